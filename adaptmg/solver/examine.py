r"""Examiner: residual, reactions, contact quantities and certificate of a displacement, whatever
method it comes from; ContactResult: what it says of each contact node, and of the nodes of masters.

One product with the matrix as it was given, and rotations at the contact nodes alone. Sizes are
what errors and residuals refer to: the energy of the displacement and the forces that act. Unknowns
count from the prescribed values
:math:`\bar u` (zero elsewhere), :math:`u = w + \bar u`; the energy of :math:`\bar u`, and so :math:`\|w\|_A` and
:math:`|A\bar u|`, grows as the mesh is refined, and nothing may be related to it. The displacement itself has

.. math:: \|u\|_A^2 = w^T(\bar b - r) + 2\,w^T A\bar u + \bar u^T A\bar u,

with the load :math:`\bar b = b - A\bar u` of the unknowns and their residual r: no pass over the
matrix. The forces are the loads, the contact forces, and where displacements are prescribed the
reactions :math:`A u - b` of the supports."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, cast

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._text import html_table, in_html_lines, shortened
from adaptmg._units import converted, in_units
from adaptmg.discrete.coordinates import from_frames, rotate, rotate_back, to_frames
from adaptmg.discrete.elasticity import dofs_of
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.ties import TieForces, tie_forces
from adaptmg.mesh.arrays import mask_of
from adaptmg.smoother.conditions import natural_at_nodes, states
from adaptmg.smoother.system import (
    OPEN,
    SLIP,
    STICK,
    contact_blocks,
    held_stiffness,
    held_tangents,
    local_contact,
)
from adaptmg.solver.certificate import (
    Certificate,
    ConditionsOnMesh,
    certify,
    ratio,
)

if TYPE_CHECKING:
    import pandas

    from adaptmg.discrete.coordinates import Coupling
    from adaptmg.mesh.arrays import MeshArrays


#: nodes of a patch of contact below which peaks are doubted, by dimension. Half a cylinder of Hertz
#: with 4, 7, 13, 25, 49 nodes on the half-width: the peak is 13, 6.2, 4.1, 1.9, 1.1 % too large. Half a
#: ball, with 30, 61 and 200 nodes in the patch: 21, 11, 11 %; another one with 54, 124, 242: 17, 9, 10 %,
#: as nodal pressures scatter on tetrahedra (the how-to on round bodies)
FEW_NODES = {2: 12, 3: 60}
_STATES = {"open": OPEN, "slip": SLIP, "stick": STICK}


@dataclass(frozen=True, eq=False)
class ContactResult:
    """Contact quantities, one entry a contact node; SI units.

    Between bodies these are displacements of the slave relative to the master (along components
    that a support fixes at the slave node: its own), and forces on the slave; those on the master
    balance them.

    Of a step of a load path, slips and forces of friction are those of that step: the slip counts
    from the displacement of the step before. ``Result.dissipation`` is the energy that friction
    dissipates in a step, ``PathResult.dissipation`` that of a path.

    Attributes
    ----------
    node : (n,) int array
        Numbers of the contact nodes in the mesh.
    x : (n, dim) array
        Position before deformation, m (NaN if the problem has no coordinates).
    frames : (n, dim, dim) array
        Unit vectors by row: the normal, out of the body, then the tangents.
    gap : (n,) array
        g0 - u_n, m.
    u_n : (n,) array
        Normal displacement, m.
    u_t, slip : (n, dim - 1) arrays
        Tangential displacement and slip (u_t minus its reference), m. In 2D (n, 1): along the normal
        turned by +90 degrees; ``slip[:, 0]`` has the numbers.
    force_n : (n,) array
        Compressive nodal force p >= 0, N (2D: N/m).
    force_t : (n, dim - 1) array
        Tangential nodal force on the body, N; in 2D (n, 1), N/m, against the slip.
    weights : (n,) array
        Lumped boundary mass, m^2 (2D: m).
    limit : (n,) array
        What the law allows for ``|force_t|``, N (2D: N/m).
    state : (n,) int8 array
        ``am.OPEN``, ``am.SLIP``, ``am.STICK``.
    boundary : (n,) int array
        Index into ``names``.
    names : tuple of str
        Contact boundaries.
    masters : tuple of str
        For each of ``names`` the boundary of the other body, "" for a rigid obstacle.
    master_node : (m,) int array
        Other nodes on which contact forces act: of the masters, and those of the contact boundary
        that carry no contact conditions of it. For each pair each node once of either.
    master_force : (m, dim) array
        Contact forces on them (Cartesian), N (2D: N/m).
    master_boundary : (m,) int array
        Their contact boundary or pair: index into ``names``.
    master_is_slave : (m,) bool array
        Which of them lie on the contact boundary itself.
    measures : (n,) array
        The part of the boundary on which the forces of contact nodes act: ``weights``, and where
        the neighbours carry no conditions their part.
    axisymmetric : bool
        Whether x is the radius, and forces and masses are those of the full circumference (N, m^2).
    accumulated_slip : (n,) array
        Length of the slips at the end of a step of a load path, m, which the next step begins with.

    Examples
    --------
    >>> contact = am.solve(am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))).contact
    >>> contact.force_n.shape, contact.force_t.shape
    ((5,), (5, 1))
    """

    node: np.ndarray
    x: np.ndarray
    frames: np.ndarray
    gap: np.ndarray
    u_n: np.ndarray
    u_t: np.ndarray
    slip: np.ndarray
    force_n: np.ndarray
    force_t: np.ndarray
    weights: np.ndarray
    limit: np.ndarray
    state: np.ndarray
    boundary: np.ndarray
    names: tuple[str, ...]
    masters: tuple[str, ...]
    master_node: np.ndarray
    master_force: np.ndarray
    master_boundary: np.ndarray
    master_is_slave: np.ndarray
    measures: np.ndarray
    axisymmetric: bool = False
    accumulated_slip: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def pair(self) -> np.ndarray:
        """Return the name of the contact boundary or pair ("slave on master") of each node (n,),
        str."""
        return np.array(self.pair_names)[self.boundary]

    @property
    def pair_names(self) -> list[str]:
        """Return for each of ``names`` the contact boundary, or "slave on master"."""
        return [
            f"{slave} on {master}" if master else slave
            for slave, master in zip(self.names, self.masters, strict=True)
        ]

    @property
    def closed(self) -> np.ndarray:
        """Return which nodes (n,) are in contact: not open."""
        return self.state != OPEN

    @property
    def units(self) -> tuple[str, str]:
        """Return the units of forces and of boundary masses: N and m^2, in plane problems N/m and
        m."""
        plane = self.frames.shape[1] == 2 and not self.axisymmetric
        return ("N/m", "m") if plane else ("N", "m^2")

    def counts(self, mask: np.ndarray | None = None) -> dict[str, int]:
        """Return the number of nodes by state, 'open', 'slip' and 'stick'; of all nodes or of those in
        a mask (n,)."""
        states = np.asarray(self.state if mask is None else self.state[mask])
        return {name: int((states == code).sum()) for name, code in _STATES.items()}

    def table(self, units: str | None = None) -> pandas.DataFrame:
        """Return one row a contact node, with units in the heads; in 3D with "slip_1 [m]", "slip_2
        [m]", and so on. ``units``: "SI", "mm-MPa" or "in-psi", by default those of
        :func:`adaptmg.set_units`."""
        import pandas

        columns: dict[str, object] = {
            "node": self.node,
            "pair": self.pair,
            "state": np.array(list(_STATES))[np.asarray(self.state, dtype=int)],
        }
        columns |= {f"{axis} [m]": values for axis, values in zip("xyz", self.x.T, strict=False)}
        # the unknown of a scalar problem has the unit that the user gives it
        scalar = self.frames.shape[1] == 1
        for name, unit in (
            ("gap", "m"),
            ("u_n", "m"),
            ("u_t", "m"),
            ("slip", "m"),
            ("force_n", self.units[0]),
            ("force_t", self.units[0]),
            ("pressure", "Pa"),
            ("traction", "Pa"),
        ):
            parts = np.atleast_2d(getattr(self, name).T)
            head = "" if scalar else f" [{unit}]"
            columns |= {
                f"{name}_{k}{head}" if len(parts) > 1 else f"{name}{head}": part
                for k, part in enumerate(parts, 1)
            }
        return in_units(pandas.DataFrame(columns), units)

    def __repr__(self) -> str:
        factor, unit = converted("Pa")
        return shortened(
            f"ContactResult: {len(self)} nodes of {', '.join(self.pair_names)}: {counted_states(self)}; pressure up to "
            f"{factor * self.pressure.max(initial=0.0):.3g} {unit}; table() lists them"
        )

    def _repr_html_(self) -> str:
        # what fits on a page: of solids all 18 columns are twice as wide
        names = "pair|state" if len(self.names) > 1 else "state"
        narrow = self.table().filter(regex=rf"^({names}|[xyz] |gap|slip|pressure|traction)")
        return in_html_lines(repr(self)) + html_table(narrow)

    @property
    def pressure(self) -> np.ndarray:
        """Return the compressive nodal force over lumped boundary mass (n,), Pa; 0 at open
        nodes."""
        return np.where(self.closed, self.force_n / self.weights, 0.0)

    @property
    def traction(self) -> np.ndarray:
        """Return the tangential nodal force over lumped boundary mass (n, dim - 1), Pa; 0 at open
        nodes."""
        return np.where(self.closed[:, None], self.force_t / self.weights[:, None], 0.0)

    @property
    def normal(self) -> np.ndarray:
        """Return the unit normals out of the body (n, dim)."""
        return self.frames[:, 0]

    @property
    def force(self) -> np.ndarray:
        """Return the contact forces on the contact nodes, Cartesian (n, dim), N (2D: N/m)."""
        return from_frames(self.frames, np.column_stack([-self.force_n, self.force_t]))

    def __len__(self) -> int:
        return len(self.node)


@dataclass(frozen=True, eq=False)
class Examined:
    """A displacement, and the quantities and the certificate that are computed from it."""

    displacement: np.ndarray  # (n_nodes, dim): of the bodies, m
    reaction: np.ndarray  # (n_nodes, dim): on the bodies, N
    contact: ContactResult
    ties: TieForces | None
    residual: float  # natural, relative to the forces that act
    checked: Certificate | None  # None: the examiner makes no certificates


class Examiner:
    """Examines displacements of one problem."""

    def __init__(
        self,
        discrete: DiscreteProblem,
        on_mesh: ConditionsOnMesh | None = None,
        certified: bool = True,
        friction_before: np.ndarray | None = None,
    ) -> None:
        """Prepare for a problem; ``on_mesh`` returns the lines of the certificate that need the mesh. Without
        ``certified`` there are no certificates. ``friction_before`` (n_nodes, dim), N, acted in the step
        before."""
        self.discrete = discrete
        self.on_mesh = on_mesh
        self.certified = certified
        self.contact, self.frames = local_contact(discrete)
        self.held = held_tangents(discrete)
        self.blocks = contact_blocks(discrete)
        self.sizes = Sizes(discrete)
        self.friction_before = friction_before
        self._last: tuple[np.ndarray, Examined] | None = None
        self._last_residual: tuple[np.ndarray, float] | None = None

    def relative_residual(self, solution: np.ndarray) -> float:
        """Return the natural residual of a solution (n_unknowns,) over the forces that act, in
        Euclidean norms; 1 if no other forces act. The last answer is remembered with its solution, which
        must not change any more: a load step asks twice for that of its extrapolation."""
        if self._last_residual is None or not np.array_equal(self._last_residual[0], solution):
            values = self._values(self.discrete.parts(solution)[0])
            residual = self._residual(solution, self.discrete.residual(solution), values)
            self._last_residual = solution, residual
        return self._last_residual[1]

    def _at_contact(self, vector: np.ndarray) -> np.ndarray:
        """Return the local components (n_contact, dim) of a vector (n_dofs,), zero along held
        tangents."""
        local = to_frames(
            self.frames, vector.reshape(-1, self.discrete.dim)[self.discrete.contact.nodes]
        )
        local[:, 1:][self.held] = 0.0
        return local

    def _values(self, solved: np.ndarray) -> np.ndarray:
        """Return the unknowns w (n_contact, dim) of a displacement u (n_dofs,), local."""
        return self._at_contact(self.discrete.from_prescribed(solved))

    def _residual(self, solution: np.ndarray, residual: np.ndarray, values: np.ndarray) -> float:
        """Return the relative natural residual of a solution (n_unknowns,) whose residual r = b - A w
        (n_dofs,), N, and unknowns ``values`` (n_contact, dim) at contact nodes are known: the norm of the
        free part of r away from contact, of the natural residual at contact nodes and of what the
        volumes miss, over the largest norm of loads, contact forces and reactions."""
        discrete = self.discrete
        solved, pressures = discrete.parts(solution)
        free = discrete.free_part(residual)
        at_contact = self._at_contact(free)
        # the friction of laws that see pressure and slip is that of this state
        self.contact.follow(values, at_contact)
        natural = natural_at_nodes(self.contact, self.blocks, values, at_contact)
        whole = free  # the free part of r away from contact, the natural residual at contact nodes
        whole.reshape(-1, discrete.dim)[discrete.contact.nodes] = natural
        missed = discrete.volumes.scale * discrete.volumes.missed(solved, pressures)
        size = float(np.hypot(euclidean_norm(whole), euclidean_norm(missed)))
        contact_norm = euclidean_norm(at_contact.reshape(-1))
        unknowns = solved  # w: the prescribed values are subtracted where there are any
        if self.sizes.prescribed:
            unknowns = discrete.free_part(solved)
            # supports may move bodies that nothing strains: all forces are then rounding, and are no scale. A
            # row sums terms of the size of its diagonal times its displacement
            floor = ROUNDING * euclidean_norm(discrete.rows.diagonal() * unknowns)
            if size <= floor and self.sizes.nothing_strains(contact_norm, floor, unknowns):
                return 0.0
        return ratio(size, self.sizes.forces(unknowns, contact_norm))

    def __call__(self, solution: np.ndarray, rtol: float = 0.0) -> Examined:
        """Examine a solution (n_unknowns,), between bodies in relative coordinates. The last answer is
        remembered with its solution, which must not change any more. ``rtol``: the requested
        tolerance."""
        if self._last is not None and np.array_equal(self._last[0], solution):
            return self._last[1]
        discrete = self.discrete
        self._last = None  # frees its arrays before others are made
        residual = discrete.residual(solution)
        solved, pressures = discrete.parts(solution)
        displacement = discrete.physical(solved.reshape(discrete.n_nodes, discrete.dim))
        values = self._values(solved)
        contact = self._contact_result(solved, residual, values)
        natural = self._residual(solution, residual, values)
        checked = (
            certify(
                discrete,
                displacement,
                contact,
                rtol=rtol,
                pressures=pressures,
                residual=residual,
                on_mesh=self.on_mesh,
            )
            if self.certified
            else None
        )
        exerted = -residual  # A u - b
        examined = Examined(
            displacement=displacement,
            reaction=discrete.physical_forces(exerted).reshape(displacement.shape),
            contact=contact,
            ties=tie_forces(discrete, exerted),
            residual=natural,
            checked=checked,
        )
        self._last = solution, examined
        return examined

    def _held_friction(
        self, slip: np.ndarray, slip_size: np.ndarray, slides: np.ndarray, limit: np.ndarray
    ) -> np.ndarray:
        r"""Return the friction (n_contact, dim - 1), N, along tangents where a support or an obstacle
        prescribes the ``slip`` tau, m, of length ``slip_size`` (n_contact,). With the bound ``limit`` s + mu p
        (n_contact,), N, and the stiffness k of supports it is

        .. math:: -\min(s + \mu\,p,\ k\,|\tau|)\,\tau / |\tau|

        at the nodes of the mask ``slides`` (n_contact,), and elsewhere that of the step before, up to its
        bound. Without k the force on an obstacle would jump where its motion turns round: prescribed
        forces between both values would have no motion."""
        size = np.minimum(limit, held_stiffness(self.discrete) * slip_size)
        direction = np.divide(
            slip, slip_size[:, None], out=np.zeros_like(slip), where=slides[:, None]
        )
        friction = -size[:, None] * direction
        if self.friction_before is None:
            return friction
        before = self.friction_before[self.discrete.contact.nodes]
        before = to_frames(self.frames, before)[:, 1:]
        size_before = np.linalg.norm(before, axis=1)
        share = np.minimum(limit, size_before) / np.where(size_before > 0.0, size_before, 1.0)
        return np.where(slides[:, None], friction, share[:, None] * before)

    def _contact_result(
        self, solved: np.ndarray, residual: np.ndarray, values: np.ndarray
    ) -> ContactResult:
        """Return contact quantities at a solution (n_dofs,) with its residual r (n_dofs,) and the unknowns
        ``values`` (n_contact, dim) of contact nodes: the pressure force p = max(0, r_n) and the friction
        f_t = -r_t. Where a support holds a tangent, r_t is friction and reaction of the support together:
        there the friction is that of the law."""
        discrete = self.discrete
        frames = self.frames
        held = self.held
        contact = self.discrete.contact
        # slips are differences of displacements of this size, whose rounding is not a slip
        negligible_slip = 1e-12 * np.abs(solved).max(initial=0.0)
        force = self._at_contact(residual)
        u = to_frames(frames, discrete.at_contact(solved.reshape(discrete.n_nodes, discrete.dim)))
        if discrete.dim == 1:  # the nearest obstacle is reported
            contact = contact.facing(u)
            frames = contact.normals[:, None]
            force = contact.normals * force
            u = contact.normals * u
        slip = u[:, 1:] - to_frames(frames, contact.slip_reference)[:, 1:]
        force_n = np.maximum(force[:, 0], 0.0)
        self.contact.follow(values, force)
        limit = self.contact.limit + self.contact.friction * force_n
        state = states(self.contact, values, force_n, negligible_slip)
        slip_size = np.linalg.norm(slip, axis=1)
        slides_held = held.any(axis=1) & (slip_size > negligible_slip)
        force_t = -force[:, 1:]
        if held.any():
            force_t = np.where(
                held, self._held_friction(slip, slip_size, slides_held, limit), force_t
            )
        # ``values`` are zero along held tangents: ``states`` sees no slip there
        state[slides_held & (state == STICK)] = SLIP
        x = discrete.coordinates
        # gaps and displacements of a contact node contain those of the nodes of which it takes over the
        # shares V: over 1 + sum(V) they are means, which are reported
        measures = contact.measures
        share = measures / contact.weights
        other_nodes, other_forces, other_boundary, on_slave = _forces_on_other_nodes(
            discrete, from_frames(frames, np.column_stack([-force_n, force_t]))
        )
        return ContactResult(
            node=contact.nodes,
            x=np.full(contact.normals.shape, np.nan) if x is None else x[contact.nodes],
            frames=frames.copy(),
            gap=(contact.gaps - u[:, 0]) / share,
            u_n=u[:, 0] / share,
            u_t=u[:, 1:] / share[:, None],
            slip=slip / share[:, None],
            force_n=force_n,
            force_t=force_t,
            weights=contact.weights,
            limit=limit,
            state=state,
            boundary=contact.boundary,
            names=contact.names,
            masters=contact.masters,
            master_node=other_nodes,
            master_force=other_forces,
            master_boundary=other_boundary,
            master_is_slave=on_slave,
            measures=measures,
            accumulated_slip=contact.accumulated_slip + slip_size / share * (state != OPEN),
        )


def _forces_on_other_nodes(
    discrete: DiscreteProblem, forces: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return the nodes (m,) without a condition on which contact forces (n_contact, dim) act, the
    forces (m, dim) on them, the numbers (m,) of the contacts, and the mask (m,) of the nodes on
    slave surfaces; the others are on masters.

    With the shares V (n_contact, n_nodes) that contact nodes take over and contact forces f, nodes of
    a contact boundary without a condition carry V'(f - P f) + P_i V'P f. P projects on what supports
    hold at the contact nodes, and P_i on what they hold at node i: a force on a support of the contact
    node goes into that support, unless node i has it, too. Nodes of a master carry -W'f, with the
    weights W of :func:`_weights_of_masters`."""
    contact = discrete.contact
    # nodes, forces, contacts and mask, piece by piece; the first piece is empty
    pieces = [
        (
            np.empty(0, dtype=np.int64),
            np.empty((0, discrete.dim)),
            np.empty(0, np.int64),
            np.empty(0, bool),
        )
    ]
    if discrete.coupling is None:  # nodes that are taken over would have made one
        return pieces[0]
    held_forces = np.einsum("nij,nj->ni", discrete.held_spans(contact.nodes), forces)
    all_weights, all_forces, boundaries = _weights_of_masters(discrete, forces)
    for k in np.unique(contact.boundary):
        slaves = np.flatnonzero(contact.boundary == k)
        taken_over = contact.taken_over[slaves]
        neighbours = np.unique(taken_over.indices).astype(np.int64)
        carried = (taken_over.T @ forces[slaves])[neighbours]
        held = (taken_over.T @ held_forces[slaves])[neighbours]
        # V'f - (V'P f - P_i V'P f)
        carried -= held - np.einsum("nij,nj->ni", discrete.held_spans(neighbours), held)
        pieces.append((neighbours, carried, np.full(len(carried), k), np.full(len(carried), True)))
        rows = np.flatnonzero(boundaries == k)
        weights = all_weights[rows]
        masters = np.unique(weights.indices).astype(np.int64)
        on_masters = -(weights.T @ all_forces[rows])[masters]
        pieces.append((masters, on_masters, np.full(len(masters), k), np.full(len(masters), False)))
    node, exerted, boundary, on_slave = map(np.concatenate, zip(*pieces, strict=True))
    return node, exerted, boundary, on_slave


