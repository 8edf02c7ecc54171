"""Surface: triangles in matplotlib's three-dimensional axes with hidden parts hidden, by a depth buffer.

Matplotlib sorts whole polygons by their mean depth, which fails where bodies touch: large triangles of one come to lie
over small ones of the other. Here each pixel shows what is nearest, whatever the sizes; lines are hidden likewise. The
image is made when the figure is drawn, at its resolution, so it follows when the view is turned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backend_bases import RendererBase
from matplotlib.colors import to_rgb, to_rgba_array
from mpl_toolkits.mplot3d import Axes3D

from adaptmg.plot.space.depth_kernels import raster_segments, raster_triangles
from adaptmg.plot.style import INK

__all__ = ["Lines", "Surface", "draw_facets", "normals_of", "sharp_edges", "viewer"]

#: triangles above which their edges would only blacken the picture
_EDGES_UP_TO = 6000
#: pixels of the raster a pixel of the picture, each way
_FINER = 2


@dataclass(frozen=True)
class Lines:
    """Segments on or near the surface.

    Attributes
    ----------
    ends : (n, 2, 3) array
        In data units.
    color : str
    width : float
        Points.
    dash : (on, off)
        Points; off = 0 for a solid line.
    """

    ends: np.ndarray
    color: str
    width: float
    dash: tuple[float, float] = (1.0, 0.0)


class Surface(Artist):
    """Shaded triangles and lines; the light stands behind the viewer's left shoulder.

    Parameters
    ----------
    corners : (n, 3, 3) array
        In data units, of axes with equal scales.
    colors : (n, 4) or (n, 3, 4) array
        Of triangles, or of their corners; opaque.
    width : float
        Of the triangles' edges, points; 0 for none.
    lines : sequence of Lines
    shading : float
        How much darker a triangle is that turns from the light, 0 to 1; small where colours mean something.
    """

    def __init__(self, corners: np.ndarray, colors: np.ndarray, width: float = 0.0,
                 lines: tuple[Lines, ...] = (), shading: float = 0.28) -> None:
        super().__init__()
        self.corners = np.asarray(corners, dtype=np.float64)
        colors = np.asarray(colors, dtype=np.float64)[..., :3]
        self.colors = np.broadcast_to(colors[:, None] if colors.ndim == 2 else colors, (len(self.corners), 3, 3))
        self.width, self.lines, self.shading = width, tuple(lines), shading
        self.set_in_layout(False)
        self.set_zorder(1)

    def draw(self, renderer: RendererBase) -> None:
        """Draw into the figure; matplotlib calls this."""
        if not self.get_visible():
            return
        image, x, y = self.raster(renderer.points_to_pixels(1.0), renderer.get_image_magnification())
        if image.size:
            graphics = renderer.new_gc()
            renderer.draw_image(graphics, x, y, image)
            graphics.restore()

    def raster(self, point: float, magnification: float = 1.0) -> tuple[np.ndarray, float, float]:
        """The picture as it is seen now.

        Parameters
        ----------
        point : float
            Pixels a point.
        magnification : float
            Pixels of the image a pixel of the figure.

        Returns
        -------
        image : (rows, columns, 4) uint8 array
            The lowest row first.
        x, y : float
            Its lower left corner in pixels of the figure.
        """
        finer = _FINER * magnification
        corners, lines = self._project(self.corners), [self._project(line.ends) for line in self.lines]
        seen = np.concatenate([part.reshape(-1, 3) for part in (corners, *lines)])
        frame = self.axes.get_figure(root=True).bbox
        lower = np.floor(np.clip(seen[:, :2].min(axis=0) - 2, 0, (frame.width, frame.height)))
        upper = np.ceil(np.clip(seen[:, :2].max(axis=0) + 2, 0, (frame.width, frame.height)))
        columns, rows = np.round((upper - lower) * magnification).astype(int)
        if columns < 1 or rows < 1:
            return np.zeros((0, 0, 4), np.uint8), 0.0, 0.0
        image = np.zeros((_FINER * rows, _FINER * columns, 4))
        depth = np.full(image.shape[:2], np.inf)
        for part in (corners, *lines):
            part[..., :2] = (part[..., :2] - lower) * finer
        raster_triangles(corners, self._shaded(), np.array(to_rgb(INK)), self.width * point * finer, image, depth)
        bias = 0.01 * float(np.ptp(seen[:, 2]))
        for line, ends in zip(self.lines, lines, strict=True):
            on, off = (part * point * finer for part in line.dash)
            raster_segments(ends, np.array(to_rgb(line.color)), line.width * point * finer, on, off, bias, image, depth)
        # colours weighted by coverage, so that edges fade out without a dark rim
        image[..., :3] *= image[..., 3:]
        mean = image.reshape(rows, _FINER, columns, _FINER, 4).mean(axis=(1, 3))
        mean[..., :3] /= np.maximum(mean[..., 3:], 1e-12)
        return np.round(255 * mean).astype(np.uint8), float(lower[0]), float(lower[1])

    def _project(self, points: np.ndarray) -> np.ndarray:
        """Pixels of the figure and depth (..., 3) of points (..., 3)."""
        flat = np.column_stack([points.reshape(-1, 3), np.ones(points.size // 3)]) @ np.asarray(self.axes.get_proj()).T
        flat = flat[:, :3] / flat[:, 3:]
        flat[:, :2] = self.axes.transData.transform(flat[:, :2])
        return flat.reshape(points.shape)

    def _shaded(self) -> np.ndarray:
        """Colours (n, 3, 3) darkened where the triangle turns from the light."""
        normals = normals_of(self.corners)
        towards, up = (viewer(self.axes.elev + more, self.axes.azim) for more in (0.0, 90.0))
        light = towards + 0.7 * up - 0.5 * np.cross(up, towards)
        # a triangle seen from behind (the inside of an open surface) is lit as from its front
        front = np.where(normals @ towards < 0, -1.0, 1.0)
        shade = 1.0 - self.shading * (1.0 - np.clip(front * (normals @ (light / np.linalg.norm(light))), 0.0, 1.0))
        return self.colors * shade[:, None, None]


def draw_facets(ax: Axes3D, corners: np.ndarray, colors: np.ndarray | str, lines: bool | None = None,
                extra: tuple[Lines, ...] = (), shading: float = 0.28) -> Surface:
    """Draw triangles (n, 3, 3) in plot units in one colour or colours (n, 4) or (n, 3, 4).

    Their edges are drawn too if ``lines`` says so, by default up to 6000 triangles; and the lines ``extra``. For
    ``shading`` see :class:`Surface`.
    """
    colors = to_rgba_array(colors) if isinstance(colors, str) else np.asarray(colors)
    if len(colors) == 1:
        colors = np.repeat(colors, len(corners), axis=0)
    edged = len(corners) <= _EDGES_UP_TO if lines is None else lines
    width = float(np.clip(12 / np.sqrt(len(corners)), 0.15, 0.6)) if edged else 0.0
    surface = Surface(corners, colors, width, extra, shading)
    ax.add_artist(surface)
    return surface


def viewer(elevation: float, azimuth: float) -> np.ndarray:
    """Unit vector (3,) towards a viewer, from degrees."""
    e, a = np.radians([elevation, azimuth])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def normals_of(corners: np.ndarray) -> np.ndarray:
    """Unit normals (n, 3) of triangles (n, 3, 3)."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals / np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]


def sharp_edges(points: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Edges of the surface (n, 2) where it bends by more than 30 degrees."""
    normals = normals_of(points[facets])
    edges = np.sort(np.concatenate([facets[:, [0, 1]], facets[:, [1, 2]], facets[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(facets)), 3)
    order = np.lexsort(edges.T)
    edges, owner = edges[order], owner[order]
    same = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    bend = np.einsum("ni,ni->n", normals[owner[same]], normals[owner[same + 1]])
    return edges[same[bend < np.cos(np.pi / 6)]]
