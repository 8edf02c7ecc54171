"""Springs, supports at points, planes of symmetry; supports that hold contact nodes, where friction
acts too."""

import re
from dataclasses import replace

import numpy as np
import pytest
from bodies import assert_balanced, random_turn, slabs
from refused import refused
from saddle import Parts
from simplex_meshes import numbered_at_random

import adaptmg as am
from adaptmg.solver.examine import Examiner
from adaptmg.solver.statics import check_statics

PRESSURE, STIFF, E = 5e5, 1e9, 1e8
FAR = am.Coulomb(0.3)


def on_springs(kind: type) -> am.ContactProblem:
    """A block that is pressed on springs, free to widen: its stress is uniform, its foot sinks by p
    / k."""
    dim = 3 if kind is am.Solid else 2
    domain = am.Box(width=1, depth=1, height=1) if dim == 3 else am.Rectangle(width=1, height=1)
    sides = ("left", "front") if dim == 3 else ("left",)
    return am.ContactProblem(
        material=kind(young=E, poisson=0.25),
        domain=domain,
        law=FAR,
        loads=[am.Pressure("top", PRESSURE)],
        contact=am.Contact(
            "right", am.Plane((2.0, *[0.0] * (dim - 1)), (-1.0, *[0.0] * (dim - 1)))
        ),
        supports=[am.Spring("bottom", normal=STIFF), *map(am.Symmetry, sides)],
    )


@pytest.mark.parametrize("kind", [am.PlaneStress, am.Axisymmetric, am.Solid])
def test_springs_carry_a_uniform_stress_exactly(kind, tmp_path):
    problem = on_springs(kind)
    grids = am.Hierarchy.uniform(problem, (2, 4))
    result = am.solve(grids, am.Multigrid(rtol=1e-12))
    area = np.pi if kind is am.Axisymmetric else 1.0
    foot = grids.finest.mesh.boundary_nodes("bottom")
    np.testing.assert_allclose(result.displacement[foot, -1], -PRESSURE / STIFF, rtol=1e-9)
    under = result.resultant("bottom", about=[0.5] * (problem.dim - 1) + [0.0])
    np.testing.assert_allclose(
        under.force, [0.0] * (problem.dim - 1) + [PRESSURE * area], atol=1e-6 * PRESSURE
    )
    if kind is not am.Axisymmetric:
        np.testing.assert_allclose(under.moment, 0.0, atol=1e-6 * PRESSURE)
    assert result.certificate()["balance"].relative < 1e-9
    assert am.Residual().indicate(grids, result).relative < 1e-6
    assert (
        am.Goal(am.MeanDisplacement("bottom", "xyz"[problem.dim - 1]))
        .indicate(grids, result)
        .relative
        < 1e-6
    )
    result.save(tmp_path / "run.npz")
    assert am.Result.load(tmp_path / "run.npz").springs == result.springs
    matrix = grids.finest.matrix.toarray()
    np.testing.assert_array_equal(matrix, matrix.T)


def test_springs_across_and_at_points_hold_a_body():
    problem = replace(
        on_springs(am.PlaneStress),
        supports=[am.Spring("bottom", normal=STIFF, tangential=2e8)],
        loads=[am.Traction("top", (1e4, 0.0))],
    )
    result = am.solve(am.Hierarchy.uniform(problem, (4, 8)), am.Multigrid(rtol=1e-11))
    assert result.resultant("bottom").force == pytest.approx([-1e4, 0.0], abs=1e-2)
    # far softer than the body, and the statics see them
    soft = (am.PointSpring((0, 0), x=10.0, y=10.0), am.PointSpring((1, 0), y=10.0))
    posed = replace(problem, supports=soft, loads=[am.Traction("top", (0.0, -1.0))])
    check_statics(am.discretise(posed, am.mesh.structured(posed.domain, 4)))
    with pytest.raises(ValueError, match=r"rotation about \(0, 1\)"):
        check_statics(
            am.discretise(
                replace(posed, law=am.Frictionless(), supports=[am.PointSpring((0, 1), y=10.0)]),
                am.mesh.structured(posed.domain, 4),
            )
        )
    hung = am.solve(am.Hierarchy.uniform(posed, (4, 8)), am.Multigrid())
    assert hung.resultant("point (1, 0)", about=(1, 0)).force == pytest.approx([0, 0.5], rel=1e-4)
    np.testing.assert_allclose(hung.displacement.mean(axis=0), [0.0, -0.05], atol=1e-6)


def test_soft_springs_hold_or_are_named_with_the_least_stiffness():
    def pulled(stiffness):
        problem = am.ContactProblem(
            domain=am.Rectangle(width=0.3, height=0.1),
            material=am.PlaneStrain(young=2.1e11, poisson=0.3),
            loads=[am.Traction("left", (1e-3 * stiffness, 0.0))],
            supports=[am.Spring("right", normal=stiffness), am.Support("bottom", y=0)],
        )
        return am.Hierarchy.uniform(problem, (4, 8, 16))

    with pytest.raises(ValueError, match="spring on 'right' counts as none") as refusal:
        am.solve(pulled(10.0))
    least = float(re.search(r"at least (\S+) N/m\^3", str(refusal.value)).group(1))
    with pytest.raises(ValueError, match="spring on 'right' counts as none"):
        am.solve(pulled(0.3 * least))
    for stiffness in (least, 2e4):
        with pytest.warns(UserWarning, match="below what double precision reaches"):
            held = am.solve(pulled(stiffness))
        assert held.rtol < 1e-5
        np.testing.assert_allclose(held.displacement[:, 0], 1e-3, rtol=2 * held.rtol)


