r"""Constitutive laws: elastic materials, and what a contact node can bear tangentially.

The stress of an isotropic material is :math:`\sigma = \lambda\,\mathrm{tr}(\varepsilon) I +
2\mu\,\varepsilon` with
:math:`\mu = E / (2(1+\nu))` and :math:`\lambda = E\nu / ((1+\nu)(1-2\nu))` in three dimensions and in plane strain;
plane stress has :math:`\lambda = E\nu / (1-\nu^2)`. Axisymmetric bodies have, besides the strains
of the meridian plane (r, z), the hoop strain :math:`\varepsilon_{\theta\theta} = u_r / r`.

Orthotropic materials have three axes at right angles. A stress :math:`\sigma_{11}` along the first
alone makes the strains :math:`\sigma_{11} / E_1`, :math:`-\nu_{12}\,\sigma_{11} / E_1` and
:math:`-\nu_{13}\,\sigma_{11} / E_1`, one along the second the strain :math:`-\nu_{23}\,\sigma_{22}
/ E_2` along the third, and shear the angles
:math:`\gamma_{ij} = \sigma_{ij} / G_{ij}`.

With the compressive nodal force p >= 0 every contact law here has the form

.. math:: |f_t| \le s + \mu\,p, \qquad f_t \text{ opposite to the slip where equal},

a Tresca limit s plus a Coulomb part. A user-defined law is any object with the two methods
:meth:`at_nodes` and
:meth:`bounds`. With a third, ``at_state(pressure, slip)``, :math:`\mu` depends on the pressure in
Pa and the slip in m: the coefficient follows the iterates of a solver, as :math:`\mu p` does (the
diagonal process), until it is that of the solution.
"""

from __future__ import annotations

import copy
import inspect
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import (
    Annotated,
    Any,
    ClassVar,
    Protocol,
    Self,
    TypeGuard,
    TypeVar,
    cast,
    runtime_checkable,
)

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._checks import FieldLike, Size
from adaptmg._text import brief, html_fields

_AnyLaw = TypeVar("_AnyLaw")
#: of the shear modulus: the part of Lame's first constant that acts on the means of smoothed elements
#: around edges. Measured on an upset block of 16 x 16 cells with Poisson's ratio .45 and .49, the
#: compression is -.1 and -.2 % off; with half -2.0 and -.3 %, with twice 7.1 and 0 % in up to 17 cycles
#: for 14
EDGE_PART = 4.0

#: three material axes as rows, or points (n, dim) -> (n, 3, 3)
Axes = np.ndarray | Sequence[Sequence[float]] | Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Anisotropy:
    """A stiffness that depends on the direction, and how the axes of the material lie."""

    #: 6 x 6 along the axes of the material, Voigt: 11, 22, 33, 23, 13, 12; Pa
    stiffness: tuple[tuple[float, ...], ...]
    #: see Axes; None: x, y, z turned by ``angle``
    axes: tuple[tuple[float, ...], ...] | Callable[[np.ndarray], np.ndarray] | None = None
    angle: FieldLike = 0.0  # in the plane: from x to the first axis, degrees

    @property
    def varies(self) -> bool:
        """Return whether the axes depend on the position."""
        return callable(self.axes) or callable(self.angle)

    def nearest(self) -> tuple[float, float]:
        r"""Return Young's modulus, Pa, and Poisson's ratio of the isotropic material whose stiffness is
        the mean over all directions, Voigt's average (R. Hill, Proc. Phys. Soc. A 65, 1952,
        doi:10.1088/0370-1298/65/5/307):

        .. math:: 9 K = c_{11} + c_{22} + c_{33} + 2 (c_{12} + c_{13} + c_{23}),\qquad
           15 G = c_{11} + c_{22} + c_{33} - (c_{12} + c_{13} + c_{23}) + 3 (c_{44} + c_{55} + c_{66}) .
        """
        c = np.array(self.stiffness)
        bulk = c[:3, :3].sum() / 9
        shear = (np.trace(c[:3, :3]) - (c[0, 1] + c[0, 2] + c[1, 2]) + 3 * np.trace(c[3:, 3:])) / 15
        young = 9 * bulk * shear / (3 * bulk + shear)
        poisson = (3 * bulk - 2 * shear) / (6 * bulk + 2 * shear)
        return float(young), float(poisson)

    def rotations(self, points: np.ndarray) -> np.ndarray:
        """Return the axes (1 or n, 3, 3) at points (n, dim), checked."""
        if self.axes is None:
            # a constant angle is the same at all points
            points = points if callable(self.angle) else points[:1]
            turn = np.radians(checks.field("angle", self.angle, points))
            c = np.cos(turn)
            s = np.sin(turn)
            zero = np.zeros(len(turn))
            entries = np.stack([c, s, zero, -s, c, zero, zero, zero, zero + 1.0], axis=1)
            return entries.reshape(-1, 3, 3)
        if not callable(self.axes):
            return np.array(self.axes)[None]
        result = checks.array("axes", self.axes(points), (len(points), 3, 3))
        _check_axes(result)
        return result


