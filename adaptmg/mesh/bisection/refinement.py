"""Refinement: what a mesh knows of the bisections it came from. They go on from it, and are taken back by it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from adaptmg.mesh.arrays import MeshArrays, trusted

__all__ = ["Refinement", "as_initial", "with_refinement"]


@dataclass(frozen=True, eq=False)
class Refinement:
    """The history of a bisected mesh, as frozen arrays; held by ``mesh.refinement``.

    The corners of such a mesh's elements are in the order of bisection: the edge between the first two is halved next.
    An element that was bisected is a row of the tree.

    Parameters
    ----------
    parents : (n_nodes, 2) int32 array
        The ends of the edge that each node halves; of a node of the initial mesh both are itself.
    marks : (n_elements,) int8 array
        Marked edges of tetrahedra, see :mod:`adaptmg.mesh.bisection.children`; 0 of triangles.
    generation : (n_elements,) int16 array
        How many bisections lead to the element.
    forebear : (n_elements,) int32 array
        Row of the tree that was bisected into it, -1 of an element of the initial mesh.
    tree : (n_bisected, dim + 4) int32 array
        Corners, marks, forebear and new node of each bisected element.
    """

    parents: np.ndarray
    marks: np.ndarray
    generation: np.ndarray
    forebear: np.ndarray
    tree: np.ndarray

    def __post_init__(self) -> None:
        for one in fields(self):
            getattr(self, one.name).flags.writeable = False

    def __reduce__(self) -> tuple[Any, ...]:
        # by way of __init__: arrays come out of a pickle writable
        return type(self), tuple(getattr(self, one.name) for one in fields(self))


def with_refinement(mesh: MeshArrays, refinement: Refinement | None) -> MeshArrays:
    """The same mesh with another history, its source and soundness kept."""
    result = trusted(mesh, vars(mesh)["source"], mesh.sound)
    object.__setattr__(result, "refinement", refinement)
    return result


def as_initial(mesh: MeshArrays) -> MeshArrays:
    """The mesh with its labels, but without its past: nothing is taken back below it."""
    history = mesh.refinement
    if history is None:
        return mesh
    own = np.repeat(np.arange(mesh.n_nodes, dtype=np.int32), 2).reshape(-1, 2)
    n = len(mesh.elements)
    return with_refinement(mesh, Refinement(own, history.marks, np.zeros(n, np.int16), np.full(n, -1, np.int32),
                                            history.tree[:0].copy()))