def test_point_supports_hold_one_node_symmetry_one_component():
    problem = on_springs(am.PlaneStress)
    mesh = am.mesh.structured(problem.domain, 4)
    np.testing.assert_array_equal(
        *(
            am.discrete.fixed_dofs(mesh, [one])
            for one in (am.Symmetry("left"), am.Support("left", x=0))
        )
    )
    held, values = am.discrete.fixed_dofs(mesh, [am.PointSupport((0.25, 1.0), y=1e-3)])
    node = int(np.flatnonzero(held)[0]) // 2
    assert (
        held.sum() == 1
        and mesh.points[node].tolist() == [0.25, 1.0]
        and values[2 * node + 1] == 1e-3
    )
    hung = replace(
        problem, supports=[am.PointSupport((0, 1), x=0.0, y=1e-3), am.PointSupport((1, 1), y=1e-3)]
    )
    path = am.solve_path(
        am.Hierarchy.uniform(hung, (2, 4)),
        am.LoadPath({"point (0, 1)": [1, 2], "point (1, 1)": [1, 2]}),
        am.Multigrid(rtol=1e-11),
    )
    np.testing.assert_allclose(
        path[1].displacement - path[0].displacement, [[0.0, 1e-3]] * 25, atol=1e-10
    )
    assert path[0].reaction[:, 1].sum() == pytest.approx(PRESSURE)


@pytest.mark.parametrize(
    "domain",
    [
        am.Rectangle(width=1, height=1),
        am.Cut(am.Rectangle(width=1, height=1), am.Circle((0.5, 0.5), 0.2, "hole")),
    ],
)
def test_graded_meshes_have_a_node_at_a_point_support(domain):
    held = (
        am.PointSupport((0.37, 1.0), x=0.0),
        am.PointSpring((1.0, 0.61), x=1.0),
        am.PointSupport((0.0, 1.0), x=0.0),
    )
    problem = replace(on_springs(am.PlaneStress), domain=domain, supports=held)
    mesh = am.Hierarchy.graded(problem, [0.3]).finest.mesh
    assert all(np.linalg.norm(mesh.points - one.point, axis=1).min() < 1e-12 for one in held)
    assert mesh.boundaries == tuple(dict.fromkeys(domain.boundaries))


def test_a_body_moved_along_the_obstacle_is_solved():
    problem = replace(
        on_springs(am.PlaneStress),
        loads=(),
        law=am.Coulomb(0.3),
        supports=(am.PointSupport((0, 1), x=1e-5, y=0.0), am.PointSupport((1, 1), y=0.0)),
        contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
    )
    result = am.solve(am.Hierarchy.uniform(problem, (2, 4)))
    np.testing.assert_allclose(result.displacement, [[1e-5, 0.0]] * 25, atol=1e-15)


def test_supports_with_the_same_values_but_for_rounding_agree():
    mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    left = am.Support("left", x=lambda points: 0.1 + points[:, 0] + 0.2)
    fixed, values = am.discrete.fixed_dofs(mesh, [left, am.Support("bottom", x=0.3)])
    assert 0.1 + 0.2 != 0.3 and fixed.sum() == 5
    np.testing.assert_allclose(values[fixed], 0.3, rtol=1e-15)


test_refused = refused(
    (lambda: am.Spring("foot"), "holds nothing: give normal or tangential"),
    (lambda: am.Spring("foot", normal=-1.0), "normal must be >= 0"),
    (lambda: am.PointSpring((0, 0), x=np.nan), "x must be"),
    (lambda: am.PointSupport((0, 0)), r"'point \(0, 0\)' holds nothing"),
    (lambda: am.PointSupport((0,), x=0.0), "2 or 3 components"),
    (
        lambda: replace(on_springs(am.Solid), supports=[am.PointSupport((0, 0), x=0.0)]),
        "2 components in a 3D problem",
    ),
    (
        lambda: replace(on_springs(am.PlaneStress), supports=[am.Spring("foot", normal=1.0)]),
        "'foot', used for a support",
    ),
    (
        lambda: am.discrete.fixed_dofs(
            am.mesh.structured(am.Rectangle(width=1, height=1), 4),
            [am.PointSupport((0.3, 0), x=0.0)],
        ),
        "nearest one 0.05 m away",
    ),
    (
        lambda: am.Hierarchy.graded(
            replace(
                on_springs(am.PlaneStress),
                domain=am.Cut(am.Rectangle(width=1, height=1), am.Circle((0.5, 0.5), 0.2)),
                supports=[am.Symmetry("circle")],
            ),
            [0.2],
        ),
        "support on 'circle' holds its normal, and the boundary is not plane",
    ),
    (
        lambda: am.discrete.fixed_dofs(
            am.mesh.structured(am.Rectangle(width=1, height=1), 4),
            [am.Support("left", x=0, normal=0)],
        ),
        "prescribes x, which is its normal displacement, twice",
    ),
    (
        lambda: am.Hierarchy.from_meshes(
            replace(
                on_springs(am.PlaneStress),
                domain=None,
                supports=[am.Support("left", normal=1e-3), am.Support("bottom", x=0, y=0)],
            ),
            sheared(2, 0)[:1],
        ),
        "supports on 'left', 'bottom' contradict each other at their common node 0",
    ),
)


def sheared(dim, seed):
    """Meshes of a parallelogram or parallelepiped in a random direction, a corner at the origin."""
    rng = np.random.default_rng(seed)
    turn = random_turn(rng, dim)
    matrix = (
        10.0 ** rng.uniform(-2, 1)
        * turn
        @ (np.eye(dim) + np.triu(rng.uniform(-0.7, 0.7, (dim, dim)), 1))
    )
    unit = am.Box(width=1, depth=1, height=1) if dim == 3 else am.Rectangle(width=1, height=1)
    meshes = [am.mesh.structured(unit, n) for n in ((2, 4) if dim == 3 else (2, 4, 8))]
    return [replace(one, points=one.points @ matrix.T) for one in meshes]


