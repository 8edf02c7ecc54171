"""Transfers between meshes that are not nested: what they cost, what they keep, how the cycles converge with them.

1. Each transfer on independent Netgen meshes in 2D and 3D (nested uniform grids as the base line): processor time to
   build, entries, complexity of the Galerkin matrices, affine fields reproduced, whether the monotone correction is
   proven: contact rows >= 0 with sums 1. Contact rows, which interpolate along the coarse contact boundary whatever
   the transfer does elsewhere, give this to every transfer; on a straight boundary interpolation has it anyway.
2. Cycles and work units with each of them, from a zero and from a nested start: the default method, and the monotone
   one with V(2,0) and W(2,0) next to it.
3. Two grids with a growing ratio of their mesh sizes, everywhere or at contact only.
4. With --full the same on the levels that adaptive loops leave: transfers, and size ratios by leaving levels out.

    python studies/transfer_operators.py [--quick | --full] [--out DIR]
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from statistics import median
from typing import Any

import common
import numpy as np
import pandas as pd
from matplotlib import pyplot as plt
from paper_runs import listed, span
from scipy import sparse
from transfer_adaptive import adaptive_items

import adaptmg as am
from adaptmg.mesh import MeshArrays, graded, structured
from adaptmg.multigrid.corrections import contact_weights, correction_levels
from adaptmg.plot.style import CYCLE, styled
from adaptmg.smoother.system import local_system
from adaptmg.transfer import mesh_ratio

RTOL = 1e-8
MAX_CYCLES = 300
REPETITIONS = 5

TRANSFERS: Mapping[str, Any] = {
    "Interpolation": am.Interpolation(), "PseudoL2": am.PseudoL2(), "L2": am.L2(),
    "QuasiInterpolation": am.QuasiInterpolation(), "LumpedL2": am.LumpedL2()}
#: (transfer, contact rows interpolated along the contact boundary)
CHOICES = (*((name, True) for name in TRANSFERS), ("Interpolation", False), ("PseudoL2", False),
           ("LumpedL2", False))


@dataclass(frozen=True)
class Case:
    """Meshes, coarse to fine, and what is tried on them.

    Parameters
    ----------
    sizes : tuple
        Divisions of structured meshes, or sizes away from contact of graded ones, m.
    contact_ratio : float
        Of graded meshes: size away from contact over size at contact; 0 means structured.
    choices : tuple of (transfer, contact rows)
    dim : int
    """

    sizes: tuple[float, ...]
    contact_ratio: float
    choices: tuple[tuple[str, bool], ...] = CHOICES
    dim: int = 2


NESTED = Case((4, 8, 16, 32), 0, (("Interpolation", True),))
GRADED = Case((20e-3, 10e-3, 5e-3, 2.5e-3, 1.25e-3), 4)
#: with --full alone
FINE = "2D graded, fine"
CASES: Mapping[str, Case] = {
    "2D nested": NESTED, "2D graded": GRADED, FINE: Case((*GRADED.sizes, 0.625e-3), 4, CHOICES[:5]),
    "3D graded": Case((20e-3, 10e-3, 5e-3), 2, dim=3)}
QUICK_CASES: Mapping[str, Case] = {"2D nested": NESTED, "2D graded": Case(GRADED.sizes[:-1], 4)}
#: the default method, and the monotone correction in two cycles
METHODS = {"default": "default", "V": "monotone V(2,0)", "W": "monotone W(2,0)"}
RATIOS, QUICK_RATIOS = (2, 3, 4, 6), (2, 4)


@lru_cache(maxsize=4)
def posed(dim: int, sizes: tuple[float, ...], contact_ratio: float) -> tuple[am.ContactProblem, tuple[MeshArrays, ...]]:
    """Problem and meshes of a case, coarse to fine; see :class:`Case`."""
    problem = am.cases.greco_bar(law=am.Coulomb(1.0)) if dim == 2 else am.cases.greco_block(law=am.Coulomb(0.3))
    if contact_ratio == 0:
        return problem, tuple(structured(problem.domain, n) for n in sizes)
    return problem, tuple(graded(problem.domain, size, "bottom", contact_ratio) for size in sizes)


def build_seconds(meshes: Sequence[MeshArrays], transfers: Sequence[Any]) -> list[float]:
    """Median processor time to build all prolongations with each transfer, in turns, s."""
    for transfer in transfers:
        transfer.build(*meshes[:2])
    seconds: list[list[float]] = [[] for _ in transfers]
    for _ in range(REPETITIONS):
        for k, transfer in enumerate(transfers):
            begin = time.process_time()
            for coarse, fine in pairwise(meshes):
                transfer.build(coarse, fine)
            seconds[k].append(time.process_time() - begin)
    return [median(values) for values in seconds]


def affine_error(hierarchy: am.Hierarchy) -> float:
    """Largest error of P in affine fields 0 <= x, y, z <= 1 over all levels."""
    worst = 0.0
    for coarse, fine in pairwise(hierarchy.levels):
        size = np.ptp(coarse.mesh.points, axis=0)
        error = fine.prolongation @ (coarse.mesh.points / size) - fine.mesh.points / size
        worst = max(worst, float(np.abs(error).max()))
    return worst


def properties(dim: int, sizes: tuple[float, ...], contact_ratio: float, transfer: str,
               contact_rows: bool) -> dict[str, Any]:
    """What a transfer costs and keeps."""
    problem, meshes = posed(dim, sizes, contact_ratio)
    base, own = build_seconds(meshes, (am.Interpolation(), TRANSFERS[transfer]))
    hierarchy = am.Hierarchy.from_meshes(problem, meshes, TRANSFERS[transfer], contact_rows=contact_rows)
    problems = [local_system(level.discrete) for level in hierarchy.levels]
    levels = correction_levels(hierarchy, problems, len(hierarchy) - 1)
    finest = hierarchy.finest
    return {"nodes": finest.discrete.n_nodes, "contact_nodes": len(finest.discrete.contact), "levels": len(hierarchy),
            "mesh_ratio": max(level.mesh_ratio for level in hierarchy.levels[1:]), "build_s": own,
            "build_ratio": own / base, "row_entries": finest.prolongation.nnz / finest.prolongation.shape[0],
            "complexity": sum(level.system.nonzeros for level in levels) / levels[-1].system.nonzeros,
            "discretised_complexity": hierarchy.operator_complexity,
            "min_weight": min(float(level.prolongation.data.min()) for level in hierarchy.levels[1:]),
            "affine_error": affine_error(hierarchy),
            "proven": all(proven(level.contact_prolongation) for level in levels[1:])}


def proven(weights: sparse.csr_array) -> bool:
    """Whether the monotone correction is proven for contact rows of a transfer: they are >= 0 with sums 1."""
    return bool((weights.data >= 0).all() and np.abs(weights.sum(axis=1) - 1).max(initial=0.0) < 1e-10)


def negative_contact_weights(hierarchy: am.Hierarchy) -> bool:
    """Whether a weight between contact nodes is negative: the monotone correction refuses such transfers."""
    return any(contact_weights(fine.prolongation, fine.discrete, coarse.discrete).data.min() < 0
               for coarse, fine in pairwise(hierarchy.levels))


def convergence(dim: int, sizes: tuple[float, ...], contact_ratio: float, transfer: str, contact_rows: bool, shape: str,
                rtol: float, max_cycles: int) -> dict[str, Any]:
    """Cycles and work from a zero start and from a nested one; ``shape`` "default" is the default method."""
    common.warm_up(dim)
    problem, meshes = posed(dim, sizes, contact_ratio)
    hierarchy = am.Hierarchy.from_meshes(problem, meshes, TRANSFERS[transfer], contact_rows=contact_rows)
    row: dict[str, Any] = {"nodes": hierarchy.finest.discrete.n_nodes}
    refused = shape != "default" and negative_contact_weights(hierarchy)
    parts = {} if shape == "default" else {"cycle": am.Cycle(shape=shape, pre=2, post=0), "correction": am.Monotone()}
    for start, method in (("zero", am.Multigrid), ("full", am.FullMultigrid)):
        solver = method(rtol=rtol, max_cycles=max_cycles, **parts)
        if refused:
            row |= {f"{start}_{name}": float("nan") for name in ("cycles", "rate", "work", "s", "residual")}
            row[f"{start}_outcome"] = "REFUSED"
            continue
        result = am.solve(hierarchy, solver, throw=False)
        row |= {f"{start}_cycles": result.cycles, f"{start}_rate": result.rate, f"{start}_work": result.work_units,
                f"{start}_s": result.seconds, f"{start}_residual": result.residual,
                f"{start}_outcome": result.status.name}
    return row


def two_grids(where: str, ratio: int, rtol: float, max_cycles: int) -> dict[str, Any]:
    """Two grids whose sizes differ by ``ratio`` everywhere, or by 2 in the bulk and by ``ratio`` at contact."""
    common.warm_up()
    problem = am.cases.greco_bar(law=am.Coulomb(1.0))
    fine = graded(problem.domain, 2.5e-3, "bottom", 8)
    coarse = (graded(problem.domain, 2.5e-3 * ratio, "bottom", 8) if where == "everywhere" else
              graded(problem.domain, 5e-3, "bottom", 16 / ratio))
    hierarchy = am.Hierarchy.from_meshes(problem, [coarse, fine])
    stop = {"rtol": rtol, "max_cycles": max_cycles}
    result = am.solve(hierarchy, am.Multigrid(**stop), throw=False)
    monotone = am.solve(hierarchy, am.Multigrid(correction=am.Monotone(), cycle=am.Cycle(shape="V", pre=2, post=0),
                                                **stop), throw=False)
    return {"coarse_nodes": coarse.n_nodes, "nodes": fine.n_nodes, "largest_ratio": mesh_ratio(coarse, fine),
            "median_ratio": mesh_ratio(coarse, fine, quantile=0.5), "cycles": result.cycles, "rate": result.rate,
            "work_units": result.work_units, "residual": result.residual, "outcome": result.status.name,
            "monotone_cycles": monotone.cycles, "monotone_rate": monotone.rate,
            "monotone_outcome": monotone.status.name}


def run(context: common.Context) -> common.Section:
    """All four parts."""
    kept, cycles = [], []
    stop = {"rtol": RTOL, "max_cycles": MAX_CYCLES}
    cases = QUICK_CASES if context.quick else {name: CASES[name] for name in CASES if context.full or name != FINE}
    meshes = {name: {"dim": case.dim, "sizes": case.sizes, "contact_ratio": case.contact_ratio}
              for name, case in cases.items()}
    choices = [(name, {"transfer": [transfer], "contact_rows": [rows]})
               for name, case in cases.items() for transfer, rows in case.choices]
    for name, choice in choices:
        cycles.append(context.study(convergence, choice | {"shape": list(METHODS)}, **meshes[name], **stop)
                      .assign(case=name))
    further = adaptive_items(context) if context.full else []
    for name, choice in choices:
        kept.append(context.study(properties, choice, timed=True, **meshes[name]).assign(case=name))
    ratios = context.study(two_grids, {"where": ["everywhere", "at contact"],
                                       "ratio": QUICK_RATIOS if context.quick else RATIOS}, **stop)
    kept, cycles = pd.concat(kept, ignore_index=True), pd.concat(cycles, ignore_index=True)
    solid = any(case.dim == 3 for case in cases.values())
    block, twice = (" and the block with friction .3 (3D)", " (3D: twice)") if solid else ("", "")
    text = (f"The GRECO bar with friction 1 (2D){block} on independent Netgen meshes, four times{twice} finer at "
            "contact, sizes halved from level to level. Every prolongation is tried with the default method and with "
            "the monotone correction; with contact rows, fine contact nodes interpolate along the coarse contact "
            f"boundary whatever the transfer does elsewhere. Tolerance {RTOL:g} (estimated relative energy error), at "
            f"most {MAX_CYCLES} cycles.")
    return common.Section("Transfers between non-nested meshes", text, [
        property_table(kept), cycle_table(cycles), ratio_table(ratios), work_figure(cycles), ratio_figure(ratios),
        *further], summary=summary(kept, cycles, ratios))


def summary(kept: pd.DataFrame, cycles: pd.DataFrame, ratios: pd.DataFrame) -> str:
    """What was asked and what came out."""
    kept = kept[kept["contact_rows"] & kept["case"].str.contains("graded")]
    rows = cycles[cycles["contact_rows"] & cycles["case"].str.contains("graded")]
    default, base = rows[rows["shape"] == "default"], "Interpolation"
    count = {name: group.loc[group["full_outcome"] == "CONVERGED", "full_cycles"]
             for name, group in default.groupby("transfer")}
    said = ["Which transfer between meshes that are not nested? "]
    others = [name for name in TRANSFERS if name != base and len(count.get(name, ()))]
    more = span(pd.concat([kept.loc[kept["transfer"] != base, "build_ratio"]]), ".0f")
    if len(count.get(base, ())) and others:
        said.append(f"With interpolation the default method takes {span(count[base], '.0f')} cycles from the nested "
                    f"start to {RTOL:g}, with the others {span(pd.concat([count[name] for name in others]), '.0f')}; ")
    said.append(f"they take {more} times as long to build, and make the coarse matrices denser (complexity "
                f"{span(kept.loc[kept['transfer'] != base, 'complexity'], '.1f')}, of interpolation "
                f"{span(kept.loc[kept['transfer'] == base, 'complexity'], '.1f')}), so that work grows by "
                f"a factor {span(over_interpolation(default)['ratio'], '.1f')}: interpolation is the default. ")
    alone = ratios[ratios["where"] == "everywhere"]
    first, last = alone.iloc[0], alone.iloc[-1]
    said.append("What counts is how far the sizes of neighbours lie apart: with two grids the rate of the default "
                f"method goes from {first['rate']:.2f} at a ratio of {first['ratio']} to {last['rate']:.2f} at "
                f"{last['ratio']}, of the monotone one from {first['monotone_rate']:.2f} to "
                f"{last['monotone_rate']:.2f}.")
    return "".join(said)


def over_interpolation(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of other transfers that converged, with ``ratio``: work over that of interpolation with contact rows."""
    key = ["case", "shape"]
    base = rows[(rows["transfer"] == "Interpolation") & rows["contact_rows"]
                & (rows["full_outcome"] == "CONVERGED")].set_index(key)["full_work"].rename("base")
    found = rows[(rows["full_outcome"] == "CONVERGED")
                 & ~((rows["transfer"] == "Interpolation") & rows["contact_rows"])].join(base, on=key)
    return found.assign(ratio=found["full_work"] / found["base"]).dropna(subset="ratio")


