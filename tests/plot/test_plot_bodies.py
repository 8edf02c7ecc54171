"""Pictures of several bodies show the result, body by body and pair by pair."""

import dataclasses

import numpy as np
import pytest
from made import result_on, square
from made_bodies import FACTORS, MATERIALS, QUANTITIES, SOLIDS, steps_of, two_bodies
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from pictures import words

import adaptmg as am
from adaptmg import plot
from adaptmg.discrete.stress import full_stress, von_mises
from adaptmg.plot.contact_surfaces import flattened, lines_of, polylines
from adaptmg.plot.style import STATE_INKS
from adaptmg.plot.surfaces import ShadedSurface
from adaptmg.smoother.system import OPEN, SLIP, STICK
from adaptmg.solver.result import Result


def two_pairs(**changes) -> Result:
    """The two blocks with the left half of the slave surface as one pair and the right half as another."""
    result = two_bodies(**changes)
    mesh = result.mesh
    labels, x = mesh.facet_labels.copy(), mesh.points[mesh.facets].mean(axis=1)[:, 0]
    slave = mesh.boundaries.index("upper.bottom")
    labels[(labels == slave) & (x > 0.02)] = len(mesh.boundaries)
    mesh = dataclasses.replace(mesh, facet_labels=labels, boundaries=(*mesh.boundaries, "upper.right half"))
    contact = dataclasses.replace(result.contact, names=("upper.bottom", "upper.right half"),
                                  masters=("lower.top", ""), boundary=(result.contact.x[:, 0] > 0.02).astype(int))
    return dataclasses.replace(result, mesh=mesh, contact=contact)


PLANE, SOLID = two_bodies(), two_bodies(3, 4, 3)


def test_polylines_use_every_edge_once_and_close_rings():
    ring, other, line = [[1, 2], [0, 1], [2, 0]], [[4, 5], [5, 4]], [[6, 9], [7, 6]]
    assert [one.tolist() for one in polylines(np.array([*ring, *line, *other]))] == [
        [7, 6, 9], [0, 1, 2, 0], [4, 5, 4]]


def test_deformation_draws_each_body_in_a_color_and_names_it():
    figure = plot.deformation(PLANE, amplify=20)
    (ax,) = figure.axes
    moved = 1e3 * (PLANE.mesh.points + 20 * PLANE.displacement)
    (filled,) = [c for c in ax.collections if isinstance(c, PolyCollection)]
    legend = {text.get_text(): patch.get_facecolor() for text, patch in
              zip(ax.get_legend().get_texts(), ax.get_legend().legend_handles, strict=True) if isinstance(patch, Patch)}
    assert list(legend) == ["upper", "lower"] and len(set(legend.values())) == 2
    # the large body first, the small one over it
    drawn, colors, k = np.array([path.vertices[:3] for path in filled.get_paths()]), filled.get_facecolor(), 0
    for body in ("lower", "upper"):
        mine = PLANE.mesh.elements[PLANE.mesh.element_body == PLANE.mesh.bodies.index(body)]
        np.testing.assert_allclose(drawn[k:k + len(mine)], moved[mine], rtol=1e-12)
        assert (colors[k:k + len(mine)] == legend[body]).all()
        k += len(mine)
    assert ax.get_title() == "two blocks: displacement drawn 20 times"
    assert ax.get_xlabel() == "x [mm]" and ax.get_aspect() == 1
    assert "drawn to scale" in words(plot.deformation(PLANE, 1))
    shown = words(plot.deformation(PLANE))
    factor = float(shown.split("drawn ")[1].split(" times")[0])
    largest = np.linalg.norm(PLANE.displacement, axis=1).max()
    assert 0.03 < factor * largest / np.linalg.norm(np.ptp(PLANE.mesh.points, axis=0)) < 0.08


def test_colors_of_the_displacement_are_its_length_at_the_nodes():
    result = result_on(square(16))
    values = 1e6 * np.linalg.norm(result.displacement, axis=1)
    ax, bar = plot.deformation(result, displacement=True).axes
    assert bar.get_ylim() == pytest.approx((0, values.max())) and "|u| [µm]" in words(ax.figure)
    (colored,) = [c for c in ax.collections if c.get_array() is not None]
    np.testing.assert_allclose(colored.get_array(), values)


