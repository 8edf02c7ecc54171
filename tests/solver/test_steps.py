"""Methods of the user's own: state in, state out; the parts of the truncated step."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from bodies import UPPER_ON_LOWER, bar_hierarchy, bar_on_block, bumpy
from norms import far
from refused import refused
from scipy import sparse
from scipy.sparse.linalg import spsolve

import adaptmg as am
from adaptmg.solver.record import Run
from adaptmg.solver.truncated import TruncatedRun


class Sweeps:
    """Projected Gauss-Seidel as a method."""

    rtol = 1e-6
    max_cycles = 400

    def __init__(self, change=lambda state: state, start_cycles=1):
        self.change = change
        self.start_cycles = start_cycles
        self.levels = []
        self.hierarchies = []

    def setup(self, hierarchy, start):
        self.levels.append(len(hierarchy))
        self.hierarchies.append(hierarchy)
        self.problem = am.smoother.local_system(hierarchy.finest.discrete)
        return self

    def step(self, state):
        unknowns = state.unknowns.copy()
        problem = self.problem
        smoother = am.ProjectedGaussSeidel(omega=1.7)
        passes = smoother.smooth(problem.system, problem.contact, problem.load, unknowns, 10)
        return self.change(am.State(unknowns=unknowns, passes=passes))


@pytest.fixture(scope="module")
def bar():
    return am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4, 8))


@pytest.fixture(scope="module")
def exact(bar):
    return am.solve(bar, am.ActiveSet())


def error(result, exact, grids):
    discrete = grids.finest.discrete
    difference = (result.displacement - exact.displacement).reshape(-1)
    size = exact.displacement.reshape(-1)
    squares = [v @ (discrete.matrix @ v) for v in (difference, size)]
    return np.sqrt(squares[0] / squares[1])


def test_a_method_gets_nested_start_history_work_and_certificate(bar, exact):
    method = Sweeps()
    result = am.solve(bar, method, reference=exact)
    assert method.levels == [2, 3]
    assert result.status.ok and error(result, exact, bar) <= 1.05 * method.rtol
    assert result.certificate().energy_error <= method.rtol
    assert result.history["true_error"][-1] == pytest.approx(
        error(result, exact, bar), rel=1e-3, abs=1e-9
    )
    # ten passes a step, and one for the residual after it
    passes = np.diff(result.history["work_units"])
    np.testing.assert_allclose(passes, 11.0)
    assert result.path[-result.cycles :] == [(2, "smooth", 1)] * result.cycles
    # the start: Newton steps on the coarsest level, a pass each, and a step of ten on the next
    coarse, middle, fine = (level.matrix.nnz for level in bar.levels)
    newton = (result.start_work_units * fine - 10 * middle) / coarse
    assert newton == pytest.approx(round(newton)) and newton >= 1
    before = [visit[:2] for visit in result.path[: -result.cycles]]
    assert before == [(0, "solve"), (1, "start"), (1, "smooth"), (2, "start")]
    from_zero = am.solve(bar, Sweeps(start_cycles=0))
    assert from_zero.cycles > result.cycles and from_zero.start_work_units == 0
    given = am.solve(bar, Sweeps(), start=exact)
    assert given.cycles <= 2


@pytest.mark.parametrize(
    "correction", [am.Truncated(), am.Monotone()], ids=["truncated", "monotone"]
)
def test_cycles_of_the_package_go_from_state_to_state(correction, bar, exact):
    """The same state leads to the same one, other unknowns are a start; as a user-defined method
    they end as soon as the package's method does."""
    method = am.Multigrid(correction=correction, rtol=1e-6)
    stepper = method.setup(bar)
    start = am.State(unknowns=np.zeros(bar.finest.discrete.n_dofs))
    first = stepper.step(start)
    with pytest.raises(ValueError, match="read-only"):
        first.unknowns[0] = 1.0
    second = stepper.step(first)
    assert second.cycles == 2 and second.passes > 0
    np.testing.assert_array_equal(stepper.step(first).unknowns, second.unknowns)
    changed = stepper.step(replace(second, unknowns=start.unknowns))
    np.testing.assert_allclose(
        changed.unknowns, first.unknowns, atol=1e-12 * np.abs(first.unknowns).max()
    )
    with pytest.raises(ValueError, match="unknowns must be of the finest level"):
        stepper.step(am.State(unknowns=np.zeros(3)))
    with pytest.raises(TypeError, match="state must be a State"):
        stepper.step(start.unknowns)

    class Driven:
        rtol = 1e-6
        start_cycles = 0
        setup = staticmethod(method.setup)

    result = am.solve(bar, Driven())
    assert result.status.ok and error(result, exact, bar) <= 1.05e-6
    assert abs(result.cycles - am.solve(bar, method).cycles) <= 2


