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
from scipy import sparse

from adaptmg._numba import kernel
from adaptmg._threads import in_parts, sum_of_parts
from adaptmg.multigrid import projected_sweeps
from adaptmg.multigrid.half_sweeps import combine, dot, product_of_change, shorten, stiff_squares, zero_at
from adaptmg.multigrid.linear_cycle import LinearCycle
from adaptmg.multigrid.projected_sweeps import Interface
from adaptmg.multigrid.rigid_motions import RigidMotions
from adaptmg.multigrid.truncated_contact import TruncatedContact
from adaptmg.multigrid.truncation import Truncation
from adaptmg.smoother.blocks import ZERO


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
        self._transfer = cycle.transfer(number)
        self.motions, self._iterates = motions, Ring(len(unknowns), depth)
        self.unknowns, self.residual = unknowns, np.zeros_like(unknowns)
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
            self.motions.settle(self.unknowns, self._iterates.past, self.residual)

    def linearise(self, safe: bool, trusted: float = np.inf) -> StepState:
        """Update the contact status, truncate the residual and, where the status has changed, the coarse matrices.
        ``safe`` freezes g in the matrices, which keeps them symmetric; a residual above ``trusted`` (N) does the
        same."""
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
        """Correct, project and search; returns the energy of the coarse correction, N m. It estimates the energy of the
        error that the correction removes."""
        self._iterates.complete()
        proposed, energy = self._coarse_correction()
        before = self.contact.values.copy()
        self.contact.project(proposed)
        if self._frozen:
            self._search(proposed, before)
        self._iterates.advance()
        self.recombination.advance()
        self.cycle.recorder.visit(self.number, "prolong")
        return energy

    def set_aside(self, matrix: sparse.bsr_array, fixed: np.ndarray) -> None:
        """Free what only further steps read, if it is much: half of the matrix, which is made again from the whole one,
        and past iterates, without which recombination starts again."""
        if self.level.set_aside(matrix, fixed):
            self._iterates.forget()
            self.recombination.restart()

    @property
    def unknowns(self) -> np.ndarray:
        """The present iterate (n_dofs,)."""
        return self._iterates.now

    @unknowns.setter
    def unknowns(self, values: np.ndarray) -> None:
        self._iterates.now[:] = values
        self._corrected = False

    @property
    def smoothed(self) -> np.ndarray:
        """The iterate that the last :meth:`correct` started from (n_dofs,)."""
        return self._iterates.past[0]

    def _projected_sweeps(self) -> None:
        """A backward and a forward sweep in one pass over the matrix."""
        level, c = self.level, self.contact
        in_parts(_copy, len(self.load), 2 * len(self.load), self.load, self.residual)
        level.sweep(projected_sweeps.backward, *level.lower_arrays, level.inverse, c.contact_of, *c.node_data,
                    self.unknowns, self.residual, backward=True)
        level.sweep(projected_sweeps.forward, *level.lower_arrays, level.inverse, c.diagonal, c.contact_of,
                    *c.node_data, self.unknowns, self.residual)
        self.cycle.recorder.count(1.0, level.nonzeros)
        self.cycle.recorder.visit(self.number, "smooth", 2)

    def _interface_sweep(self, order: np.ndarray) -> None:
        c = self.contact
        projected_sweeps.local(ZERO[self.level.dim], order, *self.interface.arrays, self.level.inverse, c.contact_of,
                               *c.node_data, self.unknowns, self.residual)
        self.cycle.recorder.count(1.0, self.interface.nonzeros)

    def _restrict(self) -> float:
        """Restrict the truncated residual for the recombination; returns its sum of squares."""
        return self.cycle.restrict(self.number, self.residual, self.recombination.residuals.now)

    def _recombine(self, places: np.ndarray) -> np.ndarray:
        """Weights of the past iterates; makes the recombined residual."""
        alpha = self.recombination.fit(self.below.inverse)
        if alpha.any() and not self.contact.admits(self._iterates.flat, places, alpha):
            alpha[:] = 0.0
        self.recombination.combine(alpha)
        return alpha

    def _coarse_correction(self) -> tuple[np.ndarray, float]:
        """The recombined iterate plus the coarse correction (in place of the oldest), and the energy of that."""
        ring, load = self._iterates, self.recombination.residuals.combined
        places = ring.places(self.recombination.past)
        alpha = self._recombine(places)
        # past iterates make up for what a cheaper cycle leaves
        correction = self.cycle.solve(self.number - 1, load, smooth=not self._corrected)
        self._corrected = True
        energy = _product(load, correction)
        n = self.level.n_dofs
        in_parts(combine, len(self._transfer[1]) - 1, 6 * n, *self._transfer, correction, ring.flat, places, alpha,
                 *ring.targets)
        proposed = ring.past[-1]
        zero_at(proposed, self.level.fixed)
        return proposed, energy

    def _search(self, proposed: np.ndarray, before: np.ndarray) -> None:
        """Shorten the step to the least energy with g frozen, in place; costs half a pass."""
        curvature = self._energy_product(proposed)
        n = len(proposed)
        gain = sum_of_parts(product_of_change, n, 3 * n, self.residual, proposed, self.unknowns)

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
        return _product(self.unknowns, self.load) - _product(self.unknowns, self.residual)

    def distance(self, other: np.ndarray) -> float:
        return float(np.sqrt(max(self._energy_product(other), 0.0)))

    def _energy_product(self, other: np.ndarray) -> float:
        """Square of the A-norm of the difference to other unknowns; half a pass."""
        level, arrays = self.level, self.level.lower_arrays
        self.cycle.recorder.count(0.5, level.nonzeros)
        return sum_of_parts(projected_sweeps.energy_product, level.n_nodes, len(arrays[-1]), level.strips.order,
                            ZERO[level.dim], *arrays, level.inverse, self.unknowns, other)

    def rounding(self) -> float:
        """Norm of D u, D the diagonal, N: times the unit of rounding the least residual that arithmetic reaches."""
        level = self.level
        level.complete()
        return float(np.sqrt(sum_of_parts(stiff_squares, level.n_nodes, len(level.inverse), level.dim, level.inverse,
                                          self.unknowns)))


