"""The nodes that may touch an obstacle or another body, and checks of the arrays of a discrete
problem."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._text import brief
from adaptmg.problem.contact_problem import CONTACT
from adaptmg.problem.laws import Law


@dataclass(frozen=True, eq=False, init=False)
class ContactNodes:
    """Nodes that may touch an obstacle.

    Parameters
    ----------
    nodes : (n_contact,) array of int
        Node numbers, each once; there may be none.
    normals : (n_contact, dim) array
        Unit normals, out of the body.
    gaps : (n_contact,) array
        Initial gap g0 along the normal, m; >= 0 unless ``allow_interference``.
    weights : (n_contact,) array, optional
        Lumped boundary mass (m in 2D, m^2 in 3D), to turn nodal forces into tractions. Default 1.
    slip_reference : (n_contact, dim) array, optional
        Displacement against which slip is measured, m (only its tangential part counts). Default 0.
    accumulated_slip : (n_contact,) array, optional
        Length of the slips before ``slip_reference``, m, which a :class:`adaptmg.StateLaw` sees.
        Default 0.
    allow_interference : bool
        Accept negative gaps.
    boundary : (n_contact,) array of int, optional
        Index of the contact boundary of each node, for resultants; default 0.
    names : tuple of str
        Names of the contact boundaries.
    masters : tuple of str, optional
        For each of ``names`` the boundary of another body that it may touch; "" (the default) is a
        rigid obstacle.
    opposite_gaps : (n_contact,) array, optional
        Of scalar problems (dim 1): gaps to a second obstacle, against the normal, u_n >= -gap. One
        of the two gaps of a node may be infinite: there is no obstacle. Default infinite.
    taken_over : (n_contact, n_nodes) sparse array, optional
        Next to nodes of the boundary without a contact condition: what each contact node takes over
        of their boundary mass, over its own. Its force acts there too, in these proportions.
        Default none, kept as (n_contact, 0).
    compliance : (n_contact,) array, optional
        Penetration of the surface over nodal force, m/N. Default 0.
    exponent : (n_contact,) array, optional
        m >= 1 of surfaces that yield by ``compliance * force**(1 / m)``; their compliance is in
        m/N^(1/m). Default 1.

    Examples
    --------
    >>> contact = am.ContactNodes(nodes=[0, 1], normals=[[0, -1], [0, -1]], gaps=[0.0, 1e-5])
    >>> len(contact)
    2
    """

    nodes: np.ndarray
    normals: np.ndarray
    gaps: np.ndarray
    weights: np.ndarray
    slip_reference: np.ndarray
    accumulated_slip: np.ndarray
    allow_interference: bool
    boundary: np.ndarray
    names: tuple[str, ...]
    masters: tuple[str, ...]
    taken_over: sparse.csr_array
    opposite_gaps: np.ndarray
    compliance: np.ndarray
    exponent: np.ndarray

    def __init__(
        self,
        *,
        nodes: ArrayLike,
        normals: ArrayLike,
        gaps: ArrayLike,
        weights: ArrayLike | None = None,
        slip_reference: ArrayLike | None = None,
        accumulated_slip: ArrayLike | None = None,
        allow_interference: bool = False,
        boundary: ArrayLike | None = None,
        names: tuple[str, ...] = ("contact",),
        masters: tuple[str, ...] | None = None,
        taken_over: sparse.sparray | sparse.spmatrix | None = None,
        opposite_gaps: ArrayLike | None = None,
        compliance: ArrayLike | None = None,
        exponent: ArrayLike | None = None,
    ) -> None:
        """Check the arrays, and keep read-only copies of them."""
        nodes = checks.array("nodes", nodes, (None,), integer=True)
        checks.flag("allow_interference", allow_interference)
        names = checks.strings("names", names)
        n = len(nodes)
        if len(np.unique(nodes)) < n or nodes.min(initial=0) < 0:
            raise ValueError("nodes must be distinct and >= 0")
        normals = _unit_normals(normals, n)
        scalar = normals.shape[1] == 1
        gaps, opposite_gaps = _checked_gaps(gaps, opposite_gaps, n, scalar)
        if not allow_interference and gaps.min(initial=0.0) < 0:
            i = int(np.argmin(gaps))
            raise ValueError(
                f"gaps must be >= 0, got {gaps[i]:.6g} at contact node {i}; "
                "for an interference fit say allow_interference=True"
            )
        weights = _uniform(1.0, n) if weights is None else bounded("weights", weights, (n,))
        _check_weights(weights)
        slip_reference = (
            _uniform(0.0, normals.shape)
            if slip_reference is None
            else bounded("slip_reference", slip_reference, normals.shape, checks.VAST)
        )
        accumulated_slip = _at_least(0.0, "accumulated_slip", accumulated_slip, n)
        compliance = _at_least(0.0, "compliance", compliance, n)
        if scalar and compliance.any():
            raise ValueError("compliance must be 0 in scalar problems")
        if boundary is None:
            boundary = np.zeros(n, dtype=np.int64)
        boundary = checks.array("boundary", boundary, (n,), integer=True)
        if not ((boundary >= 0) & (boundary < len(names))).all():
            raise ValueError(f"boundary must index names ({len(names)} given), got {boundary}")
        masters = ("",) * len(names) if masters is None else _checked_masters(masters)
        if len(masters) != len(names):
            raise ValueError(f"masters must go with names ({len(names)}), got {len(masters)}")
        # the class is frozen: its fields are set once, here
        self.__dict__.update(
            nodes=nodes,
            normals=normals,
            gaps=gaps,
            weights=weights,
            slip_reference=slip_reference,
            accumulated_slip=accumulated_slip,
            allow_interference=bool(allow_interference),
            boundary=boundary,
            names=names,
            masters=masters,
            taken_over=_checked_shares(taken_over, n),
            opposite_gaps=opposite_gaps,
            compliance=compliance,
            exponent=_at_least(1.0, "exponent", exponent, n),
        )

    @classmethod
    def assembled(
        cls,
        *,
        normals: np.ndarray,
        gaps: np.ndarray,
        weights: np.ndarray,
        taken_over: sparse.csr_array | None,
        **parts: Any,
    ) -> ContactNodes:
        """Return the nodes of a problem of bodies, all arrays of which the package has assembled: they
        are not copied, and only what a user's surfaces may make too large or too small is checked.
        ``parts`` are the other fields, but those that only scalar problems and load steps have."""
        n = len(gaps)
        _check_weights(weights)
        result = cls.__new__(cls)
        result.__dict__.update(
            normals=normals / np.linalg.norm(normals, axis=1)[:, None],
            gaps=bounded("gaps", gaps, (n,), checks.VAST),
            weights=weights,
            accumulated_slip=np.zeros(n),
            opposite_gaps=np.full(n, np.inf),
            taken_over=_checked_shares(taken_over, n),
            **parts,
        )
        checks.freeze(*vars(result).values())
        return result

    def posing(self, **parts: object) -> ContactNodes:
        """Return the nodes with other parts (gaps, ...), which have been checked."""
        result = object.__new__(type(self))
        result.__dict__.update(vars(self), **parts)
        return result

    __repr__ = brief

    def check_name_contact(self) -> None:
        """Raise ValueError if one of several names is "contact", which stands for all contact
        boundaries together."""
        if CONTACT in self.masters or (CONTACT in self.names and len(self.names) > 1):
            raise ValueError(
                f"contact: the name {CONTACT!r} stands for all contact boundaries together; of several "
                f"names and masters none may be it, got {self.names} and {self.masters}"
            )

    def check_nodes(self, n_nodes: int) -> None:
        """Raise ValueError unless all nodes are below ``n_nodes``."""
        if self.nodes.max(initial=-1) >= n_nodes:
            raise ValueError(
                f"contact.nodes: node {self.nodes.max()} does not exist; there are {n_nodes} nodes"
            )

    def __len__(self) -> int:
        return len(self.nodes)

    @cached_property
    def dim(self) -> int:
        """Return the number of unknowns of a node: the space dimension, of scalar problems 1."""
        return self.normals.shape[1]

    def facing(self, displacement: np.ndarray) -> ContactNodes:
        """Return the nodes of a scalar problem with the normals and gaps of the obstacles that are
        nearest at displacements (n_contact, dim), and without the opposite ones; the nodes of bodies, which
        have one obstacle each, are returned unchanged."""
        if self.dim > 1:
            return self
        u_n = np.einsum("nd,nd->n", displacement, self.normals)
        # of two obstacles g - u_n and g' + u_n are the distances
        opposite_is_nearer = self.gaps - u_n > self.opposite_gaps + u_n
        return self.posing(
            normals=np.where(opposite_is_nearer[:, None], -self.normals, self.normals),
            gaps=np.where(opposite_is_nearer, self.opposite_gaps, self.gaps),
            opposite_gaps=np.full(len(self), np.inf),
        )

    @property
    def measures(self) -> np.ndarray:
        """Return the boundary measures w_j (1 + sum_i V_ji) (n,): the weights w_j of contact nodes j, and
        the parts of the nodes i of which they take over the shares V (``taken_over``).

        The condition of such a node is a sum: its gap is g_j + sum_i V_ji g_i, which is ``measures /
        weights`` times the mean gap. A node i that both surfaces share, as the tip of a crack, does
        not open: g_i is 0 in this sum and in the mean."""
        return self.weights * (1 + self.taken_over.sum(axis=1))


def _check_weights(weights: np.ndarray) -> None:
    """Raise ValueError unless the weights of contact nodes are positive."""
    if not weights.min(initial=1.0) >= SMALLEST:
        raise ValueError(f"weights must be > 0, and at least {SMALLEST:g}, got {weights.min():.6g}")


def _checked_shares(
    taken_over: sparse.sparray | sparse.spmatrix | None, n: int
) -> sparse.csr_array:
    """Return the shares (n, n_nodes) that n contact nodes take over, >= 0; for None (n, 0), as the
    number of nodes is not known here."""
    if taken_over is None:
        return checks.no_entries((n, 0))
    shares = sparse.csr_array(checks.sparse_matrix("taken_over", taken_over, (n, None)))
    if not shares.data.min(initial=0.0) >= 0:
        raise ValueError(f"taken_over must be >= 0, got {shares.data.min():.6g}")
    return shares


def _uniform(value: float, shape: int | tuple[int, ...]) -> np.ndarray:
    """Return an array of equal numbers, read-only."""
    result = np.full(shape, value)
    result.flags.writeable = False
    return result


def _at_least(least: float, name: str, value: ArrayLike | None, n: int) -> np.ndarray:
    """Return numbers (n,) >= ``least``, read-only; by default all are ``least``."""
    if value is None:
        return _uniform(least, n)
    result = bounded(name, value, (n,), checks.VAST)
    if not result.min(initial=least) >= least:
        raise ValueError(f"{name} must be >= {least:g}, got {result.min():.6g}")
    return result


def _unit_normals(value: ArrayLike, n: int) -> np.ndarray:
    """Return the normals (n, dim) of contact nodes, read-only, of length 1 to rounding."""
    # their length must be 1: the bound only keeps it from overflowing
    normals = bounded("normals", value, (n, None), largest=2.0)
    if normals.shape[1] not in (1, 2, 3):
        raise ValueError(
            f"normals must have shape ({n}, 2) or ({n}, 3), of scalar problems ({n}, 1), got "
            f"{normals.shape}"
        )
    lengths = np.linalg.norm(normals, axis=1)
    if np.abs(lengths - 1).max(initial=0.0) > 1e-6:
        i = int(np.argmax(np.abs(lengths - 1)))
        raise ValueError(
            f"normals must have length 1; that of contact node {i} has length {lengths[i]:.6g}"
        )
    normals = normals / lengths[:, None]
    normals.flags.writeable = False
    return normals


def _numbers(name: str, value: ArrayLike) -> np.ndarray:
    """Return an array of numbers, which may be infinite; TypeError for anything else."""
    numbers = checks.real_array(value)
    if numbers is None:
        raise TypeError(f"{name} must be an array of real numbers, got {checks.shown(value)}")
    return numbers


def _limits(name: str, value: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Return a read-only array, whose entries may be infinite."""
    numbers = _numbers(name, value)
    is_infinite = np.isinf(numbers)
    finite = bounded(name, np.where(is_infinite, 0.0, numbers), shape, checks.VAST)
    limits = np.where(is_infinite, numbers, finite)
    limits.flags.writeable = False
    return limits


