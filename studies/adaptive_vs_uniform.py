"""Adaptive against uniform meshes: what an accuracy costs, and from which error on adaptivity pays.

Seven problems (one body and pairs, plane, axisymmetric and 3D; a quick run: four, plane), on uniform meshes, on meshes
graded by hand towards contact, and on those of the adaptive loop :func:`adaptmg.adapt` with its default settings, by
two engines and three indicators. Every mesh is solved by the default method (truncated multigrid); uniform and graded
ones each on their own hierarchy from a nested start, to a tenth of the discretisation error, as every step of the loop
is.

Seconds are processor time of one thread with warm kernels, for everything: meshes, matrices, transfers, all solves and
all estimates; of an adaptive mesh those of all steps before it too. Errors are against a reference on a bisected mesh
with some ten times the nodes of the finest adaptive one.

    python studies/adaptive_vs_uniform.py [--quick | --full] [--out DIR]
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import adaptive_runs as runs
import common
import pandas as pd
from adaptive_cases import CASES, EXPONENTS
from adaptive_figures import figures
from adaptive_pays import summary
from adaptive_tables import tables


@dataclass(frozen=True)
class Sizes:
    """Nodes of the finest meshes, at most.

    Attributes
    ----------
    loop : int
        Of the default loop, remeshed and bisected.
    uniform : int
        So many that the time to the errors of loops is measured; a quarter where the solution is regular.
    other : int
        Graded by hand, and led by recovery or a goal; 0: left out.
    reference : int
    """

    loop: int
    uniform: int
    other: int
    reference: int


#: dimension -> sizes
FULL: Mapping[int, Sizes] = {2: Sizes(30_000, 1_100_000, 30_000, 300_000), 3: Sizes(12_000, 300_000, 12_000, 250_000)}
SIZES: Mapping[int, Sizes] = {2: Sizes(30_000, 1_100_000, 6000, 300_000), 3: Sizes(6000, 300_000, 2000, 120_000)}
#: plane problems alone: kernels of solids need not be compiled
QUICK: Mapping[int, Sizes] = {2: Sizes(4000, 70_000, 0, 40_000)}
#: of a quick run
QUICK_CASES = ("GRECO bar", "upset block", "flat punch", "dovetail")

TEXT = (
    "Every mesh is solved by the default method; uniform and graded ones on a hierarchy of their own with a nested "
    "start, to a tenth of the discretisation error, as every step of the loop am.adapt is. Seconds: processor time of "
    "one thread with warm kernels, for everything: meshes, matrices, transfers, solves, estimates, of an adaptive mesh "
    "all steps before it too.")


def run(context: common.Context) -> common.Section:
    """All cases and families."""
    sizes = QUICK if context.quick else FULL if context.full else SIZES
    cases = {dim: [name for name, case in CASES.items() if case.dim == dim
                   and not (context.quick and name not in QUICK_CASES)] for dim in sizes}
    references = [context.study(runs.reference, {"case": cases[dim]}, nodes=size.reference)
                  for dim, size in sizes.items()]
    for size, found in zip(sizes.values(), references, strict=True):
        for _, row in found.iterrows():
            runs.YARDSTICKS[row["case"], size.reference] = runs.yardstick(row["case"], row)
    rows = pd.concat([meshes(context, cases[dim], size) for dim, size in sizes.items()], ignore_index=True)
    references = pd.concat(references, ignore_index=True)
    return common.Section("Adaptive against uniform meshes", TEXT,
                          [*tables(rows, references), *figures(rows, context.quick)], summary=summary(rows))


def meshes(context: common.Context, cases: Sequence[str], size: Sizes) -> pd.DataFrame:
    """One row a mesh, of all families, case after case."""
    slowed = [case for case in cases if not EXPONENTS[case] >= 1]
    others = [family for family in runs.FAMILIES if family not in ("uniform", *runs.DEFAULT)]
    # without a singularity uniform meshes come down to the error of the reference first
    plan = [(others, cases, size.other), (runs.DEFAULT, cases, size.loop), (["uniform"], slowed, size.uniform),
            (["uniform"], [case for case in cases if case not in slowed], size.uniform // 4)]
    found = {}
    for families, mine, most in plan:
        if most and mine:
            study = context.study(runs.family, {"case": mine, "family": list(families)}, timed=True, most=most,
                                  reference_nodes=size.reference)
            for _, row in study.iterrows():
                key = (row["case"], row["family"])
                found[key] = pd.DataFrame(json.loads(row["meshes"])).assign(case=key[0], family=key[1])
    return pd.concat([found[case, family] for case in cases for family in runs.FAMILIES if (case, family) in found],
                     ignore_index=True)


if __name__ == "__main__":
    common.main(run, __doc__.split("\n")[0])
