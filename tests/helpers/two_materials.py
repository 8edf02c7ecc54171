"""Bodies of two materials that share nodes, for each kind of material."""

from dataclasses import replace

import numpy as np
import pytest
from bisected_meshes import shaken

import adaptmg as am

KINDS = {
    "plane strain": am.PlaneStrain,
    "plane stress": am.PlaneStress,
    "axisymmetric": am.Axisymmetric,
    "solid": am.Solid,
}
EACH_KIND = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)
BOTH_ELEMENTS = pytest.mark.parametrize("elements", ["linear", "smoothed"])


def _glued(dim: int) -> am.MeshArrays:
    """Two bodies that share the nodes of the plane x = 1, shaken elsewhere."""
    mesh = am.mesh.structured(
        am.Rectangle(width=2.0, height=1.0)
        if dim == 2
        else am.Box(width=2.0, depth=1.0, height=1.0),
        (6, 4) if dim == 2 else (4, 2, 2),
    )
    moved = shaken(mesh, 0.05, 1).points
    points = np.where(np.isclose(mesh.points[:, :1], 1.0), mesh.points, moved)
    return replace(
        mesh,
        points=points,
        bodies=("left", "right"),
        element_body=mesh.points[mesh.elements, 0].mean(axis=1) > 1.0,
    )


MESHES = {dim: _glued(dim) for dim in (2, 3)}
