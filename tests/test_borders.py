"""What the checks of arguments let pass, and what they make of it: no sound problem is refused."""

import dataclasses

import numpy as np
import pytest
from bodies import pressed, stacked
from refused import refused
from scipy import sparse

import adaptmg as am
from adaptmg import _checks as checks
from adaptmg.solver.record import Outcome

BAR = am.cases.greco_bar()


def square(**changes):
    parts = {
        "material": am.PlaneStrain(young=1e9, poisson=0.3),
        "law": am.Coulomb(0.3),
        "loads": am.Pressure("top", 1e6),
        "supports": am.Support("right", x=0.0),
        "contact": am.Contact("contact", am.Plane((0.0, 0.0), (0.0, 1.0))),
        "domain": am.Polygon(
            vertices=((0, 0), (1, 0), (1, 1), (0, 1)),
            boundaries=("contact", "right", "top", "left"),
        ),
    }
    return am.ContactProblem(**(parts | changes))


def two_chains(error):
    """A stiff and a soft chain of nodes, one entry of the soft one wrong by a share."""
    n = 6
    line = sparse.diags_array(
        [-np.ones(n - 1), 2.1 * np.ones(n), -np.ones(n - 1)], offsets=[-1, 0, 1]
    )
    chain = sparse.csr_array(sparse.kron(line, [[2, 0.5], [0.5, 1]]))
    matrix = sparse.lil_array(sparse.block_diag([1e12 * chain, chain]))
    matrix[2 * n, 2 * n + 2] *= 1 + error
    contact = am.ContactNodes(nodes=[0, n], normals=[[0.0, -1.0]] * 2, gaps=[0.0, 0.0])
    return am.DiscreteProblem(
        matrix=sparse.csr_array(matrix),
        load=np.ones(4 * n),
        fixed=np.zeros(4 * n, dtype=bool),
        law=am.Coulomb(0.3),
        contact=contact,
    )


@pytest.mark.parametrize("scale", [1e-60, 1e60])
def test_symmetry_does_not_depend_on_units(scale):
    discrete = am.Hierarchy.uniform(BAR, 4).finest.discrete
    assert dataclasses.replace(discrete, matrix=scale * discrete.matrix).n_nodes == 25
    wrong = (scale * sparse.csr_array(discrete.matrix)).tolil()
    wrong[0, 2] *= 1.01
    with pytest.raises(ValueError, match="matrix must be symmetric"):
        dataclasses.replace(discrete, matrix=sparse.csr_array(wrong))


@pytest.mark.parametrize("ratio", [1e-12, 1e12])
def test_bodies_of_very_different_stiffness_pass(ratio):
    materials = (
        am.PlaneStrain(young=1e11, poisson=0.3),
        am.PlaneStrain(young=ratio * 1e11, poisson=0.3),
    )
    meshes = [stacked([(3, 2), (4, 3)]), stacked([(6, 4), (8, 6)])]
    problem = pressed(meshes[0], [("upper.bottom", "lower.top")], materials, am.Coulomb(0.3))
    grids = am.Hierarchy.from_meshes(problem, meshes)
    assert all(level.discrete.coupling is not None for level in grids.levels)


def test_what_was_meant():
    problem = square()
    tangential = (am.Support("right", x=0.0), am.Support("contact", x=0.0))
    assert (
        problem.contact_boundaries == ("contact",)
        and len(square(supports=tangential).supports) == 2
    )
    assert two_chains(1e-13).n_nodes == 12
    assert problem.loads == (am.Pressure("top", 1e6),) and problem.supports == (
        am.Support("right", x=0.0),
    )
    grids = am.Hierarchy.uniform(BAR, 4)
    assert len(grids) == len(am.Hierarchy.from_meshes(BAR, grids.finest.mesh)) == 1
    support = am.Support("right", x=np.float32(0.5), y=np.int64(0))
    assert support.x == 0.5 and type(support.x) is float and type(support.y) is float
    assert am.Multigrid(rtol=np.float64(1e-6), max_cycles=np.int32(7)).max_cycles == 7
    for value in (1e-40, 1.0, 10**20, 1e40):
        assert (
            checks.quantity("young", value, positive=True) == value
            and checks.quantity("value", -value) == -value
        )


