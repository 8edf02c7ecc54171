"""What solve and solve_path share: their arguments, and the Result of what a solver returns.

Of one mesh the quickest method is the default: the active set method, whose factorisation grows
faster than the unknowns, or multigrid on coarse spaces that are made from the matrix. CPU seconds
of the one and the other: bar of 33k unknowns .75 and .53, of 132k 5.5 and 2.7; block (3D) of 15k
3.9 and .57. Levels of a large coarsest one that are too close to each other are left out: block of
54k unknowns on meshes of 1264, 2612, 5883 and 17 914 nodes 6.2 s on all, 1.3 on the first and the
last; sector of the bolted junction on 1575 and 2560 nodes 1.3, by the active set method .5."""

from __future__ import annotations

import logging
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._text import label
from adaptmg.discrete.loads import spring_resultants
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import StressData
from adaptmg.grids import Grids
from adaptmg.level import is_small
from adaptmg.smoother.factorisation import factorisable
from adaptmg.solver.active_set import ActiveSet
from adaptmg.solver.advice import advise, advise_on_adhesion, advise_on_law
from adaptmg.solver.certificate import Certificate
from adaptmg.solver.examine import Examined, Examiner
from adaptmg.solver.iterate import StopTest
from adaptmg.solver.multigrid import FullMultigrid, Multigrid
from adaptmg.solver.record import Outcome, Run, Solver, Status
from adaptmg.solver.result import Result, problem_name, versions
from adaptmg.solver.statics import advise_on_free_motions
from adaptmg.solver.steps import Method, Stepped

_LOG = logging.getLogger(__name__)

#: unknowns up to which one mesh is factorised, by dimension: those of scalar problems may all be contact dofs, whose
#: matrix is dense (961 nodes .5 s, on coarse spaces 4225 nodes .03 s)
FACTORISED = {1: 1_000, 2: 30_000, 3: 6_000}
#: unknowns of a coarsest level from which its factors cost much
LARGE_COARSEST = 1500
#: nodes of a level over those of the next coarser one below which, there, the two are too close
WIDE = {1: 2, 2: 2, 3: 4}
#: the default on several levels, and where the finest one has few unknowns: their options are checked once, not in
#: each solve
_FULL_MULTIGRID = FullMultigrid()
_ON_FINEST = ActiveSet(rtol=cast("float", FullMultigrid.rtol))


def tolerance_argument(rtol: float | None, solver: Solver | Method | None) -> float | None:
    """Return the tolerance of the default method, checked; None if it is not given."""
    if rtol is not None and solver is not None:
        raise ValueError(
            f"rtol must not be given with a solver, which has its own, got {checks.shown(rtol)}"
        )
    return None if rtol is None else checks.tolerance("rtol", rtol)


def method_argument(
    solver: Solver | Method | None, grids: Grids, rtol: float | None = None, single: bool = False
) -> tuple[Grids, Solver, str]:
    """Return the grids, the solver, and the reason for the choice. Without a solver the quickest one is
    chosen, with ``rtol`` if it is given, for a ``single`` contact problem or for several in a row; the
    reason is empty for full multigrid on all levels."""
    rtol = tolerance_argument(rtol, solver)
    discrete = grids.finest.discrete
    if solver is None and single and len(grids) > 1 and is_small(discrete):
        why = f"for {discrete.n_dofs} unknowns the quickest is the active set method"
        finest_alone = grids.finest.posing(prolongation=None, surface_prolongation=None)
        # the seconds that made the levels are not those of the solve
        grids = replace(grids, levels=(finest_alone,), timings={})
        method = _ON_FINEST
    else:
        grids, method, why = _method(solver, grids)
    return grids, method if rtol is None else replace(cast("Any", method), rtol=rtol), why


