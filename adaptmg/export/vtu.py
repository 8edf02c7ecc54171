"""vtk, vtk_series: results as VTK unstructured grids (.vtu, XML with raw appended data), for ParaView and others.

SI units; vectors have three components, z = 0 in 2D. No value is NaN.

Point data: ``displacement`` m, ``reaction`` N (2D: N/m); at contact nodes ``contact_pressure`` Pa, ``contact_traction``
Pa (the tangential traction on the body), ``contact_gap`` m, ``contact_slip`` m, 0 elsewhere; ``contact_mask`` is 1 at
contact nodes, where ``contact_state`` (0 open, 1 slip, 2 stick) and ``contact_pair`` are not -1. Between two bodies the
contact nodes are those of the slave surface, gap and slip relative to the master.

Cell data: ``body``, and with materials ``stress`` (xx, yy, zz, xy, yz, xz; axisymmetric: x = r, y axial, zz the hoop
stress) and ``von_mises``, Pa, constant in each cell.

Field data: ``body:NAME`` and ``contact:NAME`` (of a pair ``contact:SLAVE|MASTER``) hold the index of each body and
contact boundary: not all readers know the strings of VTK. Control characters in names are written as codes (\\x01).
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
import struct
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import make_folder, read_bytes, waiting_folder, write_bytes
from adaptmg._text import printable
from adaptmg.discrete.coordinates import from_frames
from adaptmg.solver.result import Result

_TYPES = {"float64": "Float64", "int64": "Int64", "int32": "Int32", "uint8": "UInt8", "int8": "Int8"}
#: VTK's codes of triangles and tetrahedra by dimension
_CELLS = {2: 5, 3: 10}
_STAMP = re.compile(rb"<!-- adaptmg ([0-9a-f]{64}) -->\n\Z")


def vtk(result: Result, path: str | os.PathLike[str]) -> None:
    """Write a result with a mesh to a ``.vtu`` file, which appears complete or not at all; see the module.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> am.export.vtk(result, "bar.vtu")                               # opens in ParaView
    """
    target = checks.file_path("path", path)
    if target.suffix != ".vtu":
        raise ValueError(f"path must end in .vtu, got {os.fspath(path)!r}")
    write_bytes(target, _document(result))


def vtk_series(results: Sequence[Result], path: str | os.PathLike[str], times: Sequence[float] | None = None
               ) -> Path:
    """Write a sequence of results as a ParaView collection: a .vtu file a step and a .pvd file that lists them.

    Parameters
    ----------
    results : sequence of Result
        With meshes, one a step.
    path : path
        The ``.pvd`` file, which is returned. Its folder is made where it is missing. The steps lie next to it
        (``run_0000.vtu``, ...), in place of those of an older series, but of no other files. It is written last, so
        that all it lists is there.
    times : sequence of float, optional
        Strictly increasing; default 0, 1, 2, ...

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> steps = am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0]}))
    >>> am.export.vtk_series(list(steps), "bar.pvd").name
    'bar.pvd'
    """
    results = list(results)
    if not results:
        raise ValueError("results is empty: a series needs at least one step")
    times = np.arange(len(results), dtype=float) if times is None else checks.vector("times", times)
    if len(times) != len(results):
        raise ValueError(f"times must have one value a result: {len(results)} results, {len(times)} times")
    if (np.diff(times) <= 0).any():
        raise ValueError(f"times must increase strictly, got {times.tolist()}: give pseudo-times, or leave times out")
    target = checks.file_path("path", path)
    if target.suffix != ".pvd":
        raise ValueError(f"path must end in .pvd, got {os.fspath(path)!r}")
    with suppress(FileNotFoundError):
        # a circle of links raises here
        if stat.S_ISDIR(target.stat().st_mode):
            raise IsADirectoryError(f"path must be a .pvd file, but {str(target)!r} is a folder")
    names = [f"{target.stem}_{k:04d}.vtu" for k in range(len(results))]
    for name in names:
        if os.path.lexists(target.parent / name) and not _is_stamped(target.parent / name):
            raise FileExistsError(f"path: {str(target.parent / name)!r} is not an unchanged file of adaptmg.export: "
                                  "move it, or give another name")
    make_folder("path", target.parent)
    with waiting_folder(target.parent) as waiting:
        for name, result in zip(names, results, strict=True):
            write_bytes(waiting / name, _document(result))
        # a link stays, and the file it leads to is written again
        Path(os.path.realpath(target)).unlink(missing_ok=True)
        for name in names:
            os.replace(waiting / name, target.parent / name)
    write_bytes(target, _collection(names, times))
    return target


def _stamped(content: bytes) -> bytes:
    """Return an XML document with a comment at its end by which :func:`_is_stamped` recognises it."""
    return content + b"<!-- adaptmg %s -->\n" % hashlib.sha256(content).hexdigest().encode()


def _is_stamped(path: Path) -> bool:
    """Whether a file is one that was written with :func:`_stamped`, and has not changed since."""
    content = read_bytes(path)
    stamp = _STAMP.search(content, max(0, len(content) - 100))
    return stamp is not None and hashlib.sha256(content[:stamp.start()]).hexdigest().encode() == stamp[1]


def _collection(names: Sequence[str], times: np.ndarray) -> bytes:
    lines = [f'<DataSet timestep="{float(time)!r}" part="0" file={quoteattr(printable(name))}/>'
             for name, time in zip(names, times, strict=True)]
    return "\n".join(['<?xml version="1.0"?>', '<VTKFile type="Collection" version="1.0">', "<Collection>", *lines,
                      "</Collection>", "</VTKFile>", ""]).encode()


def _document(result: Result) -> bytes:
    """The whole file."""
    mesh = checks.instance("result", result, Result).mesh
    elements = np.ascontiguousarray(mesh.elements, dtype=np.int64)
    cells: dict[str, np.ndarray] = {"body": mesh.element_body}
    if result.stress_data is not None:
        cells |= {"stress": result.stress(), "von_mises": result.von_mises()}
    sections = {
        "FieldData": _field_data(result),
        "PointData": {"displacement": _three(result.displacement), "reaction": _three(result.reaction)}
        | _contact_data(result),
        "CellData": cells,
        "Points": {"points": _three(mesh.points)},
        "Cells": {"connectivity": elements.reshape(-1),
                  "offsets": np.arange(1, len(elements) + 1, dtype=np.int64) * elements.shape[1],
                  "types": np.full(len(elements), _CELLS[mesh.dim], dtype=np.uint8)},
    }
    order = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
    head = ['<?xml version="1.0"?>',
            f'<VTKFile type="UnstructuredGrid" version="1.0" byte_order="{order}" header_type="UInt64">',
            "<UnstructuredGrid>"]
    blocks, offset = [], 0
    for tag, arrays in sections.items():
        head.append(f"<{tag}>")
        for name, array in arrays.items():
            counts = f' NumberOfTuples="{len(array)}"' if tag == "FieldData" else ""
            counts += f' NumberOfComponents="{array.shape[1]}"' if array.ndim == 2 else ""
            head.append(f'<DataArray type="{_TYPES[array.dtype.name]}" Name={quoteattr(printable(name))}{counts} '
                        f'format="appended" offset="{offset}"/>')
            data = np.ascontiguousarray(array).tobytes()
            blocks.append(struct.pack("=Q", len(data)) + data)
            offset += len(blocks[-1])
        head.append(f"</{tag}>")
        if tag == "FieldData":
            head.append(f'<Piece NumberOfPoints="{mesh.n_nodes}" NumberOfCells="{len(elements)}">')
    head += ["</Piece>", "</UnstructuredGrid>", '<AppendedData encoding="raw">', "_"]
    return _stamped("\n".join(head).encode() + b"".join(blocks) + b"\n</AppendedData>\n</VTKFile>\n")


def _field_data(result: Result) -> dict[str, np.ndarray]:
    contact = result.contact
    names = {f"body:{name}": k for k, name in enumerate(result.mesh.bodies)}
    names |= {f"contact:{slave}|{master}" if master else f"contact:{slave}": k
              for k, (slave, master) in enumerate(zip(contact.names, contact.masters, strict=True))}
    return {name: np.array([k], dtype=np.int32) for name, k in names.items()}


def _contact_data(result: Result) -> dict[str, np.ndarray]:
    contact, n = result.contact, len(result.displacement)

    def spread(values: np.ndarray, elsewhere: float = 0.0) -> np.ndarray:
        full = np.full((n, *values.shape[1:]), elsewhere, dtype=values.dtype)
        full[contact.node] = values
        return full

    def tangential(values: np.ndarray) -> np.ndarray:
        return spread(_three(from_frames(contact.frames[:, 1:], values)))

    return {"contact_pressure": spread(contact.pressure), "contact_traction": tangential(contact.traction),
            "contact_gap": spread(contact.gap), "contact_slip": tangential(contact.slip),
            "contact_state": spread(np.asarray(contact.state, dtype=np.int8), -1),
            "contact_pair": spread(np.asarray(contact.boundary, dtype=np.int32), -1),
            "contact_mask": spread(np.ones(len(contact), dtype=np.uint8))}


def _three(vectors: np.ndarray) -> np.ndarray:
    """Vectors (n, 2) or (n, 3) with three components."""
    return np.pad(vectors, ((0, 0), (0, 3 - vectors.shape[1])))
