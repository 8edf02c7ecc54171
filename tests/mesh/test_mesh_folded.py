"""Tangled meshes are refused, wherever they come from: a node folded over, a body that lies over itself."""

from dataclasses import replace

import meshio
import ngsolve
import numpy as np
import pytest

from adaptmg.mesh import MeshArrays, as_mesh, check_mesh, from_gmsh, from_ngsolve, structured, to_ngsolve
from adaptmg.mesh.arrays import facet_table, normalised
from adaptmg.mesh.soundness import check_overlap
from adaptmg.problem import Box, Rectangle

SOUND = {"2D": structured(Rectangle(width=1, height=1), 4), "3D": structured(Box(width=1, depth=1, height=1), 3)}
BOTH = pytest.mark.parametrize("mesh", SOUND.values(), ids=SOUND)
TANGLED = "on the same side|lie over itself|lies over itself|more than 360"


def folded(mesh: MeshArrays) -> MeshArrays:
    """One inner node pulled over its neighbours; elements turned so that each is positive, as readers do."""
    inner = np.setdiff1d(np.arange(mesh.n_nodes), mesh.facets)[0]
    points = mesh.points.copy()
    points[inner] += np.linspace(0.6, 0.5, mesh.dim)
    back = normalised(points, mesh.elements, mesh.facets, mesh.facet_labels, mesh.boundaries, mesh.element_body,
                      mesh.bodies)
    assert (back.volumes > 0).all() and back.volumes.sum() > 1.04
    return back


def raw_ngsolve(mesh: MeshArrays) -> ngsolve.Mesh:
    return to_ngsolve(mesh.points, mesh.elements, mesh.facets, mesh.facet_labels, mesh.boundaries,
                      element_body=mesh.element_body, bodies=mesh.bodies)


def write_gmsh(path, mesh: MeshArrays) -> None:
    points = np.pad(mesh.points, ((0, 0), (0, 3 - mesh.dim)))
    kinds = ("triangle", "line") if mesh.dim == 2 else ("tetra", "triangle")
    cells = [(kinds[0], mesh.elements), (kinds[1], mesh.facets)]
    tags = [np.full(len(mesh.elements), 99), mesh.facet_labels + 1]
    meshio.write(path, meshio.Mesh(points, cells, cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags}),
                 file_format="gmsh22", binary=False)


@BOTH
def test_a_folded_node_is_found_from_every_source(tmp_path, mesh):
    bad = folded(mesh)
    raw = raw_ngsolve(bad)
    raw.ngmesh.Save(str(tmp_path / "bad.vol"))
    write_gmsh(tmp_path / "bad.msh", bad)
    for read in (lambda: check_mesh(bad), lambda: as_mesh(bad), lambda: from_ngsolve(raw), lambda: as_mesh(raw),
                 lambda: as_mesh(tmp_path / "bad.vol"), lambda: from_gmsh(tmp_path / "bad.msh")):
        with pytest.raises(ValueError, match="both their elements on the same side: the mesh is folded over"):
            read()


@BOTH
def test_every_single_fold_of_a_boundary_node_is_found(mesh):
    # pulled across the body: elements turn over where no inner node moved
    for node in np.unique(mesh.facets)[::3]:
        points = mesh.points.copy()
        points[node] = 1.3 - 1.6 * points[node]
        bad = normalised(points, mesh.elements, mesh.facets, mesh.facet_labels, mesh.boundaries, mesh.element_body,
                         mesh.bodies)
        if len(np.flatnonzero(np.abs(bad.volumes) < 1e-12)):
            continue
        with pytest.raises(ValueError, match=TANGLED):
            check_overlap(check_mesh(bad))


@BOTH
def test_a_mirrored_mesh_is_turned_as_a_whole(mesh):
    mirrored = mesh.points * np.r_[-1.0, np.ones(mesh.dim - 1)]
    back = normalised(mirrored, mesh.elements, mesh.facets, mesh.facet_labels, mesh.boundaries, mesh.element_body,
                      mesh.bodies)
    assert check_overlap(check_mesh(back)).volumes.sum() == pytest.approx(1)


def test_elements_that_wind_twice_around_a_node():
    turns = np.arange(5) * 2 * 2 * np.pi / 5
    points = np.vstack([np.zeros(2), np.stack([np.cos(turns), np.sin(turns)], axis=1)])
    ring = np.arange(5) + 1
    star = np.stack([np.zeros(5, dtype=int), ring, np.roll(ring, -1)], axis=1)
    mesh = MeshArrays(points, star, star[:, 1:], np.zeros(5, dtype=int), ("rim",))
    check_mesh(mesh)  # every facet is in order: only the sum of the angles tells
    with pytest.raises(ValueError, match=r"around node \[0\] at \(0, 0\) fill 720 degrees"):
        check_overlap(mesh)
    # the same star in space, two tetrahedra on each of its triangles
    points = np.vstack([np.pad(points, ((0, 0), (0, 1))), [[0, 0, 1.0]]])
    solid = normalised(points, np.hstack([star, np.full((5, 1), 6)]), np.empty((0, 3), dtype=int),
                       np.empty(0, dtype=int), [], np.zeros(5, dtype=int), ["body"])
    outer = facet_table(solid.elements, 7)
    outer = outer.facets[outer.counts == 1]
    solid = replace(solid, facets=outer, facet_labels=np.zeros(len(outer), dtype=int), boundaries=("all",))
    check_mesh(solid)
    with pytest.raises(ValueError, match=r"around edge with nodes \[0, 6\] .* fill 720 degrees"):
        check_overlap(solid)


@BOTH
def test_a_body_that_runs_into_itself(mesh):
    strip = structured(Rectangle(width=8, height=1) if mesh.dim == 2 else Box(width=8, depth=1, height=1),
                       (32, 4) if mesh.dim == 2 else (32, 4, 4))

    def bent(turn: float) -> MeshArrays:
        angle = turn * strip.points[:, 0] / 8
        radius = 3 + strip.points[:, -1] + 0.06 * angle
        points = strip.points.copy()
        points[:, 0], points[:, -1] = -radius * np.cos(angle), radius * np.sin(angle)
        return replace(strip, points=points, source=None)

    assert as_mesh(bent(1.9 * np.pi)).volumes.sum() > 0
    with pytest.raises(ValueError, match="the boundary of body 'body' lies inside other elements of it"):
        as_mesh(bent(2.2 * np.pi))
    # two bodies may touch or overlap: that is contact, or a fit with interference
    assert check_mesh(bent(2.2 * np.pi)).n_nodes == strip.n_nodes


def test_new_points_beside_an_old_source_are_seen():
    mesh = SOUND["2D"]
    moved = replace(mesh, points=2 * mesh.points)
    assert moved.source is mesh.source
    read = as_mesh(moved)
    np.testing.assert_array_equal(np.array(read.source.ngmesh.Coordinates())[:, :2], moved.points)
