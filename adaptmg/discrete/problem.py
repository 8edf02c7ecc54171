r"""The discrete problem: a contact problem as arrays and matrices.

Find u with :math:`A u - b = r`, r = 0 except at fixed dofs and at contact nodes, where with the
outward unit normal n and :math:`u_n = u\cdot n,\; p = -r_n,\; f_t = r_t`

.. math:: u_n \le g_0,\quad p \ge 0,\quad p\,(g_0 - u_n) = 0,\qquad |f_t| \le s + \mu p,

and :math:`f_t` is opposite to the slip :math:`u_t - u_t^{\mathrm{previous}}` wherever that is not
zero. Degree of freedom ``dim * node + component``. A scalar problem has one unknown a node (dim 1)
and no tangents. Between bodies all this is meant in relative
coordinates (:mod:`adaptmg.discrete.coordinates`), which :meth:`DiscreteProblem.coupled` makes."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property, partial, wraps
from typing import Any, ClassVar, NamedTuple, TypeVarTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._text import shortened
from adaptmg.discrete.block_rows import BlockRows
from adaptmg.discrete.contact_nodes import (
    Bounds,
    ContactNodes,
    bounded,
    check_bounds,
    check_size,
    checked_bodies,
    checked_mask,
    checked_matrix,
    largest_entry,
)
from adaptmg.discrete.coordinates import (
    Computed,
    Coupling,
    Unknowns,
    Value,
    held_slaves,
    remembered_of_structure,
)
from adaptmg.discrete.elasticity import ALL_NODES, rigid_body_modes
from adaptmg.discrete.supports import Inclined
from adaptmg.discrete.volumes import Volumes
from adaptmg.problem.laws import Frictionless, Law, check_law, follows_state, friction_at

Others = TypeVarTuple("Others")


class EnergyTerms(NamedTuple):
    """The terms that u'Au lacks of twice the energy of the stresses of a displacement u: this is u'Au -
    2 u . load + constant.

    Initial strains eps_0 have the load of int C eps_0 : eps(v) and the constant int C eps_0 : eps_0."""

    load: np.ndarray  # (n_dofs,), N
    constant: float  # N m


def near_nullspace_at(
    problem: DiscreteProblem, nodes: np.ndarray | slice = ALL_NODES
) -> np.ndarray | None:
    """Return ``near_nullspace`` (n, dim, k) at some nodes without storing it in the problem; None
    without coordinates."""
    if "near_nullspace" in vars(problem):
        stored = problem.near_nullspace
        return None if stored is None else stored.reshape(problem.n_nodes, problem.dim, -1)[nodes]
    if problem.dim == 1:
        return np.ones((problem.n_nodes, 1, 1))[nodes]
    if problem._motions is not None:
        return problem._motions(nodes)
    return None if problem.coordinates is None else rigid_body_modes(problem.coordinates, nodes)


def _near_nullspace(problem: DiscreteProblem) -> np.ndarray | None:
    """Return the rigid motions (n_dofs, k) of a problem to which none were given; None without
    coordinates."""
    modes = near_nullspace_at(problem)
    if modes is None:
        return None
    modes.flags.writeable = False
    return modes.reshape(problem.n_dofs, -1)


def _stored_matrix(problem: DiscreteProblem) -> sparse.bsr_array:
    """Return the matrix of a problem that has been assembled without it, which from now on is the one
    that is solved, whatever a user does to its entries."""
    matrix = problem.rows.matrix
    vars(problem)["rows"] = BlockRows.of(matrix)
    return matrix


@dataclass(frozen=True, kw_only=True, eq=False, init=False)
class DiscreteProblem(Unknowns):
    """A contact problem as arrays; every solver takes it.

    Parameters
    ----------
    matrix : scipy sparse (n_dofs, n_dofs)
        Stiffness with no boundary condition applied, symmetric, in Cartesian components, N/m. Kept
        as BSR with dim x dim blocks. Its entries, ``matrix.data``, may be changed in place between
        two solves: the second one follows them.
    load : (n_dofs,) array
        N.
    fixed : (n_dofs,) bool array
        Prescribed dofs. The normal component at a contact node must not be fixed.
    law : Law, optional
        With nodal parameters (see :mod:`adaptmg.problem.laws`). Default: frictionless, as scalar
        problems are.
    contact : ContactNodes
        Where contact may occur; or ``bounds``.
    bounds : Bounds
        Limits of the unknowns, in place of ``contact``: its nodes are then those with limits.
    fixed_values : (n_dofs,) array, optional
        Prescribed values at fixed dofs (others are ignored), m; default 0.
    coordinates : (n_nodes, dim) array, optional
        Node positions, m; of scalar problems in one to three dimensions.
    near_nullspace : (n_dofs, k) array, optional
        Rigid-body modes of the free body; made from ``coordinates`` where not given, of scalar
        problems a constant.
    name : str
        For tables.
    coupling, bodies, strain_free, inclined, ties, volumes, inelastic
        What :func:`adaptmg.discretise` adds for several bodies (:meth:`coupled` makes the
        coupling), initial strains, supports along directions that are not axes, ties, nearly
        incompressible bodies and bodies that yield.

    Examples
    --------
    >>> from scipy import sparse
    >>> contact = am.ContactNodes(nodes=[0], normals=[[0.0, -1.0]], gaps=[0.0])
    >>> discrete = am.DiscreteProblem(matrix=2.0 * sparse.eye_array(2), load=np.array([0.1, -1.0]),
    ...                               fixed=np.zeros(2, bool), law=am.Coulomb(0.3), contact=contact)
    >>> result = am.solve(discrete, am.SingleGrid())
    >>> result.contact.force_n.round(6).tolist()
    [1.0]
    """

    # made of ``rows`` where the problem has been assembled without it
    matrix: sparse.bsr_array | Any = cached_property(_stored_matrix)  # noqa: RUF009
    load: np.ndarray
    fixed: np.ndarray
    law: Law
    contact: ContactNodes
    fixed_values: np.ndarray
    coordinates: np.ndarray | None = None
    # computed when it is first read, unless it is given; Any: only problems without coordinates
    # need the test for None
    near_nullspace: np.ndarray | Any = cached_property(_near_nullspace)  # noqa: RUF009
    name: str = "discrete problem"
    coupling: Coupling | None = None  # says that all of the above is in relative coordinates
    bodies: Mapping[str, np.ndarray] | None = None  # nodes of each body by name, for messages
    # terms that u'Au lacks of twice the energy of the stresses, see EnergyTerms; None without them
    strain_free: EnergyTerms | None = None
    inclined: Inclined  # what supports hold along directions that are not axes
    # slave and master boundary, slave nodes (n,) whose relative displacement is fixed to zero, and all nodes
    # (m,) of the slave boundary
    ties: tuple[tuple[str, str, np.ndarray, np.ndarray], ...] = ()
    volumes: Volumes  # groups of nodes whose mean volume strains add to the stiffness
    inelastic: bool = False  # whether the matrix is that of bodies before they yield

    # attributes of each object that are not fields: ``assembled`` sets the first, ``_complete`` the
    # others
    _motions: ClassVar[Callable[[np.ndarray | slice], np.ndarray] | None] = None
    _computed: ClassVar[Computed]

    def __init__(
        self,
        *,
        matrix: sparse.sparray | sparse.spmatrix,
        load: ArrayLike,
        fixed: ArrayLike,
        law: Law | None = None,
        contact: ContactNodes | None = None,
        bounds: Bounds | None = None,
        fixed_values: ArrayLike | None = None,
        coordinates: ArrayLike | None = None,
        near_nullspace: ArrayLike | None = None,
        name: str = "discrete problem",
        coupling: Coupling | None = None,
        bodies: Mapping[str, np.ndarray] | None = None,
        strain_free: EnergyTerms | None = None,
        inclined: Inclined | None = None,
        ties: tuple[tuple[str, str, np.ndarray, np.ndarray], ...] = (),
        volumes: Volumes | None = None,
        inelastic: bool = False,
    ) -> None:
        """Check the arrays of a user, and keep read-only copies of them."""
        law = Frictionless() if law is None else check_law("law", law)
        if (contact is None) == (bounds is None):
            raise ValueError(
                "contact=ContactNodes(...) or bounds=Bounds(...) must be given, one of them"
            )
        if bounds is not None:
            checks.instance("bounds", bounds, Bounds, "Bounds(...)")
            contact = bounds.at_nodes(checked_mask("fixed", fixed))
        contact = checks.instance("contact", contact, ContactNodes, "ContactNodes(...)")
        checks.boundary_name("name", name)
        dim = contact.dim
        blocks = checked_matrix(matrix, dim)
        n = blocks.shape[0]
        contact.check_nodes(n // dim)
        contact.check_name_contact()
        fixed_dofs = checked_mask("fixed", fixed, n)
        inclined = Inclined.none(dim) if inclined is None else inclined
        checks.instance("inclined", inclined, Inclined, "Inclined, as discretise makes it")
        volumes = Volumes.none(n // dim, dim) if volumes is None else volumes
        checks.instance("volumes", volumes, Volumes, "Volumes(...)")
        checks.sparse_matrix("volumes.rows", volumes.rows, (len(volumes), n))
        prescribed = fixed_dofs.copy()
        # values along an inclined direction have all components
        prescribed.reshape(-1, dim)[inclined.nodes] = True
        values = np.zeros(n) if fixed_values is None else fixed_values
        if isinstance(values, np.ndarray) and values.shape == (n,) and values.dtype.kind in "iuf":
            # at free dofs anything may stand, NaN too
            values = np.where(prescribed, values, 0.0)
        values = np.where(prescribed, bounded("fixed_values", values, (n,), checks.VAST), 0.0)
        values.flags.writeable = False
        self.__dict__.update(
            matrix=checks.indices_frozen(blocks),
            load=bounded("load", load, (n,)),
            fixed=fixed_dofs,
            fixed_values=values,
            law=law,
            contact=contact,
            coordinates=coordinates,
            name=name,
            coupling=coupling,
            bodies=bodies,
            strain_free=strain_free,
            inclined=inclined,
            ties=ties,
            volumes=volumes,
            inelastic=checks.flag("inelastic", inelastic),
        )
        if coordinates is not None:
            shape = (n // dim, None if dim == 1 else dim)
            self.__dict__["coordinates"] = bounded("coordinates", coordinates, shape, checks.VAST)
        if near_nullspace is not None:
            modes = bounded("near_nullspace", near_nullspace, (n, None))
            if not modes.any():
                raise ValueError(
                    "near_nullspace holds no mode: give the rigid-body motions, a column each, or None"
                )
            self.__dict__["near_nullspace"] = modes
        if bodies is not None:
            self.__dict__["bodies"] = checked_bodies(bodies, n // dim)
        if coupling is not None:
            checks.instance(
                "coupling", coupling, Coupling, "a Coupling: use DiscreteProblem.coupled"
            )
            if (coupling.fixed & ~fixed_dofs).any():
                raise ValueError(
                    "coupling was made for other fixed dofs: use DiscreteProblem.coupled"
                )
        self._check_fixed_at_contact()
        self._complete()

    @classmethod
    def assembled(cls, weights: sparse.csr_array | None = None, **parts: Any) -> DiscreteProblem:
        """Return the problem of arrays that the package has assembled: they are neither copied nor
        checked. ``weights`` are those of :meth:`coupled`. ``motions`` computes ``near_nullspace`` in
        displacements, (n, dim, k) at some nodes, where that is not given. ``rows`` may take the place of
        ``matrix`` if no weights change it."""
        if weights is not None:
            parts = _in_relative_coordinates(weights, parts)
        motions = parts.pop("motions", None)
        if "matrix" in parts:
            parts["matrix"] = checks.indices_frozen(parts["matrix"])
        result = cls.__new__(cls)
        result.__dict__.update(parts, _motions=motions)
        result._complete()
        return result

    def coupled(self, weights: sparse.sparray | sparse.spmatrix) -> DiscreteProblem:
        """Pose contact between the bodies of this problem: in relative coordinates, with
        ``coupling``.

        ``weights`` W (n_nodes, n_nodes), sparse, have in the rows of slave nodes the nodes that
        they face, with row sums 1. ``contact`` are the slave nodes; their gaps and slips are
        relative. ``near_nullspace`` should hold the rigid-body modes of every body (one column a
        body and mode); with ``coordinates`` alone the bodies move together in it. ValueError if
        this problem has a coupling already."""
        if self.coupling is not None:
            raise ValueError("only a problem in displacements can be coupled, not with coupling")
        given = checks.sparse_matrix("weights", weights, (self.n_nodes, self.n_nodes))
        rows = sparse.csr_array(given, dtype=np.float64)  # pyright: ignore[reportCallIssue, reportArgumentType]  scipy-stubs
        _check_row_sums(rows)
        return self.assembled(
            rows, **{field.name: getattr(self, field.name) for field in fields(self)}
        )

    def __repr__(self) -> str:
        where = f"in {self.dim}D" if self.dim > 1 else "of a scalar problem"
        return shortened(
            f"DiscreteProblem {self.name!r}: {self.n_nodes} nodes {where}, {self.fixed.sum()} of "
            f"{self.n_dofs} dofs fixed, {len(self.contact)} contact nodes, {self.law!r}"
        )

    def stress_energy(self, displacement: np.ndarray, energy: float) -> float:
        """Return the energy, N m, of the stresses of a displacement (n_dofs,), in relative
        coordinates, whose ``energy`` is u'Au; free expansion is without stress. Less than 1e-8 of
        the energy of suppressed expansion is rounding, and raised to that."""
        if self.strain_free is None:
            return energy
        load, constant = self.strain_free
        # with initial strains |eps(u) - eps_0|^2 = u'Au - 2 u . b_0 + |eps_0|^2
        return max(
            energy - 2 * float(np.einsum("i,i->", displacement, load)) + constant,
            1e-8 * abs(constant),
        )

    def with_step(
        self,
        load: np.ndarray,
        slip_reference: np.ndarray,
        accumulated_slip: np.ndarray,
        strain_free: EnergyTerms | None,
        volumes: Volumes,
        fixed_values: np.ndarray | None = None,
        gaps: np.ndarray | None = None,
    ) -> DiscreteProblem:
        """Return the problem of another load step; only loads and prescribed values are checked.

        ``load`` and ``fixed_values`` (n_dofs,) are in the coordinates of this problem (with a
        coupling relative ones), N and m; slips count from ``slip_reference`` (n_contact, dim), as
        :meth:`at_contact` has it, and come after ``accumulated_slip`` (n_contact,), m.
        ``volumes`` have the initial strains of the step. ``fixed_values`` and ``gaps`` (n_contact,),
        m, are those of this problem unless they are given."""
        contact = self.contact.posing(
            slip_reference=slip_reference,
            accumulated_slip=accumulated_slip,
            gaps=self.contact.gaps if gaps is None else gaps,
        )
        values = self.fixed_values
        if fixed_values is not None:
            # only along what is held: fixed dofs and inclined directions
            prescribed = fixed_values - self.free_part(fixed_values)
            values = bounded("fixed_values", prescribed, (self.n_dofs,))
        return self.posing(
            contact=contact,
            load=bounded("load", load, (self.n_dofs,)),
            fixed_values=values,
            strain_free=strain_free,
            volumes=volumes,
        )

    def posing(self, **parts: object) -> DiscreteProblem:
        """Return the problem with other parts (load, law, ...), which have been checked."""
        result = object.__new__(type(self))  # copy.copy takes three times as many calls
        result.__dict__.update(vars(self))
        if "matrix" in parts:
            # what belongs to the old matrix; rows are made of the new one when they are first read
            result.__dict__.pop("rows", None)
            result.__dict__["_structure"] = Computed()
        result.__dict__.update(parts, _computed=Computed())
        return result

    def restructured(self, **parts: object) -> DiscreteProblem:
        """Return the problem with other parts, of which some belong to the structure (matrix, fixed
        dofs, contact nodes, normals): nothing that was computed is kept."""
        result = self.posing(**parts)
        result._check_fixed_at_contact()
        result._complete()
        return result

    def alike(self, other: DiscreteProblem) -> bool:
        """Return whether another problem has the same structure: matrix, fixed dofs, contact nodes and
        normals."""
        return self._structure is other._structure

    def friction_at(self, normal_force: np.ndarray, slip: np.ndarray) -> np.ndarray:
        """Return the coefficients of friction (n_contact,) at nodal forces, N, and slips, m: those of
        the law, which may depend on both."""
        contact = self.contact
        if not follows_state(self.law):
            _, friction = self.law.bounds(len(contact))
            return np.asarray(friction)
        # of a node that takes over others the force is that of its weight, the slip a sum; laws take means
        pressure = normal_force / contact.weights
        slip = slip * contact.weights / contact.measures + contact.accumulated_slip
        return friction_at(self.law, pressure, slip)

    def residual(self, solution: np.ndarray) -> np.ndarray:
        """Return b - A u - B'p (n_dofs,), N, of a solution (n_unknowns,); dual."""
        displacement, pressures = self.parts(solution)
        return self.volumes.balanced(self.load - self.rows.times(displacement), pressures)

    def need_no_volumes(self, what: str) -> None:
        """Raise ValueError if there are volumes; ``what`` names the method that cannot take them."""
        if len(self.volumes):
            raise ValueError(
                f"grids: {what} cannot solve for smoothed elements with poisson above .4; use "
                "am.FullMultigrid(), am.Multigrid(correction=am.Truncated()) or am.ActiveSet()"
            )

    def need_given_friction(self, what: str, instead: str) -> None:
        """Raise ValueError if the coefficient depends on pressure or slip, or the compliance on the
        pressure; ``what`` names the method that cannot follow this, ``instead`` one that can."""
        if follows_state(self.law):
            raise ValueError(f"law: {what} cannot follow a StateLaw; use {instead}")
        if (self.contact.exponent > 1).any():
            raise ValueError(
                f"contact: {what} cannot follow a NormalCompliance with an exponent above 1; use {instead}"
            )

    def _complete(self) -> None:
        """Check load and law, and forget all that was computed from the matrix; see
        :func:`remembered_of_structure`."""
        check_size("load", largest_entry(self.load))
        check_bounds(self.law, len(self.contact))
        if self.dim == 1 and np.any(self.law.bounds(len(self.contact))):
            raise ValueError(
                "law must be am.Frictionless() in a scalar problem: it has no tangents"
            )
        self.__dict__.update(_structure=Computed(), _computed=Computed())

    def follow_entries(self) -> None:
        """Forget what was computed from the matrix if its entries have been changed since it was last
        solved."""
        checksum = None  # a matrix that has not been read has not been changed
        if "matrix" in vars(self):
            # 8 ms for 2.4 million entries, those of 66k nodes in the plane
            checksum = zlib.crc32(np.ascontiguousarray(self.matrix.data).data)
        # apart: other problems share the structure, and may have been solved first
        for values in (self._structure, self._computed):
            if values.setdefault("checksum", checksum) != checksum:
                values.clear()
                values["checksum"] = checksum

    def _check_fixed_at_contact(self) -> None:
        """Raise ValueError if a component with a part along the normal of a contact node is
        fixed."""
        fixed = self.fixed.reshape(-1, self.dim)[self.contact.nodes]
        # a fixed Cartesian component must lie in the tangent plane, but for the rounding of normals, or
        # contact and support would both prescribe the normal displacement
        clash = (fixed & (np.abs(self.contact.normals) > 1e-8)).any(axis=1)
        if clash.any():
            i = int(np.argmax(clash))
            raise ValueError(
                f"fixed: a component with a normal part is fixed at contact node {i} "
                f"(node {self.contact.nodes[i]}, normal {self.contact.normals[i].round(4).tolist()}); "
                "take the node out of the contact boundary or free the component"
            )

    @cached_property
    def rows(self) -> BlockRows:
        """Return the rows of the matrix; of a lattice, which repeats them, without the matrix."""
        return _rows_of_matrix(self)

    @property
    def n_dofs(self) -> int:
        """Return the number of degrees of freedom, fixed ones included."""
        return len(self.fixed)

    @property
    def decoupled_rows(self) -> BlockRows:
        """Return the rows of the matrix that solvers take: that of :mod:`adaptmg.discrete.supports` with
        the directions decoupled along which inclined supports hold nodes."""
        return _decoupled_rows(self) if len(self.inclined) else self.rows

    @property
    def n_unknowns(self) -> int:
        """Return the number of degrees of freedom and of the pressures of ``volumes``."""
        return self.n_dofs + len(self.volumes)

    @cached_property
    def n_nodes(self) -> int:
        """Return the number of nodes."""
        return self.n_dofs // self.dim


