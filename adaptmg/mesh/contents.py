"""Contents: what a mesh file holds, in the form that all readers hand over; made into a checked
mesh here.

Cells are cut into simplices (:mod:`adaptmg.mesh.shapes`). Boundaries come from sets of faces, and
from sets of nodes that hold whole facets of the boundary. A facet has one name: sets of faces come
before sets of nodes, small ones before large ones, unless the caller gives the order. A body is one
piece, called after the smallest set of cells that holds all of it; pieces of one name are numbered.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import (
    FacetTable,
    MeshArrays,
    by_first_occurrence,
    components,
    facet_keys,
    facet_table,
    mask_of,
    normalised,
    signed_measures,
)
from adaptmg.mesh.lattices import merged
from adaptmg.mesh.shapes import KINDS, around_centres, cut_note, dimension, middles, simplices
from adaptmg.mesh.soundness import check_stranger


@dataclass(eq=False)
class Contents:
    """Contents of a mesh file; nodes are rows of ``points``."""

    points: np.ndarray  # (n, 3): in the unit of the file
    cells: list[tuple[str, np.ndarray]]  # kind and nodes (m, k) of blocks of any dimension
    #: sets of cells: blocks, and rows of them
    sets: dict[str, list[tuple[int, np.ndarray]]] = field(default_factory=dict)
    node_sets: dict[str, np.ndarray] = field(default_factory=dict)  # dict of str to nodes (n,)
    bodies: Sequence[str] | None = None  # the sets whose cells are different bodies; None: all sets
    #: those sets of nodes that come before the others
    surfaces: set[str] = field(default_factory=set)
    notes: list[str] = field(default_factory=list)


def rows_of(nodes: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return the rows of ``nodes``, an array of any shape, in the sorted table of all numbers (n,);
    ValueError if one is not in it."""
    rows = np.searchsorted(numbers, nodes)
    # -1, which is not the number of a node, stands in the row behind the last one
    known = np.append(numbers, -1)[rows] == nodes
    if not known.all():
        raise ValueError(f"elements name nodes that it does not hold, such as {nodes[~known][0]}")
    return rows


def mesh_of(
    contents: Contents,
    *,
    unit: float,
    unnamed: str,
    split_bodies: bool,
    boundaries: Sequence[str] | None,
    body: str | None,
) -> tuple[MeshArrays, np.ndarray, list[str]]:
    """Return the checked mesh, the midpoints (n, dim), m, of boundary facets that no name of the
    file holds, which are called ``unnamed``, and what is to be said of facets that no element has.
    The other arguments are those of :func:`adaptmg.mesh.from_file`."""
    _check(contents)
    points, elements, block, row, notes = _cut_into_simplices(contents)
    points = unit * points
    table = facet_table(elements, len(points))
    # sets of cells name bodies, unless the caller does
    sets = {} if body is not None else _in_sets(contents, block, row)
    parts = _pieces(len(elements), table, sets, contents.bodies)
    names, split_notes = _names(parts, sets, body or "body", split_bodies)
    facets, label, named, overlaps, strange = _labelled(
        len(points), elements, table, parts, contents, boundaries, split_bodies
    )
    # labels count from 1; 0 will be the facets called ``unnamed``
    for name in (*names, *(named[k - 1] for k in np.unique(label))):
        checks.boundary_name("the name of a boundary or body", name)
    if split_bodies:
        made = {
            name: _completed(points, elements[parts == k], facets, label, [unnamed, *named], [name])
            for k, name in enumerate(names)
        }
        mesh = merged({name: body_mesh for name, (body_mesh, _) in made.items()})
        unnamed_places = np.concatenate([places for _, places in made.values()])
    else:
        mesh, unnamed_places = _completed(
            points, elements, facets, label, [unnamed, *named], names, parts
        )
    object.__setattr__(mesh, "notes", tuple(notes + split_notes + contents.notes + overlaps))
    return mesh, unnamed_places, strange


def _in_sets(contents: Contents, block: np.ndarray, row: np.ndarray) -> dict[str, np.ndarray]:
    """Return by name the mask (n_elements,) of the elements in each set of cells that has any; element e
    is a part of the cell ``row[e]`` of the block ``block[e]``."""
    return {
        name: np.any([(block == k) & np.isin(row, rows) for k, rows in members], axis=0)
        for name, members in contents.sets.items()
        if any(len(rows) and (block == k).any() for k, rows in members)
    }


