r"""The stiffness matrix of P1 elasticity; the bodies may differ in material.

.. math:: a(u, v) = \int_\Omega \lambda\,\mathrm{div}\,u\,\mathrm{div}\,v + 2\mu\,\varepsilon(u) : \varepsilon(v),
   \qquad K_{ab} = V \left(\lambda\, g_a g_b^T + \mu\, g_b g_a^T + \mu\,(g_a \cdot g_b) I\right)

with the Lame constants of the material, so that plane stress, plane strain and three dimensions are one form, the
constant gradients g_a of the shape functions and the volume V of an element. In axisymmetry x is the radius r and y the
axial coordinate z, the hoop strain :math:`u_r / r` joins in, all is weighted with :math:`2 \pi r`, and forces are in N.
There :math:`\int r` and :math:`\int \varphi_a` are exact, :math:`\int \varphi_a \varphi_b / r` takes a rule with
interior points and positive weights: any rule that is exact for degree 1 gives the other integrals too, so that the sum
is one quadrature of the energy, hence positive semidefinite, and constant strains (:math:`u_r = c r`) are exact.

Both blocks (a, b) and (b, a) come from one computation and are added in the order of the elements: the matrix is
bitwise symmetric, and the same in every run.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import sparse

from adaptmg._numba import inner_kernel, kernel
from adaptmg._threads import in_colours, in_parts, scattering
from adaptmg.discrete.anisotropic import Moduli, add_tensors, moduli
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_rule
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.materials import Axisymmetric, Elastic

#: one material for all bodies, body name -> material, or what :func:`body_materials` returns
Materials = Elastic | Mapping[str, Elastic] | tuple[Elastic, ...]

# of the largest radius: nodes on the axis may lie this far behind it by rounding
_ROUNDING = 1e-9


def body_materials(mesh: MeshArrays, material: Materials) -> tuple[Elastic, ...]:
    """Return materials in the order of ``mesh.bodies``, checked against the mesh; such a tuple stays unchanged."""
    if isinstance(material, tuple):
        return material
    if isinstance(material, Mapping):
        missing = [body for body in mesh.bodies if body not in material]
        if missing:
            raise ValueError(f"no material for body {missing[0]!r}; the bodies are {', '.join(mesh.bodies)}, materials "
                             f"are given for {', '.join(map(str, material)) or 'none'}")
        materials = tuple(material[body] for body in mesh.bodies)
    else:
        materials = (material,) * len(mesh.bodies)
    for one in materials:
        if not isinstance(one, Elastic):
            raise TypeError("material must be PlaneStrain, PlaneStress, Axisymmetric or Solid, or a mapping body name "
                            f"-> one of them, got {one!r}")
        if one.dim != mesh.dim:
            raise ValueError(f"the material is {one.dim}D, the mesh {mesh.dim}D: use Solid in 3D, PlaneStrain, "
                             "PlaneStress or Axisymmetric in 2D")
    if is_axisymmetric(materials):
        if not all(isinstance(one, Axisymmetric) for one in materials):
            raise ValueError("either all bodies are Axisymmetric or none, got "
                             + ", ".join(type(one).__name__ for one in materials))
        r = mesh.points[:, 0]
        if r.min() < -_ROUNDING * r.max():
            raise ValueError(f"axisymmetric bodies lie at radii x >= 0, got x = {r.min():.6g} m at node "
                             f"{int(np.argmin(r))}")
    return materials


def is_axisymmetric(material: Materials) -> bool:
    """Return whether x is the radius r, y the axial coordinate z, and integrals are weighted with 2 pi r."""
    if isinstance(material, Elastic):
        return isinstance(material, Axisymmetric)
    materials = material.values() if isinstance(material, Mapping) else material
    return any(isinstance(one, Axisymmetric) for one in materials)


def lame_constants(materials: tuple[Elastic, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the Lame constants lambda and mu (n_bodies,) as they enter the stress, Pa."""
    return np.array([one.lame for one in materials]), np.array([one.shear_modulus for one in materials])


