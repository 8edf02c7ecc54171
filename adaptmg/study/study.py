"""Study: a function and a grid of parameters give a table, by way of a durable store."""

from __future__ import annotations

import inspect
import itertools
import logging
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from typing import Any

import pandas as pd

from adaptmg.problem import checks
from adaptmg.study.execute import Execute, Finished, Point, RunFunction, in_turn
from adaptmg.study.fingerprint import code_hash, environment
from adaptmg.study.record import RESERVED, Record, Value, canonical, parameter_value
from adaptmg.study.store import Store

__all__ = ["Study"]

_log = logging.getLogger(__name__)


class Study:
    """A parameter sweep.

    Each run is stored when it ends. A study that is run again takes what is stored and computes the rest: points
    never reached, points that failed, and points that are stale, which means that the source of the run function, the
    source of adaptmg or a version of a package changed since (:mod:`adaptmg.study.fingerprint` says what is seen).

    Parameters
    ----------
    run : function
        Called with the parameters by name; returns a flat dict of numbers, strings and bools (numpy scalars are
        fine). Its own exceptions make a failed row, and the study goes on.
    parameters : mapping of str to sequence
        The grid: every combination is run, the last parameter changing fastest. Values are numbers, strings, bools,
        None or tuples of those.
    store : path, optional
        SQLite file, made where missing; several studies can share one. Default: in memory, gone with the study.
    name : str, optional
        Under which the rows are stored; default the name of the function.
    fixed : mapping, optional
        Parameters that are the same in every run. They are part of what a stored run is known by.

    Raises
    ------
    TypeError, ValueError
        Before anything runs: for values that cannot be stored, and parameters the function does not take or lacks.

    Examples
    --------
    >>> def run(sweeps, friction):
    ...     return {"work": 2.0 * sweeps + friction}
    >>> table = Study(run, {"sweeps": [1, 2]}, fixed={"friction": 0.5}).run(progress=False)
    >>> table["work"].tolist()
    [2.5, 4.5]
    """

    def __init__(self, run: RunFunction, parameters: Mapping[str, Sequence[Value]],
                 store: str | os.PathLike[str] | None = None, *, name: str | None = None,
                 fixed: Mapping[str, Value] | None = None) -> None:
        self._code = code_hash(run)
        self._function = run
        self.parameters = _checked_grid(parameters)
        self.fixed = {key: parameter_value(key, value) for key, value in (fixed or {}).items()}
        self.name = run.__name__ if name is None else name
        if name is not None:
            checks.boundary_name("name", name)
        _check_names(run, self.parameters, self.fixed)
        self._store = Store(store)

    def __len__(self) -> int:
        return len(self.points())

    def __repr__(self) -> str:
        grid = ", ".join(f"{name}: {len(values)}" for name, values in self.parameters.items())
        return f"Study {self.name!r} of {len(self)} runs ({grid})"

    def points(self) -> list[Point]:
        """The parameters of every run, the fixed ones too, in grid order."""
        names = list(self.parameters)
        return [{**self.fixed, **dict(zip(names, values, strict=True))}
                for values in itertools.product(*self.parameters.values())]

    def run(self, progress: bool | None = None, *, rerun: bool = False, throw: bool = False) -> pd.DataFrame:
        """Compute what the store does not have, and return the table.

        Parameters
        ----------
        progress : bool, optional
            Show a progress bar on standard error; default: only on a terminal.
        rerun : bool
            Compute every point anew.
        throw : bool
            Raise the exception of a run that fails (the row is stored all the same) instead of going on.

        Returns
        -------
        pandas.DataFrame
            One row a run in grid order; see :meth:`table`.
        """
        return self._run(in_turn, progress=progress, rerun=rerun, throw=throw)

    def table(self) -> pd.DataFrame:
        """What the store has, without running anything.

        Returns
        -------
        pandas.DataFrame
            One row a run in grid order: parameters, results, ``status`` ('done', 'failed', 'stale', 'missing'),
            ``seconds`` and ``error``. ``attrs`` holds the name of the study and the fixed parameters.
        """
        stored, versions = self._store.get(self.name), environment()
        rows, results = [], {}
        for point in self.points():
            record = stored.get(canonical(point))
            status = "missing" if record is None else record.status if self._valid(record, versions) else "stale"
            found = record.results if record is not None else {}
            results |= dict.fromkeys(found)
            rows.append({**{name: point[name] for name in self.parameters}, **found, "status": status,
                         "seconds": record.seconds if record is not None else float("nan"),
                         "error": record.error if record is not None else ""})
        table = pd.DataFrame(rows, columns=[*self.parameters, *results, *RESERVED])
        table.attrs = {"study": self.name, "fixed": dict(self.fixed)}
        return table

    def _run(self, execute: Execute, *, progress: bool | None, rerun: bool, throw: bool) -> pd.DataFrame:
        stored, versions = self._store.get(self.name), environment()
        points = self.points()
        todo = [p for p in points if rerun or not self._settled(stored.get(canonical(p)), versions)]
        _log.info("study %s: %d of %d runs to compute", self.name, len(todo), len(points))
        with _progress_bar(self.name, len(points), len(points) - len(todo), progress) as advance:
            for point, outcome in execute(self._function, todo):
                self._store.put(self.name, self._record(point, outcome, versions))
                advance()
                if outcome.error is not None:
                    if throw:
                        raise outcome.error
                    _log.warning("study %s: %s failed: %s", self.name, canonical(point), _text(outcome.error))
        return self.table()

    def _record(self, point: Point, outcome: Finished, versions: dict[str, str]) -> Record:
        return Record(parameters=point, status="done" if outcome.error is None else "failed", results=outcome.results,
                      error="" if outcome.error is None else _text(outcome.error), seconds=outcome.seconds,
                      code=self._code, versions=versions, finished=datetime.now(UTC).isoformat(timespec="seconds"))

    def _valid(self, record: Record, versions: dict[str, str]) -> bool:
        return record.code == self._code and record.versions == versions

    def _settled(self, record: Record | None, versions: dict[str, str]) -> bool:
        return record is not None and record.status == "done" and self._valid(record, versions)


