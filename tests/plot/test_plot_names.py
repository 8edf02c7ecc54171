"""Names may hold what matplotlib reads as math or as 'leave me out': pictures show them as they are."""

from __future__ import annotations

import dataclasses
import io
import warnings

import matplotlib.pyplot as plt
import pytest
from made import cube, result_on, square
from made_bodies import two_bodies

import adaptmg as am
from adaptmg import plot
from adaptmg.plot.style import label_text, plain

NAMES = ("a$b$c", r"$\frac{", "a_b^{c", "<b>&amp;", "50 % #1 ~", r"$\$", "_hidden", "$", "ends\\")


@pytest.fixture(autouse=True)
def closed():
    yield
    plt.close("all")


def drawn(figure) -> list[str]:
    """All text as it is set: what is not math comes back without its escapes."""
    with warnings.catch_warnings():
        # a legend that leaves an entry out warns
        warnings.simplefilter("error")
        figure.savefig(io.BytesIO(), format="png", dpi=30)
    found = []
    for text in figure.findobj(plt.Text):
        shown, math = text._preprocess_math(text.get_text())
        found.append(shown.replace(r"\$", "$") if math else shown)
    return found


def posed(name: str, dim: int) -> tuple[am.ContactProblem, am.MeshArrays]:
    """A block on a plane whose bottom, and which itself, is called ``name``."""
    mesh = square(4) if dim == 2 else cube(2)
    mesh = dataclasses.replace(mesh, boundaries=(name, *mesh.boundaries[1:]), bodies=(name,))
    material = (am.PlaneStrain if dim == 2 else am.Solid)(young=2e11, poisson=0.3)
    domain = None
    if dim == 2:
        domain = am.Polygon(vertices=((0, 0), (1, 0), (1, 1), (0, 1)), boundaries=(name, "right", "top", "left"))
    up = (0.0,) * (dim - 1)
    return am.ContactProblem(
        material=material, law=am.Frictionless(), domain=domain, name=name,
        contact=am.Contact(name, am.Plane((0.0,) * dim, (*up, 1.0))),
        supports=(am.Support("left" if dim == 2 else "rest", x=0),)), mesh


def pairs(name: str, dim: int) -> am.Result:
    """Two bodies, the upper one, its boundaries and the whole called ``name``."""
    result = two_bodies(dim, 4, 3)
    mesh = dataclasses.replace(result.mesh, bodies=(name, "lower"), boundaries=tuple(
        boundary.replace("upper.bottom", name) for boundary in result.mesh.boundaries))
    contact = dataclasses.replace(result.contact, names=(name,), masters=(name,))
    return dataclasses.replace(result, mesh=mesh, contact=contact, problem_name=name)


@pytest.mark.parametrize(("dim", "name"), [*((2, name) for name in NAMES), (3, "a$b$c"), (3, r"_$\frac{")])
def test_every_picture_shows_odd_names_as_they_are(dim, name):
    problem, mesh = posed(name, dim)
    result = pairs(name, dim)
    pictures = {
        "problem": lambda: plot.problem(problem, mesh=mesh if dim == 3 else None),
        "mesh": lambda: plot.mesh(mesh, contact=[name]),
        "contact": lambda: plot.contact(result), "deformation": lambda: plot.deformation(result, states=True),
        "stress": lambda: plot.deformation(result, stress=True), "history": lambda: plot.history(result),
        "load_history": lambda: plot.load_history([result, result], [0, 1], {name: lambda r: 1.0}, against=name)}
    for picture, draw in pictures.items():
        texts = drawn(draw())
        if picture != "mesh":
            assert any(name in text for text in texts), f"{picture} does not show {name!r}: {texts}"


@pytest.mark.parametrize("name", NAMES)
def test_labels_of_histories_are_shown(name):
    result = result_on(square(4))
    # balanced dollars are math, in the user's own labels
    wanted = "abc" if name == "a$b$c" else name
    assert any(wanted in text.replace("$", "" if wanted == "abc" else "$") for text in
               drawn(plot.history({name: result, "other": result})))


def test_assemblies_show_odd_names():
    parts = {"$x$_1": am.Rectangle(width=1, height=1), "b_": am.Rectangle(width=1, height=1, origin=(0, -1))}
    steel = am.PlaneStrain(young=2e11, poisson=0.3)
    problem = am.ContactProblem(
        material=steel, law=am.Frictionless(), domain=am.Assembly(parts=parts), name="$",
        contact=am.ContactPair("$x$_1.bottom", "b_.top"), supports=(am.Support("b_.bottom", x=0, y=0),),
        loads=(am.InitialStrain("$x$_1", (1e-3, 0)), am.BodyForce((0, -1e4), body="$x$_1")))
    texts = drawn(plot.problem(problem))
    for wanted in ("$x$_1", "'$x$_1.bottom' on 'b_.top'", "body force 10 kN/m³ in '$x$_1'"):
        assert wanted in texts
    assert any("initial strain in '$x$_1'" in text for text in texts)


def test_the_user_may_write_math_in_labels():
    assert label_text(r"slip [$\mu$m]") == r"slip [$\mu$m]"
    assert label_text(r"$\frac{") == plain(r"$\frac{") == r"\$\frac{"
