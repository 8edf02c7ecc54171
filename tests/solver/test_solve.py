"""solve() and the loop below it: records, what ends it, user-defined parts; that all methods agree:
tests/agreement."""

import gc
import weakref
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from made import result_on

import adaptmg as am
from adaptmg.smoother.factorisation import condense_problem
from adaptmg.solver.aggregates import aggregates_of
from adaptmg.solver.iterate import StopTest
from adaptmg.solver.record import Outcome, Run
from adaptmg.solver.statics import critical_friction


@pytest.fixture(scope="module")
def bar():
    """Grids and their solution by the active set method."""
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8, 16))
    return grids, am.solve(grids, am.ActiveSet(rtol=1e-12))


def test_the_estimate_is_of_the_error_not_of_the_change(bar):
    """A slow iteration (omega 1) must not stop on its small change."""
    grids, reference = bar
    result = am.solve(grids, am.SingleGrid(rtol=1e-5), reference=reference)
    assert result.history["true_error"][-1] < 2e-5
    assert result.path == [(len(grids) - 1, "smooth", result.cycles)]
    paper = am.solve(
        grids, am.SingleGrid(rtol=1e-5, stop="change"), reference=reference, throw=False
    )
    assert paper.history["true_error"][-1] > 1e-4
    assert paper.status is am.Status.STALLED


def test_history_is_reported_as_it_goes(bar):
    grids, _ = bar
    rows = []
    result = am.solve(grids, am.FullMultigrid(correction=am.Monotone()), callback=rows.append)
    assert len(rows) == len(result.history["cycle"]) == result.cycles + 1
    assert (np.diff(result.history["work_units"]) > 0).all()
    assert result.history["work_units"][-1] == result.work_units
    assert 0 < result.start_work_units < result.work_units
    assert {"setup", "start", "cycles"} <= set(result.timings)
    # those of the meshes are those of the hierarchy
    assert "mesh" in grids.timings and "mesh" not in result.timings
    assert (np.diff(result.history["seconds"]) >= 0).all()


def test_contact_without_names_has_a_resultant():
    result = result_on(None)
    np.testing.assert_array_equal(
        result.resultant("contact").force, result.contact.force.sum(axis=0)
    )
    with pytest.raises(ValueError, match="boundary '' is not known"):
        result.resultant("")


@pytest.mark.parametrize("law", [am.Frictionless(), am.Coulomb(0.3)])
def test_a_force_at_a_corner_belongs_to_its_supports(law, tmp_path):
    """A square between two supports and the plane."""
    smooth = isinstance(law, am.Frictionless)
    problem = am.ContactProblem(
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        domain=am.Rectangle(width=1.0, height=1.0),
        law=law,
        contact=am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0))),
        loads=(am.Pressure("right", 1e6) if smooth else am.Traction("right", (2e5, -1e5)),),
        supports=(
            am.Support("left", x=0.0),
            am.Support("top", y=-1e-3) if smooth else am.Support("top", x=0.0, y=0.0),
        ),
    )
    result = am.solve(am.Hierarchy.uniform(problem, (3,)), am.ActiveSet())
    result.save(tmp_path / "run.npz")
    for found in (result, am.Result.load(tmp_path / "run.npz")):
        left, top, right, bottom = (
            found.resultant(name).force for name in ("left", "top", "right", "bottom")
        )
        if smooth:
            # homogeneous: each side carries its pressure
            assert left == pytest.approx([1e6, 0], abs=1e-3) and right == pytest.approx(
                [0, 0], abs=1e-3
            )
            assert top == pytest.approx([0, -found.resultant("contact").force[1]], abs=1e-3)
            continue
        assert left + top + right + bottom == pytest.approx([-2e5, 1e5], abs=1e-3)
        # both hold x at the corner
        corner = np.flatnonzero((found.mesh.points == [0, 1]).all(axis=1))[0]
        inner = np.setdiff1d(found.mesh.boundary_nodes("top"), [corner])
        shared = [0.5, 1.0] * found.reaction[corner]
        assert top == pytest.approx(found.reaction[inner].sum(axis=0) + shared, abs=1e-3)


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda grids: am.solve("bar"), TypeError, "Hierarchy or a DiscreteProblem"),
        (
            lambda grids: am.solve(grids.truncated(coarsest=2), am.Multigrid()),
            ValueError,
            "at least two levels",
        ),
        (
            lambda grids: am.solve(grids, am.FullMultigrid(), start=np.zeros((289, 2))),
            ValueError,
            "its own start",
        ),
        (
            lambda grids: am.solve(
                replace(
                    grids.finest.discrete, law=am.Frictionless(), fixed=np.zeros(578, dtype=bool)
                ),
                am.SingleGrid(),
            ),
            ValueError,
            "translation along x",
        ),
        (
            lambda grids: am.FullMultigrid(correction=am.Monotone(), rtol="discretisation"),
            ValueError,
            "needs Full",
        ),
        *(
            (
                lambda grids, option=option: am.FullMultigrid(**option),
                ValueError,
                f"{next(iter(option))} must not be given.*give correction=am.{remedy}",
            )
            for option, remedy in (
                ({"smoother": am.ProjectedGaussSeidel(order="forward")}, r"Truncated\(smooth="),
                ({"cycle": am.Cycle(pre=2)}, r"Truncated\(correct="),
                ({"coarse": am.CoarseSolve()}, r"Truncated\(coarse_solve="),
                ({"stop": "error"}, "Monotone"),
                ({"coarse_matrices": "galerkin"}, "Monotone"),
            )
        ),
    ],
)
def test_bad_input_is_refused(bar, make, error, message):
    with pytest.raises(error, match=message):
        make(bar[0])


