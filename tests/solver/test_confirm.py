"""A method that thinks too well of its iterate is made to go on by the certificate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import adaptmg as am

RTOL = 1e-8


@pytest.mark.parametrize("solver", [am.SingleGrid(omega=1.8, rtol=RTOL),
                                    am.FullMultigrid(correction=am.Monotone(), rtol=RTOL),
                                    am.Multigrid(correction=am.Monotone(), rtol=RTOL)],
                         ids=["single grid", "nested", "from zero"])
def test_it_goes_on(solver, monkeypatch):
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8, 16))
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12))
    run, asked = type(solver).run, []

    def too_early(self, hierarchy, record, start):
        """The first run stops at a thousand times the error, and says that it met the tolerance."""
        asked.append(self.rtol)
        if len(asked) > 1:
            return run_of[type(self)](self, hierarchy, record, start)
        return replace(run(replace(self, rtol=1e3 * RTOL), hierarchy, record, start), rtol=RTOL)

    run_of = {kind: kind.run for kind in (type(solver), am.Multigrid)}
    for kind in run_of:
        monkeypatch.setattr(kind, "run", too_early)
    result = am.solve(grids, solver)
    assert len(asked) > 1 and asked[1] < RTOL and result.rtol == RTOL
    matrix, u = grids.finest.discrete.matrix, exact.displacement.reshape(-1)
    error = result.displacement.reshape(-1) - u
    assert np.sqrt(error @ (matrix @ error) / (u @ (matrix @ u))) <= 3 * RTOL


def test_a_patch_test_to_the_discretisation_error():
    # the nested start is exact: no cycle shows a discretisation error, whose tenth would be the tolerance
    grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Frictionless()), divisions=(2, 4, 8))
    result = am.solve(grids, am.FullMultigrid(rtol="discretisation"))
    assert result.status.ok and result.cycles == 0 and result.residual < 1e-13
