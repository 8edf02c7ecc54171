"""Dynamics: the mass of bodies, their velocities at the start, and the time steps of a march."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from math import ceil
from typing import Annotated, Any

import numpy as np

from adaptmg import _checks as checks

#: m/s: components, or a function of positions (n, dim) that returns velocities (n, dim)
Velocity = tuple[float, ...] | Callable[[np.ndarray], np.ndarray]


def _by_body(check: Callable[[str, Any], Any], name: str, value: Any) -> Any:
    """Return a value, or a mapping of values by body, with each value checked."""
    if not isinstance(value, Mapping):
        return check(name, value)
    return {body: check(f"{name}[{body!r}]", part) for body, part in value.items()}


def _velocity(name: str, value: Any) -> Velocity:
    """Return components of a velocity, or a function of positions, checked."""
    return checks.function_or(name, value, lambda *named: tuple(checks.vector(*named).tolist()))


@dataclass(frozen=True, kw_only=True)
class Dynamics(checks.Checked):
    """Mass, initial velocities and time steps of bodies that move, for :func:`adaptmg.march`.

    Parameters
    ----------
    density : float or mapping of str to float
        kg/m^3, > 0; for all bodies, or by the name of each body.
    step : float
        Time step, s. The largest one that follows waves is about the smallest element size over
        the speed of sound sqrt(E / density); the method itself is stable for any.
    end : float
        s; the last step is the first one that reaches it.
    initial_velocity : sequence of float, callable, or mapping of str to these, optional
        m/s: a vector, or a function of positions (n, dim), m, that returns velocities (n, dim); by
        body, where bodies that are not named are at rest. Default: all are at rest. What supports
        hold does not move.
    damping : float
        Relaxation time, s, >= 0: the stiffness of bodies and springs, times this number, resists
        the rate of strain (Kelvin and Voigt). It is 0 by default, and does not brake rigid motions.

    Examples
    --------
    >>> dynamics = am.Dynamics(density=7850.0, initial_velocity=(0.0, -2.0), step=1e-6, end=1e-4)
    >>> dynamics.n_steps
    100
    """

    density: Annotated[
        float | Mapping[str, float], partial(_by_body, partial(checks.quantity, positive=True))
    ]
    step: checks.Size
    end: checks.Size
    initial_velocity: Annotated[Velocity | Mapping[str, Velocity], partial(_by_body, _velocity)] = (
        field(default_factory=dict)
    )
    damping: Annotated[float, checks.nonnegative] = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.step <= self.end:
            raise ValueError(f"end must be >= step, {self.step:g} s, got {self.end:g}")

    @property
    def n_steps(self) -> int:
        """Return the number of time steps; a millionth of one more is rounding of the end."""
        return ceil(self.end / self.step - 1e-6)
