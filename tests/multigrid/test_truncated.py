"""The truncated multigrid: agreement with independent solutions, mesh independence, failures,
user-defined parts."""

from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from bodies import bumpy
from norms import distance, far
from scipy import sparse
from scipy.sparse.linalg import splu
from smoother_problems import expand

import adaptmg as am

COLD, NESTED = am.Multigrid(), am.FullMultigrid()


def bar(law: am.problem.Law, n: int = 32) -> am.Hierarchy:
    problem = replace(
        am.cases.greco_bar(law=law),
        contact=am.Contact("bottom", am.GapFunction(bumpy)),
        reference={},
    )
    return am.Hierarchy.uniform(problem, divisions=[d for d in (4, 8, 16, 32, 64, 128) if d <= n])


def exact(hierarchy: am.Hierarchy) -> am.Result:
    return am.solve(hierarchy, am.ActiveSet(rtol=1e-12))


@pytest.mark.parametrize(
    "solver", [NESTED, am.FullMultigrid(correction=am.Monotone()), am.ActiveSet()]
)
@pytest.mark.parametrize("dim", [2, 3])
def test_no_bit_depends_on_the_unit_of_force(dim, solver):
    case = am.cases.greco_bar(law=am.Coulomb(0.4)) if dim == 2 else am.cases.greco_block()
    results = []
    # powers of two are exact; the small one makes the entries of a matrix less than one
    for unit in (1.0, 2.0**-44):
        problem = replace(
            case,
            material=replace(case.material, young=unit * case.material.young),
            loads=[replace(load, value=unit * load.value) for load in case.loads],
            reference={},
        )
        grids = am.Hierarchy.uniform(problem, (2, 4, 8) if dim == 2 else (1, 2, 4))
        results.append(am.solve(grids, solver))
    assert results[0].cycles == results[1].cycles
    np.testing.assert_array_equal(results[0].displacement, results[1].displacement)


@pytest.mark.parametrize(
    "transfer", [am.Interpolation(), am.L2(), am.PseudoL2(), am.QuasiInterpolation()], ids=str
)
def test_independent_meshes(transfer):
    hierarchy = am.Hierarchy.graded(
        am.cases.greco_bar(), sizes=(12e-3, 6e-3, 3e-3), contact_ratio=2, transfer=transfer
    )
    result = am.solve(hierarchy, NESTED, reference=exact(hierarchy))
    assert result.history["true_error"][-1] <= 3e-8 and result.cycles <= 15


def test_cycles_and_work_do_not_grow_with_the_mesh():
    results = [
        am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=divisions), NESTED)
        for divisions in ((4, 8, 16, 32), (4, 8, 16, 32, 64))
    ]
    assert all(r.cycles <= 12 for r in results)
    assert results[-1].work_units <= 32 and results[-1].start_work_units <= 1.0
    for friction in (0.1, 2.0):
        grids = am.Hierarchy.uniform(
            am.cases.greco_bar(law=am.Coulomb(friction)), divisions=(4, 8, 16, 32)
        )
        assert am.solve(grids, NESTED).cycles <= 16 and am.solve(grids, COLD).residual <= 1e-7


def test_the_start_on_uniform_plane_grids_is_extrapolated():
    grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8, 16, 32))
    # the same meshes that do not know that they are lattices
    unknown = am.Hierarchy.from_meshes(
        grids.problem, [replace(level.mesh) for level in grids.levels]
    )
    solution = exact(grids)
    here, there = (am.solve(of, NESTED, reference=solution) for of in (grids, unknown))
    assert here.history["true_error"][0] < 0.9 * there.history["true_error"][0]
    assert here.start_work_units == pytest.approx(there.start_work_units)


def test_work_units_by_hand():
    three = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8, 16))
    two = three.truncated(finest=1)
    coarse, middle, fine = (level.matrix.nnz for level in three.levels)
    result = am.solve(two, NESTED)
    # a pass for each Newton step on the coarsest level, which is solved directly
    steps = result.start_work_units * middle / coarse
    assert steps == pytest.approx(round(steps))
    assert result.work_units - result.start_work_units == pytest.approx(result.cycles + 1)
    # from zero there are safe cycles, half a pass more for each line search
    cold = am.solve(two, COLD)
    searches = 2 * (cold.work_units - cold.cycles - 1)
    assert searches == pytest.approx(round(searches)) and searches >= 1
    # on the level in between two sweeps before and after in the first cycle, one symmetric sweep
    # after in the others
    result = am.solve(three, NESTED)
    assert result.work_units - result.start_work_units == pytest.approx(
        result.cycles + 1 + 1.5 * (result.cycles + 1) * middle / fine
    )


