"""Table 1 of the paper: how much do two, three and four grids gain over one?

    python studies/table_1_grids.py [--quick | --full] [--out DIR]

GRECO bar, friction 1, 33 x 33 nodes. Every method runs until its true error, ||u - u_h||_A / ||u_h||_A against the
exact discrete solution, is below 1e-6, with the paper's smoother (two forward Gauss-Seidel sweeps, omega 1) and nested
start; the paper's own mode runs to a change of 1e-6, as it cannot come closer. Complete coarse solves, as in the paper,
stop at a tolerance that the paper does not state: the gain depends on it. Work counts every pass over a matrix by its
nonzeros, relative to the finest. Not in it: the factorisation of the coarsest level (default) and of the condensed
problem; they are in the seconds.
"""

from dataclasses import replace

import pandas as pd
from common import Output, chain, exact, grids, main, paper, quickest, warm_up, work_to
from matplotlib import pyplot as plt

import adaptmg as am

TARGET = 1e-6
MONOTONE = am.FullMultigrid(correction=am.Monotone(), cycle=am.Cycle(shape="complete"), rtol=TARGET,
                            coarse=am.CoarseSolve(condensed=False, rtol=1e-2))
METHODS = {
    "one grid": am.SingleGrid(rtol=TARGET),
    "one grid, omega 1.97": am.SingleGrid(omega=1.97, friction_update=2, rtol=TARGET),
    "one grid, condensed, omega 1.5": am.SingleGrid(omega=1.5, condensed=True, rtol=TARGET),
    "monotone, complete to 1e-2": MONOTONE,
    "monotone, complete to 1e-4": replace(MONOTONE, coarse=am.CoarseSolve(condensed=False, rtol=1e-4)),
    "monotone, W": replace(MONOTONE, cycle=am.Cycle(shape="W")),
    "monotone, V": replace(MONOTONE, cycle=am.Cycle(shape="V")),
    "default (truncated)": am.FullMultigrid(rtol=TARGET),
    "the paper's mode": replace(MONOTONE, correction=am.PaperCorrection(), stop="change"),
}


def run(method: str, levels: int, divisions: int) -> dict:
    """One method on nested grids; the quickest of three runs."""
    warm_up()
    result = quickest(grids("GRECO bar", chain(divisions, levels)), METHODS[method],
                      reference=exact("GRECO bar", divisions))
    work = result.work_units if method == "the paper's mode" else work_to(result, TARGET)
    return {"work": work, "solve_seconds": result.seconds, "true_error": result.history["true_error"][-1]}


def study(out: Output) -> None:
    """Compute every method on one to four grids; print the gains in work and seconds over one grid."""
    divisions, counts = 16 if out.quick else 64 if out.full else 32, [2, 3] if out.quick else [2, 3, 4]
    points = [{"method": name, "levels": n} for name in METHODS for n in ([1] if name.startswith("one") else counts)]
    table = am.Study(run, points, out.store, fixed={"divisions": divisions}).run(throw=True)
    table = table[["method", "levels", "work", "solve_seconds", "true_error"]].rename(
        columns={"solve_seconds": "seconds", "true_error": "error"})
    table["gain, work"], table["gain, s"] = (table[name][0] / table[name] for name in ("work", "seconds"))
    formats = {"work": ".1f", "seconds": ".3f", "error": ".1e", "gain, work": ".1f", "gain, s": ".1f"}

    rows = {name: table[table["method"] == name].set_index("levels").loc[counts] for name in METHODS
            if not name.startswith("one")}
    first = pd.DataFrame({"grids": counts, "paper": paper("table1_methods").set_index("n_grids")["speedup"][counts]})
    for name, short in (("monotone, complete to 1e-2", "1e-2"), ("monotone, complete to 1e-4", "1e-4"),
                        ("default (truncated)", "default"), ("the paper's mode", "its mode")):
        first[[f"{short}, work", f"{short}, s"]] = rows[name][["gain, work", "gain, s"]].to_numpy()
    first["its error"] = rows["the paper's mode"]["error"].to_numpy()
    out.table("table_1", first, "Table 1: how much more grids gain", f"Speed-up over one grid with omega 1, "
              f"{(divisions + 1)**2} nodes, in work and seconds (s), at a true error of 1e-6: complete coarse solves to "
              "1e-2 and 1e-4, and the default. Its mode: the paper's, to a change of 1e-6, where it stops at 'its "
              "error'. Paper: CPU time.", formats={name: ".1f" for name in first.columns[1:]} | {"its error": ".0e"},
              card="Table 1: more grids")
    out.table("methods", table, "All methods: work units and seconds to a true error of 1e-6, and the error at the end",
              units={"seconds": "s"}, formats=formats)
    figure, ax = plt.subplots(figsize=(6.4, 3.2))
    for name, row in rows.items():
        ax.semilogy(row.index, row["gain, work"], "o-", label=name)
    ax.semilogy(counts, first["paper"], "ks:", label="the paper, CPU time")
    ax.set(xlabel="number of grids", ylabel="gain in work over one grid", xticks=counts)
    figure.legend(loc="outside right upper")
    out.figure("gain", figure, "Gain in work over one grid with omega 1, at a true error of 1e-6 (the paper's mode: at "
                               "its own test)")
    out.check("gain of the default on the most grids, in work", float(rows["default (truncated)"]["gain, work"].iloc[-1]),
              low=10 if out.quick else 50)


if __name__ == "__main__":
    main(study)
