"""Load vectors: resultant force and moment are exact, functions of position included; supports prescribe."""

from dataclasses import replace

import numpy as np
import pytest
from refused import refused
from test_elasticity import BOTH, EACH_KIND, HEIGHT, INNER, OUTER, PARTS, RING, STEEL, measures, two

from adaptmg.discrete import fixed_dofs, load_vector
from adaptmg.mesh import structured
from adaptmg.problem import BodyForce, Box, PlaneStrain, Pressure, Rectangle, Support, Traction

PLATE = structured(Rectangle(width=2.0, height=1.0), (5, 3))
BLOCK = structured(Box(width=2.0, depth=3.0, height=1.0), (3, 2, 2))


def resultants(mesh, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force (dim,) and virtual works (dim, dim) of the fields x_j e_i."""
    nodal = load.reshape(-1, mesh.dim)
    return nodal.sum(axis=0), nodal.T @ mesh.points


@pytest.mark.parametrize(("load", "force", "moment"), [
    (Pressure("top", 3.0), [0.0, -6.0], [[0, 0], [-6.0, -6.0]]),
    # p = 1 + y on the left: force 3/2 in +x, moment of y: int (1 + y) y = 1/2 + 1/3
    (Pressure("left", lambda x: 1 + x[:, 1]), [1.5, 0.0], [[0.0, 5 / 6], [0.0, 0.0]]),
    (Traction("right", (lambda x: x[:, 1], 2.0)), [0.5, 2.0], [[1.0, 1 / 3], [4.0, 1.0]]),
    # int x = 2, int x^2 = 8/3, int x y = 1; over 2 x 1
    (BodyForce((lambda x: x[:, 0], -2.0)), [2.0, -4.0], [[8 / 3, 1.0], [-4.0, -2.0]]),
    # p = x + y on the top, 2 x 3: int p = 6 + 9; int p x = 3*8/3 + 2*4.5; int p y = 2*4.5 + 2*9
    (Pressure("top", lambda x: x[:, 0] + x[:, 1]), [0, 0, -15.0], [[0, 0, 0], [0, 0, 0], [-17.0, -27.0, -15.0]]),
    # volume 6: int z = 3, int z x = 3, int z y = 4.5, int z^2 = 2
    (BodyForce((0.0, lambda x: x[:, 2], 1.0)), [0.0, 3.0, 6.0], [[0, 0, 0], [3.0, 4.5, 2.0], [6.0, 9.0, 3.0]]),
], ids=["pressure", "linear pressure", "traction", "body force", "pressure 3D", "body force 3D"])
def test_resultants(load, force, moment):
    mesh = PLATE if len(force) == 2 else BLOCK
    found = resultants(mesh, load_vector(mesh, [load]))
    np.testing.assert_allclose(found[0], force, atol=1e-13)
    np.testing.assert_allclose(found[1], moment, atol=1e-13)


def test_loads_add_up():
    loads = [Pressure("top", 3.0), BodyForce((1.0, 0.0))]
    np.testing.assert_allclose(load_vector(PLATE, loads), sum(load_vector(PLATE, [load]) for load in loads))
    assert not load_vector(PLATE, []).any()
    # without a material, or with a plane one, loads are Cartesian
    loads, plane = [Pressure("top", 3e6), BodyForce((1.0, 2.0))], PlaneStrain(young=1.0, poisson=0.2)
    np.testing.assert_array_equal(load_vector(RING, loads), load_vector(RING, loads, plane))
    assert not np.allclose(load_vector(RING, loads), load_vector(RING, loads, STEEL))


def test_consistent_nodal_forces():
    # one edge of length 2 under p = x: the P1 values 2/3 and 4/3
    mesh = structured(Rectangle(width=2.0, height=1.0), 1)
    load = load_vector(mesh, [Pressure("bottom", lambda x: x[:, 0])]).reshape(-1, 2)
    np.testing.assert_allclose(load[mesh.boundary_nodes("bottom"), 1], [2 / 3, 4 / 3])
    # int 2 pi r phi_i over an edge of length L: pi L (2 r_i + r_j) / 3; on the axis itself it is not zero
    load = load_vector(mesh, [Pressure("bottom", 1.0)], STEEL).reshape(-1, 2)
    np.testing.assert_allclose(load[mesh.boundary_nodes("bottom"), 1], np.pi * 2 / 3 * np.array([2, 2 * 2]))


# the powers of r and z in the volume and at the top come from int r^n dr; k = 2e5
@pytest.mark.parametrize(("load", "force", "work"), [
    (Pressure("top", 3e6), [0.0, -3e6 * np.pi * (OUTER**2 - INNER**2)], None),
    (Pressure("left", 3e6), [3e6 * 2 * np.pi * INNER * HEIGHT, 0.0], None),
    (BodyForce((0.0, -7e4)), [0.0, -7e4 * measures(RING, True).sum()], None),
    (BodyForce((lambda x: 2e5 * x[:, 0], 0.0)), None, 4e5 * np.pi * HEIGHT * (OUTER**4 - INNER**4) / 4),
    (Traction("top", (0.0, lambda x: 2e5 * x[:, 0])), None, 4e5 * np.pi * HEIGHT * (OUTER**3 - INNER**3) / 3)])
def test_axisymmetric_forces_and_the_virtual_work_of_linear_data_are_exact(load, force, work):
    found = load_vector(RING, [load], STEEL)
    if force is not None:
        np.testing.assert_allclose(found.reshape(-1, 2).sum(axis=0), force, rtol=1e-12, atol=1e-8)
    else:
        assert found @ RING.points.reshape(-1) == pytest.approx(work, rel=1e-12)


@EACH_KIND
def test_loads_on_one_body(kind):
    mesh, materials = BOTH[kind.dim], two(kind)
    force = (1.0, lambda x: x[:, 0], 3.0)[:kind.dim]
    found = load_vector(mesh, [BodyForce(force, body="upper")], materials).reshape(-1, kind.dim)
    alone = load_vector(PARTS[kind.dim]["upper"], [BodyForce(force)], materials["upper"]).reshape(-1, kind.dim)
    lower = PARTS[kind.dim]["lower"].n_nodes
    assert not found[:lower].any()
    np.testing.assert_allclose(found[lower:], alone, rtol=1e-13)
    each = [BodyForce(force, body=body) for body in mesh.bodies]
    np.testing.assert_allclose(load_vector(mesh, each, materials), load_vector(mesh, [BodyForce(force)], materials),
                               rtol=1e-13)
    pressed = load_vector(mesh, [Pressure("upper.top", 2.0)]).reshape(-1, kind.dim)
    assert pressed[lower:].any() and not pressed[:lower].any()


def test_supports_give_a_mask_and_values():
    fixed, values = (found.reshape(-1, 3) for found in fixed_dofs(BLOCK, [
        Support("left", x=1e-3, y=0.0), Support("front", y=0.0, z=-2e-3)]))
    left, front = (np.isin(np.arange(BLOCK.n_nodes), BLOCK.boundary_nodes(name)) for name in ("left", "front"))
    np.testing.assert_array_equal(fixed, np.column_stack([left, left | front, front]))
    np.testing.assert_array_equal(values, np.column_stack([1e-3 * left, 0 * left, -2e-3 * front]))
    assert not np.any(fixed_dofs(PLATE, []))


EMPTY = replace(PLATE, boundaries=(*PLATE.boundaries, "hole"))


test_refusals = refused(
    (lambda: load_vector(PLATE, [Pressure("roof", 1.0)]), "'roof' does not exist; the boundaries are bottom"),
    (lambda: load_vector(EMPTY, [Pressure("hole", 1.0)]), "'hole' has a name in the mesh but no facets"),
    (lambda: fixed_dofs(EMPTY, [Support("hole", x=0.0)]), "'hole' has a name in the mesh but no facets"),
    (lambda: load_vector(replace(RING, points=RING.points - [0.15, 0.0]), [], STEEL), "radii x >= 0"),
    (lambda: fixed_dofs(PLATE, [Support("left", x=0.0), Support("bottom", x=1e-3)]),
     r"'left' and 'bottom' prescribe different x displacements, 0 and 0\.001 m, at their common node 0"),
    (lambda: fixed_dofs(PLATE, [Support("wall", x=0.0)]), "'wall' does not exist"))
