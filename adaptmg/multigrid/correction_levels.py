r"""CorrectionLevels: the coarse spaces below one fine problem, in local components.

With the nodal prolongation P (fine values = P coarse values in every Cartesian component) the local one is
:math:`\hat P = F_f\,(P \otimes I)\,F_c^T`, F the contact frames, rows and columns of fixed dofs zeroed. Between a fine
and a coarse contact node the block is :math:`P_{ik}` times the identity (3D: times the rotation nearest to
:math:`t_f \cdot t_c` in the tangential part), so that normal goes to normal and slip to slip also on curved boundaries.
Coarse matrices are Galerkin products :math:`\hat P^T A \hat P`, or those of the coarse discretisations.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.smoother.system import LocalProblem, LocalSystem
from adaptmg.transfer.constraints import Supports, supports

__all__ = ["CorrectionLevel", "CorrectionLevels", "contact_weights", "correction_levels", "local_prolongation"]


@dataclass(eq=False)
class CorrectionLevel:
    """One level of the coarse correction.

    Attributes
    ----------
    system : LocalSystem
        Matrix on this level, local components.
    prolongation, restriction : bsr_array or None
        From the next coarser level (n_dofs, n_dofs coarse), and its transpose; None on the coarsest.
    contact_prolongation : csr_array (n_contact, n_contact coarse) or None
        Weights between contact nodes.
    """

    system: LocalSystem
    prolongation: sparse.bsr_array | None = None
    restriction: sparse.bsr_array | None = None
    contact_prolongation: sparse.csr_array | None = None

    @cached_property
    def supports(self) -> Supports:
        """The fine contact nodes that each coarse one reaches; ValueError if a weight is negative."""
        return supports(self.contact_prolongation)

    @property
    def proven(self) -> bool:
        """Whether the monotone correction from the next coarser level is proven: contact rows >= 0 with sums 1."""
        weights = self.contact_prolongation
        if weights is None:
            return True
        sums = np.asarray(weights.sum(axis=1)).ravel()
        return bool((weights.data >= 0).all() and np.abs(sums - 1).max(initial=0.0) < 1e-10)


@dataclass(eq=False)
class CorrectionLevels:
    """Levels, coarsest first, below one fine problem.

    Attributes
    ----------
    levels : list of CorrectionLevel
    fine : LocalProblem
        The problem on the last level.
    """

    levels: list[CorrectionLevel]
    fine: LocalProblem

    def __len__(self) -> int:
        return len(self.levels)

    def __getitem__(self, number: int) -> CorrectionLevel:
        return self.levels[number]

    @property
    def operator_complexity(self) -> float:
        """Nonzeros on all levels over those of the finest."""
        return sum(level.system.nonzeros for level in self.levels) / self.levels[-1].system.nonzeros


def correction_levels(hierarchy: Hierarchy, problems: list[LocalProblem], finest: int,
                      coarse_matrices: str = "galerkin") -> CorrectionLevels:
    """Level ``finest`` of a hierarchy and those below it.

    Parameters
    ----------
    hierarchy : Hierarchy
    problems : list of LocalProblem
        Its levels in local components, coarsest first.
    finest : int
        Level number, 0 = coarsest.
    coarse_matrices : {"galerkin", "discretised"}
        Where the coarse matrices come from; on nested meshes both are the same. Only Galerkin matrices make the
        monotone correction provable.
    """
    fine = problems[finest]
    levels = [CorrectionLevel(fine.system)]
    for k in range(finest, 0, -1):
        upper, lower = problems[k], problems[k - 1]
        nodal = hierarchy[k].contact_prolongation
        levels[0].prolongation = local_prolongation(nodal, upper, lower)
        levels[0].restriction = sparse.bsr_array(levels[0].prolongation.T)
        levels[0].contact_prolongation = contact_weights(nodal, upper.discrete, lower.discrete)
        finer = levels[1] if len(levels) > 1 else None
        system = local_galerkin(levels[0], lower.system, finer) if coarse_matrices == "galerkin" else lower.system
        levels.insert(0, CorrectionLevel(system))
    return CorrectionLevels(levels, fine)


def contact_weights(nodal: sparse.csr_array, fine: DiscreteProblem, coarse: DiscreteProblem) -> sparse.csr_array:
    """The part of a nodal prolongation between contact nodes (n_contact fine, n_contact coarse)."""
    weights = sparse.csr_array(nodal[fine.contact.nodes][:, coarse.contact.nodes])
    weights.eliminate_zeros()
    weights.sort_indices()
    return weights


def local_prolongation(nodal: sparse.csr_array, fine: LocalProblem, coarse: LocalProblem) -> sparse.bsr_array:
    """A nodal prolongation in local components (n_dofs fine, n_dofs coarse), zero at fixed dofs."""
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
    """The Galerkin coarse matrix; coarse dofs that no fine dof sees get a unit-scale diagonal.

    Dofs of ``level`` that ``finer``, the next level, does not see have such a diagonal, which is left out.
    """
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
