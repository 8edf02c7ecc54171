"""The nodes and dofs that supports and springs hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptmg import _checks as checks
from adaptmg.discrete.inclined import Inclined
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.load_path import name_in_path, times
from adaptmg.problem.loads import AnySupport, FieldLike, PointSpring, PointSupport, Support, Symmetry

_AT_POINT = 1e-9  # of the size of the mesh: nodes nearer to a point lie at it
_ALONG_AXIS = 1e-9  # of the cosine with an axis or a mean normal; of prescribed values


def node_at(mesh: MeshArrays, point: Sequence[float], body: str | None = None) -> int:
    """The node at a point; ValueError if there is none, or several bodies have one."""
    text = f"point {tuple(point)}"
    if body is not None and body not in mesh.bodies:
        raise ValueError(f"{text}: body {body!r} does not exist; the bodies are {', '.join(mesh.bodies)}")
    mine = mesh.elements if body is None else mesh.elements[mesh.element_body == mesh.bodies.index(body)]
    nodes = np.unique(mine)
    away = np.linalg.norm(mesh.points[nodes] - point, axis=1)
    near = nodes[away <= _AT_POINT * np.ptp(mesh.points, axis=0).max()]
    if not len(near):
        nearest = mesh.points[nodes[np.argmin(away)]]
        raise ValueError(f"{text}: no node of the mesh lies there, the nearest one {away.min():.3g} m away at "
                         f"{tuple(nearest.tolist())}. Graded meshes of plane domains have a node at any point of a "
                         "straight edge; otherwise take a point that is a node of every mesh")
    if len(near) > 1:
        raise ValueError(f"{text}: {len(near)} nodes lie there, of bodies that touch (say body=...), or on both faces "
                         "of a crack (take another point)")
    return int(near[0])


def supported_nodes(mesh: MeshArrays, support: AnySupport) -> np.ndarray:
    """Nodes (n,) that a support or spring holds."""
    if isinstance(support, PointSupport | PointSpring):
        return np.array([node_at(mesh, support.point, support.body)])
    return mesh.surface(support.boundary).nodes


def boundary_supports(mesh: MeshArrays, supports: Sequence[AnySupport]) -> list[Support]:
    """Supports that prescribe components on boundaries, planes of symmetry by the component that they prescribe."""
    return [one for one in _resolved(mesh, supports)[0] if isinstance(one, Support)]


def held_directions(mesh: MeshArrays, supports: Sequence[AnySupport]) -> dict[str, np.ndarray]:
    """By boundary the orthonormal directions (k, dim) along which supports hold it."""
    plain, rollers = _resolved(mesh, supports)
    found: dict[str, list[np.ndarray]] = {}
    for one in plain:
        if isinstance(one, Support):
            found.setdefault(one.boundary, []).extend(
                np.eye(mesh.dim)[k] for k, value in enumerate(one.components(mesh.dim)) if value is not None)
    for roller in rollers:
        found.setdefault(roller.support.place, []).append(roller.direction)
    result = {}
    for name, directions in found.items():
        _, sizes, rows = np.linalg.svd(np.array(directions), full_matrices=False)
        plain_axes = (np.abs(directions).max(axis=1) == 1.0).all()
        result[name] = np.unique(directions, axis=0) if plain_axes else rows[sizes > _PARALLEL]
    return result


@dataclass(frozen=True)
class _Roller:
    """A support along the normal of its boundary, which is no axis."""

    support: Support
    direction: np.ndarray  # (dim,)
    value: FieldLike


def _resolved(mesh: MeshArrays, supports: Sequence[AnySupport]) -> tuple[list[AnySupport], list[_Roller]]:
    """Supports that prescribe components, planes of symmetry among them; and those along other normals."""
    plain, rollers = [], []
    for one in supports:
        if isinstance(one, Symmetry):
            one = Support(one.boundary, normal=0.0)
        if not isinstance(one, Support) or one.normal is None:
            plain.append(one)
            continue
        normals = mesh.surface(one.boundary).normals
        direction = normals.mean(axis=0)
        direction /= np.linalg.norm(direction)
        if not (normals @ direction).min() > 1 - _ALONG_AXIS:
            raise ValueError(f"the support on {one.boundary!r} holds its normal, and the boundary is not plane: name "
                             "each of its plane parts")
        axis = int(np.argmax(np.abs(direction)))
        if np.abs(direction[axis]) > 1 - _ALONG_AXIS:
            along = {"xyz"[axis]: times(one.normal, np.sign(direction[axis]))}
            if getattr(one, "xyz"[axis]) is not None:
                raise ValueError(f"the support on {one.boundary!r} prescribes {'xyz'[axis]}, which is its normal "
                                 "displacement, twice: leave one out")
            plain.append(replace(one, normal=None, **along))
        else:
            rollers.append(_Roller(one, direction, one.normal))
            if any(value is not None for value in one.components(mesh.dim)):
                plain.append(replace(one, normal=None))
    return plain, rollers


_PARALLEL = 1e-6  # directions that differ by less count as one


def inclined_supports(mesh: MeshArrays, supports: Sequence[AnySupport]) -> Inclined | None:
    """The nodes that supports hold along directions that are no axes; ValueError where their values contradict."""
    plain, rollers = _resolved(mesh, supports)
    if not rollers:
        return None
    dim, nodes = mesh.dim, np.unique(np.concatenate([mesh.surface(one.support.boundary).nodes for one in rollers]))
    held = [(one, supported_nodes(mesh, one), np.eye(dim)[d], value) for one in plain
            for d, value in enumerate(one.components(dim)) if value is not None]
    held += [(one.support, supported_nodes(mesh, one.support), one.direction, one.value) for one in rollers]
    rows, values = np.zeros((len(nodes), len(held), dim)), np.zeros((len(nodes), len(held)))
    for k, (support, own, direction, value) in enumerate(held):
        own = np.intersect1d(own, nodes)
        at = np.searchsorted(nodes, own)
        rows[at, k] = direction
        values[at, k] = checks.field(f"the support on {support.place!r}", value, mesh.points[own])
    inverse = np.linalg.pinv(rows, rcond=_PARALLEL)
    given = np.einsum("nds,ns->nd", inverse, values)
    left = np.abs(np.einsum("nsd,nd->ns", rows, given) - values).max(axis=1)
    wrong = left > _ALONG_AXIS * np.abs(values).max()
    if wrong.any():
        node = int(nodes[np.argmax(wrong)])
        names = dict.fromkeys(repr(held[k][0].place) for k in np.flatnonzero(rows[np.argmax(wrong)].any(axis=1)))
        raise ValueError(f"the supports on {', '.join(names)} contradict each other at their common node {node} "
                         f"{tuple(mesh.points[node].tolist())}: give them values that agree, or free one")
    moved: dict[str, np.ndarray] = {}
    for k, (support, *_) in enumerate(held):
        name = name_in_path(support)
        moved[name] = moved.get(name, 0.0) + inverse[:, :, k] * values[:, k, None]
    return Inclined(nodes, inverse @ rows, {name: part for name, part in moved.items() if part.any()})


def fixed_dofs(mesh: MeshArrays, supports: Sequence[AnySupport]) -> tuple[np.ndarray, np.ndarray]:
    """Mask (n_dofs,) and values (n_dofs,), m, zero where free, of the prescribed dofs; without those of nodes that
    supports hold along other directions, see :func:`inclined_supports`.

    Where two supports meet, they must agree or prescribe different components. ValueError for a boundary or point the
    mesh does not have, a z component in 2D, two values for one dof, or functions with values that are not finite.
    """
    mask, all_values = np.zeros(mesh.points.size, dtype=bool), np.zeros(mesh.points.size)
    fixed, values = (array.reshape(mesh.points.shape) for array in (mask, all_values))
    origin = np.zeros(mesh.points.shape, dtype=np.int64)  # of fixed ones
    supports, rollers = _resolved(mesh, supports)
    for k, support in enumerate(supports):
        nodes = supported_nodes(mesh, support)
        for d, value in enumerate(support.components(mesh.dim)):
            if value is None:
                continue
            name = f"{'xyz'[d]} of the support on {support.place!r}"
            prescribed = checks.field(name, value, mesh.points[nodes])
            clash = fixed[nodes, d] & (values[nodes, d] != prescribed)
            if clash.any():
                node, here = int(nodes[np.argmax(clash)]), prescribed[np.argmax(clash)]
                other = supports[origin[node, d]].place
                raise ValueError(f"supports on {other!r} and {support.place!r} prescribe different {'xyz'[d]} "
                                 f"displacements, {values[node, d]:g} and {here:g} m, at their common node {node} "
                                 f"{tuple(mesh.points[node].tolist())}: give both the same value or free one")
            fixed[nodes, d], values[nodes, d], origin[nodes, d] = True, prescribed, k
    for roller in rollers:
        nodes = mesh.surface(roller.support.boundary).nodes
        fixed[nodes], values[nodes] = False, 0.0
    return mask, all_values
