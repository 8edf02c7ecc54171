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
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.coupling import Coupling
from adaptmg.problem import checks
from adaptmg.problem.contact_problem import CONTACT, check_law
from adaptmg.problem.laws import Law

__all__ = ["ContactNodes", "DiscreteProblem"]


# entries of matrices and nodal forces beyond these come from no physical problem: energies leave the range of float64
_LARGEST, _SMALLEST = 1e140, 1e-140
_ASYMMETRY = 1e-8


def _array(name: str, value: object, shape: tuple[int | None, ...], largest: float = _LARGEST) -> np.ndarray:
    """A read-only copy as float64, of a size that energies bear."""
    result = checks.array(name, value, shape)
    size = np.abs(result).max(initial=0.0)
    if not size <= largest:
        raise ValueError(f"{name} must be at most {largest:g} in SI units, got {size:.3g}")
    return result


def _check_size(name: str, size: float) -> None:
    """ValueError if the largest entry of a matrix or load is none that a physical problem can have."""
    if size and not _SMALLEST <= size <= _LARGEST:
        raise ValueError(f"{name}: its largest entry {size:.3g} is out of range, {_SMALLEST:g} to {_LARGEST:g}: choose "
                         "units in which numbers are nearer to 1")


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
        normals = _array("normals", self.normals, (n, None), 2.0)
        if normals.shape[1] not in (2, 3):
            raise ValueError(f"normals must have shape ({n}, 2) or ({n}, 3), got {normals.shape}")
        lengths = np.linalg.norm(normals, axis=1)
        if np.abs(lengths - 1).max() > 1e-6:
            i = int(np.argmax(np.abs(lengths - 1)))
            raise ValueError(f"normals must have length 1; that of contact node {i} has length {lengths[i]:.6g}")
        normals = normals / lengths[:, None]
        normals.flags.writeable = False
        gaps = _array("gaps", self.gaps, (n,), checks.VAST)
        if not self.allow_interference and gaps.min() < 0:
            i = int(np.argmin(gaps))
            raise ValueError(f"gaps must be >= 0, got {gaps[i]:.6g} at contact node {i}; "
                             "for an interference fit say allow_interference=True")
        weights = _array("weights", np.ones(n) if self.weights is None else self.weights, (n,))
        if not weights.min() > 0 or weights.min() < _SMALLEST:
            raise ValueError(f"weights must be > 0, and at least {_SMALLEST:g}, got {weights.min():.6g}")
        reference = np.zeros_like(normals) if self.slip_reference is None else self.slip_reference
        reference = _array("slip_reference", reference, normals.shape, checks.VAST)
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
        if not names or len(set(names)) < len(names):
            raise ValueError(f"names must be distinct, and at least one, got {checks.shown(names)}")
        masters = ("",) * len(names)
        if self.masters is not None:
            if isinstance(self.masters, (str, bytes)) or not isinstance(self.masters, Iterable):
                raise TypeError(f"masters must be a sequence of names, got {checks.shown(self.masters)}")
            masters = tuple("" if isinstance(item, str) and not item else checks.boundary_name(f"masters[{i}]", item)
                            for i, item in enumerate(self.masters))
        if len(masters) != len(names):
            raise ValueError(f"masters must go with names ({len(names)}), got {len(masters)}")
        if CONTACT in masters or (CONTACT in names and len(names) > 1):
            raise ValueError(f"names, masters: the name {CONTACT!r} stands for all contact boundaries together; of "
                             "several boundaries none may have it")
        return names, masters

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
        dim, n = contact.dim, _mask("fixed", fixed).size
        blocks = _checked_matrix(matrix, dim)
        if blocks.shape[0] != n:
            raise ValueError(f"fixed must be a boolean mask over the {blocks.shape[0]} dofs of the matrix, got {n}")
        coupling = Coupling(checks.sparse_matrix("weights", weights, (n // dim, n // dim)), np.asarray(fixed))
        if near_nullspace is not None:
            near_nullspace = _array("near_nullspace", near_nullspace, (n, None))
        elif coordinates is not None:
            near_nullspace = rigid_body_modes(_array("coordinates", coordinates, (n // dim, dim), checks.VAST))
        return cls(matrix=coupling.transformed(blocks), fixed=fixed, law=law, contact=contact,
                   load=coupling.relative_forces(_array("load", load, (n,))), fixed_values=fixed_values,
                   coordinates=coordinates, name=name, coupling=coupling, bodies=bodies,
                   near_nullspace=None if near_nullspace is None else coupling.relative(near_nullspace))

    def physical(self, unknowns: np.ndarray) -> np.ndarray:
        """Displacement (n_nodes, dim) of unknowns (n_dofs,) or (n_nodes, dim), m: the same without a coupling."""
        flat = np.asarray(unknowns, dtype=np.float64).reshape(-1)
        return (flat if self.coupling is None else self.coupling.physical(flat)).reshape(-1, self.dim)

    def relative(self, displacement: np.ndarray) -> np.ndarray:
        """Unknowns (n_nodes, dim) of a displacement, m: the inverse of :meth:`physical`."""
        flat = np.asarray(displacement, dtype=np.float64).reshape(-1)
        return (flat if self.coupling is None else self.coupling.relative(flat)).reshape(-1, self.dim)

    def with_step(self, load: np.ndarray, fixed_values: np.ndarray, slip_reference: np.ndarray) -> DiscreteProblem:
        """The same bodies under other data (a load step): nothing else is checked or copied again.

        Parameters
        ----------
        load, fixed_values : (n_dofs,) arrays
            N and m, in the coordinates of this problem (with a coupling relative ones).
        slip_reference : (n_contact, dim) array
            Displacement against which slip is measured, m; between bodies relative to the other body.
        """
        contact, result = copy.copy(self.contact), copy.copy(self)
        reference = _array("slip_reference", slip_reference, contact.normals.shape)
        object.__setattr__(contact, "slip_reference", reference)
        values = _array("fixed_values", fixed_values, (self.n_dofs,))
        values = _array("fixed_values", np.where(self.fixed, values, 0.0), (self.n_dofs,))
        for name, value in (("load", _array("load", load, (self.n_dofs,))), ("fixed_values", values),
                            ("contact", contact)):
            object.__setattr__(result, name, value)
        return result

    def __post_init__(self) -> None:
        checks.instance("contact", self.contact, ContactNodes, "ContactNodes(...)")
        check_law(self.law)
        checks.boundary_name("name", self.name)
        dim = self.contact.dim
        matrix = _checked_matrix(self.matrix, dim)
        n = matrix.shape[0]
        if self.contact.nodes.max() >= n // dim:
            raise ValueError(f"contact.nodes: node {self.contact.nodes.max()} does not exist; "
                             f"there are {n // dim} nodes")
        fixed = _mask("fixed", self.fixed, n)
        load = _array("load", self.load, (n,))
        _check_size("load", np.abs(load).max())
        values = np.zeros(n) if self.fixed_values is None else self.fixed_values
        if isinstance(values, np.ndarray) and values.shape == (n,) and values.dtype.kind in "iuf":
            values = np.where(fixed, values, 0.0)  # at free dofs anything may stand, NaN too
        values = np.where(fixed, _array("fixed_values", values, (n,), checks.VAST), 0.0)
        values.flags.writeable = False
        arrays = {"matrix": matrix, "load": load, "fixed": fixed, "fixed_values": values}
        if self.coordinates is not None:
            arrays["coordinates"] = _array("coordinates", self.coordinates, (n // dim, dim), checks.VAST)
        if self.near_nullspace is not None:
            arrays["near_nullspace"] = _array("near_nullspace", self.near_nullspace, (n, None))
            if not arrays["near_nullspace"].any():
                raise ValueError("near_nullspace holds no mode: give the rigid-body motions, a column each, or None")
        elif self.coordinates is not None:
            arrays["near_nullspace"] = rigid_body_modes(arrays["coordinates"])
        for name, value in arrays.items():
            object.__setattr__(self, name, value)
        if self.bodies is not None:
            object.__setattr__(self, "bodies", _bodies(self.bodies, n // dim))
        if self.coupling is not None:
            checks.instance("coupling", self.coupling, Coupling, "a Coupling: use DiscreteProblem.coupled")
        if self.coupling is not None and not np.array_equal(self.coupling.fixed, arrays["fixed"]):
            raise ValueError("coupling was made for other fixed dofs: use DiscreteProblem.coupled")
        self._check_fixed_at_contact()
        self._check_bounds()

    def _check_bounds(self) -> None:
        bounds, n = self.law.bounds(len(self.contact)), len(self.contact)
        if not isinstance(bounds, (tuple, list)) or len(bounds) != 2:
            raise TypeError(f"law: bounds(n_contact) must return the nodal limit and friction, got "
                            f"{checks.shown(bounds)}")
        for name, bound in zip(("limit", "friction"), bounds, strict=True):
            if not (checks.array(f"law: the nodal {name}", bound, (n,)) >= 0).all():
                raise ValueError(f"law: the nodal {name} must be finite and >= 0")
            _array(f"law: the nodal {name}", bound, (n,))

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


def _mask(name: str, value: object, n: int | None = None) -> np.ndarray:
    """A read-only copy of a boolean mask over dofs."""
    try:
        given = np.asarray(value)
    except ValueError:
        given = np.asarray(None)
    if given.dtype != bool:
        raise TypeError(f"{name} must be a boolean mask over the{'' if n is None else f' {n}'} dofs, "
                        f"got {checks.shown(value) if given.dtype == object else given.dtype}")
    if given.ndim != 1 or (n is not None and len(given) != n):
        raise ValueError(f"{name} must have shape ({'n' if n is None else n},), got {given.shape}")
    result = given.copy()
    result.flags.writeable = False
    return result


def _bodies(bodies: object, n_nodes: int) -> dict[str, np.ndarray]:
    """Nodes by body, checked."""
    checks.instance("bodies", bodies, Mapping, "a mapping of names to arrays of nodes")
    result = {checks.boundary_name("the names in bodies", name): checks.array(f"bodies[{name!r}]", nodes, (None,),
                                                                              integer=True)
              for name, nodes in bodies.items()}
    for name, nodes in result.items():
        if len(nodes) and not (nodes.min() >= 0 and nodes.max() < n_nodes):
            raise ValueError(f"bodies[{name!r}] must be node numbers from 0 to {n_nodes - 1}, got {nodes.min()} to "
                             f"{nodes.max()}")
    return result


def _checked_matrix(value: object, dim: int) -> sparse.bsr_array:
    """A stiffness matrix in blocks, symmetric with a positive diagonal."""
    matrix = checks.square_blocks("matrix", value, dim)
    scale = np.abs(matrix.data).max(initial=0.0)
    if not scale > 0:
        raise ValueError("matrix is zero")
    _check_size("matrix", scale)
    diagonal = matrix.diagonal()
    if not (diagonal > 0).all():
        i = int(np.argmin(diagonal))
        raise ValueError(f"matrix must have a positive diagonal; entry {i} (node {i // dim}) is {diagonal[i]:.3g}")
    _check_symmetry(matrix, diagonal)
    return matrix


def _check_symmetry(matrix: sparse.bsr_array, diagonal: np.ndarray) -> None:
    """ValueError unless each block is the transpose of its counterpart, relative to the diagonals of its two nodes.

    sqrt(a_ii a_jj) bounds the entries of a positive definite matrix: a soft part is judged by its own stiffness.
    """
    difference = matrix - matrix.T
    if not difference.nnz:
        return
    dim = matrix.blocksize[0]
    difference = sparse.bsr_array(difference, blocksize=(dim, dim))
    scale = np.sqrt(diagonal.reshape(-1, dim).max(axis=1))
    rows = np.repeat(np.arange(len(scale)), np.diff(difference.indptr))
    asymmetry = np.abs(difference.data).max(axis=(1, 2), initial=0.0) / (scale[rows] * scale[difference.indices])
    worst = int(np.argmax(asymmetry))
    if asymmetry[worst] > _ASYMMETRY:
        raise ValueError(f"matrix must be symmetric; |A - A'| reaches {asymmetry[worst]:.2g} of the diagonal, between "
                         f"nodes {rows[worst]} and {difference.indices[worst]}")


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
