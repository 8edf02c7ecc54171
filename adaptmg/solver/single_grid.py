"""SingleGrid: projected SOR on one grid, the paper's 'regular resolution'."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from adaptmg import _checks as checks
from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.corrections import sliding_limit
from adaptmg.multigrid.cycle import project
from adaptmg.smoother.gauss_seidel import ProjectedGaussSeidel
from adaptmg.smoother.residuals import residual
from adaptmg.smoother.system import LocalProblem, local_system
from adaptmg.solver.examine import Sizes
from adaptmg.solver.factorisation import Condensed, condense
from adaptmg.solver.iterate import ChangeTest, Measure, Smoothing, State, StopTest, WholeSteps, iterate
from adaptmg.solver.record import Outcome, Run, Status


@dataclass(frozen=True, kw_only=True)
class SingleGrid:
    """Projected Gauss-Seidel / SOR on the finest grid alone.

    Parameters
    ----------
    omega : float
        Over-relaxation, 0 < omega < 2; the best value depends on the mesh.
    condensed : bool
        Eliminate all but the contact dofs first (one factorisation, reported as time, not as work units) and sweep
        on the dense Schur complement, whose entries are counted.
    friction : {"diagonal", "fixed point"}
        Coulomb: update the sliding limit with every node solve (the paper's diagonal process), or solve Tresca
        problems with the limit held and update it between them (Problems P1 and P2 of the paper).
    stop : {"error", "change"}
        Test the estimated relative A-norm error and the natural residual, or (as the paper) the relative Euclidean
        change in one sweep alone.
    rtol : float
        Tolerance of that test; where initial strains act, relative to u without what expands freely.
    max_sweeps : int

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.solve(grids, am.SingleGrid(omega=1.5)).status.name
    'CONVERGED'
    """

    omega: float = 1.0
    condensed: bool = False
    friction: str = "diagonal"
    stop: str = "error"
    rtol: float = 1e-8
    max_sweeps: int = 200_000

    def __post_init__(self) -> None:
        self.smoother()
        checks.flag("condensed", self.condensed)
        checks.choice("friction", self.friction, ("diagonal", "fixed point"))
        checks.choice("stop", self.stop, ("error", "change"))
        if self.friction == "fixed point" and self.stop != "error":
            raise ValueError(f"stop must be 'error' with friction='fixed point', got {self.stop!r}")
        object.__setattr__(self, "rtol", checks.tolerance("rtol", self.rtol))
        checks.integer("max_sweeps", self.max_sweeps, 1)

    def smoother(self) -> ProjectedGaussSeidel:
        return ProjectedGaussSeidel(omega=self.omega)

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        with run.phase("setup"):
            local = local_system(hierarchy.finest.discrete)
        condensed = None
        if self.condensed:
            with run.phase("factorise"):
                condensed = condense(local)
        problem = local if condensed is None else condensed.problem

        def restrict(unknowns: np.ndarray) -> np.ndarray:
            return unknowns if condensed is None else condensed.restrict(unknowns)

        def displacement(unknowns: np.ndarray) -> np.ndarray:
            return local.to_cartesian(unknowns if condensed is None else condensed.recover(unknowns))

        unknowns = restrict(np.zeros(local.system.n_dofs) if start is None else local.to_local(start))
        project(problem, unknowns)
        # the Schur complement measures the energy of the error of the recovered solution
        reference = None if run.reference is None else restrict(local.to_local(run.reference))
        sizes = Sizes(local.discrete, local.frames) if condensed is None else _CondensedSizes(condensed)
        new_measure = partial(Measure, run=run, reference=reference, sizes=sizes)
        common = self.smoother(), run, unknowns, self.max_sweeps

        def shortfall(rtol: float) -> float:
            return run.shortfall(displacement(unknowns), rtol)

        with run.phase("sweeps"):
            if self.friction == "fixed point":
                sweeps = _TrescaProblems(problem, *common, new_measure, self.rtol)
                stop = StopTest(self.rtol, self.max_sweeps, shortfall, stalled=None)
                status = iterate(sweeps, stop, run)
            elif self.stop == "change":
                stop, sweeps = ChangeTest(self.rtol, self.max_sweeps), _Sweeps(problem, *common, new_measure, batch=1)
                status = WholeSteps(sweeps, corrects=False).run(stop, run)
            else:
                stop = StopTest(self.rtol, self.max_sweeps, shortfall, stalled=Status.CYCLING)
                sweeps = _Sweeps(problem, *common, new_measure)
                status = iterate(sweeps, stop, run)
        run.visit(len(hierarchy) - 1, "smooth", sweeps.cycles)
        with run.phase("factorise" if self.condensed else "sweeps"):
            solved = displacement(unknowns)
        return Outcome(solved, status, sweeps.cycles, self.rtol, stop.error_estimate, sweeps.rate(stop))


class _CondensedSizes(Sizes):
    """Sizes of the whole solution, from the unknowns at the contact nodes alone."""

    def __init__(self, condensed: Condensed) -> None:
        full = condensed.full
        super().__init__(full.discrete, full.frames)
        self._condensed = condensed
        hidden = condensed.recover(np.zeros(condensed.problem.system.n_dofs))
        # the energy that the Schur complement does not see
        self._hidden = float(np.einsum("i,i->", hidden, full.system.matrix @ hidden))

    def norm(self, unknowns: np.ndarray, energy: float) -> float:
        return super().norm(self._whole(unknowns), energy + self._hidden)

    def forces(self, unknowns: np.ndarray, contact: float) -> float:
        return super().forces(self._whole(unknowns), contact)

    def _whole(self, unknowns: np.ndarray) -> np.ndarray:
        asked = self.prescribed or self._problem.strain_free is not None
        return self._condensed.recover(unknowns) if asked else unknowns


class _Sweeps(Smoothing):
    """Batches of sweeps, each followed by a residual; those that reach no new smallest change are cycling."""

    #: sweeps between the first checks; later checks come every CHECK_SHARE of the sweeps done
    FIRST_CHECK, CHECK_SHARE = 10, 0.1

    def __init__(self, problem: LocalProblem, smoother: ProjectedGaussSeidel, run: Run, unknowns: np.ndarray,
                 limit: int, new_measure: Callable[[LocalProblem], Measure], batch: int | None = None,
                 before: int = 0) -> None:
        super().__init__(new_measure(problem), unknowns)
        self.problem, self.smoother, self.run, self.limit = problem, smoother, run, limit
        self.cycles, self.before, self.batch, self._batch = before, before, 1, batch

    def smooth(self) -> int:
        system, done = self.problem.system, self.cycles - self.before
        self.batch = self._batch or max(self.FIRST_CHECK, int(self.CHECK_SHARE * done))
        times = min(self.batch, self.limit - done)
        passes = self.smoother.smooth(system, self.problem.contact, self.problem.load, self.unknowns, times)
        self.run.count(passes, system.nonzeros)
        return times

    def residual(self) -> np.ndarray:
        self.run.count(1, self.problem.system.nonzeros)
        return residual(self.problem.system, self.problem.load, self.unknowns)

    def correct(self, r: np.ndarray) -> int:
        return 0

    def rate(self, stop: StopTest) -> float:
        """Convergence rate of a sweep."""
        return stop.rate ** (1 / self.batch) if np.isfinite(stop.rate) else np.nan


class _TrescaProblems(_Sweeps):
    """The fixed point: Tresca problems with the limit held, which is updated until the solution no longer changes."""

    #: Tresca problems at most, and how much better than rtol each is solved
    MOST, INNER = 200, 0.1

    def __init__(self, problem: LocalProblem, smoother: ProjectedGaussSeidel, run: Run, unknowns: np.ndarray,
                 limit: int, new_measure: Callable[[LocalProblem], Measure], rtol: float) -> None:
        super().__init__(problem, smoother, run, unknowns, limit, new_measure)
        self._new_measure, self._rtol, self._solved = new_measure, rtol, 0

    def smooth(self) -> int:
        return 0

    def step(self) -> State | Status:
        return Status.LIMIT if self._solved == self.MOST else super().step()

    def correct(self, r: np.ndarray) -> int:
        """Hold the present limit, and solve."""
        contact, left = self.problem.contact, self.limit - self.cycles
        limit = sliding_limit(self.problem.system, contact, r)
        held = replace(self.problem, contact=replace(contact, limit=limit, friction=np.zeros_like(limit), held=None))
        sweeps = _Sweeps(held, self.smoother, self.run, self.unknowns, left, self._new_measure, before=self.cycles)
        iterate(sweeps, StopTest(self.INNER * self._rtol, self.cycles + left, stalled=Status.CYCLING), self.run)
        self._solved += 1
        return sweeps.cycles - self.cycles

    def rate(self, stop: StopTest) -> float:
        """Convergence rate of the fixed point."""
        return stop.rate
