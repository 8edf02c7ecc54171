"""refined: marked elements bisected, and their neighbours as far as conformity asks.

Edges of the marked elements are cut, then elements are bisected until none has a cut edge: each at its own edge, which
may cut a further one; so are its children. Whether the rest may have a cut edge is asked only of elements two of whose
corners were ends of one lately. The loop ends from any conforming mesh: triangles, because only edges of the mesh
before are cut; tetrahedra, because they are marked alike from both sides of a face (Arnold, Mukherjee, Pouly).

Cut edges are found through lists, one for each node: ``nodes[i, HEAD]`` is the first node that halves an edge from i to
a lower number, ``nodes[p, NEXT]`` the next one. Unlike a hash table the lists need no further memory, and lie where
the mesh around them lies.
"""

from __future__ import annotations

import numpy as np

from adaptmg._numba import inner_kernel, kernel
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.bisection.children import write_children
from adaptmg.mesh.bisection.tables import HEAD, HIGH, LOW, NEXT, Refined, cells_of, mesh_of, nodes_of, parents_of


def refined(mesh: MeshArrays, marked: np.ndarray, passes: int | None = None) -> Refined:
    """Bisect the marked elements."""
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
        result = Refined(mesh=following.mesh, origin=result.origin[following.origin])
    return result


def _once(mesh: MeshArrays, marked: np.ndarray, every_edge: bool) -> Refined:
    """One run of the closure."""
    n, corners = mesh.elements.shape
    # of uniform refinement in 2D: 4 times the elements, 4 times the nodes
    room = min(1.0, 2.0 * np.count_nonzero(marked) / n) * (2.0 ** mesh.dim if every_edge else 2.0)
    cells, n_cells, nodes, n_nodes = bisected(cells_of(mesh, room), n, corners, nodes_of(mesh, room), mesh.n_nodes,
                                              marked, every_edge)
    points = np.empty((n_nodes, mesh.dim))
    points[:mesh.n_nodes] = mesh.points
    midpoints(points, mesh.n_nodes, nodes)
    parents = np.concatenate([parents_of(mesh), nodes[mesh.n_nodes:n_nodes, [LOW, HIGH]]])
    # in the order of the elements they come from: neighbours stay near
    cells = cells[np.argsort(cells[:n_cells, -1], kind="stable")]
    return Refined(mesh=mesh_of(mesh, points, parents, cells), origin=cells[:, -1].copy())


