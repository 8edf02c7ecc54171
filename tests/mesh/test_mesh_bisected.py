"""Bisection is nested, keeps numbers, names and bodies, and leaves its input alone."""


import numpy as np
import pytest

from adaptmg.mesh import MeshArrays, bisect, check_mesh, quality, refine_near, structured
from adaptmg.problem import Box, Rectangle

SQUARE = structured(Rectangle(width=1, height=1), 4)
CUBE = structured(Box(width=1, depth=1, height=1), 2)
BOTH = pytest.mark.parametrize("mesh", [SQUARE, CUBE], ids=["2D", "3D"])


def containing_elements(coarse: MeshArrays, fine: MeshArrays) -> np.ndarray:
    """The coarse element that holds each fine one, -1 where there is none."""
    found = np.full(len(fine.elements), -1)
    for e, corners in enumerate(coarse.points[coarse.elements]):
        weights = np.linalg.solve((corners[1:] - corners[0]).T, (fine.points - corners[0]).T)
        weights = np.vstack([1 - weights.sum(axis=0), weights])
        found[(weights.min(axis=0) > -1e-12)[fine.elements].all(axis=1)] = e
    return found


@BOTH
def test_bisection_is_nested_and_halves_the_marked(mesh):
    marked = np.arange(len(mesh.elements)) % 7 == 0
    fine, parents = bisect(mesh, marked)
    check_mesh(fine, mesh.boundaries)
    holder = containing_elements(mesh, fine)
    assert (holder >= 0).all()
    children = np.bincount(holder, minlength=len(mesh.elements))
    assert (children[marked] >= 2**mesh.dim).all() and (children >= 1).all()
    assert fine.volumes.sum() == pytest.approx(mesh.volumes.sum(), rel=1e-14)
    assert fine.boundaries == mesh.boundaries
    # all elements: every edge is halved
    uniform, _ = bisect(mesh, np.ones(len(mesh.elements), dtype=bool))
    assert quality(uniform).h_max <= 0.5 * quality(mesh).h_max * (1 + 1e-12)
    assert len(uniform.elements) == 2**mesh.dim * len(mesh.elements)
    old, new = np.arange(mesh.n_nodes), np.arange(mesh.n_nodes, fine.n_nodes)
    np.testing.assert_array_equal(fine.points[old], mesh.points)
    np.testing.assert_array_equal(parents[old], np.stack([old, old], axis=1))
    np.testing.assert_array_equal(fine.points, fine.points[parents].mean(axis=1))
    assert len(new) and (parents[new] < new[:, None]).all() and (parents[new, 0] != parents[new, 1]).all()


def test_input_is_not_changed_and_the_source_follows():
    before = SQUARE.points.copy(), SQUARE.elements.copy(), SQUARE.source.nv
    fine, _ = bisect(SQUARE, np.ones(32, dtype=bool))
    assert SQUARE.source.nv == before[2]
    np.testing.assert_array_equal(SQUARE.points, before[0])
    np.testing.assert_array_equal(SQUARE.elements, before[1])
    np.testing.assert_array_equal([v.point for v in fine.source.vertices], fine.points)


def test_refine_near_reaches_strong_grading_without_bad_angles():
    meshes = refine_near(SQUARE, "bottom", 8)
    assert meshes[0] is SQUARE and len(meshes) == 9
    for level, mesh in enumerate(meshes):
        assert len(mesh.boundary_facets("bottom")) == 4 * 2**level
        assert len(mesh.boundary_facets("top")) == 4
    # the work goes to the boundary: nodes double with every level, uniform refinement would make four times as many
    assert meshes[-1].n_nodes < 2.05 * meshes[-2].n_nodes
    assert quality(meshes[-1]).min_angle > 20
    assert containing_elements(meshes[1], meshes[2]).min() >= 0
    assert [len(m.boundary_facets("bottom")) for m in refine_near(CUBE, ["bottom", "left"], 2)] == [8, 32, 128]
    with pytest.raises(ValueError, match="boundary 'bottm' does not exist"):
        refine_near(SQUARE, "bottm")
