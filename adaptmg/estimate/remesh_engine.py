"""Remesh: the next mesh of an adaptive loop made anew by Netgen, with sizes that equilibrate the error.

Each mesh is independent of the one before: not nested in it, coarser where the error is small, with nodes on the
curves of the domain. Sizes come from :mod:`adaptmg.estimate.sizes.equilibration`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from adaptmg.estimate.estimate import Estimate
from adaptmg.estimate.sizes.equilibration import NodeCount, equilibrated_sizes
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

@dataclass(frozen=True, kw_only=True)
class Remesh:
    """Remeshing by a size field, an engine of :func:`adaptmg.adapt`.

    Parameters
    ----------
    growth : float
        Nodes of the next mesh over those of this one, > 1. The last two meshes before ``max_nodes`` grow alike, by less
        or up to a fifth (in the exponent) more, so that the last is neither cut short nor preceded by one of its size.
    finest, coarsest : float
        Bounds of new over old size, 0 < ``finest`` < 1 <= ``coarsest``. At strong singularities sizes have to fall by
        4 and more from mesh to mesh; the loop then puts a level between, as multigrid converges slowly above a ratio
        of 4. Measured true errors at equal nodes, .1 over .25: .90 to .97 (upset block, flat punch), else equal.
    gradation : float
        Growth of sizes per distance, above 0 and at most 1.
    refinements : int
        Netgen makes a mesh of :math:`2^{-dk}` of the nodes, which is refined k times uniformly: with one refinement
        three times cheaper and as good; with more, sizes grow more slowly than ``gradation`` says.
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
        wanted = self._wanted(mesh.n_nodes, max_nodes)
        made, expected = self._equilibrated(problem, mesh, estimate, wanted)
        if not abs(made.n_nodes - expected) <= _MISSED * expected:
            # mostly coarse meshes in 3D, which follow sizes badly and cost little
            again, _ = self._equilibrated(problem, mesh, estimate, wanted * expected / made.n_nodes)
            made = min(made, again, key=lambda new: abs(math.log(new.n_nodes / expected)))
        return made

    def _wanted(self, nodes: int, max_nodes: int | None) -> float:
        """Nodes to aim at, after so many."""
        if max_nodes is None:
            return self.growth * nodes
        aim = _BELOW * checks.integer("max_nodes", max_nodes, 1)
        if aim <= nodes:
            return aim
        steps = max(math.ceil(math.log(aim / nodes) / math.log(self.growth) - _LONGER), 1)
        return nodes * (self.growth if steps > _LAST else (aim / nodes) ** (1 / steps))

    def _equilibrated(self, problem: ContactProblem, mesh: MeshArrays, estimate: Estimate, wanted: float
                      ) -> tuple[MeshArrays, float]:
        """A mesh of about the wanted number of nodes, and how many were expected from its sizes."""
        sizes = equilibrated_sizes(mesh, estimate.squares, wanted, finest=self.finest, coarsest=self.coarsest,
                                   growth=self._growth(mesh.dim))
        sizes = resolving(mesh, sizes, problem.pair_boundaries, self._growth(mesh.dim))
        return self.mesh(problem, SizeField(mesh, sizes)), NodeCount(mesh)(sizes)

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
