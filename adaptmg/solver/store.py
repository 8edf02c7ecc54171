"""Objects in files, and the steps of a computation in a folder; what was killed goes on there.

A file is an ``.npz`` archive of arrays, one of which is JSON text; nothing is pickled. Dataclasses
of listed kinds are written field by field, what occurs twice once. The text has a hash of all that
was written, so that damage and changes are recognised. The unpacked size is checked before anything
is unpacked: a small archive may declare terabytes.

A :class:`StepStore` is a folder with a head (``path.json``, ``loop.json``), which states what the
steps belong to, and a file a step (``step_0003.npz``) with its number and the key of the head, a
hash of its content: files that were swapped, or come from another folder, are recognised. No step
that is there is written again or removed; of processes that write the same step at the same moment
the last one's file stays, which is as whole and holds the same step.

In a head a fingerprint identifies the computation. Of each array on the meshes it has the length,
the norm and the product with a fixed wave, compared to a relative 1e-8: another mesh, material,
load or law shows, the rounding of another machine does not. Objects are compared by value, with the
code of the user's functions and classes in them (:func:`adaptmg.solver.fingerprint.value_parts`).
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import os
import re
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from enum import Enum
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import make_folder, opened, read_bytes, write_bytes
from adaptmg._text import printable
from adaptmg.discrete.named_loads import LoadSteps
from adaptmg.grids import Grids
from adaptmg.problem.laws import sampled_friction
from adaptmg.solver.fingerprint import value_parts

Kinds = tuple[type[Any], ...]

_FORMAT = 6
_META = "meta"  # name of the array that holds the JSON text
#: the head of a path of a million steps has some 20 MB
_MOST_BYTES = 2**28
#: limits on an archive: a step of a loop has some hundreds of arrays, and packing makes it ten times smaller at most,
#: since displacements hardly shrink; up to _SMALL bytes are always unpacked
_MOST_ARRAYS, _MOST_SHRINKING, _SMALL = 100_000, 200, 64 * 2**20
_AGAIN = "remove it and the steps after it to have them computed again"


class _Writer:
    """Turns objects into arrays by name and values of JSON. A value that JSON lacks becomes an object
    with one entry, whose name is its kind."""

    def __init__(self, kinds: Kinds) -> None:
        self.kinds = kinds
        self.arrays = {}
        # by id: the number of an object, and the object, which is kept alive so that its id stays its own
        self.seen: dict[int, tuple[int, object]] = {}

    def plain(self, name: str, value: object) -> Any:
        """Return a value as JSON. An array is stored under ``name`` and replaced by a reference, an object
        of one of the kinds by its fields, and one that was written before by its number."""
        kind = next((kind for kind in self.kinds if isinstance(value, kind)), None)
        if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and not value.ndim):
            value = value.item()
        if id(value) in self.seen:
            return {"same": self.seen[id(value)][0]}
        if isinstance(value, np.ndarray):
            written = {"array": self._array(name, value)}
        elif kind is not None and isinstance(value, Enum):
            written = {kind.__name__: value.name}
        elif kind is not None:
            values = {
                entry.name: self.plain(_joined(name, entry.name), vars(value).get(entry.name))
                for entry in fields(kind)
                if entry.init
            }
            written = {kind.__name__: values}
        elif isinstance(value, Mapping):
            return {
                "dict": {
                    str(key): self.plain(_joined(name, key), part) for key, part in value.items()
                }
            }
        elif isinstance(value, tuple):
            return {"tuple": self.plain(name, list(value))}
        elif isinstance(value, list):
            return [self.plain(f"{name}[{k}]", part) for k, part in enumerate(value)]
        elif value is None or isinstance(value, bool | int | float | str):
            return value
        else:
            raise TypeError(
                f"{name} must be a number, text, or a list or dict of these to be saved, "
                f"got {checks.described(value)}"
            )
        # an object gets its number after its parts, as in the reader, which makes the parts first
        self.seen[id(value)] = (len(self.seen), value)
        return written

    def _array(self, name: str, array: np.ndarray) -> str:
        """Put an array among those of the file; return its name there."""
        if array.dtype.kind not in "biuf":
            raise TypeError(
                f"{name} must be an array of numbers to be saved, got an array of {array.dtype}"
            )
        if name in self.arrays or not re.fullmatch(r"[A-Za-z0-9_.\[\]]+", name):
            name = f"array {len(self.arrays)}"
        self.arrays[name] = array.astype(array.dtype.newbyteorder("="), copy=False)
        return name


def _joined(name: str, part: object) -> str:
    return f"{name}.{part}" if name else str(part)


class _Reader:
    """The inverse of :class:`_Writer`."""

    def __init__(self, kinds: Kinds, arrays: Mapping[str, np.ndarray]) -> None:
        self.kinds = {kind.__name__: kind for kind in kinds}
        self.arrays = arrays
        self.seen = []  # objects by their numbers in the writer

    def value(self, plain: Any) -> Any:
        """Return the value that :meth:`_Writer.plain` has turned into JSON."""
        if isinstance(plain, list):
            return [self.value(part) for part in plain]
        if not isinstance(plain, dict):
            return plain
        ((kind, content),) = plain.items()
        if kind == "same":
            return self.seen[content]
        if kind == "dict":
            return {name: self.value(part) for name, part in content.items()}
        if kind == "tuple":
            return tuple(self.value(content))
        if kind == "array":
            made = self.arrays[content]
        elif kind not in self.kinds:
            raise ValueError(f"it holds {checks.shown(kind)}")
        elif issubclass(cls := self.kinds[kind], Enum):
            made = cls[content]
        else:
            made = cls(**{name: self.value(part) for name, part in content.items()})
        self.seen.append(made)
        return made


@dataclass(frozen=True, eq=False)
class Stored:
    """Contents of a file."""

    value: Any  # the object that was saved
    more: Any  # data that were saved next to it; None if they were not read
    part_of: dict[str, object]  # number and key of a step; empty for a single result


def packed(
    value: object, kinds: Kinds, more: object = None, part_of: Mapping[str, object] | None = None
) -> bytes:
    """Return the content of a file: an object, ``more`` data next to it, and ``part_of``, the number
    and the key of a step."""
    writer = _Writer(kinds)
    text = {
        "format": _FORMAT,
        "value": writer.plain("", value),
        "more": writer.plain("more", more),
        "part_of": dict(part_of or {}),
    }
    meta = json.dumps(text | {"hash": _hash(text, writer.arrays)}).encode()
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {**writer.arrays, _META: np.frombuffer(meta, dtype=np.uint8)}
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def read(path: str | os.PathLike[str], kinds: Kinds, *, more: bool = False) -> Stored:
    """Read an object of the first of ``kinds``; ValueError, which names the file, if it is
    something else or damaged.

    ``more``: read the data next to it, too, which may have other kinds than those that are listed."""
    file = checks.file_path("path", path)
    with opened(file) as stream, damage(file):
        arrays = _arrays(stream)
        # an archive without this text is not one of adaptmg
        text = json.loads(
            arrays.pop(_META, np.zeros(0, dtype=np.uint8)).tobytes() or b'{"format": null}'
        )
        if text["format"] == _FORMAT:
            if text.pop("hash") != _hash(text, arrays):
                raise ValueError("its content is not what was written")
            reader = _Reader(kinds, arrays)
            value = checks.instance("its content", reader.value(text["value"]), kinds[0])
            return Stored(value, reader.value(text["more"]) if more else None, text["part_of"])
    if text["format"] is None:
        raise ValueError(f"{printable(os.fspath(file))} was not saved by adaptmg")
    raise ValueError(
        f"{printable(os.fspath(file))} was saved by another version of adaptmg; solve again"
    )


def _hash(text: Mapping[str, object], arrays: Mapping[str, np.ndarray] | None = None) -> str:
    """Return the hash of a text and of arrays, with their kinds and shapes."""
    content = hashlib.sha256(json.dumps(text, sort_keys=True).encode())
    for name, array in sorted((arrays or {}).items()):
        content.update(f"{name} {array.dtype.kind}{array.dtype.itemsize} {array.shape}".encode())
        content.update(np.ascontiguousarray(array).data)
    return content.hexdigest()


@contextmanager
def damage(file: Path) -> Iterator[None]:
    """Turn any exception from damaged content into a ValueError that names the file."""
    try:
        yield
    except Exception as error:  # zipfile, zlib, struct, numpy and json have their own
        what = (
            f"{error.args[0]!r} is missing"
            if isinstance(error, KeyError)
            else str(error) or type(error).__name__
        )
        raise ValueError(f"{printable(os.fspath(file))} is damaged: {what}") from error


def _arrays(file: BinaryIO) -> dict[str, np.ndarray]:
    """Return the arrays of an archive by name; only numbers are read."""
    with zipfile.ZipFile(file) as archive:
        listed = archive.infolist()
    size = os.fstat(file.fileno()).st_size
    unpacked = sum(entry.file_size for entry in listed)
    if len(listed) > _MOST_ARRAYS or len({entry.filename for entry in listed}) < len(listed):
        raise ValueError(
            f"it lists {len(listed)} arrays, some of them twice or more than {_MOST_ARRAYS}"
        )
    if unpacked > max(_SMALL, _MOST_SHRINKING * size):
        raise ValueError(f"{size} bytes would unpack to {unpacked}: that is not a result")
    checks.fits("its arrays", unpacked, "unpacked they")
    file.seek(0)
    with np.load(file, allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
            raise ValueError(f"{checks.shown(name)} is not an array of numbers")
        arrays[name] = array.astype(array.dtype.newbyteorder("="), copy=False)
    return arrays


class StepStore:
    """A folder of steps, a file each, and of a ``head``, the JSON file ``name``: what all steps share.
    Its hash, the ``key``, is in each of them. ``kinds`` are the classes that files may hold, first that
    of a step."""

    def __init__(self, folder: Path, name: str, head: Mapping[str, object], kinds: Kinds) -> None:
        self.folder = folder
        self.file = folder / name
        self.kinds = kinds
        self.head: dict[str, Any] = dict(head)
        self.key = _hash(self.head)

    @classmethod
    def resumed(
        cls, folder: str | os.PathLike[str], name: str, head: Mapping[str, object], kinds: Kinds
    ) -> StepStore:
        """Open the store in a folder, or make it; ValueError if it holds steps of another
        computation."""
        store = cls(checks.file_path("store", folder), name, head, kinds)
        if store.folder.exists() and not store.folder.is_dir():
            raise ValueError(f"store must be a folder, {store.folder} is a file")
        make_folder("store", store.folder)
        if store.empty:
            store.write_head()
            return store
        stored = cls.read(store.folder, name, kinds)
        if not stored.head["fingerprint"]:
            raise ValueError(
                f"{store.folder} was written by save, without what it was solved for: give another folder "
                "as store"
            )
        # compared in the form in which JSON returns it
        different = differences(
            stored.head["fingerprint"], json.loads(json.dumps(head["fingerprint"]))
        )
        if different:
            raise ValueError(
                f"the store {store.folder} belongs to another run: {', '.join(different)} "
                f"differ{'s' if len(different) == 1 else ''}; give another folder, or remove this one"
            )
        return stored  # with the key of the stored head, which the steps have

    @classmethod
    def read(cls, folder: Path, name: str, kinds: Kinds) -> StepStore:
        """Return the store in a folder from its head, the JSON file ``name``; ValueError if there is
        none, or it is damaged or of another version."""
        try:
            content = read_bytes(folder / name, _MOST_BYTES)
        except (FileNotFoundError, NotADirectoryError) as error:
            raise ValueError(f"{folder} holds no steps: there is no {name}") from error
        with damage(folder / name):
            head = checks.instance("its text", json.loads(content), dict, "an object")
            version = head.pop("format")
            key = head.pop("key")
            store = cls(folder, name, head, kinds)
            if version == _FORMAT and key != store.key:
                raise ValueError("its key does not fit its content")
            if version == _FORMAT:
                checks.instance("fingerprint", head["fingerprint"], dict)
                return store
        raise ValueError(
            f"{store.file} was written by another version of adaptmg; solve again in another folder"
        )

    @property
    def empty(self) -> bool:
        """Return whether the folder has neither this head nor steps."""
        return not os.path.lexists(self.file) and not self._numbers()

    def write_head(self) -> None:
        """Write the head; ``save`` does so after the steps, a computation before them."""
        text = {"format": _FORMAT, "key": self.key, **self.head}
        write_bytes(self.file, json.dumps(text, indent=1).encode())

    def put(self, number: int, value: object, more: object = None) -> None:
        """Write a step, unless another process has written it; ValueError if the file of that name is
        not this step. ``more``: what the computation needs next to the result to go on from there, such
        as an :class:`adaptmg.estimate.loop.StoredStep` of an adaptive loop."""
        if os.path.lexists(self._step_file(number)):
            self._read(number)  # which raises unless it is this step
        else:
            content = packed(value, self.kinds, more, {"step": number, "key": self.key})
            write_bytes(self._step_file(number), content)

    def steps(self, most: int | None = None) -> Iterator[Stored]:
        """Read the steps in order, at most ``most`` of them."""
        numbers = self._numbers()[:most]
        for expected, number in enumerate(numbers):
            if number != expected:
                raise ValueError(
                    f"{self._step_file(expected)} is missing, though {self._step_file(number).name} is "
                    "there: put it back, or remove the steps after it"
                )
        yield from map(self._read, numbers)

    def _read(self, number: int) -> Stored:
        """Return a step; ValueError if it is damaged, or not the step of this number and head."""
        file = self._step_file(number)
        try:
            step = read(file, self.kinds, more=True)
        except ValueError as error:
            raise ValueError(f"{error}: {_AGAIN}") from error
        if step.part_of.get("key") != self.key:
            raise ValueError(
                f"{file} belongs to another computation than {self.file.name} next to it: {_AGAIN}"
            )
        if step.part_of.get("step") != number:
            raise ValueError(
                f"{file} holds step {checks.shown(step.part_of.get('step'))}, not step {number}: {_AGAIN}"
            )
        return step

    def _numbers(self) -> list[int]:
        """Return the numbers of the stored steps, ascending."""
        return sorted(
            int(match[1])
            for name in os.listdir(self.folder)
            if (match := re.fullmatch(r"step_(\d+)\.npz", name))
        )

    def _step_file(self, number: int) -> Path:
        return self.folder / f"step_{number:04d}.npz"


def fingerprint(
    grids: Grids,
    loads: Sequence[LoadSteps | None],
    factors: Mapping[str, np.ndarray],
    steps: int,
    parts: Mapping[str, object],
    depends: Mapping[str, object] | None = None,
    start: Sequence[np.ndarray] = (),
) -> dict[str, object]:
    """Return the data on which the steps depend, as values of JSON by the names that messages give
    them; ``start``: arrays of the result with which they begin."""
    depends = checks.instance(
        "depends", {} if depends is None else depends, Mapping, "a mapping of names to values"
    )
    finest = grids.finest.discrete
    contact = grids.finest.discrete.contact
    coordinates = [] if finest.coordinates is None else [_sums(finest.coordinates)]
    dependences: dict[str, object] = {
        "problem": grids.problem.name if grids.problem is not None else "",
        "grids": [[level.n_nodes, *_sums(level.matrix.data)] for level in grids.levels]
        + coordinates,
        "volumes": []
        if not len(finest.volumes)
        else [_sums(finest.volumes.rows.data), _sums(finest.volumes.compliance)],
        "transfers": [_sums(level.prolongation.data) for level in grids.levels[1:]],
        "loads": [
            {name: _sums(load) for name, load in part.loads.items()}
            for part in loads
            if part is not None
        ],
        "supports": {
            name: [*_sums(dofs), *_sums(values)]
            for name, (dofs, values) in cast("LoadSteps", loads[-1]).prescribed.items()
        },
        "contact": [
            _sums(part)
            for part in (
                contact.nodes,
                contact.normals,
                contact.gaps,
                contact.opposite_gaps,
                contact.weights,
                contact.compliance,
                contact.exponent,
            )
        ],
        "law": [
            _sums(part)
            for part in (
                finest.law.bounds(len(contact))[0],
                sampled_friction(finest.law, len(contact)),
            )
        ],
        "path": {"steps": steps}
        | {name: list(map(float, values)) for name, values in factors.items()},
        "start": [_sums(part) for part in start],
    }
    return dependences | value_parts(parts, depends)


def _sums(values: np.ndarray) -> list[float]:
    """Return the length of an array of any shape, its norm, and its product with the wave cos k, k the
    number of the entry. Gaps are infinite where there is no limit: then these three of the finite numbers,
    and of the mask of the others."""
    flat = np.asarray(values, dtype=np.float64).reshape(-1)
    if np.isinf(flat).any():
        return [*_sums(np.where(np.isinf(flat), 0.0, flat)), *_sums(np.isinf(flat))]
    # not through BLAS, whose sums depend on the number of threads
    return [
        float(flat.size),
        float(np.sqrt(np.einsum("i,i->", flat, flat))),
        float(np.einsum("i,i->", flat, np.cos(np.arange(flat.size)))),
    ]


def differences(stored: Mapping[str, object], requested: Mapping[str, object]) -> list[str]:
    """Return the names under which two fingerprints differ, numbers by more than rounding."""
    return [
        name
        for name in {**requested, **stored}
        if not _same(stored.get(name, ...), requested.get(name, ...))
    ]


def _same(a: object, b: object) -> bool:
    """Return whether two values of JSON are alike, numbers to a relative 1e-8."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(_same(a[name], b[name]) for name in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, float | int) and isinstance(b, float | int):
        return math.isclose(a, b, rel_tol=checks.ALIKE)
    return a == b
