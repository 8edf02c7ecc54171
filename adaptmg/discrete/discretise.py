r"""From what is posed to what is solved: ContactProblem + mesh -> DiscreteProblem.

Bodies that touch each other are coupled by relative coordinates
(:mod:`adaptmg.discrete.coordinates`).

With the area vectors :math:`a_F` of the facets F of the contact boundary at node i,

.. math:: n_i = \sum_F a_F \Big/ \Big|\sum_F a_F\Big|, \qquad w_i = \sum_F \int_F \varphi_i ,

the area-weighted average normal and, in front of a rigid obstacle, the row sum of the boundary mass
matrix (in axisymmetry with the factor :math:`2\pi r`); between bodies see
:mod:`adaptmg.discrete.mortar`.

A node on two contact boundaries belongs to the one named first: its normal is averaged, and what it
faces is found, there. Where a node i of a boundary carries none of its conditions, as it belongs to
another one, is held or tied, those next to it take over its part (crosspoints, B. Wohlmuth, SIAM J.
Numer. Anal. 38, 2000, doi:10.1137/S0036142999350929): with the shares :math:`E_{ji}`, which sum to 1
over the contact nodes j of the boundary,

.. math:: u_{n,j} + \sum_i \frac{E_{ji} w_i}{w_j}\, u_i \cdot n_j \le g_j + \sum_i \frac{E_{ji} w_i}{w_j}\, g_i ,

so that the multipliers add up to one and constant pressures are exact. The displacement :math:`u_i`
enters as that of a master does. Where a tied node follows contact nodes in front of obstacles, its
mass goes to these.

Load steps have nodal loads and prescribed displacements by name, so that every step is a
combination of them:

.. math:: b_k = \sum_j \lambda_{kj}\, b_j, \qquad u_{\mathrm{fixed},k} = \lambda_{kj}\, u_{\mathrm{fixed},j}
   \text{ on support } j .
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._threads import one_blas_thread
from adaptmg.discrete.contact_nodes import bounded, check_bounds, check_size
from adaptmg.discrete.coordinates import held_slaves
from adaptmg.discrete.elasticity import nodes_of_pieces, rigid_motions
from adaptmg.discrete.loads import load_vector, supported_stiffness
from adaptmg.discrete.moduli import Materials, body_materials
from adaptmg.discrete.mortar import MortarInterface, exact_of, pair_interface, slave_normals
from adaptmg.discrete.obstacles import (
    TANGENTIAL,
    check_held,
    free_normals,
    in_front_of,
    may_overlap,
    with_motions,
)
from adaptmg.discrete.problem import ContactNodes, DiscreteProblem
from adaptmg.discrete.sides import jump_of, tie_interfaces, with_sides
from adaptmg.discrete.stress import StressData
from adaptmg.discrete.supports import HeldNodes, fixed_dofs, inclined_supports, supported_nodes
from adaptmg.discrete.volumes import Volumes, volume_groups
from adaptmg.mesh.arrays import MeshArrays, Surface
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.laws import Law, NodalLaw, check_law
from adaptmg.problem.load_path import DEFAULT
from adaptmg.problem.loads import InitialStrain, Preload
from adaptmg.problem.surfaces import ContactPair, Periodic

_LOG = logging.getLogger(__name__)


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
    checks.instance("problem", problem, ContactProblem, "a ContactProblem")
    checks.instance("mesh", mesh, MeshArrays, "MeshArrays")
    if mesh.dim != problem.dim:
        raise ValueError(f"the mesh is {mesh.dim}D, the problem {problem.name!r} {problem.dim}D")
    problem = with_sides(problem, mesh)
    problem.check_boundaries(mesh.boundaries)
    problem.check_bodies(mesh.bodies)
    bodies = _bodies(mesh)
    _check_held(problem, mesh, bodies)
    fixed, values = fixed_dofs(mesh, problem.supports)
    held = HeldNodes(fixed.reshape(-1, mesh.dim), inclined_supports(mesh, problem.supports))
    ties = tie_interfaces(problem.ties, mesh, held, problem.axisymmetric)
    contact, weights = _contact(problem, mesh, slip_reference, held, ties)
    for tie, part in zip(problem.ties, ties, strict=True):
        values.reshape(-1, mesh.dim)[part.nodes] += jump_of(tie, part.nodes, held)
    materials = body_materials(mesh, problem.material)
    parts = {
        "matrix": supported_stiffness(mesh, materials, problem.supports, problem.elements),
        "load": load_vector(mesh, problem.loads, materials, problem.elements),
        "fixed": fixed,
        "fixed_values": values,
        "contact": contact,
        "coordinates": mesh.points,
        "bodies": bodies,
        "law": _nodal_law(problem, mesh, contact),
        "motions": partial(rigid_motions, mesh, problem.axisymmetric),
        "inclined": held.inclined,
        "ties": tuple(
            (tie.slave, tie.master, part.nodes)
            for tie, part in zip(problem.ties, ties, strict=True)
        ),
        "name": f"{problem.name}, {mesh.n_nodes} nodes",
    }
    parts["volumes"] = Volumes.none(mesh.n_nodes, mesh.dim)
    if problem.elements == "smoothed":
        parts["volumes"] = volume_groups(mesh, materials)
        if len(parts["volumes"]) and held.inclined is not None:
            raise ValueError(
                "supports along directions that are no axes cannot hold smoothed elements with poisson "
                'above .4; turn the problem, or take elements="linear"'
            )
    parts |= _strain_free(problem, mesh, materials, parts["volumes"])
    for array in (parts["load"], fixed, values, *bodies.values()):
        array.flags.writeable = False  # what nobody writes is not copied
    result = DiscreteProblem.assembled(weights, **parts)
    check_held(problem, mesh, result)
    return result


def _nodal_law(problem: ContactProblem, mesh: MeshArrays, contact: ContactNodes) -> Law:
    points = mesh.points[contact.nodes]
    laws = [problem.law if one.law is None else one.law for one in problem.contact]
    if all(one is problem.law for one in laws):
        law = problem.law.at_nodes(points, contact.weights)
        check_law("law", law)  # a user's own may return anything
        return law
    bounds = np.zeros((2, len(contact)))
    for k, one in enumerate(laws):
        own = contact.boundary == k
        if not own.any():
            continue
        law = one.at_nodes(points[own], contact.weights[own])
        check_law("law", law)
        check_bounds(law, int(own.sum()))
        bounds[:, own] = law.bounds(int(own.sum()))
    return NodalLaw(*bounds)


def _strain_free(
    problem: ContactProblem, mesh: MeshArrays, materials: Materials, volumes: Volumes
) -> dict[str, Any]:
    """The parts of a problem that initial strains make besides loads."""
    strains = [load for load in problem.loads if isinstance(load, InitialStrain)]
    if not strains:
        return {
            "strain_free": None,
            "volumes": replace(volumes, expansion=0.0),
        }
    data = StressData.of(mesh, materials, strains, problem.elements)
    return {
        "strain_free": (
            load_vector(mesh, strains, materials, problem.elements),
            data.suppressed(mesh),
        ),
        "volumes": volumes.expanding(mesh, data.initial_strain, data.axisymmetric),
    }


def changed_parts(problem: ContactProblem, before: ContactProblem) -> frozenset[str]:
    """Return names of the parts but laws that may have other values than ``before``; functions may
    return others."""
    surfaces = [
        tuple(replace(one, law=None) for one in posed.contact) for posed in (problem, before)
    ]
    return frozenset({"contact"} if not same(*surfaces) else ()) | frozenset(
        name
        for name in ("material", "supports", "loads", "elements", "ties")
        if not same(getattr(problem, name), getattr(before, name))
    )


_PLAIN = (type(None), bool, int, float, str, np.number, Path)


def same(a: object, b: Any) -> bool:
    """Return whether parts have the same values; functions and objects of other modules may change
    unseen."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray):
        return np.array_equal(a, b)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, Mapping):
        return list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    if is_dataclass(a) and type(a).__module__.startswith("adaptmg."):
        return all(same(getattr(a, one.name), getattr(b, one.name)) for one in fields(a))
    return isinstance(a, _PLAIN) and bool(a == b)


