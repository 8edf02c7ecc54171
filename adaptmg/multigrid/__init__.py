"""The multigrid ingredients: coarse spaces, corrections, cycles, coarse solves, nested start."""

from adaptmg.multigrid.cycle import CoarseSolve, Cycle, Monotone, NestedStart, PaperCorrection

__all__ = ["CoarseSolve", "Cycle", "Monotone", "NestedStart", "PaperCorrection"]


def __dir__() -> list[str]:
    return __all__