def stiffness(mesh: MeshArrays, material: Materials) -> sparse.bsr_array:
    """Assemble the stiffness matrix (n_dofs, n_dofs), with no boundary condition applied.

    Blocks of dim x dim, sorted indices, dof = dim * node + component; bitwise symmetric. N/m (plane: per metre of
    thickness; axisymmetric: of the full circumference). The material is the same in all bodies, or body name ->
    Elastic. ValueError if materials and mesh do not fit, a node number is out of range, or an element is inverted or
    degenerate.

    On the axis r = 0 the user prescribes u_r = 0, e.g. ``Support("axis", x=0.0)``: the hoop strain is bounded for no
    other displacement. Without it the matrix is finite still.
    """
    materials = body_materials(mesh, material)
    dim = mesh.dim
    indptr, indices, *of_nodes = node_pattern(mesh.elements, mesh.n_nodes)
    check_used(indptr)
    data, bad, own = np.empty((len(indices), dim, dim)), -1, moduli(mesh, materials)
    arguments = (mesh.points, mesh.elements, mesh.element_body, *lame_constants(materials))
    if own is not None:
        in_parts(_clear, len(data), data.size, data)
        _add_tensors(mesh, own, is_axisymmetric(materials), indptr, indices, data)
        in_parts(mirror, mesh.n_nodes, data.size, indptr, indices, data)
    elif dim == 3:
        bad = max(in_parts(add_solid, mesh.n_nodes, data.size, *arguments, *of_nodes, indptr, indices, data))
        in_parts(mirror, mesh.n_nodes, data.size, indptr, indices, data)
    else:
        # not np.zeros: its pages are mapped one by one while they are written, several times slower
        in_parts(_clear, len(data), data.size, data)
        if is_axisymmetric(materials):
            bad = add_axisymmetric(*arguments, *quadrature_rule(3, AXISYMMETRIC_DEGREE), indptr, indices, data)
        else:
            ranges = scattering(mesh.elements, size=data.size)
            bad = max(in_colours(ranges, add_plane, *arguments, indptr, indices, data))
    check_shapes(mesh, bad)
    return block_matrix(data, indices, indptr)


def _add_tensors(mesh: MeshArrays, own: Moduli, axisymmetric: bool, indptr: np.ndarray, indices: np.ndarray,
                 data: np.ndarray) -> None:
    """Add the element matrices of any tensors to the upper half."""
    n, corners = mesh.elements.shape
    slopes, measures = np.empty((n, corners, mesh.dim)), np.empty(n)
    check_shapes(mesh, shape_gradients(0, n, mesh.points, mesh.elements, slopes, measures))
    nodes = np.arange(n + 1) * corners, mesh.elements.ravel(), slopes.reshape(-1, mesh.dim)
    blocks = own.rows, own.table, indptr, indices, data
    if not axisymmetric:
        add_tensors(*nodes, np.empty(0), measures, *blocks)
        return
    for at, weight in zip(*quadrature_rule(corners, AXISYMMETRIC_DEGREE), strict=True):
        r = mesh.points[mesh.elements, 0] @ at
        add_tensors(*nodes, (at / r[:, None]).ravel(), weight * 2 * np.pi * r * measures, *blocks)


def check_used(indptr: np.ndarray) -> None:
    """Raise ValueError for a node without a row in the pattern."""
    if not (indptr[1:] > indptr[:-1]).all():
        raise ValueError(f"node {np.argmin(indptr[1:] > indptr[:-1])} belongs to no element; remove unused nodes")


def check_shapes(mesh: MeshArrays, bad: int) -> None:
    """Raise ValueError for the element that a kernel returned, unless that is -1."""
    if bad >= 0:
        raise ValueError(f"element {bad} with nodes {mesh.elements[bad].tolist()} is inverted or degenerate: "
                         "adaptmg.mesh.check_mesh finds all that is wrong with a mesh")


