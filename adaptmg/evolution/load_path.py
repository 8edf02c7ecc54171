r"""solve_path: quasi-static load histories, step by step.

Friction acts on increments: at step k the slip is :math:`u_t^k - u_t^{k-1}`, against the
displacement of the step before (implicit Euler; no time occurs). Every step is a contact problem
with other loads, prescribed values and slip references; matrices and transfers stay
(:mod:`adaptmg.evolution.path_loop`)."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, overload

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import make_folder
from adaptmg._text import html_table, in_html_lines, say, shortened
from adaptmg._threads import one_blas_thread
from adaptmg._units import in_units
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.evolution.path_loop import PathLoop, is_on
from adaptmg.evolution.plastic import PlasticLoop
from adaptmg.grids import Grids
from adaptmg.problem.contact_problem import for_problem
from adaptmg.problem.load_path import LoadPath
from adaptmg.solver.advice import advise_on_problem, advise_on_results, once
from adaptmg.solver.outcome import grids_argument, method_argument
from adaptmg.solver.record import Solver
from adaptmg.solver.result import KINDS, NotConverged, Result
from adaptmg.solver.statics import warn_of_several_solutions
from adaptmg.solver.store import StepStore, damage, fingerprint

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, eq=False, repr=False)
class PathResult(Sequence[Result]):
    """The steps of a load path, in order.

    Attributes
    ----------
    results : tuple of Result
        The finished steps; where a step did not converge it is the last one.
    factors : dict of str to (n_steps,) array
        Factors of all steps of the path, by the name of the load; "default" where loads have no
        names.
    fingerprint : dict
        What the path was solved for, see :mod:`adaptmg.solver.store`; empty without a store.
    n_steps : int
        Steps of the whole path.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> steps = am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0]}))
    >>> len(steps), steps.complete
    (2, True)
    """

    results: tuple[Result, ...]
    factors: Mapping[str, np.ndarray]
    fingerprint: Mapping[str, object] = field(default_factory=dict)
    n_steps: int = 0

    @property
    def complete(self) -> bool:
        """Return whether all steps of the path were solved to their tolerance."""
        return len(self.results) == self.n_steps and all(
            result.status.ok for result in self.results
        )

    def __len__(self) -> int:
        return len(self.results)

    @overload
    def __getitem__(self, index: int) -> Result: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Result, ...]: ...

    def __getitem__(self, index: int | slice) -> Result | tuple[Result, ...]:
        return self.results[index]

    def count(self, value: Result) -> int:
        """Return how often a result is a step."""
        return self.results.count(checks.instance("value", value, Result))

    def __repr__(self) -> str:
        return shortened(str(self))

    def _repr_html_(self) -> str:
        # what fits on a narrow page
        narrow = self.table().filter(regex=r"^(step|factor |status|open|slip$|stick|force_|press)")
        return in_html_lines(str(self).partition("\n")[0]) + html_table(narrow)

    def __str__(self) -> str:
        about = (
            f" of {self.results[0].solver_name}{for_problem(self.results[0].problem_name)}"
            if self.results
            else ""
        )
        lines = [
            f"PathResult{about}: {len(self)} of {self.n_steps} steps",
            f"{'step':>4} {'status':>9} {'cycles':>6} {'seconds':>8} {'open':>6} {'slip':>6} {'stick':>6}  "
            "factors",
        ]
        for k, result in enumerate(self.results):
            n = result.contact.counts()
            factors = ", ".join(f"{name} {values[k]:g}" for name, values in self.factors.items())
            lines.append(
                f"{k:>4} {result.status.name:>9} {result.cycles:>6} {result.seconds:>8.3g} {n['open']:>6} "
                f"{n['slip']:>6} {n['stick']:>6}  {factors}"
            )
        return "\n".join(lines)

    def table(self, units: str | None = None) -> pandas.DataFrame:
        """Return one row a step, with units in the heads; ``units`` as of
        :meth:`adaptmg.solver.ContactResult.table`.

        step; "factor NAME" for each load; status; cycles; work_units; seconds; residual (natural,
        relative); open, slip and stick (contact nodes); "force_x [N]", ... (plane problems: [N/m]):
        resultant of the contact forces; "pressure [Pa]": the largest contact pressure; "slip_size
        [m]": the largest slip of the step at a node in contact; "slip_path [m]": the largest of
        :meth:`slip_path`; "dissipation [J]" (plane problems: [J/m]): see :attr:`dissipation`."""
        import pandas

        rows = []
        paths = self.slip_path()
        dissipation = self.dissipation
        for k, result in enumerate(self.results):
            force = result.resultant("contact").force
            c = result.contact
            slips = np.linalg.norm(c.slip, axis=1)[c.closed]
            rows.append(
                {"step": k}
                | {f"factor {name}": values[k] for name, values in self.factors.items()}
                | {
                    "status": result.status.name,
                    "cycles": result.cycles,
                    "work_units": result.work_units,
                    "seconds": result.seconds,
                    "residual": result.residual,
                }
                | c.counts()
                | {
                    f"force_{'xyz'[d]} [{c.units[0]}]": float(value)
                    for d, value in enumerate(force)
                }
                | {
                    "pressure [Pa]": result.max_pressure,
                    "slip_size [m]": float(slips.max(initial=0.0)),
                    "slip_path [m]": float(paths[k].max(initial=0.0)),
                    f"dissipation [{c.units[0].replace('N', 'J')}]": float(dissipation[k]),
                }
            )
        return in_units(pandas.DataFrame(rows), units)

    def slip_path(self) -> np.ndarray:
        """Return how far each contact node has slipped so far (n_steps, n_contact), m; back and
        forth add up.

        The sum of ``|slip|`` over the steps after which it is in contact, those before the
        ``start`` of a path among them: the slip that :class:`adaptmg.StateLaw` sees.
        """
        paths = [result.contact.accumulated_slip for result in self.results]
        return np.array(paths) if paths else np.zeros((0, 0))

    @property
    def dissipation(self) -> np.ndarray:
        """Return the energy that friction has dissipated up to each step (n_steps,), J (plane
        problems: J/m).

        The sum of ``result.dissipation`` over the steps. A step counts its last friction for all of
        its slip: short steps give that of a load that changes continuously."""
        return np.cumsum([result.dissipation for result in self.results])

    def save(self, folder: str | os.PathLike[str]) -> None:
        """Write a file a step, and the factors; ValueError if the folder holds steps already."""
        target = checks.file_path("folder", folder)
        make_folder("folder", target)
        # the norms distinguish paths of the same factors
        norms = [float(np.linalg.norm(result.displacement)) for result in self.results]
        store = StepStore(
            target, _HEAD, _head(self.factors, self.n_steps, self.fingerprint, norms), KINDS
        )
        if not store.empty:
            raise ValueError(
                f"{target} holds a load path already: give another folder, or remove it"
            )
        for k, result in enumerate(self.results):
            store.put(k, _stored(k, result))
        store.write_head()

    @classmethod
    def load(cls, folder: str | os.PathLike[str]) -> PathResult:
        """Read what :meth:`save` wrote, or the steps that :func:`adaptmg.solve_path` has stored so
        far.

        ValueError if the folder holds no load path, or a file in it is damaged, missing, or of
        another path or step."""
        store = StepStore.read(checks.file_path("folder", folder), _HEAD, KINDS)
        with damage(store.file):
            steps = checks.integer("steps", store.head["steps"])
            factors = {
                name: checks.vector(f"factors[{name!r}]", values, steps)
                for name, values in checks.instance("factors", store.head["factors"], dict).items()
            }
        return cls(
            tuple(result for result, _ in _results(store, steps)),
            factors,
            store.head["fingerprint"],
            steps,
        )


_HEAD = "path.json"


def _head(
    factors: Mapping[str, np.ndarray],
    steps: int,
    fingerprint: Mapping[str, object],
    norms: Sequence[float] = (),
) -> dict[str, object]:
    """Return the head of a store of ``steps`` steps, from which :meth:`PathResult.load` reads the path:
    the factors (n_steps,) of the loads by name, and the Euclidean norms, m, of the displacements of the
    results."""
    return {
        "steps": steps,
        "factors": {name: list(map(float, values)) for name, values in factors.items()},
        "norms": list(norms),
        "fingerprint": dict(fingerprint),
    }


def _stored(k: int, result: Result) -> Result:
    """Return what is stored of the result of step k: the mesh with the first one only."""
    return result if k == 0 else replace(result, mesh=None)


def _results(store: StepStore, steps: int) -> list[tuple[Result, list[np.ndarray] | None]]:
    """Return the results, and the displacements of coarse levels (n_dofs,), coarsest first, that were
    stored with them; ValueError if there are more than ``steps``."""
    stored = list(store.steps())
    if len(stored) > steps:
        raise ValueError(
            f"{store.folder / f'step_{steps:04d}.npz'} is not a step of this path, which has {steps}: "
            "remove it"
        )
    return [(replace(step.value, mesh=stored[0].value.mesh), step.more) for step in stored]


class StepNotConverged(NotConverged):
    """Raised by :func:`adaptmg.solve_path` when a step did not reach its tolerance.

    Attributes
    ----------
    result : Result
        The last iterate of the step.
    step : int
        Its number, from 0.
    described : str
        Its factors.
    partial : PathResult
        The steps before it, and the step.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> try:
    ...     am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0]}), am.SingleGrid(max_sweeps=1))
    ... except am.solver.StepNotConverged as error:
    ...     error.step, len(error.partial)
    (0, 1)
    """

    def __init__(self, result: Result, step: int, described: str, partial: PathResult) -> None:
        super().__init__(result)
        self.step = step
        self.described = described
        self.partial = partial
        self.args = (
            f"step {step} of {partial.n_steps} ({described}): {self.args[0]} Smaller load steps help where "
            "the contact status changes much; the steps before it are in .partial.",
        )

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.result, self.step, self.described, self.partial)


@once()
@one_blas_thread()
def solve_path(
    grids: Grids | DiscreteProblem,
    path: LoadPath,
    solver: Solver | None = None,
    *,
    rtol: float | None = None,
    store: str | os.PathLike[str] | None = None,
    depends: Mapping[str, object] | None = None,
    start: Result | None = None,
    throw: bool = True,
    callback: Callable[[int, Result], None] | None = None,
    progress: Callable[[int, dict[str, float]], None] | bool | None = None,
) -> PathResult:
    """Solve a contact problem along a load path on the finest level of a hierarchy.

    Parameters
    ----------
    grids : Hierarchy or DiscreteProblem
        A bare DiscreteProblem is a hierarchy of one level; its loads have no names, so that
        ``path`` has ``default`` alone.
    path : LoadPath
    solver : SingleGrid, Multigrid, FullMultigrid, ActiveSet or user-defined, optional
        The default is that of :func:`adaptmg.solve`, on several levels always multigrid. ``rtol``
        refers to the whole displacement of a step; "discretisation" sets it once, in the first
        step. Multigrid with :class:`adaptmg.Truncated` is set up once, and takes no cycles in a step
        that the last two steps, extrapolated in the loads, solve to the tolerance.
    rtol : float, optional
        Tolerance of the default solver, where none is given; default as of :func:`adaptmg.solve`.
    store : path, optional
        A folder where every finished step is kept immediately. A path that was interrupted goes on
        there; a folder with steps of another problem, hierarchy, path or solver is refused. A
        user-defined solver is compared by its code and the values that it reads.
    depends : mapping of str to value, optional
        For the store: values that stand for what cannot be compared (an open file, a generator of
        random numbers), by the name of the variable that is read, or "solver".
    start : Result, optional
        On the finest mesh, of a step that led to the loads of the first step of ``path``; of another
        mesh by :func:`adaptmg.transfer_state`. The bodies begin with its displacement, its slips
        and its plastic state, and the first step restores equilibrium.
    throw : bool
        Raise :class:`StepNotConverged` if a step does not reach the tolerance. False ends the path
        with that step, whose status says it; ``complete`` is then False.
    callback : callable, optional
        Called with the number and the Result of each step when it is finished, and kept.
    progress : callable or bool, optional
        Called with the number of the step, from 0 on, and each row of its history. True: write a line a
        step to standard error.

    Raises
    ------
    ValueError
        Bad input, or a rigid motion that neither supports nor contact hold in a step. All steps are
        checked before the first is solved; with Rigid obstacles or Preload, rigid motions only
        before their step is solved.
    StepNotConverged

    Warns
    -----
    UserWarning, RuntimeWarning
        As :func:`adaptmg.solve`, once for the whole path.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> steps = am.solve_path(grids, am.LoadPath({"left": [0.5, 1.0, 0.0]}))
    >>> len(steps)
    3
    >>> more = am.solve_path(grids, am.LoadPath({"left": [0.0, -1.0]}), start=steps[-1])
    """
    checks.instance("path", path, LoadPath, "a LoadPath")
    grids, solver, choice = method_argument(solver, grids_argument(grids), rtol)
    checks.flag("throw", throw)
    checks.optional_callable("callback", callback, "the number and Result of a step")
    if not isinstance(progress, bool):
        checks.optional_callable(
            "progress", progress, "the number of a step and a row of its history (or a bool)"
        )
    checks.mapping("depends", {} if depends is None else depends, "names to what stands for them")
    loop_type = PlasticLoop if grids.finest.discrete.inelastic else PathLoop
    loop = loop_type(grids, path, solver)
    start_state = () if start is None else _check_start(loop, start)
    parts: dict[str, object] = {"solver": solver}
    if grids.finest.discrete.inelastic:
        parts["material"] = grids.problem.material
    # all that the steps depend on: a store with another fingerprint is refused
    path_fingerprint: dict[str, object] = {}
    step_store = None
    if store is not None:
        n_steps = len(path)
        path_fingerprint |= fingerprint(
            grids, loop.loads, loop.factors, n_steps, parts, depends, start_state
        )
        if obstacles := loop.controls.prescribed_numbers():
            path_fingerprint["obstacles and preloads"] = obstacles
        step_store = StepStore.resumed(
            store, _HEAD, _head(loop.factors, n_steps, path_fingerprint), KINDS
        )
    if start is not None:
        loop.continue_from(start)
    results: list[Result] = []
    for result, coarse in () if step_store is None else _results(step_store, len(path)):
        loop.take_over(len(results), result, coarse)
        results.append(result)
    if len(results) < len(path):  # a path that is complete in its store has given these warnings
        warn_of_several_solutions(grids)
        advise_on_problem(grids.posed)
    for k in range(len(results), len(path)):
        result = loop.step(k, progress if callable(progress) else None)
        result = replace(result, choice=choice)
        if progress is True:
            say(loop.report(k, result))
        results.append(result)
        if not result.status.ok:
            partial_result = PathResult(tuple(results), loop.factors, path_fingerprint, len(path))
            if throw:
                raise StepNotConverged(result, k, loop.described(k), partial_result)
            return partial_result
        if step_store is not None:
            step_store.put(k, _stored(k, result), loop.coarse)
        if callback is not None:
            callback(k, result)
    advise_on_results(grids.posed, grids.finest.discrete, results)
    return PathResult(tuple(results), loop.factors, path_fingerprint, len(path))


def _check_start(loop: PathLoop, start: Result) -> tuple[np.ndarray, ...]:
    """Return the displacement (n_nodes, dim), the plastic state (n_patches, n) and the accumulated slip
    (n_contact,) with which a path begins; ValueError unless they are of its problem, on its finest
    mesh."""
    checks.instance("start", start, Result, "a Result")
    finest = loop.grids.finest
    mesh = finest.mesh
    same_mesh = start.displacement.shape == (finest.n_nodes, finest.discrete.dim)
    if same_mesh and mesh is not None and start.mesh is not None:
        same_mesh = is_on(start, mesh)
    if not same_mesh:
        raise ValueError(
            f"start must be on the finest mesh, which has {finest.n_nodes} nodes, got a result on "
            f"another mesh of {len(start.displacement)}: carry it over by am.transfer_state"
        )
    obstacles = sorted(loop.controls.motions)
    if sorted(start.motions) != obstacles:
        raise ValueError(
            f"start must have motions of {obstacles} (Rigid obstacles and preloads), got "
            f"{sorted(start.motions)}: take a result of the same problem"
        )
    plastic = None if start.stress_data is None else start.stress_data.plastic
    state = np.zeros((0, 0)) if plastic is None else plastic.state
    shape = loop.plastic.unloaded.shape if isinstance(loop, PlasticLoop) else (0, 0)
    if state.shape != shape:
        raise ValueError(
            f"start must have states {shape} of plastic bodies (patches, numbers), as the finest "
            f"level has, got {state.shape}: take a result of the same materials and elements"
        )
    return start.displacement, state, start.contact.accumulated_slip
