r"""Linear solvers: a direct one and algebraic multigrid, for the steps of the active set method and
the glued problem.

Work of the iterative solver is counted by the entries it touches, in passes over the matrix:

.. math:: \text{passes} = n_A + n_M \sum_l \frac{(s_{pre} + s_{post} + 1)\,\mathrm{nnz}(A_l) + 2\,\mathrm{nnz}(P_l)}
          {\mathrm{nnz}(A_0)}

with :math:`n_A` products with the matrix and :math:`n_M` cycles (both counted as they happen),
:math:`s` passes of the smoother (two for a symmetric sweep), one residual, a restriction and a
prolongation on every level but the coarsest, where the dense pseudo-inverse is one product with
:math:`n^2` entries. Set-up and factorisations are time, not work."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from adaptmg import _checks as checks
from adaptmg._threads import seeded
from adaptmg.discrete.elasticity import dofs_of
from adaptmg.smoother.factorisation import OrderedFactors, nested_dissection, node_graph

if TYPE_CHECKING:
    import pyamg


@dataclass(frozen=True, eq=False)
class LinearSolution:
    """The result of a linear solve."""

    unknowns: np.ndarray  # (n,)
    iterations: int  # krylov iterations; 0 of a direct solver
    passes: float  # passes over the matrix that count as work; 0 of a direct solver
    residual: float  # |b - K x| / |b|, Euclidean
    converged: bool  # whether the residual is below the tolerance


def solution_of(
    linear: LinearSolver, prepared: Prepared, rhs: np.ndarray, rtol: float
) -> LinearSolution:
    """Solve for a right-hand side (n,) with a matrix that a linear solver has prepared; TypeError unless
    the solution of a user-defined solver has the right form."""
    name = f"linear: what {checks.shown(linear)}"
    checks.offers(f"{name} prepares", prepared, "solve", "an object that offers solve(rhs, rtol)")
    solution = prepared.solve(rhs, rtol=rtol)
    checks.instance(f"{name} returns", solution, LinearSolution, "a LinearSolution")
    unknowns = solution.unknowns
    if (
        not isinstance(unknowns, np.ndarray)
        or unknowns.dtype != np.float64
        or unknowns.shape != rhs.shape
    ):
        given = (
            f"{unknowns.dtype} {unknowns.shape}"
            if isinstance(unknowns, np.ndarray)
            else checks.shown(unknowns)
        )
        raise TypeError(f"{name} returns must have unknowns of float64 {rhs.shape}, got {given}")
    return solution


class Prepared(Protocol):
    """A matrix made ready for solves."""

    def solve(self, rhs: np.ndarray, rtol: float = 1e-10) -> LinearSolution:
        """Solve K x = rhs to |rhs - K x| <= rtol |rhs|, Euclidean."""
        ...


class LinearSolver(Protocol):
    """A linear solver for the steps of the active set method."""

    def setup(
        self,
        matrix: sparse.bsr_array,
        near_nullspace: np.ndarray | None = None,
        *,
        symmetric: bool = True,
        preconditioner: sparse.bsr_array | None = None,
        previous: Prepared | None = None,
    ) -> Prepared:
        """Prepare to solve with a matrix K (n_dofs, n_dofs).

        Parameters
        ----------
        matrix : bsr_array
        near_nullspace : (n_dofs, k) array, optional
            Rigid-body modes, zero at fixed dofs.
        symmetric : bool
            Whether K is symmetric: not with the slip rows of Coulomb's law.
        preconditioner : bsr_array, optional
            A symmetric matrix near K, if K is not symmetric.
        previous : object, optional
            What was prepared for the matrix before, which has the same pattern.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class Direct:
    """Sparse factorisation by SuperLU with a nested-dissection order, and one step of iterative
    refinement a solve.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.solve(grids, am.ActiveSet(linear=am.Direct())).cycles < 20
    True
    """

    #: ``|K^-1 D|`` beyond this, D the diagonal of K, means singular
    SINGULAR = 1 / checks.ROUNDING

    def setup(
        self,
        matrix: sparse.bsr_array,
        near_nullspace: np.ndarray | None = None,
        *,
        symmetric: bool = True,
        preconditioner: sparse.bsr_array | None = None,
        previous: Prepared | None = None,
    ) -> Factorised:
        """Factorise; see :class:`LinearSolver`. The order of elimination of ``previous``, which
        should have the same pattern, is reused. Only its length is compared: with another pattern the
        factors are correct, but have more entries."""
        if isinstance(previous, Factorised) and len(previous.factors.order) == matrix.shape[0]:
            order = previous.factors.order
        else:
            size = matrix.blocksize[0]
            order = dofs_of(nested_dissection(node_graph(matrix)), size)
        # without symmetry also pivots off the diagonal, where its entry is below a thousandth of the
        # largest of its column
        try:
            factors = OrderedFactors.of(sparse.csr_array(matrix), order, 0.0 if symmetric else 1e-3)
        except RuntimeError as error:
            raise np.linalg.LinAlgError(_singular(matrix)) from error
        # the solution of forces of the size of the diagonal: about 1, huge if the matrix is singular
        probe = np.random.default_rng(0).standard_normal(matrix.shape[0])
        growth = np.abs(factors.solve(matrix.diagonal() * probe)).max()
        if not growth < self.SINGULAR:
            raise np.linalg.LinAlgError(_singular(matrix))
        return Factorised(matrix, factors)


