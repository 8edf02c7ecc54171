"""The state of a contact node: the codes of results, and the finer ones that the solvers keep.

Results hold :class:`ContactState`. While they iterate, the solvers tell more: bit ``CLOSED``, set where the gap is
closed, and under ``TANGENTIAL`` one of ``FREE`` (no friction acts), ``HELD`` (no slip), ``SLIPS`` (2D: in the direction
of the tangent) and ``BACKWARDS`` (2D: against it). With the force p a node is OPEN where it is not closed or p = 0,
elsewhere STICK where it is held and SLIP otherwise: :func:`contact_states`.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

__all__ = ["BACKWARDS", "CLOSED", "FREE", "HELD", "OPEN", "SLIP", "SLIPS", "STICK", "TANGENTIAL", "ContactState",
           "contact_codes", "contact_states"]


class ContactState(IntEnum):
    """State of a contact node: open, touching and slipping, or touching and sticking."""

    OPEN = 0
    SLIP = 1
    STICK = 2


OPEN, SLIP, STICK = ContactState

CLOSED = 1
FREE, HELD, SLIPS, BACKWARDS = 0, 2, 4, 6
TANGENTIAL = 6


def contact_codes(closed: np.ndarray, held: np.ndarray, backwards: np.ndarray | bool = False) -> np.ndarray:
    """Codes (n,) int8 of nodes that are closed or not, and held or else slip; ``backwards`` counts where they slip."""
    return (np.where(held, HELD, np.where(backwards, BACKWARDS, SLIPS)) + CLOSED * closed).astype(np.int8)


def contact_states(codes: np.ndarray, normal_force: np.ndarray) -> np.ndarray:
    """States (n,) int8 of nodes with these codes and the compressive forces p (n,), N."""
    state = np.where(codes & TANGENTIAL == HELD, ContactState.STICK, ContactState.SLIP).astype(np.int8)
    state[(codes & CLOSED == 0) | (normal_force == 0)] = ContactState.OPEN
    return state
