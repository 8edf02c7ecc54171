"""The process that Netgen and OCC work in: domains and files in, plain arrays out.

:mod:`adaptmg.mesh.netgen_guard` runs this file as a script, without the package ``adaptmg.mesh``, so that neither numba
nor scipy is loaded. A request is the name of a function and its arguments; a shape or mesh stays
for the next request."""
# Netgen and OCC are compiled without type information
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import contextlib
import gzip
import io
import math
import os
import pickle
import queue
import re
import signal
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import netgen.meshing
import numpy as np
from netgen import occ
from netgen.geom2d import SplineGeometry
from netgen.occ import Dir, Face, OCCGeometry, Pnt, Solid, TopoDS_Shape, Vec, X, Y, Z

from adaptmg import _checks as checks
from adaptmg._machine import limit_memory, memory
from adaptmg.problem.combined_domains import Combination, Common, Cracked, Cut
from adaptmg.problem.plane_domains import BOX_SIDES, Box, Domain, Outline
from adaptmg.problem.solid_domains import Ball, Cylinder, Extrusion, Moved, Revolution, SolidDomain

if TYPE_CHECKING:
    import meshio
    import ngsolve
    from numpy.typing import ArrayLike


# what :func:`tables` returns
Tables = tuple[
    np.ndarray, np.ndarray, np.ndarray, np.ndarray, Sequence[str], np.ndarray, Sequence[str]
]
#: points (n, dim) and the sizes (n,) there, at most, at unit size
Sizes = Sequence[tuple[np.ndarray, np.ndarray]]

# the shapes of Netgen's element types; 12, 14 and 21 are of second order, of which only the corners are read
_KINDS = {10: "triangle", 12: "triangle", 11: "quad", 14: "quad", 20: "tetra", 21: "tetra"}
_KINDS |= {22: "pyramid", 23: "wedge", 25: "hexahedron"}
# largest angle of a spline, of which an arc is one or several
_MAX_TURN = math.radians(80.0)
# longest edge on an arc, of its radius; Netgen rounds the number of edges of a piece. Half makes 10 round
# shapes of 14 to 219 nodes 1.9 times as large, with least angles of 21 degrees in place of 28; twice 20
_MAX_EDGE = 0.4
# parameters of samples of surfaces: angles of those that are turned; half and twice change none of the
# meshes of 8 random solids
_ACROSS, _ALONG = (0.1, 0.5, 0.9, 1.3, 1.7), (0.01, 0.04, 0.07, 0.1, 0.13)
# where Gmsh puts the nodes that VTK counts in order, of kinds that meshio leaves alone
_ORDER = {
    "wedge18": (*range(7), 9, 7, 12, 14, 13, 8, 10, 11, 15, 17, 16),
    "pyramid14": (*range(6), 8, 10, 6, 7, 9, 11, 12, 13),
}


class _Held:
    """Objects that a request leaves for the next one."""

    mesh: object = None  # the last one made, of Netgen or (once bisected) of NGSolve
    shape: Solid = None  # the last one built, at about unit size
    file: tuple[str, int] | None = None  # the STEP file that was read last, and when it was changed
    step: tuple[OCCGeometry, Sequence[Solid]]  # its geometry and its solids


def tables(
    mesh: netgen.meshing.Mesh,
    boundaries: Sequence[str] | None = None,
    bodies: Sequence[str] | None = None,
) -> Tables:
    """Copy the tables of a mesh: points (n, dim), elements (n_elements, dim + 1), facets
    (n_facets, dim), labels of these, the names that labels are numbers of, the body of each element,
    names of the bodies. An ngsolve.Mesh knows the names of ``boundaries`` and ``bodies``; without
    either, they are those that Netgen's mesh has itself."""
    dim = mesh.dim
    if dim not in (2, 3):
        raise ValueError(f"mesh must be 2D or 3D, got a {dim}D mesh")
    volume, surface = (
        (mesh.Elements2D(), mesh.Elements1D())
        if dim == 2
        else (mesh.Elements3D(), mesh.Elements2D())
    )
    if len(volume) == 0 or len(surface) == 0:
        raise ValueError(
            "the mesh has no elements or no boundary facets; generate the volume mesh first"
        )
    points = np.array(mesh.Coordinates(), dtype=np.float64)[:, :dim]
    volume = volume.NumPy()
    surface = surface.NumPy()
    elements, body = _cut_into_simplices(volume, points)
    facets = surface["nodes"][:, :2].astype(np.int64) - 1
    label = surface["index"].astype(np.int64) - 1
    # in the plane the index of a segment is its boundary, in space that of a face descriptor
    if dim == 3:
        facets, label = _cut_into_simplices(surface)
        faces = np.array([face.bc for face in mesh.FaceDescriptors()], dtype=np.int64) - 1
        label = faces[_indices("the face descriptor", label, len(faces))]
    if boundaries is None or bodies is None:
        # a number far beyond the elements is a damaged one
        boundaries = [mesh.GetBCName(i).strip() for i in range(min(label.max() + 1, len(label)))]
        bodies = [mesh.GetMaterial(i + 1).strip() for i in range(min(body.max() + 1, len(body)))]
    _indices("the boundary number", label, len(boundaries))
    _indices("the material number", body, len(bodies))
    return points, elements, facets, label, boundaries, body, bodies


