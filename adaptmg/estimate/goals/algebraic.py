r"""The algebraic part of the error of a quantity: what the solver has left of the discrete equations.

With the residual r = A u - b, the slip force s f of Tresca's law, and the defects :math:`\delta` of what is prescribed
(a gap left where bodies touch, a slip where they stick), the discrete solution and this u differ by

.. math:: J(u_h) - J(u) \approx -z \cdot r + \sum_{\mathrm{slip}} s\, f \cdot z_t - \lambda^* \cdot \delta, \qquad
          \lambda^* = A z - j .

It is of first order in the algebraic error, where the discretisation error of a quantity is of second order in the
energy error: solvers must go further for a quantity than for the energy.
"""

from __future__ import annotations

import numpy as np

from adaptmg.estimate.goals.view import Functional, GoalView
from adaptmg.smoother.state import ContactState as State

__all__ = ["algebraic_part"]


def algebraic_part(view: GoalView, functional: Functional, dual: np.ndarray) -> float:
    """J of the discrete solution minus J of the result, in the unit of the quantity.

    Parameters
    ----------
    view : GoalView
    functional : Functional
    dual : (n_dofs,) array
        Its dual field in the unknowns of the problem.
    """
    contact, discrete = view.contact, view.posed.discrete
    dim, nodes, state = discrete.dim, contact.nodes, contact.state
    residual = np.where(discrete.fixed, 0.0, contact.residual)
    z = contact.local(dual).reshape(-1, dim)[nodes]
    reaction = contact.local(discrete.matrix @ dual - functional.vector).reshape(-1, dim)[nodes]
    part = -float(dual @ residual)
    part += float(np.sum(np.where(contact.slips, contact.fixed_limit, 0.0) * np.sum(contact.unit * z[:, 1:], axis=1)))
    touches, sticks = state != State.OPEN, contact.sticks[:, None] & ~contact.held
    part -= float(np.sum(np.where(touches & np.isfinite(contact.gap), reaction[:, 0] * contact.gap, 0.0)))
    return part + float(np.sum(np.where(sticks, reaction[:, 1:] * contact.slip, 0.0)))
