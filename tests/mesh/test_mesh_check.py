"""check_mesh finds what is wrong with a mesh; quality measures known elements."""

from dataclasses import replace

import numpy as np
import pytest

from adaptmg.mesh import MeshArrays, check_mesh, quality, structured
from adaptmg.mesh.arrays import element_facets, facet_keys, facet_table, same_orientation
from adaptmg.problem import Box, Rectangle

SQUARE = structured(Rectangle(width=1, height=1), 4)
CUBE = structured(Box(width=1, depth=1, height=1), 3)
BOTH = pytest.mark.parametrize("mesh", [SQUARE, CUBE], ids=["2D", "3D"])


def interior_element(mesh: MeshArrays) -> int:
    """An element without a boundary facet."""
    table = facet_table(mesh.elements, mesh.n_nodes)
    return int(np.setdiff1d(np.arange(len(mesh.elements)), table.first[table.counts == 1])[0])


@BOTH
def test_sound_mesh_is_returned_unchanged(mesh):
    unchecked = replace(mesh, source=None)
    assert check_mesh(unchecked, mesh.boundaries) is unchecked


def test_a_sound_mesh_is_not_searched_again_but_a_changed_one_is(monkeypatch):
    mesh = replace(structured(Rectangle(width=1, height=1), 2), source=None)
    assert not mesh.sound and check_mesh(mesh).sound
    monkeypatch.setattr("adaptmg.mesh.soundness.facet_table", lambda *_: pytest.fail("searched again"))
    assert check_mesh(mesh) is mesh
    with pytest.raises(ValueError, match="boundary 'rim' does not exist"):
        check_mesh(mesh, "rim")
    monkeypatch.undo()
    broken = replace(mesh, facets=mesh.facets[1:], facet_labels=mesh.facet_labels[1:])
    assert not broken.sound
    with pytest.raises(ValueError, match="has a hole"):
        check_mesh(broken)


@BOTH
def test_hole_is_found_and_located(mesh):
    e = interior_element(mesh)
    holed = replace(mesh, elements=np.delete(mesh.elements, e, axis=0), element_body=None)
    with pytest.raises(ValueError, match=rf"^{mesh.dim + 1} .* belong to one element and to no boundary .* nodes \["):
        check_mesh(holed)


@BOTH
def test_inverted_and_degenerate_elements_are_named(mesh):
    elements = mesh.elements.copy()
    elements[3, :2] = elements[3, 1::-1]
    with pytest.raises(ValueError, match=r"1 of .* elements are inverted; element 3 .* volume -0.0"):
        check_mesh(replace(mesh, elements=elements))
    points = mesh.points.copy()
    points[mesh.elements[5, 0]] = points[mesh.elements[5, 1]]
    with pytest.raises(ValueError, match=r"degenerate; element .* has volume"):
        check_mesh(replace(mesh, points=points))


@BOTH
def test_wrong_boundary_facets_are_found(mesh):
    inward = mesh.facets.copy()
    inward[2, :2] = inward[2, 1::-1]
    with pytest.raises(ValueError, match="1 boundary facets have their normal inwards"):
        check_mesh(replace(mesh, facets=inward))
    twice = np.vstack([mesh.facets, mesh.facets[:1]])
    labels = np.r_[mesh.facet_labels, mesh.facet_labels[0]]
    with pytest.raises(ValueError, match="given twice"):
        check_mesh(replace(mesh, facets=twice, facet_labels=labels))
    table = facet_table(mesh.elements, mesh.n_nodes)
    inner = np.vstack([mesh.facets, table.facets[table.counts == 2][:1]])
    with pytest.raises(ValueError, match="lie inside the mesh"):
        check_mesh(replace(mesh, facets=inner, facet_labels=labels))
    far = np.vstack([mesh.facets, [np.array([0, mesh.n_nodes - 1, mesh.n_nodes - 2])[:mesh.dim]]])
    with pytest.raises(ValueError, match=r"are no (edge|face) of any element"):
        check_mesh(replace(mesh, facets=far, facet_labels=labels))


def two_squares(bodies: tuple[str, ...]) -> MeshArrays:
    """Two separate squares of 32 and 8 triangles."""
    small = structured(Rectangle(width=1, height=1, origin=(2, 0)), 2)
    body = np.repeat(np.arange(2) % len(bodies), [32, 8])
    return MeshArrays(np.vstack([SQUARE.points, small.points]),
                      np.vstack([SQUARE.elements, small.elements + SQUARE.n_nodes]),
                      np.vstack([SQUARE.facets, small.facets + SQUARE.n_nodes]),
                      np.r_[SQUARE.facet_labels, small.facet_labels], SQUARE.boundaries, body, bodies)


