"""solve: one entry for every method: it checks the arguments, runs the solver and confirms the
status of its result."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._text import say
from adaptmg._threads import one_blas_thread
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import StressData
from adaptmg.grids import Grids
from adaptmg.problem.load_path import LoadPath
from adaptmg.solver.active_set import ActiveSet
from adaptmg.solver.advice import advise_on_problem, advise_on_results, once
from adaptmg.solver.closed_forms import free_bodies
from adaptmg.solver.examine import Examiner
from adaptmg.solver.multigrid import from_finest, handed_over
from adaptmg.solver.outcome import (
    checked_outcome,
    displacement_argument,
    grids_argument,
    method_argument,
    result_of,
    start_argument,
)
from adaptmg.solver.record import Run, Solver
from adaptmg.solver.result import NotConverged, Result
from adaptmg.solver.statics import check_statics_of, warn_of_several_solutions
from adaptmg.solver.steps import Method

_LOG = logging.getLogger(__name__)


@once()
@one_blas_thread()
def solve(
    grids: Grids | DiscreteProblem,
    solver: Solver | Method | None = None,
    *,
    start: ArrayLike | Result | None = None,
    reference: ArrayLike | Result | None = None,
    rtol: float | None = None,
    throw: bool = True,
    callback: Callable[[dict[str, float]], None] | None = None,
    progress: bool = False,
) -> Result:
    """Solve a contact problem on the finest level of a hierarchy.

    Parameters
    ----------
    grids : Hierarchy or DiscreteProblem
        A bare DiscreteProblem is a hierarchy of one level.
    solver : SingleGrid, Multigrid, FullMultigrid, ActiveSet or user-defined, optional
        A user-defined one offers ``setup(hierarchy, start) -> stepper`` with ``step(state) ->
        state`` (:class:`adaptmg.solver.steps.Method`), or ``run``
        (:class:`adaptmg.solver.record.Solver`). Default ``FullMultigrid()``, where coarse levels
        are only spaces ``Multigrid()``. On one level the quickest: ``ActiveSet()``, or for large
        problems ``Multigrid()`` on coarse spaces made from the matrix. Where the finest level has
        at most 600 unknowns (in space 500, of scalar problems 200): ``ActiveSet(rtol=1e-8)`` on it
        alone, and ``FullMultigrid()`` on all levels if that does not converge; load paths take
        multigrid. Where the coarsest level has
        more than 1500 unknowns: without levels of less than 4 (2D: 2) times the nodes of the next
        coarser one, and ``ActiveSet()`` where none is left and contact nodes are few. Printing the
        result says which and why.
    start : (n_nodes, dim) array or Result, optional
        Where to start, m; default zero. Of smoothed elements with Poisson's ratios above .4 a
        Result has the pressures, too, an array begins with none. FullMultigrid makes its own start
        and refuses one. With Coulomb friction there may be several solutions
        (:func:`~adaptmg.cases.leaning_strut` has three), which other starts show.
    reference : (n_nodes, dim) array or Result, optional
        The exact discrete solution, m: the history then has the true relative A-norm error
        (``true_error``).
    rtol : float, optional
        Tolerance of the default solver, where none is given (1e-8); others have it as an option:
        ``am.FullMultigrid(rtol=1e-10, max_cycles=200)``.
    throw : bool
        Raise :class:`NotConverged`, which carries the result, if the tolerance is not reached.
    callback : callable, optional
        Called with each row of the history (a dict), for progress bars.
    progress : bool
        Write a line a cycle to standard error.

    Raises
    ------
    ValueError
        Bad input, or a rigid motion that neither supports nor contact prevent.
    NotConverged

    Warns
    -----
    UserWarning
        Of Poisson's ratios above .45 (linear elements lock), lengths that look like mm, strains
        above 5 %, bodies that cannot meet, slaves far stiffer than their masters, and slips between
        bodies beyond an element: theory and elements are linear, strains and slips small.
    RuntimeWarning
        Of friction so large that there may be several solutions.

    Notes
    -----
    Forces that are prescribed (:class:`adaptmg.Rigid`, :class:`adaptmg.Preload`) are met by several
    contact problems, and so are plastic bodies (:class:`adaptmg.Plastic`), as in a load path of one
    step; ``start`` and ``reference`` are then refused.

    A solve takes one thread, or those of :func:`adaptmg.set_threads`; several run at the same time
    as a
    :class:`adaptmg.Study`.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> result.status.name, len(result.contact.pressure)
    ('CONVERGED', 5)
    """
    posed_grids = grids_argument(grids)
    posed = posed_grids.posed
    in_steps = posed_grids.finest.discrete.inelastic or (
        posed is not None and posed.problem.by_force
    )
    grids, solver, choice = method_argument(solver, posed_grids, rtol, single=not in_steps)
    checks.flag("throw", throw)
    checks.flag("progress", progress)
    checks.optional_callable("callback", callback, "a row of the history")
    if in_steps:
        result = _first_step(posed_grids, solver, start, reference, _watched(callback, progress))
        if throw and not result.status.ok:
            raise NotConverged(result)
        return result
    discrete = grids.finest.discrete
    exact = displacement_argument("reference", reference, discrete)
    first = start_argument(start, discrete)
    run = Run(
        unit=discrete.rows.nonzeros,
        callback=_watched(callback, progress),
        reference=exact,
        # of the coarse spaces and prolongations that the default has made
        timings={} if grids is posed_grids else dict(grids.timings),
    )
    _LOG.debug("%s", grids)  # as a table, made where somebody reads it
    with run.phase("statics"):
        check_statics_of(grids)
    with run.phase("setup"):
        bodies = free_bodies(posed, discrete)
        examiner = Examiner(discrete, bodies)
        run.examiner = examiner
        warn_of_several_solutions(grids)
        advise_on_problem(posed)
    if len(grids) == 1 < len(posed_grids):  # the default for few unknowns
        outcome, grids = from_finest(cast("ActiveSet", solver), grids, run, first, posed_grids)
    else:
        outcome = solver.run(grids, run, first)
    outcome = handed_over(checked_outcome(outcome, solver, discrete), grids, run)
    with run.phase("result"):
        stress_data = (
            None
            if posed is None
            else StressData.of(
                posed.mesh, posed.materials, posed.problem.loads, posed.problem.elements
            )
        )
        result = result_of(grids, examiner, run, outcome, solver, stress_data, choice)
        advise_on_results(posed, discrete, [result])
    _LOG.info(
        "%s, %d nodes: %s after %d cycles, %.1f work units and %.3g s (%s)",
        result.problem_name,
        discrete.n_nodes,
        result.status.name,
        result.cycles,
        result.work_units,
        result.seconds,
        result.method,
    )
    _LOG.debug("seconds by phase: %s", result.timings)
    if throw and not result.status.ok:
        raise NotConverged(result)
    return result


def _first_step(
    grids: Grids,
    solver: Solver,
    start: ArrayLike | Result | None,
    reference: ArrayLike | Result | None,
    watched: Callable[[dict[str, float]], None] | None,
) -> Result:
    """Return the result under all loads of a problem that takes several contact problems."""
    from adaptmg.evolution.load_path import solve_path  # other problems start sooner without

    for name, value in (("start", start), ("reference", reference)):
        if value is not None:
            raise ValueError(
                f"{name} must be None: a Rigid obstacle, a Preload or plastic bodies take several "
                "contact problems"
            )
    progress = None if watched is None else lambda _, row: watched(row)
    return solve_path(grids, LoadPath(), solver, throw=False, progress=progress)[0]


def _watched(
    callback: Callable[[dict[str, float]], None] | None, progress: bool
) -> Callable[[dict[str, float]], None] | None:
    """Return a callback that also logs each row of the history, and writes it to standard error."""
    if not progress and not _LOG.isEnabledFor(logging.DEBUG):
        return callback

    def take(row: dict[str, float]) -> None:
        """Write a row of the history as a line, and pass it on."""
        errors = [
            f"{name.removesuffix('_estimate')} {row[name]:.1e}"
            for name in ("error_estimate", "residual")
            if np.isfinite(row.get(name, np.nan))
        ]
        line = ", ".join(
            [
                f"cycle {row['cycle']}: {row['work_units']:.1f} work units",
                *errors,
                f"{row['seconds']:.2f} s",
            ]
        )
        _LOG.debug(line)
        if progress:
            say(line)
        if callback is not None:
            callback(row)

    return take
