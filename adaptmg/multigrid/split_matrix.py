r"""SplitMatrix: a block matrix stored as strict lower part L, strict upper part U and inverse
diagonal blocks.

Gauss-Seidel sweeps in turn, backward after forward, need the half that has changed only: with
:math:`s = f - L u` kept from the forward sweep, the backward one is :math:`D u_i = s_i - U_i u`,
and leaves the residual :math:`f - s - L u`. A half is streamed by itself and counts as half a pass:
a symmetric sweep from zero and its residual take three. L couples a node with those before it in
the order of the sweeps, :class:`~adaptmg.smoother.strips.Strips`. Of a symmetric matrix L alone is
stored where the sweeps scatter :math:`L^T`, of a lattice each of its rows once
(:func:`_shared_rows`). Rows and columns of fixed dofs are zero.
:func:`galerkin_levels` splits the matrices of all levels of a hierarchy.

A nodal prolongation P acts on every component, one of dofs as of nodes with one component: the
length of ``zero`` (see
:mod:`adaptmg.smoother.blocks`) says which. Restriction scatters.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from adaptmg._checks import indices_frozen
from adaptmg._numba import inner_kernel, kernel
from adaptmg._threads import LARGE, in_colours, in_parts, scattering
from adaptmg.discrete.block_rows import BlockRows, table_column, table_row
from adaptmg.discrete.elasticity import ALL_NODES
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.grids import Grids
from adaptmg.level import Level
from adaptmg.mesh.arrays import mask_of
from adaptmg.problem.loads import PointSpring, Spring
from adaptmg.smoother.blocks import (
    BACKWARD,
    FORWARD,
    ORIGIN,
    ZERO,
    add,
    in_loop,
    inner,
    minus_row,
    read,
    scale,
    times,
    write,
)
from adaptmg.smoother.strips import Strips
from adaptmg.transfer.galerkin import coarse_matrix, without_fixed, without_idle_rows


@dataclass(eq=False)
class SplitMatrix:
    """A matrix of ``dim`` x ``dim`` blocks in Cartesian components, fixed dofs eliminated."""

    dim: int
    # (n_nodes,) int32, where nodes share rows: the number of the row of L, and of the diagonal block, of each node.
    # (0,): row p of L is that of the node at place p of the sweeps, diagonal block i that of node i
    kinds: np.ndarray
    lower_indptr: np.ndarray  # (n_rows + 1,) int32
    # int32: block columns, ascending in a row; with ``kinds`` they count from the node
    lower_indices: np.ndarray
    lower: np.ndarray  # blocks, row by row, flat
    upper_indptr: np.ndarray  # as those of L; empty: U is the transpose of L
    upper_indices: np.ndarray
    upper: np.ndarray
    # (n_blocks * dim * dim,): diagonal blocks; (0,) after :meth:`drop_diagonal`
    diagonal: np.ndarray
    inverse: np.ndarray  # (n_blocks * dim * dim,): their inverses, see :func:`invert_block`
    fixed: np.ndarray  # (n_fixed,) int64: fixed dofs
    nonzeros: int  # stored entries of the whole matrix, the unit of work on this level
    strips: Strips  # the order of the sweeps
    # after :meth:`set_aside`: the rows of the matrix and the fixed dofs, from which L is made again
    aside: tuple[BlockRows, np.ndarray] | None = None

    @cached_property
    def n_nodes(self) -> int:
        return len(self.strips.order)

    @cached_property
    def n_dofs(self) -> int:
        return self.n_nodes * self.dim

    @property
    def symmetric(self) -> bool:
        """Return whether U is not stored, being the transpose of L."""
        return len(self.upper_indptr) == 0

    @property
    def size_of_lower(self) -> int:
        """Return the number of entries of L of a symmetric matrix, shared ones counted for each node."""
        return (self.nonzeros - self.dim * self.n_dofs) // 2

    @property
    def shared_arrays(self) -> tuple[np.ndarray, ...]:
        """Return what sweeps read that need L alone: ``kinds``, the three arrays of L, and the inverse
        blocks."""
        return self.kinds, self.lower_indptr, self.lower_indices, self.lower, self.inverse

    @property
    def lower_arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.lower_indptr, self.lower_indices, self.lower

    @property
    def upper_arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self.upper_indptr, self.upper_indices, self.upper

    def sweep(
        self, kernel: Callable[..., None], *arguments: object, backward: bool = False
    ) -> None:
        """Run a kernel over all nodes in the order of the sweeps, ``zero`` before its
        ``arguments``."""
        self.strips.sweep(kernel, ZERO[self.dim], *arguments, backward=backward)

    @cached_property
    def no_half(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the arrays of a half without entries."""
        return np.zeros_like(self.lower_indptr), self.lower_indices[:0].copy(), np.empty(0)

    @property
    def diagonal_sizes(self) -> np.ndarray:
        """Return the absolute values of the diagonal entries (n_dofs,)."""
        return np.abs(self.diagonal_blocks().diagonal(axis1=1, axis2=2)).reshape(-1)

    def diagonal_blocks(self, nodes: np.ndarray | slice = ALL_NODES) -> np.ndarray:
        """Return the diagonal blocks (n, dim, dim) of nodes."""
        blocks = self.diagonal.reshape(-1, self.dim, self.dim)
        return blocks[self.kinds[nodes] if len(self.kinds) else nodes]

    def drop_diagonal(self) -> None:
        """Free the diagonal blocks, which :meth:`at_slots`, :meth:`dense`, :meth:`matrix`,
        :meth:`diagonal_blocks` and :attr:`diagonal_sizes` need."""
        self.diagonal = np.empty(0)

    def set_aside(self, rows: BlockRows, fixed: np.ndarray) -> bool:
        """Free L and the inverse blocks of a large symmetric matrix, unless nodes share rows, until
        :meth:`complete` makes them again from the ``rows`` of the whole matrix and the mask ``fixed``
        (n_dofs,); return whether it is large."""
        if not self.symmetric or self.size_of_lower < LARGE:
            return False
        if not len(self.kinds):
            self.lower_indices = np.empty(0, dtype=np.int32)
            self.lower = np.empty(0)
            self.inverse = np.empty(0)
            self.aside = rows, fixed
        return True

    def complete(self) -> None:
        """Make L and the inverse blocks again, if they were set aside."""
        if self.aside is not None:
            again = split(*self.aside, symmetric=True)
            self.aside = None
            self.lower_indices = again.lower_indices
            self.lower = again.lower
            self.inverse = again.inverse

    def at_slots(self, slots: np.ndarray) -> np.ndarray:
        """Return the blocks at ``slots`` (n,), numbers of blocks (L first, then the diagonal, then U), as a
        flat array (n * dim^2,)."""
        result = np.empty((len(slots), self.dim**2))
        first = 0
        # part by part: 3 ms less for hierarchy and solve with 263k nodes than joined
        for part in (self.lower, self.diagonal, self.upper):
            blocks = part.reshape(-1, self.dim**2)
            # numbers and take: half of the time of masks
            inside = np.flatnonzero((slots >= first) & (slots < first + len(blocks)))
            result[inside] = blocks.take(slots.take(inside) - first, axis=0)
            first += len(blocks)
        return result.reshape(-1)

    @cached_property
    def _entries(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the numbers (n,) of the blocks of L, shared ones for each node, and their block rows (n,)
        and columns (n,)."""
        half = BlockRows(self.dim, self.kinds, self.lower_indptr, self.lower_indices, self.lower)
        order = self.strips.order
        places, columns, rows = half.entries(order if len(self.kinds) else np.arange(len(order)))
        return places, order[rows], columns

    @cached_property
    def _places(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return the block rows (n,) and columns (n,) of L, of D and of U."""
        diagonal = np.arange(self.n_nodes)
        _, row, lower = self._entries
        upper = (
            (lower, row)
            if self.symmetric
            else (
                np.repeat(self.strips.order, np.diff(self.upper_indptr)),
                self.upper_indices.astype(np.int64),
            )
        )
        return [(row, lower), (diagonal, diagonal), upper]

    @property
    def _blocks(self) -> list[np.ndarray]:
        """Return the blocks (n, dim, dim) of L, of D and of U at :attr:`_places`."""
        lower, upper = (part.reshape(-1, self.dim, self.dim) for part in (self.lower, self.upper))
        lower = lower[self._entries[0]]
        upper = lower.transpose(0, 2, 1) if self.symmetric else upper
        return [lower, self.diagonal_blocks(), upper]

    @cached_property
    def _order(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the permutation (n_blocks,) that sorts all blocks, those of L, D and U one after the other,
        by rows and in each row by columns; and indptr (n_nodes + 1,) and indices (n_blocks,) of the whole
        matrix."""
        row, column = (np.concatenate(part) for part in zip(*self._places, strict=True))
        order = np.lexsort((column, row))
        return (
            order,
            np.append(0, np.cumsum(np.bincount(row, minlength=self.n_nodes))),
            column[order],
        )

    def dense(self) -> np.ndarray:
        """Return the whole matrix (n_dofs, n_dofs) as an array; needs ``diagonal``."""
        result = np.zeros((self.n_nodes, self.dim, self.n_nodes, self.dim))
        for (row, column), blocks in zip(self._places, self._blocks, strict=True):
            result[row, :, column] = blocks
        return result.reshape(self.n_dofs, self.n_dofs)

    def matrix(self) -> sparse.bsr_array:
        """Return the whole matrix (n_dofs, n_dofs), sorted; needs ``diagonal``."""
        order, indptr, indices = self._order
        return sparse.bsr_array(
            (np.concatenate(self._blocks)[order], indices, indptr),
            shape=(self.n_dofs, self.n_dofs),
        )


def split(
    matrix: sparse.bsr_array | BlockRows, fixed: np.ndarray, symmetric: bool = False
) -> SplitMatrix:
    """Split a block matrix into its halves, with the rows and columns of dofs in the mask ``fixed``
    (n_dofs,) zeroed. Of a ``symmetric`` one U is not stored."""
    rows = BlockRows.of(matrix)
    dim = rows.dim
    n = rows.n_nodes
    size = rows.nonzeros
    strips = Strips.of(rows)
    lower_indptr = np.zeros(n + 1, dtype=np.int32)
    upper_indptr = np.zeros(n + 1, dtype=np.int32)
    # row pointers of both halves from the number of blocks in a row; the first three arrays are kinds,
    # indptr and indices
    in_parts(
        count, n, size, strips.order, *rows.arrays[:3], strips.rank, lower_indptr, upper_indptr
    )
    nonzeros = (int(lower_indptr.sum() + upper_indptr.sum()) + n) * dim * dim
    dofs = np.flatnonzero(fixed)
    held = mask_of(dofs // dim, n)  # nodes with fixed dofs
    kinds = np.empty(0, dtype=np.int32)
    nodes = strips.order  # whose rows are stored
    if symmetric:
        upper_indptr = upper_indptr[:0].copy()
        if len(rows.kinds):
            kinds, nodes = _shared_rows(rows, strips, lower_indptr[1:], held)
            lower_indptr = np.append(np.int32(0), lower_indptr[1:][strips.rank[nodes]])
    for counts in (lower_indptr, upper_indptr):
        np.cumsum(counts, out=counts)
    below = int(lower_indptr[-1])
    above = int(upper_indptr[-1]) if len(upper_indptr) else 0
    # room for the halves and the diagonal, which the kernel fills
    lower_indices = np.empty(below, dtype=np.int32)
    upper_indices = np.empty(above, dtype=np.int32)
    lower = np.empty(below * dim * dim)
    upper = np.empty(above * dim * dim)
    diagonal = np.empty(len(nodes) * dim * dim)
    inverse = np.empty(len(nodes) * dim * dim)
    in_parts(
        distribute,
        len(nodes),
        len(nodes) * size // n,  # numbers in these rows, about
        nodes,
        ZERO[dim],
        *rows.arrays,
        strips.rank,
        ~fixed,
        held,
        len(kinds) > 0,
        lower_indptr,
        lower_indices,
        lower,
        upper_indptr,
        upper_indices,
        upper,
        diagonal,
        inverse,
    )
    return SplitMatrix(
        dim=dim,
        kinds=kinds,
        lower_indptr=lower_indptr,
        lower_indices=lower_indices,
        lower=lower,
        upper_indptr=upper_indptr,
        upper_indices=upper_indices,
        upper=upper,
        diagonal=diagonal,
        inverse=inverse,
        fixed=dofs,
        nonzeros=nonzeros,
        strips=strips,
    )


def _shared_rows(
    rows: BlockRows, strips: Strips, below: np.ndarray, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the number (n_nodes,) int32 of the row of L of each node of a lattice, and for each row a
    node (n_rows,) that has it.

    Nodes of one kind share a row if their rows of L have equally many blocks: ``below`` (n_nodes,), by
    place. This number says which blocks: strips, even ones and then odd ones, are ranges of numbers, so
    that L has the last of the blocks before the diagonal in an even strip, in an odd one all of these
    and the last of those after it. Nodes with fixed dofs, ``held`` (n_nodes,), and their neighbours
    share no row. Hierarchy and solve take 368 bytes a dof with 66k nodes, 504 with 36k in space; with a
    row for each node 437 and 546."""
    places_of_kind = int(np.diff(rows.indptr).max()) + 1
    n_codes = places_of_kind * (len(rows.indptr) - 1)
    code = np.int32(places_of_kind) * rows.kinds[strips.order] + below
    near = np.unique(rows.entries(np.flatnonzero(held))[1])
    code[strips.rank[near]] = n_codes + np.arange(len(near))
    node = np.full(n_codes + len(near), -1, dtype=np.int32)
    node[code] = strips.order
    number = np.cumsum(node >= 0, dtype=np.int32) - 1
    kinds = np.empty_like(strips.order)
    kinds[strips.order] = number[code]
    return kinds, node[node >= 0]


def nodal_prolongations(hierarchy: Grids) -> list[sparse.csr_array]:
    """Return the prolongations between neighbours, coarsest first, columns sorted."""
    # unsorted ones are copied: those of the hierarchy stay unchanged
    return [
        P if P.has_sorted_indices else indices_frozen(P.sorted_indices())
        for P in (level.prolongation for level in hierarchy.levels[1:])
    ]


def galerkin_levels(hierarchy: Grids, prolongations: list[sparse.csr_array]) -> list[SplitMatrix]:
    """Return the Galerkin matrices of all levels, coarsest first.

    On nested meshes the discretised matrix is the Galerkin one and is taken over, either without a
    test, if the meshes are nested by construction (:func:`_of_nested_elements`), or if the matrices
    pass one (:func:`_nested`). Matrices of coupled bodies are always products: truncated ones need
    more entries near contact. No truncation changes the finest of several matrices: it stays
    symmetric, and one half of it is stored. Idle nodes of a level are those that no node of the next
    finer one is interpolated from."""
    fine = hierarchy.finest.discrete
    rows = fine.decoupled_rows
    result = [split(rows, fine.fixed, symmetric=len(hierarchy) > 1)]
    # the prolongation of the last product, whose idle nodes the next product leaves out; None after a
    # discretised matrix, which has none
    finer = None
    for above, level, nodal in zip(
        reversed(hierarchy.levels[1:]),
        reversed(hierarchy.levels[:-1]),
        reversed(prolongations),
        strict=True,
    ):
        coarse = level.discrete_or_none
        if coarse is None:
            # a coarse space, made from the finest matrix with its products
            rows = BlockRows.of(level.matrix)
            fixed = np.zeros(level.matrix.shape[0], dtype=bool)
            result.insert(0, split(rows, fixed))
            continue
        # all levels above a discretised one are discretised, too. By construction the coarse matrix is the
        # Galerkin one of the discretised finer matrix, not of a product that took its place
        if not coarse.between_bodies and (
            (rows is above.discrete.decoupled_rows and _of_nested_elements(hierarchy, above, level))
            or _nested(above, rows.matrix, nodal, coarse.decoupled_rows.matrix)
        ):
            rows = coarse.decoupled_rows
            finer = None
        else:
            # P'AP without the fixed dofs of the finer level and without its idle nodes
            free_matrix = _without_fixed(rows.matrix, fine, nodal, coarse)
            finer = without_idle_rows(nodal, finer)
            rows = BlockRows.of(coarse_matrix(free_matrix, finer))
        fine = coarse
        result.insert(0, split(rows, coarse.fixed))
    return result


def _of_nested_elements(hierarchy: Grids, above: Level, below: Level) -> bool:
    """Return whether the coarse matrix is by construction the Galerkin matrix of the finer one if this
    is discretised, too: both are of linear elements with constant moduli on lattices of one body,
    the finer lattice divides the coarser one by the same number along all axes, and the
    prolongation is their interpolation. All else is left to the test of the matrices, which takes 20 ms
    with 263k nodes, of 530 for hierarchy and solve."""
    fine = above.posed
    coarse = below.posed
    if hierarchy.transfer is not None or fine is None or coarse is None:
        return False
    problem = fine.problem
    if problem is not coarse.problem or problem.elements != "linear" or problem.axisymmetric:
        return False
    if any(isinstance(support, Spring | PointSpring) for support in problem.supports):
        return False
    if any(material.anisotropy or material.inelastic for material in fine.materials):
        return False
    # of each mesh the lattices, by their numbers of cells along the axes
    lattices = fine.mesh.lattices, coarse.mesh.lattices
    if [len(of_mesh) for of_mesh in lattices] != [1, 1] or (fine.mesh.box != coarse.mesh.box).any():
        return False
    # diagonals of cells lie on those of the coarse ones only where all axes are divided alike
    ratios = {n / m for n, m in zip(*(only for (only,) in lattices), strict=True)}
    return len(ratios) == 1 and ratios.pop().is_integer()


def _nested(
    above: Level, matrix: sparse.bsr_array, nodal: sparse.csr_array, coarse: sparse.bsr_array
) -> bool:
    """Return whether ``coarse`` is the Galerkin matrix P'AP of ``matrix`` A, P the prolongation of the level
    ``above``: ``nodal`` is P with its columns sorted. The answer is stored in that level, with the
    matrices and P, for which it holds, since growing hierarchies ask each time."""
    key = matrix, coarse, above.prolongation
    stored_key, answer = above.__dict__.get("_galerkin_of", ((None,) * 3, False))
    if any(stored is not present for stored, present in zip(stored_key, key, strict=True)):
        answer = is_galerkin(matrix, nodal, coarse)
        # next to the fields of the frozen level, which it follows from
        object.__setattr__(above, "_galerkin_of", (key, answer))
    return answer


def is_galerkin(
    matrix: sparse.bsr_array,
    nodal: sparse.csr_array,
    coarse: sparse.bsr_array,
    tolerance: float = 1e-9,
) -> bool:
    """Return whether ``coarse`` is P'AP, tested on one pseudo-random vector. Each row is compared
    relative to the terms that it sums, so that errors of a soft body next to a stiff one count."""
    # of nested meshes each coarse node is a fine one, whose row has a single entry. Independent meshes have too
    # few such rows, and go without the products below, 1.4 % of a loop that remeshes. (False, too, for a
    # user-defined prolongation that stores zeros: P'AP is then made.)
    if np.count_nonzero(np.diff(nodal.indptr) == 1) < nodal.shape[1]:
        return False
    transfer = ZERO[matrix.blocksize[0]], nodal.indptr, nodal.indices, nodal.data
    probe = np.random.default_rng(0).random(coarse.shape[0]) - 0.5
    prolonged = np.zeros(matrix.shape[0])
    restricted = np.zeros(len(probe))
    size = 2 * len(prolonged)  # about the numbers that a product with P reads
    # P v, added to the zeros
    in_parts(add_prolonged, nodal.shape[0], size, *transfer, probe, prolonged, prolonged)
    colours = scattering(nodal.indices, nodal.indptr, size)
    in_colours(colours, restrict, *transfer, BlockRows.of(matrix).times(prolonged), restricted)
    # P'A P v against A_c v, relative to |A_c| |v|
    sizes = BlockRows.of(abs(coarse)).times(np.abs(probe))
    difference = restricted - BlockRows.of(coarse).times(probe)
    return bool((np.abs(difference) <= tolerance * sizes).all())


def _without_fixed(
    matrix: sparse.bsr_array,
    fine: DiscreteProblem,
    nodal: sparse.csr_array,
    coarse: DiscreteProblem,
) -> sparse.bsr_array:
    """Return the matrix, without the rows and columns of fixed dofs if free coarse dofs reach them."""
    dim = fine.dim
    fixed = fine.fixed.reshape(-1, dim)
    free = ~coarse.fixed.reshape(-1, dim)
    # a product with all rows takes .1 ms for 7600 nodes, with those of fixed dofs alone .4
    if not (nodal @ free.astype(float))[fixed].any():
        return matrix
    return without_fixed(matrix, fine.fixed)


ONE = np.uint64(1)


@in_loop
def shared_row(kinds, place, i):
    """Return the row of L of node i at a place of the sweep, the number of its diagonal block, and what
    the columns of the row count from."""
    block, origin = table_row(kinds, i)
    return block if len(kinds) > 0 else place, block, origin


@kernel
def gauss_seidel(
    first,
    last,
    order,
    zero,
    backward,
    a_indptr,
    a_indices,
    a,
    b_indptr,
    b_indices,
    b,
    inverse,
    load,
    u,
    remainder,
):
    """Sweep over places of ``order``, forward or backward: D u_i = (f - a u - b u)_i, where a and b are
    the two halves of the matrix; f - a u goes to ``remainder``. ``load`` may be ``remainder``, which
    then stays if a has no entries."""
    dim = np.uint64(len(zero))
    step = BACKWARD if backward else FORWARD
    for k in range(last - first):
        place = last - 1 - k if backward else first + k
        row = np.uint64(place)
        i = np.uint64(order[place])
        dof = dim * i
        force = minus_row(row, ORIGIN, step, a_indptr, a_indices, a, u, read(load, dof, zero))
        write(remainder, dof, force)
        force = minus_row(row, ORIGIN, step, b_indptr, b_indices, b, u, force)
        write(u, dof, times(inverse, dim * dof, force))


@kernel
def subtract_half(first, last, order, zero, indptr, indices, half, u, result):
    """Subtract a half times u from ``result``."""
    dim = np.uint64(len(zero))
    for place in range(first, last):
        row = np.uint64(place)
        at = dim * np.uint64(order[place])
        rest = read(result, at, zero)
        write(result, at, minus_row(row, ORIGIN, FORWARD, indptr, indices, half, u, rest))


@kernel
def restrict(first, last, zero, indptr, indices, weights, r, coarse):
    """Add P' r to ``coarse``; return r'r, the square that norms of residuals sum."""
    dim = np.uint64(len(zero))
    squares = 0.0
    for node in range(first, last):
        i = np.uint64(node)
        force = read(r, dim * i, zero)
        squares += inner(force, force)
        for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
            j = dim * np.uint64(indices[k])
            write(coarse, j, add(read(coarse, j, zero), scale(weights[k], force)))
    return squares


@in_loop
def _plus_prolonged(i, indptr, indices, weights, coarse, e):
    """Return e plus P coarse at node i."""
    for k in range(np.uint64(indptr[i]), np.uint64(indptr[i + ONE])):
        e = add(e, scale(weights[k], read(coarse, np.uint64(len(e)) * np.uint64(indices[k]), e)))
    return e


@kernel
def add_prolonged(first, last, zero, indptr, indices, weights, coarse, begin, u):
    """Write ``begin`` plus P times ``coarse`` to u, which may be ``begin``."""
    for node in range(first, last):
        i = np.uint64(node)
        at = np.uint64(len(zero)) * i
        write(
            u,
            at,
            add(read(begin, at, zero), _plus_prolonged(i, indptr, indices, weights, coarse, zero)),
        )


@kernel
def count(first, last, order, kinds, indptr, indices, rank, lower_counts, upper_counts):
    """Count the blocks of the rows (``kinds, indptr, indices`` of BlockRows) in both halves, those of place k
    at k + 1: the row pointers are their sums. ``order`` has the node at each place, ``rank`` the place of
    each node."""
    for place in range(first, last):
        row, origin = table_row(kinds, np.uint64(order[place]))
        below = 0
        above = 0
        for k in range(np.uint64(indptr[row]), np.uint64(indptr[row + ONE])):
            # no branches: half of them would be mispredicted
            j = table_column(origin, indices, k)
            below += rank[j] < place
            above += rank[j] > place
        lower_counts[place + 1] = below
        upper_counts[place + 1] = above


@in_loop
def _copy(zero, k, to, j, data, half_indices, half):
    """Copy block k, in column j, to place ``to`` of a half."""
    dim = np.uint64(len(zero))
    half_indices[to] = j
    for a in range(dim):
        row = dim * np.uint64(a)
        write(half, dim * dim * to + row, read(data, dim * dim * k + row, zero))


@inner_kernel
def _mask(dim, i, origin, first, last, indices, data, free):
    """Zero rows and columns of fixed dofs in blocks of row i, whose columns count from ``origin``."""
    for k in range(first, last):
        j = origin + np.int64(indices[k])
        for a in range(dim):
            for b in range(dim):
                if not (free[dim * i + a] and free[dim * j + b]):
                    data[(k * dim + a) * dim + b] = 0.0


@kernel
def distribute(
    first,
    last,
    nodes,
    zero,
    kinds,
    indptr,
    indices,
    data,
    rank,
    free,
    held,
    shared,
    lower_indptr,
    lower_indices,
    lower,
    upper_indptr,
    upper_indices,
    upper,
    diagonal,
    inverse,
):
    """Distribute blocks in the rows of ``nodes`` into L, U (unless it is empty), D and its inverse (see
    :func:`invert_block`); blocks of a duplicate or missing diagonal are summed or zero. The rows are those
    of BlockRows, ``kinds`` to ``data``; ``rank`` (n_nodes,) is the place of a node in the order of the
    sweeps, which decides between L and U; ``free`` (n_dofs,) is the mask of free dofs. The couplings
    of fixed dofs are zeroed in a second pass over the rows that have any, which are few. ``held``
    (n_nodes,) tells which nodes have fixed dofs. Of ``shared`` rows columns count from the node, and
    diagonal blocks are numbered as rows, else as nodes. Integers are int64 where :func:`_mask` and
    :func:`invert_block` get them, which would be compiled again for other ones."""
    dim = len(zero)
    block_size = np.int64(len(zero) ** 2)
    size = np.uint64(block_size)
    with_upper = len(upper_indptr) > 0
    # the diagonal block, which its inversion destroys, and the sizes of its pivots
    block = np.empty(block_size)
    scale = np.empty(dim)
    for number in range(first, last):
        i = np.int64(nodes[number])
        place = rank[i]
        origin = i if shared else np.int64(0)
        block_at = block_size * (number if shared else i)
        meets_fixed = held[i]
        for c in range(block_size):
            diagonal[block_at + c] = 0.0
        below = np.uint64(lower_indptr[number])
        above = np.uint64(upper_indptr[number]) if with_upper else np.uint64(0)
        row, row_origin = table_row(kinds, np.uint64(i))
        for k in range(np.uint64(indptr[row]), np.uint64(indptr[row + ONE])):
            j = table_column(row_origin, indices, k)
            meets_fixed |= held[j]
            if rank[j] < place:
                _copy(zero, k, below, np.int64(j) - origin, data, lower_indices, lower)
                below += ONE
            elif rank[j] == place:
                for c in range(block_size):
                    diagonal[block_at + c] += data[size * k + np.uint64(c)]
            elif with_upper:
                _copy(zero, k, above, np.int64(j), data, upper_indices, upper)
                above += ONE
        if meets_fixed:
            _mask(
                dim,
                i,
                origin,
                np.int64(lower_indptr[number]),
                np.int64(below),
                lower_indices,
                lower,
                free,
            )
            if with_upper:
                _mask(
                    dim,
                    i,
                    origin,
                    np.int64(upper_indptr[number]),
                    np.int64(above),
                    upper_indices,
                    upper,
                    free,
                )
            for a in range(dim):
                for b in range(dim):
                    if a != b and not (free[dim * i + a] and free[dim * i + b]):
                        diagonal[block_at + dim * a + b] = 0.0
        for c in range(block_size):
            block[c] = diagonal[block_at + c]
        for a in range(dim):
            scale[a] = abs(block[a * dim + a])
        invert_block(np.int64(dim), block, scale, inverse, block_at)


@inner_kernel
def invert_block(dim, block, scale, result, at):
    """Write the inverse of a block (dim * dim,) to ``result`` from position ``at``: by Gauss-Jordan
    elimination, zero in rows and columns whose diagonal entry vanishes next to ``scale`` (dim,), the size
    that it had before truncation. ``block`` is destroyed."""
    for c in range(dim * dim):
        result[at + c] = 0.0
    for a in range(dim):
        result[at + a * dim + a] = 1.0
    for a in range(dim):
        pivot = block[a * dim + a]
        if abs(pivot) <= 1e-10 * scale[a]:  # vanishes, up to rounding of the truncation
            for b in range(dim):
                block[a * dim + b] = 0.0
                block[b * dim + a] = 0.0
                result[at + a * dim + b] = 0.0
                result[at + b * dim + a] = 0.0
            continue
        for b in range(dim):
            block[a * dim + b] /= pivot
            result[at + a * dim + b] /= pivot
        for row in range(dim):
            factor = block[row * dim + a]
            if row != a and factor != 0.0:
                for b in range(dim):
                    block[row * dim + b] -= factor * block[a * dim + b]
                    result[at + row * dim + b] -= factor * result[at + a * dim + b]
