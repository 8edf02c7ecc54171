r"""In which directions the bubble of an edge may move: its supports, and contact linearised as at the nodes.

On an edge of a contact surface whose ends both touch an error has no part along the normal, and none at all where both
stick; dual directions of a slipping edge are :math:`t + \mu f n`. An edge with one open end counts as open, one with
one slipping end as slipping: of these cells the solution does not know where contact ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.estimate.goals.bubbles.edge_bubbles import EdgeBubbles
from adaptmg.estimate.goals.contact_state import LinearisedContact
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.smoother.state import ContactState as State

__all__ = ["BubbleSpaces", "bubble_spaces"]


@dataclass(frozen=True, eq=False)
class BubbleSpaces:
    """Directions of the bubbles; columns of zeros are directions that do not exist.

    Attributes
    ----------
    trial, test : (n_edges, dim, dim) arrays
        In columns: of errors; of dual fields.
    """

    trial: np.ndarray
    test: np.ndarray

    @property
    def missing(self) -> np.ndarray:
        """Directions (n_edges, dim) that do not exist, bool."""
        return ~self.trial.any(axis=1)


def bubble_spaces(problem: ContactProblem, bubbles: EdgeBubbles, contact: LinearisedContact) -> BubbleSpaces:
    """The directions of all bubbles of a mesh."""
    mesh, dim = bubbles.mesh, bubbles.mesh.dim
    trial = np.broadcast_to(np.eye(dim), (len(bubbles.edges), dim, dim)).copy()
    test = trial.copy()
    place = np.full(mesh.n_nodes, -1)
    place[contact.nodes] = np.arange(len(contact.nodes))
    names = [name for name in problem.contact_boundaries if name]
    surface = np.unique(np.concatenate([bubbles.of_facets(mesh.boundary_facets(name)).ravel() for name in names]))
    ends = place[bubbles.edges[surface]]
    # an end without contact conditions of its own follows the other one
    a, b = np.where(ends[:, 0] < 0, ends[:, 1], ends[:, 0]), np.where(ends[:, 1] < 0, ends[:, 0], ends[:, 1])
    state = contact.state
    closed = (a >= 0) & (state[a] != State.OPEN) & (state[b] != State.OPEN)
    surface, a, b = surface[closed], a[closed], b[closed]
    frames = _frames(contact, a, b)
    stick = (state[a] == State.STICK) & (state[b] == State.STICK)
    normal, tangents = frames[:, 0], np.where(stick[:, None, None], 0.0, frames[:, 1:])
    along = np.einsum("nk,nkd->nd", contact.direction, contact.frames[:, 1:])
    weight = (state == State.SLIP).astype(float)
    mean = (weight[a, None] * along[a] + weight[b, None] * along[b]) / np.maximum(weight[a] + weight[b], 1.0)[:, None]
    share = np.einsum("nd,nkd->nk", mean, tangents)
    trial[surface], test[surface] = 0.0, 0.0
    trial[surface, :, 1:] = tangents.transpose(0, 2, 1)
    test[surface, :, 1:] = (tangents + share[:, :, None] * normal[:, None, :]).transpose(0, 2, 1)
    _hold(problem, bubbles, trial, test)
    return BubbleSpaces(trial, test)


def _frames(contact: LinearisedContact, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Orthonormal frames (n, dim, dim) between those of two contact nodes each."""
    first, second = contact.frames[a], contact.frames[b]
    normal = first[:, 0] + second[:, 0]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    tangent = first[:, 1] - np.sum(first[:, 1] * normal, axis=1, keepdims=True) * normal
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    if normal.shape[1] == 2:
        return np.stack([normal, tangent], axis=1)
    return np.stack([normal, tangent, np.cross(normal, tangent)], axis=1)


def _hold(problem: ContactProblem, bubbles: EdgeBubbles, trial: np.ndarray, test: np.ndarray) -> None:
    """Take out, in place, what supports hold: every direction with a part along a fixed component."""
    for support in problem.supports:
        edges = np.unique(bubbles.of_facets(bubbles.mesh.boundary_facets(support.boundary)))
        for k, value in enumerate(support.components(bubbles.mesh.dim)):
            if value is not None:
                lost = np.abs(trial[edges, k, :]) > 1e-8
                for space in (trial, test):
                    space[edges] = np.where(lost[:, None, :], 0.0, space[edges])
