"""ContactResult: what a result says of each contact node, and of the nodes of masters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from adaptmg._on_demand import ABSENT
from adaptmg._text import html_table, in_html_lines, shortened
from adaptmg.discrete.coordinates import from_frames
from adaptmg.smoother.system import OPEN, SLIP, STICK

if TYPE_CHECKING:
    import pandas

    from adaptmg.mesh.arrays import MeshArrays

_STATES = {"open": OPEN, "slip": SLIP, "stick": STICK}


@dataclass(frozen=True, eq=False)
class ContactResult:
    """Contact quantities, one entry a contact node; SI units.

    Between bodies these are displacements of the slave relative to the master (along components that a support fixes
    at the slave node: its own), and forces on the slave; those on the master balance them.

    Attributes
    ----------
    node : (n,) int array
    x : (n, dim) array
        Position before deformation, m (NaN if the problem has no coordinates).
    frames : (n, dim, dim) array
        Unit vectors by row: the normal, out of the body, then the tangents.
    gap : (n,) array
        g0 - u_n, m.
    u_n : (n,) array
        Normal displacement, m.
    u_t, slip : (n, dim - 1) arrays
        Tangential displacement and slip (u_t minus its reference), m; in 2D along the normal turned by +90 degrees.
    force_n : (n,) array
        Compressive nodal force p >= 0, N (2D: N/m).
    force_t : (n, dim - 1) array
        Tangential nodal force on the body, N (2D: N/m).
    weights : (n,) array
        Lumped boundary mass, m^2 (2D: m).
    limit : (n,) array
        What the law allows for |force_t|, N (2D: N/m).
    state : (n,) int8 array
        ``am.OPEN``, ``am.SLIP``, ``am.STICK``.
    boundary : (n,) int array
        Index into ``names``.
    names : tuple of str
        Contact boundaries.
    masters : tuple of str
        For each of ``names`` the boundary of the other body, "" for a rigid obstacle.
    master_node : (m,) int array, optional
        Nodes that contact nodes follow: of the masters, and those of the slaves that carry no contact conditions of
        their pair. For each pair each node once.
    master_force : (m, dim) array, optional
        Contact forces on them, -W' times those on the contact nodes (Cartesian), N (2D: N/m).
    master_boundary : (m,) int array, optional
        Their pair: index into ``names``.
    axisymmetric : bool
        Whether x is the radius, and forces and masses are those of the full circumference (N, m^2).
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
    names: tuple[str, ...] = ("contact",)
    masters: tuple[str, ...] = ()
    master_node: np.ndarray = ABSENT
    master_force: np.ndarray = ABSENT
    master_boundary: np.ndarray = ABSENT
    axisymmetric: bool = False

    def __post_init__(self) -> None:
        if not self.masters:
            object.__setattr__(self, "masters", ("",) * len(self.names))
        if self.master_node is None:
            empty = np.empty(0, dtype=np.int64)
            for name, value in (("master_node", empty), ("master_force", np.empty((0, self.frames.shape[1]))),
                                ("master_boundary", empty)):
                object.__setattr__(self, name, value)

    @property
    def pair(self) -> np.ndarray:
        """Return the name of the contact boundary or pair ("slave on master") of each node (n,), str."""
        return np.array(self.pair_names)[self.boundary]

    @property
    def pair_names(self) -> list[str]:
        """Return for each of ``names`` the contact boundary, or "slave on master"."""
        return [f"{slave} on {master}" if master else slave
                for slave, master in zip(self.names, self.masters, strict=True)]

    def on_slaves(self, mesh: MeshArrays | None) -> np.ndarray:
        """Return which of ``master_node`` (m,) lie on the slave of their pair; without a mesh none."""
        result = np.zeros(len(self.master_node), dtype=bool)
        if mesh is not None:
            for k in np.unique(self.master_boundary):
                mine = self.master_boundary == k
                result[mine] = np.isin(self.master_node[mine], mesh.boundary_nodes(self.names[k]))
        return result

    @property
    def closed(self) -> np.ndarray:
        """Return which nodes (n,) are in contact: not open."""
        return self.state != OPEN

    @property
    def units(self) -> tuple[str, str]:
        """Return the units of forces and of boundary masses: N and m^2, in plane problems N/m and m."""
        plane = self.frames.shape[1] == 2 and not self.axisymmetric
        return ("N/m", "m") if plane else ("N", "m^2")

    def counts(self, own: np.ndarray | None = None) -> dict[str, int]:
        """Return the number of nodes by state, 'open', 'slip' and 'stick'; of all or of those in the mask ``own``."""
        states = np.asarray(self.state if own is None else self.state[own])
        return {name: int((states == code).sum()) for name, code in _STATES.items()}

    def table(self) -> pandas.DataFrame:
        """Return one row a contact node, with units in the heads; in 3D with "slip_1 [m]", "slip_2 [m]", and so on."""
        import pandas

        columns: dict[str, object] = {"node": self.node, "pair": self.pair,
                                      "state": np.array(list(_STATES))[np.asarray(self.state, dtype=int)]}
        columns |= {f"{axis} [m]": values for axis, values in zip("xyz", self.x.T, strict=False)}
        for name, unit in (("gap", "m"), ("u_n", "m"), ("u_t", "m"), ("slip", "m"), ("force_n", self.units[0]),
                           ("force_t", self.units[0]), ("pressure", "Pa"), ("traction", "Pa")):
            parts = np.atleast_2d(getattr(self, name).T)
            columns |= {f"{name}_{k} [{unit}]" if len(parts) > 1 else f"{name} [{unit}]": part
                        for k, part in enumerate(parts, 1)}
        return pandas.DataFrame(columns)

    def __repr__(self) -> str:
        states = ", ".join(f"{count} {state}" for state, count in self.counts().items())
        return shortened(f"ContactResult: {len(self)} nodes of {', '.join(self.pair_names)}: {states}; pressure up to "
                         f"{self.pressure.max(initial=0.0):.3g} Pa; table() lists them")

    def _repr_html_(self) -> str:
        return in_html_lines(repr(self)) + html_table(self.table())

    @property
    def pressure(self) -> np.ndarray:
        """Return the compressive nodal force over lumped boundary mass (n,), Pa; 0 at open nodes."""
        return np.where(self.closed, self.force_n / self.weights, 0.0)

    @property
    def traction(self) -> np.ndarray:
        """Return the tangential nodal force over lumped boundary mass (n, dim - 1), Pa; 0 at open nodes."""
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