def _check(contents: Contents) -> None:
    """Raise ValueError unless all kinds of cells are known, and all nodes exist."""
    if other := sorted(
        {kind for kind, nodes in contents.cells if len(nodes) and kind not in KINDS}
    ):
        elements = [kind for kind in KINDS if dimension(kind) > 1]
        raise ValueError(f"it holds {', '.join(other)}; elements must be {', '.join(elements)}")
    for nodes in (*(nodes for _, nodes in contents.cells), *contents.node_sets.values()):
        if len(nodes) and not 0 <= nodes.min() <= nodes.max() < len(contents.points):
            raise ValueError("elements or sets name nodes that it does not hold")


def _cut_into_simplices(
    contents: Contents,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, list[str]]:
    """Return the points (n, dim) in the unit of the file, the simplices (m, dim + 1) of the cells of the
    largest dimension, the block (m,) and the row (m,) of the cell that each is a part of, and notes of
    what was cut."""
    kinds = {kind for kind, nodes in contents.cells if len(nodes)}
    dim = max(map(dimension, kinds), default=0)
    if dim < 2:
        raise ValueError(
            f"it holds {', '.join(sorted(kinds)) or 'no elements'}, but neither triangles and "
            "quadrilaterals nor tetrahedra and other solids (Gmsh saves only what is in a physical group: "
            "add a Physical Surface or Volume)"
        )
    points = contents.points
    counts = {}
    parts = []
    for k, (kind, nodes) in enumerate(contents.cells):
        if len(nodes) and dimension(kind) == dim:
            cells, owner, points = _block_simplices(kind, nodes, points, dim)
            parts.append((cells, np.full(len(cells), k), owner))
            # how many simplices each cell is cut into
            counts.setdefault(kind, []).append(np.bincount(owner, minlength=len(nodes)))
    elements, block, row = map(np.concatenate, zip(*parts, strict=True))
    used = points[np.unique(elements)]
    if dim == 2 and np.ptp(used[:, 2]) > checks.ALIKE * np.ptp(used[:, :2], axis=0).max():
        raise ValueError(
            "it holds plane elements only, but they are not in a plane z = constant: z runs from "
            f"{used[:, 2].min():.6g} to {used[:, 2].max():.6g}; a body in space needs solid elements"
        )
    notes = [cut_note(kind, np.concatenate(numbers)) for kind, numbers in counts.items()]
    return points[:, :dim], elements, block, row, list(filter(None, notes))


