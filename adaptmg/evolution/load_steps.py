r"""Load steps: the truncated multigrid, which is set up once (:func:`resumed`), other solvers, which
begin again (:func:`restarted`), and Controls, the motions that prescribed forces determine.

In the truncated multigrid matrices, transfers, and the lists by which the contact status changes
coarse matrices stay; loads, gaps and slip references change. The nested start of a step carries
only what the step changes: level l solves its step from

.. math:: u_l^{k-1} + P\,(u_{l-1}^k - u_{l-1}^{k-1}),

with its history :math:`u_l^0, u_l^1, \dots` and slips measured against that. The error of such a
start is the discretisation error of the increment, not of the whole displacement; it finds nodes
that stick, and slips that turn round when a load is taken back, where the interpolation of the
whole displacement would let every node slip. Before this start the certificate checks whether the
extrapolation of the last two steps solves the step, as it does under proportional loading.

The motion of a Rigid obstacle and the strain of a Preload, which transmit a force, are a few
unknowns z next to the contact problem, with the equations

.. math:: F(z) = F^* : \quad \text{resultant and moment of the contact forces of an obstacle, force across a cut} .

On a level with at most some thousand unknowns, the finest or a coarse one, the motions of obstacles
are unknowns of one contact problem. From there z is found on the finest level by Broyden's method
(C. T. Kelley, Solving Nonlinear Equations with Newton's Method, SIAM 2003,
doi:10.1137/1.9780898718898), with a contact problem for each trial, solved no more accurately than
the forces that it misses are known, and a first Jacobian from the coarse level. Where friction makes
the finest level jump where the coarse one does not, its own problem with unknown motions is solved.
Bolts are shortened until something pulls; their first Jacobian comes by differences."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import chain
from typing import Generic, TypeVar, cast

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import lsmr

from adaptmg import _checks as checks
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import StressData, cut_force, cut_stiffness
from adaptmg.discrete.supports import Inclined
from adaptmg.grids import Grids
from adaptmg.level import Level
from adaptmg.mesh.arrays import MeshArrays, need_mesh
from adaptmg.multigrid.truncated_parts import Truncated
from adaptmg.problem.contact_problem import Contact, ContactProblem
from adaptmg.problem.loads import Preload
from adaptmg.problem.surfaces import Moving, Rigid, moving_parts, placed
from adaptmg.smoother.factorisation import factorisable
from adaptmg.smoother.system import held_stiffness
from adaptmg.solver.active_set import ActiveSet
from adaptmg.solver.examine import Examiner
from adaptmg.solver.iterate import StopTest
from adaptmg.solver.multigrid import FullMultigrid, Multigrid
from adaptmg.solver.record import Outcome, Run, Solver, Status
from adaptmg.solver.result import Result
from adaptmg.solver.truncated import TruncatedRun

_LOG = logging.getLogger(__name__)
Carried = TypeVar("Carried")

# Counts below, where nothing else is said: 19 problems (rounded pads and tilted planes that are pressed, also along a
# path that turns round, on at most 6498 unknowns; a column under a weight; a bolted junction, also with a clearance
# under a head; a bolt in a sleeve) with 30 load steps take 537 cycles, at most 49 a step, and 131 contact problems of
# guides. They are from before extrapolated steps were accepted, which spares a punch and a bolted junction 2 cycles
# in each step under proportional loads

#: forces are met to this multiple of rtol: half 545 cycles, twice 537
ACCURACY = 10.0
_MOST = 40  # contact problems in a step on a level
# of the size of the unknowns so far: half 535 cycles, at most 47 a step, twice 553, at most 51
_DIFFERENCE = 0.02
# unknowns of the level on which motions are found first: half 535 cycles, twice 443 and 93 guides, 700 unknowns 497
# cycles, at most 26 a step
_GUIDING = 2500
# deviation of forces, over their size, up to which they count as met there: half 510 cycles, at most 27 a step, twice
# 548, at most 48
_COARSE = 1e-3
_RELINEARISED = 5  # times that the motions are linearised there
# springs of an obstacle there, over the largest stiffness; half, twice and 1e-7: the same cycles and guides; 1e-12:
# the same cycles, a guide more
_SOFT = 1e-9
# share of the force of a bolt from which on it is resisted; half, twice, .1 and 1e-9: the same cycles
_PULLS = 0.01
_DOUBLINGS = 20  # times that the strain of a bolt is doubled until then
# tolerance of a contact problem, over what forces missed before it: half 547 cycles, at most 35 a step, twice 511, at
# most 27
_LOOSE = 0.01
# tolerance for differences, over the size of the unknowns: half 530 cycles, twice 525, at most 38 a step, 1e-3 528
_EXACT = 1e-5
# a step with the Jacobian of a coarse level must reduce the deviation of the forces to this share: half 505 cycles, at
# most 27 a step, twice 531, at most 28, .6 563, at most 41
_SLOW = 0.15
_TINY = float(np.finfo(np.float64).tiny)
#: solves a contact problem: from motions, a result with motions near to these and the tolerance that suffices to the
#: result, and what the next step takes over
Solve = Callable[[dict[str, np.ndarray], Result | None, float], tuple[Result, Carried]]


@dataclass(frozen=True, eq=False)
class Past:
    """The starts that the steps before offer to a step. Solutions of the finest level have the values
    that supports prescribe in this step: with those of the step before, residuals would not show that
    supports have moved. 18 paths of a block of 289 nodes on a moving support take 1006 cycles of Multigrid
    in place of 1036; a SingleGrid on 153 nodes takes 30 sweeps in place of 2253 for the second step of
    a proportional motion without friction."""

    last: np.ndarray  # solution (n_unknowns,) after the step before
    extrapolated: np.ndarray  # (n_unknowns,): from the last two steps in the loads
    has_previous: bool  # whether there was a step before
    #: whether ``extrapolated`` is not an extrapolation but the start to take, as a solution of this step
    #: with other motions of obstacles
    is_start: bool = False
    loose: float = 0.0  # tolerance that suffices, if it is larger than that of the solver
    #: displacements (n_dofs,), coarsest level first, after the step before, and from the last two steps in
    #: the loads; nested starts need them
    level_displacements: list[np.ndarray] = field(default_factory=list)
    extrapolated_level_displacements: list[np.ndarray] = field(default_factory=list)


def better_start(examiner: Examiner, past: Past, run: Run) -> np.ndarray:
    """Return the solution (n_unknowns,) of the step before or the extrapolated one, the one with the
    smaller residual."""
    with run.phase("start"):
        return min(past.last, past.extrapolated, key=examiner.relative_residual)


def coarse_displacements(hierarchy: Grids, displacement: np.ndarray) -> list[np.ndarray]:
    """Return a displacement (n_dofs,) of the finest level on all levels, coarsest first: on each the one
    whose interpolation is nearest to that of the next finer level. Where coarse levels are only spaces,
    which have no displacements, the list has that of the finest level alone."""
    result = [displacement]
    for level in reversed(hierarchy.levels[1:] if hierarchy.discretised else ()):
        columns = result[0].reshape(level.n_nodes, -1).T
        # displacements of coarse levels only serve starts, which need no more than eight digits
        nodal = [lsmr(level.prolongation, column, atol=1e-8, btol=1e-8)[0] for column in columns]
        result.insert(0, np.stack(nodal, axis=1).reshape(-1))
    return result


#: extrapolation is taken where it leaves less than this share of the residual of the nested start, whose error
#: is rough and soon smoothed away. 40 load paths of 10 and 20 steps to 1e-8 and 1e-5 take 2300 cycles; half 2302,
#: twice 2289, the better one of both 2297, without extrapolation here 2647
_EXTRAPOLATE = 0.05


def extrapolated_outcome(rtol: float, examiner: Examiner, run: Run, past: Past) -> Outcome | None:
    """Return the extrapolation as the outcome of a step if the certificate finds it as accurate as
    ``rtol``, else None. A step that is proportional to the last one then costs only this certificate,
    which its result needs anyway: 20 such steps on 4225 nodes take 0.6 of the time. 17 paths with 340
    steps take 1241 cycles in place of 1326, and the certificate refuses 10 of 173 extrapolations; if
    a tenth of the residual is required, 1279 cycles, and it refuses none of 144."""
    solution = past.extrapolated
    with run.phase("start"):
        residual = examiner.relative_residual(solution)
    if residual > StopTest.RESIDUAL_FACTOR * rtol or run.shortfall(solution, rtol) > 0.0:
        return None
    run.record(cycle=0, residual=residual, change=np.nan, error_estimate=np.nan)
    return Outcome(solution=solution, status=Status.CONVERGED, cycles=0, rtol=rtol)


def step_outcome(
    solver: Solver,
    multigrid: TruncatedRun | None,
    hierarchy: Grids,
    examiner: Examiner,
    run: Run,
    past: Past,
) -> tuple[Outcome, TruncatedRun | None, list[np.ndarray] | None]:
    """Solve a step as :func:`resumed` does, or :func:`restarted` with other solvers than truncated
    multigrid. Before it, the extrapolation is taken if it is accurate enough; it is tried with
    truncated multigrid, and with an ActiveSet that repeats the last loads. ``past`` has the starts,
    ``examiner`` belongs to the step.

    Return the outcome, the set-up of multigrid for the next step, and the displacements (n_dofs,) of
    the coarse levels, coarsest first (none where only the finest one is discretised), or None if the
    step has not found them."""
    is_truncated = isinstance(solver, Multigrid) and isinstance(solver.correction, Truncated)
    # an ActiveSet that repeats the loads would find no slip, and so no direction for friction at its bound,
    # and its Newton steps may cycle: the old solution comes first
    # equal loads extrapolate to the last solution, to the bit; where others do, too, the certificate refuses it
    is_repeated = isinstance(solver, ActiveSet) and np.array_equal(past.extrapolated, past.last)
    # with past.is_start ``extrapolated`` is a start, not an extrapolation
    extrapolates = past.has_previous and not past.is_start and (is_truncated or is_repeated)
    rtol = getattr(solver, "rtol", None)
    if extrapolates and isinstance(rtol, float):  # not "discretisation", which needs a nested start
        outcome = extrapolated_outcome(rtol, examiner, run, past)
        if outcome is not None:
            # all but that of the finest level, which the outcome has
            return outcome, multigrid, past.extrapolated_level_displacements[:-1]
    if is_truncated:
        return resumed(cast("Multigrid", solver), multigrid, hierarchy, examiner, run, past)
    return restarted(solver, hierarchy, examiner, run, past), None, None


def without_nested_start(solver: FullMultigrid) -> Multigrid:
    """Return the Multigrid with the parameters of a FullMultigrid."""
    return Multigrid(**{item.name: getattr(solver, item.name) for item in fields(Multigrid)})


def restarted(
    solver: Solver, hierarchy: Grids, examiner: Examiner, run: Run, past: Past
) -> Outcome:
    """Solve a step by a solver that begins again: the first step without a start, others from the
    better one of the two that :class:`Past` has."""
    if not (past.has_previous or past.is_start):
        return solver.run(hierarchy, run, None)
    if isinstance(solver, FullMultigrid):
        solver = without_nested_start(solver)
    start = past.extrapolated if past.is_start else better_start(examiner, past, run)
    return solver.run(hierarchy, run, start)


def resumed(
    solver: Multigrid,
    multigrid: TruncatedRun | None,
    hierarchy: Grids,
    examiner: Examiner,
    run: Run,
    past: Past,
) -> tuple[Outcome, TruncatedRun | None, list[np.ndarray] | None]:
    """Solve a step by the truncated multigrid, which is set up for the step before (``multigrid``) or
    else from the beginning. Return the outcome, the set-up for the next step, and the displacements
    (n_dofs,) of coarse levels, coarsest first, if the solver has a nested start, else None."""
    problem = hierarchy.finest.discrete
    if multigrid is None or not problem.alike(multigrid.problems[-1]):
        multigrid = cast("TruncatedRun", solver.prepared(hierarchy, run, keeps=True))
    else:
        multigrid.pose(hierarchy, run)
    # "discretisation": the first contact problem of a path, whose nested start sets the tolerance of all others
    multigrid.rtol = solver.rtol if isinstance(solver.rtol, str) else max(solver.rtol, past.loose)
    coarse = None
    origin = "zero"
    if past.is_start:
        # no other start is as near: neither a nested one nor that of the step before is tried
        start = past.extrapolated
    elif isinstance(solver, FullMultigrid):
        start, coarse = _nested_start(solver, multigrid, examiner, run, past)
        origin = "nested"
    elif past.has_previous:
        start = better_start(examiner, past, run)
    else:
        start = np.zeros(problem.n_unknowns)
    # the contact status of a start is trusted after a step before. In the first step that of other motions is
    # not: 48 paths of pads take 1533 cycles in place of 1524 if it is
    outcome = multigrid.finish(
        problem.from_prescribed(start), "given" if past.has_previous else origin
    )
    # a run that leaves cycles to another method has diverged or stalled: its set-up is not used again
    return outcome, None if outcome.left else multigrid, coarse


def _nested_start(
    solver: FullMultigrid, multigrid: TruncatedRun, examiner: Examiner, run: Run, past: Past
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Return the nested start (n_unknowns,) of a step, which carries the change of the step, or the
    extrapolation where this leaves far less residual, and the displacements of the coarse levels."""
    problem = multigrid.problems[-1]
    displacements_before = past.level_displacements if past.has_previous else None
    *coarse_solutions, start = multigrid.nested_start(solver.start, displacements_before)
    # of each solution the displacement, without pressures
    coarse = [
        coarse_problem.parts(solution)[0]
        for coarse_problem, solution in zip(multigrid.problems[:-1], coarse_solutions, strict=True)
    ]
    if past.has_previous:
        # the pressures of the last step, next to the displacement of the nested start
        start[problem.n_dofs :] = past.last[problem.n_dofs :]
        if solver.rtol != "discretisation":  # this tolerance comes from the nested start
            with run.phase("start"):
                extrapolated_residual = examiner.relative_residual(past.extrapolated)
                if extrapolated_residual <= _EXTRAPOLATE * examiner.relative_residual(start):
                    start = past.extrapolated
    return start, coarse


