"""New nodes go onto arcs and round faces, never so far that an element is spoilt."""

import math

import numpy as np
import pytest
from bisected_meshes import SQUARE, random_mask, verified

from adaptmg.mesh import MeshArrays, bisect, check_mesh, coarsen, graded, onto_domain, quality
from adaptmg.mesh.bisection.onto_domain import curved_boundaries
from adaptmg.problem import Assembly, Box, Outline, Polygon, Rectangle
from adaptmg.problem.solid_domains import Ball, Common, Cut, Cylinder, Extrusion, Moved, Revolution

RING = Outline(vertices=((1, 0), (2, 0), (0, 2), (0, 1)), boundaries=("a", "out", "b", "in"),
               arcs={1: (0, 0), 3: (0, 0)})
# straight and round edges of one name, bulging out and in
SHARED = Outline(vertices=((0, 0), (1, 0), (1, 1), (0, 1)), boundaries=("wall", "wall", "top", "wall"),
                 arcs={1: (0, 0.5), 3: (-1, 0.5)})
# two arcs between the same corners
LENS = Outline(vertices=((-1, 0), (1, 0)), boundaries=("rim", "rim"), arcs={0: (0, 1), 1: (0, -2)})
CONE = Polygon(vertices=((0, 0), (2, 0), (1, 1), (0, 1)), boundaries=("base", "cone", "lid", "axis"))
BULGED = Outline(vertices=((1, 0), (2, 0), (2, 1), (1, 1)), boundaries=("floor", "belly", "lid", "bore"),
                 arcs={1: (1.5, 0.5)})


def refined_onto(domain, mesh, passes=2, part=1.0):
    for k in range(passes):
        fine, _ = bisect(mesh, random_mask(mesh, part, k))
        moved = onto_domain(domain, fine, mesh.n_nodes)
        np.testing.assert_array_equal(moved.points[:mesh.n_nodes], mesh.points)
        np.testing.assert_array_equal(moved.elements, fine.elements)
        assert moved.refinement is fine.refinement
        mesh = verified(moved)
    return mesh


def off_arcs(domain, mesh):
    """The largest distance of a boundary node to the edges that have its name."""
    from adaptmg.mesh.domains import distance_to_boundaries
    return max(distance_to_boundaries(domain, [name], mesh.points[mesh.boundary_nodes(name)]).max()
               for name in mesh.boundaries)


@pytest.mark.parametrize("domain", [RING, SHARED, LENS], ids=["ring", "shared", "lens"])
@pytest.mark.parametrize("part", [1.0, 0.3])
def test_outlines(domain, part):
    coarse = graded(domain, 0.5)
    mesh = refined_onto(domain, coarse, 2, part)
    assert off_arcs(domain, mesh) < 1e-14
    errors = [abs(m.volumes.sum() - domain.area) for m in (coarse, mesh)]
    # where only a part is refined, what bulges out and in no longer cancels
    assert errors[1] < errors[0] / 14 or part < 1
    assert quality(mesh).min_angle > 0.5 * quality(coarse).min_angle
    # chords alone stay where they were
    chords = coarse
    for _ in range(2):
        chords, _ = bisect(chords, np.ones(len(chords.elements), dtype=bool))
    assert off_arcs(domain, chords) > 1e-3


def test_an_assembly_has_its_bodies_moved_each_by_its_own_arcs():
    disk = Outline(vertices=((0, 0), (1, 0), (0, 1)), boundaries=("base", "rim", "axis"), arcs={1: (0, 0)})
    domain = Assembly(parts={"disk": disk, "ring": RING})
    assert set(curved_boundaries(domain)) == {"disk.rim", "ring.out", "ring.in"}
    mesh = refined_onto(domain, graded(domain, 0.4))
    for name, radius in (("disk.rim", 1), ("ring.in", 1), ("ring.out", 2)):
        np.testing.assert_allclose(np.linalg.norm(mesh.points[mesh.boundary_nodes(name)], axis=1), radius, rtol=1e-14)


def radii(mesh, name, centre=(0, 0)):
    return np.linalg.norm(mesh.points[mesh.boundary_nodes(name), :2] - centre, axis=1)


