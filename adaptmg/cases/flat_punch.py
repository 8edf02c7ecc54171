r"""A flat rigid punch without friction on an elastic half-plane.

The punch is a rigid plane that ends: only the part |x| < a of the block's top is called "contact" and lies against the
plane y = 0. The block, guided at its plane of symmetry, is pressed up against it from below by the load P per length.
For the half-plane

.. math:: p(x) = \frac{P}{\pi\sqrt{a^2 - x^2}}

(K. L. Johnson, Contact Mechanics, 1985, section 2.8), singular at the edge: u ~ r^(1/2), so that uniform meshes
converge like N^(-1/4) in the energy norm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.problem import Law

# depth and half the width of the block, in half-widths of the punch
_SIZE = 40.0


@dataclass(frozen=True, kw_only=True)
class PunchPressure:
    """The pressure P / (pi sqrt(a^2 - x^2)) under a flat rigid punch.

    Examples
    --------
    >>> am.cases.PunchPressure(load=1e5, half_width=0.01).half_width
    0.01
    """

    load: float  # P, N/m
    half_width: float  # a, m

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Pressure at |x| < a, Pa."""
        return self.load / (math.pi * np.sqrt(self.half_width**2 - np.asarray(x)**2))


def flat_punch(*, law: Law = am.Frictionless(), load: float = 1e6, half_width: float = 10e-3,  # noqa: B008
               young: float = 2.1e11, poisson: float = 0.3) -> am.ContactProblem:
    """Pose a flat rigid punch on a block 40 half-widths deep and 80 wide; plane strain, one half by symmetry.

    ``reference`` holds, without friction, ``pressure`` (:class:`PunchPressure`, of x in m), ``exponent`` (of the
    singularity at the edge) and ``sources``.

    Parameters
    ----------
    law : Law
        Under the punch; the closed form is that without friction.
    load : float
        P of the whole punch, N/m, > 0.
    half_width : float
        a, m.
    young, poisson : float
        Of the block, Pa, and a number.

    Examples
    --------
    >>> am.cases.flat_punch().dim
    2
    """
    a, load = checks.quantity("half_width", half_width, positive=True), checks.quantity("load", load, positive=True)
    reference = {}
    if isinstance(law, am.Frictionless):
        reference = {"quantity": "contact pressure, Pa", "pressure": PunchPressure(load=load, half_width=a),
                     "exponent": 0.5, "half_width": a,
                     "sources": {"pressure": "Johnson, Contact Mechanics, section 2.8, for a half-plane"},
                     "remark": "The block is finite: the difference is of the order of (a / depth)^2, .1 %."}
    size = _SIZE * a
    return am.ContactProblem(
        name="flat punch", material=am.PlaneStrain(young=young, poisson=poisson),
        domain=am.Polygon(vertices=((0.0, -size), (size, -size), (size, 0.0), (a, 0.0), (0.0, 0.0)),
                       boundaries=("bottom", "side", "free", "contact", "symmetry")),
        contact=am.Contact("contact", am.Plane(point=(0.0, 0.0), normal=(0.0, -1.0))), law=law,
        loads=(am.Pressure("bottom", load / (2 * size)),), supports=(am.Support("symmetry", x=0.0),),
        reference=reference)
