"""From which error on adaptive meshes pay: their cost against that of uniform ones at equal energy error.

Part of ``adaptive_vs_uniform.py``. With c_u(e) the processor time that uniform meshes take to an energy error e,
log c_u interpolated linearly in log e between meshes, the gain of an adaptive mesh of error e and time c is
c_u(e) / c; they pay where it is above 1. Beyond the finest uniform mesh the line through the last three is continued,
which is said wherever such a value stands.
"""

from __future__ import annotations

from dataclasses import dataclass

import common
import numpy as np
import pandas as pd
from adaptive_cases import EXPONENTS
from adaptive_runs import DEFAULT
from paper_runs import listed

#: engines of the loop, as text
ENGINES = {"bisected": "bisected", "remeshed": "remeshed by Netgen (the default)"}
#: meshes over which rates are fitted, and along which costs are continued
LAST = 3
#: errors at which costs are compared between the coarsest and the finest that both families have
SAMPLES = 200


def at_error(group: pd.DataFrame, error: float, column: str) -> tuple[float, bool]:
    """Value of a column where the energy error has fallen to ``error``, and whether it lies beyond the last mesh."""
    x, y = np.log(group["energy_error"].to_numpy()), np.log(group[column].to_numpy())
    wanted = np.log(error)
    below = np.flatnonzero(x <= wanted)
    if not below.size:
        slope = np.polyfit(x[-LAST:], y[-LAST:], 1)[0] if len(x) >= LAST else float("nan")
        return float(np.exp(y[-1] + slope * (wanted - x[-1]))), True
    k = int(below[0])
    if k == 0:
        return float(np.exp(y[0])) if np.isclose(x[0], wanted, rtol=0, atol=1e-9) else float("nan"), False
    share = (wanted - x[k - 1]) / (x[k] - x[k - 1])
    return float(np.exp((1 - share) * y[k - 1] + share * y[k])), False


@dataclass(frozen=True)
class Crossing:
    """Below which error a family takes less time than uniform meshes, as far as both were measured."""

    error: float
    throughout: bool = False

    @property
    def found(self) -> bool:
        """Whether there is such an error."""
        return bool(np.isfinite(self.error))


def crossing(uniform: pd.DataFrame, group: pd.DataFrame, least: float = 0.0) -> Crossing:
    """Where a family begins to pay for good, down to the error ``least`` or what both reach."""
    least = max(least, uniform["energy_error"].min(), group["energy_error"].min())
    most = min(uniform["energy_error"].max(), group["energy_error"].max())
    if not least < most:
        return Crossing(float("nan"))
    errors = np.geomspace(least, most, SAMPLES)
    # by rounding the least may lie beyond its mesh
    errors[0] = least
    quicker = [at_error(group, error, "cpu")[0] < at_error(uniform, error, "cpu")[0] for error in errors]
    if not quicker[0]:
        return Crossing(float("nan"))
    if all(quicker):
        return Crossing(float(most), throughout=True)
    return Crossing(float(errors[quicker.index(False)]))


def gains(rows: pd.DataFrame) -> pd.DataFrame:
    """Nodes and time of uniform meshes over those of each mesh, at its energy error."""
    found = pd.DataFrame({"nodes": np.nan, "time": np.nan, "beyond": False}, index=rows.index)
    for _, of_case in rows.groupby("case", sort=False):
        uniform = of_case[of_case["family"] == "uniform"]
        for k, mesh in of_case[of_case["family"] != "uniform"].iterrows():
            (nodes, beyond), (time, _) = (at_error(uniform, mesh["energy_error"], name) for name in ("nodes", "cpu"))
            found.loc[k] = [nodes / mesh["nodes"], time / mesh["cpu"], beyond]
    return found


