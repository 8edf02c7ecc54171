"""Step: what each round of the adaptive loop yields. Printing it shows a line of a table."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from adaptmg.estimate.estimate import Estimate
from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.history.load_path import PathResult
from adaptmg.solver.result import Result

__all__ = ["Ending", "Step"]


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
        line = (f"{self.number:>4} {self.nodes:>8} {len(self.hierarchy):>6} {len(self.result.contact):>7} "
                f"{self.estimate.relative:>9.3%} {self.result.cycles:>6} {self.work_units:>6.1f} "
                f"{self.total_work_units:>6.1f} {self.seconds:>8.3f} {self.total_seconds:>8.3f}")
        return f"{line}  {self.outcome}" if self.outcome else line
