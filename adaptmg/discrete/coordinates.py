r"""The systems in which the unknowns of a problem are written, and the changes between them.

====================  ============================================  =====================  =====================
system                values                                        there                  back
====================  ============================================  =====================  =====================
physical              displacement u of the bodies                  ``relative``           ``physical``
relative              w = T^-1 u: matrix and load                   ``from_prescribed``    ``with_prescribed``
from the prescribed   w minus the prescribed values, 0 where fixed  ``rotate``             ``rotate_back``
local                 the same in contact frames                    (the node solves)
====================  ============================================  =====================  =====================

Forces are dual: ``relative_forces``, ``physical_forces``; frames are orthonormal and rotate both
alike.

Relative coordinates make contact between elastic bodies look like contact of one body. A slave node
j faces the combination :math:`\sum_k W_{jk} u_k` of nodes of the other surface (mortar weights,
rows with sum 1), and

.. math:: w = (I - \Pi W)\,u,\qquad u = T w,\qquad T = (I - \Pi W)^{-1} = I + \Pi W + (\Pi W)^2 + \dots

where :math:`\Pi` drops what supports hold of slave nodes. The series ends, as no node follows
itself: two powers where no slave node is a master node, one more for each body that is both (B.
Wohlmuth, Acta Numerica 20, 2011, doi:10.1017/S0962492911000079, for the two-body case). On periodic
sides a contact node takes over images that follow it, and :func:`_inverse` finds T. With
:math:`\hat A = T^T A T,\ \hat b = T^T b` the contact conditions are on the slave nodes alone, and
:math:`\hat A w - \hat b = T^T (A u - b)` is there the contact force on the slave; the master
carries :math:`-W^T` of it, so that the forces balance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, wraps
from typing import ClassVar, TypeVar, cast

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from adaptmg import _checks as checks
from adaptmg.discrete.block_rows import BlockRows
from adaptmg.discrete.contact_nodes import ContactNodes
from adaptmg.discrete.elasticity import nodal_matrix
from adaptmg.discrete.supports import Inclined
from adaptmg.problem.laws import Law, sampled_friction

_MOST_LINKS = 16  # bodies in a row of which each is the slave of the next


@dataclass(frozen=True, eq=False)
class Coupling:
    """The transformation between displacements and relative coordinates."""

    # (n_nodes, n_nodes): W; negative in the columns of nodes whose part a slave node takes over
    weights: sparse.csr_array
    fixed: np.ndarray  # (n_dofs,) bool: fixed dofs; those of slave nodes are not relative
    inclined: Inclined  # further directions that supports hold, likewise
    # (n_nodes, n_nodes): I + W + W^2 + ..., which is T without supports; for nodal prolongations
    upward: sparse.csr_array = field(init=False, repr=False)
    _by_dof: sparse.csr_array = field(init=False, repr=False)  # (n_dofs, n_dofs): I - T^-1 = Pi W
    _series: sparse.csr_array = field(init=False, repr=False)  # (n_dofs, n_dofs): T - I

    def __post_init__(self) -> None:
        """Compute the products with W that the changes of coordinates take."""
        weights = self.weights
        n = self.weights.shape[0]
        dim = len(self.fixed) // n
        # Pi drops the fixed dofs and, by the projections Z, the directions of inclined supports
        projections = nodal_matrix(self.inclined.nodes, self.inclined.spans, n * dim)
        free = sparse.diags_array((~self.fixed).astype(float), format="csr") - projections
        by_dof = sparse.csr_array(free @ sparse.kron(weights, sparse.eye_array(dim), format="csr"))
        by_dof.eliminate_zeros()
        returning = _returning(weights)
        returning_by_dof = None
        if returning is not None:
            by_component = sparse.kron(returning, sparse.eye_array(dim), format="csr")
            returning_by_dof = sparse.csr_array(free @ by_component)
        upward = sparse.csr_array(sparse.eye_array(n, format="csr") + _inverse(weights, returning))
        # the class is frozen: these follow from its fields, and are set once
        object.__setattr__(self, "upward", checks.narrowed(upward))
        object.__setattr__(self, "_by_dof", checks.narrowed(by_dof))
        object.__setattr__(self, "_series", checks.narrowed(_inverse(by_dof, returning_by_dof)))

    @property
    def between_bodies(self) -> bool:
        """Return whether nodes face those of other bodies; without that they only take over shares of
        neighbours."""
        return bool(self.weights.data.max(initial=0.0) > 0)

    @property
    def dim(self) -> int:
        """Return the number of components of a node."""
        return len(self.fixed) // self.weights.shape[0]

    def physical(self, relative: np.ndarray) -> np.ndarray:
        """Return u = T w for values (n_dofs,) or (n_dofs, k); primal."""
        return relative + self._series @ relative

    def relative(self, displacement: np.ndarray) -> np.ndarray:
        """Return w = T^-1 u for values (n_dofs,) or (n_dofs, k); primal."""
        return displacement - self._by_dof @ displacement

    def relative_forces(self, forces: np.ndarray) -> np.ndarray:
        """Return T' f for nodal forces (n_dofs,); dual."""
        return forces + self._series.T @ forces

    def physical_forces(self, forces: np.ndarray) -> np.ndarray:
        """Return T^-T f for forces (n_dofs,) in relative coordinates; dual."""
        return forces - self._by_dof.T @ forces

    def relative_rows(self, rows: sparse.csr_array) -> sparse.csr_array:
        """Return B T for rows (n, n_dofs) that act on displacements."""
        result = sparse.csr_array(rows + rows @ self._series)
        result.sort_indices()
        return checks.narrowed(result)

    def transformed(self, matrix: sparse.bsr_array) -> sparse.bsr_array:
        """Return T' A T in blocks, exactly symmetric, for a symmetric A (n_dofs, n_dofs)."""
        dim = self.dim
        series = sparse.bsr_array(self._series, blocksize=(dim, dim))
        right = sparse.bsr_array(matrix @ series)
        # T'AT - A with T = I + series: A series + (A series)' + series' A series
        change = right + sparse.bsr_array(right.T) + sparse.bsr_array(series.T @ right)
        # the last term is symmetric to rounding only
        symmetric = 0.5 * (change + sparse.bsr_array(change.T))
        return checks.narrowed(
            sparse.bsr_array(matrix + symmetric, blocksize=(dim, dim)).sorted_indices()
        )


