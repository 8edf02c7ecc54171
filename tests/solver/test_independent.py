"""Against solvers and assemblies of others on the same discrete problems: clarabel (conic), scikit-fem (P1)."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bodies import LOWER_ON_UPPER, UPPER_ON_LOWER, bar_hierarchy, bar_on_block, bumpy

import adaptmg as am

clarabel = pytest.importorskip("clarabel")
skfem = pytest.importorskip("skfem")
from conic import Conic  # noqa: E402
from skfem.helpers import ddot, dot, sym_grad, trace  # noqa: E402

LAWS = {"frictionless": am.Frictionless(), "tresca": am.Tresca(2e7), "coulomb": am.Coulomb(0.3)}
SOLVERS = {"multigrid": am.FullMultigrid(rtol=1e-10), "active set": am.ActiveSet(rtol=1e-12),
           "monotone": am.FullMultigrid(correction=am.Monotone(), rtol=1e-9, max_cycles=400),
           "single": am.SingleGrid(rtol=1e-10, omega=1.7)}


def moved_block():
    """Pressed onto a bumpy plane by a support that moves."""
    return am.ContactProblem(
        material=am.PlaneStrain(young=1e9, poisson=0.3), domain=am.Rectangle(width=1.0, height=0.5),
        contact=am.Contact("bottom", am.GapFunction(lambda x: 0.002 * (x[:, 0] - 0.5) ** 2)), law=am.Coulomb(0.3),
        supports=(am.Support("top", x=0.0005, y=-0.001),))


POSED = {"bar": (am.cases.greco_bar, (4, 8)), "block": (am.cases.greco_block, (2, 4)),
         "moved": (moved_block, ((8, 4), (16, 8)))}


@cache
def bodies(kind, law):
    if kind in POSED:
        case, divisions = POSED[kind]
        return am.Hierarchy.uniform(replace(case(), law=LAWS[law], reference={}), divisions)
    if kind == "graded":
        return am.Hierarchy.graded(replace(am.cases.greco_bar(), law=LAWS[law], reference={}), sizes=(16e-3, 8e-3),
                                   contact_ratio=3)
    pair = UPPER_ON_LOWER if kind == "two bodies" else LOWER_ON_UPPER
    return bar_hierarchy(bar_on_block(LAWS[law], pair, gap=bumpy), 2)


@cache
def conic(kind, law):
    """Displacement and pressures by clarabel."""
    problem = bodies(kind, law).finest.discrete
    limit, friction = problem.law.bounds(len(problem.contact))
    programme = Conic(problem)
    return programme.coulomb(friction, limit) if friction.any() else programme.solve(limit)


def energy(matrix, displacement):
    flat = displacement.ravel()
    return np.sqrt(flat @ (matrix @ flat))


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("kind", [*POSED, "graded", "two bodies", "exchanged"])
def test_conic_programme(kind, law, solver):
    grids, (unknowns, pressure) = bodies(kind, law), conic(kind, law)
    problem = grids.finest.discrete
    result = am.solve(grids, SOLVERS[solver], throw=False)
    error = problem.relative(result.displacement) - unknowns
    assert energy(problem.matrix, error) <= 1e-8 * energy(problem.matrix, unknowns)
    if problem.exchange is None:
        assert np.abs(result.contact.force_n - pressure).max() <= 1e-8 * pressure.max()


def lame(material):
    E, nu = material.young, material.poisson
    return E * nu / ((1 + nu) * (1 - 2 * nu)), E / (2 * (1 + nu))


def assembled(mesh, problem, boundaries):
    """Stiffness, load of pressures (boundary name -> Pa), in our numbering of dofs, by scikit-fem."""
    dim = mesh.dim
    kinds = (skfem.MeshTri, skfem.ElementTriP1) if dim == 2 else (skfem.MeshTet, skfem.ElementTetP1)
    theirs = kinds[0](np.ascontiguousarray(mesh.points.T), np.ascontiguousarray(mesh.elements.T))
    element = skfem.ElementVector(kinds[1]())
    basis = skfem.Basis(theirs, element)
    first, shear = lame(problem.material)
    eye = np.eye(dim)[:, :, None, None]

    @skfem.BilinearForm
    def stiffness(u, v, w):
        strain = sym_grad(u)
        return ddot(first * trace(strain) * eye + 2 * shear * strain, sym_grad(v))

    load = np.zeros(basis.N)
    for name, pressure in boundaries.items():
        on = np.zeros(theirs.p.shape[1], dtype=bool)
        on[mesh.boundary_nodes(name)] = True
        facets = np.flatnonzero(on[theirs.facets].all(axis=0) & (theirs.f2t[1] < 0))

        @skfem.LinearForm
        def pressing(v, w, pressure=pressure):
            return -pressure * dot(w.n, v)
        load += pressing.assemble(skfem.FacetBasis(theirs, element, facets=facets))
    order = basis.nodal_dofs.T.ravel()
    return stiffness.assemble(basis).tocsr()[order][:, order], load[order]


@pytest.mark.parametrize("law", ["frictionless", "coulomb"])
@pytest.mark.parametrize("kind", ["bar", "graded", "block"])
def test_assembly_by_scikit_fem(kind, law):
    grids = bodies(kind, law)
    problem, mesh, ours = grids.problem, grids.finest.mesh, grids.finest.discrete
    pressures = {load.boundary: load.value for load in problem.loads}
    matrix, load = assembled(mesh, problem, pressures)
    assert np.abs(ours.matrix - matrix).max() <= 1e-12 * np.abs(matrix).max()
    assert np.abs(ours.load - load).max() <= 1e-12 * np.abs(load).max()
    # assembled by one, solved by another, and here
    other = replace(ours, matrix=matrix, load=load)
    limit, friction = other.law.bounds(len(other.contact))
    unknowns, pressure = Conic(other).coulomb(friction, limit) if friction.any() else Conic(other).solve(limit)
    result = am.solve(grids, am.FullMultigrid(rtol=1e-10))
    assert energy(matrix, result.displacement - unknowns) <= 1e-8 * energy(matrix, unknowns)
    assert np.abs(result.contact.force_n - pressure).max() <= 1e-8 * pressure.max()


def test_a_wrong_answer_would_be_seen():
    problem = bodies("bar", "coulomb").finest.discrete
    unknowns, _ = conic("bar", "coulomb")
    other, _ = Conic(problem).coulomb(np.full(len(problem.contact), 0.3 + 1e-6), np.zeros(len(problem.contact)))
    assert energy(problem.matrix, other - unknowns) > 1e-8 * energy(problem.matrix, unknowns)
