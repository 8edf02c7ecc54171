"""A pin in a bush with clearance: contact alone holds it, at few nodes, and three rigid motions are free until then."""

import numpy as np
import pytest

import adaptmg as am

RADIUS, CLEARANCE, HOLE, OUTER = 10e-3, 0.02e-3, 5e-3, 20e-3


def bush_mesh(size, square):
    """A hollow pin of 20 mm in a bush, four times finer at contact."""
    from netgen.occ import Circle, Compound, MoveTo, OCCGeometry
    from ngsolve import Mesh

    def disc(radius, name):
        face = Circle((0, 0), radius).Face()
        face.edges.name = name
        return face

    outside = disc(OUTER, "outer")
    if square:
        outside = MoveTo(-OUTER, -OUTER).Rectangle(2 * OUTER, 2 * OUTER).Face()
        outside.edges.name = "outer"
    parts = {"pin": disc(RADIUS, "surface") - disc(HOLE, "hole"), "bush": outside - disc(RADIUS + CLEARANCE, "bore")}
    for name, part in parts.items():
        part.faces.name = name
        for edge in part.edges:
            if edge.name in ("surface", "bore"):
                edge.maxh = size / 4
    return Mesh(OCCGeometry(Compound(list(parts.values())), dim=2).GenerateMesh(maxh=size, grading=0.3))


def grids(friction, load, square=False):
    loads = {"shaft": (am.Traction("hole", (0.0, lambda x: np.minimum(0.0, x[:, 1]) / HOLE * 1e7)),),
             "torque": (am.BodyForce((0.0, -1e10), body="pin"),
                        am.Traction("hole", (lambda x: -2e6 * x[:, 1] / HOLE, lambda x: 2e6 * x[:, 0] / HOLE)))}
    problem = am.ContactProblem(material=am.PlaneStrain(young=2.1e11, poisson=0.3), law=am.Coulomb(friction),
                                contact=am.ContactPair("surface", "bore"), loads=loads[load],
                                supports=am.Support("outer", x=0.0, y=0.0))
    return am.Hierarchy.from_meshes(problem, [bush_mesh(size, square) for size in (4e-3, 2e-3)])


@pytest.mark.parametrize(("friction", "load", "square"), [(0.3, "torque", False), (0.6, "shaft", True)])
def test_the_default_and_the_active_set_find_a_pin_that_contact_alone_holds(friction, load, square):
    bush = grids(friction, load, square)
    discrete = bush.finest.discrete
    for solver, rtol in ((None, 1e-8), (am.ActiveSet(), 1e-10)):
        result = am.solve(bush, solver)
        assert result.certificate(discrete, bound=True).energy_error <= 3 * rtol
        assert (result.contact.state != am.OPEN).sum() > 2
        # friction and pressure of the bush carry what acts on the pin
        force = discrete.coupling.physical_forces(discrete.load).reshape(-1, 2).sum(axis=0)
        np.testing.assert_allclose(result.resultant("contact").force, -force, atol=1e-6 * np.linalg.norm(force))