@dataclass(frozen=True)
class _Unknowns:
    """The unknowns of one obstacle or preload among all: those from number ``first`` on, and the
    sizes by which they and their forces are divided."""

    name: str
    first: int
    targets: np.ndarray  # (n,): prescribed forces, N, and moments, N m
    sizes: np.ndarray  # (n,): of displacements, m, rotations, rad, or strains
    force_sizes: np.ndarray  # (n,): of forces, N, and moments, N m
    free: tuple[int, ...] = (0,)  # which components of the motion they are
    number: int | None = None  # of the contact of an obstacle; None of a preload

    @property
    def indices(self) -> slice:
        return slice(self.first, self.first + len(self.targets))


@dataclass
class Controls:
    """The obstacles and preloads of a problem, whose motions and strains change from step to step."""

    problem: ContactProblem | None
    level: Level
    #: motions (3 in the plane, 6 in space) of obstacles, strains (1) of preloads, by name
    motions: dict[str, np.ndarray] = field(default_factory=dict)
    factors: dict[str, float] = field(default_factory=dict)  # of the step before
    #: all moving obstacles at the end of the step before, by the number of their contact
    places: dict[int, Moving] = field(init=False)

    def __post_init__(self) -> None:
        contacts = () if self.problem is None else self.problem.contact
        loads = () if self.problem is None else self.problem.loads
        self.obstacles = {
            k: contact.obstacle
            for k, contact in enumerate(contacts)
            if isinstance(contact, Contact)
        }
        self.rigid = {
            k: obstacle for k, obstacle in self.obstacles.items() if isinstance(obstacle, Rigid)
        }
        self.bolts = [load for load in loads if isinstance(load, Preload)]
        self.motions |= {
            obstacle.name: np.zeros(3 * obstacle.dim - 3) for obstacle in self.rigid.values()
        }
        self.motions |= {bolt.path_name: np.zeros(1) for bolt in self.bolts}
        self.places = self.placed({}, {})  # from there the discretisation counts slips

    def prescribed_numbers(self) -> list[list[float]]:
        """Return the prescribed motions and forces as numbers, for stores; -1e300 where nothing is
        prescribed."""
        result = [
            [*_numbers(chain(*part.forces.values(), part.moment)), *part.pivot]
            if isinstance(part, Rigid)
            else [*part.displacement, *part.rotation, *part.pivot]
            for obstacle in self.obstacles.values()
            for part in moving_parts(obstacle)
        ]
        result += [[bolt.force, bolt.direction, *_numbers([bolt.at])] for bolt in self.bolts]
        return [list(map(float, numbers)) for numbers in result]

    def check_pressed(self, factors: Mapping[str, float]) -> None:
        """Raise ValueError where the factor of the only force of an obstacle does not press it; of several
        forces some may be absent or pull."""
        for obstacle in self.rigid.values():
            only, *further_forces = obstacle.forces
            if not (further_forces or factors[only] > 0):
                raise ValueError(
                    f"the factor of {only!r}, which a force presses, must be > 0, got {factors[only]:g}: "
                    "begin and end with a small one"
                )

    def unknowns(self, factors: Mapping[str, float]) -> list[_Unknowns]:
        """Return the unknowns of a step with these factors."""
        result: list[_Unknowns] = []
        if not self.rigid and not self.bolts:
            return result
        mesh = need_mesh(self.level)
        discrete = self.level.discrete
        # the largest diagonal entry of a block of the matrix: force over displacement of a single node
        stiffness = float(
            np.abs(discrete.matrix.data[:, range(discrete.dim), range(discrete.dim)]).max()
        )
        first = 0
        for number in self.rigid:
            result.append(self._obstacle_unknowns(number, first, factors, mesh, stiffness))
            first += len(result[-1].targets)
        for bolt in self.bolts:
            # a bolt whose force stays keeps its strain
            if factors[bolt.path_name] != self.factors.get(bolt.path_name, 0.0):
                result.append(self._bolt_unknown(bolt, first, factors, mesh))
                first += 1
        return result

    def _obstacle_unknowns(
        self,
        number: int,
        first: int,
        factors: Mapping[str, float],
        mesh: MeshArrays,
        stiffness: float,
    ) -> _Unknowns:
        """Return the free motions of the obstacle of contact ``number``. The size of displacements is
        the prescribed force over the largest ``stiffness`` of a node; moments and rotations have the
        extent of the boundary as arm."""
        obstacle = self.rigid[number]
        problem = cast("ContactProblem", self.problem)
        dim = obstacle.dim
        free = list(obstacle.free)
        targets = obstacle.loaded(factors).targets  # NaN where the motion is prescribed
        force = float(np.linalg.norm(np.nan_to_num(targets[:dim])))
        nodes = mesh.surface(problem.contact[number].boundary).nodes
        extent = float(np.linalg.norm(np.ptp(mesh.points[nodes], axis=0)))
        is_rotation = np.arange(3 * dim - 3)[free] >= dim  # of 3 or 6 motions, translations first
        arms = np.where(is_rotation, extent, 1.0)
        return _Unknowns(
            obstacle.name,
            first,
            targets[free],
            sizes=force / stiffness / arms,
            force_sizes=force * arms,
            free=obstacle.free,
            number=number,
        )

    def _bolt_unknown(
        self, bolt: Preload, first: int, factors: Mapping[str, float], mesh: MeshArrays
    ) -> _Unknowns:
        """Return the strain of a bolt. Its size is that of the force in the bolt alone; where a bolt is
        released, whose force becomes 0, that of the force that it had."""
        name = bolt.path_name
        force = bolt.force * max(abs(factors[name]), abs(self.factors.get(name, 0.0)))
        material = cast("ContactProblem", self.problem).material
        return _Unknowns(
            name,
            first,
            targets=np.array([factors[name] * bolt.force]),
            sizes=np.array([force / cut_stiffness(mesh, material, bolt)]),
            force_sizes=np.array([force]),
        )

    def motions_of(self, parts: Sequence[_Unknowns], values: np.ndarray) -> dict[str, np.ndarray]:
        """Return all motions, by name, with the values (n,) of the unknowns in them."""
        result = dict(self.motions)
        for part in parts:
            motion = result[part.name].copy()
            motion[list(part.free)] = values[part.indices]
            result[part.name] = motion
        return result

    def placed(
        self, factors: Mapping[str, float], motions: Mapping[str, np.ndarray]
    ) -> dict[int, Moving]:
        """Return all moving obstacles in their places, by the number of their contact, with these factors
        of loads and ``motions`` (3 or 6,) of Rigid obstacles by name."""
        places = {k: placed(obstacle, factors, motions) for k, obstacle in self.obstacles.items()}
        return {k: place for k, place in places.items() if isinstance(place, Moving)}

    def missing_forces(self, parts: Sequence[_Unknowns], result: Result) -> np.ndarray:
        """Return the forces (n,) of a result minus the prescribed ones, over their sizes."""
        missing = []
        for part in parts:
            if part.number is not None:
                obstacle = self.rigid[part.number]
                total = result.resultant(
                    cast("ContactProblem", self.problem).contact[part.number].boundary,
                    about=obstacle.about,
                )
                forces = np.append(total.force, total.turning)[list(part.free)]
            else:
                bolt = next(preload for preload in self.bolts if preload.path_name == part.name)
                data = cast("StressData", result.stress_data)
                forces = cut_force(need_mesh(result), data, result.displacement, bolt)
            missing.append((forces - part.targets) / part.force_sizes)
        return np.concatenate(missing)

    def find(
        self,
        parts: Sequence[_Unknowns],
        solve: Solve[Carried],
        posed: Callable[[dict[str, np.ndarray]], Grids],
        is_repeated: bool,
        limit: float,
        rtol: Callable[[], float],
    ) -> tuple[Result, Carried, dict[str, np.ndarray]]:
        """Return the result with the prescribed forces, what ``solve`` carries to the next step, and
        the motions; ``rtol`` returns the tolerance of the solver, which the first contact problem may set.

        A guide finds motions of obstacles on a level with few unknowns, of the hierarchy that
        ``posed`` makes for motions; contact problems on the finest level correct them, and shorten
        bolts. The result counts the cycles of all contact problems there, and the work and seconds
        of the guide too. Once every bolt pulls, no further contact problem begins after ``limit``
        cycles."""
        search = Search(self, parts, solve, limit, rtol)
        guide = Guide(self, parts, posed)
        motions = np.concatenate([self.motions[part.name][list(part.free)] for part in parts])
        # from here on over their sizes
        values = motions / search.sizes
        try:
            # under the loads of the step before nothing moves
            trial = search.trial_at(values, None) if is_repeated else None
            if trial is None or not (trial.result.status.ok and search.reached(trial)):
                values = guide.balanced_values(values)
                # the guide has the obstacles alone
                if len(guide.parts) < len(parts):
                    trial = search.run(search.pulled(search.trial_at(values, None, _LOOSE)), None)
                else:
                    trial = search.run(search.trial_at(values, None, guide.loose), guide)
        except _Exhausted:
            trial = search.last
        result = trial.result
        if result.status.ok and not search.reached(trial):
            missed = float(np.abs(trial.missed).max())
            _LOG.warning(
                "forces of %s are missed by %.1e of their size after %d contact problems",
                ", ".join(part.name for part in parts),
                missed,
                len(search.spent),
            )
            result = replace(result, status=Status.LIMIT, missed_forces=missed)
        spent = [*guide.spent, *search.spent]
        timings = {
            name: sum(solved.timings.get(name, 0.0) for solved in spent)
            for name in dict.fromkeys(chain(*(solved.timings for solved in spent)))
        }
        result = replace(
            result,
            cycles=search.cycles,
            work_units=sum(solved.work_units for solved in spent),
            timings=timings,
        )
        return result, trial.carried, self.motions_of(parts, trial.values * search.sizes)

    def take(self, factors: Mapping[str, float], motions: Mapping[str, np.ndarray]) -> None:
        """Continue after a step with these factors of loads, and motions as in :attr:`motions`, by name."""
        self.factors = dict(factors)
        self.motions = dict(motions)
        self.places = self.placed(factors, motions)


