"""Bodies in contact: exact states on any meshes, chains of bodies, the hierarchies they are solved on."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import (
    DIMS,
    EXACT,
    MATERIALS,
    PAIRS,
    UPPER_ON_LOWER,
    P,
    assert_state,
    bar_on_block,
    corner_pushed,
    far_node,
    held_at_points,
    in_the_corner,
    pressed,
    rotation,
    stacked,
    turned,
    uniaxial,
)

import adaptmg as am
from adaptmg.discrete.discretise import discretise
from adaptmg.mesh import structured

INDEPENDENT = {2: [(4, 2), (7, 3)], 3: [(3, 1, 1), (2, 2, 1)]}


class TestPatch:
    @DIMS
    @pytest.mark.parametrize("pairs", [(a, b) for a in (("upper.bottom", "middle.top"), ("middle.top", "upper.bottom"))
                                       for b in (("middle.bottom", "lower.top"), ("lower.top", "middle.bottom"))])
    def test_three_blocks(self, dim, pairs):
        mesh = stacked([(4, 2), (7, 3), (3, 2)] if dim == 2 else [(3, 1, 1), (2, 2, 1), (1, 3, 2)])
        materials = (*MATERIALS[dim][::-1], MATERIALS[dim][1])
        result = am.solve(am.Hierarchy.from_meshes(pressed(mesh, pairs, materials), mesh), EXACT)
        assert_state(result, uniaxial(mesh, materials))
        for slave, master in pairs:
            force = P if slave.endswith("bottom") else -P
            assert result.resultant(slave).force == pytest.approx([*[0] * (dim - 1), force], rel=1e-9, abs=1e-11 * P)
            moment = -force / 2 if dim == 2 else [-force / 2, force / 2, 0]
            assert result.resultant(master).moment == pytest.approx(moment, rel=1e-9, abs=1e-9 * P)

    @PAIRS
    @pytest.mark.parametrize("covered", [0.02, 0.6])
    def test_overhanging(self, covered, pair):
        """The last edge that touches is covered by this fraction; what follows carries its part."""
        n, materials = 5, MATERIALS[2]
        mesh = stacked([(7, 3), (n, 4)], width=n / (3 + covered))
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
        for name, sign in zip(UPPER_ON_LOWER, (1, -1), strict=True):
            assert result.resultant(name).force == pytest.approx([0, sign * P], rel=1e-11, abs=1e-9 * P)

    @PAIRS
    @pytest.mark.parametrize("inner", [0.0, 0.3], ids=["disks", "rings"])
    def test_axisymmetric(self, inner, pair):
        materials = [am.Axisymmetric(**vars(m)) for m in MATERIALS[2]]
        flat = stacked([(4, 2), (7, 3)])
        mesh = replace(flat, points=flat.points + np.array([inner, 0.0]), source=None)
        problem = pressed(mesh, [pair], materials)
        held = problem.supports if inner == 0 else problem.supports[:1]
        result = am.solve(am.Hierarchy.from_meshes(replace(problem, supports=held), [mesh]), EXACT)
        assert_state(result, uniaxial(mesh, materials))
        force = np.pi * ((1 + inner)**2 - inner**2) * P
        assert result.resultant("lower.top").force[1] == pytest.approx(-force, rel=1e-11)

    @PAIRS
    @pytest.mark.parametrize("turn", [2.0, (0.3, -0.5, 1.1)])
    def test_turned(self, turn, pair):
        dim = 3 if np.ndim(turn) else 2
        flat, materials, Q = stacked(INDEPENDENT[dim]), MATERIALS[dim], rotation(turn)
        mesh, exact = turned(flat, turn), uniaxial(flat, materials) @ Q.T
        problem = replace(pressed(mesh, [pair], materials), supports=(),
                          loads=(am.Pressure("upper.top", P), am.Pressure("lower.bottom", P)))
        if dim == 2:  # two corners of the lower body hold it; contact leaves the upper one the motion along it
            along, across = (0, 1) if abs(Q[0, 0]) > abs(Q[1, 0]) else (1, 0)
            held = [(0, 0), (0, 1), (4, across), (mesh.n_nodes - 1, along)]
        else:
            held = [far_node(flat, body, (a, b, up)) for body, up in (("lower", -1), ("upper", 1))
                    for a, b in ((-1, -1.1), (1, -1.1), (-1.1, 1))]
            held = [(node, d) for node in held[:-1] for d in range(3)]
        result = am.solve(held_at_points(problem, mesh, exact, held), EXACT)
        assert_state(result, exact)
        normal = Q[:, -1] * (-1 if pair == UPPER_ON_LOWER else 1)
        np.testing.assert_allclose(result.contact.normal, np.tile(normal, (len(result.contact), 1)), atol=1e-12)

    @DIMS
    @PAIRS
    def test_node_to_node(self, dim, pair):
        mesh, found = stacked([(3, 2), (3, 1)] if dim == 2 else [(3, 2, 1), (3, 2, 2)]), {}
        for coupling in ("mortar", "nodes"):
            problem = replace(pressed(mesh, [pair], MATERIALS[dim]), contact=am.ContactPair(*pair, coupling=coupling))
            found[coupling] = am.solve(discretise(problem, mesh), EXACT)
            assert_state(found[coupling], uniaxial(mesh, MATERIALS[dim]))
            assert (found[coupling].contact.pair == " on ".join(pair)).all()
        np.testing.assert_array_equal(found["mortar"].contact.node, found["nodes"].contact.node)
        np.testing.assert_allclose(found["mortar"].contact.weights, found["nodes"].contact.weights, rtol=1e-12)


class TestCorner:
    @pytest.mark.parametrize("order", [("floor", "wall", "cap"), ("wall", "floor", "cap"), ("cap", "wall", "floor")])
    def test_bodies_in_a_row(self, order):
        mesh, problem, exact = in_the_corner(order, am.Coulomb(0.3))
        a, b = far_node(mesh, "seat", (-1, -1)), far_node(mesh, "seat", (1, -1))
        discrete = held_at_points(problem, mesh, exact, [(a, 0), (a, 1), (b, 1)])
        weights, contact = discrete.coupling.weights, discrete.contact
        # the corner of the block belongs to the pair named first; in the other it is a plain node
        corner = np.flatnonzero((mesh.points == 0).all(axis=1) & (np.arange(mesh.n_nodes) >= np.min(
            mesh.elements[mesh.element_body == 1])))[0]
        at = np.flatnonzero(contact.nodes == corner)
        first, second = (name for name in order if name != "cap")
        assert len(at) == 1 and contact.boundary[at[0]] == order.index(first)
        np.testing.assert_allclose(contact.normals[at[0]], (0, -1) if first == "floor" else (-1, 0), atol=1e-15)
        assert weights[contact.nodes[contact.boundary == order.index(second)]][:, corner].nnz == 1
        # a node of the cap follows the corner of the block, which follows the wall
        assert (weights @ weights).nnz
        result = am.solve(am.Hierarchy((am.Level(discrete, mesh),)), EXACT)
        assert_state(result, exact)
        for slave, master, force in (("block.bottom", "seat.floor", (0, P)), ("block.left", "seat.wall", (P, 0)),
                                     ("cap.bottom", "block.top", (0, P))):
            assert result.resultant(slave).force == pytest.approx(force, rel=1e-9, abs=1e-9 * P)
            assert result.resultant(master).force == pytest.approx(-np.array(force), rel=1e-9, abs=1e-9 * P)
        np.testing.assert_allclose(result.resultant("contact").force, [P, 2 * P], rtol=1e-9)


class TestHierarchies:
    @pytest.mark.filterwarnings("ignore:bisected, levels=3")
    def test_bisected_given_and_algebraic_levels_and_one_level(self):
        """The same solution of all, and less to ask where there is no mesh."""
        problem = bar_on_block(am.Coulomb(0.5))
        meshes = [structured(problem.domain, {"upper": k, "lower": k + 1}) for k in (3, 6)]
        given = am.Hierarchy.from_meshes(replace(problem, domain=None), meshes, transfer=am.L2())
        bisected = am.Hierarchy.bisected(problem, structured(problem.domain, {"upper": 3, "lower": (5, 4)}), 3)
        algebraic = am.Hierarchy.algebraic(given.finest.discrete, max_coarse=60)
        for grids, solver in ((bisected, am.FullMultigrid()), (bisected, am.Multigrid()), (given, am.FullMultigrid()),
                              (given, am.Multigrid()), (algebraic, am.Multigrid())):
            result = am.solve(grids, solver, reference=am.solve(grids, EXACT))
            assert result.history["true_error"][-1] <= 3e-8 and result.cycles <= 40
        result = am.solve(given, EXACT)
        single = am.solve(given.finest.discrete, am.SingleGrid(condensed=True, rtol=1e-11))
        np.testing.assert_allclose(single.displacement, result.displacement,
                                   atol=1e-8 * np.abs(result.displacement).max())
        for name in UPPER_ON_LOWER:
            assert single.resultant(name).force == pytest.approx(result.resultant(name).force)
        with pytest.raises(ValueError, match=r"'lower.bottom' is not known"):
            single.resultant("lower.bottom")

    def test_forces_balance_where_supports_drag_a_body_over_the_other(self):
        """At the corner both are held, and friction there passes from one support to the other."""
        problem = bar_on_block(am.Coulomb(0.5))
        moved = replace(problem, supports=(am.Support("upper.right", x=2e-4), *problem.supports[1:]))
        result = am.solve(am.Hierarchy.uniform(moved, [{"upper": 4, "lower": (5, 4)}]), EXACT)
        corner = np.argmax(result.contact.x[:, 0])
        upper, lower = (result.resultant(name).force for name in ("upper.bottom", "lower.top"))
        assert np.abs(result.contact.force_t[corner]) > 1e-3 * np.abs(upper[0])
        np.testing.assert_allclose(upper, -lower, rtol=1e-10)

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
