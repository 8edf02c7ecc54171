r"""Coupling: relative coordinates, in which contact between elastic bodies looks like contact of one body.

A slave node j faces the combination :math:`\sum_k W_{jk} u_k` of the nodes of the other surface (mortar weights, rows
with sum 1). In place of its displacement the unknown is the displacement relative to that,

.. math:: w = (I - \Pi W)\,u,\qquad u = T w,\qquad T = (I - \Pi W)^{-1} = I + \Pi W + (\Pi W)^2 + \dots

where :math:`\Pi` drops the fixed components of slave nodes. The series ends, as no node follows itself: two powers
where no slave node is a master node, one more for each body that is both (B. Wohlmuth, Acta Numerica 20, 2011,
doi:10.1017/S0962492911000079, for the two-body case). With :math:`\hat A = T^T A T,\ \hat b = T^T b` the conditions of
contact are on the slave nodes alone, and :math:`\hat A w - \hat b = T^T (A u - b)` is there the contact force on the
slave; the master carries :math:`-W^T` of it, so that the forces balance.

Exchange of slave and master at single nodes, where a support holds a tangential component of the slave.

There the slave cannot slip, but what it faces can. In the coordinates of :mod:`adaptmg.discrete.coordinates` the
unknown of such a
node j would be its own displacement, which is given, and friction would act on none. So one node k of those that it
faces takes its place: with the slip :math:`v = u_j - \sum_l W_{jl} u_l` the new unknown is :math:`v/\sigma`,
:math:`\sigma = -W_{jk}`, and

.. math:: u_k = \frac{v}{\sigma} + \frac{1}{W_{jk}}\Big(u_j - \sum_{l \ne k} W_{jl}\,u_l\Big),

again a relative displacement with weights of sum 1. Node k then has the contact conditions of j with the normal turned
round, gaps and slips divided and forces multiplied by :math:`|\sigma|`; the node j keeps its displacement as unknown
and its support. Results are turned back: they speak of the slave node.

A node k serves if it is free, follows no other, and no other such j faces it. Without one (edges of 3D bodies whose
nodes lie closer than those of the master, say) j must do without a multiplier, and its neighbours take its part.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from adaptmg import _check_arrays as check_arrays
from adaptmg._check_arrays import narrowed
from adaptmg.discrete.contact_nodes import ContactNodes
from adaptmg.problem.laws import Law

__all__ = [
    "NEGLIGIBLE",
    "Coupling",
    "Exchange",
    "ScaledLaw",
    "exchanged",
    "facing_part",
    "find_carriers",
    "rows_of_carriers",
]

_ROUNDING = 1e-13
_MOST_LINKS = 16  # bodies in a row of which each is the slave of the next


@dataclass(frozen=True, eq=False)
class Coupling:
    """The transformation between displacements and relative coordinates."""

    weights: sparse.csr_array  # (n_nodes, n_nodes) sparse
    fixed: np.ndarray  # (n_dofs,) bool: fixed dofs; those of slave nodes are not relative
    upward: sparse.csr_array = field(init=False, repr=False)  # (n_nodes, n_nodes) csr_array
    _by_dof: sparse.csr_array = field(init=False, repr=False)
    _series: sparse.csr_array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        weights = sparse.csr_array(check_arrays.sparse_matrix("weights", self.weights), dtype=np.float64)
        fixed = np.asarray(self.fixed)
        n = weights.shape[0]
        if weights.shape != (n, n) or fixed.dtype != bool or fixed.ndim != 1 or n == 0 or len(fixed) not in (2 * n,
                                                                                                            3 * n):
            raise ValueError(f"weights must be square with a row a node and fixed a boolean mask over their dofs, got "
                             f"{weights.shape} and {fixed.dtype} {fixed.shape}")
        followers = np.flatnonzero(np.diff(weights.indptr))
        sums = np.asarray(weights.sum(axis=1)).ravel()[followers]
        if not np.abs(sums - 1).max(initial=0.0) <= 1e-8:
            i = int(np.argmax(np.abs(sums - 1)))
            raise ValueError(f"weights must have rows with sum 1, got {sums[i]:.6g} at node {followers[i]}")
        dim = len(fixed) // n
        by_dof = sparse.csr_array(sparse.diags_array((~fixed).astype(float))
                                  @ sparse.kron(weights, sparse.eye_array(dim), format="csr"))
        by_dof.eliminate_zeros()
        object.__setattr__(self, "weights", weights)
        object.__setattr__(self, "fixed", fixed)
        upward = sparse.csr_array(sparse.eye_array(n, format="csr") + _series(weights))
        object.__setattr__(self, "upward", narrowed(upward))
        object.__setattr__(self, "_by_dof", narrowed(by_dof))
        object.__setattr__(self, "_series", narrowed(_series(by_dof)))

    @property
    def dim(self) -> int:
        """Components a node."""
        return len(self.fixed) // self.weights.shape[0]

    def physical(self, relative: np.ndarray) -> np.ndarray:
        """u = T w for values (n_dofs,) or (n_dofs, k); primal."""
        return relative + self._series @ relative

    def relative(self, displacement: np.ndarray) -> np.ndarray:
        """w = T^-1 u for values (n_dofs,) or (n_dofs, k); primal."""
        return displacement - self._by_dof @ displacement

    def relative_forces(self, forces: np.ndarray) -> np.ndarray:
        """T' f for nodal forces (n_dofs,); dual."""
        return forces + self._series.T @ forces

    def physical_forces(self, forces: np.ndarray) -> np.ndarray:
        """T^-T f for forces (n_dofs,) in relative coordinates; dual."""
        return forces - self._by_dof.T @ forces

    def transformed(self, matrix: sparse.bsr_array) -> sparse.bsr_array:
        """T' A T in blocks, exactly symmetric, for a symmetric A (n_dofs, n_dofs)."""
        dim = self.dim
        series = sparse.bsr_array(self._series, blocksize=(dim, dim))
        right = sparse.bsr_array(matrix @ series)
        change = right + sparse.bsr_array(right.T) + sparse.bsr_array(series.T @ right)
        change = 0.5 * (change + sparse.bsr_array(change.T))
        return narrowed(sparse.bsr_array(matrix + change, blocksize=(dim, dim)).sorted_indices())

    def prolongation(self, nodal: sparse.csr_array, coarse: Coupling) -> sparse.csr_array:
        r"""A nodal prolongation P in relative coordinates on both levels, :math:`(I - W_f)\,P\,(I - W_c)^{-1}`.

        It spans the space that P spans: rigid motions of both bodies and all else that P reproduces.
        """
        inner = sparse.csr_array(nodal @ coarse.upward)
        result = sparse.csr_array(inner - self.weights @ inner)
        result.data[np.abs(result.data) < _ROUNDING] = 0.0
        result.eliminate_zeros()
        result.sort_indices()
        return narrowed(result)


