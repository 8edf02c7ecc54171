"""check_gmsh_file: the counts and node numbers of a Gmsh file, before meshio follows them.

Every section must end, hold as many nodes and elements as it says, and its elements may name only nodes that it lists:
meshio takes node -1 for another one, reads files that are cut off, and makes tables as long as the largest number.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

__all__ = ["check_gmsh_file"]

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
    """Raise ValueError unless the sections of a ``.msh`` file are whole and its elements name nodes that it holds.

    Parameters
    ----------
    path : Path
        An existing file, MSH 2.2 or 4.1, text or binary.
    """
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
