r"""ElementStress: the stress of a discrete solution, as its elements have it.

Constant on each element, but for what the hoop strain :math:`\varepsilon_\theta = u_r / r` of axisymmetric bodies adds
to the normal components, :math:`\lambda\,\varepsilon_\theta`, and is itself, :math:`(\lambda + 2\mu)\,
\varepsilon_\theta + \lambda (\varepsilon_r + \varepsilon_z)`: that is evaluated where it is asked for.

With the gradient of the displacement from the edges of the element and the initial strain :math:`\varepsilon_0`,

.. math:: \sigma = \lambda\,\mathrm{tr}(\varepsilon - \varepsilon_0) I + 2\mu (\varepsilon - \varepsilon_0).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.discretisation.measures import StressData
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.runtime.compiled import kernel

__all__ = ["ElementStress", "element_stress"]

_THIN = 1


@kernel
def _plane(points, elements, body, u, lame, shear, thin, initial, stress):
    """Write xx, yy, xy (n_elements, 3). ``thin`` (n_bodies,): plane stress; ``initial`` (n_elements or 0, 3)."""
    strained = len(initial) > 0
    for e in range(len(elements)):
        a, b, c = elements[e, 0], elements[e, 1], elements[e, 2]
        x1, y1 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1]
        x2, y2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1]
        det = x1 * y2 - y1 * x2
        u1, v1 = u[b, 0] - u[a, 0], u[b, 1] - u[a, 1]
        u2, v2 = u[c, 0] - u[a, 0], u[c, 1] - u[a, 1]
        xx, yy = (u1 * y2 - u2 * y1) / det, (v2 * x1 - v1 * x2) / det
        twice_xy = (u2 * x1 - u1 * x2 + v1 * y2 - v2 * y1) / det
        out = 0.0
        k = body[e]
        if strained:
            xx -= initial[e, 0]
            yy -= initial[e, 1]
            if not thin[k]:
                out = -initial[e, 2]
        pressure = lame[k] * (xx + yy + out)
        stress[e, 0] = pressure + 2.0 * shear[k] * xx
        stress[e, 1] = pressure + 2.0 * shear[k] * yy
        stress[e, 2] = shear[k] * twice_xy


@kernel
def _solid(points, elements, body, u, lame, shear, initial, stress):
    """Write xx, yy, zz, xy, yz, xz (n_elements, 6). ``initial`` (n_elements or 0, 3)."""
    strained = len(initial) > 0
    for e in range(len(elements)):
        a, b, c, d = elements[e, 0], elements[e, 1], elements[e, 2], elements[e, 3]
        x1, y1, z1 = points[b, 0] - points[a, 0], points[b, 1] - points[a, 1], points[b, 2] - points[a, 2]
        x2, y2, z2 = points[c, 0] - points[a, 0], points[c, 1] - points[a, 1], points[c, 2] - points[a, 2]
        x3, y3, z3 = points[d, 0] - points[a, 0], points[d, 1] - points[a, 1], points[d, 2] - points[a, 2]
        gx1, gy1, gz1 = y2 * z3 - z2 * y3, z2 * x3 - x2 * z3, x2 * y3 - y2 * x3
        gx2, gy2, gz2 = y3 * z1 - z3 * y1, z3 * x1 - x3 * z1, x3 * y1 - y3 * x1
        gx3, gy3, gz3 = y1 * z2 - z1 * y2, z1 * x2 - x1 * z2, x1 * y2 - y1 * x2
        det = x1 * gx1 + y1 * gy1 + z1 * gz1
        u1, v1, w1 = u[b, 0] - u[a, 0], u[b, 1] - u[a, 1], u[b, 2] - u[a, 2]
        u2, v2, w2 = u[c, 0] - u[a, 0], u[c, 1] - u[a, 1], u[c, 2] - u[a, 2]
        u3, v3, w3 = u[d, 0] - u[a, 0], u[d, 1] - u[a, 1], u[d, 2] - u[a, 2]
        xx = (u1 * gx1 + u2 * gx2 + u3 * gx3) / det
        yy = (v1 * gy1 + v2 * gy2 + v3 * gy3) / det
        zz = (w1 * gz1 + w2 * gz2 + w3 * gz3) / det
        xy = (u1 * gy1 + u2 * gy2 + u3 * gy3 + v1 * gx1 + v2 * gx2 + v3 * gx3) / det
        yz = (v1 * gz1 + v2 * gz2 + v3 * gz3 + w1 * gy1 + w2 * gy2 + w3 * gy3) / det
        xz = (u1 * gz1 + u2 * gz2 + u3 * gz3 + w1 * gx1 + w2 * gx2 + w3 * gx3) / det
        if strained:
            xx -= initial[e, 0]
            yy -= initial[e, 1]
            zz -= initial[e, 2]
        k = body[e]
        pressure = lame[k] * (xx + yy + zz)
        stress[e, 0] = pressure + 2.0 * shear[k] * xx
        stress[e, 1] = pressure + 2.0 * shear[k] * yy
        stress[e, 2] = pressure + 2.0 * shear[k] * zz
        stress[e, 3], stress[e, 4], stress[e, 5] = shear[k] * xy, shear[k] * yz, shear[k] * xz


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
        _plane(mesh.points, mesh.elements, mesh.element_body, u, lame, shear, thin, initial, values)
    else:
        _solid(mesh.points, mesh.elements, mesh.element_body, u, lame, shear, initial, values)
    return ElementStress(mesh, u, data, values)
