"""TruncatedIteration: the cycles of the truncated multigrid on one level, with safe ones where they are needed.

Safe cycles are taken while the contact status of a cold start changes, and after trouble; each time at most so many,
twice as many as the time before.
"""

from __future__ import annotations

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.multigrid.truncated.step import StepState, TruncatedStep
from adaptmg.solver.result.status import Status
from adaptmg.solver.run import Run
from adaptmg.solver.stop_test import true_error
from adaptmg.solver.truncated.energy_test import EnergyTest, StartTest

__all__ = ["StartIteration", "TruncatedIteration", "WarmIteration"]


class TruncatedIteration:
    """Cycles, measured after the smoothing; see :class:`~adaptmg.solver.iterate.Iteration`.

    Parameters
    ----------
    runner : TruncatedStep
    safe_cycles : int
        At most, the first time.
    cold : bool
        Whether the contact status of the start means nothing.
    run : Run, optional
        With a reference, for the true error.
    problem : DiscreteProblem, optional
        Needed for that.
    start : (n_dofs,) array, optional
        The nested start, where it sets the tolerance.
    hands_over : bool
        Whether another method can go on where cycles are slow.
    """

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
            error = self.runner.unknowns - (self.run.reference.reshape(-1) - self.problem.fixed_values)
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
