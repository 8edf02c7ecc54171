"""Mortar coupling in 2D: patch tests, reproduction of linear fields, gaps, partial coverage, crosspoints, refusals."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mortar import mortar_2d
from uncompiled import uncompile

from adaptmg.discrete.mortar import segments as module
from adaptmg.discrete.mortar.interface import NEVER_FACING, surface_normals
from adaptmg.geometry import search

SEEDS = st.integers(min_value=0, max_value=2**32 - 1)


def two(slave, master, *, closed=False, seed=None):
    """Points, slave facets, master facets and normals of two chains of points (n, 2), each outward on its right."""
    points, facets, start = np.concatenate([slave, master]), [], 0
    for chain in (slave, master):
        i = np.arange(start, start + len(chain))
        facets.append(np.column_stack([i, np.roll(i, -1)])[:None if closed else -1])
        start += len(chain)
    if seed is not None:
        facets = [np.random.default_rng(seed).permutation(one) for one in facets]
    return points, *facets, surface_normals(points, facets[0])


def line(x, y=0.0, *, up=False):
    """Points (x, y) in the order in which the outward side is below (``up``: above)."""
    chain = np.column_stack([x, np.broadcast_to(y, np.shape(x))])
    return chain[::-1] if up else chain


def random_line(rng, n, lower=0.0, upper=1.0):
    return np.r_[lower, np.sort(lower + (upper - lower) * (np.arange(1, n) + 0.9 * (rng.random(n - 1) - 0.5)) / n),
                 upper]


def arc(radius, angles, centre=(0.0, 0.0)):
    return np.column_stack([centre[0] + radius * np.cos(angles), centre[1] + radius * np.sin(angles)])


def assert_same(one, other):
    np.testing.assert_array_equal(one.nodes, other.nodes)
    np.testing.assert_allclose(one.weights, other.weights, rtol=1e-12)
    np.testing.assert_allclose(one.gaps, other.gaps, atol=1e-11)
    assert abs(one.coupling - other.coupling).max() < 1e-10


def moved(points, angle, shift):
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s], [-s, c]]) + shift


def hats_over(nodes, parts, weight=lambda x: 1.0):
    """Integrals of the hat functions on sorted ``nodes`` times a linear weight over intervals: Simpson's rule."""
    total = np.zeros(len(nodes))
    for low, high in parts:
        cuts = np.unique(np.clip(np.r_[nodes, low, high], low, high))
        for a, b in pairwise(cuts):
            for x, w in ((a, 1 / 6), ((a + b) / 2, 2 / 3), (b, 1 / 6)):
                k = np.clip(np.searchsorted(nodes, (a + b) / 2) - 1, 0, len(nodes) - 2)
                share = (x - nodes[k]) / (nodes[k + 1] - nodes[k])
                total[[k, k + 1]] += w * (b - a) * weight(x) * np.array([1 - share, share])
    return total


def covered_parts(slave, master, min_coverage=1e-3):
    """Covered intervals of the edges of a flat slave surface, but those that are covered too little."""
    low, high = np.maximum(slave[:-1], master[0]), np.minimum(slave[1:], master[-1])
    enough = high - low >= min_coverage * np.diff(slave)
    return np.column_stack([low, high])[enough]


def flat(rng, *, overhang):
    """Positions along a flat interface of slave and master nodes: nothing in common."""
    xm = random_line(rng, rng.integers(1, 9))
    ends = (-rng.random(), 1 + rng.random()) if overhang else (0.0, 1.0)
    return random_line(rng, rng.integers(1, 9), *ends), xm