@pytest.mark.parametrize(("elements", "nu"), [("linear", 0.3), ("smoothed", 0.49)])
@pytest.mark.parametrize(("touching", "moved"), [(False, False), (True, False), (False, True)])
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("dim", [2, 3])
def test_inclined_rollers_carry_a_uniform_pressure_exactly(
    dim, seed, moved, touching, elements, nu
):
    """Under one pressure all around, a body between planes through the origin shrinks towards it,
    and moves with the planes. One of them may be an obstacle, which the others meet obliquely."""
    meshes = sheared(dim, seed)
    young, pressure = 1e7, 1e3
    sides, others = (("left", "bottom", "front"), ("top", "right", "back"))
    shrinks = pressure * (1 - 2 * nu) * (1 if dim == 3 else 1 + nu) / young
    normals = {name: meshes[0].surface(name).normals[0] for name in sides[:dim]}
    displacement = -shrinks * meshes[-1].points
    guides = [am.Symmetry("left"), *(am.Support(name, normal=0) for name in sides[1:dim])]
    if moved:
        size = shrinks * np.abs(meshes[-1].points).max()
        shift = size * np.random.default_rng(seed).uniform(-1, 1, dim)
        displacement += shift
        guides = [am.Support(name, normal=normal @ shift) for name, normal in normals.items()]
    problem = am.ContactProblem(
        elements=elements,
        material=(am.Solid if dim == 3 else am.PlaneStrain)(
            young=young, poisson=nu
        ),  # and no contact
        loads=[am.Pressure(name, pressure) for name in others[:dim]],
        supports=guides,
    )
    if touching:
        floor = am.Plane([0] * dim, -normals["bottom"])
        problem = replace(
            problem,
            contact=am.Contact("bottom", floor),
            law=am.Frictionless(),
            supports=[one for one in problem.supports if one.boundary != "bottom"],
        )
    grids = am.Hierarchy.from_meshes(problem, meshes)
    for method in (am.Multigrid(rtol=1e-11), am.FullMultigrid(rtol=1e-11), EXACT):
        result = am.solve(grids, method)
        np.testing.assert_allclose(
            result.displacement,
            displacement,
            atol=1e-9 * np.abs(displacement).max(),
        )
    surfaces = [meshes[-1].surface(name) for name in sides[:dim]]
    forces = np.array([result.resultant(name).force for name in sides[:dim]])
    expected = -pressure * np.array([surface.vectors.sum(axis=0) for surface in surfaces])
    if (
        touching
    ):  # what an oblique guide bears of contact at their common nodes counts as that of the guide
        forces, expected = forces.sum(axis=0), expected.sum(axis=0)
    np.testing.assert_allclose(forces, expected, atol=1e-6 * pressure * surfaces[0].measures.sum())
    indicators = [am.Residual(), am.Goal(am.MeanDisplacement("top", 0))]
    for indicator in [] if touching else indicators[: 1 + (elements == "linear")]:
        assert indicator.indicate(grids, result).relative < 1e-6


@pytest.mark.parametrize("factor", [1.0, -0.5])
def test_a_plane_and_an_inclined_plane_of_a_path_move_their_common_nodes(factor):
    """Without loads all of the body moves with its guides."""
    shear = np.array([[1.0, 0.6], [0.0, 1.0]])
    square = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    mesh = replace(square, points=square.points @ shear.T)
    shift = np.array([2e-4, -3e-4])
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=1e7, poisson=0.3),
        supports=[
            am.Support("left", normal=mesh.surface("left").normals[0] @ shift),
            am.Support("bottom", y=shift[1]),
        ],
    )
    grids = am.Hierarchy.from_meshes(problem, [mesh])
    path = am.LoadPath({"left": [factor], "bottom": [factor]})
    moved = am.solve_path(grids, path, EXACT)[0].displacement
    np.testing.assert_allclose(moved, np.tile(factor * shift, (mesh.n_nodes, 1)), atol=1e-12)


@pytest.mark.parametrize("turned", [False, True])
def test_supports_along_one_normal_that_part_in_a_path_are_refused(turned):
    """Only these are named, although supports at right angles hold some of their nodes, too. With
    equal factors they move all of the body."""
    box = am.mesh.structured(am.Box(width=1, depth=1, height=1), 2)
    turn = random_turn(np.random.default_rng(4)) if turned else np.eye(3)
    is_upper = (box.facet_labels == box.boundaries.index("left")) & (
        box.points[box.facets, 2].mean(axis=1) > 0.5
    )
    mesh = replace(
        box,
        points=box.points @ turn.T,
        boundaries=(*box.boundaries, "upper"),
        facet_labels=np.where(is_upper, len(box.boundaries), box.facet_labels),
    )
    problem = am.ContactProblem(
        material=am.Solid(young=1e7, poisson=0.3),
        supports=[
            am.Support("upper", normal=1e-3),
            am.Support("left", normal=1e-3),
            am.Support("bottom", normal=0.0),
            am.Support("front", normal=0.0),
        ],
    )
    grids = am.Hierarchy.from_meshes(problem, [mesh])
    together = am.solve_path(grids, am.LoadPath({"upper": [0.5], "left": [0.5]}), EXACT)[0]
    np.testing.assert_allclose(
        together.displacement, np.tile(-5e-4 * turn[:, 0], (mesh.n_nodes, 1)), atol=1e-12
    )
    with pytest.raises(ValueError, match="of 'upper' and 'left' prescribe different displacements"):
        am.solve_path(grids, am.LoadPath({"upper": [1.0], "left": [0.5]}), EXACT)


