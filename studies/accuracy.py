"""Which elements, linear or smoothed, reach an error with the fewest nodes and seconds?

    python studies/accuracy.py [--quick | --full] [--out DIR]

Families of meshes whose sizes are halved everywhere, solved by the default method, which is the
active set method on small ones: its cycles are Newton steps, its factors not counted as work.
Errors: of the GRECO bar and block the largest at the points A to E, or at A, against the converged
values; of Hertz (half a cylinder of steel on a plane, friction .3) the mean displacement of the top; of the
beam (20 : 1, over a stop) the mean displacement of its top, against a mesh twice as fine as the
last; of the roller (half a cylinder of rubber, Poisson's ratio .4999, squeezed) its force, against
a family that ends at 70 931 nodes. Seconds: of making all matrices and transfers and of solving;
meshes are not counted, but in the table of Hertz contact, which sets meshes of am.Hierarchy.graded
next to those of am.adapt.

Other programs were run once on the same problems, with friction as here, on one thread; their
seconds are stored in this script. Those of CalculiX are of the whole process."""

import json
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pandas as pd
from common import Output, cpu, drawing, main, processor_time, slope
from flexible import cantilever

import adaptmg as am

#: mean displacement of the top of half a cylinder, m: second-order elements, and families of meshes
HERTZ_TOP = -15.8898e-6
#: force of half a roller, N/m; second-order elements of NGSolve have 336.5
ROLLER = 336.35
#: relative errors of the references: by both values of the roller; errors of the cylinder stay at 1.1e-5 when its
#: mesh of 7535 nodes is halved
ACCURACY = {"roller": 4.5e-4, "Hertz": 1.1e-5}
#: seconds of other programs to an error
PEERS = pd.DataFrame(
    [
        ("GRECO bar", 8e-4, "GetFEM 5.4.2, bilinear", 0.072),
        ("GRECO bar", 8e-4, "CalculiX 2.20, CPE4", 0.40),
        ("GRECO bar", 2e-4, "NGSolve 6.2.2608, second order, graded", 0.171),
        ("GRECO bar", 2e-4, "CalculiX 2.20, CPE8", 3.1),
        ("Hertz", 1e-3, "NGSolve 6.2.2608, second order, curved", 0.098),
        ("beam", 3.5e-3, "GetFEM 5.4.2, biquadratic", 0.0134),
        ("GRECO block 3D", 1.5e-3, "NGSolve 6.2.2608, second order", 2.6),
        ("GRECO block 3D", 1.5e-3, "GetFEM 5.4.2, trilinear", 12.6),
        ("GRECO block 3D", 1.5e-3, "CalculiX 2.20", 18.6),
    ],
    columns=["case", "error", "program", "seconds"],
)


def half_cylinder(
    radius: float,
    reach: float,
    material: am.PlaneStrain,
    law: am.Coulomb | am.Frictionless,
    loads: tuple[am.Pressure, ...],
    *supports: am.Support,
) -> am.ContactProblem:
    """Half of the lower half of a cylinder, on a rigid plane, which it may touch up to x =
    reach."""
    center, side = (0.0, radius), (reach, radius - float(np.sqrt(radius**2 - reach**2)))
    domain = am.Outline(
        vertices=((0.0, 0.0), side, (radius, radius), center),
        boundaries=("round", "side", "top", "axis"),
        arcs={0: center, 1: center},
    )
    return am.ContactProblem(
        name="half a cylinder",
        domain=domain,
        material=material,
        law=law,
        loads=loads,
        contact=am.Contact("round", am.Plane((0.0, 0.0), (0.0, 1.0)), allow_interference=True),
        supports=(am.Support("axis", x=0.0), *supports),
    )


#: half-widths of contact are .53 mm here and 2.6 mm of the roller
HERTZ = half_cylinder(
    0.05,
    2.6e-3,
    am.PlaneStrain(young=2.1e11, poisson=0.3),
    am.Coulomb(0.3),
    (am.Pressure("top", 0.5e6 / 0.05),),
)


