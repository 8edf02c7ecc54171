r"""structured: regular triangulations of rectangles and boxes, also several, nested when the
divisions are multiples.

Node :math:`(i_1, \dots)` lies at exactly lower :math:`+ (i_k / n_k)` (upper - lower), x running
fastest, so that the nodes of nested grids coincide to the last bit. Each cell is cut into two
triangles or six tetrahedra, one for each permutation :math:`\pi` of the axes, :math:`x_0, x_0 +
e_{\pi(1)}, x_0 + e_{\pi(1)} + e_{\pi(2)}, \dots` (H. Freudenthal, Annals of Mathematics 43, 1942,
doi:10.2307/1968813); halving the cells gives a nested refinement.

body_centred: a box of cells with eight corners and a centre. Two neighbouring centres and an edge
of the face between them make a tetrahedron, a centre and half a side of the box another: all have a
twelfth of the volume of a cell and, in cubes, angles between faces of at least 45 degrees.

merged: meshes of several bodies as one mesh. The bodies share no nodes; arrays are concatenated
body by body."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from itertools import permutations
from typing import TypeVar

import numpy as np

from adaptmg import _checks as checks
from adaptmg._text import warn_user
from adaptmg.mesh.arrays import (
    MOST_NODES,
    MeshArrays,
    element_facets,
    normalised,
    sound_by_construction,
)
from adaptmg.mesh.soundness import check_mesh
from adaptmg.problem.combined_domains import Assembly
from adaptmg.problem.plane_domains import BOX_SIDES, Box, Domain, Rectangle

#: cells along each axis, or one number for all
Divisions = int | Sequence[int]
Value = TypeVar("Value")
#: what making the mesh takes at its peak, measured
_BYTES_PER_NODE = {2: 600, 3: 2000}


def structured(domain: Domain, divisions: Divisions | Mapping[str, Divisions]) -> MeshArrays:
    """Triangulate a rectangle or box by a lattice, or each body of an assembly by a separate one.

    Parameters
    ----------
    domain : Rectangle, Box, or Assembly of these
        What to mesh.
    divisions : int or sequence of int; of an assembly also a mapping of str to these
        Cells along every side, or along x, y (, z); 4 gives 5 x 5 nodes. A mapping names each body.

    Returns
    -------
    MeshArrays
        Nested in the mesh of n times the divisions; in 2D the diagonals of the cells run from lower
        left to upper right. The bodies of an assembly share no nodes, see
        :func:`adaptmg.mesh.merged`.

    Raises
    ------
    TypeError, ValueError
        On another domain, divisions below 1, more nodes than the main memory holds or can be
        numbered (3D: 2 million), or a body left out.

    Examples
    --------
    >>> am.mesh.structured(am.Rectangle(width=1, height=1), 4).n_nodes
    25
    """
    warn_of_stretched(domain, divisions)
    return lattices(domain, divisions)


def lattices(domain: Domain, divisions: Divisions | Mapping[str, Divisions]) -> MeshArrays:
    """Return the mesh of :func:`structured` without its warning."""
    meshes = {
        body: _lattice(part, counts) for body, (part, counts) in _parts(domain, divisions).items()
    }
    return merged(meshes) if isinstance(domain, Assembly) else meshes[""]


def _parts(
    domain: Domain, divisions: Divisions | Mapping[str, Divisions]
) -> dict[str, tuple[Rectangle | Box, tuple[int, ...]]]:
    """Return each body, called "" where it is alone, and its cells along each axis."""
    if isinstance(domain, Assembly):
        apart = per_body("divisions", divisions, domain.bodies)
        return {body: _parts(part, apart[body])[""] for body, part in domain.parts.items()}
    if not isinstance(domain, Rectangle | Box):
        raise TypeError(
            "structured grids are made of a Rectangle or a Box, or an Assembly of them, got "
            f"{checks.described(domain)}; graded meshes other domains (Hierarchy.graded)"
        )
    return {"": (domain, _divisions(of_one_body("divisions", divisions), domain.dim))}


#: sides of cells over each other from which cycles are many: bar and block take 8 and 10 with 1 : 1, 12 and 14 with 2,
#: 18 and 20 with 3, 24 and 29 with 4, 53 with 8, and end in the active set method with 16 : 1
_STRETCHED = 3.0


def warn_of_stretched(domain: Domain, divisions: Divisions | Mapping[str, Divisions]) -> None:
    """Warn of cells much longer than wide, with the divisions that make them square."""
    for part, counts in _parts(domain, divisions).values():
        sides = np.subtract(part.upper, part.lower)
        cells = sides / counts
        ratio = cells.max() / cells.min()
        if ratio > _STRETCHED * (1 + 1e-9):  # by more than rounding
            # square cells of the same measure, but at least one across the shortest side
            size = min(float(np.prod(cells)) ** (1 / len(cells)), sides.min())
            square = tuple(int(n) for n in np.maximum(np.rint(sides / size), 1))
            warn_user(
                f"divisions {counts}: the cells are {ratio:.3g} times as long as wide, which takes multigrid "
                f"many cycles and makes elements inaccurate; divisions {square} make them about square"
            )


def _lattice(domain: Rectangle | Box, counts: tuple[int, ...]) -> MeshArrays:
    """Mesh one body as :func:`structured` does."""
    dim = domain.dim
    # x runs fastest: the last axis goes first in the lattice
    shape = tuple(n + 1 for n in counts[::-1])
    points = np.empty((math.prod(shape), dim))
    coordinates = points.reshape(*shape, dim)
    for k, (lower, upper, n) in enumerate(zip(domain.lower, domain.upper, counts, strict=True)):
        places = lower + np.arange(n + 1) / n * (upper - lower)
        # along axis dim - 1 - k of the lattice, the same along the others
        coordinates[..., k] = places.reshape(-1, *[1] * k)
    nodes = np.arange(len(points), dtype=np.int32).reshape(shape)
    cells = nodes[np.s_[:-1, :-1, :-1][:dim]]  # the lowest node of each
    strides = strides_of(counts)
    elements = _repeated_in(_corners(dim) @ strides, cells)
    # at the end 0 of an axis the first cells along it, at the end 1 the last ones (-1)
    sides = [
        _repeated_in(side_corners @ strides, cells.take([-end], axis=dim - 1 - axis))
        for axis, end, side_corners in _sides(domain.boundaries, dim)
    ]
    arrays = {
        "points": points,
        "elements": elements,
        "facets": np.concatenate(sides),
        "facet_labels": np.repeat(np.arange(len(sides), dtype=np.int32), list(map(len, sides))),
        "element_body": np.zeros(len(elements), dtype=np.int32),
    }
    checks.freeze(*arrays.values())
    names = {"boundaries": domain.boundaries, "bodies": ("body",)}
    return MeshArrays.written(**arrays, **names, sound=True, apart=True, lattices=(counts,))


def unit_lattice(counts: tuple[int, ...]) -> MeshArrays:
    """Return the lattice with some numbers of cells along the axes, whose edges have the length 1, and
    with the lower corner at the origin."""
    if len(counts) == 2:
        width, height = counts
        return _lattice(Rectangle(width=width, height=height), counts)
    width, depth, height = counts
    return _lattice(Box(width=width, depth=depth, height=height), counts)


def body_centred(domain: Box, counts: Sequence[int]) -> MeshArrays:
    """Return tetrahedra by the corners and centres of cells; ``counts`` are the cells along each
    axis."""
    shape = np.array(counts)
    corners = np.arange(np.prod(shape + 1)).reshape(shape + 1)
    centres = corners.size + np.arange(np.prod(shape)).reshape(shape)
    places = np.concatenate(
        [
            np.indices(corners.shape).reshape(3, -1).T,
            np.indices(centres.shape).reshape(3, -1).T + 0.5,
        ]
    )
    elements = []
    facets = {}
    for axis in range(3):
        # with l cells along the axis, n and m along the others: corners (n + 1, m + 1, l + 1), centres
        # (n, m, l), and the four corners of each face across the axis in turn (4, n, m, l + 1)
        corner = np.moveaxis(corners, axis, -1)
        centre = np.moveaxis(centres, axis, -1)
        around = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]])
        # on the two sides of each inner face (n, m, l - 1)
        below = centre[..., :-1]
        above = centre[..., 1:]
        # two centres and an edge of the face between them
        elements += [
            np.stack(
                [below, above, around[k, ..., 1:-1], around[k - 1, ..., 1:-1]], axis=-1
            ).reshape(-1, 4)
            for k in range(4)
        ]
        # on the lower and the upper side of the box: a centre and half a face
        for side, place in ((0, 0), (1, -1)):
            faces = around[..., place].reshape(4, -1).T
            halves = [faces[:, [0, k, k + 1]] for k in (1, 2)]
            elements += [np.column_stack([half, centre[..., place].ravel()]) for half in halves]
            facets[axis, side] = np.concatenate(halves)
    sides = [facets[BOX_SIDES[name]] for name in domain.boundaries]
    return normalised(
        domain.lower + places / shape * (domain.upper - domain.lower),
        np.concatenate(elements),
        np.concatenate(sides),
        np.repeat(np.arange(6), [len(side) for side in sides]),
        domain.boundaries,
        np.zeros(12 * centres.size, dtype=int),
        ("body",),
    )


def strides_of(counts: Sequence[int]) -> np.ndarray:
    """Return the difference (dim,) between the numbers of neighbours along each axis."""
    return np.cumprod([1, *(n + 1 for n in counts[:-1])]).astype(np.int32)


def _divisions(divisions: int | Sequence[int], dim: int) -> tuple[int, ...]:
    """Return the number of cells along each axis."""
    # an array of shape () is one number
    several = not isinstance(divisions, str) and getattr(divisions, "shape", None) != ()
    numbers = (
        tuple(divisions) if several and isinstance(divisions, Iterable) else (divisions,) * dim
    )
    if len(numbers) != dim:
        raise ValueError(
            f"divisions must be one integer or {dim} of them, got {checks.shown(divisions)}"
        )
    counts = tuple(checks.integer("divisions", n, 1, 2**31) for n in numbers)
    nodes = math.prod(n + 1 for n in counts)
    if nodes > MOST_NODES[dim]:
        raise ValueError(
            f"divisions: {counts} make {nodes:.3g} nodes, a {dim}D mesh may have at most "
            f"{MOST_NODES[dim]:.3g}"
        )
    checks.fits(
        "divisions",
        _BYTES_PER_NODE[dim] * nodes,
        f"{counts} make {nodes:.3g} nodes, whose mesh alone",
    )
    return counts


@cache
def _corners(dim: int) -> np.ndarray:
    """Return the two triangles or six tetrahedra of a cell, positively oriented: the places
    (n_simplices, dim + 1, dim) of their corners along the axes, 0 or 1."""
    simplices = []
    for path in permutations(np.eye(dim, dtype=np.int32)):
        corners = np.cumsum([np.zeros(dim, dtype=np.int32), *path], axis=0, dtype=np.int32)
        odd = np.linalg.det(path) < 0
        simplices.append(corners[[*range(dim - 1), dim, dim - 1]] if odd else corners)
    return np.array(simplices)


@cache
def _sides(names: tuple[str, ...], dim: int) -> list[tuple[int, int, np.ndarray]]:
    """Return for each named side of a cell its axis, its end of this axis, 0 or 1, and the outward
    facets there: the places (n, dim, dim) of their corners, in the order of the nodes."""
    facets = element_facets(_corners(dim)).reshape(-1, dim, dim)
    # all facets of a side have its lowest and its highest node: they are sorted by that between, in any lattice
    nodes = np.sort(facets @ strides_of((1,) * dim), axis=1)
    facets = facets[np.lexsort(nodes.T[::-1])]
    result = []
    for name in names:
        axis, end = BOX_SIDES[name]
        axis = min(axis, dim - 1)  # bottom and top have the last axis, in the plane 1
        result.append((axis, end, facets[(facets[:, :, axis] == end).all(axis=1)]))
    return result


def _repeated_in(simplices: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Move the simplices (n, k) of the cell whose lowest node is 0 to each of some cells (..., y, x)."""
    return (cells[..., None, None] + simplices).reshape(-1, simplices.shape[1])


