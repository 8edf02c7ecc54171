"""Shared parts of the studies: problems, exact discrete solutions, and the output of tables, figures
and checked numbers.

A study is a script with a function ``study(out)``: it computes with :class:`adaptmg.Study` into
``out.store`` and makes its tables and figures from what is stored. The first line of its docstring
is its question; the paragraphs after the command line say what is compared. :func:`main` runs it
alone, ``reproduce.py`` runs all and makes the report."""

from __future__ import annotations

import argparse
import base64
import io
import json
import logging
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

# seconds are those of one thread: threads that wait for each other in short dot products cost more
# than they gain
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import matplotlib

matplotlib.use("Agg")

import numpy as np
import pandas as pd
import psutil
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from PIL import Image

import adaptmg as am
from adaptmg._files import make_folder, write_bytes
from adaptmg.export.report import picture_of, small_png
from adaptmg.study.tables import as_text

PAPER = Path(__file__).resolve().parent.parent / "data" / "paper"
#: a quick study is judged by no seconds, and records none: it takes those of its only run
QUICK = "--quick" in sys.argv

PROBLEMS: Mapping[str, Callable[[], am.ContactProblem]] = {
    "frictionless bar": lambda: am.cases.greco_bar(law=am.Frictionless()),
    "GRECO bar": lambda: am.cases.greco_bar(law=am.Coulomb(1.0)),
    "curved obstacle": lambda: am.cases.curved_obstacle(),
}


class Output:
    """The output of one study: CSV files, pictures, and ``section.json`` for the report.

    Parameters
    ----------
    name : str
        Name of the study's script.
    folder : Path
        Folder of all studies; this one writes into ``folder/name``.
    quick : bool
        Smaller grids, seconds instead of minutes.
    full : bool
        Larger grids than the default.
    """

    def __init__(self, name: str, folder: Path, quick: bool = False, full: bool = False) -> None:
        self.name, self.quick, self.full = name, quick, full
        self.folder = folder / name
        make_folder("--out", self.folder)
        #: where :class:`adaptmg.Study` keeps its runs
        self.store = self.folder / ("quick.sqlite" if quick else "runs.sqlite")
        self.items: list[dict[str, Any]] = []
        self.failed: list[str] = []
        self._begin = time.perf_counter()

    def table(
        self,
        name: str,
        frame: pd.DataFrame,
        caption: str,
        note: str = "",
        *,
        card: str = "",
        units: Mapping[str, str] | None = None,
        formats: Mapping[str, str] | None = None,
        readme: bool = False,
    ) -> None:
        """Print a table and write it as CSV; ``card`` puts it on the report's first screen, with
        ``note`` below. ``reproduce.py --record`` writes it into data/measured if it has a card, and
        also into the README if ``readme``."""
        write_bytes(self.folder / f"{name}.csv", frame.to_csv(index=False).encode())
        print("\n" + as_text(frame, caption=caption, note=note, units=units, formats=formats))
        self.items.append(
            {
                "kind": "table",
                "name": name,
                "caption": caption,
                "note": note,
                "units": dict(units or {}),
                "formats": dict(formats or {}),
                "card": card,
                "readme": readme,
            }
        )

    def figure(self, name: str, figure: Figure, caption: str, *, card: str = "") -> None:
        """Write a figure as PNG; ``card`` puts it on the report's first screen."""
        target = self.folder / f"{name}.png"
        write_bytes(target, small_png(figure))
        picture = picture_of(figure, caption)
        print(f"\n[figure {target}] {caption}")
        self.items.append(
            {
                "kind": "figure",
                "name": name,
                "caption": caption,
                "source": picture.source,
                "width": picture.width,
                "card": card,
            }
        )

    def animation(
        self, name: str, frames: Iterable[Figure], caption: str, milliseconds: int = 80
    ) -> None:
        """Write the states of a figure that ``frames`` yields as a GIF that repeats."""
        images = []
        for figure in frames:
            small = io.BytesIO()
            figure.savefig(small, format="png", dpi=80, facecolor="white")
            images.append(Image.open(small).convert("RGB").quantize(64))
            width = 96 * figure.get_size_inches()[0]
        gif = io.BytesIO()
        images[0].save(
            gif, "gif", save_all=True, append_images=images[1:], duration=milliseconds, loop=0
        )
        target = self.folder / f"{name}.gif"
        write_bytes(target, gif.getvalue())
        print(f"\n[animation {target}] {caption}")
        source = f"data:image/gif;base64,{base64.b64encode(gif.getvalue()).decode()}"
        self.items.append(
            {
                "kind": "figure",
                "name": name,
                "caption": caption,
                "source": source,
                "width": round(width),
                "card": "",
            }
        )

    def check(
        self, sentence: str, value: float, low: float = -np.inf, high: float = np.inf
    ) -> None:
        """Compare a number of this run with its bounds; the study fails where it lies outside."""
        met = bool(low <= value <= high)
        bounds = " and ".join(
            f"{word} {bound:g}"
            for word, bound in (("at least", low), ("at most", high))
            if np.isfinite(bound)
        )
        text = f"{sentence}: {value:.3g} ({bounds}{'' if met else '; NOT MET'})"
        print(f"\n{'checked' if met else 'FAILED'}: {text}")
        self.items.append({"kind": "check", "text": text, "met": met})
        self.failed += [] if met else [text]

    def number(self, what: str, measured: str) -> None:
        """Add a row to the table of measured numbers, which ``reproduce.py --record`` writes for
        the README."""
        print(f"\n{what}: {measured}")
        self.items.append({"kind": "number", "what": what, "measured": measured})

    def close(self, docstring: str) -> None:
        """Write the section for the report."""
        title, text = question_and_text(docstring)
        section = {
            "title": title,
            "text": text,
            "items": self.items,
            "seconds": time.perf_counter() - self._begin,
        }
        write_bytes(self.folder / "section.json", json.dumps(section, indent=1).encode())


