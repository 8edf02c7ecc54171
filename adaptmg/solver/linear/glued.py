"""The glued problem: all contact dofs fixed where they are, a linear problem that every linear solver can be timed on.

It is the yardstick of the comparison with algebraic multigrid: the same body, mesh and supports without the
nonlinearity of contact.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg.discrete import DiscreteProblem
from adaptmg.problem import checks
from adaptmg.smoother.system import local_system
from adaptmg.solver.linear.solvers import AMG, LinearSolver
from adaptmg.solver.newton.steps import local_near_nullspace

__all__ = ["GluedResult", "glued_system", "solve_glued"]


@dataclass(frozen=True, eq=False)
class GluedResult:
    """Solution of the glued problem.

    Attributes
    ----------
    displacement : (n_nodes, dim) array
        m; prescribed values at fixed dofs, zero local displacement at contact nodes.
    iterations : int
        Krylov iterations; 0 of a direct solver.
    passes : float
        Passes over the glued matrix; 0 of a direct solver.
    seconds_setup, seconds_solve : float
        s.
    residual : float
        |b - A x| / |b| of the glued system, Euclidean.
    converged : bool
        Whether ``residual`` is below the tolerance.
    error : float
        True relative error in the A-norm; NaN without a reference.
    """

    displacement: np.ndarray
    iterations: int
    passes: float
    seconds_setup: float
    seconds_solve: float
    residual: float
    converged: bool
    error: float = float("nan")


def glued_system(discrete: DiscreteProblem) -> tuple[sparse.bsr_array, np.ndarray, np.ndarray]:
    """The linear system with all contact dofs fixed.

    Parameters
    ----------
    discrete : DiscreteProblem

    Returns
    -------
    matrix : bsr_array (n_free, n_free)
        Rows and columns of the nodes that are not contact nodes; fixed dofs among them decoupled.
    load : (n_free,) array
        Prescribed values lifted, N.
    near_nullspace : (n_free, k) array
        Rigid-body modes, zero at fixed dofs.
    """
    system, load, modes, _ = _glued(discrete)
    return system, load, modes


def _glued(discrete: DiscreteProblem) -> tuple[sparse.bsr_array, np.ndarray, np.ndarray, np.ndarray]:
    local = local_system(discrete)
    dim = discrete.dim
    kept = np.flatnonzero(local.system.contact_of < 0)
    if not len(kept):
        raise ValueError("every node is a contact node: nothing is left of the glued problem")
    dofs = (dim * kept[:, None] + np.arange(dim)).reshape(-1)
    matrix = sparse.csr_array(local.system.matrix)[dofs][:, dofs]
    matrix = sparse.bsr_array(matrix, blocksize=(dim, dim)).sorted_indices()
    return matrix, local.load[dofs], local_near_nullspace(local)[dofs], dofs


def solve_glued(discrete: DiscreteProblem, linear: LinearSolver | None = None, rtol: float = 1e-8, *,
                reference: np.ndarray | None = None) -> GluedResult:
    """Solve the glued problem and time it.

    Parameters
    ----------
    discrete : DiscreteProblem
    linear : LinearSolver, optional
        Default ``AMG()``: conjugate gradients preconditioned by smoothed aggregation with rigid-body modes.
    rtol : float
        For the residual relative to the load of the glued system, Euclidean norms.
    reference : (n_nodes, dim) array, optional
        The solution (of :func:`solve_glued` with ``Direct()``), for the true error, m.

    Returns
    -------
    GluedResult

    Raises
    ------
    numpy.linalg.LinAlgError
        If the glued problem is singular and the solver finds it out.
    """
    rtol = checks.positive("rtol", rtol)
    if reference is not None and np.shape(reference) != (discrete.n_nodes, discrete.dim):
        raise ValueError(f"reference must have shape {(discrete.n_nodes, discrete.dim)}, got {np.shape(reference)}")
    matrix, load, modes, dofs = _glued(discrete)
    begin = time.perf_counter()
    prepared = (AMG() if linear is None else linear).setup(matrix, modes)
    ready = time.perf_counter()
    solution = prepared.solve(load, rtol=rtol)
    done = time.perf_counter()
    displacement = discrete.fixed_values.copy()
    displacement[dofs] += solution.unknowns
    error = float("nan")
    if reference is not None:
        exact = np.asarray(reference, dtype=np.float64).reshape(-1)[dofs] - discrete.fixed_values[dofs]
        error = _relative_energy(matrix, solution.unknowns - exact, exact)
    return GluedResult(displacement=displacement.reshape(discrete.n_nodes, -1), iterations=solution.iterations,
                       passes=solution.passes, seconds_setup=ready - begin, seconds_solve=done - ready,
                       residual=solution.residual, converged=solution.converged, error=error)


def _relative_energy(matrix: sparse.bsr_array, error: np.ndarray, exact: np.ndarray) -> float:
    size = float(exact @ (matrix @ exact))
    squared = max(float(error @ (matrix @ error)), 0.0)
    if size > 0:
        return float(np.sqrt(squared / size))
    return 0.0 if squared == 0 else float("inf")
