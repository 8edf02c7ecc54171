"""LinearCycle: a V-, W- or F-cycle on the (truncated) linear coarse problems.

One or two symmetric sweeps a level, or as many as a :class:`~adaptmg.multigrid.cycle.Cycle` says;
the coarsest problems are solved by LU factors. A user-defined :class:`LinearSolve` may replace
these, a user-defined :class:`LinearSmoother` the sweeps, and a :class:`LinearCorrection` the whole
cycle: :class:`PyAMG` is one, with the cycles and smoothers of pyamg on the same matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol, cast

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from adaptmg import _checks as checks
from adaptmg._threads import in_colours, in_parts, scattering
from adaptmg.discrete.block_rows import diagonal_places
from adaptmg.multigrid.cycle import VISITS, Cycle, Recorder
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
    # Any: the coarsest level has None of both, and is not asked for them
    below: LinearLevel | Any  # the next coarser one
    prolongation: sparse.csr_array | Any  # from there, nodal or by dofs
    pre: int  # sweeps before the coarse correction
    post: int  # and after it
    smoother: _LevelSmoother | None = None  # in place of the sweeps

    @cached_property
    def load(self) -> np.ndarray:
        """Return the vector (n_dofs,) to which :meth:`restrict` of the next finer level writes."""
        return np.zeros(self.matrix.n_dofs)

    @cached_property
    def solution(self) -> np.ndarray:
        """Return the vector (n_dofs,) of the solution, which each cycle overwrites."""
        return np.zeros(self.matrix.n_dofs)

    @cached_property
    def rest(self) -> np.ndarray:
        """Return the vector (n_dofs,) in which :meth:`presmooth` leaves the residual."""
        return np.zeros(self.matrix.n_dofs)

    @cached_property
    def _transfer(self) -> tuple[tuple[float, ...], np.ndarray, np.ndarray, np.ndarray]:
        """Return zeros, one a component of the prolongation, and its arrays."""
        nodal = self.prolongation
        return ZERO[self.matrix.n_dofs // nodal.shape[0]], nodal.indptr, nodal.indices, nodal.data

    @cached_property
    def _scattering(self) -> list[list[tuple[int, int]]]:
        """Return the ranges of rows of the prolongation that threads may restrict at the same time."""
        return scattering(
            self.prolongation.indices, self.prolongation.indptr, 2 * self.matrix.n_dofs
        )

    def restrict(self, residual: np.ndarray, coarse: np.ndarray) -> float:
        """Restrict a residual (n_dofs,) to the level below, into ``coarse`` (n_dofs coarse,); return the sum
        of squares of the residual."""
        coarse[:] = 0.0
        squares = in_colours(self._scattering, restrict, *self._transfer, residual, coarse)
        coarse[self.below.matrix.fixed] = 0.0
        return sum(squares)

    def prolong(self, coarse: np.ndarray, to: np.ndarray, begin: np.ndarray | None = None) -> None:
        """Add P ``coarse``, a vector (n_dofs coarse,) of the level below, to a vector ``to`` (n_dofs,) of
        this level; with ``begin`` (n_dofs,) write ``begin`` + P ``coarse`` to it."""
        begin = to if begin is None else begin
        n = self.prolongation.shape[0]
        in_parts(add_prolonged, n, 2 * len(to), *self._transfer, coarse, begin, to)

    def presmooth(self, load: np.ndarray) -> float:
        """Smooth from zero, and leave the residual f - A u in ``rest``; return the passes over the
        matrix. f is the load (n_dofs,), u the ``solution``, A = L + D + U.

        Pairs of sweeps go forward and backward; an odd number has one more forward sweep in front of
        the pairs. A forward sweep leaves s = f - L u in ``rest`` and ends with D u = s - U u, where u on
        the right is that before the sweep, zero in the first one. A backward sweep keeps s and ends
        with D u = s - U u, where u is that after it."""
        matrix = self.matrix
        u = self.solution
        rest = self.rest
        if self.smoother is not None:
            u[:] = 0.0
            passes = self.smoother.smooth(load, u)
            rest[:] = load - self.smoother.matrix @ u
            return passes + 1
        if self.pre == 0:
            u[:] = 0.0
            rest[:] = load
            return 0.0
        lower = matrix.lower_arrays
        # the first sweep, whose U u is zero; gauss_seidel takes first whether it goes backward
        matrix.sweep(gauss_seidel, False, *lower, *matrix.no_half, matrix.inverse, load, u, rest)
        if self.pre == 1:
            # f - A u = -U u, since D u = f - L u
            rest[:] = 0.0
            matrix.sweep(subtract_half, *matrix.upper_arrays, u, rest)
            return 1.0  # L, U
        passes = 0.5  # L
        if self.pre % 2 == 1:
            self._forward(load)
            passes += 1.0  # L, U
        self._backward()
        for _ in range(self.pre // 2 - 1):
            self._forward(load)
            self._backward()
            passes += 1.5  # L, U; U
        # f - A u = f - s - L u, since D u = s - U u
        np.subtract(load, rest, out=rest)
        matrix.sweep(subtract_half, *lower, u, rest)
        return passes + 1.0  # U, L

    def postsmooth(self, load: np.ndarray, sweeps: int) -> float:
        """Smooth from the solution, for a load (n_dofs,), in the order that makes the cycle symmetric; return
        the passes over the matrix."""
        matrix = self.matrix
        u = self.solution
        if self.smoother is not None:
            return self.smoother.smooth(load, u)
        for _ in range(sweeps // 2):
            self._forward(load)
            self._backward()
        if sweeps % 2 == 1:
            matrix.sweep(
                gauss_seidel,
                True,  # backward
                *matrix.upper_arrays,
                *matrix.lower_arrays,
                matrix.inverse,
                load,
                u,
                self.rest,
                backward=True,
            )
        # a forward sweep reads L and U, the backward one after it U alone, a single one both
        return 1.5 * (sweeps // 2) + sweeps % 2

    def _forward(self, load: np.ndarray) -> None:
        """Sweep forward; leaves load - L u in ``rest``."""
        matrix = self.matrix
        halves = (*matrix.lower_arrays, *matrix.upper_arrays)
        # False: forward, as of gauss_seidel
        matrix.sweep(gauss_seidel, False, *halves, matrix.inverse, load, self.solution, self.rest)

    def _backward(self) -> None:
        """Sweep backward from ``rest``, in which a forward sweep left load - L u; it stays, as the first
        half of the matrix that the kernel reads, which it subtracts from there, has no entries."""
        matrix = self.matrix
        rest = self.rest
        halves = (*matrix.no_half, *matrix.upper_arrays)
        matrix.sweep(
            gauss_seidel, True, *halves, matrix.inverse, rest, self.solution, rest, backward=True
        )

    def residual(self, load: np.ndarray, u: np.ndarray) -> np.ndarray:
        """Return load - A u (n_dofs,) of a level that has its diagonal blocks; one pass."""
        matrix = self.matrix
        size = matrix.dim
        blocks = matrix.diagonal.reshape(-1, size, size)
        result = load - np.einsum("nij,nj->ni", blocks, u.reshape(-1, size)).reshape(-1)
        matrix.sweep(subtract_half, *matrix.lower_arrays, u, result)
        matrix.sweep(subtract_half, *matrix.upper_arrays, u, result)
        return result


class LinearCycle:
    """Cycles for the linear problem on any of the levels, coarsest first; ``recorder`` counts
    passes and notes the path."""

    def __init__(
        self,
        matrices: list[SplitMatrix],
        prolongations: list[sparse.csr_array],
        recorder: Recorder,
        sweeps: Sequence[int],
        coarse_solve: LinearSolve | None = None,
        coarse_smoother: LinearSmoother | None = None,
        correct: Cycle | LinearCorrection | None = None,
    ) -> None:
        """Prepare the solution of the coarse problems in one of three ways; ``sweeps`` has a number for
        each level.

        ``correct`` None
            A V-cycle, with this number of sweeps before the coarse correction and as many after it.
        ``correct`` a :class:`~adaptmg.multigrid.cycle.Cycle`
            A cycle of its shape, with its own numbers of sweeps on all levels in place of ``sweeps``.
        ``correct`` a :class:`LinearCorrection`
            It solves all coarse problems by itself: ``sweeps`` has no effect.
            :class:`~adaptmg.multigrid.truncated_parts.Truncated` refuses ``coarse_solve`` and
            ``coarse_smoother`` next to it.

        In both kinds of cycles ``coarse_solve`` replaces the LU factors of the coarsest problem. On
        each level above it one call of ``coarse_smoother`` replaces all sweeps before the coarse
        correction, and another one all sweeps after it."""
        self.levels: list[LinearLevel] = []
        self.recorder = recorder
        self.coarse_smoother = coarse_smoother
        self.cycle = correct if isinstance(correct, Cycle) else None
        self.correction = None if isinstance(correct, Cycle) else correct
        for matrix, prolongation, n_sweeps in zip(
            matrices, [None, *prolongations], sweeps, strict=True
        ):
            pre, post = (
                (n_sweeps, n_sweeps) if self.cycle is None else (self.cycle.pre, self.cycle.post)
            )
            below = self.levels[-1] if self.levels else None
            self.levels.append(LinearLevel(matrix, below, prolongation, pre, post))
        self.factors = CoarseFactors(matrices[0], coarse_solve)
        self._corrector: PreparedSolve | Any = None  # Any: made by renew before it is read

    @property
    def reads_diagonals(self) -> bool:
        """Return whether cycles read the diagonal blocks of coarse levels."""
        visits_twice = self.cycle is not None and self.cycle.shape != "V"
        return self.coarse_smoother is not None or self.correction is not None or visits_twice

    def renew(self, number: int) -> None:
        """Take over the matrices below level ``number``, which have changed."""
        if self.correction is not None:
            self._corrector = self._prepared(number)
            return
        self.factors.renew()
        if self.coarse_smoother is not None:
            for level in self.levels[1:number]:
                level.smoother = _LevelSmoother(self.coarse_smoother, level.matrix)

    def solve(self, number: int, load: np.ndarray, smooth: bool = True) -> np.ndarray:
        """Run the cycles of one correction from zero for a load (n_dofs,) of a level; return their
        sum. ``smooth`` False restricts the load unchanged, as a load that comes from a smoothed
        residual may be; one symmetric sweep then comes after."""
        if self.correction is not None:
            return self._corrected(number, load)
        if self.cycle is None:
            return self._visit(number, load, "V", smooth)
        return self._visits(number, load, self.cycle.shape)

    def _visits(self, number: int, load: np.ndarray, shape: str) -> np.ndarray:
        """Return the solution (n_dofs,) of a level for a load (n_dofs,) after one visit from the next finer
        one (V) or two (W; F: an F- and then a V-cycle)."""
        first, *second = VISITS[shape]
        solution = self._visit(number, load, first)
        if number > 0 and second:  # the coarsest level is solved
            level = self.levels[number]
            solution = solution.copy()
            residual = level.residual(load, solution)
            self.recorder.count(1.0, level.matrix.nonzeros)
            solution += self._visit(number, residual, second[0])
        return solution

    def _visit(self, number: int, load: np.ndarray, shape: str, smooth: bool = True) -> np.ndarray:
        """Return the solution (n_dofs,) of a level for a load (n_dofs,) after one cycle from zero;
        ``smooth`` False leaves out the sweeps before the coarse correction."""
        level = self.levels[number]
        recorder = self.recorder
        if number == 0:
            recorder.count(self.factors.solve(load, level.solution), level.matrix.nonzeros)
            recorder.visit(0, "solve")
            return level.solution
        passes = 0.0
        residual = load
        sweeps_after = 2  # a symmetric sweep, where there is none before
        if smooth:
            passes = level.presmooth(load)
            residual = level.rest
            sweeps_after = level.post
            recorder.visit(number, "smooth", level.pre)
        else:
            level.solution[:] = 0.0
        coarse_load = level.below.load
        level.restrict(residual, coarse_load)
        recorder.visit(number, "restrict")
        level.prolong(self._visits(number - 1, coarse_load, shape), level.solution)
        level.solution[level.matrix.fixed] = 0.0
        recorder.visit(number, "prolong")
        passes += level.postsmooth(load, sweeps_after)
        recorder.visit(number, "smooth", sweeps_after)
        recorder.count(passes, level.matrix.nonzeros)
        return level.solution

    def _prepared(self, number: int) -> PreparedSolve:
        """Set the user-defined correction up for the levels below ``number``."""
        coarse_matrices = [level.matrix for level in self.levels[:number]]
        matrices = [_with_full_diagonal(matrix) for matrix in coarse_matrices]
        prolongations = [
            by_dofs(level.prolongation, level.matrix.n_dofs) for level in self.levels[1:number]
        ]
        prepared = cast("LinearCorrection", self.correction).setup(matrices, prolongations)
        words = "an object with solve(rhs) -> solution"
        return checks.offers("correct: what setup returns", prepared, "solve", words)

    def _corrected(self, number: int, load: np.ndarray) -> np.ndarray:
        """Return the solution (n_dofs,) that a user-defined correction finds for a load of a
        level."""
        matrix = self.levels[number].matrix
        solution = np.array(
            checks.array("correct: what solve returns", self._corrector.solve(load), load.shape)
        )
        passes = getattr(self._corrector, "passes", 0.0)
        self.recorder.count(checks.nonnegative("correct: passes", passes), matrix.nonzeros)
        self.recorder.visit(number, "solve")
        solution[matrix.fixed] = 0.0
        return solution


def by_dofs(prolongation: sparse.csr_array, n_dofs: int) -> sparse.csr_array:
    """Return a prolongation of nodal values as one of dofs; one of dofs unchanged."""
    size = n_dofs // prolongation.shape[0]
    return sparse.kron(prolongation, sparse.eye_array(size), format="csr")


def _with_full_diagonal(level: SplitMatrix) -> sparse.csr_array:
    """Return the matrix for user-defined methods, which may divide by the diagonal: the empty rows of
    fixed and truncated dofs get the largest diagonal entry."""
    return _regular_sparse(level, np.full(level.n_dofs, level.diagonal_sizes.max()))


class CoarseFactors:
    """Solves with the coarsest matrix by dense or sparse factors. The diagonal of a singular matrix is
    shifted at the dofs that are not determined.

    Truncation leaves coarse dofs near contact that no remaining fine dof tells apart, mostly the
    same ones each time: their shift stays, so that each matrix is factorised once. Where a later
    matrix is regular there, a shift of 1e-6 of the diagonal hardly changes the correction. Of bodies
    that only contact holds no dof is determined."""

    #: dofs up to which dense factors are quicker
    DENSE = 1500

    def __init__(self, level: SplitMatrix, custom: LinearSolve | None = None) -> None:
        """Prepare for the matrices of the coarsest level; ``custom`` replaces the factors."""
        self.level = level
        self.custom = custom
        scale = level.diagonal_sizes
        # at dofs without stiffness, as idle ones, the largest; 1 if no dof has any
        self._scale = np.where(scale > 0, scale, scale.max() or 1.0)
        self.forget()  # sets the shift
        # tells by one solve which dofs the matrix determines, see renew
        self._probe_load = self._scale * np.random.default_rng(0).standard_normal(level.n_dofs)
        # Any: made by renew before it is read
        self._solve: Callable[[np.ndarray], np.ndarray] | Any = None
        self._prepared: PreparedSolve | None = None

    def forget(self) -> None:
        """Set the shift to zero, as before the first matrix."""
        self._shift = np.zeros(self.level.n_dofs)

    def renew(self) -> None:
        """Factorise the matrix that has changed, and shift it where it is singular."""
        if self.custom is not None:
            self._prepared = checks.offers(
                "coarse_solve: what setup returns",
                self.custom.setup(_regular_sparse(self.level, self._scale)),
                "solve",
                "an object with solve(rhs) -> solution",
            )
            return
        self._solve = self._factors(self._shift)
        # the probe, a random load of the size of the diagonal, has a part along every motion that the
        # matrix leaves free. It moves a dof by about 1, or by 1 / rounding and more (infinite, NaN) where
        # only rounding determines it
        undetermined = ~(np.abs(self._solve(self._probe_load)) < 1 / checks.ROUNDING)
        if undetermined.any():
            self._shift = np.where(undetermined, checks.SIX_DIGITS * self._scale, self._shift)
            self._solve = self._factors(self._shift)

    def _factors(self, shift: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Return the solve with the matrix and a shift (n_dofs,) of its diagonal."""
        if self.level.n_dofs <= self.DENSE:
            matrix = _regular_dense(self.level, self._scale)
            matrix.flat[:: len(shift) + 1] += shift  # the diagonal
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
    """Return a solve with a matrix; solutions of a singular one are vast, infinite or NaN."""
    # LAPACK itself: scipy's wrapper warns of singular matrices, which the caller handles
    factors, pivots, _ = linalg.lapack.dgetrf(matrix)
    return lambda load: linalg.lapack.dgetrs(factors, pivots, load)[0]


