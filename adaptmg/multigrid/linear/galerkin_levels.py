"""The Galerkin matrices of all levels, split, for the truncated method."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.linear.split_matrix import SplitMatrix, split
from adaptmg.transfer.aggregation import without_fixed
from adaptmg.transfer.galerkin import galerkin_product, is_galerkin, seen

__all__ = ["galerkin_levels", "nodal_prolongations"]


def nodal_prolongations(hierarchy: Hierarchy) -> list[sparse.csr_array]:
    """Prolongations between neighbours, coarsest first, columns sorted."""
    result = []
    for level in hierarchy.levels[1:]:
        nodal = sparse.csr_array(level.prolongation)
        nodal.sort_indices()
        result.append(nodal)
    return result


def galerkin_levels(hierarchy: Hierarchy, prolongations: list[sparse.csr_array]) -> list[SplitMatrix]:
    """Galerkin matrices of all levels, coarsest first.

    Where the discretised matrix is the Galerkin one (nested meshes) it is taken as it is; not with coupled bodies,
    whose truncated matrices need more entries near contact than the discretised ones have. The finest matrix, which no
    truncation changes, is symmetric: its lower half is all that is stored.
    """
    matrix, fine = hierarchy.finest.matrix, hierarchy.finest.discrete
    result, finer = [split(matrix, fine.fixed, symmetric=len(hierarchy) > 1)], None
    for level, nodal in zip(reversed(hierarchy.levels[:-1]), reversed(prolongations), strict=True):
        if level.discrete is None:
            matrix, fixed = level.matrix, np.zeros(level.matrix.shape[0], dtype=bool)
        elif level.discrete.coupling is None and is_galerkin(matrix, nodal, level.discrete.matrix):
            matrix, fixed, finer = level.discrete.matrix, level.discrete.fixed, None
        else:
            finer = seen(nodal, finer)
            matrix = galerkin_product(_supported(matrix, fine, nodal, level.discrete), finer)
            fixed = level.discrete.fixed
        fine = level.discrete
        result.insert(0, split(matrix, fixed))
    return result


def _supported(matrix: sparse.bsr_array, fine: DiscreteProblem, nodal: sparse.csr_array,
               coarse: DiscreteProblem) -> sparse.bsr_array:
    """The matrix, without the rows and columns of fixed dofs if free coarse dofs reach them."""
    dim = fine.dim
    fixed, free = fine.fixed.reshape(-1, dim), ~coarse.fixed.reshape(-1, dim)
    reached = any((nodal[np.flatnonzero(fixed[:, c])] @ free[:, c].astype(float)).any() for c in range(dim))
    if not reached:
        return matrix
    return without_fixed(matrix, fine.fixed)
