r"""Recovery: an estimate of the energy error by a smoother stress (Zienkiewicz and Zhu).

.. math:: \eta_E^2 = \int_E (\sigma^* - \sigma_h) : C^{-1} (\sigma^* - \sigma_h)

with a continuous, piecewise linear stress :math:`\sigma^*` fitted to that of the elements around each node, body by
body: it may jump where materials meet and between bodies in contact. Where the solution is smooth the estimate tends to
the error itself; it knows nothing of loads and contact conditions.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.fields.element_stress import ElementStress
from adaptmg.estimate.fields.posed import posed
from adaptmg.estimate.recovery_kernels import difference_energy, elements_of_nodes, mark_boundary, recover
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_points, quadrature_rule
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.solver.result import Result

__all__ = ["RecoveredStress", "Recovery", "recovered_stress"]


@dataclass(frozen=True, eq=False)
class RecoveredStress:
    """A stress that is continuous in each body.

    Attributes
    ----------
    cells : (n_elements, dim + 1) int32 array
        Rows of ``nodal`` at the corners: the nodes, and more where bodies share some.
    nodal : (n, n_values) array
        Normal stresses, then shear stresses as of :class:`~adaptmg.estimate.fields.element_stress.ElementStress`;
        axisymmetric: rr, zz, hoop, rz. Pa.
    sampled : (n_elements, n_values) array
        What it was made from: the stress at the centroids, Pa.
    """

    cells: np.ndarray
    nodal: np.ndarray
    sampled: np.ndarray


@dataclass(frozen=True)
class Recovery:
    """The recovery indicator; it has no parameters."""

    def indicate(self, hierarchy: Hierarchy, result: Result) -> Estimate:
        """Estimate the error on the finest mesh.

        Parameters
        ----------
        hierarchy : Hierarchy
            Of a ContactProblem, whose loads are those of the result.
        result : Result
            Of :func:`adaptmg.solve` on it.

        Returns
        -------
        Estimate
            Terms: the bodies by name.

        Raises
        ------
        TypeError, ValueError
            As of :meth:`adaptmg.Residual.indicate`.
        """
        this = posed(hierarchy, result)
        found = recovered_stress(this.stress, this.neighbours.across)
        squares = (_axisymmetric_energy if this.stress.axisymmetric else _energy)(this.stress, found)
        by_body = np.bincount(this.mesh.element_body, weights=squares, minlength=len(this.mesh.bodies))
        return Estimate(squares=squares, norm=this.norm, indicator="recovered stress",
                        terms=dict(zip(this.mesh.bodies, by_body, strict=True)))


def recovered_stress(stress: ElementStress, across: np.ndarray) -> RecoveredStress:
    """Fit a stress that is continuous in each body.

    Parameters
    ----------
    stress : ElementStress
    across : (n_elements, dim + 1) int32 array
        See :class:`~adaptmg.estimate.fields.neighbours.Neighbours`.
    """
    mesh = stress.mesh
    cells, points = _apart(mesh)
    centroids = mesh.points[mesh.elements].mean(axis=1)
    sampled = np.ascontiguousarray(_sampled(stress))
    start, listed = np.zeros(len(points) + 1, dtype=np.int64), np.empty(cells.size, dtype=np.int32)
    elements_of_nodes(cells, start, listed)
    boundary = np.zeros(len(points), dtype=bool)
    mark_boundary(cells, across, mesh.element_body, boundary)
    nodal = np.zeros((len(points), sampled.shape[1]))
    marker, patch = np.full(len(cells), -1, dtype=np.int64), np.empty(len(cells), dtype=np.int64)
    recover(points, centroids, cells, start, listed, boundary, sampled, marker, patch, nodal)
    return RecoveredStress(cells, nodal, sampled)


def _apart(mesh: MeshArrays) -> tuple[np.ndarray, np.ndarray]:
    """Elements and points, a point for each body that uses a node."""
    if len(mesh.bodies) == 1:
        return mesh.elements, mesh.points
    taken, cells, origin = np.zeros(mesh.n_nodes, dtype=bool), mesh.elements.copy(), [np.arange(mesh.n_nodes)]
    n = mesh.n_nodes
    for k in range(len(mesh.bodies)):
        here = mesh.element_body == k
        used = np.zeros(mesh.n_nodes, dtype=bool)
        used[mesh.elements[here]] = True
        again = np.flatnonzero(used & taken)
        if len(again):
            number = np.arange(mesh.n_nodes, dtype=np.int32)
            number[again] = n + np.arange(len(again))
            cells[here] = number[mesh.elements[here]]
            origin.append(again)
            n += len(again)
        taken |= used
    return cells, mesh.points[np.concatenate(origin)]


def _sampled(stress: ElementStress) -> np.ndarray:
    """Stress at the centroids, normal components first."""
    values = stress.values
    if not stress.axisymmetric:
        return values
    centre = np.full((1, 3), 1 / 3)
    return _at_points(stress, centre)[:, 0]


def _at_points(stress: ElementStress, rule: np.ndarray) -> np.ndarray:
    """Stress rr, zz, hoop, rz (n_elements, n_points, 4) of axisymmetric bodies at barycentric points."""
    mesh, data, values = stress.mesh, stress.data, stress.values
    lame, shear = data.lame[mesh.element_body], data.shear[mesh.element_body]
    initial = data.initial_strain[:, 2] if len(data.initial_strain) else np.zeros(len(values))
    in_plane = (values[:, 0] + values[:, 1] + 2 * lame * initial) / (2 * lame + 2 * shear)
    hoop = stress.hoop(mesh.elements, rule)
    added = lame[:, None] * hoop
    around = (lame * (in_plane - initial) - 2 * shear * initial)[:, None] + (lame + 2 * shear)[:, None] * hoop
    return np.stack([values[:, 0][:, None] + added, values[:, 1][:, None] + added, around,
                     np.repeat(values[:, 2][:, None], len(rule), axis=1)], axis=-1)


def _energy(stress: ElementStress, found: RecoveredStress) -> np.ndarray:
    """Squares (n_elements,), N m."""
    squares, data, mesh = np.empty(len(found.cells)), stress.data, stress.mesh
    difference_energy(found.cells, mesh.volumes, mesh.element_body, data.lame, data.shear, found.sampled, found.nodal,
                      squares)
    return squares


def _axisymmetric_energy(stress: ElementStress, found: RecoveredStress) -> np.ndarray:
    """Squares (n_elements,), N m, of the full circumference."""
    mesh, data = stress.mesh, stress.data
    rule, weights = quadrature_rule(3, AXISYMMETRIC_DEGREE)
    difference = np.einsum("qk,ekc->eqc", rule, found.nodal[found.cells]) - _at_points(stress, rule)
    lame, shear = (part[mesh.element_body][:, None] for part in (data.lame, data.shear))
    trace = difference[:, :, :3].sum(axis=2)
    squared = difference**2 @ np.array([1.0, 1.0, 1.0, 2.0])
    density = (squared - lame / (3 * lame + 2 * shear) * trace**2) / (2 * shear)
    radius = quadrature_points(mesh.points, mesh.elements, rule)[:, :, 0]
    return mesh.volumes * ((2 * np.pi * radius * density) @ weights)
