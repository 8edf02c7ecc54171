"""Mortar coupling in 3D: consistency, patch test, gaps, visibility; and the polygon kernels below
it."""

import numpy as np
import pytest
from mortar import mortar, node_normals, node_to_node
from refused import refused
from scipy.spatial import ConvexHull, Delaunay
from scipy.spatial.transform import Rotation

import adaptmg as am
from adaptmg.discrete.mortar import NEVER_FACING

DOWN, UP = False, True


def square(n, seed, *, up, low=(0.0, 0.0), high=(1.0, 1.0), z=0.0):
    """Random triangulation of a rectangle: points (m, 3) and facets whose normals point along +z or
    -z."""
    rng = np.random.default_rng(seed)
    side = np.linspace(0, 1, int(np.sqrt(n)) + 1)[:-1]
    edges = [
        np.column_stack(c)
        for c in (
            (side, 0 * side),
            (0 * side + 1, side),
            (1 - side, 0 * side + 1),
            (0 * side, 1 - side),
        )
    ]
    plane = np.array(low) + np.concatenate([rng.random((n, 2)), *edges]) * (np.array(high) - low)
    facets = Delaunay(plane).simplices
    corners = plane[facets]
    double = np.linalg.det(corners[:, 1:] - corners[:, :1])
    facets, double = facets[np.abs(double) > 1e-12], double[np.abs(double) > 1e-12]
    facets = np.where((double > 0)[:, None] == up, facets, facets[:, ::-1])
    return np.column_stack([plane, np.full(len(plane), z)]), facets


def joined(slave, *masters):
    """Points of all, slave facets, master facets."""
    surfaces = (slave, *masters)
    first = np.cumsum([0, *(len(points) for points, _ in surfaces)])
    facets = [facets + offset for (_, facets), offset in zip(surfaces, first, strict=False)]
    return np.concatenate([points for points, _ in surfaces]), facets[0], np.concatenate(facets[1:])


def couple(points, slave, master, **options):
    return mortar(points, slave, master, node_normals(points, slave), **options)


def lumped(points, facets):
    """Integral of each shape function over a surface."""
    areas = am.mesh.Surface(points, facets).measures
    return np.bincount(facets.ravel(), np.repeat(areas / 3, 3), minlength=len(points))


def total(interface):
    """M'1: what a unit pressure on the slave gives on the master (and takes from nodes that are
    followed)."""
    return interface.coupling.T @ interface.weights


def rigid(points, seed):
    return points @ Rotation.random(random_state=seed).as_matrix().T + [0.3, -2.0, 1.0]


@pytest.mark.parametrize("kind", [mortar, node_to_node])
def test_matching_meshes_give_the_identity(kind):
    top = square(80, 0, up=DOWN, z=0.1)
    points, slave, master = joined(top, (top[0] - [0, 0, 0.1], top[1][:, ::-1]))
    points = rigid(points, 0)
    interface = kind(points, slave, master, node_normals(points, slave))
    n = len(top[0])
    np.testing.assert_array_equal(interface.nodes, np.arange(n))
    np.testing.assert_allclose(interface.coupling[:, n:].toarray(), np.eye(n), atol=1e-12)
    assert interface.coupling.nnz == n
    np.testing.assert_allclose(interface.gaps, 0.1, rtol=1e-12)
    np.testing.assert_allclose(interface.weights, lumped(points, slave)[:n], rtol=1e-12)
    np.testing.assert_allclose(interface.normals, np.tile(interface.normals[0], (n, 1)), atol=1e-14)


# the slave covers the same, a smaller or a larger rectangle than the master, or one that sticks out
# at two sides
RECTANGLES = [
    ((0, 0), (1, 1)),
    ((0.1, 0.2), (0.7, 0.9)),
    ((-0.3, -0.2), (1.4, 1.1)),
    ((0.35, -0.4), (1.5, 0.8)),
]


