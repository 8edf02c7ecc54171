r"""What a contact boundary may touch: rigid obstacles, or another boundary (ContactPair).

The condition at a contact node is :math:`u_n = u \cdot n \le g_0`, with n pointing out of the body.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._text import brief
from adaptmg.problem.laws import Law, check_law


@dataclass(frozen=True, eq=False)
class Plane:
    """A rigid plane.

    The contact normal of every node is minus the normal of the plane, so the linearised condition is exact however
    curved the body is: (x + u - point) . normal >= 0.

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

    point: np.ndarray
    normal: np.ndarray

    __repr__ = brief
    if TYPE_CHECKING:
        def __init__(self, point: ArrayLike, normal: ArrayLike) -> None: ...

    def __post_init__(self) -> None:
        point = check_arrays.vector("point", self.point)
        if point.size not in (2, 3):
            raise ValueError(f"point must have 2 or 3 components, got {point.size}")
        object.__setattr__(self, "point", point)
        checks.convert(self, check_arrays.direction, "normal", n=point.size)

    @property
    def dim(self) -> int:
        """Space dimension, 2 or 3."""
        return self.point.size

    def contact(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return contact normals (n, dim) and gaps (n,), m, at boundary points (n, dim), m, with outward unit normals.

        Gaps are measured along the contact normals, which point out of the body; negative behind the plane.
        """
        facing = normals @ self.normal
        if (facing > 0).any():
            i = int(np.argmax(facing))
            raise ValueError(f"the obstacle's normal must point towards the body; at {points[i].tolist()} the "
                             "contact boundary faces away from the plane: turn the normal, or name another boundary")
        gaps = (points - self.point) @ self.normal
        return np.broadcast_to(-self.normal, points.shape).copy(), gaps


@dataclass(frozen=True, eq=False)
class GapFunction:
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

    function: Callable[[np.ndarray], np.ndarray]

    def __post_init__(self) -> None:
        checks.offers("function", self.function, "__call__", "a function of points (n, dim) that returns gaps (n,)")

    def contact(self, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the outward normals and the gaps at boundary points; see :meth:`Plane.contact`."""
        return normals.copy(), checks.field("gap", self.function, points)


@dataclass(frozen=True, eq=False)
class Tied:
    """Two boundaries, of two bodies or of one, that move together: glued, welded, screwed.

    Their meshes need not match. Surfaces that lie on each other pass constant stresses exactly.

    Parameters
    ----------
    slave : str
        The boundary whose nodes follow the other one: rather that of the softer body, and the finer one.
    master : str
        The boundary they follow.
    reach : float, optional
        Largest distance of the surfaces, m, > 0; default the size of the surfaces, with a warning beyond an element.

    Examples
    --------
    >>> am.Tied("nut.thread", "bolt.thread").master
    'bolt.thread'
    """

    slave: str
    master: str
    _: KW_ONLY
    reach: float | None = None

    def __post_init__(self) -> None:
        _check_two_sides(self.slave, self.master)
        if self.reach is not None:
            checks.convert(self, checks.quantity, "reach", positive=True)


@dataclass(frozen=True, eq=False)
class Periodic:
    """Two opposite sides of a periodic cell: what happens on one happens on the other, up to a jump.

    Each node of a side must have a partner on the other one, the same distance away: structured meshes have.

    Parameters
    ----------
    master, slave : str
        The two sides; the slave's displacements are those of the master plus the jump.
    jump : sequence of float, optional
        m; default none. Of a cell with the sides L apart it is the mean displacement gradient times L.
    name : str, optional
        In load paths; default the slave's.

    Examples
    --------
    >>> shear = [am.Periodic("left", "right", jump=(0, 1e-3)), am.Periodic("bottom", "top", jump=(1e-3, 0))]
    """

    master: str
    slave: str
    _: KW_ONLY
    jump: Sequence[float] | None = None
    name: str | None = None

    def __post_init__(self) -> None:
        _check_two_sides(self.slave, self.master)
        if self.jump is not None:
            object.__setattr__(self, "jump", tuple(check_arrays.vector("jump", self.jump).tolist()))
        if self.name is not None:
            checks.boundary_name("name", self.name)


def _check_two_sides(slave: str, master: str) -> None:
    checks.boundary_name("slave", slave)
    checks.boundary_name("master", master)
    if slave == master:
        raise ValueError(f"slave and master are both {slave!r}: name two different boundaries; where a surface may "
                         "touch itself, cut it into two boundaries")


@dataclass(frozen=True, eq=False)
class ContactPair:
    """Two boundaries, of two bodies or of one, that may touch each other.

    Parameters
    ----------
    slave : str
        The boundary that carries the contact nodes: rather that of the softer body, the finer one, and the one that
        lies inside the other.
    master : str
        The boundary it may touch.
    sides : {"given", "auto"}
        Whether the slave is the boundary named so, or the softer of the two, of bodies whose moduli are within a factor
        of 2 the finer. "auto" is decided where a hierarchy or a discrete problem is made: ``hierarchy.problem``,
        ``result.contact`` (``names`` the slaves, ``masters``) and pictures speak of the slave that was taken. A master
        of several pairs, or one that a tie or support holds, stays the master. Cycles do not depend on the contrast of
        the bodies with the softer one as slave, and are many with one 10 times stiffer than its master (a warning).
    coupling : {"mortar", "nodes"}
        Mortar integrals with dual multipliers; or node to node, for surfaces whose nodes match.
    allow_interference : bool
        Accept negative initial gaps (an interference fit).
    reach : float, optional
        Largest initial distance of the surfaces, m, > 0; default the size of the surfaces.
    gap : float or callable, optional
        Initial gap along the slave's normal, m, in place of the computed one: a number, or a function of position
        (n, dim) -> (n,).
    law : Frictionless, Tresca, Coulomb or user-defined, optional
        In place of the problem's. A node on two contact boundaries has the law of the one named first.

    Examples
    --------
    >>> am.ContactPair("upper.bottom", "lower.top").master
    'lower.top'
    """

    slave: str
    master: str
    _: KW_ONLY
    sides: str = "given"
    coupling: str = "mortar"
    allow_interference: bool = False
    reach: float | None = None
    gap: float | Callable[[np.ndarray], np.ndarray] | None = None
    law: Law | None = None

    def __post_init__(self) -> None:
        check_law(self.law, none=True)
        _check_two_sides(self.slave, self.master)
        checks.choice("sides", self.sides, ("given", "auto"))
        checks.choice("coupling", self.coupling, ("mortar", "nodes"))
        checks.flag("allow_interference", self.allow_interference)
        if self.reach is not None:
            checks.convert(self, checks.quantity, "reach", positive=True)
        if self.gap is not None:
            checks.convert(self, checks.function_or, "gap")
            if not callable(self.gap) and self.gap < 0 and not self.allow_interference:
                raise ValueError(f"gap must be >= 0, got {self.gap!r}; for an interference fit set "
                                 "allow_interference=True")

    @property
    def boundary(self) -> str:
        """The boundary with the contact nodes: the slave."""
        return self.slave
