"""The GRECO bar in three dimensions: a box pressed on the plane z = 0 and pushed along x.

With u_y = 0 on the front and the back the solution tends to that of the bar in plane strain; with a free back face the
front is a plane of symmetry and the body, 2 x depth thick, bulges in y too.
"""

from __future__ import annotations

from adaptmg.cases.greco import greco_bar
from adaptmg.problem import (
    Box,
    Contact,
    ContactProblem,
    Coulomb,
    Law,
    Plane,
    Pressure,
    Solid,
    Support,
    checks,
)

__all__ = ["greco_block"]


def greco_block(*, law: Law = Coulomb(1.0), top_pressure: float = 5e7, side_pressure: float = 15e7,  # noqa: B008
                young: float = 1.3e11, poisson: float = 0.2, size: float = 40e-3, depth: float = 40e-3,
                plane_strain: bool = True) -> ContactProblem:
    """The GRECO bar as a solid.

    Parameters
    ----------
    law, top_pressure, side_pressure, young, poisson : see :func:`~adaptmg.cases.greco.greco_bar`
    size : float
        Length along x and height along z, m.
    depth : float
        Length along y, m.
    plane_strain : bool
        Fix u_y on front and back (True), or on the front only and leave the back free (False).

    Returns
    -------
    ContactProblem
        With ``plane_strain``, ``reference`` holds that of :func:`~adaptmg.cases.greco.greco_bar` with points
        (x, depth / 2, 0) and the remark that these are values of the plane problem.
    """
    if not isinstance(plane_strain, bool):
        raise TypeError(f"plane_strain must be True or False, got {plane_strain!r}")
    depth = checks.quantity("depth", depth, positive=True)
    bar = greco_bar(law=law, top_pressure=top_pressure, side_pressure=side_pressure, young=young, poisson=poisson,
                    size=size)
    reference = {}
    if plane_strain and bar.reference:
        points = {name: (x, depth / 2, z) for name, (x, z) in bar.reference["points"].items()}
        remark = f"Values of the plane-strain bar. {bar.reference['remark']}"
        reference = {**bar.reference, "points": points, "remark": remark}
    held = ("front", "back") if plane_strain else ("front",)
    return ContactProblem(
        name="GRECO block" if plane_strain else "GRECO block, free back",
        material=Solid(young=young, poisson=poisson),
        domain=Box(width=size, depth=depth, height=size),
        contact=Contact("bottom", Plane(point=(0.0, 0.0, 0.0), normal=(0.0, 0.0, 1.0))),
        law=law,
        loads=(Pressure("top", top_pressure), Pressure("left", side_pressure)),
        supports=(Support("right", x=0.0), *(Support(face, y=0.0) for face in held)),
        reference=reference,
    )
