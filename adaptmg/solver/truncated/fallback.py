"""Fallback: what goes on where the truncated multigrid does not converge: the active set method, or monotone cycles.

The active set method needs the finest level alone and few steps, but factorisations, so it is for problems of
moderate size; larger ones go on with the monotone correction, which is slow but needs no more memory. Newton steps
count as cycles, and the residual of each as one pass over the finest matrix; factorisations count as seconds.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import ClassVar

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.monotone import Monotone
from adaptmg.multigrid.nested import project
from adaptmg.solver.method import MultigridOptions
from adaptmg.solver.newton.active_set import ActiveSet
from adaptmg.solver.projected import ProjectedMultigrid
from adaptmg.solver.run import Outcome, Run

__all__ = ["Fallback"]

_LOG = logging.getLogger(__name__)


class Fallback:
    """Takes over a run of the truncated multigrid.

    Parameters
    ----------
    options : MultigridOptions
    hierarchy : Hierarchy
    run : Run
        Its ``fallback`` names what took over, its ``first_cycle`` says after how many cycles.
    rtol : float
        As for :class:`~adaptmg.solver.multigrid.Multigrid`.
    """

    #: dofs up to which sparse factorisations are sensible, by dimension
    FACTORISED: ClassVar[dict[int, int]] = {2: 200_000, 3: 60_000}
    #: contact dofs up to which the steps are taken on a dense matrix (0.3 GB)
    CONDENSED = 6_000

    def __init__(self, options: MultigridOptions, hierarchy: Hierarchy, run: Run, rtol: float) -> None:
        self.options, self.hierarchy, self.run, self.rtol = options, hierarchy, run, rtol
        self.problem: DiscreteProblem = hierarchy.finest.discrete

    def finish(self, outcome: Outcome, better: bool) -> Outcome:
        """Solve with what is left of the cycles.

        Parameters
        ----------
        outcome : Outcome
            How the truncated multigrid ended; not converged.
        better : bool
            Whether its iterate is better than none: one that ran away is given up.

        Returns
        -------
        Outcome
            That of the first method that converges; else of the last one tried, or ``outcome``.
        """
        start = outcome.displacement if better else None
        if self.problem.n_dofs <= self.FACTORISED[self.problem.dim]:
            for first in (start, None) if better else (None,):
                outcome = self._active_set(outcome, first)
                if outcome.status.ok:
                    return outcome
        return self._monotone(outcome, start) if self.hierarchy.discretised else outcome

    def _active_set(self, before: Outcome, start: np.ndarray | None) -> Outcome:
        """Semismooth Newton steps from ``start`` (n_nodes, dim), or from all nodes sticking."""
        left = self.options.max_cycles - before.cycles
        if left < 1:
            return before
        self._take_over(before.cycles, "ActiveSet")
        solver = ActiveSet(rtol=self.rtol, max_steps=left,
                           condensed=self.problem.dim * len(self.problem.contact.nodes) <= self.CONDENSED)
        start_work_units = self.run.start_work_units
        try:
            outcome = solver.run(self.hierarchy, self.run, start)
        except (np.linalg.LinAlgError, ValueError, MemoryError) as error:
            return self._given_up("the active set method", before, error)
        finally:
            self.run.start_work_units = start_work_units
        # Newton steps have no rate of a cycle
        return replace(outcome, cycles=before.cycles + outcome.cycles, rate=np.nan)

    def _monotone(self, before: Outcome, start: np.ndarray | None) -> Outcome:
        """Cycles with the monotone correction from ``start`` (n_nodes, dim), or from zero: slower, but they go on."""
        left = self.options.max_cycles - before.cycles
        if left < 1:
            return before
        self._take_over(before.cycles, "Monotone")
        options = replace(self.options, correction=Monotone(), rtol=self.rtol, max_cycles=left)
        method = ProjectedMultigrid(options, self.hierarchy, self.run)
        local = method.problems[-1]
        unknowns = local.to_local(self.problem.fixed_values if start is None else start)
        project(local, unknowns)
        try:
            outcome = method.finish(unknowns)
        except (np.linalg.LinAlgError, ValueError, MemoryError) as error:
            # a coarsest problem of few contact nodes may be singular where the finest one is not
            return self._given_up("the monotone correction", before, error)
        return replace(outcome, cycles=before.cycles + outcome.cycles)

    def _given_up(self, method: str, before: Outcome, error: Exception) -> Outcome:
        _LOG.info("cycle %d: %s gives up: %s", before.cycles, method, error)
        self.run.first_cycle, self.run.fallback = 0, ""
        return before

    def _take_over(self, cycles: int, method: str) -> None:
        _LOG.info("cycle %d: the truncated multigrid does not converge; going on with %s", cycles, method)
        self.run.first_cycle, self.run.fallback = cycles, f"{method} from cycle {cycles}"
