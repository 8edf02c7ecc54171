r"""The complete solution of a coarse problem by the smoother (the paper's SOR with projection).

By default the coarsest problem is condensed to its contact dofs first, as the paper does ('a condensation of the
problem to the contact variables alone'): one factorisation in the set-up, far fewer sweeps, on a small dense matrix.

Sweeps go in batches; with :math:`\delta_m` the change over batch m in the norm of the diagonal blocks and
:math:`\rho = \delta_m/\delta_{m-1}` the remaining error is estimated as :math:`\delta_m\,\rho/(1-\rho)`, which costs no
matrix pass. The paper's kind of test, on the change of one sweep alone, is there for comparison.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.multigrid.correction import Recorder
from adaptmg.problem import checks
from adaptmg.smoother.gauss_seidel import ProjectedGaussSeidel
from adaptmg.smoother.system import LocalSystem, NodalContact

__all__ = ["CoarseSolve"]


@dataclass(frozen=True, kw_only=True)
class CoarseSolve:
    """Sweeps of projected Gauss-Seidel (SOR) to a tolerance.

    Parameters
    ----------
    condensed : bool
        Sweep on the Schur complement of the contact dofs on the coarsest level. Its sweeps are counted as work by its
        entries; the factorisation and its solves are reported as seconds ('factorise', and within the cycles).
    rtol : float
        Tolerance relative to the solution of the coarse problem: for ``test="error"`` of the estimated error in the
        norm of the diagonal blocks, for ``test="change"`` of the Euclidean change in one sweep.
    atol : float
        Absolute tolerance added to it, in m, on the Euclidean norm (``test="change"`` only).
    test : {"error", "change"}
    omega : float
        Over-relaxation.
    max_sweeps : int
        At most so many; the iterate reached is used.
    """

    condensed: bool = True
    rtol: float = 1e-2
    atol: float = 0.0
    test: str = "error"
    omega: float = 1.5
    max_sweeps: int = 2000

    #: sweeps between tests of the error
    BATCH = 4

    def __post_init__(self) -> None:
        object.__setattr__(self, "rtol", checks.nonnegative("rtol", self.rtol))
        object.__setattr__(self, "atol", checks.nonnegative("atol", self.atol))
        if not self.rtol < 1:
            raise ValueError(f"rtol must be < 1, a share of the solution, got {checks.shown(self.rtol)}")
        checks.flag("condensed", self.condensed)
        if self.rtol == 0 and self.atol == 0:
            raise ValueError("rtol and atol must not both be 0")
        checks.choice("test", self.test, ("error", "change"))
        if self.atol > 0 and self.test == "error":
            raise ValueError("atol is for test='change'; give rtol with test='error'")
        ProjectedGaussSeidel(omega=self.omega)
        checks.integer("max_sweeps", self.max_sweeps, 1)

    def solve(self, system: LocalSystem, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray,
              recorder: Recorder) -> int:
        """Sweep until the tolerance is met, changing ``unknowns`` (n_dofs,) in place; returns the number of sweeps."""
        smoother = ProjectedGaussSeidel(omega=self.omega)
        batch = self.BATCH if self.test == "error" else 1
        norm = self._block_norm(system) if self.test == "error" else np.linalg.norm
        before, sweeps, change = unknowns.copy(), 0, np.inf
        while sweeps < self.max_sweeps:
            passes = smoother.smooth(system, contact, load, unknowns, batch)
            recorder.count(passes, system.nonzeros)
            sweeps += batch
            previous, change = change, float(norm(unknowns - before))
            size = float(norm(unknowns))
            if not np.isfinite(size) or change == 0.0:
                break
            if self.test == "change":
                error = change
            else:
                rate = change / previous if np.isfinite(previous) else np.inf
                error = change * rate / (1 - rate) if rate < 1 else np.inf
            if error <= self.rtol * size + self.atol:
                break
            before[:] = unknowns
        return sweeps

    @staticmethod
    def _block_norm(system: LocalSystem):
        blocks = system.diagonal.reshape(-1, system.dim, system.dim)

        def norm(vector: np.ndarray) -> float:
            v = vector.reshape(-1, system.dim)
            return float(np.sqrt(np.einsum("ni,nij,nj->", v, blocks, v)))

        return norm
