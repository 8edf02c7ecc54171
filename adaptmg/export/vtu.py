"""vtk: a result as a VTK unstructured grid (.vtu, XML with raw appended data), for ParaView and others.

SI units; vectors have three components, z = 0 in 2D. No value is NaN.

Point data: ``displacement`` m, ``reaction`` N (2D: N/m); and of contact, 0 at every node that is no contact node,
``contact_pressure`` Pa, ``contact_traction`` Pa (the tangential traction on the body, a vector), ``contact_gap`` m,
``contact_slip`` m (a vector). ``contact_mask`` is 1 at contact nodes, 0 elsewhere; where it is 0, ``contact_state`` (0
open, 1 slip, 2 stick) and ``contact_pair`` (which contact boundary) are -1. Between two bodies the contact nodes are
those of the slave surface, gap and slip relative to the master.

Cell data: ``body``, the index of the body; and where the result knows its materials ``stress`` (a symmetric tensor: xx,
yy, zz, xy, yz, xz; axisymmetric: x = r, y axial, zz the hoop stress) and ``von_mises``, Pa, constant in each cell.

Field data: ``body:NAME`` and ``contact:NAME`` (of a pair ``contact:SLAVE|MASTER``) hold the index of each body and
contact boundary. Numbers, because not all readers know the strings of VTK. Control characters in names, which XML does
not allow, are written as codes such as \\x01.

vtk_series: results of load steps as a ParaView collection, a .vtu file a step and a .pvd file that lists them.
"""

from __future__ import annotations

import errno
import os
import stat
import struct
import sys
from collections.abc import Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._files import waiting_folder, write_bytes
from adaptmg._text import printable
from adaptmg.discrete.coordinates import from_frames
from adaptmg.solver.result import Result

__all__ = ["document", "vtk", "vtk_series"]


_TYPES = {"float64": "Float64", "int64": "Int64", "int32": "Int32", "uint8": "UInt8", "int8": "Int8"}
_TRIANGLE, _TETRAHEDRON = 5, 10


def vtk(result: Result, path: str | os.PathLike[str]) -> None:
    """Write the solution on the finest mesh for ParaView; see the module for the fields.

    Parameters
    ----------
    result : Result
        With a mesh.
    path : path
        Ends in ``.vtu``. The file appears complete or not at all.

    Raises
    ------
    ValueError
        Without a mesh or for another suffix (ParaView goes by it).
    """
    target = checks.file_path("path", path)
    if target.suffix != ".vtu":
        raise ValueError(f"path must end in .vtu, got {os.fspath(path)!r}")
    write_bytes(target, document(result))


def document(result: Result) -> bytes:
    """The whole file; arguments as of :func:`vtk`."""
    if not isinstance(result, Result):
        raise TypeError(f"result must be a Result, got {type(result).__name__}")
    if result.mesh is None:
        raise ValueError("this result has no mesh to write (it comes from a bare DiscreteProblem)")
    mesh = result.mesh
    elements = np.ascontiguousarray(mesh.elements, dtype=np.int64)
    corners = elements.shape[1]
    kind = _TRIANGLE if mesh.dim == 2 else _TETRAHEDRON
    known = result.stress_data is not None
    stresses = {"stress": result.stresses(), "von_mises": result.von_mises()} if known else {}
    piece = {
        "PointData": {"displacement": _three(result.displacement), "reaction": _three(result.reaction)}
        | _contact_data(result),
        "CellData": {"body": mesh.element_body} | stresses,
        "Points": {"points": _three(mesh.points)},
        "Cells": {"connectivity": elements.reshape(-1),
                  "offsets": np.arange(1, len(elements) + 1, dtype=np.int64) * corners,
                  "types": np.full(len(elements), kind, dtype=np.uint8)},
    }
    return _assemble(_field_data(result), piece, mesh.n_nodes, len(elements))


def _assemble(fields: dict[str, np.ndarray], piece: dict[str, dict[str, np.ndarray]], n_points: int,
              n_cells: int) -> bytes:
    """The XML head, and behind it all arrays, each after its length in bytes."""
    order = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
    head = ['<?xml version="1.0"?>',
            f'<VTKFile type="UnstructuredGrid" version="1.0" byte_order="{order}" header_type="UInt64">',
            "<UnstructuredGrid>"]
    blocks: list[bytes] = []

    def section(tag: str, arrays: dict[str, np.ndarray], field: bool = False) -> None:
        head.append(f"<{tag}>")
        for name, array in arrays.items():
            counts = f' NumberOfTuples="{len(array)}"' if field else ""
            counts += f' NumberOfComponents="{array.shape[1]}"' if array.ndim == 2 else ""
            called = quoteattr(printable(name))
            head.append(f'<DataArray type="{_TYPES[array.dtype.name]}" Name={called}{counts} '
                        f'format="appended" offset="{sum(map(len, blocks))}"/>')
            data = np.ascontiguousarray(array).tobytes()
            blocks.append(struct.pack("=Q", len(data)) + data)
        head.append(f"</{tag}>")

    section("FieldData", fields, field=True)
    head.append(f'<Piece NumberOfPoints="{n_points}" NumberOfCells="{n_cells}">')
    for tag, arrays in piece.items():
        section(tag, arrays)
    head += ["</Piece>", "</UnstructuredGrid>", '<AppendedData encoding="raw">', "_"]
    return "\n".join(head).encode() + b"".join(blocks) + b"\n</AppendedData>\n</VTKFile>\n"


