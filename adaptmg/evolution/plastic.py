r"""Load paths of plastic bodies: Newton's method around a method for contact problems.

Each Newton step is a contact problem with the tangent of the material
(:mod:`adaptmg.discrete.plasticity`), which any method solves from the last iterate, no more
accurately than the last change deserves. With its solution w and forces of contact and supports
:math:`\lambda` the step goes to :math:`u + t\,d`, d = w - u, with t in (0, 1] such that

.. math:: \varphi'(t) = d \cdot \big(f_\mathrm{int}(u + t d) - f - \lambda\big),\qquad
   |\varphi'(t)| \le 0.3\,|\varphi'(0)| ,

by regula falsi, which takes responses of the material and no solve; u and w are admissible, and so
is what lies between them. A load step ends where the certificate of the iterate in the contact
problem of its own tangent, whose residual is that of the internal forces, finds an energy error of
at most the tolerance. A load step in which Newton's method fails is taken in halves."""

from __future__ import annotations

import copy
import logging
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass, replace
from typing import Any, cast

import numpy as np

from adaptmg.discrete.elasticity import dofs_of
from adaptmg.discrete.plasticity import InelasticBodies, Response
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import PlasticState, StressData
from adaptmg.evolution.load_steps import without_nested_start
from adaptmg.evolution.path_loop import PathLoop, with_values_of
from adaptmg.grids import Grids
from adaptmg.multigrid.cycle import Cycle
from adaptmg.multigrid.truncated_parts import Truncated
from adaptmg.problem.load_path import LoadPath
from adaptmg.solver.certificate import Certificate
from adaptmg.solver.examine import Examiner
from adaptmg.solver.iterate import StopTest
from adaptmg.solver.multigrid import FullMultigrid, Multigrid, handed_over
from adaptmg.solver.outcome import checked_outcome, result_of
from adaptmg.solver.record import Outcome, Run, Solver, Status
from adaptmg.solver.result import Result

_LOG = logging.getLogger(__name__)

_MOST = 40  # Newton steps
# tolerance of the first contact problem. Counts here and of _SHARE and _SLOPE: five paths (Prandtl's punch on 884
# nodes, linear and smoothed, a pierced plate, Hill's tube, a billet) with 38 load steps take 215 Newton steps and 1084
# cycles; half 212 and 1078, twice and .05 215 and 1080
_FIRST = 1e-2
# tolerance of a contact problem over the last change, which is less where that is small: half and twice the same
# counts, .05 213 and 1077; a constant share takes 497 and 1294
_SHARE = 0.2
# of multigrid on a contact problem that is not the last: Prandtl's punch in 8 load steps, 10 346 nodes linear and 5436
# smoothed, 48 and 52 Newton steps, 346 and 324 cycles, at most 54 and 59 a load step; half 48 and 53, 336 and 323, 52
# and 66; twice 48 and 52, 348 and 324, 56 and 59
_CYCLES = 20
# of multigrid on tangents of smoothed elements, whose condition near a limit load is 550 after a V-cycle and 60 after
# exact coarse solves: the punch on 5436 and 10 346 nodes takes 324 and 315 cycles, at most 59 and 77 a load step, with
# V-cycles 576 and 741, 155 and 217, and 1.3 and 1.4 times the seconds; with two sweeps 364 and 383, 82 and 101, in as
# many seconds and four fifths of the work; four and five gain nothing, one takes 427
_SMOOTHED = Cycle(shape="W", pre=3, post=3)
# |phi'| that ends the search, over that at 0: half 215 and 1071, twice 213 and 1062
_SLOPE = 0.3
_TRIALS = 10  # of the search
_SMALLEST = 1 / 64  # part of a load step


