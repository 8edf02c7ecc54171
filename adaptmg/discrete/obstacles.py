r"""Contact nodes in front of rigid obstacles, and what supports hold of them.

A support that holds a part of the normal of a node leaves it the rest: with the projection P onto
what is free, and the displacement :math:`\bar u` that supports prescribe along the other
directions, the node goes towards the obstacle along :math:`P n / |P n|`, at the gap :math:`(g - n
\cdot \bar u) / |P n|`. Where they hold all of it there is no contact; the motion that they prescribe
must end before the obstacle. The force of contact is that along
:math:`P n`: the rest goes into the support, and counts as its reaction.

Node j takes over neighbours i without a condition with the shares :math:`V_{ji} = E_{ji} w_i / w_j` of
:mod:`adaptmg.discrete.posed`. Its condition is that on the sums :math:`u_j + \sum_i V_{ji} u_i` and
:math:`g_j + \sum_i V_{ji} g_i`; motions of supports and obstacles are summed likewise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import cast

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.mortar import MortarInterface, taken_over
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.supports import Boundaries
from adaptmg.mesh.arrays import mask_of
from adaptmg.problem.contact_problem import Contact
from adaptmg.problem.surfaces import ContactPair, Moving, Obstacle, Rigid


def in_front_of(boundaries: Boundaries, k: int, owner: np.ndarray) -> MortarInterface:
    """Return the interface of a rigid obstacle and the nodes of contact boundary k whose ``owner``
    (n_nodes,), the number of a contact, is k."""
    problem = boundaries.problem
    mesh = boundaries.mesh
    contact = cast("Contact", problem.contact[k])
    surface = boundaries.surfaces[contact.boundary]
    nodes = surface.nodes
    normals, given_gaps = facing_obstacle(
        contact.obstacle, contact.boundary, mesh.points[nodes], boundaries.outward[k]
    )
    # overlaps within rounding count as 0
    rounding = checks.ROUNDING * np.linalg.norm(mesh.sides)
    gaps = np.where((given_gaps < 0) & (given_gaps > -rounding), 0.0, given_gaps)
    if gaps.min(initial=0.0) < 0 and not may_overlap(contact):
        deepest = int(np.argmin(gaps))
        raise ValueError(
            f"contact boundary {contact.boundary!r} lies up to {-gaps[deepest]:.6g} m behind its "
            f"obstacle, at {tuple(mesh.points[nodes[deepest]].tolist())}: move the obstacle, or say "
            "allow_interference=True for an interference fit"
        )
    free = free_normals(boundaries, k, normals)
    movable = (np.linalg.norm(free, axis=1) > checks.ALIKE) & (owner[nodes] == k)
    weights = surface.lumped(problem.axisymmetric)[nodes[movable]]
    distances = gaps[movable]
    taken = None
    if not movable.all():  # on few meshes
        carries = mask_of(nodes[movable], mesh.n_nodes)
        # a coupling W stands for u - W u: here it is -V
        taken = taken_over(surface, carries, problem.axisymmetric)
        taken = sparse.csr_array(sparse.diags_array(1 / weights) @ taken[nodes[movable]])
        distances = distances + taken[:, nodes] @ gaps
    scaled, distances = along_free(free[movable], normals[movable], distances)
    return MortarInterface(
        nodes=nodes[movable],
        normals=scaled,
        weights=weights,
        gaps=distances,
        coupling=None if taken is None or not taken.nnz else -taken,
        taken_over=taken,
    )


def check_held(
    boundaries: Boundaries,
    discrete: DiscreteProblem,
    places: Mapping[int, Moving] | None = None,
) -> None:
    """Raise ValueError if supports hold nodes in a load step inside an obstacle, in its place of
    this step: that of ``places``, by the number of the contact, else its first one."""
    points = boundaries.mesh.points
    prescribed = discrete.fixed_values.reshape(points.shape)
    for k, contact in enumerate(boundaries.problem.contact):
        if contact.allow_interference or isinstance(contact, ContactPair):
            continue
        obstacle = (places or {}).get(k, _obstacle_of(contact))
        if not prescribed.any() and not isinstance(obstacle, Moving):
            continue  # nothing has moved since the initial gaps were checked
        nodes = boundaries.surfaces[contact.boundary].nodes
        normals, gaps = facing_obstacle(
            obstacle, contact.boundary, points[nodes], boundaries.outward[k]
        )
        free = boundaries.free_part(nodes, normals)
        normal_motion = np.einsum("nd,nd->n", normals, prescribed[nodes])
        # where something of the normal is free the node gives way to the obstacle
        held = np.linalg.norm(free, axis=1) <= checks.ALIKE
        beyond = np.where(held, normal_motion - gaps, 0.0)
        i = int(np.argmax(beyond))
        if beyond[i] > checks.ROUNDING * (
            np.abs([normal_motion[i], gaps[i]]).max() + boundaries.mesh.sides.max()
        ):
            raise ValueError(
                f"a support holds node {nodes[i]} of contact boundary {contact.boundary!r} "
                f"{beyond[i]:.6g} m inside its obstacle: move the support less, or the obstacle"
            )


def facing_obstacle(
    obstacle: Obstacle, boundary: str, points: np.ndarray, normals: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the normals (n, dim) and gaps (n,) of an obstacle, perhaps user-defined, at points of a
    boundary with outward ``normals``, checked."""
    answer = obstacle.contact(points, normals)
    name = f"the obstacle in front of {boundary!r}"
    if not isinstance(answer, (tuple, list)) or len(answer) != 2:
        raise TypeError(f"{name} must return normals and gaps, got {checks.shown(answer)}")
    directions = checks.array(f"{name}: its normals", answer[0], points.shape)
    lengths = np.linalg.norm(directions, axis=1)
    if len(points) and not np.abs(lengths - 1).max() <= checks.SIX_DIGITS:
        raise ValueError(
            f"{name} must return normals of length 1, got {lengths[np.argmax(np.abs(lengths - 1))]:.6g}"
        )
    return directions, checks.vector(f"{name}: its gaps", answer[1], len(points))


