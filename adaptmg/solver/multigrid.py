r"""Multigrid and FullMultigrid: cycles of a correction and a smoother, from a given start or from a nested one.

Truncated: the truncated nonsmooth Newton multigrid as a correction, its options and what it is run by.

WarmMultigrid: the truncated multigrid from a start that is nearly solved, contact status and all.

A solution carried to a finer mesh has an algebraic error of some tenths of the discretisation error, and most contact
nodes are in their state. So no cycles are spent on making the status safe, and one cycle may do: the energy
:math:`\eta_1` of its correction and a rate :math:`\rho` known from the mesh before estimate the error that it leaves,
:math:`2\,\rho\,\eta_1`, as :mod:`adaptmg.solver.truncated_iteration` does from the second cycle on with the rate that
it measures. The certificate, which knows nothing of rates, has the last word.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from adaptmg import _checks as checks
from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.corrections import Correction, Monotone
from adaptmg.multigrid.cycle import CoarseSolve, Cycle, NestedStart
from adaptmg.multigrid.linear_cycle import LinearSmoother, LinearSolve
from adaptmg.multigrid.split_matrix import SplitMatrix
from adaptmg.smoother.gauss_seidel import ProjectedGaussSeidel, Smoother
from adaptmg.solver.load_steps import TruncatedSteps
from adaptmg.solver.projected import Method, MultigridOptions, ProjectedMultigrid, need_levels, own
from adaptmg.solver.record import Outcome, Run
from adaptmg.solver.truncated import TruncatedMultigrid

__all__ = ["FullMultigrid", "Multigrid", "Truncated", "WarmMultigrid"]

@dataclass(frozen=True, kw_only=True)
class Multigrid:
    """Multigrid cycles from zero or from a given start.

    Parameters
    ----------
    cycle : Cycle
    smoother : ProjectedGaussSeidel or one's own
        Anything with ``smooth(system, contact, load, unknowns, sweeps) -> passes``.
    correction : Truncated, Monotone, PaperCorrection or one's own
        Anything with ``transport`` and ``needs_initial`` (:class:`~adaptmg.multigrid.corrections.Correction`), or with
        cycles of its own, ``method(options, hierarchy, run)`` (:mod:`adaptmg.solver.projected`).
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
        With Truncated also for what takes over where it does not converge; ``Result.fallback`` says what did, see
        :class:`~adaptmg.solver.truncated.Fallback`.
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
        """Solve on the finest level; see :class:`adaptmg.solver.record.Solver`."""
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
        """Solve on the finest level; see :class:`adaptmg.solver.record.Solver`."""
        if start is not None:
            raise ValueError("start: FullMultigrid makes its own start; use Multigrid to continue from a given one")
        return self._method(hierarchy, run).from_nested(self.start)


