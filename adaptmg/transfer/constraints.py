r"""Transport of contact data from fine to coarse contact nodes, for correction problems.

``P_cc`` (n_fine_contact, n_coarse_contact) are the contact rows and columns of the prolongation, >= 0 with row sums at
most 1 (1 unless coarse dofs are fixed), and :math:`S_k = \{i : P_{ik} > 0\}`. The correction E has normal and
tangential components in the contact frames.

**The monotone guarantee.** With the smallest gap :math:`D_k = \min_{S_k} (g_0 - u_n)_i`, the minmod slip
:math:`U_k` (0 unless all slips :math:`t_i = (u_t - u_t^{prev})_i`, i in S_k, point one way; else the shortest) and the
summed limit :math:`G = P^T g`: for every E with :math:`E_{n,k} \le D_k`

.. math:: (g_0 - u_n)_i - (P E_n)_i \ge 0, \qquad
          \sum_i g_i |t_i + (P E_t)_i| - \sum_i g_i |t_i| \le \sum_k G_k \big(|U_k + E_{t,k}| - |U_k|\big).

*Proof.* :math:`\sum_k P_{ik} E_{n,k} \le \sum_k P_{ik} D_k \le (g_0 - u_n)_i`, as the opening is >= 0. By convexity
:math:`|t_i + \sum_k P_{ik} E_k| - |t_i| \le \sum_k P_{ik} (|t_i + E_k| - |t_i|)`, and :math:`|s e + E| - s` does not
increase with :math:`s \ge 0` for a unit vector e, so that it is largest at the shortest slip of :math:`S_k`; sum over i
with the weights :math:`g_i`. So the coarse functional majorises the change of the fine one: with coarse matrices
:math:`P^T A P` the Tresca energy cannot rise. It needs one normal (and in 3D one pair of tangents) over :math:`S_k`,
and contact rows that interpolate from coarse contact nodes only (:mod:`adaptmg.transfer.contact_rows`).

Source of the setting: the paper's correction problem, steps a-g; its other choices are here too, under the names
``largest_gap`` and ``injected_...``, and guarantee nothing. A nodal limit is a force and is summed, never
interpolated; a pressure is interpolated, from coarse to fine, in nested iteration.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse


@dataclass(frozen=True, eq=False)
class Supports:
    """The sets S_k of a contact prolongation, from :func:`supports`."""

    n_fine: int  # number of fine contact nodes
    indptr: np.ndarray  # (n_coarse_contact + 1,)
    nodes: np.ndarray  # (n,): fine contact nodes of S_k, ascending
    weights: np.ndarray  # (n,): P_ik > 0
    #: (n_coarse_contact,): fine contact node of the largest weight in S_k, the first of equals; -1 where S_k is empty
    main: np.ndarray

    def injected(self, values: np.ndarray, empty: float) -> np.ndarray:
        """Return fine values (n_fine, ...) at ``main``, ``empty`` where S_k is."""
        result = self._over_fine(values)[np.maximum(self.main, 0)]
        result[self.main < 0] = empty
        return result

    def reduced(self, ufunc: np.ufunc, values: np.ndarray, empty: float) -> np.ndarray:
        """Return fine values (n_fine, ...) reduced over each S_k, ``empty`` where it is."""
        values, filled = self._over_fine(values), self.main >= 0
        result = np.full((len(self.main), *values.shape[1:]), empty, dtype=values.dtype)
        if filled.any():
            result[filled] = ufunc.reduceat(values[self.nodes], self.indptr[:-1][filled])
        return result

    def _over_fine(self, values: np.ndarray) -> np.ndarray:
        if len(values) != self.n_fine:
            raise ValueError(f"one value a fine contact node is needed, {self.n_fine}, got {len(values)}")
        return values


def supports(P_cc: sparse.csr_array) -> Supports:
    """Return the sets S_k of P_cc (n_fine_contact, n_coarse_contact); ValueError if an entry is negative or not
    finite."""
    columns = sparse.csc_array(P_cc, dtype=np.float64, copy=True)
    columns.sum_duplicates()
    if not (np.isfinite(columns.data) & (columns.data >= 0)).all():
        raise ValueError("P_cc must be >= 0 (and finite): use Interpolation, or put contact rows in with "
                         "surface_interpolation and with_contact_rows")
    columns.eliminate_zeros()
    n = columns.shape[1]
    coarse = np.repeat(np.arange(n), np.diff(columns.indptr))
    # last of each column after sorting by weight, and the first of equals
    order = np.lexsort((-columns.indices, columns.data, coarse))
    main = np.full(n, -1, dtype=np.int64)
    main[coarse[order]] = columns.indices[order]
    return Supports(n_fine=columns.shape[0], indptr=columns.indptr, nodes=columns.indices, weights=columns.data,
                    main=main)


def smallest_gap(sets: Supports, opening: np.ndarray) -> np.ndarray:
    """Return safe bounds D_k (n_coarse_contact,) of the normal correction from the opening g0 - u_n (n_fine_contact,),
    m.

    +inf where S_k is empty.
    """
    return sets.reduced(np.minimum, opening, np.inf)


def largest_gap(sets: Supports, opening: np.ndarray) -> np.ndarray:
    """Return the paper's bound read literally ('smallest u_n'): max over S_k; as :func:`smallest_gap`. Stalls or
    cycles."""
    return sets.reduced(np.maximum, opening, np.inf)


def injected_gap(sets: Supports, opening: np.ndarray) -> np.ndarray:
    """Return the opening of the fine node with the largest weight in S_k; as :func:`smallest_gap`. No guarantee."""
    return sets.injected(opening, np.inf)


#: slips in 3D count as parallel up to this angle, rad
_PARALLEL = 1e-6


def minmod_slip(sets: Supports, slip: np.ndarray, stick: np.ndarray | None = None) -> np.ndarray:
    """Return safe reference slips U_k (n_coarse_contact, dim - 1) of the tangential correction, m.

    0 unless all slips u_t - u_t^previous (n_fine_contact, dim - 1) in S_k have one sign (3D: one direction) and none is
    zero or in ``stick`` (n_fine_contact,), else the shortest; 0 where S_k is empty. In 3D slips within 1e-6 rad of the
    shortest count as parallel to it; the guarantee then holds up to 1e-6 ``sum_i g_i sum_k P_ik |E_k|``.
    """
    slip = slip if stick is None else np.where(stick[:, None], 0.0, slip)
    if slip.shape[1] == 1:
        # one of the two is 0 unless all have one sign
        low, high = sets.reduced(np.minimum, slip, 0.0), sets.reduced(np.maximum, slip, 0.0)
        return np.maximum(low, 0.0) + np.minimum(high, 0.0)
    size = np.hypot(slip[:, 0], slip[:, 1])
    coarse = np.repeat(np.arange(len(sets.main)), np.diff(sets.indptr))
    # first of each column after sorting by length, and the first of equals
    order = np.lexsort((size[sets.nodes], coarse))
    shortest = np.zeros(len(sets.main), dtype=np.int64)
    filled = sets.main >= 0
    shortest[filled] = sets.nodes[order[sets.indptr[:-1][filled]]]
    this, best = slip[sets.nodes], slip[shortest[coarse]]
    dot = this[:, 0] * best[:, 0] + this[:, 1] * best[:, 1]
    cross = this[:, 0] * best[:, 1] - this[:, 1] * best[:, 0]
    other = ~(dot > 0.0) | (np.abs(cross) > np.sin(_PARALLEL) * (size[shortest[coarse]] * size[sets.nodes]))
    parallel = filled & (np.bincount(coarse[other], minlength=len(sets.main)) == 0)
    return np.where(parallel[:, None], slip[shortest], 0.0)


def injected_slip(sets: Supports, slip: np.ndarray) -> np.ndarray:
    """Return the slip of the fine node with the largest weight in S_k; shapes as :func:`minmod_slip`. No guarantee."""
    return sets.injected(slip, 0.0)


def summed_limit(sets: Supports, limit: np.ndarray) -> np.ndarray:
    """Return nodal friction limits g (n_fine_contact,) summed with the transpose, G = P'g (n_coarse_contact,), N; dual.

    The total is that of g where the rows sum to 1.
    """
    coarse = np.repeat(np.arange(len(sets.main)), np.diff(sets.indptr))
    return np.bincount(coarse, weights=sets.weights * limit[sets.nodes], minlength=len(sets.main)).astype(np.float64)


def injected_limit(sets: Supports, limit: np.ndarray) -> np.ndarray:
    """Return the nodal limit of the fine node with the largest weight in S_k, N; 0 where S_k is empty.

    As :func:`summed_limit`, but what one fine node bears is less than the force on a coarse one. No guarantee.
    """
    return sets.injected(limit, 0.0)
