"""How much does a plastic body bear, and what remains in it?

    python studies/plastic.py [--quick | --full] [--out DIR]

A rigid punch on a block without hardening has the limit load of Prandtl, (2 + pi) k: linear elements
are too strong, as volumes hardly change where all flows; smoothed ones come near it. A plate with a
hole between rigid plates has the limit load 2k (1 - a/b). A block under a rigid ball yields at a mean
pressure of 1.1 times the yield stress, and has 2.8 to 3 times it where all of the contact flows
(Johnson, Contact Mechanics, 6.3). A thick tube under inner pressure has the stresses of Hill, also
after the pressure. A billet between rough plates is upset on one mesh and on three, each of which
goes on from the state of the one before.

Each load step is solved by Newton steps; each of these is a contact problem for the multigrid."""

import time
import warnings
from functools import lru_cache

import numpy as np
import pandas as pd
from common import Output, drawing, main
from matplotlib import pyplot as plt

import adaptmg as am

RTOL = 1e-5
SOLVER = am.FullMultigrid(rtol=RTOL)
YOUNG, YIELD, RADIUS = 1e11, 2e8, 0.1  # of the block under the ball, Pa; of the ball, m
#: yield stress of the cases, Pa
STRENGTH = 3e8


def newton_steps(result: am.Result) -> int:
    """Newton steps of a load step."""
    return int(np.isfinite(result.history["newton_change"]).sum())


def punch_grids(elements: str, size: float) -> am.Hierarchy:
    """Meshes of the block, finest at the punch."""
    problem = am.cases.prandtl_punch(elements=elements)
    sizes = [8e-3]
    while sizes[-1] > 2.01 * size:
        sizes.append(sizes[-1] / 2)
    return am.Hierarchy.graded(problem, [*sizes, size], contact_ratio=8)


def limit_load(
    grids: am.Hierarchy,
    name: str,
    steps: int,
    solver: am.FullMultigrid | am.ActiveSet = SOLVER,
) -> tuple[dict, am.Result]:
    """The force on what moves over the limit load, and the last result."""
    path = am.LoadPath({name: np.arange(1, steps + 1) / steps})
    before = time.process_time()
    results = am.solve_path(grids, path, solver)
    seconds = time.process_time() - before
    reference = grids.problem.reference
    force = -results[-1].resultant("contact").force[1]
    row = {
        "nodes": grids.finest.n_nodes,
        "force": force / reference["half_width"] / reference["limit"],
        "newton": max(map(newton_steps, results)),
        "cycles": max(result.cycles for result in results),
        "total_cycles": sum(result.cycles for result in results),
        "seconds": seconds,
    }
    return row, results[-1]


@lru_cache(maxsize=1)
def punched(elements: str, size: float, steps: int) -> tuple[dict, am.Result]:
    """The force on the punch over the limit load, and the last result."""
    return limit_load(punch_grids(elements, size), "punch", steps)


def punch(elements: str, size: float, steps: int) -> dict:
    """The force on the punch over the limit load."""
    return punched(elements, size, steps)[0]


def plate(elements: str, size: float) -> dict:
    """The force on a plate with a hole over the limit load."""
    problem = am.cases.pierced_plate(elements=elements)
    grids = am.Hierarchy.graded(problem, [8 * size, 4 * size, 2 * size, size], contact_ratio=1)
    return limit_load(grids, "press", 4)[0]


def direct(size: float) -> dict:
    """Processor seconds of a path of the punch by multigrid and by factorisations, linear
    elements."""
    grids = punch_grids("linear", size)
    rows = [
        limit_load(grids, "punch", 4, solver)[0] for solver in (SOLVER, am.ActiveSet(rtol=RTOL))
    ]
    multigrid, factors = (row["seconds"] for row in rows)
    return {"nodes": rows[0]["nodes"], "multigrid": multigrid, "factors": factors}


