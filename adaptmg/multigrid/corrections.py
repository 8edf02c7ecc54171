r"""The coarse correction problem of the monotone and the paper's corrections, and the coarse spaces they use.

At a fine iterate w with residual :math:`r = b - A w` (contact forces kept in it) the coarse unknown E solves

.. math:: \min_E\ \tfrac12 E^T A_c E - (\hat P^T r)^T E + \sum_k G_k\,|U_k + E_{t,k}|,\qquad E_{n,k} \le D_k,

steps d-g of the paper. The corrections differ in how they choose D (gap), U (slip) and G (sliding limit).

With the nodal prolongation P the one in local components is :math:`\hat P = F_f\,(P \otimes I)\,F_c^T`, F the contact
frames, rows and columns of fixed dofs zeroed. Between a fine and a coarse contact node the block is :math:`P_{ik}`
times the identity (3D: times the rotation nearest to :math:`t_f \cdot t_c` in the tangential part), so that normal goes
to normal and slip to slip on curved boundaries too.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.smoother.system import LocalProblem, LocalSystem, NodalContact
from adaptmg.transfer.constraints import (
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
    """How contact data go to the next coarser level."""

    @property
    def needs_initial(self) -> bool:
        """Whether :meth:`transport` gets the first solution on the coarse level."""

    def transport(self, reach: Supports, opening: np.ndarray, slip: np.ndarray, limit: np.ndarray,
                  initial: InitialContact | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the coarse gap D, slip U and limit G."""


class Recorder(Protocol):
    """What the multigrid ingredients report to; :class:`adaptmg.solver.record.Run` is one."""

    def count(self, passes: float, nonzeros: int) -> None:
        """Count matrix passes."""

    def visit(self, level: int, action: str, times: int = 1) -> None:
        """Note an action on a level."""


def sliding_limit(system: LocalSystem, contact: NodalContact, residual: np.ndarray) -> np.ndarray:
    """Return s + mu p with p = max(0, r_n), r = b - A w (n_contact,), N."""
    normal_force = np.maximum(residual.reshape(-1, system.dim)[system.nodes, 0], 0.0)
    return contact.limit + contact.friction * normal_force


def correction_contact(correction: Correction, reach: Supports, system: LocalSystem, coarse: LocalSystem,
                       contact: NodalContact, unknowns: np.ndarray, residual: np.ndarray,
                       initial: InitialContact | None) -> NodalContact:
    """Return the contact data of the coarse correction problem at a fine iterate."""
    values = unknowns.reshape(-1, system.dim)[system.nodes]
    fine_slip = values[:, 1:] - contact.slip_reference
    # |E| is a bound of what a correction changes in a slip that is held along one tangent
    fine_slip[contact.driven] = 0.0
    gap, slip, limit = _transported(correction, coarse, correction.transport(
        reach, contact.gap - values[:, 0], fine_slip, sliding_limit(system, contact, residual), initial))
    slip = np.where(coarse.fixed.reshape(-1, coarse.dim)[coarse.nodes][:, 1:], 0.0, slip)
    return NodalContact(gap=gap, slip_reference=-slip, limit=limit, friction=np.zeros_like(limit))


def _transported(correction: Correction, coarse: LocalSystem, found: object) -> tuple[np.ndarray, ...]:
    """The coarse contact data of a correction, types and shapes checked: it may be user-defined."""
    n, name = len(coarse.nodes), f"correction: transport of {checks.shown(correction)}"
    if not isinstance(found, (tuple, list)) or len(found) != 3:
        raise TypeError(f"{name} must return gap, slip and limit, got {checks.shown(found)}")
    shapes = {"gap": (n,), "slip": (n, coarse.dim - 1), "limit": (n,)}
    for (what, shape), array in zip(shapes.items(), found, strict=True):
        if not isinstance(array, np.ndarray) or array.dtype != np.float64 or array.shape != shape:
            given = f"{array.dtype} {array.shape}" if isinstance(array, np.ndarray) else checks.shown(array)
            raise TypeError(f"{name} must return a {what} of float64 {shape}, coarse contact nodes first, got {given}")
    return tuple(found)


