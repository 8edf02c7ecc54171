"""All studies, one HTML report that opens offline, with the tables as CSV and the figures as PNG
next to it.

    python studies/reproduce.py [--quick | --full] [--workers N] [--out DIR] [--fresh] [--record]
    [STUDY ...]

Each study is a script of its own (python studies/STUDY.py) that stores its runs, so that an
interrupted call goes on. ``--record`` writes what studies found in DIR so far into data/measured,
and readme.csv into the table of the README."""

from __future__ import annotations

import argparse
import ast
import io
import json
import os
import re
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from datetime import date
from pathlib import Path
from typing import Any

import pandas as pd

from adaptmg._machine import processor

HERE = Path(__file__).resolve().parent
MEASURED, README = HERE.parent / "data" / "measured", HERE.parent / "README.md"
#: a table in the README below the name of its file in data/measured
TABLE = re.compile(r"<!-- data/measured/(\w+)\.csv -->\n\n(?:\|.*\n)*")
#: studies of a default run with their processor seconds; they appear in this order, the longest are begun first
STUDIES = {
    "table_1_grids": 10,
    "table_2_smoothings": 13,
    "table_3_full_multigrid": 4,
    "dovetail": 14,
    "bolted_junction": 12,
    "hertz": 6,
    "adaptive_vs_uniform": 38,
    "estimators": 25,
    "transfers": 25,
    "amg": 20,
    "flexible": 7,
    "parts": 42,
    "accuracy": 16,
    "obstacle": 27,
    "crack": 30,
    "impact": 26,
    "plastic": 23,
    "laws": 6,
}
#: only with --full, or where they are named
LARGE = {"benchmark": 300}
TITLE = "adaptmg: multigrid for frictional contact"
SUMMARY = """'Multigrid in Structure Assembling Problem' (a conference paper after 1989; the copy at hand names neither
authors nor volume) recomputed: its three tables next to ours, its assemblies, and what it leaves open, adaptive meshes
with non-nested grids."""
TERMS = """Work unit: one pass over the matrix of the finest grid; passes on coarser grids count by their nonzeros,
inside coarse solves and in nested starts too. Not counted: direct factorisations, which are in the seconds only; a pass
of the default method's half sweeps uses each entry twice, a sweep of the other methods once.

True error: ||u - u_h||_A / ||u_h||_A against the exact discrete solution, found by an independent method (semismooth
Newton with direct solves).

Seconds are processor time on this machine, of one thread with compiled kernels, the least of up to three runs; those of
adaptive and uniform meshes count Netgen's process, too.
The paper counts grid 1 as the finest."""


def main() -> int:
    """Command line; exit code 1 where a study failed."""
    arguments = _parser().parse_args()
    known = STUDIES | LARGE
    if unknown := sorted(set(arguments.studies) - set(known)):
        raise SystemExit(
            f"reproduce.py: unknown study {', '.join(unknown)}; there are {', '.join(known)}"
        )
    names = arguments.studies or [*STUDIES, *(LARGE if arguments.full else [])]
    out = arguments.out / "quick" if arguments.quick else arguments.out
    if arguments.quick and arguments.record:
        raise SystemExit("reproduce.py: --record writes numbers of whole runs, not of --quick ones")
    say(
        f"{len(names)} studies{' on small grids' * arguments.quick}, {arguments.workers} at a time; the first run on a "
        "machine compiles kernels for about a minute"
    )
    if arguments.fresh:
        for name in names:
            shutil.rmtree(out / name, ignore_errors=True)
    options = ["--quick"] * arguments.quick + ["--full"] * arguments.full + ["--out", str(out)]
    failed = run_all(sorted(names, key=lambda name: -known[name]), options, out, arguments.workers)
    if arguments.record and failed:
        say(f"nothing is recorded, as these failed: {', '.join(sorted(failed))}")
    elif arguments.record:
        record(out, known)
    print(f"report: {report(names, out, arguments, failed)}")
    return 1 if failed else 0


