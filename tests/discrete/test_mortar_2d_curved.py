"""Mortar coupling of curved surfaces in 2D: order of accuracy, exact rays, which master edge counts, the search."""

import numpy as np
import pytest
from hypothesis import given, settings
from mortar import mortar_2d
from test_mortar_2d import SEEDS, arc, assert_same, line, random_line, two

from adaptmg.discrete.mortar import segments as module
from adaptmg.discrete.mortar.interface import NEVER_FACING, Surfaces


def errors_on_a_plane(n):
    angles = np.linspace(1.25 * np.pi, 1.75 * np.pi, n + 1)
    data = two(arc(1.0, angles, (0.0, 1.0)), line(np.linspace(-2, 2, 3), up=True))
    found = mortar_2d(*data)
    x = data[0][found.nodes]
    return np.abs(found.gaps - x[:, 1] / (1 - x[:, 1]))[1:-1].max()


def errors_of_rings(n):
    """A shaft in a hole, gap 0.05: largest error of gap and of the nodes opposite."""
    data = two(arc(1.0, np.arange(n) * 2 * np.pi / n), arc(1.05, -np.arange(n + n // 3) * 2 * np.pi / (n + n // 3)),
               closed=True)
    found = mortar_2d(*data)
    assert len(found) == n
    opposite = found.coupling @ data[0]
    return np.array([np.abs(found.gaps - 0.05).max(), np.linalg.norm(opposite - 1.05 * data[0][:n], axis=1).max()])


class TestCurved:
    @pytest.mark.parametrize("errors", [errors_on_a_plane, errors_of_rings])
    def test_second_order(self, errors):
        coarse, fine, finer = (errors(n) for n in (48, 96, 192))
        assert (coarse > 3.3 * fine).all() and (fine > 3.6 * finer).all() and (finer < 1e-4).all()

    def test_press_fit_finds_the_near_side(self):
        # hole of radius 1, shaft of radius 1.02: the rays also meet the far side of the hole
        data = two(arc(1.02, np.linspace(0, 2 * np.pi, 60, endpoint=False)),
                   arc(1.0, -np.linspace(0, 2 * np.pi, 70, endpoint=False)), closed=True)
        found = mortar_2d(*data)
        np.testing.assert_allclose(found.gaps, -0.02, atol=3e-3)
        np.testing.assert_allclose(found.coupling @ data[0], data[0][:60], atol=0.03)

    def test_masters_beyond_the_centre_of_curvature_do_not_count(self):
        cup = arc(1.0, np.linspace(-0.25 * np.pi, -0.75 * np.pi, 12))
        below, above = line([-0.3, 0.3], -0.5), line([-0.3, 0.3], 0.5)
        assert len(mortar_2d(*two(cup, below)))
        with pytest.raises(ValueError, match=NEVER_FACING):
            mortar_2d(*two(cup, above))

    @pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
    def test_the_nearest_surface_counts(self, order):
        # floors at -0.5 and 0 and a step at 0.1, numbered in any order, below a slave surface at 0.2
        steps = np.array([[1.0, -0.5], [0.0, -0.5], [1.0, 0.0], [0.0, 0.0], [0.6, 0.1], [0.4, 0.1]])
        points, slave, _, normals = two(line(np.linspace(0, 1, 6), 0.2), steps)
        master = np.array([[6, 7], [8, 9], [10, 11]])[list(order)]
        found = mortar_2d(points, slave, master, normals)
        np.testing.assert_allclose(found.gaps, [0.2, 0.2, 0.15, 0.15, 0.2, 0.2], atol=1e-14)
        assert not found.coupling[:, [6, 7]].count_nonzero()
        # 0.02 below the top of the step overlap is nearer than the floor, 0.02 above the floor it is not
        for height, gap in ((0.08, (0.08 - 0.02) / 2), (0.02, 0.02)):
            points[:6, 1] = height
            np.testing.assert_allclose(mortar_2d(points, slave, master, normals).gaps[2:4], gap, atol=1e-14)

    @settings(max_examples=50, deadline=None)
    @given(seed=SEEDS)
    def test_rays_are_exact(self, seed):
        # an edge whose normals differ by up to 100 degrees, in front of one master edge
        rng = np.random.default_rng(seed)
        tilt = rng.uniform(-0.9, 0.9, 2)
        points = np.array([[0.0, 1.0], [1.0, 1.0], [2.5, rng.uniform(-0.3, 0.3)], [-1.5, rng.uniform(-0.3, 0.3)]])
        normals = np.zeros((4, 2))
        normals[:2] = np.column_stack([np.sin(tilt), -np.cos(tilt)])
        surfaces = Surfaces(points, np.array([[0, 1]]), np.array([[2, 3]]), normals)
        for node in (2, 3):
            s = module._projection(surfaces, np.array([[0, 1]]), np.array([node]))[0]
            if s not in (0.0, 1.0):
                ray, offset = normals[0] + s * (normals[1] - normals[0]), points[0] + [s, 0] - points[node]
                scale = (1 + abs(s))**2
                assert abs(ray[0] * offset[1] - ray[1] * offset[0]) < 3e-14 * scale
        s = rng.random((1, 3))
        eta, distance = module._opposite(surfaces, np.array([[0, 1]]), np.array([[2, 3]]), s)
        for k in range(3):
            ray, x = normals[0] + s[0, k] * (normals[1] - normals[0]), np.array([s[0, k], 1.0])
            there = points[2] + eta[0, k] * (points[3] - points[2])
            np.testing.assert_allclose(x + distance[0, k] * ray / np.linalg.norm(ray), there, atol=1e-13)
            if 0 < eta[0, k] < 1:
                other = module.distance_along_normal(points, normals, 0, 1, 2, 3, s[0, k])
                assert other == pytest.approx(distance[0, k], rel=1e-13) or np.isinf(other)

    @settings(max_examples=25, deadline=None)
    @given(seed=SEEDS)
    def test_the_search_misses_nothing(self, seed):
        rng = np.random.default_rng(seed)
        t, s = random_line(rng, rng.integers(2, 25)), random_line(rng, rng.integers(2, 25), -0.3, 1.2)
        lift = rng.uniform(-0.1, 0.4)
        data = two(line(t, lift + 0.1 * np.sin(9 * t + lift)), line(s, 0.1 * np.cos(7 * s), up=True), seed=seed)

        def everything(surfaces, backward, forward):
            i, j = np.indices((len(surfaces.slave), len(surfaces.master)))
            return i.ravel(), j.ravel()

        reach = [None, 0.05, 3.0][seed % 3]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(module, "_candidates", everything)
            try:
                expected = mortar_2d(*data, reach=reach)
            except ValueError:
                expected = None
        if expected is None:
            with pytest.raises(ValueError, match="surfaces"):
                mortar_2d(*data, reach=reach)
            return
        assert_same(mortar_2d(*data, reach=reach), expected)
