"""Carrying a solution to the next finer level (step b of the paper, u0 = J U0)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy import sparse

from adaptmg.discrete import DiscreteProblem
from adaptmg.multigrid.correction import InitialContact, sliding_limit
from adaptmg.problem import checks
from adaptmg.smoother.system import LocalProblem

__all__ = ["NestedStart", "initial_contact", "project", "prolonged_start"]


@dataclass(frozen=True, kw_only=True)
class NestedStart:
    """How the levels below the finest are solved before it.

    Parameters
    ----------
    cycles : int or "complete", optional
        Cycles on each level between the coarsest and the finest, or until ``rtol`` is met. Default: 1, and 2 where
        bodies touch each other (interpolation carries the edges of their contact less well) on levels that the next
        one outnumbers ``CHEAP`` times.
    rtol : float
        Tolerance on the coarsest level, and with 'complete' on all of them. With two levels and a coarse solve that
        is not condensed a tight one is most of the work of the start.
    """

    #: nodes of the next level over those of this one from which on a second cycle costs less than it saves
    CHEAP: ClassVar[float] = 3.0

    cycles: int | str | None = None
    rtol: float = 1e-8

    def __post_init__(self) -> None:
        if self.cycles is not None and not (isinstance(self.cycles, str) and self.cycles == "complete"):
            checks.integer("cycles", self.cycles, 1)
        object.__setattr__(self, "rtol", checks.tolerance("rtol", self.rtol))

    def cycles_on(self, problem: DiscreteProblem, finer: DiscreteProblem) -> int:
        """Cycles on a level with this problem below one with that, unless complete."""
        if self.cycles is None:
            return 1 if problem.coupling is None or finer.n_nodes < self.CHEAP * problem.n_nodes else 2
        return int(self.cycles)


def project(local: LocalProblem, unknowns: np.ndarray) -> None:
    """Put normal displacements that exceed the gap back onto the obstacle, in place."""
    normal = local.system.nodes.astype(np.int64) * local.system.dim
    unknowns[normal] = np.minimum(unknowns[normal], local.contact.gap)


def prolonged_start(nodal: sparse.csr_array, coarse: LocalProblem, unknowns: np.ndarray,
                    fine: LocalProblem) -> np.ndarray:
    """Interpolate a coarse solution (primal values, all Cartesian components) to the next finer level.

    Parameters
    ----------
    nodal : csr_array (n_nodes fine, n_nodes coarse)
    coarse, fine : LocalProblem
    unknowns : (n_dofs coarse,) array
        Local components on the coarse level.

    Returns
    -------
    (n_dofs fine,) array
        Local components, prescribed values and gaps respected.
    """
    result = fine.to_local(nodal @ coarse.to_cartesian(unknowns))
    project(fine, result)
    return result


def initial_contact(local: LocalProblem, unknowns: np.ndarray, residual: np.ndarray) -> InitialContact:
    """Slip and sliding limit of a first solution (the paper's U0 and G0)."""
    system = local.system
    slip = unknowns.reshape(-1, system.dim)[system.nodes][:, 1:] - local.contact.slip_reference
    return InitialContact(slip, sliding_limit(system, local.contact, residual))
