"""Tables of ``adaptive_vs_uniform.py``: convergence rates, cost of an accuracy, the finest meshes, the references."""

from __future__ import annotations

from collections.abc import Mapping

import common
import numpy as np
import pandas as pd
from adaptive_cases import CASES

#: relative energy errors whose cost is asked for
WANTED: Mapping[str, float] = {"upset block": 1.2e-3, "flat punch": 2.5e-2, "dovetail": 2.5e-2}
#: strongest singularity, u ~ r^exponent: end of a contact zone, stick at a free corner, edge of a punch, corners of
#: 270 degrees; that of a free edge of one block on another of other stiffness is not known to us
EXPONENTS: Mapping[str, float] = {
    "GRECO bar": 1.39, "upset block": 0.781, "flat punch": 0.5, "dovetail": 0.5445, "bolted junction": 0.5445,
    "upset block 3D": 0.781, "two blocks 3D": float("nan")}
#: meshes over which rates are fitted
LAST = 3


def tables(rows: pd.DataFrame, references: pd.DataFrame) -> list[common.Table]:
    """All of them."""
    return [rate_table(rows), cost_table(rows), finest_table(rows), pressure_rates(rows), reference_table(references),
            mesh_table(rows)]


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
        line = {"case": case, "theory, uniform": theory(case, "uniform")}
        line |= {family: rate(group) for family, group in of_case.groupby("family", sort=False)}
        lines.append(line | {"theory, adapted": theory(case, "residual, bisected")})
    frame = pd.DataFrame(lines)
    # goals ask for something else than the energy
    led = frame[[name for name in frame if name.startswith(("residual", "recovery"))]].min(axis=1)
    least = {dim: led[[CASES[name].dim == dim for name in frame["case"]]].min() for dim in (2, 3)}
    note = (f"Exponent r of error ~ N^-r, N nodes, over the last {LAST} meshes. Theory: u ~ r^lambda at the strongest "
            "singularity gives N^(-min(1, lambda)/d) on uniform meshes, and in the end on those graded by a fixed "
            "ratio; adapted meshes N^(-1/d). On the GRECO bar (lambda > 1) adaptivity improves the constant only. "
            f"Least rate of meshes led by the residual or recovery: {least[2]:.3f} in 2D, {least[3]:.3f} in 3D. Rates "
            "above theory belong to meshes that resolve their strongest singularities late; below theory (junction, "
            "two blocks) corners are not resolved yet, and references err too.")
    return common.Table("adaptive_rates", frame, "Energy error: fitted rates and theory", note, {},
                        {name: ".3f" for name in frame if name != "case"})


def at_error(group: pd.DataFrame, error: float, column: str) -> tuple[float, bool]:
    """Value of a column where the energy error has fallen to ``error``, and whether it lies beyond the last mesh.

    Logarithms are interpolated; beyond, the line through the last three meshes is continued.
    """
    x, y = np.log(group["energy_error"].to_numpy()), np.log(group[column].to_numpy())
    wanted = np.log(error)
    below = np.flatnonzero(x <= wanted)
    if not below.size:
        slope = np.polyfit(x[-LAST:], y[-LAST:], 1)[0]
        return float(np.exp(y[-1] + slope * (wanted - x[-1]))), True
    k = int(below[0])
    if k == 0:
        return float("nan"), False
    share = (wanted - x[k - 1]) / (x[k] - x[k - 1])
    return float(np.exp((1 - share) * y[k - 1] + share * y[k])), False


def pays_below(uniform: pd.DataFrame, group: pd.DataFrame) -> float:
    """The largest error below which these meshes take less processor time than uniform ones, as far as measured.

    NaN where they never do. Both are interpolated between logarithms.
    """
    least = max(uniform["energy_error"].min(), group["energy_error"].min())
    most = min(uniform["energy_error"].max(), group["energy_error"].max())
    errors = np.geomspace(least, most, 200) if least < most else np.zeros(0)
    slower = [at_error(group, error, "cpu")[0] >= at_error(uniform, error, "cpu")[0] for error in errors]
    if not slower or slower[0]:
        return float("nan")
    return float(errors[slower.index(True)] if True in slower else most)


