r"""Contact nodes: normals, lumped boundary masses and gaps of the nodes that may touch an obstacle.

With the area vectors :math:`a_F` of the facets F of the contact boundary at node i,

.. math:: n_i = \sum_F a_F \Big/ \Big|\sum_F a_F\Big|, \qquad w_i = \tfrac1d \sum_F |a_F|,

the area-weighted average normal and the row sum of the boundary mass matrix. A node on two contact boundaries belongs
to the one named first: its normal is averaged, and its obstacle taken, there; facets of the other boundary count in
its mass by the part that faces the same way, :math:`\tfrac1d \max(0, a_F \cdot n_i)`.
"""

from __future__ import annotations

import numpy as np

from adaptmg.discrete import ContactNodes
from adaptmg.discretisation.facets import area_vectors, named_facets
from adaptmg.discretisation.supports import fixed_dofs
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.contact_problem import ContactProblem

__all__ = ["contact_nodes"]

_ROUNDING = 1e-12  # of the body's size: a negative gap below this is rounding, not interference
_SYMMETRY_TILT = np.cos(np.pi / 6)


def contact_nodes(problem: ContactProblem, mesh: MeshArrays, *, slip_reference: np.ndarray | None = None
                  ) -> ContactNodes:
    """Nodes of the contact boundaries, in ascending order.

    Parameters
    ----------
    problem : ContactProblem
    mesh : MeshArrays
    slip_reference : (n_nodes, dim) array, optional
        Displacement of all nodes against which slip is measured (the previous load step), m. Default 0.

    Returns
    -------
    ContactNodes
        Unit normals out of the body, gaps (m), weights (m, in 3D m^2), and the contact boundary of each node.

    Raises
    ------
    ValueError
        If a node lies behind its obstacle without ``allow_interference``, if a support fixes a normal component, if
        normals cancel at a node, or if an obstacle returns arrays of the wrong shape.

    Notes
    -----
    Where a curved contact boundary ends on a plane of symmetry, the normal averaged from one side is off by about
    half the angle of a facet. Components along fixed directions are therefore taken out of averaged normals that are
    within 30 degrees of tangential to them.
    """
    owner = np.full(mesh.n_nodes, -1)
    facets = [named_facets(mesh, contact.boundary) for contact in problem.contact]
    for k in reversed(range(len(facets))):
        owner[facets[k]] = k
    nodes = np.flatnonzero(owner >= 0)
    owner = owner[nodes]
    normals = _averaged_normals(problem, mesh, facets, nodes, owner)
    weights = _lumped_masses(mesh, facets, nodes, owner, normals)

    fixed = fixed_dofs(mesh, problem.supports)[0].reshape(-1, mesh.dim)[nodes]
    normals = _along_symmetry_planes(normals, fixed)
    gaps = np.empty(len(nodes))
    for k, contact in enumerate(problem.contact):
        mine = owner == k
        if mine.any():
            normals[mine], gaps[mine] = _facing(contact.obstacle, contact.boundary, mesh.points[nodes[mine]],
                                                normals[mine])
    gaps[(gaps < 0) & (gaps > -_ROUNDING * np.linalg.norm(np.ptp(mesh.points, axis=0)))] = 0.0
    _check_interference(problem, mesh, nodes, owner, gaps)
    _check_supports(problem, mesh, nodes, owner, fixed & (np.abs(normals) > 1e-8))
    return ContactNodes(nodes=nodes, normals=normals, gaps=gaps, weights=weights,
                        slip_reference=_at_contact(slip_reference, mesh, nodes), boundary=owner,
                        allow_interference=any(contact.allow_interference for contact in problem.contact),
                        names=problem.contact_boundaries)


def _averaged_normals(problem: ContactProblem, mesh: MeshArrays, facets: list[np.ndarray], nodes: np.ndarray,
                      owner: np.ndarray) -> np.ndarray:
    """Unit normals (n_contact, dim) averaged over the facets of the boundary that owns a node."""
    total, measure = np.zeros((mesh.n_nodes, mesh.dim)), np.zeros(mesh.n_nodes)
    for k, mine in enumerate(facets):
        vectors = area_vectors(mesh.points, mine)
        own = np.zeros(mesh.n_nodes, dtype=bool)
        own[nodes[owner == k]] = True
        for corner in mine.T:
            here = own[corner]
            np.add.at(total, corner[here], vectors[here])
            np.add.at(measure, corner[here], np.linalg.norm(vectors[here], axis=1))
    total, measure = total[nodes], measure[nodes]
    lengths = np.linalg.norm(total, axis=1)
    if not (lengths > 1e-8 * measure).all():
        i = int(np.argmin(lengths / measure))
        raise ValueError(f"contact boundary {problem.contact[owner[i]].boundary!r} has no normal at node {nodes[i]} "
                         f"{tuple(mesh.points[nodes[i]].tolist())}: its facets there cancel; split the boundary")
    return total / lengths[:, None]


