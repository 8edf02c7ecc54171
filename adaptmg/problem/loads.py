"""Loads and supports by boundary or body name, in SI units.

Values are numbers, or vectorised functions of position (n, dim) -> (n,).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import partial
from typing import Annotated, Any, ClassVar, Self, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg._checks import FieldLike, Name, Quantity, Size, Value

BODY_FORCE = "body force"  # name of body forces that act on all bodies


def _components(name: str, values: Sequence[FieldLike]) -> tuple[FieldLike, ...]:
    """Return 2 or 3 numbers or functions of position, checked."""
    entries = checks.listed(name, values, "numbers or functions, one a component")
    if len(entries) not in (2, 3):
        raise ValueError(f"{name} must have 2 or 3 components, got {len(entries)}")
    return tuple(checks.function_or(name, value) for value in entries)


def point(name: str, value: object) -> np.ndarray:
    """Return a read-only array of 2 or 3 coordinates."""
    result = checks.vector(name, value)
    if result.size not in (2, 3):
        raise ValueError(f"{name} must have 2 or 3 components, got {result.size}")
    return result


def _nonnegative(name: str, value: object) -> float:
    """Return a quantity; ValueError unless it is >= 0."""
    result = checks.quantity(name, value)
    if not result >= 0:
        raise ValueError(f"{name} must be >= 0, got {result!r}")
    return result


Components = Annotated[tuple[FieldLike, ...], _components]
Point = Annotated[tuple[float, ...], lambda name, value: tuple(point(name, value).tolist())]
Stiffness = Annotated[float, _nonnegative]


@dataclass(frozen=True)
class Product:
    """Two numbers or functions of position, multiplied."""

    first: FieldLike
    second: FieldLike

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Return the values (n,) at points (n, dim)."""
        first, second = (
            np.asarray(factor(points)) if callable(factor) else factor
            for factor in (self.first, self.second)
        )
        return np.multiply(first, second)


def times(value: Any, factor: float) -> Any:
    """Return a number, array, function of position, or tuple of them, times a factor; None
    stays."""
    if value is None or factor == 1.0:
        return value
    if isinstance(value, tuple):
        return tuple(times(component, factor) for component in value)
    function = cast("FieldLike", value)
    return Product(function, factor) if callable(value) else factor * value


class Acting(checks.Checked):
    """The base class of all that a load path scales: loads, supports, periodic sides and moving
    obstacles."""

    name: str | None = None
    _amounts: ClassVar[tuple[str, ...]] = ()  # the fields that a factor multiplies

    @property
    def place(self) -> str:
        """Return the name of the boundary or body, or the point as text."""
        point = getattr(self, "point", None)
        if point is not None:
            return f"point ({', '.join(f'{x:.6g}' for x in point)})"
        return getattr(self, "boundary", None) or getattr(self, "body", None) or BODY_FORCE

    @property
    def path_name(self) -> str:
        """Return the name in load paths: ``name``, or the place if there is none."""
        return self.name or self.place

    @property
    def path_names(self) -> tuple[str, ...]:
        """Return the names of all that load paths multiply."""
        return (self.path_name,)

    @property
    def acts(self) -> bool:
        """Return whether a factor changes anything."""
        return any(np.any(getattr(self, name)) for name in self._amounts)

    def scaled(self, factor: float) -> Self:
        """Return the load, support or motion times a factor."""
        changed = {name: times(getattr(self, name), factor) for name in self._amounts}
        return replace(cast("Any", self), **changed)  # all subclasses are dataclasses


@dataclass(frozen=True)
class Pressure(Acting):
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

    boundary: Name
    value: Value
    _: KW_ONLY
    name: Name | None = None
    _amounts = ("value",)


@dataclass(frozen=True)
class Traction(Acting):
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

    boundary: Name
    components: Components
    _: KW_ONLY
    name: Name | None = None
    _amounts = ("components",)


@dataclass(frozen=True)
class BodyForce(Acting):
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

    components: Components
    body: Name | None = None
    _: KW_ONLY
    name: Name | None = None
    _amounts = ("components",)


