r"""plane_mesh, solid_mesh: domains meshed by Netgen along a size field, finer near some boundaries.

The edge length asked for, with a bulk size H, a size function s, a size :math:`h_c` along some
boundaries and a grading g, is

.. math:: h(x) = \min\bigl(H,\; s(x),\; h_c + g\,\mathrm{dist}(x, \text{boundaries})\bigr).

Netgen is given sizes along boundaries and, in later rounds, at the centroids of the mesh before
(its own interpolation between boundaries misses the field by up to 4), down to H/16; what is finer
is bisected. Where all faces of a solid lie on planes, cylinders, cones, spheres and tori, Netgen
makes a draft of larger sizes, which is refined (:mod:`adaptmg.mesh.improve`). New nodes are put
onto curves and faces. Domains are scaled to unit extent before, as Netgen and OCC compare lengths
with absolute tolerances; boundaries are called by the numbers of edges and faces, of which several
may share a name. In functions of solids ``worker`` is the process that holds the solid, ``shape`` are
its properties, ``unit`` or ``draft`` is a mesh at unit size, in lengths of ``shape``, ``sizes`` are in m,
and ``faces`` are those along which they are ``sizes.near``, by their numbers.

Elements are straight: all nodes of curved faces lie on them, chords do not. The volume of the mesh
therefore differs from OCC's by :math:`O(h^2)`; it is compared with the bound :math:`\sum_F \tfrac12
A_F h_F \theta_F` over the boundary triangles F, :math:`\theta` being the largest angle to a
neighbour on the same face (on a sphere the error is a third to a half of it)."""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import (
    MeshArrays,
    Surface,
    edge_lengths,
    facet_table,
    in_sweep_order,
    normalised,
    sound_by_construction,
    trusted,
)
from adaptmg.mesh.bisection import refined, with_refinement
from adaptmg.mesh.improve import improved, mean_ratios, refined_draft
from adaptmg.mesh.netgen_guard import Netgen, NetgenFails, NetgenUnfinished, limit_s, netgen, read_s
from adaptmg.mesh.projection import onto_domain
from adaptmg.mesh.sizes import (
    GRADING,
    MAX_BISECTIONS,
    SizeField,
    Unfit,
    boundary_measures,
    check_rims,
    check_sizes,
    expected_nodes,
    extent,
    guessed_nodes,
    overlong,
    refuse_too_many,
    sizes_at,
    too_large,
    unreachable,
)
from adaptmg.mesh.slits import opened_tables
from adaptmg.mesh.soundness import check_mesh, least_angle
from adaptmg.mesh.surfaces import (
    FLAT,
    Misplaced,
    Revolved,
    candidates,
    onto_surfaces,
    surfaces_of,
    surfaces_through,
)
from adaptmg.problem.combined_domains import Cracked, normal_of
from adaptmg.problem.plane_domains import Box, Domain, Outline
from adaptmg.problem.solid_domains import Cylinder, Moved, SolidDomain, StepFile

_LOG = logging.getLogger(__name__)

SizesAt = list[tuple[np.ndarray, np.ndarray]]
"""Points (n, dim) and sizes (n,) there, of the domain at unit size."""

