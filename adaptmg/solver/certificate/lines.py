"""The lines of a certificate: what a displacement and its contact forces violate, from the raw matrix.

See :mod:`adaptmg.solver.certificate.certificate`; nothing here comes from the solvers.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.solver.certificate.aggregates import Aggregates
from adaptmg.solver.certificate.energy import FrozenStatus, Tally, add_forces, residual_energy

__all__ = ["Condition", "ContactClaims", "Evidence"]

_OPEN, _SLIP, _STICK = 0, 1, 2
_EPSILON = float(np.finfo(float).eps)


class ContactClaims(Protocol):
    """What a result says of its contact nodes; see :class:`adaptmg.solver.result.ContactResult`."""

    node: np.ndarray
    frames: np.ndarray
    force_n: np.ndarray
    force_t: np.ndarray
    state: np.ndarray
    master_node: np.ndarray
    master_force: np.ndarray


@dataclass(frozen=True)
class Condition:
    """One condition: by how much it is violated.

    Attributes
    ----------
    name : str
    largest, total : float
        At one node, and over all: the Euclidean norm, of energies the sum.
    unit : str
        Of both; empty for a number.
    relative : float
        Over the actual forces (Euclidean norm of loads or reactions), the largest displacement, or the energy.
    rounding : float
        As much of ``relative`` as rounding of the terms summed explains.
    """

    name: str
    largest: float
    total: float
    unit: str
    relative: float
    rounding: float = 0.0


class Evidence:
    """What the lines are made from. Forces of coupled bodies are those of the bodies, not of relative coordinates."""

    def __init__(self, problem: DiscreteProblem, displacement: np.ndarray, contact: ContactClaims,
                 images: np.ndarray | None = None) -> None:
        self.problem, self.contact = problem, contact
        # contact as it was posed: between held bodies the problem may have nodes of the master in its place
        self.posed = problem.contact if problem.exchange is None else problem.exchange.contact
        self.nodes = self.posed.nodes
        self.sigma = np.ones(len(self.nodes)) if problem.exchange is None else problem.exchange.sigma
        shape = (problem.n_nodes, problem.dim)
        self.u = displacement.reshape(shape)
        self.unknowns = problem.relative(self.u)
        if images is None:
            images = problem.matrix @ self.unknowns.reshape(-1)
        self.fixed = problem.fixed.reshape(shape)
        self.diagonal = problem.matrix.diagonal().reshape(shape)
        self.normals = self.posed.normals
        self.claimed = np.einsum("nk,nkd->nd", np.column_stack([-contact.force_n, contact.force_t]), contact.frames)
        self.pressure = -np.einsum("nd,nd->n", self.claimed, self.normals)
        self.friction = self.claimed + self.pressure[:, None] * self.normals
        limit, self.coefficient = problem.law.bounds(len(self.nodes))
        self.limit = limit / np.abs(self.sigma)
        self.bound = self.limit + self.coefficient * np.maximum(self.pressure, 0.0)
        self.gap, self.slip = self._kinematics()
        self.unexplained = self._physical(images - problem.load).reshape(shape)
        self.unexplained[self.nodes] -= self.claimed
        np.subtract.at(self.unexplained, contact.master_node, contact.master_force)
        self.tally = Tally(self.unexplained, self.fixed, self.u, self.unknowns,
                           problem.fixed_values.reshape(shape), self.diagonal)
        self.energy = float(np.sqrt(max(_sum(self.unknowns, images), 0.0)))
        self.force = max(_norm(self._physical(problem.load)), self.tally.supports, _norm(self.claimed))
        self.length = self.tally.displacement
        # a row sums terms of the size of its diagonal times its displacement
        self.rounding = 8 * _EPSILON * self.tally.stiff

    @property
    def idle(self) -> bool:
        """Whether all forces are rounding: bodies that their supports move and nothing strains."""
        moved = float(np.abs(self.problem.fixed_values).max(initial=0.0))
        return moved > 0.0 and self.force <= 1e3 * self.rounding and self.length <= 10 * moved

    def _physical(self, forces: np.ndarray) -> np.ndarray:
        coupling = self.problem.coupling
        return forces if coupling is None else coupling.physical_forces(forces)

    def _kinematics(self) -> tuple[np.ndarray, np.ndarray]:
        """Gap (n,) and slip (n, dim) against the obstacle, or the other body."""
        problem, moved = self.problem, self.u[self.nodes]
        if problem.coupling is not None:
            rows = problem.coupling.weights[self.nodes] if problem.exchange is None else problem.exchange.weights
            moved = moved - rows @ self.u
            for at, weights, c in problem.held_together():
                moved[at, c] = self.u[self.nodes[at], c] - weights @ self.u[:, c]
        u_n = np.einsum("nd,nd->n", moved, self.normals)
        # a load step changes the reference of the nodes in the equations
        along = moved - problem.contact.slip_reference * self.sigma[:, None]
        slip = along - np.einsum("nd,nd->n", along, self.normals)[:, None] * self.normals
        return self.posed.gaps - u_n, slip

    def _forces(self, name: str, forces: np.ndarray) -> Condition:
        total = float(np.linalg.norm(forces))
        return Condition(name, float(np.abs(forces).max(initial=0.0)), total, "N", _over(total, self.force),
                    _over(self.rounding, self.force))

    def _lengths(self, name: str, lengths: np.ndarray) -> Condition:
        largest = float(np.abs(lengths).max(initial=0.0))
        return Condition(name, largest, float(np.linalg.norm(lengths)), "m", _over(largest, self.length), 16 * _EPSILON)

    def _works(self, name: str, works: np.ndarray, scale: float) -> Condition:
        total = float(works.sum())
        rounding = _over(self.rounding, self.force) + 16 * _EPSILON
        # never over next to nothing: bodies that part, or slip without friction
        scale = max(scale, self.force) * self.length
        return Condition(name, float(works.max(initial=0.0)), total, "N m", _over(total, scale), rounding)

    def equilibrium(self) -> Condition:
        """Forces at free dofs that neither loads nor claimed contact forces explain."""
        return Condition("equilibrium", self.tally.largest, self.tally.free, "N", _over(self.tally.free, self.force),
                         _over(self.rounding, self.force))

    def prescribed(self) -> Condition:
        """Distance from prescribed values."""
        return Condition("prescribed values", self.tally.furthest, self.tally.moved, "m",
                         _over(self.tally.furthest, self.length), 16 * _EPSILON)

    def normal(self) -> tuple[Condition, Condition, Condition]:
        """Penetration, tension, complementarity."""
        pulling = np.einsum("nd,nd->n", self.unexplained[self.nodes], self.normals) - self.pressure
        # each in its own scale: a force of rounding times a gap of a thousand displacements is no work of contact
        both = np.minimum(_shares(self.pressure, self.force), _shares(self.gap, self.length))
        complementarity = Condition("complementarity", float(both.max(initial=0.0)), _norm(both), "", _norm(both),
                                    _over(self.rounding, self.force) + 16 * _EPSILON)
        return (self._lengths("penetration", np.maximum(-self.gap, 0.0)),
                self._forces("tension", np.maximum(np.maximum(pulling, -self.pressure), 0.0)),
                complementarity)

    def tangential(self) -> tuple[Condition, Condition, Condition]:
        """Friction beyond its bound, and not opposite to the slip."""
        size, slip = np.linalg.norm(self.friction, axis=1), np.linalg.norm(self.slip, axis=1)
        along = np.einsum("nd,nd->n", self.friction, self.slip)
        excess, works = np.maximum(size - self.bound, 0.0), np.maximum(self.bound * slip + along, 0.0)
        # weighted by the force: open nodes slip freely, under a force of rounding
        same_way = np.maximum(along, 0.0) / (self.force or 1.0)
        return (self._forces("friction bound", excess), self._works("slip direction", works, self.bound.sum()),
                self._lengths("slip along the force", same_way))

    def states(self) -> tuple[Condition, Condition, Condition]:
        """What the claimed states contradict."""
        state, slip = np.asarray(self.contact.state), np.linalg.norm(self.slip, axis=1)
        return (self._forces("open, touching", np.where(state == _OPEN, np.maximum(self.pressure, 0.0), 0.0)),
                self._lengths("touching, open", np.where(state != _OPEN, np.maximum(self.gap, 0.0), 0.0)),
                self._lengths("slip, sticking", np.where(state == _STICK, slip, 0.0)))

    def balance(self) -> Condition:
        """Sum of loads, supports, claimed contact forces and elastic foundations: what free dofs leave unexplained."""
        sums = self.tally.sums
        # n forces of random sign sum up to more than one of them
        scale = self.force * np.sqrt(self.problem.n_nodes)
        total = float(np.linalg.norm(sums))
        return Condition("balance", float(np.abs(sums).max()), total, "N", _over(total, scale),
                         _over(self.rounding, scale))

    def energy_error(self, aggregates: Aggregates | None) -> tuple[float, float]:
        """The relative energy error, estimated with these aggregates or exact, and as much of it as rounding explains.
        """
        problem, coupling = self.problem, self.problem.coupling
        status, change, unlawful = self._frozen()
        # a copy: what is unexplained is told by other lines too
        forces = self.unexplained.copy() if coupling is None else coupling.relative_forces(self.unexplained.reshape(-1))
        forces = forces.reshape(self.u.shape)
        forces[problem.contact.nodes] += unlawful
        matrix = problem.matrix
        moved = np.sqrt(max(add_forces(matrix.indptr, matrix.indices, matrix.data, status.held, change, forces), 0.0))
        rest = residual_energy(matrix, status, forces, aggregates)
        rounding = 32 * _EPSILON * self.tally.stiff_energy
        return _over(moved + np.sqrt(rest), self.energy), _over(rounding, self.energy)

    def _frozen(self) -> tuple[FrozenStatus, np.ndarray, np.ndarray]:
        """The status that the displacement is nearest to, the change that meets it, and the forces against the law.

        At each node the cheaper is taken, in the measure of its stiffness: to move onto the obstacle (to zero slip), or
        to give the force up (to turn it against the slip).
        """
        contact, dim = self.problem.contact, self.problem.dim
        here, d = (~self.fixed[contact.nodes]).astype(float), self.diagonal[contact.nodes].max(axis=1)
        # at the nodes that carry the conditions in the equations
        scale, sigma = np.abs(self.sigma), self.sigma[:, None]
        gap, pressure = self.gap / scale, self.pressure * scale
        slip, friction = self.slip / sigma, self.friction * sigma * here
        closed = d * gap**2 < np.maximum(pressure, 0.0) ** 2 / d + d * np.minimum(gap, 0.0) ** 2
        closed |= gap < 0
        size, limit = np.linalg.norm(slip, axis=1), np.where(closed, self.bound, self.limit) * scale
        against = -_directions(slip)
        excess = np.maximum(np.linalg.norm(friction, axis=1) - limit, 0.0)
        turned = limit[:, None] * against * here
        stays = (limit > 0) & (d * size**2 + excess**2 / d <= np.sum((friction - turned) ** 2, axis=1) / d)
        # from no slip at all the node moves as the force drags it
        beyond = stays & (excess > 0)
        against[beyond] = _directions(friction)[beyond]
        lawful = np.where((stays & ~beyond)[:, None], friction, limit[:, None] * against * here)
        change = np.zeros_like(self.u)
        change[contact.nodes] = np.where(closed, gap, 0.0)[:, None] * contact.normals - stays[:, None] * slip * here
        held = np.flatnonzero(self.fixed)
        change.reshape(-1)[held] = self.problem.fixed_values[held] - self.unknowns.reshape(-1)[held]
        outer = np.einsum("ni,nj->nij", contact.normals, contact.normals)
        tangents = np.eye(dim) - outer
        slides, closed_too = ~stays | beyond, closed[:, None, None]
        kept = np.where(slides[:, None, None], tangents, 0.0) + np.where(closed_too, 0.0, outer)
        turning = np.divide(limit, size, out=np.zeros_like(size), where=~stays & (size > 0))
        across = (tangents - np.einsum("ni,nj->nij", against, against)) * (dim == 3)
        dragged = (self.coefficient * (slides & closed))[:, None, None] * np.einsum(
            "ni,nj->nij", against, contact.normals)
        pressed = -np.where(closed, pressure, 0.0)[:, None] * contact.normals
        held, kept = self._held(kept)
        status = FrozenStatus(held, kept, contact.nodes, turning[:, None, None] * across, dragged)
        return status, change, self.claimed * sigma - pressed - lawful

    def _held(self, kept: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Nodes in supports or contact, and the projections there, from those (n_contact, dim, dim) of contact."""
        nodes = self.problem.contact.nodes
        supported = np.flatnonzero(self.problem.fixed) // self.problem.dim
        held = np.append(nodes, np.setdiff1d(supported, nodes))
        every = np.concatenate([kept, np.tile(np.eye(self.problem.dim), (len(held) - len(nodes), 1, 1))])
        free = ~self.fixed[held]
        return held, every * free[:, :, None] * free[:, None, :]


def _directions(vectors: np.ndarray) -> np.ndarray:
    """Unit vectors (n, dim), zero where there is none."""
    size = np.linalg.norm(vectors, axis=1)[:, None]
    return np.divide(vectors, size, out=np.zeros_like(vectors), where=size > 0)


def _shares(values: np.ndarray, scale: float) -> np.ndarray:
    """What is positive, over a scale."""
    return np.maximum(values, 0.0) / (scale or 1.0)


def _over(value: float, scale: float) -> float:
    """A ratio; 1 for something over nothing."""
    return 0.0 if value == 0.0 else float(value / (scale or value))


def _norm(vector: np.ndarray) -> float:
    return float(np.sqrt(_sum(vector, vector)))


def _sum(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.einsum("i,i->", a.reshape(-1), b.reshape(-1)))
