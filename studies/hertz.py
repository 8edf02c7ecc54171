"""Does the contact pressure come out right where it is known: Hertz (cylinders, ball) and Cattaneo?

    python studies/hertz.py [--quick | --full] [--out DIR]

Half-width a and peak p0 come from a least-squares line through p^2 against x^2 at the nodes within
.8 a. Sizes are halved everywhere from mesh to mesh, with edges of a/2.5, a/5, ... at contact,
growing with the distance to it; the meshes are independent, and those before serve multigrid as
coarse levels. Cattaneo: half-width of the stick zone."""

import numpy as np
from common import Output, drawing, main

import adaptmg as am

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
        stick = x[contact.state == am.STICK]
        row["stick_error"] = (
            0.5 * float(np.ptp(stick)) * form.half_width / problem.reference["stick"] - 1
        )
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
            "cycles",
            "work_units",
        ]
    ]
    out.table(
        "errors",
        table,
        "Half-width, peak pressure and stick zone against the closed forms",
        "Fineness: half-width over the edge length at contact.",
        units={"work_units": "WU"},
        formats={"a_error": ".1e", "peak_error": ".1e", "stick_error": ".1e", "work_units": ".1f"},
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
    figure.legend(loc="outside right upper")
    out.figure(
        "errors", figure, "Errors of peak pressure and half-width against the fineness at contact"
    )
    last = table[table["fineness"] == fineness[-1]]
    out.number(
        f"Hertz and Cattaneo, {fineness[-1]} edges on a half-width: error of half-width; of peak pressure",
        f"{last['a_error'].abs().max():.2%}; {last['peak_error'].abs().max():.2%}",
    )
    out.check(
        "largest error of the half-width on the finest meshes",
        float(last["a_error"].abs().max()),
        high=0.03,
    )


if __name__ == "__main__":
    main(study)
