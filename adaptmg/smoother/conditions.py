r"""Contact conditions as equations: the natural residual, the states of nodes, and Newton's
linearisation.

With r = b - A w, the force on the body at a contact node is -r, and p = max(0, r_n) its compressive
magnitude. The natural residual

.. math:: D\,(\mathrm{prox}_D(w - D^{-1}(A w - b)) - w)

with D the block diagonal of A and :math:`\mathrm{prox}_D` the exact node solve of
:mod:`adaptmg.smoother.node_solve` in the metric D, its bound held at :math:`s + \mu\,p(w)`, is a force. It vanishes
exactly at the solution, Coulomb's law included; away from contact it is r.

With q = b - A w (minus the force on the body), the slip :math:`\tau` and factors :math:`c_n, c_t >
0` (N/m) the contact conditions are the equations (P. Alart, A. Curnier, Comput. Methods Appl. Mech.
Engrg. 92, 1991, doi:10.1016/0045-7825(91)90022-X)

.. math:: q_n = \max(0, z_n),\quad z_n = q_n + c_n (w_n - g_0);\qquad
          q_t = \min(1, B/|z_t|)\, z_t,\quad z_t = q_t + c_t \tau,\quad B = s + \mu \max(0, z_n).

A node is active where :math:`z_n > 0`, sticks where :math:`|z_t| \le B > 0` and slips elsewhere. A
Newton step
:math:`\delta` then satisfies (S. Hueber, G. Stadler, B. Wohlmuth, SIAM J. Sci. Comput. 30, 2008, doi:10.1137/060671061)

- active :math:`\delta_n = g_0 - w_n` (of a scalar problem to the obstacle on that side), otherwise
  :math:`(A\delta)_n = q_n`;
- stick :math:`\delta_t = -\tau`;
- slip, with :math:`z = z_t/|z_t|,\ \Pi = I - z z^T` and :math:`\mu = 0` where not active,

.. math:: (A_t - \mu z A_n + \kappa \Pi)\,\delta = z (z\cdot q_t - s - \mu q_n) + \frac{|z_t|}{|z_t| - B}\,\Pi q_t,
          \qquad \kappa = \frac{c_t B}{|z_t| - B} \ge 0.

This is the derivative itself, solved for :math:`\delta q_t`; :math:`\kappa\Pi` tends to the slip
Hessian
:math:`(B/|\tau|)\,\Pi`. In front of a surface of compliance e a node touches at :math:`w_n = g_0 + e\,q_n`, so that

.. math:: z_n = q_n + \frac{c_n}{1 + c_n e}\,(w_n - g_0 - e\,q_n),\qquad
          (A\delta)_n + \delta_n/e = q_n - (w_n - g_0)/e,

where z_n has the sign that it has in front of a rigid surface. A bound that grows by h with the
length of the slip adds :math:`h\,z z^T` to :math:`\kappa\Pi`. Without the Coulomb term
:math:`\mu z A_n` the matrix is symmetric and positive definite.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg._numba import kernel
from adaptmg.smoother.blocks import ZERO, read, upper, write
from adaptmg.smoother.node_solve import natural_at, read_reference
from adaptmg.smoother.system import (
    STIFF,
    LocalProblem,
    NodalContact,
    contact_codes,
    contact_states,
)


def natural_residual(local: LocalProblem, unknowns: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Return the natural residual (n_dofs,), N, of unknowns with the residual b - A w."""
    dim = local.system.dim
    nodes = local.system.nodes
    result = residual.reshape(-1, dim).copy()
    blocks = local.system.diagonal.reshape(-1, dim, dim)[nodes]
    result[nodes] = natural_at_nodes(
        local.contact, blocks, unknowns.reshape(-1, dim)[nodes], result[nodes]
    )
    return result.reshape(-1)


def natural_at_nodes(
    contact: NodalContact, blocks: np.ndarray, values: np.ndarray, linear: np.ndarray
) -> np.ndarray:
    """Return the natural residual (n_contact, dim), N, of contact nodes from the diagonal blocks
    (n_contact, dim, dim), the unknowns ``values`` and the residual b - A w, ``linear``, both
    (n_contact, dim)."""
    result = np.array(linear).reshape(-1)
    dim = values.shape[1]
    _natural_residual(
        ZERO[dim],
        np.ascontiguousarray(blocks).reshape(-1),
        contact.gap,
        contact.reference,
        contact.limit,
        contact.friction,
        contact.compliances,
        np.ascontiguousarray(values).reshape(-1),
        result,
    )
    return result.reshape(-1, dim)