def common_error(of_case: pd.DataFrame) -> float:
    """The error to which families of a case are compared: one wanted, or the least that all of them reach."""
    case = of_case["case"].iloc[0]
    reached = of_case.groupby("family", sort=False)["energy_error"].min().max()
    wanted = WANTED.get(case, reached)
    # on the meshes of a quick run none comes near it
    adaptive = of_case[~of_case["family"].isin(["uniform", "graded by hand"])]
    return wanted if adaptive.groupby("family")["energy_error"].min().max() <= wanted else reached


def cost_table(rows: pd.DataFrame) -> common.Table:
    """Nodes, work and seconds to one accuracy, and the ratio of uniform meshes to each."""
    lines = []
    for case, of_case in rows.groupby("case", sort=False):
        error = common_error(of_case)
        of_case = of_case.assign(passes=of_case["work_units"] * of_case["nonzeros"] * 1e-6)
        uniform = {}
        for family, group in of_case.groupby("family", sort=False):
            below = pays_below(of_case[of_case["family"] == "uniform"], group) if uniform else float("nan")
            values = {name: at_error(group, error, name) for name in ("nodes", "passes", "cpu")}
            found = {name: value for name, (value, _) in values.items()}
            uniform = uniform or found
            lines.append({"case": case, "energy error": 100 * error, "meshes": family, "nodes": found["nodes"],
                          "entries": found["passes"], "seconds": found["cpu"],
                          "nodes x": uniform["nodes"] / found["nodes"],
                          "entries x": uniform["passes"] / found["passes"],
                          "seconds x": uniform["cpu"] / found["cpu"],
                          "quicker below": 100 * below,
                          "how": "extrapolated" if values["cpu"][1] else "measured"})
    frame = pd.DataFrame(lines)
    return common.Table("adaptive_cost", frame, "Cost of an accuracy, everything counted", cost_note(frame),
                        {"energy error": "%", "entries": "1e6", "seconds": "s", "quicker below": "%"},
                        {"energy error": ".3g", "nodes": ".0f", "entries": ".1f", "seconds": ".3f", "nodes x": ".1f",
                         "entries x": ".1f", "seconds x": ".2f", "quicker below": ".2g"})


def cost_note(frame: pd.DataFrame) -> str:
    """Where adaptive meshes pay in seconds, and where they do not."""
    adaptive = frame[~frame["meshes"].isin(["uniform", "graded by hand"])]
    best = adaptive.loc[adaptive.groupby("case", sort=False)["seconds x"].idxmax()]
    words = [f"{row['case']} {row['seconds x']:.1f} ({row['meshes']})" for _, row in best.iterrows()]
    slower = frame[(frame["seconds x"] < 1) & (frame["meshes"] != "uniform")]
    losers = "; ".join(f"{case}: {', '.join(group['meshes'])}" for case, group in slower.groupby("case", sort=False))
    return ("Logarithms interpolated between meshes; 'extrapolated' along the last three where no mesh is so fine. "
            "Entries: matrix entries passed over in all solves (work units times nonzeros). x: cost on uniform meshes "
            "over that on these. Quicker below: energy error below which these meshes take less time than uniform "
            f"ones, where both were measured. Best ratio of seconds: {', '.join(words)}. "
            + (f"Uniform meshes are quicker than: {losers}." if losers else "Uniform meshes are slowest everywhere."))


def finest_table(rows: pd.DataFrame) -> common.Table:
    """All errors on the finest mesh of each family."""
    last = rows.groupby(["case", "family"], sort=False).tail(1)
    frame = pd.DataFrame({
        "case": last["case"], "meshes": last["family"], "nodes": last["nodes"], "at contact": last["contact_nodes"],
        "energy": 100 * last["energy_error"], "pressure": 100 * last["pressure_error"],
        "points": 100 * last["points_error"], "force": 100 * last["force_error"], "zones": 1e3 * last["ends_error"],
        "levels": last["levels"], "WU": last["work_units"], "seconds": last["cpu"]})
    forces = ", ".join(f"{name}: {case.force[0]}" for name, case in CASES.items())
    note = ("Energy: relative, in the energy norm. Pressure: relative L2 error along contact, without 5 % (3D: 10 %) "
            "of the surface at singular edges. Points: largest relative error of the chosen displacements. Force: "
            f"relative; {forces}. Zones: largest error of a place where the contact state changes, where there are "
            "such and as many of them as on the reference. WU: passes over the matrix of this mesh, in all "
            "solves up to it.")
    return common.Table("adaptive_finest", frame, "Errors on the finest meshes", note,
                        {"energy": "%", "pressure": "%", "points": "%", "force": "%", "zones": "mm", "seconds": "s"},
                        {"energy": ".3f", "pressure": ".3f", "points": ".4f", "force": ".4f", "zones": ".3f",
                         "WU": ".1f", "seconds": ".2f"})


