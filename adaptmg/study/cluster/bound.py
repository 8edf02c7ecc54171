"""Loaded by the processes of a local cluster: the system ends them with their parent, even in the midst of C code.

dask's own way, a thread that waits for the parent's end, needs Python's lock, which compiled code may hold for minutes.
"""

from __future__ import annotations

import contextlib
import ctypes
import signal
import sys

__all__ = ["dask_setup"]

_PR_SET_PDEATHSIG = 1


def dask_setup(worker: object) -> None:
    """Called by dask in the new process (Linux; elsewhere dask's way is the only one)."""
    if sys.platform == "linux":
        with contextlib.suppress(OSError, AttributeError):
            ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
