r"""Contact between two surfaces of the mesh: which slave nodes face what, at which gap.

Surfaces are made of facets. Where two curved surfaces fit each other, their facets overlap by up to the heights of
both facets under the arcs, about :math:`\tfrac14 h\,|n_i - n_F|` with the averaged normal :math:`n_i` at a corner of
facet F: negative gaps above minus that are the discretisation, not interference, and are taken as zero.

A slave node of whose part less than a quarter has the master opposite (where the slave hangs over) carries no
multiplier: its dual function would be large, of the order of one over the covered fraction, and with it the entries of
the coupling, which spoils the smoothing. The multipliers beside it take over, so that constant pressures stay exact.
"""

from __future__ import annotations

import numpy as np

from adaptmg.discretisation.facets import area_vectors, named_facets, shape_integrals
from adaptmg.discretisation.mortar.interface import MortarInterface
from adaptmg.discretisation.mortar.mortar_2d import mortar_2d
from adaptmg.discretisation.mortar.mortar_3d import mortar_3d
from adaptmg.discretisation.mortar.node_to_node import node_to_node
from adaptmg.discretisation.mortar.surface_normals import surface_normals
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import checks
from adaptmg.problem.pairs import ContactPair

__all__ = ["pair_interface"]

_ROUNDING = 1e-12  # of the bodies' size
_LEAST_COVERED = 0.25  # of the part of a slave node


def pair_interface(mesh: MeshArrays, pair: ContactPair, *, fixed: np.ndarray, excluded: np.ndarray,
                   axisymmetric: bool) -> MortarInterface:
    """The interface of a pair.

    Parameters
    ----------
    mesh : MeshArrays
    pair : ContactPair
    fixed : (n_nodes, dim) bool array
        Prescribed components.
    excluded : (n,) array of int
        Nodes of the slave surface that belong to another contact boundary.
    axisymmetric : bool

    Returns
    -------
    MortarInterface
        Gaps >= 0 unless the pair allows interference.

    Raises
    ------
    ValueError
        If the surfaces never face each other, overlap without ``allow_interference``, or what the couplings refuse;
        the message names the pair.
    """
    slave, master = named_facets(mesh, pair.slave), named_facets(mesh, pair.master)
    what = f"contact pair {pair.slave!r} on {pair.master!r}"
    try:
        normals = surface_normals(mesh.points, slave, fixed=fixed)
        found = _coupled(mesh, pair, slave, master, normals, excluded, axisymmetric)
        hanging = _hanging_over(mesh, slave, found, axisymmetric)
        if 0 < len(hanging) < len(found) and pair.coupling == "mortar":
            found = _coupled(mesh, pair, slave, master, normals, np.union1d(excluded, hanging), axisymmetric)
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from error
    gaps = found.gaps.copy()
    if pair.gap is not None:
        gaps = checks.field(f"gap of {what}", pair.gap, mesh.points[found.nodes])
    if not pair.allow_interference:
        size = np.linalg.norm(np.ptp(mesh.points[np.union1d(slave, master)], axis=0))
        tolerance = np.full(len(gaps), _ROUNDING * size)
        if pair.gap is None:
            tolerance += _facet_heights(mesh, slave)[found.nodes] + _facet_heights(mesh, master).max()
        deepest = int(np.argmin(gaps + tolerance))
        if gaps[deepest] < -tolerance[deepest]:
            raise ValueError(f"{what}: the bodies overlap by up to {-gaps.min():.6g} m at the start, at "
                             f"{tuple(mesh.points[found.nodes[np.argmin(gaps)]].tolist())}: move one of them apart, or "
                             "say allow_interference=True for an interference fit")
        gaps = np.maximum(gaps, 0.0)
    return MortarInterface(nodes=found.nodes, normals=found.normals, weights=found.weights, gaps=gaps,
                     coupling=found.coupling)


def _coupled(mesh: MeshArrays, pair: ContactPair, slave: np.ndarray, master: np.ndarray, normals: np.ndarray,
             excluded: np.ndarray, axisymmetric: bool) -> MortarInterface:
    """By the coupling that the pair asks for."""
    if pair.coupling == "nodes":
        return node_to_node(mesh.points, slave, master, normals, excluded=excluded, axisymmetric=axisymmetric)
    if mesh.dim == 2:
        return mortar_2d(mesh.points, slave, master, normals, excluded=excluded, axisymmetric=axisymmetric,
                         reach=pair.reach)
    return mortar_3d(mesh.points, slave, master, normals, excluded=excluded, reach=pair.reach)


def _hanging_over(mesh: MeshArrays, slave: np.ndarray, found: MortarInterface, axisymmetric: bool) -> np.ndarray:
    """Slave nodes (n,) of which the master covers too little."""
    measure = np.linalg.norm(area_vectors(mesh.points, slave), axis=1)
    share = measure[:, None] * shape_integrals(mesh.points, slave, axisymmetric)
    whole = np.bincount(slave.ravel(), weights=share.ravel(), minlength=mesh.n_nodes)
    return found.nodes[found.weights < _LEAST_COVERED * whole[found.nodes]]


def _facet_heights(mesh: MeshArrays, facets: np.ndarray) -> np.ndarray:
    """At nodes (n_nodes,) of a surface the largest height of a facet there under the arc, about, m; zero elsewhere."""
    vectors = area_vectors(mesh.points, facets)
    own = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    corners = mesh.points[facets]
    length = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    averaged = surface_normals(mesh.points, facets)
    result = np.zeros(mesh.n_nodes)
    for corner in facets.T:
        turn = np.linalg.norm(averaged[corner] - own, axis=1)
        np.maximum.at(result, corner, 0.25 * length * turn)
    return result
