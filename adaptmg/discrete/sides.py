"""Sides of pairs: which boundary carries the contact nodes.

The master's displacement enters that of the slave (:doc:`/theory/mortar`). Where the slave is much
stiffer than the master, the master's nodes are as stiff as the slave along the surface and soft
across it, which no smoother of single nodes reduces quickly. Cycles with the slave k times stiffer,
of a block on a block and of the dovetail: k = 1 8 and 10, 3 9 and 11, 10 11 and 15, 30 15 and 44,
1000 27 and 34, both ending in the active set method; the other way 8 at any k.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from adaptmg.discrete.moduli import body_materials
from adaptmg.mesh.arrays import MeshArrays, mask_of
from adaptmg.problem import ContactPair, ContactProblem
from adaptmg.problem.laws import Elastic

#: ratio of Young's moduli from which on cycles become more, and up to which the finer side is the slave, not the softer
STIFFER, ALIKE = 10.0, 2.0


def young_of(mesh: MeshArrays, materials: Sequence[Elastic], nodes: np.ndarray) -> float:
    """Return the smallest Young's modulus of the bodies with a boundary of these nodes, Pa."""
    touches = mask_of(nodes, mesh.n_nodes)
    # of elements with as many of these nodes as a facet has
    bodies = np.unique(mesh.element_body[touches[mesh.elements].sum(axis=1) >= mesh.dim])
    return min(materials[body].young for body in bodies)


def with_sides(problem: ContactProblem, mesh: MeshArrays) -> ContactProblem:
    """Choose the sides of pairs that leave the choice open: the softer side is the slave, of sides about
    as stiff (``ALIKE``) the finer one; as given where that cannot be exchanged. Returns the problem
    itself where no pair leaves it open."""
    open_pairs = [
        pair for pair in problem.contact if isinstance(pair, ContactPair) and pair.sides == "auto"
    ]
    if not open_pairs:
        return problem
    materials = body_materials(mesh, problem.material)
    contact = []
    for pair in problem.contact:
        if pair in open_pairs:
            slave = mesh.surface(pair.slave)
            master = mesh.surface(pair.master)
            ratio = young_of(mesh, materials, slave.nodes) / young_of(mesh, materials, master.nodes)
            # of sides about as stiff the finer one is the slave; 1e-6, beyond rounding, lets equal ones stay
            if 1 / ALIKE <= ratio <= ALIKE:
                ratio = slave.measures.mean() / master.measures.mean() / (1 + 1e-6)
            exchanged = (
                {"slave": pair.master, "master": pair.slave}
                if ratio > 1 and exchangeable(problem, pair)
                else {}
            )
            pair = replace(pair, sides="given", **exchanged)
        contact.append(pair)
    return replace(problem, contact=tuple(contact))


def exchangeable(problem: ContactProblem, pair: ContactPair) -> bool:
    """Return whether the master of a pair may carry the contact nodes: no other pair, tie or support
    has its boundary."""
    others = [other for other in problem.contact if other is not pair]
    return pair.master not in (
        *problem.tied_boundaries,
        *(support.boundary for support in problem.supports),
        *(other.boundary for other in others),
        *(other.master for other in others if isinstance(other, ContactPair)),
    )
