"""The file of a result: an ``.npz`` archive of arrays, and one of them JSON text; no pickle.

Whatever is read is checked in full, as if a stranger had written it: shapes against each other, numbers of nodes and
boundaries against what they point into, names and states against what there is.

The history of a bisected mesh (``mesh.refinement``) is not kept: the mesh that is read is an initial mesh, which can be
bisected, but not coarsened. Whoever needs it keeps :func:`adaptmg.mesh.bisection.tables.history_arrays`.

Arrays of an ``.npz`` file, read by a stranger: what it declares is checked before anything is unpacked.

An ``.npz`` file is a zip archive of ``.npy`` files. A small one may declare terabytes (a zip bomb), in the directory of
the archive or in the headers of the arrays, so that both are read first, and held against each other.
"""

from __future__ import annotations

import ast
import io
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import write_bytes
from adaptmg._text import printable
from adaptmg.discrete.stress import StressData
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.solver.certificate import Certificate
from adaptmg.solver.contact_result import ContactResult
from adaptmg.solver.record import Status

__all__ = ["DAMAGES", "read_arrays", "read_result", "write_result"]

_FORMAT = 1
#: fields of a Result that go into the JSON text as they are, and what they are
_TEXTS = ("problem_name", "solver_name", "fallback")
_NUMBERS = ("work_units", "residual", "error_estimate", "rate", "rtol", "start_work_units")
#: fields of ContactResult: shapes in n contact nodes, d dimensions, t tangents, m nodes that follow
_CONTACT = {"node": "n", "x": "nd", "frames": "ndd", "gap": "n", "u_n": "n", "u_t": "nt", "slip": "nt", "force_n": "n",
            "force_t": "nt", "weights": "n", "limit": "n", "state": "n", "boundary": "n", "master_node": "m",
            "master_force": "md", "master_boundary": "m"}
_WHOLE = ("node", "state", "boundary", "master_node", "master_boundary")
_STRESS = ("lame", "shear", "kind", "initial_strain")
_MESH = ("points", "elements", "facets", "facet_labels", "element_body")


class Saved(Protocol):
    """What is written, see :class:`adaptmg.solver.result.Result`; and by name ``_TEXTS`` and ``_NUMBERS``."""

    displacement: np.ndarray
    reaction: np.ndarray
    contact: ContactResult
    status: Status
    history: dict[str, np.ndarray]
    mesh: MeshArrays | None
    stress_data: StressData | None
    checked: Certificate | None
    supports: dict[str, str]


def write_result(path: str | os.PathLike[str], result: Saved, part_of: Mapping[str, Any] | None = None) -> None:
    """Write a result, whole or not at all."""
    target = checks.file_path("path", path)
    arrays = {"displacement": result.displacement, "reaction": result.reaction}
    arrays |= {f"contact.{name}": getattr(result.contact, name) for name in _CONTACT}
    arrays |= {f"history.{name}": values for name, values in result.history.items()}
    if result.mesh is not None:
        arrays |= {f"mesh.{name}": getattr(result.mesh, name) for name in _MESH}
    if result.stress_data is not None:
        arrays |= {f"stress.{name}": getattr(result.stress_data, name) for name in _STRESS}
    meta = {"format": _FORMAT, **_said(result), **({} if part_of is None else {"part_of": dict(part_of)})}
    text = json.dumps(_plain("result", meta)).encode()
    numbers = {name: _numbers(name, values) for name, values in arrays.items()}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **numbers, meta=np.frombuffer(text, dtype=np.uint8))
    write_bytes(target, buffer.getvalue())


