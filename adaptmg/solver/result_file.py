"""The file of a result: an ``.npz`` archive of arrays, one of which is JSON text; no pickle.

What is read is checked as if a stranger had written it: kinds and shapes against each other, numbers of nodes and
boundaries against what they point into, and the unpacked size before anything is unpacked (a small archive may declare
terabytes). The history of a bisected mesh (``mesh.refinement``) is not part of the file.
"""

from __future__ import annotations

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

_FORMAT = 1
#: fields of a Result in the JSON text by kind: a type, [of entries], {str: of values} or a tuple; of them optional ones
_TEXT: dict[str, object] = {
    "problem_name": str, "solver_name": str, "fallback": str, "cycles": int, "work_units": float, "residual": float,
    "rtol": float, "error_estimate": float, "rate": float, "start_work_units": float, "timings": {str: float},
    "path": [(int, str, int)], "levels": [{str: float}], "versions": {str: str}, "supports": {str: str},
    "choice": str, "springs": {str: [float]}}
_LABELS = {"names": "contact", "masters": "contact", "boundaries": "mesh", "bodies": "mesh"}
#: shapes of the arrays, a letter for each length: p nodes, d components, t tangents, n contact nodes, m nodes that
#: follow, e elements of c corners, f facets, b bodies, s initial strains
_SHAPES = {"displacement": "pd", "reaction": "pd", "contact.node": "n", "contact.x": "nd", "contact.frames": "ndd",
           "contact.gap": "n", "contact.u_n": "n", "contact.u_t": "nt", "contact.slip": "nt", "contact.force_n": "n",
           "contact.force_t": "nt", "contact.weights": "n", "contact.limit": "n", "contact.state": "n",
           "contact.boundary": "n", "contact.master_node": "m", "contact.master_force": "md",
           "contact.master_boundary": "m", "mesh.points": "pd", "mesh.elements": "ec", "mesh.facets": "fd",
           "mesh.facet_labels": "f", "mesh.element_body": "e", "stress.lame": "b", "stress.shear": "b",
           "stress.kind": "b", "stress.initial_strain": "s3"}
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
    groups = {"contact": result.contact, "mesh": getattr(result, "mesh", None), "stress": result.stress_data}
    arrays = {}
    for name in _SHAPES:
        group, _, field = name.rpartition(".")
        owner = groups.get(group, result)
        if owner is not None:
            arrays[name] = getattr(owner, field)
    arrays |= {f"history.{name}": values for name, values in result.history.items()}
    arrays |= {f"more.{name}": values for name, values in (more or {}).items()}
    numbers = {name: np.asarray(values) for name, values in arrays.items()}
    for name, array in numbers.items():
        if array.dtype.kind not in "biuf":
            raise TypeError(f"result.{name} must be an array of numbers to be saved, got an array of {array.dtype}")
    text = {"format": _FORMAT, "status": result.status.name} | {name: getattr(result, name) for name in _TEXT}
    text |= {"checked": None if result.checked is None else result.checked.as_dict()}
    text |= {name: getattr(groups[of], name) for name, of in _LABELS.items() if groups[of] is not None}
    text |= {} if part_of is None else {"part_of": part_of}
    buffer = io.BytesIO()
    meta = json.dumps(_plain("result", text)).encode()
    np.savez_compressed(buffer, **numbers, meta=np.frombuffer(meta, dtype=np.uint8))
    write_bytes(target, buffer.getvalue())


