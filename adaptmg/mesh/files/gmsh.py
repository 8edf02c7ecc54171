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
_BRICK = (*range(9), 11, 13, 9, 16, 18, 19, 17, 10, 12, 14, 15)
_ORDER = {"tetra10": (*range(8), 9, 8), "hexahedron20": _BRICK, "hexahedron27": (*_BRICK, 22, 23, 21, 24, 20, 25, 26),
          "wedge15": (*range(7), 9, 7, 12, 14, 13, 8, 10, 11), "pyramid13": (*range(6), 8, 10, 6, 7, 9, 11, 12),
          "wedge18": (*range(7), 9, 7, 12, 14, 13, 8, 10, 11, 15, 17, 16),
          "pyramid14": (*range(6), 8, 10, 6, 7, 9, 11, 12, 13)}
_SIZES = {"int": "i4", "count": "u8", "real": "f8"}
_KNOWN = ("Nodes", "Elements", "Entities", "PhysicalNames")
Rows = list[tuple[int, list[int], np.ndarray]]


class _Section:
    """The numbers of a section, taken one block after the other."""

    def __init__(self, name: str, data: bytes, binary: bool) -> None:
        self.name, self.data, self.binary, self.at = name, data, binary, 0
        if not binary:
            self.numbers = _floats(name, data)

    def take(self, kind: str, count: int) -> np.ndarray:
        """The next numbers, as integers or floats."""
        size = np.dtype(_SIZES[kind]).itemsize if self.binary else 1
        end = self.at + size * count
        if count < 0 or end > len(self.data if self.binary else self.numbers):
            raise ValueError(f"the section ${self.name} does not hold as many entries as it says; the file is cut off")
        found = (np.frombuffer(self.data, "<" + _SIZES[kind], count, self.at) if self.binary else
                 self.numbers[self.at:end])
        self.at = end
        if kind == "real":
            return found.astype(np.float64)
        return _whole(self.name, found)

    def one(self, kind: str) -> int:
        """The next whole number."""
        return int(self.take(kind, 1)[0])

    def end(self) -> None:
        """ValueError unless all numbers were taken."""
        if self.at != len(self.data if self.binary else self.numbers):
            raise ValueError(f"the section ${self.name} holds more entries than it says")


def _floats(name: str, data: bytes) -> np.ndarray:
    words = data.split()
    try:
        return np.fromiter(map(float, words), np.float64, len(words))
    except ValueError as error:
        raise ValueError(f"the section ${name} must hold numbers only: {error}") from None


def _whole(name: str, values: np.ndarray) -> np.ndarray:
    """Integers of the size that double precision holds."""
    if not ((np.abs(values) < 2.0**53) & (values == np.floor(values))).all():
        raise ValueError(f"the section ${name} must hold whole numbers below 2**53 where it counts or numbers")
    return values.astype(np.int64)


def _sections(data: bytes) -> tuple[float, bool, dict[str, bytes]]:
    """The version, whether numbers are binary, and the text of each section."""
    head = re.match(rb"\s*(?:\$Comments?\b.*?\$EndComments?\s+)?\$MeshFormat\s+(\d\.?\d*)\s+([01])\s+([48])\s*\n", data,
                    re.DOTALL)
    if not head:
        raise ValueError("it does not begin with $MeshFormat and a version")
    version, binary, parts = float(head[1]), head[2] == b"1", {}
    if not (2 <= version < 3 or 4 <= version <= 4.1):
        raise ValueError(f"its version is {head[1].decode()}; it must be MSH 2.0 to 4.1")
    if binary and data[head.end():head.end() + 4] != b"\1\0\0\0":
        raise ValueError("its binary numbers are not little-endian")
    at = head.start()
    while match := re.compile(rb"^\$(\w+)[ \t\r]*\n", re.MULTILINE).search(data, at):
        name = match[1].decode()
        end = data.find(b"$End" + match[1], match.end())
        if end < 0 or (name in parts and name in _KNOWN):
            raise ValueError(f"the section ${name} does not end, or comes twice; the file is cut off")
        # binary sections end with a line feed that is no number
        parts[name] = data[match.end():end].removesuffix(b"\n") if binary else data[match.end():end]
        at = end + 4 + len(name)
    return version, binary, parts


def read_gmsh(data: bytes) -> Contents:
    """The contents of a file."""
    version, binary, parts = _sections(data)
    for name in ("Nodes", "Elements"):
        if name not in parts:
            raise ValueError(f"the section ${name} is missing")
    names = _names(parts.get("PhysicalNames", b""))
    if version < 4:
        numbers, points = _nodes_2(parts["Nodes"], binary)
        rows = list(_elements_2(parts["Elements"], binary))
    else:
        groups = _groups(_Section("Entities", parts.get("Entities", b"0 0 0 0" if not binary else bytes(32)), binary),
                         version)
        numbers, points = _nodes_4(_Section("Nodes", parts["Nodes"], binary), version)
        rows = list(_elements_4(_Section("Elements", parts["Elements"], binary), version, groups))
    order = np.argsort(numbers, kind="stable")
    if len(numbers) == 0 or (np.diff(numbers[order]) == 0).any() or numbers.min() < 1:
        raise ValueError("the section $Nodes holds no nodes, a number below 1, or one twice")
    return _contents(points, numbers[order], order, rows, names)


