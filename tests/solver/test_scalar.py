"""Scalar problems between obstacles: against bounded least squares, closed forms, and each other."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

import adaptmg as am

TIGHT = {"rtol": 1e-11}
METHODS = {
    "nested": am.FullMultigrid(**TIGHT),
    "from zero": am.Multigrid(**TIGHT),
    "monotone": am.Multigrid(correction=am.Monotone(), max_cycles=300, **TIGHT),
    "monotone nested": am.FullMultigrid(correction=am.Monotone(), max_cycles=300, **TIGHT),
    "sweeps": am.SingleGrid(**TIGHT),
    "active set": am.ActiveSet(),
    "sparse active set": am.ActiveSet(condensed=False),
    "pyamg": am.FullMultigrid(correction=am.Truncated(correct=am.PyAMG()), **TIGHT),
}


def membrane(seed: int, two_sided: bool) -> am.Hierarchy:
    """A membrane under a load of both signs, over a floor and perhaps under a ceiling that are not
    flat, on nodes numbered at random."""
    rng = np.random.default_rng(seed)
    size, waves = 10.0 ** rng.uniform(-2, 2), rng.uniform(2, 6, 4)
    problem = am.ScalarProblem(
        domain=am.Rectangle(width=size, height=size),
        conductivity=lambda x: 1 + 0.5 * np.sin(waves[0] * x[:, 0] / size),
        load=lambda x: 80 / size**2 * np.cos(waves[1] * x[:, 0] / size - waves[2] * x[:, 1] / size),
        lower=lambda x: -0.5 + 0.1 * np.sin(waves[3] * x[:, 1] / size),
        upper=(lambda x: 0.3 + 0.1 * np.cos(waves[3] * x[:, 0] / size)) if two_sided else None,
        value=lambda x: 0.2 * x[:, 0] / size,
    )
    return am.Hierarchy.uniform(problem, divisions=(4, 8, 16))


def bounded_least_squares(problem: am.DiscreteProblem) -> np.ndarray:
    """The solution (n_nodes,) as the least |L'u - L^-1 b| within the bounds, A = LL'."""
    lower, upper = np.full((2, problem.n_nodes), np.inf)
    contact = problem.contact
    up = contact.normals[:, 0] > 0
    upper[contact.nodes] = np.where(up, contact.gaps, contact.opposite_gaps)
    lower[contact.nodes] = np.where(up, contact.opposite_gaps, contact.gaps)
    free = ~problem.fixed
    A = problem.matrix.toarray()
    L = np.linalg.cholesky(A[np.ix_(free, free)])
    b = (problem.load - A @ problem.fixed_values)[free]
    bounds = -lower[free], upper[free]
    found = lsq_linear(L.T, np.linalg.solve(L, b), bounds, method="bvls", tol=1e-15, max_iter=5000)
    result = problem.fixed_values.copy()
    result[free] = found.x
    return result


@pytest.mark.parametrize("two_sided", [False, True])
def test_all_methods_agree_with_bounded_least_squares(two_sided):
    grids = membrane(4 + two_sided, two_sided)
    exact = bounded_least_squares(grids.finest.discrete)
    size = np.abs(exact).max()
    touching = None
    for name, solver in METHODS.items():
        result = am.solve(grids, solver)
        assert np.abs(result.displacement[:, 0] - exact).max() < 1e-9 * size, name
        contact = result.contact
        assert (contact.gap >= 0).all() and (contact.force_n >= 0).all()
        touching = contact.closed if touching is None else touching
        assert (contact.closed == touching).all(), name
        assert 20 < touching.sum() < len(contact) - 20, name
        assert result.certificate().energy_error < 1e-7
        if two_sided:
            sides = contact.normal[contact.closed, 0]
            assert {-1.0, 1.0} == set(sides.tolist())
