r"""Families of independent meshes around a point where bodies touch or a punch ends.

On the finest mesh the edges have the length s within a radius of the point and grow by g per distance beyond, up to
.65 g times the largest extent of a body; on the mesh l levels below all of this is multiplied by :math:`f^l`. The
growth is not cut off before it reaches 1, because a coarse mesh that is nowhere finer than the next one is what a
hierarchy of independent meshes needs: where it is not, some coarse functions are seen by no fine node.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from adaptmg.mesh import MeshArrays, SizeNear
from adaptmg.problem import Assembly, Domain, checks

__all__ = ["point_meshes"]

# rounds of Netgen on the finest mesh beyond those that reach its smallest size, and the most on coarser ones
_CLOSER, _MOST = 1, 8
# largest edge over grading and extent
_LARGEST = 0.65


def point_meshes(domain: Domain, points: Sequence[Sequence[float]], *, size: float, radius: float, levels: int,
                 factor: float, grading: float) -> list[MeshArrays]:
    """Meshes of a domain, coarse to fine.

    Parameters
    ----------
    domain : Domain
    points : sequence of points
        m.
    size : float
        Edge length at the points on the finest mesh, m.
    radius : float
        Up to which distance from a point it stays the same, m.
    levels : int
        >= 1.
    factor : float
        By which the edge lengths fall everywhere from mesh to mesh, above 1 and at most 3.
    grading : float
        Growth of the edge length per distance on the finest mesh.

    Returns
    -------
    list of MeshArrays

    Raises
    ------
    ValueError
        If ``grading`` times ``factor`` to the number of coarser meshes is above 1.
    """
    from adaptmg.mesh import sized

    grading = checks.positive("grading", grading)
    levels, factor = checks.integer("levels", levels, 1), checks.number("factor", factor)
    if not 1 < factor <= 3:
        raise ValueError(f"factor must be above 1 and at most 3, got {factor!r}")
    steepest = grading * factor**(levels - 1)
    if not steepest <= 1 + 1e-9:
        raise ValueError(f"grading {grading:g} times factor {factor:g} to the number of coarser meshes is "
                         f"{steepest:.3g}, more than 1: no mesh can grow so fast; take fewer levels or a smaller "
                         "grading")
    parts = domain.parts.values() if isinstance(domain, Assembly) else (domain,)
    extent = float(max(np.max(part.upper - part.lower) for part in parts))
    meshes = []
    for level in reversed(range(levels)):
        scale = factor**level
        steep = min(1.0, grading * scale)
        near, most = size * scale, _LARGEST * steep * extent
        deep = max(0, math.ceil(math.log(most / near / 16, 8)))
        # rounds on coarse meshes cost next to nothing, and their few elements follow the field less closely
        rounds = min(2 + deep + _CLOSER + 2 * level, max(_MOST, 2 + deep))
        meshes.append(sized(domain, SizeNear(points, size=near, radius=radius, grading=steep), most, rounds,
                            grading=steep))
    return meshes
