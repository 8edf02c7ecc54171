r"""The stiffness matrix of P1 elasticity; the bodies may differ in material.

.. math:: a(u, v) = \int_\Omega \lambda\,\mathrm{div}\,u\,\mathrm{div}\,v + 2\mu\,\varepsilon(u) : \varepsilon(v)

with the Lame constants of the material, so that plane stress, plane strain and three dimensions are one form. In
axisymmetry x is the radius r and y the axial coordinate z,

.. math:: \varepsilon = (u_{r,r},\ u_{z,z},\ u_r / r,\ \tfrac12(u_{r,z} + u_{z,r})),

integrals run over the full circumference (weight :math:`2 \pi r`), and forces are in N.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.discretisation import element_kernels as kernels
from adaptmg.discretisation.body_materials import Materials, body_materials, is_axisymmetric, lame_constants
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_rule
from adaptmg.mesh.arrays import MeshArrays

__all__ = ["stiffness"]


def stiffness(mesh: MeshArrays, material: Materials) -> sparse.bsr_array:
    """Assemble the stiffness matrix, with no boundary condition applied.

    Parameters
    ----------
    mesh : MeshArrays
        One body or several; only the arrays are used.
    material : Elastic or mapping
        The same in all bodies, or body name -> Elastic.

    Returns
    -------
    scipy.sparse.bsr_array (n_dofs, n_dofs)
        Blocks of dim x dim, sorted indices, dof = dim * node + component; bitwise symmetric. N/m (plane: per metre of
        thickness; axisymmetric: of the full circumference).

    Raises
    ------
    ValueError
        If materials and mesh do not fit (:func:`~adaptmg.discretisation.body_materials.body_materials`), a node number
        is out of range, or an element is inverted or degenerate.

    Notes
    -----
    On the axis r = 0 the user prescribes u_r = 0, e.g. ``Support("axis", x=0.0)``: the hoop strain is bounded for no
    other displacement. Without it the matrix is finite still.
    """
    materials = body_materials(mesh, material)
    _check_numbers(mesh)
    dim = mesh.dim
    indptr, indices = _pattern(mesh.elements, mesh.n_nodes)
    # not np.zeros: of that the operating system maps small pages, one by one as they are written, several times slower
    data = np.full((len(indices), dim, dim), 0.0)
    arguments = (mesh.points, mesh.elements, mesh.element_body, *lame_constants(materials))
    if is_axisymmetric(materials):
        bad = kernels.add_axisymmetric(*arguments, *quadrature_rule(3, AXISYMMETRIC_DEGREE), indptr, indices, data)
    else:
        add = kernels.add_plane if dim == 2 else kernels.add_solid
        bad = add(*arguments, indptr, indices, data)
    if bad >= 0:
        raise ValueError(f"element {bad} with nodes {mesh.elements[bad].tolist()} is inverted or degenerate: "
                         "adaptmg.mesh.check_mesh finds all that is wrong with a mesh")
    if len(indices) < 2**31:
        indptr = indptr.astype(np.int32)
    n_dofs = dim * mesh.n_nodes
    matrix = sparse.bsr_array((data, indices, indptr), shape=(n_dofs, n_dofs), copy=False)
    matrix.has_sorted_indices = True
    return matrix


def _pattern(elements: np.ndarray, n_nodes: int) -> tuple[np.ndarray, np.ndarray]:
    """Row pointers and sorted columns of the nodal matrix."""
    start, listed = np.zeros(n_nodes + 1, dtype=np.int64), np.empty(elements.size, dtype=np.int32)
    marker, indptr = np.full(n_nodes, -1, dtype=np.int32), np.empty(n_nodes + 1, dtype=np.int64)
    kernels.count_neighbours(elements, start, listed, marker, indptr)
    indices = np.empty(indptr[-1], dtype=np.int32)
    marker[:] = -1
    kernels.fill_neighbours(elements, start, listed, marker, indptr[:-1].copy(), indices)
    return indptr, indices


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