@pytest.mark.parametrize("make", [am.cases.greco_bar, am.cases.greco_block])
def test_other_laws_and_loads_share_factors_and_aggregates(make):
    grids = am.Hierarchy.uniform(make(), (2, 4))
    first, other = grids[0].discrete, make(law=am.Coulomb(0.2), top_pressure=1e7)
    shared = grids.with_problem(other)[0].discrete
    alone = am.Hierarchy.uniform(other, (2, 4))[0].discrete
    assert aggregates_of(first) is aggregates_of(shared) is not aggregates_of(alone)
    assert critical_friction(first) is critical_friction(shared)
    ours, theirs, fresh = (condense_problem(problem) for problem in (first, shared, alone))
    assert ours.factors is theirs.factors is not fresh.factors
    assert theirs.full.discrete is shared and not np.array_equal(ours.full.load, theirs.full.load)
    am.solve(grids, am.ActiveSet())
    again, once = (
        am.solve(one, am.ActiveSet())
        for one in (grids.with_problem(other), am.Hierarchy.uniform(other, (2, 4)))
    )
    np.testing.assert_array_equal(again.displacement, once.displacement)


def test_nothing_outlives_its_problem():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4))
    am.solve(grids)
    gone = [weakref.ref(level.discrete) for level in grids.levels] + [
        weakref.ref(aggregates_of(grids.finest.discrete)),
        weakref.ref(condense_problem(grids[0].discrete).factors),
    ]
    del grids
    gc.collect()
    assert [one() for one in gone] == [None] * 4


@pytest.mark.parametrize(
    "solver",
    [
        am.FullMultigrid(),
        am.FullMultigrid(correction=am.Monotone()),
        am.ActiveSet(),
        am.SingleGrid(max_sweeps=5),
    ],
)
def test_what_a_solve_needs_is_freed_when_it_returns(solver):
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4))
    am.solve(grids, solver, throw=False)  # compiling leaves cycles of references
    gc.collect()
    gc.disable()
    try:
        am.solve(grids, solver, throw=False)
        left = [one for one in gc.get_objects() if issubclass(type(one), StopTest | Run)]
    finally:
        gc.enable()
    assert not left


def disc(poisson: float, elements: str = "linear") -> am.Hierarchy:
    """A whole disc squeezed between two planes."""
    return am.Hierarchy.graded(
        am.ContactProblem(
            material=am.PlaneStrain(young=1e7, poisson=poisson),
            law=am.Coulomb(0.3),
            domain=am.Outline(
                vertices=((0.01, 0.01), (0.0, 0.02), (-0.01, 0.01), (0.0, 0.0)),
                boundaries=("upper", "upper", "lower", "lower"),
                arcs=dict.fromkeys(range(4), (0.0, 0.01)),
            ),
            elements=elements,
            contact=(
                am.Contact("lower", am.Plane((0.0, 0.0), (0.0, 1.0))),
                am.Contact("upper", am.Plane((0.0, 0.0198), (0.0, -1.0)), allow_interference=True),
            ),
        ),
        sizes=(3e-3, 1.5e-3),
        contact_ratio=2,
    )