# largest size over the least one that Netgen is asked for; bisection makes what is smaller. Three solids
# that are 24 times finer along a face get 15 800 to 20 600 nodes from Netgen, with angles of 14 degrees;
# measured, half makes 9 to 13 % more nodes, twice 29 to 38 % fewer, with angles of 17
_NETGEN_RATIO = 16.0
# on curved faces edges are at most their radius of curvature over this, about: half changes 22 of 30
# random solids (391 to 240 nodes, 761 to 298), twice 23 (391 to 905, 761 to 4158)
_CURVATURE = 2.0
# Netgen fails on curved faces, or makes slivers, where sizes grow faster; where it does all the
# same, slower growth (which only makes the mesh finer) often helps. Half makes up to 6 % more nodes of
# 8 of 30 random solids, twice changes none
_MAX_GRADING = 0.6
# the slower growth: half and twice of the second and third change none of 30 random solids
_ATTEMPTS = (1.0, 0.7, 0.5)
#: how many times larger than wanted the elements of a draft may be (not two powers of two, which would refine levels
#: whose sizes are halved from one draft), and nodes that it has at least.
#: Of 30 random solids half and twice of the first change none; of the second 7, which have up to 23 % more nodes, and
#: none; of the last 14 and 8, with up to 40 % more and 7 % fewer nodes
_FACTORS = (7.2, 4.0, 1.8)
_LEAST = 100
# mean ratios of tetrahedra (1 if equilateral) that are bisected, if they are at most this share, as
# they are not in thin plates; passes, with moves after each: of seven coarse bars (.06 to .2, 1 to 5
# degrees) six got past .2 in four
# half and twice of the first change none and two of 30 random solids, of the second none
_POOR, _POOR_SHARE = 0.2, 0.1
_RELIEFS = 8
_MOVES = 3
# smallest angle of tetrahedra, degrees, below which a mesh is warned of, as of triangles
# half and twice change none of 30 random solids: it warns
_SHARP = 1.0
# area over the square of the longest edge, below which a triangle is flat: 1 degree
_FLAT = math.tan(math.radians(_SHARP)) / 2
# of the volume: the deviation of a mesh that chords do not explain. OCC compares lengths with 1e-7 of the extent,
# which is this part of the volume of a plate with a hundredth of the extent as thickness; measured, 4 random solids
# with plane faces deviate by 4e-16 at most, and 8 with round ones by .15 to .37 of the bound for chords
_UNEXPLAINED = 1e-5
# digits that rounding leaves of the coordinates of plane faces
_DIGITS = 14


def _raised(size: float, largest: float) -> float:
    """Return a size times the smallest power of two that Netgen can take next to the largest
    one."""
    return size * 2 ** max(0, math.ceil(math.log2(largest / _NETGEN_RATIO / size)))


def plane_mesh(
    domain: Outline,
    field: SizeField,
    size: float,
    near: float | None,
    names: Sequence[str],
    grading: float,
    rounds: int,
) -> MeshArrays:
    """Mesh a plane domain by a size field, which is at most ``size``, and ``near`` along the
    boundaries ``names`` (None: it may be small anywhere): Netgen makes a draft in ``rounds`` + 1 rounds,
    with the smallest sizes that it can take, bisection the rest."""
    start = size / _NETGEN_RATIO if near is None else _raised(near, size)
    mesh = finished(
        domain,
        _plane_draft(
            domain,
            lambda x: np.maximum(field(x), start),
            size,
            dict.fromkeys(names, start),
            grading,
            rounds,
        ),
    )
    for _ in range(MAX_BISECTIONS):
        large, sizes = too_large(mesh, field)
        if not large.any():
            break
        refuse_too_many(expected_nodes(mesh, sizes), domain)
        mesh = onto_domain(domain, refined(mesh, large).mesh, mesh.n_nodes)
    else:
        raise unreachable(domain, large)
    try:
        # without the history of its bisections: a mesh that was made, not bisected by the user
        return with_refinement(check_sizes(check_rims(domain, mesh), field), refinement=None)
    except Unfit as error:
        raise netgen_error(domain, error) from error


