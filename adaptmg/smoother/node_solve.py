r"""The exact solution of the contact problem of one node, in 2D and 3D, without regularisation.

With a symmetric positive definite block M (the diagonal block D over the relaxation factor: a
proximal step in the metric D / omega), a force c, component 0 normal and the slip :math:`\tau = w_t
- w_t^{ref}`, find w with
:math:`q = c - M w` (minus the force on the body) and

.. math:: w_n \le g_0,\quad p = q_n \ge 0,\quad p\,(g_0 - w_n) = 0,\qquad
          |q_t| \le s + \mu p,\quad |\tau|\,q_t = (s + \mu p)\,\tau .

One form holds for all laws: frictionless s = mu = 0, Tresca mu = 0, Coulomb s = 0. **The Tresca
limit s acts whether the node touches or not**, so that for mu = 0 this is the minimum of
:math:`\frac12 w'Mw - c'w + s|\tau|` over :math:`w_n \le g_0`; the Coulomb part acts only through p.

*Open* (p = 0): eliminate w_n; tangentially a shrinkage with the bound s. Kept if :math:`w_n \le
g_0`. Else *closed*: :math:`w_n = g_0`, :math:`p = p_0 - a\cdot\tau`, B the tangential block of M
and c_t the tangential force at zero slip: stick if :math:`|c_t| \le s + \mu p_0`, else slip in

- 2D: :math:`\tau = \sigma\,(|c_t| - s - \mu p_0) / (b - \sigma\mu a)`, :math:`\sigma =
  \mathrm{sign}\,c_t`;
- 3D: :math:`q_t = (I + \theta B)^{-1} c_t`, :math:`\tau = \theta q_t`, where the number
  :math:`\theta = |\tau| / |q_t| > 0` is the root of :math:`f(\theta) = (s + \mu p)/|q_t| - 1`, found by Newton's method
  inside a bracket. With B diagonalised a step costs a few operations; f is linear in :math:`\theta`
  when B is a multiple of the identity, and concave when mu = 0, so that Newton from zero rises
  monotonically to the root.

A compliant surface gives way by e p, e its ``compliance``: closed then means :math:`w_n = g_0 + e
p`. With :math:`\lambda = 1 / (1 + e M_{nn})` the closed problem keeps its form, with :math:`\lambda p_0`
for :math:`p_0`, :math:`\lambda a` for a, :math:`B - e \lambda\, a a^T` for B, and :math:`c_t - e \lambda p_0
a`.

A support may hold the first tangent of a node in 3D, which then slips by a given :math:`\tau_1`: M
must be decoupled there, and its entry :math:`M_{11}` is given with the sign turned. What is left is
one equation for :math:`\tau_2`, with the friction :math:`(s + \mu p)\,\tau_2/\sqrt{\tau_1^2 +
\tau_2^2}`, which has one root.

A node with one unknown (a scalar problem) has no tangent, but may have an obstacle on each side: w is
c / M, clamped. Its lowest value stands where others have the displacement of zero slip.

The bound is never lagged: p is p of the solution. A solution exists for every mu >= 0; in 2D it is
unique if
:math:`\mu|a| < b`. Where several exist the first of open, stick, slip is taken. If open is rejected, every root of the
closed problem with :math:`\max(0, p)` in place of p has p >= 0; the guards below only meet
rounding.

After an edit here delete the ``*.nbi`` files of the callers (smoother, multigrid) in
``__pycache__``: numba does not see across modules that a cached kernel is stale."""

from __future__ import annotations

import math

import numpy as np

from adaptmg._numba import inner_kernel, kernel
from adaptmg.smoother.blocks import in_loop, nothing, plus_symmetric, subtract

ONE, TWO = np.uint64(1), np.uint64(2)
EPSILON = float(np.finfo(np.float64).eps)
#: steps at most to the root of a node that slips: 71 000 random problems in 3D, with stiffnesses and forces over 16
#: orders of magnitude, take 59 at most with a held tangent, and 40 without
MAX_STEPS = 200


@in_loop
def solve(m, c, gap, reference, limit, friction, compliance):
    """Solve the problem of one node with dim = 1, 2 or 3 unknowns and return w.

    m: the upper triangle of M, row by row; c, w: tuples of dim components; reference: the dim - 1
    displacements of zero slip (dim = 1: the lowest value)."""
    if len(c) == 1:
        return (min(max(c[0] / m[0], reference[0]), gap),)
    if len(c) == 2:
        return solve_2d(
            m[0], m[1], m[2], c[0], c[1], gap, reference[0], limit, friction, compliance
        )
    return solve_3d(
        m[0],
        m[1],
        m[2],
        m[3],
        m[4],
        m[5],
        c[0],
        c[1],
        c[2],
        gap,
        reference[0],
        reference[1],
        limit,
        friction,
        compliance,
    )


