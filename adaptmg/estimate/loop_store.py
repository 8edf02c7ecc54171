"""LoopStore: the finished steps of an adaptive loop in a folder, so that a killed loop goes on with the same numbers.

Each step is one file of a :class:`adaptmg.solver.step_store.StepStore`: the result with its mesh, the history of a
bisected mesh, the estimate, the meshes that the step put between levels, and by number the meshes of its levels; with
a load path the folder ``path_0003`` next to it. Limits (tolerance, nodes, seconds) are not part of the fingerprint: a
loop may go on under others.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from adaptmg.discrete.discretise import load_steps
from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.goal import GoalEstimate
from adaptmg.hierarchy import Hierarchy
from adaptmg.level import Level, joined, level_of, the_transfer
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.bisection.tables import history_arrays, with_history
from adaptmg.problem.load_path import LoadPath
from adaptmg.solver.load_path import PathResult
from adaptmg.solver.result import Result
from adaptmg.solver.result_file import damage
from adaptmg.solver.step_store import StepContent, StepStore, fingerprint

Key = tuple[int, int]
_MESH = ("points", "elements", "facets", "facet_labels", "element_body")


@dataclass(frozen=True, eq=False)
class StoredStep:
    """A step of a loop as a store keeps it."""

    result: Result
    estimate: Estimate
    levels: list[Key]  # for each level the step and place of its mesh
    extra: list[MeshArrays]  # meshes that came with this step next to its own
    numbers: dict[str, float]  # total_seconds, work_units, total_work_units
    timings: dict[str, float]
    path: PathResult | None = None


class LoopStore:
    """A folder with finished steps."""

    def __init__(self, folder: str | os.PathLike[str], mark: Mapping[str, object]) -> None:
        self.store = StepStore.resumed(folder, "loop.json", {"fingerprint": dict(mark)})

    def put(self, number: int, step: StoredStep) -> None:
        """Keep a finished step; its file comes last."""
        arrays = {f"mesh{k}.{name}": getattr(mesh, name) for k, mesh in enumerate(step.extra) for name in _MESH}
        arrays |= {f"history.{name}": values for name, values in history_arrays(step.result.mesh).items()}
        labels = [{"boundaries": list(mesh.boundaries), "bodies": list(mesh.bodies)} for mesh in step.extra]
        text = {"levels": [list(key) for key in step.levels], "extra": labels, "timings": step.timings,
                "numbers": step.numbers, "estimate": _plain_estimate(step.estimate), "path": step.path is not None}
        if step.path is not None:
            folder = self._path(number)
            shutil.rmtree(folder, ignore_errors=True)  # of a process that was killed
            step.path.save(folder)
        self.store.put(number, StepContent(step.result, text, arrays | {"squares": step.estimate.squares}))

    def steps(self) -> list[StoredStep]:
        """The finished steps, from the first on."""
        return [self._step(number, content) for number, content in enumerate(self.store.steps())]

    def _path(self, number: int) -> Path:
        return self.store.folder / f"path_{number:04d}"

    def _step(self, number: int, content: StepContent) -> StoredStep:
        result, text, arrays = content.result, content.text, content.arrays
        with damage(self.store.folder / f"step_{number:04d}.npz"):
            history = _named(arrays, "history.")
            if history:
                result = replace(result, mesh=with_history(result.mesh, history))
            extra = [MeshArrays(**_named(arrays, f"mesh{k}."), boundaries=tuple(labels["boundaries"]),
                                bodies=tuple(labels["bodies"])) for k, labels in enumerate(text["extra"])]
            return StoredStep(result, _estimate(arrays["squares"], text["estimate"]),
                              [(step, place) for step, place in text["levels"]], extra, text["numbers"],
                              text["timings"], PathResult.load(self._path(number)) if text["path"] else None)


def _named(arrays: Mapping[str, np.ndarray], prefix: str) -> dict[str, np.ndarray]:
    return {name.removeprefix(prefix): values for name, values in arrays.items() if name.startswith(prefix)}


#: kinds of estimates that come back unchanged; user-defined ones come back as Estimate
_KINDS = {kind.__name__: kind for kind in (Estimate, GoalEstimate)}
_ARRAYS = ("values", "errors", "residuals")


def _plain_estimate(estimate: Estimate) -> dict[str, object]:
    kind = type(estimate) if type(estimate) in _KINDS.values() else Estimate
    return {"kind": kind.__name__} | {part.name: _plain(getattr(estimate, part.name)) for part in fields(kind)
                                      if part.name != "squares"}


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return {name: _plain(part) for name, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, tuple | list) else value


def _estimate(squares: np.ndarray, text: Mapping[str, Any]) -> Estimate:
    """The inverse of :func:`_plain_estimate`."""
    values = dict(text)
    kind = _KINDS[values.pop("kind")]
    for name, value in values.items():
        if isinstance(value, list):
            values[name] = np.array(value, dtype=np.float64) if name in _ARRAYS else tuple(value)
    return kind(squares=squares, **values)


def loop_fingerprint(start: Hierarchy, options: Mapping[str, object], load_path: LoadPath | None = None,
                     depends: Mapping[str, object] | None = None) -> dict[str, object]:
    """The fingerprint of a loop that begins with a hierarchy, with its options by name: indicator, mark, engine, ..."""
    loads = [load_steps(start.problem, level.mesh, level.discrete) for level in start.levels]
    factors = {} if load_path is None else load_path.resolved(start.problem)
    # the problem itself, since another law or gap may differ only between the nodes of the first mesh; references only
    # document it
    posed = {part.name: getattr(start.problem, part.name) for part in fields(start.problem) if part.name != "reference"}
    return fingerprint(start, loads, factors, 0 if load_path is None else len(load_path), posed | dict(options), None,
                       depends)


class Meshes:
    """The meshes of a loop by step and place, each discretised once and each neighbour located once."""

    def __init__(self, start: Hierarchy) -> None:
        self.start = start
        self._meshes: dict[Key, MeshArrays] = {}
        self._alone: dict[Key, Level] = {}
        self._joined: dict[tuple[Key, Key], Level] = {}

    def note(self, number: int, hierarchy: Hierarchy) -> tuple[list[Key], list[MeshArrays]]:
        """The keys of the levels of a step, and the meshes that came with it next to its own."""
        keys_of = {id(mesh): key for key, mesh in self._meshes.items()}
        keys, extra = [], []
        for level in hierarchy.levels:
            if level is hierarchy.finest:
                key = (number, -1)
            elif id(level.mesh) in keys_of:
                key = keys_of[id(level.mesh)]
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
            # meshes of the start know more than their arrays
            own_to = [level.mesh for level in self.start.levels if np.array_equal(level.mesh.points, mesh.points)
                      and np.array_equal(level.mesh.elements, mesh.elements)]
            self._meshes[number, place] = own_to[0] if own_to else with_source(mesh)
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
