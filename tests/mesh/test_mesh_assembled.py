"""Meshes of several bodies and of outlines with arcs: nothing shared, nodes on the circles, sizes
as asked."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from bisected_meshes import edge_lengths
from refused import refused

import adaptmg as am
from adaptmg.mesh.arrays import in_sweep_order
from adaptmg.mesh.sizes import distance_to_boundaries

UPPER = am.Rectangle(width=1.0, height=0.5)
LOWER = am.Rectangle(width=2.0, height=1.0, origin=(-0.5, -1.0))
TWO = am.Assembly(parts={"upper": UPPER, "lower": LOWER})
BOXES = am.Assembly(
    parts={
        "a": am.Box(width=1, depth=1, height=1),
        "b": am.Box(width=2, depth=1, height=1, origin=(0, 0, -1)),
    }
)
ANGLES = np.radians([0, 85, 200, 290])
DISK = am.Outline(
    vertices=[(3 + math.cos(a), 5 + math.sin(a)) for a in ANGLES],
    boundaries=("a", "b", "a", "b"),
    arcs=dict.fromkeys(range(4), (3.0, 5.0)),
)
# arcs that turn both ways, straight edges that share a name with an arc and leave it along its
# tangent
RING = am.Outline(
    vertices=((1, 0), (2, 0), (2, 1), (0, 3), (-1, 3), (-1, 2), (0, 1)),
    boundaries=("x", "out", "out", "top", "y", "in", "in"),
    arcs={2: (0, 1), 6: (0, 0)},
)
BALL_ON_BLOCK = am.Assembly(
    parts={
        "ball": am.Outline(
            vertices=((0, 0), (8e-3, 8e-3), (0, 8e-3)),
            boundaries=("arc", "top", "axis"),
            arcs={0: (0, 8e-3)},
        ),
        "block": am.Rectangle(width=8e-3, height=8e-3, origin=(0, -8e-3)),
    }
)


def off_circle(
    mesh: am.MeshArrays, boundary: str, center: tuple[float, float], radius: float
) -> float:
    distance = np.linalg.norm(mesh.points[mesh.boundary_nodes(boundary)] - center, axis=1)
    return np.abs(distance / radius - 1).max()


@pytest.mark.parametrize("ratio", [1, 100])
def test_arcs_and_straight_edges_are_meshed(ratio):
    mesh = am.mesh.check_mesh(am.mesh.graded(RING, 0.4, "in", ratio), RING.boundaries)
    assert mesh.boundaries == ("x", "out", "top", "y", "in") and mesh.bodies == ("body",)
    assert all((mesh.points == vertex).all(axis=1).sum() == 1 for vertex in RING.vertices)
    inner = mesh.points[mesh.boundary_nodes("in")]
    arc = inner[inner[:, 0] > 0]
    straight = inner[inner[:, 0] <= 0]
    np.testing.assert_allclose(np.linalg.norm(arc, axis=1), 1, rtol=1e-15)
    np.testing.assert_allclose(distance_to_boundaries(RING, ["in"], straight), 0, atol=1e-15)
    outer = mesh.points[mesh.boundary_nodes("out")]
    assert (outer[outer[:, 1] < 1, 0] == 2).all()
    curved = outer[outer[:, 1] > 1]
    np.testing.assert_allclose(np.linalg.norm(curved - [0, 1], axis=1), 2, rtol=1e-15)
    relative = edge_lengths(mesh, "in") * ratio / 0.4
    assert relative.max() < 1.5 and relative.min() > 0.4
    assert am.mesh.quality(mesh).min_angle > 15


def test_crossing_outlines_are_refused():
    # the arc dips through the edge opposite
    with pytest.raises(ValueError, match=r"edges 0 \('b'\) and 2 \('t'\) meet"):
        am.Outline(
            vertices=((0, 0), (4, 0), (4, 0.5), (0, 0.5)),
            boundaries=("b", "r", "t", "l"),
            arcs={2: (2, 4)},
        )
    # or through a neighbour, near the vertex they share, wherever that lies
    rng = np.random.default_rng()
    for _ in range(20):
        turn, part, centre = (
            rng.uniform(0, 7),
            10 ** rng.uniform(-6, -0.5),
            rng.uniform(-9, 9, 2),
        )
        first, last, tangent = (
            np.array([np.cos(a), np.sin(a)]) for a in (turn, turn + 1, turn + 0.5 * np.pi)
        )
        around = [
            4 * np.array([[np.cos(a), -np.sin(a)], [np.sin(a), np.cos(a)]]) @ tangent
            for a in (2.0, 4.0, 0.5 * part)
        ]
        vertices = [centre + p for p in (first, last, *(first + p for p in around))]
        with pytest.raises(ValueError, match=r"edges 0 \('b'\) and 4 \('l'\) meet"):
            am.Outline(vertices=vertices, boundaries=("b", "r", "t", "s", "l"), arcs={0: centre})


def test_holes_outside_the_outer_edge_are_refused():
    for x in (5.0, 0.0):
        hole = ((x + 1, 1), (x + 1, 2), (x + 2, 2), (x + 2, 1))
        corners = (((0, 0), (4, 0), (4, 4), (0, 4)), hole)
        if x:
            with pytest.raises(
                ValueError, match="holes: the hole from vertex 4 on lies outside the outer edge"
            ):
                am.Outline(vertices=sum(corners, ()), boundaries=("a",) * 8, holes=(4,))
        else:
            assert (
                am.Outline(vertices=sum(corners, ()), boundaries=("a",) * 8, holes=(4,)).area == 15
            )
            inner = tuple((1.25 + 0.5 * (p - 1), 1.25 + 0.5 * (q - 1)) for p, q in hole)
            with pytest.raises(ValueError, match="or in another hole"):
                am.Outline(
                    vertices=sum((*corners, inner), ()), boundaries=("a",) * 12, holes=(4, 8)
                )


def test_each_body_is_meshed_apart_and_without_contact_alone():
    mesh = am.mesh.graded(
        TWO, {"upper": 0.2, "lower": 0.4}, ("upper.bottom", "lower.top"), {"upper": 4, "lower": 2}
    )
    assert (
        am.mesh.check_mesh(mesh, TWO.boundaries) is mesh
        and mesh.bodies == TWO.bodies
        and mesh.source.nv == mesh.n_nodes
    )
    alone = in_sweep_order(
        am.mesh.merged(
            {
                "upper": am.mesh.graded(UPPER, 0.2, "bottom", 4),
                "lower": am.mesh.graded(LOWER, 0.4, "top", 2),
            }
        )
    )
    np.testing.assert_array_equal(mesh.points, alone.points)
    np.testing.assert_array_equal(mesh.elements, alone.elements)
    mesh = am.mesh.graded(TWO, 0.4, "upper.bottom", 8)
    assert (
        edge_lengths(mesh, "upper.bottom").max() < 0.08
        and edge_lengths(mesh, "lower.top").min() > 0.2
    )


def test_fine_where_balls_touch():
    h, radius = 1e-5, 2e-4
    mesh = am.mesh.sized(BALL_ON_BLOCK, am.SizeNear([(0.0, 0.0)], size=h, radius=radius), 1e-3)
    for name in ("ball.arc", "block.top"):
        facets = mesh.boundary_facets(name)
        near = np.linalg.norm(mesh.points[facets].mean(axis=1), axis=1) < radius
        assert near.sum() > 15 and 0.45 * h < edge_lengths(mesh, name)[near].min()
        assert edge_lengths(mesh, name)[near].max() < 1.45 * h
    assert off_circle(mesh, "ball.arc", (0, 8e-3), 8e-3) < 1e-15
    assert (
        mesh.n_nodes < 4000
        and am.mesh.quality(mesh).min_angle > 15
        and am.mesh.quality(mesh).h_max > 0.7e-3
    )


def test_sizes_near_points_grow_with_the_distance():
    field = am.SizeNear([(0, 0), (4, 0)], size=0.1, radius=1.0, grading=0.5)
    places = np.array([[0.5, 0], [2, 0], [4, 3]])
    np.testing.assert_allclose(field(places), [0.1, 0.6, 1.1])
    assert hash(field) == hash(
        am.SizeNear(((0.0, 0.0), (4.0, 0.0)), size=0.1, radius=1.0, grading=0.5)
    )
    np.testing.assert_allclose(field.scaled(0.3)(places), 0.3 * field(places), rtol=1e-14)


test_refuses = refused(
    (lambda: am.mesh.merged({}), "meshes is empty"),
    (lambda: am.mesh.merged({"a": am.mesh.structured(TWO, 1)}), r"has 2 bodies \(upper, lower\)"),
    (
        lambda: am.mesh.merged(
            {"a": am.mesh.structured(UPPER, 1), "b": am.mesh.structured(BOXES.parts["a"], 1)}
        ),
        "same dimension",
    ),
    (
        lambda: am.mesh.structured(TWO, {"upper": 2}),
        "divisions must name each body once: the bodies are 'upper'",
    ),
    (lambda: am.mesh.structured(UPPER, {"upper": 2}), TypeError, "for an Assembly only"),
    (
        lambda: am.mesh.structured(am.Assembly(parts={"disk": DISK}), 2),
        TypeError,
        "graded meshes other domains",
    ),
    (lambda: am.mesh.graded(TWO, {"upper": 1.0}), "size must name each body once"),
    (
        lambda: am.mesh.graded(TWO, 1.0, "bottom", 2),
        r"'bottom' does not exist; the boundaries are upper\.bottom",
    ),
    (
        lambda: am.mesh.graded(TWO, 1.0, "upper.bottom", {"upper": 2, "lower": 2}),
        "contact_boundaries is empty: without contact and ties am.mesh.sized",
    ),
    (lambda: am.mesh.sized(TWO, {"upper": 0.1}, 1.0), "size_function must name each body once"),
    (
        lambda: am.mesh.sized(UPPER, am.SizeNear([(0, 0, 0)], size=0.1), 1.0),
        "are 3D, the mesh is 2D",
    ),
    (lambda: am.SizeNear([], size=1.0), "at least one point"),
    (lambda: am.SizeNear([(0, 0), (0, 0, 0)], size=1.0), "same dimension"),
    (lambda: am.SizeNear([(0, 0)], size=1.0, grading=2), "grading must be at most 1"),
    (lambda: am.SizeNear([(0, 0)], size=1.0).scaled(0.0), "factor must be > 0"),
    (
        lambda: am.SizeNear([(0, 0)], size=1.0, grading=0.4).scaled(3),
        "factor must be at most 2.5, .* give SizeNear a grading of at most 1 / factor",
    ),
)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("sides", "divisions", "square"),
    [
        ((1.0, 1.0), (4, 13), (7, 7)),
        ((10.0, 1.0), (2, 8), (13, 1)),
        ((2.0, 1.0, 1.0), (4, 2, 7), (6, 3, 3)),
    ],
)
def test_stretched_cells_are_warned_of_with_divisions_that_are_not(sides, divisions, square):
    scale = 10.0 ** np.random.default_rng(5).uniform(-3, 3)
    names = ("width", "height") if len(sides) == 2 else ("width", "depth", "height")
    lengths = {name: scale * side for name, side in zip(names, sides, strict=True)}
    domain = am.Rectangle(**lengths) if len(sides) == 2 else am.Box(**lengths)
    problem = replace(
        am.cases.greco_bar() if len(sides) == 2 else am.cases.greco_block(), domain=domain
    )
    for act in (
        lambda: am.mesh.structured(domain, divisions),
        lambda: am.Hierarchy.uniform(problem, [2, divisions]),
    ):
        with pytest.warns(UserWarning, match=re.escape(f"divisions {square}")) as caught:
            act()
        assert len(caught) == 1 and caught[0].filename == __file__
    am.mesh.structured(domain, square)
