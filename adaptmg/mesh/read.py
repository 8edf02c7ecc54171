"""from_gmsh: meshes of Gmsh (MSH 2.2 and 4.1), read through meshio; physical groups name boundaries and bodies.

Where bodies share the nodes of an interface they are glued, or split: then each body gets nodes of its own there, and
the interface is a boundary of both.

check_gmsh_file: the counts and node numbers of a Gmsh file, before meshio follows them.

Every section must end, hold as many nodes and elements as it says, and its elements may name only nodes that it lists:
meshio takes node -1 for another one, reads files that are cut off, and makes tables as long as the largest number.

from_netgen_file: Netgen's mesh files (.vol, .vol.gz), read here section by section.

Netgen's own reader follows damaged numbers wherever they point. Of a file we need a few sections only: a keyword, a
count, and that many lines; each count is held against the lines that follow, each node number against the points.

as_mesh: whatever a user calls a mesh, checked and as MeshArrays.
"""

from __future__ import annotations

import gzip
import re
import warnings
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ngsolve
import numpy as np

from adaptmg import _checks as checks
from adaptmg._runtime import OnDemand
from adaptmg.mesh.arrays import MeshArrays, facet_keys, facet_table
from adaptmg.mesh.ngsolve_bridge import from_ngsolve, normalised, with_source
from adaptmg.mesh.soundness import check_mesh, check_overlap

__all__ = ["as_mesh", "check_gmsh_file", "from_gmsh", "from_netgen_file"]

# meshio's names of the cells of first and second order, by dimension
_LINES = ("line", "line3")
_TRIANGLES = ("triangle", "triangle6")
_TETRAHEDRA = ("tetra", "tetra10")
_POINTS = ("vertex",)


