r"""solve_path: quasi-static load histories, step by step.

Friction acts on increments: at step k the slip is :math:`u_t^k - u_t^{k-1}`, against the
displacement of the step before (implicit Euler; no time occurs). Every step is a contact problem
with other loads, prescribed values and slip references; matrices and transfers stay. The truncated
multigrid keeps its set-up (:mod:`adaptmg.solver.load_steps`); all other methods start from the
better of the displacement of the step before and the one extrapolated in the loads, which under
proportional loading is the solution. A FullMultigrid with another correction goes on as a
Multigrid."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, cast, overload

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import make_folder
from adaptmg._text import html_table, in_html_lines, say, shortened
from adaptmg._threads import one_blas_thread
from adaptmg._units import in_units
from adaptmg.discrete.named_loads import LoadSteps, load_steps, whole_load
from adaptmg.discrete.obstacles import check_held, moved
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import StressData
from adaptmg.hierarchy import Hierarchy
from adaptmg.level import Level
from adaptmg.problem.load_path import LoadPath
from adaptmg.solver.advice import advise_on_chords, advise_on_problem, advise_on_results, once
from adaptmg.solver.closed_forms import free_bodies
from adaptmg.solver.examine import Examiner
from adaptmg.solver.iterate import StopTest
from adaptmg.solver.load_steps import (
    Controls,
    Past,
    coarse_displacements,
    step_outcome,
)
from adaptmg.solver.multigrid import Multigrid, handed_over
from adaptmg.solver.outcome import (
    checked_outcome,
    grids_argument,
    method_argument,
    result_of,
)
from adaptmg.solver.record import Outcome, Run, Solver, Status
from adaptmg.solver.result import KINDS, NotConverged, Result
from adaptmg.solver.statics import check_statics_of, warn_of_several_solutions
from adaptmg.solver.store import StepStore, damage, fingerprint
from adaptmg.solver.truncated import TruncatedRun

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, eq=False, repr=False)
class PathResult(Sequence[Result]):
    """The steps of a load path, in order.

    Attributes
    ----------
    results : tuple of Result
        The finished steps; where a step did not converge it is the last one.
    factors : dict of str to (n_steps,) array
        Factors of all steps of the path, by the name of the load; "default" where loads have no
        names.
    fingerprint : dict
        What the path was solved for, see :mod:`adaptmg.solver.store`; empty without a store.
    n_steps : int
        Steps of the whole path.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> steps = am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0]}))
    >>> len(steps), steps.complete
    (2, True)
    """

    results: tuple[Result, ...]
    factors: Mapping[str, np.ndarray]
    fingerprint: Mapping[str, object] = field(default_factory=dict)
    n_steps: int = 0

    @property
    def complete(self) -> bool:
        """Return whether all steps of the path were solved to their tolerance."""
        return len(self.results) == self.n_steps and all(
            result.status.ok for result in self.results
        )

    def __len__(self) -> int:
        return len(self.results)

    @overload
    def __getitem__(self, index: int) -> Result: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Result, ...]: ...

    def __getitem__(self, index: int | slice) -> Result | tuple[Result, ...]:
        return self.results[index]

    def __repr__(self) -> str:
        return shortened(str(self))

    def _repr_html_(self) -> str:
        return in_html_lines(str(self).partition("\n")[0]) + html_table(self.table())

    def __str__(self) -> str:
        about = (
            f" of {self.results[0].solver_name} for {self.results[0].problem_name}"
            if self.results
            else ""
        )
        lines = [
            f"PathResult{about}: {len(self)} of {self.n_steps} steps",
            f"{'step':>4} {'status':>9} {'cycles':>6} {'seconds':>8} {'open':>6} {'slip':>6} {'stick':>6}  "
            "factors",
        ]
        for k, result in enumerate(self.results):
            n = result.contact.counts()
            factors = ", ".join(f"{name} {values[k]:g}" for name, values in self.factors.items())
            lines.append(
                f"{k:>4} {result.status.name:>9} {result.cycles:>6} {result.seconds:>8.3g} {n['open']:>6} "
                f"{n['slip']:>6} {n['stick']:>6}  {factors}"
            )
        return "\n".join(lines)

    def table(self, units: str | None = None) -> pandas.DataFrame:
        """Return one row a step, with units in the heads; ``units`` as of
        :meth:`adaptmg.solver.ContactResult.table`.

        step; "factor NAME" for each load; status; cycles; work_units; seconds; residual (natural,
        relative); open, slip and stick (contact nodes); "force_x [N]", ... (plane problems: [N/m]):
        resultant of the contact forces; "pressure [Pa]": the largest contact pressure; "slip_size
        [m]": the largest slip of the step at a node in contact; "slip_path [m]": the largest of
        :meth:`slip_path`."""
        import pandas

        rows = []
        paths = self.slip_path()
        for k, result in enumerate(self.results):
            force = result.resultant("contact").force
            c = result.contact
            slips = np.linalg.norm(c.slip, axis=1)[c.closed]
            rows.append(
                {"step": k}
                | {f"factor {name}": values[k] for name, values in self.factors.items()}
                | {
                    "status": result.status.name,
                    "cycles": result.cycles,
                    "work_units": result.work_units,
                    "seconds": result.seconds,
                    "residual": result.residual,
                }
                | c.counts()
                | {
                    f"force_{'xyz'[d]} [{c.units[0]}]": float(value)
                    for d, value in enumerate(force)
                }
                | {
                    "pressure [Pa]": result.max_pressure,
                    "slip_size [m]": float(slips.max(initial=0.0)),
                    "slip_path [m]": float(paths[k].max(initial=0.0)),
                }
            )
        return in_units(pandas.DataFrame(rows), units)

    def slip_path(self) -> np.ndarray:
        """Return how far each contact node has slipped so far (n_steps, n_contact), m; back and
        forth add up.

        The sum of ``|slip|`` over the steps after which it is in contact.
        """
        ways = [way_in_contact(result) for result in self.results]
        return np.cumsum(ways, axis=0) if ways else np.zeros((0, 0))

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write a file a step, and the factors; ValueError if the folder holds steps already."""
        target = checks.file_path("folder", folder)
        make_folder("folder", target)
        # the norms distinguish paths of the same factors
        norms = [float(np.linalg.norm(result.displacement)) for result in self.results]
        store = StepStore(
            target, _HEAD, _head(self.factors, self.n_steps, self.fingerprint, norms), KINDS
        )
        if not store.empty:
            raise ValueError(
                f"{target} holds a load path already: give another folder, or remove it"
            )
        for k, result in enumerate(self.results):
            store.put(k, _stored(k, result))
        store.write_head()

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> PathResult:
        """Read what :meth:`save` wrote, or the steps that :func:`adaptmg.solve_path` has stored so
        far.

        ValueError if the folder holds no load path, or a file in it is damaged, missing, or of
        another path or step."""
        store = StepStore.read(checks.file_path("folder", folder), _HEAD, KINDS)
        with damage(store.file):
            steps = checks.integer("steps", store.head["steps"])
            factors = {
                name: checks.vector(f"factors[{name!r}]", values, steps)
                for name, values in checks.instance("factors", store.head["factors"], dict).items()
            }
        return cls(
            tuple(result for result, _ in _results(store, steps)),
            factors,
            store.head["fingerprint"],
            steps,
        )


