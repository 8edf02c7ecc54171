"""Load histories: friction acts on increments, every step is solved, and an interrupted path goes
on where it was."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import bar_hierarchy, bar_on_block, dragged_block
from norms import distance as energy_distance
from norms import far as distance
from paths import resumed
from refused import check_refused
from scipy import sparse
from smoother_problems import Idle

import adaptmg as am
from adaptmg.evolution.load_path import StepNotConverged

FINE = am.FullMultigrid(rtol=1e-11)
EXACT = am.ActiveSet(rtol=1e-12)
MONOTONE = am.FullMultigrid(correction=am.Monotone(), rtol=1e-11)
#: side pressure on, and off again, under constant pressure on the top
CYCLE = am.LoadPath({"left": [0.5, 1, 0.5, 0]}, default=1.0)
CYCLE_OF_BODIES = am.LoadPath({"upper.left": [0.5, 1, 0.5, 0]}, default=1.0)
STEEL = am.PlaneStrain(young=2.1e11, poisson=0.3)


def bar(law: am.problem.Law = am.Coulomb(1.0), n: int = 16) -> am.Hierarchy:
    return am.Hierarchy.uniform(
        am.cases.greco_bar(law=law), divisions=[d for d in (4, 8, 16, 32) if d <= n]
    )


@pytest.fixture(scope="module")
def rough() -> am.Hierarchy:
    return bar()


@pytest.fixture(scope="module")
def cycle(rough: am.Hierarchy) -> am.PathResult:
    return am.solve_path(rough, CYCLE, FINE)


@pytest.fixture(scope="module")
def bodies() -> am.Hierarchy:
    """A block pressed on a wider one and pushed along it."""
    return bar_hierarchy(bar_on_block(am.Coulomb(0.3)), 2)


def pulled(law: am.problem.Law = am.Coulomb(0.3)) -> am.Hierarchy:
    """A block pressed on a plane and moved along it by its top."""
    problem = am.ContactProblem(
        name="moved block",
        material=STEEL,
        domain=am.Rectangle(width=0.04, height=0.02),
        contact=am.Contact("bottom", am.Plane(point=(0.0, 0.0), normal=(0.0, 1.0))),
        law=law,
        loads=(am.Pressure("left", 1e6),),
        supports=(am.Support("top", x=4e-6, y=-1e-5),),
    )
    return am.Hierarchy.uniform(problem, divisions=[(4, 2), (8, 4), (16, 8)])


def check_step(
    grids: am.Hierarchy, factors: dict[str, float], before: np.ndarray, result: am.Result
) -> None:
    """All conditions of contact, on matrix and load made again from a problem of this step;
    ``before`` is relative."""
    posed = am.discretise(
        am.problem.step_problem(grids.problem, factors), grids.finest.mesh, slip_reference=before
    )
    certificate = result.certificate(posed)
    assert not certificate.contradictions(4e-10) and certificate["penetration"].relative <= 1e-12


@pytest.mark.parametrize(("grids", "path"), [("rough", CYCLE), ("bodies", CYCLE_OF_BODIES)])
def test_each_step_satisfies_its_contact_conditions(grids, path, request):
    grids = request.getfixturevalue(grids)
    results, *others = (am.solve_path(grids, path, solver) for solver in (FINE, EXACT, MONOTONE))
    before = np.zeros_like(results[0].displacement)
    for k, result in enumerate(results):
        assert all(distance(result, other[k]) <= 1e-8 for other in others)
        check_step(grids, {name: path.of(name)[k] for name in results.factors}, before, result)
        before = grids.finest.discrete.relative(result.displacement)
        assert result.resultant(grids.problem.contact_boundaries[0]).force[1] == pytest.approx(
            5e7 * 0.04
        )
    # unloaded: what has slipped is held back by friction, which turns round
    loaded, unloaded = results[1].contact, results[-1].contact
    assert np.abs(unloaded.u_t).max() > 0.05 * np.abs(loaded.u_t).max()
    slides = unloaded.state == am.SLIP
    assert slides.any() and (unloaded.force_t[slides] * loaded.force_t[slides] < 0).any()


@pytest.mark.parametrize("law", [am.Frictionless(), am.Coulomb(1.0)], ids=["smooth", "rough"])
def test_proportional_loading_is_one_step_and_cheap(law):
    grids = bar(law)
    path = am.solve_path(grids, am.LoadPath(default=np.linspace(0.2, 1, 5)), FINE)
    assert distance(path[-1], am.solve(grids, FINE)) <= 1e-9
    cheap, scratch = (
        am.solve_path(grids, am.LoadPath(default=np.linspace(0.2, 1, 5))),
        am.solve(grids),
    )
    assert not any(result.cycles or result.work_units for result in cheap[1:])
    assert distance(cheap[-1], path[-1]) <= cheap[-1].rtol
    back = am.solve_path(grids, am.LoadPath({"left": [1, 0.8, 0.6]}))
    first = am.solve_path(grids, am.LoadPath())[0]
    assert (
        back[0].cycles == first.cycles <= scratch.cycles + 1 and distance(back[0], first) <= 1e-13
    )
    assert all(result.work_units <= 1.1 * first.work_units for result in back)


def test_starts_of_steps_follow_supports_that_move():
    """Without a change of status the solution is proportional to the motion."""
    path = am.LoadPath({"top": [0.25, 0.5, 1.0], "left": 0.0})
    first, *others = am.solve_path(pulled(am.Frictionless()), path, MONOTONE)
    assert first.cycles > 10 and all(result.cycles <= 3 for result in others)
    for result, ratio in zip(others, (2, 4), strict=True):
        np.testing.assert_allclose(result.displacement, ratio * first.displacement, atol=1e-13)


def test_extrapolated_steps_are_as_accurate_as_required():
    grids = bar(n=8)
    path = am.LoadPath({"left": np.linspace(0.5, 0.6, 25)}, default=1.0)
    exact = am.solve_path(grids, path, am.ActiveSet())
    steps = am.solve_path(grids, path, rtol=1e-6)
    assert 0 < sum(step.cycles == 0 for step in steps) < len(steps) - 1
    discrete = grids.finest.discrete
    for step, reference in zip(steps, exact, strict=True):
        error = energy_distance(discrete, step.displacement, reference.displacement)
        assert error <= 1.1 * step.rtol


@pytest.mark.parametrize("solver", [am.ActiveSet(), am.ActiveSet(condensed=False), None])
def test_nothing_moves_or_slips_under_unchanged_loads(solver):
    grids = am.Hierarchy.uniform(am.cases.greco_block(), (2, 4))
    _, before, *unchanged = am.solve_path(grids, am.LoadPath(default=[0.5, 1.0, 1.0, 1.0]), solver)
    for step in unchanged:
        assert distance(step, before) <= 1e-13
        assert not step.contact.counts()["slip"]


@pytest.mark.parametrize("law", [am.Coulomb(0.5), am.Frictionless()], ids=["sticks", "slips"])
@pytest.mark.parametrize("solver", [am.Multigrid(), am.FullMultigrid()], ids=["cold", "nested"])
def test_steps_that_change_no_status_cost_no_more_cycles_than_the_first(law, solver):
    """No extrapolation helps: the loads of the steps are independent of each other."""
    shear = am.Traction("top", (1e5, 0.0), name="shear")
    problem = replace(
        pulled(law).problem,
        loads=(am.Pressure("top", 1e7), am.Pressure("left", 1e6), shear),
        supports=(am.Support("right", x=0),),
    )
    grids = am.Hierarchy.uniform(problem, divisions=[(4, 2), (8, 4), (16, 8), (32, 16)])
    path = am.LoadPath({"left": [1, 0.3, 0.6, 0.2], "shear": [0.2, -0.3, 0.8, -0.9]})
    first, *later = am.solve_path(grids, path, solver)
    assert len({tuple(one.contact.state) for one in (first, *later)}) == 1
    assert max(one.cycles for one in later) <= first.cycles + 2
    assert sum(one.cycles for one in later[:2]) <= 25


def test_the_order_of_loads_matters_equal_steps_change_nothing(rough):
    side_first = am.solve_path(rough, am.LoadPath({"left": [1, 1, 1], "top": [0.05, 1, 1]}), FINE)
    top_first = am.solve_path(rough, am.LoadPath({"left": [0.05, 1], "top": [1, 1]}), FINE)
    assert distance(side_first[1], top_first[1]) > 1e-2
    assert distance(side_first[2], side_first[1]) <= 1e-10
    assert not (side_first[2].contact.state == am.SLIP).any()


def test_supports_move_with_the_factors_of_a_path():
    grids = pulled()
    path = am.LoadPath({"top": [1, 2, 1, 0], "left": 0.0})
    results = am.solve_path(grids, path, FINE)
    before = np.zeros_like(results[0].displacement)
    for k, result in enumerate(results[:3]):
        np.testing.assert_allclose(
            result.displacement[grids.finest.mesh.boundary_nodes("top")],
            [[4e-6 * path.of("top")[k], -1e-5 * path.of("top")[k]]] * 17,
        )
        check_step(grids, {"top": path.of("top")[k], "left": 0.0}, before, result)
        before = result.displacement
    # nothing acts any more
    assert results.complete and not results[3].displacement.any()


@pytest.mark.parametrize(
    "solver", [am.Multigrid(), EXACT, am.SingleGrid()], ids=["cold", "exact", "single"]
)
def test_an_unloaded_body_is_undeformed(solver):
    results = am.solve_path(pulled(), am.LoadPath(default=[0, 1, 0.3 - 3 * 0.1, 1]), solver)
    assert results.complete
    assert not results[0].displacement.any() and not results[2].displacement.any()
    np.testing.assert_allclose(results[2].contact.slip, -results[1].contact.u_t)
    assert distance(results[3], results[1]) <= 1e-6


def test_an_unloaded_body_stays_deformed_where_friction_needs_no_pressure():
    results, exact = (
        am.solve_path(pulled(am.Tresca(2e6)), am.LoadPath(default=[1, 0]), solver)
        for solver in (FINE, EXACT)
    )
    assert results[1].displacement.any() and distance(results[1], exact[1]) <= 1e-8


@pytest.mark.parametrize(
    ("dim", "floor", "load"),
    [(2, False, 4e5), (2, True, 4e5), (3, False, 1.2e4)],
    ids=["plane", "wider slave", "space"],
)
def test_steady_sliding_dissipates_friction_times_distance(dim, floor, load):
    cells = [2, 4]
    if floor:
        cells = [{"block": (5 * k, 2 * k), "floor": (7 * k, 2 * k)} for k in (1, 2)]
    grids = am.Hierarchy.uniform(dragged_block(dim, floor), cells)
    path = am.LoadPath({"drag": [1.0, 3.0, 0.0, -2.0, -2.5]}, default=1.0)
    steps = am.solve_path(grids, path, rtol=1e-10)
    dissipated = np.diff(steps.dissipation)[[0, 2, 3]]  # not where it turns
    friction_force = 0.3 * load
    distances = 1e-4 * np.array([2.0, 2.0, 0.5])
    assert dissipated == pytest.approx(friction_force * distances)
    unit = "J" if dim == 3 else "J/m"
    assert steps.table()[f"dissipation [{unit}]"].iloc[-1] == steps.dissipation[-1]


def test_a_bare_problem_has_default_factors(rough):
    for grids in (rough, pulled()):
        results = am.solve_path(grids.finest.discrete, am.LoadPath(default=[0.5, 1]), EXACT)
        assert distance(results[1], am.solve(grids, FINE)) <= 1e-8 and list(results.factors) == [
            "default"
        ]
    with pytest.raises(ValueError, match="have no names: give default"):
        am.solve_path(rough.finest.discrete, CYCLE, EXACT)


def test_a_path_is_solved_on_coarse_spaces(rough):
    grids = am.Hierarchy.algebraic(rough.finest.discrete, max_coarse=60)
    results, exact = (
        am.solve_path(grids, am.LoadPath(default=[1, 0.5]), solver)
        for grids, solver in ((grids, am.Multigrid(rtol=1e-10)), (rough, EXACT))
    )
    assert distance(results[1], exact[1]) <= 1e-8


def test_all_steps_have_the_tolerance_of_the_discretisation(rough, cycle):
    results = am.solve_path(rough, CYCLE, am.FullMultigrid(rtol="discretisation"))
    assert results.complete and len({result.rtol for result in results}) == 1
    assert 1e-9 < distance(results[-1], cycle[-1]) < 1e-2


def test_a_given_slip_reference_counts_in_the_first_step(rough):
    moved = rough.finest.discrete
    shift = np.full_like(moved.contact.slip_reference, 1e-5)
    moved = replace(moved, contact=replace(moved.contact, slip_reference=shift))
    assert distance(am.solve_path(moved, am.LoadPath(), EXACT)[0], am.solve(moved, EXACT)) <= 1e-14


def test_bad_factors_and_unknown_or_ambiguous_names_are_refused(rough):
    for factors, default, message in (
        (
            {"top": [1, 2], "left": [1, 2, 3]},
            1.0,
            "one at least, got 2 for 'top', 3 for 'left'",
        ),
        ({"top": [1, 2]}, [1.0], "1 for 'default'"),
        ({"top": []}, 1.0, "one at least"),
    ):
        with pytest.raises(ValueError, match=message):
            am.LoadPath(factors, default)
    for name in ("lid", "right", "bottom", "body", "default"):
        with pytest.raises(ValueError, match=f"names '{name}'.*known are 'top', 'left'"):
            am.solve_path(rough, am.LoadPath({name: [1, 2]}))
    loads = (
        am.Pressure("part", 1.0),
        am.InitialStrain("part", (1e-5, 0.0)),
        am.BodyForce((0.0, 1.0), name="weight"),
    )
    part = replace(am.cases.greco_bar(), domain=None, loads=loads)
    with pytest.raises(
        ValueError, match=r"'part', where Pressure and InitialStrain act: give each a name="
    ):
        am.LoadPath({"part": 1.0}).resolved(part)
    assert set(am.LoadPath({"weight": [1, 2]}, default=[3, 4]).resolved(part)) == {
        "part",
        "weight",
    }
    # a name of one load that is the place of another
    for one in (am.Traction("top", (1.0, 0.0)), am.BodyForce((0.0, 1.0), name="top")):
        with pytest.raises(ValueError, match=r"'top', where Pressure and .* act: give each"):
            am.LoadPath({"top": [1, 2]}).resolved(
                replace(part, loads=(am.Pressure("top", 1.0), one))
            )


@pytest.mark.parametrize("dim", [2, 3])
def test_each_load_on_a_face_has_its_own_factor(dim):
    """Fretting: a constant pressure and a cyclic shear on the same face, and a support that
    moves it."""
    pressure, shear, factors = 1e6, 2e5, [0.5, 1.0, -1.0, 0.0, 1.0]
    box = am.Box(width=1, depth=1, height=0.5) if dim == 3 else am.Rectangle(width=1, height=0.5)
    floor = [0.0] * (dim - 1) + [1.0]
    problem = am.ContactProblem(
        domain=box,
        material=(am.Solid if dim == 3 else am.PlaneStrain)(young=2e11, poisson=0.3),
        law=am.Coulomb(0.3),
        contact=am.Contact("bottom", am.Plane([0.0] * dim, floor)),
        loads=(
            am.Pressure("top", pressure, name="press"),
            am.Traction("top", (shear, *[0.0] * (dim - 1)), name="shear"),
        ),
    )
    grids = am.Hierarchy.uniform(problem, [(2,) * dim, (4,) * dim])
    path = am.LoadPath({"press": 1.0, "shear": factors})
    steps = am.solve_path(grids, path, FINE)
    for k, factor in enumerate(factors):
        force = steps[k].resultant("bottom").force
        assert force[[0, -1]] == pytest.approx([-factor * shear, pressure], abs=1e-5 * pressure)
    # the history matters: the same loads, reached otherwise
    assert distance(steps[4], steps[1]) > 1e-6
    # one name for several, and for what supports prescribe
    sinks = replace(
        problem,
        loads=(),
        supports=(
            am.Support("top", **{"xyz"[dim - 1]: -1e-6}, name="sink"),
            am.Support("top", x=1e-7, name="slide"),
        ),
    )
    moved = am.solve_path(
        am.Hierarchy.uniform(sinks, [(2,) * dim, (4,) * dim]),
        am.LoadPath({"sink": 1.0, "slide": [0, 2]}),
        FINE,
    )
    top = moved[0].mesh.boundary_nodes("top")
    for k, factor in enumerate((0, 2)):
        np.testing.assert_allclose(
            moved[k].displacement[top][:, [0, -1]], [[factor * 1e-7, -1e-6]] * len(top)
        )


def test_rigid_motion_in_a_step_is_named_before_any_is_solved(rough):
    solved = []
    with pytest.raises(ValueError, match=r"step 1 of 2 \(top=-1, left=1\): .*translation along y"):
        am.solve_path(rough, am.LoadPath({"top": [1, -1]}), callback=lambda k, _: solved.append(k))
    assert not solved


def solved_steps(*arguments, **options) -> list[int]:
    """The numbers of the steps that are not read from the store."""
    done = []
    am.solve_path(*arguments, callback=lambda k, result: done.append(k), **options)
    return done


@pytest.mark.parametrize("solver", [am.FullMultigrid(rtol="discretisation"), EXACT])
def test_an_interrupted_path_goes_on(rough, solver, tmp_path):
    resumed(rough, CYCLE, solver, tmp_path, after=1)
    assert not solved_steps(rough, CYCLE, solver, store=tmp_path)


def alike_where_a_node_sticks() -> am.Hierarchy:
    """Return grids with two coarse functions that differ in the slip of one contact node only."""
    fine = am.Hierarchy.uniform(am.cases.greco_bar(), (4, 8)).finest
    functions = fine.prolongation.toarray()
    slip = np.zeros(len(functions))
    slip[2 * fine.discrete.contact.nodes[1]] = 0.5
    last = 0.5 * functions[:, -1]
    functions = np.column_stack([functions[:, :-1], last + slip, last - slip])
    return am.Hierarchy.from_prolongations(fine.discrete, [sparse.csr_array(functions)])


@pytest.mark.parametrize(
    ("grids", "solver"),
    [
        ("rough", am.FullMultigrid()),
        ("bodies", am.FullMultigrid()),
        ("bodies", am.Multigrid()),
        ("volumes", am.FullMultigrid()),
        ("block", am.Multigrid()),
        ("alike", am.Multigrid()),
    ],
)
def test_a_path_cut_anywhere_has_the_same_bits(grids, solver, tmp_path, request):
    """The paths are of one body, of two bodies, with pressures on all levels, with supports that move,
    and with coarse matrices that are singular in some steps."""
    path = CYCLE_OF_BODIES if grids == "bodies" else CYCLE
    if grids == "volumes":
        soft = am.PlaneStrain(young=1.3e11, poisson=0.49)
        problem = am.cases.greco_bar(law=am.Coulomb(0.4))
        problem = replace(problem, material=soft, elements="smoothed")
        grids = am.Hierarchy.uniform(problem, divisions=(3, 6, 12))
    elif grids == "block":
        grids, path = pulled(), am.LoadPath({"top": [1, 1.2, 0.9, 1.4], "left": [1, 0, 3, 2]})
    elif grids == "alike":
        grids, path = alike_where_a_node_sticks(), am.LoadPath({}, default=[1, 0.9, 1.2])
    else:
        grids = request.getfixturevalue(grids)
    whole = am.solve_path(grids, path, solver, store=tmp_path)
    for cut in range(1, len(path)):
        for k in range(cut, len(path)):
            (tmp_path / f"step_{k:04d}.npz").unlink()
        again = am.solve_path(grids, path, solver, store=tmp_path)
        for one, other in zip(again, whole, strict=True):
            assert np.array_equal(one.displacement, other.displacement)
            assert np.array_equal(one.pressures, other.pressures)
            assert one.cycles == other.cycles


def test_another_run_is_refused(rough, tmp_path):
    path = am.LoadPath({"left": [0.5, 1]})
    am.solve_path(rough, path, store=tmp_path)
    others = {
        "path": (rough, am.LoadPath({"left": [0.5, 0.9]}), None),
        "grids, transfers, loads, supports, contact, law": (bar(n=8), path, None),
        "value of solver": (rough, path, am.FullMultigrid(rtol=1e-6)),
        "law": (bar(am.Coulomb(0.9)), path, None),
    }
    for named, (grids, other, solver) in others.items():
        with pytest.raises(ValueError, match=f"belongs to another run: {named} differ"):
            am.solve_path(grids, other, solver, store=tmp_path)
    # supports along a direction that is not an axis move further
    square = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    sloping = replace(square, points=square.points @ [[1.0, 0.0], [0.5, 1.0]])
    grids, further = (
        am.Hierarchy.from_meshes(
            am.ContactProblem(
                material=am.PlaneStrain(young=1e9, poisson=0.3),
                supports=[am.Support("left", normal=shift), am.Support("right", y=0, x=0)],
            ),
            [sloping],
        )
        for shift in (1e-4, 2e-4)
    )
    am.solve_path(grids, path, am.ActiveSet(), store=tmp_path / "inclined")
    with pytest.raises(ValueError, match="belongs to another run: supports differs"):
        am.solve_path(further, path, am.ActiveSet(), store=tmp_path / "inclined")
    # rounding is not another run
    close = am.Hierarchy.uniform(
        am.cases.greco_bar(top_pressure=5e7 * (1 + 1e-14)), divisions=(4, 8, 16)
    )
    assert not solved_steps(close, path, store=tmp_path)


def test_a_path_is_saved_and_loaded(rough, cycle, tmp_path):
    cycle.save(tmp_path / "a")
    loaded = am.PathResult.load(tmp_path / "a")
    assert loaded.complete and len(loaded) == 4 and loaded.table().equals(cycle.table())
    np.testing.assert_array_equal(loaded.factors["left"], CYCLE.of("left"))
    np.testing.assert_allclose(loaded[3].probe([(0.01, 0.0)]), cycle[3].probe([(0.01, 0.0)]))
    assert am.Result.load(tmp_path / "a" / "step_0000.npz").mesh.n_nodes == 289
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "step_0001.npz").write_bytes(b"mine")
    check_refused(
        (
            lambda: am.Result.load(tmp_path / "a" / "step_0002.npz"),
            r"is step 2 of a load path.*PathResult\.load\('.*a'\)\[2\]",
        ),
        (lambda: am.Result.load(tmp_path / "a"), r"got the folder .*PathResult\.load"),
        (lambda: cycle.save(tmp_path / "a"), "holds a load path already"),
        (lambda: cycle.save(tmp_path / "b"), "holds a load path already"),
        (
            lambda: am.solve_path(rough, CYCLE, FINE, store=tmp_path / "a"),
            "was written by save",
        ),
    )
    assert (tmp_path / "b" / "step_0001.npz").read_bytes() == b"mine"


def test_failure_names_the_step_and_keeps_the_others(rough, tmp_path):
    path = am.LoadPath({"left": [0.5, 1, 0.1]}, default=1.0)
    with pytest.raises(
        StepNotConverged, match=r"step 2 of 3 \(top=1, left=0.1\): .*LIMIT"
    ) as caught:
        am.solve_path(rough, path, am.Multigrid(max_cycles=11), store=tmp_path)
    assert (
        caught.value.step == 2
        and len(caught.value.partial) == 3
        and not caught.value.partial.complete
    )
    assert caught.value.result is caught.value.partial[-1] and isinstance(
        caught.value, am.NotConverged
    )
    assert len(am.PathResult.load(tmp_path)) == 2
    results = am.solve_path(rough, CYCLE, am.FullMultigrid(max_cycles=3), throw=False)
    assert len(results) == 1 and not results.complete and results[-1].status is am.Status.LIMIT
    assert "1 of 4 steps" in repr(results)


def test_a_path_has_a_table_slices_and_progress(rough, cycle):
    table = cycle.table()
    assert list(table["factor left"]) == [0.5, 1, 0.5, 0] and (table["status"] == "CONVERGED").all()
    assert (
        table[["open", "slip", "stick"]].sum(axis=1) == len(rough.finest.discrete.contact)
    ).all()
    np.testing.assert_allclose(table["force_y [N/m]"], 5e7 * 0.04)
    assert (
        cycle[-1] is cycle.results[3]
        and len(cycle[1:3]) == 2
        and list(cycle) == list(cycle.results)
    )
    rows = []
    am.solve_path(
        rough,
        am.LoadPath({"left": [0.5, 1]}),
        progress=lambda k, row: rows.append((k, row["cycle"])),
    )
    assert {k for k, _ in rows} == {0, 1}


def test_when_the_fast_cycle_gives_up_the_path_goes_on(rough, cycle):
    idle = am.Truncated(correct=Idle(), recombine=0)
    results = am.solve_path(rough, CYCLE, replace(FINE, correction=idle))
    assert distance(results[-1], cycle[-1]) <= 1e-8
    assert all("ActiveSet" in result.fallback for result in results)
