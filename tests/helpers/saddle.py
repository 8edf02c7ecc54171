"""Contact of several bodies by multipliers on the untransformed system: shares nothing with the solvers."""

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

import adaptmg as am
from adaptmg.discrete.elasticity import stiffness
from adaptmg.discrete.facets import fixed_dofs
from adaptmg.discrete.loads import load_vector


@dataclass
class Parts:
    """The untransformed system of a problem on a mesh."""

    matrix: sparse.csr_array
    load: np.ndarray
    fixed: np.ndarray
    fixed_values: np.ndarray
    contact: object
    weights: sparse.csr_array
    law: object
    axisymmetric: bool

    @classmethod
    def of(cls, problem, mesh, slip_reference=None):
        discrete = am.discretise(problem, mesh, slip_reference=slip_reference)
        posed, n = discrete.exchange, mesh.n_nodes
        contact = discrete.contact if posed is None else posed.contact
        weights = sparse.csr_array((n, n))
        if discrete.coupling is not None:
            rows = discrete.coupling.weights[contact.nodes] if posed is None else posed.weights
            place = sparse.csr_array((np.ones(len(contact)), (contact.nodes, np.arange(len(contact)))),
                                     shape=(n, len(contact)))
            weights = sparse.csr_array(place @ rows)
        return cls(sparse.csr_array(stiffness(mesh, problem.material)),
                   load_vector(mesh, problem.loads, problem.material), *fixed_dofs(mesh, problem.supports), contact,
                   weights, problem.law.at_nodes(mesh.points[contact.nodes], contact.weights), problem.axisymmetric)


def tangents(normals):
    """(n, dim - 1, dim): any orthonormal ones, along the axes where they can be."""
    if normals.shape[1] == 2:
        return np.stack([-normals[:, 1], normals[:, 0]], axis=1)[:, None]
    result = np.empty((len(normals), 2, 3))
    for i, n in enumerate(normals):
        axis = np.eye(3)[np.argmin(np.abs(n))]
        first = axis - (axis @ n) * n
        result[i, 0] = first / np.linalg.norm(first)
        result[i, 1] = np.cross(n, result[i, 0])
    return result


def relative_rows(parts, directions, rows):
    """Rows (len(rows), n_dofs) that give the displacement of slaves relative to masters along ``directions``."""
    dim, n_nodes = directions.shape[1], parts.weights.shape[0]
    nodes = parts.contact.nodes[rows]
    difference = sparse.csr_array(sparse.eye_array(n_nodes, format="csr") - parts.weights)[nodes]
    at = np.repeat(np.arange(len(rows)), np.diff(difference.indptr))
    entries = [(at, dim * difference.indices + d, difference.data * directions[at, d]) for d in range(dim)]
    row, column, value = (np.concatenate(part) for part in zip(*entries, strict=True))
    return sparse.csr_array((value, (row, column)), shape=(len(rows), dim * n_nodes))


def held_alike(parts):
    """(n, dim): fixed components of contact nodes that face fixed ones, or an obstacle."""
    nodes, dim = parts.contact.nodes, parts.contact.dim
    fixed = parts.fixed.reshape(-1, dim)
    alike = parts.weights[nodes].maximum(0.0) @ fixed.astype(float)
    return fixed[nodes] & ((alike > 1e-6) | (np.diff(parts.weights.indptr)[nodes] == 0)[:, None])


