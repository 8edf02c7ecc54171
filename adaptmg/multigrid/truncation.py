r"""Truncation: the matrices below one level, changed near contact whenever the contact status
changes.

With T dropping closed normals and held tangents, S adding the Newton rows of slip (:math:`row_t
\leftarrow row_t - \mu\,(\tau/|\tau|)\,row_n`) and H the Hessian of the friction, a coarse matrix is

.. math:: P^T T (S A + H) T P = P^T A P + P^T \Delta P,\qquad \Delta = T (S A + H) T - A,

and :math:`\Delta` lives in the block rows and columns of contact nodes only. Changed blocks are
carried down by nodal prolongations through lists of products made once; on coarse spaces that are
given dof by dof (algebraic ones, say) by sparse products. A block is addressed in a split matrix by
one slot number: L first, then the diagonal, then U."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg._numba import ZERO, inner_kernel, kernel
from adaptmg._threads import in_parts
from adaptmg.discrete.block_rows import table_column
from adaptmg.discrete.elasticity import dofs_of
from adaptmg.mesh.arrays import pair_keys
from adaptmg.multigrid.split_matrix import SplitMatrix, invert_block, shared_row
from adaptmg.multigrid.truncated_contact import TruncatedContact
from adaptmg.smoother.blocks import ONE
from adaptmg.smoother.system import CLOSED, HELD, TANGENTIAL


@dataclass(eq=False)
class _Changed:
    """The blocks of the matrix of one coarse level that the contact status changes."""

    level: SplitMatrix
    dim: int  # size of the blocks
    slots: np.ndarray  # (n,) int: where they are stored; see the module
    rows: np.ndarray  # (n,) int: block rows and columns
    columns: np.ndarray

    def __post_init__(self) -> None:
        """Read the blocks before any change."""
        self.base = self.level.at_slots(self.slots)
        self._free = np.ones(self.level.n_dofs, dtype=bool)
        self._free[self.level.fixed] = False

    def store(self, change: np.ndarray) -> None:
        """Write the base blocks plus a change (n * dim^2,), and the inverse diagonal blocks."""
        level = self.level
        store(
            ZERO[self.dim],
            self.slots,
            self.rows,
            self.columns,
            self.base,
            change,
            self._free,
            int(level.lower_indptr[-1]),
            level.lower,
            level.upper,
            level.diagonal,
            level.inverse,
            np.empty(self.dim * self.dim),
            np.empty(self.dim),
        )


@dataclass(eq=False)
class _ChangedDofs(_Changed):
    """Single entries (blocks of size 1), whose changes come by sparse products."""

    weights: sparse.csr_array  # prolongation to the changed dofs of the finer level
    keys: np.ndarray  # (n,) int: row and column of each entry among the changed dofs, sorted

    @classmethod
    def of(
        cls,
        level: SplitMatrix,
        weights: sparse.csr_array,
        dofs: np.ndarray,
        pattern: sparse.csr_array,
    ) -> _ChangedDofs:
        """Find the entries of a level in ``pattern``, a matrix of ones between the changed ``dofs`` (n,);
        ``weights`` is the prolongation from these to the changed dofs of the finer level."""
        entries = sparse.coo_array(pattern)
        # a key is the row times the number of dofs, plus the column
        keys = np.sort(pair_keys(entries.row, entries.col, len(dofs)))
        row_numbers, column_numbers = np.divmod(keys, len(dofs))
        rows = dofs[row_numbers]
        columns = dofs[column_numbers]
        slots = np.empty(len(keys), dtype=np.int64)
        find_slots(
            rows,
            columns,
            level.lower_indptr,
            level.lower_indices,
            level.upper_indptr,
            level.upper_indices,
            level.strips.rank,
            slots,
        )
        if (slots < 0).any():
            raise ValueError(
                "a coarse matrix lacks entries of the Galerkin product near contact: it must be P'AP"
            )
        return cls(
            level, dim=1, slots=slots, rows=rows, columns=columns, weights=weights, keys=keys
        )

    def update(self, change: sparse.csr_array) -> sparse.csr_array:
        """Write the matrix for a change on the finer level; return the change on this level."""
        result = sparse.coo_array(self.weights.T @ (change @ self.weights))
        # a product may leave out entries that happen to vanish
        values = np.zeros(len(self.keys))
        values[np.searchsorted(self.keys, pair_keys(result.row, result.col, result.shape[1]))] = (
            result.data
        )
        self.store(values)
        return sparse.csr_array(result)


@dataclass(eq=False)
class _ChangedBlocks(_Changed):
    """Blocks of nodes, whose changes are sums of products: the change of block ``target`` gets
    ``weight`` times that of block ``source`` of the finer level."""

    source: np.ndarray  # (n_products,) int
    target: np.ndarray  # (n_products,) int
    weight: np.ndarray  # (n_products,)

    def __post_init__(self) -> None:
        super().__post_init__()
        self._change = np.zeros(len(self.base))

    def update(self, change: np.ndarray) -> np.ndarray:
        """Write the matrix for a change on the finer level; return the change on this level."""
        add_contributions(self.dim**2, self.source, self.target, self.weight, change, self._change)
        self.store(self._change)
        return self._change


class DofUpdate:
    """Changes of the levels ``below`` the finest one, finest first, of single dofs, by sparse
    products."""

    def __init__(
        self,
        levels: list[SplitMatrix],
        prolongations: list[sparse.csr_array],
        dim: int,
        rows: np.ndarray,
        columns: np.ndarray,
    ) -> None:
        """Find the dofs of changed blocks at ``rows`` and ``columns`` (n_blocks,), nodes, and those
        that they reach on the levels below."""
        # for each entry of a block, row by row, the dof of its row and that of its column
        row_dofs = np.repeat(dofs_of(rows, dim), dim)
        column_dofs = dofs_of(np.repeat(columns, dim), dim)
        # the changed dofs, and the numbers of rows and columns among them
        dofs, numbers = np.unique(np.append(row_dofs, column_dofs), return_inverse=True)
        self._rows, self._columns = numbers.reshape(2, -1)
        self._size = len(dofs)
        pattern = sparse.csr_array(
            sparse.coo_array(
                (np.ones(len(self._rows)), (self._rows, self._columns)),
                shape=(self._size, self._size),
            )
        )
        self.below: list[_ChangedDofs] = []
        for level, prolongation in zip(reversed(levels), reversed(prolongations), strict=True):
            weights = sparse.csr_array(prolongation[dofs])
            coarse_dofs = np.unique(weights.indices).astype(np.int64)
            weights = sparse.csr_array(weights[:, coarse_dofs])
            reach = sparse.csr_array(
                (np.ones(weights.nnz), weights.indices, weights.indptr), shape=weights.shape
            )
            pattern = sparse.csr_array(reach.T @ (pattern @ reach))
            self.below.append(_ChangedDofs.of(level, weights, coarse_dofs, pattern))
            dofs = coarse_dofs

    def update(self, change: np.ndarray) -> None:
        """Write the matrices for a change (n_blocks * dim^2,) on the finest level."""
        shape = (self._size, self._size)
        matrix = sparse.csr_array(
            sparse.coo_array((change, (self._rows, self._columns)), shape=shape)
        )
        for below in self.below:
            matrix = below.update(matrix)


class NodalUpdate:
    """Changes of the levels ``below`` the finest one, finest first, with nodal prolongations, through
    lists of products that are made once."""

    def __init__(
        self,
        levels: list[SplitMatrix],
        prolongations: list[sparse.csr_array],
        rows: np.ndarray,
        columns: np.ndarray,
    ) -> None:
        """List the products by which changed blocks at ``rows`` and ``columns`` (n_blocks,), nodes, change
        each level below."""
        self.below: list[_ChangedBlocks] = []
        for level, nodal in zip(reversed(levels), reversed(prolongations), strict=True):
            self.below.append(_products(level, nodal, rows, columns))
            rows = self.below[-1].rows
            columns = self.below[-1].columns

    def update(self, change: np.ndarray) -> None:
        """Write the matrices for a change (n_blocks * dim^2,) on the finest level."""
        for below in self.below:
            change = below.update(change)


def _products(
    level: SplitMatrix, nodal: sparse.csr_array, rows: np.ndarray, columns: np.ndarray
) -> _ChangedBlocks:
    """Return the blocks of a level that changes of the blocks at ``rows`` and ``columns`` (n_blocks,),
    nodes, of the finer level reach, by the prolongation ``nodal`` between them."""
    # the block IJ of P'Delta P is the sum of P_iI P_jJ Delta_ij: each fine block has as many products as
    # row i of P has entries, times those of row j
    entries = np.diff(nodal.indptr).astype(np.int64)
    n_products_at_most = int(entries[rows] @ entries[columns])
    source = np.empty(n_products_at_most, dtype=np.int32)
    target = np.empty(n_products_at_most, dtype=np.int32)
    weight = np.empty(n_products_at_most)
    slots = np.empty(n_products_at_most, dtype=np.int64)
    coarse_rows = np.empty(n_products_at_most, dtype=np.int32)
    coarse_columns = np.empty(n_products_at_most, dtype=np.int32)
    below = int(level.lower_indptr[-1])
    above = int(level.upper_indptr[-1])
    number = np.full(below + level.n_nodes + above, -1, dtype=np.int32)
    n_met, n_products, n_lost = fill_contributions(
        rows,
        columns,
        nodal.indptr,
        nodal.indices,
        nodal.data,
        level.lower_indptr,
        level.lower_indices,
        level.upper_indptr,
        level.upper_indices,
        level.strips.rank,
        number,
        source,
        target,
        weight,
        slots,
        coarse_rows,
        coarse_columns,
    )
    if n_lost:
        raise ValueError(
            f"a coarse matrix lacks {n_lost} entries of the Galerkin product near contact: build the coarse "
            "matrices with coarse_matrices='galerkin'"
        )
    return _ChangedBlocks(
        level,
        dim=level.dim,
        slots=slots[:n_met].copy(),
        rows=coarse_rows[:n_met].copy(),
        columns=coarse_columns[:n_met].copy(),
        source=source[:n_products].copy(),
        target=target[:n_products].copy(),
        weight=weight[:n_products].copy(),
    )


class Truncation:
    """Truncates the matrices of the levels below one level for the contact status of that level."""

    def __init__(
        self,
        levels: list[SplitMatrix],
        prolongations: list[sparse.csr_array],
        contact: TruncatedContact,
    ) -> None:
        """Collect the blocks of the finest matrix in rows or columns of contact nodes, and find the
        blocks below that their changes reach."""
        fine = levels[-1]
        rows, columns, blocks = _blocks_at_contact(fine, contact)
        # any order would do: contact node by contact node the blocks written below lie close together
        contact_of_block = np.where(
            contact.contact_of[rows] < 0, contact.contact_of[columns], contact.contact_of[rows]
        )
        order = np.argsort(contact_of_block, kind="stable")
        self.rows = rows[order]
        self.columns = columns[order]
        self.blocks = blocks[order].reshape(-1)
        self.change = np.zeros(len(self.blocks))
        # nodal prolongations have a row for each node, others one for each dof
        if prolongations[-1].shape[0] == fine.n_nodes:
            self.products: NodalUpdate | DofUpdate = NodalUpdate(
                levels[:-1], prolongations, self.rows, self.columns
            )
        else:
            self.products = DofUpdate(levels[:-1], prolongations, fine.dim, self.rows, self.columns)

    def apply(self, contact: TruncatedContact, newton: bool) -> None:
        """Truncate the matrices for a status. Without ``newton`` the bounds g of friction are frozen,
        which keeps them symmetric."""
        changed_blocks(
            ZERO[contact.dim],
            self.rows,
            self.columns,
            self.blocks,
            contact.contact_of,
            contact.codes,
            contact.frames,
            contact.friction,
            contact.direction,
            contact.hessian,
            contact.spring,
            newton,
            self.change,
            *np.empty((2, contact.dim, contact.dim)),  # block and spare
        )
        self.products.update(self.change)

    def restore(self) -> None:
        """Restore the matrices without truncation."""
        for below in self.products.below:
            below.store(np.zeros(len(below.base)))


def _blocks_at_contact(
    fine: SplitMatrix, contact: TruncatedContact
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rows (n,), columns (n,) and blocks (n, dim, dim) of a symmetric matrix, which stores L
    alone, in rows or columns of contact nodes: first the diagonal ones, then the others, each followed
    by its transpose."""
    dim = fine.dim
    # the first three shared arrays are kinds and the two index arrays of L
    found = in_parts(
        _at_contact,
        fine.n_nodes,
        fine.size_of_lower,
        fine.strips.order,
        *fine.shared_arrays[:3],
        contact.contact_of,
    )
    blocks, rows, columns = np.concatenate(found, axis=1)
    # each block of L, followed by its transpose, which is a block of L'
    off_diagonal = fine.lower.reshape(-1, dim, dim).take(np.repeat(blocks, 2), axis=0)
    off_diagonal[1::2] = off_diagonal[1::2].transpose(0, 2, 1)
    return (
        np.append(contact.nodes, np.stack([rows, columns], axis=1)),
        np.append(contact.nodes, np.stack([columns, rows], axis=1)),
        np.concatenate([contact.diagonal.reshape(-1, dim, dim), off_diagonal]),
    )


