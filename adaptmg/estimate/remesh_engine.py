"""Remesh: the next mesh of an adaptive loop made anew by Netgen, with sizes that equilibrate the error.

Each mesh is independent of the one before: not nested in it, coarser where the error is small, with nodes on the
curves of the domain. Sizes come from :mod:`adaptmg.estimate.sizes.equilibration`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.sizes.equilibration import NodeCount, equilibrated_sizes, nodal_sizes, simplex_sizes
from adaptmg.estimate.sizes.gradation import resolving
from adaptmg.estimate.sizes.intermediate import mean_sizes
from adaptmg.estimate.sizes.size_field import SizeField
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import ContactProblem, checks

__all__ = ["Remesh"]

# growth of sizes, per distance, that Netgen copes with by dimension; refined meshes grow 2^k times more slowly
_MAX_GRADING = {2: 1.0, 3: 0.6}
# share of the nodes by which a mesh may miss the expected number without being made again
_MISSED = 0.15
# what is aimed at, of the most nodes; how many steps before them are of equal growth, and by which part of a step the
# way may be longer than they go
_BELOW = 0.95
_LAST, _LONGER = 2, 0.2
# growth where sizes fall steeply: by less than this factor in elements with this share of the sum of squares
_SLOW = 2.0
_STEEP, _SHARE = 0.3, 0.33


@dataclass(frozen=True, kw_only=True)
class Remesh:
    """Remeshing by a size field, an engine of :func:`adaptmg.adapt`.

    Parameters
    ----------
    growth : float
        Nodes of the next mesh over those of this one, > 1; at most 2 where elements with a third of the sum of squares
        are to become smaller than .3 of their size: at strong singularities the sizes of a few elements have to follow
        first (bolted junction, 10 000 nodes: 8 % less true error). The last two meshes before ``max_nodes`` grow alike,
        by less or up to a fifth (in the exponent) more, so that the last is neither cut short nor close to that before.
    finest, coarsest : float
        Bounds of new over old size, 0 < ``finest`` < 1 <= ``coarsest``. At strong singularities sizes have to fall by
        4 and more from mesh to mesh; the loop then puts a level between, as multigrid converges slowly above a ratio
        of 4.5. Measured true errors at equal nodes, .1 over .25: .90 to .97 (upset block, flat punch), else equal.
    gradation : float
        Growth of sizes per distance, above 0 and at most 1.
    refinements : int
        Netgen makes a mesh of :math:`2^{-dk}` of the nodes, which is refined k times uniformly. One refinement takes a
        third of the time for up to 11 % more error on coarse meshes (flat punch, 1 000 nodes; none at 26 000, 0 to 6 %
        on dovetail and junction); take 0 for goals. With more, sizes grow more slowly than ``gradation`` says.
    """

    growth: float = 2.5
    finest: float = 0.1
    coarsest: float = 1.5
    gradation: float = 0.3
    refinements: int = 1

    def __post_init__(self) -> None:
        for name in ("growth", "finest", "coarsest", "gradation"):
            object.__setattr__(self, name, checks.positive(name, getattr(self, name)))
        if not self.growth > 1:
            raise ValueError(f"growth must be > 1, got {self.growth!r}")
        if not self.finest < 1 <= self.coarsest:
            raise ValueError(f"finest and coarsest must satisfy 0 < finest < 1 <= coarsest, got {self.finest!r} and "
                             f"{self.coarsest!r}")
        if not self.gradation <= 1:
            raise ValueError(f"gradation must be at most 1, got {self.gradation!r}")
        object.__setattr__(self, "refinements", checks.integer("refinements", self.refinements, 0, 4))

    def refine(self, problem: ContactProblem, mesh: MeshArrays, estimate: Estimate, marked: Any = None,
               max_nodes: int | None = None) -> MeshArrays:
        """The next mesh.

        Parameters
        ----------
        problem : ContactProblem
            With a domain.
        mesh : MeshArrays
            The present mesh.
        estimate : Estimate
            On it.
        marked : ignored
            Sizes follow from all squares of the estimate; engines that refine marked elements have this argument.
        max_nodes : int, optional
            Aimed at are 5 % less; a mesh may miss its number of nodes by 15 %.

        Returns
        -------
        MeshArrays
            Of about ``growth`` times as many nodes; otherwise where ``max_nodes`` is near or ``finest`` says so.

        Raises
        ------
        TypeError, ValueError
            If the problem has no domain, the estimate is not of this mesh, or Netgen fails.
        """
        need_domain(problem)
        checks.instance("mesh", mesh, MeshArrays)
        checks.instance("estimate", estimate, Estimate, "an Estimate")
        wanted = _wanted(mesh.n_nodes, max_nodes, self.growth)
        sizes = self._equilibrated(problem, mesh, estimate, wanted)
        if self.growth > _SLOW and _fall_steeply(mesh, estimate, sizes):
            wanted = _wanted(mesh.n_nodes, max_nodes, _SLOW)
            sizes = self._equilibrated(problem, mesh, estimate, wanted)
        made, expected = self.mesh(problem, SizeField(mesh, sizes)), NodeCount(mesh)(sizes)
        if not abs(made.n_nodes - expected) <= _MISSED * expected:
            # mostly coarse meshes in 3D, which follow sizes badly and cost little
            sizes = self._equilibrated(problem, mesh, estimate, wanted * expected / made.n_nodes)
            again = self.mesh(problem, SizeField(mesh, sizes))
            made = min(made, again, key=lambda new: abs(math.log(new.n_nodes / expected)))
        return made

    def _equilibrated(self, problem: ContactProblem, mesh: MeshArrays, estimate: Estimate, wanted: float
                      ) -> np.ndarray:
        """Sizes (n_nodes,) for a mesh of about the wanted number of nodes, m."""
        sizes = equilibrated_sizes(mesh, estimate.squares, wanted, finest=self.finest, coarsest=self.coarsest,
                                   growth=self._growth(mesh.dim))
        return resolving(mesh, sizes, problem.pair_boundaries, self._growth(mesh.dim))

    def _growth(self, dim: int) -> float:
        """Growth of sizes per distance that the meshes can have."""
        return min(self.gradation, _MAX_GRADING[dim] / 2**self.refinements)

    def intermediate(self, problem: ContactProblem, coarse: MeshArrays, fine: MeshArrays) -> MeshArrays:
        """A mesh between two others, for levels whose sizes differ too much.

        See :mod:`adaptmg.estimate.sizes.intermediate`.

        Parameters
        ----------
        problem : ContactProblem
            With a domain.
        coarse, fine : MeshArrays
            Neighbouring levels, see :func:`adaptmg.transfer.size_ratio`.

        Returns
        -------
        MeshArrays
            Its sizes are the geometric mean of both.
        """
        need_domain(problem)
        return self.mesh(problem, mean_sizes(coarse, fine, self._growth(fine.dim)))

    def mesh(self, problem: ContactProblem, field: SizeField) -> MeshArrays:
        """A mesh of the problem's domain by a size field."""
        from adaptmg.mesh.netgen.resized import PointSizes, resized

        need_domain(problem)
        # a plane mesh that Netgen makes whole is finer than the places of the old nodes
        samples = field.samples(dense=field.mesh.dim == 2 and self.refinements == 0)
        sizes = {body: PointSizes(*given) for body, given in samples.items()}
        return resized(problem.domain, sizes if len(sizes) > 1 else sizes.popitem()[1], refinements=self.refinements,
                       grading=self._growth(field.mesh.dim) * 2**self.refinements)