@pytest.mark.parametrize(
    ("dim", "seed", "floor_moves", "elements", "nu"),
    [
        (2, 0, True, "smoothed", 0.49),
        (2, 1, False, "linear", 0.3),
        (3, 0, True, "linear", 0.3),
        (3, 1, False, "smoothed", 0.49),
    ],
)
def test_planes_that_move_at_an_angle_to_the_obstacle_compress_uniformly(
    dim, seed, floor_moves, elements, nu
):
    """A body under one pressure all around follows its guides and a plane obstacle, each of which
    moves by another factor, or where the obstacle rests; they meet at any angle."""
    meshes = [numbered_at_random(mesh, seed) for mesh in sheared(dim, seed)[:2]]
    young, pressure = 1e7, 1e3
    shrinks = pressure * (1 - 2 * nu) * (1 if dim == 3 else 1 + nu) / young
    names = ("bottom", "left", "front")[:dim]
    normals = np.array([meshes[0].surface(name).normals[0] for name in names])
    size = shrinks * np.ptp(meshes[-1].points)
    amounts = size * np.random.default_rng(seed).uniform(-1, 1, dim)
    floor = am.Plane([0] * dim, -normals[0])
    if floor_moves:
        floor = am.Moving(floor, displacement=amounts[0] * normals[0], name="bottom")
    else:
        amounts[0] = 0.0
    problem = am.ContactProblem(
        elements=elements,
        material=(am.Solid if dim == 3 else am.PlaneStrain)(young=young, poisson=nu),
        law=am.Frictionless(),
        contact=am.Contact("bottom", floor),
        loads=[am.Pressure(name, pressure) for name in ("top", "right", "back")[:dim]],
        supports=[
            am.Support(name, normal=amount)
            for name, amount in zip(names[1:], amounts[1:], strict=True)
        ],
    )
    grids = am.Hierarchy.from_meshes(problem, meshes)
    factors = np.array([[1.0, 1.0, 1.0], [0.3, -0.5, 2.0], [0.3, 2.0, -1.0]])[:, :dim]
    of_names = dict(zip(names, factors.T.tolist(), strict=True))
    if not floor_moves:
        del of_names["bottom"]
    path = am.LoadPath(of_names)
    corrections = am.Truncated(), am.Monotone(), am.PaperCorrection()
    cycles = [am.Multigrid(correction=each, rtol=1e-9) for each in corrections]
    others = [am.SingleGrid(rtol=1e-9), am.ActiveSet(condensed=False)]
    methods = [EXACT, am.FullMultigrid(rtol=1e-9), *cycles, *others]
    for method in methods[: None if elements == "linear" else 3]:
        for k, result in enumerate(am.solve_path(grids, path, method)):
            shift = np.linalg.solve(normals, factors[k] * amounts)
            expected = shift - shrinks * meshes[-1].points
            np.testing.assert_allclose(result.displacement, expected, atol=3e-8 * size)
            assert (result.contact.state != am.OPEN).all()


@pytest.mark.parametrize("seed", range(3))
def test_gaps_next_to_a_clamped_end_follow_the_motion_of_both(seed):
    """A body that its supports move along its obstacle as a whole keeps its gap, also where the
    nodes of an edge take over the part of a clamped corner."""
    mesh = numbered_at_random(sheared(3, seed)[-1], seed)
    normals = {name: mesh.surface(name).normals[0] for name in ("left", "front", "bottom")}
    shift = np.cross(normals["bottom"], [1.0, -2.0, 0.5])
    problem = am.ContactProblem(
        material=am.Solid(young=1e7, poisson=0.3),
        law=am.Frictionless(),
        contact=am.Contact("bottom", am.Plane([0] * 3, -normals["bottom"])),
        supports=[
            am.Support("left", **dict(zip("xyz", shift, strict=True))),
            am.Support("front", normal=normals["front"] @ shift),
        ],
    )
    discrete = am.discretise(problem, mesh)
    moved = discrete.at_contact(discrete.relative(np.tile(shift, (mesh.n_nodes, 1))))
    contact = discrete.contact
    assert contact.taken_over.nnz and np.ptp(contact.gaps) > 0.1
    np.testing.assert_allclose(
        np.einsum("nd,nd->n", contact.normals, moved), contact.gaps, atol=1e-10
    )


@pytest.mark.parametrize("seed", range(3))
def test_a_body_moves_with_its_obstacle_along_a_path(seed):
    """Supports, of which one clamps a corner, and the obstacle move all of the body alike: nothing
    strains it, and no gap opens or closes."""
    mesh = numbered_at_random(sheared(3, seed)[-1], seed)
    normals = {name: mesh.surface(name).normals[0] for name in ("left", "front", "bottom")}
    shift = 1e-3 * np.random.default_rng(seed).standard_normal(3)
    floor = am.Plane([0] * 3, -normals["bottom"])
    problem = am.ContactProblem(
        material=am.Solid(young=1e7, poisson=0.3),
        law=am.Frictionless(),
        contact=am.Contact("bottom", am.Moving(floor, displacement=shift, name="bottom")),
        supports=[
            am.Support("left", **dict(zip("xyz", shift, strict=True))),
            am.Support("front", normal=normals["front"] @ shift),
        ],
    )
    grids = am.Hierarchy.from_meshes(problem, [mesh])
    factors = [1.0, -0.5]
    path = am.LoadPath(dict.fromkeys(("left", "front", "bottom"), factors))
    for factor, result in zip(factors, am.solve_path(grids, path, EXACT), strict=True):
        np.testing.assert_allclose(
            result.displacement, np.tile(factor * shift, (mesh.n_nodes, 1)), atol=1e-12
        )
        np.testing.assert_allclose(result.contact.gap, 0.0, atol=1e-12)


def pressed(dim, **changes):
    """A block between two planes of symmetry that is pressed and pushed on an obstacle."""
    names = "left", *["front"] * (dim == 3)
    bottom = np.eye(dim)[-1]
    problem = am.ContactProblem(
        material=(am.Solid if dim == 3 else am.PlaneStrain)(young=1e7, poisson=0.3),
        law=am.Coulomb(0.3),
        contact=am.Contact("bottom", am.Plane(np.zeros(dim), bottom)),
        loads=(am.Pressure("right", -2e4),),
        supports=(*map(am.Symmetry, names), am.Support("top", normal=-2e-3)),
    )
    return replace(problem, **changes)


