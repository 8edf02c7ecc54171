r"""Numba kernels: what the truncation of contact nodes changes in the matrices of all coarser levels.

With T dropping closed normals and held tangents, S adding the Newton rows of slip
(:math:`row_t \leftarrow row_t - \mu\,(\tau/|\tau|)\,row_n`) and H the Hessian of the friction, a coarse matrix is

.. math:: P^T T (S A + H) T P = P^T A P + P^T \Delta P,\qquad \Delta = T (S A + H) T - A,

and :math:`\Delta` lives in the block rows and columns of contact nodes only. A block is addressed in a split
matrix by one slot number: L first, then the diagonal, then U.
"""

from __future__ import annotations

import numpy as np

from adaptmg.multigrid.linear.split_kernels import invert_block
from adaptmg.runtime.compiled import inner_kernel, kernel
from adaptmg.smoother.state import CLOSED, HELD, TANGENTIAL

__all__ = ["add_contributions", "changed_blocks", "collect", "count_blocks", "count_contributions",
           "fetch", "fill_contributions", "find_slot", "find_slots", "store"]


@kernel
def count_blocks(nodes, contact_of, indptr, indices):
    """The number of blocks in rows and columns of contact nodes, from the lower half of a symmetric matrix."""
    total = 0
    for i in range(len(indptr) - 1):
        for k in range(indptr[i], indptr[i + 1]):
            if contact_of[i] >= 0 or contact_of[indices[k]] >= 0:
                total += 2
    return total + len(nodes)


@kernel
def collect(nodes, contact_of, indptr, indices, rows, columns, entries):
    """Where those blocks are: on the diagonal the contact node, elsewhere the entry of L, for both sides."""
    count = 0
    for k in range(len(nodes)):
        rows[count], columns[count], entries[count] = nodes[k], nodes[k], k
        count += 1
    for i in range(len(indptr) - 1):
        for k in range(indptr[i], indptr[i + 1]):
            j = indices[k]
            if contact_of[i] >= 0 or contact_of[j] >= 0:
                rows[count], columns[count], entries[count] = i, j, k
                rows[count + 1], columns[count + 1], entries[count + 1] = j, i, k
                count += 2


@kernel
def fetch(dim, rows, columns, entries, lower, diagonal, blocks):
    """Copy the collected blocks; above the diagonal they are transposed ones of L."""
    size = dim * dim
    for e in range(len(rows)):
        at = size * np.int64(entries[e])
        for a in range(dim):
            for b in range(dim):
                if rows[e] == columns[e]:
                    blocks[e * size + a * dim + b] = diagonal[at + a * dim + b]
                else:
                    blocks[e * size + a * dim + b] = lower[at + (a * dim + b if rows[e] > columns[e] else b * dim + a)]


@inner_kernel
def _turn_rows(dim, frames, k, inverse, block, other):
    """other = F block, F the frame of contact node k, or F' block."""
    for a in range(dim):
        for b in range(dim):
            other[a, b] = 0.0
            for c in range(dim):
                at = c * dim + a if inverse else a * dim + c
                other[a, b] += frames[k * dim * dim + at] * block[c, b]


@inner_kernel
def _turn_columns(dim, frames, k, inverse, block, other):
    """other = block F', F the frame of contact node k, or block F."""
    for a in range(dim):
        for b in range(dim):
            other[a, b] = 0.0
            for c in range(dim):
                at = c * dim + b if inverse else b * dim + c
                other[a, b] += block[a, c] * frames[k * dim * dim + at]


@inner_kernel
def _truncated(a, code):
    """Whether component a of a contact node is out of the coarse problem."""
    return code & CLOSED != 0 if a == 0 else code & TANGENTIAL == HELD


