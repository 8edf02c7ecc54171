"""handed_over: goes on where the truncated multigrid does not converge, for the cycles that are left.

On problems of moderate size with the active set method, which needs the finest level alone and few steps, but
factorisations; on larger ones with the monotone correction, which is slow but needs no more memory. A Newton step
counts as a cycle, and its residual as one pass over the finest matrix; factorisations count as seconds.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.corrections import Monotone
from adaptmg.solver.active_set import ActiveSet
from adaptmg.solver.factorisation import FACTORISED
from adaptmg.solver.multigrid import Multigrid
from adaptmg.solver.record import Outcome, Run, Status

_LOG = logging.getLogger(__name__)

#: contact dofs up to which Newton steps are taken on a dense matrix (0.3 GB)
CONDENSED = 6_000


def handed_over(outcome: Outcome, hierarchy: Hierarchy, run: Run) -> Outcome:
    """The outcome, or where it leaves cycles to another method that of this one."""
    problem = hierarchy.finest.discrete
    start = outcome.displacement if outcome.better else None
    if outcome.left and problem.n_dofs <= FACTORISED[problem.dim]:
        for first in (start, None) if outcome.better else (None,):
            # from all nodes sticking the second time
            solver = ActiveSet(rtol=outcome.rtol, max_steps=max(outcome.left, 1),
                               condensed=problem.dim * len(problem.contact.nodes) <= CONDENSED)
            outcome = _continued(outcome, solver, "ActiveSet", first, hierarchy, run)
            if outcome.status.ok or outcome.status is Status.ROUNDING:
                return outcome
    if outcome.left and hierarchy.discretised:
        solver = Multigrid(correction=Monotone(), rtol=outcome.rtol, max_cycles=outcome.left)
        return _continued(outcome, solver, "Monotone", start, hierarchy, run)
    return outcome


def _continued(before: Outcome, solver: ActiveSet | Multigrid, method: str, start: np.ndarray | None,
               hierarchy: Hierarchy, run: Run) -> Outcome:
    if not before.left:
        return before
    _LOG.info("cycle %d: the truncated multigrid does not converge; going on with %s", before.cycles, method)
    run.first_cycle, run.fallback = before.cycles, f"{method} from cycle {before.cycles}"
    start_work_units = run.start_work_units
    try:
        outcome = solver.run(hierarchy, run, start)
    except (np.linalg.LinAlgError, ValueError, MemoryError) as error:
        # a coarsest problem of few contact nodes may be singular where the finest one is not
        _LOG.info("cycle %d: %s gives up: %s", before.cycles, method, error)
        run.first_cycle, run.fallback = 0, ""
        return before
    finally:
        run.start_work_units = start_work_units
    # Newton steps have no rate of a cycle
    return replace(outcome, cycles=before.cycles + outcome.cycles, left=before.left - outcome.cycles,
                   rate=np.nan if isinstance(solver, ActiveSet) else outcome.rate)