def _singular(matrix: sparse.bsr_array) -> str:
    """Return the error message for a singular matrix."""
    return (
        f"the matrix ({matrix.shape[0]} rows) is singular: a motion is left free by the supports and the contact "
        "nodes that hold; add a support, or start from a state in which more nodes touch"
    )


@dataclass(frozen=True, eq=False)
class Factorised:
    """The factors of a matrix; :class:`Direct` makes it."""

    matrix: sparse.bsr_array
    factors: OrderedFactors

    def solve(self, rhs: np.ndarray, rtol: float = 1e-10) -> LinearSolution:
        """Solve and refine; see :class:`Prepared`."""
        unknowns = self.factors.solve(rhs)
        unknowns += self.factors.solve(rhs - self.matrix @ unknowns)
        relative = _relative(rhs - self.matrix @ unknowns, rhs)
        return LinearSolution(
            unknowns=unknowns,
            iterations=0,
            passes=0.0,
            residual=relative,
            converged=relative <= rtol,
        )


def _relative(residual: np.ndarray, rhs: np.ndarray) -> float:
    """Return the Euclidean norm of a residual over that of the right-hand side, if that is not 0."""
    size = float(np.linalg.norm(rhs))
    return float(np.linalg.norm(residual)) / size if size > 0 else float(np.linalg.norm(residual))


@dataclass(frozen=True, kw_only=True)
class AMG:
    """Smoothed aggregation (pyamg) as preconditioner of conjugate gradients, or of flexible GMRES
    if not symmetric.

    A symmetric block Gauss-Seidel sweep before and after the coarse correction; the other options
    are the defaults of ``pyamg.smoothed_aggregation_solver``.

    Notes
    -----
    P. Vanek, J. Mandel, M. Brezina, Computing 56, 1996, doi:10.1007/BF02238511. N. Bell, L. Olson,
    J. Schroder, B. Southworth, PyAMG, JOSS 8 (87), 2023, doi:10.21105/joss.05495.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.solve(grids, am.ActiveSet(linear=am.AMG())).status.name
    'CONVERGED'
    """

    #: Krylov iterations at most
    MAX_ITERATIONS = 500
    #: iterations between restarts of GMRES: on slender bodies with slip it stagnates with 50
    RESTART = 200

    def setup(
        self,
        matrix: sparse.bsr_array,
        near_nullspace: np.ndarray | None = None,
        *,
        symmetric: bool = True,
        preconditioner: sparse.bsr_array | None = None,
        previous: Prepared | None = None,
    ) -> Preconditioned:
        """Build a hierarchy of coarse matrices; see :class:`LinearSolver`."""
        import pyamg

        # theta 0: all neighbours are strongly connected
        basis = matrix if preconditioner is None else preconditioner
        smoother = ("block_gauss_seidel", {"sweep": "symmetric"})
        with seeded():
            hierarchy = pyamg.smoothed_aggregation_solver(
                # pyamg 5.2 smooths matrices with indices of 32 bits only
                sparse.bsr_matrix(checks.narrowed(basis)),
                B=near_nullspace,
                symmetry="symmetric",
                strength=("symmetric", {"theta": 0.0}),  # pyright: ignore[reportArgumentType]  pyamg has no stubs
                presmoother=smoother,
                postsmoother=smoother,
            )
        return Preconditioned(matrix, hierarchy, symmetric, self)


