r"""LocalSystem: a matrix in contact frames, fixed dofs eliminated, as the flat arrays the kernels
read.

At contact node i the unknowns are :math:`w = F_i u`, the rows of F_i being n, t (2D: t = n turned
by +90 degrees) or n, t1, t2 (3D); elsewhere w = u. Fixed dofs are lifted off: :math:`w` counts from
the prescribed values, the rows and columns of fixed dofs are zero but for the diagonal, so a kernel
leaves them at zero.

Results hold the :class:`ContactState` of a contact node. The solvers keep finer codes: bit
``CLOSED``, set where the gap is closed, and under ``TANGENTIAL`` one of ``FREE`` (no friction
acts), ``HELD`` (no slip), ``SLIPS`` (2D: in the direction of the tangent) and ``BACKWARDS`` (2D:
against it). With the force p a node is OPEN where it is not closed or p = 0, elsewhere STICK where
it is held and SLIP otherwise: :func:`contact_states`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.block_rows import diagonal_places
from adaptmg.discrete.coordinates import frames_of, rotate, rotate_back, to_frames
from adaptmg.discrete.problem import (
    DiscreteProblem,
    remembered_of_structure,
)
from adaptmg.mesh.arrays import places_of
from adaptmg.problem.laws import follows_state
from adaptmg.transfer.galerkin import without_fixed

#: coefficients of friction (n_contact,) at nodal forces, N, and slips, m
FrictionAt = Callable[[np.ndarray, np.ndarray], np.ndarray]
#: compliance over that of a node, above which a surface counts as a spring in linear problems; below, its normal
#: displacement is prescribed like that of a rigid one
STIFF = checks.SIX_DIGITS
#: nodal forces at which laws are linearised, within double precision, N: at the larger one hardly any surface yields.
#: 1e-100 and 1e100, or 1e-300 and 1e300, change 18 solves with exponents 2 to 8 by rounding at most
_FORCES = 1e-200, 1e200
#: steps of differences: by a pressure over this pressure, by slips over the largest slip
_DIFFERENCE = checks.SIX_DIGITS
#: the least that the largest slip counts there, m; a hundredth and a hundred times change none of 8 solves
_SHORTEST = 1e-9


@dataclass(frozen=True, eq=False)
class Layer:
    """Surfaces that yield by :math:`d = e p^{1/m}`. In each cycle, sweep or step the solvers replace
    this law by a linear one near the present iterate."""

    gap: np.ndarray  # (n_contact,): largest normal displacement without a force, m
    compliance: np.ndarray  # (n_contact,): e, m/N^(1/m)
    exponent: np.ndarray  # (n_contact,): m >= 1
    stiffness: np.ndarray  # (n_contact,): of the nodes along their normals, N/m

    @classmethod
    def of(cls, problem: DiscreteProblem, gap: np.ndarray) -> Layer | None:
        """Return the surfaces of a problem with these gaps (n_contact,), m, None where all are linear."""
        contact = problem.contact
        if not (contact.exponent > 1).any():
            return None
        normals = contact.normals
        blocks = problem.rows.diagonal_blocks(contact.nodes)
        stiffness = np.einsum("ni,nij,nj->n", normals, blocks, normals)
        return cls(gap, contact.compliance, contact.exponent, stiffness)

    def tangent(self, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the gaps (n_contact,), m, and compliances, m/N, of the tangents at forces."""
        # e p^(1/m) has the derivative e p^(1/m - 1) / m; the tangent begins at g0 + (1 - 1/m) e p^(1/m)
        force = np.clip(force, *_FORCES)
        depth = self.compliance * force ** (1 / self.exponent)
        compliance = self.compliance * force ** (1 / self.exponent - 1) / self.exponent
        return self.gap + (1 - 1 / self.exponent) * depth, compliance

    def linearised(self, force: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the gaps (n_contact,), m, and compliances, m/N, of linear laws near these forces and
        normal displacements (n_contact,).

        The law d = e p^(1/m) is linearised at the force p. Where it is softer than the rest of the
        node, it is linearised at the force (d/e)^m of the depth d instead: an error of the displacement
        changes the residual, from which p comes, more than this force. A node that does not touch takes
        the mean force of the others; where none touches, surfaces are rigid.

        With the compliance c = e p^(1/m - 1) / m at p the tangent is d = (m - 1) c p + c q in the force
        q, and the secant d = m c q. The tangent is taken where its force at the depth d, d/c - (m - 1) p,
        is at least p/2, that is d > (1 - 1/(2 m)) m c p; else the secant."""
        depth = np.maximum(normal - self.gap, 0.0)
        # 72 solves of the GRECO bar, a Hertzian cylinder and a block in 3D, exponents 2 to 8: 812 cycles; 821 at .3
        # times the stiffness, 812 at 3 times, 1211 without; tangents that leave a tenth or nine tenths 812 and 813,
        # secants alone 1099
        _, compliance = self.tangent(force)
        soft = (compliance * self.stiffness > 1) & (depth > 0)
        with np.errstate(over="ignore"):
            # the force (depth / e)^m that compresses the surface to its depth
            over_scale = np.divide(depth, self.compliance, out=np.zeros_like(depth), where=soft)
            estimated = np.where(soft, over_scale**self.exponent, force)
            # with rigid surfaces in place of the mean force, sweeps of a single grid stall (a block on a dome in 3D,
            # 1e-10 m/Pa at 50 MPa, exponent 20: they converge after 1540); 60 solves by multigrid
            # take the same 580 cycles
            touching = estimated > 0
            mean = estimated[touching].mean() if touching.any() else np.inf
        p = np.clip(np.where(touching, estimated, mean), *_FORCES)
        gap, compliance = self.tangent(p)
        secant = self.exponent * compliance  # e p^(1/m) / p = m c
        by_tangent = depth > (1 - 0.5 / self.exponent) * secant * p
        return np.where(by_tangent, gap, self.gap), np.where(by_tangent, compliance, secant)


@dataclass
class NodalContact:
    """Contact conditions in local components: w_n <= gap; ``|f_t| <= limit + friction * p``; f_t
    against the slip.

    ``held``, in 3D: nodes of which a support holds the first tangent and not the second; there the
    slip along the first is minus its slip_reference, and that entry of the diagonal block has the
    sign turned, by which the node solve (:mod:`adaptmg.smoother.node_solve`) knows such nodes.
    ``friction_at``, of a law that depends on pressure and slip: the coefficients (n_contact,) at
    nodal forces, N, and slips, m.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(0.3)), divisions=(2, 4))
    >>> am.smoother.local_system(grids.finest.discrete).contact.friction.tolist()
    [0.3, 0.3, 0.3, 0.3, 0.3]
    """

    gap: np.ndarray  # (n_contact,): largest normal displacement, m; +inf without an obstacle
    slip_reference: np.ndarray  # (n_contact, dim - 1): tangential displacement of zero slip, m
    limit: np.ndarray  # (n_contact,): nodal Tresca limit, N
    friction: np.ndarray  # (n_contact,): Coulomb coefficient
    held: np.ndarray | None = None  # (n_contact,) bool
    #: (n_contact,): smallest normal displacement, m, -inf without a second obstacle; of scalar
    #: problems only, None of others
    lowest: np.ndarray | None = None
    friction_at: FrictionAt | None = None
    compliance: np.ndarray | None = None  # (n_contact,): penetration over nodal force, m/N; None: 0
    #: of surfaces that yield by a power of the force, which gap and compliance follow
    layer: Layer | None = None

    @property
    def compliances(self) -> np.ndarray:
        """Return the compliances (n_contact,), m/N."""
        return np.zeros(len(self.gap)) if self.compliance is None else self.compliance

    @property
    def reference(self) -> np.ndarray:
        """Return the flat array that kernels read next to the gap: displacements of zero slip
        (n_contact * (dim - 1),), of scalar problems the lowest values (n_contact,)."""
        return self.slip_reference.reshape(-1) if self.lowest is None else self.lowest

    def opening(self, normal: np.ndarray) -> np.ndarray:
        """Return the distances (n_contact,), m, of normal displacements to the nearest obstacle."""
        above = self.gap - normal
        return above if self.lowest is None else np.minimum(above, normal - self.lowest)

    def clamped(self, normal: np.ndarray) -> np.ndarray:
        """Return normal displacements (n_contact,) put back between the obstacles, m."""
        # compliant surfaces hold by their force, not by a limit
        below = np.where(self.compliances > 0, normal, np.minimum(normal, self.gap))
        return below if self.lowest is None else np.maximum(below, self.lowest)

    def follow(self, values: np.ndarray, residual: np.ndarray) -> None:
        """Update the conditions that depend on the state, in place: gap and compliance of a layer, and
        the friction. ``values`` of the contact nodes and the residual b - A w there are both
        (n_contact, dim)."""
        if self.layer is not None:
            # with a layer the compliances are stored, so that this changes them
            laws = self.layer.linearised(residual[:, 0], values[:, 0])
            self.gap[:], self.compliances[:] = laws
        if self.friction_at is not None:
            slip = np.linalg.norm(values[:, 1:] - self.slip_reference, axis=1)
            # of forces of either sign: laws see pressures of at least 0
            self.friction[:] = self.friction_at(residual[:, 0], slip)

    def tangent(
        self, values: np.ndarray, residual: np.ndarray
    ) -> tuple[NodalContact, np.ndarray | float]:
        """Return the conditions whose bound s + mu p is the tangent of ``B = mu(p, |slip|) p`` at
        ``values``, and ``dB / d|slip|`` (n_contact,), N/m, both by differences; see
        :meth:`follow`."""
        if self.friction_at is None:
            return self, 0.0
        force = np.maximum(residual[:, 0], 0.0)
        slip = np.linalg.norm(values[:, 1:] - self.slip_reference, axis=1)
        # B(p) + B'(p) (q - p) at the force q
        bound, slope, hardening = friction_bound(self.friction_at, force, slip)
        return replace(self, limit=self.limit + bound - slope * force, friction=slope), hardening

    @property
    def driven(self) -> np.ndarray:
        """Return the contact nodes (k,), indices, that a support moves along a held tangent."""
        return (
            np.empty(0, dtype=np.int64)
            if self.held is None
            else np.flatnonzero(self.held & (self.slip_reference[:, 0] != 0))
        )


def friction_bound(
    friction_at: FrictionAt, force: np.ndarray, slip: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the bound B = mu(p, s) p (n_contact,), N, and its derivatives dB/dp and dB/ds by
    differences, at the forces p >= 0, N, and slips s, m."""
    friction = friction_at(force, slip)
    pressed = (1 + _DIFFERENCE) * force
    rise = friction_at(pressed, slip) * pressed - friction * force
    # without a force dB/dp is mu
    slope = np.divide(rise, pressed - force, out=friction.copy(), where=pressed > force)
    step = _DIFFERENCE * max(slip.max(initial=0.0), _SHORTEST)
    hardening = (friction_at(force, slip + step) - friction) * force / step
    return friction * force, slope, hardening


