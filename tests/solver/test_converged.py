"""CONVERGED means that the error is at most rtol, against the exact discrete solution and in the energy norm."""

from functools import cache

import numpy as np
import pytest

import adaptmg as am
from adaptmg.solver import energy_error


@cache
def grids(case, friction):
    if case == "block":
        return am.Hierarchy.uniform(am.cases.greco_block(law=am.Coulomb(friction)), (2, 4, 8))
    return am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(friction)), (4, 8, 16, 32))


@cache
def exact(case, friction):
    return am.solve(grids(case, friction), am.ActiveSet(rtol=1e-13))


@pytest.mark.parametrize(("case", "friction", "rtol"), [("bar", 0.1, 1e-6), ("bar", 1.5, 1e-6), ("bar", 0.6, 3e-9),
                                                        ("block", 0.3, 1e-6), ("bar", 0.6, 1e-2)])
@pytest.mark.parametrize("solver", [am.FullMultigrid, am.ActiveSet, lambda rtol: am.FullMultigrid(
    correction=am.Monotone(), rtol=rtol)], ids=["truncated", "active set", "monotone"])
def test_the_true_error_is_at_most_rtol(case, friction, rtol, solver):
    result = am.solve(grids(case, friction), solver(rtol=rtol))
    matrix, solution = grids(case, friction).finest.matrix, exact(case, friction).displacement.reshape(-1)
    error = result.displacement.reshape(-1) - solution
    assert np.sqrt((error @ (matrix @ error)) / (solution @ (matrix @ solution))) <= rtol
    assert result.status is am.Status.CONVERGED and result.checked.energy_error <= rtol


def test_an_error_far_below_rtol_is_estimated_by_one_step(monkeypatch):
    steps, step = [], energy_error._Preconditioner.__call__
    monkeypatch.setattr(energy_error._Preconditioner, "__call__",
                        lambda self, residual: (steps.append(1), step(self, residual))[1])
    result = am.solve(grids("bar", 0.6), am.FullMultigrid(rtol=1e-2))
    assert len(steps) == 1
    found = result.certificate(grids("bar", 0.6).finest.discrete).energy_error
    assert len(steps) > 2 and found / 3 <= result.checked.energy_error <= 1.001 * found <= 1e-3
    before = len(steps)
    am.solve(grids("bar", 0.6), am.FullMultigrid(rtol=2 * found))
    assert len(steps) > before + 1
