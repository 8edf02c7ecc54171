"""Bodies of revolution: equality with NGSolve's forms, exact constant strains, Lame's cylinder, loads with 2 pi r."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse

from adaptmg.discrete import fixed_dofs, load_vector
from adaptmg.discrete.elasticity import stiffness
from adaptmg.discrete.stress import element_strain, full_stress, hoop_strain, von_mises
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_rule
from adaptmg.mesh import MeshArrays, structured
from adaptmg.problem import BodyForce, PlaneStrain, Pressure, Rectangle, Solid, Support, Traction
from adaptmg.problem.loads import InitialStrain
from adaptmg.problem.materials import Axisymmetric

STEEL = Axisymmetric(young=2.1e11, poisson=0.3)
INNER, OUTER, HEIGHT = 0.1, 0.25, 0.12


def meridian(inner: float, divisions: int | tuple[int, int] = (4, 3), *, shaken: bool = True) -> MeshArrays:
    """A rectangle inner <= r <= OUTER, 0 <= z <= HEIGHT, the nodes inside moved."""
    mesh = structured(Rectangle(width=OUTER - inner, height=HEIGHT, origin=(inner, 0.0)), divisions)
    points = mesh.points.copy()
    inside = np.setdiff1d(np.arange(mesh.n_nodes), mesh.facets)
    if shaken:
        points[inside] += 0.007 * np.random.default_rng(3).uniform(-1, 1, (len(inside), 2))
    return replace(mesh, points=points, source=None)


SOLID, RING = meridian(0.0), meridian(INNER)
MESHES = pytest.mark.parametrize("mesh", [SOLID, RING], ids=["solid", "ring"])


def by_ngsolve(mesh: MeshArrays, material, rule=None, *, bonus: int = 0) -> np.ndarray:
    """The same form by NGSolve, dense; with a quadrature rule of ours, or its own of a higher order."""
    import ngsolve as ng

    from adaptmg.mesh import with_source

    space = ng.H1(with_source(mesh).source, order=1, dim=2)
    u, v = space.TnT()
    grad_u, grad_v, r = ng.Grad(u), ng.Grad(v), ng.x
    hoop_u, hoop_v = u[0] / r, v[0] / r
    form = ng.BilinearForm(space)
    options = {"bonus_intorder": bonus}
    if rule is not None:
        points, weights = rule
        # the reference triangle has area 1/2; its corners in NGSolve's order are (1, 0), (0, 1), (0, 0)
        options = {"intrules": {ng.ET.TRIG: ng.IntegrationRule([tuple(p) for p in points[:, :2]], list(weights / 2))}}
    form += 2 * np.pi * r * (
        material.lame * (ng.Trace(grad_u) + hoop_u) * (ng.Trace(grad_v) + hoop_v)
        + 2 * material.shear_modulus * (ng.InnerProduct(ng.Sym(grad_u), ng.Sym(grad_v)) + hoop_u * hoop_v)
    ) * ng.dx(**options)
    form.Assemble()
    values, columns, rows = (np.array(part) for part in form.mat.CSR())
    blocks = sparse.bsr_array((values.reshape(-1, 2, 2), columns, rows), shape=(mesh.points.size,) * 2)
    return blocks.toarray()


def volume(mesh: MeshArrays) -> float:
    return 2 * np.pi * float(mesh.volumes @ mesh.points[mesh.elements, 0].mean(axis=1))


def solved(mesh: MeshArrays, material, loads, supports) -> np.ndarray:
    """Nodal displacements (n_nodes, 2)."""
    fixed, u = fixed_dofs(mesh, supports)
    matrix, free = stiffness(mesh, material).toarray(), ~fixed
    load = load_vector(mesh, loads, material) - matrix @ u
    u[free] = np.linalg.solve(matrix[np.ix_(free, free)], load[free])
    return u.reshape(-1, 2)


@MESHES
def test_equals_ngsolve_with_the_same_rule(mesh):
    ours = stiffness(mesh, STEEL).toarray()
    theirs = by_ngsolve(mesh, STEEL, quadrature_rule(3, AXISYMMETRIC_DEGREE))
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-13 * np.abs(ours).max())


def test_the_rule_is_accurate_off_the_axis():
    ours, exact = stiffness(RING, STEEL).toarray(), by_ngsolve(RING, STEEL, bonus=20)
    # the error of degree 5 in 1/r is of the order (h/r)^6, here h/r < .4
    np.testing.assert_allclose(ours, exact, rtol=0, atol=2e-7 * np.abs(exact).max())


@MESHES
def test_symmetric_and_only_the_axial_translation_is_free(mesh):
    matrix = stiffness(mesh, STEEL)
    assert matrix.blocksize == (2, 2) and matrix.has_sorted_indices and matrix.indices.dtype == np.int32
    assert np.isfinite(matrix.data).all() and abs(matrix - matrix.T).max() == 0.0
    axial = np.tile([0.0, 1.0], mesh.n_nodes)
    assert np.abs(matrix @ axial).max() <= 1e-14 * np.abs(matrix.data).max()
    values = np.linalg.eigvalsh(matrix.toarray())
    assert values[0] > -1e-14 * values[-1] and values[1] > 1e-5 * values[-1]


@MESHES
def test_energy_of_constant_strains(mesh):
    # u = (c r, d z + e r): rr = hoop = c, zz = d, rz = e / 2 everywhere
    c, d, e = 1e-3, -4e-4, 7e-4
    r, z = mesh.points.T
    u = np.column_stack([c * r, d * z + e * r]).reshape(-1)
    density = STEEL.lame * (2 * c + d)**2 + 2 * STEEL.shear_modulus * (2 * c**2 + d**2 + e**2 / 2)
    assert u @ (stiffness(mesh, STEEL) @ u) == pytest.approx(density * volume(mesh), rel=1e-12)


@MESHES
def test_patch_test(mesh):
    # uniform axial strain and u_r = c r are in equilibrium: prescribed on the boundary, they are found inside
    c, d = 3e-4, -1e-3
    exact = mesh.points * [c, d]
    boundary = np.unique(mesh.facets)
    held = np.zeros(mesh.points.shape, dtype=bool)
    held[boundary] = True
    held, u = held.reshape(-1), exact.reshape(-1).copy()
    matrix = stiffness(mesh, STEEL).toarray()
    u[~held] = np.linalg.solve(matrix[np.ix_(~held, ~held)], -matrix[np.ix_(~held, held)] @ u[held])
    np.testing.assert_allclose(u, exact.reshape(-1), atol=1e-17)
    np.testing.assert_allclose(hoop_strain(mesh, u), c, rtol=1e-11)
    np.testing.assert_allclose(element_strain(mesh, u)[:, 1, 1], d, rtol=1e-11)
    stress = STEEL.lame * (2 * c + d) * np.eye(3) + 2 * STEEL.shear_modulus * np.diag([c, d, c])
    found = full_stress(mesh, STEEL, u)
    np.testing.assert_allclose(found, np.broadcast_to(stress, found.shape), atol=1e-11 * np.abs(stress).max())
    np.testing.assert_allclose(von_mises(found), abs(stress[0, 0] - stress[1, 1]), rtol=1e-10)


def test_bar_under_axial_tension():
    # free sides: sigma_zz = q and nothing else, u = (-nu q r, q z) / E, the axis held
    q = 5e7
    u = solved(SOLID, STEEL, [Traction("top", (0.0, q))], [Support("bottom", y=0.0), Support("left", x=0.0)])
    np.testing.assert_allclose(u, SOLID.points * [-STEEL.poisson * q / STEEL.young, q / STEEL.young], atol=1e-16)
    np.testing.assert_allclose(full_stress(SOLID, STEEL, u)[:, 1, 1], q, rtol=1e-10)


def test_lame_cylinder_converges():
    # in the norm of L2: at single nodes, as in the corners, the best of P1 is h^2 log h
    # bore under pressure, plane strain in z: u_r = (1 + nu) / E * (A (1 - 2 nu) r + B / r), hoop stress A + B / r^2
    p = 1e8
    a = p * INNER**2 / (OUTER**2 - INNER**2)
    b = a * OUTER**2
    supports = [Support("bottom", y=0.0), Support("top", y=0.0)]
    errors, stress_errors = [], []
    for n in (4, 8, 16):
        mesh = meridian(INNER, (2 * n, n), shaken=False)
        lumped = np.bincount(mesh.elements.reshape(-1), weights=np.repeat(mesh.volumes / 3, 3))
        u = solved(mesh, STEEL, [Pressure("left", p)], supports)
        r = mesh.points[:, 0]
        exact = (1 + STEEL.poisson) / STEEL.young * (a * (1 - 2 * STEEL.poisson) * r + b / r)
        error = np.sum((u - np.column_stack([exact, 0 * r]))**2, axis=1)
        errors.append(np.sqrt(lumped @ error / (lumped @ exact**2)))
        centre = mesh.points[mesh.elements, 0].mean(axis=1)
        stress_errors.append(np.abs(full_stress(mesh, STEEL, u)[:, 2, 2] / (a + b / centre**2) - 1).mean())
    rates = np.log2(np.divide(errors[:-1], errors[1:]))
    assert (rates > 1.9).all() and errors[-1] < 5e-4, (errors, rates)
    assert (np.divide(stress_errors[:-1], stress_errors[1:]) > 1.7).all() and stress_errors[-1] < 0.02, stress_errors


class TestLoads:
    def test_resultants(self):
        top = load_vector(RING, [Pressure("top", 3e6)], STEEL).reshape(-1, 2).sum(axis=0)
        np.testing.assert_allclose(top, [0.0, -3e6 * np.pi * (OUTER**2 - INNER**2)], atol=1e-8)
        bore = load_vector(RING, [Pressure("left", 3e6)], STEEL).reshape(-1, 2).sum(axis=0)
        np.testing.assert_allclose(bore, [3e6 * 2 * np.pi * INNER * HEIGHT, 0.0], atol=1e-8)
        weight = load_vector(RING, [BodyForce((0.0, -7e4))], STEEL).reshape(-1, 2).sum(axis=0)
        np.testing.assert_allclose(weight, [0.0, -7e4 * volume(RING)], rtol=1e-12)

    def test_linear_data_are_exact(self):
        # virtual work on v = (r, z): centrifugal force f = k r: 2 pi k int r^3 dr dz
        k = 2e5
        work = load_vector(RING, [BodyForce((lambda x: k * x[:, 0], 0.0))], STEEL) @ RING.points.reshape(-1)
        assert work == pytest.approx(2 * np.pi * k * HEIGHT * (OUTER**4 - INNER**4) / 4, rel=1e-12)
        work = load_vector(RING, [Traction("top", (0.0, lambda x: k * x[:, 0]))], STEEL) @ RING.points.reshape(-1)
        assert work == pytest.approx(2 * np.pi * k * HEIGHT * (OUTER**3 - INNER**3) / 3, rel=1e-12)

    def test_consistent_nodal_forces(self):
        # int 2 pi r phi_i over an edge of length L: pi L (2 r_i + r_j) / 3; on the axis itself it is not zero
        mesh = structured(Rectangle(width=0.2, height=0.1), 1)
        load = load_vector(mesh, [Pressure("bottom", 1.0)], STEEL).reshape(-1, 2)
        np.testing.assert_allclose(load[mesh.boundary_nodes("bottom"), 1],
                                   np.pi * 0.2 / 3 * np.array([0.2, 2 * 0.2]))

    @MESHES
    def test_pressure_all_around(self, mesh):
        # virtual work of u = (r, 0) is -p times its divergence 2; there is no axial resultant
        load = load_vector(mesh, [Pressure(name, 5e6) for name in mesh.boundaries], STEEL).reshape(-1, 2)
        assert load[:, 0] @ mesh.points[:, 0] == pytest.approx(-2 * 5e6 * volume(mesh), rel=1e-12)
        assert abs(load[:, 1].sum()) < 1e-12 * np.abs(load[:, 1]).sum()

    def test_cartesian_without_material(self):
        plane = PlaneStrain(young=1.0, poisson=0.2)
        loads = [Pressure("top", 3e6), BodyForce((1.0, 2.0))]
        np.testing.assert_array_equal(load_vector(RING, loads), load_vector(RING, loads, plane))
        assert not np.allclose(load_vector(RING, loads), load_vector(RING, loads, STEEL))


class TestInitialStrain:
    @MESHES
    def test_free_body_follows_it(self, mesh):
        # rr = hoop = a, zz = b: compatible, so no stress at all
        a, b = 4e-4, -1e-3
        strain = InitialStrain("body", (a, b, a))
        supports = [Support("bottom", y=0.0)] + ([Support("left", x=0.0)] if mesh is SOLID else [])
        u = solved(mesh, STEEL, [strain], supports)
        np.testing.assert_allclose(u, mesh.points * [a, b], atol=1e-16)
        assert np.abs(full_stress(mesh, STEEL, u, [strain])).max() < 1e-11 * STEEL.young * abs(b)

    def test_clamped_bar(self):
        strain = InitialStrain("body", (0.0, -1e-3, 0.0))
        supports = [Support("bottom", y=0.0), Support("top", y=0.0), Support("left", x=0.0)]
        u = solved(SOLID, STEEL, [strain], supports)
        stress = full_stress(SOLID, STEEL, u, [strain])
        expected = np.zeros(stress.shape)
        expected[:, 1, 1] = STEEL.young * 1e-3
        np.testing.assert_allclose(stress, expected, atol=1e-10 * STEEL.young * 1e-3)

    @MESHES
    def test_virtual_work_with_a_hoop_strain_of_its_own(self, mesh):
        strain = np.array([2e-4, -5e-4, 9e-4])
        c, d = 0.7, -1.3
        stress = STEEL.lame * strain.sum() + 2 * STEEL.shear_modulus * strain
        load = load_vector(mesh, [InitialStrain("body", tuple(strain))], STEEL)
        work = load @ (mesh.points * [c, d]).reshape(-1)
        assert work == pytest.approx(stress @ [c, d, c] * volume(mesh), rel=1e-12)
        two = load_vector(mesh, [InitialStrain("body", (2e-4, -5e-4))], STEEL)
        np.testing.assert_array_equal(two, load_vector(mesh, [InitialStrain("body", (2e-4, -5e-4, 0.0))], STEEL))

    def test_linear_in_position(self):
        # zz = k r, the others 0; on v = (0, z): (lambda + 2 mu) k 2 pi int r^2
        k = 3e-3
        load = load_vector(RING, [InitialStrain("body", (0.0, lambda x: k * x[:, 0], 0.0))], STEEL)
        work = load @ (RING.points * [0.0, 1.0]).reshape(-1)
        modulus = STEEL.lame + 2 * STEEL.shear_modulus
        assert work == pytest.approx(modulus * k * 2 * np.pi * HEIGHT * (OUTER**3 - INNER**3) / 3, rel=1e-12)


class TestRefusals:
    def test_negative_radius(self):
        shifted = replace(RING, points=RING.points - [0.15, 0.0])
        with pytest.raises(ValueError, match=r"lie at radii x >= 0, got x = -0\.05 m"):
            stiffness(shifted, STEEL)
        with pytest.raises(ValueError, match="radii x >= 0"):
            load_vector(shifted, [], STEEL)

    def test_rounding_on_the_axis_is_let_pass(self):
        points = SOLID.points.copy()
        points[SOLID.boundary_nodes("left"), 0] = -1e-17
        near = stiffness(replace(SOLID, points=points), STEEL)
        here = stiffness(SOLID, STEEL)
        np.testing.assert_allclose(near.data, here.data, rtol=0, atol=1e-12 * np.abs(near.data).max())

    def test_dimension(self):
        with pytest.raises(ValueError, match="the material is 3D, the mesh 2D"):
            stiffness(RING, Solid(young=1.0, poisson=0.2))
        for shape in ((3, 2, 2), (3, 4)):
            with pytest.raises(ValueError, match=r"stress must have shape \(n, 3, 3\)"):
                von_mises(np.zeros(shape))
