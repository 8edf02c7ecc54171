r"""solve_path: quasi-static load histories, step by step.

Friction acts on increments: at step k the slip is :math:`u_t^k - u_t^{k-1}`, against the displacement of the step
before (implicit Euler; no time occurs). Every step is a contact problem of its own with other loads, prescribed values
and slip references; matrices and transfers stay. What comes back is a sequence of Results, with the factors of their
steps.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, overload

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.problem import checks
from adaptmg.problem.load_path import LoadPath
from adaptmg.runtime.threads import one_blas_thread
from adaptmg.smoother.state import OPEN, SLIP, STICK
from adaptmg.solver.arguments import displacement_argument, grids_argument, solver_argument
from adaptmg.solver.critical_friction import warn_of_large_friction
from adaptmg.solver.history import files
from adaptmg.solver.history.store import PathStore
from adaptmg.solver.history.walk import PathWalk
from adaptmg.solver.result import Result
from adaptmg.solver.result.not_converged import NotConverged
from adaptmg.solver.run import Solver

if TYPE_CHECKING:
    import pandas

__all__ = ["PathResult", "StepNotConverged", "solve_path"]


@dataclass(frozen=True, eq=False, repr=False)
class PathResult(Sequence[Result]):
    """The steps of a load path, in order.

    Attributes
    ----------
    results : tuple of Result
        Of the steps done; where a step did not converge it is the last one.
    factors : dict of str to (n_steps,) array
        Factors of all steps of the path, by the name of the load; "default" where loads have no names.
    fingerprint : dict
        What the path was solved for, see :mod:`adaptmg.solver.history.store`; empty without a store.
    n_steps : int
        Steps of the whole path.
    """

    results: tuple[Result, ...]
    factors: Mapping[str, np.ndarray]
    fingerprint: Mapping[str, Any] = field(default_factory=dict)
    n_steps: int = 0

    @property
    def complete(self) -> bool:
        """Whether all steps of the path were solved to their tolerance."""
        return len(self.results) == self.n_steps and all(result.status.ok for result in self.results)

    def __len__(self) -> int:
        return len(self.results)

    @overload
    def __getitem__(self, index: int) -> Result: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Result, ...]: ...

    def __getitem__(self, index: int | slice) -> Result | tuple[Result, ...]:
        return self.results[index]

    def __iter__(self) -> Iterator[Result]:
        return iter(self.results)

    def __repr__(self) -> str:
        about = f" of {self.results[0].solver_name} for {self.results[0].problem_name}" if self.results else ""
        lines = [f"PathResult{about}: {len(self)} of {self.n_steps} steps",
                 f"{'step':>4} {'status':>9} {'cycles':>6} {'seconds':>8} {'open':>6} {'slip':>6} {'stick':>6}  "
                 "factors"]
        for k, result in enumerate(self.results):
            n = _counts(result)
            factors = ", ".join(f"{name} {values[k]:g}" for name, values in self.factors.items())
            lines.append(f"{k:>4} {result.status.name:>9} {result.cycles:>6} {result.seconds:>8.3g} {n['open']:>6} "
                         f"{n['slip']:>6} {n['stick']:>6}  {factors}")
        return "\n".join(lines)

    def table(self) -> pandas.DataFrame:
        """One row a step.

        Returns
        -------
        pandas.DataFrame
            step; "factor NAME" for each load; status; cycles; work_units; seconds; residual (natural, relative);
            open, slip and stick (contact nodes); force_x, force_y, force_z: resultant of all contact forces on the
            contact boundaries, N (2D: N/m); pressure: the largest contact pressure, Pa; slip_size: the largest slip of
            the step at a node in contact, m.
        """
        import pandas

        rows = []
        for k, result in enumerate(self.results):
            force = result.resultant("contact").force
            c = result.contact
            slips = np.linalg.norm(c.slip, axis=1)[c.state != OPEN]
            rows.append({"step": k} | {f"factor {name}": values[k] for name, values in self.factors.items()}
                        | {"status": result.status.name, "cycles": result.cycles, "work_units": result.work_units,
                           "seconds": result.seconds, "residual": result.residual} | _counts(result)
                        | {f"force_{'xyz'[d]}": float(value) for d, value in enumerate(force)}
                        | {"pressure": float(c.pressure.max()), "slip_size": float(slips.max(initial=0.0))})
        return pandas.DataFrame(rows)

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write a file a step, and the factors; the mesh goes into the first.

        Raises
        ------
        ValueError
            If the folder holds another path already.
        """
        files.write(checks.file_path("folder", folder), self.results, self.factors, self.n_steps, self.fingerprint)

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> PathResult:
        """Read what :meth:`save` wrote, or the steps that :func:`adaptmg.solve_path` has stored so far.

        Raises
        ------
        ValueError
            If the folder holds no load path, or a file in it is damaged, missing, or of another path or step.
        """
        head, results = files.read(checks.file_path("folder", folder))
        return cls(results, head.factors, head.fingerprint, head.steps)