def rediscretise(
    problem: ContactProblem, mesh: MeshArrays, old: DiscreteProblem, changed: frozenset[str]
) -> DiscreteProblem:
    """Discretise as :func:`discretise` does; ``old``, that of a problem that differs in the parts
    ``changed`` and in the law, gives what only loads and law leave unchanged."""
    posed = old.contact
    if changed - {"loads"} or posed.slip_reference.any() or (changed and old.inclined is not None):
        return discretise(problem, mesh)
    problem.check_boundaries(mesh.boundaries)
    problem.check_bodies(mesh.bodies)
    law = _nodal_law(problem, mesh, posed)
    check_bounds(law, len(posed))
    if old.coupling is not None:
        # which slave nodes carry multipliers depends on where friction acts
        now, before = (np.maximum(*one.bounds(len(posed))) > 0 for one in (law, old.law))
        if not np.array_equal(now, before):
            return discretise(problem, mesh)
    parts = {"law": law, "name": f"{problem.name}, {mesh.n_nodes} nodes"}
    if changed:
        materials = body_materials(mesh, problem.material)
        load = old.relative_forces(load_vector(mesh, problem.loads, materials, problem.elements))
        parts |= _strain_free(problem, mesh, materials, old.volumes)
        if parts["strain_free"] is not None:
            forces, suppressed = parts["strain_free"]
            parts["strain_free"] = old.relative_forces(forces), suppressed
        check_size("load", np.abs(load).max())
        parts["load"] = bounded("load", load, (old.n_dofs,))
    return old.posing(**parts)


