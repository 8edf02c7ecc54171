"""am.plot.problem: boundaries, loads, gaps and names of the problem that is posed."""

import dataclasses

import numpy as np
import pytest
from made import cube
from made_bodies import two_bodies, two_solids
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from pictures import words

import adaptmg as am
from adaptmg.plot.surfaces import ShadedSurface

STEEL = {"young": 2e11, "poisson": 0.3}


def polygon_problem() -> am.ContactProblem:
    domain = am.Polygon(
        vertices=((0, 0), (2, 0), (2, 1), (1.5, 0.6), (0.5, 0.6), (0, 1)),
        boundaries=("foot", "side", "s1", "notch", "s2", "left"),
    )
    return am.ContactProblem(
        material=am.PlaneStress(young=1e9, poisson=0.3),
        law=am.Tresca(2e3),
        domain=domain,
        name="a polygon",
        contact=(
            am.Contact("foot", am.Plane((0, -1e-3), (0, 1))),
            am.Contact("side", am.GapFunction(lambda x: 0.1 * (x[:, 1] - 0.5) ** 2)),
        ),
        loads=(
            am.Traction("left", (3e5, -2e5)),
            am.Pressure("notch", lambda x: 4e5 * x[:, 0]),
            am.BodyForce((0, -7e4)),
        ),
        supports=(am.Support("s1", x=0, y=-1e-4), am.Support("s2", y=0)),
    )


def assembly() -> am.ContactProblem:
    tongue = am.Outline(
        vertices=((0, 0), (0.02, 0), (0.01, 0.01), (0.01, 0.03), (0, 0.03)),
        boundaries=("foot", "flank", "neck", "top", "axis"),
        arcs={1: (0.01, 0)},
    )
    block, steel = (
        am.Rectangle(width=0.03, height=0.02, origin=(0.0, -0.02)),
        am.PlaneStrain(**STEEL),
    )
    return am.ContactProblem(
        material={"tongue": steel, "block": steel},
        law=am.Coulomb(0.2),
        name="an assembly",
        domain=am.Assembly(parts={"tongue": tongue, "block": block}),
        contact=(
            am.ContactPair("tongue.foot", "block.top"),
            am.Contact("block.right", am.Plane((0.0301, 0), (-1, 0))),
        ),
        loads=(
            am.Pressure("tongue.flank", 1e8),
            am.BodyForce((0, -7e4), body="block"),
            am.InitialStrain("tongue", (0, -1e-3)),
        ),
        supports=(am.Support("block.bottom", y=0), am.Support("tongue.axis", x=0)),
    )


@pytest.mark.parametrize(
    "name", ["hertz_sphere", "coulomb_transition", "dovetail", "leaning_strut"]
)
def test_cases_are_drawn_with_the_names_of_their_boundaries(name):
    posed = am.cases.get(name).function()
    shown = words(am.plot.problem(posed))
    several = len(posed.domain.bodies) > 1
    expected = (
        (*posed.domain.bodies, *posed.pair_boundaries) if several else posed.domain.boundaries
    )
    assert posed.name in shown and all(name in shown for name in expected)


@pytest.mark.parametrize(
    ("posed", "expected"),
    [
        (
            polygon_problem(),
            (
                "a polygon",
                "|t| = 361 kPa on 'left'",
                "p up to",
                "body force (0, -70) kN/m³",
                "Tresca limit 2 kPa",
                "$u_x$ = 0, $u_y$ = -100 µm on 's1'",
                "gap drawn",
            ),
        ),
        (
            am.cases.greco_bar(),
            ("p = 50 MPa", "p = 150 MPa", "Coulomb friction 1", "$u_x$ = 0", "x [mm]"),
        ),
        (
            assembly(),
            (
                "tongue",
                "block",
                "contact on 'tongue.foot'",
                "its master 'block.top'",
                "Coulomb friction 0.2",
                "p = 100 MPa",
                "body force (0, -70) kN/m³ in 'block'",
                "initial strain in 'tongue'",
                "$\\varepsilon_y$ = -0.001",
                "$u_y$ = 0",
                "gap drawn",
            ),
        ),
        (
            dataclasses.replace(assembly(), material=am.Axisymmetric(**STEEL)),
            ("r [mm]", "z [mm]", "$u_z$ = 0", "$u_r$ = 0"),
        ),
    ],
    ids=["polygon", "bar", "assembly", "axisymmetric"],
)
def test_the_legend_states_law_supports_loads_and_enlarged_gaps(posed, expected):
    shown = words(am.plot.problem(posed))
    assert [text for text in expected if text not in shown] == []
    assert ("gap drawn" in shown) == any("gap" in text for text in expected) or posed.axisymmetric


