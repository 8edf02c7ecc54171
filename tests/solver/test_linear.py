"""Linear solvers: elimination order, direct solver, algebraic multigrid; the glued problem and
condensation."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse
from scipy.sparse.linalg import splu
from smoother_problems import network

import adaptmg as am
from adaptmg.smoother.factorisation import condense, condense_problem, nested_dissection, node_graph
from adaptmg.solver.active_set import local_near_nullspace


def bar(divisions: int, problem: am.ContactProblem | None = None) -> am.DiscreteProblem:
    problem = problem or am.cases.greco_bar()
    return am.discretise(problem, am.mesh.structured(problem.domain, divisions))


def glued_system(discrete: am.DiscreteProblem) -> tuple[sparse.bsr_array, np.ndarray, np.ndarray]:
    """Matrix, load and near-nullspace with all contact dofs fixed."""
    local = am.smoother.local_system(discrete)
    free = np.flatnonzero(local.system.contact_of < 0)
    dofs = (discrete.dim * free[:, None] + np.arange(discrete.dim)).reshape(-1)
    matrix = sparse.csr_array(local.system.matrix)[dofs][:, dofs]
    matrix = sparse.bsr_array(matrix, blocksize=(discrete.dim, discrete.dim)).sorted_indices()
    return matrix, local.load[dofs], local_near_nullspace(local)[dofs]


def skewed(matrix: sparse.bsr_array) -> sparse.bsr_array:
    """Rows of two nodes changed as Coulomb's law changes them."""
    result = matrix.tocsr().tolil()
    for node in (3, 7):
        result[2 * node + 1] = result[2 * node + 1] - 0.5 * result[2 * node]
    return sparse.bsr_array(result.tocsr(), blocksize=(2, 2))


@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.floats(0, 0.2))
@settings(max_examples=25, deadline=None)
def test_every_node_comes_once_and_the_last_come_last(seed, n, density):
    rng = np.random.default_rng(seed)
    half = sparse.random_array((n, n), density=density, rng=rng, format="csr")
    graph = sparse.csr_array(half + half.T + sparse.eye_array(n))
    last = rng.choice(n, size=rng.integers(0, n + 1), replace=False)
    # coordinates with many equal values, and none (the graph may fall apart)
    for coordinates in (rng.integers(0, 3, size=(n, 2)).astype(float), None):
        order = nested_dissection(graph, coordinates, last=last)
        assert np.array_equal(np.sort(order), np.arange(n))
        assert set(order[n - len(last) :]) == set(last)


@pytest.mark.parametrize("with_coordinates", [True, False])
def test_fill_is_that_of_a_good_order(with_coordinates):
    discrete = bar(40)
    matrix = discrete.matrix + sparse.eye_array(discrete.n_dofs) * discrete.matrix.diagonal().max()
    nodes = nested_dissection(
        node_graph(discrete.matrix), discrete.coordinates if with_coordinates else None
    )
    order = (2 * nodes[:, None] + np.arange(2)).ravel()
    ordered = sparse.csr_array(matrix)[order][:, order]
    ours, natural, minimum_degree = (
        splu(
            sparse.csc_array(m),
            permc_spec=name,
            diag_pivot_thresh=0.0,
            options={"SymmetricMode": True},
        ).nnz
        for m, name in ((ordered, "NATURAL"), (matrix, "NATURAL"), (matrix, "MMD_AT_PLUS_A"))
    )
    assert ours < 0.6 * natural and ours < 1.1 * minimum_degree