def question_and_text(docstring: str) -> tuple[str, str]:
    """The first line of a study's docstring, and its paragraphs after the indented command
    lines."""
    first, *others = docstring.strip().split("\n\n")
    return first, "\n\n".join(
        " ".join(part.split()) for part in others if not part.startswith("    ")
    )


def main(study: Callable[[Output], None]) -> None:
    """Run the study of a script from the command line; exit code 1 if its checked number is outside
    its bounds."""
    script, docstring = Path(sys.argv[0]), sys.modules[study.__module__].__doc__ or ""
    parser = argparse.ArgumentParser(
        description=question_and_text(docstring)[0],
        epilog=f"example: python studies/{script.name} --quick --out /tmp/results",
    )
    size = parser.add_mutually_exclusive_group()
    size.add_argument(
        "--quick", action="store_true", help="smaller grids, seconds instead of minutes"
    )
    size.add_argument("--full", action="store_true", help="larger grids than the default; minutes")
    parser.add_argument(
        "--out", type=Path, default=Path("results"), metavar="DIR", help="default: results"
    )
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.WARNING, format="%(message)s")
    try:
        out = Output(script.stem, arguments.out, arguments.quick, arguments.full)
        study(out)
        out.close(docstring)
    except OSError as error:
        raise SystemExit(f"{script.name}: {error}") from error
    if out.failed:
        raise SystemExit(f"{script.name}: not met: {'; '.join(out.failed)}")


@lru_cache(maxsize=32)
def grids(problem: str, divisions: tuple[int, ...]) -> am.Hierarchy:
    """Uniform nested grids of a problem by name."""
    return am.Hierarchy.uniform(PROBLEMS[problem](), divisions=divisions)


