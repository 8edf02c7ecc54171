"""The style of all pictures: type, colours for the colour-blind (Okabe and Ito), units, contact
states, polylines.

Open, slip and stick have the same three colours on curves, interfaces and backgrounds.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from os import PathLike
from typing import IO, TYPE_CHECKING, Any, Literal, ParamSpec, TypeVar

import matplotlib
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure, SubFigure
from matplotlib.layout_engine import LayoutEngine
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.mathtext import MathTextParser
from matplotlib.rcsetup import cycler
from matplotlib.ticker import (
    FuncFormatter,
    LogLocator,
    MaxNLocator,
    NullLocator,
)
from matplotlib.transforms import ScaledTranslation

from adaptmg import _checks as checks
from adaptmg._text import printable
from adaptmg._units import converted, with_prefixes
from adaptmg.problem.contact_problem import UNNAMED
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

#: what the pictures take where the user's rcParams are those of matplotlib; sizes of fonts are relative;
#: studies/pictures.py draws with them
_STYLE: dict[RcKeyType, object] = {
    "figure.dpi": 120,
    "font.size": 9.5,
    "axes.titlesize": "medium",
    "axes.titlepad": 8,
    "axes.edgecolor": "#5b626b",
    "axes.labelcolor": INK,
    "text.color": INK,
    "xtick.color": "#3f454d",
    "ytick.color": "#3f454d",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#dfe3e8",
    "grid.linewidth": 0.7,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "lines.markersize": 4.5,
    "hatch.linewidth": 0.6,
    "axes.prop_cycle": cycler(color=CYCLE),
    "axes.axisbelow": True,
}

_Arguments = ParamSpec("_Arguments")
_Drawn = TypeVar("_Drawn")


def styled(draw: Callable[_Arguments, _Drawn]) -> Callable[_Arguments, _Drawn]:
    """Decorate a function that draws: it takes the common style except for what the user has set
    in rcParams or by a style sheet, and leaves rcParams unchanged."""

    @wraps(draw)
    def drawn(*arguments: _Arguments.args, **named: _Arguments.kwargs) -> _Drawn:
        style: dict[RcKeyType, Any] = {k: v for k, v in _STYLE.items() if not _chosen(k)}
        style["text.usetex"] = False  # names of boundaries are no TeX
        with matplotlib.rc_context(style):
            return draw(*arguments, **named)

    return drawn


def _chosen(key: RcKeyType) -> bool:
    """Return whether the user has set an entry of rcParams."""
    return bool(matplotlib.rcParams[key] != matplotlib.rcParamsDefault[key])


def chosen_width() -> float | None:
    """Return the width of new figures in inches if the user has set ``figure.figsize``."""
    return float(matplotlib.rcParams["figure.figsize"][0]) if _chosen("figure.figsize") else None


_PREFIXES = (
    (1000**3, "G"),
    (1000**2, "M"),
    (1000, "k"),
    (1, ""),
    (1000**-1, "m"),
    (1000**-2, "µ"),
    (1000**-3, "n"),
)


class _Picture(Figure):
    """A figure that notebooks show without pyplot; it is saved whole, without empty margins unless
    the user has chosen its width."""

    trimmed = True

    def savefig(self, fname: str | PathLike[str] | IO[bytes], **options: object) -> None:
        """Save as matplotlib does, where it is ``trimmed`` with ``bbox_inches="tight"``."""
        tight = {"bbox_inches": "tight"} if self.trimmed else {}
        super().savefig(fname, **{**tight, **options})

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.savefig(buffer, format="png")
        return buffer.getvalue()


def new_figure(
    size: tuple[float, float],
    layout: Literal["compressed", "constrained"] | LayoutEngine = "compressed",
) -> Figure:
    """Return a figure of ``size`` inches that pyplot does not keep; ``layout`` is "constrained" for
    subfigures. If the user has chosen a width, it has this one, and the height follows in part: texts do not
    shrink."""
    width = chosen_width()
    figure = _Picture(figsize=size if width is None else fitted(size, width), layout=layout)
    figure.trimmed = width is None
    FigureCanvasAgg(figure)
    return figure


def need_displacements(result: Result) -> None:
    """Raise ValueError for a scalar result, which moves no points."""
    if result.dim == 1:
        raise ValueError(
            "result must have displacements, got that of a scalar problem: draw result.displacement[:, 0] "
            "on result.mesh (in the plane by matplotlib's tricontourf), or write it by am.export.vtk"
        )


def fitted(size: tuple[float, float], width: float) -> tuple[float, float]:
    """Return a size of this width: the height is scaled less than the width."""
    return width, size[1] * (width / size[0]) ** 0.7


def columns_of(count: int, most: int, panel: float) -> int:
    """Return the number of columns for ``count`` panels of ``panel`` inches: ``most``, or fewer
    where they would be narrower than half of that in the width the user has chosen."""
    width = chosen_width()
    fitting = most if width is None else int(width / (0.5 * panel))
    return max(1, min(count, most, fitting))


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
    ax.set_title(text, pad=40 if ax.name == "3d" else None, wrap=True)


def narrow(ax: Axes) -> bool:
    """Return whether the figure of axes is too narrow for legends next to a picture: 5 inches."""
    return figure_of(ax).get_figwidth() < 5.0


def legend_below(ax: Axes, handles: Sequence[Artist], **options: Any) -> None:
    """Add a legend below axes and their labels."""
    lines = 3.8 if ax.name != "3d" else 0.8  # of text: the labels
    distance = -lines * matplotlib.rcParams["font.size"] / 72
    below = ScaledTranslation(0, distance, figure_of(ax).dpi_scale_trans)
    legend = ax.legend(
        handles=handles,
        loc="upper center",
        bbox_to_anchor=(0.5, 0.0),
        bbox_transform=ax.transAxes + below,
        borderaxespad=0.0,
        **{"ncols": min(len(handles), 2 if narrow(ax) else 4)} | options,
    )
    figure = figure_of(ax)
    if isinstance(figure, _Picture) and not figure.trimmed:
        figure.draw_without_rendering()
        width, height = figure.get_size_inches()
        figure.set_size_inches(width, height + legend.get_window_extent().height / figure.dpi)


def legend_next_to(ax: Axes, handles: Sequence[Artist], **options: Any) -> None:
    """Add a legend to the right of axes, in narrow figures below them."""
    if narrow(ax):
        legend_below(ax, handles, ncols=1, **options)
        return
    ax.legend(
        handles=handles,
        loc="upper left",
        bbox_to_anchor=(1.02, 1.0),
        borderaxespad=0.0,
        **options,
    )


def _inside(ax: Axes, handles: Sequence[Artist], columns: int) -> Legend:
    """Put a legend with some columns at the top inside the axes."""
    legend = ax.legend(
        handles=handles,
        loc="upper center",
        ncols=columns,
        columnspacing=1.2,
        **{} if columns > 1 or len(handles) == 1 else {"fontsize": "small", "handlelength": 1.2},
    )
    legend.set_in_layout(False)  # the axes need not shrink for it
    return legend


def legends_inside(legends: Mapping[Axes, Sequence[Artist]]) -> None:
    """Add a legend at the upper side of each of some axes of a figure, and make room for it there:
    what is drawn ends below."""
    placed = {ax: _inside(ax, handles, len(handles)) for ax, handles in legends.items() if handles}
    if not placed:
        return
    figure = figure_of(next(iter(placed)))
    figure.draw_without_rendering()
    for ax, legend in placed.items():
        if legend.get_window_extent().width > ax.get_window_extent().width:
            placed[ax] = _inside(ax, legends[ax], 1)
    for ax, legend in placed.items():
        # the drawing ends below the legend and a margin of .05, but keeps .3 of the height
        share = legend.get_window_extent().height / ax.get_window_extent().height
        scale = ax.yaxis.get_transform()
        low, high = scale.transform(ax.get_ylim())
        top = low + (high - low) / (1 - min(share + 0.05, 0.7))
        ax.set_ylim(top=float(scale.inverted().transform(top)))


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
    """Return a factor and a unit for values up to ``largest``: with a prefix, so that 0.004 m gives
    (1e3, 'mm'), or what :func:`adaptmg.set_units` has set."""
    if not with_prefixes() and converted(unit)[1] != unit:
        return converted(unit)
    if not (np.isfinite(largest) and largest > 0):
        return 1.0, unit
    # what rounds to 1 of a unit counts
    reached = (entry for entry in _PREFIXES if largest >= 0.9999 * entry[0])
    size, prefix = next(reached, _PREFIXES[-1])
    return 1.0 / size, prefix + unit


def stresses() -> tuple[float, str]:
    """Return a factor and a unit for stresses and pressures in Pa: MPa, or what
    :func:`adaptmg.set_units` has set."""
    return (1e-6, "MPa") if with_prefixes() else converted("Pa")


def plain(name: str) -> str:
    """Return a name as text that matplotlib shows unchanged: without math, and not hidden in
    legends by a leading _."""
    return (" " if name.startswith("_") else "") + printable(name).replace("$", r"\$")


def titled(problem: str, text: str = "") -> str:
    """Return a title: the name of a problem, if the user has given one, before a text."""
    if problem == UNNAMED:
        return text
    return f"{plain(problem)}: {text}" if text else plain(problem)


def quoted(name: str) -> str:
    """Return a name in quotation marks."""
    return f"'{plain(name)}'"


def label_text(text: str) -> str:
    """Return a user's label: math where it is valid math, else as :func:`plain` shows it."""
    text = printable(text)
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
    if not 0 < low <= high < np.inf:
        return
    decades = 10.0 ** np.arange(np.floor(np.log10(low)), np.ceil(np.log10(high)))
    # LogLocator would label every hundredth where it has less than two ticks
    axis.set_major_locator(MaxNLocator(2))
    for subs in ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)):
        ticks = np.outer(decades, subs)
        if np.count_nonzero((low <= ticks) & (ticks <= high)) >= 2:
            axis.set_major_locator(LogLocator(subs=subs, numticks=20))
            break
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_locator(NullLocator())


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
    """Shade the background in runs of equal state (n,), which meet half way between nodes at the ascending
    positions (n,)."""
    # a run begins at each state that differs from the one before, that of the first node from state[0] - 1
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


