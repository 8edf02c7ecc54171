"""User-defined coarse solves and smoothers of the truncated method: same solution, counted work."""

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import splu

import adaptmg as am


class Factors:
    """LU factors; it keeps the matrices it was set up for."""

    def __init__(self):
        self.matrices = []

    def setup(self, matrix):
        self.matrices.append(matrix.copy())
        return splu(sparse.csc_array(matrix))


class Jacobi:
    """Damped sweeps: twenty as a coarse solve, two as a smoother; their passes are counted."""

    passes = 20

    def setup(self, matrix):
        self.matrix, self.diagonal = matrix, matrix.diagonal()
        return self

    def solve(self, rhs):
        return self.swept(rhs, np.zeros_like(rhs), self.passes)

    def smooth(self, rhs, x):
        self.swept(rhs, x, 2)
        return 2

    def swept(self, rhs, x, sweeps):
        for _ in range(sweeps):
            x += 0.6 * (rhs - self.matrix @ x) / self.diagonal
        return x


@pytest.fixture(scope="module")
def bar():
    return am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8, 16))


@pytest.fixture(scope="module")
def joint():
    # its coarsest matrix is regular
    return am.Hierarchy.graded(am.cases.dovetail(), sizes=(12e-3, 8e-3, 5e-3), mesher="netgen")


@pytest.fixture(scope="module")
def spaces(bar):
    return am.Hierarchy.algebraic(bar.finest.discrete, max_coarse=20)


def far(a, b):
    return np.abs(a.displacement - b.displacement).max() / np.abs(b.displacement).max()


@pytest.mark.parametrize("grids, method", [
    ("bar", am.FullMultigrid), ("bar", am.Multigrid), ("joint", am.FullMultigrid)])
def test_a_direct_solver_gives_the_cycles_of_the_factors(grids, method, request):
    grids, own = request.getfixturevalue(grids), Factors()
    expected = am.solve(grids, method())
    found = am.solve(grids, method(correction=am.Truncated(coarse_solve=own)))
    assert found.cycles == expected.cycles and found.work_units == expected.work_units
    assert far(found, expected) < 1e-8
    # truncated again with the contact status, and regular: no row is empty
    assert len(own.matrices) > 1 and all((abs(matrix).sum(axis=1) > 0).all() for matrix in own.matrices)


def test_an_iterative_one_is_counted(bar):
    own = am.solve(bar, am.FullMultigrid(correction=am.Truncated(coarse_solve=Jacobi())))
    exact = am.solve(bar, am.FullMultigrid())
    assert own.status.ok and far(own, exact) < 1e-6
    share = bar[0].matrix.nnz / bar.finest.matrix.nnz
    assert own.work_units > exact.work_units + Jacobi.passes * share * (own.cycles - 1)


@pytest.mark.parametrize("grids, method", [("bar", am.FullMultigrid), ("joint", am.FullMultigrid),
                                           ("spaces", am.Multigrid)])
def test_a_smoother_below_the_finest_level(grids, method, request):
    grids = request.getfixturevalue(grids)
    assert len(grids) > 2
    own = am.solve(grids, method(correction=am.Truncated(coarse_smoother=Jacobi())))
    expected = am.solve(grids, method())
    assert own.status.ok and own.cycles <= expected.cycles + 4
    assert far(own, expected) < 1e-6
    idle = type("Idle", (Jacobi,), {"smooth": lambda self, rhs, x: 0})()
    assert am.solve(grids, method(correction=am.Truncated(coarse_smoother=idle)), throw=False).cycles > expected.cycles
