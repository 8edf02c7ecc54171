"""The style of all pictures: type, colours for the colour-blind (Okabe and Ito), units, contact
states, polylines.

Open, slip and stick have the same three colours on curves, interfaces and backgrounds.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from os import PathLike
from typing import IO, TYPE_CHECKING, Literal

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import LayoutEngine
from matplotlib.lines import Line2D
from matplotlib.mathtext import MathTextParser
from matplotlib.rcsetup import cycler
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from matplotlib.transforms import ScaledTranslation

from adaptmg import _checks as checks
from adaptmg._text import printable
from adaptmg.smoother.system import OPEN, SLIP, STICK
from adaptmg.solver.result import Result

if TYPE_CHECKING:
    from matplotlib.typing import RcKeyType

INK, GREY = "#1f2328", "#8a9099"
BLUE, ORANGE, GREEN, PURPLE, SKY = "#0072b2", "#d55e00", "#009e73", "#b0568f", "#56b4e9"
#: fills of bodies: pale, so that lines, marks and the colours of states show on them
BODY_COLORS = (
    "#b9d3ea",
    "#f3d9b1",
    "#bfe0c8",
    "#e3c8dd",
    "#d9d6cf",
    "#f4efb5",
    "#b8e2e8",
    "#e9bdb5",
)
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, SKY, "#806000", INK)

_STYLE: dict[RcKeyType, object] = {
    "figure.dpi": 120,
    "figure.facecolor": "white",
    "axes.facecolor": "white",
    "font.family": "sans-serif",
    "font.size": 9.5,
    "axes.titlesize": 10.5,
    "axes.labelsize": 9.5,
    "axes.titlepad": 8,
    "axes.edgecolor": "#5b626b",
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": "#3f454d",
    "ytick.color": "#3f454d",
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": False,
    "grid.color": "#dfe3e8",
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "legend.fontsize": 9,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
    "mathtext.fontset": "dejavusans",
    "hatch.linewidth": 0.6,
    "axes.prop_cycle": cycler(color=CYCLE),
    "image.cmap": "viridis",
    "axes.axisbelow": True,
    "text.usetex": False,
}

#: decorator: draw in the common style and leave the user's settings unchanged
styled = matplotlib.rc_context(rc=_STYLE)

_PREFIXES = ((1e9, "G"), (1e6, "M"), (1e3, "k"), (1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))


class _Picture(Figure):
    """A figure that notebooks show without pyplot; it is saved whole, without empty margins."""

    def savefig(self, fname: str | PathLike[str] | IO[bytes], **options: object) -> None:
        """Save as matplotlib does, by default with ``bbox_inches="tight"``."""
        super().savefig(fname, **{"bbox_inches": "tight", **options})

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def new_figure(
    size: tuple[float, float],
    layout: Literal["compressed", "constrained"] | LayoutEngine = "compressed",
) -> Figure:
    """Return a figure of ``size`` inches that pyplot does not keep; with subfigures
    "constrained"."""
    figure = _Picture(figsize=size, layout=layout)
    FigureCanvasAgg(figure)
    return figure


def need_displacements(result: Result) -> None:
    """Raise ValueError for a scalar result, which moves no points."""
    if result.dim == 1:
        raise ValueError(
            "result must have displacements, got that of a scalar problem: draw result.displacement[:, 0] "
            "on result.mesh (matplotlib's tricontourf), or write it by am.export.vtk"
        )


def canvas(ax: Axes | None, size: tuple[float, float], dim: int = 2) -> Axes:
    """Return ``ax``, or the axes of a new figure of ``size`` inches; three-dimensional where
    ``dim`` is 3."""
    if ax is None:
        return new_figure(size).add_subplot(projection="3d" if dim == 3 else None)
    if (checks.instance("ax", ax, Axes, "matplotlib axes").name == "3d") != (dim == 3):
        raise ValueError(f"ax must be {'three' if dim == 3 else 'two'}-dimensional")
    return ax


def figure_of(ax: Axes) -> Figure:
    """Return the figure that axes belong to; ValueError if they were removed from it."""
    figure = ax.get_figure(root=True)
    if figure is None:
        raise ValueError("ax must belong to a figure, got axes that were removed from theirs")
    return figure


def cells(
    part: Figure | SubFigure, count: int, columns: int, share: bool = False, dim: int = 2
) -> list[Axes]:
    """Return ``count`` axes row by row; with ``share`` on common scales, with numbers only at the
    left and below."""
    axes = part.subplots(
        -(-count // columns),
        columns,
        sharex=share,
        sharey=share,
        squeeze=False,
        subplot_kw={"projection": "3d"} if dim == 3 else {},
    ).ravel()
    for k, ax in enumerate(axes):
        if k >= count:
            ax.remove()
        elif share and k + columns >= count:
            ax.tick_params(labelbottom=True)
    return list(axes[:count])


def entitle(ax: Axes, text: str) -> None:
    """Set a title above everything: the labels of three-dimensional axes seen from below run along
    the upper side."""
    ax.set_title(text, pad=40 if ax.name == "3d" else None)


def legend_below(ax: Axes, handles: Sequence[Artist]) -> None:
    """Add a legend below axes and their labels."""
    distance = -0.5 if ax.name != "3d" else -0.1
    below = ScaledTranslation(0, distance, figure_of(ax).dpi_scale_trans)
    ax.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        bbox_transform=ax.transAxes + below,
        ncols=min(len(handles), 4),
        borderaxespad=0.0,
    )


def axes_of(axes: Sequence[Axes], count: int) -> list[Axes]:
    """Return ``axes`` as a list of ``count``."""
    flat = list(np.ravel(np.asarray(axes, dtype=object)))
    if len(flat) != count or not all(isinstance(ax, Axes) for ax in flat):
        raise ValueError(f"axes must hold {count} matplotlib axes, got {axes!r}")
    return flat


def axis_names(result: Result) -> str:
    """Return the names of the axes of the plane: 'rz' in axisymmetry, else 'xy'."""
    return "rz" if result.stress_data is not None and result.stress_data.axisymmetric else "xy"


def scaled(largest: float, unit: str) -> tuple[float, str]:
    """Return a factor and a prefixed unit for values up to ``largest``: 0.004 m gives (1e3,
    'mm')."""
    if not (np.isfinite(largest) and largest > 0):
        return 1.0, unit
    for size, prefix in _PREFIXES:
        if largest >= 0.9999 * size:
            return 1.0 / size, prefix + unit
    return 1.0 / _PREFIXES[-1][0], _PREFIXES[-1][1] + unit


def plain(name: str) -> str:
    """Return a name as text that matplotlib shows unchanged: without math, and not hidden in
    legends by a leading _."""
    return (" " if name.startswith("_") else "") + printable(name).replace("$", r"\$")


def quoted(name: str) -> str:
    """Return a name in quotation marks."""
    return f"'{plain(name)}'"


def label_text(text: str) -> str:
    """Return a user's label: math where it is valid math, else unchanged."""
    try:
        MathTextParser("path").parse(text)
    except ValueError:
        return plain(text)
    return text if not text.startswith("_") else " " + text


