"""What is posed checks itself, and says what is wrong."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg.problem import (
    BodyForce,
    Box,
    Contact,
    ContactProblem,
    Coulomb,
    Elastic,
    Frictionless,
    GapFunction,
    Law,
    Plane,
    PlaneStrain,
    PlaneStress,
    Polygon,
    Pressure,
    Rectangle,
    Solid,
    Support,
    Traction,
    Tresca,
)

STEEL = PlaneStrain(young=2.1e11, poisson=0.3)
FLOOR = Contact("bottom", Plane(point=(0.0, 0.0), normal=(0.0, 1.0)))


def problem(**changes: object) -> ContactProblem:
    arguments = {"material": STEEL, "contact": FLOOR, "law": Frictionless(), "domain": Rectangle(width=1.0, height=1.0)}
    return ContactProblem(**(arguments | changes))


class TestChecks:
    @pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
    @pytest.mark.parametrize("check", [checks.number, checks.positive, checks.nonnegative])
    def test_not_finite_is_refused(self, check, value):
        with pytest.raises(ValueError, match="length must be finite"):
            check("length", value)

    @pytest.mark.parametrize("value", [None, "1 m", [1.0, 2.0], object()])
    def test_not_a_number(self, value):
        with pytest.raises(TypeError, match="length must be a number"):
            checks.number("length", value)

    def test_signs(self):
        with pytest.raises(ValueError, match="> 0, got 0"):
            checks.positive("length", 0)
        with pytest.raises(ValueError, match=">= 0, got -1"):
            checks.nonnegative("length", -1)
        assert checks.nonnegative("length", 0) == 0.0

    def test_integer(self):
        assert checks.integer("n", np.int32(3), 1) == 3
        with pytest.raises(TypeError, match=r"n must be an integer, got 3\.0"):
            checks.integer("n", 3.0)
        with pytest.raises(ValueError, match="n must be >= 1, got 0"):
            checks.integer("n", 0, 1)

    def test_choice(self):
        assert checks.choice("shape", "V", "VW") == "V"
        with pytest.raises(ValueError, match="'V', 'W', got 'X'"):
            checks.choice("shape", "X", "VW")

    def test_vector(self):
        result = check_arrays.vector("v", [1, 2], 2)
        assert result.dtype == np.float64 and not result.flags.writeable
        for bad in ([1.0], [[1.0, 2.0]], [1.0, np.nan]):
            with pytest.raises(ValueError, match="v must be"):
                check_arrays.vector("v", bad, 2)
        with pytest.raises(TypeError, match="sequence of numbers"):
            check_arrays.vector("v", ["a", "b"])

    def test_field(self):
        points = np.arange(6.0).reshape(3, 2)
        np.testing.assert_array_equal(checks.field("f", 2, points), [2, 2, 2])
        np.testing.assert_array_equal(checks.field("f", lambda x: x[:, 0], points), [0, 2, 4])
        np.testing.assert_array_equal(checks.field("f", lambda x: 5.0, points), [5, 5, 5])
        with pytest.raises(ValueError, match=r"return shape \(3,\)"):
            checks.field("f", lambda x: x, points)
        with pytest.raises(ValueError, match=r"f must be finite, got nan at \(2.0, 3.0\)"):
            checks.field("f", lambda x: np.where(x[:, 0] == 2, np.nan, 1), points)
        with pytest.raises(ValueError, match=r">= 0.0, got -1.0"):
            checks.field("f", -1.0, points, minimum=0.0)

    @pytest.mark.parametrize(("value", "error"), [(3, TypeError), (None, TypeError), ("", ValueError)])
    def test_boundary_name(self, value, error):
        with pytest.raises(error, match="boundary must"):
            checks.boundary_name("boundary", value)


class TestMaterials:
    def test_lame_constants(self):
        # one-dimensional strain e: stress (lambda + 2 mu) e; checked against tabulated steel values in GPa
        assert STEEL.lame == pytest.approx(121.1538e9, rel=1e-6)
        assert STEEL.shear_modulus == pytest.approx(80.7692e9, rel=1e-6)
        assert Solid(young=2.1e11, poisson=0.3).lame == STEEL.lame

    def test_plane_stress_leaves_no_stress_through_the_thickness(self):
        sheet, solid = PlaneStress(young=2.1e11, poisson=0.3), Solid(young=2.1e11, poisson=0.3)
        ex, ey = 1e-3, -4e-4
        ez = -solid.lame * (ex + ey) / (solid.lame + 2 * solid.shear_modulus)
        full = solid.lame * (ex + ey + ez) + 2 * solid.shear_modulus * ex
        assert sheet.lame * (ex + ey) + 2 * sheet.shear_modulus * ex == pytest.approx(full, rel=1e-12)

    @pytest.mark.parametrize("young", [0.0, -1.0, math.nan, math.inf])
    def test_young(self, young):
        with pytest.raises(ValueError, match="young must be"):
            PlaneStrain(young=young, poisson=0.3)

    @pytest.mark.parametrize("poisson", [0.5, -1.0, 0.7, math.nan])
    def test_poisson(self, poisson):
        with pytest.raises(ValueError, match="poisson must"):
            Solid(young=1.0, poisson=poisson)

    def test_frozen(self):
        with pytest.raises(dataclasses.FrozenInstanceError):
            STEEL.young = 1.0


class TestLaws:
    POINTS = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    WEIGHTS = np.array([0.5, 1.0, 0.5])

    def test_tresca_traction_becomes_nodal_force(self):
        law = Tresca(lambda x: 10.0 * x[:, 0]).at_nodes(self.POINTS, self.WEIGHTS)
        limit, friction = law.bounds(3)
        np.testing.assert_array_equal(limit, [0.0, 10.0, 10.0])
        np.testing.assert_array_equal(friction, 0.0)

    def test_coulomb_function_of_position(self):
        law = Coulomb(lambda x: 0.1 + x[:, 0]).at_nodes(self.POINTS, self.WEIGHTS)
        limit, friction = law.bounds(3)
        np.testing.assert_array_equal(limit, 0.0)
        np.testing.assert_allclose(friction, [0.1, 1.1, 2.1])

    def test_frictionless(self):
        assert not np.any(Frictionless().at_nodes(self.POINTS, self.WEIGHTS).bounds(3))

    @pytest.mark.parametrize("value", [-0.1, math.nan, math.inf])
    @pytest.mark.parametrize("law", [Coulomb, Tresca])
    def test_bad_parameters(self, law, value):
        with pytest.raises(ValueError, match="finite and >= 0"):
            law(value)

    @pytest.mark.parametrize("law", [Coulomb, Tresca])
    def test_not_a_parameter(self, law):
        with pytest.raises(TypeError, match="must be a number, a function"):
            law("0.3")

    @pytest.mark.parametrize("law", [Coulomb, Tresca])
    def test_negative_function(self, law):
        with pytest.raises(ValueError, match=r">= 0.0, got -1.0 at \(0.0, 0.0\)"):
            law(lambda x: x[:, 0] - 1).at_nodes(self.POINTS, self.WEIGHTS)

    @pytest.mark.parametrize("law", [Coulomb, Tresca])
    def test_function_must_be_evaluated_first(self, law):
        with pytest.raises(TypeError, match="must be evaluated at the nodes first"):
            law(lambda x: x[:, 0]).bounds(3)

    @pytest.mark.parametrize("law", [Coulomb, Tresca])
    def test_arrays_belong_on_discrete_problems(self, law):
        with pytest.raises(TypeError, match="belong on a DiscreteProblem"):
            law(np.ones(3)).at_nodes(self.POINTS, self.WEIGHTS)
        with pytest.raises(ValueError, match=r"array over the 3 contact nodes, got shape \(2,\)"):
            law(np.ones(2)).bounds(3)

    def test_own_law(self):
        class Half:
            def at_nodes(self, points, weights):
                return self

            def bounds(self, n_contact):
                return np.zeros(n_contact), np.full(n_contact, 0.5)

        assert isinstance(Half(), Law)
        assert problem(law=Half()).law.bounds(2)[1][1] == 0.5


class TestLoads:
    def test_components(self):
        assert Traction("top", (1, 2)).components == (1.0, 2.0)
        with pytest.raises(ValueError, match="2 or 3 components, got 1"):
            BodyForce((1.0,))
        with pytest.raises(TypeError, match="one a component"):
            Traction("top", lambda x: x)
        with pytest.raises(ValueError, match="components must be finite"):
            Traction("top", (0.0, math.nan))

    def test_pressure(self):
        with pytest.raises(ValueError, match="value must be finite"):
            Pressure("top", math.inf)
        with pytest.raises(TypeError, match="boundary must be a string"):
            Pressure(3, 1.0)

    def test_support(self):
        assert Support("left", y=0).components(3) == (None, 0.0, None)
        with pytest.raises(ValueError, match="fixes nothing"):
            Support("left")
        with pytest.raises(ValueError, match="z is prescribed in a 2D problem"):
            Support("left", z=0.0).components(2)
        with pytest.raises(ValueError, match="x must be finite"):
            Support("left", x=math.nan)


class TestObstacles:
    def test_gap_and_normal_of_a_plane(self):
        plane = Plane(point=(0.0, 1.0), normal=(0.0, 5.0))
        normals, gaps = plane.contact(np.array([[3.0, 2.5], [0.0, 1.0]]), np.array([[0.6, -0.8], [0.0, -1.0]]))
        np.testing.assert_array_equal(normals, [[0.0, -1.0], [0.0, -1.0]])
        np.testing.assert_array_equal(gaps, [1.5, 0.0])

    def test_plane_on_the_wrong_side(self):
        with pytest.raises(ValueError, match="turn the normal"):
            Plane(point=(0.0, 0.0), normal=(0.0, -1.0)).contact(np.zeros((1, 2)), np.array([[0.0, -1.0]]))

    def test_bad_planes(self):
        with pytest.raises(ValueError, match="normal must not be zero"):
            Plane(point=(0.0, 0.0), normal=(0.0, 0.0))
        with pytest.raises(ValueError, match="a vector of 2 numbers"):
            Plane(point=(0.0, 0.0), normal=(0.0, 0.0, 1.0))

    def test_gap_function(self):
        normals = np.array([[0.0, -1.0]])
        directions, gaps = GapFunction(lambda x: x[:, 0]**2).contact(np.array([[2.0, 0.0]]), normals)
        assert gaps == [4.0] and directions is not normals
        np.testing.assert_array_equal(directions, normals)
        with pytest.raises(TypeError, match="function must be callable"):
            GapFunction(1.0)
        with pytest.raises(ValueError, match="gap must be finite"):
            GapFunction(lambda x: x[:, 0] * np.nan).contact(np.zeros((1, 2)), normals)


class TestDomains:
    def test_rectangle_as_polygon(self):
        polygon = Rectangle(width=2.0, height=1.0, origin=(1.0, 1.0)).polygon
        assert polygon.vertices == ((1, 1), (3, 1), (3, 2), (1, 2))
        assert polygon.boundaries == ("bottom", "right", "top", "left") and polygon.polygon is polygon

    def test_bad_domains(self):
        with pytest.raises(ValueError, match="height must be > 0"):
            Rectangle(width=1.0, height=0.0)
        with pytest.raises(ValueError, match="depth must be finite"):
            Box(width=1.0, depth=math.nan, height=1.0)
        with pytest.raises(ValueError, match="origin must be a vector of 3"):
            Box(width=1.0, depth=1.0, height=1.0, origin=(0.0, 0.0))

    def test_bad_polygons(self):
        square = ((0, 0), (1, 0), (1, 1), (0, 1))
        with pytest.raises(ValueError, match="counter-clockwise"):
            Polygon(vertices=square[::-1], boundaries=("a", "b", "c", "d"))
        with pytest.raises(ValueError, match="each of the 4 edges, got 2"):
            Polygon(vertices=square, boundaries=("a", "b"))
        with pytest.raises(ValueError, match="at least 3 pairs"):
            Polygon(vertices=square[:2], boundaries=("a", "b"))

    def test_box_corners(self):
        box = Box(width=1.0, depth=2.0, height=3.0, origin=(1.0, 0.0, 0.0))
        np.testing.assert_array_equal(box.upper, [2.0, 2.0, 3.0])


class TestContactProblem:
    def test_single_contact_becomes_a_tuple(self):
        assert problem().contact == (FLOOR,)
        assert problem().contact_boundaries == ("bottom",) and problem().dim == 2

    @pytest.mark.parametrize(("changes", "error", "message"), [
        ({"material": "steel"}, TypeError, "material must be"),
        ({"contact": ()}, ValueError, "contact is empty"),
        ({"contact": (FLOOR, FLOOR)}, ValueError, "named twice"),
        ({"law": 0.3}, TypeError, "law must be"),
        ({"loads": ("gravity",)}, TypeError, r"loads\[0\] must be"),
        ({"loads": (BodyForce((0.0, 0.0, -1.0)),)}, ValueError, "3 components in a 2D problem"),
        ({"supports": (Pressure("top", 1.0),)}, TypeError, r"supports\[0\] must be"),
        ({"supports": (Support("left", z=0.0),)}, ValueError, "2D problem"),
        ({"domain": "square"}, TypeError, "domain must be"),
        ({"domain": Box(width=1.0, depth=1.0, height=1.0)}, ValueError, "use Solid in 3D"),
        ({"loads": (Pressure("roof", 1.0),)}, ValueError, "'roof', used for a load, does not exist"),
        ({"supports": (Support("wall", x=0.0),)}, ValueError, "'wall', used for a support, does not exist"),
        ({"contact": Contact("floor", FLOOR.obstacle)}, ValueError, "the boundaries are bottom, left, right, top"),
        ({"contact": Contact("bottom", Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))}, ValueError, "is 3D, the material 2D"),
    ])
    def test_refuses(self, changes, error, message):
        with pytest.raises(error, match=message):
            problem(**changes)

    @pytest.mark.parametrize("law", [Coulomb, Frictionless])
    def test_refuses_a_law_that_was_not_made(self, law):
        with pytest.raises(TypeError, match="law must be"):
            problem(law=law)

    def test_contact_needs_an_obstacle(self):
        with pytest.raises(TypeError, match="obstacle must be"):
            Contact("bottom", 0.0)

    def test_elastic_is_a_base_class(self):
        assert isinstance(STEEL, Elastic) and not hasattr(Elastic, "dim")

    @pytest.mark.parametrize("boundary", ["bottom"])
    def test_unknown_boundary_of_a_mesh(self, boundary):
        with pytest.raises(ValueError, match="'bottom', used for contact, does not exist"):
            problem().check_boundaries(("side", "top"))
