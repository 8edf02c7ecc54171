"""Truncated: the truncated nonsmooth Newton multigrid as a correction, its options and what it is run by."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.coarse_solve import CoarseSolve
from adaptmg.multigrid.cycle import Cycle
from adaptmg.multigrid.linear.own_parts import LinearSmoother, LinearSolve
from adaptmg.multigrid.linear.split_matrix import SplitMatrix
from adaptmg.problem import checks
from adaptmg.smoother.gauss_seidel import ProjectedGaussSeidel
from adaptmg.solver.history.truncated_steps import TruncatedSteps
from adaptmg.solver.method import Method, MultigridOptions
from adaptmg.solver.run import Run
from adaptmg.solver.truncated.multigrid import TruncatedMultigrid

__all__ = ["Truncated"]


@dataclass(frozen=True, kw_only=True)
class Truncated:
    """Truncated nonsmooth Newton multigrid: the fast method.

    Parameters
    ----------
    recombine : int
        Past iterates recombined with the present one, 0 to 2.
    coarse_sweeps : int, optional
        Smoothing before and after the coarse correction on the coarser levels, 1 or 2; there is one symmetric sweep on
        the finest. Default: 1 on levels whose matrix has more than 1.25 times the entries a row of the finest one
        (Galerkin products of independent meshes, which converge as well with less), 2 on the others.
    safe_cycles : int
        Cycles with g frozen, symmetric truncation and a line search at most, taken while the contact status of a cold
        start changes; twice as many whenever the residual stops falling. They make cold starts safe.
    interface_sweeps : int
        Where bodies touch each other: sweeps over the nodes within two elements of the interface after each smoothing
        of the finest level, backward and forward in turn. On large meshes they cost a few per cent of a cycle, on small
        graded ones a tenth; where a joint is soft they bring the rate from .6 or .7 to .4 (``studies/dovetail.py``).
    coarse_solve : LinearSolve, optional
        One's own solver of the coarsest linear problems, anything with ``setup(matrix) -> object with solve(rhs)``; see
        :class:`~adaptmg.multigrid.linear.own_parts.LinearSolve`. Default: LU factors.
    coarse_smoother : LinearSmoother, optional
        One's own smoother of the linear problems between the coarsest level and the finest, anything with
        ``setup(matrix) -> object with smooth(rhs, x) -> passes``. Default: Gauss-Seidel sweeps. The smoother of the
        finest level, projected sweeps that leave the residual behind, is part of the method.
    """

    #: how much denser than the finest matrix a coarse one is that is smoothed once only
    DENSE: ClassVar[float] = 1.25
    #: rtol="discretisation" can be had
    shows_discretisation_error: ClassVar[bool] = True

    recombine: int = 2
    coarse_sweeps: int | None = None
    safe_cycles: int = 20
    interface_sweeps: int = 2
    coarse_solve: LinearSolve | None = None
    coarse_smoother: LinearSmoother | None = None

    def __post_init__(self) -> None:
        if checks.integer("recombine", self.recombine) > 2:
            raise ValueError(f"recombine must be 0, 1 or 2, got {self.recombine!r}")
        if self.coarse_sweeps is not None and checks.integer("coarse_sweeps", self.coarse_sweeps, 1) > 2:
            raise ValueError(f"coarse_sweeps must be 1 or 2, got {self.coarse_sweeps!r}")
        checks.integer("safe_cycles", self.safe_cycles)
        checks.integer("interface_sweeps", self.interface_sweeps)
        if self.coarse_solve is not None:
            checks.offers("coarse_solve", self.coarse_solve, "setup",
                          "a linear solver, which offers setup(matrix) -> object with solve(rhs) -> solution")
        if self.coarse_smoother is not None:
            checks.offers("coarse_smoother", self.coarse_smoother, "setup",
                          "a linear smoother, which offers setup(matrix) -> object with smooth(rhs, x) -> passes")

    def sweeps(self, levels: Sequence[SplitMatrix]) -> list[int]:
        """Sweeps on each of the levels, coarsest first."""
        if self.coarse_sweeps is not None:
            return [self.coarse_sweeps] * len(levels)
        rows = [level.nonzeros / level.n_nodes for level in levels]
        return [1 if row > self.DENSE * rows[-1] else 2 for row in rows]

    @staticmethod
    def not_taken(options: MultigridOptions) -> str:
        """Name of an option that is not at its default though Truncated has its own; empty if there is none."""
        defaults = {"cycle": Cycle(), "smoother": ProjectedGaussSeidel(), "coarse": CoarseSolve(),
                    "coarse_matrices": "galerkin", "stop": "error"}
        return next((name for name, default in defaults.items() if getattr(options, name) != default), "")

    def check_options(self, options: MultigridOptions) -> None:
        """Refuse what it does not take; see :mod:`adaptmg.solver.method`."""
        name = self.not_taken(options)
        if name:
            raise ValueError(f"{name}: Truncated() has its own; leave it at its default, or take correction=Monotone()")

    def method(self, options: MultigridOptions, hierarchy: Hierarchy, run: Run) -> Method:
        """What runs it; see :mod:`adaptmg.solver.method`."""
        return TruncatedMultigrid(options, hierarchy, run)

    def load_steps(self, options: MultigridOptions) -> TruncatedSteps:
        """What takes it through load steps, set up once; see :mod:`adaptmg.solver.method`."""
        return TruncatedSteps(options)
