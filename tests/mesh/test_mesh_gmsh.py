"""Gmsh files, written here by meshio, are read back; what is missing in them is said."""

import sys

import meshio
import numpy as np
import pytest

from adaptmg.mesh import as_mesh, from_gmsh, structured
from adaptmg.problem import Box, Rectangle

MESHES = {"2D": structured(Rectangle(width=1, height=2), 3), "3D": structured(Box(width=1, depth=2, height=3), 2)}


def write(path, mesh, *, version, groups=True, keep=slice(None), lift=0.0, binary=False):
    """Write a mesh with a stray point in front, bodies 'body', elements turned, as Gmsh would."""
    points = np.zeros((mesh.n_nodes + 1, 3))
    points[1:, :mesh.dim] = mesh.points
    points[:, 2] += lift
    names = {2: ("triangle", "line"), 3: ("tetra", "triangle")}[mesh.dim]
    elements = mesh.elements[:, [1, 0, *range(2, mesh.dim + 1)]] + 1
    cells, physical, entity = [(names[0], elements)], [np.full(len(elements), 100)], [np.full(len(elements), 1)]
    for i in range(len(mesh.boundaries))[keep]:
        facets = mesh.boundary_facets(mesh.boundaries[i]) + 1
        cells.append((names[1], facets))
        physical.append(np.full(len(facets), 10 + i))
        entity.append(np.full(len(facets), 1 + i))
    field = {"body": np.array([100, mesh.dim])}
    field |= {name: np.array([10 + i, mesh.dim - 1]) for i, name in enumerate(mesh.boundaries)}
    # MSH 4.1 finds the groups through the entities its nodes lie on: every entity must have one
    tags = np.full((len(points), 2), [mesh.dim, 1])
    for block, number in zip(cells[1:], entity[1:], strict=True):
        for node in np.unique(block[1]):
            tags[node] = [mesh.dim - 1, number[0]]
    data = {"gmsh:physical": physical if groups else [0 * p for p in physical], "gmsh:geometrical": entity}
    out = meshio.Mesh(points, cells, cell_data=data, field_data=field if groups else {},
                      point_data={"gmsh:dim_tags": tags} if version == "gmsh" else {})
    meshio.write(path, out, file_format=version, binary=binary)


@pytest.mark.parametrize("binary", [False, True], ids=["text", "binary"])
@pytest.mark.parametrize("version", ["gmsh22", "gmsh"])
@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_round_trip(tmp_path, mesh, version, binary):
    path = tmp_path / "mesh.msh"
    write(path, mesh, version=version, binary=binary)
    assert path.read_bytes().split(b"\n")[1].startswith(b"2.2" if version == "gmsh22" else b"4.1")
    for back in (from_gmsh(path), as_mesh(str(path))):
        # in 4.1 points may be in another order: compare as sets
        order, wanted = np.lexsort(back.points.T), np.lexsort(mesh.points.T)
        np.testing.assert_allclose(back.points[order], mesh.points[wanted], rtol=1e-14)
        assert (back.volumes > 0).all() and back.volumes.sum() == pytest.approx(mesh.volumes.sum(), rel=1e-13)
        assert set(back.boundaries) == set(mesh.boundaries) and back.bodies == ("body",)
        for name in mesh.boundaries:
            np.testing.assert_allclose(np.sort(back.points[back.boundary_nodes(name)], axis=0),
                                       np.sort(mesh.points[mesh.boundary_nodes(name)], axis=0), rtol=1e-14)
        assert back.source.nv == mesh.n_nodes


@pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)
def test_missing_groups(tmp_path, mesh):
    path = tmp_path / "mesh.msh"
    write(path, mesh, version="gmsh22", groups=False)
    with pytest.raises(ValueError, match="belong to no physical group; name them in Gmsh, like Physical"):
        from_gmsh(path)
    everything = from_gmsh(path, unnamed="rim")
    assert everything.boundaries == ("rim",) and len(everything.facets) == len(mesh.facets)


def test_partly_named_boundary(tmp_path):
    path = tmp_path / "mesh.msh"
    write(path, MESHES["2D"], version="gmsh22", keep=slice(0, 2))
    with pytest.raises(ValueError, match=r"6 facets of the boundary, one of them at \("):
        from_gmsh(path)
    mesh = from_gmsh(path, unnamed="free")
    assert set(mesh.boundaries) == {"bottom", "right", "free"}
    assert len(mesh.boundary_facets("free")) == 6


def test_groups_without_names_are_numbers(tmp_path):
    cells = [("triangle", np.array([[0, 1, 2]])), ("line", np.array([[0, 1], [1, 2], [2, 0]]))]
    data = {"gmsh:physical": [np.array([7]), np.array([3, 3, 5])],
            "gmsh:geometrical": [np.array([1]), np.array([1, 2, 3])]}
    meshio.write(tmp_path / "m.msh", meshio.Mesh(np.eye(3)[[2, 0, 1]] * [1, 1, 0], cells, cell_data=data), "gmsh22")
    mesh = from_gmsh(tmp_path / "m.msh")
    assert mesh.boundaries == ("3", "5") and mesh.bodies == ("7",)


def test_second_order_elements_are_read_by_their_corners(tmp_path):
    points = np.array([[0, 0], [2, 0], [0, 2], [1, 0], [1, 1], [0, 1.0]])
    cells = [("triangle6", np.array([[0, 1, 2, 3, 4, 5]])), ("line3", np.array([[0, 1, 3], [1, 2, 4], [2, 0, 5]]))]
    data = {"gmsh:physical": [np.array([1]), np.array([1, 1, 1])],
            "gmsh:geometrical": [np.array([1]), np.array([1, 2, 3])]}
    meshio.write(tmp_path / "m.msh", meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), cells, cell_data=data), "gmsh22")
    mesh = from_gmsh(tmp_path / "m.msh")
    np.testing.assert_array_equal(mesh.points, points[:3])


def test_plane_meshes_may_lie_at_any_height(tmp_path):
    write(tmp_path / "m.msh", MESHES["2D"], version="gmsh22", lift=0.7)
    assert from_gmsh(tmp_path / "m.msh").dim == 2


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "m.msh"
    with pytest.raises(FileNotFoundError, match="no file"):
        from_gmsh(path)
    path.write_text("something else\n")
    with pytest.raises(ValueError, match="cannot be read as a Gmsh mesh"):
        from_gmsh(path)
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    meshio.write(path, meshio.Mesh(corners, [("quad", np.array([[0, 1, 2, 3]]))]), "gmsh22")
    with pytest.raises(ValueError, match="holds quad; only triangles and tetrahedra"):
        from_gmsh(path)
    meshio.write(path, meshio.Mesh(corners, [("line", np.array([[0, 1]]))]), "gmsh22")
    with pytest.raises(ValueError, match="neither triangles nor tetrahedra"):
        from_gmsh(path)
    corners[3, 2] = 1
    meshio.write(path, meshio.Mesh(corners, [("triangle", np.array([[0, 1, 2], [0, 2, 3]]))]), "gmsh22")
    with pytest.raises(ValueError, match="not in a plane z = constant"):
        from_gmsh(path)


def test_without_meshio(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(ImportError, match=r"adaptmg\[gmsh\]"):
        from_gmsh(tmp_path / "m.msh")
