r"""Marking: which elements to refine, by their parts :math:`\eta_E^2` of an estimate.

Doerfler (bulk): a smallest set M with (W. Doerfler, SIAM J. Numer. Anal. 33, 1996, doi:10.1137/0733054)

.. math:: \sum_{E \in M} \eta_E^2 \ge \theta \sum_E \eta_E^2 ,

maximum: all elements with :math:`\eta_E^2 \ge \theta \max \eta^2`. Theta refers to squares in both. Any object with
``mark(estimate) -> mask`` serves as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.estimate.estimate import Estimate
from adaptmg.problem import check_arrays, checks

__all__ = ["Doerfler", "Maximum"]


@dataclass(frozen=True)
class Doerfler:
    """Bulk marking: the smallest set of elements that holds the share ``theta`` of the sum of squares.

    Parameters
    ----------
    theta : float
        Of the sum of squares, above 0 and at most 1. Larger marks more.
    """

    theta: float = 0.5

    def __post_init__(self) -> None:
        object.__setattr__(self, "theta", _share(self.theta))

    def mark(self, estimate: Estimate | np.ndarray) -> np.ndarray:
        """The marked elements.

        Parameters
        ----------
        estimate : Estimate or (n_elements,) array
            An estimate, or its squares.

        Returns
        -------
        (n_elements,) bool array
            Of elements with equal squares those with the lowest numbers come first; none where all squares are 0.

        Raises
        ------
        ValueError
            If a square is negative or not finite.
        """
        squares = _squares(estimate)
        total = squares.sum()
        mask = np.zeros(len(squares), dtype=bool)
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
    """The elements whose square is at least the share ``theta`` of the largest.

    Parameters
    ----------
    theta : float
        Of the largest square, above 0 and at most 1. Larger marks less.
    """

    theta: float = 0.5

    def __post_init__(self) -> None:
        object.__setattr__(self, "theta", _share(self.theta))

    def mark(self, estimate: Estimate | np.ndarray) -> np.ndarray:
        """The marked elements (n_elements,), bool; parameters and errors as of :meth:`Doerfler.mark`."""
        squares = _squares(estimate)
        return (squares >= self.theta * squares.max()) & (squares > 0)


def _share(theta: float) -> float:
    result = checks.number("theta", theta)
    if not 0 < result <= 1:
        raise ValueError(f"theta must be > 0 and <= 1, a share, got {checks.shown(theta)}")
    return result


def _squares(estimate: Estimate | np.ndarray) -> np.ndarray:
    """Squares of an estimate, which has checked them, or of an array."""
    if isinstance(estimate, Estimate):
        return estimate.squares
    squares = check_arrays.vector("estimate", estimate)
    if not len(squares):
        raise ValueError("estimate is empty: give an Estimate, or the square of each element")
    if not squares.min() >= 0:
        raise ValueError(f"estimate: squares must be >= 0, got {squares.min()} in element {int(np.argmin(squares))}")
    return squares
