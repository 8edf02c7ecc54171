"""Contact with closed forms: Hertz (cylinders, ball) and Cattaneo, on meshes refined near contact.

    python studies/hertz.py [--quick | --full] [--out DIR]

Half-width, peak and distribution of the pressure against the closed form, with edges at contact from a/5 to a/80;
refinement near contact against uniform meshes; and what multigrid costs with two bodies against one.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import common
import numpy as np
import pandas as pd
from common import Context, Figure, Section, Table, main
from matplotlib import pyplot as plt
from paper_runs import span

import adaptmg as am
from adaptmg.cases.hertz import SLAVE_REACH, quarter_cylinder
from adaptmg.mesh import MeshArrays, graded
from adaptmg.plot.style import CYCLE, INK, styled

RTOL = 1e-8
CASES: Mapping[str, Callable[..., am.ContactProblem]] = {
    "cylinder on block": am.cases.hertz_cylinder,
    "two cylinders": lambda: am.cases.hertz_cylinder(lower_radius=50e-3),
    "ball on block": am.cases.hertz_sphere,
    "Cattaneo": am.cases.cattaneo,
}
#: a wider contact, a = R/20, that uniform meshes can resolve too
WIDE_LOAD = 1.135e7
#: edge lengths at contact, a over these
FINENESS, QUICK_FINENESS, FULL_FINENESS = (5, 10, 20, 40), (5, 10), (5, 10, 20, 40, 80)
UNIFORM, QUICK_UNIFORM, FULL_UNIFORM = (2.5, 5), (1.25, 2.5), (2.5, 5, 10)
#: growth of the edge length per distance is this over the fineness
GROWTH = 2.4
COARSEST = 2.5


@lru_cache(maxsize=8)
def family(case: str, finest: int) -> tuple[am.ContactProblem, list[MeshArrays]]:
    """A case and its meshes, with edges of a/2.5, a/5, ... a/finest at contact; all sizes are halved everywhere."""
    problem = CASES[case]()
    levels = round(np.log2(finest / COARSEST)) + 1
    return problem, am.cases.line_contact_meshes(problem, finest=1 / finest, levels=levels, grading=GROWTH / finest)


@lru_cache(maxsize=4)
def wide(refinement: str, finest: float) -> tuple[am.ContactProblem, list[MeshArrays]]:
    """The wide cylinder on a block, on uniform or refined meshes."""
    problem = am.cases.hertz_cylinder(load=WIDE_LOAD)
    levels = round(np.log2(finest / 1.25)) + 1
    if refinement == "near contact":
        return problem, am.cases.line_contact_meshes(problem, finest=1 / finest, levels=levels - 1,
                                                     grading=GROWTH / finest)
    a = problem.reference["half_width"]
    return problem, [graded(problem.domain, a / finest * 2**k) for k in reversed(range(levels))]


def profile(problem: am.ContactProblem, result: am.Result) -> dict[str, np.ndarray]:
    """Distance from the middle over a, weights, pressure and its closed form over p0, by distance."""
    form = problem.reference["closed_form"]
    order = np.argsort(result.contact.x[:, 0])
    contact = {"x": result.contact.x[:, 0], "weight": result.contact.weights, "p": result.contact.pressure / form.peak,
               "sticks": (result.contact.state == am.STICK).astype(float)}
    found = {name: values[order] for name, values in contact.items()}
    x = found["x"]
    found |= {"x": x / form.half_width, "exact p": form.pressure(x) / form.peak}
    if "partial_slip" in problem.reference:
        slip = problem.reference["partial_slip"]
        bound = slip.friction * form.peak
        found |= {"t": -result.contact.traction[order, 0] / bound, "exact t": slip.traction(x) / bound}
    return found


def mean_square(found: Mapping[str, np.ndarray], name: str) -> float:
    """L2 norm of the error over that of the constant p0 (or mu p0) on the contact, |x| <= a."""
    inside = np.abs(found["x"]) <= 1
    error = found["weight"] @ (found[name] - found["exact " + name])**2
    return float(np.sqrt(error / found["weight"][inside].sum()))


def stick_ends(found: Mapping[str, np.ndarray]) -> np.ndarray:
    """Where sticking ends on both sides, over a: halfway between the last node that sticks and the next."""
    x, sticks = found["x"], np.flatnonzero(found["sticks"])
    return np.array([0.5 * (x[sticks[0]] + x[sticks[0] - 1]), 0.5 * (x[sticks[-1]] + x[sticks[-1] + 1])])


def measured(problem: am.ContactProblem, meshes: list[MeshArrays], rtol: float) -> dict[str, Any]:
    """Solve by multigrid; errors of the contact, and the cost."""
    grids = am.Hierarchy.from_meshes(problem, meshes)
    solver = am.FullMultigrid(rtol=rtol) if len(meshes) > 1 else am.ActiveSet()
    result = am.solve(grids, solver, throw=False)
    form, found = problem.reference["closed_form"], profile(problem, result)
    try:
        a, peak = am.cases.pressure_fit(found["x"], found["p"], 1.0)
    except ValueError:  # too few nodes touch
        a = peak = float("nan")
    row = {"nodes": grids.finest.n_nodes, "contact_nodes": len(result.contact), "a_error": a - 1,
           "peak_error": peak - 1, "l2": mean_square(found, "p"), "cycles": result.cycles,
           "work_units": result.work_units, "rate": result.rate, "levels": len(grids), "residual": result.residual,
           "outcome": result.status.name}
    if "t" in found:
        ends, c = stick_ends(found), problem.reference["stick"] / form.half_width
        row |= {"stick_error": 0.5 * float(ends[1] - ends[0]) / c - 1, "shift": float(ends.mean()),
                "traction_l2": mean_square(found, "t")}
    kept = np.abs(found["x"]) < 1.3
    return row | {"profile": json.dumps({k: np.round(v[kept], 6).tolist() for k, v in found.items()})}


def converging(case: str, fineness: int, finest: int, rtol: float) -> dict[str, Any]:
    """A case with edges of a / fineness at contact, on the meshes of a family that goes on to a / finest."""
    problem, meshes = family(case, finest)
    return measured(problem, meshes[:round(np.log2(fineness / COARSEST)) + 1], rtol)


def refined(refinement: str, fineness: float, finest: float, rtol: float) -> dict[str, Any]:
    """The wide contact."""
    problem, meshes = wide(refinement, finest)
    first = 1.25 if refinement == "uniform" else COARSEST
    return measured(problem, meshes[:round(np.log2(fineness / first)) + 1], rtol)


def on_a_plane(problem: am.ContactProblem) -> am.ContactProblem:
    """The upper body alone on a rigid plane; twice the load makes the contact as wide."""
    form, radius = problem.reference["closed_form"], float(problem.domain.parts["upper"].upper[0])
    return am.ContactProblem(
        name="cylinder on a plane", material=problem.material,
        domain=quarter_cylinder(radius, SLAVE_REACH * form.half_width, above=True),
        contact=am.Contact("contact", am.Plane(point=(0.0, 0.0), normal=(0.0, 1.0))), law=problem.law,
        loads=(am.Pressure("top", form.load / radius),), supports=(am.Support("symmetry", x=0.0),))


def upper_alone(mesh: MeshArrays) -> MeshArrays:
    """The upper body of a mesh of two."""
    mine = mesh.element_body == mesh.bodies.index("upper")
    nodes = np.unique(mesh.elements[mine])
    number = np.full(mesh.n_nodes, -1)
    number[nodes] = np.arange(len(nodes))
    of_facets = np.isin(mesh.facets, nodes).all(axis=1)
    names = [name.split(".")[1] for name in mesh.boundaries if name.startswith("upper.")]
    old = [mesh.boundaries.index(f"upper.{name}") for name in names]
    labels = np.searchsorted(old, mesh.facet_labels[of_facets])
    return MeshArrays(mesh.points[nodes], number[mesh.elements[mine]], number[mesh.facets[of_facets]], labels,
                      tuple(names))


def bodies(solver: str, count: int, fineness: int, finest: int, rtol: float) -> dict[str, Any]:
    """Multigrid on cylinder and block, or on the cylinder's meshes alone."""
    problem, meshes = family("cylinder on block", finest)
    meshes = meshes[:round(np.log2(fineness / COARSEST)) + 1]
    if count == 1:
        problem, meshes = on_a_plane(problem), [upper_alone(mesh) for mesh in meshes]
    method = {"full": am.FullMultigrid, "zero": am.Multigrid}[solver]
    result = am.solve(am.Hierarchy.from_meshes(problem, meshes), method(rtol=rtol), throw=False)
    return {"nodes": meshes[-1].n_nodes, "contact_nodes": len(result.contact), "cycles": result.cycles,
            "work_units": result.work_units, "rate": result.rate, "residual": result.residual,
            "outcome": result.status.name, "fallback": result.fallback}