def _parser() -> argparse.ArgumentParser:
    lines = [
        f"  {name:24s}{seconds:4d} s  {question(name)}"
        for name, seconds in (STUDIES | LARGE).items()
    ]
    parser = argparse.ArgumentParser(
        description=str(__doc__).split("\n")[0],
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="studies, processor seconds (the last with --full or by name):\n"
        + "\n".join(lines)
        + "\n\nexample: python studies/reproduce.py --quick --out /tmp/report",
    )
    parser.add_argument("studies", nargs="*", metavar="STUDY", help="default: all but the last")
    size = parser.add_mutually_exclusive_group()
    size.add_argument(
        "--quick", action="store_true", help="smaller grids: 80 s on two cores, compiling included"
    )
    size.add_argument(
        "--full", action="store_true", help="larger grids and the benchmark: most of an hour"
    )
    parser.add_argument(
        "--workers",
        type=int,
        choices=range(1, 65),
        metavar="N",
        default=min(os.cpu_count() or 1, 8),
        help="studies at a time (default: one a core, here %(default)s)",
    )
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results"),
        metavar="DIR",
        help="where report.html, CSV files, figures and stores go (default: results)",
    )
    parser.add_argument(
        "--fresh", action="store_true", help="compute again what an earlier call has stored"
    )
    parser.add_argument(
        "--record", action="store_true", help="write the numbers into data/measured and README"
    )
    return parser


def question(name: str) -> str:
    """The first line of a study's docstring."""
    return (ast.get_docstring(ast.parse((HERE / f"{name}.py").read_text())) or name).split("\n")[0]


def say(text: str) -> None:
    """Write a line on standard error."""
    sys.stderr.write(text + "\n")  # in one piece: several threads write
    sys.stderr.flush()


def run_all(names: Sequence[str], options: Sequence[str], out: Path, workers: int) -> set[str]:
    """Run studies, ``workers`` at a time, a line where each begins and ends; return the names of
    those that failed."""
    failed, cost, spent = set(), STUDIES | LARGE, 0
    with ThreadPoolExecutor(max(workers, 1)) as pool:
        runs = {pool.submit(run_one, name, options, out): name for name in names}
        threading.Thread(target=_beat, args=(runs,), daemon=True).start()
        for done, run in enumerate(as_completed(runs), 1):
            code, seconds, last = run.result()
            spent += cost[runs[run]]
            say(
                f"[{done}/{len(names)}, {spent / sum(cost[name] for name in names):.0%}] {runs[run]}: "
                f"{f'FAILED, {last}' if code else last} ({seconds:.0f} s)"
            )
            failed |= {runs[run]} if code else set()
    return failed


def _beat(runs: Mapping[Future, str]) -> None:
    """Say on a terminal every ten seconds which studies run."""
    begin = time.perf_counter()
    while sys.stderr.isatty() and not all(run.done() for run in runs):
        time.sleep(10)
        if names := ", ".join(name for run, name in runs.items() if run.running()):
            say(f"{time.perf_counter() - begin:.0f} s: {names} running")


def run_one(name: str, options: Sequence[str], out: Path) -> tuple[int, float, str]:
    """Run one study; return its exit code, seconds and last line, and keep what it printed in
    ``NAME/log.txt``."""
    say(f"begins: {name}, about {(STUDIES | LARGE)[name]} s without --quick. {question(name)}")
    begin = time.perf_counter()
    (out / name).mkdir(parents=True, exist_ok=True)
    (out / name / "section.json").unlink(missing_ok=True)
    log, command = out / name / "log.txt", [sys.executable, str(HERE / f"{name}.py"), *options]
    with log.open("w") as file:
        code = subprocess.run(
            command,
            stdout=file,
            stderr=subprocess.STDOUT,
            check=False,
            env=os.environ | {"OMP_NUM_THREADS": "1"},
        ).returncode
    lines = log.read_text().strip().splitlines() or ["nothing printed"]
    return code, time.perf_counter() - begin, f"{lines[-1]} (see {log})" if code else lines[-1]


