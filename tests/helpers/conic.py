"""Contact problems solved by clarabel, an interior point method for conic programmes: shares no
code with adaptmg."""

import clarabel
import numpy as np
from scipy import sparse


class Conic:
    """A DiscreteProblem (in relative coordinates if between bodies), unknowns and forces made
    dimensionless."""

    def __init__(self, problem):
        self.problem, contact, dim = problem, problem.contact, problem.dim
        self.free = np.flatnonzero(~problem.fixed)
        matrix = sparse.csr_array(problem.matrix)
        self.held = problem.fixed_values
        load = (problem.load - matrix @ self.held)[self.free]
        self.stiffness = np.abs(matrix.diagonal()).max()
        self.force = np.abs(load).max()
        self.length = self.force / self.stiffness * problem.n_nodes ** (1 / dim)
        self.matrix, self.load = sparse.csc_array(matrix[self.free][:, self.free]), load
        n = len(contact)
        # normal displacement and slip at contact nodes, as rows over all dofs; slip in an
        # orthonormal basis by QR
        tangents = np.array(
            [
                np.linalg.qr(np.column_stack([normal, np.eye(dim)]))[0][:, 1:].T
                for normal in contact.normals
            ]
        )
        dofs = dim * contact.nodes[:, None] + np.arange(dim)
        shape = (n, problem.n_dofs)
        rows = np.repeat(np.arange(n), dim)
        self.normal = sparse.csr_array((contact.normals.ravel(), (rows, dofs.ravel())), shape=shape)
        self.tangent = [
            sparse.csr_array((tangents[:, k].ravel(), (rows, dofs.ravel())), shape=shape)
            for k in range(dim - 1)
        ]
        self.gap = contact.gaps - self.normal @ self.held
        reference = np.einsum("nkd,nd->kn", tangents, contact.slip_reference)
        self.reference = [reference[k] - self.tangent[k] @ self.held for k in range(dim - 1)]

    def solve(self, limit):
        """Displacement (n_nodes, dim) and pressures (n,) for given nodal limits (n,), N."""
        n, m = len(limit), len(self.free)
        slides = np.flatnonzero(limit > 0)
        k, dim, unit = len(slides), self.problem.dim, self.length
        P = sparse.block_diag(
            [self.matrix * (unit / self.force), sparse.csc_array((k, k))], format="csc"
        )
        q = np.concatenate([-self.load / self.force, limit[slides] / self.force])
        zero = sparse.csr_array((n, k))
        rows = [sparse.hstack([self.normal[:, self.free], zero])]
        right, cones = [self.gap / unit], [clarabel.NonnegativeConeT(n)]
        for at, i in enumerate(slides):
            bound = sparse.csr_array(([-1.0], ([0], [m + at])), shape=(1, m + k))
            parts = [
                sparse.hstack([-t[[i]][:, self.free], sparse.csr_array((1, k))])
                for t in self.tangent
            ]
            rows += [bound, *parts]
            right.append(np.array([0.0, *[-reference[i] / unit for reference in self.reference]]))
            cones.append(clarabel.SecondOrderConeT(dim))
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_iter = False, 200
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-15
        settings.tol_ktratio = 1e-12
        solver = clarabel.DefaultSolver(
            sparse.csc_matrix(sparse.triu(P)),
            q,
            sparse.csc_matrix(sparse.vstack(rows)),
            np.concatenate(right),
            cones,
            settings,
        )
        found = solver.solve()
        u = self.held.copy()
        u[self.free] = unit * np.asarray(found.x)[:m]
        return u.reshape(-1, dim), self.force * np.asarray(found.z)[:n]

    def coulomb(self, friction, limit=0.0, steps=60, rtol=1e-11):
        """Fixed point of s -> limit + friction * p."""
        pressure = np.zeros(len(self.gap))
        for _ in range(steps):
            u, found = self.solve(limit + friction * np.maximum(pressure, 0.0))
            change = np.abs(found - pressure).max()
            pressure = found
            if change <= rtol * np.abs(pressure).max():
                break
        return u, pressure