def _check_axes(axes: np.ndarray) -> None:
    """Raise ValueError unless the rows of matrices (n, 3, 3) are orthonormal."""
    wrong = np.abs(axes @ axes.swapaxes(1, 2) - np.eye(3)).max(axis=(1, 2))
    if not wrong.max(initial=0.0) <= checks.SIX_DIGITS:
        raise ValueError(
            "the rows of axes must be orthonormal (three unit vectors at right angles), got "
            f"{axes[int(np.argmax(wrong))].tolist()}"
        )


def _stiffness(young: Sequence[float], poisson: Sequence[float], shear: Sequence[float]) -> tuple:
    """Return the stiffness (6, 6) of an orthotropic material in the order of
    :class:`Anisotropy`; ``poisson`` and ``shear`` are of the pairs 12, 13, 23."""
    e = _three_moduli("young", young)
    g_12, g_13, g_23 = _three_moduli("shear", shear)
    nu = checks.vector("poisson", poisson, 3)
    compliance = np.diag(1 / np.array([*e, g_23, g_13, g_12]))
    for (i, j), ratio in zip(((0, 1), (0, 2), (1, 2)), nu, strict=True):
        compliance[i, j] = compliance[j, i] = -ratio / e[i]
    scale = np.sqrt(np.diag(compliance))  # moduli may differ by many orders
    if not _positive_definite(compliance):
        raise ValueError(
            f"young {e} and poisson {tuple(nu.tolist())} must make a positive definite stiffness: each "
            "nu_ij is below the root of E_i / E_j, and all three together are smaller"
        )
    return _table(np.linalg.inv(compliance / np.outer(scale, scale)) / np.outer(scale, scale))


def _three_moduli(name: str, values: Sequence[float]) -> tuple[float, ...]:
    """Return three moduli, Pa; ValueError unless they are > 0."""
    return tuple(
        checks.quantity(f"{name}[{i}]", value, positive=True)
        for i, value in enumerate(checks.vector(name, values, 3))
    )


