"""Does a contact problem with friction cost more than one linear solve of the same matrix?

    python studies/amg.py [--quick | --full] [--out DIR]

The linear (glued) problem has all contact dofs fixed. It is solved by conjugate gradients to a true
energy error of 1e-8, preconditioned by smoothed aggregation of pyamg with rigid-body modes and by
geometric multigrid with the same transfers and half sweeps as ours. The contact problem, GRECO bar
with friction 1 on uniform grids and on a graded mesh, the block in 3D, is solved by the default,
the monotone mode and the active set method to 1e-8 (estimated). Seconds are processor time of
set-up and solve; meshing, assembly and transfers, which all methods need, are not in them. Our
compiled sweeps are quicker than pyamg's: seconds favour ours more than work would."""

import pandas as pd
from common import Output, chain, cpu, drawing, main, timed
from linear_rivals import (
    geometric_preconditioner,
    glued,
    iterate,
    iterations_needed,
    pyamg_preconditioner,
)

import adaptmg as am

LINEAR = {
    "glued, pyamg CG": pyamg_preconditioner,
    "glued, geometric multigrid CG": geometric_preconditioner,
}
CONTACT = {
    "contact, default": am.FullMultigrid(),
    "contact, monotone": am.FullMultigrid(correction=am.Monotone()),
    "contact, active set, direct": am.ActiveSet(nested_start=True),
    "contact, active set, pyamg": am.ActiveSet(linear=am.AMG(), nested_start=True),
}


def grids_of(grid: str, size: int) -> am.Hierarchy:
    """The hierarchy of a row: divisions of uniform grids, halvings of 20 mm of graded ones."""
    if grid == "graded":
        return am.Hierarchy.graded(
            am.cases.greco_bar(law=am.Coulomb(1.0)),
            [20e-3 / 2**k for k in range(size + 1)],
            contact_ratio=4,
        )
    problem = (am.cases.greco_bar if grid == "uniform" else am.cases.greco_block)(
        law=am.Coulomb(1.0)
    )
    return am.Hierarchy.uniform(
        problem, chain(size, size.bit_length() - (2 if grid == "uniform" else 1))
    )


def run(grid: str, size: int) -> dict:
    """Every method on one hierarchy: iterations and processor seconds."""
    hierarchy = grids_of(grid, size)
    nodes = hierarchy.finest.n_nodes
    problem, row = glued(hierarchy), {"nodes": nodes}
    for name, build in LINEAR.items():
        count = iterations_needed(problem, build(problem))
        seconds = cpu(lambda build=build, count=count: iterate(problem, build(problem), count))
        row |= {f"{name}: iterations": count, f"{name}: s": seconds}
    for name, solver in CONTACT.items():
        if name == "contact, active set, pyamg" and nodes > 20_000:
            continue
        result, seconds = timed(hierarchy, solver)
        if name == "contact, default":
            row |= {"default_work": result.work_units, "pyamg_s": row["glued, pyamg CG: s"]}
        row |= {
            f"{name}: iterations": result.cycles,
            f"{name}: s": seconds,
            f"{name}: status": result.status.name,
        }
    return row


def study(out: Output) -> None:
    """Compute all grids; seconds over those of pyamg."""
    sizes = (
        [("uniform", 16), ("uniform", 32), ("uniform", 64), ("graded", 3)]
        if out.quick
        else [
            *(("uniform", n) for n in (32, 64, 128, 256)[: 4 if out.full else 3]),
            ("graded", 5),
            ("3D", 8),
            *([("3D", 16)] if out.full else []),
        ]
    )
    points = [{"grid": grid, "size": size} for grid, size in sizes]
    table = am.Study(run, points, out.store).run(throw=True)
    methods = [*LINEAR, *CONTACT]
    long = pd.DataFrame(
        [
            {
                "grid": row["grid"],
                "nodes": row["nodes"],
                "method": name,
                "iterations": row.get(f"{name}: iterations"),
                "seconds": row.get(f"{name}: s"),
                "over pyamg": row.get(f"{name}: s") / row["glued, pyamg CG: s"],
                "status": row.get(f"{name}: status", ""),
            }
            for row in table.to_dict("records")
            for name in methods
        ]
    ).dropna(subset="seconds")
    over = long.pivot(index=["grid", "nodes"], columns="method", values="over pyamg")[
        methods[1:]
    ].reset_index()
    short = over.merge(table[["grid", "nodes", "pyamg_s", "default_work"]], on=["grid", "nodes"])
    short.insert(0, "grid, nodes", short["grid"] + ", " + short["nodes"].astype(str))
    contact = zip(short["contact, default"], short["default_work"], strict=True)
    short["contact"] = [f"{over:.2f} / {work:.0f}" for over, work in contact]
    last = short.iloc[-1]
    short = short[
        [
            "grid, nodes",
            "pyamg_s",
            "glued, geometric multigrid CG",
            "contact",
            "contact, active set, direct",
        ]
    ]
    short.columns = ["grid, nodes", "pyamg", "MG CG", "contact", "active set"]
    out.table(
        "over_pyamg",
        short,
        "Contact with friction against one linear solve",
        "Seconds of pyamg CG for the linear (glued) problem; the others over those: it by CG with geometric "
        "multigrid (MG), the contact problem by the default / its work units, and by the active set method.\n\n"
        "Set-up and solve, to a true error of 1e-8 (contact: estimated); direct solves in the active set method. "
        "Meshes, matrices and transfers, which all need, are not counted.",
        card="Contact against one linear solve",
        units={"pyamg": "s"},
        formats={"pyamg": ".3f", "MG CG": ".2f", "active set": ".2f"},
    )
    out.table(
        "methods",
        long,
        "Iterations and seconds of every method",
        units={"seconds": "s"},
        formats={"iterations": ".0f", "seconds": ".3f", "over pyamg": ".2f"},
    )
    figure, ax = drawing()
    for name, rows in long[long["grid"] == "uniform"].groupby("method", sort=False):
        ax.loglog(rows["nodes"], rows["seconds"], "s--" if name in LINEAR else "o-", label=name)
    ax.set(xlabel="nodes", ylabel="set-up and solve [s]")
    figure.legend(loc="outside right upper")
    out.figure(
        "seconds",
        figure,
        "GRECO bar on uniform grids: seconds of set-up and solve; dashed: linear problem",
    )
    out.number(
        f"Contact problem ({last['grid, nodes']} nodes), seconds over a linear solve by pyamg; by geometric CG",
        f"{last['contact, default']:.2f}; {last['contact, default'] / last[list(LINEAR)[1]]:.2f}",
    )
    # seconds depend on what else the machine does
    largest = table[table["grid"] == "uniform"].iloc[-1]
    out.check(
        "cycles of the contact problem over iterations of pyamg, largest uniform grid",
        float(largest["contact, default: iterations"] / largest["glued, pyamg CG: iterations"]),
        high=1.0,
    )


if __name__ == "__main__":
    main(study)
