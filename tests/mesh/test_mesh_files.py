"""Files of Gmsh and Netgen are read as they were written, bodies glued or split; damage is refused
with the name."""

import gzip
import importlib.util
import re
import sys
from pathlib import Path

import meshio
import ngsolve
import numpy as np
import pytest
from damage import damaged
from gmsh_file import write
from netgen.csg import unit_cube
from netgen.geom2d import SplineGeometry

import adaptmg as am

sys.path.append(str(Path(__file__).parents[1] / "hostile"))
import mesh_files

MESHES = {
    "2D": am.mesh.structured(am.Rectangle(width=1, height=2), 3),
    "3D": am.mesh.structured(am.Box(width=1, depth=2, height=3), 2),
}
BOTH = pytest.mark.parametrize("mesh", MESHES.values(), ids=MESHES)


@pytest.mark.parametrize(
    ("version", "binary"), [("gmsh22", False), ("gmsh", False), ("gmsh", True)]
)
@BOTH
def test_gmsh_round_trip(tmp_path, mesh, version, binary):
    path = write(
        tmp_path / "mesh.msh",
        mesh,
        version=version,
        binary=binary,
        lift=0.7 if mesh.dim == 2 else 0.0,
    )
    back = am.mesh.as_mesh(str(path))
    assert (
        back.volumes.sum() == pytest.approx(mesh.volumes.sum(), rel=1e-13)
        and back.source.nv == mesh.n_nodes
    )
    assert set(back.boundaries) == set(mesh.boundaries) and back.bodies == ("body",)
    for name in mesh.boundaries:
        np.testing.assert_allclose(
            np.sort(back.points[back.boundary_nodes(name)], axis=0),
            np.sort(mesh.points[mesh.boundary_nodes(name)], axis=0),
            rtol=1e-14,
        )


@BOTH
def test_facets_without_a_group(tmp_path, mesh):
    path = write(tmp_path / "mesh.msh", mesh, groups=False)
    with pytest.warns(
        UserWarning, match=rf"mesh.msh'?: {len(mesh.facets)} facets .* have no name in the file"
    ):
        assert am.mesh.from_file(path).boundaries == ("free",)
    everything = am.mesh.from_file(path, unnamed="rim")
    assert everything.boundaries == ("rim",) and len(everything.facets) == len(mesh.facets)
    some = am.mesh.from_file(write(path, mesh, keep=slice(0, 2)), unnamed="free")
    assert set(some.boundaries) == {*mesh.boundaries[:2], "free"}


def test_groups_without_names_and_second_order(tmp_path):
    points = np.array([[0, 0], [2, 0], [0, 2], [1, 0], [1, 1], [0, 1.0]])
    cells = [
        ("triangle6", np.array([[0, 1, 2, 3, 4, 5]])),
        ("line3", np.array([[0, 1, 3], [1, 2, 4], [2, 0, 5]])),
    ]
    data = {
        "gmsh:physical": [np.array([7]), np.array([3, 3, 5])],
        "gmsh:geometrical": [np.array([1]), np.array([1, 2, 3])],
    }
    meshio.write(
        tmp_path / "m.msh",
        meshio.Mesh(np.pad(points, ((0, 0), (0, 1))), cells, cell_data=data),
        "gmsh22",
    )
    mesh = am.mesh.from_file(tmp_path / "m.msh")
    assert mesh.boundaries == ("3", "5") and mesh.bodies == ("7",)
    np.testing.assert_array_equal(mesh.points, points)
    assert len(mesh.elements) == 4 and [len(mesh.boundary_facets(name)) for name in ("3", "5")] == [
        4,
        2,
    ]


def test_groups_of_some_and_several_groups(tmp_path):
    path, groups = (
        tmp_path / "m.msh",
        {" 1 5 0\n": " 2 5 6 0\n", '2\n1 5 "rim"': '3\n1 5 "rim"\n1 6 "all"'},
    )
    for chosen in ("rim", "all"):
        path.write_text(re.sub("|".join(groups), lambda match: groups[match[0]], mesh_files.MSH))
        mesh = am.mesh.from_file(path, unnamed="free", unit=0.5, boundaries=[chosen])
        assert (
            mesh.bodies == ("steel",) and mesh.boundaries == (chosen,) and mesh.volumes.sum() == 0.5
        )
    path.write_text(mesh_files.MSH.replace('2\n1 5 "rim"\n2 3 "steel"', '1\n1 5 "rim"'))
    assert am.mesh.from_file(path).bodies == ("3",) and am.mesh.from_file(path).boundaries == (
        "rim",
    )
    # of curves that run the other way the numbers are negative
    path.write_text(
        mesh_files.MSH.replace(" 1 5 0\n", " 1 -5 0\n").replace(" 1 3 0\n", " 1 -3 0\n")
    )
    assert am.mesh.from_file(path).bodies == ("steel",) and am.mesh.from_file(path).boundaries == (
        "rim",
    )
    path.write_text(mesh_files.MSH.replace(" 1 5 0\n", " 0 0\n").replace(" 1 3 0\n", " 0 0\n"))
    mesh = am.mesh.from_file(path, unnamed="free")
    assert mesh.bodies == ("body",) and mesh.boundaries == ("free",)
    path.write_text(mesh_files.MSH.replace(" 1 5 0\n", " 0 0\n"))
    with pytest.raises(ValueError, match=r"m.msh.*gmsh:physical.*write it as MSH 2.2"):
        am.mesh.from_file(path)


