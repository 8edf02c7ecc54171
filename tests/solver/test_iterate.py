"""The loop over iterations, what ends it, and corrections with cycles of their own."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import adaptmg as am
from adaptmg.solver.iterate import State, StopTest, iterate
from adaptmg.solver.record import Run


@pytest.fixture(scope="module")
def grids():
    return am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8))


class Halving:
    """Residuals and changes that fall by ``factor``; gives up after ``gives_up`` cycles."""

    def __init__(self, factor=0.5, gives_up=None):
        self.factor, self.gives_up, self.cycles = factor, gives_up, -1

    def step(self):
        self.cycles += 1
        if self.cycles == self.gives_up:
            return am.Status.CYCLING
        size = self.factor**self.cycles
        return State(self.cycles, size, forces=1.0, size=1.0, change=size if self.cycles else None)


def test_error_and_residual_end_it():
    method, stop, run = Halving(), StopTest(1e-3, 100), Run(unit=1)
    assert iterate(method, stop, run) is am.Status.CONVERGED
    # with a rate of a half the error that remains is the last change
    assert method.cycles == 10 and stop.error_estimate == pytest.approx(0.5**10) and stop.rate == pytest.approx(0.5)
    assert [row["cycle"] for row in run.history] == list(range(11))


@pytest.mark.parametrize(("method", "limit", "status", "cycles"), [
    (Halving(), 4, am.Status.LIMIT, 4), (Halving(gives_up=3), 100, am.Status.CYCLING, 3),
    (Halving(1.0), 1000, am.Status.STALLED, StopTest.PATIENCE + 1), (Halving(100.0), 100, am.Status.DIVERGED, 7),
    (Halving(np.nan), 100, am.Status.DIVERGED, 1)])
def test_what_else_ends_it(method, limit, status, cycles):
    assert iterate(method, StopTest(1e-3, limit)) is status
    assert method.cycles == cycles


@pytest.mark.parametrize(("last", "status"), [(0.0, am.Status.CONVERGED), (2.0, am.Status.LIMIT)])
def test_at_the_limit_the_certificate_decides_whatever_the_estimate(last, status):
    """After a refusal the test asks for more than rtol, and the cycles may end before."""
    answers = [3.0, last]
    assert iterate(Halving(), StopTest(1e-3, 11, lambda rtol: answers.pop(0))) is status and not answers


@dataclass
class ActiveSetInDisguise:
    """A correction with cycles of its own."""

    def method(self, options, hierarchy, run):
        self.options, self.hierarchy, self.given = options, hierarchy, run
        return self

    def from_given(self, start):
        return am.ActiveSet(rtol=self.options.rtol).run(self.hierarchy, self.given, start)

    def from_nested(self, start):
        assert isinstance(start, am.NestedStart)
        return replace(self.from_given(None), cycles=1)


def test_a_correction_may_bring_cycles_of_its_own(grids):
    correction = ActiveSetInDisguise()
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12)).displacement
    for solver in (am.Multigrid(correction=correction), am.FullMultigrid(correction=correction)):
        result = am.solve(grids, solver)
        assert np.abs(result.displacement - exact).max() < 1e-10 * np.abs(exact).max()
    assert result.cycles == 1
    # load steps start it again
    path, expected = (am.solve_path(grids, am.LoadPath(default=[0.5, 1.0]), solver)[-1].displacement
                      for solver in (am.FullMultigrid(correction=correction), am.ActiveSet(rtol=1e-12)))
    assert np.allclose(path, expected, rtol=1e-8, atol=1e-15)
    wrong = SimpleNamespace(method=lambda options, hierarchy, run: 5)
    with pytest.raises(TypeError, match="from_given"):
        am.solve(grids, am.Multigrid(correction=wrong))
