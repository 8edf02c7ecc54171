"""The kernels of a first solve, compiled in a second process."""

from __future__ import annotations

import os
import sys

from adaptmg._numba import Recorder


def record_first_solve() -> dict:
    """Return the kernels that a first solve of a plane problem calls, in their order, with the
    types of their arguments. They run as plain Python on few nodes, which takes a second."""
    Recorder.calls = {}
    import adaptmg as am  # from here on: modules that are loaded now record

    grids = am.Hierarchy.graded(am.cases.greco_bar(), (0.04, 0.02, 0.01))
    am.solve(grids).certificate()
    return Recorder.calls


def compile_ahead() -> None:
    """Compile the kernels of a first solve from the last one to the first, as long as the process
    that started this one runs."""
    parent = os.getppid()
    calls = record_first_solve()
    modules = [module for name, module in sys.modules.items() if name.startswith("adaptmg.")]
    for module in modules:
        for attribute, value in list(vars(module).items()):
            if isinstance(value, Recorder):  # kernels that are compiled call compiled ones
                setattr(module, attribute, value.compiled)
    for kernel, types in reversed(calls):
        if os.getppid() == parent:
            kernel.compile(types)
