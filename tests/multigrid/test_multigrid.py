"""Coarse spaces, corrections, cycles, coarse solves: properties and hand-counted work."""

from dataclasses import replace

import numpy as np
import pytest

import adaptmg as am
from adaptmg.multigrid.cycle import MultigridCycle, correction_levels
from adaptmg.multigrid.split_matrix import galerkin_levels, nodal_prolongations
from adaptmg.solver.record import Run


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


WOOD = am.PlaneStrain.orthotropic(
    young=(12e9, 0.8e9, 0.5e9),
    poisson=(0.4, 0.4, 0.5),
    shear=(0.7e9, 0.6e9, 0.1e9),
    angle=lambda x: 2e3 * x[:, 0],
)
STEEP = am.Spring("top", normal=lambda x: 1e13 * (x[:, 0] > 0.013))


@pytest.mark.parametrize(
    "divisions", [(2, 4, 8), (2, 4, 9), [(2, 2), (4, 6), (12, 18)], [(2, 4), (6, 4), (12, 8)]]
)
@pytest.mark.parametrize(
    "changes",
    [{}, {"material": WOOD}, {"supports": (*am.cases.greco_bar().supports, STEEP)}],
    ids=["constant moduli", "moduli that vary", "springs that vary"],
)
def test_levels_have_galerkin_matrices(changes, divisions):
    problem = replace(am.cases.greco_bar(), **changes)
    grids = am.Hierarchy.uniform(problem, divisions=divisions)
    levels = galerkin_levels(grids, nodal_prolongations(grids))
    matrix = grids.finest.matrix
    for k in (1, 0):
        matrix = am.transfer.galerkin_product(matrix, grids[k + 1].prolongation)
        free = ~grids[k].discrete.fixed
        expected = matrix.toarray()[np.ix_(free, free)]
        actual = levels[k].matrix().toarray()[np.ix_(free, free)]
        np.testing.assert_allclose(actual, expected, atol=1e-9 * np.abs(expected).max())


def test_galerkin_matrices_follow_a_prolongation_that_changes():
    # moduli that are tested, as those of anisotropic bodies are, and pass: they do not vary
    wood = am.PlaneStrain.orthotropic(
        young=(12e9, 0.8e9, 0.5e9), poisson=(0.4, 0.4, 0.5), shear=(0.7e9, 0.6e9, 0.1e9)
    )
    grids = am.Hierarchy.uniform(replace(am.cases.greco_bar(), material=wood), divisions=(2, 4))
    galerkin_levels(grids, nodal_prolongations(grids))
    finest = grids.finest.posing(prolongation=2 * grids.finest.prolongation)
    changed = replace(grids, levels=(grids[0], finest))
    actual, _ = galerkin_levels(changed, nodal_prolongations(changed))
    free = ~grids[0].discrete.fixed
    expected = 4 * grids[0].matrix.toarray()[np.ix_(free, free)]
    np.testing.assert_allclose(
        actual.matrix().toarray()[np.ix_(free, free)], expected, atol=1e-9 * expected.max()
    )


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


def test_coarse_solve_meets_its_tolerance():
    bar = am.cases.greco_bar(law=am.Tresca(3e7))
    local = am.smoother.local_system(am.Hierarchy.uniform(bar, (4,)).finest.discrete)
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


def test_prolongations_in_contact_frames_keep_normal_and_tangent_apart():
    """On a round surface, whose normals turn, and on a block that supports hold."""
    for grids in (
        am.Hierarchy.graded(am.cases.hertz_cylinder(), (4e-3, 2e-3), 3),
        am.Hierarchy.uniform(am.cases.greco_block(), (2, 4)),
    ):
        coarse, fine = (am.smoother.local_system(level.discrete) for level in grids.levels)
        (P,) = am.multigrid.local_prolongations(grids, [coarse, fine])
        dense = P.toarray()
        assert not dense[fine.system.fixed].any() and not dense[:, coarse.system.fixed].any()
        dim = fine.system.dim
        blocks = dense.reshape(fine.system.n_nodes, dim, coarse.system.n_nodes, dim)
        at = blocks[fine.system.nodes][:, :, coarse.system.nodes]
        assert not at[:, 0, :, 1:].any() and not at[:, 1:, :, 0].any()
        weights = grids.finest.contact_prolongation.toarray()
        expected = weights[np.ix_(fine.system.nodes, coarse.system.nodes)]
        np.testing.assert_allclose(
            np.linalg.norm(at[:, 0, :, 0], axis=0), np.linalg.norm(expected, axis=0)
        )
