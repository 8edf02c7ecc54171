r"""The energy error of a displacement and of pressures of groups, where a problem has volumes.

With the contact status held the error (y, q) of displacement and pressures solves

.. math:: K(I + D)(K' y + B^T q) + K S y = e,\qquad -B y + A\,q/\kappa = -A\,(b\,v - p/\kappa),

with K, D, S and e of :mod:`adaptmg.solver.energy_error`; its energy is :math:`y'K'y + \sum A q^2/\kappa`, that of the
whole displacement where :math:`p = \kappa\,b\,u`. A Galerkin solution in the span of preconditioned residuals is
sought: z, what the preconditioner of K' makes of the forces, and :math:`(A s + B z)/(A/\kappa + A/(\lambda_1 + \mu))`,
s the volumes that are missed. The symmetric part of the equations is the energy: directions are orthonormal in it, and
a direction of pressures alone, whose energy may vanish, does not occur.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg.blas import daxpy

from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.solver.aggregates import Aggregates
from adaptmg.solver.energy_error import (
    FACTORISED,
    FREE,
    SURER,
    FrozenStatus,
    HeldCorrection,
    Preconditioner,
    frozen_matrices,
    refined,
)

#: least and most steps, and the share of the energy by which each of the last two may have changed it
_LEAST, _MOST, _SETTLED = 3, 24, 0.1


@dataclass(frozen=True, eq=False)
class _Direction:
    """Displacement and pressures, their energy products with others, what the equations make of them, and both the
    displacement and the forces (2, n_contact, dim) at contact nodes."""

    values: np.ndarray
    energetic: np.ndarray
    image: np.ndarray
    at_contact: np.ndarray

    def minus(self, factor: float, other: _Direction) -> None:
        # BLAS takes no empty arrays
        for name in ("values", "energetic", "image", *["at_contact"] * (self.at_contact.size > 0)):
            daxpy(getattr(other, name).reshape(-1), getattr(self, name).reshape(-1), a=-factor)

    def scale(self, factor: float) -> None:
        for vector in (self.values, self.energetic, self.image, self.at_contact):
            vector *= factor


class _Equations:
    """The equations of a status; the signs of the second ones make them positive."""

    def __init__(self, problem: DiscreteProblem, status: FrozenStatus) -> None:
        self.volumes, self.status = problem.volumes, status
        self.soft = self.volumes.areas * self.volumes.compliance
        self.stiff = self.soft + self.volumes.areas / self.volumes.modulus

    def direction(self, nodal: np.ndarray, forces: np.ndarray, missed: np.ndarray) -> _Direction:
        """Return a direction from its displacement, K' times it, and what is left of the volumes."""
        at, status = self.status.nodes, self.status
        volumes = self.volumes.rows @ nodal.reshape(-1)
        pressures = (missed + volumes) / self.stiff
        exerted = self.volumes.forces(pressures).reshape(nodal.shape)
        at_contact = np.stack([nodal[at], forces[at] + exerted[at]])
        forces[at] += np.einsum("nij,nj->ni", status.stiffening, nodal[at])
        energetic = np.append(forces, self.soft * pressures)
        exerted += forces
        exerted[at] += np.einsum("nij,nj->ni", status.dragged, at_contact[1])
        status.project(exerted)
        return _Direction(np.append(nodal, pressures), energetic,
                          np.append(exerted, self.soft * pressures - volumes), at_contact)


def mixed_correction(problem: DiscreteProblem, missed: np.ndarray, diagonal: np.ndarray, status: FrozenStatus,
                     residual: np.ndarray, aggregates: Aggregates | None, negligible: float, rounding: float
                     ) -> HeldCorrection:
    """Correct as :func:`adaptmg.solver.energy_error.correction` does, with the volumes ``missed`` (n_groups,)."""
    volumes = problem.volumes
    status.project(residual)
    left = np.append(residual, -volumes.areas * missed)
    if not 0.0 < left @ left < np.inf:
        none = np.zeros((len(status.nodes), problem.dim))
        return HeldCorrection(0.0 if left @ left == 0.0 else np.inf, none, none)
    if aggregates is not None:
        precondition = Preconditioner(problem.matrix, diagonal, status, aggregates)
        found, settled = _estimated(_Equations(problem, status), precondition, left, residual.shape, negligible)
        if settled or problem.n_dofs > FACTORISED[problem.dim]:
            return found
    return _factorised(problem, status, left, rounding)


def _estimated(equations: _Equations, precondition: Preconditioner, load: np.ndarray, shape: tuple[int, int],
               negligible: float) -> tuple[HeldCorrection, bool]:
    """A Galerkin solution, and whether further steps would change it little."""
    n, span, before, left = shape[0] * shape[1], list[_Direction](), [np.inf, np.inf], load
    matrix, shares = np.empty((_MOST, _MOST)), np.empty(0)
    for step in range(1, _MOST + 1):
        new = equations.direction(*precondition(left[:n].reshape(shape)), left[n:])
        product = float(left[:n] @ new.values[:n])
        for other in span:
            new.minus(float(other.values @ new.energetic), other)
        square = float(new.values @ new.energetic)
        if not square > FREE * product:
            return _found(new, span, shares, float("inf")), False
        new.scale(1 / np.sqrt(square))
        span.append(new)
        for k, other in enumerate(span):
            matrix[k, step - 1], matrix[step - 1, k] = other.values @ new.image, new.values @ other.image
        try:
            shares = np.linalg.solve(matrix[:step, :step], [one.values @ load for one in span])
        except np.linalg.LinAlgError:
            return _found(new, span, shares, float("inf")), False
        left = load.copy()
        for share, one in zip(shares, span, strict=True):
            daxpy(one.image, left, a=-share)
        energy = float(shares @ shares)
        if (min(step, _LEAST) * SURER) ** 2 * energy <= negligible:
            return _found(new, span, shares, energy), True
        if step >= _LEAST and max(abs(energy - last) for last in before) <= _SETTLED * energy:
            return _found(new, span, shares, energy), True
        before = [before[1], energy]
    return _found(new, span, shares, energy), False


def _found(last: _Direction, span: list[_Direction], shares: np.ndarray, energy: float) -> HeldCorrection:
    total = sum((share * one.at_contact for share, one in zip(shares, span, strict=False)), 0 * last.at_contact)
    return HeldCorrection(energy, *total)


def _factorised(problem: DiscreteProblem, status: FrozenStatus, load: np.ndarray, rounding: float) -> HeldCorrection:
    volumes, n = problem.volumes, problem.n_dofs
    taken, keep, upper, shift = frozen_matrices(problem.matrix, status)
    whole = sparse.block_array([[upper, taken @ volumes.columns],
                                [-volumes.rows @ keep, sparse.diags_array(volumes.areas * volumes.compliance)]])
    found, balanced = refined(whole, np.append(shift, np.zeros(len(volumes))), load, n, rounding)
    image, pressures = problem.matrix @ found[:n], found[n:]
    energy = max(float(found[:n] @ image), 0.0) + volumes.energy(pressures) if balanced else float("inf")
    nodal, forces = (one.reshape(-1, problem.dim)[status.nodes]
                     for one in (found[:n], image + volumes.forces(pressures)))
    return HeldCorrection(energy, nodal, forces)
