"""Result: what :func:`adaptmg.solve` returns, and NotConverged, the exception that carries it."""

from __future__ import annotations

import importlib.metadata
import os
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from functools import lru_cache
from itertools import combinations
from typing import TYPE_CHECKING, ClassVar, cast

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._files import write_bytes
from adaptmg._text import html_table, in_html_lines, shortened
from adaptmg.discrete.loads import moment
from adaptmg.discrete.moduli import Moduli, as_tensors
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import StressData, von_mises
from adaptmg.discrete.stress_intensity import StressIntensity, stress_intensity
from adaptmg.discrete.ties import TieForces
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays, need_mesh
from adaptmg.solver.certificate import Certificate, Condition, ContactClaims, certify
from adaptmg.solver.examine import ContactResult, advice_on_patches
from adaptmg.solver.record import Status
from adaptmg.solver.store import packed, read

if TYPE_CHECKING:
    import pandas

    from adaptmg.geometry.location import Location


@dataclass(frozen=True, eq=False)
class Result:
    """The solution and how it was found.

    Attributes
    ----------
    displacement : (n_nodes, dim) array
        m.
    contact : ContactResult
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
        The table of the hierarchy.
    problem_name, solver_name : str
        The names of the problem and of the solver with its options.
    fallback : str
        The method that took over where the solver did not converge, and from which cycle; empty if
        none did.
    choice : str
        Why the solver was taken, where :func:`adaptmg.solve` chose one for one mesh; else empty.
    mesh : MeshArrays or None
        Finest mesh; None if the result comes from a bare DiscreteProblem, see
        :func:`adaptmg.mesh.need_mesh`.
    start_work_units : float
        The part of ``work_units`` spent before the first cycle on the finest level (nested start).
    versions : dict of str to str
        Versions of adaptmg and of the libraries that numbers depend on.
    stress_data : StressData or None
        Material constants and initial strains, for :meth:`stress`; None for a bare DiscreteProblem.
    checked : Certificate or None
        The certificate of the solve.
    supports : dict of str to list of list of float
        By boundary the directions along which supports hold it; empty for a bare DiscreteProblem.
    ties : TieForces or None
        Nodal forces of ties on both bodies (``node``, ``force``, ``boundary``, ``names``); None
        without ties.
    springs : dict of str to list of float
        By boundary, or "point (0, 1)", the force (dim) that springs exert on the bodies, N, and its
        moment about the origin, N m.
    motions : dict of str to list of float
        By name the displacement, m, and the rotation, rad, of obstacles that a force presses
        (:class:`adaptmg.Rigid`), and the strain that shortens a body (:class:`adaptmg.Preload`).
    pressures : (n_groups,) array
        Of nearly incompressible bodies with smoothed elements: what the mean volume strains of
        groups of nodes add to the stress, Pa, tension positive (:mod:`adaptmg.discrete.volumes`).

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
    history: dict[str, np.ndarray]
    timings: dict[str, float]
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
    pressures: np.ndarray = field(default_factory=lambda: np.empty(0))

    #: of the columns of stresses and strains
    COMPONENTS: ClassVar[tuple[str, ...]] = ("xx", "yy", "zz", "xy", "yz", "xz")

    @property
    def method(self) -> str:
        """Return the name of the solver, and of what took over from it."""
        return f"{self.solver_name}, then {self.fallback}" if self.fallback else self.solver_name

    @property
    def dim(self) -> int:
        """Return the space dimension."""
        return self.displacement.shape[1]

    @property
    def seconds(self) -> float:
        """Return the seconds of all phases of the solve, set-up included, without meshing, assembly
        and compiling."""
        return float(
            sum(seconds for phase, seconds in self.timings.items() if phase != "compiling")
        )

    @property
    def advice(self) -> tuple[str, ...]:
        """Return what would make the answer better, which printing the result shows too: contact
        that does not fill its boundary needs 12 nodes in each patch, in 3D 30.

        Examples
        --------
        >>> am.solve(am.Hierarchy.graded(am.cases.hertz_cylinder())).advice
        ()
        """
        mesh = self.mesh
        return () if mesh is None else tuple(advice_on_patches(self.contact, mesh))

    def __repr__(self) -> str:
        return shortened(str(self))

    def _repr_html_(self) -> str:
        return in_html_lines(str(self)) + (
            html_table(self.pairs()) if self.mesh is not None else ""
        )

    def __str__(self) -> str:
        states = self.contact.counts()
        certified = ""
        if self.checked is not None:
            worst = self.checked.worst
            certified = (
                f"\n  certificate: worst {worst.name} {worst.largest:.2e} {worst.unit} (relative "
                f"{worst.relative:.2e}), energy error {self.checked.energy_error:.2e}; "
                f"{self.timings.get('certificate', 0.0):.2g} s"
            )
        return (
            f"Result of {self.method} for {self.problem_name}: {self.status.name}\n"
            f"  {len(self.displacement)} nodes, {len(self.contact)} contact nodes: "
            f"{', '.join(f'{count} {state}' for state, count in states.items())}\n"
            f"  {self.cycles} cycles, {self.work_units:.2f} work units, {self.seconds:.3g} s\n"
            f"  natural residual {self.residual:.2e}, estimated error {self.error_estimate:.2e} "
            f"(rtol {self.rtol:g}){certified}"
            + f"\n  solver=None: {self.choice}" * bool(self.choice)
            + "".join(f"\n  {line}" for line in self.advice)
        )

    def certificate(
        self, problem: DiscreteProblem | None = None, *, bound: bool = False
    ) -> Certificate:
        """Check by how much each condition of contact is violated, by code that shares nothing with
        the solvers.

        Without ``problem``: what was found when the problem was solved; with it that is checked
        again, and ``bound`` bounds the energy error by a sparse factorisation."""
        checks.flag("bound", bound)
        if problem is not None:
            checks.instance("problem", problem, DiscreteProblem)
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

    def probe(self, points: ArrayLike) -> np.ndarray:
        """Return the displacement (n, dim), m, at points (n, dim), m; ValueError without a mesh, or
        outside it."""
        location = self._located(points)
        return np.einsum(
            "nk,nkd->nd",
            location.weights,
            self.displacement[need_mesh(self).elements[location.element]],
        )

    def _located(self, points: ArrayLike) -> Location:
        from adaptmg.transfer import PointLocator

        mesh = need_mesh(self)
        one = getattr(points, "ndim", 0) == 1 or (
            isinstance(points, (list, tuple)) and not any(map(np.ndim, points))
        )
        array = checks.array("points", [points] if one else points, (None, mesh.dim))
        location = PointLocator(mesh).locate(array)
        outside = location.distance > 1e-6 * mesh.element_sizes[location.element]
        if outside.any():
            i = int(np.argmax(outside))
            raise ValueError(
                f"point {i} {array[i].tolist()} lies {location.distance[i]:.3g} m outside the mesh"
            )
        return location

    def stress(self, at: str | ArrayLike = "elements", *, recovered: bool = False) -> np.ndarray:
        """Return the Cauchy stress, tension positive: xx, yy, zz, xy, yz, xz
        (``Result.COMPONENTS``).

        In 2D zz is the stress through the thickness, yz and xz are 0. In axisymmetry x is r, y the
        axis, zz the hoop.

        Parameters
        ----------
        at : "elements", "nodes" or (n, dim) array-like
            All elements (recovered: centroids), all nodes, or points, m. A point on an edge belongs
            to one of the elements there, a node that two bodies share to the body named first.
        recovered : bool
            False: the stress of the displacement, constant on each element (with the mean hoop
            strain; of smoothed elements from the means around edges); nodes have none. True:
            continuous in each body and linear on elements, fitted around each node (Zienkiewicz and
            Zhu): more accurate where the solution is smooth, too smooth where it is not.

        Returns
        -------
        (n, 6) array
            Pa; ValueError without mesh or materials, at a point outside the mesh, or for nodes
            without ``recovered``.
        """
        return self._values(self._data().tensors(need_mesh(self), self.displacement), at, recovered)

    def strain(self, at: str | ArrayLike = "elements", *, recovered: bool = False) -> np.ndarray:
        """Return the strain (n, 6), initial strains included: xx, yy, zz, xy, yz, xz; arguments as
        of :meth:`stress`.

        xy is half of the change of the angle. zz is the strain through the thickness (0 in plane
        strain), in axisymmetry the hoop strain."""
        return self._values(self._data().strains(need_mesh(self), self.displacement), at, recovered)

    def von_mises(self, at: str | ArrayLike = "elements", *, recovered: bool = False) -> np.ndarray:
        """Return the von Mises stress (n,), Pa, of :meth:`stress`, whose arguments it takes."""
        return von_mises(as_tensors(self.stress(at, recovered=recovered)))

    def principal_stresses(
        self, at: str | ArrayLike = "elements", *, recovered: bool = False
    ) -> np.ndarray:
        """Return the principal stresses (n, 3), largest first, Pa, of :meth:`stress`, whose
        arguments it takes."""
        tensors = as_tensors(self.stress(at, recovered=recovered))
        principal = np.full((len(tensors), 3), np.nan)
        finite = np.isfinite(tensors).all(axis=(1, 2))
        principal[finite] = np.linalg.eigvalsh(tensors[finite])[:, ::-1]
        return principal

    def stress_intensity(
        self, crack: str, tip: int = 0, *, radius: float | None = None
    ) -> StressIntensity:
        """Return the stress intensity factors at a tip of a plane crack, by the interaction
        integral.

        Contact forces and loads on the faces, loads in the body and initial strains are counted;
        tractions on the faces within the radius are taken as smooth. The radius ends before another
        material, and before the crack turns by more than 5 degrees.

        Parameters
        ----------
        crack : str
            Its name: its faces are the boundaries "crack.left" and "crack.right".
        tip : int
            0 where the path begins, 1 where it ends; where one of them is on the boundary, 0 is the
            other one.
        radius : float, optional
            Largest radius of the domain of integration, m, of five elements at least. Default: what
            a turn of the crack, the other tip (.45 of the length up to there) and other boundaries
            leave.

        Raises
        ------
        ValueError
            For other than plane problems and cracks; for a tip between two materials; where the mesh
            is too coarse at the tip.
        """
        data = self._data()
        if self.dim != 2 or data.axisymmetric or data.moduli is not None:
            raise ValueError(
                "stress_intensity: only plane problems (PlaneStrain, PlaneStress) of isotropic bodies "
                "have K_I and K_II here"
            )
        return stress_intensity(
            need_mesh(self),
            self.displacement,
            data,
            checks.boundary_name("crack", crack),
            checks.integer("tip", tip, 0),
            radius,
        )

    @property
    def energy(self) -> float:
        """Return the strain energy, J (plane: J/m): u'Au / 2, with initial strains that of the
        elastic strains.

        The potential of loads and friction is not part of it.
        """
        return self._data().energy(need_mesh(self), self.displacement)

    @property
    def contact_area(self) -> float:
        """Return the area in contact, m^2 (plane problems: length, m): boundary masses of nodes not
        open."""
        return float(self.contact.measures[self.contact.closed].sum())

    @property
    def max_pressure(self) -> float:
        """Return the largest contact pressure of a node (force over boundary mass), Pa; 0 without
        contact nodes.

        A node where a contact boundary ends, at a plane or an axis of symmetry too, is the least
        accurate."""
        return float(self.contact.pressure.max(initial=0.0))

    @property
    def contact_extent(self) -> np.ndarray:
        """Return the half-widths (dim,) of the surfaces in contact along x, y (and z), m; 0 without
        contact.

        Half the sides of the box around them, in axisymmetry first their outer radius, of a ring
        half its width; half a (symmetric) model has half of its half. They end halfway between a
        node in contact and an open one. ValueError without a mesh."""
        return self._extent(np.ones(len(self.contact), dtype=bool))

    def _extent(self, own: np.ndarray) -> np.ndarray:
        """Of the contact nodes that the mask ``own`` chooses."""
        c = self.contact
        mesh = need_mesh(self)
        closed = np.isin(np.arange(mesh.n_nodes), c.node[own & c.closed])
        points = [mesh.points[closed]]
        for k in np.unique(c.boundary[own]):
            facets = mesh.boundary_facets(c.names[k])
            for a, b in combinations(facets.T, 2):
                ends = closed[a] != closed[b]
                points.append(0.5 * (mesh.points[a[ends]] + mesh.points[b[ends]]))
        every = np.concatenate(points)
        if not len(every):
            return np.zeros(self.dim)
        low = every.min(axis=0)
        high = every.max(axis=0)
        # up to rounding, as in meshes that are turned profiles
        if c.axisymmetric and low[0] <= 1e-12 * high[0]:
            low[0] = -high[0]
        return 0.5 * (high - low)

    def pairs(self) -> pandas.DataFrame:
        """Return one row a contact boundary or pair, with units in the heads; ValueError without a
        mesh.

        Nodes by state; the force on the body (the slave) and, unless axisymmetric, its moment about
        the origin; area, half-widths as of :attr:`contact_extent`, largest pressure."""
        import pandas

        c = self.contact
        axes = "xyz"[: self.dim]
        rows = []
        force, area = c.units
        moment, about = ("N m", axes) if self.dim == 3 else ("N", "" if c.axisymmetric else "z")
        for k, (name, pair) in enumerate(zip(c.names, c.pair_names, strict=True)):
            own = c.boundary == k
            on_it = self.resultant(name)
            row = {"pair": pair}
            row |= c.counts(own) | {f"area [{area}]": c.measures[own & c.closed].sum()}
            for what, unit, letters, values in (
                ("force", force, axes, on_it.force),
                ("moment", moment, about, np.atleast_1d(cast("np.ndarray", on_it.moment))),
                ("half_width", "m", axes, self._extent(own)),
            ):
                row |= {
                    f"{what}_{axis} [{unit}]": value
                    for axis, value in zip(letters, values, strict=False)
                }
            rows.append(row | {"max_pressure [Pa]": c.pressure[own].max(initial=0.0)})
        return pandas.DataFrame(rows)

    def work_to(self, error: float, of: str = "error_estimate") -> float:
        """Return the work units until an error of the history fell below ``error`` for good;
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
        above = np.flatnonzero(~(values <= error))
        first = above[-1] + 1 if len(above) else 0
        return float(work[first]) if first < len(work) else float("inf")

    def _data(self) -> StressData:
        if self.stress_data is None or self.mesh is None:
            raise ValueError(
                "this result has no materials to compute stresses from (it comes from a bare "
                "DiscreteProblem): replace its mesh and stress_data=StressData.of(mesh, material)"
            )
        return self.stress_data

    def _values(self, tensors: np.ndarray, at: str | ArrayLike, recovered: bool) -> np.ndarray:
        """Tensors (n_elements, 3, 3) as columns where they are asked for."""
        from adaptmg.discrete.stress import recovered as fit

        values = tensors[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
        location = None if isinstance(at, str) else self._located(at)
        if location is None:
            checks.choice("at", at, ("elements", "nodes"))
        if not checks.flag("recovered", recovered):
            if location is None and at == "nodes":
                raise ValueError(
                    "at='nodes' needs recovered=True: the elements of a node have different values"
                )
            return values if location is None else values[location.element]
        mesh = need_mesh(self)
        cells, nodal = fit(mesh, values)
        if location is not None:
            return np.einsum("nk,nkc->nc", location.weights, nodal[cells[location.element]])
        return nodal[: mesh.n_nodes] if at == "nodes" else nodal[cells].mean(axis=1)

    def resultant(self, boundary: str = "contact", about: np.ndarray | None = None) -> Resultant:
        """Return force, N, and moment, N m, on the body through a boundary; about a point (dim,),
        m, or the origin.

        ``boundary`` is 'contact' for all contact boundaries (of pairs the slaves), or one of them
        or a master (its contact forces), or one of a tie, or any other boundary (reactions of its
        supports and springs), or "point (0, 1)" of a PointSpring. In 2D all is per metre. Forces on
        slave and master of a pair balance to rounding; their moments up to the lever between the
        two discrete surfaces: 1e-8 to 1e-4 of force times size on curved ones, across whose gap the
        mortar transmits each force without regard to its arm."""
        mesh = self.mesh
        checks.instance("boundary", boundary, str, "a string")
        at_point = mesh is not None and boundary in self.springs and boundary not in mesh.boundaries
        nodes, forces = (
            (np.empty(0, int), np.zeros((0, self.dim))) if at_point else self._forces_on(boundary)
        )
        if mesh is None:
            return Resultant(forces.sum(axis=0), None)
        about = np.zeros(self.dim) if about is None else checks.vector("about", about, self.dim)
        tied = () if self.ties is None else self.ties.names
        touches = boundary in ("contact", *self.contact.names, *self.contact.masters, *tied)
        of_springs = np.array(
            self.springs.get("" if touches else boundary, np.zeros(3 * self.dim - 3))
        )
        force = of_springs[: self.dim]
        turning = of_springs[self.dim :]
        turning = (
            turning - moment(about[None], force[None]) + moment(mesh.points[nodes] - about, forces)
        )
        return Resultant(
            forces.sum(axis=0) + force, turning if self.dim == 3 else float(turning[0])
        )

    def _forces_on(self, boundary: str) -> tuple[np.ndarray, np.ndarray]:
        """Nodes and the forces on them: of contact, or elsewhere of supports alone (a corner node
        may have both)."""
        checks.instance("boundary", boundary, str, "the name of a boundary")
        c = self.contact
        slave = np.array([boundary in ("contact", name) for name in c.names])
        master = np.array([boundary == name != "" for name in c.masters])
        if (
            self.ties is not None
            and boundary in self.ties.names
            and boundary not in (*c.names, *c.masters)
        ):
            return self.ties.on(boundary)
        if slave.any() or master.any():
            own = slave[c.boundary]
            others = np.where(
                c.master_is_slave, slave[c.master_boundary], master[c.master_boundary]
            )
            node, force = (
                (np.empty(0, int), np.empty((0, self.dim)))
                if self.ties is None
                else self.ties.on(boundary)
            )
            return (
                np.concatenate([c.node[own], c.master_node[others], node]),
                np.concatenate([c.force[own], c.master_force[others], force]),
            )
        if self.mesh is None:
            raise ValueError(f"boundary {boundary!r} is not known; known are 'contact', {c.names}")
        nodes = self.mesh.boundary_nodes(boundary)
        of_contact = np.zeros_like(self.reaction)
        of_contact[c.node] = c.force
        np.add.at(of_contact, c.master_node, c.master_force)
        if self.ties is not None:
            of_contact += self.ties.total(len(of_contact))
        return nodes, np.einsum(
            "nij,nj->ni", self._share(boundary, nodes), (self.reaction - of_contact)[nodes]
        )

    def _share(self, boundary: str, nodes: np.ndarray) -> np.ndarray:
        """The part (n, dim, dim) of the reactions at some nodes that the support on a boundary
        carries: of several supports that hold one direction the measures at the node decide."""
        n, (own, total) = len(self.reaction), np.zeros((2, len(nodes), self.dim, self.dim))
        for name, directions in self.supports.items():
            surface = need_mesh(self).surface(name)
            span = np.array(directions).T @ np.array(directions)
            at = np.bincount(
                surface.facets.ravel(), np.repeat(surface.measures, self.dim), minlength=n
            )
            held = at[nodes, None, None] * span
            total += held
            if name == boundary:
                own = held
        inverse = np.linalg.pinv(total, rcond=1e-10, hermitian=True)
        return own @ inverse + np.eye(self.dim) - total @ inverse

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to an ``.npz`` file, whole or not at all; see :mod:`adaptmg.solver.store`."""
        write_bytes(checks.file_path("path", path), packed(self, KINDS))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Result:
        """Read what :meth:`save` wrote; ValueError, which names the file, if it is something else
        or damaged, or a later step of a load path, which :meth:`PathResult.load` reads."""
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
    Moduli,
    Certificate,
    Condition,
    Status,
)


@dataclass(frozen=True, eq=False)
class Resultant:
    """Force (dim,) in N (2D: N/m) and moment in N m (3D: (3,); 2D: a number, N); the moment is None
    without a mesh."""

    force: np.ndarray
    moment: np.ndarray | float | None


def label(option: object) -> str:
    """Return the name of an option object with the fields that differ from their defaults, for
    tables and pictures."""
    if not is_dataclass(option) or isinstance(option, type):
        return repr(option)
    shown = []
    for item in fields(option):
        value = getattr(option, item.name)
        default = item.default_factory() if item.default_factory is not MISSING else item.default
        if item.repr and (default is MISSING or value != default):
            shown.append(f"{item.name}={label(value)}")
    return f"{type(option).__name__}({', '.join(shown)})"


def problem_name(grids: Hierarchy) -> str:
    """Return the name of the problem, or else of the finest level."""
    return grids.problem.name if grids.problem is not None else grids.finest.discrete.name


@lru_cache(maxsize=1)
def versions() -> dict[str, str]:
    """Return the versions of adaptmg and of what its numbers depend on."""
    return {
        name: importlib.metadata.version(name)
        for name in ("adaptmg", "ngsolve", "numpy", "scipy", "numba", "pyamg")
    }


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
        violated = () if result.checked is None else result.checked.contradictions(result.rtol)
        contradicted = (
            f" The certificate contradicts this tolerance: {', '.join(violated)}."
            if violated
            else ""
        )
        poisson = 0.0 if result.stress_data is None else result.stress_data.locking
        locked = (
            f'give the problem elements="smoothed", since linear ones lock at a Poisson\'s ratio of '
            f"{poisson:.4g}, where Coulomb's law may have no solution on them; else, "
            if poisson
            else ""
        )
        super().__init__(
            f"{result.method}: {result.status.name} after {result.cycles} cycles, natural residual "
            f"{result.residual:.2e}, estimated error {result.error_estimate:.2e}: {locked}"
            f"{result.status.value}.{contradicted} The last iterate is in the exception's .result; throw=False returns "
            "it instead."
        )

    def __repr__(self) -> str:
        return shortened(super().__repr__())

    def __reduce__(self) -> tuple[object, ...]:
        # exceptions are rebuilt from .args, which is the text here: a process that is handed one
        # back must not fail
        return type(self), (self.result,)
