"""Edge bubbles: their stiffness, the actions of fields on them and the work of loads, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from simplex_meshes import random_box
from uncompiled import uncompile

import adaptmg as am
from adaptmg.estimate import edge_bubbles as module
from adaptmg.estimate.edge_bubbles import edge_bubbles
from adaptmg.mesh import structured

MATERIAL = {2: am.PlaneStrain(young=3.0, poisson=0.3), 3: am.Solid(young=3.0, poisson=0.3)}


@pytest.fixture(params=[False, True], ids=["compiled", "plain"])
def jit(request, monkeypatch):
    if request.param:
        uncompile(monkeypatch, module)
    return request.param


def posed(mesh, material, loads=()):
    """A problem on a mesh; of its contact nothing is used here."""
    return am.ContactProblem(name="bubbles", material=material, contact=am.Contact(
        mesh.boundaries[0], am.Plane(point=(0.0,) * mesh.dim, normal=(0.0,) * (mesh.dim - 1) + (1.0,))), loads=loads,
        law=am.Frictionless())


@pytest.mark.parametrize("dim", [2, 3])
def test_blocks_are_the_diagonal_of_a_symmetric_stiffness(dim, jit):
    mesh = random_box(5, dim, 1)
    found = edge_bubbles(mesh, posed(mesh, MATERIAL[dim]))
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


@pytest.mark.parametrize("dim", [2, 3])
def test_linear_fields_act_through_the_boundary_alone(dim, jit):
    mesh = random_box(5, dim, 1)
    found = edge_bubbles(mesh, posed(mesh, MATERIAL[dim]))
    rng = np.random.default_rng(1)
    slope = rng.standard_normal((dim, dim))
    action = found.actions((mesh.points @ slope.T + 1.0)[None])[1][0]
    strain = 0.5 * (slope + slope.T)
    m = MATERIAL[dim]
    stress = m.lame * np.trace(strain) * np.eye(dim) + 2 * m.shear_modulus * strain
    # a traction stress.n on all of the boundary does the same work
    wanted = np.zeros_like(action)
    for name in mesh.boundaries:
        facets = mesh.boundary_facets(name)
        corners = mesh.points[facets]
        if dim == 2:
            side = corners[:, 1] - corners[:, 0]
            area = np.column_stack([side[:, 1], -side[:, 0]])
        else:
            area = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normal = area / np.linalg.norm(area, axis=1)[:, None]
        wanted += found.boundary_work(facets, np.repeat((normal @ stress)[:, None], dim, axis=1))
    np.testing.assert_allclose(action, wanted, atol=1e-12 * np.abs(wanted).max())


def test_jumps_in_the_plane_are_two_thirds_of_the_edge():
    mesh = structured(am.Rectangle(width=1.0, height=1.0), 2)
    found, u = edge_bubbles(mesh, posed(mesh, MATERIAL[2])), np.random.default_rng(0).standard_normal(mesh.points.shape)
    action = found.actions(u[None])[1][0]
    lame, shear = MATERIAL[2].lame, MATERIAL[2].shear_modulus
    wanted = np.zeros_like(action)
    for corners, edges in zip(mesh.elements, found.element_edges, strict=True):
        x = mesh.points[corners]
        slope = np.linalg.solve(x[1:] - x[0], u[corners][1:] - u[corners][0]).T
        strain = 0.5 * (slope + slope.T)
        stress = lame * np.trace(strain) * np.eye(2) + 2 * shear * strain
        for edge, (a, b) in zip(edges, ((1, 2), (2, 0), (0, 1)), strict=True):
            side = x[b] - x[a]
            wanted[edge] += 2 / 3 * stress @ np.array([side[1], -side[0]])
    np.testing.assert_allclose(action, wanted, atol=1e-12 * np.abs(wanted).max())


def test_axisymmetric_uniform_stress_does_no_work_inside(jit):
    material = am.Axisymmetric(young=3.0, poisson=0.3)
    mesh = structured(am.Rectangle(width=1.0, height=1.0, origin=(0.5, 0.0)), 3)
    found = edge_bubbles(mesh, posed(mesh, material))
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
    work = found.load()
    # the integral of 4 la lb is V 8 / ((d + 1)(d + 2) 2) for each edge of an element
    share = 4 / ((dim + 1) * (dim + 2))
    wanted = share * np.outer(np.bincount(found.element_edges.ravel(), np.repeat(mesh.volumes,
                                                                                 found.element_edges.shape[1])), force)
    np.testing.assert_allclose(work, wanted, rtol=1e-12)
    work = edge_bubbles(mesh, posed(mesh, MATERIAL[dim], (am.Traction(name, force),))).load()
    np.testing.assert_allclose(work.sum(axis=0), np.array(force) * (2 / 3 if dim == 2 else 1.0)
                               * _size(mesh, mesh.boundary_facets(name)), rtol=1e-12)


def test_pressure_is_a_traction_against_the_normal_and_initial_strain_a_stress():
    mesh = random_box(3, 2, 1)
    every = tuple(am.Pressure(name, 2.0) for name in mesh.boundaries)
    pressed = edge_bubbles(mesh, posed(mesh, MATERIAL[2], every)).load()
    lame, shear = MATERIAL[2].lame, MATERIAL[2].shear_modulus
    strain = -2.0 / (2 * lame + 2 * shear)
    field = strain * mesh.points
    found = edge_bubbles(mesh, posed(mesh, MATERIAL[2], (am.InitialStrain(mesh.bodies[0], (strain, strain)),)))
    action = found.actions(field[None])[1][0]
    np.testing.assert_allclose(pressed, action, atol=1e-12)
    np.testing.assert_allclose(found.load(), action, atol=1e-12)


def _size(mesh, facets):
    corners = mesh.points[facets]
    if mesh.dim == 2:
        return np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).sum()
    return 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