class TestFlat:
    @settings(max_examples=60, deadline=None)
    @given(seed=SEEDS, overhang=st.booleans(), gap=st.sampled_from([0.0, 0.3, -0.05]))
    def test_patch(self, seed, overhang, gap):
        rng = np.random.default_rng(seed)
        xs, xm = flat(rng, overhang=overhang)
        points, slave, master, _ = two(line(xs, gap), line(xm, up=True), seed=seed)
        points = moved(points, rng.uniform(0, 6), rng.uniform(-3, 3, 2))
        normals = surface_normals(points, slave)
        found = mortar_2d(points, slave, master, normals)
        parts = covered_parts(xs, xm)
        # nodal forces of a uniform pressure on either side are the consistent ones, hence equal in sum
        np.testing.assert_allclose((found.coupling.T @ found.weights)[len(xs):][::-1], hats_over(xm, parts), atol=1e-12)
        forces = np.zeros(len(xs))
        forces[found.nodes] = found.weights
        np.testing.assert_allclose(forces, hats_over(xs, parts), atol=1e-12)
        # linear fields, thus rigid motions, and the gap of a parallel offset
        conditioning = 1 / np.min(np.diff(parts) / np.diff(xs).max())
        opposite = points[found.nodes] + gap * found.normals
        np.testing.assert_allclose(found.coupling @ points, opposite, atol=1e-13 * conditioning + 1e-12)
        np.testing.assert_allclose(found.gaps, gap, atol=1e-13 * conditioning + 1e-12)
        np.testing.assert_allclose(found.coupling.sum(axis=1), 1, atol=1e-14 * conditioning + 1e-13)
        assert not found.coupling[:, slave.ravel()].count_nonzero()

    @pytest.mark.parametrize("covered", [1.01e-3, 1e-2, 0.5])
    @pytest.mark.parametrize("axisymmetric", [False, True])
    def test_small_coverage_stays_stable(self, covered, axisymmetric):
        xs, xm = np.linspace(0, 1, 6), np.r_[0.2 * (1 - covered), 0.3, 0.55, 0.8 + 0.2 * covered]
        found = mortar_2d(*two(line(xs), line(xm, up=True)), axisymmetric=axisymmetric)
        weight = (lambda x: 2 * np.pi * x) if axisymmetric else (lambda x: 1.0)
        loads = hats_over(xm, covered_parts(xs, xm, 0.9 * covered), weight)
        np.testing.assert_allclose((found.coupling.T @ found.weights)[6:][::-1], loads, rtol=1e-11)
        np.testing.assert_allclose(found.coupling.sum(axis=1), 1, atol=1e-11)
        np.testing.assert_allclose((found.coupling @ np.r_[xs, xm[::-1]])[found.nodes > 0], xs[found.nodes > 0],
                                   atol=1e-11)
        np.testing.assert_array_equal(found.nodes, np.arange(6))
        assert np.abs(found.coupling.data).max() < 20 / covered

    def test_less_coverage_is_dropped(self):
        xs, xm = np.linspace(0, 1, 6), np.array([0.2 - 1.9e-4, 0.5, 1.0])
        np.testing.assert_array_equal(mortar_2d(*two(line(xs), line(xm, up=True))).nodes, np.arange(1, 6))
        with pytest.raises(ValueError, match="on a sliver of each edge"):
            mortar_2d(*two(line(xs), line([0.2, 0.2001], up=True)))

    def test_a_hole_in_the_master_surface(self):
        xs, left, right = np.linspace(0, 1, 4), np.array([0.0, 0.21, 0.4]), np.array([0.55, 0.8, 1.0])
        points, slave, master, normals = two(line(xs), line(np.r_[left, right], up=True))
        master = master[master[:, 0] != 6]  # the edge across the hole
        found = mortar_2d(points, slave, master, normals)
        forces = (found.coupling.T @ found.weights)[4:][::-1]
        np.testing.assert_allclose(forces[:3], hats_over(left, [(0.0, 0.4)]), atol=1e-13)
        np.testing.assert_allclose(forces[3:], hats_over(right, [(0.55, 1.0)]), atol=1e-13)


class TestCrosspoints:
    @settings(max_examples=40, deadline=None)
    @given(seed=SEEDS, overhang=st.booleans(), axisymmetric=st.booleans())
    def test_patch(self, seed, overhang, axisymmetric):
        rng = np.random.default_rng(seed)
        xs, xm = flat(rng, overhang=overhang and not axisymmetric)
        out = np.flatnonzero(rng.random(len(xs)) < 0.4)
        carries = ~np.isin(np.arange(len(xs)), out)
        points, slave, master, normals = two(line(xs), line(xm, up=True))
        parts = covered_parts(xs, xm)
        kept = [p for p in parts if carries[(k := np.searchsorted(xs, p.mean())) - 1] or carries[k]]
        if not kept:
            with pytest.raises(ValueError, match="excluded"):
                mortar_2d(points, slave, master, normals, excluded=out, axisymmetric=axisymmetric)
            return
        found = mortar_2d(points, slave, master, normals, excluded=out, axisymmetric=axisymmetric)
        assert not np.isin(found.nodes, out).any()
        weight = (lambda x: 2 * np.pi * x) if axisymmetric else (lambda x: 1.0)
        forces = -found.coupling.T @ found.weights
        forces[found.nodes] += found.weights
        np.testing.assert_allclose(-forces[len(xs):][::-1], hats_over(xm, kept, weight), atol=1e-12)
        np.testing.assert_allclose(forces[:len(xs)], hats_over(xs, kept, weight), atol=1e-12)
        scale = 1e-12 * np.abs(found.coupling.data).max()
        np.testing.assert_allclose(found.coupling.sum(axis=1), 1, atol=scale)
        np.testing.assert_allclose(found.coupling @ points, points[found.nodes], atol=2 * scale)

    def test_by_hand(self):
        # node 1 takes both halves of edges of length 1: D_11 = 1, D_10 = D_12 = 1/2
        found = mortar_2d(*two(line([0.0, 1.0, 2.0], 0.25), line([0.0, 2.0], up=True)), excluded=(0, 2, 4))
        np.testing.assert_allclose(found.coupling.toarray(), [[-0.5, 0.0, -0.5, 1.0, 1.0]], atol=1e-14)
        # the mean closure over the edges is half of that at node 1, as long as nodes 0 and 2 are held
        np.testing.assert_allclose(found.gaps, [0.5])
        np.testing.assert_allclose(found.weights, [1.0])

    def test_nothing_left(self):
        with pytest.raises(ValueError, match="every node of the slave surface is excluded"):
            mortar_2d(*two(line([0.0, 1.0]), line([0.0, 1.0], up=True)), excluded=range(2))
        with pytest.raises(ValueError, match="only where slave nodes are excluded"):
            mortar_2d(*two(line([0.0, 1.0, 2.0]), line([0.0, 1.0], up=True)), excluded=(0, 1))