def test_loads_that_are_zero_are_not_drawn():
    figure = am.plot.problem(am.cases.greco_bar(top_pressure=0.0))
    assert len(figure.axes[0].findobj(Quiver)[0].U) and "p = 0" not in words(figure)
    assert "free: 'top'" in words(figure)
    material = am.Solid(**STEEL)
    shown = words(
        am.plot.problem(
            am.ContactProblem(domain=am.Box(width=1, depth=1, height=2), material=material)
        )
    )
    assert "frictionless" not in shown and all(
        name in shown for name in ("'bottom'", "'left'", "'back'", "'top'")
    )


def test_a_picture_in_a_subfigure_returns_the_whole_figure():
    figure = Figure()
    upper, _ = figure.subfigures(2, 1)
    assert am.plot.problem(am.cases.greco_bar(), upper.subplots()) is figure


def test_arrows_are_proportional_to_tractions_and_end_at_bodies():
    quivers = am.plot.problem(am.cases.greco_bar()).axes[0].findobj(Quiver)
    lengths = [np.hypot(q.U, q.V) for q in quivers]
    assert all(np.ptp(x) < 1e-9 for x in lengths)
    assert float(lengths[1][0] / lengths[0][0]) == pytest.approx(3.0)
    arc = am.plot.problem(assembly()).axes[0].findobj(Quiver)[0]
    # the pressure on an arc acts along its normals
    tips = np.stack([arc.X + arc.U, arc.Y + arc.V], 1) - [10.0, 0.0]
    np.testing.assert_allclose(np.linalg.norm(tips, axis=1), 10.0, rtol=1e-3)
    directions = -np.stack([arc.U, arc.V], 1) / np.hypot(arc.U, arc.V)[:, None]
    np.testing.assert_allclose(directions, tips / np.linalg.norm(tips, axis=1)[:, None], atol=0.03)


def test_solids_are_drawn_on_a_mesh():
    posed = two_solids()
    shown = words(am.plot.problem(posed, mesh=two_bodies(3, 4, 3).mesh))
    assert all(
        text in shown
        for text in (
            "contact on 'upper.bottom'",
            "its master 'lower.bottom'",
            "p = 20 MPa on 'upper.rest'",
            "frictionless contact",
            "$u_z$ = 0 on 'lower.rest'",
            "initial strain in 'upper'\n$\\varepsilon_z$ = -0.001",
        )
    )
    # parts of arrows behind a body are pale
    (surface,) = am.plot.problem(posed, mesh=two_bodies(3, 4, 3).mesh).findobj(ShadedSurface)
    assert {line.hidden is None for line in surface.lines} == {True, False}
    with pytest.raises(ValueError, match="no domain"):
        am.plot.problem(posed)
    with pytest.raises(ValueError, match="does not exist"):
        am.plot.problem(posed, mesh=cube(1))


def test_the_picture_of_a_solid_shows_contact_and_loads():
    posed = am.cases.greco_block()
    (ax,) = am.plot.problem(posed).axes
    elevation, azimuth = np.radians([ax.elev, ax.azim])
    # contact is below, the larger load on the left
    assert np.sin(elevation) < 0 and np.cos(elevation) * np.cos(azimuth) < 0
    (surface,) = ax.findobj(ShadedSurface)
    # 24 arrows a load: shafts, then the four strokes of the heads
    shafts = surface.lines[1].ends.reshape(2, 5, 24, 2, 3)[:, 0].reshape(-1, 2, 3)
    for axis, place, pressure in ((0, 0.0, 1.5e8), (2, 1e3 * posed.domain.upper[2], 5e7)):
        mine = np.abs(np.diff(shafts, axis=1)[:, 0, axis]) > 0
        np.testing.assert_allclose(shafts[mine][:, 1, axis], place, atol=1e-9)
        np.testing.assert_allclose(
            np.abs(np.diff(shafts[mine], axis=1)[:, 0, axis]), 40 / 6 * pressure / 1.5e8
        )
    assert "'back'" in words(ax.figure) and "left" in words(ax.figure).split("\n")
