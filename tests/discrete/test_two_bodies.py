"""Bodies in contact: exact states on any meshes, hierarchies, conditions and balance, interference
fits."""

from dataclasses import replace

import bodies
import numpy as np
import pytest
from bodies import DIMS, EXACT, LOWER_ON_UPPER, MATERIALS, PAIRS, UPPER_ON_LOWER, P
from saddle import Parts

import adaptmg as am


@DIMS
@pytest.mark.parametrize(
    "pairs",
    [
        (a, b)
        for a in (("upper.bottom", "middle.top"), ("middle.top", "upper.bottom"))
        for b in (("middle.bottom", "lower.top"), ("lower.top", "middle.bottom"))
    ],
)
def test_three_blocks_pass_the_patch_test(dim, pairs):
    mesh = bodies.stacked(
        [(4, 2), (7, 3), (3, 2)] if dim == 2 else [(3, 1, 1), (2, 2, 1), (1, 3, 2)]
    )
    materials = (*MATERIALS[dim][::-1], MATERIALS[dim][1])
    result = am.solve(am.Hierarchy.from_meshes(bodies.pressed(mesh, pairs, materials), mesh), EXACT)
    bodies.assert_state(result, bodies.uniaxial(mesh, materials))
    assert set(result.contact.pair) == {" on ".join(pair) for pair in pairs}
    for slave, master in pairs:
        force = P if slave.endswith("bottom") else -P
        assert result.resultant(slave).force == pytest.approx(
            [*[0] * (dim - 1), force], rel=1e-9, abs=1e-11 * P
        )
        moment = -force / 2 if dim == 2 else [-force / 2, force / 2, 0]
        assert result.resultant(master).moment == pytest.approx(moment, rel=1e-9, abs=1e-9 * P)


@PAIRS
@pytest.mark.parametrize("inner", [0.0, 0.3], ids=["disks", "rings"])
def test_disks_and_rings_pass_the_patch_test(inner, pair):
    materials = [am.Axisymmetric(**vars(m)) for m in MATERIALS[2]]
    flat = bodies.stacked([(4, 2), (7, 3)])
    mesh = replace(flat, points=flat.points + np.array([inner, 0.0]))
    problem = bodies.pressed(mesh, [pair], materials)
    held = problem.supports if inner == 0 else problem.supports[:1]
    result = am.solve(am.Hierarchy.from_meshes(replace(problem, supports=held), [mesh]), EXACT)
    bodies.assert_state(result, bodies.uniaxial(mesh, materials))
    force = np.pi * ((1 + inner) ** 2 - inner**2) * P
    assert result.resultant("lower.top").force[1] == pytest.approx(-force, rel=1e-11)


@pytest.mark.parametrize(
    "order", [("floor", "wall", "cap"), ("wall", "floor", "cap"), ("cap", "wall", "floor")]
)
def test_bodies_in_a_row(order):
    mesh, problem, exact = bodies.in_the_corner(order, am.Coulomb(0.3))
    a, b = bodies.far_node(mesh, "seat", (-1, -1)), bodies.far_node(mesh, "seat", (1, -1))
    discrete = bodies.held_at_points(problem, mesh, exact, [(a, 0), (a, 1), (b, 1)])
    weights, contact = discrete.coupling.weights, discrete.contact
    # the corner of the block belongs to the pair named first; in the other it is a plain node
    corner = np.flatnonzero(
        (mesh.points == 0).all(axis=1)
        & (np.arange(mesh.n_nodes) >= np.min(mesh.elements[mesh.element_body == 1]))
    )[0]
    at = np.flatnonzero(contact.nodes == corner)
    first, second = (name for name in order if name != "cap")
    assert len(at) == 1 and contact.boundary[at[0]] == order.index(first)
    np.testing.assert_allclose(
        contact.normals[at[0]], (0, -1) if first == "floor" else (-1, 0), atol=1e-15
    )
    assert weights[contact.nodes[contact.boundary == order.index(second)]][:, corner].nnz == 1
    # a node of the cap follows the corner of the block, which follows the wall
    assert (weights @ weights).nnz
    result = am.solve(am.Hierarchy((am.Level(discrete, mesh),)), EXACT)
    bodies.assert_state(result, exact)
    for slave, master, force in (
        ("block.bottom", "seat.floor", (0, P)),
        ("block.left", "seat.wall", (P, 0)),
        ("cap.bottom", "block.top", (0, P)),
    ):
        assert result.resultant(slave).force == pytest.approx(force, rel=1e-9, abs=1e-9 * P)
        assert result.resultant(master).force == pytest.approx(
            -np.array(force), rel=1e-9, abs=1e-9 * P
        )
    np.testing.assert_allclose(result.resultant("contact").force, [P, 2 * P], rtol=1e-9)


