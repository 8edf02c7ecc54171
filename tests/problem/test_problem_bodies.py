"""Several bodies, outlines with arcs, pairs: what is posed checks itself, and says what is wrong."""

from __future__ import annotations

import math
import pickle
import warnings

import numpy as np
import pytest

import adaptmg as am
from adaptmg.problem import (
    Assembly,
    Axisymmetric,
    BodyForce,
    Box,
    Contact,
    ContactPair,
    ContactProblem,
    Domain,
    Frictionless,
    GapFunction,
    InitialStrain,
    Outline,
    Plane,
    PlaneStrain,
    PlaneStress,
    Polygon,
    Pressure,
    Rectangle,
    Solid,
    Support,
)

STEEL = PlaneStrain(young=2.1e11, poisson=0.3)
RUBBER = PlaneStrain(young=1e7, poisson=0.45)
TWO = Assembly(parts={"upper": Rectangle(width=1.0, height=1.0),
                      "lower": Rectangle(width=2.0, height=1.0, origin=(0.0, -1.0))})
PAIR = ContactPair("upper.bottom", "lower.top")
FLOOR = Plane((0.0, -1.0), (0.0, 1.0))


def problem(**changes: object) -> ContactProblem:
    arguments = {"material": STEEL, "contact": PAIR, "law": Frictionless(), "domain": TWO}
    return ContactProblem(**(arguments | changes))


class TestAssembly:
    def test_names(self):
        assert TWO.bodies == ("upper", "lower") and TWO.dim == 2 and isinstance(TWO, Domain)
        assert TWO.boundaries[:5] == ("upper.bottom", "upper.right", "upper.top", "upper.left", "lower.bottom")
        np.testing.assert_array_equal([TWO.lower, TWO.upper], [[0, -1], [2, 1]])

    def test_repeated_edge_names_become_one_boundary(self):
        polygon = Polygon(vertices=((0, 0), (1, 0), (0, 1)), boundaries=("a", "b", "a"))
        assert Assembly(parts={"p": polygon}).boundaries == ("p.a", "p.b")

    def test_is_plain_data(self):
        again = pickle.loads(pickle.dumps(TWO))
        assert again == TWO and hash(again) == hash(TWO)
        parts = dict(TWO.parts)
        made = Assembly(parts=parts)
        parts.clear()
        assert made.bodies == ("upper", "lower")

    @pytest.mark.parametrize(("parts", "error", "message"), [
        ({}, ValueError, "parts is empty"),
        ([TWO], TypeError, "parts must map body names"),
        ({"a.b": Rectangle(width=1, height=1)}, ValueError, r"must not contain '\.', got 'a\.b'"),
        ({"": Rectangle(width=1, height=1)}, ValueError, "must not be empty"),
        ({1: Rectangle(width=1, height=1)}, TypeError, "must be a string"),
        ({"a": "square"}, TypeError, r"parts\['a'\] must be a Domain"),
        ({"a": TWO}, ValueError, r"parts\['a'\] must be one body"),
        ({"a": Rectangle(width=1, height=1), "b": Box(width=1, depth=1, height=1)}, ValueError, "same dimension"),
    ])
    def test_refuses(self, parts, error, message):
        with pytest.raises(error, match=message):
            Assembly(parts=parts)


