"""Contact nodes and the discretisation: normals, masses, gaps, ownership; refusals name body, pair,
boundary."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EXACT, bar_on_block, in_the_corner
from refused import refused

import adaptmg as am
from adaptmg.discrete.posed import Posed

SQUARE, CUBE = am.Rectangle(width=2.0, height=1.0), am.Box(width=2.0, depth=1.0, height=1.0)
PLATE, BLOCK = am.mesh.structured(SQUARE, 4), am.mesh.structured(CUBE, (4, 3, 2))
FLOOR = am.Plane(point=(0.0, 0.0), normal=(0.0, 1.0))
TOUCHING = am.GapFunction(lambda x: np.zeros(len(x)))


def plane_problem(**changes: object) -> am.ContactProblem:
    arguments = {
        "material": am.PlaneStrain(young=1e9, poisson=0.3),
        "contact": am.Contact("bottom", FLOOR),
        "law": am.Frictionless(),
        "loads": (am.Pressure("top", 1e5),),
        "name": "plate",
        "supports": (am.Support("left", x=0.0),),
    }
    return am.ContactProblem(**(arguments | changes))


def solid_problem(**changes: object) -> am.ContactProblem:
    arguments = {
        "material": am.Solid(young=1e9, poisson=0.3),
        "law": am.Frictionless(),
        "contact": am.Contact("bottom", am.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))),
    }
    return am.ContactProblem(**(arguments | changes))


@pytest.mark.parametrize(
    ("problem", "mesh", "measure"),
    [(plane_problem(), PLATE, 2.0), (solid_problem(), BLOCK, 2.0)],
)
def test_contact_nodes_of_a_flat_boundary(problem, mesh, measure):
    nodes = Posed.of(problem, mesh).contact
    np.testing.assert_array_equal(nodes.nodes, mesh.boundary_nodes("bottom"))
    np.testing.assert_allclose(
        nodes.normals, np.tile([0.0] * (mesh.dim - 1) + [-1.0], (len(nodes), 1))
    )
    assert nodes.weights.sum() == pytest.approx(measure)
    assert nodes.weights @ mesh.points[nodes.nodes, 0] == pytest.approx(measure)
    assert not nodes.gaps.any() and nodes.names == ("bottom",) and not nodes.boundary.any()


@pytest.mark.parametrize("scale", [1e-4, 1e4])
def test_rounding_of_turned_points_is_not_an_overlap(scale):
    turn = scale * np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    mesh = replace(PLATE, points=PLATE.points @ turn.T)
    plane = am.Plane(turn @ [0.3, 0.0], turn @ [0.0, 1.0])
    problem = plane_problem(contact=am.Contact("bottom", plane), supports=())
    nodes = Posed.of(problem, mesh).contact
    assert len(nodes) == 5
    np.testing.assert_allclose(nodes.gaps, 0.0, atol=1e-12 * scale)


@pytest.mark.parametrize("angle", [0.1, 0.5, 0.9, 2.1, 4.1])
def test_a_side_at_a_right_angle_to_a_plane_does_not_face_away(angle):
    """It faces along the plane, but for rounding, which has either sign at turned sides."""
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    mesh = replace(PLATE, points=PLATE.points @ turn.T)
    plane = am.Plane(turn @ [0.0, -0.5], turn @ [0.0, 1.0])
    problem = plane_problem(contact=am.Contact("right", plane), supports=())
    nodes = Posed.of(problem, mesh).contact
    np.testing.assert_allclose(nodes.gaps, 0.5 + PLATE.points[nodes.nodes, 1], rtol=0, atol=1e-12)


def test_gaps_of_contact_nodes():
    # the plane through (0, -1) rising at 45 degrees is met along its own normal
    plane = am.Plane(point=(0.0, -3.0), normal=(-1.0, 1.0))
    nodes = Posed.of(plane_problem(contact=am.Contact("bottom", plane), supports=()), PLATE).contact
    np.testing.assert_allclose(nodes.normals, np.tile([[1.0, -1.0]], (5, 1)) / np.sqrt(2))
    np.testing.assert_allclose(nodes.gaps, (3.0 - PLATE.points[nodes.nodes, 0]) / np.sqrt(2))
    _, behind = am.Plane((0.0, -1.0), (0.0, 2.0)).contact(
        PLATE.points[:1] - [[0.0, 2.0]], nodes.normals[:1]
    )
    assert behind.tolist() == [-1.0]
    # rounding is not an overlap
    for gap, interference, least in (
        (lambda x: np.full(len(x), -1e-14), False, 0.0),
        (lambda x: 0.5 - x[:, 0], True, -1.5),
    ):
        contact = am.Contact("bottom", am.GapFunction(gap), allow_interference=interference)
        assert Posed.of(plane_problem(contact=contact), PLATE).contact.gaps.min() == least


@pytest.mark.parametrize("order", [("bottom", "right"), ("right", "bottom")])
def test_common_node_belongs_to_the_boundary_named_first(order):
    contact = tuple(am.Contact(name, TOUCHING) for name in order)
    nodes = Posed.of(plane_problem(contact=contact, loads=(), supports=()), PLATE).contact
    assert nodes.names == order
    corner = np.flatnonzero((PLATE.points[nodes.nodes] == [2.0, 0.0]).all(axis=1))[0]
    assert nodes.boundary[corner] == 0
    expected = {"bottom": [0.0, -1.0], "right": [1.0, 0.0]}[order[0]]
    np.testing.assert_allclose(nodes.normals[corner], expected)
    # the edge round the corner does not face the obstacle: half an edge of the first boundary
    # is the mass
    assert nodes.weights[corner] == pytest.approx(0.25 if order[0] == "bottom" else 0.125)


def test_symmetry_planes_take_the_tilt_out_of_the_normal():
    """A quarter of a ring with radii 1 (bottom) and 1/2, from x = 0 (left) on."""
    flat = am.mesh.structured(am.Rectangle(width=1.0, height=1.0), (8, 3))
    angle, radius = flat.points[:, 0] * np.pi / 2, 1 - flat.points[:, 1] / 2
    points = np.column_stack([radius * np.sin(angle), -radius * np.cos(angle)])
    points[flat.boundary_nodes("left"), 0] = 0.0
    mesh = replace(flat, points=points)
    nodes = Posed.of(plane_problem(contact=am.Contact("bottom", TOUCHING), loads=()), mesh).contact
    np.testing.assert_allclose(nodes.normals[:-1], mesh.points[nodes.nodes][:-1], atol=1e-12)


class Wrong:
    def contact(self, points, normals):
        return normals[:1], np.zeros(len(points))


# the same two nodes seen from both sides
CRACKED = am.MeshArrays(
    PLATE.points,
    PLATE.elements,
    np.vstack([PLATE.facets, [[0, 1], [1, 0]]]),
    np.r_[PLATE.facet_labels, 4, 4],
    (*PLATE.boundaries, "crack"),
)
DEEP = am.GapFunction(lambda x: np.full(len(x), -0.1))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"contact": am.Contact("bottom", am.GapFunction(lambda x: 0.5 - x[:, 0]))},
            r"'bottom' lies up to 1\.5 m behind its obstacle, at \(2\.0, 0\.0\)",
        ),
        (
            {
                "contact": (
                    am.Contact("bottom", DEEP, allow_interference=True),
                    am.Contact("top", DEEP),
                ),
                "loads": (),
                "supports": (),
            },
            r"'top' lies up to 0\.1 m",
        ),
        (
            {"supports": (am.Support("bottom", y=0.0),)},
            "support on 'bottom' fixes a component with a part normal to contact boundary",
        ),
        (
            {"contact": am.Contact("crack", TOUCHING), "loads": ()},
            "contact boundary 'crack': the surface has no normal at node 0",
        ),
        (
            {"contact": am.Contact("bottom", Wrong())},
            "obstacle in front of 'bottom': its normals must have shape",
        ),
    ],
)
def test_refusals(changes, message):
    with pytest.raises(ValueError, match=message):
        _ = Posed.of(plane_problem(**changes), CRACKED).contact


def test_what_a_problem_becomes_on_a_mesh():
    problem = am.discretise(plane_problem(), PLATE)
    assert problem.name == "plate, 25 nodes" and problem.n_dofs == 50
    np.testing.assert_array_equal(problem.coordinates, PLATE.points)
    assert problem.near_nullspace.shape == (50, 3) and problem.fixed.sum() == 5
    assert problem.load.reshape(-1, 2).sum(axis=0) == pytest.approx([0.0, -2e5])
    displacement = np.arange(PLATE.points.size, dtype=float).reshape(-1, 2)
    contact = am.discretise(plane_problem(), PLATE, slip_reference=displacement).contact
    np.testing.assert_array_equal(contact.slip_reference, displacement[contact.nodes])
    with pytest.raises(ValueError, match=r"slip_reference must have shape \(\d+, 2\)"):
        am.discretise(plane_problem(), PLATE, slip_reference=displacement[:3])
    # laws become nodal
    tresca = am.discretise(plane_problem(law=am.Tresca(lambda x: 1e3 * (1 + x[:, 0]))), PLATE)
    np.testing.assert_allclose(
        tresca.law.bounds(5)[0], 1e3 * tresca.contact.weights * [1.0, 1.5, 2.0, 2.5, 3.0]
    )
    coulomb = am.discretise(plane_problem(law=am.Coulomb(lambda x: x[:, 0] / 4)), PLATE)
    np.testing.assert_allclose(coulomb.law.bounds(5)[1], [0.0, 0.125, 0.25, 0.375, 0.5])


test_wrong_problems_and_meshes_are_refused = refused(
    (
        lambda: am.discretise(plane_problem(), BLOCK),
        "the mesh is 3D, the problem 'plate' 2D",
    ),
    (lambda: am.discretise(PLATE, PLATE), TypeError, "problem must be a ContactProblem"),
    (
        lambda: am.discretise(plane_problem(), PLATE.source),
        TypeError,
        "mesh must be MeshArrays",
    ),
    (
        lambda: am.discretise(plane_problem(loads=(am.Pressure("roof", 1.0),)), PLATE),
        "'roof', used for a load, does",
    ),
)


@pytest.mark.parametrize(
    "law", [am.Coulomb(lambda p: 0.2 + p[:, 0]), am.Tresca(3e6)], ids=["Coulomb", "Tresca"]
)
def test_a_subclass_of_a_law_keeps_its_bounds(law):
    class Half(type(law)):
        whole: "Half | None" = None  # a name that only type checkers know

        def bounds(self, n_contact):
            limit, friction = super().bounds(n_contact)
            return 0.5 * limit, 0.5 * friction

    whole, half = (
        am.Hierarchy.uniform(am.cases.greco_bar(law=one), (2,)).finest.discrete.law.bounds(3)
        for one in (law, Half(*vars(law).values()))
    )
    assert max(map(np.max, whole)) > 0
    for one, other in zip(whole, half, strict=True):
        np.testing.assert_array_equal(0.5 * one, other)


BAR = am.PlaneStrain(young=1.3e11, poisson=0.2)
PAIR = ("upper.bottom", "lower.top")


def posed(**changes):
    return replace(bar_on_block(am.Frictionless()), **changes)


def mesh_of(lift=0.0, bodies=("upper", "lower")):
    """The bar ``lift`` above the block."""
    parts = {name: am.mesh.structured(posed().domain.parts[name], 4) for name in ("upper", "lower")}
    upper = parts["upper"]
    parts["upper"] = replace(upper, points=upper.points + np.array([0.0, lift]))
    parts["other"] = parts["upper"]
    return am.mesh.merged({name: parts[name] for name in bodies})


BOXES = {
    "upper": am.Box(width=1.0, depth=1.0, height=1.0, origin=(0.0, 0.0, 0.99)),
    "lower": am.Box(width=1.0, depth=1.0, height=1.0),
}


def in_3d(*pair, **options):
    problem = posed(
        material=am.Solid(young=1e11, poisson=0.3),
        contact=am.ContactPair(*pair, **options),
        loads=(),
        domain=am.Assembly(parts=BOXES),
        supports=(am.Support("lower.bottom", x=0.0, y=0.0, z=0.0),),
    )
    return am.discretise(problem, am.mesh.structured(problem.domain, {"upper": 2, "lower": 3}))


def faced(*pair, **options):
    return am.discretise(
        posed(
            contact=am.ContactPair(*pair, **options), supports=(am.Support("lower.left", x=0.0),)
        ),
        mesh_of(2e-3),
    )


def circle():
    """Corners that follow each other."""
    mesh, problem, _ = in_the_corner(("floor", "wall", "cap"), am.Frictionless())
    pairs = (
        am.ContactPair("block.bottom", "seat.floor"),
        am.ContactPair("seat.wall", "block.left"),
        am.ContactPair("cap.bottom", "block.top"),
    )
    return am.discretise(
        replace(problem, contact=pairs, supports=(am.Support("seat.bottom", x=0.0, y=0.0),)), mesh
    )


def nodes_that_do_not_match():
    problem = posed(contact=am.ContactPair(*PAIR, coupling="nodes"))
    return am.discretise(problem, am.mesh.structured(problem.domain, {"upper": 4, "lower": 5}))


def held(*supports, mesh=None, **changes):
    return am.solve(
        am.discretise(posed(supports=supports, **changes), mesh_of() if mesh is None else mesh)
    )


def with_gap(gap):
    return am.discretise(posed(contact=am.ContactPair(*PAIR, gap=gap)), mesh_of())


THREE = ("upper", "lower", "other")
AXIAL = am.Axisymmetric(young=1e11, poisson=0.3)
NAMED = r"'upper.bottom' on 'lower.top'"


FAINT = (am.Pressure("top", 1e-150),)
test_loads_whose_energies_underflow_are_refused = refused(
    (
        lambda: am.discretise(plane_problem(loads=FAINT), PLATE),
        "load: its largest entry .* is out of range",
    ),
    (
        lambda: am.Hierarchy.from_meshes(plane_problem(), [PLATE]).with_problem(
            plane_problem(loads=FAINT)
        ),
        "load: its largest entry .* is out of range",
    ),
)
test_refusals_of_bodies = refused(
    # places
    (
        lambda: am.discretise(posed(domain=None), mesh_of(-1e-3)),
        NAMED + r".*overlap by up to 0.001 m.*at \(.*apart",
    ),
    (
        lambda: faced("upper.bottom", "lower.bottom"),
        "'upper.bottom' on 'lower.bottom': the surfaces never face",
    ),
    (
        lambda: faced("upper.left", "lower.top"),
        "'upper.left' on 'lower.top': the surfaces never face",
    ),
    (lambda: faced(*PAIR, reach=1e-3), NAMED + ": the surfaces never face"),
    (lambda: in_3d(*PAIR), NAMED + ": the bodies overlap by up to 0.01 m"),
    (
        lambda: in_3d("upper.top", "lower.bottom", reach=0.5),
        "'upper.top' on 'lower.bottom': the surfaces never face",
    ),
    (nodes_that_do_not_match, NAMED + ": slave node .* has no partner.*mortar"),
    # gaps
    (
        lambda: with_gap(lambda x: x[:, 0] - 0.02),
        NAMED + ".*the bodies overlap by up to 0.02 m.*allow_interference",
    ),
    (lambda: with_gap(lambda x: x), NAMED + r".*must return shape \(5,\)"),
    (lambda: with_gap(lambda x: np.nan * x[:, 0]), NAMED + ".*must be finite, got nan"),
    # what holds bodies
    (
        lambda: am.discretise(posed(material=BAR, domain=None), mesh_of(bodies=THREE)),
        r"nothing holds body 'other': no support and no contact",
    ),
    (
        lambda: am.solve(
            am.discretise(posed(loads=(am.Traction("upper.top", (0.0, 1e6)),)), mesh_of())
        ),
        r"nothing holds.*translation along y of body 'upper'",
    ),
    (
        lambda: held(
            am.Support("lower.bottom", x=0.0, y=0.0), loads=(am.Pressure("upper.top", 1e6),)
        ),
        r"not unique.*translation along x of body 'upper'",
    ),
    (lambda: held(am.Support("upper.top", x=0.0, y=0.0)), "body 'lower'"),
    (
        lambda: held(am.Support("upper.bottom", y=0.0), am.Support("lower.bottom", y=0.0)),
        r"'upper.bottom' fixes a component.*'upper.bottom', at node",
    ),
    # pairs
    (circle, r"follow each other in a circle.*exchange slave and master"),
    # names
    (
        lambda: am.discretise(
            posed(domain=None, contact=am.ContactPair("uper.bottom", "lower.top")), mesh_of()
        ),
        r"'uper.bottom', used for contact.*did you mean 'upper.bottom'\?",
    ),
    (
        lambda: am.Hierarchy.uniform(posed(), [{"upper": 2, "lowr": 2}, 4]),
        r"divisions must name each body once.*'upper', 'lowr'",
    ),
    (
        lambda: am.discretise(posed(domain=None), mesh_of(bodies=THREE)),
        r"bodies are 'upper', 'lower', 'other', material names 'upper', 'lower'",
    ),
    (lambda: posed(material=AXIAL), r"x = -0.02 m, but x is the radius"),
)


def test_gaps_and_interference():
    assert am.discretise(posed(domain=None), mesh_of(1e-3)).contact.gaps == pytest.approx(1e-3)
    # with the flag what overlaps is pressed apart
    problem = posed(domain=None, contact=am.ContactPair(*PAIR, allow_interference=True))
    result = am.solve(am.discretise(problem, mesh_of(-1e-5)), EXACT)
    assert result.contact.gap.min() >= 0
    for name in ("nothing", ""):
        with pytest.raises(ValueError, match=f"'{name}' is not known; known are 'contact'"):
            result.resultant(name)


@pytest.mark.parametrize("pair", [("round.contact", "block.top"), ("block.top", "round.contact")])
@pytest.mark.parametrize(
    "at_the_end", [True, False], ids=["pole at the end of the surface", "pole within a facet"]
)
def test_a_cylinder_that_touches_a_block_does_not_overlap_it(at_the_end, pair):
    """The mean of a distance >= 0 with a dual function, which changes sign, may be negative; that
    is not an overlap."""
    radius, size, left = 0.05, 0.01, 0.0 if at_the_end else -0.1
    for sunk in (0.0, 4e-3):
        centre = (0.0, radius - sunk)
        angles = np.radians([0.0, 45.0, 90.0] if at_the_end else [-90.0, -40.0, 40.0, 90.0])
        arc = [(radius * np.sin(a), centre[1] - radius * np.cos(a)) for a in angles]
        names = (
            ("contact", "side", "top", "axis") if at_the_end else ("side", "contact", "side", "top")
        )
        cylinder = am.Outline(
            vertices=[*arc, centre] if at_the_end else arc,
            boundaries=names,
            arcs={i: centre for i in range(len(arc) - 1)},
        )
        domain = am.Assembly(
            parts={
                "round": cylinder,
                "block": am.Rectangle(width=0.1 - left, height=radius, origin=(left, -radius)),
            }
        )
        problem = am.ContactProblem(
            material=am.PlaneStrain(young=1e9, poisson=0.3),
            domain=domain,
            law=am.Frictionless(),
            contact=am.ContactPair(*pair),
            supports=(
                am.Support("round.axis" if at_the_end else "round.top", x=0.0),
                am.Support("block.bottom", x=0.0, y=0.0),
            ),
        )
        mesh = am.mesh.graded(domain, {"round": size, "block": 1.7 * size}, pair)
        if not sunk:
            assert Posed.of(problem, mesh).contact.gaps.min() >= 0
            continue
        with pytest.raises(ValueError, match="overlap by up to"):
            _ = Posed.of(problem, mesh).contact


def test_a_whole_disc_lies_on_a_plane():
    """Its back faces away from the plane; the half width of contact is that of Hertz."""
    along = np.array([np.cos(2.9), np.sin(2.9)])
    normal = np.array([-along[1], along[0]])
    centre, radius, force, young, poisson = np.array([3.0, -1.0]), 0.01, 4e6, 2e11, 0.3
    disc = am.Circle(tuple(centre), radius)

    def on(plane):
        return am.ContactProblem(
            domain=disc,
            material=am.PlaneStrain(young=young, poisson=poisson),
            contact=am.Contact(disc.boundaries[0], plane),
            law=am.Coulomb(0.3),
            loads=[am.BodyForce(tuple(-force / (np.pi * radius**2) * normal))],
        )

    plane = am.Plane(centre - radius * normal, normal)
    result = am.solve(am.Hierarchy.graded(on(plane), sizes=(2e-3, 1e-3), contact_ratio=16))
    np.testing.assert_allclose(result.resultant("contact").force, force * normal, rtol=1e-2)
    closed = np.sort((result.contact.x @ along)[result.contact.closed])
    half_width = np.sqrt(4 * force * radius * (1 - poisson**2) / (np.pi * young))
    assert len(closed) > 9
    assert abs(np.ptp(closed) / 2 - half_width) < 2 * np.diff(closed).max()
    with pytest.raises(ValueError, match="turn the normal"):
        am.Hierarchy.graded(on(am.Plane(plane.point, -normal)), sizes=(2e-3,))