@in_loop
def natural_at(d, r, w, gap, reference, limit, compliance):
    """Return the natural residual D (prox_D(w + D^-1 r) - w) of one node, with the constant bound
    ``limit`` on friction; d is the upper triangle of D."""
    moved = solve(d, plus_symmetric(r, d, w), gap, reference, limit, 0.0, compliance)
    change = subtract(moved, w)
    return plus_symmetric(nothing(w), d, change)


@in_loop
def read_reference(reference, k, like):
    """Return the tangential displacement of zero slip of contact node k, a tuple with one entry
    less than ``like``; of a node with one unknown its lowest value."""
    if len(like) < 3:
        return (reference[k],)
    return reference[TWO * k], reference[TWO * k + ONE]


@kernel
def solve_2d(
    m_nn: float,
    m_nt: float,
    m_tt: float,
    c_n: float,
    c_t: float,
    gap: float,
    reference: float,
    limit: float,
    friction: float,
    compliance: float = 0.0,
) -> tuple[float, float]:
    """Solve the problem of one node in 2D and return (w_n, w_t): try open, then stick, then slip. In the
    letters of the module, ``m_nn``, ``m_nt`` and ``m_tt`` are the entries of M, ``c_n`` and ``c_t`` those
    of c, ``gap`` is g_0, ``reference`` the w_t of zero slip, ``limit`` s, ``friction`` mu and
    ``compliance`` e; ``p_stick`` is p_0, the pressure without slip."""
    # from here on the tangential unknown is the slip
    c_n -= m_nt * reference
    c_t -= m_tt * reference
    # open: w_n is eliminated with p = 0
    ratio = m_nt / m_nn
    slip = _shrink(c_t - ratio * c_n, limit) / (m_tt - ratio * m_nt)
    w_n = c_n / m_nn - ratio * slip
    if w_n <= gap:
        return w_n, reference + slip
    # closed: w_n is eliminated; a compliant surface makes the pressure smaller and the tangent softer
    p_stick = c_n - m_nn * gap
    share = 1.0 / (1.0 + compliance * m_nn)  # lambda of the module; m_nt becomes lambda a, m_tt B
    c_t -= m_nt * (gap + compliance * share * p_stick)
    m_tt -= m_nt * compliance * share * m_nt
    p_stick *= share
    m_nt *= share
    force = abs(c_t)
    if force <= limit + friction * max(p_stick, 0.0):
        return gap + compliance * p_stick, reference
    sign = math.copysign(1.0, c_t)
    slope = m_tt - sign * friction * m_nt
    # without pressure, unless the slip with pressure leaves one
    slip = sign * (force - limit) / m_tt
    if slope > 0.0:
        with_pressure = sign * (force - limit - friction * p_stick) / slope
        if p_stick - m_nt * with_pressure > 0.0:
            slip = with_pressure
    return gap + compliance * (p_stick - m_nt * slip), reference + slip


@inner_kernel
def _shrink(value: float, bound: float) -> float:
    """Move ``value`` towards zero by ``bound``."""
    if value > bound:
        return value - bound
    if value < -bound:
        return value + bound
    return 0.0


@kernel
def solve_3d(
    m_nn: float,
    m_n1: float,
    m_n2: float,
    m_11: float,
    m_12: float,
    m_22: float,
    c_n: float,
    c_1: float,
    c_2: float,
    gap: float,
    reference_1: float,
    reference_2: float,
    limit: float,
    friction: float,
    compliance: float = 0.0,
) -> tuple[float, float, float]:
    """Solve the problem of one node in 3D, with tangents 1 and 2, and return (w_n, w_1, w_2); arguments
    are named as of :func:`solve_2d`."""
    if m_11 < 0.0:
        # a support holds the first tangent, along which the node slips by -reference_1; where that is 0 the
        # other tangent is that of a plane problem
        if reference_1 == 0.0:
            w_n, w_2 = solve_2d(
                m_nn, m_n2, m_22, c_n, c_2, gap, reference_2, limit, friction, compliance
            )
        else:
            w_n, w_2 = _solve_held(
                m_nn,
                m_n2,
                m_22,
                c_n,
                c_2,
                gap,
                reference_1,
                reference_2,
                limit,
                friction,
                compliance,
            )
        return w_n, 0.0, w_2
    c_n -= m_n1 * reference_1 + m_n2 * reference_2
    c_1 -= m_11 * reference_1 + m_12 * reference_2
    c_2 -= m_12 * reference_1 + m_22 * reference_2
    # open: w_n is eliminated with p = 0, so that a, p_0 and mu are 0
    ratio_1 = m_n1 / m_nn
    ratio_2 = m_n2 / m_nn
    slip_1, slip_2 = slip_3d(
        m_11 - ratio_1 * m_n1,
        m_12 - ratio_1 * m_n2,
        m_22 - ratio_2 * m_n2,
        c_1 - ratio_1 * c_n,
        c_2 - ratio_2 * c_n,
        0.0,
        0.0,
        0.0,
        limit,
        0.0,
    )
    w_n = c_n / m_nn - ratio_1 * slip_1 - ratio_2 * slip_2
    if not w_n <= gap:
        # closed: w_n = gap + compliance p; share is lambda of the module, and soft p_stick how far the
        # surface gives way without slip
        p_stick = c_n - m_nn * gap
        share = 1.0 / (1.0 + compliance * m_nn)
        soft = compliance * share
        w_n = gap + soft * p_stick
        slip_1, slip_2 = slip_3d(
            m_11 - m_n1 * soft * m_n1,
            m_12 - m_n1 * soft * m_n2,
            m_22 - m_n2 * soft * m_n2,
            c_1 - m_n1 * w_n,
            c_2 - m_n2 * w_n,
            share * m_n1,
            share * m_n2,
            share * p_stick,
            limit,
            friction,
        )
        w_n -= soft * (m_n1 * slip_1 + m_n2 * slip_2)
    return w_n, reference_1 + slip_1, reference_2 + slip_2


