"""Result: what :func:`adaptmg.solve` returns, and NotConverged, the exception that carries it."""

from __future__ import annotations

import importlib.metadata
import os
from dataclasses import dataclass, field
from functools import lru_cache
from typing import cast

import numpy as np

from adaptmg import _checks as checks
from adaptmg._files import write_bytes
from adaptmg._text import html_table, in_html_lines, shortened
from adaptmg.discrete.moduli import Moduli
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import PlasticState, StressData
from adaptmg.discrete.ties import TieForces
from adaptmg.grids import Grids
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.contact_problem import for_problem
from adaptmg.solver.certificate import Certificate, Condition, ContactClaims, certify
from adaptmg.solver.examine import ContactResult, advice_on_patches, counted_states
from adaptmg.solver.quantities import Quantities
from adaptmg.solver.quantities import Resultant as Resultant
from adaptmg.solver.record import Status


@dataclass(frozen=True, eq=False)
class Result(Quantities):
    """The solution and how it was found.

    Attributes
    ----------
    displacement : (n_nodes, dim) array
        m.
    contact : ContactResult
        Arrays over the contact nodes: pressures, forces, gaps, slips, states
        (:class:`adaptmg.solver.ContactResult`).
    reaction : (n_nodes, dim) array
        A u - b: nodal forces that supports and contact exert on the body, N (2D: N/m); ~0 at free
        nodes.
    status : Status
        Its value is advice.
    cycles : int
        Cycles, sweeps or Newton steps on the finest level.
    work_units : float
        Passes over matrices, weighted by their nonzeros over those of the finest.
    residual : float
        Natural residual ``|D (prox_D(u - D^-1 (A u - b)) - u)|``, over the largest Euclidean norm
        of loads, contact forces and (with prescribed displacements) reactions.
    error_estimate : float
        Estimated ||u - u_h||_A / ||u_h||_A against the exact discrete solution: the larger of what
        the solver and the certificate find.
    rate : float
        Asymptotic convergence rate per cycle (geometric mean of the last cycles); NaN if unknown,
        and where the active set method took over (``fallback``).
    rtol : float
        The requested tolerance, or what rounding leaves on a slender body where that is more.
    history : dict of str to (n,) array
        cycle, work_units, seconds, and what the solver recorded: residual (natural, relative),
        change (since the check before, relative, A-norm), error_estimate, true_error (with a
        reference; relative, A-norm).
    timings : dict of str to float
        Seconds by phase; those of compiling kernels, if there are any, apart.
    path : list of (level, action, times)
        The way through the levels.
    levels : list of dict
        The table of the hierarchy; its last row alone where the default took the finest level alone.
    problem_name, solver_name : str
        The names of the problem and of the solver with its options.
    fallback : str
        The method that took over where the solver did not converge, and from which cycle; empty if
        none did.
    choice : str
        Why the solver was taken, where :func:`adaptmg.solve` chose another one than multigrid on all
        levels that were given; else empty.
    mesh : MeshArrays or None
        Finest mesh; None if the result comes from a bare DiscreteProblem, see
        :func:`adaptmg.mesh.need_mesh`.
    start_work_units : float
        The part of ``work_units`` spent before the first cycle on the finest level (nested start).
    versions : dict of str to str
        Versions of adaptmg and of the libraries that numbers depend on.
    stress_data : StressData or None
        Material constants and initial strains, for :meth:`stress`
        (:class:`adaptmg.solver.StressData`); None for a bare DiscreteProblem.
    checked : Certificate or None
        The certificate of the solve.
    supports : dict of str to list of list of float
        By boundary the directions along which supports hold it; empty for a bare DiscreteProblem.
    ties : TieForces or None
        Nodal forces of ties on both bodies (:class:`adaptmg.solver.TieForces`); None without ties.
    springs : dict of str to list of float
        By boundary, or "point (0, 1)", the force (dim) that springs exert on the bodies, N, and its
        moment about the origin, N m.
    motions : dict of str to list of float
        By name the displacement, m, and the rotation, rad, of obstacles that a force presses
        (:class:`adaptmg.Rigid`), and the strain that shortens a body (:class:`adaptmg.Preload`).
    missed_forces : float
        By how much the forces that move obstacles and preloads miss the prescribed ones, over their size.
    pressures : (n_groups,) array
        Of nearly incompressible bodies with smoothed elements: what the mean volume strains of
        groups of nodes add to the stress, Pa, tension positive (:mod:`adaptmg.discrete.volumes`).
    time : float
        Of a step of :func:`adaptmg.march` its end, s; else 0.
    velocity : (n_nodes, dim) array
        At that time, m/s; else empty.
    energies : dict of str to float
        At that time, N m (plane: N): "kinetic", "strain", "load" (the potential of loads and initial
        strains, 0 of the undeformed bodies), and those lost so far by "friction", "contact" and "damping". Their sum
        stays the same. Empty of other results.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> result.displacement.shape
    (25, 2)
    >>> result.probe([(0.01, 0.02)]).shape
    (1, 2)
    >>> len(result.contact.pressure)
    5
    """

    displacement: np.ndarray
    contact: ContactResult
    reaction: np.ndarray
    status: Status
    cycles: int
    work_units: float
    residual: float
    error_estimate: float
    rate: float
    rtol: float
    history: dict[str, np.ndarray] = field(compare=False)  # with seconds
    timings: dict[str, float] = field(compare=False)
    path: list[tuple[int, str, int]]
    levels: list[dict[str, float]]
    problem_name: str
    solver_name: str
    mesh: MeshArrays | None = None
    start_work_units: float = 0.0
    versions: dict[str, str] = field(default_factory=dict)
    stress_data: StressData | None = None
    checked: Certificate | None = None
    supports: dict[str, list[list[float]]] = field(default_factory=dict)
    ties: TieForces | None = None
    fallback: str = ""
    choice: str = ""
    springs: dict[str, list[float]] = field(default_factory=dict)
    motions: dict[str, list[float]] = field(default_factory=dict)
    missed_forces: float = 0.0
    pressures: np.ndarray = field(default_factory=lambda: np.empty(0))
    time: float = 0.0
    velocity: np.ndarray = field(default_factory=lambda: np.empty(0))
    energies: dict[str, float] = field(default_factory=dict)

    @property
    def method(self) -> str:
        """Return the name of the solver, and of what took over from it."""
        return f"{self.solver_name}, then {self.fallback}" if self.fallback else self.solver_name

    @property
    def seconds(self) -> float:
        """Return the seconds of all phases of the solve, set-up included, without meshing, assembly
        and compiling."""
        return float(
            sum(seconds for phase, seconds in self.timings.items() if phase != "compiling")
        )

    @property
    def advice(self) -> tuple[str, ...]:
        """Return advice to make the answer better, which printing the result shows too: contact that
        does not fill its boundary needs 12 nodes in each patch, in 3D 60.

        Examples
        --------
        >>> am.solve(am.Hierarchy.graded(am.cases.hertz_cylinder())).advice
        ()
        """
        mesh = self.mesh
        return () if mesh is None else tuple(advice_on_patches(self.contact, mesh))

    def __str__(self) -> str:
        return _summary(self)

    def __repr__(self) -> str:
        return shortened(_summary(self))

    def _repr_html_(self) -> str:
        narrow = r"^(?!moment|half_width)"  # a page has no room for these
        table = "" if self.mesh is None else html_table(self.pairs().filter(regex=narrow))
        return in_html_lines(_summary(self)) + table

    def certificate(
        self, problem: DiscreteProblem | None = None, *, bound: bool = False
    ) -> Certificate:
        """Check by how much each condition of contact is violated, by code that shares nothing with
        the solvers.

        Without ``problem`` the certificate of the solve is returned. With it the result is checked
        again, and ``bound`` bounds the distance to the solution with the same contact status by a
        sparse factorisation."""
        checks.flag("bound", bound)
        if problem is not None:
            checks.instance("problem", problem, DiscreteProblem)
            if problem.inelastic:
                raise ValueError(
                    "problem has the matrix of bodies before they yield: leave it out, the certificate "
                    "of the solve is that of the internal forces"
                )
            if len(self.pressures) != len(problem.volumes):
                raise ValueError(
                    f"problem has {len(problem.volumes)} volumes, whose pressures this result has not: "
                    "give the problem that was solved"
                )
            return certify(
                problem,
                self.displacement,
                cast("ContactClaims", self.contact),
                bound,
                pressures=self.pressures,
            )
        if bound or self.checked is None:
            raise ValueError(
                "problem: this result keeps no matrix; give the DiscreteProblem that was solved "
                "(grids.finest.discrete)"
            )
        return self.checked

    def work_to(self, error: float, of: str = "error_estimate") -> float:
        """Return the work units until an error of the history fell to ``error`` for good;
        infinite if it never did.

        ``of`` is the column of ``history``: "error_estimate" (algebraic: the estimate of ||u -
        u_h||_A / ||u_h||_A), "true_error" (with a reference), "residual" or "change", all relative.
        The nested start is included."""
        error = checks.positive("error", error)
        names = [name for name in self.history if name not in ("cycle", "work_units", "seconds")]
        if of not in names:
            raise ValueError(
                f"of must be one of {', '.join(map(repr, names)) or 'none'}, got {checks.shown(of)}"
            )
        recorded = ~np.isnan(self.history[of])
        values = self.history[of][recorded]
        work = self.history["work_units"][recorded]
        above = np.flatnonzero(values > error)
        first = above[-1] + 1 if len(above) else 0
        return float(work[first]) if first < len(work) else float("inf")

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to an ``.npz`` file, whole or not at all; see :mod:`adaptmg.solver.store`."""
        from adaptmg.solver.store import packed

        write_bytes(checks.file_path("path", path), packed(self, KINDS))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Result:
        """Read what :meth:`save` wrote; ValueError, which names the file, if it is something else
        or damaged, or a load path or a later step of it, which :meth:`PathResult.load` reads."""
        if checks.file_path("path", path).is_dir():
            raise ValueError(
                f"path must be a file, got the folder {os.fspath(path)}: PathResult.load reads load paths"
            )
        from adaptmg.solver.store import read

        stored = read(path, KINDS)
        step = stored.part_of.get("step")
        if step and stored.value.mesh is None:
            folder = os.path.dirname(path) or "."
            raise ValueError(
                f"{os.fspath(path)} is step {step} of a load path, whose mesh is in its first step: "
                f"read it by PathResult.load({folder!r})[{step}]"
            )
        return stored.value


#: what the file of a result holds
KINDS = (
    Result,
    ContactResult,
    TieForces,
    MeshArrays,
    StressData,
    PlasticState,
    Moduli,
    Certificate,
    Condition,
    Status,
)


def problem_name(grids: Grids) -> str:
    """Return the name of the problem, or else of the finest level."""
    return grids.problem.name if grids.problem is not None else grids.finest.discrete.name


@lru_cache(maxsize=1)
def versions() -> dict[str, str]:
    """Return the versions of adaptmg and of what its numbers depend on."""
    return {
        name: importlib.metadata.version(name)
        for name in ("adaptmg", "ngsolve", "numpy", "scipy", "numba", "pyamg")
    }


def _summary(result: Result) -> str:
    """Return the text that printing a result shows."""
    certified = ""
    if result.checked is not None:
        worst = result.checked.worst
        certified = (
            f"\n  certificate: worst {worst.name} {worst.largest:.2e} {worst.unit} (relative "
            f"{worst.relative:.2e}), energy error {result.checked.energy_error:.2e}; "
            f"{result.timings.get('certificate', 0.0):.2g} s"
        )
    return (
        f"Result of {result.method}{for_problem(result.problem_name)}: {result.status.name}\n"
        f"  {len(result.displacement)} nodes, {len(result.contact)} contact nodes: {counted_states(result.contact)}\n"
        f"  {result.cycles} cycles, {result.work_units:.2f} work units, {result.seconds:.3g} s\n"
        f"  natural residual {result.residual:.2e}, estimated error {result.error_estimate:.2e} "
        f"(rtol {result.rtol:g}){certified}"
        + f"\n  solver=None: {result.choice}" * bool(result.choice)
        + "".join(f"\n  {line}" for line in result.advice)
    )


#: lines of the certificate that compare mesh, posed problem and assembly: no method changes them
_OF_ASSEMBLY = {"stiffness", "loads", "measures", "bodies", "stresses"}


def _remedy(result: Result, violated: tuple[str, ...]) -> str:
    """Return the advice for a result that has not converged: for plastic bodies, for forces that the
    assembled matrices or the motions of obstacles miss, else that of its status; if the active set
    method has failed, it names another method."""
    if result.stress_data is not None and result.stress_data.plastic is not None:
        return (
            "the plastic bodies may bear no more than a part of this load: give hardening, or prescribe "
            "displacements in place of forces, in smaller load steps"
        )
    if violated and _OF_ASSEMBLY.issuperset(violated):
        return (
            "the method has converged, but forces of the mesh and of the assembled matrices differ, which no "
            "other method changes: print(result.certificate()) shows by how much; look at places where "
            "supports, ties and contact boundaries meet"
        )
    if result.status is Status.LIMIT and result.missed_forces:
        names = ", ".join(map(repr, result.motions))
        return (
            f"forces of {names} are missed by {result.missed_forces:.1e} of their size, although each contact "
            "problem on the way converged: take smaller load steps, or a larger limit"
        )
    advice = result.status.value
    if result.status is Status.DIVERGED and not np.isfinite(result.residual):
        advice = (
            "the result has numbers that are not finite: look for a division by zero in what user-defined parts "
            f"return; else, {advice}"
        )
    if "ActiveSet" not in result.method or "am.ActiveSet()" not in advice:
        return advice
    untried = not result.fallback and len(result.levels) > 1
    other = "am.FullMultigrid()" if untried else "another start, am.solve(..., start=...),"
    before, take, _ = advice.partition("take ")  # "...: take am.ActiveSet() ..." of Status
    return f"{before}{take}{other} or less friction"


def _failure(result: Result) -> str:
    """Return the message of :class:`adaptmg.NotConverged`."""
    violated = () if result.checked is None else result.checked.contradictions(result.rtol)
    contradicted = (
        f" The certificate contradicts this tolerance: {', '.join(violated)}." if violated else ""
    )
    poisson = 0.0 if result.stress_data is None else result.stress_data.locking
    locked = (
        f'give the problem elements="smoothed", since linear ones lock at a Poisson\'s ratio of '
        f"{poisson:.4g}, where Coulomb's law may have no solution on them; else, "
        if poisson
        else ""
    )
    return (
        f"{result.method}: {result.status.name} after {result.cycles} cycles, natural residual "
        f"{result.residual:.2e}, estimated error {result.error_estimate:.2e}: {locked}"
        f"{_remedy(result, violated)}.{contradicted} The last iterate is in the exception's .result; "
        "throw=False returns it instead."
    )


class NotConverged(RuntimeError):
    """Raised by :func:`adaptmg.solve` when the tolerance was not reached.

    Attributes
    ----------
    result : Result
        The last iterate with its true residual.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> try:
    ...     am.solve(grids, am.SingleGrid(max_sweeps=1))
    ... except am.NotConverged as error:
    ...     error.result.status.name
    'LIMIT'
    """

    def __init__(self, result: Result) -> None:
        self.result = result
        super().__init__(_failure(result))

    def __repr__(self) -> str:
        return shortened(super().__repr__())

    def __reduce__(self) -> tuple[object, ...]:
        # exceptions are rebuilt from .args, which is the text here: a process that is handed one
        # back must not fail
        return type(self), (self.result,)
