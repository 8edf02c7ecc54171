r"""When to stop: the algebraic error estimated from the measured rate, and the natural residual.

With :math:`\delta_k = \|w_k - w_{k-1}\|_A` the rate is :math:`\rho_k = \delta_k/\delta_{k-1}` and the error that
remains is estimated as :math:`\delta_k\,\rho/(1-\rho)`, with the larger of the last ratio and the geometric mean of
the last three. A change alone says nothing: an iteration that creeps has a small change far from the solution.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from adaptmg.smoother.residuals import natural_residual
from adaptmg.smoother.system import LocalProblem
from adaptmg.solver.run import Run
from adaptmg.solver.sizes import Sizes, displacement_norm, energy_norm, euclidean_norm

__all__ = ["Convergence"]


@dataclass(eq=False)
class Convergence:
    """Watches iterates at which the residual is known.

    Parameters
    ----------
    local : LocalProblem
    rtol : float
        For the estimated relative A-norm error; the relative natural residual must be below ``RESIDUAL_FACTOR * rtol``.
    run : Run, optional
        Where the time of comparisons with the reference is excluded.
    reference : (n_dofs,) array, optional
        The exact discrete solution in local components, for the true error in :meth:`measures`.
    sizes : Sizes, optional
        What errors and residuals refer to, where ``local`` is condensed; by default that of ``local``.
    """

    local: LocalProblem
    rtol: float
    run: Run | None = None
    reference: np.ndarray | None = None
    sizes: Sizes | None = None
    changes: list[float] = field(default_factory=list)
    error_estimate: float = np.inf
    residual: float = np.inf
    _unknowns: np.ndarray | None = None
    _defect: np.ndarray | None = None
    _norm: float = 0.0

    #: the natural residual must fall below this multiple of rtol
    RESIDUAL_FACTOR = 10.0
    #: a natural residual of so many units of rounding of the terms it sums cannot be bettered
    ROUNDING = 8 * np.finfo(float).eps
    #: largest relative residual that rounding excuses
    ROUNDING_LIMIT = 1e-9
    #: checks without a new smallest change after which an iteration counts as stalled
    PATIENCE = 60

    def __post_init__(self) -> None:
        if self.sizes is None:
            self.sizes = Sizes(self.local.discrete, self.local.frames)
        blocks = self.local.system.diagonal.reshape(-1, self.local.system.dim, self.local.system.dim)
        self._diagonal = np.diagonal(blocks, axis1=1, axis2=2).reshape(-1)

    def check(self, unknowns: np.ndarray, defect: np.ndarray) -> bool:
        """Take an iterate and its residual b - A w; True if it meets the tolerance."""
        system = self.local.system
        vector = natural_residual(system, self.local.contact, self.local.load, unknowns, defect)
        reactions = defect.reshape(-1, system.dim)[system.nodes]
        scale = self.sizes.forces(unknowns, euclidean_norm(reactions.reshape(-1)))
        size = euclidean_norm(vector)
        self.residual = 0.0 if size == 0 else size / (scale or size)  # an interference fit begins without forces
        energy = float(np.einsum("i,i->", unknowns, self.local.load - defect))
        self._norm = self.sizes.norm(unknowns, energy)
        if self._unknowns is not None:
            self.changes.append(energy_norm(unknowns - self._unknowns, self._defect - defect))
            self.error_estimate = self._estimate()
        self._unknowns, self._defect = unknowns.copy(), defect.copy()
        floor = self.ROUNDING * euclidean_norm(self._diagonal * unknowns)
        if size <= floor and self.sizes.nothing_strains(scale, floor, unknowns):
            self.residual = self.error_estimate = 0.0
            return True
        # a large residual at the level of rounding is that of unknowns that have run away
        if size <= floor and self.residual <= self.ROUNDING_LIMIT:
            # an exact start has no rate to measure, and needs none
            self.error_estimate = self.residual
            return True
        return self.error_estimate <= self.rtol and self.residual <= self.RESIDUAL_FACTOR * self.rtol

    def measures(self) -> dict[str, float]:
        """Relative residual, change, estimate and (with a reference) true error at the last iterate."""
        change = self.change / self._norm if self._norm > 0 else self.change
        values = {"residual": self.residual, "change": change, "error_estimate": self.error_estimate}
        if self.reference is not None and self._unknowns is not None:
            with self.run.untimed():
                matrix = self.local.system.matrix
                error = self._unknowns - self.reference
                size = displacement_norm(self.local.discrete, self.run.reference)
                values["true_error"] = energy_norm(error, matrix @ error) / size if size > 0 else np.nan
        return values

    def _estimate(self) -> float:
        rate = self.safe_rate
        if not rate < 1:
            return np.inf
        return self.changes[-1] * rate / (1 - rate) / self._norm if self._norm > 0 else np.inf

    @property
    def norm(self) -> float:
        """||u||_A at the last iterate."""
        return self._norm

    @property
    def change(self) -> float:
        """Last change in the A-norm."""
        return self.changes[-1] if self.changes else np.nan

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
        if not np.isfinite(self.residual):
            return True
        return len(self.changes) > 3 and not self.changes[-1] <= 1e6 * max(self.changes[:3])

    @property
    def stalled(self) -> bool:
        """Whether the change has not reached a new minimum for :attr:`PATIENCE` checks."""
        return len(self.changes) > self.PATIENCE and int(np.argmin(self.changes)) < len(self.changes) - self.PATIENCE
