"""Grids of the bolted junction, and of the bar it is compared with. Part of ``bolted_junction.py``."""

from __future__ import annotations

from functools import lru_cache

import adaptmg as am
from adaptmg.mesh import graded

MM = 1e-3
#: sizes away from contact, m; at contact 2 times finer. The third grid has about as many nodes as the paper's grid 1
SIZES = (12 * MM, 7 * MM, 4 * MM, 2.4 * MM)
#: the GRECO bar with about as many nodes, the same ratios between grids and towards contact
BAR_SIZES = tuple(0.38 * size for size in SIZES)
RATIO = 2.0


def problem_of(case: str, friction: float = 0.2, preload: float = 2.5e6) -> am.ContactProblem:
    """The junction by its bolts, "ring" or "traction", or the "bar"."""
    if case == "bar":
        return am.cases.greco_bar(law=am.Coulomb(friction))
    return am.cases.bolted_junction(bolt=case, friction=friction, preload=preload)


@lru_cache(maxsize=16)
def mesh_of(case: str, number: int) -> am.MeshArrays:
    """Mesh of one grid; neither friction nor preload change it."""
    problem = problem_of(case)
    return graded(problem.domain, (BAR_SIZES if case == "bar" else SIZES)[number], problem.pair_boundaries, RATIO)


@lru_cache(maxsize=32)
def chain(case: str, finest: int, levels: int, friction: float = 0.2, preload: float = 2.5e6) -> am.Hierarchy:
    """``levels`` grids of a problem, the finest of which is number ``finest``."""
    meshes = [mesh_of(case, number) for number in range(finest + 1 - levels, finest + 1)]
    return am.Hierarchy.from_meshes(problem_of(case, friction, preload), meshes)


@lru_cache(maxsize=32)
def exact(case: str, finest: int, friction: float = 0.2) -> am.Result:
    """The exact discrete solution by an independent method: semismooth Newton with direct solves."""
    return am.solve(chain(case, finest, 1, friction), am.ActiveSet(rtol=1e-12))


def nodes_of(grids: am.Hierarchy) -> str:
    """Nodes of the grids as the paper writes them, finest first."""
    return "/".join(str(level.n_nodes) for level in reversed(grids.levels))
