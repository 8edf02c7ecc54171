r"""VolumePressures: the pressures of the groups of :mod:`adaptmg.discrete.volumes` through the cycles of one level.

A cycle is the ordinary truncated one on K' with the load f - B'p; after its correction

.. math:: p \leftarrow p + \theta\,\frac{b\,u - p/\kappa}{1/\kappa + 1/(\lambda_1 + \mu)},\qquad \theta = 1,

:math:`\theta = 1/2` for two steps after the contact status has changed. The recombination of
:class:`~adaptmg.multigrid.truncated_step.TruncatedStep` takes u and p together: what the volumes miss counts with the
energy :math:`A\,(\lambda_1 + \mu)\,(b\,u - p/\kappa)^2`. A uniform pressure in each body is a further direction: steps
alone would find the mean pressure of an enclosed body in :math:`\kappa/(\lambda_1 + \mu)` cycles. So the number of
cycles hardly depends on Poisson's ratio.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from adaptmg.discrete.problem import DiscreteProblem


class VolumePressures:
    """The pressures of one level, ``values`` (n_groups,), Pa."""

    #: share of a step after a change of the status, and number of such steps
    CAUTIOUS, STEPS = 0.5, 2

    def __init__(self, problem: DiscreteProblem, start: np.ndarray | None = None) -> None:
        volumes, free = problem.volumes, (~problem.fixed).astype(float)
        rows = sparse.csr_array((volumes.rows.data * free[volumes.rows.indices], volumes.rows.indices,
                                 volumes.rows.indptr), shape=volumes.rows.shape)
        self.volumes, self._cautious = replace(volumes, rows=rows, expansion=0.0), 0
        self.values = np.zeros(len(volumes))
        self.pose(problem, start)

    def pose(self, problem: DiscreteProblem, start: np.ndarray | None) -> None:
        """Take over prescribed values and initial strains of another load step, and pressures if there are any."""
        if start is not None:
            self.values = start.copy()
        self._prescribed = problem.volumes.strains(problem.fixed_values)

    @property
    def weights(self) -> np.ndarray:
        """What makes energies of the squares of :meth:`missed` (n_groups,), N m."""
        return self.volumes.areas * self.volumes.modulus

    def missed(self, unknowns: np.ndarray) -> np.ndarray:
        """Return what volumes miss (n_groups,) for unknowns (n_dofs,) from the prescribed values."""
        return self.volumes.missed(unknowns, self.values) + self._prescribed

    def uniform(self) -> list[np.ndarray]:
        """Return for each body the pressures (n_groups,) that are 1 in it."""
        return [(self.volumes.body == k).astype(float) for k in np.unique(self.volumes.body)]

    def forces_missed(self, missed: np.ndarray) -> float:
        """Return the sum of squares of the same as forces, N^2."""
        forces = self.volumes.scale * missed
        return float(np.einsum("i,i->", forces, forces))

    def hesitate(self) -> None:
        self._cautious = self.STEPS

    def advance(self, unknowns: np.ndarray) -> float:
        """Step towards the pressures of corrected unknowns; returns the energy of the step, N m."""
        missed, volumes = self.missed(unknowns), self.volumes
        change = missed / (volumes.compliance + 1 / volumes.modulus)
        energy = float(np.einsum("i,i,i->", volumes.areas, missed, change))
        self.values = self.values + (self.CAUTIOUS if self._cautious else 1.0) * change
        self._cautious = max(self._cautious - 1, 0)
        return energy

    @property
    def nonzeros(self) -> int:
        """Entries of B."""
        return self.volumes.rows.nnz


def prolonged_pressures(coarse: DiscreteProblem, fine: DiscreteProblem, nodal: sparse.csr_array,
                        pressures: np.ndarray | None) -> np.ndarray | None:
    """Interpolate pressures to a finer level; ``nodal`` is the prolongation, between bodies of relative values."""
    if coarse.volumes is None or fine.volumes is None or pressures is None:
        return None
    values = coarse.volumes.at_nodes(pressures)
    if coarse.coupling is not None:
        values = values - coarse.coupling.weights @ values
    values = nodal @ values
    if fine.coupling is not None:
        values = fine.coupling.upward @ values
    return fine.volumes.means @ values
