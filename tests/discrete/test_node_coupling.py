"""Node-to-node coupling in the plane: partners, gaps, weights, and every refusal; in space: test_mortar_3d."""

import numpy as np
import pytest
from mortar import mortar_2d, node_to_node
from test_mortar_2d import line, two

from adaptmg.discrete.mortar import pairs
from adaptmg.discrete.mortar.interface import NEVER_FACING, surface_normals


def lines(x, gap, seed=None):
    """A slave line above a master line with the same positions: node i of n faces node 2 n - 1 - i."""
    return two(line(x, gap), line(x, up=True), seed=seed)


@pytest.mark.parametrize("gap", [0.0, 0.4, -0.1])
@pytest.mark.parametrize("axisymmetric", [False, True])
def test_matching_lines(gap, axisymmetric):
    data = lines(np.array([0.0, 0.1, 0.3, 0.7, 1.0]), gap, seed=1)
    found, mortar = (couple(*data, axisymmetric=axisymmetric) for couple in (node_to_node, mortar_2d))
    np.testing.assert_array_equal(found.coupling.indices, 9 - np.arange(5))
    np.testing.assert_array_equal(found.coupling.data, 1.0)
    np.testing.assert_allclose(found.gaps, gap)
    np.testing.assert_allclose(found.weights, mortar.weights)
    assert abs(found.coupling - mortar.coupling).max() < 1e-12 and mortar.coupling.nnz == 5
    np.testing.assert_array_equal(mortar.nodes, np.arange(5))


def test_excluded_nodes_have_no_row():
    found = node_to_node(*lines(np.linspace(0, 1, 5), 0.0), excluded=(0, 3))
    np.testing.assert_array_equal(found.nodes, [1, 2, 4])
    np.testing.assert_allclose(found.weights, [0.25, 0.25, 0.125])


def test_refusals(monkeypatch):
    points, slave, master, normals = lines(np.linspace(0, 1, 5), 0.1)
    moved = points.copy()
    moved[6:8, 0] += 0.02
    with pytest.raises(ValueError, match=r"slave node 2 \(0\.5, 0\.1\) has no partner: .* lies 0\.02 m off its "
                                         r"normal, 0\.0025 m are allowed \(2 such nodes of 5\)"):
        node_to_node(moved, slave, master, normals)
    with pytest.raises(ValueError, match=f"^{NEVER_FACING}"):
        node_to_node(points, slave, master[:, ::-1], normals)
    turned = np.where((master == 5).any(axis=1, keepdims=True), master[:, ::-1], master)
    with pytest.raises(ValueError, match=r"slave node 3 .* and faces the same way"):
        node_to_node(points, slave, turned, normals)
    with pytest.raises(ValueError, match=r"slave node 0 .* has no partner"):
        node_to_node(points, slave, master[:-1], normals)
    monkeypatch.setattr(pairs, "_OFFSET", 4.0)
    with pytest.raises(ValueError, match=r"slave nodes 0 .* and 1 .* have the same partner 6"):
        node_to_node(points, slave, master[:1], normals, excluded=(2, 3, 4))


def test_a_node_on_the_axis(monkeypatch):
    monkeypatch.setattr(pairs, "_OFFSET", 1.0)
    points = np.array([[0.0, 1.0], [0.0, 0.0], [1.0, 0.0], [0.0, 1.1], [0.0, -0.1], [1.0, -0.1]])
    slave, master = np.array([[0, 1], [1, 2]]), np.array([[5, 4], [4, 3]])
    with pytest.raises(ValueError, match=r"slave node 0 has no area"):
        node_to_node(points, slave, master, surface_normals(points, slave), axisymmetric=True)
