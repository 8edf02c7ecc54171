"""Asymptotic rates of V(2,0) and W(2,0) in the monotone mode, on nested grids and on independent meshes."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import pandas as pd
from common import Context, Table, grids, warm_up
from paper_runs import chain, table

import adaptmg as am

PROBLEM, SIDE = "Coulomb bar", 40e-3
RTOL = 1e-9


@lru_cache(maxsize=2)
def graded(levels: int, factor: float) -> am.Hierarchy:
    """Independent Netgen meshes, the coarsest of size a/4, half as large at contact, finer by ``factor`` each level."""
    return am.Hierarchy.graded(am.cases.greco_bar(), tuple(SIDE / 4 / factor**k for k in range(levels)),
                               contact_ratio=2)


def rate(family: str, levels: int, cycle: str, order: str, deepest: int, factor: float, rtol: float) -> dict[str, Any]:
    """One run; the coarsest nested grid has 4 cells a side, independent meshes are the first of ``deepest``."""
    warm_up()
    hierarchy = (grids(PROBLEM, chain(4 * 2**(levels - 1), levels)) if family == "nested"
                 else graded(deepest, factor).truncated(finest=levels - 1))
    solver = am.FullMultigrid(correction=am.Monotone(), cycle=am.Cycle(shape=cycle, pre=2, post=0), rtol=rtol,
                              max_cycles=150, smoother=am.ProjectedGaussSeidel(order=order))
    result = am.solve(hierarchy, solver, throw=False)
    return {"nodes": hierarchy.finest.discrete.n_nodes, "contact_nodes": len(result.contact), "rate": result.rate,
            "cycles": result.cycles, "work": result.work_units, "run_seconds": result.seconds,
            "residual": result.residual, "estimate": result.error_estimate, "outcome": result.status.name,
            "mesh_ratio": max(level.mesh_ratio for level in hierarchy.levels[1:])}


def tables(context: Context) -> list[Table]:
    """One table."""
    both = {"cycle": ("V", "W"), "order": ("backward", "forward")}
    nested, loose, close = ((3, 4), (3,), (4,)) if context.quick else ((3, 4, 5, 6), (3, 4), (4, 5))
    if context.full and not context.quick:
        nested, loose, close = (*nested, 7), (*loose, 5), (*close, 6)
    frame = pd.concat([context.study(rate, {"family": (family,), "levels": levels} | both, deepest=max(levels),
                                     factor=factor, rtol=RTOL)
                       for family, levels, factor in (("nested", nested, 2.0), ("independent, h/2", loose, 2.0),
                                                      ("independent, h/1.7", close, 1.7))], ignore_index=True)
    frame = frame.assign(meshes=frame["family"], **{
        "mesh ratio": frame["mesh_ratio"], "contact nodes": frame["contact_nodes"],
        "estimated error": frame["estimate"], "cycle": frame["cycle"] + "(2,0)", "sweeps": frame["order"],
        "test": f"error {RTOL:g}"})
    columns = ["meshes", "nodes", "contact nodes", "levels", "mesh ratio", "cycle", "sweeps", "rate", "cycles", "work",
               "run_seconds", "test", "estimated error", "residual", "outcome"]
    caption = f"{PROBLEM}: asymptotic rates of the monotone mode, nested grids and independent meshes"
    meant = ("Rate: geometric mean of the last five cycles; nested start, coarsest problem condensed. Independent "
             "Netgen meshes have sizes falling by 2 (h/2) or 1.7 (h/1.7) from level to level; mesh ratio: largest "
             "local ratio of mesh sizes between two levels. ")
    return [table("cycle_rates", frame, columns, caption, meant + note(frame),
                  {"mesh ratio": ".2f", "estimated error": ".1e"})]


def note(frame: pd.DataFrame) -> str:
    """What was measured, in sentences."""
    sentences = []
    for family, part in frame.groupby("family", sort=False):
        spans = []
        for kind, rows in part.groupby(["cycle", "sweeps"], sort=False):
            low, high = rows["rate"].min(), rows["rate"].max()
            spans.append(f"{kind[0]} {kind[1]} {low:.2f}" + (f" to {high:.2f}" if len(rows) > 1 else ""))
        sentences.append(f"Rates, {family}: {'; '.join(spans)}.")
    nested = frame[frame["family"] == "nested"]
    largest = nested[nested["nodes"] == nested["nodes"].max()]
    slow = largest[largest["cycle"] == "V(2,0)"]["rate"].max()
    fast = largest[largest["cycle"] == "W(2,0)"]["rate"].max()
    sentences.append(f"On the finest nested grid ({largest['nodes'].iloc[0]} nodes) the slower V-cycle has rate "
                     f"{slow:.2f}, the slower W-cycle {fast:.2f}: every level narrows the corrections, since its gap "
                     "and slip are the smallest over their fine nodes, and a W-cycle visits it twice. Contact nodes "
                     "come first in the numbering, so that backward sweeps end on them.")
    return " ".join(sentences)
