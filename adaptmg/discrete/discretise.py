r"""From what is posed to what is solved: ContactProblem + mesh -> DiscreteProblem.

Bodies that touch each other are coupled by relative coordinates (:mod:`adaptmg.discrete.coordinates`).

With the area vectors :math:`a_F` of the facets F of the contact boundary at node i,

.. math:: n_i = \sum_F a_F \Big/ \Big|\sum_F a_F\Big|, \qquad w_i = \sum_F \int_F \varphi_i ,

the area-weighted average normal and, in front of a rigid obstacle, the row sum of the boundary mass matrix (in
axisymmetry with the factor :math:`2\pi r`); between bodies see :mod:`adaptmg.discrete.mortar.pairs`.

A node on two contact boundaries belongs to the one named first: its normal is averaged, and what it faces is found,
there. In front of obstacles, facets of the other boundary count in its mass by the part that faces the same way. In a
pair it carries no multiplier of the pair named later: that pair's multipliers next to it take over its part, and it
follows as a plain node.

Load steps have nodal loads and prescribed displacements by name, so that every step is a combination of them:

.. math:: b_k = \sum_j \lambda_{kj}\, b_j, \qquad u_{\mathrm{fixed},k} = \lambda_{kj}\, u_{\mathrm{fixed},j}
   \text{ on support } j .
"""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import sparse

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._blas import one_blas_thread
from adaptmg._on_demand import OnDemand
from adaptmg.discrete.contact_nodes import bounded, check_bounds, check_size
from adaptmg.discrete.elasticity import Materials, body_materials
from adaptmg.discrete.exchange import ScaledLaw, find_carriers
from adaptmg.discrete.inclined import HeldNodes, Inclined
from adaptmg.discrete.loads import load_vector, supported_stiffness
from adaptmg.discrete.mortar.interface import MortarInterface, slave_normals
from adaptmg.discrete.mortar.pairs import pair_interface
from adaptmg.discrete.problem import ContactNodes, DiscreteProblem
from adaptmg.discrete.rigid_modes import rigid_motions
from adaptmg.discrete.sides import with_sides
from adaptmg.discrete.stress import StressData
from adaptmg.discrete.supports import fixed_dofs, held_directions, inclined_supports, supported_nodes
from adaptmg.discrete.ties import tie_interfaces
from adaptmg.discrete.volumes import Volumes, volume_groups
from adaptmg.mesh.arrays import MeshArrays, Surface
from adaptmg.problem.contact_problem import Contact, ContactProblem
from adaptmg.problem.laws import Law, NodalLaw, check_law
from adaptmg.problem.load_path import DEFAULT, name_in_path
from adaptmg.problem.loads import InitialStrain, Preload
from adaptmg.problem.moving import Moving, Obstacle, Rigid
from adaptmg.problem.surfaces import ContactPair

_LOG = logging.getLogger(__name__)


