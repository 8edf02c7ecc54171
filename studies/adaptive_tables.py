"""Tables of ``adaptive_vs_uniform.py``: convergence rates, cost of an accuracy, the finest meshes, the references."""

from __future__ import annotations

from collections.abc import Mapping

import common
import numpy as np
import pandas as pd
from adaptive_cases import CASES, EXPONENTS
from adaptive_pays import LAST, at_error, gains, least_common, pays_table
from adaptive_runs import DEFAULT
from paper_runs import listed, span

#: relative energy errors whose cost is asked for
WANTED: Mapping[str, float] = {"upset block": 1.2e-3, "flat punch": 2.5e-2, "dovetail": 2.5e-2}


#: of the least error measured, to which costs are continued
FURTHEST = 0.5


def tables(rows: pd.DataFrame, references: pd.DataFrame) -> list[common.Table]:
    """All of them."""
    return [pays_table(rows), rate_table(rows), cost_table(rows), finest_table(rows), gain_table(rows),
            reference_table(references, rows), mesh_table(rows)]


def theory(case: str, family: str) -> float:
    """Exponent of the energy error over nodes: of the strongest singularity (NaN: unknown), or of adapted meshes."""
    this = CASES[case]
    # what is singular along an edge of a solid converges in h as it does in the plane
    return (np.minimum(1.0, EXPONENTS[case]) if family in ("uniform", "graded by hand") else 1.0) / this.dim


def rate(group: pd.DataFrame, column: str = "energy_error") -> float:
    """Fitted exponent over the last meshes, positive where errors fall."""
    last = group.iloc[-LAST:]
    last = last[last[column] > 0]
    return -common.slope(last["nodes"], last[column]) if len(last) == LAST else float("nan")


def rate_table(rows: pd.DataFrame) -> common.Table:
    """Energy rates over the last three meshes, and theory."""
    lines = []
    for case, of_case in rows.groupby("case", sort=False):
        line = {"problem": case, "theory, uniform": theory(case, "uniform")}
        line |= {family: rate(group) for family, group in of_case.groupby("family", sort=False)}
        lines.append(line | {"theory, adapted": theory(case, "residual, bisected")})
    frame = pd.DataFrame(lines)
    # goals ask for something else than the energy
    led = frame[[name for name in frame if name.startswith(("residual", "recovery"))]]
    words = []
    for dim in (2, 3):
        found = led[[CASES[name].dim == dim for name in frame["problem"]]].to_numpy(dtype=float).ravel()
        found = found[np.isfinite(found)]
        if found.size > 1:
            words.append(f"{span(found, '.2f')} in {dim}D")
    note = (f"Exponent r of error ~ N^-r, N nodes, over the last {LAST} meshes; empty where there are fewer. Theory: "
            "u ~ r^lambda at the strongest singularity gives N^(-min(1, lambda)/d) on uniform meshes, and in the end "
            "on those graded by a fixed ratio; adapted meshes N^(-1/d). Above theory: meshes that begin to resolve "
            "their strongest singularity; below: corners that are not resolved yet."
            + f" Led by the residual or recovery: {' and '.join(words)}." * bool(words))
    return common.Table("adaptive_rates", frame, "Energy error: fitted rates and theory", note, {},
                        {name: ".2f" for name in frame if name != "problem"}, open=True)


def common_error(of_case: pd.DataFrame) -> float:
    """The error to which families of a case are compared: one wanted, where the default loop reaches it."""
    reached = of_case[of_case["family"].isin(DEFAULT)].groupby("family")["energy_error"].min().max()
    wanted = WANTED.get(of_case["case"].iloc[0], np.nan)
    return wanted if reached <= wanted else least_common(of_case)