def chain(finest: int, levels: int) -> tuple[int, ...]:
    """Divisions of nested grids, halved from the finest, coarsest first."""
    return tuple(finest // 2**k for k in reversed(range(levels)))


@lru_cache(maxsize=32)
def exact(problem: str, divisions: int) -> am.Result:
    """The exact discrete solution by an independent method: semismooth Newton with direct solves,
    residual 1e-12."""
    levels = next(n for n in range(1, 9) if divisions % 2**n or divisions // 2**n < 4)
    return am.solve(
        grids(problem, chain(divisions, levels)), am.ActiveSet(rtol=1e-12, nested_start=True)
    )


@lru_cache(maxsize=4)
def warm_up(dim: int = 2) -> None:
    """Compile and load all that meshing and solving need, so that no measured second is one of the
    compiler."""
    case = am.cases.greco_bar if dim == 2 else am.cases.greco_block
    for law in (am.Coulomb(1.0), am.Frictionless()):
        hierarchy = am.Hierarchy.graded(
            case(law=law), (20e-3, 10e-3) if dim == 2 else (40e-3, 20e-3), contact_ratio=2
        )
        for solver in (
            am.FullMultigrid(),
            am.FullMultigrid(correction=am.Monotone()),
            am.ActiveSet(linear=am.AMG()),
        ):
            am.solve(hierarchy, solver, throw=False)


def processor_time() -> float:
    """Processor seconds so far of this process and of those it has started, such as Netgen's."""
    others = [process.cpu_times() for process in psutil.Process().children(recursive=True)]
    return time.process_time() + sum(times.user + times.system for times in others)


def cpu(call: Callable[[], Any], times: int = 1 if QUICK else 3, seconds: float = 0.5) -> float:
    """Least processor time of up to ``times`` calls, as long as together they take no more than
    ``seconds``."""
    spent: list[float] = []
    while not spent or (len(spent) < times and sum(spent) < seconds):
        begin = time.process_time()
        call()
        spent.append(time.process_time() - begin)
    return min(spent)


def timed(hierarchy: am.Hierarchy, solver: Any, **options: Any) -> tuple[am.Result, float]:
    """The result of a run with options, and the processor seconds of further ones without: kernels
    are warm then. The active set method gets new matrices, so that it factorises, which it would
    not do twice."""
    begin = time.process_time()
    result = am.solve(hierarchy, solver, throw=False, **options)
    if QUICK:
        return result, time.process_time() - begin
    spent = []
    while not spent or (len(spent) < 2 and sum(spent) < 0.5):
        if isinstance(solver, am.ActiveSet):
            hierarchy = am.Hierarchy.from_meshes(
                hierarchy.problem,
                [am.mesh.need_mesh(level) for level in hierarchy],
                hierarchy.transfer,
                hierarchy.contact_rows,
            )
        spent.append(cpu(partial(am.solve, hierarchy, solver, throw=False), times=1))
    return result, min(spent)


def drawing(height: float = 3.2, width: float = 11.4) -> tuple[Figure, Axes]:
    """A figure with room for a legend outside; as wide as the page (7.2 inches: with one next to
    it; 4.6: a card)."""
    return plt.subplots(figsize=(width, height), layout="constrained")


def measured(
    hierarchy: am.Hierarchy, solver: Any, reference: am.Result, error: float
) -> dict[str, Any]:
    """Cycles of a run, its work to a true error, its processor seconds and how it ended."""
    result, seconds = timed(hierarchy, solver, reference=reference)
    return {
        "nodes": hierarchy.finest.n_nodes,
        "cycles": result.cycles,
        "work": result.work_to(error, of="true_error"),
        "total_work": result.work_units,
        "solve_seconds": seconds,
        "final_error": result.history["true_error"][-1],
        "outcome": result.status.name + ", by active set" * bool(result.fallback),
    }


def gain(seconds: float, work: float = np.nan) -> str:
    """A speed-up in seconds and, where the work is known, in work."""
    return f"{seconds:.1f}" + f" / {work:.1f}" * bool(np.isfinite(work))


def compare(
    out: Output,
    run: Callable[..., dict[str, Any]],
    methods: Sequence[str],
    counts: Sequence[int],
    caption: str,
    **fixed: Any,
) -> pd.DataFrame:
    """Compute methods on ``counts`` grids (those of one grid on one), and print cycles, work and
    seconds."""
    points = [
        {"method": name, "levels": n}
        for name in methods
        for n in ([1] if name.startswith(("one", "active")) else counts)
    ]
    table = am.Study(run, points, out.store, fixed=fixed).run(throw=True)
    table = table[
        ["method", "levels", "nodes", "cycles", "work", "solve_seconds", "final_error", "outcome"]
    ]
    # the work of factorisations cannot be compared
    table.loc[table["method"].str.contains("condensed|active"), "work"] = np.nan
    table = table.rename(columns={"levels": "grids", "solve_seconds": "seconds"})
    first = table.iloc[table["seconds"].argmin()]
    n = first["grids"]
    out.table(
        "methods",
        table,
        caption,
        f"Quickest in this run: {first['method']}{f' on {n} grids' * int(n > 1)}, "
        f"{first['seconds']:.3f} s. Work is left out where a factorisation replaces it.",
        units={"work": "WU", "seconds": "s"},
        formats={"work": ".1f", "seconds": ".3f", "final_error": ".0e"},
    )
    return table


def slope(x: ArrayLike, y: ArrayLike) -> float:
    """Exponent of y ~ x^slope, fitted by least squares to the logarithms."""
    return float(
        np.polyfit(np.log(np.asarray(x, dtype=float)), np.log(np.asarray(y, dtype=float)), 1)[0]
    )


def paper(name: str) -> pd.DataFrame:
    """A table of the paper, from data/paper."""
    return pd.read_csv(PAPER / f"{name}.csv", comment="#")