def record(
    out: Path, names: Iterable[str], measured: Path = MEASURED, readme: Path = README
) -> None:
    """Write the numbers and the tables of the first screen that studies left in ``out`` into
    data/measured and the README."""
    from adaptmg.export.report import columns_of

    lines = []
    measured.mkdir(exist_ok=True)
    machine = f"{processor()}, {os.cpu_count()} processors"
    run = f"python studies/reproduce.py, commit {commit()}, {date.today()}, {machine}"
    for name in names:
        file = out / name / "section.json"
        for item in json.loads(file.read_text())["items"] if file.exists() else []:
            if item["kind"] == "number":
                lines.append({"what": item["what"], "measured": item["measured"]})
            elif item["kind"] == "table" and (item["card"] or item["readme"]):
                columns = columns_of(
                    pd.read_csv(out / name / f"{item['name']}.csv"), item["units"], item["formats"]
                )
                heads = [
                    f"{column.head} [{column.unit}]" if column.unit else column.head
                    for column in columns
                ]
                frame = pd.DataFrame(
                    dict(zip(heads, (column.texts for column in columns), strict=True))
                )
                file = measured / f"{item['name']}.csv"
                write_measured(file, frame, item["caption"], item["note"], run)
    write_measured(measured / "readme.csv", pd.DataFrame(lines), "Numbers of the README", "", run)
    text = readme.read_text(encoding="utf-8")
    readme.write_text(TABLE.sub(lambda found: markdown(found[1], measured), text), encoding="utf-8")


def write_measured(file: Path, frame: pd.DataFrame, caption: str, note: str, run: str) -> None:
    """Write a table of data/measured, with comments: its caption, what its numbers are, and the
    run that they are from."""
    comments = [f"# {' '.join(text.split())}\n" for text in (caption, note, run) if text]
    text = "".join(comments) + frame.to_csv(index=False)
    file.write_text(text, encoding="utf-8")


def read_measured(file: Path) -> tuple[list[str], pd.DataFrame]:
    """Return the comments and the table of a file in data/measured."""
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    comments = [line[2:].strip() for line in lines if line.startswith("# ")]
    table = io.StringIO("".join(line for line in lines if not line.startswith("# ")))
    return comments, pd.read_csv(table, dtype=str, keep_default_na=False)


def markdown(name: str, measured: Path = MEASURED) -> str:
    """Return a table of data/measured as it stands in the README, below the name of its file."""
    _, frame = read_measured(measured / f"{name}.csv")
    rows = [list(frame.columns), ["---"] * frame.shape[1], *frame.to_numpy().tolist()]
    text = "".join(f"| {' | '.join(row)} |\n" for row in rows)
    return f"<!-- data/measured/{name}.csv -->\n\n{text}"


def report(
    names: Sequence[str], out: Path, arguments: argparse.Namespace, failed: set[str]
) -> Path:
    """Make the page of what the studies wrote."""
    from adaptmg.export import Report
    from adaptmg.export.report import Picture

    page = Report(
        TITLE,
        " ".join(SUMMARY.split()) + " This is a quick run, on smaller grids." * arguments.quick,
        terms=TERMS,
    )
    for name in names:
        file = out / name / "section.json"
        section: dict[str, Any] = (
            json.loads(file.read_text())
            if file.exists()
            else {
                "title": question(name),
                "text": f"This study failed; {out / name / 'log.txt'} says why.",
                "items": [],
            }
        )
        checks = [item["text"] for item in section["items"] if item["kind"] == "check"]
        page.section(
            section["title"],
            section["text"],
            key=name,
            summary="Checked in this run: " + "; ".join(checks) + "." if checks else "",
        )
        for item in sorted(
            section["items"], key=lambda item: item["kind"] == "table" and not item["card"]
        ):
            if item["kind"] == "table":
                frame = pd.read_csv(out / name / f"{item['name']}.csv")
                words = {"units": item["units"], "formats": item["formats"]}
                page.table(
                    frame, item["caption"], item["note"], csv=f"{name}/{item['name']}.csv", **words
                )
                if item["card"]:
                    page.card(item["card"], item["note"], to=name, table=frame, **words)
            elif item["kind"] == "figure":
                picture = Picture(item["source"], item["caption"], item["width"])
                page.figure(picture, item["caption"])
                if item["card"]:
                    page.card(item["card"], item["caption"], to=name, figure=picture)
    page.made(commit=commit(), command=" ".join(["python studies/reproduce.py", *sys.argv[1:]]))
    return page.write(out / "report.html")


def commit() -> str:
    """Return the commit of the source, with a mark where it was changed since; 'unknown' outside a
    repository."""
    try:
        return (
            subprocess.run(
                ["git", "describe", "--always", "--dirty"],
                cwd=HERE,
                check=True,
                capture_output=True,
                text=True,
                timeout=10,
            ).stdout.strip()
            or "unknown"
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"


if __name__ == "__main__":
    raise SystemExit(main())
