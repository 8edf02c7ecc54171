"""The paper's correction, its choices selectable (steps a-g of 'Multigrid in Structure Assembling Problem').

The paper keeps as coarse slip U and limit G those of the first complete coarse solution ('initial'), and as coarse
displacement for the non-penetration condition 'the smallest value of u among the value on the same node and on the
two adjacent ones on the fine grid'. Read as the smallest opening that is safe; read literally (the smallest u_n,
which is <= 0) it is the largest opening, and stalls or cycles. A frozen G cannot be exact on the fine grid: the
iteration stops changing before the contact conditions hold, which :class:`adaptmg.Result` reports as STALLED. On the
bars of the paper it is G that matters: with ``limit="summed"`` and the smallest gap every choice of U converged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.multigrid.correction import InitialContact
from adaptmg.problem import checks
from adaptmg.transfer.constraints import (
    Supports,
    injected_gap,
    injected_limit,
    injected_slip,
    largest_gap,
    minmod_slip,
    smallest_gap,
    summed_limit,
)

__all__ = ["PaperCorrection"]


@dataclass(frozen=True, kw_only=True)
class PaperCorrection:
    """The correction of the paper.

    Parameters
    ----------
    gap : {"smallest", "largest", "injected"}
        Opening of a coarse contact node: smallest over the fine nodes it reaches (the paper's choice, read safely),
        largest (read literally), or that of the fine node with the largest weight (nested: the coincident one).
    slip : {"initial", "injected", "minmod"}
        Slip offset U: of the first coarse solution (the paper's choice), of the coincident fine node, or the
        smallest common slip.
    limit : {"initial", "injected", "summed"}
        Sliding limit G: of the first coarse solution (the paper's choice), that of the fine node with the largest
        weight (a nodal force, hence too small on the coarse grid: for comparison), or the sum P'g.
    """

    gap: str = "smallest"
    slip: str = "initial"
    limit: str = "initial"

    def __post_init__(self) -> None:
        checks.choice("gap", self.gap, ("smallest", "largest", "injected"))
        checks.choice("slip", self.slip, ("initial", "injected", "minmod"))
        checks.choice("limit", self.limit, ("initial", "injected", "summed"))

    @property
    def needs_initial(self) -> bool:
        """Whether the first coarse solution is kept."""
        return "initial" in (self.slip, self.limit)

    def transport(self, reach: Supports, opening: np.ndarray, slip: np.ndarray, limit: np.ndarray,
                  initial: InitialContact | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See :class:`adaptmg.multigrid.correction.Correction`."""
        gap = {"smallest": smallest_gap, "largest": largest_gap, "injected": injected_gap}[self.gap](reach, opening)
        if self.slip == "initial":
            coarse_slip = initial.slip
        elif self.slip == "injected":
            coarse_slip = injected_slip(reach, slip)
        else:
            coarse_slip = minmod_slip(reach, slip, (slip == 0.0).all(axis=1))
        if self.limit == "initial":
            coarse_limit = initial.limit
        elif self.limit == "injected":
            coarse_limit = injected_limit(reach, limit)
        else:
            coarse_limit = summed_limit(reach, limit)
        return gap, coarse_slip, coarse_limit
