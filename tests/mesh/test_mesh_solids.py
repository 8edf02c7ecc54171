"""Solids: volumes and names survive combining, nodes lie on the surfaces, sizes are achieved,
failures are named."""

import itertools
import logging
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest
from bisected_meshes import edge_lengths
from refused import refused

import adaptmg as am
import adaptmg.mesh.netgen_meshes as module
from adaptmg.mesh import netgen_worker
from adaptmg.mesh.netgen_guard import Netgen, NetgenFails, netgen
from adaptmg.mesh.netgen_meshes import built_shape, check_volume
from adaptmg.mesh.soundness import check_overlap

PROFILE = am.Polygon(
    vertices=((0.04, 0), (0.1, 0), (0.1, 0.02), (0.06, 0.025), (0.05, 0.08), (0.04, 0.08)),
    boundaries=("gasket", "rim", "back", "neck", "weld", "bore"),
)
QUARTER = am.Outline(
    vertices=((0, 0), (1, 0), (0, 1)), boundaries=("base", "cap", "axis"), arcs={1: (0, 0)}
)
TRIANGLE = am.Polygon(vertices=((0, 0), (2, 0), (0, 1)), boundaries=("long", "slope", "short"))
BALL = am.Ball((0, 0, 1), 1)
PAIRS = list(itertools.combinations(range(4), 2))
UNIT = am.Box(width=1, depth=1, height=1)
OCTANT = am.Common(BALL, UNIT)
HALF = am.Common(BALL, am.Box(width=2, depth=2, height=1, origin=(-1, -1, 0)))
BOLT = am.Fuse(
    am.Cylinder((0, 0, 0), (0, 0, 1), 0.005, 0.03),
    am.Cylinder((0, 0, 0.03), (0, 0, 1), 0.009, 0.006),
    rename={"a.side": "shank", "b.side": "head", "b.bottom": "under", "b.top": "upside"},
)
# Pappus: the volume of a full revolution of a polygon
_X, _Y = np.array(PROFILE.vertices).T
_CROSS = _X * np.roll(_Y, -1) - np.roll(_X, -1) * _Y
FULL = 2 * math.pi * float(np.sum((_X + np.roll(_X, -1)) * _CROSS)) / 6


def shape_of(solid):
    with netgen() as worker:
        return built_shape(worker, solid)


SOLIDS = {
    "box": (UNIT, 1.0),
    "cylinder": (am.Cylinder((1, 2, 3), (1, 1, 0), 0.1, 0.5), 0.005 * math.pi),
    "ball": (am.Ball((1, 2, 3), 0.2), 4 / 3 * math.pi * 0.008),
    "sector": (am.Revolution(PROFILE, 90), FULL / 4),
    "wide sector": (am.Revolution(PROFILE, 250), FULL * 250 / 360),
    "ring": (am.Revolution(PROFILE), FULL),
    "cap sector": (am.Revolution(QUARTER, 90), math.pi / 6),
    "drum": (am.Revolution(am.Rectangle(width=2, height=1)), 4 * math.pi),
    "prism": (am.Extrusion(TRIANGLE, 3, base=-1), 3.0),
    "quarter disc": (am.Extrusion(QUARTER, 2), math.pi / 2),
    "octant": (OCTANT, math.pi / 6),
    "half ball": (HALF, 2 * math.pi / 3),
    "bolt": (BOLT, math.pi * (25e-6 * 0.03 + 81e-6 * 0.006)),
    "moved bolt": (
        am.Moved(BOLT, (1, 2, 3), 40, (1, 1, 0)),
        math.pi * (25e-6 * 0.03 + 81e-6 * 0.006),
    ),
}


# names of faces that combining leaves nothing of; the top of the shank lies inside the head
GONE = {
    "octant": {"bottom", "right", "back"},
    "half ball": {"bottom", "left", "right", "front", "back"},
    "bolt": {"top"},
    "moved bolt": {"top"},
}


