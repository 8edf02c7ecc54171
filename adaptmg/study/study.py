"""Study: a function and points of its parameters give a table, by way of a durable store."""

from __future__ import annotations

import contextlib
import inspect
import logging
import math
import os
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from datetime import timedelta
from typing import TYPE_CHECKING

import pandas as pd

from adaptmg import _checks as checks
from adaptmg._text import printable, say
from adaptmg.solver.fingerprint import Fingerprint, environment
from adaptmg.study.designs import DesignLike, Point, Value, as_design, canonical, parameter_value
from adaptmg.study.execute import (
    Done,
    RunFunction,
    Task,
    commit,
    in_turn,
    now,
    study_fingerprint,
)
from adaptmg.study.store import Record, Store, new_owner, unpack
from adaptmg.study.tables import frame

if TYPE_CHECKING:
    from distributed import Client
    from distributed.deploy.cluster import Cluster

    from adaptmg.study.store import Kept

_log = logging.getLogger("adaptmg.study")
Cost = Callable[[Point], float] | str
#: a point, and what is stored of it
Stored = tuple[Point, Record | None]
#: reasons that are listed
_MOST = 12
Progress = bool | Callable[["Watch"], None] | None
#: seconds of runs that this process claims ahead of others that compute the same study
_AHEAD_S = 0.25


@dataclass(frozen=True, kw_only=True)
class StudyStatus:
    """Counts of the runs of a study, and why runs are stale or failed.

    Examples
    --------
    >>> study = am.Study(lambda n: {"square": n * n}, {"n": [1, 2]})
    >>> study.status().missing
    2
    """

    name: str  # of the study
    done: int  # stored and valid
    failed: int  # stored, valid and failed
    stale: int  # stored for another state of code, values or packages
    missing: int
    reasons: dict[str, int] = field(default_factory=dict)  # why runs are stale, with their number
    errors: dict[str, int] = field(default_factory=dict)  # errors of failed runs, with their number

    @property
    def total(self) -> int:
        """Return the number of runs of the study."""
        return self.done + self.failed + self.stale + self.missing

    def __repr__(self) -> str:
        lines = [
            f"Study {self.name!r}: {self.total} runs: {self.done} done, {self.failed} failed, {self.stale} stale, "
            f"{self.missing} missing"
        ]
        for title, counts in (("stale", self.reasons), ("failed", self.errors)):
            lines += [
                f"  {title}: {text} ({count})" for text, count in Counter(counts).most_common(_MOST)
            ]
        return "\n".join(lines)


