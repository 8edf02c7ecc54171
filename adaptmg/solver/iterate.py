r"""iterate: the one loop over cycles, sweeps or Newton steps of every method; StopTest: when it ends.

With :math:`\delta_k` the A-norm of what step k changed, or an estimate of it, the rate is
:math:`\rho_k = \delta_k/\delta_{k-1}`, and :math:`\rho` the larger of the last ratio and the geometric mean of the last
three. Where the change itself is known, :math:`\delta_k = \|w_k - w_{k-1}\|_A`, the error that remains is estimated as
:math:`\delta_k\,\rho/(1-\rho)`. The natural residual must be small too: an iteration that creeps has a small change far
from the solution.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np
from scipy import sparse

from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.smoother.residuals import natural_residual
from adaptmg.smoother.system import LocalProblem
from adaptmg.solver.examine import ROUNDING, Sizes, displacement_norm, energy_norm, euclidean_norm
from adaptmg.solver.record import Run, Status


class Iteration(Protocol):
    """What a method offers to the loop; it holds its unknowns."""

    cycles: int  # cycles, sweeps or steps done

    def start(self) -> None:
        """Do what comes before the first measurement: a smoothing, the first sweeps, or nothing."""

    def measure(self, stop: StopTest) -> None:
        """Hand the residual and change of the present iterate to the test."""

    def row(self, stop: StopTest) -> dict[str, float] | None:
        """The row of the history; None for no row."""

    def step(self, stop: StopTest) -> Status | None:
        """Do the next step; a status where the method gives up."""


def iterate(method: Iteration, stop: StopTest, run: Run | None = None) -> Status:
    """Measure, judge and step until the test or the method ends it."""
    method.start()
    while True:
        method.measure(stop)
        row = None if run is None else method.row(stop)
        if row is not None:
            run.record(cycle=method.cycles, **row)
        status = stop.verdict(method.cycles)
        if status is None:
            status = method.step(stop)
        if status is not None:
            given_up = status in (Status.STALLED, Status.LIMIT)
            return Status.CONVERGED if given_up and stop.certified(method.cycles) else status


class StopTest:
    """Judges an iteration by its estimated error and residual."""

    #: the natural residual must fall below this multiple of rtol
    RESIDUAL_FACTOR = 10.0
    #: largest relative residual that rounding excuses
    ROUNDING_LIMIT = 1e-9
    #: iterates without a new smallest change, or residual, after which an iteration counts as stalled
    PATIENCE = 60
    #: what a stalled iteration is called
    STALLED = Status.STALLED

    def __init__(self, rtol: float, limit: float, sizes: Sizes) -> None:
        self.rtol, self.limit, self.sizes = rtol, limit, sizes
        self._caution, self._asked, self._rounding = 1.0, -1, False
        self.changes: list[float] = []
        self.size, self.residual, self.error_estimate, self.met = 0.0, np.inf, np.inf, False
        self._last = np.nan

    def verdict(self, cycles: int) -> Status | None:
        """How the iteration ends after this number of cycles; None if it goes on."""
        if self.met and not self.doubted(cycles):
            return Status.CONVERGED
        if self.diverged:
            return Status.DIVERGED
        if self.stalled:
            return self.STALLED
        return Status.LIMIT if cycles >= self.limit else None

    def idle(self, forces: float, floor: float, unknowns: np.ndarray) -> bool:
        """Whether the acting forces (their norm, N) are mere rounding; ``floor`` as of :meth:`at_rounding`."""
        return self.sizes.nothing_strains(forces, ROUNDING * floor, unknowns)

    def take_residual(self, residual: float, forces: float, floor: float, idle: bool = False) -> None:
        """Take the norms of the natural residual and of the acting forces, N, and estimate the error. A residual at the
        rounding of ``floor`` (:meth:`at_rounding`) is the least; ``idle``: so are the forces."""
        if idle and residual <= ROUNDING * floor:
            residual = 0.0
        self.residual = 0.0 if residual == 0 else residual / (forces or residual)  # an interference fit: no forces yet
        self._last = residual
        self._rounding = self.at_rounding(floor)
        self.error_estimate = self.residual if self._rounding else self._caution * self._estimate()
        self.met = self._rounding or self._small_enough()

    def at_rounding(self, floor: float) -> bool:
        """Whether the last residual is as small as arithmetic allows, ``floor`` being the norm of D u, N. A large
        residual at the level of rounding is that of unknowns that have run away."""
        return self._last <= ROUNDING * floor and self.residual <= self.ROUNDING_LIMIT

    @property
    def residual_met(self) -> bool:
        return self.residual <= self.RESIDUAL_FACTOR * self.rtol

    def doubted(self, cycles: int) -> bool:
        """Whether the certificate contradicts a test that is met after this number of cycles."""
        if self._rounding:
            return False
        if self.error_estimate > self.rtol and cycles < 1.5 * self._asked:
            return True
        ratio, self._asked = self.shortfall(), cycles
        if ratio is None:
            return False
        if ratio == 0.0:
            self.error_estimate = min(self.error_estimate, self.rtol)  # caution was too large
        elif self.error_estimate < 1.5 * ratio * self.rtol:
            self._caution *= max(2.0, 1.5 * ratio)
        return ratio > 0.0

    def shortfall(self) -> float | None:
        """By how many times the certificate finds the last iterate short of rtol; None if it is not asked."""
        return None

    def certified(self, cycles: int) -> bool:
        """Whether the certificate, if it was not asked, finds the last iterate good enough, whatever the estimate says:
        near rounding no rate shows that any more, and after a refusal it is cautious."""
        if cycles == self._asked or not self.residual_met or self.shortfall() != 0.0:
            return False
        self.error_estimate = min(self.error_estimate, self.rtol)
        return True

    def measures(self) -> dict[str, float]:
        return {"residual": self.residual, "change": self.change, "error_estimate": self.error_estimate}

    @property
    def change(self) -> float:
        """The last change, relative to the displacement where that has a size."""
        change = self.changes[-1] if self.changes else np.nan
        return change / self.size if self.size > 0 else change

    @property
    def rate(self) -> float:
        """Geometric mean of the last (at most five) ratios of changes; NaN before the second change."""
        return self._mean_ratio(5)

    @property
    def safe_rate(self) -> float:
        """The larger of the last ratio and the mean of the last three; NaN if unknown."""
        return max(self._mean_ratio(1), self._mean_ratio(3)) if len(self.changes) > 1 else np.nan

    def _mean_ratio(self, window: int) -> float:
        window = min(window, len(self.changes) - 1)
        if window < 1:
            return np.nan
        first, last = self.changes[-1 - window], self.changes[-1]
        if last == 0.0:
            return 0.0
        return float((last / first) ** (1 / window)) if first > 0 else np.inf

    @property
    def diverged(self) -> bool:
        """Whether the iterates grow without bound or are not finite."""
        return not np.isfinite(self.residual) or self._ran_away()

    @property
    def stalled(self) -> bool:
        """Whether the change has not reached a new minimum for ``PATIENCE`` iterates."""
        return self._no_new_minimum(self.changes)

    def _no_new_minimum(self, values: Sequence[float]) -> bool:
        return len(values) > self.PATIENCE and int(np.argmin(values)) < len(values) - self.PATIENCE

    def _small_enough(self) -> bool:
        return self.error_estimate <= self._caution * self.rtol and self.residual_met

    def _estimate(self) -> float:
        """The error that remains, relative."""
        rate = self.safe_rate
        if not rate < 1:
            return np.inf
        return self.changes[-1] * rate / (1 - rate) / self.size if self.size > 0 else np.inf

    def _ran_away(self) -> bool:
        return len(self.changes) > 3 and not self.changes[-1] <= 1e6 * max(self.changes[:3])


def true_error(error: np.ndarray, matrix: sparse.sparray | np.ndarray, problem: DiscreteProblem, run: Run) -> float:
    """A-norm of an error (n_dofs,) over that of the reference of a run; its time is not counted."""
    with run.untimed():
        size = displacement_norm(problem, run.reference)
        return energy_norm(error, matrix @ error) / size if size > 0 else np.nan


class IterateTest(StopTest):
    """Watches iterates at which the residual is known."""

    def __init__(self, local: LocalProblem, rtol: float, limit: float, run: Run | None = None,
                 reference: np.ndarray | None = None, sizes: Sizes | None = None,
                 displacement: Callable[[np.ndarray], np.ndarray] | None = None) -> None:
        super().__init__(rtol, limit, Sizes(local.discrete, local.frames) if sizes is None else sizes)
        self._displacement = displacement
        if reference is None and run is not None and run.reference is not None:
            reference = local.to_local(run.reference)
        self.local, self.run, self.reference = local, run, reference
        blocks = local.system.diagonal.reshape(-1, local.system.dim, local.system.dim)
        self._diagonal = np.diagonal(blocks, axis1=1, axis2=2).reshape(-1)
        self._unknowns: np.ndarray | None = None
        self._r: np.ndarray | None = None

    def shortfall(self) -> float | None:
        return None if self._displacement is None else self.run.shortfall(self._displacement(self._unknowns), self.rtol)

    def take(self, unknowns: np.ndarray, r: np.ndarray) -> None:
        """Take an iterate and its residual r = b - A w (n_dofs,)."""
        system = self.local.system
        vector = natural_residual(system, self.local.contact, self.local.load, unknowns, r)
        reactions = r.reshape(-1, system.dim)[system.nodes]
        scale = self.sizes.forces(unknowns, euclidean_norm(reactions.reshape(-1)))
        energy = float(np.einsum("i,i->", unknowns, self.local.load - r))
        self.size = self.sizes.norm(unknowns, energy)
        if self._unknowns is not None:
            self.changes.append(energy_norm(unknowns - self._unknowns, self._r - r))
        self._unknowns, self._r = unknowns.copy(), r.copy()
        floor, size = euclidean_norm(self._diagonal * unknowns), euclidean_norm(vector)
        self.take_residual(size, scale, floor, size <= ROUNDING * floor and self.idle(scale, floor, unknowns))

    def measures(self) -> dict[str, float]:
        values = super().measures()
        if self.reference is not None and self._unknowns is not None:
            values["true_error"] = true_error(self._unknowns - self.reference, self.local.system.matrix,
                                              self.local.discrete, self.run)
        return values


class ChangeTest(IterateTest):
    """The paper's test: the Euclidean change in a cycle or sweep alone, relative to the iterate. The residual at the
    end confirms convergence or not (:meth:`confirmed`)."""

    relative_change, finite = np.inf, True

    def take_change(self, before: np.ndarray, unknowns: np.ndarray) -> None:
        """Take two iterates (n_dofs,), one after the other."""
        size = euclidean_norm(unknowns)
        self.finite = bool(np.isfinite(size))
        self.relative_change = euclidean_norm(unknowns - before) / size if size > 0 else 0.0

    def verdict(self, cycles: int) -> Status | None:
        if not (self.finite and self.relative_change < np.inf):
            return Status.DIVERGED
        if not self.relative_change > self.rtol:
            return Status.CONVERGED
        return Status.LIMIT if cycles >= self.limit else None

    def confirmed(self, status: Status) -> Status:
        """The status, unless the residual of the last iterate taken contradicts it."""
        return Status.STALLED if status.ok and not self.residual_met else status
