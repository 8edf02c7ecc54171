r"""Transitions: how much a quantity would change if the contact zones ended one node further or sooner.

What the dual-weighted residuals take as given is the state of every contact node. Releasing a touching node with the
force p, or closing an open one with the gap g, changes a quantity to first order by

.. math:: \frac{p_i\,|\lambda^*_{n,i}|}{a_{nn,i}}, \qquad g_i\,|z_{n,i}|\,a_{nn,i},

and likewise along the tangent at sticking nodes, with the force that is left before they slip, and slipping ones, with
their slip; :math:`\lambda^* = A z - j` is the reaction of the dual field, a the diagonal of the matrix. Only nodes
that have a neighbour in another state count. Both factors fall with the mesh size at the ends of the zones, the product
as other parts of the error do; it is an overestimate (10 to 500 times what the signed estimate missed of the GRECO bar,
50 in the median).
"""

from __future__ import annotations

import numpy as np

from adaptmg.estimate.goals.view import Functional, GoalView
from adaptmg.smoother.state import ContactState as State
from adaptmg.smoother.system import contact_blocks, local_contact

__all__ = ["transition_changes"]


def transition_changes(view: GoalView, functional: Functional, dual: np.ndarray) -> np.ndarray:
    """The change of a quantity, element by element.

    Parameters
    ----------
    view : GoalView
    functional : Functional
    dual : (n_dofs,) array
        Its dual field in the unknowns of the problem.

    Returns
    -------
    (n_elements,) array
        >= 0, in the unit of the quantity; that of a node is shared out evenly among its elements.
    """
    contact, discrete = view.contact, view.posed.discrete
    dim, nodes, state = discrete.dim, contact.nodes, contact.state
    opens, sticks = _beside(view, state == State.OPEN), _beside(view, state == State.STICK)
    touches, slips = _beside(view, state != State.OPEN), _beside(view, state == State.SLIP)
    reaction = contact.local(discrete.matrix @ dual - functional.vector).reshape(-1, dim)[nodes]
    z = contact.local(dual).reshape(-1, dim)[nodes]
    nodal, frames = local_contact(discrete)
    diagonal = np.abs(np.einsum("nii->ni", contact_blocks(discrete, nodal, frames)))
    along, across = diagonal[:, 0], diagonal[:, 1:].max(axis=1)
    gap = np.where(np.isfinite(contact.gap), np.maximum(contact.gap, 0.0), 0.0)
    slack = np.maximum(contact.limit - np.linalg.norm(contact.force[:, 1:], axis=1), 0.0)
    slack = np.where(contact.held.any(axis=1), 0.0, slack)
    parts = [np.where((state != State.OPEN) & opens, np.abs(contact.force[:, 0] * reaction[:, 0]) / along, 0.0),
             np.where((state == State.OPEN) & touches, gap * np.abs(z[:, 0]) * along, 0.0),
             np.where((state == State.STICK) & slips, slack * np.linalg.norm(reaction[:, 1:], axis=1) / across, 0.0),
             np.where((state == State.SLIP) & sticks,
                      np.linalg.norm(contact.slip, axis=1) * np.linalg.norm(z[:, 1:], axis=1) * across, 0.0)]
    mesh, nodal = view.posed.mesh, np.zeros(discrete.n_nodes)
    nodal[nodes] = np.sum(parts, axis=0)
    return (nodal / np.bincount(mesh.elements.ravel(), minlength=len(nodal)))[mesh.elements].sum(axis=1)


def _beside(view: GoalView, chosen: np.ndarray) -> np.ndarray:
    """Contact nodes (n,) with an edge to one of those that are chosen (n,)."""
    contact, mesh = view.contact, view.posed.mesh
    marked = np.zeros(mesh.n_nodes, dtype=bool)
    marked[contact.nodes[chosen]] = True
    place = np.zeros(mesh.n_nodes, dtype=bool)
    place[contact.nodes] = True
    a, b = view.bubbles.edges[place[view.bubbles.edges].all(axis=1)].T
    result = np.zeros(mesh.n_nodes, dtype=bool)
    np.logical_or.at(result, b, marked[a])
    np.logical_or.at(result, a, marked[b])
    return result[contact.nodes]
