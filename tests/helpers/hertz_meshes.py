"""Meshes that are fine where round bodies touch, and the Hertzian pressure that fits nodal
pressures best."""

import numpy as np

import adaptmg as am

__all__ = ["contact_meshes", "pressure_fit"]


def contact_meshes(
    problem: am.ContactProblem, finest: float, levels: int, grading: float
) -> list[am.MeshArrays]:
    """Meshes, coarse to fine, with edges of ``finest`` half-widths at the origin on the last; all
    halved each time."""
    a, domain = problem.reference["half_width"], problem.domain
    extent = max(np.max(part.upper - part.lower) for part in domain.parts.values())
    steps = [(finest * 2.0**k, min(1.0, grading * 2.0**k)) for k in reversed(range(levels))]
    return [
        am.mesh.sized(
            domain,
            am.SizeNear([(0.0,) * problem.dim], size=h * a, radius=1.3 * a, grading=growth),
            0.65 * growth * extent,
            grading=growth,
        )
        for h, growth in steps
    ]


def pressure_fit(x, pressure, half_width, share=0.8):
    """Half-width and peak by the line through p^2 over x^2 within a share of the half-width."""
    inside = np.abs(x) < share * half_width
    slope, square = np.polyfit(x[inside] ** 2, pressure[inside] ** 2, 1)
    return np.sqrt(square / -slope), np.sqrt(square)
