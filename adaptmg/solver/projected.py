"""Projected methods: SingleGrid, projected SOR on one grid, the paper's 'regular resolution'; and
ProjectedRun, cycles of contact problems on all levels, for corrections that transport contact data.

The monotone and the paper's corrections are such; see :mod:`adaptmg.multigrid.cycle`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import ClassVar, Literal

import numpy as np

from adaptmg import _checks as checks
from adaptmg.grids import Grids
from adaptmg.multigrid.cycle import (
    CoarseSolve,
    Correction,
    Cycle,
    InitialContact,
    MultigridCycle,
    NestedStart,
    correction_levels,
    initial_contact,
    project,
)
from adaptmg.smoother.factorisation import Condensed, condense
from adaptmg.smoother.gauss_seidel import Omega, ProjectedGaussSeidel, Smoother
from adaptmg.smoother.system import local_system
from adaptmg.solver.examine import Sizes
from adaptmg.solver.iterate import Measure, Smoothing, State
from adaptmg.solver.record import Outcome, Run, Status
from adaptmg.solver.steps import LocalLevels


@dataclass(eq=False, kw_only=True)
class ProjectedRun:
    """One run of multigrid with a correction that transports gap, slip and limit; options as of
    :class:`adaptmg.Multigrid`."""

    hierarchy: Grids
    run: Run
    cycle: Cycle
    smoother: Smoother
    correction: Correction
    coarse: CoarseSolve
    coarse_matrices: str
    stop: str
    rtol: float
    max_cycles: int
    initial: list[InitialContact] = field(default_factory=list, init=False)

    def __post_init__(self) -> None:
        """Refuse problems that the correction cannot take, and prepare the levels."""
        self.hierarchy.need_discretised(f"the correction {type(self.correction).__name__}")
        self.hierarchy.finest.discrete.need_no_volumes(
            f"the correction {type(self.correction).__name__}"
        )
        if self.hierarchy.finest.discrete.contact.compliance.any():
            raise ValueError(
                f"contact: the correction {type(self.correction).__name__} cannot take NormalCompliance; "
                "use correction=am.Truncated()"
            )
        self.levels = LocalLevels(self.hierarchy, self.run)
        self.problems = [self.levels.problem(number) for number in range(len(self.hierarchy))]

    def from_given(self, start: np.ndarray | None) -> Outcome:
        """Solve from a solution (n_dofs,), or from zero. A nested start comes before it only for the
        first solutions that the correction remembers."""
        if self.correction.needs_initial:
            self.nested_start(NestedStart())
        return self.finish(self.levels.begin(start))

    def from_nested(self, start: NestedStart) -> Outcome:
        return self.finish(self.nested_start(start))

    def cycle_of_states(self) -> Callable[[State], State]:
        """Return a cycle on the finest level from state to state, which smooths a start; the nested start
        comes first only for the first solutions that the correction remembers."""
        if self.correction.needs_initial:
            self.nested_start(NestedStart())
        return self._cycles(self.multigrid(len(self.hierarchy) - 1)).step

    def multigrid(self, finest: int) -> MultigridCycle:
        """Build cycles on level ``finest`` and those below. The coarsest problem is ``condensed`` if its
        options say so: everything but its contact nodes is eliminated."""
        with self.run.phase("setup"):
            levels = correction_levels(self.hierarchy, self.problems, finest, self.coarse_matrices)
        condensed = None
        if self.coarse.condensed:
            with self.run.phase("factorise"):
                system = levels[0].system
                # without loads: each cycle brings its own
                coarsest = replace(self.problems[0], system=system, load=np.zeros(system.n_dofs))
                # lenient: where the next mesh is locally the coarser one, some coarse functions
                # vanish on it
                condensed = condense(coarsest, lenient=True)
                if not condensed.by_nodes:
                    # a block of the Schur complement is singular: sweeps go over all nodes instead
                    condensed = None
        return MultigridCycle(
            levels=levels,
            options=self.cycle,
            smoother=self.smoother,
            correction=self.correction,
            coarse=self.coarse,
            recorder=self.run,
            initial=self.initial,
            condensed=condensed,
        )

    def nested_start(self, start: NestedStart) -> np.ndarray:
        """Return the start (n_dofs,) on the finest level, after solves level by level from the coarsest
        (steps a and b of the paper)."""
        return self.levels.nested(partial(self._coarsest, start), partial(self._cycled, start))

    def _coarsest(self, start: NestedStart) -> np.ndarray:
        """Return the first solution (n_dofs,) of the coarsest level, local components."""
        multigrid = self.multigrid(0)
        local = self.problems[0]
        unknowns = np.zeros(local.system.n_dofs)
        project(local, unknowns)
        # more accurate than in the cycles, by the tolerance of the nested start
        multigrid.coarse = replace(self.coarse, rtol=start.rtol, atol=0.0, test="error")
        multigrid.solve_coarsest(local.contact, local.load, unknowns)
        self._remember(multigrid, 0, unknowns)
        return unknowns

    def _cycled(self, start: NestedStart, level: int, unknowns: np.ndarray) -> np.ndarray:
        """Return the first solution (n_dofs,) of a level between the coarsest and the finest: the start
        ``unknowns`` (n_dofs,), changed in place by a few cycles."""
        multigrid = self.multigrid(level)
        local = self.problems[level]
        for _ in range(start.cycles):
            multigrid.cycle(level, local.contact, local.load, unknowns, self.cycle.shape)
        self._remember(multigrid, level, unknowns)
        return unknowns

    def _remember(self, multigrid: MultigridCycle, level: int, unknowns: np.ndarray) -> None:
        """Store slips and limits of a first solution (n_dofs,), if the correction needs them."""
        if self.correction.needs_initial:
            local = self.problems[level]
            r = multigrid.residual(level, local.load, unknowns)
            self.initial.append(initial_contact(local, unknowns, r))

    def finish(self, unknowns: np.ndarray) -> Outcome:
        """Run cycles on the finest level from ``unknowns`` (n_dofs,), local components."""
        multigrid = self.multigrid(len(self.hierarchy) - 1)
        with self.run.phase("cycles"):
            state, status, stop = self._cycles(multigrid).solve(
                unknowns, self.stop, self.rtol, self.max_cycles, self.run, self.levels.shortfall
            )
        return self.levels.outcome(state, status, stop, self.rtol)

    def _cycles(self, multigrid: MultigridCycle) -> Smoothing:
        """Return cycles on the finest level in two halves: the iterate is measured between them, since
        the cycle needs its residual there anyway."""
        level = len(self.hierarchy) - 1
        local = self.problems[level]

        def smooth(unknowns: np.ndarray, cycles: int) -> int:
            multigrid.smooth(level, local.contact, local.load, unknowns, self.cycle.pre)
            return 0  # corrections count as cycles, not these sweeps

        def correct(unknowns: np.ndarray, r: np.ndarray) -> None:
            multigrid.correct(level, local.contact, unknowns, r)
            multigrid.smooth(level, local.contact, local.load, unknowns, self.cycle.post)

        def residual(unknowns: np.ndarray) -> np.ndarray:
            return multigrid.residual(level, local.load, unknowns)

        return Smoothing(Measure(local, self.run), smooth, residual, correct)


@dataclass(frozen=True, kw_only=True)
class SingleGrid(checks.Checked):
    """Projected Gauss-Seidel / SOR on the finest grid alone.

    Parameters
    ----------
    omega : float
        Over-relaxation, 0 < omega < 2; the best value depends on the mesh.
    condensed : bool
        Eliminate all but the contact dofs first (one factorisation, reported as time, not as work
        units) and sweep on the dense Schur complement, whose entries are counted.
    stop : {"error", "change"}
        Test the estimated relative A-norm error and the natural residual, or (as the paper) the
        relative Euclidean change in one sweep alone.
    rtol : float
        Tolerance of that test; where initial strains act, relative to u without what expands
        freely.
    max_sweeps : int

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.solve(grids, am.SingleGrid(omega=1.5)).status.name
    'CONVERGED'
    """

    #: sweeps between the first checks; later checks come every CHECK_SHARE of the sweeps done
    FIRST_CHECK: ClassVar[int] = 10
    #: 10 387 sweeps of five random problems are 10 264 with half and 10 504 with twice
    CHECK_SHARE: ClassVar[float] = 0.1

    #: there is only one grid
    reads_coarse_starts: ClassVar[bool] = False

    omega: Omega = 1.0
    condensed: checks.Flag = False
    stop: Literal["error", "change"] = "error"
    rtol: checks.Tolerance = 1e-8
    max_sweeps: checks.Count = 200_000

    def run(self, hierarchy: Grids, run: Run, start: np.ndarray | None) -> Outcome:
        """Sweep on the finest level, or on its Schur complement, from ``start`` (n_dofs,) or zero, until the
        test ends it."""
        hierarchy.finest.discrete.need_no_volumes("SingleGrid")
        if self.stop == "change":
            hierarchy.finest.discrete.need_given_friction(
                'SingleGrid(stop="change")', 'stop="error"'
            )
        with run.phase("setup"):
            full = local_system(hierarchy.finest.discrete)
        problem = full
        sizes = None
        # between the unknowns of all nodes and those of the sweeps: the same unless condensed
        restrict = np.asarray
        recover = np.asarray
        if self.condensed:
            with run.phase("factorise"):
                condensed = condense(full)
                if not condensed.by_nodes:
                    raise ValueError(
                        "condensed=True needs more contact nodes: with all but one fixed, a body that "
                        "only contact holds can still move; use condensed=False"
                    )
                problem = condensed.problem
                sizes = _CondensedSizes(condensed)
                restrict = condensed.restrict
                recover = condensed.recover
        unknowns = restrict(np.zeros(full.system.n_dofs) if start is None else full.to_local(start))
        project(problem, unknowns)
        # the Schur complement gives the energy of the error of the recovered solution, too
        reference = None if run.reference is None else restrict(full.to_local(run.reference))
        smoother = ProjectedGaussSeidel(omega=self.omega)

        def smooth(unknowns: np.ndarray, done: int) -> int:
            """Sweep in place, after ``done`` sweeps, until the next check; return the number of sweeps."""
            # with stop="change" each sweep is judged
            sweeps_to_check = max(self.FIRST_CHECK, int(self.CHECK_SHARE * done))
            sweeps = min(sweeps_to_check, self.max_sweeps - done) if self.stop == "error" else 1
            passes = smoother.smooth(
                problem.system, problem.contact, problem.load, unknowns, sweeps
            )
            run.count(passes, problem.system.nonzeros)
            return sweeps

        def residual(unknowns: np.ndarray) -> np.ndarray:
            run.count(1.0, problem.system.nonzeros)
            return problem.residual(unknowns)

        norms = Measure(problem, run=run, reference=reference, sizes=sizes)
        with run.phase("sweeps"):
            # batches that reach no new smallest change are cycling
            state, status, stop = Smoothing(norms, smooth, residual).solve(
                unknowns,
                self.stop,
                self.rtol,
                self.max_sweeps,
                run,
                lambda state, rtol: run.shortfall(full.to_cartesian(recover(state.unknowns)), rtol),
                stalled=Status.CYCLING,
            )
        run.visit(len(hierarchy) - 1, "smooth", state.cycles)
        with run.phase("factorise" if self.condensed else "sweeps"):
            solved = full.to_cartesian(recover(state.unknowns)).reshape(-1)
        return Outcome(
            solution=solved,
            status=status,
            cycles=state.cycles,
            rtol=self.rtol,
            error_estimate=stop.error_estimate,
            # of one sweep: the memory is the number of sweeps between two checks
            rate=stop.rate ** (1 / state.memory) if np.isfinite(stop.rate) else np.nan,
        )


class _CondensedSizes(Sizes):
    """Sizes of the whole solution, from the unknowns at the contact nodes alone."""

    def __init__(self, condensed: Condensed) -> None:
        full = condensed.full
        super().__init__(full.discrete, full.frames)
        self._condensed = condensed
        hidden = condensed.recover(np.zeros(condensed.problem.system.n_dofs))
        # the energy of the interior that is missing in the Schur complement
        self._hidden = float(np.einsum("i,i->", hidden, full.system.matrix @ hidden))

    def norm(self, unknowns: np.ndarray, energy: float) -> float:
        return super().norm(self._whole(unknowns), energy + self._hidden)

    def forces(self, unknowns: np.ndarray, contact: float) -> float:
        return super().forces(self._whole(unknowns), contact)

    def nothing_strains(self, contact: float, rounding: float, unknowns: np.ndarray) -> bool:
        return super().nothing_strains(contact, rounding, self._whole(unknowns))

    def _whole(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the unknowns (n_dofs,) of all nodes, where the norms need others than those at contact; else
        those at contact (n_contact * dim,) unchanged."""
        needed = self.prescribed or self._problem.strain_free is not None
        return self._condensed.recover(unknowns) if needed else unknowns
