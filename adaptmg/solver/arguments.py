"""What solve and solve_path do with their arguments."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.problem import check_arrays, checks
from adaptmg.solver.result import Result
from adaptmg.solver.result.status import Status
from adaptmg.solver.run import Outcome

if TYPE_CHECKING:
    from adaptmg.solver.run import Solver

__all__ = ["checked_outcome", "default_solver", "displacement_argument", "grids_argument", "solver_argument"]


def default_solver(grids: Hierarchy) -> Solver:
    """FullMultigrid, where coarse levels are only spaces Multigrid, on one level SingleGrid."""
    from adaptmg.solver.multigrid import FullMultigrid, Multigrid
    from adaptmg.solver.single_grid import SingleGrid

    if len(grids) == 1:
        return SingleGrid()
    return FullMultigrid() if grids.discretised else Multigrid()


def displacement_argument(name: str, value: np.ndarray | Result | None, discrete: DiscreteProblem) -> np.ndarray | None:
    """A displacement (n_nodes, dim) or a Result as unknowns of the problem, checked."""
    if value is None:
        return None
    given = value.displacement if isinstance(value, Result) else value
    wanted = (discrete.n_nodes, discrete.dim)
    array = check_arrays.array(name, given, wanted)
    size = np.abs(array).max(initial=0.0)
    if not size <= checks.VAST:
        raise ValueError(f"{name} must be at most {checks.VAST:g} m, got {size:.3g}")
    return np.array(discrete.relative(array))


def grids_argument(value: Hierarchy | DiscreteProblem) -> Hierarchy:
    """A hierarchy; a bare DiscreteProblem becomes one of one level."""
    if isinstance(value, DiscreteProblem):
        return Hierarchy.single(value)
    return checks.instance("grids", value, Hierarchy, "a Hierarchy or a DiscreteProblem")


def solver_argument(value: Solver | None, grids: Hierarchy) -> Solver:
    """A solver, the default one for None."""
    if value is None:
        return default_solver(grids)
    words = "SingleGrid(), Multigrid(), FullMultigrid(), ActiveSet() or offer run()"
    return checks.offers("solver", value, "run", words)


def checked_outcome(outcome: object, solver: Solver, discrete: DiscreteProblem) -> Outcome:
    """What a solver, a user's own perhaps, returns; where its numbers are not finite the status says so.

    Raises
    ------
    TypeError, ValueError
        If it is no Outcome, or has a displacement, status, count or tolerance of another type or shape.
    """
    name = f"solver: the run of {checks.shown(solver)} must return an Outcome"
    if not isinstance(outcome, Outcome):
        raise TypeError(f"{name}, got {checks.described(outcome)}")
    displacement = outcome.displacement
    kind = getattr(getattr(displacement, "dtype", None), "kind", "")
    if kind not in "iuf" or not kind or displacement.size != discrete.n_dofs:
        given = f"{displacement.dtype} {displacement.shape}" if kind else checks.shown(displacement)
        raise TypeError(f"{name} whose displacement is a real array {(discrete.n_nodes, discrete.dim)}, got {given}")
    if not isinstance(outcome.status, Status):
        raise TypeError(f"{name} whose status is one of am.Status, got {checks.shown(outcome.status)}")
    cycles = checks.integer(f"{name} whose cycles", outcome.cycles)
    rtol = checks.nonnegative(f"{name} whose rtol", outcome.rtol)
    if not rtol < 1:
        raise ValueError(f"{name} whose rtol is < 1, got {checks.shown(outcome.rtol)}")
    for what in ("error_estimate", "rate"):
        value = getattr(outcome, what)
        if not isinstance(value, (float, int, np.floating)) or isinstance(value, bool) or value < 0:
            raise TypeError(f"{name} whose {what} is a number >= 0 or NaN, got {checks.shown(value)}")
    finite = bool(np.isfinite(displacement).all())
    return replace(outcome, cycles=cycles, rtol=rtol, status=outcome.status if finite else Status.DIVERGED)