def run(context: Context) -> Section:
    """Tables and figures; see the module."""
    fineness = QUICK_FINENESS if context.quick else FULL_FINENESS if context.full else FINENESS
    rows = context.study(converging, {"case": tuple(CASES), "fineness": fineness}, finest=fineness[-1], rtol=RTOL)
    counts = context.study(bodies, {"solver": ("full", "zero"), "count": (1, 2), "fineness": fineness[1:]},
                           finest=fineness[-1], rtol=RTOL)
    near = fineness if context.quick else fineness[:-1]
    even = QUICK_UNIFORM if context.quick else FULL_UNIFORM if context.full else UNIFORM
    both = pd.concat([
        context.study(refined, {"refinement": ("uniform",), "fineness": even}, finest=even[-1], rtol=RTOL),
        context.study(refined, {"refinement": ("near contact",), "fineness": near}, finest=near[-1], rtol=RTOL)],
        ignore_index=True)
    items = [convergence_table(rows), *rate_table(rows), stick_table(rows), uniform_table(both), bodies_table(counts),
             pressure_figure(rows), error_figure(rows), uniform_figure(both)]
    text = ("Half-width a and peak p0 come from a least-squares line through p^2 against x^2 at the nodes within .8 a. "
            "All sizes are halved everywhere from mesh to mesh; the meshes are independent, and those before serve "
            "multigrid as coarse levels.")
    return Section("Contact with closed forms", text, items, summary=summary(rows, counts))


