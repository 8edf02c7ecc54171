"""What solvers, problems and versions are called in results, tables and pictures."""

from __future__ import annotations

import importlib.metadata
from dataclasses import MISSING, fields, is_dataclass
from functools import lru_cache

from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.run import Run, Solver

__all__ = ["label", "problem_name", "solver_name", "versions"]


def label(option: object) -> str:
    """The name of an option object with the fields that differ from their defaults, for tables and pictures."""
    if not is_dataclass(option) or isinstance(option, type):
        return repr(option)
    shown = []
    for item in fields(option):
        value = getattr(option, item.name)
        default = item.default_factory() if item.default_factory is not MISSING else item.default
        if item.repr and (default is MISSING or value != default):
            shown.append(f"{item.name}={label(value)}")
    return f"{type(option).__name__}({', '.join(shown)})"


def solver_name(solver: Solver, run: Run) -> str:
    """The label of a solver, and of what took over from it."""
    return f"{label(solver)}, then {run.fallback}" if run.fallback else label(solver)


def problem_name(grids: Hierarchy) -> str:
    """Of the problem, or else of the finest level."""
    return grids.problem.name if grids.problem is not None else grids.finest.discrete.name


@lru_cache(maxsize=1)
def _versions() -> dict[str, str]:
    return {name: importlib.metadata.version(name)
            for name in ("adaptmg", "ngsolve", "numpy", "scipy", "numba", "pyamg")}


def versions() -> dict[str, str]:
    """Versions of adaptmg and of what its numbers depend on."""
    return dict(_versions())