def _contact(
    problem: ContactProblem,
    mesh: MeshArrays,
    slip_reference: np.ndarray | None,
    held: HeldNodes,
    ties: Sequence[MortarInterface],
) -> tuple[ContactNodes, sparse.csr_array | None]:
    """Contact nodes and what they face; without slave nodes that supports hold along the
    surface."""
    excluded = np.empty(0, dtype=np.int64)
    while True:
        contact, weights = contact_data(
            problem, mesh, slip_reference=slip_reference, excluded=excluded, held=held, ties=ties
        )
        if weights is None:
            return contact, None
        law = _nodal_law(problem, mesh, contact)
        lone = held_slaves(contact.nodes, weights, held.fixed.reshape(-1), law, held.inclined)
        if not len(lone):
            return contact, weights
        for k in np.unique(contact.boundary[lone]):
            if any(one.boundary == contact.names[k] for one in problem.supports):
                raise ValueError(
                    f"a support holds slave {contact.names[k]!r} along its surface, where friction acts: "
                    "exchange slave and master of the pair"
                )
        excluded = np.union1d(excluded, contact.nodes[lone])


def _bodies(mesh: MeshArrays) -> dict[str, np.ndarray]:
    if len(mesh.bodies) == 1:
        return {mesh.bodies[0]: np.arange(mesh.n_nodes)}
    result = {}
    for k, name in enumerate(mesh.bodies):
        used = np.zeros(mesh.n_nodes, dtype=bool)
        used[mesh.elements[mesh.element_body == k]] = True
        result[name] = np.flatnonzero(used)
    return result


def _check_held(problem: ContactProblem, mesh: MeshArrays, bodies: dict[str, np.ndarray]) -> None:
    """Raise ValueError if a body, with those glued to it, has neither a support nor a surface in
    contact."""
    touching = (*problem.pair_boundaries, *problem.tied_boundaries)
    held = np.concatenate(
        [
            np.empty(0, dtype=np.int64),
            *(mesh.surface(name).nodes for name in touching),
            *(supported_nodes(mesh, support) for support in problem.supports),
        ]
    )
    for piece in nodes_of_pieces(mesh):
        if not np.isin(held, piece).any():
            name = next(
                name for name, nodes in bodies.items() if len(nodes) and np.isin(nodes[0], piece)
            )
            raise ValueError(
                f"nothing holds body {name!r}: no support and no contact is on its boundaries; give it a "
                "support or a contact pair, or leave it out"
            )


