"""Stiffness, stress, loads and supports of every kind of body: against their definitions and closed
forms."""

import math
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from bisected_meshes import shaken
from made_bodies import joined
from refused import refused
from two_materials import BOTH_ELEMENTS, EACH_KIND, KINDS, MESHES

import adaptmg as am
from adaptmg.discrete.block_rows import BlockRows
from adaptmg.discrete.elasticity import dofs_of, repeated_rows
from adaptmg.discrete.loads import supported_stiffness
from adaptmg.discrete.moduli import body_materials
from adaptmg.discrete.stress import StressData, hoop_strain
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_rule, simplex_rule

STEEL = am.Axisymmetric(young=2.1e11, poisson=0.3)
INNER, OUTER, HEIGHT = 0.1, 0.25, 0.12


def part(dim: int, divisions: int, lift: float) -> am.MeshArrays:
    """A block; in the plane 0.5 <= x <= 2.5."""
    shape = (
        am.Rectangle(width=2.0, height=1.0, origin=(0.5, lift))
        if dim == 2
        else am.Box(width=2.0, depth=1.5, height=1.0, origin=(0.0, 0.0, lift))
    )
    return shaken(am.mesh.structured(shape, divisions), 0.05, divisions)


def meridian(inner: float, divisions: int | tuple[int, int] = (4, 3)) -> am.MeshArrays:
    """A rectangle inner <= r <= OUTER, 0 <= z <= HEIGHT."""
    return am.mesh.structured(
        am.Rectangle(width=OUTER - inner, height=HEIGHT, origin=(inner, 0.0)), divisions
    )


PARTS = {dim: {"lower": part(dim, 3, 0.0), "upper": part(dim, 2, 1.0)} for dim in (2, 3)}
BOTH = {dim: joined(parts, dict.fromkeys(parts, (0.0,) * dim)) for dim, parts in PARTS.items()}
SOLID, RING = shaken(meridian(0.0), 0.007, 3), shaken(meridian(INNER), 0.007, 3)


def two(kind) -> dict:
    return {"upper": kind(young=7e10, poisson=0.33), "lower": kind(young=2.1e11, poisson=0.27)}


CASES = {
    **{name: (BOTH[kind.dim], two(kind)) for name, kind in KINDS.items()},
    "on the axis": (SOLID, STEEL),
}
EACH_CASE = pytest.mark.parametrize(("mesh", "material"), CASES.values(), ids=CASES)


def solved(mesh: am.MeshArrays, material, loads, supports, elements: str) -> np.ndarray:
    """Nodal displacements (n_nodes, dim)."""
    fixed, u = am.discrete.fixed_dofs(mesh, supports)
    matrix, free = supported_stiffness(mesh, material, (), elements).toarray(), ~fixed
    load = am.discrete.load_vector(mesh, loads, material, elements) - matrix @ u
    u[free] = np.linalg.solve(matrix[np.ix_(free, free)], load[free])
    return u.reshape(-1, mesh.dim)


def measures(mesh, axisymmetric):
    """Volumes of the elements, over the full circumference."""
    return mesh.volumes * (
        2 * np.pi * mesh.points[mesh.elements, 0].mean(axis=1) if axisymmetric else 1.0
    )


def is_axisymmetric(material):
    return isinstance(
        next(iter(material.values())) if isinstance(material, dict) else material, am.Axisymmetric
    )


def strains(
    mesh: am.MeshArrays, around: bool, rule, weights
) -> list[tuple[int, float, np.ndarray]]:
    """Elements, volumes and strains (3, 3, n_dofs) at quadrature points."""
    result, dim = [], mesh.dim
    for e, corners in enumerate(mesh.elements):
        slopes = np.linalg.inv(np.insert(mesh.points[corners], 0, 1.0, axis=1))[1:]
        flat = np.zeros((3, 3, mesh.points.size))
        for i in range(dim):
            flat[i, :dim, dim * corners + i] += slopes.T
        for at, weight in zip(rule, weights, strict=True):
            strain, volume = (flat + flat.transpose(1, 0, 2)) / 2, weight * mesh.volumes[e]
            r = at @ mesh.points[corners, 0]
            if around:
                strain[2, 2, 2 * corners] += at / r
                volume *= 2 * np.pi * r
            result.append((e, volume, strain))
    return result


