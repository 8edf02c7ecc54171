"""The multigrid ingredients: coarse spaces, corrections, cycles, coarse solves, nested start."""

from adaptmg.multigrid.coarse_solve import CoarseSolve
from adaptmg.multigrid.cycle import Cycle
from adaptmg.multigrid.monotone import Monotone
from adaptmg.multigrid.nested import NestedStart
from adaptmg.multigrid.paper import PaperCorrection

__all__ = ["CoarseSolve", "Cycle", "Monotone", "NestedStart", "PaperCorrection"]
