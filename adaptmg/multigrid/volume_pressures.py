r"""The pressures of the groups of :mod:`adaptmg.discrete.volumes` in solvers.

In :class:`~adaptmg.multigrid.truncated_step.TruncatedStep` a cycle is the ordinary truncated one on
K' with the load f - B'p; after its correction

.. math:: p \leftarrow p + \theta\,\frac{b\,u - p/\kappa}{1/\kappa + 1/(\lambda_1 + \mu)},\qquad \theta = 1,

:math:`\theta = 1/2` for two steps after the contact status has changed. The recombination
takes u and p together: what the volumes miss counts with the
energy :math:`A\,(\lambda_1 + \mu)\,(b\,u - p/\kappa)^2`. A uniform pressure in each body is a
further direction: steps alone would find the mean pressure of an enclosed body in
:math:`\kappa/(\lambda_1 + \mu)` cycles. So the number of cycles hardly depends on Poisson's ratio.

Augmented eliminates them for methods that factorise. With :math:`\tilde\kappa = \min(\kappa,
c\,(\lambda_1 + \mu))` the equations of :mod:`adaptmg.discrete.volumes` are

.. math:: (K' + B^T A^{-1}\tilde\kappa\, B)\,u + (1 - \tilde\kappa/\kappa)\,B^T p_0 = f,\qquad
          p = (1 - \tilde\kappa/\kappa)\,p_0 + \tilde\kappa\,b\,u,

with :math:`p_0 = p`. Up to a Poisson's ratio of .499 that is one problem with an ordinary matrix,
which is formed; beyond, each solve starts from the pressures :math:`p_0` of the last, and leaves
about 1/c of their error (an augmented Lagrangian). All have the same factors. A larger c would lose
as many digits of the pressures as it has itself."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg._checks import indices_frozen
from adaptmg.discrete.problem import DiscreteProblem, remembered_of_structure
from adaptmg.discrete.volumes import NO_PRESSURES, Volumes
from adaptmg.multigrid.linear_cycle import least_weights


def prolonged_pressures(
    coarse: DiscreteProblem, fine: DiscreteProblem, nodal: sparse.csr_array, pressures: np.ndarray
) -> np.ndarray:
    """Return pressures (n_groups coarse,), Pa, interpolated to a finer level, (n_groups fine,); ``nodal`` is
    the prolongation, between bodies of relative values."""

    def to_fine(values: np.ndarray) -> np.ndarray:
        """Interpolate relative values of nodes, and return those of bodies."""
        if coarse.coupling is not None:
            values = values - coarse.coupling.weights @ values
        values = nodal @ values
        return values if fine.coupling is None else fine.coupling.upward @ values

    return coarse.volumes.interpolated(pressures, to_fine, fine.volumes)


# half and twice change none of 119 solves, paths and loops (campaign constants)
_MOST = 100.0  # c


@remembered_of_structure
def _formed(problem: DiscreteProblem) -> tuple[DiscreteProblem, np.ndarray]:
    """Return the problem with the matrix K' + B'A^-1 kappa~ B of the module, without volumes, and
    kappa~ (n_groups,) = min(kappa, c (lambda_1 + mu)), Pa."""
    volumes = problem.volumes
    with np.errstate(divide="ignore"):
        kappa = np.minimum(1 / volumes.compliance, _MOST * volumes.modulus)
    # B'A^-1 kappa~ B = R'R, which is symmetric to the bit
    root = sparse.diags_array(np.sqrt(kappa / volumes.areas), format="csr") @ volumes.rows
    added = sparse.csr_array(root.T @ root)
    whole = sparse.bsr_array(problem.matrix + added, blocksize=problem.matrix.blocksize)
    matrix = indices_frozen(whole.sorted_indices())
    none = Volumes.none(problem.n_nodes, problem.dim)
    return problem.restructured(matrix=matrix, volumes=none), kappa


def augmented_problem(problem: DiscreteProblem, pressures: np.ndarray) -> Augmented:
    """Return a problem as one without volumes, for a solve that begins with these pressures
    (n_groups,), Pa."""
    return Augmented(problem, pressures) if len(problem.volumes) else _Unaugmented(problem)


class Augmented:
    """A problem with volumes, turned into one without them, whose matrix contains them."""

    #: solves at most
    MOST = 20

    def __init__(self, problem: DiscreteProblem, pressures: np.ndarray) -> None:
        """Pose the augmented problem of a solve that begins with these pressures (n_groups,),
        Pa."""
        formed, self._kappa = _formed(problem)
        volumes = problem.volumes
        self._volumes = volumes
        share_of_start = 1 - self._kappa * volumes.compliance  # 1 - kappa~ / kappa
        self._start_pressures = pressures
        self._offset = share_of_start * self._start_pressures
        #: whether one solve suffices: the share is 0, up to rounding, where kappa~ is kappa
        self.exact = not (share_of_start > 1e-12).any()
        # the part of the pressures that does not depend on the displacement acts as a load
        pressures_at_zero = self.pressures(np.zeros(problem.n_dofs))
        self.problem = formed.posing(
            load=volumes.balanced(problem.load, pressures_at_zero),
            law=problem.law,
            fixed_values=problem.fixed_values,
            contact=problem.contact,
            strain_free=problem.strain_free,
        )

    def pressures(self, solved: np.ndarray) -> np.ndarray:
        """Return the pressures (n_groups,) that belong to a displacement, between bodies
        relative."""
        # (1 - kappa~ / kappa) p_0 + kappa~ b u
        return self._offset + self._kappa * self._volumes.strains(solved.reshape(-1))

    def whole(self, solved: np.ndarray) -> np.ndarray:
        """Return the solution (n_unknowns,) of the problem with volumes for a displacement."""
        return np.append(solved, self.pressures(solved))

    def accelerated(
        self, pressures: np.ndarray, past: list[tuple[np.ndarray, np.ndarray]]
    ) -> np.ndarray:
        r"""Return the pressures (n_groups,) with which the next solve begins, by Anderson acceleration: those
        of the last five solves, recombined such that their changes :math:`c_j` by the solves have the least energy
        :math:`|c_0 + \sum_j \alpha_j (c_j - c_0)|^2 A/(\lambda_1 + \mu)`. ``past`` has the pressures and
        the changes of the earlier solves, newest first, and grows by those of this one. Without that
        the mean pressure of an enclosed body would converge with the rate 1 - kappa~ / kappa."""
        past.insert(0, (pressures, pressures - self._start_pressures))
        values, changes = map(np.array, zip(*past[:5], strict=True))
        if len(values) == 1:
            return pressures
        energies = self._volumes.areas / self._volumes.modulus  # of squares of pressures
        differences = changes[1:] - changes[0]
        weighted = differences * energies
        alphas = least_weights(weighted @ differences.T, -(weighted @ changes[0]))
        return pressures + alphas @ (values[1:] - pressures)

    def missed(self, solved: np.ndarray) -> float:
        """Return the deviation of the volume strains of a displacement (n_dofs,) from the pressures that this
        problem began with, relative to these."""
        volumes = self._volumes
        missed = volumes.scale * volumes.missed(solved.reshape(-1), self._start_pressures)
        size = np.linalg.norm(volumes.scale / volumes.modulus * self._start_pressures)
        return float(np.linalg.norm(missed) / size) if size > 0 else np.inf


class _Unaugmented(Augmented):
    """A problem without volumes, which one solve finds."""

    def __init__(self, problem: DiscreteProblem) -> None:
        self.problem = problem
        self.exact = True

    def pressures(self, solved: np.ndarray) -> np.ndarray:
        return NO_PRESSURES

    def whole(self, solved: np.ndarray) -> np.ndarray:
        return solved
