"""Hierarchy: the same contact problem on a family of grids, coarsest first, nested or not."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy_input import check_total, each, label, limits_of_bisection, need_domain, need_problem, overlaps
from adaptmg.level import Level
from adaptmg.levels import Levels
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.meshed_levels import meshed_levels
from adaptmg.problem import ContactProblem, checks
from adaptmg.runtime.threads import one_blas_thread

if TYPE_CHECKING:
    from adaptmg.transfer import Transfer

__all__ = ["Hierarchy", "Level"]


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
        from adaptmg.transfer.aggregation import aggregated_prolongations

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
