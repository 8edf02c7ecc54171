"""MeshArrays: a simplicial mesh as frozen arrays, the form in which every other layer sees a mesh."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from adaptmg.runtime.on_demand import made_on_demand

__all__ = ["MeshArrays", "longest_edges", "trusted"]


# of these, masks and floats that are whole numbers are taken too: np.zeros(n) or x > 0 is what one writes
_LABELS = ("facet_labels", "element_body")


def _frozen(name: str, array: np.ndarray, dtype: type) -> np.ndarray:
    """A read-only copy; node numbers are not rounded from floats, nor wrapped from more than 32 bits."""
    if (type(array) is np.ndarray and array.dtype == dtype and array.base is None and array.flags.c_contiguous
            and not array.flags.writeable):
        return array
    given = np.asarray(array)
    whole = name in _LABELS and (given.dtype.kind == "b" or (given.dtype.kind == "f" and (given == given // 1).all()))
    if given.dtype.kind not in ("iuf" if dtype is np.float64 else "iu") and given.size and not whole:
        what = "real numbers" if dtype is np.float64 else "integers"
        raise TypeError(f"{name} must be an array of {what}, got an array of {given.dtype}")
    if dtype is np.int32 and given.size and not (given.min() >= -2**31 and given.max() < 2**31):
        raise ValueError(f"{name} must be below 2**31, got {given.min()} to {given.max()}")
    result = np.array(given, dtype=dtype, order="C")
    result.flags.writeable = False
    return result


@dataclass(frozen=True, eq=False)
class MeshArrays:
    """A mesh of triangles or tetrahedra with named boundaries.

    Parameters
    ----------
    points : (n_nodes, dim) array
        m.
    elements : (n_elements, dim + 1) array
        Node numbers, positively oriented.
    facets : (n_facets, dim) array
        Boundary edges (triangles in 3D), oriented so that the normal points out of the body: in 2D the outward
        normal of the edge (a, b) is its direction turned by -90 degrees; in 3D of (a, b, c) it is (b - a) x (c - a).
    facet_labels : (n_facets,) array
        Index into ``boundaries``.
    boundaries : tuple of str
        Distinct boundary names.
    element_body : (n_elements,) array, optional
        Index into ``bodies``; all zero by default.
    bodies : tuple of str
        Names of the bodies.
    source : ngsolve.Mesh, optional
        A straight ngsolve.Mesh of these arrays, with the same node and element numbers, for work in
        NGSolve. Meshes made by adaptmg build it when it is first read. Neither saved nor pickled:
        :func:`adaptmg.mesh.build.with_source` makes one anew. Copies share it.

    Attributes
    ----------
    sound : bool
        Whether :func:`adaptmg.mesh.check_mesh` has passed this mesh, or it is so by construction: the arrays are
        frozen, so that it need not be checked again.
    refinement : Refinement or None
        Of a bisected mesh its history, see :class:`adaptmg.mesh.bisection.refinement.Refinement`: further bisection
        goes on from it, coarsening takes it back. Pickled, but not saved in a result; a mesh made by
        ``dataclasses.replace`` has none, and is an initial mesh.
    """

    points: np.ndarray
    elements: np.ndarray
    facets: np.ndarray
    facet_labels: np.ndarray
    boundaries: tuple[str, ...]
    element_body: np.ndarray | None = None
    bodies: tuple[str, ...] = ("body",)
    source: Any = field(default=None, repr=False)
    sound: bool = field(default=False, init=False, repr=False)
    refinement: Any = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        for name, dtype in (("points", np.float64), ("elements", np.int32), ("facets", np.int32),
                            ("facet_labels", np.int32)):
            object.__setattr__(self, name, _frozen(name, getattr(self, name), dtype))
        body = np.zeros(len(self.elements), dtype=np.int32) if self.element_body is None else self.element_body
        object.__setattr__(self, "element_body", _frozen("element_body", body, np.int32))
        object.__setattr__(self, "boundaries", tuple(self.boundaries))
        object.__setattr__(self, "bodies", tuple(self.bodies))

    def __reduce__(self) -> tuple[Any, ...]:
        # by way of __init__, so that the arrays are frozen again; a worker need not load NGSolve to hand a mesh back
        return type(self), (self.points, self.elements, self.facets, self.facet_labels, self.boundaries,
                            self.element_body, self.bodies), {"sound": self.sound, "refinement": self.refinement}

    def __copy__(self) -> MeshArrays:
        # what is frozen needs no second copy, and a source that nobody has asked for yet is built once
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> MeshArrays:
        return self

    @property
    def dim(self) -> int:
        """Space dimension, 2 or 3."""
        return self.points.shape[1]

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.points)

    def boundary_facets(self, boundary: str) -> np.ndarray:
        """Facets (n, dim) of a named boundary; ValueError if there is no such boundary."""
        if boundary not in self.boundaries:
            raise ValueError(f"boundary {boundary!r} does not exist; the boundaries are {', '.join(self.boundaries)}")
        return self.facets[self.facet_labels == self.boundaries.index(boundary)]

    def boundary_nodes(self, boundary: str) -> np.ndarray:
        """Sorted node numbers of a named boundary."""
        return np.unique(self.boundary_facets(boundary))

    @cached_property
    def element_sizes(self) -> np.ndarray:
        """Longest edge of each element (n_elements,), m."""
        return longest_edges(self.points[self.elements])

    @cached_property
    def volumes(self) -> np.ndarray:
        """Signed area (m^2) or volume (m^3) of each element (n_elements,); positive in a valid mesh."""
        corners = self.points[self.elements]
        edges = corners[:, 1:] - corners[:, :1]
        return np.linalg.det(edges) / (2 if self.dim == 2 else 6)


def longest_edges(corners: np.ndarray) -> np.ndarray:
    """Longest edge (n,) of each of some simplices, given by their corners (n, dim + 1, dim)."""
    k = corners.shape[1]
    return np.max([np.linalg.norm(corners[:, i] - corners[:, j], axis=1) for i in range(k) for j in range(i)], axis=0)


def trusted(mesh: MeshArrays, source: Any, sound: bool = True) -> MeshArrays:
    """The same arrays, not copied, as a mesh that is known to be sound, with another source."""
    result = object.__new__(MeshArrays)
    result.__dict__.update(mesh.__dict__)
    result.__dict__.update(source=source, sound=sound)
    return result


MeshArrays.source = made_on_demand("source", "A straight ngsolve.Mesh of these arrays, or None.")