def graded(problem: am.ContactProblem, count: int) -> am.Hierarchy:
    """The hierarchy of the cylinder, everywhere halved from level to level."""
    return am.Hierarchy.graded(problem, [12.5e-3 / 2**k for k in range(count)], contact_ratio=64)


def sized(problem: am.ContactProblem, size: float, count: int) -> list[am.MeshArrays]:
    """Meshes whose edges at the contact are ``size``, size / 2, ..., and grow with the distance."""
    extent = float(np.max(problem.domain.upper))
    meshes = []
    for k in range(count):
        near = am.SizeNear([(0.0, 0.0)], size=size, radius=3 * size, grading=0.8).scaled(0.5**k)
        meshes.append(
            am.mesh.sized(problem.domain, near, 0.8 * near.grading * extent, grading=near.grading)
        )
    return meshes


def mean_on(result: am.Result, boundary: str, component: int) -> float:
    """Mean displacement of a boundary, m."""
    mesh = am.mesh.need_mesh(result)
    surface = mesh.surface(boundary)
    weights = np.bincount(
        surface.facets.reshape(-1), np.repeat(surface.measures, result.dim), mesh.n_nodes
    )
    return float(weights @ result.displacement[:, component] / weights.sum())


def at_points(result: am.Result, problem: am.ContactProblem) -> float:
    """The largest relative error at the points of a case."""
    names = "A" if result.dim == 3 else "ABCDE"
    points, exact = (
        np.array([problem.reference[kind][name] for name in names])
        for kind in ("points", "converged")
    )
    return float(np.abs(result.probe(points)[:, 0] / exact - 1).max())


def deflection_error(result: am.Result) -> float:
    """The relative error of the cylinder's deflection."""
    return abs(mean_on(result, "top", 1) / HERTZ_TOP - 1)


def cylinders(meshes: str, most: int) -> Iterator[tuple[am.Result, float]]:
    """Yield results of the cylinder and processor seconds up to them."""
    spent, begin = 0.0, processor_time()
    if meshes == "adapted":
        for step in am.adapt(HERTZ, max_nodes=most):
            spent += processor_time() - begin
            yield step.result, spent
            begin = processor_time()  # measuring errors is not part of the loop
        return
    for count in range(2, 6):
        begin = processor_time()
        result = am.solve(
            graded(replace(HERTZ, elements=meshes.removeprefix("graded, ")), count),
            am.FullMultigrid(rtol=1e-6),
        )
        yield result, processor_time() - begin
        if len(result.displacement) > most:
            return


def hertz(meshes: str, most: int) -> dict:
    """Nodes, errors and seconds of a family, as JSON."""
    for _ in cylinders(meshes, 500):  # loads kernels
        pass
    rows = [
        {"nodes": len(result.displacement), "error": deflection_error(result), "seconds": seconds}
        for result, seconds in cylinders(meshes, most)
    ]
    return {"rows": json.dumps(rows)}


@lru_cache(maxsize=8)
def family(
    case: str, count: int
) -> tuple[am.ContactProblem, list[am.MeshArrays], Callable[[am.Result], float]]:
    """Problem, meshes from coarse to fine, and the error of a result."""
    if case.startswith("GRECO"):
        problem = am.cases.greco_block() if "3D" in case else am.cases.greco_bar()
        problem = replace(
            problem,
            reference={
                "points": problem.reference["points"],
                "converged": problem.reference["values"]["converged"],
            },
        )
        first = 3 if problem.dim == 3 else 4
        meshes = [am.mesh.structured(problem.domain, first * 2**k) for k in range(count)]
        return problem, meshes, lambda result: at_points(result, problem)
    if case == "Hertz":
        return HERTZ, [am.mesh.need_mesh(level) for level in graded(HERTZ, count)], deflection_error
    if case == "roller":
        problem = half_cylinder(
            0.025,
            6e-3,
            am.PlaneStrain(young=3e6, poisson=0.4999),
            am.Frictionless(),
            (),
            am.Support("top", y=-0.35e-3),
        )
        return (
            problem,
            sized(problem, 1.6e-3, count),
            lambda result: abs(result.resultant().force[1] / ROLLER - 1),
        )
    grids = cantilever(20, count)
    return (
        grids.problem,
        [am.mesh.need_mesh(level) for level in grids.levels],
        lambda result: abs(mean_on(result, "top", 1) / bent(count + 1) - 1),
    )


