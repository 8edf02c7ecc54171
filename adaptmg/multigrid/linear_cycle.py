"""LinearCycle: a V-cycle on the (truncated) linear coarse problems, one or two symmetric sweeps a level.

The coarsest ones are solved by LU factors. A user-defined :class:`LinearSolve` may replace these, and a user-defined
:class:`LinearSmoother` the sweeps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._threads import in_colours, in_parts, scattering
from adaptmg.multigrid import half_sweeps
from adaptmg.multigrid.corrections import Recorder
from adaptmg.multigrid.half_sweeps import add_prolonged, restrict, zero_at
from adaptmg.multigrid.split_matrix import SplitMatrix
from adaptmg.smoother.blocks import ZERO


@dataclass(eq=False)
class LevelVectors:
    """The vectors of a level (n_dofs,)."""

    load: np.ndarray
    solution: np.ndarray
    kept: np.ndarray


@dataclass(eq=False)
class LinearCycle:
    """V-cycles for the linear problem on any of the levels."""

    levels: list[SplitMatrix]  # coarsest first
    prolongations: list[sparse.csr_array]
    recorder: Recorder  # counts passes and notes the path
    sweeps: Sequence[int]
    coarse_solve: LinearSolve | None = None  # in place of LU factors on the coarsest level
    coarse_smoother: LinearSmoother | None = None  # in place of the symmetric sweeps
    factors: CoarseFactors = field(init=False)

    def __post_init__(self) -> None:
        self.factors = CoarseFactors(self.levels[0], self.coarse_solve)
        self._vectors: dict[int, LevelVectors] = {}
        self._custom: dict[int, _LevelSmoother] = {}
        self._scattering: dict[int, list[list[tuple[int, int]]]] = {}

    def renew(self, number: int) -> None:
        """Take over the matrices below level ``number``, which have changed."""
        self.factors.renew()
        if self.coarse_smoother is not None:
            self._custom = {k: _LevelSmoother(self.coarse_smoother, self.levels[k]) for k in range(1, number)}

    def vectors(self, number: int) -> LevelVectors:
        if number not in self._vectors:
            self._vectors[number] = LevelVectors(*(np.zeros(self.levels[number].n_dofs) for _ in range(3)))
        return self._vectors[number]

    def solve(self, number: int, load: np.ndarray, smooth: bool = True) -> np.ndarray:
        """One cycle from zero for a load (n_dofs,) of a level; returns its solution. ``smooth`` False restricts the
        load unchanged, as a load that comes from a smoothed residual may be; one symmetric sweep then comes after."""
        v = self.vectors(number)
        if number == 0:
            passes = self.factors.solve(load, v.solution)
            if passes:
                self.recorder.count(passes, self.levels[0].nonzeros)
            self.recorder.visit(0, "solve")
            return v.solution
        level = self.levels[number]
        sweeps, passes, rest = self.sweeps[number] if smooth else 2, 0.0, load
        if smooth:
            passes, rest = self._before(number, load, v), v.kept
            self.recorder.visit(number, "smooth", sweeps)
        else:
            v.solution[:] = 0.0
        below = self.vectors(number - 1).load
        self.restrict(number, rest, below)
        self.add_prolonged(number, self.solve(number - 1, below), v.solution)
        zero_at(v.solution, level.fixed)
        self.recorder.visit(number, "prolong")
        passes += self._after(number, load, v, sweeps)
        self.recorder.visit(number, "smooth", sweeps)
        self.recorder.count(passes, level.nonzeros)
        return v.solution

    def transfer(self, number: int) -> tuple[tuple[float, ...], np.ndarray, np.ndarray, np.ndarray]:
        """What the kernels of transfer between a level and the next coarser one take first: the zeros of the components
        of the prolongation, and its arrays."""
        nodal = self.prolongations[number - 1]
        return ZERO[self.levels[number].n_dofs // nodal.shape[0]], nodal.indptr, nodal.indices, nodal.data

    def add_prolonged(self, number: int, coarse: np.ndarray, fine: np.ndarray) -> None:
        """Add what the prolongation to a level makes of a vector on the next coarser one."""
        transfer = self.transfer(number)
        in_parts(add_prolonged, len(transfer[1]) - 1, 2 * len(fine), *transfer, coarse, fine)

    def restrict(self, number: int, residual: np.ndarray, coarse: np.ndarray) -> float:
        """Restrict the residual of a level to the next coarser one; returns its sum of squares."""
        zero, indptr, indices, weights = self.transfer(number)
        if number not in self._scattering:
            self._scattering[number] = scattering(indices, indptr, 2 * len(residual))
        coarse[:] = 0.0
        squares = in_colours(self._scattering[number], restrict, zero, indptr, indices, weights, residual, coarse)
        zero_at(coarse, self.levels[number - 1].fixed)
        self.recorder.visit(number, "restrict")
        return sum(squares)

    def _before(self, number: int, load: np.ndarray, v: LevelVectors) -> float:
        """Smooth from zero; the residual is left in ``kept``. Returns the passes, those of the residual included."""
        level, sweeps = self.levels[number], self.sweeps[number]
        if self._custom:
            v.solution[:] = 0.0
            passes = self._custom[number].smooth(load, v.solution)
            v.kept[:] = load - self._custom[number].matrix @ v.solution
            return passes + 1
        level.sweep(half_sweeps.forward_from_zero, *level.lower_arrays, level.inverse, load, v.solution, v.kept)
        if sweeps == 1:
            level.sweep(half_sweeps.forward_residual, *level.upper_arrays, v.solution, v.kept)
        else:
            level.sweep(half_sweeps.backward_change, *level.upper_arrays, level.inverse, v.solution, v.kept,
                        backward=True)
            level.sweep(half_sweeps.residual, *level.lower_arrays, v.kept, backward=True)
        # forward and residual: L, U; forward, backward, residual: L, U, L
        return 1 if sweeps == 1 else 1.5

    def _after(self, number: int, load: np.ndarray, v: LevelVectors, sweeps: int) -> float:
        level = self.levels[number]
        if self._custom:
            return self._custom[number].smooth(load, v.solution)
        if sweeps == 1:
            level.sweep(half_sweeps.backward_full, *level.lower_arrays, *level.upper_arrays, level.inverse, load,
                        v.solution, backward=True)
        else:
            level.sweep(half_sweeps.forward_full, *level.lower_arrays, *level.upper_arrays, level.inverse, load,
                        v.solution, v.kept)
            level.sweep(half_sweeps.backward_kept, *level.upper_arrays, level.inverse, v.solution, v.kept,
                        backward=True)
        # backward: L, U; forward, backward: L, U, U
        return 1 if sweeps == 1 else 1.5


class CoarseFactors:
    """Solves with the coarsest matrix by dense or sparse factors; a singular one is shifted where it is singular.

    Truncation leaves coarse dofs near contact that no remaining fine dof tells apart, mostly the same ones each time:
    their shift stays, so that each matrix is factorised once. Bodies held by contact alone are singular everywhere.
    """

    #: solutions of forces of size 1 beyond 1 / SINGULAR mean singular; the shift that makes the matrix regular; both
    #: over the diagonal
    SINGULAR, SHIFT = 1e-12, 1e-6
    #: share of singular dofs up to which the shift stays: a body that contact holds again needs its exact matrix
    LOCAL = 0.1
    #: dofs up to which dense factors are quicker
    DENSE = 1500

    def __init__(self, level: SplitMatrix, custom: LinearSolve | None = None) -> None:
        self.level, self.custom = level, custom
        scale = np.abs(level.diagonal.reshape(-1, level.dim, level.dim).diagonal(axis1=1, axis2=2)).reshape(-1)
        self._scale = np.where(scale > 0, scale, scale.max() or 1.0)
        self._shift = np.zeros(level.n_dofs)
        self._probe = self._scale * np.random.default_rng(0).standard_normal(level.n_dofs)
        self._solve: Callable[[np.ndarray], np.ndarray] | None = None
        self._prepared: PreparedSolve | None = None

    def renew(self) -> None:
        if self.custom is not None:
            self._prepared = checks.offers("coarse_solve: what setup returns",
                                           self.custom.setup(_regular_sparse(self.level, self._scale)), "solve",
                                           "an object with solve(rhs) -> solution")
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
            matrix.flat[::len(shift) + 1] += shift
            return _dense_factors(matrix)
        return _sparse_factors(_regular_sparse(self.level, self._scale) + sparse.diags_array(shift))

    def solve(self, load: np.ndarray, result: np.ndarray) -> float:
        """Solve into ``result`` (n_dofs,); returns the passes over the matrix, 0 for factors."""
        if self._prepared is None:
            result[:] = self._solve(load)
            return 0.0
        # a copy: a user-defined solver may change it
        solution = self._prepared.solve(load.copy())
        result[:] = check_arrays.array("coarse_solve: what solve returns", solution, load.shape)
        return checks.nonnegative("coarse_solve: passes", getattr(self._prepared, "passes", 0.0))


def _dense_factors(matrix: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Solves with a matrix; those of a singular one are vast, infinite or NaN."""
    # LAPACK itself: scipy's wrapper warns of what the caller mends
    factors, pivots, _ = linalg.lapack.dgetrf(matrix)
    return lambda load: linalg.lapack.dgetrs(factors, pivots, load)[0]


