"""Hierarchies made again from the meshes of a store: each mesh discretised once, each neighbour located once."""

from __future__ import annotations

from collections.abc import Sequence

from adaptmg.hierarchy import Hierarchy
from adaptmg.level import Level
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.meshed_levels import joined, level_of, the_transfer

__all__ = ["Meshes"]

Key = tuple[int, int]


class Meshes:
    """The meshes of a loop by step and place; see :class:`adaptmg.estimate.loop.store.StoredStep`.

    Parameters
    ----------
    start : Hierarchy
        Of the first step.
    """

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
