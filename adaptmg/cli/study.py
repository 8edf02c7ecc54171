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


@app.command(epilog="Example: adaptmg study studies/friction.toml --workers 4")
def study(
    file: Annotated[Path, typer.Argument(help="TOML file; examples: studies/*.toml.", metavar="FILE.toml")],
    workers: Annotated[int | None, typer.Option(
        show_default="that of the file, or this process", help="Processes on this machine.")] = None,
    scheduler: Annotated[str | None, typer.Option(
        help="Address of a dask scheduler instead, such as tcp://host:8786.")] = None,
    store: Annotated[Path | None, typer.Option(show_default="that of the file", help="SQLite file.")] = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Say what would run, and run nothing.")] = False,
    retry_failed: Annotated[bool, typer.Option("--retry-failed", help="Run again what failed.")] = False,
    rerun: Annotated[bool, typer.Option("--rerun", help="Run everything again.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Run a study and print its table. What is stored is not run again. Exit code 1 if a run failed, 2: bad input."""
    with told():
        from adaptmg.cli.described.study_file import read
        from adaptmg.cli.described.work import checked, summary
        from adaptmg.study import as_text

        said = read(file)
        target = said.store if store is None else store
        # a dry run leaves nothing behind
        made = checked(said, target if not dry_run or target.exists() else None)
        if dry_run:
            say(json.dumps(summary(made, False), indent=2) if as_json else f"{made!r}\n{made.status()!r}")
            return
        options = {**said.options, "rerun": rerun, "retry_failed": retry_failed}
        if workers is not None or scheduler is not None:
            options |= {"workers": workers, "scheduler": scheduler}
        with _logged():
            table = made.run(**options)
        if as_json:
            say(json.dumps(summary(made, True), indent=2, allow_nan=False))
        else:
            say(as_text(table.drop(columns=["error"]), units={"seconds": "s"}))
            say(f"\n{made.status()!r}\nstored in {target}")
        failed = int((table["status"] == "failed").sum())
    if failed:
        say(f"adaptmg: {failed} of {len(table)} runs failed", err=True)
        raise typer.Exit(1)


@contextmanager
def _logged() -> Iterator[None]:
    """Send the log of studies to standard error: a line a run where that is no terminal, else what goes wrong."""
    logger = logging.getLogger("adaptmg.study")
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("%(message)s"))
    level, spread = logger.level, logger.propagate
    logger.addHandler(handler)
    logger.setLevel(logging.WARNING if sys.stderr.isatty() else logging.INFO)
    logger.propagate = False
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = spread
