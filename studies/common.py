"""What every study shares: problems, exact discrete solutions, work at equal true error, output.

A study is a module with ``run(context) -> Section``. Computation goes through :class:`adaptmg.Study` into the store of
the context; tables and figures are made from what is stored.
"""

from __future__ import annotations

import argparse
import logging
import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

# seconds are those of one thread: threads that wait for each other in short dot products cost more than they gain
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import matplotlib

matplotlib.use("Agg")

import numpy as np
import pandas as pd
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

import adaptmg as am
from adaptmg._files import make_folder, write_bytes
from adaptmg.export.report import small_png
from adaptmg.mesh import refine_near, structured

# sections that are made at the same time hold their figures until they are drawn
matplotlib.rcParams["figure.max_open_warning"] = 0

DATA = Path(__file__).resolve().parent.parent / "data" / "paper"

PROBLEMS: Mapping[str, Callable[[], am.ContactProblem]] = {
    "frictionless bar": lambda: am.cases.greco_bar(law=am.Frictionless()),
    "curved obstacle": lambda: am.cases.curved_obstacle(),
    "Coulomb bar": lambda: am.cases.greco_bar(law=am.Coulomb(1.0)),
}


def plain_powers(text: str) -> str:
    """Python's 1e-06 as 1e-6."""
    return re.sub(r"(?<=\de)([+-])0(?=\d\b)", r"\1", text)


class _Worded:
    """Something with texts."""

    def __post_init__(self) -> None:
        for name in ("caption", "note", "text", "summary"):
            if hasattr(self, name):
                setattr(self, name, plain_powers(getattr(self, name)))


@dataclass
class Table(_Worded):
    """A table of a study: what is printed, written as CSV and put into the report.

    ``open`` says whether it stands open in the report; None: the first table of a section does.
    """

    name: str
    frame: pd.DataFrame
    caption: str
    note: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    formats: Mapping[str, str] = field(default_factory=dict)
    open: bool | None = None


@dataclass
class Figure(_Worded):
    """A figure of a study."""

    name: str
    figure: Any
    caption: str


@dataclass
class Headline(_Worded):
    """What a study has to say on the first screen of the report, at a place that :data:`front.PLACES` names.

    ``item`` is a small table (five rows, five columns) or a figure of some 5.6 x 2.5 inches, ``text`` a sentence or
    two.
    """

    place: str
    item: Table | Figure
    text: str


@dataclass
class Section(_Worded):
    """What a study returns.

    ``summary`` says what was asked, what came out and why it differs from the paper, in few sentences; ``text`` has
    the reasons, most of it folded. ``seeds`` names the random numbers, if any.
    """

    title: str
    text: str
    items: list[Table | Figure] = field(default_factory=list)
    summary: str = ""
    headline: list[Headline] = field(default_factory=list)
    seeds: str = ""


def in_this_process(study: am.Study, timed: bool) -> pd.DataFrame:
    """The rows of a study, run after run."""
    return study.run(throw=True)


def with_texts(study: am.Study, table: pd.DataFrame) -> pd.DataFrame:
    """The table with the long texts themselves, which the store keeps as files."""
    for name in table.columns.difference(study.parameters):
        kept = [isinstance(value, str) and value.endswith(".txt") for value in table[name]]
        if any(kept):
            table[name] = [study.load(k, name) if long else value
                           for k, (value, long) in enumerate(zip(table[name], kept, strict=True))]
    return table


@dataclass
class Context:
    """How a study is to run.

    Attributes
    ----------
    quick : bool
        Smaller grids, seconds instead of minutes.
    out : Path
        Directory of CSV files, pictures and the store.
    full : bool
        More than the paper asks: fine references, histories, campaigns.
    compute : callable
        Gives the rows of a study, told whether its runs are timed; :mod:`together` has one for a cluster.
    alone : callable
        A context manager for what is measured without a study: entered when nothing else computes.
    """

    quick: bool
    out: Path
    full: bool = False
    compute: Callable[[am.Study, bool], pd.DataFrame] = in_this_process
    alone: Callable[[], AbstractContextManager[None]] = nullcontext

    def study(self, run: Callable[..., dict[str, Any]], parameters: Mapping[str, Sequence[Any]], *,
              timed: bool = False, **fixed: Any) -> pd.DataFrame:
        """Run a parameter study through the store of this context; rows that are stored are not computed again."""
        make_folder("--out", self.out)
        study = am.Study(run, parameters, self.out / "studies.sqlite", fixed=fixed,
                         name=f"{Path(run.__code__.co_filename).stem}.{run.__name__}")
        return with_texts(study, self.compute(study, timed))


@lru_cache(maxsize=32)
def grids(problem: str, divisions: tuple[int, ...]) -> am.Hierarchy:
    """Uniform nested grids of a problem by name."""
    return am.Hierarchy.uniform(PROBLEMS[problem](), divisions=divisions)


@lru_cache(maxsize=32)
def exact(problem: str, divisions: int) -> am.Result:
    """The exact discrete solution by an independent method: semismooth Newton with direct solves, residual 1e-12."""
    hierarchy = grids(problem, _nested_below(divisions))
    return am.solve(hierarchy, am.ActiveSet(rtol=1e-12, nested_start=True))


