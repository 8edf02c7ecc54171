"""Small contact problems for the tests of the smoother, and a solver of them that shares nothing
with it."""

import numpy as np
from scipy import sparse

import adaptmg as am

LAWS = {"frictionless": am.Frictionless(), "tresca": am.Tresca(0.5), "coulomb": am.Coulomb(0.5)}


def spd(rng: np.random.Generator, n: int, condition: float = 30.0) -> np.ndarray:
    """A random symmetric positive definite matrix with eigenvalues in [1, condition]."""
    q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    return (q * np.exp(rng.uniform(0, np.log(condition), n))) @ q.T


def network(
    dim: int, law: str, seed: int = 0, *, fixed_tangent: bool = False
) -> am.smoother.LocalProblem:
    """A 4 x 4 grid of nodes joined by random elastic links; row 0 may touch, row 3 is fixed."""
    rng = np.random.default_rng(seed)
    n = 4
    number = np.arange(n * n).reshape(n, n)
    pairs = np.concatenate(
        [
            np.stack([a.ravel(), b.ravel()], 1)
            for a, b in (
                (number[:, :-1], number[:, 1:]),
                (number[:-1], number[1:]),
                (number[:-1, :-1], number[1:, 1:]),
            )
        ]
    )
    matrix = np.zeros((n * n, dim, n * n, dim))
    for i, j in pairs:
        link = spd(rng, dim, 5.0)
        matrix[i, :, i] += link
        matrix[j, :, j] += link
        matrix[i, :, j] -= link
        matrix[j, :, i] -= link
    fixed = np.zeros((n * n, dim), dtype=bool)
    fixed[number[3]] = True
    normals = rng.normal(size=(n, dim))
    if fixed_tangent:
        normals[0] = np.eye(dim)[0]
        fixed[number[0, 0], -1] = True
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    load = 0.3 * rng.normal(size=(n * n, dim))
    load[number[0]] += 1.2 * normals
    load[number[0, 3]] -= 4.0 * normals[3]
    contact = am.ContactNodes(
        nodes=number[0],
        normals=normals,
        gaps=rng.uniform(0, 0.1, n),
        slip_reference=0.05 * rng.normal(size=(n, dim)),
    )
    return am.smoother.local_system(
        am.DiscreteProblem(
            matrix=sparse.csr_array(matrix.reshape(n * n * dim, -1)),
            load=load.ravel(),
            fixed=fixed.ravel(),
            law=LAWS[law],
            contact=contact,
        )
    )


def dual_solution(problem: am.smoother.LocalProblem, steps: int = 20000) -> np.ndarray:
    """The solution (n_dofs,) by projected steps on the contact forces, with the dense inverse of
    the matrix."""
    system, contact, dim = problem.system, problem.contact, problem.system.dim
    flexibility = np.linalg.inv(system.matrix.toarray())
    dofs = system.nodes[:, None] * dim + np.arange(dim)
    delassus = flexibility[np.ix_(dofs.ravel(), dofs.ravel())]
    free = (flexibility @ problem.load)[dofs]
    # a fixed tangent does not move, but friction along it counts
    held = system.fixed[dofs]
    delassus[held.ravel()], delassus[:, held.ravel()], free[held] = 0.0, 0.0, 0.0
    zero = np.column_stack([contact.gap, contact.slip_reference])
    rate = 1 / np.linalg.eigvalsh(delassus)[-1]
    force = np.zeros_like(free)  # b - A w at contact nodes
    for _ in range(steps):
        step = force + rate * (free - (delassus @ force.ravel()).reshape(free.shape) - zero)
        p = np.maximum(step[:, 0], 0)
        size = np.linalg.norm(step[:, 1:], axis=1)
        bound = contact.limit + contact.friction * p
        scale = np.where(size > bound, bound / np.where(size > 0, size, 1), 1)
        new = np.column_stack([p, step[:, 1:] * scale[:, None]])
        if np.abs(new - force).max() <= 1e-16 * np.abs(new).max():
            break
        force = new
    load = problem.load.copy()
    load[dofs[~held]] -= force[~held]
    return flexibility @ load


def tresca_energy(problem: am.smoother.LocalProblem, w: np.ndarray) -> float:
    """1/2 w'Aw - b'w + sum of limit * |slip|, N m."""
    system, contact = problem.system, problem.contact
    slip = w.reshape(-1, system.dim)[system.nodes, 1:] - contact.slip_reference
    return float(
        0.5 * w @ (system.matrix @ w)
        - problem.load @ w
        + contact.limit @ np.linalg.norm(slip, axis=1)
    )


def expand(P, dim):
    """kron(P, I): from nodes to dofs, component by component."""
    return sparse.csr_array(sparse.kron(P, np.eye(dim)))


class Idle:
    """A linear correction that corrects nothing."""

    def setup(self, matrices, prolongations):
        return self

    def solve(self, rhs):
        return np.zeros_like(rhs)
