"""The active set method: its steps are few, from any start; that they are right:
tests/agreement."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from norms import far as closeness
from scipy import sparse
from smoother_problems import network

import adaptmg as am

CASES = {
    "bar, friction 1": lambda: am.cases.greco_bar(law=am.Coulomb(1.0)),
    "bar, Tresca": lambda: am.cases.greco_bar(law=am.Tresca(4e7)),
    "curved, frictionless": lambda: am.cases.curved_obstacle(),
    "block, friction 1": lambda: am.cases.greco_block(law=am.Coulomb(1.0), plane_strain=False),
}


@cache
def grids(name: str) -> am.Hierarchy:
    return am.Hierarchy.uniform(CASES[name](), (2, 4) if name.startswith("block") else (4, 8, 16))


@cache
def solved(name: str) -> am.Result:
    return am.solve(grids(name), am.ActiveSet())


@pytest.mark.parametrize("name", ["bar, friction 1", "block, friction 1", "bar, Tresca"])
def test_solution_does_not_depend_on_the_start(name):
    expected = solved(name).displacement
    for seed in range(2):
        start = 1e-5 * np.random.default_rng(seed).normal(size=expected.shape)
        assert closeness(am.solve(grids(name), am.ActiveSet(), start=start), expected) < 1e-10
    for start in (solved(name), expected):
        again = am.solve(grids(name), am.ActiveSet(), start=start)
        assert again.cycles == 1 and closeness(again, expected) < 1e-13
    # on the whole matrix a derivative that is wrong by a tenth costs two steps and more
    assert am.solve(grids(name), am.ActiveSet(condensed=False)).cycles <= 9


@pytest.mark.parametrize("law", [am.Tresca(0.5), am.Coulomb(0.5)])
@pytest.mark.parametrize("dim", [2, 3])
def test_steps_do_not_depend_on_the_unit_of_force(dim, law):
    """One of the contact nodes slips along a tangent that a support holds."""
    one = network(dim, "tresca", fixed_tangent=True).discrete
    small = law if isinstance(law, am.Coulomb) else am.Tresca(0.5e-6)
    results = [
        am.solve(problem, am.ActiveSet(start="held"))
        for problem in (
            replace(one, law=law),
            replace(one, matrix=1e-6 * one.matrix, load=1e-6 * one.load, law=small),
        )
    ]
    assert results[0].cycles == results[1].cycles
    assert closeness(*results) < 1e-9


@pytest.mark.parametrize(("friction", "most"), [(0.2, 10), (1.0, 11), (2.0, 13)])
def test_steps_are_few_and_fewer_from_coarser_grids(friction, most):
    hierarchy = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Coulomb(friction)), (4, 8, 16, 32))
    cold, nested = (
        am.solve(hierarchy, am.ActiveSet()),
        am.solve(hierarchy, am.ActiveSet(nested_start=True)),
    )
    assert cold.cycles <= most and nested.cycles <= 4
    assert nested.start_work_units > 0 == cold.start_work_units
    assert {level for level, _, _ in nested.path} == {0, 1, 2, 3}
    assert {level for level, _, _ in cold.path} == {3}


def test_steps_on_the_whole_matrix_follow_friction_that_depends_on_pressure():
    """At the same contact status the matrix changes with the friction: with that of an earlier step
    the steps are twice as many."""
    law = am.StateLaw(lambda pressure, slip: 0.5 / (1 + pressure / 3e7))
    hierarchy = am.Hierarchy.uniform(am.cases.greco_bar(law=law), (8, 16))
    condensed, whole = (
        am.solve(hierarchy, am.ActiveSet(condensed=option, start="held")).cycles
        for option in (True, False)
    )
    assert whole <= condensed


def test_band_round_a_drum_slips_as_the_belt_equation_has_it():
    # pulled at both ends it slips towards each of them, from a point where friction turns round
    friction = 0.2
    thickness = 0.01
    pulls = np.array([1.0, 1.8]) * 1e6
    angle = np.random.default_rng(5).uniform(0, 2 * np.pi)
    along = np.array([np.cos(angle), np.sin(angle)])
    away = np.array([-along[1], along[0]])
    outer = 1 + thickness
    band = am.Outline(
        vertices=tuple(
            tuple(map(float, x))
            for x in (outer * along, outer * away, -outer * along, -along, away, along)
        ),
        boundaries=("outer", "outer", "low", "inner", "inner", "high"),
        arcs=dict.fromkeys((0, 1, 3, 4), (0.0, 0.0)),
    )
    problem = am.ContactProblem(
        domain=band,
        contact=am.Contact("inner", am.GapFunction(lambda x: np.zeros(len(x)))),
        law=am.Coulomb(friction),
        material=am.PlaneStrain(young=2e11, poisson=0.3),
        loads=tuple(
            am.Traction(end, tuple(-pull * away))
            for end, pull in zip(("low", "high"), pulls, strict=True)
        ),
    )
    band_grids = am.Hierarchy.graded(problem, (thickness, 0.75 * thickness), contact_ratio=1)
    ends = pulls * thickness
    least = np.sqrt(ends.prod()) * np.exp(-friction * np.pi / 2)
    expected = (ends.sum() - 2 * least) / friction
    for solver, cycles in ((None, 60), (am.ActiveSet(), 30)):
        result = am.solve(band_grids, solver)
        assert result.cycles <= cycles
        assert result.contact.force_n.sum() == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize(
    "solution",
    [
        lambda problem: am.solve(problem, am.ActiveSet()),
        lambda problem: am.solve_path(problem, am.LoadPath(), am.ActiveSet())[0],
    ],
)
def test_entries_of_the_matrix_that_a_user_changes_between_solves_count(solution):
    """Two nodes on springs, the first one on an obstacle: their springs are exchanged."""
    discrete = am.DiscreteProblem(
        matrix=sparse.diags_array([1.0, 1.0, 2.0, 2.0]),
        load=np.array([1.0, -1.0, 1.0, 1.0]),
        fixed=np.zeros(4, dtype=bool),
        contact=am.ContactNodes(nodes=[0], normals=[[0.0, -1.0]], gaps=[0.0]),
    )
    for first, second in ((1.0, 2.0), (2.0, 1.0)):
        expected = [[1 / first, 0.0], [1 / second, 1 / second]]
        np.testing.assert_allclose(solution(discrete).displacement, expected, atol=1e-14)
        entries = discrete.matrix.data
        entries[...] = entries[::-1].copy()


def test_entries_that_are_changed_count_in_each_problem_of_a_matrix():
    bar = am.Hierarchy.uniform(am.cases.greco_bar(), (4, 8))
    smooth = bar.with_problem(am.cases.greco_bar(law=am.Frictionless()))
    for hierarchy in (bar, smooth):
        assert am.solve(hierarchy, am.ActiveSet()).status.ok
    bar.finest.discrete.matrix.data[...] *= 0.5
    for hierarchy in (smooth, bar):
        result = am.solve(hierarchy, am.ActiveSet(), throw=False)
        assert "stiffness" in result.certificate().contradictions(1e-6)


def test_work_of_direct_steps_is_a_residual_each():
    result = am.solve(grids("bar, friction 1"), am.ActiveSet(start="held"))
    assert result.work_units == pytest.approx(result.cycles + 1) and result.timings["factorise"] > 0
    assert list(result.history["cycle"]) == list(range(result.cycles + 1))
    assert result.history["active"][-1] == np.count_nonzero(result.contact.state != am.OPEN)
    assert result.history["slip"][-1] == np.count_nonzero(result.contact.state == am.SLIP)


def cantilever(slenderness: int, law: object) -> am.Hierarchy:
    """A beam clamped at one end, its load three times what lets the tip touch a plane."""
    height, length, gap = 1e-3, 1e-3 * slenderness, 1e-5 * slenderness
    pressure = 3 * 8 * 2.1e11 / 0.91 * height**3 / 12 * gap / length**4
    problem = am.ContactProblem(
        name="cantilever",
        material=am.PlaneStrain(young=2.1e11, poisson=0.3),
        law=law,
        domain=am.Rectangle(width=length, height=height),
        contact=am.Contact("bottom", am.Plane((0.0, -gap), (0.0, 1.0))),
        loads=am.Pressure("top", pressure),
        supports=am.Support("left", x=0.0, y=0.0),
    )
    return am.Hierarchy.uniform(problem, [(slenderness * across, across) for across in (1, 2, 4)])


@pytest.mark.parametrize(
    ("slenderness", "law"),
    [
        *((24, law) for law in (am.Frictionless(), am.Coulomb(0.3), am.Tresca(1e4))),
        (6, am.Coulomb(1.0)),
        (96, am.Frictionless()),
        (96, am.Coulomb(0.3)),
    ],
)
def test_slenderness_costs_neither_steps_nor_cycles(slenderness, law):
    grids = cantilever(slenderness, law)
    exact = am.solve(grids, am.ActiveSet(rtol=1e-7))
    # at 96 : 1 rounding decides: entries that change by 2e-16 of them lead to 13 to 34 steps
    assert exact.cycles <= (24 if slenderness < 96 else 40)
    assert (exact.contact.state != am.OPEN).any()
    for solver in (am.FullMultigrid(rtol=1e-6), am.Multigrid(rtol=1e-6)):
        result = am.solve(grids, solver, reference=exact)
        assert (
            result.cycles <= 20
            and not result.fallback
            and result.history["true_error"][-1] < 1.5e-6
        )


@pytest.mark.parametrize("name", CASES)
def test_linear_solvers_get_the_symmetry_and_modes_of_what_moves(name):
    class Watching:
        def setup(
            self, matrix, near_nullspace=None, *, symmetric=True, preconditioner=None, **options
        ):
            dense = matrix.toarray()
            assert (np.abs(dense - dense.T).max() < 1e-12 * np.abs(dense).max()) == symmetric
            assert (
                preconditioner is None
                or abs(preconditioner - preconditioner.T).max() < 1e-12 * abs(matrix).max()
            )
            assert near_nullspace.any() and not near_nullspace[(dense != 0).sum(axis=1) == 1].any()
            seen.append(symmetric)
            return am.Direct().setup(matrix, symmetric=symmetric)

    seen = []
    for problem in (
        grids(name),
        replace(grids(name).finest.discrete, coordinates=None, near_nullspace=None),
    ):
        am.solve(problem, am.ActiveSet(linear=Watching()))
    assert all(seen) is ("friction " not in name)


def test_too_few_steps_are_reported_and_wrong_options_refused():
    with pytest.raises(am.NotConverged, match="LIMIT after 1 cycles") as caught:
        am.solve(grids("bar, friction 1"), am.ActiveSet(max_steps=1))
    result = caught.value.result
    assert result.status is am.Status.LIMIT and result.residual > 1e-3 and result.cycles == 1
    with pytest.raises(ValueError, match="condensed=True needs"):
        am.ActiveSet(linear=am.AMG(), condensed=True)


class Unconverged:
    """Half of each solution, as of a solver that did not get further."""

    def setup(self, matrix, near_nullspace=None, symmetric=True, **others):
        exactly = am.Direct().setup(matrix, symmetric=symmetric)

        def solve(*given, **asked):
            solution = exactly.solve(*given, **asked)
            return replace(solution, unknowns=0.5 * solution.unknowns, converged=False)

        return SimpleNamespace(solve=solve)


def test_a_linear_solver_that_does_not_converge_spoils_no_result(caplog):
    solver = am.ActiveSet(linear=Unconverged(), max_steps=5)
    result = am.solve(grids("bar, Tresca"), solver, throw=False)
    assert not result.status.ok
    assert "take Direct()" in caplog.text


@pytest.mark.parametrize("friction", [0.3, 3.0])
def test_a_block_wedged_between_walls_needs_no_load(friction):
    """Nothing slips before it is pressed; walls balance each other."""
    walls = {
        "bottom": am.Plane((0.0, 1e-4), (0.1, 1.0)),
        "top": am.Plane((0.0, 1 - 1e-4), (0.1, -1.0)),
        "left": am.Plane((1e-5, 0.0), (1.0, 0.0)),
    }
    problem = am.ContactProblem(
        domain=am.Rectangle(width=1.0, height=1.0),
        material=am.PlaneStrain(young=1e9, poisson=0.3),
        law=am.Coulomb(friction),
        contact=[am.Contact(name, wall, allow_interference=True) for name, wall in walls.items()],
    )
    result = am.solve(am.Hierarchy.uniform(problem, (8,)), am.ActiveSet())
    forces = [result.resultant(name).force for name in walls]
    np.testing.assert_allclose(sum(forces), 0.0, atol=1e-9 * np.abs(forces).max())
    assert np.abs(forces).max() > 1e3