@pytest.mark.parametrize("key", SOLIDS)
def test_shapes_have_their_volume_names_and_bounding_box(key):
    solid, volume = SOLIDS[key]
    shape = shape_of(solid)
    assert shape.volume * shape.scale**3 == pytest.approx(volume, rel=1e-8)
    assert set(shape.names) == set(solid.boundaries) - GONE.get(key, set())
    lower, upper = shape.lower + shape.scale * shape.corners
    # the bounds of turned solids are those of their turned boxes
    slack = 1e-6 * shape.scale * (1e6 if key == "moved bolt" else 1)
    assert (lower > solid.lower - 1e-6 * shape.scale).all() and (
        upper < solid.upper + 1e-6 * shape.scale
    ).all()
    assert (lower < solid.lower + slack).any() and (upper > solid.upper - slack).any()
    assert pickle.loads(pickle.dumps(solid)) == solid and hash(solid) == hash(solid)


def test_a_ball_refined_at_its_lowest_point():
    mesh = am.mesh.sized(OCTANT, lambda x: 1e-3 + 0.3 * np.linalg.norm(x, axis=1), 0.25)
    surface = mesh.points[mesh.boundary_nodes("surface")]
    # also the nodes that bisection made lie on the sphere and in the planes of symmetry
    np.testing.assert_allclose(np.linalg.norm(surface - (0, 0, 1), axis=1), 1, rtol=1e-13)
    for name, axis, value in (("left", 0, 0), ("front", 1, 0), ("top", 2, 1)):
        assert (mesh.points[mesh.boundary_nodes(name), axis] == value).all()
    centroids = mesh.points[mesh.elements].mean(axis=1)
    relative = mesh.element_sizes / np.minimum(0.25, 1e-3 + 0.3 * np.linalg.norm(centroids, axis=1))
    assert relative.max() < 3.2 and 0.7 < np.median(relative) < 1.7
    assert am.mesh.quality(mesh).min_angle > 10 and mesh.n_nodes < 2000


@pytest.mark.parametrize(("ratio", "mesher"), [(8, "own"), (50, "own"), (50, "netgen")])
def test_sizes_along_boundaries_are_achieved(ratio, mesher):
    # beyond a ratio of 16 Netgen's mesh is bisected
    punch = am.Fuse(
        UNIT,
        am.Cylinder((0.5, 0.5, 1), (0, 0, 1), 0.1, 0.3),
        rename={"b.side": "shank", "b.top": "tip"},
    )
    mesh = am.mesh.graded(punch, 0.5, "tip", ratio, 0.5, mesher=mesher)
    at_tip = edge_lengths(mesh, "tip") * ratio / 0.5
    assert at_tip.max() < 2.5 and 0.6 < np.median(at_tip) < 1.4
    assert np.median(edge_lengths(mesh, "bottom")) > 0.3
    radius = np.linalg.norm(mesh.points[mesh.boundary_nodes("shank"), :2] - 0.5, axis=1)
    np.testing.assert_allclose(radius, 0.1, rtol=1e-12)


@pytest.mark.parametrize("way", ["oblique", "moved"])
def test_a_slim_bar_has_the_same_mesh_wherever_it_lies(way):
    rng = np.random.default_rng()
    point, axis = rng.normal(size=(2, 3))
    axis /= np.linalg.norm(axis)
    upright = am.Cylinder((0, 0, 0), (0, 0, 1), 1, 20)
    bar = am.Cylinder(tuple(point), tuple(axis), 1, 20)
    if way == "moved":
        angle = math.degrees(math.acos(axis[2]))
        bar = am.Moved(upright, tuple(point), angle, tuple(np.cross((0, 0, 1), axis)))
    assert am.mesh.quality(am.mesh.graded(bar, 1)).min_angle == pytest.approx(
        am.mesh.quality(am.mesh.graded(upright, 1)).min_angle, rel=1e-6
    )
    mesh = am.mesh.sized(bar, lambda x: 0.4 + 0.1 * np.abs((x - point) @ axis), 1.0)
    along = (mesh.points - point) @ axis
    away = np.linalg.norm(mesh.points - point - along[:, None] * axis, axis=1)
    for name, gaps in (("side", away - 1), ("bottom", along), ("top", along - 20)):
        assert np.abs(gaps[mesh.boundary_nodes(name)]).max() < 1e-12
    sizes = np.minimum(0.4 + 0.1 * along[mesh.elements].mean(axis=1), 1.0)
    assert (mesh.element_sizes > 2 * sizes).mean() < 0.05
    assert mesh.element_sizes[sizes < 0.5].max() < 1.0