@pytest.mark.parametrize("sizes", [(40, 70), (200, 40)])
@pytest.mark.parametrize(("low", "high"), RECTANGLES)
def test_flat_interfaces_pass_the_patch_test(low, high, sizes):
    flat, slave, master = joined(
        square(sizes[0], 1, up=DOWN, low=low, high=high, z=0.2), square(sizes[1], 2, up=UP)
    )
    points = rigid(flat, 5)
    interface = couple(points, slave, master)
    assert np.abs(interface.coupling.sum(axis=1) - 1).max() < 1e-12
    # linear fields are reproduced: the opposite point of a slave node is its projection, also
    # outside the master
    np.testing.assert_allclose(
        (interface.coupling @ flat)[:, :2], flat[interface.nodes, :2], atol=1e-12
    )
    np.testing.assert_allclose(interface.gaps, 0.2, rtol=1e-12)
    covered = np.prod(np.minimum(high, 1.0) - np.maximum(low, 0.0))
    assert interface.weights.sum() == pytest.approx(covered, rel=1e-12) == total(interface).sum()
    # forces on the master: resultant, moments, and each one where the slave covers all that touches
    # the node
    forces, middle = (
        total(interface),
        np.mean([np.minimum(high, 1.0), np.maximum(low, 0.0)], axis=0),
    )
    np.testing.assert_allclose(forces @ flat[:, :2], covered * middle, atol=1e-12)
    within = ((flat[:, :2] >= low) & (flat[:, :2] <= high)).all(axis=1)
    alone = np.setdiff1d(
        np.unique(master[within[master].all(axis=1)]), master[~within[master].all(axis=1)]
    )
    assert len(alone) >= 3
    np.testing.assert_allclose(forces[alone], lumped(flat, master)[alone], atol=1e-12)


@pytest.mark.parametrize("count", [1, 3, 25])
def test_excluded_nodes_are_followed(count):
    flat, slave, master = joined(square(50, 1, up=DOWN, z=0.2), square(70, 2, up=UP))
    n = slave.max() + 1
    excluded = np.random.default_rng(count).choice(n, count, replace=False)
    points = rigid(flat, 1)
    interface = couple(points, slave, master, excluded=[*excluded, len(points) - 1])
    assert not np.isin(interface.nodes, excluded).any()
    columns = np.unique(interface.coupling.nonzero()[1])
    assert np.isin(columns, np.r_[excluded, np.arange(n, len(points))]).all()
    assert np.abs(interface.coupling.sum(axis=1) - 1).max() < 1e-12
    np.testing.assert_allclose(
        (interface.coupling @ flat)[:, :2], flat[interface.nodes, :2], atol=1e-12
    )
    # a unit pressure, on facets without a multiplier too: the forces on both sides have the same
    # sum and moment
    forces = total(interface)
    on_slave = lumped(points, slave)
    np.testing.assert_allclose(interface.weights, on_slave[interface.nodes], rtol=1e-12)
    np.testing.assert_allclose(-forces[excluded], on_slave[excluded], atol=1e-12)
    assert forces[n:].sum() == pytest.approx(on_slave.sum(), rel=1e-12)
    np.testing.assert_allclose(forces[n:] @ flat[n:, :2], on_slave @ flat[:, :2], rtol=1e-11)
    # gap of u_a + sum_b D_ab/D_aa u_b
    followed = -interface.coupling[:, excluded].sum(axis=1)
    np.testing.assert_allclose(interface.gaps, 0.2 * (1 + followed), rtol=1e-11)


def test_a_plane_gap_is_exact_at_the_nodes():
    flat, slave, master = joined(
        square(60, 3, up=DOWN), square(60, 4, up=UP, low=(-0.2, -0.2), high=(0.8, 1.3))
    )
    points = flat.copy()
    height = -0.2 + 0.3 * flat[:, 0] - 0.1 * flat[:, 1]
    points[slave.max() + 1 :, 2] = height[slave.max() + 1 :]
    interface = couple(rigid(points, 2), slave, master)
    np.testing.assert_allclose(interface.gaps, -height[interface.nodes], atol=1e-12)


def ball(n, radius, turn=0.0):
    i = np.arange(n) + 0.5
    polar, around = np.arccos(1 - 2 * i / n), np.pi * (1 + np.sqrt(5)) * i + turn
    points = np.column_stack(
        [np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)]
    )
    facets = ConvexHull(points).simplices
    inward = np.linalg.det(points[facets]) < 0
    return radius * points, np.where(inward[:, None], facets[:, ::-1], facets)


def test_closed_surfaces_are_covered_on_every_side():
    inner, outer = ball(400, 1.0), ball(600, 1.05, 1.0)
    outer = outer[0], outer[1][:, ::-1]
    for slave, master, sign in (
        (inner, outer, 1),
        (outer, inner, 1),
        (inner, (0.9 * outer[0], outer[1]), -1),
    ):
        points, first, second = joined(slave, master)
        interface = couple(points, first, second)
        assert len(interface) == len(slave[0])
        assert interface.weights.sum() == pytest.approx(
            am.mesh.Surface(points, first).measures.sum()
        )
        assert (sign * interface.gaps > 0).all()
        np.testing.assert_allclose(interface.gaps, 0.05 if sign > 0 else -0.055, atol=0.02)


