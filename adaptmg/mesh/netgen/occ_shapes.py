r"""occ_shape: a solid as data -> OCC's shape with named faces, in scaled lengths :math:`(x - \text{origin}) / s`.

OCC compares lengths with absolute tolerances of 1e-7: everything is built near unit size. A boolean operation that goes
wrong does so without a word; its volume is therefore compared with the complementary one,

.. math:: |a \setminus b| + |a \cap b| = |a|, \qquad |a \cup b| + |a \cap b| = |a| + |b|.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from netgen.occ import ArcOfCircle, Axis, Dir, Edge, Face, Pnt, Segment, Solid, Sphere, TopoDS_Shape, Vec, Wire, X, Y, Z
from netgen.occ import Box as OccBox
from netgen.occ import Cylinder as OccCylinder
from netgen.occ import Fuse as OccFuse

from adaptmg.mesh.geometry import BOX_SIDES, require_simple
from adaptmg.problem.domains import (
    Ball,
    Box,
    Combination,
    Common,
    Cut,
    Cylinder,
    Extrusion,
    Moved,
    Outline,
    Revolution,
    SolidDomain,
)
from adaptmg.problem.domains.primitives import Profile, outline_of

__all__ = ["occ_shape"]

# volumes of boolean operations add up to 1e-9 of the operands
_VOLUME_TOLERANCE = 1e-6
_ZERO = np.zeros(3)


def occ_shape(domain: SolidDomain | Box, origin: np.ndarray, scale: float) -> Solid:
    """Build a solid.

    Parameters
    ----------
    domain : SolidDomain or Box
        What to build.
    origin : (3,) array
        Where the origin of the shape is to lie, m.
    scale : float
        Unit length of the shape, m.

    Returns
    -------
    netgen.occ.Solid
        A new shape; its faces have the names of the domain's boundaries.

    Raises
    ------
    TypeError, ValueError
        For another kind of domain, a profile that crosses itself, or a combination that fails, leaves nothing or leaves
        several pieces.
    """
    shape = _shape(domain, np.asarray(origin, dtype=np.float64), float(scale))
    if len(shape.solids) != 1:
        what = "nothing" if len(shape.solids) == 0 else f"{len(shape.solids)} pieces"
        raise ValueError(f"{domain!r} leaves {what}; a solid must be one piece")
    solid = shape.solids[0]
    for face in solid.faces:
        if face.name not in domain.boundaries:
            raise ValueError(f"a face of {domain!r} at {_point(face.center)} got no name from OCC; "
                             "move its parts a little against each other")
    return solid


def _shape(domain: SolidDomain | Box, origin: np.ndarray, scale: float) -> TopoDS_Shape:
    if isinstance(domain, Combination):
        return _combined(domain, origin, scale)
    if isinstance(domain, Moved):
        shape = _shape(domain.solid, _ZERO, scale)
        if domain.angle % 360:
            shape = shape.Rotate(Axis(Pnt(0, 0, 0), Dir(*domain.axis)), domain.angle)
        return shape.Move(Vec(*((np.array(domain.offset) - origin) / scale)))
    if isinstance(domain, Ball):
        shape = Sphere(Pnt(*((np.array(domain.centre) - origin) / scale)), domain.radius / scale)
        shape.faces.name = "surface"
        return shape
    if isinstance(domain, Cylinder):
        return OccCylinder(Pnt(*((np.array(domain.point) - origin) / scale)), Dir(*domain.axis), domain.radius / scale,
                           domain.height / scale, bottom="bottom", top="top", mantle="side")
    for kind, build in ((Box, _box), (Revolution, _revolution), (Extrusion, _extrusion)):
        if isinstance(domain, kind):
            return build(domain, origin, scale)
    raise TypeError(f"domain must be a Box or another solid (Cylinder, Ball, Revolution, Cut, ...), got {domain!r}")


def _point(p: Pnt) -> tuple[float, float, float]:
    return p.x, p.y, p.z


def _box(domain: Box, origin: np.ndarray, scale: float) -> Solid:
    solid = OccBox(Pnt(*((domain.lower - origin) / scale)), Pnt(*((domain.upper - origin) / scale)))
    for name, (axis, end) in BOX_SIDES.items():
        (solid.faces.Min, solid.faces.Max)[end]((X, Y, Z)[axis]).name = name
    return solid


def _revolution(domain: Revolution, origin: np.ndarray, scale: float) -> TopoDS_Shape:
    # the profile may touch the axis up to rounding: put those vertices onto it
    r_min = 1e-11 * float(domain.polygon.upper[0])

    def place(p: np.ndarray) -> Pnt:
        return Pnt(*((np.array([p[0] if p[0] > r_min else 0.0, 0.0, p[1]]) - origin) / scale))

    face = _profile_face(domain.polygon, place)
    shape = face.Revolve(Axis(place(np.zeros(2)), Z), domain.angle)
    if domain.angle < 360:
        start = np.array(_point(face.center))
        ends = [f for f in shape.faces if not f.name]
        ends.sort(key=lambda f: float(np.linalg.norm(np.array(_point(f.center)) - start)))
        for f, name in zip(ends, ("start", "end"), strict=True):
            f.name = name
    return shape


def _extrusion(domain: Extrusion, origin: np.ndarray, scale: float) -> TopoDS_Shape:
    def place(p: np.ndarray) -> Pnt:
        return Pnt(*((np.array([p[0], p[1], domain.base]) - origin) / scale))

    shape = _profile_face(domain.polygon, place).Extrude(Vec(0, 0, domain.height / scale))
    ends = sorted((f for f in shape.faces if not f.name), key=lambda f: f.center.z)
    for f, name in zip(ends, ("bottom", "top"), strict=True):
        f.name = name
    return shape


def _profile_face(profile: Profile, place: Callable[[np.ndarray], Pnt]) -> Face:
    """A plane face whose edges are named; ``place`` puts points of the profile into space."""
    outline = outline_of(profile)
    require_simple(outline)
    vertices = [np.array(v) for v in outline.vertices]
    edges, middles = [], []
    for i, (a, b) in enumerate(zip(vertices, vertices[1:] + vertices[:1], strict=True)):
        arc = outline.arc(i) if isinstance(outline, Outline) else None
        middle = 0.5 * (a + b) if arc is None else arc.at(np.array([0.5]))[0]
        edges.append(Segment(place(a), place(b)) if arc is None else ArcOfCircle(place(a), place(middle), place(b)))
        middles.append(_point(place(middle)))
    face = Face(Wire(edges))
    # the wire makes new edges: find each by its middle
    for edge in face.edges:
        distance = np.linalg.norm(np.array(middles) - _point(_middle(edge)), axis=1)
        edge.name = outline.boundaries[int(np.argmin(distance))]
    return face


def _middle(edge: Edge) -> Pnt:
    first, last = edge.parameter_interval
    return edge.Value(0.5 * (first + last))


def _combined(domain: Combination, origin: np.ndarray, scale: float) -> TopoDS_Shape:
    a, b = (_shape(part, origin, scale) for part in (domain.a, domain.b))
    for part, shape in (("a", a), ("b", b)):
        for face in shape.faces:
            face.name = domain.renamed(part, face.name)
    common = a * b
    if isinstance(domain, Common):
        shape, check = common, a.mass - (a - b).mass
    elif isinstance(domain, Cut):
        shape, check = a - b, a.mass - common.mass
    else:
        # not a + b, which also joins coplanar faces and so loses names
        shape, check = OccFuse([a, b]), a.mass + b.mass - common.mass
    if not (math.isfinite(shape.mass) and abs(shape.mass - check) <= _VOLUME_TOLERANCE * (a.mass + b.mass)):
        raise ValueError(f"OCC could not combine the parts of {domain!r}: the volumes do not add up "
                         f"({shape.mass:.9g} instead of {check:.9g}); move or resize one of them a little, so that "
                         "faces cross or coincide clearly")
    return shape
