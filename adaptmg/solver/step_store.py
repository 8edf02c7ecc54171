"""The folder of a load path: ``path.json`` for what all steps share, and a result file a step.

Every step file carries its number and the key of the path, a hash of what ``path.json`` says, so that files that were
swapped, or come from another folder, are told from those that belong there. Only the first step carries the mesh.

PathStore: the finished steps of a load path in a folder, so that a run that was killed goes on where it was.

A step is written beside its place and renamed: what is there is whole. The fingerprint says what the steps belong to.
Of every array on the meshes it keeps length, norm and the product with a fixed wave, which are compared to a relative
1e-8: another mesh, material, load or law shows, the rounding of another machine does not. The solver is compared by
value, with the code of the user's functions and classes in it (:func:`adaptmg._fingerprint.value_parts`).
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._files import make_folder, write_bytes
from adaptmg._fingerprint import value_parts
from adaptmg.discrete.load_steps import LoadSteps
from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.result import Result, loaded
from adaptmg.solver.result_file import DAMAGES, write_result

__all__ = ["HEAD", "PathHead", "PathStore", "differences", "fingerprint", "read", "step_file", "write", "write_head",
           "write_step"]

HEAD = "path.json"
_FORMAT = 3
#: a path.json of a million steps is some 20 MB
_MOST_BYTES, _MOST_STEPS = 2**28, 10**7
_AGAIN = "remove it and those after it to have these steps solved again"


@dataclass(frozen=True)
class PathHead:
    """What all steps share; see :class:`adaptmg.PathResult`. Without a fingerprint ``norms``, of the displacement of
    each step, tell paths of the same factors apart."""

    factors: Mapping[str, np.ndarray]
    steps: int
    fingerprint: Mapping[str, Any]
    norms: tuple[float, ...] = ()

    @property
    def plain(self) -> dict[str, Any]:
        """As JSON has it."""
        return {"steps": self.steps, "factors": {name: list(map(float, v)) for name, v in self.factors.items()},
                "norms": list(self.norms), "fingerprint": dict(self.fingerprint)}

    @property
    def key(self) -> str:
        """By which step files are known as those of this path."""
        return hashlib.sha256(json.dumps(self.plain, sort_keys=True).encode()).hexdigest()


def step_file(folder: Path, step: int) -> Path:
    """Where a step is kept."""
    return folder / f"step_{step:04d}.npz"


def write_head(folder: Path, head: PathHead) -> None:
    """Write what all steps share."""
    text = json.dumps({"format": _FORMAT, "key": head.key, **head.plain}, indent=1)
    write_bytes(folder / HEAD, text.encode())


def write_step(folder: Path, head: PathHead, step: int, result: Result) -> None:
    """Write a step, whole or not at all."""
    write_result(step_file(folder, step), result if step == 0 else replace(result, mesh=None),
                 {"step": step, "key": head.key})


def write(folder: Path, results: Sequence[Result], factors: Mapping[str, np.ndarray], steps: int,
          fingerprint: Mapping[str, Any]) -> None:
    """Write a whole path; ValueError if the folder holds one."""
    if (folder / HEAD).exists():
        raise ValueError(f"{folder} holds a load path already: give another folder, or remove it")
    make_folder("folder", folder)
    head = PathHead(factors, steps, fingerprint, tuple(float(np.linalg.norm(r.displacement)) for r in results))
    for k, result in enumerate(results):
        write_step(folder, head, k, result)
    write_head(folder, head)


def read(folder: Path) -> tuple[PathHead, tuple[Result, ...]]:
    """Read the head and the steps that are there, from the first on."""
    head = _read_head(folder)
    found = sorted(int(match[1]) for name in os.listdir(folder) if (match := re.fullmatch(r"step_(\d+)\.npz", name)))
    results: list[Result] = []
    for expected, step in enumerate(found):
        if step != expected:
            raise ValueError(f"{step_file(folder, expected)} is missing, though {step_file(folder, step).name} is "
                             "there: put it back, or remove those after it to have these steps solved again")
        if step >= head.steps:
            raise ValueError(f"{step_file(folder, step)} is no step of this path, which has {head.steps}: remove it")
        results.append(_read_step(step_file(folder, step), step, head, results))
    return head, tuple(results)


def _read_head(folder: Path) -> PathHead:
    file = folder / HEAD
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise ValueError(f"{file} is damaged: it has {file.stat().st_size} bytes")
        text = file.read_bytes()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise ValueError(f"{folder} holds no load path: there is no {HEAD}") from error
    except IsADirectoryError as error:
        raise ValueError(f"{file} is damaged: it is a folder") from error
    try:
        said = checks.instance("its text", json.loads(text), dict, "an object")
        if said["format"] == _FORMAT:
            factors = {name: check_arrays.vector(f"factors[{name!r}]", values, checks.integer("steps", said["steps"]))
                       for name, values in checks.instance("factors", said["factors"], dict).items()}
            head = PathHead(factors, checks.integer("steps", said["steps"], maximum=_MOST_STEPS),
                            checks.instance("fingerprint", said["fingerprint"], dict), tuple(said["norms"]))
            if head.key == said["key"]:
                return head
            raise ValueError("its key does not fit what it says")
    except DAMAGES as error:
        said = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else error or type(error).__name__
        raise ValueError(f"{file} is damaged: {said}") from error
    raise ValueError(f"{folder} was saved by another version of adaptmg; solve again")


def _read_step(file: Path, step: int, head: PathHead, before: list[Result]) -> Result:
    try:
        result, part_of = loaded(file)
    except ValueError as error:
        raise ValueError(f"{error}: {_AGAIN}") from error
    if part_of.get("key") != head.key:
        raise ValueError(f"{file} belongs to another load path than {HEAD} beside it: {_AGAIN}")
    if part_of.get("step") != step:
        raise ValueError(f"{file} holds step {checks.shown(part_of.get('step'))}, not step {step}: put the files back "
                         f"in order, or {_AGAIN}")
    if before and result.displacement.shape != before[0].displacement.shape:
        raise ValueError(f"{file} has {result.displacement.shape} displacements, the first step "
                         f"{before[0].displacement.shape}: {_AGAIN}")
    return replace(result, mesh=before[0].mesh) if before else result


_TOLERANCE = 1e-8


class PathStore:
    """A folder with the finished steps."""

    def __init__(self, folder: str | os.PathLike[str], factors: Mapping[str, np.ndarray], steps: int,
                 mark: Mapping[str, Any]) -> None:
        self.folder = checks.file_path("store", folder)
        if self.folder.exists() and not self.folder.is_dir():
            raise ValueError(f"store must be a folder, {self.folder} is a file")
        make_folder("store", self.folder)
        self.results: list[Result] = []
        self._head = PathHead(factors, steps, mark)
        if not any(self.folder.glob("step_*.npz")) and not (self.folder / HEAD).exists():
            write_head(self.folder, self._head)
            return
        # the head that is there stays: steps go by its key
        self._head, results = read(self.folder)
        if not self._head.fingerprint:
            raise ValueError(f"{self.folder} was written by PathResult.save, which does not know what it was "
                             "solved for: give another folder as store")
        # as it comes back from JSON
        different = differences(self._head.fingerprint, json.loads(json.dumps(mark)))
        if different:
            raise ValueError(f"the store {self.folder} belongs to another run: {', '.join(different)} differ"
                             f"{'s' if len(different) == 1 else ''}; give another folder, or remove this one")
        self.results = list(results)

    def put(self, step: int, result: Result) -> None:
        """Keep a finished step."""
        write_step(self.folder, self._head, step, result)


def fingerprint(grids: Hierarchy, loads: Sequence[LoadSteps | None], factors: Mapping[str, np.ndarray], steps: int,
                parts: Mapping[str, Any], start: np.ndarray | None = None, depends: Mapping[str, Any] | None = None
                ) -> dict[str, Any]:
    """What the steps of a path depend on, as plain values by what a message calls it."""
    given = checks.instance("depends", {} if depends is None else depends, Mapping, "a mapping of names to values")
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
    } | value_parts(parts, given)


def _sums(values: np.ndarray) -> list[float]:
    """Length, norm, and product with a wave."""
    flat = np.asarray(values, dtype=np.float64).reshape(-1)
    # not through BLAS, whose sums depend on the number of threads
    return [float(flat.size), float(np.sqrt(np.einsum("i,i->", flat, flat))),
            float(np.einsum("i,i->", flat, np.cos(np.arange(flat.size))))]


def differences(stored: Mapping[str, Any], wanted: Mapping[str, Any]) -> list[str]:
    """Names under which two fingerprints differ, numbers by more than rounding."""
    return [name for name in {**wanted, **stored} if not _same(stored.get(name, ...), wanted.get(name, ...))]


def _same(a: Any, b: Any) -> bool:
    """Whether nested plain values agree, numbers to rounding."""
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        return a.keys() == b.keys() and all(_same(a[name], b[name]) for name in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_same, a, b))
    if isinstance(a, float | int) and isinstance(b, float | int):
        return math.isclose(a, b, rel_tol=_TOLERANCE)
    return a == b
