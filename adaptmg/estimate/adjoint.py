r"""The adjoint problem: what a force at any place changes in the quantity asked for.

With trial vectors E and test vectors T of :mod:`adaptmg.estimate.contact_state` and the functional j,

.. math:: E^T (A + H)\,T\,y = E^T j, \qquad z = T y,

the transpose of the linearised contact problem :math:`T^T (A + H) E`. It is solved by GMRES (Y. Saad, M. H. Schultz,
SIAM J. Sci. Stat. Comput. 7, 1986), preconditioned by a multigrid cycle on the same matrix, or directly where it is
small or there is one level only.

AdjointCycle: a multigrid cycle on the adjoint matrix, not symmetric where nodes slip with Coulomb friction.

The finest matrix M is in local components with the dofs that cannot move decoupled, Z; with the frames F at contact
nodes and the nodal prolongation P the coarse spaces are those of

.. math:: \hat P = Z F P, \qquad M_c = \hat P^T M \hat P,

and on the levels below Galerkin matrices with P alone.

The algebraic part of the error of a quantity: what the solver has left of the discrete equations.

With the residual r = A u - b, the slip force s f of Tresca's law, and the defects :math:`\delta` of what is prescribed
(a gap left where bodies touch, a slip where they stick), the discrete solution and this u differ by

.. math:: J(u_h) - J(u) \approx -z \cdot r + \sum_{\mathrm{slip}} s\, f \cdot z_t - \lambda^* \cdot \delta, \qquad
          \lambda^* = A z - j .

It is of first order in the algebraic error, where the discretisation error of a quantity is of second order in the
energy error: solvers must go further for a quantity than for the energy.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, gmres, splu

from adaptmg._check_arrays import indices_frozen
from adaptmg.estimate.contact_state import LinearisedContact
from adaptmg.estimate.goal_view import Functional, GoalView
from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.linear_cycle import LinearCycle
from adaptmg.multigrid.split_matrix import nodal_prolongations, split
from adaptmg.smoother.system import ContactState as State
from adaptmg.smoother.system import local_system
from adaptmg.transfer.galerkin import galerkin_product

__all__ = ["AdjointCycle", "AdjointSolution", "AdjointSystem", "adjoint_system", "algebraic_part"]

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class AdjointSolution:
    """A dual field."""

    field: np.ndarray  # (n_dofs,): z in the unknowns of the problem, Cartesian, m/N times the unit of the quantity
    residual: float  # euclidean, over that of the functional
    iterations: int  # 0 of a direct solution
    converged: bool  # whether the residual is below the tolerance asked for


@dataclass(frozen=True, eq=False)
class AdjointSystem:
    """The adjoint matrix in local components."""

    contact: LinearisedContact
    matrix: sparse.bsr_array  # bsr_array (n_dofs, n_dofs)
    trial: np.ndarray  # (n_dofs,) bool: dofs that an error has
    test: sparse.csr_array  # csr_array (n_dofs, n_dofs): T on them

    def direct(self, functionals: list[np.ndarray]) -> list[AdjointSolution]:
        """Dual fields of functionals (n_dofs,), by one sparse factorisation."""
        kept = np.flatnonzero(self.trial)
        reduced = sparse.csc_array(sparse.csr_array(self.matrix)[kept][:, kept])
        try:
            factors = splu(reduced)
        except RuntimeError as error:
            raise np.linalg.LinAlgError(
                "the adjoint matrix is singular: with its contact state the solution leaves a motion free; solve more "
                "accurately, or add a support") from error
        result = []
        for functional in functionals:
            load, y = self._load(functional), np.zeros(len(self.trial))
            y[kept] = factors.solve(load[kept])
            residual = self._relative(load, y)
            result.append(AdjointSolution(self._field(y), residual, 0, residual <= 1e-6))
        return result

    def multigrid(self, hierarchy: Hierarchy, functionals: list[np.ndarray], rtol: float, max_iterations: int
                  ) -> list[AdjointSolution]:
        """Dual fields of functionals (n_dofs,), by GMRES with a multigrid cycle."""
        cycle, n = AdjointCycle(hierarchy, self.contact, self.matrix, self.trial), len(self.trial)
        preconditioner = LinearOperator((n, n), matvec=cycle.apply, dtype=np.float64)
        result = []
        for functional in functionals:
            load, norms = self._load(functional), []
            # scipy measures the residual of the preconditioned system: asked for more until the true one is small
            y, asked = np.zeros(n), rtol
            for _ in range(3):
                y, _ = gmres(self.matrix, load, x0=y, rtol=asked, atol=0.0, restart=min(max_iterations, 30),
                             maxiter=max(1, max_iterations // 30), M=preconditioner, callback=norms.append,
                             callback_type="pr_norm")
                residual = self._relative(load, y)
                if residual <= rtol or len(norms) >= max_iterations:
                    break
                asked *= 0.1
            if residual > rtol:
                _LOG.info("the adjoint problem was solved to %.1e, not %.1e, in %d iterations", residual, rtol,
                          len(norms))
            result.append(AdjointSolution(self._field(y), residual, len(norms), residual <= rtol))
        return result

    def _load(self, functional: np.ndarray) -> np.ndarray:
        return np.where(self.trial, self.contact.local(functional), 0.0)

    def _field(self, y: np.ndarray) -> np.ndarray:
        return self.contact.cartesian(self.test @ np.where(self.trial, y, 0.0))

    def _relative(self, load: np.ndarray, y: np.ndarray) -> float:
        size = float(np.linalg.norm(load))
        residual = float(np.linalg.norm(np.where(self.trial, load - self.matrix @ y, 0.0)))
        return residual / size if size > 0 else residual


def adjoint_system(contact: LinearisedContact) -> AdjointSystem:
    """The adjoint system of linearised contact conditions."""
    local, dim = local_system(contact.discrete), contact.discrete.dim
    matrix, n = sparse.csr_array(local.system.matrix), contact.discrete.n_dofs
    at = contact.nodes[:, None] * dim + np.arange(dim)
    if contact.hessian.any():
        rows, columns = np.broadcast_arrays(at[:, 1:, None], at[:, None, 1:])
        matrix = matrix + sparse.csr_array((contact.hessian.ravel(), (rows.ravel(), columns.ravel())), shape=(n, n))
    trial = ~local.system.fixed
    trial[at[~contact.free]] = False
    node, k = np.nonzero(contact.direction)
    node, k = node[trial[at[node, 1 + k]]], k[trial[at[node, 1 + k]]]
    every = np.flatnonzero(trial)
    test = sparse.csr_array((np.concatenate([np.ones(len(every)), contact.direction[node, k]]),
                             (np.concatenate([every, at[node, 0]]), np.concatenate([every, at[node, 1 + k]]))),
                            shape=(n, n))
    keep = sparse.diags_array(trial.astype(float), format="csr")
    product = keep @ matrix @ test + sparse.diags_array((~trial).astype(float), format="csr")
    matrix = sparse.bsr_array(sparse.csr_array(product), blocksize=(dim, dim)).sorted_indices()
    return AdjointSystem(contact, matrix, trial, test)


class _Counted:
    """Adds up the work, in passes over the finest matrix; see :class:`adaptmg.multigrid.corrections.Recorder`."""

    def __init__(self, finest: int) -> None:
        self.finest, self.work_units = finest, 0.0

    def count(self, passes: float, nonzeros: int) -> None:
        self.work_units += passes * nonzeros / self.finest

    def visit(self, level: int, action: str, times: int = 1) -> None:
        pass


class AdjointCycle:
    """V-cycles for the adjoint problem, two symmetric sweeps a level."""

    def __init__(self, hierarchy: Hierarchy, contact: LinearisedContact, matrix: sparse.bsr_array,
                 trial: np.ndarray) -> None:
        levels, dim = hierarchy.levels, contact.discrete.dim
        prolongation = _rotated(levels[-1].prolongation, contact, trial)
        coarse = levels[-2].discrete
        split_levels = [split(matrix, ~trial)]
        matrix = _with_diagonal(sparse.csr_array(prolongation.T @ sparse.csr_array(matrix) @ prolongation), dim)
        split_levels.insert(0, split(matrix, coarse.fixed))
        prolongations = [prolongation]
        for nodal, below in zip(reversed(nodal_prolongations(hierarchy)[:-1]), reversed(levels[:-2]), strict=True):
            matrix = galerkin_product(matrix, nodal)
            split_levels.insert(0, split(matrix, below.discrete.fixed))
            prolongations.insert(0, nodal)
        self.number = len(split_levels) - 1
        self.recorder = _Counted(split_levels[-1].nonzeros)
        self.cycle = LinearCycle(split_levels, prolongations, self.recorder, [2] * len(split_levels))
        self.cycle.renew(self.number)

    def apply(self, load: np.ndarray) -> np.ndarray:
        """One cycle from zero for a load (n_dofs,) in local components."""
        self.cycle.vectors(self.number).load[:] = load.reshape(-1)
        return self.cycle.solve(self.number).copy()


def _rotated(nodal: sparse.csr_array, contact: LinearisedContact, trial: np.ndarray) -> sparse.csr_array:
    """Z F P by dofs, columns sorted."""
    n, dim = contact.discrete.n_nodes, contact.discrete.dim
    frames = np.broadcast_to(np.eye(dim), (n, dim, dim)).copy()
    frames[contact.nodes] = contact.frames
    rotation = sparse.bsr_array((frames, np.arange(n), np.arange(n + 1)), shape=(n * dim, n * dim))
    keep = sparse.diags_array(trial.astype(float), format="csr")
    result = sparse.csr_array(keep @ sparse.csr_array(rotation) @ sparse.kron(nodal, sparse.eye_array(dim),
                                                                             format="csr"))
    result.eliminate_zeros()
    result.sort_indices()
    return indices_frozen(result)


def _with_diagonal(matrix: sparse.csr_array, dim: int) -> sparse.bsr_array:
    """In blocks; dofs that nothing reaches get a diagonal."""
    diagonal = matrix.diagonal()
    empty = np.where(diagonal == 0, np.abs(diagonal).max(), 0.0)
    full = matrix + sparse.diags_array(empty, format="csr")
    return sparse.bsr_array(sparse.csr_array(full), blocksize=(dim, dim)).sorted_indices()


def algebraic_part(view: GoalView, functional: Functional, dual: np.ndarray) -> float:
    """J of the discrete solution minus J of the result, in the unit of the quantity."""
    contact, discrete = view.contact, view.posed.discrete
    dim, nodes, state = discrete.dim, contact.nodes, contact.state
    residual = np.where(discrete.fixed, 0.0, contact.residual)
    z = contact.local(dual).reshape(-1, dim)[nodes]
    reaction = contact.local(discrete.matrix @ dual - functional.vector).reshape(-1, dim)[nodes]
    part = -float(dual @ residual)
    part += float(np.sum(np.where(contact.slips, contact.fixed_limit, 0.0) * np.sum(contact.unit * z[:, 1:], axis=1)))
    touches, sticks = state != State.OPEN, contact.sticks[:, None] & ~contact.held
    part -= float(np.sum(np.where(touches & np.isfinite(contact.gap), reaction[:, 0] * contact.gap, 0.0)))
    return part + float(np.sum(np.where(sticks, reaction[:, 1:] * contact.slip, 0.0)))
