"""finer_at_contact: sizes of default meshes where bodies touch, from solves on the coarsest of them.

Where a boundary touches in part, the patches that touch are measured on a coarse mesh, which is made
finer around those with few nodes until all of them have enough."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Callable

import numpy as np

from adaptmg.discrete.posed import Posed
from adaptmg.grids import Grids
from adaptmg.level import level_of
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.sizes import SizeField
from adaptmg.problem import ContactProblem
from adaptmg.solver.active_set import ActiveSet
from adaptmg.solver.examine import FEW_NODES, Patch, touching_patches
from adaptmg.solver.solve import solve

_LOG = logging.getLogger(__name__)

#: solves at most: of 14 rollers of 1 cm to 1 m under 1e2 to 2e6 N/m all get enough nodes, as with twice; with
#: half 4
_ROUNDS = 6
#: nodes that a patch is refined to, over those that it needs: 15 to 39 touch below these rollers; with half 19 to 25,
#: but two of them never get enough, with twice 17 to 69
_AMPLE = 1.5


def finer_at_contact(
    problem: ContactProblem,
    mesh: MeshArrays,
    remesh: Callable[[SizeField], MeshArrays],
    share: float,
    grading: float,
) -> tuple[MeshArrays, SizeField | None]:
    """Return the coarsest mesh, finer where few of its nodes touch, and the field (n, dim) -> (n,)
    of sizes there, m; None where enough do, where the problem has no solution, and where no size
    is small enough, as at corners that press.

    ``remesh`` makes the coarsest mesh by such a field; elements of the finest mesh are ``share``
    times as large, and sizes grow by ``grading`` per distance on the coarsest.
    """
    # on the coarsest mesh, whose edges are 1 / share times as long: nodes in proportion to its cells, and in the
    # plane one more, as n nodes in a row have n - 1 edges between them
    enough = FEW_NODES[mesh.dim] * share ** (mesh.dim - 1) + (mesh.dim == 2)
    first = mesh
    finer = None
    for _ in range(_ROUNDS):
        try:
            with warnings.catch_warnings():
                # the solve on all meshes warns
                warnings.simplefilter("ignore")
                # the active set needs no coarse spaces, which the default method makes from the matrix:
                # .7 s in place of 13 s on the 1987 nodes of a bolted sector
                with_sides = Posed.of(problem, mesh).problem
                grids = Grids((level_of(with_sides, mesh),), with_sides)
                contact = solve(grids, ActiveSet(), throw=False).contact
        except (ValueError, RuntimeError) as error:
            _LOG.info("default sizes do not follow the contact: %s", error)
            return first, None
        patches = touching_patches(contact, mesh)
        if all(len(patch.nodes) >= enough for patch in patches):
            _LOG.info(
                "default sizes follow the contact: about %.2g nodes on the finest mesh; a larger grading= "
                "takes fewer, as do sizes= or contact_ratio=, which leave the contact out",
                mesh.n_nodes / share**mesh.dim,
            )
            return mesh, finer
        finer = _sizes_of(patches, mesh.points, enough, grading, finer)
        mesh = remesh(finer)
    _LOG.info("default sizes do not follow the contact: %d solves find too few nodes", _ROUNDS)
    return first, None


def _sizes_of(
    patches: list[Patch],
    points: np.ndarray,
    enough: float,
    grading: float,
    previous: SizeField | None,
) -> SizeField:
    """Return the sizes at which about ``_AMPLE`` times ``enough`` nodes of each patch touch; patches
    with enough nodes keep theirs. ``previous`` are those of the mesh."""
    from scipy.spatial import cKDTree  # a first solve without it starts sooner

    trees = [cKDTree(points[patch.nodes]) for patch in patches]
    sizes = []
    for patch in patches:
        dim = points.shape[1]
        factor = 1.0 if len(patch.nodes) >= enough else patch.share_for(_AMPLE * enough, dim)
        # the mean edge at a patch of few nodes contains longer edges around it: the size that was prescribed
        # there counts if it is smaller
        prescribed = np.inf if previous is None else previous(points[patch.nodes]).min()
        sizes.append(factor * min(patch.size, prescribed))

    def field(x: np.ndarray) -> np.ndarray:
        near = zip(trees, sizes, strict=True)
        return np.min(np.array([size + grading * tree.query(x)[0] for tree, size in near]), axis=0)

    return field
