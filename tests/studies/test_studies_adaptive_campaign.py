"""The campaign of adaptive loops: it finds nothing wrong where nothing is, and what is wrong where something is."""

import dataclasses

import numpy as np
from study_scripts import load

import adaptmg as am

common = load("common")
problems = load("adaptive_problems")
checks = load("adaptive_checks")
campaign = load("adaptive_campaign")


def test_every_kind_of_problem_can_be_drawn():
    for kind in {*problems.KINDS, "remote"} - {"block"}:
        problem = problems._MAKERS[kind](np.random.default_rng(3))
        assert isinstance(problem, am.ContactProblem)
        quantity = problems.random_quantity(problem, np.random.default_rng(4))
        assert hasattr(quantity, "functionals")


def test_loops_are_measured_stored_and_counted(tmp_path, monkeypatch):
    monkeypatch.setattr(campaign, "FIRST_SEED", 2088)
    monkeypatch.setattr(campaign, "REMOTE", 5011)
    monkeypatch.setattr(campaign, "QUICK_CASES", 1)
    section = campaign.run(common.Context(True, tmp_path))
    summary, rows = (item.frame for item in section.items)
    assert summary["loops"].sum() == 2 and summary["with faults"].sum() == 0 and summary["refused"].sum() == 0
    assert (rows["rate"] > 0.4).all() and rows["why it ended"].str.contains("max_nodes").all()
    assert (summary["left by the solver"].dropna() < 0.2).all()


def test_spoilt_meshes_are_found():
    domain = am.Rectangle(width=1.0, height=1.0)
    mesh = am.mesh.structured(domain, 4)
    assert checks.mesh_faults(mesh, mesh, domain) == [] and abs(checks.smallest_angle(mesh) - 45) < 1e-9
    arc = problems._MAKERS["round"](np.random.default_rng(1)).domain
    bent = am.mesh.graded(arc, 0.01)
    assert checks.mesh_faults(bent, bent, arc) == []
    inside, off = mesh.points.copy(), bent.points.copy()
    inside[0] = [0.1, 0.1]
    off[bent.boundary_nodes("round")[2]] *= 1 + 1e-3
    for words, good, where, change in (
            ("the size", mesh, domain, {"points": inside}), ("off it", bent, arc, {"points": off}),
            ("outside", mesh, domain, {"elements": mesh.elements[1:], "element_body": None}),
            ("names", mesh, domain, {"boundaries": ("a", *mesh.boundaries[1:])})):
        other = dataclasses.replace(good, source=None, **change)
        assert any(words in fault for fault in checks.mesh_faults(other, good, where))


def test_values_are_read_from_results():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), (8,))
    result = am.solve(grids, am.ActiveSet(rtol=1e-12))
    for quantity in (am.Displacement((0.011, 0.013), "x"), am.MeanDisplacement("top", "y"), am.Opening("bottom"),
                     am.ContactForce("bottom", "normal"), am.ContactForce("bottom", "y")):
        wanted = am.Goal(quantity).indicate(grids, result).value
        np.testing.assert_allclose(checks.value_of(quantity, result), wanted, rtol=1e-8)
