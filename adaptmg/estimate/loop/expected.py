r"""What the loop expects of its next meshes: estimates, tolerances, and when it will end.

With N nodes in d dimensions good meshes have :math:`\eta \sim N^{-1/d}`; the cost of the meshes so far is about
proportional to the nodes of the last, as they grow geometrically.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from adaptmg.estimate.loop.step import Step
from adaptmg.problem import checks

__all__ = ["Limits", "algebraic_tolerance", "expected_estimate", "expected_seconds"]

#: share of the expected estimate that the algebraic error may have
SHARE = 0.1
#: bounds of the tolerances that come from it: coarse meshes are cheap, and what is exact needs no more than this
LOOSEST, TIGHTEST = 3e-2, 1e-10


@dataclass(frozen=True, kw_only=True)
class Limits:
    """When the loop ends.

    Parameters
    ----------
    tolerance : float, optional
        For the relative estimate.
    max_nodes : int, optional
    max_seconds : float, optional
    """

    tolerance: float | None = None
    max_nodes: int | None = None
    max_seconds: float | None = None

    def __post_init__(self) -> None:
        if self.tolerance is None and self.max_nodes is None and self.max_seconds is None:
            raise ValueError("give at least one of tolerance, max_nodes and max_seconds: the loop would never end")
        if self.tolerance is not None:
            object.__setattr__(self, "tolerance", checks.tolerance("tolerance", self.tolerance))
        if self.max_nodes is not None:
            checks.integer("max_nodes", self.max_nodes, 1)
        if self.max_seconds is not None:
            object.__setattr__(self, "max_seconds", checks.positive("max_seconds", self.max_seconds))


def expected_estimate(before: Step, nodes: int, dim: int) -> float:
    """The relative energy error that a mesh of so many nodes should have after a step."""
    return before.estimate.relative_energy * (before.nodes / nodes) ** (1 / dim)


def algebraic_tolerance(expected: float) -> float:
    """Tolerance of a solve, relative to ||u||_A, on a mesh with an expected relative energy error; three digits."""
    return float(f"{min(max(SHARE * expected, TIGHTEST), LOOSEST):.3g}")


def expected_seconds(steps: Sequence[Step], limits: Limits) -> float:
    """Seconds that the whole loop will have taken when the first limit stops it; NaN if nothing can be told."""
    last, ends = steps[-1], []
    if limits.max_nodes is not None:
        ends.append(last.total_seconds * max(limits.max_nodes / last.nodes, 1.0))
    if limits.tolerance is not None and last.estimate.relative > 0:
        dim = last.result.dim
        ends.append(last.total_seconds * max(last.estimate.relative / limits.tolerance, 1.0) ** dim)
    if limits.max_seconds is not None:
        ends.append(max(limits.max_seconds, last.total_seconds))
    return min(ends) if ends else float("nan")
