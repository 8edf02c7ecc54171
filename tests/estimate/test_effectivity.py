"""Estimates over errors against fine references: constant within each problem, the recovered one near 1.

The bounds are what was measured (in comments), with a margin.
"""

from __future__ import annotations

import pytest

import adaptmg as am
from adaptmg.estimate import Reference, energy_error

SOLVER = am.FullMultigrid(rtol=1e-9)


def quotients(grids, reference, levels):
    """Residual and recovered estimate over the error, by level."""
    found = []
    for k in levels:
        part = grids.truncated(finest=k)
        result = am.solve(part, SOLVER)
        error = energy_error(reference, result).absolute
        found.append([indicator.indicate(part, result).total / error for indicator in (am.Residual(), am.Recovery())])
    return list(zip(*found, strict=True))


def solved(problem, divisions):
    grids = am.Hierarchy.uniform(problem, divisions=divisions)
    return grids, Reference.of(grids, am.solve(grids, SOLVER))


@pytest.fixture(scope="module")
def bar():
    return solved(am.cases.greco_bar(), (4, 8, 16, 32, 64, 128))


def test_the_bar_on_uniform_meshes(bar):
    residual, recovery = quotients(*bar, (1, 2, 3))  # 3.34, 3.53, 3.62; .945, .971, .983
    assert max(residual) < 1.15 * min(residual) and min(residual) > 3.0 and max(residual) < 4.0
    assert min(recovery) > 0.92 and max(recovery) < 1.05


def test_the_bar_on_netgen_meshes(bar):
    problem = bar[0].problem
    grids = am.Hierarchy.from_meshes(problem, [am.mesh.graded(problem.domain, size, ("bottom",), 1.0)
                                               for size in (16e-3, 8e-3, 4e-3)])
    residual, recovery = quotients(grids, bar[1], (1, 2))  # 3.02, 3.22; .98, .99
    assert min(residual) > 2.7 and max(residual) < 3.5
    assert min(recovery) > 0.92 and max(recovery) < 1.05


def test_the_upset_block():
    residual, recovery = quotients(*solved(am.cases.upset_block(), (4, 8, 16, 32, 64, 128)), (1, 2, 3))
    # 2.80, 2.84, 2.89; .875, .885, .896: the corners are singular
    assert max(residual) < 1.15 * min(residual) and min(residual) > 2.5 and max(residual) < 3.2
    assert min(recovery) > 0.83 and max(recovery) < 1.0


def test_the_block_in_space():
    residual, recovery = quotients(*solved(am.cases.greco_block(), (2, 4, 8, 16)), (1, 2))
    assert min(residual) > 2.5 and max(residual) < 3.6  # 2.9, 3.2
    assert min(recovery) > 0.8 and max(recovery) < 1.05  # .87, .93


@pytest.mark.parametrize(("case", "sizes", "of_residual", "of_recovery"), [
    ("dovetail", (8e-3, 4e-3, 2e-3, 0.8e-3), (2.4, 3.2), (0.9, 1.05)),  # 2.75, 2.87; .94, .96
    ("bolted_junction", (12e-3, 6e-3, 3e-3, 1.4e-3), (1.8, 2.8), (0.75, 1.05))])  # 2.22, 2.28; .96, .89
def test_pairs_of_bodies_plane_and_axisymmetric(case, sizes, of_residual, of_recovery):
    problem = am.cases.get(case).function()
    grids = am.Hierarchy.graded(problem, sizes=sizes, contact_ratio=2)
    reference = Reference.of(grids, am.solve(grids, am.FullMultigrid(rtol=1e-8)))
    residual, recovery = quotients(grids, reference, (1, 2))
    assert of_residual[0] < min(residual) and max(residual) < min(of_residual[1], 1.25 * min(residual))
    assert of_recovery[0] < min(recovery) and max(recovery) < of_recovery[1]