def pressure_rates(rows: pd.DataFrame) -> common.Table:
    """Gains in other quantities than the energy, at equal nodes, against uniform meshes."""
    lines = []
    for case, of_case in rows.groupby("case", sort=False):
        uniform = of_case[of_case["family"] == "uniform"]
        for family, group in of_case.groupby("family", sort=False):
            if family == "uniform":
                continue
            line = {"case": case, "meshes": family}
            for name, column in (("energy", "energy_error"), ("pressure", "pressure_error"), ("points", "points_error"),
                                 ("force", "force_error")):
                line[name] = gain(group, uniform, column)
            lines.append(line)
    frame = pd.DataFrame(lines)
    note = ("Error of uniform meshes (logarithms interpolated) over that of each mesh, at the same number of nodes: "
            "geometric mean over the last three meshes that have uniform ones on both sides. Single points and forces "
            "pass through zero, so that these gains scatter.")
    return common.Table("adaptive_gains", frame, "Gain at equal nodes", note, {},
                        {name: ".1f" for name in ("energy", "pressure", "points", "force")})


def gain(group: pd.DataFrame, uniform: pd.DataFrame, column: str) -> float:
    """Error of the uniform meshes at the same number of nodes over each error; geometric mean of the last three."""
    there = np.interp(np.log(group["nodes"]), np.log(uniform["nodes"]), np.log(uniform[column]), np.nan, np.nan)
    gains = there - np.log(group[column].to_numpy())
    gains = gains[np.isfinite(gains)][-LAST:]
    return float(np.exp(gains.mean())) if gains.size else float("nan")


def reference_table(references: pd.DataFrame) -> common.Table:
    """What the errors are measured against."""
    frame = pd.DataFrame({
        "case": references["case"], "nodes": references["reached"], "at contact": references["contact_nodes"],
        "levels": references["levels"], "energy norm squared": references["energy"],
        "own error": 100 * references["own_error"] / np.sqrt(references["energy"]),
        "residual": references["certificate"]})
    note = ("Bisected by the residual estimate, solved to 1e-9. The own error, relative in the energy norm, is "
            "estimated by recovery and added to the squares of the errors measured (adaptmg.estimate.Reference): "
            "energy errors are right to .4 times the square of the quotient of both. Points of the GRECO bar are "
            "compared with converged values of quadratic elements. Pressures, points and forces of the "
            "finest meshes come near the reference's own.")
    return common.Table("adaptive_references", frame, "References", note,
                        {"energy norm squared": "N m", "own error": "%"},
                        {"energy norm squared": ".6f", "own error": ".3f", "residual": ".1e"})


def mesh_table(rows: pd.DataFrame) -> common.Table:
    """Every mesh."""
    frame = pd.DataFrame({
        "case": rows["case"], "meshes": rows["family"], "nodes": rows["nodes"], "energy": 100 * rows["energy_error"],
        "effectivity": rows["estimate"] / rows["energy_error"], "pressure": 100 * rows["pressure_error"],
        "points": 100 * rows["points_error"], "force": 100 * rows["force_error"], "levels": rows["levels"],
        "cycles": rows["cycles"], "WU": rows["work_units"], "seconds": rows["cpu"], "status": rows["outcome"]})
    return common.Table("adaptive_meshes", frame, "Every mesh", "Columns as above; effectivity: estimated over "
                        "measured energy error (of goals: that of their bubbles).",
                        {"energy": "%", "pressure": "%", "points": "%", "force": "%", "seconds": "s"},
                        {"energy": ".3f", "effectivity": ".2f", "pressure": ".3f", "points": ".4f", "force": ".4f",
                         "WU": ".1f", "seconds": ".2f"})