def _field_data(result: Result) -> dict[str, np.ndarray]:
    """Index of each body and contact boundary, by name."""
    contact = result.contact
    masters = contact.masters or ("",) * len(contact.names)
    names = {f"body:{name}": k for k, name in enumerate(result.mesh.bodies)}
    names |= {f"contact:{slave}|{master}" if master else f"contact:{slave}": k
              for k, (slave, master) in enumerate(zip(contact.names, masters, strict=True))}
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
    full = np.zeros((len(vectors), 3))
    full[:, :vectors.shape[1]] = vectors
    return full


def vtk_series(results: Sequence[Result], path: str | os.PathLike[str], times: Sequence[float] | None = None
               ) -> Path:
    """Write a sequence of results for ParaView; see :mod:`adaptmg.export.vtu` for the fields.

    Parameters
    ----------
    results : sequence of Result
        With meshes, one a step.
    path : path
        The ``.pvd`` file, in a directory that exists; or a folder, made where it is missing (its parent exists), for a
        ``.pvd`` file of the folder's name. The steps lie beside the ``.pvd`` file: ``run_0000.vtu``, ... for
        ``run.pvd``. All steps are written before any is put in place, and the ``.pvd`` file comes last: where it is
        there, all it lists is there. An older one of the same name is removed before its steps are replaced.
    times : sequence of float, optional
        Strictly increasing; default 0, 1, 2, ... (load factors that fall are no times: give pseudo-times).

    Returns
    -------
    pathlib.Path
        The ``.pvd`` file: what to open.

    Raises
    ------
    ValueError
        For no results, times that do not increase, or whatever :func:`adaptmg.export.vtk` refuses in a step; nothing
        is written then.
    """
    results = list(results)
    if not results:
        raise ValueError("results is empty: a series needs at least one step")
    times = np.arange(len(results), dtype=float) if times is None else check_arrays.vector("times", times)
    if len(times) != len(results):
        raise ValueError(f"times must have one value a result: {len(results)} results, {len(times)} times")
    if (np.diff(times) <= 0).any():
        raise ValueError(f"times must increase strictly, got {times.tolist()}: for load factors that fall or stay give "
                         "pseudo-times, or leave times out")
    given = checks.file_path("path", path)
    target = _target(given)
    names = [f"{target.stem}_{k:04d}.vtu" for k in range(len(results))]
    _check_target(target)
    folder_is_new = target.parent == given and not target.parent.exists()
    if folder_is_new:
        target.parent.mkdir()
    try:
        with waiting_folder(target.parent) as waiting:
            for name, result in zip(names, results, strict=True):
                write_bytes(waiting / name, document(result))
            # of a link what it leads to: the new one is written through it
            if target.exists():
                Path(os.path.realpath(target)).unlink()
            for name in names:
                os.replace(waiting / name, target.parent / name)
        write_bytes(target, _collection(names, times))
    except BaseException:
        if folder_is_new and not any(target.parent.iterdir()):
            target.parent.rmdir()
        raise
    return target


def _target(path: Path) -> Path:
    """The .pvd file for a .pvd file or a folder."""
    if path.suffix == ".pvd":
        return path
    if path.suffix in (".vtu", ".vtk", ".xdmf") or path.is_file():
        raise ValueError(f"path must be a .pvd file or a folder, got {os.fspath(path)!r}")
    return path / f"{path.name}.pvd"


def _check_target(target: Path) -> None:
    """OSError for a path that can be no file, before any step is written."""
    try:
        there = target.stat()
    except FileNotFoundError:
        return
    if stat.S_ISDIR(there.st_mode):
        raise IsADirectoryError(errno.EISDIR, "this is a folder, give the name of a file", str(target))


def _collection(names: Sequence[str], times: np.ndarray) -> bytes:
    lines = ['<?xml version="1.0"?>', '<VTKFile type="Collection" version="1.0">', "<Collection>"]
    lines += [f'<DataSet timestep="{float(time)!r}" part="0" file={quoteattr(printable(name))}/>'
              for name, time in zip(names, times, strict=True)]
    return "\n".join([*lines, "</Collection>", "</VTKFile>", ""]).encode()
