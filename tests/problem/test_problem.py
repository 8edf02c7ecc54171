"""What is posed: moduli, laws at the nodes, obstacles, domains, names, load steps; what is
refused."""

import dataclasses
import math
import pickle

import numpy as np
import pytest
from made import square
from refused import refused

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.discrete.named_loads import load_steps
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.stress import StressData

STEEL = am.PlaneStrain(young=2.1e11, poisson=0.3)
SQUARE, CUBE = am.Rectangle(width=1.0, height=1.0), am.Box(width=1.0, depth=1.0, height=1.0)
TWO = am.Assembly(
    parts={"upper": SQUARE, "lower": am.Rectangle(width=2.0, height=1.0, origin=(0.0, -1.0))}
)
FLOOR = am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0)))
PAIR = am.ContactPair("upper.bottom", "lower.top")
POINTS = np.arange(6.0).reshape(3, 2)
NORMALS = np.array([[0.0, -1.0]] * 3)
HALF = am.Outline(
    vertices=((0, 0), (2, 2), (0, 2)), boundaries=("arc", "top", "axis"), arcs={0: (0, 2)}
)


def one(**changes: object) -> am.ContactProblem:
    return am.ContactProblem(
        **(
            {"material": STEEL, "contact": FLOOR, "law": am.Frictionless(), "domain": SQUARE}
            | changes
        )
    )


def two(**changes: object) -> am.ContactProblem:
    return one(**({"contact": PAIR, "domain": TWO} | changes))


def outline(**changes: object) -> am.Outline:
    return am.Outline(
        **(
            {
                "vertices": ((0, 0), (2, 2), (0, 2)),
                "boundaries": ("arc", "top", "axis"),
                "arcs": {0: (0, 2)},
            }
            | changes
        )
    )


def polygon(n: int = 4, names: str = "abcd", turn: int = 1) -> am.Polygon:
    return am.Polygon(
        vertices=((0, 0), (1, 0), (1, 1), (0, 1))[:n][::turn], boundaries=tuple(names)
    )


@pytest.mark.parametrize(
    ("law", "limit", "friction"),
    [
        (am.Tresca(lambda x: 10.0 * x[:, 0]), [0.0, 10.0, 10.0], 0.0),
        (am.Coulomb(lambda x: 0.1 + x[:, 0]), 0.0, [0.1, 1.1, 2.1]),
        (am.Frictionless(), 0.0, 0.0),
    ],
)
def test_functions_are_taken_at_nodes_tractions_become_forces(law, limit, friction):
    points, weights = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]), np.array([0.5, 1.0, 0.5])
    bounds = law.at_nodes(points, weights).bounds(3)
    for values, expected in zip(bounds, (limit, friction), strict=True):
        np.testing.assert_allclose(values, np.broadcast_to(expected, 3))


# a plate with a quarter of a hole: the arc runs clockwise about its centre
HOLE = am.Outline(
    vertices=((1, 0), (3, 0), (3, 3), (0, 3), (0, 1)),
    boundaries=("x", "r", "t", "y", "hole"),
    arcs={4: (0, 0)},
)


def test_bounding_boxes():
    ball = am.Outline(
        vertices=[(3 * math.cos(a), 1 + 3 * math.sin(a)) for a in np.radians([10, 130, 250])],
        boundaries=("s",) * 3,
        arcs=dict.fromkeys(range(3), (0.0, 1.0)),
    )
    ring = am.Revolution(am.Rectangle(width=1, height=2, origin=(1, 0)), angle=90)
    cylinder = am.Cylinder((0, 0, 1), (0, 3, 0), 1, 2)
    for domain, lower, upper in (
        (am.Box(width=1, depth=2, height=3, origin=(1, 0, 0)), [1, 0, 0], [2, 2, 3]),
        (TWO, [0, -1], [2, 1]),
        (ball, [-3, -2], [3, 4]),
        (cylinder, [-1, 0, 0], [1, 2, 2]),
        (ring, [0, 0, 0], [2, 2, 2]),
        (am.Ball((1, 2, 3), 1), [0, 1, 2], [2, 3, 4]),
        (am.Extrusion(HOLE, 2, -1), [0, 0, -1], [3, 3, 1]),
        (am.Moved(cylinder, offset=(1, 0, 0), angle=90), [-1, -1, 0], [1, 1, 2]),
        (am.Fuse(cylinder, am.Ball((0, 0, 0), 2)), [-2, -2, -2], [2, 2, 2]),
        (am.Common(cylinder, am.Ball((0, 0, 0), 2)), [-1, 0, 0], [1, 2, 2]),
        (am.Cut(cylinder, am.Ball((0, 0, 0), 2)), [-1, 0, 0], [1, 2, 2]),
    ):
        np.testing.assert_allclose(
            [domain.lower, domain.upper], [lower, upper], rtol=1e-14, atol=1e-14
        )
    assert ball.area == pytest.approx(9 * math.pi)


