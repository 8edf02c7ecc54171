"""What the steps of an adaptive loop depend on, as plain values by what a message calls it.

To what :mod:`adaptmg.solver.history.store` compares on the first meshes the problem itself comes: between the nodes of
the first mesh another law or gap would not show. Limits (tolerance, nodes, seconds) are no part: a loop may go on under
others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from adaptmg.discretisation.load_steps import load_steps
from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.history.store import fingerprint

__all__ = ["loop_fingerprint"]


def loop_fingerprint(start: Hierarchy, options: Mapping[str, Any], load_path: Any = None,
                     depends: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Of a loop that begins with a hierarchy, and its options by name: indicator, mark, engine, solver, ..."""
    loads = [load_steps(start.problem, level.mesh, level.discrete.coupling) for level in start.levels]
    factors = {} if load_path is None else load_path.resolved(start.problem)
    # references only document the problem
    posed = {part.name: getattr(start.problem, part.name) for part in fields(start.problem) if part.name != "reference"}
    return fingerprint(start, loads, factors, 0 if load_path is None else len(load_path), posed | dict(options), None,
                       depends)