def along_free(
    free: np.ndarray, normals: np.ndarray, gaps: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return normals (n, dim) over the length of their free parts (n, dim), and gaps (n,) along
    these; unchanged where supports hold nothing or all of a normal."""
    # n / |P n| and g / |P n|
    length = np.linalg.norm(free, axis=1)
    length[(length <= checks.ALIKE) | (free == normals).all(axis=1)] = 1.0
    return normals / length[:, None], gaps / length


def free_normals(boundaries: Boundaries, k: int, normals: np.ndarray) -> np.ndarray:
    """Return the normals (n, dim) at the nodes of contact boundary k without their parts along
    directions that supports hold there.

    ValueError if a support on the boundary itself holds a part of them, which cannot be meant."""
    boundary = boundaries.problem.contact[k].boundary
    nodes = boundaries.surfaces[boundary].nodes
    directions = boundaries.directions.get(boundary, normals[:0])
    clash = (np.abs(normals @ directions.T) > checks.ALIKE).any(axis=1)
    if clash.any():
        i = int(np.argmax(clash))
        raise ValueError(
            f"the support on {boundary!r} fixes a component with a part normal to contact boundary "
            f"{boundary!r}, at node {nodes[i]} {tuple(boundaries.mesh.points[nodes[i]].tolist())}: contact could "
            "never open there; free that component, or name another boundary"
        )
    return boundaries.free_part(nodes, normals)


def may_overlap(contact: Contact | ContactPair) -> bool:
    """Return whether initial gaps may be negative."""
    return contact.allow_interference or (
        isinstance(contact, Contact) and isinstance(_obstacle_of(contact), Moving)
    )


def _obstacle_of(contact: Contact) -> Obstacle:
    """Return the obstacle in the place of a discretisation: moved as prescribed, not yet pressed."""
    return contact.obstacle.obstacle if isinstance(contact.obstacle, Rigid) else contact.obstacle


def with_motions(
    boundaries: Boundaries, nodes: np.ndarray, taken: sparse.csr_array | None, boundary: np.ndarray
) -> np.ndarray:
    """Return the slip reference (n_contact, dim), m, of contact ``nodes`` (n_contact,) on boundaries with
    the numbers ``boundary`` (n_contact,): the motion of the obstacle at each, plus that at the nodes
    that it takes over by the shares ``taken`` (n_contact, n_nodes)."""
    points = boundaries.mesh.points
    slip_reference = np.zeros((len(nodes), boundaries.mesh.dim))
    for k, contact in enumerate(boundaries.problem.contact):
        obstacle = None if isinstance(contact, ContactPair) else _obstacle_of(contact)
        if isinstance(obstacle, Moving):
            rows = boundary == k
            slip_reference[rows] += obstacle.motion(points[nodes[rows]])
            if taken is not None:
                neighbours = np.unique(taken[rows].indices)
                slip_reference[rows] += taken[rows][:, neighbours] @ obstacle.motion(
                    points[neighbours]
                )
    return slip_reference


def moved(
    boundaries: Boundaries,
    discrete: DiscreteProblem,
    now: Mapping[int, Moving],
    before: Mapping[int, Moving],
) -> DiscreteProblem:
    """Return the problem with obstacles, by the number of their contact, in the places ``now``.

    The slip of this step counts from where they were ``before``: their motion since then is added to
    the slip references.
    """
    contact = discrete.contact
    normals = contact.normals.copy()
    gaps = contact.gaps.copy()
    reference = contact.slip_reference.copy()
    prescribed = discrete.fixed_values.reshape(discrete.n_nodes, -1)
    for k, obstacle in now.items():
        rows = np.flatnonzero(contact.boundary == k)
        boundary = boundaries.problem.contact[k].boundary
        nodes = boundaries.surfaces[boundary].nodes
        points = boundaries.mesh.points[nodes]
        facing_normals, facing_gaps = facing_obstacle(
            obstacle, boundary, points, boundaries.outward[k]
        )
        place = np.searchsorted(nodes, contact.nodes[rows])
        # V; where no node takes over others it is stored without columns
        taken = contact.taken_over[rows]
        taken = taken[:, nodes] if taken.nnz else sparse.csr_array((len(rows), len(nodes)))
        scaled, distances = along_free(
            boundaries.free_part(contact.nodes[rows], facing_normals[place]),
            facing_normals[place],
            facing_gaps[place] + taken @ facing_gaps,
        )
        normals[rows] = boundaries.free_part(contact.nodes[rows], scaled)
        # the part of the normal that supports hold closes the gap by what they prescribe
        shift = prescribed[nodes[place]] + taken @ prescribed[nodes]
        gaps[rows] = distances - np.einsum("nd,nd->n", scaled - normals[rows], shift)
        motion = obstacle.motion(points) - before[k].motion(points)
        reference[rows] += motion[place] + taken @ motion
    are_turned = np.abs(normals - contact.normals).max(initial=0.0) > checks.ROUNDING
    new = replace(
        contact,
        normals=normals if are_turned else contact.normals,
        gaps=gaps,
        slip_reference=reference,
        allow_interference=True,  # an obstacle may move into the body, and be pressed out of it
    )
    # what was computed of contact frames stays as long as normals do
    return discrete.restructured(contact=new) if are_turned else discrete.posing(contact=new)
