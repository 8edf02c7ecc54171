"""history: how residual, change and estimated error fall with work, cycles or time."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptmg.plot.style import CYCLE, GREY, canvas, label_text, plain, styled
from adaptmg.problem import checks
from adaptmg.solver.result import Result

__all__ = ["history"]

_QUANTITIES = {"error_estimate": "estimated error (relative, energy norm)",
               "true_error": "true error (relative, energy norm)", "residual": "natural residual (relative)",
               "relative_change": "change in one cycle (relative, Euclidean)",
               "change": "change between checks (relative, energy norm)"}
_AGAINST = {"work_units": "work units", "cycle": "cycle", "seconds": "time [s]"}
_DASHES = ("-", "--", ":", "-.")


@styled
def history(results: Result | Mapping[str, Result], against: str = "work_units", ax: Axes | None = None, *,
            quantity: str | None = None) -> Figure:
    """Draw convergence histories on a logarithmic scale.

    Parameters
    ----------
    results : Result or mapping of label to Result
    against : {"work_units", "cycle", "seconds"}
        Seconds are those since the solver began.
    ax : matplotlib Axes, optional
    quantity : {"error_estimate", "true_error", "residual", "relative_change", "change"}, optional
        Default: for one result all it recorded, for several the true error if all recorded it, else the residual
        (an estimate made from changes cannot see that a method stalled).

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    ValueError
        If a result did not record what is asked for.
    """
    several = isinstance(results, Mapping)
    runs = dict(results) if several else {"": results}
    if not runs or not all(isinstance(r, Result) for r in runs.values()):
        raise TypeError(f"results must be a Result or a mapping of labels to Results, got {results!r}")
    checks.choice("against", against, _AGAINST)
    quantities = _chosen(runs, quantity, several)
    ax = canvas(ax, (6.4, 4.2))
    for k, (label, result) in enumerate(runs.items()):
        for j, name in enumerate(quantities):
            x, y = np.asarray(result.history[against], dtype=float), np.asarray(result.history[name], dtype=float)
            shown = np.isfinite(x) & np.isfinite(y) & (y > 0)
            ax.semilogy(x[shown], y[shown], marker="o" if shown.sum() <= 60 else "",
                        linestyle="-" if several else _DASHES[j], color=CYCLE[(k if several else j) % len(CYCLE)],
                        label=label_text(str(label)) if several else _QUANTITIES[name])
    tolerances = {result.rtol for result in runs.values()}
    if len(tolerances) == 1:
        ax.axhline(tolerances.pop(), color=GREY, linewidth=0.9, linestyle=(0, (4, 3)), zorder=1)
        ax.annotate("rtol", (1.0, next(iter(runs.values())).rtol), xycoords=("axes fraction", "data"), color=GREY,
                    fontsize=8.5, ha="right", va="bottom")
    ax.set_xlabel(_AGAINST[against])
    if several or len(quantities) == 1:
        ax.set_ylabel(_QUANTITIES[quantities[0]])
    else:
        ax.set_ylabel("relative measure")
        ax.set_title(plain(next(iter(runs.values())).problem_name))
    ax.grid(True)
    if several or len(quantities) > 1:
        ax.legend(loc="upper right")
    if against == "cycle":
        ax.xaxis.get_major_locator().set_params(integer=True)
    return ax.figure


def _chosen(runs: Mapping[str, Result], quantity: str | None, several: bool) -> list[str]:
    """What to draw, checked: recorded by every run with at least one finite positive value."""
    def recorded(result: Result, name: str) -> bool:
        values = np.asarray(result.history.get(name, ()), dtype=float)
        return bool((np.isfinite(values) & (values > 0)).any())

    if quantity is not None:
        checks.choice("quantity", quantity, _QUANTITIES)
    wanted = list(_QUANTITIES if quantity is None else (quantity,))
    if several and quantity is None:
        wanted.sort(key=("true_error", "residual", *_QUANTITIES).index)
    found = [name for name in wanted if all(recorded(result, name) for result in runs.values())]
    if not found:
        known = {label or result.solver_name: [n for n in _QUANTITIES if recorded(result, n)]
                 for label, result in runs.items()}
        raise ValueError(f"not every result recorded {quantity or 'a common quantity'}; recorded are {known}")
    return found[:1] if several else found