def test_what_gmsh_files_must_hold(tmp_path):
    path = tmp_path / "m.msh"
    with pytest.raises(FileNotFoundError, match="no file"):
        am.mesh.from_file(path)
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 1.0]])
    for kind, nodes, message in (
        ("triangle10", [[0, 1, 2, 3] * 2 + [0, 1]], "it holds triangle10; elements must be"),
        ("line", [[0, 1]], "neither triangles and quadrilaterals nor"),
        ("triangle", [[0, 1, 2], [0, 2, 3]], "not in a plane z = constant"),
    ):
        meshio.write(path, meshio.Mesh(corners, [(kind, np.array(nodes))]), "gmsh22")
        with pytest.raises(ValueError, match=f"m.msh.*{message}"):
            am.mesh.from_file(path)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.msh", "$NOD\n1\n1 0 0 0\n$ENDNOD\n", r"it begins with '\$NOD'; write it as MSH 2.2"),
        ("a.msh", "MESH dimension 2 ElemType Triangle Nnode 3\n", "begins with 'MESH dimension 2"),
        ("a.mesh", "MFEM mesh v1.0\n\ndimension\n2\n", "begins with 'MFEM mesh v1.0'"),
        ("a.bdf", "GRID,1,,0.,0.,0.\n", "BEGIN BULK"),
        (
            "a.unv",
            "    -1\n  2411\n",
            r"no reader for the suffix.*gmsh old.unv -save -format msh22",
        ),
    ],
)
def test_why_a_file_is_not_read(tmp_path, name, text, message):
    (tmp_path / name).write_text(text)
    with pytest.raises(ValueError, match=f"{name}': .*{message}"):
        am.mesh.from_file(tmp_path / name)


def test_files_that_need_another_package_name_it(tmp_path):
    (tmp_path / "a.exo").write_bytes(b"CDF\x01")
    if importlib.util.find_spec("netCDF4") is None:
        with pytest.raises(ValueError, match=r"netCDF4 reads it: pip install 'adaptmg\[formats\]'"):
            am.mesh.from_file(tmp_path / "a.exo")
    else:
        with pytest.raises(ValueError, match=r"a\.exo"):
            am.mesh.from_file(tmp_path / "a.exo")


def test_groups_of_med_name_boundaries_and_bodies(tmp_path):
    pytest.importorskip("h5py")
    square = am.mesh.structured(am.Rectangle(width=2, height=1), 2)
    lines = [square.boundary_facets(name) for name in ("bottom", "right", "top")]
    mesh = meshio.Mesh(
        square.points, [("line", np.concatenate(lines)), ("triangle", square.elements)]
    )
    # families of the facets on "low", on "low" and "held", and on neither
    mesh.cell_data["cell_tags"] = [
        np.repeat([-1, -2, 0], list(map(len, lines))),
        np.full(len(square.elements), -3),
    ]
    mesh.cell_tags = {-1: ["low"], -2: ["low", "held"], -3: ["plate"]}
    mesh.point_data["point_tags"] = np.where(square.points[:, 0] == 0, 4, 0)
    mesh.point_tags = {4: ["nodes at left"]}
    meshio.write(tmp_path / "m.med", mesh)
    read = am.mesh.from_file(
        tmp_path / "m.med", unnamed="free", boundaries=["held", "low", "nodes at left"]
    )
    lengths = {name: read.surface(name).measures.sum() for name in read.boundaries}
    assert lengths == pytest.approx({"held": 1, "low": 2, "nodes at left": 1, "free": 2})
    assert read.bodies == ("plate",)