def property_table(kept: pd.DataFrame) -> common.Table:
    """Cost and properties of the prolongations."""
    frame = pd.DataFrame({
        "meshes": kept["case"], "nodes": kept["nodes"], "transfer": kept["transfer"],
        "contact rows": kept["contact_rows"], "build": 1e3 * kept["build_s"],
        "over interpolation": kept["build_ratio"], "entries a row": kept["row_entries"],
        "complexity": kept["complexity"], "least weight": kept["min_weight"], "affine error": kept["affine_error"],
        "proven": kept["proven"], "largest size ratio": kept["mesh_ratio"]})
    with_rows = kept[kept["contact_rows"] & kept["case"].str.contains("graded")]
    worst = with_rows.groupby("transfer")["affine_error"].max()
    wrong = [f"{name} to {error:.0e}" for name, error in worst.items() if error > 1e-10]
    note = (
        f"Build: processor time for all prolongations of the hierarchy, median of {REPETITIONS} in turns with "
        "interpolation. Complexity: nonzeros of the Galerkin matrices of all levels over the finest (discretised on "
        f"every level: {span(with_rows['discretised_complexity'], '.2f')}). Affine error: largest in fields from 0 to 1"
        + (f"; not to rounding: {listed(wrong)}" if wrong else "") + ". Proven: what the monotone correction needs, "
        "contact rows >= 0 with sums 1. Largest size ratio: of neighbouring levels, measured element by element.")
    return common.Table("transfer_properties", frame, "What the transfers cost and keep", note,
                        {"build": "ms", "over interpolation": "ratio", "largest size ratio": "coarse/fine"},
                        {"build": ".1f", "over interpolation": ".1f", "entries a row": ".2f", "complexity": ".2f",
                         "least weight": ".3f", "affine error": ".1e", "largest size ratio": ".2f"})


