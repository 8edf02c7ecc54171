r"""The adjoint problem: what a force at any place changes in the quantity asked for.

With trial vectors E and test vectors T of :mod:`adaptmg.estimate.goals.contact_state` and the functional j,

.. math:: E^T (A + H)\,T\,y = E^T j, \qquad z = T y,

the transpose of the linearised contact problem :math:`T^T (A + H) E`. It is solved by GMRES (Y. Saad, M. H. Schultz,
SIAM J. Sci. Stat. Comput. 7, 1986), preconditioned by a multigrid cycle on the same matrix, or directly where it is
small or there is one level only.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, gmres, splu

from adaptmg.estimate.goals.adjoint_cycle import AdjointCycle
from adaptmg.estimate.goals.contact_state import LinearisedContact
from adaptmg.hierarchy import Hierarchy
from adaptmg.smoother.system import local_system

__all__ = ["AdjointSolution", "AdjointSystem", "adjoint_system"]

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class AdjointSolution:
    """A dual field.

    Attributes
    ----------
    field : (n_dofs,) array
        z in the unknowns of the problem, Cartesian, m/N times the unit of the quantity.
    residual : float
        Euclidean, over that of the functional.
    iterations : int
        0 of a direct solution.
    converged : bool
        Whether the residual is below the tolerance asked for.
    """

    field: np.ndarray
    residual: float
    iterations: int
    converged: bool


@dataclass(frozen=True, eq=False)
class AdjointSystem:
    """The adjoint matrix in local components.

    Attributes
    ----------
    contact : LinearisedContact
    matrix : bsr_array (n_dofs, n_dofs)
        E' (A + H) T, blown up to all dofs: other rows and columns are those of the unit matrix.
    trial : (n_dofs,) bool array
        Dofs that an error has.
    test : csr_array (n_dofs, n_dofs)
        T on them.
    """

    contact: LinearisedContact
    matrix: sparse.bsr_array
    trial: np.ndarray
    test: sparse.csr_array

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
        """Dual fields of functionals (n_dofs,), by GMRES with a multigrid cycle.

        Parameters
        ----------
        hierarchy : Hierarchy
            Whose finest level this is.
        functionals : list of (n_dofs,) arrays
        rtol : float
            Of the Euclidean residual over that of the functional.
        max_iterations : int
        """
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
