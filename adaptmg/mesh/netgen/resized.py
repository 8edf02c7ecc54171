r"""resized: a mesh of a domain in one call of Netgen, told the wanted sizes at many points at once.

:func:`adaptmg.mesh.sized` learns a size function by drafts, as it knows nothing of it. Where sizes are known on a mesh
(adaptive meshes: :mod:`adaptmg.estimate.remesh`) and grow slowly, Netgen follows them at once. Uniform refinement of a
mesh of twice the sizes, every element cut in four (3D: eight) with new nodes on the curves, is cheaper still: a k-fold
refinement asks Netgen for :math:`2^k h` and so for :math:`2^{-kd}` of the nodes. Sizes must then grow :math:`2^k` times
more slowly.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import netgen.meshing
import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.assembled import merged, per_body
from adaptmg.mesh.build import with_source
from adaptmg.mesh.netgen.generate import extent, one_mesh
from adaptmg.mesh.netgen.outline import finished
from adaptmg.problem import checks
from adaptmg.problem.domains import Assembly, Domain, Outline, SolidDomain, StepFile

__all__ = ["PointSizes", "resized"]

# Netgen's default growth of sizes; where it fails, slower growth (which only makes the mesh finer) often helps
_GRADING = 0.3
_ATTEMPTS = (1.0, 0.7, 0.5)
# Netgen takes no notice of sizes within 1.2 of what it knows: told twice, it keeps to within a tenth either way
_PASSES = (1.0, 0.91)
_STEPS = {2: "optsteps2d", 3: "optsteps3d"}


@dataclass(frozen=True, eq=False)
class PointSizes:
    """Wanted edge lengths at points, so dense that sizes between them need not be known.

    Parameters
    ----------
    points : (n, dim) array
        m.
    sizes : (n,) array
        m, > 0.
    """

    points: np.ndarray
    sizes: np.ndarray

    def __post_init__(self) -> None:
        points, sizes = (np.asarray(a, dtype=np.float64) for a in (self.points, self.sizes))
        if points.ndim != 2 or len(points) == 0 or sizes.shape != points.shape[:1]:
            raise ValueError(f"points and sizes must have shapes (n, dim) and (n,) with n > 0, got {points.shape} and "
                             f"{sizes.shape}")
        if not (np.isfinite(points).all() and np.isfinite(sizes).all() and (sizes > 0).all()):
            raise ValueError("points must be finite, sizes finite and > 0")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "sizes", sizes)

    def options(self, lower: np.ndarray, scale: float, grading: float, refinements: int, steps: int
                ) -> netgen.meshing.MeshingParameters:
        """What Netgen is to be told about the domain moved by ``-lower`` and divided by ``scale``."""
        factor = 2**refinements / scale
        largest = float(self.sizes.max())
        # Netgen's threads spend more time waiting than the work takes
        options = netgen.meshing.MeshingParameters(maxh=factor * largest, grading=grading, parallel_meshing=False,
                                                   **{_STEPS[self.points.shape[1]]: steps})
        places = np.zeros((len(self.points), 3))
        places[:, :self.points.shape[1]] = (self.points - lower) / scale
        for share in _PASSES:
            for (x, y, z), h in zip(places.tolist(), (share * factor * self.sizes).tolist(), strict=True):
                options.RestrictH(x, y, z, h)
        return options


def resized(domain: Domain, sizes: PointSizes | Mapping[str, PointSizes], *, refinements: int = 0, steps: int = 3
            ) -> MeshArrays:
    """Mesh a domain by sizes at points.

    Parameters
    ----------
    domain : Rectangle, Polygon, Outline, Box, Cylinder, Cut or another solid, Assembly of these, or StepFile
        What to mesh.
    sizes : PointSizes; of several bodies a mapping of str to these
        For each body.
    refinements : int
        How often a coarser mesh of Netgen is refined uniformly, >= 0 (module docstring).
    steps : int
        How often Netgen improves the shapes of the elements, >= 0.

    Returns
    -------
    MeshArrays
        With its source; the same arrays for the same arguments. See :func:`adaptmg.mesh.graded` for arcs and bodies.

    Raises
    ------
    TypeError, ValueError
        On an unknown domain, bodies without sizes, or where Netgen fails.
    """
    refinements, steps = (checks.integer(name, n, 0) for name, n in (("refinements", refinements), ("steps", steps)))
    if isinstance(domain, Assembly):
        mine = per_body("sizes", sizes, domain.bodies)
        return merged({body: resized(part, mine[body], refinements=refinements, steps=steps)
                       for body, part in domain.parts.items()})
    checks.instance("sizes", sizes, PointSizes)
    if not isinstance(domain, Domain) or isinstance(domain, SolidDomain | StepFile):
        raise TypeError(f"domain must be a plane domain, a Box or an Assembly of these, got {domain!r}")
    return _attempts(domain, lambda grading: _body(domain, sizes, grading, refinements, steps))


def _attempts(domain: Domain, mesh: Callable[[float], MeshArrays]) -> MeshArrays:
    """The first mesh that Netgen makes, with slower and slower growth of sizes."""
    why: ValueError | None = None
    for factor in _ATTEMPTS:
        try:
            return mesh(factor * _GRADING)
        except ValueError as error:
            why = error
    raise ValueError(f"{domain!r} could not be meshed by the given sizes: {why}") from why


def _body(domain: Domain, sizes: PointSizes, grading: float, refinements: int, steps: int) -> MeshArrays:
    """One plane domain or box."""
    lower, scale = extent(domain)
    mesh = one_mesh(domain, lower, scale, {}, sizes.options(lower, scale, grading, refinements, steps), refinements)
    return finished(domain, mesh) if isinstance(domain, Outline) else with_source(mesh)
