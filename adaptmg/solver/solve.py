"""solve: one entry for every method."""

from __future__ import annotations

import importlib.metadata
import warnings
from collections.abc import Callable
from dataclasses import MISSING, fields, is_dataclass
from functools import lru_cache

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.smoother.system import LocalProblem, local_system
from adaptmg.solver.convergence import Convergence
from adaptmg.solver.finish import contact_result, relative_residual
from adaptmg.solver.result import Result
from adaptmg.solver.run import Outcome, Run, Solver
from adaptmg.solver.statics import check_statics
from adaptmg.solver.status import NotConverged, Status

__all__ = ["label", "solve", "versions"]


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
        Where to start, m; default zero. FullMultigrid makes its own start and refuses one.
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
    if isinstance(grids, DiscreteProblem):
        grids = Hierarchy.single(grids)
    elif not isinstance(grids, Hierarchy):
        raise TypeError(f"grids must be a Hierarchy or a DiscreteProblem, got {type(grids).__name__}")
    solver = _default_solver(grids) if solver is None else solver
    if not callable(getattr(solver, "run", None)):
        raise TypeError("solver must be SingleGrid, Multigrid, FullMultigrid, ActiveSet or offer run(), "
                        f"got {solver!r}")
    discrete = grids.finest.discrete
    check_statics(discrete)
    local = local_system(discrete)
    _warn_of_large_friction(local)
    run = Run(unit=discrete.matrix.nnz, callback=callback, reference=_displacement("reference", reference, discrete))
    outcome = solver.run(grids, run, _displacement("start", start, discrete))
    solved = np.asarray(outcome.displacement).reshape(discrete.n_nodes, discrete.dim)
    unknowns = local.to_local(solved)
    reaction = discrete.matrix @ solved.reshape(-1) - discrete.load
    if discrete.coupling is not None:
        reaction = discrete.coupling.physical_forces(reaction)
    residual = relative_residual(local, unknowns)
    status = _confirmed(outcome, residual)
    keys = dict.fromkeys(key for row in run.history for key in row)
    history = {key: np.array([row.get(key, np.nan) for row in run.history]) for key in keys}
    result = Result(displacement=discrete.physical(solved), reaction=reaction.reshape(solved.shape),
                    status=status, cycles=outcome.cycles, contact=contact_result(local, unknowns, solved),
                    work_units=run.work_units, residual=residual, error_estimate=outcome.error_estimate,
                    rate=outcome.rate, rtol=outcome.rtol, history=history, timings=run.timings, path=run.path,
                    levels=grids.table(), problem_name=_problem_name(grids), solver_name=_solver_name(solver, run),
                    mesh=grids.finest.mesh, start_work_units=run.start_work_units, versions=versions())
    if throw and not result.status.ok:
        raise NotConverged(result)
    return result


def label(option: object) -> str:
    """The name of an option object with the fields that differ from their defaults, for tables and pictures."""
    if not is_dataclass(option) or isinstance(option, type):
        return repr(option)
    shown = []
    for item in fields(option):
        value = getattr(option, item.name)
        default = item.default_factory() if item.default_factory is not MISSING else item.default
        if item.repr and (default is MISSING or value != default):
            shown.append(f"{item.name}={label(value)}")
    return f"{type(option).__name__}({', '.join(shown)})"


def _solver_name(solver: Solver, run: Run) -> str:
    return f"{label(solver)}, then {run.fallback}" if run.fallback else label(solver)


def _confirmed(outcome: Outcome, residual: float) -> Status:
    """The status of a solver, unless the residual of what it returned, computed here anew, contradicts it."""
    wanted = max(Convergence.RESIDUAL_FACTOR * outcome.rtol, Convergence.ROUNDING_LIMIT)
    # twice: solvers sum the same numbers in another order
    if outcome.status.ok and not residual <= 2 * wanted:
        return Status.DIVERGED if not residual < 1 else Status.STALLED
    return outcome.status


def _warn_of_large_friction(local: LocalProblem) -> None:
    """Say where even the problem of one node, all others held, may have several solutions: mu |a_nt| >= a_tt."""
    system, dim = local.system, local.system.dim
    blocks = system.diagonal.reshape(-1, dim, dim)[system.nodes]
    coupling = local.contact.friction * np.linalg.norm(blocks[:, 0, 1:], axis=1)
    beyond = coupling >= np.linalg.eigvalsh(blocks[:, 1:, 1:])[:, 0]
    if beyond.any():
        i = int(np.argmax(beyond))
        warnings.warn(f"friction {local.contact.friction[i]:g} is so large that the solution may not be unique "
                      f"({np.count_nonzero(beyond)} contact nodes, the first is node {system.nodes[i]}); "
                      "which one is found depends on start and method", RuntimeWarning, stacklevel=3)


@lru_cache(maxsize=1)
def _versions() -> dict[str, str]:
    return {name: importlib.metadata.version(name)
            for name in ("adaptmg", "ngsolve", "numpy", "scipy", "numba", "pyamg")}


def versions() -> dict[str, str]:
    """Versions of adaptmg and of what its numbers depend on."""
    return dict(_versions())


def _problem_name(grids: Hierarchy) -> str:
    return grids.problem.name if grids.problem is not None else grids.finest.discrete.name


def _default_solver(grids: Hierarchy) -> Solver:
    from adaptmg.solver.multigrid import FullMultigrid, Multigrid
    from adaptmg.solver.single_grid import SingleGrid

    if len(grids) == 1:
        return SingleGrid()
    return FullMultigrid() if grids.discretised else Multigrid()


def _displacement(name: str, value: np.ndarray | Result | None, discrete: DiscreteProblem) -> np.ndarray | None:
    if value is None:
        return None
    array = value.displacement if isinstance(value, Result) else np.asarray(value, dtype=np.float64)
    wanted = (discrete.n_nodes, discrete.dim)
    if array.shape != wanted:
        raise ValueError(f"{name} must have shape {wanted} (nodes of the finest level), got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} must be finite")
    return np.array(discrete.relative(array))
