r"""Sides of pairs and ties: which boundary carries the contact nodes, and boundaries that move
together.

The master's displacement enters that of the slave (:doc:`/theory/mortar`). Where the slave is much
stiffer than the master, the master's nodes are as stiff as the slave along the surface and soft
across it, which no smoother of single nodes reduces quickly. Cycles with the slave k times stiffer,
of a block on a block and of the dovetail: k = 1 8 and 10, 3 9 and 11, 10 11 and 15, 30 15 and 44,
1000 27 and 34, both ending in the active set method; the other way 8 at any k.

A tied slave node follows the combination of master nodes that it faces, in all components: its
relative displacement (:mod:`adaptmg.discrete.coordinates`) is fixed to zero, on every level. It is
contact that sticks and never opens. Where surfaces lie on each other constant stresses pass
exactly, and rigid motions strain nothing; across a gap g a rotation
:math:`\omega` strains by :math:`\omega \times g`. What the slave bears at node j is the force
:math:`\lambda_j = (\hat A w - \hat b)_j` of its relative displacement; the master bears :math:`-W^T \lambda`. Along
what a support holds of a slave node the support takes its part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from scipy import sparse

from adaptmg._text import warn_user
from adaptmg.discrete.coordinates import Coupling, Unknowns
from adaptmg.discrete.moduli import body_materials
from adaptmg.discrete.mortar import MortarInterface, pair_interface
from adaptmg.discrete.supports import HeldNodes
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import ContactPair, ContactProblem
from adaptmg.problem.surfaces import Periodic, Tied

#: ratio of Young's moduli from which cycles suffer, and up to which the finer side counts, not the softer one
STIFFER, ALIKE = 10.0, 2.0
_OFFSET = 1e-6  # of the size of the mesh: how far a partner on the other side of a cell may lie off its place


def stiffness_ratio(problem: ContactProblem, mesh: MeshArrays, pair: ContactPair) -> float:
    """Return Young's modulus of the slave's body over that of the master's."""
    return young_of(problem, mesh, pair.slave) / young_of(problem, mesh, pair.master)


def young_of(problem: ContactProblem, mesh: MeshArrays, boundary: str) -> float:
    """Return the smallest Young's modulus of the bodies with a boundary, Pa."""
    touches = np.zeros(mesh.n_nodes, dtype=bool)
    touches[mesh.boundary_nodes(boundary)] = True
    materials = body_materials(mesh, problem.material)
    bodies = np.unique(mesh.element_body[touches[mesh.elements].sum(axis=1) >= mesh.dim])
    return min(materials[body].young for body in bodies)


def with_sides(problem: ContactProblem, mesh: MeshArrays) -> ContactProblem:
    """Choose the sides of pairs that leave the choice open; return the problem itself where none
    does."""
    free = [
        pair for pair in problem.contact if isinstance(pair, ContactPair) and pair.sides == "auto"
    ]
    if not free:
        return problem
    problem.check_boundaries(mesh.boundaries)
    problem.check_bodies(mesh.bodies)
    held = [*problem.tied_boundaries, *(support.boundary for support in problem.supports)]
    contact = []
    for pair in problem.contact:
        if pair in free:
            ratio = stiffness_ratio(problem, mesh, pair)
            if 1 / ALIKE <= ratio <= ALIKE:
                slave, master = (
                    mesh.surface(name).measures.mean() for name in (pair.slave, pair.master)
                )
                ratio = slave / master / (1 + 1e-6)  # equal sizes do not change places
            # a master of several pairs, or one that a tie or a support holds, cannot carry the
            # contact nodes
            bound = [
                *held,
                *(
                    name
                    for other in problem.contact
                    if other is not pair
                    for name in (other.boundary, getattr(other, "master", ""))
                ),
            ]
            sides = (
                {"slave": pair.master, "master": pair.slave}
                if ratio > 1 and pair.master not in bound
                else {}
            )
            pair = replace(pair, sides="given", **sides)
        contact.append(pair)
    return replace(problem, contact=tuple(contact))


