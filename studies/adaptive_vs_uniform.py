"""From which accuracy on do adaptive meshes pay against uniform and graded meshes?

    python studies/adaptive_vs_uniform.py [--quick | --full] [--out DIR]

Uniform meshes, those of am.Hierarchy.graded (finer towards contact by a given ratio, 4, in space
2), and those of the adaptive loop am.adapt (residual indicator; bisected, the default, or remeshed
by sizes). The loop solves to 1e-6, far below the error of its meshes; uniform and graded meshes
have hierarchies of their own, halved from level to level, and are solved from a nested start to a
tenth of the discretisation error. Seconds are processor time with warm kernels for everything:
meshes (Netgen's process, too), matrices, transfers, solves, estimates; of an adaptive mesh those of
all steps before it too. Loops begin with the default mesh. Energy errors are against a solution on
a bisected mesh with several times the nodes of the finest one. Between meshes costs are
interpolated along the logarithm of the error. Singular corners and edges slow uniform meshes down,
so that the gain in nodes grows as the error falls; without them adaptive meshes save a constant
factor of nodes at most."""

import json
from functools import lru_cache

import numpy as np
import pandas as pd
from common import Output, drawing, main, processor_time, warm_up
from matplotlib.ticker import NullLocator

import adaptmg as am
from adaptmg.estimate import Reference, energy_error
from adaptmg.mesh import bisect, graded, structured

#: problem, and its coarsest uniform mesh (cells along a side, or size, m)
CASES = {
    "GRECO bar": (am.cases.greco_bar, 4),
    "upset block": (am.cases.upset_block, 4),
    "flat punch": (am.cases.flat_punch, 40e-3),
    "dovetail": (am.cases.dovetail, 6e-3),
    "bolted junction": (am.cases.bolted_junction, 12e-3),
    "GRECO block 3D": (am.cases.greco_block, 2),
}
ENGINES = {"remeshed": am.Remesh(), "bisected": am.Bisect()}
FAMILIES = ("graded", *ENGINES)
#: problems of the table in the README, and their names there
SHOWN = {"GRECO bar": "bar", "flat punch": "punch", "GRECO block 3D": "block 3D"}


def uniform_meshes(
    problem: am.ContactProblem, coarse: float, refinements: int
) -> list[am.MeshArrays]:
    """Nested uniform meshes, coarse to fine: structured, or by Netgen and refined everywhere."""
    if isinstance(coarse, int):
        return [structured(problem.domain, coarse * 2**k) for k in range(refinements + 1)]
    meshes = [graded(problem.domain, coarse, problem.pair_boundaries, 1)]
    for _ in range(refinements):
        meshes.append(bisect(meshes[-1], np.ones(len(meshes[-1].elements), dtype=bool))[0])
    # a coarser one cannot pose the problem
    return [mesh for mesh in meshes if len(mesh.boundary_nodes(problem.contact_boundaries[0])) >= 3]


def solutions(case: str, family: str, most: int):
    """Yield hierarchy, result, and processor seconds so far of the meshes of a family."""
    make, coarse = CASES[case]
    problem, spent = make(), 0.0
    begin = processor_time()
    if family in ENGINES:
        for step in am.adapt(problem, engine=ENGINES[family], max_nodes=most):
            spent += processor_time() - begin
            yield step.hierarchy, step.result, spent
            begin = processor_time()  # measuring errors is not part of the loop
        return
    size = (
        coarse
        if isinstance(coarse, float)
        else float(max(problem.domain.upper - problem.domain.lower)) / coarse
    )
    for refinements in range(1, 20):
        begin = processor_time()
        if family == "graded":
            sizes = [size / 2**k for k in range(refinements + 1)]
            grids = am.Hierarchy.graded(problem, sizes, 4 if problem.dim == 2 else 2)
        else:
            meshes = uniform_meshes(problem, coarse, refinements)
            if len(meshes) < 2:
                continue
            grids = am.Hierarchy.from_meshes(problem, meshes)
        result = am.solve(grids, am.FullMultigrid(rtol="discretisation"))
        yield grids, result, processor_time() - begin
        # elements of half the size make about 2^dim times the nodes
        if 2**problem.dim * grids.finest.n_nodes > most:
            return


@lru_cache(maxsize=1)
def reference(case: str, nodes: int) -> Reference:
    """A solution on a far finer, bisected mesh."""
    *_, last = am.adapt(
        CASES[case][0](), engine=am.Bisect(), mark=am.Doerfler(0.6), max_nodes=nodes
    )
    return Reference.of(
        last.hierarchy, am.solve(last.hierarchy, am.Multigrid(rtol=1e-9), start=last.result)
    )


def run(case: str, family: str, most: int, reference_nodes: int) -> dict:
    """Errors and costs of all meshes of a family up to ``most`` nodes, as JSON."""
    warm_up(3 if "3D" in case else 2)
    against = reference(case, reference_nodes)
    for _ in solutions(case, family, min(most, 1000)):  # loads kernels of this case
        pass
    rows = [
        {
            "nodes": grids.finest.n_nodes,
            "levels": len(grids),
            "cycles": result.cycles,
            "cpu": seconds,
            "energy_error": energy_error(against, result).relative,
            "outcome": result.status.name,
        }
        for grids, result, seconds in solutions(case, family, most)
    ]
    return {"meshes": json.dumps(rows)}


