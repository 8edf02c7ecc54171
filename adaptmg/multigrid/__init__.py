"""The multigrid ingredients: coarse spaces, corrections, cycles, coarse solves, nested start."""

from adaptmg.multigrid.cycle import (
    CoarseSolve,
    Cycle,
    Monotone,
    NestedStart,
    PaperCorrection,
    local_prolongations,
)
from adaptmg.multigrid.linear_cycle import PyAMG

__all__ = [
    "CoarseSolve",
    "Cycle",
    "Monotone",
    "NestedStart",
    "PaperCorrection",
    "PyAMG",
    "local_prolongations",
]


def __dir__() -> list[str]:
    return __all__