def stated_curve(ax: Axes, position: np.ndarray, values: np.ndarray, state: np.ndarray) -> None:
    """Draw values against position as a curve coloured by state half way between nodes, with marks
    up to 150 nodes."""
    points = np.stack([position, values], 1)
    colors = [STATE_INKS[int(code)] for code in state]
    ax.add_collection(
        LineCollection(
            list(halves(np.stack([points[:-1], points[1:]], 1))),
            colors=np.repeat(colors, 2)[1:-1],
            linewidths=matplotlib.rcParams["lines.linewidth"],
            capstyle="round",
            zorder=3,
        )
    )
    size = 0.7 * matplotlib.rcParams["lines.markersize"] if len(position) <= 150 else 0.0
    ax.scatter(position, values, s=size**2, c=colors, linewidths=0, zorder=4)


def cycled(k: int) -> str:
    """Return colour k of the cycle; the name "C0" would be that of the settings when the figure is
    saved."""
    return to_hex(f"C{k}")


def body_fills(count: int) -> list[str]:
    """Return a colour for each of ``count`` bodies."""
    return [BODY_COLORS[k % len(BODY_COLORS)] for k in range(count)]


def state_lines(states: Iterable[int]) -> list[Line2D]:
    """Return legend entries for the states that occur."""
    present = set(map(int, states))
    width = 1.8 * matplotlib.rcParams["lines.linewidth"]
    return [
        Line2D([], [], color=STATE_INKS[s], linewidth=width, label=STATE_NAMES[s])
        for s in (OPEN, SLIP, STICK)
        if int(s) in present
    ]