def paper_bar(friction: float = 1.0) -> am.Hierarchy:
    return am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(friction)), (4, 8, 16))


class RunsAway:
    def run(self, hierarchy, run, start):
        far = np.full(hierarchy.finest.discrete.n_dofs, np.inf)
        return Outcome(far, am.Status.CONVERGED, 1, 1e-8)


PAPER = am.Multigrid(correction=am.PaperCorrection())
MONOTONE = am.Multigrid(correction=am.Monotone())
FAST, SLOW = am.SingleGrid(omega=1.99, max_sweeps=100_000), am.SingleGrid(omega=1.0)
SMOOTHED = partial(disc, 0.49, "smoothed")
#: what ends without convergence, how, and by the words of the advice what converges then
ADVICE = {
    "locked": (
        partial(disc, 0.49),
        am.FullMultigrid(correction=am.Monotone(), max_cycles=60),
        "LIMIT",
        {'elements="smoothed"': (SMOOTHED, None)},
    ),
    "few sweeps": (
        paper_bar,
        am.SingleGrid(max_sweeps=50),
        "LIMIT",
        {"raise it if the error estimate still falls": (paper_bar, am.SingleGrid())},
    ),
    "frozen": (
        paper_bar,
        PAPER,
        "LIMIT",
        {
            "am.FullMultigrid()": (paper_bar, am.FullMultigrid()),
            "am.ActiveSet()": (paper_bar, am.ActiveSet()),
        },
    ),
    "frozen, by change": (
        paper_bar,
        replace(PAPER, stop="change", rtol=1e-6),
        "STALLED",
        {
            "am.ActiveSet()": (paper_bar, am.ActiveSet()),
            "correction=am.Monotone()": (paper_bar, MONOTONE),
        },
    ),
    "over-relaxed": (
        paper_bar,
        FAST,
        "CYCLING",
        {
            "am.Multigrid()": (paper_bar, am.Multigrid()),
            "am.SingleGrid() with omega <= 1": (paper_bar, SLOW),
            "less friction": (partial(paper_bar, 0.1), FAST),
        },
    ),
    "runs away": (
        paper_bar,
        RunsAway(),
        "DIVERGED",
        {
            "am.ActiveSet()": (paper_bar, am.ActiveSet()),
            "correction=am.Monotone()": (paper_bar, MONOTONE),
            "omega <= 1": (paper_bar, SLOW),
        },
    ),
}


@pytest.mark.parametrize("failure", ADVICE)
def test_who_follows_an_advice_converges(failure):
    make, solver, status, remedies = ADVICE[failure]
    with pytest.raises(am.NotConverged) as caught:
        am.solve(make(), solver)
    assert caught.value.result.status.name == status
    text = str(caught.value)
    for words, (remade, other) in remedies.items():
        assert words in text
        assert am.solve(remade(), other).status.ok
    if failure == "locked":
        assert text.index("smoothed") < text.index(caught.value.result.status.value)
    else:
        assert "smoothed" not in text


@pytest.mark.parametrize("rtol", [1e-3, 1e-11])
def test_solves_paths_and_loops_take_a_tolerance(rtol):
    bar = paper_bar()
    path = am.LoadPath({"left": [0.5, 1.0]})
    mesh = am.mesh.structured(bar.problem.domain, 4)
    results = [am.solve(bar, rtol=rtol), *am.solve_path(bar, path, rtol=rtol)]
    for options in ({}, {"load_path": path}):
        loop = am.adapt(bar.problem, mesh, max_nodes=120, rtol=rtol, **options)
        results += [step.result for step in loop]
    assert len(results) >= 7
    for result in results:
        assert result.rtol == rtol and result.checked.energy_error <= rtol
    for act in (
        lambda **options: am.solve(bar, am.ActiveSet(), **options),
        lambda **options: am.solve_path(bar, path, am.ActiveSet(), **options),
        lambda **options: am.adapt(bar.problem, mesh, solver=am.ActiveSet(), **options),
    ):
        with pytest.raises(ValueError, match="rtol must not be given with a solver"):
            act(rtol=rtol)
    with pytest.raises(ValueError, match="rtol must be > 0 and < 1"):
        am.solve_path(bar, path, rtol=0.0)
