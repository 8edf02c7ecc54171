r"""Aggregates: groups of neighbouring nodes whose rigid motions represent what is smooth in an
error.

They follow the graph of the matrix, not space: two arms that nearly touch share none, nor do two
bodies, nor the slave nodes (whose displacement is relative) and the rest. With B the rigid motions
of each aggregate about its centre, each node projected onto what a contact status lets move, the
coarse matrix is :math:`B^T (A + S) B`.

Where the status of a displacement is wrong, what is missing in the space of that status says
little: a beam whose tip should touch, a body that hovers. The change d is then sought in the span
of P, the motions B smoothed by one step of damped Jacobi, under the conditions of all contact
nodes. With the residual r of the displacement, gaps g, slips
:math:`\tau`, pressures p, friction :math:`-q` and its bound

.. math:: P^T(A P c + N^T p + T^T q - r) = 0,\quad 0 \le p \perp g - N P c \ge 0,\quad |q| \le s + \mu p,

and q along the slip :math:`\tau + T P c`. The unknowns that reach no contact node are eliminated,
and
:mod:`adaptmg.smoother.interior_point` solves the rest. That module is the only one shared with the solvers: what it
finds is measured on the matrix afterwards, so that no fault in it can make an error small.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg.lapack import dpbtrf, dpbtrs
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import splu

from adaptmg import _checks as checks
from adaptmg._numba import kernel, prefetch, read_only
from adaptmg.discrete.block_rows import BlockRows, table_column, table_row
from adaptmg.discrete.coordinates import block_diagonal, frames_of, from_frames, to_frames
from adaptmg.discrete.elasticity import dofs_of, nodal_matrix, rotations
from adaptmg.discrete.problem import DiscreteProblem, remembered_of_structure
from adaptmg.smoother.blocks import (
    AHEAD,
    ONE,
    TWO,
    ZERO,
    add,
    in_loop,
    increase,
    read,
    scale,
    subtract,
    times,
    write,
)
from adaptmg.smoother.interior_point import Conditions, DenseSpan, dense_factors, interior_point

#: nodes of an aggregate and its depth in the graph, by dimension
_SIZE = {1: (64, 4), 2: (64, 4), 3: (80, 3)}
#: beyond this number of nodes, by dimension: least nodes of an aggregate, and about the most aggregates, which bound
#: the cost of the coarse matrix. Certificates of blocks with 36k and 118k nodes at two tolerances take 474 ms; with
#: 200, 100 and 70 aggregates 552, 479 and 512, all with estimates of 1.05 to 1.13 times the error
_MANY, _LARGE, _MOST = {1: 40_000, 2: 40_000, 3: 24_000}, 100, {1: 3600, 2: 1800, 3: 140}
#: aggregates of fewer nodes than they may have over this divisor join a neighbour
_REMNANT = 8
#: what may be missing in the conditions of a changed status: half and twice change none of 119 solves,
#: paths and loops (campaign constants)
_ENOUGH = 1e-4


@kernel
def _grow(kinds, indptr, indices, group, sizes, most_deep, label, queue, depth, members, group_of):
    """Number the aggregates in ``label`` (n_nodes,), -1 before, by breadth-first search among nodes of
    the same ``group`` (n_nodes,); groups of -1 have no aggregate. Each begins at the first node without
    one, and has at most ``sizes[group]`` nodes, at most ``most_deep`` edges away. Write the number of
    its nodes to ``members`` and its group to ``group_of``; return the number of aggregates. ``queue``
    and ``depth`` (n_nodes,) are overwritten; ``kinds, indptr, indices`` are those of
    :class:`~adaptmg.discrete.block_rows.BlockRows`."""
    n = len(group)
    count = 0
    for seed in range(n):
        if label[seed] >= 0 or group[seed] < 0:
            continue
        size = sizes[group[seed]]
        queue[0] = seed
        label[seed] = count
        depth[seed] = 0
        head = 0
        tail = 1
        while head < tail < size:  # each node enters the queue once
            i = queue[head]
            head += 1
            if depth[i] == most_deep:
                continue
            row, origin = table_row(kinds, np.uint64(i))
            for p in range(np.uint64(indptr[row]), np.uint64(indptr[row + ONE])):
                j = table_column(origin, indices, p)
                if tail < size and label[j] < 0 and group[j] == group[seed]:
                    label[j] = count
                    depth[j] = depth[i] + 1
                    queue[tail] = j
                    tail += 1
        members[count] = tail
        group_of[count] = group[seed]
        count += 1
    return count


def _joined(
    rows: BlockRows,
    label: np.ndarray,
    members: np.ndarray,
    group_of: np.ndarray,
    sizes: np.ndarray,
) -> np.ndarray:
    """Return the labels after small aggregates (remnants) have joined their smallest neighbour in the
    same group; ``members`` and ``group_of`` (n_aggregates,) are numbers of nodes and groups."""
    remnant = _REMNANT * members < sizes[group_of]
    if not remnant.any():
        return label
    # a label of -1, of nodes in no aggregate, takes the last entry
    nodes = np.flatnonzero(np.append(remnant, False).take(label))
    _, columns, places = rows.entries(nodes)
    # (n_edges,): the remnant at one end of an edge, and the aggregate at its other end
    aggregate = label[nodes[places]]
    neighbour = label[columns]
    joins = (neighbour >= 0) & ~remnant[neighbour] & (group_of[aggregate] == group_of[neighbour])
    aggregate = aggregate[joins]
    neighbour = neighbour[joins]
    # of several assignments to a remnant the last one counts: that of its smallest neighbour
    order = np.argsort(-members[neighbour], kind="stable")
    joined_to = np.arange(len(members))
    joined_to[aggregate[order]] = neighbour[order]
    new_number = np.cumsum(joined_to == np.arange(len(joined_to)), dtype=np.int32) - 1
    return np.append(new_number[joined_to], np.int32(-1)).take(label)


@kernel
def _adjacent(kinds, indptr, indices, label, seen, aggregate, neighbour):
    """Write the pairs of different aggregates that entries of the matrix join, few of them twice:
    ``seen`` (n_aggregates,), -1 at first, has the aggregate that each was last paired with. Return
    the number of pairs."""
    n_pairs = 0
    for i in range(len(label)):
        if label[i] < 0:
            continue
        row, origin = table_row(kinds, np.uint64(i))
        for p in range(np.uint64(indptr[row]), np.uint64(indptr[row + ONE])):
            other = label[table_column(origin, indices, p)]
            if other >= 0 and other != label[i] and seen[other] != label[i]:
                seen[other] = label[i]
                aggregate[n_pairs] = label[i]
                neighbour[n_pairs] = other
                n_pairs += 1
    return n_pairs


def _groups(problem: DiscreteProblem) -> tuple[np.ndarray, int]:
    """Return the group (n_nodes,) of each node, and the number of bodies: a group is a body or, between
    bodies, its contact nodes, with the number of bodies added; -1 at wholly fixed nodes."""
    dim = problem.dim
    group = np.zeros(problem.n_nodes, dtype=np.int32)
    for k, nodes in enumerate((problem.bodies or {}).values()):
        group[nodes] = k
    n_bodies = int(group.max()) + 1
    if problem.between_bodies:
        group[problem.contact.nodes] += n_bodies
    group[np.logical_and.reduce([problem.fixed[k::dim] for k in range(dim)])] = -1
    return group, n_bodies


def _narrow_order(rows: BlockRows, label: np.ndarray, count: int) -> tuple[np.ndarray, int]:
    """Return the places (count,) of aggregates in an order in which the coarse matrix has a narrow band,
    and the width of the band in aggregates; ``label`` (n_nodes,) is the aggregate of each node, -1 where
    it has none."""
    pairs = np.empty((2, rows.nonzeros // rows.dim**2), dtype=np.int32)
    seen = np.full(count, -1, dtype=np.int32)
    # kinds, indptr and indices, then both rows of ``pairs``, which are filled from the left
    pairs = pairs[:, : _adjacent(*rows.arrays[:3], label, seen, *pairs)]
    coarse = sparse.csr_array(
        (np.ones(pairs.shape[1], dtype=bool), tuple(pairs)), shape=(count, count)
    )
    place = np.argsort(reverse_cuthill_mckee(coarse, symmetric_mode=True)).astype(np.int32)
    return place, int(np.abs(np.diff(place[pairs], axis=0)).max(initial=0)) + 1


class Aggregates:
    """The aggregates of a problem: they depend on mesh, bodies and supports, not on the contact
    status."""

    def __init__(self, problem: DiscreteProblem) -> None:
        """Group the nodes, and order the aggregates so that the coarse matrix has a narrow band."""
        rows = problem.rows
        dim = problem.dim
        n = problem.n_nodes
        group, n_bodies = _groups(problem)
        size, depth = _SIZE[dim]
        if n > _MANY[dim]:
            size = max(_LARGE, n // _MOST[dim])
            # a round aggregate of this size is less deep: this stops those that grow long. Scalar problems,
            # of dim 1, count as plane ones, as in _SIZE
            depth = round(0.9 * size ** (1 / max(dim, 2)))
        # (n_groups,): nodes of an aggregate in a body, and in its contact nodes, a surface with fewer of them
        sizes = np.repeat([size, round(size ** ((dim - 1) / dim))], n_bodies)
        label = np.full(n, -1, dtype=np.int32)
        queue, depths, members, group_of = np.empty((4, n), dtype=np.int32)
        graph = rows.arrays[:3]  # kinds, indptr, indices
        count = _grow(*graph, group, sizes, depth, label, queue, depths, members, group_of)
        label = _joined(rows, label, members[:count], group_of[:count], sizes)
        self.count = int(label.max(initial=-1)) + 1
        points = np.zeros((n, dim)) if problem.coordinates is None else problem.coordinates
        self.offsets = np.empty((n, dim))  # from the centre, over the extent; see _place
        flat_points = read_only(points[:, :dim].reshape(-1))
        _place(ZERO[dim], flat_points, label, self.count, self.offsets.reshape(-1))
        #: ``width``: the largest distance of coupled aggregates in the order, and 1
        place, self.width = _narrow_order(rows, label, self.count)
        #: (n_nodes,): places of aggregates in this order, -1 at wholly fixed nodes: a label of -1 takes
        #: the last entry
        self.label = np.append(place, np.int32(-1)).take(label)

    def span(self, projections: np.ndarray) -> sparse.bsr_array:
        """Return the rigid motions of the aggregates, translations and turns about their centres, as
        columns (n_dofs, n_motions), projected by ``projections`` (n_nodes, dim, dim)."""
        n, dim, _ = projections.shape
        motions = np.zeros((n, dim, dim * (dim + 1) // 2))
        motions[:, :, :dim] = np.eye(dim)
        if dim > 1:  # scalar problems have no turns
            motions[:, :, dim:] = np.stack(rotations(self.offsets, np.eye(dim)), axis=2)
        inside = self.label >= 0
        return sparse.bsr_array(
            ((projections @ motions)[inside], self.label[inside], np.append(0, np.cumsum(inside))),
            shape=(n * dim, motions.shape[2] * self.count),
        )


@kernel
def _place(zero, points, label, count, offsets):
    """Write the offsets (n_nodes * dim,) of points from the centre of their aggregate, over its extent
    (root of the mean square), 0 in no aggregate; ``zero`` is ZERO[dim]."""
    dim = len(zero)
    members = np.zeros(count)
    centres = np.zeros((count, dim))
    squares = np.zeros(count)
    for node in range(len(label)):
        if label[node] >= 0:
            members[label[node]] += 1.0
            for k in range(dim):
                centres[label[node], k] += points[dim * node + k]
    for node in range(len(label)):
        for k in range(dim):
            at = dim * node + k
            offsets[at] = 0.0
            if label[node] >= 0:
                offsets[at] = points[at] - centres[label[node], k] / members[label[node]]
                squares[label[node]] += offsets[at] ** 2
    for node in range(len(label)):
        if label[node] >= 0 and squares[label[node]] > 0.0:
            extent = np.sqrt(squares[label[node]] / members[label[node]])
            for k in range(dim):
                offsets[dim * node + k] /= extent


aggregates_of = remembered_of_structure(Aggregates)


@in_loop
def _moment(offset, force):
    """Return the moment offset x force; with a rotation vector in place of the force, offset x rotation,
    this is minus the motion of the offset."""
    if len(force) == 2:
        return (offset[0] * force[1] - offset[1] * force[0],)
    return (
        offset[1] * force[2] - offset[2] * force[1],
        offset[2] * force[0] - offset[0] * force[2],
        offset[0] * force[1] - offset[1] * force[0],
    )


@in_loop
def _projected(projections, number, v):
    """Return v, projected if its node has a projection (``number`` >= 0)."""
    if number < 0:
        return v
    return times(projections, np.uint64(len(v) * len(v)) * np.uint64(number), v)


# positions are uint64, and so is TWO: the product with a Python integer would be a float, no index. v is a tuple, whose
# length is known when the kernel is compiled: so are the branches
@in_loop
def _increase(array, at, step, v):
    """Add v, a tuple of 1 to 3 numbers, to the entries from a position on, a ``step`` apart."""
    array[at] += v[0]
    if len(v) > 1:
        array[at + step] += v[1]
    if len(v) > 2:
        array[at + TWO * step] += v[2]


@kernel
def _fill(kinds, indptr, indices, data, label, offsets, held, projections, zero, sums, width, band):
    """Add B'AB to ``band`` (n_coarse, ``width``). Between different aggregates the lower half is stored
    by columns, as LAPACK does: the entry of row r and column c at c * width + r - c. The block of an
    aggregate with itself stands, transposed, in the last columns of its rows; only the half of it is
    added whose sum with its transpose is the block.

    The half of the matrix up to the diagonal is read, row i by row i. ``zero`` is ZERO[dim].
    ``sums`` (2, modes, dim), flat, comes as 0, and has the columns of sum_j A_ij B_j twice: summed over
    the nodes j of the ``aggregate`` of i, and over those of one ``other`` aggregate. Where a further one
    follows in the row, and at its end, :func:`_project` adds B_i' times the columns to the band and sets
    them to zero; before the first other one these are those of ``aggregate``, which may grow again. Row a
    of a block A_ij is a force on node j, whose work on the motions of j is entry a of each column;
    this spares products with B_j: 2.0 ms for 66k nodes and 4.9 for 36k in 3D, with products 2.8 and
    24."""
    dim = np.uint64(len(zero))
    start_of_other = dim * dim * (dim + ONE) // TWO  # dim * modes: sums of the other aggregate
    ahead = np.int64(data.ctypes.data) + AHEAD
    for node in range(len(label)):
        i = np.uint64(node)
        aggregate = label[i]
        if aggregate < 0:
            continue
        other = aggregate
        row, origin = table_row(kinds, i)
        for p in range(np.uint64(indptr[row]), np.uint64(indptr[row + ONE])):
            j = table_column(origin, indices, p)
            prefetch(np.uintp(ahead + np.int64(8 * dim * dim * p)))
            if j > i:
                break
            if label[j] < 0:
                continue
            start = np.uint64(0) if label[j] == aggregate else start_of_other
            if label[j] != aggregate and label[j] != other:
                _project(i, aggregate, other, offsets, held, projections, zero, sums, width, band)
                other = label[j]
            # the diagonal block is its own transpose: half of it belongs to either half of the matrix
            share = 0.5 if j == i else 1.0
            offset = read(offsets, dim * j, zero)
            for a in range(dim):
                force = scale(share, read(data, dim * (dim * p + a), zero))
                force = _projected(projections, held[j], force)
                _increase(sums, start + a, dim, force)
                if len(zero) > 1:
                    _increase(sums, start + dim * dim + a, dim, _moment(offset, force))
        # the sums that are left at the end of the row: those of its aggregate and of the last other one
        for k in range(1 if other == aggregate else 2):
            last = aggregate if k == 0 else other
            _project(i, aggregate, last, offsets, held, projections, zero, sums, width, band)


@in_loop
def _project(i, aggregate, other, offsets, held, projections, zero, sums, width, band):
    """Add to ``band`` B_i' times the columns of the sums for the aggregate ``other``, with the motions B_i
    of node i in its ``aggregate``; set these sums to zero. The entry of motion m of ``aggregate`` and
    column c stands at ``start + motion_step * m + column_step * c``; see :func:`_fill`."""
    dim = np.uint64(len(zero))
    modes = np.uint64(len(zero) * (len(zero) + 1) // 2)
    low = modes * np.uint64(aggregate if aggregate < other else other)
    high = modes * np.uint64(other if aggregate < other else aggregate)
    columns = dim * modes
    start = low * width + high - low
    if aggregate == other:  # row low + c of the band, in its last columns
        columns = np.uint64(0)
        start = low * width + width - modes
        motion_step = ONE
        column_step = width
    elif other < aggregate:  # row high + m and column low + c of the matrix
        motion_step = ONE
        column_step = width - ONE
    else:  # row high + c and column low + m
        motion_step = width - ONE
        column_step = ONE
    offset = read(offsets, dim * i, zero)
    for c in range(modes):
        force = _projected(projections, held[i], read(sums, columns + dim * c, zero))
        write(sums, columns + dim * c, zero)
        at = start + column_step * c
        _increase(band, at, motion_step, force)
        if len(zero) > 1:
            _increase(band, at + motion_step * dim, motion_step, _moment(offset, force))


@kernel
def _transfer(down, label, offsets, held, projections, zero, vector, values):
    """Restrict or prolong: if ``down``, add the work of a vector (n_dofs,) on the motions of the
    aggregates to ``values`` (n_coarse,), else add the motions times ``values`` to the vector."""
    dim = np.uint64(len(zero))
    modes = np.uint64(len(zero) * (len(zero) + 1) // 2)
    for node in range(len(label)):
        if label[node] < 0:
            continue
        i = np.uint64(node)
        first = modes * np.uint64(label[i])
        offset = read(offsets, dim * i, zero)
        if down:
            force = _projected(projections, held[i], read(vector, dim * i, zero))
            increase(values, first, force)
            if len(zero) > 1:
                increase(values, first + dim, _moment(offset, force))
            continue
        motion = read(values, first, zero)
        if len(zero) == 2:
            turn = values[first + dim]
            motion = add(motion, (-turn * offset[1], turn * offset[0]))
        if len(zero) == 3:
            turns = read(values, first + dim, zero)
            motion = subtract(motion, _moment(offset, turns))
        increase(vector, dim * i, _projected(projections, held[i], motion))


class CoarseCorrection:
    """B'(A + S)B of a contact status, factorised; S are blocks (n, dim, dim) at some nodes."""

    def __init__(
        self,
        rows: BlockRows,
        aggregates: Aggregates,
        held_nodes: np.ndarray,
        projections: np.ndarray,
        nodes: np.ndarray,
        stiffening: np.ndarray,
    ) -> None:
        """Factorise the coarse matrix, of motions that ``projections`` (n_held, dim, dim), symmetric,
        project at the held nodes (n_held,), with blocks ``stiffening`` (n, dim, dim) at ``nodes`` (n,)."""
        dim = projections.shape[1]
        modes = dim * (dim + 1) // 2
        held = np.full(len(aggregates.label), -1, dtype=np.int32)
        held[held_nodes] = np.arange(len(held_nodes))
        self._basis = (
            aggregates.label,
            aggregates.offsets.reshape(-1),
            held,
            projections.reshape(-1),
            ZERO[dim],
        )
        # the band, which ends before the last columns: these are for the blocks of aggregates with themselves,
        # by halves; see _fill
        width = modes * (aggregates.width + 1)
        band = np.zeros((modes * aggregates.count, width))
        parts = [rows]
        if stiffening.any():
            parts.append(BlockRows.of(nodal_matrix(nodes, stiffening, dim * rows.n_nodes)))
        for part in parts:
            sums = np.zeros(2 * dim * modes)
            _fill(*part.arrays, *self._basis, sums, np.uint64(width), band.reshape(-1))
        halves = band[:, -modes:].reshape(-1, modes, modes)
        blocks = halves + halves.swapaxes(1, 2)
        band[:, -modes:] = 0.0
        for k in range(modes):  # column k of each block, from its diagonal on
            band[k::modes, : modes - k] += blocks[:, k, k:]
        band[:, 0] += raised(band[:, 0])
        # without aggregates, or where nothing holds a motion, the sweeps alone precondition
        self._failed = 1
        if len(band):
            self._factor, self._failed = dpbtrf(band.T, lower=1, overwrite_ab=1)

    def add(self, residual: np.ndarray, result: np.ndarray) -> None:
        """Add the coarse correction of a residual (n_dofs,) to ``result``."""
        if not self._failed:
            sums = np.zeros(self._factor.shape[1])
            # down to the aggregates (True), and up again
            _transfer(True, *self._basis, residual, sums)
            _transfer(
                False, *self._basis, result, dpbtrs(self._factor, sums, lower=1, overwrite_b=1)[0]
            )