def _plane_draft(
    domain: Outline,
    sizes: SizeField,
    size: float,
    sides: Mapping[str, float],
    grading: float,
    rounds: int,
) -> MeshArrays:
    """Return Netgen's mesh of a plane domain, not checked: a first one, then ``rounds`` more, each
    by the ``sizes`` at the centroids of the mesh before. They are at most ``size``, and those of ``sides``
    along some boundaries, m."""
    lower, scale = extent(domain)
    volume, lengths = boundary_measures(domain)
    nodes = refuse_too_many(
        guessed_nodes(
            2,
            volume,
            size,
            sum(lengths[name] for name in sides),
            min(sides.values(), default=1.0),  # 1: of no effect, as lengths are 0 without sides
            grading,
        ),
        domain,
    )
    at: SizesAt = []  # sizes that Netgen gets, besides the largest one and those along boundaries
    options = {"maxh": size / scale, "grading": grading}
    sides = {name: h / scale for name, h in sides.items()}
    for rounds_left in range(rounds, -1, -1):
        # the steps that improve shapes take most of the time: only the last mesh needs them, of the others
        # only the centroids are used
        fast = {"optsteps2d": 0} if rounds_left else {}
        try:
            with netgen() as worker:
                tables = worker(
                    "mesh_plane",
                    domain,
                    lower,
                    scale,
                    sides,
                    options | fast,
                    at,
                    seconds=limit_s(nodes, dim=2),
                )
            if domain.twins:
                # outward normals are the edges turned by -90 degrees
                along = np.array(domain.vertices)[domain.following] - domain.vertices
                normals = along @ [[0, -1], [1, 0]]
                tables = opened_tables(
                    {str(left): str(right) for right, left in domain.twins.items()},
                    {str(left): normals[left] for left in domain.twins.values()},
                    *tables,
                )
            unit = normalised(*tables)
        except ValueError as error:
            raise netgen_error(domain, error) from error
        mesh = _onto_outline(
            domain, replace(unit, points=lower + scale * unit.points, bodies=("body",))
        )
        if rounds_left:
            places = mesh.points[mesh.elements].mean(axis=1)
            target = sizes(places)
            nodes = refuse_too_many(expected_nodes(mesh, target), domain)
            at = [((places - lower)[target < size] / scale, target[target < size] / scale)]
    return mesh


def netgen_error(domain: Domain, why: Exception) -> ValueError:
    """Return the error that names the domain and the remedy."""
    if isinstance(why, NetgenUnfinished):
        return NetgenUnfinished(
            f"Netgen could not mesh {domain!r}: {why}: take smaller sizes where a part is thin, or "
            "make it thicker"
        )
    return ValueError(
        f"Netgen could not mesh {domain!r} ({why}); change the sizes a little or take a smaller grading"
    )


def _onto_outline(domain: Outline, mesh: MeshArrays) -> MeshArrays:
    """Return the mesh with its boundary nodes exactly on arcs, on edges along an axis, and on the
    vertices."""
    points = mesh.points.copy()
    vertices = np.array(domain.vertices)
    for edge, start in enumerate(vertices):
        nodes = mesh.boundary_nodes(str(edge))
        arc = domain.arc(edge)
        if arc is not None:
            centre = np.array(arc.center)
            offset = points[nodes] - centre
            stretch = arc.radius / np.linalg.norm(offset, axis=1)
            points[nodes] = centre + offset * stretch[:, None]
        else:
            for axis in np.flatnonzero(start == vertices[domain.following[edge]]):
                points[nodes, axis] = start[axis]
    # after the edges, which would move vertices by rounding
    for edge, start in enumerate(vertices):
        nodes = mesh.boundary_nodes(str(edge))
        nearest = np.argmin(np.linalg.norm(points[nodes] - start, axis=1))
        points[nodes[nearest]] = start
    return replace(mesh, points=points)


def finished(domain: Outline, mesh: MeshArrays) -> MeshArrays:
    """Return the mesh with the names of the domain's boundaries in place of edge numbers,
    checked."""
    mesh = in_sweep_order(check_mesh(mesh))
    names = tuple(dict.fromkeys(domain.boundaries))
    labels = np.array([names.index(domain.boundaries[int(edge)]) for edge in mesh.boundaries])
    # other names leave a mesh sound
    mesh = sound_by_construction(
        replace(mesh, facet_labels=labels[mesh.facet_labels], boundaries=names)
    )
    # area over the square of the longest edge l: the height over 2 l
    if (flat := float((mesh.volumes / mesh.element_sizes**2).min())) < _FLAT:
        warnings.warn(
            f"triangles are up to {0.5 / flat:.0f} times as long as high: {domain!r} is thin or has a sharp "
            "corner; take smaller sizes (they are in m) there",
            UserWarning,
            stacklevel=2,
        )
    return mesh


@dataclass(frozen=True, repr=False)
class StepSolid(SolidDomain):
    """A solid of a STEP file."""

    file: StepFile
    number: int  # in the file
    faces: tuple[str, ...]  # their names

    @property
    def boundaries(self) -> tuple[str, ...]:
        """Return the distinct names of faces."""
        return tuple(dict.fromkeys(self.faces))

    def __repr__(self) -> str:
        return f"solid {self.number + 1} of {str(self.file.path)!r}"


