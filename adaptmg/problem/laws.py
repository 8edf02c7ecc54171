r"""Contact laws: what a contact node can bear tangentially.

With the compressive nodal force p >= 0 every law here has the form

.. math:: |f_t| \le s + \mu\,p, \qquad f_t \text{ opposite to the slip where equal},

a Tresca limit s plus a Coulomb part. A user-defined law is any object with the two methods :meth:`at_nodes` and
:meth:`bounds`.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._checks import FieldLike
from adaptmg._text import brief, html_fields

_AnyLaw = TypeVar("_AnyLaw")


@runtime_checkable
class Law(Protocol):
    """The methods of a contact law."""

    def at_nodes(self, points: np.ndarray, weights: np.ndarray) -> Law:
        """Return the law with its parameters evaluated at contact nodes (points (n, dim) m, weights (n,) m or m^2)."""

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        """Return nodal ``(slip_limit, friction)``, each (n_contact,): a force and a coefficient."""


def check_law(name: str, law: Law) -> Law:
    """Return ``law`` if it is an instance with the two methods of a law."""
    for method in ("at_nodes", "bounds"):
        checks.offers(name, law, method, "Frictionless(), Tresca(...), Coulomb(...) or offer at_nodes and bounds")
    return law


@dataclass(frozen=True, eq=False)
class NodalLaw:
    """Limits and coefficients of the contact nodes of boundaries with laws of their own."""

    slip_limit: np.ndarray  # (n_contact,), N
    friction: np.ndarray  # (n_contact,)

    __repr__ = brief

    def at_nodes(self, points: np.ndarray, weights: np.ndarray) -> NodalLaw:
        return self

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        return self.slip_limit, self.friction


def _nodal(name: str, value: FieldLike | ArrayLike, n: int) -> np.ndarray:
    if callable(value):
        raise TypeError(f"{name}: a function of position must be evaluated at the nodes first (at_nodes)")
    if np.shape(value) not in ((), (n,)):
        raise ValueError(f"{name} must be a number or an array over the {n} contact nodes, got shape {np.shape(value)}")
    return np.array(np.broadcast_to(np.asarray(value, dtype=np.float64), (n,)))


def _parameter(name: str, value: FieldLike | ArrayLike) -> FieldLike | ArrayLike:
    array = checks.real_array(value)
    if array is None:
        raise TypeError(f"{name} must be a number, a function of position or an array, got {checks.described(value)}")
    if not ((array >= 0) & (array <= checks.VAST)).all():
        raise ValueError(f"{name} must be finite and >= 0, and at most {checks.VAST:g}, got {checks.shown(value)}")
    return value


FieldLikeOrArray = Annotated[FieldLike | ArrayLike, partial(checks.function_or, check=_parameter)]


def _at_points(name: str, value: FieldLike | ArrayLike, points: np.ndarray) -> np.ndarray:
    if isinstance(value, np.ndarray) and value.ndim:
        raise TypeError(f"{name} must be a number or a function of position on a ContactProblem; arrays over contact "
                        "nodes belong on a DiscreteProblem")
    return checks.field(name, value, points, minimum=0.0)


def _with(law: _AnyLaw, name: str, values: np.ndarray) -> _AnyLaw:
    result = copy.copy(law)
    object.__setattr__(result, name, values)
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


@dataclass(frozen=True, eq=False)
class Tresca(checks.Checked):
    """Tresca friction: ``|f_t| <= limit``, independent of the pressure.

    Parameters
    ----------
    limit : float, callable or array
        On a ContactProblem a traction in Pa (number or function of position); on a DiscreteProblem the nodal
        forces in N (number or array over the contact nodes).

    Examples
    --------
    >>> am.Tresca(2e6).limit                                            # Pa
    2000000.0
    """

    limit: FieldLikeOrArray

    __repr__, _repr_html_ = brief, html_fields

    def at_nodes(self, points: np.ndarray, weights: np.ndarray) -> Tresca:
        """Return the law with nodal forces: traction times lumped boundary mass."""
        return _with(self, "limit", _at_points("limit", self.limit, points) * weights)

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        return _nodal("limit", self.limit, n_contact), np.zeros(n_contact)


@dataclass(frozen=True, eq=False)
class Coulomb(checks.Checked):
    """Coulomb friction: ``|f_t| <= friction * p``.

    Parameters
    ----------
    friction : float, callable or array
        The coefficient (number or function of position; on a DiscreteProblem also an array over the contact nodes).

    Examples
    --------
    >>> am.Coulomb(0.3).friction
    0.3
    >>> rough = am.Coulomb(lambda x: 0.1 + x[:, 0])
    """

    friction: FieldLikeOrArray

    __repr__, _repr_html_ = brief, html_fields

    def at_nodes(self, points: np.ndarray, weights: np.ndarray) -> Coulomb:
        """Return the law with the coefficient at each contact node."""
        return _with(self, "friction", _at_points("friction", self.friction, points))

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        return np.zeros(n_contact), _nodal("friction", self.friction, n_contact)