@kernel
def _solve_held(
    m_nn: float,
    m_nt: float,
    m_tt: float,
    c_n: float,
    c_t: float,
    gap: float,
    held_slip: float,
    reference: float,
    limit: float,
    friction: float,
    compliance: float,
) -> tuple[float, float]:
    """Solve as :func:`solve_2d` for a node that slips by ``held_slip``, of either sign, along its other
    tangent, which a support holds."""
    c_n -= m_nt * reference
    c_t -= m_tt * reference
    # open: w_n is eliminated with p = 0, so that a, p_0 and mu are 0
    ratio = m_nt / m_nn
    slip = _slip_held(m_tt - ratio * m_nt, c_t - ratio * c_n, 0.0, 0.0, held_slip, limit, 0.0)
    w_n = c_n / m_nn - ratio * slip
    if not w_n <= gap:
        # closed: w_n = gap + compliance p
        p_stick = c_n - m_nn * gap
        share = 1.0 / (1.0 + compliance * m_nn)
        soft = compliance * share
        w_n = gap + soft * p_stick
        slip = _slip_held(
            m_tt - m_nt * soft * m_nt,
            c_t - m_nt * w_n,
            share * m_nt,
            share * p_stick,
            held_slip,
            limit,
            friction,
        )
        w_n -= soft * m_nt * slip
    return w_n, reference + slip


@kernel
def _slip_held(
    b: float, c: float, a: float, p_stick: float, held_slip: float, limit: float, friction: float
) -> float:
    """Return the slip x along the free tangent, the root of

    c - b x - (limit + friction max(0, p_stick - a x)) x / sqrt(held_slip^2 + x^2)

    between 0 and c / b, by Newton's method inside a bracket. ``held_slip``, m, is the slip along the other
    tangent, which a support moves, not 0: with 0 the last factor, x / |x|, jumps at x = 0, where the node
    may stick. c is the tangential force, N, without slip, b > 0 the stiffness, N/m; the pressure is
    p_stick - a x."""
    low = min(0.0, c / b)
    high = max(0.0, c / b)
    slip = 0.0
    for _ in range(MAX_STEPS):
        slip_size = math.hypot(held_slip, slip)
        p = p_stick - a * slip
        bound = limit + friction * max(p, 0.0)
        excess = c - b * slip - bound * slip / slip_size
        if abs(excess) <= EPSILON * (abs(c) + b * abs(slip)):
            break
        if excess > 0.0:
            low = slip
        else:
            high = slip
        # minus the derivative of the excess; where it is not positive, ``low`` leads to a bisection
        slope = b + bound * (held_slip / slip_size) ** 2 / slip_size
        if p > 0.0:
            slope -= friction * a * slip / slip_size
        next_slip = slip + excess / slope if slope > 0.0 else low
        if not low < next_slip < high:
            next_slip = 0.5 * (low + high)
        if next_slip == slip or high - low <= EPSILON * max(abs(low), abs(high)):
            break
        slip = next_slip
    return slip


