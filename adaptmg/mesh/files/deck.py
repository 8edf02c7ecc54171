"""Input decks of Abaqus and CalculiX (.inp): meshes with their sets and surfaces, as the Contents of a mesh.

A deck is blocks of a keyword line ``*KEYWORD, PARAMETER=VALUE`` and data lines; ``**`` begins a comment, capitals do
not matter. A part is placed as often as it has instances. Boundaries are surfaces, sets of nodes that hold whole
facets, and sets of elements one dimension below the others (shells around solids). Bodies are pieces that hang together
and have one section; each is called after the smallest set of elements that holds all of it. Elastic constants,
friction and contact pairs become notes; loads, supports and steps are not read.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from adaptmg._files import file_size, read_bytes
from adaptmg.mesh.files.contents import Contents
from adaptmg.mesh.files.shapes import KINDS, dimension, facets_of, kind_of

#: beginnings of the names of element types, and shapes by the number of nodes that follows
_TYPES = (
    (re.compile(r"(?:D|AC|Q)?C3D(\d+)"), {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra",
                                          13: "pyramid", 15: "wedge", 20: "hexahedron", 27: "hexahedron"}),
    (re.compile(r"(?:CPE|CPS|CPEG|CAX|CGAX|DC2D|DCAX|AC2D|ACAX|S|STRI|DS|M3D|SFM3D|R3D)(\d+)"),
     {3: "triangle", 4: "quad", 6: "triangle", 65: "triangle", 8: "quad", 9: "quad"}),
    (re.compile(r"(?:T2D|T3D|R2D|RAX)(\d)"), {2: "line", 3: "line"}),
)
#: Abaqus' 27-node brick has its centre before the centres of its faces, these in their own order
_BRICK_27 = (*range(20), 26, 24, 25, 22, 21, 23, 20)
_GENERATED = ("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM")
_NOT_READ = ("BOUNDARY", "CLOAD", "DLOAD", "DSLOAD", "TIE", "EQUATION", "MPC", "RIGID BODY", "COUPLING", "TRANSFORM",
             "PRE-TENSION SECTION", "TEMPERATURE", "CLEARANCE", "CONTACT INTERFERENCE")
_SETS = {"NSET": "node", "ELSET": "element"}
_MOST_FILES, _MOST_GENERATED = 100, 10**7
#: numbers of nodes and elements are smaller; the k-th instance has them this times k higher
_INSTANCE = 10**12


@dataclass
class _Block:
    """A keyword with its parameters and data lines."""

    keyword: str
    parameters: dict[str, str]
    line: int
    data: list[str] = field(default_factory=list)

    def rows(self) -> Iterator[list[str]]:
        """Return the words of each line; "" for what is left out, also at its end."""
        return ([word.strip() for word in line.split(",")] for line in self.data)

    def error(self, text: str) -> ValueError:
        return ValueError(f"line {self.line}: *{self.keyword}: {text}")


@dataclass
class _Part:
    """Nodes, elements and sets of a part, or of a whole deck. A set has a kind (node, element or surface) and a name in
    capitals; its rows are a number and, of surfaces, a facet of that element (0: all)."""

    numbers: list[np.ndarray] = field(default_factory=list)
    points: list[np.ndarray] = field(default_factory=list)
    elements: list[tuple[str, np.ndarray, np.ndarray, str]] = field(default_factory=list)  # type, numbers, nodes, set
    sets: dict[tuple[str, str], list[np.ndarray]] = field(default_factory=dict)
    sections: list[str] = field(default_factory=list)  # sets of elements

    def place(self, other: _Part, offset: int, instance: str, move: np.ndarray, shift: np.ndarray) -> None:
        """Add another part, moved and with other numbers; names that are taken get that of the instance."""
        named = {key: (key[0], f"{instance}_{key[1]}") if key in self.sets else key for key in other.sets}
        self.numbers += [numbers + offset for numbers in other.numbers]
        self.points += [points @ move.T + shift for points in other.points]
        self.elements += [(kind, numbers + offset, nodes + offset, name)
                          for kind, numbers, nodes, name in other.elements]
        self.sets |= {named[key]: [rows + np.array((offset, 0)) for rows in parts] for key, parts in other.sets.items()}
        self.sections += [named.get(("element", name), ("", name))[1] for name in other.sections]

    def add(self, kind: str, name: str, numbers: np.ndarray, facet: int = 0) -> None:
        """Put numbers into a set, which is made where it is missing."""
        self.sets.setdefault((kind, name), []).append(np.column_stack([numbers, np.full(len(numbers), facet)]))

    def members(self, kind: str, name: str) -> np.ndarray:
        """Return the rows (n, 2) of a set; ValueError if there is none."""
        if (kind, name) not in self.sets:
            raise ValueError(f"there is no set {name!r}")
        return np.concatenate(self.sets[kind, name])


class _Deck:
    """What was read of a deck so far."""

    def __init__(self) -> None:
        self.root, self.parts, self.offsets, self.notes = _Part(), {}, {}, []
        self.current, self.material, self.interaction = self.root, "", ""
        self.spelling: dict[str, str] = {}
        self.not_read: dict[str, None] = {}
        self.nodal: set[str] = set()
        self.files = 0

    def read_file(self, path: Path) -> None:
        """Read a file and those that it includes."""
        self.files += 1
        if self.files > _MOST_FILES:
            raise ValueError(f"it includes more than {_MOST_FILES} files")
        file_size("path", path)
        block = None
        for number, line in enumerate(read_bytes(path).decode("utf-8", "replace").splitlines(), 1):
            line = line.strip()
            if not line or line.startswith("**"):
                continue
            if line.startswith("*"):
                self._read(block, path)
                block = _Block(" ".join(line[1:].split(",")[0].upper().split()), {}, number)
                self._parameters(block, line.split(",")[1:])
                open_ = line.endswith(",")
            elif block is None:
                raise ValueError(f"line {number}: data before the first keyword; a deck begins with a line *KEYWORD")
            elif open_ and "=" in line and not block.data:
                self._parameters(block, line.split(","))
                open_ = line.endswith(",")
            else:
                block.data.append(line)
        self._read(block, path)

    def _parameters(self, block: _Block, words: list[str]) -> None:
        for word in filter(None, map(str.strip, words)):
            key, _, value = word.partition("=")
            value = value.strip().strip('"')
            block.parameters[key.strip().upper()] = value if key.strip().upper() == "INPUT" else value.upper()
            self.spelling.setdefault(value.upper(), value)

    def _read(self, block: _Block | None, path: Path) -> None:
        if block is None:
            return
        if block.keyword in _GENERATED or (block.keyword == "NODE" and "SYSTEM" in block.parameters):
            raise block.error("nodes and elements that the solver generates or moves are not read; write them out")
        if block.keyword == "INCLUDE":
            self.read_file(path.parent / block.parameters.get("INPUT", ""))
        elif block.keyword in _NOT_READ:
            self.not_read[f"*{block.keyword.capitalize()}"] = None
        elif reader := _READERS.get(block.keyword):
            try:
                reader(self, block)
            except (ValueError, OverflowError) as error:
                raise error if str(error).startswith("line ") else block.error(str(error)) from error

    def _part(self, block: _Block) -> None:
        self.current = self.parts.setdefault(block.parameters.get("NAME", ""), _Part())

    def _end(self, _: _Block) -> None:
        self.current = self.root

    def _instance(self, block: _Block) -> None:
        name, part = block.parameters.get("NAME", ""), block.parameters.get("PART", "")
        if part not in self.parts:
            raise ValueError(f"there is no part {part!r}")
        lines = [[_number(word) for word in row if word] for row in block.rows()]
        shift, move = np.zeros(3), np.eye(3)
        if lines:
            shift[:len(lines[0])] = lines[0][:3]
        if len(lines) > 1:
            if len(lines[1]) != 7:
                raise ValueError(f"a rotation is two points and an angle, got {len(lines[1])} numbers")
            from scipy.spatial.transform import Rotation  # seldom used

            foot, axis = np.array(lines[1][:3]), np.subtract(lines[1][3:6], lines[1][:3])
            move = Rotation.from_rotvec(np.radians(lines[1][6]) * axis / max(np.linalg.norm(axis), 1e-300)).as_matrix()
            shift = move @ (shift - foot) + foot
        self.offsets[name] = (len(self.offsets) + 1) * _INSTANCE
        self.spelling |= {f"{name}_{one}": f"{self._spelt(name)}_{self._spelt(one)}"
                          for _, one in self.parts[part].sets}
        self.root.place(self.parts[part], self.offsets[name], name, move, shift)

    def _nodes(self, block: _Block) -> None:
        table = np.array([([_number(word) for word in row[:4]] + [0.0] * 3)[:4] for row in block.rows()])
        numbers = _counted(table.reshape(-1, 4)[:, 0])
        self.current.numbers.append(numbers)
        self.current.points.append(table.reshape(-1, 4)[:, 1:])
        if name := block.parameters.get("NSET"):
            self.current.add("node", name, numbers)

    def _elements(self, block: _Block) -> None:
        kind, name = block.parameters.get("TYPE", ""), block.parameters.get("ELSET", "")
        # of unknown types it is not known how many numbers an element has
        width, rows = 1 + KINDS[_kind(kind) or "vertex"][1], []
        for line in block.data if _kind(kind) else ():
            words = [int(word) for word in line.split(",") if word.strip()]
            if rows and len(rows[-1]) < width:
                rows[-1] += words
            else:
                rows.append(words)
        if rows and len(rows[-1]) < width:
            raise ValueError(f"an element of type {kind} has a number and {width - 1} nodes, element {rows[-1][:1]} "
                             f"has {len(rows[-1]) - 1}")
        table = _counted(np.array([row[:width] for row in rows], dtype=np.int64).reshape(-1, width))
        self.current.elements.append((kind, table[:, 0], table[:, 1:], name))
        if name:
            self.current.add("element", name, table[:, 0])

    def _set(self, block: _Block) -> None:
        part, kind, name = self.current, _SETS[block.keyword], block.parameters.get(block.keyword, "")
        offset, numbers = self.offsets.get(block.parameters.get("INSTANCE", ""), 0), []
        for row in block.rows():
            words = [word for word in row if word]
            if "GENERATE" in block.parameters and words:
                first, last, step = map(int, [*words, "1"][:3])
                if step < 1 or not 0 <= last - first <= _MOST_GENERATED:
                    raise ValueError(f"numbers {first} to {last} by {step} cannot be generated")
                part.add(kind, name, np.arange(first, last + 1, step) + offset)
                continue
            for word in words:
                if word.lstrip("+-").isdigit():
                    numbers.append(int(word))
                elif (kind, word.strip('"').upper()) in part.sets:
                    part.sets.setdefault((kind, name), []).append(part.members(kind, word.strip('"').upper()))
        part.add(kind, name, _counted(np.array(numbers, dtype=np.int64)) + offset)

    def _surface(self, block: _Block) -> None:
        name, part = block.parameters.get("NAME", ""), self.current
        nodal = block.parameters.get("TYPE", "ELEMENT") == "NODE"
        kind = "node" if nodal else "element"
        offset = self.offsets.get(block.parameters.get("INSTANCE", ""), 0)
        for word, *rest in block.rows():
            numbers = (_counted(np.array([int(word)])) + offset if word.isdigit() else
                       part.members(kind, word.strip('"').upper())[:, 0])
            facet = re.fullmatch(r"[SE](\d)|SPOS|SNEG|", "" if nodal else "".join(rest[:1]).upper())
            if facet is None:
                raise ValueError(f"a face is S1 to S6, got {rest[0]!r}")
            part.add("node" if nodal else "surface", name, numbers, int(facet[1] or 0))
        if nodal:
            self.nodal.add(self._spelt(name))

    def _section(self, block: _Block) -> None:
        name = block.parameters.get("ELSET", "")
        self.current.sections.append(name)
        material = self._spelt(block.parameters.get("MATERIAL", ""))
        self.notes.append(f"section {self._spelt(name)!r}: material {material!r}")

    def _named(self, block: _Block) -> None:
        setattr(self, "material" if block.keyword == "MATERIAL" else "interaction",
                self._spelt(block.parameters.get("NAME", "")))

    def _constants(self, block: _Block) -> None:
        words = [word for word in next(block.rows(), []) if word]
        if block.keyword == "FRICTION":
            self.notes.append(f"friction {', '.join(words[:1])} of {self.interaction!r}")
        else:
            self.notes.append(f"material {self.material!r}: elastic constants {', '.join(words)} in the units of the "
                              "file")

    def _pair(self, block: _Block) -> None:
        for row in block.rows():
            self.notes.append(f"contact pair: {', '.join(map(self._spelt, map(str.upper, row[:2])))}")

    def _spelt(self, name: str) -> str:
        return self.spelling.get(name, name)

    def contents(self) -> Contents:
        """Return the root with all that its sets name."""
        root = self.root
        if not root.numbers and self.parts:
            raise ValueError("it has parts, but no instances of them")
        numbers = np.concatenate([np.empty(0, dtype=np.int64), *root.numbers])
        # a node that comes again is moved
        numbers, last = np.unique(numbers[::-1], return_index=True)
        points = np.concatenate([np.empty((0, 3)), *root.points])[::-1][last]
        blocks = [(_kind(kind), elements, _rows(nodes, numbers, "nodes"), name)
                  for kind, elements, nodes, name in root.elements if _kind(kind)]
        dim = max((dimension(kind) for kind, *_ in blocks), default=0)
        left = sorted({kind or "without a type" for kind, *_ in root.elements if _kind(kind) is None})
        used = sorted({kind for kind, *_ in root.elements if _kind(kind)})
        notes = [f"elements of the types {', '.join(used)}", *self.notes]
        if left:
            notes.append(f"left out: elements of the types {', '.join(left)}")
        if self.not_read:
            notes.append(f"not read: {', '.join(self.not_read)}")
        if dim < 2:
            raise ValueError(f"it holds elements of the types {', '.join(used + left) or 'none'}; solid or plane ones "
                             "are needed (C3D8, C3D10, CPE4, CPS6, CAX8, ...)")
        contents = Contents(points, [], [], notes=notes, surfaces=self.nodal)
        solid = [block for block in blocks if dimension(block[0]) == dim]
        sets = {name: np.unique(root.members(kind, name)[:, 0]) for kind, name in root.sets if kind == "element"}
        # bodies are pieces of one section, or of one block
        sections = list(dict.fromkeys(root.sections or [name for *_, name in solid]))
        contents.bodies = ["body"] * (1 + len(sections))
        for kind, elements, nodes, name in solid:
            own = np.full(len(nodes), 0 if root.sections else 1 + sections.index(name))
            for k, section in enumerate(root.sections and sections):
                own[np.isin(elements, sets.get(section, []))] = 1 + k
            contents.cells.append((kind, nodes, own))
        contents.cell_sets = {self._spelt(name): [np.isin(elements, members) for _, elements, *_ in solid]
                              for name, members in sets.items()}
        for name, members in sets.items():
            sheets = [(kind, nodes[np.isin(elements, members)]) for kind, elements, nodes, _ in blocks
                      if dimension(kind) == dim - 1]
            if any(len(nodes) for _, nodes in sheets):
                contents.faces.setdefault(self._spelt(name), []).extend(sheets)
        for kind, name in root.sets:
            rows = root.members(kind, name)
            if kind == "node":
                contents.node_sets[self._spelt(name)] = np.flatnonzero(np.isin(numbers, rows[:, 0]))
            elif kind == "surface":
                contents.faces.setdefault(self._spelt(name), []).extend(
                    face for facet in np.unique(rows[:, 1]).tolist()
                    for face in _faces(solid, rows[rows[:, 1] == facet, 0], facet))
        return contents


_READERS = {"PART": _Deck._part, "END PART": _Deck._end, "ASSEMBLY": _Deck._end, "INSTANCE": _Deck._instance,
            "NODE": _Deck._nodes, "ELEMENT": _Deck._elements, "NSET": _Deck._set, "ELSET": _Deck._set,
            "SURFACE": _Deck._surface, "SOLID SECTION": _Deck._section, "MATERIAL": _Deck._named,
            "SURFACE INTERACTION": _Deck._named, "ELASTIC": _Deck._constants, "FRICTION": _Deck._constants,
            "CONTACT PAIR": _Deck._pair}


def read_deck(path: Path) -> Contents:
    """Return the contents of a deck."""
    deck = _Deck()
    deck.read_file(path)
    return deck.contents()


def _number(word: str) -> float:
    """A number as Fortran writes it; 0 where it is left out."""
    try:
        return float(word or 0)
    except ValueError:
        return float(word.upper().replace("D", "E"))


def _counted(numbers: np.ndarray) -> np.ndarray:
    """Numbers of nodes or elements as integers."""
    if not ((numbers >= 0) & (numbers < _INSTANCE) & (numbers == np.floor(numbers))).all():
        raise ValueError(f"nodes and elements are numbered from 1 to {_INSTANCE - 1}")
    return numbers.astype(np.int64)


def _kind(name: str) -> str | None:
    """The kind of cell of an element type."""
    for pattern, shapes in _TYPES:
        if (match := pattern.match(name)) and int(match[1]) in shapes:
            return kind_of(shapes[int(match[1])], {65: 6}.get(int(match[1]), int(match[1])))
    return None


def _rows(nodes: np.ndarray, numbers: np.ndarray, what: str) -> np.ndarray:
    """Rows of numbers in a sorted table."""
    row = np.minimum(np.searchsorted(numbers, nodes), max(len(numbers) - 1, 0))
    if nodes.size and (len(numbers) == 0 or (numbers[row] != nodes).any()):
        bad = nodes[numbers[row] != nodes][0] if len(numbers) else nodes.flat[0]
        raise ValueError(f"elements name {what} that it does not hold, such as {bad % _INSTANCE}")
    return row[:, _BRICK_27] if row.ndim == 2 and row.shape[1] == 27 else row


Blocks = list[tuple[str, np.ndarray, np.ndarray, str]]


def _faces(solid: Blocks, members: np.ndarray, facet: int) -> Iterator[tuple[str, np.ndarray]]:
    """Kinds and nodes of a facet of some elements, of all their facets where it is 0."""
    for kind, elements, nodes, _ in solid:
        rows = nodes[np.isin(elements, members)]
        facets = facets_of(kind)
        if len(rows) and facet > len(facets):
            raise ValueError(f"a surface names the face S{facet} of {KINDS[kind][1]}-node elements, which have "
                             f"{len(facets)}")
        for one, local in (facets if facet == 0 else facets[facet - 1:facet]) if len(rows) else ():
            yield one, rows[:, local]