@pytest.mark.parametrize(("result", "options", "message"), [
    (result_on(None), {}, "no mesh"), (PLANE, {"amplify": float("nan")}, "amplify"),
    (PLANE, {"bodies": ["middle"]}, "must be one of 'upper', 'lower'"),
    (dataclasses.replace(PLANE, stress_data=None), {"stress": True}, "no materials"),
    (SOLID, {"stress": True, "displacement": True}, "two pictures"),
    (SOLID, {"ax": Figure().subplots()}, "three-dimensional")])
def test_deformation_refuses_what_it_cannot_draw(result, options, message):
    with pytest.raises(ValueError, match=message):
        plot.deformation(result, **options)


def test_large_meshes_are_filled_without_lines():
    for result, lines, drawn in ((PLANE, None, True), (PLANE, False, False), (two_bodies(n=70, m=4), None, False)):
        ax = plot.deformation(result, 0, lines=lines).axes[0]
        (filled,) = [c for c in ax.collections if isinstance(c, PolyCollection)]
        assert (not np.array_equal(filled.get_edgecolor(), filled.get_facecolor())) is drawn


def test_chosen_bodies_are_drawn_alone():
    figure = plot.deformation(PLANE, bodies=["upper"])
    shown = words(figure)
    assert "upper" in shown and "lower" not in shown
    drawn = sum(len(c.get_paths()) for c in figure.axes[0].collections if isinstance(c, PolyCollection))
    assert drawn == (PLANE.mesh.element_body == PLANE.mesh.bodies.index("upper")).sum()


def test_states_color_the_slave_surface():
    (ax,) = plot.deformation(PLANE, 10, states=True).axes
    inks = {to_rgba(STATE_INKS[s]): s for s in (OPEN, SLIP, STICK)}
    (drawn,) = [c for c in ax.collections if isinstance(c, LineCollection) and len(c.get_colors()) > 1]
    c = PLANE.contact
    moved = 1e3 * (PLANE.mesh.points + 10 * PLANE.displacement)[c.node]
    state_at = {tuple(np.round(p, 9)): s for p, s in zip(moved, c.state, strict=True)}
    for k, (segment, color) in enumerate(zip(drawn.get_segments(), drawn.get_colors(), strict=True)):
        assert inks[tuple(color)] == state_at[tuple(np.round(segment[k % 2], 9))]
    assert len(drawn.get_segments()) == 2 * (len(c) - 1)
    assert {"open", "slip", "stick"} <= set(words(ax.figure).split("\n"))
    assert "stick" in words(plot.deformation(SOLID, states=True, bodies=["upper"]))


@pytest.mark.parametrize("result", [PLANE, SOLID], ids=["2D", "3D"])
def test_stress_is_that_of_each_body_in_megapascal(result):
    figure = plot.deformation(result, stress=True, states=True)
    stress = von_mises(full_stress(result.mesh, MATERIALS if result.dim == 2 else SOLIDS, result.displacement))
    np.testing.assert_array_equal(result.von_mises(), stress)
    label = f"von Mises stress [MPa], maximum {1e-6 * stress.max():.3g}"
    (bar,) = (ax for ax in figure.axes if ax.get_ylabel() == label)
    assert bar.get_ylim()[1] == pytest.approx(1e-6 * np.quantile(stress, 0.99))
    if result.dim == 3:
        # rubber low, steel high: each facet shows the element behind it
        (surface,) = plot.deformation(result, 0, stress=True).findobj(ShadedSurface)
        lower = surface.corners.mean(axis=1)[:, 2] < -1.0
        assert lower.any() and np.ptp(surface.colors[lower], axis=(0, 1)).max() < 0.05
        assert np.abs(surface.colors[~lower].mean(axis=(0, 1)) - surface.colors[lower].mean(axis=(0, 1))).max() > 0.3


def stated(ax) -> np.ndarray:
    """Points of the curve coloured by state."""
    return np.asarray(next(c for c in ax.collections if isinstance(c, PathCollection)).get_offsets())


