r"""The end of a slip zone under Coulomb friction, with its exact solution: slip beside an open zone or sticking.

Rectangle (-1, 1) x (0, 1) m in plane strain on the rigid plane y = 0: slip at x > 0, open or stick at x < 0, and
around x = 0 a field :math:`r^\lambda`, :math:`\lambda = 3/2 \pm \arctan(f \beta)/\pi`
(:mod:`adaptmg.cases.coulomb_field`). The top has the exact displacement. So have the sides along x; along y they have
the exact shear traction, because a support may not fix the normal displacement of the contact nodes at which they end.
The energy error of linear elements falls like h on uniform meshes, and the discrete transition lies within one cell of
x = 0.
"""

from __future__ import annotations

import math

import numpy as np

from adaptmg.cases.coulomb_field import (
    DisplacementComponent,
    TractionComponent,
    TransitionField,
    transition_exponent,
    transition_mode,
)
from adaptmg.problem import (
    Contact,
    ContactProblem,
    Coulomb,
    Plane,
    PlaneStrain,
    Rectangle,
    Support,
    Traction,
    checks,
)

__all__ = ["coulomb_transition"]


def coulomb_transition(*, law: Coulomb = Coulomb(0.5), kind: str = "open", sign: str = "+",  # noqa: B008
                       pressure: float = 1e8, young: float = 1.3e11, poisson: float = 0.2) -> ContactProblem:
    """A transition of contact states with its exact solution.

    Parameters
    ----------
    law : Coulomb
        A constant coefficient, above 0 and at most 2.
    kind : {"open", "stick"}
        What lies beside the slip zone.
    sign : {"+", "-"}
        Of lambda: "+" where the body slips away from the transition, "-" where it slips towards it.
    pressure : float
        Of "open" the pressure at x = 1, of "stick" the uniform compression, Pa, > 0.
    young, poisson : float
        Pa, and a number.

    Returns
    -------
    ContactProblem
        ``reference`` holds ``field`` (:class:`~adaptmg.cases.coulomb_field.TransitionField`: ``displacement``,
        ``gradient``, ``stress``, ``energy_error(result)``), ``exponent``, ``transition`` (0.0, m) and ``uniform_rate``
        (0.5: the energy error falls like N^-1/2 on uniform meshes of N nodes).
    """
    checks.choice("kind", kind, ("open", "stick"))
    checks.choice("sign", sign, ("+", "-"))
    if not isinstance(law, Coulomb) or callable(law.friction) or np.ndim(law.friction) or not 0 < law.friction <= 2:
        raise ValueError("law must be Coulomb(f) with one coefficient f above 0 and at most 2: the exact field is that "
                         f"of friction, got {checks.described(law)}")
    pressure = checks.quantity("pressure", pressure, positive=True)
    field = _field(kind, sign == "+", float(law.friction), pressure, PlaneStrain(young=young, poisson=poisson))
    moved = [DisplacementComponent(field, k) for k in (0, 1)]
    return ContactProblem(
        name=f"Coulomb transition, slip and {kind}, {sign}",
        material=field.material,
        domain=Rectangle(width=2.0, height=1.0, origin=(-1.0, 0.0)),
        contact=Contact("bottom", Plane(point=(0.0, 0.0), normal=(0.0, 1.0))),
        law=law,
        loads=tuple(Traction(side, (0.0, TractionComponent(field, normal, 1)))
                    for side, normal in (("left", -1.0), ("right", 1.0))),
        supports=(Support("top", x=moved[0], y=moved[1]), Support("left", x=moved[0]), Support("right", x=moved[0])),
        reference={"quantity": "displacement, m", "field": field, "exponent": field.exponent, "transition": 0.0,
                   "uniform_rate": 0.5, "sources": {"field": "eigenfunction of the half plane, exact"}},
    )


def _field(kind: str, away: bool, friction: float, pressure: float, material: PlaneStrain) -> TransitionField:
    """The mode with the sign and size, and the uniform part, that make all states admissible."""
    a, b, _ = transition_mode(kind, friction, material.poisson, away)
    exponent, direction = transition_exponent(friction, material.poisson, away), 1.0 if away else -1.0
    mode = TransitionField(material=material, exponent=exponent, a=a, b=b)
    right, left = (mode.stress(np.array([[x, 0.0]]))[0] for x in (1.0, -1.0))
    if kind == "open":
        scale, uniform, shear = pressure / -right[1], 0.0, 0.0
    else:
        # the tangential traction at x < 0 must stay below the limit, which the uniform part reaches
        excess = direction * left[2] + friction * left[1]
        scale, uniform, shear = -friction * pressure / excess, pressure, direction * friction * pressure
    made = TransitionField(material=material, exponent=exponent, a=scale * a, b=scale * b, pressure=uniform,
                           shear=shear)
    if kind == "stick":
        return made
    slip = abs(float(made.displacement(np.array([[1.0, 0.0]]))[0, 0]))
    return TransitionField(material=material, exponent=exponent, a=made.a, b=made.b,
                           shift=direction * math.ceil(2e6 * slip) * 1e-6)
