"""Multigrid and FullMultigrid: cycles of a correction and a smoother, from a given start or from a nested one."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.coarse_solve import CoarseSolve
from adaptmg.multigrid.correction import Correction
from adaptmg.multigrid.cycle import Cycle
from adaptmg.multigrid.monotone import Monotone
from adaptmg.multigrid.nested import NestedStart
from adaptmg.problem import checks
from adaptmg.smoother.gauss_seidel import ProjectedGaussSeidel, Smoother
from adaptmg.solver.method import Method, need_levels, own
from adaptmg.solver.projected import ProjectedMultigrid
from adaptmg.solver.run import Outcome, Run
from adaptmg.solver.truncated.options import Truncated

__all__ = ["FullMultigrid", "Multigrid"]


@dataclass(frozen=True, kw_only=True)
class Multigrid:
    """Multigrid cycles from zero or from a given start.

    Parameters
    ----------
    cycle : Cycle
    smoother : ProjectedGaussSeidel or one's own
        Anything with ``smooth(system, contact, load, unknowns, sweeps) -> passes``.
    correction : Truncated, Monotone, PaperCorrection or one's own
        Anything with ``transport`` and ``needs_initial`` (:class:`~adaptmg.multigrid.correction.Correction`), or with
        cycles of its own, ``method(options, hierarchy, run)`` (:mod:`adaptmg.solver.method`).
        :class:`~adaptmg.Truncated` brings its own cycle, smoother and coarse solve and takes ``cycle``,
        ``smoother``, ``coarse``, ``coarse_matrices`` and ``stop`` at their defaults only. Default: Truncated() if these
        are at their defaults, else Monotone(); a smoother is refused unless a correction that takes it is named. Its
        linear coarse solve and coarse smoother are options of its own.
        A correction that keeps the first coarse solutions (the paper's 'initial' choices) makes them by nested
        iteration first, and starts from zero all the same; the work is counted.
    coarse : CoarseSolve
        How coarsest problems (with ``Cycle(shape="complete")`` all coarse problems) are solved.
    coarse_matrices : {"galerkin", "discretised"}
    stop : {"error", "change"}
        Test the estimated relative A-norm error (with the natural residual below 10 times the tolerance), or, as the
        paper, the change at the end of step g alone: Euclidean, relative to the solution.
    rtol : float or "discretisation"
        Tolerance of that test. "discretisation" (FullMultigrid with Truncated): a tenth of the discretisation error, as
        the nested start shows it.
    max_cycles : int
        With Truncated also for what takes over where it does not converge; ``Result.solver_name`` says what did, see
        :class:`~adaptmg.solver.truncated.fallback.Fallback`.
    """

    cycle: Cycle = field(default_factory=Cycle)
    smoother: Smoother = field(default_factory=ProjectedGaussSeidel)
    correction: Correction | Truncated | None = None
    coarse: CoarseSolve = field(default_factory=CoarseSolve)
    coarse_matrices: str = "galerkin"
    stop: str = "error"
    rtol: float = 1e-8
    max_cycles: int = 100

    #: no nested start
    start: ClassVar[NestedStart | None] = None

    def __post_init__(self) -> None:
        checks.instance("cycle", self.cycle, Cycle, "a Cycle")
        checks.offers("smoother", self.smoother, "smooth",
                      "a smoother, which offers smooth(system, contact, load, unknowns, sweeps) -> passes")
        if self.correction is None:
            if self.smoother != ProjectedGaussSeidel():
                raise ValueError(f"smoother must be left at its default where no correction is named, got "
                                 f"{checks.shown(self.smoother)}: Truncated(), the default correction, has its own; "
                                 "say correction=Monotone()")
            object.__setattr__(self, "correction", Monotone() if Truncated.not_taken(self) else Truncated())
        if isinstance(self.correction, type):
            raise TypeError(f"correction must be an instance, got {checks.described(self.correction)}")
        if own(self.correction, "method") is None:
            words = "Monotone(), Truncated(), PaperCorrection() or offer transport and needs_initial"
            checks.offers("correction", self.correction, "transport", words)
            checks.flag(f"needs_initial of correction {checks.shown(self.correction)}",
                        getattr(self.correction, "needs_initial", None))
        checks.instance("coarse", self.coarse, CoarseSolve, "a CoarseSolve")
        checks.choice("coarse_matrices", self.coarse_matrices, ("galerkin", "discretised"))
        checks.choice("stop", self.stop, ("error", "change"))
        self._check_rtol()
        checks.integer("max_cycles", self.max_cycles, 1)
        check_options = own(self.correction, "check_options")
        if check_options is not None:
            check_options(self)

    def _check_rtol(self) -> None:
        if not isinstance(self.rtol, str):
            object.__setattr__(self, "rtol", checks.tolerance("rtol", self.rtol))
        elif self.rtol != "discretisation":
            raise ValueError(f"rtol must be a number > 0 and < 1 or 'discretisation', got {checks.shown(self.rtol)}")
        elif not (isinstance(self, FullMultigrid) and getattr(self.correction, "shows_discretisation_error", False)):
            raise ValueError("rtol='discretisation' needs FullMultigrid(correction=Truncated()): the nested start "
                             "shows the discretisation error")

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level; see :class:`adaptmg.solver.run.Solver`."""
        return self._method(hierarchy, run).from_given(start)

    def _method(self, hierarchy: Hierarchy, run: Run) -> Method:
        need_levels(hierarchy)
        method = (own(self.correction, "method") or ProjectedMultigrid)(self, hierarchy, run)
        for name in ("from_given", "from_nested"):
            checks.offers(f"correction: what the method of {checks.shown(self.correction)} returns", method, name,
                          "an object that offers from_given(start) and from_nested(start)")
        return method


@dataclass(frozen=True, kw_only=True)
class FullMultigrid(Multigrid):
    """The full multigrid method: nested start, then cycles on the finest level.

    Parameters
    ----------
    start : NestedStart
        How the levels below are solved first.

    See :class:`Multigrid` for the others.
    """

    start: NestedStart = field(default_factory=NestedStart)

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.instance("start", self.start, NestedStart, "a NestedStart")

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level; see :class:`adaptmg.solver.run.Solver`."""
        if start is not None:
            raise ValueError("start: FullMultigrid makes its own start; use Multigrid to continue from a given one")
        return self._method(hierarchy, run).from_nested(self.start)
