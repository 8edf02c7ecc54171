"""Obstacles that move or are pressed, and bolts that are tightened: motions, forces and
friction."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import rotation
from paths import resumed
from refused import check_refused, refused
from scipy.spatial.transform import Rotation

import adaptmg as am
from adaptmg.discrete.stress import cut_force

E, NU, PRESS = 2e9, 0.3, 1e6


def turned_block(rng, obstacle, law=am.Frictionless()):
    """A clamped square, turned, shifted and scaled at random, under an obstacle made by
    ``obstacle(place, size)``."""
    turn, shift, size = (
        rotation(rng.uniform(0, 2 * np.pi)),
        rng.normal(size=2),
        10 ** rng.uniform(-3, 1),
    )

    def place(points):
        return shift + size * np.asarray(points) @ turn.T

    domain = am.Polygon(
        vertices=tuple(map(tuple, place([(0, 0), (1, 0), (1, 1), (0, 1)]))),
        boundaries=("bottom", "right", "top", "left"),
    )
    problem = am.ContactProblem(
        domain=domain,
        material=am.PlaneStrain(young=E, poisson=NU),
        law=law,
        supports=(am.Support("bottom", x=0, y=0),),
        contact=am.Contact("top", obstacle(place, lambda vector: size * turn @ vector)),
    )
    return am.Hierarchy.graded(problem, sizes=(0.4 * size, 0.2 * size)), turn, size


def plane(place):
    return am.Plane(place((0.3, 1.0)), place((0.3, 0.0)) - place((0.3, 1.0)))


@pytest.mark.filterwarnings("ignore:friction 5")
@pytest.mark.parametrize("seed", range(3))
def test_force_and_moment_find_the_motion_that_made_them(seed):
    rng, sticks = np.random.default_rng(seed), am.Coulomb(5.0)
    depth, angle = rng.uniform(1e-3, 3e-3), rng.uniform(-1e-3, 1e-3)

    def moving(place, vector):
        return am.Moving(
            plane(place),
            displacement=vector(np.array([0.0, -depth])),
            rotation=angle,
            about=place((0.5, 1)),
        )

    grids, _, size = turned_block(np.random.default_rng(seed), moving, sticks)
    obstacle, moved = grids.problem.contact[0].obstacle, am.solve(grids)
    total = moved.resultant("top", about=obstacle.about)

    def rigid(place, vector):
        return am.Rigid(
            plane(place),
            force=tuple(total.force),
            moment=float(total.moment),
            about=place((0.5, 1)),
        )

    pressed = turned_block(np.random.default_rng(seed), rigid, sticks)[0]
    found = am.solve(pressed)
    expected = np.r_[obstacle.displacement / size, angle]
    np.testing.assert_allclose(
        found.motions["obstacle"] / np.array([size, size, 1]), expected, atol=1e-5 * depth
    )
    np.testing.assert_allclose(found.displacement, moved.displacement, atol=1e-5 * depth * size)
    placed = pressed.with_problem(am.problem.step_problem(pressed.problem, {}, found.motions))
    for indicator in (am.Residual(), am.Goal(am.MeanDisplacement("top", 1))):
        estimates = [
            indicator.indicate(one, result).total
            for one, result in ((placed, found), (grids, moved))
        ]
        assert estimates[0] == pytest.approx(estimates[1], rel=1e-3, abs=1e-9 * size)
        with pytest.raises(ValueError, match="obstacles in other places"):
            indicator.indicate(pressed, found)


@pytest.mark.parametrize("n", [8, 40], ids=["few unknowns", "coarse guide"])
@pytest.mark.parametrize("seed", range(2))
def test_an_obstacle_finds_a_column_that_has_moved_away(seed, n):
    """Its base sinks, it cools, and the obstacle begins above it: confined compression."""
    rng = np.random.default_rng(seed)
    turn, size = rotation(rng.uniform(0, 6)), 10 ** rng.uniform(-2, 1)
    sunk, shrunk, gap, load = size * 10 ** rng.uniform(-4, -2, 4)
    punch = am.Plane(turn @ (0, size + gap), turn @ (0, -1))
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=E, poisson=NU),
        law=am.Frictionless(),
        loads=am.InitialStrain("body", (-shrunk / size,) * 3),
        supports=(am.Symmetry("left"), am.Symmetry("right"), am.Support("bottom", normal=sunk)),
        contact=am.Contact(
            "top", am.Rigid(punch, force=tuple(turn @ (0, -E * load)), name="punch")
        ),
    )
    meshes = [
        am.mesh.structured(am.Rectangle(width=size, height=size), k) for k in (n // 4, n // 2, n)
    ]
    meshes = [replace(mesh, points=mesh.points @ turn.T) for mesh in meshes]
    result = am.solve(am.Hierarchy.from_meshes(problem, meshes))
    confined = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU))
    down = gap + sunk + shrunk * (1 + NU) / (1 - NU) + E * load / confined
    found = (turn.T @ result.motions["punch"][:2])[1]  # along the surface nothing resists
    assert found == pytest.approx(-down, rel=1e-6)
    assert result.cycles <= 40


def pad(n, **options):
    """A rounded pad on a block that its sides stretch, and that sinks."""
    pad = am.GapFunction(lambda x: (x[:, 0] - 0.5) ** 2)
    problem = am.ContactProblem(
        domain=am.Rectangle(width=1, height=1),
        material=am.PlaneStrain(young=E, poisson=NU),
        law=am.Coulomb(0.3),
        supports=(am.Support("left", x=0, y=-1e-3), am.Support("right", x=1e-2)),
        contact=am.Contact("top", am.Rigid(pad, about=(0.5, 1), name="pad", **options)),
    )
    return am.Hierarchy.uniform(problem, (n // 4, n // 2, n))


@pytest.mark.parametrize("n", [16, 40], ids=["few unknowns", "coarse guide"])
@pytest.mark.parametrize("share", [-0.5, 0.1, 0.9])
def test_a_pad_bears_tangential_force_on_a_surface_that_stretches(n, share):
    force = np.array([0.3 * share, -1.0]) * PRESS
    grids = pad(n, force=tuple(force))
    result = am.solve(grids)
    np.testing.assert_allclose(result.resultant("top").force, force, atol=1e-6 * PRESS)
    assert result.cycles <= 40
    placed = grids.with_problem(am.problem.step_problem(grids.problem, {}, result.motions))
    moved = am.solve(placed, am.ActiveSet())
    np.testing.assert_allclose(moved.resultant("top").force, force, atol=1e-5 * PRESS)


def test_a_first_contact_problem_that_meets_the_forces_at_the_tolerance_of_the_solver_is_the_last():
    """The coarse level finds the motion of a plate on a uniform block. The tolerance that then suffices
    on the finest one is 1e-5, too."""
    plate = am.Rigid(am.Plane((0, 1), (0, -1)), force=(None, -PRESS))
    problem = am.ContactProblem(
        domain=am.Rectangle(width=1, height=1),
        material=am.PlaneStrain(young=E, poisson=NU),
        law=am.Frictionless(),
        supports=(am.Support("left", x=0), am.Support("bottom", y=0)),
        contact=am.Contact("top", plate),
    )
    grids = am.Hierarchy.uniform(problem, (10, 20, 40))
    equal, larger = (am.solve(grids, am.Multigrid(rtol=rtol)) for rtol in (1e-5, 1.001e-5))
    assert equal.cycles == larger.cycles


@pytest.mark.parametrize(
    "limited",
    [lambda n: am.FullMultigrid(max_cycles=n), lambda n: am.ActiveSet(max_steps=n)],
    ids=["cycles", "steps"],
)
def test_the_limit_of_a_solver_is_that_of_all_contact_problems_of_a_step(limited):
    grids = pad(40, force=(-0.15 * PRESS, -PRESS))
    enough = am.solve(grids, limited(60)).cycles
    assert enough <= 40
    limit = enough - 3
    result = am.solve(grids, limited(limit), throw=False)
    assert result.status is am.Status.LIMIT and limit <= result.cycles < enough


def test_a_step_that_misses_its_forces_says_by_how_much():
    grids = pad(40, force=(-0.15 * PRESS, -PRESS))
    with pytest.raises(am.NotConverged, match="forces of 'pad' are missed by") as caught:
        am.solve(grids, am.ActiveSet(max_steps=am.solve(grids, am.ActiveSet()).cycles - 3))
    assert caught.value.result.missed_forces > 1e-9


@pytest.mark.parametrize("solvable", [1, 4])
def test_motions_are_found_where_guides_are_singular(solvable, monkeypatch):
    """All contact problems with unknown motions but the first ones fail."""
    run, left = am.ActiveSet.run, [solvable]

    def singular(*arguments):
        if not left[0]:
            raise np.linalg.LinAlgError("the matrix is singular")
        left[0] -= 1
        return run(*arguments)

    force = np.array([0.03, -1.0]) * PRESS
    grids = pad(40, force=tuple(force))
    monkeypatch.setattr(am.ActiveSet, "run", singular)
    result = am.solve(grids)
    np.testing.assert_allclose(result.resultant("top").force, force, atol=1e-6 * PRESS)


def test_forces_of_an_obstacle_have_names_on_a_path():
    """The normal force stays while the tangential one turns round and exceeds friction."""
    grids = pad(16, force={"P": (0, -PRESS), "Q": (PRESS, 0)})
    path = am.LoadPath({"P": [0.5, 1, 1, 1, 1], "Q": [0, 0.1, -0.2, 0.1, 0]})
    for k, step in enumerate(am.solve_path(grids, path)):
        force = PRESS * np.array([path.of("Q")[k], -path.of("P")[k]])
        np.testing.assert_allclose(step.resultant("top").force, force, atol=1e-6 * PRESS)
        assert step.cycles <= 40
    check_refused(
        (lambda: am.solve_path(grids, am.LoadPath({"Q": 0.31})), "nothing resists 'pad'"),
        (lambda: am.solve_path(grids, am.LoadPath({"pad": 1.0})), r"known are .*'P', 'Q'"),
        (lambda: pad(16, force={"P": (0, -1), "Q": (None, 1)}), "None in the same places"),
    )


@pytest.mark.parametrize("seed", range(3))
def test_friction_follows_the_sliding_obstacle(seed):
    """Pressed, slid far, and slid back: the tangential force is the friction bound, against the
    motion."""
    friction = 0.2

    def obstacle(place, vector):
        slide = am.Moving(plane(place), displacement=vector(np.array([0.05, 0.0])), name="slide")
        return am.Moving(slide, displacement=vector(np.array([0.0, -1e-3])), name="press")

    grids, turn, _ = turned_block(np.random.default_rng(seed), obstacle, am.Coulomb(friction))
    steps = am.solve_path(
        grids, am.LoadPath({"press": [1, 1, 1, 1], "slide": [0, 1, 1, 0]}), am.ActiveSet(rtol=1e-10)
    )
    forces = np.array([turn.T @ step.resultant("top").force for step in steps])
    assert forces[0, 1] < 0 and abs(forces[0, 0]) < 0.1 * abs(forces[0, 1])
    np.testing.assert_allclose(
        forces[[1, 3], 0] / forces[[1, 3], 1], [-friction, friction], rtol=1e-9
    )
    np.testing.assert_allclose(forces[2], forces[1], rtol=1e-7)  # nothing moves: nothing changes
    multigrid = am.solve_path(grids, am.LoadPath({"press": [1, 1, 1, 1], "slide": [0, 1, 1, 0]}))
    for one, other in zip(steps, multigrid, strict=True):
        np.testing.assert_allclose(
            one.displacement, other.displacement, atol=1e-6 * np.abs(one.displacement).max()
        )


@pytest.mark.parametrize("seed", range(2))
def test_a_step_of_a_moving_obstacle_goes_on_from_the_steps_before(seed):
    """Without friction the displacement of a body that stays in contact is linear in the motion."""

    def moving(place, vector):
        return am.Moving(plane(place), displacement=vector(np.array([0.0, -1e-3])), name="press")

    grids, _, _ = turned_block(np.random.default_rng(seed), moving)
    path = am.LoadPath({"press": [0.2, 0.5, 1.0, 0.4]})
    for solver in (am.Multigrid(correction=am.Monotone(), rtol=1e-6), am.FullMultigrid(rtol=1e-6)):
        first, *rest = (result.cycles for result in am.solve_path(grids, path, solver))
        assert max(rest) <= 2 < first


def test_planes_move_exactly_and_other_obstacles_to_first_order():
    rng = np.random.default_rng(5)
    for dim in (2, 3):
        turn = Rotation.random(rng=rng).as_matrix() if dim == 3 else rotation(rng.uniform(0, 6))
        normal, about, shift, points = (
            turn[0],
            rng.normal(size=dim),
            rng.normal(size=dim),
            rng.normal(size=(7, dim)),
        )
        small = 0.2 * rng.normal(size=2 * dim - 3)
        moving = am.Moving(
            am.Plane(rng.normal(size=dim), normal), displacement=shift, rotation=small, about=about
        )
        turning = Rotation.from_rotvec(small).as_matrix() if dim == 3 else rotation(small[0])
        back = about + (points - about - shift) @ turning  # in the frame of the obstacle
        normals, gaps = moving.contact(points, np.tile(-turning @ normal, (7, 1)))
        np.testing.assert_allclose(
            gaps, moving.obstacle.contact(back, np.tile(-normal, (7, 1)))[1], atol=1e-13
        )
        np.testing.assert_allclose(normals, np.tile(-turning @ normal, (7, 1)), atol=1e-13)
    ball = am.GapFunction(lambda x: 0.5 * (x**2).sum(axis=1))
    shift, points, up = (
        np.array([0.3, -0.2]),
        np.stack([rng.normal(size=5), np.zeros(5)], axis=1),
        np.array([0.0, 1.0]),
    )
    _, gaps = am.Moving(ball, displacement=shift).contact(points, np.tile(up, (5, 1)))
    np.testing.assert_allclose(gaps, 0.5 * (points[:, 0] - 0.3) ** 2 - 0.2, atol=1e-14)


def tightened(force=2e6):
    joint = am.cases.bolted_junction()
    bolt = am.Preload("bolt", force=force, axis="y")
    others = [one for one in joint.loads if not isinstance(one, am.InitialStrain)]
    return am.Hierarchy.graded(replace(joint, loads=[bolt, *others]), sizes=(20e-3, 12e-3)), bolt


@pytest.fixture(scope="module")
def joint():
    return tightened()


FILLED = {name: [0, 1] for name in ("upper.bore", "lower.bore", "upper.pipe")}


def test_a_preload_is_carried_by_cut_heads_and_joint(joint):
    grids, bolt = joint
    steps = am.solve_path(grids, am.LoadPath({"bolt": [1, 1], **FILLED}))
    first, second = steps
    at_cut = [cut_force(one.mesh, one.stress_data, one.displacement, bolt) for one in steps]
    heads = [
        [
            sign * one.resultant(f"bolt.{side}_head").force[1]
            for side, sign in (("upper", 1), ("lower", -1))
        ]
        for one in steps
    ]
    np.testing.assert_allclose(
        [at_cut[0], *heads[0], first.resultant("upper.joint").force[1]], bolt.force, rtol=1e-6
    )
    np.testing.assert_allclose(
        heads[1], at_cut[1], rtol=1e-6
    )  # the bolt keeps its length, its force changes
    assert second.motions == first.motions and abs(at_cut[1] / bolt.force - 1) > 1e-4
    relieved = second.resultant("upper.joint").force[1]
    thrust = grids.problem.reference["thrust"]
    assert relieved + thrust == pytest.approx(
        at_cut[1], rel=1e-2
    )  # the bore's corner faces the joint's gap
    placed = grids.with_problem(
        am.problem.step_problem(grids.problem, dict.fromkeys(FILLED, 0.0), first.motions)
    )
    assert am.Residual().indicate(placed, first).total > 0  # its loads are those of the step
    hot = am.InitialStrain("bolt", (0.0, 1e-4))
    with pytest.raises(ValueError, match="'bolt' is the name of a Preload and of another load"):
        am.solve(grids.with_problem(replace(grids.problem, loads=(bolt, hot))))


def test_a_bolt_closes_the_clearance_under_its_head_first(joint):
    grids, bolt = joint
    contact = [
        replace(one, gap=1e-4) if "bolt.upper_head" in (one.slave, one.master) else one
        for one in grids.problem.contact
    ]
    loose = am.Hierarchy.graded(replace(grids.problem, contact=contact), sizes=(20e-3, 12e-3))
    path = am.LoadPath(dict.fromkeys(FILLED, 0.0))
    tight, result = (am.solve_path(one, path)[0] for one in (grids, loose))
    force = result.resultant("bolt.upper_head").force[1]
    assert force == pytest.approx(bolt.force, rel=1e-6) and result.cycles <= 40
    mesh = grids.finest.mesh
    upper, lower = (
        mesh.points[mesh.boundary_nodes(f"bolt.{side}_head"), 1].mean()
        for side in ("upper", "lower")
    )
    more = result.motions["bolt"][0] - tight.motions["bolt"][0]
    assert more == pytest.approx(1e-4 / (upper - lower), rel=0.1)


@pytest.mark.parametrize("poisson", [0.3, 0.4999, 0.5])
def test_a_bolt_between_walls_bears_its_force_alone_and_is_found_as_fast_for_any_poissons_ratio(
    poisson,
):
    width = 10 ** np.random.default_rng(9).uniform(-3, 1)
    force = 1e-3 * E * width
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=E, poisson=poisson),
        domain=am.Rectangle(width=width, height=width),
        elements="smoothed",
        law=am.Frictionless(),
        contact=am.Contact("right", am.Plane((1.0001 * width, 0), (-1, 0))),
        loads=(am.Preload("body", force=force, axis="y"),),
        supports=(am.Support("bottom", y=0), am.Support("top", y=0), am.Support("left", x=0)),
    )
    result = am.solve(am.Hierarchy.uniform(problem, (2, 4)), am.FullMultigrid(rtol=1e-8))
    np.testing.assert_allclose(
        result.stress()[:, [0, 1, 3]] * width / force, [[0, 1, 0]] * 32, atol=1e-6
    )
    assert result.motions["body"] == pytest.approx([force / width * (1 - poisson**2) / E], rel=1e-6)
    assert result.cycles <= 40


@pytest.mark.parametrize("gap", [0.0, 1e-7, 1e-4])
def test_a_bolt_that_closes_a_clearance_depends_on_factor_times_force_alone(gap):
    corners = ((0, -0.5), (1, -0.5), (1, 0), (0.4, 0), (0.4, 2), (1, 2), (1, 2.5), (0, 2.5))
    names = ("foot", "e1", "low", "shank", "up", "e2", "top", "axis")
    parts = {
        "bolt": am.Polygon(vertices=corners, boundaries=names),
        "sleeve": am.Rectangle(width=0.45, height=2 - gap, origin=(0.5, 0)),
    }
    results = []
    for force, factor in ((3e7, 1.0), (1e9, 0.03)):
        problem = am.ContactProblem(
            domain=am.Assembly(parts=parts),
            material=am.Axisymmetric(young=2e11, poisson=0.3),
            law=am.Frictionless(),
            contact=am.ContactPair("sleeve.top", "bolt.up"),
            ties=am.Tied("sleeve.bottom", "bolt.low"),
            loads=[am.Preload("bolt", force=force, axis="y")],
            supports=[am.Support("bolt.foot", y=0)],
        )
        grids = am.Hierarchy.graded(problem, sizes=(0.3, 0.15))
        (result,) = am.solve_path(grids, am.LoadPath({"bolt": factor}))
        assert result.resultant("sleeve.top").force[1] == pytest.approx(-3e7, rel=1e-6)
        results.append(result)
    one, other = results
    assert other.motions["bolt"] == pytest.approx(one.motions["bolt"], rel=1e-9)
    np.testing.assert_allclose(
        other.displacement, one.displacement, atol=1e-9 * np.ptp(other.displacement)
    )


def test_a_stored_path_goes_on_with_its_motions(joint, tmp_path):
    grids, _ = joint
    path = am.LoadPath({"bolt": [0.5, 1, 1]}, default=[0, 0, 1])
    resumed(grids, path, None, tmp_path, after=1)
    with pytest.raises(ValueError, match="obstacles and preloads"):
        am.solve_path(tightened(1e6)[0], path, store=tmp_path)


@pytest.mark.parametrize("law", [am.Coulomb(0.1), am.Tresca(4e5)], ids=["Coulomb", "Tresca"])
def test_a_periodic_layer_under_a_sliding_wall_bears_uniform_stress(law):
    """It sticks, then slides, and the node that follows its partner hands its share of the surface
    to it."""
    turn, depth, slide = rotation(0.7), 1e-3, 2e-4
    meshes = [am.mesh.structured(am.Rectangle(width=1, height=0.5), (4 * k, 2 * k)) for k in (1, 2)]
    wall = am.Moving(
        am.Plane(turn @ (0, 0.5), turn @ (0, -1)), displacement=turn @ (0, -depth), name="press"
    )
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=E, poisson=NU),
        law=law,
        ties=am.Periodic("left", "right"),
        contact=am.Contact("top", am.Moving(wall, displacement=turn @ (slide, 0), name="slide")),
        supports=am.Support("bottom", x=0, y=0),
    )
    grids = am.Hierarchy.from_meshes(
        problem, [replace(one, points=one.points @ turn.T) for one in meshes]
    )
    steps = am.solve_path(grids, am.LoadPath({"slide": [0, 1, 0.5, 100]}), am.Multigrid(rtol=1e-10))
    pressure = E * (1 - NU) / ((1 + NU) * (1 - 2 * NU)) * depth / 0.5
    shear, bound = (
        E / (2 * (1 + NU)) * slide / 0.5,
        0.1 * pressure if isinstance(law, am.Coulomb) else 4e5,
    )
    for step, expected in zip(steps, (0, shear, 0.5 * shear, bound), strict=True):
        force = turn.T @ step.resultant("top").force
        np.testing.assert_allclose(force, [expected, -pressure], atol=1e-7 * pressure)
        np.testing.assert_allclose(step.contact.pressure, pressure, rtol=1e-6)


@pytest.mark.parametrize("turn", [np.eye(2), rotation(0.7)], ids=["straight", "turned"])
def test_a_punch_on_a_roller_may_be_tilted_by_any_angle(turn):
    """The roller holds a part of its normal, however small: forces depend on the angle without
    jumps."""
    meshes = [am.mesh.structured(am.Rectangle(width=1, height=1), n) for n in (4, 8)]
    meshes = [replace(mesh, points=mesh.points @ turn.T) for mesh in meshes]
    forces = []
    for angle in (0.0, 1e-9, 1e-7, 1e-5, 1e-4):
        punch = am.Moving(
            am.Plane(turn @ (0, 1), turn @ (0, -1)), displacement=turn @ (0, -1e-3), rotation=angle
        )
        problem = am.ContactProblem(
            material=am.PlaneStrain(young=E, poisson=NU),
            law=am.Coulomb(0.3),
            contact=am.Contact("top", punch),
            supports=(am.Support("bottom", x=0, y=0), am.Symmetry("left")),
        )
        result = am.solve(am.Hierarchy.from_meshes(problem, meshes), am.ActiveSet(rtol=1e-11))
        forces.append(turn.T @ result.resultant("top").force)
        assert np.abs(forces[-1] - forces[0]).max() <= E * angle + 1e-8 * np.abs(forces[0]).max()


@pytest.mark.parametrize(
    "turn",
    [np.eye(3), Rotation.from_euler("xyz", [0.4, 0.9, -0.3]).as_matrix()],
    ids=["straight", "turned"],
)
def test_a_plate_that_drags_over_held_nodes_moves_in_proportion_to_its_force(turn):
    """A block on rollers along three planes, two of which hold nodes that the plate touches: their
    friction bears a part of its force. Without a gap all is proportional to the force."""
    block = am.mesh.structured(am.Box(width=1, depth=0.8, height=0.5), (3, 3, 2))
    mesh = replace(block, points=block.points @ turn.T)
    plate = am.Rigid(
        am.Plane(turn @ [0, 0, 0.5], turn @ [0, 0, -1]), force=turn @ [5e4, 3e4, -1e6], name="plate"
    )
    problem = am.ContactProblem(
        material=am.Solid(young=1e9, poisson=0.3),
        law=am.Coulomb(0.3),
        contact=am.Contact("top", plate),
        supports=[am.Symmetry(name) for name in ("bottom", "left", "front")],
    )
    factors = [0.5, 1.0, 1.01]
    steps = am.solve_path(
        am.Hierarchy.from_meshes(problem, [mesh]), am.LoadPath({"plate": factors})
    )
    motions = np.array([step.motions["plate"][:3] for step in steps]) / np.array(factors)[:, None]
    np.testing.assert_allclose(
        motions, np.tile(motions[0], (3, 1)), atol=1e-6 * np.abs(motions).max()
    )


@pytest.mark.parametrize("friction", [0.1, 0.3, 1.0])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_punch_on_rollers_bears_its_force_also_where_supports_bear_the_friction(dim, friction):
    """Corner nodes on rollers do not follow the punch. Their friction sticks while the punch stands
    still, and has any size below its bound while the punch turns round."""
    force = np.array((5e4, 3e4, -1e6) if dim == 3 else (5e4, -1e6))
    body = am.Rectangle(width=1, height=0.5)
    if dim == 3:
        body = am.Box(width=1, depth=0.8, height=0.5)
    up = np.eye(dim)[-1]
    punch = am.Rigid(am.Plane(0.5 * up, -up), force=force, name="punch")
    problem = am.ContactProblem(
        material=(am.Solid if dim == 3 else am.PlaneStrain)(young=1e9, poisson=NU),
        law=am.Coulomb(friction),
        contact=am.Contact("top", punch),
        supports=[am.Symmetry(name) for name in ("bottom", "left", "front")[:dim]],
    )
    mesh = am.mesh.structured(body, (3, 3, 2) if dim == 3 else (6, 4))
    factors = (0.5, 1.0, 1.0, 0.9, 0.1, 1.0)
    grids = am.Hierarchy.from_meshes(problem, [mesh])
    steps = am.solve_path(grids, am.LoadPath({"punch": factors}))
    for factor, step in zip(factors, steps, strict=True):
        missed = step.resultant("top").force - factor * force
        assert np.abs(missed).max() <= 1e-9 * np.linalg.norm(factor * force)
        bound = friction * step.contact.force_n
        assert (np.linalg.norm(step.contact.force_t, axis=1) <= (1 + 1e-8) * bound).all()
    half, whole, again, *_ = steps
    np.testing.assert_allclose(whole.displacement, 2 * half.displacement, atol=1e-12)
    assert again.cycles == 0 and again.motions == whole.motions
    assert sum(step.cycles for step in steps) <= 100


@pytest.mark.parametrize("kind", ["moved", "pressed"])
def test_no_obstacle_goes_through_what_a_support_holds(kind):
    def obstacle(place, vector):
        if kind == "moved":
            return am.Moving(plane(place), displacement=vector(np.array([0.0, -1e-3])))
        return am.Rigid(
            plane(place), force=tuple(PRESS * vector(np.array([0.0, -1.0]))), moment=None
        )

    grids, *_ = turned_block(np.random.default_rng(3), obstacle, am.Coulomb(0.5))
    held = replace(grids.problem, supports=(*grids.problem.supports, am.Support("left", x=0, y=0)))
    with pytest.raises(ValueError, match=r"of contact boundary 'top' .* inside its obstacle"):
        am.solve(grids.with_problem(held))


def test_what_cannot_be_found_is_refused():
    def check(obstacle, words, path=am.LoadPath(), law=am.Frictionless()):
        grids, *_ = turned_block(np.random.default_rng(1), obstacle, law)
        with pytest.raises(ValueError, match=words):
            am.solve_path(grids, path, callback=lambda *_: pytest.fail("a step was solved"))

    def rigid(direction, name="punch"):
        return lambda place, vector: am.Rigid(
            plane(place), force=tuple(PRESS * vector(np.array(direction))), name=name
        )

    check(rigid((0.0, 1.0)), "nothing resists 'punch': .* press towards the body")
    check(
        rigid((0.0, -1.0)),
        "the factor of 'punch', which a force presses, must be > 0, got 0",
        am.LoadPath({"punch": [0.5, 1, 0]}),
    )
    check(rigid((0.5, -1.0)), "nothing resists 'punch'")
    grids, *_ = turned_block(np.random.default_rng(1), rigid((0.0, -1.0)))
    with pytest.raises(ValueError, match="start must be None"):
        am.solve(grids, start=np.zeros((grids.finest.n_nodes, 2)))
    with pytest.raises(ValueError, match="Rigid obstacle or a Preload"):
        am.adapt(grids.problem, max_nodes=100)
    free = am.ContactProblem(
        domain=am.Rectangle(width=0.01, height=0.1),
        material=am.PlaneStrain(young=2e11, poisson=0.3),
        loads=am.Preload("body", force=1e5, axis="y"),
        supports=am.Support("bottom", x=0, y=0),
    )
    for method in (None, am.Multigrid(rtol=1e-4)):
        with pytest.raises(ValueError, match=r"nothing resists .body.: .* hold a bolt"):
            am.solve(am.Hierarchy.uniform(free, [(1, 8), (2, 16)]), method)


FLOOR = am.Plane((0, 0), (0, 1))


def axisymmetric(obstacle):
    return am.ContactProblem(
        material=am.Axisymmetric(young=E, poisson=NU),
        contact=am.Contact("bottom", obstacle),
        law=am.Frictionless(),
    )


test_wrong_motions_and_forces_are_refused = refused(
    *(
        (lambda obstacle=obstacle: axisymmetric(obstacle), "must move along the axis only")
        for obstacle in (
            am.Moving(FLOOR, displacement=(1.0, 0.0)),
            am.Moving(FLOOR, displacement=(0, 1), rotation=1e-3),
            am.Rigid(FLOOR, force=(0.0, 1.0)),
            am.Rigid(FLOOR, force=(None, 1.0), moment=0.0),
        )
    ),
    (lambda: am.Rigid(FLOOR, force=(None, None)), "force and moment are None"),
    (lambda: am.Rigid(FLOOR, force=(0.0, None)), "component other than zero"),
    (lambda: am.Moving(FLOOR, displacement=(0, 0, 1)), "displacement must have 2 components"),
    (lambda: am.Moving(FLOOR, displacement=(0, np.nan)), "displacement"),
    (lambda: am.Preload("bolt", force=-1.0, axis="y"), "force must be > 0"),
    (lambda: am.Preload("bolt", force=1.0, axis="w"), "axis must be"),
    (
        lambda: am.Moving(am.Rigid(FLOOR, force=(None, 1.0)), displacement=(0, 0)),
        TypeError,
        "must not be Rigid",
    ),
)