@pytest.mark.parametrize(
    ("moves", "tilt"), [(False, 0.0), (True, 0.0), (True, 0.4)], ids=["rests", "moves", "tilted"]
)
@pytest.mark.parametrize("dim", [2, 3])
def test_supports_along_normals_turn_with_the_body(dim, moves, tilt):
    """Also where planes move the edges along which they meet the contact boundary, at right angles
    or not."""
    sides = {"left": -1e-3, "front": 4e-4} if moves else {}
    guides = [am.Support(name, normal=shift) for name, shift in list(sides.items())[: dim - 1]]
    changes = {"supports": (*guides, am.Support("top", normal=-2e-3))} if moves else {}
    rng = np.random.default_rng(dim)
    turn, shift = random_turn(rng, dim), rng.uniform(-5, 5, dim)
    unit = am.Box(width=1, depth=1, height=1) if dim == 3 else am.Rectangle(width=1, height=1)
    shear = np.eye(dim)
    shear[-1, 0] = tilt
    meshes = [am.mesh.structured(unit, n) for n in (2, 4)]
    meshes = [replace(mesh, points=mesh.points @ shear.T) for mesh in meshes]
    up = np.linalg.solve(shear.T, np.eye(dim)[-1])
    straight, turned = (
        am.Hierarchy.from_meshes(
            pressed(dim, contact=am.Contact("bottom", am.Plane(place, matrix @ up)), **changes),
            [replace(mesh, points=mesh.points @ matrix.T + place) for mesh in meshes],
        )
        for matrix, place in ((np.eye(dim), np.zeros(dim)), (turn, shift))
    )
    factors = {"top": [1.0, 1.0, 0.5], "right": [0.0, 1.0, 0.5]}
    path = am.LoadPath(factors | ({"left": [0.5, 0.5, 1.0]} if moves else {}))
    one, other = (am.solve_path(grids, path, EXACT) for grids in (straight, turned))
    steps = [
        am.solve_path(turned, path, method)
        for method in (am.Multigrid(rtol=1e-10), am.FullMultigrid())
    ]
    for k in range(3):
        size = np.abs(one[k].displacement).max()
        np.testing.assert_allclose(
            other[k].displacement @ turn, one[k].displacement, atol=1e-8 * size
        )
        np.testing.assert_array_equal(other[k].contact.state, one[k].contact.state)
        for path_of in steps:
            np.testing.assert_allclose(
                path_of[k].displacement, other[k].displacement, atol=1e-6 * size
            )
        norms = [result[k].certificate().energy_norm for result in (one, other)]
        assert norms[0] == pytest.approx(norms[1], rel=1e-8)
        for name in ("left", "top", "bottom"):
            force = one[k].resultant(name).force
            np.testing.assert_allclose(
                other[k].resultant(name).force @ turn, force, atol=1e-5 * np.linalg.norm(force)
            )
        estimates = [
            am.Residual()
            .indicate(
                replace(
                    grids,
                    problem=am.problem.step_problem(
                        grids.problem, {name: path.factors[name][k] for name in path.factors}
                    ),
                ),
                found[k],
            )
            .total
            for grids, found in ((straight, one), (turned, other))
        ]
        assert estimates[0] == pytest.approx(estimates[1], rel=1e-5)


@pytest.mark.parametrize("moves", [False, True], ids=["rest", "move"])
@pytest.mark.parametrize("dim", [2, 3])
def test_pairs_between_plane_supports_turn_with_the_bodies(dim, moves):
    box, sides = (
        (am.Box, ("left", "front", "bottom")) if dim == 3 else (am.Rectangle, ("left", "bottom"))
    )
    parts = {
        name: box(
            origin=(*[0.0] * (dim - 1), low),
            width=wide,
            height=0.5,
            **({"depth": 1.0} if dim == 3 else {}),
        )
        for name, low, wide in (("upper", 0.0, 1.0), ("lower", -0.5, 1.5))
    }
    problem = pressed(
        dim,
        contact=am.ContactPair("upper.bottom", "lower.top"),
        supports=tuple(
            am.Support(f"{body}.{side}", normal=moves * shift)
            for body, shift in (("upper", -1e-3), ("lower", 4e-4))
            for side in sides
            if (body, side) != ("upper", "bottom")
        ),
        loads=(am.Pressure("upper.top", 1e4), am.Pressure("upper.right", -3e3)),
    )
    meshes = [
        am.mesh.structured(am.Assembly(parts=parts), {"upper": n, "lower": n + 1}) for n in (2, 4)
    ]
    turn = random_turn(np.random.default_rng(dim), dim)
    one, grids = (
        am.Hierarchy.from_meshes(
            problem, [replace(mesh, points=mesh.points @ each.T) for mesh in meshes]
        )
        for each in (np.eye(dim), turn)
    )
    expected, found = am.solve(one, EXACT), am.solve(grids, EXACT)
    size = np.abs(expected.displacement).max()
    np.testing.assert_allclose(found.displacement @ turn, expected.displacement, atol=1e-10 * size)
    np.testing.assert_allclose(
        am.solve(grids, am.Multigrid(rtol=1e-9)).displacement, found.displacement, atol=1e-6 * size
    )
    path = am.LoadPath(
        {"upper.top": 1.0, "upper.right": [0, 1]} | ({"upper.left": [0.5, 1]} if moves else {})
    )
    steps = [am.solve_path(each, path, EXACT)[1].contact.slip for each in (one, grids)]
    np.testing.assert_allclose(
        np.linalg.norm(steps[1], axis=1), np.linalg.norm(steps[0], axis=1), atol=1e-10 * size
    )
    for name in ("upper.left", "lower.bottom", "lower.top"):
        np.testing.assert_allclose(
            found.resultant(name).force @ turn, expected.resultant(name).force, atol=1e-4
        )
    # also where two planes meet, and hold the nodes that a corner faces in one of them each
    forces = expected.contact.master_force
    np.testing.assert_allclose(
        found.contact.master_force @ turn, forces, atol=1e-8 * np.abs(forces).max()
    )


def test_planes_that_hold_one_body_of_a_pair_each_turn_with_it():
    """A corner of the slave is held along one tangent, nodes that it faces along the other: it carries no
    condition, at any angle."""
    mesh = am.mesh.structured(
        am.Assembly(parts=slabs(3, upper=0.0, lower=-0.5)), {"upper": 2, "lower": 3}
    )
    held = ("upper.left", "upper.back", "lower.front", "lower.right", "lower.bottom")
    found = []
    for turn in (np.eye(3), random_turn(np.random.default_rng(2))):
        problem = am.ContactProblem(
            material=am.Solid(young=1e7, poisson=0.3),
            law=am.Coulomb(0.3),
            contact=am.ContactPair("upper.bottom", "lower.top"),
            loads=[
                am.Pressure("upper.top", 1e4),
                am.Traction("upper.right", turn @ [1e3, 2e3, 0.0]),
            ],
            supports=[am.Support(name, normal=0.0) for name in held],
        )
        grids = am.Hierarchy.from_meshes(problem, [replace(mesh, points=mesh.points @ turn.T)])
        found.append(am.solve(grids, EXACT).displacement @ turn)
    np.testing.assert_allclose(found[1], found[0], atol=1e-9 * np.abs(found[0]).max())