@kernel
def _at_contact(first, last, order, kinds, indptr, indices, contact_of):
    """Return the blocks of L in rows or columns of contact nodes (3, n): their numbers, block rows and
    block columns."""
    room = 0
    for place in range(first, last):
        row, _, _ = shared_row(kinds, np.uint64(place), np.uint64(order[place]))
        room += indptr[row + ONE] - indptr[row]
    found = np.empty((3, room), dtype=np.int32)
    count = 0
    for place in range(first, last):
        i = np.uint64(order[place])
        row, _, origin = shared_row(kinds, np.uint64(place), i)
        in_row = contact_of[i] >= 0
        for k in range(np.uint64(indptr[row]), np.uint64(indptr[row + ONE])):
            j = table_column(origin, indices, k)
            # no branch: a block that does not count is overwritten by the next one
            found[0, count] = k
            found[1, count] = i
            found[2, count] = j
            count += in_row or contact_of[j] >= 0
    return found[:, :count].copy()


@inner_kernel
def _turn(zero, frames, k, inverse, rows, block, spare):
    """Turn the rows of a block, G block, or else its columns, block G'. G is the frame F of contact
    node k, which turns components into it, or its ``inverse`` F', which turns them back. ``spare``
    (dim, dim) is overwritten."""
    dim = len(zero)
    for a in range(dim):
        for b in range(dim):
            spare[a, b] = 0.0
            # the sum over c of G_ac block_cb, or of G_bc block_ac
            i = a if rows else b
            for c in range(dim):
                entry_of_frame = c * dim + i if inverse else i * dim + c
                turned = block[c, b] if rows else block[a, c]
                spare[a, b] += frames[k * dim * dim + entry_of_frame] * turned
    for a in range(dim):
        for b in range(dim):
            block[a, b] = spare[a, b]


