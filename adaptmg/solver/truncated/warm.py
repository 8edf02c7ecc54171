r"""WarmMultigrid: the truncated multigrid from a start that is nearly solved, contact status and all.

A solution carried to a finer mesh has an algebraic error of some tenths of the discretisation error, and most contact
nodes are in their state. So no cycles are spent on making the status safe, and one cycle may do: the energy
:math:`\eta_1` of its correction and a rate :math:`\rho` known from the mesh before estimate the error that it leaves,
:math:`2\,\rho\,\eta_1`, as :mod:`adaptmg.solver.truncated.energy_test` does from the second cycle on with the rate that
it measures. The certificate, which knows nothing of rates, has the last word.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.hierarchy import Hierarchy
from adaptmg.problem import checks
from adaptmg.solver.multigrid import Multigrid
from adaptmg.solver.run import Outcome, Run

__all__ = ["WarmMultigrid"]


@dataclass(frozen=True, kw_only=True)
class WarmMultigrid(Multigrid):
    """Truncated multigrid from a given start whose contact status is believed; it may stop after one cycle.

    Parameters
    ----------
    first_rate : float
        What is taken for the rate of the first cycle, > 0 and < 1.

    See :class:`adaptmg.Multigrid` for the others; the correction is :class:`adaptmg.Truncated`.
    """

    first_rate: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < checks.number("first_rate", self.first_rate) < 1:
            raise ValueError(f"first_rate must be > 0 and < 1, got {self.first_rate!r}")

    def run(self, hierarchy: Hierarchy, run: Run, start: np.ndarray | None) -> Outcome:
        """Solve on the finest level; see :class:`adaptmg.solver.run.Solver`."""
        if start is None:
            raise ValueError("start: WarmMultigrid goes on from a displacement; without one use FullMultigrid")
        method = self._method(hierarchy, run)
        checks.offers("correction", method, "from_warm", "Truncated(), whose cycles can go on from a warm start")
        return method.from_warm(start, self.first_rate)