def dense(mesh: am.MeshArrays, material, elements: str, rule=None) -> np.ndarray:
    """The stiffness from its definition, by the rule of the package or another one."""
    around, k, parts = is_axisymmetric(material), mesh.dim + 1, {}
    if rule is None:
        exact = elements == "linear" and around
        rule = quadrature_rule(3, AXISYMMETRIC_DEGREE) if exact else (np.full((1, k), 1 / k), [1.0])
    for point, (e, volume, strain) in enumerate(strains(mesh, around, *rule)):
        edges = combinations(sorted(mesh.elements[e]), 2) if elements == "smoothed" else [(point,)]
        for edge in edges:
            parts.setdefault((mesh.element_body[e], *edge), []).append((volume, strain))
    share, result = (
        math.comb(k, 2) if elements == "smoothed" else 1,
        np.zeros((mesh.points.size,) * 2),
    )
    for (body, *_), there in parts.items():
        one, volume = body_materials(mesh, material)[body], sum(volume for volume, _ in there)
        mean = sum(part * strain for part, strain in there) / volume
        trace = np.einsum("iin->n", mean)
        result += (
            volume
            / share
            * (
                2 * one.shear_modulus * np.einsum("ijn,ijm->nm", mean, mean)
                + one.lame * np.outer(trace, trace)
            )
        )
    return result


GLUED = {
    "glued": (
        MESHES[2],
        {
            "left": am.PlaneStrain(young=2.1e11, poisson=0.36),
            "right": am.PlaneStress(young=7e10, poisson=-0.2),
        },
    ),
    "glued solids": (
        MESHES[3],
        {"left": am.Solid(young=2.1e11, poisson=0.36), "right": am.Solid(young=7e10, poisson=-0.2)},
    ),
}


@BOTH_ELEMENTS
@pytest.mark.parametrize(
    ("mesh", "material"), [*CASES.values(), *GLUED.values()], ids=[*CASES, *GLUED]
)
def test_stiffness_is_that_of_its_definition_in_sorted_symmetric_blocks(mesh, material, elements):
    matrix = am.discrete.stiffness(mesh, material, elements)
    ours, theirs = matrix.toarray(), dense(mesh, material, elements)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-13 * np.abs(ours).max())
    assert (
        matrix.blocksize == (mesh.dim, mesh.dim)
        and matrix.has_sorted_indices
        and matrix.indices.dtype == np.int32
    )
    assert abs(matrix - matrix.T).max() == 0.0 and (np.diff(matrix.indptr) > 0).all()


SPRUCE = {
    "young": (12e9, 0.8e9, 0.5e9),
    "poisson": (0.4, 0.4, 0.5),
    "shear": (0.7e9, 0.7e9, 0.05e9),
}
LATTICES = {
    "sheet": (am.Rectangle(width=0.3, height=0.7, origin=(3.1, -0.4)), (63, 71)),
    "strip": (am.Rectangle(width=2.0, height=1e-3, origin=(-1.0, 5.0)), (2000, 1)),
    "block": (am.Box(width=0.3, depth=0.2, height=0.7, origin=(0.1, 3.0, -2.0)), (13, 9, 31)),
    "plate": (am.Box(width=0.3, depth=0.2, height=0.01), (45, 30, 2)),
}


