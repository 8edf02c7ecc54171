"""How fast are scalar obstacle problems, where every node may touch?

    python studies/obstacle.py [--quick | --full] [--out DIR]

A membrane under a pressure over a floor, and a square bar twisted until it yields, whose stress
function lies between two roofs: on the unit square with n x n cells, to a relative energy error of
1e-8. Seconds are processor seconds of a solve, set-up and certificate included.

Rates are those of the last cycles without recombination, next to those of the linear problem in
which the touching nodes are held. Round sections, on meshes that are not nested, have closed forms:
of the force on the floor, and of the torque of the bar.

Adaptive meshes, by the residual estimate, against uniform ones: on the round membrane, and on an L
whose solution is singular at the corner, Re z^(2/3), over an obstacle on which it lies for |z| > 1."""

from collections.abc import Callable
from functools import lru_cache
from itertools import product

import numpy as np
from common import Output, cpu, drawing, main
from scipy.optimize import nnls

import adaptmg as am

PLAIN = am.Truncated(recombine=0)
METHODS = {
    "truncated, nested start": am.FullMultigrid(),
    "truncated, from zero": am.Multigrid(),
    "truncated, pyamg's cycle": am.FullMultigrid(correction=am.Truncated(correct=am.PyAMG())),
    "monotone, nested start": am.FullMultigrid(correction=am.Monotone(), max_cycles=300),
    "active set, nested start": am.ActiveSet(condensed=False, nested_start=True, rtol=1e-8),
    "one grid, best omega": None,
}
LIMITS = {
    "monotone, nested start": 256,
    "active set, nested start": 256,
    "one grid, best omega": 128,
}  # unless --full
SQUARE = am.Rectangle(width=1.0, height=1.0, origin=(-0.5, -0.5))
CASES = {
    "floor": am.ScalarProblem(domain=SQUARE, load=-10.0, lower=-0.3),
    "torsion": am.cases.elastic_plastic_torsion(section="square", size=0.5, twist=2.5),
}
FLOOR = am.cases.obstacle_problem()


def place(x: np.ndarray) -> np.ndarray:
    """Return points as complex numbers, with the edges at the corner 3/4 pi to both sides."""
    return np.exp(-0.75j * np.pi) * (x @ (1, 1j))


CORNER = am.ScalarProblem(
    name="L with a corner",
    domain=am.Polygon(
        vertices=((0, 0), (2, 0), (2, 2), (-2, 2), (-2, -2), (0, -2)), boundaries=("edge",) * 6
    ),
    load=lambda x: np.where(np.abs(place(x)) > 1, -1.0, 0.0),
    lower=lambda x: (place(x) ** (2 / 3)).real - np.maximum(1 - np.abs(place(x)), 0) ** 2,
    value=lambda x: (place(x) ** (2 / 3)).real,
)


def floor_slope(x: np.ndarray) -> np.ndarray:
    """Return the gradient of the closed form of the membrane over a floor."""
    r = np.linalg.norm(x, axis=1)[:, None]
    a = FLOOR.reference["contact_radius"]
    return np.where(r > a, (1 - (a / r) ** 2) / 2, 0.0) * x


def corner_slope(x: np.ndarray) -> np.ndarray:
    """Return the gradient of Re z^(2/3)."""
    slope = 2 / 3 * place(x) ** (-1 / 3) * np.exp(-0.75j * np.pi)
    return np.column_stack([slope.real, -slope.imag])


#: the problem, the gradient of its solution, and the root of its area over that of the L
EXACT = {
    "membrane over a floor": (FLOOR, floor_slope, 0.51),
    "L with a corner": (CORNER, corner_slope, 1.0),
}
ENGINES = {"bisected": am.Bisect(), "remeshed": am.Remesh(), "uniform": None}


@lru_cache(maxsize=4)
def grids(case: str, n: int) -> am.Hierarchy:
    """Return nested grids from 4 x 4 cells."""
    return am.Hierarchy.uniform(CASES[case], [2**k for k in range(2, n.bit_length())])


@lru_cache(maxsize=1)
def warmed(case: str, method: str) -> None:
    """Load the kernels of a method."""
    am.solve(grids(case, 16), METHODS[method] or am.SingleGrid(), throw=False)


