r"""Projections between two meshes: L2, lumped, with the dual basis, and onto affine functions on
patches.

All are sums of the integrals :math:`B^e_{ij} = \int_e \varphi^f_i\, \varphi^c_j` over fine elements
e,

.. math:: (P u)_i = \sum_{e \ni i} \sum_k a_{iek} \sum_j B^e_{kj} u_j .

Elements that the coarse mesh covers are integrated exactly, by clipping
(:mod:`adaptmg.geometry.clipping`); those that stick out of it (curved boundaries) by a positive
rule, exact for degree 7, whose points outside take the coarse value at the closest point: no part
of the fine mesh is lost, and :math:`\sum_j B^e_{ij} = \int_e \varphi^f_i`.

Dickopf and Krause compare them in Numer. Math. Theory Methods Appl. 7 (2014) 288-316.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar, cast

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._numba import inner_kernel, kernel
from adaptmg.geometry.clipping import PIECES, SNAP, common_moments
from adaptmg.geometry.location import affine_maps
from adaptmg.geometry.quadrature import simplex_rule
from adaptmg.geometry.search import STACK, bounding_box, overlapping, padded
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.transfer import interpolation
from adaptmg.transfer.contact import with_contact_rows

Rows = TypeVar("Rows", np.ndarray, sparse.csr_array)


class _Projection(ABC):
    def build(self, coarse: MeshArrays, fine: MeshArrays) -> sparse.csr_array:
        """Return the nodal prolongation (n_fine, n_coarse); errors as
        :meth:`adaptmg.transfer.Interpolation.build`."""
        return self._rows(mixed_mass(coarse, fine))

    @abstractmethod
    def _rows(self, integrals: MixedMass) -> sparse.csr_array:
        """Return the prolongation from the integrals of both meshes."""


@dataclass(frozen=True, kw_only=True)
class LumpedL2(_Projection):
    r"""Averages of the coarse function, weighted by the fine shape functions.

    :math:`P = D^{-1} B` with :math:`D_{ii} = \int \varphi^f_i`: entries >= 0, row sums 1. Reproduces constants only: an
    affine field is evaluated at the centre of gravity of the shape function, which on the boundary
    is never the node. For comparison; :class:`adaptmg.transfer.PseudoL2` costs the same and does
    better.

    Examples
    --------
    >>> len(am.Hierarchy.graded(am.cases.greco_bar(), sizes=(20e-3, 10e-3), transfer=am.LumpedL2()))
    2
    """

    def _rows(self, integrals: MixedMass) -> sparse.csr_array:
        weighted = integrals.assemble(integrals.shape_coefficients())
        weighted.data /= np.repeat(integrals.lumped_mass, np.diff(weighted.indptr))
        result = interpolation.dropped(weighted, interpolation.CLIP)
        result.data /= np.repeat(result.sum(axis=1), np.diff(result.indptr))
        return result


@dataclass(frozen=True, kw_only=True)
class PseudoL2(_Projection):
    r"""The local projection closest to the true L2 projection.

    It is tested with the dual basis, so that no mass matrix is solved for: on a simplex in d
    dimensions
    :math:`\psi_i = (d + 2)\,\varphi^f_i - 1` has :math:`\int_e \psi_i\, \varphi^f_k = \delta_{ik} \int_e \varphi^f_i`
    (Wohlmuth, SIAM J. Numer. Anal. 38 (2000) 989-1012, doi:10.1137/S0036142999350929).

    Row sums 1; entries may be negative, so that it proves nothing for the monotone correction
    (interpolate the contact rows there: :func:`adaptmg.transfer.with_contact_rows`). Reproduces
    constants always, and affine fields at fine nodes whose elements the coarse mesh covers. On
    nested meshes it is the canonical embedding.

    Examples
    --------
    >>> len(am.Hierarchy.graded(am.cases.greco_bar(), sizes=(20e-3, 10e-3), transfer=am.PseudoL2()))
    2
    """

    def _rows(self, integrals: MixedMass) -> sparse.csr_array:
        coefficients = (integrals.fine.dim + 2) * integrals.shape_coefficients() - 1.0
        nodes, _, _ = integrals.patches
        coefficients /= integrals.lumped_mass[nodes][:, None]
        return interpolation.clipped_rows(
            integrals.assemble(coefficients), integrals.coarse, integrals.fine
        )[0]


@dataclass(frozen=True, kw_only=True)
class QuasiInterpolation(_Projection):
    r"""Clement quasi-interpolation (RAIRO Anal. Numer. 9 (1975) 77-84) on fine patches.

    It projects onto affine functions on the patch :math:`\omega_i` of the fine node :math:`x_i` and
    evaluates there: with :math:`q(x) = (1, (x - x_i)/h_i)` and :math:`G_i = \int_{\omega_i} q\,
    q^T`,

    .. math:: (Pu)_i = c_i\cdot\int_{\omega_i} q\, u, \qquad G_i c_i = (1, 0, \dots, 0).

    Row sums 1; entries may be negative. Reproduces constants always, and affine fields at fine
    nodes whose patch the coarse mesh covers. Unlike the other affine transfers it is not a
    projection: on nested meshes it smooths the kinks of the coarse function.

    Examples
    --------
    >>> bar = am.cases.greco_bar()
    >>> len(am.Hierarchy.graded(bar, sizes=(20e-3, 10e-3), transfer=am.QuasiInterpolation()))
    2
    """

    def _rows(self, integrals: MixedMass) -> sparse.csr_array:
        nodes, elements, _ = integrals.patches
        coefficients = _patch_coefficients(integrals.fine, nodes, elements)
        return interpolation.clipped_rows(
            integrals.assemble(coefficients), integrals.coarse, integrals.fine
        )[0]


def _patch_coefficients(fine: MeshArrays, node: np.ndarray, element: np.ndarray) -> np.ndarray:
    """Return c_i . q(x_k) of :class:`QuasiInterpolation` at the corners k of each element of the
    patch of each node i: (n_incidences, dim + 1). ``node`` and ``element`` (n_incidences,) are i and the
    element, by ascending i."""
    k = fine.dim + 1
    # the first incidence of each node
    first = np.searchsorted(node, np.arange(fine.n_nodes))
    relative = fine.points[fine.elements[element]] - fine.points[node][:, None, :]
    size = np.maximum.reduceat(np.abs(relative).max(axis=(1, 2)), first)
    q = np.concatenate([np.ones((len(node), k, 1)), relative / size[node][:, None, None]], axis=2)
    # integral of q q' over an element, |T| (sum_k q_k q_k' + total total') / (k (k + 1)), from the values
    # q_k at its k = dim + 1 corners and their sum
    total = q.sum(axis=1)
    gram = np.einsum("pka,pkb->pab", q, q) + total[:, :, None] * total[:, None, :]
    gram *= (fine.volumes[element] / (k * (k + 1)))[:, None, None]
    right = np.zeros((fine.n_nodes, k, 1))
    right[:, 0] = 1.0
    c = np.linalg.solve(np.add.reduceat(gram, first, axis=0), right)[:, :, 0]
    return np.einsum("pka,pa->pk", q, c[node])


# half keeps 19 % more entries of the prolongations of 8 random pairs, twice 17 % fewer; always 59 cycles
_DROP = 1e-3
"""Entries of the L2 projection of smaller magnitude are removed; the mass system is solved to a hundredth of this."""


@dataclass(frozen=True, kw_only=True)
class L2(_Projection):
    r"""The L2 projection: the densest matrices, and the most expensive.

    :math:`M P = B` with the consistent mass matrix M. P is full, but its entries decay exponentially with distance. It
    is found by the Chebyshev semi-iteration with the diagonal of M, whose spectrum lies in [1/2, (d
    + 2)/2] on every mesh (Wathen, IMA J. Numer. Anal. 7 (1987) 449-457,
    doi:10.1093/imanum/7.4.449), on sparse iterates from which small entries are dropped.

    Row sums 1; entries may be negative. Reproduces constants always and, as the moments of a row
    are restored after entries were dropped, affine fields where the coarse mesh covers the fine
    one. On nested meshes it is the canonical embedding. A row that cannot have its moments so, of a
    node next to a coarse one, is that of :class:`PseudoL2`.

    Examples
    --------
    >>> len(am.Hierarchy.graded(am.cases.greco_bar(), sizes=(20e-3, 10e-3), transfer=am.L2()))
    2
    """

    def _rows(self, integrals: MixedMass) -> sparse.csr_array:
        coarse = integrals.coarse
        fine = integrals.fine
        rhs = integrals.assemble(integrals.shape_coefficients())
        mass = mass_matrix(fine)
        centre = coarse.points.mean(axis=0)
        # coordinate functions, projected to rounding: what the rows must reproduce after dropping
        affine = np.column_stack([np.ones(coarse.n_nodes), coarse.points - centre])
        moments = _chebyshev(mass, rhs @ affine, fine.dim, tolerance=1e-16, drop=0.0)
        # column 0 is the projection of 1, as the row sums of B are those of M: 1 up to rounding
        moments[:, 1:] -= (fine.points - centre) * moments[:, :1]
        moments /= moments[:, :1]
        # iterates lose entries below a hundredth of what is dropped from the rows in the end
        inner = 0.01 * _DROP
        rows = _chebyshev(mass, rhs, fine.dim, inner, inner)
        rows.sort_indices()
        result, reached = interpolation.clipped_rows(
            rows, coarse, fine, tolerance=_DROP, moments=moments
        )
        # rows that cannot have their moments any more are replaced by those of the local projection
        missed = np.flatnonzero(~reached)
        return (
            with_contact_rows(result, missed, PseudoL2()._rows(integrals)[missed])
            if len(missed)
            else result
        )


def mass_matrix(mesh: MeshArrays) -> sparse.csr_array:
    """Return the P1 mass matrix (n_nodes, n_nodes), m^2 or m^3."""
    k = mesh.elements.shape[1]
    # |T| (1 + delta_ab) / (k (k + 1))
    blocks = (np.eye(k) + 1.0) * (mesh.volumes / (k * (k + 1)))[:, None, None]
    rows = np.repeat(mesh.elements, k, axis=1).ravel()
    columns = np.tile(mesh.elements, (1, k)).ravel()
    return sparse.csr_array((blocks.ravel(), (rows, columns)), shape=(mesh.n_nodes, mesh.n_nodes))


def _chebyshev(mass: sparse.csr_array, rhs: Rows, dim: int, tolerance: float, drop: float) -> Rows:
    """Solve M X = B to ``tolerance`` relative in the norm of M by Chebyshev's iteration (Saad,
    Iterative Methods for Sparse Linear Systems, 2003, algorithm 12.1) for D^-1 M, D the diagonal;
    sparse iterates lose entries below ``drop``."""
    inverse = sparse.diags_array(1.0 / mass.diagonal()).tocsr()
    # on any mesh the eigenvalues of D^-1 M lie between these two (Wathen 1987)
    low = 0.5
    high = (dim + 2) / 2
    middle = (high + low) / 2
    half = (high - low) / 2
    sigma = middle / half
    scaled_mass = inverse @ mass
    scaled_rhs = cast("Any", inverse @ rhs)  # scipy-stubs: sparse or dense as rhs is
    step = scaled_rhs / middle
    solution = step
    root = np.sqrt(high / low)
    steps = int(np.ceil(np.log(2 / tolerance) / np.log((root + 1) / (root - 1))))
    rho = 1 / sigma
    for _ in range(steps):
        residual = scaled_rhs - scaled_mass @ solution
        previous = rho
        rho = 1 / (2 * sigma - previous)
        step = rho * previous * step + 2 * rho / half * residual
        solution = solution + step
        if drop > 0:
            step = interpolation.dropped(step, drop)
            solution = interpolation.dropped(solution, drop)
    return cast("Any", solution)


COVERED = checks.ALIKE
"""An element of which more than this share lies outside the coarse mesh is integrated by quadrature."""


@dataclass(frozen=True, eq=False)
class MixedMass:
    """The integrals B^e, element by element."""

    coarse: MeshArrays
    fine: MeshArrays
    elements: np.ndarray  # (n_entries,): fine elements
    columns: np.ndarray  # (n_entries,): coarse nodes; one may occur more than once in an element
    values: (
        np.ndarray
    )  # (n_entries, dim + 1): integrals with the shape functions of the corners, m^2 or m^3

    @cached_property
    def patches(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return for each corner of a fine element (n_elements * (dim + 1),), node by node, the node, the
        element and the number of the corner."""
        k = self.fine.dim + 1
        order = np.argsort(self.fine.elements, axis=None, kind="stable")
        return self.fine.elements.ravel()[order], order // k, order % k

    def assemble(self, coefficients: np.ndarray) -> sparse.csr_array:
        """Return the sums over patches (n_fine, n_coarse) of the module docstring: the coefficients
        a_iek (node i, corner k of element e) times the integrals B_kj of each e."""
        k = self.fine.dim + 1
        nodes, elements, _ = self.patches
        # row k e + c of the integrals is that of corner c of element e
        rows = k * len(self.fine.elements)
        corners = k * self.elements[:, None] + np.arange(k)
        integrals = sparse.csr_array(
            (self.values.ravel(), (corners.ravel(), np.repeat(self.columns, k))),
            shape=(rows, self.coarse.n_nodes),
        )
        tests = sparse.csr_array(
            (
                coefficients.ravel(),
                (np.repeat(nodes, k), (k * elements[:, None] + np.arange(k)).ravel()),
            ),
            shape=(self.fine.n_nodes, rows),
        )
        result = tests @ integrals
        result.sort_indices()
        return checks.narrowed(result)

    def shape_coefficients(self) -> np.ndarray:
        """Return coefficients that test with the shape function of the node: a_iek = 1 at the
        corner i of e, else 0."""
        return np.eye(self.fine.dim + 1)[self.patches[2]]

    @cached_property
    def lumped_mass(self) -> np.ndarray:
        """Return the integrals of the fine shape functions (n_fine,), m^2 or m^3."""
        share = np.repeat(self.fine.volumes / (self.fine.dim + 1), self.fine.dim + 1)
        return np.bincount(self.fine.elements.ravel(), weights=share, minlength=self.fine.n_nodes)


