"""The couplings of two surfaces, from arrays."""

from adaptmg.discrete.mortar import pairs, segments, triangles
from adaptmg.discrete.mortar.interface import Surfaces
from adaptmg.mesh.arrays import Surface

__all__ = ["mortar_2d", "mortar_3d", "node_normals", "node_to_node", "surfaces"]


def node_normals(points, facets):
    return Surface(points, facets).node_normals


def surfaces(points, slave, master, normals, *, excluded=(), axisymmetric=False):
    return Surfaces(Surface(points, slave), Surface(points, master), normals, [*excluded], axisymmetric)


def mortar_2d(*data, reach=None, **options):
    return segments.mortar_2d(surfaces(*data, **options), reach)


def mortar_3d(*data, reach=None, **options):
    return triangles.mortar_3d(surfaces(*data, **options), reach)


def node_to_node(*data, **options):
    return pairs.node_to_node(surfaces(*data, **options))