@dataclass(frozen=True, kw_only=True)
class Truncated:
    """Truncated nonsmooth Newton multigrid: the fast method.

    Parameters
    ----------
    recombine : int
        Past iterates recombined with the present one, 0 to 2.
    coarse_sweeps : int, optional
        Smoothing before and after the coarse correction on the coarser levels, 1 or 2; there is one symmetric sweep on
        the finest. Default: 1 on levels whose matrix has more than 1.25 times the entries a row of the finest one
        (Galerkin products of independent meshes, which converge as well with less), 2 on the others.
    safe_cycles : int
        Cycles with g frozen, symmetric truncation and a line search at most, taken while the contact status of a cold
        start changes; twice as many whenever the residual stops falling. They make cold starts safe.
    interface_sweeps : int
        Where bodies touch each other: sweeps over the nodes within two elements of the interface after each smoothing
        of the finest level, backward and forward in turn. On large meshes they cost a few per cent of a cycle, on small
        graded ones a tenth; where a joint is soft they bring the rate from .6 or .7 to .4 (``studies/dovetail.py``).
    coarse_solve : LinearSolve, optional
        One's own solver of the coarsest linear problems, anything with ``setup(matrix) -> object with solve(rhs)``; see
        :class:`~adaptmg.multigrid.linear_cycle.LinearSolve`. Default: LU factors.
    coarse_smoother : LinearSmoother, optional
        One's own smoother of the linear problems between the coarsest level and the finest, anything with
        ``setup(matrix) -> object with smooth(rhs, x) -> passes``. Default: Gauss-Seidel sweeps. The smoother of the
        finest level, projected sweeps that leave the residual behind, is part of the method.
    """

    #: how much denser than the finest matrix a coarse one is that is smoothed once only
    DENSE: ClassVar[float] = 1.25
    #: rtol="discretisation" can be had
    shows_discretisation_error: ClassVar[bool] = True

    recombine: int = 2
    coarse_sweeps: int | None = None
    safe_cycles: int = 20
    interface_sweeps: int = 2
    coarse_solve: LinearSolve | None = None
    coarse_smoother: LinearSmoother | None = None

    def __post_init__(self) -> None:
        if checks.integer("recombine", self.recombine) > 2:
            raise ValueError(f"recombine must be 0, 1 or 2, got {self.recombine!r}")
        if self.coarse_sweeps is not None and checks.integer("coarse_sweeps", self.coarse_sweeps, 1) > 2:
            raise ValueError(f"coarse_sweeps must be 1 or 2, got {self.coarse_sweeps!r}")
        checks.integer("safe_cycles", self.safe_cycles)
        checks.integer("interface_sweeps", self.interface_sweeps)
        if self.coarse_solve is not None:
            checks.offers("coarse_solve", self.coarse_solve, "setup",
                          "a linear solver, which offers setup(matrix) -> object with solve(rhs) -> solution")
        if self.coarse_smoother is not None:
            checks.offers("coarse_smoother", self.coarse_smoother, "setup",
                          "a linear smoother, which offers setup(matrix) -> object with smooth(rhs, x) -> passes")

    def sweeps(self, levels: Sequence[SplitMatrix]) -> list[int]:
        """Sweeps on each of the levels, coarsest first."""
        if self.coarse_sweeps is not None:
            return [self.coarse_sweeps] * len(levels)
        rows = [level.nonzeros / level.n_nodes for level in levels]
        return [1 if row > self.DENSE * rows[-1] else 2 for row in rows]

    @staticmethod
    def not_taken(options: MultigridOptions) -> str:
        """Name of an option that is not at its default though Truncated has its own; empty if there is none."""
        defaults = {"cycle": Cycle(), "smoother": ProjectedGaussSeidel(), "coarse": CoarseSolve(),
                    "coarse_matrices": "galerkin", "stop": "error"}
        return next((name for name, default in defaults.items() if getattr(options, name) != default), "")

    def check_options(self, options: MultigridOptions) -> None:
        """Refuse what it does not take; see :mod:`adaptmg.solver.projected`."""
        name = self.not_taken(options)
        if name:
            raise ValueError(f"{name}: Truncated() has its own; leave it at its default, or take correction=Monotone()")

    def method(self, options: MultigridOptions, hierarchy: Hierarchy, run: Run) -> Method:
        """What runs it; see :mod:`adaptmg.solver.projected`."""
        return TruncatedMultigrid(options, hierarchy, run)

    def load_steps(self, options: MultigridOptions) -> TruncatedSteps:
        """What takes it through load steps, set up once; see :mod:`adaptmg.solver.projected`."""
        return TruncatedSteps(options)


@dataclass(frozen=True, kw_only=True)
class WarmMultigrid(Multigrid):
    """Truncated multigrid from a given start whose contact status is believed; it may stop after one cycle."""

    first_rate: float = 0.5  # what is taken for the rate of the first cycle, > 0 and < 1

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < checks.number("first_rate", self.first_rate) < 1:
            raise ValueError(f"first_rate must be > 0 and < 1, got {self.first_rate!r}")

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level; see :class:`adaptmg.solver.record.Solver`."""
        if start is None:
            raise ValueError("start: WarmMultigrid goes on from a displacement; without one use FullMultigrid")
        method = self._method(hierarchy, run)
        checks.offers("correction", method, "from_warm", "Truncated(), whose cycles can go on from a warm start")
        return method.from_warm(start, self.first_rate)