def _plain(name: str, value: object) -> object:
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
            more = {name.removeprefix("more."): values for name, values in arrays.items() if name.startswith("more.")}
            return _fields(text, arrays), checks.instance("part_of", text.get("part_of", {}), dict), more
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
    """The fields of a Result, all of them checked."""
    status = Status[checks.choice("status", text["status"], Status.__members__)]
    fields: dict[str, Any] = {"status": status, "checked": None}
    fields |= {name: _checked(name, text[name], kind) for name, kind in _TEXT.items()}
    if text.get("checked") is not None:
        fields["checked"] = Certificate.from_dict(checks.instance("checked", text["checked"], dict))
    found = {name.partition(".")[0] for name in arrays} | {"contact"}
    labels = {name: tuple(_checked(name, text[name], [str])) for name, of in _LABELS.items() if of in found}
    groups = _groups(arrays, found, labels, status.ok)
    columns = {name.removeprefix("history."): array for name, array in arrays.items() if name.startswith("history.")}
    if any(values.ndim != 1 for values in columns.values()) or len({len(v) for v in columns.values()}) > 1:
        raise ValueError("the columns of history differ in length")
    objects: dict[str, Any] = {}
    for group, cls in (("contact", ContactResult), ("mesh", MeshArrays), ("stress", StressData)):
        own = {name: labels[name] for name, of in _LABELS.items() if of == group and of in found}
        objects[group] = cls(**groups[group], **own) if group in found else None
    if objects["stress"] is not None and objects["stress"].axisymmetric:
        objects["contact"] = replace(objects["contact"], axisymmetric=True)
    if labels["masters"] and len(labels["masters"]) != len(labels["names"]):
        raise ValueError(f"there are {len(labels['names'])} names and {len(labels['masters'])} masters")
    # later steps of a load path are kept without their mesh
    unknown = set(fields["supports"]) - set(labels["boundaries"]) if "mesh" in found else ()
    if unknown:
        raise ValueError(f"supports names boundaries that the mesh does not have: {checks.shown(sorted(unknown))}")
    return fields | groups[""] | {"contact": objects["contact"], "mesh": objects["mesh"], "history": columns,
                                  "stress_data": objects["stress"]}


def _groups(arrays: Arrays, found: set[str], labels: Mapping[str, tuple[str, ...]], finite: bool) -> dict[str, Arrays]:
    """The arrays by group and name; their kinds, lengths and what they point to are checked."""
    nodes, dim = arrays["displacement"].shape
    if dim not in (2, 3):
        raise ValueError(f"displacement has {dim} components")
    lengths = {"p": nodes, "d": dim, "t": dim - 1, "c": dim + 1, "3": 3}
    pairs, boundaries, bodies = (len(labels.get(name, ())) for name in ("names", "boundaries", "bodies"))
    # integers, and below which number they must be
    ends = {"contact.node": nodes, "contact.master_node": nodes, "mesh.elements": nodes, "mesh.facets": nodes,
            "contact.boundary": pairs, "contact.master_boundary": pairs, "contact.state": 3, "stress.kind": 3,
            "mesh.facet_labels": boundaries, "mesh.element_body": bodies}
    groups: dict[str, Arrays] = {"": {}, "contact": {}, "mesh": {}, "stress": {}}
    for name, letters in _SHAPES.items():
        group, _, field = name.rpartition(".")
        if group and group not in found:
            continue
        array = groups[group][field] = arrays[name]
        if array.dtype.kind not in "iu" if name in ends else array.dtype != np.float64:
            raise ValueError(f"{name} must hold {'integers' if name in ends else 'float64'}, got {array.dtype}")
        if array.ndim != len(letters) or any(lengths.setdefault(letter, length) != length
                                             for letter, length in zip(letters, array.shape, strict=True)):
            raise ValueError(f"{name} must have shape ({', '.join(str(lengths.get(c, c)) for c in letters)}), "
                             f"got {array.shape}")
        if name in ends and array.size and not 0 <= int(array.min()) <= int(array.max()) < ends[name]:
            raise ValueError(f"{name} points to {array.min()} to {array.max()}, outside 0 to {ends[name] - 1}")
        # positions are NaN where the problem has no coordinates
        if name not in ends and (finite or group in ("mesh", "stress")) and name != "contact.x" \
                and not np.isfinite(array).all():
            raise ValueError(f"{name} is not finite")
    return groups


def _checked(name: str, value: object, kind: object) -> Any:
    if isinstance(kind, dict):
        items = checks.instance(name, value, dict).items()
        return {key: _checked(f"{name}.{key}", part, kind[str]) for key, part in items}
    if isinstance(kind, list | tuple):
        parts = checks.instance(name, value, list)
        kinds = kind if isinstance(kind, tuple) else kind * len(parts)
        if len(parts) != len(kinds):
            raise ValueError(f"{name} must have {len(kinds)} entries, got {checks.shown(value)}")
        return type(kind)(_checked(f"{name}[{k}]", *pair) for k, pair in enumerate(zip(parts, kinds, strict=True)))
    if kind is int:
        return checks.integer(name, value)
    if type(value) not in ((int, float) if kind is float else (kind,)):
        raise TypeError(f"{name} must be {'a number' if kind is float else 'text'}, got {checks.shown(value)}")
    return value