@dataclass(frozen=True)
class SolidSizes:
    """Edge lengths in a solid, m."""

    size: float  # largest
    names: tuple[str, ...] = ()  # boundaries along which edge lengths are ``near``
    near: float = 1.0  # of no effect without names
    grading: float = GRADING  # growth of the edge length per distance, above 0 and at most 1
    function: float | SizeField | None = None  # edge lengths that are not exceeded either

    def drafts(self, factor: float, slower: float) -> SolidSizes:
        """Return the sizes of a draft, ``factor`` times as large; they grow by ``slower`` times
        min(``factor`` ``grading``, _MAX_GRADING) per distance."""
        function = self.function
        return replace(
            self,
            size=factor * self.size,
            grading=slower * min(factor * self.grading, _MAX_GRADING),
            near=factor * self.near,
            function=None if function is None else lambda x: factor * sizes_at(function, x),
        )

    def for_netgen(self) -> SolidSizes:
        """Return the sizes raised to what Netgen can take next to the largest one."""
        function = self.function
        least = self.size / _NETGEN_RATIO
        return replace(
            self,
            near=_raised(self.near, self.size),
            function=None
            if function is None
            else lambda x: np.maximum(sizes_at(function, x), least),
        )

    def field(self, points: np.ndarray, mesh: MeshArrays, faces: Sequence[str]) -> np.ndarray:
        """Return the edge lengths (n,) at points (n, 3): ``size``, less by the function, and less
        near some faces of the mesh."""
        from scipy.spatial import cKDTree  # a first solve without it starts sooner

        result = np.full(len(points), self.size)
        if self.function is not None:
            result = np.minimum(result, sizes_at(self.function, points))
        if faces:
            facets = np.concatenate([mesh.boundary_facets(face) for face in faces])
            places = np.concatenate(
                [mesh.points[np.unique(facets)], mesh.points[facets].mean(axis=1)]
            )
            reach = max(self.size - self.near, 0.0) / self.grading
            # beyond ``reach``, where the size does not fall below ``size``, distances are infinite
            away = cKDTree(places).query(points, distance_upper_bound=reach)[0]
            result = np.minimum(result, self.near + self.grading * away)
        return result


@dataclass(frozen=True, eq=False)
class Shape:
    """Properties of an OCC solid at about unit size that a process of Netgen holds."""

    names: list[str]  # of its faces
    areas: list[float]  # of its faces
    volume: float
    corners: np.ndarray  # (2, 3): of its bounding box
    #: of each face: patches of points and normals on its surface (2, n, 6)
    samples: Sequence[np.ndarray]
    centres: np.ndarray  # (n, 3): of its faces
    lower: np.ndarray  # m: where its origin lies
    scale: float  # m: its unit of length
    #: of the left faces of cracks, by number: the direction from there to the right face, whose number follows those of
    #: all others, in this order
    cracks: Mapping[str, np.ndarray] = field(default_factory=dict)


def built_shape(worker: Netgen, domain: SolidDomain | Box) -> Shape:
    """Build the OCC solid of a domain."""
    if isinstance(domain, StepSolid):
        path = Path(domain.file.path)
        unit = domain.file.unit
        try:
            (_, *tables), lower, scale = worker(
                "step_shape", str(path.absolute()), domain.number, seconds=read_s(path)
            )
        except NetgenFails as error:
            raise ValueError(f"{str(path)!r} cannot be read as a STEP file: {error}") from error
        return Shape(list(domain.faces), *tables, lower=unit * lower, scale=unit * scale)
    lower, scale = extent(domain)
    try:
        shape = Shape(
            *worker("build_shape", domain, lower, scale, seconds=limit_s(nodes=0, dim=3)),
            lower=lower,
            scale=scale,
        )
    except NetgenFails as error:
        raise ValueError(
            f"OCC could not build {domain!r} ({error}); change its lengths a little"
        ) from error
    if not isinstance(domain, Cracked):
        return shape
    # a right face, after all others, for each left one of a crack
    normals = {f"{name}.left": normal_of(path) for name, path in domain.cracks.items()}
    if missing := sorted(set(normals) - set(shape.names)):
        raise ValueError(f"cracks[{missing[0].removesuffix('.left')!r}] lies outside the body")
    left = [i for i, name in enumerate(shape.names) if name in normals]
    return replace(
        shape,
        names=[*shape.names, *(shape.names[i].removesuffix("left") + "right" for i in left)],
        areas=[*shape.areas, *(shape.areas[i] for i in left)],
        samples=[*shape.samples, *(shape.samples[i] for i in left)],
        cracks={str(i): normals[shape.names[i]] for i in left},
    )


