"""Loads and supports by boundary or body name, in SI units.

Values are numbers, or vectorised functions of position (n, dim) -> (n,).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

import numpy as np

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks

FieldLike = float | Callable[[np.ndarray], np.ndarray]


def _components(name: str, values: Sequence[FieldLike]) -> tuple[FieldLike, ...]:
    entries = checks.listed(name, values, "numbers or functions, one a component")
    if len(entries) not in (2, 3):
        raise ValueError(f"{name} must have 2 or 3 components, got {len(entries)}")
    return tuple(checks.function_or(name, value) for value in entries)


def _check_name(name: str | None) -> None:
    if name is not None:
        checks.boundary_name("name", name)


@dataclass(frozen=True)
class Pressure:
    """Pressure on a boundary: traction ``-value * n``, n outward.

    Parameters
    ----------
    boundary : str
        Name of the boundary.
    value : float or callable
        Pa; positive pushes into the body.
    name : str, optional
        In load paths; default the boundary's.

    Examples
    --------
    >>> am.Pressure("top", 5e7).value
    50000000.0
    >>> ramp = am.Pressure("top", lambda x: 1e9 * x[:, 0])            # Pa, at points (n, dim)
    """

    boundary: str
    value: FieldLike
    _: KW_ONLY
    name: str | None = None

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)
        checks.convert(self, checks.function_or, "value")
        _check_name(self.name)


@dataclass(frozen=True)
class Traction:
    """Traction vector on a boundary.

    Parameters
    ----------
    boundary : str
        Name of the boundary.
    components : sequence of float or callable
        Cartesian components, Pa.
    name : str, optional
        In load paths; default the boundary's.

    Examples
    --------
    >>> am.Traction("top", (0.0, 1e6)).components
    (0.0, 1000000.0)
    """

    boundary: str
    components: tuple[FieldLike, ...]
    _: KW_ONLY
    name: str | None = None

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)
        checks.convert(self, _components, "components")
        _check_name(self.name)


@dataclass(frozen=True)
class BodyForce:
    """Force per volume on one body or all.

    Parameters
    ----------
    components : sequence of float or callable
        Cartesian components, N/m^3.
    body : str, optional
        Name of the body it acts on; all by default.
    name : str, optional
        In load paths; default the body's, or "body force".

    Examples
    --------
    >>> am.BodyForce((0.0, -9.81 * 7850)).components
    (0.0, -77008.5)
    """

    components: tuple[FieldLike, ...]
    body: str | None = None
    _: KW_ONLY
    name: str | None = None

    def __post_init__(self) -> None:
        checks.convert(self, _components, "components")
        if self.body is not None:
            checks.boundary_name("body", self.body)
        _check_name(self.name)


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
    name : str, optional
        In load paths; default the body's.

    Examples
    --------
    >>> am.InitialStrain("bolt", (0.0, -1e-3)).components
    (0.0, -0.001)
    """

    body: str
    components: tuple[FieldLike, ...]
    _: KW_ONLY
    name: str | None = None

    def __post_init__(self) -> None:
        checks.boundary_name("body", self.body)
        checks.convert(self, _components, "components")
        _check_name(self.name)

    @classmethod
    def thermal(cls, expansion: FieldLike | Sequence[FieldLike], temperature: FieldLike, *, body: str = "body",
                name: str | None = None) -> InitialStrain:
        """Return the strains of a change of temperature.

        Parameters
        ----------
        expansion : float, callable, or two or three of these
            Coefficient of expansion, 1/K: in all directions alike, or components as of the class.
        temperature : float or callable
            Temperature over that at which the body is free of stress, K.
        body : str
            Its name; a body alone is called "body".
        name : str, optional
            As of the class.

        Examples
        --------
        >>> am.InitialStrain.thermal(1.2e-5, 50.0).components
        (0.0006000000000000001, 0.0006000000000000001, 0.0006000000000000001)
        """
        alike = callable(expansion) or not isinstance(expansion, Sequence | np.ndarray)
        each = _components("expansion", (expansion,) * 3 if alike else expansion)
        rise = checks.function_or("temperature", temperature)
        return cls(body, tuple(_Product(one, rise) if callable(one) or callable(rise) else one * rise for one in each),
                   name=name)