def arrays_of(state):
    """All arrays that a state holds, copied."""
    held = [state.iterate, state.residual, state.coarse_residual, *vars(state.contact).values()]
    held += [array for pair in (*state.past, *state.uniform) for array in pair]
    return [array.copy() for array in held if isinstance(array, np.ndarray)]


@pytest.mark.parametrize("poisson", [0.3, 0.4999])
@pytest.mark.parametrize("sides", ["held", "floating"])
def test_truncated_steps_remember_nothing_but_the_state(sides, poisson):
    """A step leaves its state unchanged, and whatever steps come between, it leads to the same."""
    problem = replace(
        am.cases.greco_bar(law=am.Coulomb(0.4)),
        material=am.PlaneStrain(young=1.3e11, poisson=poisson),
        elements="smoothed",
    )
    if sides == "floating":
        loads = [am.Pressure(side, size) for side, size in BALANCED.items()]
        problem = replace(problem, supports=(), loads=tuple(loads), reference={})
    grids = am.Hierarchy.uniform(problem, (2, 4, 8))
    steps = TruncatedRun(am.Truncated(), grids, Run(unit=1), 1e-8, 50).steps_on(2)
    states = [steps.begin(np.zeros(grids.finest.discrete.n_unknowns))]
    for _ in range(6):
        states.append(steps.step(states[-1]))
    assert len({state.contact.codes.tobytes() for state in states}) > 2
    for state, following in zip(states[-2::-1], states[:0:-1], strict=True):
        before = arrays_of(state)
        again = steps.step(state)
        for one, other in zip(arrays_of(state), before, strict=True):
            np.testing.assert_array_equal(one, other)
        size = np.abs(following.iterate).max()
        np.testing.assert_allclose(again.iterate, following.iterate, rtol=0, atol=1e-12 * size)


BALANCED = {"top": 5e7, "left": 1.6e8, "right": 1.5e8}


def test_memory_goes_from_step_to_step_and_starts_empty_on_each_level(bar):
    seen = []

    class Counting(Sweeps):
        def step(self, state):
            seen.append(state.memory)
            count = 0 if state.memory is None else state.memory
            return replace(state, unknowns=super().step(state).unknowns, memory=count + 1)

    result = am.solve(bar, Counting())
    assert seen[0] is None and seen[1:] == [None, *range(1, result.cycles)]
    # a step that names no passes has none: the residual after it is one
    np.testing.assert_allclose(np.diff(result.history["work_units"]), 1.0)


def test_a_method_that_converges_to_something_else_is_found_out(bar):
    biased = Sweeps(lambda state: am.State(unknowns=0.999 * state.unknowns))
    biased.max_cycles = 40
    assert not am.solve(bar, biased, throw=False).status.ok
    wild = Sweeps(lambda state: am.State(unknowns=np.full_like(state.unknowns, np.nan)))
    with pytest.raises(am.NotConverged, match=r"DIVERGED.* what user-defined parts return"):
        am.solve(bar, wild)


def test_what_a_method_must_offer(bar):
    cases = {
        "step": (lambda hierarchy, start: object(), TypeError),
        "am.State": (lambda hierarchy, start: Returns(None), TypeError),
        r"shape \(162,\)": (
            lambda hierarchy, start: Returns(am.State(unknowns=np.zeros(3))),
            ValueError,
        ),
    }
    for words, (setup, error_type) in cases.items():
        method = Sweeps(start_cycles=0)
        method.setup = setup
        with pytest.raises(error_type, match=words):
            am.solve(bar, method)
    spaces = am.Hierarchy.algebraic(bar.finest.discrete, max_coarse=60)
    with pytest.raises(ValueError, match="only spaces"):
        am.solve(spaces, Sweeps())
    method = Sweeps()
    method.rtol = -1.0
    with pytest.raises(ValueError, match="rtol of solver"):
        am.solve(bar, method)


def test_a_residual_in_the_state_spares_a_pass(bar):
    class WithResidual(Sweeps):
        def step(self, state):
            new = super().step(state)
            return replace(new, residual=self.problem.residual(new.unknowns))

    without, result = am.solve(bar, Sweeps()), am.solve(bar, WithResidual())
    np.testing.assert_array_equal(result.displacement, without.displacement)
    np.testing.assert_array_equal(result.history["residual"], without.history["residual"])
    np.testing.assert_allclose(np.diff(result.history["work_units"]), 10.0)
    short = Sweeps(lambda state: replace(state, residual=np.zeros(3)))
    with pytest.raises(ValueError, match="residual of the State that step returns"):
        am.solve(bar, short)


class Returns:
    def __init__(self, value):
        self.value = value

    def step(self, state):
        return self.value


