"""Grids: levels, coarsest first, with the prolongations between them, as every method takes them.

Levels of a matrix are made here, levels of meshes in :mod:`adaptmg.hierarchy`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Self

from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._numba import clock
from adaptmg._text import html_table, in_html_lines, shortened
from adaptmg._threads import one_blas_thread
from adaptmg._units import lengths_in_units
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.level import Level, check_problem, joined, the_transfer
from adaptmg.problem import ContactProblem
from adaptmg.problem.contact_problem import for_problem

if TYPE_CHECKING:
    from adaptmg.transfer import Transfer


@dataclass(frozen=True, eq=False, repr=False)
class Grids:
    """Levels, coarsest first, and how they were made, with the attributes of
    :class:`adaptmg.Hierarchy`, which also makes levels of meshes."""

    levels: tuple[Level, ...]
    # Any: a ScalarProblem; only those of a given matrix need the test for None
    problem: ContactProblem | Any = None
    origin: str = "levels"
    timings: dict[str, float] = field(default_factory=dict, compare=False)  # seconds by phase
    transfer: Transfer | None = None
    contact_rows: bool = True

    def __post_init__(self) -> None:
        levels = checks.items("levels", self.levels, Level, "Level(...)")
        if not levels:
            raise ValueError("levels is empty: a hierarchy needs at least one level")
        if self.problem is not None:
            check_problem(self.problem)
        for k, (coarse, fine) in enumerate(pairwise(levels), start=1):
            if not fine.complete:
                continue  # its prolongation is made of these levels when it is read
            shape = (fine.n_nodes, coarse.n_nodes)
            # coarse spaces of dofs, not of nodes
            if not coarse.discretised and coarse.matrix.blocksize[0] == 1:
                shape = (checks.shape_of(fine.matrix)[0], checks.shape_of(coarse.matrix)[0])
            prolongations = {"prolongation": fine.prolongation_or_none}
            if fine.surface_prolongation is not None:
                prolongations["surface_prolongation"] = fine.surface_prolongation
            for name, matrix in prolongations.items():
                if matrix is None or matrix.shape != shape:
                    raise ValueError(
                        f"levels[{k}].{name} must have shape {shape} (fine, coarse), got "
                        f"{None if matrix is None else matrix.shape}"
                    )
        if not levels[-1].discretised:
            raise ValueError("the finest level has no DiscreteProblem")
        object.__setattr__(self, "levels", levels)

    @classmethod
    def single(cls, discrete: DiscreteProblem) -> Self:
        """Return a hierarchy of one level, for methods that need no coarse grid."""
        checks.instance("discrete", discrete, DiscreteProblem, "a DiscreteProblem")
        return cls((Level(discrete),), origin="one level")

    @classmethod
    def from_prolongations(
        cls,
        discrete: DiscreteProblem,
        prolongations: Sequence[sparse.csr_array],
        contact: bool = False,
    ) -> Self:
        """Return a hierarchy of a user's matrix and coarse spaces, with Galerkin matrices.

        Parameters
        ----------
        discrete : DiscreteProblem
            On the finest level.
        prolongations : sequence of sparse matrices
            Coarse to fine, each from a level to the next finer: all of nodes (n_nodes, n_nodes
            coarse), acting on every component, or all of dofs (n_dofs, n_dofs coarse).
        contact : bool
            Pose the contact problem on the coarse levels too, which a nested start and ``Monotone``
            need: gaps of coarse nodes are the smallest over the contact nodes that they reach
            (:func:`adaptmg.transfer.contact.restricted_problem`). Prolongations are then of nodes,
            with weights >= 0 at contact nodes.
        """
        from adaptmg.transfer.contact import restricted_problem
        from adaptmg.transfer.galerkin import coarse_spaces

        checks.instance("discrete", discrete, DiscreteProblem, "a DiscreteProblem")
        checks.flag("contact", contact)
        begin = clock()
        checked, matrices = coarse_spaces(
            discrete.decoupled_rows.matrix, discrete.fixed, prolongations
        )
        levels = [Level(discrete, None, checked[-1])]
        # coarse levels k, the finest of them first; checked[k] leads from level k to the next finer one
        for k in reversed(range(len(checked))):
            problem = (
                restricted_problem(levels[0].discrete, checked[k], matrices[k]) if contact else None
            )
            from_coarser = checked[k - 1] if k > 0 else None
            levels.insert(0, Level(problem, None, from_coarser, galerkin=matrices[k]))
        return cls(tuple(levels), None, "given prolongations", {"transfer": clock() - begin})

    @classmethod
    def algebraic(
        cls, discrete: DiscreteProblem, max_coarse: int = 300, contact: bool = False
    ) -> Self:
        """Return coarse spaces by smoothed aggregation (pyamg), for a bare matrix.

        Parameters
        ----------
        discrete : DiscreteProblem
            Its ``near_nullspace`` matters: with rigid-body modes convergence is about twice as
            fast.
        max_coarse : int
            Nodes (rows of blocks) of the coarsest level at most.
        contact : bool
            As in :meth:`from_prolongations`, for scalar problems.
        """
        from adaptmg.transfer.galerkin import aggregated_prolongations

        checks.instance("discrete", discrete, DiscreteProblem, "a DiscreteProblem")
        begin = clock()
        prolongations = aggregated_prolongations(
            discrete.decoupled_rows.matrix,
            discrete.near_nullspace,
            discrete.fixed,
            checks.integer("max_coarse", max_coarse, 1),
        )
        if not prolongations:
            raise ValueError(
                f"max_coarse must be below {discrete.n_nodes}, the number of nodes, got {max_coarse}: "
                "there is nothing to coarsen"
            )
        levels = cls.from_prolongations(discrete, prolongations, contact).levels
        return cls(levels, None, "smoothed aggregation", {"transfer": clock() - begin})

    def __len__(self) -> int:
        return len(self.levels)

    def __getitem__(self, index: int) -> Level:
        return self.levels[index]

    @property
    def finest(self) -> Level:
        """Return the finest level."""
        return self.levels[-1]

    @property
    def posed(self) -> Posed | None:
        """Return the contact problem on the finest mesh; None for scalar problems, and for a
        hierarchy that comes from matrices."""
        return self.posed_on(self.finest)

    def posed_on(self, level: Level) -> Posed | None:
        """Return the problem on the mesh of one of the levels, if there are both."""
        mesh = level.mesh
        if not isinstance(self.problem, ContactProblem) or mesh is None or not level.discretised:
            return None
        posed = level.posed
        alike = posed is not None and posed.problem is self.problem
        return posed if alike else Posed(self.problem, mesh)

    @cached_property
    def discretised(self) -> bool:
        """Return whether every level poses the contact problem; else only ``Truncated`` without
        nested start serves."""
        return all(level.discretised for level in self.levels)

    def need_discretised(self, what: str) -> None:
        """Raise ValueError unless every level poses the contact problem."""
        if not self.discretised:
            raise ValueError(
                f"grids: {what} needs the contact problem on every level, but the coarse levels of this "
                f"hierarchy ({self.origin}) are only spaces; use am.Multigrid(correction=am.Truncated())"
            )

    def truncated(self, *, coarsest: int = 0, finest: int | None = None) -> Self:
        """Return a hierarchy of the levels ``coarsest`` .. ``finest`` (inclusive; default: the
        last)."""
        finest = len(self) - 1 if finest is None else checks.integer("finest", finest)
        if not 0 <= checks.integer("coarsest", coarsest) <= finest < len(self):
            raise ValueError(
                f"coarsest and finest must satisfy 0 <= {coarsest} <= {finest} < {len(self)}"
            )
        first, *rest = self.levels[coarsest : finest + 1]
        first = first.posing(prolongation=None, surface_prolongation=None)
        return replace(self, levels=(first, *rest))

    @one_blas_thread()
    def without(self, level: int) -> Self:
        """Return the hierarchy without a level; only the prolongation between its two neighbours is
        built.

        ``level`` 0 is the coarsest. ValueError for the finest, and if the levels are not made of
        meshes."""
        begin = clock()
        if not 0 <= checks.integer("level", level) < len(self) - 1:
            raise ValueError(
                f"level must satisfy 0 <= level < {len(self) - 1} (the finest stays), got {level}"
            )
        if level == 0:
            return self.truncated(coarsest=1)
        self._need_meshes("without")
        above = joined(
            self.levels[level - 1],
            self.levels[level + 1],
            the_transfer(self.transfer),
            self.contact_rows,
        )
        levels = (*self.levels[:level], above, *self.levels[level + 2 :])
        return replace(
            self, levels=levels, timings=self._timings_with({"transfer": clock() - begin})
        )

    def _timings_with(self, seconds: dict[str, float]) -> dict[str, float]:
        """Return the timings with further seconds by phase."""
        return {
            name: self.timings.get(name, 0.0) + seconds.get(name, 0.0)
            for name in {**self.timings, **seconds}
        }

    def _need_meshes(self, what: str) -> None:
        """Raise ValueError unless all levels are made of meshes."""
        if self.problem is None or any(
            level.mesh is None or not level.discretised for level in self.levels
        ):
            raise ValueError(
                f"{what}: these levels ({self.origin}) are not made of meshes of a problem; make "
                "them with Hierarchy.from_meshes, graded or uniform"
            )

    @property
    def grid_complexity(self) -> float:
        """Return nodes on all levels over nodes on the finest."""
        return sum(level.n_nodes for level in self.levels) / self.finest.n_nodes

    @property
    def operator_complexity(self) -> float:
        """Return the nonzeros of the discretised matrices on all levels over those of the
        finest."""
        return sum(level.nonzeros for level in self.levels) / self.finest.nonzeros

    def table(self) -> list[dict[str, float]]:
        """Return one dict a level: level, nodes, contact_nodes, nonzeros."""
        return [
            {
                "level": k,
                "nodes": level.n_nodes,
                "contact_nodes": len(level.discrete.contact) if level.discretised else 0,
                "nonzeros": level.nonzeros,
            }
            for k, level in enumerate(self.levels)
        ]

    def __repr__(self) -> str:
        return shortened(str(self))

    def _repr_html_(self) -> str:
        import pandas

        return in_html_lines(str(self).partition("\n")[0]) + html_table(
            pandas.DataFrame(self.table())
        )

    def __str__(self) -> str:
        name = self.problem.name if self.problem is not None else self.finest.discrete.name
        lines = [
            f"Hierarchy of {len(self)} levels ({lengths_in_units(self.origin)}){for_problem(name)}",
            f"{'level':>5} {'nodes':>9} {'contact':>8} {'nonzeros':>11}",
        ]
        lines += [
            f"{row['level']:>5} {row['nodes']:>9} {row['contact_nodes']:>8} {row['nonzeros']:>11}"
            for row in self.table()
        ]
        lines.append(
            f"grid complexity {self.grid_complexity:.3f}, "
            f"operator complexity (discretised) {self.operator_complexity:.3f}"
        )
        return "\n".join(lines)
