"""SingleGrid: projected SOR on one grid, the paper's 'regular resolution'."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.correction import sliding_limit
from adaptmg.multigrid.nested import project
from adaptmg.problem import checks
from adaptmg.smoother.gauss_seidel import ProjectedGaussSeidel
from adaptmg.smoother.residuals import residual
from adaptmg.smoother.system import LocalProblem, LocalSystem, NodalContact, local_system
from adaptmg.solver.condensation import Condensed, condense
from adaptmg.solver.convergence import Convergence
from adaptmg.solver.run import Outcome, Run
from adaptmg.solver.sizes import Sizes, euclidean_norm
from adaptmg.solver.status import Status

__all__ = ["SingleGrid"]


@dataclass(frozen=True, kw_only=True)
class SingleGrid:
    """Projected Gauss-Seidel / SOR on the finest grid alone.

    Parameters
    ----------
    omega : float
        Over-relaxation, 0 < omega < 2; the best value depends on the mesh.
    condensed : bool
        Eliminate all but the contact dofs first (one factorisation, reported as time, not as work units) and sweep
        on the dense Schur complement (its sweeps are counted by its own entries over those of the sparse matrix).
    friction : {"diagonal", "fixed point"}
        Coulomb: update the sliding limit with every node solve (the paper's diagonal process), or solve Tresca
        problems with the limit held and update it between them (Problems P1 and P2 of the paper).
    friction_update : "sweep" or int
        The diagonal process updates the limit within each node solve, or holds it for so many sweeps: over-relaxed
        sweeps that cycle with the former can converge with the latter.
    stop : {"error", "change"}
        Test the estimated relative A-norm error and the natural residual, or (as the paper) the relative Euclidean
        change in one sweep alone.
    rtol : float
        Tolerance of that test.
    max_sweeps : int
    """

    omega: float = 1.0
    condensed: bool = False
    friction: str = "diagonal"
    friction_update: str | int = "sweep"
    stop: str = "error"
    rtol: float = 1e-8
    max_sweeps: int = 200_000

    def __post_init__(self) -> None:
        self.smoother()
        checks.flag("condensed", self.condensed)
        checks.choice("friction", self.friction, ("diagonal", "fixed point"))
        checks.choice("stop", self.stop, ("error", "change"))
        object.__setattr__(self, "rtol", checks.tolerance("rtol", self.rtol))
        checks.integer("max_sweeps", self.max_sweeps, 1)

    def smoother(self) -> ProjectedGaussSeidel:
        """What sweeps."""
        return ProjectedGaussSeidel(omega=self.omega, friction_update=self.friction_update)

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level; see :class:`adaptmg.solver.run.Solver`."""
        with run.phase("setup"):
            local = local_system(hierarchy.finest.discrete)
        problem, recover = local, None
        if self.condensed:
            with run.phase("factorise"):
                condensed = condense(local)
            problem, recover = condensed.problem, condensed.recover
        unknowns = np.zeros(local.system.n_dofs) if start is None else local.to_local(start)
        if self.condensed:
            unknowns = condensed.restrict(unknowns)
        project(problem, unknowns)
        reference = None if run.reference is None else local.to_local(run.reference)
        if self.condensed and reference is not None:
            # the Schur complement measures the energy of the error of the recovered solution
            reference = condensed.restrict(reference)
        sizes = _CondensedSizes(condensed) if self.condensed else Sizes(local.discrete, local.frames)
        iterate = _Iteration(self, problem, run, unknowns, reference, sizes)
        with run.phase("sweeps"):
            status = iterate.fixed_point() if self.friction == "fixed point" else iterate.sweep_until_done()
        run.visit(len(hierarchy) - 1, "smooth", iterate.sweeps)
        if recover is not None:
            with run.phase("factorise"):
                unknowns = recover(unknowns)
        return Outcome(local.to_cartesian(unknowns), status, iterate.sweeps, self.rtol, iterate.error_estimate,
                       iterate.rate)


class _CondensedSizes(Sizes):
    """Sizes of the whole solution, from the unknowns at the contact nodes alone."""

    def __init__(self, condensed: Condensed) -> None:
        full = condensed.full
        super().__init__(full.discrete, full.frames)
        self._condensed = condensed
        hidden = condensed.recover(np.zeros(condensed.problem.system.n_dofs))
        # the energy that the Schur complement does not see
        self._hidden = float(np.einsum("i,i->", hidden, full.system.matrix @ hidden))
        if self.prescribed:
            self._jump += 2 * float(np.einsum("i,i->", hidden, self._lift))
            self._lift = condensed.reduce(self._lift)[1]

    def norm(self, unknowns: np.ndarray, energy: float) -> float:
        return super().norm(unknowns, energy + self._hidden)

    def forces(self, unknowns: np.ndarray, contact: float) -> float:
        return super().forces(self._condensed.recover(unknowns) if self.prescribed else unknowns, contact)


class _Iteration:
    """The sweeps of one run: counts, tests and records them; changes ``unknowns`` in place."""

    #: sweeps between the first checks; later checks come every CHECK_SHARE of the sweeps done
    FIRST_CHECK, CHECK_SHARE = 10, 0.1
    #: Tresca problems of the fixed point at most, and how much better than rtol each is solved
    FIXED_POINT_LIMIT, INNER = 200, 0.1

    def __init__(self, options: SingleGrid, problem: LocalProblem, run: Run, unknowns: np.ndarray,
                 reference: np.ndarray | None, sizes: Sizes) -> None:
        self.options, self.problem, self.run, self.unknowns = options, problem, run, unknowns
        self.reference, self.sizes = reference, sizes
        self.system: LocalSystem = problem.system
        self.smoother = options.smoother()
        self.sweeps, self.error_estimate, self.rate = 0, np.inf, np.nan

    def sweep(self, contact: NodalContact, times: int) -> None:
        passes = self.smoother.smooth(self.system, contact, self.problem.load, self.unknowns, times)
        self.run.count(passes, self.system.nonzeros)
        self.sweeps += times

    def defect(self) -> np.ndarray:
        self.run.count(1, self.system.nonzeros)
        return residual(self.system, self.problem.load, self.unknowns)

    def sweep_until_done(self) -> Status:
        return self._by_error(self.problem.contact, self.options.rtol, self.options.stop)

    def _by_error(self, contact: NodalContact, rtol: float, stop: str, limit: int | None = None) -> Status:
        limit = self.options.max_sweeps if limit is None else limit
        problem = LocalProblem(self.system, self.problem.load, contact, self.problem.frames, self.problem.discrete)
        watch = Convergence(problem, rtol, self.run, self.reference, self.sizes)
        done, first = 0, self.sweeps
        while True:
            if stop == "change":
                before = self.unknowns.copy()
                self.sweep(contact, 1)
                size = euclidean_norm(self.unknowns)
                change = euclidean_norm(self.unknowns - before) / size if size > 0 else 0.0
                done = self.sweeps - first
                if change > rtol and done < limit and np.isfinite(change):
                    continue
                watch.check(self.unknowns, self.defect())
                self._record(watch, relative_change=change)
                if change > rtol:
                    return Status.LIMIT if np.isfinite(change) else Status.DIVERGED
                met = watch.residual <= watch.RESIDUAL_FACTOR * rtol
                return Status.CONVERGED if met else Status.STALLED
            step = max(self.FIRST_CHECK, int(self.CHECK_SHARE * (self.sweeps - first)))
            self.sweep(contact, min(step, limit - (self.sweeps - first)))
            met = watch.check(self.unknowns, self.defect())
            self.error_estimate = watch.error_estimate
            self.rate = watch.rate ** (1 / step) if np.isfinite(watch.rate) else np.nan
            self._record(watch)
            if met:
                return Status.CONVERGED
            if watch.diverged:
                return Status.DIVERGED
            if watch.stalled:
                return Status.CYCLING
            if self.sweeps - first >= limit:
                return Status.LIMIT

    def fixed_point(self) -> Status:
        """Tresca problems with the limit held; the limit is updated until it changes the solution no more."""
        options, contact = self.options, self.problem.contact
        watch = Convergence(self.problem, options.rtol, self.run, self.reference, self.sizes)
        for _ in range(self.FIXED_POINT_LIMIT):
            defect = self.defect()
            met = watch.check(self.unknowns, defect)
            self.error_estimate, self.rate = watch.error_estimate, watch.rate
            self._record(watch)
            if met:
                return Status.CONVERGED
            if watch.diverged:
                return Status.DIVERGED
            left = options.max_sweeps - self.sweeps
            if left <= 0:
                return Status.LIMIT
            limit = sliding_limit(self.system, contact, defect)
            frozen = NodalContact(contact.gap, contact.slip_reference, limit, np.zeros_like(limit))
            self._by_error(frozen, self.INNER * options.rtol, "error", left)
        return Status.LIMIT

    def _record(self, watch: Convergence, **values: float) -> None:
        self.run.record(cycle=self.sweeps, **watch.measures(), **values)
