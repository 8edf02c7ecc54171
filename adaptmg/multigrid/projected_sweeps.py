r"""The nonlinear smoothing: projected Gauss-Seidel in half passes on a symmetric matrix, and on an
interface.

Unknowns are Cartesian; the exact node solve of :mod:`adaptmg.smoother.node_solve` works in the
frame of the contact node. Both sweeps read L only, each row for two purposes, as :math:`U = L^T`.
The backward sweep scatters
:math:`-L_i^T u_i` to the nodes before, so that :math:`t = f - U u` is complete when its node is reached, and keeps t.
The forward sweep scatters :math:`-L_i^T \delta_i`, :math:`\delta_i` the change of node i: at the
end t is f - A u.

Where two bodies touch, most of the error that is left lies within a few elements of the interface.
Local sweeps there cost the rows of their nodes: a change :math:`\delta_i` alters the residual by
:math:`-A_{ij}^T\delta_i` at the neighbours j. In relative coordinates a master node carries its
followers along; where the contact is open and the slave body much stiffer (a soft tip before a
solid wall) such sweeps hardly move the master. Masters whose followers are all open are therefore
moved alone, :math:`w_j \leftarrow w_j - W_{ji}\delta_i`, unless that would close one of them.

Arguments: ``zero``, dim zeros (see :mod:`adaptmg.smoother.blocks`); the arrays of a SplitMatrix, of
a TruncatedContact and of an :class:`Interface`; ``values`` hold gap and reference exactly where a
node touches a rigid surface and sticks."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg._numba import inner_kernel, kernel
from adaptmg.discrete.coordinates import Coupling
from adaptmg.multigrid.split_matrix import SplitMatrix
from adaptmg.smoother.blocks import (
    add,
    inner,
    inverse_square,
    minus_row,
    minus_times,
    minus_transposed_row,
    multiply,
    negative,
    read,
    read_upper,
    subtract,
    times,
    transposed_times,
    write,
)
from adaptmg.smoother.node_solve import read_reference, solve

ONE = np.uint64(1)


# explicit fastmath: it would else be that of the sweep that is compiled first
@inner_kernel(fastmath=False)
def solve_at(k, frames, blocks, gap, reference, limit, friction, compliance, values, c):
    """Solve contact node k; ``c`` is the Cartesian force without the diagonal block."""
    dim = np.uint64(len(c))
    frame = dim * dim * k
    w = solve(
        read_upper(blocks, k, c),
        times(frames, frame, c),
        gap[k],
        read_reference(reference, k, c),
        limit[k],
        friction[k],
        compliance[k],
    )
    write(values, dim * k, w)
    return transposed_times(frames, frame, w)


@kernel
def backward(
    first,
    last,
    order,
    zero,
    l_indptr,
    l_indices,
    lower,
    inverse,
    contact_of,
    frames,
    blocks,
    gap,
    reference,
    limit,
    friction,
    compliance,
    values,
    u,
    kept,
):
    """Sweep backward with projections; ``kept`` comes as f and becomes f - U u."""
    dim = np.uint64(len(zero))
    for place in range(last - 1, first - 1, -1):
        row = np.uint64(place)
        i = np.uint64(order[place])
        at = dim * i
        # kept comes last: it is the one to wait for, as the node before has just written to it
        r = minus_row(row, -1, l_indptr, l_indices, lower, u, zero)
        r = add(read(kept, at, zero), r)
        if contact_of[i] < 0:
            new = times(inverse, dim * at, r)
        else:
            new = solve_at(
                np.uint64(contact_of[i]),
                frames,
                blocks,
                gap,
                reference,
                limit,
                friction,
                compliance,
                values,
                r,
            )
        write(u, at, new)
        minus_transposed_row(row, -1, l_indptr, l_indices, lower, new, kept)


@kernel(fastmath={"contract"})
def forward(
    first,
    last,
    order,
    zero,
    l_indptr,
    l_indices,
    lower,
    inverse,
    diagonal,
    contact_of,
    frames,
    blocks,
    gap,
    reference,
    limit,
    friction,
    compliance,
    values,
    u,
    kept,
):
    """Sweep forward with projections after :func:`backward`; ``kept`` becomes f - A u. ``diagonal``
    (n_contact * dim^2,) are the Cartesian diagonal blocks of the contact nodes."""
    dim = np.uint64(len(zero))
    for place in range(first, last):
        row = np.uint64(place)
        i = np.uint64(order[place])
        at = dim * i
        r = minus_row(row, 1, l_indptr, l_indices, lower, u, read(kept, at, zero))
        if contact_of[i] < 0:
            new = times(inverse, dim * at, r)
            write(kept, at, zero)
        else:
            k = np.uint64(contact_of[i])
            new = solve_at(
                k, frames, blocks, gap, reference, limit, friction, compliance, values, r
            )
            write(kept, at, minus_times(r, diagonal, dim * dim * k, new))
        change = subtract(new, read(u, at, zero))
        write(u, at, new)
        minus_transposed_row(row, 1, l_indptr, l_indices, lower, change, kept)


@kernel
def energy_product(first, last, order, zero, l_indptr, l_indices, lower, inverse, new, old):
    """Return (new - old)' A (new - old) from L and the inverse diagonal blocks: half a pass."""
    dim = np.uint64(len(zero))
    total = 0.0
    for place in range(first, last):
        row = np.uint64(place)
        i = np.uint64(order[place])
        at = dim * i
        change = subtract(read(new, at, zero), read(old, at, zero))
        total += inverse_square(inverse, dim * at, change)
        for entry in range(np.uint64(l_indptr[row]), np.uint64(l_indptr[row + ONE])):
            j = dim * np.uint64(l_indices[entry])
            other = subtract(read(new, j, zero), read(old, j, zero))
            total += 2.0 * inner(change, times(lower, dim * dim * entry, other))
    return total


