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

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from adaptmg import _checks as checks
from adaptmg.grids import Grids
from adaptmg.multigrid.cycle import project, prolonged_start
from adaptmg.smoother.system import LocalProblem, local_system
from adaptmg.solver.active_set import coarsest_solution
from adaptmg.solver.iterate import Measure, State, StopTest, iterate, nested_start
from adaptmg.solver.record import Outcome, Run, Status


class Stepper(Protocol):
    """The set-up of a method for one hierarchy (matrices, transfers), without an iterate."""

    def step(self, state: State) -> State:
        """Return the next state; the arrays of ``state`` must not be changed."""
        ...


class Method(Protocol):
    """A method that :func:`adaptmg.solve` takes as its solver.

    It may have ``rtol`` (default 1e-8), ``max_cycles`` (default 100) and ``start_cycles``, the
    steps on each level of the nested start (default 1; 0: from zero)."""

    # Any: the method of a user may name am.Hierarchy, which adds constructors to Grids
    def setup(self, hierarchy: Any, start: State) -> Stepper:
        """Prepare steps on the finest level of a hierarchy, which begin at ``start``. It is called
        for each level of the nested start above the coarsest, which the active set method solves,
        and at last for the whole hierarchy."""
        ...


@dataclass(frozen=True, eq=False)
class Cycles:
    """The cycles of a method of the package, whose work a run counts. The state of the method is
    the memory of a state; its unknowns are smoothed."""

    run: Run
    cycle: Callable[[State], State]  # of a start it only smooths
    n_dofs: int

    def step(self, state: State) -> State:
        """Return the state after a cycle; unknowns that do not come from the last cycle are smoothed
        first."""
        checks.instance("state", state, State, "a State")
        if len(state.unknowns) != self.n_dofs:
            raise ValueError(
                f"state.unknowns must be of the finest level, which has {self.n_dofs} dofs, got "
                f"{len(state.unknowns)}"
            )
        before = self.run.work_units
        smoothed = state.memory
        if smoothed is None or not np.array_equal(smoothed.unknowns, state.unknowns):
            smoothed = self.cycle(State(unknowns=state.unknowns))
        new = self.cycle(smoothed)
        return State(
            unknowns=new.unknowns,
            passes=self.run.work_units - before,
            memory=new,
            residual=new.residual,
            cycles=state.cycles + 1,
        )


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

    def run(self, hierarchy: Grids, run: Run, start: np.ndarray | None) -> Outcome:
        """Take steps on the finest level, from ``start`` (n_dofs,) or by default a nested start, until the
        test ends them."""
        hierarchy.finest.discrete.need_no_volumes("a user-defined method")
        hierarchy.finest.discrete.need_given_friction(
            "a user-defined method", "am.FullMultigrid() or am.ActiveSet()"
        )
        levels = LocalLevels(hierarchy, run)
        if start is None and self.start_cycles and len(hierarchy) > 1:
            hierarchy.need_discretised("the nested start of a user-defined method")
            unknowns = levels.nested(
                partial(self.coarsest, levels), partial(self.start_steps, levels)
            )
        else:
            unknowns = levels.begin(start)
        finest = len(hierarchy) - 1
        step = self.step_on(levels, finest, unknowns)
        measure = Measure(levels.finest, run).of
        # levels.shortfall asks the certificate
        stop = StopTest(self.rtol, self.max_cycles, shortfall=levels.shortfall)
        with run.phase("cycles"):
            state, status = iterate(step, measure, State(unknowns=unknowns), stop, run)
        return levels.outcome(state, status, stop, self.rtol)

    def coarsest(self, levels: LocalLevels) -> np.ndarray:
        """Return the solution (n_dofs,) on the coarsest level, in contact frames, by the active set
        method."""
        local = levels.problem(0)
        solution, steps, passes = coarsest_solution(local.discrete, self.rtol)
        levels.run.count(passes, local.system.nonzeros)
        levels.run.visit(0, "solve", steps)
        return local.to_local(solution)

    def start_steps(self, levels: LocalLevels, number: int, unknowns: np.ndarray) -> np.ndarray:
        """Return the unknowns (n_dofs,) of a level of the nested start after a few steps."""
        step = self.step_on(levels, number, unknowns)
        state = State(unknowns=unknowns)
        for _ in range(self.start_cycles):
            state = step(state)
        return state.unknowns

    def step_on(
        self, levels: LocalLevels, number: int, unknowns: np.ndarray
    ) -> Callable[[State], State]:
        """Return the step that the method sets up for the levels up to ``number`` and a start there,
        ``unknowns`` (n_dofs,), checked and counted."""
        hierarchy = levels.hierarchy
        run = levels.run
        finest = number == len(hierarchy) - 1
        with run.phase("setup"):
            below = hierarchy if finest else hierarchy.truncated(finest=number)
            returned = self.method.setup(below, State(unknowns=unknowns))
        words = "an object with step(state) -> state"
        stepper = checks.offers("solver: what setup returns", returned, "step", words)
        system = levels.problem(number).system

        def step(state: State) -> State:
            """Return the next state, checked, and count its work."""
            # without the passes that are counted: a step may return its state with other unknowns only
            new = stepper.step(replace(state, passes=0.0))
            checks.instance("solver: what step returns", new, State, "an am.State")
            for name in ("unknowns", "residual"):
                array = getattr(new, name)
                if array is not None and array.shape != (system.n_dofs,):
                    raise ValueError(
                        f"solver: {name} of the State that step returns must have the shape "
                        f"({system.n_dofs},), got {array.shape}"
                    )
            run.count(new.passes, system.nonzeros)
            run.visit(number, "smooth")
            return replace(new, cycles=state.cycles + 1)

        return step