class TestOutline:
    HALF = Outline(vertices=((0, 0), (2, 2), (0, 2)), boundaries=("arc", "top", "axis"), arcs={0: (0, 2)})
    # a plate with a quarter of a hole: the arc runs clockwise about its centre
    HOLE = Outline(vertices=((1, 0), (3, 0), (3, 3), (0, 3), (0, 1)), boundaries=("x", "r", "t", "y", "hole"),
                   arcs={4: (0, 0)})

    def test_area_and_lengths_are_exact(self):
        assert self.HALF.area == pytest.approx(math.pi, rel=1e-14)
        assert self.HALF.lengths == pytest.approx((math.pi, 2.0, 2.0))
        assert self.HOLE.area == pytest.approx(9 - math.pi / 4, rel=1e-14)
        assert self.HOLE.arc(4).angle < 0 < self.HALF.arc(0).angle and self.HOLE.arc(0) is None

    def test_without_arcs_it_is_a_polygon(self):
        square = Outline(vertices=((0, 0), (1, 0), (1, 1), (0, 1)), boundaries=tuple("abcd"))
        assert square.polygon == Polygon(vertices=square.vertices, boundaries=square.boundaries) and square.area == 1

    def test_bounding_box_contains_the_arcs(self):
        angles = np.radians([10, 130, 250])
        ball = Outline(vertices=[(3 * math.cos(a), 1 + 3 * math.sin(a)) for a in angles], boundaries=("s",) * 3,
                       arcs=dict.fromkeys(range(3), (0.0, 1.0)))
        np.testing.assert_allclose([ball.lower, ball.upper], [[-3, -2], [3, 4]], rtol=1e-14)
        assert ball.area == pytest.approx(9 * math.pi)

    def test_polygon_is_inscribed(self):
        chords, edges = self.HALF.chords()
        on_arc = chords[edges == 0]
        np.testing.assert_allclose(np.linalg.norm(on_arc - [0, 2], axis=1), 2, rtol=1e-15)
        x, y = chords.T
        inscribed = 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
        assert 0.998 * self.HALF.area < inscribed < self.HALF.area
        assert self.HALF.polygon.boundaries == ("arc",) * 30 + ("top", "axis")

    def test_distance_to_an_arc(self):
        arc = self.HALF.arc(0)
        points = np.array([[0.0, 2.0], [3.0, -1.0], [0.0, -1.0], [0.0, 3.0], [-1.0, 0.0]])
        np.testing.assert_allclose(arc.distance(points), [2.0, 3 * math.sqrt(2) - 2, 1.0, math.hypot(2, 1), 1.0])

    def test_is_plain_data(self):
        again = pickle.loads(pickle.dumps(self.HALF))
        assert again == self.HALF and hash(again) == hash(self.HALF)

    @pytest.mark.parametrize(("changes", "error", "message"), [
        ({"vertices": ((0, 0), (0, 2), (2, 2)), "arcs": {}}, ValueError, "counter-clockwise"),
        ({"vertices": ((0, 0),)}, ValueError, "at least 2 pairs"),
        ({"boundaries": ("a", "b")}, ValueError, "each of the 3 edges"),
        ({"boundaries": "arc"}, TypeError, "boundaries must be a sequence of names"),
        ({"arcs": {0: (0, 1.9)}}, ValueError, r"arcs\[0\] \('arc'\): the centre .* same distance"),
        ({"arcs": {0: (1, 1)}}, ValueError, "180 degrees"),
        ({"arcs": {3: (0, 2)}}, ValueError, "there are 3 edges"),
        ({"arcs": {-1: (0, 2)}}, ValueError, "must be >= 0"),
        ({"arcs": {0: (0, math.nan)}}, ValueError, "must be finite"),
        ({"arcs": [(0, 2)]}, TypeError, "arcs must map"),
        ({"vertices": ((0, 0), (0, 0), (0, 2))}, ValueError, "full circle"),
    ])
    def test_refuses(self, changes, error, message):
        arguments = {"vertices": self.HALF.vertices, "boundaries": self.HALF.boundaries, "arcs": {0: (0, 2)}}
        with pytest.raises(error, match=message):
            Outline(**(arguments | changes))