@inner_kernel
def _truncated(a, code, spring):
    """Return whether component a of a contact node with this code and ``spring``, N/m, is truncated: 0 is
    the normal, which moves on where the surface is a spring; the others are tangents."""
    return code & CLOSED != 0 and not spring if a == 0 else code & TANGENTIAL == HELD


@kernel
def changed_blocks(
    zero,
    rows,
    columns,
    blocks,
    contact_of,
    codes,
    frames,
    friction,
    direction,
    hessian,
    spring,
    newton,
    change,
    block,
    spare,
):
    """Write Delta of every collected block, Cartesian, to ``change``. Without ``newton`` the bounds g of
    friction are frozen, and the slip rows stay symmetric. ``block`` and ``spare`` (dim, dim) are
    overwritten. ``zero``, here and below, is ZERO[dim]: loops of fixed length compile in half of the
    time (with the dimension as a number the compiler vectorises each of them)."""
    dim = len(zero)
    size = dim * dim
    n_tangents = dim - 1
    # _turn would be compiled again for each constant
    no = np.bool_(False)
    yes = np.bool_(True)
    for e in range(len(rows)):
        row_contact = contact_of[rows[e]]
        column_contact = contact_of[columns[e]]
        if dim == 1:  # a tenth of the time: of scalar problems all nodes may touch
            drops_normal = (row_contact >= 0 and codes[row_contact] & CLOSED) or (
                column_contact >= 0 and codes[column_contact] & CLOSED
            )
            change[e] = -blocks[e] if drops_normal else 0.0
            continue
        for a in range(dim):
            for b in range(dim):
                block[a, b] = blocks[e * size + a * dim + b]
        # into the frames of the contact nodes, with the Newton rows of slip; _turn takes whether the frame is
        # inverted, then whether rows are turned
        if row_contact >= 0:
            _turn(zero, frames, row_contact, no, yes, block, spare)
            if newton and codes[row_contact] & CLOSED:
                for a in range(n_tangents):
                    for b in range(dim):
                        block[1 + a, b] -= (
                            friction[row_contact]
                            * direction[n_tangents * row_contact + a]
                            * block[0, b]
                        )
        if column_contact >= 0:
            _turn(zero, frames, column_contact, no, no, block, spare)
        if row_contact >= 0 and row_contact == column_contact:
            if codes[row_contact] & CLOSED:
                block[0, 0] += spring[row_contact]
            for a in range(n_tangents):
                for b in range(n_tangents):
                    block[1 + a, 1 + b] += hessian[
                        n_tangents * n_tangents * row_contact + n_tangents * a + b
                    ]
        for a in range(dim):
            for b in range(dim):
                if (
                    row_contact >= 0 and _truncated(a, codes[row_contact], spring[row_contact])
                ) or (
                    column_contact >= 0
                    and _truncated(b, codes[column_contact], spring[column_contact])
                ):
                    block[a, b] = 0.0
        # and back
        if column_contact >= 0:
            _turn(zero, frames, column_contact, yes, no, block, spare)
        if row_contact >= 0:
            _turn(zero, frames, row_contact, yes, yes, block, spare)
        for a in range(dim):
            for b in range(dim):
                change[e * size + a * dim + b] = block[a, b] - blocks[e * size + a * dim + b]