def _text(error: Exception) -> str:
    return f"{type(error).__name__}: {error}"


def _checked_grid(parameters: Mapping[str, Sequence[Value]]) -> dict[str, list[Value]]:
    if not isinstance(parameters, Mapping) or not parameters:
        raise TypeError(f"parameters must be a mapping of names to sequences of values, got {parameters!r}")
    grid = {}
    for name, values in parameters.items():
        if isinstance(values, str | Mapping) or not isinstance(values, Iterable):
            raise TypeError(f"parameters[{name!r}] must be a sequence of values, got {values!r}")
        grid[name] = [parameter_value(name, value) for value in values]
        texts = [canonical({name: value}) for value in grid[name]]
        if not texts:
            raise ValueError(f"parameters[{name!r}] is empty: give at least one value")
        if len(set(texts)) < len(texts):
            raise ValueError(f"parameters[{name!r}] holds a value twice: {grid[name]!r}")
    return grid


def _check_names(run: RunFunction, grid: Mapping[str, Any], fixed: Mapping[str, Any]) -> None:
    names = [*fixed, *grid]
    for name in names:
        if not isinstance(name, str):
            raise TypeError(f"the names of parameters must be strings, got {name!r}")
        if name in RESERVED:
            raise ValueError(f"parameter {name!r} has the name of a column of the study: rename it")
    if set(grid) & set(fixed):
        raise ValueError(f"{sorted(set(grid) & set(fixed))} are both in parameters and in fixed")
    try:
        inspect.signature(run).bind(**dict.fromkeys(names))
    except TypeError as error:
        raise TypeError(f"the run function {run.__name__}{inspect.signature(run)} does not take the parameters "
                        f"{', '.join(names)}: {error}") from None


@contextmanager
def _progress_bar(name: str, total: int, done: int, wanted: bool | None) -> Iterator[Any]:
    """Yield a function to call after each run; a bar on standard error if wanted, or None and on a terminal."""
    if not (sys.stderr.isatty() if wanted is None else wanted):
        yield lambda: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True)) as bar:
        task = bar.add_task(name, total=total, completed=done)
        yield lambda: bar.advance(task)
