"""am.adapt: steps are solved as exactly as meshes deserve, limits end it with a reason, parts may be user-defined."""

import itertools
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from adaptive_loop import Constant, upset

import adaptmg as am
from adaptmg.estimate import loop as solving
from adaptmg.estimate.loop import posed_at
from adaptmg.estimate.step import Limits
from adaptmg.mesh import structured

BISECT = am.Bisect()
COARSE = 8e-3


def loop(problem=None, start=COARSE, indicator=None, engine=BISECT, **options):
    return list(am.adapt(upset() if problem is None else problem, start, indicator, engine=engine, **options))


@cache
def steps(case: str) -> list[am.Step]:
    if case == "punch":
        problem = am.cases.flat_punch()
        return loop(problem, am.Hierarchy.graded(problem, (80e-3,), 16), max_nodes=2500)
    return loop(upset(), max_nodes=1500) if case == "upset" else loop(am.cases.dovetail(), max_nodes=800)


@pytest.mark.parametrize(("case", "cycles"), [("upset", 1.25), ("pair", 4), ("punch", 99)])
def test_each_step_is_as_exact_as_a_tenth_of_its_estimate_in_few_cycles(case, cycles):
    for step in steps(case)[1:]:
        discrete = step.hierarchy.finest.discrete
        exact = am.solve(step.hierarchy, am.ActiveSet(rtol=1e-12)).displacement
        error = discrete.relative(step.result.displacement - exact).reshape(-1)
        assert float(np.sqrt(error @ (discrete.matrix @ error))) <= 0.1 * step.estimate.total
    # on tiny meshes a second one costs less than to measure the rate
    assert case != "upset" or all(step.result.cycles <= (2 if step.number < 4 else 1) for step in steps(case)[1:])
    assert np.mean([step.result.cycles for step in steps(case)[2:]]) <= cycles


def remote(gap: float, slide: float) -> am.ContactProblem:
    """A body on one foot, a second one above the plane, its top moved down and perhaps along the plane."""
    corners = [(0, 0), (20, 0), (20, 20), (40, 20), (40, gap), (60, gap), (60, 40), (0, 40)]
    names = ("foot", "inside", "arch", "inside2", "foot2", "side", "top", "left")
    plane = am.Plane((0.0, 0.0), (0.0, 1.0))
    return am.ContactProblem(
        domain=am.Polygon(vertices=[(1e-3 * x, 1e-3 * y) for x, y in corners], boundaries=names),
        material=am.PlaneStrain(young=2e11, poisson=0.3), law=am.Coulomb(0.3),
        contact=(am.Contact("foot", plane), am.Contact("foot2", plane)),
        supports=(am.Support("top", x=slide, y=-2e-6),))


@pytest.mark.parametrize(("gap", "slide"), [(10, 0.0), (0, 1e-3)], ids=["far gap", "far slip"])
def test_the_estimate_is_that_of_the_discrete_solution_however_far_bodies_are_or_slide(gap, slide):
    found = loop(remote(gap, slide), max_nodes=900)
    assert "max_nodes" in found[-1].outcome and len(found) < 10
    for step in found:
        exact = am.solve(step.hierarchy, am.ActiveSet(rtol=1e-9))
        assert step.estimate.total == pytest.approx(am.Residual().indicate(step.hierarchy, exact).total, rel=0.05)


def test_meshes_grow_the_estimate_falls_and_the_tolerance_is_a_tenth_of_what_is_expected():
    found = steps("upset")
    for number, (before, step) in enumerate(itertools.pairwise(found), start=1):
        assert step.number == number and before.nodes < step.nodes <= 1500
        expected = before.estimate.relative * (before.nodes / step.nodes) ** 0.5
        assert step.result.rtol == pytest.approx(min(0.1 * expected, 3e-2), rel=5e-3)
        # a few elements at a singularity gain more than their number
        assert expected == pytest.approx(step.estimate.relative, rel=0.3 if step.number > 2 else 0.5)
    assert found[-1].estimate.relative < 0.3 * found[0].estimate.relative
    assert [bool(step.outcome) for step in found] == [False] * (len(found) - 1) + [True]
    assert "max_nodes" in found[-1].outcome and found[-1].outcome in repr(found[-1])
    matrices = [step.hierarchy.finest.matrix.nnz for step in found]
    total = sum(step.work_units * nonzeros for step, nonzeros in zip(found, matrices, strict=True))
    assert found[-1].total_work_units == pytest.approx(total / matrices[-1])
    alone = am.solve(found[-1].hierarchy, am.FullMultigrid(rtol="discretisation"))
    assert found[-1].total_work_units <= 1.3 * alone.work_units
    assert found[-1].total_seconds == pytest.approx(sum(step.seconds for step in found))
    assert {"solve", "estimate"} <= set(found[-1].timings) and all(s >= 0 for s in found[-1].timings.values())


