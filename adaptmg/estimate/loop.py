r"""AdaptiveLoop: from mesh to mesh: mark, refine, carry over, solve, estimate, store.

Each mesh is solved from the solution before. The rate of multigrid depends on the local size
ratio of neighbouring levels, the element sizes :math:`H/h` at the same place (measured on a flat punch: 3.3, 6.5, 12,
24 give rates of .35-.64, .66-.82, .83, .88), its cost on the nodes of all levels. With its 99 % quantile :math:`q`

- a mesh is put in between where q > 4.5 and the engine can make one (at 4 it has hardly more nodes than the coarser),
- a level is dropped where it has nearly as many nodes as the next finer one, and q <= 3.5 holds without it (at 4, two
  bisections of everything near a singularity, the flat punch's rate goes from .6 to .75 and the work of the loop up).

With a load path every mesh goes along the whole path, and is refined for its last load step or for all.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from adaptmg._numba import clock, compiling_seconds
from adaptmg._threads import one_blas_thread
from adaptmg.discrete.discretise import load_steps
from adaptmg.estimate.engines import Engine, divisible, sound_mesh
from adaptmg.estimate.estimate import Estimate, Indicator, Mark, estimate_of, marks_of
from adaptmg.estimate.step import Limits, Step, StoredStep, expected_seconds, restored, settled
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.bisection import with_refinement
from adaptmg.multigrid.volume_pressures import prolonged_pressures
from adaptmg.problem import LoadPath, step_problem
from adaptmg.solver.advice import once
from adaptmg.solver.load_path import PathResult, solve_path
from adaptmg.solver.multigrid import FullMultigrid, Multigrid
from adaptmg.solver.record import Solver
from adaptmg.solver.result import Result
from adaptmg.solver.solve import solve
from adaptmg.solver.store import StepStore, Stored
from adaptmg.transfer.interpolation import size_ratio

_LOG = logging.getLogger(__name__)

Progress = Callable[[dict[str, float | str]], None]


@dataclass(frozen=True)
class Parts:
    """What the loop is made of; :func:`adaptmg.adapt` says what each is."""

    indicator: Indicator
    mark: Mark
    engine: Engine
    solver: Solver | None = None
    load_path: LoadPath | None = None
    adapt_on: str = "last"


@dataclass
class _Clock:
    """Seconds by phase."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def phase(self, name: str) -> Iterator[None]:
        begin, compiled = clock(), compiling_seconds()
        try:
            yield
        finally:
            for what, spent in ((name, clock() - begin), ("compiling", compiling_seconds() - compiled)):
                if spent or what == name:
                    self.seconds[what] = self.seconds.get(what, 0.0) + spent

    def take(self) -> dict[str, float]:
        taken, self.seconds = self.seconds, {}
        return taken


#: nodes of the next mesh over those of the last, below which it is not worth making
LEAST_GROWTH = 1.3
#: sums of squares that are rounding, over the square of the norm, as of solutions which are linear; over the value of
#: a goal (forces that equilibrium gives: 1e-17)
EXACT, EXACT_GOAL = 1e-16, 1e-13
#: tolerance of the solves: resultants hold to 1e-4 and better on bodies of 20 : 1, and compliances, which see algebraic
#: errors to first order and those of the mesh to second, to a tenth of the latter. Marks need a hundredth of the
#: estimate, but a result is what the user keeps; from 1e-2 to 1e-6 loops take 0 to 10 % more processor time
RTOL = 1e-6
#: times that an engine is asked for a mesh that is not too large
ATTEMPTS = 3
#: the estimate must fall by this factor over meshes of so much more nodes, or the loop ends (coarse meshes that do not
#: resolve a problem hardly better it at first)
PROGRESS, OVER = 0.95, 4.0
#: nodes from which that is asked: with fewer, contact may have none where it will be, and estimates mean little
RESOLVED = 500


