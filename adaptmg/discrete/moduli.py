r"""Moduli: the materials of the bodies of a mesh as tensors of its elements.

Stresses and strains have the columns xx, yy, zz, xy (in space yz and xz too; axisymmetric rr, zz,
hoop, rz), shear strains being angles, twice the components of the tensor: :math:`\sigma = C
(\varepsilon - \varepsilon_0)`. With the axes of an anisotropic material as the rows of R its
strains are those of :math:`R \varepsilon R^T`, in columns
:math:`T \varepsilon`, and :math:`C = T^T C_0 T`. In plane stress what strains in the plane alone has the stiffness
:math:`C_{pp} - C_{pz} C_{zp} / C_{zz}`, and the strain through the thickness :math:`-C_{zp}\,\varepsilon_p / C_{zz}`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.laws import EDGE_PART, Anisotropy, Axisymmetric, Elastic, PlaneStress

#: one material for all bodies, body name -> material, or what :func:`body_materials` returns
Materials = Elastic | Mapping[str, Elastic] | tuple[Elastic, ...]

#: of the shear modulus: as EDGE_PART, of plastic bodies, whose volumes stay elastic: a bulk modulus of .3 shear
#: moduli. Prandtl's punch on 2667 nodes is 1.0132 times too strong; all on the edges locks, 1.024; a bulk modulus
#: of 0 there, 1.0006, takes twice the Newton steps
PLASTIC_EDGE_PART = 0.3 - 2 / 3
#: components of the columns, and where they stand in the order of Voigt
PAIRS = np.array([(0, 0), (1, 1), (2, 2), (0, 1), (1, 2), (0, 2)])
_VOIGT = [0, 1, 2, 5, 3, 4]
#: of an isotropic tensor, with the shear modulus 1
_SHEAR_PART = np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])


def body_materials(mesh: MeshArrays, material: Materials) -> tuple[Elastic, ...]:
    """Return materials in the order of ``mesh.bodies``, checked against the mesh; such a tuple
    stays unchanged."""
    if isinstance(material, tuple):
        return material
    if isinstance(material, Mapping):
        missing = [body for body in mesh.bodies if body not in material]
        if missing:
            raise ValueError(
                f"no material for body {missing[0]!r}; the bodies are {', '.join(mesh.bodies)}, materials "
                f"are given for {', '.join(map(str, material)) or 'none'}"
            )
        materials = tuple(material[body] for body in mesh.bodies)
    else:
        materials = (material,) * len(mesh.bodies)
    for elastic in materials:
        if not isinstance(elastic, Elastic):
            raise TypeError(
                "material must be PlaneStrain, PlaneStress, Axisymmetric or Solid, or a mapping body name "
                f"-> one of them, got {elastic!r}"
            )
        if elastic.dim != mesh.dim:
            raise ValueError(
                f"the material is {elastic.dim}D, the mesh {mesh.dim}D: use Solid in 3D, PlaneStrain, "
                "PlaneStress or Axisymmetric in 2D"
            )
    if is_axisymmetric(materials):
        if not all(isinstance(elastic, Axisymmetric) for elastic in materials):
            raise ValueError(
                "either all bodies are Axisymmetric or none, got "
                + ", ".join(type(elastic).__name__ for elastic in materials)
            )
        r = mesh.points[:, 0]
        if r.min() < -checks.ALIKE * r.max():
            raise ValueError(
                f"axisymmetric bodies lie at radii x >= 0, got x = {r.min():.6g} m at node "
                f"{int(np.argmin(r))}"
            )
    return materials


def is_axisymmetric(material: Materials) -> bool:
    """Return whether x is the radius r, y the axial coordinate z, and integrals are weighted with 2
    pi r."""
    if isinstance(material, Elastic):
        return isinstance(material, Axisymmetric)
    materials = material.values() if isinstance(material, Mapping) else material
    return any(isinstance(elastic, Axisymmetric) for elastic in materials)


def lame_constants(materials: tuple[Elastic, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Return the Lame constants lambda and mu (n_bodies,) as they enter the stress, Pa."""
    return np.array([elastic.lame for elastic in materials]), np.array(
        [elastic.shear_modulus for elastic in materials]
    )


@dataclass(frozen=True, eq=False)
class Moduli:
    """Tensors C of elements; k is 4 in the plane and 6 in space."""

    #: (n_tensors, k, k): C, Pa; in plane stress the row zz gives the strain through the thickness, not a stress, and
    #: the column zz is 0
    table: np.ndarray
    rows: np.ndarray  # (n_elements,) int32: the row of ``table`` with the tensor of each element

    def stress(self, strain: np.ndarray) -> np.ndarray:
        """Return the columns (n_elements, k) of C times columns (n_elements, k) of strains, Pa; in plane
        stress the column zz is the strain through the thickness."""
        if len(self.table) == 1:  # .22 ms for 24 576 tetrahedra, by entries .92
            return strain @ self.table[0].T
        result = np.zeros(strain.shape)
        # isotropic tensors have a third of the entries
        for i, j in np.argwhere(self.table.any(axis=0)):
            result[:, i] += self.table[self.rows, i, j] * strain[:, j]
        return result

    def work(self, stress: np.ndarray, other: np.ndarray, plane: bool) -> np.ndarray:
        """Return the work (n_elements, ...), J/m^3, of one stress on the elastic strains of another, both
        columns (n_elements, ..., k), Pa. With ``plane`` they have the columns xx, yy and xy alone, of
        bodies whose strains are in the plane: these columns decide the strains."""
        components = [0, 1, 3] if plane else list(range(self.table.shape[1]))
        compliance = np.linalg.inv(self.table[:, components][:, :, components])[self.rows]
        strain = (other.reshape(len(other), -1, len(components)) @ compliance).reshape(other.shape)
        return np.einsum("...i,...i->...", stress, strain)

    def of_hoop(self) -> np.ndarray:
        """Return the stresses rr, zz, hoop, rz (n_elements, 4) of a hoop strain of 1."""
        return self.table[self.rows, :, 2]


