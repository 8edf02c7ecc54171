"""Estimates over errors against fine references: constant within each problem, the recovered one near 1.

The bounds are what was measured (in comments), with a margin.
"""

from __future__ import annotations

from functools import cache

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


@cache
def uniform(case, *divisions):
    grids = am.Hierarchy.uniform(am.cases.get(case).function(), divisions=divisions)
    return grids, Reference.of(grids, am.solve(grids, SOLVER))


def netgen_bar():
    grids, reference = uniform("greco_bar", 4, 8, 16, 32, 64, 128)
    meshes = [am.mesh.graded(grids.problem.domain, size, ("bottom",), 1.0) for size in (16e-3, 8e-3, 4e-3)]
    return am.Hierarchy.from_meshes(grids.problem, meshes), reference


def graded(case, *sizes):
    grids = am.Hierarchy.graded(am.cases.get(case).function(), sizes=sizes, contact_ratio=2)
    return grids, Reference.of(grids, am.solve(grids, am.FullMultigrid(rtol=1e-8)))


@pytest.mark.parametrize(("make", "levels", "of_residual", "of_recovery", "spread"), [
    (lambda: uniform("greco_bar", 4, 8, 16, 32, 64, 128), (1, 2, 3), (3.0, 4.0), (0.92, 1.05), 1.15),
    # 3.34, 3.53, 3.62; .945, .971, .983
    (netgen_bar, (1, 2), (2.7, 3.5), (0.92, 1.05), 1.25),  # 3.02, 3.22; .98, .99
    (lambda: uniform("upset_block", 4, 8, 16, 32, 64, 128), (1, 2, 3), (2.5, 3.2), (0.83, 1.0), 1.15),
    # 2.80, 2.84, 2.89; .875, .885, .896: the corners are singular
    (lambda: uniform("greco_block", 2, 4, 8, 16), (1, 2), (2.5, 3.6), (0.8, 1.05), 1.25),  # 2.9, 3.2; .87, .93
    (lambda: graded("dovetail", 8e-3, 4e-3, 2e-3, 0.8e-3), (1, 2), (2.4, 3.2), (0.9, 1.05), 1.25),
    # 2.75, 2.87; .94, .96
    (lambda: graded("bolted_junction", 12e-3, 6e-3, 3e-3, 1.4e-3), (1, 2), (1.8, 2.8), (0.75, 1.05), 1.25),
    # 2.22, 2.28; .96, .89
], ids=["bar", "bar by Netgen", "upset block", "block", "pair", "axisymmetric pair"])
def test_estimates_over_errors_are_constant_within_a_problem(make, levels, of_residual, of_recovery, spread):
    residual, recovery = quotients(*make(), levels)
    assert of_residual[0] < min(residual) and max(residual) < min(of_residual[1], spread * min(residual))
    assert of_recovery[0] < min(recovery) and max(recovery) < of_recovery[1]