@pytest.mark.parametrize(
    ("solid", "size"),
    [
        (am.Ball((1, 2, 3), 1), 0.5),
        (am.Cylinder((0, 0, 0), (0, 0, 1), 1, 3), 0.6),
        (am.Fuse(am.Ball((0, 0, 0), 1), am.Ball((1.2, 0, 0), 1)), 0.5),
    ],
    ids=["ball", "bar", "fused"],
)
def test_no_edges_go_through_a_whole_body(solid, size):
    """Netgen leaves coarse round bodies without inner nodes."""
    mesh = am.mesh.graded(solid, size)
    corners = mesh.points[mesh.elements]
    lengths = [np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i, j in PAIRS]
    assert (np.array(lengths) > 2 * size).mean() <= 0.01
    assert am.mesh.quality(mesh).min_angle > 5


def test_flat_elements_are_mended_or_reported():
    # Netgen's elements with all corners on the boundary had angles of 1 degree
    assert (
        am.mesh.quality(
            am.mesh.graded(am.Cylinder((0, 0, 0), (0, 0, 1), 1, 13.7), 1.93, "side", 2)
        ).min_angle
        > 4
    )
    wedge = am.Extrusion(
        am.Polygon(vertices=((0, 0), (1, 0), (1, 0.005)), boundaries=("a", "b", "c")), 0.1
    )
    with pytest.warns(UserWarning, match=r"tetrahedra have angles down to 0\.\d+ degrees"):
        am.mesh.graded(wedge, 0.1)


FILLET = am.Revolution(
    am.Outline(
        vertices=((0.2, 0), (1, 0), (1, 0.2), (0.4, 0.2), (0.3, 0.3), (0.26, 1), (0.2, 1)),
        boundaries=("foot", "rim", "flat", "fillet", "neck", "top", "bore"),
        arcs={3: (0.4, 0.3)},
    ),
    90,
)


def from_fillet(x):
    """Distance from the torus of the fillet, which touches the plane next to it."""
    return np.abs(np.hypot(np.hypot(x[:, 0], x[:, 1]) - 0.4, x[:, 2] - 0.3) - 0.1)


def from_neck(x):
    """Distance from the cone above the fillet."""
    return np.abs(0.7 * (np.hypot(x[:, 0], x[:, 1]) - 0.3) + 0.04 * (x[:, 2] - 0.3)) / np.hypot(
        0.7, 0.04
    )


@pytest.mark.parametrize(
    ("solid", "size", "contact", "gap"),
    [
        (
            am.Cylinder((0, 0, 0), (0, 0, 1), 0.5, 1),
            0.05,
            "bottom",
            {
                "side": lambda x: np.abs(np.hypot(x[:, 0], x[:, 1]) - 0.5),
                "top": lambda x: np.abs(x[:, 2] - 1),
            },
        ),
        (
            OCTANT,
            0.05,
            "surface",
            {"surface": lambda x: np.abs(np.linalg.norm(x - (0, 0, 1), axis=1) - 1)},
        ),
        (
            FILLET,
            0.05,
            "flat",
            {"fillet": from_fillet, "neck": from_neck, "flat": lambda x: np.abs(x[:, 2] - 0.2)},
        ),
    ],
    ids=["cylinder", "octant", "fillet"],
)
def test_a_draft_is_refined_to_the_sizes_on_the_faces(solid, size, contact, gap, caplog):
    with caplog.at_level(logging.INFO, "adaptmg"):
        mesh = am.mesh.graded(solid, size, contact, 1.5)
    assert "is not refined" not in caplog.text
    check_overlap(am.mesh.check_mesh(replace(mesh)))
    for name, distance in gap.items():
        # nodes of Netgen's draft lie on crossings of faces within its tolerance
        assert distance(mesh.points[mesh.boundary_nodes(name)]).max() < 1e-7
    lengths = edge_lengths(mesh, contact) * 1.5 / size
    assert lengths.max() < 2.2 and 0.7 < np.median(lengths) < 1.3
    assert am.mesh.quality(mesh).min_angle > 10
    shape = shape_of(solid)
    assert mesh.volumes.sum() == pytest.approx(shape.volume * shape.scale**3, rel=0.02)


