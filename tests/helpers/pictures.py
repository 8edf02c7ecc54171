"""The texts of a picture."""

import io
import re
import warnings

import matplotlib.pyplot as plt
from matplotlib.figure import Figure


def words(figure: Figure) -> str:
    """All texts of a figure, which the package has drawn."""
    return "\n".join(t.get_text() for t in figure.findobj(plt.Text) if t.get_text())


def texts(figure: Figure) -> list[str]:
    """The texts as they are seen: without the signs that delimit math, and without escapes; a
    legend that drops an entry fails."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.savefig(io.BytesIO(), format="png", dpi=30)
    shown = [text._preprocess_math(text.get_text()) for text in figure.findobj(plt.Text)]
    return [
        re.sub(r"(?<!\\)\$", "", text).replace(r"\$", "$") if math else text for text, math in shown
    ]