class TestAxisymmetric:
    @settings(max_examples=30, deadline=None)
    @given(seed=SEEDS, slope=st.floats(min_value=-3, max_value=3))
    def test_weights_are_areas(self, seed, slope):
        rng = np.random.default_rng(seed)
        r, rm = (random_line(rng, n, 0.0, 2.0) for n in (7, 4))  # from the axis
        points, slave, master, normals = two(line(r, slope * r), line(rm, slope * rm, up=True), seed=seed)
        found = mortar_2d(points, slave, master, normals, axisymmetric=True)
        assert found.weights.sum() == pytest.approx(np.pi * 4 * np.hypot(1, slope), rel=1e-12)
        loads = 2 * np.pi * np.hypot(1, slope) * hats_over(rm, [(0.0, 2.0)], lambda x: x)
        np.testing.assert_allclose((found.coupling.T @ found.weights)[8:][::-1], loads, atol=1e-11)
        np.testing.assert_allclose(found.coupling @ points, points[found.nodes], atol=1e-11)

class TestRefusals:
    DATA = two(line(np.linspace(0, 1, 4), 0.1), line(np.linspace(0, 1, 3), up=True))

    def made(self, *, points=None, slave=None, master=None, normals=None, **options):
        given = [own if new is None else new for own, new in zip(self.DATA, (points, slave, master, normals),
                                                                 strict=True)]
        return mortar_2d(*given, **options)

    def test_orientation(self):
        points, slave, master, _ = self.DATA
        with pytest.raises(ValueError, match=r"point out of the slave body; that of node 1 .* Reverse"):
            self.made(slave=slave[:, ::-1])
        with pytest.raises(ValueError, match=NEVER_FACING):
            self.made(master=master[:, ::-1])
        with pytest.raises(ValueError, match=NEVER_FACING):
            self.made(slave=slave[:, ::-1], normals=surface_normals(points, slave[:, ::-1]))

    def test_reach(self):
        with pytest.raises(ValueError, match=f"^{NEVER_FACING} within a reach of 0.05 m"):
            self.made(reach=0.05)
        assert len(mortar_2d(*self.DATA, reach=0.11)) == 4
        deep = two(line(np.linspace(0, 1, 4), -0.5), line(np.linspace(0, 1, 3), up=True))
        with pytest.raises(ValueError, match=NEVER_FACING):
            mortar_2d(*deep)
        np.testing.assert_allclose(mortar_2d(*deep, reach=0.6).gaps, -0.5)

    def test_shared_nodes(self):
        with pytest.raises(ValueError, match="share node 4"):
            self.made(slave=np.r_[self.DATA[1], [[3, 4]]])


class TestNormals:
    def test_weighted_by_length(self):
        points = np.array([[0.0, 3.0], [0.0, 0.0], [1.0, 0.0], [5.0, 5.0]])
        normals = surface_normals(points, np.array([[0, 1], [1, 2]]))
        np.testing.assert_allclose(normals, [[-1, 0], np.array([-3, -1]) / np.sqrt(10), [0, -1], [0, 0]])

    def test_weighted_by_area(self):
        points = np.array([[0, 0, 0], [0, 2, 0], [4, 0, 0], [0, 0, 1.0]])
        normals = surface_normals(points, np.array([[0, 1, 2], [0, 3, 1]]))
        np.testing.assert_allclose(normals[[0, 2]], [np.array([-1, 0, -4]) / np.sqrt(17), [0, 0, -1]])


def test_without_jit(monkeypatch):
    cases = [two(arc(1.0, np.arange(9) * 2 * np.pi / 9), arc(1.1, -np.arange(7) * 2 * np.pi / 7), closed=True),
             two(line(np.linspace(0, 1, 6)), line([0.13, 0.3, 0.9], up=True))]
    compiled = [mortar_2d(*data) for data in cases]
    uncompile(monkeypatch, module, search)
    for data, expected in zip(cases, compiled, strict=True):
        assert_same(mortar_2d(*data), expected)
