"""LocalSystem: the same problem in contact frames, fixed dofs eliminated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from smoother_problems import network

from adaptmg.discrete.problem import ContactNodes, DiscreteProblem
from adaptmg.problem import Coulomb
from adaptmg.smoother import system as codes_of
from adaptmg.smoother.system import OPEN, SLIP, STICK, contact_blocks, contact_codes, inverse_blocks, local_system

RNG = np.random.default_rng(4)


def lifted(dim: int) -> DiscreteProblem:
    """Random links with a fixed tangent at contact, and supports that move."""
    discrete = network(dim, "coulomb", fixed_tangent=True).discrete
    return replace(discrete, fixed_values=np.where(discrete.fixed, 1e-5 * RNG.normal(size=discrete.n_dofs), 0.0))


PROBLEMS = [lifted(2), lifted(3)]


@pytest.mark.parametrize("problem", PROBLEMS, ids=["plane", "solid"])
class TestLocalProblem:
    def test_there_and_back_with_the_same_energy(self, problem):
        local = local_system(problem)
        w = 1e-5 * RNG.normal(size=problem.n_dofs)
        w[local.system.fixed] = 0.0
        u, lift = local.to_cartesian(w).reshape(-1), problem.fixed_values
        np.testing.assert_allclose(local.to_local(u), w, atol=1e-19)
        np.testing.assert_allclose(u[problem.fixed], lift[problem.fixed], atol=1e-19)

        def energy(x):
            return 0.5 * x @ (problem.matrix @ x) - problem.load @ x

        assert 0.5 * w @ (local.system.matrix @ w) - local.load @ w == pytest.approx(energy(u) - energy(lift), rel=1e-9)

    def test_fixed_rows_are_decoupled(self, problem):
        before = problem.matrix.data.copy()
        local = local_system(problem)
        np.testing.assert_array_equal(problem.matrix.data, before)
        matrix, held = local.system.matrix.toarray(), local.system.fixed
        assert held.sum() == problem.fixed.sum()
        assert not matrix[np.ix_(held, ~held)].any() and not matrix[np.ix_(~held, held)].any()
        among = matrix[np.ix_(held, held)]
        assert not (among - np.diag(np.diag(among))).any() and (np.diag(among) > 0).all()
        assert not local.load[held].any()
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(matrix).max())

    def test_contact_conditions_are_the_same(self, problem):
        local, contact = local_system(problem), problem.contact
        np.testing.assert_allclose(local.frames @ np.swapaxes(local.frames, 1, 2),
                                   np.broadcast_to(np.eye(problem.dim), local.frames.shape), atol=1e-14)
        np.testing.assert_allclose(np.linalg.det(local.frames), 1.0, atol=1e-14)
        np.testing.assert_array_equal(local.frames[:, 0], contact.normals)
        u = local.to_cartesian(np.where(local.system.fixed, 0.0, RNG.normal(size=problem.n_dofs)))
        w = local.to_local(u).reshape(-1, problem.dim)[contact.nodes]
        gap = contact.gaps - np.sum(u[contact.nodes] * contact.normals, axis=1)
        np.testing.assert_allclose(local.contact.gap - w[:, 0], gap, atol=1e-13)
        slip = np.einsum("nij,nj->ni", local.frames, u[contact.nodes] - contact.slip_reference)[:, 1:]
        free = ~local.system.fixed.reshape(-1, problem.dim)[contact.nodes, 1:]
        np.testing.assert_allclose((w[:, 1:] - local.contact.slip_reference)[free], slip[free], atol=1e-13)
        limit, friction = problem.law.bounds(len(contact))
        np.testing.assert_array_equal(local.contact.limit, limit)
        np.testing.assert_array_equal(local.contact.friction, friction)

    def test_flat_arrays_describe_the_matrix(self, problem):
        local = local_system(problem)
        system, held, dim, n = local.system, local.contact.held, problem.dim, problem.n_nodes
        nodes = np.arange(n)
        expected = system.matrix.toarray().reshape(n, dim, n, dim)[nodes, :, nodes]
        np.testing.assert_allclose(system.inverse.reshape(-1, dim, dim) @ expected, np.tile(np.eye(dim), (n, 1, 1)),
                                   atol=1e-12)
        if held is not None:
            expected[system.nodes[held], 1, 1] *= -1  # marks the tangent as held
        np.testing.assert_array_equal(system.diagonal.reshape(-1, dim, dim), expected)
        blocks = contact_blocks(problem, local.contact, local.frames)
        np.testing.assert_allclose(blocks, expected[system.nodes], atol=1e-12 * np.abs(blocks).max())
        assert system.nonzeros == len(system.indices) * dim * dim == problem.matrix.nnz
        np.testing.assert_array_equal(system.contact_of[system.nodes], np.arange(len(problem.contact)))
        assert np.count_nonzero(system.contact_of >= 0) == len(problem.contact)


@pytest.mark.parametrize("axes", [[0], [1], [0, 1]])
def test_fixed_tangents_of_a_horizontal_plane(axes):
    fixed = np.zeros((1, 3), dtype=bool)
    fixed[0, axes] = True
    contact = ContactNodes(nodes=[0], normals=[[0.0, 0.0, -1.0]], gaps=[0.0])
    problem = DiscreteProblem(matrix=sparse.eye_array(3).tocsr(), load=np.zeros(3), fixed=fixed.reshape(-1),
                              law=Coulomb(0.3), contact=contact)
    local = local_system(problem)
    lost = local.frames[0, 1:][local.system.fixed[1:]]
    np.testing.assert_allclose(np.abs(lost).sum(axis=0), np.abs(np.eye(3)[axes]).sum(axis=0))
    assert not local.system.fixed[0]


def test_singular_block_is_named():
    blocks = np.tile(np.eye(2), (3, 1, 1))
    blocks[1] = [[1.0, 1.0], [1.0, 1.0]]
    with pytest.raises(ValueError, match="diagonal block of node 1 is singular"):
        inverse_blocks(blocks)


def test_codes_of_contact_nodes_and_their_states():
    free, held, slips, backwards, closed = (getattr(codes_of, name) for name in (
        "FREE", "HELD", "SLIPS", "BACKWARDS", "CLOSED"))
    touch, stick = np.array([0, 0, 1, 1, 1], dtype=bool), np.array([0, 1, 0, 1, 0], dtype=bool)
    assert contact_codes(touch, stick, np.array([0, 1, 0, 1, 1], dtype=bool)).tolist() == [
        slips, held, closed + slips, closed + held, closed + backwards]
    assert contact_codes(touch, stick).tolist() == [slips, held, closed + slips, closed + held, closed + slips]
    codes = np.array([free, held, *(closed + code for code in (free, slips, backwards, held, held))])
    found = codes_of.contact_states(codes, np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 0.0]))
    assert found.dtype == np.int8 and found.tolist() == [OPEN, OPEN, SLIP, SLIP, SLIP, STICK, OPEN]
