r"""Surfaces of solids in matplotlib's three-dimensional axes, with hidden parts hidden by a depth
buffer.

Matplotlib sorts whole polygons by their mean depth, which fails where bodies touch. Here each pixel
shows what is nearest. A pixel with centre x lies in a triangle where its barycentric coordinates
:math:`w_k` are all >= 0; depth and colour are :math:`\sum_k w_k z_k` (after the perspective
division depth is linear on the screen) and
:math:`\sum_k w_k c_k`. The distance to the edge opposite corner k is :math:`w_k \cdot 2A / \ell_k`. The image is made
when the figure is drawn, at its resolution, and follows when the view is turned.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backend_bases import RendererBase
from matplotlib.backends.backend_template import RendererTemplate
from matplotlib.colors import to_rgb
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d import Axes3D, axis3d

from adaptmg import _checks as checks
from adaptmg._numba import kernel
from adaptmg.mesh.arrays import facet_table
from adaptmg.plot.style import INK, bounds, figure_of

#: pixels of the raster for each pixel of the picture, in each direction
_FINER = 2


@dataclass(frozen=True)
class Lines:
    """Segments on or near the surface."""

    ends: np.ndarray  # (n, 2, 3): in data units
    color: str
    width: float  # points
    hidden: str | None = None  # colour of the parts behind the surface; None: not drawn


class ShadedSurface(Artist):
    """Shaded triangles (n, 3, 3) in colours (n, 4) or (n, 3, 4), and lines; the light stands behind
    the viewer's left shoulder. The edges of triangles are drawn if ``edges``."""

    def __init__(
        self,
        corners: np.ndarray,
        colors: np.ndarray,
        edges: bool = False,
        lines: tuple[Lines, ...] = (),
        shading: float = 0.2,
    ) -> None:
        super().__init__()
        self.corners = np.asarray(corners, dtype=np.float64)
        self.lines = lines
        self.shading = shading
        colors = np.asarray(colors, dtype=np.float64)[..., :3]
        self.colors = np.broadcast_to(
            colors[:, None] if colors.ndim == 2 else colors, (len(corners), 3, 3)
        )
        self.width = float(np.clip(12 / np.sqrt(len(corners)), 0.15, 0.6)) if edges else 0.0
        self.set_clip_on(False)
        self.set_zorder(1)

    def draw(self, renderer: RendererBase) -> None:
        """Draw into the figure; matplotlib calls this."""
        if not self.get_visible():
            return
        image, x, y = self.raster(renderer.get_image_magnification())
        if image.size:
            graphics = renderer.new_gc()
            renderer.draw_image(graphics, x, y, image)
            graphics.restore()

    def get_tightbbox(self, renderer: RendererBase | None = None) -> Bbox:
        """Return the box of triangles and lines and, which matplotlib's layout leaves out, of the
        axes' labels."""
        parts = [self._project(self.corners)[..., :2].reshape(-1, 2)]
        parts += [self._project(line.ends)[..., :2].reshape(-1, 2) for line in self.lines]
        boxes = [Bbox([np.min(part, axis=0), np.max(part, axis=0)]) for part in parts if len(part)]
        axes = solid_axes(self.axes)
        if axes._axis3don:
            # labels are placed when they are drawn, here to nowhere
            axes.M = axes.get_proj()
            for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
                axis.draw(RendererTemplate(72))
                boxes += [axis.get_tightbbox(renderer), axis.label.get_window_extent(renderer)]
        return Bbox.union([box for box in boxes if box is not None])

    def raster(self, magnification: float = 1.0) -> tuple[np.ndarray, float, float]:
        """Return the picture in the present view, and the pixel of its lower left corner."""
        figure = figure_of(solid_axes(self.axes))
        point = figure.dpi / 72
        # drawn with _FINER times as many pixels along each side, then averaged
        finer = _FINER * magnification
        corners = self._project(self.corners)
        lines = [self._project(line.ends) for line in self.lines]
        seen = np.concatenate([part.reshape(-1, 3) for part in (corners, *lines)])
        # with two pixels around what is drawn, for the width of lines
        frame = figure.bbox
        lower = np.floor(np.clip(seen[:, :2].min(axis=0) - 2, 0, (frame.width, frame.height)))
        upper = np.ceil(np.clip(seen[:, :2].max(axis=0) + 2, 0, (frame.width, frame.height)))
        columns, rows = np.round((upper - lower) * magnification).astype(int)
        if columns < 1 or rows < 1:
            return np.zeros((0, 0, 4), np.uint8), 0.0, 0.0
        image = np.zeros((_FINER * rows, _FINER * columns, 4))
        depth = np.full(image.shape[:2], np.inf)
        for part in (corners, *lines):
            part[..., :2] = (part[..., :2] - lower) * finer
        raster_triangles(
            corners, self._shaded(), np.array(to_rgb(INK)), self.width * point * finer, image, depth
        )
        # lines lie on the surface, which must not hide them
        bias = 0.01 * float(np.ptp(seen[:, 2]))
        for line, ends in zip(self.lines, lines, strict=True):
            # the whole line in the colour of its hidden parts, then its visible parts over it
            for color, nearer in ((line.hidden, np.inf), (line.color, bias)):
                if color is not None:
                    raster_segments(
                        ends,
                        np.array(to_rgb(color)),
                        line.width * point * finer,
                        nearer,
                        image,
                        depth,
                    )
        # colours weighted by coverage, so that edges fade out without a dark rim
        image[..., :3] *= image[..., 3:]
        mean = image.reshape(rows, _FINER, columns, _FINER, 4).mean(axis=(1, 3))
        mean[..., :3] /= np.maximum(mean[..., 3:], 1e-12)
        return np.round(255 * mean).astype(np.uint8), float(lower[0]), float(lower[1])

    def _project(self, points: np.ndarray) -> np.ndarray:
        """Return pixels of the figure and depth (..., 3) of points (..., 3)."""
        axes = solid_axes(self.axes)
        homogeneous = np.column_stack([points.reshape(-1, 3), np.ones(points.size // 3)])
        flat = homogeneous @ np.asarray(axes.get_proj()).T
        flat = flat[:, :3] / flat[:, 3:]
        flat[:, :2] = axes.transData.transform(flat[:, :2])
        return flat.reshape(points.shape)

    def _shaded(self) -> np.ndarray:
        """Return the colours (n, 3, 3) darkened where the triangle turns from the light."""
        normals = normals_of(self.corners)
        axes = solid_axes(self.axes)
        towards = viewer(axes.elev, axes.azim)
        up = viewer(axes.elev + 90.0, axes.azim)
        # above the viewer, and to the left: the cross product points to the right
        light = towards + 0.7 * up - 0.5 * np.cross(up, towards)
        # a triangle seen from behind (the inside of an open surface) is lit like its front
        front = np.where(normals @ towards < 0, -1.0, 1.0)
        shade = 1.0 - self.shading * (
            1.0 - np.clip(front * (normals @ (light / np.linalg.norm(light))), 0.0, 1.0)
        )
        return self.colors * shade[:, None, None]


@kernel
def raster_triangles(corners, colors, ink, width, image, depth):
    """Draw triangles (n, 3, 3), x and y in pixels and depth, with an rgb colour (n, 3, 3) at each
    corner. Edges have the colour ``ink`` (3,) and ``width`` pixels, half in each triangle.
    ``image`` (rows, columns, 4) and ``depth`` (rows, columns) are changed."""
    rows, columns = depth.shape
    for t in range(len(corners)):
        x0, y0, z0 = corners[t, 0]
        x1, y1, z1 = corners[t, 1]
        x2, y2, z2 = corners[t, 2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if abs(area) < 1e-12:  # pixels: it is seen from the side
            continue
        # lengths of the sides opposite each corner
        l0 = ((x2 - x1) ** 2 + (y2 - y1) ** 2) ** 0.5
        l1 = ((x0 - x2) ** 2 + (y0 - y2) ** 2) ** 0.5
        l2 = ((x1 - x0) ** 2 + (y1 - y0) ** 2) ** 0.5
        first_row = max(int(min(y0, y1, y2) - 0.5), 0)
        last_row = min(int(max(y0, y1, y2) + 0.5), rows - 1)
        first_column = max(int(min(x0, x1, x2) - 0.5), 0)
        last_column = min(int(max(x0, x1, x2) + 0.5), columns - 1)
        for i in range(first_row, last_row + 1):
            y = i + 0.5
            for j in range(first_column, last_column + 1):
                x = j + 0.5
                # barycentric coordinates of the middle of the pixel
                w0 = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) / area
                w1 = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) / area
                w2 = 1.0 - w0 - w1
                # more than rounding, which must leave no pixel between two triangles out of both
                if w0 < -1e-9 or w1 < -1e-9 or w2 < -1e-9:
                    continue
                z = w0 * z0 + w1 * z1 + w2 * z2
                if z >= depth[i, j]:
                    continue
                depth[i, j] = z
                # the distance from side k is w_k times the height over it, |area| / l_k
                near = min(w0 * abs(area) / l0, w1 * abs(area) / l1, w2 * abs(area) / l2)
                edge = near < 0.5 * width
                for k in range(3):
                    if edge:
                        image[i, j, k] = ink[k]
                    else:
                        image[i, j, k] = (
                            w0 * colors[t, 0, k] + w1 * colors[t, 1, k] + w2 * colors[t, 2, k]
                        )
                image[i, j, 3] = 1.0


@kernel
def raster_segments(ends, ink, width, bias, image, depth):
    """Draw the visible parts of segments ``ends`` (n, 2, 3), in pixels and depth, as discs of ``width``
    pixels in the colour ``ink`` (3,), two for each pixel of length; what lies nearer by at most ``bias``
    does not hide them. ``image`` is changed, and ``depth`` read, as in :func:`raster_triangles`."""
    rows, columns = depth.shape
    reach = int(0.5 * width + 1.0)
    for s in range(len(ends)):
        dx, dy, dz = ends[s, 1] - ends[s, 0]
        steps = int(2.0 * (dx * dx + dy * dy) ** 0.5) + 1
        for m in range(steps + 1):
            t = m / steps
            x = ends[s, 0, 0] + t * dx
            y = ends[s, 0, 1] + t * dy
            z = ends[s, 0, 2] + t * dz
            for i in range(max(int(y) - reach, 0), min(int(y) + reach, rows - 1) + 1):
                for j in range(max(int(x) - reach, 0), min(int(x) + reach, columns - 1) + 1):
                    if (i + 0.5 - y) ** 2 + (
                        j + 0.5 - x
                    ) ** 2 <= 0.25 * width * width and z <= depth[i, j] + bias:
                        for k in range(3):
                            image[i, j, k] = ink[k]
                        image[i, j, 3] = 1.0


#: elevations and azimuths in degrees, the preferred one first
_VIEWS = (
    (22, -58),
    (22, -148),
    (-24, -58),
    (-24, -148),
    (22, 32),
    (22, 122),
    (-24, 32),
    (-24, 122),
)


def solid_axes(ax: object) -> Axes3D:
    """Return ``ax`` as three-dimensional axes."""
    return checks.instance("ax", ax, Axes3D, "three-dimensional axes")


def view_of(ax: Axes3D, corners: np.ndarray) -> None:
    """Choose the view in which most of some triangles (n, 3, 3) of a body shows; the first view is
    preferred."""
    if not len(corners):
        return
    normals = normals_of(corners)
    areas = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    best = 0.0
    chosen = _VIEWS[0]
    for view in _VIEWS:
        shown = float(areas @ np.maximum(normals @ viewer(*view), 0.0)) / float(areas.sum())
        # a later view must show clearly more, so that similar bodies are seen from the same side
        if shown > 1.2 * best + 0.05:
            best = shown
            chosen = view
    ax.view_init(*chosen)


def finish_axes(ax: Axes3D, points: np.ndarray, unit: str) -> None:
    """Set equal scales around points (n, 3), labels with units, plain panes and the first view."""
    lower, upper, _ = bounds(points)
    # a flat body, too, gets a box with a volume
    extent = np.maximum(upper - lower, 1e-3 * np.max(upper - lower))
    for axis, low, wide, name in zip(
        (ax.xaxis, ax.yaxis, ax.zaxis), lower, extent, "xyz", strict=True
    ):
        getattr(ax, f"set_{name}lim")(low - 0.02 * wide, low + 1.02 * wide)
        getattr(ax, f"set_{name}label")(f"{name} [{unit}]", labelpad=2)
        pane = checks.instance("axis", axis, axis3d.Axis).pane
        pane.set_facecolor("white")
        pane.set_edgecolor("#dfe3e8")
        axis.set_major_locator(MaxNLocator(nbins=4 if wide > 0.4 * extent.max() else 2))
        axis.set_tick_params(labelsize="small", pad=0)
    ax.grid(False)
    ax.set_box_aspect(extent)
    ax.view_init(*_VIEWS[0])


def viewer(elevation: float, azimuth: float) -> np.ndarray:
    """Return the unit vector (3,) towards a viewer at an elevation and an azimuth in degrees."""
    e, a = np.radians([elevation, azimuth])
    return np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def normals_of(corners: np.ndarray) -> np.ndarray:
    """Return the unit normals (n, 3) of triangles (n, 3, 3)."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normals / np.maximum(np.linalg.norm(normals, axis=1), np.finfo(float).tiny)[:, None]


def sharp_edges(points: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Return the edges (n, 2) of a surface where it bends by more than 30 degrees."""
    normals = normals_of(points[facets])
    table = facet_table(facets, len(points))
    inside = table.second >= 0
    bend = np.einsum("ni,ni->n", normals[table.first[inside]], normals[table.second[inside]])
    return table.facets[inside][bend < np.cos(np.pi / 6)]
