r"""A bar that hits a rigid wall, in closed form.

With the speed of sound :math:`c = \sqrt{E/\varrho}` the contact force of a bar of length L and width
b that arrives at the speed v is

.. math:: F = \varrho\,c\,v\,b

from the time of arrival on, until the wave that its free end reflects comes back, 2 L / c later:
then the bar leaves at the speed v, without strain, and no energy is lost. Poisson's ratio is 0. The
default numbers are those of D. Doyen, A. Ern, S. Piperno (SIAM J. Sci. Comput. 33, 2011,
doi:10.1137/100791440): contact from .5 to 1.1667 s, a force of 300 N/m."""

from __future__ import annotations

import math

import adaptmg as am
from adaptmg import _checks as checks


def impact_bar(
    *,
    length: float = 10.0,
    width: float = 1.0,
    young: float = 900.0,
    density: float = 1.0,
    gap: float = 5.0,
    speed: float = 10.0,
) -> am.ContactProblem:
    """Pose a bar that flies along its axis, -y, and hits a wall; for :func:`adaptmg.march`.

    ``reference`` holds ``force`` (N/m), ``begin`` and ``end`` of the contact (s), ``wave_speed``
    (m/s), ``quantity``, ``sources`` and ``remark``. Nothing holds the bar, so that
    :func:`adaptmg.solve` refuses it.

    Parameters
    ----------
    length, width : float
        m.
    young : float
        Pa; Poisson's ratio is 0.
    density : float
        kg/m^3; give :class:`adaptmg.Dynamics` the same.
    gap : float
        Distance of the bar from the wall at the start, m, > 0.
    speed : float
        Speed of the bar, m/s, > 0: give Dynamics the initial velocity (0, -speed).

    Examples
    --------
    >>> bar = am.cases.impact_bar()
    >>> bar.reference["force"], round(bar.reference["end"], 4)
    (300.0, 1.1667)
    """
    length = checks.quantity("length", length, positive=True)
    density = checks.quantity("density", density, positive=True)
    gap = checks.quantity("gap", gap, positive=True)
    speed = checks.quantity("speed", speed, positive=True)
    material = am.PlaneStrain(young=young, poisson=0.0)
    domain = am.Rectangle(width=width, height=length)
    wave_speed = math.sqrt(material.young / density)
    begin = gap / speed
    return am.ContactProblem(
        name="impact of a bar",
        material=material,
        law=am.Frictionless(),
        domain=domain,
        contact=am.Contact("bottom", am.Plane(point=(0.0, -gap), normal=(0.0, 1.0))),
        reference={
            "quantity": "contact force, N/m, and times of contact, s",
            "force": density * wave_speed * speed * domain.width,
            "begin": begin,
            "end": begin + 2 * length / wave_speed,
            "wave_speed": wave_speed,
            "sources": {"force": "Doyen, Ern, Piperno, SIAM J. Sci. Comput. 33, 2011"},
            "remark": "Exact for the continuous bar; a mesh rounds the front of the wave.",
        },
    )
