"""Words in pictures: laws, supports, loads."""

from __future__ import annotations

from collections.abc import Sequence

from adaptmg.plot.style import number, scaled
from adaptmg.problem import Coulomb, Frictionless, Law, Support, Tresca

__all__ = ["describe_law", "support_text"]


def describe_law(law: Law) -> str:
    """A law in a few words: 'Coulomb, friction 0.3'."""
    if isinstance(law, Frictionless):
        return "frictionless contact"
    if isinstance(law, Coulomb):
        return f"Coulomb friction {_parameter(law.friction)}"
    if isinstance(law, Tresca):
        if callable(law.limit):
            return "Tresca limit f(x)"
        factor, unit = scaled(float(law.limit), "Pa")
        return f"Tresca limit {number(float(law.limit) * factor)} {unit}"
    return f"contact ({type(law).__name__})"


def _parameter(value: object) -> str:
    return "f(x)" if callable(value) else number(float(value))


def support_text(support: Support, dim: int, axes: Sequence[str] = "xyz") -> str:
    """The prescribed components, a line each: '$u_x$ = 0'; equal ones together. ``axes`` are the names of the axes."""
    lines: dict[str, list[str]] = {}
    for axis, value in zip(axes, support.components(dim), strict=False):
        if value is not None:
            factor, unit = scaled(abs(value), "m")
            lines.setdefault("0" if value == 0 else f"{number(value * factor)} {unit}", []).append(f"$u_{axis}$")
    return "\n".join(f"{' = '.join(names)} = {value}" for value, names in lines.items())
