"""From options to a method: the same for the command line and for study files."""

from __future__ import annotations

from typing import Any

import adaptmg as am
from adaptmg.cli.choices import CorrectionName, LinearName, Shape, SolverName, Sweeping
from adaptmg.solver.run import Solver

__all__ = ["method_of"]

#: options, beside rtol and most, that a method takes
_MULTIGRID = ("correction", "cycle", "pre", "post", "omega", "order")
_TAKES = {SolverName.FULL: _MULTIGRID, SolverName.MULTIGRID: _MULTIGRID, SolverName.SINGLE: ("omega", "condensed"),
          SolverName.ACTIVE: ("linear", "strength", "lag")}
_PAPER = ("gap", "slip", "sliding_limit")


def method_of(name: SolverName, *, correction: CorrectionName | None = None, cycle: Shape | None = None,
              pre: int | None = None, post: int | None = None, omega: float | None = None,
              order: Sweeping | None = None, gap: str | None = None, slip: str | None = None,
              sliding_limit: str | None = None, condensed: bool | None = None, linear: LinearName | None = None,
              strength: float | None = None, lag: int | None = None, rtol: float | None = None, most: int | None = None,
              flag: str = "--", flag_of_name: str = "--solver") -> Solver:
    """The method with the options that are given; ValueError for one it has no use for.

    Parameters
    ----------
    name, correction, ..., most
        See :mod:`adaptmg.cli.described.keys`; None: the default of the method.
    flag, flag_of_name : str
        What options begin with in messages, and the option that names the method.
    """
    given = {"correction": correction, "cycle": cycle, "pre": pre, "post": post, "omega": omega, "order": order,
             "condensed": condensed, "linear": linear, "strength": strength, "lag": lag}
    useless = [option for option, value in given.items() if value is not None and option not in _TAKES[name]]
    if useless:
        raise ValueError(f"{flag}{useless[0]} has no meaning for {flag_of_name} {name}; "
                         f"it takes {', '.join(f'{flag}{option}' for option in _TAKES[name])}")
    choices = _only(gap=gap, slip=slip, limit=sliding_limit)
    if choices and correction is not CorrectionName.PAPER:
        first = next(option for option, value in zip(_PAPER, (gap, slip, sliding_limit), strict=True) if value)
        raise ValueError(f"{flag}{first} belongs to {flag}correction paper")
    if name is SolverName.SINGLE:
        return am.SingleGrid(**_only(omega=omega, condensed=condensed, rtol=rtol, max_sweeps=most))
    if name is SolverName.ACTIVE:
        options = _only(strength=strength, lag=lag)
        if options and linear is not LinearName.AMG:
            raise ValueError(f"{flag}{next(iter(options))} belongs to {flag}linear amg")
        method = am.AMG(**options) if linear is LinearName.AMG else am.Direct()
        return am.ActiveSet(linear=method, **_only(rtol=rtol, max_steps=most))
    made = {None: None, CorrectionName.TRUNCATED: am.Truncated(), CorrectionName.MONOTONE: am.Monotone(),
            CorrectionName.PAPER: am.PaperCorrection(**choices)}
    kind = am.FullMultigrid if name is SolverName.FULL else am.Multigrid
    return kind(cycle=am.Cycle(**_only(shape=cycle and cycle.value, pre=pre, post=post)),
                smoother=am.ProjectedGaussSeidel(**_only(omega=omega, order=order and order.value)),
                correction=made[correction], **_only(rtol=rtol, max_cycles=most))


def _only(**options: Any) -> dict[str, Any]:
    """Options that are given; the others keep the defaults of the class."""
    return {name: value for name, value in options.items() if value is not None}