def _weights_of_masters(
    discrete: DiscreteProblem, forces: np.ndarray
) -> tuple[sparse.csr_array, np.ndarray, np.ndarray]:
    """Return rows W (m, n_nodes) of weights of master nodes, the parts (m, dim) of contact forces
    (n_contact, dim) that these carry, and the numbers (m,) of the contacts.

    A row for each contact node has the weights of all nodes that it faces. Along a tangent that
    supports hold at the contact node and at some of these, the held ones carry all: the part of the
    force along it is in a row of its own."""
    contact = discrete.contact
    taken_over = contact.taken_over
    # the coupling has -V in the columns of the nodes whose shares are taken over: V cancels it up to
    # rounding
    weights = cast("Coupling", discrete.coupling).weights[contact.nodes]
    if taken_over.shape[1]:
        weights = sparse.csr_array(weights + taken_over)
        weights.data[np.abs(weights.data) < checks.ROUNDING] = 0.0
        weights.eliminate_zeros()
    rows = [weights]
    parts = [forces.copy()]
    boundaries = [contact.boundary]
    for slaves, held_weights, tangents in discrete.held_together():
        along = np.einsum("nd,nd->n", tangents, forces[slaves])[:, None] * tangents
        parts[0][slaves] -= along
        rows.append(held_weights)
        # the row of a contact node has this sum, that of the held weights the sum 1: both then carry the
        # same
        row_sums = 1 + taken_over[slaves].sum(axis=1)
        parts.append(row_sums[:, None] * along)
        boundaries.append(contact.boundary[slaves])
    return (
        sparse.csr_array(sparse.vstack(rows, format="csr")),
        np.concatenate(parts),
        np.concatenate(boundaries),
    )