def test_contact_draws_pressure_friction_gap_and_slip():
    figure = plot.contact(PLANE)
    c, order = PLANE.contact, np.argsort(PLANE.contact.x[:, 0])
    values = (1e-6 * c.pressure, 1e-6 * c.traction[:, 0], 1e6 * c.gap)
    for ax, wanted in zip(figure.axes, values, strict=True):
        np.testing.assert_allclose(stated(ax)[:, 0], 1e3 * c.x[order, 0])
        np.testing.assert_allclose(stated(ax)[:, 1], wanted[order])
    (slip,) = [drawn for drawn in figure.axes[2].lines if drawn.get_label() == "slip"]
    np.testing.assert_allclose(slip.get_ydata(), 1e6 * c.slip[order, 0])
    (band,) = [b for b in figure.axes[1].collections if isinstance(b, PolyCollection)]
    bound = 1e-6 * (c.limit / c.weights).max()
    assert band.get_paths()[0].get_extents().y0 == pytest.approx(-bound)
    shown = words(figure)
    assert all(text in shown for text in ("'upper.bottom' on 'lower.top'", "pressure p\n[MPa]", "gap, slip\n[µm]"))
    wide = dataclasses.replace(PLANE, contact=dataclasses.replace(c, gap=c.gap + 2e-3))
    assert "gap, slip\n[mm]" in words(plot.contact(wide))
    assert "frictionless" in words(plot.contact(dataclasses.replace(
        PLANE, contact=dataclasses.replace(c, limit=0 * c.limit, force_t=0 * c.force_t))))


def test_contact_draws_each_pair_or_one():
    result = two_pairs()
    assert len(plot.contact(result).axes) == 6
    shown = words(plot.contact(result, boundary="upper.right half"))
    assert "'upper.right half'" in shown and "lower.top" not in shown
    pair = am.ContactPair("upper.bottom", "lower.top")
    assert "lower.top" in words(plot.contact(result, boundary=pair))
    with pytest.raises(ValueError, match=r"boundary must be one of 'upper\.bottom'"):
        plot.contact(result, boundary="lower.top")


def test_a_curved_contact_line_is_drawn_against_its_arc_length():
    angle = np.linspace(0, np.pi / 2, 9)
    inner, outer = np.stack([np.cos(angle), np.sin(angle)], 1), 2 * np.stack([np.cos(angle), np.sin(angle)], 1)
    k = np.arange(8)
    elements = np.vstack([np.stack([k, 9 + k, 10 + k], 1), np.stack([k, 10 + k, 1 + k], 1)])
    facets = np.vstack([np.stack([9 + k, 10 + k], 1), np.stack([1 + k, k], 1)[::-1], [[0, 9], [17, 8]]])
    mesh = am.MeshArrays(np.vstack([inner, outer]), elements, facets, [0] * 8 + [1] * 10, ("bottom", "rest"))
    (only,) = lines_of(result_on(mesh), "bottom")
    assert only.label == "arc length from (2, 0) [m]"
    np.testing.assert_allclose(only.position, np.linalg.norm(outer[1] - outer[0]) * np.arange(9))


def test_parts_without_contact_nodes_interrupt_the_arc():
    result = two_bodies(n=10)
    c = result.contact
    keep = np.ones(len(c), bool)
    keep[4:6] = False
    some = {f.name: getattr(c, f.name)[keep] for f in dataclasses.fields(c)
            if isinstance(getattr(c, f.name), np.ndarray) and len(getattr(c, f.name)) == len(c)}
    first, second = lines_of(dataclasses.replace(result, contact=dataclasses.replace(c, **some)), "upper.bottom")
    np.testing.assert_allclose(first.position, 4.0 * np.arange(4), atol=1e-9)
    np.testing.assert_allclose(second.position, 4.0 * np.arange(6, 11))


