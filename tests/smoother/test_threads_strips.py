"""Solves on several threads: strips of nodes and parts of rows."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy import sparse
from simplex_meshes import numbered_at_random
from uncompiled import uncompile

import adaptmg as am
from adaptmg import _threads as threads
from adaptmg.discrete.block_rows import BlockRows
from adaptmg.multigrid import split_matrix
from adaptmg.multigrid.split_matrix import split
from adaptmg.smoother import blocks
from adaptmg.smoother import strips as strips_module


@pytest.fixture(autouse=True)
def small(monkeypatch):
    """Small matrices count as large; one thread afterwards."""
    monkeypatch.setattr(threads, "LARGE", 2000)
    yield
    am.set_threads(1)


def shuffled(dim: int, seed: int | None) -> sparse.bsr_array:
    """The matrix of a structured mesh, its nodes shuffled unless ``seed`` is None."""
    case, cells = (am.cases.greco_bar(), 20) if dim == 2 else (am.cases.greco_block(), 14)
    matrix = am.discretise(case, am.mesh.structured(case.domain, cells)).matrix
    if seed is None:
        return matrix
    order = np.random.default_rng(seed).permutation(matrix.shape[0] // dim)
    dofs = (dim * order[:, None] + np.arange(dim)).reshape(-1)
    return sparse.bsr_array(
        sparse.csr_array(matrix)[dofs][:, dofs], blocksize=(dim, dim)
    ).sorted_indices()


@pytest.mark.parametrize("seed", [None, 1], ids=["rows of nodes", "shuffled"])
@pytest.mark.parametrize("dim", [2, 3])
def test_strips_of_a_colour_have_no_common_neighbour(dim, seed):
    am.set_threads(2)
    matrix = shuffled(dim, seed)
    strips = strips_module.Strips.of(BlockRows.of(matrix))
    assert len(strips.colours) == 2 and sum(map(len, strips.colours)) > strips_module.FEWEST
    np.testing.assert_array_equal(strips.order[strips.rank], np.arange(len(strips.order)))
    covered = [
        place for ranges in strips.colours for first, last in ranges for place in range(first, last)
    ]
    assert covered == list(range(len(strips.order)))
    for ranges in strips.colours:
        touched = [
            set(
                np.concatenate(
                    [
                        matrix.indices[matrix.indptr[i] : matrix.indptr[i + 1]]
                        for i in strips.order[first:last]
                    ]
                )
            )
            for first, last in ranges
        ]
        assert not any(a & b for a, b in combinations(touched, 2))


@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("seed", [None, 1])
def test_a_sweep_over_strips_is_gauss_seidel_in_their_order(seed, compiled, monkeypatch):
    if not compiled:
        uncompile(monkeypatch, split_matrix, blocks)
    am.set_threads(2)
    matrix = shuffled(2, seed)
    halves, f = (
        split(matrix, np.zeros(matrix.shape[0], dtype=bool)),
        np.random.default_rng(0).normal(size=882),
    )
    dofs = (2 * halves.strips.order[:, None] + np.arange(2)).reshape(-1)
    dense = matrix.toarray()[np.ix_(dofs, dofs)]
    before = np.tril(np.kron(np.ones((441, 441)), np.ones((2, 2)))) + np.kron(
        np.eye(441), [[0, 1], [0, 0]]
    )
    u, kept = np.empty(882), np.empty(882)
    halves.sweep(
        split_matrix.gauss_seidel,
        False,
        *halves.lower_arrays,
        *halves.no_half,
        halves.inverse,
        f,
        u,
        kept,
    )
    expected = np.linalg.solve(dense * before, f[dofs])
    np.testing.assert_allclose(u[dofs], expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
    halves.sweep(
        split_matrix.gauss_seidel,
        True,
        *halves.no_half,
        *halves.upper_arrays,
        halves.inverse,
        kept,
        u,
        kept,
        backward=True,
    )
    rest = f - kept
    halves.sweep(split_matrix.subtract_half, *halves.lower_arrays, u, rest)
    np.testing.assert_allclose(rest, f - matrix @ u, atol=1e-9 * np.abs(f).max())


@pytest.mark.filterwarnings("ignore:divisions")  # cells that are long
@pytest.mark.parametrize(("dim", "cells", "colours"), [(2, 64, 2), (3, 17, 2), (2, (1400, 2), 1)])
def test_nodes_of_a_lattice_share_the_rows_of_a_half(dim, cells, colours):
    """Of few long lines, too, which stored matrices sweep by distance."""
    am.set_threads(2)
    case = am.cases.greco_bar() if dim == 2 else am.cases.greco_block()
    discrete = am.discretise(case, am.mesh.structured(case.domain, cells))
    shared, stored = (
        split(matrix, discrete.fixed, symmetric=True)
        for matrix in (discrete.rows, discrete.rows.matrix)
    )
    assert len(shared.strips.colours) == colours and len(stored.strips.colours) == 2
    assert 2 * len(shared.lower) < len(stored.lower)
    assert (shared.matrix() != stored.matrix()).nnz == 0
    blocks = shared.inverse.reshape(-1, dim**2)[shared.kinds]
    np.testing.assert_array_equal(blocks.reshape(-1), stored.inverse)


def test_what_a_large_matrix_has_set_aside_is_made_again(monkeypatch):
    monkeypatch.undo()
    case = am.cases.greco_block()
    discrete = am.discretise(case, am.mesh.structured(case.domain, 26))
    halves = split(discrete.matrix, discrete.fixed, symmetric=True)
    sweeps = []
    for _ in range(2):
        u, kept = np.zeros((2, discrete.n_dofs))
        halves.complete()
        lower = halves.lower_arrays
        halves.sweep(
            split_matrix.gauss_seidel,
            False,
            *lower,
            *halves.no_half,
            halves.inverse,
            discrete.load,
            u,
            kept,
        )
        sweeps.append(u)
        assert halves.set_aside(discrete.matrix, discrete.fixed)
        assert not len(halves.lower) and not len(halves.inverse)
    assert sweeps[0].any()
    np.testing.assert_array_equal(*sweeps)


@pytest.mark.parametrize("case", ["plane", "solid", "independent", "two bodies"])
def test_bits_do_not_depend_on_the_number_of_threads(case, monkeypatch):
    grids = {
        "plane": lambda: am.Hierarchy.uniform(
            replace(am.cases.greco_bar(), elements="smoothed"), divisions=(4, 8, 16, 32)
        ),
        "solid": lambda: am.Hierarchy.uniform(am.cases.greco_block(), divisions=(2, 4, 8)),
        "independent": lambda: am.Hierarchy.graded(
            am.cases.greco_bar(), sizes=(10e-3, 5e-3, 2.5e-3, 1.2e-3)
        ),
        "two bodies": lambda: am.Hierarchy.uniform(
            am.cases.two_block_patch(), divisions=(4, 8, 16)
        ),
    }[case]
    results = []
    for number in (2, 3, 1):
        am.set_threads(number)
        results.append(am.solve(grids()))
    # one thread takes nodes that are not numbered by place in the order of their numbers
    for other in results[1:] if case in ("plane", "solid") else results[1:2]:
        np.testing.assert_array_equal(other.displacement, results[0].displacement)
        np.testing.assert_array_equal(other.history["residual"], results[0].history["residual"])
        assert other.checked.energy_error == results[0].checked.energy_error
    monkeypatch.undo()  # in one part
    serial = am.solve(grids())
    size = np.abs(serial.displacement).max()
    np.testing.assert_allclose(results[0].displacement, serial.displacement, atol=1e-6 * size)
    assert results[0].cycles <= serial.cycles + 1
    assert (results[0].displacement != serial.displacement).any()


def test_parts_cover_the_rows_and_pass_errors_on():
    am.set_threads(3)
    assert threads.sum_of_parts(lambda first, last: last - first, 12345, 10**6) == 12345
    seen = np.zeros(999, dtype=int)

    def mark(first: int, last: int) -> None:
        seen[first:last] += 1
        if last == 999:
            raise ArithmeticError("the last part fails")

    with pytest.raises(ArithmeticError, match="the last part fails"):
        threads.in_parts(mark, 999, 10**6)
    assert (seen == 1).all()
    matrix, v = shuffled(3, None), np.random.default_rng(0).normal(size=10125)
    np.testing.assert_array_equal(BlockRows.of(matrix).times(v), matrix @ v)


def test_rows_that_scatter_at_the_same_time_share_no_column():
    elements = am.mesh.structured(am.cases.greco_bar().domain, 40).elements
    colours = threads.scattering(elements, size=10**6)
    assert [len(ranges) for ranges in colours] == [8, 8]
    for ranges in colours:
        touched = [set(elements[slice(*each)].reshape(-1)) for each in ranges]
        assert not any(a & b for a, b in combinations(touched, 2))
    assert threads.scattering(elements) == [[(0, 3200)]]
    mixed = np.random.default_rng(0).permutation(elements)
    assert threads.scattering(mixed, size=10**6) == [[(0, 3200)]]


@pytest.mark.parametrize("number", [0, 10**6, 1.5])
def test_other_numbers_of_threads_are_refused(number):
    with pytest.raises((ValueError, TypeError), match="threads must be"):
        am.set_threads(number)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_stiffness_of_shuffled_nodes_is_the_same_and_symmetric_on_any_threads(dim):
    case, cells = (am.cases.greco_bar(), 20) if dim == 2 else (am.cases.greco_block(), 7)
    mesh = numbered_at_random(am.mesh.structured(case.domain, cells), dim)
    matrices = []
    for count in (1, 2, 5):
        am.set_threads(count)
        matrices.append(am.discretise(case, mesh).matrix.toarray())
    for matrix in matrices:
        np.testing.assert_array_equal(matrix, matrices[0])
        np.testing.assert_array_equal(matrix, matrix.T)