@BOTH_ELEMENTS
@pytest.mark.parametrize("name", LATTICES)
def test_a_large_lattice_has_the_matrix_of_the_same_mesh_numbered_at_random(name, elements):
    domain, divisions = LATTICES[name]
    mesh = am.mesh.structured(domain, divisions)
    axes = np.linalg.qr(np.random.default_rng(1).random((3, 3)))[0]
    material = {
        "sheet": am.PlaneStrain.orthotropic(**SPRUCE, angle=30.0),
        "strip": am.PlaneStress(young=2e11, poisson=0.3),
        "block": am.Solid.orthotropic(**SPRUCE, axes=axes),
        "plate": am.Solid(young=2e11, poisson=0.3),
    }[name]
    rng = np.random.default_rng(0)
    number = rng.permutation(mesh.n_nodes)
    at_random = replace(
        mesh,
        points=mesh.points[np.argsort(number)],
        elements=rng.permutation(number[mesh.elements]),
        facets=number[mesh.facets],
    )
    matrix = am.discrete.stiffness(mesh, material, elements)
    dofs = (mesh.dim * number[:, None] + np.arange(mesh.dim)).ravel()
    expected = am.discrete.stiffness(at_random, material, elements).tocsr()[dofs][:, dofs]
    assert abs(matrix - expected).max() <= 1e-11 * abs(expected).max()
    assert len(matrix.indices) == expected.nnz / mesh.dim**2
    assert matrix.has_sorted_indices and matrix.indptr.dtype == np.int32
    assert abs(matrix - matrix.T).max() == 0.0
    repeated = repeated_rows(mesh, material, elements)
    stored = BlockRows.of(matrix)
    assert repeated.nonzeros == stored.nonzeros == matrix.nnz
    np.testing.assert_array_equal(repeated.diagonal(), matrix.diagonal())
    np.testing.assert_array_equal(repeated.last_columns(), stored.last_columns())
    vector = rng.random(matrix.shape[0])
    np.testing.assert_array_equal(repeated.times(vector), matrix @ vector)
    nodes = rng.permutation(mesh.n_nodes)[:50]
    for rows in (repeated, stored):
        some = rows.at_nodes(nodes).toarray()
        np.testing.assert_array_equal(some, matrix.tocsr()[dofs_of(nodes, mesh.dim)].toarray())


def test_glued_bodies_move_together():
    mesh = am.mesh.structured(am.Rectangle(width=2.0, height=1.0), 4)
    glued = replace(
        mesh,
        bodies=("left", "right"),
        element_body=mesh.points[mesh.elements, 0].mean(axis=1) > 1.0,
    )
    np.testing.assert_array_equal(am.discrete.rigid_motions(glued), am.discrete.rigid_motions(mesh))


def test_the_axisymmetric_rule_is_accurate_off_the_axis():
    ours, exact = (
        am.discrete.stiffness(RING, STEEL).toarray(),
        dense(RING, STEEL, "linear", simplex_rule(2, 11)),
    )
    # the error of degree 5 in 1/r is of the order (h/r)^6, here h/r < .4
    np.testing.assert_allclose(ours, exact, rtol=0, atol=2e-7 * np.abs(exact).max())


@BOTH_ELEMENTS
@EACH_CASE
def test_rigid_motions_cost_no_energy_and_nothing_else_does(mesh, material, elements):
    axisymmetric, n_bodies = is_axisymmetric(material), len(mesh.bodies)
    modes = am.discrete.rigid_motions(mesh, axisymmetric)
    each = 1 if axisymmetric else {2: 3, 3: 6}[mesh.dim]
    assert modes.shape == (mesh.points.size, n_bodies * each)
    np.testing.assert_allclose(modes.T @ modes, np.eye(n_bodies * each), atol=1e-14)
    for k in range(n_bodies):
        others = np.unique(mesh.elements[mesh.element_body != k])
        assert not modes.reshape(mesh.n_nodes, mesh.dim, -1)[others][
            :, :, k * each : (k + 1) * each
        ].any()
    matrix = supported_stiffness(mesh, material, (), elements)
    assert np.abs(matrix @ modes).max() < 2e-14 * np.abs(matrix.data).max()
    values = np.linalg.eigvalsh(matrix.toarray())
    assert (
        values[n_bodies * each] > 1e-6 * values[-1] > 1e6 * np.abs(values[: n_bodies * each]).max()
    )


