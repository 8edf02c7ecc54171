r"""RigidMotions: motions of a body that only contact holds, taken to the least energy.

A combination M of rigid motions that vanishes at the fixed dofs has A M = 0: the step M c changes no residual, only the
slips :math:`\tau_i` and gaps. With the load f, g = s + mu p frozen and the local values :math:`N_i, T_i` of M at the
contact nodes the energy changes by

.. math:: \phi(c) = -(M^T f)\cdot c + \sum_i g_i\,(|\tau_i + T_i c| - |\tau_i|),\qquad N_i c \le g_{0,i} - w_{n,i},

where c moves neither closed nodes along their normals nor sticking nodes at all. While such a c is left, truncated
coarse matrices are singular (2D) or nearly so (3D), and their corrections without bound. The minimum ends that: in 2D
it lies where an open node closes or a slip vanishes (the median of the slips, weighted with g), and that node then
holds the body; in 3D slips that are not parallel hold it too.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.multigrid.truncated.contact import TruncatedContact
from adaptmg.multigrid.truncated.rigid_contact import RigidContact, null_combinations

__all__ = ["RigidMotions"]

#: forces that count as zero, relative to the largest entry of the matrix
_ZERO = 1e-10


@dataclass(eq=False)
class RigidMotions:
    """The rigid motions of one level that its supports leave free.

    Attributes
    ----------
    problem : DiscreteProblem
    contact : TruncatedContact
        Its values are kept equal to the unknowns.
    load : (n_dofs,) array
        f.
    coefficients : (k, m) array
        Of the motions, in the columns of ``problem.near_nullspace``.
    at_contact : (n_contact, dim, m) array
        Their local values N_i, T_i at the contact nodes.
    """

    problem: DiscreteProblem
    contact: TruncatedContact
    load: np.ndarray
    coefficients: np.ndarray
    at_contact: np.ndarray
    _work: np.ndarray | None = field(default=None, init=False)

    #: steps at most
    STEPS: ClassVar[int] = 30

    @classmethod
    def of(cls, problem: DiscreteProblem, contact: TruncatedContact, load: np.ndarray) -> RigidMotions | None:
        """The free motions of a problem, None if it has none or nothing is known of them."""
        modes, dim = problem.near_nullspace, problem.dim
        if modes is None or not len(contact.nodes):
            return None
        coefficients = null_combinations(modes[problem.fixed])
        if not coefficients.shape[1]:
            return None
        cartesian = modes.reshape(-1, dim, modes.shape[1])[contact.nodes] @ coefficients
        return cls(problem, contact, load, coefficients,
                   np.einsum("nij,njk->nik", contact.frames.reshape(-1, dim, dim), cartesian))

    def settle(self, unknowns: np.ndarray, past: list[np.ndarray], defect: np.ndarray) -> int:
        """Move to the least energy, in place.

        Parameters
        ----------
        unknowns : (n_dofs,) array
            Cartesian, admissible, those of the contact.
        past : list of (n_dofs,) arrays
            Iterates that are moved alike.
        defect : (n_dofs,) array
            f - A u.

        Returns
        -------
        int
            Steps taken; 0 if the contact status leaves no motion free.
        """
        contact = RigidContact.of(self.contact, self.at_contact, defect)
        total, steps = np.zeros(self.at_contact.shape[2]), 0
        while steps < self.STEPS:
            free = contact.free()
            if not free.shape[1] or not self._strainless():
                break
            change = contact.step(free, self._work)
            if change is None:
                break
            total += change
            steps += 1
        if steps:
            self._move(total, unknowns, past)
        return steps

    def _strainless(self) -> bool:
        """Whether A M = 0, looked at when it first matters; if not, the motions are given up."""
        if self._work is None:
            motions = self.problem.near_nullspace @ self.coefficients
            forces = self.problem.matrix @ motions
            forces[self.problem.fixed] = 0.0
            scale = np.abs(self.problem.matrix.diagonal()).max() * np.abs(motions).max(axis=0)
            if (np.abs(forces).max(axis=0) > _ZERO * scale).any():
                self.at_contact = self.at_contact[:, :, :0]
                return False
            self._work = motions.T @ self.load
        return True

    def _move(self, change: np.ndarray, unknowns: np.ndarray, past: list[np.ndarray]) -> None:
        """Carry out a motion (m,), which the values of the contact have made already."""
        o = self.contact
        step = self.problem.near_nullspace @ (self.coefficients @ change)
        step[self.problem.fixed] = 0.0
        for vector in (unknowns, *past):
            vector += step
        # equal but for rounding; gaps and slips that vanish must do so to the bit
        values = np.einsum("nji,nj->ni", o.frames.reshape(-1, o.dim, o.dim), o.values.reshape(-1, o.dim))
        at = unknowns.reshape(-1, o.dim)
        at[o.nodes] = np.where(self.problem.fixed.reshape(-1, o.dim)[o.nodes], 0.0, values)

