"""What the checks at the borders let pass, and what they make of it: no sound problem is refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import sparse

import adaptmg as am
from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg.solver.record import Outcome


def bar(**changes):
    return am.cases.greco_bar(**changes)


def rebuilt(discrete, matrix):
    """The same problem with another matrix."""
    return dataclasses.replace(discrete, matrix=matrix)


def chain(n, stiffness):
    """A block tridiagonal matrix of n nodes in 2D."""
    parts = [-np.ones(n - 1), 2.1 * np.ones(n), -np.ones(n - 1)]
    return stiffness * sparse.csr_array(sparse.kron(sparse.diags_array(parts, offsets=[-1, 0, 1]), [[2, .5], [.5, 1]]))


def two_chains(error):
    """A stiff and a soft body, one entry of the soft one wrong by a share."""
    n = 6
    matrix = sparse.lil_array(sparse.block_diag([chain(n, 1e12), chain(n, 1.0)]))
    matrix[2 * n, 2 * n + 2] *= 1 + error
    contact = am.ContactNodes(nodes=[0, n], normals=[[0.0, -1.0]] * 2, gaps=[0.0, 0.0])
    return am.DiscreteProblem(matrix=sparse.csr_array(matrix), load=np.ones(4 * n), fixed=np.zeros(4 * n, dtype=bool),
                              law=am.Coulomb(0.3), contact=contact)


class TestSymmetry:
    @pytest.mark.parametrize("error", [0.32, 1e-3, 1e-7])
    def test_a_soft_part_is_judged_by_its_own_stiffness(self, error):
        with pytest.raises(ValueError, match=r"matrix must be symmetric.*between nodes 6 and 7"):
            two_chains(error)

    def test_rounding_passes(self):
        assert two_chains(1e-13).n_nodes == 12

    @pytest.mark.parametrize("scale", [1e-60, 1.0, 1e60])
    def test_units_do_not_matter(self, scale):
        matrix = am.Hierarchy.uniform(bar(), (4,)).finest.discrete
        assert rebuilt(matrix, scale * matrix.matrix).n_nodes == 25
        wrong = (scale * sparse.csr_array(matrix.matrix)).tolil()
        wrong[0, 2] *= 1.01
        with pytest.raises(ValueError, match="matrix must be symmetric"):
            rebuilt(matrix, sparse.csr_array(wrong))

    @pytest.mark.parametrize("ratio", [1e-12, 1.0, 1e12])
    def test_bodies_of_very_different_stiffness_pass(self, ratio):
        upper, lower = am.PlaneStrain(young=1e11, poisson=0.3), am.PlaneStrain(young=ratio * 1e11, poisson=0.3)
        problem = am.ContactProblem(
            material={"upper": upper, "lower": lower}, law=am.Coulomb(0.3),
            domain=am.Assembly(parts={"upper": am.Rectangle(width=1.0, height=1.0, origin=(0.0, 1.0)),
                                      "lower": am.Rectangle(width=1.0, height=1.0)}),
            contact=am.ContactPair("upper.bottom", "lower.top"), loads=am.Pressure("upper.top", 1e6),
            supports=am.Support("lower.bottom", x=0.0, y=0.0))
        grids = am.Hierarchy.uniform(problem, ({"upper": (3, 3), "lower": (4, 4)}, {"upper": (7, 7), "lower": (9, 9)}))
        assert all(level.discrete.coupling is not None for level in grids.levels)


class TestWhatWasMeant:
    def test_one_object_for_a_sequence(self):
        problem = am.ContactProblem(
            material=am.PlaneStrain(young=1e9, poisson=0.3), law=am.Coulomb(0.3), loads=am.Pressure("top", 1e6),
            supports=am.Support("right", x=0.0), domain=am.Rectangle(width=1.0, height=1.0),
            contact=am.Contact("bottom", am.Plane((0.0, 0.0), (0.0, 1.0))))
        assert problem.loads == (am.Pressure("top", 1e6),) and problem.supports == (am.Support("right", x=0.0),)

    def test_one_level(self):
        assert len(am.Hierarchy.uniform(bar(), 4)) == 1
        mesh = am.Hierarchy.uniform(bar(), 4).finest.mesh
        assert len(am.Hierarchy.from_meshes(bar(), mesh)) == 1

    def test_numpy_numbers_are_numbers(self):
        support = am.Support("right", x=np.float32(0.5), y=np.int64(0))
        assert support.x == 0.5 and type(support.x) is float and type(support.y) is float
        assert am.Multigrid(rtol=np.float64(1e-6), max_cycles=np.int32(7)).max_cycles == 7

    def test_anything_may_stand_at_free_dofs_of_fixed_values(self):
        discrete = am.Hierarchy.uniform(bar(), 4).finest.discrete
        values = np.where(discrete.fixed, 1e-3, np.nan)
        assert dataclasses.replace(discrete, fixed_values=values).fixed_values.max() == 1e-3

    def test_small_parts_of_a_field_are_kept(self):
        law = am.Coulomb(lambda p: np.exp(-1e5 * p[:, 0]))
        friction = am.Hierarchy.uniform(bar(law=law), 4).finest.discrete.law.friction
        assert friction[0] == 1.0 and friction.min() == pytest.approx(np.exp(-1e5 * 40e-3))


class TestTheNameContact:
    def problem(self, **changes):
        edges = ("contact", "right", "top", "left")
        parts = {"material": am.PlaneStrain(young=1e9, poisson=0.3), "law": am.Frictionless(),
                 "domain": am.Polygon(vertices=((0, 0), (1, 0), (1, 1), (0, 1)), boundaries=edges),
                 "contact": am.Contact("contact", am.Plane((0.0, 0.0), (0.0, 1.0))),
                 "supports": am.Support("right", x=0.0)}
        return am.ContactProblem(**(parts | changes))

    def test_of_the_one_contact_boundary(self):
        assert self.problem().contact_boundaries == ("contact",)

    def test_with_a_support_of_a_tangential_component_there(self):
        problem = self.problem(supports=(am.Support("right", x=0.0), am.Support("contact", x=0.0)))
        assert len(problem.supports) == 2

    def test_of_a_support_elsewhere_is_refused(self):
        with pytest.raises(ValueError, match="the name 'contact' stands for all contact boundaries"):
            self.problem(contact=am.Contact("left", am.Plane((0.0, 0.0), (1.0, 0.0))),
                         supports=am.Support("contact", x=0.0))


class Nowhere:
    """A solver that ends at its limit with numbers that are none."""

    def run(self, hierarchy, run, start):
        discrete = hierarchy.finest.discrete
        return Outcome(np.full((discrete.n_nodes, 2), np.nan), am.Status.LIMIT, 3, 1e-8)


class TestNotFinite:
    def test_a_result_that_is_not_finite_says_so(self):
        result = am.solve(am.Hierarchy.uniform(bar(), (2, 4)), Nowhere(), throw=False)
        assert result.status is am.Status.DIVERGED

    def test_and_is_raised(self):
        with pytest.raises(am.NotConverged, match="DIVERGED"):
            am.solve(am.Hierarchy.uniform(bar(), (2, 4)), Nowhere())


class TestChecks:
    def test_a_user_s_matrix_is_not_changed(self):
        matrix = sparse.csr_array((np.r_[1.0, 1.0, 1.0], np.r_[0, 0, 0], np.r_[0, 2, 3, 3]), shape=(3, 2))
        before = matrix.copy()
        found = check_arrays.sparse_matrix("matrix", matrix)
        for kept in (matrix, found):
            for name in ("indices", "indptr", "data"):  # two entries at one place stay two
                np.testing.assert_array_equal(getattr(kept, name), getattr(before, name))
        assert matrix.indices.dtype == before.indices.dtype

    def test_a_broken_lil_matrix(self):
        matrix = sparse.lil_array(np.eye(3))
        matrix.rows[1] = [10**6]
        with pytest.raises(ValueError, match="matrix: column index 1000000 is outside"):
            check_arrays.sparse_matrix("matrix", matrix)

    def test_bools_hidden_among_numbers(self):
        with pytest.raises(TypeError, match="gaps must be an array of real numbers"):
            check_arrays.array("gaps", [0.0, True], (2,))

    @pytest.mark.parametrize("value", [1e-40, 1.0, 1e40])
    def test_quantities(self, value):
        assert checks.quantity("young", value, positive=True) == value
        assert checks.quantity("value", -value) == -value
