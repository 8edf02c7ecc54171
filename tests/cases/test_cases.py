"""The benchmark cases: reference values, closed forms, and the tables of the paper in data/."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.sparse.linalg import spsolve

from adaptmg import cases
from adaptmg.discrete import discretise, full_stress
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.mesh import graded, structured
from adaptmg.problem import Assembly, Box, Coulomb, Frictionless, Rectangle, Tresca
from adaptmg.solver.statics import check_statics

PAPER = Path(__file__).parents[2] / "data" / "paper"


def solve_with(problem: DiscreteProblem, active: np.ndarray) -> np.ndarray:
    """Displacement with the contact nodes of a mask on the obstacle, without friction; a flat bottom."""
    matrix = problem.matrix.tocsc()
    normal = problem.dim * problem.contact.nodes[active] + problem.dim - 1
    held = problem.fixed.copy()
    held[normal] = True
    u = problem.fixed_values.copy()
    u[normal] = -problem.contact.gaps[active]
    free = ~held
    u[free] = spsolve(matrix[free][:, free], (problem.load - matrix @ u)[free])
    return u


def frictionless(problem: DiscreteProblem) -> tuple[np.ndarray, np.ndarray]:
    """Displacement and touching nodes by a plain active-set loop."""
    normal = problem.dim * problem.contact.nodes + problem.dim - 1
    active = np.ones(len(normal), dtype=bool)
    for _ in range(20):
        u = solve_with(problem, active)
        force = (problem.matrix @ u - problem.load)[normal]
        new = np.where(active, force > 0, problem.contact.gaps + u[normal] < 0)
        if (new == active).all():
            return u, active
        active = new
    raise AssertionError("the active set cycles")


def coarse_mesh(problem):
    """Structured where the domain allows it; else edges of a sixth of each body, finer at contact."""
    parts = problem.domain.parts if isinstance(problem.domain, Assembly) else {"": problem.domain}
    if all(isinstance(part, Rectangle | Box) for part in parts.values()):
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
    assert discrete.name.startswith(problem.name)
    pickle.loads(pickle.dumps(problem)).check_boundaries(problem.domain.boundaries)


def test_registry():
    assert "greco_bar" in cases.names() and set(cases.names()) == set(cases.CASES)
    assert all(case.description and "\n" not in case.description for case in cases.CASES.values())
    with pytest.raises(ValueError, match=r"there is no case 'greko_bar' \(did you mean 'greco_bar'\?\); the cases are"):
        cases.get("greko_bar")


class TestGrecoBar:
    @pytest.mark.parametrize(("divisions", "diagonal"), [(2, "left"), (8, "right"), (8, "alternating")])
    def test_frictionless_is_a_patch_test(self, divisions, diagonal):
        problem = cases.greco_bar(law=Frictionless())
        mesh = structured(problem.domain, divisions, diagonal)
        discrete = discretise(problem, mesh)
        u = solve_with(discrete, np.ones(len(discrete.contact), dtype=bool))
        assert u[0] == pytest.approx(4.0615384615e-5, rel=1e-10)
        assert u[0] == pytest.approx(problem.reference["values"]["exact"]["A"], rel=1e-12)
        stress = full_stress(mesh, problem.material, u)[:, :2, :2]
        np.testing.assert_allclose(stress, np.broadcast_to(np.diag([-15e7, -5e7]), stress.shape), atol=1e-3)
        # full contact: the pressure everywhere is that on the top
        force = (discrete.matrix @ u - discrete.load)[2 * discrete.contact.nodes + 1]
        np.testing.assert_allclose(force / discrete.contact.weights, 5e7, rtol=1e-9)

    def test_reference_points_of_the_closed_form(self):
        problem = cases.greco_bar(law=Frictionless(), size=1.0, poisson=0.3, side_pressure=1e7)
        mesh = structured(problem.domain, 32)
        discrete = discretise(problem, mesh)
        u = solve_with(discrete, np.ones(33, dtype=bool)).reshape(-1, 2)
        for name, point in problem.reference["points"].items():
            node = np.argmin(np.linalg.norm(mesh.points - point, axis=1))
            np.testing.assert_allclose(mesh.points[node], point, atol=1e-12)
            assert u[node, 0] == pytest.approx(problem.reference["values"]["exact"][name], rel=1e-10)

    def test_reference_belongs_to_the_default_parameters(self):
        reference = cases.greco_bar().reference
        assert reference["values"]["SSNV128"]["E"] == 1.50e-5
        assert reference["values"]["converged"]["A"] == 2.860321e-5
        assert "2.8 %" in reference["remark"]
        for changes in ({"law": Coulomb(0.5)}, {"law": Tresca(1e7)}, {"law": Coulomb(lambda x: x[:, 0])},
                        {"poisson": 0.3}, {"size": 0.05}, {"side_pressure": 1e8}, {"top_pressure": 1e8},
                        {"young": 2.1e11}):
            assert not cases.greco_bar(**changes).reference


class TestCurvedObstacle:
    def test_17_of_33_nodes_touch(self):
        problem = cases.curved_obstacle()
        discrete = discretise(problem, structured(problem.domain, 32))
        _, active = frictionless(discrete)
        assert len(active) == 33 and active.sum() == problem.reference["touching"][32] == 17
        # they are the right half
        assert discrete.coordinates[discrete.contact.nodes[active], 0].min() == pytest.approx(20e-3)

    def test_gap(self):
        problem = cases.curved_obstacle(radius=2.0)
        gaps = discretise(problem, structured(problem.domain, 4)).contact.gaps
        np.testing.assert_allclose(gaps, (40e-3 - np.linspace(0, 40e-3, 5))**2 / 4, atol=1e-18)
        assert not problem.reference


def test_upset_block():
    problem = cases.upset_block()
    assert problem.reference["exponent"] == 0.781 and problem.law.friction == 0.5
    assert not cases.upset_block(law=Coulomb(0.4)).reference and not cases.upset_block(poisson=0.25).reference
    load = discretise(problem, structured(problem.domain, 4)).load.reshape(-1, 2)
    assert load.sum(axis=0) == pytest.approx([0.0, -5e7 * 40e-3])


class TestGrecoBlock:
    def test_plane_strain_block_has_the_plane_solution(self):
        # in the patch test the solutions agree exactly
        problem = cases.greco_block(law=Frictionless(), depth=10e-3)
        discrete = discretise(problem, structured(problem.domain, 3))
        u = solve_with(discrete, np.ones(len(discrete.contact), dtype=bool)).reshape(-1, 3)
        corner = np.flatnonzero(np.all(discrete.coordinates[:, [0, 2]] == 0, axis=1))
        np.testing.assert_allclose(u[corner, 0], problem.reference["values"]["exact"]["A"], rtol=1e-9)

    def test_free_back(self):
        problem = cases.greco_block(plane_strain=False)
        assert [s.boundary for s in problem.supports] == ["right", "front"] and not problem.reference
        assert cases.greco_block(depth=0.02).reference["points"]["B"] == (1.25e-3, 0.01, 0.0)


class TestPaper:
    def test_printed_times_are_the_seconds(self):
        for file in PAPER.glob("table*.csv"):
            table = pd.read_csv(file, comment="#")
            for printed, seconds in zip(table["printed"], table["seconds"], strict=True):
                hours, _, rest = printed.rpartition("h")
                minutes, _, rest = rest.rpartition("'") if "'" in rest.replace('"', "") else ("", "", rest)
                total = 3600 * int(hours or 0) + 60 * int(minutes or 0) + int(rest.strip('"') or 0)
                assert total == seconds

    def test_reference_values_are_those_of_the_case(self):
        table = pd.read_csv(PAPER / "greco_reference.csv", comment="#").set_index("point")
        reference = cases.greco_bar().reference
        assert table["ssnv128_m"].to_dict() == reference["values"]["SSNV128"]
        assert table["converged_m"].to_dict() == reference["values"]["converged"]
        assert {name: (x, 0.0) for name, x in table["x_m"].items()} == reference["points"]

    def test_tables(self):
        speedup = pd.read_csv(PAPER / "table1_methods.csv", comment="#")
        np.testing.assert_allclose(speedup["speedup"], 43200 / speedup["seconds"], rtol=1e-3)
        assert list(pd.read_csv(PAPER / "table2_smoothing.csv", comment="#")["iterations"]) == [12, 8, 8, 10]
