"""Pictures show what they say: the data drawn, the units, the words. How they look is judged by eye."""

from __future__ import annotations

import dataclasses

import matplotlib.pyplot as plt
import numpy as np
import pytest
from made import cube, result_on, square
from made_bodies import two_bodies
from matplotlib.colors import to_rgba
from matplotlib.quiver import Quiver

import adaptmg as am
from adaptmg import plot
from adaptmg.plot.contact_surfaces import lines_of
from adaptmg.plot.posed_problem import curves_of
from adaptmg.plot.style import STATE_COLORS, number, scaled
from adaptmg.plot.surfaces import Surface
from adaptmg.smoother.system import OPEN, SLIP, STICK

PLANE, SOLID = result_on(square(16)), result_on(cube(3))


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def words(figure) -> str:
    """All text of a figure."""
    figure.canvas.draw()
    return "\n".join(t.get_text() for t in figure.findobj(plt.Text) if t.get_text())


def line(ax, label):
    return next(found for found in ax.lines if found.get_label() == label)


def polygon_problem() -> am.ContactProblem:
    domain = am.Polygon(vertices=((0, 0), (2, 0), (2, 1), (1.5, 0.6), (0.5, 0.6), (0, 1)),
                        boundaries=("foot", "side", "s1", "notch", "s2", "left"))
    return am.ContactProblem(
        material=am.PlaneStress(young=1e9, poisson=0.3), law=am.Tresca(2e3), domain=domain, name="a polygon",
        contact=(am.Contact("foot", am.Plane((0, -1e-3), (0, 1))),
                 am.Contact("side", am.GapFunction(lambda x: 0.1 * (x[:, 1] - 0.5) ** 2))),
        loads=(am.Traction("left", (3e5, -2e5)), am.Pressure("notch", lambda x: 4e5 * x[:, 0]),
               am.BodyForce((0, -7e4))),
        supports=(am.Support("s1", x=0, y=-1e-4), am.Support("s2", y=0)))


@pytest.mark.parametrize("name", am.cases.names())
def test_problem_draws_every_case(name):
    posed = am.cases.get(name).function()
    shown = words(plot.problem(posed))
    # several bodies have a legend of bodies and pairs in place of names in the picture
    several = len(posed.domain.bodies) > 1
    wanted = (*posed.domain.bodies, *posed.pair_boundaries) if several else posed.domain.boundaries
    assert posed.name in shown and all(name in shown for name in wanted)


def test_problem_states_loads_supports_law_and_enlarged_gaps():
    shown = words(plot.problem(polygon_problem()))
    for text in ("a polygon", "361 kPa", "up to", "70 kN/m³", "Tresca limit 2 kPa", "$u_y$ = -100 µm", "gap drawn"):
        assert text in shown
    shown = words(plot.problem(am.cases.greco_bar()))
    for text in ("p = 50 MPa", "p = 150 MPa", "Coulomb friction 1", "$u_x$ = 0", "40 mm"):
        assert text in shown
    assert "gap drawn" not in shown


def test_problem_arrows_are_proportional_to_the_tractions():
    figure = plot.problem(am.cases.greco_bar())
    lengths = [np.hypot(q.U, q.V) for q in figure.axes[0].findobj(lambda a: type(a).__name__ == "Quiver")]
    assert sorted(round(float(x[0] / lengths[0][0]), 6) for x in lengths) in ([1.0, 3.0], [round(1 / 3, 6), 1.0])
    assert all(np.ptp(x) < 1e-9 for x in lengths)


def dovetail() -> am.ContactProblem:
    tongue = am.Outline(vertices=((0, 0), (0.02, 0), (0.01, 0.01), (0.01, 0.03), (0, 0.03)),
                        boundaries=("foot", "flank", "neck", "top", "axis"), arcs={1: (0.01, 0)})
    block = am.Rectangle(width=0.03, height=0.02, origin=(0.0, -0.02))
    steel = am.PlaneStrain(young=2e11, poisson=0.3)
    return am.ContactProblem(
        material={"tongue": steel, "block": steel}, law=am.Coulomb(0.2), name="an assembly",
        domain=am.Assembly(parts={"tongue": tongue, "block": block}),
        contact=(am.ContactPair("tongue.foot", "block.top"), am.Contact("block.right", am.Plane((0.0301, 0), (-1, 0)))),
        loads=(am.Pressure("tongue.flank", 1e8), am.BodyForce((0, -7e4), body="block"),
               am.InitialStrain("tongue", (0, -1e-3))),
        supports=(am.Support("block.bottom", y=0), am.Support("tongue.axis", x=0)))


