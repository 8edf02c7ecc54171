"""Prolongations: what each reproduces, row sums, signs, nested meshes, bodies, curved boundaries, failures."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from simplex_meshes import delaunay, disk, log_graded, mesh_of, random_box, structured, two_boxes

from adaptmg.geometry.quadrature import simplex_rule
from adaptmg.mesh import MeshArrays
from adaptmg.transfer import CLIP, L2, Interpolation, LumpedL2, PseudoL2, QuasiInterpolation, Transfer
from adaptmg.transfer.projections import mass_matrix, mixed_mass

ALL = (Interpolation(), L2(), PseudoL2(), LumpedL2(), QuasiInterpolation())
AFFINE = (Interpolation(), L2(), PseudoL2(), QuasiInterpolation())
EMBEDDING = (Interpolation(), L2(), PseudoL2())
POSITIVE = (Interpolation(), LumpedL2())


def name(transfer):
    return type(transfer).__name__


def pairs():
    """Pairs of meshes of the same box, non-nested, with independent nodes on its sides; coarse, fine."""
    return {"2D": (random_box(20, 2, 1), random_box(90, 2, 2)), "3D": (random_box(12, 3, 1), random_box(60, 3, 2)),
            "graded": (log_graded(300, 1), log_graded(900, 2)), "coarser": (random_box(90, 2, 2), random_box(20, 2, 1)),
            "graded 3D": (structured(3, 3, 3.0), structured(5, 3, 3.0))}


PAIRS = pairs()


@pytest.mark.parametrize("transfer", ALL, ids=name)
@pytest.mark.parametrize("pair", PAIRS)
def test_rows_sum_to_one_and_have_no_tiny_entries(transfer, pair):
    coarse, fine = PAIRS[pair]
    P = transfer.build(coarse, fine)
    assert isinstance(transfer, Transfer)
    assert P.shape == (fine.n_nodes, coarse.n_nodes) and P.format == "csr" and P.has_canonical_format
    np.testing.assert_allclose(P.sum(axis=1), 1, atol=2e-14)
    assert np.abs(P.data).min() >= CLIP


@pytest.mark.parametrize("transfer", AFFINE, ids=name)
@pytest.mark.parametrize("pair", PAIRS)
def test_affine_fields_are_reproduced(transfer, pair):
    coarse, fine = PAIRS[pair]
    error = transfer.build(coarse, fine) @ coarse.points - fine.points
    assert np.abs(error).max() < 3e-14


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), dim=st.sampled_from([2, 3]), transfer=st.sampled_from(AFFINE),
       apart=st.sampled_from([None, 1e-17, 1e-16, 1e-13, 1e-9, 1e-6, 1e-4]), moved=st.booleans())
def test_sums_and_affine_fields_on_any_two_meshes(seed, dim, transfer, apart, moved):
    """Also where fine nodes equal coarse ones up to rounding: their rows have one entry, and no extent."""
    rng = np.random.default_rng(seed)
    coarse, fine = (random_box(int(n), dim, seed + k) for k, n in enumerate(rng.integers(1, 40, 2)))
    if apart is not None:
        inner = (coarse.points > 0) & (coarse.points < 1)
        points = np.clip(coarse.points + apart * rng.standard_normal(coarse.points.shape) * inner, 0, 1)
        if moved:
            corners = points[coarse.elements]
            assume((np.linalg.det(corners[:, 1:] - corners[:, :1]) > 0).all())
            fine = mesh_of(points, coarse.elements)
        else:
            shared = ~inner.any(axis=1) | (rng.random(coarse.n_nodes) < 0.5)
            fine = delaunay(np.concatenate([points[shared], rng.random((20, dim))]))
    P = transfer.build(coarse, fine)
    np.testing.assert_allclose(P.sum(axis=1), 1, atol=1e-12)
    assert np.abs(P @ coarse.points - fine.points).max() < (1e-12 if apart is None else 1e-9)


def test_lumped_l2_breaks_linears_at_the_boundary():
    P = LumpedL2().build(*PAIRS["2D"])
    coarse, fine = PAIRS["2D"]
    error = np.abs(P @ coarse.points - fine.points).max(axis=1)
    assert error.max() > 0.01


@pytest.mark.parametrize("transfer", POSITIVE, ids=name)
@pytest.mark.parametrize("pair", PAIRS)
def test_positive_transfers(transfer, pair):
    assert transfer.build(*PAIRS[pair]).data.min() >= 0


@pytest.mark.parametrize("transfer", EMBEDDING, ids=name)
@pytest.mark.parametrize(("n", "dim"), [(4, 2), (2, 3)])
def test_nested_meshes_give_the_canonical_embedding(transfer, n, dim):
    coarse, fine = structured(n, dim), structured(2 * n, dim)
    P = transfer.build(coarse, fine).toarray()
    at = np.rint(fine.points * 2 * n).astype(int)
    for row, where in zip(P, at, strict=True):
        # the diagonals all run along (1, .., 1): a node with odd numbers is the middle of floor and ceil
        ends = where // 2, -(-where // 2)
        expected = np.zeros(coarse.n_nodes)
        for end in ends:
            expected[np.argmin(np.abs(coarse.points * n - end).sum(axis=1))] += 0.5
        np.testing.assert_allclose(row, expected, atol=1e-10)


@pytest.mark.parametrize("transfer", EMBEDDING, ids=name)
@pytest.mark.parametrize("mesh", [random_box(40, 2, 4), random_box(20, 3, 4)], ids=["2D", "3D"])
def test_between_equal_meshes_it_is_the_identity(transfer, mesh):
    same = mesh_of(mesh.points, mesh.elements)
    np.testing.assert_allclose(transfer.build(mesh, same).toarray(), np.eye(mesh.n_nodes), atol=1e-9)


@pytest.mark.parametrize("pair", ["2D", "3D", "graded", "graded 3D"])
def test_coupling_integrals_are_exact(pair):
    """The integral of phi_i phi_j cannot depend on which of the meshes is clipped against the other."""
    first, second = PAIRS[pair]
    forth, back = mixed_mass(first, second), mixed_mass(second, first)
    B = forth.assemble(forth.shape_coefficients())
    C = back.assemble(back.shape_coefficients())
    assert abs(B - C.T).max() < 1e-13 * max(second.volumes.max(), first.volumes.max())
    x = np.column_stack([np.ones(first.n_nodes), first.points])
    y = np.column_stack([np.ones(second.n_nodes), second.points])
    dim = first.dim
    moments = np.full((dim + 1, dim + 1), 0.25) + np.eye(dim + 1) / 12
    moments[0] = moments[:, 0] = 0.5
    moments[0, 0] = 1.0
    np.testing.assert_allclose(y.T @ (B @ x), moments, atol=1e-12)


@pytest.mark.parametrize("pair", ["2D", "3D"])
def test_l2_solves_the_mass_system(pair):
    coarse, fine = PAIRS[pair]
    integrals = mixed_mass(coarse, fine)
    B = integrals.assemble(integrals.shape_coefficients()).toarray()
    exact = np.linalg.solve(mass_matrix(fine).toarray(), B)
    assert np.abs(L2().build(coarse, fine).toarray() - exact).max() < 6e-3


def test_mass_matrix_and_lumped_mass():
    mesh = random_box(30, 3, 8)
    M = mass_matrix(mesh)
    np.testing.assert_allclose(M.sum(axis=1), mixed_mass(mesh, mesh).lumped_mass, atol=1e-15)
    assert mesh.points[:, 0] @ (M @ mesh.points[:, 0]) == pytest.approx(1 / 3, abs=1e-13)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_simplex_rule_is_exact_for_degree_six(dim):
    shape, weights = simplex_rule(dim, 4)
    assert shape.shape == (4**dim, dim + 1) and shape.min() > 0 and weights.min() > 0
    np.testing.assert_allclose(shape.sum(axis=1), 1, atol=1e-14)
    # the mean of x^a (1 - x)^b over one barycentric coordinate, which is beta distributed: B(1 + a, dim + b)/B(1, dim)
    for coordinate in range(dim + 1):
        for a in range(7):
            expected = np.prod([(1 + k) / (1 + dim + k) for k in range(a)])
            assert weights @ shape[:, coordinate] ** a == pytest.approx(expected, abs=1e-14)


@pytest.mark.parametrize("transfer", ALL, ids=name)
def test_curved_boundary(transfer):
    """Fine nodes outside the coarse polygon: constants exact, and the interpolation of a smooth field second order."""
    errors = []
    for rings in (3, 6):
        coarse, fine = disk(rings), disk(2 * rings + 1, turn=0.3)
        P = transfer.build(coarse, fine)
        np.testing.assert_allclose(P.sum(axis=1), 1, atol=2e-14)
        assert np.diff(P.indptr).min() >= 1
        errors.append(np.abs(P @ coarse.points - fine.points).max())
    bound = 0.2 if name(transfer) == "LumpedL2" else 0.12
    assert errors[0] < bound and errors[1] < 0.6 * errors[0]


@pytest.mark.parametrize("transfer", ALL, ids=name)
def test_bodies_do_not_mix(transfer):
    coarse, fine = two_boxes(2, 2), two_boxes(5, 2)
    P = transfer.build(coarse, fine)
    half = coarse.n_nodes // 2
    of_rows = np.repeat(np.arange(fine.n_nodes) >= fine.n_nodes // 2, np.diff(P.indptr))
    np.testing.assert_array_equal(P.indices >= half, of_rows)
    np.testing.assert_allclose(P.sum(axis=1), 1, atol=1e-14)
    # the order of the bodies in the mesh does not matter, their names do
    swapped = mesh_of(fine.points, fine.elements, element_body=1 - fine.element_body, bodies=("above", "below"))
    assert abs(transfer.build(coarse, swapped) - P).max() == 0


def test_nodes_outside():
    """A quarter of the element size is the most: the diagonal of the cells here."""
    coarse, points = structured(2, 2), np.array(structured(3, 2).points)
    far, near = (mesh_of(points * scale, structured(3, 2).elements) for scale in (1.126, 1.124))
    assert Interpolation().build(coarse, near)[[15]].toarray()[0, -1] == 1
    for transfer in ALL:
        with pytest.raises(ValueError, match=r"fine node 15 at \(1.126, 1.126\) lies 0.178 m outside .* same units"):
            transfer.build(coarse, far)


def test_failures_name_the_argument():
    square, cube = structured(2, 2), structured(2, 3)
    for transfer in ALL:
        with pytest.raises(TypeError, match="coarse must be MeshArrays"):
            transfer.build(square.points, square)
        with pytest.raises(TypeError, match="fine must be MeshArrays"):
            transfer.build(square, None)
        with pytest.raises(ValueError, match="same dimension, got 2 and 3"):
            transfer.build(square, cube)
        with pytest.raises(ValueError, match="no body 'below', which fine has; its bodies are body"):
            transfer.build(square, two_boxes(2, 2))
    unused = MeshArrays(points=[[0, 0], [1, 0], [0, 1], [0.5, 0.5]], elements=[[0, 1, 2]], facets=np.zeros((0, 2)),
                        facet_labels=[], boundaries=())
    with pytest.raises(ValueError, match="fine: node 3 belongs to no element"):
        PseudoL2().build(square, unused)


def test_clipped_weights_leave_no_trace():
    """A fine node a hair off a coarse edge takes nothing from the corner across."""
    coarse = delaunay(np.array([[0.0, 0], [1, 0], [0, 1], [1, 1]]))
    fine = delaunay(np.array([[0.0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0.5 * CLIP]]))
    row = Interpolation().build(coarse, fine)[[4]]
    assert row.nnz == 2
    np.testing.assert_allclose(row.data, 0.5, atol=CLIP)
    assert row.sum() == 1


def test_growing_buffers_change_nothing():
    """A fine element over hundreds of coarse ones needs more room than is set aside at first."""
    coarse, fine = random_box(2000, 2, 11), structured(1, 2)
    P = PseudoL2().build(coarse, fine)
    np.testing.assert_allclose(P @ coarse.points, fine.points, atol=1e-12)
    assert P.nnz > 2000
