r"""Ties: boundaries that move together.

A tied slave node follows the combination of master nodes that it faces, in all components: its
relative displacement (:mod:`adaptmg.discrete.coordinates`) is fixed to zero, on every level. It is
contact that sticks and never opens. Where surfaces lie on each other constant stresses pass
exactly, and rigid motions strain nothing; across a gap g a rotation
:math:`\omega` strains by :math:`\omega \times g`. What the slave bears at node j is the force
:math:`\lambda_j = (\hat A w - \hat b)_j` of its relative displacement; the master bears :math:`-W^T \lambda`. Along
what a support holds of a slave node the support takes its part.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import cast

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._text import warn_user
from adaptmg.discrete.coordinates import Coupling, Unknowns
from adaptmg.discrete.mortar import MortarInterface, pair_interface, with_images
from adaptmg.discrete.periodic import partners
from adaptmg.discrete.supports import Boundaries
from adaptmg.mesh.arrays import Surface
from adaptmg.problem.surfaces import ContactPair, Periodic, Tied


@dataclass(frozen=True, eq=False)
class TieForces:
    """Forces that ties exert on both bodies: ``result.ties``.

    Attributes
    ----------
    node : (n,) int array
        Nodes of the mesh; a node of a master stands once for each tie.
    force : (n, dim) array
        N (2D: N/m).
    boundary : (n,) int array
        Index into ``names``.
    names : tuple of str
        The slave and the master of each tie, in turn.

    Examples
    --------
    >>> low = am.Rectangle(width=1, height=1)
    >>> problem = am.ContactProblem(
    ...     domain=am.Assembly(
    ...         parts={"low": low, "top": am.Rectangle(width=1, height=1, origin=(0, 1))}
    ...     ),
    ...     material=am.PlaneStrain(young=1e9, poisson=0.3),
    ...     ties=am.Tied("top.bottom", "low.top"),
    ...     supports=am.Support("low.bottom", x=0.0, y=0.0),
    ...     loads=am.Pressure("top.top", 1e6),
    ... )
    >>> ties = am.solve(am.Hierarchy.uniform(problem, divisions=(2, 4))).ties
    >>> round(float(ties.on("low.top")[1][:, 1].sum()))               # N/m, on the master
    -1000000
    """

    node: np.ndarray
    force: np.ndarray
    boundary: np.ndarray
    names: tuple[str, ...]

    def on(self, boundary: str) -> tuple[np.ndarray, np.ndarray]:
        """Return the nodes and forces on one boundary."""
        on_boundary = np.isin(
            self.boundary, [k for k, name in enumerate(self.names) if name == boundary]
        )
        return self.node[on_boundary], self.force[on_boundary]

    def total(self, n_nodes: int) -> np.ndarray:
        """Return the forces (n_nodes, dim) of all ties."""
        result = np.zeros((n_nodes, self.force.shape[1]))
        np.add.at(result, self.node, self.force)
        return result


def tie_interfaces(boundaries: Boundaries) -> list[MortarInterface]:
    """Return the tied slave nodes of each tie. Nodes on several ties belong to the one named first;
    nodes that supports hold in all directions are not tied."""
    if not boundaries.problem.ties:
        return []
    mesh = boundaries.mesh
    held_spans = boundaries.held_spans(np.arange(mesh.n_nodes))
    not_tied = np.einsum("nii->n", held_spans) > mesh.dim - checks.SIX_DIGITS
    parts: list[MortarInterface] = []
    periodic = np.zeros(mesh.n_nodes, dtype=bool)  # nodes that follow their partners
    for tie in boundaries.problem.ties:
        slave = boundaries.surfaces[tie.slave]
        master = boundaries.surfaces[tie.master]
        if isinstance(tie, Periodic):
            parts.append(_periodic(tie, boundaries, not_tied))
            not_tied[parts[-1].nodes] = True
            periodic[parts[-1].nodes] = True
            continue
        # a tie is coupled as a pair would be
        pair = ContactPair(tie.slave, tie.master, reach=tie.reach, allow_interference=True)
        couple = partial(pair_interface, boundaries, pair, (slave, master))
        try:
            parts.append(_tied(boundaries, slave.nodes, couple, not_tied, periodic))
        except ValueError as error:
            raise ValueError(str(error).replace("contact pair", "tie", 1)) from error
        if tie.reach is None:  # a reach says how far apart the surfaces may be
            _warn_of_gaps(tie, slave, np.abs(parts[-1].gaps).max(initial=0.0))
        not_tied[parts[-1].nodes] = True
    return parts


def _tied(
    boundaries: Boundaries,
    nodes: np.ndarray,
    couple: Callable[[np.ndarray], MortarInterface],
    not_tied: np.ndarray,
    periodic: np.ndarray,
) -> MortarInterface:
    """Return the interface that ``couple`` makes of the slave ``nodes`` (n,) of a tie without excluded ones:
    without those of the mask ``not_tied`` (n_nodes,), but of the mask ``periodic`` those that are images of
    a tied node, which takes them over."""
    originals = boundaries.originals
    if originals is None:
        return couple(nodes[not_tied[nodes]])
    images = boundaries.images(nodes[periodic[nodes]], nodes, ~not_tied)
    while True:  # with fewer images each time
        interface = couple(np.setdiff1d(nodes[not_tied[nodes]], images))
        carries = np.isin(originals[images], interface.nodes)
        if carries.all():
            return with_images(interface, images, originals)
        images = images[carries]


def _warn_of_gaps(tie: Tied, slave: Surface, apart: float) -> None:
    """Warn of surfaces that are farther apart than an element, as where a body is misplaced."""
    if apart > np.ptp(slave.points[slave.facets], axis=1).max():
        warn_user(
            f"tie {tie.slave!r} on {tie.master!r}: the surfaces are up to {apart:.3g} m apart, more than an "
            "element, and rotations strain the bodies by that distance. Check their positions (m), or give "
            "reach= where it is meant"
        )


def _periodic(tie: Periodic, boundaries: Boundaries, not_tied: np.ndarray) -> MortarInterface:
    """Return the nodes of the slave side of a cell, each with its partner on the master side, without
    those of the mask ``not_tied`` (n_nodes,)."""
    mesh = boundaries.mesh
    points = mesh.points
    slave, partner = partners(tie, mesh, boundaries.surfaces)
    held = boundaries.held_spans(slave)
    # what supports hold of a node without holding it of its partner
    held_alone = np.abs(held - held @ boundaries.held_spans(partner)).max(axis=(1, 2))
    if held_alone.max() > checks.SIX_DIGITS:
        i = int(np.argmax(held_alone))
        raise ValueError(
            f"a support holds node {slave[i]} {tuple(points[slave[i]].tolist())} of periodic side "
            f"{tie.slave!r}, and not its partner, which would move apart from it: hold the partner at "
            f"{tuple(points[partner[i]].tolist())}, which this node follows"
        )
    free = ~not_tied[slave]
    slave = slave[free]
    partner = partner[free]
    rows = sparse.csr_array(
        (np.ones(len(slave)), partner, np.arange(len(slave) + 1)), shape=(len(slave), len(points))
    )
    # normals, weights and gaps are those of contact, which a tie does not have
    return MortarInterface(
        nodes=slave,
        normals=np.zeros((len(slave), mesh.dim)),
        weights=np.ones(len(slave)),
        gaps=np.zeros(len(slave)),
        coupling=rows,
    )


def tie_forces(problem: Unknowns, residual: np.ndarray) -> TieForces | None:
    """Return the forces of the ties of a problem with the residual A w - b (n_dofs,), N; None
    without ties."""
    if not problem.ties:
        return None
    nodal = residual.reshape(-1, problem.dim)
    nodes = []
    forces = []
    boundary = []
    names = []
    for slave, master, tied, slave_nodes in problem.ties:
        spans = problem.held_spans(tied)
        # lambda on the slave, without what supports hold of it, and -W' lambda on the master
        slave_forces = nodal[tied] - np.einsum("nij,nj->ni", spans, nodal[tied])
        # W: the nodes that tied nodes face, with their weights
        rows = sparse.csr_array(cast("Coupling", problem.coupling).weights[tied])
        facing_nodes = np.unique(rows.indices)
        nodes += [tied, facing_nodes]
        forces += [slave_forces, -(rows.T @ slave_forces)[facing_nodes]]
        # a held slave node is not tied, but its neighbours, which take over its part, act on it
        on_slave = np.isin(facing_nodes, slave_nodes)
        boundary += [np.full(len(tied), len(names)), np.where(on_slave, len(names), len(names) + 1)]
        names += [slave, master]
    return TieForces(*map(np.concatenate, (nodes, forces, boundary)), names=tuple(names))
