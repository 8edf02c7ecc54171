"""vtk: a result as a VTK unstructured grid (.vtu, XML with raw appended data), for ParaView and others.

Point data (three components where vectors, z = 0 in 2D; SI units): ``displacement`` m, ``reaction`` N (2D: N/m), and
of contact, NaN (``state`` -1) at every node that is no contact node: ``contact_pressure`` Pa, ``contact_traction`` Pa
(the tangential traction on the body as a vector), ``contact_gap`` m, ``contact_slip`` m (vector), ``contact_state``
(0 open, 1 slip, 2 stick). Cell data: ``body``, the index of the body.
"""

from __future__ import annotations

import os
import struct
import sys
from xml.sax.saxutils import quoteattr

import numpy as np

from adaptmg.atomic import write_bytes
from adaptmg.solver.result import Result

__all__ = ["vtk"]

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
        Without a mesh, or for another suffix (ParaView goes by it).
    """
    if not isinstance(result, Result):
        raise TypeError(f"result must be a Result, got {type(result).__name__}")
    if result.mesh is None:
        raise ValueError("this result has no mesh to write (it comes from a bare DiscreteProblem)")
    if not os.fspath(path).endswith(".vtu"):
        raise ValueError(f"path must end in .vtu, got {os.fspath(path)!r}")
    write_bytes(path, _document(result))


def _document(result: Result) -> bytes:
    mesh = result.mesh
    elements = np.ascontiguousarray(mesh.elements, dtype=np.int64)
    corners = elements.shape[1]
    kind = _TRIANGLE if mesh.dim == 2 else _TETRAHEDRON
    sections = {
        "PointData": _point_data(result),
        "CellData": {"body": mesh.element_body},
        "Points": {"points": _three(mesh.points)},
        "Cells": {"connectivity": elements.reshape(-1),
                  "offsets": np.arange(1, len(elements) + 1, dtype=np.int64) * corners,
                  "types": np.full(len(elements), kind, dtype=np.uint8)},
    }
    order = "LittleEndian" if sys.byteorder == "little" else "BigEndian"
    head = ['<?xml version="1.0"?>',
            f'<VTKFile type="UnstructuredGrid" version="1.0" byte_order="{order}" header_type="UInt64">',
            "<UnstructuredGrid>", f'<Piece NumberOfPoints="{mesh.n_nodes}" NumberOfCells="{len(elements)}">']
    blocks: list[bytes] = []
    for section, arrays in sections.items():
        head.append(f"<{section}>")
        for name, array in arrays.items():
            components = f' NumberOfComponents="{array.shape[1]}"' if array.ndim == 2 else ""
            head.append(f'<DataArray type="{_TYPES[array.dtype.name]}" Name={quoteattr(name)}{components} '
                        f'format="appended" offset="{sum(map(len, blocks))}"/>')
            data = np.ascontiguousarray(array).tobytes()
            blocks.append(struct.pack("=Q", len(data)) + data)
        head.append(f"</{section}>")
    head += ["</Piece>", "</UnstructuredGrid>", '<AppendedData encoding="raw">', "_"]
    return "\n".join(head).encode() + b"".join(blocks) + b"\n</AppendedData>\n</VTKFile>\n"


def _point_data(result: Result) -> dict[str, np.ndarray]:
    contact, n = result.contact, len(result.displacement)

    def spread(values: np.ndarray) -> np.ndarray:
        full = np.full((n, *values.shape[1:]), np.nan)
        full[contact.node] = values
        return full

    def tangential(values: np.ndarray) -> np.ndarray:
        return spread(_three(np.einsum("nk,nkd->nd", values, contact.frames[:, 1:])))

    state = np.full(n, -1, dtype=np.int8)
    state[contact.node] = contact.state
    return {"displacement": _three(result.displacement), "reaction": _three(result.reaction),
            "contact_pressure": spread(contact.pressure), "contact_traction": tangential(contact.traction),
            "contact_gap": spread(contact.gap), "contact_slip": tangential(contact.slip), "contact_state": state}


def _three(vectors: np.ndarray) -> np.ndarray:
    """Vectors (n, 2) or (n, 3) with three components."""
    full = np.zeros((len(vectors), 3))
    full[:, :vectors.shape[1]] = vectors
    return full
