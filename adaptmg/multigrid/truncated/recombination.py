r"""Recombination of the last iterates, fitted on the next coarser level.

With restricted truncated residuals :math:`R_0` of this iterate and :math:`R_1, R_2` of the two before it, the weights
of :math:`u + \alpha_1 (u_1 - u) + \alpha_2 (u_2 - u)` minimise :math:`\sum_k |R_0 + \alpha_1 (R_1 - R_0) +
\alpha_2 (R_2 - R_0)|_k^2 / d_k`, d the diagonal of the coarse matrix (Anderson acceleration of depth 2, seen through
the restriction). As long as the contact status stays, the truncated residual is affine in u (3D: nearly).
"""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import kernel

__all__ = ["Recombination"]


@kernel
def _normal_equations(dim, inverse, now, first, second, result):
    """The entries a_11, a_12, a_22, b_1, b_2 of the weighted least squares problem, and the weighted |R_0|^2."""
    a_11, a_12, a_22, b_1, b_2, c = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(now) // dim):
        for a in range(dim):
            at = dim * i + a
            weight = inverse[(dim * i + a) * dim + a]
            r = now[at]
            d_1, d_2 = first[at] - r, second[at] - r
            a_11 += weight * d_1 * d_1
            a_12 += weight * d_1 * d_2
            a_22 += weight * d_2 * d_2
            b_1 -= weight * d_1 * r
            b_2 -= weight * d_2 * r
            c += weight * r * r
    result[0], result[1], result[2], result[3], result[4], result[5] = a_11, a_12, a_22, b_1, b_2, c


@kernel
def _combined(now, first, second, alpha_1, alpha_2, result):
    for at in range(len(now)):
        result[at] = now[at] + alpha_1 * (first[at] - now[at]) + alpha_2 * (second[at] - now[at])


class Recombination:
    """The last restricted residuals of one level.

    Parameters
    ----------
    dim, n_dofs : int
        Of the next coarser level.
    depth : int
        Iterates recombined besides the present one, 0 to 2.
    """

    #: the normal equations count as singular below this relative determinant
    SINGULAR = 1e-10

    def __init__(self, dim: int, n_dofs: int, depth: int) -> None:
        self.dim, self.depth, self.known = dim, depth, 0
        self._residuals = [np.zeros(n_dofs) for _ in range(3)]
        self._equations = np.zeros(6)

    @property
    def now(self) -> np.ndarray:
        """Where the residual of the present iterate goes."""
        return self._residuals[0]

    def restart(self) -> None:
        """Forget the iterates before the present one."""
        self.known = 0

    def fit(self, inverse: np.ndarray) -> tuple[float, float]:
        """The weights, from the inverse diagonal blocks of the next coarser level."""
        known = min(self.known, self.depth)
        if known == 0:
            return 0.0, 0.0
        _normal_equations(self.dim, inverse, *self._residuals, self._equations)
        a_11, a_12, a_22, b_1, b_2, _ = self._equations
        determinant = a_11 * a_22 - a_12 * a_12
        if known > 1 and determinant > self.SINGULAR * a_11 * a_22:
            return (b_1 * a_22 - b_2 * a_12) / determinant, (a_11 * b_2 - a_12 * b_1) / determinant
        return (b_1 / a_11, 0.0) if a_11 > 0.0 else (0.0, 0.0)

    def combine(self, alpha: tuple[float, float], result: np.ndarray) -> None:
        """The residual of the recombined iterate."""
        _combined(*self._residuals, *alpha, result)

    def advance(self) -> None:
        """The present iterate becomes a past one."""
        a, b, c = self._residuals
        self._residuals = [c, a, b]
        self.known += 1