def test_any_soup_of_masters_is_sorted_by_sight():
    """Random triangles over one slave triangle: area and mean gap are those of the nearest,
    sampled."""
    rng = np.random.default_rng(3)
    slave = np.array([[0.0, 0, 0], [0, 1, 0], [1, 0, 0]])
    bary = np.array([(i, j, 119 - i - j) for i in range(120) for j in range(120 - i)]) / 119
    at = (0.98 * bary + 0.02 / 3) @ slave[[0, 2, 1], :2]
    for _ in range(20):
        k = rng.integers(1, 12)
        corners = np.concatenate(
            [rng.uniform(-0.4, 1.2, (k, 3, 2)), rng.uniform(-0.3, -0.1, (k, 3, 1))], axis=2
        )
        vectors = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        corners[vectors[:, 2] < 0] = corners[vectors[:, 2] < 0][:, ::-1]
        points = np.concatenate([slave, corners.reshape(-1, 3)])
        nearest = np.full(len(at), np.inf)
        for a, b, c in corners:
            weights = np.linalg.solve(np.column_stack([b - a, c - a])[:2], (at - a[:2]).T).T
            inside = (weights >= 0).all(axis=1) & (weights.sum(axis=1) <= 1)
            height = a[2] + weights @ np.array([b[2] - a[2], c[2] - a[2]])
            nearest[inside] = np.minimum(nearest[inside], -height[inside])
        seen = np.isfinite(nearest)
        # the normal of the slave is -z: height 0 looking down on the masters
        interface = couple(points, np.array([[0, 1, 2]]), 3 + np.arange(3 * k).reshape(k, 3))
        assert interface.weights.sum() == pytest.approx(0.5 * seen.mean(), abs=0.01)
        assert interface.weights @ interface.gaps == pytest.approx(
            0.5 * np.where(seen, nearest, 0).mean(), abs=0.005
        )


def facing(height, reach=None, turn=1):
    """A surface and a parallel one, whose facets may be turned."""
    points, slave, master = joined(square(30, 1, up=DOWN), square(30, 2, up=UP, z=height))
    return couple(points, slave, master[:, ::turn], reach=reach)


# overlap is found too, but not as deep as gaps are wide
@pytest.mark.parametrize(("height", "reach"), [(-0.2, 0.21), (0.2, None), (0.8, 1.0)])
def test_reach_and_depth(height, reach):
    assert facing(height, reach).gaps == pytest.approx(-height)


def inward():
    points, slave, master = joined(square(10, 1, up=DOWN, z=0.1), square(10, 2, up=UP))
    return mortar(points, slave, master, -node_normals(points, slave))


test_refused = refused(
    (lambda: facing(-0.2, 0.19), NEVER_FACING),
    (lambda: facing(0.8), NEVER_FACING),
    (lambda: facing(-0.2, turn=-1), NEVER_FACING),
    (inward, "normals must point out"),
    (
        lambda: couple(
            *joined(square(9, 1, up=DOWN, low=(5, 0), high=(6, 1)), square(9, 2, up=UP, z=-0.1))
        ),
        NEVER_FACING,
    ),
)


def test_a_narrow_strip_of_coverage_is_stable():
    flat, slave, master = joined(
        square(30, 7, up=DOWN, z=0.1), square(30, 8, up=UP, low=(-1, -0.1), high=(1e-6, 1.1))
    )
    interface = couple(rigid(flat, 3), slave, master)
    np.testing.assert_allclose(
        (interface.coupling @ flat)[:, :2], flat[interface.nodes, :2], atol=1e-10
    )
    np.testing.assert_allclose(interface.gaps, 0.1, atol=1e-10)
    assert interface.weights.sum() == pytest.approx(1e-6, rel=1e-2)


def overhanging(lean: float) -> float:
    """Return the largest displacement of a block that overhangs another one, whose wall belongs to
    its contact boundary and leans outwards."""
    upper = am.Polygon(
        vertices=((0, 0), (1, 0), (1, 0.5), (0, 0.5)), boundaries=("under", "right", "head", "left")
    )
    lower = am.Polygon(
        vertices=((0, -0.5), (0.6 + 0.5 * lean, -0.5), (0.6, 0), (0, 0)),
        boundaries=("foot", "contact", "contact", "left"),
    )
    parts = {"upper": am.Extrusion(upper, 0.5), "lower": am.Extrusion(lower, 0.5)}
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        material=am.Solid(young=2e11, poisson=0.3),
        contact=am.ContactPair("upper.under", "lower.contact"),
        law=am.Coulomb(0.3),
        loads=am.Pressure("upper.head", 1e7),
        supports=(am.Support("lower.foot", x=0, y=0, z=0), am.Support("upper.left", x=0)),
    )
    return np.abs(am.solve(am.Hierarchy.graded(problem, (0.25, 0.14))).displacement).max()


def test_walls_that_lean_by_the_digits_of_a_file_change_nothing():
    assert overhanging(1e-5) == pytest.approx(overhanging(0.0), rel=1e-3)
