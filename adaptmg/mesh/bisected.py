"""bisect and refine_near: nested refinement by NGSolve's marked bisection.

Marked elements are cut until all their edges are halved (four triangles; at least eight tetrahedra), their neighbours
as far as conformity asks. The longest edges go first; every new node is the midpoint of its two parents. On the arcs of
an :class:`~adaptmg.problem.Outline` that midpoint lies on the chord: refined meshes are nested, and keep the shape of
the first mesh. The curve itself is approached by new meshes (:func:`adaptmg.mesh.graded`) only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.build import own_mesh, to_ngsolve
from adaptmg.mesh.check import check_mesh
from adaptmg.problem import checks

__all__ = ["bisect", "refine_near"]


def bisect(mesh: MeshArrays, marked: np.ndarray) -> tuple[MeshArrays, np.ndarray]:
    """Refine the marked elements.

    Parameters
    ----------
    mesh : MeshArrays
        Not changed, nor its source.
    marked : (n_elements,) array of bool
        The elements to refine; at least one.

    Returns
    -------
    fine : MeshArrays
        Nested in ``mesh``; the old nodes come first and keep their numbers, names and bodies stay.
    parents : (n_fine_nodes, 2) array of int
        Node i of ``fine`` is the midpoint of nodes ``parents[i]``, both below i (they may be new nodes themselves);
        of an old node both are i.

    Raises
    ------
    TypeError, ValueError
        If ``marked`` is no mask over the elements, or marks none.
    """
    check_mesh(mesh)
    marked = np.asarray(marked)
    if marked.dtype != bool:
        raise TypeError(f"marked must be a boolean mask over the elements, got {marked.dtype}")
    if marked.shape != (len(mesh.elements),):
        raise ValueError(f"marked must have shape ({len(mesh.elements)},), got {marked.shape}")
    if not marked.any():
        raise ValueError("marked marks no element: nothing to refine")
    # a copy: Refine changes a mesh, and views of it dangle
    copy = to_ngsolve(mesh.points, mesh.elements, mesh.facets, mesh.facet_labels, mesh.boundaries,
                      element_body=mesh.element_body, bodies=mesh.bodies)
    copy.SetRefinementFlags(marked.tolist())
    copy.Refine()
    parents = np.repeat(np.arange(copy.nv), 2).reshape(-1, 2)
    # NGSolve tells parents node by node only: 0.2 us each, small beside the refinement itself
    parents[mesh.n_nodes:] = [copy.GetParentVertices(i) for i in range(mesh.n_nodes, copy.nv)]
    return own_mesh(copy), parents


def refine_near(mesh: MeshArrays, boundaries: str | Sequence[str], levels: int = 1) -> list[MeshArrays]:
    """Refine the elements that touch some boundaries, again and again.

    Parameters
    ----------
    mesh : MeshArrays
        The coarsest mesh.
    boundaries : str or sequence of str
        Elements with a node on one of these are marked; of several bodies the names are "body.edge".
    levels : int
        How many times, >= 1.

    Returns
    -------
    list of MeshArrays
        ``levels + 1`` nested meshes, coarse to fine, the first being ``mesh`` itself.

    Raises
    ------
    ValueError
        On an unknown boundary or ``levels`` < 1.
    """
    levels = checks.integer("levels", levels, 1)
    names = (boundaries,) if isinstance(boundaries, str) else tuple(boundaries)
    if not names:
        raise ValueError("boundaries must name at least one boundary")
    meshes = [check_mesh(mesh, names)]
    for _ in range(levels):
        coarse = meshes[-1]
        near = np.zeros(coarse.n_nodes, dtype=bool)
        for name in names:
            near[coarse.boundary_nodes(name)] = True
        meshes.append(bisect(coarse, near[coarse.elements].any(axis=1))[0])
    return meshes
