"""PathWalk: what is posed at each step of a load path, what is known of the steps before, and how methods go on.

The truncated multigrid keeps its set-up (:mod:`adaptmg.solver.history.truncated_steps`). With FullMultigrid each step
has a nested start of the increment, unless the displacement extrapolated in the loads leaves far less: under
proportional loading that is the solution. All other methods start from the better of the displacement of the step
before and the extrapolated one; a FullMultigrid with another correction goes on as a Multigrid.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np

from adaptmg.discretisation.load_steps import LoadSteps, load_steps, whole_load
from adaptmg.discretisation.measures import StressData
from adaptmg.hierarchy import Hierarchy
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.load_path import LoadPath
from adaptmg.solver.arguments import checked_outcome
from adaptmg.solver.history.past import Past, StepSolver, better_start, coarse_displacements, past_of
from adaptmg.solver.history.store import fingerprint
from adaptmg.solver.method import own
from adaptmg.solver.multigrid import FullMultigrid, Multigrid
from adaptmg.solver.result import Result
from adaptmg.solver.result.examiner import Examiner
from adaptmg.solver.result.result_of import result_of
from adaptmg.solver.result.status import Status
from adaptmg.solver.run import Outcome, Run, Solver
from adaptmg.solver.statics import check_statics_of
from adaptmg.solver.truncated.multigrid import lifted_load

__all__ = ["PathWalk", "step_solver"]


def step_solver(solver: Solver) -> StepSolver:
    """The way through the steps for a solver."""
    if not isinstance(solver, Multigrid):
        return _Restarted(solver, solver)
    kept = own(solver.correction, "load_steps")
    if kept is not None:
        return kept(solver)
    if not isinstance(solver, FullMultigrid):
        return _Restarted(solver, solver)
    plain = Multigrid(**{item.name: getattr(solver, item.name) for item in fields(Multigrid)})
    return _Restarted(solver, plain)


class _Restarted:
    """A solver that is run anew for every step: ``first`` without a start, ``later`` with one."""

    def __init__(self, first: Solver, later: Solver) -> None:
        self.first, self.later = first, later

    def run(self, hierarchy: Hierarchy, examiner: Examiner, run: Run, past: Past) -> tuple[Outcome, None]:
        if not past.given:
            return self.first.run(hierarchy, run, None), None
        start = better_start(examiner, past, run)
        return self.later.run(hierarchy, run, start.reshape(examiner.discrete.n_nodes, -1)), None

    def replay(self, hierarchy: Hierarchy, past: Past, rtol: float) -> None:
        """Nothing is kept."""


_LOG = logging.getLogger(__name__)


@dataclass(eq=False)
class _Known:
    """The displacement of a step on the finest level, and the forces that led there (n_dofs,), None if unknown."""

    displacement: np.ndarray
    forces: np.ndarray | None


class PathWalk:
    """The way along a path.

    Parameters
    ----------
    grids : Hierarchy
    path : LoadPath
    solver : Solver
    start : (n_nodes, dim) array or None
        Displacement before the first step, m; between bodies relative.

    Attributes
    ----------
    factors : dict of str to (n_steps,) array
        Of everything that the path scales.
    examiner : Examiner
        Of the finest level at the present step.
    """

    def __init__(self, grids: Hierarchy, path: LoadPath, solver: Solver, start: np.ndarray | None) -> None:
        self.grids, self.path, self.solver, self.start = grids, path, solver, start
        self.factors = path.resolved(_problem_with_names(grids))
        self.loads = _loads(grids)
        for k in range(len(path)):
            # two supports that no longer agree should show before the first step is solved
            self.loads[-1].fixed_values(self._factors_at(k))
        self.examiner = Examiner(grids.finest.discrete)
        self.method = step_solver(solver)
        begin = np.zeros(grids.finest.discrete.n_dofs) if start is None else start.reshape(-1)
        self.past = past_of(grids, begin, start is not None)
        self.known = [_Known(begin, np.zeros_like(begin) if start is None else None)]

    def fingerprint(self, depends: Mapping[str, Any] | None) -> dict[str, Any]:
        """What the steps depend on."""
        return fingerprint(self.grids, self.loads, self.factors, len(self.path), {"solver": self.solver}, self.start,
                           depends)

    def described(self, k: int) -> str:
        """The factors of a step, for messages."""
        return ", ".join(f"{name}={factor:g}" for name, factor in self._factors_at(k).items())

    def _factors_at(self, k: int) -> dict[str, float]:
        return {name: float(values[k]) for name, values in self.factors.items()}

    def step(self, k: int, progress: Callable[[int, dict[str, float]], None] | None) -> Result:
        """Solve a step and remember it."""
        finest = self.grids.finest.discrete
        run = Run(unit=finest.matrix.nnz, callback=None if progress is None else partial(progress, k))
        with run.phase("setup"):
            grids = self._posed(k)
            forces = lifted_load(grids.finest.discrete)
            run.examiner = self.examiner = self.examiner.at_step(grids.finest.discrete)
            past = replace(self.past, extrapolated=self._extrapolated(forces))
        with run.phase("statics"):
            try:
                check_statics_of(grids, coarse_first=k > 0)
            except ValueError as error:
                raise ValueError(f"step {k} of {len(self.path)} ({self.described(k)}): {error}") from error
        if self._at_rest(forces):
            result, coarse = self._undeformed(k, grids, run), None
        else:
            outcome, coarse = self.method.run(grids, self.examiner, run, past)
            outcome = checked_outcome(outcome, self.solver, grids.finest.discrete)
            with run.phase("result"):
                result = result_of(grids, self.examiner, run, outcome, self.solver, self._stress_data(k))
        with run.phase("result"):
            self._remember(grids, result, forces, coarse)
        _LOG.info("step %d of %d (%s): %s after %d cycles", k, len(self.path), self.described(k), result.status.name,
                  result.cycles)
        return result

    def replay(self, k: int, result: Result) -> None:
        """Take over a step that is known already."""
        grids = self._posed(k)
        if result.displacement.shape != (grids.finest.n_nodes, grids.finest.discrete.dim):
            raise ValueError(f"step {k} in the store has {len(result.displacement)} nodes, the finest level "
                             f"{grids.finest.n_nodes}")
        moved = result.displacement.any()
        coarse = self.method.replay(grids, self.past, result.rtol) if moved else None
        self._remember(grids, result, lifted_load(grids.finest.discrete), coarse)

    def _at_rest(self, forces: np.ndarray) -> bool:
        """Whether nothing acts, and the undeformed bodies are a solution; ``forces`` is b - A u_fixed."""
        contact, quiet = self.examiner.contact, not (forces.any() or self.examiner.discrete.fixed_values.any())
        slid = np.abs(contact.slip_reference).any(axis=1)
        return quiet and bool((contact.gap >= 0).all()) and not contact.limit[slid].any()

    def _stress_data(self, k: int) -> StressData | None:
        return self.loads[-1].stress_data(self._factors_at(k))

    def _undeformed(self, k: int, grids: Hierarchy, run: Run) -> Result:
        """The result of a step in which nothing acts: no method could tell the relative error of its iterates."""
        rtol = getattr(self.solver, "rtol", None)
        outcome = Outcome(np.zeros(grids.finest.discrete.n_dofs), Status.CONVERGED, 0,
                          float(rtol) if isinstance(rtol, float | int) else np.nan, error_estimate=0.0)
        result = result_of(grids, self.examiner, run, outcome, self.solver, self._stress_data(k))
        # all forces vanish: a relative residual would be rounding over nothing
        return replace(result, status=Status.CONVERGED, residual=0.0)

    def _posed(self, k: int) -> Hierarchy:
        """The hierarchy with loads, prescribed values and slip references of a step."""
        factors, levels = self._factors_at(k), []
        offset = len(self.grids) - len(self.past.levels)
        for number, (level, loads) in enumerate(zip(self.grids.levels, self.loads, strict=True)):
            if loads is not None and number >= offset:
                problem, reference = level.discrete, level.discrete.contact.slip_reference
                if self.past.given:
                    reference = problem.at_contact(self.past.levels[number - offset])
                step = problem.with_step(loads.load(factors), loads.fixed_values(factors), reference)
                level = level.posing(step)
            levels.append(level)
        return Hierarchy(tuple(levels), self.grids.problem, self.grids.origin, dict(self.grids.timings))

    def _remember(self, grids: Hierarchy, result: Result, forces: np.ndarray, coarse: list[np.ndarray] | None) -> None:
        """What the next step wants to know."""
        discrete = grids.finest.discrete
        # from the result, as a path that goes on from its store has it
        displacement = discrete.relative(result.displacement).reshape(-1)
        self.known = [*self.known[-1:], _Known(displacement, forces)]
        if coarse is not None:
            levels = [*coarse, displacement]
        elif grids.discretised:
            levels = coarse_displacements(grids, displacement)
        else:
            levels = [displacement]
        self.past = Past(levels, displacement, True)

    def _extrapolated(self, forces: np.ndarray) -> np.ndarray:
        """The displacement for new forces if all goes on as between the last two steps, least squares in the forces."""
        before, last = self.known[0], self.known[-1]
        if len(self.known) < 2 or before.forces is None:
            return last.displacement
        change = last.forces - before.forces
        # not through BLAS, whose threads cost more than they gain
        size = float(np.einsum("i,i->", change, change))
        if size == 0.0:
            return last.displacement
        ratio = float(np.einsum("i,i->", forces - last.forces, change)) / size
        return last.displacement + ratio * (last.displacement - before.displacement)


def _problem_with_names(grids: Hierarchy) -> ContactProblem | None:
    """The problem, if its loads can be told apart on every level."""
    known = all(level.mesh is not None for level in grids.levels if level.discrete is not None)
    return grids.problem if known else None


def _loads(grids: Hierarchy) -> list[LoadSteps | None]:
    """Loads and supports one by one on each level; None where a level is only a space."""
    named = _problem_with_names(grids) is not None
    return [None if level.discrete is None
            else load_steps(grids.problem, level.mesh, level.discrete.coupling) if named else whole_load(level.discrete)
            for level in grids.levels]