def test_levels_that_are_close_are_dropped_and_progress_is_reported():
    rows = []
    found = loop(mark=am.Doerfler(0.2), max_nodes=400, progress=rows.append)
    last = found[-1].hierarchy
    assert len(last) < len(found) and last.operator_complexity < 2.6
    assert all(am.transfer.size_ratio(a.mesh, b.mesh) <= 4.0 + 1e-9 for a, b in itertools.pairwise(last.levels))
    assert {row["phase"] for row in rows} == {"mesh", "assembly", "solve", "estimate", "done"}
    assert all(row.keys() == rows[0].keys() for row in rows)
    assert rows[-1]["seconds"] > 0 and np.isfinite(rows[-1]["expected_seconds"])


def test_limits_end_the_loop():
    found = loop(tolerance=0.06)
    assert found[-1].estimate.relative <= 0.06 < found[-2].estimate.relative
    assert "tolerance" in found[-1].outcome
    found = loop(max_seconds=1e-6)
    assert len(found) == 1 and "max_seconds" in found[0].outcome


def test_a_signed_estimate_that_is_far_off_is_not_settled():
    found = loop(am.cases.hertz_cylinder(), None, am.Goal(am.MeanDisplacement("upper.top", "y")), max_nodes=900)
    exact = float(found[-1].estimate.corrected[0])
    ratios = np.array([step.estimate.signed / (exact - step.estimate.value) for step in found[:-1]])
    is_settled = np.array([step.settled for step in found[:-1]])
    assert ((ratios < 0.4) | (ratios > 2.5)).any()
    assert ((ratios > 0.5) & (ratios < 2))[is_settled].all()
    assert not is_settled[0] and is_settled[-2:].all()
    assert ["?" in repr(step) for step in found[:-1]] == (~is_settled).tolist()


class Scripted:
    def __init__(self, *parts, square=lambda n: 1.0):
        self.parts, self.square = iter(parts), square

    def indicate(self, hierarchy, result):
        n = len(hierarchy.finest.mesh.elements)
        return am.Estimate(squares=np.full(n, self.square(n)), norm=1.0, **next(self.parts))


def test_a_tolerance_is_not_met_by_an_estimate_that_is_not_settled():
    early = Scripted(*({"value": value, "signed": signed, "energy_error": 1e-3} for value, signed in (
        (1.0, -1e-9), (1.001, 1e-2), (1.01, 1e-3), (1.011, 1e-4), (1.0111, 1e-5))))
    found = loop(indicator=early, tolerance=1e-3)
    assert [step.settled for step in found] == [False, False, True]
    assert found[-1].outcome.startswith("tolerance met")


@pytest.mark.parametrize("energy, ends", [(1e-9, False), (1e-16, True)])
def test_small_shares_of_a_quantity_are_not_rounding(energy, ends):
    small = Scripted(*[{"value": 1.0, "signed": 1e-3, "energy_error": energy}] * 9, square=lambda n: 1e-3)
    found = loop(indicator=small, max_nodes=60)
    assert ("rounding" in found[-1].outcome) == ends and (len(found) == 1) == ends


def test_estimates_that_grow_on_coarse_meshes_end_nothing_and_those_that_do_not_fall_end_the_loop():
    found = loop(indicator=Scripted(*[{}] * 20, square=lambda n: min(n, 800) ** 2 / n**1.5), max_nodes=1500)
    squares = [step.estimate.squares.sum() for step in found]
    assert squares[1] > squares[0] and "max_nodes" in found[-1].outcome
    found = loop(indicator=Constant(), max_nodes=100_000)
    assert "no progress" in found[-1].outcome and found[-1].nodes < 5000


