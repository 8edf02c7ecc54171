"""Loads and supports by boundary or body name, in SI units.

Values are numbers, or vectorised functions of position (n, dim) -> (n,).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from adaptmg import _checks as checks

__all__ = ["BodyForce", "InitialStrain", "Load", "Pressure", "Support", "Traction"]

FieldLike = float | Callable[[np.ndarray], np.ndarray]


def _components(name: str, values: Sequence[FieldLike]) -> tuple[FieldLike, ...]:
    entries = checks.listed(name, values, "numbers or functions, one a component")
    if len(entries) not in (2, 3):
        raise ValueError(f"{name} must have 2 or 3 components, got {len(entries)}")
    return tuple(checks.function_or(name, value) for value in entries)


@dataclass(frozen=True)
class Pressure:
    """Pressure on a boundary: traction ``-value * n``, n outward.

    Parameters
    ----------
    boundary : str
        Name of the boundary.
    value : float or callable
        Pa; positive pushes into the body.

    Examples
    --------
    >>> am.Pressure("top", 5e7).value
    50000000.0
    >>> ramp = am.Pressure("top", lambda x: 1e9 * x[:, 0])            # Pa, at points (n, dim)
    """

    boundary: str
    value: FieldLike

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)
        checks.convert(self, checks.function_or, "value")


@dataclass(frozen=True)
class Traction:
    """Traction vector on a boundary.

    Parameters
    ----------
    boundary : str
        Name of the boundary.
    components : sequence of float or callable
        Cartesian components, Pa.

    Examples
    --------
    >>> am.Traction("top", (0.0, 1e6)).components
    (0.0, 1000000.0)
    """

    boundary: str
    components: tuple[FieldLike, ...]

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)
        checks.convert(self, _components, "components")


@dataclass(frozen=True)
class BodyForce:
    """Force per volume on one body or all.

    Parameters
    ----------
    components : sequence of float or callable
        Cartesian components, N/m^3.
    body : str, optional
        Name of the body it acts on; all by default.

    Examples
    --------
    >>> am.BodyForce((0.0, -9.81 * 7850)).components
    (0.0, -77008.5)
    """

    components: tuple[FieldLike, ...]
    body: str | None = None

    def __post_init__(self) -> None:
        checks.convert(self, _components, "components")
        if self.body is not None:
            checks.boundary_name("body", self.body)


@dataclass(frozen=True)
class InitialStrain:
    r"""Stress-free strain of one body: thermal expansion, the imposed shortening of a bolt.

    The stress is :math:`\sigma = C (\varepsilon - \varepsilon_0)`, the load
    :math:`\int C \varepsilon_0 : \varepsilon(v)`.

    Parameters
    ----------
    body : str
        Name of the body.
    components : sequence of float or callable
        Normal strains; shear strains are zero. In 2D (xx, yy) or (xx, yy, zz), axisymmetric (rr, zz) or (rr, zz,
        hoop), the third being 0 where it is left out; in 3D (xx, yy, zz). Negative shortens.

    Examples
    --------
    >>> am.InitialStrain("bolt", (0.0, -1e-3)).components
    (0.0, -0.001)
    """

    body: str
    components: tuple[FieldLike, ...]

    def __post_init__(self) -> None:
        checks.boundary_name("body", self.body)
        checks.convert(self, _components, "components")


Load = Pressure | Traction | BodyForce | InitialStrain


@dataclass(frozen=True)
class Support:
    """Prescribed displacement components on a boundary; ``None`` leaves a component free.

    Parameters
    ----------
    boundary : str
        Name of the boundary.
    x, y, z : float, callable or None
        Prescribed displacement, m; a function of position is taken at the nodes.

    Examples
    --------
    >>> am.Support("right", x=0).x
    0.0
    """

    boundary: str
    x: FieldLike | None = None
    y: FieldLike | None = None
    z: FieldLike | None = None

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)
        for name in "xyz":
            if getattr(self, name) is not None:
                checks.convert(self, checks.function_or, name)
        if self.x is None and self.y is None and self.z is None:
            raise ValueError(f"support on {self.boundary!r} fixes nothing: give x, y or z a displacement in m")

    def components(self, dim: int) -> tuple[FieldLike | None, ...]:
        """The prescribed components in ``dim`` dimensions."""
        if dim == 2 and self.z is not None:
            raise ValueError(f"support on {self.boundary!r}: z is prescribed in a 2D problem")
        return (self.x, self.y, self.z)[:dim]
