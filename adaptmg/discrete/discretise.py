"""From what is posed to what is solved: ContactProblem + mesh -> DiscreteProblem.

Bodies that touch each other are coupled by relative coordinates (:mod:`adaptmg.discrete.coordinates`).
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import partial

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._runtime import OnDemand, one_blas_thread
from adaptmg.discrete.contact import contact_data
from adaptmg.discrete.contact_nodes import check_bounds, check_size
from adaptmg.discrete.elasticity import body_materials
from adaptmg.discrete.exchange import ScaledLaw, find_carriers
from adaptmg.discrete.facets import fixed_dofs, supported_nodes
from adaptmg.discrete.loads import load_vector
from adaptmg.discrete.problem import ContactNodes, DiscreteProblem
from adaptmg.discrete.rigid_modes import rigid_motions
from adaptmg.discrete.springs import supported_stiffness
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.contact_problem import ContactProblem

_LOG = logging.getLogger(__name__)


@one_blas_thread()
def discretise(problem: ContactProblem, mesh: MeshArrays, *, slip_reference: np.ndarray | None = None
               ) -> DiscreteProblem:
    """Discretise by P1 elements on a mesh with every boundary that the problem names.

    Parameters
    ----------
    problem : ContactProblem
    mesh : MeshArrays
    slip_reference : (n_nodes, dim) array, optional
        Displacement against which slip is measured (the previous load step), m; at slave nodes relative to the
        master. Default 0.

    Returns
    -------
    DiscreteProblem
        Its law has nodal parameters; its name is the problem's with the number of nodes.

    Raises
    ------
    ValueError
        If dimensions, boundary or body names differ, if a body has neither support nor contact, if the mesh has fewer
        than dim + 1 contact nodes, or loads and supports do not fit it.

    Examples
    --------
    >>> problem = am.cases.greco_bar()
    >>> discrete = am.discretise(problem, am.mesh.structured(problem.domain, 4))
    >>> discrete.matrix.shape
    (50, 50)
    """
    checks.instance("problem", problem, ContactProblem, "a ContactProblem")
    checks.instance("mesh", mesh, MeshArrays, "MeshArrays")
    if mesh.dim != problem.dim:
        raise ValueError(f"the mesh is {mesh.dim}D, the problem {problem.name!r} {problem.dim}D")
    problem.check_boundaries(mesh.boundaries)
    problem.check_bodies(mesh.bodies)
    bodies = _bodies(mesh)
    _check_held(problem, mesh, bodies)
    fixed, values = fixed_dofs(mesh, problem.supports)
    contact, weights = _contact(problem, mesh, slip_reference, fixed)
    if len(contact) <= mesh.dim:
        raise ValueError(f"mesh too coarse: {len(contact)} contact nodes on {', '.join(problem.contact_boundaries)}, "
                         f"at least {mesh.dim + 1} are needed; refine the mesh there")
    materials = body_materials(mesh, problem.material)
    parts = {"matrix": supported_stiffness(mesh, materials, problem.supports),
             "load": load_vector(mesh, problem.loads, materials),
             "fixed": fixed, "fixed_values": values, "contact": contact, "coordinates": mesh.points, "bodies": bodies,
             "law": problem.law.at_nodes(mesh.points[contact.nodes], contact.weights),
             "near_nullspace": OnDemand(partial(_motions, mesh, problem.axisymmetric)),
             "name": f"{problem.name}, {mesh.n_nodes} nodes"}
    if weights is None:
        return DiscreteProblem.assembled(**parts)
    return DiscreteProblem.coupled(**parts, weights=weights)


def rediscretise(problem: ContactProblem, before: ContactProblem, mesh: MeshArrays, old: DiscreteProblem
                 ) -> DiscreteProblem:
    """As :func:`discretise`; ``old``, that of the problem ``before``, gives what only loads and law leave unchanged."""
    posed = old.contact if old.exchange is None else old.exchange.contact
    parts = ("material", "supports", "contact")
    if not all(same(getattr(problem, part), getattr(before, part)) for part in parts) or posed.slip_reference.any():
        return discretise(problem, mesh)
    problem.check_boundaries(mesh.boundaries)
    problem.check_bodies(mesh.bodies)
    law = problem.law.at_nodes(mesh.points[posed.nodes], posed.weights)
    check_bounds(law, len(posed))
    # what slave nodes are exchanged for depends on where friction acts
    acts = [np.maximum(*one.bounds(len(posed))) > 0 for one in (law, old.law)]
    if old.coupling is not None and not np.array_equal(*acts):
        return discretise(problem, mesh)
    load = old.load
    if not same(problem.loads, before.loads):
        load = old.relative_forces(load_vector(mesh, problem.loads, body_materials(mesh, problem.material)))
        check_size("load", np.abs(load).max())
    result = old.with_step(load, old.fixed_values, old.contact.slip_reference)
    law = law if old.exchange is None else ScaledLaw(law, np.abs(old.exchange.sigma))
    for name, value in (("law", law), ("name", f"{problem.name}, {mesh.n_nodes} nodes")):
        object.__setattr__(result, name, value)
    return result


def same(a: object, b: object) -> bool:
    """Whether two parts of problems have the same values."""
    if a is b:
        return True
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b)
    if is_dataclass(a):
        return all(same(getattr(a, one.name), getattr(b, one.name)) for one in fields(a))
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, Mapping):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    return bool(a == b)


def _motions(mesh: MeshArrays, axisymmetric: bool, discrete: DiscreteProblem) -> np.ndarray:
    motions = rigid_motions(mesh, axisymmetric)
    motions.flags.writeable = False
    return motions


def _contact(problem: ContactProblem, mesh: MeshArrays, slip_reference: np.ndarray | None, fixed: np.ndarray
             ) -> tuple[ContactNodes, sparse.csr_array | None]:
    """Contact nodes and what they face; without slave nodes that should be exchanged for others and cannot."""
    excluded = np.empty(0, dtype=np.int64)
    while True:
        contact, weights = contact_data(problem, mesh, slip_reference=slip_reference, excluded=excluded)
        if weights is None:
            return contact, None
        law = problem.law.at_nodes(mesh.points[contact.nodes], contact.weights)
        unmatched = find_carriers(contact.nodes, weights, fixed, law)[2]
        if not len(unmatched):
            return contact, weights
        excluded = np.union1d(excluded, contact.nodes[unmatched])
        _LOG.info("%d slave nodes of %r with a supported tangential component carry no multiplier: the master is too "
                  "coarse there", len(unmatched), problem.name)


def _bodies(mesh: MeshArrays) -> dict[str, np.ndarray]:
    result = {}
    for k, name in enumerate(mesh.bodies):
        used = np.zeros(mesh.n_nodes, dtype=bool)
        used[mesh.elements if len(mesh.bodies) == 1 else mesh.elements[mesh.element_body == k]] = True
        result[name] = np.flatnonzero(used)
    return result


def _check_held(problem: ContactProblem, mesh: MeshArrays, bodies: dict[str, np.ndarray]) -> None:
    """Raise ValueError if a body has neither a support nor a surface in contact."""
    held = np.zeros(mesh.n_nodes, dtype=bool)
    for name in problem.pair_boundaries:
        held[mesh.boundary_facets(name)] = True
    for support in problem.supports:
        held[supported_nodes(mesh, support)] = True
    for name, nodes in bodies.items():
        if not held[nodes].any():
            raise ValueError(f"nothing holds body {name!r}: no support and no contact is on its boundaries; give it a "
                             "support or a contact pair, or leave it out")