@dataclass(frozen=True, eq=False)
class Preconditioned:
    """A matrix with its algebraic hierarchy; :class:`AMG` makes it."""

    matrix: sparse.bsr_array
    hierarchy: pyamg.MultilevelSolver
    symmetric: bool
    options: AMG

    @cached_property
    def cycle_passes(self) -> float:
        """Return the passes over the finest matrix that a V-cycle costs; see the module's formula."""
        *levels, coarsest = self.hierarchy.levels
        # four passes of two symmetric sweeps, and a residual
        entries = sum(5 * level.A.nnz + 2 * level.P.nnz for level in levels)
        return (entries + coarsest.A.shape[0] ** 2) / self.hierarchy.levels[0].A.nnz

    def solve(self, rhs: np.ndarray, rtol: float = 1e-10) -> LinearSolution:
        """Solve; see :class:`Prepared`.

        A small residual may hide a smooth error: on a slender body nearly all of it. So the method
        goes on with smaller tolerances until the error in the norm of the preconditioner is small,
        too."""
        from pyamg import krylov

        shape = self.matrix.shape
        cycle = self.hierarchy.aspreconditioner(cycle="V")
        passes = 0.0

        def product(x: np.ndarray) -> np.ndarray:
            nonlocal passes
            passes += 1
            return self.matrix @ x.reshape(-1)

        def precondition(x: np.ndarray) -> np.ndarray:
            nonlocal passes
            passes += self.cycle_passes
            return cycle @ x.reshape(-1)

        operator = LinearOperator(shape, matvec=product, dtype=np.float64)
        inverse = LinearOperator(shape, matvec=precondition, dtype=np.float64)
        unknowns = None
        iterations = 0
        tolerance = rtol
        solution_energy = _energy(rhs, precondition(rhs))
        while True:
            norms: list[float] = []
            iterations_left = self.options.MAX_ITERATIONS - iterations
            if self.symmetric:
                unknowns, _ = krylov.cg(
                    operator,
                    rhs,
                    x0=unknowns,
                    tol=tolerance,
                    maxiter=iterations_left,
                    M=inverse,
                    residuals=norms,
                )
            else:
                restart = min(self.options.RESTART, iterations_left, shape[0])
                unknowns, _ = krylov.fgmres(
                    operator,
                    rhs,
                    x0=unknowns,
                    tol=tolerance,
                    M=inverse,
                    restart=restart,
                    maxiter=-(-iterations_left // restart),  # restarts, rounded up
                    residuals=norms,
                )
            iterations += max(len(norms) - 1, 0)
            residual = rhs - product(unknowns)
            error = _energy(residual, precondition(residual))
            accurate = not error > rtol * solution_energy
            idle = not len(norms) > 1  # no iteration was made
            if accurate or idle or iterations >= self.options.MAX_ITERATIONS:
                break
            # as much smaller as the error is too large, with a margin of a half, at most by a hundred
            tolerance *= max(0.5 * rtol * solution_energy / error, 1e-2)
        # a tenth more: the iteration ends by the residual that it updates, from which rounding moves
        # this one away. Of 168 solves of 375 to 2187 unknowns to 1e-7 ... 2e-12 four end between 1 and
        # 1.1 times rtol, all of them at rtol <= 5e-12
        relative = _relative(residual, rhs)
        return LinearSolution(
            unknowns=unknowns,
            iterations=iterations,
            passes=passes,
            residual=relative,
            converged=relative <= 1.1 * rtol,
        )


def _energy(residual: np.ndarray, preconditioned: np.ndarray) -> float:
    """Return the energy norm of the error, sqrt(N m), as the preconditioner estimates it: the root of
    r . P r from the residual r (n,) and the preconditioned one P r (n,)."""
    return float(np.sqrt(max(float(np.einsum("i,i->", residual, preconditioned)), 0.0)))
