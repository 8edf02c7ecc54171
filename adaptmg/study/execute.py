"""Execution of one run, in this process or on a worker of dask.

An executor takes a task (the run function and its limits) and the points to compute, and yields
what is finished as lists of outcomes, in any order; the study stores each list when it comes.
:func:`in_turn` computes in this process, :mod:`adaptmg.study.cluster` on workers by
:func:`perform`. A worker is checked once for each run function: it must have the same versions, and
the run function must have the same fingerprint there."""

from __future__ import annotations

import functools
import importlib.metadata
import io
import json
import pickle
import platform
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from enum import Enum
from functools import cache
from pathlib import Path
from typing import Any

from adaptmg import _checks as checks
from adaptmg._machine import peak_memory, reset_peak_memory
from adaptmg.solver.fingerprint import Fingerprint, environment, fingerprint
from adaptmg.study.designs import Point, Scalar, plain
from adaptmg.study.store import Packed, Record, pack

RunFunction = Callable[..., Mapping[str, object]]

#: characters of an error, from its begin, and of a traceback, from its end, that are stored
_MOST_ERROR, _MOST_TRACEBACK = 4_000, 20_000


@dataclass(frozen=True)
class Task:
    """The work to be done at each point."""

    function: RunFunction
    fingerprint: Fingerprint
    depends: tuple[str, ...] = ()  # names that the fingerprint leaves out, see Study
    limit_s: float | None = None  # seconds after which a run is stopped


@dataclass(frozen=True)
class Finished:
    """Outcome of one run."""

    record: Record
    packed: dict[str, Packed] = field(default_factory=dict)  # results that are kept as bytes
    exception: BaseException | None = None  # None where it cannot be sent
    refused: bool = False  # what it returned is not what a study can store


#: points are None while other processes compute those that are left
Done = Generator[list[Finished], None, None]
Execute = Callable[[Task, Iterator[Point | None]], Done]
#: seconds between two looks at what other processes compute
LOOK_S = 0.5


def in_turn(task: Task, points: Iterator[Point | None]) -> Done:
    """Run after run, in this process."""
    if "adaptmg" in task.fingerprint.parts:
        warm()
    for point in points:
        if point is None:
            time.sleep(LOOK_S)
        else:
            yield [compute(task.function, point)]


def compute(function: RunFunction, point: Point, interruptible: bool = True) -> Finished:
    """Compute one run; what the function raises, and results that cannot be stored, are part of the
    outcome. KeyboardInterrupt passes if ``interruptible``: it is Ctrl-C of the user."""
    started = now()
    reset_peak_memory()
    begin = _clock()
    end = None
    results = {}
    packed = {}
    exception = None
    try:
        returned = function(**point)
        end = _clock()
        results, packed = _sorted_out(returned, point)
    except BaseException as error:  # of sys.exit, asyncio, or a class of the user
        if interruptible and isinstance(error, KeyboardInterrupt):
            raise
        exception = error
    failed: dict[str, Any] = (
        {}
        if exception is None
        else {
            "error": error_text(exception),
            "traceback": "".join(traceback.format_exception(exception))[-_MOST_TRACEBACK:],
        }
    )
    record = Record(
        parameters=point,
        status="failed" if failed else "done",
        results=results,
        started=started,
        seconds=(_clock() if end is None else end) - begin,
        peak_memory=peak_memory(),
        machine=platform.node(),
        **failed,
    )
    return Finished(record, packed, exception, isinstance(exception, WrongResults))


def _clock() -> float:
    """Return the seconds of this thread without compiling, which nothing does before numba is
    loaded."""
    if "numba" not in sys.modules:
        return time.perf_counter()
    from adaptmg._numba import clock

    return clock()


class WrongResults(TypeError):
    """A run function returns what cannot be stored."""


def _sorted_out(returned: object, point: Point) -> tuple[dict[str, Scalar], dict[str, Packed]]:
    """Return the results of a run function, checked: numbers, strings, bools and None for the row
    (the name of an enumeration's member), the rest packed."""
    if not isinstance(returned, Mapping):
        raise WrongResults(
            f"the run function must return a dict of numbers, strings and bools, got "
            f"{checks.shown(returned)}"
        )
    results = {}
    packed = {}
    for name, value in returned.items():
        if not isinstance(name, str):
            raise WrongResults(f"the names of results must be strings, got {checks.shown(name)}")
        if name in point:
            raise WrongResults(
                f"result {name!r} has the name of a parameter: rename it (e.g. 'solver_{name}')"
            )
        value = value.name if isinstance(value, Enum) else plain(value)
        if (item := pack(value)) is not None:
            packed[name] = item
            value = item.kind
        if value is not None and type(value) not in (bool, int, float, str):
            raise WrongResults(
                f"result {name!r} must be a number, string, bool or None, got {checks.shown(value)}; "
                "reduce arrays to numbers, or return a numpy array, which is kept"
            )
        results[name] = value
    json.dumps(results)  # whole numbers of thousands of digits fail here, not in the store
    return results, packed