@pytest.mark.parametrize("linear", [am.Direct(), am.AMG()], ids=["direct", "amg"])
@pytest.mark.parametrize("symmetric", [True, False])
def test_solutions_are_those_of_dense_algebra(linear, symmetric):
    matrix, load, modes = glued_system(bar(10))
    load = np.random.default_rng(0).normal(size=len(load)) * modes.any(axis=1)
    wanted = matrix if symmetric else skewed(matrix)
    prepared = linear.setup(
        wanted, modes, symmetric=symmetric, preconditioner=None if symmetric else matrix
    )
    solution = prepared.solve(load, rtol=1e-11)
    exact = np.linalg.solve(wanted.toarray(), load)
    assert solution.converged and solution.residual <= 1.1e-11
    assert np.linalg.norm(wanted @ solution.unknowns - load) <= 1.1e-11 * np.linalg.norm(load)
    assert np.linalg.norm(solution.unknowns - exact) < 1e-9 * np.linalg.norm(exact)
    if not symmetric:
        other = np.linalg.solve(matrix.toarray(), load)
        assert np.linalg.norm(exact - other) > 1e-3 * np.linalg.norm(exact)


def test_direct_reports_a_singular_matrix():
    for symmetric in (True, False):
        with pytest.raises(np.linalg.LinAlgError, match="singular"):
            am.Direct().setup(bar(6).matrix, symmetric=symmetric)


def test_direct_uses_the_order_of_a_like_matrix_without_work():
    matrix, load, _ = glued_system(bar(6))
    first = am.Direct().setup(matrix)
    second = am.Direct().setup(sparse.bsr_array(2 * matrix, blocksize=(2, 2)), previous=first)
    assert second.factors.order is first.factors.order
    one, half = first.solve(load), second.solve(load)
    assert half.unknowns == pytest.approx(0.5 * one.unknowns, rel=1e-10) and (
        one.iterations,
        one.passes,
    ) == (0, 0.0)


def test_work_is_that_of_products_and_cycles():
    matrix, load, modes = glued_system(bar(16))
    prepared = am.AMG().setup(matrix, modes)
    *levels, coarsest = prepared.hierarchy.levels
    cycle = (
        sum(5 * level.A.nnz + 2 * level.P.nnz for level in levels) + coarsest.A.shape[0] ** 2
    ) / matrix.nnz
    assert prepared.cycle_passes == pytest.approx(cycle)
    few, more = prepared.solve(load, rtol=1e-2), prepared.solve(load, rtol=1e-4)
    # products: a residual before, after, and in the first and every eighth iteration
    assert 1 <= few.iterations < more.iterations <= 7
    assert few.passes == pytest.approx(few.iterations + 3 + (few.iterations + 3) * cycle)
    # the cost of an iteration: a product and a cycle
    assert more.passes - few.passes == pytest.approx(
        (more.iterations - few.iterations) * (1 + cycle)
    )