@dataclass(frozen=True)
class PointForce(Acting):
    """Force at the node at a point.

    The displacement of this node grows without bound as meshes become finer, and so does the strain
    energy: take the displacements and stresses some element sizes away from it. Indicators leave
    the elements of the node out.

    Parameters
    ----------
    point : sequence of float
        m. Every mesh must have a node there: graded meshes of plane domains do at points of
        straight edges.
    components : sequence of float
        Cartesian components, N (plane: per metre of thickness; axisymmetric: of the full
        circumference).
    body : str, optional
        Name of the body, where nodes of several lie at the point.
    name : str, optional
        In load paths; default the place, such as "point (0, 1)".

    Examples
    --------
    >>> am.PointForce((2.0, 0.5), (0.0, -1e4)).path_name
    'point (2, 0.5)'
    """

    point: Point
    components: Point
    body: Name | None = None
    _: KW_ONLY
    name: Name | None = None
    _amounts = ("components",)

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.components) != len(self.point):
            raise ValueError(
                f"components must have as many entries as point, {len(self.point)}, got "
                f"{len(self.components)}"
            )


@dataclass(frozen=True)
class InitialStrain(Acting):
    r"""Stress-free strain of one body: thermal expansion, the imposed shortening of a bolt.

    The stress is :math:`\sigma = C (\varepsilon - \varepsilon_0)`, the load
    :math:`\int C \varepsilon_0 : \varepsilon(v)`. Elements see the mean of a function over them: with 2,
    4 and 8 square cells over the height, a temperature that is linear over it bends a sheet ten times
    as long .80, .96 and .99 of what it should with smoothed elements, .60, .85 and .96 with linear ones.

    Parameters
    ----------
    body : str
        Name of the body.
    components : sequence of float or callable
        Normal strains; shear strains are zero. In 2D (xx, yy) or (xx, yy, zz), axisymmetric (rr,
        zz) or (rr, zz, hoop), the third being 0 where it is left out; in 3D (xx, yy, zz). Negative
        shortens.
    name : str, optional
        In load paths; default the body's.

    Examples
    --------
    >>> am.InitialStrain("bolt", (0.0, -1e-3)).components
    (0.0, -0.001)
    """

    body: Name
    components: Components
    _: KW_ONLY
    name: Name | None = None
    _amounts = ("components",)

    @classmethod
    def thermal(
        cls,
        expansion: FieldLike | Sequence[FieldLike],
        temperature: FieldLike,
        *,
        body: str = "body",
        name: str | None = None,
    ) -> InitialStrain:
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
        entries = cast("Sequence[FieldLike]", expansion)
        if callable(expansion) or not isinstance(expansion, Sequence | np.ndarray):
            entries = (expansion,) * 3
        rise = checks.function_or("temperature", temperature)
        strains = tuple(
            Product(coefficient, rise)
            if callable(coefficient) or callable(rise)
            else float(coefficient) * float(rise)
            for coefficient in _components("expansion", entries)
        )
        return cls(body, strains, name=name)


