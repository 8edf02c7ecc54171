"""The history of a bisected mesh as plain arrays, for files; and back, checked as if a stranger had written them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.bisection.refinement import Refinement, with_refinement
from adaptmg.mesh.bisection.tables import FOREBEAR, columns_of_tree

__all__ = ["history_arrays", "with_history"]

_TYPES = {"parents": np.int32, "marks": np.int8, "generation": np.int16, "forebear": np.int32, "tree": np.int32}
# marks of tetrahedra, flagged or not: see adaptmg.mesh.bisection.children
_MOST_MARKS = {2: 0, 3: 17}


def history_arrays(mesh: MeshArrays) -> dict[str, np.ndarray]:
    """The arrays of a mesh's :class:`~adaptmg.mesh.bisection.refinement.Refinement` by name; empty without one."""
    if mesh.refinement is None:
        return {}
    return {one.name: getattr(mesh.refinement, one.name) for one in fields(Refinement)}


def with_history(mesh: MeshArrays, arrays: Mapping[str, np.ndarray]) -> MeshArrays:
    """A mesh of the same arrays with the history that :func:`history_arrays` took from it.

    Parameters
    ----------
    mesh : MeshArrays
        Nodes and elements as they were, in the same order.
    arrays : mapping of str to array
        Empty: the mesh has no history.

    Returns
    -------
    MeshArrays
        Bisection goes on from it exactly as from the mesh that the arrays are from.

    Raises
    ------
    ValueError
        If an array is missing, or they do not fit the mesh or each other.
    """
    if not arrays:
        return with_refinement(mesh, None)
    missing = [name for name in _TYPES if name not in arrays]
    if missing:
        raise ValueError(f"history: {', '.join(missing)} is missing; it takes {', '.join(_TYPES)}")
    given = {name: _whole(name, arrays[name], dtype) for name, dtype in _TYPES.items()}
    n, elements, bisected = mesh.n_nodes, len(mesh.elements), len(given["tree"])
    shapes = {"parents": (n, 2), "marks": (elements,), "generation": (elements,), "forebear": (elements,),
              "tree": (bisected, columns_of_tree(mesh.dim))}
    for name, shape in shapes.items():
        if given[name].shape != shape:
            raise ValueError(f"history: {name} must have shape {shape}, got {given[name].shape}")
    most, corners, tree = _MOST_MARKS[mesh.dim], mesh.dim + 1, given["tree"]
    for name, values, below in (("parents", given["parents"], np.arange(n)[:, None] + 1),
                                ("marks", given["marks"], most + 1), ("generation", given["generation"], 2**15),
                                ("forebear", given["forebear"] + 1, bisected + 1), ("tree", tree[:, :corners], n),
                                ("tree", tree[:, corners], most + 1), ("tree", tree[:, -1], n),
                                ("tree", tree[:, corners + FOREBEAR] + 1, bisected + 1)):
        if not ((values >= 0) & (values < below)).all():
            raise ValueError(f"history: {name} holds numbers out of range; it is not of this mesh")
    used = given["forebear"][given["forebear"] >= 0]
    if not (mesh.elements[given["forebear"] >= 0] == tree[used, -1][:, None]).any(axis=1).all():
        raise ValueError("history: elements lack the node that bisection made them with; it is not of this mesh")
    return with_refinement(mesh, Refinement(**given))


def _whole(name: str, array: np.ndarray, dtype: type) -> np.ndarray:
    """A copy of an array of integers."""
    array = np.asarray(array)
    if array.dtype.kind not in "iu":
        raise ValueError(f"history: {name} must be an array of integers, got {array.dtype}")
    copy = array.astype(dtype)
    if not (copy == array).all():
        raise ValueError(f"history: {name} holds numbers out of range; it is not of this mesh")
    return copy
