"""Mortar coupling in 2D, of flat and of curved surfaces, and node-to-node coupling; refusals."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mortar import mortar, node_normals, node_to_node
from refused import check_refused, refused

import adaptmg as am
from adaptmg.discrete import mortar as coupling_module
from adaptmg.discrete import mortar_parts as module
from adaptmg.discrete.mortar import NEVER_FACING

SEEDS = st.integers(min_value=0, max_value=2**32 - 1)


def two(slave, master, *, closed=False, seed=None):
    """Points, slave facets, master facets and normals of two chains of points (n, 2), each outward
    on its right."""
    points, facets, start = np.concatenate([slave, master]), [], 0
    for chain in (slave, master):
        i = np.arange(start, start + len(chain))
        facets.append(np.column_stack([i, np.roll(i, -1)])[: None if closed else -1])
        start += len(chain)
    if seed is not None:
        facets = [np.random.default_rng(seed).permutation(one) for one in facets]
    return points, *facets, node_normals(points, facets[0])


def line(x, y=0.0, *, up=False):
    """Points (x, y) in the order in which the outward side is below (``up``: above)."""
    chain = np.column_stack([x, np.broadcast_to(y, np.shape(x))])
    return chain[::-1] if up else chain


def random_line(rng, n, lower=0.0, upper=1.0):
    return np.r_[
        lower,
        np.sort(lower + (upper - lower) * (np.arange(1, n) + 0.9 * (rng.random(n - 1) - 0.5)) / n),
        upper,
    ]


def arc(radius, angles, centre=(0.0, 0.0)):
    return np.column_stack(
        [centre[0] + radius * np.cos(angles), centre[1] + radius * np.sin(angles)]
    )


def assert_same(one, other):
    np.testing.assert_array_equal(one.nodes, other.nodes)
    np.testing.assert_allclose(one.weights, other.weights, rtol=1e-12)
    np.testing.assert_allclose(one.gaps, other.gaps, atol=1e-11)
    assert abs(one.coupling - other.coupling).max() < 1e-10


def moved(points, angle, shift):
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]]) + shift


def covered_parts(slave, master, min_coverage=1e-6):
    """Covered intervals of the edges of a flat slave surface, but those that are covered too
    little."""
    low, high = np.maximum(slave[:-1], master[0]), np.minimum(slave[1:], master[-1])
    enough = high - low >= min_coverage * np.diff(slave)
    return np.column_stack([low, high])[enough]


def flat(rng, *, overhang):
    """Positions along a flat interface of slave and master nodes: nothing in common."""
    xm = random_line(rng, rng.integers(1, 9))
    ends = (-rng.random(), 1 + rng.random()) if overhang else (0.0, 1.0)
    return random_line(rng, rng.integers(1, 9), *ends), xm


@settings(max_examples=50, deadline=None)
@given(
    seed=SEEDS,
    overhang=st.booleans(),
    excluded=st.sampled_from([0.0, 0.4]),
    gap=st.sampled_from([None, 0.0, 0.3, -0.05]),
)
def test_flat_surfaces_pass_the_patch_test(seed, overhang, excluded, gap):
    """Along a line in any direction, in axisymmetry (``gap`` is None) from the axis; some nodes
    are excluded."""
    rng, axisymmetric = np.random.default_rng(seed), gap is None
    xs, xm = flat(rng, overhang=overhang and not axisymmetric)
    out = np.flatnonzero(rng.random(len(xs)) < excluded)
    carries = ~np.isin(np.arange(len(xs)), out)
    points, slave, master, _ = two(line(xs, gap or 0.0), line(xm, up=True), seed=seed)
    angle, shift = (
        (rng.uniform(-1.2, 1.2), 0.0)
        if axisymmetric
        else (rng.uniform(0, 6), rng.uniform(-3, 3, 2))
    )
    points = moved(points, angle, shift)
    data = points, slave, master, node_normals(points, slave)
    parts = covered_parts(xs, xm)
    kept = [p for p in parts if carries[(k := np.searchsorted(xs, p.mean())) - 1] or carries[k]]
    if not kept:
        with pytest.raises(ValueError, match="excluded"):
            mortar(*data, excluded=out, axisymmetric=axisymmetric)
        return
    found = mortar(*data, excluded=out, axisymmetric=axisymmetric)
    assert (
        not np.isin(found.nodes, out).any()
        and not found.coupling[:, np.unique(slave)[carries]].count_nonzero()
    )
    # nodal forces of a uniform pressure: equal and opposite, with the same moments; where all
    # is covered consistent
    forces = -found.coupling.T @ found.weights
    forces[found.nodes] += found.weights
    measure = (
        (lambda a, b: np.pi * np.cos(angle) * (b**2 - a**2))
        if axisymmetric
        else (lambda a, b: b - a)
    )
    covered = sum(measure(*part) for part in parts)  # edges without a multiplier too
    assert (
        forces[: len(xs)].sum() == pytest.approx(covered) == pytest.approx(-forces[len(xs) :].sum())
    )
    np.testing.assert_allclose(forces @ np.r_[xs, xm[::-1]], 0, atol=1e-12)
    if not overhang and not len(out):
        for nodes, sign, facets in (
            (slice(0, len(xs)), 1, slave),
            (slice(len(xs), None), -1, master),
        ):
            consistent = am.mesh.Surface(points, facets).lumped(axisymmetric)
            np.testing.assert_allclose(sign * forces[nodes], consistent[nodes], atol=1e-12)
    # linear fields, thus rigid motions, and the gap of a parallel offset, of all nodes that are
    # followed
    scale = 1e-12 * np.abs(found.coupling.data).max() + 1e-13 / np.min(
        np.diff(parts) / np.diff(xs).max()
    )
    followed = 1 - found.coupling[:, out].sum(axis=1)
    np.testing.assert_allclose(found.coupling.sum(axis=1), 1, atol=scale)
    opposite = points[found.nodes] + (gap or 0.0) * followed[:, None] * found.normals
    np.testing.assert_allclose(found.coupling @ points, opposite, atol=4 * scale)
    np.testing.assert_allclose(found.gaps, (gap or 0.0) * followed, atol=4 * scale)


@pytest.mark.parametrize(("covered", "first"), [(0.95e-6, 1), (1.05e-6, 0)])
def test_less_coverage_is_dropped(covered, first):
    xs, xm = np.linspace(0, 1, 6), np.array([0.2 * (1 - covered), 0.5, 1.0])
    np.testing.assert_array_equal(
        mortar(*two(line(xs), line(xm, up=True))).nodes, np.arange(first, 6)
    )


@pytest.mark.parametrize("lean", [1e-7, 1e-5, 5e-3])
def test_walls_that_lean_by_the_digits_of_a_file_have_no_gaps(lean):
    wall = np.array([[0.5 + 0.5 * lean, -0.5], [0.5, 0.0], [0.0, 0.0]])
    slave, master = (moved(x, 0.7, (1.0, 2.0)) for x in (line(np.linspace(0, 1, 6)), wall))
    found = mortar(*two(slave, master))
    np.testing.assert_array_equal(found.nodes, range(4))
    np.testing.assert_allclose(found.gaps, 0.0, atol=1e-12)


def test_a_hole_in_the_master_surface():
    xs, left, right = (
        np.linspace(0, 1, 4),
        np.array([0.0, 0.21, 0.4]),
        np.array([0.55, 0.8, 1.0]),
    )
    points, slave, master, normals = two(line(xs), line(np.r_[left, right], up=True))
    master = master[master[:, 0] != 6]  # the edge across the hole
    found = mortar(points, slave, master, normals)
    forces = (found.coupling.T @ found.weights)[4:]
    np.testing.assert_allclose(
        forces, am.mesh.Surface(points, master).lumped(False)[4:], atol=1e-13
    )


DATA = POINTS, SLAVE, MASTER, NORMALS = two(
    line(np.linspace(0, 1, 4), 0.1), line(np.linspace(0, 1, 3), up=True)
)
DEEP = two(line(np.linspace(0, 1, 4), -0.5), line(np.linspace(0, 1, 3), up=True))
CUP, BAR = arc(1.0, np.linspace(-0.25 * np.pi, -0.75 * np.pi, 12)), np.array([-0.3, 0.3])


def test_heights_of_chords_of_a_circle():
    """Of a closed polygon of n sides in a circle: radius times 1 - cos(pi / n)."""
    radius, n = 3.0, 40
    points, facets, *_ = two(*2 * [arc(radius, 2 * np.pi * np.arange(n) / n)], closed=True)
    heights, lengths = coupling_module.chord_heights(am.mesh.Surface(points, facets))
    np.testing.assert_allclose(heights, radius * (1 - np.cos(np.pi / n)), rtol=1e-2)
    np.testing.assert_allclose(lengths, 2 * radius * np.sin(np.pi / n))


def test_reach_and_depth():
    assert len(mortar(*DATA, reach=0.11)) == 4 and len(mortar(*two(CUP, line(BAR, -0.5))))
    np.testing.assert_allclose(mortar(*DEEP, reach=0.6).gaps, -0.5)


test_refused = refused(
    (
        lambda: mortar(POINTS, SLAVE[:, ::-1], MASTER, NORMALS),
        r"point out of the slave body; that of node 1 .* Rev",
    ),
    (lambda: mortar(POINTS, SLAVE, MASTER[:, ::-1], NORMALS), NEVER_FACING),
    (
        lambda: mortar(POINTS, SLAVE[:, ::-1], MASTER, node_normals(POINTS, SLAVE[:, ::-1])),
        NEVER_FACING,
    ),
    (lambda: mortar(*DATA, reach=0.05), f"^{NEVER_FACING} within a reach of 0.05 m"),
    (lambda: mortar(*DEEP), NEVER_FACING),
    # beyond the centre of curvature
    (lambda: mortar(*two(CUP, line(BAR, 0.5))), NEVER_FACING),
    (lambda: mortar(POINTS, SLAVE, SLAVE[:, ::-1], NORMALS), "one of the master too"),
    (
        lambda: mortar(*two(line(np.linspace(0, 1, 6)), line([0.2, 0.2 + 1e-7], up=True))),
        "on a sliver of each facet",
    ),
    (lambda: mortar(*DATA, excluded=range(4)), "every node of the slave surface is excluded"),
    (
        lambda: mortar(*two(line([0.0, 1.0, 2.0]), line([0.0, 1.0], up=True)), excluded=(0, 1)),
        "only where slave nodes are excluded",
    ),
)


@pytest.mark.parametrize(
    ("points", "facets", "normals"),
    [
        (
            [[0.0, 3.0], [0.0, 0.0], [1.0, 0.0], [5.0, 5.0]],
            [[0, 1], [1, 2]],
            [[-1, 0], [-3, -1], [0, -1], [0, 0]],
        ),
        (
            [[0, 0, 0], [0, 2, 0], [4, 0, 0], [0, 0, 1.0]],
            [[0, 1, 2], [0, 3, 1]],
            [[-1, 0, -4], [-1, 0, -4], [0, 0, -1], [-1, 0, 0]],
        ),
    ],
    ids=["lengths", "areas"],
)
def test_normals_are_weighted_by_measures(points, facets, normals):
    size = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1)
    np.testing.assert_allclose(
        node_normals(np.array(points), np.array(facets)), normals / size, atol=1e-15
    )


def errors_on_a_plane(n):
    angles = np.linspace(1.25 * np.pi, 1.75 * np.pi, n + 1)
    data = two(arc(1.0, angles, (0.0, 1.0)), line(np.linspace(-2, 2, 3), up=True))
    found = mortar(*data)
    x = data[0][found.nodes]
    return np.abs(found.gaps - x[:, 1] / (1 - x[:, 1]))[1:-1].max()


def errors_of_rings(n):
    """A shaft in a hole, gap 0.05: largest error of gap and of the nodes opposite."""
    data = two(
        arc(1.0, np.arange(n) * 2 * np.pi / n),
        arc(1.05, -np.arange(n + n // 3) * 2 * np.pi / (n + n // 3)),
        closed=True,
    )
    found = mortar(*data)
    assert len(found) == n
    opposite = found.coupling @ data[0]
    return np.array(
        [
            np.abs(found.gaps - 0.05).max(),
            np.linalg.norm(opposite - 1.05 * data[0][:n], axis=1).max(),
        ]
    )


@pytest.mark.parametrize("errors", [errors_on_a_plane, errors_of_rings])
def test_gaps_of_curved_surfaces_are_of_second_order(errors):
    coarse, fine, finer = (errors(n) for n in (48, 96, 192))
    assert (coarse > 3.3 * fine).all() and (fine > 3.6 * finer).all() and (finer < 1e-4).all()


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_the_nearest_surface_counts(order):
    # floors at -0.5 and 0 and a step at 0.1, numbered in any order, below a slave surface at
    # 0.2
    steps = np.array([[1.0, -0.5], [0.0, -0.5], [1.0, 0.0], [0.0, 0.0], [0.6, 0.1], [0.4, 0.1]])
    points, slave, _, normals = two(line(np.linspace(0, 1, 6), 0.2), steps)
    master = np.array([[6, 7], [8, 9], [10, 11]])[list(order)]
    found = mortar(points, slave, master, normals)
    np.testing.assert_allclose(found.gaps, [0.2, 0.2, 0.15, 0.15, 0.2, 0.2], atol=1e-14)
    assert not found.coupling[:, [6, 7]].count_nonzero()
    # 0.02 below the top of the step overlap is nearer than the floor, 0.02 above the floor it
    # is not
    for height, gap in ((0.08, (0.08 - 0.02) / 2), (0.02, 0.02)):
        points[:6, 1] = height
        np.testing.assert_allclose(
            mortar(points, slave, master, normals).gaps[2:4], gap, atol=1e-14
        )


def test_distances_are_along_the_unit_normals():
    points, tilt = (
        np.array([[0.0, 1.0], [1.0, 1.0], [3.0, 0.0], [-2.0, 0.0]]),
        np.array([-0.6, 0.4]),
    )
    normals = np.zeros((4, 2))
    normals[:2] = np.column_stack([np.sin(tilt), -np.cos(tilt)])
    found = mortar(points, np.array([[0, 1]]), np.array([[2, 3]]), normals)
    s = (np.arange(2000)[:, None] + 0.5) / 2000
    rays = (1 - s) * normals[0] + s * normals[1]
    ahead = rays / -rays[:, 1:]
    assert found.weights @ found.gaps == pytest.approx(
        np.linalg.norm(ahead, axis=1).mean(), rel=1e-5
    )
    assert found.weights @ (found.coupling @ points)[:, 0] == pytest.approx(
        (s + ahead)[:, 0].mean(), rel=1e-5
    )


@settings(max_examples=25, deadline=None)
@given(seed=SEEDS)
def test_the_search_misses_nothing(seed):
    rng = np.random.default_rng(seed)
    t, s = (
        random_line(rng, rng.integers(2, 25)),
        random_line(rng, rng.integers(2, 25), -0.3, 1.2),
    )
    lift = rng.uniform(-0.1, 0.4)
    data = two(
        line(t, lift + 0.1 * np.sin(9 * t + lift)),
        line(s, 0.1 * np.cos(7 * s), up=True),
        seed=seed,
    )

    def everything(surfaces, backward, forward):
        i, j = np.indices((len(surfaces.slave), len(surfaces.master)))
        return i.ravel(), j.ravel()

    reach = [None, 0.05, 3.0][seed % 3]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_edges_near", everything)
        try:
            expected = mortar(*data, reach=reach)
        except ValueError:
            expected = None
    if expected is None:
        with pytest.raises(ValueError, match="surfaces"):
            mortar(*data, reach=reach)
        return
    assert_same(mortar(*data, reach=reach), expected)


# -- node to node (in space: test_mortar_3d) -----------------------------------------------------------------------


def lines(x, gap, seed=None):
    """A slave line above a master line with the same positions: node i of n faces node 2 n - 1 -
    i."""
    return two(line(x, gap), line(x, up=True), seed=seed)


@pytest.mark.parametrize("gap", [0.0, 0.4, -0.1])
@pytest.mark.parametrize("axisymmetric", [False, True])
def test_matching_lines(gap, axisymmetric):
    data = lines(np.array([0.0, 0.1, 0.3, 0.7, 1.0]), gap, seed=1)
    found, dual = (couple(*data, axisymmetric=axisymmetric) for couple in (node_to_node, mortar))
    np.testing.assert_array_equal(found.coupling.indices, 9 - np.arange(5))
    np.testing.assert_array_equal(found.coupling.data, 1.0)
    np.testing.assert_allclose(found.gaps, gap)
    np.testing.assert_allclose(found.weights, dual.weights)
    assert abs(found.coupling - dual.coupling).max() < 1e-12 and dual.coupling.nnz == 5
    np.testing.assert_array_equal(dual.nodes, np.arange(5))


def test_excluded_nodes_have_no_row():
    found = node_to_node(*lines(np.linspace(0, 1, 5), 0.0), excluded=(0, 3))
    np.testing.assert_array_equal(found.nodes, [1, 2, 4])
    np.testing.assert_allclose(found.weights, [0.25, 0.25, 0.125])


def test_refusals():
    points, slave, master, normals = lines(np.linspace(0, 1, 5), 0.1)
    moved = points.copy()
    moved[6:8, 0] += 0.02
    turned = np.where((master == 5).any(axis=1, keepdims=True), master[:, ::-1], master)
    check_refused(
        (
            lambda: node_to_node(moved, slave, master, normals),
            r"slave node 2 \(0\.5, 0\.1\) has no partner: .* lies 0\.02 m off its "
            r"normal, 0\.0025 m are allowed \(2 such nodes of 5\)",
        ),
        (lambda: node_to_node(points, slave, master[:, ::-1], normals), f"^{NEVER_FACING}"),
        (
            lambda: node_to_node(points, slave, turned, normals),
            r"slave node 3 .* and faces the same way",
        ),
        (
            lambda: node_to_node(points, slave, master[:-1], normals),
            r"slave node 0 .* has no partner",
        ),
    )
