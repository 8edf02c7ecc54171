r"""resized: a mesh of solids in one call of Netgen, by sizes at many points.

:func:`adaptmg.mesh.sized` learns a size function by drafts, as it knows nothing of it. Where sizes are known on a mesh
and grow slowly (adaptive meshes, :mod:`adaptmg.estimate.remesh`), Netgen follows them in one call. Uniform
refinement of a mesh of twice the sizes, every element cut in eight with new nodes on the faces, is cheaper still: a
k-fold refinement asks Netgen for :math:`2^k h` and so for :math:`2^{-3k}` of the nodes. Sizes must then grow
:math:`2^k` times more slowly.

Most of Netgen's time goes into better shapes. This is done here, in arrays (:mod:`adaptmg.mesh.improve`), of a draft
and again of what is made of it. Solids with faces other than planes, cylinders, cones, spheres and tori are left to
Netgen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays, swept
from adaptmg.mesh.domains import extent
from adaptmg.mesh.improve import halved, improved
from adaptmg.mesh.netgen_guard import MAX_NODES, Netgen, NetgenUnfinished, netgen
from adaptmg.mesh.netgen_plane import SizesAt, finished, one_mesh
from adaptmg.mesh.netgen_solid import CURVATURE, Shape, built_shape, check_volume, in_metres, ordered, shape_tables
from adaptmg.mesh.soundness import check_mesh
from adaptmg.mesh.step import step_contents, step_shapes
from adaptmg.mesh.structured import merged, per_body
from adaptmg.mesh.surfaces import candidates, onto_surfaces, surfaces_of
from adaptmg.problem.plane_domains import Box, Domain
from adaptmg.problem.solid_domains import Assembly, SolidDomain, StepFile

# Netgen's tetrahedra are finer than asked for where it is to improve them; with these factors the expected number of
# nodes comes out, of drafts and of others
_DRAFT, _PLAIN = 1.1, 1.0
# how often Netgen improves shapes: of drafts, and of what is not improved here
_STEPS, _ALL_STEPS = 2, 3
# rounds of improvement of a draft, and after refinement
_ROUNDS, _ROUNDS_AFTER = 1, 2


@dataclass(frozen=True, eq=False)
class PointSizes:
    """Wanted edge lengths at points, so dense that sizes between them need not be known."""

    points: np.ndarray  # (n, dim): m
    sizes: np.ndarray  # (n,): m, > 0

    def __post_init__(self) -> None:
        points, sizes = (np.asarray(a, dtype=np.float64) for a in (self.points, self.sizes))
        if points.ndim != 2 or len(points) == 0 or sizes.shape != points.shape[:1]:
            raise ValueError(f"points and sizes must have shapes (n, dim) and (n,) with n > 0, got {points.shape} and "
                             f"{sizes.shape}")
        if not (np.isfinite(points).all() and np.isfinite(sizes).all() and (sizes > 0).all()):
            raise ValueError("points must be finite, sizes finite and > 0")
        object.__setattr__(self, "points", points)
        object.__setattr__(self, "sizes", sizes)

    def for_netgen(self, lower: np.ndarray, scale: float, grading: float, refinements: int, *, draft: bool
                   ) -> tuple[dict[str, float], SizesAt]:
        """Options and sizes for the domain moved by ``-lower`` and divided by ``scale``; a draft is improved here."""
        steps, share = (_STEPS, _DRAFT) if draft else (_ALL_STEPS, _PLAIN)
        factor = 2**refinements / scale
        options = {"maxh": factor * float(self.sizes.max()), "grading": grading, "optsteps3d": steps}
        return options, [((self.points - lower) / scale, share * factor * self.sizes)]


def resized(domain: Domain, sizes: PointSizes | Mapping[str, PointSizes], *, grading: float = 0.3,
            refinements: int = 0) -> MeshArrays:
    """Mesh a domain by sizes at points."""
    refinements = checks.integer("refinements", refinements, 0)
    grading = checks.positive("grading", grading)
    if isinstance(domain, Assembly):
        mine = per_body("sizes", sizes, domain.bodies)
        return swept(merged({body: resized(part, mine[body], grading=grading, refinements=refinements)
                             for body, part in domain.parts.items()}))
    if isinstance(domain, StepFile):
        return _step(domain, sizes, grading, refinements)
    checks.instance("sizes", sizes, PointSizes)
    if isinstance(domain, SolidDomain):
        with netgen() as worker:
            shape = built_shape(worker, domain)
            return _attempts(domain, grading, refinements,
                             lambda g, k: ordered(domain, _shape(worker, shape, sizes, g, k)))
    if not isinstance(domain, Box):
        raise TypeError(f"domain must be a Box, another solid, an Assembly of these or a StepFile, got {domain!r}")
    return _attempts(domain, grading, refinements, lambda g, k: _box(domain, sizes, g, k))


def _attempts(domain: Domain, grading: float, refinements: int, mesh: Callable[[float, int], MeshArrays]) -> MeshArrays:
    """The first mesh that comes out sound. Where Netgen fails, slower growth of sizes (which only makes the mesh finer)
    often helps; in the end no refinement."""
    why: Exception | None = None
    for factor, k in ((1.0, refinements), (0.7, refinements), (0.7, 0), (0.5, 0)):
        try:
            return mesh(factor * grading, k)
        except ValueError as error:
            why = error
            if isinstance(error, NetgenUnfinished):
                break
    raise ValueError(f"Netgen could not mesh {domain!r} by the given sizes ({why}); start from a "
                     "finer mesh") from why


def _box(domain: Box, sizes: PointSizes, grading: float, refinements: int) -> MeshArrays:
    """A mesh of a box: Netgen's draft, improved and refined in arrays."""
    lower, scale = extent(domain)
    options, at = sizes.for_netgen(lower, scale, grading, refinements, draft=True)
    draft = check_mesh(one_mesh(domain, lower, scale, {}, options, at, MAX_NODES[3]))
    mesh = improved(draft, _ROUNDS)
    for _ in range(refinements):
        mesh = halved(mesh)
    if refinements:
        mesh = improved(mesh, _ROUNDS_AFTER)
    return finished(domain, mesh)