@dataclass(frozen=True)
class _Product:
    """Two numbers or functions of position, multiplied."""

    first: FieldLike
    second: FieldLike

    def __call__(self, points: np.ndarray) -> np.ndarray:
        first, second = (checks.field(name, value, points) for name, value in (
            ("expansion", self.first), ("temperature", self.second)))
        return first * second


@dataclass(frozen=True, kw_only=True)
class Preload:
    """The force with which a bolt is tightened.

    An initial strain along the axis shortens the body until a cut across it carries the force;
    :func:`adaptmg.solve_path` finds it, and ``Result.motions`` has it. In a load path the force is reached in steps
    that change its factor; where the factor stays the bolt keeps its length, and its force follows the other loads.

    Parameters
    ----------
    body : str
        Name of the body, given by position or name.
    force : float
        Tension across the cut, N (plane: N/m; axisymmetric: of the whole section), > 0.
    axis : {"x", "y", "z"}
        The direction of the force; in axisymmetric problems "y".
    at : float, optional
        Where the cut is, by its coordinate along the axis, m; default the middle of the body.
    name : str, optional
        In load paths; default the body's.

    Examples
    --------
    >>> am.Preload("bolt", force=2e4, axis="y").force
    20000.0
    """

    body: str = field(kw_only=False)
    force: float
    axis: str
    at: float | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        checks.boundary_name("body", self.body)
        checks.convert(self, checks.quantity, "force", positive=True)
        checks.choice("axis", self.axis, ("x", "y", "z"))
        if self.at is not None:
            checks.convert(self, checks.quantity, "at")
        _check_name(self.name)

    @property
    def path_name(self) -> str:
        """The name in load paths."""
        return self.name or self.body

    @property
    def direction(self) -> int:
        """The number of the axis."""
        return "xyz".index(self.axis)

    def shortening(self, dim: int, strain: float = 1.0) -> InitialStrain:
        """Return the initial strain that shortens the body by a strain, 1 its whole length."""
        components = [0.0] * dim
        components[self.direction] = -float(strain)
        return InitialStrain(self.body, tuple(components), name=self.name)


Load = Pressure | Traction | BodyForce | InitialStrain | Preload


class _Holds:
    """What holds bodies: the base class of all supports."""

    boundary: str | None  # None at a point

    @property
    def place(self) -> str:
        """The name of the boundary, or the point."""
        return self.boundary

    def components(self, dim: int) -> tuple[FieldLike | None, ...]:
        """Return the prescribed components in ``dim`` dimensions."""
        return (None,) * dim


class _Prescribes(_Holds):
    """What prescribes x, y, z."""

    x: FieldLike | None
    y: FieldLike | None
    z: FieldLike | None
    name: str | None

    def _check(self) -> None:
        _check_name(self.name)
        names = [name for name in ("x", "y", "z", "normal") if getattr(self, name, None) is not None]
        checks.convert(self, checks.function_or, *names)
        if not names:
            raise ValueError(f"support on {self.place!r} fixes nothing: give x, y or z a displacement in m")

    def components(self, dim: int) -> tuple[FieldLike | None, ...]:
        """Return the prescribed components in ``dim`` dimensions."""
        if dim == 2 and self.z is not None:
            raise ValueError(f"support on {self.place!r}: z is prescribed in a 2D problem")
        return (self.x, self.y, self.z)[:dim]


class _AtPoint(_Holds):
    """What holds a node."""

    boundary: ClassVar[None] = None
    point: tuple[float, ...]
    body: str | None

    def _check_point(self) -> None:
        point = check_arrays.vector("point", self.point)
        if point.size not in (2, 3):
            raise ValueError(f"point must have 2 or 3 components, got {point.size}")
        object.__setattr__(self, "point", tuple(point.tolist()))
        if self.body is not None:
            checks.boundary_name("body", self.body)

    @property
    def place(self) -> str:
        """The point as text."""
        return f"point ({', '.join(f'{x:.6g}' for x in self.point)})"


