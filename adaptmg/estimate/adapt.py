r"""adapt: solve, estimate, mark, refine, and solve again on all meshes so far.

Every mesh becomes the finest level of the hierarchy of those before it; the solution before,
carried to it, is the start. The solves of all meshes together cost little more than that on the
last: with meshes that grow by a factor g the nodes of all are :math:`1/(1 - 1/g)` times those of
the last."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from numbers import Real
from typing import TYPE_CHECKING, Literal, cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg._text import say
from adaptmg.discrete.scalar import ScalarProblem
from adaptmg.estimate.engines import Bisect, Engine, sound_mesh
from adaptmg.estimate.estimate import (
    AnyEstimate,
    Doerfler,
    Indicator,
    Mark,
    Recovery,
    Residual,
)
from adaptmg.estimate.goal import Goal, need_linear
from adaptmg.estimate.loop import (
    LOOP_KINDS,
    AdaptiveLoop,
    Limits,
    LoopParts,
    Progress,
    Step,
    loop_fingerprint,
)
from adaptmg.hierarchy import Hierarchy
from adaptmg.level import check_problem, need_domain
from adaptmg.mesh.grading import measures
from adaptmg.problem import ContactProblem, LoadPath
from adaptmg.problem.load_path import obstacles_in_path
from adaptmg.solver.outcome import tolerance_argument
from adaptmg.solver.store import StepStore

if TYPE_CHECKING:
    from adaptmg.mesh.read import MeshLike
    from adaptmg.solver.record import Solver
    from adaptmg.transfer import Transfer

    Start = float | MeshLike | Hierarchy | None


def adapt(
    problem: ContactProblem | ScalarProblem,
    start: float | MeshLike | Hierarchy | None = None,
    indicator: Indicator[AnyEstimate] | None = None,
    mark: Mark | None = None,
    engine: Engine | None = None,
    *,
    tolerance: float | None = None,
    max_nodes: int | None = None,
    max_seconds: float | None = None,
    store: str | os.PathLike[str] | None = None,
    depends: Mapping[str, object] | None = None,
    transfer: Transfer | None = None,
    solver: Solver | None = None,
    rtol: float | None = None,
    load_path: LoadPath | None = None,
    adapt_on: Literal["last", "worst"] = "last",
    remesh_every: int | None = None,
    progress: Progress | bool | None = None,
) -> Iterator[Step[AnyEstimate]]:
    """Solve on meshes that follow the error, one finer than the other, until a limit is reached.

    Without ``tolerance``, ``max_nodes`` and ``max_seconds`` it ends at 20 000 nodes. Warnings as of
    :func:`adaptmg.solve`, once for the whole loop.

    Parameters
    ----------
    problem : ContactProblem or ScalarProblem
        A ScalarProblem takes ``Residual`` and no load path. The ``elements`` of a ContactProblem are
        linear unless it says otherwise. Smoothed ones need fewer nodes: the deflection of a pressed
        cylinder is off by .14 % at 3405 nodes with linear elements, by .11 % at 1516 with smoothed
        ones. ``Goal`` estimates linear elements only.
    start : float, MeshArrays, ngsolve.Mesh, path of a mesh file or Hierarchy, optional
        The first mesh, or its element size in m. Of a hierarchy, which is not changed, the finest
        mesh. Default: an eighth of the square root of the mean area of the bodies (3D: a quarter of
        the cube root of the mean volume); at contact smaller where a contact boundary would have fewer
        than three elements along, unless the engine makes the first mesh itself, as ``Bisect`` does of
        rectangles and boxes.
    indicator : Residual, Recovery, Goal or an object with ``indicate(hierarchy, result)``, optional
        Default ``Residual()``.
    mark : Doerfler, Maximum or an object with ``mark(estimate) -> mask of elements``, optional
        Default ``Doerfler()``.
    engine : Remesh, Bisect or an object with ``refine``, optional
        See :class:`adaptmg.estimate.engines.Engine`. Default ``Bisect()``.
    tolerance : float, optional
        Stop when the estimate is so small relative to ||u||_A (of a goal: to the quantity; and
        :attr:`Step.settled`, or on two meshes in a row).
    max_nodes : int, optional
        No mesh has more; a first mesh that has more is refused, a size that asks for far more
        before it is meshed.
    max_seconds : float, optional
        No step begins after this time, meshes included.
    store : path, optional
        A folder where every step is kept immediately. A loop that was interrupted, or killed, goes
        on after its last complete step, and ends with the same numbers; steps that are there are
        yielded again. A folder with steps of another problem or other options is refused; limits
        may change. User-defined functions and classes are compared by their code and the values
        they read.
    depends : mapping of str to value, optional
        For the store: values that stand for what cannot be compared (an open file, a generator of
        random numbers), by the name of the part of the problem (``law``, ``loads``, ...), of the
        option, or of the variable that is read.
    transfer : Transfer, optional
        Between the meshes; default :class:`adaptmg.transfer.Interpolation`, or that of the
        hierarchy ``start``.
    solver : Solver, optional
        For every step; it starts from the step before unless it is a FullMultigrid. Default
        ``Multigrid(rtol=1e-6)``: forces and compliances of every step hold to about 1e-4 of those
        of its mesh, and mostly far better.
    rtol : float, optional
        Tolerance of the default solver, where none is given; default 1e-6.
    load_path : LoadPath, optional
        Every mesh goes along the whole path; by default with ``FullMultigrid(rtol=1e-6)``.
    adapt_on : {"last", "worst"}
        With a load path: take the estimate of its last load step and refine for it; or the largest
        relative estimate of all load steps, and refine where any of them needs it.
    remesh_every : int, optional
        With a load path: go along it once, and change the mesh after this number of load steps. Each
        mesh begins with the state of the mesh before (:func:`adaptmg.transfer_state`), and its first load
        step repeats the load reached. The mesh stays where the estimate meets ``tolerance``, or where
        the engine makes no other one; Remesh keeps about ``max_nodes``. Steps end with the path.
        With plastic bodies no change should fall on a step after which the load turns.
    progress : callable or bool, optional
        Called with a dict before each phase of a step, and after it: step, phase, nodes, estimate
        (of the step before), seconds. True: write lines to standard error.

    Yields
    ------
    Step
        The generator may be broken off at any step. After the last one ``step.outcome`` says why
        there are no more. TypeError or ValueError for bad arguments, immediately; NotConverged if a
        step cannot be solved.

    Examples
    --------
    >>> problem = am.cases.upset_block()
    >>> mesh = am.mesh.structured(problem.domain, 2)
    >>> steps = list(am.adapt(problem, mesh, engine=am.Bisect(), max_nodes=30))
    >>> steps[-1].estimate.relative < steps[0].estimate.relative
    True
    """
    check_problem(problem)
    if tolerance is None and max_nodes is None and max_seconds is None:
        max_nodes = _NODES
    limits = Limits(tolerance=tolerance, max_nodes=max_nodes, max_seconds=max_seconds)
    engine = Bisect() if engine is None else engine
    parts = LoopParts(
        indicator=Residual() if indicator is None else indicator,
        mark=Doerfler() if mark is None else mark,
        engine=engine,
        solver=solver,
        load_path=load_path,
        adapt_on=adapt_on,
        rtol=tolerance_argument(rtol, solver),
        remesh_every=remesh_every,
    )
    if not isinstance(progress, bool):
        checks.optional_callable("progress", progress, "what is being done (or a bool)")
    checks.mapping("depends", {} if depends is None else depends, "names to what stands for them")
    if not isinstance(problem, ScalarProblem):
        _check_bodies(problem, parts)
    elif load_path is not None or isinstance(indicator, Recovery | Goal):
        raise ValueError(
            "a ScalarProblem takes no load_path, and as indicator am.Residual() or a user-defined one"
        )
    first = _first_hierarchy(problem, start, transfer, engine, limits)
    step_store = None
    if store is not None:
        options = {
            "indicator": parts.indicator,
            "mark": parts.mark,
            "engine": parts.engine,
            "solver": parts.solver,
            "rtol": parts.rtol,
            "transfer": first.transfer,
            "contact_rows": first.contact_rows,
            "adapt_on": parts.adapt_on,
            "remesh_every": parts.remesh_every,
        }
        head = {"fingerprint": loop_fingerprint(first, options, load_path, depends)}
        step_store = StepStore.resumed(store, "loop.json", head, LOOP_KINDS)
    report = _write_line if progress is True else progress or None
    return cast(
        "Iterator[Step[AnyEstimate]]",
        AdaptiveLoop(first, parts, limits, step_store, report).steps(),
    )


def _check_bodies(problem: ContactProblem, parts: LoopParts) -> None:
    """Raise ValueError if the estimates do not account for elements, obstacles, preloads or plastic
    bodies."""
    path = parts.load_path
    if problem.elements != "linear" and isinstance(parts.indicator, Goal):
        need_linear(problem)
    if problem.by_force:
        raise ValueError(
            "problem has a Rigid obstacle or a Preload, which the estimates do not account for: give "
            "am.adapt the motion that am.solve finds (Result.motions) as Moving or InitialStrain"
        )
    if problem.inelastic:
        if path is None or isinstance(parts.indicator, Residual | Goal):
            raise ValueError(
                "problem has plastic bodies, which need a load_path and, as other estimates do not account "
                "for them, indicator=am.Recovery()"
            )
        # estimates of these bodies compare neither loads nor obstacles with those of the problem
        # (stress_fields.solved): obstacles may move
        return
    if path is not None and obstacles_in_path(problem):
        raise ValueError(
            "problem has an obstacle that moves along load_path, which the estimates do not account for: "
            "leave load_path out, and give Moving the motion at its end"
        )


def _write_line(row: dict[str, float | str]) -> None:
    """Write a line before each solve and after each step."""
    texts = {
        "solve": "solve",
        "done": f"estimate {row['estimate']:.3%}, {row['seconds']:.2f} s in all",
    }
    if row["phase"] in texts:
        say(f"step {row['step']}: {row['nodes']} nodes, {texts[row['phase']]}")


#: nodes of a loop without limits
_NODES = 20_000
#: elements of the default first mesh across a body, and at least along a contact boundary
_ACROSS = {2: 8, 3: 4}
_ALONG = 3
#: a size is refused before it is meshed if the expected nodes exceed the limit by this factor: the first meshes of 30
#: cases, of 4 to 24 elements across, have .95 to 2.6 times these, lattices of many cells .87 and in space .71 times
_SURELY = 1.5


def _first_hierarchy(
    problem: ContactProblem | ScalarProblem,
    start: Start,
    transfer: Transfer | None,
    engine: Engine,
    limits: Limits,
) -> Hierarchy:
    """Return the hierarchy that the loop begins with; ValueError if it exceeds the limits."""
    if isinstance(start, Hierarchy):
        first = _given_hierarchy(problem, start, transfer)
    elif start is None or isinstance(start, Real):
        first = _hierarchy_of_size(problem, start, transfer, engine, limits)
    else:
        with _naming_start():
            first = Hierarchy.from_meshes(problem, (cast("MeshLike", start),), transfer)
    nodes = first.finest.n_nodes
    if limits.max_nodes is not None and nodes > limits.max_nodes:
        raise ValueError(
            f"max_nodes must be at least {nodes}, the nodes of the first mesh ({first.origin}), got "
            f"{limits.max_nodes}; or take a coarser start"
        )
    return first


def _given_hierarchy(
    problem: ContactProblem | ScalarProblem, start: Hierarchy, transfer: Transfer | None
) -> Hierarchy:
    """Return a hierarchy given as start; ValueError unless it is of the problem and has meshes."""
    if start.problem is not problem:
        raise ValueError(
            f"start must be a hierarchy for the problem, got one for "
            f"{start.problem and start.problem.name!r}"
        )
    if transfer is not None:
        raise ValueError("transfer: the hierarchy start has one; make it with that transfer")
    without = [k for k, level in enumerate(start.levels) if level.mesh is None]
    if without:
        raise ValueError(
            f"start: levels {without} of the hierarchy have no mesh; make it from meshes"
        )
    return start


def _hierarchy_of_size(
    problem: ContactProblem | ScalarProblem,
    start: Real | None,
    transfer: Transfer | None,
    engine: Engine,
    limits: Limits,
) -> Hierarchy:
    """Return a hierarchy of one mesh with an element size in m, or the default one, which is finer at
    contact if a contact boundary is short; ValueError, before Netgen works for minutes, if the mesh
    would have far too many nodes."""
    from adaptmg.mesh.sizes import NODES_PER_CELL

    size = None if start is None else checks.positive("start", start)
    domain = need_domain(problem)
    volumes, lengths = measures(domain)
    dim = domain.dim
    contact_refinement = 1.0  # size in the bodies over that at contact
    if size is None:
        extent = (sum(volumes) / len(volumes)) ** (1 / dim)
        size = float(f"{extent / _ACROSS[dim]:.2g}")  # two digits are read easily in messages
        shortest = min(
            (lengths[name] for name in problem.pair_boundaries if name in lengths), default=math.inf
        )
        contact_refinement = max(contact_refinement, _ALONG * size / shortest)
    # the mesh has about c |bodies| / size^dim nodes, infinitely many where a tiny size overflows, and more where
    # it is finer at contact: _first_hierarchy refuses those that are too many after meshing
    nodes_times_cell = NODES_PER_CELL[dim] * sum(volumes)
    max_nodes = limits.max_nodes
    with np.errstate(over="ignore", divide="ignore"):
        nodes = float(nodes_times_cell * np.float64(1 / size) ** dim)
    if max_nodes is not None and nodes > _SURELY * max_nodes:
        least_size = (nodes_times_cell / max_nodes) ** (1 / dim)
        raise ValueError(
            f"start must be at least {least_size:.2g} m for max_nodes={max_nodes}, "
            f"{'the default is' if start is None else 'got'} {size:g}: its mesh has about {nodes:.2g} nodes"
        )
    # an engine's first mesh is made for one size; only the default one is finer at contact
    first_mesh = getattr(engine, "first", None)
    with _naming_start():
        mesh = cast("MeshLike | None", first_mesh(problem, size) if callable(first_mesh) else None)
        if mesh is None:
            return Hierarchy.graded(problem, (size,), contact_refinement, transfer)
    sound_mesh(engine, "first", problem, mesh)
    with _naming_start():
        return Hierarchy.from_meshes(problem, (mesh,), transfer)


@contextmanager
def _naming_start() -> Iterator[None]:
    """Put "start: " before messages of errors that concern the mesh or its size; other messages name
    the problem or the transfer."""
    try:
        yield
    except (TypeError, ValueError, FileNotFoundError) as error:
        if str(error).startswith(("mesh", "size", "divisions")):
            error.args = (f"start: {error}",)
        raise