def summary(rows: pd.DataFrame, counts: pd.DataFrame) -> str:
    """What was asked and what came out."""
    last = rows[rows["fineness"] == rows["fineness"].max()]
    cattaneo = last[last["case"] == "Cattaneo"].iloc[0]
    work = counts.pivot(index=["solver", "fineness"], columns="count", values="work_units")
    return ("Does the pressure come out right where it is known? With edges of "
            f"a/{last['fineness'].iloc[0]} at contact half-width and peak (Hertz: cylinders, ball; Cattaneo) are "
            f"within {100 * last['a_error'].abs().max():.2g} % and {100 * last['peak_error'].abs().max():.2g} % of "
            f"the closed forms, Cattaneo's traction within {100 * cattaneo['traction_l2']:.2g} % of mu p0 (L2). "
            f"Multigrid takes {span(rows['cycles'], 'd')} cycles to 1e-8 on all meshes; two bodies take "
            f"{span(work[2] / work[1], '.2f')} times the work units of one.")


def convergence_table(rows: pd.DataFrame) -> Table:
    """Errors and cost, mesh by mesh."""
    frame = pd.DataFrame({
        "case": rows["case"], "h": [f"a/{n}" for n in rows["fineness"]], "nodes": rows["nodes"],
        "contact nodes": rows["contact_nodes"], "a error": 100 * rows["a_error"], "p0 error": 100 * rows["peak_error"],
        "L2 error": 100 * rows["l2"], "levels": rows["levels"], "cycles": rows["cycles"], "work": rows["work_units"],
        "rate": rows["rate"], "natural residual": rows["residual"], "status": rows["outcome"]})
    note = ("h: edges at contact. a and p0: of the fit against the closed form. L2 error: of the nodal pressures, over "
            f"p0 on the contact. The closed forms hold for half-spaces; terms of the order of (a/R)^2 = {bodies_end()} "
            "remain. Nested start.")
    return Table("hertz_convergence", frame, f"Hertz and Cattaneo: errors of the pressure, full multigrid to {RTOL:g}",
                 note, {"a error": "%", "p0 error": "%", "L2 error": "%", "work": "WU"},
                 {"a error": ".3f", "p0 error": ".3f", "L2 error": ".3f", "work": ".1f", "rate": ".2f",
                  "natural residual": ".1e"})


