"""refined: marked elements bisected, and their neighbours as far as conformity asks."""

from __future__ import annotations

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.bisection.closure import bisected, by_origin, midpoints
from adaptmg.mesh.bisection.tabled import Refined, cells_of, mesh_of, nodes_of, parents_of, tree_of
from adaptmg.mesh.bisection.tables import HIGH, LOW

__all__ = ["refined"]


def refined(mesh: MeshArrays, marked: np.ndarray, passes: int | None = None) -> Refined:
    """Bisect the marked elements.

    Parameters
    ----------
    mesh : MeshArrays
        Sound.
    marked : (n_elements,) array of bool
        At least one.
    passes : int, optional
        How often each of them is bisected, at least; by default until all their edges are halved.

    Returns
    -------
    Refined
    """
    if passes is None:
        return _once(mesh, marked, True)
    result = _once(mesh, marked, False)
    generation = np.zeros(len(mesh.elements), np.int16) if mesh.refinement is None else mesh.refinement.generation
    for _ in range(passes - 1):
        late = result.mesh.refinement.generation - generation[result.origin] < passes
        rest = marked[result.origin] & late
        if not rest.any():
            break
        following = _once(result.mesh, rest, False)
        result = Refined(mesh=following.mesh, origin=result.origin[following.origin],
                         nodes=np.arange(mesh.n_nodes))
    return result


def _once(mesh: MeshArrays, marked: np.ndarray, every_edge: bool) -> Refined:
    """One run of the closure."""
    n, corners = mesh.elements.shape
    # of uniform refinement in 2D: 4 times the elements, 4 times the nodes
    room = min(1.0, 2.0 * np.count_nonzero(marked) / n) * (2.0 ** mesh.dim if every_edge else 2.0)
    tree = tree_of(mesh)
    cells, n_cells, tree, n_tree, nodes, n_nodes = bisected(
        cells_of(mesh, room), n, tree.copy(), len(tree), nodes_of(mesh, room), mesh.n_nodes, marked, every_edge)
    points = np.empty((n_nodes, mesh.dim))
    points[:mesh.n_nodes] = mesh.points
    midpoints(points, mesh.n_nodes, nodes)
    parents = np.concatenate([parents_of(mesh), nodes[mesh.n_nodes:n_nodes, [LOW, HIGH]]])
    cells = by_origin(cells, n_cells, n)
    fine = mesh_of(mesh, points, parents, cells, tree[:n_tree].copy())
    return Refined(mesh=fine, origin=cells[:, 2 * corners + 3].copy(), nodes=np.arange(mesh.n_nodes))
