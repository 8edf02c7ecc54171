"""The loop over iterations, what ends it, and corrections with cycles of their own."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import adaptmg as am
from adaptmg.solver.examine import Sizes
from adaptmg.solver.iterate import StopTest, iterate
from adaptmg.solver.record import Run


@pytest.fixture(scope="module")
def grids():
    return am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8))


class Halving:
    """Residuals and changes that fall by ``factor``; gives up after ``gives_up`` cycles."""

    def __init__(self, factor=0.5, gives_up=None):
        self.factor, self.gives_up, self.cycles, self.done = factor, gives_up, 0, []

    def start(self):
        self.done.append("start")

    def measure(self, stop):
        self.done.append("measure")
        if self.cycles:
            stop.changes.append(self.factor**self.cycles)
        stop.size = 1.0
        stop.take_residual(self.factor**self.cycles, 1.0, floor=0.0)

    def row(self, stop):
        return stop.measures()

    def step(self, stop):
        self.done.append("step")
        self.cycles += 1
        return am.Status.CYCLING if self.cycles == self.gives_up else None


def stop_test(grids, rtol=1e-3, limit=100):
    return StopTest(rtol, limit, Sizes(grids.finest.discrete))


def test_error_and_residual_end_it(grids):
    method, stop, run = Halving(), stop_test(grids), Run(unit=1)
    assert iterate(method, stop, run) is am.Status.CONVERGED
    # with a rate of a half the error that remains is the last change
    assert method.cycles == 10 and stop.error_estimate == pytest.approx(0.5**10) and stop.rate == pytest.approx(0.5)
    assert method.done == ["start", *["measure", "step"] * 10, "measure"]
    assert [row["cycle"] for row in run.history] == list(range(11))


@pytest.mark.parametrize(("method", "limit", "status", "cycles"), [
    (Halving(), 4, am.Status.LIMIT, 4), (Halving(gives_up=3), 100, am.Status.CYCLING, 3),
    (Halving(1.0), 1000, am.Status.STALLED, StopTest.PATIENCE + 1), (Halving(100.0), 100, am.Status.DIVERGED, 7),
    (Halving(np.nan), 100, am.Status.DIVERGED, 1)])
def test_what_else_ends_it(grids, method, limit, status, cycles):
    assert iterate(method, stop_test(grids, limit=limit)) is status
    assert method.cycles == cycles


@pytest.mark.parametrize(("last", "status"), [(0.0, am.Status.CONVERGED), (2.0, am.Status.LIMIT)])
def test_at_the_limit_the_certificate_decides_whatever_the_estimate(grids, last, status):
    """After a refusal the test asks for more than rtol, and the cycles may end before."""
    stop, found = stop_test(grids, limit=11), [3.0, last]
    stop.shortfall = lambda: found.pop(0)
    assert iterate(Halving(), stop) is status and not found


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
