"""Hierarchy: the same contact problem on a family of grids, coarsest first, nested or not.

Levels: the grids of a hierarchy, coarsest first, what they are, and how they become more or fewer.
"""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from adaptmg import _checks as checks
from adaptmg._runtime import one_blas_thread
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.level import (
    Level,
    check_coarse_to_fine,
    check_total,
    each,
    joined,
    label,
    level_of,
    limits_of_bisection,
    meshed_levels,
    need_domain,
    need_problem,
    overlaps,
    the_transfer,
)
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem import ContactProblem

if TYPE_CHECKING:
    from adaptmg.transfer import Transfer

__all__ = ["Hierarchy", "Level", "Levels"]

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


@dataclass(frozen=True, eq=False, repr=False)
class Hierarchy(Levels):
    """Levels, coarsest first, and how they were made. Printing it shows a table.

    ``limits`` says, in words, what more levels of this kind cannot do; it is printed with the table.

    Use the constructors :meth:`uniform`, :meth:`graded`, :meth:`bisected`, :meth:`from_meshes`,
    :meth:`from_prolongations`, :meth:`algebraic`, :meth:`single`; :meth:`append` and :meth:`without` make more and
    fewer levels of one.

    Attributes
    ----------
    levels : tuple of Level
    problem : ContactProblem or None
    origin : str
        How they were made, in words.
    timings : dict of str to float
        Wall time of making them by phase, s: "mesh", "assembly", "transfer". They add up to the whole.
    transfer : Transfer or None
        What built the prolongations between meshes; None for interpolation, or where there are no meshes.
    contact_rows : bool
        Whether the rows of contact nodes were replaced, see :meth:`from_meshes`.
    """

    @classmethod
    def single(cls, discrete: DiscreteProblem) -> Hierarchy:
        """One level, for methods that need no coarse grid."""
        checks.instance("discrete", discrete, DiscreteProblem, "a DiscreteProblem")
        return cls((Level(discrete),), origin="one level")

    @classmethod
    def uniform(cls, problem: ContactProblem, divisions: Sequence[int | tuple[int, ...] | Mapping[str, Any]],
                diagonal: str = "right") -> Hierarchy:
        """Structured grids of a rectangle or box.

        Parameters
        ----------
        problem : ContactProblem
            With a Rectangle or Box as domain.
        divisions : sequence of int, tuple of int or mapping
            Cells along the sides, coarse to fine; nested where each divides the next. Of several bodies also body
            name -> cells.
        diagonal : {"right", "left", "alternating"}
            How squares are cut (2D).

        Raises
        ------
        ValueError
            What :func:`adaptmg.mesh.structured` refuses; levels that together have more than four times the nodes of
            the finest, and millions of them.
        """
        begin = time.perf_counter()
        from adaptmg.mesh import structured
        from adaptmg.mesh.structured import lattice_nodes

        need_domain(problem)
        divisions = each("divisions", divisions, (int, np.integer, Mapping))
        check_total("divisions", [lattice_nodes(problem.domain, n) for n in divisions], problem.dim)
        meshes = [structured(problem.domain, n, diagonal=diagonal) for n in divisions]
        return cls._build(problem, meshes, None, f"uniform {', '.join(map(label, divisions))}", begin)

    @classmethod
    def graded(cls, problem: ContactProblem, sizes: Sequence[float | Mapping[str, float]],
               contact_ratio: float | Mapping[str, float] = 1.0,
               transfer: Transfer | None = None, contact_rows: bool = True) -> Hierarchy:
        """Independent (non-nested) Netgen meshes, graded towards the contact boundaries.

        Parameters
        ----------
        problem : ContactProblem
            With a domain.
        sizes : sequence of float or mapping
            Element size away from contact, coarse to fine, m; of several bodies also body name -> size.
        contact_ratio : float or mapping
            Size away from contact over size at contact, >= 1; of several bodies also body name -> ratio.
        transfer : Transfer, optional
            Default :class:`adaptmg.transfer.Interpolation`.
        contact_rows : bool
            See :meth:`from_meshes`.
        """
        begin = time.perf_counter()
        from adaptmg.mesh import graded

        need_domain(problem)
        sizes = each("sizes", sizes, (float, int, np.number, Mapping))
        meshes = [graded(problem.domain, size, problem.pair_boundaries, contact_ratio) for size in sizes]
        origin = f"graded {', '.join(map(label, sizes))} m, ratio {label(contact_ratio)} at contact"
        return cls._build(problem, meshes, transfer, origin, begin, contact_rows)

    @classmethod
    def bisected(cls, problem: ContactProblem, coarsest: Any, levels: int) -> Hierarchy:
        """Nested meshes: ``coarsest`` refined ``levels`` times by bisection of the elements that touch contact.

        Parameters
        ----------
        problem : ContactProblem
        coarsest : MeshArrays, ngsolve.Mesh or path of a mesh file
        levels : int
            Number of refinements, >= 1; each doubles the elements at contact (3D: four times).

        Notes
        -----
        Elements away from contact stay as they are on every level, and with them their part of the discretisation
        error: after two or three levels it dominates, and further ones only resolve contact (from 531 to 82 000 nodes
        the error of a recorded example falls from 1.40e-3 to 1.36e-3). Printing the hierarchy says so, with the sizes.
        Meshes that follow the whole solution come from :func:`adaptmg.adapt`, :meth:`graded` or :meth:`from_meshes`.

        Warns
        -----
        UserWarning
            If elements away from contact are more than six times as large as those at it: the last levels hardly help.
        """
        begin = time.perf_counter()
        from adaptmg.mesh import as_mesh, refine_near

        need_problem(problem)
        first = as_mesh(coarsest)
        problem.check_boundaries(first.boundaries)
        meshes = refine_near(first, problem.pair_boundaries, checks.integer("levels", levels, 1))
        limits, too_far = limits_of_bisection(meshes, problem.pair_boundaries)
        if too_far:
            warnings.warn(f"bisected, levels={levels}: {limits}. Take fewer levels, a finer coarsest mesh, or meshes "
                          "that follow the whole solution (am.adapt, Hierarchy.graded)", UserWarning, stacklevel=2)
        return cls._build(problem, meshes, None, f"bisected {levels} times near contact", begin, limits=limits)

    @classmethod
    def from_meshes(cls, problem: ContactProblem, meshes: Sequence[Any], transfer: Transfer | None = None,
                    contact_rows: bool = True) -> Hierarchy:
        """From one's own meshes, coarse to fine.

        Parameters
        ----------
        problem : ContactProblem
        meshes : sequence of ngsolve.Mesh, MeshArrays or paths of mesh files (.msh, .vol)
            Checked before use; the boundary names must be those of the problem.
        transfer : Transfer, optional
            Default :class:`adaptmg.transfer.Interpolation`; one's own is any object with ``build(coarse, fine)``.
        contact_rows : bool
            Replace the rows of fine contact nodes by linear interpolation along the coarse contact boundary, whatever
            the transfer does elsewhere: the monotone correction is proven only so (or where the transfer does it).
        """
        begin = time.perf_counter()
        from adaptmg.mesh import as_mesh

        need_problem(problem)
        alone = isinstance(meshes, (MeshArrays, str, os.PathLike)) or hasattr(meshes, "ngmesh")
        arrays = [as_mesh(mesh) for mesh in each("meshes", (meshes,) if alone else meshes, ())]
        return cls._build(problem, arrays, transfer, "given meshes", begin, contact_rows)

    @classmethod
    def from_prolongations(cls, discrete: DiscreteProblem, prolongations: Sequence[Any]) -> Hierarchy:
        """From one's own matrix and coarse spaces, with Galerkin matrices; no contact problem on the coarse levels.

        Parameters
        ----------
        discrete : DiscreteProblem
            On the finest level.
        prolongations : sequence of sparse matrices
            Coarse to fine, each from a level to the next finer: all of nodes (n_nodes, n_nodes coarse), acting on every
            component, or all of dofs (n_dofs, n_dofs coarse).
        """
        from adaptmg.transfer.galerkin import coarse_spaces

        checks.instance("discrete", discrete, DiscreteProblem, "a DiscreteProblem")
        begin = time.perf_counter()
        given, matrices = coarse_spaces(discrete.matrix, discrete.fixed, prolongations)
        levels = [Level(None, None, P, galerkin=A) for P, A in zip([None, *given[:-1]], matrices, strict=True)]
        levels.append(Level(discrete, None, given[-1]))
        return cls(tuple(levels), None, "given prolongations", {"transfer": time.perf_counter() - begin})

    @classmethod
    def algebraic(cls, discrete: DiscreteProblem, strength: float = 0.0, max_coarse: int = 300) -> Hierarchy:
        """Coarse spaces by smoothed aggregation (pyamg), for a bare matrix.

        Parameters
        ----------
        discrete : DiscreteProblem
            Its ``near_nullspace`` matters: with rigid-body modes convergence is about twice as fast.
        strength : float
            Drop tolerance of the strength of connection, 0 <= strength < 1.
        max_coarse : int
            Dofs of the coarsest level at most.
        """
        from adaptmg.transfer.galerkin import aggregated_prolongations

        checks.instance("discrete", discrete, DiscreteProblem, "a DiscreteProblem")
        begin = time.perf_counter()
        strength = checks.nonnegative("strength", strength)
        if not strength < 1:
            raise ValueError(f"strength must be < 1, got {strength!r}")
        found = aggregated_prolongations(discrete.matrix, discrete.near_nullspace, discrete.fixed, strength=strength,
                                         max_coarse=checks.integer("max_coarse", max_coarse, 1))
        if not found:
            raise ValueError(f"the matrix has {discrete.n_dofs} rows, no more than max_coarse={max_coarse}: there is "
                             "nothing to coarsen; use SingleGrid or ActiveSet, or a smaller max_coarse")
        made = cls.from_prolongations(discrete, found)
        return cls(made.levels, None, "smoothed aggregation", {"transfer": time.perf_counter() - begin})

    @classmethod
    @one_blas_thread()
    def _build(cls, problem: ContactProblem, meshes: list[MeshArrays], transfer: Transfer | None, origin: str,
               begin: float, contact_rows: bool = True, limits: str = "") -> Hierarchy:
        for words in overlaps(problem, meshes[-1]):
            warnings.warn(words, UserWarning, stacklevel=4)
        levels, timings = meshed_levels(problem, meshes, transfer, contact_rows, begin)
        return cls(levels, problem, origin, timings, limits, transfer, contact_rows)
