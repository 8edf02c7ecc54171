r"""Rigid obstacles that move: by a displacement (Moving), or by the force that they transmit (Rigid).

A point x of the obstacle moves by :math:`U(x) = d + (R - I)(x - c)`. A plane moves exactly. In front of any other
obstacle with the gap g and the normals n, to first order in the motion,

.. math:: g(x) \to g(x - U_t) + U \cdot n .

Friction acts on the slip relative to the obstacle, :math:`u_t - U_t`, from step to step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._text import brief
from adaptmg.problem.surfaces import Plane


class Obstacle(Protocol):
    """What a contact boundary may touch."""

    def contact(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return contact normals (n, dim) and gaps (n,), m; see :meth:`adaptmg.Plane.contact`."""
        ...


def _check(one: Moving | Rigid, what: str) -> None:
    """Check what Moving and Rigid share; ``what`` has a component for each direction."""
    checks.offers("obstacle", one.obstacle, "contact", "a Plane or a GapFunction, or offer contact()")
    if isinstance(one.obstacle, Rigid):
        raise TypeError("obstacle must not be Rigid: write Rigid(Moving(...), ...)")
    dim = one.dim
    place = one.obstacle.point if isinstance(one.obstacle, Plane) else getattr(one.obstacle, "about", np.zeros(dim))
    if len(place) != dim:
        raise ValueError(f"{what} must have {len(place)} components, as the obstacle, got {dim}")
    object.__setattr__(one, "about", check_arrays.vector("about", place if one.about is None else one.about, dim))
    checks.boundary_name("name", one.name)


