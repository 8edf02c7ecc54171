"""The parts of the truncated multigrid against dense algebra, and its local sweeps near contact
between bodies."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from bodies import UPPER_ON_LOWER, corner_pushed, pressed, stacked
from scipy import sparse
from smoother_problems import expand, network

import adaptmg as am
from adaptmg.multigrid import projected_sweeps
from adaptmg.multigrid.linear_cycle import CoarseFactors, least_weights
from adaptmg.multigrid.projected_sweeps import Interface
from adaptmg.multigrid.split_matrix import restrict, split
from adaptmg.multigrid.truncated_contact import TruncatedContact
from adaptmg.multigrid.truncation import Truncation, find_slots
from adaptmg.smoother.blocks import ZERO
from adaptmg.smoother.system import CLOSED, SLIPS


def random_matrix(rng: np.random.Generator, dim: int, n: int = 9) -> sparse.bsr_array:
    """Nonsymmetric, diagonally dominant, blocks of dim."""
    dense = rng.normal(size=(n * dim, n * dim)) * np.kron(
        rng.random((n, n)) < 0.4, np.ones((dim, dim))
    )
    dense += np.diag(np.abs(dense).sum(axis=1) + 1)
    return sparse.bsr_array(dense, blocksize=(dim, dim))


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_the_lower_half_of_a_symmetric_matrix_is_enough(dim):
    rng = np.random.default_rng(dim)
    matrix = random_matrix(rng, dim)
    matrix = sparse.bsr_array(matrix + matrix.T, blocksize=(dim, dim)).sorted_indices()
    fixed = rng.random(matrix.shape[0]) < 0.2
    both, lower = split(matrix, fixed), split(matrix, fixed, symmetric=True)
    assert lower.symmetric and not both.symmetric and lower.nonzeros == both.nonzeros
    assert len(lower.upper) == 0
    free = np.outer(~fixed, ~fixed) | np.diag(fixed)
    for halves in (both, lower):
        np.testing.assert_allclose(halves.matrix().toarray(), np.where(free, matrix.toarray(), 0.0))
        blocks = halves.diagonal.reshape(-1, dim, dim)
        np.testing.assert_allclose(
            halves.inverse.reshape(blocks.shape), np.linalg.inv(blocks), rtol=1e-12
        )


@pytest.mark.parametrize("dim", [1, 2])
def test_slots_are_those_of_the_blocks_that_a_matrix_has(dim):
    matrix = random_matrix(np.random.default_rng(5), dim, 30)
    halves = split(matrix, np.zeros(matrix.shape[0], dtype=bool))
    rows, columns = np.divmod(np.arange(900), 30)
    slots = np.empty(900, dtype=np.int64)
    find_slots(
        rows,
        columns,
        halves.lower_indptr,
        halves.lower_indices,
        halves.upper_indptr,
        halves.upper_indices,
        halves.strips.rank,
        slots,
    )
    blocks = matrix.toarray().reshape(30, dim, 30, dim).transpose(0, 2, 1, 3).reshape(900, -1)
    there = blocks.any(axis=1)
    np.testing.assert_array_equal(slots >= 0, there)
    found = halves.at_slots(slots[there]).reshape(-1, dim**2)
    np.testing.assert_allclose(found, blocks[there], rtol=1e-15)


def test_inverse_blocks_leave_out_vanishing_entries():
    blocks = [[[0, 0], [0, 2]], [[4, 0], [0, 0]], [[1, 1], [1, 1]], [[3, 1], [2, 4]]]
    matrix = sparse.bsr_array(
        (np.array(blocks, dtype=float), np.arange(4), np.arange(5)), shape=(8, 8)
    )
    inverse = split(matrix, np.zeros(8, dtype=bool)).inverse.reshape(-1, 2, 2)
    expected = [
        [[0, 0], [0, 0.5]],
        [[0.25, 0], [0, 0]],
        [[1, 0], [0, 0]],
        np.array([[4, -1], [-2, 3]]) / 10,
    ]
    np.testing.assert_allclose(inverse, expected, atol=1e-14)


def parts(dim: int, law: str):
    """A small contact problem as a split matrix and contact."""
    problem = network(dim, law, 3)
    discrete = problem.discrete
    level = split(discrete.matrix, discrete.fixed, symmetric=True)
    load = np.where(discrete.fixed, 0.0, discrete.load - discrete.matrix @ discrete.fixed_values)
    return problem, level, TruncatedContact.of(discrete, level), load


def smooth(level, contact, load, u):
    residual = load.copy()
    level.sweep(
        projected_sweeps.backward,
        *level.shared_arrays,
        contact.contact_of,
        *contact.node_data,
        u,
        residual,
        backward=True,
    )
    level.sweep(
        projected_sweeps.forward,
        *level.shared_arrays,
        contact.diagonal,
        contact.contact_of,
        *contact.node_data,
        u,
        residual,
    )
    return residual


@pytest.mark.parametrize("dim", [2, 3])
def test_half_of_a_matrix_gives_the_energy_of_a_difference(dim):
    problem, level, *_ = parts(dim, "coulomb")
    u, other = np.random.default_rng(0).normal(size=(2, level.n_dofs)) * ~problem.discrete.fixed
    product = projected_sweeps.energy_product(
        0,
        level.n_nodes,
        level.strips.order,
        ZERO[dim],
        *level.shared_arrays,
        other,
        u,
    )
    assert product == pytest.approx((other - u) @ (level.matrix() @ (other - u)), rel=1e-10)


def swept(dim: int, law: str, sweeps: int):
    """The same after some sweeps from zero, with its contact status, and the iterate."""
    problem, level, contact, load = parts(dim, law)
    u = np.zeros(problem.system.n_dofs)
    contact.start(u)
    for _ in range(sweeps):
        residual = smooth(level, contact, load, u)
    contact.update_status(residual)
    return problem, level, contact, load, u


def newton_matrix(problem, contact, newton: bool) -> np.ndarray:
    """T (S A + H) T in Cartesian components, dense, written down afresh."""
    dim, n = problem.system.dim, problem.system.n_nodes
    frames = contact.frames.reshape(-1, dim, dim)
    F = np.eye(n * dim)
    for k, node in enumerate(contact.nodes):
        F[dim * node : dim * node + dim, dim * node : dim * node + dim] = frames[k]
    A = (
        F
        @ am.transfer.without_fixed(problem.discrete.matrix, problem.discrete.fixed).toarray()
        @ F.T
    )
    J, T = A.copy(), np.ones(n * dim)
    for k, node in enumerate(contact.nodes):
        at, tau = (
            dim * node,
            contact.values.reshape(-1, dim)[k, 1:] - contact.reference.reshape(-1, dim - 1)[k],
        )
        closed, tangential = contact.codes[k] & 1, contact.codes[k] & 6
        if tangential >= 4:
            e = tau / np.linalg.norm(tau)
            if newton and closed:
                J[at + 1 : at + dim] -= contact.friction[k] * np.outer(e, A[at])
            if dim == 3:
                g = contact.limit[k] + closed * contact.friction[k] * contact.pressure[k]
                J[at + 1 : at + 3, at + 1 : at + 3] += (
                    g / np.linalg.norm(tau) * (np.eye(2) - np.outer(e, e))
                )
        if closed:
            T[at] = 0
        if tangential == 2:
            T[at + 1 : at + dim] = 0
    return F.T @ (T[:, None] * J * T) @ F


@pytest.mark.parametrize(("newton", "of_dofs"), [(True, False), (True, True), (False, False)])
@pytest.mark.parametrize("law", ["frictionless", "tresca", "coulomb"])
@pytest.mark.parametrize("dim", [2, 3])
def test_truncated_coarse_matrices(dim, law, newton, of_dofs):
    rng = np.random.default_rng(1)
    problem, level, contact, *_ = swept(dim, law, 3)
    n = problem.system.n_nodes
    assert len(np.unique(contact.codes)) > 1
    P1 = sparse.csr_array(rng.random((n, 8)) * (rng.random((n, 8)) < 0.5) + np.eye(n, 8))
    P2 = sparse.csr_array(rng.random((8, 3)) + 0.1)
    matrix = am.transfer.without_fixed(problem.discrete.matrix, problem.discrete.fixed)
    given = [expand(P1, dim), expand(P2, dim)] if of_dofs else [P1, P2]
    finest = sparse.bsr_array(sparse.csr_array(matrix), blocksize=(1, 1)) if of_dofs else matrix
    middle = am.transfer.galerkin_product(finest, given[0])
    coarsest = am.transfer.galerkin_product(middle, given[1])
    levels = [split(m, np.zeros(m.shape[0], dtype=bool)) for m in (coarsest, middle)] + [level]
    truncation = Truncation(levels, given[::-1], contact)
    contact.linearise_friction()
    truncation.apply(contact, newton=newton)
    J = newton_matrix(problem, contact, newton)
    Q1, Q2 = expand(P1, dim).toarray(), expand(P2, dim).toarray()
    expected = Q1.T @ J @ Q1
    np.testing.assert_allclose(levels[1].matrix().toarray(), expected, atol=1e-10)
    np.testing.assert_allclose(levels[0].matrix().toarray(), Q2.T @ expected @ Q2, atol=1e-9)
    if not newton:
        np.testing.assert_allclose(expected, expected.T, atol=1e-12)
    blocks = levels[1].diagonal.reshape(-1, levels[1].dim, levels[1].dim)
    np.testing.assert_allclose(
        levels[1].inverse.reshape(blocks.shape), np.linalg.inv(blocks), rtol=1e-6, atol=1e-10
    )
    truncation.restore()
    np.testing.assert_allclose(levels[1].matrix().toarray(), middle.toarray(), atol=1e-12)
    np.testing.assert_allclose(levels[0].matrix().toarray(), coarsest.toarray(), atol=1e-12)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_restriction_returns_the_square_of_what_it_restricts(dim):
    rng = np.random.default_rng(dim)
    P, r, coarse = rng.random((12, 5)), rng.normal(size=12 * dim), np.zeros(5 * dim)
    stored = sparse.csr_array(P)
    assert restrict(
        0, 12, ZERO[dim], stored.indptr, stored.indices, stored.data, r, coarse
    ) == pytest.approx(r @ r)
    np.testing.assert_allclose(coarse, expand(P, dim).T @ r)


@pytest.mark.parametrize("n", [40, 1600], ids=["dense", "sparse"])
@pytest.mark.parametrize("scale", [1e-10, 1.0, 1e10])
def test_singular_coarsest_dofs_alone_are_shifted(scale, n):
    singular = sparse.eye_array(n, format="lil")
    singular[:3, :3] = [[1.0, -1.0, 0.0], [-1.0, 1.0 + 1e-15, 0.0], [0.0, 0.0, 0.0]]
    rhs = np.r_[1.0, -1.0, 0.0, np.arange(n - 3.0)]
    result = np.empty(n)
    for matrix, tolerance in ((singular, 1e-5), (singular + sparse.eye_array(n), 1e-13)):
        matrix = sparse.bsr_array(matrix.tocsr(), blocksize=(2, 2))
        coarse = CoarseFactors(split(scale * matrix, np.zeros(n, dtype=bool)))
        for _ in range(2):
            coarse.renew()
            coarse.solve(scale * rhs, result)
            np.testing.assert_allclose(matrix @ result, rhs, atol=tolerance, rtol=1e-12)


def test_weights_of_past_iterates_are_those_of_least_squares():
    rng, d = np.random.default_rng(0), np.tile([0.5, 2.0], 20)
    for k in range(1, 5):
        changes, now = rng.normal(size=(k, 40)) * 1e-3 ** np.arange(k)[:, None], rng.normal(size=40)
        expected = np.linalg.lstsq((np.sqrt(d) * changes).T, -np.sqrt(d) * now)[0]
        alpha = least_weights(changes * d @ changes.T, -(changes * d) @ now)
        np.testing.assert_allclose(alpha, expected, rtol=1e-9)
        # what depends on the others, whatever its size, changes nothing
        more = np.stack([*changes, 1e-9 * changes[0]])
        again = least_weights(more * d @ more.T, -(more * d) @ now)
        np.testing.assert_allclose(
            again[:k] @ changes + 1e-9 * again[k] * changes[0], alpha @ changes, rtol=1e-6
        )


def test_a_recombination_cuts_one_node_and_not_many():
    """The gap is 1; slips of .5 at all nodes, of which the closed ones are at the gap."""
    problem = am.Hierarchy.uniform(am.cases.greco_bar(law=am.Tresca(1.0)), (4, 8)).finest.discrete
    problem = replace(problem, contact=replace(problem.contact, gaps=np.ones(len(problem.contact))))
    contact, nodes = (
        TruncatedContact.of(problem, split(problem.matrix, problem.fixed)),
        problem.contact.nodes,
    )
    for closed, moved, number in itertools.product(
        (False, True), ((-0.5, 0.0), (0.1, 1.1), (0.1, 0.9)), range(4)
    ):
        contact.codes[:] = SLIPS + CLOSED * closed
        local = np.tile([1.0 if closed else 0.0, 0.5], (len(nodes), 1))
        contact.values[:] = local.reshape(-1)
        local[:number] = moved[1], moved[0]
        u = np.zeros((problem.n_nodes, 2))
        u[nodes] = np.einsum("nji,nj->ni", contact.frames.reshape(-1, 2, 2), local)
        cut = number * (moved[0] < 0 or (moved[1] > 1 and not closed))
        assert contact.admits(u.reshape(-1)) is (cut <= 1), (closed, moved, number)


LAWS = {"frictionless": am.Frictionless(), "tresca": am.Tresca(2e6), "coulomb": am.Coulomb(0.4)}
GAP = 2e-5


def problem(dim, law, gap=GAP, coupling="mortar"):
    """Stacked blocks, meshes that match or (mortar) do not, rollers at x = 0 that end on both
    surfaces."""
    material = (am.PlaneStrain if dim == 2 else am.Solid)(young=1e10, poisson=0.3)
    if coupling == "nodes":
        divisions = ((6, 2), (4, 2)) if dim == 2 else ((2, 2, 2), (2, 2, 1))
    else:
        divisions = ((6, 3), (5, 3)) if dim == 2 else ((4, 3, 2), (3, 2, 2))
    mesh = stacked(divisions, width=2 / 3)
    posed = pressed(mesh, [UPPER_ON_LOWER], (material, material), law)
    posed = replace(
        posed,
        contact=am.ContactPair(*UPPER_ON_LOWER, gap=gap, coupling=coupling),
        loads=(am.Pressure("upper.top", lambda x: 1e7 * (0.2 + x[:, 0])),),
        supports=(*posed.supports, am.Support("lower.right", x=1e-6)),
    )
    return posed, mesh, am.discretise(posed, mesh)


class Swept:
    """A problem with its halves, obstacle and interface, and a random admissible start."""

    def __init__(self, dim, law, gap=GAP, amplitude=GAP, posed=None):
        self.posed, self.mesh, self.discrete = problem(dim, law, gap) if posed is None else posed
        discrete = self.discrete
        level = split(discrete.matrix, discrete.fixed)
        self.matrix = am.transfer.without_fixed(discrete.matrix, discrete.fixed)
        self.contact = TruncatedContact.of(discrete, level)
        self.interface = Interface(level, discrete.coupling, discrete.fixed)
        self.inverse = level.inverse
        self.load = np.where(
            discrete.fixed, 0.0, discrete.load - discrete.matrix @ discrete.fixed_values
        )
        rng = np.random.default_rng(0)
        self.u = np.where(discrete.fixed, 0.0, amplitude * rng.normal(size=discrete.n_dofs))
        self.contact.start(self.u)
        self.residual = self.load - self.matrix @ self.u
        self.dim = dim

    def sweep(self, order=None):
        projected_sweeps.local(
            ZERO[self.dim],
            self.interface.forward if order is None else order,
            *self.interface.arrays,
            self.inverse,
            self.contact.contact_of,
            *self.contact.node_data,
            self.u,
            self.residual,
        )

    def energy(self):
        slip = self.contact.values.reshape(-1, self.dim)[:, 1:] - self.contact.reference.reshape(
            -1, self.dim - 1
        )
        return (
            0.5 * self.u @ self.matrix @ self.u
            - self.load @ self.u
            + self.contact.limit @ np.linalg.norm(slip, axis=1)
        )

    def local(self):
        frames = self.contact.frames.reshape(-1, self.dim, self.dim)
        return np.einsum("nij,nj->ni", frames, self.u.reshape(-1, self.dim)[self.contact.nodes])


def in_a_row(law):
    """A node of the cap follows the corner of the block, which follows the seat."""
    posed = corner_pushed(law)
    posed = replace(posed, contact=tuple(replace(pair, gap=GAP) for pair in posed.contact))
    mesh = am.mesh.graded(posed.domain, 0.4, posed.pair_boundaries, 1.5)
    return posed, mesh, am.discretise(posed, mesh)


@pytest.mark.parametrize("amplitude", [0.0, 0.3 * GAP, 30 * GAP], ids=["open", "near", "mixed"])
@pytest.mark.parametrize(
    ("kind", "law"),
    [*((dim, law) for dim in (2, 3) for law in LAWS), ("row", "frictionless"), ("row", "tresca")],
)
def test_sweeps(kind, law, amplitude):
    row, dim = kind == "row", 2 if kind == "row" else kind
    at = Swept(dim, LAWS[law], amplitude=amplitude, posed=in_a_row(LAWS[law]) if row else None)
    weights = at.discrete.coupling.weights
    assert not row or (weights @ weights).nnz
    size = np.abs(at.residual).max()
    energy, first = [at.energy()], at.u.copy()
    for k in range(6):
        at.sweep(at.interface.backward if k % 2 else at.interface.forward)
        energy.append(at.energy())
        size = max(size, np.abs(at.residual).max())
        tight, length = (1e-11, 1e-12) if row else (1e-12 * len(energy), 1e-14 * len(energy))
        np.testing.assert_allclose(at.residual, at.load - at.matrix @ at.u, atol=tight * size)
        np.testing.assert_allclose(
            at.contact.values.reshape(-1, dim),
            at.local(),
            atol=length * max(GAP, np.abs(at.u).max()),
        )
        assert (at.contact.values[::dim] <= at.contact.gap).all()
        np.testing.assert_array_equal(at.u[at.discrete.fixed], first[at.discrete.fixed])
    assert np.abs(at.u - first).max() > 0
    outside = np.setdiff1d(np.arange(at.discrete.n_nodes), at.interface.nodes)
    np.testing.assert_array_equal(at.u.reshape(-1, dim)[outside], first.reshape(-1, dim)[outside])
    if law != "coulomb":
        assert (np.diff(energy) <= 1e-13 * np.abs(energy[0])).all() and energy[-1] < energy[0]


@pytest.mark.parametrize("dim", [2, 3])
def test_a_master_before_open_slaves_is_moved_alone(dim):
    at = Swept(dim, am.Coulomb(0.4), amplitude=1e-3 * GAP)
    coupling, held = at.discrete.coupling, at.discrete.fixed.reshape(-1, dim)
    for node in np.unique(coupling.weights.indices):
        before, energy = at.u.copy(), at.energy()
        at.sweep(np.array([np.searchsorted(at.interface.nodes, node)], dtype=np.int32))
        change = coupling.physical(at.u - before).reshape(-1, dim)
        others = np.setdiff1d(np.arange(at.discrete.n_nodes), node)
        assert np.abs(change[others]).max() <= 1e-15 * GAP + 1e-12 * np.abs(change[node]).max()
        assert not change[node][held[node]].any()
        # to the least energy there is for it
        direction = np.zeros((at.discrete.n_dofs, dim))
        direction[dim * node + np.arange(dim), np.arange(dim)] = 1.0
        slope = coupling.relative(direction)[:, ~held[node]].T @ np.where(
            at.discrete.fixed, 0.0, at.residual
        )
        assert np.abs(slope).max(initial=0.0) <= 1e-9 * np.abs(at.load).max()
        assert at.energy() <= energy + 1e-13 * abs(energy)


@pytest.mark.parametrize(
    ("law", "gap"),
    [(am.Frictionless(), 0.0), (am.Tresca(1e6), 0.0), (am.Tresca(1e6), 1.0)],
    ids=["frictionless", "tresca", "tresca before it closes"],
)
@pytest.mark.parametrize("coupling", ["mortar", "nodes"])
@pytest.mark.parametrize("dim", [2, 3])
def test_a_master_before_closed_slaves_takes_them_along(dim, coupling, law, gap):
    at = Swept(dim, law, amplitude=0.0, posed=problem(dim, law, gap, coupling))
    at.load[:] = np.where(
        at.discrete.fixed, 0.0, np.random.default_rng(4).normal(size=len(at.load))
    )
    at.residual[:] = at.load
    weights = at.discrete.coupling.weights
    for node in np.unique(weights.indices):
        before = at.u.copy()
        at.sweep(np.array([np.searchsorted(at.interface.nodes, node)], dtype=np.int32))
        change = (at.u - before).reshape(-1, dim)
        assert np.flatnonzero(change.any(axis=1)).tolist() == [node]
        followers = np.flatnonzero(weights[:, [node]].toarray())
        physical = at.discrete.coupling.physical(at.u - before).reshape(-1, dim)
        free = ~at.discrete.fixed.reshape(-1, dim)[followers]
        expected = free * weights[followers][:, [node]].toarray() * change[node]
        np.testing.assert_allclose(physical[followers], expected, atol=1e-15 * np.abs(change).max())


def test_work_units_by_hand():
    posed, *_ = problem(2, am.Coulomb(0.4))
    meshes = [stacked(((6 * k, 3 * k), (5 * k, 3 * k)), width=2 / 3) for k in (1, 2)]
    grids = am.Hierarchy.from_meshes(posed, meshes)
    matrix, weights = grids.finest.matrix, grids.finest.discrete.coupling.weights
    # two nodes around the slaves, twice
    pattern = sparse.csr_array((np.ones(len(matrix.indices)), matrix.indices, matrix.indptr))
    swept = pattern @ (pattern @ (np.diff(weights.indptr) > 0).astype(float)) > 0
    share = 2 * np.diff(pattern.indptr)[swept].sum() / len(matrix.indices)
    # a coarse contact problem adds a smoothing
    swept, plain = (am.Truncated(coarse_contact=False, interface_sweeps=k) for k in (2, 0))
    with_sweeps = am.solve(grids, am.Multigrid(correction=swept))
    without = am.solve(grids, am.Multigrid(correction=plain))
    smoothings = with_sweeps.cycles + 1
    passes = without.work_units / (without.cycles + 1)
    # safe cycles add half a pass for a line search
    assert with_sweeps.work_units - smoothings * (passes + share) == pytest.approx(
        0, abs=0.5 * smoothings + 1e-9
    )
    searches = 2 * (with_sweeps.work_units - smoothings * (1.0 + share))
    assert searches == pytest.approx(round(searches), abs=1e-9) and searches >= 0