@dataclass(frozen=True, eq=False)
class TieForces:
    """Forces that ties exert on both bodies."""

    node: np.ndarray  # (n,) int
    force: np.ndarray  # (n, dim), N
    boundary: np.ndarray  # (n,) int: index into names
    names: tuple[str, ...]  # of the slave and the master of each tie

    def on(self, boundary: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the nodes and forces on one boundary."""
        own = np.isin(self.boundary, [k for k, name in enumerate(self.names) if name == boundary])
        return self.node[own], self.force[own]

    def total(self, n_nodes: int) -> np.ndarray:
        """Return the forces (n_nodes, dim) of all ties."""
        result = np.zeros((n_nodes, self.force.shape[1]))
        np.add.at(result, self.node, self.force)
        return result


def tie_interfaces(
    ties: Sequence[Tied | Periodic], mesh: MeshArrays, held: HeldNodes, axisymmetric: bool
) -> list[MortarInterface]:
    """Return the tied slave nodes of each tie. Nodes on several belong to the tie named first; what
    supports hold in all directions is not tied."""
    if not ties:
        return []
    taken = np.all(held.fixed, axis=1)
    if held.inclined is not None:  # a support that moves such a node prescribes it
        taken[held.inclined.nodes[held.inclined.moving]] = True
    parts = []
    for tie in ties:
        if isinstance(tie, Periodic):
            parts.append(_periodic(tie, mesh, taken, held.fixed))
            taken[parts[-1].nodes] = True
            continue
        pair = ContactPair(tie.slave, tie.master, reach=tie.reach, allow_interference=True)
        own = mesh.surface(tie.slave).nodes
        try:
            parts.append(
                pair_interface(
                    mesh, pair, held=held, excluded=own[taken[own]], axisymmetric=axisymmetric
                )
            )
        except ValueError as error:
            raise ValueError(str(error).replace("contact pair", "tie", 1)) from error
        if tie.reach is None:
            _warn_of_gaps(tie, mesh, np.abs(parts[-1].gaps).max(initial=0.0))
        taken[parts[-1].nodes] = True
    return parts


def _warn_of_gaps(tie: Tied, mesh: MeshArrays, apart: float) -> None:
    """Warn of surfaces that are farther apart than an element, as where a body is misplaced."""
    if apart > np.ptp(mesh.points[mesh.surface(tie.slave).facets], axis=1).max():
        warn_user(
            f"tie {tie.slave!r} on {tie.master!r}: the surfaces are up to {apart:.3g} m apart, more than an "
            "element, and rotations strain the bodies by that distance. Check their positions (m), or give "
            "reach= where it is meant"
        )


def _periodic(
    tie: Periodic, mesh: MeshArrays, taken: np.ndarray, fixed: np.ndarray
) -> MortarInterface:
    """Nodes of a side of a cell, each with its partner on the other one."""
    slave = mesh.surface(tie.slave).nodes
    master = mesh.surface(tie.master).nodes
    points = mesh.points
    size = mesh.sides.max()
    middle = [
        0.5 * (points[side].max(axis=0) + points[side].min(axis=0)) for side in (slave, master)
    ]
    shift = middle[0] - middle[1]
    from scipy.spatial import cKDTree  # a first solve without it starts sooner

    # scipy-stubs: of several points
    found = cKDTree(points[master]).query(points[slave] - shift)
    away, partner = cast("tuple[np.ndarray, np.ndarray]", found)
    if len(slave) != len(master) or away.max() > _OFFSET * size:
        i = int(np.argmax(away))
        raise ValueError(
            f"periodic sides {tie.master!r} and {tie.slave!r} do not match: {len(master)} and "
            f"{len(slave)} nodes, and the partner of node {slave[i]} {tuple(points[slave[i]].tolist())} "
            f"lies {away[i]:.3g} m off. Take a structured mesh, or one with sides made alike"
        )
    alone = (fixed[slave] & ~fixed[master[partner]]).any(axis=1)
    if alone.any():
        i = int(np.argmax(alone))
        raise ValueError(
            f"a support holds node {slave[i]} {tuple(points[slave[i]].tolist())} of periodic side "
            f"{tie.slave!r}, and not its partner, which would move apart from it: hold the partner at "
            f"{tuple(points[master[partner[i]]].tolist())}, which this node follows"
        )
    free = ~taken[slave]
    slave = slave[free]
    partner = master[partner[free]]
    rows = sparse.csr_array(
        (np.ones(len(slave)), partner, np.arange(len(slave) + 1)), shape=(len(slave), len(points))
    )
    return MortarInterface(
        slave, np.zeros((len(slave), mesh.dim)), np.ones(len(slave)), np.zeros(len(slave)), rows
    )


def jump_of(tie: Tied | Periodic, nodes: np.ndarray, held: HeldNodes) -> np.ndarray:
    """Return the relative displacement (n, dim) of tied nodes, m, zero along what supports hold."""
    jump = getattr(tie, "jump", None) or (0.0,) * held.fixed.shape[1]
    return held.free_part(nodes, np.broadcast_to(jump, (len(nodes), len(jump))))


def tie_forces(problem: Unknowns, residual: np.ndarray) -> TieForces | None:
    """Return the forces of the ties of a problem with the residual A w - b (n_dofs,), N; None
    without ties."""
    if not problem.ties:
        return None
    at = residual.reshape(-1, problem.dim)
    held = problem.held.reshape(-1, problem.dim)
    nodes = []
    forces = []
    boundary = []
    names = []
    for slave, master, tied in problem.ties:
        own = np.where(held[tied], 0.0, at[tied])
        own = own if problem.inclined is None else problem.inclined.free_part(tied, own)
        # ties are rows of a coupling
        rows = sparse.csr_array(cast("Coupling", problem.coupling).weights[tied])
        facing = np.unique(rows.indices)
        nodes += [tied, facing]
        forces += [own, -(rows.T @ own)[facing]]
        boundary += [np.full(len(tied), len(names)), np.full(len(facing), len(names) + 1)]
        names += [slave, master]
    return TieForces(*map(np.concatenate, (nodes, forces, boundary)), names=tuple(names))
