"""Plane domains triangulated without Netgen: sound, Delaunay, of the sizes asked for, whatever the
outline."""

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

import adaptmg as am
from adaptmg._numba import kernel
from adaptmg.geometry import predicates
from adaptmg.mesh.delaunay import Untriangulated, of_boundary
from adaptmg.mesh.sizes import distance_to_boundaries, equilateral_sizes

SQUARE = am.Rectangle(width=1, height=1)


def polygon(*vertices):
    """A polygon whose edges are called a, b, ..."""
    return am.Polygon(vertices=vertices, boundaries=tuple("abcdefgh"[: len(vertices)]))


def with_arc(edge, about, *vertices):
    """A polygon one of whose edges is an arc, its centre put right between the ends."""
    a, b, centre = (np.array(p) for p in (vertices[edge], vertices[edge + 1], about))
    along = (b - a) / np.linalg.norm(b - a)
    return am.Outline(
        vertices=vertices,
        boundaries=tuple("abcdefgh"[: len(vertices)]),
        arcs={edge: tuple(centre - ((centre - 0.5 * (a + b)) @ along) * along)},
    )


# nodes on slanted edges are in line up to rounding
SLANTED = {
    "triangle": polygon((0.8, 0.3), (-0.6, 0.5), (-0.4, -0.9)),
    "quadrilateral": polygon((0.7, 0.4), (-0.8, 0.2), (-0.7, -0.1), (-0.1, -0.7)),
    "pentagon with arc": with_arc(
        3,
        (-0.54467, -1.07770),
        (0.93529, 0.13639),
        (0.43434, 0.68010),
        (-0.72089, 0.27870),
        (-0.55938, -0.36188),
        (-0.10880, -0.50969),
    ),
}
DOMAINS = {
    "square": SQUARE,
    "angle": polygon((0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)),
    "two holes": am.Cut(
        am.Cut(am.Rectangle(width=4, height=4), am.Circle((1, 2), 0.5, "first")),
        am.Circle((3, 2), 0.9, "second"),
    ),
    "narrow ring": am.Cut(am.Circle((0, 0), 1, "outer"), am.Circle((0.45, 0), 0.54, "inner")),
    "cusp": am.Outline(
        vertices=((0, 0), (1, 0), (1, 1)), boundaries=("bottom", "right", "arc"), arcs={2: (0, 1)}
    ),
    "slot": polygon(
        (0, 0), (0.5, 0), (0.5, 0.5), (0.500001, 0.5), (0.500001, 0), (1, 0), (1, 1), (0, 1)
    ),
    "needle": polygon((0, 0), (1, 0), (1, 1e-4)),
    "strip": am.Rectangle(width=1, height=1e-5),
}


@pytest.fixture(autouse=True)
def _no_netgen(caplog):
    caplog.set_level("INFO", "adaptmg")
    yield
    assert "Netgen" not in caplog.text


@pytest.mark.parametrize("size", [0.3, 0.05])
@pytest.mark.parametrize("domain", DOMAINS.values(), ids=DOMAINS)
def test_meshes_are_sound_and_delaunay(domain, size):
    mesh = am.mesh.graded(domain, size)
    # by what it is, not by what it says
    am.mesh.check_mesh(replace(mesh), domain.boundaries)
    outline = getattr(domain, "outline", domain)
    for name in dict.fromkeys(outline.boundaries):
        away = distance_to_boundaries(outline, [name], mesh.points[mesh.boundary_nodes(name)])
        assert away.max() < 2e-15
    for vertex in getattr(outline, "vertices", SQUARE.outline.vertices if domain is SQUARE else ()):
        assert (mesh.points == vertex).all(axis=1).sum() == 1
    if domain in (SQUARE, DOMAINS["angle"], DOMAINS["two holes"]):
        assert am.mesh.quality(mesh).min_angle > 28
        # the mean ratio is 1 for equilateral triangles, .985 where nodes are not moved
        edges = mesh.points[mesh.elements] - mesh.points[np.roll(mesh.elements, 1, axis=1)]
        ratios = 4 * np.sqrt(3) * mesh.volumes / np.square(edges).sum(axis=(1, 2))
        assert ratios.mean() > (0.99 if size == 0.05 else 0.95)