@one_blas_thread()
def discretise(problem: ContactProblem, mesh: MeshArrays, *, slip_reference: np.ndarray | None = None
               ) -> DiscreteProblem:
    """Discretise by P1 elements on a mesh with every boundary that the problem names.

    Its law has nodal parameters; its name is the problem's with the number of nodes.

    ValueError if dimensions, boundary or body names differ, if a body has neither support nor contact, or loads and
    supports do not fit it. A coarse mesh may have few contact nodes, or none.

    Parameters
    ----------
    problem : ContactProblem
    mesh : MeshArrays
    slip_reference : (n_nodes, dim) array, optional
        Displacement against which slip is measured (the previous load step), m; at slave nodes relative to the
        master. Default 0.

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
    Stops.of(problem, mesh, held).check(values, {})
    materials = body_materials(mesh, problem.material)
    parts = {"matrix": supported_stiffness(mesh, materials, problem.supports, problem.elements),
             "load": load_vector(mesh, problem.loads, materials, problem.elements),
             "fixed": fixed, "fixed_values": values, "contact": contact, "coordinates": mesh.points, "bodies": bodies,
             "law": _nodal_law(problem, mesh, contact),
             "near_nullspace": OnDemand(partial(_motions, mesh, problem.axisymmetric)), "inclined": held.inclined,
             "ties": tuple((tie.slave, tie.master, part.nodes)
                           for tie, part in zip(problem.ties, ties, strict=True)),
             "name": f"{problem.name}, {mesh.n_nodes} nodes"}
    if problem.elements == "smoothed":
        parts["volumes"] = volume_groups(mesh, materials)
        if parts["volumes"] is not None and held.inclined is not None:
            raise ValueError("supports along directions that are no axes cannot hold smoothed elements with poisson "
                             "above .4; turn the problem, or take elements=\"linear\"")
    parts |= _strain_free(problem, mesh, materials, parts.get("volumes"))
    for array in (parts["load"], fixed, values, *bodies.values()):
        array.flags.writeable = False  # what nobody writes is not copied
    return DiscreteProblem.assembled(weights, **parts)


def _nodal_law(problem: ContactProblem, mesh: MeshArrays, contact: ContactNodes) -> Law:
    points = mesh.points[contact.nodes]
    laws = [problem.law if one.law is None else one.law for one in problem.contact]
    if all(one is problem.law for one in laws):
        law = problem.law.at_nodes(points, contact.weights)
        check_law(law)  # a user's own may return anything
        return law
    bounds = np.zeros((2, len(contact)))
    for k, one in enumerate(laws):
        own = contact.boundary == k
        if not own.any():
            continue
        law = one.at_nodes(points[own], contact.weights[own])
        check_law(law)
        check_bounds(law, int(own.sum()))
        bounds[:, own] = law.bounds(int(own.sum()))
    return NodalLaw(*bounds)


def _strain_free(problem: ContactProblem, mesh: MeshArrays, materials: Materials, volumes: Volumes | None
                 ) -> dict[str, Any]:
    """The parts of a problem that initial strains make besides loads."""
    strains = [load for load in problem.loads if isinstance(load, InitialStrain)]
    if not strains:
        return {"strain_free": None, "volumes": None if volumes is None else replace(volumes, expansion=0.0)}
    data = StressData.of(mesh, materials, strains, problem.elements)
    if volumes is not None:
        volumes = volumes.expanding(mesh, data.initial_strain, data.axisymmetric)
    return {"strain_free": (load_vector(mesh, strains, materials, problem.elements), data.suppressed(mesh)),
            "volumes": volumes}


def changed_parts(problem: ContactProblem, before: ContactProblem) -> frozenset[str]:
    """Names of the parts but laws that may have other values than ``before``; functions may return others."""
    surfaces = [tuple(replace(one, law=None) for one in posed.contact) for posed in (problem, before)]
    return frozenset({"contact"} if not same(*surfaces) else ()) | frozenset(
        name for name in ("material", "supports", "loads", "elements", "ties")
        if not same(getattr(problem, name), getattr(before, name)))


_PLAIN = (type(None), bool, int, float, str, np.number, Path)


def same(a: object, b: object) -> bool:
    """Whether parts of problems have the same values; functions and objects of other modules may change unseen."""
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


def rediscretise(problem: ContactProblem, mesh: MeshArrays, old: DiscreteProblem, changed: frozenset[str]
                 ) -> DiscreteProblem:
    """As :func:`discretise`; ``old``, that of a problem that differs in the parts ``changed`` and in the law, gives
    what only loads and law leave unchanged."""
    posed = old.contact if old.exchange is None else old.exchange.contact
    if changed - {"loads"} or posed.slip_reference.any() or (changed and old.inclined is not None):
        return discretise(problem, mesh)
    problem.check_boundaries(mesh.boundaries)
    problem.check_bodies(mesh.bodies)
    law = _nodal_law(problem, mesh, posed)
    check_bounds(law, len(posed))
    if old.coupling is not None:
        # what slave nodes are exchanged for depends on where friction acts
        acts = [np.maximum(*one.bounds(len(posed))) > 0 for one in (law, old.law)]
        if not np.array_equal(*acts):
            return discretise(problem, mesh)
    parts = {"law": law if old.exchange is None else ScaledLaw(law, np.abs(old.exchange.sigma)),
             "name": f"{problem.name}, {mesh.n_nodes} nodes"}
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


def _motions(mesh: MeshArrays, axisymmetric: bool, discrete: DiscreteProblem) -> np.ndarray:
    motions = rigid_motions(mesh, axisymmetric)
    motions.flags.writeable = False
    return motions


def _contact(problem: ContactProblem, mesh: MeshArrays, slip_reference: np.ndarray | None, held: HeldNodes,
             ties: Sequence[MortarInterface]) -> tuple[ContactNodes, sparse.csr_array | None]:
    """Contact nodes and what they face; without slave nodes that should be exchanged for others and cannot."""
    excluded = np.empty(0, dtype=np.int64)
    while True:
        contact, weights = contact_data(problem, mesh, slip_reference=slip_reference, excluded=excluded, held=held,
                                        ties=ties)
        if weights is None:
            return contact, None
        law = _nodal_law(problem, mesh, contact)
        unmatched = find_carriers(contact.nodes, weights, held.fixed.reshape(-1), law, held.inclined)[2]
        if not len(unmatched):
            return contact, weights
        excluded = np.union1d(excluded, contact.nodes[unmatched])
        _LOG.info("%d slave nodes of %r with a supported tangential component carry no multiplier: the master is too "
                  "coarse there", len(unmatched), problem.name)


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
    """Raise ValueError if a body has neither a support nor a surface in contact."""
    held = np.concatenate([*(mesh.surface(name).nodes for name in (*problem.pair_boundaries, *problem.tied_boundaries)),
                           *(supported_nodes(mesh, support) for support in problem.supports)])
    for name, nodes in bodies.items():
        if not (np.searchsorted(nodes, held) < np.searchsorted(nodes, held, "right")).any():
            raise ValueError(f"nothing holds body {name!r}: no support and no contact is on its boundaries; give it a "
                             "support or a contact pair, or leave it out")


_ROUNDING = 1e-12  # of the body's size: a negative gap below this is rounding, not interference


def contact_data(problem: ContactProblem, mesh: MeshArrays, *, slip_reference: np.ndarray | None = None,
                 excluded: np.ndarray | None = None, held: HeldNodes | None = None,
                 ties: Sequence[MortarInterface] = ()
                 ) -> tuple[ContactNodes, sparse.csr_array | None]:
    """Nodes of the contact boundaries (of pairs: of the slaves), in ascending order, and what they follow. ``excluded``
    slave nodes carry no multiplier; ``slip_reference`` (n_nodes, dim) is a displacement, m. Nodes of ``ties`` carry no
    contact."""
    owner = np.zeros(mesh.n_nodes, dtype=np.int32)  # of nodes on contact boundaries
    surfaces = [mesh.surface(name) for name in problem.contact_boundaries]
    for k in reversed(range(len(surfaces))):
        owner[surfaces[k].nodes] = k
    for tie in ties:
        owner[tie.nodes] = -1
    if held is None:
        held = HeldNodes(fixed_dofs(mesh, problem.supports)[0].reshape(-1, mesh.dim),
                         inclined_supports(mesh, problem.supports))
    nothing = np.empty(0, dtype=np.int64), np.empty((0, mesh.dim)), np.empty(0), np.empty(0)
    parts = []
    for k, contact in enumerate(problem.contact):
        if isinstance(contact, ContactPair):
            mine = surfaces[k].nodes
            normals = slave_normals(surfaces[k], held)[mine]
            partly = np.linalg.norm(_free_normals(problem, mesh, k, mine, normals, held), axis=1) < 1 - _TANGENTIAL
            without = np.union1d(mine[owner[mine] != k], mine[partly])
            if excluded is not None:
                without = np.union1d(without, excluded)
            parts.append(pair_interface(mesh, contact, held=held, excluded=without,
                                        axisymmetric=problem.axisymmetric))
        else:
            parts.append(_in_front_of(contact, problem, mesh, surfaces, owner, k, held))
    parts.append(MortarInterface(*nothing))
    boundary = np.repeat(np.arange(len(parts)), [len(part.nodes) for part in parts])
    nodes = np.concatenate([part.nodes for part in parts])
    order = np.argsort(nodes)
    nodes, boundary = nodes[order], boundary[order]
    normals, weights, gaps = (np.concatenate([getattr(part, name) for part in parts])[order]
                              for name in ("normals", "weights", "gaps"))
    if held.inclined is not None:
        rubbed = np.intersect1d(nodes, held.inclined.nodes[held.inclined.moving])
        if len(rubbed):
            raise ValueError(f"a support moves contact node {rubbed[0]} {tuple(mesh.points[rubbed[0]].tolist())} along "
                             "the normal of its boundary, which is no axis: turn the geometry, or end one of the "
                             "boundaries before the other begins")
    if slip_reference is not None:
        slip_reference = check_arrays.array("slip_reference", slip_reference, mesh.points.shape)[nodes]
    slip_reference = _with_motions(problem, mesh.points[nodes], boundary, slip_reference)
    contact = ContactNodes(nodes=nodes, normals=normals, gaps=gaps, weights=weights, boundary=boundary,
                           slip_reference=slip_reference,
                           allow_interference=any(map(_may_overlap, problem.contact)),
                           names=problem.contact_boundaries, masters=problem.masters)
    return contact, _followed([*parts, *ties], mesh.n_nodes)


def _may_overlap(contact: Contact | ContactPair) -> bool:
    return contact.allow_interference or (isinstance(contact, Contact) and isinstance(_first(contact), Moving))


def _first(contact: Contact) -> Obstacle:
    """The obstacle in the place of a discretisation: moved as it is told, not yet pressed."""
    return contact.obstacle.obstacle if isinstance(contact.obstacle, Rigid) else contact.obstacle


def _with_motions(problem: ContactProblem, points: np.ndarray, boundary: np.ndarray, reference: np.ndarray | None
                  ) -> np.ndarray | None:
    """The slip reference (n_contact, dim) with how obstacles move, None where nothing does."""
    for k, contact in enumerate(problem.contact):
        obstacle = None if isinstance(contact, ContactPair) else _first(contact)
        if isinstance(obstacle, Moving):
            reference, own = np.zeros_like(points) if reference is None else reference.copy(), boundary == k
            reference[own] += obstacle.motion(points[own])
    return reference


def _followed(parts: list[MortarInterface], n_nodes: int) -> sparse.csr_array | None:
    """Rows (n_nodes, n_nodes) of what the nodes of all pairs face."""
    coupled = [part for part in parts if part.coupling is not None]
    if not coupled:
        return None
    rows = np.concatenate([np.repeat(part.nodes, np.diff(part.coupling.indptr)) for part in coupled])
    columns = np.concatenate([part.coupling.indices for part in coupled])
    values = np.concatenate([part.coupling.data for part in coupled])
    return sparse.csr_array((values, (rows, columns)), shape=(n_nodes, n_nodes))


def _in_front_of(contact: Contact, problem: ContactProblem, mesh: MeshArrays, surfaces: list[Surface],
                 owner: np.ndarray, k: int, held: HeldNodes) -> MortarInterface:
    """The nodes that contact boundary k owns, in front of a rigid obstacle. Where a support holds a part of the normal
    a node goes towards the obstacle along the rest of it; where it holds all of it there is no contact."""
    nodes = surfaces[k].nodes[owner[surfaces[k].nodes] == k]
    try:
        averaged = slave_normals(surfaces[k], held)[nodes]
    except ValueError as error:
        raise ValueError(f"contact boundary {contact.boundary!r}: {error}") from error
    normals, gaps = facing_obstacle(contact.obstacle, contact.boundary, mesh.points[nodes], averaged)
    gaps = np.array(gaps, dtype=np.float64)
    if len(nodes) and gaps.min() < 0:
        gaps[(gaps < 0) & (gaps > -_ROUNDING * np.linalg.norm(np.ptp(mesh.points, axis=0)))] = 0.0
    if len(nodes) and gaps.min() < 0 and not _may_overlap(contact):
        deepest = int(np.argmin(gaps))
        raise ValueError(f"contact boundary {contact.boundary!r} lies up to {-gaps[deepest]:.6g} m behind its "
                         f"obstacle, at {tuple(mesh.points[nodes[deepest]].tolist())}: move the obstacle, or say "
                         "allow_interference=True for an interference fit")
    normals, gaps, kept = along_free(_free_normals(problem, mesh, k, nodes, normals, held), normals, gaps)
    weights = _lumped_masses(problem, surfaces, nodes[kept], k, averaged[kept])
    return MortarInterface(nodes[kept], normals[kept], weights, gaps[kept])


def _lumped_masses(problem: ContactProblem, surfaces: list[Surface], nodes: np.ndarray, k: int, normals: np.ndarray
                   ) -> np.ndarray:
    """Boundary masses (n,) of the nodes that contact boundary k owns, m or m^2."""
    weights = np.zeros(len(nodes))
    for other, mine in enumerate(surfaces):
        if other != k and isinstance(problem.contact[other], ContactPair):
            continue
        for corner, share in zip(mine.facets.T, mine.shares(problem.axisymmetric).T, strict=True):
            at = np.searchsorted(nodes, corner)
            here = at < np.searchsorted(nodes, corner, "right")
            facing = mine.measures[here]
            if other != k:
                facing = np.maximum(0.0, np.sum(mine.vectors[here] * normals[at[here]], axis=1))
            np.add.at(weights, at[here], facing * share[here])
    return weights


def facing_obstacle(obstacle: Obstacle, boundary: str, points: np.ndarray, normals: np.ndarray
                    ) -> tuple[np.ndarray, np.ndarray]:
    """What an obstacle, perhaps user-defined, says of points of a boundary, checked."""
    answer, name = obstacle.contact(points, normals), f"the obstacle in front of {boundary!r}"
    if not isinstance(answer, (tuple, list)) or len(answer) != 2:
        raise TypeError(f"{name} must return normals and gaps, got {checks.shown(answer)}")
    directions, gaps = answer
    if np.shape(directions) != points.shape or np.shape(gaps) != (len(points),):
        raise ValueError(f"{name} must return normals {points.shape} and gaps ({len(points)},), got "
                         f"{np.shape(directions)} and {np.shape(gaps)}")
    directions = check_arrays.array(f"{name}: its normals", directions, points.shape)
    lengths = np.linalg.norm(directions, axis=1)
    if len(points) and not np.abs(lengths - 1).max() <= 1e-6:
        raise ValueError(f"{name} must return normals of length 1, got {lengths[np.argmax(np.abs(lengths - 1))]:.6g}")
    return directions, check_arrays.array(f"{name}: its gaps", gaps, (len(points),))


def along_free(free: np.ndarray, normals: np.ndarray, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normals (n, dim), gaps (n,) along their free parts (n, dim), and which of these parts do not vanish."""
    length = np.linalg.norm(free, axis=1)
    kept, partly = length > _TANGENTIAL, length < 1 - _TANGENTIAL
    length[~partly | ~kept] = 1.0
    return np.where((partly & kept)[:, None], free / length[:, None], normals), gaps / length, kept


