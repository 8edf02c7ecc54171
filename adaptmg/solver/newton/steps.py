"""How the equations of a Newton step are solved: on the sparse matrix, or condensed to the contact nodes.

Both solve for a change of all unknowns whose right-hand side is the residual of the full sparse matrix, so that every
step of the active set method is a step of iterative refinement too.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy import linalg, sparse

from adaptmg.discrete import DiscreteProblem
from adaptmg.smoother.system import LocalProblem, rotate
from adaptmg.solver.linear.condensation import Condensed, condense
from adaptmg.solver.linear.solvers import Direct, LinearSolver, Prepared, solution_of
from adaptmg.solver.newton.linearised import Linearised
from adaptmg.solver.run import Run
from adaptmg.transfer.aggregation import without_fixed

__all__ = ["CondensedSteps", "SparseSteps", "Steps", "local_near_nullspace"]

_LOG = logging.getLogger(__name__)


class Steps(Protocol):
    """Takes the linear steps of one problem."""

    @property
    def stiffness(self) -> np.ndarray:
        """Diagonal (n_contact, dim) of the matrix that the contact nodes see, N/m."""

    def contact_residual(self, residual: np.ndarray) -> np.ndarray:
        """The residual (n_contact, dim) at contact nodes that decides their status, from that at all dofs."""

    def solve(self, equations: Linearised, rtol: float, spring: float) -> np.ndarray:
        """The change (n_dofs,) for the residual last given to :meth:`contact_residual`.

        Parameters
        ----------
        equations : Linearised
        rtol : float
            Of an iterative linear solver.
        spring : float
            Springs of this stiffness, relative to the diagonal, at the contact dofs.

        Raises
        ------
        numpy.linalg.LinAlgError
            If the equations are singular or, without springs, an iterative solver does not reach ``rtol``.
        """


def local_near_nullspace(local: LocalProblem, released: np.ndarray | None = None) -> np.ndarray:
    """Rigid-body modes (n_dofs, k) in local components, zero at fixed dofs.

    Translations where the problem has no ``near_nullspace``.

    Parameters
    ----------
    local : LocalProblem
    released : (n_dofs,) bool array, optional
        Further dofs at which they are to vanish.
    """
    problem: DiscreteProblem = local.discrete
    modes = problem.near_nullspace
    if modes is None:
        modes = np.tile(np.eye(problem.dim), (problem.n_nodes, 1))
    modes = np.column_stack([rotate(mode, local.frames, local.system.nodes) for mode in modes.T])
    modes[local.system.fixed if released is None else local.system.fixed | released] = 0.0
    return modes


@dataclass(eq=False)
class CondensedSteps:
    """Steps on the dense Schur complement; one sparse factorisation serves them all.

    Parameters
    ----------
    local : LocalProblem
    run : Run
    """

    local: LocalProblem
    run: Run
    condensed: Condensed = field(init=False)
    _particular: np.ndarray = field(init=False)

    #: reciprocal condition number below which the equations count as singular
    SINGULAR = 1e-13

    def __post_init__(self) -> None:
        with self.run.phase("factorise"):
            self.condensed = condense(self.local)

    @property
    def stiffness(self) -> np.ndarray:
        """See :class:`Steps`."""
        return self.condensed.matrix.diagonal().reshape(-1, self.local.system.dim)

    def contact_residual(self, residual: np.ndarray) -> np.ndarray:
        """The residual with the interior in equilibrium; see :class:`Steps`."""
        with self.run.phase("solve"):
            self._particular, force = self.condensed.reduce(residual)
        return force.reshape(-1, self.local.system.dim)

    def solve(self, equations: Linearised, rtol: float, spring: float) -> np.ndarray:
        """See :class:`Steps`."""
        with self.run.phase("solve"):
            n, dim = equations.force.shape
            matrix = self.condensed.matrix.copy()
            matrix[np.diag_indices(n * dim)] += spring * self.condensed.matrix.diagonal()
            matrix = matrix.reshape(n, dim, n, dim)
            node = np.arange(n)
            pull = equations.coupling[:, None] * equations.direction
            for k in range(1, dim):
                matrix[:, k] -= pull[:, k - 1, None, None] * matrix[:, 0]
                for j in range(1, dim):
                    matrix[node, k, node, j] += equations.curvature[:, k - 1, j - 1]
            matrix = matrix.reshape(n * dim, n * dim)
            change = equations.change.reshape(-1).copy()
            free = np.flatnonzero(~equations.prescribed.reshape(-1))
            rhs = equations.force.reshape(-1)[free] - matrix[free] @ change
            change[free] = self._dense(matrix[np.ix_(free, free)], rhs)
            return self.condensed.complete(self._particular, change)

    def _dense(self, matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
        if not len(rhs):
            return rhs
        norm = np.abs(matrix).sum(axis=0).max()
        factors, pivots, info = linalg.lapack.dgetrf(matrix)
        rcond = linalg.lapack.dgecon(factors, norm)[0] if info == 0 else 0.0
        if not rcond > self.SINGULAR:
            raise np.linalg.LinAlgError(f"the condensed equations are singular: reciprocal condition {rcond:.1e}")
        return linalg.lapack.dgetrs(factors, pivots, rhs)[0]


@dataclass(eq=False)
class SparseSteps:
    """Steps on the sparse matrix, of which only rows (and eliminated columns) of contact nodes change.

    Parameters
    ----------
    local : LocalProblem
    linear : LinearSolver
    run : Run
    """

    local: LocalProblem
    linear: LinearSolver
    run: Run
    _matrix: sparse.bsr_array = field(init=False)
    _rows: np.ndarray = field(init=False)
    _residual: np.ndarray = field(init=False)
    _prepared: Prepared | None = field(default=None, init=False)
    _prepared_for: tuple[bytes, float] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        self._matrix = self.local.system.matrix
        self._rows = np.repeat(np.arange(self.local.system.n_nodes), np.diff(self._matrix.indptr))

    @property
    def stiffness(self) -> np.ndarray:
        """See :class:`Steps`."""
        system = self.local.system
        return self._matrix.diagonal().reshape(-1, system.dim)[system.nodes]

    def contact_residual(self, residual: np.ndarray) -> np.ndarray:
        """The rows of the contact nodes; see :class:`Steps`."""
        self._residual = residual
        return residual.reshape(-1, self.local.system.dim)[self.local.system.nodes]

    def solve(self, equations: Linearised, rtol: float, spring: float) -> np.ndarray:
        """See :class:`Steps`."""
        system = self.local.system
        prescribed = np.zeros((system.n_nodes, system.dim), dtype=bool)
        prescribed[system.nodes] = equations.prescribed
        change = np.zeros((system.n_nodes, system.dim))
        change[system.nodes] = equations.change
        rhs = self._residual.reshape(-1, system.dim).copy()
        rhs[system.nodes] = equations.force
        rhs, change = rhs.reshape(-1), change.reshape(-1)
        with self.run.phase("setup"):
            matrix = self._contact_rows(equations, spring, coupled=True)
            if change.any():
                rhs -= matrix @ change
                self.run.count(1, system.nonzeros)
            rhs[prescribed.reshape(-1)] = 0.0
        self._prepare(equations, matrix, prescribed, spring)
        with self.run.phase("solve"):
            solution = solution_of(self.linear, self._prepared, rhs, rtol)
        self.run.count(solution.passes, system.nonzeros)
        if not solution.converged and not isinstance(self.linear, Direct):
            message = (f"{self.linear!r} stopped after {solution.iterations} iterations at a relative residual of "
                       f"{solution.residual:.1e}, wanted {rtol:.1e}: raise max_iterations, or take Direct()")
            if not spring:
                raise np.linalg.LinAlgError(message)
            _LOG.warning(message)
        return solution.unknowns + change

    def _prepare(self, equations: Linearised, matrix: sparse.bsr_array, prescribed: np.ndarray, spring: float) -> None:
        """Set up the linear solver, unless the matrix is the one of the last step."""
        key = (equations.key, spring)
        if equations.same_matrix and key == self._prepared_for:
            return
        phase = "factorise" if isinstance(self.linear, Direct) else "setup"
        with self.run.phase(phase):
            released = prescribed.reshape(-1)
            eliminated = without_fixed(matrix, released, copy=False)
            symmetric, basis = equations.symmetric, None
            if not symmetric:
                basis = without_fixed(self._contact_rows(equations, spring, coupled=False), released, copy=False)
            modes = local_near_nullspace(self.local, released)
            self._prepared = self.linear.setup(eliminated, modes, symmetric=symmetric, preconditioner=basis,
                                               previous=self._prepared)
        self._prepared_for = key

    def _contact_rows(self, equations: Linearised, spring: float, coupled: bool) -> sparse.bsr_array:
        """The matrix with Coulomb coupling (if ``coupled``), curvature and springs in the rows of contact nodes."""
        system = self.local.system
        data = self._matrix.data.copy()
        contact = system.contact_of[self._rows]
        if spring:
            at = np.flatnonzero((contact >= 0) & (self._rows == self._matrix.indices))
            data[at] += spring * self.stiffness[contact[at]][:, :, None] * np.eye(system.dim)
        if coupled and not equations.symmetric:
            at = np.flatnonzero(contact >= 0)
            pull = (equations.coupling[:, None] * equations.direction)[contact[at]]
            data[at, 1:] -= pull[:, :, None] * data[at, :1]
        at = np.flatnonzero((contact >= 0) & (self._rows == self._matrix.indices))
        node = contact[at]
        data[at, 1:, 1:] += equations.curvature[node]
        return sparse.bsr_array((data, self._matrix.indices, self._matrix.indptr), shape=self._matrix.shape)