def way_in_contact(result: Result) -> np.ndarray:
    """Return the lengths of the slips of a step (n_contact,), m, at nodes that it leaves in
    contact."""
    return np.linalg.norm(result.contact.slip, axis=1) * result.contact.closed


_HEAD = "path.json"


def _head(
    factors: Mapping[str, np.ndarray],
    steps: int,
    fingerprint: Mapping[str, object],
    norms: Sequence[float] = (),
) -> dict[str, object]:
    return {
        "steps": steps,
        "factors": {name: list(map(float, values)) for name, values in factors.items()},
        "norms": list(norms),
        "fingerprint": dict(fingerprint),
    }


def _stored(k: int, result: Result) -> Result:
    return result if k == 0 else replace(result, mesh=None)


def _results(store: StepStore, steps: int) -> list[tuple[Result, list[np.ndarray] | None]]:
    """The results, and the displacements of coarse levels that were stored with them."""
    stored = list(store.steps())
    if len(stored) > steps:
        raise ValueError(
            f"{store.folder / f'step_{steps:04d}.npz'} is not a step of this path, which has {steps}: "
            "remove it"
        )
    return [(replace(step.value, mesh=stored[0].value.mesh), step.more) for step in stored]


class StepNotConverged(NotConverged):
    """Raised by :func:`adaptmg.solve_path` when a step did not reach its tolerance.

    Attributes
    ----------
    result : Result
        The last iterate of the step.
    step : int
        Its number, from 0.
    described : str
        Its factors.
    partial : PathResult
        The steps before it, and the step.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> try:
    ...     am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0]}), am.SingleGrid(max_sweeps=1))
    ... except am.solver.StepNotConverged as error:
    ...     error.step, len(error.partial)
    (0, 1)
    """

    def __init__(self, result: Result, step: int, described: str, partial: PathResult) -> None:
        super().__init__(result)
        self.step = step
        self.described = described
        self.partial = partial
        self.args = (
            f"step {step} of {partial.n_steps} ({described}): {self.args[0]} Smaller load steps help where "
            "the contact status changes much; the steps before it are in .partial.",
        )

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.result, self.step, self.described, self.partial)


