r"""Exchange of slave and master at single nodes, where a support holds a tangential component of the slave.

There the slave cannot slip, but what it faces can. In relative coordinates (:mod:`adaptmg.discrete.coordinates`) the
unknown of such a node j would be its own displacement, which is prescribed, and friction would act on none. So one node
k of those that it faces takes its place: with the slip :math:`v = u_j - \sum_l W_{jl} u_l` the new unknown is
:math:`v/\sigma`, :math:`\sigma = -W_{jk}`, and

.. math:: u_k = \frac{v}{\sigma} + \frac{1}{W_{jk}}\Big(u_j - \sum_{l \ne k} W_{jl}\,u_l\Big),

again a relative displacement with weights of sum 1. Node k then has the contact conditions of j with the normal
reversed, gaps and slips divided and forces multiplied by :math:`|\sigma|`; the node j keeps its displacement as unknown
and its support. Results are converted back: they refer to the slave node.

A node k serves if it is free, follows no other, and no other such j faces it. Without one (edges of 3D bodies whose
nodes lie closer than those of the master, say), and where what is held is not a component, j must do without a
multiplier, and its neighbours take its part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.discrete.contact_nodes import ContactNodes
from adaptmg.discrete.coordinates import NEGLIGIBLE, facing_part
from adaptmg.discrete.inclined import Inclined
from adaptmg.problem.laws import Law

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
        """Return the law itself: it is nodal."""
        return self

    def bounds(self, n_contact: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the limits times the factors, and the friction."""
        limit, friction = self.law.bounds(n_contact)
        return limit * self.factors, friction


def find_carriers(nodes: np.ndarray, weights: sparse.csr_array, fixed: np.ndarray, law: Law,
                  inclined: Inclined | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the contact nodes to be exchanged, and for whom."""
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
    facing = rows[places]
    n_facing = np.bincount(facing.indices[np.abs(facing.data) > 0], minlength=rows.shape[1])
    eligible = (n_facing == 1) & ~fixed.any(axis=1) & (np.diff(sparse.csr_array(weights).indptr) == 0)
    lone = np.empty(0, dtype=np.int64)
    if inclined is not None:
        eligible[inclined.nodes] = False
        either = fixed.any(axis=1)
        either[inclined.nodes] = True
        lone = acts & np.isin(nodes, inclined.nodes)
        lone = np.flatnonzero(lone)[facing_part(rows[lone]) @ either.astype(float) <= NEGLIGIBLE]
    carriers = np.full(len(places), -1)
    for i in range(len(places)):
        columns, values = (part[facing.indptr[i]:facing.indptr[i + 1]] for part in (facing.indices, facing.data))
        possible = eligible[columns] & (values > _WEIGHT)
        if possible.any():
            carriers[i] = columns[np.argmax(np.where(possible, values, 0.0))]
    found = carriers >= 0
    return places[found], carriers[found], np.union1d(places[~found], lone)


def rows_of_carriers(weights: sparse.csr_array, slaves: np.ndarray, carriers: np.ndarray) -> sparse.csr_array:
    """Return the weights (n_nodes, n_nodes) with ``carriers`` in place of ``slaves`` as nodes that follow others."""
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


def exchanged(contact: ContactNodes, weights: sparse.csr_array, fixed: np.ndarray, law: Law,
              inclined: Inclined | None = None) -> tuple[ContactNodes, sparse.csr_array, Law, Exchange | None]:
    """Return contact, weights and law with masters in the place of slave nodes that a support holds tangentially."""
    places, carriers, unmatched = find_carriers(contact.nodes, weights, fixed, law, inclined)
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
