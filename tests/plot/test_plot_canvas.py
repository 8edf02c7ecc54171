"""Nothing leaves the canvas, and no title or label covers another, in every kind of picture."""

import io
from itertools import combinations

import matplotlib.image
import numpy as np
import pytest
from made import result_on, square
from made_bodies import FACTORS, QUANTITIES, steps_of, two_bodies, two_solids
from matplotlib.figure import Figure
from matplotlib.text import Text

import adaptmg as am
from adaptmg import plot

PLANE, SOLID = two_bodies(), two_bodies(3, 4, 3)
def adapted(case: am.ContactProblem, size: float, nodes: int) -> list[am.Step]:
    return list(am.adapt(case, size, engine=am.Bisect(), max_nodes=nodes))


def turned(figure: Figure) -> Figure:
    figure.axes[0].view_init(-20, 30)
    return figure


PICTURES = {
    "problem 2D": lambda: plot.problem(am.cases.incline()),
    "problem 3D": lambda: plot.problem(two_solids(), mesh=SOLID.mesh),
    "mesh 2D": lambda: plot.mesh(PLANE.mesh, contact=["upper.bottom"]),
    "mesh 3D": lambda: plot.mesh(SOLID.mesh, contact=["upper.bottom"]),
    "grids 2D": lambda: plot.grids(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 3, 4, 5, 6))),
    "contact 2D": lambda: plot.contact(PLANE),
    "contact 3D": lambda: plot.contact(SOLID),
    "deformation 2D stress": lambda: plot.deformation(PLANE, stress=True, states=True),
    "deformation 3D stress": lambda: plot.deformation(SOLID, stress=True, states=True),
    "deformation 3D from below": lambda: turned(plot.deformation(SOLID, displacement=True)),
    "history": lambda: plot.history({"truncated": PLANE, "a long label of a method": SOLID}),
    "path": lambda: plot.path(result_on(square(4)), steps=8),
    "load_history 2D": lambda: plot.load_history([*steps_of(PLANE), PLANE], (*FACTORS, 1.0), QUANTITIES),
    "adaptation 2D": lambda: plot.adaptation(adapted(am.cases.dovetail(), 10e-3, 100)),
    "adaptation 3D": lambda: plot.adaptation(adapted(am.cases.greco_block(), 20e-3, 60)),
}


def inked_border(pixels: np.ndarray) -> bool:
    return bool((np.concatenate([pixels[:2].reshape(-1, pixels.shape[2]), pixels[-2:].reshape(-1, pixels.shape[2]),
                                 pixels[:, :2].reshape(-1, pixels.shape[2]),
                                 pixels[:, -2:].reshape(-1, pixels.shape[2])])[:, :3] < 0.98 * pixels.max()).any())


@pytest.mark.parametrize("name", PICTURES)
def test_no_artist_leaves_the_canvas_and_no_title_covers_a_label(name):
    figure = PICTURES[name]()
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    assert not inked_border(np.asarray(figure.canvas.buffer_rgba()))
    box = figure.get_tightbbox(renderer)
    width, height = figure.get_size_inches()
    assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height
    shown = [text for text in figure.findobj(Text) if text.get_visible() and text.get_text().strip()]
    axes = figure.axes
    headings = [text for text in shown if text in (getattr(figure, "_suptitle", None), *(ax.title for ax in axes))
                or any(text is axis.label for ax in axes for axis in ax._axis_map.values()
                       if getattr(ax, "_axis3don", ax.axison))]
    for one, other in combinations(headings, 2):
        first, second = one.get_window_extent(renderer), other.get_window_extent(renderer)
        assert not first.overlaps(second), (one.get_text(), other.get_text())


def test_files_hold_the_whole_picture():
    figure, stream = PICTURES["problem 3D"](), io.BytesIO()
    figure.savefig(stream, format="png", dpi=50)
    stream.seek(0)
    pixels = matplotlib.image.imread(stream)
    assert not inked_border(pixels) and pixels.shape[1] < 50 * figure.get_figwidth()


def test_every_function_is_among_these_pictures():
    assert {name.split()[0] for name in PICTURES} == set(plot.__all__)
