"""The smoother step and the natural residual on networks and meshes: 2D, 3D, one body, two bodies, axisymmetric."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from smoother_problems import LAWS, dual_solution, network, tresca_energy

import adaptmg as am
from adaptmg.smoother import ProjectedGaussSeidel
from adaptmg.smoother import system as codes_of
from adaptmg.smoother.residuals import natural_residual, residual, states
from adaptmg.smoother.system import OPEN, SLIP, STICK, LocalProblem, contact_codes, inverse_blocks, local_system

NETWORKS = [f"network {dim}D {law}" for dim in (2, 3) for law in LAWS]
MESHES = {
    "bar": lambda law: am.Hierarchy.uniform(am.cases.greco_bar(law=law), (4,)),
    "block": lambda law: am.Hierarchy.uniform(am.cases.greco_block(law=law), (2,)),
    "pair": lambda law: am.Hierarchy.uniform(am.cases.two_block_patch(law=law), [{"upper": 3, "lower": 4}]),
    "pair 3D": lambda law: am.Hierarchy.uniform(am.cases.two_block_patch(law=law, dim=3), [{"upper": 1, "lower": 2}]),
    "axisymmetric pair": lambda law: am.Hierarchy.graded(am.cases.hertz_sphere(law=law), (5e-3,))}
CASES = [*NETWORKS, *(f"{mesh}, {law}" for mesh in MESHES for law in ("tresca", "coulomb"))]
ORDERS = ["forward", "backward", "symmetric"]
every_case = pytest.mark.parametrize("case", CASES)
every_network = pytest.mark.parametrize(("dim", "law"), [(dim, law) for dim in (2, 3) for law in LAWS])


@cache
def posed(case: str) -> tuple[LocalProblem, np.ndarray, float]:
    """A problem, its solution by a method that shares nothing with the smoother, and the size of its forces."""
    if case in NETWORKS:
        _, dim, law = case.split()
        problem = network(int(dim[0]), law, fixed_tangent=True)
        return problem, dual_solution(problem), 1.0
    mesh, law = case.split(", ")
    discrete = MESHES[mesh]({"tresca": am.Tresca(2e7), "coulomb": am.Coulomb(0.3)}[law]).finest.discrete
    problem = local_system(discrete)
    exact = am.solve(discrete, am.ActiveSet(rtol=1e-13)).displacement
    return problem, problem.to_local(discrete.relative(exact)), np.linalg.norm(problem.load)


def smooth(problem, unknowns, sweeps=1, **options):
    return ProjectedGaussSeidel(**options).smooth(problem.system, problem.contact, problem.load, unknowns, sweeps)


def random_start(problem, seed, size=1.0):
    w = size * np.random.default_rng(seed).normal(size=problem.system.n_dofs)
    w[problem.system.fixed] = 0.0
    return w


def natural_norm(problem, unknowns):
    return np.linalg.norm(natural_residual(problem.system, problem.contact, problem.load, unknowns))


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
        assert natural_norm(problem, moved) > 1e-5 * size * np.abs(stiffness).min(initial=np.inf, where=stiffness != 0)


def normal_force(problem, w):
    system = problem.system
    return np.maximum(residual(system, problem.load, w).reshape(-1, system.dim)[system.nodes, 0], 0.0)


def frozen_at(problem, w):
    """The Tresca problem with the bound of an iterate."""
    contact = problem.contact
    return replace(problem, contact=replace(contact, limit=contact.limit + contact.friction * normal_force(problem, w),
                                            friction=np.zeros_like(contact.friction)))


@every_case
def test_what_every_sweep_keeps(case, seed=1):
    """No node penetrates, fixed dofs stay, the Tresca energy never rises; the last node has no natural residual."""
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
    last = natural_residual(problem.system, problem.contact, problem.load, w)[:dim]
    assert np.linalg.norm(last) <= 1e-9 * max(force, np.abs(problem.system.diagonal).max() * np.abs(w).max())


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
def test_without_contact_a_sweep_is_block_sor(dim):
    problem = network(dim, "frictionless", seed=7)
    problem.contact.gap[:] = np.inf
    matrix, load, omega = problem.system.matrix.toarray(), problem.load, 1.4
    w = random_start(problem, 7)
    np.testing.assert_allclose(residual(problem.system, load, w), load - matrix @ w, atol=1e-13)
    expected = w.copy()
    for i in range(problem.system.n_nodes):
        at = slice(i * dim, (i + 1) * dim)
        expected[at] += omega * np.linalg.solve(matrix[at, at], load[at] - matrix[at] @ expected)
    smooth(problem, w, omega=omega)
    np.testing.assert_allclose(w, expected, atol=1e-13)


def test_a_symmetric_sweep_is_a_forward_and_a_backward_one():
    problem = network(2, "coulomb", seed=9)
    w = random_start(problem, 9)
    symmetric, both = w.copy(), w.copy()
    assert smooth(problem, symmetric, 2, omega=1.2, order="symmetric") == 4
    for order in ("forward", "backward") * 2:
        assert smooth(problem, both, omega=1.2, order=order) == 1
    np.testing.assert_array_equal(symmetric, both)
    assert smooth(problem, w, 0) == 0


def test_codes_of_contact_nodes_and_their_states():
    free, held, slips, backwards, closed = (getattr(codes_of, name) for name in (
        "FREE", "HELD", "SLIPS", "BACKWARDS", "CLOSED"))
    touch, stick = np.array([0, 0, 1, 1, 1], dtype=bool), np.array([0, 1, 0, 1, 0], dtype=bool)
    assert contact_codes(touch, stick, np.array([0, 1, 0, 1, 1], dtype=bool)).tolist() == [
        slips, held, closed + slips, closed + held, closed + backwards]
    codes = np.array([free, held, *(closed + code for code in (free, slips, backwards, held, held))])
    found = codes_of.contact_states(codes, np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0]))
    assert found.dtype == np.int8 and found.tolist() == [OPEN, OPEN, SLIP, SLIP, SLIP, STICK, OPEN]


def test_a_singular_block_is_named():
    blocks = np.tile(np.eye(2), (3, 1, 1))
    blocks[1] = 1.0
    with pytest.raises(ValueError, match="diagonal block of node 1 is singular"):
        inverse_blocks(blocks)


@pytest.mark.parametrize(("changes", "error", "message"), [
    ({"load": np.zeros(31)}, ValueError, r"load must have shape \(32,\)"),
    ({"unknowns": np.zeros(32, dtype=np.float32)}, TypeError, "unknowns must be a numpy array of float64, got an"),
    ({"unknowns": [0.0] * 32}, TypeError, "unknowns must be a numpy array of float64, got list"),
    ({"unknowns": np.zeros(64)[::2]}, ValueError, "unknowns must be contiguous"),
    ({"unknowns": np.frombuffer(bytes(256))}, ValueError, "unknowns is read-only"),
    ({"contact": {"slip_reference": np.zeros(4)}}, ValueError, r"contact\.slip_reference must have shape \(4, 1\)"),
    ({"contact": None}, TypeError, "contact must be NodalContact"),
    ({"sweeps": -1}, ValueError, "sweeps must be >= 0")])
def test_bad_arrays(changes, error, message):
    problem = network(2, "coulomb")
    given = {"contact": problem.contact, "load": problem.load, "unknowns": np.zeros(32), "sweeps": 1} | changes
    if isinstance(given["contact"], dict):
        given["contact"] = replace(problem.contact, **given["contact"])
    with pytest.raises(error, match=message):
        ProjectedGaussSeidel().smooth(problem.system, **given)


