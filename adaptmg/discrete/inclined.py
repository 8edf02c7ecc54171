r"""Supports along directions that are no coordinate axes: inclined rollers and planes of symmetry.

With the projection :math:`Z_i` onto the directions along which supports hold node i, and the displacement
:math:`\bar u_i` that they prescribe along them, the problem in relative coordinates

.. math:: A' = (I - Z)\,A\,(I - Z) + Z D Z,\qquad b' = (I - Z)\,(b - A \bar u) + Z D \bar u

has the solution of :math:`A u = b` with :math:`Z u = \bar u`: these components are coupled to no other, and solvers
need not know of them. D has the size of the diagonal blocks. The supports exert :math:`Z (A u - b)`. The energy of a
displacement is that of A,

.. math:: u^T A u = u^T A' u + 2\,u^T (I - Z) A \bar u + \bar u^T A \bar u - \bar u^T D \bar u .
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy import sparse


@dataclass(frozen=True, eq=False)
class Inclined:
    """The nodes that supports hold along directions that are no axes. Their fixed components count among these."""

    nodes: np.ndarray  # (k,) int, ascending
    spans: np.ndarray  # (k, dim, dim): Z
    moved: Mapping[str, np.ndarray]  # (k, dim) by name in a load path: what supports prescribe, m
    rows: sparse.csr_array = field(default_factory=lambda: sparse.csr_array((0, 0)))  # (k * dim, n_dofs): of A
    stiffness: np.ndarray = field(default_factory=lambda: np.empty(0))  # (k,): D
    load: np.ndarray = field(default_factory=lambda: np.empty(0))  # (n_dofs,): b

    def prescribed(self, factors: Mapping[str, float]) -> np.ndarray:
        """Return the displacement (k, dim) that supports prescribe in a load step, m."""
        return sum((factors.get(name, 1.0) * part for name, part in self.moved.items()), np.zeros(self.spans.shape[:2]))

    @property
    def moving(self) -> np.ndarray:
        """Which of the nodes (k,) bool supports move."""
        return sum((part.any(axis=1) for part in self.moved.values()), np.zeros(len(self.nodes), dtype=bool)) > 0

    def free_part(self, nodes: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Return vectors (n, dim) at some nodes without their parts along the directions that are held."""
        at = np.minimum(np.searchsorted(self.nodes, nodes), len(self.nodes) - 1)
        here = self.nodes[at] == nodes
        return np.where(here[:, None], vectors - np.einsum("nij,nj->ni", self.spans[at], vectors), vectors)

    def spread(self, blocks: np.ndarray, n_nodes: int) -> sparse.csr_array:
        """Return the matrix of all nodes with blocks (k, dim, dim) on the diagonal."""
        counts = np.zeros(n_nodes, dtype=np.int64)
        counts[self.nodes] = 1
        n = n_nodes * self.spans.shape[1]
        return sparse.csr_array(sparse.bsr_array((blocks, self.nodes, np.append(0, np.cumsum(counts))), shape=(n, n)))

    def along(self, vector: np.ndarray) -> np.ndarray:
        """Return the parts (k, dim) of a vector (n_dofs,) along the directions that are held."""
        return np.einsum("nij,nj->ni", self.spans, vector.reshape(-1, self.spans.shape[1])[self.nodes])

    def of_problem(self, parts: dict[str, Any]) -> dict[str, Any]:
        """Return the parts of a problem, in relative coordinates, with these directions eliminated."""
        matrix, dim = parts["matrix"], self.spans.shape[1]
        dofs = (dim * self.nodes[:, None] + np.arange(dim)).reshape(-1)
        rows = sparse.csr_array(sparse.csr_array(matrix)[dofs])
        stiffness = np.abs(matrix.diagonal().reshape(-1, dim)[self.nodes]).mean(axis=1)
        this = replace(self, rows=rows, stiffness=stiffness, load=parts["load"])
        prescribed = this.prescribed({})
        return parts | {"matrix": this._eliminated(matrix), "load": this.posed(parts["load"], prescribed),
                        "strain_free": this.strain_free(parts.get("strain_free"), prescribed), "inclined": this}

    def _eliminated(self, matrix: sparse.bsr_array) -> sparse.bsr_array:
        place = np.full(matrix.shape[0] // self.spans.shape[1], -1)
        place[self.nodes] = np.arange(len(self.nodes))
        row, column, data = np.repeat(place, np.diff(matrix.indptr)), place[matrix.indices], matrix.data.copy()
        at = np.flatnonzero(row >= 0)
        data[at] -= np.einsum("nij,njk->nik", self.spans[row[at]], data[at])
        at = np.flatnonzero(column >= 0)
        data[at] -= np.einsum("nij,njk->nik", data[at], self.spans[column[at]])
        at = np.flatnonzero((row >= 0) & (row == column) & (np.repeat(np.arange(len(place)), np.diff(matrix.indptr))
                                                             == matrix.indices))
        block = data[at] + self.stiffness[row[at], None, None] * self.spans[row[at]]
        data[at] = 0.5 * (block + block.transpose(0, 2, 1))
        return sparse.bsr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)

    def posed(self, load: np.ndarray, prescribed: np.ndarray) -> np.ndarray:
        """Return b' (n_dofs,) of a load b and what supports prescribe (k, dim)."""
        result = (load - self.rows.T @ prescribed.reshape(-1)).reshape(-1, self.spans.shape[1])
        result[self.nodes] += self.stiffness[:, None] * prescribed - self.along(result)
        return result.reshape(-1)

    def strain_free(self, before: tuple[np.ndarray, float] | None, prescribed: np.ndarray
                    ) -> tuple[np.ndarray, float] | None:
        """Return what makes the energy of A' that of A; see ``DiscreteProblem.stress_energy``."""
        if not prescribed.any():
            return before
        forces = (self.rows.T @ prescribed.reshape(-1)).reshape(-1, self.spans.shape[1])
        own = float(np.sum(prescribed * (forces[self.nodes] - self.stiffness[:, None] * prescribed)))
        forces[self.nodes] -= self.along(forces)
        load, energy = (0.0, 0.0) if before is None else before
        return load - forces.reshape(-1), energy + own

    def reaction(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the forces (n_dofs,) that the supports exert along these directions, of the unknowns (n_dofs,), N."""
        load, result = self.load.reshape(-1, self.spans.shape[1]), np.zeros_like(self.load)
        forces = (self.rows @ unknowns).reshape(-1, load.shape[1]) - load[self.nodes]
        result.reshape(load.shape)[self.nodes] = np.einsum("nij,nj->ni", self.spans, forces)
        return result


@dataclass(frozen=True, eq=False)
class HeldNodes:
    """Along which directions supports hold the nodes of a mesh."""

    fixed: np.ndarray  # (n_nodes, dim) bool
    inclined: Inclined | None = None

    def free_part(self, nodes: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Return vectors (n, dim) at some nodes without their parts along what is held."""
        free = np.where(self.fixed[nodes], 0.0, vectors)
        return free if self.inclined is None else self.inclined.free_part(nodes, free)
