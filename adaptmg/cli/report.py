"""``adaptmg report STORE``: the runs of a study as one HTML page, with pictures, and as CSV beside it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from adaptmg.cli.command import _say as say
from adaptmg.cli.command import _told as told
from adaptmg.cli.command import app

__all__ = ["report"]


@app.command(epilog="Example: adaptmg report results/friction.sqlite --result cycles --to friction.html")
def report(
    store: Annotated[Path, typer.Argument(help="SQLite file of studies.")],
    study: Annotated[str | None, typer.Option(
        show_default="the only one", help="Name of a study in the store.")] = None,
    result: Annotated[list[str] | None, typer.Option(
        show_default="the first two that vary", help="Column to draw; may be given several times.")] = None,
    to: Annotated[Path | None, typer.Option(
        show_default="beside the store, named as the study", help="The HTML file to write.")] = None,
) -> None:
    """Write a page that opens offline: how many runs there are, pictures of results, all runs, those that failed."""
    with told():
        from adaptmg.cli.listed import listing, writing
        from adaptmg.export import study_report
        from adaptmg.problem import checks
        from adaptmg.study.frame import from_columns

        found = listing.opened(store)
        names = found.studies()
        if not names or (study is None and len(names) != 1):
            raise ValueError(listing.which(store, names))
        name = listing.chosen(names, study)
        records = found.runs(name)
        columns, _ = listing.selected(found, name)
        table = from_columns(columns)
        table.attrs["study"] = name
        known = {key for record in records for key in record.parameters}
        if to is None and Path(name).name != name:
            raise ValueError(f"--to must be given, as the name of the study cannot be that of a file: {name!r}")
        page = store.with_name(f"{name}.html") if to is None else checks.file_path("--to", to)
        csv = page.with_suffix(".csv")
        if csv == page:
            raise ValueError(f"--to must be an HTML file, got {checks.shown(str(to))}: its table goes into a .csv "
                             "beside it")
        written = study_report(table, page, parameters=[key for key in table if key in known], results=result,
                               csv=csv.name, units=listing.units(found, name, columns),
                               summary=listing.same_in_all(records, columns), made=listing.made(records))
        writing.write(columns, csv)
        say(f"wrote {written} and {csv}", err=True)