def _counts(result: Result) -> dict[str, int]:
    """Contact nodes by state."""
    states = np.bincount(np.asarray(result.contact.state, dtype=int), minlength=3)
    return {"open": int(states[OPEN]), "slip": int(states[SLIP]), "stick": int(states[STICK])}


class StepNotConverged(NotConverged):
    """Raised by :func:`solve_path` when a step did not reach its tolerance.

    Attributes
    ----------
    result : Result
        The last iterate of that step.
    step : int
    described : str
        The factors of that step.
    partial : PathResult
        The steps before it, and it.
    """

    def __init__(self, result: Result, step: int, described: str, partial: PathResult) -> None:
        super().__init__(result)
        self.step, self.described, self.partial = step, described, partial
        self.args = (f"step {step} of {partial.n_steps} ({described}): {self.args[0]} Smaller load steps help where "
                     "the contact status changes much; the steps before it are in .partial.",)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.result, self.step, self.described, self.partial)


@one_blas_thread()
def solve_path(grids: Hierarchy | DiscreteProblem, path: LoadPath, solver: Solver | None = None, *,
               start: np.ndarray | Result | None = None, store: str | os.PathLike[str] | None = None,
               depends: Mapping[str, Any] | None = None, throw: bool = True,
               callback: Callable[[int, Result], None] | None = None,
               progress: Callable[[int, dict[str, float]], None] | None = None) -> PathResult:
    """Solve a contact problem along a load path on the finest level of a hierarchy.

    Parameters
    ----------
    grids : Hierarchy or DiscreteProblem
        A bare DiscreteProblem is a hierarchy of one level; its loads have no names, so that ``path`` has ``default``
        alone.
    path : LoadPath
    solver : SingleGrid, Multigrid, FullMultigrid, ActiveSet or one's own, optional
        The default is that of :func:`adaptmg.solve`. ``rtol`` refers to the whole displacement of a step;
        "discretisation" sets it once, in the first step. Multigrid with :class:`adaptmg.Truncated` is set up once.
    start : (n_nodes, dim) array or Result, optional
        Displacement against which the first step slips, m. Default: the unloaded, undeformed bodies.
    store : path, optional
        A folder where every finished step is kept at once. A path that was interrupted goes on there; a folder with
        steps of another problem, hierarchy, path or solver is refused. A user-defined solver is compared by its code
        and the values that it reads.
    depends : mapping of str to value, optional
        For the store: values that stand for what cannot be compared (an open file, a generator of random numbers), by
        the name of the variable that is read, or "solver".
    throw : bool
        Raise :class:`StepNotConverged` if a step does not reach the tolerance. False ends the path with that step,
        whose status says it; ``complete`` is then False.
    callback : callable, optional
        Called with the number and the Result of each step when it is finished, and kept.
    progress : callable, optional
        Called with the number of the step and each row of its history.

    Returns
    -------
    PathResult

    Raises
    ------
    ValueError
        Bad input, or a rigid motion that neither supports nor contact hold in a step.
    StepNotConverged
    """
    grids = grids_argument(grids)
    checks.instance("path", path, LoadPath, "a LoadPath")
    solver = solver_argument(solver, grids)
    checks.flag("throw", throw)
    checks.optional_callable("callback", callback, "the number and Result of a step")
    checks.optional_callable("progress", progress, "the number of a step and a row of its history")
    walk = PathWalk(grids, path, solver, displacement_argument("start", start, grids.finest.discrete))
    mark = {} if store is None else walk.fingerprint(depends)
    kept = None if store is None else PathStore(store, walk.factors, len(path), mark)
    results = [] if kept is None else kept.results
    for k, result in enumerate(results):
        walk.replay(k, result)
    if len(results) < len(path):
        warn_of_large_friction(walk.examiner)
    for k in range(len(results), len(path)):
        result = walk.step(k, progress)
        results.append(result)
        if not result.status.ok:
            partial_result = PathResult(tuple(results), walk.factors, mark, len(path))
            if throw:
                raise StepNotConverged(result, k, walk.described(k), partial_result)
            return partial_result
        if kept is not None:
            kept.put(k, result)
        if callback is not None:
            callback(k, result)
    return PathResult(tuple(results), walk.factors, mark, len(path))
