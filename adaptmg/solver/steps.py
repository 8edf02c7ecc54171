r"""Methods that a user defines by a step: state in, state out.

A method has ``setup(hierarchy, start) -> stepper``, a stepper ``step(state) -> state``. Between two
steps nothing is remembered but the :class:`State`. :func:`adaptmg.solve` does the rest, the same
for every method: the nested start (a few steps on each level, and the interpolation of the state to
the next one), the natural residual after each step, the history, the work, the estimated error,
which decides when the certificate is asked, and the certificate, which decides whether the method
has converged. With :math:`w_k` the unknowns after step k, :math:`\delta_k = \|w_k - w_{k-1}\|_A`
and :math:`\rho` the larger of the last ratio :math:`\delta_k/\delta_{k-1}` and the mean of the last
three, that error is :math:`\delta_k\,\rho/(1-\rho)`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Protocol

import numpy as np

from adaptmg import _checks as checks
from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.cycle import project, prolonged_start
from adaptmg.smoother.system import LocalProblem, local_system
from adaptmg.solver.active_set import coarsest_solution
from adaptmg.solver.iterate import Measure, Measured, State, StopTest, iterate
from adaptmg.solver.record import Outcome, Run


class Stepper(Protocol):
    """What a method keeps for one hierarchy: matrices and transfers, no iterate."""

    def step(self, state: State) -> State:
        """Return the next state; the arrays of ``state`` must not be changed."""
        ...


class Method(Protocol):
    """A method that :func:`adaptmg.solve` takes as its solver.

    It may have ``rtol`` (default 1e-8), ``max_cycles`` (default 100) and ``start_cycles``, the
    steps on each level of the nested start (default 1; 0: from zero)."""

    def setup(self, hierarchy: Hierarchy, start: State) -> Stepper:
        """Prepare steps on the finest level of a hierarchy, which begin at ``start``. It is called
        for each level of the nested start above the coarsest, which the active set method solves,
        and at last for the whole hierarchy."""
        ...


class Stepped:
    """The solver of a user-defined method."""

    def __init__(self, method: Method) -> None:
        self.method = checks.offers("solver", method, "setup", "an object with setup() or run()")
        self.rtol = checks.tolerance("rtol of solver", getattr(method, "rtol", 1e-8))
        cycles = getattr(method, "max_cycles", 100)
        self.max_cycles = checks.integer("max_cycles of solver", cycles, 1)
        self.start_cycles = checks.integer(
            "start_cycles of solver", getattr(method, "start_cycles", 1)
        )

    def __repr__(self) -> str:
        named = type(self.method).__repr__ is not object.__repr__
        return repr(self.method) if named else f"{type(self.method).__name__}()"

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        hierarchy.finest.discrete.need_no_volumes("a user-defined method")
        nested = start is None and self.start_cycles and len(hierarchy) > 1
        if nested:
            hierarchy.need_discretised("the nested start of a user-defined method")
        with run.phase("setup"):
            last = local_system(hierarchy.finest.discrete)
        if nested:
            unknowns = self.nested_start(hierarchy, run, last)
        else:
            unknowns = np.zeros(last.system.n_dofs) if start is None else last.to_local(start)
            project(last, unknowns)
        steps = self.steps(hierarchy, run, unknowns, last, finest=True)
        stop = StopTest(
            self.rtol,
            self.max_cycles,
            lambda state, rtol: run.shortfall(last.to_cartesian(state.unknowns), rtol),
        )
        with run.phase("cycles"):
            state, status = iterate(steps, State(unknowns=unknowns), stop, run)
        solution = last.to_cartesian(state.unknowns).reshape(-1)
        return Outcome(solution, status, state.cycles, self.rtol, stop.error_estimate, stop.rate)

    def nested_start(self, hierarchy: Hierarchy, run: Run, last: LocalProblem) -> np.ndarray:
        """Return the start on the finest level, from a few steps on each level below it."""
        coarse = local_system(hierarchy[0].discrete)
        with run.phase("start"):
            solution, steps, passes = coarsest_solution(coarse.discrete, self.rtol)
            run.count(passes, coarse.system.nonzeros)
            run.visit(0, "solve", steps)
        unknowns = coarse.to_local(solution)
        for number in range(1, len(hierarchy)):
            finest = number == len(hierarchy) - 1
            fine = last if finest else local_system(hierarchy[number].discrete)
            nodal = hierarchy[number].contact_prolongation
            unknowns = prolonged_start(nodal, coarse, unknowns, fine)
            run.visit(number, "start")
            if not finest:
                steps = self.steps(hierarchy.truncated(finest=number), run, unknowns, fine)
                state = State(unknowns=unknowns)
                with run.phase("start"):
                    for _ in range(self.start_cycles):
                        state = steps.step(state)
                unknowns = state.unknowns
            coarse = fine
        run.start_work_units = run.work_units
        return unknowns

    def steps(
        self,
        hierarchy: Hierarchy,
        run: Run,
        unknowns: np.ndarray,
        local: LocalProblem,
        finest: bool = False,
    ) -> UserSteps:
        """Return the steps that the method sets up for a hierarchy."""
        with run.phase("setup"):
            made = self.method.setup(hierarchy, State(unknowns=unknowns))
        words = "an object with step(state) -> state"
        stepper = checks.offers("solver: what setup returns", made, "step", words)
        return UserSteps(stepper, len(hierarchy) - 1, local, run, finest)


class UserSteps:
    """The steps of a user-defined method on a level, checked, counted and measured."""

    def __init__(
        self, stepper: Stepper, level: int, local: LocalProblem, run: Run, finest: bool = False
    ) -> None:
        self.stepper = stepper
        self.level = level
        self.local = local
        self.run = run
        self.norms = Measure(local, run if finest else None)

    def step(self, state: State) -> State:
        new = self.stepper.step(replace(state, passes=0.0))
        checks.instance("solver: what step returns", new, State, "an am.State")
        shape = (self.local.system.n_dofs,)
        for name in ("unknowns", "residual"):
            array = getattr(new, name)
            if array is not None and array.shape != shape:
                raise ValueError(
                    f"solver: {name} of the State that step returns must have the shape {shape}, "
                    f"got {array.shape}"
                )
        self.run.count(new.passes, self.local.system.nonzeros)
        self.run.visit(self.level, "smooth")
        return replace(new, cycles=state.cycles + 1)

    def measure(self, state: State) -> Measured:
        residual = state.residual
        if residual is None:
            self.run.count(1, self.local.system.nonzeros)
            residual = self.local.residual(state.unknowns)
        return self.norms(state.cycles, state.unknowns, residual)
