r"""The stiffness matrix of elasticity: of linear elements, or with strains smoothed over edges;
rigid-body motions.

The matrix is a sum over patches, in which the strain :math:`B_p u` is constant,

.. math:: K = \sum_p V_p\, B_p^T C B_p ,

with the tensors C of :mod:`adaptmg.discrete.moduli`. The patches of linear elements are the
elements. Edge-smoothed elements take, for each edge e of a body, the mean strain of the elements T
around it, which have k = 3 (in space 6) edges (G. R. Liu, T. Nguyen-Thoi and K. Y. Lam, J. Sound
Vib. 320, 2009, doi:10.1016/j.jsv.2008.08.027):

.. math:: V_e = \sum_{T \ni e} V_T / k, \qquad V_e B_e = \sum_{T \ni e} V_T B_T / k .

A mean does not go beyond a body, across which strains jump; Lame's first constant is cut off at
:math:`4 \mu` there (:mod:`adaptmg.discrete.volumes`). With the mean :math:`(S v)_T` over the edges
of T of the means around them

.. math:: u^T K v = \sum_T V_T\, B_T u : (C S B v)_T ,

where S is symmetric for the weights V. Loads of initial strains, energies and stresses follow from
S.

In axisymmetry x is the radius r and y the axial coordinate z, the hoop strain :math:`u_r / r` joins
in, all is weighted with :math:`2 \pi r`, and forces are in N. A patch has the hoop strain at the
centroid of its element, which is the mean over the volume. To linear elements its variation within
the element adds

.. math:: C_{\theta\theta} \Big(\int 2\pi\,\frac{u_r v_r}{r} - \frac{\int 2\pi\, u_r \int 2\pi\, v_r}{\int 2\pi\, r}
   \Big) ,

by a rule with interior points and positive weights: the matrix is positive semidefinite, and
constant strains (:math:`u_r = c r`) are exact.

The upper half of each row is summed in the order of its patches, and mirrored: the matrix is
bitwise symmetric, and the same in every run."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from adaptmg import _checks as checks
from adaptmg._numba import ZERO, inner_kernel, kernel, prefetch, read_only
from adaptmg._threads import in_parts, one_blas_thread
from adaptmg.discrete.block_rows import BlockRows, frozen_matrix
from adaptmg.discrete.moduli import (
    Materials,
    body_materials,
    inelastic_bodies,
    is_axisymmetric,
    moduli,
)
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_rule
from adaptmg.mesh.arrays import MeshArrays, doubled, occurrences, pair_keys
from adaptmg.mesh.lattices import strides_of, unit_lattice
from adaptmg.problem.laws import Elastic

#: patches between a prefetch and its use: those of smoothed elements lie far apart. Their matrix of 118k nodes in space
#: takes .21 s to sum (without 1.19; at 4 and 16 .33 and .21), of 36k .060 (.082; .064, .060); linear elements no less
_LATER = 8
#: nodes from which the rows of a lattice are those of a small one: 3.6 ms for 263k nodes (sum over patches 63), 2.5 for
#: 36k in space (40), there 4.3 of smoothed elements (208); the matrix, if somebody asks for it, 20, 9 and 25 more.
#: With 4225 nodes in the plane matrix and sum take .8; in space the matrix would pay from 1300 nodes on, of smoothed
#: elements from 500: 1728 take .9 (1.2) and 1.9 ms (6.1)
_REPEATED = 4000
#: the rows of all nodes
ALL_NODES = slice(None)
#: columns of stresses and strains: in the plane without the last two, in axisymmetry ZZ is the hoop
_XX, _YY, _ZZ, _XY, _YZ, _XZ = range(6)
#: corners of the edges of an element
EDGES = {
    2: np.array([(0, 1), (0, 2), (1, 2)]),
    3: np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]),
}


def dofs_of(nodes: np.ndarray, size: int) -> np.ndarray:
    """Return the dofs (size * n,) of nodes (n,), node by node; a node has ``size`` dofs."""
    return (size * nodes.astype(np.int64)[:, None] + np.arange(size)).reshape(-1)


def nodal_matrix(nodes: np.ndarray, blocks: np.ndarray, n_dofs: int) -> sparse.bsr_array:
    """Return the block-diagonal matrix (n_dofs, n_dofs) with blocks (n, dim, dim) at some nodes."""
    order = np.argsort(nodes)
    n = n_dofs // blocks.shape[1]
    starts = np.append(0, np.cumsum(np.bincount(nodes, minlength=n)))
    return sparse.bsr_array((blocks[order], nodes[order], starts), shape=(n_dofs, n_dofs))


@dataclass(frozen=True, eq=False)
class Tangents:
    """Tangent stiffnesses of some patches, in place of the moduli of their bodies."""

    patches: np.ndarray  # (n,) int: numbers of the patches
    table: np.ndarray  # (n, k, k): Pa
    volumes: sparse.bsr_array  # (n_dofs, n_dofs): stiffness of groups of nodes, to be added, N/m


@one_blas_thread()
def stiffness(
    mesh: MeshArrays,
    material: Materials,
    elements: str = "linear",
    tangents: Tangents | None = None,
) -> sparse.bsr_array:
    """Assemble the stiffness matrix (n_dofs, n_dofs), with no boundary condition applied.

    Blocks of dim x dim, sorted indices, dof = dim * node + component; bitwise symmetric. N/m
    (plane: per metre of thickness; axisymmetric: of the full circumference). The material is the
    same in all bodies, or body name -> Elastic; ``elements`` are "linear" or "smoothed". ValueError
    if materials and mesh do not fit, a node number is out of range, or an element is inverted or
    degenerate.

    On the axis r = 0 the user prescribes u_r = 0, e.g. ``Support("axis", x=0.0)``: the hoop strain
    is bounded for no other displacement. Without it the matrix is finite still. ``tangents`` are
    stiffnesses of patches in place of those of their bodies.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> matrix = am.discrete.stiffness(mesh, am.PlaneStrain(young=1.0, poisson=0.25))
    >>> matrix.shape, matrix.blocksize, bool(abs(matrix @ np.ones(18)).max() < 1e-12)
    ((18, 18), (2, 2), True)
    """
    dim = checks.instance("mesh", mesh, MeshArrays).dim
    checks.choice("elements", elements, ("linear", "smoothed"))
    materials = body_materials(mesh, material)
    axisymmetric = is_axisymmetric(materials)
    repeated = repeated_rows(mesh, materials, elements) if tangents is None else None
    if repeated is not None:
        return repeated.matrix
    patches = patches_of(mesh, materials, elements)
    of_elements = moduli(mesh, materials, elements)
    rows = of_elements.rows[patches.element]
    table = of_elements.table
    if tangents is not None:
        rows = rows.copy()
        rows[tangents.patches] = len(table) + np.arange(len(tangents.patches))
        table = np.concatenate([table, tangents.table])
    of_nodes = patches_of_nodes(patches.start, patches.nodes, mesh.n_nodes)
    indptr, indices = pattern(of_nodes, patches.start, patches.nodes)
    data = np.empty((len(indices), dim, dim))
    # lambda = C_xxyy and mu = C_xyxy of isotropic tensors, whose sums take .75 of the time of others in
    # space (36k nodes), .80 in the plane (66k). The table begins with an isotropic tensor for each body
    # (an anisotropic one does not use it); those of anisotropic bodies and tangents follow. NaN where the
    # sum over all entries of C is taken: of the latter, and, with hoop strains, of all
    lame_constants = table[:, [_XX, _XY], [_YY, _XY]]
    lame_constants[0 if axisymmetric else len(materials) :] = np.nan
    in_parts(
        _add_patches,
        mesh.n_nodes,
        data.size,
        ZERO[dim],
        *of_nodes,
        patches.start,
        patches.nodes,
        patches.slopes,
        patches.hoops,
        patches.spread,
        patches.measures,
        rows,
        table if np.isnan(lame_constants).any() else None,
        lame_constants,
        indptr,
        indices,
        data,
    )
    in_parts(_mirror, mesh.n_nodes, data.size, ZERO[dim], indptr, indices, data)
    return frozen_matrix(data, indices, indptr)


def repeated_rows(
    mesh: MeshArrays, material: Materials, elements: str = "linear"
) -> BlockRows | None:
    """Return the rows of the stiffness of a large lattice in one uniform material, without the matrix;
    None for other meshes and materials.

    Each row repeats that of a node of a small lattice with the same cells: the node that is as far
    from the nearer end along each axis, or in the middle along axes where both ends are beyond the
    reach of rows."""
    if len(mesh.lattices) != 1 or mesh.n_nodes < _REPEATED:
        return None
    materials = body_materials(mesh, material)
    varies = any(elastic.anisotropy and elastic.anisotropy.varies for elastic in materials)
    if varies or is_axisymmetric(materials):
        return None
    (counts,) = mesh.lattices
    reach = 1 if elements == "linear" else 2
    # with 2 reach cells along an axis the node in the middle has the row of all nodes beyond this reach
    few_counts = tuple(min(n, 2 * reach) for n in counts)
    unit = unit_lattice(few_counts)
    cell = (mesh.points[-1] - mesh.points[0]) / counts
    # the node in the middle lies at the origin: its neighbours on opposite sides have opposite coordinates, so that
    # their blocks are transposes of each other to the bit
    sample = stiffness(replace(unit, points=(unit.points - reach) * cell), materials[0], elements)
    # the node of the small lattice that has the row of each node
    kinds = np.zeros(1, dtype=np.uint8)
    for n, n_few, stride in zip(counts, few_counts, strides_of(few_counts), strict=True):
        place = np.arange(n + 1)
        # within reach of the lower end the same place, within reach of the upper end as far from it, else the middle
        place = np.minimum(place, np.maximum(reach, place - (n - n_few)))
        kinds = ((stride * place).astype(np.uint8)[:, None] + kinds).reshape(-1)
    # the numbers that nodes of the small lattice have in the large one with the same origin; a column minus its
    # row is the same wherever the row is
    large_numbers = np.rint(unit.points @ strides_of(counts)).astype(np.int32)
    shifts = large_numbers[sample.indices] - np.repeat(large_numbers, np.diff(sample.indptr))
    return BlockRows(
        dim=mesh.dim,
        kinds=kinds,
        indptr=sample.indptr,
        indices=shifts,
        data=sample.data.reshape(-1),
    )


@dataclass(frozen=True, eq=False)
class Patches:
    """Parts in which the strain is that of the gradient sum_a u_a slope_a', in axisymmetry with the
    hoop strain sum_a u_a hoop_a."""

    start: np.ndarray  # (n_patches + 1,): patch p has the nodes start[p] to start[p + 1]
    nodes: np.ndarray  # (n,) int32
    slopes: np.ndarray  # (n, dim), 1/m
    hoops: np.ndarray  # (n,), 1/m; without axisymmetry (0,)
    measures: np.ndarray  # (n_patches,): volumes
    # (n_patches,): an element there; of linear elements slice(None), all
    element: np.ndarray | slice
    # (n, corners), or (0, 0): integrals that, times C_hoop, are the stiffness of the part of the hoop
    # strain that varies within an element; see the module
    spread: np.ndarray


def patches_of(mesh: MeshArrays, materials: tuple[Elastic, ...], elements: str) -> Patches:
    """Return the patches of linear or smoothed elements. Elements of plastic bodies have one hoop strain,
    since a patch has one plastic state."""
    axisymmetric = is_axisymmetric(materials)
    if elements == "smoothed":
        return _around_edges(mesh, axisymmetric)
    patches = _of_elements(mesh, axisymmetric)
    if axisymmetric:
        inelastic = inelastic_bodies(materials)[mesh.element_body]
        patches.spread[np.repeat(inelastic, mesh.dim + 1)] = 0.0
    return patches


def _of_elements(mesh: MeshArrays, axisymmetric: bool) -> Patches:
    """Return the elements as patches."""
    slopes, measures = shape_gradients(mesh)
    _, corners, dim = slopes.shape
    hoops = np.empty(0)
    spread = np.empty((0, 0))
    if axisymmetric:
        radii = mesh.points[mesh.elements, 0]
        rule, weights = quadrature_rule(corners, AXISYMMETRIC_DEGREE)
        mean_radius = radii.mean(axis=1)
        # the integral over the element minus that of the mean, as by one more point: with the volume V and the mean
        # radius R the second term is (2 pi V / 3)^2 / (2 pi V R), the integrand at the centroid times V
        rule = np.vstack([rule, np.full(corners, 1 / corners)])
        weights = np.append(weights, -1.0)
        at_points = 2 * np.pi * measures[:, None] * (weights / (radii @ rule.T))
        spread = (at_points @ (rule[:, :, None] * rule[:, None]).reshape(len(rule), -1)).reshape(
            -1, corners
        )
        # phi_a / r at the centroid, where the shape functions are 1/3
        hoops = np.repeat(1 / (3 * mean_radius), corners)
        measures = 2 * np.pi * mean_radius * measures
    return Patches(
        start=starts_of(mesh.elements),
        nodes=mesh.elements.reshape(-1),
        slopes=slopes.reshape(-1, dim),
        hoops=hoops,
        measures=measures,
        element=slice(None),
        spread=spread,
    )


def _around_edges(mesh: MeshArrays, axisymmetric: bool) -> Patches:
    """Return the patches around edges, whose strains are means of those of the elements there."""
    edges = _elements_of_edges(mesh)
    strain_rows, measures = shape_gradients(mesh)
    n, corners, dim = strain_rows.shape
    if axisymmetric:
        radius = mesh.points[mesh.elements, 0].mean(axis=1)
        # phi_a / r at the centroid, where the shape functions are 1/3
        hoops = np.repeat(1 / (3 * radius), corners).reshape(n, corners, 1)
        strain_rows = np.concatenate([strain_rows, hoops], axis=2)
        measures = 2 * np.pi * radius * measures
    # k V_e B_e = sum V_T B_T: each of the k edges of an element T has the part V_T / k of its volume. Block
    # (T, a) of ``of_elements`` (n, n_nodes) is one row, V_T times the slopes of corner a and its hoop strain
    weighted_rows = (measures[:, None, None] * strain_rows).reshape(n * corners, 1, -1)
    of_elements = sparse.bsr_array(
        (weighted_rows, mesh.elements.reshape(-1), corners * np.arange(n + 1)),
        shape=(n, weighted_rows.shape[2] * mesh.n_nodes),
    )
    patch_sums = sparse.bsr_array(edges, blocksize=(1, 1)) @ of_elements
    volumes = edges @ measures  # k V_e
    patch_rows = patch_sums.data[:, 0]  # (blocks, dim), with hoop strains (blocks, dim + 1)
    # in place: for 118k nodes in space this is 150 MB
    patch_rows /= np.repeat(volumes, np.diff(patch_sums.indptr))[:, None]
    return Patches(
        start=patch_sums.indptr,
        nodes=read_only(patch_sums.indices),
        slopes=np.ascontiguousarray(patch_rows[:, :dim]),
        hoops=np.ascontiguousarray(patch_rows[:, dim:].reshape(-1)),
        measures=volumes / len(EDGES[dim]),
        element=edges.indices[edges.indptr[:-1]],
        spread=np.empty((0, 0)),
    )


def element_measures(mesh: MeshArrays, axisymmetric: bool) -> np.ndarray:
    """Return the volumes (n_elements,) of the elements, in axisymmetry of the full
    circumference."""
    if not axisymmetric:
        return mesh.volumes
    return 2 * np.pi * mesh.points[mesh.elements, 0].mean(axis=1) * mesh.volumes


def _sorted_edges(mesh: MeshArrays) -> tuple[np.ndarray, np.ndarray]:
    """Return the order of the edges of all elements, numbered element by element as in EDGES, by body and
    nodes, and the places in this order at which each edge of a body begins, and the end."""
    begin, end = (mesh.elements[:, ends] for ends in EDGES[mesh.dim].T)
    first_key = pair_keys(mesh.element_body[:, None], np.minimum(begin, end), mesh.n_nodes).reshape(
        -1
    )
    last_node = np.maximum(begin, end).reshape(-1)
    # sorted by the last node, then, where equal ones keep this order, by body and first node. The places
    # of each number, one number after the other, are this order: 35 ms for 1.2 million edges of elements
    # in space, by unique 98
    _, order = occurrences(last_node, mesh.n_nodes)
    _, by_first = occurrences(first_key[order], len(mesh.bodies) * mesh.n_nodes)
    order = order[by_first]
    first_key = first_key[order]
    last_node = last_node[order]
    differs = (first_key[1:] != first_key[:-1]) | (last_node[1:] != last_node[:-1])
    starts = np.concatenate([[0], np.flatnonzero(differs) + 1, [len(last_node)]])
    return order, starts.astype(order.dtype)


def edges_of_elements(mesh: MeshArrays) -> np.ndarray:
    """Return the numbers (n_elements, n_edges) of the edges of elements; where bodies share an edge
    each has one."""
    order, starts = _sorted_edges(mesh)
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.repeat(np.arange(len(starts) - 1), np.diff(starts))
    return number.reshape(len(mesh.elements), -1)


def _elements_of_edges(mesh: MeshArrays) -> sparse.csr_array:
    """Return the elements (n_edges, n_elements) around each edge of each body, as ones."""
    order, starts = _sorted_edges(mesh)
    shape = len(starts) - 1, len(mesh.elements)
    element = order // len(EDGES[mesh.dim])
    return sparse.csr_array((np.ones(len(order)), element, starts), shape=shape)


def smoothed(mesh: MeshArrays, values: np.ndarray, measures: np.ndarray) -> np.ndarray:
    """Return S v of the module (n_elements, n_values) for values v (n_elements, n_values) of elements,
    which have the volumes ``measures`` (n_elements,)."""
    edges = _elements_of_edges(mesh)
    means = (edges @ (measures[:, None] * values)) / (edges @ measures)[:, None]
    return (edges.T @ means) / len(EDGES[mesh.dim])


def edge_means(mesh: MeshArrays, values: np.ndarray) -> np.ndarray:
    """Return the means (n_elements, n_values) of the values (n_edges, n_values) of the edges of elements,
    the patches of smoothed ones."""
    return (_elements_of_edges(mesh).T @ values) / len(EDGES[mesh.dim])


def shape_gradients(mesh: MeshArrays) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradients (n_elements, dim + 1, dim) of the shape functions of elements, and their
    volumes."""
    n, corners = mesh.elements.shape
    slopes = np.empty((n, corners, mesh.dim))
    measures = np.empty(n)
    bad = max(
        in_parts(
            _shape_gradients,
            n,
            slopes.size,
            ZERO[mesh.dim],
            mesh.points,
            mesh.elements,
            slopes,
            measures,
        )
    )
    if bad >= 0:
        raise ValueError(
            f"element {bad} with nodes {mesh.elements[bad].tolist()} is inverted or degenerate: "
            "adaptmg.mesh.check_mesh finds all that is wrong with a mesh"
        )
    return slopes, measures


