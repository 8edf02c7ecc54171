"""Bisection: conforming from any mesh, bounded shapes at any depth, labels and bodies follow, with the JIT off too."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
from bisected_meshes import SQUARE, containing_elements, crooked, cube, random_mask, shape_classes, single, verified
from uncompiled import uncompile

import adaptmg as am
from adaptmg.mesh import bisect, quality, refine_near, structured
from adaptmg.mesh.bisection import children, refine, tables
from adaptmg.mesh.bisection import coarsen as coarsening
from adaptmg.mesh.bisection.refine import bisected, refined
from adaptmg.mesh.bisection.tables import cells_of, nodes_of, tree_of
from adaptmg.problem import Box, Rectangle

MESHES = {"2D": SQUARE, "2D crooked": crooked(SQUARE), "3D": cube(), "3D crooked": crooked(cube(3))}


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
@pytest.mark.parametrize("passes", [None, 1, 2])
def test_random_marks_again_and_again_stay_conforming(mesh, passes):
    for k in range(12):
        before = mesh
        marked = random_mask(mesh, 0.1, k)
        mesh, parents = bisect(mesh, marked, passes)
        verified(mesh)
        np.testing.assert_array_equal(mesh.points, mesh.points[parents].mean(axis=1))
        assert mesh.volumes.sum() == pytest.approx(1, rel=1e-12)
        refinement = mesh.refinement
        assert mesh.n_nodes > before.n_nodes and len(refinement.tree) > 0
        assert len(refinement.parents) == mesh.n_nodes and refinement.generation.max() < 100
        if mesh.n_nodes > 20_000:
            break
    assert k >= 2


@pytest.mark.parametrize("points", [[[0, 0], [1, 0], [0.3, 0.6]], [[0, 0], [1, 0], [0.02, 0.1]]])
def test_a_triangle_has_at_most_four_shapes(points):
    mesh = single(points)
    for _ in range(5):
        mesh, _ = bisect(mesh, np.ones(len(mesh.elements), dtype=bool))
    assert len(mesh.elements) == 4**5 and shape_classes(mesh) <= 4


@pytest.mark.parametrize("seed", range(4))
def test_a_tetrahedron_has_a_bounded_number_of_shapes(seed):
    mesh = single(np.random.default_rng(seed).random((4, 3)))
    classes, worst = [], []
    for _ in range(12):
        mesh, _ = bisect(mesh, np.ones(len(mesh.elements), dtype=bool), passes=1)
        classes.append(shape_classes(mesh))
        worst.append(quality(mesh).aspect_ratio)
    assert len(mesh.elements) >= 2**12
    # none is new after eight bisections: Arnold, Mukherjee and Pouly, theorem 3.2 with its remark
    assert max(classes) <= 72 and worst[-1] <= max(worst[:8]) * (1 + 1e-9)


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_marked_elements_have_all_edges_halved_and_passes_count(mesh):
    marked = random_mask(mesh, 0.15, 5)
    full = refined(mesh, marked)
    children = np.bincount(full.origin, minlength=len(mesh.elements))
    assert (children[marked] >= 2**mesh.dim).all() and (children >= 1).all()
    np.testing.assert_allclose(np.bincount(full.origin, full.mesh.volumes), mesh.volumes, rtol=1e-12)
    # half an edge, or less where a face was cut twice
    old_edges = mesh.elements[marked][:, [0, 1]]
    halved = {tuple(sorted(p)) for p in full.mesh.refinement.parents[mesh.n_nodes:].tolist()}
    assert {tuple(sorted(edge)) for edge in old_edges.tolist()} <= halved
    for passes in (1, 2, 3):
        some = refined(mesh, marked, passes)
        assert (some.mesh.refinement.generation[marked[some.origin]] >= passes).all()
        few = np.bincount(some.origin, minlength=len(mesh.elements))[marked]
        assert few.min() >= 2**passes and some.mesh.n_nodes > mesh.n_nodes
    once = refined(mesh, marked, 1).mesh
    assert once.n_nodes < full.mesh.n_nodes


def test_uniform_bisection_of_a_structured_mesh_makes_the_next_structured_one():
    for mesh, next_one in ((structured(Rectangle(width=1, height=1), n) for n in (4, 8)), (cube(1), cube(2))):
        fine, _ = bisect(mesh, np.ones(len(mesh.elements), dtype=bool))
        assert fine.n_nodes == next_one.n_nodes and len(fine.elements) == len(next_one.elements)
        np.testing.assert_array_equal(np.unique(fine.points, axis=0), np.unique(next_one.points, axis=0))


@pytest.mark.parametrize("mesh", [SQUARE, cube(2)], ids=["2D", "3D"])
def test_facets_keep_their_labels_and_their_order(mesh):
    fine, _ = bisect(mesh, random_mask(mesh, 0.3, 1))
    sides = {"left": (0, 0), "right": (0, 1), "bottom": (-1, 0), "top": (-1, 1)}
    for name, (axis, value) in sides.items():
        assert (fine.points[fine.boundary_nodes(name), axis] == value).all()
    # those of one old facet lie one after another, in the order of the old ones
    assert (np.diff(fine.facet_labels) >= 0).all() == (np.diff(mesh.facet_labels) >= 0).all()


def test_the_history_is_frozen_and_not_kept_with_other_arrays():
    fine, _ = bisect(SQUARE, random_mask(SQUARE, 0.3, 1))
    for mesh in (fine, pickle.loads(pickle.dumps(fine))):
        assert not any(getattr(mesh.refinement, name).flags.writeable for name in ("parents", "marks", "tree"))
    assert SQUARE.refinement is None and replace(fine, source=None).refinement is None


def as_arrays(mesh):
    return mesh.points, mesh.elements, mesh.facets, mesh.facet_labels, mesh.element_body


def results():
    found = {}
    for name, mesh in (("2D", crooked(SQUARE)), ("3D", crooked(cube(2)))):
        fine = mesh
        for k, passes in enumerate((None, 1, 2)):
            fine, _ = bisect(fine, random_mask(fine, 0.2, k), passes)
        coarse = am.mesh.coarsen(fine, random_mask(fine, 0.8, 7), passes=2)
        assert coarse.n_nodes < fine.n_nodes
        for what, one in (("fine", fine), ("coarse", coarse)):
            for k, array in enumerate(as_arrays(one)):
                found[f"{name} {what} {k}"] = array
    return found


def test_kernels_without_the_compiler(monkeypatch):
    compiled = results()
    uncompile(monkeypatch, refine, children, tables, coarsening)
    for key, value in results().items():
        np.testing.assert_array_equal(value, compiled[key], err_msg=key)


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
@pytest.mark.parametrize("every_edge", [True, False])
def test_tables_that_grow_hold_the_same_as_those_with_room(mesh, every_edge):
    fine, _ = bisect(mesh, random_mask(mesh, 0.2, 1))
    marked, n = random_mask(fine, 0.3, 2), len(fine.elements)
    tree = tree_of(fine)
    found = []
    for room in (0.0, 20.0):
        more = np.empty((len(tree) + int(room * n), tree.shape[1]), dtype=np.int32)
        more[:len(tree)] = tree
        cells, n_cells, more, n_tree, nodes, n_nodes = bisected(
            cells_of(fine, room), n, more, len(tree), nodes_of(fine, room), fine.n_nodes, marked, every_edge)
        found.append((cells[:n_cells], more[:n_tree], nodes[fine.n_nodes:n_nodes]))
    for tight, roomy in zip(*found, strict=True):
        np.testing.assert_array_equal(tight, roomy)


FINE_SQUARE = structured(Rectangle(width=1, height=1), 4)
CUBE = structured(Box(width=1, depth=1, height=1), 2)


def test_the_source_follows_and_the_old_one_stays():
    before = FINE_SQUARE.source.nv
    fine, _ = bisect(FINE_SQUARE, np.ones(32, dtype=bool))
    assert FINE_SQUARE.source.nv == before
    np.testing.assert_array_equal([v.point for v in fine.source.vertices], fine.points)


def test_refine_near_reaches_strong_grading_without_bad_angles():
    meshes = refine_near(FINE_SQUARE, "bottom", 8)
    assert meshes[0] is FINE_SQUARE and len(meshes) == 9
    for level, mesh in enumerate(meshes):
        assert len(mesh.boundary_facets("bottom")) == 4 * 2**level
        assert len(mesh.boundary_facets("top")) == 4
    # the work goes to the boundary: nodes double with every level, uniform refinement would make four times as many
    assert meshes[-1].n_nodes < 2.05 * meshes[-2].n_nodes
    assert quality(meshes[-1]).min_angle > 20
    assert containing_elements(meshes[1], meshes[2]).min() >= 0
    assert [len(m.boundary_facets("bottom")) for m in refine_near(CUBE, ["bottom", "left"], 2)] == [8, 32, 128]
    with pytest.raises(ValueError, match="boundary 'bottm' does not exist"):
        refine_near(FINE_SQUARE, "bottm")
