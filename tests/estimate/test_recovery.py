"""Recovered stresses reproduce linear ones, are as good at boundaries as inside, and do not cross
materials."""

import dataclasses

import numpy as np
import pytest
from made import square
from simplex_meshes import random_box

import adaptmg as am
from adaptmg.discrete import stress as fit
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
    wanted = mesh.volumes * np.einsum(
        "kl,ekc,cd,eld->e", products, corners, np.linalg.inv(elastic), corners
    )
    np.testing.assert_allclose(recovered_energy(stress, mesh.elements, nodal), wanted, rtol=1e-11)


def test_the_stress_may_jump_where_materials_meet():
    whole = square(4)
    upper = whole.points[whole.elements, 1].mean(axis=1) > 0.02
    mesh = dataclasses.replace(whole, bodies=("soft", "stiff"), element_body=upper.astype(np.int32))
    materials = {
        "soft": am.PlaneStress(young=1e9, poisson=0.2),
        "stiff": am.PlaneStress(young=9e9, poisson=0.2),
    }
    # the same strains in both: the stresses are constant in each
    stress = element_stress(mesh, 1e-3 * mesh.points, StressData.of(mesh, materials))
    cells, nodal = fit.recovered(mesh, stress.values)
    assert len(nodal) == mesh.n_nodes + 5  # the nodes of the interface twice
    assert recovered_energy(stress, cells, nodal).max() < 1e-20 * (1e-3) ** 2 * 9e9
    glued = dataclasses.replace(mesh, bodies=("all",), element_body=None)
    one = dataclasses.replace(stress, mesh=glued, data=StressData.of(glued, materials["soft"]))
    assert recovered_energy(one, *fit.recovered(glued, one.values)).max() > 1e-6 * (1e-3) ** 2 * 9e9


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
    np.testing.assert_allclose(
        recovered_energy(stress, cells, moved), volume * 1e12 / 1e9, rtol=1e-9
    )


def test_stress_on_faces_of_solids_is_as_accurate_as_fits_allow():
    mesh, rng = random_box(400, 3, 0), np.random.default_rng(0)
    curved = rng.standard_normal((3, 3, 6))
    centroids = mesh.points[mesh.elements].mean(axis=1)
    exact, values = (np.einsum("na,abc,nb->nc", x, curved, x) for x in (mesh.points, centroids))
    errors = np.linalg.norm(fit.recovered(mesh, values)[1] - exact, axis=1)
    outside, face = (
        np.isin(np.arange(mesh.n_nodes), mesh.facets),
        (np.abs(mesh.points - 0.5) < 0.3).sum(axis=1) >= 2,
    )
    # by patches on one side 3.5 to 5 times as large
    assert np.sqrt(np.mean(errors[outside & face] ** 2)) < 3 * np.sqrt(
        np.mean(errors[~outside] ** 2)
    )


def test_a_result_with_gaps_of_nodes_that_take_over_others_belongs_to_its_problem():
    block = am.Rectangle(width=0.4, height=0.1, origin=(0.0, 1e-4))
    floor = am.Rectangle(width=1.0, height=0.1, origin=(-0.33, -0.1))
    problem = am.ContactProblem(
        domain=am.Assembly(parts={"block": block, "floor": floor}),
        material=am.PlaneStrain(young=1e8, poisson=0.3),
        contact=am.ContactPair("floor.top", "block.bottom"),
        law=am.Frictionless(),
        supports=[
            am.Support("block.top", x=0.0, y=-2e-4),
            am.Support("floor.bottom", x=0.0, y=0.0),
        ],
    )
    grids = am.Hierarchy.uniform(problem, [{"block": (4, 1), "floor": (22, 2)}])
    result = am.solve(grids)
    assert (result.contact.measures > result.contact.weights).any()
    assert am.Recovery().indicate(grids, result).total > 0
