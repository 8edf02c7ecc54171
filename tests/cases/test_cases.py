"""The benchmark cases: reference values, closed forms, and the tables of the paper in data/."""

import pickle
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import adaptmg as am
from adaptmg import cases
from adaptmg.discrete import discretise, full_stress
from adaptmg.mesh import graded, structured
from adaptmg.solver.statics import check_statics

PAPER = Path(__file__).parents[2] / "data" / "paper"
EXACT = am.ActiveSet(rtol=1e-12)


def coarse_mesh(problem):
    """Structured where the domain allows it; else edges of a sixth of each body, finer at contact."""
    parts = problem.domain.parts if isinstance(problem.domain, am.Assembly) else {"": problem.domain}
    if all(isinstance(part, am.Rectangle | am.Box) for part in parts.values()):
        return structured(problem.domain, 4)
    if problem.name == "flat punch":
        return cases.flat_punch_meshes(problem, finest=0.2, levels=1)[0]
    if "Hertz" in str(problem.reference.get("sources")):
        return cases.line_contact_meshes(problem, finest=0.5, levels=1, grading=0.5)[0]
    sizes = {name: float(max(part.upper - part.lower)) / 6 for name, part in parts.items()}
    return graded(problem.domain, sizes.get("", sizes), problem.pair_boundaries, 3)


@pytest.mark.parametrize("name", cases.names())
def test_every_case_discretises_and_stands(name):
    problem = cases.get(name).function()
    discrete = discretise(problem, coarse_mesh(problem))
    check_statics(discrete)
    assert discrete.name.startswith(problem.name) and cases.get(name).description
    pickle.loads(pickle.dumps(problem)).check_boundaries(problem.domain.boundaries)


def test_an_unknown_case_is_refused_with_a_suggestion():
    with pytest.raises(ValueError, match=r"there is no case 'greko_bar' \(did you mean 'greco_bar'\?\); the cases are"):
        cases.get("greko_bar")


@pytest.mark.parametrize(("divisions", "diagonal"), [(2, "left"), (8, "right"), (8, "alternating")])
def test_the_frictionless_bar_is_a_patch_test(divisions, diagonal):
    problem = cases.greco_bar(law=am.Frictionless())
    mesh = structured(problem.domain, divisions, diagonal)
    result = am.solve(discretise(problem, mesh), EXACT)
    assert result.displacement[0, 0] == pytest.approx(4.0615384615e-5, rel=1e-10)
    assert result.displacement[0, 0] == pytest.approx(problem.reference["values"]["exact"]["A"], rel=1e-12)
    stress = full_stress(mesh, problem.material, result.displacement)[:, :2, :2]
    np.testing.assert_allclose(stress, np.broadcast_to(np.diag([-15e7, -5e7]), stress.shape), atol=1e-3)
    # full contact: the pressure everywhere is that on the top
    np.testing.assert_allclose(result.contact.pressure, 5e7, rtol=1e-9)


def test_reference_points_of_the_closed_form():
    problem = cases.greco_bar(law=am.Frictionless(), size=1.0, poisson=0.3, side_pressure=1e7)
    result = am.solve(am.Hierarchy.uniform(problem, divisions=(32,)), EXACT)
    for name, point in problem.reference["points"].items():
        assert result.probe([point])[0, 0] == pytest.approx(problem.reference["values"]["exact"][name], rel=1e-10)


def test_reference_values_belong_to_the_default_parameters():
    reference = cases.greco_bar().reference
    assert reference["values"]["SSNV128"]["E"] == 1.50e-5 and reference["values"]["converged"]["A"] == 2.860321e-5
    for changes in ({"law": am.Coulomb(0.5)}, {"law": am.Tresca(1e7)}, {"law": am.Coulomb(lambda x: x[:, 0])},
                    {"poisson": 0.3}, {"size": 0.05}, {"side_pressure": 1e8}, {"top_pressure": 1e8}, {"young": 2.1e11}):
        assert not cases.greco_bar(**changes).reference
    assert cases.upset_block().reference["exponent"] == 0.781
    assert not cases.upset_block(law=am.Coulomb(0.4)).reference and not cases.upset_block(poisson=0.25).reference
    assert not cases.curved_obstacle(radius=2.0).reference


def test_17_of_33_nodes_touch_the_curved_obstacle():
    problem = cases.curved_obstacle()
    contact = am.solve(am.Hierarchy.uniform(problem, divisions=(32,)), EXACT).contact
    touching = contact.state != am.OPEN
    assert len(contact) == 33 and touching.sum() == problem.reference["touching"][32] == 17
    assert contact.x[touching, 0].min() == pytest.approx(20e-3)  # the right half
    gaps = discretise(cases.curved_obstacle(radius=2.0), structured(problem.domain, 4)).contact.gaps
    np.testing.assert_allclose(gaps, (40e-3 - np.linspace(0, 40e-3, 5))**2 / 4, atol=1e-18)


def test_the_plane_strain_block_has_the_plane_solution():
    problem = cases.greco_block(law=am.Frictionless(), depth=10e-3)
    mesh = structured(problem.domain, 3)
    result = am.solve(discretise(problem, mesh), EXACT)
    corner = np.all(mesh.points[:, [0, 2]] == 0, axis=1)
    np.testing.assert_allclose(result.displacement[corner, 0], problem.reference["values"]["exact"]["A"], rtol=1e-9)
    free = cases.greco_block(plane_strain=False)
    assert [s.boundary for s in free.supports] == ["right", "front"] and not free.reference
    assert cases.greco_block(depth=0.02).reference["points"]["B"] == (1.25e-3, 0.01, 0.0)


def test_tables_of_the_paper_agree_with_each_other_and_with_the_case():
    for file in PAPER.glob("table*.csv"):
        table = pd.read_csv(file, comment="#")
        for printed, seconds in zip(table["printed"], table["seconds"], strict=True):
            hours, _, rest = printed.rpartition("h")
            minutes, _, rest = rest.rpartition("'") if "'" in rest.replace('"', "") else ("", "", rest)
            assert 3600 * int(hours or 0) + 60 * int(minutes or 0) + int(rest.strip('"') or 0) == seconds
    speedup = pd.read_csv(PAPER / "table1_methods.csv", comment="#")
    np.testing.assert_allclose(speedup["speedup"], 43200 / speedup["seconds"], rtol=1e-3)
    assert list(pd.read_csv(PAPER / "table2_smoothing.csv", comment="#")["iterations"]) == [12, 8, 8, 10]
    table = pd.read_csv(PAPER / "greco_reference.csv", comment="#").set_index("point")
    reference = cases.greco_bar().reference
    assert table["ssnv128_m"].to_dict() == reference["values"]["SSNV128"]
    assert table["converged_m"].to_dict() == reference["values"]["converged"]
    assert {name: (x, 0.0) for name, x in table["x_m"].items()} == reference["points"]
