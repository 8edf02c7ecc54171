r"""Which meshes stay as levels of a hierarchy that grows.

The rate of multigrid depends on the local size ratio of neighbours, the element size :math:`H` of the coarser over the
:math:`h` of the finer at the same place (measured on a flat punch: 3.3, 6.5, 12, 24 give rates of .35-.64, .66-.82,
.83, .88), its cost on the number of nodes on all levels. So with the 99 % quantile :math:`q` of :math:`H/h`

- a mesh is put in between where q > 4.5 and the engine can make one (at 4 it has hardly more nodes than the coarser),
- a level is dropped where it has nearly as many nodes as the next finer one, and q <= 3.5 holds without it (at 4, two
  bisections of everything near a singularity, the flat punch's rate goes from .6 to .75 and the work of the loop up).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from adaptmg.estimate.loop.given import sound_mesh
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.transfer.mesh_ratio import size_ratio

__all__ = ["appended", "carried", "thinned"]

#: largest local size ratio (its 99 % quantile) between neighbours
RATIO = 4.5
#: the same where a level could be dropped: what it saves must not cost cycles
THINNED = 3.5
#: nodes of a level over those of the next coarser one below which the two are too close
CLOSE = 1.7
#: meshes put between two neighbours at most, and how many more nodes than the coarser one each must have
MOST_BETWEEN, GROWTH = 4, 1.2


def appended(hierarchy: Hierarchy, mesh: MeshArrays, engine: Any) -> Hierarchy:
    """With a finer mesh, and meshes between it and the present finest where the size ratio asks for them.

    Parameters
    ----------
    hierarchy : Hierarchy
    mesh : MeshArrays
    engine : object
        Asked for ``intermediate(problem, coarse, fine) -> MeshArrays``, if it offers that.
    """
    between = getattr(engine, "intermediate", None)
    for _ in range(MOST_BETWEEN if callable(between) else 0):
        finest = hierarchy.finest.mesh
        if size_ratio(finest, mesh) <= RATIO:
            break
        middle = between(hierarchy.problem, finest, mesh)
        if middle is not None:
            middle = sound_mesh(engine, "intermediate", hierarchy.problem, middle, finest)
        if middle is None or not GROWTH * finest.n_nodes <= middle.n_nodes <= mesh.n_nodes / GROWTH:
            break
        hierarchy = hierarchy.append(middle)
    return hierarchy.append(mesh)


def thinned(hierarchy: Hierarchy, last: bool = False) -> Hierarchy:
    """Without levels next to the finest ones that are too close to their neighbours and can be missed.

    A single one that is too close to the ``last`` mesh stays: to do without it would cost more than its cycles.
    """
    if last and (len(hierarchy) < 3 or hierarchy[-2].n_nodes >= CLOSE * hierarchy[-3].n_nodes):
        return hierarchy
    for level in (len(hierarchy) - 2, len(hierarchy) - 3):
        if level < 1:
            break
        finer, this = hierarchy[level + 1], hierarchy[level]
        if finer.n_nodes < CLOSE * this.n_nodes and size_ratio(hierarchy[level - 1].mesh, finer.mesh) <= THINNED:
            hierarchy = hierarchy.without(level)
    return hierarchy


def carried(hierarchy: Hierarchy, below: int, displacement: np.ndarray) -> np.ndarray:
    """A displacement of a level interpolated to the finest one, level by level.

    Parameters
    ----------
    hierarchy : Hierarchy
    below : int
        Number of the level.
    displacement : (n_nodes, dim) array
        Of the bodies on that level, m.

    Returns
    -------
    (n_nodes, dim) array
        On the finest level, m: contact nodes follow the coarse contact surface, so that most keep their state.
    """
    values = hierarchy[below].discrete.relative(displacement)
    for level in hierarchy.levels[below + 1:]:
        values = level.prolongation @ values
    return hierarchy.finest.discrete.physical(values)
