"""How fast are scalar obstacle problems, where every node may touch?

    python studies/obstacle.py [--quick | --full] [--out DIR]

A membrane under a pressure over a floor, and a square bar twisted until it yields, whose stress
function lies between two roofs: on the unit square with n x n cells, to a relative energy error of
1e-8. Seconds are processor seconds of a solve, set-up and certificate included.

Rates are those of the last cycles without recombination, next to those of the linear problem in
which the touching nodes are held. Round sections, on meshes that are not nested, have closed forms:
of the force on the floor, and of the torque of the bar."""

from functools import lru_cache, partial
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


@lru_cache(maxsize=4)
def grids(case: str, n: int) -> am.Hierarchy:
    """Return nested grids from 4 x 4 cells."""
    return am.Hierarchy.uniform(CASES[case], [2**k for k in range(2, n.bit_length())])


def run(case: str, n: int, method: str) -> dict:
    """Measure cycles, work and seconds of a method."""
    hierarchy = grids(case, n)
    solver = METHODS[method] or am.SingleGrid(omega=2 / (1 + np.sin(np.pi / n)))
    result = am.solve(hierarchy, solver, throw=False)
    return {
        "nodes": hierarchy.finest.n_nodes,
        "touching": int(result.contact.closed.sum()),
        "cycles": result.cycles,
        "work": np.nan if method.startswith("active") else result.work_units,
        "seconds": cpu(partial(am.solve, hierarchy, solver, throw=False)),
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
    problem = am.cases.obstacle_problem() if force else am.cases.elastic_plastic_torsion()
    disc = am.Circle((0.0, 0.0), 1.0, "edge")
    meshes = [am.mesh.graded(disc, h) for h in (4 * size, 2 * size, size)]
    result, mesh = am.solve(am.Hierarchy.from_meshes(problem, meshes)), meshes[-1]
    torque = 2 * mesh.volumes @ result.displacement[mesh.elements, 0].mean(axis=1)
    found = result.contact.force_n.sum() if force else torque
    exact = problem.reference["force" if force else "torque"]
    return {"nodes": mesh.n_nodes, "cycles": result.cycles, "error": abs(found / exact - 1)}


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
    sizes = [32, 64] if out.quick else [32, 128, 512]
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
        ("distance from non-negative least squares", least_squares(16), 1e-9),
    ):
        out.check(sentence, value, high=high)


if __name__ == "__main__":
    main(study)
