"""Levels: the grids of a hierarchy, coarsest first, what they are, and how they become more or fewer."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any, Self

import numpy as np

from adaptmg.hierarchy_input import check_coarse_to_fine, need_problem
from adaptmg.level import Level
from adaptmg.meshed_levels import joined, level_of, the_transfer
from adaptmg.problem import ContactProblem, checks
from adaptmg.runtime.threads import one_blas_thread

__all__ = ["Levels"]


@dataclass(frozen=True, eq=False)
class Levels:
    """Levels, coarsest first; :class:`adaptmg.Hierarchy` says how they are made.

    Attributes
    ----------
    levels : tuple of Level
    problem : ContactProblem or None
    origin : str
        How they were made, in words.
    timings : dict of str to float
        Wall time of making them by phase, s: "mesh", "assembly", "transfer". They add up to the whole.
    limits : str
        What more levels of this kind cannot do, in words.
    transfer : Transfer or None
        What built the prolongations between meshes; None where they were not made of meshes.
    contact_rows : bool
        Whether the rows of contact nodes were replaced, see :meth:`adaptmg.Hierarchy.from_meshes`.
    """

    levels: tuple[Level, ...]
    problem: ContactProblem | None = None
    origin: str = "levels"
    timings: dict[str, float] = field(default_factory=dict)
    limits: str = ""
    transfer: Any = None
    contact_rows: bool = True

    def __post_init__(self) -> None:
        levels = checks.items("levels", self.levels, Level, "Level(...)")
        if not levels:
            raise ValueError("levels is empty: a hierarchy needs at least one level")
        if self.problem is not None:
            need_problem(self.problem)
        for k, (coarse, fine) in enumerate(pairwise(levels), start=1):
            wanted = (fine.n_nodes, coarse.n_nodes)
            if coarse.discrete is None and coarse.matrix.blocksize[0] == 1:
                wanted = (fine.matrix.shape[0], coarse.matrix.shape[0])
            if fine.prolongation is None or fine.prolongation.shape != wanted:
                got = None if fine.prolongation is None else fine.prolongation.shape
                raise ValueError(f"levels[{k}].prolongation must have shape {wanted} (fine, coarse), got {got}")
            if fine.surface_prolongation is not None and fine.surface_prolongation.shape != wanted:
                raise ValueError(f"levels[{k}].surface_prolongation must have shape {wanted} (fine, coarse), got "
                                 f"{fine.surface_prolongation.shape}")
        if levels[-1].discrete is None:
            raise ValueError("the finest level has no DiscreteProblem")
        object.__setattr__(self, "levels", levels)

    def __len__(self) -> int:
        return len(self.levels)

    def __getitem__(self, index: int) -> Level:
        return self.levels[index]

    @property
    def finest(self) -> Level:
        """The finest level."""
        return self.levels[-1]

    @property
    def discretised(self) -> bool:
        """Whether every level poses the contact problem; if not, only ``Truncated`` without nested start can use it."""
        return all(level.discrete is not None for level in self.levels)

    def need_discretised(self, what: str) -> None:
        """ValueError unless every level poses the contact problem."""
        if not self.discretised:
            raise ValueError(f"grids: {what} needs the contact problem on every level, but the coarse levels of this "
                             f"hierarchy ({self.origin}) are only spaces; use am.Multigrid(correction=am.Truncated())")

    def truncated(self, *, coarsest: int = 0, finest: int | None = None) -> Self:
        """The levels ``coarsest`` .. ``finest`` (inclusive; default: the last) as a hierarchy of their own."""
        finest = len(self) - 1 if finest is None else checks.integer("finest", finest)
        if not 0 <= checks.integer("coarsest", coarsest) <= finest < len(self):
            raise ValueError(f"coarsest and finest must satisfy 0 <= {coarsest} <= {finest} < {len(self)}")
        first, *rest = self.levels[coarsest:finest + 1]
        first = Level(first.discrete, first.mesh, galerkin=first.galerkin)
        return replace(self, levels=(first, *rest), timings=dict(self.timings))

    # -- more of them, or fewer ---------------------------------------------------------------------------------

    @one_blas_thread()
    def append(self, mesh: Any) -> Self:
        """With one finer mesh; nothing of the levels that are there is assembled or located anew.

        Parameters
        ----------
        mesh : MeshArrays, ngsolve.Mesh or path of a mesh file
            With more nodes than the finest one. It need not be nested; one that is known to be sound is not checked.

        Returns
        -------
        Hierarchy
            The same as :meth:`adaptmg.Hierarchy.from_meshes` makes of all meshes; ``self`` stays what it is.

        Raises
        ------
        ValueError
            If the levels are not made of meshes, or the mesh has no more nodes than the finest.
        """
        from adaptmg.mesh import as_mesh

        begin = time.perf_counter()
        self._need_meshes("append")
        fine = as_mesh(mesh)
        check_coarse_to_fine([self.finest.mesh, fine])
        meshed = time.perf_counter()
        new, assembled = level_of(self.problem, fine), time.perf_counter()
        new = joined(self.finest, new, the_transfer(self.transfer), self.contact_rows)
        spent = {"mesh": meshed - begin, "assembly": assembled - meshed, "transfer": time.perf_counter() - assembled}
        return replace(self, levels=(*self.levels, new), timings=_sum(self.timings, spent), origin=_grown(self.origin))

    @one_blas_thread()
    def without(self, level: int) -> Self:
        """Without one of the levels; only the prolongation between its two neighbours is built.

        Parameters
        ----------
        level : int
            0 is the coarsest; the finest cannot go.

        Returns
        -------
        Hierarchy

        Raises
        ------
        ValueError
            If it is the finest, or there is none of this number, or the levels are not made of meshes.
        """
        begin = time.perf_counter()
        if not 0 <= checks.integer("level", level) < len(self) - 1:
            raise ValueError(f"level must satisfy 0 <= level < {len(self) - 1} (the finest stays), got {level}")
        if level == 0:
            return self.truncated(coarsest=1)
        self._need_meshes("without")
        above = joined(self.levels[level - 1], self.levels[level + 1], the_transfer(self.transfer), self.contact_rows)
        kept = (*self.levels[:level], above, *self.levels[level + 2:])
        return replace(self, levels=kept, timings=_sum(self.timings, {"transfer": time.perf_counter() - begin}))

    def _need_meshes(self, what: str) -> None:
        if self.problem is None or any(level.mesh is None or level.discrete is None for level in self.levels):
            raise ValueError(f"{what}: these levels ({self.origin}) are not made of meshes of a ContactProblem; make "
                             "them with Hierarchy.from_meshes, graded or uniform")

    # -- what it is ---------------------------------------------------------------------------------------------

    @property
    def grid_complexity(self) -> float:
        """Nodes on all levels over nodes on the finest."""
        return sum(level.n_nodes for level in self.levels) / self.finest.n_nodes

    @property
    def operator_complexity(self) -> float:
        """Nonzeros of the discretised matrices on all levels over those of the finest."""
        return sum(level.matrix.nnz for level in self.levels) / self.finest.matrix.nnz

    def table(self, *, ratios: bool = True) -> list[dict[str, float]]:
        """One dict a level: level, nodes, contact_nodes, nonzeros, mesh_ratio (to the next coarser level).

        Mesh ratios take time the first time; ``ratios=False`` leaves those out (NaN) that nobody has asked for.
        """
        return [{"level": k, "nodes": level.n_nodes,
                 "contact_nodes": 0 if level.discrete is None else len(level.discrete.contact),
                 "nonzeros": level.matrix.nnz, "mesh_ratio": level.mesh_ratio if ratios else level.known_ratio}
                for k, level in enumerate(self.levels)]

    def __repr__(self) -> str:
        name = self.problem.name if self.problem is not None else self.finest.discrete.name
        lines = [f"Hierarchy of {len(self)} levels ({self.origin}) for {name}",
                 f"{'level':>5} {'nodes':>9} {'contact':>8} {'nonzeros':>11} {'h ratio':>8}"]
        for row in self.table():
            ratio = "-" if np.isnan(row["mesh_ratio"]) else f"{row['mesh_ratio']:.2f}"
            lines.append(f"{row['level']:>5} {row['nodes']:>9} {row['contact_nodes']:>8} {row['nonzeros']:>11} "
                         f"{ratio:>8}")
        lines.append(f"grid complexity {self.grid_complexity:.3f}, "
                     f"operator complexity (discretised) {self.operator_complexity:.3f}")
        return "\n".join(lines + [self.limits] * bool(self.limits))


def _sum(a: dict[str, float], b: dict[str, float]) -> dict[str, float]:
    return {name: a.get(name, 0.0) + b.get(name, 0.0) for name in {**a, **b}}


def _grown(origin: str) -> str:
    return origin if origin.endswith(", grown") else f"{origin}, grown"