class PlasticLoop(PathLoop):
    """The steps of a path of plastic bodies; ``state`` (n_patches, n) is theirs after the last step, or
    the last part of it that is solved."""

    def __init__(self, grids: Grids, path: LoadPath, solver: Solver) -> None:
        self.share = 1.0  # of the change of the factors in a step; super() asks for factors
        super().__init__(grids, path, solver)
        if self.posed[-1] is None:
            raise ValueError(
                "grids: plastic bodies need the mesh, but this is a bare DiscreteProblem: give the "
                "Hierarchy of the ContactProblem"
            )
        if isinstance(getattr(solver, "rtol", None), str):
            raise ValueError("rtol must be a number where bodies are plastic, got 'discretisation'")
        # a user-defined solver may have no tolerance: that of the package's solvers
        self.rtol = cast("float", getattr(solver, "rtol", 1e-8))
        self.plastic = InelasticBodies.of(cast("Posed", self.posed[-1]))
        self.state = self.plastic.unloaded

    def _factors_at(self, k: int) -> dict[str, float]:
        """Return the factors of the part of step k that is being solved."""
        factors = super()._factors_at(k)
        if self.share == 1.0:
            return factors
        # the first step starts from zero loads, or, if the path goes on from a result, from the loads of this
        # result, which it repeats
        before = factors if self.continued else dict.fromkeys(factors, 0.0)
        if k:
            before = super()._factors_at(k - 1)
        return {
            name: before[name] + self.share * (factor - before[name])
            for name, factor in factors.items()
        }

    def step(self, k: int, progress: Callable[[int, dict[str, float]], None] | None) -> Result:
        """Solve step k, as a whole or, where Newton's method fails, in increments of its loads. They are
        halved until they are solved, at most to _SMALLEST; then the result says that it failed."""
        solved_share = 0.0
        increment = 1.0
        while True:
            # to undo what a solve that fails has changed: the solutions of the steps before, multigrid, slips
            # (replaced), and motions (in place, in the controls)
            state_before = dict(vars(self), controls=copy.copy(self.controls))
            self.share = min(solved_share + increment, 1.0)
            result = super().step(k, progress)
            if result.status.ok:
                solved_share = self.share
                self.state = _state_of(result)
            # the first step of a path that goes on from a result repeats its loads: it has no increments
            elif increment > _SMALLEST and not (k == 0 and self.continued):
                vars(self).update(state_before)
                increment /= 2
                _LOG.info("step %d: Newton's method fails; going on in parts of %g", k, increment)
                continue
            if solved_share == 1.0 or not result.status.ok:
                self.share = 1.0
                return result

    def take_over(self, k: int, result: Result, coarse: list[np.ndarray] | None) -> None:
        super().take_over(k, result, coarse)
        self.state = _state_of(result)

    def _solve(
        self,
        k: int,
        motions: Mapping[str, np.ndarray],
        near: Result | None,
        progress: Callable[[int, dict[str, float]], None] | None,
        loose: float,
    ) -> tuple[Result, tuple[Grids, list[np.ndarray] | None]]:
        """Solve step k by Newton's method; see :meth:`PathLoop._solve`. It has its own start and
        tolerances: ``near`` and ``loose`` are not used."""
        run, grids, forces = self._set_up(k, motions, progress)
        problem = grids.finest.discrete
        data = self._stress_data(k, motions)
        if self._at_rest(forces) and not self.state.any():
            result = self._undeformed(k, grids, run, motions)
            response = self.plastic.respond(problem, np.zeros(problem.n_dofs), self.state)
            data = self.plastic.result(problem, response, cast("StressData", data))
            return replace(result, stress_data=data), (grids, None)
        with run.phase("tangent"):
            response = self._start_response(k, problem)
        newton = _Newton(self, grids, run)
        outcome, tangent_grids = newton.run(response)
        response = newton.response
        with run.phase("result"):
            data = self.plastic.result(problem, response, cast("StressData", data))
            result = result_of(
                tangent_grids,
                newton.examiner,
                run,
                checked_outcome(outcome, self.solver, problem),
                self.solver,
                data,
            )
        return result, (grids, None)

    def _start_response(self, k: int, problem: DiscreteProblem) -> Response:
        """Return the response at the start of step k: at the solution of the step before where the
        load turns round, as bodies are elastic there, and where it solves this step, too, as where
        contact has been lost; else at the extrapolation."""
        last = with_values_of(problem, self.recent[-1][0])
        response = self.plastic.respond(problem, last, self.state)
        if self._ratio(k) > 0:
            tangent = self.plastic.linearised(problem, response)
            missed = Examiner(tangent, certified=False).relative_residual(last)
            if missed > StopTest.RESIDUAL_FACTOR * self.rtol:
                return self.plastic.respond(problem, self._start(k, None), self.state)
        return response


