"""am.plot.adaptation: meshes with states, the indicator, and how the error falls, in 2D and 3D."""

from __future__ import annotations

import io

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.colors import LogNorm

import adaptmg as am


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def steps():
    return list(am.adapt(am.cases.dovetail(), 10e-3, engine=am.Bisect(), max_nodes=300))


def test_curves_are_those_of_the_steps(steps):
    figure = am.plot.adaptation(steps)
    by_nodes, by_seconds = figure.axes[4:6] if len(figure.axes) == 6 else figure.axes[-2:]
    for ax, x in ((by_nodes, [s.nodes for s in steps]), (by_seconds, [s.total_seconds for s in steps])):
        line = ax.lines[0]
        np.testing.assert_allclose(line.get_xdata(), x)
        np.testing.assert_allclose(line.get_ydata(), [s.estimate.relative for s in steps])
        assert (ax.get_xscale(), ax.get_yscale()) == ("log", "log")
        assert "estimate" in ax.get_ylabel() and "[-]" in ax.get_ylabel()
    assert by_nodes.get_xlabel() == "nodes" and "[s]" in by_seconds.get_xlabel()


def test_first_and_last_mesh_are_drawn_with_states_and_units(steps):
    figure = am.plot.adaptation(steps)
    titles = [ax.get_title() for ax in figure.axes]
    assert f"step 0: {steps[0].nodes} nodes" in titles and f"step {len(steps) - 1}: {steps[-1].nodes} nodes" in titles
    assert figure.axes[0].get_xlabel() == "x [mm]"
    assert {text.get_text() for text in figure.legends[0].get_texts()} <= {"open", "slip", "stick"}
    elements = len(steps[0].hierarchy.finest.mesh.elements)
    assert any(len(drawn.get_paths()) == elements for drawn in figure.axes[0].collections)


def test_the_map_covers_the_decades_of_the_indicator(steps):
    figure = am.plot.adaptation(steps)
    bars = [ax for ax in figure.axes if ax.get_label() == "<colorbar>"]
    assert len(bars) == 1 and r"\eta_E" in bars[0].get_ylabel()
    parts = np.sqrt(steps[-1].estimate.squares)
    low, high = bars[0].get_ylim()
    assert high == pytest.approx(parts.max()) and low >= 1e-4 * high * 0.99
    assert isinstance(bars[0]._colorbar.norm, LogNorm)


def test_one_step_and_three_dimensions():
    loop = am.adapt(am.cases.greco_block(), 20e-3, engine=am.Bisect(), max_nodes=30)
    figure = am.plot.adaptation([next(loop)])
    figure.savefig(io.BytesIO())
    assert sum(ax.name == "3d" for ax in figure.axes) == 2


@pytest.mark.parametrize("wrong, kind", [([], ValueError), ([1], TypeError), (None, TypeError)])
def test_steps_are_wanted(wrong, kind):
    with pytest.raises(kind, match="steps"):
        am.plot.adaptation(wrong)