def from_gmsh(path: str | Path, *, unnamed: str | None = None, split_bodies: bool = False) -> MeshArrays:
    """Read a Gmsh mesh of triangles in the plane, or of tetrahedra.

    Parameters
    ----------
    path : str or Path
        An ``.msh`` file, MSH 2.2 or 4.1, coordinates in m. Physical curves (3D: surfaces) become boundaries, physical
        surfaces (3D: volumes) bodies; groups without a name are called by their number. Of second-order elements the
        corners are read. Points of no element (centres of circles) are dropped.
    unnamed : str, optional
        Name for the boundary facets that belong to no physical group. By default there must be none.
    split_bodies : bool
        Give each body nodes of its own, so that bodies touch only through contact. Boundaries are then called
        "body.boundary" (a "." in the name of a body becomes "_"); a physical curve or surface between two bodies is a
        boundary of both. By default bodies stay glued where they share nodes, and boundaries keep their names.

    Returns
    -------
    MeshArrays
        With its source. With ``split_bodies``, nodes, elements and facets come body by body.

    Raises
    ------
    ImportError
        Without meshio.
    FileNotFoundError
        If there is no such file.
    ValueError
        If it cannot be read, has other elements, is not plane, lacks physical groups, or is not sound
        (:func:`adaptmg.mesh.check_mesh`).
    """
    try:
        import meshio
    except ImportError as error:
        raise ImportError("reading Gmsh files needs meshio: pip install 'adaptmg[gmsh]'") from error
    path = checks.file_path("path", path)
    if unnamed is not None:
        checks.boundary_name("unnamed", unnamed)
    if not path.is_file():
        raise FileNotFoundError(f"path: there is no file {str(path)!r}")
    check_gmsh_file(path)
    try:
        raw = meshio.gmsh.read(path)
    except Exception as error:
        # meshio raises whatever its parser stumbles over (IndexError, KeyError, ...); partial groups fail in MSH 4.1
        raise ValueError(f"{str(path)!r} cannot be read as a Gmsh mesh ({type(error).__name__}: {error}); it must be "
                         "MSH 2.2 or 4.1, and in 4.1 all entities that are saved need a physical group: "
                         "set Mesh.SaveAll = 0 or Mesh.MshFileVersion = 2.2") from error
    kinds = {block.type for block in raw.cells}
    other = kinds.difference(_LINES, _TRIANGLES, _TETRAHEDRA, _POINTS)
    if other:
        raise ValueError(f"{str(path)!r} holds {', '.join(sorted(other))}; only triangles and tetrahedra can be used "
                         "(in Gmsh: no 'Recombine', Mesh.ElementOrder 1 or 2)")
    dim = 3 if kinds.intersection(_TETRAHEDRA) else 2
    tables = _tables(raw, dim, unnamed or "", path)
    if split_bodies:
        tables = _split(tables)
    rest, owner = _unnamed_facets(tables)
    if len(rest) and unnamed is None:
        what = "Physical Curve" if dim == 2 else "Physical Surface"
        place = ", ".join(f"{c:.6g}" for c in tables.points[rest[0]].mean(axis=0))
        raise ValueError(f"{str(path)!r}: {len(rest)} facets of the boundary, one of them at ({place}), belong to no "
                         f'physical group; name them in Gmsh, like {what}("contact") = {{1}};, '
                         'or here by unnamed="free"')
    # the first name, of each body if these are split, is the one of unnamed facets
    label = tables.body[owner] * (len(tables.boundaries) // len(tables.bodies)) * split_bodies
    facets, labels = np.concatenate([tables.facets, rest]), np.concatenate([tables.label, label])
    try:
        return check_overlap(with_source(normalised(tables.points, tables.elements, facets, labels, tables.boundaries,
                                                    tables.body, tables.bodies)))
    except ValueError as error:
        raise ValueError(f"{str(path)!r}: {error}") from error


@dataclass(frozen=True, eq=False)
class _Tables:
    """What a file holds: ``body`` and ``label`` index ``bodies`` and ``boundaries``; facets may lie between bodies."""

    points: np.ndarray
    elements: np.ndarray
    body: np.ndarray
    bodies: list[str]
    facets: np.ndarray
    label: np.ndarray
    boundaries: list[str]


def _tables(raw: Any, dim: int, unnamed: str, path: Path) -> _Tables:
    """The tables of a file, named facets only."""
    volumes, surfaces = (_TETRAHEDRA, _TRIANGLES) if dim == 3 else (_TRIANGLES, _LINES)
    elements, body, bodies = _cells(raw, volumes, dim, "body")
    facets, label, boundaries = _cells(raw, surfaces, dim - 1, unnamed)
    for name in (*bodies[1:], *boundaries[1:]):
        checks.boundary_name(f"{str(path)!r}: the name of a physical group", name)
    if len(elements) == 0:
        raise ValueError(f"{str(path)!r} has neither triangles nor tetrahedra (Gmsh saves only what is in a physical "
                         f"group: add a Physical {'Surface' if dim == 2 else 'Volume'})")
    if min(elements.min(), facets.min(initial=0)) < 0:
        raise ValueError(f"{str(path)!r} has elements with nodes that it does not hold")
    points = _plane(raw.points, elements, path) if dim == 2 else raw.points
    return _Tables(points, elements, body, bodies, facets[label > 0], label[label > 0], boundaries)


def _cells(raw: Any, kinds: tuple[str, ...], dim: int, unnamed: str) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Corners of all cells of some kinds, the index of the physical group of each, and names; index 0 means none."""
    tags = raw.cell_data.get("gmsh:physical", [np.zeros(len(block.data), dtype=np.int64) for block in raw.cells])
    chosen = [(block.data[:, :dim + 1], np.abs(tag)) for block, tag in zip(raw.cells, tags, strict=True)
              if block.type in kinds]
    cells = np.concatenate([np.empty((0, dim + 1), dtype=np.int64)] + [data for data, _ in chosen])
    tag = np.concatenate([np.empty(0, dtype=np.int64)] + [t for _, t in chosen])
    known = {int(number): name for name, (number, of_dim) in raw.field_data.items() if of_dim == dim}
    groups = np.union1d([0], tag).astype(np.int64)
    names = [unnamed] + [known.get(int(number), str(int(number))) for number in groups[1:]]
    return cells, np.searchsorted(groups, tag), names


def _plane(points: np.ndarray, elements: np.ndarray, path: Path) -> np.ndarray:
    """x and y of points whose elements lie in a plane z = constant."""
    used = points[np.unique(elements)]
    if np.ptp(used[:, 2]) > 1e-9 * np.ptp(used[:, :2], axis=0).max():
        raise ValueError(f"{str(path)!r} holds triangles only, but they are not in a plane z = constant: z runs from "
                         f"{used[:, 2].min():.6g} to {used[:, 2].max():.6g}; a body in space needs tetrahedra")
    return points[:, :2]


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


def _unnamed_facets(tables: _Tables) -> tuple[np.ndarray, np.ndarray]:
    """Facets of one element only that have no name, and that element."""
    n_nodes = len(tables.points)
    table = facet_table(tables.elements, n_nodes)
    outer = table.counts == 1
    row = table.find(facet_keys(tables.facets, n_nodes))
    outer[row[row >= 0]] = False
    return table.facets[outer], table.first[outer]


# nodes of an element by Gmsh's number of its type: first and second order
_NODES = {1: 2, 2: 3, 3: 4, 4: 4, 5: 8, 6: 6, 7: 5, 8: 3, 9: 6, 10: 9, 11: 10, 12: 27, 13: 18, 14: 14, 15: 1, 16: 8,
          17: 20, 18: 15, 19: 13}
_BEGIN = re.compile(rb"^\$([A-Za-z]+)[ \t]*\r?$", re.MULTILINE)
# node numbers may have gaps, but a table of them must fit into memory
_SPARSEST, _SMALL = 100, 10_000_000


class _Reader:
    """Numbers of a section one after the other, from text or binary."""

    def __init__(self, what: str, data: bytes, binary: bool) -> None:
        self.what, self.data, self.binary, self.at = what, data, binary, 0
        self.words = [] if binary else data.split()

    def take(self, count: int, kind: str) -> np.ndarray:
        """The next ``count`` numbers of a numpy type; text is read as int64 or float64."""
        size = count * np.dtype(kind).itemsize if self.binary else count
        left = (len(self.data) if self.binary else len(self.words)) - self.at
        if count < 0 or size > left:
            raise ValueError(f"the section ${self.what} is cut off, or says {count} entries where fewer follow")
        part = (self.data if self.binary else self.words)[self.at:self.at + size]
        self.at += size
        if self.binary:
            return np.frombuffer(part, dtype=kind)
        try:
            return np.array(part, dtype="S").astype(np.float64 if kind == "f8" else np.int64) if part else np.empty(0)
        except (ValueError, OverflowError):
            raise ValueError(f"the section ${self.what} holds what is no {'number' if kind == 'f8' else 'integer'}: "
                             f"{_first_odd(part, float if kind == 'f8' else int)}") from None

    def end(self) -> None:
        """Nothing but white space may be left."""
        left = self.data[self.at:].strip() if self.binary else self.words[self.at:]
        if left:
            raise ValueError(f"the section ${self.what} holds more than it says")


def _first_odd(words: list[bytes], kind: type) -> str:
    for word in words:
        try:
            kind(word)
        except ValueError:
            return repr(word.decode("utf-8", "replace")[:40])
    return "a number that is too large"


def check_gmsh_file(path: Path) -> None:
    """Raise ValueError unless the sections of a ``.msh`` file are whole and its elements name nodes that it holds."""
    data = path.read_bytes()
    try:
        version, binary = _format(data)
        wide = "u8" if version == "4.1" else "i4"
        nodes = _Reader("Nodes", _section(data, "Nodes"), binary)
        tags = _nodes_2(nodes) if version == "2.2" else _nodes_4(nodes, wide)
        nodes.end()
        if len(tags) == 0 or tags.min() < 1 or tags.max() > _SPARSEST * len(tags) + _SMALL:
            raise ValueError("the section $Nodes has no nodes" if len(tags) == 0 else "node numbers must run from 1 "
                             f"without large gaps, got {tags.min()} to {tags.max()} for {len(tags)} nodes")
        if len(np.unique(tags)) < len(tags):
            raise ValueError("the section $Nodes gives a node number twice")
        elements = _Reader("Elements", _section(data, "Elements"), binary)
        used = _elements_4(elements, wide) if version == "4.1" else (
            _elements_2_binary(elements) if binary else _elements_2(elements))
        elements.end()
        known = np.zeros(int(tags.max()) + 1, dtype=bool)
        known[tags] = True
        outside = (used < 1) | (used > tags.max())
        outside[~outside] = ~known[used[~outside]]
        if outside.any():
            raise ValueError(f"elements name nodes that it does not hold, such as {used[outside][0]}")
        if not binary:
            _all_end(data)
    except ValueError as error:
        raise ValueError(f"{str(path)!r} cannot be read as a Gmsh mesh: {error}") from None


def _format(data: bytes) -> tuple[str, bool]:
    """Version and whether binary."""
    found = re.match(rb"\s*\$MeshFormat\s+(\S+)\s+([01])\s+8\s", data)
    if not found:
        raise ValueError("it does not begin with a $MeshFormat of 2.2 or 4.1")
    version, binary = found[1].decode("ascii", "replace"), found[2] == b"1"
    if version not in ("2.2", "4.1"):
        raise ValueError(f"its version is {version}; it must be MSH 2.2 or 4.1")
    if binary and data[found.end():found.end() + 4] == (1).to_bytes(4, "big"):
        raise ValueError("it was written on a big-endian machine")
    return version, binary


def _section(data: bytes, name: str) -> bytes:
    begin, end = (re.search(rb"(?:^|\n)[ \t]*\$" + text + rb"[ \t]*\r?(?:\n|$)", data)
                  for text in (name.encode(), b"End" + name.encode()))
    if begin is None:
        raise ValueError(f"the section ${name} is missing")
    if end is None or end.start() < begin.end() - 1:
        raise ValueError(f"the section ${name} does not end; the file is cut off")
    return data[begin.end():end.start()]


def _all_end(data: bytes) -> None:
    names = [name.decode() for name in _BEGIN.findall(data)]
    for name in names:
        if not name.startswith("End") and names.count("End" + name) != names.count(name):
            raise ValueError(f"the section ${name} does not end; the file is cut off")


def _header(reader: _Reader, kind: str) -> tuple[int, int]:
    """Blocks and entries of a section of MSH 4.1."""
    blocks, entries, _, _ = (int(n) for n in reader.take(4, kind))
    return blocks, entries


def _line(reader: _Reader) -> int:
    """A count on a line of its own, text in binary files too."""
    if not reader.binary:
        return int(reader.take(1, "i8")[0])
    line, _, _ = reader.data.partition(b"\n")
    reader.at = len(line) + 1
    if not re.fullmatch(rb"\s*\d{1,18}\s*", line):
        raise ValueError(f"the section ${reader.what} does not begin with a count")
    return int(line)


def _nodes_2(reader: _Reader) -> np.ndarray:
    count = _line(reader)
    if reader.binary:
        rows = reader.take(count, "i4,3f8")
        _finite(rows["f1"])
        return rows["f0"].astype(np.int64)
    words = reader.take(4 * count, "f8").reshape(-1, 4)
    _finite(words[:, 1:])
    tags = words[:, 0]
    if (tags != np.round(tags)).any() or np.abs(tags).max(initial=0) >= 2**31:
        raise ValueError("a node number is no integer below 2**31")
    return tags.astype(np.int64)


def _nodes_4(reader: _Reader, wide: str) -> np.ndarray:
    blocks, entries = _header(reader, wide)
    parts, seen = [np.empty(0, dtype=np.int64)], 0
    for _ in range(blocks):
        dim, _, parametric = (int(n) for n in reader.take(3, "i4"))
        count = int(reader.take(1, wide)[0])
        seen += count
        parts.append(reader.take(count, wide).astype(np.int64))
        if dim not in (0, 1, 2, 3) or parametric not in (0, 1):
            raise ValueError(f"a block of $Nodes is of dimension {dim}, parametric {parametric}")
        _finite(reader.take(count * (3 + dim * parametric), "f8"))
    if seen != entries:
        raise ValueError(f"the section $Nodes says {entries} nodes and holds {seen}")
    return np.concatenate(parts)


def _finite(numbers: np.ndarray) -> None:
    if not np.isfinite(numbers).all():
        raise ValueError("a coordinate in the section $Nodes is not finite")


def _width(kind: int) -> int:
    if kind not in _NODES:
        raise ValueError(f"it holds elements of the type {kind}; only triangles and tetrahedra can be used")
    return _NODES[kind]


def _elements_2(reader: _Reader) -> np.ndarray:
    count = _line(reader)
    numbers = reader.take(len(reader.words) - 1, "i8").tolist()
    used: list[int] = []
    at = 0
    for k in range(count):
        # number, type, number of tags, tags, nodes
        last = at + 3 + numbers[at + 2] + _width(numbers[at + 1]) if at + 3 <= len(numbers) else len(numbers) + 1
        if last > len(numbers) or numbers[at + 2] < 0:
            raise ValueError(f"the section $Elements says {count} elements and ends with number {k}")
        used += numbers[at + 3 + numbers[at + 2]:last]
        at = last
    if at != len(numbers):
        raise ValueError("the section $Elements holds more than it says")
    return np.array(used, dtype=np.int64)


def _elements_2_binary(reader: _Reader) -> np.ndarray:
    count, seen, parts = _line(reader), 0, [np.empty(0, dtype=np.int64)]
    while seen < count:
        kind, block, tags = (int(n) for n in reader.take(3, "i4"))
        if block < 1 or not 0 <= tags < 1000:
            raise ValueError(f"a block of $Elements says {block} elements of {tags} tags")
        width = _width(kind)
        rows = reader.take(block * (1 + tags + width), "i4").reshape(block, -1)
        parts.append(rows[:, 1 + tags:].astype(np.int64).ravel())
        seen += block
    return np.concatenate(parts)


def _elements_4(reader: _Reader, wide: str) -> np.ndarray:
    blocks, entries = _header(reader, wide)
    seen, parts = 0, [np.empty(0, dtype=np.int64)]
    for _ in range(blocks):
        kind = int(reader.take(3, "i4")[2])
        count = int(reader.take(1, wide)[0])
        seen += count
        rows = reader.take(count * (1 + _width(kind)), wide).reshape(count, -1)
        parts.append(rows[:, 1:].astype(np.int64).ravel())
    if seen != entries:
        raise ValueError(f"the section $Elements says {entries} elements and holds {seen}")
    return np.concatenate(parts)


_SURFACES = ("surfaceelements", "surfaceelementsgi", "surfaceelementsuv")
# keyword: columns of a line, and which of them are the nodes and the number of the boundary
_SEGMENTS = {"edgesegments": (4, slice(2, 4), 0), "edgesegmentsgi": (6, slice(2, 4), 0),
             "edgesegmentsgi2": (12, slice(2, 4), 0), "edgesegmentsgi3": (7, slice(0, 2), 6)}
# unpacked over packed size: meshes reach about 30
_MAX_PACKING = 200
_COUNT = re.compile(rb"\d{1,10}")


def from_netgen_file(path: Path) -> MeshArrays:
    """Read a mesh of Netgen."""
    file = _File(path)
    dim = file.single("dimension")
    if dim not in (2, 3):
        raise ValueError(f"{file.name}: the dimension must be 2 or 3, got {dim}")
    points = file.table("points", 3)
    if dim == 2 and len(points) and np.ptp(points[:, 2]) > 1e-9 * np.ptp(points[:, :2], axis=0).max():
        raise ValueError(f"{file.name}: the points of a plane mesh must have one z, got {points[:, 2].min():.6g} to "
                         f"{points[:, 2].max():.6g}")
    points = points[:, :dim]
    surface = next((s for s in _SURFACES if s in file.start), None)
    volume = "volumeelements" if dim == 3 else surface
    if volume is None or volume not in file.start or file.count(volume) == 0:
        raise ValueError(f"{file.name}: the mesh has no elements" + (
            " (a surface mesh?); generate the volume mesh first" if dim == 3 else ""))
    if dim == 3:
        elements, head = file.elements(volume, 2, {4: 4, 10: 4}, len(points), "tetrahedra")
        body = head[:, 0]
        facets, head = (file.elements(surface, 5, {3: 3, 6: 3}, len(points), "triangles") if surface else
                        (np.empty((0, 3), dtype=np.int64), np.empty((0, 5), dtype=np.int64)))
        label = head[:, 1]
    else:
        elements, head = file.elements(volume, 5, {3: 3, 6: 3}, len(points), "triangles")
        body = _face_numbers(file, head)
        facets, label = file.segments(len(points))
    boundaries, label = _named(file, "bcnames", label, "boundary")
    bodies, body = _named(file, "materials", body, "body")
    try:
        return check_overlap(with_source(normalised(points, elements, facets, label, boundaries, body, bodies)))
    except ValueError as error:
        raise ValueError(f"{file.name}: {error}") from error


class _File:
    """The lines of a file and where its sections begin."""

    def __init__(self, path: Path) -> None:
        self.name = repr(str(path))
        self.lines = _text(path, self.name).replace(b"\r\n", b"\n").split(b"\n")
        self.start: dict[str, int] = {}
        word = ""
        for i, line in enumerate(self.lines):
            if line[:1].isalpha():
                word = line.strip().decode("ascii", "replace")
                if word == "endmesh":
                    break
                if word in self.start:
                    raise ValueError(f"{self.name}: line {i + 1}: there are two sections {word!r}")
                self.start[word] = i
        else:
            word = ""
        self.end = i
        if next(iter(self.start), "") != "mesh3d":
            raise ValueError(f"{self.name} is not a Netgen mesh: it does not begin with 'mesh3d'")
        if word != "endmesh":
            raise ValueError(f"{self.name} is cut off: the keyword 'endmesh' is missing")

    def single(self, keyword: str) -> int:
        """The number of a line that follows a keyword, such as a count."""
        if keyword not in self.start:
            raise ValueError(f"{self.name}: the section {keyword!r} is missing")
        line = self.lines[self.start[keyword] + 1].strip()
        if not _COUNT.fullmatch(line):
            raise ValueError(f"{self.name}: line {self.start[keyword] + 2}: {keyword!r} must be followed by a number "
                             f">= 0, got {checks.shown(line.decode('utf-8', 'replace'))}")
        return int(line)

    def count(self, keyword: str) -> int:
        """How many lines a section has, checked against those that are there."""
        n = self.single(keyword)
        if self.start[keyword] + 2 + n > self.end:
            raise ValueError(f"{self.name}: line {self.start[keyword] + 2}: the section {keyword!r} says {n} lines, "
                             f"the file has {self.end - self.start[keyword] - 2} more; it is damaged or cut off")
        return n

    def rows(self, keyword: str) -> list[bytes]:
        """The lines of a section."""
        first = self.start[keyword] + 2
        return self.lines[first:first + self.count(keyword)]

    def table(self, keyword: str, columns: int | None = None) -> np.ndarray:
        """A section of numbers, (n, columns) finite floats; by default as wide as its first line."""
        rows = self.rows(keyword) if self.single(keyword) else []
        if not rows:
            return np.empty((0, columns or 1))
        width = len(rows[0].split())
        with warnings.catch_warnings():
            # text that is no number ends the reading: with a warning in older numpy
            warnings.simplefilter("ignore", DeprecationWarning)
            try:
                found = np.fromstring(b" \n ".join(rows), sep=" ")
            except ValueError:
                found = np.empty(0)
        if found.size != len(rows) * width or (columns is not None and columns != width):
            line, what = self._odd_line(keyword, rows, columns or width)
            raise ValueError(f"{self.name}: line {line}: {what} in the section {keyword!r}")
        if not np.isfinite(found).all():
            row = int(np.argmin(np.isfinite(found))) // width
            raise ValueError(f"{self.name}: line {self.start[keyword] + 3 + row}: a number in the section {keyword!r} "
                             "is not finite")
        return found.reshape(len(rows), width)

    def _odd_line(self, keyword: str, rows: list[bytes], columns: int) -> tuple[int, str]:
        """The first line that is not ``columns`` numbers, and what is wrong with it."""
        for i, row in enumerate(rows):
            words = row.split()
            for word in words:
                try:
                    float(word)
                except ValueError:
                    return self.start[keyword] + 3 + i, f"{word.decode('utf-8', 'replace')!r} is no number"
            if len(words) != columns:
                return self.start[keyword] + 3 + i, f"{len(words)} numbers instead of {columns}"
        return self.start[keyword] + 3, "unreadable numbers"

    def integers(self, keyword: str, table: np.ndarray) -> np.ndarray:
        """Columns of a section as integers."""
        odd = (table != np.round(table)) | (np.abs(table) >= 2**31)
        if odd.any():
            i, j = np.argwhere(odd)[0]
            raise ValueError(f"{self.name}: line {self.start[keyword] + 3 + i}: {table[i, j]:.17g} in the section "
                             f"{keyword!r} is no whole number below 2**31")
        return table.astype(np.int64)

    def elements(self, keyword: str, head: int, corners: dict[int, int], n_points: int, kind: str
                 ) -> tuple[np.ndarray, np.ndarray]:
        """Corners, counted from 0, and the columns before the nodes, the last of which is the number of nodes."""
        if self.single(keyword) == 0:
            width = min(corners.values())
            return np.empty((0, width), dtype=np.int64), np.empty((0, head), dtype=np.int64)
        first = self.rows(keyword)[0].split()
        table = self.table(keyword)
        if table.shape[1] <= head:
            raise ValueError(f"{self.name}: line {self.start[keyword] + 3}: {len(first)} numbers are too few for an "
                             f"element in the section {keyword!r}")
        counts = table[:, head - 1]
        if counts[0] not in corners or (counts != counts[0]).any() or table.shape[1] < head + counts[0]:
            bad = int(np.argmax(counts != (counts[0] if counts[0] in corners else -1)))
            raise ValueError(f"{self.name}: line {self.start[keyword] + 3 + bad}: the mesh must consist of {kind}, all "
                             f"of one order; an element of {table[bad, head - 1]:g} nodes is in the section "
                             f"{keyword!r}")
        nodes = self.nodes(keyword, table[:, head:head + corners[int(counts[0])]], n_points)
        return nodes, self.integers(keyword, table[:, :head])

    def nodes(self, keyword: str, table: np.ndarray, n_points: int) -> np.ndarray:
        """Node numbers, checked and counted from 0."""
        nodes = self.integers(keyword, table) - 1
        bad = ((nodes < 0) | (nodes >= n_points)).any(axis=1)
        if bad.any():
            i = int(np.argmax(bad))
            raise ValueError(f"{self.name}: line {self.start[keyword] + 3 + i}: the section {keyword!r} names nodes "
                             f"{(nodes[i] + 1).tolist()}, there are {n_points} (counted from 1)")
        return nodes

    def segments(self, n_points: int) -> tuple[np.ndarray, np.ndarray]:
        """Boundary edges of a plane mesh, and the numbers of their boundaries, counted from 1."""
        keyword = next((s for s in _SEGMENTS if s in self.start), None)
        if keyword is None or self.single(keyword) == 0:
            raise ValueError(f"{self.name}: the mesh has no boundary edges (section 'edgesegmentsgi2')")
        width, where, label = _SEGMENTS[keyword]
        table = self.table(keyword)
        if table.shape[1] < width:
            raise ValueError(f"{self.name}: line {self.start[keyword] + 3}: {table.shape[1]} numbers instead of "
                             f"{width} in the section {keyword!r}")
        numbers = self.integers(keyword, table[:, [label]])[:, 0] + (keyword == "edgesegmentsgi3")
        return self.nodes(keyword, table[:, where], n_points), numbers


def _text(path: Path, name: str) -> bytes:
    """The bytes of a file, unpacked."""
    try:
        packed = path.read_bytes()
        if path.suffix != ".gz":
            return packed
        limit = _MAX_PACKING * len(packed) + 2**20
        with gzip.open(path) as stream:
            text = stream.read(limit + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise ValueError(f"{name} cannot be unpacked: {error}") from error
    if len(text) > limit:
        raise ValueError(f"{name} unpacks to more than {_MAX_PACKING} times its size; that is no mesh")
    return text


def _face_numbers(file: _File, head: np.ndarray) -> np.ndarray:
    """The material number, from 1, of plane elements: the face descriptor that their first four columns are."""
    faces: list[tuple[int, ...]] = []
    if "facedescriptors" in file.start and file.single("facedescriptors"):
        table = file.table("facedescriptors")
        if table.shape[1] < 5:
            raise ValueError(f"{file.name}: the section 'facedescriptors' has {table.shape[1]} columns instead of 5")
        listed = file.integers("facedescriptors", table[:, [0, 4, 1, 2]]) + np.array([1, 0, 0, 0])
        faces = [tuple(row) for row in listed.tolist()]
    kinds, row = np.unique(head[:, :4], axis=0, return_inverse=True)
    order = np.argsort([int(np.argmax(row.ravel() == k)) for k in range(len(kinds))])
    known = [tuple(k) for k in kinds.tolist()]
    faces += [known[k] for k in order if known[k] not in faces]
    return np.array([faces.index(k) + 1 for k in known])[row.ravel()]


def _named(file: _File, keyword: str, numbers: np.ndarray, what: str) -> tuple[Sequence[str], np.ndarray]:
    """Names by index, and the index of each of ``numbers`` (counted from 1); where no names are listed, "default"."""
    names: dict[int, str] = {}
    if keyword in file.start:
        for i, row in enumerate(file.rows(keyword)):
            number, _, text = row.strip().replace(b"\t", b" ", 1).partition(b" ")
            line = f"{file.name}: line {file.start[keyword] + 3 + i}"
            if not _COUNT.fullmatch(number):
                raise ValueError(f"{line}: a name in the section {keyword!r} must follow its number, got "
                                 f"{checks.shown(row.decode('utf-8', 'replace'))}")
            try:
                name = text.strip().decode()
            except UnicodeDecodeError:
                raise ValueError(f"{line}: the name of a {what} is not UTF-8 text") from None
            names[int(number)] = checks.boundary_name(f"{line}: the name of a {what}", name) if name else "default"
    used, index = np.unique(numbers, return_inverse=True)
    if len(used) and used[0] < 1:
        raise ValueError(f"{file.name}: the number of a {what} must be >= 1, got {used[0]}")
    for number in used if names else ():
        if int(number) not in names:
            raise ValueError(f"{file.name}: {what} number {number} has no name in the section {keyword!r}, which lists "
                             f"{', '.join(map(str, list(names)[:8]))}; give all of them names, or none")
    return [names.get(int(number), "default") for number in used], index.ravel()


def as_mesh(mesh: MeshArrays | ngsolve.Mesh | str | Path) -> MeshArrays:
    """Convert to checked MeshArrays.

    Parameters
    ----------
    mesh : MeshArrays, ngsolve.Mesh, str or Path
        A mesh, or a file of Gmsh (``.msh``) or Netgen (``.vol``, ``.vol.gz``).

    Returns
    -------
    MeshArrays
        With its source; the same object if it was MeshArrays with a source already.

    Raises
    ------
    TypeError
        If it is none of these.
    FileNotFoundError
        If there is no such file.
    ValueError
        On another file type, a file that cannot be read, or a mesh that is not sound
        (:func:`adaptmg.mesh.check_mesh`).
    """
    if isinstance(mesh, MeshArrays):
        return check_mesh(mesh) if _fits(mesh) else check_overlap(with_source(mesh))
    if isinstance(mesh, ngsolve.Mesh):
        return from_ngsolve(mesh)
    if not isinstance(mesh, str | Path):
        raise TypeError("mesh must be MeshArrays, an ngsolve.Mesh or the path of a .msh, .vol or .vol.gz file, "
                        f"got {type(mesh).__name__}")
    path = checks.file_path("mesh", mesh)
    if not path.is_file():
        raise FileNotFoundError(f"mesh: there is no file {str(path)!r}")
    if path.suffix == ".msh":
        return from_gmsh(path)
    if path.name.endswith((".vol", ".vol.gz")):
        return from_netgen_file(path)
    if path.suffix.lower() in (".step", ".stp"):
        raise ValueError(f"mesh: {str(path)!r} is a geometry, not a mesh: adaptmg.mesh.from_step(path, size) meshes it")
    raise ValueError(f"mesh: {str(path)!r} is not a .msh, .vol or .vol.gz file; other formats can be converted to .msh "
                     "by meshio")


def _fits(mesh: MeshArrays) -> bool:
    """Whether the source is still that of the arrays: dataclasses.replace keeps it beside new ones."""
    if isinstance(vars(mesh)["source"], OnDemand):
        return mesh.sound
    if not isinstance(mesh.source, ngsolve.Mesh) or mesh.points.ndim != 2:
        return False
    ngmesh = mesh.source.ngmesh
    points = np.array(ngmesh.Coordinates(), dtype=np.float64)
    volume = (ngmesh.Elements2D() if mesh.dim == 2 else ngmesh.Elements3D()).NumPy()
    return (mesh.source.dim == mesh.dim and len(volume) == len(mesh.elements)
            and np.array_equal(points[:, :mesh.dim], mesh.points))
