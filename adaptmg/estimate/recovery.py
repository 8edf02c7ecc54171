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
from adaptmg.estimate.recovery_kernels import (
    axisymmetric_energy,
    axisymmetric_stresses,
    difference_energy,
    elements_of_nodes,
    mark_boundary,
    recover,
)
from adaptmg.geometry.quadrature import AXISYMMETRIC_DEGREE, quadrature_rule
from adaptmg.hierarchy import Hierarchy
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.runtime.compiled import read_only
from adaptmg.solver.result import Result

__all__ = ["RecoveredStress", "Recovery", "recovered_energy", "recovered_stress"]


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
        squares = recovered_energy(this.stress, found)
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
    sampled = _sampled(stress)
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
    return read_only(cells), read_only(mesh.points[np.concatenate(origin)])


def _sampled(stress: ElementStress) -> np.ndarray:
    """Stress at the centroids, normal components first."""
    mesh, data, values = stress.mesh, stress.data, stress.values
    if not stress.axisymmetric:
        return values
    sampled = np.empty((len(values), 4))
    axisymmetric_stresses(mesh.points, mesh.elements, stress.displacement, mesh.element_body, data.lame, data.shear,
                          data.initial_strain, values, sampled)
    return sampled


def recovered_energy(stress: ElementStress, found: RecoveredStress) -> np.ndarray:
    """Energies (n_elements,) of the recovered stress minus that of the elements, N m."""
    mesh, data, squares = stress.mesh, stress.data, np.empty(len(found.cells))
    if stress.axisymmetric:
        rule, weights = quadrature_rule(3, AXISYMMETRIC_DEGREE)
        axisymmetric_energy(mesh.points, mesh.elements, found.cells, stress.displacement, mesh.volumes,
                            mesh.element_body, data.lame, data.shear, data.initial_strain, stress.values, found.nodal,
                            rule, weights, squares)
    else:
        difference_energy(found.cells, mesh.volumes, mesh.element_body, data.lame, data.shear, found.sampled,
                          found.nodal, squares)
    return squares
