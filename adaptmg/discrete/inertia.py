r"""Lumped masses and velocities of nodes.

.. math:: m_i = \int \varrho\,\varphi_i

in axisymmetry with the factor :math:`2\pi r`: with a diagonal mass matrix the motion that is nearest
to a free one, and admissible, is found node by node."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.loads import load_vector
from adaptmg.discrete.posed import Posed
from adaptmg.problem.dynamics import Dynamics
from adaptmg.problem.loads import BodyForce


def _by_body(value: object, posed: Posed) -> Mapping[str, Any]:
    """Return values by body: a value that is not given by body is that of all bodies."""
    return value if isinstance(value, Mapping) else dict.fromkeys(posed.mesh.bodies, value)


def lumped_mass(posed: Posed, dynamics: Dynamics) -> np.ndarray:
    """Return the masses (n_nodes,) of nodes, kg (plane: kg/m; axisymmetric: of the full
    circumference)."""
    mesh = posed.mesh
    # the mass of a node is each component of its force by a body force of the size of the density
    forces = [
        BodyForce((density,) * mesh.dim, body=checks.choice("bodies of density", body, mesh.bodies))
        for body, density in _by_body(dynamics.density, posed).items()
    ]
    mass = load_vector(mesh, forces, posed.materials)[:: mesh.dim]
    if not mass.all():
        raise ValueError(
            f"density must be given for each body; the bodies are {', '.join(mesh.bodies)}"
        )
    return mass


def nodal_velocity(posed: Posed, dynamics: Dynamics) -> np.ndarray:
    """Return the initial velocity (n_nodes, dim) of bodies, m/s, whatever holds them."""
    points = posed.mesh.points
    result = np.zeros(points.shape)
    for body, value in _by_body(dynamics.initial_velocity, posed).items():
        checks.choice("bodies of initial_velocity", body, posed.mesh.bodies)
        nodes = posed.bodies[body]
        name = f"initial_velocity of {body!r}"
        if callable(value):
            result[nodes] = checks.array(name, value(points[nodes]), points[nodes].shape)
        else:
            result[nodes] = checks.vector(name, value, posed.mesh.dim)
    return result


def with_mass(matrix: sparse.bsr_array, factor: float, mass: np.ndarray) -> sparse.bsr_array:
    """Return ``factor`` times a matrix with dim x dim blocks, and masses (n_nodes,) on its
    diagonal."""
    size = matrix.blocksize
    masses = sparse.bsr_array(sparse.diags_array(np.repeat(mass, size[0])), blocksize=size)
    return checks.narrowed(
        sparse.bsr_array(factor * matrix + masses, blocksize=size).sorted_indices()
    )
