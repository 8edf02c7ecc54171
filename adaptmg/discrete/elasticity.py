r"""The stiffness matrix of P1 elasticity; the bodies may differ in material.

.. math:: a(u, v) = \int_\Omega \lambda\,\mathrm{div}\,u\,\mathrm{div}\,v + 2\mu\,\varepsilon(u) : \varepsilon(v),
   \qquad K_{ab} = V \left(\lambda\, g_a g_b^T + \mu\, g_b g_a^T + \mu\,(g_a \cdot g_b) I\right)

with the Lame constants of the material, so that plane stress, plane strain and three dimensions are one form, the
constant gradients g_a of the shape functions and the volume V of an element. In axisymmetry x is the radius r and y the
axial coordinate z, the hoop strain :math:`u_r / r` joins in, all is weighted with :math:`2 \pi r`, and forces are in N.
There :math:`\int r` and :math:`\int \varphi_a` are exact, :math:`\int \varphi_a \varphi_b / r` takes a rule with
interior points and positive weights: any rule that is exact for degree 1 gives the other integrals too, so that the sum
is one quadrature of the energy, hence positive semidefinite, and constant strains (:math:`u_r = c r`) are exact.

Rows are written one by one, from the elements of their node in ascending order: the blocks (a, b) and (b, a) sum the
same products in the same order, so that the matrix is bitwise symmetric, and the same in every run on any number of
threads. In three dimensions the lower half is copied from the upper one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import sparse

from adaptmg._runtime import inner_kernel, kernel
from adaptmg._threads import in_parts
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_rule
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.materials import Axisymmetric, Elastic

#: one material for all bodies, body name -> material, or what :func:`body_materials` returns
Materials = Elastic | Mapping[str, Elastic] | tuple[Elastic, ...]

# of the largest radius: nodes on the axis may lie this far behind it by rounding
_ROUNDING = 1e-9


def body_materials(mesh: MeshArrays, material: Materials) -> tuple[Elastic, ...]:
    """Materials in the order of ``mesh.bodies``, checked against the mesh; such a tuple is returned unchanged."""
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
    """Whether x is the radius r, y the axial coordinate z, and integrals are weighted with 2 pi r."""
    if isinstance(material, Elastic):
        return isinstance(material, Axisymmetric)
    materials = material.values() if isinstance(material, Mapping) else material
    return any(isinstance(one, Axisymmetric) for one in materials)


def lame_constants(materials: tuple[Elastic, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Lame constants lambda and mu (n_bodies,) as they enter the stress, Pa."""
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
    if not mesh.sound:
        _check_numbers(mesh)
    dim = mesh.dim
    start, listed = elements_of_nodes(mesh.elements, mesh.n_nodes)
    if not (start[1:] > start[:-1]).all():
        raise ValueError(f"node {np.argmin(start[1:] > start[:-1])} belongs to no element; remove unused nodes")
    rows = mesh.n_nodes, dim * dim * listed.size, mesh.elements, start, listed
    indptr = np.zeros(mesh.n_nodes + 1, dtype=np.int64)
    in_parts(count_columns, *rows, indptr)
    np.cumsum(indptr, out=indptr)
    # not np.zeros: its pages are mapped one by one while they are written, several times slower
    indices, data = np.empty(indptr[-1], dtype=np.int32), np.empty(dim * dim * indptr[-1])
    rows = *rows, indptr, indices, data, mesh.points, mesh.element_body, *lame_constants(materials)
    if dim == 3:
        bad = max(in_parts(add_solid, *rows))
        in_parts(mirror, mesh.n_nodes, data.size, indptr, indices, data)
    else:
        rule = np.empty((0, 3)), np.empty(0)
        if is_axisymmetric(materials):
            rule = quadrature_rule(3, AXISYMMETRIC_DEGREE)
        bad = max(in_parts(add_plane, *rows, *rule))
    if bad >= 0:
        raise ValueError(f"element {bad} with nodes {mesh.elements[bad].tolist()} is inverted or degenerate: "
                         "adaptmg.mesh.check_mesh finds all that is wrong with a mesh")
    if len(indices) < 2**31:
        indptr = indptr.astype(np.int32)
    for array in (indices, indptr):
        array.flags.writeable = False
    n_dofs = dim * mesh.n_nodes
    matrix = sparse.bsr_array((data.reshape(-1, dim, dim), indices, indptr), shape=(n_dofs, n_dofs), copy=False)
    matrix.has_sorted_indices = True
    return matrix


