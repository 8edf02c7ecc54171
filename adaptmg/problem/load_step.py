"""step_problem: what is posed in one step of a load path, as a problem of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from adaptmg.problem import checks
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.load_path import name_in_path, names_in_path
from adaptmg.problem.loads import Load, Pressure, Support

__all__ = ["Scaled", "step_problem"]

Field = float | Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class Scaled:
    """A function of position times a number."""

    function: Callable[[np.ndarray], np.ndarray]
    factor: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Values (n,) at points (n, dim)."""
        return self.factor * np.asarray(self.function(points))


def step_problem(problem: ContactProblem, factors: Mapping[str, float]) -> ContactProblem:
    """The problem with its loads and prescribed displacements multiplied.

    Parameters
    ----------
    problem : ContactProblem
    factors : mapping of str to float
        By the names of a :class:`~adaptmg.problem.load_path.LoadPath`; what is not named keeps its size. Of step k of
        a PathResult: ``{name: values[k] for name, values in path.factors.items()}``.

    Returns
    -------
    ContactProblem
        Loads with factor 0 stay, as zeros. Friction's memory is not part of it.

    Raises
    ------
    ValueError
        For a name under which nothing is loaded or moved, or a factor that is not finite.
    """
    known = names_in_path(problem)
    given = {name: checks.quantity(f"factors[{name!r}]", value) for name, value in factors.items()}
    for name in given:
        if name not in known:
            raise ValueError(f"factors name {name!r}, where the problem has no load and no prescribed displacement "
                             f"other than zero; known are {', '.join(map(repr, known)) or 'none'}")
    return replace(problem, loads=tuple(_load(load, given.get(name_in_path(load), 1.0)) for load in problem.loads),
                   supports=tuple(_support(one, given.get(name_in_path(one), 1.0)) for one in problem.supports))


def _times(value: Field | None, factor: float) -> Field | None:
    if value is None or factor == 1.0:
        return value
    return Scaled(value, factor) if callable(value) else factor * value


def _load(load: Load, factor: float) -> Load:
    if isinstance(load, Pressure):
        return replace(load, value=_times(load.value, factor))
    return replace(load, components=tuple(_times(value, factor) for value in load.components))


def _support(support: Support, factor: float) -> Support:
    return replace(support, **{axis: _times(getattr(support, axis), factor) for axis in "xyz"})
