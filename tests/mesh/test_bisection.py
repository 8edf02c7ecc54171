"""Bisection: conforming from any mesh, bounded shapes, labels follow, also through files; new nodes
go onto arcs."""

import math
from dataclasses import replace

import bisected_meshes
import numpy as np
import pytest
from bisected_meshes import SQUARE, crooked, cube, random_mask, verified

import adaptmg as am
from adaptmg.mesh.arrays import Refinement
from adaptmg.mesh.bisection import refined, with_refinement
from adaptmg.mesh.sizes import distance_to_boundaries
from adaptmg.solver import store


def split(mesh):
    """The mesh with two bodies that are glued."""
    return am.mesh.check_mesh(
        replace(
            mesh,
            bodies=("west", "east"),
            element_body=mesh.points[mesh.elements, 0].mean(axis=1) > 0.5,
        )
    )


MESHES = {
    "2D": SQUARE,
    "2D crooked": split(crooked(SQUARE)),
    "3D": cube(),
    "3D crooked": split(crooked(cube(2))),
}
EACH = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
SIDES = {"left": (0, 0), "right": (0, 1), "bottom": (-1, 0), "top": (-1, 1)}


def everything(mesh):
    return np.ones(len(mesh.elements), dtype=bool)


@EACH
@pytest.mark.parametrize("passes", [None, 1, 2])
def test_random_marks_again_and_again_stay_conforming(mesh, passes):
    for k in range(12):
        before = mesh
        marked = random_mask(mesh, 0.1, k)
        mesh, parents = am.mesh.bisect(mesh, marked, passes)
        verified(mesh)
        np.testing.assert_array_equal(mesh.points, mesh.points[parents].mean(axis=1))
        np.testing.assert_allclose(
            *(np.bincount(m.element_body, m.volumes) for m in (mesh, before)), rtol=1e-12
        )
        for name, (axis, value) in SIDES.items():
            assert (mesh.points[mesh.boundary_nodes(name), axis] == value).all()
        # those of one old facet lie one after another, in the order of the old ones
        assert (np.diff(mesh.facet_labels) >= 0).all() == (np.diff(before.facet_labels) >= 0).all()
        refinement = mesh.refinement
        assert mesh.n_nodes > before.n_nodes
        assert len(refinement.parents) == mesh.n_nodes and refinement.generation.max() < 100
        if mesh.n_nodes > 6_000:
            break
    assert k >= 2 and before.refinement is not None and replace(mesh).refinement is None


@pytest.mark.parametrize(
    ("corners", "most"),
    [
        ([[0, 0], [1, 0], [0.02, 0.1]], 4),
        *((np.random.default_rng(seed).random((4, 3)), 72) for seed in range(2)),
    ],
    ids=["triangle", "first", "second"],
)
def test_a_simplex_has_a_bounded_number_of_shapes(corners, most):
    mesh, classes, worst = bisected_meshes.single(corners), [], []
    for _ in range(12):
        mesh, _ = am.mesh.bisect(mesh, everything(mesh), passes=1)
        classes.append(bisected_meshes.shape_classes(mesh))
        worst.append(am.mesh.quality(mesh).aspect_ratio)
    assert len(mesh.elements) >= 2**12
    # none is new after eight bisections: Arnold, Mukherjee and Pouly, theorem 3.2 with its remark
    assert max(classes) <= most and worst[-1] <= max(worst[:8]) * (1 + 1e-9)