@dataclass(frozen=True, kw_only=True)
class Preload(Acting):
    """The force with which a bolt is tightened.

    An initial strain along the axis shortens the body until a cut across it carries the force;
    :func:`adaptmg.solve_path` finds it, and ``Result.motions`` has it. In a load path the force is reached in steps
    that change its factor; where the factor stays the bolt keeps its length, and its force follows
    the other loads.

    Parameters
    ----------
    body : str
        Name of the body, given by position or name.
    force : float
        Tension across the cut, N (plane: N/m; axisymmetric: of the whole section), > 0. Where
        forces in the volume, as weight, pull along the bolt, the force is that in the middles of
        the elements at the cut.
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

    body: Name = field(kw_only=False)
    force: Size
    axis: Annotated[str, partial(checks.choice, choices="xyz")]
    at: Quantity | None = None
    name: Name | None = None
    _amounts = ("force",)

    @property
    def direction(self) -> int:
        """Return the number of the axis."""
        return "xyz".index(self.axis)

    def shortening(self, dim: int, strain: float = 1.0) -> InitialStrain:
        """Return the initial strain that shortens the body by a strain, 1 its whole length."""
        components = [0.0] * dim
        components[self.direction] = -float(strain)
        return InitialStrain(self.body, tuple(components), name=self.name)


Load = Pressure | Traction | BodyForce | PointForce | InitialStrain | Preload


class _Holds(Acting):
    """The base class of all supports."""

    _stiffnesses: ClassVar[
        tuple[str, ...]
    ] = ()  # the fields of springs, which no factor multiplies

    def __post_init__(self) -> None:
        super().__post_init__()
        names = self._amounts or self._stiffnesses
        if names and not any(map(self._is_given, names)):
            raise ValueError(
                f"the {type(self).__name__} at {self.place!r} holds nothing: give {' or '.join(names)}"
            )

    def components(self, dim: int) -> tuple[FieldLike | None, ...]:
        """Return the prescribed components in ``dim`` dimensions."""
        if dim == 2 and self._is_given("z"):
            raise ValueError(f"the {type(self).__name__} at {self.place!r} has a z in a 2D problem")
        return tuple(getattr(self, name) if name in self._amounts else None for name in "xyz"[:dim])

    def _is_given(self, name: str) -> bool:
        """Return whether there is a field of this name that differs from its default, the attribute of
        the class."""
        return getattr(self, name, None) != getattr(type(self), name, None)


@dataclass(frozen=True)
class Support(_Holds):
    """Prescribed displacement components on a boundary; ``None`` leaves a component free.

    Parameters
    ----------
    boundary : str
        Name of the boundary.
    x, y, z : float, callable or None
        Prescribed displacement, m; a function of position is taken at the nodes.
    normal : float, callable or None
        Prescribed displacement along the outward normal of the boundary, which must be plane, in
        any direction, m.
    name : str, optional
        In load paths; default the boundary's.

    Examples
    --------
    >>> am.Support("right", x=0).x
    0.0
    >>> roller = am.Support("slope", normal=0)                         # it slides along the slope
    """

    boundary: Name
    x: Value | None = None
    y: Value | None = None
    z: Value | None = None
    normal: Value | None = None
    _: KW_ONLY
    name: Name | None = None
    _amounts = ("x", "y", "z", "normal")


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

    boundary: Name


@dataclass(frozen=True)
class PointSupport(_Holds):
    """Prescribed displacement components of the node at a point, against rigid motions.

    The stress at a node that carries a load grows without bound as meshes become finer: let it
    carry none.

    Parameters
    ----------
    point : sequence of float
        m. Every mesh must have a node there: graded meshes of plane domains do at points of
        straight edges.
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

    point: Point
    x: Value | None = None
    y: Value | None = None
    z: Value | None = None
    body: Name | None = None
    _: KW_ONLY
    name: Name | None = None
    boundary: ClassVar[None] = None
    _amounts = ("x", "y", "z")


@dataclass(frozen=True)
class Spring(_Holds):
    """Springs between a boundary and the ground, an elastic foundation: traction ``-normal u_n n -
    tangential u_t``.

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

    boundary: Name
    normal: Annotated[FieldLike, partial(checks.function_or, check=_nonnegative)] = 0.0
    tangential: Annotated[FieldLike, partial(checks.function_or, check=_nonnegative)] = 0.0
    _stiffnesses = ("normal", "tangential")


@dataclass(frozen=True)
class PointSpring(_Holds):
    """Springs along the axes between the node at a point and the ground.

    Parameters
    ----------
    point : sequence of float
        m. Every mesh must have a node there: graded meshes of plane domains do at points of
        straight edges.
    x, y, z : float
        Stiffness, N/m (plane: per metre of thickness; axisymmetric: of the full circumference), >=
        0.
    body : str, optional
        Name of the body, where nodes of several lie at the point.

    Examples
    --------
    >>> am.PointSpring((0, 0), y=1e9).y
    1000000000.0
    """

    point: Point
    x: Stiffness = 0.0
    y: Stiffness = 0.0
    z: Stiffness = 0.0
    body: Name | None = None
    boundary: ClassVar[None] = None
    _stiffnesses = ("x", "y", "z")


AnySupport = Support | Symmetry | PointSupport | Spring | PointSpring
