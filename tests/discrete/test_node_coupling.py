"""Node-to-node coupling: partners, gaps, weights in 2D, axisymmetry and 3D, and every refusal."""

import numpy as np
import pytest
from mortar import mortar_2d, node_to_node

from adaptmg.discrete.mortar import pairs
from adaptmg.discrete.mortar.interface import NEVER_FACING, surface_normals


def lines(x, gap, seed=None):
    """A slave line above a master line with the same positions, numbered at random."""
    n = len(x)
    order = np.arange(n) if seed is None else np.random.default_rng(seed).permutation(n)
    points = np.empty((2 * n, 2))
    points[:n] = np.column_stack([x, np.full(n, gap)])
    points[n + order] = np.column_stack([x, np.zeros(n)])
    i = np.arange(n)
    slave = np.column_stack([i[:-1], i[1:]])
    return points, slave, n + order[slave][:, ::-1], surface_normals(points, slave), n + order


def squares(n, gap):
    """Two square surfaces of side 1 in 3D, the slave at height ``gap`` facing down."""
    x, y = (c.ravel() for c in np.meshgrid(np.linspace(0, 1, n + 1), np.linspace(0, 1, n + 1), indexing="ij"))
    flat = np.column_stack([x, y, np.zeros(len(x))])
    points = np.concatenate([flat + np.array([0, 0, gap]), flat])
    i = np.arange(len(x)).reshape(n + 1, n + 1)
    a, b, c, d = (k.ravel() for k in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    up = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    return points, up[:, ::-1], up + len(x), surface_normals(points, up[:, ::-1])


@pytest.mark.parametrize("gap", [0.0, 0.4, -0.1])
@pytest.mark.parametrize("axisymmetric", [False, True])
def test_matching_lines(gap, axisymmetric):
    *data, partner = lines(np.array([0.0, 0.1, 0.3, 0.7, 1.0]), gap, seed=1)
    found = node_to_node(*data, axisymmetric=axisymmetric)
    np.testing.assert_array_equal(found.coupling.indices, partner)
    np.testing.assert_array_equal(found.coupling.data, 1.0)
    np.testing.assert_allclose(found.gaps, gap)
    mortar = mortar_2d(*data, axisymmetric=axisymmetric)
    np.testing.assert_allclose(found.weights, mortar.weights)
    assert abs(found.coupling - mortar.coupling).max() < 1e-12 and mortar.coupling.nnz == len(partner)
    np.testing.assert_array_equal(mortar.nodes, np.arange(len(partner)))


def test_surfaces_in_3d():
    found = node_to_node(*squares(4, 0.3))
    np.testing.assert_array_equal(found.coupling.indices, 25 + np.arange(25))
    np.testing.assert_allclose(found.gaps, 0.3)
    np.testing.assert_allclose(found.normals, np.tile([0.0, 0.0, -1.0], (25, 1)))
    assert found.weights.sum() == pytest.approx(1.0)
    x = squares(4, 0.3)[0][:25]
    np.testing.assert_allclose(found.weights @ x[:, :2], [0.5, 0.5])


def test_excluded_nodes_have_no_row():
    *data, _ = lines(np.linspace(0, 1, 5), 0.0)
    found = node_to_node(*data, excluded=(0, 3))
    np.testing.assert_array_equal(found.nodes, [1, 2, 4])
    np.testing.assert_allclose(found.weights, [0.25, 0.25, 0.125])


def test_tolerance():
    points, slave, master, normals, _ = lines(np.linspace(0, 1, 5), 0.1)
    points[7:9, 0] += 0.02
    with pytest.raises(ValueError, match=r"slave node 2 \(0\.5, 0\.1\) has no partner: .* lies 0\.02 m off its "
                                         r"normal, 0\.0025 m are allowed \(2 such nodes of 5\)"):
        node_to_node(points, slave, master, normals)


def test_refusals(monkeypatch):
    points, slave, master, normals, _ = lines(np.linspace(0, 1, 5), 0.1)
    with pytest.raises(ValueError, match=f"^{NEVER_FACING}"):
        node_to_node(points, slave, master[:, ::-1], normals)
    turned = np.where((master == 9).any(axis=1, keepdims=True), master[:, ::-1], master)
    with pytest.raises(ValueError, match=r"slave node 3 .* and faces the same way"):
        node_to_node(points, slave, turned, normals)
    with pytest.raises(ValueError, match=r"slave node 0 .* has no partner"):
        node_to_node(points, slave, master[1:], normals)
    monkeypatch.setattr(pairs, "_OFFSET", 4.0)
    with pytest.raises(ValueError, match=r"slave nodes 0 .* and 1 .* have the same partner 8"):
        node_to_node(points, slave, master[3:], normals, excluded=(2, 3, 4))


def test_a_node_on_the_axis(monkeypatch):
    monkeypatch.setattr(pairs, "_OFFSET", 1.0)
    points = np.array([[0.0, 1.0], [0.0, 0.0], [1.0, 0.0], [0.0, 1.1], [0.0, -0.1], [1.0, -0.1]])
    slave, master = np.array([[0, 1], [1, 2]]), np.array([[5, 4], [4, 3]])
    normals = surface_normals(points, slave)
    with pytest.raises(ValueError, match=r"slave node 0 has no area"):
        node_to_node(points, slave, master, normals, axisymmetric=True)