@lru_cache(maxsize=2)
def bent(count: int) -> float:
    """Mean displacement of the top of the beam on a fine mesh, m."""
    grids = cantilever(20, count)
    return mean_on(
        am.solve(grids.with_problem(replace(grids.problem, elements="smoothed"))), "top", 1
    )


def solved(case: str, elements: str, meshes: int, most: int) -> am.Result:
    """Solve a case on the first meshes of a family of ``most``."""
    problem, of_family, _ = family(case, most)
    warnings.simplefilter("ignore")  # that linear elements lock is what the table shows
    return am.solve(
        am.Hierarchy.from_meshes(replace(problem, elements=elements), of_family[:meshes])
    )


@lru_cache(maxsize=2)
def warmed(case: str, elements: str, most: int) -> None:
    """Load the kernels of a case with these elements."""
    solved(case, elements, 2, most)


def run(case: str, elements: str, meshes: int, most: int) -> dict:
    """Error and seconds with the first meshes of a family of ``most``."""
    _, _, error = family(case, most)
    warmed(case, elements, most)
    results = []
    seconds = cpu(lambda: results.append(solved(case, elements, meshes, most)))
    result = results[-1]
    return {
        "nodes": len(result.displacement),
        "missed": error(result),
        "spent": seconds,
        "cycles": result.cycles,
        "work": result.work_units,
        "outcome": result.status.name,
    }


def reached(rows: pd.DataFrame, error: float, what: str) -> float:
    """Nodes or seconds to an error, between meshes by straight lines of logarithms; beyond the
    meshes NaN."""
    errors = np.minimum.accumulate(rows["error"].to_numpy())[::-1]
    if not errors[0] <= error <= errors[-1]:
        return float("nan")
    return float(
        np.exp(np.interp(np.log(error), np.log(errors), np.log(rows[what].to_numpy()[::-1])))
    )


