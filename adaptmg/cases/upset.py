r"""The upset block: the GRECO bar without its side pressure, friction 0.5.

The block is squeezed against the plane and bulges outwards; friction holds its foot, so that sticking contact meets
the free 90 degree corner at x = 0. There u ~ r^lambda with lambda < 1 and uniform meshes converge at a reduced rate:
this is where adaptive meshes pay.
"""

from __future__ import annotations

from dataclasses import replace

from adaptmg.cases.greco import greco_bar
from adaptmg.problem import ContactProblem, Coulomb, Law

__all__ = ["upset_block"]

_EXPONENTS = {0.2: 0.781, 0.3: 0.711}


def upset_block(*, law: Law = Coulomb(0.5), top_pressure: float = 5e7, young: float = 1.3e11,  # noqa: B008
                poisson: float = 0.2, size: float = 40e-3) -> ContactProblem:
    """The upset block.

    Parameters
    ----------
    law : Law
        On the plane y = 0.
    top_pressure, young, poisson, size : float
        As in :func:`~adaptmg.cases.greco.greco_bar`.

    Returns
    -------
    ContactProblem
        ``reference`` holds, for friction 0.5 and Poisson's ratio 0.2 or 0.3, ``exponent`` (lambda) and
        ``uniform_rate``: the energy error falls like N^-uniform_rate on uniform meshes of N nodes, N^-1/2 on
        adapted ones.
    """
    problem = greco_bar(law=law, top_pressure=top_pressure, side_pressure=0.0, young=young, poisson=poisson, size=size)
    exponent = _EXPONENTS.get(poisson)
    reference = {}
    if exponent is not None and isinstance(law, Coulomb) and not callable(law.friction) and law.friction == 0.5:
        reference = {"exponent": exponent, "uniform_rate": exponent / 2,
                     "sources": {"exponent": "characteristic equation of the clamped-free 90 degree corner"}}
    return replace(problem, name="upset block", reference=reference)
