"""Does the contact pressure come out right where it is known: Hertz (cylinders, ball) and Cattaneo?

    python studies/hertz.py [--quick | --full] [--out DIR]

Half-width a and peak p0 come from a least-squares line through p^2 against x^2 at the nodes within
.8 a. Sizes are halved everywhere from mesh to mesh, with edges of a/2.5, a/5, ... at contact,
growing with the distance to it; the meshes are independent, and those before serve multigrid as
coarse levels.

Cattaneo: the half-width c of the stick zone, seen twice. States of nodes change between a node that
sticks and one that slips: half-way, c is known to half an edge, h / 2c, and no better (the outermost
node that sticks lies 0 to h inside). The tractions know more: (mu p - |t|)^2 falls linearly with x^2
inside the zone, and a line through its nodes within .8 c vanishes at c."""

import numpy as np
from common import Output, drawing, main

import adaptmg as am
from adaptmg.plot.style import label_plainly

CASES = {
    "cylinder on block": am.cases.hertz_cylinder,
    "ball on block": am.cases.hertz_sphere,
    "Cattaneo": am.cases.cattaneo,
}


def mesh(problem: am.ContactProblem, a: float, fineness: float) -> am.MeshArrays:
    """A mesh with edges of a / fineness where bodies touch, which grow with the distance."""
    extent = float(np.max(problem.domain.upper - problem.domain.lower)) / 2
    near = am.SizeNear([(0.0, 0.0)], size=a / 2.5, radius=1.3 * a, grading=0.96).scaled(
        2.5 / fineness
    )
    return am.mesh.sized(problem.domain, near, 0.65 * near.grading * extent, grading=near.grading)


def run(case: str, fineness: int) -> dict:
    """Errors of the contact with edges of a / fineness, and what multigrid costs."""
    problem = CASES[case]()
    form = problem.reference["closed_form"]
    grids = am.Hierarchy.from_meshes(
        problem,
        [
            mesh(problem, form.half_width, 2.5 * 2**k)
            for k in range(round(np.log2(fineness / 2.5)) + 1)
        ],
    )
    result = am.solve(grids, am.FullMultigrid() if len(grids) > 1 else am.ActiveSet())
    contact = result.contact
    x = contact.x[:, 0] / form.half_width
    near = abs(x) < 0.8
    slope, square = np.polyfit(x[near] ** 2, (contact.pressure[near] / form.peak) ** 2, 1)
    a, peak = np.sqrt(square / -slope), np.sqrt(square)
    row = {
        "nodes": grids.finest.n_nodes,
        "contact_nodes": len(contact),
        "a_error": a - 1,
        "peak_error": peak - 1,
        "cycles": result.cycles,
        "work_units": result.work_units,
        "rate": result.rate,
    }
    if case == "Cattaneo":
        order = np.argsort(x)
        sticks = contact.state[order] == am.STICK
        changes = np.flatnonzero(np.diff(sticks))
        low, high = (0.5 * (x[order][k] + x[order][k + 1]) for k in changes[[0, -1]])
        c = problem.reference["stick"] / form.half_width
        row["stick_error"] = 0.5 * (high - low) / c - 1
        row["half_edge"] = 0.5 * float(np.diff(x[order])[changes[0]]) / c
        inner = abs(x) < 0.8 * c
        left = problem.reference["partial_slip"].friction * contact.pressure - abs(
            contact.traction[:, 0]
        )
        slope, square = np.polyfit(x[inner] ** 2, left[inner] ** 2, 1)
        row["stick_line_error"] = np.sqrt(square / -slope) / c - 1
    return row


def study(out: Output) -> None:
    """Compute all cases on finer and finer meshes."""
    fineness = [5, 10] if out.quick else [5, 10, 20, 40, 80] if out.full else [5, 10, 20, 40]
    table = am.Study(run, {"case": list(CASES), "fineness": fineness}, out.store).run(throw=True)
    table = table[
        [
            "case",
            "fineness",
            "nodes",
            "contact_nodes",
            "a_error",
            "peak_error",
            "stick_error",
            "half_edge",
            "stick_line_error",
            "cycles",
            "work_units",
        ]
    ]
    out.table(
        "errors",
        table,
        "Half-width, peak pressure and stick zone against the closed forms",
        "Fineness: half-width over the edge length at contact. The stick zone ends half-way between "
        "nodes that stick and that slip, which tells its half-width c to half an edge (half_edge, of "
        "c); stick_line_error is that of the line through the tractions.",
        units={"work_units": "WU"},
        formats=dict.fromkeys(
            ("a_error", "peak_error", "stick_error", "half_edge", "stick_line_error"), ".1e"
        )
        | {"work_units": ".1f"},
    )
    figure, ax = drawing()
    for case, rows in table.groupby("case", sort=False):
        (line,) = ax.loglog(rows["fineness"], rows["peak_error"].abs(), "o-", label=f"{case}, peak")
        ax.loglog(
            rows["fineness"],
            rows["a_error"].abs(),
            "s:",
            color=line.get_color(),
            label=f"{case}, half-width",
        )
    ax.set(xlabel="half-width over edge length at contact", ylabel="relative error")
    ax.set_xticks(fineness, map(str, fineness))
    ax.minorticks_off()
    label_plainly(ax.yaxis)
    figure.legend(loc="outside right upper")
    out.figure(
        "errors", figure, "Errors of peak pressure and half-width against the fineness at contact"
    )
    last = table[table["fineness"] == fineness[-1]]
    out.number(
        f"Hertz, Cattaneo, {fineness[-1]} edges on a: error of a; peak; stick zone by tractions; "
        "by states",
        f"{last['a_error'].abs().max():.2%}; {last['peak_error'].abs().max():.2%}; "
        f"{last['stick_line_error'].abs().max():.2%}; {last['stick_error'].abs().max():.1%} "
        f"(half an edge {last['half_edge'].max():.1%})",
    )
    out.check(
        "largest error of the half-width on the finest meshes",
        float(last["a_error"].abs().max()),
        high=0.03 if out.quick else 0.002,
    )
    slip = table[table["case"] == "Cattaneo"]
    out.check(
        "largest error of the stick zone by states, in half edges",
        float((slip["stick_error"].abs() / slip["half_edge"]).max()),
        high=1.5,
    )


if __name__ == "__main__":
    main(study)
