"""What every layer stands on: compiled kernels and their cache, BLAS threads, random numbers, values made on demand.

Kernels are compiled once per machine. numba keeps them next to the source or in the home directory; where neither can
be written they go to a folder of this user for temporary files, and a damaged or full cache costs a compilation, not
the run. numba builds a way in from Python and one from C for each function: the second is never used, and the first
only for functions that Python calls, so the first solve on a machine compiles a tenth less without them. Nor is what
kernels call compiled for each of them (:class:`_Flags`), or into machine code alone (:class:`_Linked`), and
:mod:`adaptmg._ahead` compiles on a second core.

BLAS runs on one thread inside the package: sums over two threads differ in the last digits, and small dense
factorisations lose more to starting threads than they gain.
"""

from __future__ import annotations

import fcntl
import gc
import logging
import multiprocessing
import os
import stat
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache, partial, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakKeyDictionary

import numba
import numpy as np
from llvmlite import binding as llvm
from numba.core.caching import CompileResultCacheImpl, FunctionCache, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler, Flags
from numba.core.dispatcher import _FunctionCompiler
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys

from adaptmg import _ahead

if TYPE_CHECKING:
    from threadpoolctl import LibController, ThreadpoolController

_LOG = logging.getLogger(__name__)


def kernel(function: Callable | None = None, *, cache: bool = True, **options: object) -> Any:
    """Compile a function that Python calls; ``options`` are those of ``numba.njit``. Division by zero is as in numpy: a
    test before each division would take time, here and in the compilation. Other threads of Python run meanwhile."""
    if function is None:
        return partial(kernel, cache=cache, **options)
    compiled = numba.njit(**{"no_cfunc_wrapper": True, "error_model": "numpy", "nogil": True,
                             "pipeline_class": Pipeline} | options)(function)
    if isinstance(compiled, CPUDispatcher):  # NUMBA_DISABLE_JIT compiles nothing
        compiled._compiler.__class__ = _Compiler
        if cache:
            compiled._cache = _cache_of(function)
    return compiled


def inner_kernel(function: Callable | None = None, **options: object) -> Any:
    """Compile a function that only kernels call; a call from Python is a TypeError."""
    if function is None:
        return partial(inner_kernel, **options)
    compiled = kernel(function, no_cpython_wrapper=True, **options)
    if isinstance(compiled, CPUDispatcher):
        compiled.__class__ = _Inner
    return compiled


class _Flags(Flags):
    """Flags of a kernel, equal where they compile what it calls alike. numba compares them some 50 000 times in a first
    solve, and by default compiles numpy's functions and ours again for callers with and without a way in from Python.
    """

    __slots__ = ("_key",)

    def __hash__(self) -> int:
        return _HASH

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, _Flags):
            return _of_calls(self) == _of_calls(other) if isinstance(other, Flags) else NotImplemented
        for flags in (self, other):
            if not hasattr(flags, "_key"):
                flags._key = _of_calls(flags)
        return self._key == other._key


class _Library(JITCodeLibrary):
    """The code of a kernel. numba also prepares passes for each function that is only declared."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout
        for function in ll_module.functions:
            if not function.is_declaration:
                passes, builder = self._codegen._function_pass_manager()
                passes.run(function, builder)


class _Linked(_Library):
    """The code of a function that only kernels call. They link it: no machine code is made of it alone."""

    inlined = False

    def _optimize_final_module(self) -> None:
        if not self.inlined:  # else its callers do
            super()._optimize_final_module()

    def _finalize_final_module(self) -> None:
        self._finalized = True
        linked = self._get_module_for_linking()
        # numba fills these
        names = [one.name for one in linked.global_variables if "NumbaEnv" in one.name]
        self._final_module = llvm.parse_assembly("\n".join(f'@"{name}" = common global ptr null' for name in names))
        super()._finalize_final_module()


class Pipeline(Compiler):
    """Compiles kernels and what they call into these libraries."""

    def __init__(self, typing: Any, target: Any, library: Any, arguments: Any, result: Any, flags: Any, *more: Any
                 ) -> None:
        library = (_Linked if flags.no_cpython_wrapper else _Library)(target.codegen(), "kernel")
        library.enable_object_caching()
        library.inlined = flags.forceinline
        super().__init__(typing, target, library, arguments, result, flags, *more)


_HASH = hash(Flags())  # numba's is the same for all


def _of_calls(flags: Any) -> tuple[object, ...]:
    """The flags that are passed on to the functions that a kernel calls, and change them."""
    return flags.nrt, flags.error_model, flags.boundscheck, flags.debuginfo, frozenset(flags.fastmath.flags)


class _Compiler(_FunctionCompiler):
    """Compiles a kernel without looking for garbage meanwhile, which takes a twentieth of the time."""

    def _customize_flags(self, flags: Flags) -> Flags:
        return _Flags(flags)

    def compile(self, args: Any, return_type: Any) -> Any:
        enabled = gc.isenabled()
        gc.disable()
        try:
            return super().compile(args, return_type)
        finally:
            if enabled:
                gc.enable()


class _Inner(CPUDispatcher):
    """A kernel without a way in from Python: numba would jump to an invalid address."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Compile once for numbers in the caller's text and in its variables: numba does for each number and each
        tuple of them."""
        return super().get_call_template([numba.types.unliteral(one) for one in args],
                                         {name: numba.types.unliteral(one) for name, one in kws.items()})

    def __call__(self, *arguments: object, **named: object) -> None:
        name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
        raise TypeError(f"{name} is called by compiled code alone (inner_kernel): compile it with kernel, or call its "
                        ".py_func")


_EMPTY = llvm.parse_assembly("").as_bitcode()


class _Loaded(JITCodeLibrary):
    """A kernel from the cache. What other kernels link, a second form of its code, is read when one is compiled that
    calls it."""

    def _get_module_for_linking(self) -> Any:
        if self._linked:
            self._shared_module, self._linked = llvm.parse_bitcode(self._linked), b""
            self._codegen._engine._load_defined_symbols(self._shared_module)
        return super()._get_module_for_linking()


class _Form(CompileResultCacheImpl):
    """The form in which a kernel is stored, which is numba's."""

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        (name, kind, (machine_code, linked)), function, *rest = payload
        if (entry := function.llvm_cpython_wrapper_name).encode() in machine_code:  # the way in from Python
            target_context.codegen()._engine._defined_symbols.add(entry)
        made = super().rebuild(target_context, ((name, kind, (machine_code, _EMPTY)), function, *rest))
        made.library.__class__, made.library._linked = _Loaded, linked
        return made


