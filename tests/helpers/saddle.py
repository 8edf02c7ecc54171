"""The untransformed system of a problem of several bodies, in Cartesian components: shares nothing
with the solvers."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

import adaptmg as am


@dataclass
class Parts:
    matrix: sparse.csr_array
    load: np.ndarray
    fixed: np.ndarray
    fixed_values: np.ndarray
    contact: object
    weights: sparse.csr_array
    law: object
    axisymmetric: bool

    @classmethod
    def of(cls, problem, mesh, slip_reference=None):
        discrete = am.discretise(problem, mesh, slip_reference=slip_reference)
        contact, n = discrete.contact, mesh.n_nodes
        weights = sparse.csr_array((n, n))
        if discrete.coupling is not None:
            rows = discrete.coupling.weights[contact.nodes]
            place = sparse.csr_array(
                (np.ones(len(contact)), (contact.nodes, np.arange(len(contact)))),
                shape=(n, len(contact)),
            )
            weights = sparse.csr_array(place @ rows)
        return cls(
            sparse.csr_array(am.discrete.stiffness(mesh, problem.material)),
            am.discrete.load_vector(mesh, problem.loads, problem.material),
            *am.discrete.fixed_dofs(mesh, problem.supports),
            contact,
            weights,
            problem.law.at_nodes(mesh.points[contact.nodes], contact.weights),
            problem.axisymmetric,
        )


def held_alike(parts):
    """(n, dim): fixed components of contact nodes that face fixed ones, or an obstacle."""
    nodes, dim = parts.contact.nodes, parts.contact.dim
    fixed = parts.fixed.reshape(-1, dim)
    alike = parts.weights[nodes].maximum(0.0) @ fixed.astype(float)
    return fixed[nodes] & ((alike > 1e-6) | (np.diff(parts.weights.indptr)[nodes] == 0)[:, None])
