"""The couplings of two surfaces, from arrays."""

from adaptmg.discrete.mortar import pairs, segments, triangles
from adaptmg.discrete.mortar.interface import Surfaces

__all__ = ["mortar_2d", "mortar_3d", "node_to_node"]


def mortar_2d(points, slave, master, normals, *, excluded=(), axisymmetric=False, reach=None):
    return segments.mortar_2d(Surfaces(points, slave, master, normals, [*excluded], axisymmetric), reach)


def mortar_3d(points, slave, master, normals, *, excluded=(), reach=None):
    return triangles.mortar_3d(Surfaces(points, slave, master, normals, [*excluded]), reach)


def node_to_node(points, slave, master, normals, *, excluded=(), axisymmetric=False):
    return pairs.node_to_node(Surfaces(points, slave, master, normals, [*excluded], axisymmetric))