@inner_kernel
def find_slot(row, column, l_indptr, l_indices, u_indptr, u_indices, rank):
    """Return the slot of block (row, column) in a split matrix with the halves l and u, whose rows are in
    the order of the sweeps: ``rank`` has the place of a node. -1 where the matrix has no such block."""
    n = len(l_indptr) - 1
    below = np.int64(l_indptr[n])
    if row == column:
        return below + row
    in_lower = rank[column] < rank[row]
    if in_lower:
        low = np.int64(l_indptr[rank[row]])
        high = np.int64(l_indptr[rank[row] + 1])
        shift = np.int64(0)
    else:
        low = np.int64(u_indptr[rank[row]])
        high = np.int64(u_indptr[rank[row] + 1])
        shift = below + n
    while low < high:  # the range halves
        middle = (low + high) // 2
        found = np.int64(l_indices[middle]) if in_lower else np.int64(u_indices[middle])
        if found == column:
            return shift + middle
        if found < column:
            low = middle + 1
        else:
            high = middle
    return np.int64(-1)


@kernel
def find_slots(rows, columns, l_indptr, l_indices, u_indptr, u_indices, rank, slots):
    """Find the slots of many blocks."""
    for k in range(len(rows)):
        slots[k] = find_slot(rows[k], columns[k], l_indptr, l_indices, u_indptr, u_indices, rank)


