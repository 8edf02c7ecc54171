"""Linear solvers on the glued problem (all contact dofs fixed): the rivals of the benchmark, stopped at a true error.

Each rival first runs to a relative energy error of 1e-8, measured against its own solution at 1e-13, to learn how many
iterations that takes; then exactly that many are timed. Set-up and solve are timed apart.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pyamg
from pyamg.multilevel import MultilevelSolver
from pyamg.relaxation.smoothing import change_smoothers
from scipy import sparse

import adaptmg as am
from adaptmg.multigrid.linear_cycle import LinearCycle
from adaptmg.multigrid.split_matrix import nodal_prolongations, split
from adaptmg.solver.record import Run
from adaptmg.transfer import without_fixed

TOLERANCE = 1e-8

#: pyamg settings tried besides the defaults; the best of all is reported
SETTINGS = {
    "defaults": {},
    "strength .08": {"strength": ("symmetric", {"theta": 0.08})},
    "no candidate sweeps": {"improve_candidates": None},
    "energy smoothing": {"smooth": ("energy", {"degree": 1})},
    "two sweeps": {"presmoother": ("block_gauss_seidel", {"sweep": "symmetric", "iterations": 2}),
                   "postsmoother": ("block_gauss_seidel", {"sweep": "symmetric", "iterations": 2})},
}


@dataclass(frozen=True)
class Glued:
    """The glued linear problem of one hierarchy."""

    hierarchy: am.Hierarchy
    matrix: sparse.bsr_array
    load: np.ndarray
    modes: np.ndarray
    fixed: list[np.ndarray]


def glued(hierarchy: am.Hierarchy) -> Glued:
    """All contact dofs fixed, on every level."""
    fixed = []
    for level in hierarchy.levels:
        mask = level.discrete.fixed.copy().reshape(-1, level.discrete.dim)
        mask[level.discrete.contact.nodes] = True
        fixed.append(mask.reshape(-1))
    finest = hierarchy.finest.discrete
    load = np.where(fixed[-1], 0.0, finest.load)
    modes = np.where(fixed[-1][:, None], 0.0, finest.near_nullspace)
    return Glued(hierarchy, without_fixed(finest.matrix, fixed[-1]), load, modes, fixed)


def conjugate_gradients(matrix: sparse.bsr_array, load: np.ndarray, precondition: Callable[[np.ndarray], np.ndarray],
                        iterations: int, exact: np.ndarray | None = None) -> tuple[np.ndarray, int]:
    """Preconditioned conjugate gradients; with ``exact`` until the relative energy error is 1e-8."""
    x, r = np.zeros_like(load), load.copy()
    size = 1.0 if exact is None else float(np.sqrt(exact @ (matrix @ exact)))
    z = precondition(r).copy()
    p, rz = z.copy(), float(r @ z)
    first = rz
    for k in range(1, iterations + 1):
        product = matrix @ p
        alpha = rz / float(p @ product)
        x += alpha * p
        r -= alpha * product
        z = precondition(r)
        before, rz = rz, float(r @ z)
        if exact is not None:
            error = x - exact
            if np.sqrt(max(error @ (matrix @ error), 0.0)) <= TOLERANCE * size:
                return x, k
        elif iterations == REFERENCE and rz <= 1e-26 * first:
            return x, k
        p *= rz / before
        p += z
    return x, iterations


REFERENCE = 400


def iterations_needed(problem: Glued, precondition: Callable[[np.ndarray], np.ndarray]) -> int:
    """Iterations to the true error of 1e-8."""
    exact, _ = conjugate_gradients(problem.matrix, problem.load, precondition, REFERENCE)
    return conjugate_gradients(problem.matrix, problem.load, precondition, REFERENCE - 1, exact)[1]


def pyamg_preconditioner(problem: Glued, setting: str) -> Callable[[np.ndarray], np.ndarray]:
    """Smoothed aggregation with rigid-body modes; one V-cycle an application."""
    hierarchy = pyamg.smoothed_aggregation_solver(sparse.bsr_matrix(problem.matrix), B=problem.modes,
                                                  **SETTINGS[setting])
    operator = hierarchy.aspreconditioner(cycle="V")
    return lambda r: operator @ r


def geometric_preconditioner(problem: Glued) -> tuple[Callable[[np.ndarray], np.ndarray], Run]:
    """The linear V-cycle of the package (symmetric), on the glued matrices."""
    run = Run(unit=problem.matrix.nnz)
    levels = [split(level.discrete.matrix, fixed) for level, fixed in
              zip(problem.hierarchy.levels, problem.fixed, strict=True)]
    cycle = LinearCycle(levels, nodal_prolongations(problem.hierarchy), run, [2] * len(levels))
    cycle.factors.renew()
    top = len(levels) - 1

    def precondition(r: np.ndarray) -> np.ndarray:
        cycle.vectors(top).load[:] = r
        return cycle.solve(top)

    return precondition, run


def geometric_pyamg_preconditioner(problem: Glued) -> Callable[[np.ndarray], np.ndarray]:
    """The same geometric V-cycle with pyamg's levels and block Gauss-Seidel: as one would build it from packages."""
    levels = []
    prolongations = nodal_prolongations(problem.hierarchy)
    for number in range(len(problem.hierarchy) - 1, -1, -1):
        level = MultilevelSolver.Level()
        matrix = problem.hierarchy[number].discrete.matrix
        level.A = sparse.bsr_matrix(without_fixed(matrix, problem.fixed[number]))
        if number:
            dim = matrix.blocksize[0]
            rows, columns = (sparse.diags_array((~problem.fixed[k]).astype(float)) for k in (number, number - 1))
            P = rows @ sparse.csr_array(sparse.kron(prolongations[number - 1], np.eye(dim))) @ columns
            level.P = sparse.bsr_matrix(P, blocksize=(dim, dim))
            level.R = sparse.bsr_matrix(level.P.T)
        levels.append(level)
    solver = MultilevelSolver(levels, coarse_solver="splu")
    sweeps = ("block_gauss_seidel", {"sweep": "symmetric"})
    change_smoothers(solver, sweeps, sweeps)
    operator = solver.aspreconditioner(cycle="V")
    return lambda r: operator @ r


