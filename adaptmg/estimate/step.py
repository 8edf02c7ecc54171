r"""Step: what each round of the adaptive loop yields, its limits, what it expects of the next meshes, and its file.

With N nodes in d dimensions good meshes have :math:`\eta \sim N^{-1/d}`; the cost of the meshes so far is about
proportional to the nodes of the last, as they grow geometrically.

In a folder each step is one file of a :class:`adaptmg.solver.store.StepStore`: the result with its mesh, and a
:class:`StoredStep`. A killed loop goes on with the same numbers. Limits are not part of the fingerprint: a loop may go
on under others.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Generic

import numpy as np

from adaptmg import _checks as checks
from adaptmg._text import html_table, in_html_lines, shortened
from adaptmg.discrete.discretise import load_steps
from adaptmg.estimate.estimate import Estimate, Found
from adaptmg.estimate.goal import GoalEstimate
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh import with_source
from adaptmg.mesh.arrays import MeshArrays, Refinement
from adaptmg.problem.load_path import LoadPath
from adaptmg.solver.load_path import PathResult
from adaptmg.solver.result import KINDS, Result
from adaptmg.solver.store import fingerprint

if TYPE_CHECKING:
    import pandas

@dataclass(frozen=True, kw_only=True)
class Limits:
    """When the loop ends."""

    tolerance: float | None = None  # for the relative estimate
    max_nodes: int | None = None
    max_seconds: float | None = None

    def __post_init__(self) -> None:
        if self.tolerance is None and self.max_nodes is None and self.max_seconds is None:
            raise ValueError("give at least one of tolerance, max_nodes and max_seconds: the loop would never end")
        if self.tolerance is not None:
            object.__setattr__(self, "tolerance", checks.tolerance("tolerance", self.tolerance))
        if self.max_nodes is not None:
            checks.integer("max_nodes", self.max_nodes, 1)
        if self.max_seconds is not None:
            object.__setattr__(self, "max_seconds", checks.positive("max_seconds", self.max_seconds))


@dataclass(frozen=True, eq=False, repr=False)
class Step(Generic[Found]):
    """A mesh of the adaptive loop, solved and estimated; printing it shows a line with its figures.

    Attributes
    ----------
    number : int
        0 for the start.
    hierarchy : Hierarchy
        All levels that were used; its finest is the mesh of the step.
    result : Result
        On it, solved to ``result.rtol`` (by default 1e-6, far below the estimate, so that forces and compliances hold);
        of a load path that of the load step by which the mesh is refined.
    estimate : Estimate
    timings : dict of str to float
        Seconds of this step by phase: "mesh" (marking and refining the mesh before), "assembly", "transfer", "levels"
        (which meshes stay), "solve", "estimate", "store".
    total_seconds : float
        Of all steps so far.
    work_units, total_work_units : float
        Of the solve, and of all solves so far, in passes over the finest matrix of this step.
    path : PathResult or None
        All load steps, where there is a load path.
    settled : bool or None
        Of a goal: whether its signed estimates have the sign of those of the mesh before, and are no smaller than the
        change of the corrected values since then; False on the first mesh. While they are not, the printed step says
        "not settled", and only two meshes in a row below it end the loop by ``tolerance``. None for energy norms.
    outcome : str
        Why the loop stopped after this step; empty as long as it has not.

    Examples
    --------
    >>> problem = am.cases.greco_bar()
    >>> steps = list(am.adapt(problem, am.mesh.structured(problem.domain, 2), engine=am.Bisect(), max_nodes=20))
    >>> steps[0].nodes < steps[-1].nodes
    True
    """

    number: int
    hierarchy: Hierarchy
    result: Result
    estimate: Found
    timings: Mapping[str, float]
    total_seconds: float
    work_units: float
    total_work_units: float
    path: PathResult | None = None
    settled: bool | None = None
    outcome: str = ""

    @property
    def nodes(self) -> int:
        """Nodes of the mesh."""
        return self.hierarchy.finest.n_nodes

    @property
    def seconds(self) -> float:
        """Of this step, the mesh included."""
        return float(sum(self.timings.values()))

    def __repr__(self) -> str:
        doubtful = " (not settled)" if self.settled is False else ""
        text = (f"step {self.number:>2}: {self.nodes:>7} nodes, {len(self.hierarchy):>2} levels, estimate "
                f"{self.estimate.relative:>7.3%}{doubtful}, {self.result.cycles:>3} cycles, {self.work_units:>6.1f} "
                f"work units ({self.total_work_units:.1f} in all), {self.seconds:.3g} s ({self.total_seconds:.3g} s "
                "in all)")
        return shortened(f"{text}; {self.outcome}" if self.outcome else text)

    def _repr_html_(self) -> str:
        return html_table(self.table([self])) + in_html_lines(self.outcome)

    @staticmethod
    def table(steps: Sequence[Step]) -> pandas.DataFrame:
        """Return one row a step, with units in the heads: ``am.Step.table(list(am.adapt(...)))``."""
        import pandas

        return pandas.DataFrame([
            {"step": step.number, "nodes": step.nodes, "levels": len(step.hierarchy),
             "contact_nodes": len(step.result.contact), "estimate": step.estimate.relative,
             "status": step.result.status.name, "rtol": step.result.rtol, "cycles": step.result.cycles,
             "work_units": step.work_units, "total_work_units": step.total_work_units, "seconds [s]": step.seconds,
             "total_seconds [s]": step.total_seconds, "pressure [Pa]": step.result.max_pressure}
            for step in steps])


def expected_seconds(steps: Sequence[Step], limits: Limits) -> float:
    """Return the seconds that the whole loop will have taken when a limit stops it; NaN if nothing is expected."""
    last, ends = steps[-1], []
    if limits.max_nodes is not None:
        ends.append(last.total_seconds * max(limits.max_nodes / last.nodes, 1.0))
    if limits.tolerance is not None and last.estimate.relative > 0:
        dim = last.result.dim
        ends.append(last.total_seconds * max(last.estimate.relative / limits.tolerance, 1.0) ** dim)
    if limits.max_seconds is not None:
        ends.append(max(limits.max_seconds, last.total_seconds))
    return min(ends) if ends else float("nan")


def settled(estimate: Estimate, before: Estimate | None) -> bool | None:
    """Return :attr:`Step.settled` of an estimate, given that of the mesh before."""
    if estimate.signed is None:
        return None
    if before is None or before.signed is None:
        return False
    (values, errors), (old_values, old_errors) = (
        (one.values, one.errors) if isinstance(one, GoalEstimate) else (np.array([one.value]), np.array([one.signed]))
        for one in (estimate, before))
    change = np.abs(values + errors - old_values - old_errors) if values.shape == old_values.shape else np.inf
    return bool(((errors * old_errors > 0) & (change <= np.abs(errors))).all())


@dataclass(frozen=True, eq=False)
class StoredStep:
    """What a store has of a step next to its result."""

    estimate: Estimate
    levels: list[MeshArrays]  # the meshes of all levels
    history: Refinement | None  # the bisections that made its own mesh
    numbers: dict[str, float]  # total_seconds, work_units, total_work_units
    timings: dict[str, float]
    path: PathResult | None = None


#: what the file of a step holds; user-defined estimates come back as Estimate
LOOP_KINDS = (*KINDS, StoredStep, GoalEstimate, Estimate, PathResult, Refinement)


def loop_fingerprint(start: Hierarchy, options: Mapping[str, object], load_path: LoadPath | None = None,
                     depends: Mapping[str, object] | None = None) -> dict[str, object]:
    """Return the fingerprint of a loop that begins with a hierarchy, with its options by name: indicator, mark, engine,
    ..."""
    loads = [load_steps(start.problem, level.mesh, level.discrete) for level in start.levels]
    factors = {} if load_path is None else load_path.resolved(start.problem)
    # the problem itself, since another law or gap may differ only between the nodes of the first mesh; references only
    # document it
    posed = {part.name: getattr(start.problem, part.name) for part in fields(start.problem) if part.name != "reference"}
    return fingerprint(start, loads, factors, 0 if load_path is None else len(load_path), posed | dict(options), None,
                       depends)


def restored(before: Hierarchy, meshes: Sequence[MeshArrays]) -> Hierarchy:
    """Return the hierarchy of a stored step, which has these meshes, made of that of the step before."""
    stored = [_key(mesh) for mesh in meshes]
    there = [_key(level.mesh) for level in before.levels]
    for key, mesh in zip(stored, meshes, strict=True):
        if key not in there:
            before = before.append(with_source(mesh))
            there.append(key)
    for level in reversed([k for k, key in enumerate(there) if key not in stored]):
        before = before.without(level)
    return before


def _key(mesh: MeshArrays) -> bytes:
    return hashlib.sha256(mesh.points.tobytes() + mesh.elements.tobytes()).digest()
