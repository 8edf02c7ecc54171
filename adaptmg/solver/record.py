"""Run: what a solver writes while it runs. Outcome: what it returns. Status: how it ended. Solver:
what it offers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg._numba import clock, compiling_seconds
from adaptmg.solver.certificate import Certificate
from adaptmg.solver.examine import Examined


class Status(Enum):
    """The end of a solve; the value is advice.

    CONVERGED: the certificate finds an energy error of at most rtol, relative, and the natural
    residual is at most 10 rtol; or both are rounding: a tolerance below what rounding leaves is
    widened to that, with a warning (``Result.rtol``). The certificate's estimate was .25 to 2 times
    the true error in 98.5 % of 1396 random runs; it may be .2 times where Poisson's ratio is nearly
    .5, or one body is far stiffer than the next. A user-defined solver is trusted up to 3 rtol, and
    one that stops by its change (``stop="change"``) up to 10.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> result.status is am.Status.CONVERGED
    True
    """

    CONVERGED = "converged to the tolerance asked for"
    LIMIT = (
        "the limit on cycles, sweeps or steps was reached before the tolerance: raise it if the error "
        "estimate still falls, else take am.FullMultigrid() or am.ActiveSet()"
    )
    STALLED = (
        "the iterates no longer improve, or the certificate contradicts the last one, short of the "
        "tolerance: take am.ActiveSet(), or correction=am.Monotone() (the frozen choices of the paper's correction "
        "are known to stall)"
    )
    CYCLING = (
        "the contact status repeats without converging: take am.Multigrid(), am.SingleGrid() with omega <= 1, or "
        "less friction"
    )
    ROUNDING = (
        "the residual is rounding: in double precision no smaller error than the estimated one can be reached; "
        "take an rtol above it"
    )
    TRANSFERRED = (
        "carried over from another mesh by am.transfer_state, and not in equilibrium: the first load step of "
        "am.solve_path(grids, path, start=result) restores that"
    )
    DIVERGED = "the iterates grow without bound: take am.ActiveSet(), correction=am.Monotone(), or omega <= 1"

    @property
    def ok(self) -> bool:
        return self is Status.CONVERGED


@dataclass
class Run:
    """A record that a solver writes while it runs."""

    unit: int  # stored nonzeros of the finest matrix: one work unit
    callback: Callable[[dict[str, float]], None] | None = None
    reference: np.ndarray | None = None  # (n_nodes, dim)
    work_units: float = 0.0  # passes over matrices, weighted by nonzeros over unit
    history: list[dict[str, float]] = field(default_factory=list)
    timings: dict[str, float] = field(
        default_factory=dict
    )  # seconds by phase, and those of compiling
    path: list[tuple[int, str, int]] = field(default_factory=list)  # (level, action, times)
    started: float = field(default_factory=clock)
    start_work_units: float = 0.0  # the part of work_units of the nested start
    untimed_seconds: float = 0.0  # spent on comparison with the reference
    first_cycle: int = 0  # cycles done by another method before the one that records now
    fallback: str = ""  # the method that took over, and from which cycle; empty if none did
    examiner: Callable[[np.ndarray, float], Examined] | None = None
    _nested_seconds: float = 0.0  # of the phases inside the present one
    # seconds of compiling that ``timings`` has already, or that passed before
    _compiled: float = field(default_factory=compiling_seconds)

    def count(self, passes: float, nonzeros: int) -> None:
        """Count ``passes`` over a matrix of ``nonzeros`` stored entries, checked here for
        user-defined parts."""
        # hundreds of counts a solve are floats that need no more than this
        if type(passes) is not float or not 0.0 <= passes < np.inf:
            words = "the passes over the matrix that a smoother or linear solver returns"
            passes = checks.nonnegative(words, passes)
        self.work_units += passes * nonzeros / self.unit

    def visit(self, level: int, action: str, times: int = 1) -> None:
        """Note an action on a level (0 = coarsest)."""
        self.path.append((level, action, times))

    def record(self, *, cycle: int, **values: float) -> None:
        """Append a row to the history, and pass it to the callback."""
        seconds = clock() - self.started - self.untimed_seconds
        row = {
            "cycle": self.first_cycle + cycle,
            "work_units": self.work_units,
            "seconds": seconds,
            **values,
        }
        self.history.append(row)
        if self.callback is not None:
            self.callback(row)

    @contextmanager
    def untimed(self) -> Iterator[None]:
        """Exclude a block (a comparison with the reference) from the seconds of the history and of its
        phase."""
        begin = clock()
        try:
            yield
        finally:
            self.untimed_seconds += clock() - begin

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """Time a block as a phase: 'statics', 'setup', 'factorise', 'start', 'cycles', ... The seconds
        of phases inside it are not counted twice."""
        begin = clock()
        untimed = self.untimed_seconds
        outside = self._nested_seconds
        self._nested_seconds = 0.0
        try:
            yield
        finally:
            compiled = compiling_seconds()
            if compiled > self._compiled:
                before = self.timings.get("compiling", 0.0)
                self.timings["compiling"] = before + compiled - self._compiled
                self._compiled = compiled
            seconds = clock() - begin - (self.untimed_seconds - untimed)
            self.timings[name] = self.timings.get(name, 0.0) + seconds - self._nested_seconds
            self._nested_seconds = outside + seconds

    def shortfall(self, solution: np.ndarray, rtol: float) -> float:
        """Return the factor by which the certificate finds the error of a solution (n_unknowns,) above
        ``rtol``; 1 if another condition fails, 0 if it passes or only rounding is left. Also 0 where
        nothing judges: without an examiner, and for rtol = 0, where another test ends the solve."""
        if self.examiner is None or not rtol > 0:
            return 0.0
        with self.phase("certificate"):
            examined = self.examiner(solution.reshape(-1), rtol)
        checked = cast("Certificate", examined.checked)  # the examiner of a run makes certificates
        if checked.energy_error > max(rtol, checked.energy_rounding):
            # at most the error of u = 0: the factor multiplies later estimates, which must stay finite
            return min(checked.energy_error, 1.0) / rtol
        return 1.0 if checked.contradictions(rtol) else 0.0


@dataclass
class Outcome:
    """The values that a solver returns."""

    # (n_unknowns,): displacement on the finest level, between bodies relative, m; then the
    # pressures of volumes, Pa, where the problem has any
    solution: np.ndarray
    status: Status
    cycles: int  # cycles, sweeps or Newton steps on the finest level
    rtol: float  # the tolerance asked for
    error_estimate: float = np.nan  # estimated relative A-norm error; NaN if the solver has none
    # asymptotic convergence rate (geometric mean of the last cycles); NaN if unknown
    rate: float = np.nan
    left: int = 0  # cycles that another method may take, where this one fails; else 0
    better: bool = False  # whether the other method begins at this solution, not at zero


class Solver(Protocol):
    """The protocol of a solver in :func:`adaptmg.solve`.

    It may have ``reads_coarse_starts``: False where load steps after the first one need no displacements
    of coarse levels, which are then not found (default True)."""

    # Any: the solver of a user may name am.Hierarchy, which adds constructors to Grids
    def run(self, hierarchy: Any, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level of ``hierarchy`` from ``start`` (n_unknowns,), see
        :class:`Outcome`, or zero, writing to ``run``."""
        ...