def merged(meshes: Mapping[str, MeshArrays]) -> MeshArrays:
    """Return one mesh of several bodies, each meshed apart.

    Parameters
    ----------
    meshes : mapping of str to MeshArrays
        The mesh of each body by its name, without "."; one body each, all of the same dimension.

    Returns
    -------
    MeshArrays
        Nodes, elements and facets of the first body come first, then those of the next; boundaries
        are called "body.boundary". Nodes at the same place stay apart.

    Raises
    ------
    TypeError, ValueError
        If ``meshes`` is empty or no mapping, on names with ".", meshes of several bodies, of
        different dimensions, or that are not sound (:func:`adaptmg.mesh.check_mesh`).

    Examples
    --------
    >>> block = am.mesh.structured(am.Rectangle(width=1, height=1), 2)
    >>> below = am.mesh.structured(am.Rectangle(width=1, height=1, origin=(0, -1)), 2)
    >>> am.mesh.merged({"upper": block, "lower": below}).bodies
    ('upper', 'lower')
    """
    if not isinstance(meshes, Mapping):
        raise TypeError(f"meshes must map body names to MeshArrays, got {type(meshes).__name__}")
    if not meshes:
        raise ValueError("meshes is empty: give at least one body")
    for name, mesh in meshes.items():
        checks.boundary_name("the name of a body in meshes", name)
        if "." in name:
            raise ValueError(
                f"the name of a body must not contain '.', got {name!r}: boundaries are 'body.edge'"
            )
        if not isinstance(mesh, MeshArrays):
            raise TypeError(
                f"meshes[{name!r}] must be MeshArrays, got {type(mesh).__name__}; as_mesh converts"
            )
        if len(mesh.bodies) != 1:
            raise ValueError(
                f"meshes[{name!r}] has {len(mesh.bodies)} bodies ({', '.join(mesh.bodies)}); give the "
                "mesh of each body apart"
            )
    dims = {name: mesh.dim for name, mesh in meshes.items()}
    if len(set(dims.values())) > 1:
        raise ValueError(f"all meshes must have the same dimension, got {dims}")
    parts = list(meshes.values())
    nodes = _starts(mesh.n_nodes for mesh in parts)
    labels = _starts(len(mesh.boundaries) for mesh in parts)
    for mesh in parts:
        check_mesh(mesh)
    return sound_by_construction(
        MeshArrays(
            points=np.concatenate([mesh.points for mesh in parts]),
            elements=np.concatenate(
                [mesh.elements + start for mesh, start in zip(parts, nodes, strict=True)]
            ),
            facets=np.concatenate(
                [mesh.facets + start for mesh, start in zip(parts, nodes, strict=True)]
            ),
            facet_labels=np.concatenate(
                [mesh.facet_labels + start for mesh, start in zip(parts, labels, strict=True)]
            ),
            boundaries=tuple(
                f"{body}.{name}" for body, mesh in meshes.items() for name in mesh.boundaries
            ),
            element_body=np.repeat(np.arange(len(parts)), [len(mesh.elements) for mesh in parts]),
            bodies=tuple(meshes),
        ),
        sum((mesh.lattices for mesh in parts), ()) if all(mesh.lattices for mesh in parts) else (),
    )


