"""What happens on a worker: it is checked and warmed once, then it computes runs under their limits.

Which adaptmg and which packages a process has, so that workers compute what this process would.

Run functions as bytes: by value what has no module on a worker (scripts, notebooks, closures), else by name.
"""

from __future__ import annotations

import faulthandler
import functools
import importlib.metadata
import io
import os
import pickle
import platform
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import cloudpickle

from adaptmg._fingerprint import fingerprint
from adaptmg._runtime import one_blas_thread
from adaptmg.study.execute import Finished, Point, compute, held_memory

__all__ = ["Order", "UnfitWorker", "differences", "identity", "perform", "readied", "received", "sent"]

#: seconds between two looks at the clock and the memory; and for the reason to get away before the process ends
_LOOK_S, LEAVE_S = 0.05, 0.4

Report = Callable[[str], None]


class UnfitWorker(RuntimeError):
    """A worker that would not compute what the process of the study would; the message says why."""


@dataclass(frozen=True)
class Order:
    """What a worker is told with each run."""

    function: bytes  # the run function, see in_worker
    identity: dict[str, str]  # of the process of the study
    code: str  # of the fingerprint
    depends: tuple[str, ...]  # names that it does not look at
    warm: bool  # whether kernels are to be compiled before the first clock starts
    limit_s: float | None = None
    memory_limit: int | None = None


#: how long after its limit a run is ended that lets no other thread look, s
HARD_S = 2.0
_MOST_FUNCTIONS = 32
#: by their bytes and the fingerprint that they were found to have here
_functions: dict[tuple[bytes, str], Callable[..., Any]] = {}
_warmed = False


def readied(order: Order, parts: dict[str, str] | None = None) -> Callable[..., Any]:
    """Check this process against the one of the study, and unpack the function: once for each.

    Modules that are loaded here may have been edited since, and values that the user's script set in a module are not
    here: the function would compute something else, under the fingerprint of the study.
    """
    told = differences(order.identity, identity())
    if told:
        raise UnfitWorker(f"it has {told}")
    known = order.function, order.code
    if known not in _functions:
        try:
            function = received(order.function)
        except ModuleNotFoundError as error:
            raise UnfitWorker(f"it has no module {error.name!r}, which the run function needs: install it there, put "
                              "it on PYTHONPATH, or send it with client.upload_file") from error
        except Exception as error:
            raise UnfitWorker(f"it cannot unpack the run function ({type(error).__name__}: {error})") from error
        here = fingerprint(function, dict.fromkeys(order.depends)).seen()
        if here.code != order.code:
            told = ", ".join(here.differences(parts or {})[:5]) if parts else "see the start of a study"
            raise UnfitWorker(f"it would compute something else than this process ({told}): where files differ, or "
                              "were edited since, bring the same ones there and start the worker again; what a script "
                              "sets in a module does not reach workers: give such values as parameters or fixed={...}")
        while len(_functions) >= _MOST_FUNCTIONS:
            del _functions[next(iter(_functions))]
        _functions[known] = function
    return _functions[known]


def _warm() -> None:
    """Compile the kernels of the default method, or read them from the cache, before a clock runs."""
    global _warmed
    if not _warmed:
        import adaptmg as am

        with one_blas_thread():
            am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)), am.FullMultigrid(), throw=False)
        _warmed = True


def perform(order: Order, point: Point, tries: int, report: Report) -> Finished:
    """One run."""
    function = readied(order)
    if order.warm:
        _warm()
    with _limited(order, report):
        finished = compute(function, point, interruptible=False)
    if finished.exception is not None:
        finished = replace(finished, exception=_sendable(finished.exception))
    return replace(finished, tries=tries)


def _sendable(error: BaseException) -> BaseException | None:
    """The exception, if it comes through; the text of it does in any case."""
    try:
        return cloudpickle.loads(cloudpickle.dumps(error.with_traceback(None)))
    except Exception:
        return None


@contextmanager
def _limited(order: Order, report: Report) -> Iterator[None]:
    """End the process if what happens inside takes too long or too much: Python cannot stop a thread."""
    if order.limit_s is None and order.memory_limit is None:
        yield
        return
    over = threading.Event()
    guard = threading.Thread(target=_watch, args=(order, over, report), daemon=True)
    with open(os.devnull, "w", encoding="ascii") as nowhere:
        if order.limit_s is not None:
            report("")
            # for code that holds Python's lock, so that the other thread cannot look
            faulthandler.dump_traceback_later(order.limit_s + HARD_S, exit=True, file=nowhere)
        guard.start()
        try:
            yield
        finally:
            over.set()
            faulthandler.cancel_dump_traceback_later()
    guard.join()


def _watch(order: Order, over: threading.Event, report: Report) -> None:
    end = time.monotonic() + (order.limit_s if order.limit_s is not None else float("inf"))
    while not over.wait(min(_LOOK_S, max(end - time.monotonic(), 0.001))):
        why = ""
        if order.memory_limit is not None and held_memory() > order.memory_limit:
            why = f"MemoryLimit: stopped as its process held more than memory_limit={order.memory_limit} bytes"
        elif time.monotonic() >= end:
            why = f"TimeLimit: stopped after limit_s={order.limit_s:g} s"
        if why:
            report(why)
            time.sleep(LEAVE_S)
            os._exit(1)


_PACKAGES = ("ngsolve", "numpy", "scipy", "numba", "pyamg", "cloudpickle", "dask", "distributed")


@cache
def identity() -> dict[str, str]:
    """Versions; what is in the modules of adaptmg that a run reaches is part of its fingerprint."""
    import adaptmg

    return {"python": platform.python_version(), "adaptmg": adaptmg.__version__,
            **{name: _version(name) for name in _PACKAGES}}


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return "none"


def differences(wanted: dict[str, str], found: dict[str, str]) -> str:
    """What differs, in words; empty if nothing does."""
    return ", ".join(f"{name} {found.get(name, 'none')} instead of {value}" for name, value in wanted.items()
                     if found.get(name) != value)


_MOST = 50 * 2**20


class _Pickler(cloudpickle.Pickler):
    """Cached functions of ``__main__`` too, which cloudpickle would look for in the ``__main__`` of the worker."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, functools._lru_cache_wrapper) and getattr(obj, "__module__", None) == "__main__":
            return _cached_again, (obj.__wrapped__, obj.cache_parameters())
        return super().reducer_override(obj)


def _cached_again(function: Callable[..., Any], parameters: dict[str, Any]) -> Any:
    return functools.lru_cache(**parameters)(function)


def sent(function: Callable[..., Any]) -> bytes:
    """A function as bytes."""
    buffer = io.BytesIO()
    try:
        _Pickler(buffer).dump(function)
    except Exception as error:  # whatever the objects it carries raise
        raise TypeError(f"the run function {function.__qualname__} cannot be sent to a worker, as something it reads "
                        f"cannot ({type(error).__name__}: {error}): build that inside the function") from error
    content = buffer.getvalue()
    if len(content) > _MOST:
        raise TypeError(f"the run function {function.__qualname__} carries {len(content) / 1e6:.0f} MB of values with "
                        "it, with each run: let it read them from a file, or build them")
    return content


def received(content: bytes) -> Callable[..., Any]:
    """The function again."""
    return pickle.loads(content)
