"""Images: nodes on opposite sides of a periodic cell that are the same point of the material.

Where contact meets such a side, a node and its images have one mean normal and one condition, that of
all their facets.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays, Surface
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.surfaces import Periodic


def partners(
    tie: Periodic, mesh: MeshArrays, surfaces: Mapping[str, Surface]
) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes of the slave side (n,) and their partners (n,) on the master side; ValueError if
    the sides do not match."""
    points = mesh.points
    slave = surfaces[tie.slave].nodes
    master = surfaces[tie.master].nodes
    slave_middle, master_middle = (
        0.5 * (points[side].max(axis=0) + points[side].min(axis=0)) for side in (slave, master)
    )
    shift = slave_middle - master_middle
    from scipy.spatial import cKDTree  # a first solve without it starts sooner

    # scipy-stubs: of several points
    nearest = cKDTree(points[master]).query(points[slave] - shift)
    distances, partner = cast("tuple[np.ndarray, np.ndarray]", nearest)
    if len(slave) != len(master) or distances.max() > checks.SIX_DIGITS * mesh.sides.max():
        i = int(np.argmax(distances))
        raise ValueError(
            f"periodic sides {tie.master!r} and {tie.slave!r} do not match: {len(master)} and "
            f"{len(slave)} nodes, and the partner of node {slave[i]} {tuple(points[slave[i]].tolist())} "
            f"lies {distances[i]:.3g} m off. Take a structured mesh, or one with sides made alike"
        )
    return slave, master[partner]


def originals(
    problem: ContactProblem, mesh: MeshArrays, surfaces: Mapping[str, Surface]
) -> np.ndarray | None:
    """Return for each node (n_nodes,) the one that it is an image of, itself where it is none; None
    without periodic sides. Of several ties the first one counts, as in
    :func:`adaptmg.discrete.ties.tie_interfaces`."""
    ties = [tie for tie in problem.ties if isinstance(tie, Periodic)]
    if not ties:
        return None
    nodes = np.arange(mesh.n_nodes)
    result = nodes.copy()
    for tie in reversed(ties):
        slave, partner = partners(tie, mesh, surfaces)
        result[slave] = partner
    for _ in ties:  # a corner of the cell follows one node for each tie
        result = result[result]
    return result