@pytest.mark.parametrize("engine", [BISECT, am.Remesh()])
def test_the_limits_bind_the_first_mesh(engine, monkeypatch):
    problem = upset()
    mesh = structured(problem.domain, 9)
    with pytest.raises(ValueError, match=r"max_nodes must be at least 100, .* got 99; or take a coarser start"):
        am.adapt(problem, mesh, engine=engine, max_nodes=99)
    assert next(am.adapt(problem, mesh, engine=engine, max_nodes=100)).nodes == 100
    with pytest.raises(ValueError, match="max_nodes must be at least"):
        am.adapt(problem, COARSE, engine=engine, max_nodes=30)
    for module in ("mesh.grading.netgen_mesh", "estimate.bisect.structured"):
        monkeypatch.setattr(f"adaptmg.{module}", lambda *a, **o: pytest.fail("meshed"))
    for start in (1e-4, 1e-200):
        with pytest.raises(ValueError, match=r"start must be at least 0\.00096 m for max_nodes=2000, got"):
            am.adapt(problem, start, engine=engine, max_nodes=2000)
        with pytest.raises(ValueError, match=r"start must be at least .* for max_seconds=3, got"):
            am.adapt(problem, start, engine=engine, max_nodes=10**7, max_seconds=3)


@pytest.mark.parametrize(("case", "size", "engine"), [
    ("upset_block", 5e-3, BISECT), ("hertz_cylinder", 5.9e-3, am.Remesh()), ("bolted_junction", 6.9e-3, BISECT)])
def test_the_first_size_follows_the_domain(case, size, engine):
    problem = getattr(am.cases, case)()
    first = next(am.adapt(problem, engine=engine, max_nodes=400)).hierarchy
    assert 60 <= first.finest.n_nodes / len(problem.domain.bodies) <= 140
    assert len(first.finest.discrete.contact) >= 4
    if first.origin.startswith("graded"):
        assert f"graded {size:g} m" in first.origin


@pytest.mark.parametrize(("before", "after", "square", "ends"), [
    (500, 2000, 0.91, True), (500, 2000, 0.89, False), (499, 2000, 0.91, False), (500, 1999, 0.91, False)])
def test_no_progress_is_seen_over_four_times_the_nodes_of_a_resolved_mesh(before, after, square, ends):
    done = [SimpleNamespace(nodes=nodes, settled=None, total_seconds=0.0, estimate=am.Estimate(
        squares=np.array([value]), norm=1.0)) for nodes, value in ((before, 1.0), (before, 1.0), (after, square))]
    run = SimpleNamespace(limits=Limits(max_nodes=10**6), done=[*done[:1], *done], _full=lambda nodes: False)
    assert ("no progress" in solving.AdaptiveLoop._reached(run, done[-1])) is ends


class Engine:
    def __init__(self, make):
        self.make, self.bounds = make, []

    def refine(self, problem, mesh, estimate, marked, max_nodes=None):
        self.bounds.append(max_nodes)
        return self.make(problem, mesh, estimate, marked, max_nodes)


def test_nothing_to_refine_ends_the_loop_and_an_engine_that_makes_too_much_does_not():
    stuck, most = Engine(lambda problem, mesh, *rest: mesh), {"max_nodes": 1000}
    nothing = SimpleNamespace(mark=lambda estimate: np.zeros(len(estimate.squares), dtype=bool))
    for words, found in (("beyond rounding", loop(am.cases.two_block_patch(), 0.03, max_nodes=10**5)),
                         ("no error", loop(indicator=Constant(0.0), engine=stuck, **most)),
                         ("no finer mesh than that of 3", loop(indicator=Constant(), engine=stuck, **most)),
                         ("the marking chooses no element", loop(mark=nothing, **most))):
        assert len(found) == 1 and "no progress" in found[0].outcome and words in found[0].outcome
        assert "coordinates" not in found[0].outcome
    # an engine that overshoots is asked for less
    generous = Engine(lambda *given: BISECT.refine(*given[:4], max_nodes=int(1.2 * given[4])))
    assert loop(engine=generous, max_nodes=300)[-1].nodes <= 300 and min(generous.bounds) < 300


def test_it_starts_from_a_mesh_or_a_hierarchy_with_any_solver_and_transfer(monkeypatch):
    problem = upset()
    mesh = structured(problem.domain, 5)
    assert loop(problem, mesh, max_nodes=120)[0].hierarchy.finest.mesh is mesh
    grids = am.Hierarchy.uniform(problem, (4, 8))
    for solver in (am.Multigrid(rtol=1e-9), am.FullMultigrid(rtol=1e-6)):
        found = loop(problem, grids, solver=solver, max_nodes=200)
        assert found[0].hierarchy is grids and found[1].hierarchy[0].n_nodes == 25
        assert all(step.result.rtol == solver.rtol for step in found)
    # a multigrid begins with the second mesh
    transfer = am.PseudoL2()
    found = loop(solver=am.FullMultigrid(rtol=1e-6), transfer=transfer, max_nodes=100)
    assert [step.result.rtol for step in found[1:]] == [1e-6] * (len(found) - 1) and found[0].result.rtol <= 1e-6
    assert found[-1].hierarchy.transfer is transfer
    # a warm start that fails is replaced, and its work counts
    monkeypatch.setattr(solving, "WarmMultigrid", lambda **options: am.Multigrid(rtol=1e-12, max_cycles=1))
    found = loop(max_nodes=60)
    assert all(step.result.status.ok and "FullMultigrid" in step.result.solver_name for step in found[1:])
    alone = am.solve(found[-1].hierarchy, am.FullMultigrid(rtol=found[-1].result.rtol))
    assert found[-1].work_units > alone.work_units
    with pytest.raises(am.NotConverged):
        loop(solver=am.SingleGrid(max_sweeps=1), max_nodes=900)


