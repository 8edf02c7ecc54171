r"""Problems with volumes for methods that factorise: the pressures of groups are eliminated from the equations.

With :math:`\tilde\kappa = \min(\kappa, c\,(\lambda_1 + \mu))` the equations of :mod:`adaptmg.discrete.volumes` are

.. math:: (K' + B^T A^{-1}\tilde\kappa\, B)\,u + (1 - \tilde\kappa/\kappa)\,B^T p_0 = f,\qquad
          p = (1 - \tilde\kappa/\kappa)\,p_0 + \tilde\kappa\,b\,u,

with :math:`p_0 = p`. Up to a Poisson's ratio of .499 that is one problem with an ordinary matrix, which is formed;
beyond, each solve starts from the pressures :math:`p_0` of the last, and leaves about 1/c of their error (an augmented
Lagrangian). All have the same factors. A larger c would lose as many digits of the pressures as it has itself.
"""

from __future__ import annotations

import copy

import numpy as np
from scipy import sparse

from adaptmg._checks import indices_frozen
from adaptmg._on_demand import Token
from adaptmg.discrete.problem import DiscreteProblem, remembered_of_structure
from adaptmg.multigrid.truncated_step import least_weights

_MOST = 100.0  # c


@remembered_of_structure
def _formed(problem: DiscreteProblem) -> tuple[DiscreteProblem, np.ndarray]:
    """The problem with its whole matrix, and kappa of the groups as far as the matrix has it."""
    volumes = problem.volumes
    with np.errstate(divide="ignore"):
        kappa = np.minimum(1 / volumes.compliance, _MOST * volumes.modulus)
    rows = sparse.diags_array(np.sqrt(kappa / volumes.areas), format="csr") @ volumes.rows
    added = sparse.csr_array(rows.T @ rows)
    whole = sparse.bsr_array(problem.matrix + 0.5 * (added + added.T), blocksize=problem.matrix.blocksize)
    result = copy.copy(problem)
    parts = {"matrix": indices_frozen(whole.sorted_indices()), "volumes": None, "_structure": Token()}
    for name, value in parts.items():
        object.__setattr__(result, name, value)
    return result, kappa


class Augmented:
    """A problem with volumes, and what it becomes."""

    #: solves at most
    MOST = 20

    def __init__(self, problem: DiscreteProblem, pressures: np.ndarray | None) -> None:
        formed, self._kappa = _formed(problem)
        self._volumes, rest = problem.volumes, 1 - self._kappa * problem.volumes.compliance
        self._before = np.zeros(len(rest)) if pressures is None else pressures
        self._offset = rest * self._before
        #: whether the first solve ends it
        self.exact = not (rest > 1e-12).any()
        resting = self._offset - self._kappa * problem.volumes.expansion
        self.problem = formed.posing(load=problem.load - problem.volumes.forces(resting), law=problem.law,
                                     fixed_values=problem.fixed_values, contact=problem.contact,
                                     strain_free=problem.strain_free)

    def pressures(self, solved: np.ndarray) -> np.ndarray:
        """Return the pressures (n_groups,) that belong to a displacement, between bodies relative."""
        return self._offset + self._kappa * self._volumes.strains(solved.reshape(-1))

    def accelerated(self, pressures: np.ndarray, past: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
        """Return what the next solve begins with: the pressures of this one recombined with those of the ``past`` ones.
        The mean pressure of a body that is enclosed tends to its value with 1 - kappa~ / kappa alone."""
        past.insert(0, (pressures, pressures - self._before))
        values, changes = map(np.array, zip(*past[:5], strict=True))
        if len(values) == 1:
            return pressures
        alpha = least_weights(changes[0], changes[1:] - changes[0], self._volumes.areas / self._volumes.modulus)
        return pressures + alpha @ (values[1:] - pressures)

    def missed(self, solved: np.ndarray) -> float:
        """Return what volume strains of a displacement and pressures of this problem miss, relative to these."""
        volumes = self._volumes
        missed = volumes.scale * volumes.missed(solved.reshape(-1), self._before)
        size = np.linalg.norm(volumes.scale / volumes.modulus * self._before)
        return float(np.linalg.norm(missed) / size) if size > 0 else np.inf