@dataclass(eq=False)
class CorrectionLevel:
    """One level of the coarse correction."""

    system: LocalSystem  # matrix on this level, local components
    prolongation: sparse.bsr_array | None = None  # from the next coarser level, in local components
    restriction: sparse.bsr_array | None = None
    contact_prolongation: sparse.csr_array | None = None  # (n_contact, n_contact coarse)

    @cached_property
    def supports(self) -> Supports:
        """The fine contact nodes that each coarse one reaches; ValueError if a weight is negative."""
        return supports(self.contact_prolongation)


def correction_levels(hierarchy: Hierarchy, problems: list[LocalProblem], finest: int,
                      coarse_matrices: str = "galerkin") -> list[CorrectionLevel]:
    """Return the level ``finest`` of a hierarchy and those below it, coarsest first."""
    levels = [CorrectionLevel(problems[finest].system)]
    for k in range(finest, 0, -1):
        upper, lower = problems[k], problems[k - 1]
        nodal = hierarchy[k].contact_prolongation
        levels[0].prolongation = local_prolongation(nodal, upper, lower)
        levels[0].restriction = sparse.bsr_array(levels[0].prolongation.T)
        levels[0].contact_prolongation = contact_weights(nodal, upper.discrete, lower.discrete)
        finer = levels[1] if len(levels) > 1 else None
        system = local_galerkin(levels[0], lower.system, finer) if coarse_matrices == "galerkin" else lower.system
        levels.insert(0, CorrectionLevel(system))
    return levels


def contact_weights(nodal: sparse.csr_array, fine: DiscreteProblem, coarse: DiscreteProblem) -> sparse.csr_array:
    """Return the part of a nodal prolongation between contact nodes (n_contact fine, n_contact coarse)."""
    weights = sparse.csr_array(nodal[fine.contact.nodes][:, coarse.contact.nodes])
    weights.eliminate_zeros()
    weights.sort_indices()
    return weights


def local_prolongation(nodal: sparse.csr_array, fine: LocalProblem, coarse: LocalProblem) -> sparse.bsr_array:
    """Return a nodal prolongation in local components (n_dofs fine, n_dofs coarse), zero at fixed dofs."""
    dim = fine.system.dim
    nodal = sparse.csr_array(nodal)
    rows = np.repeat(np.arange(nodal.shape[0]), np.diff(nodal.indptr))
    columns = nodal.indices
    blocks = nodal.data[:, None, None] * np.eye(dim)
    at_row, at_column = fine.system.contact_of[rows], coarse.system.contact_of[columns]
    turned = np.flatnonzero((at_row >= 0) | (at_column >= 0))
    if turned.size:
        left = np.broadcast_to(np.eye(dim), (turned.size, dim, dim)).copy()
        right = left.copy()
        i, j = at_row[turned], at_column[turned]
        left[i >= 0] = fine.frames[i[i >= 0]]
        right[j >= 0] = coarse.frames[j[j >= 0]]
        rotation = np.einsum("nij,nkj->nik", left, right)
        both = (i >= 0) & (j >= 0)
        rotation[both] = _tangential_part(rotation[both])
        blocks[turned] = nodal.data[turned, None, None] * rotation
    free_rows = (~fine.system.fixed).reshape(-1, dim)[rows]
    free_columns = (~coarse.system.fixed).reshape(-1, dim)[columns]
    blocks *= free_rows[:, :, None] & free_columns[:, None, :]
    shape = (fine.system.n_dofs, coarse.system.n_dofs)
    return sparse.bsr_array((blocks, columns, nodal.indptr), shape=shape)


def _tangential_part(rotation: np.ndarray) -> np.ndarray:
    """Normal to normal exactly; tangents by the nearest rotation, the identity in 2D."""
    result = np.zeros_like(rotation)
    result[:, 0, 0] = 1.0
    if rotation.shape[1] == 2:
        result[:, 1, 1] = 1.0
        return result
    u, _, vt = np.linalg.svd(rotation[:, 1:, 1:])
    result[:, 1:, 1:] = u @ vt
    return result


def local_galerkin(level: CorrectionLevel, coarse: LocalSystem, finer: CorrectionLevel | None = None) -> LocalSystem:
    """Return the Galerkin coarse matrix; coarse dofs that no fine dof sees get a unit-scale diagonal. Dofs of ``level``
    that ``finer``, the next level, does not see have such a diagonal, which is left out."""
    dim = coarse.dim
    prolongation, restriction = level.prolongation, level.restriction
    if finer is not None:
        taken = sparse.diags_array((np.asarray(abs(finer.prolongation).sum(axis=0)).ravel() > 0).astype(float))
        prolongation, restriction = taken @ prolongation, restriction @ taken
    product = sparse.csr_array(restriction @ level.system.matrix @ prolongation)
    diagonal = product.diagonal()
    empty = ~(diagonal > 0)
    fill = np.where(empty, diagonal[~empty].mean() if (~empty).any() else 1.0, 0.0)
    matrix = sparse.bsr_array(product + sparse.diags_array(fill), blocksize=(dim, dim)).sorted_indices()
    return LocalSystem.from_matrix(matrix, coarse.fixed, coarse.nodes)


