"""The stiffness matrix: symmetric, blind to rigid motions, exact for linear fields, equal to P1 by hand."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from adaptmg.discrete import element_strain, full_stress, stiffness, von_mises
from adaptmg.discrete.problem import rigid_body_modes
from adaptmg.mesh import MeshArrays, structured
from adaptmg.problem import Box, PlaneStrain, PlaneStress, Rectangle, Solid

MATERIALS = {2: [PlaneStrain(young=1.3e11, poisson=0.2), PlaneStress(young=7e10, poisson=0.33)],
             3: [Solid(young=2.1e11, poisson=0.3)]}


def mesh_of(dim: int, divisions: int = 3) -> MeshArrays:
    if dim == 2:
        return structured(Rectangle(width=2.0, height=1.0, origin=(0.3, -1.0)), divisions)
    return structured(Box(width=2.0, depth=0.5, height=1.0), divisions)


CASES = [(mesh_of(dim), material) for dim in (2, 3) for material in MATERIALS[dim]]


def by_hand(points: np.ndarray, material) -> np.ndarray:
    """P1 element matrix from shape gradients and Voigt's B'DB, shear strains doubled."""
    dim = points.shape[1]
    inverse = np.linalg.inv(np.column_stack([np.ones(dim + 1), points]))
    gradients = inverse[1:].T
    volume = abs(1 / np.linalg.det(inverse)) / (2 if dim == 2 else 6)
    pairs = [(0, 1)] if dim == 2 else [(1, 2), (0, 2), (0, 1)]
    strain = np.zeros((dim + len(pairs), dim * (dim + 1)))
    for i, g in enumerate(gradients):
        for d in range(dim):
            strain[d, dim * i + d] = g[d]
        for row, (a, b) in enumerate(pairs):
            strain[dim + row, dim * i + a], strain[dim + row, dim * i + b] = g[b], g[a]
    law = np.zeros((dim + len(pairs),) * 2)
    law[:dim, :dim] = material.lame + 2 * material.shear_modulus * np.eye(dim)
    law[dim:, dim:] = material.shear_modulus * np.eye(len(pairs))
    return volume * strain.T @ law @ strain


@pytest.mark.parametrize(("points", "material"), [
    ([[0.1, 0.2], [1.3, 0.0], [0.4, 0.9]], MATERIALS[2][0]),
    ([[0.1, 0.2], [1.3, 0.0], [0.4, 0.9]], MATERIALS[2][1]),
    ([[0.0, 0.1, 0.0], [1.2, 0.0, 0.1], [0.3, 0.8, -0.1], [0.2, 0.3, 0.9]], MATERIALS[3][0]),
])
def test_one_element_by_hand(points, material):
    points = np.array(points)
    dim = points.shape[1]
    facets = [[0, 1], [1, 2], [2, 0]] if dim == 2 else [[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]
    mesh = MeshArrays(points, [list(range(dim + 1))], facets, np.zeros(dim + 1), ("side",))
    expected = by_hand(points, material)
    np.testing.assert_allclose(stiffness(mesh, material).toarray(), expected, atol=1e-13 * np.abs(expected).max())


@pytest.mark.parametrize(("mesh", "material"), CASES)
def test_symmetric_sorted_blocks(mesh, material):
    matrix = stiffness(mesh, material)
    assert matrix.blocksize == (mesh.dim, mesh.dim) and matrix.has_sorted_indices
    assert matrix.shape == (mesh.points.size, mesh.points.size) and matrix.indices.dtype == np.int32
    assert abs(matrix - matrix.T).max() <= 1e-14 * np.abs(matrix.data).max()


@pytest.mark.parametrize(("mesh", "material"), CASES)
def test_rigid_motions_are_the_kernel(mesh, material):
    matrix = stiffness(mesh, material).toarray()
    modes = rigid_body_modes(mesh.points)
    assert np.abs(matrix @ modes).max() <= 1e-13 * np.abs(matrix).max()
    values = np.linalg.eigvalsh(matrix)
    assert values[modes.shape[1]] > 1e-6 * values[-1]


@pytest.mark.parametrize(("mesh", "material"), CASES)
def test_patch_test(mesh, material):
    dim = mesh.dim
    # inner nodes moved, so that the elements differ
    rng = np.random.default_rng(1)
    inner = np.setdiff1d(np.arange(mesh.n_nodes), mesh.facets)
    points = mesh.points.copy()
    points[inner] += 0.05 * rng.uniform(-1, 1, (len(inner), dim))
    mesh = replace(mesh, points=points, source=None)
    gradient = 1e-3 * rng.normal(size=(dim, dim))
    exact = points @ gradient.T
    matrix = stiffness(mesh, material).toarray()
    free = (inner[:, None] * dim + np.arange(dim)).reshape(-1)
    held = np.setdiff1d(np.arange(points.size), free)
    u = exact.reshape(-1).copy()
    u[free] = np.linalg.solve(matrix[np.ix_(free, free)], -matrix[np.ix_(free, held)] @ u[held])
    np.testing.assert_allclose(u.reshape(-1, dim), exact, atol=1e-14)
    strain = 0.5 * (gradient + gradient.T)
    np.testing.assert_allclose(element_strain(mesh, u), np.broadcast_to(strain, (len(mesh.elements), dim, dim)),
                               atol=1e-14)
    # energy of the matrix = energy of the stresses
    energy = np.sum(mesh.volumes[:, None, None] * full_stress(mesh, material, u)[:, :dim, :dim] * strain)
    assert u @ matrix @ u == pytest.approx(energy, rel=1e-12)


@pytest.mark.parametrize(("mesh", "material"), CASES)
def test_equals_ngsolve(mesh, material):
    ours, theirs = stiffness(mesh, material), by_ngsolve(mesh, material)
    np.testing.assert_array_equal(ours.indptr, theirs.indptr)
    np.testing.assert_array_equal(ours.indices, theirs.indices)
    np.testing.assert_allclose(ours.data, theirs.data, rtol=0, atol=1e-14 * np.abs(theirs.data).max())


def by_ngsolve(mesh: MeshArrays, material) -> sparse.bsr_array:
    """The same form, assembled by NGSolve on the mesh's source."""
    import ngsolve as ng

    space = ng.H1(mesh.source, order=1, dim=mesh.dim)
    u, v = space.TnT()
    grad_u, grad_v = ng.Grad(u), ng.Grad(v)
    form = ng.BilinearForm(space)
    form += (material.lame * ng.Trace(grad_u) * ng.Trace(grad_v)
             + 2 * material.shear_modulus * ng.InnerProduct(ng.Sym(grad_u), ng.Sym(grad_v))) * ng.dx
    form.Assemble()
    values, columns, rows = (np.array(part) for part in form.mat.CSR())
    return sparse.bsr_array((values.reshape(-1, mesh.dim, mesh.dim), columns, rows), shape=(mesh.points.size,) * 2)


