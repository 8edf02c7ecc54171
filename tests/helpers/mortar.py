"""The couplings of two surfaces, from arrays."""

import adaptmg as am
from adaptmg.discrete import mortar as module
from adaptmg.discrete.mortar_parts import Surfaces

__all__ = ["mortar", "node_normals", "node_to_node", "surfaces"]


def node_normals(points, facets):
    return am.mesh.Surface(points, facets).node_normals


def surfaces(points, slave, master, normals, *, excluded=(), axisymmetric=False):
    return Surfaces(
        am.mesh.Surface(points, slave),
        am.mesh.Surface(points, master),
        normals,
        [*excluded],
        axisymmetric,
    )


def mortar(*data, reach=None, **options):
    return module.mortar(surfaces(*data, **options), reach)


def node_to_node(*data, **options):
    return module.node_to_node(surfaces(*data, **options))
