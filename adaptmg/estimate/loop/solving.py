"""How a step of the adaptive loop is solved: from the step before, no further than its mesh deserves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from adaptmg.estimate.loop.expected import algebraic_tolerance, expected_estimate
from adaptmg.estimate.loop.step import Step
from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.multigrid import FullMultigrid, Multigrid
from adaptmg.solver.newton.active_set import ActiveSet
from adaptmg.solver.result import Result
from adaptmg.solver.run import Solver
from adaptmg.solver.single_grid import SingleGrid
from adaptmg.solver.solve import solve
from adaptmg.solver.truncated.warm import WarmMultigrid

__all__ = ["solved", "takes"]

#: dofs up to which a first mesh that stands alone is factorised
_FACTORISED = 60_000
#: the rate of the first cycle is taken for at least this, and for at most that (measured: strong singularities and
#: pairs have .35 to .6, others .05 to .33; with .3 for one body a flat punch kept .18 of its estimate, with .5 .07)
_RATE, _SLOWEST = 0.5, 0.9


def solved(hierarchy: Hierarchy, solver: Solver | None, before: Step | None, start: np.ndarray | None) -> Result:
    """The solution on the finest level.

    Parameters
    ----------
    hierarchy : Hierarchy
    solver : Solver or None
        The user's; it starts from ``start`` too, unless it makes its own start. None, or multigrid on one level: by
        truncated multigrid to a tenth of the error that the mesh is expected to have.
    before : Step or None
    start : (n_nodes, dim) array or None
        The displacement of the step before on this mesh, m.

    Raises
    ------
    NotConverged
    """
    if solver is not None and takes(solver, hierarchy):
        return solve(hierarchy, solver, start=None if isinstance(solver, FullMultigrid) else start)
    if len(hierarchy) == 1:
        direct = hierarchy.finest.discrete.n_dofs <= _FACTORISED
        return solve(hierarchy, ActiveSet() if direct else SingleGrid(), start=start)
    if before is None or start is None:
        return solve(hierarchy, FullMultigrid(rtol="discretisation"))
    rtol = algebraic_tolerance(expected_estimate(before, hierarchy.finest.n_nodes, before.result.dim))
    result = solve(hierarchy, WarmMultigrid(rtol=rtol, first_rate=_first_rate(before)), start=start, throw=False)
    if result.status.ok:
        return result
    # where the status of a coarse mesh leads astray, a nested start is the safer way
    again = solve(hierarchy, FullMultigrid(rtol=rtol))
    return replace(again, work_units=again.work_units + result.work_units)


def _first_rate(before: Step) -> float:
    """What is taken for the rate of the first cycle: that of the mesh before where it was measured, and is slow."""
    # not a number after a single cycle
    measured = before.result.rate if np.isfinite(before.result.rate) else 0.0
    return min(max(measured, _RATE), _SLOWEST)


def takes(solver: Solver, hierarchy: Hierarchy) -> bool:
    """Whether a solver can be used: multigrid needs two levels, which a loop that begins with a mesh has only then."""
    return len(hierarchy) > 1 or not isinstance(solver, Multigrid)