def block_matrix(data: np.ndarray, indices: np.ndarray, indptr: np.ndarray) -> sparse.bsr_array:
    """Return the matrix of blocks (n, dim, dim) with sorted columns, whose pattern is not written again."""
    if len(indices) < 2**31:
        indptr = indptr.astype(np.int32)
    for array in (indices, indptr):
        array.flags.writeable = False
    n_dofs = data.shape[1] * (len(indptr) - 1)
    matrix = sparse.bsr_array((data, indices, indptr), shape=(n_dofs, n_dofs), copy=False)
    matrix.has_sorted_indices = True
    return matrix


def node_pattern(elements: np.ndarray, n_nodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return row pointers and sorted columns of the nodal matrix; pointers to the elements of each node, and these."""
    start, listed = np.zeros(n_nodes + 1, dtype=np.int64), np.empty(elements.size, dtype=np.int32)
    list_elements(elements, start, listed)
    return *pattern_of(start, listed, elements, start[:0], 4 * elements.size), start, listed


def pattern_of(start: np.ndarray, listed: np.ndarray, nodes: np.ndarray, begin: np.ndarray, size: int
               ) -> tuple[np.ndarray, np.ndarray]:
    """Return row pointers and sorted columns of the matrix of patches: patch e has ``nodes[begin[e]:begin[e + 1]]``,
    or nodes[e] of (n, k), node i is in those of ``listed[start[i]:start[i + 1]]``; ``size`` is that of the work."""
    n, indptr = len(start) - 1, np.zeros(len(start), dtype=np.int64)
    given = start, listed, nodes, begin, indptr
    in_parts(find_neighbours, n, size, *given, np.empty(0, dtype=np.int32))
    np.cumsum(indptr, out=indptr)
    indices = np.empty(indptr[-1], dtype=np.int32)
    in_parts(find_neighbours, n, size, *given, indices)
    return indptr, indices


def _clear(first: int, last: int, data: np.ndarray) -> None:
    data[first:last] = 0.0


@kernel
def list_elements(elements, start, listed):
    """List elements of each node, ascending: ``listed[start[i]:start[i + 1]]``; ``start`` (n_nodes + 1,) comes as 0."""
    n = len(start) - 1
    for e in range(len(elements)):
        for v in elements[e]:
            start[v + 1] += 1
    for i in range(n):
        start[i + 1] += start[i]
    for e in range(len(elements)):
        for v in elements[e]:
            listed[start[v]] = e
            start[v] += 1
    for i in range(n, 0, -1):
        start[i] = start[i - 1]
    start[0] = 0


@kernel
def find_neighbours(first, last, start, listed, nodes, begin, indptr, indices):
    """Find the columns of the pattern, ascending: nodes that share a patch, each node with itself. Without ``indices``
    how many there are, to ``indptr[1:]``, which comes back summed up with them."""
    marker = np.full(len(start) - 1, -1, dtype=np.int32)
    for i in range(first, last):
        count, row = 0, indptr[i]
        for at in range(start[i], start[i + 1]):
            e = listed[at]
            for v in nodes[e] if nodes.ndim == 2 else nodes[begin[e]:begin[e + 1]]:
                if marker[v] != i:
                    marker[v] = i
                    if len(indices):
                        # few are out of order
                        k = row + count
                        while k > row and indices[k - 1] > v:  # one further down each time
                            indices[k] = indices[k - 1]
                            k -= 1
                        indices[k] = v
                    count += 1
        if not len(indices):
            indptr[i + 1] = count


@inner_kernel
def plane_gradients(points, corners, g):
    """Write the gradients (3, 2) of the shape functions; returns the area, and nothing if that is not positive."""
    a, b, c = corners[0], corners[1], corners[2]
    x1, y1 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
    x2, y2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
    det = x1 * y2 - y1 * x2
    if det > 0.0:
        g[1, 0], g[1, 1] = y2 / det, -x2 / det
        g[2, 0], g[2, 1] = -y1 / det, x1 / det
        g[0, 0], g[0, 1] = -(g[1, 0] + g[2, 0]), -(g[1, 1] + g[2, 1])
    return det / 2.0


@inner_kernel
def solid_gradients(points, corners, g):
    """Write the gradients (4, 3) of the shape functions; returns the volume, and nothing if that is not positive."""
    a, b, c, d = corners[0], corners[1], corners[2], corners[3]
    x1, y1, z1 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    x2, y2, z2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    x3, y3, z3 = points[d, 0] - points[a, 0], points[d, 1] - points[a, 1], points[d, 2] - points[a, 2]
    g[1, 0], g[1, 1], g[1, 2] = y2 * z3 - z2 * y3, z2 * x3 - x2 * z3, x2 * y3 - y2 * x3
    g[2, 0], g[2, 1], g[2, 2] = y3 * z1 - z3 * y1, z3 * x1 - x3 * z1, x3 * y1 - y3 * x1
    g[3, 0], g[3, 1], g[3, 2] = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
    det = x1 * g[1, 0] + y1 * g[1, 1] + z1 * g[1, 2]
    if det > 0.0:
        for j in range(3):
            g[1, j] /= det
            g[2, j] /= det
            g[3, j] /= det
            g[0, j] = -(g[1, j] + g[2, j] + g[3, j])
    return det / 6.0


@kernel
def shape_gradients(first, last, points, elements, slopes, measures):
    """Write the gradients (dim + 1, dim) of the shape functions of elements, and their volumes. Returns a bad one."""
    for e in range(first, last):
        if points.shape[1] == 2:
            measures[e] = plane_gradients(points, elements[e], slopes[e])
        else:
            measures[e] = solid_gradients(points, elements[e], slopes[e])
        if not measures[e] > 0.0:
            return e
    return -1


@inner_kernel
def _position(indptr, indices, a, b):
    """Where the block (a, b), which is there, is stored."""
    at = indptr[a]
    while indices[at] != b:  # the row holds b
        at += 1
    return at


@inner_kernel
def _add_plane_block(a, b, xx, xy, yx, yy, indptr, indices, data):
    """Add the block of nodes a, b, and off the diagonal its transpose at (b, a)."""
    at = _position(indptr, indices, a, b)
    data[at, 0, 0] += xx
    data[at, 0, 1] += xy
    data[at, 1, 0] += yx
    data[at, 1, 1] += yy
    if a != b:
        at = _position(indptr, indices, b, a)
        data[at, 0, 0] += xx
        data[at, 0, 1] += yx
        data[at, 1, 0] += xy
        data[at, 1, 1] += yy


@kernel
def add_plane(first, last, points, elements, body, lame, shear, indptr, indices, data):
    """Add the element matrices of plane elasticity; ``lame`` and ``shear`` are those of the bodies."""
    g = np.empty((3, 2))
    for e in range(first, last):
        area = plane_gradients(points, elements[e], g)
        if not area > 0.0:
            return e
        one, mu = area * lame[body[e]], area * shear[body[e]]
        both = one + 2.0 * mu
        for a in range(3):
            for b in range(a, 3):
                xx, yy, xy, yx = g[a, 0] * g[b, 0], g[a, 1] * g[b, 1], g[a, 0] * g[b, 1], g[a, 1] * g[b, 0]
                _add_plane_block(elements[e, a], elements[e, b], both * xx + mu * yy, one * xy + mu * yx,
                                 one * yx + mu * xy, both * yy + mu * xx, indptr, indices, data)
    return -1


@kernel
def add_solid(first, last, points, elements, body, lame, shear, start, listed, indptr, indices, data):
    """Write the upper half of rows of solid elasticity; ``lame`` and ``shear`` are those of the bodies, ``listed`` the
    elements of each node. Returns a bad element, or -1."""
    g, slot = np.empty((4, 3)), np.empty(len(indptr) - 1, dtype=np.int64)
    for i in range(first, last):
        for at in range(indptr[i], indptr[i + 1]):
            slot[indices[at]] = at
        data[slot[i]:indptr[i + 1]] = 0.0
        for k in range(start[i], start[i + 1]):
            e = listed[k]
            corners, volume = elements[e], solid_gradients(points, elements[e], g)
            if not volume > 0.0:
                return e
            one, mu = volume * lame[body[e]], volume * shear[body[e]]
            a = 0
            while corners[a] != i:  # i is a corner
                a += 1
            x, y, z = g[a, 0], g[a, 1], g[a, 2]
            for b in range(4):
                if corners[b] < i:
                    continue
                u, v, w = g[b, 0], g[b, 1], g[b, 2]
                block, dot = data[slot[corners[b]]], mu * (x * u + y * v + z * w)
                block[0, 0] += one * (x * u) + mu * (x * u) + dot
                block[0, 1] += one * (x * v) + mu * (y * u)
                block[0, 2] += one * (x * w) + mu * (z * u)
                block[1, 0] += one * (y * u) + mu * (x * v)
                block[1, 1] += one * (y * v) + mu * (y * v) + dot
                block[1, 2] += one * (y * w) + mu * (z * v)
                block[2, 0] += one * (z * u) + mu * (x * w)
                block[2, 1] += one * (z * v) + mu * (y * w)
                block[2, 2] += one * (z * w) + mu * (z * w) + dot
    return -1


@kernel
def mirror(first, last, indptr, indices, data):
    """Write the lower half of rows: the transposes of the upper one."""
    for i in range(first, last):
        at = indptr[i]
        while indices[at] < i:  # the row holds its diagonal
            block = data[_position(indptr, indices, indices[at], i)]
            for k in range(data.shape[1]):
                for m in range(data.shape[1]):
                    data[at, k, m] = block[m, k]
            at += 1


@kernel
def add_axisymmetric(points, elements, body, lame, shear, rule, weights, indptr, indices, data):
    """Add the element matrices of axisymmetric elasticity, x = r, y = z, over the full circumference. ``rule`` (n, 3)
    and ``weights`` (n,), of sum 1, are the barycentric points and weights of int . / r."""
    g, hoop = np.empty((3, 2)), np.empty((3, 3))
    for e in range(len(elements)):
        area = plane_gradients(points, elements[e], g)
        if not area > 0.0:
            return e
        r0, r1, r2 = points[elements[e, 0], 0], points[elements[e, 1], 0], points[elements[e, 2], 0]
        hoop[:] = 0.0
        for q in range(len(rule)):
            weight = weights[q] / (rule[q, 0] * r0 + rule[q, 1] * r1 + rule[q, 2] * r2)
            for a in range(3):
                for b in range(a, 3):
                    hoop[a, b] += weight * rule[q, a] * rule[q, b]
        first, mu = 2.0 * np.pi * area * lame[body[e]], 2.0 * np.pi * area * shear[body[e]]
        both = first + 2.0 * mu
        r = (r0 + r1 + r2) / 3.0
        for a in range(3):
            for b in range(a, 3):
                rr, zz, rz, zr = g[a, 0] * g[b, 0], g[a, 1] * g[b, 1], g[a, 0] * g[b, 1], g[a, 1] * g[b, 0]
                radial = r * (both * rr + mu * zz) + first * (g[a, 0] + g[b, 0]) / 3.0 + both * hoop[a, b]
                _add_plane_block(elements[e, a], elements[e, b], radial,
                                 r * (first * rz + mu * zr) + first * g[b, 1] / 3.0,
                                 r * (first * zr + mu * rz) + first * g[a, 1] / 3.0,
                                 r * (both * zz + mu * rr), indptr, indices, data)
    return -1