def contact_data(
    problem: ContactProblem,
    mesh: MeshArrays,
    *,
    slip_reference: np.ndarray | None = None,
    excluded: np.ndarray | None = None,
    held: HeldNodes | None = None,
    ties: Sequence[MortarInterface] = (),
) -> tuple[ContactNodes, sparse.csr_array | None]:
    """Return the nodes of the contact boundaries (of pairs: of the slaves), in ascending order, and
    what they follow. ``excluded`` slave nodes carry no multiplier; ``slip_reference`` (n_nodes,
    dim) is a displacement, m. Nodes of ``ties`` carry no contact."""
    if held is None:
        held = HeldNodes(
            fixed_dofs(mesh, problem.supports)[0].reshape(-1, mesh.dim),
            inclined_supports(mesh, problem.supports),
        )
    owner = np.zeros(mesh.n_nodes, dtype=np.int32)  # of nodes on contact boundaries
    surfaces = [mesh.surface(name) for name in problem.contact_boundaries]
    for k in reversed(range(len(surfaces))):
        owner[surfaces[k].nodes] = k
    tied = _masses_of_ties(problem, surfaces, owner, held, ties)
    for tie in ties:
        owner[tie.nodes] = -1
    nothing = np.empty(0, dtype=np.int64), np.empty((0, mesh.dim)), np.empty(0), np.empty(0)
    exact = exact_of(problem)
    parts = []
    for k, contact in enumerate(problem.contact):
        if isinstance(contact, ContactPair):
            mine = surfaces[k].nodes
            normals = slave_normals(surfaces[k], held)[mine]
            partly = (
                np.linalg.norm(free_normals(problem, mesh, k, mine, normals, held), axis=1)
                < 1 - TANGENTIAL
            )
            without = np.union1d(mine[owner[mine] != k], mine[partly])
            if excluded is not None:
                without = np.union1d(without, excluded)
            parts.append(
                pair_interface(
                    mesh,
                    contact,
                    held=held,
                    excluded=without,
                    axisymmetric=problem.axisymmetric,
                    exact=exact,
                )
            )
        else:
            parts.append(in_front_of(contact, problem, mesh, surfaces, owner, k, held, tied))
    parts.append(MortarInterface(*nothing))
    boundary = np.repeat(np.arange(len(parts)), [len(part.nodes) for part in parts])
    nodes = np.concatenate([part.nodes for part in parts])
    order = np.argsort(nodes)
    nodes = nodes[order]
    boundary = boundary[order]
    normals, weights, gaps = (
        np.concatenate([getattr(part, name) for part in parts])[order]
        for name in ("normals", "weights", "gaps")
    )
    taken = _joined([(part.nodes, part.taken_over) for part in parts], mesh.n_nodes)
    taken = None if taken is None else taken[nodes]
    if held.inclined is not None:
        rubbed = np.intersect1d(nodes, held.inclined.nodes[held.inclined.moving])
        if len(rubbed):
            raise ValueError(
                f"a support moves contact node {rubbed[0]} {tuple(mesh.points[rubbed[0]].tolist())} along "
                "the normal of its boundary, not an axis: turn the geometry, or end one of the "
                "boundaries before the other begins"
            )
    if slip_reference is not None:
        slip_reference = checks.array("slip_reference", slip_reference, mesh.points.shape)[nodes]
    slip_reference = with_motions(problem, mesh, nodes, taken, boundary, slip_reference)
    contact = ContactNodes(
        nodes=nodes,
        normals=normals,
        gaps=gaps,
        weights=weights,
        boundary=boundary,
        slip_reference=slip_reference,
        allow_interference=any(map(may_overlap, problem.contact)),
        names=problem.contact_boundaries,
        masters=problem.masters,
        taken_over=taken,
    )
    return contact, _followed([*parts, *ties], mesh.n_nodes)


