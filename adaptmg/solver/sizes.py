r"""Sizes: what errors and residuals refer to, the energy of the displacement and the forces that act.

Unknowns count from the prescribed values: with :math:`\bar u` these, zero elsewhere, :math:`u = w + \bar u`. The jump
:math:`\bar u` has an energy that grows as the mesh is refined, and so have :math:`\|w\|_A` and
:math:`|A\bar u|`, to which nothing may be related. The displacement itself has

.. math:: \|u\|_A^2 = w^T(\bar b - r) + 2\,w^T A\bar u + \bar u^T A\bar u,

:math:`\bar b = b - A\bar u` the load of the unknowns and r their residual: no pass over the matrix. The forces are the
loads, the contact forces, and where displacements are prescribed the reactions :math:`(A u - b)` of the supports, for
which the rows of the matrix at fixed dofs are kept.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.discrete import DiscreteProblem
from adaptmg.smoother.system import rotate

__all__ = ["Sizes", "displacement_norm", "energy_norm", "euclidean_norm"]


def energy_norm(unknowns: np.ndarray, forces: np.ndarray) -> float:
    """sqrt(w' A w) from w and A w, 0 where rounding makes it negative."""
    # not through BLAS: its threads cost more than a short dot product gains, several times over on a busy machine
    return float(np.sqrt(max(float(np.einsum("i,i->", unknowns, forces)), 0.0)))


def euclidean_norm(vector: np.ndarray) -> float:
    """|v| of a flat vector, on one thread."""
    return energy_norm(vector, vector)


def displacement_norm(problem: DiscreteProblem, displacement: np.ndarray) -> float:
    """||u||_A of a displacement (n_dofs,), prescribed values included; Cartesian, between bodies relative."""
    flat = np.asarray(displacement, dtype=np.float64).reshape(-1)
    return energy_norm(flat, problem.matrix @ flat)


class Sizes:
    """Of the iterates of one problem.

    Parameters
    ----------
    problem : DiscreteProblem
    frames : (n_contact, dim, dim) array, optional
        Contact frames, if the unknowns are in local components.

    Attributes
    ----------
    load : float
        |b|, N.
    prescribed : bool
        Whether a displacement other than zero is prescribed.
    """

    #: forces below so many times the rounding of a residual are none
    IDLE = 1e3

    def __init__(self, problem: DiscreteProblem, frames: np.ndarray | None = None) -> None:
        self.load = euclidean_norm(problem.load)
        self.prescribed = bool(problem.fixed_values.any())
        if not self.prescribed:
            return
        self._problem, self._frames = problem, frames
        lift = problem.matrix @ problem.fixed_values
        self._jump = float(np.einsum("i,i->", problem.fixed_values, lift))
        self._rows = sparse.csr_array(problem.matrix)[np.flatnonzero(problem.fixed)]
        self._offset = (lift - problem.load)[problem.fixed]
        self._lift = lift if frames is None else rotate(lift, frames, problem.contact.nodes)

    def nothing_strains(self, forces: float, rounding: float, unknowns: np.ndarray) -> bool:
        """Whether all forces are rounding: bodies that their supports move, and nothing strains or holds.

        Nothing is relative to such forces. Unknowns that have run away have such forces too, but move further than the
        supports do.

        Parameters
        ----------
        forces : float
            The largest of their norms, N.
        rounding : float
            Of the residual, N.
        unknowns : (n_dofs,) array
            m.
        """
        if not self.prescribed or forces > self.IDLE * rounding:
            return False
        return bool(np.abs(unknowns).max(initial=0.0) <= 10 * np.abs(self._problem.fixed_values).max())

    def norm(self, unknowns: np.ndarray, energy: float) -> float:
        """||u||_A from the unknowns w (n_dofs,), zero at fixed dofs, and w'Aw (N m)."""
        if self.prescribed:
            energy += 2 * float(np.einsum("i,i->", unknowns, self._lift)) + self._jump
        return float(np.sqrt(max(energy, 0.0)))

    def forces(self, unknowns: np.ndarray, contact: float) -> float:
        """The largest of the norms of load, contact forces (given, N) and, where values are prescribed, reactions."""
        if not self.prescribed:
            return max(self.load, contact)
        if self._frames is not None:
            back = np.swapaxes(self._frames, 1, 2)
            unknowns = rotate(unknowns, back, self._problem.contact.nodes)
        return max(self.load, contact, euclidean_norm(self._rows @ unknowns + self._offset))