def cost_table(rows: pd.DataFrame) -> common.Table:
    """Nodes, work and seconds to one accuracy, and the ratio of uniform meshes to each."""
    lines = []
    for case, of_case in rows.groupby("case", sort=False):
        error = common_error(of_case)
        of_case = of_case.assign(passes=of_case["work_units"] * of_case["nonzeros"] * 1e-6)
        uniform = of_case[of_case["family"] == "uniform"]
        base = {name: at_error(uniform, error, name)[0] for name in ("nodes", "passes", "cpu")}
        for family, group in of_case.groupby("family", sort=False):
            found = {name: at_error(group, error, name)[0] for name in base}
            beyond = at_error(group, error, "cpu")[1]
            near = error >= FURTHEST * group["energy_error"].min()
            found = found if near else dict.fromkeys(found, np.nan)
            lines.append({"problem": case, "energy error": 100 * error, "meshes": family, "nodes": found["nodes"],
                          "matrix entries": found["passes"], "time": found["cpu"],
                          **{f"{title}, uniform over these": base[name] / found[name] for title, name in
                             (("nodes", "nodes"), ("entries", "passes"), ("time", "cpu"))},
                          "how": ("extrapolated" if beyond else "measured") if np.isfinite(found["cpu"]) else
                          "not reached" if beyond else "first mesh is finer"})
    frame = pd.DataFrame(lines)
    over = [f"{title}, uniform over these" for title in ("nodes", "entries", "time")]
    note = ("Logarithms interpolated between meshes; 'extrapolated' along the last three where no mesh is so fine, to "
            f"{FURTHEST:g} of the least error of theirs, 'not reached' beyond. "
            "Matrix entries: passed over in all solves (work units times nonzeros). "
            + " ".join(filter(None, (losers(group, over[2]) for _, group in frame.groupby("problem", sort=False)))))
    return common.Table("adaptive_cost", frame, "Cost of one accuracy, by all families", note.strip(),
                        {"energy error": "%", "matrix entries": "million", "time": "s"} | dict.fromkeys(over, "ratio"),
                        {"energy error": ".3g", "nodes": ".0f", "matrix entries": ".1f", "time": ".3g"}
                        | dict.fromkeys(over, ".3g"))


def losers(group: pd.DataFrame, ratio: str) -> str:
    """Which meshes are slower than uniform ones on a problem, as a sentence; empty where none is."""
    slower = group.loc[(group[ratio] < 1) & (group["meshes"] != "uniform"), "meshes"]
    if slower.empty:
        return ""
    return f"{group['problem'].iloc[0]}: uniform meshes are quicker than {listed(map(repr, slower))}."


def finest_table(rows: pd.DataFrame) -> common.Table:
    """All errors on the finest mesh of each family."""
    last = rows.groupby(["case", "family"], sort=False).tail(1)
    frame = pd.DataFrame({
        "problem": last["case"], "meshes": last["family"], "nodes": last["nodes"],
        "contact nodes": last["contact_nodes"], **errors(last), "ends of zones": 1e3 * last["ends_error"],
        "levels": last["levels"], "work": last["work_units"], "time": last["cpu"]})
    forces = "; ".join(f"{name}: {CASES[name].force[0]}" for name in dict.fromkeys(rows["case"]))
    note = ("Errors are relative. Energy: in the energy norm. Pressure: L2 along contact, without 5 % (3D: 10 %) of "
            "the surface at singular edges. Points: the largest of the chosen displacements. Force: one that "
            f"equilibrium alone does not give ({forces}). Ends of zones: the largest error of a place where the "
            "contact state changes; empty in 3D, and where there are not as many as on the reference. Work: passes "
            "over the matrix of this mesh, in all solves up to it.")
    return common.Table("adaptive_finest", frame, "Errors on the finest meshes", note,
                        dict.fromkeys(ERRORS, "%") | {"ends of zones": "mm", "work": "WU", "time": "s"},
                        ERRORS | {"ends of zones": ".3f", "work": ".1f", "time": ".2f"})


#: errors in per cent, and their formats
ERRORS = {"energy": ".3f", "pressure": ".3f", "points": ".4f", "force": ".4f"}


def errors(rows: pd.DataFrame) -> dict[str, pd.Series]:
    """Columns of relative errors, per cent."""
    return {name: 100 * rows[f"{name}_error"] for name in ERRORS}


