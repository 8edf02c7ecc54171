r"""What is solved: DiscreteProblem and ContactNodes. Arrays and matrices only.

Find u with :math:`A u - b = r`, r = 0 but at fixed dofs and at contact nodes, where with the outward unit normal n and
:math:`u_n = u\cdot n,\; p = -r_n,\; f_t = r_t`

.. math:: u_n \le g_0,\quad p \ge 0,\quad p\,(g_0 - u_n) = 0,\qquad |f_t| \le s + \mu p,

and :math:`f_t` is opposite to the slip :math:`u_t - u_t^{\mathrm{previous}}` wherever that is not zero.
Degree of freedom ``dim * node + component``. With a :class:`~adaptmg.coupling.Coupling` between bodies all this is
meant in relative coordinates: :meth:`DiscreteProblem.coupled` makes them.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.coupling import Coupling
from adaptmg.discrete_input import (
    SMALLEST,
    bounded,
    check_bounds,
    check_size,
    checked_bodies,
    checked_mask,
    checked_matrix,
)
from adaptmg.exchange import NEGLIGIBLE, Exchange, ScaledLaw, facing_part, find_carriers, rows_of_carriers
from adaptmg.problem import checks
from adaptmg.problem.contact_problem import CONTACT, check_law
from adaptmg.problem.laws import Law
from adaptmg.threads import one_blas_thread

__all__ = ["ContactNodes", "DiscreteProblem"]


@dataclass(frozen=True, kw_only=True, eq=False)
class ContactNodes:
    """Nodes that may touch an obstacle.

    Parameters
    ----------
    nodes : (n_contact,) array of int
        Node numbers, each once.
    normals : (n_contact, dim) array
        Unit normals, out of the body.
    gaps : (n_contact,) array
        Initial gap g0 along the normal, m; >= 0 unless ``allow_interference``.
    weights : (n_contact,) array, optional
        Lumped boundary mass (m in 2D, m^2 in 3D), to turn nodal forces into tractions. Default 1.
    slip_reference : (n_contact, dim) array, optional
        Displacement against which slip is measured, m (only its tangential part counts). Default 0.
    allow_interference : bool
        Accept negative gaps.
    boundary : (n_contact,) array of int, optional
        Index of the contact boundary of each node, for resultants; default 0.
    names : tuple of str
        Names of the contact boundaries.
    masters : tuple of str, optional
        For each of ``names`` the boundary of another body that it may touch; "" (the default) is a rigid obstacle.
    """

    nodes: np.ndarray
    normals: np.ndarray
    gaps: np.ndarray
    weights: np.ndarray | None = None
    slip_reference: np.ndarray | None = None
    allow_interference: bool = False
    boundary: np.ndarray | None = None
    names: tuple[str, ...] = ("contact",)
    masters: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        nodes = checks.array("nodes", self.nodes, (None,), integer=True)
        n = len(nodes)
        if n == 0:
            raise ValueError("nodes is empty: a contact problem needs at least one contact node")
        if len(np.unique(nodes)) < n or nodes.min() < 0:
            raise ValueError("nodes must be distinct and >= 0")
        checks.flag("allow_interference", self.allow_interference)
        normals = bounded("normals", self.normals, (n, None), 2.0)
        if normals.shape[1] not in (2, 3):
            raise ValueError(f"normals must have shape ({n}, 2) or ({n}, 3), got {normals.shape}")
        lengths = np.linalg.norm(normals, axis=1)
        if np.abs(lengths - 1).max() > 1e-6:
            i = int(np.argmax(np.abs(lengths - 1)))
            raise ValueError(f"normals must have length 1; that of contact node {i} has length {lengths[i]:.6g}")
        normals = normals / lengths[:, None]
        normals.flags.writeable = False
        gaps = bounded("gaps", self.gaps, (n,), checks.VAST)
        if not self.allow_interference and gaps.min() < 0:
            i = int(np.argmin(gaps))
            raise ValueError(f"gaps must be >= 0, got {gaps[i]:.6g} at contact node {i}; "
                             "for an interference fit say allow_interference=True")
        weights = bounded("weights", np.ones(n) if self.weights is None else self.weights, (n,))
        if not weights.min() > 0 or weights.min() < SMALLEST:
            raise ValueError(f"weights must be > 0, and at least {SMALLEST:g}, got {weights.min():.6g}")
        reference = np.zeros_like(normals) if self.slip_reference is None else self.slip_reference
        reference = bounded("slip_reference", reference, normals.shape, checks.VAST)
        names, masters = self._names()
        boundary = np.zeros(n, dtype=np.int64) if self.boundary is None else self.boundary
        boundary = checks.array("boundary", boundary, (n,), integer=True)
        if boundary.min() < 0 or boundary.max() >= len(names):
            wrong = boundary.min() if boundary.min() < 0 else boundary.max()
            raise ValueError(f"boundary must index names ({len(names)} given), got {wrong}")
        for name, value in (("nodes", nodes), ("normals", normals), ("gaps", gaps), ("weights", weights),
                            ("slip_reference", reference), ("boundary", boundary), ("names", names),
                            ("masters", masters)):
            object.__setattr__(self, name, value)

    def _names(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Names of the contact boundaries and of what they may touch, checked."""
        names = checks.strings("names", self.names)
        if not names:
            raise ValueError("names is empty: give one name at least")
        masters = ("",) * len(names)
        if self.masters is not None:
            masters = tuple("" if isinstance(item, str) and not item else checks.boundary_name(f"masters[{i}]", item)
                            for i, item in enumerate(checks.listed("masters", self.masters, "names")))
        if len(masters) != len(names):
            raise ValueError(f"masters must go with names ({len(names)}), got {len(masters)}")
        return names, masters

    def check_name_contact(self) -> None:
        """``Result.resultant("contact")`` is that of all contact boundaries: no other may have this name."""
        if CONTACT in self.masters or (CONTACT in self.names and len(self.names) > 1):
            raise ValueError(f"contact: the name {CONTACT!r} stands for all contact boundaries together; of several "
                             f"names and masters none may be it, got {self.names} and {self.masters}")

    def check_nodes(self, n_nodes: int) -> None:
        """ValueError unless there are so many nodes that each of these is one."""
        if self.nodes.max() >= n_nodes:
            raise ValueError(f"contact.nodes: node {self.nodes.max()} does not exist; there are {n_nodes} nodes")

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def dim(self) -> int:
        """Space dimension."""
        return self.normals.shape[1]


