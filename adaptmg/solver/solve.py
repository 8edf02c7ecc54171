"""solve: one entry for every method."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.discretisation.measures import StressData
from adaptmg.hierarchy import Hierarchy
from adaptmg.problem import checks
from adaptmg.runtime.threads import one_blas_thread
from adaptmg.solver.arguments import (
    checked_outcome,
    displacement_argument,
    grids_argument,
    solver_argument,
)
from adaptmg.solver.critical_friction import warn_of_large_friction, warn_of_several_solutions
from adaptmg.solver.result import Result
from adaptmg.solver.result.examiner import Examiner
from adaptmg.solver.result.not_converged import NotConverged
from adaptmg.solver.result.result_of import result_of
from adaptmg.solver.run import Run, Solver
from adaptmg.solver.statics import check_statics_of

__all__ = ["solve"]


@one_blas_thread()
def solve(grids: Hierarchy | DiscreteProblem, solver: Solver | None = None, *, start: np.ndarray | Result | None = None,
          reference: np.ndarray | Result | None = None, throw: bool = True,
          callback: Callable[[dict[str, float]], None] | None = None) -> Result:
    """Solve a contact problem on the finest level of a hierarchy.

    Parameters
    ----------
    grids : Hierarchy or DiscreteProblem
        A bare DiscreteProblem is a hierarchy of one level.
    solver : SingleGrid, Multigrid, FullMultigrid, ActiveSet or one's own, optional
        Default ``FullMultigrid()``, where coarse levels are only spaces ``Multigrid()``, on one level
        ``SingleGrid()``. One's own offers ``run`` (see
        :class:`adaptmg.solver.run.Solver`).
    start : (n_nodes, dim) array or Result, optional
        Where to start, m; default zero. FullMultigrid makes its own start and refuses one. With Coulomb friction there
        may be several solutions (:func:`~adaptmg.cases.leaning_strut` has three): starts from other solutions, of the
        problem without friction or with more of it, say, show whether there are.
    reference : (n_nodes, dim) array or Result, optional
        The exact discrete solution, m: the history then has the true relative A-norm error (``true_error``).
    throw : bool
        Raise :class:`NotConverged`, which carries the result, if the tolerance is not reached; False returns the
        result, and ``result.status`` says it.
    callback : callable, optional
        Called with each row of the history (a dict), for progress bars.

    Returns
    -------
    Result

    Raises
    ------
    ValueError
        Bad input, or a rigid motion that neither supports nor contact hold.
    NotConverged
    """
    grids = grids_argument(grids)
    solver = solver_argument(solver, grids)
    checks.flag("throw", throw)
    checks.optional_callable("callback", callback, "a row of the history")
    discrete = grids.finest.discrete
    known = displacement_argument("reference", reference, discrete)
    first = displacement_argument("start", start, discrete)
    run = Run(unit=discrete.matrix.nnz, callback=callback, reference=known)
    with run.phase("statics"):
        check_statics_of(grids)
    with run.phase("setup"):
        run.examiner = examiner = Examiner(discrete)
        warn_of_large_friction(examiner)
        warn_of_several_solutions(grids)
    outcome = checked_outcome(solver.run(grids, run, first), solver, discrete)
    with run.phase("result"):
        posed, mesh = grids.problem, grids.finest.mesh
        stress_data = None if posed is None or mesh is None else StressData.of(mesh, posed.material, posed.loads)
        result = result_of(grids, examiner, run, outcome, solver, stress_data)
    if throw and not result.status.ok:
        raise NotConverged(result)
    return result
