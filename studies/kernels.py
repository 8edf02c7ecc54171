r"""How close the kernels come to the speed of memory, and what building an interpolation costs.

A sweep reads the matrix once and does two operations a number read: memory is its limit. The measure is the bandwidth
of a kernel over that of the triad a = b + s c on arrays of 240 MB, both best of several in one process and on one
thread; where the matrix, or even these arrays, stay in a cache it says less. Bytes are those a kernel must move at
least: each array once, the unknowns read and written (triad: 24 bytes an element).

    python studies/kernels.py [--quick | --full] [--out DIR]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
from common import Context, Section, Table, main
from numba import njit
from paper_runs import listed, span

import adaptmg as am
from adaptmg.discrete.elasticity import stiffness
from adaptmg.mesh import MeshArrays, structured
from adaptmg.multigrid import projected_sweeps as sweeps
from adaptmg.multigrid.split_matrix import split
from adaptmg.multigrid.truncated_contact import TruncatedContact
from adaptmg.smoother import kernels
from adaptmg.smoother.blocks import ZERO
from adaptmg.smoother.system import LocalSystem
from adaptmg.transfer import PointLocator

SIZES = ((2, 256), (2, 512), (3, 32), (3, 48))
QUICK_SIZES = ((2, 64), (3, 10))
REPEATS, QUICK_REPEATS = 15, 3
TRIAD_LENGTH = 10_000_000


@njit  # not cached: the cache of a script depends on how the script was loaded
def triad(a: np.ndarray, b: np.ndarray, c: np.ndarray, s: float) -> None:
    """a = b + s c."""
    for i in range(len(a)):
        a[i] = b[i] + s * c[i]


def unit_mesh(dim: int, divisions: int) -> MeshArrays:
    """A structured mesh of the unit square or cube."""
    domain = am.Rectangle(width=1, height=1) if dim == 2 else am.Box(width=1, depth=1, height=1)
    return structured(domain, divisions)


def elastic_system(dim: int, divisions: int) -> LocalSystem:
    """P1 elasticity on a structured mesh of the unit square or cube; the nodes at x = 0 are contact nodes."""
    mesh = unit_mesh(dim, divisions)
    material = am.PlaneStrain(young=1.0, poisson=0.3) if dim == 2 else am.Solid(young=1.0, poisson=0.3)
    matrix = stiffness(mesh, material)
    return LocalSystem.from_matrix(matrix, np.zeros(matrix.shape[0], dtype=bool),
                                   np.flatnonzero(mesh.points[:, 0] == 0))


def best_times(calls: list[Callable[[], object]], repeats: int) -> list[float]:
    """Shortest of several runs of each call, s, taken in turns so that all see the same load of the machine."""
    for call in calls:
        call()
    times = np.full((repeats, len(calls)), np.inf)
    for i in range(repeats):
        for k, call in enumerate(calls):
            start = time.perf_counter()
            call()
            times[i, k] = time.perf_counter() - start
    return times.min(axis=0).tolist()


def sweep_calls(system: LocalSystem) -> dict[str, tuple[Callable[[], object], int]]:
    """The kernels on a system: name -> (call, bytes moved)."""
    n, zero = len(system.nodes), ZERO[system.dim]
    contact = (np.zeros(n), np.zeros(n * (system.dim - 1)), np.zeros(n), np.full(n, 0.5))
    rng = np.random.default_rng(0)
    load, unknowns, result = rng.normal(size=system.n_dofs), np.zeros(system.n_dofs), np.zeros(system.n_dofs)
    matrix = (system.indptr, system.indices, system.data)
    arguments = (*matrix, system.diagonal, system.inverse, system.contact_of, *contact, load, unknowns, 1.0)
    read = sum(array.nbytes for array in (*matrix, load, unknowns))
    sweep = read + system.inverse.nbytes + system.contact_of.nbytes + unknowns.nbytes
    return {"sweep forward": (lambda: kernels.sweep(zero, 0, 1, *arguments), sweep),
            "sweep backward": (lambda: kernels.sweep(zero, system.n_nodes - 1, -1, *arguments), sweep),
            "residual": (lambda: kernels.residual(zero, *matrix, load, unknowns, result), read + result.nbytes)}


def half_sweep_calls(dim: int, divisions: int) -> dict[str, tuple[Callable[[], object], int]]:
    """The half-pass sweeps of the truncated multigrid on the bar or block: name -> (call, bytes moved)."""
    problem = am.cases.greco_bar() if dim == 2 else am.cases.greco_block()
    discrete = am.discretise(problem, structured(problem.domain, divisions))
    level = split(discrete.matrix, discrete.fixed, symmetric=True)
    contact = TruncatedContact.of(discrete, level)
    zero = ZERO[dim]
    load, unknowns, kept = np.array(discrete.load), np.zeros(discrete.n_dofs), np.zeros(discrete.n_dofs)
    lower = sum(array.nbytes for array in level.lower_arrays)
    nodal = level.inverse.nbytes + contact.contact_of.nbytes

    def backward() -> None:
        sweeps.backward(zero, *level.lower_arrays, level.inverse, load, contact.contact_of, *contact.node_data,
                        unknowns, kept)

    def forward() -> None:
        sweeps.forward(zero, *level.lower_arrays, level.inverse, contact.diagonal, contact.contact_of,
                       *contact.node_data, unknowns, kept)

    return {"backward, L twice used": (backward, lower + nodal + load.nbytes + 3 * unknowns.nbytes),
            "forward, L with residual": (forward, lower + nodal + 4 * unknowns.nbytes)}


def bandwidth(dim: int, divisions: int, repeats: int) -> pd.DataFrame:
    """Each kernel of the smoother on one mesh."""
    system, arrays = elastic_system(dim, divisions), np.ones((3, TRIAD_LENGTH))
    calls = sweep_calls(system) | half_sweep_calls(dim, divisions)
    memory, *seconds = best_times([lambda: triad(*arrays, 0.5), *(call for call, _ in calls.values())], repeats)
    triad_speed = arrays.nbytes / memory
    return pd.DataFrame([
        {"kernel": kernel, "dim": dim, "nodes": system.n_nodes, "time": 1e3 * t, "data": moved / 1e6,
         "bandwidth": moved / t / 1e9, "triad": triad_speed / 1e9, "over triad": moved / t / triad_speed}
        for (kernel, (_, moved)), t in zip(calls.items(), seconds, strict=True)])


def location(dim: int, divisions: int, points: int, repeats: int) -> dict[str, object]:
    """Locating random points, the search structure included."""
    mesh = unit_mesh(dim, divisions)
    where = np.random.default_rng(1).random((points, dim))
    seconds, = best_times([lambda: PointLocator(mesh).locate(where)], repeats)
    return {"task": f"locate {points} points", "dim": dim, "nodes": mesh.n_nodes, "time": seconds,
            "a point": 1e6 * seconds / points}


def interpolation(dim: int, coarse: int, fine: int, repeats: int) -> dict[str, object]:
    """Building the interpolation between two structured meshes, nested or not."""
    meshes = unit_mesh(dim, coarse), unit_mesh(dim, fine)
    seconds, = best_times([lambda: am.Interpolation().build(*meshes)], repeats)
    return {"task": f"interpolation to {meshes[1].n_nodes} nodes", "dim": dim, "nodes": meshes[0].n_nodes,
            "time": seconds, "a point": 1e6 * seconds / meshes[1].n_nodes}


def run(context: Context) -> Section:
    """Measure; nothing is stored, as timings of another moment are of no use."""
    with context.alone():
        return measured(context)


def measured(context: Context) -> Section:
    """Both tables."""
    repeats = QUICK_REPEATS if context.quick else REPEATS
    speeds = pd.concat([bandwidth(dim, divisions, repeats)
                        for dim, divisions in (QUICK_SIZES if context.quick else SIZES)])
    if context.quick:
        tasks = [location(2, 32, 10_000, 2), interpolation(2, 32, 64, 2)]
    else:
        tasks = [location(dim, divisions, points, 2) for dim, divisions in ((2, 128), (3, 24))
                 for points in (10_000, 100_000, 1_000_000)]
        tasks += [interpolation(2, 128, 256, 5), interpolation(2, 127, 256, 5), interpolation(3, 16, 32, 5)]
    note = (f"Best of {repeats} runs in one process, in turns with the triad (240 MB). Data: what a kernel must move "
            "at least. A kernel that runs after another on the same matrix may find part of it in a cache, and is then "
            f"above 1{cache_text()}. The half sweeps (L) use each entry twice.")
    return Section("Kernels", "", [
        Table("kernels_bandwidth", speeds, "Bandwidth of the kernels over that of a triad, P1 elasticity, one thread",
              note, {"time": "ms", "data": "MB", "bandwidth": "GB/s", "triad": "GB/s"},
              {"over triad": ".2f", "bandwidth": ".1f", "triad": ".1f", "time": ".3f", "data": ".1f"}),
        Table("kernels_transfer", pd.DataFrame(tasks), "Point location and interpolation between meshes, one thread",
              "Nodes: of the mesh that is searched, or interpolated from. Search structure included, compiled before. "
              f"A point takes {span([task['a point'] for task in tasks if task['dim'] == 2], '.1f')} µs in 2D.",
              {"time": "s", "a point": "µs"}, {"time": ".4f", "a point": ".2f"})], summary=summary(speeds))


def summary(speeds: pd.DataFrame) -> str:
    """What was asked and what came out: the largest meshes."""
    largest = speeds[speeds["data"] > 0.5 * speeds["data"].max()]
    whole = largest[largest["kernel"].str.startswith("sweep")]["over triad"]
    nodes = listed(largest["nodes"].unique(), "d")
    return ("How close do the kernels come to the speed of memory, which is their limit? Sweeps of the smoother on "
            f"the largest matrices ({nodes} nodes) move data at {span(whole, '.2f')} times the bandwidth of a triad"
            f"{'; above 1 they find data in a cache' * bool((whole > 1).any())}. Compare these ratios between "
            "machines, not the seconds.")


def cache_text() -> str:
    """What Linux says of the largest cache, for a sentence."""
    sizes = [path.read_text().strip() for path in Path("/sys/devices/system/cpu/cpu0/cache").glob("index*/size")]
    largest = max((int(size[:-1]) for size in sizes if size.endswith("K")), default=0)
    return f" (the largest cache of this machine: {largest / 1024:.0f} MB)" if largest else ""


if __name__ == "__main__":
    main(run, "Bandwidth of the smoother's kernels over that of the triad, and the cost of interpolation. "
              "Example: python studies/kernels.py --quick --out /tmp/kernels")
