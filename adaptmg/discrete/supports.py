r"""The nodes and dofs that supports and springs hold, also along directions that are not coordinate
axes.

With the projection :math:`Z_i` onto the directions along which inclined supports hold node i, and
the displacement :math:`\bar u` that supports prescribe, the unknowns :math:`w = u - \bar u`, which have
no parts along what is held, solve

.. math:: A' w = (I - Z)\,(b - A \bar u),\qquad A' = (I - Z)\,A\,(I - Z) + Z D Z.

In frames at the nodes whose first axes span what is held, A' is A with the rows and columns of
these local components decoupled, as those of dofs fixed along axes are. Turned back, it has
Cartesian components like all else, and solvers need not know of the frames. D has the size of the
diagonal blocks. Matrix, load and volumes of a problem are without any of this: the supports exert
:math:`Z (A u + B^T p - b)`, and the energy is :math:`u^T A u`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import NamedTuple, get_args

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.elasticity import nodal_matrix
from adaptmg.discrete.periodic import originals
from adaptmg.mesh.arrays import MeshArrays, Surface
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.loads import (
    AnySupport,
    FieldLike,
    PointSpring,
    PointSupport,
    Support,
    Symmetry,
    times,
)


@dataclass(frozen=True, eq=False)
class Inclined:
    """The nodes that supports hold along directions that are not axes. Their fixed components count
    among these."""

    nodes: np.ndarray  # (k,) int, ascending
    spans: np.ndarray  # (k, dim, dim): Z
    moved: Mapping[str, np.ndarray]  # (k, dim) by name in a load path: parts of ubar, m

    @classmethod
    @cache
    def none(cls, dim: int) -> Inclined:
        """Return no nodes: every direction that supports hold is an axis."""
        return cls(np.empty(0, dtype=np.int64), np.empty((0, dim, dim)), {})

    def __len__(self) -> int:
        return len(self.nodes)

    def at(self, nodes: np.ndarray) -> np.ndarray:
        """Return the projections (n, dim, dim) at some nodes, zero where no direction is held."""
        result = np.zeros((len(nodes), *self.spans.shape[1:]))
        if len(self):  # 10 us with no nodes, 16 times in a solve with four levels
            inclined = np.flatnonzero(np.isin(nodes, self.nodes))
            result[inclined] = self.spans[np.searchsorted(self.nodes, nodes[inclined])]
        return result

    def remove_held(self, vector: np.ndarray) -> None:
        """Remove from a vector (n_dofs,), in place, its parts along the directions that are held."""
        if len(self):  # 5 us with no nodes
            vector.reshape(-1, self.spans.shape[1])[self.nodes] -= self.along(vector)

    def along(self, vector: np.ndarray) -> np.ndarray:
        """Return the parts (k, dim) of a vector (n_dofs,) along the directions that are held."""
        return np.einsum(
            "nij,nj->ni", self.spans, vector.reshape(-1, self.spans.shape[1])[self.nodes]
        )

    def decoupled(self, matrix: sparse.bsr_array, stiffness: np.ndarray) -> sparse.bsr_array:
        """Return A' of a matrix A (n_dofs, n_dofs), with the ``stiffness`` (k,), N/m, of the nodes in D."""
        size = matrix.blocksize
        n = matrix.shape[0]
        held_stiffness = nodal_matrix(self.nodes, stiffness[:, None, None] * self.spans, n)
        held = nodal_matrix(self.nodes, self.spans, n)
        free = sparse.bsr_array(sparse.eye_array(n) - held, blocksize=size)
        # half of A'; its sum with its transpose is symmetric to the bit
        half = sparse.bsr_array(0.5 * (free @ matrix @ free + held_stiffness), blocksize=size)
        whole = sparse.bsr_array(half + half.T, blocksize=size).sorted_indices()
        return checks.indices_frozen(checks.narrowed(whole))


