"""Which transfer between meshes that are not nested, and how far may their sizes lie apart?

    python studies/transfers.py [--quick | --full] [--out DIR]

GRECO bar with friction 1 (2D), block with friction .3 (3D), independent meshes four (3D: two) times
finer at contact, sizes halved everywhere from level to level. Every transfer serves the default
method and the monotone one (V(2,0)), with the nested start, to 1e-8; fine contact nodes interpolate
along the coarse contact boundary whatever the transfer does elsewhere. Then two grids with a
growing ratio of their sizes, from zero, and hierarchies of NGSolve's locally refined meshes next to
those of the package's own mesher. Point interpolation builds quickest and keeps the coarse matrices
sparse; what decides is the ratio of sizes of neighbouring levels."""

import time
from functools import lru_cache
from itertools import pairwise, starmap

import numpy as np
from common import Output, drawing, main, processor_time, timed, warm_up

import adaptmg as am
from adaptmg.estimate.reference_error import Reference, energy_error
from adaptmg.mesh import graded, quality

TRANSFERS = {
    "Interpolation": am.Interpolation(),
    "PseudoL2": am.PseudoL2(),
    "L2": am.L2(),
    "QuasiInterpolation": am.QuasiInterpolation(),
    "LumpedL2": am.LumpedL2(),
}
MONOTONE = {"correction": am.Monotone(), "cycle": am.Cycle(pre=2, post=0)}


@lru_cache(maxsize=1)
def posed(dim: int, levels: int) -> tuple[am.ContactProblem, list[am.MeshArrays]]:
    """Problem and independent meshes, coarse to fine."""
    problem = (
        am.cases.greco_bar(law=am.Coulomb(1.0))
        if dim == 2
        else am.cases.greco_block(law=am.Coulomb(0.3))
    )
    return problem, [
        graded(problem.domain, 20e-3 / 2**k, "bottom", 4 if dim == 2 else 2, 0.3 / 2**k)
        for k in range(levels)
    ]


def run(dim: int, levels: int, transfer: str) -> dict:
    """Cost of a transfer, what it keeps, and the work of both methods with it."""
    warm_up(dim)
    problem, meshes = posed(dim, levels)
    TRANSFERS[transfer].build(*meshes[:2])
    begin = time.process_time()
    for coarse, fine in pairwise(meshes):
        TRANSFERS[transfer].build(coarse, fine)
    row = {"build_ms": 1e3 * (time.process_time() - begin)}
    hierarchy = am.Hierarchy.from_meshes(problem, meshes, TRANSFERS[transfer])
    affine = max(
        float(np.abs(level.prolongation @ coarse.points - fine.points).max())
        for level, (coarse, fine) in zip(hierarchy.levels[1:], pairwise(meshes), strict=True)
    ) / float(np.ptp(meshes[0].points))
    row |= {
        "nodes": hierarchy.finest.n_nodes,
        "affine_error": affine,
        "entries": hierarchy.finest.prolongation.nnz / hierarchy.finest.n_nodes,
    }
    for name, options in (("default", {}), ("monotone", MONOTONE)):
        try:
            result = am.solve(hierarchy, am.FullMultigrid(max_cycles=300, **options), throw=False)
        except (
            ValueError
        ):  # a negative weight between contact nodes: the monotone correction refuses the transfer
            row |= {f"{name}_work": np.nan, f"{name}_cycles": np.nan, f"{name}_outcome": "REFUSED"}
            continue
        row |= {
            f"{name}_work": result.work_units,
            f"{name}_cycles": result.cycles,
            f"{name}_outcome": result.status.name,
        }
    return row


def two_grids(where: str, ratio: int) -> dict:
    """Rates of two grids whose sizes differ by ``ratio`` everywhere, or by 2 in the bulk and
    ``ratio`` at contact."""
    warm_up()
    problem = am.cases.greco_bar(law=am.Coulomb(1.0))
    coarse = (
        graded(problem.domain, 2.5e-3 * ratio, "bottom", 8)
        if where == "everywhere"
        else graded(problem.domain, 5e-3, "bottom", 16 / ratio)
    )
    hierarchy = am.Hierarchy.from_meshes(
        problem, [coarse, graded(problem.domain, 2.5e-3, "bottom", 8)]
    )
    default, monotone = (
        am.solve(hierarchy, am.Multigrid(max_cycles=300, **options), throw=False)
        for options in ({}, MONOTONE)
    )
    return {
        "coarse_nodes": coarse.n_nodes,
        "nodes": hierarchy.finest.n_nodes,
        "cycles": default.cycles,
        "rate": default.rate,
        "monotone_cycles": monotone.cycles,
        "monotone_rate": monotone.rate,
    }


#: case, sizes away from contact, coarse to fine, m, and ratio at contact
MESHED = {
    "GRECO bar": (am.cases.greco_bar, (20e-3, 10e-3, 5e-3, 2.5e-3, 1.25e-3), 4),
    "dovetail": (am.cases.dovetail, (8e-3, 4e-3, 2e-3, 1e-3), 4),
    "bolted junction": (am.cases.bolted_junction, (12e-3, 7e-3, 4e-3, 2.4e-3), 2),
}


@lru_cache(maxsize=1)
def reference(case: str, levels: int) -> Reference:
    """A solution on meshes four times finer at contact than the finest that are compared."""
    make, sizes, ratio = MESHED[case]
    sizes = sizes[:levels]
    grids = am.Hierarchy.graded(make(), [*sizes, sizes[-1] / 2, sizes[-1] / 4], ratio)
    return Reference.of(grids, am.solve(grids))


