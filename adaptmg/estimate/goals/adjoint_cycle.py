r"""AdjointCycle: a multigrid cycle on the adjoint matrix, not symmetric where nodes slip with Coulomb friction.

The finest matrix M is in local components with the dofs that cannot move decoupled, Z; with the frames F at contact
nodes and the nodal prolongation P the coarse spaces are those of

.. math:: \hat P = Z F P, \qquad M_c = \hat P^T M \hat P,

and on the levels below Galerkin matrices with P alone.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.estimate.goals.contact_state import LinearisedContact
from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.linear.linear_cycle import LinearCycle
from adaptmg.multigrid.linear.split_matrix import nodal_prolongations, split
from adaptmg.problem.index_arrays import indices_frozen
from adaptmg.transfer.galerkin import galerkin_product

__all__ = ["AdjointCycle"]


class _Counted:
    """Adds up the work, in passes over the finest matrix; see :class:`adaptmg.multigrid.correction.Recorder`."""

    def __init__(self, finest: int) -> None:
        self.finest, self.work_units = finest, 0.0

    def count(self, passes: float, nonzeros: int) -> None:
        self.work_units += passes * nonzeros / self.finest

    def visit(self, level: int, action: str, times: int = 1) -> None:
        pass


class AdjointCycle:
    """V-cycles for the adjoint problem, two symmetric sweeps a level.

    Parameters
    ----------
    hierarchy : Hierarchy
        At least two levels.
    contact : LinearisedContact
    matrix : bsr_array (n_dofs, n_dofs)
        On the finest level, in local components.
    trial : (n_dofs,) bool array
        Dofs that are not decoupled.
    """

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
