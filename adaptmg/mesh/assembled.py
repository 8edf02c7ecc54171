"""merged: meshes of several bodies as one mesh. The bodies share no nodes; arrays are concatenated body by body."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TypeVar

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.checks.check import check_mesh
from adaptmg.mesh.on_demand_source import sound_by_construction
from adaptmg.problem import checks

__all__ = ["boundaries_of", "merged", "per_body"]

Value = TypeVar("Value")


def merged(meshes: Mapping[str, MeshArrays]) -> MeshArrays:
    """One mesh of several bodies, each meshed apart.

    Parameters
    ----------
    meshes : mapping of str to MeshArrays
        The mesh of each body by its name, without "."; one body each, all of the same dimension.

    Returns
    -------
    MeshArrays
        Nodes, elements and facets of the first body come first, then those of the next; boundaries are called
        "body.boundary". Nodes at the same place stay apart. With its source.

    Raises
    ------
    TypeError, ValueError
        If ``meshes`` is empty or no mapping, on names with ".", meshes of several bodies, of different dimensions, or
        that are not sound (:func:`adaptmg.mesh.check_mesh`).
    """
    if not isinstance(meshes, Mapping):
        raise TypeError(f"meshes must map body names to MeshArrays, got {type(meshes).__name__}")
    if not meshes:
        raise ValueError("meshes is empty: give at least one body")
    for name, mesh in meshes.items():
        checks.boundary_name("the name of a body in meshes", name)
        if "." in name:
            raise ValueError(f"the name of a body must not contain '.', got {name!r}: boundaries are 'body.edge'")
        if not isinstance(mesh, MeshArrays):
            raise TypeError(f"meshes[{name!r}] must be MeshArrays, got {type(mesh).__name__}; as_mesh converts")
        if len(mesh.bodies) != 1:
            raise ValueError(f"meshes[{name!r}] has {len(mesh.bodies)} bodies ({', '.join(mesh.bodies)}); give the "
                             "mesh of each body apart")
    dims = {name: mesh.dim for name, mesh in meshes.items()}
    if len(set(dims.values())) > 1:
        raise ValueError(f"all meshes must have the same dimension, got {dims}")
    parts = list(meshes.values())
    nodes = _starts(mesh.n_nodes for mesh in parts)
    labels = _starts(len(mesh.boundaries) for mesh in parts)
    for mesh in parts:
        check_mesh(mesh)
    return sound_by_construction(MeshArrays(
        points=np.concatenate([mesh.points for mesh in parts]),
        elements=np.concatenate([mesh.elements + start for mesh, start in zip(parts, nodes, strict=True)]),
        facets=np.concatenate([mesh.facets + start for mesh, start in zip(parts, nodes, strict=True)]),
        facet_labels=np.concatenate([mesh.facet_labels + start for mesh, start in zip(parts, labels, strict=True)]),
        boundaries=tuple(f"{body}.{name}" for body, mesh in meshes.items() for name in mesh.boundaries),
        element_body=np.repeat(np.arange(len(parts)), [len(mesh.elements) for mesh in parts]), bodies=tuple(meshes)))


def _starts(counts: Iterable[int]) -> np.ndarray:
    """Where each of some concatenated parts begins."""
    return np.cumsum([0, *counts])[:-1]


def per_body(name: str, value: Value | Mapping[str, Value], bodies: Sequence[str]) -> dict[str, Value]:
    """An argument for each body.

    Parameters
    ----------
    name : str
        Of the argument, for messages.
    value : anything, or a mapping of str to it
        The same for all bodies, or one for each by its name.
    bodies : sequence of str

    Returns
    -------
    dict of str to the value
    """
    if not isinstance(value, Mapping):
        return dict.fromkeys(bodies, value)
    if set(value) != set(bodies):
        raise ValueError(f"{name} must name each body once: the bodies are {', '.join(map(repr, bodies))}, "
                         f"{name} names {', '.join(map(repr, value))}")
    return {body: value[body] for body in bodies}


def boundaries_of(body: str, names: Sequence[str]) -> tuple[str, ...]:
    """Those of the names "body.edge" that belong to a body, without "body."."""
    return tuple(name.removeprefix(f"{body}.") for name in names if name.startswith(f"{body}."))