def test_problem_draws_assemblies():
    shown = words(plot.problem(dovetail()))
    for text in ("an assembly", "tongue", "block", "'tongue.foot' on 'block.top'", "Coulomb friction 0.2",
                 "p = 100 MPa", "body force 70 kN/m³ in 'block'", "initial strain in 'tongue'",
                 "$\\varepsilon_y$ = -0.001", "$u_y$ = 0", "30 mm", "gap drawn"):
        assert text in shown
    turned = dataclasses.replace(dovetail(), material=am.Axisymmetric(young=2e11, poisson=0.3))
    shown = words(plot.problem(turned))
    assert "r = 0 to 30 mm" in shown and "$u_z$ = 0" in shown and "$u_r$ = 0" in shown


def test_pressure_on_an_arc_acts_along_its_normal():
    figure = plot.problem(dovetail())
    quivers = figure.axes[0].findobj(Quiver)
    (arc,) = [q for q in quivers if np.ptp(np.degrees(np.arctan2(q.V, q.U))) > 10]
    tips = np.stack([arc.X + arc.U, arc.Y + arc.V], 1) - [10.0, 0.0]
    np.testing.assert_allclose(np.linalg.norm(tips, axis=1), 10.0, rtol=1e-3)
    directions = -np.stack([arc.U, arc.V], 1) / np.hypot(arc.U, arc.V)[:, None]
    np.testing.assert_allclose(directions, tips / np.linalg.norm(tips, axis=1)[:, None], atol=0.03)


def test_curves_follow_their_boundaries():
    outline = dovetail().domain.parts["tongue"]
    curves = curves_of(outline)
    assert set(curves) == set(outline.boundaries) and all(len(found) == 1 for found in curves.values())
    for name, length in zip(outline.boundaries, outline.lengths, strict=True):
        assert curves[name][0].length == pytest.approx(length, rel=1e-3)
    square_curves = curves_of(am.Polygon(vertices=((0, 0), (1, 0), (1, 1), (0, 1)), boundaries=("a", "b", "a", "b")))
    assert [len(found) for found in square_curves.values()] == [2, 2]
    circle = curves_of(am.Outline(vertices=((1, 0), (-0.5, 0.75**0.5), (-0.5, -(0.75**0.5))), boundaries=("rim",) * 3,
                                  arcs={k: (0, 0) for k in range(3)}))
    assert circle["rim"][0].length == pytest.approx(2 * np.pi, rel=1e-3)


def test_problem_draws_solids_on_a_mesh():
    material = {"upper": am.Solid(young=2e11, poisson=0.3), "lower": am.Solid(young=2e11, poisson=0.3)}
    posed = am.ContactProblem(
        material=material, law=am.Frictionless(), contact=am.ContactPair("upper.bottom", "lower.bottom"), name="solids",
        loads=(am.Pressure("upper.rest", 2e7), am.InitialStrain("upper", (0, 0, -1e-3))),
        supports=(am.Support("lower.rest", z=0),))
    shown = words(plot.problem(posed, mesh=two_bodies(3, 4, 3).mesh, explode=0.3))
    for text in ("contact on 'upper.bottom'", "its master 'lower.bottom'", "p = 20 MPa on 'upper.rest'", "lower",
                 "$u_z$ = 0 on 'lower.rest'", "initial strain in 'upper'\n$\\varepsilon_z$ = -0.001",
                 "frictionless contact"):
        assert text in shown
    with pytest.raises(ValueError, match="no domain"):
        plot.problem(posed)
    with pytest.raises(ValueError, match="does not exist"):
        plot.problem(posed, mesh=cube(1))


def test_the_picture_of_a_solid_shows_its_contact_and_where_loads_act():
    posed = am.cases.greco_block()
    (ax,) = plot.problem(posed).axes
    elevation, azimuth = np.radians([ax.elev, ax.azim])
    towards = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    # contact is below, the larger load on the left
    assert towards[2] < 0 and towards[0] < 0
    (surface,) = ax.findobj(Surface)
    # 24 arrows a load: shafts, then the four strokes of the heads
    shafts = surface.lines[1].ends.reshape(2, 5, 24, 2, 3)[:, 0].reshape(-1, 2, 3)
    pressure_of = {"left": (0, 0.0, 1.5e8), "top": (2, 1e3 * posed.domain.upper[2], 5e7)}
    for axis, place, pressure in pressure_of.values():
        mine = np.abs(np.diff(shafts, axis=1)[:, 0, axis]) > 0
        np.testing.assert_allclose(shafts[mine][:, 1, axis], place, atol=1e-9)
        np.testing.assert_allclose(np.abs(np.diff(shafts[mine], axis=1)[:, 0, axis]), 40 / 6 * pressure / 1.5e8)
    assert "'back'" in words(ax.figure) and "left" in words(ax.figure).split("\n")


