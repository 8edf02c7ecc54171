"""coarsen: bisections taken back whose children are all marked, never below the initial mesh.

A node goes if every element around it came from a bisection at this very node, and all of them are marked. Their
forebears, which all hold the edge that the node halved, come back in their place: what remains is conforming.
"""

from __future__ import annotations

import numpy as np

from adaptmg import _checks as checks
from adaptmg._numba import kernel
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.bisection import check_marked
from adaptmg.mesh.bisection.tables import FOREBEAR, Refined, cells_of, mesh_of
from adaptmg.mesh.soundness import check_mesh


def coarsen(mesh: MeshArrays, marked: np.ndarray, passes: int | None = None) -> MeshArrays:
    """Take bisections back.

    Parameters
    ----------
    mesh : MeshArrays
        With its history (:func:`adaptmg.mesh.bisect`); not changed. A mesh without one is an initial mesh.
    marked : (n_elements,) array of bool
        The elements that may become coarser. A bisection is taken back where all elements around the node it made
        are marked, and came from it directly.
    passes : int, optional
        How often, >= 1; an element that came back counts as marked. By default as often as it goes.

    Returns
    -------
    MeshArrays
        Conforming; the nodes left keep their order and places. The same object where nothing can be taken back.

    Raises
    ------
    TypeError, ValueError
        If ``marked`` is not a mask over the elements, or ``passes`` not an integer >= 1.
    """
    marked = check_marked(check_mesh(mesh), marked)
    return coarsened(mesh, marked, None if passes is None else checks.integer("passes", passes, 1)).mesh


def coarsened(mesh: MeshArrays, marked: np.ndarray, passes: int | None = None) -> Refined:
    """The same for checked arguments, with the elements and nodes that are left."""
    result = Refined(mesh=mesh, origin=np.arange(len(mesh.elements)), nodes=np.arange(mesh.n_nodes))
    done = 0
    while mesh.refinement is not None and (passes is None or done < passes):
        following = _once(result.mesh, marked)
        if following is None:
            break
        marked = marked[following.origin]
        nodes = np.where(result.nodes >= 0, following.nodes[result.nodes], -1)
        result = Refined(mesh=following.mesh, origin=result.origin[following.origin], nodes=nodes)
        done += 1
    return result


def _once(mesh: MeshArrays, marked: np.ndarray) -> Refined | None:
    """All bisections taken back that can be in one pass, None if there are none."""
    n, corners = mesh.elements.shape
    history = mesh.refinement
    goes = np.zeros(mesh.n_nodes, dtype=np.bool_)
    if len(history.tree):
        goes[history.tree[:, -1]] = True
        keep_nodes(mesh.elements, history.forebear, history.tree, marked, goes)
    if not goes.any():
        return None
    cells, tree = cells_of(mesh), history.tree.copy()
    n_cells = take_back(cells, n, tree, goes)
    left = np.flatnonzero(~goes)
    numbers = np.full(mesh.n_nodes, -1, dtype=np.int32)
    numbers[left] = np.arange(len(left))
    cells = cells[:n_cells]
    cells[:, :corners] = numbers[cells[:, :corners]]
    # rows of the tree that came back are gone
    kept = ~goes[tree[:, -1]]
    rows = np.append(np.cumsum(kept) - 1, -1).astype(np.int32)
    tree = tree[kept]
    tree[:, :corners] = numbers[tree[:, :corners]]
    tree[:, -1] = numbers[tree[:, -1]]
    tree[:, corners + FOREBEAR] = rows[tree[:, corners + FOREBEAR]]
    forebears = 2 * corners + FOREBEAR
    cells[:, forebears] = rows[cells[:, forebears]]
    coarse = mesh_of(mesh, mesh.points[left], numbers[history.parents[left]], cells, tree)
    return Refined(mesh=coarse, origin=cells[:, 2 * corners + 3].copy(), nodes=numbers)


@kernel
def keep_nodes(elements, forebear, tree, marked, goes):
    """Take out of ``goes`` each node with an element around it that is not marked, or did not come from it."""
    new = tree.shape[1] - 1
    for e in range(len(elements)):
        p = tree[forebear[e], new] if marked[e] and forebear[e] >= 0 else -1
        for k in range(elements.shape[1]):
            if elements[e, k] != p:
                goes[elements[e, k]] = False


@kernel
def take_back(cells, n_cells, tree, goes):
    """Put the forebears of the elements at nodes that go in the place of these; facets go over to them."""
    corners = tree.shape[1] - 3
    marks = 2 * corners
    # where the forebear has come to, once its first child is met
    place = np.full(len(tree), -1, dtype=np.int64)
    old = np.empty(cells.shape[1], dtype=cells.dtype)
    n = 0
    for e in range(n_cells):
        for k in range(len(old)):
            old[k] = cells[e, k]
        row = old[marks + 1]
        if row < 0 or not goes[tree[row, corners + 2]]:
            for k in range(len(old)):
                cells[n, k] = old[k]
            n += 1
            continue
        if place[row] < 0:
            place[row] = n
            n += 1
            at = place[row]
            for k in range(corners):
                cells[at, k] = tree[row, k]
                cells[at, corners + k] = -1
            cells[at, marks] = tree[row, corners]
            cells[at, marks + 1] = tree[row, corners + 1]
            cells[at, marks + 2] = old[marks + 2] - 1
            cells[at, marks + 3] = old[marks + 3]
        at = place[row]
        # the face opposite a corner that the child shares lies in that of the forebear; the one opposite the new
        # node is that opposite the corner which the child lacks
        lacking = -1
        for k in range(corners):
            has = False
            for j in range(corners):
                if old[j] == tree[row, k]:
                    has = True
                    if old[corners + j] >= 0:
                        cells[at, corners + k] = old[corners + j]
            if not has:
                lacking = k
        for j in range(corners):
            if old[j] == tree[row, corners + 2] and old[corners + j] >= 0:
                cells[at, corners + lacking] = old[corners + j]
    return n