def test_a_load_path_is_followed_on_every_mesh():
    problem = am.cases.greco_bar()
    path = am.LoadPath({"left": [0.5, 1.0, 0.2]}, default=1.0)
    solver = am.ActiveSet(rtol=1e-12)
    by_last, by_worst = (loop(problem, 10e-3, load_path=path, adapt_on=on, max_nodes=90, solver=solver)
                         for on in ("last", "worst"))
    for step in (*by_last, *by_worst):
        assert len(step.path) == 3 and step.path.complete
    assert by_last[0].result is by_last[0].path[2]
    first = by_worst[0]
    posed = [posed_at(first.hierarchy, path, first.path, k) for k in range(3)]
    assert first.estimate.relative == max(
        am.Residual().indicate(*pair).relative for pair in zip(posed, first.path, strict=True))
    # what is posed in a step is what its result solves
    for k, grids in enumerate(posed):
        alone = am.solve(grids, solver).displacement
        np.testing.assert_allclose(first.path[k].displacement, alone, atol=1e-9 * np.abs(alone).max())
        assert grids.problem.loads[-1].value == path.factors["left"][k] * problem.loads[-1].value
    one = am.LoadPath({"left": [1.0]}, default=1.0)
    plain = next(am.adapt(problem, 10e-3, engine=BISECT, max_nodes=90))
    single = next(am.adapt(problem, 10e-3, engine=BISECT, load_path=one, max_nodes=90))
    np.testing.assert_allclose(single.estimate.squares, plain.estimate.squares, rtol=1e-6)


@pytest.mark.parametrize("engine", [am.Bisect(coarsen=0.02), am.Remesh()], ids=["coarsening", "remeshing"])
def test_a_mesh_is_refined_for_all_load_steps_where_their_errors_lie_apart(engine):
    # a load that moves along the top: what one step needs another would take back
    parts = ("first", "second", "third")
    problem = am.ContactProblem(
        domain=am.Polygon(vertices=[(0.0, 0.0), (0.1, 0.0), *((one, 0.02) for one in np.linspace(0.1, 0.0, 4))],
                          boundaries=("bottom", "right", *parts, "left")),
        material=am.PlaneStrain(young=2e11, poisson=0.3), law=am.Coulomb(0.4),
        contact=am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0))), supports=(am.Support("left", x=0.0),),
        loads=tuple(am.Pressure(name, 3e7) for name in parts))
    path = am.LoadPath({name: [1.0 if k == j else 0.02 for j in range(3)] for k, name in enumerate(parts)})
    found = loop(problem, 15e-3, engine=engine, load_path=path, adapt_on="worst", max_nodes=700)
    assert "max_nodes" in found[-1].outcome and len(found) < 9
    # the estimate falls from mesh to mesh, and all steps have a similar one on the last mesh
    assert all(b.estimate.relative < a.estimate.relative for a, b in itertools.pairwise(found))
    last = found[-1]
    others = [am.Residual().indicate(posed_at(last.hierarchy, path, last.path, k), one).relative
              for k, one in enumerate(last.path)]
    assert min(others) > 0.5 * last.estimate.relative


def test_the_parts_of_a_loop_fit_each_other():
    grids = am.Hierarchy.uniform(upset(), (3, 6))
    for problem, options, words in ((upset(), {"max_nodes": 9}, "start must be a hierarchy for the problem"),
                                    (grids.problem, {"transfer": am.L2(), "max_nodes": 9}, "transfer")):
        with pytest.raises(ValueError, match=words):
            am.adapt(problem, grids, **options)
    goal, bar = am.Goal(am.Displacement((0.0, 0.0), "x")), am.cases.greco_bar()
    # goals get meshes that are no refined copies
    default, whole, refined = ([step.nodes for step in loop(bar, 12e-3, goal, engine, max_nodes=150)]
                               for engine in (None, am.Remesh(refinements=0), am.Remesh()))
    assert default == whole != refined
