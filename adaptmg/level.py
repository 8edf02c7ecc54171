"""Level: one grid of a hierarchy, with the problem on it and the prolongation from the next coarser one.

Levels made of meshes: the problem on each, and the prolongation from each to the next finer.

What the constructors of a hierarchy are given: checked, and in words.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, pairwise, product
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from adaptmg import _check_arrays as check_arrays
from adaptmg import _checks as checks
from adaptmg._check_arrays import indices_frozen
from adaptmg._runtime import OnDemand, made_on_demand
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.netgen_guard import MAX_NODES
from adaptmg.problem import ContactPair, ContactProblem

if TYPE_CHECKING:
    from adaptmg.transfer import Transfer

__all__ = ["Level", "check_coarse_to_fine", "check_total", "each", "joined", "label", "level_of", "limits_of_bisection",
           "meshed_levels", "need_domain", "need_problem", "overlaps", "ratio_to", "the_transfer"]

@dataclass(frozen=True, eq=False)
class Level:
    """One grid.

    Attributes
    ----------
    discrete : DiscreteProblem or None
        The problem discretised on this grid; None where only a coarse space is known.
    mesh : MeshArrays or None
    prolongation : csr_array or None
        Nodal values from the next coarser level (n_nodes, n_nodes coarse), or, between coarse spaces, its dofs
        (n_dofs, n_dofs coarse); None on the coarsest.
    mesh_ratio : float
        Largest local ratio of mesh sizes, next coarser over this; NaN if unknown. Found when first read.
    galerkin : bsr_array or None
        The matrix of a coarse space without a discrete problem.
    surface_prolongation : csr_array or None
        With bodies in contact: the prolongation whose contact rows are >= 0 with sums 1, for corrections that need
        it (:mod:`adaptmg.transfer.contact_rows`).
    """

    discrete: DiscreteProblem | None
    mesh: MeshArrays | None = None
    prolongation: sparse.csr_array | None = None
    mesh_ratio: float = float("nan")
    galerkin: sparse.bsr_array | None = None
    surface_prolongation: sparse.csr_array | None = None

    def __post_init__(self) -> None:
        if self.discrete is not None:
            checks.instance("discrete", self.discrete, DiscreteProblem, "a DiscreteProblem or None")
        elif not (sparse.issparse(self.galerkin) and self.galerkin.format == "bsr"):
            raise TypeError("galerkin must be a bsr_array where there is no discrete problem, got "
                            f"{checks.described(self.galerkin)}")
        if self.galerkin is not None:
            rows, columns = check_arrays.sparse_matrix("galerkin", self.galerkin).shape
            if rows != columns:
                raise ValueError(f"galerkin must be square, got {(rows, columns)}")
            object.__setattr__(self, "galerkin", indices_frozen(self.galerkin))
        if self.mesh is not None:
            checks.instance("mesh", self.mesh, MeshArrays, "MeshArrays or None; adaptmg.mesh.as_mesh converts")
        for name in ("prolongation", "surface_prolongation"):
            value = getattr(self, name)
            if value is not None:
                value = check_arrays.sparse_matrix(name, value)
                as_csr = isinstance(value, sparse.csr_array) and value.dtype == np.float64
                value = value if as_csr else sparse.csr_array(value, dtype=np.float64)
                object.__setattr__(self, name, indices_frozen(value))

    def posing(self, discrete: DiscreteProblem) -> Level:
        """The level with the data of a load step; nothing else is read or made."""
        result = copy.copy(self)
        object.__setattr__(result, "discrete", discrete)
        return result

    @property
    def known_ratio(self) -> float:
        """``mesh_ratio`` if somebody has asked for it before, else NaN."""
        held = self.__dict__["mesh_ratio"]
        return float("nan") if isinstance(held, OnDemand) else held

    @property
    def contact_prolongation(self) -> sparse.csr_array | None:
        """The form of the prolongation for corrections that carry constraints to the coarse contact nodes."""
        return self.prolongation if self.surface_prolongation is None else self.surface_prolongation

    @property
    def matrix(self) -> sparse.bsr_array:
        """The discretised matrix, or the Galerkin one of a coarse space."""
        return self.galerkin if self.discrete is None else self.discrete.matrix

    @property
    def n_nodes(self) -> int:
        """Nodes; of a coarse space the rows of blocks of its matrix."""
        return self.matrix.shape[0] // self.matrix.blocksize[0]


Level.mesh_ratio = made_on_demand("mesh_ratio", "Largest local ratio of mesh sizes, next coarser over this; or NaN.")


def ratio_to(coarse: MeshArrays, level: Level) -> float:
    """Largest local ratio of mesh sizes, those of ``coarse`` over those of the level."""
    from adaptmg.transfer import mesh_ratio

    return mesh_ratio(coarse, level.mesh)


def the_transfer(transfer: Transfer | None) -> Transfer:
    """A transfer, checked; interpolation for None."""
    from adaptmg.transfer import Interpolation

    transfer = Interpolation() if transfer is None else transfer
    return checks.offers("transfer", transfer, "build", "a transfer, which offers build(coarse, fine) -> sparse matrix")


def level_of(problem: ContactProblem, mesh: MeshArrays) -> Level:
    """The problem on a mesh."""
    from adaptmg.discrete.discretise import discretise

    return Level(discretise(problem, mesh), mesh)


def joined(below: Level, above: Level, transfer: Transfer, contact_rows: bool) -> Level:
    """The level ``above`` with its prolongation from ``below``, whatever was below it before."""
    from adaptmg.transfer.contact_rows import between_levels

    found = between_levels(transfer, below.mesh, above.mesh, below.discrete, above.discrete, contact_rows)
    return replace(above, prolongation=found.prolongation, surface_prolongation=found.surface,
                   mesh_ratio=OnDemand(partial(ratio_to, below.mesh)))


def meshed_levels(problem: ContactProblem, meshes: Sequence[MeshArrays], transfer: Transfer | None,
                  contact_rows: bool, begin: float) -> tuple[tuple[Level, ...], dict[str, float]]:
    """Levels of a problem on meshes, coarse to fine, and the seconds they took by phase since ``begin``."""
    transfer = the_transfer(transfer)
    checks.flag("contact_rows", contact_rows)
    check_coarse_to_fine(meshes)
    meshed = time.perf_counter()
    levels = [level_of(problem, mesh) for mesh in meshes]
    assembled = time.perf_counter()
    for k in range(1, len(levels)):
        levels[k] = joined(levels[k - 1], levels[k], transfer, contact_rows)
    timings = {"mesh": meshed - begin, "assembly": assembled - meshed, "transfer": time.perf_counter() - assembled}
    return tuple(levels), timings


# elements away from contact this many times as large as those at it: about what two halvings more than theirs make
_FAR_APART = 6


def limits_of_bisection(meshes: Sequence[MeshArrays], boundaries: Sequence[str]) -> tuple[str, bool]:
    """Words on what bisection near contact leaves: the elements that no level has touched, and what they do."""
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
    from adaptmg.mesh.soundness import overlapping_bodies

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
