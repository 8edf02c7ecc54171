"""Bisection: conforming from any mesh, bounded shapes, labels follow; the history goes through files."""

import pickle
from dataclasses import replace

import bisected_meshes
import numpy as np
import pytest
from bisected_meshes import SQUARE, crooked, cube, random_mask, verified

from adaptmg.mesh import MeshArrays, bisect, check_mesh, quality, refine_near, structured
from adaptmg.mesh.arrays import Refinement
from adaptmg.mesh.bisection.refine import bisected, refined
from adaptmg.mesh.bisection.tables import cells_of, nodes_of, with_refinement
from adaptmg.problem import Rectangle
from adaptmg.solver import store


def split(mesh):
    """The mesh with two bodies that are glued."""
    return check_mesh(replace(mesh, bodies=("west", "east"), source=None,
                              element_body=mesh.points[mesh.elements, 0].mean(axis=1) > 0.5))


MESHES = {"2D": SQUARE, "2D crooked": split(crooked(SQUARE)), "3D": cube(), "3D crooked": split(crooked(cube(2)))}
EACH = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
SIDES = {"left": (0, 0), "right": (0, 1), "bottom": (-1, 0), "top": (-1, 1)}


def everything(mesh):
    return np.ones(len(mesh.elements), dtype=bool)


@EACH
@pytest.mark.parametrize("passes", [None, 1, 2])
def test_random_marks_again_and_again_stay_conforming(mesh, passes):
    for k in range(12):
        before = mesh
        marked = random_mask(mesh, 0.1, k)
        mesh, parents = bisect(mesh, marked, passes)
        verified(mesh)
        np.testing.assert_array_equal(mesh.points, mesh.points[parents].mean(axis=1))
        np.testing.assert_allclose(*(np.bincount(m.element_body, m.volumes) for m in (mesh, before)), rtol=1e-12)
        for name, (axis, value) in SIDES.items():
            assert (mesh.points[mesh.boundary_nodes(name), axis] == value).all()
        # those of one old facet lie one after another, in the order of the old ones
        assert (np.diff(mesh.facet_labels) >= 0).all() == (np.diff(before.facet_labels) >= 0).all()
        refinement = mesh.refinement
        assert mesh.n_nodes > before.n_nodes
        assert len(refinement.parents) == mesh.n_nodes and refinement.generation.max() < 100
        if mesh.n_nodes > 6_000:
            break
    assert k >= 2 and before.refinement is not None and replace(mesh, source=None).refinement is None
    for one in (mesh, pickle.loads(pickle.dumps(mesh))):
        assert not any(getattr(one.refinement, name).flags.writeable for name in ("parents", "marks", "generation"))


@pytest.mark.parametrize(("corners", "most"), [([[0, 0], [1, 0], [0.02, 0.1]], 4), *(
    (np.random.default_rng(seed).random((4, 3)), 72) for seed in range(2))], ids=["triangle", "first", "second"])
def test_a_simplex_has_a_bounded_number_of_shapes(corners, most):
    mesh, classes, worst = bisected_meshes.single(corners), [], []
    for _ in range(12):
        mesh, _ = bisect(mesh, everything(mesh), passes=1)
        classes.append(bisected_meshes.shape_classes(mesh))
        worst.append(quality(mesh).aspect_ratio)
    assert len(mesh.elements) >= 2**12
    # none is new after eight bisections: Arnold, Mukherjee and Pouly, theorem 3.2 with its remark
    assert max(classes) <= most and worst[-1] <= max(worst[:8]) * (1 + 1e-9)


@EACH
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


def test_uniform_bisection_makes_the_next_structured_mesh():
    for mesh, next_one in ((structured(Rectangle(width=1, height=1), n) for n in (4, 8)), (cube(1), cube(2))):
        fine, _ = bisect(mesh, everything(mesh))
        assert fine.n_nodes == next_one.n_nodes and len(fine.elements) == len(next_one.elements)
        np.testing.assert_array_equal(np.unique(fine.points, axis=0), np.unique(next_one.points, axis=0))


@EACH
@pytest.mark.parametrize("every_edge", [True, False])
def test_tables_that_grow_hold_the_same_as_those_with_room(mesh, every_edge):
    fine, _ = bisect(mesh, random_mask(mesh, 0.2, 1))
    marked, n = random_mask(fine, 0.3, 2), len(fine.elements)
    found = []
    for room in (0.0, 20.0):
        cells, n_cells, nodes, n_nodes = bisected(cells_of(fine, room), n, mesh.dim + 1, nodes_of(fine, room),
                                                  fine.n_nodes, marked, every_edge)
        found.append((cells[:n_cells], nodes[fine.n_nodes:n_nodes]))
    for tight, roomy in zip(*found, strict=True):
        np.testing.assert_array_equal(tight, roomy)


FINE_SQUARE = structured(Rectangle(width=1, height=1), 4)


def test_refine_near_reaches_strong_grading_without_bad_angles():
    before = FINE_SQUARE.source.nv
    meshes = refine_near(FINE_SQUARE, "bottom", 8)
    assert meshes[0] is FINE_SQUARE and len(meshes) == 9 and FINE_SQUARE.source.nv == before
    np.testing.assert_array_equal([v.point for v in meshes[2].source.vertices], meshes[2].points)
    for level, mesh in enumerate(meshes):
        assert len(mesh.boundary_facets("bottom")) == 4 * 2**level
        assert len(mesh.boundary_facets("top")) == 4
    # the work goes to the boundary: nodes double with every level, uniform refinement would make four times as many
    assert meshes[-1].n_nodes < 2.05 * meshes[-2].n_nodes
    assert quality(meshes[-1]).min_angle > 20
    assert bisected_meshes.containing_elements(meshes[1], meshes[2]).min() >= 0
    assert [len(m.boundary_facets("bottom")) for m in refine_near(cube(2), ["bottom", "left"], 2)] == [8, 32, 128]
    with pytest.raises(ValueError, match="boundary 'bottm' does not exist"):
        refine_near(FINE_SQUARE, "bottm")


# -- the history in files ----------------------------------------------------------------------------------------------

CROOKED = {"2D": crooked(SQUARE), "3D": crooked(cube(2))}


def thrice(mesh):
    for k in range(3):
        mesh, _ = bisect(mesh, random_mask(mesh, 0.2, k), passes=2)
    return mesh


@pytest.mark.parametrize("mesh", CROOKED.values(), ids=CROOKED)
def test_bisection_goes_on_from_a_file(mesh, tmp_path):
    fine, kinds = thrice(mesh), (MeshArrays, Refinement)
    (tmp_path / "mesh.npz").write_bytes(store.packed(fine, kinds, fine.refinement))
    stored = store.read(tmp_path / "mesh.npz", kinds, more=True)
    assert stored.value.refinement is None
    back = with_refinement(stored.value, stored.more)
    marked = random_mask(fine, 0.3, 9)
    first, second = (bisect(m, marked)[0] for m in (fine, back))
    for name in ("points", "elements", "facets", "facet_labels"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