def test_the_arrays_are_what_is_assembled():
    # whatever became of the source, which is no part of the arrays
    mesh, material = CASES[0]
    kept = stiffness(mesh, material).data
    for source in (None, mesh_of(2, 4).source):
        np.testing.assert_array_equal(stiffness(replace(mesh, source=source), material).data, kept)


@pytest.mark.parametrize(("mesh", "material"), CASES)
def test_bitwise_symmetric(mesh, material):
    points = mesh.points + 1e-2 * np.random.default_rng(4).uniform(-1, 1, mesh.points.shape)
    matrix = stiffness(replace(mesh, points=points), material)
    assert abs(matrix - matrix.T).max() == 0.0


def test_refuses():
    mesh, material = CASES[0]
    with pytest.raises(ValueError, match="the material is 3D, the mesh 2D"):
        stiffness(mesh, MATERIALS[3][0])
    with pytest.raises(TypeError, match="material must be PlaneStrain"):
        stiffness(mesh, 2.1e11)
    for mesh, material in (CASES[0], CASES[-1]):
        turned = mesh.elements.copy()
        turned[5, :2] = turned[5, 1::-1]
        with pytest.raises(ValueError, match=r"element 5 with nodes .* is inverted or degenerate"):
            stiffness(replace(mesh, elements=turned), material)
    with pytest.raises(ValueError, match=r"mesh\.elements must be numbers from 0 to 62, got 0 to 63"):
        stiffness(replace(mesh, points=mesh.points[:-1]), material)
    with pytest.raises(ValueError, match=r"mesh\.element_body must be numbers from 0 to 0, got 1 to 1"):
        stiffness(replace(mesh, element_body=np.ones(len(mesh.elements))), material)


def test_von_mises():
    # uniaxial stress s gives s; plane strain adds the stress through the thickness
    stress, nu = np.zeros((1, 3, 3)), MATERIALS[2][0].poisson
    stress[0, 0, 0] = 5e6
    assert von_mises(stress) == pytest.approx(5e6)
    stress[0, 2, 2] = nu * 5e6
    assert von_mises(stress) == pytest.approx(5e6 * np.sqrt(1 - nu + nu**2))
    shear = np.zeros((1, 3, 3))
    shear[0, 0, 2] = shear[0, 2, 0] = 2e6
    assert von_mises(shear) == pytest.approx(2e6 * np.sqrt(3))


def test_measures_refuse():
    mesh = CASES[0][0]
    with pytest.raises(ValueError, match="displacement must have shape"):
        element_strain(mesh, np.zeros((3, 2)))
    with pytest.raises(ValueError, match="the material is 3D"):
        full_stress(mesh, MATERIALS[3][0], np.zeros(mesh.points.shape))


def test_importing_does_not_load_ngsolve():
    code = ("import sys, adaptmg.discrete, adaptmg.cases, adaptmg.solver.statics; "
            "sys.exit('ngsolve' in sys.modules or 'netgen' in sys.modules)")
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
