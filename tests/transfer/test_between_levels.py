"""Prolongations of relative values between levels: rigid motions, the same Galerkin matrix, rows along slaves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bodies import LOWER_ON_UPPER, UPPER_ON_LOWER, bar_on_block, corner_pushed, turned
from saddle import Parts
from scipy import sparse
from smoother_problems import expand

import adaptmg as am
from adaptmg.discrete.discretise import discretise
from adaptmg.mesh import graded, structured
from adaptmg.transfer import galerkin_product, surface_interpolation, with_contact_rows
from adaptmg.transfer.contact_rows import between_levels


def flat(pair, dim=2, angle=0.0):
    """A block on a wider one, fixed below only, on independent meshes."""
    if dim == 2:
        problem = bar_on_block(am.Coulomb(0.3), pair)
        divisions = [{"upper": 3, "lower": (5, 2)}, {"upper": (5, 4), "lower": (7, 5)}]
    else:
        material = am.Solid(young=1e11, poisson=0.3)
        problem = am.ContactProblem(
            material=material, law=am.Coulomb(0.3), contact=am.ContactPair(*pair),
            domain=am.Assembly(parts={"upper": am.Box(width=1.0, depth=1.0, height=1.0), "lower": am.Box(
                width=1.5, depth=1.25, height=0.5, origin=(0.0, -0.1, -0.5))}))
        divisions = [{"upper": 2, "lower": (3, 2, 1)}, {"upper": (3, 4, 3), "lower": (4, 5, 2)}]
    held = am.Support("lower.bottom", **dict.fromkeys("xyz"[:dim], 0.0))
    problem = replace(problem, supports=(held,))
    meshes = [structured(problem.domain, d) for d in divisions]
    return replace(problem, domain=None), [turned(mesh, angle) if angle else mesh for mesh in meshes]


def axisymmetric():
    problem, meshes = flat(UPPER_ON_LOWER)
    shifted = [replace(mesh, points=mesh.points + np.array([0.05, 0.0]), source=None) for mesh in meshes]
    return replace(problem, material=am.Axisymmetric(young=1e11, poisson=0.3)), shifted


def corner():
    """Three bodies in a row: what follows the block follows the seat."""
    problem = corner_pushed(am.Coulomb(0.3))
    meshes = [graded(problem.domain, h, problem.pair_boundaries, ratio) for h, ratio in ((0.5, 1.2), (0.3, 1.5))]
    return replace(problem, domain=None, supports=(am.Support("seat.bottom", x=0.0, y=0.0),)), meshes


CASES = {"upper": lambda: flat(UPPER_ON_LOWER), "lower": lambda: flat(LOWER_ON_UPPER),
         "turned": lambda: flat(UPPER_ON_LOWER, angle=0.8), "axisymmetric": axisymmetric, "corner": corner,
         "upper 3D": lambda: flat(UPPER_ON_LOWER, 3), "lower 3D": lambda: flat(LOWER_ON_UPPER, 3)}
TRANSFERS = {"interpolation": am.Interpolation(), "L2": am.L2(), "pseudo-L2": am.PseudoL2()}


@pytest.fixture(scope="module", params=CASES)
def levels(request):
    problem, meshes = CASES[request.param]()
    return problem, meshes, [discretise(problem, mesh) for mesh in meshes]


def affine_of_each_body(mesh, seed=0):
    """Every body under an affine field of its own (n_nodes, dim): rigid motions are among them."""
    rng = np.random.default_rng(seed)
    field = np.empty(mesh.points.shape)
    for k in range(len(mesh.bodies)):
        nodes = np.unique(mesh.elements[mesh.element_body == k])
        gradient, shift = rng.normal(size=(mesh.dim, mesh.dim)), rng.normal(size=mesh.dim)
        field[nodes] = mesh.points[nodes] @ gradient + shift
    return field


def nodal_of(problem, meshes, transfer):
    """The prolongation of displacements, with the rows of both surfaces of all pairs along the surfaces."""
    coarse, fine = meshes
    nodal = sparse.csr_array(transfer.build(coarse, fine))
    contact = discretise(problem, fine).contact
    masters = [(name, fine.boundary_nodes(name)) for name in contact.masters]
    slaves = [(name, contact.nodes[contact.boundary == k]) for k, name in enumerate(contact.names)]
    for name, nodes in (*masters, *slaves):
        rows = surface_interpolation(coarse, fine, coarse.boundary_facets(name), nodes)
        nodal = with_contact_rows(nodal, nodes, rows)
    return nodal


@pytest.mark.parametrize("rows", [True, False], ids=["rows", "plain"])
@pytest.mark.parametrize("transfer", TRANSFERS)
def test_affine_fields_of_each_body(levels, transfer, rows):
    _, meshes, (coarse, fine) = levels
    found = between_levels(TRANSFERS[transfer], *meshes, coarse, fine, rows)
    expected = fine.relative(affine_of_each_body(meshes[1]))
    got = found.prolongation @ coarse.relative(affine_of_each_body(meshes[0]))
    np.testing.assert_allclose(got, expected, atol=1e-11 * np.abs(expected).max())


def test_a_common_rigid_motion_has_no_relative_part(levels):
    _, meshes, (coarse, fine) = levels
    found = between_levels(am.Interpolation(), *meshes, coarse, fine)
    for prolongation in (found.prolongation, found.surface):
        got = prolongation @ coarse.relative(np.ones(meshes[0].points.shape))
        np.testing.assert_allclose(fine.physical(got), 1.0, atol=1e-11)
        assert np.abs(got[fine.contact.nodes]).max() <= 1e-12


@pytest.mark.parametrize("rows", [True, False], ids=["rows", "plain"])
@pytest.mark.parametrize("transfer", TRANSFERS)
def test_any_field_is_that_of_displacements(levels, transfer, rows):
    problem, meshes, (coarse, fine) = levels
    found = between_levels(TRANSFERS[transfer], *meshes, coarse, fine, rows)
    nodal = nodal_of(problem, meshes, TRANSFERS[transfer]) if rows else TRANSFERS[transfer].build(*meshes)
    w = np.random.default_rng(1).normal(size=meshes[0].points.shape)
    expected = nodal @ coarse.physical(w)
    np.testing.assert_allclose(fine.physical(found.prolongation @ w), expected, atol=1e-11 * np.abs(expected).max())


def test_the_galerkin_matrix_is_that_of_displacements(levels):
    problem, meshes, (coarse, fine) = levels
    found = between_levels(am.Interpolation(), *meshes, coarse, fine)
    stiffness = sparse.csr_array(Parts.of(problem, meshes[1]).matrix)
    P = expand(nodal_of(problem, meshes, am.Interpolation()), coarse.dim)
    T = np.column_stack([coarse.physical(unit).ravel() for unit in np.eye(coarse.n_dofs)])
    expected = T.T @ (P.T @ stiffness @ P).toarray() @ T
    got = galerkin_product(fine.matrix, found.prolongation).toarray()
    np.testing.assert_allclose(got, expected, atol=1e-12 * np.abs(expected).max())


def test_surface_rows(levels):
    _, meshes, (coarse, fine) = levels
    found = between_levels(am.L2(), *meshes, coarse, fine)
    above, contact = coarse.contact, fine.contact
    rows = found.surface[contact.nodes]
    assert rows.data.min() >= 0
    np.testing.assert_allclose(np.asarray(rows.sum(axis=1)).ravel(), 1.0, atol=1e-13)
    for k in range(len(contact.names)):
        used = np.unique(rows[np.flatnonzero(contact.boundary == k)].indices)
        assert np.isin(used, above.nodes[above.boundary == k]).all()
    # each coarse slave node has a say, and no row reaches beyond the facets about it
    assert len(np.unique(rows.indices)) == len(above)
    assert np.diff(rows.indptr).max() <= fine.dim
    others = np.setdiff1d(np.arange(fine.n_nodes), contact.nodes)
    assert abs(found.surface[others] - found.prolongation[others]).max() == 0
    # relative values that are constant on a surface stay so
    w = np.zeros(meshes[0].points.shape)
    w[above.nodes] = 1.0 + above.boundary[:, None]
    got = (found.surface @ w)[contact.nodes]
    np.testing.assert_allclose(got, np.tile(1.0 + contact.boundary[:, None], fine.dim), atol=1e-13)


def test_master_rows_lie_on_the_master(levels):
    _, meshes, (coarse, fine) = levels
    found = between_levels(am.L2(), *meshes, coarse, fine)
    slaves = np.flatnonzero(np.diff(fine.coupling.weights.indptr))
    on_slaves = np.flatnonzero(np.diff(coarse.coupling.weights.indptr))
    for name in fine.contact.masters:
        nodes = np.setdiff1d(meshes[1].boundary_nodes(name), slaves)
        rows = found.prolongation[nodes]
        columns = np.setdiff1d(np.unique(rows.indices), on_slaves)
        allowed = np.union1d(meshes[0].boundary_nodes(name), np.unique(coarse.coupling.weights.indices))
        assert np.isin(columns, allowed).all()


def test_one_body_has_no_coupling():
    problem = am.cases.greco_bar(law=am.Coulomb(0.5))
    meshes = [structured(problem.domain, n) for n in (3, 5)]
    coarse, fine = (discretise(problem, mesh) for mesh in meshes)
    plain = between_levels(am.Interpolation(), *meshes, coarse, fine, contact_rows=False)
    assert plain.surface is None
    assert abs(plain.prolongation - am.Interpolation().build(*meshes)).max() == 0
    assert between_levels(am.Interpolation(), *meshes, coarse, fine).surface is None


class Wrong:
    def __init__(self, change):
        self.change = change

    def build(self, coarse, fine):
        return self.change(am.Interpolation().build(coarse, fine))


def _spoiled(matrix):
    matrix = sparse.csr_array(matrix, copy=True)
    matrix.data[0] = np.nan
    return matrix


@pytest.mark.parametrize(("change", "message"), [(lambda m: m[:, :-1], r"shape \(\d+, \d+\) \(fine, coarse nodes\)"),
                                                 (lambda m: m.T, "shape"), (_spoiled, "must be finite")])
def test_what_a_transfer_must_not_return(change, message):
    problem, meshes = flat(UPPER_ON_LOWER)
    with pytest.raises(ValueError, match=message):
        between_levels(Wrong(change), *meshes, *(discretise(problem, mesh) for mesh in meshes))
