r"""solve_path: quasi-static load histories, step by step.

Friction acts on increments: at step k the slip is :math:`u_t^k - u_t^{k-1}`, against the displacement of the step
before (implicit Euler; no time occurs). Every step is a contact problem of its own with other loads, prescribed values
and slip references; matrices and transfers stay.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.problem import checks
from adaptmg.problem.load_path import LoadPath
from adaptmg.runtime.threads import one_blas_thread
from adaptmg.solver.arguments import (
    displacement_argument,
    grids_argument,
    solver_argument,
)
from adaptmg.solver.critical_friction import warn_of_large_friction
from adaptmg.solver.history.path_result import PathResult
from adaptmg.solver.history.store import PathStore
from adaptmg.solver.history.walk import PathWalk
from adaptmg.solver.result import Result
from adaptmg.solver.result.not_converged import NotConverged
from adaptmg.solver.run import Solver

__all__ = ["StepNotConverged", "solve_path"]


class StepNotConverged(NotConverged):
    """Raised by :func:`solve_path` when a step did not reach its tolerance.

    Attributes
    ----------
    result : Result
        The last iterate of that step.
    step : int
    described : str
        The factors of that step.
    partial : PathResult
        The steps before it, and it.
    """

    def __init__(self, result: Result, step: int, described: str, partial: PathResult) -> None:
        super().__init__(result)
        self.step, self.described, self.partial = step, described, partial
        self.args = (f"step {step} of {partial.n_steps} ({described}): {self.args[0]} Smaller load steps help where "
                     "the contact status changes much; the steps before it are in .partial.",)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.result, self.step, self.described, self.partial)


@one_blas_thread()
def solve_path(grids: Hierarchy | DiscreteProblem, path: LoadPath, solver: Solver | None = None, *,
               start: np.ndarray | Result | None = None, store: str | os.PathLike[str] | None = None,
               throw: bool = True, callback: Callable[[int, Result], None] | None = None,
               progress: Callable[[int, dict[str, float]], None] | None = None) -> PathResult:
    """Solve a contact problem along a load path on the finest level of a hierarchy.

    Parameters
    ----------
    grids : Hierarchy or DiscreteProblem
        A bare DiscreteProblem is a hierarchy of one level; its loads have no names, so that ``path`` has ``default``
        alone.
    path : LoadPath
    solver : SingleGrid, Multigrid, FullMultigrid, ActiveSet or one's own, optional
        The default is that of :func:`adaptmg.solve`. ``rtol`` refers to the whole displacement of a step;
        "discretisation" sets it once, in the first step. Multigrid with :class:`adaptmg.Truncated` is set up once.
    start : (n_nodes, dim) array or Result, optional
        Displacement against which the first step slips, m. Default: the unloaded, undeformed bodies.
    store : path, optional
        A folder where every finished step is kept at once. A path that was interrupted goes on there; a folder with
        steps of another problem, hierarchy, path or solver is refused.
    throw : bool
        Raise :class:`StepNotConverged` if a step does not reach the tolerance. False ends the path with that step,
        whose status says it; ``complete`` is then False.
    callback : callable, optional
        Called with the number and the Result of each step when it is finished, and kept.
    progress : callable, optional
        Called with the number of the step and each row of its history.

    Returns
    -------
    PathResult

    Raises
    ------
    ValueError
        Bad input, or a rigid motion that neither supports nor contact hold in a step.
    StepNotConverged
    """
    grids = grids_argument(grids)
    checks.instance("path", path, LoadPath, "a LoadPath")
    solver = solver_argument(solver, grids)
    checks.flag("throw", throw)
    checks.optional_callable("callback", callback, "the number and Result of a step")
    checks.optional_callable("progress", progress, "the number of a step and a row of its history")
    walk = PathWalk(grids, path, solver, displacement_argument("start", start, grids.finest.discrete))
    mark = {} if store is None else walk.fingerprint()
    kept = None if store is None else PathStore(store, walk.factors, len(path), mark)
    results = [] if kept is None else kept.results
    for k, result in enumerate(results):
        walk.replay(k, result)
    if len(results) < len(path):
        warn_of_large_friction(walk.examiner)
    for k in range(len(results), len(path)):
        result = walk.step(k, progress)
        results.append(result)
        if not result.status.ok:
            partial_result = PathResult(tuple(results), walk.factors, mark, len(path))
            if throw:
                raise StepNotConverged(result, k, walk.described(k), partial_result)
            return partial_result
        if kept is not None:
            kept.put(k, result)
        if callback is not None:
            callback(k, result)
    return PathResult(tuple(results), walk.factors, mark, len(path))