def clamped_beam(gap, seed, sinks=0.0):
    """A beam clamped at both ends above a plane, of a random place, size and direction; the meshes
    and the turn."""
    rng = np.random.default_rng(seed)
    size, angle, shift = (
        10.0 ** rng.uniform(-3, 2),
        rng.uniform(0, 2 * np.pi),
        rng.uniform(-5, 5, 2),
    )
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    meshes = [
        am.mesh.structured(am.Rectangle(width=1.0, height=0.2), n)
        for n in ((1, 1), (2, 1), (2, 2), (4, 2), (6, 3))
    ]
    meshes = [replace(one, points=size * one.points @ turn + shift) for one in meshes]
    x, y = size * np.array([0.0, sinks]) @ turn
    across = {"normal": 0.0} if seed else {"x": x}
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=2e9, poisson=0.3),
        law=am.Coulomb(0.3),
        loads=(am.Pressure("top", 8e7),),
        contact=am.Contact(
            "bottom", am.Plane(size * np.array([0, -gap]) @ turn + shift, np.array([0, 1]) @ turn)
        ),
        supports=tuple(am.Support(name, **across, y=y) for name in ("left", "right")),
    )
    return problem, meshes, turn / size


@pytest.mark.parametrize("seed", range(2))
def test_a_clamped_end_above_the_obstacle_carries_no_contact(seed):
    problem, meshes, back = clamped_beam(0.05, seed)
    grids = am.Hierarchy.from_meshes(problem, meshes)
    assert [row["contact_nodes"] for row in grids.table()] == [0, 1, 1, 3, 5]
    exact = am.solve(grids, EXACT)
    assert (
        exact.contact.state != am.OPEN
    ).sum() == 3 and exact.contact.gap.min() >= -1e-14 * np.ptp(meshes[-1].points)
    upright = am.Hierarchy.uniform(
        replace(
            problem,
            domain=am.Rectangle(width=1.0, height=0.2),
            contact=am.Contact("bottom", am.Plane((0, -0.05), (0, 1))),
        ),
        [(6, 3)],
    )
    np.testing.assert_allclose(
        exact.displacement @ back.T, am.solve(upright, EXACT).displacement, atol=1e-9
    )
    for method in (
        am.Multigrid(),
        am.FullMultigrid(),
        am.Multigrid(correction=am.Monotone(), max_cycles=400),
    ):
        for finest in range(1, 5):
            part = grids.truncated(finest=finest)
            np.testing.assert_allclose(
                am.solve(part, method).displacement,
                am.solve(part, EXACT).displacement,
                atol=1e-6 * np.abs(exact.displacement).max(),
            )


def test_two_contact_nodes_of_a_floating_body_are_a_level():
    """With one of them fixed the body turns about it: no sweep solves the condensed problem node by
    node."""
    beam = am.Rectangle(width=1.0, height=0.2)
    problem = am.ContactProblem(
        domain=am.Assembly(parts={"beam": beam, "bed": replace(beam, origin=(0, -0.2))}),
        law=am.Coulomb(0.3),
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        contact=am.ContactPair("beam.bottom", "bed.top"),
        loads=(am.Pressure("beam.top", 1e5),),
        supports=(am.Support("bed.bottom", x=0, y=0),),
    )
    grids = am.Hierarchy.uniform(problem, (1, 2))
    monotone = am.solve(grids, am.Multigrid(correction=am.Monotone()))
    exact = am.solve(grids, EXACT).displacement
    np.testing.assert_allclose(monotone.displacement, exact, atol=1e-6 * np.abs(exact).max())
    with pytest.raises(ValueError, match="condensed=True needs more contact nodes"):
        am.solve(grids.truncated(finest=0), am.SingleGrid(condensed=True))


def test_nothing_passes_from_a_roller_to_the_contact_next_to_it():
    problem = am.ContactProblem(
        domain=am.Rectangle(width=1.0, height=0.5),
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        law=am.Coulomb(0.3),
        contact=am.Contact("bottom", am.Plane((0, -1e-4), (0, 1))),
        loads=(am.Pressure("top", 2e5), am.Traction("right", (-1e5, 0.0))),
        supports=(am.Support("left", y=0), am.PointSupport((1, 0.5), x=0)),
    )
    grids = am.Hierarchy.uniform(problem, (2, 4, 8))
    monotone = am.solve(grids, am.Multigrid(correction=am.Monotone(), max_cycles=200))
    np.testing.assert_allclose(
        monotone.displacement, am.solve(grids, EXACT).displacement, atol=1e-10
    )