def run(case: str, n: int, method: str) -> dict:
    """Measure cycles, work and seconds of a method."""
    hierarchy = grids(case, n)
    solver = METHODS[method] or am.SingleGrid(omega=2 / (1 + np.sin(np.pi / n)))
    warmed(case, method)
    results = []
    seconds = cpu(lambda: results.append(am.solve(hierarchy, solver, throw=False)))
    result = results[-1]
    return {
        "nodes": hierarchy.finest.n_nodes,
        "touching": int(result.contact.closed.sum()),
        "cycles": result.cycles,
        "work": np.nan if method.startswith("active") else result.work_units,
        "seconds": seconds,
        "outcome": result.status.name + ", handed over" * bool(result.fallback),
    }


def last_rate(result: am.Result) -> float:
    """Return the mean rate of the last four cycles before corrections fall below 1e-10."""
    change = result.history["change"][result.history["change"] > 1e-10]
    return float((change[-1] / change[-5]) ** 0.25)


def rates(case: str, n: int) -> dict:
    """Measure the rate of truncated cycles, and that of the linear problem with touching nodes held."""
    discrete = grids(case, n).finest.discrete
    tight = am.Multigrid(correction=PLAIN, rtol=1e-12)
    result = am.solve(grids(case, n), tight, throw=False)
    held = discrete.fixed.copy()
    held[result.contact.node[result.contact.closed]] = True
    linear = am.DiscreteProblem(
        matrix=discrete.matrix,
        load=discrete.load,
        fixed=held,
        fixed_values=result.displacement[:, 0],
        contact=am.ContactNodes(nodes=[], normals=np.empty((0, 1)), gaps=[]),
    )
    rows = [level.prolongation.copy() for level in grids(case, n).levels[1:]]
    rows[-1].data[np.repeat(held, np.diff(rows[-1].indptr))] = 0.0
    spaces = am.Hierarchy.from_prolongations(linear, rows)
    glued = am.solve(spaces, tight, throw=False)
    return {"truncated": last_rate(result), "linear": last_rate(glued)}


def closed_form(case: str, size: float) -> dict:
    """Measure the error of the force on the floor, or of the torque, on meshes of a disc."""
    force = case == "force on the floor"
    problem = FLOOR if force else am.cases.elastic_plastic_torsion()
    grids = am.Hierarchy.graded(problem, (4 * size, 2 * size, size))
    result = am.solve(grids, am.FullMultigrid())
    mesh = am.mesh.need_mesh(result)
    torque = 2 * mesh.volumes @ result.displacement[mesh.elements, 0].mean(axis=1)
    found = result.contact.force_n.sum() if force else torque
    exact = problem.reference["force" if force else "torque"]
    return {"nodes": mesh.n_nodes, "cycles": result.cycles, "error": abs(found / exact - 1)}


