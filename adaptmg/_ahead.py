"""Compile the kernels of a first solve in a second process.

The first solve on a machine compiles about 60 kernels, one after another. Where a second core is free, a process of its
own compiles those of ``_ahead.txt`` from the last to the first into numba's cache, while this one needs them from the
first to the last and loads what it finds there. ``tests/helpers/first_solve.py`` writes the list.

The process is started by the first kernel of the list that the cache lacks, so that a full cache costs nothing. It
prints nothing and ends with this one. ``NUMBA_NUM_THREADS=1`` turns it off.
"""

from __future__ import annotations

import atexit
import importlib
import multiprocessing
import os
import select
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import numba
import numpy as np
from numba import types

LIST = Path(__file__).with_suffix(".txt")
#: held while a file of the cache is written
SAVING = threading.Lock()


def encoded(signature: tuple[types.Type, ...]) -> str:
    """A signature as text: ``int64``, ``int32.1C`` (one-dimensional array; ``r``: read-only), ``float64*2`` (tuple)."""
    return " ".join(f"{t.dtype}.{t.ndim}{t.layout}{'' if t.mutable else 'r'}" if isinstance(t, types.Array)
                    else f"{t[0] if len(t) else 'float64'}*{len(t)}" if isinstance(t, types.BaseTuple) else str(t)
                    for t in signature)


def decoded(text: str) -> tuple[types.Type, ...]:
    """The signature of a text."""
    return tuple(_type(*word.replace("*", ".*").split(".")) for word in text.split())


def _type(name: str, form: str = "") -> types.Type:
    kind = numba.from_dtype(np.dtype(name))
    if form.startswith("*"):
        return types.Tuple((kind,) * int(form[1:]))
    return types.Array(kind, int(form[0]), form[1], readonly=form.endswith("r")) if form else kind


def start(function: Callable) -> None:
    """Start the process if the list has this function, which the cache lacks, and a core is free."""
    with suppress(Exception):  # compiling here does as well
        if f"\n{function.__module__} {function.__qualname__} " in "\n" + LIST.read_text():
            _start()


@lru_cache(maxsize=1)
def _start() -> None:
    if numba.config.NUMBA_NUM_THREADS < 2 or _one_of_many() or _running() >= (os.cpu_count() or 1):
        return
    paths = os.pathsep.join(filter(None, sys.path))
    child = subprocess.Popen([sys.executable, "-c", f"from adaptmg import _ahead; _ahead.compile_all({os.getpid()})"],
                             stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
                             env=os.environ | {"PYTHONPATH": paths, "NUMBA_NUM_THREADS": "1"})
    atexit.register(_end, child)


def _one_of_many() -> bool:
    """Whether this is a worker, a test, or the second process."""
    if multiprocessing.parent_process() is not None or "PYTEST_CURRENT_TEST" in os.environ or "pytest" in sys.modules:
        return True
    if distributed := sys.modules.get("distributed"):
        with suppress(ValueError):
            return bool(distributed.get_worker())
    return False


def _running() -> int:
    """The number of threads of the machine that run or could."""
    return int(Path("/proc/loadavg").read_text().split()[3].split("/")[0])


def _end(child: subprocess.Popen) -> None:
    with suppress(Exception):
        child.communicate(timeout=5.0)  # closes its input


def compile_all(parent: int) -> None:
    """Compile the list from its end until the parent ends."""
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    for line in reversed(LIST.read_text().splitlines()):
        module, name, *words = line.split()
        with suppress(Exception):  # an entry that is out of date
            getattr(importlib.import_module(module), name).compile(decoded(" ".join(words)))


def _end_with(parent: int) -> None:
    """End this process when the parent closes our input or has ended: what it forked keeps the input open."""
    while os.getppid() == parent and not select.select([0], [], [], 0.2)[0]:
        pass
    with SAVING:
        os._exit(0)
