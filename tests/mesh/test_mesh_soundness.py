"""check_mesh finds what is wrong with a mesh, wherever it comes from; quality measures known
elements."""

from dataclasses import replace

import numpy as np
import pytest

import adaptmg as am
from adaptmg.mesh.arrays import element_facets, facet_keys, facet_table, normalised
from adaptmg.mesh.soundness import check_overlap

SQUARE = am.mesh.structured(am.Rectangle(width=1, height=1), 4)
CUBE = am.mesh.structured(am.Box(width=1, depth=1, height=1), 3)
BOTH = pytest.mark.parametrize("mesh", [SQUARE, CUBE], ids=["2D", "3D"])


def test_a_mesh_is_sound_until_it_changes():
    mesh = replace(am.mesh.structured(am.Rectangle(width=1, height=1), 2))
    assert not mesh.sound and am.mesh.check_mesh(mesh, mesh.boundaries) is mesh and mesh.sound
    for name in ("rim", ["bottom", "rim"]):
        with pytest.raises(
            ValueError, match="boundary 'rim' does not exist; the boundaries are bottom, right, top"
        ):
            am.mesh.check_mesh(mesh, name)
    with pytest.raises(ValueError, match="has a hole"):
        am.mesh.check_mesh(
            replace(mesh, facets=mesh.facets[1:], facet_labels=mesh.facet_labels[1:])
        )
    # a name without facets is as good as missing; new points beside an old source are seen
    with pytest.raises(ValueError, match="'hidden' does not exist"):
        am.mesh.check_mesh(replace(mesh, boundaries=(*mesh.boundaries, "hidden")), ["hidden"])
    read = am.mesh.as_mesh(replace(SQUARE, points=2 * SQUARE.points))
    np.testing.assert_array_equal(
        np.array(read.source.ngmesh.Coordinates())[:, :2], 2 * SQUARE.points
    )


def faults(mesh):
    """Changes of arrays, and what the check says of them."""
    table = facet_table(mesh.elements, mesh.n_nodes)
    inner = int(np.setdiff1d(np.arange(len(mesh.elements)), table.first[table.counts == 1])[0])
    turned, inward, flat = mesh.elements.copy(), mesh.facets.copy(), mesh.points.copy()
    turned[3, :2], inward[2, :2] = turned[3, 1::-1], inward[2, 1::-1]
    flat[mesh.elements[5, 0]] = flat[mesh.elements[5, 1]]
    labels = np.r_[mesh.facet_labels, mesh.facet_labels[0]]

    def more(facet):
        return {"facets": np.vstack([mesh.facets, facet]), "facet_labels": labels}

    yield (
        {"elements": np.delete(mesh.elements, inner, axis=0)},
        rf"^{mesh.dim + 1} .* belong to one element and to no boundary .* nodes \[",
    )
    yield (
        {"elements": np.vstack([mesh.elements, mesh.elements[inner]])},
        "belong to more than two elements",
    )
    yield {"elements": turned}, r"1 of .* elements are inverted; element 3 .* volume -0.0"
    yield {"points": flat}, r"degenerate; element .* has volume"
    yield (
        {"points": np.vstack([mesh.points, mesh.points[-1] + 1])},
        f"1 of .* no element; node {mesh.n_nodes} ",
    )
    yield {"facets": inward}, "1 boundary facets have their normal inwards"
    yield more(mesh.facets[:1]), "given twice"
    yield more(table.facets[table.counts == 2][:1]), "lie inside the mesh"
    yield (
        more([np.array([0, mesh.n_nodes - 1, mesh.n_nodes - 2])[: mesh.dim]]),
        r"are no (edge|face) of any element",
    )
    yield {"boundaries": ("a", "a", *mesh.boundaries[2:])}, "boundaries must be distinct"
    yield {"bodies": ("body", "ghost")}, "body 'ghost' has no elements"


@BOTH
def test_faults_are_found_and_located(mesh):
    for change, message in faults(mesh):
        for judge in (am.mesh.check_mesh, am.mesh.quality):
            with pytest.raises(ValueError, match=message):
                judge(replace(mesh, element_body=None, **change))


