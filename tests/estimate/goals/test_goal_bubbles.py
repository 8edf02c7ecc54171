"""Edge bubbles: their stiffness, the actions of fields on them and the work of loads, against closed forms."""

import numpy as np
import pytest
from simplex_meshes import random_box

import adaptmg as am
from adaptmg.estimate.edge_bubbles import edge_bubbles
from adaptmg.mesh import structured

MATERIAL = {2: am.PlaneStrain(young=3.0, poisson=0.3), 3: am.Solid(young=3.0, poisson=0.3)}
ROUND, RING = am.Axisymmetric(young=3.0, poisson=0.3), am.Rectangle(width=1.0, height=1.0, origin=(0.5, 0.0))


def posed(mesh, material, loads=()):
    """A problem on a mesh; of its contact nothing is used here."""
    plane = am.Plane(point=(0.0,) * mesh.dim, normal=(0.0,) * (mesh.dim - 1) + (1.0,))
    return am.ContactProblem(material=material, contact=am.Contact(mesh.boundaries[0], plane), loads=loads,
                             law=am.Frictionless())


@pytest.mark.parametrize("material", [*MATERIAL.values(), ROUND], ids=["2D", "3D", "axisymmetric"])
def test_blocks_are_the_diagonal_of_a_symmetric_stiffness(material):
    mesh = structured(RING, 2) if material is ROUND else random_box(5, material.dim, 1)
    dim, found = mesh.dim, edge_bubbles(mesh, posed(mesh, material))
    blocks, _ = found.actions(np.zeros((1, mesh.n_nodes, dim)))
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((2, len(found.edges), dim))
    assert np.sum(y * found.stiffness(x)) == pytest.approx(np.sum(x * found.stiffness(y)), rel=1e-12)
    for edge in (0, len(found.edges) // 2):
        for k in range(dim):
            unit = np.zeros_like(x)
            unit[edge, k] = 1.0
            np.testing.assert_allclose(found.stiffness(unit)[edge], blocks[edge, :, k], rtol=1e-12,
                                       atol=1e-12 * np.abs(blocks).max())


def test_axisymmetric_uniform_stress_does_no_work_inside():
    mesh = structured(RING, 3)
    found = edge_bubbles(mesh, posed(mesh, ROUND))
    field = np.column_stack([0.3 * mesh.points[:, 0], -0.7 * mesh.points[:, 1]])
    action = found.actions(field[None])[1][0]
    inner = np.ones(len(found.edges), dtype=bool)
    inner[found.of_facets(mesh.facets).ravel()] = False
    assert np.abs(action[inner]).max() < 1e-12 * np.abs(action).max()


@pytest.mark.parametrize("dim", [2, 3])
def test_loads_do_the_work_of_their_integrals(dim):
    mesh = random_box(3, dim, 1)
    force, name = (1.0, -2.0, 3.0)[:dim], mesh.boundaries[-1]
    found = edge_bubbles(mesh, posed(mesh, MATERIAL[dim], (am.BodyForce(force),)))
    # the integral of 4 la lb is V 8 / ((d + 1)(d + 2) 2) for each edge of an element
    around = np.bincount(found.element_edges.ravel(), np.repeat(mesh.volumes, found.element_edges.shape[1]))
    np.testing.assert_allclose(found.load(), 4 / ((dim + 1) * (dim + 2)) * np.outer(around, force), rtol=1e-12)
    work = edge_bubbles(mesh, posed(mesh, MATERIAL[dim], (am.Traction(name, force),))).load().sum(axis=0)
    size = mesh.surface(name).measures.sum()
    np.testing.assert_allclose(work, np.array(force) * (2 / 3 if dim == 2 else 1.0) * size, rtol=1e-12)


@pytest.mark.parametrize("dim", [2, 3])
def test_linear_fields_act_through_the_boundary_alone(dim):
    mesh, m = random_box(5, dim, 1), MATERIAL[dim]
    found = edge_bubbles(mesh, posed(mesh, m))
    slope = np.random.default_rng(1).standard_normal((dim, dim))
    strain = 0.5 * (slope + slope.T)
    stress = m.lame * np.trace(strain) * np.eye(dim) + 2 * m.shear_modulus * strain
    action, wanted = found.actions((mesh.points @ slope.T + 1.0)[None])[1][0], 0.0
    for surface in map(mesh.surface, mesh.boundaries):
        wanted = wanted + found.boundary_work(surface, np.repeat((surface.normals @ stress)[:, None], dim, axis=1))
    np.testing.assert_allclose(action, wanted, atol=1e-12 * np.abs(wanted).max())
    pressed = edge_bubbles(mesh, posed(mesh, m, tuple(am.Pressure(name, 2.0) for name in mesh.boundaries))).load()
    even = -2.0 / (dim * m.lame + 2 * m.shear_modulus)
    strained = edge_bubbles(mesh, posed(mesh, m, (am.InitialStrain(mesh.bodies[0], (even,) * dim),)))
    for load in (pressed, strained.load()):
        np.testing.assert_allclose(load, strained.actions(even * mesh.points[None])[1][0], atol=1e-12)
