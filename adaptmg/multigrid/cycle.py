r"""The multigrid cycle of the monotone and the paper's correction, its coarse solve and its nested start.

Fig. 1 of the paper shows the shapes of the cycle. The coarsest problem is condensed to its contact dofs first, as the
paper does ('a condensation of the problem to the contact variables alone'): one factorisation in the set-up, far fewer
sweeps, on a small dense matrix. Sweeps go in batches; with :math:`\delta_m` the change over batch m in the norm of the
diagonal blocks and :math:`\rho = \delta_m/\delta_{m-1}` the remaining error is estimated as
:math:`\delta_m\,\rho/(1-\rho)`, without a matrix pass. The paper's test is on the change of one sweep alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.multigrid.corrections import (
    Correction,
    CorrectionLevel,
    InitialContact,
    Recorder,
    correction_contact,
    sliding_limit,
)
from adaptmg.smoother.gauss_seidel import ProjectedGaussSeidel, Smoother
from adaptmg.smoother.system import LocalProblem, LocalSystem, NodalContact


class Condensation(Protocol):
    """A matrix condensed to its contact dofs; :class:`adaptmg.smoother.factorisation.Condensed` is one."""

    @property
    def problem(self) -> LocalProblem: ...

    def restrict(self, unknowns: np.ndarray) -> np.ndarray: ...

    def reduce(self, residual: np.ndarray) -> tuple[np.ndarray, np.ndarray]: ...

    def complete(self, particular: np.ndarray, unknowns: np.ndarray) -> np.ndarray: ...


@dataclass(frozen=True, kw_only=True)
class Cycle:
    """Shape of a cycle.

    Parameters
    ----------
    shape : {"V", "W", "F", "complete"}
        How often a coarse problem is visited: once, twice, once fully and once as V, or until it is solved to the
        tolerance of the coarse solve (the paper's 'complete resolution').
    pre, post : int
        Smoothing sweeps before and after the coarse correction, not both 0.

    Examples
    --------
    >>> am.Multigrid(correction=am.Monotone(), cycle=am.Cycle(shape="W", pre=1, post=1)).cycle.shape
    'W'
    """

    shape: str = "V"
    pre: int = 2
    post: int = 0

    def __post_init__(self) -> None:
        checks.choice("shape", self.shape, ("V", "W", "F", "complete"))
        checks.integer("pre", self.pre)
        checks.integer("post", self.post)
        if self.pre + self.post == 0:
            raise ValueError("pre and post must not both be 0: without smoothing the cycle does not converge")


@dataclass(eq=False)
class MultigridCycle:
    """Cycles on the levels of a coarse correction; unknowns are changed in place."""

    levels: list[CorrectionLevel]  # coarsest first
    options: Cycle
    smoother: Smoother
    correction: Correction
    coarse: CoarseSolve
    recorder: Recorder
    initial: list[InitialContact] = field(default_factory=list)  # by level, where the correction needs it
    condensed: Condensation | None = None

    #: cycles of a 'complete' coarse solution at most
    COMPLETE_LIMIT = 60

    def cycle(self, level: int, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray, shape: str) -> None:
        """Run one cycle on a level >= 1: smooth, correct from the next coarser level, smooth."""
        self.smooth(level, contact, load, unknowns, self.options.pre)
        self.correct(level, contact, unknowns, self.residual(level, load, unknowns), shape)
        self.smooth(level, contact, load, unknowns, self.options.post)

    def solve(self, level: int, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray, shape: str) -> None:
        """Solve the problem of a level as the shape of the cycle says."""
        if level == 0:
            self.solve_coarsest(contact, load, unknowns)
        elif shape == "complete":
            self._complete(level, contact, load, unknowns)
        else:
            for each in {"V": "V", "W": "WW", "F": "FV"}[shape]:
                self.cycle(level, contact, load, unknowns, each)

    def correct(self, level: int, contact: NodalContact, unknowns: np.ndarray, r: np.ndarray,
                shape: str | None = None) -> None:
        """Add the correction from the next coarser level; ``r`` is the residual at ``unknowns``."""
        fine, coarse = self.levels[level], self.levels[level - 1]
        initial = self.initial[level - 1] if self.correction.needs_initial else None
        data = correction_contact(self.correction, fine.supports, fine.system, coarse.system, contact,
                                  unknowns, r, initial)
        self.recorder.visit(level, "restrict")
        load = fine.restriction @ r
        error = np.zeros(coarse.system.n_dofs)
        self.solve(level - 1, data, load, error, self.options.shape if shape is None else shape)
        unknowns += fine.prolongation @ error
        self.recorder.visit(level, "prolong")

    def smooth(self, level: int, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray, sweeps: int) -> None:
        if sweeps:
            system = self.levels[level].system
            passes = self.smoother.smooth(system, contact, load, unknowns, sweeps)
            self.recorder.count(passes, system.nonzeros)
            self.recorder.visit(level, "smooth", sweeps)

    def residual(self, level: int, load: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
        """Return b - A w on a level (n_dofs,), one pass."""
        system = self.levels[level].system
        self.recorder.count(1, system.nonzeros)
        return load - system.matrix @ unknowns

    def solve_coarsest(self, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray) -> None:
        if self.condensed is None:
            sweeps = self.coarse.solve(self.levels[0].system, contact, load, unknowns, self.recorder)
        else:
            particular, reduced = self.condensed.reduce(load)
            part = self.condensed.restrict(unknowns)
            sweeps = self.coarse.solve(self.condensed.problem.system, contact, reduced, part, self.recorder)
            unknowns[:] = self.condensed.complete(particular, part)
        self.recorder.visit(0, "solve", sweeps)

    def _complete(self, level: int, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray) -> None:
        """Cycles until the estimated error meets the tolerance of the coarse solve."""
        change = np.inf
        for _ in range(self.COMPLETE_LIMIT):
            before = unknowns.copy()
            self.cycle(level, contact, load, unknowns, "complete")
            previous, change = change, float(np.linalg.norm(unknowns - before))
            rate = change / previous if np.isfinite(previous) else np.inf
            remaining = change if self.coarse.test == "change" else change * rate / (1 - rate) if rate < 1 else np.inf
            if change == 0.0 or remaining <= self.coarse.rtol * float(np.linalg.norm(unknowns)) + self.coarse.atol:
                break


@dataclass(frozen=True, kw_only=True)
class CoarseSolve:
    """Sweeps of projected Gauss-Seidel (SOR) to a tolerance.

    Parameters
    ----------
    condensed : bool
        Sweep on the Schur complement of the contact dofs on the coarsest level, whose entries are counted as work; the
        factorisation and its solves are reported as seconds.
    rtol : float
        Tolerance relative to the solution of the coarse problem: for ``test="error"`` of the estimated error in the
        norm of the diagonal blocks, for ``test="change"`` of the Euclidean change in one sweep.
    atol : float
        Absolute tolerance added to it, in m, on the Euclidean norm (``test="change"`` only).
    test : {"error", "change"}
    omega : float
        Over-relaxation.
    max_sweeps : int
        Sweeps at most; the last iterate is used.

    Examples
    --------
    >>> am.Multigrid(correction=am.Monotone(), coarse=am.CoarseSolve(rtol=1e-3)).coarse.rtol
    0.001
    """

    condensed: bool = True
    rtol: float = 1e-2
    atol: float = 0.0
    test: str = "error"
    omega: float = 1.5
    max_sweeps: int = 2000

    #: sweeps between tests of the error
    BATCH = 4

    def __post_init__(self) -> None:
        object.__setattr__(self, "rtol", checks.nonnegative("rtol", self.rtol))
        object.__setattr__(self, "atol", checks.nonnegative("atol", self.atol))
        if not self.rtol < 1:
            raise ValueError(f"rtol must be < 1, a share of the solution, got {checks.shown(self.rtol)}")
        checks.flag("condensed", self.condensed)
        if self.rtol == 0 and self.atol == 0:
            raise ValueError("rtol and atol must not both be 0")
        checks.choice("test", self.test, ("error", "change"))
        if self.atol > 0 and self.test == "error":
            raise ValueError("atol is for test='change'; give rtol with test='error'")
        ProjectedGaussSeidel(omega=self.omega)
        checks.integer("max_sweeps", self.max_sweeps, 1)

    def solve(self, system: LocalSystem, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray,
              recorder: Recorder) -> int:
        """Sweep until the tolerance is met, changing ``unknowns`` (n_dofs,) in place; returns the number of sweeps."""
        smoother = ProjectedGaussSeidel(omega=self.omega)
        batch = self.BATCH if self.test == "error" else 1
        norm = self._block_norm(system) if self.test == "error" else np.linalg.norm
        before, sweeps, change = unknowns.copy(), 0, np.inf
        while sweeps < self.max_sweeps:
            passes = smoother.smooth(system, contact, load, unknowns, batch)
            recorder.count(passes, system.nonzeros)
            sweeps += batch
            previous, change = change, float(norm(unknowns - before))
            size = float(norm(unknowns))
            if not np.isfinite(size) or change == 0.0:
                break
            if self.test == "change":
                error = change
            else:
                rate = change / previous if np.isfinite(previous) else np.inf
                error = change * rate / (1 - rate) if rate < 1 else np.inf
            if error <= self.rtol * size + self.atol:
                break
            before[:] = unknowns
        return sweeps

    @staticmethod
    def _block_norm(system: LocalSystem) -> Callable[[np.ndarray], float]:
        blocks = system.diagonal.reshape(-1, system.dim, system.dim)

        def norm(vector: np.ndarray) -> float:
            v = vector.reshape(-1, system.dim)
            return float(np.sqrt(np.einsum("ni,nij,nj->", v, blocks, v)))

        return norm


@dataclass(frozen=True, kw_only=True)
class NestedStart:
    """How the levels below the finest are solved before it.

    Parameters
    ----------
    cycles : int or "complete", optional
        Cycles on each level between the coarsest and the finest, or until ``rtol`` is met. Default: 1, and 2 where
        bodies touch each other (interpolation carries the edges of their contact less well) on levels that the next
        one outnumbers ``CHEAP`` times.
    rtol : float
        Tolerance on the coarsest level, and with 'complete' on all levels below the finest.

    Examples
    --------
    >>> am.FullMultigrid(start=am.NestedStart(cycles=1)).start.cycles
    1
    """

    #: nodes of the next level over those of this one from which on a second cycle costs less than it saves
    CHEAP: ClassVar[float] = 3.0

    cycles: int | str | None = None
    rtol: float = 1e-8

    def __post_init__(self) -> None:
        if self.cycles is not None and not (isinstance(self.cycles, str) and self.cycles == "complete"):
            checks.integer("cycles", self.cycles, 1)
        object.__setattr__(self, "rtol", checks.tolerance("rtol", self.rtol))

    def cycles_on(self, problem: DiscreteProblem, finer: DiscreteProblem) -> int:
        """Return the number of cycles on a level with this problem below one with that, unless complete."""
        if self.cycles is None:
            return 1 if problem.coupling is None or finer.n_nodes < self.CHEAP * problem.n_nodes else 2
        return int(self.cycles)


def project(local: LocalProblem, unknowns: np.ndarray) -> None:
    """Put normal displacements that exceed the gap back onto the obstacle, in place."""
    normal = local.system.nodes.astype(np.int64) * local.system.dim
    unknowns[normal] = np.minimum(unknowns[normal], local.contact.gap)


def prolonged_start(nodal: sparse.csr_array, coarse: LocalProblem, unknowns: np.ndarray,
                    fine: LocalProblem) -> np.ndarray:
    """Interpolate a coarse solution (primal values, all Cartesian components) to the next finer level."""
    result = fine.to_local(nodal @ coarse.to_cartesian(unknowns))
    project(fine, result)
    return result


def initial_contact(local: LocalProblem, unknowns: np.ndarray, residual: np.ndarray) -> InitialContact:
    """Return the slip and sliding limit of a first solution (the paper's U0 and G0)."""
    system = local.system
    slip = unknowns.reshape(-1, system.dim)[system.nodes][:, 1:] - local.contact.slip_reference
    return InitialContact(slip, sliding_limit(system, local.contact, residual))
