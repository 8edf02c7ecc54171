"""All studies, one HTML report that opens offline, with the tables as CSV and the figures as PNG beside it.

    python studies/reproduce.py [--quick] [--out DIR] [--fresh] [STUDY ...]
"""

from __future__ import annotations

import argparse
import importlib
import logging
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import front
from common import Context, Figure, Section, Table, show

if TYPE_CHECKING:
    from adaptmg.export import Report

STUDIES = ("grid_count", "smoothing_count", "full_multigrid", "dovetail", "bolted_junction", "hertz",
           "adaptive_vs_uniform", "goal_greco", "transfer_operators", "amg_comparison", "kernels")
#: run only where they are named: minutes on large grids, and campaigns of hundreds of problems
LARGE = ("benchmark", "robustness", "true_errors")
TITLE = "adaptmg: multigrid for frictional contact"
SUMMARY = "'Multigrid in Structure Assembling Problem' recomputed: its tables beside ours, and what they leave open."
TERMS = """Work unit: one pass over the matrix of the finest grid; passes on coarser grids count by their nonzeros,
inside coarse solves and in nested starts too. Direct factorisations are reported in seconds only.

True error: ||u - u_h||_A / ||u_h||_A against the exact discrete solution, found by an independent method (semismooth
Newton with direct solves).

Seconds are of this machine and this run, on one thread. The paper counts grid 1 as the finest."""


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0],
                                     epilog="example: python studies/reproduce.py --quick --out /tmp/report")
    parser.add_argument("studies", nargs="*", metavar="STUDY",
                        help=f"some of: {', '.join(STUDIES + LARGE)} (default: all but the last three)")
    parser.add_argument("--quick", action="store_true", help="smaller grids: some three minutes")
    parser.add_argument("--out", type=Path, default=Path("results"), metavar="DIR",
                        help="where report.html, CSV files, pictures and the store go (default: results)")
    parser.add_argument("--fresh", action="store_true", help="compute again what an earlier call has stored")
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.studies) - set(STUDIES + LARGE))
    if unknown:
        parser.error(f"unknown study {', '.join(unknown)}; there are {', '.join(STUDIES + LARGE)}")
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    out = arguments.out / "quick" if arguments.quick else arguments.out
    if arguments.fresh:
        (out / "studies.sqlite").unlink(missing_ok=True)
    report(Context(arguments.quick, out), arguments.studies or STUDIES)


def report(context: Context, names: tuple[str, ...] | list[str]) -> Path:
    """Run studies, show them, and write the report.

    Returns
    -------
    Path
        Of the HTML file.
    """
    sections = {}
    for number, name in enumerate(names, start=1):
        print(f"[{number}/{len(names)}] {name} ...", file=sys.stderr, flush=True)
        begin = time.perf_counter()
        sections[name] = importlib.import_module(name).run(context)
        show(sections[name], context.out)
        print(f"[{number}/{len(names)}] {name}: {time.perf_counter() - begin:.1f} s", file=sys.stderr, flush=True)
    target = page_of(sections, context.quick).write(context.out / "report.html")
    print(f"\nreport: {target}")
    return target


def page_of(sections: Mapping[str, Section], quick: bool) -> Report:
    """The report of what studies returned, by their names: first screen, a section each, how it was made."""
    from adaptmg.export import Report

    page = Report(TITLE, SUMMARY + " This is a quick run, on smaller grids." * quick, terms=TERMS)
    for name, line in front.headlines(sections).items():
        place = front.PLACES[name]
        if isinstance(line, str):
            page.card(place.title, line, to=place.study)
        elif isinstance(line.item, Table):
            page.card(place.title, line.text, to=place.study, table=line.item.frame, units=line.item.units,
                      formats=line.item.formats)
        else:
            page.card(place.title, line.text, to=place.study, figure=line.item.figure)
    for name, section in sections.items():
        page.section(section.title, section.text, summary=section.summary, key=name)
        for item in in_sight_first(section.items):
            add(page, item)
    seeds = "; ".join(f"{name}: {section.seeds}" for name, section in sections.items() if section.seeds)
    page.made(commit=commit(), seeds=seeds or "no study of this run draws random numbers", command=" ".join(
        ["python studies/reproduce.py", *["--quick"] * quick, *([] if tuple(sections) == STUDIES else sections)]))
    return page


def commit() -> str:
    """Of the source, and whether it was changed since; unknown outside a repository."""
    try:
        return subprocess.run(["git", "describe", "--always", "--dirty"], cwd=Path(__file__).parent, check=True,
                              capture_output=True, text=True, timeout=10).stdout.strip() or "unknown"
    except (OSError, subprocess.SubprocessError):
        return "unknown"


def in_sight_first(items: Sequence[Table | Figure]) -> list[Table | Figure]:
    """Tables that stand open, then the figures side by side, then the tables that are folded."""
    tables = [item for item in items if isinstance(item, Table)]
    opened = [item for item in tables if item.open] or [item for item in tables[:1] if item.open is None]
    figures = [item for item in items if isinstance(item, Figure)]
    return [*opened, *figures, *(item for item in tables if not any(item is one for one in opened))]


def add(page: Report, item: Table | Figure) -> None:
    """A table or figure of a section."""
    if isinstance(item, Table):
        page.table(item.frame, caption=item.caption, note=item.note, units=item.units, formats=item.formats,
                   open=item.open, csv=f"{item.name}.csv")
    else:
        page.figure(item.figure, caption=item.caption)


if __name__ == "__main__":
    main()