def solid_mesh(domain: SolidDomain | Box, sizes: SolidSizes, mesher: str = "own") -> MeshArrays:
    """Mesh a solid with straight tetrahedra: one body, with the boundaries of the domain of which a
    face is left. Plane faces normal to an axis have all nodes at the same coordinate, which is
    exact up to 14 digits; nodes of curved faces lie on them within 1e-7 of the extent (on the
    intersection of two; elsewhere to rounding)."""
    solid, turn, offset = _at_rest(domain)
    if (function := sizes.function) is not None:
        sizes = replace(sizes, function=lambda x: sizes_at(function, x @ turn.T + offset))
    with netgen() as worker:
        shape = built_shape(worker, solid)
        mesh = _in_metres(_unit_mesh(worker, shape, sizes, domain, mesher), shape, turn, offset)
    order = tuple(name for name in domain.boundaries if name in mesh.boundaries)
    labels = np.array([order.index(name) for name in mesh.boundaries])[mesh.facet_labels]
    if (angle := least_angle(mesh.points, mesh.elements)) < _SHARP:
        warnings.warn(
            f"tetrahedra have angles down to {angle:.2g} degrees: {domain!r} is thin, or faces meet at a "
            "sharp angle; take smaller sizes (they are in m) there",
            UserWarning,
            stacklevel=2,
        )
    named = replace(mesh, facet_labels=labels, boundaries=order)
    named = trusted(named, mesh.sound)  # other names make no sound mesh unsound
    return in_sweep_order(named)  # sweeps smooth better in an order along the body


def _at_rest(
    domain: SolidDomain | Box,
) -> tuple[SolidDomain | Box, np.ndarray, np.ndarray]:
    """Return the solid before it was moved, a cylinder upright, and the rotation (3, 3) and shift
    (3,) that lead from there to the domain. Netgen cuts space along the axes: of slim bars that lie
    obliquely its elements have a tenth of the angles."""
    if isinstance(domain, Moved):
        solid, turn, offset = _at_rest(domain.solid)
        return solid, domain.rotation @ turn, domain.rotation @ offset + domain.offset
    if isinstance(domain, Cylinder):
        axis = np.array(domain.axis)
        if np.count_nonzero(axis) > 1:
            # rows: the axis, and two unit vectors normal to it and to each other
            _, across, _ = np.linalg.svd(axis[None])[2]
            turn = np.column_stack([across, np.cross(axis, across), axis])
            upright = replace(domain, point=(0.0, 0.0, 0.0), axis=(0.0, 0.0, 1.0))
            return upright, turn, np.array(domain.point)
    return domain, np.eye(3), np.zeros(3)


def _unit_mesh(
    worker: Netgen, shape: Shape, sizes: SolidSizes, domain: Domain, mesher: str
) -> MeshArrays:
    """Return the mesh at unit size of the solid that a process holds.

    Coarse drafts are made and refined first, then meshes at the wanted sizes, which grow ever more
    slowly. The first one without flat elements is returned; if all have some, the one whose worst
    element is the best."""
    faces = [str(i) for i, name in enumerate(shape.names) if name in sizes.names]
    if missing := sorted(set(sizes.names).difference(shape.names)):
        raise ValueError(f"of boundary {missing[0]!r} no face is left on {domain!r}")
    nodes = guessed_nodes(
        3,
        shape.volume,
        sizes.size / shape.scale,
        sum(shape.areas[int(face)] for face in faces),
        sizes.near / shape.scale,
        sizes.grading,
    )
    on_round = _round_nodes(shape, sizes.size / shape.scale)
    refuse_too_many(nodes + on_round, domain)
    surfaces = candidates(shape.samples) if mesher == "own" else None
    if mesher == "own" and surfaces is None:
        _LOG.info(
            "Netgen makes all elements of %r, which has faces other than planes, cylinders, cones, spheres and "
            "tori",
            domain,
        )
    # attempts: drafts with sizes times a factor, then meshes with growth times ``slower``
    attempts = [
        (factor, 1.0) for factor in _FACTORS if surfaces is not None and nodes > _LEAST * factor**3
    ]
    attempts += [(1.0, slower) for slower in _ATTEMPTS]
    why: Exception = NetgenFails("it was not asked")
    best: MeshArrays | None = None
    for factor, slower in attempts:
        draft_nodes = nodes / factor**3 + on_round
        try:
            unit = _attempt(
                worker, shape, sizes, factor, slower, draft_nodes, faces, domain, surfaces
            )
            # with flat elements it is the result only if no attempt makes better ones
            if not _flat_ones(unit).any():
                return unit
            if best is None or mean_ratios(unit).min() > mean_ratios(best).min():
                best = unit
        except (NetgenFails, Unfit, Misplaced) as error:
            why = error
            if not worker.alive:
                break  # the shape ended with its process
    if best is None:
        raise netgen_error(domain, why) from why
    return best


