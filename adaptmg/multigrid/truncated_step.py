r"""TruncatedStep: one step of the truncated nonsmooth Newton multigrid, on one level and those below it.

1. *Smoother* (:meth:`~TruncatedStep.smooth`): a backward and a forward projected Gauss-Seidel sweep, local sweeps over
   the interface between bodies, and the rigid motions that only contact holds go to their least energy.
2. *Linearisation* (:meth:`~TruncatedStep.linearise`): update the contact status, drop closed normals and held tangents
   from the residual, and truncate the coarse matrices where the status has changed.
3. *Coarse correction*: a linear V-cycle on the truncated coarse problem, from a recombination of the last iterates.
4. *Projection* onto the admissible displacements.
5. *Search* for the least energy along the correction, where the friction is frozen.

With frozen friction this is a truncated nonsmooth Newton multigrid method (C. Graeser, R. Kornhuber, J. Comput. Math.
27, 2009); the Newton rows of Coulomb's law and the recombination make it faster.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from adaptmg._runtime import kernel
from adaptmg.multigrid import projected_sweeps
from adaptmg.multigrid.half_sweeps import combine, dot, product_of_change, restrict, shorten, stiff_squares, zero_at
from adaptmg.multigrid.linear_cycle import LinearCycle
from adaptmg.multigrid.projected_sweeps import Interface
from adaptmg.multigrid.rigid_motions import RigidMotions
from adaptmg.multigrid.truncated_contact import TruncatedContact
from adaptmg.multigrid.truncation import Truncation
from adaptmg.smoother.blocks import ZERO

__all__ = ["Recombination", "StepState", "TruncatedStep"]


@dataclass(frozen=True)
class StepState:
    """The iterate after the linearisation."""

    changed: int  # contact nodes whose status changed
    residual: float  # Euclidean norm of the natural residual, N
    reactions: float  # norm of the contact forces, N


class TruncatedStep:
    """Steps on level ``number`` of the levels of a linear cycle, with contact."""

    #: of the interval in the search for the least energy
    HALVINGS = 30

    def __init__(self, cycle: LinearCycle, number: int, contact: TruncatedContact, load: np.ndarray,
                 unknowns: np.ndarray, depth: int, motions: RigidMotions | None = None,
                 interface: Interface | None = None, interface_sweeps: int = 0) -> None:
        self.cycle, self.number, self.contact, self.load = cycle, number, contact, load
        self.level, self.below = cycle.levels[number], cycle.levels[number - 1]
        self.truncation = Truncation(cycle.levels[:number + 1], cycle.prolongations[:number], contact)
        self.recombination = Recombination(self.below.dim, self.below.n_dofs, depth)
        nodal = cycle.prolongations[number - 1]
        # the zeros of a prolongation's components, and its arrays: what the kernels of transfer take first
        self._transfer = ZERO[self.level.n_dofs // nodal.shape[0]], nodal.indptr, nodal.indices, nodal.data
        self.unknowns, self.motions = unknowns, motions
        self._past = [np.zeros_like(unknowns), np.zeros_like(unknowns)]
        self.residual = np.zeros_like(unknowns)
        self._frozen = False
        self.interface, self._interface_sweeps = interface, 0 if interface is None else interface_sweeps

    def step(self, trusted: Callable[[np.ndarray], float]) -> StepState:
        """Do one step; ``trusted`` gives the limit of :meth:`linearise` for the smoothed unknowns."""
        self.smooth()
        state = self.linearise(safe=False, trusted=trusted(self.unknowns))
        self.correct()
        return state

    def smooth(self) -> None:
        """Improve the iterate locally; leaves f - A u in ``residual``."""
        self._projected_sweeps()
        for k in range(self._interface_sweeps):
            self._interface_sweep(self.interface.backward if k % 2 == 0 else self.interface.forward)
        if self.motions is not None:
            self.motions.settle(self.unknowns, self._past, self.residual)

    def linearise(self, safe: bool, trusted: float = np.inf) -> StepState:
        """Update the contact status, truncate the residual and, where the status has changed, the coarse matrices.

        ``safe`` freezes g in the matrices, which keeps them symmetric; a residual above ``trusted`` (N) does the same.
        """
        status = self.contact.update_status(self.residual)
        at_contact = self.contact.truncate(self.residual)
        elsewhere = max(self._restrict() - at_contact, 0.0)
        residual = float(np.sqrt(elsewhere + status.natural))
        frozen = safe or residual > trusted
        if status.changed or frozen != self._frozen:
            self.contact.linearise_friction()
            self.truncation.apply(newton=not frozen)
            self.cycle.renew(self.number)
            self.recombination.restart()
            self._frozen = frozen
        return StepState(status.changed, residual, float(np.sqrt(status.reactions)))

    def correct(self) -> float:
        """Correct, project and search; returns the energy of the coarse correction, N m.

        It estimates the energy of the error that the correction removes.
        """
        proposed, energy = self._coarse_correction()
        before = self.contact.values.copy()
        self.contact.project(proposed)
        if self._frozen:
            self._search(proposed, before)
        self.unknowns, self._past = proposed, [self.unknowns, self._past[0]]
        self.recombination.advance()
        self.cycle.recorder.visit(self.number, "prolong")
        return energy

    @property
    def smoothed(self) -> np.ndarray:
        """The iterate that the last :meth:`correct` started from (n_dofs,)."""
        return self._past[0]

    def _projected_sweeps(self) -> None:
        """A backward and a forward sweep in one pass over the matrix."""
        level, c, zero = self.level, self.contact, ZERO[self.level.dim]
        projected_sweeps.backward(zero, *level.lower_arrays, level.inverse, self.load, c.contact_of, *c.node_data,
                                  self.unknowns, self.residual)
        projected_sweeps.forward(zero, *level.lower_arrays, level.inverse, c.diagonal, c.contact_of, *c.node_data,
                                 self.unknowns, self.residual)
        self.cycle.recorder.count(1.0, level.nonzeros)
        self.cycle.recorder.visit(self.number, "smooth", 2)

    def _interface_sweep(self, order: np.ndarray) -> None:
        c = self.contact
        projected_sweeps.local(ZERO[self.level.dim], order, *self.interface.arrays, self.level.inverse, c.contact_of,
                               *c.node_data, self.unknowns, self.residual)
        self.cycle.recorder.count(1.0, self.interface.nonzeros)

    def _restrict(self) -> float:
        """Restrict the truncated residual for the recombination; returns its sum of squares."""
        total = restrict(*self._transfer, self.residual, self.recombination.now)
        zero_at(self.recombination.now, self.below.fixed)
        self.cycle.recorder.visit(self.number, "restrict")
        return total

    def _recombine(self, first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
        """Weights of the two past iterates; the load of the next coarser level becomes that of the recombination."""
        alpha = self.recombination.fit(self.below.inverse)
        if alpha != (0.0, 0.0) and not self.contact.admits(self.unknowns, first, second, alpha):
            alpha = (0.0, 0.0)
        self.recombination.combine(alpha, self.cycle.vectors(self.number - 1).load)
        return alpha

    def _coarse_correction(self) -> tuple[np.ndarray, float]:
        """The recombined iterate plus the coarse correction (in place of the oldest), and the energy of that."""
        first, proposed = self._past
        alpha = self._recombine(first, proposed)
        correction = self.cycle.solve(self.number - 1)
        energy = float(dot(self.cycle.vectors(self.number - 1).load, correction))
        combine(*self._transfer, correction, self.unknowns, first, proposed, *alpha)
        zero_at(proposed, self.level.fixed)
        return proposed, energy

    def _search(self, proposed: np.ndarray, before: np.ndarray) -> None:
        """Shorten the step to the least energy with g frozen, in place; costs half a pass."""
        curvature = self._energy_product(proposed)
        gain = product_of_change(self.residual, proposed, self.unknowns)

        def slope(part: float) -> float:
            return part * curvature - gain + self.contact.friction_slope(before, part)

        if not slope(1.0) <= 0.0:
            low, high = 0.0, 1.0
            for _ in range(self.HALVINGS):
                middle = 0.5 * (low + high)
                low, high = (low, middle) if slope(middle) > 0.0 else (middle, high)
            shorten(low, self.unknowns, proposed)
            self.contact.values[:] = before
            self.contact.project(proposed)

    def energy(self) -> float:
        """u'Au - u'r = u'f at the present unknowns and residual f - A u (before :meth:`linearise`), N m."""
        return float(dot(self.unknowns, self.load) - dot(self.unknowns, self.residual))

    def distance(self, other: np.ndarray) -> float:
        return float(np.sqrt(max(self._energy_product(other), 0.0)))

    def _energy_product(self, other: np.ndarray) -> float:
        """Square of the A-norm of the difference to other unknowns; half a pass."""
        level = self.level
        self.cycle.recorder.count(0.5, level.nonzeros)
        return projected_sweeps.energy_product(ZERO[level.dim], *level.lower_arrays, level.inverse, self.unknowns,
                                               other)

    def rounding(self) -> float:
        """Norm of D u, D the diagonal, N: times the unit of rounding the least residual that arithmetic reaches."""
        return float(np.sqrt(stiff_squares(self.level.dim, self.level.inverse, self.unknowns)))


