"""The solid problem: a box with its contact faces, loads and supports, seen from the front, above and the side."""

from __future__ import annotations

import numpy as np
from mpl_toolkits.mplot3d import Axes3D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from adaptmg.plot.labels import describe_law, support_text
from adaptmg.plot.solid import finish_axes
from adaptmg.plot.style import BLUE, GREEN, GREY, INK, ORANGE, number, scaled
from adaptmg.problem import BodyForce, ContactProblem, Pressure

__all__ = ["draw"]

#: axis and side of each face of a Box
_FACES = {"left": (0, 0), "right": (0, 1), "front": (1, 0), "back": (1, 1), "bottom": (2, 0), "top": (2, 1)}


class _Face:
    """A face of the box in plot units: corners (4, 3), outward normal, centre."""

    def __init__(self, name: str, lower: np.ndarray, upper: np.ndarray) -> None:
        axis, side = _FACES[name]
        others = [k for k in range(3) if k != axis]
        self.corners = np.empty((4, 3))
        self.corners[:, axis] = (lower, upper)[side][axis]
        for corner, (a, b) in zip(self.corners, ((0, 0), (1, 0), (1, 1), (0, 1)), strict=True):
            corner[others[0]], corner[others[1]] = (lower, upper)[a][others[0]], (lower, upper)[b][others[1]]
        self.normal = np.zeros(3)
        self.normal[axis] = 2 * side - 1
        self.centre = self.corners.mean(axis=0)

    def points(self, count: int = 4) -> np.ndarray:
        s = (np.arange(count) + 0.5) / count
        a, b = np.meshgrid(s, s)
        u, v = self.corners[1] - self.corners[0], self.corners[3] - self.corners[0]
        return self.corners[0] + a.reshape(-1, 1) * u + b.reshape(-1, 1) * v


def draw(posed: ContactProblem, ax: Axes3D) -> None:
    """Draw a solid problem on a Box; see :func:`adaptmg.plot.problem`."""
    box = posed.domain
    scale, unit = scaled(float(np.linalg.norm(box.upper - box.lower)), "m")
    lower, upper = box.lower * scale, box.upper * scale
    faces = {name: _Face(name, lower, upper) for name in _FACES}
    size = float(np.max(upper - lower))
    handles = {}

    def fill(names: list[str], color: str, label: str, alpha: float) -> None:
        patch = Poly3DCollection([faces[n].corners for n in names], facecolor=color, edgecolor="none", alpha=alpha)
        ax.add_collection3d(patch)
        handles[label] = patch

    for contact in posed.contact:
        fill([contact.boundary], ORANGE, f"{describe_law(posed.law)} on {contact.boundary!r}", 0.35)
    for support in posed.supports:
        text = support_text(support, 3).replace("\n", ", ")
        fill([support.boundary], GREEN, f"{text} on {support.boundary!r}", 0.16)
    outline = [face.corners[[0, 1, 2, 3, 0]] for face in faces.values()]
    for loop in outline:
        ax.plot(*loop.T, color=INK, linewidth=0.9)
    sizes = [_size(posed, load, faces, scale) for load in posed.loads]
    largest = max((s for s, load in zip(sizes, posed.loads, strict=True) if not isinstance(load, BodyForce)),
                  default=0.0)
    for load, value in zip(posed.loads, sizes, strict=True):
        if value > 0:
            label, artist = _draw_load(ax, load, faces, scale, size, value, largest)
            handles[label] = artist
    for name, face in faces.items():
        ax.text(*face.centre, name, color=GREY, ha="center", va="center", fontsize=8)
    finish_axes(ax, np.array([lower, upper]), unit)
    ax.legend(handles.values(), handles.keys(), loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=1)


def _load_values(load: object, face: _Face | None, x: np.ndarray) -> np.ndarray:
    def at(value: object) -> np.ndarray:
        return np.broadcast_to(np.asarray(value(x) if callable(value) else value, dtype=float), len(x))

    if isinstance(load, Pressure):
        return -at(load.value)[:, None] * face.normal
    return np.stack([at(c) for c in load.components], axis=1)


def _size(posed: ContactProblem, load: object, faces: dict[str, _Face], scale: float) -> float:
    face = None if isinstance(load, BodyForce) else faces[load.boundary]
    x = posed.domain.lower[None] if face is None else face.points() / scale
    return float(np.linalg.norm(_load_values(load, face, x), axis=1).max())


def _draw_load(ax: Axes3D, load: object, faces: dict[str, _Face], scale: float, size: float, value: float,
               largest: float) -> tuple[str, object]:
    """Arrows of a load; its label and an artist for the legend."""
    if isinstance(load, BodyForce):
        face, x = None, np.mean([f.centre for f in faces.values()], axis=0)[None]
        arrows = _load_values(load, None, x / scale) * (0.3 * size / value)
        factor, unit = scaled(value, "N/m³")
        label = f"body force {number(value * factor)} {unit}"
    else:
        face = faces[load.boundary]
        x = face.points()
        arrows = _load_values(load, face, x / scale) * (0.28 * size / largest)
        factor, unit = scaled(value, "Pa")
        kind = "pressure" if isinstance(load, Pressure) else "traction"
        label = f"{kind} {number(value * factor)} {unit} on {load.boundary!r}"
    pushing = np.ones(len(x), bool) if face is None else arrows @ face.normal <= 0
    tails = np.where(pushing[:, None], x - arrows, x)
    artist = ax.quiver(*tails.T, *arrows.T, color=BLUE, linewidth=1.1, arrow_length_ratio=0.25)
    return label, artist