def cycle_table(cycles: pd.DataFrame) -> common.Table:
    """Cycles, rates and work."""
    frame = pd.DataFrame({
        "meshes": cycles["case"], "nodes": cycles["nodes"], "transfer": cycles["transfer"],
        "contact rows": cycles["contact_rows"], "method": cycles["shape"].map(METHODS),
        "cycles from zero": cycles["zero_cycles"], "rate": cycles["zero_rate"], "work from zero": cycles["zero_work"],
        "status": cycles["zero_outcome"], "cycles, nested start": cycles["full_cycles"],
        "rate, nested start": cycles["full_rate"], "work, nested start": cycles["full_work"],
        "natural residual": cycles["full_residual"], "status, nested start": cycles["full_outcome"]})
    block = cycles[cycles["case"].str.startswith("3D") & (cycles["shape"] != "default")
                   & (cycles["full_outcome"] == "CONVERGED")]
    limits = (f" On the block every transfer with which the monotone method converges has a rate of "
              f"{span(block['full_rate'], '.2f')}, V as W, so it is not the transfer that limits it; likely it is that "
              "in 3D a coarse node slips on only if all slips over its support are parallel."
              if block["transfer"].nunique() > 1 and set(block["shape"]) == {"V", "W"} else "")
    note = (f"The work of the nested start is included. {work_words(cycles, 'default')} "
            f"{work_words(cycles, 'monotone')}"
            + " REFUSED: a weight between contact nodes is negative, which the monotone correction does not accept."
            * bool((cycles["full_outcome"] == "REFUSED").any()) + f" Rate: geometric mean of the last cycles.{limits}")
    works = ["work from zero", "work, nested start"]
    return common.Table("transfer_cycles", frame, f"Multigrid with each transfer (rtol {RTOL:g})", note,
                        dict.fromkeys(works, "WU"),
                        {"cycles from zero": ".0f", "rate": ".2f", "cycles, nested start": ".0f",
                         "rate, nested start": ".2f", "natural residual": ".1e"} | dict.fromkeys(works, ".0f"))


