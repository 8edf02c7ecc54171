"""What a result is asked for: values at points, stresses, strains, forces, contact areas, cracks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg._units import in_units
from adaptmg.discrete.loads import moment
from adaptmg.discrete.moduli import PAIRS, as_tensors
from adaptmg.discrete.stress import PlasticState, StressData, von_mises
from adaptmg.discrete.stress import recovered as fitted
from adaptmg.discrete.stress_intensity import StressIntensity, stress_intensity
from adaptmg.discrete.ties import TieForces
from adaptmg.mesh.arrays import MeshArrays, mask_of, need_mesh
from adaptmg.solver.examine import ContactResult

if TYPE_CHECKING:
    import pandas

    from adaptmg.geometry.location import Location
    from adaptmg.solver.certificate import Certificate


class Quantities:
    """The answers of a :class:`adaptmg.Result`, computed from its fields when they are asked for."""

    displacement: np.ndarray
    contact: ContactResult
    reaction: np.ndarray
    mesh: MeshArrays | None
    stress_data: StressData | None
    checked: Certificate | None
    supports: dict[str, list[list[float]]]
    ties: TieForces | None
    springs: dict[str, list[float]]

    #: of the columns of stresses and strains
    COMPONENTS: ClassVar[tuple[str, ...]] = ("xx", "yy", "zz", "xy", "yz", "xz")

    @property
    def dim(self) -> int:
        """Return the space dimension, of scalar problems 1."""
        return self.displacement.shape[1]

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
        """Return the elements of points (n, dim) or of one point (dim,), m, and the weights of
        their corners; ValueError outside the mesh."""
        from adaptmg.transfer import PointLocator

        mesh = need_mesh(self)
        # a vector, or a list of numbers, is a single point
        is_point = getattr(points, "ndim", 0) == 1 or (
            isinstance(points, (list, tuple)) and not any(map(np.ndim, points))
        )
        array = checks.array("points", [points] if is_point else points, (None, mesh.dim))
        location = PointLocator(mesh).locate(array)
        # points on the boundary may lie outside by rounding
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
        # NaN where a stress is, which eigvalsh refuses
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

        Examples
        --------
        >>> plate = am.Rectangle(width=1.0, height=1.0)
        >>> crack = am.Cracked(plate, {"crack": [(0.3, 0.5), (0.7, 0.5)]})
        >>> problem = am.ContactProblem(
        ...     domain=crack,
        ...     material=am.PlaneStrain(young=2e11, poisson=0.3),
        ...     contact=am.ContactPair("crack.left", "crack.right"),
        ...     law=am.Frictionless(),
        ...     supports=am.Support("bottom", x=0.0, y=0.0),
        ...     loads=am.Traction("top", (0.0, 1e6)),
        ... )
        >>> result = am.solve(am.Hierarchy.graded(problem, sizes=(0.05, 0.025)))
        >>> result.stress_intensity("crack").K_I > 0
        True
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
    def plastic_strain(self) -> np.ndarray:
        """Return the plastic strain tensors (n_elements, 3, 3): what the stress leaves of the
        strain, 0 in elastic bodies. ValueError without plastic bodies."""
        return self._plastic().strain

    @property
    def accumulated_plastic_strain(self) -> np.ndarray:
        """Return the accumulated plastic strain (n_elements,), of user-defined materials the last
        number of their states; ValueError without plastic bodies."""
        return self._plastic().accumulated

    def _plastic(self) -> PlasticState:
        """Return the state of the plastic bodies; ValueError if there are none."""
        plastic = self._data().plastic
        if plastic is None:
            raise ValueError("this result has no plastic bodies: give one am.Plastic(...)")
        return plastic

    @property
    def energy(self) -> float:
        """Return the strain energy, J (plane: J/m): u'Au / 2, with initial strains that of the
        elastic strains.

        The potential of loads and friction is not part of it. Without materials (scalar problems,
        bare matrices) the energy is that of the certificate, of the displacement that was solved for.
        """
        if self.stress_data is None and self.checked is not None:
            return 0.5 * self.checked.energy_norm**2
        return self._data().energy(need_mesh(self), self.displacement)

    @property
    def dissipation(self) -> float:
        """Return the energy that friction dissipates in the (last) step of loading, J (plane: J/m):
        minus the tangential forces on the body times the slips.

        That of a load path is in :attr:`adaptmg.PathResult.dissipation`."""
        contact = self.contact
        # the force of a node works along the sum of its slip and those of nodes whose part it takes over;
        # contact.slip is their mean, the sum over measures / weights
        slips = contact.slip * (contact.measures / contact.weights)[:, None]
        return float(np.sum(-contact.force_t * slips))

    @property
    def contact_area(self) -> float:
        """Return the area in contact, m^2 (plane problems: length, m): boundary masses of nodes not
        open. As :attr:`contact_extent` it is accurate to half an edge at each end."""
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

        They are half the sides of the box around these surfaces. In axisymmetry the first one is the
        outer radius where contact reaches the axis, else half the width of the ring. If the model is one
        half of a symmetric body, the half of the contact that it has counts, so that a half-width across
        the plane of symmetry is half the true one. Surfaces in contact end halfway between a
        node in contact and an open one, and are accurate to about half an edge at each end: on Hertz's
        cylinder with 8 to 24 edges in the half-width they are .4 to .6 of an edge too large. Where
        contact of smooth surfaces ends, the square of the pressure falls in proportion to the
        distance: the line through its values at the second and fourth node from the end (the last
        one is inaccurate) meets zero within .3 to .05 of an edge there. ValueError without a mesh."""
        return self._extent(np.ones(len(self.contact), dtype=bool))

    def _extent(self, chosen: np.ndarray) -> np.ndarray:
        """Return the half-widths (dim of the mesh,), m, of contact at the ``chosen`` (n_contact,) nodes."""
        contact = self.contact
        mesh = need_mesh(self)
        closed = mask_of(contact.node[chosen & contact.closed], mesh.n_nodes)
        points = [mesh.points[closed]]
        for number in np.unique(contact.boundary[chosen]):
            # the obstacle of a scalar problem lies behind all elements
            facets = mesh.elements if self.dim == 1 else mesh.boundary_facets(contact.names[number])
            # contact ends halfway on edges of which one end is closed
            for a, b in combinations(facets.T, 2):
                ends = closed[a] != closed[b]
                points.append(0.5 * (mesh.points[a[ends]] + mesh.points[b[ends]]))
        surface = np.concatenate(points)
        if not len(surface):
            return np.zeros(mesh.dim)
        low = surface.min(axis=0)
        high = surface.max(axis=0)
        # up to rounding, as in meshes that are turned profiles
        if contact.axisymmetric and low[0] <= 1e-12 * high[0]:
            low[0] = -high[0]
        return 0.5 * (high - low)

    def pairs(self, units: str | None = None) -> pandas.DataFrame:
        """Return one row a contact boundary or pair, with units in the heads; ValueError without a
        mesh. ``units`` as of :meth:`adaptmg.solver.ContactResult.table`.

        Nodes by state; the force on the body (the slave) and, unless axisymmetric, its moment about
        the origin; area, half-widths as of :attr:`contact_extent`, largest pressure."""
        import pandas

        contact = self.contact
        axes = "xyz"[: need_mesh(self).dim]
        force_unit, area_unit = contact.units
        moment_unit = "N m" if self.dim == 3 else "N"
        moment_axes = axes if self.dim == 3 else "z"
        if contact.axisymmetric or self.dim == 1:
            moment_axes = ""
        rows = []
        for number, (name, pair) in enumerate(zip(contact.names, contact.pair_names, strict=True)):
            on_boundary = contact.boundary == number
            total = self.resultant(name)
            turning = total.turning if self.dim > 1 else np.empty(0)
            largest = contact.pressure[on_boundary].max(initial=0.0)
            area = contact.measures[on_boundary & contact.closed].sum()
            rows.append(
                {
                    "pair": pair,
                    **contact.counts(on_boundary),
                    f"area [{area_unit}]": area,
                    **_columns("force", force_unit, "u" if self.dim == 1 else axes, total.force),
                    **_columns("moment", moment_unit, moment_axes, turning),
                    **_columns("half_width", "m", axes, self._extent(on_boundary)),
                    "max_pressure [Pa]": largest,
                }
            )
        return in_units(pandas.DataFrame(rows), units)

    def _data(self) -> StressData:
        """Return the stress data; ValueError without them."""
        if self.dim == 1:
            raise ValueError(
                "result must be that of a body, got that of a scalar problem, which has no stresses and "
                "strains: its values are result.displacement[:, 0]"
            )
        if self.stress_data is None or self.mesh is None:
            raise ValueError(
                "this result has no materials to compute stresses from (it comes from a bare "
                "DiscreteProblem): replace its mesh and stress_data=StressData.of(mesh, material)"
            )
        return self.stress_data

    def _values(self, tensors: np.ndarray, at: str | ArrayLike, recovered: bool) -> np.ndarray:
        """Return tensors (n_elements, 3, 3) as the columns (n, 6) of ``COMPONENTS`` where they are asked
        for: ``at`` and ``recovered`` as of :meth:`stress`."""
        values = tensors[:, PAIRS[:, 0], PAIRS[:, 1]]
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
        cells, nodal = fitted(mesh, values)
        if location is not None:
            return np.einsum("nk,nkc->nc", location.weights, nodal[cells[location.element]])
        # the points of further bodies at shared nodes come behind all nodes
        return nodal[: mesh.n_nodes] if at == "nodes" else nodal[cells].mean(axis=1)

    def resultant(self, boundary: str = "contact", about: np.ndarray | None = None) -> Resultant:
        """Return force, N, and moment, N m, on the body through a boundary; about a point (dim,),
        m, or the origin.

        ``boundary`` is 'contact' for all contact boundaries (of pairs the slaves), or one of them
        or a master (its contact forces), or one of a tie, or any other boundary (reactions of its
        supports and springs), or "point (0, 1)" of a PointSpring. In 2D all is per metre. Forces on
        slave and master of a pair balance to rounding; their moments up to the lever between the
        two discrete surfaces, across whose gap the mortar transmits each force without regard to
        its arm: where these are curved, 1e-8 to 1e-4 of force times size without friction, and up
        to 5e-3 in ties of unlike meshes (31 edges around a circle on 13).

        Examples
        --------
        >>> problem = am.cases.greco_bar()  # 50 MPa on a width of 40 mm
        >>> result = am.solve(am.Hierarchy.uniform(problem, divisions=(2, 4)))
        >>> f"{result.resultant('bottom').force[1]:.4g} N/m"
        '2e+06 N/m'
        """
        checks.instance("boundary", boundary, str, "a string")
        nodes, forces = self._forces_on(boundary)
        total = forces.sum(axis=0)
        if self.mesh is None or self.dim == 1:
            return Resultant(total, None)
        about = np.zeros(self.dim) if about is None else checks.vector("about", about, self.dim)
        turning = moment(self.mesh.points[nodes] - about, forces)
        # springs act through the boundary, too, unless contact or a tie does
        tied_names = () if self.ties is None else self.ties.names
        if boundary in self.springs and boundary not in tied_names and not self._touches(boundary):
            of_springs = np.array(self.springs[boundary])  # force, then moment about the origin
            force = of_springs[: self.dim]
            total = total + force
            # their moment about the origin is taken to ``about``
            turning = of_springs[self.dim :] - moment(about[None], force[None]) + turning
        return Resultant(total, turning if self.dim == 3 else float(turning[0]))

    def _touches(self, boundary: str) -> bool:
        """Return whether a boundary is a contact boundary, a master, or 'contact' for all."""
        names = [name for name in (*self.contact.names, *self.contact.masters) if name]
        return boundary in names or (boundary == "contact" and bool(self.contact.names))

    def _forces_on(self, boundary: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the nodes (n,) of a boundary and the forces (n, dim), N, on them: those of contact, and of
        ties with it, if the boundary has contact; else those of ties; else those of supports without
        springs. At a corner a node may bear forces of both contact and a support."""
        if self._touches(boundary):
            return self._contact_forces(boundary)
        if self.ties is not None and boundary in self.ties.names:
            return self.ties.on(boundary)
        if self.mesh is None:
            raise ValueError(
                f"boundary {boundary!r} is not known; known are 'contact', {self.contact.names}"
            )
        if boundary in self.springs and boundary not in self.mesh.boundaries:
            return np.empty(0, dtype=np.int64), np.zeros((0, self.dim))  # springs at a point
        return self._support_forces(boundary)

    def _contact_forces(self, boundary: str) -> tuple[np.ndarray, np.ndarray]:
        """Return nodes (n,) and contact forces (n, dim), N, on a contact boundary or a master, with
        those of ties there."""
        contact = self.contact
        is_slave = np.array([boundary in ("contact", name) for name in contact.names])
        is_master = np.array([boundary == name != "" for name in contact.masters])
        slaves = is_slave[contact.boundary]
        # other nodes lie on the master, or on the slave surface itself, where they have no condition
        masters = np.where(
            contact.master_is_slave,
            is_slave[contact.master_boundary],
            is_master[contact.master_boundary],
        )
        nodes = [contact.node[slaves], contact.master_node[masters]]
        forces = [contact.force[slaves], contact.master_force[masters]]
        if self.ties is not None:
            tied_nodes, tie_forces = self.ties.on(boundary)
            nodes.append(tied_nodes)
            forces.append(tie_forces)
        return np.concatenate(nodes), np.concatenate(forces)

    def _support_forces(self, boundary: str) -> tuple[np.ndarray, np.ndarray]:
        """Return nodes (n,) of a boundary and the reactions (n, dim), N, of the supports on it."""
        nodes = need_mesh(self).boundary_nodes(boundary)
        forces = self.reaction.copy()
        forces[self.contact.node] -= self.contact.force
        np.add.at(forces, self.contact.master_node, -self.contact.master_force)
        if self.ties is not None:
            forces -= self.ties.total(len(forces))
        return nodes, np.einsum("nij,nj->ni", self._share(boundary, nodes), forces[nodes])

    def _share(self, boundary: str, nodes: np.ndarray) -> np.ndarray:
        """Return the part (n, dim, dim) of the reactions at some nodes that the support on a
        boundary carries: of several supports that hold one direction the measures at the node
        decide."""
        held_by_all = np.zeros((len(nodes), self.dim, self.dim))
        held_here = np.zeros_like(held_by_all)
        for name, directions in self.supports.items():
            surface = need_mesh(self).surface(name)
            directions_held = np.array(directions).T @ np.array(directions)
            measures = np.bincount(
                surface.facets.ravel(),
                np.repeat(surface.measures, self.dim),
                minlength=len(self.reaction),
            )
            held = measures[nodes, None, None] * directions_held
            held_by_all += held
            if name == boundary:
                held_here = held
        inverse = np.linalg.pinv(held_by_all, rcond=1e-10, hermitian=True)
        # directions that no support holds count whole: there the reaction is zero but for rounding
        return held_here @ inverse + np.eye(self.dim) - held_by_all @ inverse


def _columns(name: str, unit: str, axes: str, values: np.ndarray) -> Mapping[str, float]:
    """Return the components of a vector by the heads of their columns."""
    return {f"{name}_{axis} [{unit}]": value for axis, value in zip(axes, values, strict=False)}


@dataclass(frozen=True, eq=False)
class Resultant:
    """The force and the moment through a boundary: ``result.resultant(name)``.

    Attributes
    ----------
    force : (dim,) array
        On the body, N (2D: N/m).
    moment : (3,) array or float or None
        About the point asked for, N m; in 2D a number, N; None without a mesh.

    Examples
    --------
    >>> result = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4)))
    >>> round(float(result.resultant("bottom").force[1]), -3)         # N/m, against the top's 50 MPa
    2000000.0
    """

    force: np.ndarray
    moment: np.ndarray | float | None

    @property
    def turning(self) -> np.ndarray:
        """Return the moment as a vector, (3,) in 3D and (1,) in 2D; ValueError without a mesh."""
        if self.moment is None:
            raise ValueError("the moment is not known: make the hierarchy from meshes")
        return np.atleast_1d(self.moment)