def _sparse_factors(matrix: sparse.csr_array) -> Callable[[np.ndarray], np.ndarray]:
    """As :func:`_dense_factors`, by SuperLU."""
    try:
        # pivots off the diagonal fill more than they gain: but for the slip rows of Coulomb the matrix is symmetric
        return splu(sparse.csc_array(matrix), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=1e-3,
                    options={"SymmetricMode": True}).solve
    except RuntimeError:
        # an exactly vanishing pivot
        return lambda load: np.full_like(load, np.nan)


#: sum of the entries of a row, over the diagonal before truncation, up to which the row is empty but for rounding
EMPTY = 1e-12


class PreparedSolve(Protocol):
    """A matrix made ready for solves."""

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """The solution (n_dofs,) for a right-hand side (n_dofs,)."""


class PreparedSmoother(Protocol):
    """A matrix made ready for sweeps."""

    def smooth(self, rhs: np.ndarray, x: np.ndarray) -> float:
        """Improve x (n_dofs,) in place; returns the passes over the matrix that it took."""


class LinearSolve(Protocol):
    """A user-defined solver of the coarsest linear problems."""

    def setup(self, matrix: sparse.csr_array) -> PreparedSolve:
        """Prepare for a matrix (n_dofs, n_dofs), whenever the contact status changes it. It has a diagonal entry alone
        where dofs are fixed or truncated; with Coulomb friction it is not symmetric; where only contact holds a body it
        may be singular. The passes over the matrix that the object's ``passes`` names for its last solve, if it has
        them, are counted as work."""