def test_contact_shades_the_zones_half_way_between_nodes():
    upper = plot.contact(PLANE).axes[0]
    spans = {tuple(np.round(p.get_facecolor(), 6)): p.get_extents().transformed(upper.transData.inverted())
             for p in upper.patches}
    x, state = 1e3 * PLANE.contact.x[:, 0], PLANE.contact.state
    for code in (OPEN, SLIP, STICK):
        span = spans[tuple(np.round(to_rgba(STATE_COLORS[code]), 6))]
        inside = np.flatnonzero(state == code)
        first, last = inside.min(), inside.max()
        assert span.x0 == pytest.approx(0.5 * (x[first] + x[max(first - 1, 0)]), abs=1e-9)
        assert span.x1 == pytest.approx(0.5 * (x[last] + x[min(last + 1, len(x) - 1)]), abs=1e-9)


def test_contact_draws_surfaces_and_bare_problems():
    shown = words(plot.contact(SOLID))
    assert "contact pressure p [MPa]" in shown and "stick (" in shown and "x [mm]" in shown
    assert plot.contact(result_on(None)).axes[2].get_xlabel() == "contact node"
    with pytest.raises(ValueError, match="boundary must be one of 'bottom'"):
        plot.contact(PLANE, boundary="top")


def test_contact_takes_axes():
    figure, axes = plt.subplots(3)
    assert plot.contact(PLANE, axes) is figure
    with pytest.raises(ValueError, match="3 matplotlib axes"):
        plot.contact(PLANE, axes[0])


def test_a_curved_contact_line_is_drawn_against_its_arc_length():
    angle = np.linspace(0, np.pi / 2, 9)
    inner, outer = np.stack([np.cos(angle), np.sin(angle)], 1), 2 * np.stack([np.cos(angle), np.sin(angle)], 1)
    k = np.arange(8)
    elements = np.vstack([np.stack([k, 9 + k, 10 + k], 1), np.stack([k, 10 + k, 1 + k], 1)])
    facets = np.vstack([np.stack([9 + k, 10 + k], 1), np.stack([1 + k, k], 1)[::-1], [[0, 9], [17, 8]]])
    mesh = am.MeshArrays(np.vstack([inner, outer]), elements, facets, [0] * 8 + [1] * 10, ("bottom", "rest"))
    (found,) = lines_of(result_on(mesh), "bottom")
    assert found.label == "arc length from (2, 0) [m]"
    chord = np.linalg.norm(outer[1] - outer[0])
    np.testing.assert_allclose(found.position, chord * np.arange(9))


@pytest.mark.parametrize("result", [PLANE, SOLID], ids=["2D", "3D"])
@pytest.mark.parametrize("displacement", [True, False])
def test_deformation_states_its_amplification(result, displacement):
    shown = words(plot.deformation(result, displacement=displacement))
    largest = np.linalg.norm(result.displacement, axis=1).max()
    factor = float(shown.split("drawn ")[1].split(" times")[0])
    size = np.linalg.norm(np.ptp(result.mesh.points, axis=0))
    assert 0.03 < factor * largest / size < 0.08
    assert ("|u| [µm]" in shown) == displacement
    assert "drawn 7 times" in words(plot.deformation(result, 7.0))


def test_colors_of_the_displacement_are_its_length_at_the_nodes():
    wanted = 1e6 * np.linalg.norm(PLANE.displacement, axis=1)
    ax, bar = plot.deformation(PLANE, displacement=True).axes
    assert bar.get_ylim() == pytest.approx((0, wanted.max()))
    (colored,) = [c for c in ax.collections if c.get_array() is not None]
    np.testing.assert_allclose(colored.get_array(), wanted)


def test_deformation_refuses_what_it_cannot_draw():
    with pytest.raises(ValueError, match="no mesh"):
        plot.deformation(result_on(None))
    with pytest.raises(ValueError, match="no materials"):
        plot.deformation(PLANE, stress=True)
    with pytest.raises(ValueError, match="amplify"):
        plot.deformation(PLANE, float("nan"))
    with pytest.raises(ValueError, match="three-dimensional"):
        plot.deformation(SOLID, ax=plt.subplots()[1])


