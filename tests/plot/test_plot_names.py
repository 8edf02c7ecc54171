"""Names may hold what matplotlib reads as math or as a hidden label: pictures show them unchanged."""

import dataclasses

import pytest
from made import cube
from made_bodies import two_bodies
from pictures import texts

import adaptmg as am
from adaptmg import plot

NAMES = ("a$b$c", "_$\\frac{<b>&amp; 50 % #1 ~^{ends\\")


def posed(name: str, dim: int) -> tuple[am.ContactProblem, am.MeshArrays | None]:
    """A problem whose name, and that of a body, is ``name``; in 3D to be drawn on a mesh, with a boundary of it too."""
    if dim == 2:
        parts = {name: am.Rectangle(width=1, height=1), "b_": am.Rectangle(width=1, height=1, origin=(0, -1))}
        return am.ContactProblem(
            material=am.PlaneStrain(young=2e11, poisson=0.3), law=am.Frictionless(), name=name,
            domain=am.Assembly(parts=parts), contact=am.ContactPair(f"{name}.bottom", "b_.top"),
            supports=(am.Support("b_.bottom", x=0, y=0),),
            loads=(am.InitialStrain(name, (1e-3, 0)), am.BodyForce((0, -1e4), body=name))), None
    mesh = cube(2)
    mesh = dataclasses.replace(mesh, boundaries=(name, *mesh.boundaries[1:]), bodies=(name,))
    return am.ContactProblem(
        material=am.Solid(young=2e11, poisson=0.3), law=am.Frictionless(), name=name,
        supports=(am.Support("rest", x=0),), contact=am.Contact(name, am.Plane((0.0,) * 3, (0.0, 0.0, 1.0)))), mesh


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
    # balanced dollars are math in the user's own labels
    label = "abc" if name == "a$b$c" else name
    drawn = texts(plot.problem(problem, mesh=mesh))
    for use in ("contact on", *(("initial strain in", "body force (0, -10) kN/m³ in") if dim == 2 else ())):
        assert any(use in text and name in text for text in drawn), use
    for figure, expected in (
            (plot.contact(result), name), (plot.deformation(result, states=True), name),
            (plot.deformation(result, stress=True), name),
            *(() if dim == 3 else (
                (plot.history(result), name), (plot.history({name: result, "other": result}), label),
                (plot.load_history([result] * 2, [0, 1], {name: lambda r: 1.0}, against=name), name)))):
        found = [text.replace("$", "") if expected == "abc" else text for text in texts(figure)]
        assert any(expected in text for text in found), (found, expected)