@kernel
def slip_3d(
    b_11: float,
    b_12: float,
    b_22: float,
    c_1: float,
    c_2: float,
    a_1: float,
    a_2: float,
    p_stick: float,
    limit: float,
    friction: float,
) -> tuple[float, float]:
    r"""Return the slip :math:`\tau` of a node in 3D: :math:`q_t = c - B\tau` is the friction within the
    bound :math:`s + \mu p`, :math:`p = \max(0, p_0 - a\cdot\tau)`."""
    if math.hypot(c_1, c_2) <= limit + friction * max(p_stick, 0.0):
        return 0.0, 0.0
    # Jacobi's rotation to the eigenbasis of B (tangent: of its angle); none where b_12 = 0, so that a
    # fixed, decoupled tangent stays at zero
    tangent = 0.0
    if b_12 != 0.0:
        cotangent = (b_22 - b_11) / (2.0 * b_12)
        tangent = math.copysign(1.0 / (abs(cotangent) + math.hypot(cotangent, 1.0)), cotangent)
    cosine = 1.0 / math.hypot(tangent, 1.0)
    sine = tangent * cosine
    turned_1, turned_2 = _slip_in_eigenbasis(
        b_11 - tangent * b_12,
        b_22 + tangent * b_12,
        cosine * c_1 - sine * c_2,
        sine * c_1 + cosine * c_2,
        cosine * a_1 - sine * a_2,
        sine * a_1 + cosine * a_2,
        p_stick,
        limit,
        friction,
    )
    return cosine * turned_1 + sine * turned_2, cosine * turned_2 - sine * turned_1


@inner_kernel
def _slip_in_eigenbasis(
    b_1: float,
    b_2: float,
    c_1: float,
    c_2: float,
    a_1: float,
    a_2: float,
    p_stick: float,
    limit: float,
    friction: float,
) -> tuple[float, float]:
    r"""Return what :func:`slip_3d` returns of a node that slips, where B = diag(b_1, b_2).

    Newton's method inside a bracket finds :math:`\theta = |\tau| / |q_t|`, at which the force
    :math:`|q_t|`, :math:`q_t = (I + \theta B)^{-1} c`, is the bound. In terms of the excess of the force
    over the bound its step is

    .. math:: -f / f' = \frac{|q_t| - \beta}{\beta' - \beta\,|q_t|' / |q_t|},\qquad
       f = \beta / |q_t| - 1,\quad \beta = s + \mu p,\quad p = p_0 - \theta\, a\cdot q_t ."""
    frictionless_1 = c_1 / b_1
    frictionless_2 = c_2 / b_2
    pressure = p_stick - a_1 * frictionless_1 - a_2 * frictionless_2
    # the slip without friction takes all pressure away: no friction is left
    if limit + friction * max(pressure, 0.0) == 0.0:
        return frictionless_1, frictionless_2
    theta = 0.0
    low = 0.0
    high = math.inf
    q_1 = c_1
    q_2 = c_2
    for _ in range(MAX_STEPS):
        scale_1 = 1.0 / (1.0 + theta * b_1)
        scale_2 = 1.0 / (1.0 + theta * b_2)
        q_1 = c_1 * scale_1
        q_2 = c_2 * scale_2
        force = math.hypot(q_1, q_2)
        coupling = a_1 * q_1 + a_2 * q_2
        p = p_stick - theta * coupling
        bound = limit + friction * max(p, 0.0)
        excess = force - bound
        # the size of what the excess sums: below its rounding there is no better root
        terms = force + limit + friction * (abs(p_stick) + theta * abs(coupling))
        if abs(excess) <= EPSILON * terms:
            break
        if excess > 0.0:
            low = theta
        else:
            high = theta
        # derivatives with respect to theta
        dq_1 = -b_1 * scale_1 * q_1
        dq_2 = -b_2 * scale_2 * q_2
        d_force = (q_1 * dq_1 + q_2 * dq_2) / force
        d_bound = 0.0
        if p > 0.0:
            d_bound = -friction * (coupling + theta * (a_1 * dq_1 + a_2 * dq_2))
        slope = d_bound - bound * d_force / force
        next_theta = math.inf
        if slope > 0.0:
            next_theta = theta + excess / slope
        if not low < next_theta < high:
            next_theta = _inside(low, high, max(b_1, b_2))
        if next_theta == theta or high - low <= EPSILON * low:
            break
        theta = next_theta
    return theta * q_1, theta * q_2


@inner_kernel
def _inside(low: float, high: float, stiffness: float) -> float:
    """Return a value of theta between two bounds whose orders of magnitude may differ; ``high`` may
    be +inf, ``low`` zero. The largest eigenvalue of B, ``stiffness``, sets the scale. Factors of 8, then
    geometric means, find the order of magnitude, then bisections the value."""
    if high == math.inf:
        return max(8.0 * low, 1.0 / stiffness)
    if low == 0.0:
        return 0.125 * high
    if high > 4.0 * low:
        return math.sqrt(low) * math.sqrt(high)
    return 0.5 * (low + high)