def relative_prolongation(
    nodal: sparse.csr_array, fine: Coupling | None, coarse: Coupling | None
) -> sparse.csr_array:
    r"""Return a nodal prolongation P in relative coordinates on both levels, :math:`(I - W_f)\,P\,(I
    - W_c)^{-1}`; P itself without any. It spans the space that P spans: rigid motions of all bodies
    and all else that P reproduces. Without :math:`\Pi`, which differs from component to component of
    a node, as a nodal prolongation cannot."""
    if fine is None and coarse is None:
        return nodal
    inner = nodal if coarse is None else sparse.csr_array(nodal @ coarse.upward)
    result = inner.copy() if fine is None else sparse.csr_array(inner - fine.weights @ inner)
    result.data[np.abs(result.data) < checks.ROUNDING] = 0.0
    result.eliminate_zeros()
    result.sort_indices()
    return checks.narrowed(result)


def _returning(weights: sparse.csr_array) -> sparse.csr_array | None:
    """Return R, the entries of W (n_nodes, n_nodes) by which nodes take over images, which follow them; None
    if there are none."""
    entries = sparse.coo_array(weights)
    follows = np.diff(weights.indptr) > 0
    returns = (entries.data < 0) & follows[entries.col]
    # a node that is taken over may follow others without leading back, as where ties end at contact: entries
    # that do lead back join nodes of one strong component
    if returns.any():
        _, part = connected_components(weights, connection="strong")
        returns &= part[entries.row] == part[entries.col]
    if not returns.any():
        return None
    ends = entries.row[returns], entries.col[returns]
    return sparse.csr_array((entries.data[returns], ends), shape=weights.shape)


def _inverse(step: sparse.csr_array, returning: sparse.csr_array | None) -> sparse.csr_array:
    r"""Return :math:`(I - S)^{-1} - I` for S = W or Pi W, where R, ``returning``, is the part of S that leads back to
    the nodes where it begins. With :math:`F = (I - S + R)^{-1}`, Q = RF and D, the diagonal of Q,

    .. math:: (I - S)^{-1} = F\,(I - Q)^{-1} = F\,\bigl(I - (I - D)^{-1}(Q - D)\bigr)^{-1} (I - D)^{-1},

    and both inverses are series that end."""
    if returning is None:
        return _series(step)
    identity = sparse.eye_array(step.shape[0], format="csr")
    forward = identity + _series(sparse.csr_array(step - returning))
    back = sparse.csr_array(returning @ forward)  # Q
    diagonal = back.diagonal()
    scale = sparse.diags_array(1 / (1 - diagonal), format="csr")
    others = sparse.csr_array(scale @ (back - sparse.diags_array(diagonal)))
    others.eliminate_zeros()
    result = sparse.csr_array(forward @ (identity + _series(others)) @ scale - identity)
    result.eliminate_zeros()
    return result


