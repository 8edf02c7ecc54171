"""Interpolation along the contact boundary."""

import numpy as np
import pytest
from scipy import sparse
from simplex_meshes import disk, log_graded, mesh_of, random_box, structured

from adaptmg.transfer import Interpolation, surface_interpolation, with_contact_rows


def bottom(mesh):
    facets = mesh.facets[(mesh.points[mesh.facets][:, :, -1] == 0).all(axis=1)]
    return facets, np.unique(facets)


def bulged(n):
    """A cube whose bottom face is bent to a cap."""
    cube = structured(n, 3)
    points = np.array(cube.points)
    points[:, 2] -= (1 - points[:, 2]) * 0.3 * (1 - (2 * points[:, 0] - 1) ** 2) * (1 - (2 * points[:, 1] - 1) ** 2)
    mesh = mesh_of(points, cube.elements)
    return mesh, cube.facets[(cube.points[cube.facets][:, :, 2] == 0).all(axis=1)]


@pytest.mark.parametrize(("coarse", "fine"), [(random_box(20, 2, 1), random_box(80, 2, 2)),
                                              (log_graded(300, 1), log_graded(900, 2)),
                                              (random_box(30, 3, 1), random_box(90, 3, 2))], ids=["2D", "graded", "3D"])
def test_on_a_flat_boundary_it_is_the_interpolation(coarse, fine):
    facets, allowed = bottom(coarse)
    _, nodes = bottom(fine)
    rows = surface_interpolation(coarse, fine, facets, nodes)
    assert rows.shape == (len(nodes), coarse.n_nodes) and np.isin(rows.indices, allowed).all()
    np.testing.assert_allclose(rows @ coarse.points, fine.points[nodes], atol=1e-14)
    volume = Interpolation().build(coarse, fine)
    np.testing.assert_allclose((rows - volume[nodes]).toarray(), 0, atol=1e-7)
    changed, others = with_contact_rows(volume, nodes, 2 * rows), np.setdiff1d(np.arange(fine.n_nodes), nodes)
    assert abs(changed[nodes] - 2 * rows).max() == 0 == abs(changed[others] - volume[others]).max()


def test_on_a_curved_face_no_facet_is_nearer():
    coarse, facets = bulged(4)
    fine, fine_facets = bulged(9)
    nodes = np.unique(fine_facets)
    rows = surface_interpolation(coarse, fine, facets, nodes)
    assert rows.data.min() >= 0 and np.diff(rows.indptr).max() <= 3
    np.testing.assert_allclose(rows.sum(axis=1), 1, atol=1e-15)
    distance = np.linalg.norm(rows @ coarse.points - fine.points[nodes], axis=1)
    weights = np.array([(a, b, 12 - a - b) for a in range(13) for b in range(13 - a)]) / 12
    samples = np.einsum("wk,fkd->fwd", weights, coarse.points[facets]).reshape(-1, 3)
    sampled = np.linalg.norm(samples[None] - fine.points[nodes][:, None], axis=2).min(axis=1)
    assert (distance <= sampled + 1e-12).all()


def test_failures_name_the_argument():
    coarse, fine = disk(2), disk(3)
    nodes = np.unique(fine.facets)
    for facets in (coarse.facets[:0], coarse.facets + coarse.n_nodes, coarse.facets[0]):
        with pytest.raises(ValueError, match="coarse_boundary_facets must hold nodes of coarse"):
            surface_interpolation(coarse, fine, facets, nodes)
    P = Interpolation().build(coarse, fine)
    for rows, at in ((sparse.csr_array((len(nodes), 3)), nodes), (P[[0, 1]], np.array([0, 0]))):
        with pytest.raises(ValueError, match=r"rows must have shape .* distinct fine_nodes"):
            with_contact_rows(P, at, rows)
