"""The benchmark cases: reference values, the tables of the paper in data/, closed forms and balance
of forces."""

import pickle
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from bodies import assert_balanced
from hertz_meshes import contact_meshes, pressure_fit
from refused import refused
from saddle import Parts

import adaptmg as am
from adaptmg import cases

PAPER = Path(__file__).parents[2] / "data" / "paper"
# below 1e-11 the small weights of nodes at an axis of revolution leave rounding
EXACT, MULTIGRID = am.ActiveSet(rtol=1e-11), am.FullMultigrid(rtol=1e-10)


@pytest.mark.parametrize("name", [*cases.CASES, *cases.FROM_PYTHON])
def test_every_case_is_described_and_pickled(name):
    """That every case is solved and adapted: test_cli."""
    problem = pickle.loads(pickle.dumps(cases.get(name).function()))
    if isinstance(problem, am.ContactProblem):
        problem.check_boundaries(problem.domain.boundaries)
    assert cases.get(name).description


@pytest.mark.parametrize("divisions", [2, 8])
def test_the_frictionless_bar_is_a_patch_test(divisions):
    problem = cases.greco_bar(law=am.Frictionless())
    result = am.solve(am.Hierarchy.uniform(problem, (divisions,)), EXACT)
    points, values = problem.reference["points"], problem.reference["values"]["exact"]
    assert result.displacement[0, 0] == pytest.approx(4.0615384615e-5, rel=1e-10)
    assert result.probe(list(points.values()))[:, 0] == pytest.approx(
        [values[name] for name in points], rel=1e-10
    )
    stress = am.discrete.full_stress(result.mesh, problem.material, result.displacement)[:, :2, :2]
    np.testing.assert_allclose(
        stress, np.broadcast_to(np.diag([-15e7, -5e7]), stress.shape), atol=1e-3
    )
    # full contact: the pressure everywhere is that on the top
    np.testing.assert_allclose(result.contact.pressure, 5e7, rtol=1e-9)


def test_reference_values_belong_to_the_default_parameters():
    reference = cases.greco_bar().reference
    assert (
        reference["values"]["SSNV128"]["E"] == 1.50e-5
        and reference["values"]["converged"]["A"] == 2.860321e-5
    )
    for changes in (
        {"law": am.Coulomb(0.5)},
        {"law": am.Tresca(1e7)},
        {"law": am.Coulomb(lambda x: x[:, 0])},
        {"poisson": 0.3},
        {"size": 0.05},
        {"side_pressure": 1e8},
        {"top_pressure": 1e8},
        {"young": 2.1e11},
    ):
        assert not cases.greco_bar(**changes).reference
    assert cases.upset_block().reference["exponent"] == pytest.approx(0.781, abs=5e-4)
    # tables of the clamped-free corner, as at .2
    stiff = cases.upset_block(poisson=0.3)
    assert stiff.reference["exponent"] == pytest.approx(0.711, abs=5e-4)
    # by Williams' Airy functions r^(lambda+1) F(angle): the foot needs friction .2124 and .5030
    for friction, poisson, sticks in ((0.2, 0.2, False), (0.22, 0.2, True), (0.5, 0.499, False)):
        block = cases.upset_block(law=am.Coulomb(friction), poisson=poisson)
        assert bool(block.reference) == sticks
    assert not cases.curved_obstacle(radius=2.0).reference


def test_17_of_33_nodes_touch_the_curved_obstacle():
    problem = cases.curved_obstacle()
    contact = am.solve(am.Hierarchy.uniform(problem, divisions=(32,)), EXACT).contact
    touching = contact.state != am.OPEN
    assert len(contact) == 33 and touching.sum() == problem.reference["touching"][32] == 17
    assert contact.x[touching, 0].min() == pytest.approx(20e-3)  # the right half
    gaps = am.discretise(
        cases.curved_obstacle(radius=2.0), am.mesh.structured(problem.domain, 4)
    ).contact.gaps
    np.testing.assert_allclose(gaps, (40e-3 - np.linspace(0, 40e-3, 5)) ** 2 / 4, atol=1e-18)