@dataclass(frozen=True)
class Monotone:
    r"""The correction that cannot raise the Tresca energy; no options.

    With :math:`S_k = \{i : P_{ik} > 0\}`

    .. math:: D_k = \min_{S_k} (g_0 - u_n),\quad U_k = \mathrm{minmod}_{S_k}(u_t - u_t^{prev}),\quad G = P^T g .

    For contact rows of P that are >= 0 with row sums 1, Galerkin coarse matrices and one normal over each S_k the
    coarse functional majorises the fine one, so the energy with g frozen cannot rise, and E = 0 at the solution
    (R. Kornhuber 1994, doi:10.1007/BF03325426; R. Krause 2009, doi:10.1137/070682514). Elsewhere nothing is claimed.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> am.solve(grids, am.Multigrid(correction=am.Monotone())).status.name
    'CONVERGED'
    """

    @property
    def needs_initial(self) -> bool:
        """Return False."""
        return False

    def transport(self, reach: Supports, opening: np.ndarray, slip: np.ndarray, limit: np.ndarray,
                  initial: InitialContact | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        stick = (slip == 0.0).all(axis=1)
        return smallest_gap(reach, opening), minmod_slip(reach, slip, stick), summed_limit(reach, limit)


@dataclass(frozen=True, kw_only=True)
class PaperCorrection:
    """The correction of the paper (steps a-g), its choices selectable.

    Read literally its coarse gap (the smallest u_n, which is <= 0) is the largest opening, and stalls or cycles. A
    limit G that is frozen cannot be exact on the fine grid: the iteration stops changing before the contact conditions
    hold, which :class:`adaptmg.Result` reports as STALLED. On the bars of the paper it is G that matters.

    Parameters
    ----------
    gap : {"smallest", "largest", "injected"}
        Opening of a coarse contact node: smallest over the fine nodes it reaches (the paper's choice, read safely),
        largest (read literally), or that of the fine node with the largest weight (nested: the coincident one).
    slip : {"initial", "injected", "minmod"}
        Slip offset U: of the first coarse solution (the paper's choice), of the coincident fine node, or the
        smallest common slip.
    limit : {"initial", "injected", "summed"}
        Sliding limit G: of the first coarse solution (the paper's choice), that of the fine node with the largest
        weight (a nodal force, hence too small on the coarse grid: for comparison), or the sum P'g.

    Examples
    --------
    >>> grids = am.Hierarchy.uniform(am.cases.greco_bar(), divisions=(2, 4))
    >>> paper = am.Multigrid(correction=am.PaperCorrection(slip="initial"), max_cycles=5)
    >>> am.solve(grids, paper, throw=False).cycles <= 5
    True
    """

    gap: str = "smallest"
    slip: str = "initial"
    limit: str = "initial"

    def __post_init__(self) -> None:
        checks.choice("gap", self.gap, ("smallest", "largest", "injected"))
        checks.choice("slip", self.slip, ("initial", "injected", "minmod"))
        checks.choice("limit", self.limit, ("initial", "injected", "summed"))

    @property
    def needs_initial(self) -> bool:
        return "initial" in (self.slip, self.limit)

    def transport(self, reach: Supports, opening: np.ndarray, slip: np.ndarray, limit: np.ndarray,
                  initial: InitialContact | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        gap = {"smallest": smallest_gap, "largest": largest_gap, "injected": injected_gap}[self.gap](reach, opening)
        slips = {"initial": lambda: initial.slip, "injected": lambda: injected_slip(reach, slip),
                 "minmod": lambda: minmod_slip(reach, slip, (slip == 0.0).all(axis=1))}
        limits = {"initial": lambda: initial.limit, "injected": lambda: injected_limit(reach, limit),
                  "summed": lambda: summed_limit(reach, limit)}
        return gap, slips[self.slip](), limits[self.limit]()