class AdaptiveLoop:
    """One run of the adaptive loop."""

    def __init__(self, start: Hierarchy, parts: Parts, limits: Limits, store: StepStore | None,
                 progress: Progress | None) -> None:
        self.first, self.parts, self.limits, self.store, self.progress = start, parts, limits, store, progress
        self.clock = _Clock()
        self.clock.seconds |= start.timings
        self.done: list[Step] = []
        self.steering: Estimate | None = None
        self.said: set[str] = set()  # kinds of warnings, each given once in the loop

    def steps(self) -> Iterator[Step]:
        """Yield the steps, those of the store first."""
        for number, stored in enumerate(() if self.store is None else self.store.steps()):
            self.clock.take()
            self._remember(self._restored(number, stored))
            yield self.done[-1]
        if not self.done:
            yield self._solve(self.first, None)
        while True:
            last = self.done[-1]
            reason = self._reached(last)
            if not reason:
                mesh, reason = self._refine(last)
            if reason:
                object.__setattr__(last, "outcome", reason)
                _LOG.debug("the adaptive loop ends: %s", reason)
                return
            yield self._solve(*self._carry(last, mesh))

    def _reached(self, last: Step) -> str:
        """Which limit a step has reached, as text; empty if none."""
        limits, relative = self.limits, last.estimate.relative
        met = [limits.tolerance is not None and step.estimate.relative <= limits.tolerance for step in self.done[-2:]]
        # signs of goals may be chance on every mesh: twice in a row is enough
        if met[-1] and (last.settled is not False or met == [True, True]):
            return f"tolerance met: the estimate is {relative:.3g}, the tolerance {limits.tolerance:g}"
        estimate = last.estimate
        exact = EXACT * estimate.norm**2 if estimate.value is None else EXACT_GOAL * abs(estimate.value)
        if estimate.squares.sum() <= exact:
            return "no progress: the indicator finds no error beyond rounding"
        if self._full(last.nodes):
            return f"max_nodes: {last.nodes} of {limits.max_nodes} nodes are used"
        if limits.max_seconds is not None and last.total_seconds >= limits.max_seconds:
            return f"max_seconds: {last.total_seconds:.1f} s of {limits.max_seconds:g} s are used"
        for before in reversed(self.done[:-2]):
            if before.nodes >= RESOLVED and last.nodes >= OVER * before.nodes:
                falls = np.sqrt(last.estimate.squares.sum() / before.estimate.squares.sum())
                if falls > PROGRESS:
                    return (f"no progress: from {before.nodes} to {last.nodes} nodes the estimate falls by "
                            f"{1 - falls:.1%} only")
                break
        return ""

    def _full(self, nodes: int) -> bool:
        """Whether this number of nodes leaves no room for another mesh."""
        return self.limits.max_nodes is not None and nodes * LEAST_GROWTH > self.limits.max_nodes

    @one_blas_thread()
    def _refine(self, last: Step) -> tuple[MeshArrays | None, str]:
        """The next mesh; or why there is none."""
        self._report("mesh", last.nodes)
        most, engine, problem = self.limits.max_nodes, self.parts.engine, self.first.problem
        with self.clock.phase("mesh"):
            mesh, estimate = last.hierarchy.finest.mesh, self._steering(last)
            marked = marks_of(self.parts.mark, estimate)
            if not marked.any():
                return None, "no progress: the marking chooses no element"
            bound = most
            for _ in range(ATTEMPTS):
                finer = engine.refine(problem, mesh, estimate, marked, max_nodes=bound)
                if finer is not None:
                    finer = sound_mesh(engine, "refine", problem, finer, mesh)
                if finer is None or finer.n_nodes <= mesh.n_nodes:
                    floor = "" if divisible(mesh)[marked].any() else (
                        "; the marked elements are so small that coordinates do not resolve smaller ones")
                    return None, f"no progress: the engine makes no finer mesh than that of {mesh.n_nodes} nodes{floor}"
                if most is None or finer.n_nodes <= most:
                    return finer, ""
                # sizes are met roughly only: ask for as much less
                bound = int(0.98 * bound * most / finer.n_nodes)
        return None, f"max_nodes: the next mesh has {finer.n_nodes} nodes, {most} are allowed"

    @one_blas_thread()
    def _carry(self, last: Step, mesh: MeshArrays) -> tuple[Hierarchy, Result]:
        self._report("assembly", mesh.n_nodes)
        before = last.hierarchy
        with self.clock.phase("levels"):
            grown = appended(before, mesh, self.parts.engine)
            start = carried(grown, len(before) - 1, last.result)
            grown = thinned(grown, last=self._full(mesh.n_nodes))
        for name, seconds in (item for item in grown.timings.items() if item[0] != "compiling"):
            # what the hierarchy spent is not part of choosing levels
            spent = seconds - before.timings.get(name, 0.0)
            self.clock.seconds[name] = self.clock.seconds.get(name, 0.0) + spent
            self.clock.seconds["levels"] -= spent
        return grown, start

    @one_blas_thread()
    def _solve(self, hierarchy: Hierarchy, start: Result | None) -> Step:
        """Solve, estimate and store a step."""
        number, last, parts = len(self.done), self.done[-1] if self.done else None, self.parts
        self._report("solve", hierarchy.finest.n_nodes)
        with once(self.said), self.clock.phase("solve"):
            if parts.load_path is None:
                path, result = None, solved(hierarchy, parts.solver, start)
            else:
                solver = FullMultigrid(rtol=RTOL) if parts.solver is None else parts.solver
                solver = solver if _applies(solver, hierarchy) else None
                path, result = solve_path(hierarchy, parts.load_path, solver), None
        self._report("estimate", hierarchy.finest.n_nodes)
        with self.clock.phase("estimate"):
            if path is None:
                estimate = estimate_of(parts.indicator, hierarchy, result)
            else:
                k, estimate, self.steering = _path_estimate(hierarchy, parts, path)
                result = path[k]
        work = result.work_units if path is None else sum(one.work_units for one in path)
        nonzeros, timings = hierarchy.finest.matrix.nnz, self.clock.take()
        before = 0.0 if last is None else last.total_work_units * last.hierarchy.finest.matrix.nnz / nonzeros
        step = Step(number, hierarchy, result, estimate, timings,
                    sum(timings.values()) + (0.0 if last is None else last.total_seconds), work, work + before, path,
                    settled(estimate, None if last is None else last.estimate))
        with self.clock.phase("store"):
            if self.store is not None:
                numbers = {"total_seconds": step.total_seconds, "work_units": step.work_units,
                           "total_work_units": step.total_work_units}
                self.store.put(number, result, StoredStep(
                    estimate, [level.mesh for level in hierarchy.levels], result.mesh.refinement, numbers, timings,
                    path))
        self._remember(step)
        return step

    def _steering(self, last: Step) -> Estimate:
        """The estimate by which the next mesh is made: of a load path perhaps more than that of the step."""
        if last.path is None or self.parts.adapt_on == "last":
            return last.estimate
        if self.steering is None:  # the step is from a store
            self.steering = _path_estimate(last.hierarchy, self.parts, last.path)[2]
        return self.steering

    def _restored(self, number: int, step: Stored) -> Step:
        stored: StoredStep = step.more
        own, last = with_refinement(step.value.mesh, stored.history), self.done[-1] if self.done else None
        hierarchy = restored(self.first if last is None else last.hierarchy, [*stored.levels[:-1], own])
        # one mesh for both, with its source
        result = replace(step.value, mesh=hierarchy.finest.mesh)
        return Step(number, hierarchy, result, stored.estimate, stored.timings, path=stored.path,
                    settled=settled(stored.estimate, last and last.estimate), **stored.numbers)

    def _remember(self, step: Step) -> None:
        self.done.append(step)
        self._report("done", step.nodes)
        _LOG.debug("%s", step)

    def _report(self, phase: str, nodes: int) -> None:
        if self.progress is None:
            return
        last = self.done[-1] if self.done else None
        seconds = sum(self.clock.seconds.values()) + (0.0 if last is None else last.total_seconds)
        self.progress({"step": len(self.done) - (phase == "done"), "phase": phase, "nodes": nodes, "seconds": seconds,
                       "estimate": float("nan") if last is None else last.estimate.relative,
                       "expected_seconds": float("nan") if last is None else expected_seconds(self.done, self.limits)})