#: a natural residual below this share of the terms it sums is rounding
ROUNDING = 8 * np.finfo(float).eps


def energy_norm(unknowns: np.ndarray, forces: np.ndarray) -> float:
    """Return sqrt(w' A w) from w (n,) and A w (n,), 0 where rounding makes w' A w negative."""
    # not through BLAS: its threads cost more than a short dot product gains, several times over on
    # a busy machine
    return float(np.sqrt(max(float(np.einsum("i,i->", unknowns, forces)), 0.0)))


def euclidean_norm(vector: np.ndarray) -> float:
    """Return |v| of a flat vector, on one thread."""
    return energy_norm(vector, vector)


def displacement_norm(problem: DiscreteProblem, displacement: np.ndarray) -> float:
    """Return ||u||_A of the stresses of a displacement (n_dofs,), prescribed values included;
    between bodies relative."""
    flat = np.asarray(displacement, dtype=np.float64).reshape(-1)
    return float(
        np.sqrt(problem.stress_energy(flat, energy_norm(flat, problem.rows.times(flat)) ** 2))
    )


class Sizes:
    """Norms used to make errors and residuals of one problem relative."""

    #: forces below this multiple of the rounding of a residual are rounding: 1 and 1e9 change none of 316 solves of
    #: random problems, none of which is idle
    IDLE = 1e3

    def __init__(self, problem: DiscreteProblem, frames: np.ndarray | None = None) -> None:
        """Prepare the norms of a problem; its unknowns are in contact ``frames`` (n_contact, dim,
        dim), if they are given, else Cartesian."""
        self.load = euclidean_norm(problem.load)
        self.prescribed = bool(problem.fixed_values.any())
        self._problem = problem
        self._frames = frames
        if not self.prescribed:
            return
        lift = problem.rows.times(problem.fixed_values)  # A ubar, ubar the prescribed values
        self._lift_energy = float(np.einsum("i,i->", problem.fixed_values, lift))  # ubar'A ubar
        nodes = problem.fixed_nodes()
        dofs = dofs_of(nodes, problem.dim)
        #: projections (n, dim, dim) onto what is held of the nodes
        self._held = np.eye(problem.dim) - problem.free_spans(nodes)
        self._held_rows = problem.rows.at_nodes(nodes)
        self._held_lift = lift[dofs]
        self._held_load = problem.load[dofs]
        self._free_load = euclidean_norm(problem.free_part(problem.load))
        #: A ubar in the components of the unknowns
        self._lift = lift if frames is None else rotate(lift, frames, problem.contact.nodes)

    def nothing_strains(self, contact: float, rounding: float, unknowns: np.ndarray) -> bool:
        """Return whether supports move the bodies, and nothing strains or holds them: all forces are
        rounding, except loads at nodes that a support holds. ``contact`` is the norm of the contact
        forces, ``rounding`` that of a residual which is rounding, both N; ``unknowns`` (n_dofs,) are
        those of :meth:`norm`, m. Diverged unknowns may have such forces, too, but they move more
        than ten times as far as the supports do."""
        if not self.prescribed:
            return False
        support_forces = self._in_supports(unknowns, load=0.0)
        if max(self._free_load, contact, support_forces) > self.IDLE * rounding:
            return False
        return bool(
            np.abs(unknowns).max(initial=0.0) <= 10 * np.abs(self._problem.fixed_values).max()
        )

    def norm(self, unknowns: np.ndarray, energy: float) -> float:
        """Return ||u||_A of the stresses, from the unknowns w (n_dofs,), zero at fixed dofs, and
        w'Aw (N m)."""
        if self.prescribed:
            # u'Au = w'Aw + 2 w'A ubar + ubar'A ubar
            energy += 2 * float(np.einsum("i,i->", unknowns, self._lift)) + self._lift_energy
        if self._problem.strain_free is not None:
            energy = self._problem.stress_energy(
                self._cartesian(unknowns) + self._problem.fixed_values, energy
            )
        return float(np.sqrt(max(energy, 0.0)))

    def forces(self, unknowns: np.ndarray, contact: float) -> float:
        """Return the largest norm of load, contact forces (norm ``contact``, N) and reactions at
        prescribed values."""
        if not self.prescribed:
            return max(self.load, contact)
        return max(self.load, contact, self._in_supports(unknowns, load=self._held_load))

    def _in_supports(self, unknowns: np.ndarray, load: np.ndarray | float) -> float:
        """Return the norm of A w + A ubar minus a ``load`` (n,) at the dofs of held nodes, along what is held,
        of unknowns w (n_dofs,)."""
        forces = self._held_rows @ self._cartesian(unknowns) + self._held_lift - load
        along = np.einsum("nij,nj->ni", self._held, forces.reshape(-1, self._problem.dim))
        return euclidean_norm(along.reshape(-1))

    def _cartesian(self, unknowns: np.ndarray) -> np.ndarray:
        """Return unknowns (n_dofs,) in Cartesian components."""
        return (
            unknowns
            if self._frames is None
            else rotate_back(unknowns, self._frames, self._problem.contact.nodes)
        )


