"""How kernels are compiled: once per machine, kept on disk, with no more ways in than are used.

numba builds, beside a function, a way in from Python and one from C. The latter nobody takes, the former only
functions that Python calls: without them the first solve on a machine compiles a tenth less.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numba.core.registry import CPUDispatcher

__all__ = ["inner_kernel", "kernel", "read_only"]


def kernel(function: Callable | None = None, **options: Any) -> Any:
    """Compile a function that Python calls; ``options`` are those of ``numba.njit``.

    Divided by zero is as in numpy: tests before each division would take time, here and in what is compiled.
    """
    compiling = njit(**{"cache": True, "no_cfunc_wrapper": True, "error_model": "numpy"} | options)
    return compiling if function is None else compiling(function)


def inner_kernel(function: Callable | None = None, **options: Any) -> Any:
    """Compile a function that only kernels call; a call from Python is a TypeError."""
    def inner(function: Callable) -> Any:
        compiled = kernel(function, no_cpython_wrapper=True, **options)
        if isinstance(compiled, CPUDispatcher):  # not where numba is told to compile nothing
            compiled.__class__ = _Inner
        return compiled

    return inner if function is None else inner(function)


def read_only(array: np.ndarray) -> np.ndarray:
    """A view that nobody writes to: kernels are compiled once for those, and once more for arrays that one may."""
    view = array.view()
    view.flags.writeable = False
    return view


class _Inner(CPUDispatcher):
    """Compiled without a way in from Python: numba would jump to an address that is none."""

    def __call__(self, *arguments: Any, **named: Any) -> None:
        name = f"{self.py_func.__module__}.{self.py_func.__qualname__}"
        raise TypeError(f"{name} is called by compiled code alone (inner_kernel): compile it with kernel, or call its "
                        ".py_func")
