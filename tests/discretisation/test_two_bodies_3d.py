"""Bodies in contact in 3D: exact states, an independent solver with multipliers, balance of forces and moments."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bodies import (
    EXACT,
    LOWER_ON_UPPER,
    UPPER_ON_LOWER,
    P,
    assert_agrees,
    assert_balanced,
    assert_state,
    far_node,
    held_at_points,
)
from saddle import Parts
from scipy.spatial.transform import Rotation

import adaptmg as am
from adaptmg.discrete.discretise import discretise
from adaptmg.mesh import merged, structured
from adaptmg.mesh.arrays import MeshArrays

SOFT, STIFF = am.Solid(young=7e10, poisson=0.34), am.Solid(young=2.1e11, poisson=0.28)
HEIGHT = 0.6


def stacked(divisions):
    """A mesh of boxes of unit width and depth, from below: "lower", "middle" (with three), "upper"."""
    names = ("lower", "upper") if len(divisions) == 2 else ("lower", "middle", "upper")
    return merged({name: structured(am.Box(width=1.0, depth=1.0, height=HEIGHT, origin=(0.0, 0.0, HEIGHT * k)), n)
                   for k, (name, n) in enumerate(zip(names, divisions, strict=True))})


def uniaxial(mesh, materials):
    """Exact displacement of a stack under the pressure P, zero at the origin."""
    exact, base = np.zeros(mesh.points.shape), 0.0
    for k, material in enumerate(materials):
        axial = -P / material.young
        nodes = np.unique(mesh.elements[mesh.element_body == k])
        x = mesh.points[nodes]
        exact[nodes] = axial * (x - [0, 0, HEIGHT * k]) * [-material.poisson, -material.poisson, 1] + [0, 0, base]
        base += HEIGHT * axial
    return exact


def pressed(mesh, pairs, materials):
    return am.ContactProblem(
        material=dict(zip(mesh.bodies, materials, strict=True)), contact=pairs, law=am.Frictionless(),
        loads=(am.Pressure("upper.top", P),),
        supports=(am.Support("lower.bottom", z=0.0), *(am.Support(f"{body}.left", x=0.0) for body in mesh.bodies),
                  *(am.Support(f"{body}.front", y=0.0) for body in mesh.bodies)))


PAIRS = pytest.mark.parametrize("pair", [UPPER_ON_LOWER, LOWER_ON_UPPER], ids=["upper", "lower"])


class TestPatch:
    @PAIRS
    @pytest.mark.parametrize("solver", [EXACT, am.FullMultigrid(rtol=1e-12)], ids=["active set", "multigrid"])
    def test_flat(self, pair, solver):
        meshes = [stacked([(2 * k, k, k), (k, 3 * k, k)]) for k in (1, 2)]
        problem = pressed(meshes[0], am.ContactPair(*pair), (STIFF, SOFT))
        result = am.solve(am.Hierarchy.from_meshes(problem, meshes), solver)
        assert_state(result, uniaxial(meshes[-1], (STIFF, SOFT)))
        up = 1 if pair == UPPER_ON_LOWER else -1
        assert result.resultant(pair[0]).force == pytest.approx([0, 0, up * P], rel=1e-11, abs=1e-11 * P)
        assert result.resultant(pair[1]).moment == pytest.approx([-up * P / 2, up * P / 2, 0], rel=1e-9, abs=1e-9 * P)

    @pytest.mark.parametrize("pairs", [(a, b) for a in (("upper.bottom", "middle.top"), ("middle.top", "upper.bottom"))
                                       for b in (("middle.bottom", "lower.top"), ("lower.top", "middle.bottom"))])
    def test_three_blocks(self, pairs):
        mesh, materials = stacked([(3, 1, 1), (2, 2, 1), (1, 3, 2)]), (SOFT, STIFF, SOFT)
        problem = pressed(mesh, tuple(am.ContactPair(*pair) for pair in pairs), materials)
        assert_state(am.solve(discretise(problem, mesh), EXACT), uniaxial(mesh, materials))

    def test_a_chain_of_bodies(self):
        """A block is slave below and master beside: what follows it follows the floor too."""
        seat = structured(am.Box(width=2.0, depth=1.0, height=0.5, origin=(0.0, 0.0, -0.5)), (5, 3, 1))
        block = structured(am.Box(width=1.0, depth=1.0, height=1.0), (3, 2, 3))
        beside = structured(am.Box(width=0.7, depth=1.0, height=1.0, origin=(1.0, 0.0, 0.0)), (2, 3, 2))
        mesh = merged({"seat": seat, "block": block, "beside": beside})
        outside = ("seat.bottom", "seat.left", "seat.right", "block.left", "block.top", "beside.right", "beside.top")
        pairs = (am.ContactPair("block.bottom", "seat.top"), am.ContactPair("beside.left", "block.right"),
                 am.ContactPair("beside.bottom", "seat.top"))
        problem = am.ContactProblem(
            material=SOFT, contact=pairs, law=am.Coulomb(0.3),
            loads=tuple(am.Pressure(name, P) for name in (*outside, "seat.top")) + tuple(
                am.Pressure(f"{body}.{side}", P) for body in mesh.bodies for side in ("front", "back")))
        exact = -(1 - 2 * SOFT.poisson) * P / SOFT.young * mesh.points
        corners = [far_node(mesh, "seat", way) for way in ((-1, -1, -1), (1, -1, -1), (-1, 1, -1))]
        load = np.zeros(mesh.points.shape)
        for a in mesh.boundary_facets("seat.top"):  # where a block stands, it presses itself: take that off again
            if mesh.points[a, 0].max() <= 1.7 + 1e-12:
                load[a, 2] += P * 0.5 * np.linalg.norm(np.cross(*(mesh.points[a[1:]] - mesh.points[a[0]]))) / 3
            elif mesh.points[a, 0].min() < 1.7:
                load[a, 2] += P * covered_moments(mesh.points[a][:, :2], 1.7)
        discrete = held_at_points(problem, mesh, exact, [(node, d) for node in corners for d in range(3)], load)
        weights = discrete.coupling.weights
        assert (weights @ weights).nnz
        result = am.solve(am.Hierarchy((am.Level(discrete, mesh),)), EXACT)
        assert_state(result, exact)
        assert result.resultant("block.right").force == pytest.approx([-P, 0, 0], rel=1e-9, abs=1e-9 * P)
        np.testing.assert_allclose(result.resultant("seat.top").force, [0, 0, -1.7 * P], atol=1e-9 * P)

    @PAIRS
    @pytest.mark.parametrize("turn", [(0.3, -0.5, 1.1), (2.0, 0.4, -0.7)])
    def test_turned(self, turn, pair):
        flat, materials = stacked([(3, 1, 1), (2, 2, 1)]), (STIFF, SOFT)
        Q = Rotation.from_rotvec(turn).as_matrix()
        mesh = MeshArrays(flat.points @ Q.T, flat.elements, flat.facets, flat.facet_labels, flat.boundaries,
                          element_body=flat.element_body, bodies=flat.bodies)
        exact = uniaxial(flat, materials) @ Q.T
        problem = replace(pressed(mesh, am.ContactPair(*pair), materials), supports=(),
                          loads=(am.Pressure("upper.top", P), am.Pressure("lower.bottom", P)))
        held = [far_node(flat, body, (a, b, up)) for body, up in (("lower", -1), ("upper", 1))
                for a, b in ((-1, -1.1), (1, -1.1), (-1.1, 1))]
        held = [(node, d) for node in held[:-1] for d in range(3)]
        result = am.solve(held_at_points(problem, mesh, exact, held), EXACT)
        assert_state(result, exact)
        normal = Q @ [0, 0, -1 if pair == UPPER_ON_LOWER else 1]
        np.testing.assert_allclose(result.contact.normal, np.tile(normal, (len(result.contact), 1)), atol=1e-12)

    @PAIRS
    def test_node_to_node(self, pair):
        mesh, materials = stacked([(3, 2, 1), (3, 2, 2)]), (STIFF, SOFT)
        found = {}
        for coupling in ("mortar", "nodes"):
            problem = pressed(mesh, am.ContactPair(*pair, coupling=coupling), materials)
            found[coupling] = am.solve(discretise(problem, mesh), EXACT)
            assert_state(found[coupling], uniaxial(mesh, materials))
        np.testing.assert_allclose(found["mortar"].contact.weights, found["nodes"].contact.weights, rtol=1e-12)


def covered_moments(triangle, edge):
    """Integrals of the three linear shape functions over the part of a triangle (3, 2) with x < edge."""
    x = triangle[:, 0]
    part = []
    for i in range(3):
        j = (i + 1) % 3
        if x[i] <= edge:
            part.append(np.eye(3)[i])
        if (x[i] - edge) * (x[j] - edge) < 0:
            s = (edge - x[i]) / (x[j] - x[i])
            part.append((1 - s) * np.eye(3)[i] + s * np.eye(3)[j])
    total = np.zeros(3)
    for b, c in pairwise(part[1:]):
        corners = np.array([part[0], b, c])
        p = corners @ triangle
        total += 0.5 * abs(np.linalg.det(p[1:] - p[0])) * corners.mean(axis=0)
    return total


def block_on_slab(law, pair=UPPER_ON_LOWER, **options):
    """A block pressed and pushed both ways along a wider slab, stiffer than it."""
    return am.ContactProblem(
        material={"upper": SOFT, "lower": STIFF}, law=law,
        domain=am.Assembly(parts={"upper": am.Box(width=1.0, depth=1.0, height=1.0), "lower": am.Box(
            width=1.5, depth=1.25, height=0.5, origin=(0.0, 0.0, -0.5))}),
        contact=am.ContactPair(*pair, **options),
        loads=(am.Pressure("upper.top", P), am.Pressure("upper.right", 2.4 * P),
               am.Traction("upper.top", (0.0, 0.2 * P, 0.0))),
        supports=(am.Support("upper.left", x=0.0), am.Support("upper.front", y=0.0), am.Support("lower.left", x=0.0),
                  am.Support("lower.front", y=0.0), am.Support("lower.bottom", z=0.0)))


def wavy(points):
    return 1e-5 * (2 + np.sin(9 * points[:, 0]) + np.cos(7 * points[:, 1]))


def nested(problem):
    return am.Hierarchy.uniform(problem, [{"upper": 2 * k, "lower": (3 * k, 2 * k, k)} for k in (1, 2)])


def independent(problem):
    domain = problem.domain
    return am.Hierarchy.from_meshes(replace(problem, domain=None), [
        structured(domain, {"upper": k, "lower": (k + 1, k + 2, 1)}) for k in (2, 3, 4)])


PROBLEMS = {
    "upper": lambda law: nested(block_on_slab(law)), "lower": lambda law: nested(block_on_slab(law, LOWER_ON_UPPER)),
    "wavy": lambda law: nested(block_on_slab(law, gap=wavy)),
    "independent meshes": lambda law: independent(block_on_slab(law)),
    "node to node": lambda law: am.Hierarchy.uniform(block_on_slab(law, coupling="nodes"), [
        {"upper": (2 * k, 4 * k, k), "lower": (3 * k, 5 * k, k)} for k in (1, 2)])}
LAWS = {"frictionless": am.Frictionless(), "tresca": am.Tresca(1.5e7), "friction 0.3": am.Coulomb(0.3),
        "friction 1": am.Coulomb(1.0)}
SOLVERS = {"nested start": am.FullMultigrid(rtol=1e-11), "cold": am.Multigrid(rtol=1e-11), "active set": EXACT}


@pytest.mark.parametrize(("make", "law"), [(make, law) for make in PROBLEMS for law in LAWS
                                           if law.startswith("friction ") or make == "lower"])
def test_against_multipliers(make, law):
    assert_agrees(PROBLEMS[make](LAWS[law]), SOLVERS)


def test_the_monotone_correction():
    assert_agrees(nested(block_on_slab(am.Coulomb(0.3))),
                  {"monotone": am.FullMultigrid(correction=am.Monotone(), rtol=1e-10, max_cycles=400)})


def test_forces_balance_however_loose_the_solver():
    grids = nested(block_on_slab(am.Coulomb(0.3), LOWER_ON_UPPER, gap=wavy))
    result = am.solve(grids, am.FullMultigrid(rtol=1e-2))
    assert result.residual > 1e-6
    assert_balanced(result, Parts.of(grids.problem, grids.finest.mesh), 1.0)


@PAIRS
def test_an_interference_fit(pair):
    # between rigid walls in all directions: uniaxial strain, modulus E (1 - nu) / ((1 + nu) (1 - 2 nu)); no load
    overlap, walls = 1e-4, {"left": "x", "right": "x", "front": "y", "back": "y"}
    parts = {"lower": am.Box(width=1.0, depth=1.0, height=0.6),
             "upper": am.Box(width=1.0, depth=1.0, height=0.4, origin=(0.0, 0.0, 0.6 - overlap))}
    problem = am.ContactProblem(
        material={"lower": STIFF, "upper": SOFT}, domain=am.Assembly(parts=parts), law=am.Coulomb(0.3),
        contact=am.ContactPair(*pair, allow_interference=True),
        supports=(am.Support("lower.bottom", z=0.0), am.Support("upper.top", z=0.0),
                  *(am.Support(f"{body}.{wall}", **{c: 0.0}) for body in parts for wall, c in walls.items())))
    grids = am.Hierarchy.uniform(problem, [{"lower": (2 * k, k, k), "upper": (k, 3 * k, k)} for k in (1, 2)])
    compliance = {name: (1 + m.poisson) * (1 - 2 * m.poisson) / (m.young * (1 - m.poisson))
                  for name, m in problem.material.items()}
    pressure = overlap / (0.6 * compliance["lower"] + 0.4 * compliance["upper"])
    for solver in (EXACT, am.FullMultigrid(rtol=1e-10), am.Multigrid(rtol=1e-10)):
        result = am.solve(grids, solver)
        np.testing.assert_allclose(result.contact.pressure, pressure, rtol=1e-7)
        assert np.abs(result.contact.gap).max() <= 1e-7 * overlap
    with pytest.raises(ValueError, match=rf"{pair[0]}.*{pair[1]}.*overlap by up to 0.0001 m.*allow_interference"):
        discretise(replace(problem, contact=am.ContactPair(*pair)), grids.finest.mesh)