def over_size(problem: am.ContactProblem) -> float:
    """a/R, R the extent of the smallest body from the middle of the contact."""
    return problem.reference["half_width"] / min(float(part.upper[0]) for part in problem.domain.parts.values())


def bodies_end() -> str:
    """(a/R)^2 of the cases."""
    squares = {case: over_size(make())**2 for case, make in CASES.items()}
    cattaneo = squares.pop("Cattaneo")
    return f"{span(squares.values(), '.0e')} (Cattaneo {cattaneo:.0e})"


def rate_table(rows: pd.DataFrame) -> list[Table]:
    """Fitted exponents of the errors over h, where there are three meshes or more."""
    if rows["fineness"].nunique() < 3:
        return []
    found = []
    for case, part in rows.groupby("case", sort=False):
        h = 1 / part["fineness"]
        found.append({"case": case, "meshes": len(part), "L2 of pressure": common.slope(h, part["l2"]),
                      "L2 of traction": common.slope(h, part["traction_l2"]) if case == "Cattaneo" else np.nan})
    note = ("Exponent e of error ~ h^e, fitted to all meshes. The pressure ends like the root of the distance to the "
            "edge of contact, which lies anywhere between two nodes: the error of these is of the order of h^(1/2), "
            "its L2 norm of that of h, up and down with the place of the edge.")
    return [Table("hertz_rates", pd.DataFrame(found), "Orders of convergence of the errors above", note, {},
                  {"L2 of pressure": ".2f", "L2 of traction": ".2f"})]


def stick_table(rows: pd.DataFrame) -> Table:
    """Stick zone and traction of Cattaneo's problem."""
    part, problem = rows[rows["case"] == "Cattaneo"], CASES["Cattaneo"]()
    stays = over_size(problem) / problem.reference["partial_slip"].friction
    frame = pd.DataFrame({"h": [f"a/{n}" for n in part["fineness"]], "nodes": part["nodes"],
                          "c error": 100 * part["stick_error"], "shift": 100 * part["shift"],
                          "traction L2 error": 100 * part["traction_l2"], "cycles": part["cycles"],
                          "work": part["work_units"], "natural residual": part["residual"], "status": part["outcome"]})
    note = ("c: half the width that sticks, against the closed form, each end taken halfway between the last node that "
            "sticks and the next, so that its error jumps by h/2; shift: of its middle. Traction: over mu p0. Both "
            "loads in one step; bodies of one material do not couple pressure and slip, so that this is the state "
            f"after first P, then Q. What stays under refinement is of the order of a / (mu R) = {100 * stays:.1f} %, "
            "as the bodies are finite.")
    return Table("hertz_cattaneo", frame, f"Cattaneo: the strip that sticks, and the traction (to {RTOL:g})", note,
                 {"c error": "%", "shift": "% of a", "traction L2 error": "% of mu p0", "work": "WU"},
                 {"c error": ".2f", "shift": ".2f", "traction L2 error": ".2f", "work": ".1f",
                  "natural residual": ".1e"})