def solved(hierarchy: Hierarchy, solver: Solver | None, start: Result | None) -> Result:
    """Return the solution on the finest level."""
    if solver is None or not _applies(solver, hierarchy):
        method = FullMultigrid if start is None else Multigrid
        solver = None if len(hierarchy) == 1 else method(rtol=RTOL)
    return solve(hierarchy, solver, start=None if isinstance(solver, FullMultigrid) else start)


def _applies(solver: Solver, hierarchy: Hierarchy) -> bool:
    """Whether a solver can be used: multigrid needs two levels."""
    return len(hierarchy) > 1 or not isinstance(solver, Multigrid)


#: largest local size ratio (its 99 % quantile) between neighbours
RATIO = 4.5
#: the same where a level could be dropped: what it saves must not cost cycles
THINNED = 3.5
#: nodes of a level over those of the next coarser one below which the two are too close
CLOSE = 1.7
#: meshes put between two neighbours at most, and how many more nodes than the coarser one each must have
MOST_BETWEEN, GROWTH = 4, 1.2


def appended(hierarchy: Hierarchy, mesh: MeshArrays, engine: Engine) -> Hierarchy:
    """Return the hierarchy with a finer mesh, and meshes between it and the present finest where the size ratio asks
    for them."""
    between = getattr(engine, "intermediate", None)
    for _ in range(MOST_BETWEEN if callable(between) else 0):
        finest = hierarchy.finest.mesh
        if size_ratio(finest, mesh) <= RATIO:
            break
        middle = between(hierarchy.problem, finest, mesh)
        if middle is not None:
            middle = sound_mesh(engine, "intermediate", hierarchy.problem, middle, finest)
        if middle is None or not GROWTH * finest.n_nodes <= middle.n_nodes <= mesh.n_nodes / GROWTH:
            break
        hierarchy = hierarchy.append(middle)
    return hierarchy.append(mesh)


