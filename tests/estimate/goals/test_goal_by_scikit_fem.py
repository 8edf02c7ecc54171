"""Signed goal estimates against scikit-fem: P2 is P1 and its edge bubbles, so matrices and residuals are its own."""

import numpy as np
import pytest

import adaptmg as am

skfem = pytest.importorskip("skfem")

from skfem.helpers import ddot, dot, eye, sym_grad, trace  # noqa: E402

YOUNG, POISSON, FRICTION = 1e9, 0.3, 0.3


def problem(law, drift=0.0):
    """A block on the floor, its sides held sideways, or moved by so much."""
    return am.ContactProblem(
        material=am.PlaneStrain(young=YOUNG, poisson=POISSON), domain=am.Rectangle(width=1.0, height=1.0), law=law,
        contact=am.Contact("bottom", am.Plane(point=(0.0, 0.0), normal=(0.0, 1.0))),
        loads=(am.Pressure("top", lambda x: 1e6 * (1 + 0.5 * np.cos(np.pi * x[:, 0]))), am.BodyForce((2e5, -1e5))),
        supports=(am.Support("left", x=drift), am.Support("right", x=drift)))


class Quadratic:
    """Stiffness and load of P2 on a mesh of ours, in blocks of nodes (1) and edges (b)."""

    def __init__(self, mesh):
        self.mesh, element = mesh, skfem.ElementVector(skfem.ElementTriP2())
        theirs = skfem.MeshTri(mesh.points.T.copy(), mesh.elements.T.astype(np.int64))
        basis = skfem.Basis(theirs, element, intorder=6)
        lame, shear = YOUNG * POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), YOUNG / (2 * (1 + POISSON))

        @skfem.BilinearForm
        def work(u, v, w):
            e = sym_grad(u)
            return ddot(lame * eye(trace(e), 2) + 2 * shear * e, sym_grad(v))

        @skfem.LinearForm
        def weight(v, w):
            return 2e5 * v[0] - 1e5 * v[1]

        @skfem.LinearForm
        def pressure(v, w):
            return -1e6 * (1 + 0.5 * np.cos(np.pi * w.x[0])) * dot(v, np.stack([0 * w.x[0], 1 + 0 * w.x[0]]))

        top = theirs.facets_satisfying(lambda x: np.isclose(x[1], 1.0), boundaries_only=True)
        matrix = work.assemble(basis).toarray()
        load = weight.assemble(basis) + pressure.assemble(skfem.FacetBasis(theirs, element, facets=top, intorder=8))
        nodes, edges = basis.nodal_dofs.T.reshape(-1), basis.facet_dofs.T.reshape(-1)
        self.ends = np.sort(theirs.facets.T, axis=1)
        # a P2 function is its P1 part and bubbles: with hats in place of P2's nodal functions
        lift = np.eye(len(load))
        for node in theirs.facets:
            lift[basis.facet_dofs, basis.nodal_dofs[:, node]] = 0.5
        matrix, load = lift.T @ matrix @ lift, lift.T @ load
        self.a11, self.ab1, self.abb = (matrix[np.ix_(*at)] for at in ((nodes, nodes), (edges, nodes), (edges, edges)))
        self.load1, self.loadb = load[nodes], load[edges]

    def functional(self, item):
        """A linear functional of nodes and edges."""
        one, b, points = np.zeros(len(self.load1)), np.zeros(len(self.loadb)), self.mesh.points
        if isinstance(item, am.Displacement):
            k, x = "xyz".index(item.component), np.array(item.points[0])
            for corners in self.mesh.elements:
                inner = np.linalg.solve((points[corners[1:]] - points[corners[0]]).T, x - points[corners[0]])
                shape = np.array([1 - inner.sum(), *inner])
                if shape.min() > -1e-12:
                    one[2 * corners + k] = shape
                    for i, j in ((0, 1), (1, 2), (2, 0)):
                        b[2 * self.edge(corners[i], corners[j]) + k] = 4 * shape[i] * shape[j]
                    return one, b
        if isinstance(item, am.MeanDisplacement):
            k = "xyz".index(item.component)
            for i, j in self.mesh.boundary_facets(item.boundary):
                length = np.linalg.norm(points[i] - points[j])
                one[2 * np.array([i, j]) + k] += 0.5 * length
                b[2 * self.edge(i, j) + k] += 2 / 3 * length
            return one, b
        # the tangential force along x of all contact nodes that no support holds
        d = np.zeros(len(self.load1))
        nodes = self.mesh.boundary_nodes("bottom")
        d[2 * nodes[(points[nodes, 0] > 1e-9) & (points[nodes, 0] < 1 - 1e-9)]] = 1.0
        return self.a11 @ d, self.ab1 @ d

    def edge(self, a, b):
        return int(np.flatnonzero((self.ends == sorted((a, b))).all(axis=1))[0])


def spaces(this, state):
    """Trial and test vectors of nodes and of edges, by columns: at the floor as the state says."""
    points, made = this.mesh.points, []
    for places in (points, points[this.ends].mean(axis=1)):
        trial, test = [], []
        for i, (x, y) in enumerate(places):
            floor, side = y < 1e-9, x < 1e-9 or x > 1 - 1e-9
            for c in range(2):
                if (c == 0 and side) or (floor and (c == 1 or state == "stick")):
                    continue
                for space in (trial, test):
                    space.append(np.eye(1, 2 * len(places), 2 * i + c)[0])
                if floor and state == "slip":
                    # friction pushes against the drift: f = -e_x, and n = -e_y
                    test[-1][2 * i + 1] = FRICTION
        made += [np.array(trial).T, np.array(test).T]
    return made


CASES = {"stick": (am.Tresca(1e12), 0.0), "frictionless": (am.Frictionless(), 0.0),
         "slip": (am.Coulomb(FRICTION), 1e-2)}
ITEMS = (am.Displacement((0.31, 0.63), "y"), am.MeanDisplacement("top", "y"), am.ContactForce("bottom", "x"))


@pytest.mark.parametrize("state", CASES)
def test_signed_estimates_are_those_of_the_bubbles_in_p2(state):
    law, drift = CASES[state]
    hierarchy = am.Hierarchy.graded(problem(law, drift), (0.25,))
    result = am.solve(hierarchy, am.ActiveSet(rtol=1e-12))
    found = {"stick": am.STICK, "frictionless": am.SLIP, "slip": am.SLIP}[state]
    assert (result.contact.state[(result.contact.x[:, 0] > 1e-9) & (result.contact.x[:, 0] < 1 - 1e-9)] == found).all()
    this, u = Quadratic(result.mesh), result.displacement.reshape(-1)
    trial, test, trial_b, test_b = spaces(this, state)
    residual = this.loadb - this.ab1 @ u
    bubbles = trial_b @ np.linalg.solve(test_b.T @ this.abb @ trial_b, test_b.T @ residual)
    for item in ITEMS:
        if state == "frictionless" and isinstance(item, am.ContactForce):
            continue
        one, b = this.functional(item)
        dual = test @ np.linalg.solve(trial.T @ this.a11 @ test, trial.T @ one)
        wanted = float(b @ bubbles - (this.ab1 @ dual) @ bubbles)
        estimate = am.Goal(item).indicate(hierarchy, result)
        # the package stops at a hundredth of the bubbles' residual
        assert estimate.signed == pytest.approx(wanted, rel=2e-2), item
