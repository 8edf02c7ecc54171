r"""What the discrete contact conditions leave between the nodes of slaves and of boundaries in front of obstacles.

.. math:: \int p_h (g_0 - u_n), \qquad \int (s_h |d_t| + t_h \cdot d_t)

with the linear interpolants of nodal pressures :math:`p_h`, gaps, limits :math:`s_h` of the tangential traction
(:math:`\mu p_h` of Coulomb), slips :math:`d_t` and their sizes. Both vanish where the conditions hold all along an
edge, both are >= 0, and only facets at a transition (and with slip that turns) have a part.
"""

from __future__ import annotations

import numpy as np

from adaptmg.discretisation.facets import named_facets
from adaptmg.estimate.fields.posed import Posed
from adaptmg.estimate.terms.boundary import facet_weights

__all__ = ["condition_squares"]


def condition_squares(this: Posed) -> tuple[np.ndarray, np.ndarray]:
    """Squares (n_elements,) from complementarity and from friction, N m."""
    mesh, contact, beside = this.mesh, this.result.contact, this.neighbours
    complementarity, friction = np.zeros(len(mesh.elements)), np.zeros(len(mesh.elements))
    for k, name in enumerate(contact.names):
        facets = named_facets(mesh, name)
        mine = np.flatnonzero(contact.boundary == k)
        # a node that carries no condition of this boundary adds nothing: the last entries
        index = np.full(mesh.n_nodes, len(mine))
        index[contact.node[mine]] = np.arange(len(mine))
        at = index[facets]
        tangents = contact.frames[mine, 1:]
        slip = _padded(np.einsum("nk,nkd->nd", contact.slip[mine], tangents))[at]
        traction = _padded(np.einsum("nk,nkd->nd", contact.traction[mine], tangents))[at]
        pressure, gap = _padded(contact.pressure[mine])[at], _padded(contact.gap[mine])[at]
        limit = _padded(contact.limit[mine] / contact.weights[mine])[at]
        rule, weights = facet_weights(mesh.points, facets, this.stress.axisymmetric)
        mass = np.einsum("fq,qi,qj->fij", weights, rule, rule)
        open_part = np.einsum("fij,fi,fj->f", mass, pressure, gap)
        slip_part = (np.einsum("fij,fi,fj->f", mass, limit, np.linalg.norm(slip, axis=2))
                     + np.einsum("fij,fid,fjd->f", mass, traction, slip))
        elements = beside.owner[mesh.facet_labels == mesh.boundaries.index(name)]
        # below zero only by what the solver left
        complementarity += np.bincount(elements, weights=np.maximum(open_part, 0.0), minlength=len(complementarity))
        friction += np.bincount(elements, weights=np.maximum(slip_part, 0.0), minlength=len(friction))
    return complementarity, friction


def _padded(values: np.ndarray) -> np.ndarray:
    """With one more entry, zero."""
    return np.concatenate([values, np.zeros((1, *values.shape[1:]))])