def test_tetrahedra_of_exodus_are_read_with_sets_of_nodes(tmp_path):
    netcdf = pytest.importorskip("netCDF4")
    with netcdf.Dataset(tmp_path / "m.exo", "w", format="NETCDF3_CLASSIC") as file:
        sizes = {"num_nodes": 4, "num_el_in_blk1": 1, "num_nod_per_el1": 4, "num_nod_ns1": 3}
        for name, size in {**sizes, "num_node_sets": 1, "len_string": 33}.items():
            file.createDimension(name, size)
        for k, name in enumerate("xyz"):
            file.createVariable(f"coord{name}", "f8", ("num_nodes",))[:] = np.eye(4, 3, -1)[:, k]
        names = file.createVariable("ns_names", "S1", ("num_node_sets", "len_string"))
        names[0, :3] = np.array(list("low"), "S1")
        file.createVariable("node_ns1", "i4", ("num_nod_ns1",))[:] = [1, 2, 3]
        block = file.createVariable("connect1", "i4", ("num_el_in_blk1", "num_nod_per_el1"))
        block.elem_type = "TETRA4"
        block[:] = [[1, 2, 3, 4]]
    mesh = am.mesh.from_file(tmp_path / "m.exo", unnamed="free")
    assert mesh.volumes.sum() == pytest.approx(1 / 6) and "not read: side sets" in mesh.notes[0]
    assert (mesh.points[mesh.boundary_nodes("low"), 2] == 0).all()


CUBES = am.Assembly(
    parts={
        "lower": am.Box(width=1, depth=1, height=1),
        "upper": am.Box(width=1, depth=1, height=1, origin=(0, 0, 1)),
    }
)


def write_cubes(path, shared, *, skip=(), names=("lower", "upper")):
    """Two stacked cubes of six tetrahedra each as MSH 2.2, conforming at z = 1, with shared nodes
    there or not."""
    cubes = am.mesh.structured(CUBES, 1)
    points, numbers = cubes.points, np.arange(16)
    if shared:
        points, numbers = np.unique(points, axis=0, return_inverse=True)
        numbers = numbers.ravel()
    group = {"bottom": 11, "top": 13}
    labels = np.array(
        [
            12 if name in ("lower.top", "upper.bottom") else group.get(name.split(".")[1], 14)
            for name in cubes.boundaries
        ]
    )[cubes.facet_labels]
    facets = numbers[cubes.facets]
    if shared:
        _, once = np.unique(np.sort(facets, axis=1), axis=0, return_index=True)
        facets, labels = facets[once], labels[once]
    facets, labels = facets[~np.isin(labels, skip)], labels[~np.isin(labels, skip)]
    field = {
        "base": [11, 2],
        "interface": [12, 2],
        "lid": [13, 2],
        "wall": [14, 2],
        names[0]: [1, 3],
        names[1]: [2, 3],
    }
    tags = [labels, cubes.element_body + 1]
    meshio.write(
        path,
        meshio.Mesh(
            points,
            [("triangle", facets), ("tetra", numbers[cubes.elements])],
            cell_data={"gmsh:physical": tags, "gmsh:geometrical": tags},
            field_data={name: np.array(g) for name, g in field.items()},
        ),
        "gmsh22",
        binary=False,
    )
    return path


@pytest.mark.parametrize("shared", [True, False])
def test_bodies_are_glued_by_default_or_share_no_nodes(tmp_path, shared):
    path = write_cubes(tmp_path / "m.msh", shared)
    glued = am.mesh.from_file(path)
    assert glued.n_nodes == (12 if shared else 16) and glued.bodies == ("lower", "upper")
    # a shared interface lies inside
    assert glued.boundaries == ("base", *["interface"][shared:], "lid", "wall")
    mesh = am.mesh.check_mesh(am.mesh.from_file(path, split_bodies=True))
    assert mesh.n_nodes == mesh.source.nv == 16 and mesh.bodies == glued.bodies
    assert mesh.boundaries == (
        "lower.base",
        "lower.interface",
        "lower.wall",
        "upper.interface",
        "upper.lid",
        "upper.wall",
    )
    for one in (glued, mesh):
        np.testing.assert_allclose(np.bincount(one.element_body, one.volumes), 1)
    for body, name, z, up in (
        (0, "lower.interface", 1, 1),
        (1, "upper.interface", 1, -1),
        (0, "lower.base", 0, -1),
        (1, "upper.lid", 2, 1),
    ):
        surface = mesh.surface(name)
        assert len(surface.facets) == 2 and (mesh.points[surface.nodes, 2] == z).all()
        np.testing.assert_allclose(surface.vectors.sum(axis=0), (0, 0, up))
        assert set(surface.nodes) <= set(mesh.elements[mesh.element_body == body].ravel())


