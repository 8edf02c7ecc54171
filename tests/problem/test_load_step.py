"""Problems of single load steps, and supports that prescribe functions of position."""

import dataclasses
import pickle

import numpy as np
from made import square
from refused import refused

import adaptmg as am
from adaptmg.discrete import discretise, fixed_dofs
from adaptmg.discrete.discretise import load_steps
from adaptmg.discrete.loads import load_vector
from adaptmg.discrete.stress import StressData
from adaptmg.problem import step_problem


def bent(x):
    return 1e-3 * x[:, 1]**2


def loaded():
    return am.ContactProblem(
        material=am.PlaneStrain(young=2e11, poisson=0.3), law=am.Coulomb(0.3), domain=am.Rectangle(width=1, height=1),
        contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),
        loads=(am.Pressure("right", bent), am.Traction("right", (3.0, 4.0)), am.BodyForce((0.0, -9.0)),
               am.InitialStrain("body", (1e-4, bent)), am.BodyForce((1.0, 2.0), body="body")),
        supports=(am.Support("left", x=bent), am.Support("top", y=-2e-4)))


def test_steps_are_what_the_load_path_makes_of_the_problem():
    problem, mesh = loaded(), square(3, 1.0)
    factors = {"right": 0.5, "body force": 2.0, "body": -1.0, "left": 3.0, "top": 0.25}
    step, steps = step_problem(problem, factors), load_steps(problem, mesh, discretise(problem, mesh))
    np.testing.assert_allclose(load_vector(mesh, step.loads, step.material), steps.load(factors), rtol=1e-12,
                               atol=1e-12 * np.abs(steps.load(factors)).max())
    np.testing.assert_allclose(fixed_dofs(mesh, step.supports)[1], steps.fixed_values(factors), rtol=1e-14)
    # the strain of a body counts beside other loads of its name
    strain = StressData.of(mesh, step.material, step.loads).initial_strain
    np.testing.assert_allclose(steps.stress_data(factors).initial_strain, strain, rtol=1e-12)
    assert np.abs(strain).max() > 0
    again = pickle.loads(pickle.dumps(step))
    np.testing.assert_array_equal(fixed_dofs(mesh, again.supports)[1], fixed_dofs(mesh, step.supports)[1])
    same = step_problem(problem, {})
    assert same.loads == problem.loads and same.supports == problem.supports


test_refused = refused(
    (lambda: step_problem(loaded(), {"roof": 1.0}), r"factors name 'roof'.* known are 'right', 'body force'"),
    (lambda: step_problem(loaded(), {"top": np.nan}), r"factors\['top'\] must be finite"),
    (lambda: fixed_dofs(square(4, 1.0), (am.Support("left", x=bent), am.Support("top", x=2e-3))),
     r"prescribe different x displacements, 0.001 and 0.002 m"))


def test_supports_prescribe_functions_of_position_at_the_nodes():
    mesh = square(4, 1.0)
    fixed, values = (part.reshape(-1, 2) for part in fixed_dofs(mesh, loaded().supports))
    left = mesh.boundary_nodes("left")
    np.testing.assert_array_equal(values[left, 0], 1e-3 * mesh.points[left, 1]**2)
    assert fixed[left, 0].all() and fixed[:, 0].sum() == len(left)
    # where two meet they must agree, whether numbers or functions
    agreeing = (am.Support("left", x=bent), am.Support("top", x=lambda x: 1e-3 * x[:, 1]))
    assert fixed_dofs(mesh, agreeing)[0].sum() == 9


def test_a_solution_has_the_prescribed_function_in_every_step():
    problem = dataclasses.replace(loaded(), loads=(am.Pressure("right", 1e6),))
    grids = am.Hierarchy.uniform(problem, divisions=(4, 8))
    path = am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0], "top": [0.2, 1.0]}))
    nodes = grids.finest.mesh.boundary_nodes("left")
    y = grids.finest.mesh.points[nodes, 1]
    for result, factor in zip(path, (0.5, 1.0), strict=True):
        np.testing.assert_allclose(result.displacement[nodes, 0], factor * 1e-3 * y**2, rtol=1e-12, atol=1e-20)