_TANGENTIAL = 1e-8  # a component of a unit normal below this is none


def _free_normals(problem: ContactProblem, mesh: MeshArrays, k: int, nodes: np.ndarray, normals: np.ndarray,
                  held: HeldNodes) -> np.ndarray:
    """Normals (n, dim) at nodes on contact boundary k without their parts along what supports hold there.

    ValueError if a support on the boundary itself holds a part of them: what is meant is then something else.
    """
    boundary = problem.contact[k].boundary
    own = [one for one in problem.supports if one.boundary == boundary]
    for name, directions in held_directions(mesh, own).items():
        if len(nodes) and (np.abs(normals @ directions.T) > _TANGENTIAL).any():
            i = int(np.argmax(np.abs(normals @ directions.T).max(axis=1)))
            raise ValueError(f"the support on {name!r} fixes a component with a part normal to contact boundary "
                             f"{boundary!r}, at node {nodes[i]} {tuple(mesh.points[nodes[i]].tolist())}: contact could "
                             "never open there; free that component, or name another boundary")
    return held.free_part(nodes, normals)


@dataclass(frozen=True, eq=False)
class Stops:
    """Rigid obstacles in front of nodes that a support moves: their motion must end before them."""

    nodes: np.ndarray  # (n,) int
    normals: np.ndarray  # (n, dim)
    gaps: np.ndarray  # (n,), m
    boundary: np.ndarray  # (n,) of str
    inclined: Inclined | None = None

    @classmethod
    def of(cls, problem: ContactProblem, mesh: MeshArrays, held: HeldNodes) -> Stops:
        """The nodes of a mesh of whose normal displacement supports prescribe a part, or all of it. What moves a part
        may not change the gap."""
        parts = []
        for contact in problem.contact:
            if isinstance(contact, ContactPair) or _may_overlap(contact):
                continue
            surface = mesh.surface(contact.boundary)
            nodes = surface.nodes
            some = held.fixed[nodes].any(axis=1)
            if held.inclined is not None:
                some |= np.isin(nodes, held.inclined.nodes)
            nodes = nodes[some]
            if len(nodes):
                normals, gaps = facing_obstacle(contact.obstacle, contact.boundary, mesh.points[nodes],
                                        slave_normals(surface, held)[nodes])
                length = np.linalg.norm(held.free_part(nodes, normals), axis=1)
                for here, sign in ((length <= _TANGENTIAL, 1.0), *(
                        ((length > _TANGENTIAL) & (length < 1 - _TANGENTIAL), sign) for sign in (1.0, -1.0))):
                    own = np.where(length <= _TANGENTIAL, gaps, 0.0)[here]
                    parts.append((nodes[here], sign * normals[here], own, np.full(here.sum(), contact.boundary)))
        none = (np.empty(0, dtype=np.int64), np.empty((0, mesh.dim)), np.empty(0), np.empty(0, dtype=str))
        return cls(*(np.concatenate(arrays) for arrays in zip(none, *parts, strict=True)), held.inclined)

    def check(self, values: np.ndarray, factors: Mapping[str, float]) -> None:
        """ValueError if the prescribed displacement (n_dofs,) of a load step crosses an obstacle."""
        if not len(self.nodes):
            return
        moved = values.reshape(-1, self.normals.shape[1]).copy()
        if self.inclined is not None:
            moved[self.inclined.nodes] += self.inclined.prescribed(factors)
        along = np.einsum("nd,nd->n", self.normals, moved[self.nodes])
        over = along - self.gaps - _ROUNDING * (np.abs(moved[self.nodes]).max(axis=1) + np.abs(self.gaps))
        if (over > 0).any():
            i = int(np.argmax(over))
            raise ValueError(f"a support moves contact boundary {str(self.boundary[i])!r} {over[i]:.6g} m into its "
                             f"obstacle at node {self.nodes[i]}: move it less, or the obstacle")