def test_area_and_lengths_are_exact():
    assert HALF.area == pytest.approx(math.pi, rel=1e-14) and HALF.lengths == pytest.approx(
        (math.pi, 2.0, 2.0)
    )
    assert HOLE.area == pytest.approx(9 - math.pi / 4, rel=1e-14)
    assert HOLE.arc(4).angle < 0 < HALF.arc(0).angle and HOLE.arc(0) is None


def test_chords_are_inscribed():
    chords, edges, _ = HALF.chords()
    np.testing.assert_allclose(np.linalg.norm(chords[edges == 0] - [0, 2], axis=1), 2, rtol=1e-15)
    x, y = chords.T
    assert 0.998 * HALF.area < 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) < HALF.area
    assert np.bincount(edges).tolist() == [30, 1, 1]


def test_distance_to_an_arc():
    points = np.array([[0.0, 2.0], [3.0, -1.0], [0.0, -1.0], [0.0, 3.0], [-1.0, 0.0]])
    np.testing.assert_allclose(
        HALF.arc(0).distance(points), [2.0, 3 * math.sqrt(2) - 2, 1.0, math.hypot(2, 1), 1.0]
    )


def test_repeated_edge_names_become_one_boundary():
    polygon = am.Polygon(vertices=((0, 0), (1, 0), (0, 1)), boundaries=("a", "b", "a"))
    assert am.Assembly(parts={"p": polygon}).boundaries == ("p.a", "p.b")
    assert TWO.boundaries[:5] == (
        "upper.bottom",
        "upper.right",
        "upper.top",
        "upper.left",
        "lower.bottom",
    )


def test_names_of_a_problem():
    assert two(
        loads=(am.InitialStrain("upper", (1e-3, 0)), am.InitialStrain("lower", (0, 0, 1e-3)))
    ).loads
    posed = two(contact=(PAIR, am.Contact("lower.bottom", am.Plane((0.0, -1.0), (0.0, 1.0)))))
    assert posed.contact_boundaries == ("upper.bottom", "lower.bottom") and posed.masters == (
        "lower.top",
        "",
    )
    assert posed.pair_boundaries == ("upper.bottom", "lower.top", "lower.bottom")
    assert posed.bodies == ("upper", "lower") and posed.dim == 2 and not posed.axisymmetric
    assert two().contact == (PAIR,)


def test_bodies_without_a_domain():
    both = {"a": STEEL, "b": am.PlaneStress(young=1e7, poisson=0.45)}
    assert two(domain=None).bodies == () and two(domain=None, material=both).bodies == (
        "a",
        "b",
    )
    square = am.Rectangle(width=1, height=1)
    assert two(domain=square, contact=am.ContactPair("bottom", "top")).bodies == ("body",)

    class File(am.problem.Domain):
        dim, boundaries, bodies = 2, None, None

    assert two(domain=File(), material=both).bodies == ("a", "b")


@pytest.mark.filterwarnings("error")
def test_bodies_that_overlap_without_a_pair_are_named():
    """Nothing would separate them; where they only touch, or are a pair, there is no
    warning."""

    def posed(shift):
        places = {"low": (0.0, 0.0), "high": (0.0, 1.0), "third": (1.0 - shift, 0.0)}
        parts = {
            name: am.Rectangle(width=1.0, height=1.0, origin=origin)
            for name, origin in places.items()
        }
        return am.Hierarchy.uniform(
            two(
                domain=am.Assembly(parts=parts),
                contact=am.ContactPair("high.bottom", "low.top"),
                supports=(
                    am.Support("high.left", x=0.0),
                    am.Support("low.bottom", x=0.0, y=0.0),
                    am.Support("third.bottom", x=0.0, y=0.0),
                ),
            ),
            (4, 8),
        )

    posed(0.0)
    with pytest.warns(
        UserWarning, match=r"'low' and 'third' lie in each other, at \[.* not a contact pair"
    ):
        posed(0.3)


