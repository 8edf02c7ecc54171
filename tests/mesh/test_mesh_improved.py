"""halved and improved: sound meshes of the same bodies, better shapes, sizes and boundaries kept."""

from dataclasses import replace

import numpy as np
import pytest
from uncompiled import uncompile

import adaptmg as am
from adaptmg.mesh import check_mesh, graded, improve, structured
from adaptmg.mesh.improve import halved, improved

PLATE = am.Rectangle(width=0.3, height=0.2)
BOX = am.Box(width=0.3, depth=0.2, height=0.1)
TWO = am.Assembly(parts={"left": PLATE, "right": am.Rectangle(width=0.1, height=0.2, origin=(0.3, 0.0))})


def shapes(mesh):
    """Mean ratios, 1 for equilateral elements."""
    corners, k = mesh.points[mesh.elements], mesh.dim + 1
    square = sum(np.square(corners[:, i] - corners[:, j]).sum(axis=1) for i in range(k) for j in range(i))
    return (4 * np.sqrt(3) * mesh.volumes if mesh.dim == 2 else 12 * np.cbrt(3 * mesh.volumes)**2) / square


def shaken(mesh, share=0.3):
    """Inner nodes moved at random, as far as no element turns over."""
    rng, points = np.random.default_rng(3), mesh.points.copy()
    inner = np.setdiff1d(np.arange(mesh.n_nodes), mesh.facets)
    points[inner] += share * mesh.element_sizes.min() * rng.uniform(-1, 1, (len(inner), mesh.dim))
    moved = am.MeshArrays(points, mesh.elements, mesh.facets, mesh.facet_labels, mesh.boundaries)
    assert moved.volumes.min() > 0
    return moved


@pytest.mark.parametrize(("mesh", "least"), [(structured(PLATE, (12, 8)), 0.86), (graded(BOX, 0.03), 0.75),
                                             (graded(PLATE, 0.03, ["bottom"], 8), 0.94)],
                         ids=["squares", "box", "graded"])
def test_shapes_get_better_and_the_boundary_stays(mesh, least):
    rough = shaken(mesh, 0.2)
    better = improved(rough, 8)
    check_mesh(better)
    assert shapes(better).mean() > max(shapes(rough).mean() + 0.01, least)
    assert (1 / shapes(better)).sum() < (1 / shapes(rough)).sum()
    assert (better.facets == mesh.facets).all() and better.boundaries == mesh.boundaries
    on = np.unique(mesh.facets)
    assert (better.points[on] == mesh.points[on]).all()
    assert better.volumes.sum() == pytest.approx(mesh.volumes.sum(), rel=1e-12)


def test_swapped_triangles_are_delaunay():
    rough = shaken(graded(PLATE, 0.02))
    better = improved(rough, 1)
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


def test_kernels_are_plain_python(monkeypatch):
    rough, solid = shaken(graded(PLATE, 0.08), 0.2), shaken(graded(BOX, 0.07), 0.1)
    compiled = improved(rough, 2), halved(rough), improved(halved(solid), 1)
    uncompile(monkeypatch, improve)
    for one, other in zip(compiled, (improved(rough, 2), halved(rough), improved(halved(solid), 1)), strict=True):
        assert (one.elements == other.elements).all()
        np.testing.assert_allclose(one.points, other.points, atol=1e-12)


@pytest.mark.parametrize("mesh", [structured(PLATE, 3), graded(PLATE, 0.07), structured(BOX, 2), graded(BOX, 0.06),
                                  graded(TWO, 0.07)], ids=["plane", "Netgen", "box", "Netgen's box", "two bodies"])
def test_halves_are_a_sound_mesh_of_the_same_bodies(mesh):
    fine = halved(mesh)
    assert fine.sound and fine.boundaries == mesh.boundaries and fine.bodies == mesh.bodies
    assert len(fine.elements) == 2**mesh.dim * len(mesh.elements)
    assert len(fine.facets) == 2 ** (mesh.dim - 1) * len(mesh.facets)
    assert (fine.points[:mesh.n_nodes] == mesh.points).all()
    # by what it is, not by what it says
    check_mesh(replace(fine, source=None))
    np.testing.assert_allclose(fine.volumes.reshape(len(mesh.elements), -1) * 2**mesh.dim, mesh.volumes[:, None]
                               * np.ones(2**mesh.dim), rtol=1e-10)
    body = fine.element_body.reshape(len(mesh.elements), -1)
    assert (body == mesh.element_body[:, None]).all()
    for name in mesh.boundaries:
        assert len(fine.boundary_facets(name)) == 2 ** (mesh.dim - 1) * len(mesh.boundary_facets(name))


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