def _series(step: sparse.csr_array) -> sparse.csr_array:
    """step + step^2 + ... until it ends."""
    total, power = step, step
    for _ in range(_MOST_LINKS):
        power = sparse.csr_array(power @ step)
        if not power.nnz:
            return sparse.csr_array(total)
        total = total + power
    raise ValueError("weights: nodes follow each other in a circle, each the slave of the next; exchange slave and "
                     "master in one of the contact pairs")


#: the largest weight that counts as none
NEGLIGIBLE = 1e-6
#: the least weight of a node that takes the place of another
_WEIGHT = 0.05


@dataclass(frozen=True, eq=False)
class Exchange:
    """How contact was posed, before nodes were exchanged."""

    contact: ContactNodes  # with the slave nodes 
    weights: sparse.csr_array  # (n_contact, n_nodes) csr_array: what they face
    sigma: np.ndarray  # (n_contact,)


@dataclass(frozen=True, eq=False)
class ScaledLaw:
    """A nodal law whose limits are multiplied by ``factors`` (n_contact,)."""

    law: Law
    factors: np.ndarray

    def at_nodes(self, points: np.ndarray, weights: np.ndarray) -> ScaledLaw:
        """Itself: it is nodal."""
        return self

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        """Limits times the factors; friction."""
        limit, friction = self.law.bounds(n_contact)
        return limit * self.factors, friction


def facing_part(rows: sparse.csr_array) -> sparse.csr_array:
    """The positive entries of weights: those of the other body, not of slave nodes that carry no multiplier."""
    result = sparse.csr_array(rows, copy=True)
    result.data = np.maximum(result.data, 0.0)
    return result


