"""Assembly by scikit-fem gives the same discrete problem; solutions by clarabel: tests/agreement."""

from __future__ import annotations

import numpy as np
import pytest

import adaptmg as am

skfem = pytest.importorskip("skfem")
from skfem.helpers import ddot, dot, sym_grad, trace  # noqa: E402


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


@pytest.mark.parametrize("grids", [
    am.Hierarchy.uniform(am.cases.greco_bar(), (4, 8)), am.Hierarchy.uniform(am.cases.greco_block(), (2, 4)),
    am.Hierarchy.graded(am.cases.greco_bar(), sizes=(16e-3, 8e-3), contact_ratio=3)], ids=["bar", "block", "graded"])
def test_assembly_by_scikit_fem(grids):
    problem, mesh, ours = grids.problem, grids.finest.mesh, grids.finest.discrete
    matrix, load = assembled(mesh, problem, {load.boundary: load.value for load in problem.loads})
    assert np.abs(ours.matrix - matrix).max() <= 1e-12 * np.abs(matrix).max()
    assert np.abs(ours.load - load).max() <= 1e-12 * np.abs(load).max()


def test_the_conic_programme_sees_a_wrong_answer():
    pytest.importorskip("clarabel")
    from conic import Conic

    problem = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(0.3)), (4, 8)).finest.discrete
    n = len(problem.contact)
    one, other = (Conic(problem).coulomb(np.full(n, value), np.zeros(n))[0] for value in (0.3, 0.3 + 1e-6))
    assert np.sqrt((other - one).ravel() @ (problem.matrix @ (other - one).ravel())) > 1e-8 * np.sqrt(
        one.ravel() @ (problem.matrix @ one.ravel()))
