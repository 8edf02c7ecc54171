r"""Lumped masses and velocities of nodes.

.. math:: m_i = \int \varrho\,\varphi_i

in axisymmetry with the factor :math:`2\pi r`: with a diagonal mass matrix the motion that is nearest
to a free one, and admissible, is found node by node."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeVar

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._checks import narrowed
from adaptmg.discrete.loads import load_vector
from adaptmg.discrete.posed import Posed
from adaptmg.problem.dynamics import Dynamics
from adaptmg.problem.loads import BodyForce

Value = TypeVar("Value")


def _of_bodies(name: str, value: Value | Mapping[str, Value], posed: Posed) -> dict[str, Value]:
    """Return a value for each body; a mapping as it is, checked."""
    bodies = posed.mesh.bodies
    if not isinstance(value, Mapping):
        return dict.fromkeys(bodies, value)
    for body in value:
        if body not in bodies:
            raise ValueError(
                f"{name}: body {body!r} does not exist; the bodies are {', '.join(bodies)}"
            )
    return dict(value)


def lumped_mass(posed: Posed, dynamics: Dynamics) -> np.ndarray:
    """Return the masses (n_nodes,) of nodes, kg (plane: kg/m; axisymmetric: of the full
    circumference)."""
    mesh = posed.mesh
    densities = _of_bodies("density", dynamics.density, posed)
    missing = [body for body in mesh.bodies if body not in densities]
    if missing:
        raise ValueError(
            f"density: body {missing[0]!r} has none; the bodies are {', '.join(mesh.bodies)}"
        )
    # a force per volume along the last axis
    along = (0.0,) * (mesh.dim - 1)
    forces = [BodyForce((*along, density), body=body) for body, density in densities.items()]
    return load_vector(mesh, forces, posed.materials)[mesh.dim - 1 :: mesh.dim]


def nodal_velocity(posed: Posed, dynamics: Dynamics) -> np.ndarray:
    """Return the initial velocity (n_nodes, dim) of bodies, m/s, whatever holds them."""
    result = np.zeros(posed.mesh.points.shape)
    for body, value in _of_bodies("initial_velocity", dynamics.initial_velocity, posed).items():
        nodes = posed.bodies[body]
        shape = len(nodes), posed.mesh.dim
        name = f"initial_velocity of {body!r}"
        if callable(value):
            result[nodes] = checks.array(name, value(posed.mesh.points[nodes]), shape)
        else:
            result[nodes] = checks.vector(name, value, posed.mesh.dim)
    return result


def with_mass(matrix: sparse.bsr_array, factor: float, mass: np.ndarray) -> sparse.bsr_array:
    """Return ``factor`` times a matrix with dim x dim blocks, and masses (n_nodes,) on its
    diagonal."""
    size = matrix.blocksize
    masses = sparse.bsr_array(sparse.diags_array(np.repeat(mass, size[0])), blocksize=size)
    return narrowed(sparse.bsr_array(factor * matrix + masses, blocksize=size).sorted_indices())
