r"""The coarse correction problem, common to the paper's and the monotone correction.

At a fine iterate w with residual :math:`r = b - A w` (contact forces kept in it) the coarse unknown E solves

.. math:: \min_E\ \tfrac12 E^T A_c E - (\hat P^T r)^T E + \sum_k G_k\,|U_k + E_{t,k}|,\qquad E_{n,k} \le D_k,

steps d-g of the paper. The corrections differ in how they choose D (gap), U (slip) and G (sliding limit).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from adaptmg.problem import checks
from adaptmg.smoother.system import LocalSystem, NodalContact
from adaptmg.transfer.constraints import Supports

__all__ = ["Correction", "InitialContact", "Recorder", "correction_contact", "sliding_limit"]


@dataclass(frozen=True, eq=False)
class InitialContact:
    """What the first solution on a level leaves behind (the paper's U0 and G0).

    Attributes
    ----------
    slip : (n_contact, dim - 1) array
        m.
    limit : (n_contact,) array
        Sliding limit, N.
    """

    slip: np.ndarray
    limit: np.ndarray


class Correction(Protocol):
    """How contact data go to the next coarser level.

    Attributes
    ----------
    needs_initial : bool
        Whether the first coarse solutions must be computed and passed as ``initial``.
    """

    @property
    def needs_initial(self) -> bool: ...

    def transport(self, reach: Supports, opening: np.ndarray, slip: np.ndarray, limit: np.ndarray,
                  initial: InitialContact | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Coarse gap D, slip U and limit G.

        Parameters
        ----------
        reach : Supports
            Which fine contact nodes interpolate from each coarse one, and with which weights.
        opening : (n_contact fine,) array
            g0 - u_n >= 0, m.
        slip : (n_contact fine, dim - 1) array
            m.
        limit : (n_contact fine,) array
            Sliding limit, N.
        initial : InitialContact or None
            Of the coarse level.

        Returns
        -------
        gap (n_contact coarse,), slip (n_contact coarse, dim - 1), limit (n_contact coarse,)
        """


class Recorder(Protocol):
    """What the multigrid ingredients report to; :class:`adaptmg.solver.run.Run` is one."""

    def count(self, passes: float, nonzeros: int) -> None:
        """Count matrix passes."""

    def visit(self, level: int, action: str, times: int = 1) -> None:
        """Note an action on a level."""


def sliding_limit(system: LocalSystem, contact: NodalContact, residual: np.ndarray) -> np.ndarray:
    """s + mu p with p = max(0, r_n), r = b - A w (n_contact,), N."""
    normal_force = np.maximum(residual.reshape(-1, system.dim)[system.nodes, 0], 0.0)
    return contact.limit + contact.friction * normal_force


def correction_contact(correction: Correction, reach: Supports, system: LocalSystem, coarse: LocalSystem,
                       contact: NodalContact, unknowns: np.ndarray, residual: np.ndarray,
                       initial: InitialContact | None) -> NodalContact:
    """The contact data of the coarse correction problem at a fine iterate."""
    values = unknowns.reshape(-1, system.dim)[system.nodes]
    fine_slip = values[:, 1:] - contact.slip_reference
    # |E| is a bound of what a correction changes in a slip that is held along one tangent
    fine_slip[contact.driven] = 0.0
    gap, slip, limit = _transported(correction, coarse, correction.transport(
        reach, contact.gap - values[:, 0], fine_slip, sliding_limit(system, contact, residual), initial))
    slip = np.where(coarse.fixed.reshape(-1, coarse.dim)[coarse.nodes][:, 1:], 0.0, slip)
    return NodalContact(gap=gap, slip_reference=-slip, limit=limit, friction=np.zeros_like(limit))


def _transported(correction: Correction, coarse: LocalSystem, found: object) -> tuple[np.ndarray, ...]:
    """What a correction, a user's own perhaps, hands to the coarse contact nodes, its types and shapes checked."""
    n, name = len(coarse.nodes), f"correction: transport of {checks.shown(correction)}"
    if not isinstance(found, (tuple, list)) or len(found) != 3:
        raise TypeError(f"{name} must return gap, slip and limit, got {checks.shown(found)}")
    shapes = {"gap": (n,), "slip": (n, coarse.dim - 1), "limit": (n,)}
    for (what, shape), array in zip(shapes.items(), found, strict=True):
        if not isinstance(array, np.ndarray) or array.dtype != np.float64 or array.shape != shape:
            given = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else checks.shown(array)
            raise TypeError(f"{name} must return a {what} of float64 {shape}, coarse contact nodes first, got {given}")
    return tuple(found)
