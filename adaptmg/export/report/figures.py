"""Pictures of a report: drawings as SVG inside the page, dense ones (meshes, surfaces) as PNG of 256 colours."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass

import matplotlib
import matplotlib.pyplot as plt
from matplotlib.figure import Figure
from PIL import Image

from adaptmg.export.report.prose import given_text, marked_up, one_line
from adaptmg.export.report.svg import inline_svg
from adaptmg.runtime.text import in_html, printable

__all__ = ["DENSE", "Picture", "picture_of", "small_png"]

#: an SVG of more characters becomes a PNG, unless that is larger
DENSE = 60_000
#: bytes of an SVG that is not looked at further
_HOPELESS = 12 * DENSE
#: pixels of a PNG across at most
_ACROSS = 1200


@dataclass(frozen=True)
class Picture:
    """A picture as HTML, its caption, and the width in CSS pixels that it takes where there is room."""

    html: str
    caption: str
    width: int

    def block(self) -> str:
        """As ``<figure>`` with its caption."""
        return (f'<figure style="--w:{self.width}px">\n<div class="paper">{self.html}</div>\n'
                f"<figcaption>{marked_up(self.caption)}</figcaption>\n</figure>")


def picture_of(figure: Figure, caption: str, prefix: str) -> Picture:
    """A figure as it is now; pyplot then forgets it (an open figure costs memory).

    Parameters
    ----------
    figure : matplotlib.figure.Figure
    caption : str
        What it shows; also read out to who cannot see it.
    prefix : str
        Of all identifiers in it, other than that of any other picture of the page.
    """
    if not isinstance(figure, Figure):
        raise TypeError(f"figure must be a matplotlib Figure, got {type(figure).__name__}")
    label = one_line(given_text("caption", caption))
    width = round(96 * figure.get_size_inches()[0])
    _lay_out_once(figure)
    drawn = _drawing(figure, prefix, label)
    if drawn is None or len(drawn) > DENSE:
        png = small_png(figure, min(150.0, _ACROSS / figure.get_size_inches()[0]))
        if drawn is None or 4 * len(png) / 3 < len(drawn):
            data = base64.b64encode(png).decode("ascii")
            drawn = f'<img src="data:image/png;base64,{data}" alt="{in_html(label)}">'
    plt.close(figure)
    return Picture(drawn, caption, width)


def _lay_out_once(figure: Figure) -> None:
    """Fix where axes stand: a layout engine would find that anew each of the several times a figure is drawn."""
    if figure.get_layout_engine() is not None:
        figure.draw_without_rendering()
        figure.set_layout_engine("none")


def small_png(figure: Figure, dpi: float = 130) -> bytes:
    """A figure as PNG with 256 colours."""
    buffer, small = io.BytesIO(), io.BytesIO()
    figure.savefig(buffer, format="png", dpi=dpi, bbox_inches="tight", facecolor="white")
    Image.open(buffer).convert("RGB").quantize(256).save(small, format="png", optimize=True)
    return small.getvalue()


def _drawing(figure: Figure, prefix: str, label: str) -> str | None:
    """As SVG; None where that is far too large."""
    buffer = io.BytesIO()
    # letters stay letters; the salt makes identifiers the same from run to run
    with matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": "adaptmg", "path.simplify": True,
                                "path.simplify_threshold": 0.25}):
        figure.savefig(buffer, format="svg", bbox_inches="tight", facecolor="white",
                       metadata={"Date": None, "Creator": None})
    if buffer.tell() > _HOPELESS:
        return None
    return inline_svg(printable(buffer.getvalue().decode()), prefix, printable(label))