def test_discretisation_tolerance_stops_early_below_that_error():
    hierarchy = bar(am.Coulomb(1.0), 16)
    finer = am.solve(bar(am.Coulomb(1.0), 64), replace(NESTED, rtol=1e-10))
    reference = exact(hierarchy)
    result = am.solve(hierarchy, am.FullMultigrid(rtol="discretisation"), reference=reference)
    # every fourth line of the finer grid
    sampled = finer.displacement.reshape(65, 65, 2)[::4, ::4].reshape(-1, 2)
    discretisation = distance(hierarchy.finest.discrete, sampled, reference.displacement)
    assert result.history["true_error"][-1] < discretisation
    assert result.cycles <= 4 and result.rtol == pytest.approx(0.1 * discretisation, rel=0.5)
    # one wild start sets no tolerance
    coarse = am.Hierarchy.uniform(am.cases.greco_bar(), (1, 2))
    assert am.solve(coarse, am.FullMultigrid(rtol="discretisation")).rtol == pytest.approx(1e-2)


def test_bare_matrices():
    hierarchy = bar(am.Coulomb(0.5))
    discrete, reference = hierarchy.finest.discrete, exact(hierarchy)
    nodal = [level.prolongation for level in hierarchy.levels[1:]]
    solver = replace(COLD, rtol=1e-10)
    results = [
        am.solve(am.Hierarchy.from_prolongations(discrete, nodal), solver),
        am.solve(am.Hierarchy.from_prolongations(discrete, [expand(P, 2) for P in nodal]), solver),
        am.solve(am.Hierarchy.algebraic(discrete), solver),
    ]
    for result in results:
        assert (
            np.abs(result.displacement - reference.displacement).max()
            <= 1e-9 * np.abs(reference.displacement).max()
        )
    assert abs(results[0].cycles - results[1].cycles) <= 3
    block = am.cases.greco_block(law=am.Coulomb(0.5), plane_strain=False)
    solid = am.Hierarchy.algebraic(am.Hierarchy.uniform(block, (6,)).finest.discrete)
    assert (
        not solid.discretised and "aggregation" in repr(solid) and am.solve(solid).residual <= 1e-7
    )
    # what needs coarse problems refuses coarse spaces
    for needing in (
        NESTED,
        am.Multigrid(correction=am.Monotone()),
        am.ActiveSet(nested_start=True),
    ):
        with pytest.raises(ValueError, match="only spaces"):
            am.solve(solid, needing)


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


@cache
def levels(name):
    if name == "joint":  # no body is held by contact alone: its coarsest matrix is regular
        return am.Hierarchy.graded(am.cases.bolted_junction(), sizes=(12e-3, 8e-3, 5e-3))
    uniform = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(4, 8, 16))
    return (
        uniform
        if name == "uniform"
        else am.Hierarchy.algebraic(uniform.finest.discrete, max_coarse=20)
    )


@pytest.mark.parametrize(
    "grids, method",
    [("uniform", am.FullMultigrid), ("uniform", am.Multigrid), ("joint", am.FullMultigrid)],
)
def test_a_direct_solver_gives_the_cycles_of_the_factors(grids, method):
    grids, matrices = levels(grids), []
    own = SimpleNamespace(
        setup=lambda matrix: matrices.append(matrix.copy()) or splu(sparse.csc_array(matrix))
    )
    # the right status in the first cycle may leave a singular matrix
    expected, found = (
        am.solve(grids, method(correction=am.Truncated(coarse_contact=False, coarse_solve=solver)))
        for solver in (None, own)
    )
    assert found.cycles == expected.cycles and found.work_units == expected.work_units
    assert far(found, expected) < 1e-8
    # truncated again with the contact status, and regular: no row is empty
    assert len(matrices) > 1 and all((abs(matrix).sum(axis=1) > 0).all() for matrix in matrices)


@pytest.mark.parametrize(("shape", "visits"), [("V", 1), ("W", 2), ("F", 2)])
def test_cycles_visit_the_coarsest_of_three_levels(shape, visits):
    solves = []

    class Counted:
        def setup(self, matrix):
            self.factors = splu(sparse.csc_array(matrix))
            return self

        def solve(self, rhs):
            solves.append(len(rhs))
            return self.factors.solve(rhs)

    parts = am.Truncated(
        correct=am.Cycle(shape=shape), coarse_contact=False, coarse_solve=Counted()
    )
    result = am.solve(levels("uniform"), am.Multigrid(correction=parts))
    assert len(solves) == visits * result.cycles


