r"""The surfaces of revolution that faces of solids lie on, new nodes put onto them, and what lies
behind facets.

A plane, cylinder, cone, sphere or torus is a straight line or a circle of a half plane (r, z),
turned about an axis. It is found from points and normals that OCC gives. All normals of such a
surface meet its axis: with the moment
:math:`p \times n` of a normal n at p, the direction a of the axis and :math:`m = o \times a` of a point o on it,

.. math:: (p \times n) \cdot a + n \cdot m = 0 .

A node halfway along an edge of the mesh lies on one face or on two. From the gaps f to their
surfaces and the gradients J of these it moves by :math:`-J^+ f`, again and again: on one surface
that is exact, on a crossing it is Newton's method, and where two surfaces touch each step still
halves the distance."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from adaptmg import _checks as checks
from adaptmg.mesh.arrays import MeshArrays, Surface, mask_of, trusted
from adaptmg.mesh.soundness import least_angle
from adaptmg.problem.plane_edges import Arc, Segment

# steps of Newton's method at most
_STEPS = 60
#: smallest angle of a draft, and of a refined element where nodes moved, degrees: elements whose nodes all
#: lie on the boundary keep theirs. Half and twice change none of 30 random solids once refined; of drafts 6
#: changes none, 24 makes 8 of them finer
FLAT = 10.0
# steps from a chord to its surface, which square the angle of the arc each time: 0.5 -> 1e-16 in 5
_NEWTON = 6
# cosine between a direction and the normal of a surface below which it does not lead onto it: half and
# twice change none of 30 random solids
_GRAZING = 0.1
# cosine between facets and the surface behind them: half changes none of 30 random solids; with twice, 1,
# round ones have no surface
_PARALLEL = 0.5
# corners of a facet lie nearer to the surface behind it than this part of the extent of the boundary,
# else the mesh is another one than that of the domain: nodes of files have six digits
_MOVED = 10 * checks.SIX_DIGITS
#: the same after bisection, which may leave nodes on chords: those of 90 degrees are .1 high
CHORDAL = 0.1
# the middle of a facet lies over the edge behind it, or next to it by this part of its length: rounding;
# half and twice change none of 30 random solids
_BESIDE = 1e-3


class Misplaced(ValueError):
    """Nodes of a refined mesh cannot be put onto its boundary, or its draft is too flat for that."""


@dataclass(frozen=True, eq=False)
class Revolved:
    """A line or circle turned about an axis."""

    origin: np.ndarray  # (3,): on the axis
    axis: np.ndarray  # (3,): of length 1
    profile: np.ndarray  # (2,): the normal of the line, or the centre of the circle
    extent: float  # distance of the line from the origin, or the radius of the circle
    straight: bool  # whether it is a line
    edge: Segment | Arc | None = None  # of the plane (x, y): the surface ends where it does

    def gaps(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the signed distances (n,) of points (n, 3) from the surface, positive outside the circle
        or on the side of the normal of the line, and their gradients (n, 3)."""
        # points in the half plane (r, z), ``outward`` is the direction of r
        offset = points - self.origin
        z = offset @ self.axis
        away = offset - z[:, None] * self.axis
        r = np.linalg.norm(away, axis=1)
        outward = away / np.where(r > 0, r, 1.0)[:, None]
        if self.straight:
            normals = np.broadcast_to(self.profile, (len(points), 2))
            gaps = normals[:, 0] * r + normals[:, 1] * z - self.extent
        else:
            spoke = np.column_stack([r, z]) - self.profile
            length = np.linalg.norm(spoke, axis=1)
            normals = spoke / np.where(length > 0, length, 1.0)[:, None]
            gaps = length - self.extent
        return gaps, normals[:, :1] * outward + normals[:, 1:] * self.axis

    @property
    def plane(self) -> bool:
        """Return whether it is a plane: the normal of the line is the axis."""
        return self.straight and not self.profile[0]

    @property
    def cylinder(self) -> bool:
        """Return whether it is a cylinder: the line is parallel to the axis."""
        return self.straight and not self.profile[1]

    @property
    def sphere(self) -> bool:
        """Return whether it is a sphere: the centre of the circle is on the axis, at the origin."""
        return not self.straight and not self.profile.any()

    def moved(self, rotation: np.ndarray, offset: np.ndarray, scale: float = 1.0) -> Revolved:
        """Return the surface after x goes to scale R x + offset, with the matrix R (``rotation`` (3, 3))."""
        return replace(
            self,
            origin=scale * rotation @ self.origin + offset,
            axis=rotation @ self.axis,
            edge=None,
            profile=self.profile if self.straight else scale * self.profile,
            extent=scale * self.extent,
        )

    def along(self, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return how far (n,), m, the surface is from points (n, 3) near it along unit vectors
        ``directions`` (n, 3); 0 where they graze it, or miss it."""
        far = np.zeros(len(points))
        hit = np.ones(len(points), dtype=bool)
        for _ in range(_NEWTON):  # Newton's method for gap(point + far direction) = 0
            gaps, gradients = self.gaps(points + far[:, None] * directions)
            slopes = np.einsum("nd,nd->n", gradients, directions)
            hit &= np.abs(slopes) > _GRAZING
            far = far - np.where(hit, gaps, 0.0) / np.where(hit, slopes, 1.0)
        return np.where(hit, far, 0.0)


def plane_through(point: ArrayLike, normal: ArrayLike) -> Revolved:
    """Return the plane through a point that is normal to a unit vector: a line normal to the axis, turned."""
    return Revolved(
        np.array(point), np.array(normal), profile=np.array([0.0, 1.0]), extent=0.0, straight=True
    )


def round_about(origin: ArrayLike, axis: ArrayLike, radius: float) -> Revolved:
    """Return the cylinder of a radius about a unit vector as axis: a line parallel to it, turned."""
    return Revolved(
        np.array(origin), np.array(axis), profile=np.array([1.0, 0.0]), extent=radius, straight=True
    )


@dataclass(frozen=True, eq=False)
class Curved(Surface):
    """Facets, and the exact surfaces that they are chords of."""

    exact: Sequence[Revolved]
    bisected: bool = False  # nodes of which may lie on chords; those of others do not miss surfaces

    @cached_property
    def nearest(self) -> np.ndarray:
        """Return the number (n,) of the surface behind each facet, -1 where none is near."""
        near = CHORDAL if self.bisected else _MOVED
        return nearest(self.exact, self.points[self.facets], self.normals, near)

    @property
    def behind(self) -> np.ndarray:
        """Return the number (n,) of the curved surface behind each facet, -1 where there is none."""
        # the last entry is that of the number -1
        plane = np.array([surface.plane for surface in self.exact] + [True])
        return np.where(plane[self.nearest], -1, self.nearest)

    def _by_surface(self, facets: np.ndarray) -> Iterator[tuple[Revolved, np.ndarray]]:
        """Yield each exact surface behind the facets with these numbers (n,), and the mask (n,) of those
        that it is behind."""
        number = self.behind[facets]
        for k in np.unique(number[number >= 0]).tolist():
            yield self.exact[k], number == k

    def corner_vectors(self, k: int) -> np.ndarray:
        """Return area vectors (n, dim) along the normals of the exact surface at corners k."""
        result = self.vectors.copy()
        for surface, rows in self._by_surface(np.arange(len(result))):
            places = in_space(self.points[self.facets[rows, k]])
            normals = surface.gaps(places)[1][:, : result.shape[1]]
            outward = np.sign(np.einsum("nd,nd->n", normals, result[rows]))
            result[rows] = (outward * self.measures[rows])[:, None] * normals
        return result

    def rises(self, facets: np.ndarray, points: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Return how far (n, n_points), m, the exact surface is from points (n, n_points, dim) of the facets
        with the numbers ``facets`` (n,), along unit vectors ``directions`` (n, n_points, dim)."""
        result = super().rises(facets, points, directions)
        for surface, rows in self._by_surface(facets):
            places, along = (in_space(x[rows]).reshape(-1, 3) for x in (points, directions))
            result[rows] = surface.along(places, along).reshape(-1, points.shape[1])
        return result


def nearest(
    surfaces: Sequence[Revolved], corners: np.ndarray, normals: np.ndarray, near: float
) -> np.ndarray:
    """Return the number (n,) of the surface that facets or edges with some corners (n, k, dim) are
    chords of: the nearest one that is about parallel to their normals (n, dim), -1 if none is within
    the part ``near`` of their extent."""
    corners = in_space(corners)
    normals = in_space(normals)
    middle = corners.mean(axis=1)
    length = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
    number = np.full(len(corners), -1)
    if not len(corners):
        return number
    best = np.full(len(corners), near * np.linalg.norm(np.ptp(corners, axis=(0, 1))))
    # planes first: a curved surface is taken only where it fits better by more than checks.ALIKE of the
    # length
    for k in sorted(range(len(surfaces)), key=lambda k: not surfaces[k].plane):
        surface = surfaces[k]
        # the largest distance of a corner
        away = np.abs([surface.gaps(corner)[0] for corner in np.moveaxis(corners, 1, 0)]).max(
            axis=0
        )
        gaps, gradients = surface.gaps(middle)
        fits = np.abs(np.einsum("nd,nd->n", gradients, normals)) > _PARALLEL
        if surface.edge is not None:
            foot = (middle - gaps[:, None] * gradients)[:, :2]
            fits &= surface.edge.distance(foot) < _BESIDE * length
        nearer = fits & (away < best - checks.ALIKE * length)
        best = np.where(nearer, away, best)
        number[nearer] = k
    return number


def in_space(points: np.ndarray) -> np.ndarray:
    """Return points or vectors (..., dim) with z = 0 in the plane."""
    return (
        points if points.shape[-1] == 3 else np.pad(points, [(0, 0)] * (points.ndim - 1) + [(0, 1)])
    )


def surface_through(points: np.ndarray, normals: np.ndarray) -> Revolved | None:
    """Return the plane, sphere, cylinder, cone or torus (the latter two by :func:`_turned`) with some
    points (n, 3) and unit normals there, None if there is none. The extent of the solid is about 1, and
    points lie on the surface up to checks.ALIKE."""
    if not (np.isfinite(points).all() and np.isfinite(normals).all()):
        return None  # the face has a singular point there
    centre = points.mean(axis=0)
    centred = points - centre
    for kind in (_plane, _sphere, _cylinder, _turned):
        surface = kind(centred, normals)
        if surface is not None and np.abs(surface.gaps(centred)[0]).max() <= checks.ALIKE:
            return replace(surface, origin=surface.origin + centre)
    return None


def _plane(_points: np.ndarray, normals: np.ndarray) -> Revolved:
    """Return the plane through the origin with the first normal; :func:`surface_through` tests it."""
    return plane_through(np.zeros(3), normals[0])


def _round(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the centre (3,) and the signed radius of the circle or sphere with these points and normals
    (n, 3): points = centre + radius * normals."""
    # least squares for the radius, in which the centre does not matter; where all normals are equal it is 0
    spread = normals - normals.mean(axis=0)
    radius = float(
        (spread * (points - points.mean(axis=0))).sum() / max(np.square(spread).sum(), 1e-300)
    )
    return (points - radius * normals).mean(axis=0), radius


def _sphere(points: np.ndarray, normals: np.ndarray) -> Revolved:
    """Return the sphere nearest to points with these normals (n, 3)."""
    centre, radius = _round(points, normals)
    return Revolved(
        centre,
        axis=np.array([0.0, 0.0, 1.0]),  # any will do
        profile=np.zeros(2),
        extent=abs(radius),
        straight=False,
    )


def _cylinder(points: np.ndarray, normals: np.ndarray) -> Revolved | None:
    """Return the cylinder nearest to points with these normals (n, 3), None if the normals are not in one
    plane."""
    axis = np.linalg.svd(normals)[2][-1]  # the direction that is normal to all normals
    if np.abs(normals @ axis).max() > checks.ALIKE:
        return None
    centre, radius = _round(points - np.outer(points @ axis, axis), normals)
    return round_about(centre, axis, abs(radius))


def _turned(points: np.ndarray, normals: np.ndarray) -> Revolved | None:
    """Return the surface of revolution with some centred points and normals (n, 3), None if they
    have no common axis."""
    # (p x n, n) . (a, m) = 0 (module docstring): the vector of the least singular value
    *_, complexes = np.linalg.svd(np.hstack([np.cross(points, normals), normals]))
    axis = complexes[-1, :3]
    moment = complexes[-1, 3:]
    length = np.linalg.norm(axis)
    if length < checks.ALIKE:
        return None
    axis = axis / length
    moment = moment / length
    origin = np.cross(axis, moment)
    # points and normals in the half plane (r, z): constant normals mean a line, else a circle
    z = (points - origin) @ axis
    away = points - origin - np.outer(z, axis)
    r = np.linalg.norm(away, axis=1)
    plane = np.column_stack([r, z])
    slopes = np.column_stack(
        [(normals * away).sum(axis=1) / np.where(r > 0, r, 1.0), normals @ axis]
    )
    if np.ptp(slopes, axis=0).max() <= checks.ALIKE:
        return Revolved(
            origin,
            axis,
            profile=slopes[0],
            extent=float((plane @ slopes[0]).mean()),
            straight=True,
        )
    centre, radius = _round(plane, slopes)
    return Revolved(origin, axis, profile=centre, extent=abs(radius), straight=False)


def candidates(samples: Sequence[np.ndarray]) -> list[list[Revolved]] | None:
    """Return for each face the surfaces that its ``samples`` lie on (:func:`surfaces_through`); None if
    those of a face do not lie on a known surface."""
    surfaces_of_faces = [surfaces_through(patches) for patches in samples]
    return surfaces_of_faces if all(surfaces_of_faces) else None


def surfaces_through(patches: np.ndarray) -> list[Revolved]:
    """Return the surfaces that patches (n_patches, n, 6) of n points and normals of a face lie on, none
    for patches that do not lie on a known surface."""
    surfaces = [surface_through(patch[:, :3], patch[:, 3:]) for patch in patches]
    return [surface for surface in surfaces if surface is not None]


def surfaces_of(candidates: Sequence[Sequence[Revolved]], mesh: MeshArrays) -> list[Revolved]:
    """Return for each boundary of a mesh (called by the numbers of faces) the first of the
    candidates of its face that all its nodes lie on; Misplaced if there is none."""
    result = []
    for label, face in enumerate(mesh.boundaries):
        nodes = mesh.points[np.unique(mesh.facets[mesh.facet_labels == label])]
        fitting = [
            s
            for s in candidates[int(face)]
            if np.abs(s.gaps(nodes)[0]).max(initial=0.0) <= checks.SIX_DIGITS
        ]
        if not fitting:
            raise Misplaced(f"nodes of face {face} do not lie on its surface")
        result.append(fitting[0])
    return result


def settled(
    surfaces: Sequence[Revolved], points: np.ndarray, labels: np.ndarray, near: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) put onto two surfaces each, of which ``labels`` (n, 2) are the numbers,
    within ``near``, and the rows of the points that do not reach them."""
    places = points.copy()
    rest = np.arange(len(points))
    for _ in range(_STEPS):
        gaps = np.empty((len(rest), 2))
        gradients = np.empty((len(rest), 2, 3))
        for label in np.unique(labels[rest]):
            # (n, 2): of which points this is the first surface, or the second
            at = labels[rest] == label
            gaps[at], gradients[at] = surfaces[label].gaps(places[rest[np.nonzero(at)[0]]])
        far = np.abs(gaps).max(axis=1) > near
        rest = rest[far]
        if not len(rest):
            break
        # x - J^+ f (module docstring)
        places[rest] -= np.einsum(
            "nij,nj->ni", np.linalg.pinv(gradients[far], rcond=checks.SIX_DIGITS), gaps[far]
        )
    return places, rest


def onto_surfaces(
    surfaces: Sequence[Revolved], mesh: MeshArrays, n_old: int, flat: float = FLAT
) -> MeshArrays:
    """Return a sound refined mesh with its boundary nodes from ``n_old`` on put onto the surfaces
    of their boundaries; sound if none of its elements became flat, with an angle of ``flat``
    degrees. Misplaced otherwise, or where nodes do not reach their surfaces."""
    row, corner = np.nonzero(mesh.facets >= n_old)
    if not len(row):
        return mesh
    # the lowest and the highest label at each new node: its surfaces, twice the same of only one
    nodes, number = np.unique(mesh.facets[row, corner], return_inverse=True)
    labels = np.full((len(nodes), 2), [len(surfaces), -1])
    np.minimum.at(labels[:, 0], number, mesh.facet_labels[row])
    np.maximum.at(labels[:, 1], number, mesh.facet_labels[row])
    places, missed = settled(surfaces, mesh.points[nodes], labels, checks.ROUNDING)
    if len(missed):
        raise Misplaced(f"{len(missed)} nodes do not reach the surfaces of their faces")
    points = mesh.points.copy()
    points[nodes] = places
    moved = mask_of(nodes, mesh.n_nodes)
    if not least_angle(points, mesh.elements[moved[mesh.elements].any(axis=1)]) > flat:
        raise Misplaced("elements at a curved boundary became flat")
    return trusted(replace(mesh, points=points), mesh.sound)
