"""Is what adaptive loops say of their steps true? Random problems through :func:`adaptmg.adapt`,
every engine.

    python tests/campaigns/random_loops.py [--first SEED] [--count N] [--out DIR]

Blocks and pairs, re-entrant corners, arcs, stacks of several pairs, friction that varies in space,
and the cases of the package; every marking and indicator, and goals. Of every step: the status, the
certificate, the mesh, the algebraic error and the estimate against those of the exact discrete
solution by another method; of the loop: its end, the estimate against the error to a finer mesh,
and that it goes on from its store with the same bits after it was broken off at a random step."""

from __future__ import annotations

import math
import tempfile
import warnings
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
from campaign import main
from random_problems import random_problem

import adaptmg as am

MM = 1e-3
#: algebraic error over estimate; estimate in the loop over the exact one, less 1
SHARE, MISSED = 0.2, 0.15


@dataclass(frozen=True)
class Fading:
    """A friction coefficient that falls along x; a class, so that problems can be pickled."""

    most: float
    length: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        return self.most * (0.5 + 0.5 * np.cos(np.pi * points[:, 0] / self.length))


def _law(rng: np.random.Generator, length: float) -> Any:
    friction = float(rng.choice([0.1, 0.3, 0.7, 1.0, 1.5]))
    plain = am.Coulomb(friction)
    return [
        plain,
        plain,
        am.Frictionless(),
        am.Tresca(float(10 ** rng.uniform(6.5, 7.7))),
        am.Coulomb(Fading(friction, length)),
    ][rng.integers(5)]


def _material(rng: np.random.Generator, kind: Any = am.PlaneStrain) -> Any:
    return kind(young=float(10 ** rng.uniform(10, 11.5)), poisson=float(rng.uniform(0.1, 0.4)))


def _notched(rng: np.random.Generator) -> am.ContactProblem:
    """An L, or a foot with two re-entrant corners, pressed on a plane."""
    a = 40 * MM
    neck, foot = a * float(rng.uniform(0.3, 0.7)), a * float(rng.uniform(0.2, 0.6))
    if rng.random() < 0.5:
        corners = [(0, 0), (a, 0), (a, foot), (neck, foot), (neck, a), (0, a)]
        names = ("bottom", "side", "ledge", "flank", "top", "symmetry")
    else:
        left = 0.5 * (a - neck)
        corners = [
            (0, 0),
            (a, 0),
            (a, foot),
            (left + neck, foot),
            (left + neck, a),
            (left, a),
            (left, foot),
            (0, foot),
        ]
        names = ("bottom", "side", "ledge", "flank", "top", "flank2", "ledge2", "symmetry")
    shape = am.Polygon(vertices=corners, boundaries=names)
    push = float(rng.uniform(-0.3, 0.6))
    pressure = float(rng.uniform(1e7, 1e8))
    kind = am.PlaneStress if rng.random() < 0.3 else am.PlaneStrain
    return am.ContactProblem(
        name="notched",
        domain=shape,
        material=_material(rng, kind),
        law=_law(rng, a),
        contact=am.Contact("bottom", am.Plane((0, -float(rng.choice([0, 0, 1e-6, 1e-5]))), (0, 1))),
        loads=(am.Traction("top", (push * pressure, -pressure)),),
        supports=(am.Support("symmetry", x=0.0),),
    )


def _round(rng: np.random.Generator) -> am.ContactProblem:
    """Half a disc on end (axisymmetric: a dome) pressed on a plane or on a block."""
    radius = 50 * MM
    axisymmetric = bool(rng.random() < 0.3)
    kind = am.Axisymmetric if axisymmetric else am.PlaneStrain
    edge = (radius * math.sin(math.radians(70)), radius * (1 - math.cos(math.radians(70))))
    quarter = am.Outline(
        vertices=((0, 0), edge, (edge[0], radius), (0, radius)),
        boundaries=("round", "side", "top", "axis"),
        arcs={0: (0.0, radius)},
    )
    down = float(10 ** rng.uniform(-5, -3.6))
    law = _law(rng, radius)
    if rng.random() < 0.4:
        return am.ContactProblem(
            name="disc",
            domain=quarter,
            material=_material(rng, kind),
            law=law,
            contact=am.Contact("round", am.Plane((0, 0), (0, 1))),
            supports=(am.Support("axis", x=0.0), am.Support("top", y=-down)),
        )
    # not touching at the point: the closest points of an arc are found to 1e-12 m or so, and
    # overlap is refused
    lower = am.Rectangle(width=radius, height=0.6 * radius, origin=(0.0, -0.6 * radius - 1e-9))
    return am.ContactProblem(
        name="disc on a block",
        domain=am.Assembly(parts={"upper": quarter, "lower": lower}),
        law=law,
        material={name: _material(rng, kind) for name in ("upper", "lower")},
        contact=am.ContactPair("upper.round", "lower.top"),
        supports=(
            am.Support("upper.axis", x=0.0),
            am.Support("upper.top", y=-down),
            am.Support("lower.left", x=0.0),
            am.Support("lower.bottom", y=0.0),
        ),
    )