@kernel
def diagonal_square(first, last, zero, inverse, u):
    """Return the squared norm of D u, D the reciprocals of the diagonals of the inverse blocks: .7 ms
    for 263k nodes, by numpy 1.7."""
    dim = np.uint64(len(zero))
    total = 0.0
    for node in range(first, last):
        at = dim * np.uint64(node)
        for k in range(dim):
            pivot = inverse[dim * (at + k) + k]
            if pivot > 0.0:
                total += (u[at + k] / pivot) ** 2
    return total


@inner_kernel
def _changed(p, i, d, indptr, indices, blocks, diagonal, residual):
    """Take a change d of node i, at position p, out of the residual: its own and that of its
    neighbours."""
    dim = np.uint64(len(d))
    size = dim * dim
    at = dim * i
    write(residual, at, subtract(read(residual, at, d), times(diagonal, size * p, d)))
    for entry in range(np.uint64(indptr[p]), np.uint64(indptr[p + ONE])):
        j = dim * np.uint64(indices[entry])
        write(
            residual, j, subtract(read(residual, j, d), transposed_times(blocks, size * entry, d))
        )


@inner_kernel
def _alone(
    zero,
    p,
    i,
    nodes,
    indptr,
    indices,
    blocks,
    diagonal,
    follow_indptr,
    followers,
    weights,
    alone,
    contact_of,
    frames,
    gap,
    limit,
    values,
    u,
    residual,
):
    """Move a master i by d and its followers j back by -w_j d, so that these stay where they are, if
    all are open and stay so; return whether it was done."""
    dim = np.uint64(len(zero))
    size = dim * dim
    begin = np.uint64(follow_indptr[p])
    end = np.uint64(follow_indptr[p + ONE])
    r = read(residual, dim * i, zero)
    for s in range(begin, end):
        j = np.uint64(nodes[followers[s]])
        if contact_of[j] < 0:
            return False
        k = np.uint64(contact_of[j])
        if values[dim * k] >= gap[k] or limit[k] > 0.0:
            return False
        r = subtract(r, multiply(read(weights, dim * s, zero), read(residual, dim * j, zero)))
    d = times(alone, size * p, r)
    for s in range(begin, end):
        k = np.uint64(contact_of[nodes[followers[s]]])
        behind = negative(multiply(read(weights, dim * s, zero), d))
        if values[dim * k] + times(frames, size * k, behind)[0] >= gap[k]:
            return False
    write(u, dim * i, add(read(u, dim * i, zero), d))
    _changed(p, i, d, indptr, indices, blocks, diagonal, residual)
    for s in range(begin, end):
        q = np.uint64(followers[s])
        j = np.uint64(nodes[q])
        k = np.uint64(contact_of[j])
        behind = negative(multiply(read(weights, dim * s, zero), d))
        write(u, dim * j, add(read(u, dim * j, zero), behind))
        write(values, dim * k, add(read(values, dim * k, zero), times(frames, size * k, behind)))
        _changed(q, j, behind, indptr, indices, blocks, diagonal, residual)
    return True


