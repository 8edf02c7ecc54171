"""Netgen's files are read as Netgen reads them; what is damaged is refused, with the line."""

import gzip
import re
from pathlib import Path

import ngsolve
import numpy as np
import pytest
from netgen.csg import unit_cube
from netgen.geom2d import SplineGeometry
from netgen.occ import Cylinder, OCCGeometry, Pnt, Z
from netgen_text import VOL

from adaptmg.mesh import as_mesh, from_ngsolve, structured
from adaptmg.mesh.ngsolve_bridge import own_mesh
from adaptmg.problem import Box, Rectangle


def two_bodies():
    geometry = SplineGeometry()
    p = [geometry.AppendPoint(*c) for c in ((0, 0), (1, 0), (1, 1), (0, 1), (2, 0), (2, 1))]
    for a, b, name, left, right in ((0, 1, "low", 1, 0), (1, 2, "mid one", 1, 2), (2, 3, "top", 1, 0),
                                    (3, 0, "left side", 1, 0), (1, 4, "low", 2, 0), (4, 5, "r", 2, 0),
                                    (5, 2, "top", 2, 0)):
        geometry.Append(["line", p[a], p[b]], bc=name, leftdomain=left, rightdomain=right)
    geometry.SetMaterial(1, "first body")
    geometry.SetMaterial(2, "b")
    return geometry


def second_order():
    mesh = two_bodies().GenerateMesh(maxh=0.5)
    mesh.SecondOrder()
    return mesh


def curved():
    mesh = ngsolve.Mesh(OCCGeometry(Cylinder(Pnt(0, 0, 0), Z, 1, 1)).GenerateMesh(maxh=1))
    mesh.Curve(2)
    return mesh.ngmesh


MAKE = {"two bodies": lambda: two_bodies().GenerateMesh(maxh=0.5), "second order": second_order, "curved": curved,
        "cube": lambda: unit_cube.GenerateMesh(maxh=0.5),
        "2D arrays": lambda: structured(Rectangle(width=1, height=1), 3).source.ngmesh,
        "3D arrays": lambda: structured(Box(width=1, depth=1, height=1), 2).source.ngmesh}


@pytest.mark.parametrize("make", MAKE.values(), ids=MAKE)
def test_the_same_as_netgen_reads(tmp_path, make):
    make().Save(str(tmp_path / "m.vol"))
    wanted = own_mesh(ngsolve.Mesh(str(tmp_path / "m.vol")))
    (tmp_path / "m.vol.gz").write_bytes(gzip.compress((tmp_path / "m.vol").read_bytes()))
    for name in ("m.vol", "m.vol.gz"):
        found = as_mesh(tmp_path / name)
        for array in ("points", "elements", "facets", "facet_labels", "element_body"):
            np.testing.assert_array_equal(getattr(found, array), getattr(wanted, array))
        assert (found.boundaries, found.bodies) == (wanted.boundaries, wanted.bodies)


def test_files_of_older_versions(tmp_path):
    (tmp_path / "old.vol").write_text(VOL)
    mesh = as_mesh(tmp_path / "old.vol")
    assert mesh.boundaries == ("side", "right", "top") and mesh.bodies == ("steel",)
    assert mesh.boundary_facets("side").tolist() == [[0, 1], [3, 0]] and mesh.volumes.sum() == 2
    reference = from_ngsolve(ngsolve.Mesh(str(tmp_path / "old.vol")))
    np.testing.assert_array_equal(mesh.facet_labels, reference.facet_labels)
    assert mesh.bodies == reference.bodies
    (tmp_path / "dos.vol").write_bytes(VOL.replace("\n", "\r\n").encode())
    np.testing.assert_array_equal(as_mesh(tmp_path / "dos.vol").elements, mesh.elements)


