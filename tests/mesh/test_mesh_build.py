"""Arrays to NGSolve and back: numbers, names, bodies and normals survive; other meshes are refused."""

from dataclasses import replace

import ngsolve
import numpy as np
import pytest
from netgen.csg import unit_cube
from netgen.geom2d import SplineGeometry, unit_square
from ngsolve.meshes import MakeStructured3DMesh

from adaptmg.mesh import as_mesh, from_ngsolve, structured, to_ngsolve, with_source
from adaptmg.problem import Box, Rectangle

MESHES = {"2D": structured(Rectangle(width=1, height=2), (3, 4)), "3D": structured(Box(width=1, depth=2, height=3), 2)}


def split(mesh):
    """The mesh with two bodies in a mixed order of elements."""
    body = (mesh.points[mesh.elements].mean(axis=1)[:, 0] > 0.5).astype(int)
    return with_source(replace(mesh, element_body=body, bodies=("west", "east")))


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_round_trip(mesh):
    mesh = split(mesh)
    back = from_ngsolve(mesh.source)
    for name in ("points", "facets", "facet_labels", "element_body"):
        np.testing.assert_array_equal(getattr(back, name), getattr(mesh, name))
    np.testing.assert_array_equal(np.sort(back.elements), np.sort(mesh.elements))
    assert back.boundaries == mesh.boundaries and back.bodies == mesh.bodies
    assert (back.volumes > 0).all()


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_ngsolve_sees_the_same_mesh(mesh):
    mesh = split(mesh)
    source = mesh.source
    assert source.nv == mesh.n_nodes and source.ne == len(mesh.elements)
    np.testing.assert_array_equal([v.point for v in source.vertices], mesh.points)
    np.testing.assert_array_equal([sorted(v.nr for v in e.vertices) for e in source.Elements()], np.sort(mesh.elements))
    for i, name in enumerate(mesh.bodies):
        volume = mesh.volumes[mesh.element_body == i].sum()
        assert ngsolve.Integrate(1, source, definedon=source.Materials(name)) == pytest.approx(volume, rel=1e-12)
    for name in mesh.boundaries:
        facets = sorted(sorted(v.nr for v in e.vertices) for e in source.Boundaries(name).Elements())
        np.testing.assert_array_equal(facets, sorted(np.sort(mesh.boundary_facets(name)).tolist()))
    # the normals point outwards: divergence theorem
    x = ngsolve.CF((ngsolve.x, ngsolve.y, ngsolve.z)[:mesh.dim])
    flux = ngsolve.Integrate(x * ngsolve.specialcf.normal(mesh.dim), source, ngsolve.BND)
    assert flux == pytest.approx(mesh.dim * mesh.volumes.sum(), rel=1e-12)


def test_tetrahedra_are_oriented_as_netgen_wants_them():
    def signs(ngmesh):
        corners = np.array(ngmesh.Coordinates())[ngmesh.Elements3D().NumPy()["nodes"] - 1]
        return set(np.sign(np.linalg.det(corners[:, 1:] - corners[:, :1])))

    assert signs(MESHES["3D"].source.ngmesh) == signs(unit_cube.GenerateMesh(maxh=0.5))


def test_interfaces_are_left_out_and_names_merged():
    geometry = SplineGeometry()
    p = [geometry.AppendPoint(*x) for x in [(0, 0), (1, 0), (2, 0), (2, 1), (1, 1), (0, 1)]]
    for i, j, left, right, name in [(0, 1, 1, 0, "floor"), (1, 2, 2, 0, "floor"), (2, 3, 2, 0, "side"),
                                    (3, 4, 2, 0, "top"), (4, 5, 1, 0, "top"), (5, 0, 1, 0, "side"),
                                    (1, 4, 1, 2, "interface")]:
        geometry.Append(["line", p[i], p[j]], leftdomain=left, rightdomain=right, bc=name)
    geometry.SetMaterial(1, "steel")
    geometry.SetMaterial(2, "brass")
    mesh = from_ngsolve(ngsolve.Mesh(geometry.GenerateMesh(maxh=0.4)))
    assert mesh.boundaries == ("floor", "side", "top") and mesh.bodies == ("steel", "brass")
    np.testing.assert_allclose([mesh.volumes[mesh.element_body == i].sum() for i in (0, 1)], 1, rtol=1e-13)
    floor = mesh.points[mesh.boundary_nodes("floor")]
    assert (floor[:, 1] == 0).all() and np.ptp(floor[:, 0]) == 2