@dataclass(frozen=True, eq=False)
class LoadSteps:
    """Loads and prescribed displacements of one mesh, by the names that a load path knows."""

    n_dofs: int
    loads: Mapping[str, np.ndarray]  # dict of str to (n_dofs,)
    prescribed: Mapping[str, tuple[np.ndarray, np.ndarray]]  # dict of str to ((n,) int, (n,))
    stress: StressData | None = None  # what stresses follow from before initial strains; None without a problem
    strains: Mapping[str, np.ndarray] = field(default_factory=dict)  # dict of str to (n_elements, 3)
    strain_loads: Mapping[str, np.ndarray] = field(default_factory=dict)  # dict of str to (n_dofs,)
    mesh: MeshArrays | None = None
    stops: Stops | None = None

    def stress_data(self, factors: Mapping[str, float]) -> StressData | None:
        """What the stresses of a step follow from."""
        if not self.strains:
            return self.stress
        return replace(self.stress, initial_strain=sum(factors[name] * strain for name, strain in self.strains.items()))

    def step(self, discrete: DiscreteProblem, factors: Mapping[str, float], slip_reference: np.ndarray
             ) -> DiscreteProblem:
        """The problem of a load step; slips count from ``slip_reference`` (n_contact, dim), m."""
        volumes = discrete.volumes
        if volumes is not None and self.strains:
            data = self.stress_data(factors)
            volumes = volumes.expanding(self.mesh, data.initial_strain, data.axisymmetric)
        return discrete.with_step(self.load(factors), self.fixed_values(factors), slip_reference,
                                  self.strain_free(factors), factors, volumes)

    def strain_free(self, factors: Mapping[str, float]) -> tuple[np.ndarray, float] | None:
        """See :class:`DiscreteProblem`."""
        if not self.strains:
            return None
        load = sum(factors[name] * load for name, load in self.strain_loads.items())
        return load, self.stress_data(factors).suppressed(self.mesh)

    def load(self, factors: Mapping[str, float]) -> np.ndarray:
        """Nodal forces (n_dofs,) of a step, N."""
        result = np.zeros(self.n_dofs)
        for name, load in self.loads.items():
            if factors[name]:
                result += factors[name] * load
        return result

    def fixed_values(self, factors: Mapping[str, float]) -> np.ndarray:
        """Prescribed displacement (n_dofs,) of a step, zero at free dofs, m."""
        result = np.zeros(self.n_dofs)
        owner = np.full(self.n_dofs, -1)
        for k, (name, (dofs, values)) in enumerate(self.prescribed.items()):
            scaled = factors.get(name, 1.0) * values
            clash = (owner[dofs] >= 0) & ~np.isclose(result[dofs], scaled, rtol=1e-12, atol=0.0)
            if clash.any():
                dof = int(dofs[np.argmax(clash)])
                other = list(self.prescribed)[owner[dof]]
                raise ValueError(f"the factors of {other!r} and {name!r} prescribe different displacements, "
                                 f"{result[dof]:g} and {scaled[np.argmax(clash)]:g} m, at dof {dof}, which both fix: "
                                 "give both the same factors")
            result[dofs], owner[dofs] = scaled, k
        if self.stops is not None:
            self.stops.check(result, factors)
        return result


