r"""The energy error of a displacement, estimated from the raw matrix by a few conjugate gradient steps.

With the contact status of the displacement held, u is first moved onto its constraints by a change z of constrained
dofs alone: v = u + z has its prescribed values, touching nodes on the obstacle, sticking nodes at zero slip. What is
then missing is a correction in the space of the displacements that keep the status,

.. math:: \|u - u_h\|_A \le \|z\|_A + \|v - u_h\|_A, \qquad \|v - u_h\|_A = |e|_{A^{-1}},

e the forces at v that no load, support or lawful contact force explains. Conjugate gradients give
:math:`|e|^2_{A^{-1}} = \sum_k \alpha_k\,r_k \cdot z_k`, a sum of positive terms, of which some are taken: never too
much. The preconditioner is the diagonal plus :mod:`adaptmg.solver.certificate.hats`. What other lines of a certificate
need from all nodes, sums and largest entries, a :class:`Tally` takes in one pass. Nothing here comes from the solvers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from adaptmg.runtime.compiled import kernel
from adaptmg.solver.certificate.hats import Hats

__all__ = ["FrozenStatus", "Tally", "add_forces", "residual_energy"]


#: conjugate gradient steps at most, and the share of the sum that is not worth another: up to so many nodes, which cost
#: nothing that anybody notices, and beyond
_SMALL, _MANY, _FEW = 20_000, (12, 0.005), (4, 0.05)
_NONE = np.empty(0, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class FrozenStatus:
    """The displacements that keep a contact status.

    Attributes
    ----------
    held : (m,) int array
        Nodes that may not move freely: in supports, and in contact.
    kept : (m, dim, dim) array
        Projections onto what may move there: of the free components; at contact nodes of these I, I - n n' (closed,
        slipping), 0 (closed, sticking).
    nodes : (n_contact,) int array
    stiffening : (n_contact, dim, dim) array
        Of friction that turns with the slip (3D), N/m.
    dragged : (n_contact, dim, dim) array
        Friction for a normal force, of slipping nodes under Coulomb's law; the factorisation alone knows it.
    """

    held: np.ndarray
    kept: np.ndarray
    nodes: np.ndarray
    stiffening: np.ndarray
    dragged: np.ndarray

    def project(self, vector: np.ndarray) -> None:
        """Leave of a vector (n_nodes, dim) the part that may move, in place."""
        vector[self.held] = np.einsum("nij,nj->ni", self.kept, vector[self.held])

    def product(self, matrix: sparse.bsr_array, vector: np.ndarray) -> np.ndarray:
        """The projected matrix, friction included, times a projected vector (n_nodes, dim)."""
        result = (matrix @ vector.reshape(-1)).reshape(vector.shape)
        result[self.nodes] += np.einsum("nij,nj->ni", self.stiffening, vector[self.nodes])
        self.project(result)
        return result


@kernel
def add_forces(indptr, indices, data, nodes, change, forces):
    """Forces += A z of a change (n_nodes, dim) of some nodes alone, A symmetric; returns z'Az."""
    energy = 0.0
    for i in nodes:
        for p in range(indptr[i], indptr[i + 1]):
            for k in range(change.shape[1]):
                for m in range(change.shape[1]):
                    forces[indices[p], m] += data[p, k, m] * change[i, k]
                    energy += change[i, k] * data[p, k, m] * change[indices[p], m]
    return energy


def residual_energy(matrix: sparse.bsr_array, status: FrozenStatus, residual: np.ndarray,
                    diagonal: np.ndarray, coordinates: np.ndarray | None, exact: bool = False,
                    relative: bool = False) -> float:
    """|e|^2 in the inverse of the matrix on the space of a status, N m.

    Parameters
    ----------
    matrix : bsr_array
    status : FrozenStatus
    residual : (n_nodes, dim) array
        e, N; it is overwritten.
    diagonal : (n_nodes, dim) array
        Of the matrix.
    coordinates : (n_nodes, dim) array or None
        For the hats; else nodes are taken in the order of their numbers.
    exact : bool
        By a sparse factorisation; else from below, by conjugate gradients.
    relative : bool
        Whether contact nodes count from those of another body.
    """
    status.project(residual)
    size = _dot(residual, residual)
    if not np.isfinite(size):
        return float("inf")
    if size == 0.0:
        return 0.0
    if exact:
        return _factorised(matrix, status, residual)
    if status.stiffening.any():
        diagonal = diagonal.copy()
        diagonal[status.nodes] += np.diagonal(status.stiffening, axis1=1, axis2=2)
    hats = Hats(matrix, diagonal, status.held, status.kept, coordinates, status.nodes if relative else _NONE)
    energy, before, alpha = 0.0, np.inf, 0.0
    direction, image = np.zeros_like(residual), residual
    steps, little = _MANY if len(residual) <= _SMALL else _FEW
    for _ in range(steps):
        product, smooth = hats.advance(residual, alpha, image)
        # not before the product, which costs most: steps are about as long as the last one
        if not product > 0.0 or (alpha * product <= little * energy and energy > 0.0):
            break
        hats.turn(residual, smooth, product / before, direction)
        status.project(direction)
        image = status.product(matrix, direction)
        curvature = _dot(direction, image)
        if not curvature > 0.0:
            break  # a motion that nothing holds
        alpha, before = product / curvature, product
        energy += alpha * product
    return energy