def _stack(rng: np.random.Generator) -> am.ContactProblem:
    """Three blocks on each other: two pairs in a chain; the lowest fixed, or on a rigid plane."""
    sides = [40 * MM, 55 * MM, 70 * MM]
    parts, y = {}, 0.0
    for name, side in zip(("top", "middle", "base"), sides, strict=True):
        height = side * float(rng.uniform(0.3, 0.6))
        y -= height
        parts[name] = am.Rectangle(width=side, height=height, origin=(0.0, y))
    pairs = []
    for upper, lower in (("top", "middle"), ("middle", "base")):
        pair = (f"{upper}.bottom", f"{lower}.top")
        # a surface that is covered in part may be the slave too
        pairs.append(am.ContactPair(*pair[:: 1 if rng.random() < 0.7 else -1]))
    held: tuple[Any, ...] = (am.Support("base.bottom", x=0.0, y=0.0),)
    if rng.random() < 0.4:
        pairs.append(am.Contact("base.bottom", am.Plane((0.0, y), (0.0, 1.0))))
        held = ()
    pressure = float(rng.uniform(1e7, 1e8))
    return am.ContactProblem(
        name="stack",
        domain=am.Assembly(parts=parts),
        material={name: _material(rng) for name in parts},
        contact=tuple(pairs),
        law=_law(rng, sides[2]),
        loads=(
            am.Traction("top.top", (float(rng.uniform(-0.2, 0.2)) * pressure, -pressure)),
            am.BodyForce((0.0, -7.8e4), body="middle"),
        ),
        supports=(*(am.Support(f"{name}.left", x=0.0) for name in parts), *held),
    )


def _case(rng: np.random.Generator) -> am.ContactProblem:
    """A case of the package: pairs in a chain, round faces in space, preload, and a wide gap."""
    cases = (
        am.cases.dovetail,
        am.cases.bolted_junction,
        am.cases.hertz_cylinder,
        am.cases.curved_obstacle,
        am.cases.upset_block,
        am.cases.greco_block,
    )
    return cases[rng.integers(len(cases))]()


def _block(rng: np.random.Generator) -> am.ContactProblem:
    """As in the campaign of true errors."""
    return random_problem(int(rng.integers(10**6))).problem


MAKERS = (_block, _notched, _round, _stack, _case)


def random_loop(seed: int) -> tuple[am.ContactProblem, dict[str, Any]]:
    """A random problem, and random options of :func:`adaptmg.adapt`."""
    rng = np.random.default_rng((seed, 11))
    problem = MAKERS[seed % len(MAKERS)](rng)
    parts = (
        problem.domain.parts.values()
        if isinstance(problem.domain, am.Assembly)
        else (problem.domain,)
    )
    start = min(float((part.upper - part.lower).min()) for part in parts) / float(rng.uniform(1, 3))
    slave = problem.contact_boundaries[int(rng.integers(len(problem.contact_boundaries)))]
    goals = (am.ContactForce(slave, "normal"), am.Opening(slave), am.MeanDisplacement(slave, "x"))
    indicators = [am.Residual(), am.Recovery(), am.Goal(goals[rng.integers(3)])]
    marks = [am.Doerfler(float(rng.uniform(0.2, 0.9))), am.Maximum(float(rng.uniform(0.1, 0.7)))]
    engines = [am.Remesh(), am.Remesh(growth=float(rng.uniform(1.6, 4))), am.Bisect()]
    return problem, {
        "start": start,
        "indicator": indicators[rng.integers(3)],
        "mark": marks[rng.integers(2)],
        "engine": engines[rng.integers(3)],
        "max_nodes": int(rng.integers(1200, 3500)),
    }


def mesh_faults(mesh: am.MeshArrays, first: am.MeshArrays, curved: bool) -> list[str]:
    """What is wrong with a mesh: soundness, names, size of bodies without arcs."""
    faults = []
    try:
        am.mesh.check_mesh(replace(mesh))
    except ValueError as error:
        faults.append(str(error))
    if set(mesh.boundaries) != set(first.boundaries) or mesh.bodies != first.bodies:
        faults.append("names of boundaries or bodies differ")
    sizes = [np.bincount(m.element_body, m.volumes, len(first.bodies)) for m in (first, mesh)]
    if not curved and not np.allclose(*sizes, rtol=1e-12):
        faults.append(f"bodies have the sizes {sizes[1]}, not {sizes[0]}")
    return faults


