"""How kernels are compiled: once per machine, kept on disk, with no more ways in than are used.

numba builds, beside a function, a way in from Python and one from C. The latter nobody takes, the former only
functions that Python calls: without them the first solve on a machine compiles a tenth less.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit

__all__ = ["inner_kernel", "kernel"]


def kernel(function: Callable | None = None, **options: Any) -> Any:
    """Compile a function that Python calls; ``options`` are those of ``numba.njit``.

    Divided by zero is as in numpy: tests before each division would take time, here and in what is compiled.
    """
    compiling = njit(**{"cache": True, "no_cfunc_wrapper": True, "error_model": "numpy"} | options)
    return compiling if function is None else compiling(function)


def inner_kernel(function: Callable | None = None, **options: Any) -> Any:
    """Compile a function that only kernels call."""
    return kernel(function, no_cpython_wrapper=True, **options)