@EACH
def test_marked_elements_have_all_edges_halved_and_passes_count(mesh):
    marked = random_mask(mesh, 0.15, 5)
    full = refined(mesh, marked)
    children = np.bincount(full.origin, minlength=len(mesh.elements))
    assert (children[marked] >= 2**mesh.dim).all() and (children >= 1).all()
    np.testing.assert_allclose(
        np.bincount(full.origin, full.mesh.volumes), mesh.volumes, rtol=1e-12
    )
    # half an edge, or less where a face was cut twice
    old_edges = mesh.elements[marked][:, [0, 1]]
    halved = {tuple(sorted(p)) for p in full.mesh.refinement.parents[mesh.n_nodes :].tolist()}
    assert {tuple(sorted(edge)) for edge in old_edges.tolist()} <= halved
    for passes in (1, 2, 3):
        some = refined(mesh, marked, passes)
        assert (some.mesh.refinement.generation[marked[some.origin]] >= passes).all()
        few = np.bincount(some.origin, minlength=len(mesh.elements))[marked]
        assert few.min() >= 2**passes and some.mesh.n_nodes > mesh.n_nodes
    once = refined(mesh, marked, 1).mesh
    assert once.n_nodes < full.mesh.n_nodes


FINE_SQUARE = am.mesh.structured(am.Rectangle(width=1, height=1), 4)


def test_refine_near_reaches_strong_grading_without_bad_angles():
    before = FINE_SQUARE.source.nv
    meshes = am.mesh.refine_near(FINE_SQUARE, "bottom", 8)
    assert meshes[0] is FINE_SQUARE and len(meshes) == 9 and FINE_SQUARE.source.nv == before
    np.testing.assert_array_equal([v.point for v in meshes[2].source.vertices], meshes[2].points)
    for level, mesh in enumerate(meshes):
        assert len(mesh.boundary_facets("bottom")) == 4 * 2**level
        assert len(mesh.boundary_facets("top")) == 4
    # the work goes to the boundary: nodes double with every level, uniform refinement would make
    # four times as many
    assert meshes[-1].n_nodes < 2.05 * meshes[-2].n_nodes
    assert am.mesh.quality(meshes[-1]).min_angle > 20
    assert bisected_meshes.containing_elements(meshes[1], meshes[2]).min() >= 0
    assert [
        len(m.boundary_facets("bottom"))
        for m in am.mesh.refine_near(cube(2), ["bottom", "left"], 2)
    ] == [8, 32, 128]
    with pytest.raises(ValueError, match="boundary 'bottm' does not exist"):
        am.mesh.refine_near(FINE_SQUARE, "bottm")


# -- the history in files ----------------------------------------------------------------------------------------------

CROOKED = {"2D": crooked(SQUARE), "3D": crooked(cube(2))}


def thrice(mesh):
    for k in range(3):
        mesh, _ = am.mesh.bisect(mesh, random_mask(mesh, 0.2, k), passes=2)
    return mesh


@pytest.mark.parametrize("mesh", CROOKED.values(), ids=CROOKED)
def test_bisection_goes_on_from_a_file(mesh, tmp_path):
    fine, kinds = thrice(mesh), (am.MeshArrays, Refinement)
    (tmp_path / "mesh.npz").write_bytes(store.packed(fine, kinds, fine.refinement))
    stored = store.read(tmp_path / "mesh.npz", kinds, more=True)
    assert stored.value.refinement is None
    back = with_refinement(stored.value, stored.more)
    marked = random_mask(fine, 0.3, 9)
    first, second = (am.mesh.bisect(m, marked)[0] for m in (fine, back))
    for name in ("points", "elements", "facets", "facet_labels"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))


RING = am.Outline(
    vertices=((1, 0), (2, 0), (0, 2), (0, 1)),
    boundaries=("a", "out", "b", "in"),
    arcs={1: (0, 0), 3: (0, 0)},
)
# straight and round edges of one name, bulging out and in
SHARED = am.Outline(
    vertices=((0, 0), (1, 0), (1, 1), (0, 1)),
    boundaries=("wall", "wall", "top", "wall"),
    arcs={1: (0, 0.5), 3: (-1, 0.5)},
)
# two arcs between the same corners
LENS = am.Outline(
    vertices=((-1, 0), (1, 0)), boundaries=("rim", "rim"), arcs={0: (0, 1), 1: (0, -2)}
)
CONE = am.Polygon(
    vertices=((0, 0), (2, 0), (1, 1), (0, 1)), boundaries=("base", "cone", "lid", "axis")
)
BULGED = am.Outline(
    vertices=((1, 0), (2, 0), (2, 1), (1, 1)),
    boundaries=("floor", "belly", "lid", "bore"),
    arcs={1: (1.5, 0.5)},
)