def step_faults(
    step: am.Step, first: am.MeshArrays, indicator: Any, curved: bool, row: dict[str, Any]
) -> list[str]:
    """What is wrong with a step, and its largest figures."""
    faults = mesh_faults(step.hierarchy.finest.mesh, first, curved)
    if not step.result.status.ok:
        faults.append(f"status {step.result.status.name}")
    faults += [
        f"certificate contradicts {name}"
        for name in step.result.certificate().contradictions(step.result.rtol)
    ]
    exact = am.solve(
        step.hierarchy, am.ActiveSet(rtol=1e-11, max_steps=40), start=step.result, throw=False
    )
    discrete = step.hierarchy.finest.discrete
    error, whole = (
        discrete.relative(u).reshape(-1)
        for u in (exact.displacement - step.result.displacement, exact.displacement)
    )
    share = math.sqrt(
        max(error @ (discrete.matrix @ error), 0.0) / (whole @ (discrete.matrix @ whole))
    )
    share /= max(getattr(step.estimate, "discretisation", step.estimate.relative), 1e-300)
    row["share"], row["cycles"] = max(row["share"], share), max(row["cycles"], step.result.cycles)
    if not isinstance(indicator, am.Goal):
        if step.number and share > SHARE:
            faults.append(f"the solver leaves {share:.2g} of the estimate")
        missed = step.estimate.total / (indicator.indicate(step.hierarchy, exact).total or 1.0)
        if not abs(missed - 1) <= MISSED:
            faults.append(f"estimate {missed:.3f} of that of the discrete solution")
    return [f"step {step.number}: {fault}" for fault in faults]


def bits(step: am.Step) -> bytes:
    """What a step computed."""
    mesh = step.hierarchy.finest.mesh
    parts = step.result.displacement, step.estimate.squares, mesh.points, mesh.elements
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)


def measure(seed: int) -> dict[str, Any]:
    """One loop and all that is checked of it."""
    row: dict[str, Any] = {
        "faults": "",
        "share": 0.0,
        "cycles": 0,
        "nodes": np.nan,
        "effectivity": np.nan,
    }
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
        warnings.simplefilter(
            "ignore"
        )  # solutions that may not be unique, contact that cannot meet
        try:
            problem, options = random_loop(seed)
            row |= {
                "problem": problem.name,
                "indicator": type(options["indicator"]).__name__,
                "engine": type(options["engine"]).__name__,
            }
            steps = list(am.adapt(problem, **options))
        except (ValueError, am.NotConverged) as error:
            return row | {"why": f"{type(error).__name__}: {str(error)[:200]}"}
        parts = (
            problem.domain.parts.values()
            if isinstance(problem.domain, am.Assembly)
            else (problem.domain,)
        )
        curved = any(isinstance(part, am.Outline | am.Revolution) for part in parts)
        first, last, faults = steps[0].hierarchy.finest.mesh, steps[-1], []
        for step in steps:
            faults += step_faults(step, first, options["indicator"], curved, row)
        if any(a.nodes >= b.nodes or a.outcome for a, b in pairwise(steps)) or not last.outcome:
            faults.append("meshes do not grow, or an outcome that is not at the end")
        broken = am.adapt(problem, **options, store=folder)
        for _ in range(int(np.random.default_rng((seed, 12)).integers(1, len(steps) + 1))):
            next(broken)
        broken.close()
        if list(map(bits, am.adapt(problem, **options, store=folder))) != list(map(bits, steps)):
            faults.append("gone on from its store the loop has other bits")
        if not isinstance(options["indicator"], am.Goal):
            *_, fine = am.adapt(
                problem,
                last.hierarchy,
                engine=am.Bisect(),
                mark=am.Doerfler(0.8),
                max_nodes=(8 if problem.dim == 2 else 5) * last.nodes,
            )
            exact = am.solve(
                fine.hierarchy, am.Multigrid(rtol=1e-9), start=fine.result, throw=False
            )
            row["effectivity"] = (
                last.estimate.total
                / am.estimate.energy_error(
                    am.estimate.Reference.of(fine.hierarchy, exact), last.result
                ).absolute
            )
    return row | {"steps": len(steps), "nodes": last.nodes, "faults": "; ".join(faults)}


def summary(rows: pd.DataFrame) -> pd.DataFrame:
    """Counts and ranges by indicator; effectivities of 1.9 to 3.6 are usual for Residual, of .6 to
    1.1 for Recovery."""
    return (
        rows.assign(refused=rows["nodes"].isna(), faulty=rows["faults"] != "")
        .groupby("indicator")
        .agg(
            loops=("seed", "size"),
            refused=("refused", "sum"),
            faulty=("faulty", "sum"),
            least=("effectivity", "min"),
            median=("effectivity", "median"),
            largest=("effectivity", "max"),
            share=("share", "max"),
            cycles=("cycles", "max"),
        )
        .reset_index()
    )


if __name__ == "__main__":
    main(measure, summary, range(1000, 1140))
