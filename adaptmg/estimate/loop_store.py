"""The steps of an adaptive loop in a folder, so that a killed loop goes on with the same numbers.

Each step is one file of a :class:`adaptmg.solver.store.StepStore`: the result with its mesh, and a :class:`StoredStep`.
Limits (tolerance, nodes, seconds) are not part of the fingerprint: a loop may go on under others.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

from adaptmg.discrete.discretise import load_steps
from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.goal import GoalEstimate
from adaptmg.hierarchy import Hierarchy
from adaptmg.level import Level, joined, level_of, the_transfer
from adaptmg.mesh import with_source
from adaptmg.mesh.arrays import MeshArrays, Refinement
from adaptmg.problem.load_path import LoadPath
from adaptmg.solver.load_path import PathResult
from adaptmg.solver.result import KINDS
from adaptmg.solver.store import fingerprint


@dataclass(frozen=True, eq=False)
class StoredStep:
    """What a store has of a step next to its result."""

    estimate: Estimate
    levels: list[MeshArrays]  # the meshes of all levels
    history: Refinement | None  # the bisections that made its own mesh
    numbers: dict[str, float]  # total_seconds, work_units, total_work_units
    timings: dict[str, float]
    path: PathResult | None = None


#: what the file of a step holds; user-defined estimates come back as Estimate
LOOP_KINDS = (*KINDS, StoredStep, GoalEstimate, Estimate, PathResult, Refinement)


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
    """The meshes of stored steps, each discretised once and each neighbour located once."""

    def __init__(self, start: Hierarchy) -> None:
        self.start = start
        # meshes of the start know more than their arrays
        self._known = {_key(level.mesh): level.mesh for level in start.levels}
        self._alone: dict[bytes, Level] = {}
        self._joined: dict[tuple[bytes, bytes], Level] = {}

    def take(self, meshes: Sequence[MeshArrays]) -> Hierarchy:
        """The hierarchy of a stored step."""
        levels: list[Level] = []
        below = b""
        for mesh in meshes:
            key = _key(mesh)
            if key not in self._alone:
                self._alone[key] = level_of(self.start.problem, self._known.get(key) or with_source(mesh))
            if levels and (below, key) not in self._joined:
                self._joined[below, key] = joined(levels[-1], self._alone[key], the_transfer(self.start.transfer),
                                                  self.start.contact_rows)
            levels.append(self._joined[below, key] if levels else self._alone[key])
            below = key
        return Hierarchy(tuple(levels), self.start.problem, self.start.origin, {}, self.start.limits,
                         self.start.transfer, self.start.contact_rows)


def _key(mesh: MeshArrays) -> bytes:
    return hashlib.sha256(mesh.points.tobytes() + mesh.elements.tobytes()).digest()
