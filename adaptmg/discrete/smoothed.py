r"""Edge-smoothed strains: the mean strain around each edge takes the place of the strain of each P1 element.

.. math:: K' = \sum_e A_e\, B_e^T \left(2\mu I + \lambda_1 m m^T\right) B_e, \qquad
   A_e = \sum_{T \ni e} V_T / k, \quad A_e B_e = \sum_{T \ni e} V_T B_T / k, \qquad \lambda_1 = \min(\lambda, 4 \mu)

over the edges e of each body, with the k = 3 (in space 6) edges of an element T of volume :math:`V_T`, its strain
:math:`B_T u`, and the trace m (G. R. Liu, T. Nguyen-Thoi and K. Y. Lam, J. Sound Vib. 320, 2009,
doi:10.1016/j.jsv.2008.08.027). In axisymmetry :math:`V_T = 2\pi r_T |T|` and the hoop strain is that at the centroid,
:math:`\sum_a u_{r,a} / (3 r_T)`. A mean does not go beyond a body, across which strains jump.

With the mean :math:`(S v)_T` over the edges of T of the means :math:`\sum_{T \ni e} V_T v_T / (k A_e)` around them,

.. math:: u^T K' v = \sum_T V_T\, B_T u : \left(2\mu\, S B v + \lambda_1\, m\, m^T S B v\right)_T ,

where S is symmetric for the weights V. Loads of initial strains, energies and stresses follow from S.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg._numba import inner_kernel, kernel
from adaptmg._threads import in_parts
from adaptmg.discrete.anisotropic import add_tensors, moduli
from adaptmg.discrete.elasticity import (
    Materials,
    block_matrix,
    body_materials,
    check_shapes,
    check_used,
    is_axisymmetric,
    lame_constants,
    mirror,
    node_pattern,
    pattern_of,
    shape_gradients,
)
from adaptmg.discrete.recovery import apart
from adaptmg.mesh.arrays import MeshArrays

#: of the shear modulus: the part of Lame's first constant that acts on means around edges
EDGE_PART = 4.0


def edge_lame(lame: np.ndarray, shear: np.ndarray) -> np.ndarray:
    """Return the part of Lame's first constant that acts on the means around edges, Pa."""
    return np.minimum(lame, EDGE_PART * shear)


def element_measures(mesh: MeshArrays, axisymmetric: bool) -> np.ndarray:
    """Return the volumes (n_elements,) of the elements, in axisymmetry of the full circumference."""
    if not axisymmetric:
        return mesh.volumes
    return 2 * np.pi * mesh.points[mesh.elements, 0].mean(axis=1) * mesh.volumes


def smoothed_stiffness(mesh: MeshArrays, material: Materials) -> sparse.bsr_array:
    """Assemble K' as :func:`adaptmg.discrete.stiffness` does the matrix of linear elements; same form and errors."""
    materials = body_materials(mesh, material)
    own, patches, dim = moduli(mesh, materials, EDGE_PART), _patches(mesh, is_axisymmetric(materials)), mesh.dim
    places = np.arange(len(patches.nodes), dtype=np.int32 if len(patches.nodes) < 2**31 else np.int64)
    by_node = sparse.csr_array((places, patches.nodes, patches.start),
                               shape=(len(patches.measures), mesh.n_nodes)).tocsc()
    of_nodes, size = (by_node.indptr, by_node.indices), len(patches.nodes) * 8  # some 4 (in space 7) others for each
    indptr, indices = pattern_of(*of_nodes, patches.nodes, patches.start, size)
    data = np.empty((len(indices), dim, dim))
    own_nodes = patches.nodes, patches.slopes, patches.hoops
    if own is None:
        lame, shear = lame_constants(materials)
        moduli_of_edges = patches.measures * np.stack([edge_lame(lame, shear), shear])[:, patches.body]
        in_parts(add_patches, mesh.n_nodes, data.size, (0.0,) * dim, *of_nodes, by_node.data, patches.start, *own_nodes,
                 *moduli_of_edges, indptr, indices, data)
    else:
        data[:] = 0.0
        # one tensor for each body: its axes do not vary
        add_tensors(patches.start, *own_nodes, patches.measures, patches.body, own.table, indptr, indices, data)
    in_parts(mirror, mesh.n_nodes, data.size, indptr, indices, data)
    return block_matrix(data, indices, indptr)


