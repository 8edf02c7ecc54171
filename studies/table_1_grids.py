"""Table 1 of the paper: how much do two, three and four grids gain over one?

    python studies/table_1_grids.py [--quick | --full] [--out DIR]

GRECO bar, friction 1, 33 x 33 nodes (--quick: 17 x 17, --full: 65 x 65), to a true error of 1e-6,
with the paper's smoother (two forward Gauss-Seidel sweeps) and nested start; its own mode comes no
closer than a change of 1e-6. The gain in work stands only where nothing is factorised; the default
factorises its coarsest level."""

from dataclasses import replace

import pandas as pd
from common import Output, chain, drawing, exact, gain, grids, main, measured, paper

import adaptmg as am

PROBLEM = "GRECO bar"  # one of common.PROBLEMS
COUNTS = [2, 3, 4]  # numbers of grids
TARGET = 1e-6  # true error
MONOTONE = am.FullMultigrid(
    correction=am.Monotone(),
    cycle=am.Cycle(shape="complete"),
    rtol=TARGET / 2,
    coarse=am.CoarseSolve(condensed=False, rtol=1e-2),
)
METHODS = {
    "one grid": am.SingleGrid(rtol=TARGET / 2),
    "one grid, condensed, omega 1.5": am.SingleGrid(omega=1.5, condensed=True, rtol=TARGET / 2),
    "monotone, complete to 1e-2": MONOTONE,
    "monotone, complete to 1e-4": replace(
        MONOTONE, coarse=am.CoarseSolve(condensed=False, rtol=1e-4)
    ),
    "monotone, V": replace(MONOTONE, cycle=am.Cycle(shape="V")),
    "default (truncated)": am.FullMultigrid(rtol=TARGET / 2),
    "the paper's mode": replace(
        MONOTONE, correction=am.PaperCorrection(), stop="change", rtol=TARGET
    ),
}


def run(method: str, levels: int, divisions: int) -> dict:
    """One method on nested grids; ``part`` of the work of one grid is needed to the error at which
    the mode stops."""
    reference = exact(PROBLEM, divisions)
    row = {"part": 1.0} | measured(
        grids(PROBLEM, chain(divisions, levels)), METHODS[method], reference, TARGET
    )
    if method == "the paper's mode":
        one = am.solve(grids(PROBLEM, (divisions,)), METHODS["one grid"], reference=reference)
        work = [one.work_to(error, of="true_error") for error in (row["final_error"], TARGET)]
        row |= {"work": row["total_work"], "part": work[0] / work[1]}
    return row


def study(out: Output) -> None:
    """Compute every method on one grid and on several; print the gains over one."""
    divisions, counts = (
        16 if out.quick else 64 if out.full else 32,
        COUNTS[:2] if out.quick else COUNTS,
    )
    points = [
        {"method": name, "levels": n}
        for name in METHODS
        for n in ([1] if name.startswith("one") else counts)
    ]
    table = am.Study(run, points, out.store, fixed={"divisions": divisions}).run(throw=True)
    table = table[["method", "levels", "work", "solve_seconds", "final_error", "part"]]
    table.columns = ["method", "grids", "work", "seconds", "error", "part"]
    table["gain, work"], table["gain, s"] = (
        table[x][0] * table["part"] / table[x] for x in ("work", "seconds")
    )
    table.loc[table["method"].str.contains("condensed|default"), ["work", "gain, work"]] = float(
        "nan"
    )
    printed = paper("table1_methods")
    printed = printed[printed["n_grids"].isin([1, *counts])]
    lines = [
        {"method": "the paper"}
        | {
            str(n): f"{ratio:.1f} ({cpu})"
            for n, ratio, cpu in printed[["n_grids", "speedup", "printed"]].to_numpy()
        }
    ]
    lines += [
        {"method": str(name)}
        | {
            str(row["grids"]): gain(row["gain, s"], row["gain, work"])
            + f" ({row['error']:.0e})" * (row["part"] < 1)
            for _, row in rows.iterrows()
        }
        for name, rows in table.groupby("method", sort=False)
    ]
    lines[1]["1"] += f" ({table['seconds'][0]:.3g} s)"
    first = (
        pd.DataFrame(lines)
        .fillna("")
        .rename(columns={str(n): f"{n} grid{'s' * (n > 1)}" for n in (1, *counts)})
    )
    target = f"{TARGET:.0e}".replace("e-0", "e-")
    out.table(
        "table_1",
        first,
        "Table 1: how much more grids gain",
        f"Speed-up over one grid ({(divisions + 1) ** 2} nodes) in processor seconds / in work, to a true error of "
        f"{target}; in brackets the seconds, and the error at which the paper's mode stops.\n\n"
        "Seconds gain less than work as calls cost more than sweeps here: a sweep of the finest "
        f"grid takes {1e6 * table['seconds'][0] / table['work'][0]:.0f} µs, a call on any grid tens of µs.",
        card="Table 1: more grids",
    )
    out.table(
        "methods",
        table.drop(columns="part"),
        f"All methods: work and seconds to a true error of {target}",
        formats=dict.fromkeys(table.columns[[2, 6, 7]], ".1f") | {"seconds": ".3f", "error": ".0e"},
    )
    figure, ax = drawing()
    for name, rows in table[table["grids"] > 1].groupby("method", sort=False):
        ax.semilogy(rows["grids"], rows["gain, s"], "o-", label=name)
    ax.semilogy(
        *printed[["n_grids", "speedup"]][1:].to_numpy().T, "ks:", label="the paper, CPU time"
    )
    ax.set(xlabel="grids", ylabel="gain in seconds", xticks=counts)
    figure.legend(loc="outside right upper")
    out.figure("gain", figure, "Gain in seconds over one grid with omega 1, as in the table")
    theirs = ", ".join(f"{value:g}" for value in printed["speedup"][1:])
    for line, what in ((lines[3], "seconds / work"), (lines[-2], "seconds")):
        out.number(
            f"Speed-up of {str(counts)[1:-1]} grids (paper {theirs}), {line['method']}, {what}",
            "; ".join(list(line.values())[1:]),
        )
    out.check(
        "gain of monotone V-cycles on the most grids, in work",
        float(table[table["method"] == "monotone, V"]["gain, work"].iloc[-1]),
        low=15 if out.quick else 50,
    )


if __name__ == "__main__":
    main(study)
