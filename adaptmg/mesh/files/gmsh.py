"""Files of Gmsh, MSH 2.0 to 4.1, text or binary, as the Contents of a mesh.

A file is sections between ``$Name`` and ``$EndName``; those that are not known here, comments among them, are left out.
Physical groups name what they hold, by their numbers where they have no name. Every number of a section is read and
counted against what the section says: what is cut off or damaged is an error, and no count asks for memory before the
file has as many entries.
"""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

from adaptmg.mesh.files.contents import Contents
from adaptmg.mesh.files.shapes import KINDS, dimension

_KINDS = {1: "line", 2: "triangle", 3: "quad", 4: "tetra", 5: "hexahedron", 6: "wedge", 7: "pyramid", 8: "line3",
          9: "triangle6", 10: "quad9", 11: "tetra10", 12: "hexahedron27", 13: "wedge18", 14: "pyramid14", 15: "vertex",
          16: "quad8", 17: "hexahedron20", 18: "wedge15", 19: "pyramid13"}
#: where Gmsh puts the nodes that VTK counts in order; other kinds are numbered alike
_BRICK, _WEDGE = (*range(9), 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15), (*range(7), 9, 7, 12, 14, 13, 8, 10, 11)
_PYRAMID = (*range(6), 8, 10, 6, 7, 9, 11, 12)
_ORDER = {"tetra10": (*range(8), 9, 8), "hexahedron20": _BRICK, "hexahedron27": (*_BRICK, 22, 23, 21, 24, 20, 25, 26),
          "wedge15": _WEDGE, "wedge18": (*_WEDGE, 15, 17, 16), "pyramid13": _PYRAMID, "pyramid14": (*_PYRAMID, 13)}
_SIZES = {"int": np.dtype("<i4"), "count": np.dtype("<u8"), "real": np.dtype("<f8")}
_KNOWN = ("MeshFormat", "Nodes", "Elements", "Entities", "PhysicalNames")
#: Gmsh's number of a kind, physical groups, and nodes (n, k)
Rows = Iterator[tuple[int, list[int], np.ndarray]]


class _Section:
    """The numbers of a section, taken one block after the other."""

    def __init__(self, name: str, data: bytes, binary: bool) -> None:
        self.name, self.binary, self.at, self.numbers = name, binary, 0, np.frombuffer(data, np.uint8)
        if not binary:
            words = data.split()
            try:
                self.numbers = np.fromiter(map(float, words), np.float64, len(words))
            except ValueError as error:
                raise ValueError(f"the section ${name} must hold numbers only: {error}") from None

    def take(self, kind: str, count: int) -> np.ndarray:
        """Return the next numbers, as integers or floats."""
        end = self.at + count * (_SIZES[kind].itemsize if self.binary else 1)
        if count < 0 or end > len(self.numbers):
            raise ValueError(f"the section ${self.name} does not hold as many entries as it says; the file is cut off")
        found = self.numbers[self.at:end].view(_SIZES[kind]) if self.binary else self.numbers[self.at:end]
        self.at = end
        return found.astype(np.float64) if kind == "real" else self.whole(found)

    def whole(self, values: np.ndarray) -> np.ndarray:
        """Return the values as integers of the size that double precision holds."""
        if not ((np.abs(values) < 2.0**53) & (values == np.floor(values))).all():
            raise ValueError(f"the section ${self.name} must count and number by whole numbers below 2**53")
        return values.astype(np.int64)

    def one(self, kind: str) -> int:
        """Return the next whole number."""
        return int(self.take(kind, 1)[0])

    def end(self, missing: int = 0) -> None:
        """Raise ValueError unless all numbers were taken, and none is ``missing``."""
        if self.at != len(self.numbers) or missing:
            raise ValueError(f"the section ${self.name} does not hold as many entries as it says")


