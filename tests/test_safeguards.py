"""No wrong answer in silence: bodies held by contact alone, solvers that are mistaken, coarse grids that are large."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

import adaptmg as am
from adaptmg.multigrid.halves import split
from adaptmg.multigrid.linear_cycle import CoarseFactors
from adaptmg.solver.run import Outcome


def floating():
    """The bar with no support at all, pressed down and pushed sideways."""
    bar = am.cases.greco_bar()
    return replace(bar, supports=(), law=am.Coulomb(0.3), reference={},
                   loads=(am.Pressure("top", 5e7), am.Pressure("left", 3e7), am.Pressure("right", 2.5e7)))


GRIDS = {"nested": lambda: am.Hierarchy.uniform(floating(), divisions=(4, 8, 16)),
         "independent": lambda: am.Hierarchy.graded(floating(), sizes=(10e-3, 5e-3, 2.5e-3), contact_ratio=2)}
SOLVERS = {"nested start": am.FullMultigrid(), "cold": am.Multigrid(),
           "monotone": am.FullMultigrid(correction=am.Monotone()), "single": am.SingleGrid(omega=1.8)}


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("grids", GRIDS)
def test_a_body_held_by_contact_alone(grids, solver):
    hierarchy = GRIDS[grids]()
    exact = am.solve(hierarchy, am.ActiveSet(rtol=1e-12))
    result = am.solve(hierarchy, SOLVERS[solver])
    difference = np.abs(result.displacement - exact.displacement).max()
    assert difference < 1e-5 * np.abs(exact.displacement).max()
    assert result.residual < 1e-7


@dataclass(frozen=True)
class Mistaken:
    """Says that it converged, to this many times the solution."""

    solution: np.ndarray
    factor: float

    def run(self, hierarchy, run, start):
        return Outcome(self.factor * self.solution, am.Status.CONVERGED, cycles=1, rtol=1e-8, error_estimate=0.0)


@pytest.mark.parametrize(("factor", "status"), [(1.0, am.Status.CONVERGED), (1.0001, am.Status.STALLED),
                                                (1e15, am.Status.DIVERGED)])
def test_a_mistaken_solver_is_found_out(factor, status):
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8))
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12)).displacement
    result = am.solve(grids, Mistaken(exact, factor), throw=False)
    assert result.status is status
    if factor != 1.0:
        with pytest.raises(am.NotConverged):
            am.solve(grids, Mistaken(exact, factor))


def test_a_large_coarsest_grid_is_factorised_sparse():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(30, 60))
    assert 2 * grids[0].discrete.n_nodes > CoarseFactors.DENSE
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12))
    result = am.solve(grids, am.FullMultigrid(), reference=exact)
    assert result.history["true_error"][-1] < 1e-8


@pytest.mark.parametrize("limit", [0, 10_000])
def test_singular_coarsest_matrices_are_mended(limit, monkeypatch):
    monkeypatch.setattr(CoarseFactors, "DENSE", limit)
    discrete = am.Hierarchy.uniform(floating(), divisions=(4,)).finest.discrete
    level = split(discrete.matrix, discrete.fixed)
    factors = CoarseFactors(level)
    factors.renew()
    load = np.zeros(discrete.n_dofs)
    # a load in balance: opposite forces along the line between two nodes
    load[0], load[8] = 1e6, -1e6
    result = np.empty_like(load)
    factors.solve(load, result)
    assert np.isfinite(result).all()
    assert np.linalg.norm(discrete.matrix @ result - load) < 1e-4 * np.linalg.norm(load)
