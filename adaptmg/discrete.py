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
from typing import Any

import numpy as np
from scipy import sparse

from adaptmg.coupling import Coupling
from adaptmg.on_demand import OnDemand, made_on_demand
from adaptmg.problem.laws import Law

__all__ = ["ContactNodes", "DiscreteProblem"]


def _array(name: str, value: object, shape: tuple[int | None, ...], dtype: type = np.float64) -> np.ndarray:
    """A read-only copy of the wanted shape (None: any) and type, finite; of read-only arrays themselves."""
    if type(value) is np.ndarray and value.dtype == dtype and value.base is None and not value.flags.writeable:
        result = np.ascontiguousarray(value)
    else:
        result = np.array(value, dtype=dtype, order="C")
    if len(result.shape) != len(shape) or any(w is not None and w != g
                                              for w, g in zip(shape, result.shape, strict=True)):
        wanted = "(" + ", ".join("n" if w is None else str(w) for w in shape) + ")"
        raise ValueError(f"{name} must have shape {wanted}, got {result.shape}")
    if dtype is np.float64 and not np.isfinite(result).all():
        raise ValueError(f"{name} must be finite; {np.count_nonzero(~np.isfinite(result))} entries are not")
    result.flags.writeable = False
    return result


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
        nodes = np.asarray(self.nodes)
        if nodes.dtype.kind not in "iu":
            raise TypeError(f"nodes must be integers, got {nodes.dtype}")
        nodes = _array("nodes", nodes, (None,), np.int64)
        n = len(nodes)
        if n == 0:
            raise ValueError("nodes is empty: a contact problem needs at least one contact node")
        if len(np.unique(nodes)) < n or nodes.min() < 0:
            raise ValueError("nodes must be distinct and >= 0")
        normals = _array("normals", self.normals, (n, None))
        if normals.shape[1] not in (2, 3):
            raise ValueError(f"normals must have shape ({n}, 2) or ({n}, 3), got {normals.shape}")
        lengths = np.linalg.norm(normals, axis=1)
        if np.abs(lengths - 1).max() > 1e-6:
            i = int(np.argmax(np.abs(lengths - 1)))
            raise ValueError(f"normals must have length 1; that of contact node {i} has length {lengths[i]:.6g}")
        normals = normals / lengths[:, None]
        normals.flags.writeable = False
        gaps = _array("gaps", self.gaps, (n,))
        if not self.allow_interference and gaps.min() < 0:
            i = int(np.argmin(gaps))
            raise ValueError(f"gaps must be >= 0, got {gaps[i]:.6g} at contact node {i}; "
                             "for an interference fit say allow_interference=True")
        weights = _array("weights", np.ones(n) if self.weights is None else self.weights, (n,))
        if not weights.min() > 0:
            raise ValueError(f"weights must be > 0, got {weights.min():.6g}")
        reference = np.zeros_like(normals) if self.slip_reference is None else self.slip_reference
        reference = _array("slip_reference", reference, normals.shape)
        boundary = np.zeros(n, dtype=np.int64) if self.boundary is None else self.boundary
        boundary = _array("boundary", boundary, (n,), np.int64)
        if boundary.min() < 0 or boundary.max() >= len(self.names):
            raise ValueError(f"boundary must index names ({len(self.names)} given), got {boundary.max()}")
        names = tuple(self.names)
        masters = ("",) * len(names) if self.masters is None else tuple(self.masters)
        if len(masters) != len(names):
            raise ValueError(f"masters must go with names ({len(names)}), got {len(masters)}")
        for name, value in (("nodes", nodes), ("normals", normals), ("gaps", gaps), ("weights", weights),
                            ("slip_reference", reference), ("boundary", boundary), ("names", names),
                            ("masters", masters)):
            object.__setattr__(self, name, value)

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
    def assembled(cls, **parts: Any) -> DiscreteProblem:
        """From a matrix of this package's own assembly, which is not searched for what a stranger's may have wrong.

        Parameters as of the class. The matrix, in dim x dim blocks with sorted columns and symmetric, is kept without
        a copy; ``near_nullspace`` may be :class:`~adaptmg.on_demand.OnDemand`.
        """
        result = cls.__new__(cls)
        object.__setattr__(result, "_assembled", True)
        result.__init__(**parts)
        return result

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
        coupling = Coupling(weights, np.asarray(fixed))
        if near_nullspace is None and coordinates is not None:
            near_nullspace = rigid_body_modes(np.asarray(coordinates, dtype=np.float64))
        blocks = sparse.bsr_array(matrix, blocksize=(coupling.dim, coupling.dim))
        return cls(matrix=coupling.transformed(blocks), fixed=fixed, law=law, contact=contact,
                   load=coupling.relative_forces(np.asarray(load, dtype=np.float64)), fixed_values=fixed_values,
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
        if not isinstance(self.contact, ContactNodes):
            raise TypeError(f"contact must be ContactNodes, got {type(self.contact).__name__}")
        if not isinstance(self.law, Law) or isinstance(self.law, type):
            raise TypeError(f"law must be Frictionless(), Tresca(...), Coulomb(...) or offer at_nodes and bounds, "
                            f"got {self.law!r}")
        dim = self.contact.dim
        matrix = self._checked_matrix(dim)
        n = matrix.shape[0]
        if self.contact.nodes.max() >= n // dim:
            raise ValueError(f"contact.nodes: node {self.contact.nodes.max()} does not exist; "
                             f"there are {n // dim} nodes")
        fixed = np.asarray(self.fixed)
        if fixed.dtype != bool:
            raise TypeError(f"fixed must be a boolean mask over the {n} dofs, got {fixed.dtype}")
        values = np.zeros(n) if self.fixed_values is None else self.fixed_values
        values = np.where(fixed, values, 0.0) if np.shape(values) == fixed.shape else values
        arrays = {"matrix": matrix, "load": _array("load", self.load, (n,)),
                  "fixed": _array("fixed", fixed, (n,), bool), "fixed_values": _array("fixed_values", values, (n,))}
        if self.coordinates is not None:
            arrays["coordinates"] = _array("coordinates", self.coordinates, (n // dim, dim))
        modes = self.__dict__["near_nullspace"]
        if modes is None and self.coordinates is not None:
            modes = OnDemand(_own_modes)
        if modes is not None and not isinstance(modes, OnDemand):
            modes = _array("near_nullspace", modes, (n, None))
        arrays["near_nullspace"] = modes
        for name, value in arrays.items():
            object.__setattr__(self, name, value)
        if self.coupling is not None and not np.array_equal(self.coupling.fixed, arrays["fixed"]):
            raise ValueError("coupling was made for other fixed dofs: use DiscreteProblem.coupled")
        self._check_fixed_at_contact()
        for name, bound in zip(("limit", "friction"), self.law.bounds(len(self.contact)), strict=True):
            if not (np.isfinite(bound).all() and (bound >= 0).all()):
                raise ValueError(f"law: the nodal {name} must be finite and >= 0")

    def _checked_matrix(self, dim: int) -> sparse.bsr_array:
        if not sparse.issparse(self.matrix):
            raise TypeError(f"matrix must be a scipy sparse matrix, got {type(self.matrix).__name__}")
        rows, columns = self.matrix.shape
        if rows != columns or rows % dim:
            raise ValueError(f"matrix must be square with a multiple of {dim} rows, got {self.matrix.shape}")
        matrix = sparse.bsr_array(self.matrix, blocksize=(dim, dim))
        if matrix.dtype != np.float64:
            matrix = matrix.astype(np.float64)
        if not matrix.has_sorted_indices:
            matrix = matrix.sorted_indices()
        if self.__dict__.get("_assembled"):
            return self._with_positive_diagonal(matrix)
        if not np.isfinite(matrix.data).all():
            raise ValueError("matrix must be finite")
        scale = np.abs(matrix.data).max(initial=0.0)
        if not scale > 0:
            raise ValueError("matrix is zero")
        asymmetry = abs(matrix - matrix.T).max()
        if asymmetry > 1e-8 * scale:
            raise ValueError(f"matrix must be symmetric; |A - A'| reaches {asymmetry / scale:.2g} of its largest entry")
        return self._with_positive_diagonal(matrix)

    def _with_positive_diagonal(self, matrix: sparse.bsr_array) -> sparse.bsr_array:
        diagonal, dim = matrix.diagonal(), matrix.blocksize[0]
        if not (diagonal > 0).all():
            i = int(np.argmin(diagonal))
            raise ValueError(f"matrix must have a positive diagonal; entry {i} (node {i // dim}) is {diagonal[i]:.3g}")
        return matrix

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


def _own_modes(problem: DiscreteProblem) -> np.ndarray:
    return rigid_body_modes(problem.coordinates)


DiscreteProblem.near_nullspace = made_on_demand("near_nullspace", "Rigid-body modes (n_dofs, k), or None.")


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
