"""Fixed dofs: what the supports prescribe, node by node."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from adaptmg.discretisation.facets import named_facets
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.problem.loads import Support

__all__ = ["fixed_dofs"]


def fixed_dofs(mesh: MeshArrays, supports: Sequence[Support]) -> tuple[np.ndarray, np.ndarray]:
    """Mask and values of the prescribed dofs.

    Parameters
    ----------
    mesh : MeshArrays
    supports : sequence of Support
        Where two meet, they must agree or prescribe different components.

    Returns
    -------
    fixed : (n_dofs,) bool array
        dof = dim * node + component.
    values : (n_dofs,) array
        Prescribed displacement, m; zero where free.

    Raises
    ------
    ValueError
        For a boundary the mesh does not have, a z component in 2D, two values for one dof, or functions of position
        whose values are not finite numbers, one a node.
    """
    fixed = np.zeros((mesh.n_nodes, mesh.dim), dtype=bool)
    values = np.zeros((mesh.n_nodes, mesh.dim))
    origin = np.full((mesh.n_nodes, mesh.dim), -1)
    for k, support in enumerate(supports):
        nodes = np.unique(named_facets(mesh, support.boundary))
        for d, value in enumerate(support.components(mesh.dim)):
            if value is None:
                continue
            wanted = checks.field(f"{'xyz'[d]} of the support on {support.boundary!r}", value, mesh.points[nodes])
            clash = fixed[nodes, d] & (values[nodes, d] != wanted)
            if clash.any():
                node, here = int(nodes[np.argmax(clash)]), wanted[np.argmax(clash)]
                other = supports[origin[node, d]].boundary
                raise ValueError(f"supports on {other!r} and {support.boundary!r} prescribe different {'xyz'[d]} "
                                 f"displacements, {values[node, d]:g} and {here:g} m, at their common node {node} "
                                 f"{tuple(mesh.points[node].tolist())}: give both the same value or free one")
            fixed[nodes, d], values[nodes, d], origin[nodes, d] = True, wanted, k
    return fixed.reshape(-1), values.reshape(-1)
