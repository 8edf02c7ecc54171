"""Bodies in contact in 2D: exact states, an independent solver, balance of forces, limits, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from saddle import Parts, solve_saddle

import adaptmg as am
from adaptmg.discretisation.discretise import discretise
from adaptmg.discretisation.rigid_motions import rigid_motions
from adaptmg.mesh import graded, merged, refine_near, structured
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
