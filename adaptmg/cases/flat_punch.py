r"""A flat rigid punch without friction on an elastic half-plane, and meshes refined towards points.

The punch is a rigid plane that ends: only the part |x| < a of the block's top is called "contact" and lies against the
plane y = 0. The block, guided at its plane of symmetry, is pressed up against it from below by the load P per length.
For the half-plane

.. math:: p(x) = \frac{P}{\pi\sqrt{a^2 - x^2}}

(K. L. Johnson, Contact Mechanics, 1985, section 2.8), singular at the edge: u ~ r^(1/2), so that uniform meshes
converge like N^(-1/4) in the energy norm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from adaptmg import _checks as checks
from adaptmg.problem import (
    Assembly,
    Contact,
    ContactProblem,
    Domain,
    Frictionless,
    Law,
    Plane,
    PlaneStrain,
    Polygon,
    Pressure,
    Support,
)

if TYPE_CHECKING:
    from adaptmg.mesh.arrays import MeshArrays

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


def flat_punch(*, law: Law = Frictionless(), load: float = 1e6, half_width: float = 10e-3,  # noqa: B008
               young: float = 2.1e11, poisson: float = 0.3) -> ContactProblem:
    """A flat rigid punch on a block 40 half-widths deep and 80 wide; plane strain, one half by symmetry.

    ``reference`` holds, without friction, ``pressure`` (:class:`PunchPressure`, of x in m), ``exponent`` (of the
    singularity at the edge) and ``sources``. For meshes see :func:`flat_punch_meshes`.

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
    if isinstance(law, Frictionless):
        reference = {"quantity": "contact pressure, Pa", "pressure": PunchPressure(load=load, half_width=a),
                     "exponent": 0.5, "half_width": a,
                     "sources": {"pressure": "Johnson, Contact Mechanics, section 2.8, for a half-plane"},
                     "remark": "The block is finite: the difference is of the order of (a / depth)^2, .1 %."}
    size = _SIZE * a
    return ContactProblem(
        name="flat punch", material=PlaneStrain(young=young, poisson=poisson),
        domain=Polygon(vertices=((0.0, -size), (size, -size), (size, 0.0), (a, 0.0), (0.0, 0.0)),
                       boundaries=("bottom", "side", "free", "contact", "symmetry")),
        contact=Contact("contact", Plane(point=(0.0, 0.0), normal=(0.0, -1.0))), law=law,
        loads=(Pressure("bottom", load / (2 * size)),), supports=(Support("symmetry", x=0.0),), reference=reference)


def flat_punch_meshes(problem: ContactProblem, *, finest: float = 1 / 200, levels: int = 4, factor: float = 2.0,
                      grading: float = 0.08) -> list[MeshArrays]:
    """Independent meshes, coarse to fine, graded towards the edge of the punch.

    ``finest`` is the edge length at the edge of the punch over its half-width on the finest mesh, at most 0.5,
    ``grading`` its growth per distance. From mesh to mesh all edge lengths fall by ``factor``, above 1 and at most 3.
    """
    finest = checks.positive("finest", finest)
    if not finest <= 0.5:
        raise ValueError(f"finest must be at most 0.5 of the half-width, got {finest!r}")
    if not isinstance(problem.domain, Polygon) or "free" not in problem.domain.boundaries:
        raise ValueError(f"problem must be a flat punch, got {problem.name!r}")
    a = problem.domain.vertices[3][0]
    return point_meshes(problem.domain, [(a, 0.0)], size=finest * a, radius=0.0, levels=levels, factor=factor,
                        grading=grading)


# the least number of rounds of Netgen on the finest mesh beyond those that reach its smallest size, and the largest
_CLOSER, _MOST = 1, 8
# largest edge over grading and extent
_LARGEST = 0.65


def point_meshes(domain: Domain, points: Sequence[Sequence[float]], *, size: float, radius: float, levels: int,
                 factor: float, grading: float) -> list[MeshArrays]:
    """Return independent meshes of a domain, coarse to fine. On the finest the edges have the length ``size`` within
    ``radius`` of the points and grow by ``grading`` per distance beyond, up to .65 ``grading`` times the largest extent
    of a body; on each coarser one all of this is multiplied by ``factor``. The growth is limited by 1 only, so that a
    coarse mesh is nowhere finer than the next: else some coarse functions would be seen by no fine node."""
    from adaptmg.mesh import SizeNear, sized

    grading = checks.positive("grading", grading)
    levels, factor = checks.integer("levels", levels, 1), checks.number("factor", factor)
    if not 1 < factor <= 3:
        raise ValueError(f"factor must be above 1 and at most 3, got {factor!r}")
    steepest = grading * factor**(levels - 1)
    if not steepest <= 1 + 1e-9:
        raise ValueError(f"grading * factor**(levels - 1) must be at most 1, got {steepest:.3g}: take fewer levels or "
                         "a smaller grading")
    parts = domain.parts.values() if isinstance(domain, Assembly) else (domain,)
    extent = float(max(np.max(part.upper - part.lower) for part in parts))
    meshes = []
    for level in reversed(range(levels)):
        scale = factor**level
        steep = min(1.0, grading * scale)
        near, most = size * scale, _LARGEST * steep * extent
        deep = max(0, math.ceil(math.log(most / near / 16, 8)))
        # rounds on coarse meshes cost little, and their few elements follow the field less closely
        rounds = min(2 + deep + _CLOSER + 2 * level, max(_MOST, 2 + deep))
        meshes.append(sized(domain, SizeNear(points, size=near, radius=radius, grading=steep), most, rounds,
                            grading=steep, mesher="netgen"))
    return meshes
