"""Files of Kratos Multiphysics (.mdpa): meshes with their sub model parts, as the Contents of a mesh.

A file is nested blocks ``Begin KEYWORD name`` ... ``End KEYWORD`` of rows; ``//`` begins a comment.
Elements and conditions have a number, one of properties, and nodes; geometries have no properties.
The name of a type says the dimension of the space, the rows how many nodes there are. A sub model
part lists nodes, elements and conditions of bodies and boundaries; a part of a part is called
"part_inner". See the page "Input data" of the documentation of Kratos."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from adaptmg._files import read_bytes
from adaptmg.mesh.contents import Contents, rows_of
from adaptmg.mesh.shapes import KINDS, dimension

_KINDS = {(dimension(kind), n): kind for kind, (_, n) in KINDS.items()}
#: dimensions of types that are thinner than the space
_THIN = ((1, "Line|Beam|Truss|Cable|Spring"), (2, "Shell|Membrane|Surface|Triangle|Quadrilateral"))
#: where Kratos counts other than VTK: upright edges before upper ones, faces round about
_ORDER = {
    "wedge15": (*range(9), 12, 13, 14, 9, 10, 11),
    "hexahedron20": (*range(12), 16, 17, 18, 19, 12, 13, 14, 15),
    "hexahedron27": (*range(12), 16, 17, 18, 19, 12, 13, 14, 15, 24, 22, 21, 23, 20, 25, 26),
}


def read_mdpa(path: Path) -> Contents:
    """Return the contents of a file of Kratos."""
    contents = Contents(np.empty((0, 3)), [])
    numbers = np.empty(0, dtype=np.int64)
    # the numbers of the cells of each block; elements, conditions and geometries are counted apart
    cells: list[tuple[str, np.ndarray]] = []
    for names, rows in _blocks(read_bytes(path).decode("utf-8", "replace")):
        keyword = " ".join(names[-1][:1])
        what = keyword.removeprefix("SubModelPart")
        part = "_".join(name[1] for name in names if name[:1] == ["SubModelPart"] and name[1:])
        if keyword == "Nodes":  # of the model; "SubModelPartNodes" are those of a part
            table = np.array(rows, dtype=np.float64)
            if table.shape[1] != 4:
                raise ValueError(f"a node has a number and x, y, z, got {' '.join(rows[0])!r}")
            numbers, first = np.unique(table[:, 0].astype(np.int64), return_index=True)
            contents.points = table[first, 1:4]
        elif keyword in ("Elements", "Conditions", "Geometries"):
            table = np.array(rows, dtype=np.int64)
            nodes = table[:, 1 if keyword == "Geometries" else 2 :]
            if kind := _KINDS.get((_dimension(*names[-1]), nodes.shape[1])):
                order = _ORDER.get(kind, slice(None))
                contents.cells.append((kind, rows_of(nodes, numbers)[:, order]))
                cells.append((keyword, table[:, 0]))
        elif part and what == "Nodes":
            # a SubModelPart, called after those that it is a part of
            contents.node_sets[part] = rows_of(np.concatenate(rows).astype(np.int64), numbers)
        elif part and what in ("Elements", "Conditions", "Geometries"):
            numbers_of_part = np.concatenate(rows).astype(np.int64)
            contents.sets.setdefault(part, []).extend(
                (k, np.flatnonzero(np.isin(known, numbers_of_part)))
                for k, (counted, known) in enumerate(cells)
                if counted == what
            )
    return contents


def _blocks(text: str) -> Iterator[tuple[list[list[str]], list[list[str]]]]:
    """Yield the blocks that have rows: the words of the Begin lines of the blocks around it and of
    its own, outermost first, and the words of its rows."""
    names = []
    rows = []
    for line in text.splitlines():
        words = line.partition("//")[0].split()
        if words[:1] == ["Begin"]:
            names = [*names, words[1:]]
            rows = []
        elif words[:1] == ["End"]:
            if names and rows:
                yield names, rows
            names = names[:-1]
            rows = []
        elif words:
            rows.append(words)


def _dimension(keyword: str, *name: str) -> int:
    """Return the dimension of the cells of a block by the words of its Begin line: the ``keyword``, Elements,
    Conditions (whose cells are facets) or Geometries, and the ``name`` of their type."""
    text = " ".join(name)
    space = 2 if "2D" in text else 3
    thin = [dim for dim, names in _THIN if re.search(names, text)]
    return thin[0] if thin else space - (keyword == "Conditions")