def refined_onto(domain, mesh, passes=2, part=1.0):
    for k in range(passes):
        fine, _ = am.mesh.bisect(mesh, random_mask(mesh, part, k))
        moved = am.mesh.onto_domain(domain, fine, mesh.n_nodes)
        np.testing.assert_array_equal(moved.points[: mesh.n_nodes], mesh.points)
        np.testing.assert_array_equal(moved.elements, fine.elements)
        assert moved.refinement is fine.refinement
        mesh = verified(moved)
    return mesh


def off_arcs(domain, mesh):
    """The largest distance of a boundary node to the edges that have its name."""
    return max(
        distance_to_boundaries(domain, [name], mesh.points[mesh.boundary_nodes(name)]).max()
        for name in mesh.boundaries
    )


@pytest.mark.parametrize("domain", [RING, SHARED, LENS], ids=["ring", "shared", "lens"])
@pytest.mark.parametrize("part", [1.0, 0.3])
def test_outlines(domain, part):
    coarse = am.mesh.graded(domain, 0.5)
    mesh = refined_onto(domain, coarse, 2, part)
    errors = [abs(m.volumes.sum() - domain.area) for m in (coarse, mesh)]
    # what bulges out and in alike cancels, unless only a part is refined
    assert errors[1] < max(errors[0] / 14, 1e-14) or part < 1
    assert am.mesh.quality(mesh).min_angle > 0.5 * am.mesh.quality(coarse).min_angle
    assert (
        off_arcs(domain, mesh)
        < 1e-14
        < 1e-3
        < off_arcs(domain, am.mesh.bisect(coarse, everything(coarse))[0])
    )


def off(axes, radius, centre=(0, 0)):
    """How far points are from a circle in the plane of two axes."""
    return lambda x: np.linalg.norm(x[:, axes] - centre, axis=1) - radius


def on(axis, value):
    return lambda x: x[:, axis] - value


BALL, CYLINDER = am.Ball((1, 2, 3), 0.2), am.Cylinder((0, 0, 1), (0, 0, 1), 0.5, 1)
BORED = am.Cut(am.Box(width=1, depth=1, height=1), am.Cylinder((0, 0, -1), (0, 0, 1), 0.5, 3))
SLANT, DRILLED_AT = (math.sin(math.pi / 3), 0.0, math.cos(math.pi / 3)), (3, 2, 1.5)
DRILL = am.Cylinder((-2 * SLANT[0], 0, 0.5 - 2 * SLANT[2]), SLANT, 0.25, 4)
DISK = am.Outline(
    vertices=((0, 0), (1, 0), (0, 1)), boundaries=("base", "rim", "axis"), arcs={1: (0, 0)}
)
CONICAL = {
    "cone": lambda x: np.hypot(x[:, 0], x[:, 1]) + x[:, 2] - 2,
    "base": on(2, 0),
    "lid": on(2, 1),
}
# what is zero on the boundaries
SHAPES = {
    "disk and ring": (
        am.Assembly(parts={"disk": DISK, "ring": RING}),
        0.4,
        {"disk.rim": off([0, 1], 1), "ring.in": off([0, 1], 1), "ring.out": off([0, 1], 2)},
    ),
    "ball": (BALL, 0.2, {"surface": lambda x: np.linalg.norm(x - (1, 2, 3), axis=1) - 0.2}),
    "cylinder": (CYLINDER, 0.5, {"side": off([0, 1], 0.5), "bottom": on(2, 1)}),
    # a quarter turn about y takes (x, y, z) to (z, y, -x)
    "turned": (
        am.Moved(CYLINDER, (10, 0, 0), 90, (0, 2, 0)),
        0.5,
        {"side": off([1, 2], 0.5), "bottom": on(0, 11)},
    ),
    "sector of a cone": (am.Revolution(CONE, 120), 1.0, CONICAL),
    "cone": (am.Revolution(CONE), 1.0, CONICAL),
    "sector": (
        am.Revolution(BULGED, 90),
        0.7,
        {
            "belly": lambda x: (
                np.hypot(np.hypot(x[:, 0], x[:, 1]) - 1.5, x[:, 2] - 0.5) - math.sqrt(0.5)
            ),
            "bore": off([0, 1], 1),
            "start": on(1, 0),
            "end": on(0, 0),
        },
    ),
    "bored": (BORED, 0.5, {"side": off([0, 1], 0.5), "front": on(1, 0), "top": on(2, 1)}),
    # the axes of both cylinders meet at 60 degrees: nodes on their crossing lie on both
    "drilled aslant": (
        am.Moved(
            am.Cut(am.Moved(CYLINDER, (0, 0, -1)), DRILL, rename={"b.side": "hole"}), (3, 2, 1)
        ),
        0.3,
        {
            "side": lambda x: np.hypot(x[:, 0] - 3, x[:, 1] - 2) - 0.5,
            "hole": lambda x: (
                np.linalg.norm(np.cross(x - DRILLED_AT, SLANT), axis=1) - DRILL.radius
            ),
        },
    ),
    "prism": (am.Extrusion(RING, 0.5), 0.7, {"in": off([0, 1], 1), "out": off([0, 1], 2)}),
}


