"""Study: a function and points of its parameters give a table, by way of a durable store.

Checks of what a study is given: names, function, and the order in which runs are computed.
"""

from __future__ import annotations

import contextlib
import inspect
import logging
import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import pandas as pd

from adaptmg import _checks as checks
from adaptmg._fingerprint import Fingerprint, environment, fingerprint
from adaptmg.study.designs import Design, as_design, stored_design
from adaptmg.study.execute import Execute, Finished, Point, RunFunction, Task, commit, in_turn, now
from adaptmg.study.kept_files import Folder
from adaptmg.study.progress import Watch, watched
from adaptmg.study.record import DETAILS, RESERVED, Record, StudyStatus, Value, canonical, parameter_value, reasons
from adaptmg.study.store import Store, uncollected
from adaptmg.study.tables import frame

__all__ = ["Study", "check_names", "check_run_function", "in_order"]

_log = logging.getLogger(__name__)
#: parts of fingerprints as runs of this process left them, and as they were before
_LEFT: dict[tuple[str, str], str] = {}
#: parts that tell what is in files: who changes those while runs go on means it
_OF_FILES = ("depends ", "package ", "adaptmg")


class Study:
    """A parameter sweep.

    Each run is stored when it ends. A study that is run again takes what is stored and computes the rest: points
    never reached, points that failed, and points that are stale, which means that something changed on which a run
    depends: code and values that the run function reads, the numerical sources of adaptmg, a version of a package
    (:mod:`adaptmg._fingerprint` says what is seen and what is not, such as data files and
    environment variables, which ``depends`` can name; :meth:`status` what changed).

    Parameters
    ----------
    run : function
        Called with the parameters by name; returns a flat dict of numbers, strings and bools (numpy scalars are
        fine). Arrays, :class:`adaptmg.MeshArrays`, :class:`adaptmg.Result`, figures of matplotlib and long texts are
        kept as files beside the store, see :meth:`load`. Its own exceptions make a failed row, and the study goes on.
    parameters : mapping of str to sequence, list of points, or design
        The grid: every combination is run, the last parameter changing fastest. Values are numbers, strings, bools,
        None or tuples of those. Other designs: :mod:`adaptmg.study.designs`. None: the points that the store has.
    store : path, optional
        SQLite file, made where missing; several studies can share one. Default: in memory, gone with the study.
    name : str, optional
        Under which the rows are stored; default the name of the function.
    fixed : mapping, optional
        Parameters that are the same in every run. They are part of what a stored run is known by.
    depends : mapping, optional
        What stands for things a run depends on that cannot be seen: a :class:`pathlib.Path` for the content of a
        file, a value for a global or a variable of a closure of that name (which is then not looked at itself, such as
        a cache), a text for anything else.

    Raises
    ------
    TypeError, ValueError
        Before anything runs: for values that cannot be stored, parameters the function does not take or lacks, and
        functions of which one cannot tell on what they depend.

    Examples
    --------
    >>> def run(sweeps, friction):
    ...     return {"work": 2.0 * sweeps + friction}
    >>> table = Study(run, {"sweeps": [1, 2]}, fixed={"friction": 0.5}).run(progress=False)
    >>> table["work"].tolist()
    [2.5, 4.5]
    """

    def __init__(self, run: RunFunction, parameters: Mapping[str, Sequence[Value]] | Design | None = None,
                 store: str | os.PathLike[str] | None = None, *, name: str | None = None,
                 fixed: Mapping[str, Value] | None = None, depends: Mapping[str, Any] | None = None) -> None:
        check_run_function(run)
        self._function, self._depends = run, dict(depends or {})
        self.fixed = {key: parameter_value(key, value) for key, value in (fixed or {}).items()}
        self.name = run.__name__ if name is None else checks.boundary_name("name", name)
        self.design: Design | None = None if parameters is None else as_design("parameters", parameters)
        if self.design is not None:
            check_names(run, self.design.names, self.fixed)
        self._fingerprint()
        self._store = Store(store)
        self._files = Folder(self._store.path)
        if self.design is None:
            self.design = stored_design(self._store, self.name, self.fixed)
            check_names(run, self.design.names, self.fixed)

    def __len__(self) -> int:
        return len(self.design)

    def __repr__(self) -> str:
        return f"Study {self.name!r} of {len(self)} runs ({self.design!r})"

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that vary."""
        return self.design.names

    def points(self) -> list[Point]:
        """The parameters of every run, the fixed ones too, in the order of the design."""
        return [{**self.fixed, **point} for point in self.design.points()]

    def add(self, design: Mapping[str, Sequence[Value]] | Design | Sequence[Mapping[str, Value]]) -> Study:
        """Add points, which the store remembers: they are there when the study is opened without parameters.

        Parameters
        ----------
        design : mapping, list of points, or design
            With the same parameters. Points that are there already are left out.

        Returns
        -------
        Study
            This one.
        """
        more = as_design("design", design)
        self.design = self.design + more
        self._store.add_points(self.name, (canonical({**self.fixed, **point}) for point in more.points()))
        return self

    def run(self, progress: bool | Callable[[Watch], None] | None = None, *, workers: int | None = None,
            scheduler: Any = None, rerun: bool = False, retry_failed: bool = True, throw: bool = False,
            limit_s: float | None = None, memory_limit: float | None = None,
            cost: Callable[[Point], float] | str | None = None) -> pd.DataFrame:
        """Compute what the store does not have, and return the table.

        Parameters
        ----------
        progress : bool or callable, optional
            Show a progress bar on standard error; default: only on a terminal. Without one each run is a line of the
            log (``adaptmg.study``, INFO). A function is called after each run with an object that knows ``name``,
            ``total``, ``done`` and ``failed``, and says what is left by ``words()``.
        workers : int, optional
            Processes on this machine that compute runs, one thread each (dask.distributed). Default: this process.
        scheduler : str, distributed.Client or cluster, optional
            A cluster of dask to compute on, such as ``"tcp://host:8786"``, or the client of
            :func:`adaptmg.study.local_cluster`, which many studies can share.
        rerun : bool
            Compute every point anew.
        retry_failed : bool
            Compute points again that failed.
        throw : bool
            Raise the exception of a run that fails (the row is stored all the same) instead of going on.
        limit_s : float, optional
            Seconds after which a run is stopped and recorded as failed. Needs workers.
        memory_limit : float, optional
            Bytes that the process of a run may hold until it is stopped and recorded as failed. Needs workers.
        cost : callable or str, optional
            Long runs first: a function of a point that grows with the time its run takes, the name of a parameter that
            does, or of a result or ``"seconds"`` of an earlier call.

        Returns
        -------
        pandas.DataFrame
            One row a run in the order of the design; see :meth:`table`.

        Raises
        ------
        KeyboardInterrupt
            On Ctrl-C: what is done is stored, and no process is left.
        OSError, ValueError
            If the store cannot be written, see :class:`adaptmg.study.store.Store`; nothing that is done is lost.
        RuntimeError
            If a worker has another adaptmg, other packages, or lacks a module.
        """
        if not (progress is None or isinstance(progress, bool) or callable(progress)):
            raise TypeError(f"progress must be True, False, None or a function, got {checks.shown(progress)}")
        if workers is not None and scheduler is not None:
            raise ValueError("give workers (processes of this machine) or scheduler (a cluster), not both")
        limits = {"limit_s": None if limit_s is None else checks.positive("limit_s", limit_s),
                  "memory_limit": None if memory_limit is None else int(checks.positive("memory_limit", memory_limit))}
        here = workers is None and scheduler is None
        if here and any(value is not None for value in limits.values()):
            raise ValueError("limit_s and memory_limit need workers=1 or more: a run in this process cannot be stopped")
        if workers is not None:
            checks.integer("workers", workers, minimum=1)
        found, versions, stored = self._fingerprint(), environment(), self._store.get(self.name)
        points = self.points()
        todo = [point for point in points
                if rerun or self._state(stored.get(canonical(point)), found, versions)
                not in (("done",) if retry_failed else ("done", "failed"))]
        todo = in_order(todo, cost, stored)
        _log.info("study %s: %d of %d runs to compute", self.name, len(todo), len(points))
        if todo:
            task = Task(self._function, found, tuple(self._depends), **limits)
            with contextlib.nullcontext(in_turn) if here else _on_workers(workers, scheduler, len(todo)) as execute:
                self._compute(execute, task, todo, len(points), progress, throw, found, versions, stored)
        return self._table(found, versions, False)

    def table(self, details: bool = False) -> pd.DataFrame:
        """What the store has, without running anything.

        Parameters
        ----------
        details : bool
            Also tries, peak_memory (bytes), started, finished (UTC), machine, commit, traceback.

        Returns
        -------
        pandas.DataFrame
            One row a run in the order of the design: parameters, results, ``status`` ('done', 'failed', 'stale',
            'missing'), ``seconds`` and ``error``. Results that are kept as files show the name of the file.
            ``attrs`` holds the name of the study and the fixed parameters.
        """
        return self._table(self._fingerprint(), environment(), details)

    def status(self) -> StudyStatus:
        """How many runs are done, failed, stale and missing, and why those are stale that are."""
        found, versions, stored = self._fingerprint(), environment(), self._store.get(self.name)
        counts = dict.fromkeys(("done", "failed", "stale", "missing"), 0)
        stale, errors = [], {}
        for point in self.points():
            record = stored.get(canonical(point))
            state = self._state(record, found, versions)
            counts[state] += 1
            if state == "stale":
                stale.append(record)
            elif state == "failed":
                errors[record.error] = errors.get(record.error, 0) + 1
        return StudyStatus(name=self.name, **counts, errors=errors,
                      reasons=reasons(stale, found, versions, self._store.origins()))

    def load(self, row: int | Mapping[str, Any] | pd.Series, name: str | None = None) -> Any:
        """What a run returned that is kept as files.

        Parameters
        ----------
        row : int, mapping or pandas.Series
            Number of the row in :meth:`table`, the row itself, or the parameters of the run.
        name : str, optional
            Of the result.

        Returns
        -------
        dict, or the result of that name
            Arrays, meshes, results of solvers and texts as they were; of a figure the path of its SVG file.
        """
        if isinstance(row, Mapping | pd.Series):
            point = {**self.fixed, **{key: parameter_value(key, row[key]) for key in self.design.names}}
        else:
            points = self.points()
            point = points[checks.integer("row", row, maximum=len(points) - 1)]
        record = self._store.get(self.name).get(canonical(point))
        if record is None or not record.files:
            raise ValueError(f"the run {checks.shown(canonical(point))} "
                             + ("is not stored" if record is None else "keeps no files"))
        if name is None:
            return {key: self._files.read(path) for key, path in record.files.items()}
        if name not in record.files:
            raise ValueError(f"the run keeps no file {name!r}{checks.suggestion(name, record.files)}; it keeps "
                             f"{', '.join(record.files)}")
        return self._files.read(record.files[name])

    def _compute(self, execute: Execute, task: Task, todo: list[Point], total: int,
                 bar: bool | Callable[[Watch], None] | None, throw: bool, found: Fingerprint,
                 versions: dict[str, str], stored: Mapping[str, Record]) -> None:
        """Run, and store what comes as it comes."""
        running = lambda: getattr(execute, "running", 1)  # noqa: E731
        runs = execute(task, todo)
        try:
            with watched(self.name, total, total - len(todo), running, bar) as watch:
                for batch in runs:
                    records = [self._record(point, outcome, found, versions) for point, outcome in batch]
                    self._put(records, found)
                    for (point, outcome), record in zip(batch, records, strict=True):
                        old = stored.get(canonical(point))
                        self._files.remove({} if old is None else old.files, record.files)
                        watch.finished({name: point[name] for name in self.design.names}, outcome)
                        if throw and outcome.error:
                            raise outcome.exception or RuntimeError(outcome.error)
        finally:
            runs.close()
            self._store.flush()
            self._learn(found)

    def _put(self, records: list[Record], found: Fingerprint) -> None:
        """Store rows; OSError if their files could not be put beside them, when the rows are there."""
        try:
            self._store.put_all(self.name, records, found.parts)
        except (OSError, ValueError) as error:
            if not (told := self._files.told()):
                raise
            raise type(error)(f"{error}. {told}") from error
        if told := self._files.told():
            raise OSError(told)

    def _record(self, point: Point, outcome: Finished, found: Fingerprint, versions: dict[str, str]) -> Record:
        files = self._files.write(self.name, canonical(point), outcome.packed)
        return Record(parameters=point, status="failed" if outcome.error else "done", results=outcome.results | files,
                      error=outcome.error, traceback=outcome.traceback, seconds=outcome.seconds, code=found.code,
                      versions=versions, finished=now(), started=outcome.started, machine=outcome.machine,
                      peak_memory=outcome.peak_memory, tries=outcome.tries, commit=commit(), files=files)

    def _fingerprint(self) -> Fingerprint:
        """What a run depends on now; a value that runs left behind counts as the one they found."""
        found = fingerprint(self._function, self._depends)
        return Fingerprint({name: _LEFT.get((name, value), value) for name, value in found.parts.items()})

    def _learn(self, before: Fingerprint) -> None:
        """Remember values that changed while runs went on in this process: lists they wrote to, caches."""
        with contextlib.suppress(TypeError):
            after = fingerprint(self._function, self._depends).parts
            _LEFT.update({(name, after[name]): value for name, value in before.parts.items()
                          if name in after and after[name] != value and not name.startswith(_OF_FILES)})

    def _state(self, record: Record | None, found: Fingerprint, versions: Mapping[str, str]) -> str:
        if record is None:
            return "missing"
        return record.status if record.code == found.code and record.versions == versions else "stale"

    def _table(self, found: Fingerprint, versions: dict[str, str], details: bool) -> pd.DataFrame:
        with uncollected():
            stored = self._store.get(self.name)
            records = [(point, stored.get(canonical({**self.fixed, **point}))) for point in self.design.points()]
            rows = [(point, record, self._state(record, found, versions)) for point, record in records]
            table = frame(self.design.names, rows, details)
        table.attrs = {"study": self.name, "fixed": dict(self.fixed)}
        return table


@contextmanager
def _on_workers(workers: int | None, scheduler: Any, runs: int) -> Iterator[Execute]:
    """An executor on dask, which is loaded only here."""
    from adaptmg.study.cluster import opened

    with opened(workers, scheduler, runs) as execute:
        yield execute


Cost = Callable[[Point], float] | str


def check_run_function(run: Any) -> None:
    """TypeError for what is no plain function: of other callables one cannot tell what they depend on."""
    if not inspect.isfunction(run):
        raise TypeError(f"run must be a plain function (def), got {run!r}; give constants with fixed={{...}}")
    if inspect.iscoroutinefunction(run) or inspect.isgeneratorfunction(run) or inspect.isasyncgenfunction(run):
        raise TypeError(f"run must return a dict, but {run.__name__} is a generator or a coroutine")


def check_names(run: RunFunction, names: Sequence[str], fixed: Mapping[str, Any]) -> None:
    """Names that are taken twice, or that the function does not take."""
    for name in (*fixed, *names):
        if not isinstance(name, str):
            raise TypeError(f"the names of parameters must be strings, got {checks.shown(name)}")
        if name in RESERVED or name in DETAILS:
            raise ValueError(f"parameter {name!r} has the name of a column of the study: rename it")
    if set(names) & set(fixed):
        raise ValueError(f"{sorted(set(names) & set(fixed))} are both in parameters and in fixed")
    given = [*fixed, *names]
    try:
        inspect.signature(run).bind(**dict.fromkeys(given))
    except TypeError as error:
        raise TypeError(f"the run function {run.__name__}{inspect.signature(run)} does not take the parameters "
                        f"{', '.join(given)}: {error}") from None


def in_order(points: list[Point], cost: Cost | None, stored: Mapping[str, Record]) -> list[Point]:
    """The most expensive runs first, so that none of them is started when the others are done."""
    if cost is None or not points:
        return points
    if not (callable(cost) or isinstance(cost, str)):
        raise TypeError(f"cost must be a function of a point, or the name of a column, got {checks.described(cost)}")

    def of(point: Point) -> float:
        if callable(cost):
            return checks.number("cost", cost(dict(point)))
        if cost in point:
            return checks.number(f"cost: parameter {cost!r}", point[cost])
        record = stored.get(canonical(point))
        value = None if record is None else record.seconds if cost == "seconds" else record.results.get(cost)
        # what is not known may be long
        return float(value) if isinstance(value, int | float) and not math.isnan(value) else math.inf

    return sorted(points, key=of, reverse=True)
