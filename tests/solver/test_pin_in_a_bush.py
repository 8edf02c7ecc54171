"""A pin in a bush with clearance: contact alone holds it, at few nodes, and three rigid motions are free until then."""

import numpy as np
import pytest

import adaptmg as am

RADIUS, CLEARANCE, HOLE, OUTER = 10e-3, 0.02e-3, 5e-3, 20e-3
LOADS = {"shaft": (am.Traction("pin.hole", (0.0, lambda x: np.minimum(0.0, x[:, 1]) / HOLE * 1e7)),),
         "torque": (am.BodyForce((0.0, -1e10), body="pin"),
                    am.Traction("pin.hole", (lambda x: -2e6 * x[:, 1] / HOLE, lambda x: 2e6 * x[:, 0] / HOLE)))}


def ring(outer, outside, inner, inside):
    return am.Cut(am.Circle((0.0, 0.0), outer, outside), am.Circle((0.0, 0.0), inner, inside))


@pytest.mark.parametrize(("friction", "load"), [(0.3, "torque"), (0.6, "shaft")])
def test_the_default_and_the_active_set_find_a_pin_that_contact_alone_holds(friction, load):
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=2.1e11, poisson=0.3), law=am.Coulomb(friction), loads=LOADS[load],
        domain=am.Assembly(parts={"pin": ring(RADIUS, "surface", HOLE, "hole"),
                                  "bush": ring(OUTER, "outer", RADIUS + CLEARANCE, "bore")}),
        contact=am.ContactPair("pin.surface", "bush.bore"), supports=am.Support("bush.outer", x=0.0, y=0.0))
    grids = am.Hierarchy.graded(problem, (4e-3, 2e-3), contact_ratio=4)
    discrete = grids.finest.discrete
    for solver, rtol in ((None, 1e-8), (am.ActiveSet(), 1e-10)):
        result = am.solve(grids, solver)
        assert result.certificate(discrete, bound=True).energy_error <= 3 * rtol
        assert (result.contact.state != am.OPEN).sum() > 2
        # friction and pressure of the bush carry what acts on the pin
        force = discrete.coupling.physical_forces(discrete.load).reshape(-1, 2).sum(axis=0)
        np.testing.assert_allclose(result.resultant("contact").force, -force, atol=1e-6 * np.linalg.norm(force))
