"""The kernels of a first solve, compiled in a second process."""

from __future__ import annotations

import os

import adaptmg as am
from adaptmg._numba import RecordedKernel


def record_first_solve() -> dict:
    """Return the kernels that a first solve of a plane problem calls, in their order, with the
    types of their arguments. They run as plain Python on few nodes, which takes a second."""
    # the package loads its modules on first use. With a dict here instead of None, kernels of modules
    # that are loaded from now on are made as recorded ones
    RecordedKernel.calls = {}
    grids = am.Hierarchy.graded(am.cases.greco_bar(), (0.04, 0.02, 0.01))
    am.solve(grids, am.FullMultigrid()).certificate()
    return RecordedKernel.calls


def compile_ahead() -> None:
    """Compile the kernels of a first solve from the last one to the first, as long as the process
    that started this one runs."""
    parent = os.getppid()
    for kernel, types in reversed(record_first_solve()):
        if os.getppid() == parent:
            kernel.compile(types)
