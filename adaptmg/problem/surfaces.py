r"""The counterparts of a contact boundary: rigid obstacles, at rest or moving, and other boundaries;
and ties.

The condition at a contact node is :math:`u_n = u \cdot n \le g_0`, with n pointing out of the body.

An obstacle moves by a displacement (Moving), or by the force that it transmits (Rigid): a point x
of it by
:math:`U(x) = d + (R - I)(x - c)`. A plane moves exactly. In front of any other obstacle with the gap g and the normals
n, to first order in the motion,

.. math:: g(x) \to g(x - U_t) + U \cdot n .

Friction acts on the slip relative to the obstacle, :math:`u_t - U_t`, from step to step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._checks import Flag, Name, Size, Value
from adaptmg.problem.laws import Law, NormalCompliance, law_of_position
from adaptmg.problem.loads import Acting, Point, point, times

OwnLaw = Annotated[Law, law_of_position]
OwnCompliance = Annotated[NormalCompliance, partial(checks.instance, types=NormalCompliance)]
Coordinates = Annotated[np.ndarray, point]
_NO_ROTATION = cast("np.ndarray", 0.0)  # an array once it is checked


class Obstacle(Protocol):
    """A surface that a contact boundary may touch."""

    def contact(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return contact normals (n, dim) and gaps (n,), m; see :meth:`adaptmg.Plane.contact`."""
        ...


AnyObstacle = Annotated[
    Obstacle,
    partial(checks.offers, method="contact", words="a Plane or a GapFunction, or offer contact()"),
]


