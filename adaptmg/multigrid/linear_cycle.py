"""LinearCycle: a V-cycle on the (truncated) linear coarse problems, one or two symmetric sweeps a
level.

The coarsest ones are solved by LU factors. A user-defined :class:`LinearSolve` may replace these,
and a user-defined
:class:`LinearSmoother` the sweeps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from adaptmg import _checks as checks
from adaptmg._threads import in_colours, in_parts, scattering
from adaptmg.multigrid.cycle import Recorder
from adaptmg.multigrid.split_matrix import (
    SplitMatrix,
    add_prolonged,
    gauss_seidel,
    restrict,
    subtract_half,
)
from adaptmg.smoother.blocks import ZERO


@dataclass(eq=False)
class LinearLevel:
    """One level with its operators: matrix, prolongation, smoother and vectors."""

    matrix: SplitMatrix
    below: LinearLevel | None  # the next coarser one
    prolongation: sparse.csr_array | None  # from there, nodal or by dofs
    sweeps: int  # symmetric ones before and after the coarse correction
    smoother: _LevelSmoother | None = None  # in place of the sweeps

    @cached_property
    def load(self) -> np.ndarray:
        return np.zeros(self.matrix.n_dofs)

    @cached_property
    def solution(self) -> np.ndarray:
        return np.zeros(self.matrix.n_dofs)

    @cached_property
    def rest(self) -> np.ndarray:
        """The residual that :meth:`presmooth` leaves."""
        return np.zeros(self.matrix.n_dofs)

    @cached_property
    def _transfer(self) -> tuple[tuple[float, ...], np.ndarray, np.ndarray, np.ndarray]:
        """The zeros of the components of the prolongation, and its arrays."""
        nodal = self.prolongation
        return ZERO[self.matrix.n_dofs // nodal.shape[0]], nodal.indptr, nodal.indices, nodal.data

    @cached_property
    def _scattering(self) -> list[list[tuple[int, int]]]:
        return scattering(
            self.prolongation.indices, self.prolongation.indptr, 2 * self.matrix.n_dofs
        )

    def restrict(self, residual: np.ndarray, coarse: np.ndarray) -> float:
        """Restrict a residual to the level below, into ``coarse``; returns its sum of squares."""
        coarse[:] = 0.0
        squares = in_colours(self._scattering, restrict, *self._transfer, residual, coarse)
        coarse[self.below.matrix.fixed] = 0.0
        return sum(squares)

    def prolong(self, coarse: np.ndarray, to: np.ndarray) -> None:
        """Add a prolonged vector of the level below to one of this level."""
        in_parts(
            add_prolonged, self.prolongation.shape[0], 2 * len(to), *self._transfer, coarse, to
        )

    def presmooth(self, load: np.ndarray) -> float:
        """Smooth from zero and leave the residual; returns the passes over the matrix."""
        matrix, u, rest = self.matrix, self.solution, self.rest
        if self.smoother is not None:
            u[:] = 0.0
            passes = self.smoother.smooth(load, u)
            rest[:] = load - self.smoother.matrix @ u
            return passes + 1
        lower, upper, none = matrix.lower_arrays, matrix.upper_arrays, matrix.no_half
        matrix.sweep(gauss_seidel, False, *lower, *none, matrix.inverse, load, u, rest)
        if self.sweeps == 1:
            rest[:] = 0.0
            matrix.sweep(subtract_half, *upper, u, rest)
            return 1.0  # L, U
        matrix.sweep(
            gauss_seidel, True, *none, *upper, matrix.inverse, rest, u, rest, backward=True
        )
        np.subtract(load, rest, out=rest)
        matrix.sweep(subtract_half, *lower, u, rest)
        return 1.5  # L, U, L

    def postsmooth(self, load: np.ndarray, sweeps: int) -> float:
        matrix, u, rest = self.matrix, self.solution, self.rest
        if self.smoother is not None:
            return self.smoother.smooth(load, u)
        lower, upper = matrix.lower_arrays, matrix.upper_arrays
        if sweeps == 1:
            matrix.sweep(
                gauss_seidel, True, *upper, *lower, matrix.inverse, load, u, rest, backward=True
            )
            return 1.0  # L, U
        matrix.sweep(gauss_seidel, False, *lower, *upper, matrix.inverse, load, u, rest)
        matrix.sweep(
            gauss_seidel,
            True,
            *matrix.no_half,
            *upper,
            matrix.inverse,
            rest,
            u,
            rest,
            backward=True,
        )
        return 1.5  # L, U, U


class LinearCycle:
    """V-cycles for the linear problem on any of the levels, coarsest first; ``recorder`` counts
    passes and notes the path."""

    def __init__(
        self,
        matrices: list[SplitMatrix],
        prolongations: list[sparse.csr_array],
        recorder: Recorder,
        sweeps: Sequence[int],
        coarse_solve: LinearSolve | None = None,
        coarse_smoother: LinearSmoother | None = None,
    ) -> None:
        self.levels: list[LinearLevel] = []
        for parts in zip(matrices, [None, *prolongations], sweeps, strict=True):
            self.levels.append(
                LinearLevel(parts[0], self.levels[-1] if self.levels else None, *parts[1:])
            )
        self.recorder, self.coarse_smoother = recorder, coarse_smoother
        self.factors = CoarseFactors(matrices[0], coarse_solve)

    def renew(self, number: int) -> None:
        """Take over the matrices below level ``number``, which have changed."""
        self.factors.renew()
        for level in self.levels[1:number] if self.coarse_smoother is not None else ():
            level.smoother = _LevelSmoother(self.coarse_smoother, level.matrix)

    def solve(self, number: int, load: np.ndarray, smooth: bool = True) -> np.ndarray:
        """Run one cycle from zero for a load (n_dofs,) of a level; return its solution. ``smooth``
        False restricts the load unchanged, as a load that comes from a smoothed residual may be;
        one symmetric sweep then comes after."""
        level, recorder = self.levels[number], self.recorder
        if number == 0:
            recorder.count(self.factors.solve(load, level.solution), level.matrix.nonzeros)
            recorder.visit(0, "solve")
            return level.solution
        passes, rest, sweeps = 0.0, load, 2
        if smooth:
            passes, rest, sweeps = level.presmooth(load), level.rest, level.sweeps
            recorder.visit(number, "smooth", sweeps)
        else:
            level.solution[:] = 0.0
        level.restrict(rest, level.below.load)
        recorder.visit(number, "restrict")
        level.prolong(self.solve(number - 1, level.below.load), level.solution)
        level.solution[level.matrix.fixed] = 0.0
        recorder.visit(number, "prolong")
        passes += level.postsmooth(load, sweeps)
        recorder.visit(number, "smooth", sweeps)
        recorder.count(passes, level.matrix.nonzeros)
        return level.solution


class CoarseFactors:
    """Solves with the coarsest matrix by dense or sparse factors; a singular one is shifted where
    it is singular.

    Truncation leaves coarse dofs near contact that no remaining fine dof tells apart, mostly the
    same ones each time: their shift stays, so that each matrix is factorised once. Bodies held by
    contact alone are singular everywhere."""

    #: solutions of forces of size 1 beyond 1 / SINGULAR mean singular; the shift that makes the matrix regular; both
    #: over the diagonal
    SINGULAR, SHIFT = 1e-12, 1e-6
    #: share of singular dofs up to which the shift stays: a body that contact holds again needs its exact matrix
    LOCAL = 0.1
    #: dofs up to which dense factors are quicker
    DENSE = 1500

    def __init__(self, level: SplitMatrix, custom: LinearSolve | None = None) -> None:
        self.level, self.custom = level, custom
        scale = np.abs(
            level.diagonal.reshape(-1, level.dim, level.dim).diagonal(axis1=1, axis2=2)
        ).reshape(-1)
        self._scale = np.where(scale > 0, scale, scale.max() or 1.0)
        self.forget()
        self._probe = self._scale * np.random.default_rng(0).standard_normal(level.n_dofs)
        self._solve: Callable[[np.ndarray], np.ndarray] | None = None
        self._prepared: PreparedSolve | None = None

    def forget(self) -> None:
        """Take no shift, as before the first matrix."""
        self._shift = np.zeros(self.level.n_dofs)

    def renew(self) -> None:
        if self.custom is not None:
            self._prepared = checks.offers(
                "coarse_solve: what setup returns",
                self.custom.setup(_regular_sparse(self.level, self._scale)),
                "solve",
                "an object with solve(rhs) -> solution",
            )
            return
        self._solve = self._factors(self._shift)
        singular = ~(np.abs(self._solve(self._probe)) < 1 / self.SINGULAR)
        if singular.any():
            shift = np.where(singular, self.SHIFT * self._scale, self._shift)
            self._solve = self._factors(shift)
            if singular.mean() <= self.LOCAL:
                self._shift = shift

    def _factors(self, shift: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        if self.level.n_dofs <= self.DENSE:
            matrix = _regular_dense(self.level, self._scale)
            matrix.flat[:: len(shift) + 1] += shift
            return _dense_factors(matrix)
        return _sparse_factors(_regular_sparse(self.level, self._scale) + sparse.diags_array(shift))

    def solve(self, load: np.ndarray, result: np.ndarray) -> float:
        """Solve into ``result`` (n_dofs,); returns the passes over the matrix, 0 for factors."""
        if self._prepared is None:
            result[:] = self._solve(load)
            return 0.0
        # a copy: a user-defined solver may change it
        solution = self._prepared.solve(load.copy())
        result[:] = checks.array("coarse_solve: what solve returns", solution, load.shape)
        return checks.nonnegative("coarse_solve: passes", getattr(self._prepared, "passes", 0.0))


def _dense_factors(matrix: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Solves with a matrix; those of a singular one are vast, infinite or NaN."""
    # LAPACK itself: scipy's wrapper warns of what the caller mends
    factors, pivots, _ = linalg.lapack.dgetrf(matrix)
    return lambda load: linalg.lapack.dgetrs(factors, pivots, load)[0]