@dataclass(frozen=True)
class Timed:
    """One timed solve."""

    iterations: int
    setup: float
    solve: float


def time_iterative(problem: Glued, build: Callable[[], Callable[[np.ndarray], np.ndarray]], iterations: int) -> Timed:
    """Set up and iterate n times."""
    begin = time.perf_counter()
    precondition = build()
    ready = time.perf_counter()
    conjugate_gradients(problem.matrix, problem.load, precondition, iterations)
    return Timed(iterations, ready - begin, time.perf_counter() - ready)


def time_cholesky(hierarchy: am.Hierarchy, fixed: np.ndarray) -> Timed:
    """NGSolve's sparse Cholesky factorisation of the glued matrix (assembly not counted), and one solve."""
    import ngsolve as ng

    mesh, material = hierarchy.finest.mesh, hierarchy.problem.material
    space = ng.VectorH1(mesh.source, order=1)
    u, v = space.TnT()
    form = ng.BilinearForm(space)
    form += (material.lame * ng.Trace(ng.Grad(u)) * ng.Trace(ng.Grad(v))
             + 2 * material.shear_modulus * ng.InnerProduct(ng.Sym(ng.Grad(u)), ng.Sym(ng.Grad(v)))) * ng.dx
    form.Assemble()
    free = ng.BitArray(space.ndof)
    free.Clear()
    # VectorH1 is ordered component by component
    for dof in np.flatnonzero(~fixed.reshape(-1, mesh.dim).T.reshape(-1)):
        free.Set(int(dof))
    rhs, solution = form.mat.CreateColVector(), form.mat.CreateColVector()
    rhs.FV().NumPy()[:] = 1.0
    begin = time.perf_counter()
    inverse = form.mat.Inverse(free, inverse="sparsecholesky")
    ready = time.perf_counter()
    solution.data = inverse * rhs
    return Timed(1, ready - begin, time.perf_counter() - ready)