def work_words(cycles: pd.DataFrame, method: str) -> str:
    """Work of the other transfers over that of interpolation, in words: of the default method or the monotone one."""
    mine = (cycles["shape"] == "default") == (method == "default")
    rows = cycles[mine & cycles["case"].str.contains("graded")]
    over = over_interpolation(rows)
    words, failed = [], []
    for (name, contact_rows), group in rows.groupby(["transfer", "contact_rows"], sort=False):
        label = name if contact_rows else f"{name} without contact rows"
        unfinished = group["full_outcome"].isin(["LIMIT", "STALLED", "DIVERGED"])
        if unfinished.any():
            share = f" in {unfinished.sum()} of {len(group)} runs" if len(group) > 1 else ""
            failed.append(f" {label} does not converge{share}.")
        ratio = over.loc[(over["transfer"] == name) & (over["contact_rows"] == contact_rows), "ratio"]
        if len(ratio):
            words.append(f"{label} {span(ratio, '.2f')}")
    if not words:
        return "".join(failed).strip()
    return (f"Work of the {method} method with the nested start over that of interpolation with contact rows, on the "
            f"graded meshes: {'; '.join(words)}.{''.join(failed)}")


def ratio_table(ratios: pd.DataFrame) -> common.Table:
    """Two grids, by the ratio of their sizes."""
    frame = ratios[["where", "ratio", "coarse_nodes", "nodes", "median_ratio", "largest_ratio", "cycles", "rate",
                    "work_units", "residual", "outcome", "monotone_cycles", "monotone_rate"]].rename(columns={
                        "where": "coarser", "ratio": "size ratio", "coarse_nodes": "coarse nodes",
                        "median_ratio": "median ratio", "largest_ratio": "largest ratio", "work_units": "work",
                        "residual": "natural residual", "outcome": "status", "monotone_cycles": "cycles, monotone",
                        "monotone_rate": "rate, monotone"})
    note = ("Two grids, interpolation with contact rows, from a zero start; the default method, and the monotone one "
            "with V(2,0). Size ratio: of the sizes asked for, everywhere, or at contact with 2 elsewhere; median and "
            "largest are measured element by element. The default method spends its first cycles on finding the "
            "contact status; its rate is that of the last ones.")
    return common.Table("transfer_mesh_ratio", frame, f"GRECO bar: ratio of mesh sizes (rtol {RTOL:g})", note,
                        {"work": "WU"} | dict.fromkeys(["size ratio", "median ratio", "largest ratio"], "coarse/fine"),
                        {"median ratio": ".2f", "largest ratio": ".2f", "rate": ".2f", "work": ".0f",
                         "natural residual": ".1e", "rate, monotone": ".2f"})