@dataclass(eq=False)
class LocalSystem:
    """A block-sparse matrix in local components with fixed dofs eliminated, as the kernels read
    it.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> int(am.smoother.local_system(grids.finest.discrete).system.fixed.sum())
    5
    """

    dim: int  # block size
    indptr: np.ndarray  # (n_nodes + 1,) int32
    indices: np.ndarray  # (n_blocks,) int32: block columns, sorted
    data: np.ndarray  # (n_blocks * dim * dim,): blocks, row by row
    diagonal: np.ndarray  # (n_nodes * dim * dim,): diagonal blocks
    inverse: np.ndarray  # (n_nodes * dim * dim,): their inverses
    fixed: np.ndarray  # (n_dofs,) bool: eliminated dofs, local components
    nodes: np.ndarray  # (n_contact,) int32: contact nodes
    contact_of: np.ndarray  # (n_nodes,) int32: index of a node among the contact nodes, or -1

    @classmethod
    def from_matrix(
        cls, matrix: sparse.bsr_array, fixed: np.ndarray, nodes: np.ndarray
    ) -> LocalSystem:
        """Return the system of a matrix in local components whose rows and columns in the mask ``fixed``
        (n_dofs,) are decoupled; ``nodes`` (n_contact,) are its contact nodes."""
        dim = matrix.blocksize[0]
        n_nodes = matrix.shape[0] // dim
        if not matrix.has_sorted_indices:
            matrix = matrix.sorted_indices()
        indptr = matrix.indptr.astype(np.int32)
        indices = matrix.indices.astype(np.int32)
        diagonal = matrix.data.take(diagonal_places(matrix), axis=0)
        contact_of = places_of(nodes, n_nodes, np.int32)
        result = cls(
            dim=dim,
            indptr=indptr,
            indices=indices,
            data=np.ascontiguousarray(matrix.data).reshape(-1),
            diagonal=diagonal.reshape(-1),
            inverse=inverse_blocks(diagonal).reshape(-1),
            fixed=np.asarray(fixed),
            nodes=np.asarray(nodes, dtype=np.int32),
            contact_of=contact_of,
        )
        result.__dict__["matrix"] = matrix  # :attr:`matrix` does not make it again
        return result

    @property
    def n_nodes(self) -> int:
        return len(self.indptr) - 1

    @property
    def n_dofs(self) -> int:
        return self.n_nodes * self.dim

    @property
    def nonzeros(self) -> int:
        """Return the number of stored entries: the unit in which work is counted."""
        return len(self.data)

    @cached_property
    def matrix(self) -> sparse.bsr_array:
        """Return the matrix, sharing memory."""
        blocks = self.data.reshape(-1, self.dim, self.dim)
        return sparse.bsr_array(
            (blocks, self.indices, self.indptr), shape=(self.n_dofs, self.n_dofs), copy=False
        )


