"""LoopStore: the finished steps of an adaptive loop in a folder, so that a loop that was killed goes on where it was.

``loop.json`` says what the steps belong to. A step is a Result (``step_0003.npz``, its mesh inside), an estimate
(``estimate_0003.npz``), of a bisected mesh its history (``history_0003.npz``), meshes that were put between levels
(``mesh_0003_0.npz``), and at last ``step_0003.json``, which makes it complete: it names the levels, and the checksum of
each file. Every file is written whole or not at all. Both JSON files carry a key, the hash of what they say, and those
of steps the key of ``loop.json``: what was changed, or comes from another folder, is seen.

Estimates as plain values: what a store keeps of them beside their squares.

What the steps of an adaptive loop depend on, as plain values by what a message calls it.

To what :mod:`adaptmg.solver.step_store` compares on the first meshes the problem itself comes: between the nodes of
the first mesh another law or gap would not show. Limits (tolerance, nodes, seconds) are no part: a loop may go on under
others.

Hierarchies made again from the meshes of a store: each mesh discretised once, each neighbour located once.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import make_folder, write_bytes
from adaptmg.discrete.load_steps import load_steps
from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.goal_view import GoalEstimate
from adaptmg.hierarchy import Hierarchy
from adaptmg.level import Level, joined, level_of, the_transfer
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.bisection.tables import history_arrays, with_history
from adaptmg.solver.load_path import PathResult
from adaptmg.solver.result import Result
from adaptmg.solver.result_file import DAMAGES, read_arrays
from adaptmg.solver.step_store import HEAD as PATH_HEAD
from adaptmg.solver.step_store import differences, fingerprint

__all__ = ["LoopStore", "Meshes", "StoredStep", "estimate_from", "loop_fingerprint", "plain_estimate"]

_HEAD, _FORMAT = "loop.json", 2
_MESH = ("points", "elements", "facets", "facet_labels", "element_body")
_NUMBERS = ("total_seconds", "work_units", "total_work_units")
_AGAIN = "remove it and the steps after it to have them made again"


@dataclass(frozen=True, eq=False)
class StoredStep:
    """What a folder keeps of a step."""

    result: Result
    estimate: Estimate
    levels: list[tuple[int, int]]  # list of (int, int)
    extra: list[MeshArrays]  # meshes that came with this step beside its own
    numbers: dict[str, float]  # total_seconds, work_units, total_work_units
    timings: dict[str, float]
    path: PathResult | None = None  # of a loop with a load path; in a folder path_0003


class LoopStore:
    """A folder with finished steps."""

    def __init__(self, folder: str | os.PathLike[str], mark: Mapping[str, Any]) -> None:
        self.folder = checks.file_path("store", folder)
        if self.folder.exists() and not self.folder.is_dir():
            raise ValueError(f"store must be a folder, {self.folder} is a file")
        make_folder("store", self.folder)
        # as it comes back from JSON
        wanted, head = json.loads(json.dumps(mark)), self.folder / _HEAD
        if not head.exists():
            if any(self.folder.glob("step_*")):
                raise ValueError(f"store: {self.folder} holds steps of something else, there is no {_HEAD}; give "
                                 "another folder")
            _write_json(head, {"format": _FORMAT, "fingerprint": wanted})
        said = _json(head, "give another folder")
        self.key = said["key"]
        different = differences(said["fingerprint"], wanted)
        if different:
            raise ValueError(f"the store {self.folder} belongs to another loop: {', '.join(different)} "
                             f"differ{'s' if len(different) == 1 else ''}; give another folder, or remove this one")

    def steps(self) -> list[StoredStep]:
        """The finished steps, from the first on."""
        found = sorted(int(match[1]) for name in os.listdir(self.folder)
                       if (match := re.fullmatch(r"step_(\d+)\.json", name)))
        if found != list(range(len(found))):
            raise ValueError(f"{self.folder} has the steps {found}: one is missing; put it back, or remove those after "
                             "it")
        return [self._read(k) for k in found]

    def put(self, number: int, step: StoredStep) -> None:
        """Keep a finished step; its ``.json`` comes last."""
        step.result.save(self._file(number, "step", "npz"))
        names = [self._file(number, "step", "npz").name]
        for k, mesh in enumerate(step.extra):
            arrays = {name: getattr(mesh, name) for name in _MESH}
            names.append(self._write(f"mesh_{number:04d}_{k}.npz", arrays, boundaries=mesh.boundaries,
                                     bodies=mesh.bodies))
        history = history_arrays(step.result.mesh)
        if history:
            # bisection goes on from it
            names.append(self._write(f"history_{number:04d}.npz", history))
        names.append(self._write(f"estimate_{number:04d}.npz", {"squares": step.estimate.squares},
                                 **plain_estimate(step.estimate)))
        folder = self.folder / f"path_{number:04d}"
        if step.path is not None:
            # what a process that was killed may have left
            shutil.rmtree(folder, ignore_errors=True)
            step.path.save(folder)
            names.append(f"{folder.name}/{PATH_HEAD}")
        said = {"format": _FORMAT, "loop": self.key, "step": number, "levels": step.levels, "extra": len(step.extra),
                "history": bool(history), "path": step.path is not None, "timings": step.timings, **step.numbers,
                "files": {name: _checksum(self.folder / name) for name in names}}
        _write_json(self._file(number, "step", "json"), said)

    def _file(self, number: int, kind: str, ending: str) -> Path:
        return self.folder / f"{kind}_{number:04d}.{ending}"

    def _write(self, name: str, arrays: Mapping[str, np.ndarray], **said: Any) -> str:
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **arrays, meta=np.frombuffer(json.dumps(said).encode(), dtype=np.uint8))
        write_bytes(self.folder / name, buffer.getvalue())
        return name

    def _arrays(self, name: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        arrays = read_arrays(self.folder / name)
        return arrays, json.loads(arrays.pop("meta").tobytes())

    def _read(self, number: int) -> StoredStep:
        file = self._file(number, "step", "json")
        said = _json(file, _AGAIN)
        if (said["loop"], said["step"]) != (self.key, number):
            raise ValueError(f"{file} belongs to another loop or step: {_AGAIN}")
        try:
            for name, checksum in said["files"].items():
                if _checksum(self.folder / name) != checksum:
                    raise ValueError(f"{name} is not what was written")
            extra = [self._mesh(f"mesh_{number:04d}_{k}.npz") for k in range(said["extra"])]
            arrays, meta = self._arrays(f"estimate_{number:04d}.npz")
            path = PathResult.load(self.folder / f"path_{number:04d}") if said["path"] else None
            result = Result.load(self._file(number, "step", "npz"))
            if said["history"]:
                history, _ = self._arrays(f"history_{number:04d}.npz")
                result = replace(result, mesh=with_history(result.mesh, history))
            return StoredStep(result, estimate_from(arrays["squares"], meta),
                              [(step, place) for step, place in said["levels"]], extra,
                              {name: said[name] for name in _NUMBERS}, said["timings"], path)
        except (*DAMAGES, OSError) as error:
            raise ValueError(f"{file} is damaged, or a file beside it ({error or type(error).__name__}): {_AGAIN}"
                             ) from error

    def _mesh(self, name: str) -> MeshArrays:
        arrays, meta = self._arrays(name)
        return MeshArrays(**{key: arrays[key] for key in _MESH}, boundaries=tuple(meta["boundaries"]),
                          bodies=tuple(meta["bodies"]))


def _key(said: Mapping[str, Any]) -> str:
    """The hash of what a file says, its own key apart."""
    text = json.dumps({name: value for name, value in said.items() if name != "key"}, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _write_json(file: Path, said: dict[str, Any]) -> None:
    write_bytes(file, json.dumps(said | {"key": _key(said)}, indent=1, allow_nan=False).encode())


def _json(file: Path, remedy: str) -> dict[str, Any]:
    """What a file says, which is what :func:`_write_json` wrote."""
    try:
        said = checks.instance("its text", json.loads(file.read_bytes()), dict, "an object")
        if said["format"] == _FORMAT and said["key"] != _key(said):
            raise ValueError("its key does not fit what it says")
    except (*DAMAGES, OSError) as error:
        what = f"{error.args[0]!r} is missing" if isinstance(error, KeyError) else error or type(error).__name__
        raise ValueError(f"{file} is damaged ({what}): {remedy}") from error
    if said["format"] != _FORMAT:
        raise ValueError(f"{file} was written by another version of adaptmg; begin again in another folder")
    return said


def _checksum(file: Path) -> str:
    return hashlib.sha256(file.read_bytes()).hexdigest()


#: kinds that come back as they were; others, one's own, as Estimate
_KINDS = {kind.__name__: kind for kind in (Estimate, GoalEstimate)}
_ARRAYS = ("values", "errors", "residuals")


def plain_estimate(estimate: Estimate) -> dict[str, Any]:
    """Everything but ``squares``, as JSON has it."""
    name = type(estimate).__name__
    kind = name if _KINDS.get(name) is type(estimate) else "Estimate"
    names = [part.name for part in fields(_KINDS[kind]) if part.name != "squares"]
    return {"kind": kind} | {name: _plain(getattr(estimate, name)) for name in names}


def estimate_from(squares: np.ndarray, said: Mapping[str, Any]) -> Estimate:
    """The inverse of :func:`plain_estimate`; KeyError, TypeError or ValueError where it says something else."""
    values = dict(said)
    kind = _KINDS[values.pop("kind")]
    for name, value in values.items():
        if isinstance(value, list):
            values[name] = np.array(value, dtype=np.float64) if name in _ARRAYS else tuple(value)
    return kind(squares=squares, **values)


def _plain(value: Any) -> Any:
    """Of numpy's numbers and arrays, tuples and mappings."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {name: _plain(part) for name, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, tuple | list) else value