class ByLU:
    """The coarse problems, solved exactly."""

    def __repr__(self):
        return "ByLU()"

    def setup(self, matrices, prolongations):
        for prolongation, fine, coarse in zip(
            prolongations, matrices[1:], matrices[:-1], strict=True
        ):
            assert prolongation.shape == (fine.shape[0], coarse.shape[0])
        self.matrix = sparse.csc_array(matrices[-1])
        return self

    def solve(self, rhs):
        return spsolve(self.matrix, rhs)


CORRECTIONS = [
    *(am.Cycle(shape="V", pre=pre, post=post) for pre, post in [(1, 1), (2, 2), (3, 3), (0, 3)]),
    am.Cycle(shape="V", pre=5, post=0),
    am.Cycle(shape="V", pre=4, post=1),
    am.Cycle(shape="W", pre=1, post=1),
    am.Cycle(shape="F", pre=1, post=2),
    am.PyAMG(),
    am.PyAMG(cycle="W", smoother="sor", cycles=2),
    ByLU(),
]


@pytest.mark.parametrize("correct", CORRECTIONS, ids=str)
def test_every_linear_correction_leads_to_the_same_solution(correct, exact, bar):
    solver = am.FullMultigrid(correction=am.Truncated(correct=correct), rtol=1e-8)
    result = am.solve(bar, solver)
    assert result.status.ok and not result.fallback
    assert error(result, exact, bar) <= 1.05e-8


def test_more_smoothing_and_more_visits_take_fewer_cycles():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4, 8, 16, 32))

    def run(correct):
        correction = am.Truncated(correct=correct, recombine=0)
        return am.solve(grids, am.Multigrid(correction=correction, rtol=1e-6))

    few, many = run(am.Cycle(pre=1, post=1)), run(am.Cycle(pre=3, post=3))
    twice, exactly = run(am.Cycle(shape="W", pre=1, post=1)), run(ByLU())
    assert many.cycles < few.cycles and twice.cycles < few.cycles
    assert exactly.cycles <= twice.cycles + 1
    assert many.work_units > few.work_units and twice.work_units > few.work_units


@pytest.mark.parametrize("part", ["coarse_contact", "rigid_motions", "search"])
def test_parts_that_are_left_out_change_no_solution(part, exact, bar):
    correction = am.Truncated(**{part: False}, interface_sweeps=0, recombine=1)
    result = am.solve(bar, am.Multigrid(correction=correction))
    assert result.status.ok and error(result, exact, bar) <= 1.05e-8


class BackAndForth:
    """The sweeps of the default, by the public smoother."""

    def smooth(self, system, contact, load, unknowns, sweeps):
        for order in ("backward", "forward"):
            sweep = am.ProjectedGaussSeidel(order=order)
            sweep.smooth(system, contact, load, unknowns, sweeps)
        return 0.0  # and one for the residual, as the default


class CutSlips:
    """The projection of the default, written out."""

    def project(self, contact, before, after):
        rubs = (contact.limit > 0) | ((before[:, 0] >= contact.gap) & (contact.friction > 0))
        earlier, slip = (values[:, 1:] - contact.slip_reference for values in (before, after))
        turned = rubs & earlier.any(axis=1) & (np.einsum("nt,nt->n", earlier, slip) <= 0)
        after[turned, 1:] = contact.slip_reference[turned]
        return after


@cache
def cases_of_parts():
    pair = bar_on_block(am.Coulomb(0.5), UPPER_ON_LOWER, gap=bumpy)
    rubber = replace(
        am.cases.greco_bar(law=am.Coulomb(0.4)),
        material=am.PlaneStrain(young=1.3e11, poisson=0.4999),
        elements="smoothed",
    )
    soft = am.Contact("bottom", am.Plane((0, 0), (0, 1)), compliance=am.NormalCompliance(1e-13))
    rough = replace(am.cases.greco_bar(law=am.Coulomb(0.5)), contact=soft)
    weaker = am.StateLaw(lambda pressure, slip: 0.1 + 0.3 / (1 + pressure / 50e6))
    torsion = am.cases.elastic_plastic_torsion()
    discs = [am.mesh.graded(torsion.domain, size) for size in (0.4, 0.2, 0.1)]
    sizes = (20e-3, 10e-3, 5e-3)
    return {
        "bar": am.Hierarchy.uniform(am.cases.greco_bar(), (2, 4, 8)),
        "graded": am.Hierarchy.graded(am.cases.greco_bar(), sizes=sizes, contact_ratio=2),
        "block": am.Hierarchy.uniform(am.cases.greco_block(law=am.Coulomb(0.5)), (1, 2, 4)),
        "pair": bar_hierarchy(pair, 2),
        "rubber": am.Hierarchy.uniform(rubber, (2, 4, 8)),
        "rough": am.Hierarchy.uniform(rough, (2, 4, 8)),
        "state law": am.Hierarchy.uniform(am.cases.greco_bar(law=weaker), (2, 4, 8)),
        "torsion": am.Hierarchy.from_meshes(torsion, discs),
    }


