"""The file of a result: an ``.npz`` archive of arrays, one of which is JSON text; no pickle.

The text has a hash of all that was written, so that damage and changes are recognised. The unpacked size is checked
before anything is unpacked (a small archive may declare terabytes), and node numbers, which compiled code follows
wherever they point. The history of a bisected mesh (``mesh.refinement``) is not part of the file.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, Protocol

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import write_bytes
from adaptmg._text import printable
from adaptmg.discrete.stress import StressData
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.solver.certificate import Certificate
from adaptmg.solver.contact_result import ContactResult
from adaptmg.solver.record import Status

Arrays = dict[str, np.ndarray]

_FORMAT = 2
#: fields of a Result in the JSON text, names of boundaries and bodies there, and the fields that are arrays
_TEXT = ("problem_name", "solver_name", "fallback", "cycles", "work_units", "residual", "rtol", "error_estimate",
         "rate", "start_work_units", "timings", "path", "levels", "versions", "supports", "choice", "springs")
_LABELS = {"names": "contact", "masters": "contact", "boundaries": "mesh", "bodies": "mesh"}
_ARRAYS = ("displacement", "reaction", *(f"{group}.{name}" for group, names in (
    ("contact", "node x frames gap u_n u_t slip force_n force_t weights limit state boundary master_node master_force "
                "master_boundary"),
    ("mesh", "points elements facets facet_labels element_body"),
    ("stress", "lame shear kind initial_strain")) for name in names.split()))
#: a result has about 40 arrays; its displacements hardly shrink, so that the whole shrinks some ten times at most
_MOST_ARRAYS, _MOST_SHRINKING, _SMALL = 10_000, 200, 64 * 2**20
#: what damaged archives, arrays and JSON make zipfile, numpy and json raise
_DAMAGES = (ValueError, TypeError, KeyError, IndexError, EOFError, OSError, OverflowError, RuntimeError, MemoryError,
            SyntaxError, AttributeError, zipfile.BadZipFile, zlib.error, struct.error)


class Saved(Protocol):
    """What is written of a :class:`adaptmg.Result`, next to the fields in ``_TEXT``."""

    displacement: np.ndarray
    reaction: np.ndarray
    contact: ContactResult
    status: Status
    history: dict[str, np.ndarray]
    mesh: MeshArrays | None
    stress_data: StressData | None
    checked: Certificate | None


def write_result(path: str | os.PathLike[str], result: Saved, part_of: Mapping[str, object] | None = None,
                 more: Mapping[str, np.ndarray] | None = None) -> None:
    """Write a result, whole or not at all; a step of a store says in ``part_of`` what it belongs to."""
    target = checks.file_path("path", path)
    groups = {"": result, "contact": result.contact, "mesh": getattr(result, "mesh", None),
              "stress": result.stress_data}
    places = [(name, *name.rpartition(".")[::2]) for name in _ARRAYS]
    arrays = {name: getattr(groups[group], field) for name, group, field in places if groups[group] is not None}
    arrays |= {f"history.{name}": values for name, values in result.history.items()}
    arrays |= {f"more.{name}": values for name, values in (more or {}).items()}
    numbers = {name: np.asarray(values) for name, values in arrays.items()}
    for name, array in numbers.items():
        if array.dtype.kind not in "biuf":
            raise TypeError(f"result.{name} must be an array of numbers to be saved, got an array of {array.dtype}")
        numbers[name] = array.astype(array.dtype.newbyteorder("="), copy=False)
    text = {"format": _FORMAT, "status": result.status.name} | {name: getattr(result, name) for name in _TEXT}
    text |= {"checked": None if result.checked is None else result.checked.as_dict()}
    text |= {name: getattr(groups[of], name) for name, of in _LABELS.items() if groups[of] is not None}
    text |= {} if part_of is None else {"part_of": part_of}
    text = _plain("result", text)
    buffer = io.BytesIO()
    meta = json.dumps(text | {"hash": _hash(text, numbers)}).encode()
    np.savez_compressed(buffer, **numbers, meta=np.frombuffer(meta, dtype=np.uint8))
    write_bytes(target, buffer.getvalue())


def _hash(text: Mapping[str, object], arrays: Arrays) -> str:
    """The hash of a text and of arrays, with their kinds and shapes."""
    content = hashlib.sha256(json.dumps(text, sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        content.update(f"{name} {array.dtype.kind}{array.dtype.itemsize} {array.shape}".encode())
        content.update(np.ascontiguousarray(array))
    return content.hexdigest()


def _plain(name: str, value: object) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, Mapping):
        return {str(key): _plain(f"{name}.{key}", part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(f"{name}[{k}]", part) for k, part in enumerate(value)]
    if value is None or isinstance(value, bool | int | float | str):
        return value
    raise TypeError(f"{name} must be a number, text, or a list or dict of these to be saved, "
                    f"got {checks.described(value)}")


@contextmanager
def damage(file: Path) -> Iterator[None]:
    """Turn what damaged content raises into one ValueError that names the file."""
    try:
        yield
    except _DAMAGES as error:
        what = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else error or type(error).__name__
        raise ValueError(f"{printable(os.fspath(file))} is damaged: {what}") from error


def read_result(path: str | os.PathLike[str]) -> tuple[dict[str, Any], dict[str, Any], Arrays]:
    """Return the fields of a Result, what it is a part of, and the further arrays that were written with it."""
    file = checks.file_path("path", path)
    arrays = read_arrays(file)
    if "meta" not in arrays:
        raise ValueError(f"{printable(os.fspath(file))} is not a result saved by adaptmg")
    with damage(file):
        text = json.loads(arrays.pop("meta").tobytes())
        if text["format"] == _FORMAT:
            if text.pop("hash") != _hash(text, arrays):
                raise ValueError("its content is not what was written")
            more = {name.removeprefix("more."): values for name, values in arrays.items() if name.startswith("more.")}
            return _fields(text, arrays), text.get("part_of", {}), more
    raise ValueError(f"{printable(os.fspath(file))} was saved by another version of adaptmg; solve again")


def read_arrays(path: Path) -> Arrays:
    """Return the arrays of an ``.npz`` file by name; numbers only, nothing is unpickled."""
    if path.exists() and not path.is_file():
        raise ValueError(f"{printable(os.fspath(path))} must be a file, not a folder, device or pipe")
    with path.open("rb") as file, damage(path):
        _check_sizes(file)
        with np.load(file, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        for name, array in arrays.items():
            if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
                raise ValueError(f"{checks.shown(name)} is not an array of numbers")
            arrays[name] = array.astype(array.dtype.newbyteorder("="), copy=False)
        return arrays


def _check_sizes(file: BinaryIO) -> None:
    with zipfile.ZipFile(file) as archive:
        listed = archive.infolist()
    size, unpacked = os.fstat(file.fileno()).st_size, sum(entry.file_size for entry in listed)
    if len(listed) > _MOST_ARRAYS or len({entry.filename for entry in listed}) < len(listed):
        raise ValueError(f"it lists {len(listed)} arrays, some of them twice or more than {_MOST_ARRAYS}")
    if unpacked > max(_SMALL, _MOST_SHRINKING * size):
        raise ValueError(f"{size} bytes would unpack to {unpacked}: that is not a result")
    checks.fits("its arrays", unpacked, "unpacked they")
    file.seek(0)


def _fields(text: dict[str, Any], arrays: Arrays) -> dict[str, Any]:
    """The fields of a Result."""
    objects: dict[str, Any] = {}
    for group, kind in (("", dict), ("contact", ContactResult), ("mesh", MeshArrays), ("stress", StressData)):
        own = {name.rpartition(".")[2]: arrays[name] for name in _ARRAYS
               if name in arrays and name.rpartition(".")[0] == group}
        own |= {name: tuple(text[name]) for name, of in _LABELS.items() if of == group and name in text}
        objects[group] = kind(**own) if own else None
    mesh, stress = objects["mesh"], objects["stress"]
    for nodes in () if mesh is None else (mesh.elements, mesh.facets):
        if nodes.size and not 0 <= nodes.min() <= nodes.max() < mesh.n_nodes:
            raise ValueError(f"the mesh has nodes {nodes.min()} to {nodes.max()}, outside 0 to {mesh.n_nodes - 1}")
    contact = replace(objects["contact"], axisymmetric=stress is not None and stress.axisymmetric)
    checked = None if text["checked"] is None else Certificate.from_dict(text["checked"])
    return {name: text[name] for name in _TEXT} | objects[""] | {
        "status": Status[text["status"]], "checked": checked, "path": [tuple(entry) for entry in text["path"]],
        "contact": contact, "mesh": mesh, "stress_data": stress,
        "history": {name.removeprefix("history."): a for name, a in arrays.items() if name.startswith("history.")}}