def _factorised(matrix: sparse.bsr_array, status: FrozenStatus, residual: np.ndarray) -> float:
    n, dim = residual.shape
    eye = np.tile(np.eye(dim), (n, 1, 1))

    def by_node(nodes: np.ndarray, blocks: np.ndarray, others: np.ndarray) -> sparse.bsr_array:
        every = others.copy()
        every[nodes] = blocks
        return sparse.bsr_array((every, np.arange(n), np.arange(n + 1)), shape=matrix.shape)

    keep = by_node(status.held, status.kept, eye)
    stiffening, dragged = (by_node(status.nodes, blocks, 0 * eye) for blocks in (status.stiffening, status.dragged))
    whole = keep @ (matrix + stiffening) + keep @ dragged @ matrix
    # what may not move gets a diagonal of the size of the others
    rest = np.abs(matrix.diagonal()).max() * (sparse.eye_array(matrix.shape[0]) - keep)
    found = splu(sparse.csc_array(whole @ keep + rest)).solve(residual.reshape(-1))
    return max(_dot(found.reshape(n, dim), (matrix @ found).reshape(n, dim)), 0.0)


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.einsum("nd,nd->", a, b))


@kernel
def _tally(unexplained, fixed, physical, unknowns, values, diagonal, squares, largest, sums):
    """Squares and largest entries of: free forces, forces in supports, prescribed values missed; displacements."""
    for i in range(len(unexplained)):
        for k in range(unexplained.shape[1]):
            force, u, stiffness = abs(unexplained[i, k]), abs(physical[i, k]), abs(diagonal[i, k])
            if fixed[i, k]:
                missed = abs(unknowns[i, k] - values[i, k])
                squares[1] += force * force
                squares[2] += missed * missed
                largest[2] = max(largest[2], missed)
            else:
                squares[0] += force * force
                largest[0] = max(largest[0], force)
                sums[k] += unexplained[i, k]
            squares[3] += (stiffness * u) ** 2
            squares[4] += stiffness * u * u
            largest[3] = max(largest[3], u)


class Tally:
    """Over the nodes of a problem; what has run away makes its numbers infinite or NaN.

    Parameters
    ----------
    unexplained : (n_nodes, dim) array
        Forces that neither loads nor claimed contact forces explain, N.
    fixed : (n_nodes, dim) bool array
    physical, unknowns, values : (n_nodes, dim) arrays
        Displacement of the bodies, the same relative, prescribed values, m.
    diagonal : (n_nodes, dim) array
        Of the matrix, N/m.

    Attributes
    ----------
    free, largest : float
        Norm and largest component of what is unexplained at free dofs, N.
    supports : float
        Norm of the forces at fixed dofs, N.
    moved, furthest : float
        Norm and largest component of the distance from prescribed values, m.
    displacement : float
        The largest component, m.
    stiff, stiff_energy : float
        Norms of D u (N) and of D^1/2 u (sqrt(N m)), D the diagonal.
    sums : (dim,) array
        Of what is unexplained at free dofs, N.
    """

    def __init__(self, unexplained: np.ndarray, fixed: np.ndarray, physical: np.ndarray, unknowns: np.ndarray,
                 values: np.ndarray, diagonal: np.ndarray) -> None:
        squares, largest, self.sums = np.zeros(5), np.zeros(4), np.zeros(unexplained.shape[1])
        _tally(unexplained, fixed, physical, unknowns, values, diagonal, squares, largest, self.sums)
        # the larger of NaN and a number is the number: the squares know
        largest[~np.isfinite(squares[:4])] = np.nan
        self.free, self.supports, self.moved, self.stiff, self.stiff_energy = np.sqrt(squares).tolist()
        self.largest, _, self.furthest, self.displacement = largest.tolist()
