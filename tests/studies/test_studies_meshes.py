"""The studies of meshes, transfers and algebraic multigrid: they run, and what they measure holds."""

import numpy as np
import pandas as pd
import pytest
from study_scripts import load

import adaptmg as am

transfers = load("transfer_operators")
amg = load("amg_comparison")
front = load("front")


def test_constants_of_the_glued_problem_vanish_where_it_is_fixed():
    discrete = amg.grids_of("uniform", 8).finest.discrete
    matrix, load_vector, modes, constants = amg.glued(discrete)
    assert matrix.shape[0] == len(load_vector) == len(modes) == len(constants)
    kept = np.setdiff1d(np.arange(discrete.n_nodes), discrete.contact.nodes)
    fixed = discrete.fixed.reshape(-1, 2)[kept].reshape(-1)
    assert fixed.any() and not constants[fixed].any() and (constants[~fixed].sum(axis=1) == 1).all()


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
    assert table["method"].tolist() == ["first", "second"] and table["total_s"].tolist() == [2.0, 0.0]


def test_negative_contact_weights_are_seen():
    problem, meshes = transfers.posed(2, (5e-3, 2.5e-3), 4)
    for rows in (False, True):
        grids = am.Hierarchy.from_meshes(problem, meshes, am.PseudoL2(), contact_rows=rows)
        assert transfers.negative_contact_weights(grids) is not rows


@pytest.mark.slow
def test_transfers(tables):
    tables = tables("transfer_operators", True)
    kept = tables["transfer_properties"].set_index(["meshes", "transfer", "contact rows"]).loc["2D graded"]
    lumped = kept.index.get_level_values("transfer") == "LumpedL2"
    assert (kept["affine error"][~lumped] < 1e-4).all() and kept.loc[("Interpolation", True), "affine error"] < 1e-12
    assert kept.loc[("LumpedL2", True), "affine error"] > 1e-2 and kept.xs(True, level="contact rows")["proven"].all()
    assert not kept.loc[("PseudoL2", False), "proven"]
    assert (kept.loc[("Interpolation", True), "complexity"] <= kept["complexity"]).all()
    assert (kept["complexity"] <= kept.loc[("L2", True), "complexity"]).all()
    assert kept.loc["Interpolation", "least weight"].min() >= 0
    cycles = tables["transfer_cycles"]
    with_rows = cycles[cycles["contact rows"]]
    assert (with_rows["status"] == "CONVERGED").all() and (with_rows["status, nested start"] == "CONVERGED").all()
    assert (with_rows["work, nested start"] <= with_rows["work from zero"]).all()
    refused = cycles[(cycles["transfer"] == "PseudoL2") & ~cycles["contact rows"] & (cycles["method"] != "default")]
    assert (refused["status"] == "REFUSED").all()
    for _, rows in tables["transfer_mesh_ratio"].groupby("coarser"):
        assert (np.diff(rows["rate"]) > 0).all() and (np.diff(rows["largest ratio"]) > 0).all()
    adapted = tables["transfer_adaptive"]
    assert (adapted["status"] == "CONVERGED").all() and (adapted["work"] < adapted["work, monotone"]).all()
    apart = tables["transfer_size_ratio"]
    assert (np.diff(apart["size ratio"]) > 0).all() and (np.diff(apart["rate"]) > 0).all()
    assert apart["rate"].iloc[0] < 0.6 < apart["rate"].iloc[-1]


@pytest.mark.slow
def test_algebraic_multigrid(tables):
    tables = tables("amg_comparison", True)
    glued = tables["amg_glued"]
    assert (glued["status"] == "CONVERGED").all()
    by = {name: rows.set_index(["grid", "nodes"]) for name, rows in glued.groupby("method")}
    assert (by["AMG-CG, rigid-body modes"]["iterations"] < by["AMG-CG, constants"]["iterations"]).all()
    assert (glued["energy error"] < 2e-8).all() and "linear solve" in front.linear(tables).text
    contact = tables["amg_contact"]
    assert (contact["status"] == "CONVERGED").all() and (contact["true error"] < 5e-8).all()
    steps = contact.pivot(index=["grid", "nodes"], columns="method", values="steps")
    assert (steps["ActiveSet, AMG, nested"] < steps["ActiveSet, AMG, cold"]).all()
    assert (steps["ActiveSet, direct, nested"] < steps["ActiveSet, direct, cold"]).all()
    assert (contact["inner iterations"].notna() == contact["method"].str.contains("AMG")).all()