@kernel
def fill_contributions(
    rows,
    columns,
    indptr,
    indices,
    weights,
    l_indptr,
    l_indices,
    u_indptr,
    u_indices,
    rank,
    number,
    source,
    target,
    weight,
    slots,
    coarse_rows,
    coarse_columns,
):
    """Find where each fine block, at ``rows`` and ``columns`` (n_blocks,), goes by the prolongation
    ``indptr, indices, weights``: coarse block ``target`` gets ``weight`` times block ``source``.
    ``number`` (slots of the coarse matrix,) comes as -1 and numbers the coarse blocks met, whose
    ``slots``, rows and columns are written. Returns their number, the number of products, and how many
    of them found no place in the coarse matrix."""
    n_products = 0
    n_met = 0
    n_lost = 0
    for e in range(len(rows)):
        i = rows[e]
        j = columns[e]
        for p in range(indptr[i], indptr[i + 1]):
            for q in range(indptr[j], indptr[j + 1]):
                row = np.int64(indices[p])
                column = np.int64(indices[q])
                slot = find_slot(row, column, l_indptr, l_indices, u_indptr, u_indices, rank)
                if slot < 0:
                    n_lost += 1
                    continue
                if number[slot] < 0:
                    number[slot] = n_met
                    slots[n_met] = slot
                    coarse_rows[n_met] = row
                    coarse_columns[n_met] = column
                    n_met += 1
                source[n_products] = e
                target[n_products] = number[slot]
                weight[n_products] = weights[p] * weights[q]
                n_products += 1
    return n_met, n_products, n_lost


