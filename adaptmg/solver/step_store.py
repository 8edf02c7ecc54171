"""StepStore: finished steps of a load path or an adaptive loop in a folder; what was killed goes on there.

A head (``path.json``, ``loop.json``) states what the steps belong to. A step is one result file (``step_0003.npz``),
written whole, with its number and the key of the head, a hash of its content: files that were swapped, or come from
another folder, are recognised.

In a head a fingerprint identifies the computation. Of each array on the meshes it has the length, the norm and the
product with a fixed wave, compared to a relative 1e-8: another mesh, material, load or law shows, the rounding of
another machine does not. Objects are compared by value, with the code of the user's functions and classes in them
(:func:`adaptmg._fingerprint.value_parts`).
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import make_folder, write_bytes
from adaptmg._fingerprint import value_parts
from adaptmg.discrete.discretise import LoadSteps
from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.result import Result
from adaptmg.solver.result_file import damage, read_result, write_result

_FORMAT = 3
#: the head of a path of a million steps has some 20 MB
_MOST_BYTES = 2**28
_AGAIN = "remove it and the steps after it to have them computed again"
_TOLERANCE = 1e-8


@dataclass(frozen=True, eq=False)
class StepContent:
    """A step in a file: its result, and plain values and arrays that were written with it."""

    result: Result
    text: dict[str, Any] = field(default_factory=dict)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)


class StepStore:
    """A folder of steps under a head."""

    def __init__(self, folder: Path, name: str, head: Mapping[str, object]) -> None:
        self.folder, self.file = folder, folder / name
        self.head: dict[str, Any] = dict(head)
        self.key = _hash(self.head)

    @classmethod
    def resumed(cls, folder: str | os.PathLike[str], name: str, head: Mapping[str, object]) -> StepStore:
        """Open the store in a folder, or make it; ValueError if it holds steps of another computation."""
        store = cls(checks.file_path("store", folder), name, head)
        if store.folder.exists() and not store.folder.is_dir():
            raise ValueError(f"store must be a folder, {store.folder} is a file")
        make_folder("store", store.folder)
        if not store.file.exists() and not store._numbers():
            store.write_head()
            return store
        stored = cls.read(store.folder, name)
        if not stored.head["fingerprint"]:
            raise ValueError(f"{store.folder} was written by save, without what it was solved for: give another folder "
                             "as store")
        # as it comes back from JSON
        different = differences(stored.head["fingerprint"], json.loads(json.dumps(head["fingerprint"])))
        if different:
            raise ValueError(f"the store {store.folder} belongs to another run: {', '.join(different)} "
                             f"differ{'s' if len(different) == 1 else ''}; give another folder, or remove this one")
        return stored  # steps go by the key of the head that is there

    @classmethod
    def read(cls, folder: Path, name: str) -> StepStore:
        file = folder / name
        try:
            with damage(file):
                if file.stat().st_size > _MOST_BYTES:
                    raise ValueError(f"it has {file.stat().st_size} bytes")
                head = checks.instance("its text", json.loads(file.read_bytes()), dict, "an object")
                version, key = head.pop("format"), head.pop("key")
                store = cls(folder, name, head)
                if version == _FORMAT and key != store.key:
                    raise ValueError("its key does not fit its content")
                if version == _FORMAT:
                    checks.instance("fingerprint", head["fingerprint"], dict)
        except ValueError as error:
            if isinstance(error.__cause__, FileNotFoundError | NotADirectoryError):
                raise ValueError(f"{folder} holds no steps: there is no {name}") from error
            raise
        if version != _FORMAT:
            raise ValueError(f"{file} was written by another version of adaptmg; solve again in another folder")
        return store

    def write_head(self) -> None:
        """Write the head; ``save`` does so after the steps, a computation before them."""
        text = {"format": _FORMAT, "key": self.key, **self.head}
        write_bytes(self.file, json.dumps(text, indent=1).encode())

    def put(self, number: int, step: StepContent) -> None:
        part_of = {"step": number, "key": self._key_of(step.text), **({"text": step.text} if step.text else {})}
        write_result(self._step_file(number), step.result, part_of, step.arrays)

    def steps(self) -> list[StepContent]:
        numbers = self._numbers()
        for expected, number in enumerate(numbers):
            if number != expected:
                raise ValueError(f"{self._step_file(expected)} is missing, though {self._step_file(number).name} is "
                                 "there: put it back, or remove the steps after it")
        return [self._read(number) for number in numbers]

    def _read(self, number: int) -> StepContent:
        file = self._step_file(number)
        try:
            fields, part_of, arrays = read_result(file)
        except ValueError as error:
            raise ValueError(f"{error}: {_AGAIN}") from error
        text = part_of.get("text", {})
        if part_of.get("key") != self._key_of(text):
            raise ValueError(f"{file} belongs to another computation than {self.file.name} next to it: {_AGAIN}")
        if part_of.get("step") != number:
            raise ValueError(f"{file} holds step {checks.shown(part_of.get('step'))}, not step {number}: {_AGAIN}")
        return StepContent(Result(**fields), text, arrays)

    def _numbers(self) -> list[int]:
        return sorted(int(match[1]) for name in os.listdir(self.folder)
                      if (match := re.fullmatch(r"step_(\d+)\.npz", name)))

    def _step_file(self, number: int) -> Path:
        return self.folder / f"step_{number:04d}.npz"

    def _key_of(self, text: Mapping[str, object]) -> str:
        return _hash({"head": self.key, "text": text}) if text else self.key


def _hash(content: Mapping[str, object]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def fingerprint(grids: Hierarchy, loads: Sequence[LoadSteps | None], factors: Mapping[str, np.ndarray], steps: int,
                parts: Mapping[str, object], start: np.ndarray | None = None,
                depends: Mapping[str, object] | None = None) -> dict[str, object]:
    """What the steps depend on, as plain values by the names that messages give them."""
    depends = checks.instance("depends", {} if depends is None else depends, Mapping, "a mapping of names to values")
    finest, contact = grids.finest.discrete, grids.finest.discrete.contact
    coordinates = [] if finest.coordinates is None else [_sums(finest.coordinates)]
    return {
        "problem": grids.problem.name if grids.problem is not None else "",
        "grids": [[level.n_nodes, *_sums(level.matrix.data)] for level in grids.levels] + coordinates,
        "transfers": [_sums(level.prolongation.data) for level in grids.levels[1:]],
        "loads": [{name: _sums(load) for name, load in part.loads.items()} for part in loads if part is not None],
        "supports": {name: [*_sums(dofs), *_sums(values)] for name, (dofs, values) in loads[-1].prescribed.items()},
        "contact": [_sums(part) for part in (contact.nodes, contact.normals, contact.gaps, contact.weights)],
        "law": [_sums(part) for part in finest.law.bounds(len(contact))],
        "path": {"steps": steps} | {name: list(map(float, values)) for name, values in factors.items()},
        "start": None if start is None else _sums(start),
    } | value_parts(parts, depends)


def _sums(values: np.ndarray) -> list[float]:
    flat = np.asarray(values, dtype=np.float64).reshape(-1)
    # not through BLAS, whose sums depend on the number of threads
    return [float(flat.size), float(np.sqrt(np.einsum("i,i->", flat, flat))),
            float(np.einsum("i,i->", flat, np.cos(np.arange(flat.size))))]


def differences(stored: Mapping[str, object], requested: Mapping[str, object]) -> list[str]:
    """Names under which two fingerprints differ, numbers by more than rounding."""
    return [name for name in {**requested, **stored} if not _same(stored.get(name, ...), requested.get(name, ...))]


def _same(a: object, b: object) -> bool:
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(_same(a[name], b[name]) for name in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, float | int) and isinstance(b, float | int):
        return math.isclose(a, b, rel_tol=_TOLERANCE)
    return a == b