def _attempt(
    worker: Netgen,
    shape: Shape,
    sizes: SolidSizes,
    factor: float,
    slower: float,
    nodes: float,
    faces: Sequence[str],
    domain: Domain,
    surfaces: list[list[Revolved]] | None,
) -> MeshArrays:
    """Return a checked mesh at unit size from a draft of about ``nodes`` nodes, whose sizes are
    ``factor`` times as large and grow ``slower`` times as fast; NetgenFails, Unfit or Misplaced if this
    attempt fails."""
    coarse = sizes.drafts(factor, slower)
    # meshes before the draft, which has sizes by their centroids: one where sizes vary, and one more
    # for a function if the draft is not coarser than its sizes (factor 1)
    by_function = coarse.function is not None
    rounds = int(by_function or bool(faces)) + int(by_function and factor == 1)
    unit = _solid_draft(worker, shape, coarse, faces, domain, nodes, rounds)
    if surfaces is None:
        unit = _bisected(worker, unit, shape, sizes, faces, domain)
    else:
        unit = _on_surfaces(worker, unit, factor, shape, sizes, faces, domain, surfaces)
    check_volume(unit, shape.volume)
    mesh = _placed(check_mesh(unit), shape)
    check_sizes(mesh, lambda x: sizes.field(x, mesh, faces))
    return unit


def _on_surfaces(
    worker: Netgen,
    draft: MeshArrays,
    factor: float,
    shape: Shape,
    sizes: SolidSizes,
    faces: Sequence[str],
    domain: Domain,
    possible: list[list[Revolved]],
) -> MeshArrays:
    """Return a draft at unit size, whose sizes are ``factor`` times those wanted, refined to these on
    the surfaces of its faces, with as few flat elements as :func:`_relieved` leaves; ``possible`` is
    that of :func:`_refined`. If that fails, Misplaced for a coarse draft; one with factor 1 is
    bisected by Netgen."""
    try:
        # a finer draft follows a flat one; after factor 1 there is none
        if factor > 1 and (angle := least_angle(draft.points, draft.elements)) < FLAT:
            raise Misplaced(f"it has angles of {angle:.1f} degrees")
        unit = _refined(draft, shape, sizes, faces, domain, possible)
    except Misplaced as error:
        _LOG.info("a draft of %r with sizes times %g is not refined: %s", domain, factor, error)
        if factor > 1:
            raise
        unit = _bisected(worker, draft, shape, sizes, faces, domain)
    return _relieved(unit, possible)


def _round_nodes(shape: Shape, size: float) -> float:
    """Return the number of nodes that cylinders and spheres ask for where their edges, of the radius over
    _CURVATURE, are shorter than a ``size``; this and all of ``shape`` in lengths at unit size."""
    nodes = 0.0
    for area, samples in zip(shape.areas, shape.samples, strict=True):
        # of the two patches one suffices: both lie on the same cylinder or sphere
        for surface in surfaces_through(samples)[:1]:
            edge = surface.extent / _CURVATURE  # extent: of these two surfaces the radius
            if (surface.cylinder or surface.sphere) and 0 < edge < size:
                # equilateral triangles have 1.15 nodes in the square of their edge; about half of these
                # are counted, since Netgen's edges have this length only approximately
                nodes += 0.6 * area / edge**2
    return nodes