class Study:
    """A parameter sweep.

    Each run is stored when it ends. A study that is run again computes only points that are
    missing, that failed, and that are stale (:meth:`status` says why). A row is stale when one of
    these changed: the instructions of a function or class of the user's modules that the run
    function reaches; a value that it reads (globals, closures, defaults, attributes); a name of a
    module that it imports inside or passes on; the numerical sources of adaptmg; the version of a
    package. Comments and docstrings do not count. What cannot be compared (locks, generators,
    ``eval``, docstrings that are read) is refused: ``depends`` names what stands for it. Not seen
    are data files, the environment, time, the state of libraries, packages edited at run time, and
    classes registered with an ABC: ``depends`` can name these, too. A run must not change what it
    reads: a UserWarning names the value.

    Several processes may run a study on one store: each claims a point before it computes it.
    Claims of processes that ended are taken over (of another machine when they have not been
    renewed for a quarter of an hour).

    Where no parameter changes the meshes, grids are made once outside the run function, which takes
    ``grids.with_problem(problem)``; where one does, a function with ``functools.cache`` makes them
    (:doc:`/howto/study`).

    Parameters
    ----------
    run : function
        Called with the parameters by name; returns a flat dict of numbers, strings and bools, or
        members of an enumeration (``result.status``), of which the name is stored. Arrays,
        :class:`adaptmg.MeshArrays`, :class:`adaptmg.Result`, and figures of matplotlib are kept
        apart in the store, see :meth:`load`. An exception makes a failed row, and the study goes
        on. Names that a study gives its own columns: see :meth:`table`.
    parameters : mapping of str to sequence, list or pandas.DataFrame of points, or sample
        A mapping is a grid: every combination, the last parameter changing fastest. A point is a
        mapping of names to values and stands there once. Samples are :class:`Random`,
        :class:`LatinHypercube` and :class:`Sobol`. Values are numbers, strings, bools, None or
        tuples of those.
    store : path, optional
        SQLite file, made where missing; several studies can share one. Default: in memory, gone
        with the study.
    name : str, optional
        Under which the rows are stored; default the name of the function.
    fixed : mapping, optional
        Parameters that are the same in every run.
    depends : mapping, optional
        Values by name for dependencies that cannot be seen: a :class:`pathlib.Path` for the content
        of a file, a value in place of a global or a variable of a closure of that name, a text for
        anything else.

    Examples
    --------
    >>> def run(sweeps, friction):
    ...     return {"work": 2.0 * sweeps + friction}
    >>> table = Study(run, {"sweeps": [1, 2]}, fixed={"friction": 0.5}).run(progress=False)
    >>> table["work"].tolist()
    [2.5, 4.5]
    """

    def __init__(
        self,
        run: RunFunction,
        parameters: DesignLike,
        store: str | os.PathLike[str] | None = None,
        *,
        name: str | None = None,
        fixed: Mapping[str, Value] | None = None,
        depends: Mapping[str, object] | None = None,
    ) -> None:
        self._function = run
        self._depends = checks.mapping(
            "depends", {} if depends is None else depends, "names to what stands for them"
        )
        self._fingerprint()  # raises here, not in the first run, where a dependency cannot be seen
        if (
            inspect.iscoroutinefunction(run)
            or inspect.isgeneratorfunction(run)
            or inspect.isasyncgenfunction(run)
        ):
            raise TypeError(
                f"run must return a dict, but {run.__name__} is a generator or a coroutine"
            )
        given = checks.mapping("fixed", {} if fixed is None else fixed, "names to values")
        self.fixed = {key: parameter_value(key, value) for key, value in given.items()}
        self.name = run.__name__ if name is None else checks.boundary_name("name", name)
        self.design = as_design(parameters)
        _check_names(run, self.design.names, self.fixed)
        self._store = Store(store)

    def __len__(self) -> int:
        return len(self.design)

    def __repr__(self) -> str:
        return f"Study {self.name!r} of {len(self)} runs ({self.design!r})"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Return the names of the parameters that vary."""
        return self.design.names

    def points(self) -> list[Point]:
        """Return the parameters of every run, the fixed ones too, in the order of the design."""
        return [{**self.fixed, **point} for point in self.design.points()]

    def run(
        self,
        progress: Progress = None,
        *,
        workers: int | None = None,
        scheduler: str | Client | Cluster | None = None,
        rerun: bool = False,
        retry_failed: bool = True,
        throw: bool = False,
        limit_s: float | None = None,
        memory_limit: float | None = None,
        cost: Cost | None = None,
    ) -> pd.DataFrame:
        """Compute the runs that the store does not have, and return the table.

        As of :meth:`table`. On Ctrl-C finished runs are stored, no process is left, and the message
        of the KeyboardInterrupt has the number of stored runs. OSError or ValueError if the store
        cannot be written, RuntimeError for a worker with other packages or without a module.

        Parameters
        ----------
        progress : bool or callable, optional
            Show a progress bar on standard error; default: where that is a terminal. Each run is a
            line of the log, too (``adaptmg.study``, INFO). A function is called after each run with
            an object that has ``name``, ``total``, ``done``, ``failed`` and ``words()``.
        workers : int, optional
            Processes on this machine that compute runs, one thread each (dask.distributed).
            Default: this process.
        scheduler : str, distributed.Client or cluster, optional
            A cluster of dask, such as ``"tcp://host:8786"``, or the client of
            :func:`adaptmg.study.local_cluster`.
        rerun : bool
            Compute every point again.
        retry_failed : bool
            Compute points again that failed.
        throw : bool
            Raise the exception of a run that fails (its row is stored) instead of going on.
        limit_s : float, optional
            Seconds after which a run is stopped and recorded as failed. Needs workers.
        memory_limit : float, optional
            Bytes that the process of a run may hold until it is stopped and recorded as failed.
            Needs ``workers``; the workers of a cluster have their own (``dask worker
            --memory-limit``).
        cost : callable or str, optional
            Long runs first: a function of a point that grows with the time its run takes, the name
            of a parameter that does, or of a result or ``"seconds"`` of an earlier call.
        """
        if not (progress is None or isinstance(progress, bool) or callable(progress)):
            raise TypeError(
                f"progress must be True, False, None or a function, got {checks.shown(progress)}"
            )
        if workers is not None and scheduler is not None:
            raise ValueError(
                "give workers (processes of this machine) or scheduler (a cluster), not both"
            )
        limit_s = None if limit_s is None else checks.positive("limit_s", limit_s)
        memory = (
            None if memory_limit is None else int(checks.positive("memory_limit", memory_limit))
        )
        if workers is None and (memory is not None or (limit_s is not None and scheduler is None)):
            raise ValueError(
                "limit_s and memory_limit need workers=1 or more: runs in this process cannot be stopped, "
                "and workers of a cluster have their own limit (dask worker --memory-limit)"
            )
        if workers is not None:
            checks.integer("workers", workers, minimum=1)
        for name, flag in (("rerun", rerun), ("retry_failed", retry_failed), ("throw", throw)):
            checks.flag(name, flag)
        code = self._fingerprint()
        rows = self._rows(code)
        valid = ("done",) if retry_failed else ("done", "failed")
        todo = in_order(
            {
                canonical(point): (point, record)
                for point, record, state in rows
                if rerun or state not in valid
            },
            cost,
        )
        _log.info("study %s: %d of %d runs to compute", self.name, len(todo), len(rows))
        if todo:
            if workers is None and scheduler is None:
                executor = contextlib.nullcontext(in_turn)
            else:
                from adaptmg.study.cluster import opened

                if workers is not None and progress is not False:
                    say(f"adaptmg: starting workers: {min(workers, len(todo))}")
                executor = opened(workers, scheduler, len(todo), memory)
            task = Task(self._function, code, tuple(self._depends), limit_s)
            owner = new_owner()
            try:
                with self._store.claims_of(owner), executor as execute:
                    runs = execute(task, self._claimed(todo, owner))
                    self._compute(runs, code, len(todo), progress, throw)
            except KeyboardInterrupt:
                n_stored = sum(state in ("done", "failed") for _, _, state in self._rows(code))
                raise KeyboardInterrupt(
                    f"study {self.name}: {n_stored} of {len(rows)} runs are stored; run() computes the rest"
                ) from None
        table = self._table(code)
        done = table[table.attrs["columns"]["status"]] == "done"
        if isinstance(cost, str) and done.any() and cost not in table:
            raise ValueError(
                f"cost must name a parameter or a result, got {cost!r}"
                f"{checks.suggestion(cost, map(str, table.columns))}; the runs are stored"
            )
        return table

    def table(self, details: bool = False) -> pd.DataFrame:
        """Return the runs in the store, without computing any: one row a run in the order of the
        design.

        Columns are parameters, results (its kind where one is kept apart), ``status`` ('done',
        'failed', 'stale', 'missing'), ``seconds`` (wall time without compiling) and ``error``; with
        ``details`` also peak_memory (bytes), started, finished (UTC), machine, commit, traceback.
        Where a parameter or a result has such a name, the column of the study is ``run_status``,
        say. ``attrs`` has the study's name, its fixed parameters and, as ``columns``, those
        names.

        Examples
        --------
        >>> study = am.Study(lambda n: {"inverse": 1 / n}, {"n": [1, 0]}, name="inverse")
        >>> table = study.run(progress=False)
        >>> study.table()[["n", "inverse", "status"]].values.tolist()
        [[1, 1.0, 'done'], [0, nan, 'failed']]
        """
        return self._table(self._fingerprint(), checks.flag("details", details))

    def status(self) -> StudyStatus:
        """Return how many runs are done, failed, stale and missing, and why runs are stale."""
        code = self._fingerprint()
        reasons = Counter()
        errors = Counter()
        origins = self._store.origins()
        rows = self._rows(code)
        for _, record, state in rows:
            if state == "stale" and record is not None:
                changes = code.differences(origins.get(record.code, {}))
                reasons.update(changes if record.code else [record.error])  # of no code: damaged
            elif state == "failed" and record is not None:
                errors[record.error] += 1
        counts = Counter(state for _, _, state in rows)
        return StudyStatus(
            name=self.name,
            errors=dict(errors),
            reasons=dict(reasons),
            **{state: counts[state] for state in ("done", "failed", "stale", "missing")},
        )

    def load(
        self, row: int | Mapping[str, Value] | pd.Series, name: str | None = None
    ) -> Kept | dict[str, Kept]:
        """Return the results of a run that are kept apart from its row, by name, or the one called
        ``name``.

        ``row`` is the number of the row in :meth:`table`, the row itself, or the parameters of the
        run. Of a figure the text of its SVG is returned. Stale runs are loaded, too:
        :meth:`table` and :meth:`status` say which they are. ValueError for a run that keeps
        nothing of that name."""
        if isinstance(row, Mapping | pd.Series):
            if missing := [key for key in self.design.names if key not in row]:
                raise ValueError(f"row must have all parameters, got none of {', '.join(missing)}")
            point = {
                **self.fixed,
                **{key: parameter_value(key, row[key]) for key in self.design.names},
            }
        else:
            points = self.points()
            point = points[checks.integer("row", row, maximum=len(points) - 1)]
        items = self._store.kept(self.name, canonical(point))
        if name is None and items:
            return {key: unpack(item) for key, item in items.items()}
        if name not in items:
            asked = "" if name is None else f", not {name}{checks.suggestion(name, items)}"
            record = self._store.one(self.name, canonical(point))
            reason = "it is not in the store" if record is None else record.error or "it is done"
            raise ValueError(
                f"the run {checks.shown(canonical(point))} keeps "
                f"{', '.join(items) or f'nothing ({reason})'}{asked}"
            )
        return unpack(items[name])

    def _compute(
        self, runs: Done, code: Fingerprint, count: int, progress: Progress, throw: bool
    ) -> None:
        """Store each of ``count`` runs when it ends. ``throw``: an exception in one goes on to the caller."""
        watch = Watch(self.name, len(self), len(self) - count)
        try:
            with _shown(watch, progress) as show:
                for number, batch in enumerate(runs):
                    refused = next((outcome for outcome in batch if outcome.refused), None)
                    # results of a wrong form among the first ones end the study
                    if number == 0 and refused is not None:
                        raise ValueError(
                            f"the run function of study {self.name} cannot be used: "
                            f"{refused.exception or refused.record.error}"
                        )
                    origin = {
                        "code": code.code,
                        "versions": environment(),
                        "finished": now(),
                        "commit": commit(),
                    }
                    self._store.put(
                        self.name,
                        [replace(outcome.record, **origin) for outcome in batch],
                        code.parts,
                        [outcome.packed for outcome in batch],
                    )
                    for outcome in batch:
                        record = outcome.record
                        watch.done += 1
                        watch.failed += bool(record.error)
                        show()
                        self._log_end(record, watch)
                        if throw and record.error:
                            raise outcome.exception or RuntimeError(record.error)
        finally:
            runs.close()
            self._warn_of_changes(code)

    def _log_end(self, record: Record, watch: Watch) -> None:
        """Log how a run ended."""
        end = (
            f"failed: {printable(record.error)}"
            if record.error
            else f"done in {record.seconds:.3g} s; {watch.words()}"
        )
        _log.log(
            logging.WARNING if record.error else logging.INFO,
            "study %s: [%d/%d] %s %s",
            self.name,
            watch.done,
            watch.total,
            ", ".join(f"{name}={record.parameters[name]!r}" for name in self.design.names),
            end,
        )

    def _claimed(self, todo: Mapping[str, Stored], owner: str) -> Iterator[Point | None]:
        """Yield the points that this process claims, in rounds over those that are left; None after a
        round in which other processes held all of them. Points that another process has stored
        meanwhile are left out."""
        left = list(todo.items())
        batch_size = 1
        while left:
            held = []  # by other processes
            at = 0
            while at < len(left):
                batch = left[at : at + batch_size]
                at = at + batch_size
                begin = time.perf_counter()
                claims = self._store.claim(self.name, [key for key, _ in batch], owner)
                for item, ours in zip(batch, claims, strict=True):
                    key, (point, stored) = item
                    if not ours:
                        held.append(item)
                    elif self._store.one(self.name, key) == stored:
                        yield point
                    else:  # computed by another one since the list was made
                        self._store.release(owner, key)
                # a claim takes a write to the disk: several runs at a time where these, which are taken
                # while points are yielded, are short
                is_short = time.perf_counter() - begin < _AHEAD_S
                batch_size = min(2 * batch_size, 64) if is_short else 1
            if len(held) == len(left):
                yield None
            left = held

    def _fingerprint(self) -> Fingerprint:
        """Return what the results depend on now; TypeError where that cannot be seen."""
        return study_fingerprint(self._function, self._depends)

    def _warn_of_changes(self, before: Fingerprint) -> None:
        """Warn of values that changed while runs went on in this process: rows depend on the order
        of the runs."""
        # TypeError: a run has put a value in place that cannot be compared. The next call of run says so
        with contextlib.suppress(TypeError):
            changes = [
                text
                for text in self._fingerprint().differences(before.parts)
                if text.startswith("value of ")
            ]
            if changes:
                warnings.warn(
                    f"study {self.name}: {', '.join(changes)} while the runs went on, so that their rows are "
                    "stale: a run must not change what it reads; if the results do not depend on it (a "
                    "cache), name it in depends",
                    UserWarning,
                    stacklevel=4,
                )

    def _rows(self, code: Fingerprint) -> list[tuple[Point, Record | None, str]]:
        """Return the points in the order of the design, each with its record and the state of that:
        "missing", "stale" where the code has changed, or how the run ended."""
        stored = self._store.get(self.name)
        records = [(point, stored.get(canonical(point))) for point in self.points()]
        return [
            (
                point,
                record,
                "missing"
                if record is None
                else record.status
                if record.code == code.code
                else "stale",
            )
            for point, record in records
        ]

    def _table(self, code: Fingerprint, details: bool = False) -> pd.DataFrame:
        """Return the table of all runs by this code; see :func:`frame`."""
        table = frame(self.design.names, self._rows(code), details)
        table.attrs |= {"study": self.name, "fixed": dict(self.fixed)}
        return table


def _check_names(run: RunFunction, names: Sequence[str], fixed: Mapping[str, Value]) -> None:
    """Raise unless the run function takes exactly these parameters and fixed values."""
    if set(names) & set(fixed):
        raise ValueError(f"{sorted(set(names) & set(fixed))} are both in parameters and in fixed")
    arguments = [*fixed, *names]
    try:
        inspect.signature(run).bind(**dict.fromkeys(arguments))
    except TypeError as error:
        raise TypeError(
            f"the run function {run.__name__}{inspect.signature(run)} does not take the parameters "
            f"{', '.join(arguments)}: {error}"
        ) from None


def in_order(todo: dict[str, Stored], cost: Cost | None) -> dict[str, Stored]:
    """Return the points, the most expensive first, so that none of them is started when the others
    are done."""
    if cost is None:
        return todo
    checks.function_or("cost", cost, checks.boundary_name)
    stored = [record.results for _, record in todo.values() if record and record.results]
    named = {"seconds"}.union(*stored, *(point for point, _ in todo.values()))
    if stored and isinstance(cost, str) and cost not in named:
        raise ValueError(
            f"cost must be a function, or the name of a parameter or of a result, got "
            f"{cost!r}{checks.suggestion(cost, named)}"
        )

    def cost_of(item: tuple[str, Stored]) -> float:
        """Return the cost of a point, infinite where it is not known."""
        point, record = item[1]
        if callable(cost):
            return checks.number("cost", cost(dict(point)))
        if cost in point:
            return checks.number(f"cost: parameter {cost!r}", point[cost])
        measured = {} if record is None else {"seconds": record.seconds, **record.results}
        value = measured.get(cost)
        # a run without a record may be long
        return (
            float(value) if isinstance(value, int | float) and not math.isnan(value) else math.inf
        )

    return dict(sorted(todo.items(), key=cost_of, reverse=True))


class Watch:
    """Counts of a running study."""

    def __init__(self, name: str, total: int, done: int) -> None:
        self.name = name
        self.total = total
        self.done = done
        self.failed = 0
        self._before = done
        self._begin = time.monotonic()

    def words(self) -> str:
        """Return failures, runs that are left, and how long these take at the pace so far."""
        left = self.total - self.done
        n_run = self.done - self._before
        seconds = (time.monotonic() - self._begin) / max(n_run, 1) * left
        more = f", about {timedelta(seconds=round(seconds))} more" if n_run and left else ""
        return f"{self.failed or 'none'} failed, {left} left{more}"


@contextmanager
def _shown(watch: Watch, progress: Progress) -> Iterator[Callable[[], None]]:
    """Yield what is to be called after each run: the function of the user, or one that updates a
    bar on standard error; by default only where that is a terminal."""
    if callable(progress):
        yield lambda: progress(watch)
    elif sys.stderr is not None and (sys.stderr.isatty() if progress is None else progress):
        from rich import progress as shown
        from rich.console import Console

        with shown.Progress(
            shown.TextColumn("{task.description}", markup=False),
            shown.BarColumn(24),
            shown.MofNCompleteColumn(),
            shown.TimeElapsedColumn(),
            shown.TextColumn("{task.fields[words]}"),
            console=Console(stderr=True),
        ) as bar:
            task = bar.add_task(
                watch.name, total=watch.total, completed=watch.done, words=watch.words()
            )
            yield lambda: bar.update(task, completed=watch.done, words=watch.words())
    else:
        yield lambda: None