class _Cache(FunctionCache):
    """numba's cache of a kernel, whose failures are logged and cost a compilation."""

    _impl_class = _Form

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = None
        try:
            # numba also lists all that it can compile, which takes longer than a small solve
            rtsys.initialize(target_context)
            found = self._load_overload(sig, target_context)
        except Exception as error:
            self._warn("read", error)
            with suppress(OSError):  # a new index takes what is compiled now
                os.unlink(self._cache_file._index_path)
        if found is None:
            _announce_compiling()
            _ahead.start(self._py_func)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            with _ahead.SAVING, _locked(self.cache_path):
                super().save_overload(sig, data)
        except Exception as error:
            self._warn("written", error)

    def _warn(self, done: str, error: Exception) -> None:
        _LOG.warning("the cache of the kernel %s in %s cannot be %s (%s: %s): the kernel is compiled again",
                     self._py_func.__qualname__, self.cache_path, done, type(error).__name__, error)


@contextmanager
def _locked(folder: str) -> Iterator[None]:
    """Let one process at a time number its files: numba gives two that save at the same moment the same name."""
    file = -1
    with suppress(OSError):  # a file system without locks, or a process stopped while it saves: go on
        os.makedirs(folder, exist_ok=True)
        file = os.open(folder, os.O_RDONLY)
        for wait in (0.001, 0.01, 0.1, 1.0, 0.0):
            with suppress(BlockingIOError):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            time.sleep(wait)
    try:
        yield
    finally:
        if file >= 0:
            os.close(file)


@lru_cache(maxsize=1)
def _announce_compiling() -> None:
    text = "compiling kernels (first use on this machine, about 15 s; kept for later runs)"
    if sys.stderr is not None and sys.stderr.isatty() and multiprocessing.parent_process() is None:
        say(f"adaptmg: {text}")
    else:
        _LOG.info(text)


def say(text: str) -> None:
    """Write a line to standard error, if there is one."""
    if sys.stderr is not None:
        sys.stderr.write(f"{text}\n")
        sys.stderr.flush()


def _cache_of(function: Callable) -> FunctionCache | NullCache:
    try:
        return _Cache(function)
    except RuntimeError:  # numba finds no folder that can be written
        before, numba.config.CACHE_DIR = numba.config.CACHE_DIR, _temporary_folder()
        try:
            return _Cache(function) if numba.config.CACHE_DIR else NullCache()
        except RuntimeError:
            return NullCache()
        finally:
            numba.config.CACHE_DIR = before


@lru_cache(maxsize=1)
def _temporary_folder() -> str:
    """A folder that this user alone can write, since compiled code is run from it; "" if there is none."""
    try:
        folder = Path(tempfile.gettempdir(), f"adaptmg-kernels-{os.getuid() if hasattr(os, 'getuid') else 'user'}")
        folder.mkdir(mode=0o700, exist_ok=True)
        status = folder.lstat()
        if not stat.S_ISDIR(status.st_mode) or (hasattr(os, "getuid") and (status.st_uid, status.st_mode & 0o077) != (
                os.getuid(), 0)):
            folder = Path(tempfile.mkdtemp(prefix="adaptmg-kernels-"))
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        _LOG.warning("compiled kernels are not kept, as nothing can be written (%s): set NUMBA_CACHE_DIR to a folder "
                     "that can", error)
        return ""
    _LOG.warning("compiled kernels are kept in %s, as neither the package nor the home directory can be written: set "
                 "NUMBA_CACHE_DIR to keep them elsewhere", folder)
    return str(folder)


