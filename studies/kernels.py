r"""How close the kernels of the smoother come to the speed of memory.

A sweep reads the matrix once and does two operations a number read: memory is its limit. The measure is the bandwidth
of a kernel over that of the triad a = b + s c on arrays that fit no cache, both best of several in one process and on
one thread. Bytes are those a kernel must move at least: each array once, the unknowns read and written
(triad: 24 bytes an element). Compare the ratios between machines, not the seconds.

    python studies/kernels.py [--quick] [--out DIR]
"""

from __future__ import annotations

import argparse
import csv
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numba import njit

from adaptmg.smoother import kernels_2d, kernels_3d
from adaptmg.smoother.system import LocalSystem

SIZES = ((2, 256), (2, 512), (3, 32), (3, 48))
QUICK_SIZES = ((2, 64), (3, 10))
REPEATS, QUICK_REPEATS = 15, 3
TRIAD_LENGTH = 10_000_000


@njit  # not cached: the cache of a script depends on how the script was loaded
def triad(a: np.ndarray, b: np.ndarray, c: np.ndarray, s: float) -> None:
    """a = b + s c."""
    for i in range(len(a)):
        a[i] = b[i] + s * c[i]


def elastic_system(dim: int, divisions: int) -> LocalSystem:
    """P1 elasticity on a structured mesh of the unit square or cube; the nodes at x = 0 are contact nodes."""
    from adaptmg.discretisation.elasticity import stiffness
    from adaptmg.mesh.structured import structured
    from adaptmg.problem import Box, PlaneStrain, Rectangle, Solid

    if dim == 2:
        mesh, material = structured(Rectangle(width=1, height=1), divisions), PlaneStrain(young=1.0, poisson=0.3)
    else:
        mesh, material = structured(Box(width=1, depth=1, height=1), divisions), Solid(young=1.0, poisson=0.3)
    matrix = stiffness(mesh, material)
    return LocalSystem.from_matrix(matrix, np.zeros(matrix.shape[0], dtype=bool),
                                   np.flatnonzero(mesh.points[:, 0] == 0))


def best_time(call: Callable[[], object], repeats: int) -> float:
    """Shortest of several runs, s; one run before them to compile and to fill the caches."""
    call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times)


def triad_bandwidth(arrays: np.ndarray, repeats: int) -> float:
    """Bytes a second of the triad on the rows of a (3, n) array."""
    return arrays.nbytes / best_time(lambda: triad(*arrays, 0.5), repeats)


def sweep_calls(system: LocalSystem) -> dict[str, tuple[Callable[[], object], int]]:
    """The kernels on a system: name -> (call, bytes moved)."""
    kernels = kernels_2d if system.dim == 2 else kernels_3d
    n = len(system.nodes)
    contact = (np.zeros(n), np.zeros(n * (system.dim - 1)), np.zeros(n), np.full(n, 0.5))
    rng = np.random.default_rng(0)
    load, unknowns, result = rng.normal(size=system.n_dofs), np.zeros(system.n_dofs), np.zeros(system.n_dofs)
    matrix = (system.indptr, system.indices, system.data)
    arguments = (*matrix, system.diagonal, system.inverse, system.contact_of, *contact, load, unknowns, 1.0)
    read = sum(array.nbytes for array in (*matrix, load, unknowns))
    sweep = read + system.inverse.nbytes + system.contact_of.nbytes + unknowns.nbytes
    return {"sweep forward": (lambda: kernels.sweep(0, 1, *arguments), sweep),
            "sweep backward": (lambda: kernels.sweep(system.n_nodes - 1, -1, *arguments), sweep),
            "residual": (lambda: kernels.residual(*matrix, load, unknowns, result), read + result.nbytes),
            "natural residual": (lambda: kernels.natural_residual(
                *matrix, system.diagonal, system.contact_of, *contact, load, unknowns, result),
                read + system.contact_of.nbytes + result.nbytes)}


def run(quick: bool = False, out: Path | None = None) -> list[dict[str, object]]:
    """Measure, and write ``kernels.csv`` to ``out`` if that is given.

    Returns
    -------
    list of dict
        One row a kernel and mesh: kernel, dim, nodes, seconds, bytes, GB_per_s, triad_GB_per_s, ratio.
    """
    repeats = QUICK_REPEATS if quick else REPEATS
    arrays = np.ones((3, TRIAD_LENGTH))
    rows = []
    for dim, divisions in QUICK_SIZES if quick else SIZES:
        system = elastic_system(dim, divisions)
        for kernel, (call, moved) in sweep_calls(system).items():
            # the triad beside each kernel, so that both see the same load of the machine
            memory = triad_bandwidth(arrays, repeats)
            seconds = best_time(call, repeats)
            rows.append({"kernel": kernel, "dim": dim, "nodes": system.n_nodes, "seconds": seconds, "bytes": moved,
                         "GB_per_s": moved / seconds / 1e9, "triad_GB_per_s": memory / 1e9,
                         "ratio": moved / seconds / memory})
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        with open(out / "kernels.csv", "w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, fieldnames=list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
    return rows


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description="Bandwidth of the smoother's kernels over that of the triad.")
    parser.add_argument("--quick", action="store_true", help="small meshes, in cache: a test that it runs")
    parser.add_argument("--out", type=Path, help="directory for kernels.csv")
    options = parser.parse_args()
    for row in run(options.quick, options.out):
        print(f"{row['kernel']:17s} {row['dim']}D {row['nodes']:8d} nodes {1e3 * row['seconds']:9.3f} ms "
              f"{row['GB_per_s']:6.1f} GB/s, {row['ratio']:.2f} of triad")


if __name__ == "__main__":
    main()
