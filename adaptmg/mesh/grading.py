r"""graded and sized: independent Netgen meshes that are finer where contact is expected, or where a size field says.

The size field of :func:`graded`, for a bulk size H, a contact ratio q and a grading g, is

.. math:: h(x) = \min\bigl(H,\; H/q + g \,\mathrm{dist}(x, \text{contact boundaries})\bigr).

Netgen loses its way where sizes differ by more than about 16 in a coarse mesh (it fails, or takes minutes): sizes up
to that ratio are asked from Netgen, and the rest is bisected on top, element by element, until no element and no
boundary facet is larger than sqrt(2) times the field, by the edge of the equilateral one of the same volume. Meshes of
different sizes are not nested.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.bisected import bisect
from adaptmg.mesh.generate import SizeField, expected_nodes, guessed_nodes, netgen_mesh, refuse_too_many
from adaptmg.mesh.geometry import distance_to_boundaries, require_simple
from adaptmg.mesh.topology import facet_keys, facet_table
from adaptmg.problem import checks
from adaptmg.problem.domains import Box, Polygon, Rectangle

__all__ = ["graded", "sized"]

_NETGEN_RATIO = 16.0
# an element is bisected when its size is this many times the field: halving then leaves it no smaller than 1 / sqrt(2)
_TOO_LARGE = math.sqrt(2)
# sizes down to 1e-9 of the domain; far below, neighbouring nodes would round to the same point
_MAX_BISECTIONS = 30


def graded(domain: Rectangle | Polygon | Box, size: float, contact_boundaries: str | Sequence[str] = (),
           contact_ratio: float = 1.0, grading: float = 0.3, *, rounds: int = 1) -> MeshArrays:
    """Mesh a domain, finer near some boundaries.

    Parameters
    ----------
    domain : Rectangle, Polygon or Box
        What to mesh.
    size : float
        Edge length far from contact, m.
    contact_boundaries : str or sequence of str
        Where the edges have the length ``size / contact_ratio``.
    contact_ratio : float
        >= 1. A few hundred are fine in 2D; in 3D the number of nodes grows with its square.
    grading : float
        Growth of the edge length per distance from contact, above 0 and at most 1.
    rounds : int
        How often Netgen meshes again by the size field (only for ratios above 1).

    Returns
    -------
    MeshArrays
        With its source; the same arrays for the same arguments.

    Raises
    ------
    TypeError, ValueError
        On an unknown domain or boundary, sizes <= 0, a ratio < 1, a polygon that crosses itself, sizes that ask for
        more than 5 million nodes (3D: 2 million), or where Netgen fails.
    """
    _check_domain(domain)
    size = checks.positive("size", size)
    names = (contact_boundaries,) if isinstance(contact_boundaries, str) else tuple(contact_boundaries)
    for name in names:
        if name not in domain.boundaries:
            raise ValueError(f"contact_boundaries: boundary {name!r} does not exist; "
                             f"the boundaries are {', '.join(dict.fromkeys(domain.boundaries))}")
    ratio = checks.number("contact_ratio", contact_ratio)
    if not ratio >= 1:
        raise ValueError(f"contact_ratio must be >= 1 (contact is never coarser than the bulk), got {contact_ratio!r}")
    if ratio > 1 and not names:
        raise ValueError(f"contact_ratio is {contact_ratio!r}, but contact_boundaries is empty")
    grading = _grading(grading)
    rounds = checks.integer("rounds", rounds, 0)
    if ratio == 1:
        return netgen_mesh(domain, lambda x: np.full(len(x), size), size, {}, grading, 0)

    def field(contact_size: float) -> SizeField:
        return lambda x: np.minimum(size, contact_size + grading * distance_to_boundaries(domain, names, x))

    # the ratio asked from Netgen is the wanted one over a power of two: what bisection then makes up exactly
    steps = max(0, math.ceil(math.log2(ratio / _NETGEN_RATIO)))
    near = size / ratio
    start = near * 2**steps
    # before Netgen works for minutes on a mesh that bisection would then find too large
    refuse_too_many(guessed_nodes(domain, size, dict.fromkeys(names, near), grading), domain)
    mesh = netgen_mesh(domain, field(start), size, dict.fromkeys(names, start), grading, rounds)
    return _bisected_to(mesh, field(near), domain)


def sized(domain: Rectangle | Polygon | Box, size_function: float | Callable[[np.ndarray], np.ndarray],
          max_size: float, rounds: int = 2, *, grading: float = 0.3) -> MeshArrays:
    """Mesh a domain by a size field.

    Parameters
    ----------
    domain : Rectangle, Polygon or Box
        What to mesh.
    size_function : callable or float
        Points (n, dim) in m -> wanted edge length (n,) in m. It is read at centroids of elements: a dip much narrower
        than the elements around it can be missed.
    max_size : float
        No edge is to be longer, m.
    rounds : int
        How often Netgen meshes again with the sizes at the centroids of the mesh before, >= 1; two bring it near
        the field. Where it is still too coarse, elements are bisected.
    grading : float
        Growth of the edge length per distance that Netgen allows, above 0 and at most 1.

    Returns
    -------
    MeshArrays
        With its source; the same arrays for the same arguments.

    Raises
    ------
    TypeError, ValueError
        On an unknown domain, sizes <= 0 or not finite, sizes that ask for more than 5 million nodes (3D: 2
        million), or where Netgen fails.
    """
    _check_domain(domain)
    max_size = checks.positive("max_size", max_size)
    rounds = checks.integer("rounds", rounds, 1)
    grading = _grading(grading)

    def wanted(x: np.ndarray) -> np.ndarray:
        result = checks.field("size_function", size_function, x)
        if not (result > 0).all():
            i = int(np.argmin(result))
            raise ValueError(f"size_function must be > 0, got {result[i]} at {tuple(float(c) for c in x[i])}")
        return np.minimum(result, max_size)

    # Netgen alone sees a field that is cut off at the ratio it can take
    def limited(x: np.ndarray) -> np.ndarray:
        return np.maximum(wanted(x), max_size / _NETGEN_RATIO)

    mesh = netgen_mesh(domain, limited, max_size, {}, grading, rounds)
    return _bisected_to(mesh, wanted, domain)


def _bisected_to(mesh: MeshArrays, field: SizeField, domain: Rectangle | Polygon | Box) -> MeshArrays:
    """Bisect until no element is too large for the field."""
    for _ in range(_MAX_BISECTIONS):
        wanted = field(mesh.points[mesh.elements].mean(axis=1))
        large = _equilateral_size(mesh.volumes, mesh.dim) > _TOO_LARGE * wanted
        large[_owners_of_large_facets(mesh, field)] = True
        if not large.any():
            return mesh
        refuse_too_many(expected_nodes(mesh, wanted), domain)
        mesh = bisect(mesh, large)[0]
    raise ValueError(f"the size field cannot be reached: after {_MAX_BISECTIONS} bisections {large.sum()} elements of "
                     f"{domain!r} are still too large; does it tend to zero at a point?")


def _owners_of_large_facets(mesh: MeshArrays, field: SizeField) -> np.ndarray:
    """Elements with a boundary facet that is too large for the field on the facet: centroids lie off the boundary."""
    corners = mesh.points[mesh.facets]
    sides = corners[:, 1:] - corners[:, :1]
    gram = np.linalg.det(sides @ sides.transpose(0, 2, 1))
    sizes = _equilateral_size(np.sqrt(gram) / (mesh.dim - 1), mesh.dim - 1)
    large = sizes > _TOO_LARGE * field(corners.mean(axis=1))
    table = facet_table(mesh.elements, mesh.n_nodes)
    return table.first[table.find(facet_keys(mesh.facets[large], mesh.n_nodes))]


def _equilateral_size(measure: np.ndarray, dim: int) -> np.ndarray:
    """Edge of the equilateral simplex of the same measure: refinement halves it, unlike the longest edge."""
    if dim == 1:
        return measure
    return np.sqrt(measure * 4 / math.sqrt(3)) if dim == 2 else np.cbrt(measure * 6 * math.sqrt(2))


def _check_domain(domain: Rectangle | Polygon | Box) -> None:
    if not isinstance(domain, Rectangle | Polygon | Box):
        raise TypeError(f"domain must be a Rectangle, a Polygon or a Box, got {domain!r}")
    if isinstance(domain, Polygon):
        require_simple(domain)


def _grading(value: float) -> float:
    grading = checks.positive("grading", value)
    if not grading <= 1:
        raise ValueError(f"grading must be at most 1, got {value!r}")
    return grading
