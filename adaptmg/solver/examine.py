r"""Examiner: residual, reactions, contact quantities and certificate of a displacement, whatever method it comes from.

One product with the matrix as it was given, and rotations at the contact nodes alone. Sizes are what errors and
residuals refer to: the energy of the displacement and the forces that act. Unknowns count from the prescribed values
:math:`\bar u` (zero elsewhere), :math:`u = w + \bar u`; the energy of :math:`\bar u`, and so :math:`\|w\|_A` and
:math:`|A\bar u|`, grows as the mesh is refined, and nothing may be related to it. The displacement itself has

.. math:: \|u\|_A^2 = w^T(\bar b - r) + 2\,w^T A\bar u + \bar u^T A\bar u,

with the load :math:`\bar b = b - A\bar u` of the unknowns and their residual r: no pass over the matrix. The forces are
the loads, the contact forces, and where displacements are prescribed the reactions :math:`A u - b` of the supports.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.discrete.coordinates import from_frames, rotate, rotate_back, to_frames
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.sides import TieForces, tie_forces
from adaptmg.smoother.residuals import natural_at_nodes, states
from adaptmg.smoother.system import ContactState, NodalContact, contact_blocks, held_tangents, local_contact
from adaptmg.solver.certificate import Certificate, certify
from adaptmg.solver.contact_result import ContactResult


@dataclass(frozen=True, eq=False)
class Examined:
    """A displacement and what follows from it."""

    displacement: np.ndarray  # (n_nodes, dim): of the bodies, m
    reaction: np.ndarray  # (n_nodes, dim): on the bodies, N
    contact: ContactResult
    ties: TieForces | None
    residual: float  # natural, relative to the forces that act
    checked: Certificate


class Examiner:
    """Examines displacements of one problem."""

    def __init__(self, discrete: DiscreteProblem) -> None:
        self.discrete = discrete
        self.contact, self.frames = local_contact(discrete)
        self.held, self.blocks = held_tangents(discrete), contact_blocks(discrete)
        self.sizes = Sizes(discrete)
        self._last: tuple[np.ndarray, np.ndarray | None, Examined] | None = None

    def relative_residual(self, solved: np.ndarray, pressures: np.ndarray | None = None) -> float:
        """Natural residual of a displacement (n_dofs,), relative coordinates, over the forces that act. The largest of
        load, contact forces and, where displacements are prescribed, reactions, in Euclidean norms; 1 if it is all
        there is."""
        solved = np.asarray(solved, dtype=np.float64).reshape(-1)
        return self._residual(solved, self.discrete.under(pressures).load - self.discrete.matrix @ solved, pressures)

    def _at_contact(self, vector: np.ndarray) -> np.ndarray:
        """Local components (n_contact, dim) of a vector (n_dofs,), zero along what is held."""
        local = to_frames(self.frames, vector.reshape(-1, self.discrete.dim)[self.discrete.contact.nodes])
        local[:, 1:][self.held] = 0.0
        return local

    def _values(self, solved: np.ndarray) -> np.ndarray:
        return self._at_contact(self.discrete.from_prescribed(solved))

    def _residual(self, solved: np.ndarray, residual: np.ndarray, pressures: np.ndarray | None) -> float:
        discrete = self.discrete
        free = np.where(discrete.fixed, 0.0, residual)
        at_contact = self._at_contact(free)
        natural = natural_at_nodes(self.contact, self.blocks, self._values(solved), at_contact)
        free.reshape(-1, discrete.dim)[discrete.contact.nodes] = natural
        unknowns = np.where(discrete.fixed, 0.0, solved) if self.sizes.prescribed else solved
        scale, size = self.sizes.forces(unknowns, euclidean_norm(at_contact.reshape(-1))), euclidean_norm(free)
        if discrete.volumes is not None:
            size = float(np.hypot(size, euclidean_norm(discrete.volumes.scale * discrete.volumes.missed(
                solved, pressures))))
        if self.sizes.prescribed:
            floor = ROUNDING * euclidean_norm(discrete.matrix.diagonal() * unknowns)
            if size <= floor and self.sizes.nothing_strains(scale, floor, unknowns):
                return 0.0
        return 0.0 if size == 0.0 else size / (scale or size)

    def __call__(self, solved: np.ndarray, rtol: float = 0.0, pressures: np.ndarray | None = None) -> Examined:
        """Examine a displacement (n_nodes, dim) or (n_dofs,), between bodies in relative coordinates, m, which is kept
        and must not change any more; ``rtol``: the tolerance that is asked for; ``pressures`` of volumes, Pa."""
        solved = np.asarray(solved, dtype=np.float64).reshape(-1)
        if self._last is not None and np.array_equal(self._last[0], solved) and (
                pressures is None or np.array_equal(self._last[1], pressures)):
            return self._last[2]
        discrete, self._last = self.discrete, None
        residual = discrete.under(pressures).load - discrete.matrix @ solved
        nodal = solved.reshape(discrete.n_nodes, discrete.dim)
        displacement = discrete.physical(nodal)
        contact = contact_result(discrete, self.contact, self.frames, self.held, nodal, self._values(solved),
                                 -self._at_contact(residual))
        natural = self._residual(solved, residual, pressures)
        checked = certify(discrete, displacement, contact, rtol=rtol, pressures=pressures)
        residual = -residual
        if discrete.inclined is not None:
            residual += discrete.inclined.reaction(solved)
        ties = tie_forces(discrete, residual)
        reaction = discrete.physical_forces(residual).reshape(nodal.shape)
        found = Examined(displacement, reaction, contact, ties, natural, checked)
        self._last = solved, pressures, found
        return found


def contact_result(discrete: DiscreteProblem, nodal: NodalContact, frames: np.ndarray, held: np.ndarray,
                   solved: np.ndarray, values: np.ndarray, force: np.ndarray) -> ContactResult:
    """Contact quantities at a solution. Where a support holds a tangential component, the equations do not tell
    friction from the reaction of the support: there it is what the law says for the slip, and nothing if nothing
    slips."""
    contact, small = discrete.contact, 1e-12 * max(solved.max(initial=0.0), -solved.min(initial=0.0))
    u = to_frames(frames, discrete.at_contact(solved))
    slip = u[:, 1:] - to_frames(frames, contact.slip_reference)[:, 1:]
    force_n, force_t = np.maximum(-force[:, 0], 0.0), np.where(held, 0.0, force[:, 1:])
    limit = nodal.limit + nodal.friction * force_n
    state = states(nodal, values, force_n, small)
    _friction_at_supports(held, slip, limit, small, force_t, state)
    weights = None if discrete.coupling is None else discrete.coupling.weights[contact.nodes]
    x = np.full(contact.normals.shape, np.nan) if discrete.coordinates is None else discrete.coordinates[contact.nodes]
    carried = from_frames(frames, np.column_stack([-force_n, force_t]))
    boundary, node, on_masters = _on_followed(discrete, contact.boundary, weights, carried)
    return ContactResult(node=contact.nodes, x=x, frames=frames.copy(), gap=contact.gaps - u[:, 0], u_n=u[:, 0],
                         u_t=u[:, 1:], slip=slip, force_n=force_n, force_t=force_t, weights=contact.weights,
                         limit=limit, state=state, boundary=contact.boundary, names=contact.names,
                         masters=contact.masters, master_node=node, master_force=on_masters, master_boundary=boundary)


def _friction_at_supports(held: np.ndarray, slip: np.ndarray, limit: np.ndarray, small: float, force_t: np.ndarray,
                          state: np.ndarray) -> None:
    """Friction along held tangents (n, dim - 1) and the states of their nodes, in place."""
    size = np.linalg.norm(slip, axis=1)
    slides = held.any(axis=1) & (size > small)
    direction = np.divide(slip, size[:, None], out=np.zeros_like(slip), where=slides[:, None])
    force_t[held] = (-limit[:, None] * direction)[held]
    state[slides & (state == ContactState.STICK)] = ContactState.SLIP


def _on_followed(discrete: DiscreteProblem, boundary: np.ndarray, rows: sparse.csr_array | None, forces: np.ndarray
                 ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What contact forces (n_contact, dim) exert on the nodes that slave nodes follow, -W' times them, by boundary.
    ``rows`` (n_contact, n_nodes) are the weights W. Where both bodies are held, held nodes of the other one take
    all."""
    dim, n = discrete.dim, discrete.n_nodes
    if rows is None:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty((0, dim))
    keys, parts = [], []
    held = {c: (at, weights) for at, weights, c in discrete.held_together()}
    for c in range(dim):
        weights, (at, instead) = rows, held[c]
        if len(at):
            others = np.ones(len(boundary))
            others[at] = 0.0
            place = sparse.csr_array((np.ones(len(at)), (at, np.arange(len(at)))), shape=(len(boundary), len(at)))
            weights = sparse.csr_array(sparse.diags_array(others, format="csr") @ rows + place @ instead)
        of = np.repeat(np.arange(len(boundary)), np.diff(weights.indptr))
        keys.append(boundary[of] * n + weights.indices)
        part = np.zeros((len(of), dim))
        part[:, c] = -weights.data * forces[of, c]
        parts.append(part)
    key, place = np.unique(np.concatenate(keys), return_inverse=True)
    total = np.column_stack([np.bincount(place, part, minlength=len(key)) for part in np.concatenate(parts).T])
    return key // n, key % n, total


