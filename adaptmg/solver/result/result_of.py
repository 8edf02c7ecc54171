"""result_of: the Result of what a solver returned, its status confirmed."""

from __future__ import annotations

import logging

import numpy as np

from adaptmg.discretisation.measures import StressData
from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.certificate import Certificate
from adaptmg.solver.result.examiner import Examiner
from adaptmg.solver.result.labels import problem_name, solver_name, versions
from adaptmg.solver.result.result import Result
from adaptmg.solver.result.status import Status
from adaptmg.solver.run import Outcome, Run, Solver
from adaptmg.solver.stop_test import StopTest

__all__ = ["result_of"]

_LOG = logging.getLogger(__name__)


def result_of(grids: Hierarchy, examiner: Examiner, run: Run, outcome: Outcome, solver: Solver,
              stress_data: StressData | None) -> Result:
    """The Result on the finest level; what is examined must confirm the status.

    Parameters
    ----------
    grids : Hierarchy
    examiner : Examiner
        Of the finest level.
    run : Run
        Of the solver.
    outcome : Outcome
        What it returned; between bodies relative.
    solver : Solver
        For its name.
    stress_data : StressData or None
        For the stresses.
    """
    with run.phase("certificate"):
        found = examiner(outcome.displacement)
    keys = dict.fromkeys(key for row in run.history for key in row)
    history = {key: np.array([row.get(key, np.nan) for row in run.history]) for key in keys}
    return Result(displacement=found.displacement, reaction=found.reaction, checked=found.checked,
                  status=_confirmed(outcome, found.residual, found.checked, getattr(solver, "stop", "error")),
                  cycles=outcome.cycles,
                  contact=found.contact, work_units=run.work_units, residual=found.residual,
                  error_estimate=float(np.fmax(outcome.error_estimate, found.checked.energy_error)),
                  rate=outcome.rate, rtol=outcome.rtol, history=history,
                  timings=run.timings, path=run.path, levels=grids.table(ratios=False),
                  problem_name=problem_name(grids), solver_name=solver_name(solver, run), mesh=grids.finest.mesh,
                  start_work_units=run.start_work_units, versions=versions(), stress_data=stress_data,
                  supports={} if grids.problem is None or grids.finest.mesh is None else grids.problem.held_components)


def _confirmed(outcome: Outcome, residual: float, checked: Certificate, stop: str) -> Status:
    """The status of a solver, unless what it returned, examined here anew, contradicts it.

    With the paper's test rtol is that of a change: the error is held against the multiple that the residual has.
    """
    if not np.isfinite(residual):
        return Status.DIVERGED
    wanted = max(StopTest.RESIDUAL_FACTOR * outcome.rtol, StopTest.ROUNDING_LIMIT)
    # twice: solvers sum the same numbers in another order
    if outcome.status.ok and not residual <= 2 * wanted:
        return Status.DIVERGED if not residual < 1 else Status.STALLED
    factor = StopTest.RESIDUAL_FACTOR if stop == "change" else checked.ENERGY_FACTOR
    found = checked.contradictions(outcome.rtol, factor)
    if not checked.energy_error < 1:
        found = *found, "energy error of the size of the solution"
    if outcome.status.ok and found:
        _LOG.info("said to be converged, contradicted by %s", ", ".join(found))
        _LOG.debug("%s", checked)
        return Status.STALLED
    return outcome.status
