"""halved: sound meshes of the same bodies, all edges cut, octahedra along their shortest diagonals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import adaptmg as am
from adaptmg.mesh import check_mesh, graded, structured
from adaptmg.mesh.improve import halved

PLATE = am.Rectangle(width=0.3, height=0.2)
BOX = am.Box(width=0.3, depth=0.2, height=0.1)
TWO = am.Assembly(parts={"left": PLATE, "right": am.Rectangle(width=0.1, height=0.2, origin=(0.3, 0.0))})


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
