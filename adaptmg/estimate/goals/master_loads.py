r"""Tractions of contact on masters, as work on the bubbles of their edges.

The slave's conditions are part of its spaces; a master's bubble moves for itself, against the nodal contact forces F
over the lumped mass of its surface, linear in between.
"""

from __future__ import annotations

import numpy as np

from adaptmg.discretisation.facets import area_vectors, named_facets, shape_integrals
from adaptmg.estimate.goals.view import GoalView

__all__ = ["master_work"]


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
