"""Every object describes itself in 400 characters, without arrays; tables name their units."""

import html
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from made import cube, result_on

import adaptmg as am

MOST = 400


@cache
def solved() -> tuple[am.Hierarchy, am.Result]:
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4, 8, 16))
    return grids, am.solve(grids)


@cache
def along() -> am.PathResult:
    return am.solve_path(
        solved()[0].truncated(finest=2), am.LoadPath({"left": np.linspace(0.1, 1, 6), "top": 1.0})
    )


@cache
def adapted() -> tuple[am.Step, ...]:
    grids = am.Hierarchy.uniform(am.cases.upset_block(), divisions=(4,))
    return tuple(am.adapt(grids.problem, grids, engine=am.Bisect(), max_nodes=60))


def ring(n: int) -> list[tuple[float, float]]:
    angles = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return [(float(np.cos(a)), float(np.sin(a))) for a in angles]


def rows(n: int) -> dict[str, int]:
    return {"m": n}


def large(folder: Path) -> list[object]:
    """What holds arrays, functions or many parts."""
    grids, result = solved()
    steel = am.PlaneStrain(young=2e11, poisson=0.3)
    big = am.Polygon(vertices=ring(300), boundaries=[f"edge {k}" for k in range(300)])
    many = am.Assembly(
        parts={
            f"body {k}": am.Rectangle(width=1.0, height=1.0, origin=(2.0 * k, 0.0))
            for k in range(60)
        }
    )
    points, n = np.random.default_rng(0).random((500, 2)), 30
    with pytest.raises(am.NotConverged) as caught:
        am.solve(grids, am.SingleGrid(max_sweeps=2))
    study = am.Study(rows, {"n": list(range(1, 200))}, folder / "s.sqlite")
    estimate = am.GoalEstimate(
        squares=np.ones(9),
        norm=1.0,
        indicator="goal",
        value=1.0,
        signed=0.1,
        names=tuple(f"u_y at {k}" for k in range(n)),
        units=("m",) * n,
        values=np.ones(n),
        errors=np.ones(n),
        algebraic=np.ones(n),
        discretisation=0.1,
        residuals=np.ones(n),
    )
    goal = am.Displacement(points=points, component="y")
    return [
        grids,
        result,
        result.contact,
        result.certificate(),
        grids.finest,
        grids[0],
        grids.finest.mesh,
        grids.finest.discrete,
        grids.finest.discrete.contact,
        grids.finest.discrete.law,
        grids.problem,
        along(),
        *adapted(),
        adapted()[-1].estimate,
        caught.value,
        big,
        many,
        study,
        study.status(),
        goal,
        estimate,
        am.Goal(goal),
        am.Pressure("left", lambda x: x[:, 0]),
        am.GapFunction(lambda x: x[:, 0]),
        am.ContactProblem(
            material=steel,
            domain=many,
            law=am.Coulomb(0.3),
            supports=[am.Support(f"body {k}.left", x=0.0, y=0.0) for k in range(60)],
            contact=[am.ContactPair(f"body {k}.right", f"body {k + 1}.left") for k in range(59)],
        ),
        am.Tresca(np.full(1000, 1e5)),
        am.Coulomb(lambda x: x[:, 0]),
        am.LoadPath({"left": np.linspace(0, 1, 1000)}),
        am.SizeNear(points, size=1e-3, radius=1e-2),
        am.Extrusion(big, 1.0),
        am.Outline(vertices=ring(200), boundaries=["rim"] * 200),
        am.FullMultigrid(
            smoother=am.ProjectedGaussSeidel(omega=1.2),
            max_cycles=7,
            cycle=am.Cycle(pre=3),
            correction=am.Monotone(),
        ),
    ]


def test_what_is_large_describes_itself_briefly(tmp_path):
    for one in large(tmp_path):
        text = repr(one)
        assert len(text) <= MOST and "array(" not in text, text


def test_short_options_read_as_they_are_written():
    for one in (
        am.FullMultigrid(max_cycles=7),
        am.Polygon(vertices=ring(4), boundaries=("a", "b", "c", "d")),
        am.ActiveSet(linear=am.AMG()),
        am.Remesh(growth=2.0),
        am.Displacement(points=(0.0, 1.0), component=0),
    ):
        assert eval(repr(one), {name: getattr(am, name) for name in dir(am)}) == one
    path = eval(repr(am.LoadPath({"left": [0.5, 1.0]})), vars(am))
    np.testing.assert_array_equal(path.of("left"), [0.5, 1.0])