def inelastic_bodies(materials: tuple[Elastic, ...]) -> np.ndarray:
    """Return the mask (n_bodies,) of bodies that are plastic, or of another material with a history."""
    return np.array([elastic.inelastic is not None for elastic in materials])


def edge_parts(materials: tuple[Elastic, ...]) -> np.ndarray:
    """Return Lame's first constants over the shear moduli (n_bodies,) up to which they act on the
    means of smoothed elements around edges."""
    return np.where(inelastic_bodies(materials), PLASTIC_EDGE_PART, EDGE_PART)


def moduli(mesh: MeshArrays, materials: tuple[Elastic, ...], elements: str = "linear") -> Moduli:
    """Return the tensors of the materials of the bodies; for smoothed elements without the part that
    acts on groups of nodes (:mod:`adaptmg.discrete.volumes`), in the same rows as for linear ones.

    The table begins with an isotropic tensor for each body, which elements of an anisotropic one do not
    use: theirs follow, one for the body, or one for each element if its axes vary."""
    thin = np.array([isinstance(elastic, PlaneStress) for elastic in materials])
    most = edge_parts(materials) if elements == "smoothed" else np.inf
    result = isotropic(*lame_constants(materials), thin, mesh, most)
    for k, material in enumerate(materials):
        if material.anisotropy is not None:
            chosen = np.flatnonzero(mesh.element_body == k)
            tensors = _turned(
                material, material.anisotropy, mesh.points[mesh.elements[chosen]].mean(axis=1)
            )
            rows = result.rows.copy()
            rows[chosen] = len(result.table) + (
                np.arange(len(chosen)) if material.anisotropy.varies else 0
            )
            result = Moduli(np.concatenate([result.table, tensors]), rows)
    return result


def isotropic(
    lame: np.ndarray,
    shear: np.ndarray,
    thin: np.ndarray,
    mesh: MeshArrays,
    most: float | np.ndarray = np.inf,
) -> Moduli:
    """Return the tensors of isotropic bodies, of which some are ``thin`` (n_bodies,) sheets in plane
    stress, from Lame's constants (n_bodies,), Pa. The first one is cut off at ``most`` shear moduli,
    one number or (n_bodies,): the rest acts on groups of nodes (:mod:`adaptmg.discrete.volumes`). That
    of sheets, which is at most twice the shear modulus, is not cut off."""
    lame = np.minimum(lame, most * shear)
    k = 2 * mesh.dim
    table = shear[:, None, None] * _SHEAR_PART[:k, :k]
    table[:, :3, :3] += lame[:, None, None]
    if thin.any():
        # the row zz of a sheet gives the strain through the thickness, not a stress: -lambda / (2 mu)
        # of the strains in the plane, as lambda is that of plane stress
        table[thin, 2] = 0.0
        table[thin, :, 2] = 0.0
        table[thin, 2, :2] = -(lame / (2 * shear))[thin, None]
    return Moduli(table, mesh.element_body)


def _turned(material: Elastic, anisotropy: Anisotropy, points: np.ndarray) -> np.ndarray:
    """Return tensors (1 or n, k, k) of an anisotropic material at points (n, dim): T' C_0 T of the
    module."""
    i, j = PAIRS.T
    k = 2 * material.dim
    axes = anisotropy.rotations(points)  # (1 or n, 3, 3): R
    # row p of T gives the component PAIRS[p] of R e R', twice it where that is a shear
    turn = axes[:, i][:, :, i] * axes[:, j][:, :, j] + axes[:, i][:, :, j] * axes[:, j][:, :, i]
    turn[:, :3] *= 0.5
    # T' C_0 T
    result = turn.swapaxes(1, 2) @ np.array(anisotropy.stiffness)[np.ix_(_VOIGT, _VOIGT)] @ turn
    result = (0.5 * (result + result.swapaxes(1, 2)))[:, :k, :k]
    if isinstance(material, PlaneStress):
        # eliminate the strain through the thickness, -C_zp eps_p / C_zz, whose stress is zero
        through = -result[:, 2] / result[:, 2, 2, None]
        result += result[:, 2, :, None] * through[:, None]
        result[:, :, 2] = 0.0
        result[:, 2] = through
        result[:, 2, 2] = 0.0
    return result


def strain_columns(gradients: np.ndarray) -> np.ndarray:
    """Return the columns (n, 2 dim) of the strains of displacement gradients (n, dim, dim); zz of a
    plane is 0. Arrays of tensors take three times as long."""
    n, dim, _ = gradients.shape
    result = np.zeros((n, 2 * dim))
    for k, (i, j) in enumerate(PAIRS[: 2 * dim].tolist()):
        if i == j < dim:
            result[:, k] = gradients[:, i, i]
        elif j < dim:
            result[:, k] = gradients[:, i, j] + gradients[:, j, i]
    return result


def as_tensors(stress: np.ndarray) -> np.ndarray:
    """Return the symmetric tensors (n, 3, 3) of the columns (n, k) of stresses."""
    result = np.zeros((len(stress), 3, 3))
    i, j = PAIRS[: stress.shape[1]].T
    result[:, i, j] = result[:, j, i] = stress
    return result