def number(value: float) -> str:
    """Return a number with three digits for a label."""
    if value != 0 and not 1e-3 <= abs(value) < 1e5:
        mantissa, exponent = f"{value:.2e}".split("e")
        return rf"{float(mantissa):g}$\cdot$10$^{{{int(exponent)}}}$"
    return f"{value:.3g}" if abs(value) < 1000 else f"{value:.0f}"


def label_plainly(axis: Axis) -> None:
    """Label a logarithmic axis with plain numbers: few on long ranges, several on short ones."""
    low, high = axis.get_data_interval()
    subs = (
        (1.0,)
        if high > 100 * low
        else (1.0, 2.0, 5.0)
        if high > 5 * low
        else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
    )
    axis.set_major_locator(LogLocator(subs=subs, numticks=20))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def bounds(points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the lower and the upper corner of points (n, dim), and the length of the diagonal."""
    lower = points.min(axis=0)
    upper = points.max(axis=0)
    return lower, upper, float(np.linalg.norm(upper - lower))


#: pale enough to draw on
STATE_COLORS: dict[int, str] = {OPEN: "#f1f2f4", SLIP: "#fbe3d3", STICK: "#d6e8f5"}
#: strong enough for lines and marks
STATE_INKS: dict[int, str] = {OPEN: "#9aa0a8", SLIP: "#e69f00", STICK: "#0072b2"}
STATE_NAMES: dict[int, str] = {OPEN: "open", SLIP: "slip", STICK: "stick"}


def shade(ax: Axes, position: np.ndarray, state: np.ndarray) -> None:
    """Shade the background in runs of equal state, which meet half way between nodes."""
    starts = np.flatnonzero(np.diff(state, prepend=state[0] - 1))
    ends = np.append(starts[1:], len(state)) - 1
    for a, b in zip(starts, ends, strict=True):
        left = position[a] if a == 0 else 0.5 * (position[a - 1] + position[a])
        right = position[b] if b == len(state) - 1 else 0.5 * (position[b] + position[b + 1])
        ax.axvspan(
            float(left),
            float(right),
            facecolor=STATE_COLORS[int(state[a])],
            edgecolor="none",
            linewidth=0,
            zorder=0,
        )


def halves(edges: np.ndarray) -> np.ndarray:
    """Return the halves (2 n, 2, dim) of edges (n, 2, dim), that of the first end first."""
    middle = edges.mean(axis=1, keepdims=True)
    return np.concatenate([edges[:, :1], middle, middle, edges[:, 1:]], axis=1).reshape(
        -1, 2, edges.shape[2]
    )


def stated_curve(
    ax: Axes, position: np.ndarray, values: np.ndarray, state: np.ndarray, linewidth: float = 1.8
) -> None:
    """Draw values against position as a curve coloured by state half way between nodes, with marks
    up to 150 nodes."""
    points = np.stack([position, values], 1)
    colors = [STATE_INKS[int(code)] for code in state]
    ax.add_collection(
        LineCollection(
            list(halves(np.stack([points[:-1], points[1:]], 1))),
            colors=np.repeat(colors, 2)[1:-1],
            linewidths=linewidth,
            capstyle="round",
            zorder=3,
        )
    )
    ax.scatter(
        position, values, s=9.0 if len(position) <= 150 else 0.0, c=colors, linewidths=0, zorder=4
    )


def body_fills(count: int) -> list[str]:
    """Return a colour for each of ``count`` bodies."""
    return [BODY_COLORS[k % len(BODY_COLORS)] for k in range(count)]


def state_lines(states: Iterable[int], linewidth: float = 3.0) -> list[Line2D]:
    """Return legend entries for the states that occur."""
    present = set(map(int, states))
    return [
        Line2D([], [], color=STATE_INKS[s], linewidth=linewidth, label=STATE_NAMES[s])
        for s in (OPEN, SLIP, STICK)
        if int(s) in present
    ]
