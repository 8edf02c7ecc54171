r"""Strain and stress, element by element, from a P1 displacement.

.. math:: \varepsilon = \tfrac12(\nabla u + \nabla u^T), \qquad
   \sigma = \lambda\,\mathrm{tr}(\varepsilon - \varepsilon_0) I + 2\mu (\varepsilon - \varepsilon_0)

with the initial strain :math:`\varepsilon_0`, if any, and the Lame constants as they enter the plane problem. Both are
constant on an element, but for the hoop strain :math:`u_r / r` of axisymmetric bodies, whose mean over the volume is
taken: its value at the centroid, :math:`\int u_r \big/ \int r`. The strain energy is
:math:`\tfrac12 \int \sigma : (\varepsilon - \varepsilon_0)`, by the quadrature of the stiffness matrix.

Bodies of which one is anisotropic have the tensors of :mod:`adaptmg.discrete.anisotropic`.

Smoothed elements have the stress that is in equilibrium, :math:`\sum_T V_T\, \sigma_T : \varepsilon_T(v) = b^T v`: by
means around edges (S of :mod:`adaptmg.discrete.smoothed`), with the mean pressure p of the groups of their corners:

.. math:: \sigma = \big(\lambda_1\, \mathrm{tr}\, S(\varepsilon - \varepsilon_0) + p\big) I
   + 2\mu\, S(\varepsilon - \varepsilon_0) .
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from adaptmg._numba import kernel
from adaptmg.discrete.anisotropic import Moduli, as_tensors, moduli
from adaptmg.discrete.elasticity import Materials, body_materials, is_axisymmetric, lame_constants
from adaptmg.discrete.loads import body_elements, mean_initial_strain
from adaptmg.discrete.smoothed import EDGE_PART, edge_lame, element_measures, smoothed
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_rule
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.loads import InitialStrain, Load, Preload
from adaptmg.problem.materials import PlaneStress


def element_strain(mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
    """Return symmetric small-strain tensors (n_elements, dim, dim) in the plane (3D: full), initial strains included.

    The displacement is (n_nodes, dim) or (n_dofs,), m.
    """
    gradient = displacement_gradient(mesh, displacement)
    return 0.5 * (gradient + np.swapaxes(gradient, 1, 2))


def displacement_gradient(mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
    """Return the gradients d u_i / d x_j (n_elements, dim, dim)."""
    result = np.zeros((len(mesh.elements), mesh.dim, mesh.dim))
    _gradients(mesh.points, mesh.elements, _nodal(mesh, displacement), result)
    return result


@kernel
def _gradients(points, elements, u, gradients):
    """Add the gradients of linear displacements to ``gradients``."""
    dim = points.shape[1]
    edges, normals = np.empty((dim, dim)), np.empty((dim, dim))
    for e in range(len(elements)):
        first = elements[e, 0]
        for k in range(dim):
            for d in range(dim):
                edges[k, d] = points[elements[e, k + 1], d] - points[first, d]
        # the gradient of each corner's shape function, times the determinant of the edges
        for k in range(dim):
            a, b = (k + 1) % dim, (k + 2) % dim
            if dim == 2:
                normals[k, 0], normals[k, 1] = edges[a, 1], -edges[a, 0]
            else:
                for d in range(dim):
                    i, j = (d + 1) % dim, (d + 2) % dim
                    normals[k, d] = edges[a, i] * edges[b, j] - edges[a, j] * edges[b, i]
        if dim == 2:
            normals[1] *= -1.0
        determinant = 0.0
        for d in range(dim):
            determinant += edges[0, d] * normals[0, d]
        for k in range(dim):
            for i in range(dim):
                moved = (u[elements[e, k + 1], i] - u[first, i]) / determinant
                for j in range(dim):
                    gradients[e, i, j] += moved * normals[k, j]


def hoop_strain(mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
    """Return the mean hoop strain u_r / r of axisymmetric elements."""
    u = _nodal(mesh, displacement)
    return u[mesh.elements, 0].sum(axis=1) / mesh.points[mesh.elements, 0].sum(axis=1)


#: kinds of bodies in StressData
_PLAIN, _THIN, _AXISYMMETRIC = 0, 1, 2


@dataclass(frozen=True, eq=False)
class StressData:
    """What stresses follow from, next to a mesh and a displacement."""

    lame: np.ndarray  # (n_bodies,): Lame constants as they enter the stress, Pa
    shear: np.ndarray  # (n_bodies,), Pa
    kind: np.ndarray  # (n_bodies,) int8: 0 for plane strain and solids, 1 for plane stress, 2 for axisymmetric bodies
    initial_strain: np.ndarray  # (n_elements, 3), or (0, 3) for none
    smoothed: bool = False  # whether the elements are
    # of groups of nodes (adaptmg.discrete.volumes), if there are any
    pressure: np.ndarray | None = None  # (n_elements,): mean of the corners, tension positive, Pa
    volume_energy: float = 0.0  # J (plane: J/m)
    moduli: Moduli | None = None  # where a body is anisotropic; Lame constants are those of an isotropic one near it

    @classmethod
    def of(cls, mesh: MeshArrays, material: Materials, loads: Sequence[Load] = (), elements: str = "linear"
           ) -> StressData:
        """Return the data of materials (one, or body name -> Elastic) and of the initial strains among loads."""
        materials = body_materials(mesh, material)
        kind = [_THIN if isinstance(one, PlaneStress) else _AXISYMMETRIC if is_axisymmetric(one) else _PLAIN
                for one in materials]
        strains = [load for load in loads if isinstance(load, InitialStrain)]
        initial = mean_initial_strain(mesh, strains, axisymmetric=is_axisymmetric(materials)) if strains else None
        return cls(*lame_constants(materials), np.array(kind, dtype=np.int8),
                   np.zeros((0, 3)) if initial is None else initial, elements == "smoothed",
                   moduli=moduli(mesh, materials, EDGE_PART if elements == "smoothed" else np.inf))

    @property
    def axisymmetric(self) -> bool:
        """Whether x is the radius r, and y the axial coordinate z."""
        return bool((self.kind == _AXISYMMETRIC).any())

    def tensors(self, mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
        """Return the stress tensors (n_elements, 3, 3) as of :func:`full_stress`."""
        return self._stress(mesh, self._elastic(mesh, displacement))

    def strains(self, mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
        """Return strain tensors (n_elements, 3, 3) with initial strains, through the thickness and of the hoop, too."""
        strain, thin = self._elastic(mesh, displacement), (self.kind == _THIN)[mesh.element_body]
        body, sheet = mesh.element_body[thin], strain[thin]
        strain[thin, 2, 2] = (-self.lame[body] / (2 * self.shear[body]) * (sheet[:, 0, 0] + sheet[:, 1, 1])
                              if self.moduli is None else self.moduli.stress(strain)[thin, 2])
        if len(self.initial_strain):
            strain[:, np.arange(3), np.arange(3)] += self.initial_strain
        return strain

    def suppressed(self, mesh: MeshArrays) -> float:
        """Return the energy of stresses that suppress initial strains, N m; of plane bodies of those in the plane."""
        body, dim = mesh.element_body, 3 if self.axisymmetric else mesh.dim
        lame, shear, volume = self.lame[body, None], self.shear[body, None], element_measures(mesh, self.axisymmetric)
        strain = self.initial_strain.copy()
        strain[(self.kind == _THIN)[body], 2] = 0.0
        if self.moduli is not None:
            stress = self.moduli.stress(strain[:, :, None] * np.eye(3))
            if plane := mesh.dim == 2 and not self.axisymmetric:
                stress = stress[:, [0, 1, 3]]
            # means around edges of what the tensors of bodies make
            means = smoothed(mesh, stress, volume) if self.smoothed else stress
            return float(volume @ self.moduli.work(stress, means, plane))
        if self.smoothed:  # the rest is energy of volumes
            lame = edge_lame(lame, shear)
        stress = (lame * strain.sum(axis=1, keepdims=True) + 2 * shear * strain)[:, :dim]
        # what strains in the plane alone are under this stress
        elastic = (stress - lame / (dim * lame + 2 * shear) * stress.sum(axis=1, keepdims=True)) / (2 * shear)
        if self.smoothed:
            stress = smoothed(mesh, stress, volume)
        return float(np.einsum("n,nd,nd->", volume, stress, elastic))

    def energy(self, mesh: MeshArrays, displacement: np.ndarray) -> float:
        """Return the strain energy, J (plane: J/m)."""
        elastic, u = self._elastic(mesh, displacement), _nodal(mesh, displacement)
        if self.smoothed:
            density = np.einsum("nij,nij->n", replace(self, pressure=None)._stress(mesh, elastic), elastic)
            return 0.5 * float(element_measures(mesh, self.axisymmetric) @ density) + self.volume_energy
        if not self.axisymmetric:
            return 0.5 * float(np.einsum("n,nij,nij", mesh.volumes, self._stress(mesh, elastic), elastic))
        total, (rule, weights) = 0.0, quadrature_rule(3, AXISYMMETRIC_DEGREE)
        initial = self.initial_strain[:, 2] if len(self.initial_strain) else 0.0
        for at, weight in zip(rule, weights, strict=True):
            radius = mesh.points[mesh.elements, 0] @ at
            elastic[:, 2, 2] = u[mesh.elements, 0] @ at / radius - initial
            total += weight * np.einsum("n,nij,nij", radius * mesh.volumes, self._stress(mesh, elastic), elastic)
        return float(np.pi * total)

    def _elastic(self, mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
        """Strain minus initial strain; of plane stress without the strain through the thickness."""
        if len(self.kind) != len(mesh.bodies) or len(self.initial_strain) not in (0, len(mesh.elements)):
            raise ValueError(f"stress data of {len(self.kind)} bodies and {len(self.initial_strain)} elements do not "
                             f"belong to a mesh of {len(mesh.bodies)} and {len(mesh.elements)}")
        dim, diagonal = mesh.dim, np.arange(3)
        strain = np.zeros((len(mesh.elements), 3, 3))
        strain[:, :dim, :dim] = element_strain(mesh, displacement)
        if self.axisymmetric:
            strain[:, 2, 2] = hoop_strain(mesh, displacement)
        if len(self.initial_strain):
            strain[:, diagonal, diagonal] -= self.initial_strain
        # a sheet strains freely through its thickness: its Lame constant accounts for that
        strain[(self.kind == _THIN)[mesh.element_body], 2, 2] = 0.0
        return strain

    def _stress(self, mesh: MeshArrays, strain: np.ndarray) -> np.ndarray:
        body, diagonal, lame = mesh.element_body, np.arange(3), self.lame
        if self.smoothed:
            volumes = element_measures(mesh, self.axisymmetric)
            strain = smoothed(mesh, strain.reshape(-1, 9), volumes).reshape(strain.shape)
            lame = edge_lame(lame, self.shear)
        if self.moduli is None:
            stress = 2 * self.shear[body][:, None, None] * strain
            stress[:, diagonal, diagonal] += (lame[body] * np.trace(strain, axis1=1, axis2=2))[:, None]
        else:
            stress = as_tensors(self.moduli.stress(strain))
        if self.pressure is not None:
            stress[:, diagonal, diagonal] += self.pressure[:, None]
        stress[(self.kind == _THIN)[body], 2, 2] = 0.0
        return stress


def full_stress(mesh: MeshArrays, material: Materials, displacement: np.ndarray, loads: Sequence[Load] = ()
                ) -> np.ndarray:
    """Return Cauchy stresses (n_elements, 3, 3) of linear elements, Pa, tension positive, with that out of the plane.

    In 2D [2, 2] is the stress through the thickness (0 in plane stress) or the hoop stress; the shear stresses out of
    the plane are 0. The displacement is (n_nodes, dim) or (n_dofs,), m; initial strains among the loads carry no
    stress, other loads do not matter.
    """
    return StressData.of(mesh, material, loads).tensors(mesh, displacement)


def von_mises(stress: np.ndarray) -> np.ndarray:
    r"""Return equivalent stresses :math:`\sqrt{\tfrac32\, s : s}` (n,), Pa, of the deviators s of tensors (n, 3, 3)."""
    if np.shape(stress)[1:] != (3, 3):
        raise ValueError(f"stress must have shape (n, 3, 3), as of full_stress, got {np.shape(stress)}")
    deviator = stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * np.sum(deviator**2, axis=(1, 2)))


def _nodal(mesh: MeshArrays, displacement: np.ndarray) -> np.ndarray:
    """The displacement as float (n_nodes, dim), its shape checked."""
    u = np.ascontiguousarray(displacement, dtype=np.float64)
    if u.shape not in (mesh.points.shape, (mesh.points.size,)):
        raise ValueError(f"displacement must have shape {mesh.points.shape}, got {u.shape}")
    return u.reshape(mesh.points.shape)


def cut_force(mesh: MeshArrays, data: StressData, displacement: np.ndarray, preload: Preload) -> float:
    r"""Return the tension across the cut of a preload, N; ValueError if no element of the body lies across it.

    With the nodal function chi, 1 beyond the cut and 0 before it, and the axis a it is the virtual work of moving the
    part beyond by a unit, :math:`\int \sigma : \nabla (\chi a)`: what all forces on that part pull.
    """
    elements, axis = body_elements(mesh, preload.body), preload.direction
    nodes = np.unique(mesh.elements[elements])
    along = mesh.points[nodes, axis]
    at = 0.5 * (along.min() + along.max()) if preload.at is None else preload.at
    if not along.min() < at < along.max():
        raise ValueError(f"at of the preload of {preload.body!r} must be in ({along.min():g}, {along.max():g}), the "
                         f"extent of the body along {preload.axis}, got {at:g}")
    beyond = np.zeros(mesh.points.shape)
    beyond[nodes[along > at], axis] = 1.0
    slopes = displacement_gradient(mesh, beyond)[elements]
    stress = data.tensors(mesh, displacement)[elements, :mesh.dim, :mesh.dim]
    volumes = element_measures(mesh, data.axisymmetric)[elements]
    return float(np.einsum("n,nij,nij->", volumes, stress, slopes))


def cut_stiffness(mesh: MeshArrays, material: Materials, preload: Preload) -> float:
    """Return the force, N, that a strain of 1 makes in the mean section of the body, whose sides are free."""
    elements, young = body_elements(mesh, preload.body), body_materials(mesh, material)[
        mesh.bodies.index(preload.body)].young
    volume = element_measures(mesh, is_axisymmetric(material))[elements].sum()
    return float(young * volume / np.ptp(mesh.points[mesh.elements[elements], preload.direction]))
