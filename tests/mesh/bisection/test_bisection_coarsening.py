"""Coarsening takes back what was bisected, no more, and leaves a conforming mesh."""

import pickle

import numpy as np
import pytest
from bisected_meshes import SQUARE, as_sets, crooked, cube, random_mask, verified

from adaptmg.mesh import bisect, coarsen
from adaptmg.mesh.bisection.coarsen import coarsened

MESHES = {"2D": SQUARE, "2D crooked": crooked(SQUARE), "3D": cube(), "3D crooked": crooked(cube(2))}
EACH = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)


def everything(mesh):
    return np.ones(len(mesh.elements), dtype=bool)


@EACH
def test_refined_at_random_and_all_taken_back_is_the_first_mesh(mesh):
    fine = mesh
    for k in range(5):
        fine, _ = bisect(fine, random_mask(fine, 0.15, k), None if k % 2 else 1)
    back = coarsen(pickle.loads(pickle.dumps(fine)), everything(fine))
    assert as_sets(back) == as_sets(mesh)
    np.testing.assert_array_equal(back.points, mesh.points)
    assert len(back.refinement.tree) == 0 and (back.refinement.generation == 0).all()
    assert coarsen(back, everything(back)) is back and fine.refinement is not None
    assert as_sets(bisect(back, everything(back))[0]) == as_sets(bisect(mesh, everything(mesh))[0])


@EACH
def test_to_and_fro_stays_conforming(mesh):
    mesh, mixed = mesh, 0
    for k in range(8):
        mesh, _ = bisect(mesh, random_mask(mesh, 0.1, k))
        marked = random_mask(mesh, 0.7, 100 + k)
        result = coarsened(mesh, marked, 1 if k % 2 else None)
        coarse = verified(result.mesh)
        assert coarse.volumes.sum() == pytest.approx(1, rel=1e-12)
        kept = result.nodes >= 0
        np.testing.assert_array_equal(coarse.points[result.nodes[kept]], mesh.points[kept])
        np.testing.assert_array_equal(np.sort(result.nodes[kept]), np.arange(coarse.n_nodes))
        # what was not marked is still there
        unmarked = {frozenset(map(tuple, mesh.points[e].tolist())) for e in mesh.elements[~marked]}
        assert unmarked <= {nodes for _, nodes in as_sets(coarse)[1]}
        mixed += coarse.n_nodes < mesh.n_nodes
        mesh = coarse
        if mesh.n_nodes > 4000:
            break
    assert mixed > 2


@EACH
def test_one_pass_takes_back_one_bisection(mesh):
    once, _ = bisect(mesh, everything(mesh), passes=1)
    twice, _ = bisect(once, everything(once), passes=1)
    assert as_sets(coarsen(once, everything(once), 1)) == as_sets(mesh)
    back = coarsen(twice, everything(twice), passes=1)
    assert mesh.n_nodes < back.n_nodes < twice.n_nodes
    assert back.refinement.generation.max() < twice.refinement.generation.max()


def test_a_bisection_stays_where_one_child_is_not_marked():
    assert coarsen(SQUARE, everything(SQUARE)) is SQUARE
    fine, _ = bisect(SQUARE, np.arange(len(SQUARE.elements)) == 4, passes=1)
    new = SQUARE.n_nodes
    around = np.flatnonzero((fine.elements == new).any(axis=1))
    assert fine.n_nodes == new + 1 and len(around) == 4
    for left_out in around:
        marked = everything(fine)
        marked[left_out] = False
        assert coarsen(fine, marked) is fine
    marked = np.zeros(len(fine.elements), dtype=bool)
    marked[around] = True
    assert as_sets(coarsen(fine, marked)) == as_sets(SQUARE)
