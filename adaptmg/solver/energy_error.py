r"""The energy error of a displacement, estimated from the raw matrix by a few steps of a Galerkin method.

With the contact status of the displacement held, u is first moved onto its constraints by a change z of constrained
dofs alone: v = u + z has its prescribed values, touching nodes on the obstacle, sticking nodes at zero slip. What is
then missing is a correction in the space of the displacements that keep the status,

.. math:: \|u - u_h\|_A \le \|z\|_A + \|v - u_h\|_A,

the solution of :math:`K (I + D) A\,y + K S\,y = e`: e the forces at v that no load, support or lawful contact force
explains, K the projection onto that space, S the stiffness of friction that turns with the slip, D the friction that
a change of the pressure brings (Coulomb). Its Galerkin solution in the span of preconditioned residuals is sought,
without D by conjugate gradients, whose energy grows from step to step and is never too large. The preconditioner:
forward Gauss-Seidel, the rigid motions of :mod:`adaptmg.solver.aggregates`, backward Gauss-Seidel. A residual r
holds at most the energy :math:`r\cdot P r / \lambda`, with the least eigenvalue :math:`\lambda` of the preconditioned
matrix; the least Ritz value of the steps stands for it, which falls towards it. The steps end when this value has
settled and what the last step may have left is small; it is counted as missing. Where they do not settle, a
factorisation decides if the matrix is not too large for one.
What other lines of a certificate need from all nodes, sums and largest entries, a :class:`Tally` takes in one pass.
Nothing here comes from the solvers but the arithmetic of small blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg.blas import daxpy
from scipy.sparse.linalg import splu

from adaptmg._numba import kernel
from adaptmg._threads import in_parts, sum_of_parts
from adaptmg.smoother.blocks import ONE, ZERO, add, increase, read, subtract, times, transposed_times, write
from adaptmg.smoother.strips import Strips
from adaptmg.solver.aggregates import Aggregates, CoarseMatrix

#: least steps, the share of the energy that the last one may have left, and of the least Ritz value that stays
_LEAST, _MISSING, _SETTLED = 3, 0.3, 0.7
#: by how much more than what is negligible an error may be that need not be known better, a step: .6 of rtol after the
#: second, .9 after the third (seen at most 1.46 and 1.09 times too small)
SURER = 3.0
#: steps at most, without and with Coulomb friction, which needs all directions
_MOST, _MOST_COULOMB = 40, 16
#: a direction whose energy is below this share of what the preconditioner makes of it is a motion that nothing holds
FREE = 1e-5
#: of a factorised matrix: what is added to its diagonal, solves, and the share of a residual that they may leave if
#: nothing is free
_SHIFT, _REFINEMENTS, _BALANCED = 1e-14, 4, 1e-6
#: dofs up to which a factorisation is taken where the steps do not settle, by dimension
FACTORISED = {2: 100_000, 3: 30_000}


@dataclass(frozen=True, eq=False)
class FrozenStatus:
    """The displacements that keep a contact status."""

    held: np.ndarray  # (m,) int: nodes that may not move freely: in supports, and in contact
    kept: np.ndarray  # (m, dim, dim): projections there onto what may move
    nodes: np.ndarray  # (n_contact,) int: contact nodes
    stiffening: np.ndarray  # (n_contact, dim, dim): of friction that turns with the slip (3D), N/m
    dragged: np.ndarray  # (n_contact, dim, dim): of friction that grows with the pressure (Coulomb)

    def project(self, vector: np.ndarray) -> None:
        """Leave of a vector (n_nodes, dim) the part that may move, in place."""
        vector[self.held] = np.einsum("nij,nj->ni", self.kept, vector[self.held])

    @property
    def symmetric(self) -> bool:
        """Whether the pressure does not change friction."""
        return not self.dragged.any()


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


@kernel
def _multiply(first, last, zero, indptr, indices, data, vector, image, diagonal):
    dim = np.uint64(len(zero))
    size = dim * dim
    for node in range(first, last):
        i, total = np.uint64(node), zero
        for p in range(indptr[node], indptr[node + 1]):
            at, j = size * np.uint64(p), np.uint64(indices[p])
            total = add(total, times(data, at, read(vector, dim * j, zero)))
            if i == j:
                for k in range(size):
                    diagonal[size * i + k] = data[at + k]
        write(image, dim * i, total)


def product_and_diagonal(matrix: sparse.bsr_array, vector: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A v (n_dofs,) and the diagonal blocks (n_nodes, dim, dim) of A, in one pass."""
    n, dim = len(matrix.indptr) - 1, matrix.blocksize[0]
    image, diagonal = np.empty(n * dim), np.empty(n * dim * dim)
    in_parts(_multiply, n, matrix.data.size, ZERO[dim], matrix.indptr, matrix.indices, matrix.data.reshape(-1), vector,
             image, diagonal)
    return image, diagonal.reshape(n, dim, dim)