def uniform_table(rows: pd.DataFrame) -> Table:
    """Uniform against refined meshes."""
    frame = pd.DataFrame({"mesh": rows["refinement"], "h": [f"a/{n:g}" for n in rows["fineness"]],
                          "nodes": rows["nodes"], "p0 error": 100 * rows["peak_error"], "L2 error": 100 * rows["l2"],
                          "cycles": rows["cycles"], "work": rows["work_units"], "natural residual": rows["residual"],
                          "status": rows["outcome"]})
    return Table("hertz_uniform", frame, "Cylinder on block, a = R/20: uniform meshes against refinement near contact "
                 f"(full multigrid to {RTOL:g}; one mesh alone: active set)", equal_sizes(rows),
                 {"p0 error": "%", "L2 error": "%", "work": "WU"},
                 {"p0 error": ".3f", "L2 error": ".3f", "work": ".1f", "natural residual": ".1e"})


def order(h: pd.Series, error: pd.Series) -> str:
    """For a legend: ': h^.9', fitted to three points or more; else nothing."""
    exponent = common.slope(h, error)
    return f": $h^{{{exponent:.2f}}}$" if np.isfinite(exponent) else ""


def equal_sizes(rows: pd.DataFrame) -> str:
    """Errors and nodes where both meshes have the same size at contact."""
    even, near = (rows[rows["refinement"] == name].set_index("fineness") for name in ("uniform", "near contact"))
    both = even.index.intersection(near.index)
    said = ["h: edges at contact. Meshes are independent, and the L2 error goes up and down with the place of the edge "
            "of contact between two nodes."]
    if rows["peak_error"].isna().any():
        said.append("'-': too few nodes touch for a fit.")
    if len(both):
        nodes, errors = even["nodes"] / near["nodes"], even["l2"] / near["l2"]
        told = "; ".join(f"h = a/{n:g}: {nodes[n]:.0f} times the nodes, {errors[n]:.1f} times the L2 error"
                         for n in both)
        said.append(f"Uniform over refined at equal edges at contact: {told}.")
    return " ".join(said)


def bodies_table(rows: pd.DataFrame) -> Table:
    """Work with one body and with two."""
    keys = ["solver", "fineness"]
    one, two = (rows[rows["count"] == n].set_index(keys) for n in (1, 2))
    frame = pd.DataFrame({
        "start": [{"full": "nested", "zero": "zero"}[s] for s, _ in two.index],
        "h": [f"a/{n}" for _, n in two.index], "nodes, one": one["nodes"].loc[two.index].to_numpy(),
        "nodes, two": two["nodes"].to_numpy(), "cycles, one": one["cycles"].loc[two.index].to_numpy(),
        "cycles, two": two["cycles"].to_numpy(), "rate, two": two["rate"].to_numpy(),
        "work, one": one["work_units"].loc[two.index].to_numpy(), "work, two": two["work_units"].to_numpy()})
    # the direct solves of a method that takes over are no work
    taken = two["fallback"].to_numpy() != ""
    whole = ~taken & (one["fallback"].loc[two.index].to_numpy() == "")
    frame["two over one"] = (frame["work, two"] / frame["work, one"]).where(whole)
    if taken.any():
        frame["taken over by, two"] = [name or "-" for name in two["fallback"]]
    ends = [f"{s} {span(part['two over one'], '.2f')}" for s, part in frame[whole].groupby("start", sort=False)]
    return Table("hertz_bodies", frame, f"Multigrid on two bodies (cylinder on block) against one, to {RTOL:g}",
                 "One: the cylinder's meshes alone on a rigid plane, under the load that makes the contact as wide. A "
                 "work unit is a pass over the finest matrix of the problem at hand. Two over one, in work, by start: "
                 f"{'; '.join(ends)}." + " Taken over: cycles were too slow for what was left to do; the direct solves "
                 "after them are not in the work." * bool(taken.any()),
                 {"work, one": "WU", "work, two": "WU"},
                 {"rate, two": ".2f", "work, one": ".1f", "work, two": ".1f", "two over one": ".2f"})