# -- single load steps, and supports that prescribe functions of position ---------------------------------------------


def bent(x):
    return 1e-3 * x[:, 1] ** 2


def loaded():
    return am.ContactProblem(
        material=am.PlaneStrain(young=2e11, poisson=0.3),
        law=am.Coulomb(0.3),
        domain=am.Rectangle(width=1, height=1),
        contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
        loads=(
            am.Pressure("right", bent),
            am.Traction("right", (3.0, 4.0)),
            am.BodyForce((0.0, -9.0)),
            am.InitialStrain("body", (1e-4, bent)),
            am.BodyForce((1.0, 2.0), body="body"),
        ),
        supports=(am.Support("left", x=bent), am.Support("top", y=-2e-4)),
    )


def test_steps_are_what_the_load_path_makes_of_the_problem():
    problem, mesh = loaded(), square(3, 1.0)
    factors = {"right": 0.5, "body force": 2.0, "body": -1.0, "left": 3.0, "top": 0.25}
    step, steps = (
        am.problem.step_problem(problem, factors),
        load_steps(Posed(problem, mesh), am.discretise(problem, mesh)),
    )
    np.testing.assert_allclose(
        am.discrete.load_vector(mesh, step.loads, step.material),
        steps.load(factors),
        rtol=1e-12,
        atol=1e-12 * np.abs(steps.load(factors)).max(),
    )
    np.testing.assert_allclose(
        am.discrete.fixed_dofs(mesh, step.supports)[1], steps.fixed_values(factors), rtol=1e-14
    )
    # the strain of a body counts beside other loads of its name
    strain = StressData.of(mesh, step.material, step.loads).initial_strain
    np.testing.assert_allclose(steps.stress_data(factors).initial_strain, strain, rtol=1e-12)
    assert np.abs(strain).max() > 0
    again = pickle.loads(pickle.dumps(step))
    np.testing.assert_array_equal(
        am.discrete.fixed_dofs(mesh, again.supports)[1],
        am.discrete.fixed_dofs(mesh, step.supports)[1],
    )
    same = am.problem.step_problem(problem, {})
    assert same.loads == problem.loads and same.supports == problem.supports


def test_a_solution_has_the_prescribed_function_in_every_step():
    problem = dataclasses.replace(loaded(), loads=(am.Pressure("right", 1e6),))
    grids = am.Hierarchy.uniform(problem, divisions=(4, 8))
    path = am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0], "top": [0.2, 1.0]}))
    nodes = grids.finest.mesh.boundary_nodes("left")
    y = grids.finest.mesh.points[nodes, 1]
    for result, factor in zip(path, (0.5, 1.0), strict=True):
        np.testing.assert_allclose(
            result.displacement[nodes, 0], factor * 1e-3 * y**2, rtol=1e-12, atol=1e-20
        )
    # where two meet they must agree, whether numbers or functions
    agreeing = (am.Support("left", x=bent), am.Support("top", x=lambda x: 1e-3 * x[:, 1]))
    assert am.discrete.fixed_dofs(square(4, 1.0), agreeing)[0].sum() == 9


