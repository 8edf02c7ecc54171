"""Which side of a pair carries the contact nodes.

The master's displacement enters that of the slave (:doc:`/theory/mortar`). Where the slave is much stiffer than the
master, the master's nodes are as stiff as the slave along the surface and soft across it, which no smoother of single
nodes reduces quickly. Cycles with the slave k times stiffer, of a block on a block and of the dovetail: k = 1 8 and 10,
3 9 and 11, 10 11 and 15, 30 15 and 44, 1000 27 and 34, both ending in the active set method; the other way 8 at any k.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from adaptmg.discrete.elasticity import body_materials
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import ContactPair, ContactProblem

#: ratio of Young's moduli from which cycles suffer, and up to which the finer side counts, not the softer one
STIFFER, ALIKE = 10.0, 2.0


def stiffness_ratio(problem: ContactProblem, mesh: MeshArrays, pair: ContactPair) -> float:
    """Return Young's modulus of the slave's body over that of the master's."""
    return _young(problem, mesh, pair.slave) / _young(problem, mesh, pair.master)


def _young(problem: ContactProblem, mesh: MeshArrays, boundary: str) -> float:
    touches = np.zeros(mesh.n_nodes, dtype=bool)
    touches[mesh.boundary_nodes(boundary)] = True
    materials = body_materials(mesh, problem.material)
    bodies = np.unique(mesh.element_body[touches[mesh.elements].sum(axis=1) >= mesh.dim])
    return min(materials[body].young for body in bodies)


def with_sides(problem: ContactProblem, mesh: MeshArrays) -> ContactProblem:
    """Choose the sides of pairs that leave the choice open; return the problem itself where none does."""
    if not any(isinstance(pair, ContactPair) and pair.sides == "auto" for pair in problem.contact):
        return problem
    problem.check_boundaries(mesh.boundaries)
    problem.check_bodies(mesh.bodies)
    return replace(problem, contact=tuple(_chosen(problem, mesh, pair) for pair in problem.contact))


def _chosen(problem: ContactProblem, mesh: MeshArrays, pair: object) -> object:
    if not isinstance(pair, ContactPair) or pair.sides != "auto":
        return pair
    ratio = stiffness_ratio(problem, mesh, pair)
    if 1 / ALIKE <= ratio <= ALIKE:
        slave, master = (mesh.surface(name).measures.mean() for name in (pair.slave, pair.master))
        ratio = slave / master / (1 + 1e-6)  # equal sizes do not change places
    # a master of several pairs, or one that a tie or a support holds, cannot carry the contact nodes
    elsewhere = [*problem.tied_boundaries, *(name for other in problem.contact if other is not pair
                                             for name in (other.boundary, getattr(other, "master", "")))]
    bound = pair.master in elsewhere or any(support.boundary == pair.master for support in problem.supports)
    if ratio > 1 and not bound:
        return replace(pair, slave=pair.master, master=pair.slave, sides="given")
    return replace(pair, sides="given")