def _checked_gaps(
    gaps: ArrayLike, opposite_gaps: ArrayLike | None, n: int, scalar: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return the gaps (n,) and the opposite gaps (n,) of contact nodes, read-only."""
    opposite = (
        _uniform(np.inf, n)
        if opposite_gaps is None
        else _limits("opposite_gaps", opposite_gaps, (n,))
    )
    if not scalar and np.isfinite(opposite).any():
        raise ValueError(
            "opposite_gaps are for scalar problems (dim 1): of a body between two obstacles the "
            "nodes of each face have gaps to the one that they face"
        )
    gaps = _limits("gaps", gaps, (n,)) if scalar else bounded("gaps", gaps, (n,), checks.VAST)
    _check_room(gaps, opposite)
    return gaps, opposite


def _check_room(gaps: np.ndarray, opposite: np.ndarray) -> None:
    """Raise ValueError unless each node has an obstacle, and room between two: ``gaps`` and ``opposite``
    (n,) are those along the normal and against it, m, infinite where there is none."""
    # -g' < g, and one of the two finite; the negation catches NaN
    bad = ~(gaps + opposite > 0) | np.isinf(np.minimum(gaps, opposite))
    if bad.any():
        i = int(np.argmax(bad))
        raise ValueError(
            f"contact node {i} must have a finite limit, and room between two, got "
            f"{-opposite[i]:.6g} to {gaps[i]:.6g} along its normal; leave out nodes without a limit, and "
            "prescribe values (fixed, fixed_values) in place of equal limits"
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Bounds(checks.Checked):
    """Limits of unknowns, lower <= u <= upper, for :class:`adaptmg.DiscreteProblem`.

    Parameters
    ----------
    lower, upper : float or array, optional
        Of a scalar problem, with one unknown a node (a membrane, torsion, a pressure), a number or
        one a node, (n_nodes,). Of a body (n_nodes, dim), in Cartesian components: at most one finite
        limit a node, which is then a contact node. Infinite or None: no limit.
    weights : (n_nodes,) array, optional
        Lumped masses, to turn nodal forces into pressures. Default 1.

    Examples
    --------
    A rod of three free nodes over a floor at -0.1:

    >>> from scipy import sparse
    >>> rod = sparse.diags_array([-np.ones(4), 2 * np.ones(5), -np.ones(4)], offsets=[-1, 0, 1])
    >>> discrete = am.DiscreteProblem(matrix=rod, load=np.full(5, -0.1), bounds=am.Bounds(lower=-0.1),
    ...                               fixed=np.array([True, False, False, False, True]))
    >>> result = am.solve(discrete, am.SingleGrid())
    >>> result.displacement[:, 0].round(3).tolist()
    [0.0, -0.1, -0.1, -0.1, 0.0]
    """

    lower: Annotated[ArrayLike, _numbers] | None = None
    upper: Annotated[ArrayLike, _numbers] | None = None
    weights: Annotated[ArrayLike, _numbers] | None = None

    def __post_init__(self) -> None:
        """Refuse numbers that cross; arrays may cross at fixed dofs, which have no limits."""
        super().__post_init__()
        if self.lower is None or self.upper is None:
            return
        if np.ndim(self.lower) == np.ndim(self.upper) == 0 and np.greater(self.lower, self.upper):
            raise ValueError(f"lower must be <= upper, got {self.lower} and {self.upper}")

    def at_nodes(self, fixed: np.ndarray) -> ContactNodes:
        """Return the contact nodes of a problem: those with a finite limit, without the limits of the
        ``fixed`` dofs, a mask (n_dofs,)."""
        gaps = self._gaps(fixed)
        is_limited = np.isfinite(gaps)
        n_limits = is_limited.sum(axis=(1, 2))
        nodes = np.flatnonzero(n_limits)
        weights = self.weights
        if weights is not None:
            weights = bounded("bounds.weights", weights, (len(gaps),))[nodes]
        # limits need not include 0, where gaps would be >= 0
        limited = partial(ContactNodes, nodes=nodes, weights=weights, allow_interference=True)
        dim = gaps.shape[1]
        if dim == 1:  # a scalar unknown may have both limits
            return limited(
                normals=np.ones((len(nodes), 1)),
                gaps=gaps[nodes, 0, 1],
                opposite_gaps=gaps[nodes, 0, 0],
            )
        if (n_limits > 1).any():
            raise ValueError(
                f"bounds: node {np.argmax(n_limits > 1)} has several finite limits, a node of a body "
                "can have one: give the nodes of each face of the body the limit that it meets"
            )
        # the normal of a node is the axis of its limited component, or minus this axis; with one limit a
        # node the entries of the mask are in the order of the nodes
        _, component, side = np.nonzero(is_limited)
        normals = np.eye(dim)[component] * np.where(side == 1, 1.0, -1.0)[:, None]
        return limited(normals=normals, gaps=gaps[is_limited])

    def _gaps(self, fixed: np.ndarray) -> np.ndarray:
        """Return the gaps (n_nodes, dim, 2) of each component to its limits: side 0 is against the
        axis, -u <= -lower, side 1 along it, u <= upper; infinite without a limit, and at the ``fixed``
        dofs (n_dofs,)."""
        lower = -np.inf if self.lower is None else self.lower
        upper = np.inf if self.upper is None else self.upper
        # two numbers have no shape, and limit every dof
        shape = max(np.shape(lower), np.shape(upper), key=len) or fixed.shape
        if math.prod(shape) != len(fixed):
            raise ValueError(f"bounds must have {len(fixed)} entries, one a dof, got shape {shape}")
        against_axes = -_open_limits("bounds.lower", lower, shape, closing=np.inf)
        along_axes = _open_limits("bounds.upper", upper, shape, closing=-np.inf)
        gaps = np.where(fixed[:, None], np.inf, np.stack([against_axes, along_axes], axis=1))
        dim = shape[1] if len(shape) == 2 else 1
        return gaps.reshape(-1, dim, 2)


def _open_limits(name: str, limit: ArrayLike, shape: tuple[int, ...], closing: float) -> np.ndarray:
    """Return limits (n_dofs,) from a number for all dofs or an array of this shape; ValueError if one is
    the infinity ``closing``, which no displacement satisfies."""
    limits = _limits(name, np.full(shape, limit) if np.ndim(limit) == 0 else limit, shape)
    if (limits == closing).any():
        raise ValueError(f"{name} must be {'<' if closing > 0 else '>'} {closing}, got {closing}")
    return limits.reshape(-1)


def _checked_masters(value: object) -> tuple[str, ...]:
    """Return the names of masters, "" of rigid obstacles, checked."""
    return tuple(
        checks.boundary_name(f"masters[{i}]", name) if name else ""
        for i, name in enumerate(checks.listed("masters", value, "names"))
    )


# entries of matrices and nodal forces beyond these come from no physical problem: their squares leave
# 1e28 of the range of double precision for sums; half and twice change none of 160 pairs
LARGEST = 1e140
SMALLEST = 1 / LARGEST


def bounded(
    name: str, value: object, shape: tuple[int | None, ...], largest: float = LARGEST
) -> np.ndarray:
    """Return a read-only copy as float64; ValueError for entries above ``largest``, by default the
    largest whose energies do not overflow."""
    result = checks.array(name, value, shape)
    if not (size := largest_entry(result)) <= largest:
        raise ValueError(f"{name} must be at most {largest:g} in SI units, got {size:.3g}")
    return result


def largest_entry(values: np.ndarray) -> float:
    """Return the largest magnitude of an array; 0 of an empty one."""
    return max(values.max(initial=0.0), -values.min(initial=0.0))


def check_size(name: str, size: float) -> None:
    """Raise ValueError if the largest entry of a matrix or load is too small or too large for a
    physical problem."""
    if size and not SMALLEST <= size <= LARGEST:
        raise ValueError(
            f"{name}: its largest entry {size:.3g} is out of range, {SMALLEST:g} to {LARGEST:g}: choose "
            "units in which numbers are nearer to 1"
        )


def checked_mask(name: str, value: object, n: int | None = None) -> np.ndarray:
    """Return a read-only boolean mask over dofs: the array itself if it is read-only and owns its data,
    else a copy."""
    # the entries of a list stay objects, or numpy would turn True in [True, 1] into a number
    mask = np.asarray(value) if hasattr(value, "dtype") else np.array(value, dtype=object)
    if mask.dtype != bool and not all(
        isinstance(entry, (bool, np.bool_)) for entry in mask.ravel()
    ):
        raise TypeError(f"{name} must be a boolean mask over the dofs, got {checks.shown(value)}")
    if mask.ndim != 1 or (n is not None and len(mask) != n):
        raise ValueError(f"{name} must have shape ({'n' if n is None else n},), got {mask.shape}")
    # a view (with a base) changes with the array that it shows
    if mask.dtype != bool or mask.base is not None or mask.flags.writeable:
        mask = mask.astype(bool)
        mask.flags.writeable = False
    return mask


def checked_bodies(bodies: Mapping[str, ArrayLike], n_nodes: int) -> dict[str, np.ndarray]:
    """Return the node numbers (n,) of each body by name, checked."""
    result = {}
    for body, nodes in checks.mapping("bodies", bodies, "names to arrays of nodes").items():
        name = f"bodies[{checks.boundary_name('the names in bodies', body)!r}]"
        numbers = checks.array(name, nodes, (None,), integer=True)
        if len(numbers) and not (numbers.min() >= 0 and numbers.max() < n_nodes):
            raise ValueError(
                f"{name} must be node numbers from 0 to {n_nodes - 1}, got {numbers.min()} to "
                f"{numbers.max()}"
            )
        result[body] = numbers
    return result


def checked_matrix(value: object, dim: int) -> sparse.bsr_array:
    """Return a stiffness matrix in blocks, symmetric with a positive diagonal."""
    matrix = checks.square_blocks("matrix", value, dim)
    scale = largest_entry(matrix.data)
    diagonal = matrix.diagonal()
    if not scale > 0:
        raise ValueError("matrix is zero")
    # once of all entries, and once of the diagonal, by which the check of symmetry divides
    check_size("matrix", scale)
    if not (diagonal > 0).all():
        i = int(np.argmin(diagonal))
        raise ValueError(
            f"matrix must have a positive diagonal; entry {i} (node {i // dim}) is {diagonal[i]:.3g}"
        )
    check_size("matrix", diagonal.max())
    _check_symmetry(matrix, diagonal)
    return matrix


def _check_symmetry(matrix: sparse.bsr_array, diagonal: np.ndarray) -> None:
    """Raise ValueError unless each block is the transpose of its counterpart, up to rounding. The
    difference is compared with sqrt(a_ii a_jj), a_ii the largest entry of node i on the ``diagonal``
    (n_dofs,), which bounds the entries of a positive definite matrix, so that errors in a soft part count."""
    difference = sparse.coo_array(matrix - matrix.T)
    dim = matrix.blocksize[0]
    scale = np.sqrt(diagonal.reshape(-1, dim).max(axis=1))
    rows, columns = (place // dim for place in difference.coords)
    asymmetry = np.abs(difference.data) / (scale[rows] * scale[columns])
    if asymmetry.max(initial=0.0) > checks.ALIKE:
        worst = int(np.argmax(asymmetry))
        raise ValueError(
            f"matrix must be symmetric; |A - A'| reaches {asymmetry[worst]:.2g} of the diagonal, between "
            f"nodes {rows[worst]} and {columns[worst]}"
        )


def check_bounds(law: Law, n: int) -> None:
    """Raise unless a law, which may be user-defined, has limits and coefficients >= 0 at n contact
    nodes."""
    bounds = law.bounds(n)
    if not isinstance(bounds, (tuple, list)) or len(bounds) != 2:
        raise TypeError(
            f"law: bounds(n_contact) must return the nodal limit and friction, got {checks.shown(bounds)}"
        )
    for name, bound in zip(("limit", "friction"), bounds, strict=True):
        if not (bounded(f"law: the nodal {name}", bound, (n,)) >= 0).all():
            raise ValueError(f"law: the nodal {name} must be finite and >= 0")
