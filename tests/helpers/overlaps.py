"""What covers what in a picture: texts, legends, and what is drawn in axes."""

from itertools import combinations

import numpy as np
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.figure import Figure
from matplotlib.legend import Legend
from matplotlib.lines import Line2D
from matplotlib.text import Text
from matplotlib.transforms import Bbox


def shown_texts(figure: Figure) -> dict[str, Bbox]:
    """Boxes of the texts that are seen, tick labels too, by text and place."""
    renderer = figure.canvas.get_renderer()
    boxes = {}
    hidden = set()
    for ax in figure.axes:
        for axis in ax._axis_map.values():
            low, high = sorted(axis.get_view_interval())
            seen = ax.axison and axis.get_visible()
            for tick in (*axis.get_major_ticks(), *axis.get_minor_ticks()):
                if not seen or not low <= tick.get_loc() <= high:
                    hidden |= {tick.label1, tick.label2}
            if not seen:
                hidden |= {axis.label, axis.offsetText}
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip() and text not in hidden:
            box = text.get_window_extent(renderer)
            if box.width > 1 and box.height > 1:
                boxes[f"{text.get_text()!r} at {box.x0:.0f}, {box.y0:.0f}"] = box
    return boxes


def drawn_points(ax) -> np.ndarray:
    """Points (n, 2) of curves and marks in axes, in pixels, close to each other."""
    points = [np.empty((0, 2))]
    for line in ax.get_lines():
        if isinstance(line, Line2D) and len(line.get_xdata()) > 2:
            points.append(line.get_transform().transform(line.get_xydata()))
    for part in ax.collections:
        if isinstance(part, LineCollection):
            ends = np.array([segment[:2] for segment in part.get_segments() if len(segment) > 1])
            share = np.linspace(0, 1, 9)[:, None, None]
            between = (1 - share) * ends[:, 0] + share * ends[:, 1] if len(ends) else ends
            points.append(ax.transData.transform(np.reshape(between, (-1, 2))))
        elif isinstance(part, PathCollection):
            points.append(ax.transData.transform(np.asarray(part.get_offsets())))
    return np.concatenate(points)


def overlaps(figure: Figure) -> list[str]:
    """Pairs of texts that overlap, texts that leave the figure, and legends that cover a curve, a
    mark or a text of others."""
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    texts = shown_texts(figure)
    found = [
        f"{one} and {other}"
        for (one, first), (other, second) in combinations(texts.items(), 2)
        if first.padded(-1).overlaps(second.padded(-1))
    ]
    whole = figure.bbox.padded(0.5)
    found += [
        f"{text} leaves the figure"
        for text, box in texts.items()
        if not (
            whole.x0 <= box.x0 and box.x1 <= whole.x1 and whole.y0 <= box.y0 and box.y1 <= whole.y1
        )
    ]
    for legend in figure.findobj(Legend):
        box = legend.get_window_extent(renderer).padded(-1)
        inside = {id(text) for text in legend.findobj(Text)}
        for text in figure.findobj(Text):
            if id(text) not in inside and text.get_visible() and text.get_text().strip():
                other = text.get_window_extent(renderer)
                if (
                    f"{text.get_text()!r} at {other.x0:.0f}, {other.y0:.0f}" in texts
                    and box.overlaps(other)
                ):
                    found.append(f"a legend and {text.get_text()!r}")
        for ax in figure.axes:
            if len(drawn := drawn_points(ax)) and box.count_contains(drawn):
                found.append(f"a legend covers what is drawn in {ax.get_ylabel()!r}")
    return found