@kernel
def _natural_residual(zero, diagonal, gap, reference, limit, friction, compliance, w, result):
    """Overwrite r = b - A w in ``result`` by D (prox_D(w + D^-1 r) - w), node by node; all arrays
    are flat, ``zero`` is ZERO[dim]."""
    dim = np.uint64(len(zero))
    for node in range(len(gap)):
        k = np.uint64(node)
        r = read(result, dim * k, zero)
        write(
            result,
            dim * k,
            natural_at(
                upper(diagonal, dim * dim * k, zero),
                r,
                read(w, dim * k, zero),
                gap[k],
                read_reference(reference, k, zero),
                limit[k] + friction[k] * max(r[0], 0.0),
                compliance[k],
            ),
        )


def states(
    contact: NodalContact, values: np.ndarray, normal_force: np.ndarray, small: float
) -> np.ndarray:
    """Return the :class:`~adaptmg.smoother.system.ContactState` (n_contact,) int8 for unknowns
    (n_contact, dim) and p. OPEN where there is a gap, or no compressive force; otherwise STICK
    where the slip is zero and the bound s + mu p is positive, and SLIP elsewhere. A gap or slip up
    to ``small`` (m) counts as zero."""
    slip = np.linalg.norm(values[:, 1:] - contact.slip_reference, axis=1)
    sticks = (slip <= small) & (contact.limit + contact.friction * normal_force > 0)
    closed = ~(contact.opening(values[:, 0]) > small)
    return contact_states(contact_codes(closed, sticks), normal_force)


@dataclass(frozen=True, eq=False)
class Linearised:
    """The equations of one Newton step at the contact nodes; see the module."""

    active: np.ndarray  # (n,) bools
    slip: np.ndarray  # (n,) bools
    direction: np.ndarray  # (n, dim - 1): z, zero where the node sticks
    coupling: np.ndarray  # (n,): mu where the node is active and slips, else 0
    curvature: np.ndarray  # (n, dim - 1, dim - 1): kappa Pi, N/m
    force: np.ndarray  # (n, dim): right-hand sides of the equations that are not prescriptions, N
    prescribed: np.ndarray  # (n, dim) bool: components whose change is given
    change: np.ndarray  # (n, dim): these changes, zero elsewhere, m
    spring: np.ndarray  # (n,): of compliant surfaces at active nodes, N/m

    @property
    def symmetric(self) -> bool:
        """Return whether the matrix stays symmetric: no pressure changes friction."""
        return not self.coupling.any()

    @property
    def key(self) -> bytes:
        """Return the contact status: the codes of :mod:`adaptmg.smoother.system`, as bytes; with one tangent,
        in 2D, also the direction of the slip."""
        backwards = ~(self.direction[:, 0] > 0) if self.direction.shape[1] == 1 else False
        return contact_codes(self.active, ~self.slip, backwards).tobytes()

    @property
    def pull(self) -> np.ndarray:
        """Return mu z (n, dim - 1), the multiples of the normal row that tangential rows lose."""
        return self.coupling[:, None] * self.direction

    def has_matrix_of(self, other: Linearised) -> bool:
        """Return whether ``other`` has the same matrix. With the same :attr:`key` the two may still differ
        by friction or compliance that follows the state."""
        return (
            np.array_equal(self.prescribed, other.prescribed)
            and np.array_equal(self.pull, other.pull)
            and np.array_equal(self.curvature, other.curvature)
            and np.array_equal(self.spring, other.spring)
        )


