r"""Estimate: what an indicator finds for a discrete solution, element by element and in all, and which are marked.

With :math:`\eta_E^2` the square of element E (an energy, N m; in 2D per metre of thickness),

.. math:: \eta = \Bigl(\sum_E \eta_E^2\Bigr)^{1/2}, \qquad \eta / \|u_h\|_A .

Goals (:class:`adaptmg.Goal`) quote a signed estimate of the error of one quantity; their squares only say where to
refine. Doerfler marks a smallest set M (W. Doerfler, SIAM J. Numer. Anal. 33, 1996, doi:10.1137/0733054),

.. math:: \sum_{E \in M} \eta_E^2 \ge \theta \sum_E \eta_E^2 ,

Maximum all elements with :math:`\eta_E^2 \ge \theta \max \eta^2`; theta refers to squares in both.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._text import shortened

if TYPE_CHECKING:
    from adaptmg.hierarchy import Hierarchy
    from adaptmg.mesh.arrays import MeshArrays
    from adaptmg.solver.result import Result


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """An error estimate on the finest mesh of a hierarchy.

    Parameters
    ----------
    squares : (n_elements,) array
        Square of each element's part, >= 0; N m. Of a goal: the absolute value of its part, in the goal's unit; these
        mark, their sum overestimates the error many times and is never quoted.
    norm : float
        Energy norm of the displacement ||u_h||_A, sqrt(N m): what ``relative`` refers to.
    indicator : str
        Name of the indicator, for messages.
    terms : mapping of str to float
        Parts of the sum of squares by name; they add up to it.
    value, signed : float, optional
        Of a goal: the quantity of the discrete solution, and the estimate of exact minus discrete value.

    Examples
    --------
    >>> estimate = am.Estimate(squares=[9.0, 16.0], norm=50.0)
    >>> estimate.total, estimate.relative
    (5.0, 0.1)
    """

    squares: np.ndarray
    norm: float
    indicator: str = ""
    terms: Mapping[str, float] = field(default_factory=dict)
    value: float | None = None
    signed: float | None = None

    if TYPE_CHECKING:
        def __init__(self, *, squares: ArrayLike, norm: float, indicator: str = "", terms: Mapping[str, float] = ...,
                     value: float | None = None, signed: float | None = None) -> None: ...

    def __post_init__(self) -> None:
        object.__setattr__(self, "squares", _checked_squares("squares", self.squares))
        object.__setattr__(self, "norm", checks.nonnegative("norm", self.norm))
        checks.instance("indicator", self.indicator, str, "text")
        checks.instance("terms", self.terms, Mapping, "a mapping of names to parts of the sum of squares")
        terms = {checks.instance("the keys of terms", name, str, "text"): checks.number(f"terms[{name!r}]", part)
                 for name, part in self.terms.items()}
        object.__setattr__(self, "terms", terms)
        for name in ("value", "signed"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, checks.number(name, getattr(self, name)))
        if (self.value is None) != (self.signed is None):
            raise ValueError("value and signed belong together: give both, or neither")

    @property
    def total(self) -> float:
        """Square root of the sum of squares, sqrt(N m); of a goal the absolute value of ``signed``, in its unit."""
        return float(np.sqrt(self.squares.sum())) if self.signed is None else abs(self.signed)

    @property
    def relative(self) -> float:
        """``total`` over ||u_h||_A; of a goal over ``|value|``, infinite where that is 0 and a square is not."""
        size = self.norm if self.value is None else abs(self.value)
        if size > 0:
            return self.total / size
        infinite = self.total > 0 or (self.value is not None and bool(self.squares.any()))
        return np.inf if infinite else 0.0

    def __repr__(self) -> str:
        return shortened(str(self))

    def __str__(self) -> str:
        lines = [f"Estimate by {self.indicator or 'an indicator'}: {len(self.squares)} elements"]
        if self.signed is None:
            lines.append(f"  total {self.total:.4g} sqrt(N m), relative {self.relative:.3%} of "
                         f"||u||_A = {self.norm:.4g} sqrt(N m)")
        else:
            lines.append(f"  value {self.value:.8g}, estimated error {self.signed:+.3g} (exact minus discrete), "
                         f"relative {self.relative:.3%}")
        whole = sum(self.terms.values())
        lines += [f"  {name:<28s} {part:11.4g} {part / whole:7.1%}" for name, part in self.terms.items() if whole > 0]
        return "\n".join(lines)


def _checked_squares(name: str, squares: object) -> np.ndarray:
    result = checks.array(name, squares, (None,))
    if not len(result) or result.min() < 0:
        raise ValueError(f"{name} must be numbers >= 0, one for each element, got {checks.shown(squares)}")
    return result


if TYPE_CHECKING:
    from typing_extensions import TypeVar  # Python's has no default before 3.13

    #: what an indicator returns, and so the steps of a loop with it hold
    Found = TypeVar("Found", bound=Estimate, default=Estimate, covariant=True)
else:
    Found = TypeVar("Found", covariant=True)


class Indicator(Protocol[Found]):
    """What estimates the error: Residual, Recovery, Goal or a user-defined object."""

    def indicate(self, hierarchy: Hierarchy, result: Result) -> Found:
        """Return the estimate for the elements of the finest mesh."""


def estimate_of(indicator: Indicator, hierarchy: Hierarchy, result: Result) -> Estimate:
    """Return the estimate of an indicator, of the elements of the finest mesh."""
    return estimate_for(hierarchy.finest.mesh, indicator.indicate(hierarchy, result),
                        f"what the indicator {checks.shown(indicator)} returns")


def estimate_for(mesh: MeshArrays, estimate: Estimate, name: str = "estimate") -> Estimate:
    """Return an estimate, checked to be one of the elements of a mesh."""
    checks.instance(name, estimate, Estimate, "an Estimate")
    if len(estimate.squares) != len(mesh.elements):
        raise ValueError(f"{name} is of {len(estimate.squares)} elements, but mesh has {len(mesh.elements)}")
    return estimate


class Mark(Protocol):
    """What chooses the elements to refine: Doerfler, Maximum or a user-defined object."""

    def mark(self, estimate: Estimate) -> np.ndarray:
        """Return the mask (n_elements,) of the marked elements."""


def marks_of(mark: Mark, estimate: Estimate) -> np.ndarray:
    """Return the mask (n_elements,) that a marking chooses, checked."""
    mask = mark.mark(estimate)
    if not isinstance(mask, np.ndarray) or mask.dtype.kind != "b" or mask.shape != estimate.squares.shape:
        raise TypeError(f"mark: {checks.shown(mark)} must return a boolean mask over the {len(estimate.squares)} "
                        f"elements, got {checks.described(mask)}")
    return mask


@dataclass(frozen=True)
class Doerfler:
    """Bulk marking: the smallest set of elements that holds the share ``theta`` of the sum of squares.

    Parameters
    ----------
    theta : float
        Share of the sum of squares, above 0 and at most 1; larger shares take fewer steps.

    Examples
    --------
    >>> am.Doerfler(0.3).theta
    0.3
    """

    theta: float = 0.8

    def __post_init__(self) -> None:
        object.__setattr__(self, "theta", _share(self.theta))

    def mark(self, estimate: Estimate | np.ndarray) -> np.ndarray:
        """Return the mask (n_elements,) of the marked elements of an estimate or of its squares (n_elements,).

        Of elements with equal squares those with the lowest numbers come first; none are marked where all are 0.
        """
        squares = _squares(estimate)
        total, mask = squares.sum(), np.zeros(len(squares), dtype=bool)
        if total == 0:
            return mask
        order = np.argsort(-squares, kind="stable")
        reached = np.cumsum(squares[order])
        # a sum in another order differs by rounding: theta = 1 takes every element that has a part
        count = min(int(np.searchsorted(reached, self.theta * min(total, reached[-1]))) + 1, len(squares))
        mask[order[:count]] = True
        return mask & (squares > 0)


@dataclass(frozen=True)
class Maximum:
    """The elements whose square is at least the share ``theta`` of the largest; larger marks less.

    Parameters
    ----------
    theta : float
        Share of the largest square, above 0 and at most 1.

    Examples
    --------
    >>> am.Maximum(0.5).theta
    0.5
    """

    theta: float = 0.5

    def __post_init__(self) -> None:
        object.__setattr__(self, "theta", _share(self.theta))

    def mark(self, estimate: Estimate | np.ndarray) -> np.ndarray:
        """Return the mask (n_elements,) of the marked elements of an estimate or of its squares (n_elements,)."""
        squares = _squares(estimate)
        return (squares >= self.theta * squares.max()) & (squares > 0)


def _share(theta: float) -> float:
    result = checks.number("theta", theta)
    if not 0 < result <= 1:
        raise ValueError(f"theta must be > 0 and <= 1, got {checks.shown(theta)}")
    return result


def _squares(estimate: Estimate | np.ndarray) -> np.ndarray:
    return estimate.squares if isinstance(estimate, Estimate) else _checked_squares("estimate", estimate)
