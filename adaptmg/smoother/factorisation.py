r"""Sparse factors in a nested-dissection order, and the condensation of a problem onto its contact
dofs.

Nested dissection: a part of the graph is cut at the median of its longest extent; the nodes behind
the cut with a neighbour before it are the separator and go last, and both halves are cut again (A.
George, SIAM J. Numer. Anal. 10, 1973, doi:10.1137/0710032), all parts of a depth in one pass.
Against SuperLU's minimum-degree order, elasticity on 257 x 257 nodes takes half the time and a
fifth less fill; below 5k nodes nothing differs.

Condensation: with the contact dofs c and all others i,

.. math:: S = A_{cc} - A_{ci} A_{ii}^{-1} A_{ic},\qquad s = b_c - A_{ci} A_{ii}^{-1} b_i,\qquad
          w_i = A_{ii}^{-1} (b_i - A_{ic} w_c).

The matrix :math:`M = A + \Sigma`, :math:`\Sigma` the diagonal of A at the contact dofs and zero
elsewhere, is factorised as L U with the contact dofs last; elimination leaves :math:`L_{cc} U_{cc}
= S + \Sigma` on them. (:math:`\Sigma` makes M regular where only contact holds the body.) Solves
with :math:`A_{ii}` are solves with M whose right-hand side at c is chosen so that :math:`w_c` comes
out as required."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import SuperLU, splu

from adaptmg import _checks as checks
from adaptmg.discrete.elasticity import dofs_of
from adaptmg.discrete.problem import DiscreteProblem, remembered_of_structure
from adaptmg.smoother.conditions import Linearised
from adaptmg.smoother.interior_point import ContactDofs, Interior, Span
from adaptmg.smoother.system import LocalProblem, LocalSystem, local_system, turn_held

#: dofs up to which factorisations take over where cycles do not converge, by dimension
FACTORISED = {1: 200_000, 2: 200_000, 3: 60_000}
#: entries in a row of a matrix of linear elements
_ENTRIES = {1: 7, 2: 15, 3: 45}


def factorisable(problem: DiscreteProblem, most: Mapping[int, int] = FACTORISED) -> bool:
    """Return whether factors of the matrix take at most the work of ``most[dim]`` dofs of linear
    elements."""
    # a volume whose row has k entries joins k dofs, by k^2 entries, of which half are there already
    added = 0.5 * np.sum(np.diff(problem.volumes.rows.indptr).astype(float) ** 2)
    entries = problem.rows.nonzeros + added
    return bool(max(entries / _ENTRIES[problem.dim], problem.n_dofs) <= most[problem.dim])


@dataclass(frozen=True, eq=False)
class OrderedFactors:
    """The factors of a matrix by SuperLU."""

    lu: SuperLU  # of the permuted matrix
    order: np.ndarray  # (n_dofs,) int: elimination order
    diagonal: np.ndarray  # (n_dofs,): of the permuted matrix

    @classmethod
    def of(
        cls,
        matrix: sparse.csr_array | sparse.csc_array,
        order: np.ndarray,
        threshold: float = 0.0,
    ) -> OrderedFactors:
        """Return the factors of a matrix with the elimination ``order`` (n_dofs,). A pivot off the
        diagonal, which destroys the order, is taken only where the diagonal entry is smaller than
        ``threshold`` times the largest of its column."""
        permuted = matrix[order][:, order].tocsc()
        lu = splu(
            permuted,
            permc_spec="NATURAL",
            diag_pivot_thresh=threshold,
            options={"SymmetricMode": True},
        )
        return cls(lu, order, permuted.diagonal())

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Return the solution for a right-hand side (n_dofs,), both in the order of the matrix."""
        result = np.empty_like(rhs)
        result[self.order] = self.lu.solve(rhs[self.order])
        return result


