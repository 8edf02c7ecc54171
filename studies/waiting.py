"""What a user waits for: seconds of wall time from the problem to its solution, by phase, one thread.

Everything counts: meshes, assembly, transfers, statics, set-up, the nested start, cycles to an estimated error of 1e-8
and the certificate; pyamg's smoothed aggregation (its defaults, rigid motions as near-nullspace) stands next to it, on
the glued matrix of the same mesh, set-up and solve alone.
"""

from __future__ import annotations

import time
from typing import Any

import pandas as pd
from common import Context, Table

import adaptmg as am
from adaptmg.solver.active_set import glued_system

SIZES, QUICK = {"2D": (256, 512, 1024), "3D": (32, 64)}, {"2D": (32,), "3D": (4,)}
MESH, SOLVE = ("mesh", "assembly", "transfer"), ("statics", "setup", "start", "cycles", "certificate", "result")


def wait(family: str, size: int) -> dict[str, Any]:
    """One row: the better of two runs."""
    return min((_once(family, size) for _ in range(2)), key=lambda row: row["wall_s"])


def _once(family: str, size: int) -> dict[str, Any]:
    problem = am.cases.greco_bar() if family == "2D" else am.cases.greco_block()
    chain = [size]
    while chain[0] % 2 == 0 and chain[0] > (4 if family == "2D" else 2):
        chain.insert(0, chain[0] // 2)
    begin = time.perf_counter()
    grids = am.Hierarchy.uniform(problem, chain)
    built = time.perf_counter()
    result = am.solve(grids, am.FullMultigrid(rtol=1e-8))
    solved = time.perf_counter()
    matrix, load, modes = glued_system(grids.finest.discrete)
    begin_glued = time.perf_counter()
    prepared = am.AMG().setup(matrix, modes)
    ready = time.perf_counter()
    prepared.solve(load, rtol=1e-8)
    setup, solve = ready - begin_glued, time.perf_counter() - ready
    return {"nodes": grids.finest.n_nodes, **{f"{name}_s": grids.timings.get(name, 0.0) for name in MESH},
            **{f"{name}_s": result.timings.get(name, 0.0) for name in SOLVE}, "hierarchy_s": built - begin,
            "solve_s": solved - built, "wall_s": solved - begin,
            "accounted": (sum(grids.timings.values()) + result.seconds) / (solved - begin), "pyamg_setup_s": setup,
            "pyamg_solve_s": solve, "solve_over_pyamg": (solved - built) / (setup + solve),
            "wall_over_pyamg": (solved - begin) / (setup + solve)}


#: stored results and how they are printed
_SHOWN = {"family": "", "nodes": "nodes", "hierarchy_s": "hierarchy", "solve_s": "solve", "wall_s": "together",
          **{f"{name}_s": {"mesh": "meshes", "assembly": "assembly", "transfer": "transfers"}[name] for name in MESH},
          **{f"{name}_s": {"setup": "set-up", "start": "nested start"}.get(name, name) for name in SOLVE},
          "pyamg_setup_s": "pyamg set-up", "pyamg_solve_s": "pyamg solve", "solve_over_pyamg": "solve / pyamg",
          "wall_over_pyamg": "together / pyamg"}


def table(context: Context) -> Table:
    """All rows."""
    sizes = QUICK if context.quick else SIZES
    rows = pd.concat([context.study(wait, {"family": [family], "size": list(each)}, timed=True)
                      for family, each in sizes.items()], ignore_index=True)
    frame = rows[list(_SHOWN)].rename(columns=_SHOWN | {"family": "dim"})
    seconds = [_SHOWN[name] for name in _SHOWN if name.endswith("_s")]
    note = ("Wall seconds, one thread, the better of two runs. Together: hierarchy (meshes, assembly, transfers) and "
            f"solve (statics to result); phases account for {rows['accounted'].min():.0%} of it or more. pyamg: "
            "smoothed aggregation on the glued matrix of the same mesh, set-up and solve to 1e-8; ratios over both.")
    return Table("benchmark_waiting", frame, "What a user waits for, by phase: GRECO bar and block, friction 1, nested "
                 "grids, to an estimated error of 1e-8", note, dict.fromkeys(seconds, "s"),
                 dict.fromkeys(seconds, ".3g") | {"solve / pyamg": ".3f", "together / pyamg": ".3f"})