def _copy(first: int, last: int, source: np.ndarray, to: np.ndarray) -> None:
    to[first:last] = source[first:last]


def _product(a: np.ndarray, b: np.ndarray) -> float:
    """a'b."""
    return float(sum_of_parts(dot, len(a), 2 * len(a), a, b))


class Ring:
    """The last vectors (n,) of a sequence in one array, newest first: the present one, then in turns a recombined one
    and the one that it was made from. Two more take the places of the oldest.

    With recombined vectors alone, few are as good as all of them where the problem is symmetric; the others keep what
    Coulomb's law needs.
    """

    #: past vectors at most
    MOST = 4

    def __init__(self, n: int, depth: int) -> None:
        self._rows = max(depth, 2) + 1
        self._take(np.zeros((self._rows, n)))

    def _take(self, vectors: np.ndarray) -> None:
        self.vectors, self.flat, self._order = vectors, vectors.reshape(-1), list(range(len(vectors)))

    def forget(self) -> None:
        """Free all vectors but the present one, until :meth:`complete`."""
        self._take(self.now[None].copy())

    def complete(self) -> None:
        if len(self.vectors) < self._rows:
            now = self.now
            self._take(np.zeros((self._rows, len(now))))
            self.now[:] = now

    @property
    def now(self) -> np.ndarray:
        return self.vectors[self._order[0]]

    @property
    def past(self) -> list[np.ndarray]:
        return [self.vectors[k] for k in self._order[1:]]

    @property
    def combined(self) -> np.ndarray:
        """Where the present vector, recombined, goes."""
        return self.vectors[self._order[-2]]

    def places(self, past: int) -> np.ndarray:
        """Where in ``flat`` the present vector begins and the MOST before it; beyond ``past`` the present one."""
        rows = [self._order[k if k <= past else 0] for k in range(self.MOST + 1)]
        return np.array(rows, dtype=np.int64) * self.vectors.shape[1]

    @property
    def targets(self) -> tuple[int, int]:
        """The places of :attr:`combined` and of the next vector."""
        n = self.vectors.shape[1]
        return self._order[-2] * n, self._order[-1] * n

    def advance(self) -> None:
        *kept, combined, following = self._order
        self._order = [following, combined, *kept]