def pays_table(rows: pd.DataFrame) -> common.Table:
    """Problem by problem: times to the least error that uniform and default adaptive meshes reach, and crossings."""
    lines = []
    for case, of_case in rows.groupby("case", sort=False):
        groups = {family: of_case[of_case["family"] == family] for family in ("uniform", *DEFAULT)}
        error = least_common(of_case)
        at = {family: at_error(group, error, "cpu")[0] for family, group in groups.items()}
        nodes = {family: at_error(group, error, "nodes")[0] for family, group in groups.items()}
        line = {"problem": case, "energy error": 100 * error, "uniform": at["uniform"]}
        line |= {short(family): at[family] for family in DEFAULT}
        line |= {f"nodes, {short(family)}": nodes["uniform"] / nodes[family] for family in DEFAULT}
        line |= {f"time, {short(family)}": at["uniform"] / at[family] for family in DEFAULT}
        for family in DEFAULT:
            line[f"{short(family)} pays below"] = pays_text(crossing(groups["uniform"], groups[family], error))
        lines.append(line)
    frame = pd.DataFrame(lines)
    engines = [short(family) for family in DEFAULT]
    note = ("The least energy error that uniform, remeshed and bisected meshes (residual indicator) all reach here, "
            "and the processor time to it; nodes and time: uniform over adaptive. Pays below: energy error from which "
            "on these meshes take less time than uniform ones, down to that least error; 'all': at each error "
            "compared, up to the one in brackets; 'no': slower at the least one. Between meshes logarithms are "
            "interpolated. The last mesh of a loop is cut short at the nodes it may have: a step for a small gain.")
    units = {"energy error": "%", "uniform": "s"} | dict.fromkeys(engines, "s")
    units |= {f"{what}, {name}": "ratio" for what in ("nodes", "time") for name in engines}
    units |= {f"{name} pays below": "%" for name in engines}
    formats = {"energy error": ".2g", "uniform": ".2g"} | dict.fromkeys(engines, ".2g")
    formats |= {f"{what}, {name}": ".3g" for what in ("nodes", "time") for name in engines}
    return common.Table("adaptive_pays", frame, "From which error on adaptive meshes pay, everything counted", note,
                        units, formats, open=True)


def least_common(of_case: pd.DataFrame) -> float:
    """The least energy error that uniform meshes and the default loop, by both engines, reach."""
    compared = of_case[of_case["family"].isin(["uniform", *DEFAULT])]
    return float(compared.groupby("family")["energy_error"].min().max())


def short(family: str) -> str:
    """'remeshed' of 'residual, remeshed'."""
    return family.split(", ")[1]


def pays_text(found: Crossing) -> str:
    """A cell of :func:`pays_table`, per cent."""
    if not found.found:
        return "no"
    return f"all ({two(100 * found.error)})" if found.throughout else two(100 * found.error)


def or_more(cell: str) -> str:
    """A cell of :func:`pays_table` in a sentence: '5 %', or '16 % or more' where no larger error was compared."""
    return f"{cell[5:-1]} % or more" if cell.startswith("all (") else f"{cell} %"


def two(value: float) -> str:
    """Two digits, without an exponent."""
    return f"{float(format(value, '.2g')):g}"


def summary(rows: pd.DataFrame) -> str:
    """What was asked and what came out."""
    frame = pays_table(rows).frame.set_index("problem")
    said = ["From which energy error on does adaptivity pay, everything counted? At the least error that uniform, "
            f"bisected and remeshed meshes all reach here: {'; '.join(count_words(frame, name) for name in ENGINES)}.",
            *(engine_sentence(frame, name) for name in ENGINES)]
    slowed = [case for case in frame.index if not EXPONENTS[case] >= 1]
    if slowed:
        said.append(f"Singular corners and edges slow uniform meshes down ({listed(slowed)}), so that the gain in "
                    "nodes grows as the error falls; without them adaptive meshes save a constant factor of nodes at "
                    "most. What they cost is the mesh generator, and the steps before them.")
    return " ".join(said)


def count_words(frame: pd.DataFrame, name: str) -> str:
    """In how many problems meshes of an engine are quicker than uniform ones, and by how much."""
    ratio = frame[f"time, {name}"]
    wins = ratio[ratio > 1]
    return (f"{ENGINES[name]} they are quicker than uniform ones in {len(wins)} of {len(frame)} problems"
            + (f", {between(wins)} times, with {between(frame.loc[wins.index, f'nodes, {name}'])} times fewer nodes"
               if len(wins) else ""))


def engine_sentence(frame: pd.DataFrame, name: str) -> str:
    """Below which errors meshes of an engine are quicker than uniform ones, and where they are not."""
    ratio, below = frame[f"time, {name}"], frame[f"{name} pays below"]
    wins, losses = ratio[ratio > 1], ratio[~(ratio > 1)]
    said = [f"{ENGINES[name].capitalize().replace('netgen', 'Netgen')}"]
    if len(wins):
        said.append(f"they pay below {listed([f'{or_more(below[case])} ({case})' for case in wins.index])}")
    if len(losses):
        said.append("uniform meshes are quicker on, by factors: "
                    + listed([f"{case} ({two(1 / value)})" for case, value in losses.items()]))
    return f"{said[0]}, {'; '.join(said[1:])}."


def between(values: pd.Series) -> str:
    """'smallest to largest' with two digits, or the one value."""
    low, high = two(values.min()), two(values.max())
    return low if low == high else f"{low} to {high}"
