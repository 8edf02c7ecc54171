r"""Prolongations between two levels of a contact problem, and transport of contact data to the
coarser one.

On curved or non-nested contact boundaries a fine contact node lies inside or outside the coarse
mesh, and a prolongation between the volumes gives it weights of inner coarse nodes, without contact
conditions. Here it is projected onto the nearest coarse contact facet and takes the weights there:

.. math:: P_{ik} \ge 0, \qquad \sum_k P_{ik} = 1, \qquad k \text{ coarse contact nodes only},

which is what the proof of the monotone correction below needs. Affine fields are reproduced at the
projected points, so on curved boundaries up to O(h_coarse^2).

With the nodal prolongation P of displacements and the couplings W_f, W_c of the two levels there
are two forms for relative values w: :math:`P_w = (I - W_f)\,P\,(I - W_c)^{-1}`, which spans the
same space as P, rigid motions of all bodies included; and the same with the rows of the slave nodes
replaced by interpolation of relative values along the coarse slave surface, weights >= 0 with sums
1 over the coarse slave nodes of the pair, for the monotone correction. Other coarse nodes of the
surface (where it hangs over, or belongs to another pair) have no values relative to this master:
those next to them take over their weights.

The two faces of a crack lie at one place. Nodes on a face are interpolated along the coarse one,
whatever the transfer does elsewhere and whether they are in contact; so are inner nodes between the
meshes of a curved face, which lie inside the fine one and outside the coarse one, that is on the
other side of the coarse crack.

``P_cc`` (n_fine_contact, n_coarse_contact) are the contact rows and columns of the prolongation, >=
0 with row sums at most 1 (1 unless coarse dofs are fixed), and :math:`S_k = \{i : P_{ik} > 0\}`.
The correction E has normal and tangential components in the contact frames.

**The monotone guarantee.** With the smallest gap :math:`D_k = \min_{S_k} (g_0 - u_n)_i`, the minmod
slip
:math:`U_k` (0 unless all slips :math:`t_i = (u_t - u_t^{prev})_i`, i in S_k, point one way; else the shortest) and the
summed limit :math:`G = P^T g`: for every E with :math:`E_{n,k} \le D_k`

.. math:: (g_0 - u_n)_i - (P E_n)_i \ge 0, \qquad
          \sum_i g_i |t_i + (P E_t)_i| - \sum_i g_i |t_i| \le \sum_k G_k \big(|U_k + E_{t,k}| - |U_k|\big).

*Proof.* :math:`\sum_k P_{ik} E_{n,k} \le \sum_k P_{ik} D_k \le (g_0 - u_n)_i`, as the opening is >=
0. By convexity
:math:`|t_i + \sum_k P_{ik} E_k| - |t_i| \le \sum_k P_{ik} (|t_i + E_k| - |t_i|)`, and :math:`|s e + E| - s` does not
increase with :math:`s \ge 0` for a unit vector e, so that it is largest at the shortest slip of
:math:`S_k`; sum over i with the weights :math:`g_i`. So the coarse functional majorises the change
of the fine one: with coarse matrices
:math:`P^T A P` the Tresca energy cannot rise. It needs one normal (and in 3D one pair of tangents) over :math:`S_k`,
and contact rows that interpolate from coarse contact nodes only.

Source of the setting: the paper's correction problem, steps a-g; its other choices are here too,
under the names ``largest_gap`` and ``injected_...``, and guarantee nothing. A nodal limit is a
force and is summed, never interpolated; a pressure is interpolated, from coarse to fine, in nested
iteration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from adaptmg import _checks as checks
from adaptmg.discrete.contact_nodes import ContactNodes, largest_entry
from adaptmg.discrete.coordinates import relative_prolongation
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.geometry.search import BoxTree
from adaptmg.mesh.arrays import MeshArrays, mask_of
from adaptmg.problem.laws import NodalLaw
from adaptmg.transfer.interpolation import (
    CLIP,
    Interpolation,
    Transfer,
    csr_from_weights,
    nodes_of_bodies,
    without_search,
)


def surface_interpolation(
    coarse: MeshArrays, fine: MeshArrays, coarse_boundary_facets: np.ndarray, fine_nodes: np.ndarray
) -> sparse.csr_array:
    """Interpolate at fine contact nodes (n,) from the nearest coarse contact facet.

    Entries are >= 0, with row sums 1, at most dim in a row. The facets (n_facets, dim) hold coarse
    nodes, as ``coarse.boundary_facets(name)`` does; the nearest is exact, on graded boundaries too.

    Examples
    --------
    >>> coarse, fine = (am.mesh.structured(am.Rectangle(width=1, height=1), n) for n in (2, 4))
    >>> nodes = fine.boundary_nodes("bottom")
    >>> rows = am.transfer.surface_interpolation(coarse, fine, coarse.boundary_facets("bottom"), nodes)
    >>> rows.shape, rows.sum(axis=1).tolist()
    ((5, 9), [1.0, 1.0, 1.0, 1.0, 1.0])
    """
    facets = coarse_boundary_facets
    if (
        facets.ndim != 2
        or not len(facets)
        or not 0 <= facets.min() <= facets.max() < coarse.n_nodes
    ):
        raise ValueError(
            f"coarse_boundary_facets must hold nodes of coarse, a row a facet, got shape {facets.shape}"
        )
    facet, weights, _ = BoxTree(coarse.points, facets).nearest(fine.points[fine_nodes])
    return csr_from_weights(facets[facet], weights, coarse.n_nodes)


def with_contact_rows(
    P: sparse.csr_array, fine_nodes: np.ndarray, rows: sparse.csr_array
) -> sparse.csr_array:
    """Return a nodal prolongation (n_fine, n_coarse) with other rows (n, n_coarse) for distinct
    fine nodes (n,).

    Examples
    --------
    >>> from scipy import sparse
    >>> P = sparse.csr_array([[1.0, 0.0], [0.4, 0.6], [0.0, 1.0]])
    >>> rows = sparse.csr_array([[0.5, 0.5]])
    >>> am.transfer.with_contact_rows(P, np.array([1]), rows).toarray().tolist()
    [[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]
    """
    nodes = checks.array("fine_nodes", fine_nodes, (None,), integer=True)
    if rows.shape != (len(nodes), P.shape[1]) or len(np.unique(nodes)) < len(nodes):
        raise ValueError(
            f"rows must have shape ({len(nodes)}, {P.shape[1]}), one for each of distinct fine_nodes, got "
            f"{rows.shape}"
        )
    row_of = np.arange(P.shape[0])
    row_of[nodes] = P.shape[0] + np.arange(len(nodes))
    return checks.narrowed(sparse.csr_array(sparse.vstack([P, rows], format="csr")[row_of]))


@dataclass(frozen=True, eq=False)
class LevelTransfer:
    """Nodal prolongations from a level to the next finer, (n_nodes, n_nodes coarse)."""

    prolongation: sparse.csr_array  # of relative values where there is a coupling
    #: with other rows of contact nodes, along the coarse surface, for the monotone correction (module docstring); None
    #: where ``prolongation`` has such rows itself
    surface: sparse.csr_array | None = None


def between_levels(
    transfer: Transfer,
    coarse: MeshArrays,
    fine: MeshArrays,
    coarse_problem: DiscreteProblem,
    fine_problem: DiscreteProblem,
    contact_rows: bool = True,
) -> LevelTransfer:
    """Return prolongations between the discretisations of one problem on two meshes: that of
    ``transfer``, with other rows on crack faces and (``contact_rows``) on contact boundaries, and
    from it the two forms for relative values (module docstring)."""
    # interpolation between structured or bisected meshes, whose rows interpolate along the boundaries, too
    embedding = without_search(coarse, fine) if type(transfer) is Interpolation else None
    if embedding is None:
        nodal = _checked_prolongation(transfer, coarse, fine)
    else:
        nodal = embedding
        checks.freeze(nodal.indices, nodal.indptr)
    contact = fine_problem.contact
    coupling = fine_problem.coupling
    if coupling is not None:
        _check_bodies(nodal, coarse, fine, transfer)
    slave_nodes = [contact.nodes[contact.boundary == k] for k in range(len(contact.names))]
    # for each contact boundary its slave nodes, and their rows of interpolation along the coarse one; those
    # of an embedding are read from it below, where a problem needs them
    slave_rows = (
        [_rows_along(coarse, fine, *side) for side in zip(contact.names, slave_nodes, strict=True)]
        if embedding is None
        else []
    )
    for face, other in _crack_faces(fine, contact):
        nodal = with_contact_rows(
            nodal, *_rows_along(coarse, fine, face, _on_side(nodal, coarse, fine, face, other))
        )
    if contact_rows and embedding is None:
        master_rows = [
            _rows_along(coarse, fine, name, fine.boundary_nodes(name))
            for name in contact.masters
            if name
        ]
        for nodes, rows in (*master_rows, *slave_rows):
            # on nested meshes the rows are the same up to rounding, and the matrix stays
            if largest_entry((nodal[nodes] - rows).data) > CLIP:
                nodal = with_contact_rows(nodal, nodes, rows)
    relative = relative_prolongation(nodal, coupling, coarse_problem.coupling)
    surface = relative
    # contact nodes that take over weights of tied nodes
    takes_over = np.diff(contact.taken_over.indptr) > 0
    no_limit = _without_limit(coarse_problem)
    # rows of ``surface``: with the values of coarse slave nodes of this boundary alone, where those of others are not
    # relative to its master, or without coarse nodes that no condition bounds
    for k, nodes in enumerate(slave_nodes):
        takes_values = contact.masters[k] or takes_over[contact.boundary == k].any()
        may_pass = contact_rows and no_limit[coarse.surface(contact.names[k]).nodes].any()
        if not (takes_values or may_pass):
            continue  # the rows of ``relative`` will do
        rows = slave_rows[k][1] if embedding is None else embedding[nodes]
        if takes_values:  # relative ones, or with shares of tied neighbours
            coarse_contact = coarse_problem.contact
            coarse_slaves = coarse_contact.nodes[coarse_contact.boundary == k]
            rows = _rows_on_side(coarse_slaves, rows, fine.points[nodes], coarse.points)
        else:  # without the coarse nodes that could move the fine ones beyond the obstacle
            rows.data[no_limit[rows.indices]] = 0.0
        surface = with_contact_rows(surface, nodes, rows)
    return LevelTransfer(relative, None if surface is relative else surface)


def _without_limit(problem: DiscreteProblem) -> np.ndarray:
    """Return the mask (n_nodes,) of nodes that could move beyond an obstacle: contact nodes have bounds
    that prevent it, and held ones do not move."""
    held = problem.fixed.reshape(-1, problem.dim).all(axis=1)
    no_limit = np.array(~held)
    no_limit[problem.contact.nodes] = False
    return no_limit


def _crack_faces(mesh: MeshArrays, contact: ContactNodes) -> list[tuple[str, str]]:
    """Return each face of a crack, and the other one. A crack is a contact pair, or a pair of boundaries
    of one name that end in .left and .right, whose faces share nodes, those at its tips. An obstacle,
    whose master is "", has no face."""
    pairs = [
        *zip(contact.names, contact.masters, strict=True),
        *(
            (name, name.removesuffix("left") + "right")
            for name in mesh.boundaries
            if name.endswith(".left")
        ),
    ]
    shared = [
        pair
        for pair in dict.fromkeys(pairs)
        if set(pair) <= set(mesh.boundaries)
        and len(np.intersect1d(mesh.boundary_nodes(pair[0]), mesh.boundary_nodes(pair[1])))
    ]
    return [faces for side, other in shared for faces in ((side, other), (other, side))]


def _on_side(
    nodal: sparse.csr_array, coarse: MeshArrays, fine: MeshArrays, face: str, other: str
) -> np.ndarray:
    """Return the fine nodes (n,), ascending, on a face of a crack, and the inner ones between the fine
    and the coarse face that the prolongation ``nodal`` lets follow the opposite coarse face, ``other``."""
    near = np.flatnonzero(abs(nodal) @ mask_of(coarse.boundary_nodes(other), coarse.n_nodes))
    points = fine.points[near]
    outside_coarse = _height(coarse, face, other, points) > 0
    inside_fine = _height(fine, face, other, points) < 0
    return np.union1d(fine.boundary_nodes(face), near[outside_coarse & inside_fine])


def _height(mesh: MeshArrays, face: str, other: str, points: np.ndarray) -> np.ndarray:
    """Return the distances (n,), m, of points from a face of a crack, along its normals, which point
    out of the body; 0 ahead of a tip, where the nearest point of the face is a node of the ``other``
    face, too."""
    surface = mesh.surface(face)
    facet, weights, _ = BoxTree(mesh.points, surface.facets).nearest(points)
    corners = surface.facets[facet]
    foot = np.einsum("nk,nkd->nd", weights, mesh.points[corners])
    height = np.einsum("nd,nd->n", points - foot, surface.normals[facet])
    weight_on_other = (weights * np.isin(corners, mesh.boundary_nodes(other))).sum(axis=1)
    return np.where(weight_on_other < 1, height, 0.0)


def _checked_prolongation(
    transfer: Transfer, coarse: MeshArrays, fine: MeshArrays
) -> sparse.csr_array:
    """Return the prolongation that a transfer builds; ValueError unless it is a sparse matrix of
    the right shape with finite entries, the largest of them neither tiny nor huge (checks.VAST)."""
    returned = transfer.build(coarse, fine)
    shape = (fine.n_nodes, coarse.n_nodes)
    if sparse.issparse(returned) and returned.shape != shape:
        raise ValueError(
            f"transfer.build must return a matrix of shape {shape} (fine, coarse nodes), "
            f"got {returned.shape}"
        )
    nodal = checks.sparse_matrix(
        f"what transfer.build of {checks.shown(transfer)} returns", returned
    )
    nodal = sparse.csr_array(nodal, dtype=np.float64)  # pyright: ignore[reportCallIssue, reportArgumentType]  scipy-stubs
    if not nodal.has_sorted_indices:  # products sort in place, and prolongations are read-only
        nodal = nodal.sorted_indices()
    largest = largest_entry(nodal.data)
    if not 1 / checks.VAST <= largest <= checks.VAST:
        raise ValueError(
            f"transfer.build of {checks.shown(transfer)} must return weights of about 1, the largest is "
            f"{largest:.3g}"
        )
    return nodal


def _check_bodies(
    nodal: sparse.csr_array, coarse: MeshArrays, fine: MeshArrays, transfer: Transfer
) -> None:
    """Raise ValueError if a fine node follows a coarse node of another body, unless coarse elements
    of both bodies share nodes, directly or through other bodies."""
    body = np.repeat(coarse.element_body, coarse.elements.shape[1])
    incidence = sparse.csr_array(
        (np.ones(coarse.elements.size), (coarse.elements.ravel(), body)),
        shape=(coarse.n_nodes, len(coarse.bodies)),
    )
    # numbers (n_bodies,), equal for bodies that share nodes
    _, group = connected_components(incidence.T @ incidence, directed=False)
    # of each entry of the prolongation
    rows = np.repeat(np.arange(fine.n_nodes), np.diff(nodal.indptr))
    body_of_row = nodes_of_bodies(fine)[rows]
    body_of_column = nodes_of_bodies(coarse, "coarse")[nodal.indices]
    wrong = np.flatnonzero((group[body_of_row] != group[body_of_column]) & (nodal.data != 0.0))
    if wrong.size:
        node = rows[wrong[0]]
        fine_body = fine.bodies[body_of_row[wrong[0]]]
        coarse_body = coarse.bodies[body_of_column[wrong[0]]]
        raise ValueError(
            f"transfer.build of {transfer!r} lets node {node} of body {fine_body!r} follow body {coarse_body!r}: "
            "build the rows of each body from its own nodes (mesh.element_body tells which they are)"
        )


def _rows_along(
    coarse: MeshArrays, fine: MeshArrays, boundary: str, nodes: np.ndarray
) -> tuple[np.ndarray, sparse.csr_array]:
    """Return fine nodes (n,) on a boundary, and the rows (n, n_coarse) that interpolate along it."""
    return nodes, surface_interpolation(coarse, fine, coarse.boundary_facets(boundary), nodes)


def _rows_on_side(
    coarse_slaves: np.ndarray,
    rows: sparse.csr_array,
    points: np.ndarray,
    coarse_points: np.ndarray,
) -> sparse.csr_array:
    """Return the rows (n, n_coarse) of fine nodes at ``points`` (n, dim) with entries in the columns
    ``coarse_slaves`` only and sums 1: scaled, or 1 at the nearest of these coarse nodes where nothing
    is left; zero if there are none. ``coarse_points`` (n_coarse, dim) are those of all coarse nodes."""
    if not len(coarse_slaves):
        return sparse.csr_array(rows.shape)
    same_side = sparse.csr_array(
        rows @ sparse.diags_array(mask_of(coarse_slaves, rows.shape[1]).astype(float))
    )
    sums = np.asarray(same_side.sum(axis=1)).ravel()
    without_entries = np.flatnonzero(sums <= CLIP)
    from scipy.spatial import cKDTree  # a first solve without it starts sooner

    _, at = cKDTree(coarse_points[coarse_slaves]).query(points[without_entries])
    nearest = coarse_slaves[at]
    filled = sparse.csr_array(
        (np.ones(len(without_entries)), (without_entries, nearest)), shape=rows.shape
    )
    scale = np.divide(1.0, sums, out=np.zeros_like(sums), where=sums > CLIP)
    result = sparse.csr_array(sparse.diags_array(scale) @ same_side + filled)
    result.eliminate_zeros()
    return result


@dataclass(frozen=True, eq=False)
class Supports:
    """The sets S_k of a contact prolongation, from :func:`supports`."""

    n_fine: int  # number of fine contact nodes
    indptr: np.ndarray  # (n_coarse_contact + 1,)
    nodes: np.ndarray  # (n,): fine contact nodes of S_k, ascending
    weights: np.ndarray  # (n,): P_ik > 0
    #: (n_coarse_contact,): fine contact node of the largest weight in S_k, the first of equals; -1 where S_k is empty
    main: np.ndarray

    def injected(self, values: np.ndarray, empty: float) -> np.ndarray:
        """Return fine values (n_fine, ...) at ``main``, ``empty`` where S_k is."""
        result = self._over_fine(values)[np.maximum(self.main, 0)]
        result[self.main < 0] = empty
        return result

    def reduced(self, ufunc: np.ufunc, values: np.ndarray, empty: float) -> np.ndarray:
        """Return fine values (n_fine, ...) reduced over each S_k, ``empty`` where it is."""
        values = self._over_fine(values)
        # reduceat reduces from one start to the next: empty sets, which have no entries, are left out
        filled = self.main >= 0
        result = np.full((len(self.main), *values.shape[1:]), empty, dtype=values.dtype)
        if filled.any():
            result[filled] = ufunc.reduceat(values[self.nodes], self.indptr[:-1][filled])
        return result

    def _over_fine(self, values: np.ndarray) -> np.ndarray:
        """Return fine values unchanged; ValueError unless there are n_fine."""
        if len(values) != self.n_fine:
            raise ValueError(
                f"one value a fine contact node is needed, {self.n_fine}, got {len(values)}"
            )
        return values


def supports(P_cc: sparse.csr_array) -> Supports:
    """Return the sets S_k of P_cc (n_fine_contact, n_coarse_contact); ValueError if an entry is
    negative or not finite.

    Examples
    --------
    >>> from scipy import sparse
    >>> P = sparse.csr_array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]])             # 3 fine nodes, 2 coarse
    >>> sets = am.transfer.supports(P)
    >>> [sets.nodes[a:b].tolist() for a, b in zip(sets.indptr, sets.indptr[1:])]
    [[0, 1], [1, 2]]
    """
    if not sparse.issparse(P_cc):
        raise TypeError(f"P_cc must be a scipy sparse matrix, got {checks.shown(P_cc)}")
    columns = sparse.csc_array(P_cc, dtype=np.float64, copy=True)
    columns.sum_duplicates()
    if not (np.isfinite(columns.data) & (columns.data >= 0)).all():
        raise ValueError(
            "P_cc must be >= 0 (and finite) in the contact rows of a prolongation: use Interpolation, put "
            "contact rows in with surface_interpolation and with_contact_rows, or pose coarse spaces "
            "without contact (contact=False)"
        )
    columns.eliminate_zeros()
    n = columns.shape[1]
    coarse = np.repeat(np.arange(n), np.diff(columns.indptr))
    # ordered by weight within each S_k, of equals the first one last: of several assignments to an entry
    # of ``main`` the last one counts
    order = np.lexsort((-columns.indices, columns.data, coarse))
    main = np.full(n, -1, dtype=np.int64)
    main[coarse[order]] = columns.indices[order]
    return Supports(
        n_fine=columns.shape[0],
        indptr=columns.indptr,
        nodes=columns.indices,
        weights=columns.data,
        main=main,
    )


def smallest_gap(sets: Supports, opening: np.ndarray) -> np.ndarray:
    """Return safe bounds D_k (n_coarse_contact,) of the normal correction from the opening g0 - u_n
    (n_fine_contact,), m.

    +inf where S_k is empty.

    Examples
    --------
    >>> from scipy import sparse
    >>> sets = am.transfer.supports(sparse.csr_array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]))
    >>> am.transfer.smallest_gap(sets, np.array([1e-6, 2e-6, 3e-6])).tolist()      # m
    [1e-06, 2e-06]
    """
    return sets.reduced(np.minimum, opening, empty=np.inf)


def largest_gap(sets: Supports, opening: np.ndarray) -> np.ndarray:
    """Return the paper's bound read literally ('smallest u_n'): the maximum of the ``opening``
    (n_fine_contact,) over S_k, m; else as :func:`smallest_gap`. Iterations with it stall or cycle.

    Examples
    --------
    >>> from scipy import sparse
    >>> sets = am.transfer.supports(sparse.csr_array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]))
    >>> am.transfer.largest_gap(sets, np.array([1e-6, 2e-6, 3e-6])).tolist()       # m
    [2e-06, 3e-06]
    """
    return sets.reduced(np.maximum, opening, empty=np.inf)


def restricted_problem(
    fine: DiscreteProblem, nodal: sparse.csr_array, matrix: sparse.bsr_array
) -> DiscreteProblem:
    """Return the contact problem on a coarse space, from its Galerkin matrix and the nodal
    prolongation from there: with the smallest gap over each S_k, the mean normal, summed limits and
    the coefficient of the fine node with the largest weight. Its unknowns are changes from the values
    that the fine problem prescribes: no dof is fixed, as those of the fine one are decoupled in the matrix.
    ValueError for a prolongation of dofs, or with negative weights at contact nodes."""
    if nodal.shape[0] != fine.n_nodes:
        raise ValueError(
            "contact=True needs prolongations of nodes (n_nodes, n_nodes coarse), got one of shape "
            f"{nodal.shape}: give those, or leave contact=False"
        )
    # coarse contact nodes are all that fine ones follow
    contact = fine.contact
    rows = sparse.csr_array(nodal[contact.nodes], copy=True)
    rows.eliminate_zeros()
    nodes = np.unique(rows.indices)
    weights = sparse.csr_array(rows[:, nodes])
    reach = supports(weights)
    normals = weights.T @ (contact.weights[:, None] * contact.normals)
    limit, friction = fine.law.bounds(len(contact))
    return DiscreteProblem(
        matrix=matrix,
        load=(nodal.T @ fine.load_from_prescribed().reshape(-1, fine.dim)).reshape(-1),
        fixed=np.zeros(matrix.shape[0], dtype=bool),
        law=NodalLaw(summed_limit(reach, limit), reach.injected(friction, empty=0.0)),
        contact=ContactNodes(
            nodes=nodes,
            normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
            gaps=smallest_gap(reach, contact.gaps),
            opposite_gaps=smallest_gap(reach, contact.opposite_gaps),
            weights=weights.T @ contact.weights,
            slip_reference=reach.injected(contact.slip_reference, empty=0.0),
            allow_interference=True,
        ),
        name=f"{fine.name}, coarse",
    )


def injected_gap(sets: Supports, opening: np.ndarray) -> np.ndarray:
    """Return the opening of the fine node with the largest weight in S_k; as :func:`smallest_gap`.
    No guarantee.

    Examples
    --------
    >>> from scipy import sparse
    >>> sets = am.transfer.supports(sparse.csr_array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]))
    >>> am.transfer.injected_gap(sets, np.array([1e-6, 2e-6, 3e-6])).tolist()      # m
    [1e-06, 3e-06]
    """
    return sets.injected(opening, empty=np.inf)


def minmod_slip(sets: Supports, slip: np.ndarray, stick: np.ndarray | None = None) -> np.ndarray:
    """Return safe reference slips U_k (n_coarse_contact, dim - 1) of the tangential correction, m.

    0 unless all slips u_t - u_t^previous (n_fine_contact, dim - 1) in S_k have one sign (3D: one
    direction) and none is zero or in ``stick`` (n_fine_contact,), else the shortest; 0 where S_k is
    empty. In 3D slips within 1e-6 rad of the shortest count as parallel to it; the guarantee then
    holds up to 1e-6 ``sum_i g_i sum_k P_ik |E_k|``.

    Examples
    --------
    >>> from scipy import sparse
    >>> sets = am.transfer.supports(sparse.csr_array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]))
    >>> am.transfer.minmod_slip(sets, np.array([[2e-6], [1e-6], [-1e-6]])).tolist()      # m
    [[1e-06], [0.0]]
    """
    slip = slip if stick is None else np.where(stick[:, None], 0.0, slip)
    if slip.shape[1] <= 1:
        # one of the two is 0 unless all have one sign
        low = sets.reduced(np.minimum, slip, empty=0.0)
        high = sets.reduced(np.maximum, slip, empty=0.0)
        return np.maximum(low, 0.0) + np.minimum(high, 0.0)
    size = np.hypot(slip[:, 0], slip[:, 1])
    coarse = np.repeat(np.arange(len(sets.main)), np.diff(sets.indptr))
    # ordered by length within each S_k: the first one is the shortest, of equals the first in S_k
    order = np.lexsort((size[sets.nodes], coarse))
    shortest = np.zeros(len(sets.main), dtype=np.int64)
    filled = sets.main >= 0
    shortest[filled] = sets.nodes[order[sets.indptr[:-1][filled]]]
    fine_slip = slip[sets.nodes]
    least_slip = slip[shortest[coarse]]
    dot = fine_slip[:, 0] * least_slip[:, 0] + fine_slip[:, 1] * least_slip[:, 1]
    cross = fine_slip[:, 0] * least_slip[:, 1] - fine_slip[:, 1] * least_slip[:, 0]
    turned = ~(dot > 0.0) | (
        np.abs(cross) > checks.SIX_DIGITS * (size[shortest[coarse]] * size[sets.nodes])
    )
    parallel = filled & (np.bincount(coarse[turned], minlength=len(sets.main)) == 0)
    return np.where(parallel[:, None], slip[shortest], 0.0)


def injected_slip(sets: Supports, slip: np.ndarray) -> np.ndarray:
    """Return the slip of the fine node with the largest weight in S_k; shapes as
    :func:`minmod_slip`. No guarantee.

    Examples
    --------
    >>> from scipy import sparse
    >>> sets = am.transfer.supports(sparse.csr_array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]))
    >>> am.transfer.injected_slip(sets, np.array([[2e-6], [1e-6], [-1e-6]])).tolist()    # m
    [[2e-06], [-1e-06]]
    """
    return sets.injected(slip, empty=0.0)


def summed_limit(sets: Supports, limit: np.ndarray) -> np.ndarray:
    """Return nodal friction limits g (n_fine_contact,) summed with the transpose, G = P'g
    (n_coarse_contact,), N; dual.

    The total is that of g where the rows sum to 1.

    Examples
    --------
    >>> from scipy import sparse
    >>> sets = am.transfer.supports(sparse.csr_array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]))
    >>> am.transfer.summed_limit(sets, np.array([10.0, 20.0, 30.0])).tolist()      # N
    [20.0, 40.0]
    """
    coarse = np.repeat(np.arange(len(sets.main)), np.diff(sets.indptr))
    return np.bincount(
        coarse, weights=sets.weights * limit[sets.nodes], minlength=len(sets.main)
    ).astype(np.float64)


def injected_limit(sets: Supports, limit: np.ndarray) -> np.ndarray:
    """Return the nodal limit of the fine node with the largest weight in S_k, N; 0 where S_k is
    empty.

    As :func:`summed_limit`, but what one fine node bears is less than the force on a coarse one. No
    guarantee.

    Examples
    --------
    >>> from scipy import sparse
    >>> sets = am.transfer.supports(sparse.csr_array([[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]))
    >>> am.transfer.injected_limit(sets, np.array([10.0, 20.0, 30.0])).tolist()    # N
    [10.0, 30.0]
    """
    return sets.injected(limit, empty=0.0)
