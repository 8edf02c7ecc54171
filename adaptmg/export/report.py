"""Report: one self-contained HTML page of sections, tables and figures. It opens offline and holds nothing foreign."""

from __future__ import annotations

import base64
import io
import os
import platform
import time
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

import matplotlib.pyplot as plt
import pandas as pd
from matplotlib.figure import Figure

from adaptmg.problem import checks
from adaptmg.runtime.atomic import write_bytes
from adaptmg.runtime.text import in_html
from adaptmg.study.fingerprint import environment
from adaptmg.study.tables import as_html

__all__ = ["Report"]

#: readable tables, light or dark as the reader's system is
_STYLE = """\
:root {
  color-scheme: light dark;
  --ink: #1f2328; --soft: #59636e; --line: #d7dce2; --paper: #ffffff; --band: #f5f7f9; --link: #0061a4;
}
@media (prefers-color-scheme: dark) {
  :root { --ink: #e3e7eb; --soft: #9aa4af; --line: #3a4149; --paper: #16191d; --band: #1e2227; --link: #6cb6f2; }
}
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.55 system-ui, sans-serif; }
main { max-width: min(96vw, 100rem); margin: 0 auto; padding: 2rem 1.25rem 4rem; }
h1 { font-size: 1.9rem; line-height: 1.25; margin: 0 0 .6rem; }
h2 { font-size: 1.3rem; margin: 2.8rem 0 .6rem; padding-top: .6rem; border-top: 1px solid var(--line); }
p { max-width: 46rem; margin: .6rem 0; }
a { color: var(--link); text-decoration: none; }
a:hover { text-decoration: underline; }
nav { max-width: 44rem; background: var(--band); border-radius: 6px; padding: .7rem 1rem; margin: 1.4rem 0; }
nav ol { margin: 0; padding-left: 1.6rem; }
figure { margin: 1.5rem 0; }
figure img { max-width: min(100%, 62rem); height: auto; background: #ffffff; border-radius: 4px; }
figcaption { color: var(--soft); font-size: .92rem; max-width: 46rem; margin: .4rem 0; }
figure.table figcaption { color: var(--ink); font-weight: 600; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: .82rem; font-variant-numeric: tabular-nums; }
thead th { border-bottom: 1.5px solid var(--ink); text-align: left; vertical-align: bottom; }
th, td { padding: .25rem .55rem; white-space: nowrap; }
th.n, td.n { text-align: right; }
tbody tr:nth-child(even) { background: var(--band); }
tbody tr:last-child td { border-bottom: 1px solid var(--line); }
.note { color: var(--soft); font-size: .88rem; }
footer { margin-top: 3.5rem; padding-top: .8rem; border-top: 1px solid var(--line); color: var(--soft);
  font-size: .85rem; }
"""


class Report:
    """An HTML page in the making; what is added appears in order.

    All text is escaped; a blank line in a text begins a new paragraph.

    Parameters
    ----------
    title : str
    summary : str
        Below the title.

    Examples
    --------
    >>> page = Report("Smoothing")
    >>> page.section("Sweeps", "Two sweeps a cycle are best.")
    >>> page.table(pd.DataFrame({"sweeps": [1, 2]}), caption="Table 2. GRECO bar, rtol 1e-8.")
    """

    def __init__(self, title: str, summary: str = "") -> None:
        self.title, self.summary = _text("title", title), _text("summary", summary, empty=True)
        self._began = time.perf_counter()
        self._parts: list[str] = []
        self._sections: list[str] = []

    def section(self, title: str, text: str = "") -> None:
        """Begin a section; it is listed in the table of contents."""
        self._sections.append(_text("title", title))
        number = len(self._sections)
        self._parts.append(f'<h2 id="section-{number}">{number}. {in_html(title)}</h2>')
        self.text(text)

    def text(self, text: str) -> None:
        """Add paragraphs."""
        self._parts.extend(_paragraphs(_text("text", text, empty=True)))

    def table(self, table: pd.DataFrame, caption: str, note: str = "", *, units: Mapping[str, str] | None = None,
              formats: Mapping[str, str] | None = None) -> None:
        """Add a table.

        Parameters
        ----------
        table : pandas.DataFrame
        caption : str
            What it shows; say the grid, the norm and the tolerance.
        note : str
            Below it: sources, what differs from a reference.
        units, formats : mapping of column to str
            See :func:`adaptmg.study.tables.as_text`.
        """
        if not isinstance(table, pd.DataFrame):
            raise TypeError(f"table must be a pandas DataFrame, got {type(table).__name__}")
        self._parts.append(as_html(table, caption=_text("caption", caption), note=_text("note", note, empty=True),
                                   units=units, formats=formats))

    def figure(self, figure: Figure, caption: str) -> None:
        """Add a picture as it is now, as PNG inside the page; pyplot then forgets it (an open figure costs memory)."""
        if not isinstance(figure, Figure):
            raise TypeError(f"figure must be a matplotlib Figure, got {type(figure).__name__}")
        caption = in_html(_text("caption", caption))
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=160, bbox_inches="tight", facecolor="white")
        plt.close(figure)
        data = base64.b64encode(picture.getvalue()).decode("ascii")
        width = round(96 * figure.get_size_inches()[0])
        self._parts.append(f'<figure>\n<img src="data:image/png;base64,{data}" alt="{caption}" '
                           f'style="width:{width}px">\n<figcaption>{caption}</figcaption>\n</figure>')

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the page; the file appears complete or not at all.

        Returns
        -------
        pathlib.Path
            Where it is.
        """
        target = checks.file_path("path", path)
        write_bytes(target, self.page().encode())
        return target

    def page(self) -> str:
        """The whole page as text."""
        entries = "\n".join(f'<li><a href="#section-{k}">{in_html(name)}</a></li>'
                            for k, name in enumerate(self._sections, 1))
        contents = f"<nav>\n<ol>\n{entries}\n</ol>\n</nav>\n" if entries else ""
        summary = "\n".join(_paragraphs(self.summary))
        body = "\n".join(self._parts)
        return (f'<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
                f'<meta name="viewport" content="width=device-width, initial-scale=1">\n'
                f"<title>{in_html(self.title)}</title>\n<style>\n{_STYLE}</style>\n</head>\n<body>\n<main>\n"
                f"<h1>{in_html(self.title)}</h1>\n{summary}\n{contents}{body}\n"
                f"<footer>{in_html(self._provenance())}</footer>\n</main>\n</body>\n</html>\n")

    def _provenance(self) -> str:
        versions = ", ".join(f"{name} {version}" for name, version in environment().items())
        now = datetime.now().astimezone().isoformat(sep=" ", timespec="minutes")
        seconds = time.perf_counter() - self._began
        return (f"Written {now} in {seconds:.1f} s, with {versions}; "
                f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores.")


def _text(name: str, value: str, empty: bool = False) -> str:
    if not isinstance(value, str):
        raise TypeError(f"{name} must be a string, got {checks.shown(value)}")
    if not value and not empty:
        raise ValueError(f"{name} must not be empty")
    return value


def _paragraphs(text: str) -> list[str]:
    return [f"<p>{in_html(' '.join(part.split()))}</p>" for part in text.split("\n\n") if part.strip()]
