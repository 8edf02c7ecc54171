r"""march: bodies that move, hit each other and rebound, step by step in time.

With the lumped mass M, the stiffness K, the loads f and the time step :math:`\tau` a step of the
contact-stabilised Newmark method (P. Deuflhard, R. Krause, S. Ertel, Int. J. Numer. Meth. Engng. 73,
2008, doi:10.1002/nme.2119) takes the free motion :math:`\tilde u = u^k + \tau v^k` to the nearest
admissible one :math:`u_p` in the norm of M, and solves the contact problem

.. math:: \Big(\tfrac12 K + \tfrac{\beta}{\tau} K + \tfrac{2}{\tau^2} M\Big) u^{k+1} =
   f - \tfrac12 K u^k + \tfrac{\beta}{\tau} K u^k + \tfrac{2}{\tau^2} M u_p + F,\qquad
   v^{k+1} = v^k + \tfrac{2}{\tau}\,(u^{k+1} - u_p)

with the damping :math:`\beta`. Its contact forces F are the means over the step, and friction acts on
the slip of the step. The energy changes by

.. math:: F \cdot (u^{k+1} - u^k) - \tfrac{2}{\tau^2}\,(u_p - \tilde u)\cdot M\,(u^{k+1} - u_p)
   - \tfrac{\beta}{\tau}\,(u^{k+1} - u^k)\cdot K\,(u^{k+1} - u^k),

where no term is positive: friction, contact and damping take energy, and nothing adds any. The
matrix does not depend on the step, and has an inverse without supports: what multigrid sets up for
it stays from step to step. Bodies that nothing holds are solved for relative to their mean
displacement, so that errors do not grow with the distance that they fly."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property, partial
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._text import say
from adaptmg._threads import one_blas_thread
from adaptmg.discrete.coordinates import to_frames
from adaptmg.discrete.discretise import assembled
from adaptmg.discrete.elasticity import nodes_of_pieces
from adaptmg.discrete.inertia import lumped_mass, nodal_velocity, with_mass
from adaptmg.discrete.loads import supported_stiffness
from adaptmg.discrete.named_loads import load_steps
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import StressData
from adaptmg.discrete.supports import supported_nodes
from adaptmg.evolution.load_steps import Past, step_outcome
from adaptmg.evolution.path_loop import is_on
from adaptmg.grids import Grids
from adaptmg.multigrid.truncated_parts import Truncated
from adaptmg.problem.dynamics import Dynamics
from adaptmg.problem.laws import Frictionless
from adaptmg.problem.load_path import obstacles_in_path
from adaptmg.problem.loads import PointSpring, Spring
from adaptmg.solver.active_set import ActiveSet
from adaptmg.solver.advice import advise_on_motion, advise_on_problem, once
from adaptmg.solver.examine import ContactResult, Examiner, euclidean_norm
from adaptmg.solver.iterate import StopTest
from adaptmg.solver.multigrid import Multigrid, handed_over
from adaptmg.solver.outcome import (
    checked_outcome,
    displacement_argument,
    grids_argument,
    method_argument,
    result_of,
)
from adaptmg.solver.record import Run, Solver
from adaptmg.solver.result import KINDS, NotConverged, Result
from adaptmg.solver.store import StepStore, fingerprint
from adaptmg.solver.truncated import TruncatedRun

_HEAD = "march.json"
#: of the size of the mesh: an overlap at the start that is refused. Round bodies that touch overlap a
#: little on their meshes: a ball of Hertz by 1e-7 on its default ones
_OVERLAP = checks.SIX_DIGITS
#: the largest tolerance that rounding makes of a smaller one: where waves pass a million cells in a step. Flights
#: of steel by 40 000, 400 000 and 4 000 000 cells a step end alike with half, twice and ten times as much, .0005,
#: .04 and 6 % off after 30 steps
_MOST_ROUNDING = 1e-3


@one_blas_thread()
def march(
    grids: Grids,
    dynamics: Dynamics,
    method: Solver | None = None,
    *,
    start: ArrayLike | Result | None = None,
    rtol: float | None = None,
    certify_every: int = 10,
    store: str | os.PathLike[str] | None = None,
    depends: Mapping[str, object] | None = None,
    throw: bool = True,
    progress: Callable[[int, dict[str, float]], None] | bool | None = None,
) -> Iterator[Result]:
    """Follow bodies in time: a contact problem for each time step, on the finest level of a
    hierarchy.

    The method is the contact-stabilised Newmark method (:mod:`adaptmg.evolution.march`), of second
    order without contact. Loads and supports are constant in time. Bodies need no supports.

    Parameters
    ----------
    grids : Hierarchy
        Of meshes, made from a ContactProblem. ValueError for Rigid and Moving obstacles, Preload,
        NormalCompliance, and smoothed elements with Poisson's ratios above .4.
    dynamics : Dynamics
        Densities, initial velocities, time step, end and damping.
    method : SingleGrid, Multigrid, FullMultigrid, ActiveSet or user-defined, optional
        The solver of a time step; default that of :func:`adaptmg.solve_path`. It begins at the free
        motion, so that FullMultigrid goes on as a Multigrid.
    start : (n_nodes, dim) array or Result, optional
        Displacement at time 0, m; default 0. Under weight, that of ``am.solve(grids)`` begins at
        rest. A step of another march is refused, as its velocity would be lost: ``store`` lets a
        march go on.
    rtol : float, optional
        Tolerance of the default method, where none is given; default as of :func:`adaptmg.solve`.
        The error is relative to the displacement in the norm of the matrix of a time step, of
        bodies that nothing holds without the mean displacement before the step: the energy changes
        by about ``rtol`` of the kinetic energy in a step.
    certify_every : int
        The first step, and each one after this number of steps, is certified; others end by the
        estimate of the method, and their result has no certificate.
    store : path, optional
        A folder where every finished step is kept immediately, as a file that
        :meth:`adaptmg.Result.load` reads. A march that was interrupted, or had an earlier end, goes
        on there with the same bits; a folder of another march is refused.
    depends : mapping of str to value, optional
        For the store, as of :func:`adaptmg.solve_path`.
    throw : bool
        Raise NotConverged if a step does not reach the tolerance. False ends the march with that
        step, whose status says it.
    progress : callable or bool, optional
        Called with the number of the step, from 0 on, and each row of its history. True: write a line a
        step to standard error.

    Yields
    ------
    Result
        At the end of each step: ``time``, displacement, ``velocity``, ``energies``; forces are means
        over the step, slips those of the step.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.impact_bar(), divisions=((1, 10), (2, 20)))
    >>> dynamics = am.Dynamics(density=1.0, initial_velocity=(0.0, -10.0), step=0.02, end=0.1)
    >>> for result in am.march(grids, dynamics):
    ...     speed = result.velocity[:, 1].mean()
    >>> round(float(speed), 9), round(result.time, 3)
    (-10.0, 0.1)
    """
    checks.instance("dynamics", dynamics, Dynamics, "am.Dynamics(density=, step=, end=)")
    checks.integer("certify_every", certify_every, 1)
    checks.flag("throw", throw)
    if not isinstance(progress, bool):
        checks.optional_callable(
            "progress", progress, "the number of a step and a row of its history (or a bool)"
        )
    step_grids, solver, choice = method_argument(method, _time_step_grids(grids, dynamics), rtol)
    if isinstance(getattr(solver, "rtol", None), str):
        raise ValueError("method: rtol must be a number in a march, got 'discretisation'")
    loop = March(step_grids, dynamics, solver, choice, start)
    steps = None
    if store is not None:
        # neither the end nor the number of steps matters to a step
        parts = {
            "method": solver,
            "dynamics": replace(dynamics, end=dynamics.step),
            "certify_every": certify_every,
            "start": loop.displacement,
        }
        loads = [load_steps(loop.posed, loop.discrete)]
        march_fingerprint = fingerprint(step_grids, loads, {}, 1, parts, depends)
        steps = StepStore.resumed(store, _HEAD, {"fingerprint": march_fingerprint}, KINDS)
    return _results(loop, steps, certify_every, throw, progress)


def _results(
    loop: March,
    store: StepStore | None,
    certify_every: int,
    throw: bool,
    progress: Callable[[int, dict[str, float]], None] | bool | None,
) -> Iterator[Result]:
    """Yield the results of the steps, those of the store first."""
    n_steps = loop.dynamics.n_steps
    first = 0
    for stored in () if store is None else store.steps(n_steps):
        loop.take(stored.value)
        yield stored.value
        first += 1
    warned_kinds: set[str] = set()  # each kind of warning is given once in a march
    for k in range(first, n_steps):
        callback = partial(progress, k) if callable(progress) else None
        with one_blas_thread(), once(warned_kinds):
            result = loop.step(k, k % certify_every == 0, callback)
        if progress is True:
            say(
                f"step {k} of {n_steps}, {result.time:.4g} s: {result.status.name} after "
                f"{result.cycles} cycles and {result.seconds:.2g} s"
            )
        if not result.status.ok:
            if not throw:
                yield result
                return
            error = NotConverged(result)
            error.add_note(f"in time step {k} of {n_steps}: a smaller step is easier to solve")
            raise error
        if store is not None:
            store.put(k, result)
        yield result


def _time_step_grids(grids: Grids, dynamics: Dynamics) -> Grids:
    """Return the hierarchy with the matrices of a time step; ValueError for problems
    that march does not solve."""
    grids = grids_argument(grids)
    problem = grids.problem
    posed = [grids.posed_on(level) for level in grids.levels]
    if any(posed_level is None for posed_level in posed):
        raise ValueError(
            "grids must be levels with meshes, made from a ContactProblem: masses come from them"
        )
    compliant = any(contact.compliance is not None for contact in problem.contact)
    if problem.by_force or obstacles_in_path(problem) or compliant:
        raise ValueError(
            "grids: march has no Rigid or Moving obstacles, no Preload and no NormalCompliance: pose "
            "an obstacle that moves as a body with a density, in a ContactPair, a compliance as a "
            "soft body"
        )
    if problem.inelastic:
        raise ValueError("grids: march has no plastic bodies: give all bodies elastic materials")
    grids.finest.discrete.need_no_volumes("march")
    # the matrix of the module: (1/2 + beta/tau) K + 2/tau^2 M
    levels = []
    for level, posed_level in zip(grids.levels, cast("list[Posed]", posed), strict=True):
        discrete = assembled(
            posed_level,
            effective=partial(
                with_mass,
                factor=0.5 + dynamics.damping / dynamics.step,
                mass=2 / dynamics.step**2 * lumped_mass(posed_level, dynamics),
            ),
        )
        # solvers take coarse matrices of nested posed problems for Galerkin products of the fine one; those
        # with lumped masses are not, so that these levels have no posed problem
        levels.append(level.posing(discrete=discrete, posed=None))
    return replace(grids, levels=tuple(levels))


class March:
    """The time steps of a problem, on a hierarchy with the matrices of a step. Displacement, m,
    velocity, m/s, and internal forces K u, N, all (n_nodes, dim), are those after the last step.
    ``choice`` is the reason for the solver, if it is the default one."""

    def __init__(
        self,
        grids: Grids,
        dynamics: Dynamics,
        solver: Solver,
        choice: str,
        start: ArrayLike | Result | None,
    ) -> None:
        self.grids = grids
        self.dynamics = dynamics
        self.solver = solver
        self.choice = choice
        self.step_solver = solver
        if isinstance(solver, Multigrid) and isinstance(solver.correction, Truncated):
            # with mass no rigid motion is without energy
            correction = replace(solver.correction, rigid_motions=False)
            self.step_solver = replace(solver, correction=correction)
        self.multigrid: TruncatedRun | None = None
        self.discrete = grids.finest.discrete
        self.posed = cast("Posed", grids.posed)
        problem = self.posed.problem
        mesh = self.posed.mesh
        materials = self.posed.materials
        self.stiffness = supported_stiffness(mesh, materials, problem.supports, problem.elements)
        self.stress_data = StressData.of(mesh, materials, problem.loads, problem.elements)
        self.mass = lumped_mass(self.posed, dynamics)[:, None]  # (n_nodes, 1)
        #: Euclidean norm of what rounding of a unit displacement leaves in K u, N/m
        self.rounding = np.finfo(float).eps * euclidean_norm(self.stiffness.diagonal())
        #: the loads f (n_nodes, dim), N
        self.forces = self.discrete.physical_forces(self.discrete.load).reshape(-1, mesh.dim)
        self.free_pieces = self._free_pieces()
        #: the energy lost so far by cause, N m, and the lengths of the slips so far (n_contact,), m
        self.lost_energies = {"friction": 0.0, "contact": 0.0, "damping": 0.0}
        self.accumulated_slip = self.discrete.contact.accumulated_slip
        if isinstance(start, Result) and start.velocity.size:
            raise ValueError(
                "start must be at rest, got a step of a march, which has a velocity: let that march go "
                "on by store= and a later end, or give start=result.displacement and initial_velocity"
            )
        if isinstance(start, Result) and start.mesh is not None and not is_on(start, mesh):
            raise ValueError(
                f"start must be on the finest mesh, which has {mesh.n_nodes} nodes, got a result on "
                f"another mesh of {len(start.displacement)}: carry it over by am.transfer_state"
            )
        first = displacement_argument("start", start, self.discrete)
        relative = np.zeros(mesh.points.shape) if first is None else first
        self.displacement = self._with_prescribed(relative, share=1.0)
        initial_velocity = self.discrete.relative(nodal_velocity(self.posed, dynamics))
        self.velocity = self._with_prescribed(initial_velocity, share=0.0)
        self.internal = self._internal(self.displacement)
        overlap = self._overlap(self.displacement).max(initial=0.0)
        if overlap > _OVERLAP * mesh.sides.max():
            raise ValueError(
                f"start: bodies overlap by {overlap:.3g} m at the start; give start=am.solve(grids)"
            )
        advise_on_problem(self.posed)

    def _free_pieces(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return for each connected piece its nodes, and the mask (dim,) of the axes along which
        certainly nothing holds it: supports count along the axes that their directions have parts of,
        springs along all, as the mask only spares rounding."""
        problem = self.posed.problem
        held = np.any(self.posed.held_spans(np.arange(self.posed.mesh.n_nodes)), axis=2)
        held[:, 0] |= problem.axisymmetric  # hoop strains resist a radial motion
        for support in problem.supports:
            if isinstance(support, Spring | PointSpring):
                held[supported_nodes(self.posed.mesh, support, self.posed.surfaces)] = True
        pieces = nodes_of_pieces(self.posed.mesh)
        return [(nodes, ~np.any(held[nodes], axis=0)) for nodes in pieces]

    def _mean_displacement(self, displacement: np.ndarray) -> np.ndarray:
        """Return the mean displacement (n_nodes, dim) of each body along axes that nothing holds."""
        result = np.zeros_like(displacement)
        for nodes, free in self.free_pieces:
            result[nodes] = np.where(free, displacement[nodes].mean(axis=0), 0.0)
        return result

    def _internal(self, displacement: np.ndarray) -> np.ndarray:
        """Return K u (n_nodes, dim), N."""
        strained = (displacement - self._mean_displacement(displacement)).reshape(-1)
        return (self.stiffness @ strained).reshape(displacement.shape)

    def _with_prescribed(self, relative: np.ndarray, share: float) -> np.ndarray:
        """Return Cartesian vectors (n_nodes, dim) from relative ones, with ``share`` times the values
        that supports and ties prescribe."""
        discrete = self.discrete
        return discrete.physical(discrete.free_part(relative) + share * discrete.fixed_values)

    def _overlap(self, displacement: np.ndarray) -> np.ndarray:
        """Return the overlap (n_contact,), m, at contact nodes: the normal displacement minus the initial
        gap, which is minus the present gap; a sum at nodes that take over a part of others."""
        discrete = self.discrete
        moved = discrete.at_contact(discrete.relative(displacement))
        return np.einsum("nd,nd->n", discrete.contact.normals, moved) - discrete.contact.gaps

    def _admissible(self, displacement: np.ndarray) -> np.ndarray:
        """Return the admissible displacement (n_nodes, dim) that is nearest in the norm of the mass."""
        contact = self.discrete.contact
        overlap = self._overlap(displacement)
        if not overlap.max(initial=0.0) > np.finfo(float).eps * np.abs(displacement).max():
            return displacement
        if self.discrete.coupling is None:
            # the lumped mass of a node is a number: the nearest place without overlap lies along the normal
            result = displacement.copy()
            result[contact.nodes] -= np.maximum(overlap, 0.0)[:, None] * contact.normals
            return result
        problem = self._mass_problem
        # a contact problem for the change, with the matrix M, no load, and the gaps that are left
        gaps = replace(contact, gaps=-overlap, allow_interference=True)
        grids = Grids.single(problem.posing(contact=gaps))
        nearest = ActiveSet().run(grids, Run(unit=problem.rows.nonzeros), None)
        if not nearest.status.ok:
            raise RuntimeError(
                f"no admissible displacement was found next to a free motion: {nearest.status.name}"
            )
        return displacement + problem.physical(nearest.solution)

    @cached_property
    def _mass_problem(self) -> DiscreteProblem:
        """Return the contact problem, without friction and loads, whose matrix is the mass."""
        mass = partial(with_mass, factor=0.0, mass=self.mass[:, 0])
        nothing = np.zeros(self.discrete.n_dofs)
        problem = assembled(self.posed, effective=mass)
        return problem.posing(law=Frictionless(), load=nothing, fixed_values=nothing)

    def step(
        self, k: int, certified: bool, callback: Callable[[dict[str, float]], None] | None
    ) -> Result:
        """Take time step k and return its result."""
        run = Run(unit=self.discrete.rows.nonzeros, callback=callback)
        with run.phase("setup"):
            free = self.displacement + self.dynamics.step * self.velocity  # u + tau v
            admissible = self._admissible(free)
            shift = self._mean_displacement(self.displacement)
            grids = self._posed(admissible, shift)
            discrete = grids.finest.discrete
            examiner = Examiner(discrete, certified=certified)
            run.examiner = examiner if certified else None
            # the step starts at u_p. A start with the acceleration of the step before lets errors whose sign
            # alternates from step to step grow, up to the tolerance
            first = discrete.relative(admissible - shift).reshape(-1)
            loose = self._rounding_tolerance(admissible - shift, discrete.load)
            past = Past(
                last=first, extrapolated=first, has_previous=True, is_start=True, loose=loose
            )
        outcome, self.multigrid, _ = step_outcome(
            self.step_solver, self.multigrid, grids, examiner, run, past
        )
        outcome = handed_over(checked_outcome(outcome, self.solver, discrete), grids, run)
        with run.phase("result"):
            relative = result_of(
                grids, examiner, run, outcome, self.solver, self.stress_data, self.choice
            )
            result = self._complete(k, relative, free, admissible, shift)
            self.take(result)
        if certified:
            advise_on_motion(self.posed, [result])
        return result

    def _rounding_tolerance(self, start: np.ndarray, load: np.ndarray) -> float:
        """Return the tolerance that rounding of K u leaves to a step with a ``start`` (n_nodes, dim), m,
        and a ``load`` (n_dofs,), N: eps |diag K| |u|_max / (RESIDUAL_FACTOR |load|), as residuals may be
        that many tolerances, and at most _MOST_ROUNDING. It is large where bodies have flown far, and a
        step is so long that their mass counts little."""
        rounding = self.rounding * np.abs([self.displacement, start]).max()
        # without a load 1 N is the denominator
        tolerance = rounding / (StopTest.RESIDUAL_FACTOR * euclidean_norm(load) or 1.0)
        return min(tolerance, _MOST_ROUNDING)

    def take(self, result: Result) -> None:
        """Continue after a step with its result."""
        self.displacement = result.displacement
        self.velocity = result.velocity
        self.internal = self._internal(result.displacement)
        self.lost_energies = {cause: result.energies[cause] for cause in self.lost_energies}
        self.accumulated_slip = result.contact.accumulated_slip

    def _posed(self, admissible: np.ndarray, shift: np.ndarray) -> Grids:
        """Return the hierarchy with the problem of a step from the displacement u_p (``admissible``
        (n_nodes, dim)), relative to a ``shift`` (n_nodes, dim) of the bodies."""
        discrete = self.discrete
        step = self.dynamics.step
        # f + (beta/tau - 1/2) K u^k + 2/tau^2 M u_p, relative to the shift
        share_of_internal = self.dynamics.damping / step - 0.5
        load = self.forces + share_of_internal * self.internal
        load += 2 / step**2 * self.mass * (admissible - shift)
        shifted = discrete.relative(shift)
        posed = discrete.with_step(
            load=discrete.relative_forces(load.reshape(-1)),
            fixed_values=discrete.fixed_values - shifted.reshape(-1),
            slip_reference=discrete.at_contact(discrete.relative(self.displacement) - shifted),
            accumulated_slip=self.accumulated_slip,
            strain_free=None,  # tolerances refer to the whole displacement
            volumes=discrete.volumes,
            gaps=-self._overlap(shift),
        )
        finest = self.grids.finest.posing(discrete=posed)
        return replace(self.grids, levels=(*self.grids.levels[:-1], finest))

    def _complete(
        self,
        k: int,
        result: Result,
        free: np.ndarray,
        admissible: np.ndarray,
        shift: np.ndarray,
    ) -> Result:
        """Return the result of step k, which is relative to a ``shift``, as one with the whole
        displacement, the velocity and the energies; ``free`` and ``admissible`` are u~ = u + tau v and
        the nearest admissible displacement u_p, all (n_nodes, dim), m."""
        step = self.dynamics.step
        contact = result.contact
        displacement = result.displacement + shift
        velocity_change = 2 / step * (displacement - admissible)  # 2/tau (u^(k+1) - u_p)
        velocity = self.velocity + velocity_change
        internal = self._internal(displacement)
        change = displacement - self.displacement
        # 2/tau^2 (u_p - u~) . M (u^(k+1) - u_p), and (u^(k+1) - u^k) . K (u^(k+1) - u^k)
        by_impact = np.sum((admissible - free) * self.mass * velocity_change) / step
        damped = np.sum(change * (internal - self.internal))
        by_friction, by_gaps = self._contact_losses(contact)
        losses = {
            "friction": by_friction,
            "contact": by_impact + by_gaps,
            "damping": self.dynamics.damping / step * damped,
        }
        energies = {
            "kinetic": 0.5 * np.sum(self.mass * velocity**2),
            "strain": 0.5 * np.sum(displacement * internal),
            "load": -np.sum(displacement * self.forces),
        } | {cause: self.lost_energies[cause] + loss for cause, loss in losses.items()}
        return replace(
            result,
            displacement=displacement,
            contact=self._shifted_back(contact, shift),
            time=(k + 1) * step,
            velocity=velocity,
            energies={name: float(value) for name, value in energies.items()},
        )

    def _contact_losses(self, contact: ContactResult) -> tuple[float, float]:
        """Return the energies -F . (u^(k+1) - u^k), N m, that friction takes on slips, and normal forces on
        the change g^(k+1) - g^k of gaps."""
        # the force F of a node that takes over the shares V of others acts with V F on these: its work is
        # F times the sum of slips or gaps with the weights 1 and V, of which results have the means
        weight_sums = contact.measures / contact.weights
        friction_work = np.sum(contact.force_t * contact.slip, axis=1)
        # the overlap before the step is the sum of -g^k. Only of closed nodes: at open ones the tolerance
        # leaves forces, and gaps may be long
        opening = (self._overlap(self.displacement) + weight_sums * contact.gap) * contact.closed
        return -np.sum(weight_sums * friction_work), -np.sum(contact.force_n * opening)

    def _shifted_back(self, contact: ContactResult, shift: np.ndarray) -> ContactResult:
        """Return a contact result relative to a ``shift`` (n_nodes, dim) with whole displacements."""
        weight_sums = contact.measures / contact.weights  # sums over means, as in _contact_losses
        shifted = self.discrete.at_contact(self.discrete.relative(shift)) / weight_sums[:, None]
        moved = to_frames(contact.frames, shifted)
        return replace(contact, u_n=contact.u_n + moved[:, 0], u_t=contact.u_t + moved[:, 1:])
