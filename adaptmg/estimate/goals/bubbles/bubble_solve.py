r"""The error in the space of edge bubbles, and what it says of quantities of interest.

Residuals of the discrete solution and of its dual field against the bubbles,

.. math:: \rho_E(v) = b(b_E v) + \langle t_h, b_E v\rangle - a(u_h, b_E v), \qquad
          \rho^*_E(v) = J(b_E v) + \langle t^*_h, b_E v\rangle - a(b_E v, z_h)

(tractions t of contact on masters, whose bubbles move for themselves), give the error :math:`\sum_E b_E d_E` of all
bubbles together (by a few steps of GMRES, preconditioned edge by edge), or edge by edge,

.. math:: a\Bigl(\sum_F b_F d_F, b_E v\Bigr) = \rho_E(v), \qquad a(b_E d^0_E, b_E v) = \rho_E(v) .

The first one gives the signed estimate :math:`J(e) \approx \sum_E \rho^*_E(d_E)`: edge by edge it would be 1.3 to 2
times too large. The second one marks, :math:`|\rho^*_E(d^0_E)|`.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy.sparse.linalg import LinearOperator, gmres

from adaptmg.estimate.goals.bubbles.bubble_spaces import BubbleSpaces
from adaptmg.estimate.goals.bubbles.edge_bubbles import EdgeBubbles
from adaptmg.problem.contact_problem import ContactProblem

__all__ = ["BubbleError", "bubble_error"]

_LOG = logging.getLogger(__name__)

#: residual of the bubbles' equations, and the steps to a restart: five to ten suffice, the condition is about ten
_RTOL, _STEPS = 1e-2, 30


@dataclass(frozen=True, eq=False)
class BubbleError:
    """Amplitudes of the bubbles in the error, (n_edges, dim) each, m.

    Attributes
    ----------
    together : array
        All bubbles at once: signed estimates.
    alone : array
        Each edge for itself: marks.
    energy : float
        Energy norm of the error as the bubbles see it, sqrt(N m).
    """

    together: np.ndarray
    alone: np.ndarray
    energy: float


def bubble_error(problem: ContactProblem, bubbles: EdgeBubbles, spaces: BubbleSpaces, blocks: np.ndarray,
                 residual: np.ndarray) -> BubbleError:
    """The error of a discrete solution in the space of bubbles.

    Parameters
    ----------
    problem : ContactProblem
    bubbles : EdgeBubbles
    spaces : BubbleSpaces
        Directions that the bubbles have.
    blocks : (n_edges, dim, dim) array
        a(b e_i, b e_j), N/m.
    residual : (n_edges, dim) array
        rho of unit vectors, N.
    """
    trial, test, shape = spaces.trial, spaces.test, residual.shape
    small = np.einsum("nik,nij,njl->nkl", test, blocks, trial)
    small[spaces.missing[:, :, None] & np.eye(shape[1], dtype=bool)] = 1.0
    inverse = np.linalg.inv(small)
    load = np.einsum("nik,ni->nk", test, residual)

    def stiffness(x: np.ndarray) -> np.ndarray:
        x = x.reshape(shape)
        action = bubbles.stiffness(problem, np.einsum("nik,nk->ni", trial, x))
        return (np.einsum("nik,ni->nk", test, action) + np.where(spaces.missing, x, 0.0)).reshape(-1)

    def alone(x: np.ndarray) -> np.ndarray:
        return np.einsum("nkl,nl->nk", inverse, x.reshape(shape)).reshape(-1)

    n = load.size
    operator, inner = (LinearOperator((n, n), matvec=f, dtype=np.float64) for f in (stiffness, alone))
    # the test of scipy is on the preconditioned residual; if the true one is a little larger it begins anew
    found, failed = gmres(operator, load.reshape(-1), rtol=_RTOL, atol=0.0, restart=_STEPS, maxiter=3, M=inner)
    if failed:
        _LOG.info("the equations of %d bubbles were not solved to %.0e", len(load), _RTOL)
    together = np.einsum("nik,nk->ni", trial, found.reshape(shape))
    single = np.einsum("nik,nk->ni", trial, alone(load).reshape(shape))
    return BubbleError(together, single, float(np.sqrt(max(np.sum(residual * together), 0.0))))
