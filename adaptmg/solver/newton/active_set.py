"""ActiveSet: the semismooth Newton method, with direct or algebraic multigrid solves."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

import numpy as np

from adaptmg.hierarchy import Hierarchy
from adaptmg.problem import checks
from adaptmg.smoother.residuals import natural_residual, residual
from adaptmg.smoother.system import LocalProblem, local_system
from adaptmg.solver.iterate import iterate
from adaptmg.solver.linear import Direct, LinearSolver
from adaptmg.solver.newton.linearised import Linearised, hold_all, linearise
from adaptmg.solver.newton.steps import CondensedSteps, SparseSteps, Steps
from adaptmg.solver.result.status import Status
from adaptmg.solver.run import Outcome, Run
from adaptmg.solver.stop_test import IterateTest

__all__ = ["ActiveSet"]

_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, kw_only=True)
class ActiveSet:
    """Semismooth Newton (active set) method on the finest grid; see :mod:`adaptmg.solver.newton.linearised`.

    Parameters
    ----------
    linear : Direct, AMG or one's own
        Solver of the linear steps.
    condensed : bool, optional
        Take the steps on the Schur complement of the contact dofs, with one factorisation in all. Default: with
        ``Direct()``.
    rtol : float
        For the relative A-norm of the last Newton step (ten times that while the contact status changes), which bounds
        the error of the iterate before it, and, times 10, for the relative natural residual.
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
    state. If a status comes back, the iteration may be cycling: the step is halved, and gaps weigh less against forces.
    If either happens again, springs tie the contact nodes to the last iterate that is trusted (a proximal point
    method): each problem with springs is solved until its residual is a tenth of that of its centre, which then moves
    to its solution. The springs become weaker with every problem that is solved and stiffer with every other one, and
    nothing is left of them at the end.
    """

    linear: LinearSolver = field(default_factory=Direct)
    condensed: bool | None = None
    rtol: float = 1e-10
    max_steps: int = 200
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
            steps = _NewtonSteps(self, local, run, number, None if start is None else local.to_local(start))
            stop = _NewtonTest(local, self.rtol, self.max_steps, run if finest else None,
                               displacement=local.to_cartesian if finest else None)
            if finest:
                run.start_work_units = run.work_units
            status = iterate(steps, stop, run if finest else None)
            start = local.to_cartesian(steps.unknowns)
        return Outcome(start, status, steps.cycles, self.rtol, stop.error_estimate, stop.rate)


class _NewtonTest(IterateTest):
    """The last step bounds the error of the iterate before it; every step refines, so that rounding excuses none.

    As long as the contact status changes, nodes may follow one another: many such steps may be left.

    Attributes
    ----------
    settled : bool
        Whether the status is that of the step before.
    """

    stalled, settled = False, False
    #: times a step that the error may be as long as the status changes
    UNSETTLED = 10.0

    def take_residual(self, residual: float, forces: float, floor: float, idle: bool = False) -> None:
        """See :class:`~adaptmg.solver.stop_test.StopTest`."""
        super().take_residual(residual, forces, floor, idle)
        if self.met and self.error_estimate == 0.0:
            return  # nothing strains
        self.error_estimate = np.inf
        if self.changes:
            change = self.change if self.size > 0 else (0.0 if self.changes[-1] == 0 else np.inf)
            self.error_estimate = self._caution * change * (1.0 if self.settled else self.UNSETTLED)
        self.met = self._small_enough()


class _NewtonSteps:
    """The Newton steps on one level; see :class:`~adaptmg.solver.iterate.Iteration`.

    Parameters
    ----------
    options : ActiveSet
    local : LocalProblem
    run : Run
    level : int
    start : (n_dofs,) array or None
        Local components.
    """

    #: springs, relative to the diagonal: the first ones, the stiffest, those that count as none; the factors by which
    #: they become weaker and stiffer; to what a problem with them reduces the residual, and in how many steps
    SPRING, STIFFEST, NONE, WEAKER, STIFFER, REDUCED, TRIES = 1e-2, 1e2, 1e-6, 0.5, 10.0, 0.1, 5
    #: repeated states before springs are set
    PATIENCE = 3
    #: every so many steps the iteration is taken to repeat itself
    LONG = 15
    #: augmentation c over the diagonal of the matrix; it weighs gaps against forces where a status is decided: small
    #: values change fewer nodes at a time. It is not reduced below the second, lest rounding decide.
    FACTOR, SMALLEST_FACTOR = 0.1, 1e-4

    def __init__(self, options: ActiveSet, local: LocalProblem, run: Run, level: int,
                 start: np.ndarray | None) -> None:
        self.options, self.local, self.run, self.level = options, local, run, level
        self.methods: Steps = (CondensedSteps(local, run) if options.condensed
                               else SparseSteps(local, options.linear, run))
        self.unknowns = np.zeros(local.system.n_dofs) if start is None else start
        self.cycles, self.held, self._hold_first = 0, False, start is None
        self._factor, self._repeats, self._last = self.FACTOR, 0, b""
        self._seen: set[bytes] = set()
        self._forces, self._equations = np.empty(0), None
        # springs, what they tie the contact nodes to, its residual, and the steps since
        self._spring, self._stiffness, self._centre, self._size, self._tries = 0.0, self.SPRING, None, np.inf, 0

    def start(self) -> None:
        """Nothing: the start is measured."""

    def measure(self, stop: IterateTest) -> None:
        """Residual, and the contact status that it decides."""
        defect = residual(self.local.system, self.local.load, self.unknowns)
        self.run.count(1, self.local.system.nonzeros)
        tied = defect if self._centre is None else self._tied(defect)
        self._decide(tied, hold=self._hold_first and self.cycles == 0)
        # with springs a short step does not bound the error
        stop.settled = not self._spring and self._equations.key == self._last
        stop.take(self.unknowns, defect)

    def _decide(self, defect: np.ndarray, hold: bool = False) -> None:
        self._forces = self.methods.contact_residual(defect)
        self._equations = self._linearised(self._factor, hold)

    def _tied(self, defect: np.ndarray) -> np.ndarray:
        """The residual with springs; where it is small enough their centre moves to the present iterate."""
        tied, system = defect.copy(), self.local.system
        pull = (self.unknowns - self._centre).reshape(-1, system.dim)[system.nodes]
        tied.reshape(-1, system.dim)[system.nodes] -= self._spring * self.methods.stiffness * pull
        if not self._tries or self._natural(tied) > self.REDUCED * self._size:
            return tied
        self._stiffness *= self.WEAKER
        self._tie(defect, self._stiffness if self._stiffness > self.NONE else 0.0)
        return defect

    def _natural(self, defect: np.ndarray) -> float:
        vector = natural_residual(self.local.system, self.local.contact, self.local.load, self.unknowns, defect)
        return float(np.linalg.norm(vector))

    def _tie(self, defect: np.ndarray, spring: float) -> None:
        """Springs to the present iterate with the residual ``defect``."""
        self._centre, self._size = self.unknowns, self._natural(defect)
        self._spring, self._tries, self._factor, self._last = spring, 0, self.FACTOR, b""
        self._seen.clear()

    def _stiffen(self) -> None:
        """Springs; where there are some already, stiffer ones, and back to their centre."""
        if self._centre is not None:
            self.unknowns = self._centre
            # without any, those that were the last
            self._stiffness = max(self._stiffness, self.NONE) * (self.STIFFER if self._spring else 1.0)
        _LOG.info("step %d: springs of %.1e at contact", self.cycles, self._stiffness)
        defect = residual(self.local.system, self.local.load, self.unknowns)
        self.run.count(1, self.local.system.nonzeros)
        self._tie(defect, self._stiffness)
        self._decide(defect)

    def row(self, stop: IterateTest) -> dict[str, float]:
        """See :class:`~adaptmg.solver.iterate.Iteration`."""
        active = self._equations.active
        return {"active": int(active.sum()), "slip": int((active & self._equations.slip).sum()), **stop.measures()}

    def step(self, stop: IterateTest) -> Status | None:
        """A step, shorter where a status comes back; with springs where it does so again."""
        key = self._equations.key
        # in 3D the direction of a slip may go round while no status comes back
        repeated = (key in self._seen and key != self._last) or self.cycles % self.LONG == self.LONG - 1
        if self._centre is not None:
            if repeated or self._tries >= self.TRIES:
                self._stiffen()
                repeated = False
        elif repeated:
            self._repeats += 1
            self._factor = min(self._factor, max(0.1 * self._factor, self.SMALLEST_FACTOR))
            _LOG.info("step %d: the contact status comes back (%d times); halving the step", self.cycles, self._repeats)
            if self._repeats > self.PATIENCE:
                self._stiffen()
                repeated = False
        if self._stiffness > self.STIFFEST:
            return Status.CYCLING
        change = self._solved()
        self._last = self._equations.key
        self._seen.add(self._last)
        self.unknowns = self.unknowns + (0.5 if repeated else 1.0) * change
        self.cycles += 1
        self._tries += 1
        self.run.visit(self.level, "solve")
        return None

    def _linearised(self, factor: float, hold: bool) -> Linearised:
        system, contact = self.local.system, self.local.contact
        at_contact = self.unknowns.reshape(-1, system.dim)[system.nodes]
        if hold:
            self.held = True
            return hold_all(contact, at_contact, self._forces)
        return linearise(contact, at_contact, self._forces, self.methods.stiffness, factor)

    def _solved(self) -> np.ndarray:
        """The change of a step; where it is singular, from the safe state, then with springs."""
        while True:
            try:
                return self.methods.solve(self._equations, self.options.linear_rtol, self._spring)
            except np.linalg.LinAlgError as error:
                _LOG.info("step %d: %s", self.cycles, error)
                if self._stiffness > self.STIFFEST:
                    raise
            if self.held:
                self._stiffen()
            else:
                self._equations = self._linearised(0.0, hold=True)