@kernel
def local(
    zero,
    order,
    nodes,
    indptr,
    indices,
    blocks,
    diagonal,
    follow_indptr,
    followers,
    weights,
    alone,
    inverse,
    contact_of,
    frames,
    own_blocks,
    gap,
    reference,
    limit,
    friction,
    compliance,
    values,
    u,
    residual,
):
    """Sweep with projections over positions ``order`` of an
    :class:`~adaptmg.multigrid.projected_sweeps.Interface`. ``residual`` is f - A u before and
    after."""
    dim = np.uint64(len(zero))
    for entry in range(len(order)):
        p = np.uint64(order[entry])
        i = np.uint64(nodes[p])
        at = dim * i
        now = read(u, at, zero)
        if contact_of[i] >= 0:
            force = minus_times(read(residual, at, zero), diagonal, dim * dim * p, negative(now))
            new = solve_at(
                np.uint64(contact_of[i]),
                frames,
                own_blocks,
                gap,
                reference,
                limit,
                friction,
                compliance,
                values,
                force,
            )
            change = subtract(new, now)
        elif follow_indptr[p + ONE] > follow_indptr[p] and _alone(
            zero,
            p,
            i,
            nodes,
            indptr,
            indices,
            blocks,
            diagonal,
            follow_indptr,
            followers,
            weights,
            alone,
            contact_of,
            frames,
            gap,
            limit,
            values,
            u,
            residual,
        ):
            continue
        else:
            change = times(inverse, dim * at, read(residual, at, zero))
            new = add(now, change)
        write(u, at, new)
        _changed(p, i, change, indptr, indices, blocks, diagonal, residual)