def test_faces_of_an_unknown_kind_are_left_to_netgen(tmp_path, caplog):
    from netgen import occ

    edge = occ.SplineApproximation(
        [occ.Pnt(x, 1 + 0.2 * math.sin(3 * x), 0) for x in np.linspace(0, 1, 9)]
    )
    corners = [
        occ.Pnt(1, 1 + 0.2 * math.sin(3), 0),
        occ.Pnt(1, 0, 0),
        occ.Pnt(0, 0, 0),
        occ.Pnt(0, 1, 0),
    ]
    wire = occ.Wire([edge, *(occ.Segment(a, b) for a, b in itertools.pairwise(corners))])
    occ.Face(wire).Extrude(occ.Vec(0, 0, 1)).WriteStep(str(tmp_path / "wavy.step"))
    with caplog.at_level(logging.INFO, logger=module.__name__):
        mesh = am.mesh.graded(am.StepFile(tmp_path / "wavy.step"), 0.1e-3)
    assert "faces other than planes, cylinders" in caplog.text
    am.mesh.check_mesh(replace(mesh))
    assert 400 < mesh.n_nodes < 8000


def test_a_draft_with_sharp_angles_gives_way(caplog):
    blade = am.Extrusion(
        am.Polygon(vertices=((0, 0), (1, 0), (1, 0.1)), boundaries=("a", "b", "c")), 0.3
    )
    with caplog.at_level(logging.INFO, "adaptmg"):
        mesh = am.mesh.graded(blade, 0.03)
    assert "with sizes times 1.8 is not refined: it has angles of" in caplog.text
    am.mesh.check_mesh(replace(mesh))
    assert mesh.volumes.sum() == pytest.approx(0.015)
    assert (mesh.element_sizes > 0.06).mean() <= 0.01


@pytest.mark.parametrize("failures", [2, 9])
def test_netgen_is_given_a_second_chance(failures, monkeypatch):
    answer, gradings = Netgen.__call__, []

    def fails_first(worker, function, *arguments, seconds):
        if function == "mesh_shape":
            gradings.append(arguments[1]["grading"])
            if len(gradings) <= failures:
                raise NetgenFails("Meshing failed!")
        return answer(worker, function, *arguments, seconds=seconds)

    monkeypatch.setattr(Netgen, "__call__", fails_first)
    if failures == 2:
        assert am.mesh.graded(OCTANT, 0.5, grading=0.5).n_nodes > 10
        np.testing.assert_allclose(gradings, [0.5, 0.35, 0.25])
        return
    with pytest.raises(
        ValueError, match=r"could not mesh Common.*Meshing failed!.*smaller grading"
    ):
        am.mesh.graded(OCTANT, 0.5)


def test_the_volume_check_can_fail():
    shape = shape_of(OCTANT)
    mesh = am.mesh.graded(OCTANT, 0.5 * shape.scale)
    unit = type(mesh)(
        mesh.points / shape.scale, mesh.elements, mesh.facets, mesh.facet_labels, mesh.boundaries
    )
    bound = module._left_by_chords(unit)
    # far from failing even on the coarsest mesh, and not without a limit
    assert abs(unit.volumes.sum() - shape.volume) < 0.6 * bound < 0.5 * shape.volume
    assert check_volume(unit, shape.volume) is None
    for wrong in (shape.volume + 1.7 * bound, 0.98 * (unit.volumes.sum() - bound)):
        with pytest.raises(ValueError, match="of the volume, chords explain"):
            check_volume(unit, wrong)


