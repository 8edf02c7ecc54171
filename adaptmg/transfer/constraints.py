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

Kernels of the transport of contact data: minima over the supports S_k of the columns of P.

``indptr``, ``nodes`` hold S_k as in a CSC matrix; results are written to the last argument.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._runtime import kernel

__all__ = ["Supports", "injected_gap", "injected_limit", "injected_slip", "largest", "largest_gap", "minmod_line",
           "minmod_plane", "minmod_slip", "smallest", "smallest_gap", "summed_limit", "supports"]

@dataclass(frozen=True, eq=False)
class Supports:
    """The sets S_k of a contact prolongation; made once by :func:`supports`, accepted in place of ``P_cc``.

    Attributes
    ----------
    n_fine : int
        Number of fine contact nodes.
    indptr : (n_coarse_contact + 1,) array
    nodes : (n,) array
        Fine contact nodes of S_k, ascending.
    weights : (n,) array
        P_ik > 0.
    main : (n_coarse_contact,) array
        Fine contact node of the largest weight in S_k, the first of equals; -1 where S_k is empty.
    """

    n_fine: int
    indptr: np.ndarray
    nodes: np.ndarray
    weights: np.ndarray
    main: np.ndarray

    def injected(self, values: np.ndarray, empty: float) -> np.ndarray:
        """Fine values (n_fine, ...) at ``main``, ``empty`` where S_k is."""
        result = values[np.maximum(self.main, 0)]
        result[self.main < 0] = empty
        return result


def supports(P_cc: sparse.csr_array | Supports) -> Supports:
    """The sets S_k; ValueError if an entry of P_cc is negative or not finite."""
    if isinstance(P_cc, Supports):
        return P_cc
    if not sparse.issparse(P_cc):
        raise TypeError(f"P_cc must be a scipy sparse matrix or Supports, got {type(P_cc).__name__}")
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


def _over_fine(name: str, value: np.ndarray, n_fine: int) -> np.ndarray:
    array = np.asarray(value, dtype=np.float64)
    if array.shape != (n_fine,):
        raise ValueError(f"{name} must have shape ({n_fine},), one value a fine contact node, got {array.shape}")
    return array


def _slips(slip: np.ndarray, n_fine: int) -> np.ndarray:
    array = np.ascontiguousarray(slip, dtype=np.float64)
    if array.shape not in ((n_fine, 1), (n_fine, 2)):
        raise ValueError(f"slip must have shape ({n_fine}, 1) in 2D or ({n_fine}, 2) in 3D, got {array.shape}")
    return array


def smallest_gap(P_cc: sparse.csr_array | Supports, opening: np.ndarray) -> np.ndarray:
    """Safe bounds of the normal correction.

    Parameters
    ----------
    P_cc : (n_fine_contact, n_coarse_contact) sparse, or Supports
    opening : (n_fine_contact,) array
        g0 - u_n of the current iterate, m.

    Returns
    -------
    (n_coarse_contact,) array
        D_k, m; +inf where S_k is empty.
    """
    sets = supports(P_cc)
    result = np.empty(len(sets.main))
    smallest(sets.indptr, sets.nodes, _over_fine("opening", opening, sets.n_fine), result)
    return result


def largest_gap(P_cc: sparse.csr_array | Supports, opening: np.ndarray) -> np.ndarray:
    """The paper's bound read literally ('smallest u_n'): max over S_k; as :func:`smallest_gap`. Stalls or cycles."""
    sets = supports(P_cc)
    result = np.empty(len(sets.main))
    largest(sets.indptr, sets.nodes, _over_fine("opening", opening, sets.n_fine), result)
    return result


def injected_gap(P_cc: sparse.csr_array | Supports, opening: np.ndarray) -> np.ndarray:
    """Opening of the fine node with the largest weight in S_k; as :func:`smallest_gap`. No guarantee."""
    sets = supports(P_cc)
    return sets.injected(_over_fine("opening", opening, sets.n_fine), np.inf)


def minmod_slip(P_cc: sparse.csr_array | Supports, slip: np.ndarray, stick: np.ndarray | None = None, *,
                angle: float = 1e-6) -> np.ndarray:
    r"""Safe reference slips of the tangential correction.

    Parameters
    ----------
    P_cc : (n_fine_contact, n_coarse_contact) sparse, or Supports
    slip : (n_fine_contact, dim - 1) array
        u_t - u_t^previous of the current iterate, m.
    stick : (n_fine_contact,) bool array, optional
        Nodes whose slip counts as zero; default none.
    angle : float
        3D: slips within this angle (rad, below pi/2) of the shortest in S_k count as parallel to it. The guarantee then
        holds up to angle * sum_i g_i sum_k P_ik |E_k|.

    Returns
    -------
    (n_coarse_contact, dim - 1) array
        U_k, m: 0 unless all slips in S_k have one sign (3D: one direction) and none is zero or sticks, else the
        shortest; 0 where S_k is empty.
    """
    sets = supports(P_cc)
    slip = _slips(slip, sets.n_fine)
    mask = np.zeros(sets.n_fine, dtype=bool) if stick is None else np.asarray(stick)
    if mask.dtype != bool or mask.shape != (sets.n_fine,):
        raise ValueError(f"stick must be a boolean mask of shape ({sets.n_fine},), got {mask.dtype} {mask.shape}")
    if not 0 <= checks.number("angle", angle) < np.pi / 2:
        raise ValueError(f"angle must be >= 0 and below pi/2, got {angle!r}")
    result = np.empty((len(sets.main), slip.shape[1]))
    if slip.shape[1] == 1:
        minmod_line(sets.indptr, sets.nodes, slip[:, 0], mask, result[:, 0])
    else:
        minmod_plane(sets.indptr, sets.nodes, slip, mask, np.sin(angle), result)
    return result


