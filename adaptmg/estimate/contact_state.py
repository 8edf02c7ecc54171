r"""LinearisedContact: the converged contact conditions: in which directions errors and dual fields may move.

With the normal n, a tangent t and the direction f of the friction force on the body, the condition of a slipping node
is :math:`r_t - \mu p f = 0`, r = A u - b, p = -r_n. An error of the displacement therefore has :math:`v_n = 0` where
bodies touch and :math:`v_t = 0` where they stick, and its equations are those of A, but of slipping nodes

.. math:: (A_t + H)\,v + \mu f A_n\,v, \qquad H = \frac{g}{|s|}\Bigl(I - \frac{s s^T}{|s|^2}\Bigr)

(H in 3D; slip s, limit g).
The dual field is a combination of these equations: :math:`z_t + \mu f\,n` in place of :math:`z_t`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.discrete.coordinates import rotate, rotate_back, to_frames
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.smoother.system import ContactState as State
from adaptmg.smoother.system import held_tangents, local_contact
from adaptmg.solver.result import Result

__all__ = ["LinearisedContact", "linearised_contact"]

#: slips below so much of the largest displacement are none
_STILL = 1e-12


@dataclass(frozen=True, eq=False)
class LinearisedContact:
    """The contact nodes of a solution, in local components (normal, tangents)."""

    discrete: DiscreteProblem
    frames: np.ndarray  # (n, dim, dim)
    state: np.ndarray  # (n,) int: am.OPEN, am.SLIP, am.STICK
    unknowns: np.ndarray  # (n_dofs,): of the problem (between bodies relative), Cartesian, m
    residual: np.ndarray  # (n_dofs,): A u - b, Cartesian, N
    gap: np.ndarray  # (n,), (n, dim - 1)s: m
    slip: np.ndarray  # (n,), (n, dim - 1)s: m
    force: np.ndarray  # (n, dim): contact forces in local components; force[:, 0] <= 0. N
    limit: np.ndarray  # (n,)s: of the friction, and the part of it that does not depend on the pressure, N
    fixed_limit: np.ndarray  # (n,)s: of the friction, and the part of it that does not depend on the pressure, N
    slips: np.ndarray  # (n,) bools
    sticks: np.ndarray  # (n,) bools
    unit: np.ndarray  # (n, dim - 1): f at slipping nodes
    direction: np.ndarray  # (n, dim - 1): mu f at nodes that slip and touch, else 0
    hessian: np.ndarray  # (n, dim - 1, dim - 1): H of slipping nodes, N/m
    free: np.ndarray  # (n, dim) bool: components in which an error may move
    held: np.ndarray  # (n, dim - 1) bool: tangents that a support holds

    @property
    def nodes(self) -> np.ndarray:
        """The contact nodes."""
        return self.discrete.contact.nodes

    def local(self, vector: np.ndarray) -> np.ndarray:
        """A Cartesian vector (n_dofs,) in local components at the contact nodes."""
        return rotate(vector, self.frames, self.nodes)

    def cartesian(self, vector: np.ndarray) -> np.ndarray:
        """The inverse of :meth:`local`."""
        return rotate_back(vector, self.frames, self.nodes)


def linearised_contact(discrete: DiscreteProblem, result: Result) -> LinearisedContact:
    """The contact conditions of a result, linearised."""
    nodal, frames = local_contact(discrete)
    dim, nodes = discrete.dim, discrete.contact.nodes
    unknowns = discrete.relative(result.displacement).reshape(-1)
    residual = discrete.matrix @ unknowns - discrete.load
    held = held_tangents(discrete, frames)
    moved = to_frames(frames, discrete.at_contact(unknowns) - discrete.contact.slip_reference)
    slip, gap = moved[:, 1:], nodal.gap - np.einsum(
        "nj,nj->n", frames[:, 0], discrete.from_prescribed(unknowns).reshape(-1, dim)[nodes])
    force = to_frames(frames, residual.reshape(-1, dim)[nodes])
    force[:, 1:][held] = 0.0
    state = np.asarray(result.contact.state).astype(int)
    length = np.linalg.norm(slip, axis=1)
    rubs = (state == State.OPEN) & (nodal.limit > 0)
    still = rubs & (length <= _STILL * np.abs(unknowns).max(initial=0.0))
    sticks, slips = (state == State.STICK) | still, (state == State.SLIP) | (rubs & ~still)
    limit = nodal.limit + nodal.friction * np.maximum(-force[:, 0], 0.0)
    unit = _opposite(slip, length, force[:, 1:])
    direction = np.where((state == State.SLIP)[:, None], nodal.friction[:, None] * unit, 0.0)
    bent = slips & (length > 0)
    stiffness = np.where(bent, limit / np.where(bent, length, 1.0), 0.0)
    hessian = stiffness[:, None, None] * (np.eye(dim - 1) - unit[:, :, None] * unit[:, None, :])
    free = np.ones((len(nodes), dim), dtype=bool)
    free[state != State.OPEN, 0] = False
    free[:, 1:] = ~held & ~sticks[:, None]
    return LinearisedContact(discrete, frames, state, unknowns, residual, gap, slip, force, limit, nodal.limit, slips,
                             sticks, unit, direction, hessian, free, held)


def _opposite(slip: np.ndarray, length: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Directions (n, dim - 1) against the slip; where there is none, of the force."""
    size = np.linalg.norm(force, axis=1)
    along = np.divide(force, size[:, None], out=np.zeros_like(slip), where=size[:, None] > 0)
    return np.divide(-slip, length[:, None], out=along, where=length[:, None] > 0)
