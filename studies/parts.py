"""What does each part of the truncated multigrid step buy?

    python studies/parts.py [--quick | --full] [--out DIR]

Twelve hard cases (slender cantilevers, blocks of unlike stiffness, large friction, two bodies, 3D)
and random bodies on a floor: polygons of 4 to 9 corners, stretched up to three times, on three
independent meshes. Every second one stands on springs and is pressed at an angle, with friction up
to 1.2; the others are held by contact and friction alone. Each is solved to a relative
energy error of 1e-6, from the nested start and from zero, by the default and by variants of it that
leave out one part or exchange it. A run that another method took over, or that did not converge, is
counted apart, with the cycles that it took. Seconds are processor seconds of all solves, set-up
included."""

import time
import warnings
from functools import lru_cache

import numpy as np
import pandas as pd
from common import Output, main
from flexible import bar, blocks, cantilever

import adaptmg as am

VARIANTS = {
    "default": am.Truncated(),
    "no coarse contact problems": am.Truncated(coarse_contact=False),
    "no rigid motions": am.Truncated(rigid_motions=False),
    "no search": am.Truncated(search=False),
    "no interface sweeps": am.Truncated(interface_sweeps=0),
    "two symmetric sweeps": am.Truncated(smooth=2),
    "over-relaxed sweeps, 1.3": am.Truncated(
        smooth=am.ProjectedGaussSeidel(omega=1.3, order="symmetric")
    ),
    "no past iterates": am.Truncated(recombine=0),
    "two past iterates": am.Truncated(recombine=2),
    "V(1,1)": am.Truncated(correct=am.Cycle(pre=1, post=1)),
    "V(2,2)": am.Truncated(correct=am.Cycle(pre=2, post=2)),
    "W(1,1)": am.Truncated(correct=am.Cycle(shape="W", pre=1, post=1)),
    "F(1,1)": am.Truncated(correct=am.Cycle(shape="F", pre=1, post=1)),
    "V-cycle of pyamg": am.Truncated(correct=am.PyAMG()),
}
HARD = {
    "bar": lambda: bar(1.0, 4),
    "bar, friction 3": lambda: bar(3.0, 4),
    "bar, graded": lambda: am.Hierarchy.graded(am.cases.greco_bar()),
    "curved obstacle": lambda: am.Hierarchy.uniform(am.cases.curved_obstacle(), (4, 8, 16, 32)),
    "upset block": lambda: am.Hierarchy.graded(am.cases.upset_block()),
    "cantilever 24 : 1": lambda: cantilever(24, 3),
    "cantilever 96 : 1": lambda: cantilever(96, 3),
    "blocks, upper 30 times stiffer": lambda: blocks(30, 3),
    "blocks, upper 1000 times stiffer": lambda: blocks(1000, 3),
    "dovetail": lambda: am.Hierarchy.graded(am.cases.dovetail()),
    "bolted junction": lambda: am.Hierarchy.graded(am.cases.bolted_junction()),
    "block, 3D": lambda: am.Hierarchy.uniform(am.cases.greco_block(), (2, 4, 8)),
}


def random_body(seed: int) -> am.Hierarchy:
    """A polygon on a floor."""
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0.1, np.pi - 0.1, rng.integers(2, 8)))
    stretch = rng.uniform(1.0, 3.0)
    crown = 0.02 * np.column_stack([stretch * np.cos(angles), np.sin(angles)])
    foot = 0.02 * stretch * np.array([[-1.0, 0.0], [1.0, 0.0]])
    vertices = tuple((float(x), float(y)) for x, y in np.vstack([foot, crown]))
    names = ["foot"] + ["side"] * (len(vertices) - 1)
    names[1 + int(rng.integers(len(crown) + 1))] = "loaded"
    weight = am.BodyForce((rng.uniform(-0.2, 0.2) * 1e9, -1e9))
    press = am.Pressure("loaded", 10 ** rng.uniform(6, 8))
    floats = seed % 2 == 0
    friction = rng.uniform(0.5, 1.0) if floats else rng.uniform(0.0, 1.2)
    problem = am.ContactProblem(
        domain=am.Polygon(vertices=vertices, boundaries=tuple(names)),
        material=am.PlaneStrain(young=10 ** rng.uniform(9, 11.5), poisson=rng.uniform(0, 0.4)),
        law=am.Coulomb(friction),
        contact=am.Contact("foot", am.GapFunction(lambda x: 1e-7 * (x[:, 0] / 0.02) ** 2)),
        loads=(weight,) if floats else (weight, press),
        supports=() if floats else (am.Spring("side", normal=1e10, tangential=1e10),),
        name=f"random body {seed}",
    )
    return am.Hierarchy.graded(problem, (8e-3, 4e-3, 2e-3), contact_ratio=3)


@lru_cache(maxsize=4)
def grids(case: str) -> am.Hierarchy:
    """The grids of a case by its name, or of a random body by its number, with what all variants
    share."""
    hierarchy = random_body(int(case)) if case.isdigit() else HARD[case]()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        am.solve(hierarchy, am.FullMultigrid(rtol=0.1), throw=False)
    return hierarchy


def run(case: str, variant: str) -> dict:
    """Cycles from the nested start and from zero."""
    correction = VARIANTS[variant]
    row: dict = {"nodes": grids(case).finest.n_nodes, "handed_over": 0}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        begin = time.process_time()
        for start, method in {"nested": am.FullMultigrid, "zero": am.Multigrid}.items():
            solver = method(correction=correction, rtol=1e-6)
            result = am.solve(grids(case), solver, throw=False)
            row[start] = result.cycles
            row["handed_over"] += bool(result.fallback) or not result.status.ok
    return row | {"spent": time.process_time() - begin}


def study(out: Output) -> None:
    """Sum the cycles of each variant over the hard cases and over the random ones."""
    n_random = 2 if out.quick else 40 if out.full else 16
    random = [str(seed) for seed in range(n_random)]
    hard = list(HARD)[: 3 if out.quick else None]
    points = [
        {"case": case, "variant": variant} for case in [*hard, *random] for variant in VARIANTS
    ]
    table = am.Study(run, points, out.store).run(throw=True)
    table["kind"] = np.where(table["case"].isin(hard), "hard", "random")
    rows = table.pivot_table(
        index="variant",
        columns="kind",
        values=["nested", "zero", "handed_over", "spent"],
        aggfunc="sum",
        sort=False,
    ).loc[list(VARIANTS)]
    rows.columns = pd.Index([f"{what}, {kind}".replace("_", " ") for what, kind in rows.columns])
    out.table(
        "parts",
        rows.reset_index(),
        f"Cycles to a relative energy error of 1e-6, sums over {len(hard)} hard cases and "
        f"{len(random)} random bodies",
        "From the nested start and from zero; solves that another method took over or that did not "
        "converge; processor seconds of all solves.",
        units={name: "s" for name in rows.columns if name.startswith("spent")},
        formats={name: ".2f" for name in rows.columns if name.startswith("spent")},
    )
    of_hard = table[table["kind"] == "hard"].pivot(index="variant", columns="case", values="nested")
    out.table(
        "hard",
        of_hard.loc[list(VARIANTS), hard].T.reset_index(),
        "The hard cases: cycles from the nested start",
        "Cycles of a method that took over included.",
    )
    cycles = (rows["nested, hard"] + rows["zero, hard"]) / (
        rows["nested, hard"] + rows["zero, hard"]
    )["default"]
    out.check(
        "cycles without past iterates over those of the default, hard cases",
        float(cycles["no past iterates"]),
        low=1.3,
    )


if __name__ == "__main__":
    main(study)
