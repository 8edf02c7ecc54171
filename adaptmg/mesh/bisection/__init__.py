"""bisect and refine_near: nested refinement by bisection of marked elements.

Marked elements are cut until all their edges are halved (four triangles; at least eight tetrahedra), their neighbours
as far as conformity asks. Of a mesh that was never bisected the longest edges go first; later those opposite the newest
nodes (triangles), or those that Arnold, Mukherjee and Pouly mark (tetrahedra, see
:mod:`adaptmg.mesh.bisection.children`): shapes stay within a bounded number of classes. Every new node is the midpoint
of its two parents. On curved boundaries that midpoint lies on the chord: refined meshes are nested, and keep the shape
of the first mesh. :func:`adaptmg.mesh.onto_domain` moves new nodes onto the curve.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.bisection.refine import refined
from adaptmg.mesh.netgen_guard import MAX_NODES
from adaptmg.mesh.soundness import check_mesh

__all__ = ["bisect", "check_marked", "refine_near"]


def bisect(mesh: MeshArrays, marked: np.ndarray, passes: int | None = None) -> tuple[MeshArrays, np.ndarray]:
    """Refine the marked elements.

    Parameters
    ----------
    mesh : MeshArrays
        Not changed, nor its source.
    marked : (n_elements,) array of bool
        The elements to refine; at least one.
    passes : int, optional
        How often the marked elements are bisected, >= 1: once gives two of each, and adds fewest nodes. By default
        until all their edges are halved.

    Returns
    -------
    fine : MeshArrays
        Nested in ``mesh``; the old nodes come first and keep their numbers, names and bodies stay. It carries its
        history (``fine.refinement``), by which further bisection goes on.
    parents : (n_fine_nodes, 2) array of int
        Node i of ``fine`` is the midpoint of nodes ``parents[i]``, both below i (they may be new nodes themselves);
        of an old node both are i.

    Raises
    ------
    TypeError, ValueError
        If ``marked`` is not a mask over the elements, or marks none; if ``passes`` is not an integer >= 1.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> fine, parents = am.mesh.bisect(mesh, np.arange(len(mesh.elements)) < 2)
    >>> fine.n_nodes > mesh.n_nodes
    True
    """
    marked = check_marked(check_mesh(mesh), marked)
    if not marked.any():
        raise ValueError("marked marks no element: nothing to refine")
    fine = refined(mesh, marked, None if passes is None else checks.integer("passes", passes, 1)).mesh
    parents = np.array(fine.refinement.parents, dtype=np.int64)
    parents[:mesh.n_nodes] = np.arange(mesh.n_nodes)[:, None]
    return fine, parents


def check_marked(mesh: MeshArrays, marked: np.ndarray) -> np.ndarray:
    """Return ``marked`` as an array; TypeError or ValueError unless it is a boolean mask over the elements."""
    marked = np.asarray(marked)
    if marked.dtype != bool:
        raise TypeError(f"marked must be a boolean mask over the elements, got {marked.dtype}")
    if marked.shape != (len(mesh.elements),):
        raise ValueError(f"marked must have shape ({len(mesh.elements)},), got {marked.shape}")
    return marked


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
        On an unknown boundary, ``levels`` < 1, or where more than 5 million nodes (3D: 2 million) are expected:
        each level doubles the elements at the boundaries (3D: four times).

    Notes
    -----
    Elsewhere the mesh stays what it was: so does its part of the discretisation error.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> len(am.mesh.refine_near(mesh, "bottom", levels=2))
    3
    """
    levels = checks.integer("levels", levels, 1)
    names = (boundaries,) if isinstance(boundaries, str) else checks.strings("boundaries", boundaries)
    if not names:
        raise ValueError("boundaries must name at least one boundary")
    meshes = [check_mesh(mesh, names)]
    facets = sum(len(mesh.boundary_facets(name)) for name in names)
    # each facet is cut in 2 (3D: 4) a level, and gets about as many new nodes next to it
    expected = facets * (mesh.dim - 1) * 2.0 ** min((mesh.dim - 1) * levels, 1000)
    if mesh.n_nodes + expected > MAX_NODES[mesh.dim]:
        raise ValueError(f"levels: {levels} bisections along {facets} facets of {', '.join(names)} ask for about "
                         f"{mesh.n_nodes + expected:.1g} nodes (at most {MAX_NODES[mesh.dim]:.0e}); take fewer levels")
    for _ in range(levels):
        meshes.append(bisect(meshes[-1], _touching(meshes[-1], names))[0])
    return meshes


def _touching(mesh: MeshArrays, names: Sequence[str]) -> np.ndarray:
    """Mask of the elements with a node on one of some boundaries."""
    near = np.zeros(mesh.n_nodes, dtype=bool)
    for name in names:
        near[mesh.boundary_nodes(name)] = True
    return near[mesh.elements].any(axis=1)
