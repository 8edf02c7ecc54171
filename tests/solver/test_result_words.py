"""Every public object describes itself in 400 characters, without arrays; tables name their units."""

from __future__ import annotations

import inspect
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import adaptmg as am

MOST = 400


@cache
def solved() -> tuple[am.Hierarchy, am.Result]:
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4, 8, 16))
    return grids, am.solve(grids)


@cache
def along() -> am.PathResult:
    return am.solve_path(solved()[0].truncated(finest=2), am.LoadPath({"left": np.linspace(0.1, 1, 6), "top": 1.0}))


@cache
def adapted() -> tuple[am.Step, ...]:
    grids = am.Hierarchy.uniform(am.cases.upset_block(), divisions=(4,))
    return tuple(am.adapt(grids.problem, grids, engine=am.Bisect(), max_nodes=60))


def ring(n: int) -> list[tuple[float, float]]:
    angles = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return [(float(np.cos(a)), float(np.sin(a))) for a in angles]


def rows(n: int) -> dict[str, int]:
    return {"m": n}


def examples(folder: Path) -> list[object]:
    grids, result = solved()
    steel = am.PlaneStrain(young=2e11, poisson=0.3)
    big = am.Polygon(vertices=ring(300), boundaries=[f"edge {k}" for k in range(300)])
    many = am.Assembly(parts={f"body {k}": am.Rectangle(width=1.0, height=1.0, origin=(2.0 * k, 0.0))
                              for k in range(60)})
    points = np.random.default_rng(0).random((500, 2))
    with pytest.raises(am.NotConverged) as caught:
        am.solve(grids, am.SingleGrid(max_sweeps=2))
    box = am.Box(width=1.0, depth=1.0, height=1.0)
    ball = am.Ball((0.0, 0.0, 0.0), 1.0)
    study = am.Study(rows, {"n": list(range(1, 200))}, folder / "s.sqlite")
    n = 30
    estimate = am.GoalEstimate(squares=np.ones(9), norm=1.0, indicator="goal", value=1.0, signed=0.1, energy_error=0.1,
                               names=tuple(f"u_y at {k}" for k in range(n)), units=("m",) * n, values=np.ones(n),
                               errors=np.ones(n), algebraic=np.ones(n), discretisation=0.1, residuals=np.ones(n))
    goal = am.Displacement(points=points, component="y")
    return [
        grids, result, result.contact, result.certificate(), grids.finest, grids[0], grids.finest.mesh,
        grids.finest.discrete, grids.finest.discrete.contact, grids.finest.discrete.law, grids.problem, along(),
        *adapted(), adapted()[-1].estimate, caught.value, big, many, study, study.status(), goal, estimate, am.Goal(goal), box, ball,
        am.ContactProblem(material=steel, domain=many, law=am.Coulomb(0.3), supports=[
            am.Support(f"body {k}.left", x=0.0, y=0.0) for k in range(60)], contact=[
            am.ContactPair(f"body {k}.right", f"body {k + 1}.left") for k in range(59)]),
        am.Tresca(np.full(1000, 1e5)), am.Coulomb(lambda x: x[:, 0]), am.Frictionless(),
        am.LoadPath({"left": np.linspace(0, 1, 1000)}), am.LoadPath({"left": [0.0, 1.0]}),
        am.SizeNear(points, size=1e-3, radius=1e-2), am.Extrusion(big, 1.0),
        am.Outline(vertices=ring(200), boundaries=["rim"] * 200), am.Rectangle(width=1.0, height=1.0),
        am.Cut(box, am.Moved(ball, offset=(1.0, 0.0, 0.0))), am.Fuse(box, ball), am.Common(box, ball),
        am.Cylinder((0, 0, 0), (0, 0, 1), 1.0, 2.0), am.Plane((0, 0), (0, 1)),
        am.FullMultigrid(), am.FullMultigrid(smoother=am.ProjectedGaussSeidel(omega=1.2), max_cycles=7,
                                             cycle=am.Cycle(pre=3), correction=am.Monotone()), am.Multigrid(), am.SingleGrid(),
        am.ActiveSet(linear=am.AMG()), am.ActiveSet(linear=am.Direct()), am.Truncated(), am.Monotone(),
        am.PaperCorrection(), am.CoarseSolve(), am.NestedStart(), am.Doerfler(), am.Maximum(), am.Remesh(), am.Bisect(),
        am.Recovery(), am.Residual(), am.Interpolation(), am.PseudoL2(), am.L2(), am.LumpedL2(),
        am.QuasiInterpolation(), am.Pressure("left", 1.0), am.Traction("left", (1.0, 0.0)),
        am.BodyForce((0.0, 1.0)), am.InitialStrain("body", (1e-3, 1e-3, 1e-3)), am.Support("left", x=0.0),
        am.Contact("bottom", am.Plane((0, 0), (0, 1))), am.GapFunction(lambda x: x[:, 0]), steel,
        am.PlaneStress(young=1.0, poisson=0.3), am.Axisymmetric(young=1.0, poisson=0.3),
        am.Solid(young=1.0, poisson=0.3), am.ContactForce("bottom", "y"), am.MeanDisplacement("left", "x"),
        am.Opening("bottom", (0.0, 0.0)), am.Status.CONVERGED]