def test_history_draws_what_was_recorded():
    ax = plot.history(PLANE).axes[0]
    drawn = line(ax, "natural residual (relative)")
    np.testing.assert_array_equal(drawn.get_xdata(), PLANE.history["work_units"])
    np.testing.assert_array_equal(drawn.get_ydata(), PLANE.history["residual"])
    estimate = line(ax, "estimated error (relative, energy norm)")
    np.testing.assert_array_equal(estimate.get_ydata(), PLANE.history["error_estimate"][1:])
    assert ax.get_yscale() == "log" and ax.get_xlabel() == "work units"


def test_history_compares_results_by_a_common_quantity():
    short = result_on(square(4), history={k: v for k, v in PLANE.history.items() if k != "residual"})
    ax = plot.history({"a": PLANE, "b": PLANE}, against="cycle").axes[0]
    assert ax.get_ylabel().startswith("natural residual") and {x.get_label() for x in ax.lines} >= {"a", "b"}
    assert plot.history({"a": PLANE, "b": short}).axes[0].get_ylabel().startswith("estimated error")
    with pytest.raises(ValueError, match="not every result recorded residual"):
        plot.history({"a": PLANE, "b": short}, quantity="residual")
    with pytest.raises(ValueError, match="against"):
        plot.history(PLANE, against="time")
    with pytest.raises(TypeError, match="Result"):
        plot.history({"a": 1})


def test_path_climbs_from_level_to_level():
    ax = plot.path(PLANE, steps=8).axes[0]
    ways = [(found.get_label(), found.get_ydata()) for found in ax.lines if len(found.get_xdata()) == 2
            and found.get_xdata()[1] - found.get_xdata()[0] == 1 and found.get_xdata()[0] >= 0
            and found.get_ydata()[0] != found.get_ydata()[1]]
    assert [tuple(y) for _, y in ways[:6]] == [(0, 1), (1, 0), (0, 1), (1, 2), (2, 1), (1, 0)]
    shown = words(ax.figure)
    assert "first 8 of" in shown and "level 2\n289 nodes" in shown and "restrict residual" in shown
    with pytest.raises(ValueError, match="no way"):
        plot.path(result_on(square(4), path=[]))


def test_meshes_and_grids_are_drawn():
    assert "81 nodes, 128 elements" in words(plot.mesh(square(8), contact=["bottom"]))
    assert "27 nodes" in words(plot.mesh(cube(2)))
    with pytest.raises(TypeError, match="MeshArrays"):
        plot.mesh("bar.msh")
    with pytest.raises(TypeError, match="Hierarchy"):
        plot.grids([square(2)])


def test_grids_draws_each_level_of_a_hierarchy():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    figure = plot.grids(grids)
    assert len(figure.axes) == 2 and "level 1: 25 nodes" in words(figure)
    triangles = figure.axes[1].collections[0].get_paths()
    assert len(triangles) == 32
    bare = am.Hierarchy.single(grids.finest.discrete)
    with pytest.raises(ValueError, match="no mesh"):
        plot.grids(bare)


def test_pyplot_does_not_keep_pictures_and_notebooks_show_them():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    pictures = [plot.problem(grids.problem), plot.grids(grids), plot.contact(PLANE), plot.deformation(SOLID),
                plot.load_history([PLANE] * 2, [1.0, 2.0], {"n": lambda result: 1.0}, steps=0)]
    assert not plt.get_fignums()
    assert all(picture._repr_png_().startswith(b"\x89PNG") for picture in pictures)


def test_pictures_leave_the_settings_of_the_user_alone():
    before = dict(plt.rcParams)
    plot.contact(PLANE)
    assert dict(plt.rcParams) == before


@pytest.mark.parametrize(("value", "unit"), [(4e-3, (1e3, "mm")), (1.0, (1.0, "m")), (2e-7, (1e9, "nm")),
                                             (0.0, (1.0, "m")), (5e3, (1e-3, "km"))])
def test_units_are_chosen_to_read_well(value, unit):
    factor, name = scaled(value, "m")
    assert (pytest.approx(factor), name) == unit


def test_numbers_are_short():
    assert [number(v) for v in (50.0, 0.3, 1234.5, 0.0)] == ["50", "0.3", "1234", "0"]
    assert number(1.5e-7) == r"1.5$\cdot$10$^{-7}$"


def test_an_unknown_picture_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = plot.nothing
