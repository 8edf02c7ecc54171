"""Contents: what a mesh file holds, in the form that all readers hand over; made into a checked mesh here.

Cells are cut into simplices (:mod:`adaptmg.mesh.files.shapes`). Boundaries come from faces that the file names, and
from sets of nodes that hold whole facets of the boundary. A facet has one name: faces come before sets of nodes, small
ones before large ones, unless the caller gives the order. A body is one piece: the pieces of a name are numbered.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import FacetTable, MeshArrays, components, facet_keys, facet_table, normalised, signed_measures
from adaptmg.mesh.files.shapes import KINDS, around_centres, cut_note, dimension, middles, simplices
from adaptmg.mesh.soundness import check_stranger

_FLAT = 1e-9


@dataclass(eq=False)
class Contents:
    """What a mesh file holds; nodes are rows of ``points``."""

    points: np.ndarray  # (n, 3): in the unit of the file
    cells: list[tuple[str, np.ndarray, np.ndarray]]  # kind, nodes (m, k), index of each into bodies (m,)
    bodies: list[str]
    faces: dict[str, list[tuple[str, np.ndarray]]] = field(default_factory=dict)  # kinds and nodes of named faces
    node_sets: dict[str, np.ndarray] = field(default_factory=dict)
    surfaces: set[str] = field(default_factory=set)  # those sets of nodes that come before the others
    notes: list[str] = field(default_factory=list)
    #: cells of each block (m,) bool by name; a piece is called after the smallest set that holds all of it
    cell_sets: dict[str, list[np.ndarray]] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class _Tables:
    """Simplices: ``body`` and ``label`` index ``bodies`` and ``boundaries``; facets may lie between bodies."""

    points: np.ndarray
    elements: np.ndarray
    body: np.ndarray
    bodies: list[str]
    facets: np.ndarray
    label: np.ndarray
    boundaries: list[str]


def mesh_of(contents: Contents, *, unit: float, unnamed: str, split_bodies: bool,
            boundaries: Sequence[str] | None, body: str | None) -> tuple[MeshArrays, np.ndarray]:
    """Return the checked mesh, and the midpoints (n, dim), m, of boundary facets that no name of the file holds."""
    _check(contents)
    tables, cell, cut = _cut(contents, unit, body)
    table = facet_table(tables.elements, len(tables.points))
    sets = {} if body is not None else contents.cell_sets
    tables, pieces = _in_pieces(tables, table, {name: np.concatenate(parts)[cell] for name, parts in sets.items()})
    tables, overlaps = _labelled(tables, table, contents, boundaries, unnamed)
    if split_bodies:
        tables = _split(tables)
        table = facet_table(tables.elements, len(tables.points))
    mesh, rest = _named(tables, table, split_bodies)
    object.__setattr__(mesh, "notes", tuple(cut + pieces + contents.notes + overlaps))
    return mesh, rest


def _check(contents: Contents) -> None:
    """ValueError unless all kinds of cells are known, and all nodes exist."""
    faces = [block for blocks in contents.faces.values() for block in blocks]
    blocks = [(kind, nodes) for kind, nodes, _ in contents.cells] + faces
    if other := sorted({kind for kind, nodes in blocks if len(nodes) and kind not in KINDS}):
        raise ValueError(f"it holds {', '.join(other)}; elements must be {', '.join(list(KINDS)[2:])}")
    for nodes in (*(nodes for _, nodes in blocks), *contents.node_sets.values()):
        if len(nodes) and not 0 <= nodes.min() <= nodes.max() < len(contents.points):
            raise ValueError("elements or sets name nodes that it does not hold")


def _cut(contents: Contents, unit: float, body: str | None) -> tuple[_Tables, np.ndarray, list[str]]:
    """The simplices of the cells of the largest dimension, without facets; the cell of each; and what was cut."""
    kinds = {kind for kind, nodes, _ in contents.cells if len(nodes)}
    dim = max(map(dimension, kinds), default=0)
    if dim < 2:
        raise ValueError(f"it holds {', '.join(sorted(kinds)) or 'no elements'}, but neither triangles and "
                         "quadrilaterals nor tetrahedra and other solids (Gmsh saves only what is in a physical group: "
                         "add a Physical Surface or Volume)")
    points, counts = contents.points, {}
    elements, labels = [np.empty((0, dim + 1), dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    cells, ends = [np.empty(0, dtype=np.int64)], np.cumsum([len(nodes) for _, nodes, _ in contents.cells])
    for (kind, nodes, label), end in zip(contents.cells, ends, strict=True):
        if len(nodes) and dimension(kind) == dim:
            found, owner = simplices(kind, nodes, points)
            bad = _turned_over(points[:, :dim], found, owner, len(nodes))
            if dim == 3 and len(bad) and kind not in ("tetra", "hexahedron27"):
                whole = ~np.isin(owner, bad)
                again, whose = around_centres(kind, nodes[bad], len(points))
                points = np.concatenate([points, points[nodes[bad]].mean(axis=1)])
                found, owner = np.concatenate([found[whole], again]), np.concatenate([owner[whole], bad[whose]])
            elements.append(found)
            labels.append(label[owner])
            cells.append(end - len(nodes) + owner)
            counts.setdefault(kind, []).append(np.bincount(owner, minlength=len(nodes)))
    used = points[np.unique(np.concatenate(elements))]
    if dim == 2 and np.ptp(used[:, 2]) > _FLAT * np.ptp(used[:, :2], axis=0).max():
        raise ValueError("it holds plane elements only, but they are not in a plane z = constant: z runs from "
                         f"{used[:, 2].min():.6g} to {used[:, 2].max():.6g}; a body in space needs solid elements")
    label, bodies = np.concatenate(labels), contents.bodies
    if body is not None:
        label, bodies = np.zeros_like(label), [body]
    empty = np.empty(0, dtype=np.int64)
    notes = [cut_note(kind, np.concatenate(parts)) for kind, parts in counts.items()]
    tables = _Tables(unit * points[:, :dim], np.concatenate(elements), label, list(bodies), empty.reshape(-1, dim),
                     empty, [])
    return tables, np.concatenate(cells), list(filter(None, notes))


def _turned_over(points: np.ndarray, cells: np.ndarray, owner: np.ndarray, n: int) -> np.ndarray:
    """The cells of which a part is flat, or lies the other way than the whole."""
    sizes = signed_measures(points, cells)
    whole = np.bincount(owner, sizes, minlength=n)
    return np.unique(owner[sizes * np.sign(whole[owner]) <= 1e-9 * np.abs(whole[owner])])


def _in_pieces(tables: _Tables, table: FacetTable, sets: dict[str, np.ndarray]) -> tuple[_Tables, list[str]]:
    """Each piece a body, called after the smallest of the sets of elements (n,) bool that hold all of it; the pieces of
    one name are "name", "name_2", ... in the order of their first elements."""
    part = components(table, tables.body)
    _, first, sizes = np.unique(part, return_index=True, return_counts=True)
    order = np.argsort(first)
    by_piece, least = [tables.bodies[k] for k in tables.body[first]], np.full(len(sizes), len(part) + 1)
    for name, inside in sets.items():
        better = (np.bincount(part[inside], minlength=len(sizes)) == sizes) & (np.count_nonzero(inside) < least)
        least[better] = np.count_nonzero(inside)
        by_piece = [name if take else before for take, before in zip(better, by_piece, strict=True)]
    called = [by_piece[k] for k in order]
    names, count = [], Counter()
    for name in called:
        count[name] += 1
        names.append(f"{name}_{count[name]}" if count[name] > 1 else name)
    if len(set(names)) < len(names):
        raise ValueError(f"bodies are called {_some(called)}, and their pieces alike; give the bodies other names")
    notes = [f"body {name!r} has {pieces} pieces, called {name}, {name}_2, ..." for name, pieces in count.items()
             if pieces > 1]
    return replace(tables, body=np.argsort(order)[part], bodies=names), notes


def _some(names: Sequence[str]) -> str:
    """Names for a note."""
    return ", ".join(names[:6]) + (f", ... ({len(names)})" if len(names) > 6 else "")


def _labelled(tables: _Tables, table: FacetTable, contents: Contents, wanted: Sequence[str] | None, unnamed: str
              ) -> tuple[_Tables, list[str]]:
    """With the facets that have names: of the boundary, and between bodies."""
    n = len(tables.points)
    open_ = (table.counts == 1) | (tables.body[table.first] != tables.body[table.second])
    keys, facets = table.keys[open_], table.facets[open_]
    held: dict[str, np.ndarray] = {}
    notes: list[str] = []
    for name, blocks in contents.faces.items():
        found = [simplices(kind, nodes)[0] for kind, nodes in blocks if len(nodes)]
        rows = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *(facet_keys(f, n) for f in found)]))
        held[name] = np.flatnonzero(np.isin(keys, rows, assume_unique=True))
    between = _between(contents) if contents.node_sets else []
    for name, nodes in contents.node_sets.items():
        inside = np.zeros(n, dtype=bool)
        inside[nodes] = True
        for middle in between:
            # a set of corners means the middle nodes between them too
            inside[middle[inside[middle[:, 1:]].all(axis=1), 0]] = True
        if wanted is None and inside[tables.elements].all():
            notes.append(f"set of all nodes, which is not taken for a boundary: {name!r}")
        else:
            held.setdefault(name, np.flatnonzero(inside[facets].all(axis=1)))
    if wanted is None:
        first = contents.surfaces.union(contents.faces)
        order = sorted(held, key=lambda name: (name not in first, len(held[name])))
    else:
        if unknown := [name for name in wanted if name not in held]:
            raise ValueError(f"boundaries: it holds no {_some(list(map(repr, unknown)))}; it holds {_some(list(held))}")
        order = list(wanted)
    label, number = np.zeros(len(keys), dtype=np.int64), {name: k + 1 for k, name in enumerate(held)}
    for name in order:
        free = label[held[name]] == 0
        label[held[name][free]] = number[name]
        if len(free) and not free.all() and (wanted is not None or free.any()):
            notes.append(f"{name!r}: {np.count_nonzero(~free)} of {len(free)} facets belong to another name before it; "
                         "boundaries= sets the order")
    empty = [name for name in order if not (label == number[name]).any()]
    if empty:
        notes.append(f"sets that name no facet of the boundary, or only facets of other names: {_some(empty)}")
    for name in (*tables.bodies, *(name for name in order if name not in empty)):
        checks.boundary_name("the name of a boundary or body", name)
    named = label > 0
    return replace(tables, facets=facets[named], label=label[named], boundaries=[unnamed, *held]), notes


def _between(contents: Contents) -> list[np.ndarray]:
    """Rows of a middle node and the corners that it lies between, by the number of these."""
    rows: dict[int, list[np.ndarray]] = {}
    for kind, cells, _ in contents.cells:
        for k, ends in enumerate(middles(kind), cells.shape[1] - len(middles(kind))):
            rows.setdefault(len(ends), []).append(cells[:, (k, *ends)])
    found = [np.concatenate(parts) for parts in rows.values()]
    return [one[np.unique(one[:, 0], return_index=True)[1]] for one in found]


def _split(tables: _Tables) -> _Tables:
    """The same body by body, with nodes of their own; facets are given to every body that has their nodes."""
    called = [name.replace(".", "_") for name in tables.bodies]
    bodies = list(dict.fromkeys(called[i] for i in np.unique(tables.body)))
    body = np.array([bodies.index(name) if name in bodies else -1 for name in called])[tables.body]
    order = np.argsort(body, kind="stable")
    elements, body, n = tables.elements[order], body[order], len(tables.points)
    # a node of a body is the pair (body, node) as one integer
    pairs = np.unique(elements + n * body[:, None])
    every = np.arange(len(bodies))
    facets = (tables.facets[None] + n * every[:, None, None]).reshape(-1, tables.facets.shape[1])
    row = np.minimum(np.searchsorted(pairs, facets), len(pairs) - 1)
    there = (pairs[row] == facets).all(axis=1)
    label = (tables.label[None] + len(tables.boundaries) * every[:, None]).reshape(-1)
    boundaries = [f"{name}.{boundary}" for name in bodies for boundary in tables.boundaries]
    return _Tables(tables.points[pairs % n], np.searchsorted(pairs, elements + n * body[:, None]), body, bodies,
                   row[there], label[there], boundaries)


def _named(tables: _Tables, table: FacetTable, split: bool) -> tuple[MeshArrays, np.ndarray]:
    """The checked mesh, and midpoints of the facets of one element only that got the first name, of each body if split.
    """
    outer = table.counts == 1
    row = table.find(facet_keys(tables.facets, len(tables.points)))
    outer[row[row >= 0]] = False
    rest, owner = table.facets[outer], table.first[outer]
    label = tables.body[owner] * (len(tables.boundaries) // len(tables.bodies)) * split
    facets, labels = np.concatenate([tables.facets, rest]), np.concatenate([tables.label, label])
    mesh = check_stranger(normalised(tables.points, tables.elements, facets, labels, tables.boundaries, tables.body,
                                     tables.bodies))
    return mesh, tables.points[rest].mean(axis=1)
