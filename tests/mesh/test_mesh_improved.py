"""Structured meshes, halved and improved ones: sound, nested, of the same bodies, with better shapes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from bisected_meshes import containing_elements
from bisected_meshes import shaken as moved

import adaptmg as am
from adaptmg.mesh import check_mesh, graded, structured
from adaptmg.mesh.arrays import element_facets, facet_keys, facet_table
from adaptmg.mesh.improve import halved, improve_triangles, improved

PLATE = am.Rectangle(width=0.3, height=0.2)
BOX = am.Box(width=0.3, depth=0.2, height=0.1)
TWO = am.Assembly(parts={"left": BOX, "right": am.Box(width=0.1, depth=0.2, height=0.1, origin=(0.3, 0, 0))})


def shaken(mesh, share=0.3):
    return moved(mesh, share * mesh.element_sizes.min())


def better_shaped(mesh, rounds):
    """The mesh improved, also of triangles."""
    if mesh.dim == 3:
        return improved(mesh, rounds)
    table = facet_table(mesh.elements, mesh.n_nodes)
    row = table.find(facet_keys(element_facets(mesh.elements).reshape(-1, 2), mesh.n_nodes))
    own = np.repeat(np.arange(len(mesh.elements)), 3)
    across = np.where(table.first[row] == own, table.second[row], table.first[row]).reshape(-1, 3).astype(np.int32)
    points, elements, held = mesh.points.copy(), mesh.elements.copy(), np.isin(np.arange(mesh.n_nodes), mesh.facets)
    improve_triangles(points, elements, across, held, rounds)
    return replace(mesh, points=points, elements=elements, source=None)


def shapes(mesh):
    """Mean ratios, 1 for equilateral elements."""
    corners, k = mesh.points[mesh.elements], mesh.dim + 1
    square = sum(np.square(corners[:, i] - corners[:, j]).sum(axis=1) for i in range(k) for j in range(i))
    return (4 * np.sqrt(3) * mesh.volumes if mesh.dim == 2 else 12 * np.cbrt(3 * mesh.volumes)**2) / square


@pytest.mark.parametrize(("mesh", "least"), [(structured(PLATE, (12, 8)), 0.86), (graded(BOX, 0.03), 0.75),
                                             (graded(PLATE, 0.03, ["bottom"], 8), 0.94)],
                         ids=["squares", "box", "graded"])
def test_shapes_get_better_and_the_boundary_stays(mesh, least):
    rough = shaken(mesh, 0.2)
    better = better_shaped(rough, 8)
    check_mesh(better)
    assert shapes(better).mean() > max(shapes(rough).mean() + 0.009, least)
    assert (1 / shapes(better)).sum() < (1 / shapes(rough)).sum()
    assert (better.facets == mesh.facets).all() and better.boundaries == mesh.boundaries
    on = np.unique(mesh.facets)
    assert (better.points[on] == mesh.points[on]).all()
    assert better.volumes.sum() == pytest.approx(mesh.volumes.sum(), rel=1e-12)


def test_swapped_triangles_are_delaunay():
    rough = shaken(graded(PLATE, 0.02))
    better = better_shaped(rough, 1)
    # of every node the circumcircles of the others' triangles hold none; moves after the swaps spoil few
    corners = better.points[better.elements]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    double = 2 * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    square = np.column_stack([np.square(a).sum(axis=1), np.square(b).sum(axis=1)])
    centre = np.column_stack([b[:, 1] * square[:, 0] - a[:, 1] * square[:, 1],
                              a[:, 0] * square[:, 1] - b[:, 0] * square[:, 0]]) / double[:, None]
    radius = np.linalg.norm(centre, axis=1)
    apart = np.linalg.norm((corners[:, 0] + centre)[:, None] - better.points[None], axis=2)
    inside = (apart < radius[:, None] * (1 - 1e-6)).any(axis=1)
    assert inside.mean() < 0.05


@pytest.mark.parametrize("mesh", [structured(BOX, 2), graded(BOX, 0.06), graded(TWO, 0.07)],
                         ids=["structured", "graded", "two bodies"])
def test_halves_are_a_sound_mesh_of_the_same_bodies(mesh):
    fine = halved(mesh)
    assert fine.sound and fine.boundaries == mesh.boundaries and fine.bodies == mesh.bodies
    assert len(fine.elements) == 8 * len(mesh.elements) and len(fine.facets) == 4 * len(mesh.facets)
    assert (fine.points[:mesh.n_nodes] == mesh.points).all()
    # by what it is, not by what it says
    check_mesh(replace(fine, source=None))
    np.testing.assert_allclose(8 * fine.volumes, np.repeat(mesh.volumes, 8), rtol=1e-10)
    np.testing.assert_array_equal(fine.element_body, np.repeat(mesh.element_body, 8))
    for name in mesh.boundaries:
        assert len(fine.boundary_facets(name)) == 4 * len(mesh.boundary_facets(name))


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (1, 0, 3, 2), (2, 3, 0, 1), (0, 2, 3, 1), (0, 3, 1, 2)])
def test_octahedra_are_cut_along_the_shortest_diagonal(order):
    # the middles of the edges (0, 1) and (2, 3) are the closest of opposite ones
    corners = np.array([[-1.0, 0, -0.1], [1, 0, -0.1], [0, -1, 0.1], [0, 1, 0.1]])
    elements = np.array([order])
    if np.linalg.det(corners[elements[0, 1:]] - corners[elements[0, 0]]) < 0:
        elements = elements[:, [1, 0, 2, 3]]
    facets = elements[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    fine = halved(am.MeshArrays(corners, elements, facets, np.zeros(4), ("all",)))
    check_mesh(fine)
    inner = [set(cell) for cell in fine.elements.tolist() if min(cell) >= 4]
    ends = {int(np.flatnonzero((fine.points == place).all(axis=1))[0]) for place in ([0, 0, -0.1], [0, 0, 0.1])}
    assert len(inner) == 4 and all(ends <= cell for cell in inner)


# -- structured meshes ------------------------------------------------------------------------------------------------

RECTANGLE = am.Rectangle(width=0.3, height=0.7, origin=(-0.1, 0.2))
SOLID = am.Box(width=0.3, depth=0.2, height=0.7, origin=(1, 2, 3))


@pytest.mark.parametrize("domain", [RECTANGLE, SOLID])
def test_doubling_is_nested(domain):
    coarse, fine = structured(domain, 3), structured(domain, 6)
    # every coarse node is a fine node, to the last bit
    assert set(map(tuple, coarse.points)) <= set(map(tuple, fine.points))
    assert containing_elements(coarse, fine).min() >= 0


@pytest.mark.parametrize(("domain", "divisions"), [(RECTANGLE, (5, 3)), (RECTANGLE, 1), (SOLID, (3, 1, 4)),
                                                   (SOLID, (1, 2, 2))])
def test_counts_volumes_and_the_boundary_side_by_side(domain, divisions):
    mesh = structured(domain, divisions)
    table = facet_table(mesh.elements, mesh.n_nodes)
    outer = table.facets[table.counts == 1]
    rows = np.lexsort(np.sort(outer, axis=1).T[::-1])
    mine = np.lexsort(np.sort(mesh.facets, axis=1).T[::-1])
    np.testing.assert_array_equal(mesh.facets[mine], outer[rows])
    order = np.lexsort((mesh.facets.min(axis=1), mesh.facet_labels))
    np.testing.assert_array_equal(order, np.arange(len(mesh.facets)))
    assert mesh.sound and check_mesh(replace(mesh, source=None), domain.boundaries).sound
    counts = np.broadcast_to(divisions, mesh.dim)
    assert mesh.n_nodes == np.prod(counts + 1) and len(mesh.elements) == math.factorial(mesh.dim) * np.prod(counts)
    volume = np.prod(domain.upper - domain.lower)
    np.testing.assert_allclose(mesh.volumes, volume / len(mesh.elements), rtol=1e-11)