def _positive_definite(matrix: np.ndarray) -> bool:
    """Return whether the eigenvalues of a matrix are positive once its diagonal is scaled to 1."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    return bool(
        scale.all() and np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min() > checks.ALIKE
    )


def _table(matrix: np.ndarray) -> tuple[tuple[float, ...], ...]:
    """Return the symmetric part of a matrix as a tuple of rows."""
    return tuple(map(tuple, (0.5 * (matrix + matrix.T)).tolist()))


@dataclass(frozen=True, kw_only=True, repr=False)
class Elastic(checks.Checked):
    """Linear elasticity; use one of the subclasses.

    ``young`` is Young's modulus, Pa, > 0, ``poisson`` Poisson's ratio in (-1, 0.5]. Strains are to
    be small (a few per cent). Above 0.45 linear elements lock, but in plane stress: they are too
    stiff, and stresses oscillate. Smoothed ones do not (``ContactProblem.elements``), and 0.5
    itself needs them. ``anisotropy`` is set by ``orthotropic`` and ``anisotropic``; ``young`` and
    ``poisson`` are then those of the isotropic material with the same means over all directions.
    ``inelastic`` is set where a problem has :class:`adaptmg.Plastic` bodies.

    Examples
    --------
    >>> isinstance(am.Solid(young=2.1e11, poisson=0.3), am.problem.Elastic)
    True
    """

    young: Size
    poisson: Annotated[float, checks.number]
    anisotropy: Annotated[Anisotropy, partial(checks.instance, types=Anisotropy)] | None = None
    # a plastic or user-defined material with this elastic part (adaptmg.problem.plastic.Inelastic)
    inelastic: Any = None
    dim: ClassVar[int]

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.anisotropy is not None and (self.young, self.poisson) != self.anisotropy.nearest():
            raise ValueError(
                "young and poisson of an anisotropic material follow from its stiffness: make another by "
                "orthotropic(...) or anisotropic(...)"
            )
        if not -1 + checks.ALIKE < self.poisson <= 0.5:
            raise ValueError(
                f"poisson must be > -1 (by more than {checks.ALIKE:g}) and <= 0.5, got {self.poisson!r}"
            )

    def __repr__(self) -> str:
        if self.inelastic is not None:
            return repr(self.inelastic)
        anisotropy = f", anisotropy={self.anisotropy!r}" if self.anisotropy is not None else ""
        return f"{type(self).__name__}(young={self.young!r}, poisson={self.poisson!r}{anisotropy})"

    @classmethod
    def _of(cls, anisotropy: Anisotropy) -> Self:
        young, poisson = anisotropy.nearest()
        return cls(young=young, poisson=poisson, anisotropy=anisotropy)

    @property
    def least_stiffness(self) -> float:
        """Return the least norm of the stress of a strain over that of the strain, Pa: the least
        eigenvalue of the stiffness. Of isotropic materials that is 2 mu for deviators, and 2 mu + 3 lambda
        for changes of volume (in the plane 2 mu + 2 lambda, of which this is a bound)."""
        if self.anisotropy is None:
            return 2 * self.shear_modulus + min(3 * self.lame, 0.0)
        # shear stresses and strains count twice in the norms of tensors
        root = np.sqrt([1, 1, 1, 2, 2, 2])
        tensorial = np.array(self.anisotropy.stiffness) * np.outer(root, root)
        return float(np.linalg.eigvalsh(tensorial).min())

    @property
    def shear_modulus(self) -> float:
        """Return the second Lame constant mu, Pa."""
        return self.young / (2 * (1 + self.poisson))

    @property
    def lame(self) -> float:
        """Return the first Lame constant lambda as it enters the stress, Pa; infinite for Poisson's
        ratio 0.5."""
        compressible = (1 + self.poisson) * (1 - 2 * self.poisson)
        return self.young * self.poisson / compressible if compressible > 0 else math.inf

    @property
    def incompressible(self) -> bool:
        """Return whether ``lame`` is so large that only smoothed elements can take it."""
        return self.lame > self.shear_modulus / checks.ALIKE


class _Plane(Elastic):
    """A material of plane or axisymmetric bodies."""

    @classmethod
    def orthotropic(
        cls,
        *,
        young: Sequence[float],
        poisson: Sequence[float],
        shear: Sequence[float],
        angle: FieldLike = 0.0,
    ) -> Self:
        """Return a material with three axes at right angles, the third one out of the plane
        (axisymmetric: the hoop).

        Parameters
        ----------
        young : three floats
            Young's moduli E1, E2, E3 along the axes, Pa, > 0.
        poisson : three floats
            nu12, nu13, nu23: contraction along the second index over extension along the first.
        shear : three floats
            Shear moduli G12, G13, G23, Pa, > 0.
        angle : float or callable
            From x (axisymmetric: r) counter-clockwise to the first axis, degrees; a function of
            position is taken at the centroids of elements.

        Examples
        --------
        >>> wood = am.PlaneStrain.orthotropic(young=(12e9, 0.8e9, 0.5e9), poisson=(0.4, 0.4, 0.5),
        ...                                   shear=(0.7e9, 0.6e9, 0.1e9), angle=30.0)
        >>> wood.anisotropy.angle
        30.0
        """
        return cls._of(
            Anisotropy(_stiffness(young, poisson, shear), angle=checks.function_or("angle", angle))
        )


@dataclass(frozen=True, kw_only=True, repr=False)
class PlaneStrain(_Plane):
    """Plane strain: a long body, strain only in the plane. Forces are per metre of length.

    Examples
    --------
    >>> am.PlaneStrain(young=2.1e11, poisson=0.3).young
    210000000000.0
    """

    dim: ClassVar[int] = 2


@dataclass(frozen=True, kw_only=True, repr=False)
class PlaneStress(_Plane):
    """Plane stress: a thin sheet. Forces are per metre of thickness.

    Examples
    --------
    >>> am.PlaneStress(young=2.1e11, poisson=0.3).young
    210000000000.0
    """

    dim: ClassVar[int] = 2

    @property
    def lame(self) -> float:
        """Return the first Lame constant of plane stress, Pa."""
        return self.young * self.poisson / (1 - self.poisson**2)


@dataclass(frozen=True, kw_only=True, repr=False)
class Axisymmetric(_Plane):
    """A body of revolution without torsion: x is the radius r >= 0, y the axial coordinate z.

    All forces are those over the full circumference, N: integrals are weighted with 2 pi r. A
    support has to hold the axis, ``am.Support("axis", x=0)``: free, it opened by .03 to 2 % of the largest
    displacement with 32 to 8 elements along the radius.

    Examples
    --------
    >>> am.Axisymmetric(young=2.1e11, poisson=0.3).poisson
    0.3
    """

    dim: ClassVar[int] = 2


@dataclass(frozen=True, kw_only=True, repr=False)
class Solid(Elastic):
    """A three-dimensional body.

    Examples
    --------
    >>> am.Solid(young=2.1e11, poisson=0.3).young
    210000000000.0
    """

    dim: ClassVar[int] = 3

    @classmethod
    def orthotropic(
        cls,
        *,
        young: Sequence[float],
        poisson: Sequence[float],
        shear: Sequence[float],
        axes: Axes | None = None,
    ) -> Self:
        """Return a material with three axes at right angles.

        Parameters
        ----------
        young, poisson, shear
            As of :meth:`PlaneStrain.orthotropic`.
        axes : array (3, 3) or callable, optional
            The axes as rows, unit vectors; a function takes points (n, 3), the centroids of
            elements, and returns (n, 3, 3). Default x, y, z.

        Examples
        --------
        >>> spruce = am.Solid.orthotropic(
        ...     young=(12e9, 0.8e9, 0.5e9), poisson=(0.4, 0.4, 0.5), shear=(0.7e9, 0.6e9, 0.1e9))
        >>> spruce.dim
        3
        """
        return cls._of(Anisotropy(_stiffness(young, poisson, shear), _axes(axes)))

    @classmethod
    def anisotropic(
        cls, stiffness: np.ndarray | Sequence[Sequence[float]], axes: Axes | None = None
    ) -> Self:
        """Return a material with any stiffness.

        Parameters
        ----------
        stiffness : array (6, 6)
            Stresses over strains in the order of Voigt, 11, 22, 33, 23, 13, 12, with the angles of
            shear (twice the components of the tensor), Pa; symmetric and positive definite.
        axes
            As of :meth:`orthotropic`.

        Examples
        --------
        >>> silicon = [[166, 64, 64, 0, 0, 0], [64, 166, 64, 0, 0, 0], [64, 64, 166, 0, 0, 0],
        ...            [0, 0, 0, 80, 0, 0], [0, 0, 0, 0, 80, 0], [0, 0, 0, 0, 0, 80]]
        >>> am.Solid.anisotropic([[1e9 * c for c in row] for row in silicon]).dim
        3
        """
        c = checks.array("stiffness", stiffness, (6, 6))
        if not np.abs(c - c.T).max() <= checks.ALIKE * np.abs(c).max():
            raise ValueError("stiffness must be symmetric")
        if not _positive_definite(c):
            raise ValueError("stiffness must be positive definite")
        return cls._of(Anisotropy(_table(c), _axes(axes)))


def _axes(
    axes: Axes | None,
) -> tuple[tuple[float, ...], ...] | Callable[[np.ndarray], np.ndarray] | None:
    """Return axes as rows, checked; a function stays, and None."""
    if axes is None or (callable(axes) and not isinstance(axes, type)):
        return axes
    rows = checks.array("axes", axes, (3, 3))
    _check_axes(rows[None])
    return tuple(map(tuple, rows.tolist()))


@runtime_checkable
class Law(Protocol):
    """The methods of a contact law."""

    def at_nodes(self, points: np.ndarray, weights: np.ndarray) -> Law:
        """Return another law, with the parameters evaluated at contact nodes (points (n, dim) m, weights
        (n,) m or m^2); each mesh asks for one."""
        ...

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        """Return nodal ``(slip_limit, friction)``, each (n_contact,): a force and a coefficient."""
        ...


def check_law(name: str, law: object) -> Law:
    """Return ``law`` if it is an instance with the two methods of a law."""
    for method in ("at_nodes", "bounds"):
        checks.offers(
            name,
            law,
            method,
            "Frictionless(), Tresca(...), Coulomb(...) or offer at_nodes and bounds",
        )
    return cast("Law", law)


def law_of_position(name: str, law: object) -> Law:
    """Return ``law`` if it is a law that each mesh can evaluate at its contact nodes."""
    checked = check_law(name, law)
    for parameter in ("limit", "friction"):
        shape = np.shape(getattr(law, parameter, 0.0))
        if isinstance(law, Tresca | Coulomb) and shape:
            raise TypeError(
                f"{parameter} of {name} must be a number or a function of position on a ContactProblem, got "
                f"shape {shape}: arrays over contact nodes belong on a DiscreteProblem"
            )
    return checked


class FollowsState(Protocol):
    """The further method of a law whose coefficient depends on pressure and slip."""

    def at_state(self, pressure: np.ndarray, slip: np.ndarray) -> np.ndarray:
        """Return the coefficients of friction (n_contact,) at pressures, Pa, and slips along the
        load path so far, m, both (n_contact,)."""
        ...


def follows_state(law: Law) -> TypeGuard[FollowsState]:
    """Return whether the coefficient of a law depends on pressure and slip: .3 us, by isinstance of a
    protocol 16, and a solve asks at each level and five times more."""
    return hasattr(law, "at_state")


#: pressures, Pa, and slips, m, at which such laws are examined; larger ones of iterates are cut
_PRESSURES = (0.0, *np.logspace(0, 12, 13).tolist())
_SLIPS = np.append(0, np.logspace(-9, 3, 13)).tolist()


def sampled_friction(law: Law, n: int) -> np.ndarray:
    """Return coefficients (k, n) of n contact nodes: of a law that depends on pressure and slip at
    many states, of others in one row."""
    if not follows_state(law):
        return np.asarray(law.bounds(n)[1])[None]
    return np.array(
        [law.at_state(np.full(n, p), np.full(n, s)) for p in _PRESSURES for s in _SLIPS]
    )


def friction_at(law: FollowsState, pressure: np.ndarray, slip: np.ndarray) -> np.ndarray:
    """Return the coefficients at the pressures and slips (n,) of an iterate, which may hold any
    values: NaN counts as zero."""
    return law.at_state(
        np.clip(np.nan_to_num(pressure), 0.0, _PRESSURES[-1]),
        np.clip(np.nan_to_num(slip), 0.0, _SLIPS[-1]),
    )


@dataclass(frozen=True, eq=False)
class NodalLaw:
    """The limits and coefficients at contact nodes of boundaries with different laws."""

    slip_limit: np.ndarray  # (n_contact,), N
    friction: np.ndarray  # (n_contact,)

    __repr__ = brief

    def at_nodes(self, points: np.ndarray, weights: np.ndarray) -> NodalLaw:
        return self

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        return self.slip_limit, self.friction


@dataclass(frozen=True, eq=False)
class NodalStateLaw(NodalLaw):
    """Limits and coefficients at contact nodes, where some laws depend on pressure and slip."""

    #: each of these laws with the numbers (k,) of its contact nodes
    laws: tuple[tuple[FollowsState, np.ndarray], ...]

    def at_state(self, pressure: np.ndarray, slip: np.ndarray) -> np.ndarray:
        """Return the coefficients (n_contact,): at the nodes of these laws those at the state."""
        friction = self.friction.copy()
        for law, numbers in self.laws:
            friction[numbers] = law.at_state(pressure[numbers], slip[numbers])
        return friction


def _nodal(name: str, value: FieldLike | ArrayLike, n: int) -> np.ndarray:
    """Return a parameter of a law, a number or an array, at n contact nodes."""
    if callable(value):
        raise TypeError(
            f"{name}: a function of position must be evaluated at the nodes first (at_nodes)"
        )
    if np.shape(value) not in ((), (n,)):
        raise ValueError(
            f"{name} must be a number or an array over the {n} contact nodes, got shape {np.shape(value)}"
        )
    return np.full(n, value, dtype=np.float64)


def _parameter(name: str, value: FieldLike | ArrayLike) -> FieldLike | ArrayLike:
    """Return a number or an array unchanged; TypeError for anything else, ValueError unless it is finite
    and >= 0. Functions, which the parameter may be, too, are accepted before (``function_or``)."""
    array = checks.real_array(value)
    # an array may be that of no contact nodes
    if array is None or not (array.size or isinstance(value, np.ndarray)):
        raise TypeError(
            f"{name} must be a number, a function of position or an array, got {checks.described(value)}"
        )
    if not ((array >= 0) & (array <= checks.VAST)).all():
        raise ValueError(
            f"{name} must be finite and >= 0, and at most {checks.VAST:g}, got {checks.shown(value)}"
        )
    return value


FieldLikeOrArray = Annotated[FieldLike | ArrayLike, partial(checks.function_or, check=_parameter)]


def _evaluated(
    law: _AnyLaw, name: str, points: np.ndarray, weights: np.ndarray | float = 1.0
) -> _AnyLaw:
    """Return a copy of a law with a parameter, a number or a function, evaluated at points (n, dim)
    and multiplied by weights (n,)."""
    values = checks.field(name, getattr(law, name), points, minimum=0.0)
    result = copy.copy(law)
    object.__setattr__(result, name, values * weights)  # not checked again
    return result


@dataclass(frozen=True, eq=False)
class Frictionless:
    """No tangential force: f_t = 0.

    Examples
    --------
    >>> isinstance(am.cases.greco_bar(law=am.Frictionless()).law, am.Frictionless)
    True
    """

    _repr_html_ = html_fields

    def at_nodes(self, points: np.ndarray, weights: np.ndarray) -> Frictionless:
        return self

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(n_contact), np.zeros(n_contact)


@dataclass(frozen=True, eq=False, repr=False)
class Tresca(checks.Checked):
    """Tresca friction: ``|f_t| <= limit``, independent of the pressure.

    This is the problem of given friction: the limit holds at every node of the contact boundary, also
    at those that are open. A boundary of which a part touches is thus held beyond that part, and
    :func:`adaptmg.solve` warns where open nodes carry more friction than those in contact. For shear
    that acts only in contact let ``limit`` be a function of position that is 0 outside, or take
    ``am.StateLaw(lambda pressure, slip: limit / np.maximum(pressure, 1e5))``, with ``limit`` in Pa, whose
    friction is the limit wherever the pressure is above 1e5 Pa and vanishes with it.

    Parameters
    ----------
    limit : float, callable or array
        On a ContactProblem a traction in Pa (number or function of position); on a DiscreteProblem
        the nodal forces in N (number or array over the contact nodes).

    Examples
    --------
    >>> am.Tresca(2e6).limit                                            # Pa
    2000000.0
    """

    limit: FieldLikeOrArray

    _repr_html_ = html_fields

    def at_nodes(self, points: np.ndarray, weights: np.ndarray) -> Tresca:
        """Return the law with nodal forces: traction times lumped boundary mass."""
        return _evaluated(self, "limit", points, weights)

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        return _nodal("limit", self.limit, n_contact), np.zeros(n_contact)


@dataclass(frozen=True, eq=False, repr=False)
class Coulomb(checks.Checked):
    """Coulomb friction: ``|f_t| <= friction * p``.

    Parameters
    ----------
    friction : float, callable or array
        The coefficient (number or function of position; on a DiscreteProblem also an array over the
        contact nodes).

    Examples
    --------
    >>> am.Coulomb(0.3).friction
    0.3
    >>> rough = am.Coulomb(lambda x: 0.1 + x[:, 0])
    """

    friction: FieldLikeOrArray

    _repr_html_ = html_fields

    def at_nodes(self, points: np.ndarray, weights: np.ndarray) -> Coulomb:
        """Return the law with the coefficient at each contact node."""
        return _evaluated(self, "friction", points)

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(n_contact), _nodal("friction", self.friction, n_contact)


def _state_function(name: str, value: object) -> object:
    """Return a function; TypeError unless it takes pressures and slips."""
    if not callable(value) or isinstance(value, type):
        raise TypeError(
            f"{name} must be a function of pressures and slips, got {checks.described(value)}; a number "
            "or a function of position belongs in Coulomb(...)"
        )
    try:
        inspect.signature(value).bind(None, None)
    except ValueError:  # compiled functions may not have a signature
        pass
    except TypeError as error:
        raise TypeError(
            f"{name} must be a function of two arguments, pressures in Pa and slips in m, got one of "
            f"{inspect.signature(value)}"
        ) from error
    return value


@dataclass(frozen=True, eq=False, repr=False)
class StateLaw(checks.Checked):
    """Friction whose coefficient depends on pressure and slip: ``|f_t| <= friction(p, slip) * p``.

    The coefficient follows the iterates of a solver until it is that of their pressures and slips,
    and the certificate recomputes it from the result. Friction times pressure should not fall with
    the pressure, nor rise much faster than it, nor friction fall with the slip faster than the bodies
    can follow: there may then be several solutions, and a warning says so. Where friction rises
    steeply with the slip, ``Truncated`` takes the coefficients in part, and ``ActiveSet`` their
    tangents; ``SingleGrid`` and ``Monotone``, which do neither, may not converge.

    Parameters
    ----------
    friction : callable
        Takes pressures (n,) in Pa and slips (n,) in m, and returns coefficients (n,), finite and
        >= 0 for pressures up to 1e12 and slips up to 1e3 (larger ones are cut). The slip is the
        length of the path in contact, back and forth, in all steps of a load path
        (:meth:`PathResult.slip_path`) and in the present step. On a DiscreteProblem the pressure
        is the nodal force over ``ContactNodes.weights``.

    Examples
    --------
    >>> law = am.StateLaw(lambda pressure, slip: 0.1 + 0.3 / (1 + pressure / 50e6))
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(law=law), divisions=(2, 4))
    >>> contact = am.solve(grids).contact
    >>> friction = contact.limit / contact.force_n            # of the result
    >>> bool(np.allclose(friction, 0.1 + 0.3 / (1 + contact.pressure / 50e6)))
    True
    """

    friction: Annotated[Callable[[np.ndarray, np.ndarray], ArrayLike], _state_function]

    _repr_html_ = html_fields

    def __post_init__(self) -> None:
        super().__post_init__()
        sampled_friction(self, 2)

    def at_nodes(self, points: np.ndarray, weights: np.ndarray) -> StateLaw:
        return self

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        """Return no limit, and the coefficients without pressure and slip."""
        zero = np.zeros(n_contact)
        return zero, self.at_state(zero, zero)

    def at_state(self, pressure: np.ndarray, slip: np.ndarray) -> np.ndarray:
        """Return the coefficients (n_contact,) at pressures, Pa, and slips, m, checked."""
        friction = checks.array(
            "friction(pressure, slip)", self.friction(pressure, slip), pressure.shape
        )
        wrong = friction < 0
        if wrong.any():
            i = int(np.argmax(wrong))
            raise ValueError(
                f"friction(pressure, slip) must be >= 0, got {friction[i]:.6g} at {pressure[i]:.3g} Pa and "
                f"{slip[i]:.3g} m: cut it off by numpy.maximum"
            )
        return friction


def _exponent(name: str, value: object) -> float:
    """Return the exponent of the pressure in a layer, checked."""
    exponent = checks.quantity(name, value)
    if not exponent >= 1:
        raise ValueError(
            f"{name} must be >= 1, got {checks.shown(value)}: a layer with a smaller one becomes softer "
            "the more it is pressed"
        )
    return exponent


@dataclass(frozen=True, eq=False, repr=False)
class NormalCompliance(checks.Checked):
    """Give a contact boundary a layer that yields to the pressure: a rough surface.

    In place of no penetration, d = u_n - g0 = compliance * pressure**(1 / exponent) where bodies
    touch, or p = (d / compliance)**exponent: the peaks of rough surfaces are pressed flat. With the
    exponent 1 the layer yields in proportion to the pressure; with a larger one it is soft at first
    and becomes stiffer (J. T. Oden, J. A. C. Martins, Comput. Methods Appl. Mech. Engrg. 52, 1985,
    doi:10.1016/0045-7825(85)90009-X; V. A. Yastrebov, Numerical Methods in Contact Mechanics, 2013,
    doi:10.1002/9781118647974). It goes with every law of friction:
    ``am.Contact(..., law=am.Coulomb(0.3), compliance=am.NormalCompliance(1e-13))``. The gap of a
    result is negative where the layer is pressed.

    Parameters
    ----------
    compliance : float or callable
        m/Pa, >= 0 (a number or a function of position). Machined surfaces of steel have
        some 1e-14 to 1e-12; 0 is a rigid surface. With an exponent m the unit is m/Pa^(1/m): a layer
        that yields by d at the pressure p has d / p**(1 / m).
    exponent : float
        m >= 1, without unit. Default 1.

    Examples
    --------
    >>> rough = am.Contact("bottom", am.Plane((0, 0), (0, 1)), compliance=am.NormalCompliance(1e-13))
    >>> problem = am.cases.greco_bar()
    >>> from dataclasses import replace
    >>> grids = am.Hierarchy.uniform(replace(problem, contact=rough), divisions=(2, 4))
    >>> contact = am.solve(grids).contact
    >>> bool(np.allclose(-contact.gap, 1e-13 * contact.pressure))
    True
    >>> am.NormalCompliance(1e-10, exponent=2).exponent     # 1 um at 100 MPa, .5 um at 25 MPa
    2.0
    """

    compliance: Annotated[FieldLike, partial(checks.function_or, check=checks.nonnegative)]
    exponent: Annotated[float, _exponent] = 1.0

    _repr_html_ = html_fields

    def at_points(self, points: np.ndarray) -> np.ndarray:
        """Return the compliances (n,) at points (n, dim), m/Pa^(1 / exponent)."""
        return checks.field("compliance", self.compliance, points, minimum=0.0)
