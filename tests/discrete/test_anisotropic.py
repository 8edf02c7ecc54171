"""Materials that depend on the direction, and thermal strains: against isotropic ones, turned
bodies, closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from refused import refused
from scipy.spatial.transform import Rotation
from two_materials import BOTH_ELEMENTS, EACH_KIND, MESHES

import adaptmg as am
from adaptmg.discrete.loads import supported_stiffness
from adaptmg.discrete.stress import StressData

WOOD = {"young": (12e9, 0.8e9, 0.5e9), "poisson": (0.4, 0.35, 0.5), "shear": (0.7e9, 0.6e9, 0.1e9)}
LIKE_STEEL = {"young": (2.1e11,) * 3, "poisson": (0.3,) * 3, "shear": (2.1e11 / 2.6,) * 3}
RANDOM = np.random.default_rng(33)


def axes_of(kind, angles) -> np.ndarray:
    """Axes (n, 3, 3) as rows, turned by angles (n,) about z; of solids from others that are no
    coordinate axes."""
    about_z = Rotation.from_euler("z", -np.reshape(angles, (-1, 1)), degrees=True).as_matrix()
    return about_z if kind.dim == 2 else about_z @ Rotation.random(random_state=1).as_matrix()


def turned(kind, values, angle: float = 0.0, by: float = 0.0):
    """A material whose axes are turned, ``by`` degrees per metre along x."""
    if kind.dim == 2:
        return kind.orthotropic(**values, angle=(lambda x: angle + by * x[:, 0]) if by else angle)
    return kind.orthotropic(
        **values,
        axes=(lambda x: axes_of(kind, angle + by * x[:, 0])) if by else axes_of(kind, [angle])[0],
    )


@EACH_KIND
@pytest.mark.parametrize(("elements", "by"), [("linear", 0.0), ("linear", 40.0), ("smoothed", 0.0)])
def test_energies_are_those_of_the_matrix_and_uniform_fields_are_in_balance(kind, elements, by):
    mesh, material = MESHES[kind.dim], turned(kind, WOOD, RANDOM.uniform(0, 360), by)
    matrix, u = (
        supported_stiffness(mesh, material, (), elements),
        RANDOM.standard_normal(mesh.points.shape),
    )
    data = StressData.of(mesh, material, (), elements)
    assert data.energy(mesh, u) == pytest.approx(0.5 * u.ravel() @ matrix @ u.ravel(), rel=1e-12)
    assert np.linalg.eigvalsh(matrix.toarray()).min() > -1e-12 * abs(matrix).max()
    if kind is not am.Axisymmetric and not by:
        forces = (
            matrix @ (mesh.points @ RANDOM.standard_normal((kind.dim, kind.dim))).ravel()
        ).reshape(-1, kind.dim)
        inner = np.setdiff1d(np.arange(mesh.n_nodes), mesh.facets)
        assert np.abs(forces[inner]).max() < 1e-13 * np.abs(forces).max()


def compliance_tensor(axes: np.ndarray) -> np.ndarray:
    """The strains (3, 3) of stresses (3, 3) of wood, by the definition of its constants, with its
    axes as rows."""
    (e, (n12, n13, n23), (g12, g13, g23)), result = WOOD.values(), np.zeros((3, 3, 3, 3))
    normal = [
        [1 / e[0], -n12 / e[0], -n13 / e[0]],
        [-n12 / e[0], 1 / e[1], -n23 / e[1]],
        [-n13 / e[0], -n23 / e[1], 1 / e[2]],
    ]
    for i, j, g in ((0, 1, g12), (0, 2, g13), (1, 2, g23)):
        for k, m in ((i, j), (j, i)):
            result[k, m, k, m] = result[k, m, m, k] = 0.25 / g
    result[np.arange(3)[:, None], np.arange(3)[:, None], np.arange(3), np.arange(3)] = normal
    return np.einsum("ai,bj,ck,dl,abcd->ijkl", axes, axes, axes, axes, result)


@EACH_KIND
@pytest.mark.parametrize("by", [0.0, 40.0])
def test_stresses_make_the_strains_of_the_constants_along_axes_that_may_follow_the_position(
    kind, by
):
    mesh, angle = MESHES[kind.dim], RANDOM.uniform(0, 360)
    axes = axes_of(kind, angle + by * mesh.points[mesh.elements, 0].mean(axis=1))
    data, u = (
        StressData.of(mesh, turned(kind, WOOD, angle, by)),
        RANDOM.standard_normal(mesh.points.shape),
    )
    stress, strain = data.tensors(mesh, u), data.strains(mesh, u)
    made = [
        np.einsum("ijkl,kl->ij", compliance_tensor(own), one)
        for own, one in zip(axes, stress, strict=True)
    ]
    assert np.abs(made - strain).max() < 1e-11 * np.abs(strain).max()
    assert (np.abs(stress[:, 2, 2]).max() == 0.0) == (kind is am.PlaneStress)


@pytest.mark.parametrize("kind", [am.PlaneStress, am.Axisymmetric, am.Solid])
@BOTH_ELEMENTS
def test_what_expands_freely_bears_no_stress(kind, elements):
    mesh, material = MESHES[kind.dim], turned(kind, WOOD, 25.0)
    heat = [am.InitialStrain.thermal(1.2e-5, 40.0, body=body) for body in mesh.bodies]
    u = 1.2e-5 * 40.0 * mesh.points
    load = am.discrete.load_vector(mesh, heat, material, elements)
    forces = supported_stiffness(mesh, material, (), elements) @ u.ravel()
    assert np.abs(forces - load).max() < 1e-12 * np.abs(load).max()
    stress = StressData.of(mesh, material, heat, elements).tensors(mesh, u)
    assert np.abs(stress).max() < 1e-12 * 12e9 * 1.2e-5 * 40.0


def test_thermal_strains_take_numbers_and_functions():
    x = RANDOM.uniform(size=(5, 2))
    assert am.InitialStrain.thermal(1e-5, 100.0).components == (1e-5 * 100.0,) * 3
    along = am.InitialStrain.thermal(
        (1e-5, lambda x: 1e-5 * x[:, 0], 0.0), lambda x: 100 * x[:, 1], body="pin"
    )
    assert along.body == "pin" and along == replace(along)
    np.testing.assert_allclose(
        [one(x) for one in along.components],
        [1e-3 * x[:, 1], 1e-3 * x[:, 0] * x[:, 1], 0 * x[:, 0]],
    )


@pytest.mark.parametrize("angle", [0.0, 90.0])
def test_a_rigid_cylinder_presses_an_orthotropic_half_plane_as_in_closed_form(angle):
    (e1, e2, e3), (n12, n13, n23), (g12, *_) = WOOD.values()
    compliance = np.array(
        [
            [1 / e1, -n12 / e1, -n13 / e1],
            [-n12 / e1, 1 / e2, -n23 / e2],
            [-n13 / e1, -n23 / e2, 1 / e3],
        ]
    )
    plane = compliance[:2, :2] - np.outer(compliance[:2, 2], compliance[2, :2]) / compliance[2, 2]
    along, normal = (plane[0, 0], plane[1, 1]) if angle == 0 else (plane[1, 1], plane[0, 0])
    # of a half-plane normal to an axis (Lekhnitskii): 2 / E* of an isotropic one
    soft = math.sqrt(normal * (2 * plane[0, 1] + 1 / g12 + 2 * math.sqrt(along * normal)))
    radius, a, size, fine = 0.05, 1e-3, 0.06, 10
    load = math.pi * a**2 * (2 / soft) / (4 * radius)
    problem = am.ContactProblem(
        domain=am.Rectangle(width=size, height=size),
        material=am.PlaneStrain.orthotropic(**WOOD, angle=angle),
        contact=am.Contact("bottom", am.GapFunction(lambda x: 0.5 * x[:, 0] ** 2 / radius)),
        law=am.Frictionless(),
        loads=(am.Pressure("top", load / 2 / size),),
        supports=(am.Support("left", x=0),),
    )
    near = am.SizeNear([(0.0, 0.0)], size=a / fine, radius=1.3 * a, grading=2.4 / fine)
    meshes = [
        am.mesh.sized(problem.domain, near.scaled(k), k * size / 20, grading=k * near.grading)
        for k in (2, 1)
    ]
    contact = am.solve(am.Hierarchy.from_meshes(problem, meshes)).contact
    x, peak = contact.x[:, 0] / a, 2 * load / (math.pi * a)
    slope, square = np.polyfit(x[x < 0.8] ** 2, (contact.pressure[x < 0.8] / peak) ** 2, 1)
    found = math.sqrt(square), math.sqrt(square / -slope)
    assert found == pytest.approx((1, 1), abs=0.015)


@pytest.mark.parametrize("name", ["greco_bar", "hertz_sphere", "greco_block"])
def test_estimates_of_isotropic_tensors_are_those_of_isotropic_materials(name, tmp_path):
    plain = am.cases.CASES[name].function()
    material = plain.material
    constants = {
        "young": material.young,
        "poisson": material.poisson,
        "shear": material.shear_modulus,
    }
    own = replace(
        plain,
        material=turned(
            type(material), {name: (one,) * 3 for name, one in constants.items()}, 40.0
        ),
    )
    size = 4e-3 if name == "hertz_sphere" else 10e-3
    goal, found = (
        am.Goal(am.MeanDisplacement("top" if name != "hertz_sphere" else "upper.top", "y")),
        [],
    )
    for problem in (plain, own):
        grids = am.Hierarchy.graded(problem, (size,))
        result = am.solve(grids, am.ActiveSet(rtol=1e-12))
        found.append(
            [one.indicate(grids, result).total for one in (am.Residual(), am.Recovery(), goal)]
        )
    assert found[0] == pytest.approx(found[1], rel=1e-6)
    result.save(tmp_path / "run.npz")
    np.testing.assert_array_equal(am.Result.load(tmp_path / "run.npz").stress(), result.stress())


SILICON = np.diag([166e9] * 3 + [80e9] * 3) + 64e9 * np.pad(1 - np.eye(3), (0, 3))

test_refuses = refused(
    (
        lambda: am.PlaneStrain.orthotropic(**WOOD | {"poisson": (0.4, 0.35, 1.5)}),
        "positive definite",
    ),
    (
        lambda: am.PlaneStress.orthotropic(**WOOD | {"young": (1e9, 1e9)}),
        r"young must have shape \(3,\)",
    ),
    (lambda: am.Solid.orthotropic(**WOOD | {"shear": (1e9, 0.0, 1e9)}), r"shear\[1\] must be > 0"),
    (lambda: am.Solid.orthotropic(**WOOD, axes=2 * np.eye(3)), "rows of axes must be orthonormal"),
    (lambda: am.Axisymmetric.orthotropic(**WOOD, angle=np.nan), "angle must be finite"),
    (lambda: am.Solid.anisotropic(SILICON + 1e9 * np.eye(6, k=1)), "stiffness must be symmetric"),
    (lambda: am.Solid.anisotropic(-SILICON), "stiffness must be positive definite"),
    (lambda: am.Solid.anisotropic(SILICON[:3, :3]), r"stiffness must have shape \(6, 6\)"),
    (lambda: replace(am.Solid.anisotropic(SILICON), young=1e9), "follow from its stiffness"),
    (
        lambda: am.Solid(young=1e9, poisson=0.3, anisotropy=SILICON),
        TypeError,
        "anisotropy must be Anisotropy",
    ),
    (lambda: am.InitialStrain.thermal((1e-5,), 1.0), "expansion must have 2 or 3 components"),
    (lambda: am.InitialStrain.thermal(1e-5, "hot"), TypeError, "temperature must be a number"),
    (
        lambda: supported_stiffness(
            MESHES[3], am.Solid.orthotropic(**WOOD, axes=lambda x: np.ones((len(x), 3, 3))), ()
        ),
        "rows of axes must be orthonormal",
    ),
    (
        lambda: replace(
            am.cases.greco_bar(),
            elements="smoothed",
            material=am.PlaneStrain.orthotropic(**LIKE_STEEL, angle=lambda x: x[:, 0]),
        ),
        "must not vary in a body with smoothed elements",
    ),
)