class LinearSmoother(Protocol):
    """A user-defined smoother of the linear problems between the coarsest level and the finest."""

    def setup(self, matrix: sparse.csr_array) -> PreparedSmoother:
        """Prepare for a matrix; see :meth:`LinearSolve.setup`."""


def regular_matrix(level: SplitMatrix, scale: np.ndarray) -> sparse.bsr_array:
    """The matrix of a level, with ``scale`` (n_dofs,) on the diagonal where rows are empty but for rounding."""
    matrix = level.matrix()
    row = np.repeat(np.arange(level.n_nodes), np.diff(matrix.indptr))
    sizes = np.zeros((level.n_nodes, level.dim))
    np.add.at(sizes, row, np.abs(matrix.data).sum(axis=2))
    node, component = np.nonzero(sizes <= EMPTY * scale.reshape(sizes.shape))
    matrix.data[np.flatnonzero(row == matrix.indices)[node], component, component] = scale[level.dim * node + component]
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
        diagonal = level.diagonal.reshape(-1, level.dim, level.dim).diagonal(axis1=1, axis2=2).reshape(-1)
        self.matrix = _regular_sparse(level, np.full(level.n_dofs, np.abs(diagonal).max()))
        self._smoother = checks.offers("coarse_smoother: what setup returns", custom.setup(self.matrix), "smooth",
                                       "an object with smooth(rhs, x) -> passes")

    def smooth(self, load: np.ndarray, unknowns: np.ndarray) -> float:
        passes = self._smoother.smooth(load.copy(), unknowns)
        return checks.nonnegative("coarse_smoother: the passes that smooth returns", passes)
