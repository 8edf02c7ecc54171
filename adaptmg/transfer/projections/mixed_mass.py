r"""MixedMass: integrals of products of the shape functions of two non-nested meshes.

.. math:: B^e_{ij} = \int_e \varphi^f_i\, \varphi^c_j

over every fine element e. Elements that the coarse mesh covers are integrated exactly, by clipping against the coarse
elements (:mod:`adaptmg.geometry.simplex_clipping`). Elements that stick out of the coarse mesh (curved boundaries) are
integrated by a positive quadrature rule, exact for degree 6, whose points outside take the coarse value at the
closest point: no part of the fine mesh is lost, and :math:`\sum_j B^e_{ij} = \int_e \varphi^f_i` on every element.

The transfers are sums of these integrals with coefficients of their own over the elements e around a fine node i:

.. math:: (T u)_i = \sum_{e \ni i} \sum_k a_{iek} \sum_j B^e_{kj} u_j .
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from adaptmg.geometry.box_tree import padded
from adaptmg.geometry.location_kernels import affine_maps
from adaptmg.geometry.quadrature import simplex_rule
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.transfer.location import PointLocator, body_locators, locate_nodes, nodes_of_bodies
from adaptmg.transfer.projections.mixed_mass_kernels import clip_elements, count_rows, fill_rows

__all__ = ["MixedMass", "Patches", "mixed_mass"]

COVERED = 1e-11
"""An element of which more than this share lies outside the coarse mesh is integrated by quadrature."""


@dataclass(frozen=True, eq=False)
class Patches:
    """The elements around every node.

    Attributes
    ----------
    indptr : (n_nodes + 1,) array
    elements, corners : (n_elements * (dim + 1),) arrays
        Element and the node's number in it, node by node.
    """

    indptr: np.ndarray
    elements: np.ndarray
    corners: np.ndarray

    @classmethod
    def of(cls, mesh: MeshArrays) -> Patches:
        """Patches of all nodes."""
        k = mesh.elements.shape[1]
        order = np.argsort(mesh.elements.ravel(), kind="stable")
        indptr = np.concatenate([[0], np.cumsum(np.bincount(mesh.elements.ravel(), minlength=mesh.n_nodes))])
        return cls(indptr=indptr, elements=order // k, corners=order % k)

    @cached_property
    def nodes(self) -> np.ndarray:
        """The node of each entry."""
        return np.repeat(np.arange(len(self.indptr) - 1), np.diff(self.indptr))


@dataclass(frozen=True, eq=False)
class MixedMass:
    """The integrals B^e, element by element.

    Attributes
    ----------
    coarse, fine : MeshArrays
    indptr : (n_fine_elements + 1,) array
    columns : (n_entries,) array
        Coarse nodes; one may occur more than once in an element.
    values : (n_entries, dim + 1) array
        Integrals with the shape functions of the corners, m^2 or m^3.
    patches : Patches
        Of the fine mesh.
    """

    coarse: MeshArrays
    fine: MeshArrays
    indptr: np.ndarray
    columns: np.ndarray
    values: np.ndarray
    patches: Patches

    def assemble(self, coefficients: np.ndarray) -> sparse.csr_array:
        """Sum over patches.

        Parameters
        ----------
        coefficients : (n_incidences, dim + 1) array
            a_iek at the entries of ``patches``.

        Returns
        -------
        (n_fine, n_coarse) csr_array
            Sorted.
        """
        patches, shape = self.patches, (self.fine.n_nodes, self.coarse.n_nodes)
        indptr = np.zeros(shape[0] + 1, dtype=np.int64)
        marker = np.full(shape[1], -1, dtype=np.int64)
        count_rows(patches.indptr, patches.elements, self.indptr, self.columns, marker, indptr)
        np.cumsum(indptr, out=indptr)
        indices, data = np.empty(indptr[-1], dtype=np.int32), np.zeros(indptr[-1])
        marker[:] = -1
        fill_rows(patches.indptr, patches.elements, coefficients, self.indptr, self.columns, self.values, marker,
                  indptr, indices, data)
        result = sparse.csr_array((data, indices, indptr.astype(np.int32)), shape=shape)
        result.sort_indices()
        return result

    def shape_coefficients(self) -> np.ndarray:
        """Coefficients that test with the shape function of the node: a_iek = 1 at the corner i of e, else 0."""
        coefficients = np.zeros((len(self.patches.corners), self.fine.dim + 1))
        coefficients[np.arange(len(coefficients)), self.patches.corners] = 1.0
        return coefficients

    @cached_property
    def lumped_mass(self) -> np.ndarray:
        """Integrals of the fine shape functions (n_fine,), m^2 or m^3."""
        share = np.repeat(self.fine.volumes / (self.fine.dim + 1), self.fine.dim + 1)
        return np.bincount(self.fine.elements.ravel(), weights=share, minlength=self.fine.n_nodes)


def mixed_mass(coarse: MeshArrays, fine: MeshArrays, outside_tolerance: float) -> MixedMass:
    """Compute the integrals, body by body.

    Raises
    ------
    TypeError, ValueError
        As :func:`adaptmg.transfer.location.locate_nodes`; a fine node without an element.
    """
    locate_nodes(coarse, fine, outside_tolerance)
    nodes_of_bodies(fine)
    parts = []
    for body, locator in body_locators(coarse, fine):
        elements = np.arange(len(fine.elements)) if body is None else np.flatnonzero(fine.element_body == body)
        parts += _body_entries(locator, fine, elements)
    element, columns, values = (np.concatenate(arrays) for arrays in zip(*parts, strict=True))
    order = np.argsort(element, kind="stable")
    indptr = np.concatenate([[0], np.cumsum(np.bincount(element, minlength=len(fine.elements)))])
    return MixedMass(coarse=coarse, fine=fine, indptr=indptr, columns=columns[order], values=values[order],
                    patches=Patches.of(fine))


def _body_entries(locator: PointLocator, fine: MeshArrays, elements: np.ndarray) -> list[tuple[np.ndarray, ...]]:
    """Entries (element, coarse node, values) of clipped elements, then of those that need quadrature."""
    k = fine.dim + 1
    covered, fine_maps = np.empty(len(elements)), np.empty((len(fine.elements), fine.dim * k))
    fine_points, tree = padded(fine.points), locator.tree
    affine_maps(fine_points, fine.elements, fine_maps)
    marker = np.full(locator.mesh.n_nodes, -1, dtype=np.int64)
    capacity = 8 * k * len(elements) + 64
    element, columns, values = np.empty(capacity, np.int64), np.empty(capacity, np.int32), np.empty((capacity, k))
    done = count = 0
    while True:
        done, count = clip_elements(fine_points, fine.elements, fine_maps, elements, done, count, tree.points,
                                    tree.simplices, locator.maps, tree.boxes, marker, covered, element, columns, values)
        if done == len(elements):
            break
        element, columns, values = (np.concatenate([a, np.empty_like(a)]) for a in (element, columns, values))
    whole = np.zeros(len(fine.elements), dtype=bool)
    whole[elements] = np.abs(covered - 1.0) <= COVERED
    kept = np.flatnonzero(whole[element[:count]])
    volumes = fine.volumes[element[kept]]
    clipped = element[kept], columns[kept], values[kept] * volumes[:, None]
    return [clipped, _quadrature(locator, fine, elements[~whole[elements]])]


def _quadrature(locator: PointLocator, fine: MeshArrays, elements: np.ndarray) -> tuple[np.ndarray, ...]:
    """Entries of elements that stick out of the coarse mesh, by quadrature."""
    shape, weights = simplex_rule(fine.dim, 4)
    points = np.einsum("qv,evc->eqc", shape, fine.points[fine.elements[elements]])
    found = locator.locate(points.reshape(-1, fine.dim))
    columns = locator.mesh.elements[found.element]
    scaled = found.weights.reshape(len(elements), len(weights), fine.dim + 1) * fine.volumes[elements][:, None, None]
    values = np.einsum("eqj,q,qv->eqjv", scaled, weights, shape)
    return (np.repeat(elements, len(weights) * columns.shape[1]), columns.ravel(),
            values.reshape(-1, columns.shape[1]))
