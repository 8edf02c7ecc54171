"""Input decks of Abaqus and CalculiX (.inp): meshes with their sets and surfaces, as the Contents
of a mesh.

A deck is blocks of a keyword line ``*KEYWORD, PARAMETER=VALUE`` and data lines; ``**`` begins a
comment, capitals do not matter. Boundaries are surfaces, sets of nodes that hold whole facets, and
sets of elements one dimension below the others (shells around solids). Bodies are pieces that hang
together and have one section. Elastic constants, friction and contact pairs become notes; loads,
supports and steps are not read, nor are parts and instances."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from adaptmg._files import file_size, read_bytes
from adaptmg.mesh.contents import Contents, rows_of
from adaptmg.mesh.shapes import KINDS, dimension, facets_of

#: beginnings of the names of element types, and kinds by the number of nodes that follows; of beams,
#: and of shells and membranes of revolution, the order follows
_TYPES = (
    (
        re.compile(r"(?:D|AC|Q)?C3D(\d+)"),
        {
            4: "tetra",
            5: "pyramid",
            6: "wedge",
            8: "hexahedron",
            10: "tetra10",
            13: "pyramid13",
            15: "wedge15",
            20: "hexahedron20",
            27: "hexahedron27",
        },
    ),
    (
        re.compile(r"(?:CPE|CPS|CPEG|CAX|CGAX|DC2D|DCAX|AC2D|ACAX|S|STRI|DS|M3D|SFM3D|R3D)(\d+)"),
        {3: "triangle", 4: "quad", 6: "triangle6", 65: "triangle6", 8: "quad8", 9: "quad9"},
    ),
    (re.compile(r"(?:T2D|T3D|R2D|RAX)(\d)"), {2: "line", 3: "line3"}),
    (re.compile(r"(?:B2|B3|SAX|MAX|MGAX|SFMAX|SFMGAX)(\d)"), {1: "line", 2: "line3"}),
)
#: where a deck counts other than VTK: the middle of a line comes between its ends, and the centre of
#: a brick before those of its faces, which have their own order
_ORDER = {"line3": (0, 2, 1), "hexahedron27": (*range(20), 26, 24, 25, 22, 21, 23, 20)}
#: the comment that Gmsh writes before elements, which it calls after the entities of its geometry
_OF_GMSH = "******* E L E M E N T S"
#: why decks with these keywords are refused
_REFUSED: dict[str, str] = dict.fromkeys(
    ("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM"),
    "nodes and elements that the solver generates or moves are not read; write them out",
)
_REFUSED |= dict.fromkeys(
    ("PART", "INSTANCE", "ASSEMBLY"),
    "a deck of parts is not read; write it without parts and "
    "instances (Abaqus/CAE: attributes of the model, 'Do not use parts and assemblies')",
)
#: keywords that are noted as not read; of all others nothing is said
_NOT_READ = (
    "BOUNDARY",
    "CLOAD",
    "DLOAD",
    "DSLOAD",
    "TIE",
    "EQUATION",
    "MPC",
    "RIGID BODY",
    "COUPLING",
    "TRANSFORM",
    "PRE-TENSION SECTION",
    "TEMPERATURE",
    "CLEARANCE",
    "CONTACT INTERFERENCE",
)
#: files of a deck, numbers of nodes and elements, and members of a generated set: at most, far beyond any model
_MOST_FILES, _MOST_NUMBER, _MOST_GENERATED = 100, 10**12, 10**7


#: the elements of one type: kind of cell, numbers (n,), and nodes (n, k) as rows of the points
_NumberedCells = tuple[str, np.ndarray, np.ndarray]


@dataclass
class _Block:
    """A keyword with its parameters and data lines."""

    keyword: str  # in capitals, without *
    parameters: dict[str, str]  # in capitals, but for names of files
    line: int  # its number in the file, from 1
    data: list[str] = field(default_factory=list)

    def rows(self) -> Iterator[list[str]]:
        """Return the words of each line; "" for what is left out, also at its end."""
        return ([word.strip() for word in line.split(",")] for line in self.data)


class _InLine(ValueError):
    """An error in a line of a deck, or of a file that it includes."""


class _Deck:
    """The parts of a deck that were read so far. Names of sets are in capitals."""

    def __init__(self) -> None:
        self.numbers = [np.empty(0, dtype=np.int64)]  # of the nodes, of each *NODE
        self.points = [np.empty((0, 3))]  # the places of these nodes
        # type, numbers, nodes, set
        self.elements: list[tuple[str, np.ndarray, np.ndarray, str]] = []
        self.sets: dict[str, dict[str, list[np.ndarray]]] = {"NSET": {}, "ELSET": {}}
        # elements, and their facet (0: all)
        self.surfaces: dict[str, list[tuple[np.ndarray, int]]] = {}
        self.sections: list[str] = []  # sets of elements that have one
        self.nodal: set[str] = set()  # surfaces that are sets of nodes, as the deck spells them
        self.notes: list[str] = []
        self.not_read: dict[str, None] = {}  # keywords, in order
        self.spelling: dict[str, str] = {}  # of names in capitals
        self.material = ""  # the last one named, as is the interaction
        self.interaction = ""
        self.files = 0  # read so far
        self.of_gmsh = False  # whether Gmsh wrote it

    def read_file(self, path: Path, place: str = "") -> None:
        """Read a file and those that it includes; ``place`` names it in messages."""
        self.files += 1
        if self.files > _MOST_FILES:
            raise ValueError(f"it includes more than {_MOST_FILES} files")
        file_size("INPUT", path)  # called for its check that the file exists
        block = None
        unfinished = False  # whether the next line may have more parameters of the block
        for number, line in enumerate(read_bytes(path).decode("utf-8", "replace").splitlines(), 1):
            line = line.strip()
            if not line or line.startswith("**"):
                self.of_gmsh |= line.startswith(_OF_GMSH)
                continue
            if line.startswith("*"):
                self._read(block, path, place)  # the block before is complete
                keyword, *parameters = line[1:].split(",")
                block = _Block(" ".join(keyword.upper().split()), {}, number)
                self._parameters(block, parameters)
                unfinished = line.endswith(",")
            elif block is None:
                raise _InLine(
                    f"{place}line {number}: data before the first keyword; a deck begins with a line *KEYWORD"
                )
            elif unfinished and "=" in line and not block.data:
                self._parameters(block, line.split(","))
                unfinished = line.endswith(",")
            else:
                block.data.append(line)
        self._read(block, path, place)

    def _parameters(self, block: _Block, words: list[str]) -> None:
        """Add parameters KEY=VALUE to a block, in capitals but for names of files; note the spelling."""
        for word in filter(None, map(str.strip, words)):
            key, _, value = word.partition("=")
            key = key.strip().upper()
            value = value.strip().strip('"')
            block.parameters[key] = value if key == "INPUT" else value.upper()
            self.spelling.setdefault(value.upper(), value)

    def _read(self, block: _Block | None, path: Path, place: str) -> None:
        """Read a block that is complete, None: nothing, of the file ``path``; errors get the ``place`` of the
        file, the line and the keyword."""
        if block is None:
            return
        try:
            # nodes in other coordinates (*NODE, SYSTEM=...) are refused like *SYSTEM
            if refusal := _REFUSED.get(
                "SYSTEM"
                if block.keyword == "NODE" and "SYSTEM" in block.parameters
                else block.keyword
            ):
                raise ValueError(refusal)
            if block.keyword == "INCLUDE":
                name = block.parameters.get("INPUT", "")
                self.read_file(path.parent / name, f"in {name!r}, ")
            elif block.keyword in _NOT_READ:
                self.not_read[f"*{block.keyword.capitalize()}"] = None
            elif reader := _READERS.get(block.keyword):
                reader(self, block)
        except _InLine:
            raise
        except (ValueError, OverflowError, OSError) as error:
            raise _InLine(f"{place}line {block.line}: *{block.keyword}: {error}") from error

    def _members(self, kind: str, word: str) -> np.ndarray:
        """Return the numbers (n,) that a word says: one, or those of a set of this ``kind``, "NSET" or
        "ELSET"."""
        name = word.strip('"').upper()
        if word.isdigit():
            return _counted(np.array([int(word)]))
        if name not in self.sets[kind]:
            raise ValueError(f"there is no set {name!r}")
        return np.concatenate(self.sets[kind][name])

    def _nodes(self, block: _Block) -> None:
        """Read the nodes of *NODE: the number and the coordinates of each, 0 where they are left out."""
        table = np.array(
            [([_number(word) for word in row[:4]] + [0.0] * 3)[:4] for row in block.rows()]
        ).reshape(-1, 4)
        self.numbers.append(_counted(table[:, 0]))
        self.points.append(table[:, 1:])
        if name := block.parameters.get("NSET"):
            self.sets["NSET"].setdefault(name, []).append(self.numbers[-1])

    def _elements(self, block: _Block) -> None:
        """Read the elements of *ELEMENT: number and nodes of each, in one line or in several."""
        element_type = block.parameters.get("TYPE", "")
        name = block.parameters.get("ELSET", "")
        # of unknown types, whose number of nodes is not known, no line is read, and the width does not matter
        width = 1 + KINDS[_kind(element_type) or "vertex"][1]
        rows = []
        for line in block.data if _kind(element_type) else ():
            # a row that is too short goes on in the next line
            words = [int(word) for word in line.split(",") if word.strip()]
            if rows and len(rows[-1]) < width:
                rows[-1] += words
            else:
                rows.append(words)
        if rows and len(rows[-1]) < width:
            raise ValueError(
                f"an element of type {element_type} has a number and {width - 1} nodes, element {rows[-1][:1]} "
                f"has {len(rows[-1]) - 1}"
            )
        table = _counted(np.array([row[:width] for row in rows], dtype=np.int64).reshape(-1, width))
        self.elements.append((element_type, table[:, 0], table[:, 1:], name))
        if name:
            self.sets["ELSET"].setdefault(name, []).append(table[:, 0])

    def _set(self, block: _Block) -> None:
        """Read the members of *NSET or *ELSET: numbers, names of sets, or with GENERATE the first
        number, the last one and the step, 1 where it is left out."""
        members = self.sets[block.keyword].setdefault(
            block.parameters.get(block.keyword, ""), [_counted(np.empty(0))]
        )
        for row in block.rows():
            words = [word for word in row if word]
            if "GENERATE" in block.parameters and words:
                first, last, step = _counted(
                    np.array([int(word) for word in [*words, "1"][:3]])
                ).tolist()
                if step < 1 or last - first > step * _MOST_GENERATED:
                    raise ValueError(f"numbers {first} to {last} by {step} cannot be generated")
                members.append(np.arange(first, last + 1, step))
            else:
                members += [self._members(block.keyword, word) for word in words]

    def _surface(self, block: _Block) -> None:
        """Read *SURFACE: a set or number of elements and a face (S1 to S6) in each line, or a set
        or number of nodes."""
        name = block.parameters.get("NAME", "")
        nodal = block.parameters.get("TYPE", "ELEMENT") == "NODE"
        for word, *rest in block.rows():
            # S1 to S6 a face of solids, E1 to E4 an edge of plane elements; 0, all facets, where no
            # facet is named, or a side of shells (SPOS, SNEG)
            label = "" if nodal else "".join(rest[:1]).upper()
            facet = re.fullmatch(r"[SE](\d)|SPOS|SNEG|", label)
            if facet is None:
                raise ValueError(f"a face is S1 to S6, got {rest[0]!r}")
            if nodal:
                self.nodal.add(self._spelt(name))
                self.sets["NSET"].setdefault(name, []).append(self._members("NSET", word))
            else:
                self.surfaces.setdefault(name, []).append(
                    (self._members("ELSET", word), int(facet[1] or 0))
                )

    def _section(self, block: _Block) -> None:
        """Note the material of the set of elements of *SOLID SECTION, which is a body."""
        self.sections.append(block.parameters.get("ELSET", ""))
        self.notes.append(
            f"section {self._spelt(self.sections[-1])!r}: material "
            f"{self._spelt(block.parameters.get('MATERIAL', ''))!r}"
        )

    def _named(self, block: _Block) -> None:
        """Remember the name of *MATERIAL or *SURFACE INTERACTION, for the constants that follow it."""
        setattr(
            self,
            "material" if block.keyword == "MATERIAL" else "interaction",
            self._spelt(block.parameters.get("NAME", "")),
        )

    def _constants(self, block: _Block) -> None:
        """Note the constants of *ELASTIC or *FRICTION, which are not taken over."""
        words = [word for word in next(block.rows(), []) if word]
        if block.keyword == "FRICTION":
            self.notes.append(f"friction {', '.join(words[:1])} of {self.interaction!r}")
        else:
            self.notes.append(
                f"material {self.material!r}: elastic constants {', '.join(words)} in the units of the "
                "file"
            )

    def _pair(self, block: _Block) -> None:
        """Note the slave and the master of each line of *CONTACT PAIR."""
        self.notes += [
            f"contact pair: {', '.join(map(self._spelt, map(str.upper, row[:2])))}"
            for row in block.rows()
        ]

    def _spelt(self, name: str) -> str:
        """Return a name as the deck spells it where it comes first."""
        return self.spelling.get(name, name)

    def _groups(self) -> dict[str, np.ndarray]:
        """Return the numbers (n,) of the elements of each set.

        Gmsh writes the elements by the entities of its geometry, say "Volume1", and then its physical
        groups, say "steel", as sets of the same elements. Of entities only those count that have an
        element in no physical group, which would else be in no set."""
        groups = {name: np.concatenate(parts) for name, parts in self.sets["ELSET"].items()}
        entities = {entity for *_, entity in self.elements if entity} if self.of_gmsh else set()
        physical = [members for name, members in groups.items() if name not in entities]
        return {
            name: members
            for name, members in groups.items()
            if name not in entities or not np.isin(members, np.concatenate([[], *physical])).all()
        }

    def contents(self) -> Contents:
        """Return the elements that can be read, with all that sets and surfaces name of them."""
        # a node that comes again is moved: of the reversed numbers the first of each counts
        numbers, last = np.unique(np.concatenate(self.numbers)[::-1], return_index=True)
        points = np.concatenate(self.points)[::-1][last]
        # kind, numbers, and nodes as rows of the points, of the elements of each type
        blocks = [
            (kind, elements, rows_of(nodes, numbers)[:, _ORDER.get(kind, slice(None))])
            for name, elements, nodes, _ in self.elements
            if (kind := _kind(name))
        ]
        types = {name for name, *_ in self.elements}
        used = sorted(name for name in types if _kind(name) is not None)
        left = sorted(name or "without a type" for name in types if _kind(name) is None)
        notes = [f"elements of the types {', '.join(used)}", *self.notes]
        if left:
            notes.append(f"left out: elements of the types {', '.join(left)}")
        if self.not_read:
            notes.append(f"not read: {', '.join(self.not_read)}")
        dim = max((dimension(kind) for kind, *_ in blocks), default=0)
        if dim < 2:
            raise ValueError(
                f"it holds elements of the types {', '.join(used + left) or 'none'}; solid or plane ones "
                "are needed (C3D8, C3D10, CPE4, CPS6, CAX8, ...)"
            )
        contents = Contents(
            points,
            [(kind, nodes) for kind, _, nodes in blocks],
            notes=notes,
            surfaces=self.nodal,
        )
        for name, members in self.sets["NSET"].items():
            contents.node_sets[self._spelt(name)] = np.flatnonzero(
                np.isin(numbers, np.concatenate(members))
            )
        self._add_sets(contents, blocks)
        self._add_surfaces(contents, [block for block in blocks if dimension(block[0]) == dim])
        return contents

    def _add_sets(self, contents: Contents, blocks: list[_NumberedCells]) -> None:
        """Add the sets of elements to the contents, and say which of them are bodies."""
        for name, members in self._groups().items():
            contents.sets[self._spelt(name)] = [
                (k, np.flatnonzero(np.isin(elements, members)))
                for k, (_, elements, _) in enumerate(blocks)
            ]
        # bodies are the sets that have a section, else those that lines *ELEMENT name. In these Gmsh
        # writes the entities of its geometry: without sections all of its sets may be bodies
        if self.sections or not self.of_gmsh:
            bodies = self.sections or [elset for *_, elset in self.elements]
            contents.bodies = [self._spelt(name) for name in bodies]

    def _add_surfaces(self, contents: Contents, solid: list[_NumberedCells]) -> None:
        """Add the surfaces to the contents as sets of faces, which become further blocks of cells."""
        for name, members in self.surfaces.items():
            faces = [face for selected, facet in members for face in _faces(solid, selected, facet)]
            rows = contents.sets.setdefault(self._spelt(name), [])
            rows += [
                (len(contents.cells) + k, np.arange(len(nodes)))
                for k, (_, nodes) in enumerate(faces)
            ]
            contents.cells += faces


_READERS = {
    "NODE": _Deck._nodes,
    "ELEMENT": _Deck._elements,
    "NSET": _Deck._set,
    "ELSET": _Deck._set,
    "SURFACE": _Deck._surface,
    "SOLID SECTION": _Deck._section,
    "MATERIAL": _Deck._named,
    "SURFACE INTERACTION": _Deck._named,
    "ELASTIC": _Deck._constants,
    "FRICTION": _Deck._constants,
    "CONTACT PAIR": _Deck._pair,
}


def read_deck(path: Path) -> Contents:
    """Return the contents of a deck."""
    deck = _Deck()
    deck.read_file(path)
    return deck.contents()


def _number(word: str) -> float:
    """Return a number as Fortran writes it; 0 where it is left out."""
    return float(word.upper().replace("D", "E") or 0)


def _counted(numbers: np.ndarray) -> np.ndarray:
    """Return numbers of nodes or elements, an array of any shape, as integers; ValueError for others."""
    if not ((numbers >= 0) & (numbers < _MOST_NUMBER) & (numbers == np.floor(numbers))).all():
        raise ValueError(f"nodes and elements are numbered from 1 to {_MOST_NUMBER - 1}")
    return numbers.astype(np.int64)


def _kind(name: str) -> str | None:
    """Return the kind of cell of an element type; None of a type that is not read."""
    for pattern, kinds in _TYPES:
        if match := pattern.match(name):
            return kinds.get(int(match[1]))
    return None


def _faces(
    solid: list[_NumberedCells], members: np.ndarray, facet: int
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield kind and nodes (m, k) of facet ``facet``, from 1 on, of the elements of the blocks ``solid`` that
    are among the numbers ``members``, or of all their facets if it is 0."""
    for kind, elements, nodes in solid:
        rows = nodes[np.isin(elements, members)]
        facets = facets_of(kind)
        if len(rows) and facet > len(facets):
            raise ValueError(
                f"a surface names the face S{facet} of {KINDS[kind][1]}-node elements, which have "
                f"{len(facets)}"
            )
        for facet_kind, local in (
            (facets if facet == 0 else facets[facet - 1 : facet]) if len(rows) else ()
        ):
            yield facet_kind, rows[:, local]
