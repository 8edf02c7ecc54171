"""From a study file to a study, and to what the command prints of it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from adaptmg.cli.described.case_run import case_run, checked_parts
from adaptmg.cli.described.study_file import StudyFile
from adaptmg.problem import checks
from adaptmg.study import Study

__all__ = ["checked", "rows", "summary"]

#: points whose problem and solver are made before anything runs
_MOST_CHECKED = 200


def checked(said: StudyFile, store: Path | None) -> Study:
    """The study, after a look at what its first points are made of.

    Raises
    ------
    ValueError
        If a problem or a solver cannot be made; the message says for which values.
    """
    study = Study(case_run, said.design, store, name=said.name, fixed=said.fixed)
    for point in study.points()[:_MOST_CHECKED]:
        try:
            checked_parts(point)
        except (ValueError, TypeError) as error:
            varied = ", ".join(f"{name} = {point[name]!r}" for name in said.design.names)
            raise ValueError(f"with {checks.shown(varied)[1:-1]}: {error}") from None
    return study


def summary(study: Study, with_rows: bool) -> dict[str, Any]:
    """What the command prints as JSON."""
    status = study.status()
    head = {"study": study.name, "runs": status.total, "done": status.done, "failed": status.failed,
            "stale": status.stale, "missing": status.missing, "why_stale": status.reasons, "errors": status.errors}
    return head | ({"rows": rows(study.table(details=True))} if with_rows else {})


def rows(table: Any) -> list[dict[str, Any]]:
    """A table as JSON takes it; numbers that are not finite become null."""
    return [{name: _finite(value) for name, value in row.items()} for row in table.to_dict("records")]


def _finite(value: Any) -> Any:
    if isinstance(value, tuple | list):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
