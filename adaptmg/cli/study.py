"""``adaptmg study FILE.toml``: run a study that a file describes."""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from adaptmg.cli.command import _say as say
from adaptmg.cli.command import _told as told
from adaptmg.cli.command import app

__all__ = ["study"]


@app.command(epilog="Example: adaptmg study --template greco_bar > my.toml, then adaptmg study my.toml --workers 4")
def study(
    file: Annotated[Path | None, typer.Argument(
        help="TOML file: --keys says what may stand in it, --template prints one.", metavar="FILE.toml",
        show_default=False)] = None,
    keys: Annotated[bool, typer.Option("--keys", help="List all keys and measures, with units and defaults.")] = False,
    template: Annotated[str | None, typer.Option(
        help="Print a file to begin with, for a case of 'adaptmg cases'.", metavar="CASE")] = None,
    workers: Annotated[int | None, typer.Option(
        show_default="that of the file, or this process", help="Processes on this machine.", min=1)] = None,
    scheduler: Annotated[str | None, typer.Option(
        help="Address of a dask scheduler instead, such as tcp://host:8786.")] = None,
    store: Annotated[Path | None, typer.Option(show_default="that of the file", help="SQLite file.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would run, and run nothing.")] = False,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Run again what failed.")] = False,
    rerun: Annotated[bool, typer.Option("--rerun", help="Run everything again.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table: errors alone.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Run a study and print its table.

    What is stored is not run again. Exit code 0: all runs done and converged; 1: a run failed or did not converge;
    2: bad input; 130: Ctrl-C, the same command goes on.
    """
    with told(as_json, "what is done is stored, the same command goes on"):
        if keys or template is not None:
            from adaptmg.cli.described import guide

            if as_json:
                say(json.dumps(guide.key_facts() if keys else {"template": guide.template(template)}, indent=2))
            else:
                say(guide.keys() if keys else guide.template(template))
            return
        if file is None:
            raise ValueError("give a file: adaptmg study FILE.toml; --template CASE prints one to begin with")
        from adaptmg.cli.described.options import check_options
        from adaptmg.cli.described.study_file import read

        said = read(file)
        options = {**said.options, "rerun": rerun, "retry_failed": retry_failed}
        if workers is not None or scheduler is not None:
            options |= {"workers": workers, "scheduler": scheduler}
        check_options(said, options)
        from adaptmg.cli.described.work import checked, plan, summary, unsolved, warm

        target = said.store if store is None else store
        # a dry run leaves nothing behind
        made = checked(said, target if not dry_run or target.exists() else None)
        if dry_run:
            say(json.dumps(summary(made, False), indent=2) if as_json else plan(made))
            return
        if options.get("workers") is None and scheduler is None:
            warm(made)
        with _logged(quiet):
            table = made.run(progress=False if quiet else None, **options)
        if as_json:
            say(json.dumps(summary(made, True), indent=2, allow_nan=False))
        elif not quiet:
            from adaptmg.cli.described.meanings import units_of
            from adaptmg.cli.listed.fitting import printed

            say(printed(table.drop(columns=["error"]), made.parameters, units=units_of(table)))
            say(f"\n{made.status()!r}\nstored in {target}")
        failed, missed = int((table["status"] == "failed").sum()), unsolved(table)
    for count, words in ((failed, "failed: --retry-failed runs them again"),
                         (missed, "did not converge, see the column outcome")):
        if count:
            say(f"adaptmg: {count} of {len(table)} runs {words}", err=True)
    if failed or missed:
        raise typer.Exit(1)


@contextmanager
def _logged(quiet: bool) -> Iterator[None]:
    """Send the log of studies to standard error: a line a run where that is no terminal, else what goes wrong."""
    logger = logging.getLogger("adaptmg.study")
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(message)s"))
    level, spread = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.INFO if sys.stderr and not (quiet or sys.stderr.isatty()) else logging.WARNING)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = spread