VALUES = {
    r"f must be finite, got nan at \(2.0, 3.0\)": lambda: checks.field(
        "f", lambda x: np.where(x[:, 0] == 2, np.nan, 1), POINTS
    ),
    r">= 0.0, got -1.0 at \(0.0, 1.0\)": lambda: am.Coulomb(lambda x: x[:, 0] - 1).at_nodes(
        POINTS, np.ones(3)
    ),
    r"over the 3 contact nodes, got shape \(2,\)": lambda: am.Tresca(np.ones(2)).bounds(3),
    "2 or 3 components, got 1": lambda: am.BodyForce((1.0,)),
    "holds nothing": lambda: am.Support("left"),
    "has a z in a 2D problem": lambda: one(supports=(am.Support("left", z=0.0),)),
    "turn the normal": lambda: am.Plane((0.0, 0.0), (0.0, -1.0)).contact(POINTS, NORMALS),
    "normal must not be zero": lambda: am.Plane((0.0, 0.0), (0.0, 0.0)),
    "gap must be finite": lambda: am.GapFunction(lambda x: x[:, 0] * np.nan).contact(
        POINTS, NORMALS
    ),
    "allow_interference=True": lambda: am.ContactPair("a", "b", gap=-1e-6),
    "positive area": lambda: polygon(turn=-1),
    "each of the 4 edges, got 2": lambda: polygon(names="ab"),
    "at least 2 pairs": lambda: polygon(1, "a"),
    r"arcs\[0\] \('arc'\): the centre .* same distance": lambda: outline(arcs={0: (0, 1.9)}),
    "180 degrees": lambda: outline(arcs={0: (1, 1)}),
    "there are 3 edges": lambda: outline(arcs={3: (0, 2)}),
    "full circle": lambda: outline(vertices=((0, 0), (0, 0), (0, 2))),
    "parts is empty": lambda: am.Assembly(parts={}),
    r"must not contain '\.', got 'a\.b'": lambda: am.Assembly(parts={"a.b": SQUARE}),
    r"parts\['a'\] must be one body": lambda: am.Assembly(parts={"a": TWO}),
    "same dimension": lambda: am.Assembly(parts={"a": SQUARE, "b": CUBE}),
    "'bottom' is named twice": lambda: one(contact=(FLOOR, FLOOR)),
    "3 components in a 2D problem": lambda: one(loads=(am.BodyForce((0.0, 0.0, -1.0)),)),
    "use Solid in 3D": lambda: one(domain=CUBE),
    "'wall', used for a support, does not exist": lambda: one(
        supports=(am.Support("wall", x=0.0),)
    ),
    "is 3D, the material 2D": lambda: one(
        contact=am.Contact("bottom", am.Plane((0, 0, 0), (0, 0, 1)))
    ),
    "the bodies are 'upper', 'lower', material names 'upper'": lambda: two(
        material={"upper": STEEL}
    ),
    "all Axisymmetric": lambda: two(
        material={"upper": STEEL, "lower": am.Axisymmetric(young=1.0, poisson=0.3)}
    ),
    "'upper.bottom' is named twice": lambda: two(
        contact=(PAIR, am.ContactPair("upper.bottom", "lower.left"))
    ),
    "swap slave and master": lambda: two(contact=(PAIR, am.ContactPair("lower.top", "upper.left"))),
    "body 'middle', used for a load": lambda: two(loads=(am.BodyForce((0, 1), body="middle"),)),
    r"reaches to x = -0\.5 m": lambda: one(
        material=am.Axisymmetric(young=1.0, poisson=0.3),
        domain=am.Rectangle(width=1, height=1, origin=(-0.5, 0)),
    ),
    "2 components in a 3D problem": lambda: one(
        material=am.Solid(young=1.0, poisson=0.3),
        domain=CUBE,
        contact=am.ContactPair("top", "bottom"),
        loads=(am.InitialStrain("body", (1e-3, 0)),),
    ),
}
TYPES = {
    "must be evaluated at the nodes first": lambda: am.Tresca(lambda x: x[:, 0]).bounds(3),
    "belong on a DiscreteProblem": lambda: am.cases.greco_bar(law=am.Coulomb(np.ones(3))),
    "one a component": lambda: am.Traction("top", lambda x: x),
    "contact must be a sequence of Contact or ContactPair": lambda: two(contact="upper.bottom"),
    # an error of the user's generator
    "unsupported operand": lambda: two(contact=(None + number for number in (1, 2))),
}


test_refused = refused(
    (
        lambda: am.problem.step_problem(loaded(), {"roof": 1.0}),
        r"factors name 'roof'.* known are 'right', 'body force'",
    ),
    (
        lambda: am.problem.step_problem(loaded(), {"top": np.nan}),
        r"factors\['top'\] must be finite",
    ),
    (
        lambda: am.discrete.fixed_dofs(
            square(4, 1.0), (am.Support("left", x=bent), am.Support("top", x=2e-3))
        ),
        r"prescribe different x displacements, 0.001 and 0.002 m",
    ),
    *((make, message) for message, make in VALUES.items()),
    *((make, TypeError, message) for message, make in TYPES.items()),
)


@pytest.mark.parametrize(
    "contact",
    [
        PAIR,
        am.ContactPair("upper.left", "upper.right"),
        (PAIR, am.ContactPair("upper.left", "lower.top")),
        (PAIR, am.Contact("lower.top", am.Plane((0, 2), (0, -1)))),
    ],
    ids=["two bodies", "one body", "a common master", "master before an obstacle"],
)
def test_accepted(contact):
    assert two(contact=contact).dim == 2
