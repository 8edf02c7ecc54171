"""TruncatedCycle: the cycle of the truncated nonsmooth Newton multigrid on one level."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from adaptmg.multigrid import projected_sweeps
from adaptmg.multigrid.coarse_transfer import combine, dot, product_of_change, restrict, shorten, zero_at
from adaptmg.multigrid.interface import Interface
from adaptmg.multigrid.linear_cycle import LinearCycle
from adaptmg.multigrid.local_sweeps import local
from adaptmg.multigrid.obstacle import Obstacle
from adaptmg.multigrid.recombination import Recombination
from adaptmg.multigrid.rigid_motions import RigidMotions
from adaptmg.multigrid.truncation import Truncation
from adaptmg.smoother.blocks import ZERO

__all__ = ["Look", "TruncatedCycle"]


@dataclass(frozen=True)
class Look:
    """What is known after the smoothing of a cycle.

    Attributes
    ----------
    changed : int
        Contact nodes whose status changed.
    residual : float
        Euclidean norm of the natural residual, N.
    reactions : float
        Norm of the contact forces, N.
    """

    changed: int
    residual: float
    reactions: float


class TruncatedCycle:
    """Cycles on level ``number`` of the levels of a linear cycle, with contact.

    Parameters
    ----------
    cycle : LinearCycle
        Levels and coarse cycles.
    number : int
        >= 1.
    obstacle : Obstacle
    load : (n_dofs,) array
        Cartesian, zero at fixed dofs.
    unknowns : (n_dofs,) array
        Start, Cartesian, counted from the prescribed values; admissible.
    depth : int
        Of the recombination.
    motions : RigidMotions, optional
        Those that contact alone holds.
    interface : Interface, optional
        Between bodies.
    interface_sweeps : int
        Local sweeps over it after each smoothing.
    """

    def __init__(self, cycle: LinearCycle, number: int, obstacle: Obstacle, load: np.ndarray, unknowns: np.ndarray,
                 depth: int, motions: RigidMotions | None = None, interface: Interface | None = None,
                 interface_sweeps: int = 0) -> None:
        self.cycle, self.number, self.obstacle, self.load = cycle, number, obstacle, load
        self.level, self.below = cycle.levels[number], cycle.levels[number - 1]
        self.truncation = Truncation(cycle.levels[:number + 1], cycle.prolongations[:number], obstacle)
        self.recombination = Recombination(self.below.dim, self.below.n_dofs, depth)
        self._components = ZERO[self.level.n_dofs // cycle.prolongations[number - 1].shape[0]]
        self.unknowns, self.motions = unknowns, motions
        self._past = [np.zeros_like(unknowns), np.zeros_like(unknowns)]
        self.defect = np.zeros_like(unknowns)
        self.cuts = 0
        self._symmetric = False
        self.interface, self._interface_sweeps = interface, 0 if interface is None else interface_sweeps

    @property
    def nbytes(self) -> int:
        """Memory of what the cycle adds to the linear one, bytes."""
        vectors = 5 * self.unknowns.nbytes + 3 * self.recombination.now.nbytes
        own = vectors + self.obstacle.nbytes + self.truncation.nbytes
        return own + (self.interface.nbytes if self.interface is not None else 0)

    def rounding(self) -> float:
        """Norm of D u, D the diagonal: times the unit of rounding, what a residual cannot be better than, N."""
        dim = self.level.dim
        diagonal = self.level.inverse.reshape(-1, dim, dim).diagonal(axis1=1, axis2=2).reshape(-1)
        stiffness = np.divide(1.0, diagonal, where=diagonal > 0, out=np.zeros_like(diagonal))
        forces = stiffness * self.unknowns
        return float(np.sqrt(dot(forces, forces)))

    def smooth(self) -> None:
        """A backward and a forward projected sweep, one pass, and local ones; leaves f - A u in ``defect``.

        Rigid motions that the contact status then leaves free go to the least energy.
        """
        level, o, zero = self.level, self.obstacle, ZERO[self.level.dim]
        projected_sweeps.backward(zero, *level.lower_arrays, level.inverse, self.load, o.contact_of, *o.node_data,
                                  self.unknowns, self.defect)
        projected_sweeps.forward(zero, *level.lower_arrays, level.inverse, o.diagonal, o.contact_of, *o.node_data,
                                 self.unknowns, self.defect)
        self.cycle.recorder.count(1.0, level.nonzeros)
        self.cycle.recorder.visit(self.number, "smooth", 2)
        for k in range(self._interface_sweeps):
            order = self.interface.backward if k % 2 == 0 else self.interface.forward
            local(zero, order, *self.interface.arrays, level.inverse, o.contact_of, *o.node_data, self.unknowns,
                  self.defect)
            self.cycle.recorder.count(1.0, self.interface.nonzeros)
        if self.motions is not None:
            self.motions.settle(self.unknowns, self._past, self.defect)

    def look(self, safe: bool, trusted: float = np.inf) -> Look:
        """Find the status, truncate and restrict the residual; the matrices below follow the status.

        ``safe`` freezes g in them, which keeps them symmetric; a residual above ``trusted`` (N) does the same.
        """
        o, nodal = self.obstacle, self.cycle.prolongations[self.number - 1]
        status = o.look(self.defect)
        squares = o.truncate(self.defect)
        now = self.recombination.now
        total = restrict(self._components, nodal.indptr, nodal.indices, nodal.data, self.defect, now)
        zero_at(now, self.below.fixed)
        self.cycle.recorder.visit(self.number, "restrict")
        residual = float(np.sqrt(max(total - squares, 0.0) + status.natural))
        safe = safe or residual > trusted
        if status.changed or safe != self._symmetric:
            o.renew_directions()
            self.truncation.apply(newton=not safe)
            self.cycle.factors.renew()
            self.recombination.restart()
            self._symmetric = safe
        return Look(status.changed, residual, float(np.sqrt(status.reactions)))

    def correct(self) -> float:
        """Coarse correction with recombination, in safe cycles with a line search; returns its energy, N m.

        The energy is that of the correction proposed by the next coarser level, an estimate of the error it removes.
        """
        o, below, nodal = self.obstacle, self.cycle.vectors(self.number - 1), self.cycle.prolongations[self.number - 1]
        first, second = self._past
        alpha = self.recombination.fit(self.below.inverse)
        if alpha != (0.0, 0.0) and not o.admits(self.unknowns, first, second, alpha):
            alpha = (0.0, 0.0)
        self.recombination.combine(alpha, below.load)
        correction = self.cycle.solve(self.number - 1)
        energy = float(dot(below.load, correction))
        combine(self._components, nodal.indptr, nodal.indices, nodal.data, correction, self.unknowns, first, second,
                                *alpha)
        zero_at(second, self.level.fixed)
        before = o.values.copy()
        self.cuts = o.project(second)
        if self._symmetric:
            self._search(second, before)
        self.unknowns, self._past = second, [self.unknowns, first]
        self.recombination.advance()
        self.cycle.recorder.visit(self.number, "prolong")
        return energy

    def _search(self, proposed: np.ndarray, before: np.ndarray) -> None:
        """Shorten the step to the least energy with g frozen, in place; costs half a pass."""
        o, curvature = self.obstacle, self._energy_product(proposed)
        gain = product_of_change(self.defect, proposed, self.unknowns)

        def slope(alpha: float) -> float:
            return alpha * curvature - gain + o.friction_slope(before, alpha)

        if slope(1.0) <= 0.0:
            return
        low, high = 0.0, 1.0
        for _ in range(30):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if slope(middle) > 0.0 else (middle, high)
        shorten(low, self.unknowns, proposed)
        o.values[:] = before
        o.project(proposed)

    def energy(self) -> float:
        """u'Au - u'r = u'f at the present unknowns and residual f - A u (before :meth:`look`), N m."""
        return float(dot(self.unknowns, self.load) - dot(self.unknowns, self.defect))

    def distance(self, other: np.ndarray) -> float:
        """A-norm of the difference to other unknowns; half a pass."""
        return float(np.sqrt(max(self._energy_product(other), 0.0)))

    def _energy_product(self, other: np.ndarray) -> float:
        """Square of the A-norm of the difference to other unknowns; half a pass."""
        level = self.level
        self.cycle.recorder.count(0.5, level.nonzeros)
        return projected_sweeps.energy_product(ZERO[level.dim], *level.lower_arrays, level.inverse, self.unknowns,
                                               other)
