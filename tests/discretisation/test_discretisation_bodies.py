"""Several bodies: materials body by body, loads on one body, initial strains, stresses, rigid-body motions."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from adaptmg.discrete import fixed_dofs, load_vector
from adaptmg.discrete.elasticity import stiffness
from adaptmg.discrete.rigid_modes import rigid_motions
from adaptmg.discrete.stress import full_stress, von_mises
from adaptmg.mesh import MeshArrays, structured
from adaptmg.problem import BodyForce, Box, PlaneStrain, PlaneStress, Pressure, Rectangle, Solid, Support
from adaptmg.problem.loads import InitialStrain
from adaptmg.problem.materials import Axisymmetric

HERE = Path(__file__).parent
KINDS = {"plane strain": PlaneStrain, "plane stress": PlaneStress, "axisymmetric": Axisymmetric, "solid": Solid}
EACH_KIND = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


def assembled(**parts: MeshArrays) -> MeshArrays:
    """Unconnected bodies in one mesh; boundaries are named "body.edge"."""
    nodes = np.cumsum([0, *(part.n_nodes for part in parts.values())])
    labels = np.cumsum([0, *(len(part.boundaries) for part in parts.values())])
    bodies = list(parts.values())
    return MeshArrays(
        np.vstack([part.points for part in bodies]),
        np.vstack([part.elements + first for part, first in zip(bodies, nodes, strict=False)]),
        np.vstack([part.facets + first for part, first in zip(bodies, nodes, strict=False)]),
        np.concatenate([part.facet_labels + first for part, first in zip(bodies, labels, strict=False)]),
        tuple(f"{name}.{edge}" for name, part in parts.items() for edge in part.boundaries),
        np.repeat(np.arange(len(bodies)), [len(part.elements) for part in bodies]), tuple(parts))


def part(dim: int, divisions: int, lift: float) -> MeshArrays:
    """A block with moved inner nodes; in the plane 0.5 <= x <= 2.5."""
    if dim == 2:
        mesh = structured(Rectangle(width=2.0, height=1.0, origin=(0.5, lift)), divisions)
    else:
        mesh = structured(Box(width=2.0, depth=1.5, height=1.0, origin=(0.0, 0.0, lift)), divisions)
    points = mesh.points.copy()
    inside = np.setdiff1d(np.arange(mesh.n_nodes), mesh.facets)
    points[inside] += 0.05 * np.random.default_rng(divisions).uniform(-1, 1, (len(inside), dim))
    return replace(mesh, points=points, source=None)


PARTS = {dim: {"lower": part(dim, 3, 0.0), "upper": part(dim, 2, 1.0)} for dim in (2, 3)}
BOTH = {dim: assembled(**parts) for dim, parts in PARTS.items()}


def two(kind) -> dict:
    return {"upper": kind(young=7e10, poisson=0.33), "lower": kind(young=2.1e11, poisson=0.27)}


def solved(mesh: MeshArrays, material, loads, supports) -> np.ndarray:
    fixed, u = fixed_dofs(mesh, supports)
    matrix, free = stiffness(mesh, material).toarray(), ~fixed
    load = load_vector(mesh, loads, material) - matrix @ u
    u[free] = np.linalg.solve(matrix[np.ix_(free, free)], load[free])
    return u.reshape(-1, mesh.dim)


@EACH_KIND
class TestMaterials:
    def test_stiffness_is_that_of_each_body(self, kind):
        mesh, materials = BOTH[kind.dim], two(kind)
        separate = [stiffness(one, materials[name]).toarray() for name, one in PARTS[kind.dim].items()]
        matrix = stiffness(mesh, materials)
        np.testing.assert_array_equal(matrix.toarray(), sparse.block_diag(separate).toarray())
        assert matrix.has_sorted_indices and matrix.indices.dtype == np.int32 and (np.diff(matrix.indptr) > 0).all()

    def test_one_material_for_all(self, kind):
        mesh, one = BOTH[kind.dim], two(kind)["upper"]
        np.testing.assert_array_equal(stiffness(mesh, one).data, stiffness(mesh, {"lower": one, "upper": one}).data)

    def test_stress_is_that_of_each_body(self, kind):
        mesh, materials = BOTH[kind.dim], two(kind)
        u = 1e-3 * np.random.default_rng(0).normal(size=mesh.points.shape)
        whole, first = full_stress(mesh, materials, u), 0
        for k, (name, one) in enumerate(PARTS[kind.dim].items()):
            alone = full_stress(one, materials[name], u[first:first + one.n_nodes])
            np.testing.assert_allclose(whole[mesh.element_body == k], alone, rtol=1e-13)
            first += one.n_nodes

    def test_work_of_the_stress_is_the_energy(self, kind):
        # for strains that are constant on the elements; the axisymmetric hoop strain is so for u_r = c r
        mesh, materials = BOTH[kind.dim], two(kind)
        gradient = np.diag([1e-3, -4e-4, 7e-4][:kind.dim])
        u = (mesh.points @ gradient).reshape(-1)
        strain = np.zeros((3, 3))
        strain[:kind.dim, :kind.dim] = gradient
        measure = mesh.volumes
        if kind is Axisymmetric:
            strain[2, 2] = gradient[0, 0]
            measure = measure * 2 * np.pi * mesh.points[mesh.elements, 0].mean(axis=1)
        work = measure @ np.einsum("eij,ij->e", full_stress(mesh, materials, u), strain)
        assert u @ (stiffness(mesh, materials) @ u) == pytest.approx(work, rel=1e-12)


def test_glued_materials_equal_ngsolve():
    import ngsolve as ng

    mesh = structured(Rectangle(width=2.0, height=1.0), 4)
    mesh = replace(mesh, bodies=("left", "right"), source=None,
                   element_body=mesh.points[mesh.elements, 0].mean(axis=1) > 1.0)
    materials = {"left": PlaneStrain(young=2.1e11, poisson=0.3), "right": PlaneStress(young=7e10, poisson=0.33)}
    from adaptmg.mesh import with_source

    source = with_source(mesh).source
    space = ng.H1(source, order=1, dim=2)
    u, v = space.TnT()
    lame, shear = (source.MaterialCF({name: getattr(one, what) for name, one in materials.items()}, default=0.0)
                   for what in ("lame", "shear_modulus"))
    form = ng.BilinearForm(space)
    form += (lame * ng.Trace(ng.Grad(u)) * ng.Trace(ng.Grad(v))
             + 2 * shear * ng.InnerProduct(ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v)))) * ng.dx
    form.Assemble()
    ours, theirs = stiffness(mesh, materials), np.array(form.mat.CSR()[0]).reshape(-1, 2, 2)
    np.testing.assert_allclose(ours.data, theirs, rtol=0, atol=1e-13 * np.abs(theirs).max())


class TestLoads:
    @EACH_KIND
    def test_body_force_on_one_body(self, kind):
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

    def test_boundary_of_one_body(self):
        load = load_vector(BOTH[2], [Pressure("upper.top", 2.0)]).reshape(-1, 2)
        np.testing.assert_allclose(load.sum(axis=0), [0.0, -4.0], atol=1e-14)
        assert not load[:PARTS[2]["lower"].n_nodes].any()


class TestInitialStrain:
    @EACH_KIND
    def test_a_free_body_lengthens_without_stress(self, kind):
        # compatible with the kind: nothing through the thickness in plane strain, anything in plane stress, hoop = rr
        mesh, materials = BOTH[kind.dim], two(kind)
        third = {PlaneStrain: (0.0,), PlaneStress: (5e-3,), Axisymmetric: (1e-3,), Solid: (3e-3,)}[kind]
        strain = InitialStrain("upper", (1e-3, -2e-3, *third))
        across = {2: [Support("lower.bottom", y=0.0), Support("upper.bottom", y=0.0)],
                  3: [Support("lower.bottom", z=0.0), Support("upper.bottom", z=0.0)]}[kind.dim]
        if kind is not Axisymmetric:
            across += [Support("lower.left", x=0.0), Support("upper.left", x=0.0)]
        if kind is Solid:
            across += [Support("lower.front", y=0.0), Support("upper.front", y=0.0)]
        u = solved(mesh, materials, [strain], across)
        lower, points = PARTS[kind.dim]["lower"].n_nodes, PARTS[kind.dim]["upper"].points
        origin = points.min(axis=0) * (np.arange(kind.dim) > 0 if kind is Axisymmetric else 1)
        expected = (points - origin) * [1e-3, -2e-3, *third][:kind.dim]
        np.testing.assert_allclose(u[lower:], expected, atol=1e-15)
        np.testing.assert_allclose(u[:lower], 0.0, atol=1e-30)
        assert np.abs(full_stress(mesh, materials, u, [strain])).max() < 1e-10 * 7e10 * 2e-3
        assert np.abs(full_stress(mesh, materials, u)).max() > 1e-2 * 7e10 * 2e-3

    @pytest.mark.parametrize("kind", [PlaneStrain, PlaneStress, Solid])
    def test_a_clamped_bar_is_under_minus_young_times_it(self, kind):
        # both ends held, the sides free to contract: uniaxial stress; plane strain has E / (1 - nu^2)
        mesh, material = PARTS[kind.dim]["lower"], two(kind)["lower"]
        supports = [Support("left", x=0.0), Support("right", x=0.0), Support("bottom", **{"xyz"[kind.dim - 1]: 0.0})]
        if kind is Solid:
            supports.append(Support("front", y=0.0))
        strain = InitialStrain("body", (1e-3, 0.0, 0.0))
        u = solved(mesh, material, [strain], supports)
        stress = full_stress(mesh, material, u, [strain])
        modulus = material.young / (1 - material.poisson**2 if kind is PlaneStrain else 1)
        expected = np.zeros((3, 3))
        expected[0, 0] = -modulus * 1e-3
        if kind is PlaneStrain:
            expected[2, 2] = material.poisson * expected[0, 0]
        np.testing.assert_allclose(stress, np.broadcast_to(expected, stress.shape), atol=1e-10 * modulus * 1e-3)

    def test_through_the_thickness_in_plane_strain(self):
        # fully held in z, free in the plane: sigma_zz = -E e and no other stress, in-plane strain nu e
        mesh, material = PARTS[2]["lower"], PlaneStrain(young=2.1e11, poisson=0.27)
        strain = InitialStrain("body", (0.0, 0.0, 1e-3))
        u = solved(mesh, material, [strain], [Support("left", x=0.0), Support("bottom", y=0.0)])
        stress = full_stress(mesh, material, u, [strain])
        np.testing.assert_allclose(stress[:, 2, 2], -2.1e8, rtol=1e-10)
        np.testing.assert_allclose(stress[:, :2, :2], 0.0, atol=1e-2)
        np.testing.assert_allclose(u, 0.27e-3 * (mesh.points - mesh.points.min(axis=0)), atol=1e-16)
        np.testing.assert_allclose(von_mises(stress), 2.1e8, rtol=1e-10)

    def test_linear_in_position_is_exact(self):
        # virtual work on v = (x, 0, 0): (lambda + 2 mu) int e = with e = k (y + z), 2 x 1.5 x 1
        mesh, material, k = PARTS[3]["lower"], Solid(young=2.1e11, poisson=0.3), 1e-3
        strain = InitialStrain("body", (lambda x: k * (x[:, 1] + x[:, 2]), 0.0, 0.0))
        work = load_vector(mesh, [strain], material) @ (mesh.points * [1.0, 0, 0]).reshape(-1)
        modulus = material.lame + 2 * material.shear_modulus
        assert work == pytest.approx(modulus * k * 3.0 * (0.75 + 0.5), rel=1e-12)

    def test_several_add_up(self):
        mesh, materials = BOTH[2], two(PlaneStress)
        strains = [InitialStrain("upper", (1e-3, 0.0)), InitialStrain("lower", (0.0, lambda x: 1e-3 * x[:, 0])),
                   InitialStrain("upper", (0.0, 2e-3))]
        np.testing.assert_allclose(load_vector(mesh, strains, materials),
                                   sum(load_vector(mesh, [one], materials) for one in strains), atol=1e-8)
        u = np.zeros(mesh.points.shape)
        np.testing.assert_allclose(full_stress(mesh, materials, u, strains),
                                   sum(full_stress(mesh, materials, u, [one]) for one in strains), atol=1e-6)


class TestRigidMotions:
    @EACH_KIND
    def test_they_cost_no_energy(self, kind):
        mesh, axisymmetric = BOTH[kind.dim], kind is Axisymmetric
        modes = rigid_motions(mesh, axisymmetric)
        each = 1 if axisymmetric else {2: 3, 3: 6}[kind.dim]
        assert modes.shape == (mesh.points.size, 2 * each)
        np.testing.assert_allclose(modes.T @ modes, np.eye(2 * each), atol=1e-14)
        lower = PARTS[kind.dim]["lower"].points.size
        assert not modes[lower:, :each].any() and not modes[:lower, each:].any()
        matrix = stiffness(mesh, two(kind))
        assert np.abs(matrix @ modes).max() < 1e-14 * np.abs(matrix.data).max()
        # and nothing else is free
        values = np.linalg.eigvalsh(matrix.toarray())
        assert values[2 * each] > 1e-6 * values[-1] > 1e6 * np.abs(values[:2 * each]).max()

    def test_glued_bodies_move_together(self):
        mesh = structured(Rectangle(width=2.0, height=1.0), 4)
        right = mesh.points[mesh.elements, 0].mean(axis=1) > 1.0
        glued = replace(mesh, bodies=("left", "right"), element_body=right)
        np.testing.assert_array_equal(rigid_motions(glued), rigid_motions(mesh))
        assert rigid_motions(assembled(a=mesh, b=mesh)).shape[1] == 6

    def test_refuses(self):
        with pytest.raises(ValueError, match="axisymmetric meshes are 2D"):
            rigid_motions(BOTH[3], axisymmetric=True)


class TestRefusals:
    def test_materials(self):
        steel = PlaneStrain(young=1.0, poisson=0.2)
        with pytest.raises(ValueError, match=r"no material for body 'upper'; the bodies are lower, upper, .*lower"):
            stiffness(BOTH[2], {"lower": steel})
        with pytest.raises(ValueError, match="either all bodies are Axisymmetric or none, got PlaneStrain, Axisym"):
            stiffness(BOTH[2], {"lower": steel, "upper": Axisymmetric(young=1.0, poisson=0.2)})
        with pytest.raises(TypeError, match=r"mapping body name -> one of them, got 1\.0"):
            full_stress(BOTH[2], {"lower": steel, "upper": 1.0}, np.zeros(BOTH[2].points.shape))

    def test_loads(self):
        steel = Solid(young=1.0, poisson=0.2)
        for load in (BodyForce((0.0, 0.0, 1.0), body="roof"), InitialStrain("roof", (1.0, 1.0, 1.0))):
            with pytest.raises(ValueError, match="body 'roof' does not exist; the bodies are lower, upper"):
                load_vector(BOTH[3], [load], steel)
        with pytest.raises(ValueError, match="depends on the elastic constants: give material"):
            load_vector(BOTH[3], [InitialStrain("upper", (1.0, 1.0, 1.0))])
        with pytest.raises(ValueError, match="2 components on a 3D mesh: give 3"):
            load_vector(BOTH[3], [InitialStrain("upper", (1.0, 1.0))], steel)
        with pytest.raises(ValueError, match="component 3 of InitialStrain on 'upper' must be finite"):
            load_vector(BOTH[3], [InitialStrain("upper", (1.0, 1.0, lambda x: np.full(len(x), np.nan)))], steel)


def without_ngsolve() -> dict[str, np.ndarray]:
    """The matrix of every kind."""
    return {kind.__name__: stiffness(BOTH[kind.dim], two(kind)).data for kind in KINDS.values()}


def test_kernels_without_jit(tmp_path):
    script = ("import sys; sys.path.insert(0, sys.argv[1])\nimport numpy as np\n"
              "from test_discretisation_bodies import without_ngsolve\nnp.savez(sys.argv[2], **without_ngsolve())\n")
    path = tmp_path / "matrices.npz"
    subprocess.run([sys.executable, "-W", "error::RuntimeWarning", "-c", script, str(HERE), str(path)], check=True,
                   env={**os.environ, "NUMBA_DISABLE_JIT": "1"})
    plain = np.load(path)
    for name, data in without_ngsolve().items():
        np.testing.assert_allclose(plain[name], data, rtol=0, atol=1e-14 * np.abs(data).max(), err_msg=name)