def _method(solver: Solver | Method | None, grids: Grids) -> tuple[Grids, Solver, str]:
    """Return the grids, the solver and the reason for it: those given, or the default for these grids,
    which may leave out levels or make coarse spaces."""
    if solver is not None:
        if hasattr(solver, "setup") and not hasattr(solver, "run"):
            return grids, Stepped(cast("Method", solver)), ""
        words = (
            "SingleGrid(), Multigrid(), FullMultigrid(), ActiveSet() or offer setup() or run() (a "
            "correction belongs in FullMultigrid(correction=...))"
        )
        return grids, cast("Solver", checks.offers("solver", solver, "run", words)), ""
    if len(grids) > 1:
        return _levels_that_pay(grids) if grids.discretised else (grids, Multigrid(), "")
    level = grids.finest
    why = f"for one mesh of {grids.finest.discrete.n_dofs} unknowns the quickest is "
    if not factorisable(level.discrete, FACTORISED):
        with suppress(ValueError):  # nothing to coarsen
            algebraic = Grids.algebraic(level.discrete)
            finest = algebraic.finest.posing(mesh=level.mesh, posed=level.posed)
            levels = (*algebraic.levels[:-1], finest)
            algebraic = replace(algebraic, levels=levels, problem=grids.problem)
            return algebraic, Multigrid(), why + "multigrid on coarse spaces made from its matrix"
    return grids, ActiveSet(), why + "the active set method"


def _levels_that_pay(grids: Grids) -> tuple[Grids, Solver, str]:
    """Return the default on several discretised levels. Those that are too close to each other have
    Galerkin matrices with as many entries as the finest one, down to the coarsest, whose factors
    then cost more than all the rest."""
    finest = grids.finest
    nodes = [level.n_nodes for level in grids.levels]
    least_ratio = WIDE[grids.finest.discrete.dim]
    if finest.discrete.dim * nodes[0] <= LARGE_COARSEST:  # its factors cost little
        return grids, _FULL_MULTIGRID, ""
    # the finest level itself is too close to the coarsest, and contact dofs are few enough for dense factors
    if (
        nodes[-1] < least_ratio * nodes[0]
        and finest.discrete.dim * len(finest.discrete.contact) <= LARGE_COARSEST
    ):
        return (
            grids,
            ActiveSet(),
            (
                f"from {nodes[0]} to {nodes[-1]} nodes multigrid gains little, the quickest is the "
                "active set method"
            ),
        )
    # from the coarsest on, those far enough from the last that was taken and from the finest
    last_taken = 0
    too_close = []
    for level in range(1, len(grids) - 1):
        if least_ratio * nodes[last_taken] <= nodes[level] <= nodes[-1] / least_ratio:
            last_taken = level
        else:
            too_close.append(level)
    # the seconds that made the levels are not those of the solve
    grids = replace(grids, timings={})
    # without a problem there are no meshes between which a prolongation could be made: all levels stay
    for level in reversed(too_close if grids.problem is not None else ()):
        grids = grids.without(level)
    sizes_left_out = ", ".join(str(nodes[level]) for level in too_close)
    return (
        grids,
        _FULL_MULTIGRID,
        (
            f"without the meshes of {sizes_left_out} nodes, too close to others"
            if len(grids) < len(nodes)
            else ""
        ),
    )


def displacement_argument(
    name: str, value: ArrayLike | Result | None, discrete: DiscreteProblem
) -> np.ndarray | None:
    """Return a displacement (n_nodes, dim) or a Result as unknowns of the problem, checked."""
    if value is None:
        return None
    nodal = value.displacement if isinstance(value, Result) else value
    array = checks.array(name, nodal, (discrete.n_nodes, discrete.dim))
    size = np.abs(array).max(initial=0.0)
    if not size <= checks.VAST:
        raise ValueError(f"{name} must be at most {checks.VAST:g} m, got {size:.3g}")
    return np.array(discrete.relative(array))