def _masses_of_ties(
    problem: ContactProblem,
    surfaces: list[Surface],
    owner: np.ndarray,
    held: HeldNodes,
    ties: Sequence[MortarInterface],
) -> np.ndarray:
    """Boundary masses (n_nodes,) in front of obstacles that tied nodes give, < 0, and contact nodes
    that these follow, over tied ones too, take."""
    masses = np.zeros(len(owner))
    takes = np.zeros(len(owner))
    if not ties:
        return masses
    for k, contact in enumerate(problem.contact):
        if isinstance(contact, ContactPair):
            continue
        own = surfaces[k].nodes[owner[surfaces[k].nodes] == k]
        free = held.free_part(own, surfaces[k].node_normals[own])
        takes[own] = np.linalg.norm(free, axis=1) > TANGENTIAL
        masses[own] = surfaces[k].lumped(problem.axisymmetric)[own]
    tied = np.unique(np.concatenate([tie.nodes for tie in ties]))
    takes[tied] = 0.0
    followed = cast("sparse.csr_array", _followed(list(ties), len(owner)))  # ties have weights
    step = followed.maximum(0.0).T
    reached = sparse.csr_array(step.shape)
    path = step
    for _ in ties:
        reached = reached + sparse.diags_array(takes) @ path
        path = step @ sparse.diags_array(1 - takes) @ path
    total = reached.sum(axis=0)
    masses = np.where(total > 0, masses, 0.0)
    return reached @ np.divide(masses, total, out=np.zeros_like(masses), where=total > 0) - masses


def _followed(parts: list[MortarInterface], n_nodes: int) -> sparse.csr_array | None:
    """Rows (n_nodes, n_nodes) of what the nodes of all pairs face."""
    return _joined([(part.nodes, part.coupling) for part in parts], n_nodes)


def _joined(
    parts: list[tuple[np.ndarray, sparse.csr_array | None]], n_nodes: int
) -> sparse.csr_array | None:
    """The rows (n_nodes, n_nodes) of several matrices (n, n_nodes) whose rows are those of nodes (n,),
    None if there are no matrices."""
    coupled = [(nodes, weights) for nodes, weights in parts if weights is not None]
    if not coupled:
        return None
    rows = np.concatenate([np.repeat(nodes, np.diff(weights.indptr)) for nodes, weights in coupled])
    columns = np.concatenate([weights.indices for _, weights in coupled])
    values = np.concatenate([weights.data for _, weights in coupled])
    return sparse.csr_array((values, (rows, columns)), shape=(n_nodes, n_nodes))


@dataclass(frozen=True, eq=False)
class LoadSteps:
    """Loads and prescribed displacements of one mesh, by the names that a load path knows."""

    n_dofs: int
    loads: Mapping[str, np.ndarray]  # dict of str to (n_dofs,)
    prescribed: Mapping[str, tuple[np.ndarray, np.ndarray]]  # dict of str to ((n,) int, (n,))
    # what stresses follow from before initial strains; Any: None without a problem, and so without strains
    stress: StressData | Any = None
    strains: Mapping[str, np.ndarray] = field(
        default_factory=dict
    )  # dict of str to (n_elements, 3)
    strain_loads: Mapping[str, np.ndarray] = field(default_factory=dict)  # dict of str to (n_dofs,)
    mesh: MeshArrays | Any = None  # Any: as of stress

    def stress_data(self, factors: Mapping[str, float]) -> StressData | Any:
        """Return what the stresses of a step follow from."""
        if not self.strains:
            return self.stress
        return replace(
            self.stress,
            initial_strain=sum(factors[name] * strain for name, strain in self.strains.items()),
        )

    def step(
        self, discrete: DiscreteProblem, factors: Mapping[str, float], slip_reference: np.ndarray
    ) -> DiscreteProblem:
        """Return the problem of a load step; slips count from ``slip_reference`` (n_contact, dim),
        m."""
        volumes = discrete.volumes
        if len(volumes) and self.strains:
            data = self.stress_data(factors)
            volumes = volumes.expanding(self.mesh, data.initial_strain, data.axisymmetric)
        return discrete.with_step(
            self.load(factors),
            self.fixed_values(factors),
            slip_reference,
            self.strain_free(factors),
            factors,
            volumes,
        )

    def strain_free(self, factors: Mapping[str, float]) -> tuple[np.ndarray, float] | None:
        """Return ``strain_free`` of a step, see :class:`DiscreteProblem`."""
        if not self.strains:
            return None
        load = sum(
            (factors[name] * load for name, load in self.strain_loads.items()),
            np.zeros(self.n_dofs),
        )
        return load, self.stress_data(factors).suppressed(self.mesh)

    def load(self, factors: Mapping[str, float]) -> np.ndarray:
        """Return the nodal forces (n_dofs,) of a step, N."""
        result = np.zeros(self.n_dofs)
        for name, load in self.loads.items():
            if factors[name]:
                result += factors[name] * load
        return result

    def fixed_values(self, factors: Mapping[str, float]) -> np.ndarray:
        """Return the prescribed displacement (n_dofs,) of a step, zero at free dofs, m."""
        result = np.zeros(self.n_dofs)
        owner = np.full(self.n_dofs, -1)
        for k, (name, (dofs, values)) in enumerate(self.prescribed.items()):
            scaled = factors.get(name, 1.0) * values
            clash = (owner[dofs] >= 0) & ~np.isclose(result[dofs], scaled, rtol=1e-12, atol=0.0)
            if clash.any():
                dof = int(dofs[np.argmax(clash)])
                other = list(self.prescribed)[owner[dof]]
                raise ValueError(
                    f"the factors of {other!r} and {name!r} prescribe different displacements, "
                    f"{result[dof]:g} and {scaled[np.argmax(clash)]:g} m, at dof {dof}, which both fix: "
                    "give both the same factors"
                )
            result[dofs] = scaled
            owner[dofs] = k
        return result