def test_an_iterative_one_is_counted():
    uniform = levels("uniform")
    own = am.solve(uniform, am.FullMultigrid(correction=am.Truncated(coarse_solve=Jacobi())))
    exact = am.solve(uniform, am.FullMultigrid())
    assert own.status.ok and far(own, exact) < 1e-6
    share = uniform[0].matrix.nnz / uniform.finest.matrix.nnz
    assert own.work_units > exact.work_units + Jacobi.passes * share * (own.cycles - 1)


@pytest.mark.parametrize(
    "grids, method",
    [("uniform", am.FullMultigrid), ("joint", am.FullMultigrid), ("spaces", am.Multigrid)],
)
def test_a_smoother_below_the_finest_level(grids, method):
    grids = levels(grids)
    assert len(grids) > 2
    own = am.solve(grids, method(correction=am.Truncated(coarse_smoother=Jacobi())))
    expected = am.solve(grids, method())
    assert own.status.ok and own.cycles <= expected.cycles + 4
    assert far(own, expected) < 1e-6
    idle = type("Idle", (Jacobi,), {"smooth": lambda self, rhs, x: 0})()
    assert (
        am.solve(grids, method(correction=am.Truncated(coarse_smoother=idle)), throw=False).cycles
        > expected.cycles
    )


def membrane(n: int, coarser: int) -> am.Hierarchy:
    """A square membrane that its load presses on a floor: all nodes but those of the rim are
    contact nodes."""
    along = sparse.diags_array([-np.ones(n), np.full(n + 1, 2.0), -np.ones(n)], offsets=[-1, 0, 1])
    still = sparse.eye_array(n + 1)
    laplacian = sparse.kron(along, still) + sparse.kron(still, along)
    at_rim = np.zeros((n + 1, n + 1), dtype=bool)
    at_rim[[0, -1]] = at_rim[:, [0, -1]] = True
    inner = np.flatnonzero(~at_rim)
    load = np.zeros((at_rim.size, 2))
    load[:, 1] = -np.linspace(1.0, 2.0, at_rim.size) / n**2
    problem = am.DiscreteProblem(
        matrix=sparse.bsr_array(sparse.kron(laplacian, np.eye(2)), blocksize=(2, 2)),
        load=load.reshape(-1),
        fixed=np.repeat(at_rim, 2),
        law=am.Frictionless(),
        contact=am.ContactNodes(
            nodes=inner,
            normals=np.tile([0.0, -1.0], (len(inner), 1)),
            gaps=np.full(len(inner), 0.05),
        ),
    )
    prolongations = []
    for coarse in (n >> k for k in range(coarser, 0, -1)):
        nodes, ends = np.arange(2 * coarse + 1), np.arange(coarse + 1)
        hats = np.maximum(1.0 - np.abs(nodes[:, None] / 2 - ends), 0.0)
        prolongations.append(sparse.kron(hats, hats))
    return am.Hierarchy.from_prolongations(problem, prolongations)


@pytest.mark.parametrize(("n", "coarser"), [(64, 3), (128, 3), (64, 1)])
def test_bodies_all_of_whose_nodes_are_contact_nodes_take_few_cycles(n, coarser):
    result = am.solve(membrane(n, coarser), am.Multigrid())
    assert result.cycles <= 25 and not result.fallback
    assert 0.1 < result.contact.closed.mean() < 0.3


def test_levels_are_smoothed_once_where_their_matrix_is_denser():
    """The mesh next to the coarsest one is not nested in the others."""
    domain = am.cases.greco_bar().domain
    meshes = [am.mesh.structured(domain, n) for n in (2, 8, 16)]
    meshes.insert(1, am.mesh.graded(domain, 8e-3, (), 1))
    grids = am.Hierarchy.from_meshes(am.cases.greco_bar(), meshes)
    path = am.solve(grids, am.Multigrid()).path
    blocks = grids.finest.matrix
    entries = sparse.csr_array((np.ones(len(blocks.indices)), blocks.indices, blocks.indptr))
    density = []
    for level in (3, 2, 1):
        density.append(entries.nnz / entries.shape[0])
        sweeps = {times for number, action, times in path if (number, action) == (level, "smooth")}
        assert sweeps == {1 if density[-1] > 1.25 * density[0] else 2}
        P = abs(grids[level].prolongation)
        entries = P.T @ entries @ P
    assert density[1] < density[0] < 0.7 * density[2]
