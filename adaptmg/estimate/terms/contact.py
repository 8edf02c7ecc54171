r"""What the discrete contact conditions leave between the nodes of slaves and of boundaries in front of obstacles.

.. math:: \int p_h (g_0 - u_n), \qquad \int (s_h |d_t| + t_h \cdot d_t)

with the linear interpolants of nodal pressures :math:`p_h`, gaps, limits :math:`s_h` of the tangential traction
(:math:`\mu p_h` of Coulomb), slips :math:`d_t` and their sizes. Both vanish where the conditions hold all along an
edge, both are >= 0, and only facets at a transition (and with slip that turns) have a part.

At the nodes themselves the conditions are taken as met: no pressure where a node is OPEN, no gap elsewhere, friction
at its limit against the slip where there is one. What a solver leaves of them is algebraic error; multiplied by a gap,
or by a slip, that is far larger than the deformation it would exceed all that the mesh has left.
"""

from __future__ import annotations

import numpy as np

from adaptmg.discretisation.facets import named_facets
from adaptmg.estimate.fields.posed import Posed
from adaptmg.estimate.terms.boundary import facet_weights
from adaptmg.smoother.state import ContactState as State

__all__ = ["condition_squares"]

#: slips up to this part of the largest displacement are rounding
_STILL = 1e-12


def condition_squares(this: Posed) -> tuple[np.ndarray, np.ndarray]:
    """Squares (n_elements,) from complementarity and from friction, N m."""
    mesh, contact, beside = this.mesh, this.result.contact, this.neighbours
    complementarity, friction = np.zeros(len(mesh.elements)), np.zeros(len(mesh.elements))
    opens = contact.state == State.OPEN
    pressures, gaps = np.where(opens, 0.0, contact.pressure), np.where(opens, np.maximum(contact.gap, 0.0), 0.0)
    limits, tractions = _friction(this, opens)
    slips = np.einsum("nk,nkd->nd", contact.slip, contact.frames[:, 1:])
    for k, name in enumerate(contact.names):
        facets = named_facets(mesh, name)
        mine = np.flatnonzero(contact.boundary == k)
        # a node that carries no condition of this boundary adds nothing: the last entries
        index = np.full(mesh.n_nodes, len(mine))
        index[contact.node[mine]] = np.arange(len(mine))
        pressure, gap, limit, traction, slip = (
            _padded(values[mine])[index[facets]] for values in (pressures, gaps, limits, tractions, slips))
        rule, weights = facet_weights(mesh.points, facets, this.stress.axisymmetric)
        mass = np.einsum("fq,qi,qj->fij", weights, rule, rule)
        open_part = np.einsum("fij,fi,fj->f", mass, pressure, gap)
        slip_part = (np.einsum("fij,fi,fj->f", mass, limit, np.linalg.norm(slip, axis=2))
                     + np.einsum("fij,fid,fjd->f", mass, traction, slip))
        elements = beside.owner[mesh.facet_labels == mesh.boundaries.index(name)]
        complementarity += np.bincount(elements, weights=open_part, minlength=len(complementarity))
        # below zero by rounding
        friction += np.bincount(elements, weights=np.maximum(slip_part, 0.0), minlength=len(friction))
    return complementarity, friction


def _friction(this: Posed, opens: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Limits (n,) of the friction and its tractions (n, dim), Cartesian, which obey the law for the slip, Pa."""
    contact, exchange = this.result.contact, this.discrete.exchange
    fixed, _ = this.discrete.law.bounds(len(contact))
    if exchange is not None:
        fixed = fixed / np.abs(exchange.sigma)
    limit, length = np.where(opens, fixed, contact.limit), np.linalg.norm(contact.slip, axis=1)
    moves = (contact.state != State.STICK) & (length > _STILL * np.abs(this.result.displacement).max(initial=0.0))
    along = np.where(moves[:, None], -contact.slip, contact.force_t)
    size = np.linalg.norm(along, axis=1)
    factor = np.divide(limit, size, out=np.zeros_like(size), where=size > 0)
    factor = np.where(moves, factor, np.minimum(factor, 1.0)) / contact.weights
    return limit / contact.weights, np.einsum("nk,nkd->nd", factor[:, None] * along, contact.frames[:, 1:])


def _padded(values: np.ndarray) -> np.ndarray:
    """With one more entry, zero."""
    return np.concatenate([values, np.zeros((1, *values.shape[1:]))])