@once()
@one_blas_thread()
def solve_path(
    grids: Hierarchy | DiscreteProblem,
    path: LoadPath,
    solver: Solver | None = None,
    *,
    rtol: float | None = None,
    store: str | os.PathLike[str] | None = None,
    depends: Mapping[str, object] | None = None,
    throw: bool = True,
    callback: Callable[[int, Result], None] | None = None,
    progress: Callable[[int, dict[str, float]], None] | bool | None = None,
) -> PathResult:
    """Solve a contact problem along a load path on the finest level of a hierarchy.

    Parameters
    ----------
    grids : Hierarchy or DiscreteProblem
        A bare DiscreteProblem is a hierarchy of one level; its loads have no names, so that
        ``path`` has ``default`` alone.
    path : LoadPath
    solver : SingleGrid, Multigrid, FullMultigrid, ActiveSet or user-defined, optional
        The default is that of :func:`adaptmg.solve`. ``rtol`` refers to the whole displacement of a
        step; "discretisation" sets it once, in the first step. Multigrid with
        :class:`adaptmg.Truncated` is set up once.
    rtol : float, optional
        Tolerance of the default solver, where none is given; default as of :func:`adaptmg.solve`.
    store : path, optional
        A folder where every finished step is kept immediately. A path that was interrupted goes on
        there; a folder with steps of another problem, hierarchy, path or solver is refused. A
        user-defined solver is compared by its code and the values that it reads.
    depends : mapping of str to value, optional
        For the store: values that stand for what cannot be compared (an open file, a generator of
        random numbers), by the name of the variable that is read, or "solver".
    throw : bool
        Raise :class:`StepNotConverged` if a step does not reach the tolerance. False ends the path
        with that step, whose status says it; ``complete`` is then False.
    callback : callable, optional
        Called with the number and the Result of each step when it is finished, and kept.
    progress : callable or bool, optional
        Called with the number of the step and each row of its history. True: write a line a step to
        standard error.

    Raises
    ------
    ValueError
        Bad input, or a rigid motion that neither supports nor contact hold in a step.
    StepNotConverged

    Warns
    -----
    UserWarning, RuntimeWarning
        As :func:`adaptmg.solve`, once for the whole path.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> steps = am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0, 0.0]}))
    >>> len(steps)
    3
    """
    checks.instance("path", path, LoadPath, "a LoadPath")
    grids, solver, choice = method_argument(solver, grids_argument(grids), rtol)
    checks.flag("throw", throw)
    checks.optional_callable("callback", callback, "the number and Result of a step")
    if not isinstance(progress, bool):
        checks.optional_callable(
            "progress", progress, "the number of a step and a row of its history (or a bool)"
        )
    if depends is not None:
        checks.mapping("depends", depends, "names to what stands for them")
    loop = _loop(grids, path, solver)
    parts: dict[str, object] = {"solver": solver}
    if grids.finest.discrete.inelastic:
        parts["material"] = grids.problem.material
    mark = (
        {}
        if store is None
        else fingerprint(grids, loop.loads, loop.factors, len(path), parts, depends)
    )
    if store is not None and (obstacles := loop.controls.posed()):
        mark["obstacles and preloads"] = obstacles
    steps = (
        None
        if store is None
        else StepStore.resumed(store, _HEAD, _head(loop.factors, len(path), mark), KINDS)
    )
    results: list[Result] = []
    for result, coarse in () if steps is None else _results(steps, len(path)):
        loop.take_over(len(results), result, coarse)
        results.append(result)
    if len(results) < len(path):
        warn_of_several_solutions(grids)
        advise_on_problem(grids.posed)
    for k in range(len(results), len(path)):
        result = loop.step(k, progress if callable(progress) else None)
        result = replace(result, choice=choice)
        if progress is True:
            say(loop.report(k, result))
        results.append(result)
        if not result.status.ok:
            partial_result = PathResult(tuple(results), loop.factors, mark, len(path))
            if throw:
                raise StepNotConverged(result, k, loop.described(k), partial_result)
            return partial_result
        if steps is not None:
            steps.put(k, _stored(k, result), loop.coarse)
        if callback is not None:
            callback(k, result)
    advise_on_results(grids.posed, results)
    advise_on_chords(grids.posed, grids.finest.discrete, results)
    return PathResult(tuple(results), loop.factors, mark, len(path))