@pytest.mark.parametrize(("old", "new", "message"), [
    (" 1 1 1 0 3 1 2 3", " 1 1 1 0 3 1 2 9", r"line 8: .* names nodes \[1, 2, 9\], there are 4"),
    (" 1 1 1 0 3 1 2 3", " 1 1 1 0 3 1 2 0", r"names nodes \[1, 2, 0\]"),
    (" 1 1 1 0 3 1 2 3", " 1 1 1 0 3 1 2 2.5", "line 8: 2.5 in the section 'surfaceelements' is no whole number"),
    (" 1 1 1 0 3 1 2 3", " 1 1 1 0 3 1 2 4294967299", "no whole number below"),
    (" 1 1 1 0 3 1 2 3", " 1 1 1 0 4 1 2 3", "line 8: the mesh must consist of triangles"),
    (" 1 1 1 0 3 1 3 4", " 1 1 1 0 3 1 3", "line 9: 7 numbers instead of 8"),
    ("points\n4", "points\n-4", "line 19: 'points' must be followed by a number >= 0, got '-4'"),
    ("points\n4", "points\n999999999", "says 999999999 lines, the file has 12 more"),
    ("points\n4", "points\n3", r"names nodes"),
    ("dimension\n2", "dimension\n7", "the dimension must be 2 or 3, got 7"),
    ("dimension\n2", "dimension\n3", "the mesh has no elements"),
    (" 2 1 0", " 2 nan 0", "line 22: a number in the section 'points' is not finite"),
    (" 2 1 0", " 2 x 0", "line 22: 'x' is no number"),
    (" 2 1 0", " 2 1 1", "must have one z, got 0 to 1"),
    (" 2 1 0", " -1 1 0", "same side"),
    (" 2 0 2 3", " 9 0 2 3", "boundary number 9 has no name"),
    (" 2 0 2 3", " 0 0 2 3", "number of a boundary must be >= 1, got 0"),
    ("1 steel", "1 st\x07eel", "line 26: the name of a body must be printable"),
    ("2 right", "right", "a name in the section 'bcnames' must follow its number"),
    ("bcnames\n3", "bcnames\n30", "damaged or cut off"),
    ("endmesh", "", "cut off: the keyword 'endmesh' is missing"),
    ("materials", "points", "two sections 'points'"),
    ("mesh3d", "mesh4d", "does not begin with 'mesh3d'"),
    ("points\n", "spots\n", "the section 'points' is missing"),
    ("edgesegmentsgi2", "edgesegmentsgi9", "no boundary edges"),
])
def test_damage_is_named(tmp_path, old, new, message):
    assert old in VOL
    (tmp_path / "bad.vol").write_text(VOL.replace(old, new, 1))
    with pytest.raises(ValueError, match=message) as caught:
        as_mesh(tmp_path / "bad.vol")
    assert "bad.vol" in str(caught.value)


def test_every_cut_is_noticed(tmp_path):
    for k in range(0, len(VOL) - 9, 17):
        (tmp_path / "cut.vol").write_text(VOL[:k])
        with pytest.raises(ValueError, match=re.escape("cut.vol")):
            as_mesh(tmp_path / "cut.vol")


def test_a_bomb_is_not_unpacked(tmp_path):
    (tmp_path / "bomb.vol.gz").write_bytes(gzip.compress(b"mesh3d\n" + b"0" * 300_000_000, compresslevel=1))
    with pytest.raises(ValueError, match="unpacks to more than 200 times its size"):
        as_mesh(tmp_path / "bomb.vol.gz")


def test_hostile_files_are_sound_before_they_are_damaged(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "hostile"))
    import mesh_files

    for name, text in (("a.vol", mesh_files.VOL), ("b.msh", mesh_files.MSH2), ("c.msh", mesh_files.MSH4),
                       ("d.vol.gz", gzip.compress(mesh_files.VOL.encode()))):
        (tmp_path / name).write_bytes(text.encode() if isinstance(text, str) else text)
        mesh = as_mesh(tmp_path / name)
        assert mesh.volumes.sum() == 2 and mesh.bodies == ("steel",)