def test_round_faces_of_solids():
    ball = refined_onto(None, graded(Ball((1, 2, 3), 0.2), 0.2), 1)
    assert np.linalg.norm(ball.points[ball.boundary_nodes("surface")] - (1, 2, 3), axis=1).min() < 0.199
    ball = refined_onto(Ball((1, 2, 3), 0.2), graded(Ball((1, 2, 3), 0.2), 0.2), 2, 0.5)
    np.testing.assert_allclose(np.linalg.norm(ball.points[ball.boundary_nodes("surface")] - (1, 2, 3), axis=1), 0.2,
                               rtol=1e-12)
    cylinder = Cylinder((0, 0, 1), (0, 0, 1), 0.5, 1)
    mesh = refined_onto(cylinder, graded(cylinder, 0.5))
    np.testing.assert_allclose(radii(mesh, "side"), 0.5, rtol=1e-12)
    assert (mesh.points[mesh.boundary_nodes("bottom"), 2] == 1).all() and radii(mesh, "bottom").max() < 0.5 + 1e-12
    # a quarter turn about y takes (x, y, z) to (z, y, -x)
    turned = Moved(cylinder, (10, 0, 0), 90, (0, 2, 0))
    mesh = refined_onto(turned, graded(turned, 0.5))
    np.testing.assert_allclose(np.hypot(*mesh.points[mesh.boundary_nodes("side"), 1:].T), 0.5, rtol=1e-12)
    np.testing.assert_allclose(mesh.points[mesh.boundary_nodes("bottom"), 0], 11, rtol=1e-14)
    np.testing.assert_allclose([turned.lower, turned.upper], [[11, -0.5, -0.5], [12, 0.5, 0.5]], atol=1e-14)


def test_turned_and_extruded_profiles():
    for solid in (Revolution(CONE, 120), Revolution(CONE)):
        mesh = refined_onto(solid, graded(solid, 1.0))
        np.testing.assert_allclose(radii(mesh, "cone") + mesh.points[mesh.boundary_nodes("cone"), 2], 2, rtol=1e-10)
        assert radii(mesh, "base").max() < 2 + 1e-10
        for name, height in (("base", 0), ("lid", 1)):
            assert (mesh.points[mesh.boundary_nodes(name), 2] == height).all()
    assert mesh.volumes.sum() == pytest.approx(math.pi * 7 / 3, rel=0.03)
    sector = Revolution(BULGED, 90)
    mesh = refined_onto(sector, graded(sector, 0.7))
    nodes = mesh.boundary_nodes("belly")
    np.testing.assert_allclose(np.hypot(radii(mesh, "belly") - 1.5, mesh.points[nodes, 2] - 0.5), math.sqrt(0.5),
                               rtol=1e-10)
    np.testing.assert_allclose(radii(mesh, "bore"), 1, rtol=1e-12)
    assert (mesh.points[mesh.boundary_nodes("start"), 1] == 0).all()
    np.testing.assert_allclose(mesh.points[mesh.boundary_nodes("end"), 0], 0, atol=1e-14)
    prism = Extrusion(RING, 0.5)
    mesh = refined_onto(prism, graded(prism, 0.7))
    np.testing.assert_allclose(radii(mesh, "in"), 1, rtol=1e-12)
    np.testing.assert_allclose(radii(mesh, "out"), 2, rtol=1e-12)


def test_what_is_not_known_stays_on_the_chord():
    unit = Box(width=1, depth=1, height=1)
    for domain in (Common(Ball((0, 0, 1), 1), unit), Cut(unit, Cylinder((0, 0, -1), (0, 0, 1), 0.5, 3))):
        coarse = graded(domain, 0.5)
        fine, _ = bisect(coarse, np.ones(len(coarse.elements), dtype=bool))
        assert onto_domain(domain, fine, coarse.n_nodes) is fine
    fine, _ = bisect(SQUARE, np.ones(len(SQUARE.elements), dtype=bool))
    assert onto_domain(Rectangle(width=1, height=1), fine, SQUARE.n_nodes) is fine
    # nothing new, nothing moves
    assert onto_domain(RING, fine, fine.n_nodes) is fine


def thin(height):
    """A domain whose floor bulges into it by .5, meshed with a node that far above the floor's chord."""
    domain = Outline(vertices=((-1, 0), (1, 0), (1, 2), (-1, 2)), boundaries=("floor", "right", "top", "left"),
                     arcs={0: (0, -0.75)})
    points = np.array([*domain.vertices, (0, height)])
    mesh = MeshArrays(points, np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]),
                      np.array([[0, 1], [1, 2], [2, 3], [3, 0]]), np.arange(4), domain.boundaries)
    return domain, check_mesh(mesh)


@pytest.mark.parametrize(("height", "goes"), [(1.0, True), (0.6, False), (0.4, False)])
def test_a_node_stays_on_the_chord_where_it_would_spoil_an_element(height, goes):
    domain, coarse = thin(height)
    assert domain.arc(0).at(0.5) == pytest.approx((0, 0.5))
    fine, parents = bisect(coarse, np.array([True, False, False, False]), passes=1)
    moved = verified(onto_domain(domain, fine, coarse.n_nodes))
    new = int(np.flatnonzero((parents == [0, 1]).all(axis=1))[0])
    assert (moved is not fine) == goes
    np.testing.assert_allclose(moved.points[new], (0, 0.5 if goes else 0), atol=1e-15)
    assert moved.volumes.min() > 0.2 * fine.volumes.min()


def test_moved_meshes_are_taken_back_too():
    coarse = graded(RING, 0.5)
    fine = refined_onto(RING, coarse, 2, 0.4)
    back = verified(coarsen(fine, np.ones(len(fine.elements), dtype=bool)))
    np.testing.assert_array_equal(back.points, coarse.points)
    assert len(back.elements) == len(coarse.elements)