def _checked_mesh(shape: Shape, tables: Sequence) -> MeshArrays:
    """Return the mesh of some tables, opened along cracks; NetgenFails if it is not sound."""
    try:
        if shape.cracks:
            # the right faces have the last numbers
            first = len(shape.names) - len(shape.cracks)
            right = {name: str(first + k) for k, name in enumerate(shape.cracks)}
            tables = opened_tables(right, shape.cracks, *tables)
        return check_mesh(normalised(*tables))
    except ValueError as error:
        raise NetgenFails(str(error)) from error


def _solid_draft(
    worker: Netgen,
    shape: Shape,
    sizes: SolidSizes,
    faces: Sequence[str],
    domain: Domain,
    nodes: float,
    rounds: int,
) -> MeshArrays:
    """Return Netgen's mesh at unit size: a first one, then ``rounds`` more, each by the sizes at
    the centroids of the mesh before."""
    raised = sizes.for_netgen()
    face_sizes = {int(face): raised.near / shape.scale for face in faces}
    options = {
        "maxh": sizes.size / shape.scale,
        "grading": sizes.grading,
        "curvaturesafety": _CURVATURE,
    }
    at: SizesAt = []  # sizes that Netgen gets, besides the largest one and those along boundaries
    for rounds_left in range(rounds, -1, -1):
        # of a draft only its sizes matter: optimising takes most of the time
        fast = {"optsteps3d": 0} if rounds_left else {}
        unit = _checked_mesh(
            shape,
            worker("mesh_shape", face_sizes, options | fast, at, seconds=limit_s(nodes, dim=3)),
        )
        if rounds_left:
            mesh = _placed(unit, shape)
            centroids = mesh.points[mesh.elements].mean(axis=1)
            # before Netgen works for minutes on a mesh that bisection would then find too large
            nodes = max(
                nodes,
                refuse_too_many(expected_nodes(mesh, sizes.field(centroids, mesh, faces)), domain),
            )
            target = raised.field(centroids, mesh, faces)
            small = target < sizes.size
            at = [((centroids - shape.lower)[small] / shape.scale, target[small] / shape.scale)]
    return unit


def _refined(
    draft: MeshArrays,
    shape: Shape,
    sizes: SolidSizes,
    faces: Sequence[str],
    domain: Domain,
    possible: list[list[Revolved]],
) -> MeshArrays:
    """Return the draft at unit size, refined to the sizes; ``possible`` are the surfaces that each face may
    lie on (:func:`~adaptmg.mesh.surfaces.candidates`)."""
    surfaces = surfaces_of(possible, draft)

    def field(unit: MeshArrays) -> np.ndarray:
        mesh = _placed(unit, shape)
        return sizes.field(mesh.points, mesh, faces) / shape.scale

    return refined_draft(
        domain, draft, field, lambda mesh, n_old: onto_surfaces(surfaces, mesh, n_old)
    )


def _flat_ones(mesh: MeshArrays) -> np.ndarray:
    """Return the mask (n_elements,) of the elements that are far from equilateral; none where many are,
    as in thin plates."""
    flat = mean_ratios(mesh) < _POOR
    return flat & (flat.mean() < _POOR_SHARE)


def _relieved(mesh: MeshArrays, possible: list[list[Revolved]]) -> MeshArrays:
    """Return a sound mesh at unit size with its flat elements bisected and moved: those of Netgen
    whose corners all lie on the boundary, which moves alone cannot mend. Of the meshes on the way
    that with the best worst element is returned. ``possible`` is that of :func:`_refined`."""
    best = mesh
    try:
        surfaces = surfaces_of(possible, mesh)
        for _ in range(_RELIEFS):
            if not (flat := _flat_ones(mesh)).any():
                break
            finer = refined(mesh, flat, passes=1).mesh
            # elements that are flat for now are the next to be bisected
            mesh = improved(onto_surfaces(surfaces, finer, mesh.n_nodes, flat=0.0), _MOVES)
            best = max(best, mesh, key=lambda made: mean_ratios(made).min())
    except Misplaced as error:
        _LOG.info("flat elements stay: %s", error)
    return best


