r"""shape_arrays: the arrays of a mesh that Netgen made of an OCC solid at unit size: read, checked, placed, named.

Elements are straight: all nodes of curved faces lie on them, chords do not. The volume of the mesh therefore differs
from OCC's by :math:`O(h^2)`; it is compared with the bound :math:`\sum_F \tfrac12 A_F h_F \theta_F` over the boundary
triangles F, :math:`\theta` being the largest angle to a neighbour on the same face (on a sphere the error is a third to
a half of it).
"""

from __future__ import annotations

import math
from dataclasses import replace

import ngsolve
import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.build import own_mesh, with_source
from adaptmg.mesh.topology import facet_table
from adaptmg.problem.domains import Box, SolidDomain

__all__ = ["Unsound", "check_volume", "in_metres", "left_by_chords", "ordered", "placed", "read_shape"]

# of the largest coordinate: what scaling to unit size and back may move a node by
_FLAT = 1e-9
_DIGITS = 14


class Unsound(ValueError):
    """A mesh with holes, inverted elements or the wrong volume."""


def read_shape(mesh: ngsolve.Mesh) -> MeshArrays:
    """The checked arrays of a scaled mesh."""
    try:
        return own_mesh(mesh)
    except ValueError as error:
        raise Unsound(error) from error


def placed(unit: MeshArrays, lower: np.ndarray, scale: float) -> MeshArrays:
    """The mesh in m, without source."""
    return replace(unit, points=lower + scale * unit.points, source=None)


def in_metres(unit: MeshArrays, names: list[str], lower: np.ndarray, scale: float) -> MeshArrays:
    """The mesh of a scaled shape in m, its faces (called by their numbers so far) with their names; without source."""
    mesh = _in_planes(placed(unit, lower, scale))
    order = tuple(dict.fromkeys(names))
    faces = np.array([order.index(names[int(face)]) for face in mesh.boundaries])
    return replace(mesh, facet_labels=faces[mesh.facet_labels], boundaries=order, bodies=("body",),
                   source=None)


def ordered(domain: SolidDomain | Box, mesh: MeshArrays) -> MeshArrays:
    """The checked mesh with its boundaries in the order of the domain, with source."""
    order = tuple(name for name in domain.boundaries if name in mesh.boundaries)
    labels = np.array([order.index(name) for name in mesh.boundaries])[mesh.facet_labels]
    return with_source(replace(mesh, facet_labels=labels, boundaries=order, source=None))


def check_volume(mesh: MeshArrays, volume: float) -> None:
    """Raise Unsound unless the volume is right but for the chords of curved faces."""
    bound, meshed = left_by_chords(mesh) + 1e-5 * volume, float(mesh.volumes.sum())
    if not abs(meshed - volume) <= bound:
        raise Unsound(f"the mesh fills {meshed / volume:.6g} of the volume, chords explain a deviation of "
                       f"{bound / volume:.2g}")


def left_by_chords(mesh: MeshArrays) -> float:
    """Bound of the volume between curved faces and the mesh (module docstring)."""
    a, b, c = (mesh.points[mesh.facets[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    areas = 0.5 * np.linalg.norm(normals, axis=1)
    normals /= 2 * areas[:, None]
    longest = np.max([np.linalg.norm(e, axis=1) for e in (b - a, c - b, a - c)], axis=0)
    edges = facet_table(mesh.facets, mesh.n_nodes)
    first, second = edges.first, edges.second
    angles = np.arccos(np.clip(np.sum(normals[first] * normals[second], axis=1), -1.0, 1.0))
    angles[mesh.facet_labels[first] != mesh.facet_labels[second]] = 0.0
    turn = np.zeros(len(areas))
    np.maximum.at(turn, first, angles)
    np.maximum.at(turn, second, angles)
    return 0.5 * float(np.sum(areas * longest * turn))


def _in_planes(mesh: MeshArrays) -> MeshArrays:
    """Nodes of plane faces normal to an axis at one coordinate, free of the rounding of scaling."""
    points = mesh.points.copy()
    reach = float(np.abs(points).max())
    digits = _DIGITS - math.ceil(math.log10(reach))
    for face in mesh.boundaries:
        nodes = mesh.boundary_nodes(face)
        for axis in np.flatnonzero(np.ptp(points[nodes], axis=0) < _FLAT * reach):
            points[nodes, axis] = round(float(np.median(points[nodes, axis])), digits) + 0.0
    return replace(mesh, points=points, source=None)
