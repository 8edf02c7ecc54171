r"""CoarseContact: the contact problem of the finest level in the span of a coarse space.

While the contact status is unknown, a linear correction carries a flexible body through its obstacle, and the
projection cuts it node by node. In the span of a coarse space, :math:`u + P e`, the inequalities and the law of all
contact nodes are kept: with the residual :math:`r = f - A u`, the Galerkin matrix :math:`A_c` and the rows B of P at
contact nodes, in their frames, e solves

.. math:: A_c e + B' q(w + B e) = P' r,

q being the contact forces that belong to the displacements w + B e of the contact nodes. Coarse unknowns that reach no
contact node are eliminated once; the interior point method (:mod:`adaptmg.smoother.interior_point`) solves the rest.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy import sparse

from adaptmg._numba import kernel
from adaptmg.multigrid.truncated_step import TruncatedStep
from adaptmg.smoother.factorisation import Eliminated, dofs_of, eliminate
from adaptmg.smoother.interior_point import dense_factors, interior_point
from adaptmg.smoother.system import LocalSystem, NodalContact


class CoarseContact:
    """Corrections of one :class:`~adaptmg.multigrid.truncated_step.TruncatedStep`, in the span of the finest level with
    at most ``MOST`` unknowns below its own."""

    #: unknowns of the coarse space; tolerance of its problem; slack above which its solution is refused
    MOST, TOLERANCE, REFUSED = 2500, 1e-3, 1e-2

    def __init__(self, step: TruncatedStep, coordinates: list[np.ndarray | None]) -> None:
        levels, contact, dim = step.cycle.levels, step.contact, step.contact.dim
        small = [number for number in range(step.number) if levels[number].matrix.n_dofs <= self.MOST]
        self.step, self.number = step, small[-1] if small else 0
        rows = self._rows()
        matrix = step.base_matrix(self.number)
        nodes = np.unique(rows.indices // matrix.blocksize[0])
        fixed = np.zeros(matrix.shape[0], dtype=bool)
        fixed[levels[self.number].matrix.fixed] = True
        self.eliminated = _eliminated(matrix, fixed, nodes, coordinates[self.number])
        self.unknowns = _CoarseSpan(self.eliminated.matrix, rows[:, self.eliminated.contact], dim)
        block = np.zeros((len(contact.nodes), dim, dim))
        block[(slice(None), *np.triu_indices(dim))] = contact.blocks.reshape(len(block), -1)
        self.stiffness = np.abs(block.diagonal(axis1=1, axis2=2))

    def _rows(self) -> sparse.csr_array:
        """B: the prolongation from the coarse level, at contact nodes, in their frames."""
        step, dim = self.step, self.step.contact.dim
        n, dofs = len(step.contact.nodes), dofs_of(step.contact.nodes, dim)
        frames = step.contact.frames.reshape(n, dim, dim)
        rows = sparse.csr_array(sparse.bsr_array((frames, np.arange(n), np.arange(n + 1)), shape=(n * dim, n * dim)))
        rows = sparse.csr_array((rows.data, dofs[rows.indices], rows.indptr), shape=(n * dim, len(step.unknowns)))
        for level in reversed(step.cycle.levels[self.number + 1:step.number + 1]):
            nodal = level.prolongation
            size = level.matrix.n_dofs // nodal.shape[0]
            rows = _without(rows, level.matrix.fixed) @ sparse.kron(nodal, sparse.eye_array(size), format="csr")
        rows = _without(rows, step.cycle.levels[self.number].matrix.fixed)
        rows.eliminate_zeros()
        return rows

    def __call__(self) -> float:
        """Correct the smoothed iterate; returns the A-norm of the correction, sqrt(N m), or infinity where there is
        none."""
        step = self.step
        if not len(self.eliminated.contact):  # no coarse unknown moves a contact node
            return np.inf
        levels, rest = step.cycle.levels, step.residual
        for level in reversed(levels[self.number + 1:step.number + 1]):
            coarse = np.zeros(level.below.matrix.n_dofs)
            level.restrict(rest, coarse)
            rest = coarse
        particular, load = self.eliminated.reduce(rest)
        c = step.contact
        conditions = NodalContact(c.gap, c.reference.reshape(len(c.nodes), -1), c.limit, c.friction)
        solution = interior_point(self.unknowns, load, conditions, self.stiffness, self.TOLERANCE,
                                  c.values.reshape(len(c.nodes), -1))
        if not solution.slack <= self.REFUSED:
            return np.inf
        correction = self.eliminated.complete(particular, solution.unknowns)
        for level in levels[self.number + 1:step.number + 1]:
            correction[level.below.matrix.fixed] = 0.0
            finer = np.zeros(level.matrix.n_dofs)
            level.prolong(correction, finer)
            correction = finer
        correction[step.matrix.fixed] = 0.0
        step.move(correction)
        return float(np.sqrt(max(solution.unknowns @ self.unknowns.product(solution.unknowns), 0.0)))


#: springs that hold what no fine node tells apart, over the diagonal
_SPRING = 1e-9


def _eliminated(matrix: sparse.bsr_array, fixed: np.ndarray, nodes: np.ndarray, coordinates: np.ndarray | None
                ) -> Eliminated:
    """All but the coarse nodes that reach contact nodes eliminated. Galerkin matrices of independent meshes may be
    singular without these; no force acts on what springs hold then."""
    try:
        return eliminate(LocalSystem.from_matrix(matrix, fixed, nodes), coordinates)
    except ValueError:
        held = sparse.bsr_array(matrix + sparse.diags_array(_SPRING * matrix.diagonal()), blocksize=matrix.blocksize)
        return eliminate(LocalSystem.from_matrix(held, fixed, nodes), coordinates)


def _without(rows: sparse.csr_array, fixed: np.ndarray) -> sparse.csr_array:
    """The rows with columns of fixed dofs zero."""
    free = np.ones(rows.shape[1])
    free[fixed] = 0.0
    return sparse.csr_array((rows.data * free[rows.indices], rows.indices, rows.indptr), shape=rows.shape)


class _CoarseSpan:
    """Coarse unknowns; see :class:`~adaptmg.smoother.interior_point.Span`."""

    def __init__(self, matrix: np.ndarray, rows: sparse.csr_array, dim: int) -> None:
        self.matrix, self.rows, self.dim = matrix, rows, dim

    def product(self, unknowns: np.ndarray) -> np.ndarray:
        return self.matrix @ unknowns

    def values(self, unknowns: np.ndarray) -> np.ndarray:
        return (self.rows @ unknowns).reshape(-1, self.dim)

    def restricted(self, forces: np.ndarray) -> np.ndarray:
        return self.rows.T @ forces.reshape(-1)

    def factors(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        whole, rows = self.matrix.copy(), self.rows
        _add_nodal(self.dim, rows.indptr, rows.indices, rows.data, blocks, whole)
        return dense_factors(whole)


@kernel
def _add_nodal(dim, indptr, indices, data, blocks, whole):
    """Whole += B' S B, S the blocks of the contact nodes."""
    for k in range(len(blocks)):
        for a in range(dim):
            for p in range(indptr[dim * k + a], indptr[dim * k + a + 1]):
                for b in range(dim):
                    factor = data[p] * blocks[k, a, b]
                    for q in range(indptr[dim * k + b], indptr[dim * k + b + 1]):
                        whole[indices[p], indices[q]] += factor * data[q]
