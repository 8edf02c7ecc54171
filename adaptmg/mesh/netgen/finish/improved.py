"""improved: a mesh whose elements are better shaped; its boundary stays as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.netgen.finish.tetrahedra import moved_tetrahedra
from adaptmg.mesh.netgen.finish.triangles import improved_triangles

__all__ = ["improved"]


def improved(mesh: MeshArrays, rounds: int) -> MeshArrays:
    """Better shaped elements, of about the same sizes.

    Parameters
    ----------
    mesh : MeshArrays
        Of one body, positively oriented.
    rounds : int
        In each, edges of triangles are swapped until none asks for it, and every inner node is moved once.

    Returns
    -------
    MeshArrays
        With the same nodes and facets; sound where ``mesh`` is; without source and history.
    """
    held = np.zeros(mesh.n_nodes, dtype=bool)
    held[mesh.facets] = True
    if mesh.dim == 2:
        points, elements = improved_triangles(mesh.points, mesh.elements, held, rounds)
    else:
        points, elements = moved_tetrahedra(mesh.points, mesh.elements, held, rounds), mesh.elements
    result = replace(mesh, points=points, elements=elements, source=None)
    # neither a swap nor a move turns an element over
    object.__setattr__(result, "sound", mesh.sound)
    return result
