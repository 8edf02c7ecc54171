"""A mesh into the tables of a bisection, and out of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.mesh.arrays import MeshArrays, element_facets, sound_by_construction
from adaptmg.mesh.bisection.children import (
    CODES,
    EVEN,
    FOREBEAR,
    HEAD,
    NODE_COLUMNS,
    Refinement,
    columns_of_cells,
    columns_of_tree,
    facets_into_cells,
    facets_of_cells,
    first_labels,
    with_refinement,
)

__all__ = ["Refined", "cells_of", "mesh_of", "nodes_of", "parents_of", "tree_of"]


@dataclass(frozen=True, kw_only=True, eq=False)
class Refined:
    """A mesh made from another one by bisection or its taking back."""

    mesh: MeshArrays  # trusted, with its history and a source on demand
    origin: np.ndarray  # (n_elements,) int: of a refined mesh: the element of the mesh before that holds each element
    nodes: np.ndarray  # (n_nodes_before,) int: number of each node of the mesh before; -1 where it is gone


def parents_of(mesh: MeshArrays) -> np.ndarray:
    """Parents (n_nodes, 2) of each node since the initial mesh."""
    refinement = mesh.refinement
    if refinement is not None:
        return refinement.parents
    return np.repeat(np.arange(mesh.n_nodes, dtype=np.int32), 2).reshape(-1, 2)


def cells_of(mesh: MeshArrays, room: float = 0.0) -> np.ndarray:
    """The elements as a table, labelled if the mesh was never bisected, with so many times the rows as room."""
    n, corners = mesh.elements.shape
    cells = np.empty((n + int(room * n), columns_of_cells(mesh.dim)), dtype=np.int32)
    cells[:n, :corners] = mesh.elements
    facets_into_cells(mesh.facets, cells, n, corners, mesh.n_nodes)
    marks, refinement = 2 * corners, mesh.refinement
    if refinement is None:
        first_labels(mesh.points, cells, n, corners, EVEN, CODES)
        cells[:n, marks + 1] = -1
        cells[:n, marks + 2] = 0
    else:
        cells[:n, marks] = refinement.marks
        cells[:n, marks + 1] = refinement.forebear
        cells[:n, marks + 2] = refinement.generation
    cells[:n, marks + 3] = np.arange(n)
    return cells


def tree_of(mesh: MeshArrays) -> np.ndarray:
    """The elements that were bisected."""
    refinement = mesh.refinement
    return np.empty((0, columns_of_tree(mesh.dim)), dtype=np.int32) if refinement is None else refinement.tree


def nodes_of(mesh: MeshArrays, room: float) -> np.ndarray:
    """The nodes as a table in which no edge is cut, with so many times the rows as room."""
    n = mesh.n_nodes
    nodes = np.empty((n + int(room * n), NODE_COLUMNS), dtype=np.int32)
    nodes[:n, HEAD] = -1
    return nodes


def mesh_of(before: MeshArrays, points: np.ndarray, parents: np.ndarray, cells: np.ndarray, tree: np.ndarray
            ) -> MeshArrays:
    """The mesh that tables hold, with the boundaries and bodies of the mesh they come from."""
    corners = before.dim + 1
    marks = 2 * corners
    opposite = element_facets(np.arange(corners)[None])[0]
    facets, origin = facets_of_cells(cells, len(cells), corners, len(before.facets), opposite)
    mesh = MeshArrays(points, cells[:, :corners], facets, before.facet_labels[origin], before.boundaries,
                      before.element_body[cells[:, marks + 3]], before.bodies)
    history = Refinement(parents, cells[:, marks].astype(np.int8), cells[:, marks + 2].astype(np.int16),
                         cells[:, marks + FOREBEAR].copy(), tree)
    return with_refinement(sound_by_construction(mesh), history)
