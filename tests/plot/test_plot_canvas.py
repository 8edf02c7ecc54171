"""In every kind of picture nothing leaves the canvas, no title covers a label, and odd names are
shown unchanged."""

import dataclasses
import io
from functools import cache

import matplotlib
import matplotlib.image
import numpy as np
import pytest
from made import cube, result_on, square
from made_bodies import FACTORS, QUANTITIES, steps_of, two_bodies, two_solids
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.text import Text
from overlaps import overlaps
from pictures import texts

import adaptmg as am
from adaptmg import plot

PLANE, SOLID = two_bodies(), two_bodies(3, 4, 3)


@cache
def flat() -> am.Result:
    flat_bar = am.Rectangle(width=40e-3, height=20e-3)
    problem = dataclasses.replace(am.cases.greco_bar(), domain=flat_bar)
    return am.solve(am.Hierarchy.uniform(problem, divisions=((4, 2), (8, 4))))


@cache
def adapted(name: str, size: float, nodes: int) -> list[am.Step]:
    case = am.cases.get(name).function()
    return list(am.adapt(case, size, engine=am.Bisect(), max_nodes=nodes))


def turned(figure: Figure) -> Figure:
    figure.axes[0].view_init(-20, 30)
    return figure


PICTURES = {
    "problem 2D": lambda: plot.problem(am.cases.incline()),
    "problem 3D": lambda: plot.problem(two_solids(), mesh=SOLID.mesh),
    "mesh 2D": lambda: plot.mesh(PLANE.mesh, contact=["upper.bottom"]),
    "mesh 3D": lambda: plot.mesh(SOLID.mesh, contact=["upper.bottom"]),
    "grids 2D": lambda: plot.grids(
        am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 3, 4, 5, 6))
    ),
    "contact 2D": lambda: plot.contact(PLANE),
    "contact 3D": lambda: plot.contact(SOLID),
    "deformation 2D stress": lambda: plot.deformation(PLANE, stress=True, states=True),
    "deformation 3D stress": lambda: plot.deformation(SOLID, stress=True, states=True),
    "deformation 3D from below": lambda: turned(plot.deformation(SOLID, displacement=True)),
    "deformation of a flat body": lambda: plot.deformation(flat(), stress=True, states=True),
    "history": lambda: plot.history({"truncated": PLANE, "a long label of a method": SOLID}),
    "path": lambda: plot.path(result_on(square(4)), steps=8),
    "load_history 2D": lambda: plot.load_history(
        [*steps_of(PLANE), PLANE], (*FACTORS, 1.0), QUANTITIES
    ),
    "adaptation 2D": lambda: plot.adaptation(adapted("dovetail", 10e-3, 100)),
    "adaptation scalar": lambda: plot.adaptation(adapted("obstacle_problem", 0.3, 100)),
    "adaptation 3D": lambda: plot.adaptation(adapted("greco_block", 20e-3, 60)),
}


def inked_border(pixels: np.ndarray) -> bool:
    inside = np.zeros(pixels.shape[:2], bool)
    inside[2:-2, 2:-2] = True
    return bool((pixels[~inside, :3] < 0.98 * pixels.max()).any())


@pytest.mark.parametrize("width", [None, 3.3])
@pytest.mark.parametrize("name", PICTURES)
def test_no_artist_leaves_the_figure_or_covers_another(name, width):
    chosen = {} if width is None else {"figure.figsize": (width, 2.5), "font.size": 8}
    with matplotlib.rc_context(chosen):
        figure = PICTURES[name]()
        assert overlaps(figure) == []
    assert not inked_border(np.asarray(figure.canvas.buffer_rgba()))
    assert width is None or figure.get_figwidth() == width


@pytest.mark.parametrize("width", [2.0, 7.0])
def test_grids_label_the_left_axes_of_each_row(width):
    with matplotlib.rc_context({"figure.figsize": (width, 2.5), "font.size": 6}):
        figure = PICTURES["grids 2D"]()
        figure.draw_without_rendering()
    left = min(ax.get_position().x0 for ax in figure.axes)
    for ax in figure.axes:
        assert bool(ax.get_ylabel()) == (ax.get_position().x0 < left + 0.1)


def test_files_hold_the_whole_picture():
    figure, stream = PICTURES["problem 3D"](), io.BytesIO()
    figure.savefig(stream, format="png", dpi=50)
    stream.seek(0)
    pixels = matplotlib.image.imread(stream)
    assert not inked_border(pixels) and pixels.shape[1] < 50 * figure.get_figwidth()


def test_every_function_is_among_these_pictures():
    assert {name.split()[0] for name in PICTURES} == set(plot.__all__)


#: with what matplotlib reads as math or as a hidden label
NAME = "_a$b$c {<b>&amp; 50 % #1 ~^{ends\\"