def test_printing_and_notebooks_show_tables_and_pictures():
    grids, result = solved()
    block = am.solve(am.Hierarchy.uniform(am.cases.greco_block(), (1, 2)))
    assert str(along()).count("CONVERGED") == 6 and len(str(grids).splitlines()) == 7
    line = str(adapted()[0])
    assert all(
        word in line for word in ("nodes", "levels", "estimate", "cycles", "work units", " s (")
    )
    for one in (
        grids,
        result,
        along(),
        adapted()[-1],
        result.contact,
        block.contact,
        grids.problem,
        am.Coulomb(lambda x: x[:, 0]),
    ):
        shown = one._repr_html_()
        assert shown.count("<table") == shown.count("</table>") == 1
        # ten columns fit on a page
        assert shown.count("<th>") <= 10 or one is adapted()[-1]
    assert "force_x [N/m]" in result._repr_html_() and "max_nodes" in adapted()[-1]._repr_html_()
    assert repr(grids.problem.loads[0]) in html.unescape(grids.problem._repr_html_())
    assert "equilibrium" in result.certificate()._repr_html_()
    picture = ElementTree.fromstring(grids[1].mesh._repr_svg_())
    path = picture.find("{*}path").get("d")
    assert path.count("M") == 4 * 4 + 2 * 4 * 5  # diagonals, and the lines of the lattice
    assert max(map(float, re.findall(r"[\d.]+", path))) <= min(
        int(picture.get(name)) for name in ("width", "height")
    )
    assert (
        ElementTree.fromstring(cube(2)._repr_svg_()).find("{*}path").get("d").count("M")
        == 6 * (4 + 12) - 24
    )


def test_tables_have_a_row_each_and_units_in_their_heads():
    _, result = solved()
    table, c = result.contact.table(), result.contact
    np.testing.assert_array_equal(table["pressure [Pa]"], c.pressure)
    np.testing.assert_array_equal(table["force_t [N/m]"], c.force_t[:, 0])
    assert (table["state"] == "stick").sum() == (c.state == am.STICK).sum()
    row = result.pairs().iloc[0]
    np.testing.assert_array_equal(
        row[["force_x [N/m]", "force_y [N/m]"]].astype(float), result.resultant().force
    )
    assert row["moment_z [N]"] == result.resultant().moment and row["stick"] == c.counts()["stick"]
    loop = am.Step.table(adapted())
    assert list(loop["nodes"]) == [step.nodes for step in adapted()] and "seconds [s]" in loop


def test_what_has_no_friction_touches_and_does_not_slip():
    grids = solved()[0].truncated(finest=1)
    smooth = am.solve(grids.with_problem(replace(grids.problem, law=am.Frictionless())))
    touching = int(smooth.contact.closed.sum())
    for text in (str(smooth), repr(smooth.contact)):
        assert f"{len(smooth.contact) - touching} open, {touching} touching" in text
        assert "slip" not in text
    membrane = am.solve(am.Hierarchy.graded(am.cases.obstacle_problem(), sizes=(0.4, 0.2)))
    assert re.search(r"\d+ open, \d+ touching\n", str(membrane))
    assert re.search(r"\d+ open, \d+ slip, \d+ stick", str(solved()[1]))


def test_the_way_slipped_adds_up_where_the_load_turns_and_a_path_goes_on():
    grids = solved()[0].truncated(finest=1)
    solver = am.FullMultigrid(rtol=1e-10)
    steps = am.solve_path(grids, am.LoadPath({"left": [0.2, 1.0, 0.0], "top": 1.0}), solver)
    slips = np.array(
        [np.where(one.contact.state == am.OPEN, 0.0, one.contact.slip[:, 0]) for one in steps]
    )
    ways = steps.slip_path()
    np.testing.assert_allclose(ways, np.abs(slips).cumsum(axis=0), rtol=1e-14)
    rest = am.LoadPath({"left": [1.0, 0.0], "top": 1.0})
    later = am.solve_path(grids, rest, solver, start=steps[1])
    np.testing.assert_allclose(later.slip_path(), ways[1:], atol=1e-8 * ways.max())
    assert (ways[-1] > np.abs(slips.sum(axis=0)) + 1e-9).any()
    assert steps.table()["slip_path [m]"].iloc[-1] == ways[-1].max()


def test_work_to_an_error_is_where_it_stays_below():
    error = np.array([np.inf, 1e-1, 1e-3, np.nan, 1e-2, 1e-4, 1e-5])
    result = result_on(
        None,
        history={
            "cycle": np.arange(7),
            "work_units": 10.0 * np.arange(7),
            "error_estimate": error,
            "residual": error,
        },
    )
    assert (
        result.work_to(1.0) == 10.0
        and result.work_to(5e-3) == 50.0
        and result.work_to(1e-5) == 60.0
    )
    assert result.work_to(1e-9, "residual") == np.inf
    with pytest.raises(ValueError, match="of must be one of 'error_estimate', 'residual'"):
        result.work_to(1e-3, "cycle")


def test_what_has_failed_is_not_advised():
    result = am.solve(solved()[0], am.FullMultigrid())
    result = replace(result, status=am.Status.STALLED)
    (bodies,) = (k for k, line in enumerate(result.checked.lines) if line.name == "bodies")
    lines = list(result.checked.lines)
    lines[bodies] = replace(lines[bodies], relative=1e-3)
    for changes, words in (
        ({"solver_name": "FullMultigrid()"}, "take am.ActiveSet"),
        ({"solver_name": "ActiveSet()"}, "take am.FullMultigrid"),
        ({"fallback": "ActiveSet from cycle 9"}, "take another start"),
        ({"checked": replace(result.checked, lines=tuple(lines))}, "no other method changes"),
    ):
        assert words in str(am.NotConverged(replace(result, **changes)))
