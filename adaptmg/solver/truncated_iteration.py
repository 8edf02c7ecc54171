r"""TruncatedIteration: the cycles of the truncated multigrid on one level, and when they stop.

The energy :math:`\eta_k^2 = \tilde r_k \cdot e_k` of the correction that the next coarser level proposes estimates the
error it removes; with the rate :math:`\rho = \eta_k/\eta_{k-1}` (the larger of the last ratio and the mean of the last
three) the error after the next smoothing is :math:`\rho\,\eta_k`. Together with the natural residual, which every
smoothing leaves behind, it decides when to stop, without a further pass over a matrix.

Cycles with frozen friction and a line search ("safe" ones) are taken while the contact status of a cold start changes,
and twice as many where the residual no longer falls. If that does not help, the iteration has stalled.
"""

from __future__ import annotations

import numpy as np

from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.multigrid.truncated_step import TruncatedStep
from adaptmg.solver.examine import Sizes
from adaptmg.solver.iterate import StopTest, true_error
from adaptmg.solver.record import Run, Status

__all__ = ["TruncatedIteration"]


class TruncatedIteration(StopTest):
    """Cycles on one level, measured after the smoothing, and their test; see :func:`~adaptmg.solver.iterate.iterate`.

    ``run`` asks the certificate and keeps the history. ``cold``: the contact status of the start is unknown.
    ``first_rate`` is the rate of the first cycle for a start that is nearly solved: one cycle may then do, and friction
    is frozen as long as the residual contradicts such a start. ``nested`` is the start (n_dofs,) from which
    ``rtol="discretisation"`` is measured. ``hands_over``: end where the tolerance is out of reach at the present speed.
    """

    #: the energy of the coarse correction misses what the smoothing removes, and all the corrections that follow: the
    #: error is up to the larger of SAFETY and TAIL / (1 - rate) times larger
    SAFETY, TAIL = 2.0, 1.5
    #: the least rate that is believed before this many ratios of energies
    EARLY_RATE, EARLY = 0.3, 3
    #: safe cycles at most, before the iteration is in trouble
    SAFE_CYCLES = 20
    #: natural residual, relative, above which a start is not believed
    TRUSTED = 0.1
    #: share of the discretisation error that may remain with rtol="discretisation"
    SHARE = 0.1
    #: the largest tolerance that comes from that: a start further off shows no discretisation error
    COARSEST = 1e-2
    #: iterates without a new smallest residual after which an iteration is in trouble
    TROUBLE = 6
    #: cycles over which the speed is measured once there are twice as many, and the largest share of those left
    WINDOW, MOST = 12, 0.7

    def __init__(self, multigrid: TruncatedStep, problem: DiscreteProblem, rtol: float | str, limit: float, *,
                 run: Run | None = None, cold: bool = False, first_rate: float | None = None,
                 nested: np.ndarray | None = None, hands_over: bool = False) -> None:
        super().__init__(0.0 if rtol == "discretisation" else rtol, limit, Sizes(problem),
                         None if run is None else self._shortfall)
        self.multigrid, self.problem, self.run = multigrid, problem, run
        self.cycles = self.changed = 0
        self.residuals: list[float] = []
        self._first_rate, self._nested, self._hands_over = first_rate, nested, hands_over
        self._most, self._safe = self.SAFE_CYCLES, self.SAFE_CYCLES if cold else 0
        self._first, self._since = np.nan, 0

    def start(self) -> None:
        """Nothing: :meth:`measure` smooths."""

    def measure(self, stop: StopTest) -> None:
        """Smooth, and take the residual that this leaves."""
        multigrid, sizes = self.multigrid, self.sizes
        multigrid.smooth()
        # each cycle only where the displacement has to grow into prescribed values
        if self.cycles % 4 == 0 or sizes.prescribed:
            self.size = sizes.norm(multigrid.unknowns, multigrid.energy())
        trusted = np.inf if self._first_rate is None else self.TRUSTED * sizes.forces(multigrid.unknowns, 0.0)
        state = multigrid.linearise(self._safe > 0, trusted)
        self.changed = state.changed
        self._safe = self._safe - 1 if self._safe > 0 and state.changed else 0
        early = self.cycles < 2
        # an exact start has no rate to measure, and needs none
        floor = multigrid.rounding() if early or sizes.prescribed else 0.0
        forces = sizes.forces(multigrid.unknowns, state.reactions)
        idle = self.idle(forces, floor, multigrid.unknowns)
        self.take_residual(state.residual, forces, floor if early or idle else 0.0, idle)
        self.residuals.append(self.residual)
        if len(self.residuals) == 1:
            self._first = self._last

    def row(self, stop: StopTest) -> dict[str, float]:
        values = self.measures() | {"status_changes": float(self.changed)}
        if self.run.reference is not None:
            error = self.multigrid.unknowns - self.problem.from_prescribed(self.run.reference)
            values["true_error"] = true_error(error, self.problem.matrix, self.problem, self.run)
        return values

    def step(self, stop: StopTest) -> Status | None:
        self.changes.append(float(np.sqrt(abs(self.multigrid.correct()))))
        self.cycles += 1
        if self._safe == 0 and self._in_trouble():
            if self._most > self.SAFE_CYCLES:
                return Status.STALLED
            self._most = self._safe = 2 * self.SAFE_CYCLES
        if self._safe == 0 and self._hands_over and self._too_slow(self.limit - self.cycles):
            return Status.STALLED
        if self.cycles == 1 and self._nested is not None:
            self.take_discretisation_error(self.multigrid.distance(self._nested))
        return None

    def take_discretisation_error(self, change: float) -> None:
        r"""Set rtol from the A-norm of what the first cycle changed in the nested start.

        By orthogonality and an error that halves with the mesh size,
        :math:`|u - u_h| = |u_h - u_{2h}|/\sqrt 3`; a tenth of it is the tolerance.
        """
        if self.size > 0:
            self.rtol = min(self.SHARE * change / np.sqrt(3.0) / self.size, self.COARSEST)

    def rests(self) -> bool:
        """Whether the last residual is as small as arithmetic allows."""
        return self.at_rounding(self.multigrid.rounding())

    @property
    def better(self) -> bool:
        return self.residual < self.residuals[0] and not self.diverged

    @property
    def stalled(self) -> bool:
        return self._no_new_minimum(self.residuals)

    @property
    def safe_rate(self) -> float:
        """See :class:`~adaptmg.solver.iterate.StopTest`; after one cycle the first rate."""
        return self._first_rate if self._first_rate is not None and len(self.changes) == 1 else super().safe_rate

    def _shortfall(self, rtol: float) -> float:
        """The certificate's answer; none where no iterate can be better."""
        return 0.0 if self.rests() else self.run.shortfall(self.problem.with_prescribed(self.multigrid.unknowns), rtol)

    def _estimate(self) -> float:
        rate = self.safe_rate
        if len(self.changes) <= self.EARLY:
            rate = max(rate, self.EARLY_RATE)
        return self._remaining(rate) if self.size > 0 and rate < 1 else np.inf

    def _remaining(self, rate: float) -> float:
        """The error that remains, relative, if corrections fall by ``rate`` < 1."""
        return max(self.SAFETY, self.TAIL / (1 - rate)) * self.changes[-1] * rate / self.size

    def _ran_away(self) -> bool:
        """Whether the absolute norm has grown: reactions, to which it is related elsewhere, grow with it."""
        return self._last > 1e6 * max(self._first, 1e-300)

    def _in_trouble(self) -> bool:
        """Whether the residual has reached no new minimum for a while; then the count begins again."""
        self._since += 1
        window = self.residuals[-self.TROUBLE:]
        if self._since < self.TROUBLE or window[0] > min(window[1:]):
            return False
        self._since = 0
        return True

    def _too_slow(self, left: float) -> bool:
        """Whether, as fast as the last cycles went, the tolerance is not reached in most of the cycles ``left``.

        The last ratio alone says nothing: recombined corrections fall unevenly.
        """
        if len(self.changes) <= 2 * self.WINDOW or not (self.rtol > 0 and self.size > 0):
            return False
        rate = self._mean_ratio(self.WINDOW)
        if not 0 < rate < 1:
            return True
        gap = max(self._remaining(rate) / self.rtol, self.residual / (self.RESIDUAL_FACTOR * self.rtol), 1.0)
        return bool(np.log(gap) > self.MOST * left * -np.log(rate))
