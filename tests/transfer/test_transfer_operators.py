"""Restriction, injection, expansion to dofs, masks, mesh ratios."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from simplex_meshes import disk, log_graded, random_box, structured, two_boxes

from adaptmg.transfer import Interpolation, PseudoL2, expand, injection, mask, mesh_ratio, restriction


@pytest.mark.parametrize("transfer", [Interpolation(), PseudoL2()])
@pytest.mark.parametrize("dim", [2, 3])
def test_restriction_is_the_adjoint(transfer, dim):
    P = expand(transfer.build(random_box(15, dim, 1), random_box(50, dim, 2)), dim)
    R = restriction(P)
    assert R.format == "csr"
    rng = np.random.default_rng(0)
    r, v = rng.standard_normal(P.shape[0]), rng.standard_normal(P.shape[1])
    assert r @ (P @ v) == pytest.approx((R @ r) @ v, rel=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_injection_evaluates_the_fine_function(dim):
    coarse, fine = random_box(15, dim, 1), random_box(50, dim, 2)
    Q = injection(coarse, fine)
    assert Q.shape == (coarse.n_nodes, fine.n_nodes) and Q.data.min() >= 0
    np.testing.assert_allclose(Q.sum(axis=1), 1, atol=1e-15)
    np.testing.assert_allclose(Q @ fine.points, coarse.points, atol=1e-14)


def test_injection_undoes_the_prolongation_on_nested_meshes():
    coarse, fine = structured(3, 2), structured(6, 2)
    product = injection(coarse, fine) @ Interpolation().build(coarse, fine)
    np.testing.assert_allclose(product.toarray(), np.eye(coarse.n_nodes), atol=1e-13)


def test_injection_names_the_coarse_node():
    with pytest.raises(ValueError, match=r"coarse node \d+ at .* outside the fine mesh"):
        injection(disk(3), structured(9, 2))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), dim=st.integers(1, 4), shape=st.tuples(st.integers(1, 12), st.integers(1, 9)))
def test_expand_is_the_kronecker_product(seed, dim, shape):
    P = sparse.random_array(shape, density=0.3, format="csr", rng=np.random.default_rng(seed))
    wide = expand(P, dim)
    assert wide.has_canonical_format
    np.testing.assert_array_equal(wide.toarray(), np.kron(P.toarray(), np.eye(dim)))


def test_mask_empties_rows_and_columns():
    P = sparse.csr_array(np.arange(1.0, 13.0).reshape(4, 3))
    rows, columns = np.array([False, True, False, False]), np.array([False, False, True])
    masked = mask(P, rows, columns)
    np.testing.assert_array_equal(masked.toarray(), [[1, 2, 0], [0, 0, 0], [7, 8, 0], [10, 11, 0]])
    assert masked.nnz == 6 and P.nnz == 12


@pytest.mark.parametrize("dim", [2, 3])
def test_mesh_ratio_of_uniform_meshes(dim):
    assert mesh_ratio(structured(2, dim), structured(4, dim)) == pytest.approx(2, abs=1e-12)
    assert mesh_ratio(structured(4, dim), structured(2, dim)) == pytest.approx(0.5, abs=1e-12)
    assert mesh_ratio(two_boxes(2, dim), two_boxes(6, dim)) == pytest.approx(3, abs=1e-12)


def test_mesh_ratio_sees_a_local_jump():
    coarse, fine = structured(8, 2), log_graded(3000, 4)
    assert mesh_ratio(coarse, fine) > 200
    assert mesh_ratio(coarse, structured(16, 2)) == pytest.approx(2)
    assert mesh_ratio(coarse, fine, quantile=0.1) < mesh_ratio(coarse, fine, quantile=0.9) < mesh_ratio(coarse, fine)


def test_failures_name_the_argument():
    P = sparse.csr_array(np.eye(3))
    with pytest.raises(TypeError, match="P must be a scipy sparse matrix"):
        restriction(np.eye(3))
    with pytest.raises(ValueError, match="dim must be >= 1"):
        expand(P, 0)
    with pytest.raises(TypeError, match="fixed_fine must be a boolean mask"):
        mask(P, np.zeros(3), np.zeros(3, dtype=bool))
    with pytest.raises(ValueError, match=r"fixed_coarse must have shape \(3,\), got \(2,\)"):
        mask(P, np.zeros(3, dtype=bool), np.zeros(2, dtype=bool))
    with pytest.raises(ValueError, match="quantile"):
        mesh_ratio(structured(1, 2), structured(2, 2), quantile=2)
    with pytest.raises(ValueError, match="outside_tolerance"):
        injection(structured(1, 2), structured(2, 2), outside_tolerance=float("nan"))
