"""From options to the problem of a case with another law: the same for the command line and for study files."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import adaptmg as am
from adaptmg.cli.choices import LawName

__all__ = ["posed"]


def posed(function: Callable[..., am.ContactProblem], law: LawName | None, friction: float | None,
          limit: float | None, flag: str = "--", **own: Any) -> am.ContactProblem:
    """The problem of a case; ValueError for options that do not belong together.

    Parameters
    ----------
    function : callable
        Of a case.
    law, friction, limit : optional
        Coefficient of friction; Tresca limit, Pa. None: that of the case.
    flag : str
        What options begin with in messages.
    own
        The case's own arguments.
    """
    if law is None and friction is None and limit is None:
        return function(**own)
    takes = function.__kwdefaults__ or {}
    if "law" not in takes:
        # a case whose bodies differ in friction: it takes coefficients
        if law not in (None, LawName.COULOMB) or friction is None or "friction" not in takes:
            raise ValueError(f"this case has Coulomb friction, its law cannot be changed: give {flag}friction alone")
        return function(friction=friction, **own)
    if law is None:
        law = LawName.TRESCA if friction is None else LawName.COULOMB
    for name, value, owner in (("friction", friction, LawName.COULOMB), ("limit", limit, LawName.TRESCA)):
        if law is owner and value is None:
            raise ValueError(f"{flag}law {law} needs {flag}{name}")
        if law is not owner and value is not None:
            raise ValueError(f"{flag}{name} belongs to {flag}law {owner}, not to {law}")
    made = {LawName.COULOMB: lambda: am.Coulomb(friction), LawName.TRESCA: lambda: am.Tresca(limit),
            LawName.FRICTIONLESS: am.Frictionless}
    return function(law=made[law](), **own)