def start_argument(
    start: ArrayLike | Result | None, discrete: DiscreteProblem
) -> np.ndarray | None:
    """Return a start as a solution (n_unknowns,), checked; without pressures these are zero."""
    displacement = displacement_argument("start", start, discrete)
    if displacement is None:
        return None
    groups = len(discrete.volumes)
    pressures = np.zeros(groups)
    if groups and isinstance(start, Result) and len(start.pressures):
        pressures = checks.vector("start.pressures", start.pressures, groups)
    return np.append(displacement, pressures)


def grids_argument(value: Grids | DiscreteProblem) -> Grids:
    """Return a hierarchy; a bare DiscreteProblem becomes one of one level. What was computed from
    the finest matrix is forgotten if its entries have been changed since the last solve."""
    if isinstance(value, DiscreteProblem):
        value = Grids.single(value)
    grids = checks.instance("grids", value, Grids, "a Hierarchy or a DiscreteProblem")
    grids.finest.discrete.follow_entries()
    return grids


def checked_outcome(outcome: Outcome, solver: Solver, discrete: DiscreteProblem) -> Outcome:
    """Return the outcome of a solver, which may be user-defined, after checks; its status is DIVERGED if
    its numbers are not finite."""
    name = f"solver: of the Outcome of {type(solver).__name__}"
    checks.instance(f"solver: what {type(solver).__name__} returns", outcome, Outcome)
    solution = checks.real_array(outcome.solution)
    if solution is None or solution.size != discrete.n_unknowns:
        raise TypeError(
            f"{name} solution must be a real array ({discrete.n_unknowns},), got "
            f"{checks.shown(outcome.solution)}: the displacement, and the pressures of "
            f"{len(discrete.volumes)} volumes"
        )
    checks.instance(f"{name} status", outcome.status, Status, "one of am.Status")
    cycles = checks.integer(f"{name} cycles", outcome.cycles)
    rtol = checks.nonnegative(f"{name} rtol", outcome.rtol)
    for what in ("error_estimate", "rate"):
        number = checks.real_array(getattr(outcome, what))
        if number is None or number.ndim or number < 0:
            raise TypeError(
                f"{name} {what} must be a number >= 0 or NaN, got {checks.shown(getattr(outcome, what))}"
            )
    if not rtol < 1:
        raise ValueError(f"{name} rtol must be < 1, got {rtol:g}")
    # a solver of the user may go on with its array
    solution = np.array(solution, dtype=np.float64).reshape(-1)
    status = outcome.status if np.isfinite(solution).all() else Status.DIVERGED
    return replace(outcome, solution=solution, cycles=cycles, rtol=rtol, status=status)


def result_of(
    grids: Grids,
    examiner: Examiner,
    run: Run,
    outcome: Outcome,
    solver: Solver | None,
    stress_data: StressData | None,
    choice: str = "",
) -> Result:
    """Return the Result on the finest level; the certificate and the natural residual confirm the
    status. ``solver`` None: no solver made it."""
    with run.phase("certificate"):
        examined = examiner(outcome.solution, outcome.rtol)
    volumes = grids.finest.discrete.volumes
    _, pressures = grids.finest.discrete.parts(outcome.solution)
    if stress_data is not None:
        stress_data = replace(
            stress_data,
            pressure=volumes.of_elements(pressures),
            volume_energy=0.5 * volumes.energy(pressures),
        )
    posed = grids.posed
    supports = {}
    springs = {}
    if posed is not None:
        supports = {name: rows.tolist() for name, rows in posed.directions.items()}
        springs = spring_resultants(
            posed.mesh,
            posed.problem.supports,
            examined.displacement,
            posed.problem.axisymmetric,
        )
    outcome = _checked(outcome, examined, solver)
    status = outcome.status
    # methods may end so where nothing but friction holds a body
    if status in (Status.CYCLING, Status.STALLED) or (run.fallback and not status.ok):
        advise_on_free_motions(examiner.discrete, examined.contact)
    if status.ok:
        advise_on_adhesion(examiner.discrete, examined.contact)
    advise_on_law(examiner.discrete, examined.contact)
    # rows of different methods have different columns
    keys = dict.fromkeys(chain.from_iterable(run.history))
    history = {key: np.array([row.get(key, np.nan) for row in run.history]) for key in keys}
    return Result(
        displacement=examined.displacement,
        reaction=examined.reaction,
        checked=examined.checked,
        status=status,
        cycles=outcome.cycles,
        # the examiner of a discrete problem does not know whether it is axisymmetric
        contact=replace(
            examined.contact, axisymmetric=stress_data is not None and stress_data.axisymmetric
        ),
        work_units=run.work_units,
        residual=examined.residual,
        error_estimate=float(outcome.error_estimate),
        rate=outcome.rate,
        rtol=outcome.rtol,
        history=history,
        timings=run.timings,
        path=run.path,
        levels=grids.table(),
        problem_name=problem_name(grids),
        solver_name="" if solver is None else label(solver),
        fallback=run.fallback,
        choice=choice,
        mesh=grids.finest.mesh,
        start_work_units=run.start_work_units,
        versions=dict(versions()),
        stress_data=stress_data,
        supports=supports,
        springs=springs,
        ties=examined.ties,
        pressures=pressures,
    )


