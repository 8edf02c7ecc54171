"""The dovetail loaded in steps: clamped, pulled out, let go. Part of ``dovetail.py``."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import common
import dovetail_pictures
import numpy as np
import pandas as pd
from common import Context, Figure, Table
from dovetail_sweeps import RTOL, TOP, grids_of, zones
from paper_runs import span, table

import adaptmg as am

#: ratio of sizes from level to level
STEP = 1.7
PULL = 100.0  # MPa


def factors(steps: int, unload: bool) -> np.ndarray:
    """Of the pull: up in ``steps`` steps; with ``unload`` from the clamped joint, and down again."""
    up = np.arange(1, steps + 1) / steps
    return np.r_[0.0, up, up[-2::-1], 0.0] if unload else up


@lru_cache(maxsize=4)
def grids(finest: float, levels: int) -> am.Hierarchy:
    """Graded grids of the default case."""
    return grids_of(0.2, 0.0, 50.0, finest, STEP, levels)


@lru_cache(maxsize=4)
def history(finest: float, levels: int, steps: int, unload: bool, rtol: float) -> am.PathResult:
    """The clamp stays, the pull follows :func:`factors`."""
    path = am.LoadPath({"tongue.top": factors(steps, unload), "block.side": 1.0})
    return am.solve_path(grids(finest, levels), path, am.FullMultigrid(rtol=rtol), throw=False)


def cost(finest: float, levels: int, steps: int, unload: bool, rtol: float, times: int) -> dict[str, Any]:
    """A path compared with one step with all loads; the quickest of some runs."""
    # the mesh, and kernels
    am.solve(grids(finest, levels), am.FullMultigrid(rtol=rtol), throw=False)
    single = common.quickest(grids(finest, levels), am.FullMultigrid(rtol=rtol), seconds=1e9, times=times)
    history.cache_clear()
    paths = [history(finest, levels, steps, unload, rtol)]
    for _ in range(times - 1):
        history.cache_clear()
        paths.append(history(finest, levels, steps, unload, rtol))
    rows = min((path.table() for path in paths), key=lambda rows: rows["seconds"].sum())
    return {"nodes": grids(finest, levels).finest.n_nodes, "load_steps": len(rows), "complete": paths[0].complete,
            "one_cycles": single.cycles, "one_work": single.work_units, "one_rate": single.rate,
            "one_seconds": single.seconds, "path_cycles": int(rows["cycles"].sum()),
            "most_cycles": int(rows["cycles"].max()), "path_work": float(rows["work_units"].sum()),
            "path_seconds": float(rows["seconds"].sum()), "residual": float(rows["residual"].max())}


def walked(finest: float, levels: int, steps: int, unload: bool, rtol: float) -> dict[str, Any]:
    """What each step of a path gives: entries "name k"."""
    path = history(finest, levels, steps, unload, rtol)
    row: dict[str, Any] = {"n": len(path), "complete": path.complete}
    slid = np.zeros(len(path[0].contact))
    for k, (result, (_, line)) in enumerate(zip(path, path.table().iterrows(), strict=True)):
        c = result.contact
        # from the first step on: what the clamp alone did is not part of it
        slid = slid + (c.slip[:, 0] if k else 0.0)
        found = {"factor": factors(steps, unload)[k], "lift": float(result.probe([TOP])[0, 1]), **zones(result),
                 "slid": float(np.abs(slid[c.boundary == c.names.index("tongue.flank")]).max()),
                 "cycles": result.cycles, "work": result.work_units, "residual": result.residual,
                 "outcome": result.status.name, "pressure": line["pressure [Pa]"]}
        row |= {f"{name} {k}": value for name, value in found.items()}
    return row


def items(context: Context) -> tuple[list[Table | Figure], pd.DataFrame]:
    """Tables and figure, and the costs."""
    here = {"finest": 2.4e-3 if context.quick else 0.6e-3, "levels": 3 if context.quick else 5}
    fixed = {"rtol": RTOL, "unload": True, **here}
    steps = (2, 10) if context.quick else (5, 10, 20, 40)
    rows = {n: unfolded(context.study(walked, {"steps": (n,)}, **fixed).iloc[0]) for n in steps}
    single = context.study(walked, {"steps": (1,)}, rtol=RTOL, unload=False, **here).iloc[0]["lift 0"]
    figure = dovetail_pictures.history_figure(history(**fixed, steps=10), PULL * factors(10, True),
                                              4 if context.quick else 8)
    costs = costs_of(context, here)
    nodes = grids(**here).finest.n_nodes
    return [history_table(rows[10], nodes), figure, step_table(rows, single, nodes), cost_table(costs)], costs


def unfolded(row: pd.Series) -> pd.DataFrame:
    """One row a step of what :func:`walked` has stored."""
    names = [name[:-2] for name in row.index if name.endswith(" 0")]
    return pd.DataFrame([{name: row[f"{name} {k}"] for name in names} for k in range(row["n"])])


def costs_of(context: Context, here: dict[str, Any]) -> pd.DataFrame:
    """Paths compared with single steps."""
    fixed = {"steps": 10, "rtol": RTOL, "times": 1 if context.quick else 2}
    cases = [(here, False)]
    if not context.quick:
        cases += [(here, True), ({"finest": 0.145e-3, "levels": 7}, False)]
    frame = pd.concat([context.study(cost, {"unload": (unload,)}, **size, **fixed) for size, unload in cases],
                      ignore_index=True)
    return frame.assign(**{"work ratio": frame["path_work"] / frame["one_work"] * 10 / frame["load_steps"],
                           "seconds ratio": frame["path_seconds"] / frame["one_seconds"] * 10 / frame["load_steps"]})


def history_table(rows: pd.DataFrame, nodes: int) -> Table:
    """Step by step."""
    frame = rows.assign(step=range(len(rows)), pull=PULL * rows["factor"], lift=1e6 * rows["lift"],
                        slid=1e6 * rows["slid"], pressure=1e-6 * rows["pressure"],
                        **{"open to": 1e3 * rows["open_to"], "stick from": 1e3 * rows["stick_from"],
                           "stick to": 1e3 * rows["stick_to"], "test": f"error {RTOL:g}"})
    first, last = frame.iloc[0], frame.iloc[-1]
    full = frame.iloc[len(frame) // 2]
    half = frame[np.isclose(rows["factor"], 0.5)]["lift"]
    note = (f"The clamp stays; the pull rises to {PULL:g} MPa and falls again. Lift at full pull "
            f"{full['lift']:.1f} µm; at half of it {half.iloc[0]:.1f} µm on the way up, {half.iloc[-1]:.1f} µm on the "
            "way down. Let go, the joint differs from the clamped one by "
            f"{last['lift'] - first['lift']:.2f} µm of lift and at most {last['slid']:.2f} µm of slip. Open to, stick: "
            "depth below the mouth; stick from the first node that sticks to the last ('-': none). Slid: largest sum "
            "of the slips at a node of the flank since the clamped state (open ones too). Pressure: the largest.")
    columns = ["step", "pull", "lift", "open to", "stick from", "stick to", "slid", "pressure", "cycles", "work",
               "test", "residual", "outcome"]
    made = table("dovetail_history", frame, columns, "Dovetail in load steps: clamped, pulled, let go (friction .2, "
                 f"{nodes} nodes)", note,
                 {"pull": ".0f", "lift": ".2f", "slid": ".2f", "pressure": ".0f", "open to": ".2f",
                  "stick from": ".2f", "stick to": ".2f"})
    made.units = dict(made.units) | {"pull": "MPa", "lift": "µm", "slid": "µm", "pressure": "MPa", "open to": "mm",
                                     "stick from": "mm", "stick to": "mm"}
    return made


def step_table(rows: dict[int, pd.DataFrame], single: float, nodes: int) -> Table:
    """How the answer depends on the number of steps."""
    found = []
    for n, part in rows.items():
        lift, half = 1e6 * part["lift"], np.flatnonzero(np.isclose(part["factor"], 0.5))
        found.append({"steps up": n, "clamped": lift.iloc[0],
                      "half, pulling": lift.iloc[half[0]] if half.size else np.nan, "full pull": lift.iloc[n],
                      "half, letting go": lift.iloc[half[-1]] if half.size else np.nan, "let go": lift.iloc[-1],
                      "sticks at full pull": bool(part["stick_from"].notna().iloc[n]),
                      "cycles": int(part["cycles"].sum()), "largest residual": part["residual"].max(),
                      "all converged": bool((part["outcome"] == "CONVERGED").all())})
    frame = pd.DataFrame(found)
    values = frame["full pull"]
    note = (f"Lifts at {PULL / 2:g} MPa, where the number of steps allows, and {PULL:g} MPa. Coulomb friction depends "
            f"on the way: clamp and pull in one step give a lift of {1e6 * single:.1f} µm; the clamp first, then the "
            f"pull, {span(values, '.1f')} µm with {frame['steps up'].iloc[0]} to {frame['steps up'].iloc[-1]} steps")
    note += "." if frame["sticks at full pull"].any() else (
        ": at full pull the whole flank slips, so that the steps before leave no trace.")
    units = dict.fromkeys(("clamped", "half, pulling", "full pull", "half, letting go", "let go"), "µm")
    return Table("dovetail_steps", frame, f"Dovetail: lift against the number of load steps (friction .2, {nodes} "
                 "nodes)", note, units, {**dict.fromkeys(units, ".2f"), "largest residual": ".1e"})


def cost_table(costs: pd.DataFrame) -> Table:
    """Whether steps are cheap."""
    names = {"nodes": "nodes", "unload": "clamped first", "load_steps": "load steps", "one_cycles": "cycles of one",
             "one_work": "work of one", "one_rate": "rate of one", "one_seconds": "seconds of one",
             "path_cycles": "cycles", "most_cycles": "most in a step", "path_work": "work", "path_seconds": "seconds",
             "work ratio": "work ratio", "seconds ratio": "seconds ratio", "residual": "largest residual",
             "complete": "complete"}
    frame = costs[list(names)].rename(columns=names)
    note = (f"Ratios: cost of ten steps (of more: ten on the average) over that of one solve with all loads, full "
            f"multigrid start to {RTOL:g} in both; set-up counts in the seconds (matrices and transfers of a path are "
            "made once). Clamped first: before the pull, and let go after it.")
    return Table("dovetail_history_cost", frame, "Dovetail: what ten load steps cost", note,
                 {"seconds": "s", "seconds of one": "s", "work": "WU", "work of one": "WU"},
                 {"work of one": ".1f", "rate of one": ".2f", "seconds of one": ".2f", "work": ".0f", "seconds": ".2f",
                  "work ratio": ".2f", "seconds ratio": ".2f", "largest residual": ".1e"})