def test_bisected_given_and_algebraic_levels_and_one_level():
    """The same solution of all, and less to ask where there is no mesh."""
    problem = bodies.bar_on_block(am.Coulomb(0.5))
    meshes = [am.mesh.structured(problem.domain, {"upper": k, "lower": k + 1}) for k in (3, 6)]
    given = am.Hierarchy.from_meshes(replace(problem, domain=None), meshes, transfer=am.L2())
    coarsest = am.mesh.structured(problem.domain, {"upper": 3, "lower": (5, 4)})
    bisected = am.Hierarchy.from_meshes(
        problem, am.mesh.refine_near(coarsest, problem.pair_boundaries, 3)
    )
    algebraic = am.Hierarchy.algebraic(given.finest.discrete, max_coarse=60)
    for grids, solver in (
        (bisected, am.FullMultigrid()),
        (bisected, am.Multigrid()),
        (given, am.FullMultigrid()),
        (given, am.Multigrid()),
        (algebraic, am.Multigrid()),
    ):
        result = am.solve(grids, solver, reference=am.solve(grids, EXACT))
        assert result.history["true_error"][-1] <= 3e-8 and result.cycles <= 40
    result = am.solve(given, EXACT)
    single = am.solve(given.finest.discrete, am.SingleGrid(condensed=True, rtol=1e-11))
    np.testing.assert_allclose(
        single.displacement, result.displacement, atol=1e-8 * np.abs(result.displacement).max()
    )
    for name in UPPER_ON_LOWER:
        assert single.resultant(name).force == pytest.approx(result.resultant(name).force)
    with pytest.raises(ValueError, match=r"'lower.bottom' is not known"):
        single.resultant("lower.bottom")


def test_forces_balance_where_supports_drag_a_body():
    """At the corner both are held, and friction there passes from one support to the other."""
    problem = bodies.bar_on_block(am.Coulomb(0.5))
    moved = replace(problem, supports=(am.Support("upper.right", x=2e-4), *problem.supports[1:]))
    result = am.solve(am.Hierarchy.uniform(moved, [{"upper": 4, "lower": (5, 4)}]), EXACT)
    corner = np.argmax(result.contact.x[:, 0])
    upper, lower = (result.resultant(name).force for name in ("upper.bottom", "lower.top"))
    assert np.abs(result.contact.force_t[corner]) > 1e-3 * np.abs(upper[0])
    np.testing.assert_allclose(upper, -lower, rtol=1e-10)


def block_on_slab(law, pair=UPPER_ON_LOWER, **options):
    """A block pressed and pushed both ways along a wider slab, stiffer than it."""
    return am.ContactProblem(
        material=dict(zip(("lower", "upper"), MATERIALS[3], strict=True)),
        law=law,
        domain=am.Assembly(
            parts={
                "upper": am.Box(width=1.0, depth=1.0, height=1.0),
                "lower": am.Box(width=1.5, depth=1.25, height=0.5, origin=(0.0, 0.0, -0.5)),
            }
        ),
        contact=am.ContactPair(*pair, **options),
        loads=(
            am.Pressure("upper.top", P),
            am.Pressure("upper.right", 2.4 * P),
            am.Traction("upper.top", (0.0, 0.2 * P, 0.0)),
        ),
        supports=(
            am.Support("upper.left", x=0.0),
            am.Support("upper.front", y=0.0),
            am.Support("lower.left", x=0.0),
            am.Support("lower.front", y=0.0),
            am.Support("lower.bottom", z=0.0),
        ),
    )


def wavy(points):
    return 1e-5 * (2 + np.sin(9 * points[:, 0]) + np.cos(7 * points[:, 1]))


def nested(problem):
    return am.Hierarchy.uniform(
        problem, [{"upper": 2 * k, "lower": (3 * k, 2 * k, k)} for k in (1, 2)]
    )


#: that all methods agree between bodies: tests/agreement
PROBLEMS = {
    "corner": lambda law: am.Hierarchy.graded(
        bodies.corner_pushed(law), sizes=(0.5, 0.3, 0.17), contact_ratio=1.5
    ),
    "wavy 3D": lambda law: nested(block_on_slab(law, LOWER_ON_UPPER, gap=wavy)),
    "node to node 3D": lambda law: am.Hierarchy.uniform(
        block_on_slab(law, coupling="nodes"),
        [{"upper": (2 * k, 4 * k, k), "lower": (3 * k, 5 * k, k)} for k in (1, 2)],
    ),
}


@pytest.mark.parametrize("make", PROBLEMS)
def test_solvers_agree_and_forces_balance(make):
    bodies.assert_agrees(
        PROBLEMS[make](am.Coulomb(0.3)),
        {
            "nested start": am.FullMultigrid(rtol=1e-11),
            "cold": am.Multigrid(rtol=1e-11),
            "active set": EXACT,
        },
    )


