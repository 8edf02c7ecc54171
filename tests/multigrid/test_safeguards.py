"""No wrong answer in silence: bodies held by contact alone, solvers that are mistaken, coarse grids that are large."""

from dataclasses import replace

import numpy as np
import pytest

import adaptmg as am
from adaptmg.multigrid.linear_cycle import CoarseFactors
from adaptmg.multigrid.rigid_motions import RigidMotions
from adaptmg.solver import truncated as fallback
from adaptmg.solver.truncated import Fallback, TruncatedIteration


def floating():
    """The bar with no support at all, pressed down and pushed sideways."""
    bar = am.cases.greco_bar()
    return replace(bar, supports=(), law=am.Coulomb(0.3), reference={},
                   loads=(am.Pressure("top", 5e7), am.Pressure("left", 3e7), am.Pressure("right", 2.5e7)))


GRIDS = {"nested": lambda: am.Hierarchy.uniform(floating(), divisions=(4, 8, 16)),
         "independent": lambda: am.Hierarchy.graded(floating(), sizes=(10e-3, 5e-3, 2.5e-3), contact_ratio=2)}
SOLVERS = {"nested start": am.FullMultigrid(), "cold": am.Multigrid(),
           "monotone": am.FullMultigrid(correction=am.Monotone()), "single": am.SingleGrid(omega=1.8)}


@pytest.mark.parametrize(("grids", "solver"), [*(("nested", solver) for solver in SOLVERS),
                                               ("independent", "nested start")])
def test_a_body_held_by_contact_alone(grids, solver):
    hierarchy = GRIDS[grids]()
    exact = am.solve(hierarchy, am.ActiveSet(rtol=1e-12))
    result = am.solve(hierarchy, SOLVERS[solver])
    difference = np.abs(result.displacement - exact.displacement).max()
    assert difference < 1e-5 * np.abs(exact.displacement).max()
    assert result.residual < 1e-7


def nearly_sliding(dim, law, held):
    """No support at all, and sideways so much that nearly all nodes slip: ``held`` of what friction can take."""
    pressure, area = (5e7, 1.0)
    push = held * (law.friction * pressure if isinstance(law, am.Coulomb) else law.limit * area)
    case = am.cases.greco_bar() if dim == 2 else am.cases.greco_block()
    return replace(case, supports=(), law=law, reference={},
                   loads=(am.Pressure("top", pressure), am.Pressure("left", 1.5e8 + push), am.Pressure("right", 1.5e8)))


SLIDES = [(2, am.Coulomb(0.3), 0.99, (4, 8, 16, 32)), (2, am.Tresca(2e7), 0.98, (4, 8, 16, 32)),
          (3, am.Coulomb(0.3), 0.95, (2, 4, 8))]


@pytest.mark.parametrize("solver", [am.FullMultigrid(), am.Multigrid()])
@pytest.mark.parametrize(("dim", "law", "held", "divisions"), SLIDES)
def test_a_body_that_nearly_slides_takes_no_more_cycles_than_others(dim, law, held, divisions, solver):
    hierarchy = am.Hierarchy.uniform(nearly_sliding(dim, law, held), divisions=divisions)
    exact = am.solve(hierarchy, am.ActiveSet(rtol=1e-12))
    result = am.solve(hierarchy, solver, reference=exact)
    assert result.cycles <= 30 and not result.fallback
    assert result.history["true_error"][-1] < 1e-7


@pytest.fixture
def without_motions(monkeypatch):
    monkeypatch.setattr(RigidMotions, "of", classmethod(lambda cls, problem, obstacle, load: None))


GRIDS_THAT_FAIL = {"nested": lambda: am.Hierarchy.uniform(nearly_sliding(2, am.Tresca(2e7), 0.98), (4, 8, 16, 32))}
GRIDS_THAT_FAIL["only spaces"] = lambda: am.Hierarchy.algebraic(GRIDS_THAT_FAIL["nested"]().finest.discrete)


@pytest.mark.usefixtures("without_motions")
@pytest.mark.parametrize("grids", GRIDS_THAT_FAIL)
def test_the_active_set_method_takes_over(grids):
    hierarchy = GRIDS_THAT_FAIL[grids]()
    result = am.solve(hierarchy, am.Multigrid())
    assert "ActiveSet from cycle" in result.fallback
    assert np.isnan(result.rate)  # of Newton steps it would be that of no cycle
    assert result.history["cycle"][-1] == result.cycles
    exact = am.solve(hierarchy, am.ActiveSet(rtol=1e-12)).displacement
    assert np.abs(result.displacement - exact).max() < 1e-8 * np.abs(exact).max()


