"""Compiled kernels: numba's options for all of them, its cache on disk, and the seconds that it
spends compiling.

numba compiles a function once per machine and stores the code in ``__pycache__`` next to the
source, in the user's cache folder, or in ``NUMBA_CACHE_DIR``. It makes a wrapper for calls from
Python and one for calls from C: the second is never used, and the first only for functions that
Python calls."""

from __future__ import annotations

import gc
import logging
import os
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from functools import cache, lru_cache, partial
from typing import Any, cast

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core.event import Event, Listener, register
from numba.extending import intrinsic, overload, typeof_impl

from adaptmg._machine import has_idle_processor
from adaptmg._text import say

_LOG = logging.getLogger(__name__)

#: by dimension: what kernels take as ``zero``, a tuple of as many zeros. Its length is part of its type: numba compiles
#: a kernel for each dimension, with loops of fixed length and without the branches of other dimensions. BlockRows.times
#: with lattices of 17k nodes in the plane and 9k in space takes .56 and .77 of the time of a kernel that gets the
#: dimension as a number; with stored matrices of the same size .61 and .83
ZERO = {1: (0.0,), 2: (0.0, 0.0), 3: (0.0, 0.0, 0.0)}


def kernel(function: Callable | None = None, **options: Any) -> Any:
    """Compile a function that Python calls; ``options`` are those of ``numba.njit``. Division by
    zero is as in numpy: a test before each division would take time, here and in the compilation.
    Other threads of Python run meanwhile."""
    if function is None:
        return partial(kernel, **options)
    chosen: dict[str, Any] = {
        "cache": True,
        "no_cfunc_wrapper": True,
        "error_model": "numpy",
        "nogil": True,
    } | options
    try:
        compiled = numba.njit(**chosen)(function)
    except RuntimeError:  # numba finds no folder that it can write
        _warn_of_no_cache()
        chosen["cache"] = False
        compiled = numba.njit(**chosen)(function)
    return compiled if RecordedKernel.calls is None else RecordedKernel(compiled)


def inner_kernel(function: Callable | None = None, **options: object) -> Any:
    """Compile a function that only kernels call: Python must not, as there is no code for its
    calls."""
    return kernel(function, no_cpython_wrapper=True, **options)


class RecordedKernel:
    """A kernel that runs as plain Python and records the types of its arguments, so that it can be
    compiled for them later."""

    #: each kernel that Python called, with the types; None: kernels are compiled, none records
    calls: dict[tuple[Any, tuple], None] | None = None

    def __init__(self, compiled: Any) -> None:
        self.compiled = compiled

    def __call__(self, *arguments: Any) -> Any:
        # kernels that only kernels call are compiled with these
        if self.calls is not None and not self.compiled.targetoptions.get("no_cpython_wrapper"):
            self.calls[self.compiled, tuple(map(numba.typeof, arguments))] = None
        return self.compiled.py_func(*arguments)


@typeof_impl.register(RecordedKernel)
def _type_of_recorded(recorded, context):
    """Return the type of the kernel itself: kernels that are compiled call compiled ones."""
    return typeof_impl(recorded.compiled, context)


@lru_cache(maxsize=1)
def _warn_of_no_cache() -> None:
    _LOG.warning(
        "compiled kernels are not stored, as neither the package nor the home directory can be written: set "
        "NUMBA_CACHE_DIR to a folder that can"
    )


def _typed_prefetch(typing_context, address):
    """Return the signature and the code of a prefetch for reading, into all caches."""
    byte_pointer = ir.IntType(8).as_pointer()
    integer = ir.IntType(32)
    arguments = [byte_pointer, integer, integer, integer]

    def generate(context, builder, signature, values):
        function = builder.module.declare_intrinsic(
            "llvm.prefetch", [byte_pointer], ir.FunctionType(ir.VoidType(), arguments)
        )
        place = builder.inttoptr(values[0], byte_pointer)
        # for reading; kept in all caches; data, not instructions
        builder.call(function, [place, integer(0), integer(3), integer(1)])
        return context.get_dummy_value()  # of void

    return types.void(types.uintp), generate


_prefetch: Any = intrinsic(_typed_prefetch)  # Any: numba passes the first argument itself


def prefetch(address: np.unsignedinteger) -> None:
    """Ask the processor for what stands at an address (uintp), which may lie outside every array.
    Where a kernel runs as plain Python, do nothing."""


@overload(prefetch, inline="always")
def _compiled_prefetch(address):
    """Return what compiled kernels call; numba compares the names of arguments, annotations too."""
    return lambda address: _prefetch(address)


