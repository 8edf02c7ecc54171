"""iterate: the one loop over cycles, sweeps or Newton steps of every method."""

from __future__ import annotations

from typing import Protocol

from adaptmg.solver.result.status import Status
from adaptmg.solver.run import Run
from adaptmg.solver.stop_test import StopTest

__all__ = ["Iteration", "iterate"]


class Iteration(Protocol):
    """What a method offers to the loop; it holds its unknowns.

    Attributes
    ----------
    cycles : int
        Cycles, sweeps or steps done.
    """

    cycles: int

    def start(self) -> None:
        """What comes before the first measurement: a smoothing, the first sweeps; perhaps nothing."""

    def measure(self, stop: StopTest) -> None:
        """Hand to the test what is known of the present iterate."""

    def row(self, stop: StopTest) -> dict[str, float] | None:
        """What the history keeps of it; None for no row."""

    def step(self, stop: StopTest) -> Status | None:
        """Go on to the next iterate; a status where the method gives up."""


def iterate(method: Iteration, stop: StopTest, run: Run | None = None) -> Status:
    """Measure, judge and step until the test or the method ends it.

    Parameters
    ----------
    method : Iteration
    stop : StopTest
    run : Run, optional
        Where rows of the history go.
    """
    method.start()
    while True:
        method.measure(stop)
        row = None if run is None else method.row(stop)
        if row is not None:
            run.record(cycle=method.cycles, **row)
        status = stop.verdict(method.cycles)
        if status is None:
            status = method.step(stop)
        if status is not None:
            return status
