"""Indices of sparse matrices are narrowed to 32 bits on all levels; nothing else changes."""

import numpy as np
import pytest
from scipy import sparse

import adaptmg as am
from adaptmg import _check_arrays as check_arrays


def wide(matrix):
    """The same with indices of 64 bits."""
    result = matrix.copy()
    result.indices, result.indptr = result.indices.astype(np.int64), result.indptr.astype(np.int64)
    return result


@pytest.mark.parametrize("kind", ["csr", "csc", "bsr"])
def test_the_same_matrix_with_smaller_indices(kind):
    matrix = sparse.random_array((12, 12), density=0.3, rng=np.random.default_rng(1)).asformat(kind)
    result = check_arrays.narrowed(wide(matrix))
    assert result.indices.dtype == result.indptr.dtype == np.int32 and result.format == kind
    assert (result != matrix).nnz == 0 and getattr(result, "blocksize", 0) == getattr(matrix, "blocksize", 0)
    assert check_arrays.narrowed(result) is result
    assert check_arrays.sparse_matrix("matrix", wide(matrix)).indices.dtype == np.int32


def test_indices_that_do_not_fit_stay(monkeypatch):
    monkeypatch.setattr(check_arrays, "_LARGEST_INDEX", 5)
    matrix = wide(sparse.eye_array(6, format="csr"))
    assert check_arrays.narrowed(matrix) is matrix


@pytest.mark.parametrize("case", ["greco_bar", "two_block_patch"])
def test_all_levels_have_them(case):
    problem = getattr(am.cases, case)()
    parts = getattr(problem.domain, "parts", {"": problem.domain}).values()
    size = max(part.upper[0] - part.lower[0] for part in parts)
    grids = am.Hierarchy.graded(problem, (size / 3, size / 6))
    result = [level.discrete.matrix for level in grids.levels] + [grids.finest.prolongation]
    result += [grids.finest.surface_prolongation] * (grids.finest.surface_prolongation is not None)
    assert {(m.indices.dtype, m.indptr.dtype) for m in result} == {(np.dtype(np.int32),) * 2}