class LocalLevels:
    """The levels of a run in contact frames, each problem made when it is asked for."""

    def __init__(self, hierarchy: Grids, run: Run) -> None:
        self.hierarchy = hierarchy
        self.run = run
        self._problems: dict[int, LocalProblem] = {}

    def problem(self, number: int) -> LocalProblem:
        """Return the problem of a level."""
        if number not in self._problems:
            with self.run.phase("setup"):
                self._problems[number] = local_system(self.hierarchy[number].discrete)
        return self._problems[number]

    @property
    def finest(self) -> LocalProblem:
        return self.problem(len(self.hierarchy) - 1)

    def begin(self, start: np.ndarray | None) -> np.ndarray:
        """Return the admissible unknowns of a given start (n_dofs,), or of zero."""
        local = self.finest
        unknowns = np.zeros(local.system.n_dofs) if start is None else local.to_local(start)
        project(local, unknowns)
        return unknowns

    def nested(
        self, coarsest: Callable[[], np.ndarray], cycled: Callable[[int, np.ndarray], np.ndarray]
    ) -> np.ndarray:
        """Return the unknowns (n_dofs,) of a nested start from the functions ``coarsest`` and ``cycled``; see
        :func:`nested_start`."""

        def prolonged(number: int, unknowns: np.ndarray) -> np.ndarray:
            nodal = self.hierarchy[number].contact_prolongation
            return prolonged_start(nodal, self.problem(number - 1), unknowns, self.problem(number))

        return nested_start(self.run, len(self.hierarchy), coarsest, prolonged, cycled)

    def shortfall(self, state: State, rtol: float) -> float:
        """Return the factor by which the certificate finds the error of a state above ``rtol``, as
        :meth:`~adaptmg.solver.record.Run.shortfall`."""
        return self.run.shortfall(self.finest.to_cartesian(state.unknowns), rtol)

    def outcome(self, state: State, status: Status, stop: StopTest, rtol: float) -> Outcome:
        """Return the outcome of a method that ended in a state with a status."""
        solution = self.finest.to_cartesian(state.unknowns).reshape(-1)
        return Outcome(solution, status, state.cycles, rtol, stop.error_estimate, stop.rate)