def mesher(case: str, mesher: str, levels: int) -> dict:
    """Meshes of one mesher, and the solution with the default method."""
    warm_up()
    make, sizes, ratio = MESHED[case]
    problem = make()
    graded(problem.domain, sizes[0], problem.pair_boundaries, ratio, mesher=mesher)
    begin = processor_time()
    meshes = [
        graded(
            problem.domain,
            size,
            problem.pair_boundaries,
            ratio,
            0.3 * size / sizes[0],
            mesher=mesher,
        )
        for size in sizes[:levels]
    ]
    meshed = processor_time() - begin
    grids = am.Hierarchy.from_meshes(problem, meshes)
    result, seconds = timed(grids, am.FullMultigrid())
    return {
        "nodes": grids.finest.n_nodes,
        "smallest_angle": min(quality(mesh).min_angle for mesh in meshes),
        "size_ratio": max(starmap(am.transfer.mesh_ratio, pairwise(meshes))),
        "cycles": result.cycles,
        "work": result.work_units,
        "energy_error": 100 * energy_error(reference(case, levels), result).relative,
        "mesh_s": meshed,
        "solution_s": seconds,
    }


def study(out: Output) -> None:
    """Compute every transfer, every ratio, and the meshes of both meshers."""
    points = [
        {"dim": dim, "levels": levels, "transfer": name}
        for dim, levels in ([(2, 4)] if out.quick else [(2, 6 if out.full else 5), (3, 3)])
        for name in TRANSFERS
    ]
    table = am.Study(run, points, out.store, name="transfers").run(throw=True)
    columns = [
        "dim",
        "nodes",
        "transfer",
        "build_ms",
        "entries",
        "affine_error",
        "default_cycles",
        "default_work",
        "default_outcome",
        "monotone_cycles",
        "monotone_work",
        "monotone_outcome",
    ]
    refused = (table["monotone_outcome"] == "REFUSED").any()
    out.table(
        "transfers",
        table[columns],
        "Transfers between independent meshes: cost, and cycles and work with them",
        "Build: processor time of all prolongations. Entries: of a row. Affine error: of the largest coordinate."
        + " REFUSED: a weight between contact nodes is negative, which the monotone correction does not accept."
        * bool(refused),
        units={"build_ms": "ms", "default_work": "WU", "monotone_work": "WU"},
        formats={
            "build_ms": ".1f",
            "entries": ".2f",
            "affine_error": ".0e",
            "default_cycles": ".0f",
            "monotone_cycles": ".0f",
            "default_work": ".0f",
            "monotone_work": ".0f",
        },
    )
    apart = {"where": ["everywhere", "at contact"], "ratio": [2, 4] if out.quick else [2, 3, 4, 6]}
    ratios = am.Study(two_grids, apart, out.store, name="ratios").run(throw=True)
    ratios = ratios[
        [
            "where",
            "ratio",
            "coarse_nodes",
            "nodes",
            "cycles",
            "rate",
            "monotone_cycles",
            "monotone_rate",
        ]
    ]
    out.table(
        "ratios",
        ratios,
        "Two grids: the ratio of their mesh sizes, interpolation, from zero",
        "Rate: of the last cycles. From zero most cycles of the default find the contact zones, at no rate.",
        formats={"rate": ".2f", "monotone_rate": ".2f"},
    )
    figure, ax = drawing()
    for (where, rows), mark in zip(ratios.groupby("where", sort=False), "os", strict=True):
        ax.plot(rows["ratio"], rows["rate"], f"{mark}-", label=f"{where}, default")
        ax.plot(rows["ratio"], rows["monotone_rate"], f"{mark}:", label=f"{where}, monotone")
    ax.set(
        xlabel="coarse size over fine size",
        ylabel="rate of the last cycles",
        ylim=(0, 1),
        xticks=ratios["ratio"].unique(),
    )
    figure.legend(loc="outside right upper")
    out.figure(
        "ratios", figure, "Convergence rate of two grids against the ratio of their mesh sizes"
    )
    both = am.Study(
        mesher,
        {"case": list(MESHED), "mesher": ["own", "netgen"]},
        out.store,
        name="meshers",
        fixed={"levels": 3 if out.quick else 4},
    ).run(throw=True)
    out.table(
        "meshers",
        both[
            [
                "case",
                "mesher",
                "nodes",
                "smallest_angle",
                "size_ratio",
                "cycles",
                "work",
                "energy_error",
                "mesh_s",
                "solution_s",
            ]
        ],
        "Hierarchies of NGSolve's locally refined meshes next to the package's own",
        "Size ratio: largest local "
        "one of neighbouring levels. Energy error: against a reference on meshes four times finer or more.",
        units={"work": "WU", "energy_error": "%", "smallest_angle": "°"},
        formats={
            "smallest_angle": ".1f",
            "size_ratio": ".1f",
            "work": ".0f",
            "energy_error": ".2f",
            "mesh_s": ".3f",
            "solution_s": ".3f",
        },
    )
    plane = table[(table["dim"] == 2) & (table["transfer"] == "Interpolation")]
    out.check(
        "cycles of the default method with interpolation, 2D",
        float(plane["default_cycles"].iloc[0]),
        high=12,
    )


if __name__ == "__main__":
    main(study)
