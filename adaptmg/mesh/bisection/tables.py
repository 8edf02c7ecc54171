"""A mesh into the tables of a bisection and out of them, with its history.

A table has a row of 32 bit integers for each element or node. Columns of an element: its corners, the boundary facet
opposite each (-1: none), marks, generation, origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg._numba import inner_kernel, kernel
from adaptmg.mesh.arrays import MeshArrays, Refinement, element_facets, sound_by_construction, trusted
from adaptmg.mesh.bisection.children import CODES, EVEN, first_labels

# columns of the nodes: first and next of the list of edges (see refine), and both ends of the edge that it halves
HEAD, NEXT, LOW, HIGH = 0, 1, 2, 3
NODE_COLUMNS = 4


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """A mesh made from another one by bisection."""

    mesh: MeshArrays  # trusted, with its history and a source on demand
    origin: np.ndarray  # (n_elements,) int: the element of the mesh before that holds each element


def parents_of(mesh: MeshArrays) -> np.ndarray:
    """Return the parents (n_nodes, 2) of each node since the initial mesh."""
    refinement = mesh.refinement
    if refinement is not None:
        return refinement.parents
    return np.repeat(np.arange(mesh.n_nodes, dtype=np.int32), 2).reshape(-1, 2)


def cells_of(mesh: MeshArrays, room: float = 0.0) -> np.ndarray:
    """Return the elements as a table, labelled if the mesh was never bisected, with ``room`` times the rows as room."""
    n, corners = mesh.elements.shape
    cells = np.empty((n + int(room * n), 2 * corners + 3), dtype=np.int32)
    cells[:n, :corners] = mesh.elements
    facets_into_cells(mesh.facets, cells, n, corners, np.full(mesh.n_nodes, -1, dtype=np.int32),
                      np.empty(len(mesh.facets), dtype=np.int32), np.zeros(mesh.n_nodes, dtype=bool))
    marks, refinement = 2 * corners, mesh.refinement
    if refinement is None:
        first_labels(mesh.points, cells, n, corners, EVEN, CODES, np.empty(2 * corners, dtype=np.int32))
        cells[:n, marks + 1] = 0
    else:
        cells[:n, marks] = refinement.marks
        cells[:n, marks + 1] = refinement.generation
    cells[:n, marks + 2] = np.arange(n)
    return cells


def nodes_of(mesh: MeshArrays, room: float) -> np.ndarray:
    """Return the nodes as a table in which no edge is cut, with ``room`` times the rows as room."""
    n = mesh.n_nodes
    nodes = np.empty((n + int(room * n), NODE_COLUMNS), dtype=np.int32)
    nodes[:n, HEAD] = -1
    return nodes


def mesh_of(before: MeshArrays, points: np.ndarray, parents: np.ndarray, cells: np.ndarray) -> MeshArrays:
    """Return the mesh that tables hold, with the boundaries and bodies of the mesh they come from."""
    corners = before.dim + 1
    marks = 2 * corners
    opposite = element_facets(np.arange(corners)[None])[0]
    # in the order of the facets they come from
    row, side = np.nonzero(cells[:, corners:marks] >= 0)
    origin = cells[row, corners + side]
    order = np.argsort(origin, kind="stable")
    facets, origin = cells[row[:, None], opposite[side]][order], origin[order]
    mesh = MeshArrays(points, cells[:, :corners], facets, before.facet_labels[origin], before.boundaries,
                      before.element_body[cells[:, -1]], before.bodies)
    history = Refinement(parents, cells[:, marks].astype(np.int8), cells[:, marks + 1].astype(np.int16))
    return with_refinement(sound_by_construction(mesh), history)


@inner_kernel
def _key(table, row, skip, corners):
    """Sum and largest of the corners but one: with the smallest they tell a face."""
    total, high, low = 0, -1, 2**31
    for k in range(corners):
        if k != skip:
            node = np.int64(table[row, k])
            total += node
            if node > high:
                high = node
            if node < low:
                low = node
    return total, high, low


@kernel
def facets_into_cells(facets, cells, n_cells, corners, head, following, on_boundary):
    """Write into the cells which boundary facet lies opposite each corner, -1 where there is none. Lists of facets by
    their highest node: ``head`` (n_nodes,) comes as -1, and ``on_boundary`` (n_nodes,) as False."""
    for f in range(len(facets)):
        _, high, _ = _key(facets, f, -1, corners - 1)
        following[f] = head[high]
        head[high] = f
        for k in range(corners - 1):
            on_boundary[facets[f, k]] = True
    found = 0
    for e in range(n_cells):
        inside = 0
        for k in range(corners):
            inside += not on_boundary[cells[e, k]]
        for k in range(corners):
            cells[e, corners + k] = -1
            if inside > 1 or (inside == 1 and on_boundary[cells[e, k]]):
                continue
            total, high, low = _key(cells, e, k, corners)
            f = head[high]
            while f >= 0:  # what follows in a list was entered before
                if _key(facets, f, -1, corners - 1) == (total, high, low):
                    cells[e, corners + k] = f
                    found += 1
                    break
                f = following[f]
    return found


def with_refinement(mesh: MeshArrays, refinement: Refinement | None) -> MeshArrays:
    """Return the same mesh with another history, its source and soundness kept."""
    result = trusted(mesh, vars(mesh)["source"], mesh.sound)
    object.__setattr__(result, "refinement", refinement)
    return result


def as_initial(mesh: MeshArrays) -> MeshArrays:
    """Return the mesh with its labels, but without its past: it counts as the initial one."""
    history = mesh.refinement
    if history is None:
        return mesh
    own = np.repeat(np.arange(mesh.n_nodes, dtype=np.int32), 2).reshape(-1, 2)
    return with_refinement(mesh, Refinement(own, history.marks, np.zeros(len(mesh.elements), np.int16)))
