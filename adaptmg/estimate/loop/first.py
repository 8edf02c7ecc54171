"""The hierarchy that a loop begins with: within its limits, and known to be so before Netgen works for minutes."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from adaptmg.estimate.loop.expected import Limits
from adaptmg.estimate.loop.given import sound_mesh
from adaptmg.hierarchy import Hierarchy
from adaptmg.hierarchy_input import need_domain
from adaptmg.mesh.limits import MAX_NODES
from adaptmg.problem import ContactProblem, checks

if TYPE_CHECKING:
    from adaptmg.transfer import Transfer

__all__ = ["first_hierarchy"]

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
    from adaptmg.mesh.netgen.generate import NODES_PER_CELL
    from adaptmg.mesh.netgen.measures import measures

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