def counted_states(contact: ContactResult) -> str:
    """Return the number of nodes by state as text; where no node bears friction they do not slip, they
    touch."""
    counts = contact.counts()
    if not contact.limit.any():
        counts = {"open": counts["open"], "touching": counts["slip"] + counts["stick"]}
    return ", ".join(f"{count} {state}" for state, count in counts.items())


@dataclass(frozen=True, eq=False)
class Patch:
    """A connected set of contact nodes that touch, with open ones around.

    Attributes
    ----------
    name : str
        The contact boundary.
    nodes : (n,) int array
    size : float
        Mean length of the edges there, m.
    """

    name: str
    nodes: np.ndarray
    size: float

    def share_for(self, nodes: float, dim: int) -> float:
        """Return the factor by which edges must change for about this number of nodes to touch there."""
        # n nodes in a row have n - 1 edges; in space 3 nodes less, so that a single facet, as a single node in
        # the plane, has none. At least half a cell, as the patch ends somewhere beyond its last nodes
        cells = max(len(self.nodes) - (1 if dim == 2 else 3), 0.5)
        return (cells / nodes) ** (1 / (dim - 1))  # cells grow like size^-(dim - 1)


def touching_patches(contact: ContactResult, mesh: MeshArrays) -> list[Patch]:
    """Return the patches of all contact boundaries of which a part touches."""
    patches = []
    for k, name in enumerate(contact.names):
        on_boundary = contact.boundary == k
        touching = on_boundary & (contact.state != OPEN)
        if touching.sum() in (0, on_boundary.sum()):
            continue
        inside = mask_of(contact.node[touching], mesh.n_nodes)
        # patches: nodes that touch, joined by edges of the boundary, the sides of its facets (in the plane
        # the facets themselves, twice)
        facets = mesh.boundary_facets(name)
        edges = np.concatenate([facets[:, [i - 1, i]] for i in range(mesh.dim)])
        pairs = edges[inside[edges].all(axis=1)]
        graph = sparse.coo_array((np.ones(len(pairs)), pairs.T), (mesh.n_nodes, mesh.n_nodes))
        labels = sparse.csgraph.connected_components(graph, directed=False)[1]
        for label in np.unique(labels[inside]):
            nodes = np.flatnonzero(inside & (labels == label))
            # the mean length of an edge of each facet at the patch
            near = mesh.points[facets[np.isin(facets, nodes).any(axis=1)]]
            size = float(np.linalg.norm(near[:, 1] - near[:, 0], axis=1).mean())
            patches.append(Patch(name, nodes, size))
    return patches


def advice_on_patches(contact: ContactResult, mesh: MeshArrays) -> list[str]:
    """Return a sentence for each contact boundary of which a part touches on few nodes, about its
    smallest patch; none of scalar problems, whose obstacles lie behind all nodes."""
    if contact.frames.shape[1] == 1:
        return []
    nodes_needed = FEW_NODES[mesh.dim]
    factor, unit = converted("m")
    smallest: dict[str, Patch] = {}
    for patch in touching_patches(contact, mesh):
        fewest = len(smallest[patch.name].nodes) if patch.name in smallest else nodes_needed
        if len(patch.nodes) < fewest:
            smallest[patch.name] = patch
    return [
        f"contact {name!r}: {len(patch.nodes)} nodes touch in a patch, and peaks of pressure need {nodes_needed}; "
        f"take elements of at most {factor * patch.size * patch.share_for(nodes_needed, mesh.dim):.2g} {unit} there"
        for name, patch in smallest.items()
    ]
