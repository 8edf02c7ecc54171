"""What is checked of an adaptive loop from outside: meshes in plain numpy, values read from results, solutions again.

Part of ``adaptive_campaign.py``. Nothing here uses the estimates' own code, but for the reference's own error.
"""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np

import adaptmg as am
from adaptmg.estimate import Reference, Residual
from adaptmg.mesh import MeshArrays
from adaptmg.transfer import PointLocator

#: of the estimate, that the algebraic error may have
SHARE = 0.1
#: nodes of the reference over those of the last mesh, and at most, by dimension
FINER, MOST = {2: 8, 3: 5}, {2: 24_000, 3: 10_000}


def smallest_angle(mesh: MeshArrays) -> float:
    """The smallest angle of a triangle, in 3D the smallest dihedral angle; degrees."""
    x = mesh.points[mesh.elements]
    worst = 180.0
    if mesh.dim == 2:
        for k in range(3):
            a, b = x[:, (k + 1) % 3] - x[:, k], x[:, (k + 2) % 3] - x[:, k]
            cosine = np.sum(a * b, axis=1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
            worst = min(worst, math.degrees(math.acos(min(cosine.max(), 1.0))))
        return worst
    for i, j in itertools.combinations(range(4), 2):
        k, m = (n for n in range(4) if n not in (i, j))
        edge = x[:, j] - x[:, i]
        one, two = np.cross(edge, x[:, k] - x[:, i]), np.cross(edge, x[:, m] - x[:, i])
        cosine = np.sum(one * two, axis=1) / (np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1))
        worst = min(worst, math.degrees(math.acos(min(cosine.max(), 1.0))))
    return worst


def mesh_faults(mesh: MeshArrays, first: MeshArrays, domain: Any) -> list[str]:
    """What is wrong with a mesh: conformity, orientation, names, size of bodies, nodes off curved boundaries."""
    faults = []
    dim, corners = mesh.dim, mesh.points[mesh.elements]
    volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / math.factorial(dim)
    if not volumes.min() > 0:
        faults.append(f"an element has the volume {volumes.min():.2g}")
    faces = np.concatenate([np.delete(mesh.elements, k, axis=1) for k in range(dim + 1)])
    keys, counts = np.unique(np.sort(faces, axis=1), axis=0, return_counts=True)
    outside = {tuple(face) for face in keys[counts == 1].tolist()}
    named = [tuple(face) for face in np.sort(mesh.facets, axis=1).tolist()]
    if counts.max() > 2:
        faults.append("a facet has three elements")
    if len(set(named)) < len(named) or set(named) != outside:
        faults.append(f"{len(outside)} facets lie outside, {len(set(named))} have names")
    if set(mesh.boundaries) != set(first.boundaries) or mesh.bodies != first.bodies:
        faults.append("names of boundaries or bodies differ")
    if len(np.unique(mesh.elements)) < mesh.n_nodes:
        faults.append("a node has no element")
    flat = np.unique(np.round(mesh.points / np.ptp(mesh.points, axis=0).max(), 13), axis=0)
    if len(mesh.bodies) == 1 and len(flat) < mesh.n_nodes:
        faults.append("two nodes in one place")
    curved = is_curved(domain)
    for body in first.bodies:
        sizes = [m.volumes[m.element_body == m.bodies.index(body)].sum() for m in (first, mesh)]
        if not curved and not abs(sizes[1] - sizes[0]) <= 1e-12 * sizes[0]:
            faults.append(f"{body} has the size {sizes[1]:.15g}, not {sizes[0]:.15g}")
    return faults + (_off_curves(mesh, domain) if curved else [])


def parts_of(domain: Any) -> dict[str, Any]:
    """Bodies by name."""
    return dict(domain.parts) if isinstance(domain, am.Assembly) else {"": domain}


def is_curved(domain: Any) -> bool:
    """Whether a body has arcs or round faces."""
    return any(isinstance(part, am.Outline | am.Revolution) for part in parts_of(domain).values())


def _off_curves(mesh: MeshArrays, domain: Any) -> list[str]:
    """Nodes of arcs that are not on them; the pin's fillet too."""
    faults = []
    for body, part in parts_of(domain).items():
        outline = part.polygon if isinstance(part, am.Revolution) else part
        if not isinstance(outline, am.Outline):
            continue
        for i in outline.arcs:
            name = f"{body}.{outline.boundaries[i]}" if body else outline.boundaries[i]
            points = mesh.points[mesh.boundary_nodes(name)]
            if isinstance(part, am.Revolution):
                points = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
            off = outline.arc(i).distance(points) / outline.arc(i).radius
            if off.max() > 1e-6:
                faults.append(f"{int((off > 1e-6).sum())} of {len(off)} nodes of {name} lie off it, by "
                              f"{off.max():.1g} of its radius")
    return faults


