"""Which elements reach an error with the fewest nodes and seconds, linear or smoothed ones, and what do others need?

    python studies/accuracy.py [--quick | --full] [--out DIR]

Families of meshes whose sizes are halved everywhere, solved by the default method. Errors: of the GRECO bar and block
the largest at the points A to E, or at A, against the converged values; of Hertz (half a cylinder of steel on a plane,
friction .3) the mean displacement of the top; of the beam (20 : 1, over a stop) the mean displacement of its top,
against a mesh twice as fine as the last; of the roller (half a cylinder of rubber, Poisson's ratio .4999, squeezed) its
force, against a family that ends at 70 931 nodes. Seconds: of making all matrices and transfers and of solving; meshes
are not counted.

Other programs were run once on the same problems, with friction as here, on one thread; their seconds are stored in
this script. Those of CalculiX are of the whole process.
"""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd
from common import Output, cpu, drawing, main, warm_up
from flexible import cantilever

import adaptmg as am

#: mean displacement of the top of half a cylinder, m: second-order elements, and families of meshes
HERTZ_TOP = -15.8898e-6
#: force of half a roller, N/m; second-order elements of NGSolve have 336.5
ROLLER = 336.35
#: seconds of other programs to an error
PEERS = pd.DataFrame([
    ("GRECO bar", 8e-4, "GetFEM 5.4.2, bilinear", 0.072), ("GRECO bar", 8e-4, "CalculiX 2.20, CPE4", 0.40),
    ("GRECO bar", 2e-4, "NGSolve 6.2.2608, second order, graded", 0.171),
    ("GRECO bar", 2e-4, "CalculiX 2.20, CPE8", 3.1),
    ("Hertz", 1e-3, "NGSolve 6.2.2608, second order, curved", 0.098),
    ("beam", 3.5e-3, "GetFEM 5.4.2, biquadratic", 0.0134),
    ("GRECO block 3D", 1.5e-3, "NGSolve 6.2.2608, second order", 2.6),
    ("GRECO block 3D", 1.5e-3, "GetFEM 5.4.2, trilinear", 12.6),
    ("GRECO block 3D", 1.5e-3, "CalculiX 2.20", 18.6)], columns=["case", "error", "program", "seconds"])


def half_cylinder(radius: float, material: am.PlaneStrain, law: am.Coulomb | am.Frictionless,
                  loads: tuple[am.Pressure, ...], *supports: am.Support) -> am.ContactProblem:
    """Half of the lower half of a cylinder on a rigid plane."""
    domain = am.Outline(vertices=((0.0, 0.0), (radius, radius), (0.0, radius)), boundaries=("round", "top", "axis"),
                        arcs={0: (0.0, radius)})
    return am.ContactProblem(name="half a cylinder", domain=domain, material=material, law=law, loads=loads,
                             contact=am.Contact("round", am.Plane((0.0, 0.0), (0.0, 1.0))),
                             supports=(am.Support("axis", x=0.0), *supports))


def sized(problem: am.ContactProblem, size: float, count: int) -> list[am.MeshArrays]:
    """Meshes whose edges at the contact are ``size``, size / 2, ..., and grow with the distance."""
    extent = float(np.max(problem.domain.upper))
    meshes = []
    for k in range(count):
        near = am.SizeNear([(0.0, 0.0)], size=size, radius=3 * size, grading=0.8).scaled(0.5**k)
        meshes.append(am.mesh.sized(problem.domain, near, 0.8 * near.grading * extent, grading=near.grading))
    return meshes


def mean_on(result: am.Result, boundary: str, component: int) -> float:
    """Mean displacement of a boundary, m."""
    surface = result.mesh.surface(boundary)
    weights = np.bincount(surface.facets.reshape(-1), np.repeat(surface.measures, result.dim), result.mesh.n_nodes)
    return float(weights @ result.displacement[:, component] / weights.sum())


def at_points(result: am.Result, problem: am.ContactProblem) -> float:
    """The largest relative error at the points of a case."""
    names = "A" if result.dim == 3 else "ABCDE"
    points, exact = (np.array([problem.reference[kind][name] for name in names]) for kind in ("points", "converged"))
    return float(np.abs(result.probe(points)[:, 0] / exact - 1).max())


@lru_cache(maxsize=8)
def family(case: str, count: int) -> tuple[am.ContactProblem, list[am.MeshArrays], Callable[[am.Result], float]]:
    """Problem, meshes from coarse to fine, and the error of a result."""
    if case.startswith("GRECO"):
        problem = am.cases.greco_block() if "3D" in case else am.cases.greco_bar()
        problem = replace(problem, reference={"points": problem.reference["points"],
                                              "converged": problem.reference["values"]["converged"]})
        first = 3 if problem.dim == 3 else 4
        meshes = [am.mesh.structured(problem.domain, first * 2**k) for k in range(count)]
        return problem, meshes, lambda result: at_points(result, problem)
    if case == "Hertz":
        problem = half_cylinder(0.05, am.PlaneStrain(young=2.1e11, poisson=0.3), am.Coulomb(0.3),
                                (am.Pressure("top", 0.5e6 / 0.05),))
        return problem, sized(problem, 2e-4, count), lambda result: abs(mean_on(result, "top", 1) / HERTZ_TOP - 1)
    if case == "roller":
        problem = half_cylinder(0.025, am.PlaneStrain(young=3e6, poisson=0.4999), am.Frictionless(), (),
                                am.Support("top", y=-0.35e-3))
        return problem, sized(problem, 1.6e-3, count), lambda result: abs(
            result.resultant().force[1] / ROLLER - 1)
    grids = cantilever(20, count)
    return grids.problem, [level.mesh for level in grids.levels], lambda result: abs(
        mean_on(result, "top", 1) / bent(count + 1) - 1)


