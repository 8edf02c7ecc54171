r"""Assembly: Posed -> DiscreteProblem.

With the area vectors :math:`a_F` of the facets F of the contact boundary at node i,

.. math:: n_i = \sum_F a_F \Big/ \Big|\sum_F a_F\Big|, \qquad w_i = \sum_F \int_F \varphi_i ,

the area-weighted average normal and, in front of a rigid obstacle, the row sum of the boundary mass
matrix (in axisymmetry with the factor :math:`2\pi r`); between bodies see
:mod:`adaptmg.discrete.mortar`. Bodies that touch each other are coupled by relative coordinates
(:mod:`adaptmg.discrete.coordinates`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._threads import one_blas_thread
from adaptmg.discrete.contact_nodes import bounded, check_bounds, check_size, largest_entry
from adaptmg.discrete.coordinates import friction_acts
from adaptmg.discrete.elasticity import motions_at, repeated_rows
from adaptmg.discrete.loads import load_vector, supported_stiffness
from adaptmg.discrete.obstacles import check_held
from adaptmg.discrete.posed import Posed, nodal_law
from adaptmg.discrete.problem import DiscreteProblem, EnergyTerms
from adaptmg.discrete.stress import StressData
from adaptmg.discrete.volumes import Volumes, volume_groups
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.loads import InitialStrain, PointSpring, Spring


@one_blas_thread()
def discretise(
    problem: ContactProblem, mesh: MeshArrays, *, slip_reference: np.ndarray | None = None
) -> DiscreteProblem:
    """Discretise by P1 elements on a mesh with every boundary that the problem names.

    Its law has nodal parameters; its name is the problem's with the number of nodes.

    ValueError if dimensions, boundary or body names differ, if a body has neither support nor
    contact, or loads and supports do not fit it. A coarse mesh may have few contact nodes, or none.
    Rigid obstacles are in their first place, and preloads not tightened: :func:`adaptmg.solve_path`
    moves them.

    Parameters
    ----------
    problem : ContactProblem
    mesh : MeshArrays
    slip_reference : (n_nodes, dim) array, optional
        Displacement against which slip is measured (the previous load step), m; at slave nodes
        relative to the master. Default 0.

    Examples
    --------
    >>> problem = am.cases.greco_bar()
    >>> discrete = am.discretise(problem, am.mesh.structured(problem.domain, 4))
    >>> discrete.matrix.shape
    (50, 50)
    """
    return assembled(Posed.of(problem, mesh), slip_reference)


def assembled(
    posed: Posed,
    slip_reference: np.ndarray | None = None,
    effective: Callable[[sparse.bsr_array], sparse.bsr_array] | None = None,
) -> DiscreteProblem:
    """Return the problem of what is posed; see :func:`discretise`. ``effective`` makes the matrix
    of a time step from the stiffness."""
    problem = posed.problem
    mesh = posed.mesh
    posed.check_held()
    values = posed.prescribed
    contact = posed.contact
    if slip_reference is not None:
        # slips count from these displacements plus the motion of obstacles
        before = checks.array("slip_reference", slip_reference, mesh.points.shape)[contact.nodes]
        contact = replace(contact, slip_reference=before + contact.slip_reference)
    materials = posed.materials
    parts = {
        "load": load_vector(mesh, problem.loads, materials, problem.elements),
        "fixed": posed.fixed.reshape(-1),
        "fixed_values": values.reshape(-1),
        "contact": contact,
        "coordinates": mesh.points,
        "bodies": posed.bodies,
        "law": nodal_law(posed, contact),
        "motions": partial(motions_at, mesh, problem.axisymmetric),
        "inclined": posed.inclined,
        "ties": tuple(
            (tie.slave, tie.master, part.nodes, posed.surfaces[tie.slave].nodes)
            for tie, part in zip(problem.ties, posed.ties, strict=True)
        ),
        "name": f"{problem.name}, {mesh.n_nodes} nodes",
        "inelastic": problem.inelastic,
    }
    parts["volumes"] = (
        volume_groups(mesh, materials)
        if problem.elements == "smoothed"
        else Volumes.none(mesh.n_nodes, mesh.dim)
    )
    if problem.inelastic and len(parts["volumes"]):
        raise ValueError(
            "smoothed elements of elastic bodies next to plastic ones must have poisson of at most "
            '.4; take elements="linear"'
        )
    parts |= _initial_strain_parts(posed, parts["volumes"])
    parts |= _matrix_part(posed, effective)
    # arrays that cannot be written may be shared: they are frozen, not copied
    checks.freeze(parts["load"], posed.fixed, values, *posed.bodies.values())
    result = DiscreteProblem.assembled(posed.rows.follows, **parts)
    check_held(posed, result)
    return result


def _matrix_part(
    posed: Posed, effective: Callable[[sparse.bsr_array], sparse.bsr_array] | None
) -> dict[str, Any]:
    """Return the ``matrix`` of the bodies and their springs, or, where nothing changes the stiffness of
    a lattice, its ``rows``, of which all but those near its sides are the same.

    The matrix is returned where springs add to it, where the weights ``follows`` of slave and tied nodes
    change its coordinates, where ``effective`` makes the matrix of a time step of
    it, and where bodies are inelastic, whose tangents differ from row to row."""
    problem = posed.problem
    springs = any(isinstance(support, Spring | PointSpring) for support in problem.supports)
    coupled = posed.rows.follows is not None
    if not (springs or coupled or problem.inelastic or effective):
        rows = repeated_rows(posed.mesh, posed.materials, problem.elements)
        if rows is not None:
            return {"rows": rows}
    matrix = supported_stiffness(posed.mesh, posed.materials, problem.supports, problem.elements)
    return {"matrix": matrix if effective is None else effective(matrix)}


def _initial_strain_parts(posed: Posed, volumes: Volumes) -> dict[str, Any]:
    """Return the parts of a problem that depend on initial strains, apart from the load: the energy
    terms ``strain_free`` in displacements of the bodies, None without initial strains, and the
    ``volumes`` with the expansion by these strains, 0 without any: they may come with that of the
    problem before."""
    problem = posed.problem
    mesh = posed.mesh
    strains = [load for load in problem.loads if isinstance(load, InitialStrain)]
    if not strains:
        return {"strain_free": None, "volumes": replace(volumes, expansion=0.0)}
    data = StressData.of(mesh, posed.materials, strains, problem.elements)
    return {
        "strain_free": EnergyTerms(
            load=load_vector(mesh, strains, posed.materials, problem.elements),
            constant=data.suppressed(mesh),
        ),
        "volumes": volumes.expanding(mesh, data.initial_strain, data.axisymmetric),
    }


def reassembled(posed: Posed, old: DiscreteProblem, changed: frozenset[str]) -> DiscreteProblem:
    """Return the problem of :func:`assembled`, with all parts of ``old`` that do not depend on loads and
    the law.

    The problem of ``old`` differs in the parts ``changed``, and perhaps in its law. All is assembled
    again where other parts than loads changed, where slips do not count from zero (obstacles move, or
    ``old`` belongs to a load step), and where other slave nodes carry multipliers."""
    problem = posed.problem
    mesh = posed.mesh
    contact = old.contact
    if changed - {"loads"} or contact.slip_reference.any():
        return assembled(posed)
    law = nodal_law(posed, contact)
    check_bounds(law, len(contact))
    n = len(contact)
    # which slave nodes carry multipliers depends on where friction acts: it may differ if some carry none
    # now, or if friction acts at other nodes
    may_differ = old.coupling is not None and (
        n < np.count_nonzero(posed.untied >= 0)
        or not np.array_equal(friction_acts(law, n), friction_acts(old.law, n))
    )
    if may_differ and not np.array_equal(posed.contact.nodes, contact.nodes):
        return assembled(posed)
    parts = {"law": law, "name": f"{problem.name}, {mesh.n_nodes} nodes"}
    if changed:
        forces = load_vector(mesh, problem.loads, posed.materials, problem.elements)
        load = old.relative_forces(forces)
        strains = _initial_strain_parts(posed, old.volumes)
        terms = strains["strain_free"]
        if terms is not None:
            strains["strain_free"] = terms._replace(load=old.relative_forces(terms.load))
        check_size("load", largest_entry(load))
        parts |= strains | {"load": bounded("load", load, (old.n_dofs,))}
    return old.posing(**parts)