def read_result(path: str | os.PathLike[str]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Read what :func:`write_result` wrote."""
    file = checks.file_path("path", path)
    arrays = read_arrays(file)
    where = printable(os.fspath(file))
    if "meta" not in arrays:
        raise ValueError(f"{where} is not a result saved by adaptmg")
    try:
        meta = json.loads(arrays.pop("meta").tobytes())
        if meta["format"] == _FORMAT:
            return _fields(meta, arrays), checks.instance("part_of", meta.get("part_of", {}), dict)
    except DAMAGES as error:
        said = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else error or type(error).__name__
        raise ValueError(f"{where} is damaged: {said}") from error
    raise ValueError(f"{where} was saved by another version of adaptmg; solve again")


def _said(result: Saved) -> dict[str, Any]:
    """What goes into the JSON text."""
    names = (*_TEXTS, *_NUMBERS, "cycles", "timings", "path", "levels", "versions")
    meta = {name: getattr(result, name) for name in names}
    meta |= {"status": result.status.name, "names": result.contact.names, "masters": result.contact.masters,
             "checked": None if result.checked is None else result.checked.as_dict(), "supports": result.supports}
    if result.mesh is not None:
        meta |= {"boundaries": result.mesh.boundaries, "bodies": result.mesh.bodies}
    return meta


def _plain(name: str, value: Any) -> Any:
    """``value`` as JSON has it; numpy numbers, which one's own solver may leave, become Python's."""
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and value.ndim == 0):
        value = value.item()
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Mapping):
        return {str(_plain(f"a key of {name}", key)): _plain(f"{name}.{key}", part) for key, part in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(f"{name}[{k}]", part) for k, part in enumerate(value)]
    raise TypeError(f"{name} must be a number, text, or a list or dict of these to be saved, "
                    f"got {checks.described(value)}")


def _numbers(name: str, values: Any) -> np.ndarray:
    """An array that can be saved without pickle."""
    array = np.asarray(values)
    if array.dtype.kind not in "biuf":
        raise TypeError(f"result.{name} must be an array of numbers to be saved, got an array of {array.dtype}")
    return array


def _fields(meta: dict[str, Any], arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    """Fields of a Result, all of them checked."""
    status = checks.choice("status", meta["status"], Status.__members__)
    finite = Status[status].ok
    displacement = _sized("displacement", arrays, (None, None), finite)
    n, dim = displacement.shape
    if dim not in (2, 3):
        raise ValueError(f"displacement has {dim} components")
    fields = {"displacement": displacement, "reaction": _sized("reaction", arrays, (n, dim), finite),
              "status": Status[status], "cycles": checks.integer("cycles", meta["cycles"]),
              "contact": _contact(meta, arrays, n, dim, finite), "history": _history(arrays),
              "mesh": _mesh(meta, arrays, n, dim), "stress_data": _stress(arrays),
              "timings": _mapping("timings", meta["timings"], float),
              "path": [_visit(k, step) for k, step in enumerate(_list("path", meta["path"]))],
              "levels": [_mapping(f"levels[{k}]", row, float) for k, row in enumerate(_list("levels", meta["levels"]))],
              "versions": _mapping("versions", meta["versions"], str), "checked": None}
    if meta.get("checked") is not None:
        fields["checked"] = Certificate.from_dict(checks.instance("checked", meta["checked"], dict))
    # written later than the first files: those say nothing about supports
    fields["supports"] = _mapping("supports", meta.get("supports", {}), str)
    # later steps of a load path are kept without their mesh
    unknown = set() if fields["mesh"] is None else set(fields["supports"]) - set(fields["mesh"].boundaries)
    if unknown:
        raise ValueError(f"supports names boundaries that the mesh does not have: {checks.shown(sorted(unknown))}")
    fields |= {name: _number(name, meta[name]) for name in _NUMBERS}
    if "fallback" not in meta:  # the first files say it in the name of the solver
        solver, _, fallback = _text("solver_name", meta["solver_name"]).partition(", then ")
        meta = {**meta, "solver_name": solver, "fallback": fallback}
    return fields | {name: _text(name, meta[name]) for name in _TEXTS}


def _contact(meta: dict[str, Any], arrays: dict[str, np.ndarray], n_nodes: int, dim: int,
             finite: bool) -> dict[str, Any]:
    """Fields of a ContactResult."""
    names = tuple(_text("names", name) for name in _list("names", meta["names"]))
    masters = tuple(_text("masters", name) for name in _list("masters", meta["masters"]))
    if masters and len(masters) != len(names):
        raise ValueError(f"there are {len(names)} names and {len(masters)} masters")
    sizes = {"d": dim, "t": dim - 1} | {letter: len(arrays[f"contact.{of}"])
                                        for letter, of in (("n", "node"), ("m", "master_node"))}
    fields: dict[str, Any] = {"names": names, "masters": masters}
    for name, letters in _CONTACT.items():
        # positions are NaN where the problem has no coordinates
        fields[name] = _sized(f"contact.{name}", arrays, tuple(sizes[c] for c in letters), finite and name != "x",
                              whole=name in _WHOLE)
    for name, end in (("node", n_nodes), ("master_node", n_nodes), ("boundary", len(names)),
                      ("master_boundary", len(names)), ("state", 3)):
        _inside(f"contact.{name}", fields[name], end)
    return fields


def _history(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    history = {name.removeprefix("history."): values for name, values in arrays.items() if name.startswith("history.")}
    if any(values.ndim != 1 for values in history.values()) or len({len(v) for v in history.values()}) > 1:
        raise ValueError("the columns of history differ in length")
    return history


def _mesh(meta: dict[str, Any], arrays: dict[str, np.ndarray], n_nodes: int, dim: int) -> MeshArrays | None:
    if not any(name.startswith("mesh.") for name in arrays):
        return None
    labels = {key: tuple(_text(key, name) for name in _list(key, meta[key])) for key in ("boundaries", "bodies")}
    elements = _sized("mesh.elements", arrays, (None, dim + 1), whole=True)
    facets = _sized("mesh.facets", arrays, (None, dim), whole=True)
    of_facet = _sized("mesh.facet_labels", arrays, (len(facets),), whole=True)
    of_element = _sized("mesh.element_body", arrays, (len(elements),), whole=True)
    whole = {"elements": (elements, n_nodes), "facets": (facets, n_nodes),
             "facet_labels": (of_facet, len(labels["boundaries"])), "element_body": (of_element, len(labels["bodies"]))}
    for name, (numbers, end) in whole.items():
        _inside(f"mesh.{name}", numbers, end)
    return MeshArrays(_sized("mesh.points", arrays, (n_nodes, dim), True), **{k: v for k, (v, _) in whole.items()},
                      **labels)


def _stress(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray] | None:
    """Fields of a StressData."""
    if not any(name.startswith("stress.") for name in arrays):
        return None
    kind = _sized("stress.kind", arrays, (None,), whole=True)
    _inside("stress.kind", kind, 3)
    return {"kind": kind, "lame": _sized("stress.lame", arrays, kind.shape, True),
            "shear": _sized("stress.shear", arrays, kind.shape, True),
            "initial_strain": _sized("stress.initial_strain", arrays, (None, 3), True)}


def _sized(name: str, arrays: dict[str, np.ndarray], shape: tuple[int | None, ...], finite: bool = False,
           whole: bool = False) -> np.ndarray:
    """An array of a shape; of float64 or, where ``whole``, of integers."""
    array = arrays[name]
    if array.dtype.kind not in "iu" if whole else array.dtype != np.float64:
        raise ValueError(f"{name} must be an array of {'integers' if whole else 'float64'}, got {array.dtype}")
    if array.ndim != len(shape) or any(w is not None and w != g for w, g in zip(shape, array.shape, strict=True)):
        raise ValueError(f"{name} must have shape ({', '.join('n' if w is None else str(w) for w in shape)}), "
                         f"got {array.shape}")
    if finite and not np.isfinite(array).all():
        raise ValueError(f"{name} is not finite")
    return array


def _inside(name: str, numbers: np.ndarray, end: int) -> None:
    if numbers.size and (int(numbers.min()) < 0 or int(numbers.max()) >= end):
        wrong = int(numbers.min()) if int(numbers.min()) < 0 else int(numbers.max())
        raise ValueError(f"{name} points to {wrong}, outside 0 to {end - 1}")


def _list(name: str, value: Any) -> list[Any]:
    return checks.instance(name, value, list)


def _text(name: str, value: Any) -> str:
    return checks.instance(name, value, str, "text")


def _number(name: str, value: Any) -> float:
    """A number, NaN and the infinities too."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError(f"{name} must be a number, got {checks.shown(value)}")
    return value


def _mapping(name: str, value: Any, kind: type) -> dict[str, Any]:
    one = _text if kind is str else _number
    return {key: one(f"{name}.{key}", part) for key, part in checks.instance(name, value, dict).items()}


def _visit(k: int, step: Any) -> tuple[int, str, int]:
    if not isinstance(step, list) or [type(part) for part in step] != [int, str, int]:
        raise TypeError(f"path[{k}] must be level, action and times, got {checks.shown(step)}")
    return (step[0], step[1], step[2])


#: what broken archives, arrays and JSON make numpy, zipfile and json raise
DAMAGES = (ValueError, TypeError, KeyError, IndexError, EOFError, OverflowError, NotImplementedError, RuntimeError,
           RecursionError, MemoryError, SyntaxError, AttributeError, zipfile.BadZipFile, zlib.error, struct.error)

#: arrays in a file; a result has about 40
_MOST_ARRAYS = 10_000
#: displacements do not shrink, so that a whole result shrinks some ten times at most
_MOST_SHRINKING, _SMALL = 200, 64 * 2**20
_MAGIC, _HEADER_LIMIT = b"\x93NUMPY", 1000


@dataclass(frozen=True)
class _Header:
    """What a ``.npy`` file says of itself."""

    shape: tuple[int, ...]
    dtype: np.dtype
    fortran: bool
    length: int

    @property
    def size(self) -> int:
        """Bytes of the whole file; of Python's unbounded integers, so that nothing wraps."""
        size = self.length + self.dtype.itemsize
        if 0 in self.shape:
            return self.length
        for count in self.shape:
            size = self.length + (size - self.length) * count
        return size


def read_arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of an ``.npz`` file by name; numbers only, nothing is unpickled."""
    where = printable(os.fspath(path))
    if path.is_dir():
        raise ValueError(f"{where} is a folder, a file is wanted")
    if path.exists() and not path.is_file():
        raise ValueError(f"{where} is a device or a pipe, a file is wanted")
    with path.open("rb") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                entries = _entries(archive, os.fstat(file.fileno()).st_size)
                headers = {name: _header(archive, entry) for name, entry in entries.items()}
                return {name: _array(archive, entries[name], header) for name, header in headers.items()}
        except (*DAMAGES, OSError) as error:  # zipfile seeks where a cut archive tells it to
            raise ValueError(f"{where} is damaged, or no .npz file ({error or type(error).__name__})") from error


def _entries(archive: zipfile.ZipFile, size: int) -> dict[str, zipfile.ZipInfo]:
    """The entries by name of the array, their declared sizes checked."""
    listed = archive.infolist()
    if len(listed) > _MOST_ARRAYS:
        raise ValueError(f"it lists {len(listed)} arrays, at most {_MOST_ARRAYS} are read")
    entries = {entry.filename.removesuffix(".npy"): entry for entry in listed}
    if len(entries) < len(listed):
        raise ValueError("it lists an array twice")
    for entry in listed:
        if not entry.filename.endswith(".npy") or entry.flag_bits & 1:
            raise ValueError(f"{checks.shown(entry.filename)} is no plain array")
        if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise ValueError(f"{checks.shown(entry.filename)} is compressed in an unknown way")
    packed, unpacked = sum(e.compress_size for e in listed), sum(e.file_size for e in listed)
    if packed > size:
        raise ValueError(f"it lists {packed} bytes, but has {size}")
    if unpacked > _SMALL and unpacked > _MOST_SHRINKING * size:
        raise ValueError(f"{size} bytes would unpack to {unpacked}: that is no result")
    checks.fits("its arrays", unpacked, "unpacked they")
    return entries


def _header(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> _Header:
    """Header of an array, held against the size in the archive."""
    with archive.open(entry) as file:
        start = file.read(12)
        if start[:6] != _MAGIC or len(start) < 12 or start[6] not in (1, 2, 3):
            raise ValueError(f"{entry.filename} is no .npy file")
        prefix, length = (10, struct.unpack("<H", start[8:10])[0]) if start[6] == 1 else \
            (12, struct.unpack("<I", start[8:12])[0])
        if not 2 <= length <= _HEADER_LIMIT:
            raise ValueError(f"{entry.filename} has a header of {length} bytes")
        text = (start[prefix:] + file.read(length - (12 - prefix))).decode("utf-8" if start[6] == 3 else "latin-1")
    said = ast.literal_eval(text)
    if not isinstance(said, dict) or not isinstance(said["descr"], str) or type(said["fortran_order"]) is not bool \
            or not isinstance(said["shape"], tuple):
        raise ValueError(f"{entry.filename} has a header that says {checks.shown(said)}")
    shape = tuple(checks.integer(f"the shape of {entry.filename}", count) for count in said["shape"])
    dtype = np.dtype(said["descr"])
    if dtype.kind not in "biuf":
        raise ValueError(f"{entry.filename} holds {dtype}, no numbers")
    header = _Header(shape, dtype, said["fortran_order"], prefix + length)
    if header.size != entry.file_size:
        raise ValueError(f"{entry.filename} has {entry.file_size} bytes, its header says {header.size}")
    return header


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, header: _Header) -> np.ndarray:
    # reads to the end, so that zipfile compares the checksum
    flat = np.frombuffer(archive.read(entry), dtype=header.dtype, offset=header.length)
    # a copy, which can be written to
    flat = flat.astype(header.dtype.newbyteorder("="))
    return flat.reshape(header.shape, order="F" if header.fortran else "C")
