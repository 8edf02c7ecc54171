"""Adaptive against uniform meshes: what an accuracy costs, in nodes, work and seconds.

Seven problems (one body and pairs, plane, axisymmetric and 3D), on uniform meshes, on meshes graded by hand, and on
those of the adaptive loop by two engines and three indicators. Errors are against references on far finer meshes.

    python studies/adaptive_vs_uniform.py [--quick | --full] [--out DIR]
"""

from __future__ import annotations

import json
from collections.abc import Mapping

import adaptive_runs as runs
import common
import pandas as pd
from adaptive_cases import CASES
from adaptive_figures import figures
from adaptive_tables import tables

#: dimension -> nodes of adaptive and graded meshes, of the reference, of uniform meshes; at most
FULL: Mapping[int, tuple[int, int, int]] = {2: (30_000, 300_000, 300_000), 3: (12_000, 250_000, 300_000)}
SIZES: Mapping[int, tuple[int, int, int]] = {2: (6000, 60_000, 70_000), 3: (2000, 25_000, 20_000)}
QUICK: Mapping[int, tuple[int, int, int]] = {2: (2000, 18_000, 18_000), 3: (800, 6000, 6000)}
#: families of solids in a quick run
QUICK_3D = ("uniform", "residual, remeshed", "residual, bisected")
#: cases whose uniform meshes go further: the time to an accuracy is asked for
FURTHER = {"upset block": 1_100_000, "flat punch": 600_000, "dovetail": 1_100_000}

TEXT = (
    "What was asked: how much an accuracy costs on uniform meshes, on meshes graded by hand towards contact, and on "
    "those of the adaptive loop am.adapt, with default settings, remeshed by Netgen or bisected, marked by the "
    "residual, by stress recovery, or for a goal. Every mesh is solved by the default method (truncated multigrid); "
    "uniform and graded ones each on their own hierarchy from a nested start, to a tenth of the discretisation error, "
    "as every step of the loop is. Seconds are processor time of one thread with warm kernels, for everything: meshes, "
    "matrices, transfers, all solves and all estimates. Errors are against a reference on a bisected mesh many times "
    "finer.")


def run(context: common.Context) -> common.Section:
    """All cases and families."""
    sizes = QUICK if context.quick else FULL if context.full else SIZES
    references = pd.concat([context.study(runs.reference, {"case": of_dim(dim)}, nodes=nodes)
                            for dim, (_, nodes, _) in sizes.items()], ignore_index=True)
    found = []
    for name, case in CASES.items():
        most, nodes, uniform = sizes[case.dim]
        if sizes is FULL:
            uniform = FURTHER.get(name, uniform)
        runs.YARDSTICKS[name, nodes] = runs.yardstick(name, references[references["case"] == name].iloc[0])
        for family in QUICK_3D if context.quick and case.dim == 3 else runs.FAMILIES:
            study = context.study(runs.family, {"case": [name], "family": [family]}, timed=True,
                                  most=uniform if family == "uniform" else most, reference_nodes=nodes)
            found.append(pd.DataFrame(json.loads(study["meshes"].iloc[0])).assign(case=name, family=family))
    rows = pd.concat(found, ignore_index=True)
    return common.Section("Adaptive against uniform meshes", TEXT,
                          [*tables(rows, references), *figures(rows, context.quick)])


def of_dim(dim: int) -> list[str]:
    """Names of the cases in 2D or 3D."""
    return [name for name, case in CASES.items() if case.dim == dim]


if __name__ == "__main__":
    common.main(run, __doc__.split("\n")[0])
