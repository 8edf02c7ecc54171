"""All studies, one HTML report that opens offline, with the tables as CSV and the figures as PNG beside it.

    python studies/reproduce.py [--quick] [--out DIR] [--fresh] [STUDY ...]
"""

from __future__ import annotations

import argparse
import importlib
import logging
import sys
import time
from pathlib import Path

from common import Context, Section, Table, show

STUDIES = ("grid_count", "smoothing_count", "full_multigrid", "dovetail", "bolted_junction", "hertz",
           "adaptive_vs_uniform", "goal_greco", "estimator_effectivity", "transfer_operators",
           "amg_comparison", "kernels")
#: run only where they are named: minutes on large grids, and campaigns of hundreds of problems
LARGE = ("benchmark", "robustness", "true_errors")
TITLE = "adaptmg: multigrid for frictional contact"
SUMMARY = """The three tables of 'Multigrid in Structure Assembling Problem' beside ours, the same on its assemblies
(reconstructed), closed forms of contact, adaptive against uniform meshes, transfers between meshes that are not nested,
and algebraic multigrid on the same matrices.

One work unit is one pass over the matrix of the finest grid; passes on coarser grids count by their nonzeros, inside
coarse solves and in nested starts too. Direct factorisations are reported in seconds only. The true error is
||u - u_h||_A / ||u_h||_A against the exact discrete solution, found by an independent method (semismooth Newton with
direct solves). Seconds are of this machine and this run."""


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
    from adaptmg.export.report import Report

    page = Report(TITLE, SUMMARY + ("\n\nThis is a quick run on smaller grids." if context.quick else ""))
    for number, name in enumerate(names, start=1):
        print(f"[{number}/{len(names)}] {name} ...", file=sys.stderr, flush=True)
        begin = time.perf_counter()
        section = importlib.import_module(name).run(context)
        show(section, context.out)
        add(page, section)
        print(f"[{number}/{len(names)}] {name}: {time.perf_counter() - begin:.1f} s", file=sys.stderr, flush=True)
    target = context.out / "report.html"
    page.write(target)
    print(f"\nreport: {target}")
    return target


def add(page: object, section: Section) -> None:
    """A section of the report."""
    page.section(section.title, section.text)
    for item in section.items:
        if isinstance(item, Table):
            page.table(item.frame, caption=item.caption, note=item.note, units=item.units, formats=item.formats)
        else:
            page.figure(item.figure, caption=item.caption)


if __name__ == "__main__":
    main()