def ngsolve_mesh(
    points: np.ndarray,
    elements: np.ndarray,
    facets: np.ndarray,
    element_body: np.ndarray,
    facet_labels: np.ndarray,
    bodies: tuple[str, ...],
    boundaries: tuple[str, ...],
) -> ngsolve.Mesh:
    """Return the mesh of the fields of MeshArrays for NGSolve, with the same numbers of nodes, elements
    and facets; bodies become materials. It has no geometry, so that it stays straight when it is
    refined."""
    import ngsolve

    dim = points.shape[1]
    result = netgen.meshing.Mesh(dim=dim)
    result.AddPoints(np.ascontiguousarray(np.pad(points, ((0, 0), (0, 3 - dim)))))
    # of Netgen a face is a body in the plane, a boundary in space
    for i in range(len(bodies if dim == 2 else boundaries)):
        result.Add(
            netgen.meshing.FaceDescriptor(
                surfnr=i + 1, domin=i + 1 if dim == 2 else 1, domout=0, bc=i + 1
            )
        )
    for i, name in enumerate(bodies):
        result.SetMaterial(i + 1, name)
    if dim == 3:
        # Netgen counts the other orientation of tetrahedra as positive
        elements = np.ascontiguousarray(elements[:, [0, 1, 3, 2]])
    result.AddElements(dim=dim, index=1, data=elements, base=0)
    result.AddElements(dim=dim - 1, index=1, data=facets, base=0)
    volume, surface = (
        (result.Elements2D(), result.Elements1D())
        if dim == 2
        else (result.Elements3D(), result.Elements2D())
    )
    volume.NumPy()["index"] = element_body + 1
    surface.NumPy()["index"] = facet_labels + 1
    for i, name in enumerate(boundaries):
        result.SetBCName(i, name)
    return ngsolve.Mesh(result)