def test_two_pieces_need_two_bodies():
    # pieces that share only a node are two
    points = np.array([[0, 0], [1, 0], [1, 1], [2, 1], [2, 2.0]])
    arrays = (
        points,
        [[0, 1, 2], [2, 3, 4]],
        [[0, 1], [1, 2], [2, 0], [2, 3], [3, 4], [4, 2]],
        np.zeros(6),
        ("rim",),
    )
    am.mesh.check_mesh(am.MeshArrays(*arrays, [0, 1], ("low", "high")))
    with pytest.raises(ValueError, match="body 'all' consists of 2 pieces, of 1, 1 elements"):
        am.mesh.check_mesh(am.MeshArrays(*arrays, bodies=("all",)))


def test_keys_of_facets_do_not_overflow():
    with pytest.raises(ValueError, match="at most"):
        facet_keys(CUBE.facets, 3_000_000)


TRIANGLE = [[0, 0], [1, 0], [0.5, np.sqrt(0.75)]], [[0, 1, 2]], [[0, 1], [1, 2], [2, 0]]
TETRAHEDRON = (
    [[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1.0]],
    [[0, 2, 1, 3]],
    element_facets(np.array([[0, 2, 1, 3]]))[0],
)


def test_quality_of_known_elements():
    half = am.mesh.quality(am.mesh.structured(am.Rectangle(width=2, height=2), 1))
    assert (half.min_angle, half.max_angle) == pytest.approx((45, 90))
    assert (half.h_min, half.h_max) == pytest.approx((2, 2 * np.sqrt(2)))
    for arrays, angle in ((TRIANGLE, 60), (TETRAHEDRON, np.degrees(np.arccos(1 / 3)))):
        best = am.mesh.quality(
            am.mesh.check_mesh(am.MeshArrays(*arrays, np.zeros(len(arrays[2])), ("a",)))
        )
        assert (best.min_angle, best.max_angle, best.aspect_ratio) == pytest.approx(
            (angle, angle, 1)
        )


def turned(mesh, points):
    """The mesh with other points, elements turned so that each is positive, as readers do."""
    return normalised(
        points,
        mesh.elements,
        mesh.facets,
        mesh.facet_labels,
        mesh.boundaries,
        mesh.element_body,
        mesh.bodies,
    )


@BOTH
def test_every_single_fold_of_a_boundary_node_is_found(mesh):
    # pulled across the body: elements turn over where no inner node moved
    for node in np.unique(mesh.facets)[::3]:
        points = mesh.points.copy()
        points[node] = 1.3 - 1.6 * points[node]
        bad = turned(mesh, points)
        if len(np.flatnonzero(np.abs(bad.volumes) < 1e-12)):
            continue
        with pytest.raises(ValueError, match=r"on the same side|lies over itself"):
            check_overlap(am.mesh.check_mesh(bad))
    mirrored = turned(mesh, mesh.points * np.r_[-1.0, np.ones(mesh.dim - 1)])
    assert check_overlap(am.mesh.check_mesh(mirrored)).volumes.sum() == pytest.approx(1)


@BOTH
def test_a_body_that_runs_into_itself(mesh):
    strip = am.mesh.structured(
        am.Rectangle(width=8, height=1) if mesh.dim == 2 else am.Box(width=8, depth=1, height=1),
        (32, 4) if mesh.dim == 2 else (32, 4, 4),
    )

    def bent(turn):
        angle = turn * strip.points[:, 0] / 8
        radius = 3 + strip.points[:, -1] + 0.06 * angle
        points = strip.points.copy()
        points[:, 0], points[:, -1] = -radius * np.cos(angle), radius * np.sin(angle)
        return replace(strip, points=points)

    assert am.mesh.as_mesh(bent(1.9 * np.pi)).volumes.sum() > 0
    with pytest.raises(
        ValueError, match="the boundary of body 'body' lies inside other elements of it"
    ):
        am.mesh.as_mesh(bent(2.2 * np.pi))
    # two bodies may touch or overlap: that is contact, or a fit with interference
    assert am.mesh.check_mesh(bent(2.2 * np.pi)).n_nodes == strip.n_nodes
