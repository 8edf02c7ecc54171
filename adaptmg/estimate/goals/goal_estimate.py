"""GoalEstimate: the estimate of a goal, quantity by quantity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.estimate.estimate import Estimate

__all__ = ["GoalEstimate"]


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class GoalEstimate(Estimate):
    """An estimate of the error of quantities of interest.

    Parameters
    ----------
    names, units : tuples of str
        Of the quantities.
    values, errors : (n,) arrays
        Of the discrete solution, and estimated exact minus discrete values.
    algebraic : (n,) array
        The part of ``errors`` that the solver has left.
    discretisation : float
        Estimated relative energy error of the discrete solution.
    residuals : (n,) array
        Relative residuals of the adjoint problems.
    iterations : int
        Of GMRES, in all; 0 of direct solutions.
    converged : bool
        Whether all adjoint problems were solved to the tolerance asked for.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    values: np.ndarray
    errors: np.ndarray
    algebraic: np.ndarray
    discretisation: float
    residuals: np.ndarray
    iterations: int = 0
    converged: bool = True

    @property
    def corrected(self) -> np.ndarray:
        """Values plus estimated errors (n,)."""
        return self.values + self.errors

    def __repr__(self) -> str:
        lines = [f"Estimate by {self.indicator}: {len(self.squares)} elements, estimated relative energy error "
                 f"{self.discretisation:.3%}"]
        width = max(map(len, self.names))
        lines += [f"  {name:<{width}s} {value:14.7g} {unit:<3s} estimated error {error:+.3g} (exact minus discrete)"
                  + (f", {error / abs(value):+.3%}" if value else "")
                  for name, unit, value, error in zip(self.names, self.units, self.values, self.errors, strict=True)]
        if not self.converged:
            lines.append(f"  the adjoint problems were not solved: residual {self.residuals.max():.1e}; take more "
                         "max_iterations")
        return "\n".join(lines)