def need_domain(problem: ContactProblem) -> None:
    """ValueError unless the problem has a domain, of which a new mesh can be made."""
    checks.instance("problem", problem, ContactProblem, "a ContactProblem")
    if problem.domain is None:
        raise ValueError("problem.domain is None: of a mesh of one's own no new one can be made; give the problem a "
                         "domain, or refine its mesh with engine=am.Bisect()")


def _wanted(nodes: int, max_nodes: int | None, growth: float) -> float:
    """Nodes to aim at, after so many."""
    if max_nodes is None:
        return growth * nodes
    aim = _BELOW * checks.integer("max_nodes", max_nodes, 1)
    if aim <= nodes:
        return aim
    steps = max(math.ceil(math.log(aim / nodes) / math.log(growth) - _LONGER), 1)
    return nodes * (growth if steps > _LAST else (aim / nodes) ** (1 / steps))


def _fall_steeply(mesh: MeshArrays, estimate: Estimate, sizes: np.ndarray) -> bool:
    """Whether much of the error lies in elements that are to become much smaller."""
    factors = (sizes / nodal_sizes(mesh, simplex_sizes(mesh)))[mesh.elements].min(axis=1)
    return bool(estimate.squares[factors < _STEEP].sum() > _SHARE * estimate.squares.sum())
