r"""The nonlinear smoothing: projected Gauss-Seidel in half passes on a symmetric matrix, and on an
interface.

Unknowns are Cartesian; the exact node solve of :mod:`adaptmg.smoother.node_solve` works in the
frame of the contact node. Both sweeps read L only, each row for two purposes, as :math:`U = L^T`.
The backward sweep scatters
:math:`-L_i^T u_i` to the nodes before, so that :math:`t = f - U u` is complete when its node is reached, and stays.
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
from adaptmg.discrete.block_rows import table_column, table_row
from adaptmg.discrete.coordinates import Coupling, block_diagonal
from adaptmg.discrete.elasticity import dofs_of
from adaptmg.mesh.arrays import places_of
from adaptmg.multigrid.split_matrix import SplitMatrix, shared_row
from adaptmg.smoother.blocks import (
    BACKWARD,
    FORWARD,
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


@inner_kernel
def solve_at(k, frames, blocks, gap, reference, limit, friction, compliance, values, c):
    """Return the displacement of contact node k, a tuple of Cartesian components, from the Cartesian force
    ``c`` = f - sum A_kj u_j over the other nodes; its local components go to ``values``. ``blocks`` are
    the upper triangles of the local diagonal blocks."""
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
    kinds,
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
    remainder,
):
    """Sweep backward with projections; ``remainder`` comes as f and becomes f - U u."""
    dim = np.uint64(len(zero))
    for place in range(last - 1, first - 1, -1):
        i = np.uint64(order[place])
        row, block, origin = shared_row(kinds, np.uint64(place), i)
        dof = dim * i
        # remainder comes last: it is the one to wait for, as the node before has just written to it
        force = minus_row(row, origin, BACKWARD, l_indptr, l_indices, lower, u, zero)
        force = add(read(remainder, dof, zero), force)
        if contact_of[i] < 0:
            new = times(inverse, dim * dim * block, force)
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
                force,
            )
        write(u, dof, new)
        minus_transposed_row(row, origin, BACKWARD, l_indptr, l_indices, lower, new, remainder)


@kernel
def forward(
    first,
    last,
    order,
    zero,
    kinds,
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
    remainder,
):
    """Sweep forward with projections after :func:`backward`; ``remainder`` becomes f - A u. ``diagonal``
    (n_contact * dim^2,) are the Cartesian diagonal blocks of the contact nodes."""
    dim = np.uint64(len(zero))
    for place in range(first, last):
        i = np.uint64(order[place])
        row, block, origin = shared_row(kinds, np.uint64(place), i)
        dof = dim * i
        force = read(remainder, dof, zero)
        force = minus_row(row, origin, FORWARD, l_indptr, l_indices, lower, u, force)
        if contact_of[i] < 0:
            new = times(inverse, dim * dim * block, force)
            write(remainder, dof, zero)  # its equation holds
        else:
            k = np.uint64(contact_of[i])
            new = solve_at(
                k, frames, blocks, gap, reference, limit, friction, compliance, values, force
            )
            write(remainder, dof, minus_times(force, diagonal, dim * dim * k, new))
        change = subtract(new, read(u, dof, zero))
        write(u, dof, new)
        minus_transposed_row(row, origin, FORWARD, l_indptr, l_indices, lower, change, remainder)


@kernel
def energy_product(first, last, order, zero, kinds, l_indptr, l_indices, lower, inverse, new, old):
    """Return (new - old)' A (new - old) = d'D d + 2 d'L d, d = new - old, from L and the inverse diagonal
    blocks: half a pass."""
    dim = np.uint64(len(zero))
    total = 0.0
    for place in range(first, last):
        i = np.uint64(order[place])
        row, block, origin = shared_row(kinds, np.uint64(place), i)
        at = dim * i
        change = subtract(read(new, at, zero), read(old, at, zero))
        total += inverse_square(inverse, dim * dim * block, change)
        for entry in range(np.uint64(l_indptr[row]), np.uint64(l_indptr[row + ONE])):
            j = dim * table_column(origin, l_indices, entry)
            other = subtract(read(new, j, zero), read(old, j, zero))
            total += 2.0 * inner(change, times(lower, dim * dim * entry, other))
    return total


@kernel
def diagonal_square(first, last, zero, kinds, inverse, u):
    """Return the squared norm of D u, N^2, for a displacement u (n_dofs,), m, at the nodes ``first``, ...,
    ``last`` - 1: the size of the terms that a residual sums, whose rounding it cannot fall below. D has
    the size of the diagonal of A, of which only the inverse blocks are stored: the reciprocals of their
    diagonals. .7 ms for 263k nodes, by numpy 1.7."""
    dim = np.uint64(len(zero))
    total = 0.0
    for node in range(first, last):
        i = np.uint64(node)
        block, _ = table_row(kinds, i)
        for k in range(dim):
            flexibility = inverse[dim * (dim * block + k) + k]
            if flexibility > 0.0:  # 0: the dof has no stiffness
                total += (u[dim * i + k] / flexibility) ** 2
    return total


@inner_kernel
def _subtract_change(p, i, d, indptr, indices, blocks, diagonal, residual):
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
def _move_master(
    zero,
    position,
    master,
    nodes,
    indptr,
    indices,
    blocks,
    diagonal,
    follow_indptr,
    followers,
    weights,
    master_inverse,
    contact_of,
    frames,
    gap,
    limit,
    values,
    u,
    residual,
):
    """Move a master by d, and the relative displacements of its followers j by -w_j d, so that these
    stay where they are. A weight w_j has a number for each component, 0 along those that a support
    fixes at the follower. With D, 1 at the master and -w_j at each follower, the energy is least for
    d = (D'AD)^-1 D'r, of which the inverse is ``master_inverse``. ``position`` is the place of
    ``master`` in ``nodes``.

    It is done only if all followers are open before and after it, and have no Tresca limit, which
    would resist the change of their slip without contact; return whether it was done."""
    dim = np.uint64(len(zero))
    size = dim * dim
    begin = np.uint64(follow_indptr[position])
    end = np.uint64(follow_indptr[position + ONE])
    # D'r, while all followers are open
    force = read(residual, dim * master, zero)
    for entry in range(begin, end):
        follower = np.uint64(nodes[followers[entry]])
        if contact_of[follower] < 0:  # without a contact condition, as tied nodes: it never opens
            return False
        contact = np.uint64(contact_of[follower])
        if values[dim * contact] >= gap[contact] or limit[contact] > 0.0:
            return False
        force = subtract(
            force, multiply(read(weights, dim * entry, zero), read(residual, dim * follower, zero))
        )
    change = times(master_inverse, size * position, force)
    # they stay open
    for entry in range(begin, end):
        contact = np.uint64(contact_of[nodes[followers[entry]]])
        follower_change = negative(multiply(read(weights, dim * entry, zero), change))
        if (
            values[dim * contact] + times(frames, size * contact, follower_change)[0]
            >= gap[contact]
        ):
            return False
    write(u, dim * master, add(read(u, dim * master, zero), change))
    _subtract_change(position, master, change, indptr, indices, blocks, diagonal, residual)
    for entry in range(begin, end):
        follower_position = np.uint64(followers[entry])
        follower = np.uint64(nodes[follower_position])
        contact = np.uint64(contact_of[follower])
        follower_change = negative(multiply(read(weights, dim * entry, zero), change))
        write(u, dim * follower, add(read(u, dim * follower, zero), follower_change))
        write(
            values,
            dim * contact,
            add(read(values, dim * contact, zero), times(frames, size * contact, follower_change)),
        )
        _subtract_change(
            follower_position,
            follower,
            follower_change,
            indptr,
            indices,
            blocks,
            diagonal,
            residual,
        )
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
    master_inverse,
    inverse,
    contact_of,
    frames,
    contact_blocks,
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
        position = np.uint64(order[entry])
        i = np.uint64(nodes[position])
        dof = dim * i
        before = read(u, dof, zero)
        if contact_of[i] >= 0:
            # the force without the diagonal block: r + D u
            force = minus_times(
                read(residual, dof, zero), diagonal, dim * dim * position, negative(before)
            )
            new = solve_at(
                np.uint64(contact_of[i]),
                frames,
                contact_blocks,
                gap,
                reference,
                limit,
                friction,
                compliance,
                values,
                force,
            )
            change = subtract(new, before)
        # a master takes its followers along, unless it can be moved alone
        elif follow_indptr[position + ONE] > follow_indptr[position] and _move_master(
            zero,
            position,
            i,
            nodes,
            indptr,
            indices,
            blocks,
            diagonal,
            follow_indptr,
            followers,
            weights,
            master_inverse,
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
            change = times(inverse, dim * dof, read(residual, dof, zero))
            new = add(before, change)
        write(u, dof, new)
        _subtract_change(position, i, change, indptr, indices, blocks, diagonal, residual)


class Interface:
    """Nodes near contact between bodies and their rows: within ``LAYERS`` edges of the matrix from
    the slave nodes.

    ``nodes`` (n,) are the numbers of these nodes; row i of all other arrays belongs to ``nodes[i]``.
    ``indices`` are node numbers, ``followers`` places in ``nodes``."""

    #: one layer does nearly as well, more than two gain nothing
    LAYERS = 2

    def __init__(self, level: SplitMatrix, coupling: Coupling, fixed: np.ndarray) -> None:
        """Take the rows of the nodes near contact, and the blocks by which masters move; ``fixed`` (n_dofs,)
        is the mask of fixed dofs."""
        n = level.n_nodes
        dim = level.dim
        self.dim = dim
        # L by nodes, whose entries are the numbers of its blocks for ``_set_rows``, from 1: zeros are not
        # entries. Coupled matrices have a row of L for each node (lattices may share rows)
        numbers = np.arange(1, len(level.lower_indices) + 1)
        lower = sparse.csr_array((numbers, level.lower_indices, level.lower_indptr), shape=(n, n))[
            level.strips.rank
        ]
        is_near = np.diff(coupling.weights.indptr) > 0
        for _ in range(self.LAYERS):
            is_near = is_near | (lower @ is_near + lower.T @ is_near > 0)
        self.nodes = np.flatnonzero(is_near).astype(np.int32)
        place = places_of(self.nodes, n, np.int32)
        self._set_rows(level, lower)
        self.diagonal = level.diagonal_blocks(self.nodes).reshape(-1)
        self._set_followers(coupling, place, fixed)
        # fixed components stay where they are, though followers pull at them
        free = ~fixed.reshape(-1, dim)[self.nodes]
        master_blocks = self._master_blocks(place) * (free[:, :, None] & free[:, None, :])
        # the rows of fixed components are zero
        self.master_inverse = np.linalg.pinv(master_blocks, hermitian=True).reshape(-1)
        # orders of the local sweeps: places in ``nodes``
        self.forward = np.arange(len(self.nodes), dtype=np.int32)
        self.backward = self.forward[::-1].copy()
        #: entries that a local sweep reads: its work
        self.nonzeros = len(self.blocks) + len(self.diagonal)
        #: what the local sweeps read
        self.arrays = (
            self.nodes,
            self.indptr,
            self.indices,
            self.blocks,
            self.diagonal,
            self.follow_indptr,
            self.followers,
            self.follow_weights,
            self.master_inverse,
        )

    def _set_rows(self, level: SplitMatrix, lower: sparse.csr_array) -> None:
        """Set the rows of the nodes in L + L', without the diagonal; ``lower`` has the numbers of the
        blocks of L, from 1 on. Blocks of L' are those of L, transposed."""
        dim = self.dim
        # the numbers of blocks of L' are negative: so 0 numbers none
        rows = sparse.csr_array(lower[self.nodes] - sparse.csr_array(lower[:, self.nodes].T))
        rows.sort_indices()
        self.indptr = rows.indptr.astype(np.int64)
        self.indices = rows.indices.astype(np.uint32)
        blocks = level.lower.reshape(-1, dim, dim)[np.abs(rows.data) - 1]
        in_transpose = rows.data < 0
        blocks[in_transpose] = blocks[in_transpose].transpose(0, 2, 1)
        self.blocks = blocks.reshape(-1)

    def _set_followers(self, coupling: Coupling, place: np.ndarray, fixed: np.ndarray) -> None:
        """Set the followers of each node, the slave nodes that its motion carries along, node after node in
        ``followers`` (k,), those of node i from ``follow_indptr[i]`` on, and their weights W, repeated for
        each component, in the flat ``follow_weights`` (k * dim,); slave nodes have none. Where all
        followers are open, the master is moved alone. ``place`` (n_nodes,) is that of a node in ``nodes``,
        -1 elsewhere; ``fixed`` is a mask (n_dofs,)."""
        by_master = sparse.csr_array(coupling.weights.T)[self.nodes]
        counts = np.diff(by_master.indptr)
        is_slave = np.diff(coupling.weights.indptr)[self.nodes] > 0
        self.follow_indptr = np.append(0, np.cumsum(np.where(is_slave, 0, counts))).astype(np.int32)
        # entries in rows of masters
        of_master = np.repeat(~is_slave, counts)
        slave_nodes = by_master.indices[of_master]
        self.followers = place[slave_nodes]
        # fixed components do not follow: their unknowns stay 0, whatever the master does
        free = ~fixed.reshape(-1, coupling.dim)[slave_nodes]
        self.follow_weights = (by_master.data[of_master, None] * free).reshape(-1)

    def _master_blocks(self, place: np.ndarray) -> np.ndarray:
        """Return the blocks D'AD (n, dim, dim), D the motion of a node that leaves its followers where
        they are: 1 at the node, minus the weight at each follower; ``place`` as of
        :meth:`_set_followers`."""
        n = len(self.nodes)
        dim = self.dim
        # the rows with their diagonal, in the columns of the nodes near contact
        columns = place[self.indices]
        inside = columns >= 0
        indptr = np.append(0, np.cumsum(inside))[self.indptr]
        rows = sparse.bsr_array(
            (self.blocks.reshape(-1, dim, dim)[inside], columns[inside], indptr),
            shape=(dim * n, dim * n),
        )
        rows = sparse.csr_array(rows + block_diagonal(self.diagonal.reshape(-1, dim, dim)))
        masters = np.repeat(np.arange(n), np.diff(self.follow_indptr))
        coordinates = dofs_of(self.followers, dim), dofs_of(masters, dim)
        motion = sparse.eye_array(dim * n) - sparse.csr_array(
            (self.follow_weights, coordinates), shape=rows.shape
        )
        forces = sparse.csc_array(rows @ motion)
        motion = sparse.csc_array(motion)
        # the products of columns that belong to one node
        result = np.empty((n, dim, dim))
        for a, b in np.ndindex(dim, dim):
            result[:, a, b] = motion[:, a::dim].multiply(forces[:, b::dim]).sum(axis=0)
        return result
