"""The study of closed forms: a quick run end to end, what must hold of it, and its measures by hand."""

from __future__ import annotations

import numpy as np
import pytest
from study_scripts import load

import adaptmg as am

hertz = load("hertz")


@pytest.mark.slow
def test_a_quick_run(tables):
    tables = tables("hertz")
    # errors are small and all converge
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
    # two bodies cost little more than one
    frame = tables["hertz_bodies"]
    nested = frame[frame["start"] == "nested"]
    # 1.40 on the 407 nodes of a quick run, 1.11 to 1.20 on those of a full one
    assert len(nested) and (nested["two over one"] < 1.5).all()
    assert (frame["nodes, two"] / frame["nodes, one"] > 1.9).all()
    # refinement near contact saves nodes
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
