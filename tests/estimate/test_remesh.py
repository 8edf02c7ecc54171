"""Remesh: sizes that equilibrate errors within bounds, and meshes of these sizes for every kind of
domain."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.csgraph import shortest_path
from simplex_meshes import delaunay, log_graded, structured, two_boxes

import adaptmg as am
from adaptmg.estimate.engines import (
    Grading,
    NodeCount,
    SizeField,
    equilibrated_sizes,
    mean_sizes,
    nodal_sizes,
    simplex_sizes,
)


def singular(mesh, place, exponent=0.6):
    """Squares of a solution that goes like r^exponent at a place: h^(2 + d) |D^2 u|^2."""
    distance = np.linalg.norm(mesh.points[mesh.elements].mean(axis=1) - np.array(place), axis=1)
    return am.Estimate(
        squares=simplex_sizes(mesh) ** (2 + mesh.dim) * distance ** (2 * (exponent - 2)), norm=1.0
    )


PLANE = {
    "upset": am.cases.upset_block,
    "dovetail": am.cases.dovetail,
    "cylinder": am.cases.hertz_cylinder,
}


@pytest.mark.parametrize("case", PLANE)
def test_plane_problems(case):
    problem = PLANE[case]()
    domain = problem.domain
    mesh = am.mesh.graded(
        domain, float((domain.upper - domain.lower).max()) / 12, problem.pair_boundaries, 4
    )
    place = mesh.points[mesh.boundary_nodes(problem.pair_boundaries[0])[0]]
    engine = am.Remesh(growth=2.5)
    for _ in range(3):
        estimate = singular(mesh, place)
        sizes = equilibrated_sizes(mesh, estimate.squares, 2.5 * mesh.n_nodes)
        fine = am.mesh.check_mesh(engine.refine(problem, mesh, estimate, None), domain.boundaries)
        assert fine.bodies == mesh.bodies and fine.boundaries == mesh.boundaries
        mesh_before, mesh = mesh, fine
    assert mesh.n_nodes == pytest.approx(2.5 * mesh_before.n_nodes, rel=0.15)
    field = SizeField(mesh_before, sizes)
    for k, body in enumerate(mesh.bodies):
        own = mesh.element_body == k
        relative = simplex_sizes(mesh)[own] / field.function(body)(
            mesh.points[mesh.elements[own]].mean(axis=1)
        )
        assert 0.9 < np.median(relative) < 1.15
        assert np.quantile(relative, 0.02) > 0.6 and np.quantile(relative, 0.98) < 1.5
    assert am.mesh.quality(mesh).min_angle > 20
    # not nested: most old nodes are gone
    old, new = ({tuple(x) for x in m.points.round(12)} for m in (mesh_before, mesh))
    assert len(old & new) < 0.3 * len(old)


def test_it_coarsens_small_errors_but_contact_keeps_nodes():
    problem = am.cases.upset_block()
    mesh = am.mesh.graded(problem.domain, 1e-3)
    far = mesh.points[mesh.elements].mean(axis=1)[:, 0] > 20e-3
    fine = am.Remesh(growth=1.5).refine(
        problem, mesh, am.Estimate(squares=np.where(far, 1e-12, 1.0), norm=1.0)
    )
    in_far_half = [np.count_nonzero(m.points[:, 0] > 30e-3) for m in (mesh, fine)]
    assert in_far_half[1] < 0.7 * in_far_half[0]
    mesh = am.mesh.graded(problem.domain, 4e-3)
    for _ in range(6):
        at_top = mesh.points[mesh.elements].mean(axis=1)[:, 1] > 39e-3
        estimate = am.Estimate(squares=np.where(at_top, 1.0, 1e-20), norm=1.0)
        mesh = am.Remesh(growth=1.1).refine(problem, mesh, estimate)
    assert len(mesh.boundary_nodes("bottom")) >= 5


def test_number_of_nodes():
    problem = am.cases.upset_block()
    mesh = am.mesh.graded(problem.domain, 2.5e-3)

    def refined(mesh, exponent, most=None, **options):
        return am.Remesh(**options).refine(
            problem, mesh, singular(mesh, problem.domain.lower, exponent), None, most
        )

    # the meshes before the most nodes grow alike
    meshes = [mesh]
    for _ in range(2):
        meshes.append(refined(meshes[-1], 1.5, 5 * mesh.n_nodes, growth=2.5))
        assert meshes[-1].n_nodes / meshes[-2].n_nodes == pytest.approx((0.95 * 5) ** 0.5, rel=0.15)
    # by no more than twice where sizes fall steeply
    assert refined(mesh, 0.5, growth=4.0).n_nodes == pytest.approx(2 * mesh.n_nodes, rel=0.15)


@pytest.mark.parametrize(
    "domain",
    [
        am.Box(width=0.04, depth=0.02, height=0.03),
        am.Cut(
            am.Box(width=0.04, depth=0.04, height=0.02),
            am.Cylinder(point=(0.02, 0.02, -0.01), axis=(0, 0, 1), radius=0.01, height=0.04),
        ),
    ],
    ids=["box", "cut"],
)
def test_solids(domain):
    first, *_, last = dict.fromkeys(domain.boundaries)
    problem = am.ContactProblem(
        material=am.Solid(young=2.1e11, poisson=0.3),
        domain=domain,
        law=am.Frictionless(),
        contact=am.Contact(last, am.Plane((0, 0, 0), (0, 0, 1))),
        supports=(am.Support(first, x=0.0),),
    )
    mesh, engine = am.mesh.graded(domain, 6e-3), am.Remesh()
    for _ in range(2):
        before, mesh = (
            mesh,
            am.mesh.check_mesh(
                engine.refine(problem, mesh, singular(mesh, domain.lower)), domain.boundaries
            ),
        )
    assert mesh.n_nodes == pytest.approx(engine.growth * before.n_nodes, rel=0.25)
    assert am.mesh.quality(mesh).min_angle > 8
    if isinstance(domain, am.Cut):
        hole = [name for name in mesh.boundaries if "side" in name]
        nodes = np.unique(np.concatenate([mesh.boundary_nodes(name) for name in hole]))
        radii = np.linalg.norm(mesh.points[nodes, :2] - 0.02, axis=1)
        np.testing.assert_allclose(radii, 0.01, rtol=1e-5)


def test_intermediate_meshes_halve_the_jump():
    problem = am.cases.dovetail()
    coarse, fine = am.mesh.graded(problem.domain, 6e-3), am.mesh.graded(problem.domain, 0.5e-3)
    between = am.mesh.check_mesh(
        am.Remesh().intermediate(problem, coarse, fine), problem.domain.boundaries
    )
    assert coarse.n_nodes < between.n_nodes < fine.n_nodes
    whole, lower, upper = (
        am.transfer.size_ratio(*pair)
        for pair in ((coarse, fine), (coarse, between), (between, fine))
    )
    assert whole > 8
    assert max(lower, upper) < 1.7 * np.sqrt(whole)


def test_a_problem_without_a_domain_is_refused():
    mesh, alone = structured(4, 2), replace(am.cases.upset_block(), domain=None)
    for run in (
        lambda: am.Remesh().refine(alone, am.mesh.as_mesh(mesh), singular(mesh, (0.0, 0.0))),
        lambda: am.Remesh().intermediate(alone, mesh, mesh),
    ):
        with pytest.raises(ValueError, match=r"problem\.domain is None.*engine=am\.Bisect"):
            run()


def edges_of(mesh):
    k = mesh.elements.shape[1]
    pairs = np.concatenate([mesh.elements[:, [i, j]] for i in range(k) for j in range(i)])
    return pairs, np.linalg.norm(mesh.points[pairs[:, 0]] - mesh.points[pairs[:, 1]], axis=1)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), dim=st.sampled_from([2, 3]), growth=st.floats(0.01, 2))
def test_gradation_is_the_largest_field_below_that_grows_slowly(seed, dim, growth):
    rng = np.random.default_rng(seed)
    mesh = delaunay(rng.random((60, dim)))
    sizes = 10 ** rng.uniform(-4, 0, mesh.n_nodes)
    before, (pairs, lengths) = sizes.copy(), edges_of(mesh)
    # an edge is there once for each of its elements
    graph = sparse.lil_array((mesh.n_nodes, mesh.n_nodes))
    graph[pairs[:, 0], pairs[:, 1]] = growth * lengths
    largest = (shortest_path(graph.tocsr(), directed=False) + sizes).min(axis=1)
    np.testing.assert_allclose(Grading(mesh, growth)(sizes), largest, rtol=1e-12)
    assert (before == sizes).all()


@pytest.mark.parametrize("rate", [0.0, 1.5])
@pytest.mark.parametrize("dim", [2, 3])
def test_squares_after_refinement_are_equal(dim, rate):
    # eta^2 = a h^(2 + d) with a that varies smoothly, or not: sizes must go like a^(-1 / (2 + d))
    mesh = structured(8 if dim == 3 else 30, dim)
    squares = np.exp(rate * mesh.points[mesh.elements].mean(axis=1)[:, 0]) * simplex_sizes(
        mesh
    ) ** (2 + dim)
    sizes = equilibrated_sizes(mesh, squares, 2.0 * mesh.n_nodes, growth=10)
    after = np.exp(rate * mesh.points[:, 0]) * sizes ** (2 + dim)
    assert after.max() / after.min() < (1.35 if rate else 1 + 1e-11)
    assert NodeCount(mesh)(sizes) == pytest.approx(2.0 * mesh.n_nodes, rel=0.01)


def test_units_of_squares_do_not_matter_and_the_count_is_exact():
    mesh = log_graded(150, 3)
    squares = np.random.default_rng(0).random(len(mesh.elements))
    np.testing.assert_allclose(
        equilibrated_sizes(mesh, 1e-25 * squares, 400),
        equilibrated_sizes(mesh, squares, 400),
        rtol=1e-9,
    )
    squares[:50] = 0
    for some in (squares, 0 * squares):
        assert NodeCount(mesh)(equilibrated_sizes(mesh, some, 400)) == pytest.approx(400, rel=0.01)
    for mesh in (log_graded(300, 2), structured(5, 3), two_boxes(4, 2)):
        assert NodeCount(mesh)(nodal_sizes(mesh, simplex_sizes(mesh))) == pytest.approx(
            mesh.n_nodes
        )
    # half the sizes: four times the nodes inside, twice those of the boundary
    mesh = structured(16, 2)
    assert NodeCount(mesh)(0.5 * nodal_sizes(mesh, simplex_sizes(mesh))) == pytest.approx(
        33**2, rel=0.02
    )


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
    grading = Grading(mesh, 0.3)
    lowest = grading(0.1 * old)
    assert (sizes >= lowest * (1 - 1e-9)).all()
    count = NodeCount(mesh)
    highest = grading(1.5 * old)
    reachable = np.clip(growth * mesh.n_nodes, count(highest), count(lowest))
    assert count(sizes) == pytest.approx(reachable, rel=0.01)


@pytest.mark.parametrize("dim", [2, 3])
def test_size_fields_are_linear_in_each_body(dim):
    mesh, slope = structured(3, dim), np.arange(1.0, dim + 1)
    field, x = SizeField(mesh, 1 + mesh.points @ slope), np.random.default_rng(1).random((50, dim))
    np.testing.assert_allclose(field.function(mesh.bodies[0])(x), 1 + x @ slope, rtol=1e-12)
    both = two_boxes(2, dim)
    body = np.zeros(both.n_nodes)
    body[both.elements] = both.element_body[:, None]
    field = SizeField(both, 1 + body)
    for k, name in enumerate(both.bodies):
        assert (field.function(name)(both.points[body == k]) == 1 + k).all()
    whole = structured(2, 2), structured(32, 2)
    halves = [
        replace(
            mesh,
            bodies=("left", "right"),
            element_body=(mesh.points[mesh.elements].mean(axis=1)[:, 0] > 0.5).astype(int),
        )
        for mesh in whole
    ]
    for coarse, fine in (whole, halves):  # bodies that share nodes, too
        mean = mean_sizes(coarse, fine, 10.0)
        expected = np.sqrt(
            nodal_sizes(coarse, simplex_sizes(coarse))[0] * nodal_sizes(fine, simplex_sizes(fine))
        )
        np.testing.assert_allclose(mean.sizes, expected, rtol=1e-9)
