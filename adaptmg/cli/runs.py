"""``adaptmg runs STORE``: what a store holds, filtered, and as a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from adaptmg.cli.command import _say as say
from adaptmg.cli.command import _told as told
from adaptmg.cli.command import app

__all__ = ["runs"]


@app.command(epilog="Example: adaptmg runs results/friction.sqlite --where case.friction=0.2 --where \"cycles>20\" "
                    "--to friction.csv")
def runs(
    store: Annotated[Path, typer.Argument(help="SQLite file of studies.")],
    study: Annotated[str | None, typer.Option(
        show_default="the only one", help="Name of a study in the store.")] = None,
    status: Annotated[str | None, typer.Option(help="Only runs that are 'done' or 'failed'.")] = None,
    where: Annotated[list[str] | None, typer.Option(
        help="Only runs with NAME=VALUE, or with !=, <, <=, >, >= and a number; several times: all of them.")] = None,
    details: Annotated[bool, typer.Option("--details", help="Also tries, memory, machine, commit ...")] = False,
    limit: Annotated[int, typer.Option(help="Rows that are printed at most; JSON and files have all.", min=1)] = 50,
    to: Annotated[Path | None, typer.Option(
        help="Write all of them to a file: .csv, .tex, or .parquet (which needs pyarrow).")] = None,
    take_in: Annotated[Path | None, typer.Option(
        help="First take in the runs of another store, such as one that was rescued.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Show the runs in a store: without --study those of its one study, or which studies it has."""
    with told(as_json):
        from adaptmg.cli.listed import conditions, listing
        from adaptmg.cli.listed.fitting import printed
        from adaptmg.cli.plain import lines, rows
        from adaptmg.problem import checks

        if status is not None:
            checks.choice("--status", status, ("done", "failed"))
        wanted = [conditions.parsed(text) for text in where or []]
        if to is not None:
            from adaptmg.cli.listed import writing

            writing.ending(to)
        if take_in is None:
            found = listing.opened(store)
        else:
            from adaptmg.study.store import Store

            listing.opened(take_in)  # a store that was removed is made again only for one that is there
            found = Store(store)
            say(f"{found.take_in(take_in)} runs taken in from {take_in}", err=True)
        names = found.studies()
        if study is None and len(names) != 1:
            if to is not None or wanted or status is not None:
                raise ValueError(listing.which(store, names))
            table = listing.studies(found)
            say(lines(rows(table)) if as_json else printed(table, ["study"], units={"seconds": "s"}))
            return
        name = listing.chosen(names, study)
        table, total = listing.selected(found, name, status=status, where=wanted, details=details,
                                        limit=None if as_json or to is not None else limit)
        if to is not None:
            writing.write(table, to, listing.units(found, name, table))
            say(f"wrote {to}", err=True)
        if as_json:
            say(lines(rows(table)))
        elif to is None:
            rest = total - limit
            counted = "1 run" if total == 1 else f"{total} runs"
            note = f"... {rest} more: --limit, or --to FILE.csv for all" if rest > 0 else counted
            first = found.runs(name, limit=1)
            say(printed(listing.short(table), list(first[0].parameters) if first else [],
                        units=listing.units(found, name, table), note=note))
