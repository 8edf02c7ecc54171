"""A family bisected at contact alone, compared with meshes that follow the error. Part of ``estimator_effectivity.py``.

:meth:`adaptmg.Hierarchy.bisected` refines the elements that touch contact, and no others: after two or three levels the
error of the elements that stay is all that is left.
"""

from __future__ import annotations

import json
import warnings
from typing import Any

import common
import numpy as np
import pandas as pd

import adaptmg as am
from adaptmg.mesh import graded

#: of the coarsest mesh, m; away from contact over at contact
SIZE, RATIO = 2.8e-3, 2.0
LEVELS, QUICK_LEVELS = 10, 4


def family(way: str, levels: int, most: int) -> dict[str, Any]:
    """Largest relative error of the displacement at A-E on each mesh: JSON, a list of one mapping a mesh."""
    problem = am.cases.greco_bar()
    start = graded(problem.domain, SIZE, ("bottom",), RATIO)
    rows = []
    if way == "adapted":
        for step in am.adapt(problem, start, engine=am.Bisect(), max_nodes=most):
            rows.append(shown(step.hierarchy, step.result, ""))
        return {"meshes": json.dumps(rows)}
    for level in range(1, levels + 1):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            grids = am.Hierarchy.bisected(problem, start, level)
        if level == 1:
            rows.append(shown(grids.truncated(finest=0), am.solve(grids.truncated(finest=0), am.ActiveSet()), ""))
        said = [str(one.message) for one in caught if "further ones" in str(one.message) or
                "more levels hardly help" in str(one.message)]
        rows.append(shown(grids, am.solve(grids, am.FullMultigrid(rtol=1e-6)), said[0] if said else ""))
    return {"meshes": json.dumps(rows)}


def shown(grids: am.Hierarchy, result: am.Result, warned: str) -> dict[str, Any]:
    """One mesh: its sizes, and the error at A-E."""
    reference = am.cases.greco_bar().reference
    exact = np.array(list(reference["values"]["converged"].values()))
    found = result.probe(list(reference["points"].values()))[:, 0]
    mesh = grids.finest.mesh
    touching = np.isin(mesh.elements, mesh.boundary_nodes("bottom")).any(axis=1)
    return {"nodes": mesh.n_nodes, "contact_nodes": len(result.contact),
            "at_contact": mesh.element_sizes[touching].max(),
            "largest": mesh.element_sizes.max(), "error": float(np.abs(found / exact - 1).max()),
            "energy": am.Recovery().indicate(grids, result).relative, "warned": warned}


def bisected_table(context: common.Context) -> common.Table:
    """Both families, mesh by mesh."""
    levels = QUICK_LEVELS if context.quick else LEVELS
    runs = context.study(family, {"way": ["bisected at contact", "adapted"]}, levels=levels,
                         most=2000 if context.quick else 20_000)
    rows = [{"family": row["way"], **mesh} for _, row in runs.iterrows() for mesh in json.loads(row["meshes"])]
    frame = pd.DataFrame(rows)
    line = frame[frame["family"] == "bisected at contact"]
    rest = frame[frame["family"] == "adapted"]
    warned = line[line["warned"] != ""]
    first, last, best = line.iloc[0], line.iloc[-1], rest.iloc[-1]
    note = (f"GRECO bar. From {first['nodes']} to {last['nodes']} nodes the family that refines only the elements at "
            f"contact goes from an error of {first['error']:.3%} to {last['error']:.3%} at A-E (the largest of five "
            f"displacements), and its energy error, estimated by recovery, from {first['energy']:.2%} to "
            f"{last['energy']:.2%}; meshes that follow the error have {best['error']:.3%} and {best['energy']:.2%} "
            f"with {best['nodes']} nodes. "
            + (f"Hierarchy.bisected warns from {warned['nodes'].iloc[0]} nodes on." if len(warned) else
               "Hierarchy.bisected does not warn yet."))
    table = pd.DataFrame({"family": frame["family"], "nodes": frame["nodes"], "contact nodes": frame["contact_nodes"],
                          "size at contact": 1e3 * frame["at_contact"], "largest size": 1e3 * frame["largest"],
                          "error A-E": 100 * frame["error"], "energy, ZZ": 100 * frame["energy"],
                          "warns": frame["warned"] != ""})
    return common.Table("bisected_family", table, "Bisected at contact alone: the error stays", note,
                        {"size at contact": "mm", "largest size": "mm", "error A-E": "%", "energy, ZZ": "%"},
                        {"size at contact": ".4f", "largest size": ".2f", "error A-E": ".4f", "energy, ZZ": ".3f"})