def solve_saddle(parts, steps=80):
    """Displacement (n_nodes, dim), and the forces on the slaves, normal p >= 0 (n,) and Cartesian (n, dim)."""
    contact = parts.contact
    n, dim = contact.normals.shape
    limit, friction = parts.law.bounds(n)
    t = tangents(contact.normals)
    # tangents along fixed components carry no force where what they face is held likewise, or nothing
    held = held_alike(parts)
    loose = np.array([[not held[i][np.abs(e) > 1e-8].any() for e in t[i]] for i in range(n)])
    every = np.arange(n)
    Cn = relative_rows(parts, contact.normals, every)
    Ct = [relative_rows(parts, t[:, k], every) for k in range(dim - 1)]
    reference = np.einsum("nkd,nd->nk", t, contact.slip_reference)
    scale = parts.matrix.diagonal().max()
    limit = limit / scale
    free = np.flatnonzero(~parts.fixed)
    A = parts.matrix[free][:, free] / scale
    b = (parts.load - parts.matrix @ parts.fixed_values)[free] / scale
    C = sparse.vstack([Cn, *Ct], format="csr")
    lifted = C @ parts.fixed_values
    C = C[:, free]
    u, f = np.zeros(len(free)), np.zeros((dim, n))
    f[0] = -1e-3 * np.abs(b).max()
    c, seen = 0.3, set()
    for step in range(steps):
        w = (C @ u + lifted).reshape(dim, n)
        closed = (f[0] - c * (w[0] - contact.gaps) < 0) | (step == 0)
        p = np.maximum(-f[0], 0) if step else np.zeros(n)
        radius = limit + friction * p
        slip = w[1:] - reference.T
        moved = f[1:] - c * slip
        size = np.linalg.norm(moved, axis=0)
        slides = (size > radius) & (step > 0)
        direction = moved / np.where(size > 0, size, 1)
        # rows: d/du (through w) and d/df, right-hand side for the new values of (u, f)
        on_w, on_f, right = np.zeros((dim, dim, n)), np.zeros((dim, dim, n)), np.zeros((dim, n))
        on_w[0, 0], right[0] = closed, closed * contact.gaps
        on_f[0, 0] = ~closed
        for k in range(1, dim):
            on_w[k, k], on_f[k, k], right[k] = 1.0, 0.0, reference[:, k - 1]
        for i in np.flatnonzero(slides | (radius <= 0) & (step > 0) | ~loose.all(axis=1)):
            on_w[1:, 1:, i] = 0.0
            on_f[1:, 1:, i] = np.eye(dim - 1)
            right[1:, i] = 0.0
            if not loose[i].all():
                if not loose[i].any():
                    continue
                k = np.flatnonzero(loose[i])[0]  # one tangent is left
                value = moved[k, i]
                if step == 0 or abs(value) <= radius[i]:
                    on_w[1 + k, 1 + k, i], on_f[1 + k, 1 + k, i] = 1.0, 0.0
                    right[1 + k, i] = reference[i, k]
                else:
                    on_f[1 + k, 0, i] = np.sign(value) * friction[i] * (p[i] > 0)
                    right[1 + k, i] = np.sign(value) * limit[i]
                continue
            if not slides[i]:
                continue
            e, slope = direction[:, i], friction[i] * (p[i] > 0)
            shrink = radius[i] / size[i] * (np.eye(dim - 1) - np.outer(e, e))
            # f = radius e; linearised in f_t - c slip and in p = -f_n
            on_f[1:, 1:, i] -= shrink
            on_w[1:, 1:, i] = c * shrink
            on_f[1:, 0, i] = slope * e
            right[1:, i] = limit[i] * e + c * shrink @ reference[i]
        W = sparse.block_array([[sparse.diags_array(on_w[r, s]) for s in range(dim)] for r in range(dim)])
        F = sparse.block_array([[sparse.diags_array(on_f[r, s]) for s in range(dim)] for r in range(dim)])
        K = sparse.csc_array(sparse.block_array([[A, -C.T], [W @ C, F]]))
        rhs = np.concatenate([b, right.ravel() - W @ lifted])
        factors = splu(K)
        x = factors.solve(rhs)
        for _ in range(2):
            x += factors.solve(rhs - K @ x)
        change = np.abs(x[:len(u)] - u).max()
        key = closed.tobytes() + slides.tobytes()
        new_u, new_f = x[:len(u)], x[len(u):].reshape(dim, n)
        half = key in seen and change > 1e-10 * np.abs(new_u).max()
        seen.add(key)
        if half:
            u, f, c = 0.5 * (u + new_u), 0.5 * (f + new_f), 0.7 * c
            continue
        u, f = new_u, new_f
        if step and change <= 1e-12 * np.abs(u).max():
            break
    else:
        raise AssertionError("the saddle-point solver did not converge")
    _check(C @ u + lifted, f, contact, limit, friction, reference, loose, np.abs(u).max())
    full = parts.fixed_values.copy()
    full[free] = u
    force = scale * (f[0][:, None] * contact.normals + np.einsum("kn,nkd->nd", f[1:], t))
    return full.reshape(-1, dim), -scale * f[0], force


def _check(w, f, contact, limit, friction, reference, loose, length):
    """The conditions themselves, whatever the method; ``length`` is the size of displacements."""
    w, force = w.reshape(f.shape), np.abs(f).max()
    gap, p = contact.gaps - w[0], -f[0]
    slip, radius = (w[1:] - reference.T) * loose.T, limit + friction * np.maximum(p, 0)
    size = np.linalg.norm(f[1:], axis=0)
    assert gap.min() > -1e-9 * length and p.min() > -1e-9 * force and (np.abs(gap * p) < 1e-9 * length * force).all()
    assert (size <= radius + 1e-9 * force).all()
    moving = np.linalg.norm(slip, axis=0) > 1e-8 * length
    opposite = f[1:] * np.linalg.norm(slip, axis=0) + slip * radius
    assert (np.abs(opposite[:, moving]) < 1e-8 * length * force).all()
