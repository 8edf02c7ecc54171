r"""Critical friction: an estimate of the coefficient from which on a contact problem may have several solutions.

Where one node touches alone, with C the compliance of the body at that node and :math:`K = C^{-1}`, pressing in the
normal direction and slipping balance in one way only if

.. math:: \mu\,|K_{nt}| < K_{tt} .

Beyond, open, slip and stick may all be equilibria of the same load (A. Klarbring, Ingenieur-Archiv 60, 1990,
doi:10.1007/BF00541909). With several nodes in contact the bound is another one; this is an estimate, not a criterion.
"""

from __future__ import annotations

import warnings

import numpy as np

from adaptmg.discrete import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.runtime.remembered import remembered
from adaptmg.smoother.system import local_system
from adaptmg.solver.linear.condensation import condense
from adaptmg.solver.result.examiner import Examiner

__all__ = ["critical_friction", "warn_of_large_friction", "warn_of_several_solutions"]

#: dofs, and contact dofs, up to which the estimate costs next to nothing
_SMALL, _SMALL_CONTACT = 1500, 200


@remembered
def critical_friction(problem: DiscreteProblem) -> np.ndarray:
    """The critical coefficient of each contact node if it touches alone.

    Parameters
    ----------
    problem : DiscreteProblem
        One factorisation, and a dense inverse of the size of its contact dofs.

    Returns
    -------
    (n_contact,) array
        min K_tt / |K_nt| over tangents; infinite where the two do not interact, NaN where only contact holds the body.
    """
    local = local_system(problem)
    dim, n = problem.dim, len(problem.contact)
    schur = condense(local).matrix
    values, vectors = np.linalg.eigh(schur)
    if not values[0] > 1e-10 * values[-1]:
        return np.full(n, np.nan)
    compliance = (vectors / values) @ vectors.T
    blocks = compliance.reshape(n, dim, n, dim)[np.arange(n), :, np.arange(n), :]
    held = local.system.fixed.reshape(-1, dim)[problem.contact.nodes].any(axis=1)
    result = np.full(n, np.inf)
    stiffness = np.linalg.inv(blocks[~held])
    across = np.linalg.norm(stiffness[:, 0, 1:], axis=1)
    along = np.linalg.eigvalsh(stiffness[:, 1:, 1:])[:, 0]
    result[~held] = np.divide(along, across, out=np.full(len(along), np.inf), where=across > 1e-12 * along)
    result.flags.writeable = False
    return result


def warn_of_several_solutions(grids: Hierarchy) -> None:
    """Warn where the friction of a node exceeds the estimate on the coarsest grid, if that is cheap."""
    problem = grids[0].discrete
    if problem is None or problem.n_dofs > _SMALL or len(problem.contact) * problem.dim > _SMALL_CONTACT:
        return
    friction = problem.law.bounds(len(problem.contact))[1]
    if not friction.any():
        return
    try:
        critical = critical_friction(problem)
    except (ValueError, np.linalg.LinAlgError):
        return  # nothing is known of a singular interior, which is refused elsewhere
    beyond = friction >= critical
    if beyond.any():
        i = int(np.argmax(np.where(beyond, friction - critical, -np.inf)))
        warnings.warn(f"friction {friction[i]:g} exceeds {critical[i]:.2g}, from which on a node in contact alone may "
                      f"open, slip or stick under the same load ({np.count_nonzero(beyond)} contact nodes of the "
                      "coarsest grid): the solution may not be unique; compare am.solve(..., start=...) from several "
                      "starts", RuntimeWarning, stacklevel=3)


def warn_of_large_friction(examiner: Examiner) -> None:
    """Say where even the problem of one node, all others held, may have several solutions: mu |a_nt| >= a_tt."""
    blocks, nodes = examiner.blocks, examiner.discrete.contact.nodes
    tangential = blocks[:, 1:, 1:].copy()
    tangential[:, 0, 0] = np.abs(tangential[:, 0, 0])  # negative where held
    coupling = examiner.contact.friction * np.linalg.norm(blocks[:, 0, 1:], axis=1)
    beyond = coupling >= np.linalg.eigvalsh(tangential)[:, 0]
    if beyond.any():
        i = int(np.argmax(beyond))
        warnings.warn(f"friction {examiner.contact.friction[i]:g} is so large that the solution may not be unique "
                      f"({np.count_nonzero(beyond)} contact nodes, the first is node {nodes[i]}); "
                      "which one is found depends on start and method", RuntimeWarning, stacklevel=3)
