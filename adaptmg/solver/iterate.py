r"""iterate: the one loop over cycles, sweeps or Newton steps of every method; nested_start: the
start that comes from coarser levels; StopTest and ChangeTest: when the loop ends.

With :math:`\delta_k` the A-norm of what step k changed, or an estimate of it, the rate is
:math:`\rho_k = \delta_k/\delta_{k-1}`, and :math:`\rho` the larger of the last ratio and the geometric mean of the last
three. Where the change itself is known, :math:`\delta_k = \|w_k - w_{k-1}\|_A`, the error that
remains is estimated as
:math:`\delta_k\,\rho/(1-\rho)`. The natural residual must be small too: an iteration that creeps has a small change far
from the solution.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, TypeVar, cast

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.smoother.conditions import natural_residual
from adaptmg.smoother.system import LocalProblem
from adaptmg.solver.certificate import Certificate, ratio
from adaptmg.solver.examine import ROUNDING, Sizes, displacement_norm, energy_norm, euclidean_norm
from adaptmg.solver.record import Run, Status


@dataclass(frozen=True, eq=False)
class Measured:
    """Norms of a state."""

    cycles: int  # cycles, sweeps or steps done
    # Euclidean norm of the natural residual, N; Any: None where a method judges by changes alone
    residual: float | Any = None
    forces: float = 0.0  # norm of the acting forces, N
    size: float = 0.0  # A-norm of the displacement
    # norm of D u, N: no residual falls below this times the unit of rounding; 0: not computed
    floor: float = 0.0
    idle: bool = False  # whether all acting forces are rounding, since nothing strains the bodies
    change: float | None = None  # A-norm of the change by the step; None: unknown
    # Euclidean norm of the change over that of the iterate; Any: None where it is not the test
    relative_change: float | Any = None
    from_start: float | None = None  # A-norm of the change by the first cycle; None: not computed
    gives_up: Status | None = None  # why the method has no next state; then no more is measured
    columns: dict[str, float] = field(default_factory=dict)  # further ones of the history


def _kept_vector(name: str, value: object) -> np.ndarray:
    """Return a read-only copy of a vector of a state."""
    entries = checks.real_array(value)
    if entries is None or entries.ndim != 1:
        raise TypeError(f"{name} must be a real array (n_dofs,), got {checks.shown(value)}")
    # not a check for finite numbers: a method that diverges is reported as such
    vector = np.array(entries, dtype=np.float64)
    vector.flags.writeable = False
    return vector


@dataclass(frozen=True, eq=False, kw_only=True)
class State(checks.Checked):
    """All that flows from one step of a method to the next.

    Parameters
    ----------
    unknowns : (n_dofs,) array
        Displacement of the level in contact frames, m: at contact nodes the normal component, then
        the tangential ones, elsewhere the Cartesian ones. They count from prescribed values; those
        of fixed dofs are zero. ``to_local`` and ``to_cartesian`` of
        :func:`adaptmg.smoother.local_system` convert.
    passes : float
        Passes over the finest matrix that the step took; they are counted as work.
    memory : object, optional
        What else a method hands from step to step: a status, past iterates. A step must not change
        it in place.
    residual : (n_dofs,) array, optional
        b - A w in the same components, N, where the step has it: this spares a pass over the
        matrix.
    cycles : int
        Steps so far; :func:`adaptmg.solve` counts them.

    Examples
    --------
    >>> am.State(unknowns=[0.0, 0.0], passes=2).passes
    2.0
    """

    unknowns: Annotated[np.ndarray, _kept_vector]
    passes: checks.Nonnegative = 0.0
    memory: Any = None
    residual: Annotated[np.ndarray, _kept_vector] | None = None
    cycles: checks.Whole = 0


Flowing = TypeVar("Flowing")  # what a method has for its states


def iterate(
    step: Callable[[Flowing], Flowing],
    measure: Callable[[Flowing], Measured],
    state: Flowing,
    stop: StopTest,
    run: Run | None = None,
) -> tuple[Flowing, Status]:
    """Measure, judge and step until the test or the method ends the iteration; return the last state
    and the status. Each state is measured once, in turn: ``measure`` may compare it with the one
    before."""
    stop.state = state
    del state  # the test may let go of what is large
    while True:
        measured = measure(stop.state)
        status = measured.gives_up or stop.take(measured, run)
        if status is not None:
            given_up = status in (Status.STALLED, Status.LIMIT, Status.ROUNDING)
            if given_up and stop.accepted_by_certificate():
                status = Status.CONVERGED
            return stop.state, status
        stop.state = step(stop.state)


def nested_start(
    run: Run,
    levels: int,
    coarsest: Callable[[], Flowing],
    prolonged: Callable[[int, Flowing], Flowing],
    cycled: Callable[[int, Flowing], Flowing],
) -> Flowing:
    """Return the start on the finest of some levels: the solution of the ``coarsest``,
    ``prolonged`` from level to level, ``cycled`` on those between."""
    before = run.work_units
    with run.phase("start"):
        state = coarsest()
        for number in range(1, levels):
            state = prolonged(number, state)
            run.visit(number, "start")
            if number < levels - 1:  # on the finest level the method itself goes on
                state = cycled(number, state)
    run.start_work_units += run.work_units - before
    return state


class StopTest:
    """Judges an iteration by its estimated error and residual.

    ``shortfall(state, rtol)`` asks the certificate: it returns the factor by which the error of the
    state exceeds ``rtol``, 0 if it does not. ``stalled`` is the status of an iteration that no
    longer improves (None: it goes on)."""

    #: the natural residual must fall below this multiple of rtol
    #: half changes 1 of 119 solves, paths and loops, twice 0; cycles 691, 690, 691 (campaign
    #: constants)
    RESIDUAL_FACTOR = 10.0
    #: a residual up to ``ROUNDING`` of the terms that it sums, and up to this share of the forces, is zero but for
    #: rounding: the state has converged
    ROUNDING_LIMIT = checks.ALIKE
    #: a residual up to this share of the terms that it sums, and up to ``BALANCED`` of the forces, cannot fall any
    #: more: after this number of such iterates the iteration gives up, with :attr:`Status.ROUNDING`
    ROUNDING_LEVEL = 2 * np.finfo(float).eps
    BALANCED = Certificate.MOST_ROUNDING
    ROUNDING_ITERATES = 4
    #: iterates without a new smallest change after which sweeps and cycles of other methods count as stalled: of
    #: 90 solves of random problems by monotone cycles and over-relaxed sweeps to 1e-6 68 converge, at 30 and 120, too;
    #: the monotone cycles are 3409, 3439, 3469
    PATIENCE = 60

    def __init__(
        self,
        rtol: float,
        limit: float,
        shortfall: Callable[[Any, float], float] | None = None,
        stalled: Status | None = Status.STALLED,
    ) -> None:
        """Begin a test for a tolerance and a ``limit`` on cycles; without ``shortfall`` no
        certificate is asked."""
        self.rtol = rtol
        self.state: Any = None  # the state that is judged
        self.limit = limit
        self._ask_certificate = shortfall
        self._stalled_status = stalled
        self._caution = 1.0  # factor by which the certificate found estimates too small
        self._cycle_asked: int | None = None  # the last cycle at which the certificate was asked
        self._at_rounding = False
        self.cycles = 0
        self.changes: list[float] = []  # A-norms
        self.size = 0.0  # A-norm of the displacement
        self.residual = np.inf  # relative to the forces
        self.error_estimate = np.inf  # relative
        self.met = False  # whether estimate and residual meet the tolerance
        self._last_residual = np.nan  # N
        self._iterates_at_rounding = 0

    def take(self, measured: Measured, run: Run | None = None) -> Status | None:
        """Judge a state and record it; return how the iteration ends, None if it goes on."""
        self.judge(measured)
        if run is not None:
            run.record(cycle=measured.cycles, **self.columns() | measured.columns)
        return self.verdict()

    def judge(self, state: Measured) -> None:
        """Estimate the error from the norms of a state, and decide whether it meets the tolerance. A
        residual that is only rounding counts as zero where the acting forces are rounding, too."""
        self.cycles = state.cycles
        self.size = state.size
        if state.change is not None:
            self.changes.append(state.change)
        residual = state.residual
        if state.idle and residual <= ROUNDING * state.floor:
            residual = 0.0
        # relative to the forces; without any, as before an interference is met, it is 1
        self.residual = ratio(residual, state.forces)
        self._last_residual = residual
        self._at_rounding = self.residual_within(ROUNDING * state.floor, self.ROUNDING_LIMIT)
        cannot_fall = self.residual_within(self.ROUNDING_LEVEL * state.floor, self.BALANCED)
        self._iterates_at_rounding = self._iterates_at_rounding + 1 if cannot_fall else 0
        # changes at rounding have no rate: there the residual stands for the error
        self.error_estimate = (
            self.residual if self._at_rounding else self._caution * self._estimate()
        )
        self.met = self._at_rounding or self._small_enough()

    def verdict(self) -> Status | None:
        """Return how the iteration ends; None if it goes on."""
        if self.met and (self._at_rounding or not self.refused()):
            return Status.CONVERGED
        if self.diverged:
            return Status.DIVERGED
        if self._iterates_at_rounding >= self.ROUNDING_ITERATES:
            self.error_estimate = np.nan  # the estimate of the certificate is reported
            return Status.ROUNDING
        if self._stalled_status is not None and self.stalled:
            return self._stalled_status
        return Status.LIMIT if self.cycles >= self.limit else None

    def residual_within(self, rounding: float, limit: float) -> bool:
        """Return whether the last residual is at most ``rounding``, N, and at most the share ``limit``
        of the forces: rounding grows with unknowns that diverge, forces do not."""
        return bool(self._last_residual <= rounding and self.residual <= limit)

    @property
    def residual_met(self) -> bool:
        """Return whether the last residual is small enough, or cannot fall any more."""
        return self.residual <= self.RESIDUAL_FACTOR * self.rtol or self._iterates_at_rounding > 0

    def refused(self) -> bool:
        """Ask the certificate; return whether it contradicts the tolerance. Later estimates are
        multiplied by the factor by which it finds this one too small."""
        factor = self.shortfall()
        self._cycle_asked = self.cycles
        if factor is None:
            return False
        if factor > 0.0 and self.error_estimate > 0.0:
            self._caution *= max(factor * self.rtol / self.error_estimate, 1.0)
        return factor > 0.0

    def shortfall(self) -> float | None:
        """Return the factor by which the certificate finds the error of the last iterate above rtol, 0
        if it is not above; None without a certificate."""
        return (
            None if self._ask_certificate is None else self._ask_certificate(self.state, self.rtol)
        )

    def accepted_by_certificate(self) -> bool:
        """Ask the certificate about the last iterate, unless it refused this one already; return
        whether it accepts it, and if so lower the estimate to rtol. The estimate may be too large:
        near rounding there is no rate of convergence, and after a refusal a factor multiplies it."""
        if self.cycles == self._cycle_asked or not self.residual_met or self.shortfall() != 0.0:
            return False
        self.error_estimate = min(self.error_estimate, self.rtol)
        return True

    def columns(self) -> dict[str, float]:
        """Return the entries of a row of the history."""
        return {
            "residual": self.residual,
            "change": self.change,
            "error_estimate": self.error_estimate,
        }

    @property
    def change(self) -> float:
        """Return the last change, relative to the displacement where that has a size."""
        change = self.changes[-1] if self.changes else np.nan
        return change / self.size if self.size > 0 else change

    @property
    def rate(self) -> float:
        """Return the geometric mean of the last (at most five) ratios of changes; NaN before the
        second change."""
        return self._mean_ratio(5)

    @property
    def safe_rate(self) -> float:
        """Return the larger of the last ratio and the mean of the last three; NaN if unknown."""
        return max(self._mean_ratio(1), self._mean_ratio(3)) if len(self.changes) > 1 else np.nan

    def _mean_ratio(self, window: int) -> float:
        """Return the geometric mean of the last ratios of changes, at most ``window`` of them; NaN
        before the second change."""
        window = min(window, len(self.changes) - 1)
        if window < 1:
            return np.nan
        first = self.changes[-1 - window]
        last = self.changes[-1]
        if last == 0.0:
            return 0.0
        return float((last / first) ** (1 / window)) if first > 0 else np.inf

    @property
    def diverged(self) -> bool:
        """Return whether the iterates grow without bound or are not finite."""
        return not np.isfinite(self.residual) or self._ran_away()

    @property
    def stalled(self) -> bool:
        """Return whether the change has not reached a new minimum for ``PATIENCE`` iterates."""
        iterates = len(self.changes)
        return iterates > self.PATIENCE and int(np.argmin(self.changes)) < iterates - self.PATIENCE

    def _small_enough(self) -> bool:
        return self.error_estimate <= self.rtol and self.residual_met

    def _estimate(self) -> float:
        """Return the relative error that remains, from the last change and the rate."""
        rate = self.safe_rate
        if not rate < 1:
            return np.inf
        # delta_k rho / (1 - rho), relative; of a zero displacement no relative error is known
        return self.changes[-1] * rate / (1 - rate) / self.size if self.size > 0 else np.inf

    def _ran_away(self) -> bool:
        """Return whether the last change is a million times the largest of the first three."""
        return len(self.changes) > 3 and not self.changes[-1] <= 1e6 * max(self.changes[:3])


def true_error(
    error: np.ndarray, matrix: sparse.sparray | np.ndarray, problem: DiscreteProblem, run: Run
) -> float:
    """Return the A-norm of an error (n_dofs,) over that of the reference of a run; its time is not
    counted."""
    with run.untimed():
        size = displacement_norm(problem, cast("np.ndarray", run.reference))
        return energy_norm(error, matrix @ error) / size if size > 0 else np.nan


class ChangeTest(StopTest):
    """The paper's test: the Euclidean change in a cycle or sweep alone, relative to the iterate.
    The norms at the last state, which ``measure`` takes, confirm convergence or not."""

    relative_change = np.inf

    def __init__(self, rtol: float, limit: float, measure: Callable[[State], Measured]) -> None:
        super().__init__(rtol, limit)
        self._measure = measure

    def take(self, measured: Measured, run: Run | None = None) -> Status | None:
        """Judge a state by the change in its cycle alone; return how the iteration ends, None if it goes
        on. The history gets the norms of the state between smoothing and correction, if there is a
        correction; at the end also those of the state after both, which is the solution."""
        self.cycles = measured.cycles
        self.relative_change = measured.relative_change
        if not np.isfinite(self.relative_change):
            return Status.DIVERGED
        if measured.residual is not None:  # None: there is no correction
            self._record(measured, cast("Run", run))
        small = self.relative_change <= self.rtol
        if not small and self.cycles < self.limit:
            return None
        self._record(self._measure(self.state), cast("Run", run))
        if not small:
            return Status.LIMIT
        return Status.CONVERGED if self.residual_met else Status.STALLED

    def _record(self, state: Measured, run: Run) -> None:
        """Judge a state, and add a row with its norms to the history of the run."""
        self.judge(state)
        run.record(
            cycle=self.cycles,
            relative_change=self.relative_change,
            **self.columns() | state.columns,
        )


class Measure:
    """Norms of the iterates of a problem whose residual is known; ``reference`` (n_dofs,) is the
    solution."""

    def __init__(
        self,
        local: LocalProblem,
        run: Run | None = None,
        reference: np.ndarray | None = None,
        sizes: Sizes | None = None,
    ) -> None:
        """Prepare the norms of a problem; ``sizes`` are what they are relative to, by default those of the
        problem. On the finest level the ``run`` may have the reference, Cartesian."""
        self.sizes = Sizes(local.discrete, local.frames) if sizes is None else sizes
        if reference is None and run is not None and run.reference is not None:
            reference = local.to_local(run.reference)
        self.local = local
        self.run = run
        self.reference = reference
        blocks = local.system.diagonal.reshape(-1, local.system.dim, local.system.dim)
        self._diagonal = np.diagonal(blocks, axis1=1, axis2=2).reshape(-1)  # (n_dofs,): D
        self._last_iterate: tuple[np.ndarray, np.ndarray] | None = None

    def __call__(
        self,
        cycles: int,
        unknowns: np.ndarray,
        residual: np.ndarray,
        **columns: float,
    ) -> Measured:
        """Return the norms of an iterate (n_dofs,), which must not change any more, with its
        residual b - A w (n_dofs,)."""
        system = self.local.system
        sizes = self.sizes
        at_contact = (
            vector.reshape(-1, system.dim)[system.nodes] for vector in (unknowns, residual)
        )
        self.local.contact.follow(*at_contact)
        # the friction of laws that see pressure and slip is now that of this iterate
        natural = euclidean_norm(natural_residual(self.local, unknowns, residual))
        contact_forces = euclidean_norm(residual.reshape(-1, system.dim)[system.nodes].reshape(-1))
        forces = sizes.forces(unknowns, contact_forces)
        # w'Aw = w'(b - r)
        size = sizes.norm(unknowns, float(np.einsum("i,i->", unknowns, self.local.load - residual)))
        change = None
        if self._last_iterate is not None:
            unknowns_before, residual_before = self._last_iterate
            # A (w_k - w_(k-1)) = r_(k-1) - r_k
            change = energy_norm(unknowns - unknowns_before, residual_before - residual)
        self._last_iterate = unknowns, residual
        floor = euclidean_norm(self._diagonal * unknowns)
        idle = natural <= ROUNDING * floor and sizes.nothing_strains(
            contact_forces, ROUNDING * floor, unknowns
        )
        if self.reference is not None:
            columns["true_error"] = true_error(
                unknowns - self.reference,
                system.matrix,
                self.local.discrete,
                cast("Run", self.run),
            )
        return Measured(
            cycles=cycles,
            residual=natural,
            forces=forces,
            size=size,
            floor=floor,
            idle=idle,
            change=change,
            columns=columns,
        )

    def of(self, state: State) -> Measured:
        """Measure a state; the residual that it lacks is counted."""
        residual = state.residual
        if residual is None:
            cast("Run", self.run).count(1.0, self.local.system.nonzeros)
            residual = self.local.residual(state.unknowns)
        return self(state.cycles, state.unknowns, residual)


class Smoothing:
    """Steps of smoothing and, if there is ``correct``, coarse corrections.

    ``smooth(unknowns, cycles)`` smooths in place, after a number of cycles; it returns its sweeps
    where each counts as a cycle, else 0. ``correct(unknowns, residual)`` corrects in place, which
    counts as a cycle. ``residual(unknowns)`` returns b - A w (n_dofs,)."""

    def __init__(
        self,
        norms: Measure,
        smooth: Callable[[np.ndarray, int], int],
        residual: Callable[[np.ndarray], np.ndarray],
        correct: Callable[[np.ndarray, np.ndarray], None] | None = None,
    ) -> None:
        self.norms = norms
        self.smooth = smooth
        self.residual = residual
        self.correct = correct

    def step(self, state: State) -> State:
        """Return the state after a correction, which a start, that has no residual, does not get, and
        smoothing; its memory is the number of sweeps."""
        unknowns = state.unknowns.copy()
        cycles = state.cycles
        if self.correct is not None and state.residual is not None:
            self.correct(unknowns, state.residual)
            cycles += 1
        sweeps = self.smooth(unknowns, cycles)
        residual = self.residual(unknowns)
        return State(unknowns=unknowns, memory=sweeps, residual=residual, cycles=cycles + sweeps)

    def whole_step(self, state: State) -> State:
        """Return the state after smoothing and a correction; its memory is the relative change by
        both, and the state between the two, with its residual (None without a correction)."""
        unknowns = state.unknowns.copy()
        cycles = state.cycles + self.smooth(unknowns, state.cycles)
        between = None
        if self.correct is not None:
            residual = self.residual(unknowns)
            between = State(unknowns=unknowns, residual=residual)
            self.correct(unknowns, residual)
            cycles += 1
        size = euclidean_norm(unknowns)
        change = euclidean_norm(unknowns - state.unknowns) / size if size > 0 else 0.0
        change = change if np.isfinite(size) else np.inf
        return State(unknowns=unknowns, cycles=cycles, memory=(change, between))

    def measure_whole(self, state: State) -> Measured:
        """Return the relative change by a whole step, with the norms of the state between smoothing
        and correction, if there is one."""
        change, between = state.memory
        # without a correction there are no norms: ChangeTest takes them of the last state alone
        measured = Measured(cycles=0) if between is None else self.norms.of(between)
        return replace(measured, cycles=state.cycles, relative_change=change)

    def solve(
        self,
        unknowns: np.ndarray,
        stop: str,
        rtol: float,
        limit: int,
        run: Run,
        shortfall: Callable[[State, float], float],
        stalled: Status = Status.STALLED,
    ) -> tuple[State, Status, StopTest]:
        """Iterate from ``unknowns`` (n_dofs,) until the estimated error is small (``stop="error"``), or the
        change by a whole step (``stop="change"``, the paper's test at the end of step g)."""
        start = State(unknowns=unknowns)
        if stop == "error":
            test = StopTest(rtol, limit, shortfall=shortfall, stalled=stalled)
            # the first state that is measured is a smoothed start
            return *iterate(self.step, self.norms.of, self.step(start), test, run), test
        test = ChangeTest(rtol, limit, measure=self.norms.of)
        first = self.whole_step(start)
        return *iterate(self.whole_step, self.measure_whole, first, test, run), test
