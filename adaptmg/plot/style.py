"""The look of all pictures: type, colours that the colour-blind can tell apart (Okabe and Ito), units on axes.

Open, slip and stick in pictures: the same three colours everywhere, on curves, interfaces and backgrounds.

Edges in a row: oriented boundary edges joined to polylines, and bodies as filled shapes.
"""

from __future__ import annotations

import io
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.mathtext import MathTextParser
from matplotlib.path import Path

from adaptmg._text import printable
from adaptmg.smoother.system import OPEN, SLIP, STICK
from adaptmg.solver.result import Result

__all__ = ["BLUE", "BODY_COLORS", "CYCLE", "GREEN", "GREY", "INK", "ORANGE", "PALE", "SKY", "STATE_COLORS",
           "STATE_INKS", "STATE_NAMES", "axes_of", "axis_names", "bounds", "canvas", "filled_path", "halves",
           "label_text", "new_figure", "number", "plain", "quoted", "scaled", "shade", "state_colormap", "state_lines",
           "stated_curve", "styled", "walks"]

INK, GREY, PALE = "#1f2328", "#8a9099", "#eceef1"
BLUE, ORANGE, GREEN, PURPLE, SKY = "#0072b2", "#d55e00", "#009e73", "#b0568f", "#56b4e9"
#: fills of bodies: pale, so that lines, marks and the colours of states show on them
BODY_COLORS = ("#b9d3ea", "#f3d9b1", "#bfe0c8", "#e3c8dd", "#d9d6cf", "#f4efb5", "#b8e2e8", "#e9bdb5")
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, SKY, "#806000", INK)

_STYLE: dict[str, Any] = {
    "figure.dpi": 120, "savefig.dpi": 200, "savefig.bbox": "tight", "figure.facecolor": "white",
    "axes.facecolor": "white", "font.family": "sans-serif", "font.size": 9.5, "axes.titlesize": 10.5,
    "axes.labelsize": 9.5, "axes.titlepad": 8, "axes.edgecolor": "#5b626b",
    "axes.labelcolor": INK, "text.color": INK, "xtick.color": "#3f454d", "ytick.color": "#3f454d",
    "axes.linewidth": 0.8, "axes.spines.top": False, "axes.spines.right": False, "axes.grid": False,
    "grid.color": "#dfe3e8", "grid.linewidth": 0.7, "legend.frameon": False, "legend.fontsize": 9,
    "lines.linewidth": 1.6, "lines.markersize": 4.5, "mathtext.fontset": "dejavusans", "hatch.linewidth": 0.6,
    "axes.prop_cycle": matplotlib.cycler(color=CYCLE), "image.cmap": "viridis", "axes.axisbelow": True,
    "figure.constrained_layout.use": True, "text.usetex": False,
}

#: decorator that runs a drawing function under the common style and leaves the user's own settings alone
styled = matplotlib.rc_context(rc=_STYLE)

_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


class _Picture(Figure):
    """A figure that notebooks show without pyplot."""

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png", bbox_inches="tight")
        return buffer.getvalue()


def new_figure(size: tuple[float, float]) -> Figure:
    """Return a figure of ``size`` inches that goes when nobody holds it: pyplot would keep it until it is closed."""
    figure = _Picture(figsize=size)
    FigureCanvasAgg(figure)
    return figure


def canvas(ax: Axes | None, size: tuple[float, float], dim: int = 2) -> Axes:
    """``ax``, or the axes of a new figure of ``size`` inches; three-dimensional where ``dim`` is 3."""
    if ax is None:
        return new_figure(size).add_subplot(projection="3d" if dim == 3 else None)
    if not isinstance(ax, Axes):
        raise TypeError(f"ax must be matplotlib axes, got {ax!r}")
    if (ax.name == "3d") != (dim == 3):
        raise ValueError(f"ax must be {'three' if dim == 3 else 'two'}-dimensional: make it with "
                         f"add_subplot({'projection=' + repr('3d') if dim == 3 else ''})")
    return ax


def axes_of(axes: Sequence[Axes] | None, count: int, name: str = "ax") -> list[Axes]:
    """Given axes as a list of ``count``."""
    found = list(np.ravel(np.asarray(axes, dtype=object)))
    if len(found) != count or not all(isinstance(a, Axes) for a in found):
        raise ValueError(f"{name} must hold {count} matplotlib axes, got {axes!r}")
    return found


def axis_names(result: Result) -> str:
    """Of the two axes of the plane: 'rz' in axisymmetry, else 'xy'."""
    return "rz" if result.stress_data is not None and result.stress_data.axisymmetric else "xy"


def scaled(largest: float, unit: str) -> tuple[float, str]:
    """Factor and prefixed unit that make ``largest`` read well: 0.004 m gives (1e3, 'mm')."""
    if not (np.isfinite(largest) and largest > 0):
        return 1.0, unit
    for size, prefix in _PREFIXES:
        if largest >= 0.9999 * size:
            return 1.0 / size, prefix + unit
    return 1.0 / _PREFIXES[-1][0], _PREFIXES[-1][1] + unit