def node_at(mesh: MeshArrays, point: Sequence[float], body: str | None = None) -> int:
    """Return the node at a point; ValueError if there is none, or several bodies have one."""
    text = f"point {tuple(point)}"
    if len(point) != mesh.dim:
        raise ValueError(f"{text} has {len(point)} components on a {mesh.dim}D mesh")
    if body is not None and body not in mesh.bodies:
        raise ValueError(
            f"{text}: body {body!r} does not exist; the bodies are {', '.join(mesh.bodies)}"
        )
    elements = (
        mesh.elements
        if body is None
        else mesh.elements[mesh.element_body == mesh.bodies.index(body)]
    )
    nodes = np.unique(elements)
    away = np.linalg.norm(mesh.points[nodes] - point, axis=1)
    near = nodes[away <= checks.ALIKE * mesh.sides.max()]
    if not len(near):
        nearest = mesh.points[nodes[np.argmin(away)]]
        raise ValueError(
            f"{text}: no node of the mesh lies there, the nearest one {away.min():.3g} m away at "
            f"{tuple(nearest.tolist())}. Graded meshes of plane domains have a node at any point of a "
            "straight edge; otherwise take a point that is a node of every mesh"
        )
    if len(near) > 1:
        raise ValueError(
            f"{text}: {len(near)} nodes lie there, of bodies that touch (say body=...), or on both faces "
            "of a crack (take another point)"
        )
    return int(near[0])


def surfaces_of(mesh: MeshArrays, names: Iterable[str | None]) -> dict[str, Surface]:
    """Return the surfaces of some boundaries by name, each once."""
    return {name: mesh.surface(name) for name in dict.fromkeys(names) if name}


def supported_nodes(
    mesh: MeshArrays, support: AnySupport, surfaces: Mapping[str, Surface]
) -> np.ndarray:
    """Return the nodes (n,) that a support or spring holds."""
    if isinstance(support, PointSupport | PointSpring):
        return np.array([node_at(mesh, support.point, support.body)])
    return surfaces[support.boundary].nodes


class Held(NamedTuple):
    """A direction along which a support holds its nodes."""

    support: AnySupport
    direction: np.ndarray  # (dim,): unit vector
    axis: int | None  # None: it is not an axis
    nodes: np.ndarray  # (n,) int
    values: np.ndarray  # (n,): prescribed along it, m
    constant: bool  # whether they are the same on all meshes, and no function of position


def held_by(
    mesh: MeshArrays, supports: Sequence[AnySupport], surfaces: Mapping[str, Surface]
) -> list[Held]:
    """Return the directions that supports hold: components, and normals of plane boundaries."""
    axes = np.eye(mesh.dim)
    result = []
    for support in supports:
        directions: list[tuple[np.ndarray, int | None, FieldLike]] = []
        components = list(support.components(mesh.dim))
        # what is prescribed along the normal; of a spring, which prescribes nothing, ``normal`` is a stiffness
        normal = 0.0 if isinstance(support, Symmetry) else getattr(support, "normal", None)
        if isinstance(support, Support | Symmetry) and normal is not None:
            direction = _plane_normal(support.boundary, surfaces[support.boundary])
            axis = int(np.argmax(np.abs(direction)))
            if np.abs(direction[axis]) <= 1 - checks.ALIKE:
                directions.append((direction, None, normal))
            elif components[axis] is not None:
                raise ValueError(
                    f"the support on {support.boundary!r} prescribes {'xyz'[axis]}, which is its normal "
                    "displacement, twice: leave one out"
                )
            else:  # the normal is an axis, or minus one: the component along it is held
                components[axis] = times(normal, np.sign(direction[axis]))
        directions += [
            (axes[k], k, value) for k, value in enumerate(components) if value is not None
        ]
        if not directions:
            continue
        nodes = supported_nodes(mesh, support, surfaces)
        for direction, axis, value in directions:
            component = "" if axis is None else f"{'xyz'[axis]} of "
            name = f"{component}the support on {support.place!r}"
            values = checks.field(name, value, mesh.points[nodes])
            result.append(Held(support, direction, axis, nodes, values, not callable(value)))
    return result


def _plane_normal(boundary: str, surface: Surface) -> np.ndarray:
    """Return the unit normal (dim,) of a boundary whose normal a support holds; ValueError unless it is
    plane."""
    mean = surface.normals.mean(axis=0)
    normal = mean / np.linalg.norm(mean)
    if not (surface.normals @ normal).min() > 1 - checks.ALIKE:
        raise ValueError(
            f"the support on {boundary!r} holds its normal, and the boundary is not plane: "
            "name each of its plane parts"
        )
    return normal


def held_directions(holds: Sequence[Held]) -> dict[str, np.ndarray]:
    """Return by boundary the orthonormal directions (k, dim) along which supports hold it."""
    by_boundary: dict[str, list[np.ndarray]] = {}
    for hold in holds:
        if hold.support.boundary is not None:
            by_boundary.setdefault(hold.support.boundary, []).append(hold.direction)
    result = {}
    for name, directions in by_boundary.items():
        result[name] = np.array(sorted({tuple(direction.tolist()) for direction in directions}))
        if (np.abs(directions).max(axis=1) < 1.0).any():  # axes stay unchanged, to the bit
            _, sizes, rows = np.linalg.svd(result[name], full_matrices=False)
            result[name] = rows[sizes > checks.SIX_DIGITS]
    return result


