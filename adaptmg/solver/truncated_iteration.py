r"""TruncatedIteration: the cycles of the truncated multigrid on one level, with safe ones where they are needed.

Safe cycles are taken while the contact status of a cold start changes, and after trouble; each time at most so many,
twice as many as the time before.

EnergyTest: when the truncated multigrid stops, and when it is in trouble.

The energy :math:`\eta_k^2 = \tilde r_k \cdot e_k` of the correction that the next coarser level proposes estimates the
error it removes; with the rate :math:`\rho = \eta_k/\eta_{k-1}` (the larger of the last ratio and the mean of the last
three) the error after the next smoothing is :math:`\rho\,\eta_k`. Together with the natural residual, which every
smoothing leaves behind, it decides when to stop, at no further pass over a matrix.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.multigrid.truncated_step import StepState, TruncatedStep
from adaptmg.solver.examine import Sizes
from adaptmg.solver.iterate import StopTest, true_error
from adaptmg.solver.record import Run
from adaptmg.solver.status import Status

__all__ = ["EnergyTest", "StartIteration", "StartTest", "TruncatedIteration", "WarmIteration", "WarmTest"]

class TruncatedIteration:
    """Cycles, measured after the smoothing; see :class:`~adaptmg.solver.iterate.Iteration`."""

    #: times that safe cycles are tried when the residual stops falling
    TROUBLES = 1

    def __init__(self, runner: TruncatedStep, safe_cycles: int, cold: bool, run: Run | None = None,
                 problem: DiscreteProblem | None = None, start: np.ndarray | None = None,
                 hands_over: bool = False) -> None:
        self.runner, self.run, self.problem, self.from_nested = runner, run, problem, start
        self.hands_over = hands_over
        self.cycles = self.troubles = self.changed = 0
        self.most, self.safe = safe_cycles, safe_cycles if cold else 0

    def start(self) -> None:
        """Smooth."""
        self.runner.smooth()

    def measure(self, stop: EnergyTest) -> None:
        """What the smoothing leaves behind."""
        stop.measure_size(self.runner, self.cycles)
        state = self._truncate(stop)
        self.changed = state.changed
        self.safe = self.safe - 1 if self.safe > 0 and state.changed else 0
        unknowns, early = self.runner.unknowns, self.cycles < 2
        # an exact start has no rate to measure, and needs none
        floor = self.runner.rounding() if early or stop.sizes.prescribed else 0.0
        forces = stop.sizes.forces(unknowns, state.reactions)
        idle = stop.idle(forces, floor, unknowns)
        stop.take_residual(state.residual, forces, floor if early or idle else 0.0, idle)

    def _truncate(self, stop: EnergyTest) -> StepState:
        return self.runner.truncate(safe=self.safe > 0)

    def row(self, stop: EnergyTest) -> dict[str, float]:
        """See :class:`~adaptmg.solver.iterate.Iteration`."""
        values = stop.measures() | {"status_changes": float(self.changed)}
        if self.run is not None and self.run.reference is not None:
            error = self.runner.unknowns - self.problem.from_prescribed(self.run.reference)
            values["true_error"] = true_error(error, self.problem.matrix, self.problem, self.run)
        return values

    def step(self, stop: EnergyTest) -> Status | None:
        """Correct and smooth, unless the iteration goes nowhere."""
        stop.corrected(self.runner.correct())
        self.cycles += 1
        if self.safe == 0 and stop.in_trouble():
            self.troubles += 1
            if self.troubles > self.TROUBLES:
                return Status.STALLED
            self.most *= 2
            self.safe = self.most
        if self.safe == 0 and self.hands_over and stop.too_slow(stop.limit - self.cycles):
            return Status.STALLED
        if self.cycles == 1 and self.from_nested is not None:
            stop.take_discretisation_error(self.runner.distance(self.from_nested))
        self.runner.smooth()
        return None


class WarmIteration(TruncatedIteration):
    """The cycles from a start that is nearly solved; frozen ones as long as the residual belies that."""

    def _truncate(self, stop: EnergyTest) -> StepState:
        trusted = StartTest.TRUSTED * stop.sizes.forces(self.runner.unknowns, 0.0)
        return self.runner.truncate(safe=self.safe > 0, trusted=trusted)


class StartIteration(TruncatedIteration):
    """The cycles of a nested start; Newton cycles where the residual is small enough to trust them."""

    def measure(self, stop: StartTest) -> None:
        """See :class:`TruncatedIteration`; sizes of displacements do not matter."""
        unknowns, sizes = self.runner.unknowns, stop.sizes
        state = self.runner.truncate(safe=False, trusted=stop.TRUSTED * sizes.forces(unknowns, 0.0))
        stop.take_residual(state.residual, sizes.forces(unknowns, state.reactions), 0.0)

    def step(self, stop: StartTest) -> Status | None:
        """Correct, and smooth if there are further cycles."""
        self.runner.correct()
        self.cycles += 1
        if stop.enough(self.cycles):
            return Status.LIMIT
        self.runner.smooth()
        return None


class EnergyTest(StopTest):
    """Follows the residuals and coarse corrections of one level."""

    #: the energy of the coarse correction misses what the smoothing removes, and all the corrections that follow: the
    #: error is up to the larger of SAFETY and TAIL / (1 - rate) times larger
    SAFETY, TAIL = 2.0, 1.5
    #: a rate that is not believed before so many ratios of energies are known
    EARLY_RATE, EARLY = 0.3, 3
    #: share of the discretisation error that may remain with rtol="discretisation"
    SHARE = 0.1
    #: the largest tolerance that comes from that: a start further off shows no discretisation error
    COARSEST = 1e-2
    #: iterates without a new smallest residual after which an iteration is in trouble
    TROUBLE = 6
    #: cycles over which the speed is measured once there are twice as many, and the share of what is left that is most
    WINDOW, MOST = 12, 0.7

    def __init__(self, problem: DiscreteProblem, rtol: float | str, limit: float = np.inf,
                 certificate: Callable[[float], float] | None = None) -> None:
        super().__init__(0.0 if rtol == "discretisation" else rtol, limit, Sizes(problem), certificate)
        self.residuals: list[float] = []
        self._first = np.nan
        self._since = 0

    def measure_size(self, runner: TruncatedStep, cycle: int) -> None:
        """Measure the displacement after a smoothing; each cycle only where it has to grow into prescribed values."""
        if cycle % 4 == 0 or self.sizes.prescribed:
            self.size = self.sizes.norm(runner.unknowns, runner.energy())

    def take_residual(self, residual: float, forces: float, floor: float, idle: bool = False) -> None:
        """See :class:`~adaptmg.solver.iterate.StopTest`."""
        super().take_residual(residual, forces, floor, idle)
        self.residuals.append(self.residual)
        if len(self.residuals) == 1:
            self._first = self._last

    def _estimate(self) -> float:
        rate = self.safe_rate
        if len(self.changes) <= self.EARLY:
            rate = max(rate, self.EARLY_RATE)
        if not (self.size > 0 and rate < 1):
            return np.inf
        return max(self.SAFETY, self.TAIL / (1 - rate)) * self.changes[-1] * rate / self.size

    def corrected(self, energy: float) -> None:
        """Take the energy of a coarse correction, N m."""
        self.changes.append(float(np.sqrt(abs(energy))))

    def take_discretisation_error(self, change: float) -> None:
        r"""Set rtol from the A-norm of what the first cycle changed in the nested start.

        By orthogonality and an error that halves with the mesh size,
        :math:`|u - u_h| = |u_h - u_{2h}|/\sqrt 3`; a tenth of it is the tolerance.
        """
        if self.size > 0:
            self.rtol = min(self.SHARE * change / np.sqrt(3.0) / self.size, self.COARSEST)

    def in_trouble(self) -> bool:
        """Whether the residual has reached no new minimum for a while; then the count begins anew."""
        self._since += 1
        window = self.residuals[-self.TROUBLE:]
        if self._since < self.TROUBLE or window[0] > min(window[1:]):
            return False
        self._since = 0
        return True

    def too_slow(self, left: float) -> bool:
        """Whether, as fast as the last cycles went, the tolerance is not reached in most of the cycles ``left``."""
        if len(self.changes) <= 2 * self.WINDOW or not self.rtol > 0:
            return False
        first, last = self.changes[-1 - self.WINDOW], self.changes[-1]
        if not 0 < last < first:
            return True
        gap = max(self.error_estimate / self.rtol, self.residual / (self.RESIDUAL_FACTOR * self.rtol), 1.0)
        return np.log(gap) * self.WINDOW / np.log(first / last) > self.MOST * left

    @property
    def better(self) -> bool:
        """Whether the last iterate is better than the first one."""
        return self.residual < self.residuals[0] and not self.diverged

    def _ran_away(self) -> bool:
        """Whether the absolute norm has grown: reactions, to which it is related elsewhere, grow with it."""
        return self._last > 1e6 * max(self._first, 1e-300)

    @property
    def stalled(self) -> bool:
        """Whether the residual has reached no new minimum for ``PATIENCE`` iterates."""
        return self._no_new_minimum(self.residuals)


class StartTest(EnergyTest):
    """So many cycles of a nested start, and more as long as the residual is large; :meth:`enough` ends them."""

    #: natural residual, relative, above which a nested start is not left to Newton cycles nor to the next level
    TRUSTED = 0.1

    def __init__(self, problem: DiscreteProblem, wanted: int, most: int) -> None:
        super().__init__(problem, 0.0)
        self._wanted, self._most = wanted, most

    def verdict(self, cycles: int) -> Status | None:
        """Never before the correction that follows."""
        return None

    def enough(self, cycles: int) -> bool:
        """Whether the next level may begin after so many cycles."""
        return cycles >= self._most or (cycles >= self._wanted and self.residual <= self.TRUSTED)


class WarmTest(EnergyTest):
    """For a start that is nearly solved: a rate is taken for known before one is measured, so that a cycle may do."""

    def __init__(self, problem: DiscreteProblem, rtol: float, limit: float, certificate: Callable[[float], float],
                 rate: float) -> None:
        super().__init__(problem, rtol, limit, certificate)
        self._known = rate

    @property
    def safe_rate(self) -> float:
        """See :class:`~adaptmg.solver.iterate.StopTest`; after one cycle the rate that is known."""
        return self._known if len(self.changes) == 1 else super().safe_rate