def test_the_plane_strain_block_has_the_plane_solution():
    problem = cases.greco_block(law=am.Frictionless(), depth=10e-3)
    mesh = am.mesh.structured(problem.domain, 3)
    result = am.solve(am.discretise(problem, mesh), EXACT)
    corner = np.all(mesh.points[:, [0, 2]] == 0, axis=1)
    np.testing.assert_allclose(
        result.displacement[corner, 0], problem.reference["values"]["exact"]["A"], rtol=1e-9
    )
    free = cases.greco_block(plane_strain=False)
    assert [s.boundary for s in free.supports] == ["right", "front"] and not free.reference
    assert cases.greco_block(depth=0.02).reference["points"]["B"] == (1.25e-3, 0.01, 0.0)


def test_tables_of_the_paper_agree_with_the_case():
    for file in PAPER.glob("table*.csv"):
        table = pd.read_csv(file, comment="#")
        for printed, seconds in zip(table["printed"], table["seconds"], strict=True):
            hours, _, rest = printed.rpartition("h")
            minutes, _, rest = (
                rest.rpartition("'") if "'" in rest.replace('"', "") else ("", "", rest)
            )
            assert (
                3600 * int(hours or 0) + 60 * int(minutes or 0) + int(rest.strip('"') or 0)
                == seconds
            )
    speedup = pd.read_csv(PAPER / "table1_methods.csv", comment="#")
    np.testing.assert_allclose(speedup["speedup"], 43200 / speedup["seconds"], rtol=1e-3)
    assert list(pd.read_csv(PAPER / "table2_smoothing.csv", comment="#")["iterations"]) == [
        12,
        8,
        8,
        10,
    ]
    table = pd.read_csv(PAPER / "greco_reference.csv", comment="#").set_index("point")
    reference = cases.greco_bar().reference
    assert table["ssnv128_m"].to_dict() == reference["values"]["SSNV128"]
    assert table["converged_m"].to_dict() == reference["values"]["converged"]
    assert {name: (x, 0.0) for name, x in table["x_m"].items()} == reference["points"]


# -- closed forms ----------------------------------------------------------------------------------------------------


def solved(problem, meshes):
    """By the active set method; multigrid, where there are several meshes, must agree."""
    grids = am.Hierarchy.from_meshes(problem, meshes)
    exact = am.solve(grids, EXACT)
    assert_balanced(exact, Parts.of(problem, exact.mesh), 1e-9, flat=False)
    if len(meshes) > 1:
        result = am.solve(grids, MULTIGRID)
        assert_balanced(result, Parts.of(problem, result.mesh), 1e-7, flat=False)
        size = np.abs(exact.displacement).max()
        np.testing.assert_allclose(
            result.displacement, exact.displacement, rtol=0, atol=1e-8 * size
        )
        assert result.work_units < 60
    return exact


@pytest.mark.parametrize(
    ("options", "cells", "matching"),
    [
        ({}, 4, False),
        ({}, 4, True),
        ({"slope": 15.0}, 4, False),
        ({"dim": 3}, 3, False),
        ({"slope": 20.0, "law": am.Frictionless(), "side_pressure": 1e8}, 4, False),
        ({"slope": 10.0, "law": am.Tresca(2e7)}, 5, False),
        ({"dim": 3, "slope": 15.0}, 2, False),
    ],
    ids=str,
)
def test_patch_uniform(options, cells, matching):
    problem = cases.two_block_patch(**options)
    other = cells if matching else cells + 1 + cells // 3
    if "slope" in options:
        mesh = am.mesh.graded(problem.domain, {"upper": 0.1 / cells, "lower": 0.1 / other})
    else:
        mesh = am.mesh.structured(problem.domain, {"upper": cells, "lower": other})
    result = am.solve(am.Hierarchy.from_meshes(problem, [mesh]), EXACT)
    pressure, traction = problem.reference["pressure"], problem.reference["traction"]
    np.testing.assert_allclose(result.contact.pressure, pressure, rtol=1e-10)
    np.testing.assert_allclose(
        np.linalg.norm(result.contact.traction, axis=1), traction, atol=1e-10 * pressure
    )
    assert_balanced(result, Parts.of(problem, result.mesh), 1e-9, flat=False)
    counts = {len(mesh.boundary_nodes(name)) for name in problem.pair_boundaries}
    assert (len(counts) == 1) is matching


