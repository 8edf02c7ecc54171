"""Contact nodes in front of obstacles that move: their gaps, normals and the slip that friction acts on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from adaptmg.discrete.inclined import HeldNodes
from adaptmg.discrete.mortar.interface import slave_normals
from adaptmg.discrete.obstacles import along_free, facing_obstacle
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.contact_problem import ContactProblem
from adaptmg.problem.surfaces import Moving

#: normals that turn by less than this do not
_ROUNDING = 1e-14


def moved(discrete: DiscreteProblem, problem: ContactProblem, mesh: MeshArrays, now: Mapping[int, Moving],
          before: Mapping[int, Moving]) -> DiscreteProblem:
    """Return the problem with obstacles, by the number of their contact, in the places ``now``.

    Slip counts from where they were ``before``.
    """
    if not now:
        return discrete
    held = HeldNodes(discrete.held.reshape(mesh.points.shape), discrete.inclined)
    contact = discrete.contact
    normals, gaps, reference = contact.normals.copy(), contact.gaps.copy(), contact.slip_reference.copy()
    stops = discrete.stops
    for k, obstacle in now.items():
        own = np.flatnonzero(contact.boundary == k)
        points, boundary = mesh.points[contact.nodes[own]], problem.contact[k].boundary
        outward = slave_normals(mesh.surface(boundary), held)
        direct, gap = facing_obstacle(obstacle, boundary, points, outward[contact.nodes[own]])
        if stops is not None:
            stops = stops.moved(obstacle, boundary, mesh.points, outward, contact.nodes)
        normals[own], gaps[own] = along_free(held.free_part(contact.nodes[own], direct), direct, gap)
        reference[own] += obstacle.motion(points) - before[k].motion(points)
    turned = np.abs(normals - contact.normals).max(initial=0.0) > _ROUNDING
    new = replace(contact, normals=normals if turned else contact.normals, gaps=gaps, slip_reference=reference,
                  allow_interference=True)
    result = discrete.facing(new) if turned else discrete.posing(contact=new)
    return result.posing(stops=stops)
