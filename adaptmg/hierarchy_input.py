"""What the constructors of a hierarchy are given: checked, and in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations, pairwise, product
from typing import Any

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.limits import MAX_NODES
from adaptmg.problem import ContactPair, ContactProblem, checks

__all__ = ["check_coarse_to_fine", "check_total", "each", "label", "limits_of_bisection", "need_domain", "need_problem",
           "overlaps"]


# elements away from contact this many times as large as those at it: about what two halvings more than theirs make
_FAR_APART = 6


def limits_of_bisection(meshes: Sequence[MeshArrays], boundaries: Sequence[str]) -> tuple[str, bool]:
    """Words on what bisection near contact leaves: the elements that no level has touched, and what they do.

    Parameters
    ----------
    meshes : sequence of MeshArrays
        Coarse to fine.
    boundaries : sequence of str
        Contact.

    Returns
    -------
    words : str
    too_far : bool
        Whether the elements left are so large that further levels hardly help.
    """
    first, last = meshes[0].element_sizes, meshes[-1]
    contact = np.unique(np.concatenate([last.boundary_nodes(name) for name in boundaries]))
    near = np.isin(last.elements, contact).any(axis=1)
    bulk, fine = float(last.element_sizes.max()), float(last.element_sizes[near].max())
    kept = float(last.volumes[last.element_sizes >= 0.5 * first.max()].sum() / last.volumes.sum())
    words = (f"limits: only elements at contact are refined (to {fine:.3g} m); away from it {100 * kept:.0f} % of the "
             f"domain keeps elements of up to {bulk:.3g} m")
    too_far = bulk > _FAR_APART * fine
    return words + (": their part of the error stays, and more levels hardly help" if too_far else ""), too_far


def need_problem(problem: ContactProblem) -> None:
    """TypeError unless it is a ContactProblem."""
    checks.instance("problem", problem, ContactProblem, "a ContactProblem")


def each(name: str, value: Any, one: tuple[type, ...]) -> tuple[Any, ...]:
    """A sequence with a value a level; an instance of ``one`` stands for one level."""
    if isinstance(value, one) and not isinstance(value, bool):
        return (value,)
    values = checks.listed(name, value, "values, one a level, coarse to fine")
    if not values:
        raise ValueError(f"{name} is empty: no meshes; give at least one, coarse to fine")
    return values


def need_domain(problem: ContactProblem) -> None:
    """ValueError unless the problem has a domain to mesh."""
    need_problem(problem)
    if problem.domain is None:
        raise ValueError("problem.domain is None: give the problem a domain, or meshes with Hierarchy.from_meshes")


def check_coarse_to_fine(meshes: Sequence[MeshArrays]) -> None:
    """ValueError unless each mesh has more nodes than the one before."""
    sizes = [mesh.n_nodes for mesh in meshes]
    if any(a >= b for a, b in pairwise(sizes)):
        raise ValueError(f"meshes must go from coarse to fine; they have {sizes} nodes")


def check_total(name: str, nodes: Sequence[int], dim: int) -> None:
    """ValueError if levels that hardly get finer would take memory and time that the finest does not."""
    most = max(MAX_NODES[dim], 4 * max(nodes))
    if sum(nodes) > most:
        raise ValueError(f"{name} must make at most {most:.3g} nodes in all, got {sum(nodes):.3g} on {len(nodes)} "
                         f"levels, {max(nodes):.3g} on the finest: leave levels out (halving the divisions is usual)")


def overlaps(problem: ContactProblem, mesh: MeshArrays) -> list[str]:
    """Words on bodies that lie in each other and are no pair; in axisymmetry that is how a ring of bolts is posed."""
    from adaptmg.mesh.checks.overlap import overlapping_bodies

    if problem.axisymmetric or len(mesh.bodies) < 2:
        return []
    body = np.zeros(mesh.n_nodes, dtype=np.int64)
    body[mesh.elements] = mesh.element_body[:, None]
    of = {name: set(body[mesh.boundary_nodes(name)].tolist()) for name in mesh.boundaries}
    paired = {frozenset(ends) for pair in problem.contact if isinstance(pair, ContactPair)
              for ends in product(of.get(pair.slave, ()), of.get(pair.master, ()))}
    apart = [ends for ends in combinations(np.unique(mesh.element_body).tolist(), 2) if frozenset(ends) not in paired]
    return [f"the bodies {mesh.bodies[a]!r} and {mesh.bodies[b]!r} lie in each other, at {x.round(9).tolist()} among "
            "other places, and are not a contact pair: nothing keeps them apart. Move one of them, or declare an "
            "am.ContactPair" for a, b, x in overlapping_bodies(mesh, apart)]


def label(value: Any) -> str:
    """A size, a ratio or divisions in words: a number, some, or by body."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{body}: {label(part)}" for body, part in value.items()) + "}"
    return f"{value:g}" if isinstance(value, float) else str(value)
