"""Multigrid and FullMultigrid: the multigrid methods from a given start and from a nested one.

The correction chooses between two methods: :class:`~adaptmg.solver.truncated.TruncatedRun` for
Truncated(), and
:class:`~adaptmg.solver.projected.ProjectedRun` for corrections that transport contact data to coarser levels, whose
options are None where they are not given.

Where the truncated multigrid does not converge, :func:`handed_over` goes on for the cycles that are
left: on problems of moderate size with the active set method, which needs the finest level alone
and few steps, but factorisations; on larger ones with the monotone correction, which is slow but
needs no more memory, and which nearly incompressible bodies do not have: these begin again from zero on
every second level. A Newton step counts as a cycle, and its residual as one pass over the finest
matrix; factorisations count as seconds. :func:`from_finest` goes the other way on small problems:
it begins with the active set method."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Annotated, Any, Literal, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg.grids import Grids
from adaptmg.multigrid.cycle import CoarseSolve, Correction, Cycle, Monotone, NestedStart
from adaptmg.multigrid.truncated_parts import Truncated
from adaptmg.smoother.factorisation import factorisable
from adaptmg.smoother.gauss_seidel import ProjectedGaussSeidel, Smoother
from adaptmg.solver.active_set import ActiveSet
from adaptmg.solver.iterate import State
from adaptmg.solver.projected import ProjectedRun
from adaptmg.solver.record import Outcome, Run, Status
from adaptmg.solver.steps import Cycles, Stepper
from adaptmg.solver.truncated import TruncatedRun

_LOG = logging.getLogger(__name__)


#: the options of the method with projected sweeps on all levels, where they are not given
PROJECTED: dict[str, Any] = {
    "cycle": Cycle(),
    "smoother": ProjectedGaussSeidel(),
    "coarse": CoarseSolve(),
    "coarse_matrices": "galerkin",
    "stop": "error",
}
#: by option of Multigrid the argument with which Truncated() is given the same
_OF_TRUNCATED = {
    "cycle": "am.Truncated(correct=am.Cycle(...))",
    "smoother": "am.Truncated(smooth=...)",
    "coarse": "am.Truncated(coarse_solve=...)",
}


def _tolerance(name: str, value: object) -> object:
    """Return a tolerance as a float, or "discretisation"."""
    if not isinstance(value, str):
        return checks.tolerance(name, value)
    if value != "discretisation":
        raise ValueError(
            f"{name} must be a number > 0 and < 1 or 'discretisation', got {checks.shown(value)}"
        )
    return value


_SMOOTHER = "a smoother, which offers smooth(system, contact, load, unknowns, sweeps) -> passes"
ToleranceOrName = Annotated[float | Literal["discretisation"], _tolerance]


@dataclass(frozen=True, kw_only=True, repr=False)
class Multigrid(checks.Checked):
    """Multigrid cycles from zero or from a given start.

    Parameters
    ----------
    correction : Truncated, Monotone, PaperCorrection or user-defined
        Anything with ``transport`` and ``needs_initial``
        (:class:`~adaptmg.multigrid.cycle.Correction`). Default: Truncated(), which defines cycle,
        smoother, coarse solve and stopping test itself: the next five options are refused. A
        correction that keeps the first coarse solutions (the paper's 'initial' choices) makes them
        by nested iteration first, and starts from zero all the same; the work is counted.
    cycle : Cycle, optional
        Default Cycle(): V, two smoothings.
    smoother : ProjectedGaussSeidel or user-defined, optional
        Anything with ``smooth(system, contact, load, unknowns, sweeps) -> passes``. Default
        ProjectedGaussSeidel().
    coarse : CoarseSolve, optional
        How coarsest problems (with ``Cycle(shape="complete")`` all coarse problems) are solved.
        Default CoarseSolve().
    coarse_matrices : {"galerkin", "discretised"}, optional
        Default "galerkin".
    stop : {"error", "change"}, optional
        Test the estimated relative A-norm error (with the natural residual below 10 times the
        tolerance, the default), or, as the paper, the change at the end of step g alone: Euclidean,
        relative to the solution.
    rtol : float or "discretisation"
        Tolerance of that test; where initial strains act, relative to u without what expands
        freely: to the norm of the stresses. "discretisation" (FullMultigrid with Truncated): a
        tenth of the discretisation error, as the nested start shows it.
    max_cycles : int
        With Truncated also for what takes over where it does not converge (:func:`handed_over`;
        ``Result.fallback`` names it). In a step of a load path that finds motions of
        :class:`adaptmg.Rigid` obstacles or :class:`adaptmg.Preload` no contact problem begins after
        ``max_cycles`` cycles in all of them together: the step takes less than twice that number,
        and the cycles that tighten a bolt until it pulls.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> solver = am.Multigrid(correction=am.Monotone(), cycle=am.Cycle(shape="W", pre=2))
    >>> am.solve(grids, solver).residual < 1e-7
    True
    """

    cycle: Annotated[Cycle, partial(checks.instance, types=Cycle, words="a Cycle")] | None = None
    smoother: (
        Annotated[Smoother, partial(checks.offers, method="smooth", words=_SMOOTHER)] | None
    ) = None
    correction: Correction | Truncated = field(default_factory=Truncated)
    coarse: (
        Annotated[CoarseSolve, partial(checks.instance, types=CoarseSolve, words="a CoarseSolve")]
        | None
    ) = None
    coarse_matrices: Literal["galerkin", "discretised"] | None = None
    stop: Literal["error", "change"] | None = None
    rtol: ToleranceOrName = 1e-8
    max_cycles: checks.Count = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        truncated = isinstance(self.correction, Truncated)
        if not truncated:
            checks.offers(
                "correction",
                self.correction,
                "transport",
                "Monotone(), Truncated(), PaperCorrection() or offer transport and needs_initial",
            )
            checks.flag(
                f"needs_initial of correction {checks.shown(self.correction)}",
                getattr(self.correction, "needs_initial", None),
            )
        if truncated and self._named:
            name, value = next(iter(self._named.items()))
            remedy = _OF_TRUNCATED.get(name, "am.Monotone()")
            raise ValueError(
                f"{name} must not be given with the correction Truncated(), which defines its own, got "
                f"{checks.shown(value)}: give correction={remedy}"
            )
        if isinstance(self.rtol, str) and not (isinstance(self, FullMultigrid) and truncated):
            raise ValueError(
                "rtol='discretisation' needs FullMultigrid(correction=Truncated()): the nested start "
                "shows the discretisation error"
            )

    @property
    def reads_coarse_starts(self) -> bool:
        """Return whether load steps after the first one read displacements of coarse levels."""
        return not isinstance(self.correction, Truncated)

    @property
    def _named(self) -> dict[str, Any]:
        """Return the options of the projected method that the user gives."""
        return {name: value for name in PROJECTED if (value := getattr(self, name)) is not None}

    def run(self, hierarchy: Grids, run: Run, start: np.ndarray | None) -> Outcome:
        return self.prepared(hierarchy, run).from_given(start)

    def setup(self, hierarchy: Grids, start: State | None = None) -> Stepper:
        """Return an object whose ``step(state) -> state`` is a cycle on the finest level: to look at
        the states, or as a part of a user-defined method.

        Only the :class:`adaptmg.State` is remembered. A step that gets other unknowns than those of
        the last state smooths them first. There is no stopping test, no nested start, and no contact
        problem on a coarse level. ValueError for smoothed elements with poisson above .4.

        Parameters
        ----------
        hierarchy : Hierarchy
        start : State, optional
            Not used; it is there for :func:`adaptmg.solve`.

        Examples
        --------
        >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4, 8))
        >>> stepper = am.Multigrid().setup(grids)
        >>> state = am.State(unknowns=np.zeros(grids.finest.discrete.n_dofs))
        >>> for _ in range(3):
        ...     state = stepper.step(state)
        >>> state.cycles
        3
        """
        discrete = hierarchy.finest.discrete
        run = Run(unit=discrete.rows.nonzeros)
        return Cycles(run, self.prepared(hierarchy, run).cycle_of_states(), discrete.n_dofs)

    def prepared(
        self, hierarchy: Grids, run: Run, keeps: bool = False
    ) -> TruncatedRun | ProjectedRun:
        """Return a run of the method that is set up for a hierarchy; with ``keeps`` the set-up serves
        several load steps (of Truncated(); other corrections are set up for each)."""
        if len(hierarchy) < 2:
            raise ValueError(
                "grids must have at least two levels for multigrid, got one: give coarser ones too, as in "
                "Hierarchy.uniform(problem, divisions=(4, 8)), or use ActiveSet"
            )
        if isinstance(self.correction, Truncated):
            return TruncatedRun(self.correction, hierarchy, run, self.rtol, self.max_cycles, keeps)
        return ProjectedRun(
            hierarchy=hierarchy,
            run=run,
            correction=self.correction,
            rtol=cast("float", self.rtol),
            max_cycles=self.max_cycles,
            **PROJECTED | self._named,
        )


@dataclass(frozen=True, kw_only=True, repr=False)
class FullMultigrid(Multigrid):
    """The full multigrid method: nested start, then cycles on the finest level.

    Parameters
    ----------
    start : NestedStart
        How the levels below are solved first.

    See :class:`Multigrid` for the others.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.solve(grids, am.FullMultigrid(rtol=1e-6)).error_estimate < 1e-6
    True
    """

    start: Annotated[
        NestedStart, partial(checks.instance, types=NestedStart, words="a NestedStart")
    ] = field(default_factory=NestedStart)

    @property
    def reads_coarse_starts(self) -> bool:
        return True  # the nested start carries the change of a step from level to level

    def run(self, hierarchy: Grids, run: Run, start: np.ndarray | None) -> Outcome:
        if start is not None:
            raise ValueError(
                "start: FullMultigrid makes its own start; use Multigrid to continue from a given one"
            )
        return self.prepared(hierarchy, run).from_nested(self.start)


#: contact dofs up to which Newton steps are taken on a dense matrix (0.3 GB)
CONDENSED = 6_000


def handed_over(outcome: Outcome, hierarchy: Grids, run: Run) -> Outcome:
    """Return the outcome; if it leaves cycles to another method, that of the other method: the active
    set method if factors pay, and where that fails, too, or cannot be taken, the monotone correction,
    or with volumes the truncated one on fewer levels."""
    problem = hierarchy.finest.discrete
    start = outcome.solution if outcome.better else None  # None: from zero
    if outcome.left and factorisable(problem):
        solver = ActiveSet(
            rtol=outcome.rtol,
            max_steps=outcome.left,
            condensed=problem.dim * len(problem.contact.nodes) <= CONDENSED,
        )
        most_cycles = outcome.cycles + outcome.left
        outcome = _continued(outcome, solver, "ActiveSet", start, hierarchy, run)
        if outcome.status.ok or outcome.status is Status.ROUNDING:
            return outcome
        outcome.left = most_cycles - outcome.cycles
    if outcome.left and len(problem.volumes) and len(hierarchy) > 2:
        solver = Multigrid(rtol=outcome.rtol, max_cycles=outcome.left)
        fewer = _fewer_levels(hierarchy)
        return _continued(
            outcome, solver, "Truncated on fewer levels", start=None, hierarchy=fewer, run=run
        )
    if outcome.left and hierarchy.discretised:  # which refuses volumes
        solver = Multigrid(correction=Monotone(), rtol=outcome.rtol, max_cycles=outcome.left)
        return _continued(outcome, solver, "Monotone", start, hierarchy, run)
    return outcome


def _fewer_levels(hierarchy: Grids) -> Grids:
    """Return the hierarchy without every second level, from the next to the finest on; unchanged if it
    is not made of meshes."""
    with suppress(ValueError):  # which without() raises for levels without meshes
        for level in range(len(hierarchy) - 2, 0, -2):
            hierarchy = hierarchy.without(level)
    return hierarchy


def _continued(
    before: Outcome,
    solver: ActiveSet | Multigrid,
    method: str,
    start: np.ndarray | None,
    hierarchy: Grids,
    run: Run,
) -> Outcome:
    """Return the outcome of another solver, from ``start`` (n_unknowns,) or zero (None), with the cycles of
    that ``before`` added; ``before`` if the other one gives up."""
    _LOG.info(
        "cycle %d: the method does not converge; going on with %s",
        before.cycles,
        method,
    )
    run.first_cycle += before.cycles
    try:
        outcome = solver.run(hierarchy, run, start)
    except (np.linalg.LinAlgError, ValueError, MemoryError) as error:
        # a coarsest problem of few contact nodes may be singular where the finest one is not
        _LOG.info("cycle %d: %s gives up: %s", before.cycles, method, error)
        return before
    finally:
        run.first_cycle -= before.cycles
    run.fallback = f"{method} from cycle {run.first_cycle + before.cycles}"
    # Newton steps have no rate of a cycle
    return replace(
        outcome,
        cycles=before.cycles + outcome.cycles,
        rate=np.nan if isinstance(solver, ActiveSet) else outcome.rate,
    )


def from_finest(
    solver: ActiveSet, finest: Grids, run: Run, start: np.ndarray | None, grids: Grids
) -> tuple[Outcome, Grids]:
    """Solve by the active set method on the finest level alone, ``finest``, from a start (n_unknowns,)
    or zero (None); where that fails, by full multigrid on all levels, ``grids``. Return the outcome
    and the levels that it comes from."""
    try:
        outcome = solver.run(finest, run, start)
    except (np.linalg.LinAlgError, MemoryError) as error:
        _LOG.info("the active set method gives up: %s", error)
        zero = np.zeros(finest.finest.discrete.n_unknowns)
        outcome = Outcome(zero, Status.DIVERGED, cycles=0, rtol=solver.rtol)
    if outcome.status.ok or outcome.status is Status.ROUNDING:
        return outcome, finest
    method = FullMultigrid if grids.discretised else Multigrid
    after = _continued(outcome, method(rtol=solver.rtol), method.__name__, None, grids, run)
    return after, grids if run.fallback else finest
