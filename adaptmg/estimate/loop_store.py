"""The steps of an adaptive loop in a folder, so that a killed loop goes on with the same numbers.

Each step is one file of a :class:`adaptmg.solver.store.StepStore`: the result with its mesh, and a :class:`StoredStep`.
Limits (tolerance, nodes, seconds) are not part of the fingerprint: a loop may go on under others.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np

from adaptmg.discrete.discretise import load_steps
from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.goal import GoalEstimate
from adaptmg.hierarchy import Hierarchy
from adaptmg.level import Level, joined, level_of, the_transfer
from adaptmg.mesh.arrays import MeshArrays, Refinement
from adaptmg.problem.load_path import LoadPath
from adaptmg.solver.load_path import PathResult
from adaptmg.solver.result import KINDS
from adaptmg.solver.store import StepStore, fingerprint

Key = tuple[int, int]


@dataclass(frozen=True, eq=False)
class StoredStep:
    """What a store has of a step next to its result."""

    estimate: Estimate
    levels: list[Key]  # for each level the step and place of its mesh
    extra: list[MeshArrays]  # meshes that came with this step next to its own
    history: Refinement | None  # the bisections that made its own mesh
    numbers: dict[str, float]  # total_seconds, work_units, total_work_units
    timings: dict[str, float]
    path: PathResult | None = None


#: what the file of a step holds; user-defined estimates come back as Estimate
LOOP_KINDS = (*KINDS, StoredStep, GoalEstimate, Estimate, PathResult, Refinement)


def loop_store(folder: str | os.PathLike[str], mark: Mapping[str, object]) -> StepStore:
    """The store of a loop with a fingerprint."""
    return StepStore.resumed(folder, "loop.json", {"fingerprint": dict(mark)}, LOOP_KINDS)


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