class Recombination:
    r"""The last restricted truncated residuals of one level, and the weights of the last iterates.

    The weights of :math:`u + \alpha_1 (u_1 - u) + \alpha_2 (u_2 - u)` minimise
    :math:`\sum_k |R_0 + \alpha_1 (R_1 - R_0) + \alpha_2 (R_2 - R_0)|_k^2 / d_k`, d the diagonal of the coarse matrix
    (Anderson acceleration of depth 2). While the contact status stays, the residual is affine in u (3D: nearly).
    """

    #: the normal equations count as singular below this relative determinant
    SINGULAR = 1e-10

    def __init__(self, dim: int, n_dofs: int, depth: int) -> None:
        self.dim, self.depth, self.past = dim, depth, 0
        self._residuals = [np.zeros(n_dofs) for _ in range(3)]
        self._equations = np.zeros(5)

    @property
    def now(self) -> np.ndarray:
        """Where the residual of the present iterate goes."""
        return self._residuals[0]

    def restart(self) -> None:
        self.past = 0

    def fit(self, inverse: np.ndarray) -> tuple[float, float]:
        """The weights, from the inverse diagonal blocks of the next coarser level."""
        past = min(self.past, self.depth)
        if past == 0:
            return 0.0, 0.0
        _normal_equations(self.dim, inverse, *self._residuals, self._equations)
        a_11, a_12, a_22, b_1, b_2 = self._equations
        determinant = a_11 * a_22 - a_12 * a_12
        if past > 1 and determinant > self.SINGULAR * a_11 * a_22:
            return (b_1 * a_22 - b_2 * a_12) / determinant, (a_11 * b_2 - a_12 * b_1) / determinant
        return (b_1 / a_11, 0.0) if a_11 > 0.0 else (0.0, 0.0)

    def combine(self, alpha: tuple[float, float], result: np.ndarray) -> None:
        _combined(*self._residuals, *alpha, result)

    def advance(self) -> None:
        a, b, c = self._residuals
        self._residuals = [c, a, b]
        self.past += 1


@kernel
def _normal_equations(dim, inverse, now, first, second, result):
    """The entries a_11, a_12, a_22, b_1, b_2 of the weighted least squares problem."""
    a_11, a_12, a_22, b_1, b_2 = 0.0, 0.0, 0.0, 0.0, 0.0
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
    result[0], result[1], result[2], result[3], result[4] = a_11, a_12, a_22, b_1, b_2


@kernel
def _combined(now, first, second, alpha_1, alpha_2, result):
    for at in range(len(now)):
        result[at] = now[at] + alpha_1 * (first[at] - now[at]) + alpha_2 * (second[at] - now[at])
