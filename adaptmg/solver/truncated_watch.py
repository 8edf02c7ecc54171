"""TruncatedWatch: when the truncated multigrid stops, and when it is in trouble."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.solver.convergence import Convergence
from adaptmg.solver.run import Run
from adaptmg.solver.sizes import Sizes, displacement_norm, energy_norm

if TYPE_CHECKING:
    from adaptmg.multigrid.truncated.step import TruncatedStep

__all__ = ["TruncatedWatch"]


class TruncatedWatch:
    """Follows the residuals and coarse corrections of one level.

    Parameters
    ----------
    problem : DiscreteProblem
    rtol : float or "discretisation"
        Bounds the estimated relative A-norm error; the natural residual must fall below
        ``Convergence.RESIDUAL_FACTOR`` times it. "discretisation": see :meth:`take_discretisation_error`.
    run : Run, optional
        Where rows of the history go.

    Attributes
    ----------
    sizes : Sizes
        What residuals and errors are related to.
    size : float
        A-norm of the displacement, as last measured.
    residual, error_estimate : float
        Relative, at the last check.
    """

    #: the energy of the coarse correction misses what the smoothing removes, and all the corrections that follow: the
    #: error is up to the larger of SAFETY and TAIL / (1 - rate) times larger
    SAFETY, TAIL = 2.0, 1.5
    #: a rate that is not believed before so many ratios of energies are known
    EARLY_RATE, EARLY = 0.3, 3
    #: share of the discretisation error that may remain with rtol="discretisation"
    SHARE = 0.1
    #: the largest tolerance that comes from that: a start further off shows no discretisation error
    COARSEST = 1e-2
    #: checks without a new smallest residual after which an iteration is in trouble, and after which it has stalled
    TROUBLE, PATIENCE = 6, 60
    #: cycles over which the speed is measured once there are twice as many, and the share of what is left that is most
    WINDOW, MOST = 12, 0.7

    def __init__(self, problem: DiscreteProblem, rtol: float | str, run: Run | None = None) -> None:
        self.problem, self.run = problem, run
        self.rtol = 0.0 if rtol == "discretisation" else rtol
        self.size, self.residual, self.error_estimate = 0.0, np.inf, np.inf
        self.energies: list[float] = []
        self.residuals: list[float] = []
        self._first = self._last = np.nan
        self.doubts, self._caution = 0, 1.0
        self.sizes = Sizes(problem)
        self._since = 0

    def measure(self, runner: TruncatedStep, cycle: int) -> None:
        """Measure the displacement after a smoothing; each cycle only where it has to grow into prescribed values."""
        if cycle % 4 == 0 or self.sizes.prescribed:
            self.size = self.sizes.norm(runner.unknowns, runner.energy())

    def check(self, residual: float, scale: float, floor: float, idle: bool = False) -> bool:
        """Take the norms of the natural residual and of the acting forces after a smoothing; True if it is enough.

        A residual of ``Convergence.ROUNDING`` times ``floor`` cannot be bettered; ``idle``: nor can the forces.
        """
        if idle and residual <= Convergence.ROUNDING * floor:
            residual = 0.0
        self.residual = residual / scale if scale > 0 else (0.0 if residual == 0 else np.inf)
        self.residuals.append(self.residual)
        self._last = residual
        if len(self.residuals) == 1:
            self._first = residual
        if self.at_rounding(floor):
            self.error_estimate = self.residual
            return True
        rate = self.safe_rate
        if len(self.energies) <= self.EARLY:
            rate = max(rate, self.EARLY_RATE)
        if self.size > 0 and rate < 1:
            factor = self._caution * max(self.SAFETY, self.TAIL / (1 - rate))
            self.error_estimate = factor * self.energies[-1] * rate / self.size
        else:
            self.error_estimate = np.inf
        return self.error_estimate <= self.rtol and self.residual <= Convergence.RESIDUAL_FACTOR * self.rtol

    def at_rounding(self, floor: float) -> bool:
        """Whether the last residual is as small as arithmetic allows, ``floor`` being the norm of D u, N."""
        return self._last <= Convergence.ROUNDING * floor and self.residual <= Convergence.ROUNDING_LIMIT

    def doubt(self, ratio: float) -> None:
        """Be so many times more cautious from now on; 0 leaves all as it is."""
        if ratio > 0.0:
            self.doubts += 1
            self._caution *= max(2.0, 1.5 * ratio)

    def corrected(self, energy: float) -> None:
        """Take the energy of a coarse correction, N m."""
        self.energies.append(float(np.sqrt(abs(energy))))

    def take_discretisation_error(self, change: float) -> None:
        r"""Set rtol from the A-norm of what the first cycle changed in the nested start.

        By orthogonality and an error that halves with the mesh size,
        :math:`|u - u_h| = |u_h - u_{2h}|/\sqrt 3`; a tenth of it is the tolerance.
        """
        if self.size > 0:
            self.rtol = min(self.SHARE * change / np.sqrt(3.0) / self.size, self.COARSEST)

    def record(self, runner: TruncatedStep, cycle: int, changed: int) -> None:
        """Add a row to the history."""
        if self.run is None:
            return
        change = self.energies[-1] / self.size if self.energies and self.size > 0 else np.nan
        values = {"residual": self.residual, "change": change, "error_estimate": self.error_estimate,
                  "status_changes": float(changed)}
        if self.run.reference is not None:
            with self.run.untimed():
                values["true_error"] = self._true_error(runner.unknowns)
        self.run.record(cycle=cycle, **values)

    def _true_error(self, unknowns: np.ndarray) -> float:
        matrix = self.problem.matrix
        error = unknowns - (self.run.reference.reshape(-1) - self.problem.fixed_values)
        size = displacement_norm(self.problem, self.run.reference)
        return energy_norm(error, matrix @ error) / size if size > 0 else np.nan

    @property
    def rate(self) -> float:
        """Geometric mean of the last (at most five) ratios of energies; NaN before the second."""
        return self._mean_ratio(5)

    @property
    def safe_rate(self) -> float:
        """The larger of the last ratio and the mean of the last three; NaN if unknown."""
        return max(self._mean_ratio(1), self._mean_ratio(3)) if len(self.energies) > 1 else np.nan

    def _mean_ratio(self, window: int) -> float:
        window = min(window, len(self.energies) - 1)
        if window < 1:
            return np.nan
        first, last = self.energies[-1 - window], self.energies[-1]
        if last == 0.0:
            return 0.0
        return float((last / first) ** (1 / window)) if first > 0 else np.inf

    def in_trouble(self) -> bool:
        """Whether the residual has reached no new minimum for a while; then the count begins anew."""
        self._since += 1
        window = self.residuals[-self.TROUBLE:]
        if self._since < self.TROUBLE or window[0] > min(window[1:]):
            return False
        self._since = 0
        return True

    def too_slow(self, left: int) -> bool:
        """Whether, as fast as the last cycles went, the tolerance is not reached in most of the cycles ``left``."""
        if len(self.energies) <= 2 * self.WINDOW or not self.rtol > 0:
            return False
        first, last = self.energies[-1 - self.WINDOW], self.energies[-1]
        if not 0 < last < first:
            return True
        gap = max(self.error_estimate / self.rtol, self.residual / (Convergence.RESIDUAL_FACTOR * self.rtol), 1.0)
        return np.log(gap) * self.WINDOW / np.log(first / last) > self.MOST * left

    @property
    def diverged(self) -> bool:
        """Whether the residual is not finite or has grown without bound.

        Its absolute norm is what counts: reactions, to which it is related elsewhere, grow with it.
        """
        return not np.isfinite(self.residual) or self._last > 1e6 * max(self._first, 1e-300)

    @property
    def stalled(self) -> bool:
        """Whether the residual has reached no new minimum for ``PATIENCE`` checks."""
        return (len(self.residuals) > self.PATIENCE
                and int(np.argmin(self.residuals)) < len(self.residuals) - self.PATIENCE)
