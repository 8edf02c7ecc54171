"""Averaged normals of a surface."""

from __future__ import annotations

import numpy as np
import pytest
from test_mortar_2d import arc

from adaptmg.discrete.mortar.interface import surface_normals


class TestNormals:
    def test_weighted_by_length(self):
        points = np.array([[0.0, 3.0], [0.0, 0.0], [1.0, 0.0], [5.0, 5.0]])
        normals = surface_normals(points, np.array([[0, 1], [1, 2]]))
        np.testing.assert_allclose(normals, [[-1, 0], np.array([-3, -1]) / np.sqrt(10), [0, -1], [0, 0]])

    def test_weighted_by_area(self):
        points = np.array([[0, 0, 0], [0, 2, 0], [4, 0, 0], [0, 0, 1.0]])
        normals = surface_normals(points, np.array([[0, 1, 2], [0, 3, 1]]))
        np.testing.assert_allclose(normals[[0, 2]], [np.array([-1, 0, -4]) / np.sqrt(17), [0, 0, -1]])

    def test_symmetry_planes(self):
        points = arc(1.0, np.linspace(1.5, 2, 5) * np.pi)
        fixed = np.zeros((5, 2), dtype=bool)
        fixed[0, 0] = fixed[2, 0] = True  # at node 2 the held direction is 45 degrees off: not a plane of symmetry
        facets = np.column_stack([np.arange(4), np.arange(1, 5)])
        plain, normals = surface_normals(points, facets), surface_normals(points, facets, fixed=fixed)
        np.testing.assert_array_equal(normals[0], [0, -1])
        np.testing.assert_allclose(normals[1:], plain[1:], atol=1e-15)
        assert abs(plain[0, 0]) > 0.1

    def test_refusals(self):
        points = np.array([[0.0, 0.0], [1.0, 0.0]])
        with pytest.raises(ValueError, match="no normal at node 0"):
            surface_normals(points, np.array([[0, 1], [1, 0]]))