def raised(diagonal: np.ndarray) -> np.ndarray:
    """Return the terms (n_coarse,) that make the coarse matrix regular, to be added to its
    diagonal."""
    # motions whose nodes are all held have no stiffness but rounding: they are kept at rest
    largest = diagonal.max(initial=0.0)
    return np.where(diagonal > 1e-14 * largest, checks.ALIKE * diagonal, largest)


@dataclass(frozen=True, eq=False)
class ContactValues:
    """Gaps, slips and forces at the contact nodes."""

    gap: np.ndarray  # (n_contact,) m
    slip: np.ndarray  # (n_contact, dim), in the tangent plane, m
    pressure: np.ndarray  # (n_contact,) N
    friction: np.ndarray  # (n_contact, dim) N

    def forces(self, normals: np.ndarray) -> np.ndarray:
        """Return contact forces (n_contact, dim), N."""
        return self.friction - self.pressure[:, None] * normals


class _Smoothed(DenseSpan):
    """The span of the smoothed aggregates of a problem, with the matrix on it condensed to the
    unknowns that move contact nodes."""

    def __init__(self, problem: DiscreteProblem) -> None:
        """Compute the span, and eliminate its unknowns that move no contact node."""
        dim = problem.dim
        self.dim = dim
        free = ~problem.fixed
        matrix = sparse.csr_array(problem.decoupled_rows.matrix)
        basis = aggregates_of(problem).span(problem.free_spans(np.arange(problem.n_nodes)))
        inverse = np.where(free, 1 / matrix.diagonal(), 0.0)
        # damped Jacobi with 4/3 over the largest eigenvalue of D^-1 A, as of smoothed aggregation: ten
        # power steps find this nearly, a little too small, hence the factor 1.1. They begin at numbers
        # without a pattern, the same in each run
        vector = np.where(free, np.sin(np.arange(len(free)) ** 2.0), 0.0)
        for _ in range(10):
            size = np.linalg.norm(vector)
            vector = inverse * (matrix @ (vector / size))
        damping = 4 / 3 / (1.1 * np.linalg.norm(vector))
        self.span = sparse.csr_array(
            basis - sparse.diags_array(damping * inverse) @ (matrix @ basis)
        )
        self.span.eliminate_zeros()
        coarse = sparse.csc_array(self.span.T @ (matrix @ self.span))
        coarse = coarse + sparse.diags_array(raised(coarse.diagonal()), format="csc")
        self.frames = frames_of(problem)
        rows = self.span[dofs_of(problem.contact.nodes, dim)]
        at_contact = sparse.csr_array(block_diagonal(self.frames) @ rows)
        touched = np.isin(np.arange(self.span.shape[1]), at_contact.indices)
        # unknowns that move contact nodes, and the others, which are eliminated
        self.near = np.flatnonzero(touched)
        self.far = np.flatnonzero(~touched)
        self.rows = sparse.csr_array(at_contact[:, self.near])
        self._solve = (
            splu(sparse.csc_array(coarse[self.far][:, self.far])).solve
            if len(self.far)
            else np.asarray  # returns the empty right-hand side
        )
        self._coupling = sparse.csc_array(coarse[self.far][:, self.near])
        # the Schur complement on the unknowns that move contact nodes
        self.matrix = coarse[self.near][:, self.near].toarray() - self._coupling.T @ self._solve(
            self._coupling.toarray()
        )

    def factors(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        """Return the solution of equations with S + R'DR; see
        :class:`~adaptmg.smoother.interior_point.Span`."""
        added = self.rows.T @ (block_diagonal(blocks) @ self.rows)
        return dense_factors(self.matrix + added.toarray())

    def condense(self, load: np.ndarray) -> np.ndarray:
        """Return the load (m,) of the condensed equations for forces (n_coarse,)."""
        return load[self.near] - self._coupling.T @ self._solve(load[self.far])

    def recover(self, load: np.ndarray, near: np.ndarray) -> np.ndarray:
        """Return the displacement (n_dofs,) of condensed unknowns ``near`` (m,) under forces
        ``load`` (n_coarse,)."""
        values = np.zeros(self.span.shape[1])
        values[self.near] = near
        values[self.far] = self._solve(load[self.far] - self._coupling @ near)
        return self.span @ values


_smoothed_of = remembered_of_structure(_Smoothed)


def change_with_free_status(
    problem: DiscreteProblem,
    residual: np.ndarray,
    claims: ContactValues,
    stiffness: np.ndarray,
    limit: np.ndarray,
    friction: np.ndarray,
    compliance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the change (n_dofs,) in the span of the smoothed aggregates that solves the contact
    problem there, in which the contact status may change, and the contact forces (n_contact, dim)
    after it; None if the interior point method does not find it, or for a scalar problem.

    ``residual`` (n_dofs,) and ``claims`` are those before the change. ``stiffness`` (n_contact,):
    of the nodes, N/m; ``limit`` (n_contact,): bound of friction without pressure, N; ``friction``
    (n_contact,): its coefficient; ``compliance`` (n_contact,): of the surfaces, m/N."""
    if problem.dim == 1:
        return None
    coarse = _smoothed_of(problem)
    load = coarse.span.T @ residual
    # where a support holds a tangent its reaction takes the place of friction
    without_support = ~problem.held_spans(problem.contact.nodes).any(axis=(1, 2))
    slip = to_frames(coarse.frames, claims.slip)[:, 1:]
    # the conditions add e p to the gap of an unloaded surface; the gap of the claims contains it
    # already. The slip of the change counts from minus that of the claims
    gap = claims.gap - compliance * np.maximum(claims.pressure, 0.0)
    conditions = Conditions(
        gap=gap,
        slip_reference=-slip,
        limit=limit * without_support,
        friction=friction * without_support,
        compliance=compliance,
    )
    solution = interior_point(
        coarse,
        load=coarse.condense(load),
        contact=conditions,
        stiffness=np.tile(stiffness[:, None], problem.dim),
        tolerance=_ENOUGH,
    )
    if not solution.slack <= _ENOUGH:
        return None
    return coarse.recover(load, solution.unknowns), -from_frames(coarse.frames, solution.forces)