def find_carriers(nodes: np.ndarray, weights: sparse.csr_array, fixed: np.ndarray, law: Law
                  ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The contact nodes to be exchanged, and for whom."""
    dim = len(fixed) // weights.shape[0]
    fixed = fixed.reshape(-1, dim)
    limit, friction = law.bounds(len(nodes))
    rows = sparse.csr_array(weights[nodes])
    acts = ((np.asarray(limit) > 0) | (np.asarray(friction) > 0)) & (np.diff(rows.indptr) > 0)
    held = np.flatnonzero(acts & fixed[nodes].any(axis=1))
    # where the other body is held likewise the supports say what slips
    alike = facing_part(rows[held]) @ fixed.astype(float)
    slips = fixed[nodes[held]] & (alike <= NEGLIGIBLE)
    places = held[slips.any(axis=1)]
    mine = rows[places]
    wanted = np.bincount(mine.indices[np.abs(mine.data) > 0], minlength=rows.shape[1])
    able = (wanted == 1) & ~fixed.any(axis=1) & (np.diff(sparse.csr_array(weights).indptr) == 0)
    carriers = np.full(len(places), -1)
    for i in range(len(places)):
        columns, values = (part[mine.indptr[i]:mine.indptr[i + 1]] for part in (mine.indices, mine.data))
        good = able[columns] & (values > _WEIGHT)
        if good.any():
            carriers[i] = columns[np.argmax(np.where(good, values, 0.0))]
    found = carriers >= 0
    return places[found], carriers[found], places[~found]


def rows_of_carriers(weights: sparse.csr_array, slaves: np.ndarray, carriers: np.ndarray) -> sparse.csr_array:
    """The weights (n_nodes, n_nodes) with ``carriers`` in place of ``slaves`` as the nodes that follow others."""
    n = weights.shape[0]
    old = sparse.csr_array(weights[slaves])
    at = np.repeat(np.arange(len(slaves)), np.diff(old.indptr))
    own = old.indices == carriers[at]
    factor = np.zeros(len(slaves))
    factor[at[own]] = 1 / old.data[own]
    kept = np.ones(n)
    kept[slaves] = 0.0
    rows = np.concatenate([carriers[at[~own]], carriers])
    columns = np.concatenate([old.indices[~own], slaves])
    values = np.concatenate([-(old.data * factor[at])[~own], factor])
    new = sparse.csr_array((values, (rows, columns)), shape=(n, n))
    return sparse.csr_array(sparse.diags_array(kept, format="csr") @ weights + new)


def exchanged(contact: ContactNodes, weights: sparse.csr_array, fixed: np.ndarray, law: Law
               ) -> tuple[ContactNodes, sparse.csr_array, Law, Exchange | None]:
    """Contact, weights and law with masters in the place of slave nodes that a support holds tangentially."""
    weights = sparse.csr_array(weights, dtype=np.float64)
    places, carriers, unmatched = find_carriers(contact.nodes, weights, fixed, law)
    if len(unmatched):
        raise ValueError(f"contact: slave node {contact.nodes[unmatched[0]]} has a supported tangential component, and "
                         "no node that it faces can take its place (each belongs to another one, too): exchange slave "
                         "and master, or leave the node out and let its neighbours take its part")
    if not len(places):
        return contact, weights, law, None
    slaves = contact.nodes[places]
    sigma = np.ones(len(contact))
    sigma[places] = -weights[slaves, carriers]
    posed = Exchange(contact, sparse.csr_array(weights[contact.nodes]), sigma)
    nodes, boundary, pairs = contact.nodes.copy(), contact.boundary.copy(), len(contact.names)
    nodes[places] = carriers
    boundary[places] += pairs
    masters = tuple(master or name for name, master in zip(contact.names, contact.masters, strict=True))
    size = np.abs(sigma)
    turned = ContactNodes(nodes=nodes, normals=contact.normals * np.sign(sigma)[:, None], gaps=contact.gaps / size,
                          weights=contact.weights * size, slip_reference=contact.slip_reference / sigma[:, None],
                          allow_interference=contact.allow_interference, boundary=boundary,
                          names=(*contact.names, *masters), masters=(*contact.masters, *contact.names))
    return turned, rows_of_carriers(weights, slaves, carriers), ScaledLaw(law, size), posed
