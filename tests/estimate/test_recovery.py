"""Recovered stresses reproduce linear ones, are as good at boundaries as inside, and do not cross materials."""

import dataclasses

import numpy as np
import pytest
from made import cube, square
from scipy.sparse.linalg import spsolve
from simplex_meshes import random_box

import adaptmg as am
from adaptmg.discrete import stress as fit
from adaptmg.discrete.elasticity import stiffness
from adaptmg.discrete.stress import StressData
from adaptmg.estimate.estimate import recovered_energy
from adaptmg.estimate.stress_fields import ElementStress, element_stress

KINDS = {2: am.PlaneStrain, 3: am.Solid}


@pytest.mark.parametrize("dim", [2, 3])
def test_linear_stresses_are_reproduced_at_every_node(dim):
    mesh = random_box(12, dim, 4)
    data = StressData.of(mesh, KINDS[dim](young=1.0, poisson=0.3))
    rng = np.random.default_rng(0)
    slope, constant = rng.standard_normal((dim, 3 * dim - 3)), rng.standard_normal(3 * dim - 3)
    values = mesh.points[mesh.elements].mean(axis=1) @ slope + constant
    stress = ElementStress(mesh, np.zeros(mesh.points.shape), data, values)
    _, nodal = fit.recovered(mesh, stress.values)
    np.testing.assert_allclose(nodal, mesh.points @ slope + constant, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
def test_energy_is_that_of_the_compliance(dim):
    mesh, material = random_box(4, dim, 1), KINDS[dim](young=3.0, poisson=0.3)
    stress = element_stress(mesh, np.zeros(mesh.points.shape), StressData.of(mesh, material))
    nodal = np.random.default_rng(0).standard_normal((mesh.n_nodes, 3 * dim - 3))
    # for shear stresses that count once
    elastic = np.diag(np.repeat([2.0, 1.0], [dim, 2 * dim - 3])) * material.shear_modulus
    elastic[:dim, :dim] += material.lame
    # means of products of hat functions
    products = (np.ones((dim + 1, dim + 1)) + np.eye(dim + 1)) / ((dim + 1) * (dim + 2))
    corners = nodal[mesh.elements]
    wanted = mesh.volumes * np.einsum("kl,ekc,cd,eld->e", products, corners, np.linalg.inv(elastic), corners)
    np.testing.assert_allclose(recovered_energy(stress, mesh.elements, nodal), wanted, rtol=1e-11)


def test_the_stress_may_jump_where_materials_meet():
    whole = square(4)
    upper = whole.points[whole.elements, 1].mean(axis=1) > 0.02
    mesh = dataclasses.replace(whole, bodies=("soft", "stiff"), element_body=upper.astype(np.int32))
    materials = {"soft": am.PlaneStress(young=1e9, poisson=0.2), "stiff": am.PlaneStress(young=9e9, poisson=0.2)}
    # the same strains in both: the stresses are constant in each
    stress = element_stress(mesh, 1e-3 * mesh.points, StressData.of(mesh, materials))
    cells, nodal = fit.recovered(mesh, stress.values)
    assert len(nodal) == mesh.n_nodes + 5  # the nodes of the interface twice
    assert recovered_energy(stress, cells, nodal).max() < 1e-20 * (1e-3)**2 * 9e9
    glued = dataclasses.replace(mesh, bodies=("all",), element_body=None)
    one = dataclasses.replace(stress, mesh=glued, data=StressData.of(glued, materials["soft"]))
    assert recovered_energy(one, *fit.recovered(glued, one.values)).max() > 1e-6 * (1e-3)**2 * 9e9


def test_axisymmetric_stress_is_recovered_with_its_hoop_part():
    mesh = square(4)
    strain = am.InitialStrain("body", (1e-3, 2e-3, -3e-3))
    data = StressData.of(mesh, am.Axisymmetric(young=1e9, poisson=0.3), [strain])
    r, z = mesh.points.T
    stress = element_stress(mesh, np.column_stack([2e-3 * r, -1e-3 * z]), data)
    cells, nodal = fit.recovered(mesh, stress.values)
    assert recovered_energy(stress, cells, nodal).max() < 1e-12
    # a constant added to the hoop stress: its energy is known
    moved = nodal + np.array([0.0, 0.0, 1e6, 0.0])
    volume = 2 * np.pi * mesh.volumes * mesh.points[mesh.elements, 0].mean(axis=1)
    np.testing.assert_allclose(recovered_energy(stress, cells, moved), volume * 1e12 / 1e9, rtol=1e-9)


def test_an_element_alone_recovers_its_own_stress():
    for mesh, kind in ((square(1), am.PlaneStress), (cube(1), am.Solid)):
        stress = element_stress(mesh, 1e-3 * mesh.points, StressData.of(mesh, kind(young=1e9, poisson=0.3)))
        nodal = fit.recovered(mesh, stress.values)[1]
        np.testing.assert_allclose(nodal, np.tile(stress.values[0], (mesh.n_nodes, 1)), rtol=1e-9, atol=1e-3)


def kirsch(points):
    """Stresses xx, yy, xy (n, 3) and displacements (n, 2), E = 1, nu = .3 (plane strain), next to a hole of radius 1 in
    a plate under unit tension along x."""
    r, t = np.hypot(*points.T), np.arctan2(*points.T[::-1])
    q, k, mu = r**-2.0, 1.8, 0.5 / 1.3
    c, s, twice = np.cos(t), np.sin(t), np.cos(2 * t)
    radial, hoop = 0.5 * (1 - q + (1 - 4 * q + 3 * q * q) * twice), 0.5 * (1 + q - (1 + 3 * q * q) * twice)
    shear = -0.5 * (1 + 2 * q - 3 * q * q) * np.sin(2 * t)
    stress = [radial * c * c + hoop * s * s - 2 * shear * s * c, radial * s * s + hoop * c * c + 2 * shear * s * c,
              (radial - hoop) * s * c + shear * (c * c - s * s)]
    moved = [r * (k + 1) * c + 2 / r * ((1 + k) * c + np.cos(3 * t)) - 2 / r**3 * np.cos(3 * t),
             r * (k - 3) * s + 2 / r * ((1 - k) * s + np.sin(3 * t)) - 2 / r**3 * np.sin(3 * t)]
    return np.stack(stress, 1), np.stack(moved, 1) / (8 * mu)


@pytest.mark.parametrize("size", [0.4, 0.2])
def test_stress_on_symmetry_is_nearly_as_accurate_as_inside(size):
    plate = am.Outline(vertices=[(1, 0), (4, 0), (4, 4), (0, 4), (0, 1)],
                       boundaries=("bottom", "right", "top", "left", "hole"), arcs={4: (0.0, 0.0)})
    mesh, material = am.mesh.graded(plate, size, ["hole"], 4.0), am.PlaneStrain(young=1.0, poisson=0.3)
    exact, moved = kirsch(mesh.points)
    held = np.zeros(moved.shape, dtype=bool)
    held[mesh.boundary_nodes("right")] = held[mesh.boundary_nodes("top")] = True
    held[mesh.boundary_nodes("left"), 0] = held[mesh.boundary_nodes("bottom"), 1] = True
    held, matrix, u = held.ravel(), stiffness(mesh, material).tocsr(), np.where(held, moved, 0.0).ravel()
    u[~held] = spsolve(matrix[~held][:, ~held].tocsc(), -(matrix @ u)[~held])
    found = fit.recovered(mesh, element_stress(mesh, u.reshape(-1, 2), StressData.of(mesh, material)).values)[1]
    errors, r = np.linalg.norm(found - exact, axis=1), np.hypot(*mesh.points.T)
    near, outside = (r > 1.05) & (r < 2.0), np.isin(np.arange(mesh.n_nodes), mesh.facets)
    # by patches on one side 6 to 7 times as large
    assert np.sqrt(np.mean(errors[near & outside]**2)) < 3 * np.sqrt(np.mean(errors[near & ~outside]**2))


def test_stress_on_faces_of_solids_is_as_accurate_as_fits_allow():
    mesh, rng = random_box(400, 3, 0), np.random.default_rng(0)
    curved = rng.standard_normal((3, 3, 6))
    centroids = mesh.points[mesh.elements].mean(axis=1)
    exact, values = (np.einsum("na,abc,nb->nc", x, curved, x) for x in (mesh.points, centroids))
    errors = np.linalg.norm(fit.recovered(mesh, values)[1] - exact, axis=1)
    outside, face = np.isin(np.arange(mesh.n_nodes), mesh.facets), (np.abs(mesh.points - 0.5) < 0.3).sum(axis=1) >= 2
    # by patches on one side 3.5 to 5 times as large
    assert np.sqrt(np.mean(errors[outside & face]**2)) < 3 * np.sqrt(np.mean(errors[~outside]**2))