def study_fingerprint(function: RunFunction, depends: Mapping[str, object]) -> Fingerprint:
    """Return the fingerprint on which rows depend: that of the run function, with the versions of Python
    and packages."""
    versions = {f"package {name}": version for name, version in environment().items()}
    return Fingerprint(versions | fingerprint(function, depends).parts)


def now() -> str:
    """Return the time, UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def error_text(error: BaseException) -> str:
    """Return type and text of an exception, bounded, even where its ``__str__`` fails."""
    try:
        text = str(error)
    except BaseException as worse:
        text = f"<its text raises {type(worse).__name__}>"
    return f"{type(error).__name__}: {text}"[:_MOST_ERROR]


@cache
def commit() -> str:
    """Return the commit of adaptmg; empty where it does not lie in a git repository, or git is not
    installed."""
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    try:
        return subprocess.run(
            ["git", "-C", root, "rev-parse", "HEAD"], capture_output=True, text=True, timeout=10
        ).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


# on a worker


class UnfitWorker(RuntimeError):
    """A worker that would not compute what the process of the study would; the message says why."""


@dataclass(frozen=True)
class Order:
    """The order that a worker gets with each run."""

    function: bytes  # the run function, see sent
    identity: dict[str, str]  # of the process of the study
    fingerprint: Fingerprint
    depends: tuple[str, ...]  # names that the fingerprint leaves out


@cache
def identity() -> dict[str, str]:
    """Return the versions on which a run depends, and those of the packages that send it."""
    return environment() | {
        name: importlib.metadata.version(name) for name in ("cloudpickle", "dask", "distributed")
    }


def readied(order: Order) -> RunFunction:
    """Check this process against the one of the study, and unpack the run function. Modules that
    are loaded here may have been edited since, and values that a script set in a module are not
    here: the function would compute something else under the fingerprint of the study."""
    identity_now = identity()
    if different := [
        f"{name} {identity_now.get(name, 'none')} instead of {value}"
        for name, value in order.identity.items()
        if identity_now.get(name) != value
    ]:
        raise UnfitWorker(f"it has {', '.join(different)}")
    try:
        function = pickle.loads(order.function)
    except Exception as error:
        raise UnfitWorker(
            f"it cannot unpack the run function ({error_text(error)}): install what it lacks there, put "
            "it on PYTHONPATH, or send it with client.upload_file"
        ) from error
    fingerprint_now = study_fingerprint(function, dict.fromkeys(order.depends)).seen()
    if changes := fingerprint_now.differences(order.fingerprint.parts):
        raise UnfitWorker(
            f"it would compute something else than this process ({', '.join(changes[:5])}): bring the "
            "same files there and start the worker again; give values that a script sets in a module as "
            "parameters or fixed={...}"
        )
    return function


def check(order: Order) -> None:
    """Raise what :func:`readied` raises."""
    readied(order)


@cache
def warm() -> None:
    """Compile the kernels of the default method, or read them from the cache, before a clock
    starts."""
    import adaptmg as am
    from adaptmg._threads import one_blas_thread

    with one_blas_thread():
        am.solve(
            am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)),
            am.FullMultigrid(),
            throw=False,
        )


def perform(
    function: RunFunction, uses_adaptmg: bool, point: Point, begin: Callable[[], object]
) -> Finished:
    """Compute one run on a worker; ``begin`` is called when its clock starts."""
    import cloudpickle

    if uses_adaptmg:
        warm()
    begin()
    finished = compute(function, point, interruptible=False)
    error = finished.exception
    try:
        sendable = error and cloudpickle.loads(cloudpickle.dumps(error.with_traceback(None)))
    except Exception:  # its text arrives in any case
        sendable = None
    return replace(finished, exception=sendable)


def _cached_again(function: RunFunction, parameters: dict[str, Any]) -> RunFunction:
    return functools.lru_cache(**parameters)(function)


def sent(function: RunFunction) -> bytes:
    """Return a function as bytes: by value what has no module on a worker (scripts, closures), else
    by name."""
    import cloudpickle

    class Pickler(cloudpickle.Pickler):
        """Cached functions of ``__main__`` too, which cloudpickle would look for in the worker's
        ``__main__``."""

        def reducer_override(self, obj: object) -> object:
            if (
                isinstance(obj, functools._lru_cache_wrapper)
                and getattr(obj, "__module__", None) == "__main__"
            ):
                return _cached_again, (obj.__wrapped__, obj.cache_parameters())
            return super().reducer_override(obj)

    buffer = io.BytesIO()
    try:
        Pickler(buffer).dump(function)
    except Exception as error:  # whatever the objects it carries raise
        raise TypeError(
            f"the run function {function.__qualname__} cannot be sent to a worker, as something it reads "
            f"cannot ({type(error).__name__}: {error}): build that inside the function"
        ) from error
    return buffer.getvalue()
