"""DiscreteProblem and ContactNodes refuse what no solver could make sense of."""

import numpy as np
import pytest
from scipy import sparse

from adaptmg.discrete.problem import ContactNodes, DiscreteProblem, rigid_body_modes
from adaptmg.problem import Coulomb, Frictionless, Tresca


def contact(**changes: object) -> ContactNodes:
    arguments = {"nodes": [0, 2], "normals": [[0.0, -1.0], [0.6, -0.8]], "gaps": [0.0, 0.1]}
    return ContactNodes(**(arguments | changes))


def discrete(**changes: object) -> DiscreteProblem:
    arguments = {"matrix": sparse.eye_array(6).tocsr(), "load": np.zeros(6), "fixed": np.zeros(6, dtype=bool),
                 "law": Frictionless(), "contact": contact()}
    return DiscreteProblem(**(arguments | changes))


class TestContactNodes:
    def test_arrays_are_read_only_copies_with_defaults(self):
        gaps = np.array([0.0, -1e-3])
        nodes = contact(gaps=gaps, allow_interference=True, normals=[[0.0, -1.0 - 5e-7], [0.6, -0.8]])
        gaps[0] = 5.0
        assert len(nodes) == 2 and nodes.dim == 2 and nodes.gaps.tolist() == [0.0, -1e-3]
        np.testing.assert_array_equal(nodes.weights, 1.0)
        assert not nodes.slip_reference.any() and not nodes.boundary.any()
        np.testing.assert_allclose(np.linalg.norm(nodes.normals, axis=1), 1.0, rtol=1e-15)
        for array in (nodes.gaps, nodes.normals):
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1.0

    @pytest.mark.parametrize(("changes", "error", "message"), [
        ({"nodes": [2, 2]}, ValueError, "distinct"),
        ({"nodes": np.zeros(0, dtype=int), "normals": np.zeros((0, 2)), "gaps": []}, ValueError, "nodes is empty"),
        ({"normals": [[0.0, np.nan], [0.6, -0.8]]}, ValueError, "normals must be finite; 1 entries are not"),
        ({"normals": [[0.0, -1.0], [0.6, -0.9]]}, ValueError, "contact node 1 has length 1.08"),
        ({"gaps": [0.0, -1e-3]}, ValueError, "got -0.001 at contact node 1; for an interference fit"),
        ({"weights": [1.0, 0.0]}, ValueError, "weights must be > 0"),
        ({"boundary": [0, 1]}, ValueError, "boundary must index names"),
    ])
    def test_refuses(self, changes, error, message):
        with pytest.raises(error, match=message):
            contact(**changes)


class Negative(Frictionless):
    def bounds(self, n_contact):
        return np.zeros(n_contact), np.full(n_contact, -1.0)


class TestDiscreteProblem:
    def test_what_is_made_of_the_arrays(self):
        points, own = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.ones((6, 1))
        fixed = np.array([True, False, True, False, False, False])  # a fixed tangent is fine
        rounding = (sparse.eye_array(6) + sparse.eye_array(6, k=1) * 1e-12).tocsr()
        problem = discrete(matrix=rounding, fixed=fixed, fixed_values=np.arange(1.0, 7.0), coordinates=points)
        assert problem.matrix.format == "bsr" and problem.matrix.blocksize == (2, 2)
        assert (problem.n_nodes, problem.n_dofs, problem.dim) == (3, 6, 2)
        np.testing.assert_array_equal(problem.fixed_values, [1, 0, 3, 0, 0, 0])
        assert problem.near_nullspace.shape == (6, 3) and discrete().near_nullspace is None
        np.testing.assert_array_equal(discrete(coordinates=points, near_nullspace=own).near_nullspace, own)

    @pytest.mark.parametrize(("changes", "error", "message"), [
        ({"matrix": sparse.csr_array((6, 6))}, ValueError, "matrix is zero"),
        ({"matrix": sparse.diags_array([1, 1, 1, -1, 1, 1.0]).tocsr()}, ValueError, r"entry 3 \(node 1\) is -1"),
        ({"matrix": (sparse.eye_array(6) + sparse.eye_array(6, k=1) * 1e-3).tocsr()}, ValueError, "must be symmetric"),
        ({"law": Coulomb(np.ones(3))}, ValueError, "array over the 2 contact nodes"),
        ({"law": Tresca(lambda x: x[:, 0])}, TypeError, "evaluated at the nodes first"),
        ({"law": Negative()}, ValueError, "nodal friction must be finite and >= 0"),
        ({"contact": contact(nodes=[0, 3])}, ValueError, "node 3 does not exist; there are 3 nodes"),
        ({"fixed": np.array([False, True, False, False, False, False])}, ValueError, "normal part is fixed"),
        ({"fixed": np.array([False, False, False, False, True, False])}, ValueError, "contact node 1"),
    ])
    def test_refuses(self, changes, error, message):
        with pytest.raises(error, match=message):
            discrete(**changes)


@pytest.mark.parametrize("dim", [2, 3])
def test_rigid_body_modes_are_orthonormal_and_strain_free(dim):
    rng = np.random.default_rng(0)
    points = 5.0 + rng.random((20, dim))
    modes = rigid_body_modes(points)
    k = 3 if dim == 2 else 6
    np.testing.assert_allclose(modes.T @ modes, np.eye(k), atol=1e-13)
    # a rigid motion leaves all distances alone to first order
    i, j = rng.integers(0, 20, (2, 50))
    for mode in modes.T:
        u = mode.reshape(-1, dim)
        np.testing.assert_allclose(np.sum((u[i] - u[j]) * (points[i] - points[j]), axis=1), 0.0, atol=1e-13)
