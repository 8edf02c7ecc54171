"""Ties: bodies that move together on meshes that do not match."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bodies import EXACT, random_turn, rotation, slabs
from refused import refused

import adaptmg as am

E, NU = 1e7, 0.3
PLANE = am.PlaneStrain(young=E, poisson=NU)


def stacked(dim, seed):
    """Two tied blocks under tension in a random place, size and direction; the meshes and the
    turn."""
    rng = np.random.default_rng(seed)
    turn = random_turn(rng, dim)
    size, shift = 10.0 ** rng.uniform(-3, 2), rng.uniform(-5, 5, dim)
    parts = slabs(dim, upper=0.5, lower=0.0)
    meshes = [
        am.mesh.structured(am.Assembly(parts=parts), {"upper": 3 * n // 2, "lower": n})
        for n in (2, 4)
    ]
    meshes = [replace(one, points=size * one.points @ turn.T + shift) for one in meshes]
    planes = [f"{body}.{side}" for body in parts for side in ("left", "front")[: dim - 1]]
    problem = am.ContactProblem(
        material=(am.Solid if dim == 3 else am.PlaneStrain)(young=E, poisson=NU),
        loads=am.Pressure("upper.top", -1e3),
        ties=am.Tied("upper.bottom", "lower.top"),
        supports=[*map(am.Symmetry, planes), am.Symmetry("lower.bottom")],
    )
    return problem, meshes, turn, lambda points: (points - shift) @ turn


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("dim", [2, 3])
def test_a_tie_passes_a_uniform_stress_exactly(dim, seed):
    problem, meshes, turn, back = stacked(dim, seed)
    grids = am.Hierarchy.from_meshes(problem, meshes)
    strain = np.array([-NU * (1 + NU), 1 - NU**2] if dim == 2 else [-NU, -NU, 1]) * 1e3 / E
    for method in (am.Multigrid(rtol=1e-11), am.FullMultigrid(rtol=1e-11), EXACT):
        result = am.solve(grids, method)
        expected = strain * back(meshes[-1].points)
        np.testing.assert_allclose(
            result.displacement @ turn, expected, atol=1e-9 * np.abs(expected).max()
        )
    area = meshes[-1].surface("lower.top").measures.sum()
    for name, sign in (("upper.bottom", -1), ("lower.top", 1), ("lower.bottom", -1)):
        np.testing.assert_allclose(
            result.resultant(name).force, sign * 1e3 * area * turn[:, -1], atol=1e-3 * area
        )
    for indicator in (am.Residual(), am.Recovery(), am.Goal(am.MeanDisplacement("upper.top", 0))):
        assert indicator.indicate(grids, result).relative < 1e-6


def test_a_chain_of_ties_follows_a_rigid_motion():
    """The corner of the arm follows that of the block, which follows the base."""
    parts = {
        "base": am.Rectangle(width=1, height=0.5),
        "block": am.Rectangle(width=1, height=0.5, origin=(0, 0.5)),
        "arm": am.Rectangle(width=1, height=0.5, origin=(1, 0.5)),
    }
    turn = 1e-3
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        material=PLANE,
        ties=(am.Tied("block.bottom", "base.top"), am.Tied("arm.left", "block.right")),
        supports=am.Support("base.bottom", x=0.02, y=lambda x: 0.01 + turn * x[:, 0]),
    )
    cells = {"base": (3, 2), "block": (4, 3), "arm": (2, 2)}
    grids = am.Hierarchy.uniform(
        problem, [cells, {k: (2 * a, 2 * b) for k, (a, b) in cells.items()}]
    )
    result = am.solve(grids, EXACT)
    x, y = result.mesh.points.T
    expected = np.column_stack([0.02 - turn * y, 0.01 + turn * x])
    np.testing.assert_allclose(result.displacement, expected, atol=1e-10)


def cantilever(**changes):
    """Two beams welded end to end."""
    parts = {
        "inner": am.Rectangle(width=1, height=0.5),
        "outer": am.Rectangle(width=1, height=0.5, origin=(1, 0)),
    }
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        material=PLANE,
        ties=am.Tied("outer.left", "inner.right"),
        loads=am.Traction("outer.right", (0.0, -1e3)),
        supports=am.Support("inner.left", x=0, y=0),
    )
    return replace(problem, **changes)


def test_a_tie_of_matching_meshes_is_one_body():
    grids = am.Hierarchy.uniform(
        cantilever(), [{"inner": (4, 2), "outer": (4, 2)}, {"inner": (8, 4), "outer": (8, 4)}]
    )
    far = am.Contact("bottom", am.GapFunction(lambda x: np.full(len(x), 1e3)))
    whole = am.Hierarchy.uniform(
        cantilever(
            domain=am.Rectangle(width=2, height=0.5),
            ties=(),
            contact=far,
            loads=(am.Traction("right", (0.0, -1e3)),),
            supports=(am.Support("left", x=0, y=0),),
        ),
        [(8, 2), (16, 4)],
    )
    tied, expected = am.solve(grids, EXACT), am.solve(whole, EXACT)
    points = tied.mesh.points
    np.testing.assert_allclose(tied.displacement, expected.probe(points), atol=1e-11)
    np.testing.assert_allclose(tied.resultant("outer.left").force, [0.0, 500.0], atol=1e-8)
    assert tied.resultant("outer.left", about=(1, 0.25)).moment == pytest.approx(500.0)
    assert tied.resultant("inner.left").force == pytest.approx([0.0, 500.0], abs=1e-6)
    assert am.solve(grids, am.Multigrid()).cycles <= am.solve(whole, am.Multigrid()).cycles + 3
    assert am.Residual().indicate(grids, tied).total == pytest.approx(
        am.Residual().indicate(whole, expected).total, rel=1e-2
    )


@pytest.mark.parametrize(
    ("reach", "apart", "far"), [(None, 0.3, True), (None, 1e-3, False), (0.5, 0.3, False)]
)
def test_ties_across_more_than_an_element_are_warned_of(reach, apart, far, recwarn):
    parts = {
        "inner": am.Rectangle(width=1, height=0.5),
        "outer": am.Rectangle(width=1, height=0.5, origin=(1 + apart, 0)),
    }
    moved = cantilever(
        domain=am.Assembly(parts=parts), ties=am.Tied("outer.left", "inner.right", reach=reach)
    )
    am.Hierarchy.uniform(moved, [2])
    assert ["0.3 m apart" in str(one.message) for one in recwarn] == [True] * far


def pressed():
    """Two tied blocks that are pressed and pushed on a third one, on which they slide in part."""
    parts = {
        "cap": am.Rectangle(width=1, height=0.5, origin=(0, 0.5)),
        "block": am.Rectangle(width=1, height=0.5),
        "base": am.Rectangle(width=2, height=0.5, origin=(-0.5, -0.5)),
    }
    return am.ContactProblem(
        domain=am.Assembly(parts=parts),
        material=PLANE,
        ties=am.Tied("cap.bottom", "block.top"),
        contact=am.ContactPair("block.bottom", "base.top", law=am.Coulomb(0.3)),
        supports=am.Support("base.bottom", x=0, y=0),
        loads=(am.Pressure("cap.top", 1e4), am.Traction("cap.right", (-3e3, 0.0))),
    )


def test_ties_and_contact_carry_a_load_together(tmp_path):
    grids = am.Hierarchy.uniform(
        pressed(), [{"cap": 3 * k, "block": 2 * k, "base": (5 * k, 2 * k)} for k in (1, 2, 4)]
    )
    exact = am.solve(grids, EXACT)
    assert {am.SLIP, am.STICK} <= set(exact.contact.state)
    for method in (am.Multigrid(), am.FullMultigrid(), am.Multigrid(correction=am.Monotone())):
        np.testing.assert_allclose(
            am.solve(grids, method).displacement,
            exact.displacement,
            atol=1e-6 * np.abs(exact.displacement).max(),
        )
    exact.save(tmp_path / "run.npz")
    path = am.solve_path(grids, am.LoadPath({"cap.right": [0, 1]}), EXACT)
    for result in (exact, am.Result.load(tmp_path / "run.npz"), path[1]):
        for name in ("cap.bottom", "block.bottom", "base.bottom"):
            assert result.resultant(name).force == pytest.approx([1500.0, 1e4], abs=1e-4)
        assert result.resultant("block.top").force == pytest.approx([-1500.0, -1e4], abs=1e-4)


def test_supports_and_contact_meet_ties():
    """What a support holds of a tied node it bears; a node of a tied and of a contact boundary is
    tied."""
    parts = {
        "cap": am.Rectangle(width=1, height=0.5, origin=(0, 0.5)),
        "block": am.Rectangle(width=1, height=0.5),
        "wall": am.Rectangle(width=0.5, height=1, origin=(1, 0)),
    }
    pairs = (am.ContactPair("cap.right", "wall.left"), am.ContactPair("block.right", "wall.left"))
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        material=PLANE,
        law=am.Coulomb(0.3),
        ties=am.Tied("cap.bottom", "block.top"),
        contact=pairs,
        loads=[am.Pressure("cap.top", 1e3)],
        supports=(
            am.Support("wall.right", x=0, y=0),
            am.Support("cap.left", x=1e-4),
            am.Support("block.bottom", y=0),
        ),
    )
    grids = am.Hierarchy.uniform(
        problem, [{"cap": 3 * k, "block": 2 * k, "wall": (2 * k, 5 * k)} for k in (1, 2)]
    )
    result = am.solve(grids, EXACT)
    force = {
        name: result.resultant(name).force
        for name in (
            "cap.left",
            "cap.bottom",
            "cap.right",
            "block.bottom",
            "block.top",
            "block.right",
        )
    }
    assert force["cap.left"] + force["cap.bottom"] + force["cap.right"] == pytest.approx(
        [0, 1e3], abs=1e-6
    )
    assert force["block.bottom"] + force["block.top"] + force["block.right"] == pytest.approx(
        [0, 0], abs=1e-6
    )
    np.testing.assert_allclose(
        am.solve(grids, am.Multigrid(rtol=1e-9)).displacement,
        result.displacement,
        atol=1e-6 * np.abs(result.displacement).max(),
    )
    assert not np.isin(result.contact.node, result.ties.on("cap.bottom")[0]).any()


@pytest.mark.parametrize("engine", [am.Remesh(), am.Bisect()], ids=["remesh", "bisect"])
def test_adaptive_loops_refine_tied_bodies(engine):
    steps = list(am.adapt(pressed(), start=0.3, engine=engine, max_nodes=600))
    errors = [step.estimate.relative for step in steps]
    assert len(errors) > 2 and all(b < a for a, b in pairwise(errors))
    assert steps[-1].result.resultant("cap.bottom").force == pytest.approx([1500.0, 1e4], rel=1e-4)


def test_a_pin_glued_into_its_hole_fills_it():
    """Curved surfaces of independent meshes: the stress of the plate without a hole."""
    pin, hole = (am.Circle((0, 0), 0.3, name) for name in ("rim", "hole"))
    plate = am.Cut(am.Rectangle(width=2, height=2, origin=(-1, -1)), hole)
    problem = am.ContactProblem(
        domain=am.Assembly(parts={"pin": pin, "plate": plate}),
        material=PLANE,
        ties=am.Tied("pin.rim", "plate.hole"),
        loads=am.Pressure("plate.right", -1e3),
        supports=(am.Symmetry("plate.left"), am.PointSupport((-1, -1), y=0)),
    )
    result = am.solve(am.Hierarchy.graded(problem, [0.4, 0.2]), am.Multigrid(rtol=1e-10))
    expected = 1e3 / E * (result.mesh.points + 1) * [1 - NU**2, -NU * (1 + NU)]
    np.testing.assert_allclose(result.displacement, expected, atol=1e-8 * np.abs(expected).max())


SHEAR = 1e-3


def cell(dim, **changes):
    """A periodic cell under the mean shear strain SHEAR in its first plane, with no name of a
    load."""
    sides = (("left", "right"), *([("front", "back")] * (dim == 3)), ("bottom", "top"))
    strain = np.zeros((dim, dim))
    strain[0, 1] = strain[1, 0] = SHEAR
    arguments = {
        "material": (am.Solid if dim == 3 else am.PlaneStrain)(young=E, poisson=NU),
        "ties": [am.Periodic(*pair, jump=jump) for pair, jump in zip(sides, strain, strict=True)],
        "domain": am.Box(width=1, depth=1, height=1)
        if dim == 3
        else am.Rectangle(width=1, height=1),
        "supports": am.PointSupport([0] * dim, **dict.fromkeys("xyz"[:dim], 0.0)),
    }
    return am.ContactProblem(**arguments | changes), strain


@pytest.mark.parametrize("dim", [2, 3])
def test_a_periodic_cell_is_sheared_uniformly(dim):
    problem, strain = cell(dim)
    grids = am.Hierarchy.uniform(problem, (2, 4))
    for method in (am.Multigrid(rtol=1e-11), am.FullMultigrid(rtol=1e-11), EXACT):
        result = am.solve(grids, method)
        np.testing.assert_allclose(
            result.displacement, result.mesh.points @ strain, atol=1e-10 * SHEAR
        )
    stress = E / (1 + NU) * SHEAR
    np.testing.assert_allclose(
        result.resultant("right").force, stress * np.eye(dim)[1], atol=1e-6 * stress
    )
    assert am.Residual().indicate(grids, result).relative < 1e-9
    path = am.solve_path(
        grids, am.LoadPath({"right": [0.5, -1], "back" if dim == 3 else "top": [0.5, -1]}), EXACT
    )
    np.testing.assert_allclose(path[1].displacement, -result.displacement, atol=1e-10 * SHEAR)


@pytest.mark.parametrize("corner", [(1, 0), (0, 1), (1, 1)])
def test_a_support_of_a_node_that_follows_its_partner_is_refused(corner):
    """It would hold the jump; with the partner it holds both (the shear was .84 to 1.04 of it)."""
    at_corner = am.PointSupport(corner, x=0, y=0)
    problem, _ = cell(2, supports=at_corner)
    with pytest.raises(ValueError, match=r"not its partner, .* hold the partner at \("):
        am.Hierarchy.uniform(problem, (2, 4))


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_plane_support_of_one_periodic_side_is_refused_at_any_angle(angle):
    mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    middles = mesh.points[mesh.facets].mean(axis=1)
    at_slave = (middles[:, 0] > 0.5) & (middles[:, 1] == 0)
    part = replace(
        mesh,
        points=mesh.points @ rotation(angle).T,
        boundaries=(*mesh.boundaries, "foot"),
        facet_labels=np.where(at_slave, len(mesh.boundaries), mesh.facet_labels),
    )
    problem = am.ContactProblem(
        material=PLANE,
        ties=am.Periodic("left", "right"),
        supports=[am.Support("foot", normal=0.0), am.Support("top", x=0.0, y=0.0)],
    )
    with pytest.raises(ValueError, match="not its partner"):
        am.discretise(problem, part)


@pytest.mark.parametrize("shift", [(0, 2), (2, 1)])
def test_a_cell_does_not_depend_on_where_it_begins(shift):
    """A stiff inclusion anywhere in the cell: the same mean stress, whose work is the energy (Hill
    and Mandel)."""

    def with_inclusion(shift):
        mesh = am.mesh.structured(am.Rectangle(width=1, height=1), 8)
        centre = np.abs(mesh.points[mesh.elements].mean(axis=1) - 0.5 - np.array(shift) / 8)
        inside = (centre < 0.25).all(axis=1).astype(np.int32)
        two = replace(mesh, bodies=("soft", "stiff"), element_body=inside)
        problem, _ = cell(
            2, material={"soft": PLANE, "stiff": replace(PLANE, young=10 * E)}, domain=None
        )
        return am.solve(am.Hierarchy.from_meshes(problem, [two]), EXACT)

    one, other = with_inclusion((0, 0)), with_inclusion(shift)
    for side in ("right", "top"):
        force = one.resultant(side).force
        np.testing.assert_allclose(
            other.resultant(side).force, force, atol=1e-10 * np.abs(force).max()
        )
    assert 2 * one.energy == pytest.approx(2 * SHEAR * one.resultant("right").force[1])


@pytest.mark.parametrize("facing", ["obstacle", "mortar", "nodes"])
@pytest.mark.parametrize("dim", [2, 3])
def test_contact_does_not_depend_on_where_a_cell_begins(dim, facing):
    """A wavy gap that is closed with friction: its crest inside the cell, at a side and at an edge."""
    n = 8 if dim == 2 else 4
    names = "xyz"[:dim]

    def pressed(crest):
        def gap(points):
            return 1e-3 * (1 - np.cos(2 * np.pi * (points[:, : dim - 1] - crest)).mean(axis=1)) / 2

        motion = (2e-4, 1e-4, -6e-4)[3 - dim :]
        clamped = dict.fromkeys(names, 0.0)
        if facing == "obstacle":
            moved = am.Moving(am.GapFunction(gap), displacement=tuple(-x for x in motion))
            parts, contact = slabs(dim, up=0.0), am.Contact("up.bottom", moved)
            supports = [am.Support("up.top", **clamped)]
        else:
            parts = slabs(dim, low=-0.5, up=0.0)
            contact = am.ContactPair("up.bottom", "low.top", gap=gap, coupling=facing)
            supports = [
                am.Support("low.bottom", **clamped),
                am.Support("up.top", **dict(zip(names, motion, strict=True))),
            ]
        sides = (("left", "right"), ("front", "back"))[: dim - 1]
        problem = am.ContactProblem(
            domain=am.Assembly(parts=parts),
            material=(am.Solid if dim == 3 else am.PlaneStrain)(young=E, poisson=NU),
            contact=contact,
            law=am.Coulomb(0.2),
            ties=[am.Periodic(f"{name}.{a}", f"{name}.{b}") for name in parts for a, b in sides],
            supports=supports,
        )
        # with mortar functions a side needs no partners
        divisions = {"low": n // 2 if facing == "mortar" else n, "up": n}
        grids = am.Hierarchy.uniform(
            problem, [{name: (divisions[name],) * (dim - 1) + (2,) for name in parts}]
        )
        return am.solve(grids, am.ActiveSet(rtol=1e-10))

    inside = pressed(0.5)
    assert 0 < inside.contact_area < 1
    for crest in (0.0, np.array([0.0, 0.5])[: dim - 1]):
        other = pressed(crest)
        for name in ("energy", "max_pressure", "contact_area", "dissipation"):
            assert getattr(other, name) == pytest.approx(getattr(inside, name), rel=1e-6, abs=1e-9)
        for name in ("up.top", "contact"):
            expected = inside.resultant(name).force
            np.testing.assert_allclose(
                other.resultant(name).force, expected, atol=1e-6 * np.abs(expected).max()
            )
        assert not other.certificate().contradictions(1e-8)


@pytest.mark.parametrize("dim", [2, 3])
def test_a_tie_of_unlike_meshes_does_not_depend_on_where_a_cell_begins(dim):
    """With the coarser side as slave, and a mean strain."""

    def solved(crest):
        parts = slabs(dim, low=0.0, up=0.5)
        sides = (("left", "right"), ("front", "back"))[: dim - 1]
        problem = am.ContactProblem(
            domain=am.Assembly(parts=parts),
            material=(am.Solid if dim == 3 else am.PlaneStrain)(young=E, poisson=NU),
            ties=[
                *(
                    am.Periodic(f"{name}.{a}", f"{name}.{b}", jump=np.eye(dim)[k] * 1e-4)
                    for name in parts
                    for k, (a, b) in enumerate(sides)
                ),
                am.Tied("up.bottom", "low.top"),
            ],
            loads=[
                am.Traction(
                    "up.top",
                    (lambda x: 1e4 * np.cos(2 * np.pi * (x[:, 0] - crest)),) + (0,) * (dim - 1),
                ),
                am.Pressure("up.top", lambda x: 1e4 * np.sin(2 * np.pi * (x[:, 0] - crest))),
            ],
            supports=[
                am.Support("low.bottom", **{"xyz"[dim - 1]: 0.0}),
                am.PointSupport([0] * dim, **dict.fromkeys("xyz"[: dim - 1], 0.0)),
            ],
        )
        divisions = {"low": (8,) * (dim - 1) + (2,), "up": (4,) * (dim - 1) + (2,)}
        return am.solve(am.Hierarchy.uniform(problem, [divisions]), am.ActiveSet(rtol=1e-10))

    moved = solved(0.25)
    assert moved.energy == pytest.approx(solved(0.0).energy, rel=1e-8)
    assert not moved.certificate().contradictions(1e-8)


test_refused = refused(
    (
        lambda: cell(2, ties=am.Periodic("left", "right", jump=(1, 2, 3))),
        "jump must have 2 components, got 3",
    ),
    (
        lambda: am.Hierarchy.from_meshes(
            cell(2, ties=am.Periodic("left", "top"))[0],
            [am.mesh.structured(am.Rectangle(width=1, height=1), (2, 3))],
        ),
        "sides 'left' and 'top' do not match: 4 and 3 nodes",
    ),
    (lambda: am.Tied("a", "a"), "slave and master are both 'a'"),
    (lambda: am.Tied("a", "b", reach=0.0), "reach must be"),
    (lambda: am.Hierarchy.uniform(cantilever(ties=()), [2]), "nothing holds body"),
    (
        lambda: cantilever(
            ties=(am.Tied("outer.left", "inner.right"), am.Tied("inner.right", "outer.right"))
        ),
        "'inner.right' is the master of 'outer.left' and slave of another pair",
    ),
    (
        lambda: cantilever(
            contact=am.ContactPair("outer.left", "inner.top", law=am.Frictionless())
        ),
        "'outer.left' is named twice",
    ),
    (
        lambda: am.Hierarchy.uniform(cantilever(ties=am.Tied("outer.lft", "inner.right")), [2]),
        r"'outer.lft', used for a tie, does not exist \(did you mean 'outer.left'\?\)",
    ),
    (
        lambda: am.Hierarchy.uniform(cantilever(ties=am.Tied("outer.right", "inner.right")), [2]),
        "tie 'outer.right' on 'inner.right': the surfaces never face",
    ),
    (
        lambda: am.ContactProblem(material=PLANE, contact=am.ContactPair("a", "b")),
        TypeError,
        "law must be",
    ),
    (lambda: am.solve(am.Hierarchy.uniform(cantilever(supports=()), [2])), "nothing holds"),
)


def test_contact_ratio_refines_at_ties_where_there_is_no_contact():
    halves = {
        "a": am.Rectangle(width=1, height=1),
        "b": am.Rectangle(width=1, height=1, origin=(0, -1)),
    }
    problem = am.ContactProblem(
        domain=am.Assembly(parts=halves),
        material=dict.fromkeys(halves, am.PlaneStrain(young=E, poisson=NU)),
        ties=am.Tied("a.bottom", "b.top"),
        supports=am.Support("b.bottom", x=0, y=0),
    )
    mesh = am.Hierarchy.graded(problem, (0.5, 0.25), contact_ratio=4).finest.mesh
    sides = mesh.points[mesh.surface("a.bottom").facets]
    lengths = np.linalg.norm(sides[:, 1] - sides[:, 0], axis=1)
    np.testing.assert_allclose(lengths, 0.25 / 4, rtol=0.3)


@pytest.mark.parametrize("divisions", [(4, 2), (3, 4), (5, 3)])
@pytest.mark.parametrize("upper_is_slave", [True, False])
def test_a_tie_that_ends_at_clamped_nodes_balances_both_bodies(divisions, upper_is_slave):
    """Two glued layers, both clamped on the left and pulled down on the right."""
    heights = {"lower": 0.8, "upper": 0.4}
    parts = {
        "lower": am.Rectangle(width=3, height=0.8),
        "upper": am.Rectangle(width=3, height=0.4, origin=(0, 0.8)),
    }
    sides = ("upper.bottom", "lower.top")
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts),
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        ties=am.Tied(*(sides if upper_is_slave else sides[::-1])),
        loads=[am.Traction(f"{body}.right", (0, -1e5)) for body in parts],
        supports=[am.Support(f"{body}.left", x=0, y=0) for body in parts],
    )
    cells = {body: (6 * n, n) for body, n in zip(parts, divisions, strict=True)}
    result = am.solve(am.Hierarchy.uniform(problem, [cells]), EXACT)
    for body, side in (("upper", "upper.bottom"), ("lower", "lower.top")):
        total = result.resultant(f"{body}.left").force + result.resultant(side).force
        np.testing.assert_allclose(total, (0, 1e5 * heights[body]), atol=1e-5)
    assert not result.certificate().contradictions(1e-8)


@pytest.mark.parametrize("body", ["upper", "lower"])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_tie_that_ends_at_clamped_nodes_turns_with_the_bodies(dim, body):
    """Clamped by components, or by the normal of a plane and the other components."""
    problem, meshes, *_ = stacked(dim, 0)
    shift = 1e-4 * np.ptp(meshes[-1].points) * np.array([1.0, 2.0, -1.0])[:dim]
    normal = meshes[-1].surface(f"{body}.left").normals[0]
    other = "lower.bottom" if body == "upper" else "upper.top"
    components = dict(zip("xyz", shift, strict=False))
    rest = {name: value for name, value in components.items() if name != "x"}
    solutions = [
        am.solve(am.Hierarchy.from_meshes(replace(problem, supports=supports), meshes), EXACT)
        for supports in (
            [am.Support(f"{body}.left", **components), am.Symmetry(other)],
            [am.Support(f"{body}.left", normal=normal @ shift, **rest), am.Symmetry(other)],
        )
    ]
    found, expected = (solution.displacement for solution in solutions)
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())


def test_a_boundary_that_is_tied_and_in_contact_bears_both():
    """Of two blocks on a third one is glued; the pressures on both go down."""
    blocks = {
        name: am.Rectangle(width=width, height=1.0, origin=origin)
        for name, width, origin in (
            ("base", 2.0, (0.0, -1.0)),
            ("glued", 1.0, (0.0, 0.0)),
            ("loose", 1.0, (1.0, 0.0)),
        )
    }
    problem = am.ContactProblem(
        domain=am.Assembly(parts=blocks),
        material=am.PlaneStrain(young=1e9, poisson=0.0),
        law=am.Coulomb(0.3),
        ties=am.Tied("glued.bottom", "base.top"),
        contact=am.ContactPair("loose.bottom", "base.top"),
        loads=[am.Pressure("glued.top", 1e6), am.Pressure("loose.top", 2e6)],
        supports=am.Support("base.bottom", x=0.0, y=0.0),
    )
    grids = am.Hierarchy.uniform(problem, [{"base": (4, 2), "glued": 3, "loose": 3}])
    result = am.solve(grids, am.ActiveSet(rtol=1e-11)).resultant("base.top", about=(0.0, 0.0))
    np.testing.assert_allclose(result.force, [0.0, -3e6], atol=1e-2)
    assert result.moment == pytest.approx(-0.5 * 1e6 - 1.5 * 2e6)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("shift", [0.0, -4e-4])
def test_a_tie_between_a_plane_support_and_contact_bears_what_one_body_bears(shift, turned):
    """Contact nodes in the plane take over parts of tied nodes that are free along its normal."""
    turn = random_turn(np.random.default_rng(1)) if turned else np.eye(3)
    box = am.Box(width=1, depth=1, height=1)
    parts = am.Assembly(parts={"a": box, "b": replace(box, origin=(1, 0, 0))})
    whole = am.Box(width=2, depth=1, height=1)
    forces = []
    for domain, names, cells in (
        (parts, ("a.", "b."), [{"a": n, "b": n} for n in (1, 3)]),
        (whole, ("",), [(2 * n, n, n) for n in (1, 3)]),
    ):
        plane = am.Plane((0, 0, 0), turn[:, 2])
        problem = am.ContactProblem(
            material=am.Solid(young=1e7, poisson=0.3),
            law=am.Coulomb(0.3),
            contact=[am.Contact(f"{name}bottom", plane) for name in names],
            ties=[am.Tied("a.right", "b.left")] if len(names) > 1 else [],
            supports=[
                am.Symmetry(f"{names[0]}left"),
                *[am.Support(f"{name}front", normal=shift) for name in names],
                *[am.Support(f"{name}top", normal=-2e-3) for name in names],
            ],
        )
        straight = [am.mesh.structured(domain, n) for n in cells]
        meshes = [replace(mesh, points=mesh.points @ turn.T) for mesh in straight]
        result = am.solve(am.Hierarchy.from_meshes(problem, meshes))
        assert not result.certificate().contradictions(1e-8)
        forces.append(result.resultant("contact").force)
    np.testing.assert_allclose(*forces, atol=0.005 * np.linalg.norm(forces[1]))