@kernel
def _invert(first, last, zero, blocks):
    """Blocks of size dim become their inverses, by cofactors."""
    dim = len(zero)
    v = np.empty((dim, dim))
    for i in range(first, last):
        d = blocks[i]
        if dim == 2:
            v[0, 0], v[0, 1], v[1, 0], v[1, 1] = d[1, 1], -d[0, 1], -d[1, 0], d[0, 0]
        else:
            v[0, 0], v[1, 1] = d[1, 1] * d[2, 2] - d[1, 2] * d[2, 1], d[0, 0] * d[2, 2] - d[0, 2] * d[2, 0]
            v[0, 1] = v[1, 0] = d[0, 2] * d[2, 1] - d[0, 1] * d[2, 2]
            v[0, 2] = v[2, 0] = d[0, 1] * d[1, 2] - d[0, 2] * d[1, 1]
            v[1, 2] = v[2, 1] = d[0, 2] * d[1, 0] - d[0, 0] * d[1, 2]
            v[2, 2] = d[0, 0] * d[1, 1] - d[0, 1] * d[1, 0]
        determinant = 0.0
        for k in range(dim):
            determinant += d[0, k] * v[k, 0]
        for k in range(dim):
            for m in range(dim):
                d[k, m] = v[k, m] / determinant


@kernel
def _forward(first, last, order, zero, indptr, indices, data, rank, inverse, load, u, rest):
    """Gauss-Seidel from zero over places of ``order``, and the residual that it leaves in ``rest``, which comes as 0.
    Of the matrix the half that couples a node with those of lower ``rank`` is read."""
    dim = np.uint64(len(zero))
    size = dim * dim
    for place in range(first, last):
        i = np.uint64(order[place])
        own, r = rank[i], read(load, dim * i, zero)
        for p in range(indptr[i], indptr[i + ONE]):
            if rank[indices[p]] < own:
                r = subtract(r, times(data, size * np.uint64(p), read(u, dim * np.uint64(indices[p]), zero)))
        value = times(inverse, size * i, r)
        write(u, dim * i, value)
        for p in range(indptr[i], indptr[i + ONE]):
            if rank[indices[p]] < own:
                at = dim * np.uint64(indices[p])
                write(rest, at, subtract(read(rest, at, zero), transposed_times(data, size * np.uint64(p), value)))


@kernel
def _backward(first, last, order, zero, indptr, indices, data, rank, inverse, load, u, image):
    """Gauss-Seidel from u, and the matrix times what it ends with in ``image``, which comes as 0, in one pass. Rows are
    read from their end: memory that is read in one direction comes in advance, in 3D in a third of the time."""
    dim = np.uint64(len(zero))
    size = dim * dim
    for place in range(last - 1, first - 1, -1):
        i = np.uint64(order[place])
        own, on_diagonal, total = rank[i], indptr[i], zero
        for p in range(indptr[i + ONE] - 1, indptr[i] - 1, -1):
            j = np.uint64(indices[p])
            if j == i:
                on_diagonal = p
            else:
                total = add(total, times(data, size * np.uint64(p), read(u, dim * j, zero)))
        value = times(inverse, size * i, subtract(read(load, dim * i, zero), total))
        change = subtract(value, read(u, dim * i, zero))
        write(u, dim * i, value)
        increase(image, dim * i, add(total, times(data, size * np.uint64(on_diagonal), value)))
        # later nodes were multiplied with what was here before
        for p in range(indptr[i], indptr[i + ONE]):
            if rank[indices[p]] > own:
                increase(image, dim * np.uint64(indices[p]), transposed_times(data, size * np.uint64(p), change))