def elements_of_nodes(elements: np.ndarray, n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Elements of each node, ascending, in compressed rows: of node i ``listed[start[i]:start[i + 1]]``."""
    start, listed = np.zeros(n_nodes + 1, dtype=np.int64), np.empty(elements.size, dtype=np.int32)
    list_elements(elements, start, listed)
    return start, listed


def _check_numbers(mesh: MeshArrays) -> None:
    """Numbers out of range would make the kernels read and write elsewhere."""
    for name, numbers, count in (("elements", mesh.elements, mesh.n_nodes),
                                 ("element_body", mesh.element_body, len(mesh.bodies))):
        if not numbers.size or numbers.min() < 0 or numbers.max() >= count:
            found = f"{numbers.min()} to {numbers.max()}" if numbers.size else "none"
            raise ValueError(f"mesh.{name} must be numbers from 0 to {count - 1}, got {found}")
    if mesh.elements.shape[1] != mesh.dim + 1 or len(mesh.element_body) != len(mesh.elements):
        raise ValueError(f"a {mesh.dim}D mesh needs elements (n, {mesh.dim + 1}) and element_body (n,), got "
                         f"{mesh.elements.shape} and {mesh.element_body.shape}")


@kernel
def list_elements(elements, start, listed):
    """Elements of each node, ascending: ``listed[start[i]:start[i + 1]]``; ``start`` (n_nodes + 1,) comes as 0."""
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
def count_columns(first, last, elements, start, listed, indptr):
    """Number of columns of rows of the pattern, one place further: nodes that share an element, each with itself."""
    marker = np.full(len(start) - 1, -1, dtype=np.int32)
    for i in range(first, last):
        for at in range(start[i], start[i + 1]):
            for v in elements[listed[at]]:
                if marker[v] != i:
                    marker[v] = i
                    indptr[i + 1] += 1


@inner_kernel
def _fill_columns(i, elements, start, listed, indptr, indices, slot):
    """Write the columns of row i, ascending, and to ``slot`` their places; it comes with those of rows before or -1."""
    first = end = indptr[i]
    for at in range(start[i], start[i + 1]):
        for v in elements[listed[at]]:
            if slot[v] < first:
                slot[v], to = first, end
                while to > first and indices[to - 1] > v:
                    indices[to] = indices[to - 1]
                    to -= 1
                indices[to] = v
                end += 1
    for at in range(first, end):
        slot[indices[at]] = at


@inner_kernel
def plane_cofactors(points, corners):
    """The determinant of a triangle, twice its area, and times this the gradients of its three shape functions."""
    a, b, c = corners[0], corners[1], corners[2]
    ax, ay = points[b, 1] - points[c, 1], points[c, 0] - points[b, 0]
    bx, by = points[c, 1] - points[a, 1], points[a, 0] - points[c, 0]
    cx, cy = points[a, 1] - points[b, 1], points[b, 0] - points[a, 0]
    return bx * cy - cx * by, ax, ay, bx, by, cx, cy


@inner_kernel
def solid_cofactors(points, corners, g):
    """Write the gradients (4, 3) of the shape functions times the determinant, six times the volume: returned."""
    a, b, c, d = corners[0], corners[1], corners[2], corners[3]
    x1, y1, z1 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
    x2, y2, z2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
    x3, y3, z3 = points[d, 0] - points[a, 0], points[d, 1] - points[a, 1], points[d, 2] - points[a, 2]
    g[1, 0], g[1, 1], g[1, 2] = y2 * z3 - z2 * y3, z2 * x3 - x2 * z3, x2 * y3 - y2 * x3
    g[2, 0], g[2, 1], g[2, 2] = y3 * z1 - z3 * y1, z3 * x1 - x3 * z1, x3 * y1 - y3 * x1
    g[3, 0], g[3, 1], g[3, 2] = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
    for c in range(3):
        g[0, c] = -(g[1, c] + g[2, c] + g[3, c])
    return x1 * g[1, 0] + y1 * g[1, 1] + z1 * g[1, 2]


@kernel
def add_plane(first, last, elements, start, listed, indptr, indices, data, points, body, lame, shear, rule, weights):
    """Write rows of plane elasticity, pattern and blocks; ``lame`` and ``shear`` are those of the bodies, ``listed``
    the elements of each node. In axisymmetry, x = r and y = z, over the full circumference: ``rule`` (n, 3) and
    ``weights`` (n,), of sum 1, are the barycentric points and weights of int . / r. Returns a bad element, or -1."""
    slot, hoop, third = np.full(len(start) - 1, -1, dtype=np.int32), np.zeros(3), 0.0
    for i in range(first, last):
        _fill_columns(i, elements, start, listed, indptr, indices, slot)
        for at in range(4 * indptr[i], 4 * indptr[i + 1]):
            data[at] = 0.0
        xx, xy, yy = 0.0, 0.0, 0.0
        for k in range(start[i], start[i + 1]):
            e = listed[k]
            a, b, c = elements[e, 0], elements[e, 1], elements[e, 2]
            det, ax, ay, bx, by, cx, cy = plane_cofactors(points, elements[e])
            if not det > 0.0:
                return e
            half = 0.5 / det
            one, mu = half * lame[body[e]], half * shear[body[e]]
            if len(weights):
                one, mu = 2.0 * np.pi * one, 2.0 * np.pi * mu
                r = _hoop(points, elements[e], i, det * det * (one + 2.0 * mu), rule, weights, hoop)
                third, one, mu = det * one / 3.0, r * one, r * mu
            both = one + 2.0 * mu
            if b == i:
                a, b, ax, ay, bx, by = b, a, bx, by, ax, ay
            elif c == i:
                a, c, ax, ay, cx, cy = c, a, cx, cy, ax, ay
            xx += both * (ax * ax) + mu * (ay * ay) + (third * (ax + ax) + hoop[0])
            xy += one * (ax * ay) + mu * (ay * ax) + third * ay
            yy += both * (ay * ay) + mu * (ax * ax)
            _add_plane_block(4 * np.int64(slot[b]), ax, ay, bx, by, one, mu, both, third, hoop[1], data)
            _add_plane_block(4 * np.int64(slot[c]), ax, ay, cx, cy, one, mu, both, third, hoop[2], data)
        at = 4 * np.int64(slot[i])
        data[at], data[at + 1], data[at + 2], data[at + 3] = xx, xy, xy, yy
    return -1


@inner_kernel
def _add_plane_block(at, x, y, u, v, one, mu, both, third, hoop, data):
    data[at] += both * (x * u) + mu * (y * v) + (third * (x + u) + hoop)
    data[at + 1] += one * (x * v) + mu * (y * u) + third * v
    data[at + 2] += one * (y * u) + mu * (x * v) + third * y
    data[at + 3] += both * (y * v) + mu * (x * u)


@inner_kernel
def _hoop(points, corners, i, factor, rule, weights, hoop):
    """Write ``factor`` times the means of phi_i phi_k / r, k = i and the others in their order but that the first takes
    the place of i; returns the mean of r."""
    r0, r1, r2 = points[corners[0], 0], points[corners[1], 0], points[corners[2], 0]
    own = 1 if corners[1] == i else 2 if corners[2] == i else 0
    second, third = 0 if own == 1 else 1, 0 if own == 2 else 2
    hoop[:] = 0.0
    for q in range(len(rule)):
        weight = factor * weights[q] / (rule[q, 0] * r0 + rule[q, 1] * r1 + rule[q, 2] * r2)
        hoop[0] += weight * (rule[q, own] * rule[q, own])
        hoop[1] += weight * (rule[q, own] * rule[q, second])
        hoop[2] += weight * (rule[q, own] * rule[q, third])
    return (r0 + r1 + r2) / 3.0


@kernel
def add_solid(first, last, elements, start, listed, indptr, indices, data, points, body, lame, shear):
    """Write the upper half of rows of solid elasticity, with the pattern of both, as :func:`add_plane`."""
    slot, g = np.full(len(start) - 1, -1, dtype=np.int32), np.empty((4, 3))
    for i in range(first, last):
        _fill_columns(i, elements, start, listed, indptr, indices, slot)
        for at in range(9 * np.int64(slot[i]), 9 * indptr[i + 1]):
            data[at] = 0.0
        xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(start[i], start[i + 1]):
            e, a = listed[k], 0
            det = solid_cofactors(points, elements[e], g)
            if not det > 0.0:
                return e
            while elements[e, a] != i:
                a += 1
            sixth = 1.0 / (6.0 * det)
            x, y, z, one, mu = g[a, 0], g[a, 1], g[a, 2], sixth * lame[body[e]], sixth * shear[body[e]]
            lx, ly, lz, mx, my, mz = one * x, one * y, one * z, mu * x, mu * y, mu * z
            square = mx * x + my * y + mz * z
            xx += lx * x + mx * x + square
            xy += lx * y + mx * y
            xz += lx * z + mx * z
            yy += ly * y + my * y + square
            yz += ly * z + my * z
            zz += lz * z + mz * z + square
            for b in range(4):
                if elements[e, b] <= i:
                    continue
                at, u, v, w = 9 * np.int64(slot[elements[e, b]]), g[b, 0], g[b, 1], g[b, 2]
                dot = mx * u + my * v + mz * w
                data[at] += lx * u + mx * u + dot
                data[at + 1] += lx * v + my * u
                data[at + 2] += lx * w + mz * u
                data[at + 3] += ly * u + mx * v
                data[at + 4] += ly * v + my * v + dot
                data[at + 5] += ly * w + mz * v
                data[at + 6] += lz * u + mx * w
                data[at + 7] += lz * v + my * w
                data[at + 8] += lz * w + mz * w + dot
        at = 9 * np.int64(slot[i])
        data[at], data[at + 1], data[at + 2], data[at + 3], data[at + 4] = xx, xy, xz, xy, yy
        data[at + 5], data[at + 6], data[at + 7], data[at + 8] = yz, xz, yz, zz
    return -1


@kernel
def mirror(first, last, indptr, indices, data):
    """Write the lower half of rows: the transposes of the upper one."""
    for i in range(first, last):
        at = indptr[i]
        while indices[at] < i:
            other = indptr[indices[at]]
            while indices[other] != i:
                other += 1
            for k in range(3):
                for m in range(3):
                    data[9 * at + 3 * k + m] = data[9 * other + 3 * m + k]
            at += 1