class Guide:
    """Contact problems in which the motions of obstacles are unknowns, on the finest level with few
    unknowns; ``posed`` takes motions."""

    def __init__(
        self,
        controls: Controls,
        parts: Sequence[_Unknowns],
        posed: Callable[[dict[str, np.ndarray]], Grids],
    ) -> None:
        self.controls = controls
        self.posed = posed
        self.all_parts = parts
        self.parts = [part for part in parts if part.number is not None]
        #: number of the motions of obstacles, which come before the strains of bolts in all unknowns
        self.n_motions = sum(len(part.targets) for part in self.parts)
        self.sizes = np.concatenate([part.sizes for part in parts])
        self.spent: list[Run] = []
        levels = posed(controls.motions).levels
        small_levels = [
            number
            for number, level in enumerate(levels)
            if level.discretised and level.discrete.n_dofs <= _GUIDING
        ]
        self.finest_number = len(levels) - 1
        #: number of the level on which motions are found
        self.level_number = small_levels[-1] if small_levels else self.finest_number
        #: tolerance that suffices for the first contact problem on the finest level, whose forces are off by
        #: about the share _COARSE if a coarser level finds the motions
        self.loose = 0.0 if self.level_number == self.finest_number else _LOOSE * _COARSE

    def balanced_values(self, values: np.ndarray) -> np.ndarray:
        """Return values (n,) of the unknowns, over their sizes, with which obstacles balance their
        forces, by a few steps to first order from ``values`` (n,); or the last ones, where
        equations become singular. Strains of bolts stay. ValueError if they are singular before the
        first trial, or nothing resists the forces."""
        values = values.copy()
        for _ in range(_RELINEARISED if self.n_motions else 0):
            try:
                change = self._balancing_change(values, np.zeros(self.n_motions))
            except ValueError:  # singular equations
                if not self.spent:
                    raise
                break
            # a million times the size that the forces suggest: only the soft springs resist
            if not np.abs(change).max() < 1 / checks.SIX_DIGITS:
                raise nothing_resists(self.parts)
            values[: self.n_motions] += change
            if np.abs(change).max() <= _COARSE:
                break
        return values

    def better_values(self, values: np.ndarray, missed: np.ndarray) -> np.ndarray:
        """Return better values (n,) than those with which the finest level misses the forces by
        ``missed`` (n,), both over their sizes: those of this guide on the finest level, where it then
        stays. Where it was on this level already, or the factors of that take too much memory, a Newton
        step corrects the values by what is missed."""
        is_coarse = self.level_number < self.finest_number
        if is_coarse and factorisable(self.controls.level.discrete):
            self.level_number = self.finest_number
            return self.balanced_values(values)
        # with a guide there are no bolts: all unknowns are motions of obstacles
        try:
            return values + self._balancing_change(values, -missed)
        except ValueError:  # singular equations: the finest level goes on from its values
            return values

    def stiffness(self, values: np.ndarray) -> np.ndarray | None:
        """Return the Jacobian (n, n) of forces by motions at ``values`` (n,), all over their sizes, as the
        inverse of the differences of motions for small changes of the forces; None where equations are
        singular."""
        try:
            rest = self._balancing_change(values, np.zeros(self.n_motions))
            changes = _DIFFERENCE * np.eye(self.n_motions)
            moved = [self._balancing_change(values, force) - rest for force in changes]
            return np.linalg.inv(np.stack(moved, axis=1) / _DIFFERENCE)
        except ValueError:  # singular equations, also those of numpy.linalg.inv
            return None

    def _balancing_change(self, values: np.ndarray, extra: np.ndarray) -> np.ndarray:
        r"""Return the change (n,) of the values after which obstacles bear the prescribed forces plus
        ``extra`` ones (n,), to first order in the motion; all over their sizes.

        The motions are unknowns of one contact problem in displacements relative to obstacles,
        :math:`u = v + M z` at the nodes that they may touch, with the matrix :math:`(I\; M)^T A\,
        (I\; M)` and the load :math:`(b, M^T b + F^*)`. All z are lengths, rotations times their arm, and
        F* forces, moments over it: one spring, soft, holds each motion that nothing resists."""
        motions = self.controls.motions_of(self.all_parts, values * self.sizes)
        posed = self.posed(motions)
        at_level = posed[self.level_number].discrete
        discrete = self._with_slips_where_held(at_level)
        n = self.n_motions
        # motions over z, by which all z become lengths: 1 of displacements, 1 over the arm of rotations
        scales = np.concatenate([part.sizes / part.sizes[0] for part in self.parts])
        forces = np.concatenate(
            [part.targets + part.force_sizes * extra[part.indices] for part in self.parts]
        )
        # the matrix has blocks of dim dofs: columns of zeros, whose dofs are fixed, complete the last one
        moves = np.pad(self._motions_at_contact(discrete, scales), ((0, 0), (0, -n % discrete.dim)))
        padded = moves.shape[1]
        basis = sparse.hstack([sparse.eye_array(discrete.n_dofs), sparse.csr_array(moves)], "csr")
        soft = _SOFT * np.abs(at_level.matrix.diagonal()).max()
        springs = sparse.diags_array(np.append(np.zeros(discrete.n_dofs), np.full(padded, soft)))
        # (I M)'A (I M), and (b, M'b + F*)
        matrix = basis.T @ sparse.csr_array(discrete.matrix) @ basis + springs
        load = basis.T @ discrete.load
        load[discrete.n_dofs :][:n] += forces * scales
        problem = DiscreteProblem(
            matrix=0.5 * (matrix + matrix.T),
            load=load,
            fixed=np.append(discrete.fixed, np.arange(padded) >= n),
            fixed_values=np.pad(discrete.fixed_values, (0, padded)),
            inclined=discrete.inclined,
            law=discrete.law,
            contact=discrete.contact,
            volumes=replace(discrete.volumes, rows=discrete.volumes.rows @ basis),
        )
        run = Run(unit=posed.finest.nonzeros)
        with run.phase("start"):
            outcome = ActiveSet().run(Grids.single(problem), run, None)
        self.spent.append(run)
        z = outcome.solution[discrete.n_dofs :][:n]
        return z * scales / self.sizes[:n]

    def _with_slips_where_held(self, discrete: DiscreteProblem) -> DiscreteProblem:
        r"""Return the problem in which the slips that supports prescribe at the nodes of obstacles are
        unknowns s, too: along the projections Z onto what is held, friction pulls at springs k in place of
        supports,

        .. math:: A \to (I - Z)\,A\,(I - Z) + k Z .

        The obstacle then feels this friction, which sticks where the obstacle does not move. As supports
        bear no other force through k, the results obey the law of :class:`Examiner`. All unknowns count from
        the prescribed values."""
        contact = discrete.contact
        numbers = [cast("int", part.number) for part in self.parts]
        nodes = contact.nodes[np.isin(contact.boundary, numbers)]
        spans = discrete.held_spans(nodes)
        is_held = spans.any(axis=(1, 2))
        if not is_held.any():
            return discrete
        slipping = nodes[is_held]
        stiffness = held_stiffness(discrete)[np.isin(contact.nodes, slipping)]
        springs = Inclined(slipping, spans[is_held], {})
        others = ~np.isin(discrete.inclined.nodes, slipping)
        fixed = discrete.fixed.reshape(-1, discrete.dim).copy()
        fixed[slipping] &= ~discrete.held.reshape(fixed.shape)[slipping]
        return discrete.restructured(
            matrix=springs.decoupled(discrete.matrix, stiffness),
            load=discrete.load_from_prescribed(),
            fixed=fixed.reshape(-1),
            fixed_values=np.zeros(discrete.n_dofs),
            inclined=Inclined(discrete.inclined.nodes[others], discrete.inclined.spans[others], {}),
            contact=replace(
                contact,
                slip_reference=contact.slip_reference - discrete.at_contact(discrete.fixed_values),
            ),
            volumes=discrete.volumes.from_prescribed(discrete),
        )

    def _motions_at_contact(self, discrete: DiscreteProblem, scales: np.ndarray) -> np.ndarray:
        """Return M (n_dofs, n): the free parts of the displacements of contact nodes in each motion of
        the size ``scales`` (n,)."""
        contact = discrete.contact
        points = cast("np.ndarray", discrete.coordinates)
        moves = np.zeros((discrete.n_nodes, discrete.dim, self.n_motions))
        for part in self.parts:
            nodes = contact.nodes[contact.boundary == part.number]
            arms = points[nodes] - self.controls.rigid[cast("int", part.number)].about
            of_unit = _rigid_moves(arms)[:, list(part.free)].transpose(0, 2, 1)
            moves[nodes, :, part.indices] = of_unit * scales[part.indices]
        return np.stack([discrete.free_part(moves[:, :, k]) for k in range(self.n_motions)], axis=1)


