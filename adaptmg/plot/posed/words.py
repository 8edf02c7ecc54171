"""What pictures of posed problems say of laws, supports and loads, and the tractions that they draw."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg.plot.style import number, quoted, scaled
from adaptmg.problem import BodyForce, Coulomb, Frictionless, InitialStrain, Law, Pressure, Support, Traction, Tresca

__all__ = ["describe_law", "support_text", "surface_load_text", "tractions", "volume_load_text"]


def describe_law(law: Law) -> str:
    """A law in a few words: 'Coulomb, friction 0.3'."""
    if isinstance(law, Frictionless):
        return "frictionless contact"
    if isinstance(law, Coulomb):
        return f"Coulomb friction {_parameter(law.friction)}"
    if isinstance(law, Tresca):
        return f"Tresca limit {_parameter(law.limit, 'Pa')}"
    return f"contact ({type(law).__name__})"


def _parameter(value: object, unit: str = "") -> str:
    return "f(x)" if callable(value) else _quantity(float(value), unit) if unit else number(float(value))


def _quantity(value: float, unit: str) -> str:
    factor, unit = scaled(abs(value), unit)
    return f"{number(value * factor)} {unit}"


def support_text(support: Support, dim: int, axes: Sequence[str] = "xyz") -> str:
    """The prescribed components, a line each: '$u_x$ = 0'; equal ones together. ``axes`` are the names of the axes."""
    lines: dict[str, list[str]] = {}
    for axis, value in zip(axes, support.components(dim), strict=False):
        if value is not None:
            lines.setdefault("0" if value == 0 else _parameter(value, "m"), []).append(f"$u_{axis}$")
    return "\n".join(f"{' = '.join(names)} = {value}" for value, names in lines.items())


def surface_load_text(load: Pressure | Traction, traction: np.ndarray) -> str:
    """How large a load is whose tractions (n, dim), Pa, are known at some points: 'p = 2 MPa', '|t| up to 3 kPa'."""
    sizes = np.linalg.norm(traction, axis=1)
    largest = float(sizes.max())
    relation = "up to" if np.ptp(sizes) > 1e-9 * largest else "="
    given = load.value if isinstance(load, Pressure) and not callable(load.value) else largest
    return f"{'p' if isinstance(load, Pressure) else '|t|'} {relation} {_quantity(given, 'Pa')}"


def volume_load_text(load: BodyForce | InitialStrain, axes: Sequence[str] = "xyz") -> str:
    """What acts in a body, how much and in which: 'body force 3 kN/m³ in 'rod''."""
    where = "" if load.body is None else f" in {quoted(load.body)}"
    if isinstance(load, InitialStrain):
        parts = [f"$\\varepsilon_{axis}$ = {_parameter(value)}"
                 for axis, value in zip(axes, load.components, strict=False) if callable(value) or value != 0]
        return f"initial strain{where}\n{', '.join(parts) or '0'}"
    if any(map(callable, load.components)):
        return f"body force f(x){where}"
    size = float(np.linalg.norm(load.components))
    if len(load.components) == 2:
        return f"body force {_quantity(size, 'N/m³')}{where}"
    factor, unit = scaled(size, "N/m³")
    return f"body force ({', '.join(number(c * factor) for c in load.components)}) {unit}{where}"


def tractions(load: Pressure | Traction, x: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Tractions (n, dim), Pa, of a load at points (n, dim), m, with outward unit normals."""
    def at(value: object) -> np.ndarray:
        return np.broadcast_to(np.asarray(value(x) if callable(value) else value, dtype=float), len(x))

    if isinstance(load, Pressure):
        return -at(load.value)[:, None] * normals
    return np.stack([at(component) for component in load.components], axis=1)
