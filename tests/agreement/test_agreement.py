"""Agreement: every method finds one solution for each law in 2D, 3D, axisymmetry and between
bodies."""

from dataclasses import replace
from functools import cache

import bodies
import numpy as np
import pytest
from bodies import LOWER_ON_UPPER, UPPER_ON_LOWER
from norms import distance

import adaptmg as am

LAWS = {"frictionless": am.Frictionless(), "tresca": am.Tresca(3e7), "coulomb": am.Coulomb(0.5)}


def wavy(points: np.ndarray) -> np.ndarray:
    """Gaps that leave some nodes open, m."""
    return 5e-6 * (1 + np.sin(points[:, 0] * 300)) + 1e-5 * points[:, -1]


def bar(law: am.problem.Law, gap=None) -> am.ContactProblem:
    problem = replace(am.cases.greco_bar(), law=law, reference={})
    return problem if gap is None else replace(problem, contact=am.Contact("bottom", gap))


def block(law: am.problem.Law) -> am.ContactProblem:
    return replace(
        am.cases.greco_block(plane_strain=False),
        law=law,
        reference={},
        contact=am.Contact("bottom", am.GapFunction(wavy)),
    )


def round_bar(law: am.problem.Law) -> am.ContactProblem:
    """A disc pressed onto a wavy plane and squeezed from outside, axisymmetric."""
    return am.ContactProblem(
        material=am.Axisymmetric(young=1.3e11, poisson=0.2),
        law=law,
        domain=am.Rectangle(width=0.04, height=0.04),
        contact=am.Contact("bottom", am.GapFunction(wavy)),
        supports=(am.Support("left", x=0.0),),
        loads=(am.Pressure("top", 5e7), am.Pressure("right", 9e7)),
    )


def curved(law: am.problem.Law) -> am.ContactProblem:
    """A block on a curved obstacle; Coulomb's coefficient grows along it."""
    varying = am.Coulomb(lambda x: 0.2 + 5 * x[:, 0]) if isinstance(law, am.Coulomb) else law
    return replace(am.cases.curved_obstacle(), law=varying, reference={})


def moved(law: am.problem.Law) -> am.ContactProblem:
    """A block pressed onto a bowl by a support that moves."""
    return am.ContactProblem(
        material=am.PlaneStrain(young=1e11, poisson=0.3),
        domain=am.Rectangle(width=0.1, height=0.05),
        law=law,
        contact=am.Contact(
            "bottom", am.GapFunction(lambda x: 2e-3 * (10 * x[:, 0] - 0.5) ** 2 / 40)
        ),
        supports=(am.Support("top", x=5e-5, y=-1e-4),),
    )


@cache
def grids(case: str, law: str) -> am.Hierarchy:
    given = LAWS[law]
    if case == "graded":
        return am.Hierarchy.graded(bar(given), sizes=(16e-3, 8e-3, 4e-3), contact_ratio=3)
    if case in ("pair", "held"):
        pair = UPPER_ON_LOWER if case == "pair" else LOWER_ON_UPPER
        return bodies.bar_hierarchy(bodies.bar_on_block(given, pair, gap=bodies.bumpy), 2)
    posed = {
        "bar": (bar, (4, 8, 16)),
        "wavy": (lambda law: bar(law, am.GapFunction(wavy)), (4, 8, 16)),
        "block": (block, (2, 4)),
        "round": (round_bar, (4, 8, 16)),
        "moved": (moved, ((8, 4), (16, 8))),
        "curved": (curved, (4, 8, 16)),
    }
    problem, divisions = posed[case]
    return am.Hierarchy.uniform(problem(given), divisions)


@cache
def reference(case: str, law: str) -> am.Result:
    return am.solve(grids(case, law), am.ActiveSet(rtol=1e-12))