def _sparse_factors(matrix: sparse.csr_array) -> Callable[[np.ndarray], np.ndarray]:
    """Return a solve as :func:`_dense_factors` does, by SuperLU."""
    try:
        # pivots on the diagonal cause less fill; except for the slip rows of Coulomb's law the
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


class PreparedSolve(Protocol):
    """A matrix made ready for solves."""

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Return the solution (n_dofs,) for a right-hand side (n_dofs,)."""
        ...


class PreparedSmoother(Protocol):
    """A matrix made ready for sweeps."""

    def smooth(self, rhs: np.ndarray, x: np.ndarray) -> float:
        """Improve x (n_dofs,) in place; returns the passes over the matrix that it took."""
        ...


class LinearSolve(Protocol):
    """A user-defined solver of the coarsest linear problems."""

    def setup(self, matrix: sparse.csr_array) -> PreparedSolve:
        """Prepare for a matrix (n_dofs, n_dofs), whenever the contact status changes it. It has a
        diagonal entry alone where dofs are fixed or truncated; with Coulomb friction it is not
        symmetric; where only contact holds a body it may be singular. The passes over the matrix
        that the object's ``passes`` names for its last solve, if it has them, are counted as
        work."""
        ...


class LinearSmoother(Protocol):
    """A user-defined smoother of the linear problems between the coarsest level and the finest."""

    def setup(self, matrix: sparse.csr_array) -> PreparedSmoother:
        """Prepare for a matrix; see :meth:`LinearSolve.setup`."""
        ...


class LinearCorrection(Protocol):
    """A user-defined solver, or some cycles, of the linear problem below the finest level."""

    def setup(
        self, matrices: list[sparse.csr_array], prolongations: list[sparse.csr_array]
    ) -> PreparedSolve:
        """Prepare for the matrices (coarsest first; the last one is solved with) and the
        prolongations (n_dofs, n_dofs of the next coarser level) between them, whenever the contact
        status changes them; see :meth:`LinearSolve.setup`."""
        ...


@dataclass(frozen=True, kw_only=True)
class PyAMG(checks.Checked):
    """Cycles of pyamg on the truncated coarse problems, ``am.Truncated(correct=am.PyAMG())``.

    Parameters
    ----------
    cycle : {"V", "W", "F", "AMLI"}
    smoother : str
        One of ``pyamg.relaxation``, before and after the coarse correction; a symmetric sweep.
    cycles : int
        Cycles a correction.

    Notes
    -----
    Matrices and prolongations are those of the hierarchy; pyamg brings cycles and sweeps
    (``pyamg.MultilevelSolver``). Its sweeps are pointwise. The coarsest problem is solved by a
    pseudo-inverse up to 400 dofs, above by LU factors.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4, 8))
    >>> solver = am.FullMultigrid(correction=am.Truncated(correct=am.PyAMG(cycle="W")))
    >>> am.solve(grids, solver).status.name
    'CONVERGED'
    """

    cycle: Literal["V", "W", "F", "AMLI"] = "V"
    smoother: Literal["gauss_seidel", "block_gauss_seidel", "sor"] = "gauss_seidel"
    cycles: checks.Count = 1

    def setup(
        self, matrices: list[sparse.csr_array], prolongations: list[sparse.csr_array]
    ) -> PreparedSolve:
        """Make the levels of pyamg; see :class:`LinearCorrection`."""
        import pyamg

        levels = []
        for matrix, prolongation in zip(
            reversed(matrices), [*reversed(prolongations), None], strict=True
        ):
            level: Any = pyamg.MultilevelSolver.Level()  # pyamg has no stubs
            level.A = _with_small_indices(matrix)
            if prolongation is not None:
                level.P = _with_small_indices(prolongation)
                level.R = _with_small_indices(level.P.T)
            levels.append(level)
        coarse = "pinv" if matrices[0].shape[0] <= _PSEUDO_INVERSE else "splu"
        multilevel = pyamg.MultilevelSolver(levels, coarse_solver=coarse)
        sweep = (self.smoother, {"sweep": "symmetric", "iterations": 1})
        pyamg.relaxation.smoothing.change_smoothers(multilevel, sweep, sweep)
        return _PyAMGCycles(self, multilevel)


def _with_small_indices(matrix: Any) -> sparse.csr_matrix:
    """Return a matrix with 32-bit indices, which pyamg 5.2 needs; sums and products of scipy 1.15 have
    64-bit ones."""
    result = sparse.csr_matrix(matrix)
    result.indptr = result.indptr.astype(np.int32)
    result.indices = result.indices.astype(np.int32)
    return result


#: dofs up to which pyamg solves the coarsest problem by a pseudo-inverse, which a singular matrix has, too: 0.03 s at
#: 400, 0.2 s at 800, 1.6 s at 1600, for each contact status
_PSEUDO_INVERSE = 400


class _PyAMGCycles:
    """Cycles of pyamg for one matrix."""

    def __init__(self, options: PyAMG, multilevel: Any) -> None:
        self.options = options
        self.multilevel = multilevel
        # a cycle of pyamg counts in passes over the finest of its matrices, sweeps included
        self.passes = options.cycles * multilevel.cycle_complexity(cycle=options.cycle)

    def solve(self, rhs: np.ndarray) -> np.ndarray:
        """Return the result of the cycles from zero."""
        options = self.options
        # no test of the residual: the number of cycles is fixed
        return self.multilevel.solve(rhs, maxiter=options.cycles, tol=1e-300, cycle=options.cycle)


def regular_matrix(level: SplitMatrix, scale: np.ndarray) -> sparse.bsr_array:
    """Return the matrix of a level, with ``scale`` (n_dofs,) on the diagonal of rows whose entries are
    all rounding."""
    matrix = level.matrix()
    row = np.repeat(np.arange(level.n_nodes), np.diff(matrix.indptr))
    sizes = np.zeros((level.n_nodes, level.dim))
    np.add.at(sizes, row, np.abs(matrix.data).sum(axis=2))
    node, component = np.nonzero(sizes <= checks.ROUNDING * scale.reshape(sizes.shape))
    place = diagonal_places(matrix)[node]
    matrix.data[place, component, component] = scale[level.dim * node + component]
    return matrix


def _regular_sparse(level: SplitMatrix, scale: np.ndarray) -> sparse.csr_array:
    """Return :func:`regular_matrix` by dofs, without zeros."""
    matrix = sparse.csr_array(regular_matrix(level, scale))
    matrix.eliminate_zeros()
    return matrix


def _regular_dense(level: SplitMatrix, scale: np.ndarray) -> np.ndarray:
    """Return :func:`regular_matrix` as a dense one (n_dofs, n_dofs). By way of the sparse one a solve of
    1089 nodes takes 5 % more: each status makes a new one."""
    matrix = level.dense()
    empty = np.flatnonzero(np.abs(matrix).sum(axis=1) <= checks.ROUNDING * scale)
    matrix[empty, empty] = scale[empty]
    return matrix


class _LevelSmoother:
    """A :class:`LinearSmoother` set up for the matrix of a level."""

    def __init__(self, custom: LinearSmoother, level: SplitMatrix) -> None:
        self.matrix = _with_full_diagonal(level)
        self._smoother = checks.offers(
            "coarse_smoother: what setup returns",
            custom.setup(self.matrix),
            "smooth",
            "an object with smooth(rhs, x) -> passes",
        )

    def smooth(self, load: np.ndarray, unknowns: np.ndarray) -> float:
        passes = self._smoother.smooth(load.copy(), unknowns)
        return checks.nonnegative("coarse_smoother: the passes that smooth returns", passes)


def least_weights(products: np.ndarray, loads: np.ndarray) -> np.ndarray:
    """Return the alpha (k,) that minimise the norm of r + alpha C, squares weighted with W, from
    C W C' (k, k), which is overwritten, and -C W r (k,)."""
    # a diagonal that is raised by rounding: changes C may be dependent, or zero
    diagonal = products.reshape(-1)[:: len(products) + 1]  # a view
    diagonal *= 1.0 + checks.ROUNDING
    diagonal[diagonal == 0.0] = 1.0
    # LAPACK itself: numpy's least squares take ten times as long as all products of a small problem
    return linalg.lapack.dposv(products, loads)[1]