class Preconditioner:
    """Forward Gauss-Seidel, coarse correction, backward Gauss-Seidel on the matrix of a status. ``diagonal``, the
    diagonal blocks of the matrix, is overwritten."""

    def __init__(self, matrix: sparse.bsr_array, diagonal: np.ndarray, status: FrozenStatus,
                 aggregates: Aggregates) -> None:
        n, dim, _ = diagonal.shape
        self._zero = ZERO[dim]
        self._strips = Strips.of(matrix.indptr, matrix.indices, dim * dim, stored=False)
        self._matrix = matrix.indptr, matrix.indices, matrix.data.reshape(-1), self._strips.rank
        diagonal[status.nodes] += status.stiffening
        number = np.full(n, -1, dtype=np.int32)
        number[status.held] = np.arange(len(status.held))
        self._coarse = CoarseMatrix(aggregates, matrix, diagonal, number, status.kept)
        # what is projected away has no stiffness
        stiffness, axes = np.linalg.eigh(status.kept @ diagonal[status.held] @ status.kept)
        size = np.abs(stiffness)
        stiffness[size <= 1e-12 * size.max(axis=1, initial=0.0, keepdims=True)] = np.inf
        in_parts(_invert, n, 20 * n, self._zero, diagonal)
        diagonal[status.held] = (axes / stiffness[:, None]) @ axes.swapaxes(1, 2)
        self._inverse = diagonal.reshape(-1)

    def __call__(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The preconditioned residual (n_nodes, dim), and the stored matrix times it."""
        # what the forward sweep leaves of the residual, then the product
        result, image = np.empty_like(residual), np.zeros_like(residual)
        flat = image.reshape(-1)
        given = self._zero, *self._matrix, self._inverse, residual.reshape(-1), result.reshape(-1), flat
        self._strips.sweep(_forward, *given)
        self._coarse.correct(flat, result.reshape(-1))
        image[:] = 0.0
        self._strips.sweep(_backward, *given, backward=True)
        return result, image


@dataclass(frozen=True, eq=False)
class HeldCorrection:
    """Of a displacement, in the space of its status."""

    energy: float  # N m; infinite where the status leaves a motion free that is loaded
    moved: np.ndarray  # (n_contact, dim): the correction at the contact nodes, m
    forces: np.ndarray  # (n_contact, dim): the matrix times it there, N


def correction(matrix: sparse.bsr_array, diagonal: np.ndarray, status: FrozenStatus, residual: np.ndarray,
               aggregates: Aggregates | None, negligible: float = 0.0, rounding: float = 0.0) -> HeldCorrection:
    """The correction that a residual brings about in the space of a status. If its energy is at most ``negligible``
    after the first step, 36 times that after the second, or 81 times after the third, that is the answer. A residual
    whose norm is at most ``rounding`` loads no motion. The diagonal blocks and the residual are overwritten."""
    status.project(residual)
    size, none = _dot(residual, residual), np.zeros((len(status.nodes), residual.shape[1]))
    if not 0.0 < size < np.inf:
        return HeldCorrection(0.0 if size == 0.0 else np.inf, none, none)
    if aggregates is None:
        return _factorised(matrix, status, residual, rounding)
    given = residual.copy() if matrix.shape[0] <= FACTORISED[residual.shape[1]] else None
    precondition = Preconditioner(matrix, diagonal, status, aggregates)
    found, settled = _estimated(matrix, status, residual, precondition, negligible)
    return found if settled or given is None else _factorised(matrix, status, given, rounding)


def _estimated(matrix: sparse.bsr_array, status: FrozenStatus, residual: np.ndarray, precondition: Preconditioner,
               negligible: float) -> tuple[HeldCorrection, bool]:
    """A Galerkin solution, and whether further steps would change it little; overwrites the residual."""
    symmetric, energy, ritz = status.symmetric, 0.0, np.inf
    # orthonormal directions, what the equations make of them, and them and the matrix times them at contact nodes
    kept: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    equations, load, shares = np.empty((_MOST_COULOMB, _MOST_COULOMB)), np.empty(_MOST_COULOMB), np.empty(0)
    # preconditioned residuals, of unit length in the norm of the preconditioner, by the directions
    basis = np.zeros((_MOST, _MOST))
    at, total, free = status.nodes, np.zeros((2, len(status.nodes), residual.shape[1])), float("inf")
    for step in range(1, (_MOST if symmetric else _MOST_COULOMB) + 1):
        direction, forces = precondition(residual)
        product, before = _dot(residual, direction), energy
        if not product > 0.0:
            return HeldCorrection(energy, *total), True
        here = np.stack([direction[at], forces[at]])
        dragged = np.einsum("nij,nj->ni", status.dragged, forces[at])
        forces[at] += np.einsum("nij,nj->ni", status.stiffening, direction[at])
        square = _dot(direction, forces)
        overlaps = [_dot(other, forces) for other, *_ in kept]
        forces[at] += dragged
        status.project(forces)
        for overlap, (other, of_other, there) in zip(overlaps, kept, strict=True):
            _add(-overlap, other, direction)
            _add(-overlap, of_other, forces)
            here -= overlap * there
            square -= overlap * overlap
        if not square > FREE * product:
            return HeldCorrection(free, *total), False
        for vector in (direction, forces, here):
            vector /= np.sqrt(square)
        if symmetric:
            share = _dot(direction, residual)
            kept = [(direction, forces, here)]
            _add(-share, forces, residual)
            total += share * here
            energy += share * share
        else:
            kept.append((direction, forces, here))
            try:
                shares, taken = _galerkin(equations, load, shares, kept, residual), np.append(shares, 0.0)
            except np.linalg.LinAlgError:
                return HeldCorrection(free, *total), False
            for share, (_, f, there) in zip(shares - taken, kept, strict=True):
                _add(-share, f, residual)
                total += share * there
            energy = float(shares @ shares)
        if energy <= negligible:
            return HeldCorrection(energy, *total), True
        basis[step - 1 - len(overlaps):step, step - 1] = np.append(overlaps, np.sqrt(square)) / np.sqrt(product)
        last, ritz = ritz, np.linalg.svd(basis[:step, :step], compute_uv=False)[-1] ** 2
        whole = max(before + product / ritz, energy)
        left = whole - energy if symmetric else max(whole - energy, abs(energy - before))
        if step > 1 and whole <= (min(step, _LEAST) * SURER) ** 2 * negligible:
            return HeldCorrection(whole, *total), True
        if step >= _LEAST and left <= _MISSING * energy and ritz >= _SETTLED * last:
            return HeldCorrection(whole, *total), True
    return HeldCorrection(energy, *total), False


def _galerkin(equations: np.ndarray, load: np.ndarray, shares: np.ndarray,
              kept: list[tuple[np.ndarray, np.ndarray, np.ndarray]], residual: np.ndarray) -> np.ndarray:
    """The shares of all directions, the last of which is new; the unsymmetric equations grow by a row and a column."""
    n, (direction, forces, _) = len(kept), kept[-1]
    equations[:n - 1, n - 1] = [_dot(v, forces) for v, *_ in kept[:-1]]
    equations[n - 1, :n] = [_dot(direction, f) for _, f, _ in kept]
    # what is left of the load and what the earlier directions take of it
    load[n - 1] = _dot(direction, residual) + shares @ equations[n - 1, :n - 1]
    return np.linalg.solve(equations[:n, :n], load[:n])


def _factorised(matrix: sparse.bsr_array, status: FrozenStatus, residual: np.ndarray, rounding: float
                ) -> HeldCorrection:
    _, _, whole, shift = frozen_matrices(matrix, status)
    found, balanced = refined(whole, shift, residual.reshape(-1), residual.size, rounding)
    nodal, image = found.reshape(residual.shape), (matrix @ found).reshape(residual.shape)
    energy = max(_dot(nodal, image), 0.0) if balanced else float("inf")
    return HeldCorrection(energy, nodal[status.nodes], image[status.nodes])


def frozen_matrices(matrix: sparse.bsr_array, status: FrozenStatus
                    ) -> tuple[sparse.sparray, sparse.sparray, sparse.sparray, np.ndarray]:
    """K (I + D), K, the matrix of a status, and what makes it regular where motions are free (n_dofs,)."""
    n, dim = matrix.shape[0] // matrix.blocksize[0], matrix.blocksize[0]
    eye = np.tile(np.eye(dim), (n, 1, 1))

    def by_node(nodes: np.ndarray, blocks: np.ndarray, others: np.ndarray) -> sparse.bsr_array:
        every = others.copy()
        every[nodes] = blocks
        return sparse.bsr_array((every, np.arange(n), np.arange(n + 1)), shape=matrix.shape)

    keep = by_node(status.held, status.kept, eye)
    stiffening, dragged = (by_node(status.nodes, blocks, 0 * eye) for blocks in (status.stiffening, status.dragged))
    taken = keep + keep @ dragged
    # what may not move gets a diagonal of the size of the others, and what is free a little
    most, every = np.abs(matrix.diagonal()).max(), sparse.eye_array(matrix.shape[0])
    whole = (taken @ matrix + keep @ stiffening) @ keep + most * (every - keep)
    return taken, keep, whole, np.full(matrix.shape[0], _SHIFT * most)


def refined(whole: sparse.sparray, shift: np.ndarray, load: np.ndarray, n: int, rounding: float
            ) -> tuple[np.ndarray, bool]:
    """The solution for a load by factors of the matrix with a shift, and whether it balances the first n entries."""
    whole = sparse.csc_array(whole)
    factors, found, rest = splu(sparse.csc_array(whole + sparse.diags_array(shift))), np.zeros(len(load)), load
    most_left = max(_BALANCED * np.linalg.norm(load[:n]), rounding)
    for _ in range(_REFINEMENTS):
        found += factors.solve(rest)
        rest = load - whole @ found
        if np.linalg.norm(rest[:n]) <= most_left:
            return found, True
    return found, False


def _add(factor: float, vector: np.ndarray, to: np.ndarray) -> None:
    """To += factor vector, in one pass."""
    daxpy(vector.reshape(-1), to.reshape(-1), a=factor)


def _dot(a: np.ndarray, b: np.ndarray) -> float:
    return float(sum_of_parts(_dot_of_rows, len(a), 2 * a.size, a, b))


def _dot_of_rows(first: int, last: int, a: np.ndarray, b: np.ndarray) -> float:
    return np.vdot(a[first:last], b[first:last])


@kernel
def _tally(unexplained, fixed, physical, unknowns, values, diagonal, squares, largest, sums):
    """Squares and largest entries of: free forces, forces in supports, prescribed values missed; displacements. Sums
    of free forces by component, and of the sizes of those in supports."""
    for i in range(len(unexplained)):
        for k in range(unexplained.shape[1]):
            force, u, stiffness = abs(unexplained[i, k]), abs(physical[i, k]), abs(diagonal[i, k, k])
            if fixed[i, k]:
                missed = abs(unknowns[i, k] - values[i, k])
                squares[1] += force * force
                sums[-1] += force
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
    """Over the nodes of a problem; what has run away makes its numbers infinite or NaN."""

    def __init__(self, unexplained: np.ndarray, fixed: np.ndarray, physical: np.ndarray, unknowns: np.ndarray,
                 values: np.ndarray, diagonal: np.ndarray) -> None:
        squares, largest, sums = np.zeros(5), np.zeros(4), np.zeros(unexplained.shape[1] + 1)
        _tally(unexplained, fixed, physical, unknowns, values, diagonal, squares, largest, sums)
        self.sums, self.in_supports = sums[:-1], float(sums[-1])
        # the larger of NaN and a number is the number: the squares know
        largest[~np.isfinite(squares[:4])] = np.nan
        self.free, self.supports, self.moved, self.stiff, self.stiff_energy = np.sqrt(squares).tolist()
        self.largest, _, self.furthest, self.displacement = largest.tolist()
