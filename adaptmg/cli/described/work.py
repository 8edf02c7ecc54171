"""From a study file to a study, and to what the command prints of it."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

import adaptmg as am
from adaptmg.cli.described.study_file import StudyFile
from adaptmg.cli.listed.fitting import printed
from adaptmg.cli.plain import rows
from adaptmg.cli.single_run import parts
from adaptmg.cli.single_run.case_run import case_run
from adaptmg.problem import checks
from adaptmg.study import Study

__all__ = ["checked", "plan", "summary", "unsolved", "warm"]

#: points whose problem and solver are made before anything runs: of the first, of those with new values; and points
#: that are looked at for such
_FIRST, _NEW, _SEEN = 100, 1000, 50_000
#: points that a plan shows, and of how many it says what is stored of each
_SHOWN, _TOLD = 20, 20_000


def checked(said: StudyFile, store: Path | None) -> Study:
    """The study, after a look at what its points are made of: the first ones, and those that bring a new value.

    Raises
    ------
    ValueError
        If a problem or a solver cannot be made; the message says for which values, and in which line.
    """
    seen: set[tuple[str, Any]] = set()
    count = 0
    for point in itertools.islice(said.design.points(), _SEEN):
        new = set(point.items()) - seen
        if count >= _FIRST and (not new or count == _FIRST + _NEW):
            continue
        seen |= new
        count += 1
        try:
            parts.check({**said.fixed, **point})
        except parts.WrongSetting as error:
            varied = ", ".join(f"{name} = {value!r}" for name, value in point.items())
            raise said.file.wrong(f"with {checks.shown(varied)[1:-1]}: {error}", *_place(said, error)) from None
    return Study(case_run, said.design, store, name=said.name, fixed=said.fixed)


def _place(said: StudyFile, error: parts.WrongSetting) -> tuple[str, ...]:
    """Where the setting stands that a message names, or the section it is about."""
    mine = [name for name in [*said.design.names, *said.fixed] if name.startswith(f"{error.section}.")]
    found = {name: re.search(rf"(?<![\w-]){re.escape(name.removeprefix(f'{error.section}.'))}(?![\w.-])", str(error))
             for name in mine if name in said.places}
    named = {name: match.start() for name, match in found.items() if match}
    if named:
        return said.places[min(named, key=named.__getitem__)]
    return said.places.get(mine[0], (error.section,)) if len(mine) == 1 else (error.section,)


def unsolved(table: Any) -> int:
    """How many runs are done, but did not reach their tolerance."""
    if "outcome" not in table:
        return 0
    return int(((table["status"] == "done") & (table["outcome"] != "CONVERGED")).sum())


def warm(study: Study) -> None:
    """Compile the kernels of the default method before the clock of the first run, if anything is to be run."""
    status = study.status()
    if status.done + status.failed < status.total:
        am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)), throw=False)


def plan(study: Study) -> str:
    """What a study would run: its first points, what is stored of them, and how many there are."""
    points = list(itertools.islice(study.design.points(), _SHOWN))
    shown = {name: [point[name] for point in points] for name in study.parameters}
    if len(study) <= _TOLD:
        shown["status"] = list(study.table()["status"].head(_SHOWN))
    rest = len(study) - _SHOWN
    return "\n".join([printed(shown, study.parameters, units={}, note=f"... {rest} more" if rest > 0 else ""), "",
                      repr(study), repr(study.status())])


def summary(study: Study, with_rows: bool) -> dict[str, Any]:
    """What the command prints as JSON."""
    status = study.status()
    head = {"study": study.name, "runs": status.total, "done": status.done, "failed": status.failed,
            "stale": status.stale, "missing": status.missing, "why_stale": status.reasons, "errors": status.errors}
    return head | ({"rows": rows(study.table(details=True))} if with_rows else {})