def load_steps(problem: ContactProblem, mesh: MeshArrays, discrete: DiscreteProblem) -> LoadSteps:
    """The loads and supports of a problem one by one."""
    loads, strains, strain_loads = {}, {}, {}
    for name in dict.fromkeys(map(name_in_path, problem.loads)):
        named = [load.shortening(mesh.dim) if isinstance(load, Preload) else load for load in problem.loads
                 if name_in_path(load) == name]
        forces = load_vector(mesh, named, problem.material, problem.elements)
        loads[name] = discrete.relative_forces(forces)
        if (own := [load for load in named if isinstance(load, InitialStrain)]):
            strains[name] = StressData.of(mesh, problem.material, own).initial_strain
            strain_loads[name] = discrete.relative_forces(load_vector(mesh, own, problem.material, problem.elements))
    prescribed = {}
    for name in dict.fromkeys(map(name_in_path, problem.supports)):
        fixed, values = fixed_dofs(mesh, [support for support in problem.supports if name_in_path(support) == name])
        dofs = np.flatnonzero(fixed)
        prescribed[name] = dofs, values[dofs]
    return LoadSteps(mesh.n_nodes * mesh.dim, loads, prescribed,
                     StressData.of(mesh, problem.material, elements=problem.elements), strains, strain_loads, mesh,
                     Stops.of(problem, mesh, HeldNodes(discrete.held.reshape(-1, mesh.dim), discrete.inclined)))


def whole_load(discrete: DiscreteProblem) -> LoadSteps:
    """All loads and prescribed displacements of a problem without names, as one."""
    dofs, inclined = np.flatnonzero(discrete.fixed), discrete.inclined
    load = discrete.load if inclined is None else inclined.given_load(discrete.load)
    return LoadSteps(discrete.n_dofs, {DEFAULT: load}, {DEFAULT: (dofs, discrete.fixed_values[dofs])})
