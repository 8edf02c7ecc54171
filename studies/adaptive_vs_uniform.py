"""Adaptive against uniform meshes: what an accuracy costs, in nodes, work and seconds.

Seven problems (one body and pairs, plane, axisymmetric and 3D), on uniform meshes, on meshes graded by hand, and on
those of the adaptive loop by two engines and three indicators. Errors are against references on far finer meshes.

    python studies/adaptive_vs_uniform.py [--quick] [--out DIR]
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
QUICK: Mapping[int, tuple[int, int, int]] = {2: (2500, 25_000, 18_000), 3: (900, 12_000, 6000)}
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
    sizes = QUICK if context.quick else FULL
    found, references = [], []
    for name, case in CASES.items():
        most, nodes, uniform = sizes[case.dim]
        uniform = uniform if context.quick else FURTHER.get(name, uniform)
        row = context.study(runs.reference, {"case": [name]}, nodes=nodes).iloc[0]
        references.append(row)
        runs.YARDSTICKS[name, nodes] = runs.yardstick(name, row)
        for family in runs.FAMILIES:
            study = context.study(runs.family, {"case": [name], "family": [family]},
                                  most=uniform if family == "uniform" else most, reference_nodes=nodes)
            found.append(pd.DataFrame(json.loads(study["meshes"].iloc[0])).assign(case=name, family=family))
    rows = pd.concat(found, ignore_index=True)
    return common.Section("Adaptive against uniform meshes", TEXT,
                          [*tables(rows, pd.DataFrame(references)), *figures(rows, context.quick)])


if __name__ == "__main__":
    common.main(run, __doc__.split("\n")[0])
