r"""The stiffness matrix of P1 elasticity, assembled by NGSolve.

.. math:: a(u, v) = \int_\Omega \lambda\,\mathrm{div}\,u\,\mathrm{div}\,v + 2\mu\,\varepsilon(u) : \varepsilon(v)

with the Lame constants of the material, so that plane stress, plane strain and three dimensions are one form.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.materials import Elastic

__all__ = ["stiffness"]


def stiffness(mesh: MeshArrays, material: Elastic) -> sparse.bsr_array:
    """Assemble the stiffness matrix, with no boundary condition applied.

    Parameters
    ----------
    mesh : MeshArrays
        Assembly runs on ``mesh.source``; without one, an NGSolve mesh is built from the arrays.
    material : Elastic
        The same in the whole body.

    Returns
    -------
    scipy.sparse.bsr_array (n_dofs, n_dofs)
        Blocks of dim x dim, sorted indices, dof = dim * node + component; N/m (2D: per metre of thickness).

    Raises
    ------
    ValueError
        If material and mesh differ in dimension, or ``mesh.source`` does not belong to the arrays or is curved.
    """
    import ngsolve as ng

    dim = mesh.dim
    if material.dim != dim:
        raise ValueError(f"the material is {material.dim}D, the mesh {dim}D: use Solid in 3D, PlaneStrain or "
                         "PlaneStress in 2D")
    source = _source(mesh)
    space = ng.H1(source, order=1, dim=dim)
    u, v = space.TnT()
    grad_u, grad_v = ng.Grad(u), ng.Grad(v)
    form = ng.BilinearForm(space)
    form += (material.lame * ng.Trace(grad_u) * ng.Trace(grad_v)
             + 2 * material.shear_modulus * ng.InnerProduct(ng.Sym(grad_u), ng.Sym(grad_v))) * ng.dx
    form.Assemble()
    values, columns, rows = form.mat.CSR()
    # views into the NGSolve matrix, which dies with `form`: copied here, once
    data = np.array(values).reshape(-1, dim, dim)
    indices = np.array(columns, dtype=np.int32)
    indptr = np.array(rows, dtype=np.int32 if len(indices) < 2**31 else np.int64)
    n_dofs = dim * mesh.n_nodes
    matrix = sparse.bsr_array((data, indices, indptr), shape=(n_dofs, n_dofs), copy=False)
    return matrix if matrix.has_sorted_indices else matrix.sorted_indices()


def _source(mesh: MeshArrays) -> Any:
    """The NGSolve mesh to assemble on, checked against the arrays."""
    if mesh.source is None:
        from adaptmg.mesh.build import with_source

        return with_source(mesh).source
    source = mesh.source
    if source.dim != mesh.dim or source.nv != mesh.n_nodes or source.ne != len(mesh.elements):
        raise ValueError(f"mesh.source ({source.dim}D, {source.nv} nodes, {source.ne} elements) does not belong to the "
                         f"arrays ({mesh.dim}D, {mesh.n_nodes} nodes, {len(mesh.elements)} elements): was it refined "
                         "after it was read? Read the arrays again, or drop the source")
    if source.GetCurveOrder() > 1:
        raise ValueError(f"mesh.source is curved (order {source.GetCurveOrder()}); P1 needs straight elements: "
                         "call mesh.Curve(1) on it, or drop the source")
    return source