@lru_cache(maxsize=2)
def bent(count: int) -> float:
    """Mean displacement of the top of the beam on a fine mesh, m."""
    grids = cantilever(20, count)
    return mean_on(am.solve(grids.with_problem(replace(grids.problem, elements="smoothed"))), "top", 1)


def run(case: str, elements: str, meshes: int, most: int) -> dict:
    """Error and seconds with the first meshes of a family of ``most``."""
    warm_up(3 if "3D" in case else 2)
    problem, of_family, error = family(case, most)
    posed = replace(problem, elements=elements)

    def solved() -> am.Result:
        warnings.simplefilter("ignore")  # that linear elements lock is what the table shows
        return am.solve(am.Hierarchy.from_meshes(posed, of_family[:meshes]))

    result = solved()
    return {"nodes": len(result.displacement), "missed": error(result), "spent": cpu(solved), "cycles": result.cycles,
            "work": result.work_units, "outcome": result.status.name}


def reached(rows: pd.DataFrame, error: float, what: str) -> float:
    """Nodes or seconds to an error, between meshes by straight lines of logarithms; beyond the meshes NaN."""
    errors = np.minimum.accumulate(rows["error"].to_numpy())[::-1]
    if not errors[0] <= error <= errors[-1]:
        return float("nan")
    return float(np.exp(np.interp(np.log(error), np.log(errors), np.log(rows[what].to_numpy()[::-1]))))


def study(out: Output) -> None:
    """Compute all families with both elements; tables of errors and of what others need."""
    counts = {"GRECO bar": 4 if out.quick else 6, "Hertz": 3 if out.quick else 5, "beam": 3 if out.quick else 5,
              "roller": 3 if out.quick else 5}
    if not out.quick:
        counts["GRECO block 3D"] = 4 if out.full else 3
    tables = [am.Study(run, [{"case": case, "elements": elements, "meshes": k + 1}
                             for elements in ("linear", "smoothed") for k in range(1, most)], out.store, name=case,
                       fixed={"most": most}).run(throw=True) for case, most in counts.items()]
    table = pd.concat(tables, ignore_index=True)
    table["error"], table["seconds"] = table.pop("missed"), table.pop("spent")
    out.table("errors", table[["case", "elements", "nodes", "error", "seconds", "cycles", "work", "outcome"]],
              "Errors on families of meshes, linear and smoothed elements", units={"seconds": "s", "work": "WU"},
              formats={"error": ".1e", "seconds": ".3f", "work": ".1f"})
    rows = []
    for peer in PEERS.to_dict("records"):
        own = {elements: table[(table["case"] == peer["case"]) & (table["elements"] == elements)]
               for elements in ("linear", "smoothed")}
        rows.append(peer | {f"{elements} {what}": reached(of, peer["error"], what) if len(of) else float("nan")
                            for elements, of in own.items() for what in ("nodes", "seconds")})
    out.table("peers", pd.DataFrame(rows), "Seconds of other programs to an error, and of this one",
              "Their seconds are those of one run, of CalculiX with its start.", units={"seconds": "s"},
              formats={"error": ".1e", "seconds": ".3g", "linear nodes": ".0f", "smoothed nodes": ".0f",
                       "linear seconds": ".3g", "smoothed seconds": ".3g"})
    figure, ax = drawing()
    for case, of in table.groupby("case", sort=False):
        line, = ax.loglog(*of[of["elements"] == "smoothed"][["nodes", "error"]].to_numpy().T, "o-", label=case)
        ax.loglog(*of[of["elements"] == "linear"][["nodes", "error"]].to_numpy().T, "s:", color=line.get_color())
    ax.set(xlabel="nodes", ylabel="relative error")
    figure.legend(loc="outside right upper")
    out.figure("errors", figure, "Errors of smoothed (solid) and linear elements (dotted) against the nodes")
    last = table.groupby(["case", "elements"]).last()["error"].unstack()
    gains = last["linear"] / last["smoothed"]
    out.number("Error of linear over smoothed elements on the finest meshes: " + ", ".join(gains.index),
               "; ".join(f"{value:.1f}" for value in gains))
    out.check("error of the GRECO bar with smoothed elements on the finest mesh", last["smoothed"]["GRECO bar"],
              high=2e-3 if out.quick else 2e-4)


if __name__ == "__main__":
    main(study)