def _block_simplices(
    kind: str, nodes: np.ndarray, points: np.ndarray, dim: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the simplices of the cells ``nodes`` (n, k) of one kind, the number of the cell that each
    is a part of, and the points, followed by new ones at the centres of cells that are cut there:
    solids of which a simplex is turned over."""
    cells, owner = simplices(kind, nodes, points)
    bad = _turned_over(points[:, :dim], cells, owner, len(nodes))
    # a tetrahedron is not cut, and a brick of 27 nodes already has a node at its centre
    if dim < 3 or not len(bad) or kind in ("tetra", "hexahedron27"):
        return cells, owner, points
    whole = ~np.isin(owner, bad)
    from_centres, cut_cell = around_centres(kind, nodes[bad], len(points))
    return (
        np.concatenate([cells[whole], from_centres]),
        np.concatenate([owner[whole], bad[cut_cell]]),
        np.concatenate([points, points[nodes[bad]].mean(axis=1)]),
    )


def _turned_over(points: np.ndarray, cells: np.ndarray, owner: np.ndarray, n: int) -> np.ndarray:
    """Return which of n cells have a part that is flat, or lies the other way than the whole; the parts
    are the simplices ``cells`` (m, dim + 1) between ``points``, of the cells ``owner`` (m,)."""
    sizes = signed_measures(points, cells)
    whole = np.bincount(owner, sizes, minlength=n)
    return np.unique(owner[sizes * np.sign(whole[owner]) <= checks.ALIKE * np.abs(whole[owner])])


def _pieces(
    n: int, table: FacetTable, sets: dict[str, np.ndarray], bodies: Sequence[str] | None
) -> np.ndarray:
    """Return the number of the piece of each element (n,), in the order of their first elements. Those
    ``sets`` of cells (masks (n,) by name) that are ``bodies``, None: all, separate pieces; an element of
    several belongs to the last one."""
    label = np.zeros(n, dtype=np.int64)
    for k, name in enumerate(name for name in sets if bodies is None or name in bodies):
        label[sets[name]] = k + 1
    return by_first_occurrence(components(table, label))[1]


def _names(
    parts: np.ndarray, sets: dict[str, np.ndarray], unnamed: str, split: bool
) -> tuple[list[str], list[str]]:
    """Return the name of each piece of the mesh, ``unnamed`` where no set holds all of it, and notes;
    ``parts`` (n_elements,): the piece of each element, ``sets``: masks over the elements. Where bodies
    are ``split`` their names get no dots, which separate them from boundaries."""
    # a piece is called after the smallest set that holds all of it
    sizes = np.bincount(parts)
    called = [unnamed] * len(sizes)
    least = np.full(len(sizes), len(parts) + 1)
    for name, inside in sets.items():
        size = np.count_nonzero(inside)
        contains_piece = np.bincount(parts[inside], minlength=len(sizes)) == sizes
        for k in np.flatnonzero(contains_piece & (size < least)):
            called[k] = name.replace(".", "_") if split else name
            least[k] = size
    # pieces of one name are numbered
    names = []
    count = Counter()
    for name in called:
        count[name] += 1
        names.append(f"{name}_{count[name]}" if count[name] > 1 else name)
    if len(set(names)) < len(names):
        raise ValueError(
            f"bodies are called {_listed_names(called)}, and their pieces alike; give the bodies other names"
        )
    return names, [
        f"body {name!r} has {n} pieces, called {name}, {name}_2, ..."
        for name, n in count.items()
        if n > 1
    ]


def _listed_names(names: Sequence[str]) -> str:
    """Return names for a message, the first six of many."""
    return ", ".join(names[:6]) + (f", ... ({len(names)})" if len(names) > 6 else "")


def _labelled(
    n: int,
    elements: np.ndarray,
    table: FacetTable,
    parts: np.ndarray,
    contents: Contents,
    boundaries: Sequence[str] | None,
    split: bool,
) -> tuple[np.ndarray, np.ndarray, list[str], list[str], list[str]]:
    """Return the facets (m, dim) of n nodes that have names, on the boundary and between bodies that are
    split; their labels (m,), from 1 on; names, notes, and notes of facets that no element has.
    ``parts`` (n_elements,) is the piece of each element."""
    # facets that may have names; ``facets_of`` holds rows of these for each name
    is_nameable = table.counts == 1
    if split:
        is_nameable |= parts[table.first] != parts[table.second]
    keys = table.keys[is_nameable]
    facets = table.facets[is_nameable]
    facets_of, notes, strange = _of_face_sets(n, table, keys, contents)
    surface_names = contents.surfaces.union(facets_of)
    by_nodes, node_notes = _of_node_sets(n, elements, facets, parts, contents, boundaries is None)
    # of two sets of one name that of faces counts
    facets_of |= {name: rows for name, rows in by_nodes.items() if name not in facets_of}
    notes += node_notes
    order = _claims(facets_of, surface_names, boundaries)
    # each name gets those of its facets that none before it has
    names = list(facets_of)
    label = np.zeros(len(keys), dtype=np.int64)
    for name in order:
        free = label[facets_of[name]] == 0
        label[facets_of[name][free]] = names.index(name) + 1
        # sets that get no facet at all are noted together below; those that the caller names here, too
        if len(free) and not free.all() and (boundaries is not None or free.any()):
            notes.append(
                f"{name!r}: {np.count_nonzero(~free)} of {len(free)} facets belong to another name before it; "
                "boundaries= sets the order"
            )
    used = set(label.tolist())
    if empty := [name for name in order if names.index(name) + 1 not in used]:
        notes.append(
            f"sets that name no facet of the boundary, or only facets of other names: {_listed_names(empty)}"
        )
    return facets[label > 0], label[label > 0], names, notes, strange


def _claims(
    facets_of: dict[str, np.ndarray], surface_names: set[str], boundaries: Sequence[str] | None
) -> list[str]:
    """Return the names in the order in which they claim facets, whose rows ``facets_of`` has: that of the
    caller (``boundaries``), or surfaces before sets of nodes, and small ones before large ones."""
    if boundaries is None:
        return sorted(facets_of, key=lambda name: (name not in surface_names, len(facets_of[name])))
    if unknown := [name for name in boundaries if name not in facets_of]:
        raise ValueError(
            f"boundaries: it holds no {_listed_names(list(map(repr, unknown)))}; it holds "
            f"{_listed_names(list(facets_of))}"
        )
    return list(boundaries)


def _of_node_sets(
    n: int,
    elements: np.ndarray,
    facets: np.ndarray,
    parts: np.ndarray,
    contents: Contents,
    skip_volumes: bool,
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Return for each set of nodes the rows of the ``facets`` (m, dim) that have all their nodes in it,
    and notes of sets that are left out as volumes; there are n nodes, and ``parts`` (n_elements,) is
    the piece of each of ``elements``."""
    facets_of: dict[str, np.ndarray] = {}
    notes: list[str] = []
    between = _between(contents) if contents.node_sets else []
    on_facets = mask_of(facets, n)
    for name, nodes in contents.node_sets.items():
        inside = mask_of(nodes, n)
        for middle in between:
            # a set of corners means the middle nodes between them too
            inside[middle[inside[middle[:, 1:]].all(axis=1), 0]] = True
        if skip_volumes and _is_volume(inside, elements, on_facets, parts):
            notes.append(
                f"set of all nodes of elements, which is not taken for a boundary: {name!r}"
            )
        else:
            facets_of[name] = np.flatnonzero(inside[facets].all(axis=1))
    return facets_of, notes


def _of_face_sets(
    n: int, table: FacetTable, keys: np.ndarray, contents: Contents
) -> tuple[dict[str, np.ndarray], list[str], list[str]]:
    """Return for each set of faces which facets it names, as rows of ``keys`` (m,), the keys of those that
    may have names; notes, and notes of facets that no element has. There are n nodes."""
    dim = table.facets.shape[1]
    facets_of: dict[str, np.ndarray] = {}
    notes: list[str] = []
    strange: list[str] = []
    for name, members in contents.sets.items():
        faces = [
            (kind, nodes[rows])
            for (kind, nodes), rows in ((contents.cells[k], rows) for k, rows in members)
            if dimension(kind) == dim - 1 and len(rows)
        ]
        if faces:
            set_facets = np.concatenate([simplices(kind, nodes)[0] for kind, nodes in faces])
            set_keys = facet_keys(set_facets, n)
            facets_of[name] = np.flatnonzero(np.isin(keys, set_keys))
            lost = np.count_nonzero(~np.isin(set_keys, table.keys))
            if lost:
                strange.append(
                    f"{name!r}: {lost} of {len(set_facets)} facets are facets of no element, and are dropped"
                )
            inner = np.count_nonzero(~np.isin(set_keys, keys)) - lost
            if inner:
                notes.append(
                    f"{name!r}: {inner} of {len(set_facets)} facets lie inside and are dropped; "
                    "split_bodies=True makes boundaries of those between bodies"
                )
    return facets_of, notes, strange


def _is_volume(
    inside: np.ndarray, elements: np.ndarray, on_facets: np.ndarray, parts: np.ndarray
) -> bool:
    """Return whether a set of nodes stands for a volume. Programs write sets of all nodes of a body,
    which would name all facets of its boundary.

    The nodes ``inside`` (n_nodes,) are a volume if they are those of some elements, of which one has
    a node that is not ``on_facets`` (n_nodes,) of the boundary, or which are all of a piece (``parts``
    (n_elements,) numbers the pieces)."""
    whole = inside[elements].all(axis=1)
    # every node of the set must be in such an element; nodes of no element may be in it
    covered = np.ones_like(inside)
    covered[elements] = False
    covered[elements[whole]] = True
    if (inside & ~covered).any():
        return False
    pieces = np.bincount(parts, whole) == np.bincount(parts)
    return bool(pieces.any() or not on_facets[elements[whole]].all())


def _between(contents: Contents) -> list[np.ndarray]:
    """Return rows (n, 1 + k) of a middle node and the k corners that it lies between, for each k: 2 on
    edges, 4 on quadrilaterals, ..."""
    rows: dict[int, list[np.ndarray]] = {}
    for kind, cells in contents.cells:
        # the middle nodes are the last columns of the cells
        for column, ends in enumerate(middles(kind), cells.shape[1] - len(middles(kind))):
            rows.setdefault(len(ends), []).append(cells[:, (column, *ends)])
    return [np.unique(np.concatenate(parts), axis=0) for parts in rows.values()]


def _completed(
    points: np.ndarray,
    elements: np.ndarray,
    facets: np.ndarray,
    label: np.ndarray,
    boundaries: list[str],
    bodies: list[str],
    parts: np.ndarray | None = None,
) -> tuple[MeshArrays, np.ndarray]:
    """Return the checked mesh of ``elements`` (n_elements, dim + 1) between ``points`` (n_nodes, dim),
    m, with the first of ``boundaries`` for facets that have no name, and the midpoints (n, dim) of
    these. ``label`` (m,) is the name of each of ``facets`` (m, dim), ``parts`` (n_elements,) the body
    of each element, None for a single one."""
    table = facet_table(elements, len(points))
    rest = table.facets[(table.counts == 1) & ~np.isin(table.keys, facet_keys(facets, len(points)))]
    mesh = check_stranger(
        normalised(
            points,
            elements,
            np.concatenate([facets, rest]),
            np.concatenate([label, np.zeros(len(rest), dtype=np.int64)]),
            boundaries,
            np.zeros(len(elements), dtype=np.int64) if parts is None else parts,
            bodies,
        )
    )
    return mesh, points[rest].mean(axis=1)