def load_steps(problem: ContactProblem, mesh: MeshArrays, discrete: DiscreteProblem) -> LoadSteps:
    """Return the loads and supports of a problem one by one."""
    loads = {}
    strains = {}
    strain_loads = {}
    for name in dict.fromkeys(load.path_name for load in problem.loads):
        named = [
            load.shortening(mesh.dim) if isinstance(load, Preload) else load
            for load in problem.loads
            if load.path_name == name
        ]
        forces = load_vector(mesh, named, problem.material, problem.elements)
        loads[name] = discrete.relative_forces(forces)
        if own := [load for load in named if isinstance(load, InitialStrain)]:
            strains[name] = StressData.of(mesh, problem.material, own).initial_strain
            strain_loads[name] = discrete.relative_forces(
                load_vector(mesh, own, problem.material, problem.elements)
            )
    prescribed = {}
    for name in dict.fromkeys(one.path_name for one in problem.supports):
        fixed, values = fixed_dofs(
            mesh, [support for support in problem.supports if support.path_name == name]
        )
        dofs = np.flatnonzero(fixed)
        prescribed[name] = dofs, values[dofs]
    held = HeldNodes(discrete.held.reshape(-1, mesh.dim), discrete.inclined)
    for tie, (*_, nodes) in zip(problem.ties, discrete.ties, strict=True):
        if isinstance(tie, Periodic) and tie.jump is not None:
            free = np.flatnonzero(~held.fixed[nodes].reshape(-1))
            dofs = (mesh.dim * nodes[:, None] + np.arange(mesh.dim)).reshape(-1)[free]
            before = prescribed.get(
                name := tie.path_name, (np.empty(0, dtype=np.int64), np.empty(0))
            )
            prescribed[name] = tuple(
                map(np.append, before, (dofs, jump_of(tie, nodes, held).reshape(-1)[free]))
            )
    return LoadSteps(
        mesh.n_nodes * mesh.dim,
        loads,
        prescribed,
        StressData.of(mesh, problem.material, elements=problem.elements),
        strains,
        strain_loads,
        mesh,
    )


def whole_load(discrete: DiscreteProblem) -> LoadSteps:
    """Return all loads and prescribed displacements of a problem without names, as one."""
    dofs = np.flatnonzero(discrete.fixed)
    inclined = discrete.inclined
    load = discrete.load if inclined is None else inclined.load
    return LoadSteps(
        discrete.n_dofs, {DEFAULT: load}, {DEFAULT: (dofs, discrete.fixed_values[dofs])}
    )
