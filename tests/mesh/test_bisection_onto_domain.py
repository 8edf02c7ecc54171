"""New nodes go onto arcs and round faces, never so far that an element is spoilt."""

import math

import numpy as np
import pytest
from bisected_meshes import SQUARE, random_mask, verified

from adaptmg.mesh import MeshArrays, bisect, check_mesh, graded, onto_domain, quality
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
    # what bulges out and in alike cancels, unless only a part is refined
    assert errors[1] < max(errors[0] / 14, 1e-14) or part < 1
    assert quality(mesh).min_angle > 0.5 * quality(coarse).min_angle
    # chords alone stay where they were
    chords = coarse
    for _ in range(2):
        chords, _ = bisect(chords, np.ones(len(chords.elements), dtype=bool))
    assert off_arcs(domain, chords) > 1e-3


def off(axes, radius, centre=(0, 0)):
    """How far points are from a circle in the plane of two axes."""
    return lambda x: np.linalg.norm(x[:, axes] - centre, axis=1) - radius


def on(axis, value):
    return lambda x: x[:, axis] - value


BALL, CYLINDER = Ball((1, 2, 3), 0.2), Cylinder((0, 0, 1), (0, 0, 1), 0.5, 1)
DISK = Outline(vertices=((0, 0), (1, 0), (0, 1)), boundaries=("base", "rim", "axis"), arcs={1: (0, 0)})
CONICAL = {"cone": lambda x: np.hypot(x[:, 0], x[:, 1]) + x[:, 2] - 2, "base": on(2, 0), "lid": on(2, 1)}
# what is zero on the boundaries
SHAPES = {
    "disk and ring": (Assembly(parts={"disk": DISK, "ring": RING}), 0.4, {
        "disk.rim": off([0, 1], 1), "ring.in": off([0, 1], 1), "ring.out": off([0, 1], 2)}),
    "ball": (BALL, 0.2, {"surface": lambda x: np.linalg.norm(x - (1, 2, 3), axis=1) - 0.2}),
    "cylinder": (CYLINDER, 0.5, {"side": off([0, 1], 0.5), "bottom": on(2, 1)}),
    # a quarter turn about y takes (x, y, z) to (z, y, -x)
    "turned": (Moved(CYLINDER, (10, 0, 0), 90, (0, 2, 0)), 0.5, {"side": off([1, 2], 0.5), "bottom": on(0, 11)}),
    "sector of a cone": (Revolution(CONE, 120), 1.0, CONICAL), "cone": (Revolution(CONE), 1.0, CONICAL),
    "sector": (Revolution(BULGED, 90), 0.7, {
        "belly": lambda x: np.hypot(np.hypot(x[:, 0], x[:, 1]) - 1.5, x[:, 2] - 0.5) - math.sqrt(0.5),
        "bore": off([0, 1], 1), "start": on(1, 0), "end": on(0, 0)}),
    "prism": (Extrusion(RING, 0.5), 0.7, {"in": off([0, 1], 1), "out": off([0, 1], 2)})}


@pytest.mark.parametrize(("domain", "size", "zero"), SHAPES.values(), ids=SHAPES)
def test_boundaries_stay_where_they_are(domain, size, zero):
    coarse = graded(domain, size)
    mesh = refined_onto(domain, coarse)
    for name, function in zero.items():
        np.testing.assert_allclose(function(mesh.points[mesh.boundary_nodes(name)]), 0, atol=1e-10 * max(1, size))
    if domain is BALL:
        chords = refined_onto(None, coarse, 1)
        assert zero["surface"](chords.points[chords.boundary_nodes("surface")]).min() < -1e-3
    if domain is SHAPES["cone"][0]:
        assert mesh.volumes.sum() == pytest.approx(math.pi * 7 / 3, rel=0.03)
    if domain is SHAPES["disk and ring"][0]:
        assert set(curved_boundaries(domain)) == set(zero)


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
def test_a_node_that_would_spoil_an_element_stays_on_the_chord(height, goes):
    domain, coarse = thin(height)
    assert domain.arc(0).at(0.5) == pytest.approx((0, 0.5))
    fine, parents = bisect(coarse, np.array([True, False, False, False]), passes=1)
    moved = verified(onto_domain(domain, fine, coarse.n_nodes))
    new = int(np.flatnonzero((parents == [0, 1]).all(axis=1))[0])
    assert (moved is not fine) == goes
    np.testing.assert_allclose(moved.points[new], (0, 0.5 if goes else 0), atol=1e-15)
    assert moved.volumes.min() > 0.2 * fine.volumes.min()
