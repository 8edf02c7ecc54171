"""Rigid-body statics: what contact can hold passes, what it cannot is named; friction with several
solutions."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy import sparse

import adaptmg as am
from adaptmg.solver.statics import check_statics, critical_friction

FLOOR = am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0)))
GROUND = am.Contact("bottom", am.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))
TOUCHING = am.GapFunction(lambda x: np.zeros(len(x)))
PLATE = am.mesh.structured(am.Rectangle(width=4.0, height=1.0), (8, 2))
BLOCK = am.mesh.structured(am.Box(width=4.0, depth=4.0, height=1.0), (6, 6, 1))


def posed(
    mesh, material, contact, law=am.Frictionless(), loads=(am.Pressure("top", 1.0),), supports=()
):
    return am.discretise(
        am.ContactProblem(
            material=material(young=1e3, poisson=0.3),
            contact=contact,
            law=law,
            loads=loads,
            supports=supports,
        ),
        mesh,
    )


plate = partial(posed, PLATE, am.PlaneStrain, contact=FLOOR)
block = partial(posed, BLOCK, am.Solid, contact=GROUND)


def weight(*direction: float) -> tuple[am.BodyForce]:
    return (am.BodyForce(direction),)


LEFT, TIPPING = (
    (am.Support("left", x=0.0),),
    (am.Pressure("top", 0.3), am.Traction("left", (0.0, 1.0))),
)
SIDES = (am.Support("left", x=0.0), am.Support("front", y=0.0))
SPIN = (
    am.Pressure("top", 1.0),
    am.Traction("top", (lambda x: -(x[:, 1] - 2), lambda x: x[:, 0] - 2, 0.0)),
)

#: what stands
STANDING = {
    "on supports": plate(
        loads=weight(3.0, 5.0),
        supports=(*LEFT, am.Support("right", x=0.0), am.Support("top", y=0.0)),
    ),
    "between support and floor": plate(supports=LEFT),
    "by friction": plate(law=am.Coulomb(0.01)),
    "by adhesion": plate(law=am.Tresca(1e-3)),
    "without any load": plate(loads=(), supports=(*LEFT, am.Support("top", y=-1e-3))),
    "by friction at one node": plate(law=am.Coulomb(lambda x: np.where(x[:, 0] == 2.0, 0.1, 0.0))),
    "enclosed": plate(
        loads=(), contact=tuple(am.Contact(name, TOUCHING) for name in PLATE.boundaries)
    ),
    "above a gap": plate(
        contact=am.Contact("bottom", am.Plane(point=(0.0, -1.0), normal=(0.0, 1.0))), supports=LEFT
    ),
    **{
        f"loads {size:g}": plate(law=am.Coulomb(0.5), loads=weight(0.4 * size, -abs(size)))
        for size in (1e-9, -1e9)
    },
    # 4 m of contact under a limit of .25 bear a side load of 1 on 4 m2
    "below the limit": plate(law=am.Tresca(0.25), loads=weight(0.25 * 0.999, -1.0)),
    "below the limit, free in one direction": plate(
        law=am.Tresca(0.25),
        loads=weight(0.25 * 0.999, 0.0),
        supports=(am.Support("top", y=0.0),),
    ),
    # weight 1 on 4 m2 at lever 2 m against a push at lever 1/2 m: tips about the right foot beyond
    # slope 4
    "about to tip": plate(law=am.Coulomb(5.0), loads=weight(3.99, -1.0)),
    "solid between supports": block(supports=SIDES),
    "solid by friction": block(law=am.Coulomb(0.1)),
    "solid by adhesion": block(law=am.Tresca(0.1)),
    "solid that does not spin": block(law=am.Coulomb(2.0), loads=SPIN),
    "solid about to tip": block(law=am.Coulomb(9.0), loads=weight(3.9, 0.0, -1.0)),
}

#: what does not, and the motion that is named
FALLING = {
    "lifted": (
        plate(loads=weight(0.0, 1.0), supports=LEFT),
        "nothing holds a translation along y: the supports leave it free",
    ),
    "pushed": (plate(loads=weight(-0.01, -1.0)), "nothing holds a translation along -x"),
    "free to slide": (plate(), "the solution is not unique: a translation along x is left free"),
    "beyond the limit": (
        plate(law=am.Tresca(0.25), loads=weight(0.25 * 1.001, -1.0)),
        "holds a translation along x",
    ),
    "beyond the limit, free in one direction": (
        plate(
            law=am.Tresca(0.25),
            loads=weight(0.25 * 1.001, 0.0),
            supports=(am.Support("top", y=0.0),),
        ),
        "holds a translation along x",
    ),
    "tipped": (
        plate(law=am.Coulomb(5.0), loads=weight(4.01, -1.0)),
        r"nothing holds a rotation about \(4, 0\)",
    ),
    # 1.2 down at x = 2 and 1 up at x = 0: .2 down at x = 12, beyond the right foot
    "pulled up at one end": (
        plate(law=am.Coulomb(1.0), loads=TIPPING),
        "nothing holds a rotation about",
    ),
    "no load": (
        plate(loads=(), supports=LEFT),
        "nothing presses the body against its obstacle: a translation along y",
    ),
    # there is no load with which limits of friction could be compared
    **{
        f"no load, between walls that bear {limit:g} Pa": (
            plate(
                law=am.Tresca(limit),
                loads=(),
                contact=tuple(am.Contact(name, TOUCHING) for name in ("bottom", "left", "right")),
            ),
            "nothing presses the body against its obstacle: a translation along y",
        )
        for limit in (1e-9, 1.0, 1e9)
    },
    "squeezed": (
        plate(law=am.Coulomb(0.5), loads=(am.Pressure("left", 1.0), am.Pressure("right", 1.0))),
        "nothing presses the body",
    ),
    **{
        f"loads {size:g}": (
            plate(law=am.Coulomb(0.5), loads=weight(0.6 * size, -abs(size))),
            "nothing holds",
        )
        for size in (1e-9, -1e9)
    },
    "solid free to slide": (block(supports=SIDES[:1]), "not unique: a translation along y"),
    "solid lifted": (
        block(law=am.Coulomb(1.0), loads=weight(0.0, 0.0, 1.0)),
        "nothing holds a translation along z",
    ),
    "solid spun": (
        block(law=am.Coulomb(0.1), loads=SPIN),
        "rotation about the axis along z through",
    ),
    "solid tipped": (
        block(law=am.Coulomb(9.0), loads=weight(4.1, 0.0, -1.0)),
        "rotation about the axis along y through",
    ),
}


def pin(law):
    """Return a whole disc in a hole that it nearly fills, pressed down by its weight."""
    problem = am.ContactProblem(
        domain=am.Circle((0.3, 0.2), 0.02, "side"),
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        law=law,
        contact=am.Contact("side", am.GapFunction(lambda x: np.full(len(x), 1e-6))),
        loads=[am.BodyForce((0.0, -1e5))],
    )
    return am.Hierarchy.graded(problem, sizes=(8e-3,)).finest.discrete


def test_the_error_for_a_round_body_that_turns_freely_says_how_to_hold_it():
    """It has no natural node to hold: the message names what helps, and a little friction does."""
    with pytest.raises(ValueError, match=r"rotation about .* half of a round body, or .* friction"):
        check_statics(pin(am.Frictionless()))
    check_statics(pin(am.Coulomb(0.01)))
    with pytest.raises(ValueError, match=r"along x is left free.*fixes it$"):
        check_statics(plate())


@pytest.mark.parametrize("name", STANDING)
def test_what_contact_and_supports_hold_passes(name):
    check_statics(STANDING[name])


@pytest.mark.parametrize("name", FALLING)
def test_a_motion_that_nothing_holds_is_named(name):
    problem, message = FALLING[name]
    with pytest.raises(ValueError, match=message):
        check_statics(problem)


@pytest.mark.parametrize("direction", np.linspace(0, np.pi / 2, 4))
@pytest.mark.parametrize("law", [am.Coulomb(0.5), am.Tresca(0.5)])
def test_sliding_in_any_direction(direction, law):
    # the polygon with 16 sides is at most 1 / cos(pi / 16) = 1.02 too wide; weight 16 on 16 m2
    side = np.array([np.cos(direction), np.sin(direction)])
    check_statics(block(law=law, loads=weight(*(0.4999 * side), -1.0)))
    with pytest.raises(ValueError, match="nothing holds"):
        check_statics(block(law=law, loads=weight(*(0.511 * side), -1.0)))


@pytest.mark.parametrize("angle", [20.0, 40.0])
@pytest.mark.parametrize("law", [am.Coulomb(0.3), am.Tresca(1e-3), am.Frictionless()])
def test_a_slope_that_is_too_steep_is_named_with_its_tangent(angle, law):
    slope = np.radians(angle)
    problem = plate(law=law, loads=weight(np.sin(slope), -np.cos(slope)))
    required = (
        f"without friction of about {np.tan(slope):.3g} or more, the tangent of {angle:g} degrees;"
    )
    with pytest.raises(ValueError, match=required):
        check_statics(problem)


def test_motions_are_found_without_coordinates():
    lifted, turning = plate(loads=weight(0.0, 1.0)), plate(law=am.Coulomb(1.0), loads=TIPPING)
    check_statics(replace(lifted, coordinates=None, near_nullspace=None))
    for problem, motion in (
        (lifted, "translation along y"),
        (turning, r"motion \(a combination of near_nullspace\)"),
    ):
        with pytest.raises(ValueError, match=f"nothing holds a {motion}"):
            check_statics(replace(problem, coordinates=None))


def test_modes_need_not_be_orthonormal():
    problem = plate(law=am.Coulomb(0.5), loads=weight(0.4, -1.0))
    mixed = problem.near_nullspace @ np.array([[1.0, 2, 3, 4], [0, 5.0, 6, 1], [0, 0, 1e3, 1]])
    check_statics(replace(problem, near_nullspace=mixed))
    with pytest.raises(ValueError, match="nothing holds"):
        check_statics(replace(problem, near_nullspace=mixed, load=-problem.load))


def test_modes_may_be_other_than_rigid_motions():
    # in skew coordinates of the user's: nothing is known about the shape of the motion, but it
    # is found
    problem = plate(law=am.Coulomb(1.0), loads=TIPPING)
    shaken = problem.coordinates + np.random.default_rng(0).random(problem.coordinates.shape)
    with pytest.raises(ValueError, match=r"nothing holds a motion \(a combination"):
        check_statics(replace(problem, coordinates=shaken))


def test_springs_hold():
    problem = plate(loads=weight(0.0, 1.0))
    springs = np.zeros(problem.n_dofs)
    springs[:4] = springs[-4:] = 1.0
    held = replace(problem, matrix=problem.matrix + sparse.diags_array(springs))
    am.solve(held)
    held.matrix.data[...] = problem.matrix.data  # by a user, who removes the springs
    with pytest.raises(ValueError, match="nothing holds"):
        am.solve(held)
    springs[1::2] = 0.0
    with pytest.raises(ValueError, match="nothing holds a translation along y"):
        check_statics(replace(problem, matrix=problem.matrix + sparse.diags_array(springs)))


def test_a_body_without_nodes_does_not_hide_what_is_free():
    problem = plate(law=am.Frictionless(), loads=TIPPING)
    bodies = {"plate": np.arange(problem.n_nodes), "none": []}
    with pytest.raises(ValueError, match="nothing holds"):
        check_statics(replace(problem, bodies=bodies))


def next_to(one, matrix, load, points):
    """Return a problem with further nodes, of this matrix and load, that nothing fixes."""
    return am.DiscreteProblem(
        matrix=sparse.block_diag([one.matrix, matrix], format="csr"),
        load=np.r_[one.load, load],
        fixed=np.r_[one.fixed, np.zeros(len(load), dtype=bool)],
        law=am.Frictionless(),
        contact=am.ContactNodes(
            nodes=one.contact.nodes, normals=one.contact.normals, gaps=one.contact.gaps
        ),
        coordinates=np.vstack([one.coordinates, points]),
    )


def test_two_bodies_are_checked_one_by_one():
    """A pressed plate, and a second one that no support and no contact holds."""
    one = plate(supports=LEFT)
    n = one.n_dofs
    pair = next_to(one, one.matrix, np.zeros(n), one.coordinates + 10.0)
    with pytest.raises(ValueError, match=f"not unique: .* of the body of node {n // 2} "):
        check_statics(pair)
    check_statics(replace(pair, fixed=pair.fixed | (np.arange(2 * n) >= n)))
    with pytest.raises(
        ValueError, match="nothing holds a translation along -x of the body of node"
    ):
        check_statics(replace(pair, load=np.r_[one.load, np.tile([-1.0, 0.0], n // 2)]))


def test_nodes_without_neighbours_are_not_bodies():
    # nodes decoupled from all others (eliminated by the user, say) are held by their own
    # diagonal
    check_statics(next_to(plate(supports=LEFT), sparse.eye_array(6), np.ones(6), np.zeros((3, 2))))


@pytest.fixture(scope="module")
def strut():
    return am.Hierarchy.graded(
        am.cases.leaning_strut(), sizes=(20e-3, 10e-3, 5e-3), contact_ratio=2
    )


def with_friction(grids, law):
    return am.Hierarchy.from_meshes(
        replace(grids.problem, law=law), [level.mesh for level in grids.levels]
    )


@pytest.mark.filterwarnings("ignore:friction:RuntimeWarning")
def test_the_strut_has_three_equilibria(strut):
    related = [
        am.solve(with_friction(strut, law), am.ActiveSet())
        for law in (am.Tresca(1e6), am.Frictionless())
    ]
    found = [
        am.solve(strut, am.ActiveSet(rtol=1e-9, start="held")),
        *(am.solve(strut, am.ActiveSet(rtol=1e-9), start=start) for start in related),
    ]
    touching = [result.contact.state[result.contact.state != am.OPEN].tolist() for result in found]
    assert touching == [[am.STICK], [am.SLIP], []]
    for result in found:
        # each is one: Newton steps from it stay, and the conditions of contact hold
        assert result.residual <= 1e-7
        again = am.solve(strut, am.ActiveSet(rtol=1e-10), start=result)
        assert (
            np.abs(again.displacement - result.displacement).max()
            <= 1e-6 * np.abs(result.displacement).max()
        )


@pytest.mark.filterwarnings("error")
def test_a_warning_says_so_but_not_where_friction_is_small(strut):
    with pytest.warns(RuntimeWarning, match="may not be unique.*start"):
        am.solve(strut, am.ActiveSet())
    am.solve(with_friction(strut, am.Coulomb(0.1)), am.ActiveSet())


def test_the_estimate_against_the_compliance(strut):
    """From solves with unit forces at a node, on the matrix alone."""
    discrete = strut[1].discrete
    critical = critical_friction(discrete)
    free = np.flatnonzero(~discrete.fixed)
    matrix = discrete.matrix.toarray()[np.ix_(free, free)]
    for i in (0, len(critical) // 2):
        dofs = 2 * discrete.contact.nodes[i] + np.arange(2)
        n = discrete.contact.normals[i]
        frame = np.array([n, [-n[1], n[0]]])
        unit = np.zeros((len(free), 2))
        unit[np.searchsorted(free, dofs)] = frame.T
        stiffness = np.linalg.inv(unit.T @ np.linalg.solve(matrix, unit))
        assert critical[i] == pytest.approx(stiffness[1, 1] / abs(stiffness[0, 1]), rel=1e-8)
    # a body that contact holds has none
    assert np.isnan(
        critical_friction(am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4)).finest.discrete)
    ).all()


def test_a_disc_that_slides_at_the_limit_of_friction_is_warned_of():
    angles = np.pi * (1 + np.linspace(0, 1, 48))
    arc = [(float(np.cos(a)), float(1 + np.sin(a))) for a in angles]
    problem = am.ContactProblem(
        domain=am.Polygon(vertices=tuple(arc), boundaries=("arc",) * 47 + ("top",)),
        material=am.PlaneStrain(young=2e9, poisson=0.3),
        law=am.Coulomb(0.05),
        contact=am.Contact("arc", am.Plane((0.0, 0.0), (0.0, 1.0))),
        loads=[am.BodyForce((5e3, -1e5))],
    )
    grids = am.Hierarchy.graded(problem, sizes=(0.2, 0.1))
    with pytest.warns(RuntimeWarning, match="nothing but friction resists a translation along x"):
        assert not am.solve(grids, am.ActiveSet(), throw=False).status.ok