@dataclass(frozen=True, kw_only=True, eq=False)
class DiscreteProblem:
    """A contact problem as arrays; every solver takes it.

    Parameters
    ----------
    matrix : scipy sparse (n_dofs, n_dofs)
        Stiffness with no boundary condition applied, symmetric, in Cartesian components, N/m. Kept as BSR with
        dim x dim blocks.
    load : (n_dofs,) array
        N.
    fixed : (n_dofs,) bool array
        Prescribed dofs. The normal component at a contact node must not be fixed.
    law : Law
        With nodal parameters (see :mod:`adaptmg.problem.laws`).
    contact : ContactNodes
        Where contact may occur.
    fixed_values : (n_dofs,) array, optional
        Prescribed values at fixed dofs (others are ignored), m; default 0.
    coordinates : (n_nodes, dim) array, optional
        Node positions, m.
    near_nullspace : (n_dofs, k) array, optional
        Rigid-body modes of the free body; made from ``coordinates`` where not given.
    name : str
        For tables.
    coupling : Coupling, optional
        Says that all of the above is in relative coordinates; see :meth:`coupled`.
    bodies : mapping of str to (n,) int arrays, optional
        Nodes of each body by name, for messages.
    exchange : Exchange, optional
        Contact as it was posed where slave and master were exchanged at single nodes (:mod:`adaptmg.exchange`).
    """

    matrix: sparse.bsr_array
    load: np.ndarray
    fixed: np.ndarray
    law: Law
    contact: ContactNodes
    fixed_values: np.ndarray | None = None
    coordinates: np.ndarray | None = None
    near_nullspace: np.ndarray | None = None
    name: str = "discrete problem"
    coupling: Coupling | None = None
    bodies: Mapping[str, np.ndarray] | None = None
    exchange: Exchange | None = None

    @classmethod
    def coupled(cls, *, matrix: sparse.bsr_array, load: np.ndarray, fixed: np.ndarray, law: Law,
                contact: ContactNodes, weights: sparse.csr_array, fixed_values: np.ndarray | None = None,
                coordinates: np.ndarray | None = None, near_nullspace: np.ndarray | None = None,
                name: str = "discrete problem", bodies: Mapping[str, np.ndarray] | None = None
                ) -> DiscreteProblem:
        """Several bodies in contact, from their uncoupled matrix and load.

        Parameters
        ----------
        matrix, load, fixed, law, contact, fixed_values, coordinates, near_nullspace, name, bodies
            As of the class, in displacements. ``contact`` are the slave nodes; their gaps and slips are relative.
            ``near_nullspace`` should hold the rigid-body modes of every body (one column a body and mode); with
            ``coordinates`` alone the bodies move together in it.
        weights : (n_nodes, n_nodes) sparse
            W: in the rows of slave nodes the nodes that they face, row sums 1.

        Returns
        -------
        DiscreteProblem
            In relative coordinates, with ``coupling``. The Result of :func:`adaptmg.solve` has displacements.
        """
        checks.instance("contact", contact, ContactNodes, "ContactNodes(...)")
        check_law(law)
        contact.check_name_contact()
        dim, fixed = contact.dim, checked_mask("fixed", fixed)
        blocks, n = checked_matrix(matrix, dim), len(fixed)
        if blocks.shape[0] != n:
            raise ValueError(f"fixed must be a boolean mask over the {blocks.shape[0]} dofs of the matrix, got {n}")
        weights = checks.sparse_matrix("weights", weights, (n // dim, n // dim))
        contact.check_nodes(n // dim)
        check_bounds(law, len(contact))
        contact, weights, law, exchange = _exchanged(contact, weights, fixed, law)
        coupling = Coupling(weights, fixed)
        if near_nullspace is not None:
            near_nullspace = bounded("near_nullspace", near_nullspace, (n, None))
        elif coordinates is not None:
            near_nullspace = rigid_body_modes(bounded("coordinates", coordinates, (n // dim, dim), checks.VAST))
        return cls(matrix=coupling.transformed(blocks), fixed=fixed, law=law, contact=contact,
                   load=coupling.relative_forces(bounded("load", load, (n,))), fixed_values=fixed_values,
                   coordinates=coordinates, name=name, coupling=coupling, bodies=bodies, exchange=exchange,
                   near_nullspace=None if near_nullspace is None else coupling.relative(near_nullspace))

    def physical(self, unknowns: np.ndarray) -> np.ndarray:
        """Displacement (n_nodes, dim) of unknowns (n_dofs,) or (n_nodes, dim), m: the same without a coupling."""
        flat = np.asarray(unknowns, dtype=np.float64).reshape(-1)
        return (flat if self.coupling is None else self.coupling.physical(flat)).reshape(-1, self.dim)

    def relative(self, displacement: np.ndarray) -> np.ndarray:
        """Unknowns (n_nodes, dim) of a displacement, m: the inverse of :meth:`physical`."""
        flat = np.asarray(displacement, dtype=np.float64).reshape(-1)
        return (flat if self.coupling is None else self.coupling.relative(flat)).reshape(-1, self.dim)

    def at_contact(self, unknowns: np.ndarray) -> np.ndarray:
        """Displacement (n_contact, dim) of the contact nodes relative to what they face, m.

        Of the unknowns; between bodies that both are held, relative to what holds the other one.
        """
        nodal = np.asarray(unknowns, dtype=np.float64).reshape(-1, self.dim)
        nodes = self.contact.nodes
        result, own = nodal[nodes], self.fixed.reshape(-1, self.dim)[nodes]
        if self.coupling is not None and own.any():
            # such components are no relative coordinates
            moved = self.physical(nodal)
            result = np.where(own, moved[nodes] - self.coupling.weights[nodes] @ moved, result)
            for at, weights, c in self.held_together():
                result[at, c] = moved[nodes[at], c] - weights @ moved[:, c]
        return result

    def held_together(self) -> list[tuple[np.ndarray, sparse.csr_array, int]]:
        """For each component the contact nodes at which it is fixed and faces fixed ones, and the weights of these.

        Indices (k,) of contact nodes, weights (k, n_nodes) with row sums 1, component.
        """
        if self.coupling is None:
            return []
        rows, fixed, result = self.coupling.weights[self.contact.nodes], self.fixed.reshape(-1, self.dim), []
        for c in range(self.dim):
            held = np.flatnonzero(fixed[self.contact.nodes, c])
            weights = sparse.csr_array(facing_part(rows[held]) @ sparse.diags_array(fixed[:, c].astype(float)))
            total = np.asarray(weights.sum(axis=1)).ravel()
            kept = total > NEGLIGIBLE
            scale = sparse.diags_array(1 / total[kept], format="csr")
            result.append((held[kept], sparse.csr_array(scale @ weights[kept]), c))
        return result

    def with_step(self, load: np.ndarray, fixed_values: np.ndarray, slip_reference: np.ndarray) -> DiscreteProblem:
        """The same bodies under other data (a load step): nothing else is checked or copied again.

        Parameters
        ----------
        load, fixed_values : (n_dofs,) arrays
            N and m, in the coordinates of this problem (with a coupling relative ones).
        slip_reference : (n_contact, dim) array
            Displacement of the contact nodes against which slip is measured, as :meth:`at_contact` has it, m.
        """
        contact, result = copy.copy(self.contact), copy.copy(self)
        reference = bounded("slip_reference", slip_reference, contact.normals.shape)
        object.__setattr__(contact, "slip_reference", reference)
        values = bounded("fixed_values", fixed_values, (self.n_dofs,))
        values = bounded("fixed_values", np.where(self.fixed, values, 0.0), (self.n_dofs,))
        for name, value in (("load", bounded("load", load, (self.n_dofs,))), ("fixed_values", values),
                            ("contact", contact)):
            object.__setattr__(result, name, value)
        return result

    def __post_init__(self) -> None:
        checks.instance("contact", self.contact, ContactNodes, "ContactNodes(...)")
        check_law(self.law)
        checks.boundary_name("name", self.name)
        dim = self.contact.dim
        matrix = checked_matrix(self.matrix, dim)
        n = matrix.shape[0]
        self.contact.check_nodes(n // dim)
        if self.exchange is None:
            self.contact.check_name_contact()
        fixed = checked_mask("fixed", self.fixed, n)
        load = bounded("load", self.load, (n,))
        check_size("load", np.abs(load).max())
        values = np.zeros(n) if self.fixed_values is None else self.fixed_values
        if isinstance(values, np.ndarray) and values.shape == (n,) and values.dtype.kind in "iuf":
            values = np.where(fixed, values, 0.0)  # at free dofs anything may stand, NaN too
        values = np.where(fixed, bounded("fixed_values", values, (n,), checks.VAST), 0.0)
        values.flags.writeable = False
        arrays = {"matrix": matrix, "load": load, "fixed": fixed, "fixed_values": values}
        if self.coordinates is not None:
            arrays["coordinates"] = bounded("coordinates", self.coordinates, (n // dim, dim), checks.VAST)
        if self.near_nullspace is not None:
            arrays["near_nullspace"] = bounded("near_nullspace", self.near_nullspace, (n, None))
            if not arrays["near_nullspace"].any():
                raise ValueError("near_nullspace holds no mode: give the rigid-body motions, a column each, or None")
        elif self.coordinates is not None:
            arrays["near_nullspace"] = rigid_body_modes(arrays["coordinates"])
        for name, value in arrays.items():
            object.__setattr__(self, name, value)
        if self.bodies is not None:
            object.__setattr__(self, "bodies", checked_bodies(self.bodies, n // dim))
        if self.coupling is not None:
            checks.instance("coupling", self.coupling, Coupling, "a Coupling: use DiscreteProblem.coupled")
        if self.coupling is not None and not np.array_equal(self.coupling.fixed, arrays["fixed"]):
            raise ValueError("coupling was made for other fixed dofs: use DiscreteProblem.coupled")
        self._check_fixed_at_contact()
        check_bounds(self.law, len(self.contact))

    def _check_fixed_at_contact(self) -> None:
        fixed = self.fixed.reshape(-1, self.dim)[self.contact.nodes]
        # a fixed Cartesian component must lie in the tangent plane, or the contact condition would be prescribed too
        clash = (fixed & (np.abs(self.contact.normals) > 1e-8)).any(axis=1)
        if clash.any():
            i = int(np.argmax(clash))
            raise ValueError(f"fixed: a component with a normal part is fixed at contact node {i} "
                             f"(node {self.contact.nodes[i]}, normal {self.contact.normals[i].round(4).tolist()}); "
                             "take the node out of the contact boundary or free the component")

    @property
    def dim(self) -> int:
        """Space dimension."""
        return self.contact.dim

    @property
    def n_dofs(self) -> int:
        """Number of degrees of freedom, fixed ones included."""
        return self.matrix.shape[0]

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return self.n_dofs // self.dim


def _exchanged(contact: ContactNodes, weights: sparse.csr_array, fixed: np.ndarray, law: Law
               ) -> tuple[ContactNodes, sparse.csr_array, Law, Exchange | None]:
    """Contact, weights and law with masters in the place of slave nodes that a support holds tangentially."""
    weights = sparse.csr_array(weights, dtype=np.float64)
    places, carriers, unmatched = find_carriers(contact.nodes, weights, fixed, law)
    if len(unmatched):
        raise ValueError(f"contact: slave node {contact.nodes[unmatched[0]]} has a supported tangential component, and "
                         "no node that it faces can take its place (each belongs to another one, too): exchange slave "
                         "and master, or leave the node out and let its neighbours take its part")
    if not len(places):
        return contact, weights, law, None
    slaves = contact.nodes[places]
    sigma = np.ones(len(contact))
    sigma[places] = -weights[slaves, carriers]
    posed = Exchange(contact, sparse.csr_array(weights[contact.nodes]), sigma)
    nodes, boundary, pairs = contact.nodes.copy(), contact.boundary.copy(), len(contact.names)
    nodes[places] = carriers
    boundary[places] += pairs
    masters = tuple(master or name for name, master in zip(contact.names, contact.masters, strict=True))
    size = np.abs(sigma)
    turned = ContactNodes(nodes=nodes, normals=contact.normals * np.sign(sigma)[:, None], gaps=contact.gaps / size,
                          weights=contact.weights * size, slip_reference=contact.slip_reference / sigma[:, None],
                          allow_interference=contact.allow_interference, boundary=boundary,
                          names=(*contact.names, *masters), masters=(*contact.masters, *contact.names))
    return turned, rows_of_carriers(weights, slaves, carriers), ScaledLaw(law, size), posed


@one_blas_thread()
def rigid_body_modes(points: np.ndarray) -> np.ndarray:
    """Rigid-body modes about the centroid, orthonormal.

    Parameters
    ----------
    points : (n_nodes, dim) array
        m.

    Returns
    -------
    (n_nodes * dim, 3 or 6) array
        Translations, then rotations; orthonormalised.
    """
    n, dim = points.shape
    x = points - points.mean(axis=0)
    modes = np.zeros((n, dim, 3 if dim == 2 else 6))
    for k in range(dim):
        modes[:, k, k] = 1.0
    if dim == 2:
        modes[:, 0, 2], modes[:, 1, 2] = -x[:, 1], x[:, 0]
    else:
        for k, (a, b) in enumerate(((0, 1), (1, 2), (2, 0))):
            modes[:, a, 3 + k], modes[:, b, 3 + k] = -x[:, b], x[:, a]
    return np.linalg.qr(modes.reshape(n * dim, -1))[0]