def linearise(
    contact: NodalContact,
    unknowns: np.ndarray,
    residual: np.ndarray,
    stiffness: np.ndarray,
    factor: float,
) -> Linearised:
    """Decide the status of every contact node at ``unknowns``, and set up its equations.

    unknowns, residual (b - A w), stiffness (diagonal of A): (n_contact, dim); c_n and c_t are
    ``factor`` times the stiffness, in 3D that of the stiffer tangent."""
    if contact.lowest is not None:  # a scalar problem: no tangents, and an obstacle on each side
        aim = unknowns + residual / (factor * stiffness)
        return _clamped_equations(contact, unknowns, residual, aim[:, 0])
    contact, hardening = contact.tangent(unknowns, residual)
    c_t = factor * stiffness[:, 1:].max(axis=1)
    # z_n = q_n + c_n / (1 + c_n e) (w_n - g_0 - e q_n)
    with np.errstate(invalid="ignore"):  # diverged unknowns may be infinite, as gaps may
        penetration = unknowns[:, 0] - contact.gap - contact.compliances * residual[:, 0]
        c_n = factor * stiffness[:, 0]
        augmented = residual[:, 0] + c_n / (1 + c_n * contact.compliances) * penetration
    # B = s + mu max(0, z_n), z_t = q_t + c_t tau
    active = augmented > 0
    tau = unknowns[:, 1:] - contact.slip_reference
    # the tangent of a bound that follows the state may be negative: there is no friction then
    bound = np.maximum(contact.limit + contact.friction * np.maximum(augmented, 0.0), 0.0)
    trial = residual[:, 1:] + c_t[:, None] * tau
    trial_size = np.linalg.norm(trial, axis=1)
    slip = ~((trial_size <= bound) & (bound > 0))
    slip[contact.driven] = True  # a support moves them along a tangent
    equations = _equations(contact, unknowns, residual, active, slip, trial, trial_size, bound, c_t)
    # h z z'
    along = equations.direction[:, :, None] * equations.direction[:, None, :]
    equations.curvature[:] += (active * hardening)[:, None, None] * along
    # springs change normal equations only; slip along held tangents replaces tangential ones, h z z' too
    compliant = np.flatnonzero(active & (contact.compliances * stiffness[:, 0] > STIFF))
    _set_springs(contact, unknowns, compliant, equations)
    return _slip_along_held(contact, tau, residual, equations)


def _set_springs(
    contact: NodalContact, unknowns: np.ndarray, nodes: np.ndarray, equations: Linearised
) -> None:
    """Replace prescribed normal displacements of compliant ``nodes`` (k,), numbers of contact nodes, by
    springs, at ``unknowns`` (n_contact, dim), m."""
    spring = 1 / contact.compliances[nodes]
    equations.spring[nodes] = spring
    equations.prescribed[nodes, 0] = False
    equations.change[nodes, 0] = 0.0
    # (A delta)_n + delta_n / e = q_n - (w_n - g_0) / e
    equations.force[nodes, 0] -= spring * (unknowns[nodes, 0] - contact.gap[nodes])


def _slip_along_held(
    contact: NodalContact, tau: np.ndarray, residual: np.ndarray, equations: Linearised
) -> Linearised:
    r"""Replace the equations, in place, of nodes that slip along a held first tangent, and return
    them all. There the support gives :math:`\tau_1 \ne 0`, and :math:`z = \tau_2/|\tau|`. The friction
    along the second tangent is :math:`q_2 = (s + \mu q_n)\,z`. A Newton step for :math:`|\tau|\,q_2 =
    (s + \mu q_n)\,\tau_2` (T. F. Chan, G. H. Golub, P. Mulet, SIAM J. Sci. Comput. 20, 1999,
    doi:10.1137/S1064827596299767) has

    .. math:: (A_2 - \mu z A_n + \kappa)\,\delta = q_2 - z\,(s + \mu q_n),\qquad
              \kappa = (s + \mu p - z\,q_2)/|\tau| ,

    with :math:`q_2` cut to its bound. With the derivative of z, :math:`(1 - z^2)/|\tau|`, three load steps of a
    punch on rollers with small :math:`\tau_1` take 30, 78 and 45 Newton steps in place of 4, 9 and 8.

    Along the first tangent the prescribed change is zero. ``tau`` (n_contact, 2), m, is the slip, and
    ``residual`` (n_contact, 3), N, has q in its columns."""
    at = contact.driven
    if len(at):
        size = np.linalg.norm(tau[at], axis=1)
        z = tau[at, 1] / size
        mu = np.where(equations.active[at], contact.friction[at], 0.0)
        bound = contact.limit[at] + mu * np.maximum(residual[at, 0], 0.0)
        equations.direction[at] = np.column_stack([np.zeros_like(z), z])
        equations.coupling[at] = mu
        equations.curvature[at] = 0.0
        friction = np.clip(residual[at, 2], -bound, bound)
        equations.curvature[at, 1, 1] = (bound - z * friction) / size
        equations.force[at, 1] = 0.0
        equations.force[at, 2] = residual[at, 2] - z * (contact.limit[at] + mu * residual[at, 0])
    return equations