def inverse_blocks(blocks: np.ndarray) -> np.ndarray:
    """Return the inverses of (n, dim, dim) blocks; ValueError names the first singular one."""
    try:
        inverse = np.linalg.inv(blocks)
    except np.linalg.LinAlgError:
        inverse = np.full_like(blocks, np.nan)
    if not np.isfinite(inverse).all():
        bad = int(np.argmin(np.abs(np.linalg.det(blocks))))
        raise ValueError(
            f"the diagonal block of node {bad} is singular: is the node part of an element?"
        )
    return inverse


@dataclass(eq=False)
class LocalProblem:
    """A DiscreteProblem in local components, on which the nonlinear solvers iterate.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.smoother.local_system(grids.finest.discrete).load.shape                 # (n_dofs,), N
    (50,)
    """

    system: LocalSystem
    load: np.ndarray  # (n_dofs,): local components, prescribed values lifted, zero at fixed dofs, N
    contact: NodalContact
    frames: np.ndarray  # (n_contact, dim, dim): rows normal, tangents
    discrete: DiscreteProblem  # the problem in Cartesian components

    def residual(self, unknowns: np.ndarray) -> np.ndarray:
        """Return b - A w (n_dofs,), N, contact forces included."""
        return self.load - self.system.matrix @ unknowns

    def to_local(self, displacement: np.ndarray) -> np.ndarray:
        """Return the local unknowns (n_dofs,) of a Cartesian displacement (n_nodes, dim) or
        (n_dofs,)."""
        w = rotate(self.discrete.from_prescribed(displacement), self.frames, self.system.nodes)
        w[self.system.fixed] = 0.0
        return w

    def to_cartesian(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the Cartesian displacement (n_nodes, dim), m, prescribed values included, of local
        unknowns."""
        u = rotate_back(unknowns, self.frames, self.system.nodes)
        return self.discrete.with_prescribed(u).reshape(-1, self.system.dim)


def local_system(problem: DiscreteProblem, system: LocalSystem | None = None) -> LocalProblem:
    """Rotate a DiscreteProblem into contact frames and eliminate its fixed dofs. ``system``: that
    of a problem which shares matrix, fixed dofs and contact nodes with it.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> problem = am.smoother.local_system(grids.finest.discrete)
    >>> len(problem.contact.gap), problem.system.dim
    (5, 2)
    """
    checks.instance("problem", problem, DiscreteProblem)
    frames, fixed = frames_and_fixed(problem)
    load = rotate(problem.load_from_prescribed(), frames, problem.contact.nodes)
    load[fixed] = 0.0
    nodal = _nodal_contact(problem, frames, fixed)
    if system is None:
        matrix = without_fixed(
            _rotated(problem.decoupled_rows.matrix, frames, problem.contact.nodes),
            fixed,
            copy=False,
        )
        system = LocalSystem.from_matrix(matrix, fixed, problem.contact.nodes)
        # the node solve knows nodes with a held tangent by the sign of an entry: see NodalContact.held
        turn_held(system.diagonal, system.nodes, nodal.held)
    checks.instance("system", system, LocalSystem)
    return LocalProblem(system=system, load=load, contact=nodal, frames=frames, discrete=problem)


# stiffness with which supports take up friction, over that of the node. Of 36 paths of a punch on rollers, 156 steps,
# one does not converge (999 cycles); with half and twice two, with a tenth seven, where friction below its bound and a
# slip contradict the certificate, with ten times eleven, whose motions are rounded
_HELD = 1e7


def local_contact(problem: DiscreteProblem) -> tuple[NodalContact, np.ndarray]:
    """Return the contact conditions in local components, and the frames (n_contact, dim, dim), without
    rotating the matrix."""
    frames, fixed = frames_and_fixed(problem)
    return _nodal_contact(problem, frames, fixed), frames


def held_tangents(problem: DiscreteProblem) -> np.ndarray:
    """Return the tangents at contact nodes that a support holds (n_contact, dim - 1) bool."""
    _, fixed = frames_and_fixed(problem)
    return fixed.reshape(-1, problem.dim)[problem.contact.nodes, 1:]


def held_stiffness(problem: DiscreteProblem) -> np.ndarray:
    """Return the stiffness k (n_contact,), N/m, with which supports take up friction along the tangents
    that they hold."""
    return _HELD * np.abs(np.einsum("nii->ni", contact_blocks(problem))).max(axis=1)


@remembered_of_structure
def contact_blocks(problem: DiscreteProblem) -> np.ndarray:
    """Return the diagonal blocks (n_contact, dim, dim) of the contact nodes in local components, as
    :func:`local_system` has them, without rotating the matrix."""
    frames, _ = frames_and_fixed(problem)
    held = held_tangents(problem)
    cartesian = problem.decoupled_rows.diagonal_blocks(problem.contact.nodes)
    blocks = np.einsum("nij,njk,nlk->nil", frames, cartesian, frames)
    # of rows and columns of held tangents only the diagonal entries stay
    free = np.ones((len(blocks), problem.dim), dtype=bool)
    free[:, 1:] = ~held
    blocks *= (free[:, :, None] & free[:, None, :]) | np.eye(problem.dim, dtype=bool)
    # the node solve knows nodes with a held tangent by the sign of an entry: see NodalContact.held
    turn_held(blocks, np.arange(len(blocks)), _first_held(held))
    return blocks


def _nodal_contact(problem: DiscreteProblem, frames: np.ndarray, fixed: np.ndarray) -> NodalContact:
    """Return the contact conditions of a problem in contact ``frames`` (n_contact, dim, dim), for unknowns
    from which the prescribed values are subtracted; ``fixed`` (n_dofs,) is the mask of fixed dofs in
    these frames."""
    prescribed = to_frames(
        frames, problem.fixed_values.reshape(-1, problem.dim)[problem.contact.nodes]
    )
    limit, friction = problem.law.bounds(len(problem.contact))
    held = fixed.reshape(-1, problem.dim)[problem.contact.nodes][:, 1:]
    first_held = _first_held(held)
    reference = _slip_reference(problem, frames, prescribed[:, 1:], held, first_held)
    gap = problem.contact.gaps
    lowest = None
    if problem.dim == 1:
        # the unknown counts along the axis: where the normal points against it, gaps are below
        above = problem.contact.normals[:, 0] > 0
        lowest = -np.where(above, problem.contact.opposite_gaps, gap)
        gap = np.where(above, gap, problem.contact.opposite_gaps)
    # only tangents are fixed here: along normals prescribed values are rounding, in scalar problems 0
    gap = gap - prescribed[:, 0]
    compliance = problem.contact.compliance
    layer = Layer.of(problem, gap)
    if layer is not None:
        # before the first state no node touches
        gap, compliance = layer.linearised(
            force=np.zeros_like(gap), normal=np.full_like(gap, -np.inf)
        )
    return NodalContact(
        gap=gap,
        slip_reference=reference,
        limit=np.array(limit, dtype=np.float64),
        friction=np.array(friction, dtype=np.float64),
        held=first_held,
        lowest=lowest,
        friction_at=_friction_at(problem, frames, held, first_held),
        compliance=compliance,
        layer=layer,
    )


def _first_held(held: np.ndarray) -> np.ndarray | None:
    """Return the nodes (n_contact,) bool of which a support holds the first tangent and not the second,
    from the ``held`` tangents (n_contact, dim - 1); None without such nodes, as in the plane."""
    if held.shape[1] < 2:
        return None
    first_held = held[:, 0] & ~held[:, 1]
    return first_held if first_held.any() else None


def _slip_reference(
    problem: DiscreteProblem,
    frames: np.ndarray,
    prescribed: np.ndarray,
    held: np.ndarray,
    first_held: np.ndarray | None,
) -> np.ndarray:
    """Return the values (n_contact, dim - 1) of the tangential unknowns, which count from the
    ``prescribed`` displacements, at which the slip is zero. Unknowns along ``held`` tangents are 0: so
    is their reference, since the support bears the friction there. At nodes ``first_held`` the friction
    along the second tangent depends on both slips: there it is minus the prescribed slip, which is then
    the slip of the unknown 0."""
    before = to_frames(frames, problem.contact.slip_reference)
    reference = before[:, 1:] - prescribed
    reference[held] = 0.0
    if first_held is not None:
        u = to_frames(frames, problem.at_contact(problem.fixed_values))
        slip = u[:, 1] - before[:, 1]
        # along directions that are not axes rounding is not a slip
        slip[np.abs(slip) <= checks.ROUNDING * np.abs([u, before]).max()] = 0.0
        reference[first_held, 0] = -slip[first_held]
    return np.ascontiguousarray(reference)


def _friction_at(
    problem: DiscreteProblem, frames: np.ndarray, held: np.ndarray, first_held: np.ndarray | None
) -> FrictionAt | None:
    """Return the coefficients of friction as a function of forces and slips of the unknowns; None for
    laws that do not depend on these. The whole slip is

        |tau| = hypot(slip of the unknowns, prescribed slip along ``held`` tangents)

    (n_contact,); at nodes ``first_held`` the slip of the unknowns has both (:func:`_slip_reference`)."""
    if not follows_state(problem.law):
        return None
    displacement = problem.at_contact(problem.fixed_values) - problem.contact.slip_reference
    along_held = np.where(held, to_frames(frames, displacement)[:, 1:], 0.0)
    prescribed_slip = np.linalg.norm(along_held, axis=1)
    if first_held is not None:
        prescribed_slip[first_held] = 0.0
    return lambda force, slip: problem.friction_at(force, np.hypot(slip, prescribed_slip))


def turn_held(diagonal: np.ndarray, nodes: np.ndarray, held: np.ndarray | None) -> None:
    """Make the entry (1, 1), of the first tangent, negative in the flat diagonal blocks of nodes where a
    support holds it and not the second, in place: by this sign the node solve knows them (see
    ``held`` of :class:`NodalContact`). ``nodes`` (n_contact,) are the places of the contact nodes
    among the blocks."""
    if held is not None:
        blocks = diagonal.reshape(-1, 3, 3)
        at = nodes[held]
        blocks[at, 1, 1] = -np.abs(blocks[at, 1, 1])


@remembered_of_structure
def frames_and_fixed(problem: DiscreteProblem) -> tuple[np.ndarray, np.ndarray]:
    """Return the frames (n_contact, dim, dim), and the mask (n_dofs,) of fixed dofs in local
    components: at contact nodes the tangents that supports hold. Normals of scalar problems, whose
    nodes have obstacles on both sides, point along the axis."""
    dim = problem.dim
    fixed = problem.fixed.reshape(-1, dim).copy()
    frames = frames_of(problem)
    if dim == 1:
        frames = np.abs(frames)
    spans = problem.held_spans(problem.contact.nodes)
    # tangent j is fixed if all of it lies in what supports hold
    fixed_tangents = np.einsum("nij,njk,nik->ni", frames, spans, frames) > 1 - checks.ALIKE
    fixed[problem.contact.nodes] = fixed_tangents
    return frames, fixed.reshape(-1)


def _rotated(matrix: sparse.bsr_array, frames: np.ndarray, nodes: np.ndarray) -> sparse.bsr_array:
    """Return a copy of a matrix, turned into contact ``frames`` (n, dim, dim) of ``nodes`` (n,): A_ij
    becomes F_i A_ij F_j', F the frame of one of these nodes and the identity elsewhere."""
    n = matrix.shape[0] // matrix.blocksize[0]
    frame_of = places_of(nodes, n)
    in_row = np.repeat(frame_of, np.diff(matrix.indptr))
    in_column = frame_of[matrix.indices]
    data = matrix.data.copy()
    for_row = np.flatnonzero(in_row >= 0)
    data[for_row] = np.einsum("nij,njk->nik", frames[in_row[for_row]], data[for_row])
    for_column = np.flatnonzero(in_column >= 0)
    data[for_column] = np.einsum("nij,nkj->nik", data[for_column], frames[in_column[for_column]])
    return sparse.bsr_array((data, matrix.indices, matrix.indptr), shape=matrix.shape)


class ContactState(IntEnum):
    """State of a contact node: open, touching and slipping, or touching and sticking."""

    OPEN = 0
    SLIP = 1
    STICK = 2


OPEN, SLIP, STICK = ContactState

CLOSED = 1
FREE, HELD, SLIPS, BACKWARDS = 0, 2, 4, 6
TANGENTIAL = 6


def contact_codes(
    closed: np.ndarray, held: np.ndarray, backwards: np.ndarray | bool = False
) -> np.ndarray:
    """Return codes (n,) int8 of nodes: closed or open, and held or slipping, ``backwards`` or in the
    direction of the tangent."""
    return (np.where(held, HELD, np.where(backwards, BACKWARDS, SLIPS)) + CLOSED * closed).astype(
        np.int8
    )


def contact_states(codes: np.ndarray, normal_force: np.ndarray) -> np.ndarray:
    """Return the states (n,) int8 of nodes with these codes and the compressive forces p (n,),
    N."""
    state = np.where(codes & TANGENTIAL == HELD, ContactState.STICK, ContactState.SLIP).astype(
        np.int8
    )
    state[(codes & CLOSED == 0) | (normal_force == 0)] = ContactState.OPEN
    return state
