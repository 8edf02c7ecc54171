"""Contact boundaries with laws of their own."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EXACT
from refused import refused

import adaptmg as am

PRESSURE = 1e6
SMOOTH, ROUGH = am.Coulomb(0.1), am.Coulomb(0.4)


def stack(share):
    """Three plates under a pressure; the middle one is pushed with a share of what its two faces
    can bear."""
    parts = {
        name: am.Rectangle(width=1.0, height=0.2, origin=(0.0, 0.2 * k))
        for k, name in enumerate("abc")
    }
    return am.ContactProblem(
        domain=am.Assembly(parts=parts),
        material=am.PlaneStrain(young=2e11, poisson=0.3),
        law=am.Coulomb(0.9),
        contact=(
            am.ContactPair("b.bottom", "a.top", law=SMOOTH),
            am.ContactPair("c.bottom", "b.top", law=ROUGH),
        ),
        loads=(am.Pressure("c.top", PRESSURE), am.Pressure("b.left", share * 0.5 * PRESSURE / 0.2)),
        supports=(
            am.Support("a.bottom", x=0, y=0),
            am.Support("a.right", x=0),
            am.Support("c.right", x=0),
        ),
    )


def plates(share):
    return am.Hierarchy.uniform(
        stack(share), [{"a": (4 * n, n), "b": (5 * n, n), "c": (4 * n, n)} for n in (1, 2)]
    )


@pytest.mark.parametrize("method", [am.Multigrid(), am.FullMultigrid(), EXACT])
def test_each_interface_bears_what_its_own_law_says(method):
    result = am.solve(plates(0.98), method)
    assert result.resultant("b.bottom").force == pytest.approx(
        [-0.1 * PRESSURE, PRESSURE], rel=1e-6
    )
    assert result.resultant("c.bottom").force == pytest.approx(
        [0.39 * PRESSURE, PRESSURE], rel=1e-6
    )
    with pytest.raises(ValueError, match="nothing holds a translation along x of body 'b'"):
        am.solve(plates(1.02), method)


LAWS = (
    am.Tresca(lambda x: 1e4 * (1 + x[:, 0])),
    am.Frictionless(),
    am.Coulomb(lambda x: 0.1 + x[:, 1]),
)


def cornered(law, *own):
    """A block in a corner with two contact boundaries that share a node, and a third one."""
    planes = {"bottom": ((0, 0), (0, 1)), "left": ((0, 0), (1, 0)), "right": ((1.1, 0), (-1, 0))}
    return am.ContactProblem(
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        law=law,
        loads=(am.Pressure("top", 1e5),),
        contact=[
            am.Contact(name, am.Plane(*planes[name]), law=one)
            for name, one in zip(planes, own, strict=True)
        ],
    )


def test_laws_of_different_types_meet_at_common_nodes():
    mesh = am.mesh.structured(am.Rectangle(width=1.0, height=1.0), 4)
    mixed = am.discretise(cornered(am.Coulomb(7.0), *LAWS), mesh)
    alone = [am.discretise(cornered(law, None, None, None), mesh) for law in LAWS]
    for k, one in enumerate(alone):
        own = mixed.contact.boundary == k
        for values, expected in zip(
            mixed.law.bounds(len(own)), one.law.bounds(len(own)), strict=True
        ):
            np.testing.assert_array_equal(values[own], expected[own])
    corner = np.flatnonzero((mesh.points[mixed.contact.nodes] == 0).all(axis=1))
    assert mixed.contact.boundary[corner] == 0
    # what has no law of its own has the problem's
    part = am.discretise(cornered(LAWS[2], LAWS[0], LAWS[1], None), mesh)
    np.testing.assert_array_equal(part.law.bounds(len(own)), mixed.law.bounds(len(own)))


def test_a_hierarchy_with_other_laws_shares_its_matrices():
    grids = plates(0.5)
    slippery = replace(
        grids.problem,
        contact=tuple(
            replace(one, law=am.Coulomb(1e-3)) if one.law is SMOOTH else one
            for one in grids.problem.contact
        ),
    )
    other = grids.with_problem(slippery)
    assert other.finest.matrix is grids.finest.matrix
    result = am.solve(other, EXACT)
    assert result.resultant("b.bottom").force[0] == pytest.approx(-1e-3 * PRESSURE)
    assert result.resultant("c.bottom").force[0] == pytest.approx(0.249 * PRESSURE)


class Wearing:
    """Friction that varies, stored by ``at_nodes``, which returns the law itself."""

    def at_nodes(self, points, weights):
        self.friction = 0.2 + 10 * points[:, 0]
        return self

    def bounds(self, n_contact):
        return np.zeros(n_contact), self.friction


@pytest.mark.parametrize("name", [None, "bottom"], ids=["of the problem", "of a boundary"])
def test_a_law_may_return_itself_from_every_mesh(name):
    results = []
    for law in (Wearing(), am.Coulomb(lambda x: 0.2 + 10 * x[:, 0])):
        problem = am.cases.greco_bar(law=law)
        if name is not None:
            contact = replace(problem.contact[0], law=law)
            problem = replace(problem, contact=contact, law=am.Frictionless())
        results.append(am.solve(am.Hierarchy.uniform(problem, (4, 8, 16))).displacement)
    assert np.array_equal(*results)


test_refused = refused(
    (lambda: am.Contact("bottom", am.Plane((0, 0), (0, 1)), law=0.3), TypeError, "law must be"),
    (lambda: am.ContactPair("a", "b", law=am.Coulomb), TypeError, "law must be"),
)