CASES = ("bar", "wavy", "block", "round", "moved", "curved", "graded", "pair", "held")
TRUNCATED = am.FullMultigrid(rtol=1e-10)
MONOTONE = am.Multigrid(correction=am.Monotone(), rtol=1e-10, max_cycles=400)
METHODS = {
    "single": am.SingleGrid(rtol=1e-10, omega=1.7),
    "condensed": am.SingleGrid(rtol=1e-10, condensed=True),
    "monotone": MONOTONE,
    "monotone nested": am.FullMultigrid(correction=am.Monotone(), rtol=1e-10, max_cycles=400),
    "truncated": am.Multigrid(rtol=1e-10),
    "truncated nested": TRUNCATED,
    "sparse": am.ActiveSet(condensed=False),
    "pyamg": am.ActiveSet(linear=am.AMG()),
    "levels": am.ActiveSet(nested_start=True),
}
#: what else a cycle or a smoother may be, on the bar and the block alone
VARIANTS = {
    "W": replace(MONOTONE, cycle=am.Cycle(shape="W", pre=1, post=1)),
    "complete": am.FullMultigrid(
        correction=am.Monotone(), cycle=am.Cycle(shape="complete"), rtol=1e-10
    ),
    "F": am.FullMultigrid(correction=am.Monotone(), cycle=am.Cycle(shape="F"), rtol=1e-10),
    "minmod": am.FullMultigrid(
        correction=am.PaperCorrection(slip="minmod", limit="summed"), rtol=1e-10
    ),
    "discretised": replace(MONOTONE, coarse_matrices="discretised"),
    "no recombination": am.Multigrid(correction=am.Truncated(recombine=0), rtol=1e-10),
    "one recombined": am.Multigrid(correction=am.Truncated(recombine=1), rtol=1e-10),
    "symmetric sweeps": replace(MONOTONE, smoother=am.ProjectedGaussSeidel(order="symmetric")),
}


def assert_contact_conditions(result: am.Result, problem: am.DiscreteProblem) -> None:
    """The certificate, which shares no code with the methods, and the limits of friction that it
    does not read."""
    assert result.certificate().contradictions(result.rtol) == ()
    limit, friction = problem.law.bounds(len(result.contact))
    force = result.contact.force_n
    np.testing.assert_allclose(
        result.contact.limit, limit + friction * force, atol=1e-12 * np.abs(force).max()
    )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("case", CASES)
def test_the_reference_solves_the_conic_programme(case, law):
    Conic = pytest.importorskip("conic", reason="clarabel is not installed").Conic
    problem, result = grids(case, law).finest.discrete, reference(case, law)
    limit, friction = problem.law.bounds(len(problem.contact))
    programme = Conic(problem)
    unknowns, pressure = (
        programme.coulomb(friction, limit) if friction.any() else programme.solve(limit)
    )
    assert distance(problem, result.displacement, problem.physical(unknowns)) <= 1e-8
    assert np.abs(result.contact.force_n - pressure).max() <= 1e-8 * pressure.max()
    assert_contact_conditions(result, problem)


def check(case: str, law: str, solver: am.Multigrid) -> None:
    """Energy norm, contact conditions, states, residual, and an error estimate that does not
    flatter."""
    hierarchy, expected = grids(case, law), reference(case, law)
    problem = hierarchy.finest.discrete
    result = am.solve(hierarchy, solver, reference=expected)
    error = distance(problem, result.displacement, expected.displacement)
    assert error <= 1e-9
    assert result.history["true_error"][-1] == pytest.approx(error, rel=0.05, abs=1e-11)
    assert error <= 5 * max(result.error_estimate, 1e-12)
    assert result.residual <= 1e-8
    assert np.array_equal(result.contact.state, expected.contact.state)
    assert_contact_conditions(result, problem)


# every method meets every case, and every law in five cases or more
@pytest.mark.parametrize(
    ("case", "law", "method"),
    [
        (case, law, method)
        for i, case in enumerate(CASES)
        for j, law in enumerate(LAWS)
        for k, method in enumerate(METHODS)
        if case in ("bar", "block", "pair") or (i + j + k) % 3 == 0
    ],
)
def test_every_method_agrees_with_the_reference(case, law, method):
    check(case, law, METHODS[method])


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(
    ("case", "law"), [("bar", "coulomb"), ("wavy", "tresca"), ("block", "coulomb")]
)
def test_variants_of_cycles_agree_too(case, law, variant):
    check(case, law, VARIANTS[variant])


def test_the_cases_have_all_states():
    for law in LAWS:
        states = set().union(*(reference(case, law).contact.state for case in CASES))
        assert states == (
            {am.OPEN, am.SLIP} if law == "frictionless" else {am.OPEN, am.SLIP, am.STICK}
        ), law