def _starts(counts: Iterable[int]) -> np.ndarray:
    """Return where each of some concatenated parts with these numbers of rows begins (n,)."""
    return np.cumsum([0, *counts])[:-1]


def per_body(
    name: str, value: Value | Mapping[str, Value], bodies: Sequence[str]
) -> dict[str, Value]:
    """Return the value of the argument ``name`` for each body: one for all, or one by name; ValueError
    unless the names are those of the bodies."""
    if not isinstance(value, Mapping):
        return dict.fromkeys(bodies, value)
    if set(value) != set(bodies):
        raise ValueError(
            f"{name} must name each body once: the bodies are {', '.join(map(repr, bodies))}, "
            f"{name} names {', '.join(map(repr, value))}"
        )
    return {body: value[body] for body in bodies}


def of_one_body(name: str, value: Value | Mapping[str, Value]) -> Value:
    """Return an argument that names no bodies; TypeError otherwise."""
    if isinstance(value, Mapping):
        raise TypeError(f"{name} may name bodies for an Assembly only, got {value!r}")
    return value


def boundaries_of(body: str, names: Sequence[str]) -> tuple[str, ...]:
    """Return those of the names "body.edge" that belong to a body, without "body."."""
    return tuple(name.removeprefix(f"{body}.") for name in names if name.startswith(f"{body}."))