@styled
def work_figure(cycles: pd.DataFrame) -> common.Figure:
    """Work units of the default method with the nested start."""
    rows = cycles[(cycles["shape"] == "default") & cycles["contact_rows"]]
    cases = [case for case in rows["case"].unique() if "graded" in case]
    figure, ax = plt.subplots(figsize=(7.0, 3.8))
    width = 0.8 / len(TRANSFERS)
    for k, name in enumerate(TRANSFERS):
        for j, case in enumerate(cases):
            row = rows[(rows["case"] == case) & (rows["transfer"] == name)].iloc[0]
            bar = ax.bar(j + (k - 2) * width, row["full_work"], width=0.9 * width, color=CYCLE[k],
                         label=name if j == 0 else None)
            text = f"{row['full_cycles']:.0f}" if row["full_outcome"] == "CONVERGED" else "not"
            ax.bar_label(bar, [text], fontsize=8)
    nodes = rows.groupby("case")["nodes"].first()
    ax.set_xticks(range(len(cases)), [f"{case}\n{nodes[case]} nodes" for case in cases])
    ax.set_ylabel("work units")
    ax.tick_params(axis="x", length=0)
    ax.grid(True, axis="y")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return common.Figure("transfer_work", figure,
                         f"Work of the default method to {RTOL:g} with the nested start; above the bars cycles on "
                         "the finest "
                         "grid")


@styled
def ratio_figure(ratios: pd.DataFrame) -> common.Figure:
    """Rate against the ratio of sizes."""
    figure, ax = plt.subplots(figsize=(5.4, 3.8))
    for k, (where, group) in enumerate(ratios.groupby("where", sort=False)):
        ax.plot(group["ratio"], group["rate"], marker="os"[k], color=CYCLE[k], label=where)
        ax.plot(group["ratio"], group["monotone_rate"], ":", marker="os"[k], color=CYCLE[k])
    ax.set_xlabel("ratio of mesh sizes, coarse over fine")
    ax.set_ylabel("rate a cycle")
    ax.set_ylim(0.0, 1.0)
    ax.set_xticks(sorted(ratios["ratio"].unique()))
    ax.grid(True)
    ax.legend(loc="lower right")
    return common.Figure("transfer_mesh_ratio", figure,
                         "Two-grid rate against the ratio of mesh sizes; default method solid, monotone dotted")


if __name__ == "__main__":
    common.main(run, "Transfers between non-nested meshes: cost, properties, convergence.")