def _series(step: sparse.csr_array) -> sparse.csr_array:
    """Return step + step^2 + ... until a power vanishes, of W or Pi W; ValueError if none does."""
    total = step
    power = step
    for _ in range(_MOST_LINKS):
        power = sparse.csr_array(power @ step)
        if not power.nnz:
            return sparse.csr_array(total)
        total = total + power
    raise ValueError(
        "weights: nodes follow each other in a circle, each the slave of the next; exchange slave and "
        "master in one of the contact pairs"
    )


def block_diagonal(blocks: np.ndarray) -> sparse.bsr_array:
    """Return the block-diagonal matrix of blocks (n, dim, dim)."""
    n = len(blocks)
    dim = blocks.shape[1]
    return sparse.bsr_array((blocks, np.arange(n), np.arange(n + 1)), shape=(n * dim, n * dim))


def facing_part(rows: sparse.csr_array) -> sparse.csr_array:
    """Return rows of W with its positive entries alone, those of the other body: slave nodes that carry
    no multiplier, and are taken over, have negative ones. Those stay stored, as zeros."""
    result = sparse.csr_array(rows, copy=True)
    result.data = np.maximum(result.data, 0.0)
    return result


def friction_acts(law: Law, n: int) -> np.ndarray:
    """Return at which of n contact nodes (n,) a law lets friction act, in some state at least."""
    limit, _ = law.bounds(n)
    return (np.asarray(limit) > 0) | sampled_friction(law, n).any(axis=0)


def held_slaves(
    nodes: np.ndarray,
    weights: sparse.csr_array,
    fixed: np.ndarray,
    law: Law,
    inclined: Inclined,
) -> np.ndarray:
    """Return the indices among the contact ``nodes`` of those whose slip is not an unknown: friction
    acts at them, and a support holds them along the surface, but not the nodes that they face.
    ``weights`` (n_nodes, n_nodes) and ``fixed`` (n_dofs,) are those of :class:`Coupling`.

    Components that are held are tangential here, as no support holds a normal of a contact node."""
    fixed = fixed.reshape(weights.shape[0], -1)
    facing = facing_part(sparse.csr_array(weights[nodes]))
    rubs = friction_acts(law, len(nodes)) & (facing.sum(axis=1) > 0)
    of_nodes = _spans(nodes, fixed, inclined)
    held = np.flatnonzero(rubs & of_nodes.any(axis=(1, 2)))
    # P is the projection of a node, F the weighted sum of the projections of the nodes that it faces. The
    # least eigenvalue is the least t'Ft of unit vectors t that are held at the node: I - P gives others 1
    P = of_nodes[held]
    faced = np.unique(facing[held].indices)
    of_faced = _spans(faced, fixed, inclined).reshape(len(faced), fixed.shape[1] ** 2)
    F = (facing[held][:, faced] @ of_faced).reshape(P.shape)
    least = np.linalg.eigvalsh(P @ F @ P + np.eye(fixed.shape[1]) - P)[:, 0]
    return held[least <= checks.SIX_DIGITS]


def _spans(nodes: np.ndarray, fixed: np.ndarray, inclined: Inclined) -> np.ndarray:
    """Return the projections (n, dim, dim) onto the directions that supports hold at nodes (n,), from the
    mask ``fixed`` (n_nodes, dim) of axes."""
    return fixed[nodes][:, :, None] * np.eye(fixed.shape[1]) + inclined.at(nodes)


class Computed(dict):
    """Values that functions have computed from a problem, by function and arguments; pickled without them."""

    def __reduce__(self) -> tuple[object, ...]:
        return Computed, ()


Value = TypeVar("Value")
Problem = TypeVar("Problem", bound="Unknowns")


