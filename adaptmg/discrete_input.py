"""What the arrays and matrices of a discrete problem must be: shapes, sizes, symmetry. Checked once, by discrete.py."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import sparse

from adaptmg.problem import check_arrays, checks
from adaptmg.problem.laws import Law

__all__ = ["SMALLEST", "bounded", "check_bounds", "check_size", "checked_bodies", "checked_mask", "checked_matrix",
           "with_positive_diagonal"]

# entries of matrices and nodal forces beyond these come from no physical problem: energies leave the range of float64
LARGEST, SMALLEST = 1e140, 1e-140
_ASYMMETRY = 1e-8


def bounded(name: str, value: object, shape: tuple[int | None, ...], largest: float = LARGEST) -> np.ndarray:
    """A read-only copy as float64, of a size that energies bear."""
    result = check_arrays.array(name, value, shape)
    size = np.abs(result).max(initial=0.0)
    if not size <= largest:
        raise ValueError(f"{name} must be at most {largest:g} in SI units, got {size:.3g}")
    return result


def check_size(name: str, size: float) -> None:
    """ValueError if the largest entry of a matrix or load is none that a physical problem can have."""
    if size and not SMALLEST <= size <= LARGEST:
        raise ValueError(f"{name}: its largest entry {size:.3g} is out of range, {SMALLEST:g} to {LARGEST:g}: choose "
                         "units in which numbers are nearer to 1")


def checked_mask(name: str, value: object, n: int | None = None) -> np.ndarray:
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


def checked_bodies(bodies: object, n_nodes: int) -> dict[str, np.ndarray]:
    """Nodes by body, checked."""
    checks.instance("bodies", bodies, Mapping, "a mapping of names to arrays of nodes")
    result = {checks.boundary_name("the names in bodies", name): check_arrays.array(f"bodies[{name!r}]", nodes, (None,),
                                                                              integer=True)
              for name, nodes in bodies.items()}
    for name, nodes in result.items():
        if len(nodes) and not (nodes.min() >= 0 and nodes.max() < n_nodes):
            raise ValueError(f"bodies[{name!r}] must be node numbers from 0 to {n_nodes - 1}, got {nodes.min()} to "
                             f"{nodes.max()}")
    return result


def checked_matrix(value: object, dim: int) -> sparse.bsr_array:
    """A stiffness matrix in blocks, symmetric with a positive diagonal."""
    matrix = check_arrays.square_blocks("matrix", value, dim)
    scale = np.abs(matrix.data).max(initial=0.0)
    if not scale > 0:
        raise ValueError("matrix is zero")
    check_size("matrix", scale)
    with_positive_diagonal(matrix)
    _check_symmetry(matrix, matrix.diagonal())
    return matrix


def with_positive_diagonal(matrix: sparse.bsr_array) -> sparse.bsr_array:
    """The matrix itself, if its diagonal is positive, of a size that a physical problem can have."""
    diagonal, dim = matrix.diagonal(), matrix.blocksize[0]
    if not (diagonal > 0).all():
        i = int(np.argmin(diagonal))
        raise ValueError(f"matrix must have a positive diagonal; entry {i} (node {i // dim}) is {diagonal[i]:.3g}")
    check_size("matrix", diagonal.max())
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


def check_bounds(law: Law, n: int) -> None:
    """Raise unless a law, a user's own perhaps, bears limits and coefficients >= 0 at n contact nodes."""
    bounds = law.bounds(n)
    if not isinstance(bounds, (tuple, list)) or len(bounds) != 2:
        raise TypeError(f"law: bounds(n_contact) must return the nodal limit and friction, got {checks.shown(bounds)}")
    for name, bound in zip(("limit", "friction"), bounds, strict=True):
        if not (bounded(f"law: the nodal {name}", bound, (n,)) >= 0).all():
            raise ValueError(f"law: the nodal {name} must be finite and >= 0")
