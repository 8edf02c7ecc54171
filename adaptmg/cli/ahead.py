"""The kernels of a first solve, compiled in a second process."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any, cast

import numba
from numba.core.dispatcher import Dispatcher

import adaptmg as am


def record_first_solve() -> dict[tuple[Any, tuple], None]:
    """Return the kernels that a first solve of a plane problem calls, in their order, with the
    types of their arguments. They run as plain Python on few nodes, which takes a second; this
    process compiles no kernel at its first call any more."""
    calls: dict[tuple[Any, tuple], None] = {}

    def record(kernel: Any, *arguments: Any) -> Callable:
        """Return the function that runs for these arguments of a kernel: its Python code."""
        # kernels that only kernels call are compiled with these
        if not kernel.targetoptions.get("no_cpython_wrapper"):
            calls[kernel, tuple(map(numba.typeof, arguments))] = None
        return kernel.py_func

    # numba calls this method of a kernel that is not compiled for its arguments
    cast("Any", Dispatcher)._compile_for_args = record
    grids = am.Hierarchy.graded(am.cases.greco_bar(), (0.04, 0.02, 0.01))
    am.solve(grids).certificate()
    return calls


def compile_ahead() -> None:
    """Compile the kernels of a first solve from the last one to the first, as long as the process
    that started this one runs."""
    parent = os.getppid()
    for kernel, types in reversed(record_first_solve()):
        if os.getppid() == parent:
            kernel.compile(types)