@pytest.mark.parametrize("dim", [2, 3])
def test_clamped_ends_of_a_slave_carry_no_multiplier(dim):
    """A beam between clamps on a soft bed: every level couples what is free, and the forces
    balance."""
    size, box = ((1.0, 0.2), am.Rectangle) if dim == 2 else ((1.0, 0.3, 0.2), am.Box)
    names = ("width", "height") if dim == 2 else ("width", "depth", "height")
    beam = box(**dict(zip(names, size, strict=True)))
    bed = replace(beam, origin=(*[0.0] * (dim - 1), -0.2))
    held = dict.fromkeys("xyz"[:dim], 0.0)
    material = (am.PlaneStrain if dim == 2 else am.Solid)(young=1e9, poisson=0.3)
    problem = am.ContactProblem(
        domain=am.Assembly(parts={"beam": beam, "bed": bed}),
        material=material,
        law=am.Coulomb(0.3),
        contact=am.ContactPair("beam.bottom", "bed.top"),
        loads=(am.Pressure("beam.top", 1e5),),
        supports=tuple(
            am.Support(name, **held) for name in ("beam.left", "beam.right", "bed.bottom")
        ),
    )
    grids = am.Hierarchy.uniform(problem, [(n, *[max(n // 2, 1)] * (dim - 1)) for n in (1, 2, 4)])
    counts = [row["contact_nodes"] for row in grids.table()]
    assert counts == ([0, 1, 3] if dim == 2 else [0, 2, 9])
    exact = am.solve(grids, EXACT)
    assert_balanced(exact, Parts.of(problem, grids.finest.mesh), 1e-9)
    monotone = am.Multigrid(correction=am.Monotone(), max_cycles=400)
    for method in (am.Multigrid(rtol=1e-9), am.FullMultigrid(rtol=1e-9), monotone):
        np.testing.assert_allclose(
            am.solve(grids, method).displacement,
            exact.displacement,
            atol=1e-6 * np.abs(exact.displacement).max(),
        )


@pytest.mark.parametrize("seed", range(2))
def test_a_support_may_move_up_to_the_obstacle_and_not_beyond(seed):
    problem, meshes, _ = clamped_beam(0.05, seed, sinks=-0.049)
    grids = am.Hierarchy.from_meshes(problem, meshes[-2:])
    assert am.solve(grids, EXACT).contact.gap.min() >= -1e-14 * np.ptp(meshes[-1].points)
    crossing = am.LoadPath({"left": [0.5, 1.0, 1.5], "right": [0.5, 1.0, 1.5]})
    with pytest.raises(ValueError, match=r"of contact boundary 'bottom' .* inside its obstacle"):
        am.solve_path(grids, crossing, EXACT)
    with pytest.raises(ValueError, match=r"of contact boundary 'bottom' .* inside its obstacle"):
        am.discretise(clamped_beam(0.05, seed, sinks=-0.051)[0], meshes[-1])


FRICTION, PRESSURE, PULL = 0.4, 1e7, 1e-3
EXACT = am.ActiveSet(rtol=1e-11)


def pad(dim, slave="pad", coupling="mortar", pull=PULL, friction=FRICTION):
    """A pad held at its sides on a plate that is pulled along x."""
    pair = ("pad.bottom", "plate.top") if slave == "pad" else ("plate.top", "pad.bottom")
    if dim == 2:
        parts = {
            "pad": am.Rectangle(width=40e-3, height=20e-3),
            "plate": am.Rectangle(width=80e-3, height=20e-3, origin=(-20e-3, -20e-3)),
        }
        below = am.Support("plate.bottom", x=pull, y=0.0)
        material = am.PlaneStrain(young=2.1e11, poisson=0.3)
    else:
        parts = {
            "pad": am.Box(width=40e-3, depth=40e-3, height=20e-3),
            "plate": am.Box(
                width=80e-3, depth=80e-3, height=20e-3, origin=(-20e-3, -20e-3, -20e-3)
            ),
        }
        below, material = (
            am.Support("plate.bottom", x=pull, y=0.0, z=0.0),
            am.Solid(young=2.1e11, poisson=0.3),
        )
    return am.ContactProblem(
        name="pad",
        domain=am.Assembly(parts=parts),
        material=material,
        law=am.Coulomb(friction),
        contact=am.ContactPair(*pair, coupling=coupling),
        loads=(am.Pressure("pad.top", PRESSURE),),
        supports=(
            am.Support("pad.left", x=0.0),
            am.Support("pad.right", x=0.0),
            below,
            *((am.Support("pad.front", y=0.0),) if dim == 3 else ()),
        ),
    )


def test_a_pad_in_an_inclined_guide_slides_on_its_plate():
    straight, turn = pad(2), np.array([[0.8, -0.6], [0.6, 0.8]])
    pulled = dict(zip("xy", turn @ [PULL, 0.0], strict=True))
    problem = replace(
        straight,
        domain=None,
        supports=(
            am.Support("pad.left", normal=0),
            am.Symmetry("pad.right"),
            am.Support("plate.bottom", **pulled),
        ),
    )
    meshes = [level.mesh for level in grids(straight, 2, 6, 4).levels]
    result = am.solve(
        am.Hierarchy.from_meshes(
            problem, [replace(one, points=one.points @ turn.T) for one in meshes]
        ),
        am.ActiveSet(rtol=1e-10),
    )
    assert result.resultant("pad.bottom").force @ turn == pytest.approx(
        [FRICTION * PRESSURE * 40e-3, PRESSURE * 40e-3], rel=1e-8
    )
    assert result.certificate().worst.relative < 1e-8


def grids(problem, dim, on_pad, on_plate):
    """Two uniform levels; cells along the edge of the pad, and of the plate over the same
    length."""

    def divisions(a, b):
        if dim == 2:
            return {"pad": (a, max(a // 2, 1)), "plate": (2 * b, max(b // 2, 1))}
        return {"pad": (a, a, max(a // 2, 1)), "plate": (2 * b, 2 * b, max(b // 2, 1))}

    return am.Hierarchy.uniform(
        problem, [divisions(on_pad // 2, on_plate // 2), divisions(on_pad, on_plate)]
    )


@pytest.mark.parametrize(
    ("dim", "slave", "coupling", "on_pad", "on_plate"),
    [
        (2, "pad", "mortar", 8, 5),
        (2, "plate", "mortar", 8, 5),
        (2, "pad", "nodes", 8, 8),
        (3, "pad", "mortar", 6, 4),
        (3, "plate", "mortar", 4, 5),
    ],
)
def test_all_of_the_pad_slides(dim, slave, coupling, on_pad, on_plate):
    result = am.solve(grids(pad(dim, slave, coupling), dim, on_pad, on_plate), EXACT)
    area = 40e-3 if dim == 2 else 1.6e-3
    on_the_pad, on_the_plate = (
        result.resultant("pad.bottom").force,
        result.resultant("plate.top").force,
    )
    assert np.abs(on_the_pad + on_the_plate).max() <= 1e-12 * PRESSURE * area
    assert on_the_pad[-1] == pytest.approx(PRESSURE * area, rel=1e-9)
    assert (result.contact.state == am.SLIP).all()
    np.testing.assert_allclose(
        np.linalg.norm(result.contact.force_t, axis=1), result.contact.limit, rtol=1e-8
    )
    # in 3D the slip deviates by the bulge of the pad, a 1e-4 th of the pull
    assert np.abs(on_the_pad[0]) == pytest.approx(
        FRICTION * PRESSURE * area, rel=1e-9 if dim == 2 else 3e-7
    )
    # the supports of the pad take the friction
    taken = sum(result.resultant(name).force[0] for name in ("pad.left", "pad.right"))
    assert taken == pytest.approx(-on_the_pad[0], rel=1e-8)
    # held nodes of the pad carry no multiplier: their neighbours take their part
    assert slave == "plate" or len(result.contact) < len(result.mesh.boundary_nodes("pad.bottom"))
    assert result.certificate().worst.relative < 1e-8


def test_a_slave_that_is_held_along_its_whole_surface_is_refused():
    held = replace(pad(2), supports=(*pad(2).supports, am.Support("pad.bottom", x=0)))
    with pytest.raises(
        ValueError, match=r"holds slave 'pad.bottom' along its surface.*exchange slave and master"
    ):
        grids(held, 2, 8, 5)
    with pytest.raises(ValueError, match=r"slave node .* has a supported tangential component"):
        discrete = grids(pad(2, friction=0.0), 2, 8, 5).finest.discrete
        am.DiscreteProblem(
            matrix=discrete.matrix,
            load=discrete.load,
            fixed=discrete.fixed,
            law=am.Coulomb(0.4),
            contact=discrete.contact,
        ).coupled(discrete.coupling.weights)


@pytest.mark.parametrize(
    ("law", "pull", "nu"),
    [
        (am.Coulomb(0.4), 1e-7, 0.2),
        (am.Coulomb(0.4), 2e-5, 0.2),
        (am.Tresca(1.5e7), 1e-7, 0.2),
        (am.Coulomb(0.4), 2e-5, 0.49),
    ],
    ids=["little", "far", "tresca", "smoothed"],
)
def test_friction_is_opposite_to_all_of_the_slip(law, pull, nu):
    """On a rigid plane: one tangent is driven by the support, the other one free; Newton and cycles
    agree."""
    problem = am.ContactProblem(
        domain=am.Box(width=40e-3, depth=40e-3, height=30e-3),
        material=am.Solid(young=1.3e11, poisson=nu),
        elements="smoothed" if nu > 0.4 else "linear",
        law=law,
        contact=am.Contact("bottom", am.Plane(point=(0, 0, 0), normal=(0, 0, 1))),
        loads=(am.Pressure("top", 5e7), am.Traction("back", (0, 5e6, 0))),
        supports=(am.Support("left", x=pull), am.Support("right", x=pull)),
    )
    levels = am.Hierarchy.uniform(problem, ((2, 2, 2), (4, 4, 3)))
    exact = am.solve(levels, EXACT)
    contact, slides = exact.contact, exact.contact.state == am.SLIP
    against = np.sum(contact.force_t * contact.slip, axis=1)[slides]
    size = (np.linalg.norm(contact.slip, axis=1) * contact.limit)[slides]
    np.testing.assert_allclose(against, -size, rtol=1e-9)
    for solver in (am.ActiveSet(condensed=False, rtol=1e-12), am.FullMultigrid(rtol=1e-10)):
        assert am.solve(levels, solver, reference=exact).history["true_error"][-1] <= 3e-10


@pytest.mark.parametrize("moved", [0.0, 0.02, -0.03])
@pytest.mark.parametrize("angle", [0.0, 0.5, 1.2])
def test_a_roller_closes_its_gap_along_the_way_it_is_free_to_go(angle, moved):
    """A corner on a guide along y has the height above an inclined floor as its gap, where the
    guide moves it."""
    floor = am.Plane(point=(0.0, -0.1), normal=(np.sin(angle), np.cos(angle)))
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=E, poisson=0.3),
        domain=am.Rectangle(width=1, height=1),
        contact=am.Contact("bottom", floor),
        law=am.Frictionless(),
        loads=am.Pressure("top", PRESSURE),
        supports=am.Support("left", x=moved),
    )
    mesh = am.mesh.structured(problem.domain, 2)
    contact = am.discretise(problem, mesh).contact
    corner = (mesh.points[contact.nodes] == 0.0).all(axis=1)
    np.testing.assert_allclose(contact.gaps[corner], 0.1 + moved * np.tan(angle), rtol=1e-12)
    np.testing.assert_allclose(contact.normals[corner], [[0.0, -1.0]], atol=1e-12)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("dim", [2, 3])
def test_a_turned_state_has_the_same_residual_and_reactions(dim, seed):
    """Of any displacement the natural residual, over the largest forces, does not depend on whether
    the directions that supports hold and move are axes."""
    rng = np.random.default_rng(seed)
    unit = am.Box(width=1, depth=1, height=1) if dim == 3 else am.Rectangle(width=1, height=1)
    mesh = am.mesh.structured(unit, 3)
    displacement = 1e-4 * rng.standard_normal(mesh.points.shape)
    turn = random_turn(rng, dim)
    examined = []
    for axes in (np.eye(dim), turn):
        problem = am.ContactProblem(
            material=(am.Solid if dim == 3 else am.PlaneStrain)(young=1e9, poisson=0.3),
            law=am.Coulomb(0.3),
            loads=[am.Pressure("top", 1e3)],
            supports=[am.Support("left", normal=1e-3), am.Symmetry("right")],
            contact=am.Contact("bottom", am.Plane([0] * dim, axes[:, -1])),
        )
        discrete = am.discretise(problem, replace(mesh, points=mesh.points @ axes.T))
        start = discrete.from_prescribed(displacement @ axes.T)
        state = Examiner(discrete)(discrete.with_prescribed(start))
        examined.append((state.residual, state.reaction @ axes))
    (residual, reaction), (turned_residual, turned_reaction) = examined
    assert turned_residual == pytest.approx(residual, rel=1e-9)
    np.testing.assert_allclose(turned_reaction, reaction, atol=1e-9 * np.abs(reaction).max())
