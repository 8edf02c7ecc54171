"""Structured meshes, halved and improved ones: sound, nested, of the same bodies, with better
shapes."""

import math
from dataclasses import replace

import numpy as np
import pytest
from bisected_meshes import shaken as moved

import adaptmg as am
from adaptmg.mesh.arrays import facet_table
from adaptmg.mesh.improve import halved, improved

BOX = am.Box(width=0.3, depth=0.2, height=0.1)
TWO = am.Assembly(
    parts={"left": BOX, "right": am.Box(width=0.1, depth=0.2, height=0.1, origin=(0.3, 0, 0))}
)


def shaken(mesh, share=0.3):
    return moved(mesh, share * mesh.element_sizes.min())


def shapes(mesh):
    """Mean ratios, 1 for equilateral tetrahedra."""
    corners = mesh.points[mesh.elements]
    square = sum(
        np.square(corners[:, i] - corners[:, j]).sum(axis=1) for i in range(4) for j in range(i)
    )
    return 12 * np.cbrt(3 * mesh.volumes) ** 2 / square


def test_shapes_get_better_and_the_boundary_stays():
    mesh = am.mesh.graded(BOX, 0.03)
    rough = shaken(mesh, 0.2)
    better = improved(rough, 8)
    am.mesh.check_mesh(better)
    assert shapes(better).mean() > max(shapes(rough).mean() + 0.009, 0.75)
    assert (1 / shapes(better)).sum() < (1 / shapes(rough)).sum()
    assert (better.facets == mesh.facets).all() and better.boundaries == mesh.boundaries
    on = np.unique(mesh.facets)
    assert (better.points[on] == mesh.points[on]).all()
    assert better.volumes.sum() == pytest.approx(mesh.volumes.sum(), rel=1e-12)


@pytest.mark.parametrize(
    "mesh",
    [am.mesh.structured(BOX, 2), am.mesh.graded(BOX, 0.06), am.mesh.graded(TWO, 0.07)],
    ids=["structured", "graded", "two bodies"],
)
def test_halves_are_a_sound_mesh_of_the_same_bodies(mesh):
    fine = halved(mesh)
    assert fine.sound and fine.boundaries == mesh.boundaries and fine.bodies == mesh.bodies
    assert len(fine.elements) == 8 * len(mesh.elements) and len(fine.facets) == 4 * len(mesh.facets)
    assert (fine.points[: mesh.n_nodes] == mesh.points).all()
    # by what it is, not by what it says
    am.mesh.check_mesh(replace(fine))
    np.testing.assert_allclose(8 * fine.volumes, np.repeat(mesh.volumes, 8), rtol=1e-10)
    np.testing.assert_array_equal(fine.element_body, np.repeat(mesh.element_body, 8))
    for name in mesh.boundaries:
        assert len(fine.boundary_facets(name)) == 4 * len(mesh.boundary_facets(name))


@pytest.mark.parametrize(
    "order", [(0, 1, 2, 3), (1, 0, 3, 2), (2, 3, 0, 1), (0, 2, 3, 1), (0, 3, 1, 2)]
)
def test_octahedra_are_cut_along_the_shortest_diagonal(order):
    # the middles of the edges (0, 1) and (2, 3) are the closest of opposite ones
    corners = np.array([[-1.0, 0, -0.1], [1, 0, -0.1], [0, -1, 0.1], [0, 1, 0.1]])
    elements = np.array([order])
    if np.linalg.det(corners[elements[0, 1:]] - corners[elements[0, 0]]) < 0:
        elements = elements[:, [1, 0, 2, 3]]
    facets = elements[:, [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]]].reshape(-1, 3)
    fine = halved(am.MeshArrays(corners, elements, facets, np.zeros(4), ("all",)))
    am.mesh.check_mesh(fine)
    inner = [set(cell) for cell in fine.elements.tolist() if min(cell) >= 4]
    ends = {
        int(np.flatnonzero((fine.points == place).all(axis=1))[0])
        for place in ([0, 0, -0.1], [0, 0, 0.1])
    }
    assert len(inner) == 4 and all(ends <= cell for cell in inner)


# -- structured meshes ------------------------------------------------------------------------------------------------

RECTANGLE = am.Rectangle(width=0.3, height=0.7, origin=(-0.1, 0.2))
SOLID = am.Box(width=0.3, depth=0.2, height=0.7, origin=(1, 2, 3))


@pytest.mark.parametrize(
    ("domain", "divisions"),
    [(RECTANGLE, (5, 3)), (RECTANGLE, 1), (SOLID, (3, 1, 4)), (SOLID, (1, 2, 2))],
)
def test_counts_volumes_and_the_boundary_side_by_side(domain, divisions):
    mesh = am.mesh.structured(domain, divisions)
    table = facet_table(mesh.elements, mesh.n_nodes)
    outer = table.facets[table.counts == 1]
    rows = np.lexsort(np.sort(outer, axis=1).T[::-1])
    mine = np.lexsort(np.sort(mesh.facets, axis=1).T[::-1])
    np.testing.assert_array_equal(mesh.facets[mine], outer[rows])
    order = np.lexsort((mesh.facets.min(axis=1), mesh.facet_labels))
    np.testing.assert_array_equal(order, np.arange(len(mesh.facets)))
    assert mesh.sound and am.mesh.check_mesh(replace(mesh), domain.boundaries).sound
    counts = np.broadcast_to(divisions, mesh.dim)
    assert mesh.n_nodes == np.prod(counts + 1) and len(mesh.elements) == math.factorial(
        mesh.dim
    ) * np.prod(counts)
    # every node is one of the mesh with twice the divisions, to the last bit
    assert set(map(tuple, mesh.points)) <= set(
        map(tuple, am.mesh.structured(domain, 2 * counts).points)
    )
    volume = np.prod(domain.upper - domain.lower)
    np.testing.assert_allclose(mesh.volumes, volume / len(mesh.elements), rtol=1e-11)