def _checked(outcome: Outcome, examined: Examined, solver: Solver | None) -> Outcome:
    """Return an outcome with what the certificate says: a status that it contradicts changes, the error
    is at least that of the certificate, and a tolerance below what double precision reaches is raised to
    that, with a warning."""
    checked = examined.checked
    if checked is None:
        return outcome
    status = _confirmed(outcome, examined.residual, checked, getattr(solver, "stop", "error"))
    # NaN where the solver has no estimate
    error_estimate = float(np.fmax(outcome.error_estimate, checked.energy_error))
    rtol = outcome.rtol
    least = checked.energy_rounding
    if status.ok and 0 < rtol < checked.energy_error <= least:
        # the attribute of the class is the default of the option
        is_default = solver is _ON_FINEST or rtol == getattr(type(solver), "rtol", None)
        default = "the default " if is_default else ""
        advise(
            "rounding",
            f"{default}rtol={rtol:.3g} is below what double precision reaches on these bodies, {least:.1e} "
            "(slender ones answer to rounding with their condition): the result has that tolerance, in "
            "result.rtol",
        )
        rtol = least
    return replace(outcome, status=status, error_estimate=error_estimate, rtol=rtol)


def _confirmed(outcome: Outcome, residual: float, checked: Certificate, stop: str) -> Status:
    """Return the status of a solver, unless the natural residual or the certificate contradicts it. With
    ``stop="change"``, the paper's test, rtol bounds a change and not the error: the error may then be
    the multiple of rtol that residuals may be."""
    if not np.isfinite(residual):
        return Status.DIVERGED
    # forces that balance but for rounding may leave as much as the certificate excuses
    line = checked["equilibrium"]
    rounding = checked.MOST_ROUNDING if line.relative <= line.rounding else StopTest.ROUNDING_LIMIT
    most = max(StopTest.RESIDUAL_FACTOR * outcome.rtol, rounding)
    # twice: solvers sum the same numbers in another order; 1: as large as the forces that act
    if outcome.status.ok and not residual <= 2 * most:
        return Status.DIVERGED if not residual < 1 else Status.STALLED
    factor = StopTest.RESIDUAL_FACTOR if stop == "change" else checked.ENERGY_FACTOR
    contradictions = checked.contradictions(outcome.rtol, factor)
    if not checked.energy_error < 1:
        contradictions = *contradictions, "energy error of the size of the solution"
    if outcome.status.ok and contradictions:
        _LOG.info("the solver reports convergence, contradicted by %s", ", ".join(contradictions))
        _LOG.debug("%s", checked)
        return Status.STALLED
    return outcome.status