def _sparse_factors(matrix: sparse.csr_array) -> Callable[[np.ndarray], np.ndarray]:
    """As :func:`_dense_factors`, by SuperLU."""
    try:
        # pivots off the diagonal fill more than they gain: but for the slip rows of Coulomb the
        # matrix is symmetric
        return splu(
            sparse.csc_array(matrix),
            permc_spec="MMD_AT_PLUS_A",
            diag_pivot_thresh=1e-3,
            options={"SymmetricMode": True},
        ).solve
    except RuntimeError:
        # an exactly vanishing pivot
        return lambda load: np.full_like(load, np.nan)


#: sum of the entries of a row, over the diagonal before truncation, up to which the row is empty but for rounding
EMPTY = 1e-12


class PreparedSolve(Protocol):
    """A matrix made ready for solves."""

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Return the solution (n_dofs,) for a right-hand side (n_dofs,)."""


class PreparedSmoother(Protocol):
    """A matrix made ready for sweeps."""

    def smooth(self, rhs: np.ndarray, x: np.ndarray) -> float:
        """Improve x (n_dofs,) in place; returns the passes over the matrix that it took."""


class LinearSolve(Protocol):
    """A user-defined solver of the coarsest linear problems."""

    def setup(self, matrix: sparse.csr_array) -> PreparedSolve:
        """Prepare for a matrix (n_dofs, n_dofs), whenever the contact status changes it. It has a
        diagonal entry alone where dofs are fixed or truncated; with Coulomb friction it is not
        symmetric; where only contact holds a body it may be singular. The passes over the matrix
        that the object's ``passes`` names for its last solve, if it has them, are counted as
        work."""


class LinearSmoother(Protocol):
    """A user-defined smoother of the linear problems between the coarsest level and the finest."""

    def setup(self, matrix: sparse.csr_array) -> PreparedSmoother:
        """Prepare for a matrix; see :meth:`LinearSolve.setup`."""


def regular_matrix(level: SplitMatrix, scale: np.ndarray) -> sparse.bsr_array:
    """Return the matrix of a level, with ``scale`` (n_dofs,) on the diagonal where rows are empty
    but for rounding."""
    matrix = level.matrix()
    row = np.repeat(np.arange(level.n_nodes), np.diff(matrix.indptr))
    sizes = np.zeros((level.n_nodes, level.dim))
    np.add.at(sizes, row, np.abs(matrix.data).sum(axis=2))
    node, component = np.nonzero(sizes <= EMPTY * scale.reshape(sizes.shape))
    matrix.data[np.flatnonzero(row == matrix.indices)[node], component, component] = scale[
        level.dim * node + component
    ]
    return matrix


def _regular_sparse(level: SplitMatrix, scale: np.ndarray) -> sparse.csr_array:
    matrix = sparse.csr_array(regular_matrix(level, scale))
    matrix.eliminate_zeros()
    return matrix


def _regular_dense(level: SplitMatrix, scale: np.ndarray) -> np.ndarray:
    matrix = level.dense()
    empty = np.flatnonzero(np.abs(matrix).sum(axis=1) <= EMPTY * scale)
    matrix[empty, empty] = scale[empty]
    return matrix


class _LevelSmoother:
    """A :class:`LinearSmoother` set up for the matrix of a level."""

    def __init__(self, custom: LinearSmoother, level: SplitMatrix) -> None:
        diagonal = (
            level.diagonal.reshape(-1, level.dim, level.dim).diagonal(axis1=1, axis2=2).reshape(-1)
        )
        self.matrix = _regular_sparse(level, np.full(level.n_dofs, np.abs(diagonal).max()))
        self._smoother = checks.offers(
            "coarse_smoother: what setup returns",
            custom.setup(self.matrix),
            "smooth",
            "an object with smooth(rhs, x) -> passes",
        )

    def smooth(self, load: np.ndarray, unknowns: np.ndarray) -> float:
        passes = self._smoother.smooth(load.copy(), unknowns)
        return checks.nonnegative("coarse_smoother: the passes that smooth returns", passes)


#: added to the scaled products of residuals, which may depend on each other
_SHIFT = 1e-12


def least_weights(now: np.ndarray, changes: np.ndarray, d: np.ndarray) -> np.ndarray:
    """The alpha (k,) that minimise |now + alpha changes|, ``changes`` (k, n), weighted with ``d``
    (n,)."""
    weighted = changes * d
    products = weighted @ changes.T
    scale = np.sqrt(products.diagonal())
    scale[scale == 0.0] = 1.0
    products /= scale[:, None] * scale
    products.flat[:: len(scale) + 1] += _SHIFT
    # LAPACK itself: numpy's least squares take ten times as long as all products of a small problem
    return linalg.lapack.dposv(products, -(weighted @ now) / scale)[1] / scale