@dataclass(frozen=True, eq=False)
class _Patches:
    """The elements around each edge: the strain of an edge is that of the gradients sum_a u_a slope_a', in axisymmetry
    with the hoop strain sum_a u_a hoop_a."""

    start: np.ndarray  # (n_edges + 1,): edge e has the nodes start[e] to start[e + 1]
    nodes: np.ndarray  # (n,) int32
    slopes: np.ndarray  # (n, dim)
    hoops: np.ndarray  # (n,), or (0,)
    measures: np.ndarray  # (n_edges,): volumes, 0 of an edge with nothing around
    body: np.ndarray  # (n_edges,) int32


def _patches(mesh: MeshArrays, axisymmetric: bool) -> _Patches:
    """Around each edge, which is an entry above the diagonal of the nodal pattern; of all others nothing is around."""
    cells, points = apart(mesh)
    n = len(points)
    indptr, indices, *of_nodes = node_pattern(cells, n)
    check_used(indptr)
    slopes, measures = np.empty((len(cells), mesh.dim + 1, mesh.dim)), np.empty(len(cells))
    check_shapes(mesh, max(in_parts(shape_gradients, len(cells), slopes.size, mesh.points, mesh.elements, slopes,
                                    measures)))
    hoop = np.empty(0)
    if axisymmetric:
        radius = mesh.points[mesh.elements, 0].mean(axis=1)
        measures, hoop = 2 * np.pi * radius * measures, 1 / (3 * radius)
    start, size = np.zeros(len(indices) + 1, dtype=np.int64), len(indices) * 8
    arguments = cells, *of_nodes, indptr, indices, start
    in_parts(size_patches, n, size, *arguments)
    np.cumsum(start, out=start)
    nodes, own = np.empty(start[-1], dtype=np.int32), np.empty((start[-1], mesh.dim))
    hoops = np.empty(start[-1] if axisymmetric else 0)
    volumes, body = np.zeros(len(indices)), np.zeros(len(indices), dtype=np.int32)
    in_parts(fill_patches, n, size, *arguments, mesh.elements, mesh.element_body, slopes, measures, hoop,
             nodes, own, hoops, volumes, body)
    return _Patches(start, nodes, own, hoops, volumes, body)


def smoothed(mesh: MeshArrays, values: np.ndarray, measures: np.ndarray) -> np.ndarray:
    """Return S v (n_elements, n_values) of the values of elements, which have these ``measures``."""
    cells, points = apart(mesh)
    indptr, indices, start, listed = node_pattern(cells, len(points))
    result = np.zeros(values.shape)
    smooth(cells, start, listed, indptr, indices, measures, np.ascontiguousarray(values), result)
    return result


@inner_kernel
def _has(cells, e, v):
    """Whether element e has the node v."""
    found = False
    for c in range(cells.shape[1]):
        found |= cells[e, c] == v
    return found


@kernel
def size_patches(first, last, cells, start, listed, indptr, indices, size):
    """Write to ``size[at + 1]``, which comes as 0, how many nodes have the elements around the edge ``at``."""
    marker = np.full(len(start) - 1, -1, dtype=np.int64)
    for i in range(first, last):
        for at in range(indptr[i], indptr[i + 1]):
            j, count = indices[at], 0
            if j <= i:
                continue
            for k in range(start[i], start[i + 1]):
                e = listed[k]
                if _has(cells, e, j):
                    for c in range(cells.shape[1]):
                        if marker[cells[e, c]] != at:
                            marker[cells[e, c]] = at
                            count += 1
            size[at + 1] = count


