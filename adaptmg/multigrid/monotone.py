r"""Monotone correction: coarse contact data that can only lower the fine Tresca energy.

With :math:`S_k = \{i : P_{ik} > 0\}`

.. math:: D_k = \min_{S_k} (g_0 - u_n),\quad U_k = \mathrm{minmod}_{S_k}(u_t - u_t^{prev}),\quad G = P^T g .

For contact rows of P that are >= 0 with row sums 1, Galerkin coarse matrices and one normal over each S_k the coarse
functional majorises the fine one, so the energy with g frozen cannot rise, and E = 0 at the solution (the idea of
monotone multigrid, Kornhuber 1994, doi:10.1007/BF03325426; Krause 2009, doi:10.1137/070682514). Elsewhere nothing is
claimed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.multigrid.correction import InitialContact
from adaptmg.transfer.constraints import Supports, minmod_slip, smallest_gap, summed_limit

__all__ = ["Monotone"]


@dataclass(frozen=True)
class Monotone:
    """The energy-decreasing correction; no options."""

    @property
    def needs_initial(self) -> bool:
        """It needs no first coarse solution."""
        return False

    def transport(self, reach: Supports, opening: np.ndarray, slip: np.ndarray, limit: np.ndarray,
                  initial: InitialContact | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """See :class:`adaptmg.multigrid.correction.Correction`."""
        stick = (slip == 0.0).all(axis=1)
        return smallest_gap(reach, opening), minmod_slip(reach, slip, stick), summed_limit(reach, limit)
