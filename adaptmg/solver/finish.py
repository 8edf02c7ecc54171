"""From a displacement to contact quantities and the true natural residual: every Result passes here."""

from __future__ import annotations

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.smoother.residuals import contact_state, natural_residual, residual
from adaptmg.smoother.system import LocalProblem
from adaptmg.solver.result import ContactResult
from adaptmg.solver.sizes import Sizes, euclidean_norm

__all__ = ["contact_result", "relative_residual"]


def relative_residual(local: LocalProblem, unknowns: np.ndarray) -> float:
    """Natural residual over the largest of load, contact forces and, where displacements are prescribed, reactions.

    Euclidean norms (:mod:`adaptmg.solver.sizes`); 1 if it is all there is.

    Parameters
    ----------
    local : LocalProblem
    unknowns : (n_dofs,) array
        Local components, m.
    """
    vector = natural_residual(local.system, local.contact, local.load, unknowns)
    reactions = residual(local.system, local.load, unknowns).reshape(-1, local.system.dim)[local.system.nodes]
    scale = Sizes(local.discrete, local.frames).forces(unknowns, euclidean_norm(reactions.reshape(-1)))
    size = euclidean_norm(vector)
    return 0.0 if size == 0.0 else size / (scale or size)


def contact_result(local: LocalProblem, unknowns: np.ndarray, solved: np.ndarray) -> ContactResult:
    """Contact quantities at a solution.

    Parameters
    ----------
    local : LocalProblem
    unknowns : (n_dofs,) array
        Local components.
    solved : (n_nodes, dim) array
        Cartesian, m; between bodies in relative coordinates.
    """
    discrete, contact = local.discrete, local.discrete.contact
    u = np.einsum("nij,nj->ni", local.frames, solved[contact.nodes])
    force = -residual(local.system, local.load, unknowns).reshape(-1, discrete.dim)[contact.nodes]
    force_n = np.maximum(-force[:, 0], 0.0)
    reference = np.einsum("nij,nj->ni", local.frames, contact.slip_reference)[:, 1:]
    x = np.full(contact.normals.shape, np.nan) if discrete.coordinates is None else discrete.coordinates[contact.nodes]
    carried = np.einsum("nk,nkd->nd", np.column_stack([-force_n, force[:, 1:]]), local.frames)
    boundary, node, on_masters = _on_followed(discrete, carried)
    return ContactResult(node=contact.nodes, x=x, frames=local.frames, gap=contact.gaps - u[:, 0], u_n=u[:, 0],
                         u_t=u[:, 1:], slip=u[:, 1:] - reference, force_n=force_n, force_t=force[:, 1:],
                         weights=contact.weights, limit=local.contact.limit + local.contact.friction * force_n,
                         state=contact_state(local.system, local.contact, local.load, unknowns),
                         boundary=contact.boundary, names=contact.names, masters=contact.masters, master_node=node,
                         master_force=on_masters, master_boundary=boundary)


def _on_followed(discrete: DiscreteProblem, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What contact forces (n_contact, dim) exert on the nodes that slave nodes follow, -W' times them, by boundary.

    Returns
    -------
    boundary, node : (m,) int arrays
    force : (m, dim) array
        N.
    """
    dim, coupling, contact = discrete.dim, discrete.coupling, discrete.contact
    if coupling is None:
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), np.empty((0, dim))
    rows = coupling.weights[contact.nodes]
    at = np.repeat(np.arange(len(contact)), np.diff(rows.indptr))
    # components of slave nodes that are fixed are not relative
    free = ~coupling.fixed.reshape(-1, dim)[contact.nodes]
    parts = -rows.data[:, None] * (free * forces)[at]
    key, place = np.unique(contact.boundary[at] * discrete.n_nodes + rows.indices, return_inverse=True)
    total = np.column_stack([np.bincount(place, part, minlength=len(key)) for part in parts.T])
    return key // discrete.n_nodes, key % discrete.n_nodes, total