def patches_of_nodes(
    start: np.ndarray, nodes: np.ndarray, n_nodes: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return ``begin`` (n_nodes + 1,) and ``patches`` (n,): node i is in the ascending patches
    ``patches[begin[i]:begin[i + 1]]``, and patch p has ``nodes[start[p]:start[p + 1]]``."""
    begin = np.zeros(n_nodes + 2, dtype=start.dtype)
    patches = np.empty(len(nodes), dtype=start.dtype)
    _sort_by_nodes(start, nodes, begin, patches)
    return begin[:-1], patches


def elements_of_nodes(elements: np.ndarray, n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the elements of each node, ascending, as :func:`patches_of_nodes`."""
    return patches_of_nodes(starts_of(elements), read_only(elements.reshape(-1)), n_nodes)


def starts_of(elements: np.ndarray) -> np.ndarray:
    """Return the places (n + 1,) at which the corners of each element begin among all, and the end."""
    return np.arange(
        0,
        elements.size + 1,
        elements.shape[1],
        dtype=np.int32 if elements.size < 2**31 else np.int64,
    )


def pattern(
    of_nodes: tuple[np.ndarray, np.ndarray], start: np.ndarray, nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return row pointers (n_nodes + 1,) and sorted columns of the matrix of patches; ``of_nodes`` is
    what :func:`patches_of_nodes` returns for their ``start`` and ``nodes``. ValueError for a node
    without a patch."""
    n = len(of_nodes[0]) - 1
    indptr = np.zeros(n + 1, dtype=np.int64)
    arguments = *of_nodes, start, nodes, indptr
    # for each node of a patch some 8 numbers are read
    columns = in_parts(_find_neighbours, n, 8 * len(nodes), *arguments)
    if not indptr[1:].all():
        raise ValueError(f"node {np.argmin(indptr[1:])} belongs to no element; remove unused nodes")
    np.cumsum(indptr, out=indptr)
    return indptr, np.concatenate(columns)


def separate_bodies(mesh: MeshArrays) -> tuple[np.ndarray, np.ndarray]:
    """Return elements and points in which bodies share no points: a node that several bodies use
    becomes a point for each of them. The first body keeps its number, the points of further bodies get
    the numbers n_nodes, n_nodes + 1, ..."""
    if len(mesh.bodies) == 1:
        return mesh.elements, mesh.points
    body_of_corner = np.repeat(mesh.element_body, mesh.elements.shape[1])
    numbers, doubled_nodes = doubled(body_of_corner, mesh.elements.reshape(-1), mesh.n_nodes)
    points = np.concatenate([mesh.points, mesh.points[doubled_nodes]])
    elements = numbers.astype(np.int32).reshape(mesh.elements.shape)
    return read_only(elements), read_only(points)


@kernel
def _sort_by_nodes(start, nodes, begin, patches):
    """Write the arrays of :func:`patches_of_nodes`, ``begin`` with one more entry: sorted by counting.
    On a mesh of 289 nodes the transpose of a sparse matrix, which does the same, takes 60 us more."""
    for node in nodes:
        begin[node + 2] += 1
    for i in range(2, len(begin)):
        begin[i] += begin[i - 1]
    # begin[i + 1] is the place of the next patch of node i, in the end that behind its last one
    for patch in range(len(start) - 1):
        for at in range(start[patch], start[patch + 1]):
            i = nodes[at] + 1
            patches[begin[i]] = patch
            begin[i] += 1


@kernel
def _find_neighbours(first, last, start, patches, begin, nodes, counts):
    """Return the columns of the rows ``first``, ..., ``last`` - 1 of the pattern, ascending in each
    row: nodes that share a patch, each node with itself. Node i has the patches
    ``patches[start[i]:start[i + 1]]``, patch e the nodes ``nodes[begin[e]:begin[e + 1]]``. The number
    of columns of row i goes to ``counts[i + 1]``. Found once, in an array that is too long: 10.4 ms for
    263k nodes, 4.5 for 36k in 3D, counted before they are found 13.3 and 7.1."""
    # unsigned: numba tests signed indices for negative ones, which takes half of the time
    row_that_met = np.empty(len(start) - 1, dtype=np.int32)
    for v in range(len(row_that_met)):  # np.full compiles for .1 s
        row_that_met[v] = -1
    one = np.uint64(1)
    room = 0
    for at in range(start[first], start[last]):
        e = np.uint64(patches[at])
        room += begin[e + one] - begin[e]
    columns = np.empty(room, dtype=np.int32)
    end = np.uint64(0)
    for i in range(first, last):
        row = end
        for at in range(start[i], start[i + 1]):
            e = np.uint64(patches[at])
            for p in range(np.uint64(begin[e]), np.uint64(begin[e + one])):
                v = np.uint64(nodes[p])
                if row_that_met[v] != i:
                    row_that_met[v] = i
                    # few are out of order
                    k = end
                    while k > row and columns[k - one] > nodes[p]:  # one further down each time
                        columns[k] = columns[k - one]
                        k -= one
                    columns[k] = nodes[p]
                    end += one
        counts[i + 1] = end - row
    return columns[:end]


@kernel
def _shape_gradients(first, last, zero, points, elements, slopes, measures):
    """Write the gradients of the shape functions of elements into ``slopes`` (n_elements, dim + 1,
    dim), and their volumes into ``measures`` (n_elements,). Returns the first element whose volume is
    not positive, or -1. ``zero``, here and below, is ZERO[dim]."""
    dim = len(zero)
    edges = np.empty((len(zero), len(zero)))
    normals = np.empty((len(zero), len(zero)))
    for e in range(first, last):
        for k in range(dim):
            for d in range(dim):
                edges[k, d] = points[elements[e, k + 1], d] - points[elements[e, 0], d]
        # the gradient of each corner's shape function, times the determinant of the edges
        for k in range(dim):
            a = (k + 1) % dim
            b = (k + 2) % dim
            if len(zero) == 2:
                # the other edge turned by a right angle, towards corner k + 1
                normals[k, 0], normals[k, 1] = (1 - 2 * k) * edges[a, 1], (2 * k - 1) * edges[a, 0]
            else:
                for d in range(dim):
                    i = (d + 1) % dim
                    j = (d + 2) % dim
                    normals[k, d] = edges[a, i] * edges[b, j] - edges[a, j] * edges[b, i]
        determinant = 0.0
        for d in range(dim):
            determinant += edges[0, d] * normals[0, d]
        if not determinant > 0.0:
            return e
        measures[e] = determinant / (2.0 if len(zero) == 2 else 6.0)
        for d in range(dim):
            slopes[e, 0, d] = 0.0
            for k in range(dim):
                slopes[e, k + 1, d] = normals[k, d] / determinant
                slopes[e, 0, d] -= slopes[e, k + 1, d]
    return -1


@inner_kernel(inline="always")
def _add_isotropic(zero, i, lame, shear, p, first, last, nodes, slopes, slot, data):
    """Add lame g h' + shear (h g' + g.h I) with the slopes g of corner p, node i, and h of the corners
    from ``first`` to before ``last`` of its patch, to the blocks ``data[slot[j]]`` of their nodes j >= i.
    ``lame`` and ``shear`` are times the volume. (x, y, z) is lame g, (r, s, t) shear g, (u, v, w) h."""
    x = lame * slopes[p, 0]
    y = lame * slopes[p, 1]
    z = lame * slopes[p, 2] if len(zero) == 3 else 0.0
    r = shear * slopes[p, 0]
    s = shear * slopes[p, 1]
    t = shear * slopes[p, 2] if len(zero) == 3 else 0.0
    for q in range(np.uint64(first), last):
        if nodes[q] < i:
            continue
        at = np.uint64(slot[np.uint64(nodes[q])])
        u = slopes[q, 0]
        v = slopes[q, 1]
        w = slopes[q, 2] if len(zero) == 3 else 0.0
        product = r * u + s * v + t * w
        data[at, 0, 0] += (x + r) * u + product
        data[at, 0, 1] += x * v + s * u
        data[at, 1, 0] += y * u + r * v
        data[at, 1, 1] += (y + s) * v + product
        if len(zero) == 3:
            data[at, 0, 2] += x * w + t * u
            data[at, 1, 2] += y * w + t * v
            data[at, 2, 0] += z * u + r * w
            data[at, 2, 1] += z * v + s * w
            data[at, 2, 2] += (z + t) * w + product


@inner_kernel(inline="always")
def _unit_stresses(zero, measure, tensor, p, slopes, hoops, table, stress):
    """Write V C B_p: ``stress[c, a]`` is column c of the stress that a unit displacement of corner p along
    a makes, times the measure V of the patch, whose C is row ``tensor`` of ``table``; (x, y, z) is V times
    the slopes of p, in axisymmetry z is V times its hoop strain."""
    x = measure * slopes[p, 0]
    y = measure * slopes[p, 1]
    z = measure * (slopes[p, 2] if len(zero) == 3 else hoops[p] if len(hoops) else 0.0)
    for c in range(2 * len(zero)):
        xx = table[tensor, c, _XX]
        yy = table[tensor, c, _YY]
        zz = table[tensor, c, _ZZ]
        xy = table[tensor, c, _XY]
        if len(zero) == 3:
            yz = table[tensor, c, _YZ]
            xz = table[tensor, c, _XZ]
            stress[c, 0] = xx * x + xy * y + xz * z
            stress[c, 1] = xy * x + yy * y + yz * z
            stress[c, 2] = xz * x + yz * y + zz * z
        else:
            stress[c, 0] = xx * x + xy * y + zz * z
            stress[c, 1] = xy * x + yy * y


@inner_kernel(inline="always")
def _add_work(zero, stress, q, slopes, hoops, at, data):
    """Add S' B_q (dim, dim) to block number ``at`` of ``data`` (n_blocks, dim, dim), where ``stress``
    (2 dim, dim) is S = V C B_p of corner p, a row a component of the stress (see _unit_stresses).
    (u, v, w) are the slopes of corner q, its row of ``slopes`` (n_corners, dim), 1/m; in axisymmetry w
    is its hoop strain, of ``hoops`` (n_corners,), else (0,)."""
    u = slopes[q, 0]
    v = slopes[q, 1]
    w = slopes[q, 2] if len(zero) == 3 else hoops[q] if len(hoops) else 0.0
    # the share of this patch is summed first: an entry, a sum over patches, is rounded once by it
    for a in range(len(zero)):
        xx = stress[_XX, a]
        yy = stress[_YY, a]
        zz = stress[_ZZ, a]
        xy = stress[_XY, a]
        if len(zero) == 3:
            yz = stress[_YZ, a]
            xz = stress[_XZ, a]
            data[at, a, 0] += xx * u + xy * v + xz * w
            data[at, a, 1] += xy * u + yy * v + yz * w
            data[at, a, 2] += xz * u + yz * v + zz * w
        else:
            data[at, a, 0] += xx * u + xy * v + zz * w
            data[at, a, 1] += xy * u + yy * v


@kernel
def _add_patches(
    first,
    last,
    zero,
    start,
    patches,
    begin,
    nodes,
    slopes,
    hoops,
    spread,
    measures,
    rows,
    table,
    lame_constants,
    indptr,
    indices,
    data,
):
    """Write the upper half of the rows ``first``, ..., ``last`` - 1 of the matrix with the pattern
    ``indptr``, ``indices`` and the blocks ``data``: the block of nodes i and j is the sum of V B_p' C
    B_q over the patches in which i is a corner p and j a corner q. Node i is in
    ``patches[start[i]:start[i + 1]]``, patch e has ``nodes[begin[e]:begin[e + 1]]`` and the tensor
    ``table[rows[e]]``, whose ``lame_constants[rows[e]]`` are NaN where all its entries count;
    ``slopes``, ``hoops``, ``spread`` and ``measures`` are those of :class:`Patches`. ``slot`` has the
    places of the blocks of row i by the nodes j. Without a ``table`` (None) all tensors are isotropic,
    and the kernel compiles in 2.3 s in place of 3.8: numba leaves out the branches for others."""
    one = np.uint64(1)
    if table is not None:
        stress = np.empty((2 * len(zero), len(zero)))
    slot = np.empty(len(indptr) - 1, dtype=np.int64)
    for i in range(first, last):
        for at in range(indptr[i], indptr[i + 1]):
            slot[indices[at]] = at
        data[slot[i] : indptr[i + 1]] = 0.0
        for k in range(start[i], start[i + 1]):
            # ask for the nodes and the slopes (three lines of 64 bytes) of the patch that comes _LATER, from its
            # first corner on
            ahead = k + _LATER if k + _LATER < len(patches) else k
            later = np.int64(begin[np.uint64(patches[ahead])])
            prefetch(np.uintp(np.int64(nodes.ctypes.data) + nodes.itemsize * later))
            for line in range(3):
                prefetch(np.uintp(np.int64(slopes.ctypes.data) + 8 * len(zero) * later + 64 * line))
            e = np.uint64(patches[k])
            p = np.uint64(begin[e])
            end = np.uint64(begin[e + one])
            while nodes[p] != i:  # the patch has the node
                p += one
            tensor = np.uint64(rows[e])
            lame = lame_constants[tensor, 0]
            shear = lame_constants[tensor, 1]
            if table is None or not np.isnan(lame):
                lame *= measures[e]
                shear *= measures[e]
                _add_isotropic(zero, i, lame, shear, p, begin[e], end, nodes, slopes, slot, data)
                continue
            _unit_stresses(zero, measures[e], tensor, p, slopes, hoops, table, stress)
            for q in range(np.uint64(begin[e]), end):
                if nodes[q] < i:
                    continue
                at = np.uint64(slot[np.uint64(nodes[q])])
                _add_work(zero, stress, q, slopes, hoops, at, data)
                if len(spread):
                    data[at, 0, 0] += table[tensor, _ZZ, _ZZ] * spread[p, q - np.uint64(begin[e])]


@kernel
def _mirror(first, last, zero, indptr, indices, data):
    """Write the lower half of the rows ``first``, ..., ``last`` - 1 of the matrix with the pattern
    ``indptr``, ``indices`` and the blocks ``data``, diagonal blocks included: the transposes of the
    upper half.

    Row i takes its block of column j < i from row j. ``next_block[j]`` is the first block of row j whose
    column is beyond all rows written so far: rows are written in ascending order, so that it is the
    block of the next row that has the column j. It is 0 as long as row j, before ``first``, has not
    been needed."""
    next_block = np.empty(last, dtype=np.int64)
    for j in range(last):  # np.zeros compiles for .1 s
        next_block[j] = 0
    for i in range(first, last):
        at = np.uint64(indptr[i])
        while indices[at] < i:
            column = np.uint64(indices[at])
            if next_block[column] == 0:
                next_block[column] = indptr[column]
                while indices[next_block[column]] < i:
                    next_block[column] += 1
            mirrored = np.uint64(next_block[column])
            next_block[column] += 1
            for k in range(len(zero)):
                for m in range(len(zero)):
                    data[at, k, m] = data[mirrored, m, k]
            at += np.uint64(1)
        for k in range(len(zero)):
            for m in range(k):
                data[at, k, m] = data[at, m, k]
        next_block[i] = np.int64(at) + 1  # behind the diagonal


def rigid_motions(mesh: MeshArrays, axisymmetric: bool = False) -> np.ndarray:
    """Return orthonormal rigid-body motions (n_dofs, k) of every body, as ``near_nullspace`` of an
    uncoupled problem.

    Per body 3 columns in 2D, 6 in 3D, 1 in axisymmetry (x = r, y = z), zero outside the body, in
    the order of ``mesh.bodies``. Bodies that share nodes (glued materials) move together and count
    as one.

    Examples
    --------
    >>> mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> am.discrete.rigid_motions(mesh).shape
    (18, 3)
    """
    checks.instance("mesh", mesh, MeshArrays)
    checks.flag("axisymmetric", axisymmetric)
    return motions_at(mesh, axisymmetric, ALL_NODES).reshape(mesh.points.size, -1)


def motions_at(mesh: MeshArrays, axisymmetric: bool, nodes: np.ndarray | slice) -> np.ndarray:
    """Return :func:`rigid_motions` (n, dim, k) at some nodes."""
    columns = []
    for piece in nodes_of_pieces(mesh):
        if axisymmetric:  # only along the axis: others would strain the hoop
            modes = np.tile([[0.0], [1 / np.sqrt(len(piece))]], (len(piece), 1, 1))
        elif len(piece) == mesh.n_nodes:
            return rigid_body_modes(mesh.points, nodes)
        else:
            modes = rigid_body_modes(mesh.points[piece])
        column = np.zeros((mesh.n_nodes, mesh.dim, modes.shape[2]))
        column[piece] = modes
        columns.append(column)
    return np.concatenate(columns, axis=2)[nodes]


def nodes_of_pieces(mesh: MeshArrays) -> list[np.ndarray]:
    """Return the ascending nodes of each set of bodies that share nodes, in the order of their first
    bodies."""
    n_bodies = len(mesh.bodies)
    if n_bodies == 1:
        return [np.arange(mesh.n_nodes)]
    # bodies and nodes are connected where a body uses a node
    body = np.repeat(mesh.element_body, mesh.elements.shape[1])
    size = n_bodies + mesh.n_nodes
    uses = sparse.coo_array(
        (np.ones(len(body), dtype=np.int8), (body, n_bodies + mesh.elements.reshape(-1))),
        shape=(size, size),
    )
    labels = connected_components(uses, directed=False)[1]
    pieces = list(dict.fromkeys(labels[np.unique(mesh.element_body)].tolist()))
    return [np.flatnonzero(labels[n_bodies:] == piece) for piece in pieces]


def rotations(points: np.ndarray, axes: np.ndarray) -> list[np.ndarray]:
    """Return the small rotations (n, dim) of points (n, dim) about the origin, in 3D about each of three
    ``axes`` (rows); in 2D there is one, whatever ``axes`` (2, 2) are."""
    spins = [[[0.0, 1.0], [-1.0, 0.0]]] if len(axes) == 2 else np.cross(axes[:, None], np.eye(3))
    return [points @ np.array(spin) for spin in spins]


@one_blas_thread()
def rigid_body_modes(points: np.ndarray, nodes: np.ndarray | slice = ALL_NODES) -> np.ndarray:
    """Return the translations and, about the principal axes at the centroid, rotations (n, dim, k)
    of points (n_nodes, dim) at some of them, orthonormal over all."""
    n, dim = points.shape
    from_centroid = points - np.einsum("nd->d", points) / n
    moments = from_centroid.T @ from_centroid
    moments_of_axes = np.zeros(1)
    axes = np.eye(2)
    if dim == 3:
        moments_of_axes, axes = np.linalg.eigh(moments)
    # the norms over all points of rotations about unit axes a: |a x x|^2 = |x|^2 - (a . x)^2
    turn_sizes = np.sqrt(np.maximum(np.trace(moments) - moments_of_axes, 0.0))
    # of points on a line one rotation vanishes, up to rounding: QR puts another orthonormal mode there
    on_line = not turn_sizes.min() > checks.SIX_DIGITS * turn_sizes.max()
    turning = from_centroid if on_line else from_centroid[nodes]
    modes = np.zeros((len(turning), dim, dim + len(turn_sizes)))
    modes[:, range(dim), range(dim)] = 1 / np.sqrt(n)
    for k, turn in enumerate(rotations(turning, axes.T)):
        modes[:, :, dim + k] = turn / (turn_sizes[k] or 1.0)  # 0: points on the axis do not turn
    if on_line:
        return np.linalg.qr(modes.reshape(n * dim, -1))[0].reshape(n, dim, -1)[nodes]
    return modes
