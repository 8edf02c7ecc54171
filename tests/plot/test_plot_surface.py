"""Surfaces in space: each pixel shows the nearest triangle."""

import numpy as np
from made import cube
from matplotlib.figure import Figure

from adaptmg.plot.surfaces import ShadedSurface, raster_segments, raster_triangles

CORNERS = np.array(
    [[[0, 0, 1], [8, 0, 1], [0, 8, 1]], [[0, 0, 2], [8, 0, 0], [8, 8, 0]]], dtype=float
)


def rastered(kernel, corners=CORNERS, width=0.0) -> tuple[np.ndarray, np.ndarray]:
    image, depth = np.zeros((8, 8, 4)), np.full((8, 8), np.inf)
    colors = np.repeat(np.eye(3)[: len(corners), None], 3, axis=1)
    kernel(corners, colors, np.array([1.0, 1, 1]), width, image, depth)
    return image, depth


def test_the_nearest_triangle_is_seen_pixel_by_pixel():
    image, depth = rastered(raster_triangles)
    i, j = np.mgrid[:8, :8]
    x, y = j + 0.5, i + 0.5
    flat = np.where(x + y <= 8, 1.0, np.inf)
    sloped = np.where(y <= x, 2 - x / 4, np.inf)
    np.testing.assert_allclose(depth, np.minimum(flat, sloped))
    np.testing.assert_array_equal(image[..., 3] == 1, np.isfinite(depth))
    np.testing.assert_array_equal(image[..., 1] == 1, np.isfinite(depth) & (sloped < flat))
    # the order in which triangles come does not matter
    np.testing.assert_array_equal(rastered(raster_triangles, CORNERS[::-1])[1], depth)


def test_segments_show_where_no_triangle_is_in_front():
    ends = np.array([[[0.0, 3.5, 1.5], [8.0, 3.5, 1.5]]])
    image, depth = rastered(raster_triangles, CORNERS[:1])
    raster_segments(ends, np.ones(3), 1.0, 0.0, image, depth)
    assert image[3, :, 2].tolist() == [0, 0, 0, 0, 0, 1, 1, 1]
    # edges of triangles are half a width inside each
    assert (rastered(raster_triangles, CORNERS[:1], width=2.5)[0][0, :7, 2] == 1).all()


def test_a_surface_shows_the_front_of_a_body_from_any_side():
    mesh = cube(2, 1.0)
    outward = np.cross(
        *(mesh.points[mesh.facets[:, k]] - mesh.points[mesh.facets[:, 0]] for k in (1, 2))
    )
    axis = np.argmax(np.abs(outward), axis=1)
    side = (np.sign(outward[np.arange(len(axis)), axis]) > 0).astype(int)
    tints = np.linspace(0.1, 1.0, 6)
    colors = np.repeat(tints[2 * axis + side][:, None], 4, axis=1)
    ax = Figure().add_subplot(projection="3d")
    surface = ShadedSurface(mesh.points[mesh.facets], colors, shading=0.0)
    ax.add_artist(surface)
    ax.set(xlim=(0, 1), ylim=(0, 1), zlim=(0, 1))
    for elevation, azimuth, front in ((0, 0, 1), (0, 180, 0), (0, 90, 3), (90, 0, 5), (-90, 0, 4)):
        ax.view_init(elev=elevation, azim=azimuth)
        image, _, _ = surface.raster()
        middle = image[image.shape[0] // 2, image.shape[1] // 2]
        assert middle[3] == 255 and middle[0] == round(255 * tints[front])
