"""``adaptmg runs STORE``: what a store holds, filtered, and as a file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from adaptmg.cli.command import _say as say
from adaptmg.cli.command import _told as told
from adaptmg.cli.command import app

__all__ = ["runs"]


@app.command(epilog="Example: adaptmg runs results/friction.sqlite --where case.friction=0.2 --to friction.csv")
def runs(
    store: Annotated[Path, typer.Argument(help="SQLite file of studies.")],
    study: Annotated[str | None, typer.Option(
        show_default="the only one", help="Name of a study in the store.")] = None,
    status: Annotated[str | None, typer.Option(help="Only runs that are 'done' or 'failed'.")] = None,
    where: Annotated[list[str] | None, typer.Option(
        help="Only runs with this value, NAME=VALUE; may be given several times.")] = None,
    details: Annotated[bool, typer.Option("--details", help="Also tries, memory, machine, commit ...")] = False,
    limit: Annotated[int, typer.Option(help="Rows that are printed at most.", min=1)] = 50,
    to: Annotated[Path | None, typer.Option(
        help="Write all of them to a file: .csv, .parquet (with pyarrow) or .tex.")] = None,
    take_in: Annotated[Path | None, typer.Option(
        help="First take in the runs of another store, such as one that was rescued.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show the runs in a store: without --study those of its one study, or which studies it has."""
    with told():
        from adaptmg.cli.described import listing
        from adaptmg.study import as_text

        found = listing.opened(store)
        if take_in is not None:
            say(f"{found.take_in(take_in)} runs taken in from {take_in}", err=True)
        names = found.studies()
        if study is None and len(names) != 1:
            rows = listing.studies(found)
            say(json.dumps(rows.to_dict("records"), indent=2) if as_json else as_text(rows))
            return
        table = listing.table(found, listing.chosen(names, study), details)
        table = listing.filtered(table, status, where or [])
        if to is not None:
            listing.write(table, to)
            say(f"wrote {to}", err=True)
        if as_json:
            say(json.dumps(listing.rows(table), indent=2, allow_nan=False))
        elif to is None:
            rest = len(table) - limit
            note = f"... {rest} more: --limit, or --to FILE.csv for all" if rest > 0 else f"{len(table)} runs"
            say(as_text(listing.short(table.head(limit)), units={"seconds": "s"}, note=note))