def _loop(grids: Hierarchy, path: LoadPath, solver: Solver) -> PathLoop:
    """Return the loop of a path, whose bodies may be plastic."""
    if not grids.finest.discrete.inelastic:
        return PathLoop(grids, path, solver)
    from adaptmg.evolution.plastic import PlasticLoop

    return PlasticLoop(grids, path, solver)


_LOG = logging.getLogger(__name__)


class PathLoop:
    """The steps of a path."""

    def __init__(self, grids: Hierarchy, path: LoadPath, solver: Solver) -> None:
        self.grids = grids
        self.path = path
        self.solver = solver
        self.posed = _posed_with_names(grids)
        problem = None if self.posed[-1] is None else grids.problem
        self.factors = path.resolved(problem)
        self.finest_loads = _loads(self.posed[-1], grids.finest)
        coarse = zip(self.posed[:-1], grids.levels[:-1], strict=True)
        #: None where a level is only a space
        self.loads = [
            None if level.discrete_or_none is None else _loads(posed, level)
            for posed, level in coarse
        ]
        self.loads.append(self.finest_loads)
        for k in range(len(path)):
            # two supports that no longer agree should show before the first step is solved
            self.finest_loads.fixed_values(self._factors_at(k))
        finest = grids.finest
        self.bodies = free_bodies(self.posed[-1], finest.discrete)
        self.examiner = Examiner(finest.discrete, self.bodies)
        #: the solver with the tolerance of the steps, and what its truncated multigrid has set up
        self.step_solver = solver
        self.multigrid: TruncatedRun | None = None
        self.controls = Controls(problem, grids.finest)
        #: displacements of the last step on the levels; the method has those of coarse ones, or they are interpolated
        self.levels = [
            np.zeros(level.discrete.n_dofs)
            for level in grids.levels[0 if grids.discretised else -1 :]
        ]
        self.coarse: list[np.ndarray] | None = None
        #: (n_contact,): length of the slips so far, m, which the law may see
        self.accumulated_slip = finest.discrete.contact.accumulated_slip
        #: the solutions of the last two steps, and the forces that led there
        self.recent = [(np.zeros(finest.discrete.n_unknowns), np.zeros(finest.discrete.n_dofs))]

    @property
    def _limit(self) -> float:
        """The cycles, steps or sweeps that the solver may take."""
        limits = (
            getattr(self.solver, name, None) for name in ("max_cycles", "max_steps", "max_sweeps")
        )
        return next((limit for limit in limits if limit is not None), np.inf)

    def described(self, k: int) -> str:
        """Return the factors of a step as text."""
        return ", ".join(f"{name}={factor:g}" for name, factor in self._factors_at(k).items())

    def _factors_at(self, k: int) -> dict[str, float]:
        return {name: float(values[k]) for name, values in self.factors.items()}

    def step(self, k: int, progress: Callable[[int, dict[str, float]], None] | None) -> Result:
        factors = self._factors_at(k)
        parts = self.controls.unknowns(factors)
        motions = self.controls.motions
        if parts:
            self._check_statics(k, self._posed(k, motions))
            result, (grids, forces, coarse), motions = self.controls.find(
                parts,
                lambda motions, near, loose: self._solve(k, motions, near, progress, loose),
                partial(self._posed, k),
                self._limit,
            )
            self._check_held(grids, k, motions)
        else:
            result, (grids, forces, coarse) = self._solve(k, motions, None, progress, 0.0)
        result = replace(
            result,
            motions={name: motion.tolist() for name, motion in motions.items()},
        )
        self.controls.take(factors, motions)
        self._remember(grids, result, forces, coarse)
        _LOG.info(self.report(k, result))
        return result

    def _solve(
        self,
        k: int,
        motions: Mapping[str, np.ndarray],
        near: Result | None,
        progress: Callable[[int, dict[str, float]], None] | None,
        loose: float,
    ) -> tuple[Result, tuple[Hierarchy, np.ndarray, list[np.ndarray] | None]]:
        """The result of step k with the motions of obstacles, from one ``near`` to it; and what the
        next step needs. The tolerance may be as ``loose``."""
        finest = self.grids.finest.discrete
        callback = None if progress is None else partial(progress, k)
        run = Run(unit=finest.matrix.nnz, callback=callback)
        with run.phase("setup"):
            grids = self._posed(k, motions)
            if (
                not self.controls.rigid
            ):  # these move until their forces fit, and may go too far on the way
                self._check_held(grids, k, motions)
            forces = grids.finest.discrete.load_from_prescribed()
            run.examiner = self.examiner = Examiner(grids.finest.discrete, self.bodies)
            past = Past(
                self.levels,
                self.recent[-1][0],
                self._start(forces, near),
                len(self.recent) > 1,
                near is not None,
                loose,
            )
        with run.phase("statics"):
            self._check_statics(k, grids)
        if self._at_rest(forces):
            return self._undeformed(k, grids, run, motions), (grids, forces, None)
        outcome, self.multigrid, coarse = step_outcome(
            self.step_solver, self.multigrid, grids, self.examiner, run, past
        )
        outcome = checked_outcome(outcome, self.solver, grids.finest.discrete)
        self._hold(outcome.rtol)
        outcome = handed_over(outcome, grids, run)
        with run.phase("result"):
            result = result_of(
                grids, self.examiner, run, outcome, self.solver, self._stress_data(k, motions)
            )
        return result, (grids, forces, coarse)

    def _hold(self, rtol: float) -> None:
        """Keep the tolerance that the discretisation error of the first step has set: increments
        have smaller ones."""
        if getattr(self.step_solver, "rtol", None) == "discretisation":
            least = max(rtol, StopTest.ROUNDING_LIMIT)
            self.step_solver = replace(cast("Multigrid", self.step_solver), rtol=least)

    def _check_statics(self, k: int, grids: Hierarchy) -> None:
        try:
            check_statics_of(grids)
        except ValueError as error:
            raise ValueError(
                f"step {k} of {len(self.path)} ({self.described(k)}): {error}"
            ) from error

    def _check_held(self, grids: Hierarchy, k: int, motions: Mapping[str, np.ndarray]) -> None:
        posed = self.posed[-1]
        if posed is not None:
            factors = self._loading(k, motions)
            places = self.controls.placed(factors, motions)
            check_held(posed, grids.finest.discrete, factors, places)

    def report(self, k: int, result: Result) -> str:
        """Return how a step ended, as text."""
        return (
            f"step {k} of {len(self.path)} ({self.described(k)}): {result.status.name} after {result.cycles} "
            f"cycles and {result.seconds:.2g} s"
        )

    def take_over(self, k: int, result: Result, coarse: list[np.ndarray] | None) -> None:
        """Go past a step that was solved before."""
        motions = {name: np.array(motion) for name, motion in result.motions.items()}
        grids = self._posed(k, motions)
        if result.displacement.shape != (grids.finest.n_nodes, grids.finest.discrete.dim):
            raise ValueError(
                f"step {k} in the store has {len(result.displacement)} nodes, the finest level "
                f"{grids.finest.n_nodes}"
            )
        if result.displacement.any():
            self._hold(result.rtol)
        self.controls.take(self._factors_at(k), motions)
        self._remember(grids, result, grids.finest.discrete.load_from_prescribed(), coarse)

    def _at_rest(self, forces: np.ndarray) -> bool:
        """Return whether nothing acts, and the undeformed bodies are a solution; ``forces`` is b -
        A u_fixed."""
        contact = self.examiner.contact
        quiet = not (forces.any() or self.examiner.discrete.fixed_values.any())
        slid = np.abs(contact.slip_reference).any(axis=1)
        return quiet and bool((contact.gap >= 0).all()) and not contact.limit[slid].any()

    def _loading(self, k: int, motions: Mapping[str, np.ndarray]) -> dict[str, float]:
        """Factors of all loads: those of preloads are strains."""
        bolts = {bolt.path_name: float(motions[bolt.path_name][0]) for bolt in self.controls.bolts}
        return self._factors_at(k) | bolts

    def _stress_data(self, k: int, motions: Mapping[str, np.ndarray]) -> StressData | None:
        return self.finest_loads.stress_data(self._loading(k, motions))

    def _undeformed(
        self, k: int, grids: Hierarchy, run: Run, motions: Mapping[str, np.ndarray]
    ) -> Result:
        """The result of a step in which nothing acts: no method could tell the relative error of
        its iterates."""
        rtol = getattr(self.solver, "rtol", None)
        outcome = Outcome(
            np.zeros(grids.finest.discrete.n_unknowns),
            Status.CONVERGED,
            0,
            float(rtol) if isinstance(rtol, float | int) else np.nan,
            error_estimate=0.0,
        )
        result = result_of(
            grids, self.examiner, run, outcome, self.solver, self._stress_data(k, motions)
        )
        # all forces vanish: a relative residual would be rounding over nothing
        return replace(result, status=Status.CONVERGED, residual=0.0)

    def _posed(self, k: int, motions: Mapping[str, np.ndarray]) -> Hierarchy:
        """Return the hierarchy with loads, prescribed values, places of obstacles and slip
        references of step k. Levels coarser than the solver's, or without a problem, stay as they
        are."""
        factors = self._loading(k, motions)
        levels = []
        places = self.controls.placed(factors, motions)
        n_unused = len(self.grids) - len(self.levels)  # coarsest levels
        parts = zip(self.grids.levels, self.loads, self.posed, strict=True)
        for number, (level, loads, posed) in enumerate(parts):
            if loads is not None and number >= n_unused:
                problem = level.discrete
                reference = level.discrete.contact.slip_reference
                if len(self.recent) > 1:
                    reference = problem.at_contact(self.levels[number - n_unused])
                # coarse levels make starts only: with the slips of the nearest fine nodes four paths
                # of ten steps take 253 cycles, without any 258
                slips = problem.contact.accumulated_slip
                if level is self.grids.finest:
                    slips = self.accumulated_slip
                step = loads.step(problem, factors, reference, slips)
                if posed is not None and places:
                    step = moved(posed, step, places, self.controls.places)
                level = level.posing(discrete=step)
            levels.append(level)
        return Hierarchy(
            tuple(levels), self.grids.problem, self.grids.origin, dict(self.grids.timings)
        )

    def _remember(
        self, grids: Hierarchy, result: Result, forces: np.ndarray, coarse: list[np.ndarray] | None
    ) -> None:
        discrete = grids.finest.discrete
        self.coarse = coarse
        # from the result, as a path that goes on from its store has it
        displacement = discrete.relative(result.displacement).reshape(-1)
        self.accumulated_slip = self.accumulated_slip + way_in_contact(result)
        solution = np.append(displacement, result.pressures)
        self.recent = [*self.recent[-1:], (solution, forces)]
        self.levels = (
            coarse_displacements(grids, displacement) if coarse is None else [*coarse, displacement]
        )

    def _start(self, forces: np.ndarray, near: Result | None) -> np.ndarray:
        """A start (n_unknowns,) for a step with these forces: a result near to it, or where all
        goes on as between the last two steps, least squares in the forces."""
        if near is not None:
            displacement = self.grids.finest.discrete.relative(near.displacement)
            return np.append(displacement, near.pressures)
        earlier, forces_earlier = self.recent[0]
        last, last_forces = self.recent[-1]
        change = last_forces - forces_earlier
        # not through BLAS, whose threads cost more than they gain
        size = float(np.einsum("i,i->", change, change))
        ratio = float(np.einsum("i,i->", forces - last_forces, change)) / size if size else 0.0
        return last + ratio * (last - earlier)


def _posed_with_names(grids: Hierarchy) -> list[Posed | None]:
    """Return the posed problem of each level; None for all unless every discretised level has a
    mesh."""
    posed = [grids.posed_on(level) for level in grids.levels]
    named = all(
        posed_level is not None or level.discrete_or_none is None
        for posed_level, level in zip(posed, grids.levels, strict=True)
    )
    return posed if named else [None] * len(posed)


def _loads(posed: Posed | None, level: Level) -> LoadSteps:
    """Return the loads and supports on a level one by one, without a problem as a whole."""
    return whole_load(level.discrete) if posed is None else load_steps(posed, level.discrete)