@kernel
def fill_patches(first, last, cells, start, listed, indptr, indices, begin, elements, body, slopes, measures, hoop,
                 nodes, own, hoops, volumes, bodies):
    """Write the patches of edges: ``nodes`` as ``elements`` number them, mean gradients ``own`` and ``hoops``, their
    share of the ``volumes`` and their body. ``slopes``, ``measures`` and ``hoop`` are those of the elements."""
    corners, dim = cells.shape[1], cells.shape[1] - 1
    share = 1.0 / (3.0 if dim == 2 else 6.0)
    for i in range(first, last):
        for at in range(indptr[i], indptr[i + 1]):
            j = indices[at]
            if j <= i:
                continue
            end, volume, e = begin[at], 0.0, 0
            for k in range(start[i], start[i + 1]):
                if not _has(cells, listed[k], j):
                    continue
                e = listed[k]
                volume += measures[e]
                for c in range(corners):
                    v, p = elements[e, c], begin[at]
                    while p < end and nodes[p] != v:  # one further each time
                        p += 1
                    if p == end:
                        nodes[p] = v
                        own[p] = 0.0
                        if len(hoops):
                            hoops[p] = 0.0
                        end += 1
                    for d in range(dim):
                        own[p, d] += measures[e] * slopes[e, c, d]
                    if len(hoops):
                        hoops[p] += measures[e] * hoop[e]
            for p in range(begin[at], end):
                for d in range(dim):
                    own[p, d] /= volume
                if len(hoops):
                    hoops[p] /= volume
            volumes[at], bodies[at] = share * volume, body[e]


@kernel
def add_patches(first, last, zero, start, edges, places, begin, nodes, slopes, hoops, lame, shear, indptr, indices,
                data):
    """Write the upper half of rows: node i is in the patches of ``edges[start[i]:start[i + 1]]``, in each at
    ``places``. ``zero`` (dim,) is a tuple, so that the loops over components are compiled for their length."""
    dim, slot = len(zero), np.empty(len(indptr) - 1, dtype=np.int64)
    for i in range(first, last):
        for at in range(indptr[i], indptr[i + 1]):
            slot[indices[at]] = at
        data[slot[i]:indptr[i + 1]] = 0.0
        for k in range(start[i], start[i + 1]):
            e, p = edges[k], places[k]
            one, mu = lame[e], shear[e]
            for q in range(begin[e], begin[e + 1]):
                if nodes[q] < i:
                    continue
                at, dot = slot[nodes[q]], 0.0
                for a in range(dim):
                    dot += slopes[p, a] * slopes[q, a]
                    for b in range(dim):
                        data[at, a, b] += one * (slopes[p, a] * slopes[q, b]) + mu * (slopes[p, b] * slopes[q, a])
                for a in range(dim):
                    data[at, a, a] += mu * dot
                if len(hoops):
                    data[at, 0, 0] += (one * (slopes[p, 0] * hoops[q] + hoops[p] * slopes[q, 0])
                                       + (one + 2.0 * mu) * (hoops[p] * hoops[q]))
                    data[at, 0, 1] += one * (hoops[p] * slopes[q, 1])
                    data[at, 1, 0] += one * (slopes[p, 1] * hoops[q])


@kernel
def smooth(cells, start, listed, indptr, indices, measures, values, result):
    """Add to ``result`` (n_elements, n_values) the means over the edges of elements of the means around edges."""
    share, mean = 1.0 / (3.0 if cells.shape[1] == 3 else 6.0), np.empty(values.shape[1])
    for i in range(len(start) - 1):
        for at in range(indptr[i], indptr[i + 1]):
            j, volume = indices[at], 0.0
            if j <= i:
                continue
            mean[:] = 0.0
            for k in range(start[i], start[i + 1]):
                e = listed[k]
                if _has(cells, e, j):
                    volume += measures[e]
                    for c in range(len(mean)):
                        mean[c] += measures[e] * values[e, c]
            for k in range(start[i], start[i + 1]):
                e = listed[k]
                if _has(cells, e, j):
                    for c in range(len(mean)):
                        result[e, c] += share * mean[c] / volume