def _bisected(
    worker: Netgen,
    unit: MeshArrays,
    shape: Shape,
    sizes: SolidSizes,
    faces: Sequence[str],
    domain: Domain,
) -> MeshArrays:
    """Return the mesh at unit size after bisection until no element is too large."""
    for _ in range(MAX_BISECTIONS):
        mesh = _placed(unit, shape)
        large, at_centroids = too_large(mesh, lambda x, mesh=mesh: sizes.field(x, mesh, faces))
        if sizes.function is None and not faces:
            # a constant size, which Netgen meets: only edges that go through a thin body are too long
            large = overlong(mesh, at_centroids)
        if not large.any():
            return unit
        nodes = refuse_too_many(expected_nodes(mesh, at_centroids), domain)
        if shape.cracks:
            # Netgen's mesh has closed cracks, and not all of the elements marked: this one is
            # bisected here, and new nodes stay on chords
            unit = refined(unit, large, passes=1).mesh
            continue
        # in Netgen, whose mesh has its geometry, so that new nodes go onto the surfaces
        unit = _checked_mesh(shape, worker("bisect", large, seconds=limit_s(nodes, dim=3)))
    raise unreachable(domain, large)


def _placed(unit: MeshArrays, shape: Shape) -> MeshArrays:
    """Return the mesh in m."""
    return trusted(replace(unit, points=shape.lower + shape.scale * unit.points), unit.sound)


def _in_metres(unit: MeshArrays, shape: Shape, turn: np.ndarray, offset: np.ndarray) -> MeshArrays:
    """Return the mesh at unit size in m, rotated by the matrix ``turn`` (3, 3) and shifted by ``offset``
    (3,), with the names of its faces in place of their numbers. Nodes of a plane face normal to an axis
    get one coordinate along it, free of the rounding of scaling."""
    points = (shape.lower + shape.scale * unit.points) @ turn.T + offset
    reach = float(np.abs(points).max())
    for face in unit.boundaries:
        nodes = unit.boundary_nodes(face)
        for axis in np.flatnonzero(np.ptp(points[nodes], axis=0) < checks.ALIKE * reach):
            # the median, rounded to _DIGITS digits of the largest coordinate
            points[nodes, axis] = (
                round(float(np.median(points[nodes, axis])), _DIGITS - math.ceil(math.log10(reach)))
                + 0.0  # no -0.0
            )
    order = tuple(dict.fromkeys(shape.names))
    labels = np.array([order.index(shape.names[int(face)]) for face in unit.boundaries])
    return trusted(
        replace(
            unit,
            points=points,
            facet_labels=labels[unit.facet_labels],
            boundaries=order,
            bodies=("body",),
        ),
        unit.sound,
    )


def check_volume(mesh: MeshArrays, volume: float) -> None:
    """Raise NetgenFails unless the volume is right but for the chords of curved faces."""
    bound = _left_by_chords(mesh) + _UNEXPLAINED * volume
    meshed = float(mesh.volumes.sum())
    if not abs(meshed - volume) <= bound:
        raise NetgenFails(
            f"the mesh fills {meshed / volume:.6g} of the volume, chords explain a deviation of "
            f"{bound / volume:.2g}"
        )


def _left_by_chords(mesh: MeshArrays) -> float:
    """Return a bound of the volume between curved faces and the mesh: the sum over the boundary
    triangles of half the area times the longest edge times the largest angle to a neighbour on the
    same face."""
    surface = Surface(mesh.points, mesh.facets)
    normals = surface.normals
    areas = surface.measures
    longest = edge_lengths(mesh.points[mesh.facets]).max(axis=0)
    edges = facet_table(mesh.facets, mesh.n_nodes)
    # the two triangles at each edge of the boundary
    first = edges.first
    second = edges.second
    angles = np.arccos(np.clip(np.sum(normals[first] * normals[second], axis=1), -1.0, 1.0))
    angles[mesh.facet_labels[first] != mesh.facet_labels[second]] = 0.0
    turn = np.zeros(len(areas))
    np.maximum.at(turn, first, angles)
    np.maximum.at(turn, second, angles)
    return 0.5 * float(np.sum(areas * longest * turn))