def test_values_at_free_dofs_and_small_parts_of_a_field_stay():
    law = am.Coulomb(lambda p: np.exp(-1e5 * p[:, 0]))
    discrete = am.Hierarchy.uniform(am.cases.greco_bar(law=law), 4).finest.discrete
    values = np.where(discrete.fixed, 1e-3, np.nan)
    assert dataclasses.replace(discrete, fixed_values=values).fixed_values.max() == 1e-3
    friction = discrete.law.friction
    assert friction[0] == 1.0 and friction.min() == pytest.approx(np.exp(-1e5 * 40e-3))


def test_a_result_that_is_not_finite_has_diverged():
    class Nowhere:
        def run(self, hierarchy, run, start):
            return Outcome(
                np.full((hierarchy.finest.discrete.n_nodes, 2), np.nan), am.Status.LIMIT, 3, 1e-8
            )

    grids = am.Hierarchy.uniform(BAR, (2, 4))
    assert am.solve(grids, Nowhere(), throw=False).status is am.Status.DIVERGED
    with pytest.raises(am.NotConverged, match="DIVERGED"):
        am.solve(grids, Nowhere())


def test_a_user_s_matrix_is_not_changed():
    matrix = sparse.csr_array(
        (np.r_[1.0, 1.0, 1.0], np.r_[0, 0, 0], np.r_[0, 2, 3, 3]), shape=(3, 2)
    )
    before = matrix.copy()
    result = checks.sparse_matrix("matrix", matrix)
    for one in (matrix, result):
        for name in ("indices", "indptr", "data"):  # two entries at one place stay two
            np.testing.assert_array_equal(getattr(one, name), getattr(before, name))
    assert matrix.indices.dtype == before.indices.dtype


def _broken():
    matrix = sparse.lil_array(np.eye(3))
    matrix.rows[1] = [10**6]
    return checks.sparse_matrix("matrix", matrix)


def _falling():
    matrix = sparse.csr_array(np.eye(3))
    matrix.indptr[-1] = 0
    return checks.sparse_matrix("matrix", matrix)


def _cut_blocks():
    blocks = sparse.bsr_array((np.ones((1, 2, 2)), [0], [0, 1]), shape=(3, 3))
    return checks.sparse_matrix("matrix", blocks)


test_refused = refused(
    (_broken, "matrix: indices must be < 3"),
    (_falling, "matrix: indptr must not fall"),
    (_cut_blocks, r"matrix: its shape \(3, 3\) is not a multiple of its blocks \(2, 2\)"),
    *(
        (lambda error=error: two_chains(error), r"matrix must be symmetric.*between nodes 6 and 7")
        for error in (0.32, 1e-7)
    ),
    (
        lambda: square(
            contact=am.Contact("left", am.Plane((0.0, 0.0), (1.0, 0.0))),
            supports=am.Support("contact", x=0),
        ),
        "the name 'contact' stands for all contact boundaries",
    ),
)


@pytest.mark.parametrize("kind", ["csr", "csc", "bsr"])
def test_indices_are_narrowed_to_32_bits_where_they_fit(kind):
    matrix = sparse.random_array((12, 12), density=0.3, rng=np.random.default_rng(1)).asformat(kind)
    wide = matrix.copy()
    wide.indices, wide.indptr = wide.indices.astype(np.int64), wide.indptr.astype(np.int64)
    for result in (checks.narrowed(wide), checks.sparse_matrix("matrix", wide)):
        assert result.indices.dtype == result.indptr.dtype == np.int32
    result = checks.narrowed(wide)
    assert (result != matrix).nnz == 0 and getattr(result, "blocksize", 0) == getattr(
        matrix, "blocksize", 0
    )
    assert result.format == kind and checks.narrowed(result) is result
    large = sparse.csr_array(([1.0], ([0], [2**31])), shape=(1, 2**32))
    assert checks.narrowed(large).indices.dtype == np.int64


def test_a_refused_call_shows_the_arguments():
    for call, takes in (
        (lambda: am.Rectangle(0.1, 0.05), "am.Rectangle(*, width, height, origin="),
        (lambda: am.Polygon(vertices=((0, 0), (1, 0), (0, 1)), edges=("a", "b")), "boundaries)"),
        (lambda: am.Coulomb(), "am.Coulomb(friction)"),
    ):
        with pytest.raises(TypeError) as refused:
            call()
        assert takes in refused.value.__notes__[0]
    with pytest.raises(TypeError, match="friction must be") as refused:
        am.Coulomb("rough")
    assert not hasattr(refused.value, "__notes__")
