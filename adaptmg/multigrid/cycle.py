r"""The multigrid cycle of the monotone and the paper's correction, its coarse problems, and its
nested start.

At a fine iterate w with residual :math:`r = b - A w` (contact forces kept in it) the coarse unknown
E solves

.. math:: \min_E\ \tfrac12 E^T A_c E - (\hat P^T r)^T E + \sum_k G_k\,|U_k + E_{t,k}|,\qquad E_{n,k} \le D_k,

steps d-g of the paper. The corrections differ in how they choose D (gap), U (slip) and G (sliding
limit).

With the nodal prolongation P the one in local components is :math:`\hat P = F_f\,(P \otimes
I)\,F_c^T`, F the contact frames, rows and columns of fixed dofs zeroed. Between a fine and a coarse
contact node the block is :math:`P_{ik}` times the identity (3D: times the rotation nearest to
:math:`t_f \cdot t_c` in the tangential part), so that normal goes to normal and slip to slip on
curved boundaries too.

Fig. 1 of the paper shows the shapes of the cycle. The coarsest problem is condensed to its contact
dofs first, as the paper does ('a condensation of the problem to the contact variables alone'): one
factorisation in the set-up, far fewer sweeps, on a small dense matrix. Sweeps go in batches; with
:math:`\delta_m` the change over batch m in the norm of the diagonal blocks and :math:`\rho =
\delta_m/\delta_{m-1}` the remaining error is estimated as
:math:`\delta_m\,\rho/(1-\rho)`, without a matrix pass. The paper's test is on the change of one sweep alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, Protocol, cast

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.grids import Grids
from adaptmg.smoother.factorisation import Condensed
from adaptmg.smoother.gauss_seidel import Omega, ProjectedGaussSeidel, Smoother
from adaptmg.smoother.system import LocalProblem, LocalSystem, NodalContact
from adaptmg.transfer.contact import (
    Supports,
    injected_gap,
    injected_limit,
    injected_slip,
    largest_gap,
    minmod_slip,
    smallest_gap,
    summed_limit,
    supports,
)


@dataclass(frozen=True, eq=False)
class InitialContact:
    """The first solution on a level at its contact nodes (the paper's U0 and G0)."""

    slip: np.ndarray  # (n_contact, dim - 1), m
    limit: np.ndarray  # (n_contact,): sliding limit, N


class Correction(Protocol):
    """The transport of contact data to the next coarser level."""

    @property
    def needs_initial(self) -> bool:
        """Return whether :meth:`transport` gets the first solution on the coarse level."""
        ...

    def transport(
        self,
        reach: Supports,
        opening: np.ndarray,
        slip: np.ndarray,
        limit: np.ndarray,
        initial: InitialContact | None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the coarse gap D (n,), m, slip U (n, dim - 1), m, and limit G (n,), N, of the n coarse
        contact nodes.

        The arguments belong to the k fine contact nodes: ``opening`` (k,) is g0 - w_n in m, ``slip``
        (k, dim - 1) is in m, and ``limit`` (k,) is the sliding limit s + mu p in N. ``reach`` says
        which of them each coarse node reaches. ``initial`` is the first solution on the coarse level
        if ``needs_initial``, else None."""
        ...


class Recorder(Protocol):
    """An observer that the multigrid ingredients report to; :class:`adaptmg.solver.record.Run` is
    one."""

    def count(self, passes: float, nonzeros: int) -> None:
        """Count ``passes`` over a matrix with this number of stored entries."""

    def visit(self, level: int, action: str, times: int = 1) -> None:
        """Note an action on a level."""


def sliding_limit(system: LocalSystem, contact: NodalContact, residual: np.ndarray) -> np.ndarray:
    """Return s + mu p with p = max(0, r_n), r = b - A w (n_contact,), N."""
    normal_force = np.maximum(residual.reshape(-1, system.dim)[system.nodes, 0], 0.0)
    return contact.limit + contact.friction * normal_force


def correction_contact(
    correction: Correction,
    reach: Supports,
    system: LocalSystem,
    coarse: LocalSystem,
    contact: NodalContact,
    unknowns: np.ndarray,
    residual: np.ndarray,
    initial: InitialContact | None,
) -> NodalContact:
    """Return the contact data D, U and G of the coarse correction problem (module) at a fine iterate
    (n_dofs,) with its residual (n_dofs,). ``system`` and ``contact`` are those of the fine level,
    ``coarse`` is the system of the coarse one; ``reach`` and ``initial`` are those of
    :meth:`Correction.transport`."""
    values = unknowns.reshape(-1, system.dim)[system.nodes]
    fine_slip = values[:, 1:] - contact.slip_reference
    # where a support moves a node along one tangent, a correction E changes the length of its slip tau
    # by at most |E|: | |tau + E| - |tau| | <= |E|, which is the term |U + E| of the coarse friction
    # with U = 0
    fine_slip[contact.driven] = 0.0
    fine_limit = sliding_limit(system, contact, residual)

    def transported(opening: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return D, U and G for the distances (n_contact,), m, to one of the obstacles."""
        returned = correction.transport(reach, opening, fine_slip, fine_limit, initial)
        return _checked_transport(correction, coarse, returned)

    gap, slip, limit = transported(contact.gap - values[:, 0])
    lowest = None
    if contact.lowest is not None:
        # U and G do not depend on the obstacle; the opening of the one below counts downwards
        lowest = -transported(values[:, 0] - contact.lowest)[0]
    # E_t is 0 along tangents that supports hold: there is no slip of the correction
    slip = np.where(coarse.fixed.reshape(-1, coarse.dim)[coarse.nodes][:, 1:], 0.0, slip)
    # G |U + E_t|: the slip of E counts from -U, with the limit frozen, so that friction is zero
    return NodalContact(
        gap=gap, slip_reference=-slip, limit=limit, friction=np.zeros_like(limit), lowest=lowest
    )


def _checked_transport(
    correction: Correction, coarse: LocalSystem, returned: object
) -> tuple[np.ndarray, ...]:
    """Return gap (n,), slip (n, dim - 1) and limit (n,) that a correction has transported to the n coarse
    contact nodes, with types and shapes checked: it may be user-defined."""
    n = len(coarse.nodes)
    name = f"correction: transport of {checks.shown(correction)}"
    if not isinstance(returned, (tuple, list)) or len(returned) != 3:
        raise TypeError(f"{name} must return gap, slip and limit, got {checks.shown(returned)}")
    shapes = {"gap": (n,), "slip": (n, coarse.dim - 1), "limit": (n,)}
    for (what, shape), array in zip(shapes.items(), returned, strict=True):
        if not isinstance(array, np.ndarray) or array.dtype != np.float64 or array.shape != shape:
            actual = (
                f"{array.dtype} {array.shape}"
                if isinstance(array, np.ndarray)
                else checks.shown(array)
            )
            raise TypeError(
                f"{name} must return a {what} of float64 {shape}, coarse contact nodes first, got {actual}"
            )
    return tuple(returned)


@dataclass(eq=False)
class CorrectionLevel:
    """One level of the coarse correction."""

    system: LocalSystem  # matrix on this level, local components
    # Any: those of the coarsest level are None, and nothing reads them
    prolongation: sparse.bsr_array | Any = None  # from the next coarser level, in local components
    restriction: sparse.bsr_array | Any = None
    # (n_contact, n_contact coarse): its nodal weights between contact nodes
    contact_prolongation: sparse.csr_array | Any = None

    @cached_property
    def supports(self) -> Supports:
        """Return the fine contact nodes that each coarse one reaches; ValueError if a weight is
        negative."""
        return supports(self.contact_prolongation)


def local_prolongations(hierarchy: Grids, problems: list[LocalProblem]) -> list[sparse.csr_array]:
    """Return the prolongations between neighbouring levels in contact frames, coarsest first.

    Parameters
    ----------
    hierarchy : Hierarchy
        With the contact problem on every level.
    problems : list of LocalProblem
        Those of the levels (:func:`adaptmg.smoother.local_system`), coarsest first.

    Returns
    -------
    list of scipy.sparse.csr_array
        (n_dofs, n_dofs of the next coarser level), zero in rows and columns of fixed dofs; normal
        goes to normal and tangent to tangent. Primal; the transpose restricts residuals.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> problems = [am.smoother.local_system(level.discrete) for level in grids.levels]
    >>> [P.shape for P in am.multigrid.local_prolongations(grids, problems)]
    [(50, 18)]
    """
    return [
        sparse.csr_array(local_prolongation(level.contact_prolongation, fine, coarse))
        for level, coarse, fine in zip(
            hierarchy.levels[1:], problems[:-1], problems[1:], strict=True
        )
    ]


def correction_levels(
    hierarchy: Grids,
    problems: list[LocalProblem],
    finest: int,
    coarse_matrices: str = "galerkin",
) -> list[CorrectionLevel]:
    """Return the level ``finest`` of a hierarchy and those below it, coarsest first. ``problems`` are those
    of all levels of the hierarchy; matrices of coarse levels are "galerkin" products of the level above,
    or else those of the problems."""
    fine = CorrectionLevel(problems[finest].system)
    finer = None  # the level above ``fine``
    levels = [fine]  # finest first
    for k in range(finest, 0, -1):
        nodal = hierarchy[k].contact_prolongation
        coarse_problem = problems[k - 1]
        fine.prolongation = local_prolongation(nodal, problems[k], coarse_problem)
        fine.restriction = sparse.bsr_array(fine.prolongation.T)
        fine.contact_prolongation = contact_weights(
            nodal, problems[k].discrete, coarse_problem.discrete
        )
        system = coarse_problem.system
        if coarse_matrices == "galerkin":
            system = local_galerkin(fine, system, finer)
        finer = fine
        fine = CorrectionLevel(system)
        levels.append(fine)
    return levels[::-1]


def contact_weights(
    nodal: sparse.csr_array, fine: DiscreteProblem, coarse: DiscreteProblem
) -> sparse.csr_array:
    """Return the part of a nodal prolongation between contact nodes (n_contact fine, n_contact
    coarse)."""
    weights = sparse.csr_array(nodal[fine.contact.nodes][:, coarse.contact.nodes])
    weights.eliminate_zeros()
    weights.sort_indices()
    return weights


def local_prolongation(
    nodal: sparse.csr_array, fine: LocalProblem, coarse: LocalProblem
) -> sparse.bsr_array:
    """Return a nodal prolongation in local components (n_dofs fine, n_dofs coarse), zero at fixed
    dofs."""
    dim = fine.system.dim
    nodal = sparse.csr_array(nodal)
    rows = np.repeat(np.arange(nodal.shape[0]), np.diff(nodal.indptr))
    columns = nodal.indices
    blocks = nodal.data[:, None, None] * np.eye(dim)
    contact_of_row = fine.system.contact_of[rows]
    contact_of_column = coarse.system.contact_of[columns]
    # blocks F_f F_c' where one of the nodes has a frame; elsewhere the identity
    at_contact = np.flatnonzero((contact_of_row >= 0) | (contact_of_column >= 0))
    if at_contact.size:
        fine_frames = np.broadcast_to(np.eye(dim), (at_contact.size, dim, dim)).copy()
        coarse_frames = fine_frames.copy()
        fine_contact = contact_of_row[at_contact]
        coarse_contact = contact_of_column[at_contact]
        fine_frames[fine_contact >= 0] = fine.frames[fine_contact[fine_contact >= 0]]
        coarse_frames[coarse_contact >= 0] = coarse.frames[coarse_contact[coarse_contact >= 0]]
        rotation = np.einsum("nij,nkj->nik", fine_frames, coarse_frames)
        between_contacts = (fine_contact >= 0) & (coarse_contact >= 0)
        rotation[between_contacts] = _tangential_part(rotation[between_contacts])
        blocks[at_contact] = nodal.data[at_contact, None, None] * rotation
    free_rows = (~fine.system.fixed).reshape(-1, dim)[rows]
    free_columns = (~coarse.system.fixed).reshape(-1, dim)[columns]
    blocks *= free_rows[:, :, None] & free_columns[:, None, :]
    shape = (fine.system.n_dofs, coarse.system.n_dofs)
    return sparse.bsr_array((blocks, columns, nodal.indptr), shape=shape)


def _tangential_part(rotation: np.ndarray) -> np.ndarray:
    """Return the parts (n, dim, dim) of rotations between frames (n, dim, dim) that map normal to normal
    exactly, and tangents by the nearest rotation, the identity in 2D."""
    if rotation.shape[1] < 3:
        return np.broadcast_to(np.eye(rotation.shape[1]), rotation.shape)
    result = np.zeros_like(rotation)
    result[:, 0, 0] = 1.0
    u, _, vt = np.linalg.svd(rotation[:, 1:, 1:])
    result[:, 1:, 1:] = u @ vt
    return result


def local_galerkin(
    level: CorrectionLevel, coarse: LocalSystem, finer: CorrectionLevel | None = None
) -> LocalSystem:
    """Return the system of the Galerkin matrix P'AP, A and P those of ``level``.

    An idle coarse dof moves no fine dof: its column of P is zero, and so is its residual. It gets a
    diagonal entry, without which a sweep divides by zero; as its correction is zero, any size serves,
    here the mean of the other entries. The matrix of ``level`` has such entries, too, at dofs that are
    idle for the level ``finer`` above it: they are not stiffness, and do not enter P'AP."""
    dim = coarse.dim
    prolongation = level.prolongation
    restriction = level.restriction
    if finer is not None:
        column_sums = np.asarray(abs(finer.prolongation).sum(axis=0)).ravel()
        without_idle = sparse.diags_array((column_sums > 0).astype(float))
        prolongation = without_idle @ prolongation
        restriction = restriction @ without_idle
    product = sparse.csr_array(restriction @ level.system.matrix @ prolongation)
    diagonal = product.diagonal()
    idle = ~(diagonal > 0)
    size = 1.0 if idle.all() else diagonal[~idle].mean()
    with_idle = product + sparse.diags_array(np.where(idle, size, 0.0))
    matrix = sparse.bsr_array(with_idle, blocksize=(dim, dim)).sorted_indices()
    return LocalSystem.from_matrix(matrix, coarse.fixed, coarse.nodes)


@dataclass(frozen=True)
class Monotone:
    r"""The correction that cannot raise the Tresca energy; no options.

    With :math:`S_k = \{i : P_{ik} > 0\}`

    .. math:: D_k = \min_{S_k} (g_0 - u_n),\quad U_k = \mathrm{minmod}_{S_k}(u_t - u_t^{prev}),\quad G = P^T g .

    For contact rows of P that are >= 0 with row sums 1, Galerkin coarse matrices and one normal
    over each S_k the coarse functional majorises the fine one, so the energy with g frozen cannot
    rise, and E = 0 at the solution (R. Kornhuber 1994, doi:10.1007/BF03325426; R. Krause 2009,
    doi:10.1137/070682514). Elsewhere nothing is claimed.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.solve(grids, am.Multigrid(correction=am.Monotone())).status.name
    'CONVERGED'
    """

    needs_initial = False

    def transport(
        self,
        reach: Supports,
        opening: np.ndarray,
        slip: np.ndarray,
        limit: np.ndarray,
        initial: InitialContact | None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        # D, U, G
        stick = (slip == 0.0).all(axis=1)
        return (
            smallest_gap(reach, opening),
            minmod_slip(reach, slip, stick),
            summed_limit(reach, limit),
        )


@dataclass(frozen=True, kw_only=True)
class PaperCorrection(checks.Checked):
    """The correction of the paper (steps a-g), its choices selectable.

    Read literally its coarse gap (the smallest u_n, which is <= 0) is the largest opening, and
    stalls or cycles. A limit G that is frozen cannot be exact on the fine grid: the iteration stops
    changing before the contact conditions hold, which :class:`adaptmg.Result` reports as STALLED.
    On the bars of the paper it is G that matters.

    Parameters
    ----------
    gap : {"smallest", "largest", "injected"}
        Opening of a coarse contact node: smallest over the fine nodes it reaches (the paper's
        choice, read safely), largest (read literally), or that of the fine node with the largest
        weight (nested: the coincident one).
    slip : {"initial", "injected", "minmod"}
        Slip offset U: of the first coarse solution (the paper's choice), of the coincident fine
        node, or the smallest common slip.
    limit : {"initial", "injected", "summed"}
        Sliding limit G: of the first coarse solution (the paper's choice), that of the fine node
        with the largest weight (a nodal force, hence too small on the coarse grid: for comparison),
        or the sum P'g.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> paper = am.Multigrid(correction=am.PaperCorrection(slip="initial"), max_cycles=5)
    >>> am.solve(grids, paper, throw=False).cycles <= 5
    True
    """

    gap: Literal["smallest", "largest", "injected"] = "smallest"
    slip: Literal["initial", "injected", "minmod"] = "initial"
    limit: Literal["initial", "injected", "summed"] = "initial"

    @property
    def needs_initial(self) -> bool:
        return "initial" in (self.slip, self.limit)

    def transport(
        self,
        reach: Supports,
        opening: np.ndarray,
        slip: np.ndarray,
        limit: np.ndarray,
        initial: InitialContact | None,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        gap = {"smallest": smallest_gap, "largest": largest_gap, "injected": injected_gap}[
            self.gap
        ](reach, opening)
        # functions, of which the chosen ones are called: first solutions may be missing
        slips = {
            "initial": lambda: cast("InitialContact", initial).slip,  # see needs_initial
            "injected": lambda: injected_slip(reach, slip),
            "minmod": lambda: minmod_slip(reach, slip, (slip == 0.0).all(axis=1)),
        }
        limits = {
            "initial": lambda: cast("InitialContact", initial).limit,
            "injected": lambda: injected_limit(reach, limit),
            "summed": lambda: summed_limit(reach, limit),
        }
        return gap, slips[self.slip](), limits[self.limit]()


@dataclass(frozen=True, kw_only=True)
class Cycle(checks.Checked):
    """Shape of a cycle.

    Parameters
    ----------
    shape : {"V", "W", "F", "complete"}
        How often a coarse problem is visited: once, twice, once fully and once as V, or until it is
        solved to the tolerance of the coarse solve (the paper's 'complete resolution').
    pre, post : int
        Smoothing sweeps before and after the coarse correction, not both 0.

    Examples
    --------
    >>> am.Multigrid(correction=am.Monotone(), cycle=am.Cycle(shape="W", pre=1, post=1)).cycle.shape
    'W'
    """

    shape: Literal["V", "W", "F", "complete"] = "V"
    pre: checks.Whole = 2
    post: checks.Whole = 0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.pre + self.post == 0:
            raise ValueError(
                "pre and post must not both be 0: without smoothing the cycle does not converge"
            )


#: shapes of the cycles on a level in one visit from the next finer one
VISITS = {"V": "V", "W": "WW", "F": "FV"}


@dataclass(eq=False)
class MultigridCycle:
    """Cycles on the levels of a coarse correction. Loads (n_dofs,) and unknowns (n_dofs,), which are
    changed in place, are in the contact frames of their level."""

    levels: list[CorrectionLevel]  # coarsest first
    options: Cycle
    smoother: Smoother
    correction: Correction
    coarse: CoarseSolve
    recorder: Recorder
    # by level; empty where the correction does not need it
    initial: list[InitialContact] = field(default_factory=list)
    # the coarsest level on its contact dofs alone; None: its sweeps go over all dofs
    condensed: Condensed | None = None

    #: cycles of a 'complete' coarse solution at most
    COMPLETE_LIMIT = 60

    def cycle(
        self, level: int, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray, shape: str
    ) -> None:
        """Run one cycle on a level >= 1: smooth, correct from the next coarser level, smooth."""
        self.smooth(level, contact, load, unknowns, self.options.pre)
        self.correct(level, contact, unknowns, self.residual(level, load, unknowns), shape)
        self.smooth(level, contact, load, unknowns, self.options.post)

    def solve(
        self, level: int, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray, shape: str
    ) -> None:
        """Solve the problem of a level as the ``shape`` of the cycle says, from ``unknowns`` on."""
        if level == 0:
            self.solve_coarsest(contact, load, unknowns)
        elif shape == "complete":
            self._complete(level, contact, load, unknowns)
        else:
            for shape_of_visit in VISITS[shape]:
                self.cycle(level, contact, load, unknowns, shape_of_visit)

    def correct(
        self,
        level: int,
        contact: NodalContact,
        unknowns: np.ndarray,
        residual: np.ndarray,
        shape: str | None = None,
    ) -> None:
        """Add the correction from the next coarser level to ``unknowns``, in place; ``residual`` is
        b - A w. ``shape`` says how the coarse problem is solved, by default that of the options."""
        fine = self.levels[level]
        coarse = self.levels[level - 1]
        initial = self.initial[level - 1] if self.correction.needs_initial else None
        coarse_contact = correction_contact(
            self.correction,
            reach=fine.supports,
            system=fine.system,
            coarse=coarse.system,
            contact=contact,
            unknowns=unknowns,
            residual=residual,
            initial=initial,
        )
        self.recorder.visit(level, "restrict")
        load = fine.restriction @ residual
        error = np.zeros(coarse.system.n_dofs)
        self.solve(
            level - 1, coarse_contact, load, error, self.options.shape if shape is None else shape
        )
        unknowns += fine.prolongation @ error
        self.recorder.visit(level, "prolong")

    def smooth(
        self, level: int, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray, sweeps: int
    ) -> None:
        """Smooth on a level, and count the passes."""
        if sweeps:
            system = self.levels[level].system
            passes = self.smoother.smooth(system, contact, load, unknowns, sweeps)
            self.recorder.count(passes, system.nonzeros)
            self.recorder.visit(level, "smooth", sweeps)

    def residual(self, level: int, load: np.ndarray, unknowns: np.ndarray) -> np.ndarray:
        """Return b - A w on a level (n_dofs,), one pass."""
        system = self.levels[level].system
        self.recorder.count(1.0, system.nonzeros)
        return load - system.matrix @ unknowns

    def solve_coarsest(self, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray) -> None:
        """Solve the coarsest problem, condensed to its contact dofs if it has factors."""
        if self.condensed is None:
            sweeps = self.coarse.solve(
                self.levels[0].system, contact, load, unknowns, self.recorder
            )
        else:
            particular, reduced = self.condensed.reduce(load)
            contact_part = self.condensed.restrict(unknowns)
            sweeps = self.coarse.solve(
                self.condensed.problem.system, contact, reduced, contact_part, self.recorder
            )
            unknowns[:] = self.condensed.complete(particular, contact_part)
        self.recorder.visit(0, "solve", sweeps)

    def _complete(
        self, level: int, contact: NodalContact, load: np.ndarray, unknowns: np.ndarray
    ) -> None:
        """Run cycles until the estimated error meets the tolerance of the coarse solve."""
        change = np.inf
        for _ in range(self.COMPLETE_LIMIT):
            before = unknowns.copy()
            self.cycle(level, contact, load, unknowns, "complete")
            previous = change
            change = float(np.linalg.norm(unknowns - before))
            if self.coarse.met(change, previous, float(np.linalg.norm(unknowns))):
                break


@dataclass(frozen=True, kw_only=True)
class CoarseSolve(checks.Checked):
    """Sweeps of projected Gauss-Seidel (SOR) to a tolerance.

    Parameters
    ----------
    condensed : bool
        Sweep on the Schur complement of the contact dofs on the coarsest level, whose entries are
        counted as work; the factorisation and its solves are reported as seconds.
    rtol : float
        Tolerance relative to the solution of the coarse problem: for ``test="error"`` of the
        estimated error in the norm of the diagonal blocks, for ``test="change"`` of the Euclidean
        change in one sweep.
    atol : float
        Absolute tolerance added to it, in m, on the Euclidean norm (``test="change"`` only).
    test : {"error", "change"}
    omega : float
        Over-relaxation.
    max_sweeps : int
        Sweeps at most; the last iterate is used.

    Examples
    --------
    >>> am.Multigrid(correction=am.Monotone(), coarse=am.CoarseSolve(rtol=1e-3)).coarse.rtol
    0.001
    """

    condensed: checks.Flag = True
    rtol: checks.Nonnegative = 1e-2
    atol: checks.Nonnegative = 0.0
    test: Literal["error", "change"] = "error"
    omega: Omega = 1.5
    max_sweeps: checks.Count = 2000

    #: sweeps between tests of the error
    BATCH = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.rtol < 1:
            raise ValueError(
                f"rtol must be < 1, a share of the solution, got {checks.shown(self.rtol)}"
            )
        if self.rtol == 0 and self.atol == 0:
            raise ValueError("rtol and atol must not both be 0")
        if self.atol > 0 and self.test == "error":
            raise ValueError("atol is for test='change'; give rtol with test='error'")

    def solve(
        self,
        system: LocalSystem,
        contact: NodalContact,
        load: np.ndarray,
        unknowns: np.ndarray,
        recorder: Recorder,
    ) -> int:
        """Sweep until the tolerance is met, changing ``unknowns`` (n_dofs,) in place; returns the
        number of sweeps."""
        smoother = ProjectedGaussSeidel(omega=self.omega)
        batch = self.BATCH if self.test == "error" else 1
        blocks = system.diagonal.reshape(-1, system.dim, system.dim)

        def norm(vector: np.ndarray) -> float:
            """Return the norm of the test: Euclidean, or that of the diagonal blocks."""
            if self.test == "change":
                return float(np.linalg.norm(vector))
            v = vector.reshape(-1, system.dim)
            return float(np.sqrt(np.einsum("ni,nij,nj->", v, blocks, v)))

        before = unknowns.copy()
        sweeps = 0
        change = np.inf
        size = 0.0
        while sweeps < self.max_sweeps and np.isfinite(size):
            passes = smoother.smooth(system, contact, load, unknowns, batch)
            recorder.count(passes, system.nonzeros)
            sweeps += batch
            previous = change
            change = norm(unknowns - before)
            size = norm(unknowns)
            if self.met(change, previous, size):
                break
            before[:] = unknowns
        return sweeps

    def met(self, change: float, previous: float, size: float) -> bool:
        """Return whether the tolerance is met after a ``change``, with the ``previous`` one and the
        ``size`` of the unknowns."""
        error = change
        if self.test == "error" and change > 0.0:
            # delta rho / (1 - rho); the first change has no rate
            rate = change / previous if np.isfinite(previous) else np.inf
            error = change * rate / (1 - rate) if rate < 1 else np.inf
        return error <= self.rtol * size + self.atol


@dataclass(frozen=True, kw_only=True)
class NestedStart(checks.Checked):
    """The solves on the levels below the finest, before it.

    Parameters
    ----------
    cycles : int
        Cycles on each level between the coarsest and the finest.
    rtol : float
        Tolerance on the coarsest level.

    Examples
    --------
    >>> am.FullMultigrid(start=am.NestedStart(cycles=1)).start.cycles
    1
    """

    #: between bodies two cycles, where the next level has three times the nodes, save nothing: of 40 random problems
    #: at 1e-3 and 1e-6 417 cycles for 417, 1588 passes for 1572
    cycles: checks.Count = 1
    rtol: checks.Tolerance = 1e-8


def project(local: LocalProblem, unknowns: np.ndarray) -> None:
    """Put normal displacements of unknowns (n_dofs,) that exceed the gap back onto the obstacle, in place."""
    normal = local.system.nodes.astype(np.int64) * local.system.dim
    unknowns[normal] = local.contact.clamped(unknowns[normal])


def prolonged_start(
    nodal: sparse.csr_array, coarse: LocalProblem, unknowns: np.ndarray, fine: LocalProblem
) -> np.ndarray:
    """Interpolate local unknowns (n_dofs coarse,) to those of the next finer level (n_dofs fine,), by the
    prolongation ``nodal`` of Cartesian components, and project them."""
    result = fine.to_local(nodal @ coarse.to_cartesian(unknowns))
    project(fine, result)
    return result


def initial_contact(
    local: LocalProblem, unknowns: np.ndarray, residual: np.ndarray
) -> InitialContact:
    """Return the slip and sliding limit of a first solution (n_dofs,) with its residual (n_dofs,) (the
    paper's U0 and G0)."""
    system = local.system
    slip = unknowns.reshape(-1, system.dim)[system.nodes][:, 1:] - local.contact.slip_reference
    return InitialContact(slip=slip, limit=sliding_limit(system, local.contact, residual))