def read_only(array: np.ndarray) -> np.ndarray:
    """A view that cannot be written: kernels are compiled separately for those and for other arrays."""
    view = array.view()
    view.flags.writeable = False
    return view


class _Blas:
    """The BLAS libraries of the process, and how many are inside :func:`one_blas_thread`."""

    def __init__(self) -> None:
        self.controller: ThreadpoolController | None = None
        self.modules = -1
        self.renew()

    def renew(self) -> None:
        self.lock, self.inside, self.here = threading.RLock(), 0, threading.local()
        self.before: list[tuple[LibController, int]] = []

    def enter(self) -> None:
        with self.lock:
            self.here.inside = getattr(self.here, "inside", 0) + 1
            if self.here.inside == 1:
                # built on OpenMP a library counts its threads for each calling thread
                self.here.before = self._limited(by_thread=True)
            if self.inside == 0:
                self.before = self._limited(by_thread=False)
            self.inside += 1

    def leave(self) -> None:
        with self.lock:
            self.here.inside -= 1
            self.inside -= 1
            if self.here.inside == 0:
                _set(self.here.before)
            if self.inside == 0:
                _set(self.before)

    def _limited(self, by_thread: bool) -> list[tuple[LibController, int]]:
        """Hold libraries at one thread; returns the numbers before."""
        # imported inside the block it would bring another BLAS without a limit
        import scipy.linalg  # noqa: F401
        from threadpoolctl import ThreadpoolController

        if self.modules != len(sys.modules):  # looked for again (some ms) when modules were imported since
            self.controller, self.modules = ThreadpoolController(), len(sys.modules)
        before = [(library, library.get_num_threads()) for library in self.controller.lib_controllers
                  if library.user_api == "blas" and (getattr(library, "threading_layer", "") == "openmp") == by_thread]
        _set([(library, 1) for library, _ in before])
        return before


def _set(numbers: list[tuple[LibController, int]]) -> None:
    """Set the numbers of threads, whichever thread of Python set them before."""
    for library, threads in numbers:
        # threadpoolctl 3.7 and later obey, in silence, only the thread that was first to set it
        release = getattr(library, "clear_controlling_thread", lambda force: None)
        release(force=True)
        library.set_num_threads(threads)
        release(force=True)


_BLAS = _Blas()
_RANDOM = threading.RLock()


def _after_fork() -> None:
    """Locks that other threads held, and their being inside, do not come along to a child."""
    global _RANDOM
    _RANDOM, before = threading.RLock(), _BLAS.before if _BLAS.inside else []
    _BLAS.renew()
    _set(before)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_after_fork)


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Hold BLAS at one thread, in a with statement or as a decorator; may be nested, and entered by several threads."""
    _BLAS.enter()
    try:
        yield
    finally:
        _BLAS.leave()


@contextmanager
def seeded() -> Iterator[None]:
    """Let what draws from numpy's global generator (pyamg) draw the same numbers always, and put the state back. One
    thread at a time; a thread of the user that draws from the global generator meanwhile is not held back."""
    with _RANDOM:
        state = np.random.get_state()  # noqa: NPY002
        np.random.seed(0)  # noqa: NPY002
        try:
            yield
        finally:
            np.random.set_state(state)  # noqa: NPY002


@dataclass(frozen=True)
class OnDemand:
    """What a field is given in place of its value."""

    make: Callable[[Any], object]  # of the object that has the field; returns the value


class Absent(AttributeError, ValueError):
    """Raised where an optional part is read that an object does not have; ``getattr(x, name, None)`` gives None."""


def made_on_demand(name: str, doc: str, absent: str = "") -> property:
    """A property to put in the place of the field ``name`` of a dataclass, after its class statement.

    The field keeps its default and its place in ``__init__``, and may be given a value or an :class:`OnDemand`.
    ``dataclasses.replace`` reads it: say what the new value is, where it depends on what is replaced. With ``absent``,
    the field may be None, and reading it raises :class:`Absent` with this text.
    """
    def value(owner: object) -> Any:
        held = owner.__dict__[name]
        if isinstance(held, OnDemand):
            held = owner.__dict__[name] = held.make(owner)
        if held is None and absent:
            raise Absent(absent)
        return held

    return property(value, lambda owner, given: owner.__dict__.__setitem__(name, given), doc=doc)


class Token:
    """Stands for what an object and its copies have in common."""


Owner = TypeVar("Owner")
Value = TypeVar("Value")


def remembered(function: Callable[[Owner], Value], of: Callable[[Owner], object] = lambda owner: owner
               ) -> Callable[[Owner], Value]:
    """A function that computes once for each object, or for ``of`` it; exceptions are not remembered. For objects that
    are the same only if they are identical, and never change: hierarchies that grow keep their coarse levels from solve
    to solve."""
    known: WeakKeyDictionary[object, Value] = WeakKeyDictionary()

    @wraps(function)
    def asked(owner: Owner) -> Value:
        key = of(owner)
        if key not in known:
            known[key] = function(owner)
        return known[key]

    return asked
