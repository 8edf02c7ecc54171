"""The smoother: solves at a node by every law, sweeps and the natural residual on networks and
meshes."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smoother_problems import LAWS, dual_solution, network, spd, tresca_energy

import adaptmg as am
from adaptmg.smoother.conditions import natural_residual, states
from adaptmg.smoother.node_solve import _inside, slip_3d, solve_2d, solve_3d
from adaptmg.smoother.system import contact_blocks, contact_codes, contact_states, inverse_blocks

NETWORKS = [f"network {dim}D {law}" for dim in (2, 3) for law in LAWS]
MESHES = {
    "bar": lambda law: am.Hierarchy.uniform(am.cases.greco_bar(law=law), (4,)),
    "block": lambda law: am.Hierarchy.uniform(am.cases.greco_block(law=law), (2,)),
    "pair": lambda law: am.Hierarchy.uniform(
        am.cases.two_block_patch(law=law), [{"upper": 3, "lower": 4}]
    ),
    "pair 3D": lambda law: am.Hierarchy.uniform(
        am.cases.two_block_patch(law=law, dim=3), [{"upper": 1, "lower": 2}]
    ),
    "axisymmetric pair": lambda law: am.Hierarchy.graded(am.cases.hertz_sphere(law=law), (5e-3,)),
}
CASES = [*NETWORKS, *(f"{mesh}, {law}" for mesh in MESHES for law in ("tresca", "coulomb"))]
ORDERS = ["forward", "backward", "symmetric"]
every_case = pytest.mark.parametrize("case", CASES)
every_network = pytest.mark.parametrize(
    ("dim", "law"), [(dim, law) for dim in (2, 3) for law in LAWS]
)


@cache
def posed(case: str) -> tuple[am.smoother.LocalProblem, np.ndarray, float]:
    """A problem, its solution by a method that shares nothing with the smoother, and the size of
    its forces."""
    if case in NETWORKS:
        _, dim, law = case.split()
        problem = network(int(dim[0]), law, fixed_tangent=True)
        return problem, dual_solution(problem), 1.0
    mesh, law = case.split(", ")
    discrete = MESHES[mesh](
        {"tresca": am.Tresca(2e7), "coulomb": am.Coulomb(0.3)}[law]
    ).finest.discrete
    problem = am.smoother.local_system(discrete)
    exact = am.solve(discrete, am.ActiveSet(rtol=1e-13)).displacement
    return problem, problem.to_local(discrete.relative(exact)), np.linalg.norm(problem.load)


def smooth(problem, unknowns, sweeps=1, **options):
    return am.ProjectedGaussSeidel(**options).smooth(
        problem.system, problem.contact, problem.load, unknowns, sweeps
    )


def random_start(problem, seed, size=1.0):
    w = size * np.random.default_rng(seed).normal(size=problem.system.n_dofs)
    w[problem.system.fixed] = 0.0
    return w


def natural_norm(problem, unknowns):
    return np.linalg.norm(natural_residual(problem, unknowns, problem.residual(unknowns)))


@every_case
def test_blocks_of_contact_nodes_are_those_of_the_system(case):
    problem = posed(case)[0]
    system = problem.system
    expected = system.diagonal.reshape(-1, system.dim, system.dim)[system.nodes]
    found = contact_blocks(problem.discrete)
    np.testing.assert_allclose(found, expected, atol=1e-14 * np.abs(expected).max())


@every_case
def test_the_solution_alone_is_a_fixed_point_without_residual(case):
    problem, exact, force = posed(case)
    size = np.abs(exact).max()
    for options in ({}, {"omega": 1.3, "order": "symmetric"}, {"omega": 0.5, "order": "backward"}):
        w = exact.copy()
        smooth(problem, w, 2, **options)
        np.testing.assert_allclose(w, exact, atol=1e-8 * size, err_msg=str(options))
    assert natural_norm(problem, exact) <= 1e-8 * force
    stiffness = problem.system.diagonal
    for dof in np.flatnonzero(~problem.system.fixed)[::5]:
        moved = exact.copy()
        moved[dof] += 1e-3 * size
        assert natural_norm(problem, moved) > 1e-5 * size * np.abs(stiffness).min(
            initial=np.inf, where=stiffness != 0
        )


def normal_force(problem, w):
    system = problem.system
    return np.maximum(problem.residual(w).reshape(-1, system.dim)[system.nodes, 0], 0.0)


def frozen_at(problem, w):
    """The Tresca problem with the bound of an iterate."""
    contact = problem.contact
    return replace(
        problem,
        contact=replace(
            contact,
            limit=contact.limit + contact.friction * normal_force(problem, w),
            friction=np.zeros_like(contact.friction),
        ),
    )


@every_case
def test_what_every_sweep_keeps(case, seed=1):
    """No node penetrates, fixed dofs stay, the Tresca energy never rises; the last node has no
    natural residual."""
    problem, exact, force = posed(case)
    dim, rng = problem.system.dim, np.random.default_rng(seed)
    if "coulomb" in case:
        problem = frozen_at(problem, exact)
    w = random_start(problem, seed, np.abs(exact).max())
    smooth(problem, w)
    energy = [tresca_energy(problem, w)]
    for order in ORDERS * 2:
        smooth(problem, w, omega=float(rng.uniform(0.05, 1.95)), order=order)
        energy.append(tresca_energy(problem, w))
        assert (w.reshape(-1, dim)[problem.system.nodes, 0] <= problem.contact.gap).all()
        assert (w[problem.system.fixed] == 0).all()
    assert (np.diff(energy) <= 1e-12 * np.abs(energy).max()).all() and energy[-1] < energy[0]
    smooth(problem, w, order="backward")
    last = natural_residual(problem, w, problem.residual(w))[:dim]
    assert np.linalg.norm(last) <= 1e-9 * max(
        force, np.abs(problem.system.diagonal).max() * np.abs(w).max()
    )


@every_case
def test_the_natural_residual_is_the_jacobi_step(case):
    """At the first contact node of a sweep it is D times the step with the bound frozen, elsewhere
    the residual."""
    problem, exact, _ = posed(case)
    system, dim = problem.system, problem.system.dim
    w = random_start(problem, 5, np.abs(exact).max())
    linear = problem.residual(w)
    vector = natural_residual(problem, w, linear).reshape(-1, dim)
    frozen = frozen_at(problem, w)
    first = int(system.nodes.min())
    # nodes before it are not visited: they do not move
    rows = np.zeros((system.n_nodes, dim), dtype=bool)
    rows[:first] = True
    still = replace(
        system, inverse=np.where(np.repeat(rows.any(axis=1), dim * dim), 0.0, system.inverse)
    )
    moved = w.copy()
    smooth(replace(frozen, system=still), moved)
    block = system.diagonal.reshape(-1, dim, dim)[first]
    scale = np.abs(system.diagonal).max() * np.abs(w).max()
    if problem.contact.held is None:
        np.testing.assert_allclose(
            vector[first], block @ (moved - w).reshape(-1, dim)[first], atol=1e-11 * scale
        )
    elsewhere = np.setdiff1d(np.arange(system.n_nodes), system.nodes)
    np.testing.assert_array_equal(vector[elsewhere], linear.reshape(-1, dim)[elsewhere])


@every_network
def test_sweeps_converge_to_the_solution_of_the_dual_problem(dim, law):
    problem, exact, _ = posed(f"network {dim}D {law}")
    for options in ({}, {"omega": 1.3, "order": "symmetric"}, {"order": "backward"}):
        w = np.zeros(problem.system.n_dofs)
        smooth(problem, w, 400, **options)
        np.testing.assert_allclose(w, exact, atol=1e-11)
    local, p = w.reshape(-1, dim)[problem.system.nodes], normal_force(problem, w)
    # in 3D the support drives the node that would stick under the Tresca limit
    sticks = law != "frictionless" and (dim, law) != (3, "tresca")
    found = set(states(problem.contact, local, p, 1e-9))
    assert found == {am.OPEN, am.SLIP, *([am.STICK] if sticks else [])}


@pytest.mark.parametrize("dim", [2, 3])
def test_without_contact_a_symmetric_sweep_is_block_ssor(dim):
    problem = network(dim, "frictionless", seed=7)
    problem.contact.gap[:] = np.inf
    matrix, load, omega = problem.system.matrix.toarray(), problem.load, 1.4
    w = random_start(problem, 7)
    expected = w.copy()
    for i in [*range(problem.system.n_nodes), *reversed(range(problem.system.n_nodes))]:
        at = slice(i * dim, (i + 1) * dim)
        expected[at] += omega * np.linalg.solve(matrix[at, at], load[at] - matrix[at] @ expected)
    assert smooth(problem, w, omega=omega, order="symmetric") == 2
    np.testing.assert_allclose(w, expected, atol=1e-13)


def test_a_node_that_touches_without_a_force_is_open():
    codes = contact_codes(np.array([True, True, False]), np.ones(3, dtype=bool))
    assert contact_states(codes, np.array([1.0, 0.0, 0.0])).tolist() == [am.STICK, am.OPEN, am.OPEN]


def test_a_singular_block_is_named():
    blocks = np.tile(np.eye(2), (3, 1, 1))
    blocks[1] = 1.0
    with pytest.raises(ValueError, match="diagonal block of node 1 is singular"):
        inverse_blocks(blocks)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"load": np.zeros(31)}, ValueError, r"load must have shape \(32,\)"),
        (
            {"unknowns": np.zeros(32, dtype=np.float32)},
            TypeError,
            "unknowns must be a numpy array of float64, got an",
        ),
        (
            {"unknowns": [0.0] * 32},
            TypeError,
            "unknowns must be a numpy array of float64, got list",
        ),
        ({"unknowns": np.zeros(64)[::2]}, ValueError, "unknowns must be contiguous"),
        ({"unknowns": np.frombuffer(bytes(256))}, ValueError, "unknowns is read-only"),
        (
            {"contact": {"slip_reference": np.zeros(4)}},
            ValueError,
            r"contact\.slip_reference must have shape \(4, 1\)",
        ),
        (
            {"contact": {"compliance": np.zeros(3)}},
            ValueError,
            r"contact\.compliance must have shape \(4,\)",
        ),
        ({"contact": {"lowest": np.zeros(4)}}, ValueError, r"contact\.lowest must be None"),
        ({"contact": None}, TypeError, "contact must be NodalContact"),
        ({"sweeps": -1}, ValueError, "sweeps must be >= 0"),
    ],
)
def test_bad_arrays(changes, error, message):
    problem = network(2, "coulomb")
    given = {
        "contact": problem.contact,
        "load": problem.load,
        "unknowns": np.zeros(32),
        "sweeps": 1,
    } | changes
    if isinstance(given["contact"], dict):
        given["contact"] = replace(problem.contact, **given["contact"])
    with pytest.raises(error, match=message):
        am.ProjectedGaussSeidel().smooth(problem.system, **given)


@pytest.mark.parametrize("lowest", [None, np.zeros(1)])
def test_the_lower_obstacle_of_a_scalar_problem_is_checked(lowest):
    problem = am.smoother.local_system(
        am.Hierarchy.graded(am.cases.obstacle_problem(), (0.5,)).finest.discrete
    )
    contact = replace(problem.contact, lowest=lowest)
    unknowns = np.zeros_like(problem.load)
    with pytest.raises((TypeError, ValueError), match=r"contact\.lowest must"):
        am.ProjectedGaussSeidel().smooth(problem.system, contact, problem.load, unknowns)


EXAMPLES = settings(max_examples=50, deadline=None)
BOUNDS = {
    "frictionless": (0.0, 0.0),
    "tresca": (1.0, 0.0),
    "coulomb": (0.0, 1.0),
    "both": (1.0, 1.0),
}
laws = st.sampled_from(sorted(BOUNDS))
seeds = st.integers(0, 2**32 - 1)
dims = st.sampled_from([2, 3])
exponents = st.floats(-2, 2)


def solve(block, force, gap, reference, *law):
    solve_node = solve_2d if len(force) == 2 else solve_3d
    upper = block[np.triu_indices(len(force))]
    return np.array(solve_node(*upper, *force, gap, *reference, *law))


def problem(dim, seed, law, exponent):
    """A random node problem; friction up to 5, so that the solution is not always unique."""
    rng = np.random.default_rng(seed)
    block = spd(rng, dim) * 10.0**exponent
    limit, friction = BOUNDS[law]
    return (
        block,
        3 * rng.normal(size=dim),
        rng.normal() / 10.0**exponent,
        rng.normal(size=dim - 1) / 10.0**exponent,
        limit * rng.uniform(),
        friction * 5.0 ** rng.uniform(-2, 1),
    )


def assert_conditions(w, block, force, gap, reference, limit, friction, relative=2e-14):
    q = force - block @ w
    slip = w[1:] - reference
    rounding = (
        relative
        * (1 + friction)
        * (
            np.abs(force).sum()
            + np.abs(block @ np.diag(w)).sum()
            + np.abs(block[:, 1:] @ np.diag(reference)).sum()
            + np.abs(block[:, 0] * gap).sum()
        )
    )
    assert w[0] <= gap
    assert q[0] >= -rounding
    assert w[0] == gap or abs(q[0]) <= rounding
    bound = limit + friction * max(q[0], 0.0)
    size = np.linalg.norm(slip)
    if size > 0:
        np.testing.assert_allclose(
            q[1:], bound * slip / size, atol=rounding * (1 + np.abs(reference).max() / size)
        )
    else:
        assert np.linalg.norm(q[1:]) <= bound + rounding


@EXAMPLES
@given(dims, seeds, laws, exponents, st.floats(0.05, 1.95), st.sampled_from([0.0, 1.0]))
def test_optimality_conditions(dim, seed, law, exponent, omega, coupling):
    block, *rest = problem(dim, seed, law, exponent)
    block[0, 1:] *= coupling
    block[1:, 0] *= coupling
    assert_conditions(solve(block / omega, *rest), block / omega, *rest)


@EXAMPLES
@given(dims, seeds, laws, exponents, st.floats(-2, 1))
def test_a_compliant_surface_yields_with_its_pressure(dim, seed, law, exponent, softness):
    """w_n = gap + c p: the surface is a rigid one further behind."""
    block, force, gap, *rest = problem(dim, seed, law, exponent)
    compliance = 10.0 ** (softness - exponent)
    w = solve(block, force, gap, *rest, compliance)
    pressure = max(force[0] - block[0] @ w, 0.0)
    if w[0] <= gap:
        assert_conditions(w, block, force, gap, *rest)
    else:
        # equal up to the rounding of the forces, whose difference is the pressure
        yielded = gap + compliance * pressure
        size = abs(gap) + compliance * (np.abs(force).sum() + np.abs(block @ np.diag(w)).sum())
        assert w[0] == pytest.approx(yielded, rel=0, abs=1e-13 * size)
        assert_conditions(w, block, force, w[0], *rest, relative=1e-13)


@EXAMPLES
@given(seeds)
def test_large_friction_against_strong_coupling(seed):
    """mu |a| >> b: several solutions or a wedged node; whatever is returned meets the
    conditions."""
    rng = np.random.default_rng(seed)
    block = spd(rng, 3, 1e4)
    arguments = (block, rng.normal(size=3), 0.0, np.zeros(2), 0.0, 20.0)
    assert_conditions(solve(*arguments), *arguments)
    plane = (block[:2, :2], arguments[1][:2], 0.0, np.zeros(1), 0.0, 20.0)
    assert_conditions(solve(*plane), *plane)


@EXAMPLES
@given(seeds, st.floats(0, 0.9))
def test_a_gap_that_closes_by_rounding_changes_nothing(seed, share):
    """Where the pressure comes out as zero or below."""
    block, force, _, reference, limit, _ = problem(2, seed, "both", 0.0)
    friction = share * block[1, 1] / abs(block[0, 1])
    opened = solve(block, force, np.inf, reference, limit, friction)
    closed = solve(block, force, np.nextafter(opened[0], -np.inf), reference, limit, friction)
    np.testing.assert_allclose(closed, opened, atol=1e-9 * (1 + np.abs(opened).max()))


@given(st.floats(1e-9, 1e9), st.floats(1e-9, 1e9), st.floats(1e-9, 1e9))
def test_a_point_inside_a_bracket_of_any_extent(low, extent, stiffness):
    inside = getattr(_inside, "py_func", _inside)
    for bounds in (
        (low, low + max(extent, 1e-6 * low)),
        (0.0, extent),
        (low, np.inf),
        (0.0, np.inf),
    ):
        assert bounds[0] < inside(*bounds, stiffness) < bounds[1]


@pytest.mark.parametrize("size", [1e-12, 1e-6, 1e-1, 1.0, 10.0])
def test_slip_just_beyond_the_bound(size):
    """The slip is accurate relative to itself, however little the force exceeds the bound."""
    limit = 2.0
    slip = np.array(
        slip_3d(
            4.0, 0.0, 4.0, (limit + size) * 0.6, (limit + size) * 0.8, 0.0, 0.0, 0.0, limit, 0.0
        )
    )
    np.testing.assert_allclose(slip, [0.15 * size, 0.2 * size], rtol=1e-15 * limit / size + 1e-14)