def periodic_square():
    geometry = SplineGeometry()
    corners = [geometry.AppendPoint(*x) for x in ((0, 0), (1, 0), (1, 1), (0, 1))]
    right = [geometry.Append(["line", corners[i], corners[i + 1]], bc="rim") for i in range(3)][1]
    geometry.Append(["line", corners[0], corners[3]], bc="rim", leftdomain=0, rightdomain=1, copy=right)
    return ngsolve.Mesh(geometry.GenerateMesh(maxh=0.5))


def test_what_corners_do_not_say_is_refused():
    for geometry in (unit_square, unit_cube):
        mesh = ngsolve.Mesh(geometry.GenerateMesh(maxh=0.5))
        field = ngsolve.GridFunction(ngsolve.VectorH1(mesh, order=1))
        mesh.SetDeformation(field)
        with pytest.raises(ValueError, match="has a deformation"):
            from_ngsolve(mesh)
        mesh.UnsetDeformation()
        assert from_ngsolve(mesh).n_nodes == mesh.nv
        mesh.ngmesh.SecondOrder()
        with pytest.raises(ValueError, match=r"has curved elements \(order 2\)"):
            from_ngsolve(ngsolve.Mesh(mesh.ngmesh))
    geometry = SplineGeometry()
    geometry.AddCircle((0, 0), 1, bc="rim")
    curved = ngsolve.Mesh(geometry.GenerateMesh(maxh=0.5))
    curved.Curve(3)
    with pytest.raises(ValueError, match=r"has curved elements \(order 3\)"):
        from_ngsolve(curved)
    with pytest.raises(ValueError, match=r"identified nodes \(periodic"):
        from_ngsolve(periodic_square())


def test_other_meshes_are_refused():
    with pytest.raises(TypeError, match=r"must be an ngsolve.Mesh, got ndarray"):
        from_ngsolve(np.zeros(3))
    with pytest.raises(ValueError, match=r"must consist of triangles, but .* first element 0"):
        from_ngsolve(ngsolve.Mesh(unit_square.GenerateMesh(maxh=0.5, quad_dominated=True)))
    with pytest.raises(ValueError, match="must consist of tetrahedra"):
        from_ngsolve(MakeStructured3DMesh(hexes=True, nx=2))


def test_to_ngsolve_refuses_what_would_crash():
    m = MESHES["2D"]
    good = dict(points=m.points, elements=m.elements, facets=m.facets, facet_labels=m.facet_labels,
                boundaries=m.boundaries)
    for change, message in [({"elements": m.elements + 1}, "elements must be node numbers from 0 to 19, got 1 to 20"),
                            ({"elements": m.elements[:, :2]}, r"elements must have shape \(n, 3\)"),
                            ({"facet_labels": m.facet_labels + 1}, "facet_labels must index 4 names"),
                            ({"facet_labels": m.facet_labels[1:]}, "facet_labels must have shape"),
                            ({"points": m.points[:, :1]}, "points must have shape")]:
        with pytest.raises(ValueError, match=message):
            to_ngsolve(**(good | change))


def test_as_mesh_takes_arrays_and_reads_copies(tmp_path, monkeypatch):
    source = ngsolve.Mesh(unit_square.GenerateMesh(maxh=0.3))
    read, points, n = as_mesh(source), as_mesh(source).points.copy(), source.nv
    source.Refine()
    np.testing.assert_array_equal(read.points, points)
    assert read.source.nv == n == read.n_nodes
    with pytest.raises(FileNotFoundError, match="no file"):
        as_mesh(tmp_path / "none.vol")
    (tmp_path / "mesh.stl").write_text("solid\n")
    with pytest.raises(ValueError, match=r"not a \.msh, \.vol or \.vol\.gz file"):
        as_mesh(tmp_path / "mesh.stl")
    mesh = structured(Rectangle(width=1, height=1), 2)
    # nobody asks for the source
    monkeypatch.setattr("adaptmg.mesh.ngsolve_bridge.to_ngsolve", lambda *_, **__: pytest.fail("built"))
    assert as_mesh(mesh) is mesh and as_mesh(replace(mesh, source=None)).sound