def mixed_mass(coarse: MeshArrays, fine: MeshArrays) -> MixedMass:
    """Return the integrals of two meshes, body by body."""
    # both are called for their checks alone: nodes outside the coarse mesh, and nodes without elements
    interpolation.locate_nodes(coarse, fine)
    interpolation.nodes_of_bodies(fine)
    parts = []
    for body, locator in interpolation.body_locators(coarse, fine):
        elements = (
            np.arange(len(fine.elements))
            if body is None
            else np.flatnonzero(fine.element_body == body)
        )
        parts += _body_entries(locator, fine, elements)
    return MixedMass(coarse, fine, *(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def overlaps(coarse: MeshArrays, fine: MeshArrays, density: np.ndarray) -> sparse.csr_array:
    """Return the mass (n_fine_elements, n_coarse_elements) in the common part of each fine and coarse
    element, for a ``density`` (n_fine_nodes,) that is linear in each fine element. The mass of fine
    elements outside the coarse mesh counts to the nearest coarse elements. No two coarse elements
    may share a node."""
    integrals = mixed_mass(coarse, fine)
    weights = density[fine.elements[integrals.elements]]
    masses = np.einsum("ek,ek->e", integrals.values, weights)
    owner = np.empty(coarse.n_nodes, dtype=np.int64)
    owner[coarse.elements] = np.arange(len(coarse.elements))[:, None]
    shape = (len(fine.elements), len(coarse.elements))
    return sparse.csr_array((masses, (integrals.elements, owner[integrals.columns])), shape=shape)


def _body_entries(
    locator: interpolation.PointLocator, fine: MeshArrays, elements: np.ndarray
) -> list[tuple[np.ndarray, ...]]:
    """Return the entries of :class:`MixedMass` (fine elements (n,), coarse nodes (n,), integrals with the
    fine shape functions (n, dim + 1)) of fine ``elements`` (m,): of those that the coarse mesh covers, by
    clipping, and of the others, by quadrature."""
    k = fine.dim + 1
    covered = np.empty(len(elements))
    fine_points = padded(fine.points)
    tree = locator.tree
    fine_maps = affine_maps(fine_points, fine.elements)
    marker = np.full(locator.mesh.n_nodes, -1, dtype=np.int64)
    # rows of the tables at first, a guess: eight coarse elements for each fine one
    capacity = 8 * k * len(elements) + 64
    element = np.empty(capacity, np.int64)
    columns = np.empty(capacity, np.int32)
    values = np.empty((capacity, k))
    done = count = 0
    while True:
        done, count = clip_elements(
            fine_points,
            fine.elements,
            fine_maps,
            elements,
            done,
            count,
            tree.points,
            tree.simplices,
            locator.maps,
            tree.boxes,
            marker,
            covered,
            element,
            columns,
            values,
        )
        if done == len(elements):
            break
        # the tables are full: go on with tables twice as long
        element = np.concatenate([element, np.empty_like(element)])
        columns = np.concatenate([columns, np.empty_like(columns)])
        values = np.concatenate([values, np.empty_like(values)])
    whole = np.zeros(len(fine.elements), dtype=bool)
    whole[elements] = np.abs(covered - 1.0) <= COVERED
    entries = np.flatnonzero(whole[element[:count]])
    volumes = fine.volumes[element[entries]]
    clipped = element[entries], columns[entries], values[entries] * volumes[:, None]
    return [clipped, _quadrature(locator, fine, elements[~whole[elements]])]


def _quadrature(
    locator: interpolation.PointLocator, fine: MeshArrays, elements: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Return fine elements (n,), coarse nodes (n,) and integrals (n, dim + 1), as :class:`MixedMass`
    has them, over some fine elements by quadrature: each point has the coarse shape functions of the
    nearest point of the coarse mesh."""
    shape, weights = simplex_rule(fine.dim, 4)  # the rule of the module
    points = np.einsum("qv,evc->eqc", shape, fine.points[fine.elements[elements]])
    location = locator.locate(points.reshape(-1, fine.dim))
    columns = locator.mesh.elements[location.element]
    scaled = (
        location.weights.reshape(len(elements), len(weights), fine.dim + 1)
        * fine.volumes[elements][:, None, None]
    )
    values = np.einsum("eqj,q,qv->eqjv", scaled, weights, shape)
    return (
        np.repeat(elements, len(weights) * columns.shape[1]),
        columns.ravel(),
        values.reshape(-1, columns.shape[1]),
    )


@kernel
def clip_elements(
    points,
    elements,
    fine_maps,
    chosen,
    done,
    count,
    coarse_points,
    coarse,
    maps,
    boxes,
    marker,
    covered,
    element,
    columns,
    values,
):
    """Compute integrals over the fine elements ``chosen[done:]``, each scaled to volume 1. ``points``,
    ``elements`` and ``fine_maps`` are the nodes, elements and barycentric maps of the fine mesh,
    ``coarse_points``, ``coarse`` and ``maps`` those of the coarse one, with its tree of ``boxes``. Entries are
    written from position ``count`` on: fine element, coarse node and the integrals with the shape
    functions of the corners. ``covered`` (n_chosen,) gets the share of each element that the coarse
    mesh covers; ``marker`` (n_coarse,) is -1 throughout on entry and exit. Return the place among the
    ``chosen`` of the first element whose entries did not fit into the tables, len(chosen) if all did,
    and the number of entries before it."""
    k = elements.shape[1]
    mu = np.empty((k, k))
    moments = np.empty((k, k))
    pieces = np.empty((PIECES, 1 + 2 * k * k))
    levels = np.empty(PIECES, dtype=np.int64)
    stack = np.empty(STACK, dtype=np.int64)
    box = np.empty(2 * (k - 1))
    candidates = np.empty(len(coarse), np.int64)
    for c in range(done, len(chosen)):
        e = chosen[c]
        start = count
        covered[c] = 0.0
        bounding_box(points, elements[e], box)
        full = False
        for at in range(overlapping(boxes, box, coarse_points, coarse, stack, candidates)):
            s = candidates[at]
            if _separates(coarse_points, coarse[s], fine_maps, e, mu):
                continue
            # the second test leaves in mu the coarse coordinates of the fine corners
            if _separates(points, elements[e], maps, s, mu):
                continue
            share = common_moments(mu, k, pieces, levels, moments)
            full = count + k > len(columns)
            if full:
                break
            if share > 0.0:
                covered[c] += share
                count = _add_entries(coarse[s], mu, moments, marker, count, columns, values)
        for at in range(start, count):
            marker[columns[at]] = -1
            element[at] = e
        if full:
            # the entries of this element are written again, from ``start`` on, in longer tables
            return c, start
    return len(chosen), count


@kernel
def _separates(points, corners, maps, e, mu):
    """Return whether a face of element ``e`` parts it from the simplex of the nodes ``corners``
    (dim + 1,) among ``points``. The rows of ``maps`` are those of
    :func:`~adaptmg.geometry.location.affine_maps`: origin, then gradients. Writes the barycentric
    coordinate m of corner v at ``mu[v, m]``, snapped to zero: all of them only if no face does."""
    # coordinate by coordinate, not corner by corner: most pairs are parted by one of the first faces
    k = len(corners)
    dim = k - 1
    for v in range(k):
        mu[v, 0] = 1.0
    for m in range(1, k):
        largest = 0.0
        for v in range(k):
            value = 0.0
            for c in range(dim):
                value += maps[e, m * dim + c] * (points[corners[v], c] - maps[e, c])
            mu[v, 0] -= value
            mu[v, m] = value if abs(value) >= SNAP else 0.0
            largest = max(largest, mu[v, m])
        if largest == 0.0:
            return True
    largest = 0.0
    for v in range(k):
        if abs(mu[v, 0]) < SNAP:
            mu[v, 0] = 0.0
        largest = max(largest, mu[v, 0])
    return largest == 0.0


@inner_kernel
def _add_entries(coarse_corners, mu, moments, marker, count, columns, values):
    """Add the integrals of lambda_i mu_m = sum_v lambda_i lambda_v mu_m(v), with the shape functions
    lambda of the fine and mu of the coarse element and ``moments`` the integrals of lambda_i lambda_v
    over their common part, to the row of ``values`` of each coarse corner m; ``marker`` has the row of
    a coarse node, -1 if it has none. Returns the number of rows."""
    k = len(coarse_corners)
    for m in range(k):
        column = coarse_corners[m]
        at = marker[column]
        if at < 0:
            at = count
            marker[column] = at
            columns[at] = column
            values[at] = 0.0
            count += 1
        for i in range(k):
            total = 0.0
            for v in range(k):
                total += moments[i, v] * mu[v, m]
            values[at, i] += total
    return count
