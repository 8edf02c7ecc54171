"""The parts of the truncated step that a user exchanges: Truncated, the options; Projection, the
protocol of a user-defined projection; FrameSmoother, a user-defined smoother in the step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, ClassVar, Protocol

import numpy as np

from adaptmg import _checks as checks
from adaptmg.discrete.coordinates import rotate, rotate_back
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.multigrid.cycle import Cycle
from adaptmg.multigrid.linear_cycle import (
    LinearCorrection,
    LinearSmoother,
    LinearSolve,
    regular_matrix,
)
from adaptmg.multigrid.split_matrix import SplitMatrix
from adaptmg.multigrid.truncated_contact import TruncatedContact
from adaptmg.smoother.gauss_seidel import Smoother
from adaptmg.smoother.system import NodalContact, local_system


class Projection(Protocol):
    """The protocol of a projection of a corrected iterate."""

    def project(self, contact: NodalContact, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """Return admissible values at the contact nodes.

        Parameters
        ----------
        contact : NodalContact
            The conditions, in contact frames: normal values at most ``contact.gap``, slips from
            ``contact.slip_reference``.
        before, after : (n_contact, dim) array
            Values before the correction, which are admissible, and after it: normal, tangents, m.
            Nodes that stick are as before, and so are normal values of closed nodes, unless the
            surface is compliant. These arrays may be changed.

        Returns
        -------
        (n_contact, dim) array
            What is as before stays so, whatever is returned. Normal values above the gap are cut,
            those of closed nodes on compliant surfaces below it.
        """
        ...


#: number of past iterates that are recombined
PastIterates = Annotated[int, partial(checks.integer, maximum=4)]
#: checks of options that may be user-defined
_offers_projection = partial(
    checks.offers,
    method="project",
    words="None or offer project(contact, before, after) -> values",
)
_offers_coarse_solve = partial(
    checks.offers,
    method="setup",
    words="a linear solver, which offers setup(matrix) -> object with solve(rhs) -> solution",
)
_offers_coarse_smoother = partial(
    checks.offers,
    method="setup",
    words="a linear smoother, which offers setup(matrix) -> object with smooth(rhs, x) -> passes",
)


@dataclass(frozen=True, kw_only=True)
class Truncated(checks.Checked):
    """Truncated nonsmooth Newton multigrid: the fast method.

    One symmetric sweep on the finest level, and after the first cycle one on the next coarser
    level, after its correction alone; on the others one before and after the correction where the
    matrix has more than 1.25 times the entries a row of the finest one (Galerkin products of
    independent meshes), else two. Where bodies touch each other, two sweeps over the nodes within
    two elements of the interface follow each smoothing of the finest level, backward and forward:
    where a joint is soft they bring the rate from .6 or .7 to .4, for a few per cent of a cycle on
    large meshes and a tenth on small graded ones.

    Parameters
    ----------
    smooth : int or Smoother
        Symmetric sweeps on the finest level before each linearisation, or a user-defined smoother:
        anything with ``smooth(system, contact, load, unknowns, sweeps) -> passes``, as
        ProjectedGaussSeidel, which is asked for one sweep, in contact frames. It works on a second
        copy of the matrix, and the residual after it takes another pass.
    recombine : int
        Past iterates recombined with the present one, 0 to 4, in turns recombined ones and those
        that they were made from.
    coarse_solve : LinearSolve, optional
        A user-defined solver of the coarsest linear problems, anything with ``setup(matrix) ->
        object with solve(rhs)`` (:class:`~adaptmg.multigrid.linear_cycle.LinearSolve`). Default: LU
        factors.
    coarse_smoother : LinearSmoother, optional
        A user-defined smoother of the linear problems between the coarsest level and the finest,
        anything with ``setup(matrix) -> object with smooth(rhs, x) -> passes``. Default:
        Gauss-Seidel sweeps.
    correct : Cycle, PyAMG or user-defined, optional
        What solves the truncated linear problem below the finest level: a
        :class:`~adaptmg.multigrid.cycle.Cycle` of shape "V", "W" or "F" with its numbers of
        sweeps, cycles of pyamg (:class:`~adaptmg.multigrid.linear_cycle.PyAMG`), or anything with
        ``setup(matrices, prolongations) -> object with solve(rhs)``
        (:class:`~adaptmg.multigrid.linear_cycle.LinearCorrection`). Default: a V-cycle with the
        sweeps above, but ``Cycle(shape="W", pre=3, post=3)`` for tangents of plastic bodies with
        smoothed elements: near a limit load these are nearly incompressible, and V-cycles reduce
        errors slowly.
    project : Projection, optional
        A user-defined projection of corrected iterates, anything with ``project(contact, before,
        after) -> values`` (:class:`~adaptmg.multigrid.truncated_parts.Projection`). Default:
        normal displacements end at the gap, and slips that would turn by more than 90 degrees at
        zero.
    coarse_contact, rigid_motions, search : bool
        Parts of the step that may be left out, to see what they buy (``studies/parts.py``): contact
        problems on a coarse level while the contact status is unknown, the least energy of the
        rigid motions that only contact holds, and the search for the least energy along a
        correction.
    interface_sweeps : int
        Sweeps near the interface of two bodies.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.solve(grids, am.Multigrid(correction=am.Truncated())).status.name
    'CONVERGED'
    """

    #: entries a row of a coarse matrix, over those of the finest one, above which it is smoothed once only. Half
    #: changes 28 of 119 solves, paths and loops, twice 10; cycles 691, 720, 686 (campaign constants)
    DENSE: ClassVar[float] = 1.25
    smooth: int | Smoother = 1
    recombine: PastIterates = 4
    coarse_solve: Annotated[LinearSolve, _offers_coarse_solve] | None = None
    coarse_smoother: Annotated[LinearSmoother, _offers_coarse_smoother] | None = None
    correct: Cycle | LinearCorrection | None = None
    project: Annotated[Projection, _offers_projection] | None = None
    coarse_contact: checks.Flag = True
    rigid_motions: checks.Flag = True
    search: checks.Flag = True
    interface_sweeps: checks.Whole = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.smooth, (int, np.integer)):
            object.__setattr__(self, "smooth", checks.integer("smooth", self.smooth, 1))
        else:
            words = "a number of sweeps or offer smooth(system, contact, load, unknowns, sweeps)"
            checks.offers("smooth", self.smooth, "smooth", words)
        if isinstance(self.correct, Cycle):
            checks.choice("shape of correct", self.correct.shape, ("V", "W", "F"))
        elif self.correct is not None:
            words = "a Cycle, am.PyAMG() or offer setup(matrices, prolongations)"
            checks.offers("correct", self.correct, "setup", words)
        if self.correct is not None and not isinstance(self.correct, Cycle):
            for name in ("coarse_solve", "coarse_smoother"):
                if getattr(self, name) is not None:
                    raise ValueError(
                        f"{name} must be None with correct={checks.shown(self.correct)}, which "
                        "solves all coarse problems itself"
                    )

    def sweeps(self, levels: Sequence[SplitMatrix]) -> list[int]:
        """Return the sweeps on each of the levels, coarsest first."""
        rows = [level.nonzeros / level.n_nodes for level in levels]
        return [1 if row > self.DENSE * rows[-1] else 2 for row in rows]


class FrameSmoother:
    """A user-defined smoother of a level, which works in contact frames, in the truncated step,
    which works in Cartesian components."""

    def __init__(self, smoother: Smoother, problem: DiscreteProblem, level: SplitMatrix) -> None:
        """Prepare the smoother for the matrix of a level, in contact frames."""
        self.smoother = smoother
        sizes = level.diagonal_sizes
        # that of the level, not of the problem: below the finest level it is a Galerkin matrix
        matrix = regular_matrix(level, np.where(sizes > 0, sizes, 1.0))
        local = local_system(problem.restructured(matrix=matrix))
        self.system = local.system
        self.frames = local.frames

    def smooth(
        self, load: np.ndarray, contact: TruncatedContact, u: np.ndarray, residual: np.ndarray
    ) -> float:
        """Smooth the unknowns u (n_dofs,) and the values at contact nodes, in place, leave ``load``
        - A u in ``residual``, and return the passes over the matrix that the smoother reports."""
        system = self.system
        nodes = system.nodes
        forces = rotate(load, self.frames, nodes)
        forces[system.fixed] = 0.0
        local = rotate(u, self.frames, nodes)
        local_by_node = local.reshape(-1, system.dim)
        values = contact.values.reshape(-1, system.dim)
        # rotated twice, a closed gap would no longer be closed to the last digit
        local_by_node[nodes] = values
        conditions = contact.conditions
        passes = self.smoother.smooth(system, conditions, forces, local, 1)  # one sweep
        # a user-defined smoother may leave numbers that are not finite
        checks.array("smooth: the unknowns that smooth leaves", local, local.shape)
        local[system.fixed] = 0.0
        local_by_node[nodes, 0] = conditions.clamped(local_by_node[nodes, 0])
        values[:] = local_by_node[nodes]
        u[:] = rotate_back(local, self.frames, nodes)
        residual[:] = rotate_back(forces - system.matrix @ local, self.frames, nodes)
        return passes
