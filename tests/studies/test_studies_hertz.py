"""The study of closed forms: a quick run end to end, what must hold of it, and its measures by hand."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from study_scripts import load

import adaptmg as am

common, hertz = load("common"), load("hertz")


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """A quick run: what is written, and the tables by name."""
    out = tmp_path_factory.mktemp("hertz")
    section = hertz.run(common.Context(True, out))
    common.show(section, out, pictures=False)
    assert section.title and "closed forms" in section.summary
    assert all((out / f"{item.name}.csv").stat().st_size > 100 for item in section.items
               if isinstance(item, common.Table))
    return {item.name: item.frame for item in section.items if isinstance(item, common.Table)}


def test_errors_are_small_and_all_converge(tables):
    frame = tables["hertz_convergence"]
    assert (frame["status"] == "CONVERGED").all() and (frame["natural residual"] < 1e-7).all()
    assert set(frame["case"]) == set(hertz.CASES)
    last = frame[frame["h"] == "a/10"]
    assert (last["p0 error"].abs() < 1).all() and (last["a error"].abs() < 1.5).all() and (last["L2 error"] < 3).all()
    assert frame["work"].max() < 60 and frame["cycles"].max() < 20
    # over mu p0; on the coarse mesh four nodes stick on either side
    traction = tables["hertz_cattaneo"].set_index("h")["traction L2 error"]
    assert traction["a/5"] < 12 and traction["a/10"] < 6
    # no order of two meshes
    assert "hertz_rates" not in tables


def test_two_bodies_cost_little_more_than_one(tables):
    frame = tables["hertz_bodies"]
    nested = frame[frame["start"] == "nested"]
    # 1.40 on the 407 nodes of a quick run, 1.11 to 1.20 on those of a full one
    assert len(nested) and (nested["two over one"] < 1.5).all()
    assert (frame["nodes, two"] / frame["nodes, one"] > 1.9).all()


def test_work_that_another_method_ended_is_told_and_not_compared():
    late = "ActiveSet from cycle 30"
    rows = pd.DataFrame([
        {"solver": solver, "count": count, "fineness": fineness, "nodes": 100 * count, "cycles": 10, "rate": 0.3,
         "work_units": 20.0 * count, "fallback": late * ((solver, count, fineness) == ("zero", 2, 40))}
        for solver in ("full", "zero") for fineness in (20, 40) for count in (1, 2)])
    table = hertz.bodies_table(rows)
    assert table.frame["taken over by, two"].tolist() == ["-", "-", "-", late]
    assert table.frame["two over one"].isna().tolist() == [False] * 3 + [True]
    assert "nested 2.00; zero 2.00. Taken over" in table.note
    plain = hertz.bodies_table(rows.assign(fallback=""))
    assert "Taken over" not in plain.note and "taken over by, two" not in plain.frame


def test_refinement_near_contact_saves_nodes(tables):
    frame = tables["hertz_uniform"].set_index("mesh")
    assert frame.loc["near contact", "nodes"].min() * 5 < frame.loc["uniform", "nodes"].max()
    assert frame.loc["near contact", "L2 error"].min() < frame.loc["uniform", "L2 error"].min()


def test_measures_by_hand():
    x = np.array([-1.2, -0.8, -0.4, 0.0, 0.4, 0.8, 1.2])
    found = {"x": x, "sticks": np.abs(x) < 0.5, "weight": np.full(7, 2.0), "p": np.full(7, 0.1), "exact p": np.zeros(7)}
    np.testing.assert_allclose(hertz.stick_ends(found), [-0.6, 0.6])
    # 7 nodes with an error of .1, 5 of them on the contact
    assert hertz.mean_square(found, "p") == pytest.approx(0.1 * (7 / 5)**0.5)


def test_upper_body_alone():
    problem, meshes = hertz.family("cylinder on block", 10)
    alone = hertz.upper_alone(meshes[0])
    assert alone.n_nodes < meshes[0].n_nodes and set(alone.boundaries) == {"contact", "side", "top", "symmetry"}
    one = hertz.on_a_plane(problem)
    result = am.solve(am.Hierarchy.from_meshes(one, [alone]), am.ActiveSet())
    # half of twice the load
    assert result.resultant("contact").force[1] == pytest.approx(problem.reference["closed_form"].load, rel=1e-9)


def test_families_share_their_meshes():
    first = hertz.family("cylinder on block", 10)[1]
    assert first is hertz.family("cylinder on block", 10)[1]
    row = hertz.converging("cylinder on block", 5, 10, 1e-8)
    assert row["nodes"] == first[1].n_nodes and len(json.loads(row["profile"])["x"]) > 5
