"""surfaces_of: the surfaces that the facets of a domain's boundaries are chords of.

A facet is straight, the boundary need not be. Each surface is a plane or of revolution
(:mod:`adaptmg.mesh.surfaces`); the edges of plane domains, profiles in axisymmetry too, are the
planes and cylinders that they sweep along z."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from adaptmg.mesh.sizes import in_edges
from adaptmg.mesh.surfaces import Revolved, plane_through, round_about
from adaptmg.problem.combined_domains import Assembly, Combination, Cracked
from adaptmg.problem.plane_domains import BOX_SIDES, Box, Domain, Outline
from adaptmg.problem.plane_edges import Arc, Segment
from adaptmg.problem.solid_domains import Ball, Cylinder, Extrusion, Moved, Revolution, StepFile

_AXIS = np.eye(3)[2]


def surfaces_of(domain: Domain | None) -> dict[str, list[Revolved]]:
    """Return the surfaces of the faces of each boundary of a domain, m, in no order; none of a STEP
    file, which :func:`adaptmg.mesh.step.exact_surfaces` reads, nor of cracks in space, whose faces
    are plane, as their facets are."""
    # plane domains, cracked and combined ones too, have an outline of edges: the last line takes them
    if domain is None or isinstance(domain, StepFile):
        return {}
    if isinstance(domain, Assembly):
        return {
            f"{body}.{name}": surfaces
            for body, part in domain.parts.items()
            for name, surfaces in surfaces_of(part).items()
        }
    if isinstance(domain, Cracked) and domain.dim == 3:
        return surfaces_of(domain.domain)
    if isinstance(domain, Combination) and domain.dim == 3:
        return _merged(
            (domain.renamed(part, name), surface)
            for part in "ab"
            for name, surfaces in surfaces_of(getattr(domain, part)).items()
            for surface in surfaces
        )
    if isinstance(domain, Moved):
        offset = np.array(domain.offset)
        return {
            name: [surface.moved(domain.rotation, offset) for surface in surfaces]
            for name, surfaces in surfaces_of(domain.solid).items()
        }
    return _merged(_faces(in_edges(domain)))


def _merged(named: Iterable[tuple[str, Revolved]]) -> dict[str, list[Revolved]]:
    """Return the surfaces of each name."""
    result: dict[str, list[Revolved]] = {}
    for name, surface in named:
        result.setdefault(name, []).append(surface)
    return result


def _faces(domain: Domain) -> Iterator[tuple[str, Revolved]]:
    """Yield the name and the surface of each face of a solid, or of each edge of a plane domain."""
    if isinstance(domain, Outline):
        yield from _extruded(domain)
    elif isinstance(domain, Box):
        for name, (axis, end) in BOX_SIDES.items():
            yield name, plane_through((domain.lower, domain.upper)[end], np.eye(3)[axis])
    elif isinstance(domain, Cylinder):
        top = np.array(domain.point) + domain.height * np.array(domain.axis)
        yield "side", round_about(domain.point, domain.axis, domain.radius)
        yield "bottom", plane_through(domain.point, domain.axis)
        yield "top", plane_through(top, domain.axis)
    elif isinstance(domain, Ball):
        yield (
            "surface",
            # a circle around the centre, turned about any axis through it
            Revolved(
                np.array(domain.centre),
                _AXIS,
                profile=np.zeros(2),
                extent=domain.radius,
                straight=False,
            ),
        )
    elif isinstance(domain, Extrusion):
        yield from _extruded(domain.polygon)
        yield "bottom", plane_through((0.0, 0.0, domain.base), _AXIS)
        yield "top", plane_through((0.0, 0.0, domain.base + domain.height), _AXIS)
    elif isinstance(domain, Revolution):  # all other domains are resolved in surfaces_of
        yield from _turned(domain)


def _extruded(outline: Outline) -> Iterator[tuple[str, Revolved]]:
    """Yield the surfaces that the edges of an outline make when they are extruded along z."""
    for i, name in enumerate(outline.boundaries):
        edge = outline.edges[i]
        surface = (
            round_about((*edge.center, 0.0), _AXIS, edge.radius)
            if isinstance(edge, Arc)
            else plane_through((*edge.start, 0.0), (*_normal(edge), 0.0))
        )
        yield name, replace(surface, edge=edge)


def _normal(edge: Segment) -> np.ndarray:
    """Return the unit normal (2,) of an edge, its direction turned by -90 degrees: out of the outline."""
    along = edge.end - edge.start
    return np.array([along[1], -along[0]]) / edge.length


def _turned(domain: Revolution) -> Iterator[tuple[str, Revolved]]:
    """Yield the names and surfaces of the edges of a profile, turned about z, and of the two ends
    of the turn."""
    origin = np.zeros(3)
    for i, name in enumerate(domain.polygon.boundaries):
        edge = domain.polygon.edges[i]
        if isinstance(edge, Arc):
            centre = np.array(edge.center)
            yield name, Revolved(origin, _AXIS, centre, extent=edge.radius, straight=False)
        else:
            normal = _normal(edge)
            distance = float(normal @ edge.start)
            yield name, Revolved(origin, _AXIS, normal, extent=distance, straight=True)
    for name, angle in (("start", 0.0), ("end", np.radians(domain.angle))):
        yield name, plane_through(origin, (-np.sin(angle), np.cos(angle), 0.0))
