r"""Contact tractions that are known, as work on the bubbles of surface edges: nodal forces over lumped masses.

Contact conditions of slaves are part of the spaces, in which Coulomb's friction does no work; Tresca's does, the part
s / (s + mu p) of the friction. A master's bubble moves for itself, against all of the contact force. Linear in between
nodes.
"""

from __future__ import annotations

import numpy as np

from adaptmg.discretisation.facets import area_vectors, named_facets, shape_integrals
from adaptmg.estimate.goals.view import GoalView

__all__ = ["friction_work", "master_work"]


def friction_work(view: GoalView) -> np.ndarray:
    """Work (n_edges, dim) of the friction that does not depend on pressure on the bubbles of contact surfaces, N."""
    contact, given, mesh = view.contact, view.posed.result.contact, view.posed.mesh
    result = np.zeros((len(view.bubbles.edges), mesh.dim))
    if not contact.fixed_limit.any():
        return result
    share = np.divide(contact.fixed_limit, contact.limit, out=np.zeros_like(contact.limit), where=contact.limit > 0)
    traction = np.zeros((mesh.n_nodes, mesh.dim))
    traction[given.node] = share[:, None] * np.einsum("nk,nkd->nd", given.traction, given.frames[:, 1:])
    for name in given.names:
        facets = named_facets(mesh, name)
        result += view.bubbles.boundary_work(facets, traction[facets])
    return result


def master_work(view: GoalView, reaction: np.ndarray) -> np.ndarray:
    """Work of contact forces on the bubbles of master surfaces.

    Parameters
    ----------
    view : GoalView
    reaction : (n_dofs,) array
        A v - f in the unknowns of the problem, of the solution or of a dual field, N.

    Returns
    -------
    (n_edges, dim) array
        N; zero elsewhere.
    """
    discrete, mesh = view.posed.discrete, view.posed.mesh
    result = np.zeros((len(view.bubbles.edges), mesh.dim))
    if discrete.coupling is None:
        return result
    # what is not of contact: reactions of supports
    forces = np.where(discrete.fixed, 0.0, discrete.coupling.physical_forces(reaction)).reshape(-1, mesh.dim)
    masters = view.posed.problem.masters
    for name in dict.fromkeys(filter(None, masters)):
        facets = named_facets(mesh, name)
        areas = np.linalg.norm(area_vectors(mesh.points, facets), axis=1)
        shares = areas[:, None] * shape_integrals(mesh.points, facets, view.bubbles.axisymmetric)
        mass = np.bincount(facets.ravel(), weights=shares.ravel(), minlength=mesh.n_nodes)
        traction = np.divide(forces, mass[:, None], out=np.zeros_like(forces), where=mass[:, None] > 0)
        result += view.bubbles.boundary_work(facets, traction[facets])
    return result