@inner_kernel
def _roomier(table):
    """The table with half as much room again."""
    result = np.empty((len(table) + len(table) // 2 + 16, table.shape[1]), table.dtype)
    # loops compile ten times as fast as slices
    for i in range(len(table)):
        for j in range(table.shape[1]):
            result[i, j] = table[i, j]
    return result


@inner_kernel
def _longer(stamps):
    """The stamps with room for half as many more."""
    result = np.empty(len(stamps) + len(stamps) // 2 + 16, stamps.dtype)
    for i in range(len(stamps)):
        result[i] = stamps[i]
    return result


@inner_kernel
def _midpoint_of(nodes, a, b):
    """The node that halves the edge (a, b), -1 if it is not cut."""
    low, high = (a, b) if a < b else (b, a)
    p = nodes[high, HEAD]
    while p >= 0 and nodes[p, LOW] != low:  # what follows in a list was entered before
        p = nodes[p, NEXT]
    return p


@inner_kernel
def _cut_edge(nodes, p, a, b):
    """Enter p, the next free row, as the node that halves the edge (a, b)."""
    low, high = (a, b) if a < b else (b, a)
    nodes[p, HEAD] = -1
    nodes[p, NEXT] = nodes[high, HEAD]
    nodes[p, LOW] = low
    nodes[p, HIGH] = high
    nodes[high, HEAD] = p


@inner_kernel
def _has_cut_edge(cells, e, corners, nodes, stamps):
    """Whether an edge of element e is cut; most have no two corners that ever were ends of one."""
    for i in range(1, corners):
        a = cells[e, i]
        if stamps[a] >= 0:
            for j in range(i):
                b = cells[e, j]
                if stamps[b] >= 0 and _midpoint_of(nodes, a, b) >= 0:
                    return True
    return False


@inner_kernel
def _touched(cells, e, corners, stamps, since):
    """Whether two corners of element e were ends of cut edges since some round."""
    found = 0
    for i in range(corners):
        found += stamps[cells[e, i]] >= since
    return found > 1


@inner_kernel
def _cut(nodes, stamps, n_nodes, a, b, stamp):
    """Cut the edge (a, b) unless it is cut: its node, and the number of nodes; there is room for one more."""
    p = _midpoint_of(nodes, a, b)
    if p < 0:
        p = n_nodes
        n_nodes += 1
        _cut_edge(nodes, p, a, b)
        stamps[p] = -1
        stamps[a] = stamp
        stamps[b] = stamp
    return np.int64(p), n_nodes


@inner_kernel
def _cut_marked(cells, n_cells, nodes, stamps, n_nodes, e, marked, most):
    """Cut edges between the first ``most`` corners of the marked elements from e on, as long as there is room."""
    while e < n_cells and n_nodes + most * most <= len(nodes):  # an element further each time
        if marked[e]:
            for i in range(1, most):
                for j in range(i):
                    _, n_nodes = _cut(nodes, stamps, n_nodes, cells[e, i], cells[e, j], 0)
        e += 1
    return e, n_nodes


@inner_kernel
def _round(cells, n_cells, corners, nodes, stamps, n_nodes, e, n_before, stamp):
    """Bisect the elements from e on that have a cut edge, as long as there is room. Which were there before the round
    are looked at if they were touched since the round before, and e in any case. The tables are not assigned again in
    here: counting references to them would take longer than all the rest."""
    again = e
    while e < n_cells:  # an element further each time
        if e >= n_before or e == again or _touched(cells, e, corners, stamps, stamp - 1):
            while _has_cut_edge(cells, e, corners, nodes, stamps):  # each bisection takes up room, which is bounded
                if n_cells == len(cells) or n_nodes == len(nodes):
                    return e, n_cells, n_nodes
                p, n_nodes = _cut(nodes, stamps, n_nodes, cells[e, 0], cells[e, 1], stamp)
                write_children(cells, e, n_cells, corners, p)
                n_cells += 1
        e += 1
    return e, n_cells, n_nodes


@kernel
def bisected(cells, n_cells, corners, nodes, n_nodes, marked, every_edge):
    """Bisect the marked elements and what conformity asks for."""
    # the round in which an edge that ends in a node was last cut, -1: never
    stamps = np.full(len(nodes), -1, dtype=np.int32)
    # of a type: numba would compile what it calls for a literal 0 as well
    stamp, e = np.int64(0), np.int64(0)
    while e < n_cells:  # with more room at least one element further
        e, n_nodes = _cut_marked(cells, n_cells, nodes, stamps, n_nodes, e, marked,
                                 corners if every_edge else 2)
        if e < n_cells:
            nodes, stamps = _roomier(nodes), _longer(stamps)
    nodes_before = np.int64(-1)
    # a round in which no edge is cut is the last: closures of these bisections are finite (Maubach, 1995)
    while n_nodes > nodes_before:
        stamp += 1
        nodes_before, n_before = n_nodes, n_cells
        e = np.int64(0)
        while e < n_cells:  # more room lets the round go on; closures are finite
            e, n_cells, n_nodes = _round(cells, n_cells, corners, nodes, stamps, n_nodes, e, n_before, stamp)
            if n_cells == len(cells):
                cells = _roomier(cells)
            if n_nodes == len(nodes):
                nodes, stamps = _roomier(nodes), _longer(stamps)
    return cells, n_cells, nodes, n_nodes


@kernel
def midpoints(points, n_old, nodes):
    """Move the nodes from ``n_old`` on halfway between their parents, in ``points``."""
    for p in range(n_old, len(points)):
        a, b = nodes[p, LOW], nodes[p, HIGH]
        for k in range(points.shape[1]):
            points[p, k] = 0.5 * (points[a, k] + points[b, k])