@kernel
def changed_blocks(dim, rows, columns, blocks, contact_of, codes, frames, friction, direction, hessian, newton, change):
    """Delta of every collected block, Cartesian; ``newton`` False leaves the slip rows symmetric (g frozen)."""
    size = dim * dim
    m = dim - 1
    block, other = np.empty((dim, dim)), np.empty((dim, dim))
    for e in range(len(rows)):
        k, l = contact_of[rows[e]], contact_of[columns[e]]
        for a in range(dim):
            for b in range(dim):
                block[a, b] = blocks[e * size + a * dim + b]
        if k >= 0:
            _turn_rows(dim, frames, k, False, block, other)
            if newton and codes[k] & CLOSED:
                for a in range(m):
                    for b in range(dim):
                        other[1 + a, b] -= friction[k] * direction[m * k + a] * other[0, b]
            block, other = other, block
        if l >= 0:
            _turn_columns(dim, frames, l, False, block, other)
            block, other = other, block
        if k >= 0 and k == l:
            for a in range(m):
                for b in range(m):
                    block[1 + a, 1 + b] += hessian[m * m * k + m * a + b]
        for a in range(dim):
            for b in range(dim):
                if (k >= 0 and _truncated(a, codes[k])) or (l >= 0 and _truncated(b, codes[l])):
                    block[a, b] = 0.0
        if l >= 0:
            _turn_columns(dim, frames, l, True, block, other)
            block, other = other, block
        if k >= 0:
            _turn_rows(dim, frames, k, True, block, other)
            block, other = other, block
        for a in range(dim):
            for b in range(dim):
                change[e * size + a * dim + b] = block[a, b] - blocks[e * size + a * dim + b]


@kernel
def count_contributions(rows, columns, indptr):
    """Number of products P_iI P_jJ over all blocks (i, j)."""
    total = 0
    for e in range(len(rows)):
        i, j = rows[e], columns[e]
        total += (indptr[i + 1] - indptr[i]) * (indptr[j + 1] - indptr[j])
    return total


@inner_kernel
def find_slot(row, column, l_indptr, l_indices, u_indptr, u_indices):
    """Slot of block (row, column), -1 where the matrix has none."""
    n = len(l_indptr) - 1
    below = np.int64(l_indptr[n])
    if row == column:
        return below + row
    if column < row:
        low, high = np.int64(l_indptr[row]), np.int64(l_indptr[row + 1])
        shift = np.int64(0)
    else:
        low, high = np.int64(u_indptr[row]), np.int64(u_indptr[row + 1])
        shift = below + n
    while low < high:
        middle = (low + high) // 2
        found = np.int64(l_indices[middle]) if column < row else np.int64(u_indices[middle])
        if found == column:
            return shift + middle
        if found < column:
            low = middle + 1
        else:
            high = middle
    return np.int64(-1)


@kernel
def find_slots(rows, columns, l_indptr, l_indices, u_indptr, u_indices, slots):
    """Slots of many blocks."""
    for k in range(len(rows)):
        slots[k] = find_slot(rows[k], columns[k], l_indptr, l_indices, u_indptr, u_indices)


@kernel
def fill_contributions(rows, columns, indptr, indices, weights, l_indptr, l_indices, u_indptr, u_indices, number,
                       source, target, weight, slots, coarse_rows, coarse_columns):
    """Where each fine block goes: coarse block ``target`` gets ``weight`` times block ``source``.

    ``number`` (slots of the coarse matrix,) comes as -1 and numbers the coarse blocks met. Returns their number and
    how many products found no place in the coarse matrix.
    """
    count = 0
    met = 0
    lost = 0
    for e in range(len(rows)):
        i, j = rows[e], columns[e]
        for p in range(indptr[i], indptr[i + 1]):
            for q in range(indptr[j], indptr[j + 1]):
                row, column = np.int64(indices[p]), np.int64(indices[q])
                slot = find_slot(row, column, l_indptr, l_indices, u_indptr, u_indices)
                if slot < 0:
                    lost += 1
                    continue
                if number[slot] < 0:
                    number[slot] = met
                    slots[met], coarse_rows[met], coarse_columns[met] = slot, row, column
                    met += 1
                source[count], target[count], weight[count] = e, number[slot], weights[p] * weights[q]
                count += 1
    return met, count, lost


@kernel
def add_contributions(size, source, target, weight, fine, coarse):
    """coarse = sum of weight * fine over the products."""
    coarse[:] = 0.0
    for c in range(len(source)):
        at, to, factor = size * np.int64(source[c]), size * np.int64(target[c]), weight[c]
        for e in range(size):
            coarse[to + e] += factor * fine[at + e]


@kernel
def store(dim, slots, rows, columns, base, change, free, below, lower, upper, diagonal, inverse):
    """Write base + change to a split matrix; ``change`` is zeroed in rows and columns of fixed dofs first.

    ``diagonal`` may be empty where nobody needs it.
    """
    size = dim * dim
    n = len(inverse) // size
    block, scale = np.empty(size), np.empty(dim)
    for t in range(len(slots)):
        i, j, slot = rows[t], columns[t], slots[t]
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
