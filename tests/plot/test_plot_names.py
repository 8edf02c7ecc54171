"""Names may hold what matplotlib reads as math or as a hidden label: pictures show them unchanged."""

import dataclasses

import pytest
from made import cube, square
from made_bodies import two_bodies
from pictures import texts

import adaptmg as am
from adaptmg import plot

NAMES = ("a$b$c", "_$\\frac{<b>&amp; 50 % #1 ~^{ends\\")


def posed(name: str, dim: int) -> tuple[am.ContactProblem, am.MeshArrays]:
    """A block on a plane; the problem, the body and its bottom are called ``name``."""
    mesh = square(4) if dim == 2 else cube(2)
    mesh = dataclasses.replace(mesh, boundaries=(name, *mesh.boundaries[1:]), bodies=(name,))
    domain = am.Polygon(vertices=((0, 0), (1, 0), (1, 1), (0, 1)), boundaries=(name, "right", "top", "left"))
    return am.ContactProblem(
        material=(am.PlaneStrain if dim == 2 else am.Solid)(young=2e11, poisson=0.3), law=am.Frictionless(),
        domain=domain if dim == 2 else None, name=name,
        contact=am.Contact(name, am.Plane((0.0,) * dim, (*(0.0,) * (dim - 1), 1.0))),
        supports=(am.Support("left" if dim == 2 else "rest", x=0),)), mesh


def pairs(name: str, dim: int) -> am.Result:
    """Two bodies; the upper one, its boundaries and the problem are called ``name``."""
    result = two_bodies(dim, 4, 3)
    mesh = dataclasses.replace(result.mesh, bodies=(name, "lower"), boundaries=tuple(
        boundary.replace("upper.bottom", name) for boundary in result.mesh.boundaries))
    contact = dataclasses.replace(result.contact, names=(name,), masters=(name,))
    return dataclasses.replace(result, mesh=mesh, contact=contact, problem_name=name)


@pytest.mark.parametrize(("dim", "name"), [*((2, name) for name in NAMES), (3, NAMES[1])])
def test_every_picture_shows_odd_names_unchanged(dim, name):
    problem, mesh = posed(name, dim)
    result = pairs(name, dim)
    plot.mesh(mesh, contact=[name])
    # balanced dollars are math in the user's own labels
    label = "abc" if name == "a$b$c" else name
    for figure, expected in (
            (plot.problem(problem, mesh=mesh if dim == 3 else None), name), (plot.contact(result), name),
            (plot.deformation(result, states=True), name), (plot.deformation(result, stress=True), name),
            *(() if dim == 3 else (
                (plot.history(result), name), (plot.history({name: result, "other": result}), label),
                (plot.load_history([result] * 2, [0, 1], {name: lambda r: 1.0}, against=name), name)))):
        found = [text.replace("$", "") if expected == "abc" else text for text in texts(figure)]
        assert any(expected in text for text in found), (found, expected)


def test_assemblies_show_odd_names():
    parts = {"$x$_1": am.Rectangle(width=1, height=1), "b_": am.Rectangle(width=1, height=1, origin=(0, -1))}
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=2e11, poisson=0.3), law=am.Frictionless(), domain=am.Assembly(parts=parts),
        name="$", contact=am.ContactPair("$x$_1.bottom", "b_.top"), supports=(am.Support("b_.bottom", x=0, y=0),),
        loads=(am.InitialStrain("$x$_1", (1e-3, 0)), am.BodyForce((0, -1e4), body="$x$_1")))
    found = texts(plot.problem(problem))
    for expected in ("$x$_1", "contact on '$x$_1.bottom'", "  its master 'b_.top'",
                     "body force (0, -10) kN/m³ in '$x$_1'"):
        assert expected in found
    assert any("initial strain in '$x$_1'" in text for text in found)