def _clamped_equations(
    contact: NodalContact, unknowns: np.ndarray, residual: np.ndarray, aim: np.ndarray
) -> Linearised:
    """Return the equations of nodes with one unknown, at ``unknowns`` w and residuals q = b - A w, both
    (n_contact, 1). A node that would move beyond an obstacle, to its ``aim`` w + q / c (n_contact,), m,
    is active there. All count as slipping: no tangent holds them."""
    n = len(aim)
    target = contact.clamped(aim)
    # diverged unknowns are no numbers, which differ from themselves
    active = np.isfinite(target) & (target != aim)
    change = np.where(active, target - unknowns[:, 0], 0.0)
    return Linearised(
        active=active,
        slip=np.ones(n, dtype=bool),
        direction=np.empty((n, 0)),
        coupling=np.zeros(n),
        curvature=np.empty((n, 0, 0)),
        force=residual.copy(),
        prescribed=active[:, None],
        change=change[:, None],
        spring=np.zeros(n),
    )


def hold_all(contact: NodalContact, unknowns: np.ndarray, residual: np.ndarray) -> Linearised:
    """Return the equations, at unknowns and residuals (n_contact, dim) as of :func:`linearise`, by which
    every node that has an obstacle touches and, where the law has friction, sticks."""
    if contact.lowest is not None:
        nearer_below = contact.gap - unknowns[:, 0] > unknowns[:, 0] - contact.lowest
        aim = np.where(nearer_below, -np.inf, np.inf)
        return _clamped_equations(contact, unknowns, residual, aim)
    active = np.isfinite(contact.gap)
    slip = ~((contact.limit > 0) | (active & (contact.friction > 0)))
    zero = np.zeros(len(active))
    equations = _equations(
        contact,
        unknowns,
        residual,
        active,
        slip,
        trial=np.zeros_like(unknowns[:, 1:]),
        trial_size=zero,
        bound=zero,
        c_t=zero,
    )
    # the slip along a held tangent is that of the support
    equations.change[contact.driven, 1] = 0.0
    return equations


def _equations(
    contact: NodalContact,
    unknowns: np.ndarray,
    residual: np.ndarray,
    active: np.ndarray,
    slip: np.ndarray,
    trial: np.ndarray,
    trial_size: np.ndarray,
    bound: np.ndarray,
    c_t: np.ndarray,
) -> Linearised:
    r"""Set up the equations of the module's docstring, for the masks ``active`` and ``slip``
    (n_contact,), the slip force z_t (``trial`` (n_contact, dim - 1)) of length ``trial_size``, the bound
    B and c_t (all (n_contact,)), at ``unknowns`` w and ``residual`` q (n_contact, dim): ``direction`` is
    z, ``across`` the projection :math:`\Pi`, ``curvature`` :math:`\kappa\Pi`, ``coupling``
    :math:`\mu`, ``force`` the right side. A slip force of length 0 has no direction: its node moves
    freely."""
    moving = slip & (trial_size > 0)
    direction = np.where(moving[:, None], trial / np.where(moving, trial_size, 1.0)[:, None], 0.0)
    coupling = np.where(active & moving, contact.friction, 0.0)
    limit = np.where(moving, contact.limit, 0.0)
    excess = np.where(moving, trial_size - bound, 1.0)
    across = np.eye(trial.shape[1]) - direction[:, :, None] * direction[:, None, :]
    # kappa Pi with kappa = c_t B / (|z_t| - B)
    curvature = np.where(moving, c_t * bound / excess, 0.0)[:, None, None] * across
    along = np.sum(direction * residual[:, 1:], axis=1)
    stretch = np.where(moving, trial_size / excess, 1.0)[:, None]
    # z (z . q_t - s - mu q_n) + |z_t| / (|z_t| - B) Pi q_t
    force = residual.copy()
    force[:, 1:] = direction * (along - limit - coupling * residual[:, 0])[:, None]
    force[:, 1:] += stretch * np.einsum("nij,nj->ni", across, residual[:, 1:])
    prescribed = np.zeros(unknowns.shape, dtype=bool)
    prescribed[active, 0] = True
    prescribed[~slip, 1:] = True
    # delta_n = g_0 + e q_n - w_n where active, delta_t = -tau where it sticks
    change = np.zeros_like(unknowns)
    surface = contact.gap + contact.compliances * residual[:, 0]
    change[active, 0] = (surface - unknowns[:, 0])[active]
    change[~slip, 1:] = (contact.slip_reference - unknowns[:, 1:])[~slip]
    return Linearised(
        active=active,
        slip=slip,
        direction=direction,
        coupling=coupling,
        curvature=curvature,
        force=force,
        prescribed=prescribed,
        change=change,
        spring=np.zeros(len(active)),
    )