def loop_fingerprint(start: Hierarchy, options: Mapping[str, Any], load_path: Any = None,
                     depends: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Of a loop that begins with a hierarchy, and its options by name: indicator, mark, engine, solver, ..."""
    loads = [load_steps(start.problem, level.mesh, level.discrete) for level in start.levels]
    factors = {} if load_path is None else load_path.resolved(start.problem)
    # references only document the problem
    posed = {part.name: getattr(start.problem, part.name) for part in fields(start.problem) if part.name != "reference"}
    return fingerprint(start, loads, factors, 0 if load_path is None else len(load_path), posed | dict(options), None,
                       depends)


Key = tuple[int, int]


class Meshes:
    """The meshes of a loop by step and place; see :class:`adaptmg.estimate.loop_store.StoredStep`."""

    def __init__(self, start: Hierarchy) -> None:
        self.start = start
        self._meshes: dict[Key, MeshArrays] = {}
        self._alone: dict[Key, Level] = {}
        self._joined: dict[tuple[Key, Key], Level] = {}

    def note(self, number: int, hierarchy: Hierarchy) -> tuple[list[Key], list[MeshArrays]]:
        """The keys of the levels of a step, and the meshes that came with it beside its own."""
        known = {id(mesh): key for key, mesh in self._meshes.items()}
        keys, extra = [], []
        for level in hierarchy.levels:
            if level is hierarchy.finest:
                key = (number, -1)
            elif id(level.mesh) in known:
                key = known[id(level.mesh)]
            else:
                key = (number, len(extra))
                extra.append(level.mesh)
            self._meshes[key] = level.mesh
            keys.append(key)
        return keys, extra

    def take(self, number: int, own: MeshArrays, extra: Sequence[MeshArrays], keys: Sequence[Key]) -> Hierarchy:
        """The hierarchy of a stored step; its own mesh and those that came with it are new."""
        from adaptmg.mesh import with_source

        for place, mesh in ((-1, own), *enumerate(extra)):
            self._meshes[number, place] = with_source(mesh)
        levels: list[Level] = []
        for k, key in enumerate(keys):
            if key not in self._alone:
                self._alone[key] = level_of(self.start.problem, self._meshes[key])
            levels.append(self._alone[key] if k == 0 else self._pair(keys[k - 1], key, levels[-1]))
        return Hierarchy(tuple(levels), self.start.problem, self.start.origin, {}, self.start.limits,
                         self.start.transfer, self.start.contact_rows)

    def _pair(self, below: Key, key: Key, coarse: Level) -> Level:
        if (below, key) not in self._joined:
            transfer = the_transfer(self.start.transfer)
            self._joined[below, key] = joined(coarse, self._alone[key], transfer, self.start.contact_rows)
        return self._joined[below, key]