def _step(domain: StepFile, sizes: PointSizes | Mapping[str, PointSizes], grading: float, refinements: int
          ) -> MeshArrays:
    meshes = {}
    with netgen() as worker:
        contents = step_contents(worker, domain)
        by_body = per_body("sizes", sizes, list(contents))
        for body, shape in step_shapes(worker, domain, contents):
            own = checks.instance(f"sizes[{body!r}]", by_body[body], PointSizes)
            meshes[body] = _attempts(domain, grading, refinements, lambda g, k, shape=shape, own=own:
                                     check_mesh(_shape(worker, shape, own, g, k)))
    return swept(merged(meshes))


def _shape(worker: Netgen, shape: Shape, sizes: PointSizes, grading: float, refinements: int) -> MeshArrays:
    """A mesh of the solid that a process holds: Netgen's draft, refined in arrays where its faces are known."""
    known = candidates(shape.samples) if refinements else None
    if known is None:
        grading, refinements = grading / 2**refinements, 0
    options, at = sizes.for_netgen(shape.lower, shape.scale, grading, refinements, draft=False)
    options["curvaturesafety"] = CURVATURE / 2 ** (refinements / 2)
    unit = shape_tables(worker, {}, options, at, MAX_NODES[3])
    if known is not None:
        surfaces = surfaces_of(known, unit)
        for _ in range(refinements):
            unit = improved(onto_surfaces(surfaces, halved(unit), unit.n_nodes), _ROUNDS_AFTER)
    check_volume(unit, shape.volume)
    return in_metres(unit, shape)
