"""Peak pressure and dissipated energy as goals: their values, and their signed estimates."""

import math

import numpy as np
import pytest
from bodies import dragged_block

import adaptmg as am


def smoothed_peak(result: am.Result) -> float:
    weights = result.contact.weights
    pressure = result.contact.pressure
    return weights @ pressure**9 / (weights @ pressure**8)


@pytest.mark.parametrize(
    ("case", "quantity", "value_of"),
    [
        ("curved_obstacle", am.PeakPressure("contact"), smoothed_peak),
        ("greco_bar", am.Dissipation("contact"), lambda result: result.dissipation),
    ],
)
def test_goals_of_contact_are_estimated_with_their_sign(case, quantity, value_of):
    problem = am.cases.CASES[case].function()
    steps = list(am.adapt(problem, 8e-3, am.Goal(quantity), engine=am.Bisect(), max_nodes=2000))
    for step in steps:
        value = value_of(step.result)
        np.testing.assert_allclose(float(step.estimate.value), value, rtol=1e-9)
    exact = float(steps[-1].estimate.corrected[0])
    for step in steps[2:-1]:
        error = exact - float(step.estimate.value)
        assert 0.5 < float(step.estimate.signed) / error < 2
        assert abs(exact - float(step.estimate.corrected[0])) < abs(error)


def test_steady_sliding_on_a_narrower_master_dissipates_friction_times_distance():
    problem = dragged_block(dim=2, floor=True)
    path = am.LoadPath({"drag": [1.0, 3.0]}, default=1.0)
    goal = am.Goal(am.Dissipation())
    step = next(am.adapt(problem, None, goal, load_path=path, max_nodes=400))
    assert (step.result.contact.measures > step.result.contact.weights).any()
    assert float(step.estimate.value) == pytest.approx(0.3 * 4e5 * 2e-4, rel=1e-6)


def test_a_loop_goes_on_where_the_load_alone_gives_the_goal():
    problem = am.cases.hertz_cylinder()
    goal = am.Goal(am.PeakPressure("contact"))
    steps = list(am.adapt(problem, indicator=goal, max_nodes=4500))
    assert np.count_nonzero(steps[0].result.contact.closed) == 1
    # Hertz for 1 MN/m, R = 50 mm, E = 210 GPa, nu = .3: p = p0 (1 - x^2)^(1/2), whose mean of the
    # power 9 over that of the power 8 is G(11/2)^2 / (G(6) G(5)) p0
    peak = math.sqrt(1e6 * 2.1e11 / (2 * (1 - 0.3**2)) / (math.pi * 50e-3))
    smoothed = math.gamma(5.5) ** 2 / (math.gamma(6) * math.gamma(5)) * peak
    assert steps[-1].result.max_pressure == pytest.approx(peak, rel=0.01)
    assert float(steps[-1].estimate.value) == pytest.approx(smoothed, rel=0.003)


def test_goals_of_contact_name_what_they_refuse():
    for quantity in (am.PeakPressure("tongue.flank"), am.Dissipation("notch.flank")):
        problem = am.cases.dovetail()
        master = problem.contact[0].master
        with pytest.raises(ValueError, match="master of a pair"):
            next(iter(am.adapt(problem, None, am.Goal(type(quantity)(master)), max_nodes=2000)))
    with pytest.raises(ValueError, match="power must be"):
        am.PeakPressure("contact", power=0)