def inclined_supports(points: np.ndarray, holds: Sequence[Held]) -> Inclined:
    """Return the nodes, of those at ``points`` (n_nodes, dim), that supports hold along directions other
    than axes; ValueError where values contradict."""
    oblique = [hold.nodes for hold in holds if hold.axis is None]
    if not oblique:
        return Inclined.none(points.shape[1])
    nodes = np.unique(np.concatenate(oblique))
    # at each node a row for each hold, zero where it does not act: rows times u are the values
    rows = np.zeros((len(nodes), len(holds), points.shape[1]))
    values = np.zeros((len(nodes), len(holds)))
    for k, hold in enumerate(holds):
        _, at, entries = np.intersect1d(nodes, hold.nodes, return_indices=True)
        rows[at, k] = hold.direction
        values[at, k] = hold.values[entries]
    # u = inverse values is the least one with rows u = values, if these agree
    inverse = np.linalg.pinv(rows, rcond=checks.SIX_DIGITS)
    contradiction = np.einsum("nsd,ndt,nt->ns", rows, inverse, values) - values
    contradicts = np.abs(contradiction).max(axis=1) > checks.ALIKE * np.abs(values).max()
    if contradicts.any():
        i = int(np.argmax(contradicts))
        names = dict.fromkeys(
            repr(holds[k].support.place) for k in np.flatnonzero(rows[i].any(axis=1)).tolist()
        )
        raise ValueError(
            f"the supports on {', '.join(names)} contradict each other at their common node {nodes[i]} "
            f"{tuple(points[nodes[i]].tolist())}: give them values that agree, or free one"
        )
    moved: dict[str, np.ndarray] = {}
    for k, hold in enumerate(holds):
        name = hold.support.path_name
        moved[name] = moved.get(name, 0.0) + inverse[:, :, k] * values[:, k, None]
    # Z = R^+ R, the projection onto the rows
    return Inclined(
        nodes, inverse @ rows, {name: part for name, part in moved.items() if part.any()}
    )


