"""The nodes and dofs that supports and springs hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.loads import AnySupport, PointSpring, PointSupport, Support, Symmetry

_AT_POINT = 1e-9  # of the size of the mesh: nodes nearer to a point lie at it
_ALONG_AXIS = 1e-9


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
        raise ValueError(f"{text}: {len(near)} nodes lie there, of bodies that touch: say body=...")
    return int(near[0])


def supported_nodes(mesh: MeshArrays, support: AnySupport) -> np.ndarray:
    """Nodes (n,) that a support or spring holds."""
    if isinstance(support, PointSupport | PointSpring):
        return np.array([node_at(mesh, support.point, support.body)])
    return mesh.surface(support.boundary).nodes


def boundary_supports(mesh: MeshArrays, supports: Sequence[AnySupport]) -> list[Support]:
    """Supports that prescribe displacements on boundaries, planes of symmetry by the component that they prescribe."""
    return [one for one in _resolved(mesh, supports) if isinstance(one, Support)]


def held_components(mesh: MeshArrays, supports: Sequence[AnySupport]) -> dict[str, str]:
    """By boundary the components that supports prescribe, such as "xy"."""
    held: dict[str, str] = {}
    for support in boundary_supports(mesh, supports):
        components = "".join(c for c in "xyz" if getattr(support, c) is not None)
        held[support.boundary] = held.get(support.boundary, "") + components
    return held


def _resolved(mesh: MeshArrays, supports: Sequence[AnySupport]) -> list[AnySupport]:
    return [_of_symmetry(mesh, one) if isinstance(one, Symmetry) else one for one in supports]


def _of_symmetry(mesh: MeshArrays, symmetry: Symmetry) -> Support:
    along = np.abs(mesh.surface(symmetry.boundary).normals)
    axis = int(np.argmax(along[0]))
    if not along[:, axis].min() > 1 - _ALONG_AXIS:
        raise ValueError(f"symmetry on {symmetry.boundary!r}: the boundary must be plane and normal to a coordinate "
                         "axis; turn the geometry, or name that part of it")
    return Support(symmetry.boundary, **{"xyz"[axis]: 0.0})


def fixed_dofs(mesh: MeshArrays, supports: Sequence[AnySupport]) -> tuple[np.ndarray, np.ndarray]:
    """Mask (n_dofs,) and values (n_dofs,), m, zero where free, of the prescribed dofs.

    Where two supports meet, they must agree or prescribe different components. ValueError for a boundary or point the
    mesh does not have, a z component in 2D, two values for one dof, or functions with values that are not finite.
    """
    mask, all_values = np.zeros(mesh.points.size, dtype=bool), np.zeros(mesh.points.size)
    fixed, values = (array.reshape(mesh.points.shape) for array in (mask, all_values))
    origin = np.zeros(mesh.points.shape, dtype=np.int64)  # of fixed ones
    supports = _resolved(mesh, supports)
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
    return mask, all_values
