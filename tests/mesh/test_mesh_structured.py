"""Structured meshes: exact nodes, exact volumes, nested, names on the right sides."""

import math
from dataclasses import replace

import numpy as np
import pytest
from bisected_meshes import containing_elements

from adaptmg.mesh import check_mesh, structured
from adaptmg.mesh.arrays import facet_table
from adaptmg.problem import Box, Rectangle

RECTANGLE = Rectangle(width=0.3, height=0.7, origin=(-0.1, 0.2))
BOX = Box(width=0.3, depth=0.2, height=0.7, origin=(1, 2, 3))


@pytest.mark.parametrize(("domain", "diagonal"), [(RECTANGLE, "right"), (RECTANGLE, "left"), (RECTANGLE, "alternating"),
                                                  (BOX, "right")])
def test_doubling_is_nested(domain, diagonal):
    coarse, fine = structured(domain, 3, diagonal), structured(domain, 6, diagonal)
    # every coarse node is a fine node, to the last bit
    fine_nodes = {tuple(x) for x in fine.points}
    assert all(tuple(x) in fine_nodes for x in coarse.points)
    assert containing_elements(coarse, fine).min() >= 0


def test_diagonals():
    def lowest(diagonal):
        mesh = structured(Rectangle(width=1, height=1), 1, diagonal)
        return {tuple(sorted(element)) for element in mesh.elements.tolist()}

    assert lowest("right") == lowest("alternating") == {(0, 1, 3), (0, 2, 3)}
    assert lowest("left") == {(0, 1, 2), (1, 2, 3)}
    # alternating: an inner node has 4 or 8 elements
    mesh = structured(Rectangle(width=1, height=1), 4, "alternating")
    inner = ((mesh.points > 0) & (mesh.points < 1)).all(axis=1)
    assert set(np.bincount(mesh.elements.ravel())[inner]) == {4, 8}


@pytest.mark.parametrize(("domain", "divisions", "diagonal"), [
    (RECTANGLE, (5, 3), "right"), (RECTANGLE, (2, 5), "left"), (RECTANGLE, (4, 3), "alternating"),
    (RECTANGLE, 1, "left"), (BOX, (3, 1, 4), "right"), (BOX, (1, 2, 2), "right")])
def test_counts_volumes_and_the_boundary_side_by_side(domain, divisions, diagonal):
    mesh = structured(domain, divisions, diagonal)
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
