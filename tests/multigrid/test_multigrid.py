"""Coarse spaces, corrections, cycles, coarse solves: properties and hand-counted work."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smoother_problems import tresca_energy

import adaptmg as am
from adaptmg.multigrid.cycle import MultigridCycle, correction_levels, project
from adaptmg.solver.record import Run


@pytest.fixture(scope="module")
def hierarchies():
    bar, block = am.cases.greco_bar(law=am.Tresca(3e7)), am.cases.greco_block(law=am.Tresca(3e7))
    return {
        "nested": am.Hierarchy.uniform(bar, divisions=(2, 4, 8)),
        "graded": am.Hierarchy.graded(bar, sizes=(20e-3, 10e-3, 5e-3), contact_ratio=2),
        "L2": am.Hierarchy.graded(
            bar, sizes=(10e-3, 5e-3), contact_ratio=2, transfer=am.PseudoL2()
        ),
        "block": am.Hierarchy.uniform(block, divisions=(1, 2, 4)),
    }


def cycle_of(grids, **options):
    run = Run(unit=grids.finest.discrete.matrix.nnz)
    cycle = MultigridCycle(
        levels_of(grids),
        recorder=run,
        **{
            "options": am.Cycle(),
            "smoother": am.ProjectedGaussSeidel(),
            "correction": am.Monotone(),
            "coarse": am.CoarseSolve(),
        }
        | options,
    )
    return cycle, am.smoother.local_system(grids.finest.discrete), run


@pytest.mark.parametrize("name", ["nested", "graded", "L2", "block"])
@settings(max_examples=8, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    shape=st.sampled_from(["V", "W", "F"]),
    sweeps=st.sampled_from([(0, 1), (2, 0)]),
)
def test_tresca_energy_never_rises(hierarchies, name, seed, shape, sweeps):
    grids = hierarchies[name]
    pre, post = sweeps
    options = am.Cycle(shape=shape, pre=pre, post=post)
    cycle, local, _ = cycle_of(grids, options=options, coarse=am.CoarseSolve(rtol=0.3))
    level = len(grids) - 1
    random = np.random.default_rng(seed)
    w = random.normal(scale=1e-4, size=local.system.n_dofs) * ~local.system.fixed
    project(local, w)
    before = tresca_energy(local, w)
    for _ in range(3):
        cycle.correct(level, local.contact, w, local.residual(w))
        after = tresca_energy(local, w)
        assert after <= before + 1e-13 * abs(before)
        cycle.smooth(level, local.contact, local.load, w, 1)
        before = tresca_energy(local, w)
    normal = w.reshape(-1, local.system.dim)[local.system.nodes, 0]
    assert (normal <= local.contact.gap + 1e-15).all()


def test_corrections_vanish_at_the_solution_unless_frozen():
    """The paper's frozen slip and limit move the solution: its mode stalls."""
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8))
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12))
    for correction in (am.Monotone(), am.PaperCorrection(slip="minmod", limit="summed")):
        cycle, local, _ = cycle_of(grids, correction=correction, coarse=am.CoarseSolve(rtol=1e-12))
        w = local.to_local(exact.displacement)
        moved = w.copy()
        cycle.correct(1, local.contact, moved, local.residual(w))
        assert np.abs(moved - w).max() < 1e-12 * np.abs(w).max()
    result = am.solve(
        grids,
        am.FullMultigrid(
            correction=am.PaperCorrection(),
            stop="change",
            rtol=1e-10,
            cycle=am.Cycle(shape="complete"),
            coarse=am.CoarseSolve(rtol=1e-10),
        ),
        throw=False,
        reference=exact,
    )
    assert result.status is am.Status.STALLED
    assert result.history["true_error"][-1] > 1e-4
    assert "Monotone" in result.status.value


def test_hand_counted_work():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8, 16))
    ratio = [level.discrete.matrix.nnz / grids.finest.discrete.matrix.nnz for level in grids.levels]
    coarse = am.CoarseSolve(rtol=1e-30, max_sweeps=8)
    for shape, visits in (("V", 1), ("W", 2), ("F", 2)):
        cycle, local, run = cycle_of(
            grids, options=am.Cycle(shape=shape, pre=2, post=1), coarse=coarse
        )
        cycle.cycle(2, local.contact, local.load, np.zeros(local.system.n_dofs), shape)
        # three sweeps and one residual a level, eight sweeps on the coarsest, which is solved once
        # a visit of level 1
        expected = 4 + 4 * visits * ratio[1] + 8 * visits * ratio[0]
        assert run.work_units == pytest.approx(expected, rel=1e-12)
        assert sum(step == (0, "solve", 8) for step in run.path) == visits
        if shape == "V":
            assert [(level, action) for level, action, _ in run.path] == [
                (2, "smooth"),
                (2, "restrict"),
                (1, "smooth"),
                (1, "restrict"),
                (0, "solve"),
                (1, "prolong"),
                (1, "smooth"),
                (2, "prolong"),
                (2, "smooth"),
            ]


def test_coarse_solve_meets_its_tolerance(hierarchies):
    local = am.smoother.local_system(hierarchies["nested"][1].discrete)
    exact, found = np.zeros((2, local.system.n_dofs))
    run = Run(unit=local.system.nonzeros)
    am.CoarseSolve(rtol=1e-13, omega=1.0, max_sweeps=20_000).solve(
        local.system, local.contact, local.load, exact, run
    )
    for rtol in (1e-3, 1e-6):
        found[:] = 0
        am.CoarseSolve(rtol=rtol).solve(local.system, local.contact, local.load, found, run)
        assert np.linalg.norm(found - exact) <= 3 * rtol * np.linalg.norm(exact)


def levels_of(grids, matrices="galerkin"):
    return correction_levels(
        grids,
        [am.smoother.local_system(level.discrete) for level in grids.levels],
        len(grids) - 1,
        matrices,
    )


def test_galerkin_matrices_are_discretised_ones_on_nested_meshes():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4, 8))
    for a, b in zip(levels_of(grids), levels_of(grids, "discretised"), strict=True):
        free = ~a.system.fixed
        difference = (a.system.matrix - b.system.matrix).toarray()[np.ix_(free, free)]
        assert np.abs(difference).max() < 1e-12 * np.abs(b.system.data).max()
