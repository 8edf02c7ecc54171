"""Truncated: the options of the truncated nonsmooth Newton multigrid."""

from __future__ import annotations

from dataclasses import dataclass

from adaptmg.problem import checks

__all__ = ["Truncated"]


@dataclass(frozen=True, kw_only=True)
class Truncated:
    """Truncated nonsmooth Newton multigrid: the fast method.

    Parameters
    ----------
    recombine : int
        Past iterates recombined with the present one, 0 to 2.
    safe_cycles : int
        Cycles with g frozen, symmetric truncation and a line search at most, taken while the contact status changes;
        they make cold starts safe.
    """

    recombine: int = 2
    safe_cycles: int = 20

    def __post_init__(self) -> None:
        if checks.integer("recombine", self.recombine) > 2:
            raise ValueError(f"recombine must be 0, 1 or 2, got {self.recombine!r}")
        checks.integer("safe_cycles", self.safe_cycles)