def energy_error(result: am.Result, slope: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return the error in the energy norm, by the middles of 36 equal parts of each triangle."""
    mesh = am.mesh.need_mesh(result)
    parts = [(3 * i + k, 3 * j + k) for i in range(6) for j in range(6) for k in (1, 2)]
    second, third = np.array([part for part in parts if sum(part) < 18]).T / 18
    corners = mesh.points[mesh.elements]
    u = result.displacement[mesh.elements, 0]
    found = np.linalg.solve(corners[:, 1:] - corners[:, :1], (u[:, 1:] - u[:, :1])[..., None])
    weights = np.column_stack([1 - second - third, second, third])
    points = np.einsum("qk,ekd->qed", weights, corners)
    missed = slope(points.reshape(-1, 2)).reshape(points.shape) - found[..., 0]
    return float(np.sqrt((missed**2).sum(axis=2).mean(axis=0) @ mesh.volumes))


def follow(case: str, meshes: str, max_nodes: int) -> dict:
    """Measure the error on the last of three meshes, its rate in the number of nodes, and the estimate
    over it."""
    problem, slope, size = EXACT[case]
    if meshes == "uniform":
        grids = am.Hierarchy.graded(problem, [size * h * max_nodes**-0.5 for h in (15.2, 7.6, 3.8)])
        levels = [grids.truncated(finest=k) for k in range(3)]
        pairs = [(level, am.solve(level)) for level in levels]
    else:
        steps = list(am.adapt(problem, engine=ENGINES[meshes], max_nodes=max_nodes))
        pairs = [(step.hierarchy, step.result) for step in steps[-3:]]
    errors = [energy_error(result, slope) for _, result in pairs]
    nodes = [level.finest.n_nodes for level, _ in pairs]
    estimates = [am.Residual().indicate(*pair) for pair in pairs]
    return {
        "nodes": nodes[-1],
        "error": errors[-1] / estimates[-1].norm,
        "rate": np.polyfit(np.log(nodes), np.log(errors), 1)[0],
        "estimate over error": estimates[-1].total / errors[-1],
    }


def least_squares(n: int) -> float:
    """Return the largest distance from the solution by Lawson and Hanson's method, over the depth."""
    discrete, free = grids("floor", n).finest.discrete, ~grids("floor", n).finest.discrete.fixed
    factor = np.linalg.cholesky(discrete.matrix.toarray()[np.ix_(free, free)])
    rest = (discrete.load + 0.3 * (discrete.matrix @ free.astype(float)))[free]
    exact, _ = nnls(factor.T, np.linalg.solve(factor, rest))
    result = am.solve(grids("floor", n), am.FullMultigrid(rtol=1e-12), throw=False)
    return float(np.abs(result.displacement[free, 0] + 0.3 - exact).max() / 0.3)


def study(out: Output) -> None:
    """Compare methods, rates and closed forms."""
    sizes = [32] if out.quick else [32, 128, 512]
    points = [
        {"case": case, "n": n, "method": method}
        for case, method, n in product(CASES, METHODS, sizes)
        if out.full or n <= LIMITS.get(method, n)
    ]
    table = am.Study(run, points, out.store).run(throw=True)
    table = table.drop(columns=["n", "status", "run_seconds", "error"])
    note = "Cycles of one grid are sweeps, of the active set Newton steps: their factors are not counted as work."
    formats = {"work": ".1f", "seconds": ".3f"}
    out.table("methods", table, "To 1e-8, by all methods", note, formats=formats)
    cells = [{"case": case, "n": n} for case in CASES for n in sizes[:2]]
    linear = am.Study(rates, cells, out.store).run(throw=True).iloc[:, :4].round(3)
    out.table("rates", linear, "Rates of cycles without recombination")
    sections = {"case": ["force on the floor", "torque"], "size": [0.1, 0.05, 0.025]}
    exact = am.Study(closed_form, sections, out.store).run(throw=True).iloc[:, :5]
    out.table("closed_forms", exact, "Round sections against closed forms")
    ways = {"case": list(EXACT), "meshes": list(ENGINES)}
    nodes = {"max_nodes": 1500 if out.quick else 5000}
    followed = am.Study(follow, ways, out.store, fixed=nodes).run(throw=True)
    followed = followed.iloc[:, :6]
    note = "Errors in the energy norm, over the norm; rates in the number of nodes, of the last three meshes."
    formats = {"error": ".1%", "rate": ".2f", "estimate over error": ".1f"}
    out.table("adaptive", followed, "Meshes that follow the error", note, formats=formats)
    adaptive = followed[followed["meshes"] != "uniform"]
    figure, axes = drawing()
    for method, rows in table[table["case"] == "torsion"].groupby("method", sort=False):
        axes.loglog(rows["nodes"], rows["seconds"], "o-", label=method)
    axes.set(xlabel="nodes", ylabel="seconds")
    axes.legend(bbox_to_anchor=(1, 1))
    out.figure("seconds", figure, "Torsion of a square bar: processor seconds to 1e-8.")
    most = table.groupby("method")["cycles"].max()
    for sentence, value, high in (
        ("cycles after the nested start", most["truncated, nested start"], 8),
        ("cycles from zero", most["truncated, from zero"], 14),
        ("rate over that of the linear problem", (linear.truncated / linear.linear).max(), 1.1),
        ("error of force and torque on the finest disc", exact["error"].iloc[2::3].max(), 5e-4),
        ("exponent of errors on adaptive meshes", adaptive["rate"].max(), -0.45),
        ("estimate over error on adaptive meshes", adaptive["estimate over error"].max(), 8),
        ("distance from non-negative least squares", least_squares(16), 1e-9),
    ):
        out.check(sentence, value, high=high)


if __name__ == "__main__":
    main(study)
