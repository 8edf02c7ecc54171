"""Confirm: a result that says it has converged is examined, and iterated further where it fell short.

Every method estimates its error from its own progress. The certificate knows nothing of that: where its estimate of
the error lies above the tolerance, the method goes on from where it stopped with a tolerance as much tighter, a few
times at most. What then still contradicts takes the status back (:mod:`adaptmg.solver.result.result_of`).
"""

from __future__ import annotations

import logging
from dataclasses import fields, replace
from typing import Any

import numpy as np

from adaptmg.discretisation.measures import StressData
from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.multigrid import FullMultigrid, Multigrid
from adaptmg.solver.newton.active_set import ActiveSet
from adaptmg.solver.result import Result
from adaptmg.solver.result.examiner import Examiner
from adaptmg.solver.result.result_of import result_of
from adaptmg.solver.run import Outcome, Run, Solver
from adaptmg.solver.single_grid import SingleGrid
from adaptmg.solver.truncated.warm import WarmMultigrid

__all__ = ["confirmed_result"]

_LOG = logging.getLogger(__name__)

#: continuations at most
_TIMES = 3
#: tolerances below this are rounding
_LEAST = 1e-14
_LIMITS = {Multigrid: "max_cycles", FullMultigrid: "max_cycles", WarmMultigrid: "max_cycles", ActiveSet: "max_steps",
           SingleGrid: "max_sweeps"}


def confirmed_result(grids: Hierarchy, examiner: Examiner, run: Run, outcome: Outcome, solver: Solver,
                     stress_data: StressData | None) -> Result:
    """The Result of what a solver returned, after further iterations where it fell short.

    Parameters
    ----------
    grids, examiner, run, outcome, solver, stress_data
        As of :func:`~adaptmg.solver.result.result_of.result_of`.
    """
    result = result_of(grids, examiner, run, outcome, solver, stress_data)
    for _ in range(_TIMES):
        closer = _closer(solver, outcome, result)
        if closer is None:
            break
        run.first_cycle, cycles = outcome.cycles, outcome.cycles
        _LOG.info("after %d cycles the certificate estimates an error of %.2e: going on to %.1e", cycles,
                  result.checked.energy_error, closer.rtol)
        try:
            further = closer.run(grids, run, examiner.discrete.relative(result.displacement))
        except (ValueError, np.linalg.LinAlgError) as error:
            _LOG.info("which fails: %s", error)
            break
        status = further.status if further.status.ok else outcome.status
        outcome = replace(further, cycles=cycles + further.cycles, rtol=outcome.rtol, status=status)
        better = result_of(grids, examiner, run, outcome, solver, stress_data)
        if not better.checked.energy_error <= result.checked.energy_error:
            break
        result = better
    return result


def _closer(solver: Any, outcome: Outcome, result: Result) -> Any:
    """The method with a tighter tolerance, from the present iterate; None where nothing is wrong, or nothing helps."""
    limit = _LIMITS.get(type(solver))
    if limit is None or not outcome.status.ok or getattr(solver, "stop", "error") != "error":
        return None
    checked, rtol = result.checked, outcome.rtol
    # solved to rounding before a cycle could show the discretisation error
    if not rtol > 0:
        return None
    short = checked.energy_error / rtol
    if not (np.isfinite(short) and (short > Run.ENOUGH or checked.contradictions(rtol))):
        return None
    if checked.energy_error <= checked.energy_rounding:
        return None
    left = getattr(solver, limit) - outcome.cycles
    tighter = 0.5 * rtol / max(short, 2.0)
    if left < 1 or tighter < _LEAST:
        return None
    options = {"rtol": tighter, limit: left}
    if isinstance(solver, FullMultigrid):
        return Multigrid(**({item.name: getattr(solver, item.name) for item in fields(Multigrid)} | options))
    if isinstance(solver, ActiveSet):
        options["nested_start"] = False
    return replace(solver, **options)