@DIMS
def test_forces_balance_however_loose_the_solver(dim):
    grids = (
        bodies.bar_hierarchy(bodies.bar_on_block(am.Coulomb(0.5), LOWER_ON_UPPER))
        if dim == 2
        else nested(block_on_slab(am.Coulomb(0.3), LOWER_ON_UPPER, gap=wavy))
    )
    result = am.solve(grids, am.FullMultigrid(rtol=1e-2))
    assert result.residual > 1e-6
    on_slave, on_master = (result.resultant(name) for name in LOWER_ON_UPPER)
    size = np.abs(on_slave.force).max()
    assert size > 1e6 and np.abs(on_slave.force + on_master.force).max() <= 1e-13 * size
    assert np.abs(on_slave.moment + on_master.moment).max() <= 1e-13 * size
    bodies.assert_balanced(result, Parts.of(grids.problem, grids.finest.mesh), 1.0)
    total = am.solve(grids, EXACT).resultant("lower.bottom").force[-1]
    assert total == pytest.approx(P * (40e-3 if dim == 2 else 1.0), rel=1e-9)


@DIMS
@PAIRS
def test_an_interference_fit(dim, pair):
    # two blocks between rigid walls, too long together: uniaxial strain, compliance
    # (1+nu)(1-2nu)/(E(1-nu))
    overlap, heights = (2e-4 if dim == 2 else 1e-4), {"lower": 0.6, "upper": 0.4}
    shape, depth = (am.Rectangle, {}) if dim == 2 else (am.Box, {"depth": 1.0})
    parts = {
        body: shape(width=1.0, height=height, **depth, origin=(*[0.0] * (dim - 1), base))
        for (body, height), base in zip(heights.items(), (0.0, 0.6 - overlap), strict=True)
    }
    walls, up = {"left": "x", "right": "x", "front": "y", "back": "y"}, "xyz"[dim - 1]
    supports = (
        am.Support("lower.bottom", **{up: 0.0}),
        am.Support("upper.top", **{up: 0.0}),
        *(
            am.Support(f"{body}.{wall}", **{walls[wall]: 0.0})
            for body in parts
            for wall in list(walls)[: 2 * dim - 2]
        ),
    )
    materials = dict(zip(heights, MATERIALS[dim], strict=True))
    problem = am.ContactProblem(
        material=materials,
        domain=am.Assembly(parts=parts),
        supports=supports,
        law=am.Coulomb(0.3),
        contact=am.ContactPair(*pair, allow_interference=True),
    )
    grids = am.Hierarchy.uniform(
        problem,
        [{"lower": (k, k), "upper": (5 * k // 4, k)} for k in (4, 8)]
        if dim == 2
        else [{"lower": (2 * k, k, k), "upper": (k, 3 * k, k)} for k in (1, 2)],
    )
    compliance = {
        name: (1 + m.poisson) * (1 - 2 * m.poisson) / (m.young * (1 - m.poisson))
        for name, m in materials.items()
    }
    pressure = overlap / sum(heights[name] * compliance[name] for name in heights)
    for solver in (
        EXACT,
        am.FullMultigrid(rtol=1e-10),
        am.Multigrid(correction=am.Monotone(), rtol=1e-10),
        am.SingleGrid(condensed=True, rtol=1e-12),
    ):
        result = am.solve(grids, solver)
        np.testing.assert_allclose(result.contact.pressure, pressure, rtol=1e-7)
        assert np.abs(result.contact.gap).max() <= 1e-8 * overlap
        top = grids.finest.mesh.boundary_nodes("lower.top")
        np.testing.assert_allclose(
            result.displacement[top, -1], -pressure * 0.6 * compliance["lower"], rtol=1e-7
        )
    # from a start that gapes, and from the solution
    for start, cycles in ((3 * result.displacement, 30), (result, 1)):
        again = am.solve(grids, am.Multigrid(rtol=1e-10), start=start)
        np.testing.assert_allclose(again.contact.pressure, pressure, rtol=1e-7)
        assert again.cycles <= cycles
    deep = rf"{pair[0]}.*{pair[1]}.*overlap by up to {overlap:.4f} m.*allow_interference"
    with pytest.raises(ValueError, match=deep):
        am.discretise(replace(problem, contact=am.ContactPair(*pair)), grids.finest.mesh)


@DIMS
def test_a_given_gap_closes_everywhere_at_once(dim):
    """The slave is wider than the master: rows that take other slave nodes along move more than the
    master."""
    gap, make = 1e-3, bodies.bar_on_block if dim == 2 else block_on_slab
    problem = make(am.Frictionless(), LOWER_ON_UPPER, gap=gap)
    mesh = am.mesh.structured(
        problem.domain, {"upper": 8, "lower": 11} if dim == 2 else {"upper": 5, "lower": 8}
    )
    discrete, upper = am.discretise(problem, mesh), np.unique(mesh.elements[mesh.element_body == 0])
    moved = np.zeros(mesh.points.shape)
    moved[upper, dim - 1] = -gap
    relative = discrete.at_contact(discrete.relative(moved).reshape(-1))
    closes = np.einsum("nd,nd->n", relative, discrete.contact.normals)
    assert mesh.bodies[0] == "upper" and closes.max() > 1.01 * gap
    np.testing.assert_allclose(discrete.contact.gaps, closes, rtol=1e-9)
