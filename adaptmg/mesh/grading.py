r"""graded and sized: independent meshes that are finer where contact is expected, or where a size
field says.

The size field of :func:`graded`, for a bulk size H, a contact ratio q and a grading g, is

.. math:: h(x) = \min\bigl(H,\; H/q + g \,\mathrm{dist}(x, \text{contact boundaries})\bigr).

Plane domains are triangulated here (:mod:`adaptmg.mesh.triangulate`). A box is cut into cells of
the largest size of the field, which are refined to it and improved (:mod:`adaptmg.mesh.improve`).
Netgen meshes the others, and these if it is asked to or triangulation fails
(:mod:`adaptmg.mesh.netgen_meshes`). It fails itself, or takes minutes, where sizes differ by more
than about 16 in a coarse mesh: the rest is bisected, until no element and no boundary facet is
larger than sqrt(2) times the field. Whoever made it, a mesh is measured in the end: its edges
against the field, its boundary against the curves of a plane domain. Meshes of different sizes are
not nested. The bodies of an :class:`~adaptmg.problem.Assembly` or a STEP file are meshed apart.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays, in_sweep_order
from adaptmg.mesh.delaunay import Untriangulated
from adaptmg.mesh.improve import EQUILATERAL, refined_draft
from adaptmg.mesh.lattices import body_centred, boundaries_of, merged, of_one_body, per_body
from adaptmg.mesh.netgen_guard import netgen
from adaptmg.mesh.netgen_meshes import SolidSizes, built_shape, finished, plane_mesh, solid_mesh
from adaptmg.mesh.sizes import (
    SizeField,
    Unfit,
    boundary_measures,
    check_rims,
    check_sizes,
    distance_to_boundaries,
    expected_nodes,
    growth,
    guessed_nodes,
    in_edges,
    refuse_too_many,
    sizes_at,
    too_large,
)
from adaptmg.mesh.soundness import check_mesh
from adaptmg.mesh.step import step_solids
from adaptmg.mesh.triangulate import triangulated
from adaptmg.problem.combined_domains import Assembly
from adaptmg.problem.plane_domains import Box, Domain, Outline
from adaptmg.problem.solid_domains import SolidDomain, StepFile

_LOG = logging.getLogger(__name__)

#: edge lengths, m: one everywhere, or by position
SizeFunction = float | SizeField

#: places along each side of a box where the field is read for its least and largest size
_READINGS = 9
#: the sides of a cell are at most this many times as long as each other: flatter boxes are refused
_FLATTEST = 1000
#: boxes are refined to this part of the field, so that their elements exceed it by 1.28 at most: on
#: 120 random boxes 1 makes 16 % fewer nodes and elements up to 1.42 times the field, .8 49 % more
#: nodes and up to 1.14
_REFINED_TO = 0.9
#: elements across a body by default, coarse to fine, and along a contact boundary of the finest mesh (in space its
#: length is the root of its area). Ball on block: 39 nodes touch with 14 elements, 9 and 45 with half and twice
_ACROSS, _ALONG = {2: (4, 8, 16), 3: (3, 6)}, {2: 64, 3: 14}
#: elements as large as the square of their size on all contact boundaries in space, at most. Ball on block:
#: 39 nodes touch, 21 with half, 39 with twice
_ON_FACES = 1000
MESHERS = ("own", "netgen")


def graded(
    domain: Domain,
    size: float | Mapping[str, float],
    contact_boundaries: str | Sequence[str] = (),
    contact_ratio: float | Mapping[str, float] = 1.0,
    grading: float | Mapping[str, float] = 0.3,
    *,
    mesher: str = "own",
    size_function: SizeField | None = None,
) -> MeshArrays:
    """Mesh a domain, finer near some boundaries.

    Parameters
    ----------
    domain : Rectangle, Polygon, Outline, Circle, Box, Cylinder, ..., Assembly of these, or StepFile
        What to mesh. A StepFile is treated like an assembly of its solids.
    size : float; of an assembly also a mapping of str to float
        Edge length far from contact, m; a mapping names each body.
    contact_boundaries : str or sequence of str
        Where the edges have the length ``size / contact_ratio``; in an assembly the names are
        "body.edge".
    contact_ratio : float; of an assembly also a mapping of str to float
        >= 1. A few hundred are fine in 2D; in 3D the number of nodes grows with its square. A
        single number does not concern bodies without contact boundaries.
    grading : float; of an assembly also a mapping of str to float
        Growth of the edge length per distance from contact, above 0 and at most 1.
    mesher : {"own", "netgen"}
        What makes small elements. "own": in the plane a Delaunay triangulation of this package,
        which takes a fiftieth of Netgen's time; in space bisection of a coarse mesh (of Netgen, of
        boxes our own) and improvement of shapes, a tenth to a twentieth. "netgen": Netgen alone,
        which also meshes where "own" fails. Solids with faces other than planes, cylinders, cones,
        spheres and tori are left to Netgen.
    size_function : callable, optional
        Edge lengths (n,) at points (n, dim), m, that no edge exceeds either, for instance an
        :class:`adaptmg.SizeNear`.

    Returns
    -------
    MeshArrays
        The same arrays for the same arguments. Nodes lie on arcs, edges are their
        chords (of at most about 35 degrees). The bodies of an assembly share no nodes, see
        :func:`adaptmg.mesh.merged`.

    Raises
    ------
    TypeError, ValueError
        On an unknown domain or boundary, sizes <= 0, a ratio < 1, sizes that ask for
        more than 5 million nodes (3D: 2 million), or where Netgen fails or does not finish; where
        no mesher makes 99 % of the edges shorter than twice the size asked for there, or meets the
        boundary of a plane domain.

    Examples
    --------
    >>> mesh = am.mesh.graded(am.Rectangle(width=1, height=1), 0.5, "bottom", contact_ratio=2)
    >>> mesh.dim
    2
    """
    shape = _meshed(domain)
    names = checks.items("contact_boundaries", contact_boundaries, str, "names of boundaries")
    for name in names:
        if name not in shape.boundaries:
            raise ValueError(
                f"contact_boundaries: boundary {name!r} does not exist; "
                f"the boundaries are {', '.join(dict.fromkeys(shape.boundaries))}"
            )
    if isinstance(shape, Assembly):
        sizes = per_body("size", size, shape.bodies)
        ratios = per_body("contact_ratio", contact_ratio, shape.bodies)
        gradings = per_body("grading", grading, shape.bodies)
        meshes = {}
        for body, part in shape.parts.items():
            near = boundaries_of(body, names)
            # a single ratio does not concern bodies without contact boundaries; if no body has any, the
            # first one refuses it
            is_concerned = near or not names or isinstance(contact_ratio, Mapping)
            ratio = ratios[body] if is_concerned else 1.0
            meshes[body] = graded(
                part,
                sizes[body],
                near,
                ratio,
                gradings[body],
                mesher=mesher,
                size_function=size_function,
            )
        return in_sweep_order(merged(meshes))
    size = checks.positive("size", size)
    ratio = _ratio(contact_ratio)
    if ratio > 1 and not names:
        raise ValueError(
            f"contact_ratio is {contact_ratio!r}, but contact_boundaries is empty: without contact and "
            "ties am.mesh.sized makes meshes that are finer somewhere, for Hierarchy.from_meshes"
        )
    return _graded_body(
        shape,
        size,
        names if ratio > 1 else (),
        size / ratio,
        growth("grading", grading),
        checks.choice("mesher", mesher, MESHERS),
        checks.optional_callable("size_function", size_function, "points (n, dim)"),
    )


def _meshed(domain: Domain) -> Outline | Box | SolidDomain | Assembly:
    """Return the domain to be meshed: a plane one as an outline, a STEP file as the assembly of its
    solids."""
    shape = in_edges(domain)
    return Assembly(parts=step_solids(shape)) if isinstance(shape, StepFile) else shape


def _ratio(value: object) -> float:
    """Return a checked ``contact_ratio``, size in the bulk over size at contact."""
    ratio = checks.number("contact_ratio", value)
    if not ratio >= 1:
        raise ValueError(
            f"contact_ratio must be >= 1 (contact is never coarser than the bulk), got {value!r}"
        )
    return ratio


def _graded_body(
    domain: Outline | Box | SolidDomain,
    size: float,
    names: tuple[str, ...],
    near: float,
    grading: float,
    mesher: str,
    size_function: SizeField | None,
) -> MeshArrays:
    """Mesh one body as :func:`graded` does, whose arguments these are, checked; ``near`` is the size along
    the boundaries ``names``."""
    solid = SolidSizes(size, names, near, grading, size_function)
    if isinstance(domain, SolidDomain) or (isinstance(domain, Box) and mesher == "netgen"):
        return solid_mesh(domain, solid, mesher)
    volume, areas = boundary_measures(domain)
    # before Netgen works for minutes on a mesh that bisection would then find too large
    refuse_too_many(
        guessed_nodes(domain.dim, volume, size, sum(areas[name] for name in names), near, grading),
        domain,
    )

    def field(x: np.ndarray) -> np.ndarray:
        """Return the sizes (n,), m, at points (n, dim)."""
        sizes = (
            np.minimum(size, near + grading * distance_to_boundaries(domain, names, x))
            if names
            else np.full(len(x), size)
        )
        return sizes if size_function is None else np.minimum(sizes, sizes_at(size_function, x))

    if mesher == "own" and (mesh := _mesh_without_netgen(domain, field)) is not None:
        return mesh
    if isinstance(domain, Box):
        return solid_mesh(domain, solid, "netgen")
    # meshes of Netgen before the last one, which has sizes by their centroids: one where sizes vary
    # towards boundaries, and one where a function gives them
    rounds = int(bool(names)) + int(size_function is not None)
    return plane_mesh(domain, field, size, near, names, grading, rounds)


def _mesh_without_netgen(
    domain: Outline | Box, field: SizeField, growth: float | None = None
) -> MeshArrays | None:
    """Return the mesh of a plane domain or a box that this package makes without Netgen; None if it
    fails, or does not have the sizes of the field. ``growth`` is that of
    :func:`~adaptmg.mesh.triangulate.triangulated`, of no effect on boxes."""
    try:
        if isinstance(domain, Box):
            mesh = refined_draft(
                domain, _cells(domain, field), lambda mesh: _REFINED_TO * field(mesh.points)
            )
            # after the checks only the order of nodes and elements changes
            return in_sweep_order(check_sizes(check_mesh(mesh), field))
        mesh = finished(domain, triangulated(domain, field, growth))
        return check_sizes(check_rims(domain, mesh), field)
    except (Untriangulated, Unfit) as error:
        _LOG.info("Netgen meshes the domain: %s", error)
        return None


def _cells(domain: Box, field: SizeField) -> MeshArrays:
    """Return a box in cells whose tetrahedra have about the largest size of a field."""
    sides = domain.upper - domain.lower
    # read the field on a lattice over the box
    shares = np.indices([_READINGS] * 3).reshape(3, -1).T / (_READINGS - 1)
    sizes = field(domain.lower + shares * sides)
    least = float(sizes.min())
    # cells of about the largest size, whose edges have the least size after a whole number of halvings
    halvings = round(math.log2(sizes.max() / least))
    size = least * 2**halvings
    refuse_too_many(guessed_nodes(3, float(np.prod(sides)), size), domain)
    # twelve equilateral tetrahedra of this size have the volume of the cell that they are cut from
    side = size * (12 * EQUILATERAL) ** (1 / 3)
    # rounded up, but for a remainder of up to a quarter of a cell
    counts = np.ceil(np.maximum(1, sides / side - 1 / 4)).astype(int)
    longest = np.argmax(sides)
    if counts[longest] > 3 and counts[longest] % 2 == 0:
        # an odd number: cells of a size and of half of it are then not nested, as meshes of other domains are
        # not. Of two cells a third would be too many
        counts[longest] += 1
    cell = sides / counts
    if cell.max() > _FLATTEST * cell.min():
        raise ValueError(
            f"size {size:g} m is more than {_FLATTEST} times as long as {domain!r} is thick; take smaller "
            "sizes (they are in m)"
        )
    return body_centred(domain, counts)


def sized(
    domain: Domain,
    size_function: SizeFunction | Mapping[str, SizeFunction],
    max_size: float | Mapping[str, float],
    *,
    grading: float = 0.3,
    mesher: str = "own",
) -> MeshArrays:
    """Mesh a domain by a size field.

    Parameters
    ----------
    domain, grading, mesher
        As of :func:`graded`.
    size_function : callable or float; of an assembly also a mapping of str to these
        Points (n, dim) in m -> edge length (n,) in m, for instance an
        :class:`adaptmg.mesh.SizeNear`. It is read at centroids of elements: a dip much narrower
        than the elements around it can be missed.
    max_size : float; of an assembly also a mapping of str to float
        Largest edge length, m.

    Returns
    -------
    MeshArrays
        As of :func:`graded`.

    Raises
    ------
    TypeError, ValueError
        On an unknown domain, sizes <= 0 or not finite, or as :func:`graded`.

    Examples
    --------
    >>> mesh = am.mesh.sized(am.Rectangle(width=1, height=1), lambda x: 0.1 + x[:, 0], max_size=0.5)
    >>> mesh.n_nodes > 10
    True
    """
    return sized_by(domain, size_function, max_size, grading, mesher, foreseen=False)


def sized_by(
    domain: Domain,
    size_function: SizeFunction | Mapping[str, SizeFunction],
    max_size: float | Mapping[str, float],
    grading: float,
    mesher: str = "own",
    foreseen: bool = True,
) -> MeshArrays:
    """Mesh a domain as :func:`sized` does. If the number of nodes is ``foreseen``, no coarse mesh is
    made first to estimate it: .94 of the time of a loop by Remesh to 3800 nodes."""
    shape = _meshed(domain)
    if isinstance(shape, Assembly):
        fields = per_body("size_function", size_function, shape.bodies)
        limits = per_body("max_size", max_size, shape.bodies)
        return in_sweep_order(
            merged(
                {
                    body: sized_by(part, fields[body], limits[body], grading, mesher, foreseen)
                    for body, part in shape.parts.items()
                }
            )
        )
    function = of_one_body("size_function", size_function)
    largest = checks.positive("max_size", max_size)
    mesher = checks.choice("mesher", mesher, MESHERS)
    grading = growth("grading", grading)
    solid = SolidSizes(largest, grading=grading, function=function)
    if isinstance(shape, SolidDomain) or (isinstance(shape, Box) and mesher == "netgen"):
        return solid_mesh(shape, solid, mesher)

    def limited(x: np.ndarray) -> np.ndarray:
        return np.minimum(sizes_at(function, x), largest)

    if mesher == "own":
        if isinstance(shape, Outline):
            refuse_too_many(guessed_nodes(2, shape.area, largest), shape)
            if not foreseen:
                _refuse_large_field(shape, limited, largest)
        if (mesh := _mesh_without_netgen(shape, limited, growth=grading)) is not None:
            return mesh
    if isinstance(shape, Box):
        return solid_mesh(shape, solid, "netgen")
    # two meshes of Netgen before the last one, as of solids: one where sizes vary, one more for a
    # function
    return plane_mesh(shape, limited, largest, near=None, names=(), grading=grading, rounds=2)


def _refuse_large_field(domain: Outline, field: SizeField, largest: float) -> None:
    """Raise ValueError if a size field asks for too many nodes: it is read on a coarse mesh, with a
    sixteenth of the extent, or the largest size, as edge length. On a unit square a size of 2e-5 is
    refused after 4 ms, and without this after 6 s, with nodes along the boundary."""
    size = max(largest, float((domain.upper - domain.lower).max()) / 16)
    coarse = _mesh_without_netgen(domain, lambda x: np.full(len(x), size))
    if coarse is not None:
        _, sizes = too_large(coarse, field)
        refuse_too_many(expected_nodes(coarse, sizes), domain)


def gradings_of(
    sizes: Sequence[float | Mapping[str, float]], coarsest: float
) -> Sequence[float | dict[str, float]]:
    """Return the gradings of levels, coarse to fine, which make their size fields multiples of the
    first."""
    checks.positive("grading", coarsest)

    def of(size: float, first: float) -> float:
        """Return the grading for a size, of which ``first`` is that of the first level."""
        # levels whose sizes rise are refused once they are meshed
        return coarsest * min(checks.positive("size", size) / checks.positive("size", first), 1.0)

    # sizes that name no bodies are those of a single body ""
    bodies = next((tuple(size) for size in sizes if isinstance(size, Mapping)), ("",))
    tables = [per_body("size", size, bodies) for size in sizes]
    gradings = [{body: of(table[body], tables[0][body]) for body in bodies} for table in tables]
    return gradings if bodies != ("",) else [table[""] for table in gradings]


def sensible_sizes(domain: Domain, boundaries: Sequence[str]) -> tuple[tuple[float, ...], float]:
    """Return sizes, coarse to fine, m, that follow bodies, and a contact ratio by the shortest of
    some boundaries."""
    volumes, lengths = measures(domain)
    # edge of the square or cube that is as large as a body on average
    across = (sum(volumes) / len(volumes)) ** (1 / domain.dim)
    sizes = tuple(float(f"{across / count:.2g}") for count in _ACROSS[domain.dim])
    along = [lengths[name] for name in boundaries if name in lengths]
    near = min(along, default=math.inf) / _ALONG[domain.dim]
    if domain.dim == 3 and along:
        # along are square roots of areas: at most _ON_FACES squares of this size cover them together
        near = max(near, math.hypot(*along) / math.sqrt(_ON_FACES))
    return sizes, max(1.0, float(math.ceil(sizes[-1] / near)))


def measures(domain: Domain) -> tuple[list[float], dict[str, float]]:
    """Return the area (m^2) or volume (m^3) of each body, and the length (m) of each boundary, in
    space the root of its area."""
    shape = _meshed(domain)
    if isinstance(shape, Assembly):
        apart = {body: measures(part) for body, part in shape.parts.items()}
        return (
            [volume for volumes, _ in apart.values() for volume in volumes],
            {
                f"{body}.{name}": length
                for body, (_, lengths) in apart.items()
                for name, length in lengths.items()
            },
        )
    if isinstance(shape, Outline):
        area, lengths = boundary_measures(shape)
        return [area], lengths
    with netgen() as worker:
        solid = built_shape(worker, shape)
    areas = dict.fromkeys(solid.names, 0.0)
    for name, area in zip(solid.names, solid.areas, strict=True):
        areas[name] += area
    roots = {name: solid.scale * math.sqrt(area) for name, area in areas.items()}
    return [solid.volume * solid.scale**3], roots