def around_a_cylinder(radius: float) -> Result:
    """Contact nodes on the wall of a hole about the line x = 0.1, y = 0.2 along z; pressure falls with z."""
    angle, z = (part.ravel() for part in np.meshgrid(np.arange(-170, 180, 20.0), np.linspace(0.0, 0.03, 5)))
    normal = -np.stack([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0 * angle], 1)
    x = np.array([0.1, 0.2, 0.0]) - radius * normal + np.stack([0 * z, 0 * z, z], 1)
    n = len(x)
    frames = np.stack([normal, np.cross([0, 0, 1.0], normal), np.tile([0, 0, 1.0], (n, 1))], axis=1)
    contact = dataclasses.replace(
        SOLID.contact, node=np.arange(n), x=x, frames=frames, gap=np.zeros(n), u_n=np.zeros(n), u_t=np.zeros((n, 2)),
        slip=np.zeros((n, 2)), force_n=1e3 * z, force_t=np.zeros((n, 2)), weights=np.full(n, 1e-6), limit=np.zeros(n),
        state=np.full(n, 1), boundary=np.zeros(n, int))
    return dataclasses.replace(SOLID, mesh=None, contact=contact)


def test_surfaces_are_drawn_flat_and_a_hole_is_unrolled():
    result = around_a_cylinder(0.015)
    flat = flattened(result, "upper.bottom")
    offset = result.contact.x - [0.1, 0.2, 0]
    np.testing.assert_allclose(flat.points[:, 0], np.degrees(np.arctan2(-offset[:, 1], -offset[:, 0])))
    np.testing.assert_allclose(flat.points[:, 1], 1e3 * offset[:, 2])
    assert flat.labels == ("angle of the normal around z [°]", "z [mm]") and not flat.equal
    # closed everywhere: no scale from 0 to 1
    shown = words(plot.contact(result))
    assert "gap = 0" in shown and "gap [µm]" not in shown
    shown = words(plot.contact(SOLID))
    assert all(text in shown for text in ("'upper.bottom' on 'lower.rest'", "contact pressure p [MPa]", "gap [µm]"))


def test_load_history_draws_quantities_and_pressures():
    steps = steps_of(PLANE)
    figure = plot.load_history(steps, FACTORS, QUANTITIES)
    for ax, (label, function) in zip(figure.axes[:2], QUANTITIES.items(), strict=True):
        assert ax.get_ylabel() == label and ax.get_xlabel() == "load factor"
        np.testing.assert_array_equal(ax.lines[0].get_xdata(), FACTORS)
        np.testing.assert_allclose(ax.lines[0].get_ydata(), [function(step) for step in steps])
    order = np.argsort(PLANE.contact.x[:, 0])
    for ax, step, factor in zip(figure.axes[2:], steps, FACTORS, strict=True):
        np.testing.assert_allclose(stated(ax)[:, 1], 1e-6 * step.contact.pressure[order])
        assert ax.get_title() == f"load factor {factor:g}"
    # as many steps as requested, the first and the last among them
    figure = plot.load_history(steps_of(PLANE), FACTORS, {}, steps=2)
    assert [ax.get_title() for ax in figure.axes] == ["load factor 0.25", "load factor 0.5"]
    assert "2 of 4 steps" in words(figure)
    # the largest pressure is at the third step, where the factors turn
    assert "load factor 1" in words(plot.load_history(steps_of(PLANE), FACTORS, {}, steps=3))
    assert len(plot.load_history(steps_of(PLANE), FACTORS, QUANTITIES, steps=0).axes) == 2
    assert "contact pressure [MPa]" in words(plot.load_history(steps_of(SOLID), FACTORS, QUANTITIES, against="step"))
    assert len(plot.load_history(steps_of(two_pairs()), FACTORS, {}, steps=3).axes) == 6


@pytest.mark.parametrize(("results", "factors", "quantities", "error", "message"), [
    (steps_of(PLANE), FACTORS, {"force": lambda r: np.nan}, ValueError, r"'force'.*step 0 must be finite"),
    ([*steps_of(PLANE)[:3], SOLID], FACTORS, QUANTITIES, ValueError, "same mesh"),
    (steps_of(PLANE), FACTORS, {}, ValueError, "nothing to draw")])
def test_load_history_refuses_what_it_cannot_draw(results, factors, quantities, error, message):
    with pytest.raises(error, match=message):
        plot.load_history(results, factors, quantities, steps=8 if quantities else 0)
