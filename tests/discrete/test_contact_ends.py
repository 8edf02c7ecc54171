"""Where a contact boundary ends, or meets another: what nodes without a condition bear is taken
over."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import random_turn, rotation
from simplex_meshes import random_box

import adaptmg as am

YOUNG, POISSON, P = 1e9, 0.3, 1e6
SIDES = ("left", "right", "front", "back", "bottom", "top")
EXACT = am.ActiveSet(rtol=1e-12)


def sides_of(dim):
    """The sides of a box by axis: at 0 and at 1."""
    return [SIDES[:2], SIDES[2:4], SIDES[4:]] if dim == 3 else [SIDES[:2], SIDES[4:]]


def skewed_box(dim, seed, skew):
    """A box with inner nodes at random, numbered at random, sheared, turned, scaled and moved."""
    rng, mesh = np.random.default_rng(seed), random_box(30, dim, seed)
    middle = mesh.points[mesh.facets].mean(axis=1)
    names = [name for pair in sides_of(dim) for name in pair]
    places = [
        np.abs(middle[:, axis] - value) < 1e-12 for axis in range(dim) for value in (0.0, 1.0)
    ]
    turn = random_turn(rng, dim)
    shape = turn @ (np.eye(dim) + skew * np.triu(rng.uniform(0.5, 1, (dim, dim)), 1))
    scale, order = 10 ** rng.uniform(-3, 1), rng.permutation(mesh.n_nodes)
    number = np.argsort(order)
    moved = replace(
        mesh,
        points=scale * (mesh.points @ shape.T + rng.normal(size=dim))[order],
        elements=number[mesh.elements],
        facets=number[mesh.facets],
        facet_labels=np.argmax(places, axis=0),
        boundaries=tuple(names),
    )
    return moved, turn, scale


@pytest.mark.parametrize("elements", ["linear", "smoothed"])
@pytest.mark.parametrize(
    ("order", "skew", "friction"),
    [
        (("left", "bottom"), 0.0, None),
        (("bottom", "left"), 1.2, None),
        (("left", "bottom"), -1.2, None),
        (("bottom", "left"), 0.0, "bottom"),
        (("left", "bottom"), 0.0, "bottom"),
        (("front", "bottom", "left"), 0.0, None),
        (("left", "bottom", "front"), 0.6, None),
        (("bottom", "front", "left"), 0.0, "bottom"),
    ],
)
def test_a_block_in_the_corner_of_walls(order, skew, friction, elements):
    """Under pressure all around, or sticking to the floor without sliding: the exact solution is
    linear."""
    dim = len(order)
    mesh, turn, scale = skewed_box(dim, seed=len(elements) + dim, skew=skew)
    if friction is None:
        stress = -P * np.eye(dim)
    else:  # no strain along the floor
        stress = turn @ np.diag([-P * POISSON / (1 - POISSON)] * (dim - 1) + [-P]) @ turn.T
    lame, shear = YOUNG * POISSON / (1 + POISSON) / (1 - 2 * POISSON), YOUNG / 2 / (1 + POISSON)
    trace = np.trace(stress) / (dim * lame + 2 * shear)
    strain = (stress - lame * trace * np.eye(dim)) / (2 * shear)
    normal = {name: mesh.surface(name).normals[0] for name in mesh.boundaries}
    place = {name: mesh.points[mesh.boundary_nodes(name)[0]] for name in mesh.boundaries}
    gaps = 1e-3 * scale * np.random.default_rng(dim).uniform(size=dim)
    walls = np.array([normal[name] for name in order])
    corner = np.linalg.solve(walls, [normal[name] @ place[name] for name in order])
    exact = (mesh.points - corner) @ strain.T + np.linalg.solve(walls, gaps)
    contact = [
        am.Contact(
            name,
            am.Plane(place[name] + gap * normal[name], -normal[name]),
            law=am.Coulomb(0.4) if name == friction else am.Frictionless(),
        )
        for name, gap in zip(order, gaps, strict=True)
    ]
    material = am.PlaneStrain if dim == 2 else am.Solid
    problem = am.ContactProblem(
        material=material(young=YOUNG, poisson=POISSON),
        contact=contact,
        law=am.Frictionless(),
        loads=[
            am.Traction(name, tuple(stress @ normal[name]))
            for name in mesh.boundaries
            if name not in order
        ],
        supports=(),
        elements=elements,
    )
    if friction is not None:  # the floor does not hold before it is pressed
        exact -= turn[:, :-1] @ (turn[:, :-1].T @ np.linalg.solve(walls, gaps))
        contact = [
            replace(one, obstacle=am.Plane(place[one.boundary], -normal[one.boundary]))
            if one.boundary != friction
            else one
            for one in contact
        ]
        problem = replace(problem, contact=contact)
    result = am.solve(am.discretise(problem, mesh), EXACT)
    assert np.abs(result.displacement - exact).max() <= 1e-10 * np.abs(exact).max()
    result = am.solve(am.Hierarchy.from_meshes(problem, [mesh]), EXACT)
    for name in order:
        force = stress @ normal[name] * mesh.surface(name).measures.sum()
        got = result.resultant(name)
        assert np.abs(got.force - force).max() <= 1e-9 * np.abs(force).max()
    pressures = -np.einsum("nd,de,ne->n", result.contact.normal, stress, result.contact.normal)
    np.testing.assert_allclose(result.contact.pressure, pressures, rtol=1e-8)
    # reported gaps and areas are those of the boundary
    measure = sum(mesh.surface(name).measures.sum() for name in order)
    assert result.contact_area == pytest.approx(measure, rel=1e-12)


@pytest.mark.parametrize("tie", [("a.bottom", "b.top"), ("b.top", "a.bottom")])
@pytest.mark.parametrize("divisions", [{"a": 4, "b": 5}, {"a": (5, 3), "b": (2, 4)}])
def test_contact_ends_at_a_tie(tie, divisions):
    """Two blocks of one material, a wall beside the upper one alone: the exact solution is
    linear."""
    parts = {
        "a": am.Rectangle(width=1, height=1, origin=(0, 1)),
        "b": am.Rectangle(width=1, height=1),
    }
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        material=am.PlaneStrain(young=YOUNG, poisson=POISSON),
        law=am.Frictionless(),
        ties=am.Tied(*tie),
        contact=(
            am.Contact("a.right", am.Plane((1, 1), (-1, 0))),
            am.Contact("b.bottom", am.Plane((0, 0), (0, 1))),
        ),
        loads=[am.Pressure(name, P) for name in ("a.left", "a.top", "b.left", "b.right")],
    )
    grids = am.Hierarchy.uniform(problem, [divisions])
    result = am.solve(grids, EXACT)
    strain = (1 + POISSON) * (1 - 2 * POISSON) * P / YOUNG
    exact = -strain * (result.mesh.points - (1, 0))
    assert np.abs(result.displacement - exact).max() <= 1e-10 * strain
    np.testing.assert_allclose(result.contact.pressure, P, rtol=1e-8)
    np.testing.assert_allclose(result.resultant("a.right").force, (-P, 0), atol=1e-6 * P)


@pytest.mark.parametrize("divisions", [(6, 12), (12, 6), (5, 13), (6, 7), (6, 6)])
@pytest.mark.parametrize("law", [am.Frictionless(), am.Coulomb(0.3)], ids=["smooth", "rough"])
def test_contact_goes_on_across_a_tie(divisions, law):
    """Two glued blocks on one floor, turned: uniform pressure whichever side has the finer mesh."""
    rng = np.random.default_rng(sum(divisions))
    turn = rotation(rng.uniform(0, 2 * np.pi))
    size = 10 ** rng.uniform(-3, 1)
    shift = rng.normal(size=2)

    def block(x):
        corners = np.array([(x, 0), (x + 1, 0), (x + 1, 1), (x, 1)])
        places = shift + size * corners @ turn.T
        return am.Polygon(
            vertices=tuple(map(tuple, places)), boundaries=("bottom", "right", "top", "left")
        )

    parts = {"left": block(0), "right": block(1)}
    floor = am.Plane(tuple(shift), tuple(turn[:, 1]))
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        material=am.PlaneStrain(young=YOUNG, poisson=0.0),
        law=law,
        ties=am.Tied("left.right", "right.left"),
        contact=[am.Contact(f"{body}.bottom", floor) for body in parts],
        loads=[am.Pressure(f"{body}.top", P) for body in parts],
        supports=am.Support("left.left", normal=0.0),
    )
    sizes = {name: size / n for name, n in zip(parts, divisions, strict=True)}
    result = am.solve(am.Hierarchy.graded(problem, sizes=[sizes]), EXACT)
    up = (result.mesh.points - shift) @ turn[:, 1]
    np.testing.assert_allclose(
        result.displacement @ turn[:, 1], -P / YOUNG * up, atol=1e-9 * size * P / YOUNG
    )
    np.testing.assert_allclose(result.contact.pressure, P, rtol=1e-8)


@pytest.mark.parametrize("order", [("floor", "wall"), ("wall", "floor")])
def test_a_cylinder_on_its_end_between_walls(order):
    """In axisymmetry masses carry the circumference."""
    domain = am.Rectangle(width=0.3, height=0.2, origin=(0.1, 0.0))
    walls = {
        "floor": am.Contact("bottom", am.Plane((0, 0), (0, 1))),
        "wall": am.Contact("right", am.Plane((0.4, 0), (-1, 0))),
    }
    problem = am.ContactProblem(
        domain=domain,
        material=am.Axisymmetric(young=YOUNG, poisson=POISSON),
        law=am.Frictionless(),
        contact=[walls[name] for name in order],
        loads=(am.Pressure("top", P),),
        supports=(am.Support("left", x=0.0),),
    )
    grids = am.Hierarchy.uniform(problem, [(6, 4)])
    result = am.solve(grids, EXACT)
    strain = (1 + POISSON) * (1 - 2 * POISSON) / (1 - POISSON) * P / YOUNG
    assert np.abs(result.displacement[:, 1] + strain * result.mesh.points[:, 1]).max() <= 1e-10
    pressure = np.where(result.contact.normal[:, 0] > 0.5, POISSON / (1 - POISSON), 1.0) * P
    np.testing.assert_allclose(result.contact.pressure, pressure, rtol=1e-8)
    area = np.pi * (0.4**2 - 0.1**2)
    assert result.resultant("bottom").force[1] == pytest.approx(P * area, rel=1e-9)
    assert result.contact_area == pytest.approx(area + 2 * np.pi * 0.4 * 0.2, rel=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_contact_ends_at_a_support_that_moves(dim):
    """A side follows a block that is pressed onto a floor across a gap."""
    up, gap = "xyz"[dim - 1], 2e-4
    strain = (1 + POISSON) * (1 - 2 * POISSON) / (1 - POISSON) * P / YOUNG
    sizes = {"width": 1.0, "height": 0.7}
    box = am.Rectangle(**sizes) if dim == 2 else am.Box(depth=0.9, **sizes)
    moved = {axis: 0.0 for axis in "xyz"[: dim - 1]} | {up: lambda x: -strain * x[:, -1] - gap}
    walls = [am.Support("right", x=0.0)]
    if dim == 3:
        walls += [am.Support("front", y=0.0), am.Support("back", y=0.0)]
    floor = am.Plane([0.0] * (dim - 1) + [-gap], [0.0] * (dim - 1) + [1.0])
    problem = am.ContactProblem(
        domain=box,
        material=(am.PlaneStrain if dim == 2 else am.Solid)(young=YOUNG, poisson=POISSON),
        contact=am.Contact("bottom", floor),
        law=am.Coulomb(0.3),
        loads=am.Pressure("top", P),
        supports=[am.Support("left", **moved), *walls],
    )
    grids = am.Hierarchy.uniform(problem, [4 if dim == 3 else 6])
    result = am.solve(grids, EXACT)
    exact = np.zeros_like(result.displacement)
    exact[:, -1] = -strain * result.mesh.points[:, -1] - gap
    assert np.abs(result.displacement - exact).max() <= 1e-10 * np.abs(exact).max()
    np.testing.assert_allclose(result.contact.pressure, P, rtol=1e-8)
    area = 1.0 if dim == 2 else 0.9
    assert result.resultant("bottom").force[-1] == pytest.approx(P * area, rel=1e-9)
    assert result.contact_area == pytest.approx(area, rel=1e-12)
    # what a support holds of the end is its own
    assert abs(result.resultant("left").force[-1]) <= 1e-8 * P
    # bodies that do not touch report their gap there, too
    apart = replace(problem, supports=[am.Support("left", **dict.fromkeys("xyz"[:dim], 0.0))])
    apart = am.solve(am.Hierarchy.uniform(replace(apart, loads=()), [4]), EXACT)
    np.testing.assert_allclose(apart.contact.gap, gap, rtol=1e-9)


@pytest.mark.parametrize("order", [("floor", "wall", "punch"), ("punch", "wall", "floor")])
def test_walls_that_move_and_press(order):
    """A floor and a wall go away, a rigid punch follows with a given force."""
    walls = {
        "floor": am.Contact(
            "bottom", am.Moving(am.Plane((0, 0), (0, 1)), displacement=(0, -3e-4), name="floor")
        ),
        "wall": am.Contact(
            "left", am.Moving(am.Plane((0, 0), (1, 0)), displacement=(-2e-4, 0), name="wall")
        ),
        "punch": am.Contact(
            "right", am.Rigid(am.Plane((1, 0), (-1, 0)), force=(-0.8 * P, 0), name="punch")
        ),
    }
    problem = am.ContactProblem(
        domain=am.Rectangle(width=1.0, height=0.8),
        material=am.PlaneStrain(young=YOUNG, poisson=POISSON),
        contact=[walls[name] for name in order],
        law=am.Frictionless(),
        loads=am.Pressure("top", P),
    )
    grids = am.Hierarchy.uniform(problem, [(5, 4)])
    strain = (1 + POISSON) * (1 - 2 * POISSON) * P / YOUNG
    factors = {"floor": (0, 1), "wall": (0.5, 1), "punch": (1, 1), "top": (1, 1)}
    path = am.solve_path(grids, am.LoadPath(factors), EXACT)
    for result, floor, wall in zip(path.results, factors["floor"], factors["wall"], strict=True):
        exact = -strain * result.mesh.points + (-2e-4 * wall, -3e-4 * floor)
        assert np.abs(result.displacement - exact).max() <= 1e-8 * strain
        np.testing.assert_allclose(result.contact.pressure, P, rtol=1e-6)
        np.testing.assert_allclose(result.resultant("right").force, (-0.8 * P, 0), atol=1e-6 * P)


@pytest.mark.parametrize("coupling", ["mortar", "nodes"])
@pytest.mark.parametrize("order", [("floor", "wall", "door"), ("door", "wall", "floor")])
def test_a_block_in_the_corner_of_bodies(order, coupling):
    """At a corner of the block a facet may have no node with a condition of its pair."""
    parts = {
        "block": am.Box(width=1.0, depth=1.0, height=1.0),
        "floor": am.Box(width=1.0, depth=1.0, height=0.5, origin=(0, 0, -0.5)),
        "wall": am.Box(width=0.5, depth=1.0, height=1.0, origin=(1, 0, 0)),
        "door": am.Box(width=1.0, depth=0.5, height=1.0, origin=(0, -0.5, 0)),
    }
    pairs = {
        "floor": ("block.bottom", "floor.top"),
        "wall": ("block.right", "wall.left"),
        "door": ("block.front", "door.back"),
    }
    strain = (1 - 2 * POISSON) * P / YOUNG
    exact = {axis: lambda x, k=k: -strain * x[:, k] for k, axis in enumerate("xyz")}
    supports = [am.Support(name, **exact) for name in ("floor.bottom", "wall.right", "door.front")]
    inside = {name for pair in pairs.values() for name in pair}
    inside |= {one.boundary for one in supports}
    sides = {f"{body}.{side}" for body in parts for side in SIDES}
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        material=am.Solid(young=YOUNG, poisson=POISSON),
        contact=[am.ContactPair(*pairs[name], coupling=coupling) for name in order],
        law=am.Frictionless(),
        loads=[am.Pressure(name, P) for name in sorted(sides - inside)],
        supports=supports,
    )
    divisions = {"block": 4, "floor": (4, 4, 2), "wall": (2, 4, 4), "door": (4, 2, 4)}
    if coupling == "mortar":
        divisions |= {"floor": (3, 5, 2), "door": (3, 1, 2)}
    result = am.solve(am.Hierarchy.uniform(problem, [divisions]), EXACT)
    wrong = result.displacement + strain * result.mesh.points
    assert np.abs(wrong).max() <= 1e-10 * strain
    np.testing.assert_allclose(result.contact.pressure, P, rtol=1e-8)
    for name in inside:
        got = np.abs(result.resultant(name).force).max()
        assert got == pytest.approx(P, rel=1e-9)


@pytest.mark.parametrize("direction", ["normal", "y"])
def test_the_force_next_to_a_clamped_side_and_its_estimate(direction):
    """The force on the last half edge is above 1 % here."""
    domain = am.Polygon(
        vertices=((0, 0), (1, 0), (1, 0.7), (0, 0.7)), boundaries=("bottom", "right", "top", "left")
    )
    problem = am.ContactProblem(
        domain=domain,
        material=am.PlaneStrain(young=YOUNG, poisson=POISSON),
        contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
        law=am.Frictionless(),
        loads=am.Pressure("top", lambda x: P * (1 + 0.5 * x[:, 0])),
        supports=am.Support("left", x=0, y=0),
    )
    coarse, fine = (
        am.Hierarchy.from_meshes(problem, [am.mesh.graded(domain, size, ())])
        for size in (0.032, 0.008)
    )
    result, reference = (am.solve(grids, am.ActiveSet()) for grids in (coarse, fine))
    force, expected = (one.resultant("bottom").force[1] for one in (result, reference))
    assert force == pytest.approx(expected, rel=2e-3)
    estimate = am.Goal(am.ContactForce("bottom", direction)).indicate(coarse, result)
    assert estimate.values[0] == pytest.approx(force, rel=1e-9)
    assert 0.5 <= estimate.errors[0] / (expected - force) <= 2


def test_contact_ends_on_a_plane_of_symmetry():
    """A sloping floor: next to the end of the common edge a part of its normal is held."""
    mesh, gap = am.mesh.structured(am.Box(width=1.0, depth=1.0, height=1.0), 3), 2e-4
    mesh = replace(mesh, points=mesh.points - [[0, 0, 0.5]] * mesh.points[:, :1])
    normal = mesh.surface("bottom").normals[0]
    strain, moved = (1 - 2 * POISSON) * P / YOUNG, np.array([0, 0, gap / normal[2]])
    exact = {axis: lambda x, k=k: -strain * x[:, k] + moved[k] for k, axis in enumerate("xyz")}
    problem = am.ContactProblem(
        material=am.Solid(young=YOUNG, poisson=POISSON),
        law=am.Frictionless(),
        contact=am.Contact("bottom", am.Plane(gap * normal, -normal)),
        loads=[am.Pressure(name, P) for name in ("right", "back", "top")],
        supports=[am.Support("left", x=0.0), am.Support("front", **exact)],
    )
    result = am.solve(am.discretise(problem, mesh), EXACT)
    wrong = result.displacement + strain * mesh.points - moved
    assert np.abs(wrong).max() <= 1e-10 * gap