@dataclass(frozen=True, eq=False)
class DenseFactors:
    """Factors by Cholesky's method of the rows and columns ``order`` of a matrix; other dofs stay
    at zero."""

    lower: np.ndarray  # (k, k)
    order: np.ndarray  # (k,) int: dofs in the order of elimination

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Return the solution (n_dofs,) for a right-hand side (n_dofs,), 0 at other dofs than ``order``."""
        result = np.zeros_like(rhs)
        result[self.order] = linalg.lapack.dpotrs(self.lower, rhs[self.order], lower=1)[0]
        return result


#: parts of at most this number of nodes are not cut
_LEAF = 4
#: base-3 digits that an int64 holds
_DEPTH = 38
#: nodes from which distances serve as coordinates
_LANDMARKS = 3


def node_graph(matrix: sparse.bsr_array) -> sparse.csr_array:
    """Return the graph (n_nodes, n_nodes) of the blocks of a matrix, all weights 1."""
    n = matrix.shape[0] // matrix.blocksize[0]
    return sparse.csr_array(
        (np.ones(len(matrix.indices)), matrix.indices, matrix.indptr), shape=(n, n)
    )


def nested_dissection(
    graph: sparse.csr_array, coordinates: np.ndarray | None = None, last: np.ndarray | None = None
) -> np.ndarray:
    """Return the order of elimination (n_nodes,) of the nodes of a graph with ``coordinates``
    (n_nodes, k), by default distances in the graph; the nodes ``last`` come last."""
    if coordinates is None:
        coordinates = graph_coordinates(graph)
    path = np.zeros(graph.shape[0], dtype=np.int64)
    if last is not None:
        path[last] = np.iinfo(np.int64).max
    _cut(graph, coordinates, path)
    return np.argsort(path, kind="stable")


def graph_coordinates(graph: sparse.csr_array) -> np.ndarray:
    """Return the distances in the graph (n, k) from nodes far from each other, in which
    connected parts are apart."""
    n_parts, part = connected_components(graph, directed=False)
    # a landmark in each part: the first one is farthest from any node there, each further one from
    # the landmarks before it
    any_nodes = np.unique(part, return_index=True)[1]
    to_nearest = _distances(graph, any_nodes)
    coordinates = []
    for _ in range(_LANDMARKS):
        landmarks = _farthest(to_nearest, part)
        coordinates.append(_distances(graph, landmarks))
        to_nearest = np.min(coordinates, axis=0)
    result = np.column_stack(coordinates)
    shift = result.max(initial=0.0) + 1
    return result + shift * part[:, None] if n_parts > 1 else result


def _distances(graph: sparse.csr_array, nodes: np.ndarray) -> np.ndarray:
    """Return the numbers of edges (n,) from each node of a graph to the nearest of some nodes."""
    return dijkstra(graph, directed=False, indices=nodes, unweighted=True, min_only=True)


def _farthest(distance: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Return for each part the node with the largest distance (n,); ``part`` (n,) has its number."""
    order = np.lexsort((distance, part))  # by part, then by distance
    last_of_part = np.append(np.diff(part[order]) != 0, True)
    return order[last_of_part]


def _cut(graph: sparse.csr_array, coordinates: np.ndarray, path: np.ndarray) -> None:
    """Write to ``path`` (n,), at nodes where it is 0, how the cuts divide the nodes: a digit in base 3
    for each depth, the most significant first, is 0 before the cut, 1 behind it and 2 on the
    separator. Sorted by path the nodes are in the order of elimination."""
    edges = sparse.coo_array(graph)
    row, column = edges.coords
    upper = row < column
    row = row[upper]
    column = column[upper]
    active = path == 0
    part = np.zeros(len(path), dtype=np.int64)
    behind = np.zeros(len(path), dtype=bool)
    separator = np.zeros(len(path), dtype=bool)
    # place value of the digit of each depth
    for digit in 3 ** np.arange(_DEPTH, -1, -1, dtype=np.int64):
        nodes = np.flatnonzero(active)
        if not len(nodes):
            return
        behind[nodes], is_leaf = _halves(coordinates[nodes], part[nodes])
        inside_part = (part[row] == part[column]) & active[row] & active[column]
        row = row[inside_part]
        column = column[inside_part]
        cut = behind[row] != behind[column]
        separator[:] = False
        # of the edges that are cut, the end behind the cut is on the separator
        separator[np.where(behind[row], row, column)[cut]] = True
        separator[nodes[is_leaf]] = False
        side = np.where(separator[nodes], 2, behind[nodes])
        path[nodes] += digit * np.where(is_leaf, 0, side)
        # both halves of part k get the numbers 2 k and 2 k + 1
        numbered = np.unique(part[nodes], return_inverse=True)[1]
        part[nodes] = 2 * numbered + behind[nodes]
        active[nodes[separator[nodes] | is_leaf]] = False


