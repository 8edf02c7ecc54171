"""All studies, one HTML report that opens offline, with the tables as CSV next to it.

    python studies/reproduce.py [--quick | --full] [--workers N] [--out DIR] [--fresh] [--pictures] [STUDY ...]
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

# what takes seconds to import is imported where it is needed: the first line comes in the first second
if TYPE_CHECKING:
    from common import Context, Figure, Section, Table

    from adaptmg.export import Report
    from adaptmg.export.report import Picture

STUDIES = ("grid_count", "smoothing_count", "full_multigrid", "dovetail", "bolted_junction", "adaptive_vs_uniform",
           "transfer_operators", "amg_comparison")
#: only with --full, or where they are named: minutes on large grids, and campaigns of hundreds of problems
LARGE = ("hertz", "estimator_effectivity", "goal_greco", "kernels", "benchmark", "robustness", "true_errors",
         "adaptive_campaign")
TITLE = "adaptmg: multigrid for frictional contact"
SUMMARY = "'Multigrid in Structure Assembling Problem' recomputed: its tables next to ours, and what they leave open."
TERMS = """Work unit: one pass over the matrix of the finest grid; passes on coarser grids count by their nonzeros,
inside coarse solves and in nested starts too. It counts matrix read, not operations: a pass of the default method's
half sweeps uses each entry twice, a sweep of the other methods once. Direct factorisations are reported in seconds
only.

True error: ||u - u_h||_A / ||u_h||_A against the exact discrete solution, found by an independent method (semismooth
Newton with direct solves).

Natural residual: how far the contact and friction conditions and equilibrium are from met, relative to loads, contact
forces and reactions. CONVERGED: the estimated error is below the tolerance and the residual below ten times that.
LIMIT: cycles or sweeps ran out before. STALLED: the iteration no longer changes though the residual is above.

Seconds are of this machine and this run, on one thread. Those of adaptive meshes, of building transfers and of
algebraic multigrid were measured alone; elsewhere other runs may have gone on at the same time, so that they are
rough. The paper counts grid 1 as the finest."""


def main() -> None:
    """Command line."""
    arguments = _parser().parse_args()
    unknown = sorted(set(arguments.studies) - set(STUDIES + LARGE))
    if unknown:
        raise SystemExit(f"reproduce.py: unknown study {', '.join(unknown)}; there are {', '.join(STUDIES + LARGE)}")
    out = arguments.out / "quick" if arguments.quick else arguments.out
    names = arguments.studies or (STUDIES + LARGE if arguments.full else STUDIES)
    print(f"{len(names)} {'studies' if len(names) > 1 else 'study'} on {max(arguments.workers, 1)} "
          f"{'processes' if arguments.workers > 1 else 'process'}, to {out / 'report.html'}: {', '.join(names)}",
          file=sys.stderr, flush=True)
    from common import Context

    if arguments.fresh:
        (out / "studies.sqlite").unlink(missing_ok=True)
    failed = report(Context(arguments.quick, out, arguments.full), names, arguments.workers, arguments.pictures)
    if failed:
        raise SystemExit(f"reproduce.py: failed: {', '.join(failed)} (the report says why; called again, it goes on)")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0],
                                     epilog="example: python studies/reproduce.py --quick --out /tmp/report")
    parser.add_argument("studies", nargs="*", metavar="STUDY",
                        help=f"some of: {', '.join(STUDIES)} (default: these), {', '.join(LARGE)} (with --full)")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--quick", action="store_true",
                      help="smaller grids: a minute on two cores, once kernels are compiled")
    size.add_argument("--full", action="store_true", help="beyond the paper: fine references, histories, campaigns")
    parser.add_argument("--workers", type=_workers, default=cores(), metavar="N",
                        help="processes that compute; 0 or 1: this one alone (default: one a core, here %(default)s)")
    parser.add_argument("--out", type=Path, default=Path("results"), metavar="DIR",
                        help="where report.html, CSV files, pictures and the store go (default: results)")
    parser.add_argument("--pictures", action="store_true", help="write the figures as PNG too")
    parser.add_argument("--fresh", action="store_true", help="compute again what an earlier call has stored")
    return parser


def _workers(text: str) -> int:
    if not text.isascii() or not text.isdigit():
        raise argparse.ArgumentTypeError(f"a whole number, 0 or more, not {text!r}")
    return int(text)


def cores() -> int:
    """That this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def report(context: Context, names: Sequence[str], workers: int, pictures: bool = False) -> list[str]:
    """Run studies, write the tables of each as it is done and say so in a line, and write the report."""
    import together
    from common import write
    from watching import Watching

    begin, sections, drawn = time.perf_counter(), {}, {}

    def done(name: str, section: Section, made: dict[str, Picture], seconds: float) -> None:
        sections[name] = section
        drawn.update(made)
        write(section, context.out, pictures)
        watching.study_ended(name, seconds)

    watching = Watching(len(names))
    if workers > 1:
        with watching:
            failed = together.at_once(context, names, done, workers, watching.run_ended)
    else:
        failed = together.in_turn(context, names, done)
    page = page_of({name: sections[name] for name in names}, context, drawn)
    target = page.write(context.out / "report.html")
    print(f"report: {target}")
    print(f"all done after {time.perf_counter() - begin:.0f} s", file=sys.stderr)
    return failed


def page_of(sections: Mapping[str, Section], context: Context, drawn: Mapping[str, Picture] | None = None) -> Report:
    """The report of what studies returned, by their names: first screen, a section each, how it was made."""
    import front
    from common import Table

    from adaptmg.export import Report

    page = Report(TITLE, SUMMARY + " This is a quick run, on smaller grids." * context.quick, terms=TERMS)
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
            add(page, item, drawn or {})
    seeds = "; ".join(f"{name}: {section.seeds}" for name, section in sections.items() if section.seeds)
    page.made(commit=commit(), seeds=seeds or "no study of this run draws random numbers", command=" ".join(
        ["python studies/reproduce.py", *["--quick"] * context.quick, *["--full"] * context.full,
         *([] if tuple(sections) in (STUDIES, STUDIES + LARGE) else sections)]))
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
    from common import Figure, Table

    tables = [item for item in items if isinstance(item, Table)]
    opened = [item for item in tables if item.open] or [item for item in tables[:1] if item.open is None]
    figures = [item for item in items if isinstance(item, Figure)]
    return [*opened, *figures, *(item for item in tables if not any(item is one for one in opened))]


def add(page: Report, item: Table | Figure, drawn: Mapping[str, Picture]) -> None:
    """A table or figure of a section."""
    from common import Table

    if isinstance(item, Table):
        page.table(item.frame, caption=item.caption, note=item.note, units=item.units, formats=item.formats,
                   open=item.open, csv=f"{item.name}.csv")
    else:
        page.figure(drawn.get(item.name, item.figure), caption=item.caption)


if __name__ == "__main__":
    main()
