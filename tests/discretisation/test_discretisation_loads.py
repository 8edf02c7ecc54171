"""Load vectors: resultant force and moment are exact, functions of position included; supports prescribe."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adaptmg.discrete import fixed_dofs, load_vector
from adaptmg.discrete.facets import area_vectors
from adaptmg.mesh import structured
from adaptmg.problem import BodyForce, Box, Pressure, Rectangle, Support, Traction

PLATE = structured(Rectangle(width=2.0, height=1.0), (5, 3))
BLOCK = structured(Box(width=2.0, depth=3.0, height=1.0), (3, 2, 2))


def resultants(mesh, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force (dim,) and virtual works (dim, dim) of the fields x_j e_i."""
    nodal = load.reshape(-1, mesh.dim)
    return nodal.sum(axis=0), nodal.T @ mesh.points


class TestPlane:
    def test_constant_pressure(self):
        force, moment = resultants(PLATE, load_vector(PLATE, [Pressure("top", 3.0)]))
        np.testing.assert_allclose(force, [0.0, -6.0], atol=1e-14)
        np.testing.assert_allclose(moment, [[0, 0], [-6.0, -6.0]], atol=1e-14)

    def test_linear_pressure(self):
        # p = 1 + y on the left: force 3/2 in +x, moment of y: int (1 + y) y = 1/2 + 1/3
        force, moment = resultants(PLATE, load_vector(PLATE, [Pressure("left", lambda x: 1 + x[:, 1])]))
        np.testing.assert_allclose(force, [1.5, 0.0], atol=1e-14)
        np.testing.assert_allclose(moment, [[0.0, 5 / 6], [0.0, 0.0]], atol=1e-14)

    def test_traction(self):
        force, moment = resultants(PLATE, load_vector(PLATE, [Traction("right", (lambda x: x[:, 1], 2.0))]))
        np.testing.assert_allclose(force, [0.5, 2.0], atol=1e-14)
        np.testing.assert_allclose(moment, [[1.0, 1 / 3], [4.0, 1.0]], atol=1e-14)

    def test_body_force(self):
        force, moment = resultants(PLATE, load_vector(PLATE, [BodyForce((lambda x: x[:, 0], -2.0))]))
        # int x = 2, int x^2 = 8/3, int x y = 1; over 2 x 1
        np.testing.assert_allclose(force, [2.0, -4.0], atol=1e-13)
        np.testing.assert_allclose(moment, [[8 / 3, 1.0], [-4.0, -2.0]], atol=1e-13)

    def test_loads_add_up(self):
        loads = [Pressure("top", 3.0), BodyForce((1.0, 0.0))]
        np.testing.assert_allclose(load_vector(PLATE, loads), sum(load_vector(PLATE, [load]) for load in loads))
        assert not load_vector(PLATE, []).any()

    def test_consistent_nodal_forces(self):
        # one edge of length 2 under p = x: the P1 values 2/3 and 4/3
        mesh = structured(Rectangle(width=2.0, height=1.0), 1)
        load = load_vector(mesh, [Pressure("bottom", lambda x: x[:, 0])]).reshape(-1, 2)
        np.testing.assert_allclose(load[mesh.boundary_nodes("bottom"), 1], [2 / 3, 4 / 3])


class TestSolid:
    def test_linear_pressure(self):
        # p = x + y on the top, 2 x 3: int p = 6 + 9; int p x = 3*8/3 + 2*4.5; int p y = 2*4.5 + 2*9
        force, moment = resultants(BLOCK, load_vector(BLOCK, [Pressure("top", lambda x: x[:, 0] + x[:, 1])]))
        np.testing.assert_allclose(force, [0.0, 0.0, -15.0], atol=1e-13)
        np.testing.assert_allclose(moment[2], [-17.0, -27.0, -15.0], atol=1e-13)
        np.testing.assert_allclose(moment[:2], 0.0, atol=1e-13)

    def test_linear_body_force(self):
        force, moment = resultants(BLOCK, load_vector(BLOCK, [BodyForce((0.0, lambda x: x[:, 2], 1.0))]))
        # volume 6: int z = 3, int z x = 3, int z y = 4.5, int z^2 = 2
        np.testing.assert_allclose(force, [0.0, 3.0, 6.0], atol=1e-13)
        np.testing.assert_allclose(moment[1], [3.0, 4.5, 2.0], atol=1e-13)

    @pytest.mark.parametrize("mesh", [PLATE, BLOCK])
    def test_uniform_pressure_all_around_is_in_equilibrium(self, mesh):
        load = load_vector(mesh, [Pressure(name, 7.0) for name in mesh.boundaries])
        force, moment = resultants(mesh, load)
        np.testing.assert_allclose(force, 0.0, atol=1e-12)
        # virtual work of x_j e_i is -p volume delta_ij
        np.testing.assert_allclose(moment, -7.0 * mesh.volumes.sum() * np.eye(mesh.dim), atol=1e-12)