def _sections(data: bytes) -> tuple[float, bool, dict[str, bytes]]:
    """The version, whether numbers are binary, and the text of each section."""
    head = re.match(rb"\s*(?:\$Comments?\b.*?\$EndComments?\s+)?\$MeshFormat\s+(\d\.?\d*)\s+([01])\s+([48])\s*\n", data,
                    re.DOTALL)
    if not head:
        raise ValueError("it does not begin with $MeshFormat and a version")
    version, binary, parts = float(head[1]), head[2] == b"1", {}
    if not (2 <= version < 3 or 4 <= version <= 4.1):
        raise ValueError(f"its version is {head[1].decode()}; it must be MSH 2.0 to 4.1")
    if binary and (data[head.end():head.end() + 4] != b"\1\0\0\0" or version == 4):
        raise ValueError("its binary numbers are not little-endian, or of MSH 4.0: write MSH 4.1 or 2.2")
    at = head.start()
    while match := re.compile(rb"^\$(\w+)[ \t\r]*\n", re.MULTILINE).search(data, at):
        name = match[1].decode()
        end = data.find(b"$End" + match[1], match.end())
        if end < 0 or (name in parts and name in _KNOWN):
            raise ValueError(f"the section ${name} does not end, or comes twice; the file is cut off")
        # binary sections end with a line feed that is not a number
        parts[name] = data[match.end():end].removesuffix(b"\n") if binary else data[match.end():end]
        at = end + 4 + len(name)
    return version, binary, parts


def read_gmsh(data: bytes) -> Contents:
    """Return the contents of a file."""
    version, binary, parts = _sections(data)
    for name in ("Nodes", "Elements"):
        if name not in parts:
            raise ValueError(f"the section ${name} is missing")
    names = _names(parts.get("PhysicalNames", b""))
    if version < 4:
        numbers, points = _nodes_2(*_counted("Nodes", parts, binary))
        rows = _elements_2(*_counted("Elements", parts, binary))
    else:
        entities = parts.get("Entities", bytes(32) if binary else b"0 0 0 0")
        groups = _groups(_Section("Entities", entities, binary), version)
        numbers, points = _nodes_4(_Section("Nodes", parts["Nodes"], binary), version)
        rows = _elements_4(_Section("Elements", parts["Elements"], binary), version, groups)
    order = np.argsort(numbers, kind="stable")
    if len(numbers) == 0 or (np.diff(numbers[order]) == 0).any() or numbers.min() < 1:
        raise ValueError("the section $Nodes holds no nodes, a number below 1, or one twice")
    return _contents(points, numbers[order], order, rows, names)


def _contents(points: np.ndarray, numbers: np.ndarray, order: np.ndarray, rows: Rows, names: dict[tuple[int, int], str]
              ) -> Contents:
    """Cells and faces by the groups of their rows."""
    found: dict[tuple[tuple[int, ...], int], list[np.ndarray]] = {}
    for number, groups, nodes in rows:
        found.setdefault((tuple(groups), number), []).append(nodes)
    dim = max((dimension(_kind(number)) for _, number in found), default=0)
    bodies = sorted({groups[0] if groups else 0 for groups, number in found if dimension(_kind(number)) == dim})
    contents = Contents(points, [], [names.get((dim, group), str(group)) if group else "body" for group in bodies])
    for (groups, number), blocks in sorted(found.items()):
        kind, nodes = _kind(number), np.concatenate(blocks)
        row = np.minimum(np.searchsorted(numbers, nodes), len(numbers) - 1)
        if (numbers[row] != nodes).any():
            raise ValueError(f"elements name nodes that it does not hold, such as {nodes[numbers[row] != nodes][0]}")
        nodes = order[row][:, _ORDER.get(kind, slice(None))]
        if dimension(kind) == dim:
            contents.cells.append((kind, nodes, np.full(len(nodes), bodies.index(groups[0] if groups else 0))))
        elif dimension(kind) == dim - 1:
            for group in groups:
                contents.faces.setdefault(names.get((dim - 1, group), str(group)), []).append((kind, nodes))
    return contents


def _kind(number: int) -> str:
    if number not in _KINDS:
        raise ValueError(f"it holds elements of the type {number} of Gmsh; elements must be of first or second order")
    return _KINDS[number]


def _width(number: int) -> int:
    return KINDS[_kind(number)][1]


def _names(data: bytes) -> dict[tuple[int, int], str]:
    """Names of groups by dimension and number."""
    lines = data.decode(errors="replace").strip().splitlines()
    result = {}
    for line in lines[1:]:
        match = re.fullmatch(r'\s*(\d)\s+(-?\d{1,18})\s+"(.*)"\s*', line)
        if not match:
            raise ValueError(f"the section $PhysicalNames holds {line[:40]!r}, not a dimension, number and name")
        result[int(match[1]), abs(int(match[2]))] = match[3]
    if lines and not (lines[0].strip().isdecimal() and int(lines[0]) == len(lines) - 1):
        raise ValueError("the section $PhysicalNames does not hold as many entries as it says")
    return result


