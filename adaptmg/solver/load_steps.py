r"""What load steps keep: KeptMultigrid, the truncated multigrid, set up once, and Controls, what a
force prescribes.

Matrices, transfers, and the lists by which the contact status changes coarse matrices stay; loads,
gaps and slip references change. The nested start of a step carries only what the step changes:
level l solves its step from

.. math:: u_l^{k-1} + P\,(u_{l-1}^k - u_{l-1}^{k-1}),

with its history :math:`u_l^0, u_l^1, \dots` and slips measured against that. The error of such a
start is the discretisation error of the increment, not of the whole displacement; it finds nodes
that stick, and slips that turn round when a load is taken back, where the interpolation of the
whole displacement would let every node slip.

The motion of a Rigid obstacle and the strain of a Preload, which transmit a force, are a few
unknowns z next to the contact problem, with the equations

.. math:: F(z) = F^* : \quad \text{resultant and moment of the contact forces of an obstacle, force across a cut} .

Each F is a contact problem with z prescribed; z is found by Broyden's method (C. T. Kelley, Solving
Nonlinear Equations with Newton's Method, SIAM 2003, doi:10.1137/1.9780898718898) from a Jacobian by
differences. The first one is taken where an obstacle has just met the body; contact stiffens, so
that a step from there is at most four times the depth."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import TypeVar

import numpy as np
from scipy.sparse.linalg import lsmr

from adaptmg.discrete.stress import cut_force, cut_stiffness
from adaptmg.hierarchy import Hierarchy
from adaptmg.level import Level
from adaptmg.multigrid.cycle import NestedStart
from adaptmg.multigrid.rigid_motions import RigidMotions
from adaptmg.multigrid.truncated_step import TruncatedStep
from adaptmg.multigrid.volume_pressures import prolonged_pressures
from adaptmg.problem.contact_problem import Contact, ContactProblem
from adaptmg.problem.loads import Preload
from adaptmg.problem.surfaces import Moving, Rigid, moving_parts, placed
from adaptmg.smoother.system import local_contact
from adaptmg.solver.examine import Examiner
from adaptmg.solver.iterate import StopTest
from adaptmg.solver.multigrid import FullMultigrid, Multigrid
from adaptmg.solver.record import Outcome, Run, Status
from adaptmg.solver.result import Result
from adaptmg.solver.truncated import Truncated, TruncatedRun

_LOG = logging.getLogger(__name__)
Kept = TypeVar("Kept")

#: forces are met to this multiple of rtol
ACCURACY = 10.0
_MOST = 40  # contact problems in a step
_GROWTH = 4.0  # of the depth of an obstacle, in a step of the iteration
_DIFFERENCE = 0.02  # of the size of the unknowns so far
_UNRESISTED = 1e-5  # of the largest stiffness
#: displacement (n_dofs,) of the finest level, and pressures of its volumes, if it has them
Start = tuple[np.ndarray, np.ndarray | None]


@dataclass(frozen=True, eq=False)
class Past:
    """What is known before a step."""

    levels: list[np.ndarray]  # displacements (n_dofs,) after the step before, coarsest level first
    last: Start  # after the step before
    extrapolated: Start
    given: bool  # whether there is a step before


def better_start(examiner: Examiner, past: Past, run: Run) -> np.ndarray:
    """Return the displacement of the step before or the extrapolated one, the one with the smaller
    residual."""
    with run.phase("start"):
        starts = past.last, past.extrapolated
        displacement, run.pressures = min(
            starts, key=lambda start: examiner.relative_residual(*start)
        )
    return displacement


def coarse_displacements(hierarchy: Hierarchy, displacement: np.ndarray) -> list[np.ndarray]:
    """Return a displacement of the finest level on all discretised ones: the next coarser ones that
    interpolate it best."""
    result = [displacement]
    for level in reversed(hierarchy.levels[1:] if hierarchy.discretised else ()):
        columns = result[0].reshape(level.n_nodes, -1).T
        nodal = [lsmr(level.prolongation, column, atol=1e-8, btol=1e-8)[0] for column in columns]
        result.insert(0, np.stack(nodal, axis=1).reshape(-1))
    return result


class KeptMultigrid(TruncatedRun):
    """The truncated multigrid for a sequence of steps."""

    def __init__(
        self, parts: Truncated, hierarchy: Hierarchy, run: Run, rtol: float | str, max_cycles: int
    ) -> None:
        super().__init__(parts, hierarchy, run, rtol, max_cycles)
        self._steps: dict[int, TruncatedStep] = {}

    def take(self, hierarchy: Hierarchy, run: Run) -> None:
        """Go on to the next step: ``hierarchy`` differs in loads, prescribed values and slip
        references only. What the steps before leave in coarse factors is forgotten: a path that is
        resumed has the same bits."""
        self.hierarchy, self.run, self.cycle.recorder = hierarchy, run, run
        self.problems = [level.discrete_or_none for level in hierarchy.levels]
        self.pressures = run.pressures
        self.cycle.factors.forget()
        if len(hierarchy) - 1 in self._steps:
            with run.phase("setup"):
                self._steps[len(hierarchy) - 1].truncation.restore()

    def increment(self, start: NestedStart, past: list[np.ndarray]) -> list[np.ndarray]:
        """Return the displacements (n_dofs,) of all levels from which a step begins."""
        result: list[np.ndarray] = []
        for number, problem in enumerate(self.problems):
            if number == 0:
                unknowns = self._solve_coarsest(start, past[0] if past[0].any() else None)
            else:
                change = (result[-1] - past[number - 1]).reshape(-1, problem.dim)
                unknowns = past[number] + (self.cycle.levels[number].prolongation @ change).reshape(
                    -1
                )
                unknowns = problem.from_prescribed(unknowns)
                self.pressures = prolonged_pressures(
                    self.problems[number - 1],
                    problem,
                    self.cycle.levels[number].prolongation,
                    self.pressures,
                )
                self.run.visit(number, "start")
                if number < len(self.problems) - 1:
                    unknowns = self._start_cycles(number, unknowns, start)
            result.append(problem.with_prescribed(unknowns))
        if self.run.pressures is not None:
            self.pressures = self.run.pressures
        self.run.start_work_units = self.run.work_units
        return result

    def _step(self, number: int, unknowns: np.ndarray) -> TruncatedStep:
        if number not in self._steps:
            self._steps[number] = super()._step(number, unknowns)
            return self._steps[number]
        step, problem = self._steps[number], self.problems[number]
        with self.run.phase("setup"):
            data, _ = local_contact(problem)
            contact, load = step.contact, problem.load_from_prescribed()
            contact.renew(data)
            contact.start(unknowns)
            if step.pressures is not None:
                step.pressures.pose(problem, self.pressures)
            step.pose(load, unknowns, RigidMotions.of(problem, contact, load))
        return step


class TruncatedSteps:
    """The truncated multigrid, with or without nested start."""

    #: extrapolation is taken where it leaves less than this share of the residual of the nested start, whose error
    #: is rough and soon smoothed away
    EXTRAPOLATE = 0.05

    def __init__(self, solver: Multigrid) -> None:
        self.parts, self.rtol, self.max_cycles = solver.correction, solver.rtol, solver.max_cycles
        self.start = solver.start if isinstance(solver, FullMultigrid) else None
        self.multigrid: KeptMultigrid | None = None

    def run(
        self, hierarchy: Hierarchy, examiner: Examiner, run: Run, past: Past
    ) -> tuple[Outcome, list[np.ndarray] | None]:
        multigrid, coarse, kind = self.multigrid, None, "given" if past.given else "zero"
        if multigrid is None or not hierarchy.finest.discrete.alike(multigrid.problems[-1]):
            multigrid = KeptMultigrid(self.parts, hierarchy, run, self.rtol, self.max_cycles)
        else:
            multigrid.take(hierarchy, run)
        multigrid.rtol = self.rtol
        if self.start is not None:
            *coarse, start = multigrid.increment(self.start, past.levels)
            kind = "given" if past.given else "nested"
            with run.phase("start"):
                # not where the nested start sets the tolerance
                extrapolated, pressures = past.extrapolated
                if (
                    past.given
                    and self.rtol != "discretisation"
                    and examiner.relative_residual(extrapolated, pressures)
                    <= self.EXTRAPOLATE * examiner.relative_residual(start, multigrid.pressures)
                ):
                    start, multigrid.pressures = extrapolated, pressures
        else:
            start = (
                better_start(examiner, past, run)
                if past.given
                else np.zeros(examiner.discrete.n_dofs)
            )
            multigrid.pressures = run.pressures
        outcome = multigrid.finish(examiner.discrete.from_prescribed(start), kind)
        self.hold(outcome.rtol)
        # what a cycle that ran away leaves behind is not used again
        self.multigrid = None if outcome.left else multigrid
        return outcome, coarse

    def hold(self, rtol: float) -> None:
        """Keep the tolerance that the discretisation error of the first step has set: increments
        have smaller ones."""
        if self.rtol == "discretisation":
            self.rtol = max(rtol, StopTest.ROUNDING_LIMIT)


@dataclass(frozen=True)
class _Unknowns:
    """The numbers of one obstacle or preload: where they begin, and what they are measured by."""

    name: str
    first: int
    targets: np.ndarray  # (n,)
    sizes: np.ndarray  # (n,): displacements in m, rotations in rad, strains
    forces: np.ndarray  # (n,)
    free: tuple[int, ...] = (0,)
    number: int = -1  # of the contact of an obstacle

    @property
    def own(self) -> slice:
        return slice(self.first, self.first + len(self.targets))


@dataclass
class Controls:
    """The obstacles and preloads of a problem, from step to step."""

    problem: ContactProblem | None
    level: Level
    #: motions (3 in the plane, 6 in space) of obstacles, strains (1) of preloads, by name
    motions: dict[str, np.ndarray] = field(default_factory=dict)
    factors: dict[str, float] = field(default_factory=dict)  # of the step before
    places: dict[int, Moving] = field(
        init=False
    )  # of all moving obstacles at the end of the step before

    def __post_init__(self) -> None:
        contacts, loads = (
            ((), ()) if self.problem is None else (self.problem.contact, self.problem.loads)
        )
        self.obstacles = {
            k: one.obstacle for k, one in enumerate(contacts) if isinstance(one, Contact)
        }
        self.rigid = {k: one for k, one in self.obstacles.items() if isinstance(one, Rigid)}
        self.bolts = [load for load in loads if isinstance(load, Preload)]
        for obstacle in self.rigid.values():
            self.motions[obstacle.name] = np.zeros(3 * obstacle.dim - 3)
        for bolt in self.bolts:
            self.motions[bolt.path_name] = np.zeros(1)
        self.places = self.placed({}, {})  # from there the discretisation counts slips

    def posed(self) -> list[list[float]]:
        """Return the prescribed motions and forces as numbers, for stores; -1e300 where nothing is
        prescribed."""
        result = [
            [*np.nan_to_num(one.targets, nan=-1e300), *one.about]
            if isinstance(one, Rigid)
            else [*one.displacement, *one.rotation, *one.about]
            for obstacle in self.obstacles.values()
            for one in moving_parts(obstacle)
        ]
        result += [
            [bolt.force, bolt.direction, -1e300 if bolt.at is None else bolt.at]
            for bolt in self.bolts
        ]
        return [list(map(float, one)) for one in result]

    def unknowns(self, factors: Mapping[str, float]) -> list[_Unknowns]:
        """Return what is to be found in a step with these factors."""
        result: list[_Unknowns] = []
        if not self.rigid and not self.bolts:
            return result
        mesh, discrete = self.level.mesh, self.level.discrete
        stiffness = float(
            np.abs(discrete.matrix.data[:, range(discrete.dim), range(discrete.dim)]).max()
        )
        first = 0
        for number, obstacle in self.rigid.items():
            name, dim = obstacle.name, obstacle.dim
            if not factors[name] > 0:
                raise ValueError(
                    f"the factor of {name!r}, which a force presses, must be > 0, got {factors[name]:g}: "
                    "begin and end with a small one"
                )
            targets = factors[name] * obstacle.targets[list(obstacle.free)]
            force = float(np.linalg.norm(np.nan_to_num(obstacle.targets[:dim]))) * factors[name]
            nodes = mesh.surface(self.problem.contact[number].boundary).nodes
            size = float(np.linalg.norm(np.ptp(mesh.points[nodes], axis=0)))
            turns = np.arange(3 * dim - 3)[list(obstacle.free)] >= dim
            result.append(
                _Unknowns(
                    name,
                    first,
                    targets,
                    force / stiffness / np.where(turns, size, 1.0),
                    force * np.where(turns, size, 1.0),
                    obstacle.free,
                    number,
                )
            )
            first += len(targets)
        for bolt in self.bolts:
            name = bolt.path_name
            if factors[name] == self.factors.get(name, 0.0):
                continue
            size = bolt.force / cut_stiffness(mesh, self.problem.material, bolt)
            result.append(
                _Unknowns(
                    name,
                    first,
                    np.array([factors[name] * bolt.force]),
                    np.array([size]),
                    np.array([bolt.force]),
                )
            )
            first += 1
        return result

    def start(self, parts: Sequence[_Unknowns]) -> np.ndarray:
        """Return the start of the iteration: the end of the step before; the first time obstacles
        approach the body."""
        return np.concatenate(
            [
                self.motions[part.name][list(part.free)]
                if self.motions[part.name].any()
                else self._approach(part)
                if part.number >= 0
                else part.sizes
                for part in parts
            ]
        )

    def _approach(self, part: _Unknowns) -> np.ndarray:
        """The motion along the force that brings an obstacle to the body."""
        obstacle, contact = self.rigid[part.number], self.level.discrete.contact
        dim, own = obstacle.dim, contact.boundary == part.number
        along = np.nan_to_num(obstacle.targets[:dim])
        along = along / np.linalg.norm(along)
        towards = -contact.normals[own] @ along
        if not (towards > 0).any():
            raise ValueError(
                f"the force of {part.name!r} pulls it away from the body: it must press, along minus the "
                "outward normal of the contact boundary"
            )
        way = max(0.0, float(np.min(contact.gaps[own][towards > 0] / towards[towards > 0])))
        motion = np.zeros(3 * dim - 3)
        motion[:dim] = along * (way + part.sizes[0] if part.free[0] < dim else way)
        return motion[list(part.free)]

    def taken(self, parts: Sequence[_Unknowns], values: np.ndarray) -> dict[str, np.ndarray]:
        """Return the motions with the values (n,) of the unknowns."""
        result = dict(self.motions)
        for part in parts:
            motion = result[part.name].copy()
            motion[list(part.free)] = values[part.own]
            result[part.name] = motion
        return result

    def placed(
        self, factors: Mapping[str, float], motions: Mapping[str, np.ndarray]
    ) -> dict[int, Moving]:
        """Return all moving obstacles in their places, by the number of their contact."""
        places = {k: placed(obstacle, factors, motions) for k, obstacle in self.obstacles.items()}
        return {k: place for k, place in places.items() if isinstance(place, Moving)}

    def missed(self, parts: Sequence[_Unknowns], result: Result) -> np.ndarray:
        """Return by how much the forces of a result miss what is prescribed (n,), relative to the
        sizes of forces."""
        missed = []
        for part in parts:
            if part.number >= 0:
                obstacle = self.rigid[part.number]
                total = result.resultant(
                    self.problem.contact[part.number].boundary, about=obstacle.about
                )
                have = np.concatenate([total.force, np.atleast_1d(total.moment)])[list(part.free)]
            else:
                bolt = next(one for one in self.bolts if one.path_name == part.name)
                have = np.array(
                    [cut_force(result.mesh, result.stress_data, result.displacement, bolt)]
                )
            missed.append((have - part.targets) / part.forces)
        return np.concatenate(missed)

    def find(
        self,
        parts: Sequence[_Unknowns],
        solve: Callable[[dict[str, np.ndarray], Result | None], tuple[Result, Kept]],
    ) -> tuple[Result, Kept, dict[str, np.ndarray]]:
        """Return the result, what is kept of it, and the motions with which the forces are as
        prescribed; ``solve`` takes motions and a result near theirs. Cycles, work and seconds are
        those of all contact problems together."""
        sizes = np.concatenate([part.sizes for part in parts])
        spent: list[tuple[int, float, dict[str, float]]] = []

        def at(values: np.ndarray, near: Result | None) -> tuple[np.ndarray, tuple[Result, Kept]]:
            solved = solve(self.taken(parts, values * sizes), near)
            spent.append((solved[0].cycles, solved[0].work_units, solved[0].timings))
            missed = self.missed(parts, solved[0])
            _LOG.debug("motions %s miss their forces by %s of their size", values * sizes, missed)
            return missed, solved

        values, jacobian, reach = self.start(parts) / sizes, None, 1.0
        missed, (result, kept) = at(values, None)
        last = result

        def reached() -> bool:
            return bool(np.abs(missed).max() <= ACCURACY * result.rtol)

        while not reached() and last.status.ok and len(spent) < _MOST:
            fresh = jacobian is None
            if fresh:
                steps = _DIFFERENCE * reach * np.eye(len(values))
                jacobian = np.stack(
                    [(at(values + step, result)[0] - missed) / step.max() for step in steps], axis=1
                )
            left, values_of, right = np.linalg.svd(jacobian)
            noise = result.rtol / (_DIFFERENCE * reach)
            resisted = values_of > max(_UNRESISTED * values_of[0], noise)
            along = left.T @ missed
            if fresh and np.abs(along[~resisted]).max(initial=0.0) > 1e-3:
                raise ValueError(
                    "nothing resists "
                    + ", ".join(repr(part.name) for part in parts)
                    + ": no body, or no "
                    "friction, opposes a prescribed force or moment: write None for it, add friction, "
                    "take a moment about= a point near contact, or hold a bolt at both ends"
                )
            change = -right[resisted].T @ (along[resisted] / values_of[resisted])
            change *= min(1.0, _GROWTH * reach / np.abs(change).max())
            new, solved = at(values + change, result)
            last = solved[0]
            if not fresh and np.abs(new).max() > 0.9 * np.abs(missed).max():
                jacobian = None
                continue
            jacobian = jacobian + np.outer(new - missed - jacobian @ change, change) / (
                change @ change
            )
            reach = max(np.abs(change).max(), 0.1 * reach)
            values, missed, (result, kept) = values + change, new, solved
        if result.status.ok and not reached():
            _LOG.warning(
                "forces of %s are missed by %.1e of their size after %d contact problems",
                ", ".join(part.name for part in parts),
                np.abs(missed).max(),
                len(spent),
            )
            result = replace(result, status=Status.LIMIT, mesh=result.mesh_or_none)
        cycles, work, seconds = zip(*spent, strict=True)
        timings = {
            name: sum(one.get(name, 0.0) for one in seconds)
            for name in dict.fromkeys(chain(*seconds))
        }
        result = replace(
            result,
            cycles=sum(cycles),
            work_units=sum(work),
            timings=timings,
            mesh=result.mesh_or_none,
        )
        return result, kept, self.taken(parts, values * sizes)

    def take(self, factors: Mapping[str, float], motions: Mapping[str, np.ndarray]) -> None:
        """Go past a step."""
        self.factors, self.motions = dict(factors), dict(motions)
        self.places = self.placed(factors, motions)
