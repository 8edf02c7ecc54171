"""A semismooth Newton method in forty lines of scipy: what a plain script takes for a small plane
problem."""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

import adaptmg as am


def plain_newton(
    problem: am.DiscreteProblem, friction: float, rtol: float = 1e-8, most: int = 50
) -> np.ndarray:
    """Solve a problem over a horizontal plane at the contact nodes; returns u (n_nodes, 2). It
    checks nothing."""
    tangential = 2 * problem.contact.nodes
    normal, gap = tangential + 1, problem.contact.gaps
    held = problem.fixed[tangential]
    at_contact = np.zeros(problem.n_dofs, dtype=bool)
    at_contact[np.r_[normal, tangential]] = True
    inside, contact = np.flatnonzero(~at_contact & ~problem.fixed), np.r_[normal, tangential]
    A, n = sparse.csc_array(problem.matrix), len(normal)
    factors, coupling = splu(A[inside][:, inside]), A[inside][:, contact]
    S = A[contact][:, contact].toarray() - coupling.T @ factors.solve(coupling.toarray())
    load = problem.load[contact] - coupling.T @ factors.solve(problem.load[inside])
    stiff = 0.1 * S.diagonal()
    w, before = np.zeros(2 * n), None
    for step in range(most):
        # forces on the body: up, against the plane below, is -q at normals
        q = load - S @ w
        pressure = -q[:n] + stiff[:n] * (-w[:n] - gap)
        trial = q[n:] + stiff[n:] * w[n:]
        active = (pressure > 0) | (step == 0)
        stick = (
            active & ((np.abs(trial) <= friction * np.maximum(pressure, 0)) | (step == 0)) | held
        )
        slip = active & ~stick
        sign = np.sign(trial)
        J, rhs = S.copy(), q.copy()
        J[n:][slip] += (friction * sign[:, None] * S[:n])[slip]
        rhs[n:][slip] = (q[n:] + friction * sign * q[:n])[slip]
        prescribed = np.r_[active, stick]
        J[prescribed] = np.eye(2 * n)[prescribed]
        rhs[prescribed] = np.r_[-gap - w[:n], -w[n:]][prescribed]
        change = np.linalg.solve(J, rhs)
        w += change
        status = np.r_[active, stick, sign[slip]].tobytes()
        if status == before and np.linalg.norm(change) <= rtol * np.linalg.norm(w):
            break
        before = status
    u = np.zeros(problem.n_dofs)
    u[contact], u[inside] = w, factors.solve(problem.load[inside] - coupling @ w)
    return u.reshape(-1, 2)