def plain(name: str) -> str:
    """A name as text that matplotlib shows as it is: no math between dollars, and in legends too (it leaves out
    labels that begin with an underscore)."""
    return (" " if name.startswith("_") else "") + printable(name).replace("$", r"\$")


def quoted(name: str) -> str:
    """A name in quotation marks, see :func:`plain`."""
    return f"'{plain(name)}'"


def label_text(text: str) -> str:
    """A user's label: with math where it can be read as math, else as it is."""
    try:
        MathTextParser("path").parse(text)
    except ValueError:
        return plain(text)
    return text if not text.startswith("_") else " " + text


def number(value: float) -> str:
    """A number for a label: three digits, no exponent where it can be avoided."""
    if value != 0 and not 1e-3 <= abs(value) < 1e5:
        mantissa, exponent = f"{value:.2e}".split("e")
        return rf"{float(mantissa):g}$\cdot$10$^{{{int(exponent)}}}$"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def bounds(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Lower and upper corner of points (n, dim), and the length of the diagonal."""
    lower, upper = points.min(axis=0), points.max(axis=0)
    return lower, upper, float(np.linalg.norm(upper - lower))


#: pale enough to draw on
STATE_COLORS = {OPEN: "#f1f2f4", SLIP: "#fbe3d3", STICK: "#d6e8f5"}
#: strong enough for lines and marks
STATE_INKS = {OPEN: "#9aa0a8", SLIP: "#e69f00", STICK: "#0072b2"}
STATE_NAMES = {OPEN: "open", SLIP: "slip", STICK: "stick"}


def state_colormap() -> tuple[ListedColormap, BoundaryNorm]:
    """Colour map and norm of the codes 0, 1, 2."""
    return ListedColormap([STATE_INKS[s] for s in (OPEN, SLIP, STICK)]), BoundaryNorm([-0.5, 0.5, 1.5, 2.5], 3)


def shade(ax: Axes, position: np.ndarray, state: np.ndarray) -> None:
    """Shade the background in runs of equal state; they meet half way between nodes."""
    starts = np.flatnonzero(np.diff(state, prepend=state[0] - 1))
    ends = np.append(starts[1:], len(state)) - 1
    for a, b in zip(starts, ends, strict=True):
        left = position[a] if a == 0 else 0.5 * (position[a - 1] + position[a])
        right = position[b] if b == len(state) - 1 else 0.5 * (position[b] + position[b + 1])
        ax.axvspan(left, right, facecolor=STATE_COLORS[int(state[a])], edgecolor="none", linewidth=0, zorder=0)


def halves(points: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """A polyline cut half way between its nodes, each half in the colour of its node."""
    middle = 0.5 * (points[:-1] + points[1:])
    segments = np.stack([np.stack([points[:-1], middle], 1), np.stack([middle, points[1:]], 1)], 1).reshape(-1, 2, 2)
    codes = np.stack([state[:-1], state[1:]], 1).ravel()
    return segments, [STATE_INKS[int(code)] for code in codes]


def stated_curve(ax: Axes, position: np.ndarray, values: np.ndarray, state: np.ndarray, linewidth: float = 1.8) -> None:
    """Draw values against position as a curve coloured by state; with marks where these can be told apart."""
    segments, colors = halves(np.stack([position, values], 1), state)
    ax.add_collection(LineCollection(segments, colors=colors, linewidths=linewidth, capstyle="round", zorder=3))
    size = 9.0 if len(position) <= 150 else 0.0
    ax.scatter(position, values, s=size, c=[STATE_INKS[int(code)] for code in state], linewidths=0, zorder=4)


def state_lines(states: Iterable[int], linewidth: float = 3.0) -> list[Line2D]:
    """Legend entries of coloured lines, for the states that occur."""
    present = set(map(int, states))
    return [Line2D([], [], color=STATE_INKS[s], linewidth=linewidth, label=STATE_NAMES[s])
            for s in (OPEN, SLIP, STICK) if int(s) in present]


def walks(edges: np.ndarray) -> list[np.ndarray]:
    """Join oriented edges (n, 2) to walks of nodes, each edge used once.

    Open walks come first, by the number of their first node; then rings, whose last node is their first (rings that
    touch in a node are one).
    """
    following: dict[int, list[int]] = defaultdict(list)
    surplus: dict[int, int] = defaultdict(int)
    for a, b in np.asarray(edges).tolist():
        following[a].append(b)
        surplus[a] += 1
        surplus[b] -= 1

    def walk_from(start: int) -> np.ndarray:
        walk = [start]
        while following[walk[-1]]:
            walk.append(following[walk[-1]].pop())
        return np.array(walk)

    nodes = sorted(following)
    found = [walk_from(node) for node in nodes for _ in range(max(surplus[node], 0))]
    # what is left enters each node as often as it leaves it: a walk ends only where it began
    return found + [walk_from(node) for node in nodes if following[node]]


def filled_path(points: np.ndarray, rings: list[np.ndarray]) -> Path:
    """One closed path of rings of nodes; holes run clockwise and stay empty."""
    vertices = [points[ring] for ring in rings]
    codes = [np.r_[Path.MOVETO, np.full(len(ring) - 2, Path.LINETO), Path.CLOSEPOLY] for ring in rings]
    return Path(np.concatenate(vertices), np.concatenate(codes))