def injected_slip(P_cc: sparse.csr_array | Supports, slip: np.ndarray) -> np.ndarray:
    """Slip of the fine node with the largest weight in S_k; shapes as :func:`minmod_slip`. No guarantee."""
    sets = supports(P_cc)
    return sets.injected(_slips(slip, sets.n_fine), 0.0)


def summed_limit(P_cc: sparse.csr_array | Supports, limit: np.ndarray) -> np.ndarray:
    """Nodal friction limits summed with the transpose: G = P'g.

    Parameters
    ----------
    P_cc : (n_fine_contact, n_coarse_contact) sparse, or Supports
    limit : (n_fine_contact,) array
        g, nodal forces (dual), N.

    Returns
    -------
    (n_coarse_contact,) array
        N; the total is that of g where the rows sum to 1.
    """
    sets = supports(P_cc)
    coarse = np.repeat(np.arange(len(sets.main)), np.diff(sets.indptr))
    values = sets.weights * _over_fine("limit", limit, sets.n_fine)[sets.nodes]
    return np.bincount(coarse, weights=values, minlength=len(sets.main))


def injected_limit(P_cc: sparse.csr_array | Supports, limit: np.ndarray) -> np.ndarray:
    """Nodal limit of the fine node with the largest weight in S_k, N; 0 where S_k is empty.

    As :func:`summed_limit`, but what one fine node bears is less than the force on a coarse one. No guarantee.
    """
    sets = supports(P_cc)
    return sets.injected(_over_fine("limit", limit, sets.n_fine), 0.0)


@kernel
def smallest(indptr, nodes, values, result):
    """Minimum over S_k, +inf where it is empty."""
    for k in range(len(indptr) - 1):
        result[k] = np.inf
        for at in range(indptr[k], indptr[k + 1]):
            result[k] = min(result[k], values[nodes[at]])


@kernel
def largest(indptr, nodes, values, result):
    """Maximum over S_k, +inf where it is empty."""
    for k in range(len(indptr) - 1):
        result[k] = np.inf if indptr[k] == indptr[k + 1] else -np.inf
        for at in range(indptr[k], indptr[k + 1]):
            result[k] = max(result[k], values[nodes[at]])


@kernel
def minmod_line(indptr, nodes, slip, stick, result):
    """2D: the slip of smallest magnitude, 0 unless all slips in S_k have one sign and none sticks."""
    for k in range(len(indptr) - 1):
        result[k] = 0.0
        for at in range(indptr[k], indptr[k + 1]):
            i = nodes[at]
            value = slip[i]
            first = at == indptr[k]
            if stick[i] or value == 0.0 or (not first and (value > 0.0) != (result[k] > 0.0)):
                result[k] = 0.0
                break
            if first or abs(value) < abs(result[k]):
                result[k] = value


@kernel
def minmod_plane(indptr, nodes, slip, stick, sine, result):
    """3D: the shortest slip, 0 unless all slips in S_k point its way within an angle below 90 degrees."""
    for k in range(len(indptr) - 1):
        result[k, 0], result[k, 1] = 0.0, 0.0
        shortest, length = -1, np.inf
        for at in range(indptr[k], indptr[k + 1]):
            i = nodes[at]
            norm = 0.0 if stick[i] else np.hypot(slip[i, 0], slip[i, 1])
            if norm < length:
                shortest, length = i, norm
        if shortest < 0 or length == 0.0:
            continue
        parallel = True
        for at in range(indptr[k], indptr[k + 1]):
            i = nodes[at]
            scale = length * np.hypot(slip[i, 0], slip[i, 1])
            dot = slip[i, 0] * slip[shortest, 0] + slip[i, 1] * slip[shortest, 1]
            cross = slip[i, 0] * slip[shortest, 1] - slip[i, 1] * slip[shortest, 0]
            if not dot > 0.0 or abs(cross) > sine * scale:
                parallel = False
                break
        if parallel:
            result[k, 0], result[k, 1] = slip[shortest, 0], slip[shortest, 1]
