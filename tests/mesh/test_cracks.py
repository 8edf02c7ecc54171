"""Bodies with cracks: both faces have nodes of their own, tips are shared, and transfers keep to
one side."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import rotation
from refused import refused

import adaptmg as am
from adaptmg.mesh.soundness import check_overlap

PLATE = am.Rectangle(width=4, height=3)


def turned(points, angle, shift):
    c, s = np.cos(angle), np.sin(angle)
    return (np.array(points) @ np.array([[c, s], [-s, c]]) + shift).tolist()


def plate(rng):
    """A plate with a round hole, and cracks: kinked inside, from the hole, from a corner, and one
    that branches off."""
    at = rng.uniform(0, 7), rng.uniform(-9, 9, 2)
    body = am.Cut(
        am.Polygon(
            vertices=turned([(0, 0), (4, 0), (4, 3), (0, 3)], *at), boundaries=tuple("abcd")
        ),
        am.Circle(tuple(*turned([(3, 1)], *at)), 0.4, "hole"),
    )
    paths = {
        "kinked": [(0.5, 2), (1.5, 2.2), (2, 1.5)],
        "hole": [(3, 1.4), (3, 2)],
        "corner": [(0.4, 0.6), (0, 0)],
        "branch": [(1.5, 2.2), (1.7, 2.7)],
    }
    return am.Cracked(body, {name: turned(path, *at) for name, path in paths.items()})


def faces(mesh, name):
    """Nodes of both faces, each along the path."""
    left, right = (mesh.boundary_facets(f"{name}.{side}") for side in ("left", "right"))
    return left, right[:, ::-1]


@pytest.mark.parametrize("mesher", ["own", "netgen"])
def test_cracks_are_meshed_with_two_faces_that_share_tips(mesher):
    domain = plate(np.random.default_rng())
    names = [name for name in domain.boundaries if "kinked" in name or "hole." in name]
    mesh = am.mesh.graded(domain, 0.4, names, 3, mesher=mesher)
    check_overlap(am.mesh.check_mesh(replace(mesh), domain.boundaries))
    assert am.mesh.quality(mesh).min_angle > 15
    assert mesh.volumes.sum() == pytest.approx(domain.domain.outline.area, rel=0.01)
    # nodes at one place: three at the branch, as many as faces meet there
    copies = {
        name: sorted(np.sum(np.abs(mesh.points - p).max(axis=1) < 1e-12) for p in path)
        for name, path in domain.cracks.items()
    }
    assert copies == {"kinked": [1, 1, 3], "hole": [1, 2], "corner": [1, 2], "branch": [1, 3]}
    for name, path in domain.cracks.items():
        left, right = faces(mesh, name)
        places = [sorted(mesh.points[facets].reshape(-1, 4).tolist()) for facets in (left, right)]
        assert places[0] == places[1]
        length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
        assert mesh.surface(f"{name}.left").measures.sum() == pytest.approx(length)
        # the left face lies to the left of the path: its outward normal points to the right
        along = np.array(path[1]) - path[0]
        first = np.argmin(np.linalg.norm(mesh.points[left].mean(axis=1) - path[0], axis=1))
        assert mesh.surface(f"{name}.left").vectors[first] @ [along[1], -along[0]] > 0
    for level in am.mesh.refine_near(mesh, names, 2)[1:]:
        am.mesh.check_mesh(replace(level), domain.boundaries)


def test_polygons_are_cracks_of_solids():
    rng = np.random.default_rng()
    turn = rotation(rng.normal(size=3))
    square = np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]) @ turn.T + (3, 3, 3)
    # this one reaches through the side
    half = [(4.5, 2, 5), (13.5, 2, 5), (13.5, 5, 5), (4.5, 5, 5)]
    domain = am.Cracked(am.Box(width=6, depth=6, height=7), {"square": square, "half": half})
    mesh = am.mesh.graded(domain, 2, ("square.left", "square.right"), 4)
    am.mesh.check_mesh(replace(mesh), domain.boundaries)
    for name, area, normal in (("square", 4, turn[:, 2]), ("half", 4.5, (0, 0, 1))):
        left, right = (mesh.surface(f"{name}.{side}") for side in ("left", "right"))
        np.testing.assert_allclose(left.vectors.sum(axis=0), area * np.array(normal), atol=1e-9)
        np.testing.assert_allclose(left.vectors.sum(axis=0), -right.vectors.sum(axis=0))
    front = mesh.points[
        np.intersect1d(*(mesh.boundary_nodes(f"square.{side}") for side in ("left", "right")))
    ]
    np.testing.assert_allclose(np.abs((front - 3) @ turn).max(axis=1), 1, atol=1e-9)
    fine = am.mesh.refine_near(mesh, "square.left")[-1]
    assert fine.surface("square.left").measures.sum() == pytest.approx(4)


def test_a_mesh_is_split_along_facets():
    cube = am.mesh.structured(am.Box(width=1, depth=1, height=1), 4)
    inside = np.abs(cube.points[cube.elements] - 0.5).max(axis=(1, 2)) < 0.3
    assert inside.any()
    top = [
        f
        for e in cube.elements
        for f in (e[[1, 2, 3]], e[[0, 3, 2]], e[[0, 1, 3]], e[[0, 2, 1]])
        if (cube.points[f, 2] == 0.5).all() and (np.abs(cube.points[f, :2] - 0.5) <= 0.25).all()
    ]
    down = [f for f in top if np.cross(*(cube.points[f[1:]] - cube.points[f[0]]))[2] < 0]
    cracked = am.mesh.split(cube, down, "disc")
    assert (
        cracked.n_nodes == cube.n_nodes + 1
        and cracked.surface("disc.left").normals[:, 2].max() == -1
    )
    assert (
        len(cracked.boundary_facets("disc.left"))
        == len(cracked.boundary_facets("disc.right"))
        == 8 - 2
    )


CUBE, TRIANGLE = (
    am.Box(width=1, depth=1, height=1),
    [(0.3, 0.3, 0.5), (0.7, 0.3, 0.5), (0.5, 0.7, 0.5)],
)
SQUARE = am.mesh.structured(am.Rectangle(width=1, height=1), 4)
test_refused = refused(
    (
        lambda: am.Cracked(am.StepFile("a.step"), {}),
        TypeError,
        "domain must be a Box or another solid",
    ),
    (
        lambda: am.Cracked(am.Cracked(PLATE, {"a": [(1, 1), (2, 2)]}), {"b": [(1, 2), (2, 1)]}),
        "domain is cracked",
    ),
    (lambda: am.Cut(PLATE, am.Cracked(PLATE, {"a": [(1, 1), (2, 2)]})), "b is cracked"),
    (lambda: am.Moved(am.Cracked(CUBE, {"a": TRIANGLE})), "got a cracked"),
    (lambda: am.Cracked(CUBE, {"a": [*TRIANGLE, (0.5, 0.5, 0.6)]}), "corners of a plane polygon"),
    (lambda: am.Cracked(CUBE, {"a": [TRIANGLE[0], *TRIANGLE]}), r"cracks\['a'\].*edge 0"),
    (
        lambda: am.Cracked(CUBE, {"a": [(0, 0, 0), (1, 1, 0), (1, 0, 0), (0, 1, 0)]}),
        r"cracks\['a'\]",
    ),
    (lambda: am.mesh.graded(am.Cracked(CUBE, {"a": np.add(TRIANGLE, 3)}), 0.3), "lies outside"),
    (
        lambda: am.mesh.graded(
            am.Cracked(CUBE, {"a": [(-1, -1, 0.5), (2, -1, 0.5), (2, 2, 0.5), (-1, 2, 0.5)]}), 0.3
        ),
        "2 pieces",
    ),
    (lambda: am.Cracked(PLATE, {}), "name one crack"),
    (lambda: am.Cracked(PLATE, {"a": [(1, 1)]}), "2 points or more"),
    (lambda: am.Cracked(PLATE, {"a": [(1, 1), (5, 1)]}), r"cracks\['a'\] leaves the body|meet"),
    (lambda: am.Cracked(PLATE, {"a": [(1, 1), (1, 1), (2, 1)]}), "twice in a row"),
    (lambda: am.Cracked(PLATE, {"a": [(1, 0), (1, 3)]}), "in two"),
    (lambda: am.Cracked(PLATE, {"a": [(1, 1), (2, 1), (2, 2), (1, 1)]}), "in two"),
    (
        lambda: am.Cracked(PLATE, {"a": [(1, 1), (2, 2)], "b": [(1, 2), (3, 1)]}),
        r"cracks: edges .* meet",
    ),
    (lambda: am.Cracked(PLATE, {"a": [(1, 0), (2, 0)]}), "meet|leaves|in two"),
    (
        lambda: am.Cracked(
            am.Polygon(vertices=[(0, 0), (1, 0), (0, 1)], boundaries=("a.left", "b", "c")),
            {"a": [(0.2, 0.2), (0.3, 0.3)]},
        ),
        "other names",
    ),
    (lambda: am.mesh.split(SQUARE, [[11, 12]]), "nothing opens"),
    (lambda: am.mesh.split(SQUARE, [[0, 1], [1, 2]]), "between two elements|twice"),
    (lambda: am.mesh.split(SQUARE, [[10, 11], [11, 12], [12, 13], [13, 14]]), "2 pieces"),
)