@styled
def pressure_figure(rows: pd.DataFrame) -> Figure:
    """Pressure and traction over x/a on one mesh of each case."""
    fineness = min(20, rows["fineness"].max())
    figure, axes = plt.subplots(1, 4, figsize=(13.0, 3.4), sharey=True)
    for ax, (case, part) in zip(axes, rows[rows["fineness"] == fineness].groupby("case", sort=False), strict=True):
        found = {name: np.array(values) for name, values in json.loads(part["profile"].iloc[0]).items()}
        ax.plot(found["x"], found["p"], "o", color=CYCLE[0], markersize=3, label="pressure / p0")
        x = np.linspace(max(found["x"].min(), -1.3), 1.3, 1201)
        ax.plot(x, np.sqrt(np.maximum(0, 1 - x**2)), color=INK, linewidth=0.9, label="closed form")
        if "t" in found:
            ax.plot(found["x"], found["t"], "s", color=CYCLE[1], markersize=3, label="traction / (mu p0)")
            c = CASES[case]().reference["stick"] / CASES[case]().reference["half_width"]
            ax.plot(x, np.sqrt(np.maximum(0, 1 - x**2)) - c * np.sqrt(np.maximum(0, 1 - (x / c)**2)), color=INK,
                    linewidth=0.9)
        ax.set(title=case, xlabel="r / a" if case.startswith("ball") else "x / a")
        ax.grid(True)
    axes[0].legend(loc="lower left", fontsize=8)
    axes[-1].legend(*(part[-1:] for part in axes[-1].get_legend_handles_labels()), loc="center", fontsize=8,
                    handletextpad=0.2)
    axes[0].set_ylabel("over p0")
    return Figure("hertz_pressure", figure, f"Nodal pressures with edges of a/{fineness} at contact, and the closed "
                  "forms; of Cattaneo's problem the tangential traction too.")


@styled
def error_figure(rows: pd.DataFrame) -> Figure:
    """L2 errors over h/a."""
    figure, axes = plt.subplots(1, 2, figsize=(9.6, 4.0))
    for k, (case, part) in enumerate(rows.groupby("case", sort=False)):
        h = 1 / part["fineness"]
        axes[0].loglog(h, 100 * part["l2"], marker="osv^"[k], color=CYCLE[k], label=f"{case}{order(h, part['l2'])}")
        axes[1].loglog(h, 100 * part["peak_error"].abs(), marker="osv^"[k], color=CYCLE[k], label=case)
        if case == "Cattaneo":
            axes[0].loglog(h, 100 * part["traction_l2"], marker="D", linestyle="--", color=CYCLE[k],
                           label=f"its traction{order(h, part['traction_l2'])}")
    axes[0].set_ylabel("L2 error of the pressure [% of p0]")
    axes[1].set_ylabel("error of the fitted peak [%]")
    for ax in axes:
        ax.set_xlabel("h / a")
        ax.grid(True)
        common.plain_ticks(ax.xaxis, ax.yaxis)
    axes[0].legend(fontsize=8.5)
    return Figure("hertz_errors", figure, "Errors against the edge length at contact. The fitted peak is limited by "
                  "the bodies' finite size, of the order of (a/R)^2.")


@styled
def uniform_figure(rows: pd.DataFrame) -> Figure:
    """L2 error over nodes."""
    figure, ax = plt.subplots(figsize=(5.6, 4.0))
    for k, (name, part) in enumerate(rows.groupby("refinement", sort=False)):
        ax.loglog(part["nodes"], 100 * part["l2"], marker="os"[k], color=CYCLE[k], label=name)
    ax.set(xlabel="nodes", ylabel="L2 error of the pressure [% of p0]")
    ax.grid(True)
    common.plain_ticks(ax.xaxis, ax.yaxis)
    ax.legend()
    return Figure("hertz_uniform_nodes", figure, "Cylinder on block, a = R/20: error of the pressure against nodes, "
                  "on uniform meshes and on meshes refined near contact.")


if __name__ == "__main__":
    main(run, "Contact with closed forms (Hertz, Cattaneo): errors, meshes, two bodies against one. "
              "Example: python studies/hertz.py --quick --out /tmp/hertz")
