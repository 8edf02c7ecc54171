"""from_netgen_file: Netgen's mesh files (.vol, .vol.gz), read here section by section.

Netgen's own reader follows damaged numbers wherever they point. Of a file we need a few sections only: a keyword, a
count, and that many lines; each count is held against the lines that follow, each node number against the points.
"""

from __future__ import annotations

import gzip
import re
import warnings
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.build import with_source
from adaptmg.mesh.checks.overlap import check_overlap
from adaptmg.mesh.files.normalise import normalised
from adaptmg.problem import checks

__all__ = ["from_netgen_file"]

_SURFACES = ("surfaceelements", "surfaceelementsgi", "surfaceelementsuv")
# keyword: columns of a line, and which of them are the nodes and the number of the boundary
_SEGMENTS = {"edgesegments": (4, slice(2, 4), 0), "edgesegmentsgi": (6, slice(2, 4), 0),
             "edgesegmentsgi2": (12, slice(2, 4), 0), "edgesegmentsgi3": (7, slice(0, 2), 6)}
# unpacked over packed size: meshes reach about 30
_MAX_PACKING = 200
_COUNT = re.compile(rb"\d{1,10}")


def from_netgen_file(path: Path) -> MeshArrays:
    """Read a mesh of Netgen.

    Parameters
    ----------
    path : Path
        A ``.vol`` or ``.vol.gz`` file of triangles in the plane or of tetrahedra. Of second-order elements the corners
        are read, curved ones become straight.

    Returns
    -------
    MeshArrays
        With its source, as of :func:`adaptmg.mesh.from_ngsolve`.

    Raises
    ------
    ValueError
        If it is damaged, cut off or another file, has other elements, or is not sound
        (:func:`adaptmg.mesh.check_mesh`).
    """
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
