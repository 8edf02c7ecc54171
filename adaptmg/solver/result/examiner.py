"""Examiner: what a displacement is, whatever method it comes from.

Residual, reactions, contact quantities and certificate on the finest level, from the matrix as it was given: one
product with it, and rotations at the contact nodes alone. The last displacement examined is remembered, since a method
that asks before it stops returns the same one.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.smoother.residuals import natural_at_nodes
from adaptmg.smoother.system import contact_blocks, held_tangents, local_contact
from adaptmg.solver.certificate import Certificate, certify
from adaptmg.solver.result.contact_quantities import contact_result
from adaptmg.solver.result.contact_result import ContactResult
from adaptmg.solver.sizes import ROUNDING, Sizes, euclidean_norm

__all__ = ["Examined", "Examiner"]


@dataclass(frozen=True, eq=False)
class Examined:
    """What was found.

    Attributes
    ----------
    displacement, reaction : (n_nodes, dim) arrays
        Of the bodies, m and N.
    contact : ContactResult
    residual : float
        Natural, relative to the forces that act.
    checked : Certificate
    """

    displacement: np.ndarray
    reaction: np.ndarray
    contact: ContactResult
    residual: float
    checked: Certificate


class Examiner:
    """Examines displacements of one problem.

    Parameters
    ----------
    discrete : DiscreteProblem

    Attributes
    ----------
    contact : NodalContact
    frames : (n_contact, dim, dim) array
    blocks : (n_contact, dim, dim) array
        Diagonal blocks at the contact nodes, local components.
    """

    def __init__(self, discrete: DiscreteProblem) -> None:
        self.discrete = discrete
        self.contact, self.frames = local_contact(discrete)
        self.held = held_tangents(discrete, self.frames)
        self.blocks = contact_blocks(discrete, self.contact, self.frames)
        self.sizes = Sizes(discrete)
        self._last: tuple[np.ndarray, Examined] | None = None

    def at_step(self, discrete: DiscreteProblem) -> Examiner:
        """For the same bodies under other data (a load step)."""
        result = copy.copy(self)
        result.discrete, result._last = discrete, None
        result.contact, _ = local_contact(discrete)
        result.sizes = Sizes(discrete)
        return result

    def relative_residual(self, solved: np.ndarray) -> float:
        """Natural residual of a displacement (n_dofs,), relative coordinates, over the forces that act.

        The largest of load, contact forces and, where displacements are prescribed, reactions, in Euclidean norms; 1 if
        it is all there is.
        """
        solved = np.asarray(solved, dtype=np.float64).reshape(-1)
        return self._residual(solved, self.discrete.load - self.discrete.matrix @ solved)

    def _at_contact(self, vector: np.ndarray) -> np.ndarray:
        """Local components (n_contact, dim) of a vector (n_dofs,), zero along what is held."""
        return self._local(vector.reshape(-1, self.discrete.dim)[self.discrete.contact.nodes])

    def _local(self, at: np.ndarray) -> np.ndarray:
        local = np.einsum("nij,nj->ni", self.frames, at)
        local[:, 1:][self.held] = 0.0
        return local

    def _values(self, solved: np.ndarray) -> np.ndarray:
        nodes, shape = self.discrete.contact.nodes, (-1, self.discrete.dim)
        return self._local(solved.reshape(shape)[nodes] - self.discrete.fixed_values.reshape(shape)[nodes])

    def _residual(self, solved: np.ndarray, defect: np.ndarray) -> float:
        discrete = self.discrete
        free = np.where(discrete.fixed, 0.0, defect)
        at_contact = self._at_contact(free)
        natural = natural_at_nodes(self.contact, self.blocks, self._values(solved), at_contact)
        free.reshape(-1, discrete.dim)[discrete.contact.nodes] = natural
        unknowns = np.where(discrete.fixed, 0.0, solved) if self.sizes.prescribed else solved
        scale, size = self.sizes.forces(unknowns, euclidean_norm(at_contact.reshape(-1))), euclidean_norm(free)
        if self.sizes.prescribed:
            floor = ROUNDING * euclidean_norm(discrete.matrix.diagonal() * unknowns)
            if size <= floor and self.sizes.nothing_strains(scale, floor, unknowns):
                return 0.0
        return 0.0 if size == 0.0 else size / (scale or size)

    def __call__(self, solved: np.ndarray) -> Examined:
        """Examine a displacement (n_nodes, dim) or (n_dofs,), between bodies in relative coordinates, m."""
        solved = np.array(solved, dtype=np.float64).reshape(-1)
        if self._last is not None and np.array_equal(self._last[0], solved):
            return self._last[1]
        discrete = self.discrete
        images = discrete.matrix @ solved
        defect = discrete.load - images
        reaction = -defect if discrete.coupling is None else discrete.coupling.physical_forces(-defect)
        nodal = solved.reshape(discrete.n_nodes, discrete.dim)
        displacement = discrete.physical(nodal)
        contact = contact_result(discrete, self.contact, self.frames, self.held, nodal, self._values(solved),
                                 -self._at_contact(defect))
        found = Examined(displacement, reaction.reshape(nodal.shape), contact, self._residual(solved, defect),
                         certify(discrete, displacement, contact, images=images))
        self._last = solved, found
        return found
