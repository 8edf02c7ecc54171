"""What the studies of the paper's three tables share: what a row measures, and how it is printed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import common
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

import adaptmg as am

#: true relative A-norm error at which methods are compared
TARGET = 1e-6
#: tolerance of the runs that are compared there: their estimated error, a little below TARGET
RTOL = 3e-7
#: our reading of the paper's test: tolerance of the change over one cycle or sweep, relative, Euclidean
CHANGE = 1e-6
#: said once where that test is first used
OUR_READING = (f"The paper goes on 'until a given precision is reached' and gives neither norm nor number; we take a "
               f"change over a cycle or sweep of at most {CHANGE:g} (relative, Euclidean).")
#: true errors at which the work is stored, for the pictures
ERRORS = tuple(10.0**(-k / 2) for k in range(1, 14))

COUNT = {1: "regular resolution", 2: "two grids", 3: "three grids", 4: "four grids", 5: "five grids", 6: "six grids"}

#: stored results and how they are printed: column, unit, format
_SHOWN = {
    "cycles_at": ("cycles", "", ".1f"), "work_at": ("work", "WU", ".1f"), "seconds_at": ("seconds", "s", ".3g"),
    "cycles": ("cycles", "", "d"), "work": ("work", "WU", ".1f"), "run_seconds": ("seconds", "s", ".3g"),
    "start_work": ("start work", "WU", ".1f"), "true_error": ("true error", "", ".1e"),
    "residual": ("natural residual", "", ".1e"), "change": ("last change", "", ".1e"), "outcome": ("status", "", ""),
    "rate": ("rate", "", ".2f"), "active_seconds": ("active set", "s", ".3g"),
}
_FORMATS = {"gain": ".1f", "speed-up": ".1f", "gain in s": ".1f"}


def chain(finest: int, levels: int) -> tuple[int, ...]:
    """Divisions of nested grids, halved from the finest, coarsest first."""
    return tuple(finest // 2**k for k in reversed(range(levels)))


def repeats(context: common.Context) -> int:
    """How often a short solve is repeated for its seconds."""
    return 3 if context.full and not context.quick else 1


def nodes_text(divisions: tuple[int, ...]) -> str:
    """Nodes of uniform grids as the paper writes them, finest first: 1089/289/81."""
    return "/".join(str((n + 1)**2) for n in reversed(divisions))


def measured(hierarchy: am.Hierarchy, solver: Any, reference: am.Result, target: float, times: int = 3
             ) -> dict[str, Any]:
    """One row: a solve, the quickest of up to ``times`` where it is short."""
    common.warm_up()
    results = [am.solve(hierarchy, solver, reference=reference, throw=False)]
    while len(results) < times and sum(result.seconds for result in results) < 0.3:
        results.append(am.solve(hierarchy, solver, reference=reference, throw=False))
    best = min(results, key=lambda result: result.seconds)
    at = common.first_below(best, target)
    change = best.history.get("relative_change", np.array([np.nan]))
    return {"cycles_at": at["cycle"], "work_at": at["work_units"], "seconds_at": at["seconds"],
            "cycles": best.cycles, "work": best.work_units, "start_work": best.start_work_units,
            "run_seconds": best.seconds, "true_error": common.energy_error(best, reference, hierarchy),
            "residual": best.residual, "change": float(change[-1]), "rate": best.rate, "outcome": best.status.name,
            "fallback": best.fallback,
            **{f"{name}_{k}": float(best.history[key][min(k, len(best.history[key]) - 1)])
               for k in (0, 1) for name, key in (("error", "true_error"), ("work", "work_units"))},
            **{_at(error): common.first_below(best, error)["work_units"] for error in ERRORS}}


def table(name: str, frame: pd.DataFrame, columns: list[str], caption: str, note: str = "",
          formats: Mapping[str, str] | None = None) -> common.Table:
    """A table of ``columns`` of ``frame``; those of :func:`measured` get their printed names, units and formats."""
    shown = {name: _SHOWN.get(name, (name, "", "")) for name in columns}
    printed = frame[columns].rename(columns={name: title for name, (title, _, _) in shown.items()})
    formats = {title: fmt for title, _, fmt in shown.values() if fmt} | \
              {title: fmt for title, fmt in (_FORMATS | dict(formats or {})).items() if title in printed}
    units = {title: unit for title, unit, _ in shown.values() if unit}
    return common.Table(name, printed.reset_index(drop=True), caption, note, units, formats)


def discretisation_error(problem: str, divisions: int) -> float:
    """||u_2h - u_h||_A / ||u_h||_A of the exact discrete solutions on a grid and on the next finer one."""
    fine = common.grids(problem, (divisions, 2 * divisions))
    reference = common.exact(problem, 2 * divisions).displacement.reshape(-1)
    coarse = (fine.finest.prolongation @ common.exact(problem, divisions).displacement).reshape(-1)
    matrix = fine.finest.discrete.matrix
    error = coarse - reference
    return float(np.sqrt(error @ (matrix @ error) / (reference @ (matrix @ reference))))


def draw_error(ax: Axes, row: pd.Series, label: str, **style: Any) -> Line2D:
    """True error against work of a stored row: reached errors as points, a cross where a run stops above TARGET."""
    points = [(row["work_0"], row["error_0"])]
    points += [(row[_at(error)], error) for error in ERRORS if error < row["error_0"] and np.isfinite(row[_at(error)])]
    x, y = zip(*points, (row["work"], row["true_error"]), strict=True)
    line, = ax.loglog(x, y, label=label, **({"marker": "o", "markersize": 3} | style))
    if not row["true_error"] <= TARGET:
        ax.loglog(row["work"], row["true_error"], marker="X", markersize=9, color=line.get_color(), linestyle="")
    return line


def listed(values: Any, spec: str = ".1f") -> str:
    """Numbers or words for a sentence: '1.2, 3.4 and 5.6'; 'none' if there are none."""
    texts = [value if isinstance(value, str) else format(value, spec) for value in values]
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts) or "none"


def span(values: Any, spec: str) -> str:
    """'smallest to largest', or the one value where both print alike."""
    low, high = format(min(values), spec), format(max(values), spec)
    return low if low == high else f"{low} to {high}"


def short(tolerance: float) -> str:
    """1e-2 for 0.01."""
    return f"{tolerance:.0e}".replace("e-0", "e-")


def _at(error: float) -> str:
    return f"work at {error:.0e}"
