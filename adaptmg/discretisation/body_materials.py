"""The material of each body of a mesh, and whether the bodies are axisymmetric."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.materials import Axisymmetric, Elastic

__all__ = ["Materials", "body_materials", "is_axisymmetric", "lame_constants"]

Materials = Elastic | Mapping[str, Elastic]

# of the largest radius: nodes on the axis may lie this far behind it by rounding
_ROUNDING = 1e-9


def body_materials(mesh: MeshArrays, material: Materials) -> tuple[Elastic, ...]:
    """Materials in the order of ``mesh.bodies``, checked against the mesh.

    Parameters
    ----------
    mesh : MeshArrays
    material : Elastic or mapping
        One for all bodies, or body name -> Elastic.

    Returns
    -------
    tuple of Elastic

    Raises
    ------
    TypeError
        If a material is no Elastic.
    ValueError
        If a body has no material, a dimension does not fit, axisymmetric and other materials are mixed, or an
        axisymmetric mesh has nodes at r < 0.
    """
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


def is_axisymmetric(material: Materials | tuple[Elastic, ...]) -> bool:
    """Whether x is the radius r, y the axial coordinate z, and integrals are weighted with 2 pi r."""
    if isinstance(material, Elastic):
        return isinstance(material, Axisymmetric)
    materials = material.values() if isinstance(material, Mapping) else material
    return any(isinstance(one, Axisymmetric) for one in materials)


def lame_constants(materials: tuple[Elastic, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Lame constants lambda and mu (n_bodies,) as they enter the stress, Pa."""
    return np.array([one.lame for one in materials]), np.array([one.shear_modulus for one in materials])