@BOTH_ELEMENTS
@EACH_CASE
def test_patch_test(mesh, material, elements):
    """A linear field (u_r = c r in axisymmetry) leaves the nodes inside without force, with exact
    energy."""
    dim, axisymmetric = mesh.dim, is_axisymmetric(material)
    gradient = 1e-3 * np.random.default_rng(1).normal(size=(dim, dim))
    if axisymmetric:
        gradient = np.diag([3e-4, -1e-3])
    u, inside = (
        (mesh.points @ gradient.T).reshape(-1),
        np.setdiff1d(np.arange(mesh.n_nodes), mesh.facets),
    )
    matrix = supported_stiffness(mesh, material, (), elements)
    force = (matrix @ u).reshape(-1, dim)
    np.testing.assert_allclose(force[inside], 0, atol=1e-13 * np.abs(force).max())
    strain = np.zeros((3, 3))
    strain[:dim, :dim] = 0.5 * (gradient + gradient.T)
    expected = np.broadcast_to(strain[:dim, :dim], (len(mesh.elements), dim, dim))
    np.testing.assert_allclose(am.discrete.element_strain(mesh, u), expected, atol=1e-14)
    if axisymmetric:
        strain[2, 2] = 3e-4
        np.testing.assert_allclose(hoop_strain(mesh, u), 3e-4, rtol=1e-11)
    data = StressData.of(mesh, material, elements=elements)
    stress = data.tensors(mesh, u)
    assert 2 * data.energy(mesh, u) == pytest.approx(u @ matrix @ u, rel=1e-12)
    if isinstance(material, dict) and isinstance(material["lower"], am.PlaneStress):
        through = [-one.poisson / (1 - one.poisson) for one in map(material.get, mesh.bodies)]
        thickened = np.array(through)[mesh.element_body] * np.trace(strain)
        np.testing.assert_allclose(data.strains(mesh, u)[:, 2, 2], thickened, rtol=1e-10)
    work = measures(mesh, axisymmetric) @ np.einsum("eij,ij->e", stress, strain)
    assert u @ matrix @ u == pytest.approx(work, rel=1e-12)
    if not isinstance(material, dict):
        expected = STEEL.lame * np.trace(strain) * np.eye(3) + 2 * STEEL.shear_modulus * strain
        np.testing.assert_allclose(
            stress, np.broadcast_to(expected, stress.shape), atol=1e-11 * np.abs(expected).max()
        )


@BOTH_ELEMENTS
@EACH_KIND
def test_a_free_body_with_initial_strains_lengthens_without_stress(kind, elements):
    # compatible with the kind: nothing through the thickness in plane strain, anything in plane
    # stress, hoop = rr
    mesh, materials = BOTH[kind.dim], two(kind)
    third = {
        am.PlaneStrain: (0.0,),
        am.PlaneStress: (5e-3,),
        am.Axisymmetric: (1e-3,),
        am.Solid: (3e-3,),
    }[kind]
    strains = [
        am.InitialStrain("upper", (1e-3, 0.0, *third)),
        am.InitialStrain("upper", (0.0, -2e-3, 0.0)),
    ]
    sides = {"bottom": "y"} if kind is am.Axisymmetric else {"bottom": "y", "left": "x"}
    sides = {"bottom": "z", "left": "x", "front": "y"} if kind is am.Solid else sides
    supports = [
        am.Support(f"{body}.{side}", **{c: 0.0})
        for body in mesh.bodies
        for side, c in sides.items()
    ]
    u = solved(mesh, materials, strains, supports, elements)
    lower, points = PARTS[kind.dim]["lower"].n_nodes, PARTS[kind.dim]["upper"].points
    origin = points.min(axis=0) * (np.arange(kind.dim) > 0 if kind is am.Axisymmetric else 1)
    np.testing.assert_allclose(
        u[lower:], (points - origin) * [1e-3, -2e-3, *third][: kind.dim], atol=1e-15
    )
    np.testing.assert_allclose(u[:lower], 0.0, atol=1e-30)
    stress = StressData.of(mesh, materials, strains, elements).tensors(mesh, u)
    assert np.abs(stress).max() < 1e-10 * 7e10 * 2e-3
    assert np.abs(am.discrete.full_stress(mesh, materials, u)).max() > 1e-2 * 7e10 * 2e-3


