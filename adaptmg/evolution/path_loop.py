"""PathLoop takes the steps of a load path, one after another, without a store.

The truncated multigrid keeps its set-up (:mod:`adaptmg.evolution.load_steps`); all other methods
start from the better of the displacement of the step before and the one extrapolated in the loads,
which under proportional loading is the solution. A FullMultigrid with another correction goes on as
a Multigrid."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import cast

import numpy as np

from adaptmg.discrete.named_loads import LoadSteps, load_steps, whole_load
from adaptmg.discrete.obstacles import check_held, moved
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import StressData
from adaptmg.evolution.load_steps import (
    Controls,
    Past,
    coarse_displacements,
    step_outcome,
)
from adaptmg.grids import Grids
from adaptmg.level import Level
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.multigrid.truncated_contact import with_fields
from adaptmg.problem.load_path import LoadPath
from adaptmg.solver.closed_forms import free_bodies
from adaptmg.solver.examine import Examiner
from adaptmg.solver.iterate import StopTest
from adaptmg.solver.multigrid import Multigrid, handed_over
from adaptmg.solver.outcome import checked_outcome, result_of
from adaptmg.solver.record import Outcome, Run, Solver, Status
from adaptmg.solver.result import Result
from adaptmg.solver.statics import check_statics_of
from adaptmg.solver.truncated import TruncatedRun

_LOG = logging.getLogger(__name__)


def is_on(result: Result, mesh: MeshArrays) -> bool:
    """Return whether a result is on a mesh, with the same numbers of nodes and elements."""
    own = result.mesh
    return (
        own is not None
        and np.array_equal(own.points, mesh.points)
        and np.array_equal(own.elements, mesh.elements)
    )


class PathLoop:
    """The steps of a load path, and what each step needs of the steps before it."""

    def __init__(self, grids: Grids, path: LoadPath, solver: Solver) -> None:
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
            _loads(posed, level) if level.discretised else None for posed, level in coarse
        ]
        self.loads.append(self.finest_loads)
        self.controls = Controls(problem, grids.finest)
        for k in range(len(path)):
            # supports that no longer agree, and forces that do not press, should show before the
            # first step is solved
            self.finest_loads.fixed_values(self._factors_at(k))
            self.controls.check_pressed(self._factors_at(k))
        finest = grids.finest
        self.bodies = free_bodies(self.posed[-1], finest.discrete)
        self.examiner = Examiner(finest.discrete, self.bodies)
        #: the solver with the tolerance of the steps, and what its truncated multigrid has set up
        self.step_solver = solver
        self.multigrid: TruncatedRun | None = None
        #: displacements (n_dofs,) after the last step on the levels that the method uses, coarsest first: it
        #: returns those of coarse levels, or they are found from the finest
        self.displacements = [
            np.zeros(level.discrete.n_dofs)
            for level in grids.levels[0 if grids.discretised else -1 :]
        ]
        #: the same after the step before, for extrapolation
        self.displacements_before = self.displacements
        #: displacements of coarse levels that the store keeps with the last step, None if it keeps none
        self.coarse: list[np.ndarray] | None = None
        #: whether the path goes on from a result under the loads of its first step
        self.continued = False
        #: (n_contact,): length of the slips so far, m, which the law may see
        self.accumulated_slip = finest.discrete.contact.accumulated_slip
        #: (n_nodes, dim): friction in the last step, N
        self.friction = np.zeros((finest.n_nodes, finest.discrete.dim))
        #: the solutions of the last two steps, and the factors that led there
        self.recent = [(np.zeros(finest.discrete.n_unknowns), np.zeros(len(self.factors)))]
        if not self.controls.motions:
            # a step that nothing holds should show before the first step is solved, too
            for k in range(len(path)):
                self._check_statics(k, self._posed(k, {}, only_ends=True))

    @property
    def _limit(self) -> float:
        """Return the number of cycles, steps or sweeps that the solver may take."""
        limits = (
            getattr(self.solver, name, None) for name in ("max_cycles", "max_steps", "max_sweeps")
        )
        return next((limit for limit in limits if limit is not None), np.inf)

    def described(self, k: int) -> str:
        """Return the factors of a step as text."""
        return ", ".join(f"{name}={factor:g}" for name, factor in self._factors_at(k).items())

    def _factors_at(self, k: int) -> dict[str, float]:
        """Return the factors of the loads in step k, by name."""
        return {name: float(values[k]) for name, values in self.factors.items()}

    def step(self, k: int, progress: Callable[[int, dict[str, float]], None] | None) -> Result:
        """Solve step k, with the motions of Rigid obstacles and preloads if there are any, and
        return its result; the next step goes on from it."""
        factors = self._factors_at(k)
        unknowns = self.controls.unknowns(factors)
        motions = self.controls.motions
        if unknowns:
            # once, and where they end; without unknowns each solve checks statics and held nodes itself
            self._check_statics(k, self._posed(k, motions, only_ends=True))
            result, (grids, coarse), motions = self.controls.find(
                unknowns,
                lambda motions, near, loose: self._solve(k, motions, near, progress, loose),
                partial(self._posed, k),
                factors == self.controls.factors,
                self._limit,
                # user-defined solvers may have none: inf limits nothing
                lambda: getattr(self.step_solver, "rtol", np.inf),
            )
            self._check_held(grids, k, motions)
        else:
            result, (grids, coarse) = self._solve(
                k, motions, near=None, progress=progress, loose=0.0
            )
        result = replace(
            result,
            motions={name: motion.tolist() for name, motion in motions.items()},
        )
        self.controls.take(factors, motions)
        self._remember(k, grids, result, coarse)
        _LOG.info(self.report(k, result))
        return result

    def _solve(
        self,
        k: int,
        motions: Mapping[str, np.ndarray],
        near: Result | None,
        progress: Callable[[int, dict[str, float]], None] | None,
        loose: float,
    ) -> tuple[Result, tuple[Grids, list[np.ndarray] | None]]:
        """Return the result of step k with these motions (3 or 6,) of obstacles and strains (1,) of
        preloads, by name as in :attr:`Controls.motions`, and what the next step needs: the hierarchy
        and the displacements (n_dofs,) of coarse levels, coarsest first, None without a nested start.
        The method starts from a result ``near`` to it, unless there is none; its tolerance may be as
        large as ``loose``."""
        run, grids, forces = self._set_up(k, motions, progress)
        run.examiner = self.examiner
        problem = grids.finest.discrete
        with run.phase("setup"):
            past = Past(
                level_displacements=self.displacements,
                extrapolated_level_displacements=self._extrapolated_displacements(k),
                last=with_values_of(problem, self.recent[-1][0]),
                extrapolated=with_values_of(problem, self._start(k, near)),
                has_previous=len(self.recent) > 1,
                is_start=near is not None,
                loose=loose,
            )
        if self.controls.motions:
            with run.phase("statics"):
                self._check_statics(k, grids)
        if self._at_rest(forces):
            return self._undeformed(k, grids, run, motions), (grids, None)
        outcome, self.multigrid, coarse = step_outcome(
            self.step_solver, self.multigrid, grids, self.examiner, run, past
        )
        outcome = checked_outcome(outcome, self.solver, problem)
        self._fix_tolerance(outcome.rtol)
        outcome = handed_over(outcome, grids, run)
        with run.phase("result"):
            result = result_of(
                grids, self.examiner, run, outcome, self.solver, self._stress_data(k, motions)
            )
        return result, (grids, coarse)

    def _set_up(
        self,
        k: int,
        motions: Mapping[str, np.ndarray],
        progress: Callable[[int, dict[str, float]], None] | None,
    ) -> tuple[Run, Grids, np.ndarray]:
        """Return the run of step k, its hierarchy with these motions of obstacles and preloads, and the
        forces b - A u_fixed (n_dofs,)."""
        callback = None if progress is None else partial(progress, k)
        run = Run(unit=self.grids.finest.nonzeros, callback=callback)
        with run.phase("setup"):
            grids = self._posed(k, motions)
            # Rigid obstacles move until their forces fit, and trial motions may go too far
            if not self.controls.rigid:
                self._check_held(grids, k, motions)
            self.examiner = Examiner(
                grids.finest.discrete, self.bodies, friction_before=self.friction
            )
            return run, grids, grids.finest.discrete.load_from_prescribed()

    def _fix_tolerance(self, rtol: float) -> None:
        """Give all steps the tolerance ``rtol`` that the discretisation error of the first one has
        set, if the solver asks for that: the errors of increments are smaller."""
        if getattr(self.step_solver, "rtol", None) == "discretisation":
            least = max(rtol, StopTest.ROUNDING_LIMIT)
            self.step_solver = replace(cast("Multigrid", self.step_solver), rtol=least)

    def _check_statics(self, k: int, grids: Grids) -> None:
        """Raise ValueError, which names step k, if a rigid motion is held by nothing."""
        try:
            check_statics_of(grids)
        except ValueError as error:
            raise ValueError(
                f"step {k} of {len(self.path)} ({self.described(k)}): {error}"
            ) from error

    def _check_held(self, grids: Grids, k: int, motions: Mapping[str, np.ndarray]) -> None:
        """Raise ValueError if supports hold nodes inside an obstacle in step k."""
        posed = self.posed[-1]
        if posed is not None:
            places = self.controls.placed(self._loading(k, motions), motions)
            check_held(posed, grids.finest.discrete, places)

    def report(self, k: int, result: Result) -> str:
        """Return how a step ended, as text."""
        return (
            f"step {k} of {len(self.path)} ({self.described(k)}): {result.status.name} after {result.cycles} "
            f"cycles and {result.seconds:.2g} s"
        )

    def take_over(self, k: int, result: Result, coarse: list[np.ndarray] | None) -> None:
        """Continue after a step that was solved before, with its result and the displacements (n_dofs,) of
        coarse levels, None if they are to be found from it."""
        motions = {name: np.array(motion) for name, motion in result.motions.items()}
        grids = self._posed(k, motions)
        if result.displacement.shape != (grids.finest.n_nodes, grids.finest.discrete.dim):
            raise ValueError(
                f"step {k} in the store has {len(result.displacement)} nodes, the finest level "
                f"{grids.finest.n_nodes}"
            )
        if result.displacement.any():
            self._fix_tolerance(result.rtol)
        self.controls.take(self._factors_at(k), motions)
        self._remember(k, grids, result, coarse)

    def continue_from(self, start: Result) -> None:
        """Begin at a result under the loads of the first step, which repeats them."""
        self.take_over(0, start, None)
        # its contact boundaries may be others
        slips = np.zeros(len(start.displacement))
        slips[start.contact.node] = start.contact.accumulated_slip
        self.accumulated_slip = slips[self.grids.finest.discrete.contact.nodes]
        self.continued = True

    def _at_rest(self, forces: np.ndarray) -> bool:
        """Return whether nothing acts, so that the undeformed bodies are a solution; ``forces``
        (n_dofs,) is b - A u_fixed."""
        contact = self.examiner.contact
        quiet = not (forces.any() or self.examiner.discrete.fixed_values.any())
        has_slipped = np.abs(contact.slip_reference).any(axis=1)
        # where bodies have slipped, a limit that does not depend on pressure still exerts friction
        return quiet and bool((contact.gap >= 0).all()) and not contact.limit[has_slipped].any()

    def _loading(self, k: int, motions: Mapping[str, np.ndarray]) -> dict[str, float]:
        """Return the factors of all loads by name; those of preloads are strains, from ``motions``."""
        bolts = {bolt.path_name: float(motions[bolt.path_name][0]) for bolt in self.controls.bolts}
        return self._factors_at(k) | bolts

    def _stress_data(self, k: int, motions: Mapping[str, np.ndarray]) -> StressData | None:
        """Return the stress data of step k; None if the levels have no meshes."""
        return self.finest_loads.stress_data(self._loading(k, motions))

    def _undeformed(
        self, k: int, grids: Grids, run: Run, motions: Mapping[str, np.ndarray]
    ) -> Result:
        """Return the result of step k, in which nothing acts: no method could estimate the relative
        error of its iterates. ``motions`` are those of obstacles (3,) or (6,) and strains of preloads
        (1,), by name."""
        # a user-defined solver may have none, and "discretisation" is measured in cycles, of which there are none
        rtol = getattr(self.solver, "rtol", None)
        outcome = Outcome(
            solution=np.zeros(grids.finest.discrete.n_unknowns),
            status=Status.CONVERGED,
            cycles=0,
            rtol=float(rtol) if isinstance(rtol, float | int) else np.nan,
            error_estimate=0.0,
        )
        result = result_of(
            grids, self.examiner, run, outcome, self.solver, self._stress_data(k, motions)
        )
        # all forces vanish: a relative residual would be rounding over nothing
        return replace(result, status=Status.CONVERGED, residual=0.0)

    def _posed(self, k: int, motions: Mapping[str, np.ndarray], only_ends: bool = False) -> Grids:
        """Return the hierarchy with loads, prescribed values, places of obstacles and slip
        references of step k. Levels coarser than the solver's, or without a problem, stay
        unchanged. With ``only_ends`` so do those between the coarsest level of the solver and the
        finest one: statics does not read them."""
        factors = self._loading(k, motions)
        levels = []
        places = self.controls.placed(factors, motions)
        # the coarsest levels, if the method uses the finest alone
        n_unused = len(self.grids) - len(self.displacements)
        ends = (n_unused, len(self.grids) - 1)
        parts = zip(self.grids.levels, self.loads, self.posed, strict=True)
        for number, (level, loads, posed) in enumerate(parts):
            if loads is not None and number >= n_unused and (number in ends or not only_ends):
                problem = level.discrete
                # slips count from the displacement after the last step; before the first step there is
                # none, and they count from the reference that the level was posed with
                reference = (
                    problem.at_contact(self.displacements[number - n_unused])
                    if len(self.recent) > 1
                    else problem.contact.slip_reference
                )
                # coarse levels make starts only: with the slips of the nearest fine nodes four paths
                # of ten steps take 253 cycles, without any 258
                slips = (
                    self.accumulated_slip
                    if level is self.grids.finest
                    else problem.contact.accumulated_slip
                )
                step = loads.step(problem, factors, reference, slips)
                if posed is not None and places:
                    step = moved(posed, step, places, self.controls.places)
                level = level.posing(discrete=step)
            levels.append(level)
        return with_fields(self.grids, levels=tuple(levels))

    def _remember(
        self, k: int, grids: Grids, result: Result, coarse: list[np.ndarray] | None
    ) -> None:
        """Keep what the next step needs of the result of step k, posed as in ``grids``, and of the
        displacements (n_dofs,) of coarse levels, None if they are to be found from it."""
        self.coarse = coarse
        # from the result, as a path that goes on from its store has it
        displacement = grids.finest.discrete.relative(result.displacement).reshape(-1)
        self.accumulated_slip = result.contact.accumulated_slip
        self.friction = np.zeros_like(result.displacement)
        contact = result.contact
        tangential = np.einsum("nj,nji->ni", contact.force_t, contact.frames[:, 1:])
        self.friction[contact.node] = tangential
        solution = np.append(displacement, result.pressures)
        self.recent = [*self.recent[-1:], (solution, self._factor_array(k))]
        self.displacements_before = self.displacements
        if coarse is None:
            # to find them takes a quarter of a path of Multigrid or ActiveSet with 4225 nodes. Guides for
            # the motions of obstacles read them, too
            are_read = self.controls.motions or getattr(self.solver, "reads_coarse_starts", True)
            found = coarse_displacements(grids, displacement) if are_read else self.displacements
            coarse = found[:-1]
        self.displacements = [*coarse, displacement]

    def _factor_array(self, k: int) -> np.ndarray:
        """Return the factors (n,) of the loads in step k."""
        return np.array(list(self._factors_at(k).values()))

    def _ratio(self, k: int) -> float:
        """Return the ratio of the change of the factors towards step k to their last change, by least
        squares."""
        last = self.recent[-1][1]
        change = last - self.recent[0][1]
        size = float(change @ change)
        return float((self._factor_array(k) - last) @ change) / size if size else 0.0

    def _start(self, k: int, near: Result | None) -> np.ndarray:
        """Return a start (n_unknowns,) for step k: a result near to it, or the extrapolation of the
        last two steps."""
        if near is not None:
            displacement = self.grids.finest.discrete.relative(near.displacement)
            return np.append(displacement, near.pressures)
        last = self.recent[-1][0]
        return last + self._ratio(k) * (last - self.recent[0][0])

    def _extrapolated_displacements(self, k: int) -> list[np.ndarray]:
        """Return the displacements (n_dofs,) of all levels for step k, extrapolated as the start. Ten
        paths take 1323 cycles; with those of the last step in place of it, where an extrapolation is
        accepted, 1347."""
        ratio = self._ratio(k)
        pairs = zip(self.displacements, self.displacements_before, strict=True)
        return [last + ratio * (last - before) for last, before in pairs]


def with_values_of(problem: DiscreteProblem, solution: np.ndarray) -> np.ndarray:
    """Return a solution (n_unknowns,) with the values that supports prescribe in a problem."""
    return problem.with_prescribed(problem.from_prescribed(solution))


def _posed_with_names(grids: Grids) -> list[Posed | None]:
    """Return the posed problem of each level; None for all unless every discretised level has a
    mesh."""
    posed = [grids.posed_on(level) for level in grids.levels]
    named = all(
        posed_level is not None or not level.discretised
        for posed_level, level in zip(posed, grids.levels, strict=True)
    )
    return posed if named else [None] * len(posed)


def _loads(posed: Posed | None, level: Level) -> LoadSteps:
    """Return the loads and supports on a level one by one, without a problem as a whole."""
    return whole_load(level.discrete) if posed is None else load_steps(posed, level.discrete)
