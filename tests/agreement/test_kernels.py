"""Kernels as plain Python: results do not depend on the compiler, and reads outside of arrays,
silent there, raise."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from bisected_meshes import SQUARE, crooked, cube, random_mask
from bodies import LOWER_ON_UPPER, bar_on_block
from simplex_meshes import disk, structured
from smoother_problems import network
from two_materials import KINDS, MESHES
from uncompiled import uncompile

import adaptmg as am
from adaptmg.mesh.improve import halved, improved
from adaptmg.smoother.conditions import natural_residual

HOLED = am.Cut(am.Circle((0, 0), 1, "outer"), am.Circle((0.45, 0), 0.54, "inner"))
TRANSFERS = (am.Interpolation(), am.L2(), am.PseudoL2(), am.LumpedL2(), am.QuasiInterpolation())


def solved(problem, divisions, *solvers):
    """What a few cycles find, and what the certificate says of it."""
    grids = am.Hierarchy.uniform(problem, divisions)
    for solver in solvers or (am.FullMultigrid(max_cycles=3),):
        result = am.solve(grids, solver, throw=False)
        yield from (result.displacement, result.contact.force)
        yield np.maximum([result.residual, result.checked.energy_error], 1e-9)


def one_body(dim):
    case = am.cases.greco_bar() if dim == 2 else am.cases.greco_block()
    return solved(
        case,
        (2, 4, 8) if dim == 2 else (1, 2, 4),
        am.Multigrid(max_cycles=3),
        am.FullMultigrid(correction=am.Monotone(), max_cycles=2),
    )


def pair(dim):
    if dim == 2:
        return solved(
            bar_on_block(am.Coulomb(0.3), LOWER_ON_UPPER),
            [{"upper": k, "lower": (k + 1, k)} for k in (2, 4)],
        )
    return solved(
        am.cases.two_block_patch(law=am.Coulomb(0.3), dim=3),
        [{"upper": k, "lower": (2, k, 1)} for k in (1, 2)],
        am.FullMultigrid(max_cycles=1),
    )


def rubber():
    return solved(
        replace(
            am.cases.greco_bar(),
            material=am.PlaneStrain(young=1e6, poisson=0.45),
            elements="smoothed",
        ),
        (2, 4),
    )


def smoothed(dim, law):
    problem = network(dim, law, seed=9)
    w = np.random.default_rng(9).normal(size=problem.system.n_dofs) * ~problem.system.fixed
    am.ProjectedGaussSeidel(omega=1.2, order="symmetric").smooth(
        problem.system, problem.contact, problem.load, w, 4
    )
    return w, natural_residual(problem, w, problem.residual(w))


def bisected(mesh):
    for k, passes in enumerate((None, 1, 2)):
        mesh, _ = am.mesh.bisect(mesh, random_mask(mesh, 0.2, k), passes)
    return mesh.points, mesh.elements, mesh.facets, mesh.facet_labels, mesh.element_body


def meshed():
    square = am.Rectangle(width=1, height=1)
    yield from (
        am.mesh.graded(domain, 0.4, domain.boundaries[0], 4).points for domain in (square, HOLED)
    )
    yield am.mesh.sized(square, am.mesh.SizeNear([(0.4, 0.4)], size=0.05), 0.3).points
    mesh = am.mesh.graded(am.Box(width=0.3, depth=0.2, height=0.1), 0.07)
    yield from (improved(mesh, 2).points, halved(mesh).elements, improved(halved(mesh), 1).points)


def transferred():
    for dim in (2, 3):
        coarse, fine = structured(1, dim), structured(2, dim, 1.3)
        yield from (kind.build(coarse, fine).toarray() for kind in TRANSFERS)
        yield am.transfer.surface_interpolation(
            coarse, fine, coarse.facets, np.unique(fine.facets)
        ).toarray()
    yield am.PseudoL2().build(disk(1), disk(2)).toarray()


def stiff(kind):
    mesh = crooked(SQUARE if kind.dim == 2 else cube(2))
    return [
        am.discretise(
            am.ContactProblem(
                material=kind(young=1e9, poisson=0.3),
                law=am.Frictionless(),
                contact=am.Contact("bottom", am.GapFunction(lambda x: 0 * x[:, 0])),
            ),
            mesh,
        ).matrix.toarray(),
        am.discrete.stiffness(
            MESHES[kind.dim],
            {"left": kind(young=2e9, poisson=0.36), "right": kind(young=1e9, poisson=-0.2)},
            "smoothed",
        ).toarray(),
    ]


CASES = {
    "one body": lambda: one_body(2),
    "rubber": rubber,
    "solid": lambda: one_body(3),
    "pair": lambda: pair(2),
    "solid pair": lambda: pair(3),
    "meshes": meshed,
    "transfers": transferred,
    "bisection": lambda: bisected(crooked(SQUARE)),
    "bisection in space": lambda: bisected(crooked(cube(2))),
    **{
        f"smoother {dim}D {law}": lambda dim=dim, law=law: smoothed(dim, law)
        for dim in (2, 3)
        for law in ("frictionless", "tresca", "coulomb")
    },
    **{name: lambda kind=kind: stiff(kind) for name, kind in KINDS.items()},
}


@pytest.mark.parametrize("case", CASES)
def test_kernels_are_plain_python(case, monkeypatch):
    compiled = list(CASES[case]())
    uncompile(
        monkeypatch,
        *(module for name, module in list(sys.modules.items()) if name.startswith("adaptmg.")),
    )
    for plain, expected in zip(CASES[case](), compiled, strict=True):
        np.testing.assert_allclose(
            plain, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max(initial=0.0)
        )
