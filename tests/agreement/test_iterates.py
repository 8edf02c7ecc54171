"""What holds for the iterates of every method: the solution is a fixed point, energy falls where it
must, inputs stay, a second solve is the first."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bodies import UPPER_ON_LOWER, bar_hierarchy, bar_on_block, bumpy
from norms import far
from smoother_problems import tresca_energy

import adaptmg as am

LAWS = {"frictionless": am.Frictionless(), "tresca": am.Tresca(3e7), "coulomb": am.Coulomb(0.5)}
MONOTONE = am.Multigrid(correction=am.Monotone())
METHODS = {
    "single": am.SingleGrid(omega=1.5),
    "condensed": am.SingleGrid(condensed=True),
    "V": MONOTONE,
    "W": replace(MONOTONE, cycle=am.Cycle(shape="W", pre=1, post=1)),
    "F": replace(MONOTONE, cycle=am.Cycle(shape="F", pre=0, post=1)),
    "symmetric": replace(MONOTONE, smoother=am.ProjectedGaussSeidel(order="symmetric")),
    "slopes": am.Multigrid(correction=am.PaperCorrection(slip="minmod", limit="summed")),
    "truncated": am.Multigrid(),
    "plain": am.Multigrid(correction=am.Truncated(recombine=0, coarse_contact=False)),
    "pyamg": am.Multigrid(correction=am.Truncated(correct=am.PyAMG())),
    "active set": am.ActiveSet(),
    "whole matrix": am.ActiveSet(condensed=False),
    "AMG": am.ActiveSet(linear=am.AMG()),
}
every_method = pytest.mark.parametrize("method", METHODS)


@cache
def grids(case, law="coulomb"):
    bar = am.cases.greco_bar(law=LAWS[law])
    if case == "graded":
        return am.Hierarchy.graded(bar, sizes=(20e-3, 10e-3, 5e-3), contact_ratio=2)
    if case == "block":
        return am.Hierarchy.uniform(am.cases.greco_block(law=LAWS[law]), (1, 2, 4))
    if case == "pair":
        return bar_hierarchy(bar_on_block(LAWS[law], UPPER_ON_LOWER, gap=bumpy), 2)
    return am.Hierarchy.uniform(bar, (2, 4, 8))


@cache
def exact(case, law="coulomb"):
    return am.solve(grids(case, law), am.ActiveSet(rtol=1e-13))


@every_method
@pytest.mark.parametrize("case", ["bar", "graded", "block", "pair"])
def test_the_solution_is_a_fixed_point(case, method):
    result = am.solve(grids(case), METHODS[method], start=exact(case))
    # ten sweeps are measured together
    assert result.status is am.Status.CONVERGED
    assert result.cycles <= (10 if method in ("single", "condensed") else 2)
    assert far(result, exact(case)) <= 1e-10


def random_start(case, law, seed):
    """Displacements as large as those of the solution, the same at fixed dofs."""
    solution = exact(case, law).displacement
    fixed = grids(case, law).finest.discrete.fixed.reshape(solution.shape)
    noise = np.random.default_rng(seed).normal(size=solution.shape)
    return np.where(fixed, solution, np.abs(solution).max() * noise)


@pytest.mark.parametrize("law", ["frictionless", "tresca"])
@pytest.mark.parametrize("case", ["bar", "graded", "block"])
@pytest.mark.parametrize("method", ["V", "W", "F", "symmetric"])
def test_the_energy_of_iterates_never_rises(method, case, law):
    """Sweeps on one grid are tested in tests/smoother."""
    local = am.smoother.local_system(grids(case, law).finest.discrete)
    start = random_start(case, law, 1)
    energies = []
    for cycles in (1, 2, 3, 5):
        solver = replace(METHODS[method], max_cycles=cycles)
        iterate = am.solve(grids(case, law), solver, start=start, throw=False).displacement
        w = local.to_local(local.discrete.relative(iterate))
        energies.append(tresca_energy(local, w))
        normal = w.reshape(-1, local.system.dim)[local.system.nodes, 0]
        assert (normal <= local.contact.gap + 1e-15).all()
    least = tresca_energy(
        local, local.to_local(local.discrete.relative(exact(case, law).displacement))
    )
    assert (np.diff(energies) <= 1e-12 * np.abs(energies[0])).all()
    assert energies[0] > energies[-1] >= least - 1e-12 * abs(least)


@every_method
def test_inputs_stay_and_a_second_solve_is_the_first(method):
    start = random_start("graded", "coulomb", 0)
    given = start.copy()
    hierarchy = grids("graded")
    arrays = [
        array
        for level in hierarchy.levels
        for array in (level.discrete.matrix.data, level.discrete.load, level.mesh.points)
    ]
    before = [array.copy() for array in arrays]
    first, second = (am.solve(hierarchy, METHODS[method], start=start) for _ in range(2))
    np.testing.assert_array_equal(start, given)
    for array, copy in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(array, copy)
    np.testing.assert_array_equal(first.displacement, second.displacement)
    np.testing.assert_array_equal(first.history["residual"], second.history["residual"])
    assert first.work_units == second.work_units