class TestContactPair:
    def test_defaults(self):
        assert PAIR.boundary == PAIR.slave == "upper.bottom" and PAIR.coupling == "mortar"
        assert PAIR.reach is None and PAIR.gap is None and not PAIR.allow_interference

    @pytest.mark.parametrize(("arguments", "options", "error", "message"), [
        (("a", "a"), {}, ValueError, "slave and master are both 'a'"),
        (("", "a"), {}, ValueError, "slave must not be empty"),
        (("a", 1), {}, TypeError, "master must be a string"),
        (("a", "b"), {"coupling": "glue"}, ValueError, "coupling must be one of 'mortar', 'nodes'"),
        (("a", "b"), {"reach": -1.0}, ValueError, "reach must be > 0"),
        (("a", "b"), {"reach": math.nan}, ValueError, "reach must be finite"),
        (("a", "b"), {"gap": -1e-6}, ValueError, "allow_interference=True"),
        (("a", "b"), {"gap": "small"}, TypeError, "gap must be a number"),
    ])
    def test_refuses(self, arguments, options, error, message):
        with pytest.raises(error, match=message):
            ContactPair(*arguments, **options)

    def test_interference_and_functions(self):
        assert ContactPair("a", "b", gap=-1e-6, allow_interference=True).gap == -1e-6
        assert callable(ContactPair("a", "b", gap=lambda x: x[:, 0]).gap)


class TestMaterialsAndLoads:
    def test_axisymmetric_has_the_moduli_of_a_solid(self):
        ring, solid = (kind(young=2.0, poisson=0.3) for kind in (Axisymmetric, Solid))
        assert ring.dim == 2 and ring.lame == solid.lame and ring.shear_modulus == solid.shear_modulus

    def test_initial_strain(self):
        assert InitialStrain("bolt", (0, -1e-3, 0)).components == (0.0, -1e-3, 0.0)
        with pytest.raises(ValueError, match="2 or 3 components, got 1"):
            InitialStrain("bolt", (1e-3,))
        with pytest.raises(TypeError, match="body must be a string"):
            InitialStrain(None, (0.0, 0.0))

    def test_body_force_of_one_body(self):
        assert BodyForce((0, 1)).body is None and BodyForce((0, 1), body="upper").body == "upper"
        with pytest.raises(ValueError, match="body must not be empty"):
            BodyForce((0, 1), body="")


