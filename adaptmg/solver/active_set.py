"""ActiveSet: the semismooth Newton method, with direct or algebraic multigrid solves."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

import numpy as np

from adaptmg.hierarchy import Hierarchy
from adaptmg.problem import checks
from adaptmg.smoother.residuals import residual
from adaptmg.smoother.system import LocalProblem, local_system
from adaptmg.solver.convergence import Convergence
from adaptmg.solver.linear import Direct, LinearSolver
from adaptmg.solver.newton_state import Linearised, hold_all, linearise
from adaptmg.solver.newton_steps import CondensedSteps, SparseSteps, Steps
from adaptmg.solver.run import Outcome, Run
from adaptmg.solver.status import Status

__all__ = ["ActiveSet"]

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ActiveSet:
    """Semismooth Newton (active set) method on the finest grid; see :mod:`adaptmg.solver.newton_state`.

    Parameters
    ----------
    linear : Direct, AMG or one's own
        Solver of the linear steps.
    condensed : bool, optional
        Take the steps on the Schur complement of the contact dofs, with one factorisation in all. Default: with
        ``Direct()``.
    rtol : float
        For the relative A-norm of the last Newton step, which bounds the error of the iterate before it (the last one
        is better), and, times 10, for the relative natural residual.
    max_steps : int
        Newton steps at most.
    linear_rtol : float
        Relative residual to which an iterative linear solver solves each step.
    nested_start : bool
        Solve on the coarser levels first, each from the solution of the level below.

    Notes
    -----
    Without a start all nodes touch and, under friction, stick: a state that is not singular where the problem is well
    posed. If a later one is (a body that only contact holds and that has lost it), the iteration goes back to that
    state; if it happens again, the step is taken with weak springs at the contact nodes. If a status comes back, the
    iteration may be cycling: the step is halved, and gaps weigh less against forces.
    """

    linear: LinearSolver = field(default_factory=Direct)
    condensed: bool | None = None
    rtol: float = 1e-10
    max_steps: int = 60
    linear_rtol: float = 1e-2
    nested_start: bool = False

    def __post_init__(self) -> None:
        checks.offers("linear", self.linear, "setup", "Direct(), AMG(...) or offer setup()")
        if self.condensed is None:
            object.__setattr__(self, "condensed", isinstance(self.linear, Direct))
        for name in ("condensed", "nested_start"):
            checks.flag(name, getattr(self, name))
        if self.condensed and not isinstance(self.linear, Direct):
            raise ValueError("condensed=True factorises the interior directly: leave linear at Direct(), "
                             "or say condensed=False")
        for name in ("rtol", "linear_rtol"):
            object.__setattr__(self, name, checks.tolerance(name, getattr(self, name)))
        checks.integer("max_steps", self.max_steps, 1)

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level; see :class:`adaptmg.solver.run.Solver`."""
        if self.nested_start and start is None:
            hierarchy.need_discretised("the nested start of ActiveSet")
        first = 0 if self.nested_start and start is None else len(hierarchy) - 1
        for number in range(first, len(hierarchy)):
            level, finest = hierarchy[number], number == len(hierarchy) - 1
            if start is not None and number > first:
                start = level.prolongation @ start
                run.visit(number, "start")
            with run.phase("setup"):
                local = local_system(level.discrete)
            iteration = _Iteration(self, local, run, number, record=finest)
            if finest:
                run.start_work_units = run.work_units
            status = iteration.iterate(None if start is None else local.to_local(start))
            start = local.to_cartesian(iteration.unknowns)
        return Outcome(start, status, iteration.steps, self.rtol, iteration.error_estimate, iteration.watch.rate)


