"""Small solves that between them call every compiled kernel: ``adaptmg warm``."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import adaptmg as am

PLANE = am.cases.greco_bar()
SOLID = am.cases.greco_block()
PAIR = am.cases.two_block_patch()


def _solve_graded(problem: am.ContactProblem, *methods: Any, size: float = 0.25) -> None:
    """Solve a problem on three graded meshes; the elements of the coarsest one are this part of the
    largest body's length."""
    parts = getattr(problem.domain, "parts", {"": problem.domain}).values()
    extent = max(float(max(part.upper - part.lower)) for part in parts)
    sizes = [size * extent * 0.6**level for level in range(3)]
    grids = am.Hierarchy.graded(problem, sizes)
    for method in methods or (am.FullMultigrid(),):
        am.solve(grids, method, throw=False)


def _methods(problem: am.ContactProblem, size: float) -> None:
    """Solve a problem by every method, on meshes of :func:`_solve_graded`."""
    monotone = am.FullMultigrid(correction=am.Monotone())
    paper = am.FullMultigrid(correction=am.PaperCorrection(), max_cycles=3)
    methods = (am.FullMultigrid(), monotone, paper, am.SingleGrid(max_sweeps=20))
    sparse = am.ActiveSet(condensed=False, max_steps=1)
    _solve_graded(problem, *methods, am.ActiveSet(), sparse, size=size)


def _transfers() -> None:
    """Build every transfer in the plane and in space."""
    for transfer in (am.L2(), am.LumpedL2(), am.PseudoL2(), am.QuasiInterpolation()):
        for problem, size in ((PLANE, 0.01), (SOLID, 0.02)):
            am.Hierarchy.graded(problem, (size, 0.6 * size), transfer=transfer)


def _adapted(problem: am.ContactProblem, nodes: int) -> None:
    """Solve a problem on adapted meshes of at most this number of nodes, by both engines."""
    for engine in (am.Bisect(), am.Remesh()):
        list(am.adapt(problem, max_nodes=nodes, engine=engine, indicator=am.Residual()))


def _spaces() -> None:
    """Solve a problem on coarse spaces that are made from its matrix."""
    discrete = am.Hierarchy.uniform(PLANE, (8,)).finest.discrete
    am.solve(am.Hierarchy.algebraic(discrete, max_coarse=60), am.Multigrid())


def _pictures() -> None:
    """Draw a picture of a solid."""
    grids = am.Hierarchy.uniform(SOLID, (2, 4))
    with tempfile.TemporaryFile() as file:
        am.plot.deformation(am.solve(grids)).savefig(file)


#: the solves by their names on the bar: 5 s of one processor where all kernels are compiled, 14 s with all Newton steps
#: of the active set method without condensation
STEPS: Mapping[str, Callable[[], object]] = {
    "plane bodies, every method": lambda: _methods(PLANE, size=0.25),
    "solids, every method": lambda: _methods(SOLID, size=0.4),
    "two bodies": lambda: _solve_graded(PAIR),
    "two solids": lambda: _solve_graded(am.cases.two_block_patch(dim=3)),
    "axisymmetric bodies": lambda: _solve_graded(am.cases.hertz_sphere(), size=0.1),
    "smoothed elements": lambda: _solve_graded(replace(PLANE, elements="smoothed")),
    "smoothed elements of solids": lambda: _solve_graded(replace(SOLID, elements="smoothed")),
    "nearly incompressible bodies": lambda: _solve_graded(
        replace(am.cases.greco_bar(poisson=0.49), elements="smoothed")
    ),
    "a large lattice": lambda: am.discrete.stiffness(
        am.mesh.structured(PLANE.domain, 64), PLANE.material
    ),
    "transfers": _transfers,
    "adaptive loop": lambda: _adapted(am.cases.upset_block(), 400),
    "adaptive loop of solids": lambda: _adapted(SOLID, 400),
    "load path": lambda: am.solve_path(
        am.Hierarchy.uniform(PLANE, (4, 8)), am.LoadPath({"left": [0.5, 1.0]})
    ),
    "coarse spaces of a matrix": _spaces,
    "pictures of solids": _pictures,
}


def solve_step(name: str) -> None:
    """Solve one of these."""
    STEPS[name]()
