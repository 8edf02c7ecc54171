"""Execution of runs: the seam between a study and whatever computes its rows.

An executor takes a task (the run function and its limits) and the points to compute, and yields what is finished as
lists of ``(point, outcome)``, in any order. The study stores each list when it comes, so what was yielded is never
lost. :func:`in_turn` computes in this process; :mod:`adaptmg.study.cluster` on the workers of dask.

The most memory that a process held since a moment, as the system counts it.

The commit of adaptmg, where it runs from a git repository; read from its files, as git need not be installed.
"""

from __future__ import annotations

import platform
import sys
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from adaptmg._fingerprint import Fingerprint
from adaptmg._text import printable
from adaptmg.study.kept_files import Packed, pack
from adaptmg.study.record import MOST_ERROR, MOST_TRACEBACK, Scalar, Value, bounded, check_size, plain_results

__all__ = ["Execute", "Finished", "Point", "RunFunction", "Task", "commit", "compute", "error_text", "forget_peak",
           "held_memory", "in_turn", "peak_memory"]

Point = dict[str, Value]
RunFunction = Callable[..., Any]


@dataclass(frozen=True)
class Task:
    """What is to be done at each point."""

    function: RunFunction  # the run function
    fingerprint: Fingerprint  # what it depends on
    depends: tuple[str, ...] = ()  # names that were left out of that, see Study
    limit_s: float | None = None  # seconds after which a run is stopped
    memory_limit: int | None = None  # bytes that the process of a run may hold


@dataclass(frozen=True)
class Finished:
    """What came of one run."""

    results: dict[str, Scalar] = field(default_factory=dict)  # empty if it failed
    packed: dict[str, Packed] = field(default_factory=dict)
    error: str = ""  # type and text of the exception, empty if it did not fail
    traceback: str = ""
    exception: BaseException | None = None  # the exception itself, where it can be had
    seconds: float = 0.0
    peak_memory: int = 0
    started: str = ""
    machine: str = ""
    tries: int = 1


Execute = Callable[[Task, Sequence[Point]], Iterator[list[tuple[Point, Finished]]]]


def compute(function: RunFunction, point: Point, interruptible: bool = True) -> Finished:
    """One run. Whatever the function raises, or results that cannot be stored, are part of the outcome.

    ``interruptible``: but for KeyboardInterrupt, which is Ctrl-C where a user sits.
    """
    started = now()
    forget_peak()
    begin = time.perf_counter()
    try:
        returned = function(**point)
        seconds = time.perf_counter() - begin
        results, packed = _sorted_out(returned, point)
    except BaseException as error:  # of sys.exit, asyncio, or a class of the user's
        if interruptible and isinstance(error, KeyboardInterrupt):
            raise
        return Finished(error=error_text(error), traceback=_trace(error), exception=error,
                        seconds=time.perf_counter() - begin, peak_memory=peak_memory(), started=started,
                        machine=platform.node())
    return Finished(results, packed, seconds=seconds, peak_memory=peak_memory(), started=started,
                    machine=platform.node())


def in_turn(task: Task, points: Sequence[Point]) -> Iterator[list[tuple[Point, Finished]]]:
    """Run after run, in this process."""
    for point in points:
        yield [(point, compute(task.function, point))]


def now() -> str:
    """UTC, ISO 8601."""
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def error_text(error: BaseException) -> str:
    """Type and text of an exception, bounded, whatever it does when it is asked for its text."""
    try:
        text = str(error)
    except BaseException as worse:
        text = f"<its text cannot be had: {type(worse).__name__}>"
    return bounded(printable(f"{type(error).__name__}: {text}"), MOST_ERROR)


def _trace(error: BaseException) -> str:
    try:
        text = "".join(traceback.format_exception(error))
    except BaseException as worse:
        text = f"<the traceback cannot be had: {type(worse).__name__}>"
    return bounded(printable(text), MOST_TRACEBACK)


def _sorted_out(returned: Any, point: Point) -> tuple[dict[str, Scalar], dict[str, Packed]]:
    """Results that go into the row, and those that are kept as files (empty texts in the row for now)."""
    packed = {}
    if isinstance(returned, Mapping):
        found = {name: pack(value) for name, value in returned.items()}
        packed = {name: item for name, item in found.items() if item is not None}
        returned = {name: "" if name in packed else value for name, value in returned.items()}
    results = plain_results(returned, point)
    check_size(results)
    return results, packed


def forget_peak() -> None:
    """Count the peak anew from here, where the system can (Linux); elsewhere it stays that of the process."""
    try:
        with open("/proc/self/clear_refs", "w", encoding="ascii") as file:
            file.write("5")
    except OSError:
        return


def peak_memory() -> int:
    """The peak, bytes; 0 where the system does not say."""
    if (told := _told_by_linux("VmHWM")) is not None:
        return told
    try:
        import resource
    except ImportError:
        return 0
    # Linux counts in units of 1024 bytes, macOS in bytes
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def held_memory() -> int:
    """What the process holds now, bytes; 0 where the system does not say."""
    if (told := _told_by_linux("VmRSS")) is not None:
        return told
    try:
        import psutil
    except ImportError:
        return 0
    return psutil.Process().memory_info().rss


def _told_by_linux(name: str) -> int | None:
    """A line of the status of this process, bytes; None elsewhere."""
    try:
        with open("/proc/self/status", encoding="ascii", errors="replace") as file:
            for line in file:
                if line.startswith(f"{name}:"):
                    return 1024 * int(line.split()[1])
    except (OSError, ValueError, IndexError):
        pass
    return None


@cache
def commit() -> str:
    """Hexadecimal, empty where there is no repository."""
    try:
        return _head(Path(__file__).resolve().parents[2])
    except (OSError, ValueError):
        return ""


def _head(root: Path) -> str:
    git = root / ".git"
    if git.is_file():  # a working tree beside its repository
        git = root / git.read_text(encoding="utf-8").removeprefix("gitdir:").strip()
    if not git.is_dir():
        return ""
    head = (git / "HEAD").read_text(encoding="utf-8").strip()
    if not head.startswith("ref:"):
        return head
    name = head.removeprefix("ref:").strip()
    common = git / "commondir"
    base = git / common.read_text(encoding="utf-8").strip() if common.is_file() else git
    for place in (git, base):
        if (place / name).is_file():
            return (place / name).read_text(encoding="utf-8").strip()
    for line in (base / "packed-refs").read_text(encoding="utf-8").splitlines():
        if line.endswith(f" {name}"):
            return line.split()[0]
    return ""
