"""Rigid motions that contact alone holds: to the least energy, exactly, and nothing else changes."""

from dataclasses import replace

import numpy as np
import pytest

import adaptmg as am
from adaptmg.multigrid.rigid_motions import RigidMotions, null_combinations
from adaptmg.multigrid.split_matrix import split
from adaptmg.multigrid.truncated_contact import TruncatedContact

LOADS = (am.Pressure("top", 5e7), am.Pressure("left", 1.6e8), am.Pressure("right", 1.5e8))


def discrete(dim, law=None, **changes):
    case = am.cases.greco_bar() if dim == 2 else am.cases.greco_block()
    law = am.Tresca(4e7) if law is None else law
    problem = replace(case, **({"supports": (), "law": law, "loads": LOADS, "reference": {}} | changes))
    return am.Hierarchy.uniform(problem, divisions=(6 if dim == 2 else 3,)).finest.discrete


class Body:
    """A body near its obstacle with random displacements, motions settled once."""

    def __init__(self, problem, seed=0, opening=0.0):
        rng = np.random.default_rng(seed)
        self.problem, self.contact = problem, TruncatedContact.of(problem, split(problem.matrix, problem.fixed))
        self.unknowns = 1e-6 * rng.standard_normal(problem.n_dofs)
        self.unknowns[problem.dim * problem.contact.nodes + problem.dim - 1] = opening * rng.random(
            len(problem.contact.nodes))
        self.unknowns[problem.fixed] = 0.0
        self.contact.start(self.unknowns)
        self.before, self.past = self.unknowns.copy(), [rng.standard_normal(problem.n_dofs)]
        self.first = self.past[0].copy()
        self.motions = RigidMotions.of(problem, self.contact, problem.load)

    def settle(self):
        residual = self.problem.load - self.problem.matrix @ self.unknowns
        return self.motions.settle(self.unknowns, self.past, residual)

    def energy(self, unknowns):
        """Tresca energy without u'Au; infinite where a node penetrates."""
        problem, dim = self.problem, self.problem.dim
        local = np.einsum("nij,nj->ni", self.contact.frames.reshape(-1, dim, dim),
                          unknowns.reshape(-1, dim)[problem.contact.nodes])
        if (local[:, 0] > self.contact.gap + 1e-18).any():
            return np.inf
        return float(self.contact.limit @ np.linalg.norm(local[:, 1:], axis=1) - problem.load @ unknowns)


@pytest.mark.parametrize("opening", [0.0, 1e-6])
@pytest.mark.parametrize("dim", [2, 3])
def test_no_rigid_motion_lowers_the_energy_further(dim, opening, seed=1):
    body = Body(discrete(dim), seed, opening)
    assert body.settle() > 0
    least, moved = body.energy(body.unknowns), body.unknowns - body.before
    assert least <= body.energy(body.before)
    modes, rng = body.problem.near_nullspace, np.random.default_rng(seed)
    # the step itself is rigid: A m = 0, so that no residual changes
    coefficients, *_ = np.linalg.lstsq(modes, moved, rcond=None)
    assert np.abs(modes @ coefficients - moved).max() < 1e-9 * np.abs(moved).max()
    assert np.allclose(body.past[0] - body.first, moved, atol=1e-9 * np.abs(moved).max())
    span = np.abs(moved).max() + 1e-6
    others = [least]
    for _ in range(300):
        mode = modes @ (rng.standard_normal(modes.shape[1]) / np.abs(modes).max(axis=0))
        others += [body.energy(body.unknowns + 10.0 ** rng.uniform(-6, 1) * span * sign * mode) for sign in (1, -1)]
    # in 3D the gradient is small only
    work = np.abs(modes.T @ body.problem.load / np.abs(modes).max(axis=0)).max()
    assert least <= min(others) + (1e-12 if dim == 2 else 2e-2) * work * 10 * span


@pytest.mark.parametrize("dim", [2, 3])
def test_friction_that_cannot_hold_yet_moves_nothing_far(dim):
    body = Body(discrete(dim, am.Coulomb(1e-3)))
    assert body.settle() > 0
    # in 2D a node holds the body all the same
    assert dim == 3 or (body.contact.values[1::2] == 0.0).any()
    assert np.abs(body.unknowns).max() < 1e2 * np.abs(body.before).max()


def test_motions_that_strain_the_body_are_given_up():
    problem = discrete(2)
    body = Body(replace(problem, near_nullspace=problem.near_nullspace * np.linspace(1, 2, problem.n_dofs)[:, None]))
    assert body.settle() == 0 and (body.unknowns == body.before).all()


def test_supports_leave_none():
    problem = discrete(2, supports=(am.Support("top", x=0.0, y=0.0),), loads=LOADS[1:])
    obstacle = TruncatedContact.of(problem, split(problem.matrix, problem.fixed))
    assert RigidMotions.of(problem, obstacle, problem.load) is None
    assert RigidMotions.of(replace(problem, near_nullspace=None, coordinates=None), obstacle, problem.load) is None


def test_null_combinations_do_not_depend_on_units():
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((5, 4)) @ np.diag([1e-6, 1.0, 1e6, 1e3])
    assert null_combinations(rows).shape == (4, 0)
    found = null_combinations(rows[:3])
    assert found.shape == (4, 1) and np.abs(rows[:3] @ found).max() < 1e-12 * np.abs(rows[:3] * found.T).max()
    assert null_combinations(np.zeros((0, 4))).shape == (4, 4)