@pytest.mark.parametrize(
    ("stress", "expected"),
    [
        (np.diag([5.0, 0, 0]), 5.0),
        (np.diag([5.0, 0, 1.0]), 5 * np.sqrt(0.84)),  # uniaxial; plane strain with nu = .2
        ([[0, 0, 2.0], [0, 0, 0], [2.0, 0, 0]], 2 * np.sqrt(3)),
    ],
)
def test_von_mises(stress, expected):
    assert am.discrete.von_mises(np.array([stress])) == pytest.approx(expected)


def test_rounding_on_the_axis_is_let_pass():
    points = SOLID.points.copy()
    points[SOLID.boundary_nodes("left"), 0] = -1e-17
    near, here = (
        am.discrete.stiffness(replace(SOLID, points=points), STEEL),
        am.discrete.stiffness(SOLID, STEEL),
    )
    np.testing.assert_allclose(near.data, here.data, rtol=0, atol=1e-12 * np.abs(near.data).max())


FLAT = am.mesh.structured(am.Rectangle(width=2.0, height=1.0), (5, 3))
DEEP = am.mesh.structured(am.Box(width=2.0, depth=3.0, height=1.0), (3, 2, 2))


def resultants(mesh, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Force (dim,) and virtual works (dim, dim) of the fields x_j e_i."""
    nodal = load.reshape(-1, mesh.dim)
    return nodal.sum(axis=0), nodal.T @ mesh.points


@pytest.mark.parametrize(
    ("load", "force", "moment"),
    [
        (am.Pressure("top", 3.0), [0.0, -6.0], [[0, 0], [-6.0, -6.0]]),
        # p = 1 + y on the left: force 3/2 in +x, moment of y: int (1 + y) y = 1/2 + 1/3
        (am.Pressure("left", lambda x: 1 + x[:, 1]), [1.5, 0.0], [[0.0, 5 / 6], [0.0, 0.0]]),
        (am.Traction("right", (lambda x: x[:, 1], 2.0)), [0.5, 2.0], [[1.0, 1 / 3], [4.0, 1.0]]),
        # int x = 2, int x^2 = 8/3, int x y = 1; over 2 x 1
        (am.BodyForce((lambda x: x[:, 0], -2.0)), [2.0, -4.0], [[8 / 3, 1.0], [-4.0, -2.0]]),
        # p = x + y on the top, 2 x 3: int p = 6 + 9; int p x = 3*8/3 + 2*4.5; int p y = 2*4.5 + 2*9
        (
            am.Pressure("top", lambda x: x[:, 0] + x[:, 1]),
            [0, 0, -15.0],
            [[0, 0, 0], [0, 0, 0], [-17.0, -27.0, -15.0]],
        ),
        # volume 6: int z = 3, int z x = 3, int z y = 4.5, int z^2 = 2
        (
            am.BodyForce((0.0, lambda x: x[:, 2], 1.0)),
            [0.0, 3.0, 6.0],
            [[0, 0, 0], [3.0, 4.5, 2.0], [6.0, 9.0, 3.0]],
        ),
    ],
    ids=["pressure", "linear pressure", "traction", "body force", "pressure 3D", "body force 3D"],
)
def test_resultants(load, force, moment):
    mesh = FLAT if len(force) == 2 else DEEP
    found = resultants(mesh, am.discrete.load_vector(mesh, [load]))
    np.testing.assert_allclose(found[0], force, atol=1e-13)
    np.testing.assert_allclose(found[1], moment, atol=1e-13)


# the powers of r and z in the volume and at the top come from int r^n dr; k = 2e5
@pytest.mark.parametrize(
    ("load", "force", "work"),
    [
        (am.Pressure("top", 3e6), [0.0, -3e6 * np.pi * (OUTER**2 - INNER**2)], None),
        (am.Pressure("left", 3e6), [3e6 * 2 * np.pi * INNER * HEIGHT, 0.0], None),
        (am.BodyForce((0.0, -7e4)), [0.0, -7e4 * measures(RING, True).sum()], None),
        (
            am.InitialStrain("body", (0.0, lambda x: 2e5 * x[:, 0], 0.0)),
            None,
            4e5
            * np.pi
            * (3 * STEEL.lame + 2 * STEEL.shear_modulus)
            * HEIGHT
            * (OUTER**3 - INNER**3)
            / 3,
        ),
        (
            am.BodyForce((lambda x: 2e5 * x[:, 0], 0.0)),
            None,
            4e5 * np.pi * HEIGHT * (OUTER**4 - INNER**4) / 4,
        ),
        (
            am.Traction("top", (0.0, lambda x: 2e5 * x[:, 0])),
            None,
            4e5 * np.pi * HEIGHT * (OUTER**3 - INNER**3) / 3,
        ),
    ],
)
def test_axisymmetric_forces_and_work_of_linear_data_are_exact(load, force, work):
    found = am.discrete.load_vector(RING, [load], STEEL)
    if force is not None:
        np.testing.assert_allclose(found.reshape(-1, 2).sum(axis=0), force, rtol=1e-12, atol=1e-8)
    else:
        assert found @ RING.points.reshape(-1) == pytest.approx(work, rel=1e-12)


def _turned(mesh):
    elements = mesh.elements.copy()
    elements[5, :2] = elements[5, 1::-1]
    return replace(mesh, elements=elements)


PLATE, BLOCK, ONE = PARTS[2]["lower"], PARTS[3]["lower"], am.PlaneStrain(young=1.0, poisson=0.2)
ROCK = am.Solid(young=1.0, poisson=0.2)


EMPTY = replace(FLAT, boundaries=(*FLAT.boundaries, "hole"))
test_refusals = refused(
    (
        lambda: am.discrete.load_vector(FLAT, [am.Pressure("top", 1.0)], elements="quadratic"),
        "elements must be .*linear.*smoothed.*quadratic",
    ),
    (
        lambda: am.discrete.load_vector(FLAT, [am.Pressure("roof", 1.0)]),
        "'roof' does not exist; the boundaries are bottom",
    ),
    (
        lambda: am.discrete.load_vector(EMPTY, [am.Pressure("hole", 1.0)]),
        "'hole' has a name in the mesh but no facets",
    ),
    (
        lambda: am.discrete.fixed_dofs(
            FLAT, [am.Support("left", x=0.0), am.Support("bottom", x=1e-3)]
        ),
        r"'left' and 'bottom' prescribe different x displacements, 0 and 0\.001 m, at their common node 0",
    ),
    (lambda: am.discrete.fixed_dofs(FLAT, [am.Support("wall", x=0.0)]), "'wall' does not exist"),
    (lambda: am.discrete.stiffness(PLATE, ROCK), "the material is 3D, the mesh 2D"),
    (
        lambda: am.discrete.stiffness(_turned(PLATE), ONE),
        r"element 5 with nodes .* is inverted or degenerate",
    ),
    (
        lambda: am.discrete.stiffness(replace(RING, points=RING.points - [0.15, 0.0]), STEEL),
        r"lie at radii x >= 0, got x = -0\.05 m",
    ),
    (
        lambda: am.discrete.stiffness(BOTH[2], {"lower": ONE}),
        r"no material for body 'upper'; .*lower, upper, .*lower",
    ),
    (
        lambda: am.discrete.stiffness(BOTH[2], {"lower": ONE, "upper": STEEL}),
        "either all bodies are Axisymmetric or none, got PlaneStrain, Axisym",
    ),
    (
        lambda: am.discrete.full_stress(
            BOTH[2], {"lower": ONE, "upper": 1.0}, np.zeros(BOTH[2].points.shape)
        ),
        TypeError,
        r"mapping body name -> one of them, got 1\.0",
    ),
    (lambda: am.discrete.von_mises(np.zeros((3, 2, 2))), r"stress must have shape \(n, 3, 3\)"),
    (
        lambda: am.discrete.load_vector(
            BOTH[3], [am.BodyForce((0.0, 0.0, 1.0), body="roof")], ROCK
        ),
        "body 'roof' does not exist; the bodies are lower, upper",
    ),
    (
        lambda: am.discrete.load_vector(BOTH[3], [am.InitialStrain("upper", (1.0, 1.0, 1.0))]),
        "depends on the elastic constants: give material",
    ),
)
