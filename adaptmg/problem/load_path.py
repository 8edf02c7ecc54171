"""LoadPath: a quasi-static history of loads and prescribed displacements, in each step a factor
times the problem's.

Friction depends on the history: the same load, applied in another order, leaves another slip.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, cast

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._text import brief
from adaptmg.problem.contact_problem import Contact, ContactProblem
from adaptmg.problem.loads import Acting, Preload
from adaptmg.problem.surfaces import Moving, Rigid, moving_parts, placed

DEFAULT = "default"  # name of all loads together, where no ContactProblem names them

#: of the largest factor: smaller ones are zeros up to 64 roundings of double precision, such as sums
#: of steps that end at 0
_ROUNDING = 64 * float(np.finfo(np.float64).eps)
_ALL_LOADS = cast("np.ndarray", 1.0)  # an array once it is checked


@dataclass(frozen=True, eq=False)
class LoadPath:
    """Factors of loads and prescribed displacements in each load step.

    Parameters
    ----------
    factors : mapping of str to float or sequence of float
        Factor of each step, by the name of loads and supports, or where one alone is called so by
        that of its place: a boundary, "point (0, 1)" of a PointSupport or PointForce, a body (InitialStrain,
        BodyForce), "body force" (of all bodies). A single number holds in all steps. Factors below
        1e-14 of the largest of their sequence, what rounding leaves of zero, become zero.
    default : float or sequence of float
        Factor of what is not named.

    Examples
    --------
    >>> path = am.LoadPath({"top": [1, 1, 1], "left": [0, 0.5, 1]})
    >>> path.factors["left"].tolist()
    [0.0, 0.5, 1.0]
    >>> loads = (am.Pressure("top", 1e6, name="press"), am.Traction("top", (2e5, 0.0), name="shear"))
    >>> fretting = am.LoadPath({"press": 1.0, "shear": [1, -1, 1]})
    """

    factors: Mapping[str, np.ndarray] = field(default_factory=dict)
    default: np.ndarray = _ALL_LOADS

    if TYPE_CHECKING:

        def __init__(
            self, factors: Mapping[str, ArrayLike] = ..., default: ArrayLike = 1.0
        ) -> None: ...

    __repr__ = brief

    def __post_init__(self) -> None:
        """Check the factors, and spread single numbers over all steps."""
        factors = checks.mapping(
            "factors", self.factors, "names of boundaries or bodies to factors"
        )
        values: dict[str | None, np.ndarray] = {}  # by name, those of ``default`` by None
        for name, value in factors.items():
            checks.boundary_name("the names in factors", name)
            values[name] = _factors(f"factors[{name!r}]", value)
        values[None] = _factors("default", self.default)
        lengths = {name: value.size for name, value in values.items() if value.ndim}
        steps = max(lengths.values(), default=1)
        if set(lengths.values()) - {steps} or not steps:
            raise ValueError(
                "factors must have the same number of steps, one at least, got "
                + ", ".join(f"{n} for {name or DEFAULT!r}" for name, n in lengths.items())
            )
        spread = {name: np.broadcast_to(value, (steps,)) for name, value in values.items()}
        object.__setattr__(self, "default", spread.pop(None))
        object.__setattr__(self, "factors", spread)

    def __len__(self) -> int:
        return len(self.default)

    def of(self, name: str) -> np.ndarray:
        """Return the factors (n_steps,) of a name, those of ``default`` where it is not named."""
        return self.factors.get(name, self.default)

    def resolved(self, problem: ContactProblem | None) -> dict[str, np.ndarray]:
        """Return the factors (n_steps,) of each load and motion of a problem, by its name; for a
        bare DiscreteProblem (None) only ``default``.

        ValueError if the path names something that the problem does not load or move.
        """
        if problem is None:
            if self.factors:
                raise ValueError(
                    f"path names {next(iter(self.factors))!r}, but the loads of a bare DiscreteProblem "
                    "have no names: give default=... alone, or a hierarchy made from a ContactProblem"
                )
            return {DEFAULT: self.of(DEFAULT)}
        names = names_in_path(problem)
        _check_names("path names", self.factors, names)
        for name in self.factors:
            alike = [acting for acting in _acting(problem) if name in acting.path_names]
            if len(alike) > 1 and not all(acting.name for acting in alike):
                kinds = " and ".join(type(acting).__name__ for acting in alike)
                raise ValueError(f"path names {name!r}, where {kinds} act: give each a name=")
        return {name: self.of(name) for name in names}


def _acting(problem: ContactProblem) -> Sequence[Acting]:
    """Return the parts of a problem that a path scales: loads, prescribed displacements and jumps other
    than zero, and moving obstacles."""
    prescribed = [
        support
        for support in (*problem.supports, *problem.ties)
        if isinstance(support, Acting) and support.acts
    ]
    return [*problem.loads, *prescribed, *_obstacles(problem)]


def _obstacles(problem: ContactProblem) -> list[Moving | Rigid]:
    """Return the moving parts of all obstacles."""
    return [
        part
        for contact in problem.contact
        if isinstance(contact, Contact)
        for part in moving_parts(contact.obstacle)
    ]


def names_in_path(problem: ContactProblem) -> tuple[str, ...]:
    """Return the names of all that a path scales, each once; those of preloads and obstacles belong
    to one alone."""
    acting = _acting(problem)
    named = [name for part in acting for name in part.path_names]
    for part in acting:
        shared = [name for name in part.path_names if named.count(name) > 1]
        if isinstance(part, Preload | Moving | Rigid) and shared:
            raise ValueError(
                f"{shared[0]!r} is the name of a {type(part).__name__} and of another load, support or "
                "obstacle: give each a name= of its own"
            )
    return tuple(dict.fromkeys(named))


def obstacles_in_path(problem: ContactProblem) -> list[str]:
    """Return the names of the obstacles that move."""
    return [obstacle.name for obstacle in _obstacles(problem)]


def _factors(name: str, value: ArrayLike) -> np.ndarray:
    """Return a factor, or factors of all steps, checked; factors that are rounding become 0."""
    is_sequence = isinstance(value, Iterable) and getattr(value, "ndim", 1) > 0
    if isinstance(value, (str, bytes)) or not is_sequence:
        return np.array(checks.quantity(name, value))
    result = np.array(checks.vector(name, value))
    if not (np.abs(result) <= checks.VAST).all():
        raise ValueError(f"{name} must be at most {checks.VAST:g}, got {checks.shown(value)}")
    result[np.abs(result) <= _ROUNDING * np.abs(result).max(initial=0.0)] = 0.0
    return result


def step_problem(
    problem: ContactProblem,
    factors: Mapping[str, float],
    motions: Mapping[str, ArrayLike] | None = None,
) -> ContactProblem:
    """Return the problem with its loads and prescribed displacements multiplied by the factors of
    one load step.

    ``factors`` go by the names of a :class:`LoadPath`; what is not named keeps its size. Those of
    step k of a PathResult are ``{name: values[k] for name, values in path.factors.items()}``. Loads
    with factor 0 stay, as zeros; the slip of earlier steps is not part of it. With the ``motions``
    of the step's Result, Rigid obstacles have become Moving ones and preloads initial strains.
    ValueError for a name under which nothing is loaded or moved, or a factor that is not finite.

    Examples
    --------
    >>> half = am.problem.step_problem(am.cases.greco_bar(), {"left": 0.5})
    >>> {load.boundary: load.value for load in half.loads}                     # Pa
    {'top': 50000000.0, 'left': 75000000.0}
    """
    factors = {
        name: checks.quantity(f"factors[{name!r}]", value) for name, value in factors.items()
    }
    _check_names("factors name", factors, names_in_path(problem))
    changed = {
        kind: tuple(
            part.scaled(factors.get(part.path_name, 1.0)) if isinstance(part, Acting) else part
            for part in getattr(problem, kind)
        )
        for kind in ("loads", "supports", "ties")
    }
    if motions is not None:
        # the motion of a preload is one number, its strain
        changed["loads"] = tuple(
            part.shortening(problem.dim, strain=np.ravel(motions[part.path_name]).item())
            if isinstance(part, Preload)
            else part
            for part in changed["loads"]
        )
    contact = tuple(
        replace(part, obstacle=placed(part.obstacle, factors, motions))
        if isinstance(part, Contact)
        else part
        for part in problem.contact
    )
    return replace(problem, contact=contact, **changed)


def _check_names(what: str, factors: Mapping[str, object], names: tuple[str, ...]) -> None:
    """Raise ValueError if factors have other names than ``names``."""
    for name in factors:
        if name not in names:
            raise ValueError(
                f"{what} {name!r}, which no load, moving obstacle or prescribed displacement other than "
                f"zero has; known are {', '.join(map(repr, names)) or 'none'}"
            )
