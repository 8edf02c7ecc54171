"""Contact nodes and the whole discretisation: normals, masses, gaps, ownership, and every refusal."""

from dataclasses import replace

import numpy as np
import pytest
from refused import refused
from simplex_meshes import disk

import adaptmg as am
from adaptmg.discrete import discretise
from adaptmg.discrete.discretise import contact_data
from adaptmg.mesh import MeshArrays, structured

SQUARE, CUBE = am.Rectangle(width=2.0, height=1.0), am.Box(width=2.0, depth=1.0, height=1.0)
PLATE, BLOCK = structured(SQUARE, 4), structured(CUBE, (4, 3, 2))
FLOOR = am.Plane(point=(0.0, 0.0), normal=(0.0, 1.0))
TOUCHING = am.GapFunction(lambda x: np.zeros(len(x)))


def plane_problem(**changes: object) -> am.ContactProblem:
    arguments = {"material": am.PlaneStrain(young=1e9, poisson=0.3), "contact": am.Contact("bottom", FLOOR),
                 "law": am.Frictionless(), "loads": (am.Pressure("top", 1e5),), "name": "plate",
                 "supports": (am.Support("left", x=0.0),)}
    return am.ContactProblem(**(arguments | changes))


def solid_problem(**changes: object) -> am.ContactProblem:
    arguments = {"material": am.Solid(young=1e9, poisson=0.3), "law": am.Frictionless(),
                 "contact": am.Contact("bottom", am.Plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)))}
    return am.ContactProblem(**(arguments | changes))


class TestContactNodes:
    @pytest.mark.parametrize(("problem", "mesh", "measure"), [
        (plane_problem(), PLATE, 2.0), (solid_problem(), BLOCK, 2.0)])
    def test_flat_boundary(self, problem, mesh, measure):
        nodes = contact_data(problem, mesh)[0]
        np.testing.assert_array_equal(nodes.nodes, mesh.boundary_nodes("bottom"))
        np.testing.assert_allclose(nodes.normals, np.tile([0.0] * (mesh.dim - 1) + [-1.0], (len(nodes), 1)))
        assert nodes.weights.sum() == pytest.approx(measure)
        assert nodes.weights @ mesh.points[nodes.nodes, 0] == pytest.approx(measure)
        assert not nodes.gaps.any() and nodes.names == ("bottom",) and not nodes.boundary.any()

    @pytest.mark.parametrize("rings", [2, 8])
    def test_curved_boundary(self, rings):
        mesh, n = disk(rings), 6 * rings
        nodes = contact_data(plane_problem(contact=am.Contact("all", TOUCHING), loads=(), supports=()), mesh)[0]
        np.testing.assert_allclose(nodes.normals, mesh.points[nodes.nodes], atol=1e-12)
        assert nodes.weights.sum() == pytest.approx(2 * n * np.sin(np.pi / n))

    def test_gaps(self):
        # the plane through (0, -1) rising at 45 degrees is met along its own normal
        plane = am.Plane(point=(0.0, -3.0), normal=(-1.0, 1.0))
        nodes = contact_data(plane_problem(contact=am.Contact("bottom", plane), supports=()), PLATE)[0]
        np.testing.assert_allclose(nodes.normals, np.tile([[1.0, -1.0]], (5, 1)) / np.sqrt(2))
        np.testing.assert_allclose(nodes.gaps, (3.0 - PLATE.points[nodes.nodes, 0]) / np.sqrt(2))
        _, behind = am.Plane((0.0, -1.0), (0.0, 2.0)).contact(PLATE.points[:1] - [[0.0, 2.0]], nodes.normals[:1])
        assert behind.tolist() == [-1.0]
        # rounding is not an overlap
        for gap, interference, least in ((lambda x: np.full(len(x), -1e-14), False, 0.0),
                                         (lambda x: 0.5 - x[:, 0], True, -1.5)):
            contact = am.Contact("bottom", am.GapFunction(gap), allow_interference=interference)
            assert contact_data(plane_problem(contact=contact), PLATE)[0].gaps.min() == least

    @pytest.mark.parametrize("order", [("bottom", "right"), ("right", "bottom")])
    def test_common_node_belongs_to_the_boundary_named_first(self, order):
        contact = tuple(am.Contact(name, TOUCHING) for name in order)
        nodes = contact_data(plane_problem(contact=contact, loads=(), supports=()), PLATE)[0]
        assert nodes.names == order
        corner = np.flatnonzero((PLATE.points[nodes.nodes] == [2.0, 0.0]).all(axis=1))[0]
        assert nodes.boundary[corner] == 0
        expected = {"bottom": [0.0, -1.0], "right": [1.0, 0.0]}[order[0]]
        np.testing.assert_allclose(nodes.normals[corner], expected)
        # the edge round the corner does not face the obstacle: half an edge of the first boundary is the mass
        assert nodes.weights[corner] == pytest.approx(0.25 if order[0] == "bottom" else 0.125)

    def test_a_boundary_in_two_pieces_has_the_masses_of_one(self):
        centre = PLATE.points[PLATE.facets].mean(axis=1)
        labels = PLATE.facet_labels.copy()
        labels[(labels == 0) & (centre[:, 0] > 1)] = 4
        mesh = replace(PLATE, facet_labels=labels, boundaries=(*PLATE.boundaries, "bottom 2"), source=None)
        contact = (am.Contact("bottom 2", FLOOR), am.Contact("bottom", FLOOR))
        nodes = contact_data(plane_problem(contact=contact), mesh)[0]
        np.testing.assert_allclose(nodes.weights, contact_data(plane_problem(), PLATE)[0].weights)
        np.testing.assert_array_equal(nodes.boundary, [1, 1, 0, 0, 0])

    def test_symmetry_planes_take_the_tilt_out_of_the_normal(self):
        """A quarter of a ring with radii 1 (bottom) and 1/2, from x = 0 (left) on."""
        flat = structured(am.Rectangle(width=1.0, height=1.0), (8, 3))
        angle, radius = flat.points[:, 0] * np.pi / 2, 1 - flat.points[:, 1] / 2
        points = np.column_stack([radius * np.sin(angle), -radius * np.cos(angle)])
        points[flat.boundary_nodes("left"), 0] = 0.0
        mesh = replace(flat, points=points, source=None)
        nodes = contact_data(plane_problem(contact=am.Contact("bottom", TOUCHING), loads=()), mesh)[0]
        np.testing.assert_allclose(nodes.normals[:-1], mesh.points[nodes.nodes][:-1], atol=1e-12)