def _cut_into_simplices(
    table: np.ndarray, points: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return the simplices that the elements of a ``table`` of Netgen are, or are cut into, (n, dim + 1), or
    without ``points`` (n_nodes, dim) its facets, (n, dim), and the body (label) of each (n,), from 0. Middle
    nodes of second order, which only files can have, are left out: bodies have straight elements."""
    from adaptmg.mesh.shapes import KINDS, simplices

    cells = []
    owner = []
    for number in np.unique(table["type"]).tolist():
        if number not in _KINDS:
            raise ValueError(f"the mesh has elements of Netgen's type {number}, which is not read")
        kind = _KINDS[number]
        rows = np.flatnonzero(table["type"] == number)
        # the corners come first
        nodes = table["nodes"][rows, : KINDS[kind][1]].astype(np.int64) - 1
        simple = kind in ("triangle", "tetra")
        found, cell_of = (nodes, np.arange(len(rows))) if simple else simplices(kind, nodes, points)
        cells.append(found)
        owner.append(rows[cell_of])
    return np.concatenate(cells), table["index"][np.concatenate(owner)].astype(np.int64) - 1


def _indices(what: str, index: np.ndarray, size: int) -> np.ndarray:
    """Return an index (n,) unchanged; ValueError, which names ``what`` it is, unless it is
    from 0 to ``size`` - 1."""
    if index.min() < 0 or index.max() >= size:
        raise ValueError(
            f"mesh: {what} of an element must be from 1 to {size}, got {index.min() + 1} to "
            f"{index.max() + 1}"
        )
    return index


def mesh_plane(
    domain: Outline,
    lower: np.ndarray,
    scale: float,
    sides: Mapping[str, float],
    options: Mapping[str, float],
    sizes: Sizes,
) -> Tables:
    """Mesh a domain moved by ``-lower`` and divided by ``scale``, with the sizes ``sides`` along some
    boundaries; see :func:`_generated`."""
    return _generated(_spline_geometry(domain, lower, scale, sides), options, sizes)


def mesh_shape(
    face_sizes: Mapping[int, float], options: Mapping[str, float], sizes: Sizes
) -> Tables:
    """Mesh the shape of the last request; its faces are called by their numbers, by which ``face_sizes``
    has sizes along them. See :func:`_generated`."""
    for i, face in enumerate(_Held.shape.faces):
        face.name = str(i)
        if i in face_sizes:
            face.maxh = face_sizes[i]
    return _generated(OCCGeometry(_Held.shape), options, sizes)


def _generated(
    geometry: SplineGeometry | OCCGeometry, options: Mapping[str, float], sizes: Sizes
) -> Tables:
    """Return the tables of Netgen's mesh of a geometry, with ``options`` of its MeshingParameters, and sizes
    at most as given at points; the mesh is held for further requests."""
    # Netgen's threads spend more time waiting than the work takes: 3 to 30 times slower
    parameters = netgen.meshing.MeshingParameters(**options, parallel_meshing=False)
    for points, lengths in sizes:
        # one call a point is Netgen's only interface
        columns = np.pad(points, ((0, 0), (0, 3 - points.shape[1]))).T.tolist()
        for x, y, z, h in zip(*columns, lengths.tolist(), strict=True):
            parameters.RestrictH(x, y, z, h)
    mesh = geometry.GenerateMesh(mp=parameters)
    _Held.mesh = mesh
    return tables(mesh)


def bisect(marked: np.ndarray) -> Tables:
    """Bisect marked elements of the last mesh; new nodes go onto the surfaces of its geometry."""
    import ngsolve

    if not isinstance(_Held.mesh, ngsolve.Mesh):
        _Held.mesh = ngsolve.Mesh(_Held.mesh)
    _Held.mesh.SetRefinementFlags(marked.tolist())
    _Held.mesh.Refine()
    return tables(_Held.mesh.ngmesh)


def _spline_geometry(
    domain: Outline, lower: np.ndarray, scale: float, sides: Mapping[str, float]
) -> SplineGeometry:
    r"""Return Netgen's geometry of a plane domain at unit size, (x - ``lower``) / ``scale``, with edges
    called by their numbers; ``sides`` are sizes along some boundaries. An arc becomes
    rational quadratic splines, which are exact circles: the middle control point is the meeting
    point of the tangents, at the distance
    :math:`r / \cos(\theta / 2)` from the centre."""
    geometry = SplineGeometry()
    number = {
        vertex: geometry.AppendPoint(*(np.array(vertex) - lower) / scale)
        for vertex in dict.fromkeys(domain.vertices)
    }
    corners = [number[vertex] for vertex in domain.vertices]
    for i, name in enumerate(domain.boundaries):
        if i in domain.twins:
            continue  # the right face of a crack: the left one is an edge with the body on both sides
        is_left_face = i in domain.twins.values()
        options = {
            "leftdomain": 1,
            "rightdomain": int(is_left_face),
            "bc": str(i),
            "maxh": sides.get(name, checks.VAST),
        }
        first = corners[i]
        last = corners[domain.following[i]]
        arc = domain.arc(i)
        if arc is None:
            geometry.Append(["line", first, last], **options)
            continue
        pieces = math.ceil(abs(arc.angle) / _MAX_TURN)
        options["maxh"] = min(options["maxh"], _MAX_EDGE * arc.radius / scale)
        center = np.array(arc.center)
        stretch = 1 / math.cos(0.5 * arc.angle / pieces)
        ends = arc.at(np.arange(1, pieces) / pieces)
        middles = center + stretch * (arc.at((np.arange(pieces) + 0.5) / pieces) - center)
        numbers = [first, *(geometry.AppendPoint(*place) for place in (ends - lower) / scale), last]
        for k, middle in enumerate((middles - lower) / scale):
            geometry.Append(
                ["spline3", numbers[k], geometry.AppendPoint(*middle), numbers[k + 1]], **options
            )
    geometry.SetMaterial(1, "body")
    return geometry


# what :func:`_hold` returns
ShapeTables = tuple[list[str], list[float], float, np.ndarray, list[np.ndarray], np.ndarray]


def build_shape(domain: SolidDomain | Box, origin: np.ndarray, scale: float) -> ShapeTables:
    """Hold OCC's shape of a solid in lengths (x - origin) / scale, and return its tables, as
    :func:`_hold`. OCC compares lengths with absolute tolerances of 1e-7: all is built near unit size."""
    shape = _shape(domain, origin, scale)
    if len(shape.solids) != 1:
        what = "nothing" if len(shape.solids) == 0 else f"{len(shape.solids)} pieces"
        raise ValueError(f"{domain!r} leaves {what}; a solid must be one piece")
    solid = shape.solids[0]
    for face in solid.faces:
        if face.name not in domain.boundaries:
            raise ValueError(
                f"a face of {domain!r} at {_place(face.center)} got no name from OCC; "
                "move its parts a little against each other"
            )
    return _hold(solid)


def _step(path: str) -> tuple[OCCGeometry, Sequence[Solid]]:
    """Return the geometry of a STEP file and its solids, read once as long as it does not
    change."""
    key = (path, os.stat(path).st_mtime_ns)
    if _Held.file != key:
        geometry = OCCGeometry(path)
        _Held.step = (geometry, list(geometry.solids))
        _Held.file = key
    return _Held.step


def read_step(path: str) -> list[tuple[str, str, list[str]]]:
    """Return of each solid of a STEP file the name of its product, its own name and those of its
    faces, "" where there is none. A product of several solids names none of them."""
    geometry, solids = _step(path)
    products: dict[Solid, str] = {}
    tree = geometry.GetAssemblyTree()
    if tree is not None:
        _name_products(tree, "", *_parts_of(Path(path).read_text("latin-1")), products)
    return [
        (products.get(solid, ""), solid.name or "", [face.name or "" for face in solid.faces])
        for solid in solids
    ]


def _name_products(
    node: occ.OCCAssemblyNode,
    part: str,
    names: Mapping[str, str],
    uses: Mapping[str, Sequence[tuple[str, str]]],
    products: dict[Solid, str],
) -> None:
    """Enter the names of the products of the solids below a node into ``products``: of a vice with two
    instances "M6:1" and "M6:2" of a screw "M6" this is "M6" for both.

    Netgen knows the names of instances only. The file (``names``, ``uses`` of :func:`_parts_of`) says
    which part an instance is of, and how the product of the part is called; ``part`` is the number of
    the part of the node. A product without a name is called after its instance."""
    instances = list(uses.get(part, ()))
    for child in node.children:
        # where OCC reads another name than the file has, it is the next instance in the file
        same_name = [instance for instance in instances if instance[0] == child.name]
        matching = same_name or instances[:1]
        part_of_child = ""  # in no instance of the file: a part without a name
        if matching:
            instances.remove(matching[0])
            _, part_of_child = matching[0]
        _name_products(child, part_of_child, names, uses, products)
    # several solids of one product would all have its name
    if not node.is_assembly and node.shape is not None and len(node.shape.solids) == 1:
        # OCC calls an instance without a name after the place of its shape: =>[0:1:1:3]
        instance_name = "" if node.name.startswith("=>[") else node.name
        products[node.shape.solids[0]] = names.get(part) or instance_name


def _parts_of(text: str) -> tuple[dict[str, str], dict[str, list[tuple[str, str]]]]:
    """Return the names of the parts of a STEP file by their numbers, and by the number of a part
    the instances in it: their names and the numbers of what they are instances of. Parts that are
    in no other are instances in "".

    The file writes (strings may be $, and doubled quotes stand for one)

        #1=PRODUCT('id','name',...)
        #2=PRODUCT_DEFINITION_FORMATION('id','text',#1)
        #3=PRODUCT_DEFINITION('id','text',#2,...)                       the part number 3
        #9=NEXT_ASSEMBLY_USAGE_OCCURRENCE('id','name','text',#3,#7,$)   an instance of 7 in 3"""
    string = r"(?:[^']|'')*"
    described = rf"\s*\(\s*'(?P<id>{string})'\s*,\s*(?:'(?P<name>{string})'|\$)\s*,\s*"
    text = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)

    def rows(pattern: str) -> list[dict[str, str]]:
        matches = re.finditer(rf"#(?P<number>\d+)\s*=\s*{pattern}", text)
        return [
            {key: _decoded(value or "") for key, value in row.groupdict().items()}
            for row in matches
        ]

    product = {row["number"]: row["name"] or row["id"] for row in rows(rf"PRODUCT{described}")}
    version = {
        row["number"]: product.get(row["product"], "")
        for row in rows(rf"PRODUCT_DEFINITION_FORMATION\w*{described}#(?P<product>\d+)")
    }
    names = {
        row["number"]: version.get(row["version"], "")
        for row in rows(rf"PRODUCT_DEFINITION(?:_WITH_\w+)?{described}#(?P<version>\d+)")
    }
    parts = r"#(?P<whole>\d+)\s*,\s*#(?P<part>\d+)"
    instances = rows(rf"NEXT_ASSEMBLY_USAGE_OCCURRENCE{described}(?:'{string}'|\$)\s*,\s*{parts}")
    used = {row["part"] for row in instances}
    uses = {"": [(name, number) for number, name in names.items() if number not in used]}
    for row in instances:
        uses.setdefault(row["whole"], []).append((row["name"] or row["id"], row["part"]))
    return names, uses


