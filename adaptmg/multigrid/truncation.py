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
from typing import Generic, TypeVar

import numpy as np
from scipy import sparse

from adaptmg._numba import inner_kernel, kernel
from adaptmg._threads import in_parts
from adaptmg.mesh.arrays import pair_keys
from adaptmg.multigrid.split_matrix import SplitMatrix, invert_block
from adaptmg.multigrid.truncated_contact import TruncatedContact
from adaptmg.smoother.system import CLOSED, HELD, TANGENTIAL


@dataclass(eq=False)
class _Changed:
    """The blocks of one coarse level that the contact status changes."""

    level: SplitMatrix
    dim: int  # block size of the changes
    slots: np.ndarray
    rows: np.ndarray
    columns: np.ndarray

    def __post_init__(self) -> None:
        self.base = self.level.at_slots(self.slots)
        self._free = np.ones(self.level.n_dofs, dtype=bool)
        self._free[self.level.fixed] = False

    def store(self, change: np.ndarray) -> None:
        level = self.level
        store(
            self.dim,
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
    """Single entries, and the part of the prolongation that changes pass."""

    weights: sparse.csr_array
    keys: np.ndarray

    @classmethod
    def of(
        cls,
        level: SplitMatrix,
        weights: sparse.csr_array,
        dofs: np.ndarray,
        pattern: sparse.csr_array,
    ) -> _ChangedDofs:
        """Build from the weights of changed dofs, the coarse ones they reach, and the pattern of
        the change (ones)."""
        order = sparse.coo_array(pattern)
        keys = np.sort(pair_keys(order.row, order.col, len(dofs)))
        rows = dofs[keys // len(dofs)]
        columns = dofs[keys % len(dofs)]
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
        return cls(level, 1, slots, rows, columns, weights, keys)

    def update(self, change: sparse.csr_array) -> sparse.csr_array:
        """Write the matrix for a change on the finer level; returns the change on this one."""
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
    """Blocks of nodes, and the products they are made of."""

    source: np.ndarray
    target: np.ndarray
    weight: np.ndarray

    def __post_init__(self) -> None:
        super().__post_init__()
        self._change = np.zeros(len(self.base))

    def update(self, change: np.ndarray) -> np.ndarray:
        add_contributions(self.dim**2, self.source, self.target, self.weight, change, self._change)
        self.store(self._change)
        return self._change


Changed = TypeVar("Changed", bound=_Changed)


class _Update(Generic[Changed]):
    """Carries changes of the finest level down the levels ``below``, finest of them first."""

    below: list[Changed]

    def restore(self) -> None:
        """Put the base matrices back."""
        for below in self.below:
            below.store(np.zeros(len(below.base)))


class DofUpdate(_Update[_ChangedDofs]):
    """The carrier to levels of single dofs, by sparse products."""

    def __init__(
        self,
        levels: list[SplitMatrix],
        prolongations: list[sparse.csr_array],
        dim: int,
        rows: np.ndarray,
        columns: np.ndarray,
    ) -> None:
        components = np.arange(dim)
        shape = (len(rows), dim, dim)
        dof_rows = np.broadcast_to(
            (dim * rows.astype(np.int64)[:, None] + components)[:, :, None], shape
        ).reshape(-1)
        dof_columns = np.broadcast_to(
            (dim * columns.astype(np.int64)[:, None] + components)[:, None, :], shape
        )
        dofs, position = np.unique(
            np.concatenate([dof_rows, dof_columns.reshape(-1)]), return_inverse=True
        )
        self._rows, self._columns = np.split(position, 2)
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
            dofs = np.unique(weights.indices).astype(np.int64)
            weights = sparse.csr_array(weights[:, dofs])
            reach = sparse.csr_array(
                (np.ones(weights.nnz), weights.indices, weights.indptr), shape=weights.shape
            )
            pattern = sparse.csr_array(reach.T @ (pattern @ reach))
            self.below.append(_ChangedDofs.of(level, weights, dofs, pattern))

    def update(self, change: np.ndarray) -> None:
        """Write the matrices for a change (n_blocks * dim^2,) on the finest level."""
        shape = (self._size, self._size)
        matrix = sparse.csr_array(
            sparse.coo_array((change, (self._rows, self._columns)), shape=shape)
        )
        for below in self.below:
            matrix = below.update(matrix)


class NodalUpdate(_Update[_ChangedBlocks]):
    """The carrier by nodal prolongations, through lists of products made once."""

    def __init__(
        self,
        levels: list[SplitMatrix],
        prolongations: list[sparse.csr_array],
        rows: np.ndarray,
        columns: np.ndarray,
    ) -> None:
        self.below: list[_ChangedBlocks] = []
        for level, nodal in zip(reversed(levels), reversed(prolongations), strict=True):
            self.below.append(_products(level, nodal, rows, columns))
            rows = self.below[-1].rows
            columns = self.below[-1].columns

    def update(self, change: np.ndarray) -> None:
        for below in self.below:
            change = below.update(change)


def _products(
    level: SplitMatrix, nodal: sparse.csr_array, rows: np.ndarray, columns: np.ndarray
) -> _ChangedBlocks:
    """Find where the blocks of a finer level go on this one."""
    entries = np.diff(nodal.indptr).astype(np.int64)
    room = int(entries[rows] @ entries[columns])
    source = np.empty(room, dtype=np.int32)
    target = np.empty(room, dtype=np.int32)
    weight = np.empty(room)
    slots = np.empty(room, dtype=np.int64)
    coarse_rows = np.empty(room, dtype=np.int32)
    coarse_columns = np.empty(room, dtype=np.int32)
    below = int(level.lower_indptr[-1])
    above = int(level.upper_indptr[-1])
    n = level.n_nodes
    number = np.full(below + n + above, -1, dtype=np.int32)
    met, count, lost = fill_contributions(
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
    if lost:
        raise ValueError(
            f"a coarse matrix lacks {lost} entries of the Galerkin product near contact: build the coarse "
            "matrices with coarse_matrices='galerkin'"
        )
    return _ChangedBlocks(
        level,
        level.dim,
        slots[:met].copy(),
        coarse_rows[:met].copy(),
        coarse_columns[:met].copy(),
        source[:count].copy(),
        target[:count].copy(),
        weight[:count].copy(),
    )


class Truncation:
    """Keeps the matrices of the levels below one level as the contact status of that level
    demands."""

    def __init__(
        self,
        levels: list[SplitMatrix],
        prolongations: list[sparse.csr_array],
        contact: TruncatedContact,
    ) -> None:
        fine = levels[-1]
        dim = fine.dim
        at = np.concatenate(
            in_parts(
                _at_contact,
                fine.n_nodes,
                len(fine.lower),
                fine.strips.order,
                fine.lower_indptr,
                fine.lower_indices,
                contact.contact_of,
            )
        )
        i = fine.strips.order[np.searchsorted(fine.lower_indptr, at, side="right") - 1]
        j = fine.lower_indices[at]
        below = fine.lower.reshape(-1, dim, dim)[at]
        # blocks in rows and columns of contact nodes: on the diagonal, and of L for both sides
        rows, columns = (
            np.concatenate([contact.nodes, np.column_stack(pair).reshape(-1)]).astype(np.int32)
            for pair in ((i, j), (j, i))
        )
        blocks = np.concatenate(
            [
                contact.diagonal.reshape(-1, dim, dim),
                np.stack([below, below.transpose(0, 2, 1)], axis=1).reshape(-1, dim, dim),
            ]
        )
        # contact node by contact node, so that the blocks written below lie close together
        owner = np.where(
            contact.contact_of[rows] < 0, contact.contact_of[columns], contact.contact_of[rows]
        )
        order = np.argsort(owner, kind="stable")
        self.rows = rows[order]
        self.columns = columns[order]
        self.blocks = blocks[order].reshape(-1)
        self.change = np.zeros(len(self.blocks))
        if prolongations[-1].shape[0] == fine.n_nodes:
            self.products: NodalUpdate | DofUpdate = NodalUpdate(
                levels[:-1], prolongations, self.rows, self.columns
            )
        else:
            self.products = DofUpdate(levels[:-1], prolongations, dim, self.rows, self.columns)

    def apply(self, contact: TruncatedContact, newton: bool) -> None:
        """Change the matrices for a status; ``newton`` False keeps them symmetric, with g
        frozen."""
        o = contact
        changed_blocks(
            o.dim,
            self.rows,
            self.columns,
            self.blocks,
            o.contact_of,
            o.codes,
            o.frames,
            o.friction,
            o.direction,
            o.hessian,
            o.spring,
            newton,
            self.change,
            *np.empty((2, o.dim, o.dim)),
        )
        self.products.update(self.change)

    def restore(self) -> None:
        self.products.restore()


@kernel
def _at_contact(first, last, order, indptr, indices, contact_of):
    """Return the numbers of the blocks of a half in rows and columns of contact nodes."""
    found = np.empty(indptr[last] - indptr[first], dtype=np.int32)
    count = 0
    for place in range(first, last):
        in_row = contact_of[order[place]] >= 0
        for k in range(indptr[place], indptr[place + 1]):
            # written without a branch, kept if it counts
            found[count] = k
            count += in_row or contact_of[indices[k]] >= 0
    return found[:count].copy()


@inner_kernel
def _turn(dim, frames, k, inverse, rows, block, other):
    """Change a block to F block (``rows``) or block F', F the frame of contact node k, or F its
    inverse F'."""
    for a in range(dim):
        for b in range(dim):
            other[a, b] = 0.0
            i = a if rows else b
            for c in range(dim):
                at = c * dim + i if inverse else i * dim + c
                other[a, b] += frames[k * dim * dim + at] * (block[c, b] if rows else block[a, c])
    for a in range(dim):
        for b in range(dim):
            block[a, b] = other[a, b]


@inner_kernel
def _truncated(a, code, spring):
    """Return whether component a of a contact node is out of the coarse problem."""
    return code & CLOSED != 0 and not spring if a == 0 else code & TANGENTIAL == HELD


@kernel
def changed_blocks(
    dim,
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
    other,
):
    """Compute delta of every collected block, Cartesian; ``newton`` False leaves the slip rows
    symmetric (g frozen). ``block`` and ``other`` (dim, dim) are overwritten."""
    size = dim * dim
    m = dim - 1
    # _turn would be compiled again for each constant
    no = np.bool_(False)
    yes = np.bool_(True)
    for e in range(len(rows)):
        k = contact_of[rows[e]]
        l = contact_of[columns[e]]
        if dim == 1:  # a tenth of the time: of scalar problems all nodes may touch
            out = (k >= 0 and codes[k] & CLOSED) or (l >= 0 and codes[l] & CLOSED)
            change[e] = -blocks[e] if out else 0.0
            continue
        for a in range(dim):
            for b in range(dim):
                block[a, b] = blocks[e * size + a * dim + b]
        if k >= 0:
            _turn(dim, frames, k, no, yes, block, other)
            if newton and codes[k] & CLOSED:
                for a in range(m):
                    for b in range(dim):
                        block[1 + a, b] -= friction[k] * direction[m * k + a] * block[0, b]
        if l >= 0:
            _turn(dim, frames, l, no, no, block, other)
        if k >= 0 and k == l:
            if codes[k] & CLOSED:
                block[0, 0] += spring[k]
            for a in range(m):
                for b in range(m):
                    block[1 + a, 1 + b] += hessian[m * m * k + m * a + b]
        for a in range(dim):
            for b in range(dim):
                if (k >= 0 and _truncated(a, codes[k], spring[k])) or (
                    l >= 0 and _truncated(b, codes[l], spring[l])
                ):
                    block[a, b] = 0.0
        if l >= 0:
            _turn(dim, frames, l, yes, no, block, other)
        if k >= 0:
            _turn(dim, frames, k, yes, yes, block, other)
        for a in range(dim):
            for b in range(dim):
                change[e * size + a * dim + b] = block[a, b] - blocks[e * size + a * dim + b]


@inner_kernel
def find_slot(row, column, l_indptr, l_indices, u_indptr, u_indices, rank):
    """Return the slot of block (row, column), -1 where the matrix has none."""
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
    """Find where each fine block goes: coarse block ``target`` gets ``weight`` times block
    ``source``. ``number`` (slots of the coarse matrix,) comes as -1 and numbers the coarse blocks
    met. Returns their number, the number of products, and how many of them found no place in the
    coarse matrix."""
    count = 0
    met = 0
    lost = 0
    for e in range(len(rows)):
        i = rows[e]
        j = columns[e]
        for p in range(indptr[i], indptr[i + 1]):
            for q in range(indptr[j], indptr[j + 1]):
                row = np.int64(indices[p])
                column = np.int64(indices[q])
                slot = find_slot(row, column, l_indptr, l_indices, u_indptr, u_indices, rank)
                if slot < 0:
                    lost += 1
                    continue
                if number[slot] < 0:
                    number[slot] = met
                    slots[met] = slot
                    coarse_rows[met] = row
                    coarse_columns[met] = column
                    met += 1
                source[count], target[count], weight[count] = (
                    e,
                    number[slot],
                    weights[p] * weights[q],
                )
                count += 1
    return met, count, lost


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
    dim,
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
    first. ``diagonal`` may be empty where nobody needs it; ``block`` (dim * dim,) and ``scale``
    (dim,) are overwritten."""
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
            invert_block(dim, block, scale, inverse, i * size)
        else:
            for e in range(size):
                upper[(slot - below - n) * size + e] = block[e]