def _nested_below(divisions: int) -> tuple[int, ...]:
    chain = [divisions]
    while chain[0] % 2 == 0 and chain[0] > 4:
        chain.insert(0, chain[0] // 2)
    return tuple(chain)


def energy_error(result: am.Result, reference: am.Result, hierarchy: am.Hierarchy) -> float:
    """||u - u_h||_A / ||u_h||_A."""
    discrete = hierarchy.finest.discrete
    matrix = discrete.matrix
    # between bodies the matrix is that of relative coordinates
    error = discrete.relative(result.displacement - reference.displacement).reshape(-1)
    u = discrete.relative(reference.displacement).reshape(-1)
    return float(np.sqrt(error @ (matrix @ error) / (u @ (matrix @ u))))


def first_below(result: am.Result, tolerance: float) -> dict[str, float]:
    """Cycles, work units and seconds when the true error first fell below a tolerance."""
    error = result.history["true_error"]
    below = np.flatnonzero(error <= tolerance)
    names = ("cycle", "work_units", "seconds")
    if not below.size:
        return dict.fromkeys(names, float("nan"))
    k = int(below[0])
    share = 1.0
    if k > 0 and error[k] > 0:
        share = np.log(error[k - 1] / tolerance) / np.log(error[k - 1] / error[k])
    return {name: float(result.history[name][k] if k == 0 else
                        (1 - share) * result.history[name][k - 1] + share * result.history[name][k])
            for name in names}


@lru_cache(maxsize=4)
def warm_up(dim: int = 2) -> None:
    """Compile and load all that meshing and solving need, so that no measured second is one of the compiler."""
    if dim == 2:
        refine_near(structured(am.cases.greco_bar().domain, 2), "bottom")
        hierarchy = am.Hierarchy.graded(am.cases.greco_bar(), (20e-3, 10e-3), contact_ratio=2)
    else:
        hierarchy = am.Hierarchy.graded(am.cases.greco_block(), (40e-3, 20e-3))
    for solver in (am.FullMultigrid(), am.FullMultigrid(correction=am.Monotone()), am.ActiveSet(),
                   am.ActiveSet(linear=am.AMG())):
        am.solve(hierarchy, solver, throw=False)


def seconds_by_phase(hierarchy: am.Hierarchy, result: am.Result) -> dict[str, float]:
    """Seconds of meshing, assembly, transfer, the solver's set-up (factorisations too) and its solve, and their sum."""
    setup = sum(result.timings.get(name, 0.0) for name in ("setup", "factorise"))
    phases = {f"{name}_s": hierarchy.timings.get(name, 0.0) for name in ("mesh", "assembly", "transfer")}
    phases |= {"setup_s": setup, "solve_s": result.seconds - setup}
    return phases | {"total_s": sum(phases.values())}


def quickest(hierarchy: am.Hierarchy, solver: Any, seconds: float = 0.5, times: int = 3) -> am.Result:
    """Solve up to ``times`` times, as long as that takes no more than ``seconds``, and keep the quickest run."""
    results = [am.solve(hierarchy, solver, throw=False)]
    while len(results) < times and sum(r.seconds for r in results) < seconds:
        results.append(am.solve(hierarchy, solver, throw=False))
    return min(results, key=lambda result: result.seconds)


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Exponent of y ~ x^slope, fitted by least squares to the logarithms; NaN of fewer than three points."""
    if len(x) < 3:
        return float("nan")
    return float(np.polyfit(np.log(np.asarray(x, dtype=float)), np.log(np.asarray(y, dtype=float)), 1)[0])


def plain_ticks(*axes: Any) -> None:
    """Label logarithmic axes (``ax.xaxis``, ...) without exponents, as many as there is room for."""
    for axis in axes:
        low, high = axis.get_view_interval()
        span = high / low if low > 0 else 1.0
        subs = (1.0, 2.0, 5.0) if span <= 30 else (1.0, 3.0) if span <= 300 else (1.0,)
        axis.set_major_locator(LogLocator(subs=subs))
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())


def paper(name: str) -> pd.DataFrame:
    """A table of the paper, from data/paper."""
    return pd.read_csv(DATA / f"{name}.csv", comment="#")


def write_picture(figure: Any, path: Path, dpi: int = 130) -> None:
    """Write a figure as PNG with 256 colours, whole or not at all."""
    make_folder("--out", path.parent)
    write_bytes(path, small_png(figure, dpi))


def write(section: Section, out: Path, pictures: bool = True) -> None:
    """Write a section's tables as CSV, and the figures as PNG if they are wanted."""
    make_folder("--out", out)
    for item in section.items:
        if isinstance(item, Table):
            text = item.frame.to_csv(index=False)
            write_bytes(out / f"{item.name}.csv", text.encode("utf-8", "backslashreplace"))
        elif pictures:
            write_picture(item.figure, out / f"{item.name}.png")


def show(section: Section, out: Path, pictures: bool = True) -> None:
    """Print a section's tables, and :func:`write` it."""
    from adaptmg.study.tables import as_text

    write(section, out, pictures)
    said = "\n\n".join(text for text in (section.summary, section.text) if text)
    print(f"\n{section.title}\n{'=' * len(section.title)}\n{said}")
    for item in section.items:
        if isinstance(item, Table):
            print("\n" + as_text(item.frame, caption=item.caption, note=item.note, units=item.units,
                                 formats=item.formats))
        elif pictures:
            print(f"\n[figure {out / f'{item.name}.png'}] {item.caption}")


def main(run: Callable[[Context], Section], description: str) -> None:
    """Command line of a study script."""
    parser = argparse.ArgumentParser(description=description)
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true", help="smaller grids, seconds instead of minutes")
    size.add_argument("--full", action="store_true", help="more than the paper asks; minutes")
    parser.add_argument("--out", type=Path, default=Path("results"), metavar="DIR",
                        help="where CSV files, pictures and the store go (default: results)")
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        show(run(Context(arguments.quick, arguments.out, arguments.full)), arguments.out)
    except OSError as error:
        raise SystemExit(f"{parser.prog}: {error}") from error
