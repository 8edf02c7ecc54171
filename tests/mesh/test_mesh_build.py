"""Arrays to NGSolve and back: numbers, names, bodies and normals survive; other meshes are
refused."""

from dataclasses import replace

import ngsolve
import numpy as np
import pytest
from netgen.csg import unit_cube
from netgen.geom2d import SplineGeometry, unit_square
from ngsolve.meshes import MakeStructured3DMesh
from refused import refused

import adaptmg as am

MESHES = {
    "2D": am.mesh.structured(am.Rectangle(width=1, height=2), (3, 4)),
    "3D": am.mesh.structured(am.Box(width=1, depth=2, height=3), 2),
}


def split(mesh):
    """The mesh with two bodies in a mixed order of elements."""
    body = (mesh.points[mesh.elements].mean(axis=1)[:, 0] > 0.5).astype(int)
    return am.mesh.check_mesh(replace(mesh, element_body=body, bodies=("west", "east")))


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_ngsolve_sees_the_same_mesh_and_gives_it_back(mesh):
    mesh = split(mesh)
    source, back = mesh.source, am.mesh.as_mesh(mesh.source)
    for name in ("points", "facets", "facet_labels", "element_body"):
        np.testing.assert_array_equal(getattr(back, name), getattr(mesh, name))
    np.testing.assert_array_equal(np.sort(back.elements), np.sort(mesh.elements))
    assert (
        back.boundaries == mesh.boundaries
        and back.bodies == mesh.bodies
        and (back.volumes > 0).all()
    )
    assert source.nv == mesh.n_nodes and source.ne == len(mesh.elements)
    for i, name in enumerate(mesh.bodies):
        volume = mesh.volumes[mesh.element_body == i].sum()
        assert ngsolve.Integrate(1, source, definedon=source.Materials(name)) == pytest.approx(
            volume, rel=1e-12
        )
    for name in mesh.boundaries:
        facets = sorted(
            sorted(v.nr for v in e.vertices) for e in source.Boundaries(name).Elements()
        )
        np.testing.assert_array_equal(facets, sorted(np.sort(mesh.boundary_facets(name)).tolist()))
    # the normals point outwards: divergence theorem
    x = ngsolve.CF((ngsolve.x, ngsolve.y, ngsolve.z)[: mesh.dim])
    flux = ngsolve.Integrate(x * ngsolve.specialcf.normal(mesh.dim), source, ngsolve.BND)
    assert flux == pytest.approx(mesh.dim * mesh.volumes.sum(), rel=1e-12)
    if mesh.dim == 3:
        # Netgen counts the corners of tetrahedra the other way round
        corners = mesh.points[source.ngmesh.Elements3D().NumPy()["nodes"] - 1]
        assert (np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0).all()


def periodic_square():
    geometry = SplineGeometry()
    corners = [geometry.AppendPoint(*x) for x in ((0, 0), (1, 0), (1, 1), (0, 1))]
    right = [geometry.Append(["line", corners[i], corners[i + 1]], bc="rim") for i in range(3)][1]
    geometry.Append(
        ["line", corners[0], corners[3]], bc="rim", leftdomain=0, rightdomain=1, copy=right
    )
    return ngsolve.Mesh(geometry.GenerateMesh(maxh=0.5))


@pytest.mark.parametrize("geometry", [unit_square, unit_cube], ids=["2D", "3D"])
def test_what_corners_do_not_say_is_refused(geometry):
    mesh = ngsolve.Mesh(geometry.GenerateMesh(maxh=0.5))
    mesh.SetDeformation(ngsolve.GridFunction(ngsolve.VectorH1(mesh, order=1)))
    with pytest.raises(ValueError, match="has a deformation"):
        am.mesh.as_mesh(mesh)
    mesh.UnsetDeformation()
    assert am.mesh.as_mesh(mesh).n_nodes == mesh.nv
    mesh.Curve(3)
    with pytest.raises(ValueError, match=r"has curved elements \(order 3\)"):
        am.mesh.as_mesh(mesh)
    mesh.ngmesh.SecondOrder()
    with pytest.raises(ValueError, match=r"has curved elements \(order 2\)"):
        am.mesh.as_mesh(ngsolve.Mesh(mesh.ngmesh))


@pytest.mark.parametrize(
    ("make", "area"),
    [
        (lambda: ngsolve.Mesh(unit_square.GenerateMesh(maxh=0.4, quad_dominated=True)), 4),
        (lambda: MakeStructured3DMesh(hexes=True, nx=2, ny=3, nz=2), 6),
        (lambda: MakeStructured3DMesh(hexes=False, prism=True, nx=3, ny=2, nz=2), 6),
    ],
    ids=["quadrilaterals", "bricks", "wedges"],
)
def test_netgens_other_elements_are_cut(tmp_path, make, area):
    source = make()
    source.ngmesh.Save(str(tmp_path / "m.vol"))
    for mesh in (am.mesh.as_mesh(source), am.mesh.as_mesh(tmp_path / "m.vol")):
        assert mesh.n_nodes == source.nv and len(mesh.elements) > source.ne
        assert mesh.volumes.sum() == pytest.approx(1)
        sides = [mesh.surface(name).measures.sum() for name in mesh.boundaries]
        assert sides == pytest.approx([1] * area)


ELEMENTS, LABELS = MESHES["2D"].elements, MESHES["2D"].facet_labels
test_refused = refused(
    (lambda: am.mesh.as_mesh(periodic_square()), r"identified nodes \(periodic"),
    (lambda: am.mesh.as_mesh(np.zeros(3)), TypeError, r"an ngsolve.Mesh or .*, got ndarray"),
    # what would crash
    *(
        (lambda changes=changes: replace(MESHES["2D"], **changes), message)
        for changes, message in (
            ({"elements": ELEMENTS[:, :2]}, r"elements must have shape \(n, 3\)"),
            ({"facet_labels": LABELS[1:]}, "facet_labels must have shape"),
        )
    ),
)


def test_as_mesh_takes_arrays_and_reads_copies(tmp_path):
    source = ngsolve.Mesh(unit_square.GenerateMesh(maxh=0.3))
    read, points, n = am.mesh.as_mesh(source), am.mesh.as_mesh(source).points.copy(), source.nv
    source.Refine()
    np.testing.assert_array_equal(read.points, points)
    assert read.source.nv == n == read.n_nodes
    with pytest.raises(FileNotFoundError, match="no file"):
        am.mesh.as_mesh(tmp_path / "none.vol")
    (tmp_path / "mesh.stl").write_text("solid\n")
    with pytest.raises(ValueError, match=r"mesh.stl': "):
        am.mesh.as_mesh(tmp_path / "mesh.stl")
    mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    assert am.mesh.as_mesh(mesh) is mesh and am.mesh.as_mesh(replace(mesh)).sound
