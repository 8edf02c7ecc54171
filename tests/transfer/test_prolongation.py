"""Prolongations on any pair of meshes: sums, affine fields, adjointness, signs, bodies; and of
relative values."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from bisected_meshes import SQUARE, crooked, cube, random_mask, shaken
from bodies import LOWER_ON_UPPER, UPPER_ON_LOWER, bar_on_block, corner_pushed, turned
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from refused import refused
from saddle import Parts
from scipy import sparse
from scipy.spatial import Delaunay
from simplex_meshes import delaunay, disk, log_graded, mesh_of, random_box, structured, two_boxes
from smoother_problems import expand

import adaptmg as am
from adaptmg.geometry.quadrature import simplex_rule
from adaptmg.mesh.bisection import with_refinement
from adaptmg.multigrid.split_matrix import is_galerkin
from adaptmg.transfer.contact import between_levels
from adaptmg.transfer.projections import mass_matrix, mixed_mass

ALL = (am.Interpolation(), am.L2(), am.PseudoL2(), am.LumpedL2(), am.QuasiInterpolation())
AFFINE = (am.Interpolation(), am.L2(), am.PseudoL2(), am.QuasiInterpolation())
EMBEDDING = (am.Interpolation(), am.L2(), am.PseudoL2())

# coarse, fine: meshes of the same box with independent nodes on its sides, nested ones, a fine one
# that is coarser
PAIRS = {
    "2D": (random_box(20, 2, 1), random_box(90, 2, 2)),
    "3D": (random_box(12, 3, 1), random_box(60, 3, 2)),
    "graded": (log_graded(300, 1), log_graded(900, 2)),
    "coarser": (random_box(90, 2, 2), random_box(20, 2, 1)),
    "graded 3D": (structured(3, 3, 3.0), structured(5, 3, 3.0)),
    "nested": (structured(4, 2), structured(8, 2)),
    "nested 3D": (structured(2, 3), structured(4, 3)),
    "bodies": (two_boxes(2, 2), two_boxes(5, 2)),
    "bodies 3D": (two_boxes(1, 3), two_boxes(2, 3)),
    # more pieces of an element than room is set aside for at first
    "hundreds in one": (random_box(2000, 2, 11), structured(1, 2)),
}


def name(transfer):
    return type(transfer).__name__


@pytest.mark.parametrize("transfer", ALL, ids=name)
@pytest.mark.parametrize("pair", PAIRS)
def test_every_transfer_on_every_pair(transfer, pair):
    coarse, fine = PAIRS[pair]
    P = transfer.build(coarse, fine)
    assert isinstance(transfer, am.transfer.Transfer)
    assert (
        P.shape == (fine.n_nodes, coarse.n_nodes) and P.format == "csr" and P.has_canonical_format
    )
    np.testing.assert_allclose(P.sum(axis=1), 1, atol=2e-14)
    assert np.abs(P.data).min() >= am.transfer.CLIP
    if transfer in AFFINE:
        assert np.abs(P @ coarse.points - fine.points).max() < 3e-14
    if transfer in (am.Interpolation(), am.LumpedL2()):
        assert P.data.min() >= 0
    # <r, P v> = <P' r, v>, and a constant force keeps its resultant
    rng = np.random.default_rng(0)
    r, v = rng.standard_normal(fine.n_nodes), rng.standard_normal(coarse.n_nodes)
    assert r @ (P @ v) == pytest.approx((P.T @ r) @ v, rel=1e-12, abs=1e-12)
    assert (P.T @ r).sum() == pytest.approx(r.sum(), abs=1e-11)
    if "bodies" in pair:
        of_rows = np.repeat(np.arange(fine.n_nodes) >= fine.n_nodes // 2, np.diff(P.indptr))
        np.testing.assert_array_equal(P.indices >= coarse.n_nodes // 2, of_rows)
        # the order of the bodies in the mesh does not matter, their names do
        swapped = mesh_of(
            fine.points,
            fine.elements,
            element_body=1 - fine.element_body,
            bodies=("above", "below"),
        )
        assert abs(transfer.build(coarse, swapped) - P).max() == 0


PLATE, BLOCK = (
    am.Rectangle(width=0.3, height=0.2, origin=(0.1, -0.7)),
    am.Box(width=1, depth=2, height=0.7),
)
ON_PLATE = am.Assembly(
    parts={
        "plate": PLATE,
        "below": am.Rectangle(width=1, height=1, origin=(0, -1.7)),
        "side": am.Rectangle(width=1, height=2, origin=(3, 0)),
    }
)


LONGER = replace(PLATE, width=0.31)  # by less than what may lie outside


def assert_interpolated_as_by_search(*meshes):
    # copies do not know how they were made
    known, searched = (
        am.Interpolation().build(*pair) for pair in (meshes, [replace(mesh) for mesh in meshes])
    )
    np.testing.assert_array_equal(known.indptr, searched.indptr)
    np.testing.assert_array_equal(known.indices, searched.indices)
    np.testing.assert_allclose(known.data, searched.data, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("domain", "coarse", "fine"),
    [
        (PLATE, 3, 6),
        ((PLATE, LONGER), 3, 6),
        (PLATE, (3, 5), (4, 7)),
        (PLATE, 7, 3),
        (BLOCK, 2, 4),
        (BLOCK, (2, 3, 1), (3, 4, 2)),
        (ON_PLATE, {"plate": 2, "below": 3, "side": 2}, {"plate": 4, "below": 5, "side": 3}),
    ],
)
def test_structured_meshes_are_interpolated_as_by_search(domain, coarse, fine):
    domains = domain if isinstance(domain, tuple) else (domain, domain)
    meshes = [
        am.mesh.structured(own, divisions)
        for own, divisions in zip(domains, (coarse, fine), strict=True)
    ]
    assert_interpolated_as_by_search(*meshes)


def thrice_bisected(mesh):
    meshes = [mesh]
    for seed in range(3):
        mask = random_mask(meshes[-1], 0.3, seed)
        meshes.append(am.mesh.bisect(meshes[-1], mask, passes=seed + 1)[0])
    return meshes


@pytest.mark.parametrize("mesh", [crooked(SQUARE), crooked(cube(2))], ids=["2D", "3D"])
def test_bisected_meshes_are_interpolated_as_by_search(mesh):
    for pair in combinations(thrice_bisected(mesh), 2):
        assert_interpolated_as_by_search(*pair)


def test_meshes_that_are_not_nested_are_searched_although_one_is_bisected():
    mesh = crooked(SQUARE)
    fine = thrice_bisected(mesh)[-1]
    other_diagonals = mesh_of(mesh.points, Delaunay(mesh.points).simplices)
    assert_interpolated_as_by_search(other_diagonals, fine)
    other_nodes, _ = am.mesh.bisect(mesh, random_mask(mesh, 0.2, 8))
    assert_interpolated_as_by_search(other_nodes, fine)
    assert_interpolated_as_by_search(shaken(mesh, 1e-3), fine)
    points = fine.points.copy()
    points[-1] += 1e-3
    moved = with_refinement(replace(fine, points=points), fine.refinement)
    assert_interpolated_as_by_search(mesh, moved)


def test_nodes_at_one_place_are_interpolated_in_their_bodies():
    """Two triangles touch along their longest edges, of which each mesh halves another one."""
    points = np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 1.0], [0.0, 0.0], [2.0, 0.0], [1.0, -1.0]])
    mesh = mesh_of(
        points, [[0, 1, 2], [3, 4, 5]], element_body=np.arange(2), bodies=("upper", "lower")
    )
    pair = [am.mesh.bisect(mesh, mesh.element_body == body, passes=1)[0] for body in range(2)]
    np.testing.assert_array_equal(pair[0].points, pair[1].points)
    assert_interpolated_as_by_search(*pair)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    dim=st.sampled_from([2, 3]),
    transfer=st.sampled_from(AFFINE),
    apart=st.sampled_from([None, 1e-17, 1e-16, 1e-13, 1e-9, 1e-6, 1e-4]),
    moved=st.booleans(),
)
@example(seed=0, dim=2, transfer=am.L2(), apart=1e-6, moved=True)
def test_sums_and_affine_fields_on_any_two_meshes(seed, dim, transfer, apart, moved):
    """Also where fine nodes equal coarse ones up to rounding: their rows have one entry, and no
    extent."""
    rng = np.random.default_rng(seed)
    coarse, fine = (random_box(int(n), dim, seed + k) for k, n in enumerate(rng.integers(1, 40, 2)))
    if apart is not None:
        inner = (coarse.points > 0) & (coarse.points < 1)
        points = np.clip(
            coarse.points + apart * rng.standard_normal(coarse.points.shape) * inner, 0, 1
        )
        if moved:
            corners = points[coarse.elements]
            assume((np.linalg.det(corners[:, 1:] - corners[:, :1]) > 0).all())
            fine = mesh_of(points, coarse.elements)
        else:
            shared = ~inner.any(axis=1) | (rng.random(coarse.n_nodes) < 0.5)
            fine = delaunay(np.concatenate([points[shared], rng.random((20, dim))]))
    P = transfer.build(coarse, fine)
    np.testing.assert_allclose(P.sum(axis=1), 1, atol=1e-12)
    assert np.abs(P @ coarse.points - fine.points).max() < (1e-12 if apart is None else 1e-9)


@pytest.mark.parametrize("transfer", EMBEDDING, ids=name)
@pytest.mark.parametrize(("n", "dim"), [(4, 2), (2, 3)])
def test_nested_meshes_give_the_canonical_embedding(transfer, n, dim):
    coarse, fine = structured(n, dim), structured(2 * n, dim)
    P = transfer.build(coarse, fine).toarray()
    for row, where in zip(P, np.rint(fine.points * 2 * n).astype(int), strict=True):
        # the diagonals all run along (1, .., 1): a node with odd numbers is the middle of floor and
        # ceil
        expected = np.zeros(coarse.n_nodes)
        for end in (where // 2, -(-where // 2)):
            expected[np.argmin(np.abs(coarse.points * n - end).sum(axis=1))] += 0.5
        np.testing.assert_allclose(row, expected, atol=1e-10)
    mesh = random_box(40 if dim == 2 else 20, dim, 4)
    same = transfer.build(mesh, mesh_of(mesh.points, mesh.elements))
    np.testing.assert_allclose(same.toarray(), np.eye(mesh.n_nodes), atol=1e-9)


@pytest.mark.parametrize("pair", ["2D", "3D", "graded", "graded 3D", "hundreds in one"])
def test_coupling_integrals_are_exact(pair):
    """The integral of phi_i phi_j cannot depend on which of the meshes is clipped against the
    other."""
    first, second = PAIRS[pair]
    forth, back = mixed_mass(first, second), mixed_mass(second, first)
    B = forth.assemble(forth.shape_coefficients())
    C = back.assemble(back.shape_coefficients())
    assert abs(B - C.T).max() < 1e-13 * max(second.volumes.max(), first.volumes.max())
    x = np.column_stack([np.ones(first.n_nodes), first.points])
    y = np.column_stack([np.ones(second.n_nodes), second.points])
    dim = first.dim
    moments = np.full((dim + 1, dim + 1), 0.25) + np.eye(dim + 1) / 12
    moments[0] = moments[:, 0] = 0.5
    moments[0, 0] = 1.0
    np.testing.assert_allclose(y.T @ (B @ x), moments, atol=1e-12)
    M = mass_matrix(second)
    np.testing.assert_allclose(M.sum(axis=1), forth.lumped_mass, atol=1e-15)
    assert y[:, 1] @ (M @ y[:, 1]) == pytest.approx(1 / 3, abs=1e-13)
    if "graded" not in pair:
        exact = np.linalg.solve(M.toarray(), B.toarray())
        assert np.abs(am.L2().build(first, second).toarray() - exact).max() < 6e-3


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_simplex_rule_is_exact_for_degree_six(dim):
    shape, weights = simplex_rule(dim, 4)
    assert shape.shape == (4**dim, dim + 1) and shape.min() > 0 and weights.min() > 0
    np.testing.assert_allclose(shape.sum(axis=1), 1, atol=1e-14)
    # the mean of x^a over one barycentric coordinate, which is beta distributed: B(1 + a, dim)/B(1,
    # dim)
    for coordinate in range(dim + 1):
        for a in range(7):
            expected = np.prod([(1 + k) / (1 + dim + k) for k in range(a)])
            assert weights @ shape[:, coordinate] ** a == pytest.approx(expected, abs=1e-14)


def test_nodes_outside():
    """A quarter of the element size is the most: the diagonal of the cells here."""
    coarse, points = structured(2, 2), np.array(structured(3, 2).points)
    far, near = (mesh_of(points * scale, structured(3, 2).elements) for scale in (1.126, 1.124))
    assert am.Interpolation().build(coarse, near)[[15]].toarray()[0, -1] == 1
    for transfer in ALL:
        with pytest.raises(
            ValueError, match=r"fine node 15 at \(1.126, 1.126\) lies 0.178 m outside .* same units"
        ):
            transfer.build(coarse, far)


UNUSED = am.MeshArrays(
    points=[[0, 0], [1, 0], [0, 1], [0.5, 0.5]],
    elements=[[0, 1, 2]],
    facets=np.zeros((0, 2)),
    facet_labels=[],
    boundaries=(),
)


@pytest.mark.parametrize("transfer", ALL, ids=name)
def test_failures_name_the_argument(transfer):
    square = structured(2, 2)
    for coarse, fine, error, message in (
        (square.points, square, TypeError, "coarse must be MeshArrays"),
        (square, structured(2, 3), ValueError, "same dimension, got 2 and 3"),
        (
            square,
            two_boxes(2, 2),
            ValueError,
            "no body 'below', which fine has; its bodies are body",
        ),
        *(
            ((square, UNUSED, ValueError, "fine: node 3 belongs to no element"),)
            * (transfer == am.PseudoL2())
        ),
    ):
        with pytest.raises(error, match=message):
            transfer.build(coarse, fine)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("transfer", ALL, ids=name)
def test_meshes_with_inverted_elements_are_refused(transfer, dim):
    mesh, finer = structured(2, dim), structured(3, dim)
    elements = np.array(mesh.elements)
    elements[3, :2] = elements[3, 1::-1]
    inverted = replace(mesh, elements=elements)
    for pair, which in (((inverted, finer), "coarse"), ((finer, inverted), "fine")):
        with pytest.raises(ValueError, match=f"{which}: element 3 is inverted or degenerate"):
            transfer.build(*pair)


# -- contact rows and relative values -------------------------------------------------------------------------------


def flat(pair, dim=2, angle=0.0):
    """A block on a wider one, fixed below only, on independent meshes."""
    if dim == 2:
        problem = bar_on_block(am.Coulomb(0.3), pair)
        divisions = [{"upper": 3, "lower": (5, 2)}, {"upper": (5, 4), "lower": (7, 5)}]
    else:
        problem = am.ContactProblem(
            material=am.Solid(young=1e11, poisson=0.3),
            law=am.Coulomb(0.3),
            contact=am.ContactPair(*pair),
            domain=am.Assembly(
                parts={
                    "upper": am.Box(width=1.0, depth=1.0, height=1.0),
                    "lower": am.Box(width=1.5, depth=1.25, height=0.5, origin=(0.0, -0.1, -0.5)),
                }
            ),
        )
        divisions = [{"upper": 2, "lower": (3, 2, 1)}, {"upper": (3, 4, 3), "lower": (4, 5, 2)}]
    problem = replace(
        problem, supports=(am.Support("lower.bottom", **dict.fromkeys("xyz"[:dim], 0.0)),)
    )
    meshes = [am.mesh.structured(problem.domain, d) for d in divisions]
    return replace(problem, domain=None), [
        turned(mesh, angle) if angle else mesh for mesh in meshes
    ]


def axisymmetric():
    problem, meshes = flat(UPPER_ON_LOWER)
    shifted = [replace(mesh, points=mesh.points + np.array([0.05, 0.0])) for mesh in meshes]
    return replace(problem, material=am.Axisymmetric(young=1e11, poisson=0.3)), shifted


def corner():
    """Three bodies in a row: what follows the block follows the seat."""
    problem = corner_pushed(am.Coulomb(0.3))
    meshes = [
        am.mesh.graded(problem.domain, h, problem.pair_boundaries, ratio)
        for h, ratio in ((0.5, 1.2), (0.3, 1.5))
    ]
    return replace(
        problem, domain=None, supports=(am.Support("seat.bottom", x=0.0, y=0.0),)
    ), meshes


def one_body():
    problem = am.cases.greco_bar(law=am.Coulomb(0.5))
    return problem, [am.mesh.structured(problem.domain, n) for n in (3, 5)]


CASES = {
    "one body": one_body,
    "upper": lambda: flat(UPPER_ON_LOWER),
    "lower": lambda: flat(LOWER_ON_UPPER),
    "turned": lambda: flat(UPPER_ON_LOWER, angle=0.8),
    "axisymmetric": axisymmetric,
    "corner": corner,
    "upper 3D": lambda: flat(UPPER_ON_LOWER, 3),
    "lower 3D": lambda: flat(LOWER_ON_UPPER, 3),
}


@pytest.fixture(scope="module", params=CASES)
def levels(request):
    problem, meshes = CASES[request.param]()
    return problem, meshes, [am.discretise(problem, mesh) for mesh in meshes]


def affine_of_each_body(mesh):
    """Every body under a different affine field (n_nodes, dim): rigid motions are among them."""
    rng, field = np.random.default_rng(0), np.empty(mesh.points.shape)
    for k in range(len(mesh.bodies)):
        nodes = np.unique(mesh.elements[mesh.element_body == k])
        gradient, shift = rng.normal(size=(mesh.dim, mesh.dim)), rng.normal(size=mesh.dim)
        field[nodes] = mesh.points[nodes] @ gradient + shift
    return field


def nodal_of(problem, meshes, transfer):
    """The prolongation of displacements, with the rows of both surfaces of all pairs along the
    surfaces."""
    coarse, fine = meshes
    nodal, contact = (
        sparse.csr_array(transfer.build(coarse, fine)),
        am.discretise(problem, fine).contact,
    )
    masters = [(name, fine.boundary_nodes(name)) for name in contact.masters if name]
    slaves = [(name, contact.nodes[contact.boundary == k]) for k, name in enumerate(contact.names)]
    for boundary, nodes in (*masters, *slaves):
        rows = am.transfer.surface_interpolation(
            coarse, fine, coarse.boundary_facets(boundary), nodes
        )
        nodal = am.transfer.with_contact_rows(nodal, nodes, rows)
    return nodal


@pytest.mark.parametrize("rows", [True, False], ids=["rows", "plain"])
@pytest.mark.parametrize("transfer", EMBEDDING, ids=name)
def test_fields_between_levels(levels, transfer, rows):
    problem, meshes, (coarse, fine) = levels
    P = between_levels(transfer, *meshes, coarse, fine, rows).prolongation
    assert (P.data != 0).all() and P.has_sorted_indices
    expected = fine.relative(affine_of_each_body(meshes[1]))
    np.testing.assert_allclose(
        P @ coarse.relative(affine_of_each_body(meshes[0])),
        expected,
        atol=1e-11 * np.abs(expected).max(),
    )
    # any field is that of displacements
    nodal = nodal_of(problem, meshes, transfer) if rows else transfer.build(*meshes)
    w = np.random.default_rng(1).normal(size=meshes[0].points.shape)
    expected = nodal @ coarse.physical(w)
    np.testing.assert_allclose(fine.physical(P @ w), expected, atol=1e-11 * np.abs(expected).max())


def test_rigid_motions_and_the_galerkin_matrix(levels):
    problem, meshes, (coarse, fine) = levels
    found = between_levels(am.Interpolation(), *meshes, coarse, fine)
    assert (found.surface is None) == (fine.coupling is None)
    if fine.coupling is None:
        return
    for prolongation in (found.prolongation, found.surface):
        got = prolongation @ coarse.relative(np.ones(meshes[0].points.shape))
        np.testing.assert_allclose(fine.physical(got), 1.0, atol=1e-11)
        assert np.abs(got[fine.contact.nodes]).max() <= 1e-12
    assert abs(fine.matrix - fine.matrix.T).max() == 0 and fine.matrix.has_sorted_indices
    stiffness = sparse.csr_array(Parts.of(problem, meshes[1]).matrix)
    P = expand(nodal_of(problem, meshes, am.Interpolation()), coarse.dim)
    T = np.column_stack([coarse.physical(unit).ravel() for unit in np.eye(coarse.n_dofs)])
    expected = T.T @ (P.T @ stiffness @ P).toarray() @ T
    got = am.transfer.galerkin_product(fine.matrix, found.prolongation).toarray()
    np.testing.assert_allclose(got, expected, atol=1e-12 * np.abs(expected).max())


def test_constraints_of_surface_rows(levels):
    """Weights >= 0 with sums 1 over the coarse contact nodes of the same pair: what the monotone
    correction needs."""
    _, meshes, (coarse, fine) = levels
    found = between_levels(am.L2(), *meshes, coarse, fine)
    above, contact = coarse.contact, fine.contact
    surface = found.prolongation if found.surface is None else found.surface
    rows = surface[contact.nodes]
    assert rows.data.min() >= 0 and np.diff(rows.indptr).max() <= fine.dim
    np.testing.assert_allclose(np.asarray(rows.sum(axis=1)).ravel(), 1.0, atol=1e-13)
    for k in range(len(contact.names)):
        used = np.unique(rows[np.flatnonzero(contact.boundary == k)].indices)
        assert np.isin(used, above.nodes[above.boundary == k]).all()
    assert len(np.unique(rows.indices)) == len(above)
    others = np.setdiff1d(np.arange(fine.n_nodes), contact.nodes)
    assert abs(surface[others] - found.prolongation[others]).max() == 0
    # relative values that are constant on a surface stay so
    w = np.zeros(meshes[0].points.shape)
    w[above.nodes] = 1.0 + above.boundary[:, None]
    np.testing.assert_allclose(
        (surface @ w)[contact.nodes], np.tile(1.0 + contact.boundary[:, None], fine.dim), atol=1e-13
    )
    if fine.coupling is None:
        return
    slaves, on_slaves = (np.flatnonzero(np.diff(p.coupling.weights.indptr)) for p in (fine, coarse))
    for master in fine.contact.masters:
        nodes = np.setdiff1d(meshes[1].boundary_nodes(master), slaves)
        columns = np.setdiff1d(np.unique(found.prolongation[nodes].indices), on_slaves)
        allowed = np.union1d(
            meshes[0].boundary_nodes(master), np.unique(coarse.coupling.weights.indices)
        )
        assert np.isin(columns, allowed).all()


def test_soft_bodies_next_to_stiff_ones_count_in_comparisons():
    coarse, fine = structured(2, 2), structured(4, 2)
    P, stretched = (
        am.Interpolation().build(coarse, fine),
        np.eye(2) + 0.1 * np.random.default_rng(2).random((2, 2)),
    )
    soft = sparse.kron(mass_matrix(fine), sparse.csr_array(stretched))
    stiff = sparse.bsr_array(sparse.block_diag([1e12 * soft, soft]), blocksize=(2, 2))
    both = sparse.csr_array(sparse.block_diag([P, P]))
    product = am.transfer.galerkin_product(stiff, both)
    assert is_galerkin(stiff, both, product)
    wrong = product.copy()
    wrong.data[wrong.indptr[coarse.n_nodes] :] *= 1.001
    assert not is_galerkin(stiff, both, wrong)


# -- along the contact boundary ----------------------------------------------------------------------------------------


def bottom(mesh):
    facets = mesh.facets[(mesh.points[mesh.facets][:, :, -1] == 0).all(axis=1)]
    return facets, np.unique(facets)


def rows_of(facets):
    return am.transfer.surface_interpolation(disk(2), disk(3), facets, np.unique(disk(3).facets))


def replaced(rows, at):
    return am.transfer.with_contact_rows(am.Interpolation().build(disk(2), disk(3)), at, rows)


test_refused = refused(
    *(
        (lambda facets=facets: rows_of(facets), "coarse_boundary_facets must hold nodes of coarse")
        for facets in (disk(2).facets[:0], disk(2).facets + disk(2).n_nodes, disk(2).facets[0])
    ),
    *(
        (
            lambda rows=rows, at=at: replaced(rows, at),
            r"rows must have shape .* distinct fine_nodes",
        )
        for rows, at in (
            (sparse.csr_array((18, 3)), np.unique(disk(3).facets)),
            (sparse.csr_array((2, disk(2).n_nodes)), np.array([0, 0])),
        )
    ),
)


# -- meshes that are locally finer than the next one, which takes nothing from some of their nodes --------------------


def hierarchy(inserted: int) -> am.Hierarchy:
    """4, 8, 16 cells a side; the second mesh is bisected so many times in the middle of a cell, far
    from contact."""
    problem = am.cases.greco_bar(law=am.Coulomb(0.5))
    meshes = [am.mesh.structured(problem.domain, n) for n in (4, 8, 16)]
    for _ in range(inserted):
        centre = meshes[1].points[meshes[1].elements].mean(axis=1)
        near = np.linalg.norm(centre - np.array([20.4e-3, 20.8e-3]), axis=1)
        meshes[1] = am.mesh.bisect(meshes[1], near <= 1.01 * near.min())[0]
    return am.Hierarchy.from_meshes(problem, meshes)


def unseen(grids: am.Hierarchy) -> np.ndarray:
    """Nodes of the second level that the finest takes nothing from."""
    return np.flatnonzero(np.asarray(abs(grids[2].prolongation).sum(axis=0)).ravel() == 0)


@pytest.mark.parametrize("correction", [am.Truncated(), am.Monotone()])
def test_unseen_nodes_cost_no_cycles(correction):
    plain, refined = hierarchy(0), hierarchy(10)
    assert not len(unseen(plain)) and len(unseen(refined)) > 2
    before, after = (
        am.solve(grids, am.FullMultigrid(correction=correction)) for grids in (plain, refined)
    )
    assert after.status is am.Status.CONVERGED
    assert after.cycles <= before.cycles + 3


def test_a_coarsest_mesh_finer_than_the_next_is_solved():
    """Coarse functions that the next level cannot tell apart made the coarsest matrix of the nested
    start singular."""
    grids = am.Hierarchy.graded(am.cases.dovetail(), sizes=(6e-3, 3.6e-3, 2.2e-3), contact_ratio=4)
    result = am.solve(grids, am.FullMultigrid())
    assert result.status is am.Status.CONVERGED and result.cycles <= 14