@pytest.mark.parametrize(
    ("case", "options"),
    [
        (cases.hertz_cylinder, {}),
        (cases.hertz_cylinder, {"lower_radius": 40e-3}),
        (cases.hertz_sphere, {}),
        (cases.hertz_sphere, {"lower_radius": 50e-3}),
    ],
    ids=["cylinder on block", "two cylinders", "ball on block", "two balls"],
)
def test_hertz_closed_form(case, options):
    problem = case(**options)
    ball = case is cases.hertz_sphere
    h = 1 / 20
    result = solved(problem, contact_meshes(problem, h, 3, 0.12))
    form, x = problem.reference["closed_form"], result.contact.x[:, 0]
    touching = result.contact.pressure > 1e-6 * form.peak
    last, first = np.array([x[touching].max(), x[~touching].min()]) / form.half_width
    # contact ends between a touching and an open node, one edge of at most 1.5 h apart
    assert 1 - 1.5 * h < last < first < 1 + 1.5 * h
    fitted = pressure_fit(x, result.contact.pressure, form.half_width)
    np.testing.assert_allclose(np.array(fitted) / [form.half_width, form.peak], 1, atol=0.01)
    # the nodes at the axis carry half a hat, of an axisymmetric body hardly any area: their
    # pressure is noisy
    away = (x > 2 * h * form.half_width) & (x < 0.95 * form.half_width)
    np.testing.assert_allclose(
        result.contact.pressure[away] / form.peak, form.pressure(x[away]) / form.peak, atol=0.02
    )
    carried = form.load if ball else 0.5 * form.load
    if ball:
        approach = problem.reference["approach"]
        assert 4 / 3 * form.modulus * form.radius**0.5 * approach**1.5 == pytest.approx(form.load)
    assert result.resultant("upper.contact").force[1] == pytest.approx(carried, rel=1e-9)


def test_hertz_ball_in_3d():
    # h = a/4: pressures of single nodes scatter by a fifth; the fit through all that touch holds
    # closer
    h = 1 / 4
    problem = cases.hertz_sphere(dim=3)
    result = solved(problem, contact_meshes(problem, h, 1, 0.4))
    form, pressure = problem.reference["closed_form"], result.contact.pressure
    r = np.linalg.norm(result.contact.x[:, :2], axis=1)
    a, peak = pressure_fit(r, pressure, form.half_width, share=1.0)
    assert a / form.half_width == pytest.approx(1, abs=0.06) and peak / form.peak == pytest.approx(
        1, abs=0.08
    )
    touching = pressure > 1e-6 * form.peak
    assert (
        1 - h
        < r[touching].max() / form.half_width
        < r[~touching].min() / form.half_width + h
        < 1 + 2 * h
    )
    # the flat top is a polygon of a slightly smaller area than the circle
    assert 4 * result.resultant("upper.contact").force[2] == pytest.approx(form.load, rel=0.02)