def test_scaling_changes_nothing_and_meshes_repeat():
    def pin(s):
        return am.Cut(
            am.Cylinder((s, 0, 0), (0, 0, 1), s, s),
            am.Ball((s, 0, s), 0.5 * s),
            rename={"surface": "seat"},
        )

    first, again, large = (am.mesh.graded(pin(s), 0.5 * s, "seat", 2) for s in (1.0, 1.0, 4096.0))
    for name in ("points", "elements", "facets", "facet_labels"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    np.testing.assert_array_equal(first.elements, large.elements)
    np.testing.assert_allclose(first.points * 4096, large.points, rtol=1e-11, atol=1e-11)
    assert first.boundaries == ("side", "bottom", "top", "seat")


def test_renaming():
    hole = am.Cylinder((0.5, 0.5, -1), (0, 0, 1), 0.2, 3)
    one = am.Cut(UNIT, hole, rename={"top": "lid", "b.top": "end", "b.side": "hole"})
    assert one.boundaries == ("bottom", "right", "lid", "left", "front", "back", "hole", "end")
    assert set(shape_of(one).names) == {*one.boundaries} - {"end"}
    # sides beyond the ball are left out; that it touches the bottom in a point is not seen
    half = am.Common(BALL, am.Box(width=4, depth=4, height=1, origin=(-2, -2, 0)))
    assert half.boundaries == ("surface", "bottom", "top")
    assert set(shape_of(half).names) == {"surface", "top"}
    # faces that coincide have the name given by the first solid
    flush = am.Cut(UNIT, am.Box(width=0.5, depth=1, height=1), rename={"b.right": "cut"})
    assert set(shape_of(flush).names) == {*UNIT.boundaries, "cut"} - {"left"}
    names = shape_of(
        am.Fuse(
            UNIT, am.Box(width=1, depth=1, height=1, origin=(0, 0, 1)), rename={"b.front": "face"}
        )
    ).names
    assert (
        {"front", "face"} <= set(names) and names.count("top") == 1 and names.count("bottom") == 1
    )


test_refused = refused(
    (lambda: am.Cylinder((0, 0, 0), (0, 0, 0), 1, 1), "axis must not be zero"),
    (lambda: am.Revolution(PROFILE, 361), "angle must be at most 360"),
    (lambda: am.Revolution(am.Rectangle(width=1, height=1, origin=(-0.1, 0))), "half plane r >= 0"),
    (
        lambda: am.Revolution(
            am.Polygon(vertices=((0, 0), (1, -1), (1, 1)), boundaries=("a", "b", "c"))
        ),
        "axis at the single vertex 0",
    ),
    (
        lambda: am.Revolution(
            am.Polygon(vertices=((1, 0), (2, 0), (2, 1)), boundaries=("start", "b", "c")), 90
        ),
        "must not be called 'start'",
    ),
    (lambda: am.Extrusion(am.Rectangle(width=1, height=1), 1), "must not be called 'bottom'"),
    (lambda: am.Cut(UNIT, BALL, rename={"c.top": "x"}), "the keys of rename must be one of"),
    (lambda: am.Moved(UNIT, axis=(0, 0, 0)), "axis must not be zero"),
    (lambda: am.StepFile("a.step", names={"solid1": "a.b"}), "must not contain '.'"),
    (lambda: am.mesh.graded(OCTANT, 0.5, "bottom", 5), "of boundary 'bottom' no face is left"),
    (
        lambda: am.mesh.graded(OCTANT, 1, "surfac", 10),
        "boundary 'surfac' does not exist; the boundaries are surface, bottom",
    ),
    (lambda: am.mesh.graded(OCTANT, 1, "surface", 1e4), "nodes .at most 2e"),
    (
        lambda: am.mesh.graded(
            am.Cut(UNIT, am.Box(width=3, depth=3, height=3, origin=(-1, -1, -1))), 1
        ),
        "leaves nothing",
    ),
    (
        lambda: am.mesh.graded(
            am.Cut(UNIT, am.Box(width=0.2, depth=3, height=3, origin=(0.4, -1, -1))), 1
        ),
        "leaves 2 pieces",
    ),
)


def test_a_boolean_operation_that_fails_is_noticed(monkeypatch):
    # OCC says nothing when an operation fails
    monkeypatch.setattr(netgen_worker.occ, "Fuse", lambda parts: parts[0])
    with pytest.raises(ValueError, match=r"volumes do not add up \(0.25 instead of 1\)"):
        netgen_worker.build_shape(
            am.Fuse(
                am.Box(width=0.25, depth=1, height=1),
                am.Box(width=0.75, depth=1, height=1, origin=(0.25, 0, 0)),
            ),
            np.zeros(3),
            1.0,
        )
