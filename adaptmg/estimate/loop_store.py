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
    """Return the fingerprint of a loop that begins with a hierarchy, with its options by name: indicator, mark, engine,
    ..."""
    loads = [load_steps(start.problem, level.mesh, level.discrete) for level in start.levels]
    factors = {} if load_path is None else load_path.resolved(start.problem)
    # the problem itself, since another law or gap may differ only between the nodes of the first mesh; references only
    # document it
    posed = {part.name: getattr(start.problem, part.name) for part in fields(start.problem) if part.name != "reference"}
    return fingerprint(start, loads, factors, 0 if load_path is None else len(load_path), posed | dict(options), None,
                       depends)


def restored(before: Hierarchy, meshes: Sequence[MeshArrays]) -> Hierarchy:
    """Return the hierarchy of a stored step, which has these meshes, made of that of the step before."""
    stored = [_key(mesh) for mesh in meshes]
    there = [_key(level.mesh) for level in before.levels]
    for key, mesh in zip(stored, meshes, strict=True):
        if key not in there:
            before = before.append(with_source(mesh))
            there.append(key)
    for level in reversed([k for k, key in enumerate(there) if key not in stored]):
        before = before.without(level)
    return before


def _key(mesh: MeshArrays) -> bytes:
    return hashlib.sha256(mesh.points.tobytes() + mesh.elements.tobytes()).digest()
