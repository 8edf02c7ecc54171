"""What is posed is checked where it is made; the message says what is wrong."""

import math

import numpy as np
import pytest

import adaptmg as am
from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg.problem import Axisymmetric, PlaneStrain, Solid

STEEL = PlaneStrain(young=2.1e11, poisson=0.3)
SQUARE, CUBE = am.Rectangle(width=1.0, height=1.0), am.Box(width=1.0, depth=1.0, height=1.0)
TWO = am.Assembly(parts={"upper": SQUARE, "lower": am.Rectangle(width=2.0, height=1.0, origin=(0.0, -1.0))})
FLOOR = am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0)))
PAIR = am.ContactPair("upper.bottom", "lower.top")
POINTS = np.arange(6.0).reshape(3, 2)
NORMALS = np.array([[0.0, -1.0]] * 3)


def one(**changes: object) -> am.ContactProblem:
    return am.ContactProblem(**({"material": STEEL, "contact": FLOOR, "law": am.Frictionless(), "domain": SQUARE}
                                | changes))


def two(**changes: object) -> am.ContactProblem:
    return one(**({"contact": PAIR, "domain": TWO} | changes))


def outline(**changes: object) -> am.Outline:
    return am.Outline(**({"vertices": ((0, 0), (2, 2), (0, 2)), "boundaries": ("arc", "top", "axis"),
                          "arcs": {0: (0, 2)}} | changes))


def polygon(n: int = 4, names: str = "abcd", turn: int = 1) -> am.Polygon:
    return am.Polygon(vertices=((0, 0), (1, 0), (1, 1), (0, 1))[:n][::turn], boundaries=tuple(names))


