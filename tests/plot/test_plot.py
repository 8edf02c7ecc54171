"""Pictures of contact, histories, cycle diagrams, meshes and adaptive loops show the data of their arguments."""

import matplotlib.pyplot as plt
import numpy as np
import pytest
from made import cube, result_on, square
from made_bodies import two_bodies
from matplotlib.colors import LogNorm, to_rgba
from matplotlib.figure import Figure
from pictures import words

import adaptmg as am
from adaptmg import plot
from adaptmg.plot.style import STATE_COLORS
from adaptmg.smoother.system import OPEN, SLIP, STICK

PLANE, SOLID = result_on(square(16)), result_on(cube(3))


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


def test_contact_takes_axes_and_bare_problems():
    assert plot.contact(result_on(None)).axes[2].get_xlabel() == "contact node"
    with pytest.raises(ValueError, match="boundary must be one of 'bottom'"):
        plot.contact(PLANE, boundary="top")
    figure = Figure()
    axes = figure.subplots(3)
    assert plot.contact(PLANE, axes) is figure
    with pytest.raises(ValueError, match="3 matplotlib axes"):
        plot.contact(PLANE, axes[0])


def test_history_draws_what_was_recorded():
    ax = plot.history(PLANE).axes[0]
    drawn = {line.get_label(): line for line in ax.lines}
    residual, estimate = drawn["natural residual (relative)"], drawn["estimated error (relative, energy norm)"]
    np.testing.assert_array_equal(residual.get_xydata().T, [PLANE.history["work_units"], PLANE.history["residual"]])
    np.testing.assert_array_equal(estimate.get_ydata(), PLANE.history["error_estimate"][1:])
    assert ax.get_yscale() == "log" and ax.get_xlabel() == "work units"


def test_history_compares_results_by_a_common_quantity():
    short = result_on(square(4), history={k: v for k, v in PLANE.history.items() if k != "residual"})
    ax = plot.history({"a": PLANE, "b": PLANE}, against="cycle").axes[0]
    assert ax.get_ylabel().startswith("natural residual") and {x.get_label() for x in ax.lines} >= {"a", "b"}
    assert plot.history({"a": PLANE, "b": short}).axes[0].get_ylabel().startswith("estimated error")
    empty = result_on(square(4), history={"cycle": [1], "work_units": [1.0]})
    for arguments, options, error, message in (
            ({"a": PLANE, "b": empty}, {}, ValueError, "in common"),
            (PLANE, {"against": "time"}, ValueError, "against"), ({"a": 1}, {}, TypeError, "Result")):
        with pytest.raises(error, match=message):
            plot.history(arguments, **options)


def test_the_cycle_diagram_climbs_from_level_to_level():
    ax = plot.path(PLANE, steps=11).axes[0]
    assert [tuple(line.get_ydata()) for line in ax.lines] == [(0, 1), (1, 0), (0, 1), (1, 2), (2, 1), (1, 0)]
    shown = words(ax.figure)
    assert "first 11 of" in shown and "level 2\n289 nodes" in shown and "restrict residual" in shown
    with pytest.raises(ValueError, match="no cycles"):
        plot.path(result_on(square(4), path=[]))


def test_meshes_and_the_levels_of_a_hierarchy_are_drawn():
    assert "81 nodes, 128 elements" in words(plot.mesh(square(8), contact=["bottom"]))
    assert "27 nodes" in words(plot.mesh(cube(2)))
    bodies = two_bodies().mesh
    colors = plot.mesh(bodies).axes[0].collections[0].get_facecolor()
    assert sorted(np.unique(colors, axis=0, return_counts=True)[1]) == sorted(np.bincount(bodies.element_body))
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    figure = plot.grids(grids)
    assert len(figure.axes) == 2 and "level 1: 25 nodes" in words(figure)
    assert len(figure.axes[1].collections[0].get_paths()) == 32
    with pytest.raises(ValueError, match="no mesh"):
        plot.grids(am.Hierarchy.single(grids.finest.discrete))
    with pytest.raises(TypeError, match="MeshArrays"):
        plot.mesh("bar.msh")
    with pytest.raises(TypeError, match="Hierarchy"):
        plot.grids([square(2)])
    # pyplot does not keep pictures, and notebooks show them
    assert not plt.get_fignums() and figure._repr_png_().startswith(b"\x89PNG")


def test_adaptation_draws_meshes_states_indicator_and_errors():
    steps = list(am.adapt(am.cases.dovetail(), 10e-3, engine=am.Bisect(), max_nodes=300))
    figure = plot.adaptation(steps)
    by_nodes, by_seconds = (next(ax for ax in figure.axes if ax.get_xlabel().startswith(name))
                            for name in ("nodes", "time"))
    for ax, x in ((by_nodes, [s.nodes for s in steps]), (by_seconds, [s.total_seconds for s in steps])):
        np.testing.assert_allclose(ax.lines[0].get_xdata(), x)
        np.testing.assert_allclose(ax.lines[0].get_ydata(), [s.estimate.relative for s in steps])
        assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log") and "estimate" in ax.get_ylabel()
    titles = [ax.get_title() for ax in figure.axes]
    assert f"step 0: {steps[0].nodes} nodes" in titles and f"step {len(steps) - 1}: {steps[-1].nodes} nodes" in titles
    assert {text.get_text() for text in figure.legends[0].get_texts()} <= {"open", "slip", "stick"}
    elements = len(steps[0].hierarchy.finest.mesh.elements)
    assert any(len(drawn.get_paths()) == elements for drawn in figure.axes[0].collections)
    (bar,) = [ax for ax in figure.axes if ax.get_label() == "<colorbar>"]
    low, high = bar.get_ylim()
    assert high == pytest.approx(np.sqrt(steps[-1].estimate.squares).max()) and low >= 1e-4 * high * 0.99
    assert isinstance(bar._colorbar.norm, LogNorm)
    for wrong, kind in (([], ValueError), ([1], TypeError)):
        with pytest.raises(kind, match="steps"):
            plot.adaptation(wrong)


def test_pictures_leave_the_settings_of_the_user_alone():
    before = dict(plt.rcParams)
    plot.contact(PLANE)
    assert dict(plt.rcParams) == before