@pytest.mark.parametrize("domain", SLANTED.values(), ids=SLANTED)
def test_slanted_outlines_are_meshed_wherever_they_lie(domain):
    rng = np.random.default_rng()
    for scale, offset in ((1.0, 0.0), (1.0, 0.0), *10.0 ** rng.uniform((-6, -1), (6, 5), (8, 2))):
        turned = (
            domain
            if offset == 0
            else moved(domain, rng.uniform(0, 7), scale, offset * rng.normal(size=2))
        )
        for size in (0.2, 0.1, 0.05, 0.02):
            mesh = am.mesh.graded(turned, size * scale)
            am.mesh.check_mesh(replace(mesh), turned.boundaries)
            assert am.mesh.quality(mesh).min_angle > 15
            assert set(turned.vertices) <= set(map(tuple, mesh.points.tolist()))


def moved(domain, angle, scale, offset):
    """An outline turned, scaled, and moved by so many sizes."""
    turn = scale * np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    vertices = [tuple(turn @ p + scale * offset) for p in domain.vertices]
    if isinstance(domain, am.Polygon):
        return replace(domain, vertices=vertices)
    return with_arc(3, turn @ domain.arcs[3] + scale * offset, *vertices)


@kernel(cache=False)
def signs(points):
    """Of both predicates."""
    return np.sign(predicates.turn(points, 0, 1, 2)), np.sign(
        predicates.in_circle(points, 0, 1, 2, 3)
    )


def rational_signs(points):
    """The same in rational numbers, from the usual determinants."""
    x, y = ([Fraction(value) for value in column] for column in points.T.tolist())
    rows = [(x[i] - x[3], y[i] - y[3], (x[i] - x[3]) ** 2 + (y[i] - y[3]) ** 2) for i in range(3)]
    (a, b, c), (d, e, f), (g, h, i) = rows
    values = (
        (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0]),
        a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g),
    )
    return tuple((value > 0) - (value < 0) for value in values)


def test_predicates_are_exact():
    rng = np.random.default_rng()
    for _ in range(100):
        a, b, centre = rng.normal(size=(3, 2)) * 10 ** rng.uniform(-3, 3)
        angles = rng.uniform(0, 7, 4)
        for points in (
            a + rng.random((4, 1)) * (b - a),
            rng.integers(-3, 4, (4, 2)) * 0.1,
            centre + np.column_stack([np.cos(angles), np.sin(angles)]),
        ):
            places = points * 10.0 ** rng.integers(-8, 8)
            assert signs(places) == rational_signs(places)


def test_a_node_that_lies_on_another_is_named():
    corners = np.array([[0, 0], [1, 0], [1, 1], [0.3, 0.4], [0, 1], [0.3, 0.4]])
    edges = np.column_stack([range(6), [1, 2, 3, 4, 5, 0]])
    with pytest.raises(Untriangulated, match=r"0\.3 0\.4"):
        of_boundary(corners, edges)


def test_triangles_at_short_edges_are_not_flat():
    chamfered = polygon((0, 0), (1, 0), (1, 0.98), (0.98, 1), (0, 1))
    mesh = am.mesh.graded(chamfered, 0.2)
    assert am.mesh.quality(mesh).min_angle > 25
    assert mesh.n_nodes < 2 * am.mesh.graded(SQUARE, 0.2).n_nodes