VALUES = {
    r"v must be a vector of 2 numbers, got shape \(1,\)": lambda: check_arrays.vector("v", [1.0], 2),
    r"return shape \(3,\)": lambda: checks.field("f", lambda x: x, POINTS),
    r"f must be finite, got nan at \(2.0, 3.0\)": lambda: checks.field(
        "f", lambda x: np.where(x[:, 0] == 2, np.nan, 1), POINTS),
    r"f must be finite and >= 0.0, got -1.0": lambda: checks.field("f", -1.0, POINTS, minimum=0.0),
    r"f must be at most 1e\+40 in SI units": lambda: checks.field("f", lambda x: -1e300, POINTS),
    "friction must be finite and >= 0": lambda: am.Coulomb(-0.1),
    "limit must be finite and >= 0": lambda: am.Tresca(math.nan),
    r">= 0.0, got -1.0 at \(0.0, 1.0\)": lambda: am.Coulomb(lambda x: x[:, 0] - 1).at_nodes(POINTS, np.ones(3)),
    r"over the 3 contact nodes, got shape \(2,\)": lambda: am.Tresca(np.ones(2)).bounds(3),
    "2 or 3 components, got 1": lambda: am.BodyForce((1.0,)),
    "fixes nothing": lambda: am.Support("left"),
    "z is prescribed in a 2D problem": lambda: one(supports=(am.Support("left", z=0.0),)),
    "turn the normal": lambda: am.Plane((0.0, 0.0), (0.0, -1.0)).contact(POINTS, NORMALS),
    "normal must not be zero": lambda: am.Plane((0.0, 0.0), (0.0, 0.0)),
    "gap must be finite": lambda: am.GapFunction(lambda x: x[:, 0] * np.nan).contact(POINTS, NORMALS),
    "slave and master are both 'a'": lambda: am.ContactPair("a", "a"),
    "allow_interference=True": lambda: am.ContactPair("a", "b", gap=-1e-6),
    "positive area": lambda: polygon(turn=-1),
    "each of the 4 edges, got 2": lambda: polygon(names="ab"),
    "at least 3 pairs": lambda: polygon(2, "ab"),
    "counter-clockwise": lambda: outline(vertices=((0, 0), (0, 2), (2, 2)), arcs={}),
    r"arcs\[0\] \('arc'\): the centre .* same distance": lambda: outline(arcs={0: (0, 1.9)}),
    "180 degrees": lambda: outline(arcs={0: (1, 1)}),
    "there are 3 edges": lambda: outline(arcs={3: (0, 2)}),
    "full circle": lambda: outline(vertices=((0, 0), (0, 0), (0, 2))),
    "parts is empty": lambda: am.Assembly(parts={}),
    r"must not contain '\.', got 'a\.b'": lambda: am.Assembly(parts={"a.b": SQUARE}),
    r"parts\['a'\] must be one body": lambda: am.Assembly(parts={"a": TWO}),
    "same dimension": lambda: am.Assembly(parts={"a": SQUARE, "b": CUBE}),
    "contact is empty": lambda: one(contact=()),
    "'bottom' is named twice": lambda: one(contact=(FLOOR, FLOOR)),
    "3 components in a 2D problem": lambda: one(loads=(am.BodyForce((0.0, 0.0, -1.0)),)),
    "use Solid in 3D": lambda: one(domain=CUBE),
    "'roof', used for a load, does not exist": lambda: one(loads=(am.Pressure("roof", 1.0),)),
    "'wall', used for a support, does not exist": lambda: one(supports=(am.Support("wall", x=0.0),)),
    "the boundaries are bottom, left, right, top": lambda: one(contact=am.Contact("floor", FLOOR.obstacle)),
    "is 3D, the material 2D": lambda: one(contact=am.Contact("bottom", am.Plane((0, 0, 0), (0, 0, 1)))),
    "the bodies are 'upper', 'lower', material names 'upper'": lambda: two(material={"upper": STEEL}),
    "must name each body once": lambda: two(material=dict.fromkeys(("upper", "lower", "x"), STEEL)),
    "all Axisymmetric": lambda: two(material={"upper": STEEL, "lower": Axisymmetric(young=1.0, poisson=0.3)}),
    "all Solid": lambda: two(material={"upper": STEEL, "lower": Solid(young=1.0, poisson=0.3)}),
    "'upper.bottom' is named twice": lambda: two(contact=(PAIR, am.ContactPair("upper.bottom", "lower.left"))),
    "swap slave and master": lambda: two(contact=(PAIR, am.ContactPair("lower.top", "upper.left"))),
    "'lower.roof', used for contact": lambda: two(contact=am.ContactPair("upper.bottom", "lower.roof")),
    "body 'middle', used for a load": lambda: two(loads=(am.BodyForce((0, 1), body="middle"),)),
    "the bodies are 'upper', 'lower'$": lambda: two(loads=(am.InitialStrain("middle", (0, 1)),)),
    "the bodies are 'a', 'c', material names 'a'": lambda: one(domain=None, material={"a": STEEL}).check_bodies(
        ("a", "c")),
    "'bottom', used for contact, does not exist": lambda: one().check_boundaries(("side", "top")),
    r"reaches to x = -0\.5 m": lambda: one(
        material=Axisymmetric(young=1.0, poisson=0.3), domain=am.Rectangle(width=1, height=1, origin=(-0.5, 0))),
    "2 components in a 3D problem": lambda: one(
        material=Solid(young=1.0, poisson=0.3), domain=CUBE, contact=am.ContactPair("top", "bottom"),
        loads=(am.InitialStrain("body", (1e-3, 0)),)),
}
TYPES = {
    "v must be a sequence of numbers": lambda: check_arrays.vector("v", ["a", "b"]),
    "must be evaluated at the nodes first": lambda: am.Tresca(lambda x: x[:, 0]).bounds(3),
    "belong on a DiscreteProblem": lambda: am.Coulomb(np.ones(3)).at_nodes(POINTS, np.ones(3)),
    "one a component": lambda: am.Traction("top", lambda x: x),
    r"parts\['a'\] must be a Domain": lambda: am.Assembly(parts={"a": "square"}),
    "material must be": lambda: two(material={"upper": STEEL, "lower": "rubber"}),
    "contact must be a sequence of Contact or ContactPair": lambda: two(contact="upper.bottom"),
}


@pytest.mark.parametrize(("error", "message", "make"), [
    (error, message, make) for error, table in ((ValueError, VALUES), (TypeError, TYPES))
    for message, make in table.items()])
def test_refused(error, message, make):
    with pytest.raises(error, match=message):
        make()


@pytest.mark.parametrize("contact", [
    PAIR, am.ContactPair("upper.left", "upper.right"), (PAIR, am.ContactPair("upper.left", "lower.top")),
    (PAIR, am.Contact("lower.top", am.Plane((0, 2), (0, -1))))],
    ids=["two bodies", "one body", "a common master", "master before an obstacle"])
def test_accepted(contact):
    assert two(contact=contact).dim == 2
