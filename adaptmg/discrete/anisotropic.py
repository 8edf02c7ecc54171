r"""Stiffness that depends on the direction: tensors by element, and the matrices of bodies of which one has such.

Stresses and strains have the columns xx, yy, zz, xy (in space yz and xz too; axisymmetric rr, zz, hoop, rz), shear
strains being angles, twice the components of the tensor: :math:`\sigma = C (\varepsilon - \varepsilon_0)`,

.. math:: K = \sum_T \int_T B^T C B, \qquad K' = \sum_e A_e\, B_e^T C B_e

of linear elements, and of smoothed ones with the means around edges (:mod:`adaptmg.discrete.smoothed`). With the axes
of the material as the rows of R its strains are those of :math:`R \varepsilon R^T`, in columns :math:`T \varepsilon`,
and :math:`C = T^T C_0 T`. In plane stress what strains in the plane alone has the stiffness
:math:`C_{pp} - C_{pz} C_{zp} / C_{zz}`, and the strain through the thickness :math:`-C_{zp}\,\varepsilon_p / C_{zz}`.
Quadrature is that of :mod:`adaptmg.discrete.elasticity`; matrices are bitwise symmetric.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg._numba import inner_kernel, kernel
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.materials import Elastic, PlaneStress

#: components of the columns, and where they stand in the order of Voigt
_PAIRS = np.array([(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)])
_VOIGT = [0, 1, 2, 5, 3, 4]


@dataclass(frozen=True, eq=False)
class Moduli:
    """Tensors C of elements."""

    #: (m, k, k): Pa; of plane stress the row zz makes the strain through the thickness, and the column is 0
    table: np.ndarray
    rows: np.ndarray  # (n_elements,) int32: which of them an element has

    def stress(self, strain: np.ndarray) -> np.ndarray:
        """Return columns (n_elements, k) of C times strains (n_elements, 3, 3); plane stress: without that of zz."""
        return np.einsum("nij,nj->ni", self.table[self.rows], columns(strain, self.table.shape[1]))

    def work(self, stress: np.ndarray, other: np.ndarray, plane: bool) -> np.ndarray:
        """Return one of two stresses, columns (n_elements, ..., k), times the strains that the other makes,
        (n_elements, ...); in the plane the columns are xx, yy, xy."""
        kept = [0, 1, 3] if plane else list(range(self.table.shape[1]))
        compliance = np.linalg.inv(self.table[:, kept][:, :, kept])[self.rows]
        return np.einsum("n...i,nij,n...j->n...", stress, compliance, other)

    def of_hoop(self) -> np.ndarray:
        """Return the stresses rr, zz, hoop, rz (n_elements, 4) of a hoop strain of 1."""
        return self.table[self.rows, :, 2]


def moduli(mesh: MeshArrays, materials: tuple[Elastic, ...], most: float = np.inf) -> Moduli | None:
    """Return the tensors of the materials of the bodies; None where all are isotropic. Lame's first constant of
    isotropic ones is cut off at ``most`` shear moduli."""
    own = [one.anisotropy for one in materials]
    if not any(own):
        return None
    centroids, parts, rows = mesh.points[mesh.elements].mean(axis=1), [], np.empty(len(mesh.elements), dtype=np.int32)
    for k, material in enumerate(materials):
        here = np.flatnonzero(mesh.element_body == k)
        rows[here] = sum(map(len, parts))
        parts.append(_tensors(material, centroids[here], mesh.dim, most))
        if own[k] is not None and own[k].varies:
            rows[here] += np.arange(len(here), dtype=np.int32)
    return Moduli(np.concatenate(parts), rows)


def _tensors(material: Elastic, points: np.ndarray, dim: int, most: float) -> np.ndarray:
    """Tensors (1 or n, k, k) of a material at points."""
    anisotropy, mu, k = material.anisotropy, material.shear_modulus, 2 * dim
    if anisotropy is None:
        lame = min(material.lame, most * mu)
        result = np.diag(mu * np.array([2.0, 2.0, 2.0, 1.0, 1.0, 1.0]))
        result[:3, :3] += lame
        result, through = result[None, :k, :k].copy(), -lame / (2 * mu) * np.array([1.0, 1.0, 0.0, 0.0])
    else:
        i, j = _PAIRS.T
        axes = anisotropy.rotations(points)
        turn = axes[:, i][:, :, i] * axes[:, j][:, :, j] + axes[:, i][:, :, j] * axes[:, j][:, :, i]
        turn[:, :3] *= 0.5
        result = turn.swapaxes(1, 2) @ np.array(anisotropy.stiffness)[np.ix_(_VOIGT, _VOIGT)] @ turn
        result = (0.5 * (result + result.swapaxes(1, 2)))[:, :k, :k]
        through = -result[:, 2] / result[:, 2, 2, None]
        if isinstance(material, PlaneStress):
            result += result[:, 2, :, None] * through[:, None]
    if isinstance(material, PlaneStress):
        result[:, :, 2], result[:, 2] = 0.0, through
        result[:, 2, 2] = 0.0
    return result


def columns(tensors: np.ndarray, k: int) -> np.ndarray:
    """Return the columns (n, k) of strain tensors (n, 3, 3)."""
    i, j = _PAIRS[:k].T
    return tensors[:, i, j] * np.where(i == j, 1.0, 2.0)


def as_tensors(stress: np.ndarray) -> np.ndarray:
    """Return the symmetric tensors (n, 3, 3) of the columns (n, k) of stresses."""
    result = np.zeros((len(stress), 3, 3))
    i, j = _PAIRS[:stress.shape[1]].T
    result[:, i, j] = result[:, j, i] = stress
    return result


@kernel
def add_tensors(start, nodes, slopes, hoops, measures, rows, table, indptr, indices, data):
    """Add to blocks, of the upper half, the matrices of patches: patch e has the nodes ``start[e]`` to ``start[e +
    1]``, the strain of the gradients sum_a u_a slope_a', in axisymmetry with the hoop strain sum_a u_a hoop_a, a volume
    ``measures[e]``, and the tensor ``table[rows[e]]``."""
    dim, k = slopes.shape[1], table.shape[1]
    left, right, stress = np.zeros((k, dim)), np.zeros((k, dim)), np.empty((k, dim))
    for e in range(len(rows)):
        own = table[rows[e]]
        for q in range(start[e], start[e + 1]):
            _set_strain(slopes, hoops, q, right)
            for i in range(k):
                for b in range(dim):
                    stress[i, b] = 0.0
                    for j in range(k):
                        stress[i, b] += measures[e] * own[i, j] * right[j, b]
            for p in range(start[e], start[e + 1]):
                if nodes[p] > nodes[q]:
                    continue
                _set_strain(slopes, hoops, p, left)
                at = indptr[nodes[p]] + np.searchsorted(indices[indptr[nodes[p]]:indptr[nodes[p] + 1]], nodes[q])
                for a in range(dim):
                    for b in range(a if p == q else 0, dim):
                        value = 0.0
                        for i in range(k):
                            value += left[i, a] * stress[i, b]
                        data[at, a, b] += value
                        if p == q and a != b:
                            data[at, b, a] += value


@inner_kernel
def _set_strain(slopes, hoops, p, strain):
    """Write the columns of the strain (k, dim) of unit displacements of a node, whose other entries are 0."""
    dim = slopes.shape[1]
    for a in range(dim):
        strain[a, a] = slopes[p, a]
    strain[3, 0], strain[3, 1] = slopes[p, 1], slopes[p, 0]
    if dim == 3:
        strain[4, 1], strain[4, 2] = slopes[p, 2], slopes[p, 1]
        strain[5, 0], strain[5, 2] = slopes[p, 2], slopes[p, 0]
    elif len(hoops):
        strain[2, 0] = hoops[p]
