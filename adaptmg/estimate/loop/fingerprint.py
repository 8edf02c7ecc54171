"""What the steps of an adaptive loop depend on, as plain values by what a message calls it.

Of arrays length, norm and the product with a wave are kept, which tell another mesh, material, load or law, and do not
mind the rounding of another machine. Limits (tolerance, nodes, seconds) are no part: a loop may go on under others.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from adaptmg.discretisation.load_steps import load_steps
from adaptmg.hierarchy import Hierarchy
from adaptmg.solver.history.store import fingerprint as path_fingerprint
from adaptmg.solver.result.labels import label

__all__ = ["loop_fingerprint"]

_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")


def loop_fingerprint(start: Hierarchy, options: Mapping[str, Any], load_path: Any = None) -> dict[str, Any]:
    """Of a loop that begins with a hierarchy.

    Parameters
    ----------
    start : Hierarchy
    options : mapping
        By name: indicator, mark, engine, transfer, solver, ...; told apart by their reprs.
    load_path : LoadPath, optional
    """
    loads = [load_steps(start.problem, level.mesh, level.discrete.coupling) for level in start.levels]
    factors = {} if load_path is None else load_path.resolved(start.problem)
    found = path_fingerprint(start, loads, factors, 0 if load_path is None else len(load_path), None, None)
    del found["start"], found["solver"]
    found["domain"] = _ADDRESS.sub("", repr(start.problem.domain))
    # an object without a repr of its own shows its address
    return found | {name: _ADDRESS.sub("", label(value)) for name, value in options.items()}
