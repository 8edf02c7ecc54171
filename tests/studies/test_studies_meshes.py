"""The studies of meshes, transfers and algebraic multigrid: they run, and what they measure holds."""

import numpy as np
import pandas as pd
import pytest
from study_scripts import load

import adaptmg as am

common = load("common")
families = load("mesh_families")
transfers = load("transfer_operators")
amg = load("amg_comparison")
front = load("front")


def test_slope_of_a_power():
    x = np.array([10.0, 40.0, 90.0])
    assert common.slope(x, 7 * x**-0.4) == pytest.approx(-0.4)


def test_bisected_families_are_nested_and_refine_the_contact_line():
    for family, fineness in (("8 cells, contact line bisected", 2), ("halved, contact line bisected 3x", 4)):
        grids = families.grids_of(am.cases.greco_bar(), family, fineness)
        for level in grids.levels[1:]:
            # every fine node is a coarse node or the midpoint of an edge, or of one that was cut before
            quarters = 4 * level.prolongation.data
            assert quarters == pytest.approx(np.round(quarters), abs=1e-9)
        assert len(grids.finest.discrete.contact) == 33


def test_the_mesh_to_the_corner_follows_its_size_field():
    mesh = families.to_the_corner(am.cases.upset_block(), 5e-3)
    r = np.linalg.norm(mesh.points[mesh.elements].mean(axis=1), axis=1)
    size = np.sqrt(mesh.volumes * 4 / np.sqrt(3))
    wanted = 5e-3 * np.sqrt(np.maximum(r / families.SIDE, (5e-3 / families.SIDE) ** 2))
    assert np.median(size / wanted) == pytest.approx(1.0, abs=0.35)
    assert size[np.argmin(r)] < 0.3 * size.max()


def test_constants_of_the_glued_problem_vanish_where_it_is_fixed():
    discrete = amg.grids_of("uniform", 8).finest.discrete
    matrix, load_vector, modes, constants = amg.glued(discrete)
    assert matrix.shape[0] == len(load_vector) == len(modes) == len(constants)
    kept = np.setdiff1d(np.arange(discrete.n_nodes), discrete.contact.nodes)
    fixed = discrete.fixed.reshape(-1, 2)[kept].reshape(-1)
    assert fixed.any()
    assert not constants[fixed].any()
    assert (constants[~fixed].sum(axis=1) == 1).all()


def test_counted_solver_counts_and_changes_nothing():
    grids = amg.grids_of("uniform", 8)
    counted = amg.Counted(am.AMG())
    plain = am.solve(grids, am.ActiveSet(linear=am.AMG()))
    result = am.solve(grids, am.ActiveSet(linear=counted))
    # not bitwise: pyamg starts its estimates of spectral radii at random
    assert result.displacement == pytest.approx(plain.displacement, abs=1e-12 * np.abs(plain.displacement).max())
    assert counted.iterations > result.cycles


def test_medians_are_of_seconds_in_turns():
    order, seconds = [], iter([3.0, 1.0, 2.0])

    def first():
        order.append("first")
        return {"total_s": next(seconds), "steps": len(order)}

    found = amg.medians({"first": first, "second": lambda: order.append("second") or {"total_s": 0.0}}, 3)
    assert order == ["first", "second"] * 3
    assert found == {"first: total_s": 2.0, "first: steps": 5, "second: total_s": 0.0}
    table = amg.long_form(pd.DataFrame([{"nodes": 9, **found}]))
    assert table["method"].tolist() == ["first", "second"]
    assert table["total_s"].tolist() == [2.0, 0.0]


def test_what_takes_long_is_run_once(monkeypatch):
    order = []
    clock = iter([0.0, 0.6, 1.0, 1.4, 2.0, 2.4])
    monkeypatch.setattr(amg, "perf_counter", lambda: next(clock))
    calls = {name: lambda name=name: order.append(name) or {"total_s": 1.0} for name in ("long", "short")}
    found = amg.medians(calls, 2)
    assert order == ["long", "short", "short"] and set(found) == {"long: total_s", "short: total_s"}


def test_negative_contact_weights_are_seen():
    problem, meshes = transfers.posed(2, (5e-3, 2.5e-3), 4)
    for rows in (False, True):
        grids = am.Hierarchy.from_meshes(problem, meshes, am.PseudoL2(), contact_rows=rows)
        assert transfers.negative_contact_weights(grids) is not rows


def tried(transfer, work, outcome="CONVERGED", rows=True, shape="default"):
    """A row of the cycles of a transfer on graded meshes."""
    return {"case": "2D graded", "shape": shape, "transfer": transfer, "contact_rows": rows, "full_work": work,
            "full_cycles": 9.0, "full_outcome": outcome}