def remembered(
    function: Callable[[DiscreteProblem, *Others], Value],
) -> Callable[[DiscreteProblem, *Others], Value]:
    """Make a function compute once for each problem and its other arguments, which are hashable;
    exceptions are not remembered."""

    @wraps(function)
    def remembering(problem: DiscreteProblem, *arguments: *Others) -> Value:
        key = function, *arguments
        if key not in problem._computed:
            problem._computed[key] = function(problem, *arguments)
        return problem._computed[key]

    return remembering


@remembered_of_structure
def _rows_of_matrix(problem: DiscreteProblem) -> BlockRows:
    """Return the rows of a stored matrix, which all steps of a load path share."""
    return BlockRows.of(problem.matrix)


@remembered_of_structure
def _decoupled_rows(problem: DiscreteProblem) -> BlockRows:
    """Return the rows with the directions of inclined supports decoupled."""
    inclined = problem.inclined
    # D, of the size of the diagonal blocks
    diagonal = np.abs(problem.matrix.diagonal()).reshape(-1, problem.dim)
    stiffness = diagonal[inclined.nodes].mean(axis=1)
    return BlockRows.of(inclined.decoupled(problem.matrix, stiffness))


def _check_row_sums(weights: sparse.csr_array) -> None:
    """Raise ValueError unless the rows of nodes that face others have the sum 1."""
    followers = np.flatnonzero(np.diff(weights.indptr))
    sums = np.asarray(weights.sum(axis=1)).ravel()[followers]
    if not np.abs(sums - 1).max(initial=0.0) <= 1e-8:
        i = int(np.argmax(np.abs(sums - 1)))
        raise ValueError(
            f"weights must have rows with sum 1, got {sums[i]:.6g} at node {followers[i]}"
        )