def _counted(name: str, parts: dict[str, bytes], binary: bool) -> tuple[int, _Section]:
    """The number of entries in the first line of a section of MSH 2, and the rest."""
    head, _, rest = parts[name].lstrip().partition(b"\n")
    if not head.strip().isdigit():
        raise ValueError(f"the section ${name} must begin with the number of its entries")
    return int(head), _Section(name, rest, binary)


def _nodes_2(count: int, section: _Section) -> tuple[np.ndarray, np.ndarray]:
    """Numbers and places of nodes of MSH 2."""
    if section.binary:
        table = section.take("int", 7 * count).astype("<i4").reshape(-1, 7)
        numbers, points = table[:, 0], np.ascontiguousarray(table[:, 1:]).view("<f8")
    else:
        table = section.take("real", 4 * count).reshape(-1, 4)
        numbers, points = table[:, 0], table[:, 1:]
    section.end()
    return section.whole(numbers), points


def _elements_2(count: int, section: _Section) -> Rows:
    """Elements of MSH 2: number, kind, number of tags, tags (the first is the group), nodes; in binary files blocks of
    kind, number of elements and number of tags come before."""
    found: dict[tuple[int, int], list[np.ndarray]] = {}
    if section.binary:
        while count > 0:
            kind, n, tags = section.take("int", 3).tolist()
            if n < 1 or tags < 0:
                raise ValueError(f"a block of $Elements says {n} elements of {tags} tags")
            table = section.take("int", n * (1 + tags + _width(kind))).reshape(n, -1)
            found.setdefault((kind, tags), []).append(table[:, 1:])
            count -= n
    else:
        numbers, starts, at = section.take("int", len(section.numbers)), {}, 0
        words = numbers.tolist()
        while at + 2 < len(words):
            kind, tags = words[at + 1], words[at + 2]
            if tags < 0:
                raise ValueError(f"an element of $Elements says {tags} tags")
            starts.setdefault((kind, tags), []).append(at + 3)
            at += 3 + tags + _width(kind)
            count -= 1
        if at != len(words):
            raise ValueError("the section $Elements does not hold as many entries as it says; the file is cut off")
        found = {(kind, tags): [numbers[np.add.outer(places, np.arange(tags + _width(kind)))]]
                 for (kind, tags), places in starts.items()}
    section.end(count)
    for (kind, tags), parts in found.items():
        table = np.concatenate(parts)
        group = np.abs(table[:, 0]) if tags else np.zeros(len(table), dtype=np.int64)
        for number in np.unique(group).tolist():
            yield kind, [number] if number else [], table[group == number, tags:]


def _groups(section: _Section, version: float) -> dict[tuple[int, int], list[int]]:
    """Physical groups of each entity (dimension, number) of MSH 4."""
    result, counts = {}, section.take("count", 4).tolist()
    for dim, count in enumerate(counts):
        for _ in range(count):
            tag = section.one("int")
            section.take("real", 3 if dim == 0 and version > 4 else 6)
            result[dim, tag] = np.abs(section.take("int", section.one("count"))).tolist()
            if dim:
                section.take("int", section.one("count"))
    section.end()
    return result


def _nodes_4(section: _Section, version: float) -> tuple[np.ndarray, np.ndarray]:
    """Numbers and places of nodes of MSH 4."""
    blocks, total, *_ = section.take("count", 4 if version > 4 else 2).tolist()
    numbers, points = [np.empty(0, dtype=np.int64)], [np.empty((0, 3))]
    for _ in range(blocks):
        first, second, parametric = section.take("int", 3).tolist()
        dim, count = first if version > 4 else second, section.one("count")
        width = 3 + max(0, min(dim, 3)) * bool(parametric)
        if version > 4:
            numbers.append(section.take("count", count))
            points.append(section.take("real", width * count).reshape(-1, width)[:, :3])
        else:
            table = section.take("real", (1 + width) * count).reshape(-1, 1 + width)
            numbers.append(section.whole(table[:, 0]))
            points.append(table[:, 1:4])
    section.end(total - sum(map(len, numbers)))
    return np.concatenate(numbers), np.concatenate(points)


def _elements_4(section: _Section, version: float, groups: dict[tuple[int, int], list[int]]) -> Rows:
    """Elements of MSH 4 by entities."""
    blocks, total, *_ = section.take("count", 4 if version > 4 else 2).tolist()
    for _ in range(blocks):
        first, second, kind = section.take("int", 3).tolist()
        count, width = section.one("count"), 1 + _width(kind)
        table = section.take("count", width * count).reshape(-1, width)
        total -= count
        yield kind, groups.get((first, second) if version > 4 else (second, first), []), table[:, 1:]
    section.end(total)