def test_cattaneo_partial_slip():
    problem = cases.cattaneo()
    assert "stick" not in cases.cattaneo(law=am.Coulomb(lambda x: 0.3 + x[:, 0])).reference
    h = 1 / 20
    grids = am.Hierarchy.from_meshes(problem, contact_meshes(problem, h, 2, 0.12))
    path = am.solve_path(grids, am.LoadPath({"lower.bottom": 1.0, "upper.top": [0.0, 1.0]}), EXACT)
    result, form = path[-1], problem.reference["partial_slip"]
    a, contact = form.normal.half_width, result.contact
    # one step under both loads ends in the same state
    at_once = am.solve(grids, MULTIGRID)
    size = np.abs(result.displacement).max()
    np.testing.assert_allclose(at_once.displacement, result.displacement, rtol=0, atol=1e-8 * size)
    assert_balanced(result, Parts.of(problem, result.mesh), 1e-9, flat=False)
    assert_balanced(at_once, Parts.of(problem, at_once.mesh), 1e-7, flat=False)
    np.testing.assert_allclose(result.resultant("upper.contact").force, [-1.5e4, 1e5], rtol=1e-9)
    np.testing.assert_allclose(path[0].resultant("upper.contact").force, [0, 1e5], atol=1e-4)

    x = contact.x[:, 0]
    fitted = pressure_fit(x, contact.pressure, a)
    np.testing.assert_allclose(np.array(fitted) / [a, form.normal.peak], 1, atol=0.01)
    stick = x[contact.state == am.STICK]
    # half the width: from the outermost nodes that stick, which lie within one edge of where
    # sticking ends
    assert abs(0.5 * np.ptp(stick) - form.stick) < 1.2 * h * a
    away = np.minimum(abs(abs(x) - form.stick), abs(abs(x) - a)) > 2 * h * a
    bound = form.friction * form.normal.peak
    np.testing.assert_allclose(
        -contact.traction[away, 0] / bound, form.traction(x[away]) / bound, atol=0.02
    )


def test_flat_punch():
    problem = cases.flat_punch()
    a = problem.reference["half_width"]
    near = [am.SizeNear([(a, 0.0)], size=h * a, grading=16 * h) for h in (1 / 50, 1 / 100, 1 / 200)]
    result = solved(
        problem, [am.mesh.sized(problem.domain, size, 26 * size.grading * a) for size in near]
    )
    contact = result.contact
    x = contact.x[:, 0]
    assert (contact.force_n > 0).all()
    closed = problem.reference["pressure"]
    for share, bound in ((0.8, 0.01), (0.95, 0.025)):
        inside = x < share * a
        np.testing.assert_allclose(contact.pressure[inside], closed(x[inside]), rtol=bound)
    assert contact.pressure.max() > 5 * closed(0.0)
    assert result.resultant("contact").force[1] == pytest.approx(-5e5, rel=1e-9)


@pytest.mark.parametrize("angle", [0.0, 26.5])
def test_incline_holds(angle):
    problem = cases.incline(angle=angle)
    assert (
        problem.reference["holds"]
        and cases.incline(angle=np.degrees(np.arctan(0.5)) - 1e-9).reference["holds"]
    )
    assert not cases.incline(angle=26.6).reference["holds"]
    result = solved(problem, [am.mesh.graded(problem.domain, 10e-3, problem.pair_boundaries, 2)])
    force = result.resultant("block.bottom").force
    np.testing.assert_allclose(force, [0, problem.reference["weight"]], atol=1e-9 * force[1])
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    assert force @ [-s, c] == pytest.approx(problem.reference["force_n"], rel=1e-9)
    assert force @ [c, s] == pytest.approx(problem.reference["force_t"], rel=1e-9, abs=1e-9)


test_refused = refused(
    (
        lambda: cases.get("greko_bar"),
        r"there is no case 'greko_bar' \(did you mean 'greco_bar'\?\); the cases are",
    ),
    *(
        (
            lambda solver=solver: am.solve(
                am.Hierarchy.graded(cases.incline(angle=26.6), (10e-3,), 2), solver
            ),
            r"nothing holds a translation along .* of body 'block'",
        )
        for solver in (EXACT, MULTIGRID)
    ),
    (lambda: cases.hertz_cylinder(load=1e9), "more than a tenth of the radius 0.05 m"),
    (lambda: cases.hertz_cylinder(lower_radius=1e-3), "more than a tenth of the radius 0.001 m"),
    (lambda: cases.hertz_sphere(load=1e6), "Hertz does not hold there"),
    (lambda: cases.cattaneo(tangential=3e4), "the cylinder slides off"),
    (lambda: cases.incline(angle=90), "angle must be below 90"),
    (lambda: cases.incline(angle=70), "tips over"),
    (lambda: cases.two_block_patch(slope=40), "slope must be at most 30"),
    (lambda: cases.two_block_patch(slope=15, law=am.Frictionless()), "the law allows 0 Pa"),
    (lambda: cases.two_block_patch(slope=15, law=am.Coulomb(0.2)), "tangential traction of 2.5e"),
)