@dataclass(frozen=True, eq=False)
class Moving:
    """An obstacle with a prescribed motion.

    In a load path its factor multiplies displacement and rotation; without one the whole motion acts.

    Parameters
    ----------
    obstacle : Plane, GapFunction or Moving
        What moves; a user-defined one offers ``contact``.
    displacement : (dim,) sequence of float
        m; in axisymmetric problems along y, without rotation.
    rotation : float or (3,) sequence of float
        rad; counter-clockwise in the plane, in space along the axis (3,). Obstacles that are not planes turn to first
        order: keep it small.
    about : (dim,) sequence of float, optional
        The point that only ``displacement`` moves, m. Default: the point of a Plane, else the origin.
    name : str
        In load paths.

    Examples
    --------
    >>> punch = am.Moving(am.Plane((0, 0), (0, 1)), displacement=(1e-3, 2e-3), name="punch")
    >>> normals, gaps = punch.contact(np.array([[0.5, 0.0]]), np.array([[0.0, -1.0]]))
    >>> gaps.tolist()                                                 # m: the plane has risen
    [-0.002]
    """

    obstacle: Obstacle
    _: KW_ONLY
    displacement: np.ndarray
    rotation: np.ndarray | float = 0.0
    about: np.ndarray | None = None
    name: str = "obstacle"

    __repr__ = brief
    if TYPE_CHECKING:
        def __init__(self, obstacle: Obstacle, *, displacement: ArrayLike, rotation: ArrayLike = 0.0,
                     about: ArrayLike | None = None, name: str = "obstacle") -> None: ...

    def __post_init__(self) -> None:
        checks.convert(self, check_arrays.vector, "displacement")
        dim = self.displacement.size
        if dim not in (2, 3):
            raise ValueError(f"displacement must have 2 or 3 components, got {dim}")
        turn = self.rotation
        if np.ndim(turn) == 0:
            turn = (turn,) if dim == 2 or turn != 0 else np.zeros(3)
        object.__setattr__(self, "rotation", check_arrays.vector("rotation", turn, 2 * dim - 3))
        _check(self, "displacement")

    @property
    def dim(self) -> int:
        """Space dimension."""
        return self.displacement.size

    def scaled(self, factor: float) -> Moving:
        """Return the same with ``factor`` times the motion."""
        return replace(self, displacement=factor * self.displacement, rotation=factor * self.rotation)

    def motion(self, points: np.ndarray) -> np.ndarray:
        """Return how points (n, dim) of the obstacle move (n, dim), m."""
        arms = points - self.about
        inner = self.obstacle.motion(points) if isinstance(self.obstacle, Moving) else 0.0
        return self.displacement + arms @ (self._turn() - np.eye(self.dim)).T + inner

    def contact(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return contact normals and gaps after the motion; see :meth:`Plane.contact`."""
        whole = self._plane()
        if whole is not None:
            return whole.contact(points, normals)
        motion = self.motion(points)
        along = np.einsum("nd,nd->n", motion, normals)
        fixed = self.obstacle
        while isinstance(fixed, Moving):
            fixed = fixed.obstacle
        directions, gaps = fixed.contact(points - motion + along[:, None] * normals, normals)
        return directions, gaps + np.einsum("nd,nd->n", motion, directions)

    def _plane(self) -> Plane | None:
        """The plane after the motion, if it is one."""
        inner = self.obstacle._plane() if isinstance(self.obstacle, Moving) else self.obstacle
        if not isinstance(inner, Plane):
            return None
        turn = self._turn()
        return Plane(self.about + self.displacement + turn @ (inner.point - self.about), turn @ inner.normal)

    def _turn(self) -> np.ndarray:
        if not self.rotation.any():
            return np.eye(self.dim)
        if self.dim == 2:
            c, s = np.cos(self.rotation[0]), np.sin(self.rotation[0])
            return np.array([[c, -s], [s, c]])
        from scipy.spatial.transform import Rotation

        return Rotation.from_rotvec(self.rotation.copy()).as_matrix()


@dataclass(frozen=True, eq=False)
class Rigid:
    """A rigid obstacle that moves until it transmits a force and a moment.

    :func:`adaptmg.solve_path` finds its motion by Broyden's method on these few numbers, with a contact problem for
    each trial; ``Result.motions`` has the motion. Cycles, work and seconds of the result are those of all trials, its
    history that of the one it is from. In a load path the factor multiplies force and moment.

    Parameters
    ----------
    obstacle : Plane, GapFunction or Moving
        Its shape and first place. With a Moving one press and slide: the force finds what its motion leaves open.
    force : (dim,) sequence of float or None
        What it exerts on the body, N (plane: N/m; axisymmetric: of the whole circumference); None: it does not move in
        this direction.
    moment : float, or (3,) sequence of float or None, optional
        About ``about``, N m (plane: N); None, the default: it does not turn.
    about, name
        See :class:`Moving`.

    Examples
    --------
    >>> punch = am.Rigid(am.Plane((0, 1), (0, -1)), force=(None, -1e5), moment=0.0, name="punch")
    >>> punch.free
    (1, 2)
    """

    obstacle: Obstacle
    _: KW_ONLY
    force: tuple[float | None, ...]
    moment: tuple[float | None, ...] | float | None = None
    about: np.ndarray | None = None
    name: str = "obstacle"

    __repr__ = brief
    if TYPE_CHECKING:
        def __init__(self, obstacle: Obstacle, *, force: tuple[float | None, ...],
                     moment: tuple[float | None, ...] | float | None = None, about: ArrayLike | None = None,
                     name: str = "obstacle") -> None: ...

    def __post_init__(self) -> None:
        force = _targets("force", self.force)
        dim = len(force)
        if dim not in (2, 3):
            raise ValueError(f"force must have 2 or 3 components, got {dim}")
        moment = self.moment if isinstance(self.moment, tuple | list) else (self.moment,) * (2 * dim - 3)
        moment = _targets("moment", moment)
        if len(moment) != 2 * dim - 3:
            raise ValueError(f"moment must have {2 * dim - 3} components, got {len(moment)}")
        object.__setattr__(self, "force", force)
        object.__setattr__(self, "moment", moment)
        if not self.free:
            raise ValueError("force and moment are None: use the obstacle itself, or Moving")
        if not any(force):
            raise ValueError("force must have a component other than zero: nothing would press the obstacle")
        _check(self, "force")

    @property
    def dim(self) -> int:
        """Space dimension."""
        return len(self.force)

    @property
    def targets(self) -> np.ndarray:
        """Force and moment (n,), NaN where the motion is prescribed."""
        return np.array([*self.force, *self.moment], dtype=np.float64)

    @property
    def free(self) -> tuple[int, ...]:
        """The numbers of the components of force and moment that are prescribed."""
        return tuple(np.flatnonzero(~np.isnan(self.targets)).tolist())

    def scaled(self, factor: float) -> Rigid:
        """Return the same with ``factor`` times force and moment."""
        force, moment = (tuple(None if value is None else factor * value for value in values)
                         for values in (self.force, self.moment))
        return replace(self, force=force, moment=moment)

    def contact(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return contact normals and gaps in the first place; see :meth:`Plane.contact`."""
        return self.obstacle.contact(points, normals)

    def placed(self, motion: np.ndarray) -> Moving:
        """Return the obstacle after displacement and rotation (n,), m and rad."""
        return Moving(self.obstacle, displacement=motion[:self.dim], rotation=motion[self.dim:], about=self.about,
                      name=self.name)


def _targets(name: str, values: object) -> tuple[float | None, ...]:
    return tuple(None if value is None else checks.quantity(f"{name}[{i}]", value)
                 for i, value in enumerate(checks.listed(name, values, "numbers or None, one a component")))


def moving_parts(obstacle: Obstacle) -> list[Moving | Rigid]:
    """Return an obstacle and what it wraps, as far as it moves."""
    result: list[Moving | Rigid] = []
    while isinstance(obstacle, Moving | Rigid):
        result.append(obstacle)
        obstacle = obstacle.obstacle
    return result


def placed(obstacle: Obstacle, factors: Mapping[str, float], motions: Mapping[str, ArrayLike] | None) -> Obstacle:
    """Return an obstacle whose Moving parts have made ``factors`` of their motions (1 where not named), and whose Rigid
    one has made that of ``motions`` (none where not named); without ``motions`` it has the factor of its force."""
    if isinstance(obstacle, Rigid):
        inner = replace(obstacle, obstacle=placed(obstacle.obstacle, factors, motions))
        if motions is None:
            return inner.scaled(factors.get(obstacle.name, 1.0))
        return inner.placed(np.asarray(motions.get(obstacle.name, np.zeros(3 * obstacle.dim - 3))))
    if isinstance(obstacle, Moving):
        inner = placed(obstacle.obstacle, factors, motions)
        return replace(obstacle.scaled(factors.get(obstacle.name, 1.0)), obstacle=inner)
    return obstacle
