"""Point location: every point is found, exactly, on any mesh; and ratios of the sizes of two meshes
there."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from refused import refused
from simplex_meshes import disk, log_graded, mesh_of, random_box, structured, two_boxes

import adaptmg as am

MESHES = {
    "random 2D": random_box(80, 2, 1),
    "random 3D": random_box(60, 3, 1),
    "graded 2D": log_graded(1000, 2),
    "graded 3D": structured(8, 3, 4.0),
    "one triangle": mesh_of([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]]),
    "disk": disk(5),
}


def position(mesh, found):
    return np.einsum("nk,nkd->nd", found.weights, mesh.points[mesh.elements[found.element]])


def nodal(mesh, found):
    """Dense interpolation rows, which do not depend on the element chosen on a common face."""
    rows = np.zeros((len(found.element), mesh.n_nodes))
    np.add.at(rows, (np.arange(len(rows))[:, None], mesh.elements[found.element]), found.weights)
    return rows


def brute_force_weights(mesh, point):
    """Barycentric weights of one point in every element, by linear solves."""
    corners = mesh.points[mesh.elements]
    system = np.concatenate(
        [np.ones((len(corners), 1, mesh.dim + 1)), np.swapaxes(corners, 1, 2)], axis=1
    )
    return np.linalg.solve(system, np.append(1.0, point)[None, :, None])[:, :, 0]


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), dim=st.sampled_from([2, 3]), n=st.integers(1, 25))
def test_agrees_with_brute_force(seed, dim, n):
    mesh = random_box(n, dim, seed)
    points = np.random.default_rng(seed).random((20, dim)) * 1.4 - 0.2
    found = am.transfer.PointLocator(mesh).locate(points)
    for point, element, weights, distance in zip(
        points, found.element, found.weights, found.distance, strict=True
    ):
        every = brute_force_weights(mesh, point)
        if every.min(axis=1).max() > 1e-9:
            assert distance == 0 and every[element].min() > -1e-9
            np.testing.assert_allclose(weights, every[element], atol=1e-9)
        else:
            nearest = np.clip(point, 0, 1)
            assert distance == pytest.approx(np.linalg.norm(point - nearest), abs=1e-9)
            np.testing.assert_allclose(
                weights @ mesh.points[mesh.elements[element]], nearest, atol=1e-9
            )


@pytest.mark.parametrize("dim", [2, 3])
def test_points_of_the_boundary_lie_inside(dim):
    mesh, rng = random_box(60, dim, 3), np.random.default_rng(0)
    # turned about an axis and moved, so that coordinates on a side are rounded
    axes = np.eye(dim)
    axes[:2, :2] = [[0.8, 0.6], [-0.6, 0.8]]
    points = mesh.points @ axes + 100.0
    shares = rng.dirichlet(np.ones(dim), (20, len(mesh.facets)))
    places = np.einsum("nfk,fkd->nfd", shares, points[mesh.facets]).reshape(-1, dim)
    assert (
        am.transfer.PointLocator(mesh_of(points, mesh.elements)).locate(places).distance == 0
    ).all()


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), dim=st.sampled_from([2, 3]))
def test_outside_a_shape_that_is_not_convex(seed, dim):
    # a box of 4^dim cells without the cells of one corner: the union of boxes, whose nearest points
    # are known
    whole = structured(4, dim)
    centres = whole.points[whole.elements].mean(axis=1)
    mesh = mesh_of(whole.points, whole.elements[~(centres > 0.5).all(axis=1)])
    points = np.random.default_rng(seed).random((30, dim)) * 3 - 1
    found = am.transfer.PointLocator(mesh).locate(points)
    high = [np.where(np.arange(dim) == axis, 0.5, 1.0) for axis in range(dim)]
    expected = np.min(
        [np.linalg.norm(points - np.clip(points, 0, h), axis=1) for h in high], axis=0
    )
    np.testing.assert_allclose(found.distance, expected, atol=1e-12)
    np.testing.assert_allclose(
        np.linalg.norm(points - position(mesh, found), axis=1), expected, atol=1e-12
    )
    assert (found.weights >= 0).all()
    np.testing.assert_allclose(found.weights.sum(axis=1), 1, atol=1e-14)


def test_far_away_none_and_each_body():
    mesh, both = MESHES["random 2D"], two_boxes(3, 2)
    found = am.transfer.PointLocator(mesh).locate(np.array([[1e9, 0.5], [-1e12, -1e12]]))
    np.testing.assert_allclose(found.distance, [1e9 - 1, np.sqrt(2) * 1e12], rtol=1e-12)
    empty = am.transfer.PointLocator(mesh).locate(np.zeros((0, 2)))
    assert (
        empty.element.shape == (0,)
        and empty.weights.shape == (0, 3)
        and empty.distance.shape == (0,)
    )
    points = np.column_stack([np.linspace(0, 1, 20), np.zeros(20)])
    for body in (0, 1):
        found = am.transfer.PointLocator(both, body=body).locate(points)
        assert (both.element_body[found.element] == body).all() and not found.distance.any()


def bare(points, elements):
    return am.MeshArrays(
        points=points, elements=elements, facets=np.zeros((0, 2)), facet_labels=[], boundaries=()
    )


test_failures_name_the_argument = refused(
    (
        lambda: am.transfer.PointLocator(MESHES["disk"]).locate(
            np.array([[0.5, 0.5], [np.nan, 0]])
        ),
        "must be finite; point 1",
    ),
    (
        lambda: am.transfer.PointLocator(
            bare([[0, 0], [1, 0], [0, 1], [2, 0]], [[0, 1, 2], [0, 1, 3]])
        ),
        "element 1 has no volume",
    ),
    (lambda: am.transfer.PointLocator(bare([[0, 0]], np.zeros((0, 3)))), "no elements"),
    (
        lambda: am.transfer.PointLocator(two_boxes(3, 2), body=2),
        "body 2 of the mesh has no elements",
    ),
)


def test_mesh_ratio_of_uniform_meshes_and_at_a_local_jump():
    for make, n, m, dim in ((structured, 2, 4, 2), (structured, 4, 2, 3), (two_boxes, 2, 6, 2)):
        assert am.transfer.mesh_ratio(make(n, dim), make(m, dim)) == pytest.approx(m / n, abs=1e-12)
    coarse, fine = structured(8, 2), log_graded(3000, 4)
    assert am.transfer.mesh_ratio(coarse, fine) > 200
    # the hundredth that differs most is left out
    assert 100 < am.transfer.size_ratio(coarse, fine) < 0.9 * am.transfer.mesh_ratio(coarse, fine)
