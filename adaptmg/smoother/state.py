"""The state of a contact node, as small integer codes that arrays hold."""

from __future__ import annotations

from enum import IntEnum

__all__ = ["OPEN", "SLIP", "STICK", "ContactState"]


class ContactState(IntEnum):
    """State of a contact node: open, touching and slipping, or touching and sticking."""

    OPEN = 0
    SLIP = 1
    STICK = 2


OPEN, SLIP, STICK = ContactState