def _state_of(result: Result) -> np.ndarray:
    """Return the states (n_patches, n) of the plastic patches at the end of a step."""
    data = cast("StressData", result.stress_data)
    return cast("PlasticState", data.plastic).state


class _Newton:
    """Newton's method for a load step, from the ``state`` (n_patches, n) before it; ``cycles`` are those of
    all its contact problems."""

    def __init__(self, loop: PlasticLoop, grids: Grids, run: Run) -> None:
        self.plastic = loop.plastic
        self.state = loop.state
        solver: Any = loop.solver
        correction = getattr(solver, "correction", None)
        # only smoothed elements have groups of nodes. Their tangents need the better coarse solves of
        # _SMOOTHED; a coarse solver that the user gave stays
        if (
            len(self.plastic.groups)
            and isinstance(correction, Truncated)
            and correction.correct is None
        ):
            solver = replace(solver, correction=replace(correction, correct=_SMOOTHED))
        self.solver: Solver = solver
        self.grids = grids
        self.recorder = run
        self.problem = grids.finest.discrete
        self.rtol = loop.rtol
        self.cycles = 0

    def run(self, response: Response) -> tuple[Outcome, Grids]:
        """Return the outcome, and the hierarchy with the tangent at the solution.

        The method ends with an iterate that the certificate finds accurate enough, which is asked only
        after a contact problem that was solved to ``rtol``, the last one so far; with a contact problem
        that cannot be solved; or after ``_MOST`` of them."""
        self.response = response
        tolerance = _FIRST  # of the next contact problem; at most rtol after the last one
        status = Status.LIMIT
        error = np.nan
        for number in range(_MOST + 1):
            grids = self._linearised()
            tangent = grids.finest.discrete
            self.examiner = Examiner(tangent)
            if number and tolerance <= self.rtol:
                checked = cast(
                    "Certificate", self.examiner(self.response.displacement, self.rtol).checked
                )
                error = checked.energy_error
                if error <= max(self.rtol, checked.energy_rounding):
                    status = Status.CONVERGED
                    break
            if number == _MOST:
                break
            is_last = tolerance <= self.rtol  # if the certificate then agrees
            outcome = self._contact_problem(grids, max(tolerance, self.rtol), is_last)
            # a limit of cycles is enough progress for an inexact step
            if outcome.status in (Status.DIVERGED, Status.STALLED, Status.CYCLING):
                status = outcome.status
                break
            tangent_before = self.response.tangent
            change = self._advance(tangent, outcome.solution)
            # Newton's method converges quadratically: a share of the last change, or where that is small
            # its square; where the tangent stays, the next contact problem is exact
            tolerance = min(tolerance, min(_SHARE, change) * change)
            if np.array_equal(tangent_before, self.response.tangent):
                tolerance = min(tolerance, self.rtol)
            self.recorder.record(
                cycle=0, newton_step=number + 1, newton_change=change, newton_part=self.part
            )
        return (
            Outcome(
                self.response.displacement, status, self.cycles, self.rtol, error_estimate=error
            ),
            grids,
        )

    def _linearised(self) -> Grids:
        """Return the hierarchy with the tangent on the finest level."""
        with self.recorder.phase("tangent"):
            tangent = self.plastic.linearised(self.problem, self.response)
            grids = self.grids
            # coarse levels that are only spaces have Galerkin products, here of the tangent
            if not grids.discretised:
                coarse = [level.prolongation for level in grids.levels[1:]]
                galerkin = Grids.from_prolongations(tangent, coarse)
                grids = replace(grids, levels=(*galerkin.levels[:-1], grids.finest))
            finest = grids.finest.posing(discrete=tangent)
            return replace(grids, levels=(*grids.levels[:-1], finest))

    def _contact_problem(self, grids: Grids, tolerance: float, is_last: bool) -> Outcome:
        """Solve the contact problem of the tangent from the last iterate; ``is_last``: after it the
        certificate may end the load step."""
        solver = self.solver
        start = self.response.displacement
        unloaded = not start.any()
        # a nested start begins at zero, on discretised levels
        if isinstance(solver, FullMultigrid) and not (unloaded and grids.discretised):
            solver = without_nested_start(solver)
        if is_dataclass(solver) and hasattr(solver, "rtol"):
            changed: dict[str, float] = {"rtol": tolerance}
            if isinstance(solver, Multigrid) and not is_last:
                changed["max_cycles"] = min(_CYCLES, solver.max_cycles)
            solver = replace(cast("Any", solver), **changed)
        run = self.recorder
        run.first_cycle = self.cycles  # the history counts the cycles of all contact problems
        # only the last contact problem needs a certificate
        run.examiner = self.examiner if is_last else None
        outcome = solver.run(grids, run, None if unloaded else start)
        outcome = handed_over(checked_outcome(outcome, solver, self.problem), grids, run)
        self.cycles += outcome.cycles
        run.first_cycle = self.cycles
        return outcome

    def _advance(self, tangent: DiscreteProblem, solution: np.ndarray) -> float:
        """Go towards the solution (n_unknowns,) of the contact problem of a tangent, and return the change
        over the solution, in the energy norm of the tangent."""
        direction = solution - self.response.displacement  # d = w - u
        # lambda = A w - b of the tangent, the forces of contact and supports: along all else it is the residual
        # that the solver leaves
        whole = -tangent.residual(solution)
        forces = whole - tangent.free_part(whole)
        of_contact = dofs_of(tangent.contact.nodes, tangent.dim)
        forces[of_contact] = whole[of_contact]

        def slope(response: Response) -> float:
            """Return phi' of the module, d . (f_int - f - lambda): ``missed`` is f - f_int."""
            return -float(direction @ (response.missed + forces))

        with self.recorder.phase("tangent"):
            self.response, self.part = self._searched(direction, slope)
        # squares of the energy norms of t d, but for t, and of w
        change = float(direction @ (tangent.matrix @ direction))
        size = float(solution @ (tangent.matrix @ solution))
        return self.part * float(np.sqrt(max(change, 0.0) / size)) if size > 0 else 0.0

    def _searched(
        self, direction: np.ndarray, slope: Callable[[Response], float]
    ) -> tuple[Response, float]:
        """Return the response after a part of a ``direction`` (n_unknowns,), m, and this part: 1 if the
        ``slope`` is still negative there, else one where it is small.

        Regula falsi keeps the slope negative at the first end of an interval and positive at the
        second; the slope of an end that stays twice counts half (the rule of Illinois)."""
        ends = [0.0, 1.0]
        slopes = [slope(self.response), np.nan]
        small = _SLOPE * abs(slopes[0])
        part = 1.0
        last_end = -1
        for _ in range(_TRIALS):
            tried = part
            displacement = self.response.displacement + tried * direction
            response = self.plastic.respond(self.problem, displacement, self.state)
            new_slope = slope(response)
            end = int(new_slope > 0)  # the end of the interval that is replaced
            if abs(new_slope) <= small or (tried == 1.0 and not end):
                break
            if end == last_end:
                slopes[1 - end] *= 0.5
            last_end = end
            ends[end] = tried
            slopes[end] = new_slope
            part = ends[0] - slopes[0] * (ends[1] - ends[0]) / (slopes[1] - slopes[0])
        return response, tried