@pytest.mark.parametrize(("domain", "size", "zero"), SHAPES.values(), ids=SHAPES)
def test_boundaries_stay_where_they_are(domain, size, zero):
    coarse = am.mesh.graded(domain, size)
    mesh = refined_onto(domain, coarse)
    for name, function in zero.items():
        # on crossings of two surfaces Netgen's nodes miss them by 1e-8
        missed, left = (
            np.abs(function(one.points[one.boundary_nodes(name)])).max() for one in (coarse, mesh)
        )
        assert left <= max(1e-10 * max(1, size), missed)


def test_what_is_not_known_stays_on_the_chord():
    for domain, coarse in (
        (None, am.mesh.graded(BORED, 0.5)),
        (am.Rectangle(width=1, height=1), SQUARE),
    ):
        fine, _ = am.mesh.bisect(coarse, everything(coarse))
        assert am.mesh.onto_domain(domain, fine, coarse.n_nodes) is fine
    # nothing new, nothing moves
    assert am.mesh.onto_domain(RING, fine, fine.n_nodes) is fine


def thin(height):
    """A domain whose floor bulges into it by .5, meshed with a node that far above the floor's
    chord."""
    domain = am.Outline(
        vertices=((-1, 0), (1, 0), (1, 2), (-1, 2)),
        boundaries=("floor", "right", "top", "left"),
        arcs={0: (0, -0.75)},
    )
    points = np.array([*domain.vertices, (0, height)])
    mesh = am.MeshArrays(
        points,
        np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]),
        np.array([[0, 1], [1, 2], [2, 3], [3, 0]]),
        np.arange(4),
        domain.boundaries,
    )
    return domain, am.mesh.check_mesh(mesh)


@pytest.mark.parametrize(("height", "goes"), [(1.0, True), (0.6, False), (0.4, False)])
def test_a_node_that_would_spoil_an_element_stays_on_the_chord(height, goes):
    domain, coarse = thin(height)
    assert domain.arc(0).at(0.5) == pytest.approx((0, 0.5))
    fine, parents = am.mesh.bisect(coarse, np.array([True, False, False, False]), passes=1)
    moved = verified(am.mesh.onto_domain(domain, fine, coarse.n_nodes))
    new = int(np.flatnonzero((parents == [0, 1]).all(axis=1))[0])
    assert (moved is not fine) == goes
    np.testing.assert_allclose(moved.points[new], (0, 0.5 if goes else 0), atol=1e-15)
    assert moved.volumes.min() > 0.2 * fine.volumes.min()