def study(out: Output) -> None:
    """Compute all families with both elements; tables of errors and of what others need."""
    counts = {
        "GRECO bar": 4 if out.quick else 6,
        "Hertz": 3 if out.quick else 5,
        "beam": 3 if out.quick else 5,
        "roller": 3 if out.quick else 5,
    }
    if not out.quick:
        counts["GRECO block 3D"] = 4 if out.full else 3
    tables = [
        am.Study(
            run,
            [
                {"case": case, "elements": elements, "meshes": k + 1}
                for elements in ("linear", "smoothed")
                for k in range(1, most)
            ],
            out.store,
            name=case,
            fixed={"most": most},
        ).run(throw=True)
        for case, most in counts.items()
    ]
    table = pd.concat(tables, ignore_index=True)
    table["error"], table["seconds"] = table.pop("missed"), table.pop("spent")
    out.table(
        "errors",
        table[["case", "elements", "nodes", "error", "seconds", "cycles", "work", "outcome"]],
        "Errors on families of meshes, linear and smoothed elements; cycles of small ones are Newton steps",
        units={"seconds": "s", "work": "WU"},
        formats={"error": ".1e", "seconds": ".3f", "work": ".1f"},
    )
    rows = []
    for peer in PEERS.to_dict("records"):
        own = {
            elements: table[(table["case"] == peer["case"]) & (table["elements"] == elements)]
            for elements in ("linear", "smoothed")
        }
        rows.append(
            peer
            | {
                f"{elements} {what}": reached(of, peer["error"], what) if len(of) else float("nan")
                for elements, of in own.items()
                for what in ("nodes", "seconds")
            }
        )
    out.table(
        "peers",
        pd.DataFrame(rows),
        "Seconds of other programs to an error, and of this one",
        "Their seconds are those of one run, of CalculiX with its start. Empty where all meshes are better, or "
        "none.",
        units={"seconds": "s"},
        formats={
            "error": ".1e",
            "seconds": ".3g",
            "linear nodes": ".0f",
            "smoothed nodes": ".0f",
            "linear seconds": ".3g",
            "smoothed seconds": ".3g",
        },
    )
    figure, _ = drawing()
    figure.clear()
    for ax, what in zip(figure.subplots(1, 2, sharey=True), ("nodes", "seconds"), strict=True):
        for case, of in table.groupby("case", sort=False):
            (line,) = ax.loglog(
                *of[of["elements"] == "smoothed"][[what, "error"]].to_numpy().T, "o-", label=case
            )
            ax.loglog(
                *of[of["elements"] == "linear"][[what, "error"]].to_numpy().T,
                "s:",
                color=line.get_color(),
            )
        ax.set(xlabel=what, ylabel="relative error" if what == "nodes" else "")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside right upper")
    out.figure(
        "errors",
        figure,
        "Errors of smoothed (solid) and linear elements (dotted) against nodes and seconds",
    )
    contact(out)
    errors = table.pivot(index=["case", "nodes"], columns="elements", values="error")
    # the ratio of a mesh is right only if its errors are well above that of the reference
    accuracy = errors.index.get_level_values("case").map(ACCURACY).fillna(0)
    resolved = errors["smoothed"] > 5 * accuracy
    last = errors[resolved].groupby("case").last()
    gains = last["linear"] / last["smoothed"]
    out.number(
        "Error of linear over smoothed elements (5 times the reference's or more): "
        + ", ".join(name.removeprefix("GRECO ") for name in gains.index),
        "; ".join(f"{value:.{1 if value < 10 else 0}f}" for value in gains),
    )
    out.check(
        "error of the GRECO bar with smoothed elements on the finest mesh",
        last.loc["GRECO bar", "smoothed"],
        high=1.2e-3 if out.quick else 9e-5,
    )


def contact(out: Output) -> None:
    """Hertz contact on graded and on adaptive meshes."""
    kinds = ["graded, linear", "graded, smoothed", "adapted"]
    found = am.Study(
        hertz,
        {"meshes": kinds},
        out.store,
        name="meshes of Hertz",
        fixed={"most": 1500 if out.quick else 15_000},
    ).run(throw=True)
    of = {
        kind: pd.DataFrame(json.loads(rows))
        for kind, rows in zip(found["meshes"], found["rows"], strict=True)
    }
    out.table(
        "hertz",
        pd.concat([rows.assign(meshes=kind) for kind, rows in of.items()])[
            ["meshes", "nodes", "error", "seconds"]
        ],
        "Hertz: error of the deflection, meshes counted in the seconds",
        "Adapted: linear elements.",
        units={"seconds": "s"},
        formats={"error": ".1e", "seconds": ".3f"},
    )
    if not out.quick:
        # the coarsest of a family may be better than that
        least = {
            kind: pd.concat([rows.head(1).assign(error=max(1e-3, rows["error"][0])), rows])
            for kind, rows in of.items()
        }
        out.number(
            f"Hertz contact to .1 %, nodes and seconds: {'; '.join(kinds)}",
            "; ".join(
                f"{reached(rows, 1e-3, 'nodes'):.0f}, {reached(rows, 1e-3, 'seconds'):.2f} s"
                for rows in least.values()
            ),
        )
        out.check(
            "exponent of nodes in the error of adaptive meshes",
            slope(of["adapted"]["nodes"].iloc[2:], of["adapted"]["error"].iloc[2:]),
            high=-0.8,
        )


if __name__ == "__main__":
    main(study)