class Recombination:
    r"""The last restricted truncated residuals of one level, and the weights of the last iterates. The weights of
    :math:`u + \sum_j \alpha_j (u_j - u)` minimise :math:`\sum_k |R_0 + \sum_j \alpha_j (R_j - R_0)|_k^2 / d_k`, d the
    diagonal of the coarse matrix (Anderson acceleration). While the contact status stays, the residual is affine in u
    (3D: nearly)."""

    def __init__(self, dim: int, n_dofs: int, depth: int) -> None:
        self.dim, self.depth, self._past = dim, depth, 0
        self.residuals, self._alpha = Ring(n_dofs, depth), np.zeros(Ring.MOST)
        self._matrix = np.zeros((Ring.MOST, Ring.MOST))

    @property
    def past(self) -> int:
        """The number of iterates that can be recombined with the present one."""
        return min(self._past, self.depth)

    def restart(self) -> None:
        self._past = 0

    def fit(self, inverse: np.ndarray) -> np.ndarray:
        """The weights (MOST,), from the inverse diagonal blocks of the next coarser level."""
        self._alpha[:] = 0.0
        if self.past:
            ring = self.residuals
            n = len(self.residuals.now)
            # it computes more than it reads
            sums = sum_of_parts(_sums, n // self.dim, 20 * n, self.dim, inverse, ring.flat, ring.places(self.past))
            _fit(np.asarray(sums), self._matrix, self._alpha)
        return self._alpha

    def combine(self, alpha: np.ndarray) -> None:
        ring, n = self.residuals, len(self.residuals.now)
        in_parts(_combined, n, 6 * n, ring.flat, ring.places(self.past), alpha, ring.combined)

    def advance(self) -> None:
        self.residuals.advance()
        self._past += 2


#: the normal equations count as singular below this pivot, relative to the diagonal
_SINGULAR = 1e-10


@kernel
def _sums(begin, end, dim, inverse, ring, places):
    """What the normal equations of the weighted least squares problem sum over these nodes."""
    now, first, second, third, fourth = places
    a_11, a_12, a_13, a_14, a_22, a_23, a_24, a_33, a_34, a_44 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    b_1, b_2, b_3, b_4 = 0.0, 0.0, 0.0, 0.0
    for i in range(begin, end):
        for c in range(dim):
            at = dim * i + c
            weight, r = inverse[at * dim + c], ring[now + at]
            d_1, d_2 = ring[first + at] - r, ring[second + at] - r
            d_3, d_4 = ring[third + at] - r, ring[fourth + at] - r
            w_1, w_2, w_3, w_4 = weight * d_1, weight * d_2, weight * d_3, weight * d_4
            a_11 += w_1 * d_1
            a_12 += w_1 * d_2
            a_13 += w_1 * d_3
            a_14 += w_1 * d_4
            a_22 += w_2 * d_2
            a_23 += w_2 * d_3
            a_24 += w_2 * d_4
            a_33 += w_3 * d_3
            a_34 += w_3 * d_4
            a_44 += w_4 * d_4
            b_1 -= w_1 * r
            b_2 -= w_2 * r
            b_3 -= w_3 * r
            b_4 -= w_4 * r
    return a_11, a_12, a_13, a_14, a_22, a_23, a_24, a_33, a_34, a_44, b_1, b_2, b_3, b_4


@kernel
def _fit(sums, matrix, alpha):
    """Solve the normal equations for the weights ``alpha`` (4,); 0 for residuals that depend on newer ones. ``matrix``
    (4, 4) is overwritten."""
    at = 0
    for k in range(4):
        for j in range(k, 4):
            matrix[k, j] = matrix[j, k] = sums[at]
            at += 1
        alpha[k] = sums[10 + k]
    at = 0  # of the diagonal
    for k in range(4):
        if not matrix[k, k] > _SINGULAR * sums[at]:
            for j in range(4):
                matrix[k, j] = matrix[j, k] = 0.0
            matrix[k, k], alpha[k] = 1.0, 0.0
        at += 4 - k
        for j in range(k + 1, 4):
            factor = matrix[j, k] / matrix[k, k]
            alpha[j] -= factor * alpha[k]
            for c in range(k, 4):
                matrix[j, c] -= factor * matrix[k, c]
    for k in range(3, -1, -1):
        for j in range(k + 1, 4):
            alpha[k] -= matrix[k, j] * alpha[j]
        alpha[k] /= matrix[k, k]


@kernel
def _combined(begin, end, ring, places, alpha, result):
    now, first, second, third, fourth = places
    for at in range(begin, end):
        r = ring[now + at]
        result[at] = r + alpha[0] * (ring[first + at] - r) + alpha[1] * (ring[second + at] - r) + alpha[2] * (
            ring[third + at] - r) + alpha[3] * (ring[fourth + at] - r)
