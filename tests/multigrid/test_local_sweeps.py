"""Local sweeps near contact between bodies: exact residuals, falling energy, what is moved and what is not, work."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import corner_pushed
from scipy import sparse

import adaptmg as am
from adaptmg.discrete.discretise import discretise
from adaptmg.mesh import graded, structured
from adaptmg.multigrid import projected_sweeps
from adaptmg.multigrid.projected_sweeps import Interface
from adaptmg.multigrid.split_matrix import split
from adaptmg.multigrid.truncated_contact import TruncatedContact
from adaptmg.smoother.blocks import ZERO
from adaptmg.solver.truncated import TruncatedIteration
from adaptmg.transfer import without_fixed

LAWS = {"frictionless": am.Frictionless(), "tresca": am.Tresca(2e6), "coulomb": am.Coulomb(0.4)}
GAP = 2e-5


def problem(dim, law, gap=GAP, coupling="mortar"):
    """A block on a wider one, meshes that match or (mortar) do not, rollers at x = 0 that end on both surfaces."""
    if dim == 2:
        parts = {"upper": am.Rectangle(width=1.0, height=0.6, origin=(0.0, 0.5)),
                 "lower": am.Rectangle(width=1.5, height=0.5)}
        kind, up, divisions = am.PlaneStrain, "y", {"mortar": ((5, 3), (6, 3)), "nodes": ((4, 2), (6, 2))}
    else:
        parts = {"upper": am.Box(width=1.0, depth=1.0, height=0.6, origin=(0.0, 0.0, 0.5)),
                 "lower": am.Box(width=1.5, depth=1.0, height=0.5)}
        kind, up, divisions = am.Solid, "z", {"mortar": ((3, 2, 2), (4, 3, 2)), "nodes": ((2, 2, 1), (3, 2, 2))}
    domain = am.Assembly(parts=parts)
    posed = am.ContactProblem(
        domain=domain, material=kind(young=1e10, poisson=0.3), law=law,
        contact=am.ContactPair("upper.bottom", "lower.top", gap=gap, coupling=coupling),
        loads=(am.Pressure("upper.top", lambda x: 1e7 * (0.2 + x[:, 0])),),
        supports=(am.Support("upper.left", x=0.0), am.Support("lower.left", x=0.0),
                  am.Support("lower.bottom", **{up: 0.0}), am.Support("lower.right", x=1e-6),
                  *((am.Support(f"{body}.front", y=0.0) for body in parts) if dim == 3 else ())))
    mesh = structured(domain, dict(zip(parts, divisions[coupling], strict=True)))
    return posed, mesh, discretise(posed, mesh)


class Swept:
    """A problem with its halves, obstacle and interface, and a random admissible start."""

    def __init__(self, dim, law, gap=GAP, amplitude=GAP, posed=None):
        self.posed, self.mesh, self.discrete = problem(dim, law, gap) if posed is None else posed
        discrete = self.discrete
        level = split(discrete.matrix, discrete.fixed)
        self.matrix = without_fixed(discrete.matrix, discrete.fixed)
        self.contact = TruncatedContact.of(discrete, level)
        self.interface = Interface(level, discrete.coupling)
        self.inverse = level.inverse
        self.load = np.where(discrete.fixed, 0.0, discrete.load - discrete.matrix @ discrete.fixed_values)
        rng = np.random.default_rng(0)
        self.u = np.where(discrete.fixed, 0.0, amplitude * rng.normal(size=discrete.n_dofs))
        self.contact.start(self.u)
        self.residual = self.load - self.matrix @ self.u
        self.dim = dim

    def sweep(self, order=None):
        projected_sweeps.local(ZERO[self.dim], self.interface.forward if order is None else order,
                               *self.interface.arrays, self.inverse, self.contact.contact_of,
                               *self.contact.node_data, self.u, self.residual)

    def energy(self):
        slip = (self.contact.values.reshape(-1, self.dim)[:, 1:]
                - self.contact.reference.reshape(-1, self.dim - 1))
        return (0.5 * self.u @ self.matrix @ self.u - self.load @ self.u
                + self.contact.limit @ np.linalg.norm(slip, axis=1))

    def local(self):
        frames = self.contact.frames.reshape(-1, self.dim, self.dim)
        return np.einsum("nij,nj->ni", frames, self.u.reshape(-1, self.dim)[self.contact.nodes])


def in_a_row(law):
    """A node of the cap follows the corner of the block, which follows the seat."""
    posed = corner_pushed(law)
    posed = replace(posed, contact=tuple(replace(pair, gap=GAP) for pair in posed.contact))
    mesh = graded(posed.domain, 0.4, posed.pair_boundaries, 1.5)
    return posed, mesh, discretise(posed, mesh)


@pytest.mark.parametrize("amplitude", [0.0, 0.3 * GAP, 30 * GAP], ids=["open", "near", "mixed"])
@pytest.mark.parametrize(("kind", "law"), [*((dim, law) for dim in (2, 3) for law in LAWS), ("row", "frictionless"),
                                           ("row", "tresca")])
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
        np.testing.assert_allclose(at.contact.values.reshape(-1, dim), at.local(),
                                   atol=length * max(GAP, np.abs(at.u).max()))
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
        slope = coupling.relative(direction)[:, ~held[node]].T @ np.where(at.discrete.fixed, 0.0, at.residual)
        assert np.abs(slope).max(initial=0.0) <= 1e-9 * np.abs(at.load).max()
        assert at.energy() <= energy + 1e-13 * abs(energy)


def test_work_units_by_hand(monkeypatch):
    monkeypatch.setattr(TruncatedIteration, "MOVES", 0)  # each adds a smoothing
    posed, _, _ = problem(2, am.Coulomb(0.4))
    divisions = [{"upper": (5 * k, 3 * k), "lower": (6 * k, 3 * k)} for k in (1, 2)]
    grids = am.Hierarchy.uniform(posed, divisions)
    matrix, weights = grids.finest.matrix, grids.finest.discrete.coupling.weights
    # two nodes around the slaves, twice
    pattern = sparse.csr_array((np.ones(len(matrix.indices)), matrix.indices, matrix.indptr))
    swept = pattern @ (pattern @ (np.diff(weights.indptr) > 0).astype(float)) > 0
    share = 2 * np.diff(pattern.indptr)[swept].sum() / len(matrix.indices)
    with_sweeps, without = (am.solve(grids, am.Multigrid(correction=am.Truncated(interface_sweeps=k)))
                            for k in (2, 0))
    smoothings = with_sweeps.cycles + 1
    passes = without.work_units / (without.cycles + 1)
    # safe cycles add half a pass for a line search
    assert with_sweeps.work_units - smoothings * (passes + share) == pytest.approx(0, abs=0.5 * smoothings + 1e-9)
    searches = 2 * (with_sweeps.work_units - smoothings * (1.0 + share))
    assert searches == pytest.approx(round(searches), abs=1e-9) and searches >= 0