def test_an_interface_without_a_name_and_dots_in_names(tmp_path):
    path = write_cubes(tmp_path / "m.msh", shared=True, skip=(12,), names=("a.1", "upper"))
    assert am.mesh.from_file(path).boundaries == ("base", "lid", "wall") and am.mesh.from_file(
        path
    ).bodies == (
        "a.1",
        "upper",
    )
    with pytest.warns(
        UserWarning, match=r"4 facets of the boundary, one of them at \(.*have no name in the file"
    ):
        mesh = am.mesh.from_file(path, split_bodies=True)
    # a dot would be read as body.boundary
    assert set(mesh.boundaries) == {
        "a_1.base",
        "a_1.wall",
        "a_1.free",
        "upper.lid",
        "upper.wall",
        "upper.free",
    }
    for name in ("a_1.free", "upper.free"):
        assert (
            len(mesh.boundary_facets(name)) == 2
            and (mesh.points[mesh.boundary_nodes(name), 2] == 1).all()
        )


def two_bodies():
    """Two squares with a common edge, whose boundaries share names."""
    geometry = SplineGeometry()
    p = [geometry.AppendPoint(*c) for c in ((0, 0), (1, 0), (1, 1), (0, 1), (2, 0), (2, 1))]
    for a, b, name, left, right in (
        (0, 1, "low", 1, 0),
        (1, 2, "mid one", 1, 2),
        (2, 3, "top", 1, 0),
        (3, 0, "left side", 1, 0),
        (1, 4, "low", 2, 0),
        (4, 5, "r", 2, 0),
        (5, 2, "top", 2, 0),
    ):
        geometry.Append(["line", p[a], p[b]], bc=name, leftdomain=left, rightdomain=right)
    for number, name in ((1, "first body"), (2, "b")):
        geometry.SetMaterial(number, name)
    return geometry.GenerateMesh(maxh=0.5)


def test_netgens_interfaces_are_left_out_and_names_merged():
    mesh = am.mesh.as_mesh(ngsolve.Mesh(two_bodies()))
    assert mesh.boundaries == ("low", "top", "left side", "r") and mesh.bodies == (
        "first body",
        "b",
    )
    np.testing.assert_allclose(np.bincount(mesh.element_body, mesh.volumes), 1, rtol=1e-13)
    low = mesh.points[mesh.boundary_nodes("low")]
    assert (low[:, 1] == 0).all() and np.ptp(low[:, 0]) == 2


@pytest.mark.parametrize(
    "make", [two_bodies, lambda: unit_cube.GenerateMesh(maxh=0.5)], ids=["plane", "cube"]
)
def test_netgen_files_are_read_as_netgen_reads_them(tmp_path, make):
    made = make()
    made.Save(str(tmp_path / "m.vol"))
    expected = am.mesh.as_mesh(ngsolve.Mesh(str(tmp_path / "m.vol")))
    (tmp_path / "m.vol.gz").write_bytes(gzip.compress((tmp_path / "m.vol").read_bytes()))
    for name in ("m.vol", "m.vol.gz"):
        found = am.mesh.as_mesh(tmp_path / name)
        for array in ("points", "elements", "facets", "facet_labels", "element_body"):
            np.testing.assert_array_equal(getattr(found, array), getattr(expected, array))
        assert (found.boundaries, found.bodies) == (expected.boundaries, expected.bodies)
    # of second-order elements the corners are read
    made.SecondOrder()
    made.Save(str(tmp_path / "second.vol"))
    assert am.mesh.as_mesh(tmp_path / "second.vol").n_nodes == expected.n_nodes


def test_every_cut_is_noticed(tmp_path):
    for text in (mesh_files.VOL, mesh_files.VOL.replace("\n", "\r\n") + "geometry\n"):
        (tmp_path / "whole.vol").write_bytes(text.encode())
        mesh = am.mesh.as_mesh(tmp_path / "whole.vol")
        assert mesh.volumes.sum() == 2 and mesh.bodies == ("steel",)
    for name, text in (("cut.vol", mesh_files.VOL), ("cut.msh", mesh_files.MSH)):
        for k in range(0, len(text) - 15, 37):
            (tmp_path / name).write_text(text[:k])
            with pytest.raises(ValueError, match=re.escape(name)):
                am.mesh.as_mesh(tmp_path / name)


@pytest.mark.filterwarnings("ignore:.*have no name in the file")
def test_damaged_files_are_read_soundly_or_refused(tmp_path):
    refused = 0
    # seeds that reach a crash of OCC, an error inside meshio, missing nodes and overlapping elements
    for seed in range(9, 33):
        name, data = damaged(seed)
        path = tmp_path / f"{seed}-{name}"
        path.write_bytes(data)
        try:
            am.mesh.touching(path) if path.suffix == ".step" else am.mesh.check_mesh(
                am.mesh.from_file(path)
            )
        except ValueError as error:
            assert path.name in str(error)
            refused += 1
    assert 0 < refused < 24
