"""How sharp are the error estimates, and how many cycles does each adaptive mesh need?

    python studies/estimators.py [--quick | --full] [--out DIR]

Adaptive loops (residual indicator, default marks) on problems whose energy error is known: two
Coulomb transitions with closed forms, others against a bisected mesh with several times the nodes.
Effectivity: estimate over true error, of the residual estimate, which drives the loop, and of the
recovered one (Zienkiewicz and Zhu) on the same meshes. Signed estimates of goals are compared with
the corrected value on a finer mesh."""

import json
from typing import Literal

import pandas as pd
from adaptive_vs_uniform import CASES, ENGINES, reference
from common import Output, drawing, main, slope

import adaptmg as am
from adaptmg.estimate import energy_error

EXACT: dict[str, Literal["open", "stick"]] = {"slip and open": "open", "slip and stick": "stick"}
GOALS = {
    "GRECO bar": am.Displacement(am.cases.greco_bar().reference["points"]["C"], "x"),
    "upset block": am.ContactForce("contact", "x"),
    "dovetail": am.ContactForce("tongue.flank", "normal"),
}


def run(case: str, engine: str, most: int) -> dict:
    """Estimates over true errors of each step of a loop, as JSON."""
    if case in EXACT:
        problem, size = am.cases.coulomb_transition(kind=EXACT[case]), 0.5
        measure = problem.reference["field"].energy_error
    else:
        problem, size, against = CASES[case][0](), None, reference(case, 6 * most)
        measure = lambda result: energy_error(against, result)  # noqa: E731
    rows = []
    for step in am.adapt(problem, size, engine=ENGINES[engine], max_nodes=most):
        error = measure(step.result)
        rows.append(
            {
                "nodes": step.nodes,
                "error": error.relative,
                "residual": step.estimate.total / error.absolute,
                "recovery": am.Recovery().indicate(step.hierarchy, step.result).total
                / error.absolute,
                "cycles": step.result.cycles,
                "work": step.work_units,
            }
        )
    return {"steps": json.dumps(rows)}


def goal(case: str, most: int) -> dict:
    """Signed estimates of a goal on bisected meshes against the corrected value on the last one, as
    JSON."""
    steps = list(
        am.adapt(
            CASES[case][0](), None, am.Goal(GOALS[case]), engine=am.Bisect(), max_nodes=8 * most
        )
    )
    exact = float(steps[-1].estimate.corrected[0])
    rows = [
        {
            "nodes": step.nodes,
            "error": exact - float(step.estimate.value),
            "signed": float(step.estimate.signed),
            "relative": 1 - float(step.estimate.value) / exact,
        }
        for step in steps
        if step.nodes <= most
    ]
    return {"steps": json.dumps(rows)}


def unfolded(table: pd.DataFrame, keys: list[str]) -> pd.DataFrame:
    """One row for each step of stored loops."""
    return pd.concat(
        [
            pd.DataFrame(json.loads(row["steps"])).assign(**{key: row[key] for key in keys})
            for row in table.to_dict("records")
        ],
        ignore_index=True,
    )


def study(out: Output) -> None:
    """Compute loops and goals; effectivities, rates and cycles."""
    names = [*EXACT, "upset block", "dovetail"] if out.quick else [*EXACT, *CASES]
    plane = [name for name in names if "3D" not in name]
    found = [
        am.Study(
            run,
            {"case": plane, "engine": list(ENGINES)},
            out.store,
            name="loops",
            fixed={"most": 1200 if out.quick else 8000},
        ).run(throw=True)
    ]
    if not out.quick:
        found.append(
            am.Study(
                run,
                {"case": ["GRECO block 3D"], "engine": list(ENGINES)},
                out.store,
                name="loops 3D",
                fixed={"most": 4000},
            ).run(throw=True)
        )
    steps = unfolded(pd.concat(found, ignore_index=True), ["case", "engine"])
    lines = []
    for (case, engine), rows in steps.groupby(["case", "engine"], sort=False):
        rows = rows.iloc[1:]
        lines.append(
            {
                "problem": case,
                "engine": engine,
                "nodes": rows["nodes"].iloc[-1],
                "energy error": 100 * rows["error"].iloc[-1],
                "residual, least": rows["residual"].min(),
                "residual, largest": rows["residual"].max(),
                "recovery, least": rows["recovery"].min(),
                "recovery, largest": rows["recovery"].max(),
                "rate": -slope(rows["nodes"], rows["error"]) if len(rows) > 2 else float("nan"),
                "most cycles": rows["cycles"].max(),
            }
        )
    table = pd.DataFrame(lines)
    out.table(
        "effectivity",
        table,
        "Estimate over true error in adaptive loops, the first mesh left out",
        "Rate: exponent s of error ~ nodes^-s; in the long run at best 1/2 in the plane, 1/3 in 3D. Cycles: of "
        "the default method on a mesh, started from the mesh before.",
        units={"energy error": "%"},
        formats={name: ".2f" for name in table.columns[3:9]},
    )
    goals = unfolded(
        am.Study(
            goal,
            {"case": ["upset block"] if out.quick else list(GOALS)},
            out.store,
            name="goals",
            fixed={"most": 600 if out.quick else 4000},
        ).run(throw=True),
        ["case"],
    )
    goals["signed over error"] = goals["signed"] / goals["error"]
    out.table(
        "goals",
        goals[["case", "nodes", "relative", "signed over error"]],
        "Signed estimates of goals",
        "Relative: of the goal's value on that mesh, against the corrected value on a mesh with eight times the "
        "nodes.",
        formats={"relative": ".1e", "signed over error": ".2f"},
    )
    figure, ax = drawing()
    for (case, engine), rows in steps.groupby(["case", "engine"], sort=False):
        if engine == "remeshed":
            (line,) = ax.semilogx(rows["nodes"], rows["residual"], "o-", markersize=3, label=case)
            ax.semilogx(rows["nodes"], rows["recovery"], ":", color=line.get_color())
    ax.axhline(1.0, color="grey")
    ax.set(xlabel="nodes", ylabel="estimate over true error", ylim=(0, None))
    figure.legend(loc="outside right upper")
    out.figure(
        "effectivity",
        figure,
        "Residual estimate (solid) and recovered one (dotted) over the true error, remeshed loops",
    )
    out.number(
        f"Energy estimate by residual; by recovery over the true error, {len(table)} adaptive loops",
        "; ".join(
            f"{table[f'{name}, least'].min():.2f} to {table[f'{name}, largest'].max():.2f}"
            for name in ("residual", "recovery")
        ),
    )
    exact = table[table["problem"].isin(EXACT)]
    out.check(
        "largest residual estimate over the true error, closed forms",
        float(exact["residual, largest"].max()),
        high=4.5,
    )


if __name__ == "__main__":
    main(study)