#: a natural residual below this share of the terms it sums is rounding
ROUNDING = 8 * np.finfo(float).eps


def energy_norm(unknowns: np.ndarray, forces: np.ndarray) -> float:
    """sqrt(w' A w) from w and A w, 0 where rounding makes it negative."""
    # not through BLAS: its threads cost more than a short dot product gains, several times over on a busy machine
    return float(np.sqrt(max(float(np.einsum("i,i->", unknowns, forces)), 0.0)))


def euclidean_norm(vector: np.ndarray) -> float:
    """|v| of a flat vector, on one thread."""
    return energy_norm(vector, vector)


def displacement_norm(problem: DiscreteProblem, displacement: np.ndarray) -> float:
    """||u||_A of the stresses of a displacement (n_dofs,), prescribed values included; Cartesian, between bodies
    relative."""
    flat = np.asarray(displacement, dtype=np.float64).reshape(-1)
    return float(np.sqrt(problem.stress_energy(flat, energy_norm(flat, problem.matrix @ flat) ** 2)))


class Sizes:
    """Of the iterates of one problem."""

    IDLE = 1e3  # forces below this multiple of the rounding of a residual are rounding

    def __init__(self, problem: DiscreteProblem, frames: np.ndarray | None = None) -> None:
        self.load = euclidean_norm(problem.load)
        self.prescribed, self._problem, self._frames = bool(problem.fixed_values.any()), problem, frames
        if not self.prescribed:
            return
        lift = problem.matrix @ problem.fixed_values
        self._jump = float(np.einsum("i,i->", problem.fixed_values, lift))
        self._rows = sparse.csr_array(problem.matrix)[np.flatnonzero(problem.fixed)]
        self._offset = (lift - problem.load)[problem.fixed]
        self._lift = lift if frames is None else rotate(lift, frames, problem.contact.nodes)

    def nothing_strains(self, forces: float, rounding: float, unknowns: np.ndarray) -> bool:
        """Whether all forces are rounding: bodies that their supports move, and nothing strains or holds. Nothing is
        relative to such forces. Unknowns that have run away have such forces too, but move further than the supports
        do."""
        if not self.prescribed or forces > self.IDLE * rounding:
            return False
        return bool(np.abs(unknowns).max(initial=0.0) <= 10 * np.abs(self._problem.fixed_values).max())

    def norm(self, unknowns: np.ndarray, energy: float) -> float:
        """||u||_A of the stresses, from the unknowns w (n_dofs,), zero at fixed dofs, and w'Aw (N m)."""
        if self.prescribed:
            energy += 2 * float(np.einsum("i,i->", unknowns, self._lift)) + self._jump
        if self._problem.strain_free is not None:
            energy = self._problem.stress_energy(self._cartesian(unknowns) + self._problem.fixed_values, energy)
        return float(np.sqrt(max(energy, 0.0)))

    def forces(self, unknowns: np.ndarray, contact: float) -> float:
        """The largest of the norms of load, contact forces (given, N) and, where values are prescribed, reactions."""
        if not self.prescribed:
            return max(self.load, contact)
        return max(self.load, contact, euclidean_norm(self._rows @ self._cartesian(unknowns) + self._offset))

    def _cartesian(self, unknowns: np.ndarray) -> np.ndarray:
        return unknowns if self._frames is None else rotate_back(unknowns, self._frames, self._problem.contact.nodes)
