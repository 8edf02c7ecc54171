r"""ElementStress: the stress of a discrete solution, as its elements have it.

Constant on each element, but for what the hoop strain :math:`\varepsilon_\theta = u_r / r` of axisymmetric bodies adds
to the normal components, :math:`\lambda\,\varepsilon_\theta`, and is itself, :math:`(\lambda + 2\mu)\,
\varepsilon_\theta + \lambda (\varepsilon_r + \varepsilon_z)`: that is evaluated where it is asked for.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.discretisation.measures import StressData
from adaptmg.estimate.fields.stress_kernels import plane_stresses, solid_stresses
from adaptmg.mesh.arrays import MeshArrays

__all__ = ["ElementStress", "element_stress"]

_THIN = 1


@dataclass(frozen=True, eq=False)
class ElementStress:
    """Stress in a mesh.

    Attributes
    ----------
    mesh : MeshArrays
    displacement : (n_nodes, dim) array
        m.
    data : StressData
    values : (n_elements, 3 or 6) array
        xx, yy, xy or xx, yy, zz, xy, yz, xz, Pa; in axisymmetry without what the hoop strain adds.
    """

    mesh: MeshArrays
    displacement: np.ndarray
    data: StressData
    values: np.ndarray

    @property
    def axisymmetric(self) -> bool:
        """Whether integrals are weighted with 2 pi r."""
        return self.data.axisymmetric

    def hoop(self, cells: np.ndarray, rule: np.ndarray) -> np.ndarray:
        """Hoop strain u_r / r (n, n_points) at barycentric points (n_points, k) of cells (n, k); 0 on the axis."""
        radius = self.mesh.points[cells, 0] @ rule.T
        moved = self.displacement[cells, 0] @ rule.T
        return np.divide(moved, radius, out=np.zeros_like(radius), where=radius > 0)

    def tractions(self, elements: np.ndarray, normals: np.ndarray, facets: np.ndarray, rule: np.ndarray
                  ) -> np.ndarray:
        """Sigma n at points of facets.

        Parameters
        ----------
        elements : (n,) int array
            Whose stress.
        normals : (n, dim) array
        facets : (n, dim) int array
            Nodes.
        rule : (n_points, dim) array
            Barycentric points.

        Returns
        -------
        (n, n_points, dim) array
            Pa.
        """
        s, n = self.values[elements], normals
        if self.mesh.dim == 2:
            plain = np.column_stack([s[:, 0] * n[:, 0] + s[:, 2] * n[:, 1], s[:, 2] * n[:, 0] + s[:, 1] * n[:, 1]])
        else:
            plain = np.column_stack([s[:, 0] * n[:, 0] + s[:, 3] * n[:, 1] + s[:, 5] * n[:, 2],
                                     s[:, 3] * n[:, 0] + s[:, 1] * n[:, 1] + s[:, 4] * n[:, 2],
                                     s[:, 5] * n[:, 0] + s[:, 4] * n[:, 1] + s[:, 2] * n[:, 2]])
        result = np.repeat(plain[:, None, :], len(rule), axis=1)
        if self.axisymmetric:
            lame = self.data.lame[self.mesh.element_body[elements]]
            result += (lame[:, None] * self.hoop(facets, rule))[:, :, None] * n[:, None, :]
        return result


def element_stress(mesh: MeshArrays, displacement: np.ndarray, data: StressData) -> ElementStress:
    """The stress of a displacement (n_nodes, dim), m."""
    if len(data.kind) != len(mesh.bodies) or len(data.initial_strain) not in (0, len(mesh.elements)):
        raise ValueError(f"stress data of {len(data.kind)} bodies and {len(data.initial_strain)} elements do not "
                         f"belong to a mesh of {len(mesh.bodies)} and {len(mesh.elements)}")
    u = np.ascontiguousarray(displacement, dtype=np.float64)
    values = np.empty((len(mesh.elements), 3 if mesh.dim == 2 else 6))
    initial = np.ascontiguousarray(data.initial_strain, dtype=np.float64)
    lame, shear = (np.ascontiguousarray(part, dtype=np.float64) for part in (data.lame, data.shear))
    if mesh.dim == 2:
        thin = data.kind == _THIN
        plane_stresses(mesh.points, mesh.elements, mesh.element_body, u, lame, shear, thin, initial, values)
    else:
        solid_stresses(mesh.points, mesh.elements, mesh.element_body, u, lame, shear, initial, values)
    return ElementStress(mesh, u, data, values)
