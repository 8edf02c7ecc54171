r"""The GRECO bar: a square pressed on a rigid plane and pushed along it (Example 1 of the paper).

Half of a long bar of 80 x 40 mm in plane strain: u_x = 0 on the plane of symmetry x = a ('right'), a rigid plane with
Coulomb friction at y = 0 ('bottom'), pressure on the top, and a larger one on x = 0 ('left') that pushes in +x. The
contact opens near x = 0, slips, and sticks towards the plane of symmetry.

Sources of the reference values: Code_Aster test SSNV128 (V6.04.128), after Raous, Chabrand and Lebon, 'Numerical
methods for frictional contact problems and applications', J. Mec. Theor. Appl. 7 (1988); and a P2 computation on fine
meshes, in which two independent codes agree to 2e-7.

Without friction the case is a patch test: full contact under the uniform stress
:math:`\sigma_{xx} = -p_{side},\ \sigma_{yy} = -p_{top}`, so that P1 elements are exact on every mesh, with

.. math:: u_x = -(a - x)\,\varepsilon_{xx},\quad u_y = y\,\varepsilon_{yy},\quad
   E\,\varepsilon_{xx} = (1-\nu^2)\,\sigma_{xx} - \nu(1+\nu)\,\sigma_{yy}.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from adaptmg.problem import (
    Contact,
    ContactProblem,
    Coulomb,
    Frictionless,
    Law,
    Plane,
    PlaneStrain,
    Pressure,
    Rectangle,
    Support,
    checks,
)

__all__ = ["greco_bar"]

_POINTS = {"A": (0.0, 0.0), "B": (1.25e-3, 0.0), "C": (5e-3, 0.0), "D": (7.5e-3, 0.0), "E": (11.25e-3, 0.0)}
_SSNV128 = {"A": 2.86e-5, "B": 2.72e-5, "C": 2.28e-5, "D": 1.98e-5, "E": 1.50e-5}
_CONVERGED = {"A": 2.860321e-5, "B": 2.722589e-5, "C": 2.286829e-5, "D": 1.980758e-5, "E": 1.541403e-5}
_REFERENCE = {
    "quantity": "tangential displacement u_x, m",
    "points": _POINTS,
    "values": {"SSNV128": _SSNV128, "converged": _CONVERGED},
    "sources": {"SSNV128": "Code_Aster test SSNV128, average of codes (Raous, Chabrand, Lebon 1988)",
                "converged": "P2 on fine meshes, two independent codes agreeing to 2e-7"},
    "remark": "The published value at E is 2.8 % below the converged one; elsewhere the two agree to .3 %.",
    "zones": {"open": (0.0, 3.32e-3), "slip": (3.32e-3, 29.86e-3), "stick": (29.86e-3, 40e-3)},
}
_DEFAULTS = {"top_pressure": 5e7, "side_pressure": 15e7, "young": 1.3e11, "poisson": 0.2, "size": 40e-3}


def greco_bar(*, law: Law = Coulomb(1.0), top_pressure: float = 5e7, side_pressure: float = 15e7,  # noqa: B008
              young: float = 1.3e11, poisson: float = 0.2, size: float = 40e-3) -> ContactProblem:
    """The GRECO bar.

    Parameters
    ----------
    law : Law
        On the plane y = 0.
    top_pressure, side_pressure : float
        On the top and on x = 0, Pa; positive pushes into the body.
    young, poisson : float
        Pa, and a number.
    size : float
        Side of the square, m.

    Returns
    -------
    ContactProblem
        ``reference`` holds ``quantity``, ``points`` (name -> position, m), ``values`` (source -> point -> m),
        ``sources``, ``remark`` and ``zones`` (state -> range of x, m) for the default parameters; without friction
        the closed form, for any parameters with ``top_pressure`` > 0; otherwise it is empty.
    """
    parameters = {"top_pressure": top_pressure, "side_pressure": side_pressure, "young": young, "poisson": poisson,
                  "size": size}
    size = checks.quantity("size", size, positive=True)
    material = PlaneStrain(young=young, poisson=poisson)
    top_pressure = checks.quantity("top_pressure", top_pressure)
    side_pressure = checks.quantity("side_pressure", side_pressure)
    reference: Mapping[str, Any] = {}
    if isinstance(law, Frictionless) and top_pressure > 0:
        reference = _patch_test(material, top_pressure, side_pressure, size)
    elif parameters == _DEFAULTS and isinstance(law, Coulomb) and not callable(law.friction) and law.friction == 1.0:
        reference = _REFERENCE
    return ContactProblem(
        name="GRECO bar",
        material=material,
        domain=Rectangle(width=size, height=size),
        contact=Contact("bottom", Plane(point=(0.0, 0.0), normal=(0.0, 1.0))),
        law=law,
        loads=(Pressure("top", top_pressure), Pressure("left", side_pressure)),
        supports=(Support("right", x=0.0),),
        reference=reference,
    )


def _patch_test(material: PlaneStrain, top_pressure: float, side_pressure: float, size: float) -> dict[str, Any]:
    """The closed form without friction."""
    nu = material.poisson
    strain = (-(1 - nu**2) * side_pressure + nu * (1 + nu) * top_pressure) / material.young
    exact = {name: -(1 - fraction) * size * strain for name, fraction in
             (("A", 0.0), ("B", 1.25 / 40), ("C", 5 / 40), ("D", 7.5 / 40), ("E", 11.25 / 40))}
    return {
        "quantity": _REFERENCE["quantity"],
        "points": {name: tuple(np.array(point) * size / 40e-3) for name, point in _POINTS.items()},
        "values": {"exact": exact},
        "sources": {"exact": "uniform stress (patch test): P1 elements are exact on every mesh"},
        "remark": "Full contact under uniform stress; a nested start solves it exactly, so it says nothing about "
                  "the convergence of a solver.",
        "zones": {"slip": (0.0, size)},
    }
