"""Bodies in contact in 2D: exact states, an independent solver, balance of forces, limits, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from saddle import Parts, solve_saddle

import adaptmg as am
from adaptmg.discretisation.discretise import discretise
from adaptmg.discretisation.rigid_motions import rigid_motions
from adaptmg.mesh import graded, merged, structured
from adaptmg.mesh.arrays import MeshArrays

EXACT = am.ActiveSet(rtol=1e-12)
SOFT, STIFF = am.PlaneStrain(young=7e10, poisson=0.34), am.PlaneStrain(young=2.1e11, poisson=0.28)
P = 5e7


def strains(material, pressure=P):
    """(lateral, axial) strain under a uniaxial pressure in plane strain."""
    E, nu = material.young, material.poisson
    return nu * (1 + nu) / E * pressure, -(1 - nu**2) / E * pressure


def turned(mesh, angle):
    """A mesh turned about the origin."""
    c, s = np.cos(angle), np.sin(angle)
    return MeshArrays(mesh.points @ np.array([[c, s], [-s, c]]), mesh.elements, mesh.facets, mesh.facet_labels,
                      mesh.boundaries, element_body=mesh.element_body, bodies=mesh.bodies)


def held_at_points(problem, mesh, exact, points, load=0.0):
    """The discrete problem with prescribed values of ``exact`` (n_nodes, dim) at some (node, component)."""
    parts = Parts.of(problem, mesh)
    fixed, values = np.zeros(mesh.points.shape, dtype=bool), np.zeros(mesh.points.shape)
    for node, component in points:
        fixed[node, component] = True
        values[node, component] = exact[node, component]
    return am.DiscreteProblem.coupled(
        matrix=parts.matrix, load=parts.load + np.ravel(load), fixed=fixed.ravel(), fixed_values=values.ravel(),
        law=parts.law, contact=parts.contact, weights=parts.weights, coordinates=mesh.points,
        near_nullspace=rigid_motions(mesh))


def far_node(mesh, body, direction):
    """The node of a body farthest in a direction."""
    nodes = np.unique(mesh.elements[mesh.element_body == mesh.bodies.index(body)])
    return nodes[np.argmax(mesh.points[nodes] @ np.asarray(direction))]


def assert_state(result, exact, pressure=P):
    np.testing.assert_allclose(result.displacement, exact, atol=1e-10 * np.abs(exact).max())
    np.testing.assert_allclose(result.contact.pressure, pressure, rtol=1e-9)
    assert np.abs(result.contact.traction).max() < 1e-9 * pressure


def stacked(divisions, width=1.0):
    """A mesh of blocks "lower", "middle" (with three divisions), "upper", all 1 wide but the last."""
    names = ("lower", "upper") if len(divisions) == 2 else ("lower", "middle", "upper")
    parts = {name: am.Rectangle(width=width if name == "upper" else 1.0, height=0.6, origin=(0.0, 0.6 * k))
             for k, name in enumerate(names)}
    return merged({name: structured(parts[name], n) for name, n in zip(names, divisions, strict=True)})


def uniaxial(mesh, materials):
    """Exact displacement of a stack under the pressure P, zero at the origin."""
    exact, base = np.zeros(mesh.points.shape), 0.0
    for k, material in enumerate(materials):
        nodes = np.unique(mesh.elements[mesh.element_body == k])
        lateral, axial = strains(material)
        x = mesh.points[nodes]
        exact[nodes] = np.column_stack([lateral * x[:, 0], base + axial * (x[:, 1] - 0.6 * k)])
        base += 0.6 * axial
    return exact


def pressed(mesh, pairs, materials, law=None):
    """A stack under the pressure P with rollers below and at the left."""
    return am.ContactProblem(
        material=dict(zip(mesh.bodies, materials, strict=True)), contact=tuple(am.ContactPair(*p) for p in pairs),
        law=am.Frictionless() if law is None else law, loads=(am.Pressure("upper.top", P),),
        supports=(am.Support("lower.bottom", y=0.0), *(am.Support(f"{body}.left", x=0.0) for body in mesh.bodies)))


UPPER_ON_LOWER, LOWER_ON_UPPER = ("upper.bottom", "lower.top"), ("lower.top", "upper.bottom")


class TestPatch:
    @pytest.mark.parametrize("pair", [UPPER_ON_LOWER, LOWER_ON_UPPER], ids=["upper", "lower"])
    @pytest.mark.parametrize("solver", [EXACT, am.FullMultigrid(rtol=1e-12)], ids=["active set", "multigrid"])
    def test_flat(self, pair, solver):
        meshes = [stacked([(3 * k, 2 * k), (4 * k, 3 * k)]) for k in (1, 2)]
        grids = am.Hierarchy.from_meshes(pressed(meshes[0], [pair], (STIFF, SOFT)), meshes)
        result = am.solve(grids, solver)
        assert_state(result, uniaxial(meshes[-1], (STIFF, SOFT)))
        assert result.resultant(pair[0]).force[1] == pytest.approx(P if pair[0] == "upper.bottom" else -P, rel=1e-12)

    @pytest.mark.parametrize("pairs", [
        (UPPER_ON_MIDDLE, MIDDLE_ON_LOWER) for UPPER_ON_MIDDLE in (("upper.bottom", "middle.top"),
                                                                   ("middle.top", "upper.bottom"))
        for MIDDLE_ON_LOWER in (("middle.bottom", "lower.top"), ("lower.top", "middle.bottom"))])
    def test_three_blocks(self, pairs):
        mesh, materials = stacked([(4, 2), (7, 3), (3, 2)]), (SOFT, STIFF, SOFT)
        problem = pressed(mesh, pairs, materials)
        assert_state(am.solve(discretise(problem, mesh), EXACT), uniaxial(mesh, materials))

    @pytest.mark.parametrize("pair", [UPPER_ON_LOWER, LOWER_ON_UPPER], ids=["upper", "lower"])
    @pytest.mark.parametrize("covered", [0.02, 0.24, 0.6, 1.0])
    def test_overhanging(self, covered, pair):
        # the last edge that touches at all is covered by this fraction
        n = 5
        mesh = stacked([(7, 3), (n, 4)], width=n / (3 + covered))
        materials = (STIFF, SOFT)
        problem = pressed(mesh, [pair], materials)
        load = np.zeros(mesh.points.shape)
        for a, b in mesh.boundary_facets("upper.bottom"):
            # the pressure goes on where nothing is below: exact for the linear shape functions
            (x_a, _), (x_b, _) = mesh.points[[a, b]]
            start = max(x_a, 1.0)
            if start < x_b:
                share = (0.5 * (start + x_b) - x_a) / (x_b - x_a)
                load[[a, b], 1] += P * (x_b - start) * np.array([1 - share, share])
        discrete = discretise(problem, mesh)
        discrete = replace(discrete, load=discrete.load + discrete.coupling.relative_forces(load.ravel()))
        result = am.solve(am.Hierarchy((am.Level(discrete, mesh),)), EXACT)
        assert_state(result, uniaxial(mesh, materials))
        sign = 1 if pair == UPPER_ON_LOWER else -1
        # what follows carries its part
        assert result.resultant(pair[0]).force == pytest.approx([0, sign * P], rel=1e-11, abs=1e-9 * P)
        assert result.resultant(pair[1]).force == pytest.approx([0, -sign * P], rel=1e-11, abs=1e-9 * P)

    @pytest.mark.parametrize("pair", [UPPER_ON_LOWER, LOWER_ON_UPPER], ids=["upper", "lower"])
    @pytest.mark.parametrize("angle", [0.3, 2.0, -1.1])
    def test_turned(self, angle, pair):
        materials = (STIFF, SOFT)
        flat = stacked([(4, 2), (7, 3)])
        mesh = turned(flat, angle)
        c, s = np.cos(angle), np.sin(angle)
        exact = uniaxial(flat, materials) @ np.array([[c, s], [-s, c]])
        problem = replace(pressed(mesh, [pair], materials), supports=(),
                          loads=(am.Pressure("upper.top", P), am.Pressure("lower.bottom", P)))
        # two corners of the lower body hold it; contact leaves the upper one the motion along it
        along, across = (0, 1) if abs(c) > abs(s) else (1, 0)
        fixed = [(0, 0), (0, 1), (4, across), (mesh.n_nodes - 1, along)]
        assert_state(am.solve(held_at_points(problem, mesh, exact, fixed), EXACT), exact)

    @pytest.mark.parametrize("pair", [UPPER_ON_LOWER, LOWER_ON_UPPER], ids=["upper", "lower"])
    def test_inclined_and_stuck(self, pair):
        # steeper than the interface, the friction cone holds the upper part
        lower = am.Polygon(vertices=[(0, 0), (1, 0), (1, 0.7), (0, 0.4)], boundaries=("bottom", "right", "top", "left"))
        upper = am.Polygon(vertices=[(0, 0.4), (1, 0.7), (1, 1.2), (0, 1.2)],
                           boundaries=("bottom", "right", "top", "left"))
        material = am.PlaneStrain(young=1e11, poisson=0.0)
        problem = am.ContactProblem(
            material=material, contact=am.ContactPair(*pair), law=am.Coulomb(0.35),
            loads=(am.Pressure("upper.top", P),), supports=(am.Support("lower.bottom", x=0.0, y=0.0),))
        meshes = [merged({"lower": graded(lower, h, ()), "upper": graded(upper, 0.8 * h, ())}) for h in (0.3, 0.15)]
        grids = am.Hierarchy.from_meshes(problem, meshes)
        for solver in (EXACT, am.FullMultigrid(rtol=1e-12)):
            result = am.solve(grids, solver)
            exact = -P / 1e11 * meshes[-1].points * [0, 1]
            np.testing.assert_allclose(result.displacement, exact, atol=1e-10 * np.abs(exact).max())
            cosine = 1 / np.hypot(1, 0.3)
            np.testing.assert_allclose(result.contact.pressure, P * cosine**2, rtol=1e-9)
            np.testing.assert_allclose(np.abs(result.contact.traction[:, 0]), 0.3 * P * cosine**2, rtol=1e-9)
            assert (result.contact.state == am.STICK).all()
        with pytest.raises(ValueError, match=r"nothing holds.*body 'upper'"):
            am.solve(discretise(replace(problem, law=am.Coulomb(0.25)), meshes[0]))


def in_the_corner(order, law):
    """A block in the corner of a seat, a cap on the block, equal pressure all around: mesh, problem, exact state."""
    seat = am.Polygon(vertices=[(-1, -1), (1, -1), (1, 0), (0, 0), (0, 1), (-1, 1)],
                      boundaries=("bottom", "right", "floor", "wall", "top", "left"))
    block, cap = am.Rectangle(width=1.0, height=1.0), am.Rectangle(width=1.0, height=0.5, origin=(0.0, 1.0))
    mesh = merged({"seat": graded(seat, 0.3, ()), "block": structured(block, (4, 5)), "cap": structured(cap, (3, 2))})
    pairs = {"floor": am.ContactPair("block.bottom", "seat.floor"), "wall": am.ContactPair("block.left", "seat.wall"),
             "cap": am.ContactPair("cap.bottom", "block.top")}
    outside = ("seat.bottom", "seat.right", "seat.top", "seat.left", "block.right", "cap.top", "cap.left", "cap.right")
    problem = am.ContactProblem(material=SOFT, contact=tuple(pairs[name] for name in order), law=law,
                                loads=tuple(am.Pressure(name, P) for name in outside))
    strain = (1 + SOFT.poisson) * (1 - 2 * SOFT.poisson) * P / SOFT.young
    return mesh, problem, -strain * mesh.points


class TestCorner:
    @pytest.mark.parametrize("order", [("floor", "wall", "cap"), ("wall", "cap", "floor"), ("cap", "wall", "floor")])
    def test_bodies_in_a_row(self, order):
        mesh, problem, exact = in_the_corner(order, am.Coulomb(0.3))
        a, b = far_node(mesh, "seat", (-1, -1)), far_node(mesh, "seat", (1, -1))
        discrete = held_at_points(problem, mesh, exact, [(a, 0), (a, 1), (b, 1)])
        # a node of the cap follows the corner of the block, which follows the wall
        weights = discrete.coupling.weights
        assert (weights @ weights).nnz
        result = am.solve(am.Hierarchy((am.Level(discrete, mesh),)), EXACT)
        assert_state(result, exact)
        for name, force in {"block.bottom": (0, P), "block.left": (P, 0), "cap.bottom": (0, P)}.items():
            master = {"block.bottom": "seat.floor", "block.left": "seat.wall", "cap.bottom": "block.top"}[name]
            assert result.resultant(name).force == pytest.approx(force, rel=1e-9, abs=1e-9 * P)
            assert result.resultant(master).force == pytest.approx(-np.array(force), rel=1e-9, abs=1e-9 * P)
        np.testing.assert_allclose(result.resultant("contact").force, [P, 2 * P], rtol=1e-9)

    @pytest.mark.parametrize("order", [("floor", "wall", "cap"), ("wall", "floor", "cap")])
    def test_the_corner_belongs_to_the_pair_named_first(self, order):
        mesh, problem, _ = in_the_corner(order, am.Frictionless())
        discrete = discretise(replace(problem, supports=(am.Support("seat.bottom", y=0.0),)), mesh)
        corner = np.flatnonzero((mesh.points == 0).all(axis=1)
                                & np.isin(np.arange(mesh.n_nodes), mesh.boundary_nodes("block.left")))
        contact = discrete.contact
        at = np.flatnonzero(contact.nodes == corner)
        assert len(at) == 1 and contact.boundary[at[0]] == 0
        np.testing.assert_allclose(contact.normals[at[0]], (0, -1) if order[0] == "floor" else (-1, 0), atol=1e-15)
        # it follows what its pair faces; in the other pair it is a plain node
        others = contact.nodes[contact.boundary == 1]
        assert discrete.coupling.weights[others][:, corner].nnz == 1


def bar_on_block(law, pair=UPPER_ON_LOWER, ratio=1.0, **options):
    """The GRECO bar pressed on an elastic block 1.5 times as wide, ``ratio`` times as stiff."""
    size, bar = 40e-3, am.PlaneStrain(young=1.3e11, poisson=0.2)
    return am.ContactProblem(
        material={"upper": bar, "lower": replace(bar, young=ratio * bar.young)}, law=law,
        domain=am.Assembly(parts={"upper": am.Rectangle(width=size, height=size), "lower": am.Rectangle(
            width=1.5 * size, height=size, origin=(-0.5 * size, -size))}),
        contact=am.ContactPair(*pair, **options),
        loads=(am.Pressure("upper.top", 5e7), am.Pressure("upper.left", 15e7)),
        supports=(am.Support("upper.right", x=0.0), am.Support("lower.right", x=0.0),
                  am.Support("lower.bottom", y=0.0)))


def bumpy(points):
    return 4e-6 * (1 + np.sin(points[:, 0] * 400))


def corner_pushed(law):
    """Three bodies, three pairs, unequal loads; the cap follows the block, which follows the seat."""
    order = ("wall", "floor", "cap")
    _, problem, _ = in_the_corner(order, law)
    seat = am.Polygon(vertices=[(-1, -1), (1, -1), (1, 0), (0, 0), (0, 1), (-1, 1)],
                      boundaries=("bottom", "right", "floor", "wall", "top", "left"))
    return replace(problem, domain=am.Assembly(parts={
        "seat": seat, "block": am.Rectangle(width=1.0, height=1.0),
        "cap": am.Rectangle(width=1.0, height=0.5, origin=(0.0, 1.0))}),
        loads=(am.Pressure("cap.top", lambda x: 4e7 * (1 + x[:, 0])), am.Pressure("block.right", 3e7),
               am.Traction("cap.left", (4e6, 0.0))),
        supports=(am.Support("seat.bottom", x=0.0, y=0.0), am.Support("cap.right", x=0.0)))


def bar_hierarchy(problem, n=3):
    return am.Hierarchy.uniform(problem, [{"upper": k, "lower": (5 * k // 4, k)} for k in (4, 8, 16, 32)[:n]])


PROBLEMS = {
    "bar": lambda law: bar_hierarchy(bar_on_block(law)),
    "block": lambda law: bar_hierarchy(bar_on_block(law, LOWER_ON_UPPER)),
    "bumpy": lambda law: bar_hierarchy(bar_on_block(law, gap=bumpy)),
    "corner": lambda law: am.Hierarchy.graded(corner_pushed(law), sizes=(0.5, 0.3, 0.17), contact_ratio=1.5)}
LAWS = {"frictionless": am.Frictionless(), "tresca": am.Tresca(1.5e7), "coulomb": am.Coulomb(0.3)}
SOLVERS = {"fmg": am.FullMultigrid(rtol=1e-10), "mg": am.Multigrid(rtol=1e-10), "active set": EXACT,
           "sparse active set": am.ActiveSet(condensed=False, rtol=1e-12),
           "monotone": am.FullMultigrid(correction=am.Monotone(), rtol=1e-10, max_cycles=400),
           "single grid": am.SingleGrid(condensed=True, rtol=1e-11)}


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("make", PROBLEMS)
def test_against_multipliers(make, law):
    grids = PROBLEMS[make](LAWS[law])
    mesh = grids.finest.mesh
    parts = Parts.of(grids.problem, mesh)
    displacement, pressure, force = solve_saddle(parts)
    scale = np.abs(displacement).max()
    for name, solver in SOLVERS.items():
        result = am.solve(grids, solver)
        contact = result.contact
        assert np.abs(result.displacement - displacement).max() <= 1e-8 * scale, name
        assert np.abs(contact.force_n - pressure).max() <= 2e-7 * pressure.max(), name
        assert np.abs(contact.force - force).max() <= 2e-7 * pressure.max(), name
        # what is called relative is so
        relative = (displacement - grids.finest.discrete.coupling.weights @ displacement)[contact.node]
        assert np.abs(contact.u_n - np.sum(relative * contact.normal, axis=1)).max() <= 2e-8 * scale
        assert_balanced(result, parts, 1e-7)


def assert_balanced(result, parts, tolerance):
    """Slaves and masters to rounding; with loads and supports all, and free nodes to the tolerance of the solver."""
    contact, mesh = result.contact, result.mesh
    load = parts.load.reshape(-1, mesh.dim)
    size, arm = np.abs(load).sum(), np.ptp(mesh.points)
    for slave, master in zip(contact.names, contact.masters, strict=True):
        one, other = result.resultant(slave), result.resultant(master)
        assert np.abs(one.force + other.force).max() <= 1e-12 * size
        # surfaces that lie on each other: no lever between the forces
        assert np.abs(one.moment + other.moment).max() <= 1e-12 * size * arm
    of_contact = np.zeros_like(load)
    of_contact[contact.node] = contact.force
    np.add.at(of_contact, contact.master_node, contact.master_force)
    supports = np.where(parts.fixed.reshape(load.shape), result.reaction - of_contact, 0.0)
    assert np.abs(result.reaction - of_contact - supports).max() <= tolerance * np.abs(of_contact).max()
    assert np.abs((result.reaction + load).sum(axis=0)).max() <= 1e-10 * size
    for name in result.mesh.boundaries:
        if name not in (*contact.names, *contact.masters):
            nodes = mesh.boundary_nodes(name)
            expected = (result.reaction - of_contact)[nodes].sum(axis=0)
            np.testing.assert_allclose(result.resultant(name).force, expected, atol=1e-12 * size)


def test_forces_balance_however_loose_the_solver():
    grids = bar_hierarchy(bar_on_block(am.Coulomb(0.5), LOWER_ON_UPPER))
    result = am.solve(grids, am.FullMultigrid(rtol=1e-2))
    assert result.residual > 1e-6
    on_slave, on_master = (result.resultant(name) for name in LOWER_ON_UPPER)
    size = np.abs(on_slave.force).max()
    assert size > 1e6 and np.abs(on_slave.force + on_master.force).max() <= 1e-13 * size
    assert abs(on_slave.moment + on_master.moment) <= 1e-13 * size
    total = am.solve(grids, EXACT).resultant("lower.bottom").force[1]
    assert total == pytest.approx(5e7 * 40e-3, rel=1e-9)


@pytest.mark.parametrize("law", [am.Frictionless(), am.Coulomb(0.4)], ids=["frictionless", "coulomb"])
def test_matching_meshes_node_to_node_or_mortar(law):
    results = []
    for coupling in ("mortar", "nodes"):
        problem = bar_on_block(law, coupling=coupling)
        grids = am.Hierarchy.uniform(problem, [{"upper": (2 * k, k), "lower": (3 * k, 2 * k)} for k in (2, 4, 8)])
        results.append(am.solve(grids, EXACT))
        assert am.solve(grids, am.FullMultigrid(rtol=1e-10), reference=results[0]).history["true_error"][-1] < 1e-9
    mortar, nodes = results
    # the mortar leaves out the corner of the bar, if it does: here all of it lies on the block
    np.testing.assert_array_equal(mortar.contact.node, nodes.contact.node)
    np.testing.assert_allclose(mortar.contact.weights, nodes.contact.weights, rtol=1e-12)
    np.testing.assert_allclose(mortar.displacement, nodes.displacement,
                               atol=1e-10 * np.abs(nodes.displacement).max())
    assert (mortar.contact.pair == "upper.bottom on lower.top").all()


def test_a_stiff_block_becomes_the_rigid_plane():
    rigid = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(0.5)), (4, 8, 16)), EXACT)
    differences = []
    for ratio in (1e2, 1e3, 1e4, 1e6):
        result = am.solve(bar_hierarchy(bar_on_block(am.Coulomb(0.5), ratio=ratio)), EXACT)
        n = len(rigid.displacement)
        differences.append(np.abs(result.displacement[:n] - rigid.displacement).max()
                           / np.abs(rigid.displacement).max())
    assert differences[-1] < 1e-5
    # of first order in the compliance
    assert differences[1] / differences[2] == pytest.approx(10, rel=0.3)
    assert am.solve(bar_hierarchy(bar_on_block(am.Coulomb(0.5), ratio=1e4)), am.FullMultigrid()).cycles <= 30


@pytest.mark.parametrize("pair", [UPPER_ON_LOWER, LOWER_ON_UPPER], ids=["upper", "lower"])
def test_an_interference_fit(pair):
    # two blocks between rigid walls, 0.2 mm too long together: uniaxial strain, modulus M = E (1-nu)/((1+nu)(1-2nu))
    overlap, heights = 2e-4, {"lower": 0.6, "upper": 0.4}
    assembly = am.Assembly(parts={"lower": am.Rectangle(width=1.0, height=0.6),
                                  "upper": am.Rectangle(width=1.0, height=0.4, origin=(0.0, 0.6 - overlap))})
    supports = (am.Support("lower.bottom", y=0.0), am.Support("upper.top", y=0.0),
                *(am.Support(f"{body}.{side}", x=0.0) for body in heights for side in ("left", "right")))
    materials = {"lower": STIFF, "upper": SOFT}
    problem = am.ContactProblem(material=materials, domain=assembly, supports=supports, law=am.Coulomb(0.3),
                                contact=am.ContactPair(*pair, allow_interference=True))
    grids = am.Hierarchy.uniform(problem, [{"lower": (k, k), "upper": (5 * k // 4, k)} for k in (4, 8)])
    modulus = {name: m.young * (1 - m.poisson) / ((1 + m.poisson) * (1 - 2 * m.poisson))
               for name, m in materials.items()}
    pressure = overlap / sum(heights[name] / modulus[name] for name in heights)
    for solver in (EXACT, am.FullMultigrid(rtol=1e-10), am.Multigrid(rtol=1e-10),
                   am.Multigrid(correction=am.Monotone(), rtol=1e-10), am.SingleGrid(condensed=True, rtol=1e-12)):
        result = am.solve(grids, solver)
        np.testing.assert_allclose(result.contact.pressure, pressure, rtol=1e-7)
        assert np.abs(result.contact.gap).max() <= 1e-8 * overlap
        top = grids.finest.mesh.boundary_nodes("lower.top")
        np.testing.assert_allclose(result.displacement[top, 1], -pressure * 0.6 / modulus["lower"], rtol=1e-7)
    # from a start that overlaps, one that gapes, and the solution
    for start in (np.zeros_like(result.displacement), result, 3 * result.displacement):
        again = am.solve(grids, am.Multigrid(rtol=1e-10), start=start)
        np.testing.assert_allclose(again.contact.pressure, pressure, rtol=1e-7)
        assert again.cycles <= (1 if start is result else 30)
    with pytest.raises(ValueError, match=rf"{pair[0]}.*{pair[1]}.*overlap by up to 0.0002 m.*allow_interference"):
        discretise(replace(problem, contact=am.ContactPair(*pair)), grids.finest.mesh)


def test_a_start_and_a_reference_are_displacements():
    grids = bar_hierarchy(bar_on_block(am.Coulomb(0.5)))
    exact = am.solve(grids, EXACT)
    result = am.solve(grids, am.Multigrid(rtol=1e-8), start=exact, reference=exact)
    assert result.cycles <= 1 and result.history["true_error"][0] < 1e-10
    discrete = grids.finest.discrete
    flat = exact.displacement.ravel()
    np.testing.assert_allclose(discrete.physical(discrete.relative(flat)).ravel(), flat,
                               atol=1e-14 * np.abs(flat).max())


class TestHierarchies:
    def check(self, grids):
        reference = am.solve(grids, EXACT)
        for solver in (am.FullMultigrid(), am.Multigrid()):
            result = am.solve(grids, solver, reference=reference)
            assert result.history["true_error"][-1] <= 3e-8 and result.cycles <= 40
        return reference

    def test_graded_with_sizes_by_body(self):
        problem = bar_on_block(am.Coulomb(0.5))
        grids = am.Hierarchy.graded(
            problem, sizes=[{"upper": h, "lower": 1.4 * h} for h in (16e-3, 8e-3, 4e-3)],
            contact_ratio={"upper": 2.0, "lower": 3.0})
        self.check(grids)

    def test_bisected(self):
        problem = bar_on_block(am.Coulomb(0.5))
        grids = am.Hierarchy.bisected(problem, structured(problem.domain, {"upper": 3, "lower": (5, 4)}), 3)
        self.check(grids)

    def test_given_meshes_and_one_level(self, tmp_path):
        problem = bar_on_block(am.Coulomb(0.5))
        meshes = [structured(problem.domain, {"upper": k, "lower": k + 1}) for k in (3, 5, 9)]
        grids = am.Hierarchy.from_meshes(replace(problem, domain=None), meshes, transfer=am.L2())
        result = self.check(grids)
        single = am.solve(grids.finest.discrete, am.SingleGrid(condensed=True, rtol=1e-11))
        np.testing.assert_allclose(single.displacement, result.displacement,
                                   atol=1e-8 * np.abs(result.displacement).max())
        assert single.resultant("upper.bottom").force == pytest.approx(result.resultant("upper.bottom").force)
        assert single.resultant("lower.top").force == pytest.approx(result.resultant("lower.top").force)
        with pytest.raises(ValueError, match=r"'lower.bottom' is not known"):
            single.resultant("lower.bottom")
        algebraic = am.Hierarchy.algebraic(grids.finest.discrete, max_coarse=60)
        again = am.solve(algebraic, am.Multigrid(), reference=result)
        assert again.history["true_error"][-1] <= 3e-8

    def test_saved_and_loaded(self, tmp_path):
        grids = am.Hierarchy.graded(corner_pushed(am.Coulomb(0.3)), sizes=(0.5, 0.3))
        result = am.solve(grids)
        result.save(tmp_path / "corner.npz")
        loaded = am.Result.load(tmp_path / "corner.npz")
        assert loaded.contact.masters == result.contact.masters == ("seat.wall", "seat.floor", "block.top")
        assert loaded.mesh.bodies == ("seat", "block", "cap")
        for name in ("master_node", "master_force", "master_boundary", "force", "pair"):
            np.testing.assert_array_equal(getattr(loaded.contact, name), getattr(result.contact, name))
        for name in ("contact", "block.left", "seat.wall", "block.top", "seat.bottom", "cap.right"):
            np.testing.assert_array_equal(loaded.resultant(name).force, result.resultant(name).force)
        np.testing.assert_array_equal(am.solve(grids, am.Multigrid(), start=loaded).contact.state, result.contact.state)


class TestRefusals:
    def problem(self, **changes):
        return replace(bar_on_block(am.Frictionless()), **changes)

    def mesh(self, lift=0.0, bodies=("upper", "lower")):
        assembly = bar_on_block(am.Frictionless()).domain
        parts = {name: structured(assembly.parts[name], 4) for name in ("upper", "lower")}
        upper = parts["upper"]
        parts["upper"] = replace(upper, points=upper.points + np.array([0.0, lift]), source=None)
        parts["other"] = parts["upper"]
        return merged({name: parts[name] for name in bodies})

    def test_bodies_that_overlap(self):
        with pytest.raises(ValueError, match=r"'upper.bottom' on 'lower.top'.*overlap by up to 0.001 m.*apart"):
            discretise(self.problem(domain=None), self.mesh(-1e-3))
        assert discretise(self.problem(domain=None), self.mesh(1e-3)).contact.gaps == pytest.approx(1e-3)

    def test_surfaces_that_never_face_each_other(self):
        for pair in (am.ContactPair("upper.bottom", "lower.bottom"), am.ContactPair("upper.left", "lower.top"),
                     am.ContactPair("upper.bottom", "lower.top", reach=1e-3)):
            with pytest.raises(ValueError, match=rf"'{pair.slave}' on '{pair.master}': the surfaces never face"):
                discretise(self.problem(contact=pair, supports=(am.Support("lower.left", x=0.0),)), self.mesh(2e-3))

    def test_a_body_that_nothing_touches(self):
        problem = self.problem(material=am.PlaneStrain(young=1e11, poisson=0.2), domain=None)
        with pytest.raises(ValueError, match=r"nothing holds body 'other'"):
            discretise(problem, self.mesh(bodies=("upper", "lower", "other")))

    def test_a_slave_named_twice(self):
        pairs = (am.ContactPair("upper.bottom", "lower.top"), am.ContactPair("upper.bottom", "lower.left"))
        with pytest.raises(ValueError, match=r"'upper.bottom' is named twice"):
            self.problem(contact=pairs)
        with pytest.raises(ValueError, match=r"'lower.top' is the master of 'upper.bottom' and slave of another"):
            self.problem(contact=(pairs[0], am.ContactPair("lower.top", "upper.left")))

    @pytest.mark.parametrize("boundary", ["upper.bottom", "upper.left"])
    def test_a_support_against_the_contact(self, boundary):
        problem = self.problem(supports=(am.Support(boundary, y=0.0), am.Support("lower.bottom", y=0.0)))
        with pytest.raises(ValueError, match=rf"'{boundary}' fixes y.*'upper.bottom'.*common node"):
            discretise(problem, self.mesh())

    def test_a_support_on_the_master_is_no_trouble(self):
        down = -3e-5  # the upper body follows the master
        problem = self.problem(supports=(am.Support("lower.top", x=0.0, y=down), am.Support("upper.right", x=0.0)))
        rigid = am.solve(discretise(am.cases.greco_bar(law=am.Frictionless()),
                                    structured(am.Rectangle(width=40e-3, height=40e-3), 4)), EXACT)
        result = am.solve(am.Hierarchy.from_meshes(problem, [self.mesh()]), EXACT)
        np.testing.assert_allclose(result.displacement[:25] - [0, down], rigid.displacement, atol=1e-10 * abs(down))
        # the master passes on what the support takes
        assert result.resultant("lower.top").force == pytest.approx(-result.resultant("upper.bottom").force)

    def test_free_bodies(self):
        discrete = discretise(self.problem(loads=(am.Traction("upper.top", (0.0, 1e6)),)), self.mesh())
        with pytest.raises(ValueError, match=r"nothing holds.*translation along y of body 'upper'"):
            am.solve(discrete)
        problem = self.problem(supports=(am.Support("lower.bottom", x=0.0, y=0.0),),
                               loads=(am.Pressure("upper.top", 1e6),))
        with pytest.raises(ValueError, match=r"not unique.*translation along x of body 'upper'"):
            am.solve(discretise(problem, self.mesh()))
        problem = self.problem(supports=(am.Support("upper.top", x=0.0, y=0.0),))
        with pytest.raises(ValueError, match=r"body 'lower'"):
            am.solve(discretise(problem, self.mesh()))

    def test_unknown_names(self):
        with pytest.raises(ValueError, match=r"'lower.topp', used for contact, does not exist"):
            self.problem(contact=am.ContactPair("upper.bottom", "lower.topp"))
        with pytest.raises(ValueError, match=r"'uper.bottom', used for contact, does not exist"):
            discretise(self.problem(domain=None, contact=am.ContactPair("uper.bottom", "lower.top")), self.mesh())
        with pytest.raises(ValueError, match="body"):
            discretise(self.problem(domain=None), self.mesh(bodies=("upper", "lower", "other")))
        result = am.solve(discretise(self.problem(), self.mesh()), EXACT)
        with pytest.raises(ValueError, match="'nothing' is not known"):
            result.resultant("nothing")
        with pytest.raises(ValueError, match="''"):
            result.resultant("")
