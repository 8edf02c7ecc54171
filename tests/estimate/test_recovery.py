"""Recovered stresses reproduce linear ones, and do not cross materials."""

import dataclasses

import numpy as np
import pytest
from made import cube, square
from simplex_meshes import random_box
from uncompiled import uncompile

import adaptmg as am
from adaptmg.discrete import recovery as fit
from adaptmg.discrete.stress import StressData
from adaptmg.estimate import recovery as module
from adaptmg.estimate.recovery import recovered_energy, recovered_stress
from adaptmg.estimate.stress_fields import ElementStress, element_stress, neighbours

KINDS = {2: am.PlaneStrain, 3: am.Solid}


@pytest.fixture(params=[False, True], ids=["compiled", "plain"])
def jit(request, monkeypatch):
    if request.param:
        uncompile(monkeypatch, module, fit)
    return request.param


@pytest.mark.parametrize("dim", [2, 3])
def test_linear_stresses_are_reproduced_at_every_node(dim, jit):
    mesh = random_box(12, dim, 4)
    data = StressData.of(mesh, KINDS[dim](young=1.0, poisson=0.3))
    rng = np.random.default_rng(0)
    slope, constant = rng.standard_normal((dim, 3 * dim - 3)), rng.standard_normal(3 * dim - 3)
    values = mesh.points[mesh.elements].mean(axis=1) @ slope + constant
    stress = ElementStress(mesh, np.zeros(mesh.points.shape), data, values)
    found = recovered_stress(stress, neighbours(mesh).across)
    np.testing.assert_allclose(found.nodal, mesh.points @ slope + constant, rtol=1e-8, atol=1e-9)
    np.testing.assert_array_equal(fit.recovered(mesh, values)[1], found.nodal)


@pytest.mark.parametrize("dim", [2, 3])
def test_energy_is_that_of_the_compliance(dim, jit):
    mesh, material = random_box(4, dim, 1), KINDS[dim](young=3.0, poisson=0.3)
    stress = element_stress(mesh, np.zeros(mesh.points.shape), StressData.of(mesh, material))
    nodal = np.random.default_rng(0).standard_normal((mesh.n_nodes, 3 * dim - 3))
    found = dataclasses.replace(recovered_stress(stress, neighbours(mesh).across), nodal=nodal)
    # for shear stresses that count once
    elastic = np.diag(np.repeat([2.0, 1.0], [dim, 2 * dim - 3])) * material.shear_modulus
    elastic[:dim, :dim] += material.lame
    # means of products of hat functions
    products = (np.ones((dim + 1, dim + 1)) + np.eye(dim + 1)) / ((dim + 1) * (dim + 2))
    corners = nodal[mesh.elements]
    wanted = mesh.volumes * np.einsum("kl,ekc,cd,eld->e", products, corners, np.linalg.inv(elastic), corners)
    np.testing.assert_allclose(recovered_energy(stress, found), wanted, rtol=1e-11)


def test_the_stress_may_jump_where_materials_meet():
    whole = square(4)
    upper = whole.points[whole.elements, 1].mean(axis=1) > 0.02
    mesh = dataclasses.replace(whole, bodies=("soft", "stiff"), element_body=upper.astype(np.int32))
    materials = {"soft": am.PlaneStress(young=1e9, poisson=0.2), "stiff": am.PlaneStress(young=9e9, poisson=0.2)}
    # the same strains in both: the stresses are constant in each
    stress = element_stress(mesh, 1e-3 * mesh.points, StressData.of(mesh, materials))
    across = neighbours(mesh).across
    found = recovered_stress(stress, across)
    assert len(found.nodal) == mesh.n_nodes + 5  # the nodes of the interface twice
    np.testing.assert_array_equal(fit.recovered(mesh, found.sampled)[1], found.nodal)
    assert recovered_energy(stress, found).max() < 1e-20 * (1e-3)**2 * 9e9
    boundary = np.zeros(mesh.n_nodes, dtype=bool)
    module.mark_boundary(mesh.elements, across, mesh.element_body, boundary)
    np.testing.assert_array_equal(boundary, (whole.points[:, 1] == 0.02) | np.isin(np.arange(25), mesh.facets))
    glued = dataclasses.replace(mesh, bodies=("all",), element_body=None)
    one = dataclasses.replace(stress, mesh=glued, data=StressData.of(glued, materials["soft"]))
    assert recovered_energy(one, recovered_stress(one, across)).max() > 1e-6 * (1e-3)**2 * 9e9


def test_axisymmetric_stress_is_recovered_with_its_hoop_part(jit):
    mesh = square(4)
    strain = am.InitialStrain("body", (1e-3, 2e-3, -3e-3))
    data = StressData.of(mesh, am.Axisymmetric(young=1e9, poisson=0.3), [strain])
    r, z = mesh.points.T
    stress = element_stress(mesh, np.column_stack([2e-3 * r, -1e-3 * z]), data)
    found = recovered_stress(stress, neighbours(mesh).across)
    tensors = data.tensors(mesh, stress.displacement)
    np.testing.assert_allclose(found.sampled, tensors[:, [0, 1, 2, 0], [0, 1, 2, 1]], rtol=1e-12, atol=1e-6)
    assert recovered_energy(stress, found).max() < 1e-12
    # a constant added to the hoop stress: its energy is known
    moved = dataclasses.replace(found, nodal=found.nodal + np.array([0.0, 0.0, 1e6, 0.0]))
    volume = 2 * np.pi * mesh.volumes * mesh.points[mesh.elements, 0].mean(axis=1)
    np.testing.assert_allclose(recovered_energy(stress, moved), volume * 1e12 / 1e9, rtol=1e-9)


def test_an_element_alone_recovers_its_own_stress():
    for mesh, kind in ((square(1), am.PlaneStress), (cube(1), am.Solid)):
        stress = element_stress(mesh, 1e-3 * mesh.points, StressData.of(mesh, kind(young=1e9, poisson=0.3)))
        found = recovered_stress(stress, neighbours(mesh).across)
        np.testing.assert_allclose(found.nodal, np.tile(stress.values[0], (mesh.n_nodes, 1)), rtol=1e-9, atol=1e-3)
