r"""AdaptiveLoop: from mesh to mesh: mark, refine, carry over, solve, estimate, store; and the Step
that each yields.

Each mesh is solved from the solution before. The rate of multigrid depends on the local size ratio
of neighbouring levels, the element sizes :math:`H/h` at the same place (measured on a flat punch:
3.3, 6.5, 12, 24 give rates of .35-.64, .66-.82, .83, .88), its cost on the nodes of all levels.
With its 99 % quantile :math:`q`

- a mesh is put in between where q > 4.5 and the engine can make one (at 4 it has hardly more nodes
  than the coarser),
- a level is dropped where it has nearly as many nodes as the next finer one, and q <= 4.5 holds
  without it.

With a load path every mesh goes along the whole path, and is refined for its last load step or for
all; or a mesh takes some load steps, and the next mesh goes on from its state
(:mod:`adaptmg.evolution.state_transfer`).

In a folder each step is one file of a :class:`adaptmg.solver.store.StepStore`: the result with its
mesh, and a
:class:`StoredStep`. A killed loop goes on with the same numbers. Limits are not part of the fingerprint: a loop may go
on under others.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Generic, Literal, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg._text import html_table, in_html_lines, shortened, warn_user
from adaptmg._threads import one_blas_thread
from adaptmg._units import in_units
from adaptmg.discrete.named_loads import load_steps, whole_load
from adaptmg.discrete.posed import Posed
from adaptmg.estimate.engines import Engine, divisible, sound_mesh
from adaptmg.estimate.estimate import AnyEstimate, Estimate, Indicator, Mark, estimate_of, marks_of
from adaptmg.estimate.goal import GoalEstimate
from adaptmg.evolution.load_path import PathResult, solve_path
from adaptmg.evolution.state_transfer import transfer_state
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays, Refinement, need_mesh, sound_by_construction
from adaptmg.mesh.bisection import with_refinement
from adaptmg.mesh.soundness import check_mesh
from adaptmg.multigrid.volume_pressures import prolonged_pressures
from adaptmg.problem import LoadPath, step_problem
from adaptmg.solver.active_set import ActiveSet
from adaptmg.solver.advice import once
from adaptmg.solver.multigrid import FullMultigrid, Multigrid
from adaptmg.solver.record import Run, Solver
from adaptmg.solver.result import KINDS, Result
from adaptmg.solver.solve import solve
from adaptmg.solver.store import StepStore, Stored, fingerprint
from adaptmg.transfer.interpolation import size_ratio

if TYPE_CHECKING:
    import pandas

_LOG = logging.getLogger(__name__)

#: a function of the dict of :func:`adaptmg.adapt`, called before and after each phase
Progress = Callable[[dict[str, float | str]], None]


@dataclass(frozen=True, kw_only=True)
class Limits(checks.Checked):
    """The limits at which the loop ends; at least one is given."""

    tolerance: checks.Tolerance | None = None  # for the relative estimate
    max_nodes: checks.Count | None = None
    max_seconds: checks.Positive | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.tolerance is None and self.max_nodes is None and self.max_seconds is None:
            raise ValueError(
                "give at least one of tolerance, max_nodes and max_seconds: the loop would never end"
            )


@dataclass(frozen=True, eq=False, repr=False)
class Step(Generic[AnyEstimate]):
    """A mesh of the adaptive loop, solved and estimated; printing it shows a line with its figures.

    Attributes
    ----------
    number : int
        0 for the start.
    hierarchy : Hierarchy
        All levels that were used; its finest is the mesh of the step.
    result : Result
        On it, solved to ``result.rtol`` (by default 1e-6, far below the estimate, so that forces
        and compliances hold); of a load path that of the load step by which the mesh is refined.
    estimate : Estimate
    timings : dict of str to float
        Seconds of this step by phase: "mesh" (marking and refining the mesh before), "assembly",
        "transfer", "levels" (which meshes stay), "solve", "estimate", "store".
    total_seconds : float
        Of all steps so far.
    work_units, total_work_units : float
        Of the solve, and of all solves so far, in passes over the finest matrix of this step.
    path : PathResult or None
        All load steps, where there is a load path; with ``remesh_every`` those on this mesh, of
        which the first repeats the last one of the mesh before.
    settled : bool or None
        Of a goal: whether its signed estimates have the sign of those of the mesh before, and are
        no smaller than the change of the corrected values since then; False on the first mesh.
        While they are not, the printed step says "not settled", and only two meshes in a row below
        it end the loop by ``tolerance``. It may be True, False and True again where the error
        passes through zero, which is not a fault of the loop: take the corrected values then, and
        their change from mesh to mesh as the error. None for energy norms.
    outcome : str
        Why the loop stopped after this step; empty as long as it has not.

    Examples
    --------
    >>> problem = am.cases.greco_bar()
    >>> mesh = am.mesh.structured(problem.domain, 2)
    >>> steps = list(am.adapt(problem, mesh, engine=am.Bisect(), max_nodes=20))
    >>> steps[0].nodes < steps[-1].nodes
    True
    """

    number: int
    hierarchy: Hierarchy
    result: Result
    estimate: AnyEstimate
    timings: Mapping[str, float]
    total_seconds: float
    work_units: float
    total_work_units: float
    path: PathResult | None = None
    settled: bool | None = None
    outcome: str = ""

    @property
    def nodes(self) -> int:
        """Return the number of nodes of the mesh."""
        return self.hierarchy.finest.n_nodes

    @property
    def seconds(self) -> float:
        """Return the seconds of this step, the mesh included."""
        return float(sum(self.timings.values()))

    def __repr__(self) -> str:
        doubtful = " (not settled)" if self.settled is False else ""
        text = (
            f"step {self.number:>2}: {self.nodes:>7} nodes, {len(self.hierarchy):>2} levels, estimate "
            f"{self.estimate.relative:>7.3%}{doubtful}, {self.result.cycles:>3} cycles, {self.work_units:>6.1f} "
            f"work units ({self.total_work_units:.1f} in all), {self.seconds:.3g} s ({self.total_seconds:.3g} s "
            "in all)"
        )
        return shortened(f"{text}; {self.outcome}" if self.outcome else text)

    def _repr_html_(self) -> str:
        return html_table(self.table([self])) + in_html_lines(self.outcome)

    @staticmethod
    def table(steps: Sequence[Step]) -> pandas.DataFrame:
        """Return one row a step, with units in the heads, those of :func:`adaptmg.set_units`:
        ``am.Step.table(list(am.adapt(...)))``."""
        import pandas

        steps = checks.items("steps", steps, Step)
        return in_units(
            pandas.DataFrame(
                [
                    {
                        "step": step.number,
                        "nodes": step.nodes,
                        "levels": len(step.hierarchy),
                        "contact_nodes": len(step.result.contact),
                        "estimate": step.estimate.relative,
                        "status": step.result.status.name,
                        "rtol": step.result.rtol,
                        "cycles": step.result.cycles,
                        "work_units": step.work_units,
                        "total_work_units": step.total_work_units,
                        "seconds [s]": step.seconds,
                        "total_seconds [s]": step.total_seconds,
                        "pressure [Pa]": step.result.max_pressure,
                    }
                    for step in steps
                ]
            )
        )


def settled(estimate: Estimate, before: Estimate | None) -> bool | None:
    """Return :attr:`Step.settled` of an estimate, given that of the mesh before."""
    if estimate.signed is None:
        return None
    if before is None or before.signed is None:
        return False
    values, errors = _values_and_errors(estimate)
    old_values, old_errors = _values_and_errors(before)
    # the change of the corrected values; another number of quantities cannot be compared
    change = (
        np.abs(values + errors - old_values - old_errors)
        if values.shape == old_values.shape
        else np.inf
    )
    same_sign = errors * old_errors > 0
    return bool((same_sign & (change <= np.abs(errors))).all())


def _values_and_errors(estimate: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """Return the values (n,) of the quantities of a goal and their estimated errors (n,)."""
    if isinstance(estimate, GoalEstimate):
        return estimate.values, estimate.errors
    return np.array([estimate.value]), np.array([estimate.signed])


def _is_exact(estimate: Estimate) -> bool:
    """Return whether the sum of squares of an estimate is rounding, next to the square of the energy
    norm or, of a goal, to its value."""
    # solutions that are linear: solves to RTOL leave 6e-13 of the square of the norm in patch tests
    rounding = (
        (checks.SIX_DIGITS * estimate.norm) ** 2
        if estimate.value is None
        else checks.ROUNDING * abs(estimate.value)
    )
    return bool(estimate.squares.sum() <= rounding)


@dataclass(frozen=True, eq=False)
class StoredStep:
    """The record that a store has of a step next to its result."""

    estimate: Estimate
    levels: list[MeshArrays]  # the meshes of all levels
    history: Refinement | None  # the bisections that made its own mesh
    numbers: dict[str, float]  # total_seconds, work_units, total_work_units
    timings: dict[str, float]  # seconds by phase
    path: PathResult | None = None

    @classmethod
    def of(cls, step: Step) -> StoredStep:
        """Return the record of a step."""
        return cls(
            step.estimate,
            levels=[need_mesh(level) for level in step.hierarchy.levels],
            history=need_mesh(step.result).refinement,
            numbers={
                name: getattr(step, name)
                for name in ("total_seconds", "work_units", "total_work_units")
            },
            timings=dict(step.timings),
            path=step.path,
        )


_offers_indicate = partial(
    checks.offers,
    method="indicate",
    words="Residual(), Recovery(), Goal(...) or offer indicate(hierarchy, result) -> Estimate",
)
_offers_mark = partial(
    checks.offers,
    method="mark",
    words="Doerfler(...), Maximum(...) or offer mark(estimate) -> mask",
)
_offers_refine = partial(
    checks.offers,
    method="refine",
    words="Remesh(), Bisect() or offer refine(problem, mesh, estimate, marked, max_nodes) -> MeshArrays",
)
_offers_run = partial(
    checks.offers, method="run", words="Multigrid(), ActiveSet(), ... or offer run()"
)


@dataclass(frozen=True)
class LoopParts(checks.Checked):
    """The parts of a loop; :func:`adaptmg.adapt` says what each is."""

    indicator: Annotated[Indicator, _offers_indicate]
    mark: Annotated[Mark, _offers_mark]
    engine: Annotated[Engine, _offers_refine]
    solver: Annotated[Solver, _offers_run] | None = None
    load_path: (
        Annotated[LoadPath, partial(checks.instance, types=LoadPath, words="a LoadPath")] | None
    ) = None
    adapt_on: Literal["last", "worst"] = "last"
    rtol: float | None = None
    remesh_every: checks.Count | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.remesh_every is not None and (self.load_path is None or self.adapt_on == "worst"):
            raise ValueError('remesh_every must come with a load_path, and adapt_on="last"')

    def path_of(self, number: int) -> LoadPath:
        """Return the load steps that mesh ``number`` takes: all, or those after the last one of the
        mesh before, which it repeats."""
        path = cast("LoadPath", self.load_path)
        if self.remesh_every is None:
            return path
        end = (number + 1) * self.remesh_every
        steps = slice(max(end - self.remesh_every - 1, 0), end)
        factors = {name: values[steps] for name, values in path.factors.items()}
        return LoadPath(factors, path.default[steps])


#: nodes of the next mesh over those of the last, below which it is not worth making, and of one
#: between them: measured 1.15 and 1.6 change none of 20 loops to 700 nodes; between levels 1.2 and 1.4
#: make 8 % more and 3 % less work of 10 of them
LEAST_GROWTH = 1.3
#: tolerance of the solves: resultants hold to 1e-4 and better on bodies of 20 : 1, and compliances, which see algebraic
#: errors to first order and those of the mesh to second, to a tenth of the latter. Marks need a hundredth of the
#: estimate, but a result is what the user keeps; from 1e-2 to 1e-6 loops take 0 to 10 % more processor time
RTOL = 1e-6
#: times that an engine is asked for a mesh that is not too large
ATTEMPTS = 3


class AdaptiveLoop:
    """One run of the adaptive loop."""

    def __init__(
        self,
        start: Hierarchy,
        parts: LoopParts,
        limits: Limits,
        store: StepStore | None,
        progress: Progress | None,
    ) -> None:
        self.first = start
        self.parts = parts
        self.limits = limits
        self.store = store
        self.progress = progress
        self.clock = Run(unit=1)  # for the seconds of its phases: it counts no work
        self.clock.timings |= start.timings
        self.done: list[Step] = []
        #: for all load steps of the path of the last step, from :meth:`_solve`; None without a load path, and
        #: of a step from a store until :meth:`_steering` makes it
        self.steering: Estimate | None = None
        self.warned_kinds: set[str] = set()  # each kind of warning is given once in the loop

    def steps(self) -> Iterator[Step]:
        """Yield the steps, those of the store first, until a limit is reached."""
        for number, stored in enumerate(() if self.store is None else self.store.steps()):
            self.clock.timings = {}
            self._remember(self._restored(number, stored))
            yield self.done[-1]
        if not self.done:
            yield self._solve(self.first, start=None)
        while True:
            last = self.done[-1]
            # why the mesh stays, and why the loop ends; both empty as long as neither is the case
            why_same_mesh = self._reached(last)
            outcome = self._reason_to_end(last)
            mesh = None
            if not (outcome or why_same_mesh):
                mesh, why_same_mesh = self._refine(last)
            # without remeshing along a path a loop ends where its mesh stays; with it the path goes on there
            if self.parts.remesh_every is None:
                outcome = why_same_mesh or outcome
            if outcome:
                # the step was yielded before it was known that it is the last one
                object.__setattr__(last, "outcome", outcome)
                if self.first.problem.contact and not last.result.displacement.any():
                    warn_user(
                        f"the displacement is zero on the last mesh, of {last.nodes} nodes, and so is the "
                        "estimate: nothing acts there. An obstacle that lies between two nodes of a contact "
                        "boundary is not seen: take a smaller start"
                    )
                _LOG.debug("the adaptive loop ends: %s", outcome)
                return
            if mesh is None:
                yield self._solve(last.hierarchy, last.result)
            else:
                yield self._solve(*self._grown(last, mesh))

    def _reason_to_end(self, last: Step) -> str:
        """Return the reason to end the loop that its time or its load path gives; "" to go on."""
        limits = self.limits
        every = self.parts.remesh_every
        if limits.max_seconds is not None and last.total_seconds >= limits.max_seconds:
            return f"max_seconds: {last.total_seconds:.1f} s of {limits.max_seconds:g} s are used"
        load_steps = 0 if self.parts.load_path is None else len(self.parts.load_path)
        if every is not None and (last.number + 1) * every >= load_steps:
            return f"the load path ends after {load_steps} load steps"
        return ""

    def _reached(self, last: Step) -> str:
        """Return the limit that a step has reached, as text; empty if it has reached none."""
        limits = self.limits
        accurate = [
            limits.tolerance is not None and step.estimate.relative <= limits.tolerance
            for step in self.done[-2:]
        ]
        # signs of goals may be chance on every mesh: twice in a row is enough
        if accurate[-1] and (last.settled is not False or accurate == [True, True]):
            return (
                f"tolerance met: the estimate is {last.estimate.relative:.3g}, the tolerance "
                f"{limits.tolerance:g}"
            )
        # of a goal on two meshes in a row: with one node in contact, the load alone gives its pressure
        without_error = [_is_exact(step.estimate) for step in self.done[-2:]]
        if without_error[-1] and (last.settled is None or without_error == [True, True]):
            return "no progress: the indicator finds no error beyond rounding"
        if self._is_near_limit(last.nodes):
            return f"max_nodes: {last.nodes} of {limits.max_nodes} nodes are used"
        return ""

    def _is_near_limit(self, nodes: int) -> bool:
        """Return whether this number of nodes leaves no room for another mesh; along a path meshes
        may follow each other with the same number."""
        if self.limits.max_nodes is None or self.parts.remesh_every is not None:
            return False
        return nodes * LEAST_GROWTH > self.limits.max_nodes

    @one_blas_thread()
    def _refine(self, last: Step) -> tuple[MeshArrays | None, str]:
        """Return the next mesh, or None and the reason why there is none."""
        self._report("mesh", last.nodes)
        max_nodes = self.limits.max_nodes
        engine = self.parts.engine
        problem = self.first.problem
        with self.clock.phase("mesh"):
            mesh = need_mesh(last.hierarchy.finest)
            estimate = self._steering(last)
            # of a goal, whose squares are rounding: refine all elements alike
            if _is_exact(estimate):
                estimate = replace(estimate, squares=np.ones_like(estimate.squares))
            marked = marks_of(self.parts.mark, estimate)
            if not marked.any():
                return None, "no progress: the marking chooses no element"
            # between steps of a load path the next mesh may have fewer nodes
            must_grow = self.parts.remesh_every is None
            bound = max_nodes
            for _ in range(ATTEMPTS):
                finer = engine.refine(problem, mesh, estimate, marked, max_nodes=bound)
                if finer is not None:
                    finer = sound_mesh(engine, "refine", problem, finer, mesh)
                if finer is None or (must_grow and finer.n_nodes <= mesh.n_nodes):
                    reason = f"no progress: the engine makes no finer mesh than that of {mesh.n_nodes} nodes"
                    if not divisible(mesh)[marked].any():
                        reason += "; the marked elements are so small that coordinates do not resolve smaller ones"
                    return None, reason
                if max_nodes is None or finer.n_nodes <= max_nodes:
                    return finer, ""
                # engines meet the number roughly: ask for fewer in proportion, and 2 % less
                bound = int(0.98 * cast("int", bound) * max_nodes / finer.n_nodes)
        return None, f"max_nodes: the next mesh has {finer.n_nodes} nodes, {max_nodes} are allowed"

    @one_blas_thread()
    def _grown(self, last: Step, mesh: MeshArrays) -> tuple[Hierarchy, Result | None]:
        """Return the hierarchy with the next mesh, and the last result interpolated to it as start; a load
        path begins without."""
        self._report("assembly", mesh.n_nodes)
        before = last.hierarchy
        with self.clock.phase("levels"):
            grown = appended(before, mesh, self.parts.engine)
            start = None
            if self.parts.load_path is None:
                start = carried(grown, len(before) - 1, last.result)
            grown = thinned(grown, last=self._is_near_limit(mesh.n_nodes))
        # the seconds of the phases of the hierarchy are not those of choosing levels; compiling is not a
        # phase, and the clock has counted it
        for name, seconds in grown.timings.items():
            if name != "compiling":
                spent = seconds - before.timings.get(name, 0.0)
                self.clock.timings[name] = self.clock.timings.get(name, 0.0) + spent
                self.clock.timings["levels"] -= spent
        return grown, start

    @one_blas_thread()
    def _solve(self, hierarchy: Hierarchy, start: Result | None) -> Step:
        """Solve, estimate and store a step; a load path does not begin with ``start``."""
        number = len(self.done)
        last = self.done[-1] if self.done else None
        parts = self.parts
        path = None
        self._report("solve", hierarchy.finest.n_nodes)
        with once(self.warned_kinds), self.clock.phase("solve"):
            if parts.load_path is None:
                result = solved(hierarchy, parts.solver, start, parts.rtol)
            else:
                path = self._solve_path(hierarchy, number, last)
                result = path[-1]
        self._report("estimate", hierarchy.finest.n_nodes)
        with self.clock.phase("estimate"):
            if path is None:
                estimate = estimate_of(parts.indicator, hierarchy, result)
            else:
                k, estimate, self.steering = _path_estimate(hierarchy, parts, path, number)
                result = path[k]
        work = result.work_units if path is None else sum(step.work_units for step in path)
        timings = self.clock.timings
        self.clock.timings = {}
        # totals of the steps before; their work in passes over the finest matrix of this step
        seconds_before = 0.0 if last is None else last.total_seconds
        work_before = 0.0
        if last is not None:
            entries = last.total_work_units * last.hierarchy.finest.nonzeros
            work_before = entries / hierarchy.finest.nonzeros
        step = Step(
            number=number,
            hierarchy=hierarchy,
            result=result,
            estimate=estimate,
            timings=timings,
            total_seconds=sum(timings.values()) + seconds_before,
            work_units=work,
            total_work_units=work + work_before,
            path=path,
            settled=settled(estimate, None if last is None else last.estimate),
        )
        with self.clock.phase("store"):
            if self.store is not None:
                self.store.put(number, result, StoredStep.of(step))
        self._remember(step)
        return step

    def _solve_path(self, hierarchy: Hierarchy, number: int, last: Step | None) -> PathResult:
        """Return the load steps of mesh ``number``, from the state of the last one if the path goes
        on from mesh to mesh."""
        parts = self.parts
        solver = parts.solver
        if solver is None:
            solver = FullMultigrid(rtol=RTOL if parts.rtol is None else parts.rtol)
        # a first mesh has one level, which multigrid cannot use: solve_path then chooses the method
        solver = solver if _applies(solver, hierarchy) else None
        rtol = parts.rtol if solver is None else None
        start = None
        if last is not None and parts.remesh_every is not None:
            reached = cast("PathResult", last.path)[-1]
            start = transfer_state(last.hierarchy, reached, hierarchy)
        return solve_path(hierarchy, parts.path_of(number), solver, rtol=rtol, start=start)

    def _steering(self, last: Step) -> Estimate:
        """Return the estimate by which the next mesh is made: that of the last step, or one for all load
        steps of its path. Steps from a store come before all that are solved, so that ``steering`` is
        of the last step, or there is none yet."""
        if last.path is None or self.parts.adapt_on == "last":
            return last.estimate
        if self.steering is None:  # the step is from a store
            _, _, self.steering = _path_estimate(last.hierarchy, self.parts, last.path, last.number)
        return self.steering

    def _restored(self, number: int, step: Stored) -> Step:
        """Return a step made of its record in the store."""
        stored: StoredStep = step.more
        # bisection goes on from the history, which only the record has
        finest = with_refinement(need_mesh(step.value), stored.history)
        last = self.done[-1] if self.done else None
        before = self.first if last is None else last.hierarchy
        hierarchy = restored(before, [*stored.levels[:-1], finest])
        return Step(
            number=number,
            hierarchy=hierarchy,
            # with the mesh of the hierarchy, which is the same as that in the file
            result=replace(step.value, mesh=hierarchy.finest.mesh),
            estimate=stored.estimate,
            timings=stored.timings,
            path=stored.path,
            settled=settled(stored.estimate, None if last is None else last.estimate),
            **cast("Any", stored.numbers),  # names of seconds and work units
        )

    def _remember(self, step: Step) -> None:
        """Append a step that is finished, and report it."""
        self.done.append(step)
        self._report("done", step.nodes)
        _LOG.debug("%s", step)

    def _report(self, phase: str, nodes: int) -> None:
        """Call ``progress`` with a row on a phase of the step."""
        if self.progress is None:
            return
        last = self.done[-1] if self.done else None
        seconds = sum(self.clock.timings.values()) + (0.0 if last is None else last.total_seconds)
        self.progress(
            {
                # a step that is done is among ``done``
                "step": len(self.done) - (phase == "done"),
                "phase": phase,
                "nodes": nodes,
                "seconds": seconds,
                "estimate": float("nan") if last is None else last.estimate.relative,
            }
        )


def solved(
    hierarchy: Hierarchy, solver: Solver | None, start: Result | None, rtol: float | None
) -> Result:
    """Return the solution on the finest level; ``rtol`` is that of the default method."""
    if solver is None or not _applies(solver, hierarchy):
        if len(hierarchy) == 1:
            solver = None if rtol is None else ActiveSet(rtol=rtol)
        else:
            method = FullMultigrid if start is None else Multigrid
            solver = method(rtol=RTOL if rtol is None else rtol)
    # FullMultigrid makes its own start
    return solve(hierarchy, solver, start=None if isinstance(solver, FullMultigrid) else start)


def _applies(solver: Solver, hierarchy: Hierarchy) -> bool:
    """Return whether a solver can be used: multigrid needs two levels."""
    return len(hierarchy) > 1 or not isinstance(solver, Multigrid)


#: largest local size ratio (its 99 % quantile) between neighbours, also where a level could be dropped:
#: half makes 46 % more work in 10 loops with 8 % fewer cycles, twice 14 % less with 6 % more
RATIO = 4.5
#: nodes of a level over those of the next coarser one below which the two are too close: 1.35 and 2.4
#: make 1 % more and 2 % less work in 8 loops with small steps (theta .15), without it 150 % more with
#: 18 % fewer cycles
CLOSE = 1.7
#: meshes put between two neighbours at most
MOST_BETWEEN = 4


def appended(hierarchy: Hierarchy, mesh: MeshArrays, engine: Engine) -> Hierarchy:
    """Return the hierarchy with a finer mesh, and meshes between it and the present finest where
    the size ratio asks for them."""
    between = cast("Any", getattr(engine, "intermediate", None))
    for _ in range(MOST_BETWEEN if callable(between) else 0):
        finest = need_mesh(hierarchy.finest)
        if size_ratio(finest, mesh) <= RATIO:
            break
        middle = between(hierarchy.problem, finest, mesh)
        if middle is not None:
            middle = sound_mesh(engine, "intermediate", hierarchy.problem, middle, finest)
        # not worth making with about as many nodes as one of its neighbours
        if middle is None or not (
            LEAST_GROWTH * finest.n_nodes <= middle.n_nodes <= mesh.n_nodes / LEAST_GROWTH
        ):
            break
        hierarchy = hierarchy.append(middle)
    return on_coarser_levels(hierarchy, mesh)


def on_coarser_levels(hierarchy: Hierarchy, mesh: MeshArrays) -> Hierarchy:
    """Return the levels with fewer nodes than a mesh, and the mesh as the finest one. Between load steps a
    mesh may have as many nodes as the one before, or fewer."""
    n_coarser = sum(level.n_nodes < mesh.n_nodes for level in hierarchy)
    if n_coarser == 0:
        return Hierarchy.from_meshes(
            hierarchy.problem, [mesh], hierarchy.transfer, hierarchy.contact_rows
        )
    if n_coarser < len(hierarchy):
        hierarchy = hierarchy.truncated(finest=n_coarser - 1)
    return hierarchy.append(mesh)


def thinned(hierarchy: Hierarchy, last: bool = False) -> Hierarchy:
    """Return the hierarchy without the levels next to the finest that are too close to their
    neighbours and not needed. Before the ``last`` mesh a single level that is too close stays: its
    cycles cost less than to set up others without it."""
    if last and (len(hierarchy) < 3 or hierarchy[-2].n_nodes >= CLOSE * hierarchy[-3].n_nodes):
        return hierarchy
    for level in (len(hierarchy) - 2, len(hierarchy) - 3):
        if level < 1:
            break
        finer = hierarchy[level + 1]
        middle = hierarchy[level]
        too_close = finer.n_nodes < CLOSE * middle.n_nodes
        if too_close and size_ratio(need_mesh(hierarchy[level - 1]), need_mesh(finer)) <= RATIO:
            hierarchy = hierarchy.without(level)
    return hierarchy


def carried(hierarchy: Hierarchy, below: int, result: Result) -> Result:
    """Return the result of level number ``below`` with displacement and pressures interpolated to the
    finest one, level by level."""
    values = hierarchy[below].discrete.relative(result.displacement)
    pressures = result.pressures
    for coarse, level in pairwise(hierarchy.levels[below:]):
        values = level.prolongation @ values
        pressures = prolonged_pressures(
            coarse.discrete, level.discrete, level.prolongation, pressures
        )
    return replace(
        result, displacement=hierarchy.finest.discrete.physical(values), pressures=pressures
    )


def posed_at(hierarchy: Hierarchy, path: LoadPath, results: PathResult, k: int) -> Hierarchy:
    """Return the hierarchy with the problem of load step ``k`` of a path on the finest level, slips counted
    from the step before; ``results`` are those of the path up to there."""
    factors = {name: float(values[k]) for name, values in path.resolved(hierarchy.problem).items()}
    discrete = hierarchy.finest.discrete
    loads = load_steps(cast("Posed", hierarchy.posed), discrete)
    reference = discrete.contact.slip_reference
    slips = discrete.contact.accumulated_slip
    if k > 0:
        slips = results[k - 1].contact.accumulated_slip
        reference = discrete.at_contact(discrete.relative(results[k - 1].displacement).reshape(-1))
    finest = hierarchy.finest.posing(discrete=loads.step(discrete, factors, reference, slips))
    problem = step_problem(hierarchy.problem, factors)
    return replace(hierarchy, levels=(*hierarchy.levels[:-1], finest), problem=problem)


def _path_estimate(
    hierarchy: Hierarchy, parts: LoopParts, results: PathResult, number: int
) -> tuple[int, Estimate, Estimate]:
    """Return the number and the estimate of the last load step, or of the one with the largest relative
    estimate, and the estimate by which mesh ``number`` is refined.

    Of several load steps each element counts with its largest share in the relative estimate of any
    step: a mesh made for one step alone is too coarse where others need it, and the loop would
    alternate between them."""
    steps = range(len(results)) if parts.adapt_on == "worst" else (len(results) - 1,)
    estimates = {
        k: estimate_of(
            parts.indicator,
            posed_at(hierarchy, parts.path_of(number), results, k),
            results[k],
        )
        for k in steps
        if parts.adapt_on == "last" or results[k].displacement.any()
    }
    if not estimates:
        raise ValueError(
            "load_path: nothing moves in any of its steps, so there is nothing to refine for"
        )
    k = max(estimates, key=lambda k: estimates[k].relative)
    # the squares of each step over their sum, times the square of its relative estimate, which is infinite
    # for a quantity that is zero: above 1 all steps count alike
    shares = [
        min(estimate.relative, 1.0) ** 2 / (estimate.squares.sum() or 1.0) * estimate.squares
        for estimate in estimates.values()
    ]
    return k, estimates[k], replace(estimates[k], squares=np.max(shares, axis=0))


#: what the file of a step holds; user-defined estimates come back as Estimate
LOOP_KINDS = (*KINDS, StoredStep, GoalEstimate, Estimate, PathResult, Refinement)


def loop_fingerprint(
    start: Hierarchy,
    options: Mapping[str, object],
    load_path: LoadPath | None = None,
    depends: Mapping[str, object] | None = None,
) -> dict[str, object]:
    """Return the fingerprint of a loop that begins with a hierarchy, with its options by name:
    indicator, mark, engine, ..."""
    loads = [
        whole_load(level.discrete) if posed is None else load_steps(posed, level.discrete)
        for level, posed in zip(start.levels, map(start.posed_on, start.levels), strict=True)
    ]
    factors = {} if load_path is None else load_path.resolved(start.problem)
    # the problem itself, since another law or gap may differ only between the nodes of the first
    # mesh; references only document it
    posed = {
        part.name: getattr(start.problem, part.name)
        for part in fields(start.problem)
        if part.name != "reference"
    }
    return fingerprint(
        start,
        loads,
        factors,
        0 if load_path is None else len(load_path),
        posed | dict(options),
        depends,
    )


def restored(before: Hierarchy, meshes: Sequence[MeshArrays]) -> Hierarchy:
    """Return the hierarchy of a stored step, which has these meshes, made of that of the step
    before: levels are appended and dropped."""
    stored = [_key(mesh) for mesh in meshes]
    present = [_key(need_mesh(level)) for level in before.levels]
    for key, mesh in zip(stored, meshes, strict=True):
        if key not in present:
            before = on_coarser_levels(before, sound_by_construction(check_mesh(mesh)))
            present = [_key(need_mesh(level)) for level in before.levels]
    for level in reversed([k for k, key in enumerate(present) if key not in stored]):
        before = before.without(level)
    return before


def _key(mesh: MeshArrays) -> bytes:
    """Return a hash of the points and elements of a mesh."""
    return hashlib.sha256(mesh.points.tobytes() + mesh.elements.tobytes()).digest()