def remembered_of_structure(
    function: Callable[[Problem], Value],
) -> Callable[[Problem], Value]:
    """Make a function compute once for all problems that share matrix, fixed dofs, contact nodes and
    normals: those of ``posing`` of a DiscreteProblem. Load, law, prescribed values and slips must not
    matter to it."""

    @wraps(function)
    def remembering(problem: Problem) -> Value:
        if function not in problem._structure:
            problem._structure[function] = function(problem)
        return problem._structure[function]

    return remembering


class Unknowns:
    """The unknowns of a :class:`~adaptmg.discrete.problem.DiscreteProblem` in each system, there
    and back. A solution is one vector (n_unknowns,): the unknowns of the nodes, then the pressures
    of volumes, which are the same in every system."""

    # these are of DiscreteProblem, which explains them
    rows: BlockRows
    load: np.ndarray
    contact: ContactNodes
    coupling: Coupling | None
    fixed: np.ndarray
    fixed_values: np.ndarray
    inclined: Inclined
    ties: tuple[tuple[str, str, np.ndarray, np.ndarray], ...]
    _structure: ClassVar[Computed]  # of :func:`remembered_of_structure`

    @property
    def held(self) -> np.ndarray:
        """Return the dofs (n_dofs,) bool that supports prescribe: the fixed ones but the relative
        displacements of ties."""
        return self.fixed if self.coupling is None else self.coupling.fixed

    @property
    def between_bodies(self) -> bool:
        """Return whether the unknowns are relative to other bodies."""
        return self.coupling is not None and self.coupling.between_bodies

    @cached_property  # a solve asks for it a hundred times
    def dim(self) -> int:
        """Return the space dimension."""
        return self.contact.dim

    def physical(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the displacement (n_nodes, dim) of unknowns (n_dofs,) or (n_nodes, dim), m: these
        if uncoupled."""
        flat = np.asarray(unknowns, dtype=np.float64).reshape(-1)
        return (flat if self.coupling is None else self.coupling.physical(flat)).reshape(
            -1, self.dim
        )

    def relative(self, displacement: np.ndarray) -> np.ndarray:
        """Return the unknowns (n_nodes, dim) of a displacement, m: the inverse of
        :meth:`physical`."""
        flat = np.asarray(displacement, dtype=np.float64).reshape(-1)
        return (flat if self.coupling is None else self.coupling.relative(flat)).reshape(
            -1, self.dim
        )

    def physical_forces(self, forces: np.ndarray) -> np.ndarray:
        """Return the nodal forces (n_dofs,) on the bodies from those that belong to the unknowns,
        N; dual."""
        return forces if self.coupling is None else self.coupling.physical_forces(forces)

    def relative_forces(self, forces: np.ndarray) -> np.ndarray:
        """Return the inverse of :meth:`physical_forces`."""
        return forces if self.coupling is None else self.coupling.relative_forces(forces)

    def parts(self, solution: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the unknowns of the nodes (n_dofs,) and the pressures (n_groups,) of a
        solution, not copied."""
        return solution[: len(self.fixed)], solution[len(self.fixed) :]

    def held_spans(self, nodes: np.ndarray) -> np.ndarray:
        """Return the projections (n, dim, dim) onto the directions along which supports hold
        nodes."""
        return _spans(nodes, self.held.reshape(-1, self.dim), self.inclined)

    def free_spans(self, nodes: np.ndarray) -> np.ndarray:
        """Return the projections (n, dim, dim) onto the directions along which neither supports nor ties
        hold nodes."""
        # a tied node, all of whose dofs are fixed, may be one of the inclined nodes
        free = ~self.fixed.reshape(-1, self.dim)[nodes]
        return free[:, :, None] * (np.eye(self.dim) - self.inclined.at(nodes))

    @remembered_of_structure
    def fixed_nodes(self) -> np.ndarray:
        """Return the nodes (n,) that supports or ties hold along any direction, ascending."""
        # 0.1 ms for 263k nodes, by any(axis=1) 3.3 ms
        return np.union1d(np.flatnonzero(self.fixed) // self.dim, self.inclined.nodes)

    def free_part(self, vector: np.ndarray) -> np.ndarray:
        """Return a vector (n_dofs,) or (n_nodes, dim) without its parts along fixed dofs and along
        what inclined supports hold; flat."""
        result = np.where(self.fixed, 0.0, vector.reshape(-1))
        self.inclined.remove_held(result)
        return result

    def supported_part(self, vectors: np.ndarray) -> np.ndarray:
        """Return the parts of vectors (n_nodes, dim) along the directions that supports hold; without
        those along jumps of ties."""
        result = np.where(self.held.reshape(vectors.shape), vectors, 0.0)
        result[self.inclined.nodes] += self.inclined.along(vectors)
        return result

    def from_prescribed(self, solution: np.ndarray) -> np.ndarray:
        """Return unknowns (n_dofs,) or (n_nodes, dim), m, or a solution (n_unknowns,), minus the
        prescribed values, zero along what is held; flat."""
        result = np.array(solution, dtype=np.float64).reshape(-1)
        unknowns, _ = self.parts(result)
        # in place: with 263k nodes .26 ms a call, by free_part 3.5
        unknowns -= self.fixed_values
        np.copyto(unknowns, 0.0, where=self.fixed)
        self.inclined.remove_held(unknowns)
        return result

    def with_prescribed(self, change: np.ndarray) -> np.ndarray:
        """Return the inverse of :meth:`from_prescribed` of a flat ``change``."""
        result = change.copy()
        unknowns, _ = self.parts(result)
        unknowns += self.fixed_values
        return result

    def load_from_prescribed(self) -> np.ndarray:
        """Return the load b - A u_fixed (n_dofs,), N, of unknowns from the prescribed values, zero
        along held directions; see :meth:`from_prescribed`."""
        load = self.load
        if self.fixed_values.any():
            load = load - self.rows.times(self.fixed_values)
        return self.free_part(load)

    def at_contact(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the displacement (n_contact, dim) of the contact nodes relative to the nodes that they
        face, m, of unknowns (n_dofs,) or (n_nodes, dim). Unknowns are that already, except components that
        supports prescribe; if these are prescribed on both sides, they are relative to the prescribed
        nodes of the other side."""
        nodal = np.asarray(unknowns, dtype=np.float64).reshape(-1, self.dim)
        nodes = self.contact.nodes
        result = nodal[nodes]
        if self.coupling is None:
            return result
        spans = self.held_spans(nodes)
        # along what is held unknowns are not relative
        result -= np.einsum("nij,nj->ni", spans, result)
        return result + np.einsum("nij,nj->ni", spans, self.apart(self.physical(nodal)))

    def apart(self, displacement: np.ndarray) -> np.ndarray:
        """Return :meth:`at_contact` of a displacement u (n_nodes, dim) of the bodies, m: u_j - (W u)_j,
        with two corrections along directions that supports hold.

        W has negative entries W^- in the columns of nodes whose part node j takes over. Along the
        directions that supports hold at j (projection P_j) these nodes count only with what supports
        prescribe for them: P_j (W^- u_free)_j is added, with the free part of u. Along tangents that
        supports hold at j and at nodes that it faces, u_j counts relative to these nodes alone."""
        nodes = self.contact.nodes
        result = displacement[nodes]
        if self.coupling is None:
            return result
        weights = self.coupling.weights[nodes]
        result -= weights @ displacement
        free = np.where(self.held, 0.0, displacement.reshape(-1))
        self.inclined.remove_held(free)
        negative_weights = weights - facing_part(weights)
        free_of_taken_over = negative_weights @ free.reshape(displacement.shape)
        result += np.einsum("nij,nj->ni", self.held_spans(nodes), free_of_taken_over)
        for slaves, held_weights, tangents in self.held_together():
            relative = displacement[nodes[slaves]] - held_weights @ displacement
            change = np.einsum("nd,nd->n", tangents, relative - result[slaves])
            result[slaves] += change[:, None] * tangents
        return result

    @remembered_of_structure
    def held_together(self) -> list[tuple[np.ndarray, sparse.csr_array, np.ndarray]]:
        """Return for the first, and in 3D the second tangent the slave nodes that supports hold along
        it and that face master nodes held along it too.

        An entry has the indices (k,) of these slave nodes among the contact nodes, the weights (k,
        n_nodes) of such master nodes, scaled to row sums 1, and the tangents (k, dim)."""
        nodes = self.contact.nodes
        facing = facing_part(cast("Coupling", self.coupling).weights[nodes])
        result = []
        for tangents in self._held_tangents(facing).swapaxes(0, 1):
            held = np.flatnonzero(self._held_along(nodes, tangents))
            weights = sparse.coo_array(facing[held])
            weights.data *= self._held_along(weights.col, tangents[held][weights.row])
            weights = sparse.csr_array(weights)
            weight_sums = np.asarray(weights.sum(axis=1)).ravel()
            carried = weight_sums > checks.SIX_DIGITS
            # without master nodes that are held there is nothing to be relative to
            scale = sparse.diags_array(1 / weight_sums[carried], format="csr")
            slaves = held[carried]
            result.append((slaves, sparse.csr_array(scale @ weights[carried]), tangents[slaves]))
        return result

    def _held_tangents(self, facing: sparse.csr_array) -> np.ndarray:
        """Return tangents (n_contact, dim - 1, dim) of contact nodes, which face others by the weights
        ``facing`` (n_contact, n_nodes).

        They are those of the frames, except where supports hold a node along all tangents, so that its
        frame is arbitrary. If they hold a node that it faces along a single tangent direction, this
        is the first tangent."""
        frames = frames_of(self)
        tangents = frames[:, 1:]
        if self.dim < 3:
            return tangents
        nodes = self.contact.nodes
        is_clamped = self._held_along(nodes, frames[:, 1]) & self._held_along(nodes, frames[:, 2])
        for i in np.flatnonzero(is_clamped):
            to_tangents = tangents[i].T @ tangents[i]  # the projection onto the tangent plane
            spans = to_tangents @ self.held_spans(facing[[i]].indices) @ to_tangents
            along_one = np.abs(np.einsum("nii->n", spans) - 1) < checks.SIX_DIGITS
            if along_one.any():
                # a projection onto one direction: the eigenvector of its largest eigenvalue, 1
                first = np.linalg.eigh(spans[np.argmax(along_one)])[1][:, -1]
                tangents[i] = first, np.cross(frames[i, 0], first)
        return tangents

    def _held_along(self, nodes: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return whether (n,) supports hold nodes (n,) along unit vectors (n, dim)."""
        spans = self.held_spans(nodes)
        return np.einsum("ni,nij,nj->n", directions, spans, directions) > 1 - checks.SIX_DIGITS


def frames_of(problem: Unknowns) -> np.ndarray:
    """Return orthonormal frames (n_contact, dim, dim) at contact nodes: normal, then tangents.

    In space a tangent direction that supports hold becomes the first tangent, so that solvers can fix
    it as one local component."""
    contact = problem.contact
    normals = contact.normals
    frames = np.empty((len(normals), contact.dim, contact.dim))
    frames[:, 0] = normals
    if contact.dim == 1:
        return frames
    if contact.dim == 2:  # the tangent is the normal, turned by +90 degrees
        frames[:, 1, 0] = -normals[:, 1]
        frames[:, 1, 1] = normals[:, 0]
        return frames
    # the Cartesian axis nearest the tangent plane, or the held direction, projected into the plane
    axis = np.eye(3)[np.argmin(np.abs(normals), axis=1)]
    spans = problem.held_spans(contact.nodes)
    held = np.flatnonzero(spans.any(axis=(1, 2)))
    # column d of a projection is what is held of axis d; the squared length of this is its entry (d, d)
    longest = np.argmax(np.einsum("nii->ni", spans[held]), axis=1)
    axis[held] = spans[held, :, longest]
    t1 = axis - np.sum(axis * normals, axis=1)[:, None] * normals
    t1 /= np.linalg.norm(t1, axis=1)[:, None]
    frames[:, 1] = t1
    frames[:, 2] = np.cross(normals, t1)
    return frames


def to_frames(frames: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    """Return local components (n, dim) of Cartesian vectors (n, dim) at contact nodes with frames
    (n, dim, dim)."""
    return np.einsum("nij,nj->ni", frames, vectors)


def from_frames(frames: np.ndarray, local: np.ndarray) -> np.ndarray:
    """Return the inverse of :func:`to_frames` for ``local`` components (n, k); with k rows of frames, say
    ``frames[:, 1:]``, of those components."""
    return np.einsum("nk,nkd->nd", local, frames)


def rotate(vector: np.ndarray, frames: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return a copy of a vector (n_dofs,) with ``frames`` (n_contact, dim, dim) applied at the ``nodes``
    with these numbers (n_contact,)."""
    dim = frames.shape[1]
    result = np.array(vector, dtype=np.float64).reshape(-1, dim)
    result[nodes] = to_frames(frames, result[nodes])
    return result.reshape(-1)


def rotate_back(vector: np.ndarray, frames: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """Return the inverse of :func:`rotate`."""
    return rotate(vector, np.swapaxes(frames, 1, 2), nodes)