class Wrong:
    def contact(self, points, normals):
        return normals[:1], np.zeros(len(points))


# the same two nodes seen from both sides
CRACKED = MeshArrays(PLATE.points, PLATE.elements, np.vstack([PLATE.facets, [[0, 1], [1, 0]]]),
                     np.r_[PLATE.facet_labels, 4, 4], (*PLATE.boundaries, "crack"))
DEEP = am.GapFunction(lambda x: np.full(len(x), -0.1))


@pytest.mark.parametrize(("changes", "message"), [
    ({"contact": am.Contact("bottom", am.GapFunction(lambda x: 0.5 - x[:, 0]))},
     r"'bottom' lies up to 1\.5 m behind its obstacle, at \(2\.0, 0\.0\)"),
    ({"contact": (am.Contact("bottom", DEEP, allow_interference=True), am.Contact("top", DEEP)), "loads": (),
      "supports": ()},
     r"'top' lies up to 0\.1 m"),
    ({"supports": (am.Support("right", x=0.0), am.Support("left", y=0.0))},
     "support on 'left' fixes y, which has a part normal to contact boundary"),
    ({"supports": (am.Support("bottom", y=0.0),)}, "support on 'bottom' fixes y"),
    ({"contact": am.Contact("bottom", am.Plane(point=(0.0, -3.0), normal=(-1.0, 1.0)))}, "support on 'left' fixes x"),
    ({"contact": am.Contact("crack", TOUCHING), "loads": ()},
     "contact boundary 'crack': the surface has no normal at node 0"),
    ({"contact": am.Contact("bottom", Wrong())}, "obstacle in front of 'bottom' must return normals"),
])
def test_refusals(changes, message):
    with pytest.raises(ValueError, match=message):
        contact_data(plane_problem(**changes), CRACKED)


class TestDiscretise:
    def test_what_the_problem_becomes(self):
        problem = discretise(plane_problem(), PLATE)
        assert problem.name == "plate, 25 nodes" and problem.n_dofs == 50
        np.testing.assert_array_equal(problem.coordinates, PLATE.points)
        assert problem.near_nullspace.shape == (50, 3) and problem.fixed.sum() == 5
        assert problem.load.reshape(-1, 2).sum(axis=0) == pytest.approx([0.0, -2e5])
        displacement = np.arange(PLATE.points.size, dtype=float).reshape(-1, 2)
        contact = discretise(plane_problem(), PLATE, slip_reference=displacement).contact
        np.testing.assert_array_equal(contact.slip_reference, displacement[contact.nodes])
        with pytest.raises(ValueError, match=r"slip_reference must have shape \(\d+, 2\)"):
            contact_data(plane_problem(), PLATE, slip_reference=displacement[:3])
        # laws become nodal
        tresca = discretise(plane_problem(law=am.Tresca(lambda x: 1e3 * (1 + x[:, 0]))), PLATE)
        np.testing.assert_allclose(tresca.law.bounds(5)[0], 1e3 * tresca.contact.weights * [1.0, 1.5, 2.0, 2.5, 3.0])
        coulomb = discretise(plane_problem(law=am.Coulomb(lambda x: x[:, 0] / 4)), PLATE)
        np.testing.assert_allclose(coulomb.law.bounds(5)[1], [0.0, 0.125, 0.25, 0.375, 0.5])

    test_refuses = staticmethod(refused(
        (lambda: discretise(plane_problem(), BLOCK), "the mesh is 3D, the problem 'plate' 2D"),
        (lambda: discretise(PLATE, PLATE), TypeError, "problem must be a ContactProblem"),
        (lambda: discretise(plane_problem(), PLATE.source), TypeError, "mesh must be MeshArrays"),
        (lambda: discretise(plane_problem(), structured(SQUARE, 1)), "coarse: 2 contact nodes on bottom, at least 3"),
        (lambda: discretise(plane_problem(loads=(am.Pressure("roof", 1.0),)), PLATE), "'roof', used for a load, does")))


@pytest.mark.parametrize("law", [am.Coulomb(lambda p: 0.2 + p[:, 0]), am.Tresca(3e6)], ids=["Coulomb", "Tresca"])
def test_a_subclass_of_a_law_keeps_its_bounds(law):
    class Half(type(law)):
        def bounds(self, n_contact):
            limit, friction = super().bounds(n_contact)
            return 0.5 * limit, 0.5 * friction

    whole, half = (am.Hierarchy.uniform(am.cases.greco_bar(law=one), (2,)).finest.discrete.law.bounds(3)
                   for one in (law, Half(*vars(law).values())))
    assert max(map(np.max, whole)) > 0
    for one, other in zip(whole, half, strict=True):
        np.testing.assert_array_equal(0.5 * one, other)