def held_components(points: np.ndarray, holds: Sequence[Held]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mask and the values (n_nodes, dim), m, zero where free, of the components that
    supports hold at points (n_nodes, dim); without those of nodes that they hold along other
    directions, see :func:`inclined_supports`. ValueError for two values of one component."""
    fixed = np.zeros(points.shape, dtype=bool)
    values = np.zeros(points.shape)
    hold_of_component = np.zeros(points.shape, dtype=np.int64)  # of fixed ones
    for k, hold in enumerate(holds):
        axis = hold.axis
        if axis is None:
            continue
        nodes = hold.nodes
        # two functions that prescribe the same may differ by rounding
        size = np.abs([hold.values, values[nodes, axis]]).max(initial=0.0)
        clash = fixed[nodes, axis] & (
            np.abs(hold.values - values[nodes, axis]) > checks.ALIKE * size
        )
        if clash.any():
            node = int(nodes[np.argmax(clash)])
            value = hold.values[np.argmax(clash)]
            other = holds[int(hold_of_component[node, axis])].support.place
            raise ValueError(
                f"supports on {other!r} and {hold.support.place!r} prescribe different {'xyz'[axis]} "
                f"displacements, {values[node, axis]:g} and {value:g} m, at their common node {node} "
                f"{tuple(points[node].tolist())}: give both the same value or free one"
            )
        fixed[nodes, axis] = True
        values[nodes, axis] = hold.values
        hold_of_component[nodes, axis] = k
    for hold in holds:
        if hold.axis is None:
            fixed[hold.nodes] = False
            values[hold.nodes] = 0.0
    return fixed, values


def fixed_dofs(mesh: MeshArrays, supports: Sequence[AnySupport]) -> tuple[np.ndarray, np.ndarray]:
    """Return the mask (n_dofs,) and values (n_dofs,), m, zero where free, of the prescribed dofs;
    without those of nodes that supports hold along directions that are not axes.

    Where two supports meet, they must agree or prescribe different components. ValueError for a
    boundary or point the mesh does not have, a z component in 2D, two values for one dof, or
    functions with values that are not finite.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> mask, values = am.discrete.fixed_dofs(mesh, [am.Support("bottom", y=-1e-5)])
    >>> int(mask.sum()), values.min().tolist()                                     # dofs; m
    (3, -1e-05)
    """
    points = checks.instance("mesh", mesh, MeshArrays).points
    supports = checks.items("supports", supports, get_args(AnySupport), "supports")
    surfaces = surfaces_of(mesh, (support.boundary for support in supports))
    fixed, values = held_components(points, held_by(mesh, supports, surfaces))
    return fixed.reshape(-1), values.reshape(-1)


# normals within 30 degrees of a plane of symmetry are put into it
_SYMMETRY_TILT = np.cos(np.pi / 6)


@dataclass(frozen=True, eq=False)
class Boundaries:
    """The boundaries of a problem on one mesh, and what supports hold of them; all that follows is
    computed when it is first read."""

    problem: ContactProblem
    mesh: MeshArrays

    @cached_property
    def surfaces(self) -> Mapping[str, Surface]:
        """Return the surfaces that contacts, ties and supports name."""
        problem = self.problem
        supported = (support.boundary for support in problem.supports)
        return surfaces_of(
            self.mesh, (*problem.pair_boundaries, *problem.tied_boundaries, *supported)
        )

    @cached_property
    def originals(self) -> np.ndarray | None:
        """Return the nodes (n_nodes,) of which others are images on periodic sides; None without any."""
        return originals(self.problem, self.mesh, self.surfaces)

    def images(self, nodes: np.ndarray, surface: np.ndarray, carries: np.ndarray) -> np.ndarray:
        """Return those of ``nodes`` (n,) on periodic sides that are images of nodes on a ``surface`` (k,) which
        may carry a condition, by the mask ``carries`` (n_nodes,): those where supports hold the same axes of
        both, and no other direction of either."""
        originals = nodes if self.originals is None else self.originals[nodes]
        inclined = self.inclined.nodes
        return nodes[
            np.isin(originals, surface)
            & carries[originals]
            & (self.fixed[nodes] == self.fixed[originals]).all(axis=1)
            & ~np.isin(nodes, inclined)
            & ~np.isin(originals, inclined)
        ]

    @cached_property
    def holds(self) -> Sequence[Held]:
        """Return the directions that supports hold, with nodes and values."""
        return held_by(self.mesh, self.problem.supports, self.surfaces)

    @cached_property
    def directions(self) -> Mapping[str, np.ndarray]:
        """Return by boundary the orthonormal directions (k, dim) along which supports hold it."""
        return held_directions(self.holds)

    @cached_property
    def held(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the mask and the values (n_nodes, dim), m, of the components that supports hold."""
        return held_components(self.mesh.points, self.holds)

    @property
    def fixed(self) -> np.ndarray:
        """Return the mask (n_nodes, dim) of the components that supports hold."""
        return self.held[0]

    @cached_property
    def inclined(self) -> Inclined:
        """Return the nodes that supports hold along directions that are not axes."""
        return inclined_supports(self.mesh.points, self.holds)

    def held_spans(self, nodes: np.ndarray) -> np.ndarray:
        """Return the projections (n, dim, dim) onto the directions along which supports hold
        nodes."""
        return self.fixed[nodes][:, :, None] * np.eye(self.mesh.dim) + self.inclined.at(nodes)

    def free_part(self, nodes: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Return vectors (n, dim) at some nodes without their parts along directions that supports
        hold."""
        result = np.where(self.fixed[nodes], 0.0, vectors)
        if len(self.inclined):  # 5 us with no nodes, 9 times in a solve with four levels
            result -= np.einsum("nij,nj->ni", self.inclined.at(nodes), vectors)
        return result

    def averaged_normals(self, surface: Surface) -> np.ndarray:
        """Return the averaged normals (n_nodes, dim) of a surface, without components along what
        supports hold where these are small."""
        normals = surface.mean_normals(self.originals)
        nodes = surface.nodes
        inside = self.free_part(nodes, normals[nodes])
        lengths = np.linalg.norm(inside, axis=1)
        tilted = lengths > _SYMMETRY_TILT
        normals[nodes[tilted]] = inside[tilted] / lengths[tilted, None]
        return normals

    @cached_property
    def outward(self) -> Sequence[np.ndarray]:
        """Return the normals (n, dim) at the nodes of each contact boundary."""
        result = []
        for name in self.problem.contact_boundaries:
            surface = self.surfaces[name]
            try:
                result.append(self.averaged_normals(surface)[surface.nodes])
            except ValueError as error:
                raise ValueError(f"contact boundary {name!r}: {error}") from error
        return result