@pytest.mark.parametrize("part", [{"smooth": BackAndForth()}, {"project": CutSlips()}], ids=list)
@pytest.mark.parametrize(
    "case", ["bar", "graded", "block", "pair", "rubber", "rough", "state law", "torsion"]
)
def test_user_defined_sweeps_and_projections_give_the_iterates_of_the_default(case, part):
    grids = cases_of_parts()[case]
    for method in (am.FullMultigrid, am.Multigrid):
        expected = am.solve(grids, method())
        result = am.solve(grids, method(correction=am.Truncated(**part)))
        assert result.cycles == expected.cycles and far(result, expected) <= 1e-9
        if case != "graded":
            # a coarse level counts the smoother with its nonzeros, which include those of empty rows
            assert result.work_units == pytest.approx(expected.work_units, rel=1e-12)
        for name in ("residual", "status_changes"):
            first, last = (run.history[name][:3] for run in (expected, result))
            np.testing.assert_allclose(last, first, rtol=1e-6, atol=1e-12)


def test_user_defined_parts_follow_a_load_path(bar):
    path = am.LoadPath({"left": [0.5, 1, 0.5, 0]}, default=1.0)
    parts = am.Truncated(smooth=BackAndForth(), project=CutSlips())
    expected = am.solve_path(bar, path)
    for one, other in zip(
        am.solve_path(bar, path, am.FullMultigrid(correction=parts)), expected, strict=True
    ):
        assert one.cycles == other.cycles and far(one, other) <= 1e-8


@pytest.mark.parametrize("plastic", [False, True])
def test_a_method_gets_the_hierarchy_of_the_user_in_each_load_step(plastic):
    problem = am.cases.greco_bar()
    if plastic:
        soft = am.Plastic(problem.material, yield_stress=1e8, hardening=1e10)
        problem = replace(problem, material=soft)
    grids = am.Hierarchy.graded(problem, (20e-3, 10e-3), 2, am.PseudoL2(), contact_rows=False)
    method = Sweeps(start_cycles=0)
    am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0]}), method)
    assert len(method.hierarchies) >= 2
    for hierarchy in method.hierarchies:
        assert isinstance(hierarchy, am.Hierarchy)
        assert hierarchy.transfer is grids.transfer and not hierarchy.contact_rows


def test_more_sweeps_on_the_finest_level_take_fewer_cycles():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), (4, 8, 16, 32))
    over = am.ProjectedGaussSeidel(omega=1.3, order="symmetric")
    once, four, relaxed = (
        am.solve(grids, am.Multigrid(correction=am.Truncated(smooth=smooth, recombine=0)))
        for smooth in (1, 4, over)
    )
    assert four.cycles < once.cycles and four.work_units > once.work_units
    assert far(four, once) <= 2e-8 and far(relaxed, once) <= 2e-8


test_options_of_the_parts_are_checked = refused(
    (
        lambda: am.Truncated(smooth="twice"),
        TypeError,
        "smooth must be a number of sweeps or offer smooth",
    ),
    (lambda: am.Truncated(smooth=0), "smooth must be >= 1"),
    (lambda: am.Truncated(recombine=5), "recombine must be <= 4, got 5"),
    (lambda: am.Truncated(project=3), TypeError, "project must be None or offer"),
    (lambda: am.Truncated(correct=am.Cycle(shape="complete")), "shape of correct"),
    (lambda: am.Truncated(correct=3), TypeError, "correct"),
    (
        lambda: am.Truncated(correct=am.PyAMG(), coarse_solve=ByLU()),
        "coarse_solve must be None",
    ),
    (lambda: am.PyAMG(smoother="nobody"), "smoother"),
)


class Overshooting(ByLU):
    """Goes far beyond the solution below the level before the finest."""

    def __init__(self, factor):
        self.factor = factor

    def setup(self, matrices, prolongations):
        self.now = self.factor if len(matrices) == 1 else 1.0
        return super().setup(matrices, prolongations)

    def solve(self, rhs):
        return self.now * super().solve(rhs)


def test_a_nested_start_that_diverges_is_left_out(bar):
    honest, far = (
        am.solve(
            bar,
            am.FullMultigrid(
                correction=am.Truncated(correct=Overshooting(factor), recombine=0),
                start=am.NestedStart(cycles=4),
            ),
        )
        for factor in (1.0, 100.0)
    )
    # from what those cycles lead to it is 17 times as large, and takes 6 cycles more
    assert far.history["residual"][0] <= 4 * honest.history["residual"][0]
    assert not far.fallback and far.cycles <= honest.cycles + 2
