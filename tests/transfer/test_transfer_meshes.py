"""The meshes of the transfer tests are what they claim to be."""

from __future__ import annotations

import numpy as np
import pytest
from simplex_meshes import log_graded, random_box, structured

MAKERS = {"random 2D": lambda: random_box(30, 2, 0), "random 3D": lambda: random_box(30, 3, 0),
          "structured 2D": lambda: structured(3, 2), "structured 3D": lambda: structured(3, 3, 2.0),
          "log graded": lambda: log_graded(200, 0)}


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_meshes_fill_the_box_and_are_closed(make):
    mesh = make()
    assert (mesh.volumes > 0).all()
    assert mesh.volumes.sum() == pytest.approx(1, abs=1e-12)
    corners = mesh.points[mesh.facets]
    if mesh.dim == 2:
        edge = corners[:, 1] - corners[:, 0]
        normals = np.column_stack([edge[:, 1], -edge[:, 0]])
    else:
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    flux = np.sum(normals * corners.mean(axis=1))
    assert flux == pytest.approx(mesh.dim, abs=1e-12)      # the divergence theorem for the field x, normals outward


def test_log_graded_spans_three_decades():
    sizes = log_graded(3000, 1).element_sizes
    assert sizes.max() / sizes.min() > 1000