@dataclass(frozen=True)
class Support(_Prescribes):
    """Prescribed displacement components on a boundary; ``None`` leaves a component free.

    Parameters
    ----------
    boundary : str
        Name of the boundary.
    x, y, z : float, callable or None
        Prescribed displacement, m; a function of position is taken at the nodes.
    normal : float, callable or None
        Prescribed displacement along the outward normal of the boundary, which must be plane, in any direction, m.
    name : str, optional
        In load paths; default the boundary's.

    Examples
    --------
    >>> am.Support("right", x=0).x
    0.0
    >>> roller = am.Support("slope", normal=0)                         # it slides along the slope
    """

    boundary: str
    x: FieldLike | None = None
    y: FieldLike | None = None
    z: FieldLike | None = None
    normal: FieldLike | None = None
    _: KW_ONLY
    name: str | None = None

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)
        self._check()


@dataclass(frozen=True)
class Symmetry(_Holds):
    """A plane of symmetry: no displacement normal to a boundary.

    Parameters
    ----------
    boundary : str
        Name of the boundary, which must be plane, in any direction.

    Examples
    --------
    >>> am.Symmetry("left").boundary
    'left'
    """

    boundary: str

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)


@dataclass(frozen=True)
class PointSupport(_Prescribes, _AtPoint):
    """Prescribed displacement components of the node at a point, against rigid motions.

    The stress at a node that carries a load grows without bound as meshes become finer: let it carry none.

    Parameters
    ----------
    point : sequence of float
        m. Every mesh must have a node there: graded meshes of plane domains do at points of straight edges.
    x, y, z : float, callable or None
        Prescribed displacement, m.
    body : str, optional
        Name of the body, where nodes of several lie at the point.
    name : str, optional
        In load paths; default the place, such as "point (0, 1)".

    Examples
    --------
    >>> am.PointSupport((0, 0), x=0).x
    0.0
    """

    point: tuple[float, ...]
    x: FieldLike | None = None
    y: FieldLike | None = None
    z: FieldLike | None = None
    body: str | None = None
    _: KW_ONLY
    name: str | None = None

    def __post_init__(self) -> None:
        self._check_point()
        self._check()


@dataclass(frozen=True)
class Spring(_Holds):
    """Springs between a boundary and the ground, an elastic foundation: traction ``-normal u_n n - tangential u_t``.

    Parameters
    ----------
    boundary : str
        Name of the boundary.
    normal, tangential : float or callable
        Stiffness along and across the normal, N/m^3 (Pa per m), >= 0.

    Examples
    --------
    >>> am.Spring("foot", normal=1e9).tangential
    0.0
    """

    boundary: str
    normal: FieldLike = 0.0
    tangential: FieldLike = 0.0

    def __post_init__(self) -> None:
        checks.boundary_name("boundary", self.boundary)
        checks.convert(self, checks.function_or, "normal", "tangential")
        _check_stiffness(self, "normal", "tangential")


@dataclass(frozen=True)
class PointSpring(_AtPoint):
    """Springs along the axes between the node at a point and the ground.

    Parameters
    ----------
    point : sequence of float
        m. Every mesh must have a node there: graded meshes of plane domains do at points of straight edges.
    x, y, z : float
        Stiffness, N/m (plane: per metre of thickness; axisymmetric: of the full circumference), >= 0.
    body : str, optional
        Name of the body, where nodes of several lie at the point.

    Examples
    --------
    >>> am.PointSpring((0, 0), y=1e9).y
    1000000000.0
    """

    point: tuple[float, ...]
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    body: str | None = None

    def __post_init__(self) -> None:
        self._check_point()
        checks.convert(self, checks.quantity, "x", "y", "z")
        _check_stiffness(self, "x", "y", "z")

    def components(self, dim: int) -> tuple[FieldLike | None, ...]:
        """Return None for each component: a spring prescribes none."""
        if dim == 2 and self.z:
            raise ValueError(f"spring at {self.place}: z has a stiffness in a 2D problem")
        return (None,) * dim


def _check_stiffness(spring: Spring | PointSpring, *names: str) -> None:
    values = [getattr(spring, name) for name in names]
    for name, value in zip(names, values, strict=True):
        if not callable(value) and not value >= 0:
            raise ValueError(f"{name} must be >= 0, got {value!r}")
    if not any(values):
        raise ValueError(f"the spring on {spring.place!r} has no stiffness: give {' or '.join(names)}")


AnySupport = Support | Symmetry | PointSupport | Spring | PointSpring
