"""Edge-smoothed elements: their form, summed edge by edge, and what loads, energies and stresses
follow from it."""

from dataclasses import replace

import numpy as np
import pytest
from refused import refused
from two_materials import BOTH_ELEMENTS, EACH_KIND, MESHES

import adaptmg as am
from adaptmg.discrete import elasticity
from adaptmg.discrete.stress import StressData


def two(kind) -> dict:
    return {"left": kind(young=2.1e11, poisson=0.36), "right": kind(young=7e10, poisson=-0.2)}


@BOTH_ELEMENTS
@EACH_KIND
def test_energy_matrix_and_loads_of_initial_strains_belong_together(kind, elements):
    """u'K'u / 2 - b'u is the energy of elastic strains less that of u = 0, for initial strains that
    vary."""
    mesh, materials, rng = MESHES[kind.dim], two(kind), np.random.default_rng(3)
    strains = [
        am.InitialStrain(
            body, (lambda x: 1e-3 * np.sin(3 * x[:, 0]), 2e-3, lambda x: 1e-3 * x[:, 1])
        )
        for body in mesh.bodies
    ]
    u, still = 1e-3 * rng.normal(size=mesh.points.size), np.zeros(mesh.points.size)
    matrix, load = (
        am.discrete.stiffness(mesh, materials, elements),
        am.discrete.load_vector(mesh, strains, materials, elements),
    )
    data = StressData.of(mesh, materials, strains, elements)
    # linear elements integrate 1/r by more points than energies have
    near = 1e-3 if kind is am.Axisymmetric and elements == "linear" else 1e-11
    assert data.energy(mesh, u) - data.energy(mesh, still) == pytest.approx(
        u @ (matrix @ u) / 2 - load @ u, rel=near
    )
    if kind is not am.PlaneStrain:
        assert data.suppressed(mesh) == pytest.approx(2 * data.energy(mesh, still), rel=1e-12)
    else:  # free in the plane, it strains still
        assert 0 < data.suppressed(mesh) <= 2 * data.energy(mesh, still)


@EACH_KIND
def test_the_stress_of_elements_is_in_equilibrium_and_smoother_than_that_of_their_strains(kind):
    mesh, materials, rng = MESHES[kind.dim], two(kind), np.random.default_rng(5)
    strains = [am.InitialStrain("left", (lambda x: 1e-3 * x[:, 0], 2e-3, 1e-3))]
    u, v = 1e-3 * rng.normal(size=(2, mesh.points.size))
    data = StressData.of(mesh, materials, strains, "smoothed")
    volumes = elasticity.element_measures(mesh, data.axisymmetric)
    virtual = StressData.of(mesh, materials).strains(mesh, v)
    if kind is am.PlaneStress:  # no work
        virtual[:, 2, 2] = 0.0
    work = np.einsum("n,nij,nij", volumes, data.tensors(mesh, u), virtual)
    load = am.discrete.load_vector(mesh, strains, materials, "smoothed")
    assert work == pytest.approx(
        v @ (am.discrete.stiffness(mesh, materials, "smoothed") @ u - load), rel=1e-10
    )
    # pressures of groups add theirs
    more = replace(data, pressure=rng.normal(size=len(volumes))).tensors(mesh, u) - data.tensors(
        mesh, u
    )
    assert (np.abs(more[:, 2, 2]).max() == 0) == (kind is am.PlaneStress)


def test_a_problem_has_its_elements_on_all_levels_and_in_all_that_follows_from_it():
    problem = replace(am.cases.greco_bar(), elements="smoothed")
    grids = am.Hierarchy.uniform(problem, divisions=(4, 8))
    for level in grids.levels:
        np.testing.assert_array_equal(
            level.matrix.data, am.discrete.stiffness(level.mesh, problem.material, "smoothed").data
        )
    result = am.solve(grids)
    assert result.energy == pytest.approx(result.checked.energy_norm**2 / 2, rel=1e-6)
    linear = grids.with_problem(replace(problem, elements="linear"))
    np.testing.assert_array_equal(
        linear.finest.matrix.data, am.discrete.stiffness(linear.finest.mesh, problem.material).data
    )


def energy_of(stress: np.ndarray, material) -> np.ndarray:
    """Twice the energy density of stresses (n, 6) in plane strain, by the components in the plane,
    or axisymmetric."""
    lame, shear, n = (
        material.lame,
        material.shear_modulus,
        3 if isinstance(material, am.Axisymmetric) else 2,
    )
    squares = np.sum(stress[:, :n] ** 2, axis=1) + 2 * stress[:, 3] ** 2
    return (squares - stress[:, :n].sum(axis=1) ** 2 / (n + 2 * shear / lame)) / (2 * shear)


@pytest.mark.parametrize(("kind", "poisson"), [(am.PlaneStrain, 0.3), (am.Axisymmetric, 0.5)])
def test_estimates_follow_the_error_of_the_stress(kind, poisson):
    problem = replace(
        am.cases.greco_bar(),
        material=kind(young=1.3e11, poisson=poisson),
        elements="smoothed",
        domain=am.Rectangle(width=40e-3, height=40e-3, origin=(5e-3, 0.0)),
    )
    coarse, fine = (
        am.Hierarchy.uniform(problem, divisions=list(divisions))
        for divisions in ((4, 8, 16), (8, 32, 64))
    )
    result, better = am.solve(coarse), am.solve(fine)
    at = better.mesh.points[better.mesh.elements].mean(axis=1)
    error = energy_of(result.stress(at) - better.stress(recovered=True), problem.material)
    true = np.sqrt(elasticity.element_measures(better.mesh, kind is am.Axisymmetric) @ error)
    for indicator, low, high in ((am.Recovery(), 0.75, 1.1), (am.Residual(), 2.0, 4.5)):
        assert low < indicator.indicate(coarse, result).total / true < high


def solved_bar() -> tuple[am.Hierarchy, am.Result]:
    grids = am.Hierarchy.uniform(
        replace(am.cases.greco_bar(), elements="smoothed"), divisions=(2, 4)
    )
    return grids, am.solve(grids)


test_refusals = refused(
    (
        lambda: am.Goal(am.Opening("contact")).indicate(*solved_bar()),
        "am.Goal estimates errors of linear elements",
    ),
    (
        lambda: am.adapt(
            replace(am.cases.greco_bar(), elements="smoothed"),
            indicator=am.Goal(am.Opening("contact")),
        ),
        "am.Goal estimates errors of linear elements",
    ),
    (lambda: am.estimate.Reference.of(*solved_bar()), "a reference must have linear elements"),
    (
        lambda: replace(am.cases.greco_bar(), elements="quadratic"),
        r"elements must be one of 'linear', 'smoothed'",
    ),
)