@dataclass(frozen=True)
class _Trial(Generic[Carried]):
    """A contact problem with prescribed motions."""

    values: np.ndarray  # (n,): of the unknowns, over their sizes
    missed: np.ndarray  # (n,): its forces minus the prescribed ones, over their sizes
    result: Result
    carried: Carried
    loosened: bool  # whether it was solved to a larger tolerance than that of the solver, one that sufficed


class _Exhausted(Exception):
    """The contact problems of a step have taken all cycles of its solver."""


class Search(Generic[Carried]):
    """The search for motions on the finest level, with the arguments of :meth:`Controls.find`. ``last``
    is the last trial."""

    last: _Trial[Carried]

    def __init__(
        self,
        controls: Controls,
        parts: Sequence[_Unknowns],
        solve: Solve[Carried],
        limit: float,
        rtol: Callable[[], float],
    ) -> None:
        self.controls = controls
        self.parts = parts
        self.solve = solve
        self.limit = limit
        self.rtol = rtol
        #: cycles after which no contact problem begins
        self.budget = np.inf
        self.sizes = np.concatenate([part.sizes for part in parts])
        self.spent: list[Result] = []

    def trial_at(
        self, values: np.ndarray, near: _Trial[Carried] | None, loose: float = 0.0
    ) -> _Trial[Carried]:
        """Return the solved contact problem with these ``values`` (n,) of the unknowns, over their sizes,
        which starts from the trial ``near`` to it; ``loose`` is the tolerance that suffices."""
        if self.cycles >= self.budget:
            raise _Exhausted
        motions = self.controls.motions_of(self.parts, values * self.sizes)
        # callers take a share of the force that was missed, which is many times the prescribed one where
        # a bolt was shortened too far
        loose = min(loose, _LOOSE)
        result, carried = self.solve(motions, None if near is None else near.result, loose)
        self.spent.append(result)
        missed = self.controls.missing_forces(self.parts, result)
        _LOG.debug("motions %s miss their forces by %s of their size", motions, missed)
        # multigrid takes the larger one of both tolerances; other solvers, and the problem that sets rtol, ignore
        # ``loose``, and rounding may widen both
        self.last = _Trial(
            values, missed, result, carried, loosened=result.rtol == loose > self.rtol()
        )
        return self.last

    @property
    def cycles(self) -> int:
        """Return the cycles of all contact problems so far."""
        return sum(trial.cycles for trial in self.spent)

    def reached(self, trial: _Trial[Carried]) -> bool:
        """Return whether the forces are as prescribed."""
        most = ACCURACY * trial.result.rtol
        return not trial.loosened and bool(np.abs(trial.missed).max() <= most)

    def run(self, trial: _Trial[Carried], guide: Guide | None) -> _Trial[Carried]:
        """Return the last trial of Broyden's method, whose steps are Newton's with Jacobians that each
        trial updates.

        The first Jacobian is that of the guide, if there is one. If it has none, or its step does not
        reduce what is missed to the share ``_SLOW``, the guide gives better values, and the method
        begins there without it: Jacobians come by differences. Their steps are always accepted; where
        an updated one reduces hardly anything, differences at the same trial replace it."""
        reach = 1.0  # size of the last changes of the values, to which differences are scaled
        jacobian = None
        # the limit counts the cycles from this first trial on, not those that shorten bolts before it
        self.budget = self.cycles - trial.result.cycles + self.limit
        while trial.result.status.ok and not self.reached(trial) and len(self.spent) < _MOST:
            by_differences = jacobian is None and guide is None
            if jacobian is None and guide is not None:
                jacobian = guide.stiffness(trial.values)
                if jacobian is None:
                    trial = self.trial_at(guide.better_values(trial.values, trial.missed), None)
                    guide = None
                    continue
            elif jacobian is None:
                if trial.loosened:  # as accurate as the differences
                    trial = self.trial_at(trial.values, trial, _EXACT * reach)
                jacobian = self.differences(trial, reach)
            change = self.newton_change(jacobian, trial.missed, by_differences)
            missed_size = max(np.abs(trial.missed).max(), trial.result.rtol)
            new = self.trial_at(trial.values + change, trial, _LOOSE * missed_size)
            new_missed_size = np.abs(new.missed).max()
            if guide is not None and new_missed_size > _SLOW * missed_size:
                trial = self.trial_at(guide.better_values(trial.values, trial.missed), None)
                guide = None
                continue
            if not by_differences and new_missed_size > 0.9 * missed_size:
                # hardly a reduction: differences at the same trial replace a Jacobian that was updated. With
                # .45, .99 and 1.8 the cycles of 9 paths with a pressed, tilted punch or a bolt are unchanged
                jacobian = None
                continue
            # J + (F(z + d) - F(z) - J d) d' / d'd
            update = new.missed - trial.missed - jacobian @ change
            jacobian = jacobian + np.outer(update, change) / max(change @ change, _TINY)
            # a change that happens to be tiny shortens the next differences to a tenth at most; a twentieth and
            # a fifth change no cycles of those paths
            reach = max(np.abs(change).max(), 0.1 * reach)
            trial = new
        return trial

    def newton_change(
        self, jacobian: np.ndarray, missed: np.ndarray, by_differences: bool
    ) -> np.ndarray:
        """Return the change d (n,) of least size with J d = -``missed`` (n,), J the ``jacobian``
        (n, n), in the directions of forces that resist, where the singular values of J are not
        rounding; ValueError where differences show that nothing resists a direction in which forces
        are missed.

        Changes are over the sizes of the unknowns, forces (the actual minus the prescribed ones) over
        theirs: J has no units."""
        left_vectors, stiffnesses, right_vectors = np.linalg.svd(jacobian)
        # errors of J by differences: the tolerance of their contact problems, _EXACT * reach, over their step,
        # _DIFFERENCE * reach, with the size ``reach`` of the last changes. Values above 1, of a single node, are those
        # of friction where supports hold: they say nothing of other directions
        noise = _EXACT / _DIFFERENCE if by_differences else 0.0
        resisted = stiffnesses > max(checks.SIX_DIGITS * min(1.0, stiffnesses[0]), noise)
        components = left_vectors.T @ missed
        # an unresisted force that is missed by more than a thousandth of its size cannot be met
        if by_differences and np.abs(components[~resisted]).max(initial=0.0) > 1e-3:
            raise nothing_resists(self.parts)
        return -right_vectors[resisted].T @ (components[resisted] / stiffnesses[resisted])

    def differences(self, trial: _Trial[Carried], reach: float) -> np.ndarray:
        """Return the Jacobian (n, n) at a trial, by differences over a share of ``reach``."""
        step = _DIFFERENCE * reach
        moved = [
            self.trial_at(trial.values + change, trial, _EXACT * reach)
            for change in step * np.eye(len(trial.values))
        ]
        return np.stack([(there.missed - trial.missed) / step for there in moved], axis=1)

    def pulled(self, trial: _Trial[Carried]) -> _Trial[Carried]:
        """Return the first trial in which every bolt pulls; each is shortened until something
        resists it."""
        for doubling in range(_DOUBLINGS):
            change = np.zeros(len(trial.values))
            for part in self.parts:
                target = part.targets[0] / part.force_sizes[0]
                # the force in the bolt, over its size, is the prescribed one plus what is missed
                if part.number is None and target + trial.missed[part.first] < _PULLS * target:
                    # over the size of its strain
                    change[part.first] = 2.0**doubling
            if not change.any():
                return trial
            trial = self.trial_at(trial.values + change, trial, _LOOSE)
        raise nothing_resists(self.parts)


def _numbers(values: Iterable[float | None]) -> list[float]:
    """Return values with -1e300 in place of None."""
    return [-1e300 if value is None else value for value in values]


def nothing_resists(parts: Sequence[_Unknowns]) -> ValueError:
    """Return the error for forces that no motion meets."""
    return ValueError(
        f"nothing resists {', '.join(repr(part.name) for part in parts)}: no body, or no friction, "
        "opposes a prescribed force or moment: press towards the body, write None for it, add "
        "friction, take a moment about= a point near contact, or hold a bolt at both ends"
    )


def _rigid_moves(arms: np.ndarray) -> np.ndarray:
    """Return the displacements (n, 3 or 6, dim) of points with these arms (n, dim) in each rigid motion
    of size 1: translations, then rotations."""
    n, dim = arms.shape
    axes = np.eye(3) if dim == 3 else np.eye(3)[2:]  # of rotation: in the plane z alone
    spatial = np.pad(arms, ((0, 0), (0, 3 - dim)))
    rotations = np.cross(axes, spatial[:, None])[:, :, :dim]
    return np.concatenate([np.broadcast_to(np.eye(dim), (n, dim, dim)), rotations], axis=1)
