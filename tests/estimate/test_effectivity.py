"""Estimates over exact errors: that of residuals alike on all meshes, the recovered one near 1."""

import numpy as np
import pytest

import adaptmg as am


def error_against(result, young, poisson, exact):
    """In energy, against exact normal strains (xx, yy, zz or rr, zz, hoop), without shear; by a rule of degree 3."""
    mesh, round_ = result.mesh, result.stress_data.axisymmetric
    corners, moved = mesh.points[mesh.elements], result.displacement[mesh.elements]
    slopes = np.linalg.solve(corners[:, 1:] - corners[:, :1], moved[:, 1:] - moved[:, :1])
    lame, shear = young * poisson / ((1 + poisson) * (1 - 2 * poisson)), young / (2 * (1 + poisson))
    square = 0.0
    for shape, weight in zip(np.array([[.6, .2, .2], [.2, .6, .2], [.2, .2, .6], [1 / 3, 1 / 3, 1 / 3]]),
                             (25 / 48, 25 / 48, 25 / 48, -9 / 16), strict=True):
        x = np.einsum("k,ekd->ed", shape, corners)
        hoop = np.einsum("k,ek->e", shape, moved[:, :, 0]) / x[:, 0] if round_ else 0.0
        off = [a - b for a, b in zip((slopes[:, 0, 0], slopes[:, 1, 1], hoop), exact(x), strict=True)]
        energy = (lame * sum(off) ** 2 + 2 * shear * sum(e**2 for e in off)
                  + shear * (slopes[:, 0, 1] + slopes[:, 1, 0]) ** 2)
        square += weight * np.sum(energy * mesh.volumes * (2 * np.pi * x[:, 0] if round_ else 1.0))
    return np.sqrt(square)


def tube(poisson, young=1e11, inner=0.02, outer=0.035, pressure=1e8):
    """Lame's tube under internal pressure, its ends free."""
    c = pressure * inner**2 / (outer**2 - inner**2)
    a, b = c * (1 - poisson) / young, c * outer**2 * (1 + poisson) / young
    problem = am.ContactProblem(
        material=am.Axisymmetric(young=young, poisson=poisson), law=am.Frictionless(),
        domain=am.Rectangle(width=outer - inner, height=0.015, origin=(inner, 0.0)),
        contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))), loads=(am.Pressure("left", pressure),
                                                                       am.Pressure("top", 1e3)))
    return problem, young, lambda x: (a - b / x[:, 0]**2, -2 * poisson * c / young, a + b / x[:, 0]**2)


def column(poisson, young=1e9, weight=1e5):
    """A column under its own weight between smooth walls."""
    stiff = young * (1 - poisson) / ((1 + poisson) * (1 - 2 * poisson))
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=young, poisson=poisson), domain=am.Rectangle(width=1.0, height=1.0),
        contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))), law=am.Frictionless(),
        loads=(am.BodyForce((0.0, -weight)),), supports=(am.Support("left", x=0.0), am.Support("right", x=0.0)))
    return problem, young, lambda x: (0.0, -weight * (1 - x[:, 1]) / stiff, 0.0)


@pytest.mark.parametrize("make", [tube, column])
@pytest.mark.parametrize("poisson", [0.1, 0.4])
def test_smooth_fields_with_body_forces_or_hoop_stress_are_known_exactly(make, poisson):
    """The recovered estimate is the error; that of residuals is far above it, alike on all meshes."""
    problem, young, exact = make(poisson)
    found = []
    for n in (8, 16):
        hierarchy = am.Hierarchy.uniform(problem, (n,))
        result = am.solve(hierarchy, am.ActiveSet())
        error = error_against(result, young, poisson, exact)
        assert 0.95 < am.Recovery().indicate(hierarchy, result).total / error < 1.01
        found.append(am.Residual().indicate(hierarchy, result).total / error)
    low, high = min(found), max(found)
    assert low > 5.5 and high < 9 and high < 1.05 * low