class _Iteration:
    """The Newton steps on one level."""

    #: relative stiffness of the springs that make a singular step regular
    SPRING = 1e-2
    #: repeated states after which the iteration counts as cycling
    PATIENCE = 12
    #: every so many steps the iteration is taken to repeat itself
    LONG = 15
    #: augmentation c over the diagonal of the matrix; it weighs gaps against forces where a status is decided: small
    #: values change fewer nodes at a time. It is not reduced below the second, lest rounding decide.
    FACTOR, SMALLEST_FACTOR = 0.1, 1e-4

    def __init__(self, options: ActiveSet, local: LocalProblem, run: Run, level: int, record: bool) -> None:
        self.options, self.local, self.run, self.level, self.record = options, local, run, level, record
        self.methods: Steps = (CondensedSteps(local, run) if options.condensed
                               else SparseSteps(local, options.linear, run))
        reference = local.to_local(run.reference) if record and run.reference is not None else None
        self.watch = Convergence(local, options.rtol, run, reference)
        self.unknowns = np.zeros(local.system.n_dofs)
        self.steps, self.error_estimate, self.held = 0, np.inf, False

    def iterate(self, start: np.ndarray | None) -> Status:
        """Newton steps from ``start`` (n_dofs,), local components, until converged or given up."""
        options, local = self.options, self.local
        self.unknowns = np.zeros(local.system.n_dofs) if start is None else start
        factor, repeats, last = self.FACTOR, 0, b""
        seen: set[bytes] = set()
        while True:
            defect = residual(local.system, local.load, self.unknowns)
            self.run.count(1, local.system.nonzeros)
            met = self._check(defect)
            forces = self.methods.contact_residual(defect)
            equations = self._equations(forces, factor, hold=start is None and self.steps == 0)
            self._note(equations)
            if met:
                return Status.CONVERGED
            if self.watch.diverged:
                return Status.DIVERGED
            if self.steps >= options.max_steps:
                return Status.LIMIT
            # in 3D the direction of a slip may go round while no status comes back
            repeated = (equations.key in seen and equations.key != last) or self.steps % self.LONG == self.LONG - 1
            if repeated:
                repeats += 1
                factor = min(factor, max(0.1 * factor, self.SMALLEST_FACTOR))
                _LOG.info("step %d: the contact status comes back (%d times); halving the step", self.steps, repeats)
                if repeats > self.PATIENCE:
                    return Status.CYCLING
            last = equations.key
            seen.add(last)
            self.unknowns = self.unknowns + (0.5 if repeated else 1.0) * self._step(equations, forces)
            self.steps += 1
            self.run.visit(self.level, "solve")

    def _check(self, defect: np.ndarray) -> bool:
        watch, rtol = self.watch, self.options.rtol
        if watch.check(self.unknowns, defect) and watch.error_estimate == 0.0:
            self.error_estimate = 0.0  # nothing strains
            return True
        size = watch.norm
        if self.steps:
            self.error_estimate = watch.change / size if size > 0 else (0.0 if watch.change == 0 else np.inf)
        return self.error_estimate <= rtol and watch.residual <= watch.RESIDUAL_FACTOR * rtol

    def _equations(self, forces: np.ndarray, factor: float, hold: bool) -> Linearised:
        system, contact = self.local.system, self.local.contact
        at_contact = self.unknowns.reshape(-1, system.dim)[system.nodes]
        if hold:
            self.held = True
            return hold_all(contact, at_contact, forces)
        return linearise(contact, at_contact, forces, self.methods.stiffness, factor)

    def _step(self, equations: Linearised, forces: np.ndarray) -> np.ndarray:
        try:
            return self.methods.solve(equations, self.options.linear_rtol, 0.0)
        except np.linalg.LinAlgError as error:
            _LOG.info("step %d: %s", self.steps, error)
            if self.held:
                return self.methods.solve(equations, self.options.linear_rtol, self.SPRING)
        return self._step(self._equations(forces, 0.0, hold=True), forces)

    def _note(self, equations: Linearised) -> None:
        if self.record:
            values = self.watch.measures() | {"error_estimate": self.error_estimate}
            active = int(equations.active.sum())
            slip = int((equations.active & equations.slip).sum())
            self.run.record(cycle=self.steps, active=active, slip=slip, **values)
