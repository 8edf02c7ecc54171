r"""transfer_state: carry what a load path has left in the bodies to another mesh.

The state s of a patch p of the new mesh is the mean over what it has in common with the patches q
of the old one,

.. math:: s_p = \frac{\sum_q |p \cap q|\, s_q}{\sum_q |p \cap q|},

so that :math:`\sum_p |p|\, s_p` is that of the old mesh where both meshes cover the same body. The
volumes are exact: simplices are clipped (:mod:`adaptmg.transfer.projections`). The patches of linear
elements are the elements. Those of smoothed elements surround edges: in each element the triangle of
an edge and the centroid, in space the two tetrahedra of an edge, the centroid and that of a face at
the edge. In axisymmetry volumes count with the radius.

Means of stresses on the yield limit lie within it, and the interpolated displacement is in no
equilibrium: the load step that follows restores both, by the return mapping of the material and by
Newton's method."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import cast

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._threads import one_blas_thread
from adaptmg.discrete.elasticity import EDGES, edges_of_elements
from adaptmg.discrete.moduli import inelastic_bodies
from adaptmg.discrete.plasticity import InelasticBodies
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.stress import PlasticState, StressData
from adaptmg.evolution.path_loop import is_on
from adaptmg.grids import Grids
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.smoother.system import OPEN
from adaptmg.solver.examine import ContactResult, Examiner
from adaptmg.solver.outcome import result_of
from adaptmg.solver.record import Outcome, Run, Status
from adaptmg.solver.result import Result
from adaptmg.transfer.contact import surface_interpolation
from adaptmg.transfer.interpolation import Interpolation, locate_nodes
from adaptmg.transfer.projections import overlaps


@one_blas_thread()
def transfer_state(old_grids: Grids, result: Result, new_grids: Grids) -> Result:
    """Carry a result of a load path to the finest mesh of another hierarchy, from where
    ``solve_path(new_grids, path, start=...)`` goes on.

    The meshes need not be nested. The state of plastic bodies is conserved: its integral over the
    new mesh is that over the old one, up to rounding where both meshes cover the same body. New
    elements that stick out at a curved boundary take the state of the old ones next to them.

    Parameters
    ----------
    old_grids : Hierarchy
        That of ``result``.
    result : Result
        A converged step on the finest mesh of ``old_grids``.
    new_grids : Hierarchy
        Of the same bodies, with materials whose states have the same numbers. Its elements may be
        smoothed where those of ``old_grids`` are linear, and the other way round.

    Returns
    -------
    Result
        On the finest mesh of ``new_grids``: the interpolated displacement, the accumulated slip of
        the contact nodes and, with plastic bodies, means of the state, the plastic strain and the
        stress. It is not in equilibrium, which its status TRANSFERRED says: its contact forces and
        reactions are zero, its residual is NaN. A load step with the same loads restores equilibrium.
        There the forces of plastic bodies dip below those of ``result``, by 3 to 7 % in the middle of
        a path of Prandtl's punch; in the next step they differ from those of an uninterrupted path
        on the new mesh by .05 % with smoothed elements on 1900 nodes, by .2 % with linear ones, and
        with these on 7500 nodes by .12 %. This holds where the load goes on: where it turns in the
        next step, bodies are elastic and the dip stays, 7 to 10 % of the force on 850 nodes. Take
        some steps in the same direction first.

    Raises
    ------
    ValueError
        If bodies, dimensions or kinds of materials of the two differ, the meshes do not cover the same
        bodies, or the result is on another mesh or has not converged.

    Examples
    --------
    >>> problem = am.cases.hill_cylinder()
    >>> old = am.Hierarchy.uniform(problem, divisions=[(4, 1), (8, 2)])
    >>> new = am.Hierarchy.uniform(problem, divisions=[(5, 1), (10, 3)])
    >>> first = am.solve_path(old, am.LoadPath({"left": [0.9, 1.0]}))
    >>> start = am.transfer_state(old, first[-1], new)
    >>> rest = am.solve_path(new, am.LoadPath({"left": [1.0, 0.0]}), start=start)
    >>> len(rest), rest[-1].mesh.n_nodes
    (2, 44)
    """
    checks.instance("result", result, Result, "a Result")
    before = _Side.of("old_grids", old_grids)
    after = _Side.of("new_grids", new_grids)
    _check(before, result, after)
    old_mesh = before.posed.mesh
    mesh = after.posed.mesh
    discrete = new_grids.finest.discrete
    try:
        nodal = Interpolation().build(old_mesh, mesh)
    except ValueError as error:
        raise ValueError(f"old_grids and new_grids, here coarse and fine: {error}") from error
    try:
        # this raises where old nodes lie outside: a body that lacks a part of the old one has all its nodes
        # inside
        locate_nodes(mesh, old_mesh)
    except ValueError as error:
        raise ValueError(f"new_grids and old_grids, here coarse and fine: {error}") from error
    displacement = discrete.relative(nodal @ result.displacement).reshape(-1)
    pressures = discrete.volumes.means @ (
        nodal @ old_grids.finest.discrete.volumes.at_nodes(result.pressures)
    )
    carried = result_of(
        new_grids,
        Examiner(discrete, certified=False),
        Run(unit=discrete.rows.nonzeros),
        Outcome(
            solution=np.append(displacement, pressures),
            status=Status.TRANSFERRED,
            cycles=0,
            rtol=result.rtol,
        ),
        solver=None,
        stress_data=_stress_data(before, cast("StressData", result.stress_data), after),
    )
    return replace(
        carried,
        contact=_at_rest(
            carried.contact, _interpolated_slips(old_mesh, result.contact, mesh, carried.contact)
        ),
        reaction=np.zeros(mesh.points.shape),
        residual=np.nan,
        solver_name=f"transfer_state from {old_mesh.n_nodes} nodes",
        ties=None,
        springs={},
        motions=result.motions,
    )


@dataclass(frozen=True, eq=False)
class _Side:
    """The old or the new mesh, in cells that belong to one element and one patch each."""

    posed: Posed

    @classmethod
    def of(cls, name: str, grids: Grids) -> _Side:
        """Return the finest mesh of a hierarchy as a side; ValueError without a problem on it."""
        checks.instance(name, grids, Grids, "a Hierarchy")
        if grids.posed is None:
            raise ValueError(f"{name} must be the Hierarchy of a ContactProblem, with its meshes")
        return cls(grids.posed)

    @cached_property
    def plastic_bodies(self) -> InelasticBodies | None:
        """Return the plastic bodies, None if there are none."""
        inelastic = inelastic_bodies(self.posed.materials).any()
        return InelasticBodies.of(self.posed) if inelastic else None

    @property
    def smoothed(self) -> bool:
        """Return whether patches are the edges of smoothed elements, not the elements."""
        return self.posed.problem.elements == "smoothed"

    @cached_property
    def cells(self) -> MeshArrays:
        """Return the cells as the elements of a mesh, in the order of the elements that they lie in."""
        mesh = self.posed.mesh
        corners = _corners(mesh.dim) if self.smoothed else np.eye(mesh.dim + 1)[None]
        points = np.einsum("cvk,ekd->ecvd", corners, mesh.points[mesh.elements])
        n = len(mesh.elements) * len(corners)
        # each cell has its corners to itself, and there are no boundaries
        return MeshArrays(
            points=points.reshape(-1, mesh.dim),
            elements=np.arange(n * (mesh.dim + 1)).reshape(n, -1),
            facets=np.empty((0, mesh.dim), dtype=np.int32),
            facet_labels=np.empty(0, dtype=np.int32),
            boundaries=(),
            element_body=np.repeat(mesh.element_body, len(corners)),
            bodies=mesh.bodies,
        )

    @property
    def elements(self) -> sparse.csr_array:
        """Return a matrix (n_elements, n_cells) with ones at the cells of each element."""
        n = len(self.posed.mesh.elements)
        return _members(np.repeat(np.arange(n), len(self.cells.elements) // n), n)

    @property
    def patches(self) -> sparse.csr_array:
        """Return a matrix (n_patches, n_cells) with ones at the cells of each plastic patch."""
        if not self.smoothed:
            return self.elements[cast("InelasticBodies", self.plastic_bodies).numbers]
        number = edges_of_elements(self.posed.mesh)
        # the patch of a cell is its edge: an element has one cell an edge, in space two
        of_cells = np.repeat(number, len(self.cells.elements) // number.size, axis=1).reshape(-1)
        bodies = cast("InelasticBodies", self.plastic_bodies)
        return _members(of_cells, bodies.n_patches)[bodies.numbers]


def _corners(dim: int) -> np.ndarray:
    """Return the corners of the cells of an element, edge by edge, in barycentric coordinates
    (n_cells, dim + 1, dim + 1)."""
    unit = np.eye(dim + 1)
    cells = []
    for a, b in EDGES[dim].tolist():
        # a cell has the ends of the edge, in space the centroid of a face at it, and that of the element
        centroid = np.full(dim + 1, 1 / (dim + 1))
        further_corners = [[centroid]]
        if dim == 3:
            others = [c for c in range(4) if c not in (a, b)]
            further_corners = [[(unit[a] + unit[b] + unit[c]) / 3, centroid] for c in others]
        for corners in further_corners:
            cell = np.array([unit[a], unit[b], *corners])
            # the determinant has the sign of the volume: exchanged ends of the edge make it positive
            is_positive = np.linalg.det(cell) > 0
            cells.append(cell if is_positive else cell[[1, 0, *range(2, dim + 1)]])
    return np.array(cells)


def _members(owner: np.ndarray, n: int) -> sparse.csr_array:
    """Return a matrix (n, len(owner)) with a one in column k at the row ``owner[k]``."""
    return sparse.csr_array(
        (np.ones(len(owner)), (owner, np.arange(len(owner)))), shape=(n, len(owner))
    )


def _check(before: _Side, result: Result, after: _Side) -> None:
    """Raise ValueError unless a result is of the old side, and both have the same bodies and
    states."""
    if not result.status.ok:
        raise ValueError(f"result must be a converged load step, got status {result.status.name}")
    mesh = before.posed.mesh
    if not is_on(result, mesh):
        raise ValueError(
            f"result must be on the finest mesh of old_grids, which has {mesh.n_nodes} nodes, got "
            f"one on another mesh of {len(result.displacement)}"
        )
    names = mesh.bodies
    # a single body is the same whatever its name
    new_names = after.posed.mesh.bodies if len(after.posed.mesh.bodies) > 1 else names[:1]
    different = set(names) ^ set(new_names)
    if different:
        raise ValueError(
            f"old_grids and new_grids must have the same bodies, got {', '.join(sorted(different))} "
            "in one of them only"
        )
    for k, name in enumerate(names):
        material = before.posed.materials[k]
        new_material = after.posed.materials[new_names.index(name)]
        if type(material) is not type(new_material):
            raise ValueError(
                f"new_grids: the material of body {name!r} must be of {type(material).__name__}, as "
                f"in old_grids, got {type(new_material).__name__}"
            )
        size, new_size = (
            None if each.inelastic is None else each.inelastic.state_size
            for each in (material, new_material)
        )
        if size != new_size:
            raise ValueError(
                f"new_grids: the material of body {name!r} must have states as in old_grids, of "
                f"{size} numbers (None: elastic), got {new_size}"
            )
    plastic = cast("StressData", result.stress_data).plastic
    if (plastic is None) != (before.plastic_bodies is None):
        raise ValueError("result must be of the problem of old_grids, whose materials differ")


def _means(volumes: sparse.csr_array, values: np.ndarray) -> np.ndarray:
    """Return the means (n_new, ...) of values (n_old, ...), weighted with the volumes (n_new, n_old) that
    new and old patches share."""
    total = np.asarray(volumes.sum(axis=1)).reshape(-1, 1)
    means = (volumes @ values.reshape(len(values), -1)) / total
    return means.reshape(-1, *values.shape[1:])


def _stress_data(before: _Side, data: StressData, after: _Side) -> StressData:
    """Return the stress data of the new mesh, with means of the old."""
    posed = after.posed
    # without loads: initial strains are those of the old mesh
    result = StressData.of(posed.mesh, posed.materials, (), posed.problem.elements)
    if after.plastic_bodies is None and not len(data.initial_strain):
        return result
    cells = after.cells
    # in axisymmetry volumes count with the radius
    density = cells.points[:, 0] if result.axisymmetric else np.ones(cells.n_nodes)
    shared = overlaps(before.cells, cells, density)
    elements = after.elements @ shared @ before.elements.T
    if len(data.initial_strain):
        result = replace(result, initial_strain=_means(elements, data.initial_strain))
    if after.plastic_bodies is None:
        return result
    old = cast("PlasticState", data.plastic)
    state = _means(after.patches @ shared @ before.patches.T, old.state)
    parts = (_means(elements, part) for part in (old.stress, old.strain, old.accumulated))
    return replace(result, plastic=PlasticState(state, *parts))


def _interpolated_slips(
    old_mesh: MeshArrays, old: ContactResult, mesh: MeshArrays, new: ContactResult
) -> np.ndarray:
    """Return the accumulated slip (n,), m, of new contact nodes, interpolated on the old boundary of
    the same name."""
    result = np.zeros(len(new))
    for k, name in enumerate(new.names):
        if name not in old.names:  # nothing has slipped on it yet
            continue
        on_boundary = new.boundary == k
        source = old.boundary == old.names.index(name)
        facets = old_mesh.boundary_facets(name)
        rows = surface_interpolation(old_mesh, mesh, facets, new.node[on_boundary])
        slips = np.zeros(old_mesh.n_nodes)
        slips[old.node[source]] = old.accumulated_slip[source]
        # nodes of the boundary that belong to another one, or that a support holds, have no slip: means are
        # taken over the others
        has_slip = np.zeros(old_mesh.n_nodes)
        has_slip[old.node[source]] = 1.0
        total = rows @ slips
        share = rows @ has_slip
        result[on_boundary] = np.divide(total, share, out=np.zeros_like(total), where=share > 0)
    return result


def _at_rest(contact: ContactResult, accumulated_slip: np.ndarray) -> ContactResult:
    """Return contact quantities without forces and without a slip of the last step, with this
    accumulated slip (n_contact,), m."""
    zeros = {
        name: np.zeros_like(getattr(contact, name))
        for name in ("slip", "force_n", "force_t", "limit", "master_force")
    }
    state = np.full_like(contact.state, OPEN)
    return replace(contact, state=state, accumulated_slip=accumulated_slip, **zeros)