def _in_relative_coordinates(weights: sparse.csr_array, parts: dict[str, Any]) -> dict[str, Any]:
    """Return the parts of a problem of several bodies, which have been checked, in relative
    coordinates, with their coupling."""
    nodes = parts["contact"].nodes
    held = held_slaves(nodes, weights, parts["fixed"], parts["law"], parts["inclined"])
    if len(held):
        raise ValueError(
            f"contact: slave node {nodes[held[0]]} has a supported tangential component, and what it "
            "faces has not: exchange slave and master, or leave the node out and let its neighbours take "
            "its part"
        )
    coupling = Coupling(weights, parts["fixed"], parts["inclined"])
    # forces and rows of volumes are dual
    load = coupling.relative_forces(parts["load"])
    load.flags.writeable = False
    strain_free = parts.get("strain_free")
    if strain_free is not None:
        strain_free = strain_free._replace(load=coupling.relative_forces(strain_free.load))
    volumes = parts["volumes"]
    volumes = replace(volumes, rows=coupling.relative_rows(volumes.rows))
    if parts.get("ties"):  # the relative displacement of tied nodes is fixed
        tied = parts["fixed"].copy().reshape(weights.shape[0], -1)
        for _, _, tied_nodes, _ in parts["ties"]:
            tied[tied_nodes] = True
        parts = parts | {"fixed": tied.reshape(-1)}
    if parts.get("motions") is not None:
        parts = parts | {"motions": partial(_relative_motions, coupling, parts["motions"])}
    if parts.get("near_nullspace") is not None:
        parts = parts | {"near_nullspace": coupling.relative(parts["near_nullspace"])}
    return parts | {
        "matrix": coupling.transformed(parts["matrix"]),
        "load": load,
        "coupling": coupling,
        "strain_free": strain_free,
        "volumes": volumes,
    }


def _relative_motions(
    coupling: Coupling,
    motions: Callable[[np.ndarray | slice], np.ndarray],
    nodes: np.ndarray | slice,
) -> np.ndarray:
    """Return the rigid motions (n, dim, k) that ``motions`` computes at nodes, in relative coordinates."""
    modes = motions(ALL_NODES)  # unknowns are relative to other nodes
    flat = modes.reshape(-1, modes.shape[2])
    return coupling.relative(flat).reshape(modes.shape)[nodes]