def test_rigid_body_modes_pay_and_a_residual_that_stays_shows():
    matrix, load, modes = glued_system(bar(32))
    constants = np.tile(np.eye(2), (len(load) // 2, 1)) * modes.any(axis=1)[:, None]
    counts = [
        am.AMG().setup(matrix, b).solve(load, rtol=1e-8).iterations for b in (modes, constants)
    ]
    assert counts[0] <= 18 and counts[1] >= 1.3 * counts[0]
    for symmetric in (True, False):
        solution = am.AMG().setup(matrix, modes, symmetric=symmetric).solve(load, rtol=1e-30)
        assert not solution.converged and 1e-30 < solution.residual < 1e-8


def contact_dofs(local: am.smoother.LocalProblem) -> np.ndarray:
    dim = local.system.dim
    return (dim * local.system.nodes[:, None] + np.arange(dim)).ravel()


def dense_condensation(local: am.smoother.LocalProblem) -> tuple[np.ndarray, np.ndarray]:
    matrix, c = local.system.matrix.toarray(), contact_dofs(local)
    i = np.setdiff1d(np.arange(len(matrix)), c)
    through = matrix[np.ix_(c, i)] @ np.linalg.inv(matrix[np.ix_(i, i)])
    return matrix[np.ix_(c, c)] - through @ matrix[np.ix_(i, c)], local.load[
        c
    ] - through @ local.load[i]


def copies(one: am.DiscreteProblem, n: int) -> am.DiscreteProblem:
    """Bodies that do not touch each other, their contact nodes in turns."""
    nodes = (one.contact.nodes[:, None] + one.n_nodes * np.arange(n)).reshape(-1)
    contact = am.ContactNodes(
        nodes=nodes,
        normals=np.repeat(one.contact.normals, n, axis=0),
        gaps=np.repeat(one.contact.gaps, n),
    )
    return am.DiscreteProblem(
        matrix=sparse.block_diag(n * [one.matrix], format="csr"),
        load=np.tile(one.load, n),
        fixed=np.tile(one.fixed, n),
        law=am.Coulomb(1.0),
        contact=contact,
    )


#: below and above 300 dofs, beyond which factors are sparse
PROBLEMS = {
    "bar": lambda: bar(6),
    "large bar": lambda: bar(14),
    "block": lambda: bar(3, am.cases.greco_block(plane_strain=False)),
    "large block": lambda: bar(5, am.cases.greco_block(plane_strain=False)),
    "network": lambda: network(3, "coulomb", fixed_tangent=True).discrete,
    "bodies": lambda: copies(bar(3), 3),
    "many bodies": lambda: copies(bar(3), 12),
    "no coordinates": lambda: replace(bar(14), coordinates=None),
}


@pytest.mark.parametrize("name", PROBLEMS)
def test_condensation_and_recovery_are_those_of_dense_algebra(name):
    local = am.smoother.local_system(PROBLEMS[name]())
    condensed, (schur, load) = condense(local), dense_condensation(local)
    for matrix in (condensed.matrix, condensed.problem.system.matrix.toarray()):
        assert np.abs(matrix - schur).max() < 1e-13 * np.abs(schur).max()
    assert np.abs(condensed.problem.load - load).max() < 1e-13 * np.abs(local.load).max() * len(
        load
    )
    assert not condensed.problem.load[condensed.problem.system.fixed].any()
    unknowns = np.random.default_rng(0).normal(size=len(load)) * 1e-5
    unknowns[condensed.problem.system.fixed] = 0.0
    full = condensed.recover(unknowns)
    rest = local.load - local.system.matrix @ full
    forces = np.abs(local.system.matrix) @ np.abs(full)
    away = np.setdiff1d(np.arange(len(full)), contact_dofs(local))
    assert np.array_equal(condensed.restrict(full), unknowns)
    assert np.abs(rest[away]).max() < 1e-13 * forces.max()
    left = condensed.restrict(rest) - condensed.problem.load + condensed.matrix @ unknowns
    assert np.abs(left).max() < 1e-12 * forces.max()


@pytest.mark.parametrize("n", [2, 12])
def test_a_body_that_nothing_holds_is_refused_or_left_out(n):
    held = bar(3)
    bodies = copies(held, n)
    of_held = {name: getattr(held.contact, name) for name in ("nodes", "normals", "gaps")}
    fixed = bodies.fixed & (np.arange(bodies.n_dofs) < bodies.n_dofs - held.n_dofs)
    loose = replace(bodies, fixed=fixed, contact=am.ContactNodes(**of_held))
    lenient = condense_problem(loose, lenient=True)
    for refuses in (condense_problem, lambda problem: condense(am.smoother.local_system(problem))):
        with pytest.raises(ValueError, match="singular even with all contact dofs fixed"):
            refuses(loose)
    alone = condense(am.smoother.local_system(held)).matrix
    np.testing.assert_allclose(lenient.matrix, alone, atol=1e-13 * np.abs(alone).max())
    # the others, whose contact nodes are free now, can rise
    assert len(lenient.factors.order) == bodies.n_dofs - 3 - (n - 2)


@pytest.mark.parametrize("seed", range(3))
def test_factors_without_good_pivots_solve_to_rounding(seed):
    """Of diagonals of 1e-6: one solve leaves 4e-10 to 8e-9 of the right side, a refined one 5e-15."""
    rng, n = np.random.default_rng(seed), 200
    matrix = rng.standard_normal((n, n))
    matrix[np.diag_indices(n)] *= 1e-6
    rhs = rng.standard_normal(n)
    solution = am.Direct().setup(sparse.bsr_array(matrix, blocksize=(2, 2))).solve(rhs)
    assert np.linalg.norm(rhs - matrix @ solution.unknowns) < 1e-13 * np.linalg.norm(rhs)
