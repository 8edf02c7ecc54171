"""TruncatedContact: the contact nodes of one level, their status, and what truncation makes of vectors there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.multigrid.linear.split_matrix import SplitMatrix
from adaptmg.multigrid.truncated import contact_kernels
from adaptmg.smoother.blocks import ZERO
from adaptmg.smoother.system import NodalContact, local_contact, turn_held

__all__ = ["StatusChange", "TruncatedContact"]


@dataclass(frozen=True)
class StatusChange:
    """What an update of the contact status finds.

    Attributes
    ----------
    changed : int
        Nodes whose status differs from that of the last update.
    natural, reactions : float
        Sums of squares of the natural residual and of the contact forces, N^2.
    """

    changed: int
    natural: float
    reactions: float


@dataclass(eq=False)
class TruncatedContact:
    """Contact data and contact status of one level, flat as the kernels read them.

    The kernels are those of :mod:`adaptmg.multigrid.truncated.contact_kernels`.

    Attributes
    ----------
    dim : int
    nodes : (n_contact,) int32 array
    contact_of : (n_nodes,) int32 array
        Index of a node among the contact nodes, or -1.
    frames : (n_contact * dim * dim,) array
    diagonal : (n_contact * dim * dim,) array
        Cartesian diagonal blocks.
    blocks : (n_contact * dim * (dim + 1) / 2,) array
        Upper triangles of the local ones.
    gap, limit, friction : (n_contact,) arrays
    reference : (n_contact * (dim - 1),) array
    values : (n_contact * dim,) array
        Local unknowns.
    codes : (n_contact,) int8 array
        Of :mod:`adaptmg.smoother.state`; -1 before the first update.
    pressure : (n_contact,) array
        p >= 0, N.
    direction, hessian : (n_contact * (dim - 1),), (n_contact * (dim - 1)^2,) arrays
        Of the slip, as the matrices have them.
    driven : (k,) int array
        Nodes that slip along a first tangent which a support holds.
    """

    #: share of the contact nodes that a recombination may cut
    FEW: ClassVar[float] = 0.02

    dim: int
    nodes: np.ndarray
    contact_of: np.ndarray
    frames: np.ndarray
    diagonal: np.ndarray
    blocks: np.ndarray
    gap: np.ndarray
    reference: np.ndarray
    limit: np.ndarray
    friction: np.ndarray
    values: np.ndarray
    codes: np.ndarray
    pressure: np.ndarray
    direction: np.ndarray
    hessian: np.ndarray
    driven: np.ndarray

    @classmethod
    def of(cls, problem: DiscreteProblem, level: SplitMatrix) -> TruncatedContact:
        """The contact nodes of a level whose matrix is ``level``."""
        dim, (contact, frames) = problem.dim, local_contact(problem)
        nodes = problem.contact.nodes.astype(np.int32)
        contact_of = np.full(problem.n_nodes, -1, dtype=np.int32)
        contact_of[nodes] = np.arange(len(nodes), dtype=np.int32)
        diagonal = level.diagonal.reshape(-1, dim, dim)[nodes]
        local = np.einsum("nij,njk,nlk->nil", frames, diagonal, frames)
        turn_held(local, np.arange(len(nodes)), contact)
        row, column = np.triu_indices(dim)
        n = len(nodes)
        return cls(dim, nodes, contact_of, np.ascontiguousarray(frames).reshape(-1), diagonal.reshape(-1),
                   np.ascontiguousarray(local[:, row, column]).reshape(-1), contact.gap,
                   contact.slip_reference.reshape(-1), contact.limit, contact.friction, np.zeros(n * dim),
                   np.full(n, -1, dtype=np.int8), np.zeros(n), np.zeros(n * (dim - 1)), np.zeros(n * (dim - 1) ** 2),
                   contact.driven)

    def renew(self, contact: NodalContact) -> None:
        """Take over gaps and slips of another load step."""
        self.gap, self.reference, self.driven = contact.gap, contact.slip_reference.reshape(-1), contact.driven

    @property
    def node_data(self) -> tuple[np.ndarray, ...]:
        """What the node solve reads."""
        return self.frames, self.blocks, self.gap, self.reference, self.limit, self.friction, self.values

    @property
    def nbytes(self) -> int:
        """Memory of the arrays, bytes."""
        return sum(value.nbytes for value in vars(self).values() if isinstance(value, np.ndarray))

    def start(self, unknowns: np.ndarray) -> None:
        """Take over unknowns (n_dofs,) that may penetrate; they are projected onto the admissible ones, in place."""
        self.codes[:] = 0
        self.project(unknowns)
        self.codes[:] = -1

    def update_status(self, defect: np.ndarray) -> StatusChange:
        """Find the status after a sweep; ``defect`` is f - A u (n_dofs,)."""
        return StatusChange(*contact_kernels.classify(ZERO[self.dim], self.nodes, *self.node_data, defect, self.codes,
                                                      self.pressure))

    def linearise_friction(self) -> None:
        """Take the slip directions (3D: and the Hessian) from the present unknowns."""
        contact_kernels.directions(self.dim, self.codes, self.limit, self.friction, self.pressure, self.reference,
                                   self.values, self.direction, self.hessian)
        if len(self.driven):
            self.direction.reshape(-1, 2)[self.driven, 0] = 0.0
            hessian = self.hessian.reshape(-1, 2, 2)
            hessian[self.driven, 0] = 0.0
            hessian[self.driven, :, 0] = 0.0

    def truncate(self, defect: np.ndarray) -> float:
        """Make f - A u the truncated residual, in place; returns its sum of squares at the contact nodes."""
        squares = contact_kernels.truncate(self.dim, self.codes, self.nodes, self.frames, self.limit, self.friction,
                                           self.reference, self.values, defect)
        # the support takes the friction along what it holds
        return squares - self._clear(defect)

    def _clear(self, vector: np.ndarray) -> float:
        """Set held tangents of driven nodes to zero in a vector (n_dofs,), in place; returns the squares lost."""
        if not len(self.driven):
            return 0.0
        at, tangents = vector.reshape(-1, 3), self.frames.reshape(-1, 3, 3)[self.driven, 1]
        along = np.einsum("nd,nd->n", tangents, at[self.nodes[self.driven]])
        at[self.nodes[self.driven]] -= along[:, None] * tangents
        return float(np.sum(along**2))

    def project(self, unknowns: np.ndarray) -> int:
        """Make a corrected iterate admissible, in place; returns the number of nodes that had to be cut."""
        cut = contact_kernels.project(self.dim, self.codes, self.nodes, self.frames, self.gap, self.reference,
                                      self.values, unknowns)
        self._clear(unknowns)
        self.values.reshape(-1, self.dim)[self.driven, 1] = 0.0
        return cut

    def admits(self, unknowns: np.ndarray, first: np.ndarray, second: np.ndarray, alpha: tuple[float, float]) -> bool:
        """Whether the recombination closes an open node or reverses a slip at a few nodes at most.

        Those are cut back with the correction. To do without the recombination for the sake of one node that is about
        to change its status would cost more cycles than to cut it.
        """
        cut = contact_kernels.count_cut(self.dim, self.codes, self.nodes, self.frames, self.gap, self.reference,
                                        self.values, first, second, alpha[0], alpha[1], unknowns)
        return cut <= 1 + self.FEW * len(self.nodes)

    def friction_slope(self, before: np.ndarray, alpha: float) -> float:
        """How much the slope of sum g |slip| at alpha exceeds that at 0 on the way from local unknowns ``before``."""
        return contact_kernels.friction_slope(self.dim, self.codes, self.limit, self.friction, self.pressure,
                                              self.reference, before, self.values, alpha)
