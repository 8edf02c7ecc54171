"""interruptible: Netgen and OCC in a thread of their own, so that Ctrl-C is heard while they work.

Python looks at signals between instructions of the main thread, but Netgen may be at work in C++ for hours, or forever.
It releases Python's lock meanwhile; the main thread therefore waits, and an interrupt ends the wait at once. The work
itself cannot be stopped: until it ends, another call is refused, as Netgen has state of its own.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, TypeVar

__all__ = ["NetgenBusy", "NetgenEndless", "interruptible"]

Value = TypeVar("Value")

# seconds between two looks at signals, and what an abandoned call is given to end
_LOOK, _PATIENCE = 0.2, 1.0
# five times what the largest meshes take: 2 million nodes in 3D at 7 ms
_LIMIT_S = 70_000.0
# Netgen's recursions need more than the half megabyte that threads get on some systems
_STACK = 64 * 2**20
_starting = threading.Lock()
_abandoned: list[threading.Event] = []


class NetgenBusy(Exception):
    """Netgen is still at work on an earlier call."""


class NetgenEndless(ValueError):
    """Netgen came to no end in the time given."""


def interruptible(function: Callable[..., Value], *args: Any, limit: float | None = None, **options: Any) -> Value:
    """Call a function of Netgen or OCC.

    Parameters
    ----------
    function : callable
        Releases Python's lock while it works.
    *args, **options
        Its arguments.
    limit : float, optional
        Seconds it may take; by default ``_LIMIT_S``.

    Returns
    -------
    What it returns; its exceptions are raised here.

    Raises
    ------
    NetgenBusy
        If an earlier call, which was interrupted, is still at work.
    NetgenEndless
        If it takes longer than the limit.
    """
    for ended in _abandoned[:]:
        if not ended.wait(_PATIENCE):
            raise NetgenBusy("Netgen is still at work on what was interrupted before, and cannot be stopped: wait, or "
                               "restart Python")
        _abandoned.remove(ended)
    if threading.current_thread() is not threading.main_thread():
        return function(*args, **options)  # signals go to the main thread only
    outcome: dict[str, Any] = {}
    # not Thread.join: interrupted, that of Python 3.11 takes the thread for ended
    ended = threading.Event()

    def work() -> None:
        try:
            outcome["value"] = function(*args, **options)
        except BaseException as error:  # whatever it is, it belongs to the caller
            outcome["error"] = error
        finally:
            ended.set()

    with _starting:
        before = threading.stack_size(_STACK)
        try:
            threading.Thread(target=work, daemon=True, name="netgen").start()
        finally:
            threading.stack_size(before)
    try:
        end = time.monotonic() + (_LIMIT_S if limit is None else limit)
        while not ended.wait(_LOOK):
            if time.monotonic() > end:
                raise NetgenEndless(f"Netgen came to no end in {limit or _LIMIT_S:.0f} s; it often does so where parts "
                                    "are much thinner than the sizes asked for")
    except BaseException:
        _abandoned.append(ended)
        raise
    if "error" in outcome:
        raise outcome["error"]
    return outcome["value"]