def posed(name: str, dim: int) -> tuple[am.ContactProblem, am.MeshArrays | None]:
    """A problem whose name, and that of a body, is ``name``; in 3D to be drawn on a mesh, with a
    boundary of it too."""
    if dim == 2:
        parts = {
            name: am.Rectangle(width=1, height=1),
            "b_": am.Rectangle(width=1, height=1, origin=(0, -1)),
        }
        return am.ContactProblem(
            material=am.PlaneStrain(young=2e11, poisson=0.3),
            law=am.Frictionless(),
            name=name,
            domain=am.Assembly(parts=parts),
            contact=am.ContactPair(f"{name}.bottom", "b_.top"),
            supports=(am.Support("b_.bottom", x=0, y=0),),
            loads=(am.InitialStrain(name, (1e-3, 0)), am.BodyForce((0, -1e4), body=name)),
        ), None
    mesh = cube(2)
    mesh = dataclasses.replace(mesh, boundaries=(name, *mesh.boundaries[1:]), bodies=(name,))
    return am.ContactProblem(
        material=am.Solid(young=2e11, poisson=0.3),
        law=am.Frictionless(),
        name=name,
        supports=(am.Support("rest", x=0),),
        contact=am.Contact(name, am.Plane((0.0,) * 3, (0.0, 0.0, 1.0))),
    ), mesh


def pairs(name: str, dim: int) -> am.Result:
    """Two bodies; the upper one, its boundaries and the problem are called ``name``."""
    result = two_bodies(dim, 4, 3)
    mesh = dataclasses.replace(
        result.mesh,
        bodies=(name, "lower"),
        boundaries=tuple(
            boundary.replace("upper.bottom", name) for boundary in result.mesh.boundaries
        ),
    )
    contact = dataclasses.replace(result.contact, names=(name,), masters=(name,))
    return dataclasses.replace(result, mesh=mesh, contact=contact, problem_name=name)


@pytest.mark.parametrize("dim", [2, 3])
def test_every_picture_shows_odd_names_unchanged(dim):
    problem, mesh = posed(NAME, dim)
    result = pairs(NAME, dim)
    drawn = texts(plot.problem(problem, mesh=mesh))
    uses = ("initial strain in", "body force (0, -10) kN/m³ in") if dim == 2 else ()
    for use in ("contact on", *uses):
        assert any(use in text and NAME in text for text in drawn), use
    for figure in (
        plot.contact(result),
        plot.deformation(result, states=True),
        plot.deformation(result, stress=True),
        plot.history(result),
    ):
        assert any(NAME in text for text in texts(figure))


@pytest.mark.parametrize(
    ("label", "shown"),
    [("a$b$c", "a$b$c"), ("_$\\frac{$", " _\\$\\frac{\\$")],
    ids=["valid", "not"],
)
def test_labels_of_the_user_are_math_where_it_is_valid(label, shown):
    for figure in (
        plot.history({label: PLANE, "other": PLANE}),
        plot.load_history([PLANE] * 2, [0, 1], {label: lambda r: 1.0}, against=label),
    ):
        assert texts(figure) and shown in [text.get_text() for text in figure.findobj(Text)]


@pytest.mark.parametrize(
    ("rows", "columns", "size"), [(3, 1, (3.3, 4.0)), (1, 3, (7.0, 2.2)), (2, 2, (7.0, 4.0))]
)
def test_contact_fits_axes_of_any_layout(rows, columns, size):
    with matplotlib.rc_context({"font.size": 8}):
        figure = Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(figure)
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        assert plot.contact(PLANE, axes=axes[:3]) is figure
        plot.history(PLANE, ax=axes[-1]) if len(axes) > 3 else None
        assert overlaps(figure) == []


def test_pictures_follow_rcparams_and_are_saved_as_wide_as_chosen():
    chosen = {
        "font.family": "serif",
        "font.size": 7.0,
        "lines.linewidth": 0.5,
        "axes.prop_cycle": matplotlib.cycler(color=["#123456", "#654321"]),
        "image.cmap": "plasma",
        "figure.figsize": (3.3, 2.0),
    }
    with matplotlib.rc_context(chosen):
        before = dict(matplotlib.rcParams)
        figure = plot.history({"one": PLANE, "other": PLANE})
        colored = plot.deformation(PLANE, displacement=True)
        assert dict(matplotlib.rcParams) == before
    lines = figure.axes[0].get_lines()[:2]
    assert [line.get_color() for line in lines] == ["#123456", "#654321"]
    assert {line.get_linewidth() for line in lines} == {0.5}
    label = figure.axes[0].xaxis.label
    assert label.get_family() == ["serif"] and label.get_size() == 7.0
    assert any(mesh.get_cmap().name == "plasma" for mesh in colored.axes[0].collections)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=100)
    stream.seek(0)
    assert matplotlib.image.imread(stream).shape[1] == 330
    # what the user has not set is that of the package
    assert plot.history(PLANE).axes[0].xaxis.label.get_size() == 9.5