def read_only(array: np.ndarray) -> np.ndarray:
    """Return a view that cannot be written: kernels are compiled separately for those and for other
    arrays."""
    view = array.view()
    view.flags.writeable = False
    return view


class _Seconds(threading.local):
    """The seconds of the compilations in a thread; each solve reads them some 60 times."""

    seconds = 0.0


class _Compiling(Listener):
    """A listener that adds up the seconds of compilations in each thread, and announces long ones;
    numba compiles in one thread at a time. Kernels that a kernel calls compile within it: only the
    outermost compilation is timed, and the garbage collector is off while it runs."""

    def __init__(self) -> None:
        self.depth = 0  # compilations that run, one within the other
        self.begin = 0.0  # s, of the outermost one
        self.collecting = False  # whether the collector was on before it
        self.kernel: Any = None  # the function that it compiles
        self.here = _Seconds()

    def on_start(self, event: Event) -> None:
        """Begin to time the compilation of a kernel, unless it is part of another one."""
        self.depth += 1
        if self.depth == 1:
            data = cast("dict[str, Any]", event.data)  # numba infers None from its default
            self.kernel = data["dispatcher"].py_func
            package, _, part = str(self.kernel.__module__).partition(".")
            if compiling_seconds() > 1.0 and package == "adaptmg":
                _announce(part.partition(".")[0])
            if f"{part}.{self.kernel.__name__}" in _FIRST:
                _compile_ahead()
            # looking for garbage among the many objects of a compilation takes 2 of 17 s of a first
            # solve (uniform bar) with an empty cache
            self.collecting = gc.isenabled()
            gc.disable()
            self.begin = time.perf_counter()

    def on_end(self, event: Event) -> None:
        """Add the seconds of an outermost compilation that has ended, and let the collector run again if
        it did before."""
        self.depth -= 1
        if self.depth == 0:
            if self.collecting:
                gc.enable()
            seconds = time.perf_counter() - self.begin
            self.here.seconds = compiling_seconds() + seconds
            _LOG.info(
                "compiled %s.%s: %.1f s", self.kernel.__module__, self.kernel.__name__, seconds
            )


#: processor seconds in which all kernels of a part compile, by adaptmg warm on an AMD EPYC
_SECONDS = {
    "discrete": 14,
    "multigrid": 13,
    "mesh": 8,
    "smoother": 6,
    "transfer": 5,
    "geometry": 4,
    "solver": 4,
    "plot": 1,
}

#: kernels that solves of plane problems call first, on graded and on uniform meshes
_FIRST = ("mesh.delaunay._put", "discrete.elasticity._shape_gradients")


@cache
def _compile_ahead() -> None:
    """Let a second process compile the kernels of a first solve, from the last one to the first,
    while this one needs them from the first to the last, where a processor is idle and the code is
    stored. Workers start no such process, nor does an embedded Python, whose executable is another
    program."""
    from multiprocessing import parent_process

    is_stored = not _warn_of_no_cache.cache_info().misses
    may_use_two = parent_process() is None and os.environ.get("NUMBA_NUM_THREADS") != "1"
    is_python = os.path.basename(sys.executable or "").startswith("python")
    if not (is_stored and may_use_two and is_python and has_idle_processor()):
        return
    code = "from adaptmg.cli.ahead import compile_ahead; compile_ahead()"
    variables = {
        "NUMBA_NUM_THREADS": "1",  # it starts no further process
        "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path)),
    }

    def compile_until_done() -> None:
        """Run the second process, and wait for its end, without which it would stay in the table of
        the system as a zombie."""
        with suppress(OSError):
            # without an object of subprocess, which warns where Python ends before the process
            process = os.posix_spawn(
                sys.executable,
                # modules come from the folders of this process only, not from the working directory
                [sys.executable, "-P", "-c", code],
                os.environ | variables,
                file_actions=[
                    (os.POSIX_SPAWN_OPEN, stream, os.devnull, os.O_RDWR, 0) for stream in range(3)
                ],
            )
            os.waitpid(process, 0)

    threading.Thread(target=compile_until_done, daemon=True).start()


_COMPILING = _Compiling()
register("numba:compile", _COMPILING)


def compiling_seconds() -> float:
    """Return the seconds that this thread has spent compiling."""
    return _COMPILING.here.seconds


def clock() -> float:
    """Return the seconds that this thread has spent on anything but compiling: only differences
    mean something."""
    return time.perf_counter() - _COMPILING.here.seconds


@cache
def _announce(part: str) -> None:
    say(
        f"adaptmg: compiling kernels of {part} (up to {_SECONDS.get(part, 5)} s, once on this machine; "
        "'adaptmg warm' compiles nearly all)"
    )
