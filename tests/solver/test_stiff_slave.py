"""A stiff slave on a soft master: slow for cycles, quick for the active set method, which takes over in time."""

from __future__ import annotations

import numpy as np
import pytest

import adaptmg as am


@pytest.mark.parametrize(("pull", "ratio", "finest"), [(-8e7, 25, 12), (-2e7, 25, 12), (5e7, 25, 12), (5e7, 100, 16)])
def test_a_stiff_slave_on_a_soft_master_is_handed_over(pull, ratio, finest):
    """Little friction: left alone, cycles from zero take 50 to 66, in the last case more than 100."""
    parts = {"upper": am.Rectangle(width=40e-3, height=40e-3),
             "lower": am.Rectangle(width=60e-3, height=30e-3, origin=(-8e-3, -30e-3))}
    young = {"upper": 1e11, "lower": 1e11 / ratio}
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts), contact=am.ContactPair("upper.bottom", "lower.top"), law=am.Coulomb(0.05),
        material={name: am.PlaneStrain(young=value, poisson=0.3) for name, value in young.items()},
        loads=(am.Pressure("upper.top", 5e7), am.Pressure("upper.left", pull)),
        supports=(am.Support("upper.right", x=0.0), am.Support("lower.bottom", x=0.0, y=0.0)))
    grids = am.Hierarchy.uniform(problem, [{"upper": k, "lower": (3 * k // 2 + 1, 3 * k // 4)} for k in (4, 8, finest)])
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12))
    for solver in (am.FullMultigrid(), am.Multigrid()):
        result = am.solve(grids, solver)
        assert result.cycles < 45
        assert np.abs(result.displacement - exact.displacement).max() <= 1e-6 * np.abs(exact.displacement).max()