@dataclass(frozen=True, eq=False, repr=False)
class Plane(checks.Checked):
    """A rigid plane.

    The contact normal of every node is minus the normal of the plane, so the linearised condition
    is exact however curved the body is: (x + u - point) . normal >= 0.

    Parameters
    ----------
    point : sequence of float
        A point of the plane, m.
    normal : sequence of float
        Its normal, pointing towards the body; any length > 0.

    Examples
    --------
    >>> floor = am.Plane(point=(0, 0, 0), normal=(0, 0, 2))
    >>> floor.normal.tolist()                                         # of unit length
    [0.0, 0.0, 1.0]
    """

    point: Coordinates
    normal: np.ndarray

    if TYPE_CHECKING:

        def __init__(self, point: ArrayLike, normal: ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "normal", checks.direction("normal", self.normal, self.dim))

    @property
    def dim(self) -> int:
        """Return the space dimension, 2 or 3."""
        return self.point.size

    def contact(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return contact normals (n, dim) and gaps (n,), m, at boundary points (n, dim), m, with
        outward unit normals.

        Gaps are measured along the contact normals, which point out of the body; negative behind
        the plane. ValueError if the boundary faces away where it is nearest."""
        gaps = (points - self.point) @ self.normal
        # the back of a whole ball faces away, far from the plane; a side at a right angle to the plane
        # does not, but for rounding
        nearest = np.abs(gaps) <= np.abs(gaps).min(initial=np.inf)
        away = nearest & (normals @ self.normal > checks.ALIKE)
        if away.any():
            raise ValueError(
                f"the obstacle's normal must point towards the body; at {points[away][0].tolist()} the "
                "contact boundary faces away from the plane: turn the normal, or name another boundary"
            )
        return np.broadcast_to(-self.normal, points.shape).copy(), gaps


@dataclass(frozen=True, eq=False)
class GapFunction(checks.Checked):
    """Any obstacle given by the gap in front of the contact boundary.

    Parameters
    ----------
    function : callable
        Points (n, dim) in m -> gaps (n,) in m, measured along the outward normal of the body.

    Examples
    --------
    >>> parabola = am.GapFunction(lambda x: 0.5 * x[:, 0]**2 / 0.1)      # m, at points (n, dim)
    >>> parabola.function(np.array([[0.01, 0.0]])).round(6).tolist()
    [0.0005]
    """

    function: Annotated[
        Callable[[np.ndarray], np.ndarray],
        partial(
            checks.offers,
            method="__call__",
            words="a function of points (n, dim) that returns gaps (n,)",
        ),
    ]

    def contact(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the outward normals and the gaps at boundary points; see :meth:`Plane.contact`."""
        return normals.copy(), checks.field("gap", self.function, points)


class _MovingPart(Acting):
    """The fields and checks that Moving and Rigid share."""

    obstacle: Obstacle
    about: np.ndarray | None  # (dim,), m: the point about which it turns
    dim: int  # of the motion: components of its first amount, a displacement or a force

    def __post_init__(self) -> None:
        super().__post_init__()
        inner = self.obstacle
        if isinstance(inner, Rigid):
            raise TypeError("obstacle must not be Rigid: write Rigid(Moving(...), ...)")
        # the default of ``about``: a point of the plane, that of a Moving inside, else the origin
        place = (
            inner.point if isinstance(inner, Plane) else getattr(inner, "about", np.zeros(self.dim))
        )
        if len(place) != self.dim:
            raise ValueError(
                f"{self._amounts[0]} must have {len(place)} components, as the obstacle, got {self.dim}"
            )
        about = place if self.about is None else self.about
        object.__setattr__(self, "about", checks.vector("about", about, self.dim))

    @property
    def pivot(self) -> np.ndarray:
        """Return the point (dim,) about which the obstacle turns, m."""
        return checks.instance("about", self.about, np.ndarray)


@dataclass(frozen=True, eq=False, repr=False)
class Moving(_MovingPart):
    """An obstacle with a prescribed motion.

    In a load path its factor multiplies displacement and rotation; without one the whole motion
    acts.

    Parameters
    ----------
    obstacle : Plane, GapFunction or Moving
        What moves; a user-defined one offers ``contact``.
    displacement : (dim,) sequence of float
        m; in axisymmetric problems along y, without rotation.
    rotation : float or (3,) sequence of float
        In rad (the angle of :class:`adaptmg.Moved`, a part of the geometry, is in degrees);
        counter-clockwise in the plane, in space a vector along the axis whose length is the angle.
        Obstacles that are not planes turn to first order: keep it small.
    about : (dim,) sequence of float, optional
        The point that only ``displacement`` moves, m. Default: the point of a Plane, else the
        origin.
    name : str
        In load paths.

    Examples
    --------
    >>> punch = am.Moving(am.Plane((0, 0), (0, 1)), displacement=(1e-3, 2e-3), name="punch")
    >>> normals, gaps = punch.contact(np.array([[0.5, 0.0]]), np.array([[0.0, -1.0]]))
    >>> gaps.tolist()                                                 # m: the plane has risen
    [-0.002]
    """

    obstacle: AnyObstacle
    _: KW_ONLY
    displacement: Coordinates
    rotation: np.ndarray = _NO_ROTATION
    about: np.ndarray | None = None
    name: Name = "obstacle"
    _amounts = ("displacement", "rotation")

    if TYPE_CHECKING:

        def __init__(
            self,
            obstacle: Obstacle,
            *,
            displacement: ArrayLike,
            rotation: ArrayLike = 0.0,
            about: ArrayLike | None = None,
            name: str = "obstacle",
        ) -> None: ...

    def __post_init__(self) -> None:
        super().__post_init__()
        turn = self.rotation
        dim = self.dim
        if np.ndim(turn) == 0:
            # in space an angle does not give a vector: (turn,) makes the check below say so; 0 means no rotation
            turn = (turn,) if dim == 2 or turn != 0 else np.zeros(3)
        # one component in the plane, three in space
        object.__setattr__(self, "rotation", checks.vector("rotation", turn, 2 * dim - 3))

    @property
    def dim(self) -> int:
        """Return the space dimension."""
        return self.displacement.size

    def motion(self, points: np.ndarray) -> np.ndarray:
        """Return the displacements (n, dim), m, of points (n, dim) of the obstacle."""
        arms = points - self.about
        inner = self.obstacle.motion(points) if isinstance(self.obstacle, Moving) else 0.0
        return self.displacement + arms @ (self._turn() - np.eye(self.dim)).T + inner

    def contact(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return contact normals and gaps after the motion; see :meth:`Plane.contact`."""
        moved_plane = self._plane()
        if moved_plane is not None:
            return moved_plane.contact(points, normals)
        motion = self.motion(points)
        along_normal = np.einsum("nd,nd->n", motion, normals)
        # the gap of the obstacle at rest, at points moved back tangentially, plus the motion along
        # the contact normals
        at_rest = moving_parts(self)[-1].obstacle
        moved_back = points - motion + along_normal[:, None] * normals
        directions, gaps = at_rest.contact(moved_back, normals)
        return directions, gaps + np.einsum("nd,nd->n", motion, directions)

    def _plane(self) -> Plane | None:
        """Return the plane after the motion; None for other obstacles."""
        inner = self.obstacle._plane() if isinstance(self.obstacle, Moving) else self.obstacle
        if not isinstance(inner, Plane):
            return None
        turn = self._turn()
        place = self.about + self.displacement + turn @ (inner.point - self.about)
        return Plane(place, turn @ inner.normal)

    def _turn(self) -> np.ndarray:
        """Return the rotation as a matrix (dim, dim)."""
        if not self.rotation.any():
            return np.eye(self.dim)
        if self.dim == 2:
            c = np.cos(self.rotation[0])
            s = np.sin(self.rotation[0])
            return np.array([[c, -s], [s, c]])
        from scipy.spatial.transform import Rotation

        return Rotation.from_rotvec(self.rotation.copy()).as_matrix()


def _targets(name: str, values: object) -> tuple[float | None, ...]:
    """Return the components of a force or moment, checked; None where the motion is prescribed."""
    return tuple(
        None if value is None else checks.quantity(f"{name}[{i}]", value)
        for i, value in enumerate(checks.listed(name, values, "numbers or None, one a component"))
    )


Force = tuple[float | None, ...]
_NO_MOMENT = cast("Force", None)  # a tuple once it is checked


def _forces(name: str, values: object) -> Force | dict[str, Force]:
    """Return a force, or forces by name, checked."""
    if not isinstance(values, Mapping):
        return _targets(name, values)
    forces = {
        checks.boundary_name(f"the names in {name}", key): _targets(f"{name}[{key!r}]", value)
        for key, value in checks.mapping(name, values, "names to forces").items()
    }
    if len({tuple(x is None for x in force) for force in forces.values()}) != 1:
        raise ValueError(
            f"{name} must have forces of as many components, None in the same places of all of them, "
            f"got {checks.shown(values)}"
        )
    return forces


@dataclass(frozen=True, eq=False, repr=False)
class Rigid(_MovingPart):
    """A rigid obstacle that moves until it transmits a force and a moment.

    :func:`adaptmg.solve_path` finds its motion, on a level of few unknowns as an unknown of the contact problem, on the
    finest level from there by Broyden's method; ``Result.motions`` has it. Cycles, work and seconds
    of the result are those of all trials, its history that of the one it is from. In a load path
    the factor multiplies force and moment.

    Parameters
    ----------
    obstacle : Plane, GapFunction or Moving
        Its shape and first place. With a Moving one press and slide: the force finds what its
        motion leaves open.
    force : (dim,) sequence of float or None, or mapping of str to these
        What it exerts on the body, N (plane: N/m; axisymmetric: of the whole circumference); None:
        it does not move in this direction. A mapping has forces that add up, by the names that they
        have in load paths; None stands in all of them in the same places.
    moment : float, or (3,) sequence of float or None, optional
        About ``about``, N m (plane: N); None, the default: it does not turn.
    about, name
        See :class:`Moving`.

    Examples
    --------
    >>> punch = am.Rigid(am.Plane((0, 1), (0, -1)), force=(None, -1e5), moment=0.0, name="punch")
    >>> punch.free
    (1, 2)
    >>> forces = {"P": (0.0, -1e5), "Q": (1e4, 0.0)}
    >>> fretting = am.Rigid(am.Plane((0, 1), (0, -1)), force=forces, name="pad")
    >>> path = am.LoadPath({"P": 1.0, "Q": [1, -1, 1]})
    """

    obstacle: AnyObstacle
    _: KW_ONLY
    force: Annotated[Force | Mapping[str, Force], _forces]
    moment: Force = _NO_MOMENT
    about: np.ndarray | None = None
    name: Name = "obstacle"
    _amounts = ("force", "moment")

    if TYPE_CHECKING:

        def __init__(
            self,
            obstacle: Obstacle,
            *,
            force: Force | Mapping[str, Force],
            moment: tuple[float | None, ...] | float | None = None,
            about: ArrayLike | None = None,
            name: str = "obstacle",
        ) -> None: ...

    def __post_init__(self) -> None:
        """Store the moment as a tuple; ValueError unless a force, or a moment, presses the obstacle."""
        super().__post_init__()
        turns = 2 * self.dim - 3  # components of a rotation: 1 in the plane, 3 in space
        moment = self.moment if isinstance(self.moment, tuple | list) else (self.moment,) * turns
        object.__setattr__(self, "moment", _targets("moment", moment))
        if self.dim not in (2, 3) or len(self.moment) != turns:
            raise ValueError(
                f"force must have 2 or 3 components, moment 1 or 3, got {self.dim} and {len(self.moment)}"
            )
        if not self.free:
            raise ValueError("force and moment are None: use the obstacle itself, or Moving")
        if not any(map(any, self.forces.values())):
            raise ValueError(
                "force must have a component other than zero: nothing would press the obstacle"
            )

    @property
    def forces(self) -> dict[str, Force]:
        """Return the forces by their names in load paths."""
        return dict(self.force) if isinstance(self.force, Mapping) else {self.name: self.force}

    @property
    def path_names(self) -> tuple[str, ...]:
        """Return the names of the forces, and that of the moment if there is one."""
        return tuple(dict.fromkeys([*self.forces, *([self.name] if any(self.moment) else [])]))

    @property
    def dim(self) -> int:
        """Return the space dimension."""
        return len(next(iter(self.forces.values())))

    @property
    def targets(self) -> np.ndarray:
        """Return the force and moment (n,), NaN where the motion is prescribed."""
        forces = np.array(list(self.forces.values()), dtype=np.float64)
        return np.append(forces.sum(axis=0), np.array(self.moment, dtype=np.float64))

    def loaded(self, factors: Mapping[str, float]) -> Rigid:
        """Return the obstacle with force and moment times their factors, 1 where not named."""
        scaled_forces = {
            name: times(force, factors.get(name, 1.0)) for name, force in self.forces.items()
        }
        force = scaled_forces if isinstance(self.force, Mapping) else scaled_forces[self.name]
        return replace(self, force=force, moment=times(self.moment, factors.get(self.name, 1.0)))

    @property
    def free(self) -> tuple[int, ...]:
        """Return the numbers of the components of force and moment that are prescribed."""
        return tuple(np.flatnonzero(~np.isnan(self.targets)).tolist())

    def contact(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return contact normals and gaps in the first place; see :meth:`Plane.contact`."""
        return self.obstacle.contact(points, normals)

    def placed(self, motion: np.ndarray) -> Moving:
        """Return the obstacle after a ``motion`` (n,): the displacement (dim,), m, then the rotation, rad."""
        return Moving(
            self.obstacle,
            displacement=motion[: self.dim],
            rotation=motion[self.dim :],
            about=self.about,
            name=self.name,
        )


def moving_parts(obstacle: Obstacle) -> list[Moving | Rigid]:
    """Return the moving parts of an obstacle, from the outermost to the innermost."""
    result: list[Moving | Rigid] = []
    while isinstance(obstacle, Moving | Rigid):
        result.append(obstacle)
        obstacle = obstacle.obstacle
    return result


def placed(
    obstacle: Obstacle, factors: Mapping[str, float], motions: Mapping[str, ArrayLike] | None
) -> Obstacle:
    """Return an obstacle after a part of its motions.

    Each Moving part has made the share of its motion that ``factors`` gives (1 if not named). A
    Rigid part has made its motion of ``motions`` (none if not named); if ``motions`` is None, its
    force is multiplied by its factor instead."""
    if isinstance(obstacle, Rigid):
        inner = replace(obstacle, obstacle=placed(obstacle.obstacle, factors, motions))
        if motions is None:
            return inner.loaded(factors)
        # dim translations, then one rotation in 2D or three
        return inner.placed(np.asarray(motions.get(obstacle.name, np.zeros(3 * obstacle.dim - 3))))
    if isinstance(obstacle, Moving):
        inner = placed(obstacle.obstacle, factors, motions)
        return replace(obstacle.scaled(factors.get(obstacle.name, 1.0)), obstacle=inner)
    return obstacle


class _Sides(checks.Checked):
    """Two different boundaries."""

    slave: Name
    master: Name

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.slave == self.master:
            raise ValueError(
                f"slave and master are both {self.slave!r}: name two different boundaries; where a "
                "surface may touch itself, cut it into two boundaries"
            )

    @property
    def boundary(self) -> str:
        """Return the boundary whose nodes follow the other one, or touch it: the slave."""
        return self.slave


@dataclass(frozen=True, eq=False)
class Tied(_Sides):
    """Two boundaries, of two bodies or of one, that move together: glued, welded, screwed.

    Their meshes need not match. Surfaces that lie on each other pass constant stresses exactly.

    Parameters
    ----------
    slave : str
        The boundary whose nodes follow the other one: rather that of the softer body, and the finer
        one.
    master : str
        The boundary they follow.
    reach : float, optional
        Largest distance of the surfaces, m, > 0; default the size of the surfaces, with a warning
        beyond an element.

    Examples
    --------
    >>> am.Tied("nut.thread", "bolt.thread").master
    'bolt.thread'
    """

    slave: Name
    master: Name
    _: KW_ONLY
    reach: Size | None = None


@dataclass(frozen=True, eq=False)
class Periodic(_Sides, Acting):
    """Two opposite sides of a periodic cell: what happens on one happens on the other, up to a
    jump.

    Each node of a side must have a partner on the other one, the same distance away: structured
    meshes have. Where a contact boundary crosses the sides, a node and its partner carry one condition.

    Parameters
    ----------
    master, slave : str
        The two sides; the slave's displacements are those of the master plus the jump.
    jump : sequence of float, optional
        m; default none. Of a cell with the sides L apart it is the mean displacement gradient times
        L.
    name : str, optional
        In load paths; default the slave's.

    Examples
    --------
    >>> sides = am.Periodic("left", "right", jump=(0, 1e-3))
    >>> shear = [sides, am.Periodic("bottom", "top", jump=(1e-3, 0))]
    """

    master: Name
    slave: Name
    _: KW_ONLY
    jump: Point | None = None
    name: Name | None = None
    _amounts = ("jump",)


@dataclass(frozen=True, eq=False)
class ContactPair(_Sides):
    """Two boundaries, of two bodies or of one, that may touch each other.

    Initial gaps are those between the exact boundaries where the problem's domain knows them: arcs,
    cylinders, balls, cones and tori, of STEP files too. Nodes of the two sides need not match then.
    Meshes without a domain have gaps between their straight edges, of which a warning tells where
    these matter.

    Parameters
    ----------
    slave : str
        The boundary that carries the contact nodes: rather that of the softer body, the finer one,
        and the one that lies inside the other.
    master : str
        The boundary it may touch.
    sides : {"given", "auto"}
        Whether the slave is the boundary named so, or the softer of the two, of bodies whose moduli
        are within a factor of 2 the finer. "auto" is decided where a hierarchy or a discrete
        problem is made: ``hierarchy.problem``, ``result.contact`` (``names`` the slaves,
        ``masters``) and pictures speak of the slave that was taken. A master of several pairs, or
        one that a tie or support holds, stays the master. Cycles do not depend on the contrast of
        the bodies with the softer one as slave, and are many with one 10 times stiffer than its
        master (a warning).
    coupling : {"mortar", "nodes"}
        Mortar integrals with dual multipliers; or node to node, for surfaces whose nodes match.
    allow_interference : bool
        Accept negative initial gaps (an interference fit).
    reach : float, optional
        Largest initial distance of the surfaces, m, > 0; default the size of the surfaces.
    gap : float or callable, optional
        Initial gap along the slave's normal, m, in place of the computed one: a number, or a
        function of position (n, dim) -> (n,).
    law : Frictionless, Tresca, Coulomb or user-defined, optional
        In place of the problem's. A node on two contact boundaries has the law of the one named
        first.
    compliance : NormalCompliance, optional
        Of its surfaces together; default rigid ones.

    Examples
    --------
    >>> am.ContactPair("upper.bottom", "lower.top").master
    'lower.top'
    """

    slave: Name
    master: Name
    _: KW_ONLY
    sides: Annotated[str, partial(checks.choice, choices=("given", "auto"))] = "given"
    coupling: Annotated[str, partial(checks.choice, choices=("mortar", "nodes"))] = "mortar"
    allow_interference: Flag = False
    reach: Size | None = None
    gap: Value | None = None
    law: OwnLaw | None = None
    compliance: OwnCompliance | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if (
            self.gap is not None
            and not callable(self.gap)
            and self.gap < 0
            and not self.allow_interference
        ):
            raise ValueError(
                f"gap must be >= 0, got {self.gap!r}; for an interference fit set allow_interference=True"
            )
