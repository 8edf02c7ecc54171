"""What the parts of a loop give: one's own too are held to their word, and named where they do not keep it."""

from __future__ import annotations

from typing import Any

import numpy as np

from adaptmg.estimate.estimate import Estimate
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.checks.check import check_mesh
from adaptmg.problem import ContactProblem, checks
from adaptmg.solver.result import Result

__all__ = ["estimate_of", "marks_of", "sound_mesh"]


def estimate_of(indicator: Any, hierarchy: Hierarchy, result: Result) -> Estimate:
    """The estimate of an indicator, of the elements of the finest mesh."""
    estimate, name = indicator.indicate(hierarchy, result), f"the indicator {checks.shown(indicator)} returns"
    checks.instance(f"what {name}", estimate, Estimate)
    if len(estimate.squares) != len(hierarchy.finest.mesh.elements):
        raise ValueError(f"{name} an estimate of {len(estimate.squares)} elements for a mesh of "
                         f"{len(hierarchy.finest.mesh.elements)}")
    return estimate


def marks_of(mark: Any, estimate: Estimate) -> np.ndarray:
    """The mask (n_elements,) that a marking chooses."""
    given, name = mark.mark(estimate), f"mark: {checks.shown(mark)} must return a boolean mask over the elements"
    try:
        marked = np.asarray(given)
    except (TypeError, ValueError):
        marked = np.asarray(None)
    if marked.dtype != bool:
        raise TypeError(f"{name}, got {checks.described(given)}")
    if marked.shape != estimate.squares.shape:
        raise ValueError(f"{name} (shape {estimate.squares.shape}), got shape {marked.shape}")
    return marked


def sound_mesh(engine: Any, method: str, problem: ContactProblem, made: Any, like: MeshArrays | None = None
               ) -> MeshArrays:
    """A mesh that an engine has made: sound, with the problem's boundaries and the bodies of another mesh."""
    name = f"engine {checks.shown(engine)}: what {method} returns"
    checks.instance(name, made, MeshArrays, "MeshArrays")
    try:
        check_mesh(made)
        if made.dim != problem.dim:
            raise ValueError(f"it is {made.dim}D, the problem {problem.dim}D")
        problem.check_boundaries(made.boundaries)
        if like is not None and set(made.bodies) != set(like.bodies):
            raise ValueError(f"its bodies are {', '.join(made.bodies)}, not {', '.join(like.bodies)}")
    except (TypeError, ValueError) as error:
        raise type(error)(f"{name} is no mesh of the problem: {error}") from error
    return made