class Interface:
    """Nodes near contact between bodies and their rows: within ``LAYERS`` edges of the matrix from
    the slave nodes."""

    #: one layer does nearly as well, more than two gain nothing
    LAYERS = 2

    def __init__(self, level: SplitMatrix, coupling: Coupling, fixed: np.ndarray) -> None:
        n = level.n_nodes
        dim = level.dim
        self.dim = dim
        ones = np.ones(len(level.lower_indices))
        # row by row of the nodes
        half = sparse.csr_array(
            (np.arange(1, len(ones) + 1), level.lower_indices.astype(np.int32), level.lower_indptr),
            shape=(n, n),
        )[level.strips.rank]
        entries = half
        half = sparse.csr_array((ones, half.indices, half.indptr), shape=(n, n))
        reached = (np.diff(coupling.weights.indptr) > 0).astype(float)
        for _ in range(self.LAYERS):
            reached = ((reached + half @ reached + half.T @ reached) > 0).astype(float)
        self.nodes = np.flatnonzero(reached).astype(np.int32)
        place = np.full(n, -1, dtype=np.int32)
        place[self.nodes] = np.arange(len(self.nodes), dtype=np.int32)
        # the rows without diagonal: entries of L, and of L' (negative), whose blocks are transposed
        rows = sparse.csr_array(entries[self.nodes] - sparse.csr_array(entries[:, self.nodes].T))
        rows.sort_indices()
        self.indptr = rows.indptr.astype(np.int64)
        self.indices = rows.indices.astype(np.uint32)
        blocks = level.lower.reshape(-1, dim, dim)[np.abs(rows.data) - 1]
        self.blocks = np.where(
            (rows.data < 0)[:, None, None], blocks.transpose(0, 2, 1), blocks
        ).reshape(-1)
        self.diagonal = level.diagonal.reshape(-1, dim * dim)[self.nodes].reshape(-1)
        self._follow(coupling, place, fixed)
        # fixed components stay where they are, though followers pull at them
        free = ~fixed.reshape(-1, dim)[self.nodes]
        blocks = self._alone_blocks(place) * (free[:, :, None] & free[:, None, :])
        self.alone = np.linalg.pinv(blocks, hermitian=True).reshape(-1)
        self.forward = np.arange(len(self.nodes), dtype=np.int32)
        self.backward = self.forward[::-1].copy()
        self.nonzeros = len(self.blocks) + len(self.diagonal)

    def _follow(self, coupling: Coupling, place: np.ndarray, fixed: np.ndarray) -> None:
        """Set the followers of each node that can stay where they are, with their weights; nodes that
        follow others have none."""
        by_master = sparse.csr_array(coupling.weights.T)[self.nodes]
        itself = np.diff(coupling.weights.indptr)[self.nodes] > 0
        following = ~np.repeat(itself, np.diff(by_master.indptr))
        self.follow_indptr = np.concatenate([[0], np.cumsum(following)])[by_master.indptr].astype(
            np.int32
        )
        slaves = by_master.indices[following]
        self.followers = place[slaves]
        free = ~fixed.reshape(-1, coupling.dim)[slaves]
        self.follow_weights = (by_master.data[following, None] * free).reshape(-1)

    def _alone_blocks(self, place: np.ndarray) -> np.ndarray:
        """Return the blocks D'AD (n, dim, dim), D the motion of a node that leaves its followers where
        they are: 1 at the node, minus the weight at each follower."""
        n = len(self.nodes)
        dim = self.dim
        columns = place[self.indices]
        inside = columns >= 0
        indptr = np.append(0, np.cumsum(inside))[self.indptr]
        rows = sparse.bsr_array(
            (self.blocks.reshape(-1, dim, dim)[inside], columns[inside], indptr),
            shape=(dim * n, dim * n),
        )
        rows = sparse.csr_array(
            rows
            + sparse.bsr_array(
                (self.diagonal.reshape(-1, dim, dim), np.arange(n), np.arange(n + 1)),
                shape=rows.shape,
            )
        )
        masters = np.repeat(np.arange(n), np.diff(self.follow_indptr))
        ends = (
            (dim * nodes[:, None] + np.arange(dim)).reshape(-1)
            for nodes in (self.followers, masters)
        )
        motion = sparse.eye_array(dim * n) - sparse.csr_array(
            (self.follow_weights, tuple(ends)), shape=rows.shape
        )
        motion, forces = sparse.csc_array(motion), sparse.csc_array(rows @ motion)
        result = np.empty((n, dim, dim))
        for a, b in np.ndindex(dim, dim):
            result[:, a, b] = motion[:, a::dim].multiply(forces[:, b::dim]).sum(axis=0)
        return result

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """The arrays that the local sweeps read."""
        return (
            self.nodes,
            self.indptr,
            self.indices,
            self.blocks,
            self.diagonal,
            self.follow_indptr,
            self.followers,
            self.follow_weights,
            self.alone,
        )
