"""Sizes of the next mesh: growth is bounded, errors are equilibrated, bounds hold, the number of nodes is met."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from simplex_meshes import delaunay, log_graded, structured, two_boxes
from uncompiled import uncompile

from adaptmg.estimate import gradation
from adaptmg.estimate.gradation import ElementsAtNodes, graded_sizes
from adaptmg.estimate.remesh import NodeCount, SizeField, equilibrated_sizes, mean_sizes, nodal_sizes, simplex_sizes


def edges_of(mesh):
    k = mesh.elements.shape[1]
    pairs = np.concatenate([mesh.elements[:, [i, j]] for i in range(k) for j in range(i)])
    return pairs, np.linalg.norm(mesh.points[pairs[:, 0]] - mesh.points[pairs[:, 1]], axis=1)


def graded_by_sweeps(mesh, sizes, growth):
    """The same by plain relaxation of all edges until nothing changes."""
    pairs, lengths = edges_of(mesh)
    sizes = sizes.copy()
    while True:
        before = sizes.copy()
        for a, b in (pairs.T, pairs.T[::-1]):
            np.minimum.at(sizes, a, sizes[b] + growth * lengths)
        if (sizes == before).all():
            return sizes


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), dim=st.sampled_from([2, 3]), growth=st.floats(0.01, 2))
def test_gradation_is_the_largest_field_below_that_grows_slowly(seed, dim, growth):
    rng = np.random.default_rng(seed)
    mesh = delaunay(rng.random((60, dim)))
    sizes = 10 ** rng.uniform(-4, 0, mesh.n_nodes)
    result = graded_sizes(ElementsAtNodes(mesh.points, mesh.elements), sizes, growth)
    np.testing.assert_allclose(result, graded_by_sweeps(mesh, sizes, growth), rtol=1e-12)


def test_gradation_without_the_compiler(monkeypatch):
    mesh = log_graded(200, 1)
    sizes = np.where(np.arange(mesh.n_nodes) == 7, 1e-6, 1.0)
    compiled = graded_sizes(ElementsAtNodes(mesh.points, mesh.elements), sizes, 0.3)
    uncompile(monkeypatch, gradation)
    assert (graded_sizes(ElementsAtNodes(mesh.points, mesh.elements), sizes, 0.3) == compiled).all()
    assert (sizes == np.where(np.arange(mesh.n_nodes) == 7, 1e-6, 1.0)).all(), "the given sizes were changed"


@pytest.mark.parametrize("dim", [2, 3])
def test_equal_squares_ask_for_uniform_refinement(dim):
    mesh = structured(4, dim)
    wanted = 4.0 * mesh.n_nodes
    sizes = equilibrated_sizes(mesh, np.full(len(mesh.elements), 3e-7), wanted, growth=10)
    assert np.ptp(sizes) < 1e-12 * sizes[0]
    assert NodeCount(mesh)(sizes) == pytest.approx(wanted, rel=0.01)


@pytest.mark.parametrize("dim", [2, 3])
def test_squares_after_refinement_are_equal(dim):
    # eta^2 = a h^(2 + d) with a that varies smoothly: sizes must go like a^(-1 / (2 + d))
    mesh = structured(8 if dim == 3 else 30, dim)
    a = np.exp(1.5 * mesh.points[mesh.elements].mean(axis=1)[:, 0])
    squares = a * simplex_sizes(mesh) ** (2 + dim)
    sizes = equilibrated_sizes(mesh, squares, 2.0 * mesh.n_nodes, growth=10)
    after = np.exp(1.5 * mesh.points[:, 0]) * sizes ** (2 + dim)
    assert after.max() / after.min() < 1.35
    assert squares.max() / squares.min() > 3


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), growth=st.floats(1.1, 4), spread=st.floats(0, 12))
def test_number_of_nodes_bounds_and_growth(seed, growth, spread):
    rng = np.random.default_rng(seed)
    mesh = log_graded(150, seed % 7)
    squares = 10 ** rng.uniform(-spread, 0, len(mesh.elements))
    old = nodal_sizes(mesh, simplex_sizes(mesh))
    sizes = equilibrated_sizes(mesh, squares, growth * mesh.n_nodes)
    pairs, lengths = edges_of(mesh)
    assert (np.abs(sizes[pairs[:, 0]] - sizes[pairs[:, 1]]) <= 0.3 * lengths * (1 + 1e-9)).all()
    assert (sizes <= 1.5 * old * (1 + 1e-9)).all()
    lowest = graded_sizes(ElementsAtNodes(mesh.points, mesh.elements), 0.25 * old, 0.3)
    assert (sizes >= lowest * (1 - 1e-9)).all()
    count = NodeCount(mesh)
    highest = graded_sizes(ElementsAtNodes(mesh.points, mesh.elements), 1.5 * old, 0.3)
    reachable = np.clip(growth * mesh.n_nodes, count(highest), count(lowest))
    assert count(sizes) == pytest.approx(reachable, rel=0.01)


def test_unit_of_the_squares_does_not_matter_and_zeros_are_fine():
    mesh = log_graded(150, 3)
    squares = np.random.default_rng(0).random(len(mesh.elements))
    first = equilibrated_sizes(mesh, squares, 400)
    np.testing.assert_allclose(equilibrated_sizes(mesh, 1e-25 * squares, 400), first, rtol=1e-9)
    squares[:50] = 0
    assert np.isfinite(equilibrated_sizes(mesh, squares, 400)).all()
    none = equilibrated_sizes(mesh, np.zeros(len(squares)), 400)
    assert NodeCount(mesh)(none) == pytest.approx(400, rel=0.01)


def test_node_count_is_exact_for_the_mesh_itself():
    for mesh in (log_graded(300, 2), structured(5, 3), two_boxes(4, 2)):
        assert NodeCount(mesh)(nodal_sizes(mesh, simplex_sizes(mesh))) == pytest.approx(mesh.n_nodes)


@pytest.mark.parametrize("dim", [2, 3])
def test_size_field_is_linear_and_knows_its_bodies(dim):
    mesh = structured(3, dim)
    field = SizeField(mesh, 1 + mesh.points @ np.arange(1.0, dim + 1))
    x = np.random.default_rng(1).random((50, dim))
    np.testing.assert_allclose(field(x), 1 + x @ np.arange(1.0, dim + 1), rtol=1e-12)
    for places, sizes in field.samples(dense=True).values():
        np.testing.assert_allclose(sizes, 1 + places @ np.arange(1.0, dim + 1), rtol=1e-12)
    both = two_boxes(2, dim)
    body = np.zeros(both.n_nodes)
    body[both.elements] = both.element_body[:, None]
    field = SizeField(both, 1 + body)
    for k, name in enumerate(both.bodies):
        assert (field(both.points[body == k], name) == 1 + k).all()
        places, sizes = field.samples()[name]
        assert (sizes == 1 + k).all() and len(places) == (body == k).sum() + (both.element_body == k).sum()


def test_mean_sizes_are_the_geometric_mean():
    coarse, fine = structured(2, 2), structured(32, 2)
    field = mean_sizes(coarse, fine, 10.0)
    assert field.mesh is fine
    np.testing.assert_allclose(field.sizes, np.sqrt(nodal_sizes(coarse, simplex_sizes(coarse))[0]
                                                    * nodal_sizes(fine, simplex_sizes(fine))), rtol=1e-9)


def test_failures_name_the_argument():
    mesh = structured(2, 2)
    squares = np.ones(len(mesh.elements))
    with pytest.raises(ValueError, match=r"squares must have shape \(8,\)"):
        equilibrated_sizes(mesh, squares[:-1], 20)
    with pytest.raises(ValueError, match="n_nodes must be > 0"):
        equilibrated_sizes(mesh, squares, 0)
    with pytest.raises(ValueError, match="finest < coarsest"):
        equilibrated_sizes(mesh, squares, 20, finest=2.0)
    with pytest.raises(ValueError, match="at node 3"):
        SizeField(mesh, np.where(np.arange(mesh.n_nodes) == 3, np.nan, 1.0))
    with pytest.raises(ValueError, match="sizes must have shape"):
        SizeField(mesh, np.ones(3))
    both = two_boxes(2, 2)
    with pytest.raises(ValueError, match="body must be one of"):
        SizeField(both, np.ones(both.n_nodes))(np.zeros((1, 2)))
    with pytest.raises(ValueError, match="no body 'rotor'"):
        SizeField(both, np.ones(both.n_nodes))(np.zeros((1, 2)), "rotor")
    with pytest.raises(ValueError, match="same dimension and bodies"):
        mean_sizes(mesh, both, 0.3)
    with pytest.raises(TypeError, match="coarse must be MeshArrays"):
        mean_sizes(None, mesh, 0.3)