def _decoded(string: str) -> str:
    """Return a string of a STEP file (ISO 10303-21, 6.4.3), with letters beyond ASCII."""
    wide = re.sub(
        r"\\X([24])\\((?:[0-9A-F]{4})*)\\X0\\",
        lambda found: bytes.fromhex(found[2]).decode(f"utf-{8 * int(found[1])}-be", "replace"),
        string.replace("''", "'"),
    )
    return re.sub(r"\\X\\([0-9A-F]{2})", lambda found: chr(int(found[1], 16)), wide)


def step_surface(size: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points (n, 3), outward triangles (m, 3) and the face of each (m,), of a surface mesh of the
    shape of the last request, with edges of at most ``size``."""
    mesh = OCCGeometry(_Held.shape).GenerateMesh(
        maxh=size, perfstepsend=netgen.meshing.MeshingStep.MESHSURFACE
    )
    found = mesh.Elements2D().NumPy()
    return (
        np.array(mesh.Coordinates()),
        found["nodes"][:, :3].astype(np.int64) - 1,
        found["index"].astype(np.int64) - 1,
    )


def face_sides() -> tuple[np.ndarray, np.ndarray]:
    """Return the bounding boxes (n, 2, 3) of the faces of the shape of the last request, and the
    outward normals (n, 3) of those that are plane."""
    boxes = []
    normals = []
    for face in _Held.shape.faces:
        boxes.append([_place(p) for p in face.bounding_box])
        normal = _samples(face)[..., 3:].reshape(-1, 3)
        if not np.ptp(normal, axis=0).max() < checks.ALIKE:
            normals.append([math.nan] * 3)
            continue
        # the surface does not know which side is outside: the face and its turned copy next to it
        # enclose a volume, which is negative where the copy lies outside
        volume = occ.Compound([face, face.Move(Vec(*normal[0])).Reversed()]).mass
        normals.append(-math.copysign(1, volume) * normal[0])
    return np.array(boxes), np.array(normals)


def face_distances(path: str, number: int, face: int, points: np.ndarray) -> np.ndarray:
    """Return the distances (n,) of points (n, 3) from the face with the number ``face`` of solid ``number``
    of a STEP file, in the unit of the file."""
    shape = list(_step(path)[1][number].faces)[face]
    return np.array([occ.Vertex(Pnt(*point)).Distance(shape) for point in points.tolist()])


def step_shape(path: str, number: int) -> tuple[ShapeTables, np.ndarray, float]:
    """Return the tables of a solid of a STEP file at unit size, its lowest corner (3,) and its size, both
    in the unit of the file."""
    solid = _step(path)[1][number]
    lower, upper = (np.array(_place(p)) for p in solid.bounding_box)
    scale = float((upper - lower).max())
    if not (
        np.isfinite([*lower, *upper]).all()
        and scale > 0
        and math.isfinite(solid.mass)
        and solid.mass > 0
    ):
        raise ValueError(f"solid {number + 1} has no finite size or volume")
    shape = solid.Move(Vec(*(-lower))).Scale(Pnt(0, 0, 0), 1 / scale).solids[0]
    return _hold(shape), lower, scale


def _hold(solid: Solid) -> ShapeTables:
    """Store a solid for further requests, and return the first entries of
    :class:`adaptmg.mesh.netgen_meshes.Shape`, all in lengths of the solid: names and areas of its n
    faces, its volume, its bounding box (2, 3), samples (2, 25, 6) of the surface of each face, and the
    centres (n, 3) of the faces. OCC's ``mass`` is the area of a face, or the volume of a solid."""
    _Held.shape = solid
    faces = list(solid.faces)
    return (
        [face.name for face in faces],
        [face.mass for face in faces],
        solid.mass,
        np.array([_place(p) for p in solid.bounding_box]),
        [_samples(face) for face in faces],
        np.array([_place(face.center) for face in faces]),
    )


def _samples(face: Face) -> np.ndarray:
    """Return points x, y, z and unit normals (2, n, 6) on two patches of n = 25 points of the surface
    of a face, one on either side of an apex."""
    # D1: the point with the parameters u and v, and its derivatives by them
    found = np.array(
        [
            [[_place(x) for x in face.surf.D1(u, sign * v)] for u in _ACROSS for v in _ALONG]
            for sign in (1.0, -1.0)
        ]
    )
    normals = np.cross(found[:, :, 1], found[:, :, 2])
    with np.errstate(invalid="ignore"):
        # nan where there is none
        normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    return np.concatenate([found[:, :, 0], normals], axis=2)


def _shape(domain: Domain, origin: np.ndarray, scale: float) -> TopoDS_Shape:
    """Return OCC's shape of a solid in lengths (x - origin) / scale, its faces named."""

    def place(p: ArrayLike) -> Pnt:
        return Pnt(*((np.asarray(p, dtype=np.float64) - origin) / scale))

    if isinstance(domain, Combination):
        return _combination(domain, origin, scale)
    if isinstance(domain, Cracked):
        parts = [_shape(domain.domain, origin, scale)]
        for name, path in domain.cracks.items():
            ends = list(map(place, path))
            face = Face(occ.Wire([occ.Segment(a, b) for a, b in pairwise([*ends, ends[0]])]))
            face.name = f"{name}.left"
            parts.append(face)
        return occ.Glue(parts)
    if isinstance(domain, Moved):
        shape = _shape(domain.solid, np.zeros(3), scale)
        if domain.angle % 360:
            shape = shape.Rotate(occ.Axis(Pnt(0, 0, 0), Dir(*domain.axis)), domain.angle)
        return shape.Move(Vec(*((np.array(domain.offset) - origin) / scale)))
    if isinstance(domain, Ball):
        shape = occ.Sphere(place(domain.centre), domain.radius / scale)
        shape.faces.name = "surface"
        return shape
    if isinstance(domain, Cylinder):
        return occ.Cylinder(
            place(domain.point),
            Dir(*domain.axis),
            domain.radius / scale,
            domain.height / scale,
            bottom="bottom",
            top="top",
            mantle="side",
        )
    if isinstance(domain, Box):
        solid = occ.Box(place(domain.lower), place(domain.upper))
        for name, (axis, end) in BOX_SIDES.items():
            (solid.faces.Min, solid.faces.Max)[end]((X, Y, Z)[axis]).name = name
        return solid
    if isinstance(domain, Revolution):
        # the profile may touch the axis up to rounding: put those vertices onto it
        r_min = 1e-11 * float(domain.polygon.upper[0])
        face = _profile_face(
            domain.polygon, lambda p: place((p[0] if p[0] > r_min else 0.0, 0.0, p[1]))
        )
        shape = face.Revolve(occ.Axis(place(np.zeros(3)), Z), domain.angle)
        start = np.array(_place(face.center))
        if domain.angle < 360:
            # the start of the turn is the profile itself
            _name_ends(
                shape,
                ("start", "end"),
                lambda f: float(np.linalg.norm(np.array(_place(f.center)) - start)),
            )
        return shape
    if isinstance(domain, Extrusion):
        face = _profile_face(domain.polygon, lambda p: place((p[0], p[1], domain.base)))
        shape = face.Extrude(Vec(0, 0, domain.height / scale))
        _name_ends(shape, ("bottom", "top"), lambda f: f.center.z)
        return shape
    raise TypeError(
        f"domain must be a Box or another solid (Cylinder, Ball, Revolution, Cut, ...), got {domain!r}"
    )


def _place(p: Pnt | Vec) -> tuple[float, float, float]:
    return p.x, p.y, p.z


def _name_ends(shape: TopoDS_Shape, names: tuple[str, str], key: Callable[[Face], float]) -> None:
    """Name the two faces that no edge of the profile gave a name, in the order of ``key``."""
    for face, name in zip(
        sorted((f for f in shape.faces if not f.name), key=key), names, strict=True
    ):
        face.name = name


def _profile_face(outline: Outline, place: Callable[[np.ndarray], Pnt]) -> Face:
    """Return the plane face inside an outline, its edges named; ``place`` puts points of the plane
    into space."""
    vertices = [np.array(v) for v in outline.vertices]
    edges = []
    middles = []
    for i, (a, b) in enumerate(zip(vertices, vertices[1:] + vertices[:1], strict=True)):
        arc = outline.arc(i)
        middle = 0.5 * (a + b) if arc is None else arc.at(np.array([0.5]))[0]
        edges.append(
            occ.Segment(place(a), place(b))
            if arc is None
            else occ.ArcOfCircle(place(a), place(middle), place(b))
        )
        middles.append(_place(place(middle)))
    face = Face(occ.Wire(edges))
    # the wire makes new edges: find each by its middle
    for edge in face.edges:
        middle = _place(edge.Value(0.5 * sum(edge.parameter_interval)))
        edge.name = outline.boundaries[
            int(np.argmin(np.linalg.norm(np.array(middles) - middle, axis=1)))
        ]
    return face


def _combination(domain: Combination, origin: np.ndarray, scale: float) -> TopoDS_Shape:
    r"""Return the shape that a boolean operation makes, at (x - ``origin``) / ``scale``. OCC may
    get it wrong without an error: volumes are compared with the complementary ones, :math:`|a
    \setminus b| + |a \cap b| = |a|` and :math:`|a \cup b| + |a \cap b| = |a| + |b|`."""
    a, b = (_shape(part, origin, scale) for part in (domain.a, domain.b))
    for part, shape in (("a", a), ("b", b)):
        for face in shape.faces:
            face.name = domain.renamed(part, face.name)
    common = a * b
    if isinstance(domain, Common):
        shape = common
        check = a.mass - (a - b).mass
    elif isinstance(domain, Cut):
        shape = a - b
        check = a.mass - common.mass
    else:
        # not a + b, which also joins coplanar faces and so loses names
        shape = occ.Fuse([a, b])
        check = a.mass + b.mass - common.mass
    if not (
        math.isfinite(shape.mass)
        and abs(shape.mass - check) <= checks.SIX_DIGITS * (a.mass + b.mass)
    ):
        raise ValueError(
            f"OCC could not combine the parts of {domain!r}: the volumes do not add up "
            f"({shape.mass:.9g} instead of {check:.9g}); move or resize one of them a little, so that "
            "faces cross or coincide clearly"
        )
    return shape


def read_vol(path: str) -> Tables:
    """Return the tables of a mesh file of Netgen."""
    data = Path(path).read_bytes()
    if b"\nendmesh" not in (gzip.decompress(data) if path.endswith(".gz") else data):
        raise ValueError("it is cut off: the keyword 'endmesh' is missing")
    mesh = netgen.meshing.Mesh()
    mesh.Load(path)
    return tables(mesh)


# what :func:`read_meshio` returns
MeshioTables = tuple[np.ndarray, list, dict, dict]


def read_meshio(path: str) -> MeshioTables:
    """Return points, cells (kind, nodes), sets of cells (block, rows) and sets of nodes of a file
    that meshio reads. In files of Gmsh, meshio takes only the first of the groups without names that
    share a curve, and only the last of the groups of different dimensions that share a name."""
    import meshio

    # its readers know these kinds, and make meshes of them fail: its table of dimensions lacks them
    dimensions = sys.modules[meshio.Mesh.__module__].topological_dimension
    dimensions.update(wedge15=3, pyramid13=3, tetra4=3)
    with open(path, "rb") as file:
        begins = file.readline(60).decode("latin-1").strip()
    printed = io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            raw = meshio.read(path)
    except ModuleNotFoundError as error:
        raise ValueError(f"{error.name} reads it: pip install 'adaptmg[formats]'") from None
    except KeyError as error:
        raise ValueError(f"meshio does not know its {error}") from None
    except (SystemExit, meshio.ReadError) as error:
        # meshio prints what its readers of the suffix say, and ends the process
        cause = (
            printed.getvalue().strip() or "it is not what the suffix says"
            if isinstance(error, SystemExit)
            else "it has no reader for the suffix"
        )
        raise ValueError(f"meshio does not read it ({cause}); it begins with {begins!r}") from None
    of_gmsh = "gmsh:geometrical" in raw.cell_data
    sets, node_sets = _sets_of(raw)
    if of_gmsh or not sets:
        # of Gmsh, groups whose numbers are negative, of curves that run the other way, are in no set; other files
        # may have numbers of cells in place of sets
        numbered = _numbered(raw)
        sets = {name: numbered.get(name, []) + sets.get(name, []) for name in numbered | sets}
    points = np.zeros((len(raw.points), 3))
    points[:, : raw.points.shape[1]] = raw.points
    # Exodus calls tetrahedra tetra4
    kinds = [block.type.replace("tetra4", "tetra") for block in raw.cells]
    cells = [(kind, np.asarray(block.data)) for kind, block in zip(kinds, raw.cells, strict=True)]
    if of_gmsh:
        cells = [
            (kind, nodes[:, _ORDER[kind]] if kind in _ORDER else nodes) for kind, nodes in cells
        ]
    return points, cells, sets, node_sets


# by name: numbers of blocks, and rows of these
_CellSets = dict[str, list[tuple[int, np.ndarray]]]


def _sets_of(raw: Any) -> tuple[_CellSets, dict[str, np.ndarray]]:
    """Return the named sets of cells (block, rows) and of nodes that meshio has read."""
    if hasattr(raw, "cell_tags"):
        # of MED: the names of groups by numbers of families
        sets = _groups(raw.cell_tags, raw.cell_data.get("cell_tags", []))
        nodes = _groups(raw.point_tags, [raw.point_data.get("point_tags", np.empty(0))])
        return sets, {name: np.concatenate([r for _, r in rows]) for name, rows in nodes.items()}
    sets = {
        name: [(k, rows) for k, rows in enumerate(members) if rows is not None and len(rows)]
        for name, members in raw.cell_sets.items()
        if not name.startswith("gmsh:")
    }
    return sets, {name: np.asarray(rows) for name, rows in raw.point_sets.items()}


def _groups(names: Mapping[int, Sequence[str]], numbers: Sequence[np.ndarray]) -> _CellSets:
    """Return the blocks and rows of each group, from the groups of each family (``names``) and the family
    of each row of each block (``numbers``)."""
    groups: _CellSets = {}
    for family, names_of_family in names.items():
        for name in names_of_family:
            rows = [(k, np.flatnonzero(part == family)) for k, part in enumerate(numbers)]
            groups.setdefault(name, []).extend(rows)
    return groups


def _numbered(raw: meshio.Mesh) -> _CellSets:
    """Return sets of cells (block, rows) by their names: cells that have the same number in the
    first data that are whole numbers. Of Gmsh these are the numbers of physical groups: 0 of cells
    that are in none, negative ones of curves that run against their group."""
    sets: _CellSets = {}
    whole_numbers = {
        key: parts
        for key, parts in raw.cell_data.items()
        if key != "gmsh:geometrical"
        and all(part.dtype.kind in "iu" and part.ndim == 1 for part in parts)
    }
    key = next(iter(whole_numbers), "")
    of_groups = key == "gmsh:physical"
    names = {
        tuple(map(int, pair)): name for name, pair in raw.field_data.items() if np.size(pair) == 2
    }
    for k, (block, part) in enumerate(zip(raw.cells, whole_numbers.get(key, []), strict=False)):
        for value in np.unique(part).tolist():
            if of_groups and value == 0:
                continue
            number = abs(value) if of_groups else value
            name = names.get((number, block.dim), str(number))
            sets.setdefault(name, []).append((k, np.flatnonzero(part == value)))
    return sets


def _serve() -> None:
    """Answer requests until the process that asks ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # libraries print: away from the answers
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    requests: queue.SimpleQueue = queue.SimpleQueue()

    def listen() -> None:
        try:
            while True:
                requests.put(pickle.load(sys.stdin.buffer))
        finally:
            # whatever Netgen is at: nobody waits for it
            os._exit(0)

    threading.Thread(target=listen, daemon=True).start()
    # as much as the machine has, but 4 GB on a small one: what libraries map without using it counts, too
    limit_memory(max(4e9, memory()))
    while True:
        name, arguments = requests.get()
        try:
            answer: tuple[bool, object] = (True, globals()[name](*arguments))
        except (ValueError, netgen.meshing.NgException, RuntimeError) as error:
            answer = (False, str(error))
        except BaseException as error:
            answer = (False, f"{type(error).__name__}: {error}")
        pickle.dump(answer, answers, protocol=pickle.HIGHEST_PROTOCOL)
        answers.flush()


if __name__ == "__main__":
    _serve()