def gain_table(rows: pd.DataFrame) -> common.Table:
    """Gains in all errors at equal nodes, against uniform meshes."""
    lines = []
    for case, of_case in rows.groupby("case", sort=False):
        uniform = of_case[of_case["family"] == "uniform"]
        lines += [{"problem": case, "meshes": family} | {name: gain(group, uniform, f"{name}_error") for name in ERRORS}
                  for family, group in of_case.groupby("family", sort=False) if family != "uniform"]
    note = ("Error of uniform meshes (logarithms interpolated) over that of each mesh, at the same number of nodes: "
            f"geometric mean over the last {LAST} meshes that have uniform ones on both sides; empty where none has. "
            "Single points and forces pass through zero, so that these gains scatter.")
    return common.Table("adaptive_gains", pd.DataFrame(lines), "Gain in accuracy at equal nodes", note,
                        dict.fromkeys(ERRORS, "ratio"), dict.fromkeys(ERRORS, ".1f"))


def gain(group: pd.DataFrame, uniform: pd.DataFrame, column: str) -> float:
    """Error of the uniform meshes at the same number of nodes over each error; geometric mean of the last three."""
    there = np.interp(np.log(group["nodes"]), np.log(uniform["nodes"]), np.log(uniform[column]), np.nan, np.nan)
    gained = there - np.log(group[column].to_numpy())
    gained = gained[np.isfinite(gained)][-LAST:]
    return float(np.exp(gained.mean())) if gained.size else float("nan")


def reference_table(references: pd.DataFrame, rows: pd.DataFrame) -> common.Table:
    """What the errors are measured against."""
    least = references["case"].map(rows.groupby("case")["energy_error"].min())
    own = references["own_error"] / np.sqrt(references["energy"])
    frame = pd.DataFrame({
        "problem": references["case"], "nodes": references["reached"], "contact nodes": references["contact_nodes"],
        "levels": references["levels"], "energy norm squared": references["energy"],
        "own error": 100 * own, "least error measured": 100 * least, "which is right to": 40 * (own / least)**2,
        "natural residual": references["certificate"]})
    note = ("Bisected by the residual estimate, solved to 1e-9. The own error, relative in the energy norm, is "
            "estimated by recovery and added to the squares of the errors measured (adaptmg.estimate.Reference), "
            "which are right to .4 times the square of the quotient of both. Points of the GRECO bar are "
            "compared with converged values of quadratic elements. Pressures, points and forces of the "
            "finest meshes come near the reference's own. Energy: per metre in plane strain.")
    return common.Table("adaptive_references", frame, "References", note, {"energy norm squared": "N m"}
                        | dict.fromkeys(["own error", "least error measured", "which is right to"], "%"),
                        {"energy norm squared": ".6g", "own error": ".3f", "least error measured": ".3f",
                         "which is right to": ".0f", "natural residual": ".1e"})


def mesh_table(rows: pd.DataFrame) -> common.Table:
    """Every mesh."""
    over = gains(rows)
    frame = pd.DataFrame({
        "problem": rows["case"], "meshes": rows["family"], "nodes": rows["nodes"], **errors(rows),
        "estimate over error": rows["estimate"] / rows["energy_error"], "levels": rows["levels"],
        "cycles": rows["cycles"], "work": rows["work_units"], "time": rows["cpu"],
        "nodes, uniform over this": over["nodes"], "time, uniform over this": over["time"],
        "uniform": np.where(over["time"].isna(), "", np.where(over["beyond"], "extrapolated", "measured")),
        "status": rows["outcome"]})
    ratios = [name for name in frame if name.endswith("over this")]
    return common.Table("adaptive_meshes", frame, "Every mesh",
                        "Errors, work and time as above. Estimate over error: in the energy norm (of goals: that of "
                        "their bubbles). Uniform over this: at equal energy error; empty where the coarsest uniform "
                        "mesh is better.", dict.fromkeys(ERRORS, "%") | dict.fromkeys(ratios, "ratio")
                        | {"work": "WU", "time": "s"},
                        ERRORS | dict.fromkeys(ratios, ".3g")
                        | {"estimate over error": ".2f", "work": ".1f", "time": ".3g"})