@pytest.mark.parametrize("thickness", [0.1, 0.01])
def test_one_good_triangle_fits_across_thin_parts(thickness):
    x, y, turn = np.random.default_rng().uniform(-5, 5, 3)
    arm = polygon(
        *(
            (
                3 * np.cos(turn) * a - np.sin(turn) * b + x,
                3 * np.sin(turn) * a + np.cos(turn) * b + y,
            )
            for a, b in ((0, 0), (1, 0), (1, thickness), (0, thickness))
        )
    )
    for domain in (
        am.Cut(am.Circle((x, y), 1, "out"), am.Circle((x, y), 1 - thickness, "in")),
        arm,
    ):
        for size in (0.5, 0.1):
            mesh = am.mesh.graded(domain, size)
            assert am.mesh.quality(mesh).min_angle > 15 and mesh.n_nodes < 30 / thickness + 200


def test_flat_triangles_are_reported_far_coordinates_refused():
    for name in ("needle", "strip"):
        with pytest.warns(
            UserWarning, match=r"triangles are up to \d+ times as long as high: .* is thin"
        ):
            am.mesh.graded(DOMAINS[name], 0.3)
    far = moved(SLANTED["triangle"], 1.0, 1.0, np.array([1e14, 0]))
    with pytest.raises(ValueError, match="move it nearer to the origin"):
        am.mesh.graded(far, 0.3)


def test_slits_do_not_ask_for_many_nodes():
    # the sides of the slit are apart by a millionth, and have different numbers of nodes
    slit = polygon(
        (0, 0), (0.5, 0), (0.48, 0.5), (0.480001, 0.52), (0.500001, 0), (1, 0), (1.1, 1), (0, 1)
    )
    mesh = am.mesh.graded(moved(slit, 1.0, 1.0, np.zeros(2)), 0.1)
    am.mesh.check_mesh(replace(mesh))
    assert mesh.n_nodes < 1000


def test_dips_and_jumps_of_a_size_function_are_met():
    places = np.array([[0.31, 0.62], [0.7, 0.3]])

    def dips(x):
        return np.min(
            [0.002 + 0.3 * np.maximum(np.linalg.norm(x - p, axis=1) - 0.06, 0) for p in places],
            axis=0,
        )

    mesh = am.mesh.sized(SQUARE, dips, 0.2)
    assert am.mesh.sized(SQUARE, lambda x: np.ones(len(x)), 0.1).element_sizes.max() < 0.2
    for place in places:
        assert np.sort(np.linalg.norm(mesh.points - place, axis=1))[1] < 0.004
    # holes in the field, far narrower than the elements around them: seen at nodes and centroids,
    # half of them are met
    discs = np.random.default_rng(0).uniform(0.1, 0.9, (12, 2))
    met = [
        am.mesh.sized(
            SQUARE, lambda x, p=p: np.where(np.linalg.norm(x - p, axis=1) < 0.06, 0.01, 0.2), 0.2
        ).n_nodes
        > 200
        for p in discs
    ]
    assert sum(met) >= 8
    jump = am.mesh.sized(SQUARE, lambda x: np.where(x[:, 0] < 0.5, 0.01, 0.2), 0.2, grading=0.2)
    # beyond the jump sizes grow by a fifth of the distance, until the next side
    x, sizes = (
        jump.points[jump.elements].mean(axis=1)[:, 0],
        equilateral_sizes(jump.points, jump.elements),
    )
    beyond = (x > 0.52) & (x < 0.8)
    assert (sizes[beyond] < 1.8 * (0.01 + 0.2 * (x[beyond] - 0.5))).all() and sizes.max() > 0.07


def test_too_many_nodes_are_refused_before_they_are_made():
    for size in (lambda x: np.full(len(x), 1e-5), lambda x: 1e-7 + 0.02 * np.abs(x[:, 0] - 0.5)):
        with pytest.raises(
            ValueError, match=r"the sizes ask for about .* nodes \(at most 5e\+06\)"
        ):
            am.mesh.sized(SQUARE, size, 0.1)


def test_a_fine_rim_does_not_ask_for_its_size_all_over():
    """55 000 nodes were refused as 7 million."""
    corners = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))
    rim = am.Outline(
        vertices=corners, boundaries=("rim",) * 4, arcs=dict.fromkeys(range(4), (0, 0))
    )
    assert am.mesh.graded(rim, 1 / 31, "rim", 55).n_nodes < 60_000
