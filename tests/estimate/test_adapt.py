"""am.adapt: results of all steps carry the load, limits end it with a reason, parts may be
user-defined, neighbouring levels are neither too far apart nor too close."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import adaptmg as am
from adaptmg.estimate.loop import RATIO, RTOL, appended, carried, posed_at, thinned
from adaptmg.transfer.interpolation import _size_ratios

upset = am.cases.upset_block
BISECT = am.Bisect()
COARSE = 8e-3


def loop(problem=None, start=COARSE, indicator=None, engine=BISECT, **options):
    return list(
        am.adapt(
            upset() if problem is None else problem, start, indicator, engine=engine, **options
        )
    )


def test_forces_of_every_step_are_those_of_its_mesh():
    # a beam of 18 : 1 that bends onto a plane: energy errors of 1e-2 are forces wrong by 4 %
    beam = am.ContactProblem(
        domain=am.Polygon(
            vertices=[(0, 0), (0.02, 0), (0.2, 0), (0.2, 0.01), (0, 0.01)],
            boundaries=("free", "contact", "right", "top", "left"),
        ),
        material=am.PlaneStrain(young=2e11, poisson=0.3),
        law=am.Frictionless(),
        loads=(am.Pressure("top", 2e4),),
        contact=am.Contact("contact", am.Plane((0, -2e-5), (0, 1))),
        supports=(am.Support("left", x=0.0, y=0.0),),
    )
    for problem in (beam, am.cases.hertz_cylinder()):
        found = loop(problem, None, max_nodes=1500)
        for step in found:
            exact = am.solve(step.hierarchy, am.ActiveSet(rtol=1e-10), start=step.result)
            assert step.result.contact.force_n.sum() == pytest.approx(
                exact.contact.force_n.sum(), rel=1e-4
            )
            assert step.result.energy == pytest.approx(exact.energy, rel=1e-4)
            table = step.result.contact.table()
            assert (table[table["state"] == "open"]["pressure [Pa]"] == 0).all()
        assert len(found) >= 4 and set(am.Step.table(found)["rtol"][1:]) == {RTOL}


@pytest.mark.parametrize(("gap", "slide"), [(10e-3, 0.0), (0.0, 1e-3)], ids=["far gap", "far slip"])
def test_wide_gaps_and_slips_do_not_add_to_the_estimate(gap, slide):
    problem = am.ContactProblem(
        domain=am.Rectangle(width=40e-3, height=40e-3),
        material=am.PlaneStrain(young=2e11, poisson=0.3),
        law=am.Coulomb(0.3),
        contact=am.Contact("bottom", am.Plane((0.0, -gap), (0.0, 1.0))),
        supports=(am.Support("top", x=slide, y=-gap - 2e-6),),
    )
    found = loop(problem, max_nodes=900)
    assert "max_nodes" in found[-1].outcome and len(found) < 10
    for step in found:
        exact = am.solve(step.hierarchy, am.ActiveSet(rtol=1e-9))
        assert step.estimate.total == pytest.approx(
            am.Residual().indicate(step.hierarchy, exact).total, rel=0.05
        )


def test_the_estimate_falls_and_all_solves_cost_little():
    found = loop(max_nodes=1500)
    for number, (before, step) in enumerate(itertools.pairwise(found), start=1):
        assert step.number == number and before.nodes < step.nodes <= 1500
    assert found[-1].estimate.relative < 0.3 * found[0].estimate.relative
    assert [bool(step.outcome) for step in found] == [False] * (len(found) - 1) + [True]
    assert "max_nodes" in found[-1].outcome and found[-1].outcome in repr(found[-1])
    matrices = [step.hierarchy.finest.matrix.nnz for step in found]
    total = sum(step.work_units * nonzeros for step, nonzeros in zip(found, matrices, strict=True))
    assert found[-1].total_work_units == pytest.approx(total / matrices[-1])
    alone = am.solve(found[-1].hierarchy, am.FullMultigrid(rtol=RTOL))
    assert found[-1].total_work_units <= 2 * alone.work_units
    assert found[-1].total_seconds == pytest.approx(sum(step.seconds for step in found))
    assert {"solve", "estimate"} <= set(found[-1].timings) and all(
        s >= 0 for s in found[-1].timings.values()
    )


def test_close_levels_are_dropped_and_progress_is_reported():
    rows = []
    found = loop(mark=am.Doerfler(0.2), max_nodes=400, progress=rows.append)
    last = found[-1].hierarchy
    assert len(last) < len(found) and last.operator_complexity < 2.6
    assert all(
        am.transfer.size_ratio(a.mesh, b.mesh) <= 4.0 + 1e-9
        for a, b in itertools.pairwise(last.levels)
    )
    assert {row["phase"] for row in rows} == {"mesh", "assembly", "solve", "estimate", "done"}
    assert all(row.keys() == rows[0].keys() for row in rows)
    assert rows[-1]["seconds"] > 0


def test_limits_end_the_loop():
    found = loop(tolerance=0.06)
    assert found[-1].estimate.relative <= 0.06 < found[-2].estimate.relative
    assert "tolerance" in found[-1].outcome
    found = loop(max_seconds=1e-6)
    assert len(found) == 1 and "max_seconds" in found[0].outcome


def test_a_signed_estimate_that_is_far_off_is_not_settled():
    # on coarse meshes one to three nodes touch
    found = loop(
        am.cases.curved_obstacle(radius=0.5),
        10e-3,
        am.Goal(am.PeakPressure("bottom")),
        max_nodes=1000,
        mark=am.Doerfler(0.5),
    )
    exact = float(found[-1].estimate.corrected[0])
    ratios = np.array([step.estimate.signed / (exact - step.estimate.value) for step in found[:-1]])
    is_settled = np.array([step.settled for step in found[:-1]])
    assert ((ratios[1:] < 0.5) | (ratios[1:] > 2)).any()
    assert ((ratios > 0.5) & (ratios < 2))[is_settled].all()
    assert not is_settled[0] and is_settled[-2:].all()
    assert ["not settled" in repr(step) for step in found[:-1]] == (~is_settled).tolist()


class Scripted:
    def __init__(self, *parts, square=lambda n: 1.0):
        self.parts, self.square = iter(parts), square

    def indicate(self, hierarchy, result):
        n = len(hierarchy.finest.mesh.elements)
        return am.Estimate(squares=np.full(n, self.square(n)), norm=1.0, **next(self.parts))


def test_an_unsettled_estimate_meets_no_tolerance():
    early = Scripted(
        *(
            {"value": value, "signed": signed}
            for value, signed in (
                (1.0, -1e-9),
                (1.001, 1e-2),
                (1.01, 1e-3),
                (1.011, 1e-4),
                (1.0111, 1e-5),
            )
        )
    )
    found = loop(indicator=early, tolerance=1e-3)
    assert [step.settled for step in found] == [False, False, True]
    assert found[-1].outcome.startswith("tolerance met")
    # it is met where it is met twice, whatever the signs are
    never = Scripted(
        *({"value": 1.0, "signed": signed} for signed in (2e-2, -1e-2, 9e-4, -8e-4, 7e-4))
    )
    found = loop(indicator=never, tolerance=1e-3)
    assert (
        len(found) == 4
        and found[-1].settled is False
        and found[-1].outcome.startswith("tolerance met")
    )


def test_small_shares_of_a_quantity_are_not_rounding():
    for square, ends in ((1e-9, False), (1e-17, True)):
        small = Scripted(
            *[{"value": 1.0, "signed": 1e-3}] * 9, square=lambda n, square=square: square
        )
        found = loop(indicator=small, max_nodes=400)
        assert ("rounding" in found[-1].outcome) == ends and (len(found) == 2) == ends
    # of several quantities one that equilibrium gives says nothing about the others
    given = am.ContactForce("bottom", "normal")
    assert "rounding" in loop(am.cases.greco_bar(), None, am.Goal(given), max_nodes=400)[-1].outcome
    both = loop(
        am.cases.greco_bar(), None, am.Goal([given, am.MeanDisplacement("top", "y")]), max_nodes=400
    )
    assert len(both) > 1 and "max_nodes" in both[-1].outcome


@pytest.mark.parametrize("engine", [BISECT, am.Remesh()])
def test_the_limits_bind_the_first_mesh(engine):
    problem = upset()
    mesh = am.mesh.structured(problem.domain, 9)
    for start, most, message in (
        (mesh, 99, "100, .* got 99; or take a coarser start"),
        (COARSE, 30, ""),
    ):
        with pytest.raises(ValueError, match=f"max_nodes must be at least {message}"):
            am.adapt(problem, start, engine=engine, max_nodes=most)
    assert next(am.adapt(problem, mesh, engine=engine, max_nodes=100)).nodes == 100
    for start, most, message in (
        (1e-4, 2000, r"0\.00096 m for max_nodes=2000, got"),
        (1e-200, 2000, r"0\.00096 m for max_nodes=2000, got"),
        (None, 30, r"0\.0078 m for max_nodes=30, the default is"),
    ):
        with pytest.raises(ValueError, match=f"start must be at least {message}"):
            am.adapt(problem, start, engine=engine, max_nodes=most)


@pytest.mark.parametrize(
    ("case", "size", "engine"),
    [
        ("upset_block", 5e-3, BISECT),
        ("hertz_cylinder", 5.9e-3, am.Remesh()),
        ("bolted_junction", 6.9e-3, BISECT),
    ],
)
def test_the_first_size_follows_the_domain(case, size, engine):
    problem = getattr(am.cases, case)()
    first = next(am.adapt(problem, engine=engine, max_nodes=400)).hierarchy
    assert 60 <= first.finest.n_nodes / len(problem.domain.bodies) <= 140
    assert len(first.finest.discrete.contact) >= 4
    if first.origin.startswith("graded"):
        assert f"graded {size:g} m" in first.origin


def test_nothing_to_refine_ends_the_loop_but_not_a_large_mesh():
    stuck, most = (
        SimpleNamespace(refine=lambda problem, mesh, *rest, **options: mesh),
        {"max_nodes": 1000},
    )
    nothing = SimpleNamespace(mark=lambda estimate: np.zeros(len(estimate.squares), dtype=bool))
    for words, found in (
        ("beyond rounding", loop(am.cases.two_block_patch(), 0.03, max_nodes=10**5)),
        ("no error", loop(indicator=Scripted({}, square=lambda n: 0.0), engine=stuck, **most)),
        ("no finer mesh than that of 3", loop(indicator=Scripted({}), engine=stuck, **most)),
        ("the marking chooses no element", loop(mark=nothing, **most)),
    ):
        assert len(found) == 1 and "no progress" in found[0].outcome and words in found[0].outcome
        assert "coordinates" not in found[0].outcome

    # an engine that overshoots is asked for less
    def refine(*given, max_nodes):
        bounds.append(max_nodes)
        return BISECT.refine(*given, max_nodes=int(1.2 * max_nodes))

    bounds = []
    assert (
        loop(engine=SimpleNamespace(refine=refine), max_nodes=300)[-1].nodes <= 300
        and min(bounds) < 300
    )


def test_it_starts_from_a_mesh_or_hierarchy_with_any_solver():
    problem = upset()
    mesh = am.mesh.structured(problem.domain, 5)
    assert loop(problem, mesh, max_nodes=120)[0].hierarchy.finest.mesh is mesh
    grids = am.Hierarchy.uniform(problem, (4, 8))
    for solver in (am.Multigrid(rtol=1e-9), am.FullMultigrid(rtol=1e-6)):
        found = loop(problem, grids, solver=solver, max_nodes=200)
        assert found[0].hierarchy is grids and found[1].hierarchy[0].n_nodes == 25
        assert all(step.result.rtol == solver.rtol for step in found)
    # a multigrid begins with the second mesh
    transfer = am.PseudoL2()
    found = loop(solver=am.FullMultigrid(rtol=1e-6), transfer=transfer, max_nodes=100)
    assert [step.result.rtol for step in found[1:]] == [1e-6] * (len(found) - 1) and found[
        0
    ].result.rtol <= 1e-6
    assert found[-1].hierarchy.transfer is transfer
    with pytest.raises(am.NotConverged):
        loop(solver=am.SingleGrid(max_sweeps=1), max_nodes=900)


def test_a_load_path_is_followed_on_every_mesh():
    problem = am.cases.greco_bar()
    path = am.LoadPath({"left": [0.5, 1.0, 0.2]}, default=1.0)
    solver = am.ActiveSet(rtol=1e-12)
    by_last, by_worst = (
        loop(problem, 10e-3, load_path=path, adapt_on=on, max_nodes=90, solver=solver)
        for on in ("last", "worst")
    )
    for step in (*by_last, *by_worst):
        assert len(step.path) == 3 and step.path.complete
    assert by_last[0].result is by_last[0].path[2]
    first = by_worst[0]
    posed = [posed_at(first.hierarchy, path, first.path, k) for k in range(3)]
    assert first.estimate.relative == max(
        am.Residual().indicate(*pair).relative for pair in zip(posed, first.path, strict=True)
    )
    # what is posed in a step is what its result solves
    for k, grids in enumerate(posed):
        alone = am.solve(grids, solver).displacement
        np.testing.assert_allclose(
            first.path[k].displacement, alone, atol=1e-9 * np.abs(alone).max()
        )
        assert grids.problem.loads[-1].value == path.factors["left"][k] * problem.loads[-1].value
    one = am.LoadPath({"left": [1.0]}, default=1.0)
    plain = next(am.adapt(problem, 10e-3, engine=BISECT, max_nodes=90))
    single = next(am.adapt(problem, 10e-3, engine=BISECT, load_path=one, max_nodes=90))
    np.testing.assert_allclose(single.estimate.squares, plain.estimate.squares, rtol=1e-6)


@pytest.mark.parametrize("engine", [am.Bisect(), am.Remesh()], ids=["bisecting", "remeshing"])
def test_a_mesh_is_refined_for_all_load_steps(engine):
    # a load that moves along the top: what one step needs another would take back
    parts = ("first", "second", "third")
    problem = am.ContactProblem(
        domain=am.Polygon(
            vertices=[(0.0, 0.0), (0.1, 0.0), *((one, 0.02) for one in np.linspace(0.1, 0.0, 4))],
            boundaries=("bottom", "right", *parts, "left"),
        ),
        material=am.PlaneStrain(young=2e11, poisson=0.3),
        law=am.Coulomb(0.4),
        contact=am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0))),
        supports=(am.Support("left", x=0.0),),
        loads=tuple(am.Pressure(name, 3e7) for name in parts),
    )
    path = am.LoadPath(
        {name: [1.0 if k == j else 0.02 for j in range(3)] for k, name in enumerate(parts)}
    )
    found = loop(problem, 15e-3, engine=engine, load_path=path, adapt_on="worst", max_nodes=700)
    assert "max_nodes" in found[-1].outcome and len(found) < 9
    # the estimate falls from mesh to mesh, and all steps have a similar one on the last mesh
    assert all(b.estimate.relative < a.estimate.relative for a, b in itertools.pairwise(found))
    last = found[-1]
    others = [
        am.Residual().indicate(posed_at(last.hierarchy, path, last.path, k), one).relative
        for k, one in enumerate(last.path)
    ]
    assert min(others) > 0.5 * last.estimate.relative


def test_the_parts_of_a_loop_fit_each_other():
    grids = am.Hierarchy.uniform(upset(), (3, 6))
    for problem, options, words in (
        (upset(), {"max_nodes": 9}, "start must be a hierarchy for the problem"),
        (grids.problem, {"transfer": am.L2(), "max_nodes": 9}, "transfer"),
    ):
        with pytest.raises(ValueError, match=words):
            am.adapt(problem, grids, **options)


@pytest.mark.parametrize("theta", [0.1, 0.5, 0.9, 1.0])
def test_doerfler_marks_a_smallest_set_that_holds_the_share(theta):
    rng = np.random.default_rng(3)
    for _ in range(20):
        squares = rng.integers(0, 5, 9).astype(float)
        squares[0] += 1.0
        mask = am.Doerfler(theta).mark(squares)
        assert squares[mask].sum() >= theta * squares.sum()
        smaller = max(
            (
                squares[list(chosen)].sum()
                for chosen in itertools.combinations(range(9), mask.sum() - 1)
            ),
            default=0.0,
        )
        assert smaller < theta * squares.sum()
        assert (squares[mask] > 0).all()
        np.testing.assert_array_equal(
            am.Doerfler(theta).mark(am.Estimate(squares=squares, norm=1.0)), mask
        )
        largest = (squares >= theta * squares.max()) & (squares > 0)
        np.testing.assert_array_equal(am.Maximum(theta).mark(squares), largest)
    assert (
        not am.Doerfler(theta).mark(np.zeros(4)).any()
        and not am.Maximum(theta).mark(np.zeros(4)).any()
    )


def test_all_elements_with_an_error_are_marked_for_uniform_refinement():
    """Also those that the sum loses by rounding; the error for a share of 0 names them."""
    squares = np.array([1e-30, 0.0, 1.0, 1e-300, 0.3])
    assert am.Doerfler(1.0).mark(squares).tolist() == [True, False, True, True, True]
    with pytest.raises(ValueError, match=r"refine uniformly, take am.Doerfler\(1.0\)"):
        am.Maximum(0.0)


class Between:
    def __init__(self, counts: list[int]) -> None:
        self.counts, self.asked = counts, 0

    def intermediate(self, problem, coarse, fine):
        self.asked += 1
        return am.mesh.structured(problem.domain, self.counts.pop(0)) if self.counts else None


def grids(*counts: int) -> am.Hierarchy:
    return am.Hierarchy.uniform(upset(), counts)


def nodes(hierarchy: am.Hierarchy) -> list[int]:
    return [round(level.n_nodes**0.5) - 1 for level in hierarchy.levels]


@pytest.mark.parametrize(
    ("offered", "fine", "kept", "asked"),
    [
        ([9], 24, [3, 9, 24], 1),
        ([9], 9, [3, 9], 0),
        (None, 24, [3, 24], 0),
        ([], 24, [3, 24], 1),
        ([3], 24, [3, 24], 1),
        ([24], 24, [3, 24], 1),
    ],
    ids=["put between", "sizes fit", "not offered", "none made", "no finer", "no coarser"],
)
def test_a_mesh_is_put_between_where_sizes_fall_too_much(offered, fine, kept, asked):
    start, engine = grids(3), object() if offered is None else Between(offered)
    found = appended(start, am.mesh.structured(start.problem.domain, fine), engine)
    assert nodes(found) == kept and getattr(engine, "asked", 0) == asked
    assert len(kept) == 2 or all(
        am.transfer.size_ratio(a.mesh, b.mesh) <= RATIO for a, b in itertools.pairwise(found.levels)
    )


@pytest.mark.parametrize(
    ("sizes", "last", "kept"),
    [
        ((2, 6, 18, 20), False, (2, 6, 20)),
        ((2, 6, 18, 20), True, (2, 6, 18, 20)),  # a single close level stays
        ((1, 6, 7, 8), True, (1, 6, 8)),
        ((6, 7), False, (6, 7)),
        ((6, 7, 8), False, (6, 8)),
        ((6, 17, 20), False, (6, 20)),
        ((5, 20, 24), False, (5, 20, 24)),
    ],
)  # without it sizes are too far apart
def test_close_levels_that_are_not_needed_are_dropped(sizes, last, kept):
    assert tuple(nodes(thinned(grids(*sizes), last=last))) == kept


def test_the_ratio_of_a_sample_is_that_of_all():
    coarse, fine = (am.mesh.structured(am.Rectangle(width=1.0, height=1.0), n) for n in (7, 150))
    assert len(fine.elements) > 40_000
    assert am.transfer.size_ratio(coarse, fine) == pytest.approx(
        np.quantile(_size_ratios(coarse, fine, 1), 0.99), rel=1e-12
    )


@pytest.mark.parametrize("case", [am.cases.greco_bar, am.cases.dovetail])
def test_a_carried_solution_keeps_its_contact_state(case):
    problem = case()
    start = am.Hierarchy.graded(problem, (8e-3, 4e-3))
    coarse = am.solve(start, am.ActiveSet())
    grown = start.append(am.mesh.graded(problem.domain, 2.2e-3))
    fine = am.solve(grown, am.ActiveSet())
    carried_up = carried(grown, 1, coarse).displacement
    discrete = grown.finest.discrete
    assert am.solve(grown, am.Multigrid(rtol=1e-2), start=carried_up).status.ok
    moved = discrete.relative(carried_up)[discrete.contact.nodes]
    gap = discrete.contact.gaps - np.einsum("nd,nd->n", moved, discrete.contact.normals)
    closed = gap <= 1e-3 * np.abs(carried_up).max()
    assert np.mean(closed == (fine.contact.state != am.OPEN)) >= 0.85


@pytest.mark.parametrize("remesh_every", [None, 1])
def test_obstacle_between_two_nodes_is_warned_of(remesh_every):
    """It presses with 5e6 N/m; on a mesh whose nodes it misses nothing happens."""
    die = am.Moving(
        am.GapFunction(lambda x: (x[:, 0] - 0.01) ** 2 / 0.06), displacement=(0, -6e-5), name="die"
    )
    problem = am.ContactProblem(
        domain=am.Rectangle(width=0.03, height=0.02),
        material=am.PlaneStrain(young=2e11, poisson=0.3),
        contact=am.Contact("top", die),
        law=am.Frictionless(),
        supports=[am.Support("left", x=0), am.Support("bottom", y=0)],
    )
    options = {"tolerance": 0.05}
    if remesh_every:
        problem = replace(problem, material=am.Plastic(problem.material, yield_stress=2e8))
        options = {
            "load_path": am.LoadPath({"die": [0.5, 1.0]}),
            "remesh_every": remesh_every,
            "indicator": am.Recovery(),
        }
    start = am.mesh.structured(problem.domain, (2, 2))
    with pytest.warns(UserWarning, match="take a smaller start"):
        steps = list(am.adapt(problem, start, max_nodes=100, **options))
    assert not steps[-1].result.displacement.any()
