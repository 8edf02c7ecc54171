"""Step: what each round of the adaptive loop yields. Printing it shows a line of a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.goals.goal_estimate import GoalEstimate
from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.history.load_path import PathResult
from adaptmg.solver.result import Result

__all__ = ["Ending", "Step", "settled"]


def settled(estimate: Estimate, before: Estimate | None) -> bool | None:
    """:attr:`Step.settled` of an estimate, given that of the mesh before."""
    if estimate.signed is None:
        return None
    if before is None or before.signed is None:
        return False
    (values, errors), (old_values, old_errors) = map(_values_and_errors, (estimate, before))
    change = np.abs(values + errors - old_values - old_errors) if values.shape == old_values.shape else np.inf
    return bool(((errors * old_errors > 0) & (change <= np.abs(errors))).all())


def _values_and_errors(estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(estimate, GoalEstimate):
        return estimate.values, estimate.errors
    return np.array([estimate.value]), np.array([estimate.signed])


@dataclass
class Ending:
    """Why a loop stopped after a step; empty as long as it has not."""

    words: str = ""


@dataclass(frozen=True, eq=False, repr=False)
class Step:
    """A mesh of the adaptive loop, solved and estimated.

    Attributes
    ----------
    number : int
        0 for the start.
    hierarchy : Hierarchy
        All levels that were used; its finest is the mesh of the step.
    result : Result
        On it; of a load path that of the load step by which the mesh is refined.
    estimate : Estimate
    timings : dict of str to float
        Seconds of this step by phase: "mesh" (marking and refining the mesh before), "assembly", "transfer", "levels"
        (which meshes stay), "solve", "estimate", "store".
    total_seconds : float
        Of all steps so far.
    work_units : float
        Of the solve, in passes over the finest matrix of this step.
    total_work_units : float
        Of all solves so far, in passes over the finest matrix of this step.
    path : PathResult or None
        All load steps, where there is a load path.
    settled : bool or None
        Of a goal: whether its signed estimates can be trusted, which the first mesh never says: they have the sign of
        those of the mesh before, and are no smaller than the change of the corrected values since then. Otherwise a
        question mark is printed before the estimate, and the loop does not end by ``tolerance``. None for energy norms.
    """

    #: heading of the lines that steps print
    HEADER: ClassVar[str] = (f"{'step':>4} {'nodes':>8} {'levels':>6} {'contact':>7} {'estimate':>9} {'cycles':>6} "
                             f"{'work':>6} {'in all':>6} {'seconds':>8} {'in all':>8}")

    number: int
    hierarchy: Hierarchy
    result: Result
    estimate: Estimate
    timings: Mapping[str, float]
    total_seconds: float
    work_units: float
    total_work_units: float
    path: PathResult | None = None
    settled: bool | None = None
    ending: Ending = field(default_factory=Ending)

    @property
    def nodes(self) -> int:
        """Nodes of the mesh."""
        return self.hierarchy.finest.n_nodes

    @property
    def seconds(self) -> float:
        """Of this step, the mesh included."""
        return float(sum(self.timings.values()))

    @property
    def outcome(self) -> str:
        """Why the loop stopped after this step, in words; empty as long as it has not."""
        return self.ending.words

    def __repr__(self) -> str:
        estimate = f"{'?' if self.settled is False else ''}{self.estimate.relative:.3%}"
        line = (f"{self.number:>4} {self.nodes:>8} {len(self.hierarchy):>6} {len(self.result.contact):>7} "
                f"{estimate:>9} {self.result.cycles:>6} {self.work_units:>6.1f} "
                f"{self.total_work_units:>6.1f} {self.seconds:>8.3f} {self.total_seconds:>8.3f}")
        return f"{line}  {self.outcome}" if self.outcome else line
