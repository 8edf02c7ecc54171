"""A problem whose nodes come after many others: products of their numbers leave 32 bits."""

from dataclasses import replace
from functools import cache

import numpy as np

import adaptmg as am

#: name of the other body, and of its boundary
FAR = "far"


@cache
def strip(dim: int, n_nodes: int) -> am.MeshArrays:
    """A strip of cells one cell thick, all of its nodes on its boundary."""
    kind = am.Rectangle if dim == 2 else am.Box
    depth = {} if dim == 2 else {"depth": 1}
    long = n_nodes // 2 ** (dim - 1)
    return am.mesh.structured(
        kind(width=long, height=1, **depth), (long, 1) if dim == 2 else (long, 1, 1)
    )


def mesh_behind(mesh: am.MeshArrays, n_nodes: int = 47_000) -> tuple[am.MeshArrays, int]:
    """The mesh after at least ``n_nodes`` nodes of another body, and how many these are."""
    far = strip(mesh.dim, n_nodes)
    n, size = far.n_nodes, np.ptp(mesh.points, axis=0).max()
    away = mesh.points.min(axis=0) - size * np.array([0.0] * (mesh.dim - 1) + [3.0])
    return (
        am.MeshArrays(
            points=np.concatenate([away + 0.5 * size * far.points, mesh.points]),
            elements=np.concatenate([far.elements, mesh.elements + n]),
            facets=np.concatenate([far.facets, mesh.facets + n]),
            facet_labels=np.concatenate([0 * far.facet_labels, mesh.facet_labels + 1]),
            boundaries=(FAR, *mesh.boundaries),
            element_body=np.concatenate([0 * far.element_body, mesh.element_body + 1]),
            bodies=(FAR, *mesh.bodies),
        ),
        n,
    )


def problem_behind(problem: am.ContactProblem, mesh: am.MeshArrays) -> am.ContactProblem:
    """The problem of such a mesh, whose other body is held."""
    materials = problem.material
    if not isinstance(materials, dict):
        materials = dict.fromkeys(mesh.bodies, materials)
    held = am.Support(FAR, **dict.fromkeys("xyz"[: mesh.dim], 0.0))
    return replace(
        problem,
        domain=None,
        # groups of nearly incompressible nodes are found along a curve through all of them
        material=materials | {FAR: type(next(iter(materials.values())))(young=1e11, poisson=0.3)},
        supports=(*problem.supports, held),
        reference={},
    )