class TestProblemOfBodies:
    def test_names(self):
        posed = problem(contact=(PAIR, Contact("lower.bottom", FLOOR)))
        assert posed.contact_boundaries == ("upper.bottom", "lower.bottom") and posed.masters == ("lower.top", "")
        assert posed.pair_boundaries == ("upper.bottom", "lower.top", "lower.bottom")
        assert posed.bodies == ("upper", "lower") and posed.dim == 2 and not posed.axisymmetric

    def test_bodies_without_a_domain(self):
        assert problem(domain=None).bodies == ()
        assert problem(domain=None, material={"a": STEEL, "b": RUBBER}).bodies == ("a", "b")
        assert problem(domain=Rectangle(width=1, height=1), contact=ContactPair("bottom", "top")).bodies == ("body",)
        with pytest.raises(ValueError, match="the bodies are 'a', 'c', material names 'a', 'b'"):
            problem(domain=None, material={"a": STEEL, "b": RUBBER}).check_bodies(("a", "c"))

    def test_a_domain_whose_names_only_the_mesh_knows(self):
        class File(Domain):
            dim, boundaries, bodies = 2, None, None

        posed = problem(domain=File(), material={"a": STEEL, "b": RUBBER})
        assert posed.bodies == ("a", "b")
        with pytest.raises(ValueError, match=r"'upper\.bottom', used for contact, does not exist"):
            posed.check_boundaries(("a.top",))

    @pytest.mark.parametrize("contact", [PAIR, ContactPair("upper.left", "upper.right"),
                                         (PAIR, ContactPair("upper.left", "lower.top")),
                                         (PAIR, Contact("lower.top", Plane((0, 2), (0, -1))))],
                             ids=["two bodies", "one body", "a common master", "master before an obstacle"])
    def test_accepts(self, contact):
        assert problem(contact=contact).dim == 2

    @pytest.mark.parametrize(("changes", "error", "message"), [
        ({"material": {}}, TypeError, "material must be"),
        ({"material": {"upper": STEEL}}, ValueError, "the bodies are 'upper', 'lower', material names 'upper'"),
        ({"material": {"upper": STEEL, "lower": STEEL, "x": STEEL}}, ValueError, "must name each body once"),
        ({"material": {"upper": STEEL, "lower": "rubber"}}, TypeError, "material must be"),
        ({"material": {"upper": STEEL, "lower": Axisymmetric(young=1.0, poisson=0.3)}}, ValueError, "all Axisymmetric"),
        ({"material": {"upper": STEEL, "lower": Solid(young=1.0, poisson=0.3)}}, ValueError, "all Solid"),
        ({"contact": (PAIR, ContactPair("upper.bottom", "lower.left"))}, ValueError, "'upper.bottom' is named twice"),
        ({"contact": (PAIR, Contact("upper.bottom", FLOOR))}, ValueError, "'upper.bottom' is named twice"),
        ({"contact": (PAIR, ContactPair("lower.top", "upper.left"))}, ValueError, "swap slave and master"),
        ({"contact": ContactPair("upper.bottom", "lower.roof")}, ValueError, "'lower.roof', used for contact"),
        ({"contact": ContactPair("bottom", "lower.top")}, ValueError, "'bottom', used for contact"),
        ({"contact": "upper.bottom"}, TypeError, "contact must be a sequence of Contact or ContactPair"),
        ({"loads": (Pressure("top", 1.0),)}, ValueError, "'top', used for a load, does not exist"),
        ({"loads": (BodyForce((0, 1), body="middle"),)}, ValueError, "body 'middle', used for a load"),
        ({"loads": (InitialStrain("middle", (0, 1)),)}, ValueError, "the bodies are 'upper', 'lower'"),
        ({"supports": (Support("upper.roof", x=0),)}, ValueError, "used for a support"),
        ({"domain": "two squares"}, TypeError, "domain must be a Domain"),
    ])
    def test_refuses(self, changes, error, message):
        with pytest.raises(error, match=message):
            problem(**changes)

    def test_plane_stress_and_strain_may_meet(self):
        assert problem(material={"upper": STEEL, "lower": PlaneStress(young=1.0, poisson=0.3)}).dim == 2

    def test_radius_is_not_negative(self):
        ring = Axisymmetric(young=1.0, poisson=0.3)
        assert problem(material=ring).axisymmetric
        with pytest.raises(ValueError, match=r"reaches to x = -0\.5 m"):
            problem(material=ring, domain=Rectangle(width=1, height=1, origin=(-0.5, 0)),
                    contact=Contact("bottom", GapFunction(lambda x: x[:, 0])))

    def test_initial_strain_components(self):
        assert problem(loads=(InitialStrain("upper", (1e-3, 0)), InitialStrain("lower", (0, 0, 1e-3)))).loads
        cube = Box(width=1, depth=1, height=1)
        with pytest.raises(ValueError, match="2 components in a 3D problem"):
            problem(material=Solid(young=1.0, poisson=0.3), domain=cube, contact=ContactPair("top", "bottom"),
                    loads=(InitialStrain("body", (1e-3, 0)),))


def test_top_level_names():
    for name in ("Assembly", "Axisymmetric", "ContactPair", "InitialStrain", "Outline"):
        assert getattr(am, name) is getattr(am.problem, name)


def test_bodies_that_lie_in_each_other_and_are_no_pair_are_named():
    """Nothing would keep them apart; where they only touch, or are a pair, there is no warning."""
    def posed(shift):
        places = {"low": (0.0, 0.0), "high": (0.0, 1.0), "third": (1.0 - shift, 0.0)}
        parts = {name: am.Rectangle(width=1.0, height=1.0, origin=origin) for name, origin in places.items()}
        problem = am.ContactProblem(
            material=am.PlaneStrain(young=1e9, poisson=0.3), domain=am.Assembly(parts=parts), law=am.Frictionless(),
            contact=am.ContactPair("high.bottom", "low.top"), loads=(am.Pressure("high.top", 1e5),),
            supports=(am.Support("high.left", x=0.0), am.Support("low.bottom", x=0.0, y=0.0),
                      am.Support("third.bottom", x=0.0, y=0.0)))
        return am.Hierarchy.uniform(problem, (4, 8))

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        posed(0.0)
    with pytest.warns(UserWarning, match=r"the bodies 'low' and 'third' lie in each other, at \[.* not a contact pair"):
        posed(0.3)