@pytest.mark.usefixtures("without_motions")
@pytest.mark.parametrize("reason", ["too large", "gives up"])
def test_the_monotone_correction_takes_over_from_what_cannot(reason, monkeypatch):
    if reason == "too large":
        monkeypatch.setattr(Fallback, "FACTORISED", {2: 0, 3: 0})
    else:
        def singular(self, hierarchy, run, start):
            raise np.linalg.LinAlgError("singular")
        monkeypatch.setattr(fallback.ActiveSet, "run", singular)
    result = am.solve(GRIDS_THAT_FAIL["nested"](), am.Multigrid(), throw=False)
    assert "Monotone from cycle" in result.fallback
    # slow, but on its way, and not in silence
    assert result.residual < 1e-2 and result.status.ok == (result.residual <= 1e-7)
    if reason == "gives up":
        # an error of one method is no error of the run
        monkeypatch.setattr(fallback.ProjectedRun, "finish",
                            lambda self, unknowns: singular(self, None, None, None))
        nothing = am.solve(GRIDS_THAT_FAIL["nested"](), am.Multigrid(), throw=False)
        assert not nothing.status.ok and not nothing.fallback
        spaces = am.solve(GRIDS_THAT_FAIL["only spaces"](), am.Multigrid(), throw=False)
        assert not spaces.status.ok and not spaces.fallback


def test_nothing_takes_over_where_arithmetic_ends():
    hierarchy = am.Hierarchy.uniform(am.cases.greco_bar(), (4, 8, 16, 32))
    result = am.solve(hierarchy, am.FullMultigrid(rtol=1e-17), throw=False)
    assert result.status is am.Status.STALLED and not result.fallback
    assert result.residual < 1e-11


def test_a_large_coarsest_grid_is_factorised_sparse():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(30, 60))
    assert 2 * grids[0].discrete.n_nodes > CoarseFactors.DENSE
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12))
    result = am.solve(grids, am.FullMultigrid(rtol=1e-9), reference=exact)
    assert result.history["true_error"][-1] < 1e-9


def test_a_start_that_ran_away_sets_no_tolerance():
    problem = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4,)).finest.discrete
    watch = TruncatedIteration(None, problem, "discretisation", 100)
    watch.size = 1.0
    for change in (1e-2, 1e3):
        watch.take_discretisation_error(change)
        assert watch.rtol == pytest.approx(min(0.1 * change / np.sqrt(3), 1e-2))


@pytest.mark.parametrize(("rate", "slow"), [(0.5, False), (0.97, True)])
def test_one_uneven_ratio_hands_nothing_over(rate, slow):
    problem = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4,)).finest.discrete
    watch = TruncatedIteration(None, problem, 1e-8, 100)
    watch.size, watch.residual = 1.0, 1e-5
    watch.changes = [rate**k for k in range(30)]
    watch.changes.append(1.1 * watch.changes[-1])
    assert watch._too_slow(70) is slow


@pytest.mark.parametrize(("pull", "ratio", "finest"), [(-2e7, 25, 12), (5e7, 100, 16)])
def test_a_stiff_slave_on_a_soft_master_is_handed_over(pull, ratio, finest):
    """Little friction: left alone, cycles from zero take 39, in the last case more than 100."""
    parts = {"upper": am.Rectangle(width=40e-3, height=40e-3),
             "lower": am.Rectangle(width=60e-3, height=30e-3, origin=(-8e-3, -30e-3))}
    young = {"upper": 1e11, "lower": 1e11 / ratio}
    problem = am.ContactProblem(
        domain=am.Assembly(parts=parts), contact=am.ContactPair("upper.bottom", "lower.top"), law=am.Coulomb(0.05),
        material={name: am.PlaneStrain(young=value, poisson=0.3) for name, value in young.items()},
        loads=(am.Pressure("upper.top", 5e7), am.Pressure("upper.left", pull)),
        supports=(am.Support("upper.right", x=0.0), am.Support("lower.bottom", x=0.0, y=0.0)))
    grids = am.Hierarchy.uniform(problem, [{"upper": k, "lower": (3 * k // 2 + 1, 3 * k // 4)} for k in (4, 8, finest)])
    exact = am.solve(grids, am.ActiveSet(rtol=1e-12))
    for solver in (am.FullMultigrid(), am.Multigrid()):
        result = am.solve(grids, solver)
        assert result.cycles < 45
        assert np.abs(result.displacement - exact.displacement).max() <= 1e-6 * np.abs(exact.displacement).max()