@pytest.mark.parametrize("mesh", [PLATE, BLOCK])
def test_area_vectors_close_the_surface(mesh):
    vectors = area_vectors(mesh.points, mesh.facets)
    np.testing.assert_allclose(vectors.sum(axis=0), 0.0, atol=1e-13)
    # divergence theorem with the field x / dim: outward, and of the right size
    centres = mesh.points[mesh.facets].mean(axis=1)
    assert np.sum(vectors * centres) / mesh.dim == pytest.approx(mesh.volumes.sum())


class TestRefusals:
    def test_unknown_boundary(self):
        with pytest.raises(ValueError, match="'roof' does not exist; the boundaries are bottom"):
            load_vector(PLATE, [Pressure("roof", 1.0)])

    def test_boundary_without_facets(self):
        empty = replace(PLATE, boundaries=(*PLATE.boundaries, "hole"))
        with pytest.raises(ValueError, match="'hole' has a name in the mesh but no facets"):
            load_vector(empty, [Pressure("hole", 1.0)])
        with pytest.raises(ValueError, match="'hole' has a name in the mesh but no facets"):
            fixed_dofs(empty, [Support("hole", x=0.0)])

    def test_components(self):
        with pytest.raises(ValueError, match="3 components on a 2D mesh"):
            load_vector(PLATE, [BodyForce((0.0, 0.0, 1.0))])

    def test_functions(self):
        with pytest.raises(ValueError, match="pressure on 'top' must be finite"):
            load_vector(PLATE, [Pressure("top", lambda x: np.where(x[:, 0] > 1, np.inf, 1.0))])
        with pytest.raises(ValueError, match=r"component y of BodyForce: the function must return shape"):
            load_vector(PLATE, [BodyForce((0.0, lambda x: x))])


class TestSupports:
    def test_mask_and_values(self):
        fixed, values = fixed_dofs(PLATE, [Support("left", x=1e-3), Support("bottom", y=-2e-3)])
        left, bottom = PLATE.boundary_nodes("left"), PLATE.boundary_nodes("bottom")
        np.testing.assert_array_equal(np.flatnonzero(fixed), np.sort(np.r_[2 * left, 2 * bottom + 1]))
        np.testing.assert_array_equal(values[2 * left], 1e-3)
        np.testing.assert_array_equal(values[2 * bottom + 1], -2e-3)
        assert np.count_nonzero(values) == len(left) + len(bottom)

    def test_supports_that_agree(self):
        fixed, values = fixed_dofs(BLOCK, [Support("left", x=1.0, y=0.0), Support("front", y=0.0, z=2.0)])
        corner = np.intersect1d(BLOCK.boundary_nodes("left"), BLOCK.boundary_nodes("front"))
        np.testing.assert_array_equal(fixed.reshape(-1, 3)[corner], True)
        np.testing.assert_array_equal(values.reshape(-1, 3)[corner], [[1.0, 0.0, 2.0]] * len(corner))

    def test_conflict(self):
        message = r"'left' and 'bottom' prescribe different x displacements, 0 and 0\.001 m, at their common node 0"
        with pytest.raises(ValueError, match=message):
            fixed_dofs(PLATE, [Support("left", x=0.0), Support("bottom", x=1e-3)])

    def test_nothing(self):
        fixed, values = fixed_dofs(PLATE, [])
        assert not fixed.any() and not values.any()

    def test_refuses(self):
        with pytest.raises(ValueError, match="'wall' does not exist"):
            fixed_dofs(PLATE, [Support("wall", x=0.0)])
        with pytest.raises(ValueError, match="2D problem"):
            fixed_dofs(PLATE, [Support("left", z=0.0)])