def _halves(coordinates: np.ndarray, part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return two masks of nodes (n,): which lie behind the median of their part along its longest
    extent, and which are in a part that is not cut. ``part`` (n,) numbers the part of each node;
    ``coordinates`` (n, k) are positions or, of a matrix without any, distances in its graph."""
    _, index, size = np.unique(part, return_inverse=True, return_counts=True)
    first = np.r_[0, np.cumsum(size)[:-1]]
    # extent, lowest and median coordinate of each part along each axis
    extent, low, middle = (np.empty((len(size), coordinates.shape[1])) for _ in range(3))
    for k, x in enumerate(coordinates.T):
        by_part = x[np.lexsort((x, index))]
        low[:, k] = by_part[first]
        middle[:, k] = by_part[first + size // 2]
        extent[:, k] = by_part[first + size - 1] - low[:, k]
    # the same along the axis of the longest extent
    axis = np.argmax(extent, axis=1)
    extent, low, middle = (
        np.take_along_axis(values, axis[:, None], axis=1)[:, 0] for values in (extent, low, middle)
    )
    x = np.take_along_axis(coordinates, axis[index][:, None], axis=1)[:, 0]
    # many equal values, as distances have, may put the median on the lowest: cut above it then
    cut_above = (middle == low)[index]
    behind = np.where(cut_above, x > middle[index], x >= middle[index])
    is_leaf = ((size <= _LEAF) | (extent == 0))[index]
    return behind & ~is_leaf, is_leaf


#: dofs up to which dense factors are quicker, and up to which they decide which dofs depend on others
_DENSE, _DENSE_AT_MOST = 300, 6000


class _Singular(ValueError):
    def __init__(self) -> None:
        super().__init__(
            "the problem is singular even with all contact dofs fixed: add a support, or check that every "
            "node belongs to an element"
        )


@dataclass(frozen=True, eq=False)
class Eliminated:
    """The Schur complement on the dofs of some nodes and the way back; see the module for the
    formulas."""

    factors: OrderedFactors | DenseFactors  # of M
    contact: np.ndarray  # (n,) int: dofs of these nodes, n = n_nodes * dim
    matrix: np.ndarray  # (n, n): S
    shift: np.ndarray  # (n,): diagonal of Sigma at these dofs

    def reduce(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r"""Return the interior solution (n_dofs,) of M w = r with r_c = 0, and the residual (n,) of the
        condensed problem, for a residual r (n_dofs,); one solve."""
        # with r_c = 0 the solution has (S + Sigma) w_c = -A_ci A_ii^-1 r_i
        rhs = residual.copy()
        rhs[self.contact] = 0.0
        particular = self.factors.solve(rhs)
        return particular, residual[self.contact] + self._stiffness(particular[self.contact])

    def complete(self, particular: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
        r"""Return the solution (n_dofs,) of :math:`A_{ii} w_i = r_i - A_{ic} w_c` for given
        :math:`w_c`; one solve."""
        rhs = np.zeros_like(particular)
        rhs[self.contact] = self._stiffness(unknowns - particular[self.contact])
        result = particular + self.factors.solve(rhs)
        result[self.contact] = unknowns
        return result

    def _stiffness(self, unknowns: np.ndarray) -> np.ndarray:
        """Return (S + Sigma) w_c (n,), the right-hand side of M at c that leads to w_c (n,)."""
        return self.matrix @ unknowns + self.shift * unknowns


@dataclass(frozen=True, eq=False)
class Condensed(Eliminated):
    """A contact problem on its contact dofs."""

    full: LocalProblem  # what was condensed

    @property
    def regular(self) -> bool:
        """Return whether the interior matrix is regular: no interior dof stays at zero."""
        return len(self.factors.order) == self.full.system.n_dofs

    @property
    def by_nodes(self) -> bool:
        """Return whether sweeps may solve node by node: the diagonal blocks S_kk are regular. S_kk d = 0
        for a motion d of node k that costs no energy while all other contact nodes are held. An
        example is a body that only contact holds, at two nodes: it turns about the other one.
        Rounding is relative to the diagonal of A."""
        n = len(self.full.system.nodes)
        dim = self.full.system.dim
        size = np.sqrt(self.shift).reshape(n, dim)
        blocks = self.matrix.reshape(n, dim, n, dim)[np.arange(n), :, np.arange(n)] / (
            size[:, :, None] * size[:, None]
        )
        return bool(np.linalg.eigvalsh(blocks).min(initial=1.0) > checks.ROUNDING)

    @cached_property
    def reduced(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the interior solution (n_dofs,) and the condensed load (n,); see :meth:`reduce`."""
        return self.reduce(self.full.load)

    @property
    def load(self) -> np.ndarray:
        """Return the condensed load s (n_contact * dim,)."""
        return self.reduced[1]

    @cached_property
    def problem(self) -> LocalProblem:
        """Return the condensed problem."""
        full = self.full
        dim = full.system.dim
        fixed = full.system.fixed[self.contact]
        # its nodes are the contact nodes alone
        dense = LocalSystem.from_matrix(
            matrix=sparse.bsr_array(self.matrix, blocksize=(dim, dim)),
            fixed=fixed,
            nodes=np.arange(len(full.system.nodes)),
        )
        turn_held(dense.diagonal, dense.nodes, full.contact.held)
        return replace(full, system=dense, load=np.where(fixed, 0.0, self.load))

    def restrict(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the entries (n_contact * dim,) at contact nodes of a vector over all dofs."""
        return unknowns[self.contact]

    def recover(self, unknowns: np.ndarray) -> np.ndarray:
        """Return all unknowns (n_dofs,) from those at the contact nodes (n_contact * dim,), local
        components."""
        # one step of iterative refinement of the interior, from its first solution; reduce returns the
        # interior solution first
        result = self.complete(self.reduced[0], unknowns)
        rest = self.full.load - self.full.system.matrix @ result
        return result + self.complete(self.reduce(rest)[0], np.zeros_like(unknowns))

    def posing(self, problem: DiscreteProblem) -> Condensed:
        """Return the condensation of a problem with the same structure."""
        return replace(self, full=local_system(problem, self.full.system))

    @property
    def stiffness(self) -> np.ndarray:
        """Return the diagonal (n_contact, dim) of S, N/m."""
        return self.matrix.diagonal().reshape(-1, self.full.system.dim)

    def contact_residual(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the interior solution (n_dofs,) of a residual r (n_dofs,), which :meth:`newton_change`
        takes, and the forces (n_contact, dim), r_c - A_ci A_ii^-1 r_i, that are left at the contact
        nodes with the interior in equilibrium. They decide the status of these nodes."""
        particular, force = self.reduce(residual)
        return particular, force.reshape(-1, self.full.system.dim)

    def interior_problem(self) -> tuple[Span, np.ndarray]:
        """Return the unknowns of the interior point method, the free contact dofs with S as matrix, and
        their load."""
        free = ~self.full.system.fixed[self.contact]
        dofs = ContactDofs(self.matrix, free.reshape(-1, self.full.system.dim))
        return dofs, self.load[free]

    def from_interior(self, interior: Interior) -> np.ndarray:
        """Return the unknowns (n_dofs,) of a solution of the interior point method."""
        return self.recover(interior.values.reshape(-1))

    def newton_change(self, equations: Linearised, particular: np.ndarray) -> np.ndarray:
        """Return the change (n_dofs,) of a Newton step; ``particular`` is the interior solution of
        :meth:`contact_residual`. LinAlgError if the equations are singular."""
        n, dim = equations.force.shape
        # rows and columns by contact node and component
        matrix = self.matrix.copy().reshape(n, dim, n, dim)
        node = np.arange(n)
        # A_t - mu z A_n + kappa Pi: friction follows the pressure, so that tangential rows take
        # a part of the normal row
        for k in range(1, dim):
            matrix[:, k] -= equations.pull[:, k - 1, None, None] * matrix[:, 0]
            matrix[node, k, node, 1:] += equations.curvature[:, k - 1]
        matrix[node, 0, node, 0] += equations.spring  # 1/e of compliant surfaces
        matrix = matrix.reshape(n * dim, n * dim)
        # prescribed changes go to the right-hand side
        change = equations.change.reshape(-1).copy()
        free = np.flatnonzero(~equations.prescribed.reshape(-1))
        rhs = equations.force.reshape(-1)[free] - matrix[free] @ change
        change[free] = _dense_solution(matrix[free[:, None], free], rhs)
        return self.complete(particular, change)


def _dense_solution(matrix: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Return the solution (n,) of dense equations; LinAlgError if they are singular."""
    if not len(rhs):
        return rhs
    norm_1 = np.abs(matrix).sum(axis=0).max()
    factors, pivots, failed = linalg.lapack.dgetrf(matrix)
    rcond = linalg.lapack.dgecon(factors, norm_1)[0] if not failed else 0.0
    if not rcond > checks.ROUNDING:
        raise np.linalg.LinAlgError(
            f"the condensed equations are singular: reciprocal condition {rcond:.1e}"
        )
    return linalg.lapack.dgetrs(factors, pivots, rhs)[0]


def condense(local: LocalProblem, lenient: bool = False) -> Condensed:
    """Condense a problem onto its contact nodes; see :func:`eliminate`."""
    parts = eliminate(local.system, local.discrete.coordinates, lenient)
    return Condensed(**vars(parts), full=local)


def eliminate(
    system: LocalSystem, coordinates: np.ndarray | None, lenient: bool = False
) -> Eliminated:
    """Eliminate all but the contact nodes of a system, by factors of M = A + Sigma; ``coordinates``
    (n_nodes, dim), if they are known, order the elimination. ``lenient``: where M is singular with all
    contact dofs fixed, dofs that depend on others stay at zero."""
    dim = system.dim
    contact = dofs_of(system.nodes, dim)
    shift = np.abs(
        system.diagonal.reshape(-1, dim, dim).diagonal(axis1=1, axis2=2)[system.nodes]
    ).reshape(-1)
    try:
        if system.n_dofs <= _DENSE:
            factors, schur = _eliminate_dense(system, contact, shift, lenient)
        else:
            nodes = nested_dissection(node_graph(system.matrix), coordinates, last=system.nodes)
            factors, schur = _eliminate(
                _shifted(system, contact, shift), dofs_of(nodes, dim), contact
            )
    except _Singular:
        if not lenient or system.n_dofs > _DENSE_AT_MOST:
            raise
        factors, schur = _eliminate_dense(system, contact, shift, lenient)
    # S from S + Sigma, symmetric to the bit
    np.einsum("kk->k", schur)[:] -= shift
    return Eliminated(factors=factors, contact=contact, matrix=0.5 * (schur + schur.T), shift=shift)


#: dofs up to which the condensation of a problem is remembered, by dimension
REMEMBERED = {1: 10_000, 2: 10_000, 3: 3_000}


def condense_problem(problem: DiscreteProblem, lenient: bool = False) -> Condensed:
    """Condense a problem; those that share its matrix share the factors, where these are small."""
    if problem.n_dofs > REMEMBERED[problem.dim]:
        return condense(local_system(problem), lenient)
    system, parts = eliminated(problem)
    result = Condensed(**vars(parts), full=local_system(problem, system))
    if not (lenient or result.regular):
        raise _Singular
    return result


@remembered_of_structure
def eliminated(problem: DiscreteProblem) -> tuple[LocalSystem, Eliminated]:
    """Return the system of a problem, and its elimination, which serves problems with other loads,
    too."""
    system = local_system(problem).system
    return system, eliminate(system, problem.coordinates, lenient=True)


def _shifted(system: LocalSystem, contact: np.ndarray, shift: np.ndarray) -> sparse.csc_array:
    """Return M with every entry between two dofs ``contact`` (n,) stored, so that SuperLU keeps them at the
    end of its order; ``shift`` (n,) is the diagonal of Sigma there."""
    n = len(contact)
    matrix = sparse.coo_array(system.matrix)
    rows, columns = matrix.coords
    # Sigma with zeros between all contact dofs, added entry by entry: a sum of matrices drops zeros
    data = np.append(matrix.data, np.diag(shift))
    rows = np.append(rows, np.repeat(contact, n))
    columns = np.append(columns, np.tile(contact, n))
    return sparse.coo_array((data, (rows, columns)), shape=matrix.shape).tocsc()


def _eliminate(
    matrix: sparse.csc_array, order: np.ndarray, contact: np.ndarray
) -> tuple[OrderedFactors, np.ndarray]:
    """Return the factors of a matrix by the elimination ``order`` (n_dofs,), in which the dofs
    ``contact`` (n_c,) are last, and L_cc U_cc (n_c, n_c) in the order of ``contact``."""
    try:
        factors = OrderedFactors.of(matrix, order)
    except RuntimeError as error:
        raise _Singular from error
    # SuperLU postorders the elimination tree: the dof that is k-th in ``order`` has column place[k] of L
    # and U, and row place[k], too, unless a pivot was exchanged
    lu = factors.lu
    place = lu.perm_c
    upper = lu.U
    pivots = upper.diagonal()[place]  # in ``order``, as the diagonal
    is_regular = (pivots > checks.ROUNDING * factors.diagonal).all()
    if not (is_regular and np.array_equal(place, lu.perm_r)):
        raise _Singular
    place_of_dof = np.empty_like(order)
    place_of_dof[order] = place
    contact_places = place_of_dof[contact]
    lower_cc, upper_cc = (
        part[:, contact_places].tocsr()[contact_places].toarray() for part in (lu.L, upper)
    )
    return factors, lower_cc @ upper_cc


def _eliminate_dense(
    system: LocalSystem, contact: np.ndarray, shift: np.ndarray, lenient: bool
) -> tuple[DenseFactors, np.ndarray]:
    """Return the factors and S + Sigma (n, n) on the dofs ``contact`` (n,), where ``shift`` (n,) is the
    diagonal of Sigma, by a dense Cholesky decomposition with pivots, which find the rank of the interior
    matrix; other arguments as of :func:`eliminate`."""
    n = system.n_nodes
    dim = system.dim
    # the matrix by node and component
    matrix = np.zeros((n, dim, n, dim))
    block_rows = np.repeat(np.arange(n), np.diff(system.indptr))
    matrix[block_rows, :, system.indices] = system.data.reshape(-1, dim, dim)
    matrix = matrix.reshape(n * dim, n * dim)
    interior = np.flatnonzero(np.repeat(system.contact_of < 0, dim))
    size = np.sqrt(matrix.diagonal()[interior])
    lower = np.empty((0, 0))
    pivots = np.empty(0, dtype=np.int64)
    rank = 0
    if len(interior):
        scaled = matrix[interior[:, None], interior] / (size[:, None] * size)
        lower, pivots, rank, _ = linalg.lapack.dpstrf(scaled, tol=checks.ROUNDING, lower=1)
    if rank < len(interior) and not lenient:
        raise _Singular
    # interior dofs that do not depend on others, in the order of elimination; LAPACK counts from 1
    independent = pivots[:rank] - 1
    lower = np.tril(lower[:rank, :rank]) * size[independent, None]
    order = np.append(interior[independent], contact)
    coupling = linalg.solve_triangular(
        lower, matrix[order[:rank, None], contact], lower=True, check_finite=False
    )
    # S + Sigma, and the factor of the whole matrix
    schur = matrix[contact[:, None], contact] + np.diag(shift) - coupling.T @ coupling
    whole = np.zeros((len(order), len(order)), order="F")
    whole[:rank, :rank] = lower
    whole[rank:, :rank] = coupling.T
    whole[rank:, rank:] = np.linalg.cholesky(schur)
    return DenseFactors(whole, order), schur
