"""Structured meshes: exact nodes, exact volumes, nested, names on the right sides."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adaptmg.mesh import check_mesh, structured
from adaptmg.mesh.arrays import facet_table
from adaptmg.problem import Box, Rectangle

RECTANGLE = Rectangle(width=0.3, height=0.7, origin=(-0.1, 0.2))
BOX = Box(width=0.3, depth=0.2, height=0.7, origin=(1, 2, 3))
SIDES = {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1), "bottom": (-1, 0), "top": (-1, 1)}


@settings(max_examples=15, deadline=None)
@given(nx=st.integers(1, 6), ny=st.integers(1, 6), diagonal=st.sampled_from(["right", "left", "alternating"]))
def test_rectangle(nx, ny, diagonal):
    mesh = check_mesh(structured(RECTANGLE, (nx, ny), diagonal), RECTANGLE.boundaries)
    assert mesh.n_nodes == (nx + 1) * (ny + 1) and len(mesh.elements) == 2 * nx * ny
    np.testing.assert_allclose(mesh.volumes, 0.21 / (2 * nx * ny), rtol=1e-12)


@settings(max_examples=8, deadline=None)
@given(st.tuples(st.integers(1, 3), st.integers(1, 3), st.integers(1, 3)))
def test_box(divisions):
    mesh = check_mesh(structured(BOX, divisions), BOX.boundaries)
    assert mesh.n_nodes == np.prod(np.array(divisions) + 1) and len(mesh.elements) == 6 * np.prod(divisions)
    np.testing.assert_allclose(mesh.volumes, 0.042 / (6 * np.prod(divisions)), rtol=1e-11)


@pytest.mark.parametrize(("domain", "diagonal"), [(RECTANGLE, "right"), (RECTANGLE, "left"), (RECTANGLE, "alternating"),
                                                  (BOX, "right")])
def test_doubling_is_nested(domain, diagonal):
    coarse, fine = structured(domain, 3, diagonal), structured(domain, 6, diagonal)
    # every coarse node is a fine node, to the last bit
    fine_nodes = {tuple(x) for x in fine.points}
    assert all(tuple(x) in fine_nodes for x in coarse.points)
    # every fine element lies inside one coarse element
    inside = np.zeros(len(fine.elements), dtype=bool)
    for corners in coarse.points[coarse.elements]:
        weights = np.linalg.solve((corners[1:] - corners[0]).T, (fine.points - corners[0]).T)
        weights = np.vstack([1 - weights.sum(axis=0), weights])
        inside |= (weights.min(axis=0) > -1e-12)[fine.elements].all(axis=1)
    assert inside.all()


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
def test_boundary_is_that_of_the_elements_side_by_side(domain, divisions, diagonal):
    mesh = structured(domain, divisions, diagonal)
    table = facet_table(mesh.elements, mesh.n_nodes)
    outer = table.facets[table.counts == 1]
    rows = np.lexsort(np.sort(outer, axis=1).T[::-1])
    mine = np.lexsort(np.sort(mesh.facets, axis=1).T[::-1])
    np.testing.assert_array_equal(mesh.facets[mine], outer[rows])
    order = np.lexsort((mesh.facets.min(axis=1), mesh.facet_labels))
    np.testing.assert_array_equal(order, np.arange(len(mesh.facets)))
    assert mesh.sound and check_mesh(replace(mesh, source=None)).sound


def test_importing_the_package_does_not_import_ngsolve():
    code = ("import sys, adaptmg.mesh as m; assert 'ngsolve' not in sys.modules and 'netgen' not in sys.modules; "
            "m.structured(__import__('adaptmg').Rectangle(width=1, height=1), 2); assert 'ngsolve' not in sys.modules; "
            "m.sized; m.graded; assert all(callable(getattr(m, n)) for n in m.__all__)")
    subprocess.run([sys.executable, "-c", code], check=True, timeout=120)


def test_unknown_name():
    import adaptmg.mesh

    with pytest.raises(AttributeError, match="no attribute 'grade'"):
        adaptmg.mesh.grade  # noqa: B018
    assert "graded" in dir(adaptmg.mesh)
