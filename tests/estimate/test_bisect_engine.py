"""Bisect refines what is marked within its limits, goes onto arcs, and takes back where little is
left."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from bisected_meshes import SQUARE, as_sets, cube, random_mask, verified

import adaptmg as am
from adaptmg.estimate.engines import divisible
from adaptmg.mesh.bisection import refined

PROBLEM = am.cases.greco_bar()
MESH = am.mesh.structured(PROBLEM.domain, 8)
RING = am.Outline(
    vertices=((1, 0), (2, 0), (0, 2), (0, 1)),
    boundaries=("a", "out", "b", "in"),
    arcs={1: (0, 0), 3: (0, 0)},
)


def estimate_of(mesh, towards=(0.0, 0.0)):
    middle = mesh.points[mesh.elements].mean(axis=1)
    far = np.linalg.norm(middle - np.array(towards), axis=1) / np.ptp(mesh.points[:, 0])
    return am.Estimate(squares=1 / (1e-3 + far) ** 3, norm=1.0)


def largest(estimate, part):
    return estimate.squares >= np.quantile(estimate.squares, 1 - part)


def test_it_bisects_what_is_marked():
    estimate = estimate_of(MESH)
    marked = largest(estimate, 0.2)
    # twice where once would leave more than half of the mean square, and of the smallest that is
    # marked
    for part, deep in (
        (0.2, estimate.squares.mean()),
        (0.05, estimate.squares[largest(estimate, 0.05)].min()),
    ):
        marked, twice = largest(estimate, part), estimate.squares > 8 * deep
        once = refined(MESH, marked)
        assert 0 < twice.sum() < marked.sum()
        expected = refined(once.mesh, twice[once.origin]).mesh
        assert as_sets(verified(am.Bisect().refine(PROBLEM, MESH, estimate, marked))) == as_sets(
            expected
        )
    assert am.Bisect().refine(PROBLEM, MESH, estimate, ~np.ones_like(marked)) is MESH
    for limit in (1, MESH.n_nodes - 1, MESH.n_nodes):
        assert am.Bisect().refine(PROBLEM, MESH, estimate, marked, max_nodes=limit) is MESH
    with pytest.raises(ValueError, match="estimate is of 128 elements, but mesh has 18"):
        am.Bisect().refine(PROBLEM, SQUARE, estimate, np.ones(18, dtype=bool))


@pytest.mark.parametrize("mesh", [MESH, cube(4)], ids=["2D", "3D"])
@pytest.mark.parametrize("room", [1.02, 1.2, 1.5])
def test_a_limit_is_kept_and_used(mesh, room):
    engine = am.Bisect()
    estimate = estimate_of(mesh, mesh.points[0])
    limit = int(room * mesh.n_nodes)
    marked = np.ones(len(mesh.elements), dtype=bool)
    free = engine.refine(PROBLEM, mesh, estimate, marked).n_nodes
    bound = engine.refine(PROBLEM, mesh, estimate, marked, max_nodes=limit)
    assert min(free, limit) >= bound.n_nodes >= 0.85 * min(free, limit)
    if mesh.n_nodes < bound.n_nodes < free:
        # the largest squares are served first
        fine = bound.element_sizes < 0.99 * mesh.element_sizes.max()
        far = np.linalg.norm(bound.points[bound.elements].mean(axis=1) - mesh.points[0], axis=1)
        assert far[fine].mean() < far[~fine].mean()
    # the closure around the first of scattered marks makes half the nodes
    even, marked = replace(estimate, squares=np.ones(len(marked))), random_mask(mesh, 0.3, 4)
    free = engine.refine(PROBLEM, mesh, even, marked).n_nodes
    bound = engine.refine(PROBLEM, mesh, even, marked, max_nodes=limit).n_nodes
    assert (
        0.7 * (min(free, limit) - mesh.n_nodes) - 2 <= bound - mesh.n_nodes <= limit - mesh.n_nodes
    )


def test_nodes_go_onto_the_arcs_of_the_domain():
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        law=am.Frictionless(),
        domain=RING,
        contact=am.Contact("in", am.Plane((0, 0), (0, 1))),
    )
    bare, mesh = replace(problem, domain=None), am.mesh.graded(RING, 0.5)
    for _ in range(3):
        estimate = estimate_of(mesh, (1.0, 0.0))
        mesh = verified(am.Bisect().refine(problem, mesh, estimate, largest(estimate, 0.3)))
    np.testing.assert_allclose(
        np.linalg.norm(mesh.points[mesh.boundary_nodes("in")], axis=1), 1, rtol=1e-14
    )
    estimate = estimate_of(mesh, (1.0, 0.0))
    chords = am.Bisect().refine(bare, mesh, estimate, largest(estimate, 0.3))
    assert np.linalg.norm(chords.points[chords.boundary_nodes("in")], axis=1).min() < 1 - 1e-6


def test_rectangles_and_boxes_begin_with_a_regular_mesh():
    problem, first = am.cases.upset_block(), am.Bisect().first
    mesh = first(problem, 12e-3)
    # 40 mm in cells of 12 mm at most
    assert mesh.n_nodes == 25 and mesh.volumes == pytest.approx(1e-4 / 2)
    assert first(am.cases.greco_block(depth=10e-3), 20e-3).n_nodes == 27
    assert first(am.cases.two_block_patch(size=0.1), 0.05).bodies == ("upper", "lower")
    assert first(am.cases.dovetail(), 5e-3) is None


def test_a_marked_element_stays_above_what_coordinates_resolve():
    mesh = am.mesh.structured(PROBLEM.domain, 2)
    for _ in range(60):
        before, marked = mesh, np.arange(len(mesh.elements)) == 0
        mesh = am.Bisect().refine(
            PROBLEM, before, am.Estimate(squares=marked * 1.0, norm=1.0), marked
        )
        if mesh is before:
            break
    assert mesh is before and not divisible(mesh)[0] and divisible(mesh).any()
    edge = np.sqrt(verified(mesh).volumes.min()) / np.abs(mesh.points).max()
    assert 1e-10 < edge < 1e-8
    # a loop that comes there says so
    first = SimpleNamespace(mark=lambda estimate: np.arange(len(estimate.squares)) == 0)
    (found,) = am.adapt(PROBLEM, mesh, mark=first, engine=am.Bisect(), max_nodes=10_000)
    assert (
        "no finer mesh" in found.outcome and "coordinates do not resolve smaller" in found.outcome
    )
