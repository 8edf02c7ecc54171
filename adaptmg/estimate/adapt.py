r"""adapt: solve, estimate, mark, refine, and solve again on the grids that are left behind.

Every mesh becomes the finest level of the hierarchy of those before it; the solution before, carried to it, is the
start, and cycles go on until the algebraic error is a tenth of the error that the mesh is expected to have. So the
solves of all meshes together cost little more than that on the last: with meshes that grow by a factor g the nodes of
all are :math:`1/(1 - 1/g)` times those of the last.

The hierarchy that a loop begins with: within its limits, and known to be so before Netgen works for minutes.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from adaptmg import _checks as checks
from adaptmg.estimate.loop import AdaptiveWalk, Parts
from adaptmg.estimate.loop_store import LoopStore, loop_fingerprint
from adaptmg.estimate.step import Limits, Step, sound_mesh
from adaptmg.hierarchy import Hierarchy
from adaptmg.level import need_domain
from adaptmg.mesh.netgen_guard import MAX_NODES
from adaptmg.problem import ContactProblem, LoadPath

if TYPE_CHECKING:
    from adaptmg.solver.record import Solver
    from adaptmg.transfer import Transfer

__all__ = ["adapt", "first_hierarchy"]

def adapt(problem: ContactProblem, start: Any = None, indicator: Any = None, mark: Any = None, engine: Any = None, *,
          tolerance: float | None = None, max_nodes: int | None = None, max_seconds: float | None = None,
          store: str | os.PathLike[str] | None = None, depends: Mapping[str, Any] | None = None,
          transfer: Transfer | None = None, solver: Solver | None = None, load_path: LoadPath | None = None,
          adapt_on: str = "last",
          progress: Callable[[dict[str, Any]], None] | None = None) -> Iterator[Step]:
    """Solve on meshes that follow the error, one finer than the other, until a limit is reached.

    Parameters
    ----------
    problem : ContactProblem
    start : float, MeshArrays, ngsolve.Mesh, path of a mesh file or Hierarchy, optional
        The first mesh, or its element size in m. Of a hierarchy, which is not changed, the finest mesh. Default: an
        eighth of the square root of the mean area of the bodies (3D: of the cube root of the mean volume), in the plane
        with at least three elements along each contact boundary.
    indicator : Residual, Recovery, Goal or one's own, optional
        Anything with ``indicate(hierarchy, result) -> Estimate``. Default ``Residual()``.
    mark : Doerfler, Maximum or one's own, optional
        Anything with ``mark(estimate) -> mask of elements``. Default ``Doerfler(0.5)``.
    engine : Remesh, Bisect or one's own, optional
        Anything with ``refine(problem, mesh, estimate, marked, max_nodes=None) -> MeshArrays``, and perhaps
        ``intermediate(problem, coarse, fine) -> MeshArrays``, where sizes fall too much for neighbouring levels, and
        ``first(problem, size) -> MeshArrays or None``, where ``start`` is a size (default, and for None: by Netgen).
        Default ``Remesh()``, for a :class:`adaptmg.Goal` ``Remesh(refinements=0)``, and ``Bisect()`` for a problem
        without a domain.
    tolerance : float, optional
        Stop when the estimate is so small relative to ||u||_A (of a goal: to the quantity, and :attr:`Step.settled`).
    max_nodes : int, optional
        No mesh has more; a first mesh that has more is refused, a size that asks for far more before it is meshed.
    max_seconds : float, optional
        No step is begun after so many, meshes included. A size of the first mesh is refused that needs many more.
    store : path, optional
        A folder where every step is kept immediately. A loop that was interrupted, or killed, goes on after its last
        complete step, and ends with the same numbers; steps that are there are yielded again. A folder with steps of
        another problem or other options is refused; limits may change. User-defined functions and classes are compared
        by their code and the values they read.
    depends : mapping of str to value, optional
        For the store: values that stand for what cannot be compared (an open file, a generator of random numbers), by
        the name of the part of the problem (``law``, ``loads``, ...), of the option, or of the variable that is read.
    transfer : Transfer, optional
        Between the meshes; default :class:`adaptmg.transfer.Interpolation`, or that of the hierarchy ``start``.
    solver : Solver, optional
        One's own choice for every step; it starts from the step before unless it is a FullMultigrid. Default: truncated
        multigrid from the step before, until the estimated algebraic error is a tenth of the expected estimate.
    load_path : LoadPath, optional
        Every mesh goes along the whole path; by default with ``FullMultigrid(rtol="discretisation")``.
    adapt_on : {"last", "worst"}
        With a load path: take the estimate of its last load step and refine for it; or the largest relative estimate of
        all load steps, and refine where any of them needs it.
    progress : callable, optional
        Called with a dict before each phase of a step, and after it: step, phase, nodes, estimate (of the step before),
        seconds, expected_seconds (of the whole loop, roughly).

    Yields
    ------
    Step
        The generator may be broken off at any step. After the last one ``step.outcome`` says why there are no more.

    Raises
    ------
    TypeError, ValueError
        Bad arguments, immediately; no limit at all; a first mesh beyond the limits; a store of something else.
    NotConverged
        If a step cannot be solved.

    Examples
    --------
    >>> for step in am.adapt(am.cases.upset_block(), max_nodes=20_000):
    ...     print(step)
    """
    checks.instance("problem", problem, ContactProblem, "a ContactProblem")
    limits = Limits(tolerance=tolerance, max_nodes=max_nodes, max_seconds=max_seconds)
    parts = Parts(*_parts(problem, indicator, mark, engine), solver, load_path, adapt_on)
    _check(parts)
    checks.optional_callable("progress", progress, "what is being done")
    first = first_hierarchy(problem, start, transfer, parts.engine, limits)
    kept = None
    if store is not None:
        options = {"indicator": parts.indicator, "mark": parts.mark, "engine": parts.engine, "solver": parts.solver,
                   "transfer": first.transfer, "contact_rows": first.contact_rows, "adapt_on": parts.adapt_on}
        kept = LoopStore(store, loop_fingerprint(first, options, load_path, depends))
    return AdaptiveWalk(first, parts, limits, kept, progress).steps()


def _parts(problem: ContactProblem, indicator: Any, mark: Any, engine: Any) -> tuple[Any, Any, Any]:
    """What is given, and the defaults for the rest."""
    from adaptmg.estimate.estimate import Doerfler
    from adaptmg.estimate.residual import Residual

    if engine is None:
        if problem.domain is None:
            from adaptmg.estimate.bisect import Bisect

            engine = Bisect()
        else:
            from adaptmg.estimate.goal import Goal
            from adaptmg.estimate.remesh import Remesh

            # errors of single quantities scatter less on Netgen's own meshes
            engine = Remesh(refinements=0) if isinstance(indicator, Goal) else Remesh()
    return Residual() if indicator is None else indicator, Doerfler(0.5) if mark is None else mark, engine


def _check(parts: Parts) -> None:
    checks.offers("indicator", parts.indicator, "indicate",
                  "Residual(), Recovery(), Goal(...) or offer indicate(hierarchy, result) -> Estimate")
    checks.offers("mark", parts.mark, "mark", "Doerfler(...), Maximum(...) or offer mark(estimate) -> mask")
    checks.offers("engine", parts.engine, "refine",
                  "Remesh(), Bisect() or offer refine(problem, mesh, estimate, marked, max_nodes) -> MeshArrays")
    if parts.solver is not None:
        checks.offers("solver", parts.solver, "run", "Multigrid(), ActiveSet(), ... or offer run()")
    if parts.load_path is not None:
        checks.instance("load_path", parts.load_path, LoadPath, "a LoadPath")
    checks.choice("adapt_on", parts.adapt_on, ("last", "worst"))


#: sizes of the first mesh over the extent of a body by default, and elements along a contact boundary at least
_ACROSS, _ALONG = 8, 3
#: a size is refused before it is meshed if the expected nodes, which are good to 15 %, exceed a limit by this factor
_SURELY = 1.5
#: seconds in which Netgen makes the largest meshes; shorter limits than the least one say nothing about a first mesh
_SECONDS, _LEAST = 900.0, 1.0


def first_hierarchy(problem: ContactProblem, start: Any, transfer: Transfer | None, engine: Any, limits: Limits
                    ) -> Hierarchy:
    """The hierarchy that the loop begins with; ValueError if it exceeds the limits."""
    if isinstance(start, Hierarchy):
        found = _checked(problem, start, transfer)
    elif start is None or isinstance(start, (int, float)) or (
            hasattr(start, "__float__") and not isinstance(start, type)):
        found = _of_size(problem, start, transfer, engine, limits)
    else:
        with _named("start"):
            found = Hierarchy.from_meshes(problem, (start,), transfer)
    nodes = found.finest.n_nodes
    if limits.max_nodes is not None and nodes > limits.max_nodes:
        raise ValueError(f"max_nodes must be at least {nodes}, the nodes of the first mesh ({found.origin}), got "
                         f"{limits.max_nodes}; or take a coarser start")
    return found


def _checked(problem: ContactProblem, start: Hierarchy, transfer: Transfer | None) -> Hierarchy:
    if start.problem is not problem:
        raise ValueError(f"start is a hierarchy for another problem ({start.problem and start.problem.name}): make "
                         "it for the one that is given, or give a mesh")
    if transfer is not None:
        raise ValueError("transfer: the hierarchy that is given as start has its own; make it with that transfer")
    without = [k for k, level in enumerate(start.levels) if level.mesh is None]
    if without:
        raise ValueError(f"start: levels {without} of the hierarchy have no mesh; make it from meshes")
    return start


def _of_size(problem: ContactProblem, start: Any, transfer: Transfer | None, engine: Any, limits: Limits) -> Hierarchy:
    """With a mesh of an element size, m, or of the default one."""
    from adaptmg.mesh.grading import measures
    from adaptmg.mesh.netgen_plane import NODES_PER_CELL

    size = None if start is None else checks.positive("start", start)
    need_domain(problem)
    volumes, lengths = measures(problem.domain)
    dim = problem.dim
    ratio = 1.0
    if size is None:
        size = float(f"{(sum(volumes) / len(volumes)) ** (1 / dim) / _ACROSS:.2g}")
        shortest = min((lengths[name] for name in problem.pair_boundaries if name in lengths), default=math.inf)
        ratio = max(ratio, _ALONG * size / shortest)
    most = min(math.inf if limits.max_nodes is None else limits.max_nodes,
               math.inf if limits.max_seconds is None else
               MAX_NODES[dim] / _SECONDS * max(limits.max_seconds, _LEAST))
    cells = NODES_PER_CELL[dim] * sum(volumes)
    with np.errstate(over="ignore", divide="ignore"):
        nodes = float(cells * np.float64(1 / size) ** dim)
    if nodes > _SURELY * most:
        name = "max_nodes" if most == limits.max_nodes else "max_seconds"
        raise ValueError(f"start must be at least {(cells / most) ** (1 / dim):.2g} m for {name}="
                         f"{getattr(limits, name):g}, got {size:g}: its mesh has about {nodes:.2g} nodes")
    make = getattr(engine, "first", None)
    with _named("start"):
        mesh = make(problem, size) if callable(make) else None
        if mesh is None:
            return Hierarchy.graded(problem, (size,), ratio, transfer)
    sound_mesh(engine, "first", problem, mesh)
    with _named("start"):
        return Hierarchy.from_meshes(problem, (mesh,), transfer)


@contextmanager
def _named(name: str) -> Iterator[None]:
    """Name the argument in messages on the mesh that is made of it; others speak of the problem or the transfer."""
    try:
        yield
    except (TypeError, ValueError, FileNotFoundError) as error:
        kind = next(kind for kind in (TypeError, ValueError, FileNotFoundError) if isinstance(error, kind))
        if not str(error).startswith(("mesh", "size", "divisions")):
            raise
        raise kind(f"{name}: {error}") from error