def _contents(points: np.ndarray, numbers: np.ndarray, order: np.ndarray, rows: Rows, names: dict[tuple[int, int], str]
              ) -> Contents:
    """Cells and faces by the groups of rows (type, groups, nodes)."""
    dim = max((dimension(_kind(number)) for number, _, _ in rows), default=0)
    found: dict[tuple[int, tuple[int, ...]], list[np.ndarray]] = {}
    for number, groups, nodes in rows:
        found.setdefault((number, tuple(groups)), []).append(nodes)
    contents = Contents(points, [], [])
    bodies = sorted({groups[0] if groups else 0 for number, groups in found if dimension(_kind(number)) == dim})
    contents.bodies = [names.get((dim, group), str(group)) if group else "body" for group in bodies]
    for (number, groups), blocks in sorted(found.items(), key=lambda item: item[0][1]):
        kind = _kind(number)
        nodes = np.concatenate(blocks)
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


def _count(name: str, data: bytes) -> tuple[int, bytes]:
    """The number in the first line of a section of MSH 2, and the rest."""
    head, _, rest = data.lstrip().partition(b"\n")
    if not head.strip().isdigit():
        raise ValueError(f"the section ${name} must begin with the number of its entries")
    return int(head), rest


def _nodes_2(data: bytes, binary: bool) -> tuple[np.ndarray, np.ndarray]:
    """Numbers and places of nodes of MSH 2."""
    count, rest = _count("Nodes", data)
    if binary:
        if len(rest) != 28 * count:
            raise ValueError("the section $Nodes does not hold as many entries as it says")
        table = np.frombuffer(rest, np.dtype([("number", "<i4"), ("x", "<f8", 3)]))
        return table["number"].astype(np.int64), np.array(table["x"])
    section = _Section("Nodes", rest, False)
    table = section.take("real", 4 * count).reshape(-1, 4)
    section.end()
    return _whole("Nodes", table[:, 0]), table[:, 1:]


def _elements_2(data: bytes, binary: bool) -> Iterator[tuple[int, list[int], np.ndarray]]:
    """Elements of MSH 2; rows of one kind and group in one block where they follow each other."""
    count, rest = _count("Elements", data)
    blocks: dict[tuple[int, int], list[np.ndarray]] = {}
    if binary:
        section, total = _Section("Elements", rest, True), 0
        while total < count:
            kind, n, tags = section.take("int", 3).tolist()
            width = 1 + tags + KINDS[_kind(kind)][1]
            if n < 1 or tags < 0:
                raise ValueError(f"a block of $Elements says {n} elements of {tags} tags")
            blocks.setdefault((kind, tags), []).append(section.take("int", n * width).reshape(n, width)[:, 1:])
            total += n
        section.end()
    else:
        lines = [line.split() for line in rest.splitlines() if line.strip()]
        texts: dict[tuple[int, int], list[list[int]]] = {}
        for line in lines:
            kind, tags = (int(word) for word in line[1:3])
            if tags < 0 or len(line) != 3 + tags + KINDS[_kind(kind)][1]:
                raise ValueError("a line of the section $Elements does not hold as many entries as it says")
            texts.setdefault((kind, tags), []).append(list(map(int, line[3:])))
        if len(lines) != count:
            raise ValueError("the section $Elements does not hold as many entries as it says")
        blocks = {key: [np.array(rows, dtype=np.int64)] for key, rows in texts.items()}
    for (kind, tags), parts in blocks.items():
        table = np.concatenate(parts)
        group = np.abs(table[:, 0]) if tags else np.zeros(len(table), dtype=np.int64)
        for number in np.unique(group):
            yield kind, [int(number)] if number else [], table[group == number, tags:]


def _groups(section: _Section, version: float) -> dict[tuple[int, int], list[int]]:
    """Physical groups of each entity (dimension, number)."""
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
        elif section.binary:
            raise ValueError("binary MSH 4.0 cannot be read: write MSH 4.1 or 2.2")
        else:
            table = section.take("real", (1 + width) * count).reshape(-1, 1 + width)
            numbers.append(_whole("Nodes", table[:, 0]))
            points.append(table[:, 1:4])
    section.end()
    if sum(map(len, numbers)) != total:
        raise ValueError("the section $Nodes does not hold as many entries as it says")
    return np.concatenate(numbers), np.concatenate(points)


def _elements_4(section: _Section, version: float, groups: dict[tuple[int, int], list[int]]
                ) -> Iterator[tuple[int, list[int], np.ndarray]]:
    """Elements of MSH 4 by entities."""
    blocks, total, *_ = section.take("count", 4 if version > 4 else 2).tolist()
    for _ in range(blocks):
        first, second, kind = section.take("int", 3).tolist()
        dim, entity = (first, second) if version > 4 else (second, first)
        count, width = section.one("count"), 1 + KINDS[_kind(kind)][1]
        table = section.take("count" if version > 4 else "int", width * count).reshape(-1, width)
        total -= count
        yield kind, groups.get((dim, entity), []), table[:, 1:]
    section.end()
    if total:
        raise ValueError("the section $Elements does not hold as many entries as it says")