def tube(elements: str, cells: int) -> dict:
    """Mean errors of the stresses of a tube under pressure and after it, over the yield stress."""
    problem = am.cases.hill_cylinder(elements=elements)
    grids = am.Hierarchy.uniform(problem, [(n, n // 4) for n in (cells // 4, cells // 2, cells)])
    results = am.solve_path(grids, am.LoadPath({"left": [1.0, 0.0]}), SOLVER)
    mesh = am.mesh.need_mesh(grids.finest)
    radius = mesh.points[mesh.elements, 0].mean(axis=1)
    row = {"nodes": mesh.n_nodes}
    for name, result in zip(("stress", "residual_stress"), results, strict=True):
        found = result.stress(recovered=True)[:, [0, 2]].T
        row[name] = np.abs(found - problem.reference[name](radius)).mean() / STRENGTH
    return row | {"cycles": max(result.cycles for result in results)}


def ball(reach: float, size: float, factors: np.ndarray) -> np.ndarray:
    """E* a / (yield stress R), the mean pressure over the yield stress, and the largest plastic
    strain (3, n_steps) as a ball is pressed into a block that it touches up to ``reach``."""
    steel = am.Plastic(
        am.Axisymmetric(young=YOUNG, poisson=0.3), yield_stress=YIELD, hardening=1e-4 * YOUNG
    )

    def gap(points: np.ndarray) -> np.ndarray:
        return points[:, 0] ** 2 / (2 * RADIUS)

    # with twice the width the pressures change by .2 %
    wide = 20 * reach
    block = am.Polygon(
        vertices=((0, -wide), (wide, -wide), (wide, 0), (1.3 * reach, 0), (0, 0)),
        boundaries=("bottom", "side", "free", "contact", "axis"),
    )
    depth = reach**2 / RADIUS
    problem = am.ContactProblem(
        name="ball",
        material=steel,
        domain=block,
        contact=am.Contact(
            "contact",
            am.Moving(am.GapFunction(gap), displacement=(0.0, -depth), name="ball"),
        ),
        law=am.Frictionless(),
        supports=(am.Support("axis", x=0.0), am.Support("bottom", y=0.0)),
        elements="smoothed",
    )
    sizes = [wide / 2, wide / 4, wide / 8]
    grids = am.Hierarchy.graded(problem, sizes, contact_ratio=wide / 8 / size)
    rows = []
    modulus = YOUNG / (1 - 0.3**2)
    for result in am.solve_path(grids, am.LoadPath({"ball": factors}), SOLVER):
        radius = result.contact_extent[0]
        pressure = -result.resultant("contact").force[1] / (np.pi * radius**2)
        plastic = result.accumulated_plastic_strain.max()
        rows.append((modulus * radius / (YIELD * RADIUS), pressure / YIELD, plastic))
    return np.transpose(rows)


def flow(out: Output, last: am.Result) -> None:
    """Draw where the block under the punch has flowed."""
    mesh = am.mesh.need_mesh(last)
    figure, ax = drawing()
    x, y = 1e3 * (mesh.points + 5 * last.displacement).T
    shade = ax.tripcolor(
        x, y, mesh.elements, facecolors=100 * last.accumulated_plastic_strain, vmin=0, vmax=5
    )
    figure.colorbar(shade, label="accumulated plastic strain [%]", extend="max")
    ax.set(xlabel="x [mm]", ylabel="y [mm]", xlim=(0, 40), ylim=(-25, 3), aspect="equal")
    out.figure("flow", figure, "The block under Prandtl's punch; displacements 5 times too large")


def mean_pressures(problem: am.ContactProblem, results: list[am.Result]) -> np.ndarray:
    """Mean pressure under the plate over the yield stress after each load step."""
    area = np.pi * problem.reference["radius"] ** 2
    forces = [result.resultant("contact").force[1] for result in results]
    return -np.array(forces) / area / STRENGTH


def billet(out: Output) -> None:
    """Upset a billet on three meshes, compare its forces with those on one fine mesh, and draw."""
    problem = am.cases.upset_billet()
    path = am.LoadPath({"plate": np.arange(1, 7) / 6})
    sizes = [4e-3, 2e-3, 1e-3]
    fine = am.Hierarchy.graded(problem, [*sizes, 7e-4 if out.quick else 5e-4])
    whole = mean_pressures(problem, list(am.solve_path(fine, path, SOLVER)))
    steps = list(
        am.adapt(
            problem,
            am.Hierarchy.graded(problem, sizes),
            am.Recovery(),
            engine=am.Remesh(),
            load_path=path,
            remesh_every=2,
            max_nodes=400 if out.quick else 800,
            solver=SOLVER,
        )
    )
    figure, axes = plt.subplots(
        1, 3, figsize=(11.4, 3.6), layout="constrained", sharex=True, sharey=True
    )
    rows = []
    for number, (step, ax) in enumerate(zip(steps, axes, strict=True)):
        assert step.path is not None  # there is a load path
        found = mean_pressures(problem, list(step.path))
        restored, found = found[:-2], found[-2:]
        exact = whole[2 * number : 2 * number + 2]
        rows.append(
            {
                "nodes": step.nodes,
                "dip": restored[0] / whole[2 * number - 1] - 1 if number else 0.0,
                "pressure": found[-1],
                "difference": np.abs(found / exact - 1).max(),
                "estimate": step.estimate.relative,
            }
        )
        mesh = am.mesh.need_mesh(step.result)
        x, y = 1e3 * (mesh.points + 10 * step.result.displacement).T
        shade = ax.tripcolor(
            x,
            y,
            mesh.elements,
            facecolors=100 * step.result.accumulated_plastic_strain,
            edgecolors="k",
            linewidth=0.1,
            vmin=0,
            vmax=8,
        )
        ax.set(xlabel="r [mm]", aspect="equal", title=f"{step.nodes} nodes")
    axes[0].set_ylabel("z [mm]")
    figure.colorbar(shade, ax=axes, label="accumulated plastic strain [%]", extend="max")
    table = pd.DataFrame(rows)
    out.table(
        "billet",
        table,
        "An upset billet on three meshes: mean pressure over the yield stress",
        "Two load steps on each mesh; the dip of the force where the mesh changes, and the largest difference of "
        f"these load steps from one mesh of {fine.finest.n_nodes} nodes.",
        formats={"dip": ".2%", "difference": ".1e", "estimate": ".2%", "pressure": ".4f"},
    )
    out.figure("billet", figure, "The billet on its meshes; displacements 10 times too large")
    out.check("forces on three meshes against those on one", table["difference"].max(), high=5e-4)
    slabs = problem.reference["pressure"] / STRENGTH
    out.check("pressure of the billet over that of slabs", whole[-1] / slabs, 0.98, 1.0)


def study(out: Output) -> None:
    """Compare limit loads and stresses with closed forms, and draw."""
    warnings.filterwarnings("ignore", message="strains exceed")
    sizes = [2e-3] if out.quick else [2.8e-3, 1.4e-3, 7.2e-4] if out.full else [2.8e-3, 1.4e-3]
    steps = 4 if out.quick else 8
    points = {"elements": ["linear", "smoothed"], "size": sizes, "steps": [steps]}
    table = am.Study(punch, points, out.store).run(throw=True)
    _, last = punched("smoothed", sizes[-1], steps)
    columns = ["elements", "nodes", "force", "newton", "cycles", "total_cycles", "seconds"]
    out.table(
        "punch",
        table[columns],
        "Prandtl's punch: force over (2 + pi) k a",
        "At a displacement of .04 half-widths; the most Newton steps and cycles of a load step.",
        formats={"force": ".4f", "seconds": ".2f"},
    )
    sections = {"elements": ["linear", "smoothed"], "cells": [20] if out.quick else [20, 40]}
    tubes = am.Study(tube, sections, out.store).run(throw=True)
    out.table(
        "tube",
        tubes[["elements", "nodes", "stress", "residual_stress", "cycles"]],
        "Hill's cylinder: mean error of radial and hoop stress over the yield stress",
        "Under the pressure and after it; most cycles of a load step.",
        formats=dict.fromkeys(("stress", "residual_stress"), ".3%"),
    )
    sizes = [2e-3] if out.quick else [2e-3, 1e-3]
    points = {"elements": ["linear", "smoothed"], "size": sizes}
    plates = am.Study(plate, points, out.store).run(throw=True)
    out.table(
        "plate",
        plates[["elements", "nodes", "force", "newton", "cycles"]],
        "A plate with a hole between rigid plates: force over 2k (b - a)",
        "At a shortening of .006; the most Newton steps and cycles of a load step.",
        formats={"force": ".4f"},
    )
    sizes = [4e-3] if out.quick else [1.4e-3, 7.2e-4] if out.full else [1.4e-3]
    seconds = am.Study(direct, {"size": sizes}, out.store).run(throw=True)
    out.table(
        "direct",
        seconds[["nodes", "multigrid", "factors"]],
        "Processor seconds of four load steps of the punch, linear elements",
        "Newton's method around multigrid, and around the active set method with sparse factors.",
        formats=dict.fromkeys(("multigrid", "factors"), ".2f"),
    )
    size, n_steps = (3e-4, 4) if out.quick else (1.5e-4, 10)
    # these steps end where E* a / (yield stress R) is 50
    sizes, pressures, _ = ball(0.01, size, 0.45 * np.arange(1, n_steps + 1) / n_steps)
    _, elastic, plastic = ball(6e-4, 0.08 * size, np.linspace(0.4, 0.7, 7))
    onset = np.searchsorted(plastic, 1e-6)
    figure, ax = drawing()
    ax.plot(sizes, pressures, "o-")
    ax.axhspan(2.8, 3.0, alpha=0.3)
    ax.set(xlabel="E* a / (yield stress R)", ylabel="mean pressure / yield stress")
    out.figure("ball", figure, "A ball on a block; the band: all of the contact flows (Johnson)")
    flow(out, last)
    billet(out)
    best = table[table["elements"] == "smoothed"].iloc[-1]
    out.number(
        f"Limit load of Prandtl's punch, smoothed, {best['nodes']:.0f} nodes; Newton steps, cycles a load step",
        "{force:.3f}; {newton}, {cycles}".format(**best),
    )
    finest = table.groupby("elements").last()
    out.check(
        "limit load, smoothed elements", finest.force["smoothed"], 0.99, 1.04 if out.quick else 1.02
    )
    out.check(
        "limit load, linear elements", finest.force["linear"], 1.0, 1.13 if out.quick else 1.08
    )
    out.check("error of the stresses of the tube", tubes["stress"].iloc[-1], high=3e-3)
    out.check("error of its residual stresses", tubes["residual_stress"].iloc[-1], high=3e-3)
    finest = plates.groupby("elements").last()
    out.check("limit load of the plate, smoothed elements", finest.force["smoothed"], 1.0, 1.04)
    out.check("mean pressure of the ball where it yields", elastic[onset], 1.0, 1.2)
    out.check("mean pressure of the ball", pressures[-1], 2.5 if out.quick else 2.7, 3.0)


if __name__ == "__main__":
    main(study)