def _lumped_masses(mesh: MeshArrays, facets: list[np.ndarray], nodes: np.ndarray, owner: np.ndarray,
                   normals: np.ndarray) -> np.ndarray:
    """Boundary masses (n_contact,), m or m^2."""
    index = np.full(mesh.n_nodes, -1)
    index[nodes] = np.arange(len(nodes))
    weights = np.zeros(len(nodes))
    for k, mine in enumerate(facets):
        vectors = area_vectors(mesh.points, mine)
        lengths = np.linalg.norm(vectors, axis=1)
        for corner in index[mine].T:
            facing = np.maximum(0.0, np.sum(vectors * normals[corner], axis=1))
            np.add.at(weights, corner, np.where(owner[corner] == k, lengths, facing) / mesh.dim)
    return weights


def _along_symmetry_planes(normals: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Normals without their components along fixed directions, where these are small."""
    inside = np.where(fixed, 0.0, normals)
    lengths = np.linalg.norm(inside, axis=1)
    tilted = lengths > _SYMMETRY_TILT
    result = normals.copy()
    result[tilted] = inside[tilted] / lengths[tilted, None]
    return result


def _facing(obstacle: object, boundary: str, points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Contact normals and gaps from an obstacle, with their shapes checked."""
    directions, gaps = obstacle.contact(points, normals)
    if np.shape(directions) != points.shape or np.shape(gaps) != (len(points),):
        raise ValueError(f"the obstacle in front of {boundary!r} must return normals {points.shape} and gaps "
                         f"({len(points)},), got {np.shape(directions)} and {np.shape(gaps)}")
    return directions, gaps


def _check_interference(problem: ContactProblem, mesh: MeshArrays, nodes: np.ndarray, owner: np.ndarray,
                        gaps: np.ndarray) -> None:
    for k, contact in enumerate(problem.contact):
        mine = np.flatnonzero(owner == k)
        if contact.allow_interference or not len(mine):
            continue
        deepest = mine[np.argmin(gaps[mine])]
        if gaps[deepest] < 0:
            raise ValueError(f"contact boundary {contact.boundary!r} lies up to {-gaps[deepest]:.6g} m behind its "
                             f"obstacle, at {tuple(mesh.points[nodes[deepest]].tolist())}: move the obstacle, or say "
                             "allow_interference=True for an interference fit")


def _check_supports(problem: ContactProblem, mesh: MeshArrays, nodes: np.ndarray, owner: np.ndarray,
                    clash: np.ndarray) -> None:
    """Raise ValueError if ``clash`` (n_contact, dim), a fixed component with a normal part, holds anywhere."""
    if not clash.any():
        return
    i, d = (int(k[0]) for k in np.nonzero(clash))
    support = next(s for s in problem.supports
                   if s.components(mesh.dim)[d] is not None and nodes[i] in mesh.boundary_nodes(s.boundary))
    raise ValueError(f"the support on {support.boundary!r} fixes {'xyz'[d]}, which has a part normal to contact "
                     f"boundary {problem.contact[owner[i]].boundary!r} at their common node {nodes[i]} "
                     f"{tuple(mesh.points[nodes[i]].tolist())}: contact could never open there; free that component, "
                     "or end one of the boundaries before the other begins")


def _at_contact(slip_reference: np.ndarray | None, mesh: MeshArrays, nodes: np.ndarray) -> np.ndarray | None:
    if slip_reference is None:
        return None
    if np.shape(slip_reference) != mesh.points.shape:
        raise ValueError(f"slip_reference must be a displacement of all nodes, shape {mesh.points.shape}, got "
                         f"{np.shape(slip_reference)}")
    return np.asarray(slip_reference, dtype=np.float64)[nodes]