def at_error(rows: pd.DataFrame, error: float, column: str) -> float:
    """Value of a column where the energy error has fallen to ``error``; NaN where no mesh reaches
    it."""
    x, y = -np.log(rows["energy_error"].to_numpy()), np.log(rows[column].to_numpy())
    return float(np.exp(np.interp(-np.log(error), x, y, right=np.nan)))


def study(out: Output) -> None:
    """Compute all families of all cases; compare costs at equal errors."""
    cases = list(CASES)[:3] if out.quick else list(CASES)
    parts = []
    for case in cases:
        solid = "3D" in case
        loop = 1500 if out.quick else (5000 if solid else 10_000) * (3 if out.full else 1)
        uniform = 8000 if out.quick else (50_000 if solid else 130_000) * (3 if out.full else 1)
        for family in ("uniform", *FAMILIES):
            found = am.Study(
                run,
                {"case": [case], "family": [family]},
                out.store,
                name=f"{case} {family}",
                fixed={
                    "most": loop
                    if family in ENGINES
                    else uniform
                    if family == "uniform"
                    else uniform // 2,
                    "reference_nodes": loop * (8 if solid or out.quick else 5),
                },
            ).run(throw=True)
            parts.append(
                pd.DataFrame(json.loads(found["meshes"][0])).assign(case=case, family=family)
            )
    meshes = pd.concat(parts, ignore_index=True)
    lines, curves = [], []
    for case in cases:
        of = dict(list(meshes[meshes["case"] == case].groupby("family")))
        low, high = (
            max(rows["energy_error"].min() for rows in of.values()),
            of["uniform"]["energy_error"].iloc[0],
        )
        line = {"problem": case, "error": 100 * low}
        for name in FAMILIES:
            for what, column in (("nodes", "nodes"), ("seconds", "cpu")):
                line[f"{name}: {what}"] = at_error(of["uniform"], low, column) / at_error(
                    of[name], low, column
                )
        lines.append(line)
        errors = np.geomspace(high, low, 30)
        curves += [
            (
                case,
                name,
                errors,
                [at_error(of["uniform"], e, "cpu") / at_error(of[name], e, "cpu") for e in errors],
            )
            for name in FAMILIES
        ]
    table = pd.DataFrame(lines)
    shown = table[["problem", "error"]].copy()
    for name in FAMILIES:
        shown[name] = [
            f"{line[f'{name}: nodes']:.1f} / {line[f'{name}: seconds']:.1f}" for line in lines
        ]
    out.table(
        "gains",
        shown,
        "Adaptive and graded against uniform meshes",
        "Nodes / seconds of uniform meshes over those of others at the least energy error that all reach: "
        "above 1 the others save.\n\n"
        "Processor seconds of everything: meshes, matrices, solves, estimates.",
        card="Adaptive and graded against uniform meshes",
        units={"error": "%"},
        formats={"error": ".2g"},
    )
    out.table(
        "meshes",
        meshes[["case", "family", "nodes", "levels", "cycles", "energy_error", "cpu", "outcome"]],
        "All meshes: nodes, energy error, processor seconds",
        units={"cpu": "s"},
        formats={"energy_error": ".2e", "cpu": ".2f"},
    )
    named = [line for line in lines if line["problem"] in SHOWN]
    places = "; ".join(f"{SHOWN[line['problem']]} ({line['error']:.2g} %)" for line in named)
    out.table(
        "saved",
        pd.DataFrame(
            {"meshes": name}
            | {
                f"{what} saved: {places}": "; ".join(
                    f"{line[f'{name}: {what}']:.1f}" for line in named
                )
                for what in ("nodes", "seconds")
            }
            for name in FAMILIES
        ),
        "What other meshes save against uniform ones",
        "Nodes, and processor seconds of everything, of uniform meshes over those of others at equal energy error "
        "(in brackets); below 1 uniform meshes are cheaper.",
        readme=True,
    )
    figure, ax = drawing(3.1, 4.6)
    for case, name, errors, ratios in curves:
        ax.loglog(
            100 * errors,
            ratios,
            {"graded": "--", "remeshed": "-"}.get(name, ":"),
            color=f"C{cases.index(case)}",
            label=case if name == "remeshed" else None,
        )
    ax.axhline(1.0, color="grey")
    ax.set(xlabel="energy error [%]", ylabel="seconds, uniform over others")
    ax.invert_xaxis()
    for axis, ticks in (
        (ax.xaxis, (0.1, 0.3, 1, 3, 10, 30)),
        (ax.yaxis, (0.1, 0.2, 0.5, 1, 2, 5, 10)),
    ):
        within = axis.get_view_interval()
        axis.set_ticks([tick for tick in ticks if min(within) <= tick <= max(within)])
        axis.set_major_formatter("{x:g}")
        axis.set_minor_locator(NullLocator())
    ax.tick_params(labelsize=8)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    out.figure(
        "seconds",
        figure,
        "Seconds on uniform meshes over those on others at equal energy error: solid "
        "remeshed, dotted bisected, dashed graded; above 1 these are quicker",
        card="Seconds at equal error",
    )
    *_, last = am.adapt(am.cases.dovetail(), max_nodes=1500 if out.quick else 4000)
    out.figure(
        "mesh",
        am.plot.mesh(last.result.mesh),
        f"An adaptive mesh of the dovetail, {last.nodes} nodes",
    )
    out.check(
        "nodes of uniform over those of bisected meshes, flat punch",
        float(table.set_index("problem").loc["flat punch", "bisected: nodes"]),
        low=6.0 if out.quick else 25.0,
    )


if __name__ == "__main__":
    main(study)
