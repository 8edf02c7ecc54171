r"""L2 projections: with the consistent mass matrix, a lumped one, the dual basis, and on patches of nodes.

.. math:: M P = B, \qquad M_{ik} = \int \varphi^f_i \varphi^f_k, \qquad B_{ij} = \int \varphi^f_i \varphi^c_j

P is full, but its entries decay exponentially with distance. It is found by the Chebyshev semi-iteration with the
diagonal of M, whose spectrum lies in [1/2, (d + 2)/2] on every mesh (Wathen, IMA J. Numer. Anal. 7 (1987) 449-457), on
sparse iterates from which small entries are dropped.

Lumped: :math:`P = D^{-1} B`, :math:`D_{ii} = \int \varphi^f_i`. Pseudo-L2 is tested with the dual basis instead, so
that no mass matrix is solved for:

.. math:: P = D^{-1} B^\psi, \qquad B^\psi_{ij} = \int \psi_i\, \varphi^c_j, \qquad
          \int_e \psi_i\, \varphi^f_k = \delta_{ik} \int_e \varphi^f_i \;\text{ on every element } e,

which on a simplex in d dimensions gives :math:`\psi_i = (d + 2)\,\varphi^f_i - 1`. Dickopf and Krause, Evaluating local
approximations of the L2-orthogonal projection between non-nested finite element spaces, Numer. Math. Theory Methods
Appl. 7 (2014) 288-316; dual basis: Wohlmuth, SIAM J. Numer. Anal. 38 (2000) 989-1012.

Quasi-interpolation of Clement type (RAIRO Anal. Numer. 9 (1975) 77-84) projects onto affine functions on the patch
:math:`\omega_i` of fine elements around the node :math:`x_i` and evaluates there. With
:math:`q(x) = (1, (x - x_i)/h_i)`

.. math:: (Pu)_i = c_i\cdot\int_{\omega_i} q\, u, \qquad G_i c_i = (1, 0, \dots, 0), \qquad
          G_i = \int_{\omega_i} q\, q^T .
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from scipy import sparse

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.transfer.contact_rows import with_contact_rows
from adaptmg.transfer.location import OUTSIDE_TOLERANCE
from adaptmg.transfer.projections.mixed_mass import MixedMass, Patches, mixed_mass
from adaptmg.transfer.rows import CLIP, clipped_rows, dropped, normalised

__all__ = ["L2", "LumpedL2", "PseudoL2", "QuasiInterpolation"]


Rows = TypeVar("Rows", np.ndarray, sparse.csr_array)


@dataclass(frozen=True, kw_only=True)
class L2:
    """The L2 projection.

    Row sums 1; entries may be negative. Reproduces constants always and, as the moments of a row are restored after
    entries were dropped, affine fields where the coarse mesh covers the fine one. On nested meshes it is the canonical
    embedding. The most expensive transfer, with the densest matrices. Integrals:
    :mod:`adaptmg.transfer.projections.mixed_mass`.

    Parameters
    ----------
    drop_tolerance : float
        Entries of smaller magnitude are removed (rows sum to 1), at least ``CLIP``. The mass system is solved to a
        hundredth of this. A row that cannot have its moments so, of a node next to a coarse one, is that of
        :class:`PseudoL2`, which differs by less.
    outside_tolerance : float
        How far outside the coarse mesh a fine node may lie, over the longest edge of the nearest coarse element.
    """

    drop_tolerance: float = 1e-3
    outside_tolerance: float = OUTSIDE_TOLERANCE

    def __post_init__(self) -> None:
        checks.nonnegative("outside_tolerance", self.outside_tolerance)
        if not CLIP <= checks.number("drop_tolerance", self.drop_tolerance) < 0.1:
            raise ValueError(f"drop_tolerance must be at least {CLIP:g} and below 0.1, got {self.drop_tolerance!r}")

    def build(self, coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array:
        """Nodal prolongation (n_fine, n_coarse); errors as :meth:`adaptmg.transfer.Interpolation.build`."""
        integrals = mixed_mass(coarse, fine, self.outside_tolerance)
        rhs = integrals.assemble(integrals.shape_coefficients())
        mass = mass_matrix(fine)
        centre = coarse.points.mean(axis=0)
        # coordinate functions, projected to rounding: what the rows must reproduce after dropping
        affine = np.column_stack([np.ones(coarse.n_nodes), coarse.points - centre])
        moments = _chebyshev(mass, rhs @ affine, fine.dim, 1e-16, 0.0)
        moments[:, 1:] -= (fine.points - centre) * moments[:, :1]
        moments /= moments[:, :1]
        inner = 0.01 * self.drop_tolerance
        rows = _chebyshev(mass, rhs, fine.dim, inner, inner)
        rows.sort_indices()
        result, reached = clipped_rows(rows, coarse, fine, tolerance=self.drop_tolerance, moments=moments)
        missed = np.flatnonzero(~reached)
        return with_contact_rows(result, missed, _pseudo(integrals)[missed]) if len(missed) else result


def mass_matrix(mesh: MeshArrays) -> sparse.csr_array:
    """P1 mass matrix (n_nodes, n_nodes), m^2 or m^3."""
    k = mesh.elements.shape[1]
    blocks = (np.eye(k) + 1.0) * (mesh.volumes / (k * (k + 1)))[:, None, None]
    rows, columns = np.repeat(mesh.elements, k, axis=1).ravel(), np.tile(mesh.elements, (1, k)).ravel()
    return sparse.csr_array((blocks.ravel(), (rows, columns)), shape=(mesh.n_nodes, mesh.n_nodes))


def _chebyshev(mass: sparse.csr_array, rhs: Rows, dim: int, tolerance: float, drop: float) -> Rows:
    """Solve M X = B to ``tolerance`` relative in the norm of M; sparse iterates lose entries below ``drop``."""
    inverse = sparse.diags_array(1.0 / mass.diagonal()).tocsr()
    low, high = 0.5, (dim + 2) / 2
    middle, half = (high + low) / 2, (high - low) / 2
    sigma = middle / half
    scaled_mass, scaled_rhs = inverse @ mass, inverse @ rhs
    solution = step = scaled_rhs / middle
    root = np.sqrt(high / low)
    steps = int(np.ceil(np.log(2 / tolerance) / np.log((root + 1) / (root - 1))))
    rho = 1 / sigma
    for _ in range(steps):
        residual = scaled_rhs - scaled_mass @ solution
        rho, previous = 1 / (2 * sigma - rho), rho
        step = rho * previous * step + 2 * rho / half * residual
        solution = solution + step
        if drop > 0:
            step, solution = dropped(step, drop), dropped(solution, drop)
    return solution


@dataclass(frozen=True, kw_only=True)
class LumpedL2:
    """Averages of the coarse function, weighted by the fine shape functions.

    Entries are >= 0 with row sums 1. Reproduces constants only: an affine field is evaluated at the centre of gravity
    of the shape function, which is not the node unless the patch is symmetric, and never is on the boundary. For
    comparison; :class:`adaptmg.transfer.PseudoL2` costs the same and does better. Integrals:
    :mod:`adaptmg.transfer.projections.mixed_mass`.

    Parameters
    ----------
    outside_tolerance : float
        How far outside the coarse mesh a fine node may lie, over the longest edge of the nearest coarse element.
    """

    outside_tolerance: float = OUTSIDE_TOLERANCE

    def __post_init__(self) -> None:
        checks.nonnegative("outside_tolerance", self.outside_tolerance)

    def build(self, coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array:
        """Nodal prolongation (n_fine, n_coarse); errors as :meth:`adaptmg.transfer.Interpolation.build`."""
        integrals = mixed_mass(coarse, fine, self.outside_tolerance)
        weighted = integrals.assemble(integrals.shape_coefficients())
        data = weighted.data / np.repeat(integrals.lumped_mass, np.diff(weighted.indptr))
        result = sparse.csr_array((data, weighted.indices, weighted.indptr), shape=weighted.shape)
        return normalised(dropped(result, CLIP))


@dataclass(frozen=True, kw_only=True)
class PseudoL2:
    """The local projection closest to the true L2 projection.

    Row sums 1; entries may be negative, so that it proves nothing for the monotone correction (interpolate the contact
    rows there: :func:`adaptmg.transfer.with_contact_rows`). Reproduces constants always, and affine fields at fine
    nodes whose elements the coarse mesh covers. On nested meshes it is the canonical embedding. Integrals are exact
    where the coarse mesh covers the fine element: :mod:`adaptmg.transfer.projections.mixed_mass`.

    Parameters
    ----------
    outside_tolerance : float
        How far outside the coarse mesh a fine node may lie, over the longest edge of the nearest coarse element.
    """

    outside_tolerance: float = OUTSIDE_TOLERANCE

    def __post_init__(self) -> None:
        checks.nonnegative("outside_tolerance", self.outside_tolerance)

    def build(self, coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array:
        """Nodal prolongation (n_fine, n_coarse); errors as :meth:`adaptmg.transfer.Interpolation.build`."""
        return _pseudo(mixed_mass(coarse, fine, self.outside_tolerance))


def _pseudo(integrals: MixedMass) -> sparse.csr_array:
    """Rows of the pseudo-L2 projection."""
    coefficients = (integrals.fine.dim + 2) * integrals.shape_coefficients() - 1.0
    coefficients /= integrals.lumped_mass[integrals.patches.nodes][:, None]
    return clipped_rows(integrals.assemble(coefficients), integrals.coarse, integrals.fine)[0]


@dataclass(frozen=True, kw_only=True)
class QuasiInterpolation:
    """Clement quasi-interpolation on fine patches.

    Row sums 1; entries may be negative. Reproduces constants always, and affine fields at fine nodes whose patch the
    coarse mesh covers. Unlike the other affine transfers it is no projection: on nested meshes it smooths the kinks of
    the coarse function. Integrals: :mod:`adaptmg.transfer.projections.mixed_mass`.

    Parameters
    ----------
    outside_tolerance : float
        How far outside the coarse mesh a fine node may lie, over the longest edge of the nearest coarse element.
    """

    outside_tolerance: float = OUTSIDE_TOLERANCE

    def __post_init__(self) -> None:
        checks.nonnegative("outside_tolerance", self.outside_tolerance)

    def build(self, coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array:
        """Nodal prolongation (n_fine, n_coarse); errors as :meth:`adaptmg.transfer.Interpolation.build`."""
        integrals = mixed_mass(coarse, fine, self.outside_tolerance)
        coefficients = _patch_coefficients(fine, integrals.patches)
        return clipped_rows(integrals.assemble(coefficients), coarse, fine)[0]


def _patch_coefficients(fine: MeshArrays, patches: Patches) -> np.ndarray:
    """c_i . q(x_k) at the corners k of every element of the patch of i (n_incidences, dim + 1)."""
    k = fine.dim + 1
    node, first = patches.nodes, patches.indptr[:-1]
    relative = fine.points[fine.elements[patches.elements]] - fine.points[node][:, None, :]
    size = np.maximum.reduceat(np.abs(relative).max(axis=(1, 2)), first)
    q = np.concatenate([np.ones((len(node), k, 1)), relative / size[node][:, None, None]], axis=2)
    # integral of q q' over an element, from the values of q at its corners
    total = q.sum(axis=1)
    gram = np.einsum("pka,pkb->pab", q, q) + total[:, :, None] * total[:, None, :]
    gram *= (fine.volumes[patches.elements] / (k * (k + 1)))[:, None, None]
    right = np.zeros((fine.n_nodes, k, 1))
    right[:, 0] = 1.0
    c = np.linalg.solve(np.add.reduceat(gram, first, axis=0), right)[:, :, 0]
    return np.einsum("pka,pa->pk", q, c[node])