@kernel
def add_contributions(size, source, target, weight, fine, coarse):
    """Compute coarse = sum of weight * fine over the products."""
    coarse[:] = 0.0
    for c in range(len(source)):
        at = size * np.int64(source[c])
        to = size * np.int64(target[c])
        factor = weight[c]
        for e in range(size):
            coarse[to + e] += factor * fine[at + e]


@kernel
def store(
    zero,
    slots,
    rows,
    columns,
    base,
    change,
    free,
    below,
    lower,
    upper,
    diagonal,
    inverse,
    block,
    scale,
):
    """Write base + change to a split matrix; ``change`` is zeroed in rows and columns of fixed dofs
    first. ``free`` is the mask of the others, ``below`` the number of blocks of L, with which slots
    begin. ``diagonal`` may be empty where nobody needs it; ``block`` (dim * dim,) and ``scale`` (dim,)
    are overwritten."""
    dim = len(zero)
    size = dim * dim
    n = len(inverse) // size
    for t in range(len(slots)):
        i = rows[t]
        j = columns[t]
        slot = slots[t]
        for a in range(dim):
            for b in range(dim):
                at = t * size + a * dim + b
                if not (free[dim * i + a] and free[dim * j + b]):
                    change[at] = 0.0
                block[a * dim + b] = base[at] + change[at]
        if slot < below:
            for e in range(size):
                lower[slot * size + e] = block[e]
        elif slot < below + n:
            for e in range(size if len(diagonal) else 0):
                diagonal[i * size + e] = block[e]
            for a in range(dim):
                scale[a] = abs(base[t * size + a * dim + a])
            invert_block(np.int64(dim), block, scale, inverse, i * size)
        else:
            for e in range(size):
                upper[(slot - below - n) * size + e] = block[e]
