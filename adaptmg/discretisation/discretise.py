"""From what is posed to what is solved: ContactProblem + mesh -> DiscreteProblem."""

from __future__ import annotations

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.discretisation.contact_nodes import contact_nodes
from adaptmg.discretisation.elasticity import stiffness
from adaptmg.discretisation.loads import load_vector
from adaptmg.discretisation.supports import fixed_dofs
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.contact_problem import ContactProblem

__all__ = ["discretise"]


def discretise(problem: ContactProblem, mesh: MeshArrays, *, slip_reference: np.ndarray | None = None
               ) -> DiscreteProblem:
    """Discretise by P1 elements.

    Parameters
    ----------
    problem : ContactProblem
    mesh : MeshArrays
        With every boundary the problem names.
    slip_reference : (n_nodes, dim) array, optional
        Displacement against which slip is measured (the previous load step), m. Default 0.

    Returns
    -------
    DiscreteProblem
        Its law has nodal parameters; its name is the problem's with the number of nodes.

    Raises
    ------
    ValueError
        If dimensions or boundary names differ, if the mesh has fewer than dim + 1 contact nodes, or for what
        :func:`contact_nodes`, :func:`fixed_dofs` and :func:`load_vector` refuse.
    """
    if not isinstance(problem, ContactProblem):
        raise TypeError(f"problem must be a ContactProblem, got {type(problem).__name__}")
    if not isinstance(mesh, MeshArrays):
        raise TypeError(f"mesh must be MeshArrays, got {type(mesh).__name__}")
    if mesh.dim != problem.dim:
        raise ValueError(f"the mesh is {mesh.dim}D, the problem {problem.name!r} {problem.dim}D")
    problem.check_boundaries(mesh.boundaries)
    contact = contact_nodes(problem, mesh, slip_reference=slip_reference)
    if len(contact) <= mesh.dim:
        raise ValueError(f"mesh too coarse: {len(contact)} contact nodes on {', '.join(problem.contact_boundaries)}, "
                         f"at least {mesh.dim + 1} are needed; refine the mesh there")
    fixed, values = fixed_dofs(mesh, problem.supports)
    load = load_vector(mesh, problem.loads)
    law = problem.law.at_nodes(mesh.points[contact.nodes], contact.weights)
    return DiscreteProblem(matrix=stiffness(mesh, problem.material), load=load, fixed=fixed, fixed_values=values,
                           law=law, contact=contact, coordinates=mesh.points,
                           name=f"{problem.name}, {mesh.n_nodes} nodes")
