r"""SplitMatrix: a block matrix stored as strict lower part L, strict upper part U and inverse diagonal blocks.

Gauss-Seidel sweeps in turn, forward after backward, need the half that has changed only:
with :math:`t = f - U u` kept from the backward sweep, the forward sweep is :math:`D u_i = t_i - L_i u`. Kept apart, a
half is streamed for itself and counts as half a pass. Of a symmetric matrix L alone is enough where the sweeps scatter
:math:`L^T`. Rows and columns of fixed dofs are zero. :func:`galerkin_levels` splits those of all levels of a hierarchy.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy import Hierarchy, Level
from adaptmg.multigrid.linear import split_kernels as kernels
from adaptmg.problem.index_arrays import indices_frozen
from adaptmg.runtime.compiled import read_only
from adaptmg.transfer.aggregation import without_fixed
from adaptmg.transfer.galerkin import galerkin_product, is_galerkin, seen

__all__ = ["SplitMatrix", "galerkin_levels", "nodal_prolongations", "split"]


@dataclass(eq=False)
class SplitMatrix:
    """A matrix of ``dim`` x ``dim`` blocks in Cartesian components, fixed dofs eliminated.

    Attributes
    ----------
    dim : int
    lower_indptr, upper_indptr : (n_nodes + 1,) int32 arrays
    lower_indices, upper_indices : uint32 arrays
        Block columns, ascending in a row.
    lower, upper : float64 arrays
        Blocks, row by row, flat. All three arrays of the upper half are empty where it is the transpose of the lower.
    diagonal, inverse : (n_nodes * dim * dim,) arrays
        Diagonal blocks and their inverses, flat; :meth:`drop_diagonal` empties ``diagonal`` when it is of no more use.
    fixed : (n_fixed,) int64 array
        Fixed dofs.
    nonzeros : int
        Stored entries of the whole matrix, the unit of work on this level.
    """

    dim: int
    lower_indptr: np.ndarray
    lower_indices: np.ndarray
    lower: np.ndarray
    upper_indptr: np.ndarray
    upper_indices: np.ndarray
    upper: np.ndarray
    diagonal: np.ndarray
    inverse: np.ndarray
    fixed: np.ndarray
    nonzeros: int

    @property
    def n_nodes(self) -> int:
        """Block rows."""
        return len(self.lower_indptr) - 1

    @property
    def n_dofs(self) -> int:
        """Rows."""
        return self.n_nodes * self.dim

    @property
    def symmetric(self) -> bool:
        """Whether U is not stored, being the transpose of L."""
        return len(self.upper_indptr) == 0

    @property
    def lower_arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """indptr, indices, data of L."""
        return self.lower_indptr, self.lower_indices, self.lower

    @property
    def upper_arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """indptr, indices, data of U."""
        return self.upper_indptr, self.upper_indices, self.upper

    @property
    def nbytes(self) -> int:
        """Memory of the arrays, bytes."""
        arrays = (*self.lower_arrays, *self.upper_arrays, self.diagonal, self.inverse, self.fixed)
        return sum(array.nbytes for array in arrays)

    def copy(self) -> SplitMatrix:
        """With arrays of its own where the contact status changes them."""
        return replace(self, lower=self.lower.copy(), upper=self.upper.copy(), diagonal=self.diagonal.copy(),
                       inverse=self.inverse.copy())

    def drop_diagonal(self) -> None:
        """Free the diagonal blocks: :meth:`at_slots` and :meth:`matrix` are then out of reach."""
        self.diagonal = np.empty(0)

    def at_slots(self, slots: np.ndarray) -> np.ndarray:
        """The blocks at slots (L first, then the diagonal, then U), flat."""
        size, n, below = self.dim**2, self.n_nodes, int(self.lower_indptr[-1])
        result = np.empty((len(slots), size))
        in_lower, in_upper = slots < below, slots >= below + n
        on_diagonal = ~(in_lower | in_upper)
        result[in_lower] = self.lower.reshape(-1, size)[slots[in_lower]]
        result[on_diagonal] = self.diagonal.reshape(-1, size)[slots[on_diagonal] - below]
        result[in_upper] = self.upper.reshape(-1, size)[slots[in_upper] - below - n]
        return result.reshape(-1)

    def matrix(self) -> sparse.bsr_array:
        """The whole matrix, for coarsest solves and tests (n_dofs, n_dofs); needs ``diagonal``."""
        n, dim = self.n_nodes, self.dim
        shape = (self.n_dofs, self.n_dofs)
        parts = []
        for indptr, indices, data in ((np.arange(n + 1), np.arange(n), self.diagonal), self.lower_arrays,
                                      *(() if self.symmetric else (self.upper_arrays,))):
            blocks = data.reshape(-1, dim, dim)
            parts.append(sparse.bsr_array((blocks, indices.astype(np.int32), indptr), shape=shape))
        return parts[0] + parts[1] + (parts[1].T if self.symmetric else parts[2])


def split(matrix: sparse.bsr_array, fixed: np.ndarray, symmetric: bool = False) -> SplitMatrix:
    """Split a block matrix into its halves, with the rows and columns of fixed dofs zeroed.

    Parameters
    ----------
    matrix : bsr_array (n_dofs, n_dofs)
        Square blocks; columns sorted in each row.
    fixed : (n_dofs,) bool array
    symmetric : bool
        Store L alone, and take its transpose for U.

    Returns
    -------
    SplitMatrix
    """
    dim = matrix.blocksize[0]
    n = matrix.shape[0] // dim
    indptr, indices, data = read_only(matrix.indptr), read_only(matrix.indices), matrix.data.reshape(-1)
    lower_indptr, upper_indptr = np.empty(n + 1, dtype=np.int32), np.empty(n + 1, dtype=np.int32)
    kernels.count(indptr, indices, lower_indptr, upper_indptr)
    below, above = int(lower_indptr[-1]), int(upper_indptr[-1])
    nonzeros = (below + above + n) * dim * dim
    if symmetric:
        upper_indptr, above = upper_indptr[:0].copy(), 0
    lower_indices, upper_indices = np.empty(below, dtype=np.uint32), np.empty(above, dtype=np.uint32)
    lower, upper = np.empty(below * dim * dim), np.empty(above * dim * dim)
    diagonal, inverse = np.empty(n * dim * dim), np.empty(n * dim * dim)
    kernels.distribute(dim, indptr, indices, data, lower_indptr, lower_indices, lower, upper_indptr, upper_indices,
                       upper, diagonal)
    dofs = np.flatnonzero(fixed)
    if len(dofs):
        free, held = ~fixed, np.zeros(n, dtype=bool)
        held[dofs // dim] = True
        kernels.mask(dim, lower_indptr, lower_indices, lower, free, held)
        if not symmetric:
            kernels.mask(dim, upper_indptr, upper_indices, upper, free, held)
        kernels.decouple(dim, diagonal, dofs)
    kernels.invert_all(dim, diagonal, inverse)
    return SplitMatrix(dim, lower_indptr, lower_indices, lower, upper_indptr, upper_indices, upper, diagonal, inverse,
                       dofs, nonzeros)


def nodal_prolongations(hierarchy: Hierarchy) -> list[sparse.csr_array]:
    """Prolongations between neighbours, coarsest first, columns sorted."""
    # a copy where they are not: the hierarchy's own stays
    return [P if P.has_sorted_indices else indices_frozen(P.sorted_indices())
            for P in (level.prolongation for level in hierarchy.levels[1:])]


def galerkin_levels(hierarchy: Hierarchy, prolongations: list[sparse.csr_array]) -> list[SplitMatrix]:
    """Galerkin matrices of all levels, coarsest first.

    Where the discretised matrix is the Galerkin one (nested meshes) it is taken as it is; not with coupled bodies,
    whose truncated matrices need more entries near contact than the discretised ones have. The finest matrix, which no
    truncation changes, is symmetric: its lower half is all that is stored.
    """
    matrix, fine = hierarchy.finest.matrix, hierarchy.finest.discrete
    result, finer = [split(matrix, fine.fixed, symmetric=len(hierarchy) > 1)], None
    for above, level, nodal in zip(reversed(hierarchy.levels[1:]), reversed(hierarchy.levels[:-1]),
                                   reversed(prolongations), strict=True):
        if level.discrete is None:
            matrix, fixed = level.matrix, np.zeros(level.matrix.shape[0], dtype=bool)
        elif level.discrete.coupling is None and _nested(above, level, matrix, nodal):
            matrix, fixed, finer = level.discrete.matrix, level.discrete.fixed, None
        else:
            finer = seen(nodal, finer)
            matrix = galerkin_product(_supported(matrix, fine, nodal, level.discrete), finer)
            fixed = level.discrete.fixed
        fine = level.discrete
        result.insert(0, split(matrix, fixed))
    return result


def _nested(above: Level, level: Level, matrix: sparse.bsr_array, nodal: sparse.csr_array) -> bool:
    """Whether the discretised matrix of ``level`` is the Galerkin one of ``matrix``, that of the level above.

    Remembered on the level above, whose prolongation it is: hierarchies that grow ask for it at every step.
    """
    coarse = level.discrete.matrix
    if matrix is not above.matrix:
        return is_galerkin(matrix, nodal, coarse)
    known = above.__dict__.get("_galerkin_of")
    if known is None or known[0] is not matrix or known[1] is not coarse:
        known = matrix, coarse, is_galerkin(matrix, nodal, coarse)
        object.__setattr__(above, "_galerkin_of", known)
    return known[2]


def _supported(matrix: sparse.bsr_array, fine: DiscreteProblem, nodal: sparse.csr_array,
               coarse: DiscreteProblem) -> sparse.bsr_array:
    """The matrix, without the rows and columns of fixed dofs if free coarse dofs reach them."""
    dim = fine.dim
    fixed, free = fine.fixed.reshape(-1, dim), ~coarse.fixed.reshape(-1, dim)
    reached = any((nodal[np.flatnonzero(fixed[:, c])] @ free[:, c].astype(float)).any() for c in range(dim))
    if not reached:
        return matrix
    return without_fixed(matrix, fine.fixed)