def value_of(quantity: Any, result: am.Result) -> float:
    """A quantity read from a result, not by the code of the goals."""
    mesh, contact = result.mesh, result.contact
    if isinstance(quantity, am.Displacement):
        k = "xyz".index(str(quantity.component))
        body = None if quantity.body is None else mesh.bodies.index(quantity.body)
        found = PointLocator(mesh, body).locate(np.array(quantity.points))
        return float(found.weights[0] @ result.displacement[mesh.elements[found.element[0]], k])
    if isinstance(quantity, am.MeanDisplacement):
        k = "xyz".index(str(quantity.component))
        facets = mesh.boundary_facets(quantity.boundary)
        corners, moved = mesh.points[facets], result.displacement[facets, k]
        if mesh.dim == 3:
            sizes = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
            return float(sizes @ moved.mean(axis=1) / sizes.sum())
        sizes = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
        if not result.stress_data.axisymmetric:
            return float(sizes @ moved.mean(axis=1) / sizes.sum())
        r = corners[:, :, 0]  # Simpson's rule is exact
        product = (r * moved).sum(axis=1) + 4 * r.mean(axis=1) * moved.mean(axis=1)
        return float(sizes @ product / 6 / (sizes @ r.mean(axis=1)))
    mine = contact.boundary == contact.names.index(quantity.boundary)
    if isinstance(quantity, am.Opening):
        return float(contact.weights[mine] @ contact.gap[mine] / contact.weights[mine].sum())
    if quantity.direction == "normal":
        return float(contact.force_n[mine].sum())
    if quantity.direction == "tangential":
        return float(contact.force_t[mine].sum())
    return float(contact.force[mine, "xyz".index(quantity.direction)].sum())


def exact_discrete(step: am.Step) -> am.Result:
    """The discrete solution of a step, by another method, from what the loop found."""
    return am.solve(step.hierarchy, am.ActiveSet(rtol=1e-11, max_steps=40), start=step.result, throw=False)


def a_norm(step: am.Step, displacement: np.ndarray) -> float:
    """Energy norm of a displacement of the step's bodies."""
    discrete = step.hierarchy.finest.discrete
    u = discrete.relative(displacement).reshape(-1)
    return float(np.sqrt(max(u @ (discrete.matrix @ u), 0.0)))


def fine_solution(step: am.Step) -> tuple[am.Hierarchy, am.Result]:
    """A mesh several times finer than a step's, nested in it but for curved boundaries, solved to 1e-9."""
    problem, dim, nodes = step.hierarchy.problem, step.result.dim, step.nodes
    hierarchy, mesh = step.hierarchy, step.hierarchy.finest.mesh
    limit = min(FINER[dim] * nodes, MOST[dim])
    every = am.Estimate(squares=np.ones(len(mesh.elements)), norm=1.0)
    finer = am.Bisect().refine(problem, mesh, every, np.ones(len(mesh.elements), dtype=bool))
    hierarchy = hierarchy.append(finer)
    if finer.n_nodes * 1.5 < limit:
        for last in am.adapt(problem, hierarchy, Residual(), am.Doerfler(0.7), am.Bisect(), max_nodes=limit):
            hierarchy = last.hierarchy
    result = am.solve(hierarchy, am.FullMultigrid(rtol=1e-9), throw=False)
    if not result.status.ok:
        result = am.solve(hierarchy, am.ActiveSet(rtol=1e-9), start=result, throw=False)
    return hierarchy, result


def direct_error(coarse: am.Result, fine: am.Result, hierarchy: am.Hierarchy) -> float:
    """||u_H - u_h||_A on the fine mesh, with u_h interpolated there: exact where it is nested."""
    values = np.zeros_like(fine.displacement)
    for k, _ in enumerate(fine.mesh.bodies):
        nodes = np.unique(fine.mesh.elements[fine.mesh.element_body == k])
        found = PointLocator(coarse.mesh, k).locate(fine.mesh.points[nodes])
        values[nodes] = np.einsum("nk,nkd->nd", found.weights, coarse.displacement[coarse.mesh.elements[found.element]])
    from adaptmg.discrete.elasticity import stiffness
    e = (fine.displacement - values).reshape(-1)
    return float(np.sqrt(e @ (stiffness(fine.mesh, hierarchy.problem.material) @ e)))


def reference_of(fine: tuple[am.Hierarchy, am.Result]) -> Reference:
    """What energy errors are measured against."""
    return Reference.of(*fine)


def bits(step: am.Step) -> bytes:
    """What a step computed."""
    mesh = step.hierarchy.finest.mesh
    parts = [step.result.displacement, step.estimate.squares, mesh.points, mesh.elements, mesh.facets,
             np.array([level.n_nodes for level in step.hierarchy.levels]),
             np.array([step.work_units, step.total_work_units, step.result.rtol, step.estimate.signed or 0.0])]
    return b"".join(np.ascontiguousarray(part).tobytes() for part in parts)
