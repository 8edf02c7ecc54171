"""The multigrid cycle of the monotone and the paper's correction. Fig. 1 of the paper shows its shapes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from adaptmg.multigrid.coarse_solve import CoarseSolve
from adaptmg.multigrid.correction import Correction, InitialContact, Recorder, correction_contact
from adaptmg.multigrid.correction_levels import CorrectionLevels
from adaptmg.problem import checks
from adaptmg.smoother.gauss_seidel import Smoother
from adaptmg.smoother.residuals import residual
from adaptmg.smoother.system import LocalProblem, NodalContact

__all__ = ["Condensation", "Cycle", "MultigridCycle"]


class Condensation(Protocol):
    """A matrix condensed to its contact dofs; :class:`adaptmg.solver.linear.condensation.Condensed` is one."""

    @property
    def problem(self) -> LocalProblem:
        """The condensed problem."""

    def restrict(self, unknowns: np.ndarray) -> np.ndarray:
        """The entries at contact dofs."""

    def reduce(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """A particular solution away from contact, and the condensed residual."""

    def complete(self, particular: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
        """All dofs from those at contact."""


@dataclass(frozen=True, kw_only=True)
class Cycle:
    """Shape of a cycle.

    Parameters
    ----------
    shape : {"V", "W", "F", "complete"}
        How often a coarse problem is visited: once, twice, once fully and once as V, or until it is solved to the
        tolerance of the coarse solve (the paper's 'complete resolution').
    pre, post : int
        Smoothing sweeps before and after the coarse correction, not both 0.
    """

    shape: str = "V"
    pre: int = 2
    post: int = 0

    def __post_init__(self) -> None:
        checks.choice("shape", self.shape, ("V", "W", "F", "complete"))
        checks.integer("pre", self.pre)
        checks.integer("post", self.post)
        if self.pre + self.post == 0:
            raise ValueError("pre and post must not both be 0: without smoothing the cycle does not converge")


@dataclass(eq=False)
class MultigridCycle:
    """Cycles on the levels of a coarse correction; all they change they change in place.

    Parameters
    ----------
    levels : CorrectionLevels
    options : Cycle
    smoother : Smoother
    correction : Correction
    coarse : CoarseSolve
    recorder : Recorder
    initial : list of InitialContact or None
        By level, where the correction needs it.
    condensed : Condensation or None
        The coarsest matrix condensed to its contact dofs, where the coarse solve wants that.
    """

    levels: CorrectionLevels
    options: Cycle
    smoother: Smoother
    correction: Correction
    coarse: CoarseSolve
    recorder: Recorder
    initial: list[InitialContact] = field(default_factory=list)
    condensed: Condensation | None = None

    #: cycles of a 'complete' coarse solution at most
    COMPLETE_LIMIT = 60

    def cycle(self, level: int, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray, shape: str) -> None:
        """One cycle on a level >= 1: smooth, correct from the next coarser level, smooth."""
        self.smooth(level, contact, load, unknowns, self.options.pre)
        self.correct(level, contact, unknowns, self.residual(level, load, unknowns), shape)
        self.smooth(level, contact, load, unknowns, self.options.post)

    def solve(self, level: int, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray, shape: str) -> None:
        """Solve the problem of a level as well as the shape of the cycle wants it."""
        if level == 0:
            self.solve_coarsest(contact, load, unknowns)
        elif shape == "complete":
            self._complete(level, contact, load, unknowns)
        else:
            for each in {"V": "V", "W": "WW", "F": "FV"}[shape]:
                self.cycle(level, contact, load, unknowns, each)

    def correct(self, level: int, contact: NodalContact, unknowns: np.ndarray, defect: np.ndarray,
                shape: str | None = None) -> None:
        """Add the correction from the next coarser level; ``defect`` is the residual at ``unknowns``."""
        fine, coarse = self.levels[level], self.levels[level - 1]
        initial = self.initial[level - 1] if self.correction.needs_initial else None
        data = correction_contact(self.correction, fine.supports, fine.system, coarse.system, contact,
                                  unknowns, defect, initial)
        self.recorder.visit(level, "restrict")
        load = fine.restriction @ defect
        error = np.zeros(coarse.system.n_dofs)
        self.solve(level - 1, data, load, error, self.options.shape if shape is None else shape)
        unknowns += fine.prolongation @ error
        self.recorder.visit(level, "prolong")

    def smooth(self, level: int, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray, sweeps: int) -> None:
        """Sweep on a level."""
        if sweeps:
            system = self.levels[level].system
            passes = self.smoother.smooth(system, contact, load, unknowns, sweeps)
            self.recorder.count(passes, system.nonzeros)
            self.recorder.visit(level, "smooth", sweeps)

    def residual(self, level: int, load: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
        """b - A w on a level (n_dofs,), one pass."""
        system = self.levels[level].system
        self.recorder.count(1, system.nonzeros)
        return residual(system, load, unknowns)

    def solve_coarsest(self, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray) -> None:
        """Solve on the coarsest level."""
        if self.condensed is None:
            sweeps = self.coarse.solve(self.levels[0].system, contact, load, unknowns, self.recorder)
        else:
            particular, reduced = self.condensed.reduce(load)
            part = self.condensed.restrict(unknowns)
            sweeps = self.coarse.solve(self.condensed.problem.system, contact, reduced, part, self.recorder)
            unknowns[:] = self.condensed.complete(particular, part)
        self.recorder.visit(0, "solve", sweeps)

    def _complete(self, level: int, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray) -> None:
        """Cycles until the estimated error meets the tolerance of the coarse solve."""
        change = np.inf
        for _ in range(self.COMPLETE_LIMIT):
            before = unknowns.copy()
            self.cycle(level, contact, load, unknowns, "complete")
            previous, change = change, float(np.linalg.norm(unknowns - before))
            rate = change / previous if np.isfinite(previous) else np.inf
            remaining = change if self.coarse.test == "change" else change * rate / (1 - rate) if rate < 1 else np.inf
            if change == 0.0 or remaining <= self.coarse.rtol * float(np.linalg.norm(unknowns)) + self.coarse.atol:
                break