def test_two_pieces_need_two_bodies():
    check_mesh(two_squares(("big", "small")))
    with pytest.raises(ValueError, match="body 'all' consists of 2 pieces, of 32, 8 elements"):
        check_mesh(two_squares(("all",)))


def test_pieces_that_share_only_a_node_are_two():
    points = np.array([[0, 0], [1, 0], [1, 1], [2, 1], [2, 2.0]])
    mesh = MeshArrays(points, [[0, 1, 2], [2, 3, 4]], [[0, 1], [1, 2], [2, 0], [2, 3], [3, 4], [4, 2]], np.zeros(6),
                      ("rim",))
    with pytest.raises(ValueError, match="2 pieces, of 1, 1 elements"):
        check_mesh(mesh)


def test_names_are_checked():
    with pytest.raises(ValueError, match="'contct' does not exist; the boundaries are bottom, right, top, left"):
        check_mesh(SQUARE, ["bottom", "contct"])
    with pytest.raises(ValueError, match="boundary 'bottm'"):
        check_mesh(SQUARE, "bottm")
    # a name without facets is as good as missing
    with pytest.raises(ValueError, match="'hidden' does not exist"):
        check_mesh(replace(SQUARE, boundaries=(*SQUARE.boundaries, "hidden")), ["hidden"])
    with pytest.raises(ValueError, match="boundaries must be distinct"):
        check_mesh(replace(SQUARE, boundaries=("a", "b", "a", "c")))
    with pytest.raises(ValueError, match="body 'ghost' has no elements"):
        check_mesh(replace(SQUARE, bodies=("body", "ghost")))


@BOTH
def test_outward_facets_close_the_body(mesh):
    # divergence theorem: the normals of a closed surface add up to zero, x . n to dim times the volume
    corners = mesh.points[mesh.facets]
    edge = corners[:, 1] - corners[:, 0]
    normals = (np.stack([edge[:, 1], -edge[:, 0]], axis=1) if mesh.dim == 2
               else 0.5 * np.cross(edge, corners[:, 2] - corners[:, 0]))
    np.testing.assert_allclose(normals.sum(axis=0), 0, atol=1e-14)
    np.testing.assert_allclose((normals * corners.mean(axis=1)).sum(), mesh.dim * mesh.volumes.sum(), rtol=1e-13)


def test_facet_keys_do_not_depend_on_the_order_of_nodes():
    rng = np.random.default_rng(1)
    facets = np.array([rng.choice(50, 3, replace=False) for _ in range(200)])
    keys = facet_keys(facets, 50)
    np.testing.assert_array_equal(keys, facet_keys(facets[:, [2, 0, 1]], 50))
    assert len(np.unique(keys)) == len(np.unique(np.sort(facets, axis=1), axis=0))
    assert same_orientation(facets, facets[:, [1, 2, 0]]).all()
    assert not same_orientation(facets, facets[:, [1, 0, 2]]).any()
    with pytest.raises(ValueError, match="at most"):
        facet_keys(facets, 3_000_000)


def test_quality_of_known_elements():
    half = quality(structured(Rectangle(width=2, height=2), 1))
    assert half.min_angle == pytest.approx(45) and half.max_angle == pytest.approx(90)
    assert half.h_min == pytest.approx(2) and half.h_max == pytest.approx(2 * np.sqrt(2))
    corners = [[0, 0], [1, 0], [0.5, np.sqrt(0.75)]]
    triangle = MeshArrays(corners, [[0, 1, 2]], [[0, 1], [1, 2], [2, 0]], [0] * 3, ("a",))
    best = quality(check_mesh(triangle))
    assert best.min_angle == pytest.approx(60) and best.aspect_ratio == pytest.approx(1)
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]])
    element = np.array([[0, 2, 1, 3]])
    best = quality(check_mesh(MeshArrays(corners, element, element_facets(element)[0], [0] * 4, ("a",))))
    assert best.min_angle == pytest.approx(np.degrees(np.arccos(1 / 3))) == best.max_angle
    assert best.aspect_ratio == pytest.approx(1)