def thinned(hierarchy: Hierarchy, last: bool = False) -> Hierarchy:
    """Return the hierarchy without the levels next to the finest that are too close to their neighbours and not needed.
    A single one that is too close to the ``last`` mesh stays: its cycles cost less than to do without it."""
    if last and (len(hierarchy) < 3 or hierarchy[-2].n_nodes >= CLOSE * hierarchy[-3].n_nodes):
        return hierarchy
    for level in (len(hierarchy) - 2, len(hierarchy) - 3):
        if level < 1:
            break
        finer, this = hierarchy[level + 1], hierarchy[level]
        if finer.n_nodes < CLOSE * this.n_nodes and size_ratio(hierarchy[level - 1].mesh, finer.mesh) <= THINNED:
            hierarchy = hierarchy.without(level)
    return hierarchy


def carried(hierarchy: Hierarchy, below: int, result: Result) -> Result:
    """Return the result of a level with displacement and pressures interpolated to the finest one, level by level."""
    values, pressures = hierarchy[below].discrete.relative(result.displacement), result.pressures
    for coarse, level in pairwise(hierarchy.levels[below:]):
        values = level.prolongation @ values
        pressures = prolonged_pressures(coarse.discrete, level.discrete, level.prolongation, pressures)
    return replace(result, displacement=hierarchy.finest.discrete.physical(values), pressures=pressures)


def posed_at(hierarchy: Hierarchy, path: LoadPath, results: PathResult, k: int) -> Hierarchy:
    """Return the hierarchy with the problem of load step ``k`` on the finest level, slips counted from the step
    before."""
    problem, finest = hierarchy.problem, hierarchy.finest
    factors = {name: float(values[k]) for name, values in path.resolved(problem).items()}
    loads, discrete = load_steps(problem, finest.mesh, finest.discrete), finest.discrete
    reference = discrete.contact.slip_reference
    if k > 0:
        reference = discrete.at_contact(discrete.relative(results[k - 1].displacement).reshape(-1))
    posed = finest.posing(discrete=loads.step(discrete, factors, reference))
    return replace(hierarchy, levels=(*hierarchy.levels[:-1], posed), problem=step_problem(problem, factors))


def _path_estimate(hierarchy: Hierarchy, parts: Parts, results: PathResult) -> tuple[int, Estimate, Estimate]:
    """The last load step, or the one with the largest relative estimate: number, estimate, and what to refine by. Of
    several load steps each element counts with its largest share in the relative estimate of any step: a mesh made for
    one step alone is too coarse where others need it, and the loop would alternate between them."""
    steps = range(len(results)) if parts.adapt_on == "worst" else (len(results) - 1,)
    estimates = {k: estimate_of(parts.indicator, posed_at(hierarchy, parts.load_path, results, k), results[k])
                 for k in steps if parts.adapt_on == "last" or results[k].displacement.any()}
    if not estimates:
        raise ValueError("load_path: nothing moves in any of its steps, so there is nothing to refine for")
    k = max(estimates, key=lambda k: estimates[k].relative)
    # a quantity that is zero has no relative error: above 1 all steps count alike
    shares = np.max([min(one.relative, 1.0) ** 2 / (one.squares.sum() or 1.0) * one.squares
                     for one in estimates.values()], axis=0)
    return k, estimates[k], replace(estimates[k], squares=shares)
