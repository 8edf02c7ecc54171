"""The projected Gauss-Seidel method: what it converges to, what it may never do, what it counts, what it refuses."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numba
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from smoother_problems import LAWS, dual_solution, network

from adaptmg.smoother import OPEN, SLIP, STICK, ContactState, ProjectedGaussSeidel, compiling
from adaptmg.smoother.residuals import (
    contact_share,
    contact_state,
    energy,
    natural_residual,
    normal_force,
    residual,
)

EXAMPLES = settings(max_examples=15, deadline=None)
CASES = [(dim, law) for dim in (2, 3) for law in LAWS]
every_case = pytest.mark.parametrize(("dim", "law"), CASES)
cases = st.sampled_from(CASES)
seeds = st.integers(0, 10**6)
omegas = st.floats(0.05, 1.95)


def smooth(problem, unknowns, sweeps=1, **options):
    return ProjectedGaussSeidel(**options).smooth(problem.system, problem.contact, problem.load, unknowns, sweeps)


def solved(problem, **options):
    w = np.zeros(problem.system.n_dofs)
    smooth(problem, w, 400, **options)
    return w


def random_start(problem, seed):
    w = np.random.default_rng(seed).normal(size=problem.system.n_dofs)
    w[problem.system.fixed] = 0.0
    return w


def natural_norm(problem, unknowns):
    return np.linalg.norm(natural_residual(problem.system, problem.contact, problem.load, unknowns))


@every_case
@pytest.mark.parametrize("options", [{}, {"omega": 1.3, "order": "symmetric"},
                                     {"order": "backward", "friction_update": 2}], ids=str)
def test_converges_to_the_solution_of_the_dual_problem(dim, law, options):
    problem = network(dim, law, fixed_tangent=True)
    expected = dual_solution(problem)
    np.testing.assert_allclose(solved(problem, **options), expected, atol=1e-11)
    state = contact_state(problem.system, problem.contact, problem.load, expected, tolerance=1e-9)
    # in 3D the support drives the node that would stick under the Tresca limit
    sticks = law != "frictionless" and (dim, law) != (3, "tresca")
    assert set(state) == ({OPEN, SLIP, STICK} if sticks else {OPEN, SLIP})


@every_case
def test_solution_meets_the_laws(dim, law):
    problem = network(dim, law, seed=3)
    w = solved(problem)
    contact = problem.contact
    r = residual(problem.system, problem.load, w).reshape(-1, dim)
    local, r_contact = w.reshape(-1, dim)[problem.system.nodes], r[problem.system.nodes]
    p = normal_force(problem.system, problem.load, w)
    slip = local[:, 1:] - contact.slip_reference
    size = np.linalg.norm(slip, axis=1)
    bound = contact.limit + contact.friction * p
    assert (p >= 0).all() and (contact.gap >= local[:, 0]).all()
    np.testing.assert_allclose(p, r_contact[:, 0], atol=1e-13)
    np.testing.assert_allclose(p * (contact.gap - local[:, 0]), 0, atol=1e-13)
    assert (np.linalg.norm(r_contact[:, 1:], axis=1) <= bound + 1e-13).all()
    np.testing.assert_allclose(r_contact[:, 1:] * size[:, None], bound[:, None] * slip, atol=1e-13)
    r[problem.system.nodes] = 0
    np.testing.assert_allclose(r, 0, atol=1e-13)


@EXAMPLES
@given(st.sampled_from([2, 3]), st.sampled_from(["frictionless", "tresca"]), seeds, omegas,
       st.sampled_from(["forward", "backward", "symmetric"]))
def test_energy_never_rises(dim, law, seed, omega, order):
    problem = network(dim, law, seed)
    w = random_start(problem, seed)
    smooth(problem, w)
    values = []
    for _ in range(12):
        values.append(energy(problem.system, problem.contact, problem.load, w))
        smooth(problem, w, omega=omega, order=order)
    assert (np.diff(values) <= 1e-13 * max(map(abs, values))).all()
    assert values[-1] < values[0]


@EXAMPLES
@given(cases, seeds, omegas, st.sampled_from(["forward", "backward", "symmetric"]))
def test_gap_is_never_violated_and_fixed_dofs_stay(case, seed, omega, order):
    dim, law = case
    problem = network(dim, law, seed, fixed_tangent=True)
    w = random_start(problem, seed)
    for _ in range(4):
        smooth(problem, w, omega=omega, order=order)
        assert (w.reshape(-1, dim)[problem.system.nodes, 0] <= problem.contact.gap).all()
        assert (w[problem.system.fixed] == 0).all()


@every_case
@pytest.mark.parametrize("omega", [0.5, 1.0, 1.7])
def test_the_solution_is_a_fixed_point(dim, law, omega):
    problem = network(dim, law, seed=1)
    w = solved(problem)
    again = w.copy()
    smooth(problem, again, omega=omega, order="symmetric")
    np.testing.assert_allclose(again, w, atol=1e-13)


@every_case
def test_natural_residual_vanishes_only_at_the_solution(dim, law):
    problem = network(dim, law, seed=2)
    w = solved(problem)
    assert natural_norm(problem, w) <= 1e-13
    rng = np.random.default_rng(0)
    free = np.flatnonzero(~problem.system.fixed)
    for dof in free:
        moved = w.copy()
        moved[dof] += rng.choice([-1e-3, 1e-3])
        assert natural_norm(problem, moved) > 1e-4


@every_case
def test_natural_residual_is_the_jacobi_step(dim, law):
    """At one contact node, everything else held, it is D times the step of a sweep with the bound frozen."""
    problem = network(dim, law, seed=4)
    system = problem.system
    w = random_start(problem, 5)
    held = replace(problem, contact=problem.contact.frozen(normal_force(system, problem.load, w)))
    vector = natural_residual(system, problem.contact, problem.load, w).reshape(-1, dim)
    moved = w.copy()
    smooth(held, moved)
    first = system.nodes[0]
    assert first == 0  # the first node of a forward sweep
    block = system.diagonal.reshape(-1, dim, dim)[first]
    np.testing.assert_allclose(vector[first], block @ (moved - w).reshape(-1, dim)[first], atol=1e-12)
    elsewhere = np.setdiff1d(np.arange(system.n_nodes), system.nodes)
    np.testing.assert_array_equal(vector[elsewhere],
                                  residual(system, problem.load, w).reshape(-1, dim)[elsewhere])


@every_case
def test_symmetric_is_forward_then_backward(dim, law):
    problem = network(dim, law, seed=6)
    w = random_start(problem, 6)
    expected = w.copy()
    smooth(problem, w, 2, omega=1.2, order="symmetric")
    for order in ("forward", "backward") * 2:
        smooth(problem, expected, omega=1.2, order=order)
    np.testing.assert_array_equal(w, expected)


@pytest.mark.parametrize("dim", [2, 3])
def test_linear_part_is_sor(dim):
    """With the obstacle out of reach and no friction a sweep is block SOR, done here with dense blocks."""
    problem = network(dim, "frictionless", seed=7)
    problem.contact.gap[:] = np.inf
    matrix, load, omega = problem.system.matrix.toarray(), problem.load, 1.4
    w = random_start(problem, 7)
    expected = w.copy()
    for i in range(problem.system.n_nodes):
        at = slice(i * dim, (i + 1) * dim)
        expected[at] += omega * np.linalg.solve(matrix[at, at], load[at] - matrix[at] @ expected)
    smooth(problem, w, omega=omega)
    np.testing.assert_allclose(w, expected, atol=1e-13)


@pytest.mark.parametrize("dim", [2, 3])
def test_residual_and_energy_against_dense_arithmetic(dim):
    problem = network(dim, "tresca", seed=8)
    matrix, load, contact = problem.system.matrix.toarray(), problem.load, problem.contact
    w = random_start(problem, 8)
    np.testing.assert_allclose(residual(problem.system, load, w), load - matrix @ w, atol=1e-13)
    slip = w.reshape(-1, dim)[problem.system.nodes, 1:] - contact.slip_reference
    expected = 0.5 * w @ matrix @ w - load @ w + contact.limit @ np.linalg.norm(slip, axis=1)
    assert energy(problem.system, contact, load, w) == pytest.approx(expected, rel=1e-13)


def test_held_bound_follows_the_normal_force():
    """friction_update = 2: two sweeps of the Tresca problem at the first p, then two at the new one."""
    problem = network(2, "coulomb", seed=9)
    w = random_start(problem, 9)
    expected = w.copy()
    smooth(problem, w, 4, friction_update=2)
    for _ in range(2):
        p = normal_force(problem.system, problem.load, expected)
        smooth(replace(problem, contact=problem.contact.frozen(p)), expected, 2)
    np.testing.assert_array_equal(w, expected)


def test_passes():
    """Hand-counted: row 0 of the 4 x 4 grid holds 4 + 5 + 5 + 3 of the 16 + 2 * 33 blocks."""
    problem = network(2, "coulomb")
    w = np.zeros(problem.system.n_dofs)
    share = (4 + 5 + 5 + 3) / (16 + 2 * 33)
    assert contact_share(problem.system) == pytest.approx(share, rel=1e-15)
    assert smooth(problem, w, 3) == 3
    assert smooth(problem, w, 3, order="symmetric") == 6
    assert smooth(problem, w, 0) == 0
    assert smooth(problem, w, 5, order="symmetric", friction_update=2) == pytest.approx(10 + 3 * share)
    assert smooth(network(2, "tresca"), w, 5, friction_update=2) == 5


def test_states():
    """Touching with and without slip, open, and touching without force."""
    problem = network(2, "coulomb")
    problem.contact.gap[:] = 0.1
    w = np.zeros((16, 2))
    w[:4, 0] = [0.1, 0.1, 0.0, 0.1 * (1 + 1e-14)]
    w[:4, 1] = problem.contact.slip_reference[:, 0] + [0.01, 0.0, 0.0, 0.0]
    load = problem.system.matrix @ w.ravel()
    load[[0, 2, 4]] += 1.0
    state = contact_state(problem.system, problem.contact, load, w.ravel())
    assert state.dtype == np.int8
    np.testing.assert_array_equal(state[:3], [SLIP, STICK, OPEN])
    load[6] = (problem.system.matrix @ w.ravel())[6] - 1.0
    assert contact_state(problem.system, problem.contact, load, w.ravel())[3] == ContactState.OPEN
    problem.contact.friction[:] = 0.0
    assert contact_state(problem.system, problem.contact, load, w.ravel())[1] == ContactState.SLIP
    with pytest.raises(ValueError, match="tolerance must be >= 0"):
        contact_state(problem.system, problem.contact, load, w.ravel(), tolerance=-1.0)


@pytest.mark.parametrize(("options", "error", "message"), [
    ({"omega": 2.0}, ValueError, "omega must lie between 0 and 2"),
    ({"omega": 0.0}, ValueError, "omega must lie between 0 and 2"),
    ({"omega": float("nan")}, ValueError, "omega must be finite"),
    ({"order": "random"}, ValueError, "order must be one of 'forward', 'backward', 'symmetric'"),
    ({"friction_update": "never"}, ValueError, "friction_update must be one of 'sweep'"),
    ({"friction_update": 0}, ValueError, "friction_update must be >= 1"),
    ({"friction_update": 1.5}, TypeError, "friction_update must be an integer"),
])
def test_bad_options(options, error, message):
    with pytest.raises(error, match=message):
        ProjectedGaussSeidel(**options)


def test_bad_arrays():
    problem = network(2, "coulomb")
    system, contact, load = problem.system, problem.contact, problem.load
    smoother, w = ProjectedGaussSeidel(), np.zeros(32)
    with pytest.raises(ValueError, match=r"load must have shape \(32,\)"):
        smoother.smooth(system, contact, load[:-1], w)
    with pytest.raises(TypeError, match="unknowns must be a numpy array of float64, got an array of float32"):
        smoother.smooth(system, contact, load, w.astype(np.float32))
    with pytest.raises(TypeError, match="unknowns must be a numpy array of float64, got list"):
        smoother.smooth(system, contact, load, list(w))
    with pytest.raises(ValueError, match="unknowns must be contiguous"):
        smoother.smooth(system, contact, load, np.zeros(64)[::2])
    with pytest.raises(ValueError, match=r"contact\.gap must have shape \(4,\) \(there are 4 contact nodes\)"):
        smoother.smooth(system, replace(contact, gap=np.zeros(3)), load, w)
    with pytest.raises(ValueError, match=r"contact\.slip_reference must have shape \(4, 1\)"):
        smoother.smooth(system, replace(contact, slip_reference=np.zeros(4)), load, w)
    with pytest.raises(TypeError, match="contact must be a NodalContact"):
        smoother.smooth(system, None, load, w)
    with pytest.raises(ValueError, match="sweeps must be >= 0"):
        smoother.smooth(system, contact, load, w, -1)
    w.flags.writeable = False
    with pytest.raises(ValueError, match="unknowns is read-only"):
        smoother.smooth(system, contact, load, w)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing compiles")
def test_notice_of_compiling_comes_once(caplog, monkeypatch):
    monkeypatch.setattr(compiling, "_announced", False)
    monkeypatch.setattr(compiling, "_checked", set())
    kernels = [numba.njit(lambda x: x + 1), numba.njit(lambda x: x + 2)]
    with caplog.at_level(logging.INFO, "adaptmg"):
        compiling.notice(len)
        assert not caplog.records
        compiling.notice(*kernels)
        compiling.notice(*kernels)
    assert [record.getMessage() for record in caplog.records] == ["compiling kernels (once per machine; cached)"]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing compiles")
def test_no_notice_where_a_kernel_is_cached(caplog, monkeypatch):
    problem = network(2, "tresca")
    residual(problem.system, problem.load, problem.load)
    monkeypatch.setattr(compiling, "_announced", False)
    monkeypatch.setattr(compiling, "_checked", set())
    with caplog.at_level(logging.INFO, "adaptmg"):
        residual(problem.system, problem.load, problem.load)
    assert not caplog.records


@pytest.mark.slow
@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="this is the run without the JIT")
def test_kernels_without_the_jit():
    """Out-of-bounds reads are silent in compiled code: here they raise."""
    chosen = "optimality or dense_arithmetic or linear_part or jacobi or symmetric_is or never_violated or isotropy"
    here = Path(__file__).parent
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-k", chosen,
         here / "test_smoother_sweep.py", here / "test_smoother_node_solve.py"],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1"}, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stdout
    assert " passed" in run.stdout and "skipped" not in run.stdout
