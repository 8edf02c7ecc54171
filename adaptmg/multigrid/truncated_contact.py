r"""TruncatedContact: the contact nodes of one level: status, truncation, projection, admissibility,
in 2D and 3D.

In the local frame of a node, with r = f - A u, :math:`p = \max(0, r_n)`, slip :math:`\tau` and
:math:`g = s + \mu p` (an open node: g = s), the truncated residual is

.. math:: \rho_n = 0 \text{ where closed, else } r_n;\qquad
          \rho_t = 0 \text{ where it sticks},\; r_t - g\,\tau/|\tau| \text{ where it slips, else } r_t .

Codes are those of :mod:`adaptmg.smoother.system`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar, TypeVar

import numpy as np

from adaptmg import _checks as checks
from adaptmg._numba import inner_kernel, kernel
from adaptmg.discrete.coordinates import from_frames, to_frames
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.mesh.arrays import mask_of, places_of
from adaptmg.multigrid.split_matrix import SplitMatrix
from adaptmg.smoother.blocks import ZERO, in_loop, inner, read, read_upper, times
from adaptmg.smoother.node_solve import natural_at, read_reference
from adaptmg.smoother.system import (
    BACKWARDS,
    CLOSED,
    HELD,
    SLIPS,
    TANGENTIAL,
    FrictionAt,
    Layer,
    NodalContact,
    friction_bound,
    local_contact,
    turn_held,
)

Instance = TypeVar("Instance")


def with_fields(instance: Instance, **changes: object) -> Instance:
    """Return a copy of a dataclass with some fields changed; a state of 19 fields takes an eighth of
    the time of dataclasses.replace."""
    result = object.__new__(type(instance))
    vars(result).update(vars(instance), **changes)
    return result


#: rows and columns of the upper triangle of a block; numpy takes 30 us to find them
UPPER = {dim: np.triu_indices(dim) for dim in (1, 2, 3)}


@dataclass(eq=False)
class TruncatedContact:
    """Contact data and contact status of one level, flat as the kernels read them."""

    #: compliance of a surface, over that of its node, up to which the linear problems take it as rigid, and leave
    #: its yielding to the sweeps: 30 solves with layers from 1e-16 to 1e-12 m/Pa take 325 cycles; 332 at 0.03, 331
    #: at 0.1, 327 at 1, 346 at 1e-6
    RIGID: ClassVar[float] = 0.3
    #: stiffness of a node that slips, over its diagonal block: where friction rises faster with the slip, its
    #: coefficient follows in part. 13 bodies with friction that doubles over slips of .4 % of the displacement take 365
    #: cycles, and none is handed over; 596 (2) at 0.25, 372 (1) at 1, 477 (10) at 2; all 13 where it follows fully
    YIELDING: ClassVar[float] = 0.5

    dim: int
    nodes: np.ndarray  # (n_contact,) int32
    contact_of: np.ndarray  # (n_nodes,) int32: index of a node among the contact nodes, or -1
    frames: np.ndarray  # (n_contact * dim * dim,): by row normal, tangents
    diagonal: np.ndarray  # (n_contact * dim * dim,): Cartesian diagonal blocks
    blocks: np.ndarray  # (n_contact * dim * (dim + 1) / 2,): upper triangles of the local ones
    gap: np.ndarray  # (n_contact,): largest normal displacement, m
    # (n_contact * (dim - 1),): tangential displacements of zero slip, m; of scalar problems lowest values (n_contact,)
    reference: np.ndarray
    limit: np.ndarray  # (n_contact,): nodal Tresca limit s, N
    friction: np.ndarray  # (n_contact,): coefficient mu
    values: np.ndarray  # (n_contact * dim,): local unknowns, m
    codes: np.ndarray  # (n_contact,) int8; -1 before the first update
    pressure: np.ndarray  # (n_contact,): p >= 0, N
    direction: np.ndarray  # (n_contact * (dim - 1),): of the slip
    hessian: np.ndarray  # (n_contact * (dim - 1)^2,): of the friction
    #: of a law that depends on pressure and slip, as of :class:`~adaptmg.smoother.system.NodalContact`
    friction_at: FrictionAt | None
    hardening: np.ndarray  # (n_contact,): derivative of s + mu p by the slip where it rises, N/m
    compliance: np.ndarray  # (n_contact,): of the surfaces, m/N
    spring: np.ndarray  # (n_contact,): stiffness of surfaces in linear problems, N/m; 0: rigid
    # (k,) int: numbers of contact nodes whose first tangent a support holds and moves
    driven: np.ndarray
    layer: Layer | None  # of surfaces that yield by a power of the force

    @classmethod
    def of(cls, problem: DiscreteProblem, level: SplitMatrix) -> TruncatedContact:
        """Return the contact nodes of a level whose matrix is ``level``."""
        dim = problem.dim
        contact, frames = local_contact(problem)
        nodes = problem.contact.nodes.astype(np.int32)
        contact_of = places_of(nodes, problem.n_nodes, np.int32)
        diagonal = level.diagonal_blocks(nodes)
        local = np.einsum("nij,njk,nlk->nil", frames, diagonal, frames)
        turn_held(local, np.arange(len(nodes)), contact.held)
        row, column = UPPER[dim]
        n = len(nodes)
        result = cls(
            dim=dim,
            nodes=nodes,
            contact_of=contact_of,
            frames=np.ascontiguousarray(frames).reshape(-1),
            diagonal=diagonal.reshape(-1),
            blocks=np.ascontiguousarray(local[:, row, column]).reshape(-1),
            gap=contact.gap,
            reference=contact.reference,
            limit=contact.limit,
            friction=contact.friction,
            values=np.zeros(n * dim),
            codes=np.full(n, -1, dtype=np.int8),
            pressure=np.zeros(n),
            direction=np.zeros(n * (dim - 1)),
            hessian=np.zeros(n * (dim - 1) ** 2),
            friction_at=contact.friction_at,
            hardening=np.zeros(n),
            compliance=contact.compliances,
            spring=np.zeros(n),
            driven=contact.driven,
            layer=contact.layer,
        )
        result._set_springs()
        return result

    def _set_springs(self) -> None:
        """Set the springs of linear problems from the compliances."""
        # of the normals: the first entries of the upper triangles
        stiffness = self.blocks[:: self.dim * (self.dim + 1) // 2]
        soft = self.compliance * stiffness > self.RIGID
        # new arrays: copies share the old ones
        self.spring = np.divide(1.0, self.compliance, out=np.zeros_like(stiffness), where=soft)

    def _follow_layer(self, layer: Layer, forces: np.ndarray, normal: np.ndarray) -> None:
        """Set gap and compliance to the linear law of a layer near these forces and normal
        displacements, both (n_contact,)."""
        self.gap, self.compliance = layer.linearised(forces, normal)
        self._set_springs()

    def posed(self, problem: DiscreteProblem) -> TruncatedContact:
        """Return these nodes with the conditions of another load step, without a status.

        Load steps differ in gaps and slip references, which prescribed values move, too, and so in
        what follows from these: coefficients that depend on the state, layers, driven nodes. They agree
        in nodes, frames, blocks, Tresca limits and compliances; :meth:`start` and
        :meth:`update_status` renew the linear laws of layers, springs and hardening."""
        contact, _ = local_contact(problem)
        return with_fields(
            self,
            gap=contact.gap,
            reference=contact.reference,
            friction=contact.friction,
            friction_at=contact.friction_at,
            layer=contact.layer,
            driven=contact.driven,
            codes=np.full_like(self.codes, -1),
        )

    def copy(self) -> TruncatedContact:
        """Return these nodes with copies of the values and the status."""
        return with_fields(
            self, values=self.values.copy(), codes=self.codes.copy(), pressure=self.pressure.copy()
        )

    @property
    def node_frames(self) -> np.ndarray:
        """Return the frames (n_contact, dim, dim): rows normal, tangents."""
        return self.frames.reshape(-1, self.dim, self.dim)

    @property
    def node_data(self) -> tuple[np.ndarray, ...]:
        """Return the arrays that all kernels on contact nodes read."""
        return (
            self.frames,
            self.blocks,
            self.gap,
            self.reference,
            self.limit,
            self.friction,
            self.compliance,
            self.values,
        )

    @property
    def conditions(self) -> NodalContact:
        """Return the contact conditions in the form that parts in contact frames read."""
        n = len(self.nodes)
        if self.dim == 1:
            slips = np.empty((n, 0))
            return NodalContact(self.gap, slips, self.limit, self.friction, lowest=self.reference)
        # here it serves :attr:`NodalContact.driven` alone
        held = mask_of(self.driven, n) if len(self.driven) else None
        reference = self.reference.reshape(n, self.dim - 1)
        return NodalContact(
            self.gap,
            reference,
            self.limit,
            self.friction,
            held,
            compliance=self.compliance,
            layer=self.layer,
        )

    def start(self, unknowns: np.ndarray) -> None:
        """Project unknowns (n_dofs,) that may penetrate onto the admissible ones, in place, and store their
        local components. Springs admit all."""
        normal_displacement = self.normal_components(unknowns)
        if self.layer is not None:
            self._follow_layer(self.layer, np.zeros_like(normal_displacement), normal_displacement)
        # there is no status yet: no node sticks, and those that penetrate a spring may stay in it
        penetrates_spring = (self.spring > 0) & (normal_displacement > self.gap)
        self.project(unknowns, np.where(penetrates_spring, CLOSED, 0).astype(np.int8))

    def closing_share(self, unknowns: np.ndarray) -> float:
        """Return the share of a change to unknowns (n_dofs,) at which its first open node closes,
        at most 1. Scalar problems take the whole: torsion with 64 and 256 cells a side takes 9 and 8
        cycles from zero, shortened 10 and 12."""
        if self.dim == 1:
            return 1.0
        before = self.values[:: self.dim]
        change = self.normal_components(unknowns) - before
        clearance = self.gap - before
        closing = (self.codes & CLOSED == 0) & (change > clearance)
        return float((clearance[closing] / change[closing]).min(initial=1.0))

    def update_status(self, residual: np.ndarray) -> tuple[int, float, float]:
        """Update the status after a sweep; ``residual`` is f - A u (n_dofs,). Return the number of
        codes that changed, and the sums of squares of the natural residual and of the reactions at
        contact nodes."""
        missed = 0.0
        if self.layer is not None:
            forces = self.normal_components(residual)
            self._follow_layer(self.layer, forces, self.values[:: self.dim])
        if self.friction_at is not None:
            forces = np.maximum(self.normal_components(residual), 0.0)
            missed = self._follow_friction(self.friction_at, forces)
        changed, natural_squares, reaction_squares = classify(
            ZERO[self.dim], self.nodes, *self.node_data, residual, self.codes, self.pressure
        )
        return changed, natural_squares + missed, reaction_squares

    def normal_components(self, vector: np.ndarray) -> np.ndarray:
        """Return the components (n_contact,) along the normals of a vector (n_dofs,), which pressures
        may follow."""
        by_node = vector[: self.dim * len(self.contact_of)].reshape(-1, self.dim)
        return np.einsum("nd,nd->n", self.node_frames[:, 0], by_node[self.nodes])

    def _follow_friction(self, friction_at: FrictionAt, forces: np.ndarray) -> float:
        """Update the coefficients of friction to the present unknowns and normal ``forces``
        (n_contact,), N, at least 0, only in part where friction rises with the slip; return the sum of
        squares of the friction that is then missed.

        Friction that is raised by df shortens the slip of a node of stiffness k by df/k, which lowers
        the friction of the law by h df/k, h its slope by the slip. If a part a of the difference to
        the law is followed, it is multiplied by 1 - a (1 + h/k): a = 1/(1 + h/k) ends it."""
        n = len(self.nodes)
        slip = self.values.reshape(n, -1)[:, 1:] - self.reference.reshape(n, -1)
        size = np.linalg.norm(slip, axis=1)
        bound_of_law, _, slope_of_slip = friction_bound(friction_at, forces, size)
        self.hardening = np.maximum(slope_of_slip, 0.0)
        # of the last tangent: the entry of a first one that a support holds has its sign turned
        tangential = self.blocks.reshape(n, -1)[:, -1]
        part_followed = 1 / (1 + self.hardening / (self.YIELDING * tangential))
        # a new array: copies share the old one
        self.friction = self.friction + part_followed * (friction_at(forces, size) - self.friction)
        return float(np.sum((bound_of_law - self.friction * forces) ** 2))

    def linearise_friction(self) -> None:
        """Set the slip directions (3D: and the Hessian of g |slip|) from the present unknowns, zero at
        nodes that do not slip."""
        if self.dim == 1:
            return
        slip = self.values.reshape(-1, self.dim)[:, 1:] - self.reference.reshape(-1, self.dim - 1)
        slipping = np.flatnonzero(self.codes & TANGENTIAL >= SLIPS)
        direction = np.zeros(slip.shape)
        hessian = np.zeros((*slip.shape, self.dim - 1))
        direction[slipping] = np.sign(slip[slipping])  # in the plane
        if self.dim == 3:
            # scaled: the square of a slip that is all but zero may vanish
            largest = np.abs(slip[slipping]).max(axis=1, keepdims=True)
            size = largest * np.linalg.norm(slip[slipping] / largest, axis=1, keepdims=True)
            slip_direction = slip[slipping] / size
            direction[slipping] = slip_direction
            # g/|tau| (I - tau tau'/|tau|^2)
            across = np.eye(2) - slip_direction[:, :, None] * slip_direction[:, None, :]
            hessian[slipping] = (self._bound[slipping, None] / size)[:, :, None] * across
            # along a tangent that a support holds the slip is given
            direction[self.driven, 0] = 0.0
            hessian[self.driven, 0] = 0.0
            hessian[self.driven, :, 0] = 0.0
        hessian += self.hardening[:, None, None] * direction[:, :, None] * direction[:, None, :]
        # new arrays: copies share the old ones
        self.direction = direction.reshape(-1)
        self.hessian = hessian.reshape(-1)

    @property
    def _bound(self) -> np.ndarray:
        """Return the bound g of friction (n_contact,), N."""
        return self.limit + np.where(self.codes & CLOSED, self.friction * self.pressure, 0.0)

    def truncate(self, residual: np.ndarray) -> float:
        """Truncate the residual f - A u (n_dofs,), in place; return its sum of squares at the contact nodes."""
        squares = truncate(
            ZERO[self.dim],
            self.codes,
            self.nodes,
            self.frames,
            self.limit,
            self.friction,
            self.reference,
            self.gap,
            self.spring,
            self.values,
            residual,
            np.empty(self.dim),
        )
        # friction along a held tangent is taken by the support
        return squares - self._remove_held(residual)

    def _remove_held(self, vector: np.ndarray) -> float:
        """Remove from a vector (n_dofs,), in place, the parts along the first tangents that supports
        hold at driven nodes, which 3D alone has; returns the sum of their squares."""
        if not len(self.driven):
            return 0.0
        at = vector.reshape(-1, 3)
        tangents = self.node_frames[self.driven, 1]
        along = np.einsum("nd,nd->n", tangents, at[self.nodes[self.driven]])
        at[self.nodes[self.driven]] -= along[:, None] * tangents
        return float(np.sum(along**2))

    def project_by(
        self,
        project: Callable[[NodalContact, np.ndarray, np.ndarray], np.ndarray],
        unknowns: np.ndarray,
    ) -> None:
        """Make a corrected iterate admissible, in place, by a user-defined function of the
        conditions and of local values (n_contact, dim) before and after the correction.

        As :func:`project` does, closed nodes keep the gap, or on springs stay beyond it, open ones stop
        at it, held ones do not slip, and driven ones keep their prescribed slip."""
        shape = len(self.nodes), self.dim
        frames = self.node_frames
        before = self.values.reshape(shape)
        closed = self.codes & CLOSED != 0
        on_spring = self.spring > 0
        truncated = np.zeros(shape, dtype=bool)  # components that stay as before
        truncated[:, 0] = closed & ~on_spring
        truncated[:, 1:] = (self.codes & TANGENTIAL == HELD)[:, None]
        dofs = self.dim * self.nodes[:, None] + np.arange(self.dim)
        after = to_frames(frames, unknowns[dofs])
        after[truncated] = before[truncated]
        values = checks.array(
            "project: what project returns", project(self.conditions, before.copy(), after), shape
        )
        values = np.where(truncated, before, values)
        normal = self.conditions.clamped(values[:, 0])
        # the gap of a spring does not limit the conditions, but a correction does not cross it
        same_side = np.where(closed, np.maximum(normal, self.gap), np.minimum(normal, self.gap))
        values[:, 0] = np.where(on_spring, same_side, normal)
        values[self.driven, 1:2] = 0.0  # the unknown of the prescribed slip
        self.values[:] = values.reshape(-1)
        unknowns[dofs] = from_frames(frames, values)

    def project(self, unknowns: np.ndarray, codes: np.ndarray) -> None:
        """Make unknowns (n_dofs,) admissible to a status, the ``codes`` (n_contact,), in place."""
        self._cut(unknowns, codes, move=True)
        self._remove_held(unknowns)
        # the first tangent, of nodes in 3D alone: unknowns count from what the support prescribes
        self.values.reshape(-1, self.dim)[self.driven, 1:2] = 0.0

    def _cut(self, unknowns: np.ndarray, codes: np.ndarray, move: bool) -> int:
        """Return the number of nodes that the projection of unknowns (n_dofs,) cuts for a status, the
        ``codes`` (n_contact,); with ``move`` cut them, in place."""
        return project(
            ZERO[self.dim],
            codes,
            self.nodes,
            self.frames,
            self.gap,
            self.reference,
            self.spring,
            self.values,
            unknowns,
            np.empty(self.dim),
            move,
        )

    def admits(self, unknowns: np.ndarray) -> bool:
        """Return whether an iterate (n_dofs,) closes open nodes or reverses slips at one node at most, which
        the projection cuts."""
        return self._cut(unknowns, self.codes, move=False) <= 1

    def slope_along(self, before: np.ndarray, curvature: float) -> Callable[[float], float]:
        """Return the derivative by alpha of ``curvature`` alpha^2 / 2, of sum g |tau + alpha d_t| over
        slipping nodes, and of half of sum k (alpha d_n)^2 over the springs k of closed ones: d is the
        step from local unknowns ``before`` (n_contact * dim,) to the values. What the springs bore
        before the step is in its residual."""
        shape = len(self.nodes), self.dim
        if self.dim == 1:
            return lambda alpha: curvature * alpha
        slipping = np.flatnonzero(self.codes & TANGENTIAL >= SLIPS)
        change = (self.values - before).reshape(shape)
        closed = self.codes & CLOSED != 0
        of_springs = float(np.where(closed, self.spring, 0.0) @ change[:, 0] ** 2)
        slip = (
            before.reshape(shape)[slipping, 1:] - self.reference.reshape(-1, self.dim - 1)[slipping]
        )
        curvature += of_springs
        return friction_slope(slip, change[slipping, 1:], self._bound[slipping], curvature)


def friction_slope(
    slip: np.ndarray, change: np.ndarray, bound: np.ndarray, curvature: float = 0.0
) -> Callable[[float], float]:
    """Return the derivative of sum g |slip + alpha change| + curvature alpha^2 / 2 by alpha, from slips
    (n, dim - 1) and g (n,)."""

    def slope(alpha: float) -> float:
        moved = slip + alpha * change
        size = np.linalg.norm(moved, axis=1)
        product = np.einsum("nt,nt->n", moved, change)
        rates = np.divide(product, size, out=np.zeros_like(size), where=size > 0)
        return float(bound @ rates) + curvature * alpha

    return slope


@kernel
def classify(
    zero,
    nodes,
    frames,
    blocks,
    gap,
    reference,
    limit,
    friction,
    compliance,
    values,
    residual,
    codes,
    pressure,
):
    """Update ``codes`` and ``pressure`` from local unknowns w and the residual (n_dofs,), r in the frame
    of a node. ``zero`` are dim zeros, see :mod:`adaptmg.smoother.blocks`. Return the number of codes
    that changed, and the sums of squares of the natural residual and of the reactions."""
    dim = np.uint64(len(zero))
    changed = 0
    natural_squares = 0.0
    reaction_squares = 0.0
    for node in range(len(nodes)):
        k = np.uint64(node)
        r = times(frames, dim * dim * k, read(residual, dim * np.uint64(nodes[k]), zero))
        w = read(values, dim * k, zero)
        slip_origin = read_reference(reference, k, zero)  # of scalar problems the lowest value
        code = CLOSED if _touches(w, gap[k], slip_origin) else 0
        if limit[k] > 0.0 or (code and friction[k] > 0.0):
            code += _tangential(w, slip_origin)
        changed += code != codes[k]
        codes[k] = code
        p = max(r[0], 0.0)
        pressure[k] = p
        natural = natural_at(
            read_upper(blocks, k, zero),
            r,
            w,
            gap[k],
            slip_origin,
            limit[k] + friction[k] * p,
            compliance[k],
        )
        natural_squares += inner(natural, natural)
        reaction_squares += inner(r, r)
    return changed, natural_squares, reaction_squares


@in_loop
def _touches(w, gap, reference):
    """Return whether a node is at an obstacle, in scalar problems at one of two."""
    if len(w) == 1:
        return w[0] == gap or w[0] == reference[0]
    return w[0] >= gap


@in_loop
def _tangential(w, reference):
    """Return the code of the slip; in 3D it is without direction."""
    if len(w) == 1:
        return 0
    if len(w) == 2:
        if w[1] == reference[0]:
            return HELD
        return SLIPS if w[1] > reference[0] else BACKWARDS
    return HELD if w[1] == reference[0] and w[2] == reference[1] else SLIPS


@inner_kernel(inline="always")
def _slip_size(dim, k, values, reference):
    """Return the length of the slip of contact node k."""
    largest = 0.0
    for a in range(dim - 1):
        largest = max(largest, abs(values[dim * k + 1 + a] - reference[(dim - 1) * k + a]))
    if largest == 0.0:
        return 0.0
    total = 0.0
    for a in range(dim - 1):
        # scaled: the square of a slip that is all but zero may vanish
        slip = (values[dim * k + 1 + a] - reference[(dim - 1) * k + a]) / largest
        total += slip * slip
    return largest * math.sqrt(total)


@inner_kernel
def _read_local(zero, frames, k, vector, at, local):
    """Write the components of a vector at contact node k in its frame to ``local`` (dim,)."""
    dim = len(zero)
    for a in range(dim):
        local[a] = 0.0
        for b in range(dim):
            local[a] += frames[(dim * k + a) * dim + b] * vector[at + b]


@inner_kernel
def _write_cartesian(zero, frames, k, local, vector, at):
    """Write the Cartesian components of ``local`` (dim,), in the frame of contact node k, to a vector."""
    dim = len(zero)
    for b in range(dim):
        total = 0.0
        for a in range(dim):
            total += frames[(dim * k + a) * dim + b] * local[a]
        vector[at + b] = total


@kernel
def truncate(zero, codes, nodes, frames, limit, friction, reference, gap, spring, values, r, local):
    """Replace the residual (n_dofs,) at contact nodes by the truncated one; returns the sum of its
    squares there. ``local`` (dim,) is overwritten; ``zero``, here and below, is ZERO[dim]."""
    dim = len(zero)
    squares = 0.0
    for k in range(len(nodes)):
        at = dim * np.int64(nodes[k])
        _read_local(zero, frames, k, r, at, local)
        closed = codes[k] & CLOSED
        tangential = codes[k] & TANGENTIAL
        bound = limit[k]
        if closed:
            bound += friction[k] * max(local[0], 0.0)
            # the force of the spring is balanced
            local[0] = local[0] - spring[k] * (values[dim * k] - gap[k]) if spring[k] else 0.0
        if tangential == HELD:
            for a in range(1, dim):
                local[a] = 0.0
        elif tangential:
            size = _slip_size(dim, k, values, reference)
            for a in range(1, dim):
                local[a] -= bound * (values[dim * k + a] - reference[(dim - 1) * k + a - 1]) / size
        _write_cartesian(zero, frames, k, local, r, at)
        for b in range(dim):
            squares += r[at + b] * r[at + b]
    return squares


@kernel
def project(zero, codes, nodes, frames, gap, reference, spring, values, u, local, move):
    """Make a corrected iterate u (n_dofs,) admissible, and write its local unknowns to ``values``.
    Closed nodes keep the gap, those on springs do not open, held ones do not slip. An open node
    stops at the gap. A slip that would turn by more than 90 degrees (2D: reverse) is cut to zero.
    Return how many nodes were cut; without ``move`` only count them. ``local`` (dim,) is
    overwritten."""
    dim = len(zero)
    n_tangents = dim - 1
    n_cut = 0
    for k in range(len(nodes)):
        at = dim * np.int64(nodes[k])
        _read_local(zero, frames, k, u, at, local)
        # the normal
        tangential = codes[k] & TANGENTIAL
        if codes[k] & CLOSED and not spring[k]:
            local[0] = values[dim * k]  # the gap, of scalar problems on either side
        elif codes[k] & CLOSED:
            if local[0] < gap[k]:
                local[0] = gap[k]
                n_cut += 1
        elif local[0] > gap[k]:
            local[0] = gap[k]
            n_cut += 1
        elif dim == 1 and local[0] < reference[k]:
            local[0] = reference[k]
            n_cut += 1
        # the slip
        sticks = tangential == HELD
        if tangential >= SLIPS:
            product = 0.0
            for a in range(n_tangents):
                slip_origin = reference[n_tangents * k + a]
                product += (values[dim * k + 1 + a] - slip_origin) * (local[1 + a] - slip_origin)
            if product <= 0.0:
                sticks = True
                n_cut += 1
        if not move:
            continue
        for a in range(dim):
            if sticks and a > 0:
                local[a] = reference[n_tangents * k + a - 1]
            values[dim * k + a] = local[a]
        _write_cartesian(zero, frames, k, local, u, at)
    return n_cut