def test_work_is_compared_where_both_converged():
    cycles = pd.DataFrame([tried("Interpolation", 10.0), tried("L2", 25.0), tried("PseudoL2", 99.0, "STALLED"),
                           tried("Interpolation", 11.0, rows=False), tried("L2", 7.0, shape="V")])
    over = transfers.over_interpolation(cycles)
    # the monotone method has no interpolation to be compared with
    assert list(zip(over["transfer"], over["ratio"], strict=True)) == [("L2", 2.5), ("Interpolation", 1.1)]
    said = transfers.work_words(cycles, "default")
    assert said.endswith(": L2 2.50; Interpolation without contact rows 1.10. PseudoL2 does not converge.")
    assert transfers.work_words(cycles, "monotone") == ""


def test_the_summary_of_transfers_says_what_was_measured():
    cycles = pd.DataFrame([tried("Interpolation", 10.0), tried("L2", 25.0), tried("PseudoL2", 99.0, "STALLED")])
    kept = pd.DataFrame({"case": "2D graded", "contact_rows": True, "transfer": ["Interpolation", "L2", "PseudoL2"],
                         "build_ratio": [1.0, 30.0, 8.0], "complexity": [1.5, 4.0, 3.0]})
    ratios = pd.DataFrame({"where": "everywhere", "ratio": [2, 4], "rate": [0.1, 0.5], "monotone_rate": [0.5, 0.8]})
    said = transfers.summary(kept, cycles, ratios)
    assert "they take 8 to 30 times as long to build" in said
    assert "complexity 3.0 to 4.0, of interpolation 1.5" in said
    assert "so that work grows by a factor 2.5: interpolation" in said
    assert "from 0.10 at a ratio of 2 to 0.50 at 4, of the monotone one from 0.50 to 0.80" in said


def section_of(module, folder):
    """A quick run: the section, and its tables by name."""
    section = module.run(common.Context(quick=True, out=folder, full=True))
    common.show(section, folder)
    written = {item.name: (folder / f"{item.name}.{'csv' if isinstance(item, common.Table) else 'png'}")
               for item in section.items}
    assert all(path.stat().st_size > 100 for path in written.values())
    return {item.name: item.frame for item in section.items if isinstance(item, common.Table)}


@pytest.mark.slow
def test_transfers(tmp_path):
    tables = section_of(transfers, tmp_path)
    kept = tables["transfer_properties"].set_index(["meshes", "transfer", "contact rows"]).loc["2D graded"]
    lumped = kept.index.get_level_values("transfer") == "LumpedL2"
    assert (kept["affine error"][~lumped] < 1e-4).all()
    assert kept.loc[("Interpolation", True), "affine error"] < 1e-12
    assert kept.loc[("LumpedL2", True), "affine error"] > 1e-2
    assert kept.xs(True, level="contact rows")["proven"].all()
    assert not kept.loc[("PseudoL2", False), "proven"]
    assert (kept.loc[("Interpolation", True), "complexity"] <= kept["complexity"]).all()
    assert (kept["complexity"] <= kept.loc[("L2", True), "complexity"]).all()
    assert kept.loc["Interpolation", "least weight"].min() >= 0
    cycles = tables["transfer_cycles"]
    with_rows = cycles[cycles["contact rows"]]
    assert (with_rows["status"] == "CONVERGED").all()
    assert (with_rows["status, nested start"] == "CONVERGED").all()
    assert (with_rows["work, nested start"] <= with_rows["work from zero"]).all()
    refused = cycles[(cycles["transfer"] == "PseudoL2") & ~cycles["contact rows"] & (cycles["method"] != "default")]
    assert (refused["status"] == "REFUSED").all()
    for _, rows in tables["transfer_mesh_ratio"].groupby("coarser"):
        assert (np.diff(rows["rate"]) > 0).all()
        assert (np.diff(rows["largest ratio"]) > 0).all()
    adapted = tables["transfer_adaptive"]
    assert (adapted["status"] == "CONVERGED").all()
    assert (adapted["work"] < adapted["work, monotone"]).all()
    apart = tables["transfer_size_ratio"]
    assert (np.diff(apart["size ratio"]) > 0).all()
    assert (np.diff(apart["rate"]) > 0).all()
    assert apart["rate"].iloc[0] < 0.6 < apart["rate"].iloc[-1]


@pytest.mark.slow
def test_algebraic_multigrid(tmp_path):
    tables = section_of(amg, tmp_path)
    glued = tables["amg_glued"]
    assert (glued["status"] == "CONVERGED").all()
    by = {name: rows.set_index(["grid", "nodes"]) for name, rows in glued.groupby("method")}
    assert (by["AMG-CG, rigid-body modes"]["iterations"] < by["AMG-CG, constants"]["iterations"]).all()
    assert (glued["energy error"] < 2e-8).all()
    assert "linear solve" in front.linear(tables).text
    contact = tables["amg_contact"]
    assert (contact["status"] == "CONVERGED").all()
    assert (contact["true error"] < 5e-8).all()
    steps = contact.pivot(index=["grid", "nodes"], columns="method", values="steps")
    assert (steps["ActiveSet, AMG, nested"] < steps["ActiveSet, AMG, cold"]).all()
    assert (steps["ActiveSet, direct, nested"] < steps["ActiveSet, direct, cold"]).all()
    assert (contact["inner iterations"].notna() == contact["method"].str.contains("AMG")).all()
