"""The glued problem: all contact dofs fixed where they are, a linear problem that every linear solver can be timed on.

It is the yardstick of the comparison with algebraic multigrid: the same body, mesh and supports without the
nonlinearity of contact.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.discrete import DiscreteProblem
from adaptmg.smoother.system import local_system
from adaptmg.solver.newton_steps import local_near_nullspace

__all__ = ["glued_system"]


def glued_system(discrete: DiscreteProblem) -> tuple[sparse.bsr_array, np.ndarray, np.ndarray]:
    """The linear system with all contact dofs fixed.

    Parameters
    ----------
    discrete : DiscreteProblem

    Returns
    -------
    matrix : bsr_array (n_free, n_free)
        Rows and columns of the nodes that are not contact nodes; fixed dofs among them decoupled.
    load : (n_free,) array
        Prescribed values lifted, N.
    near_nullspace : (n_free, k) array
        Rigid-body modes, zero at fixed dofs.
    """
    system, load, modes, _ = _glued(discrete)
    return system, load, modes


def _glued(discrete: DiscreteProblem) -> tuple[sparse.bsr_array, np.ndarray, np.ndarray, np.ndarray]:
    local = local_system(discrete)
    dim = discrete.dim
    kept = np.flatnonzero(local.system.contact_of < 0)
    if not len(kept):
        raise ValueError("every node is a contact node: nothing is left of the glued problem")
    dofs = (dim * kept[:, None] + np.arange(dim)).reshape(-1)
    matrix = sparse.csr_array(local.system.matrix)[dofs][:, dofs]
    matrix = sparse.bsr_array(matrix, blocksize=(dim, dim)).sorted_indices()
    return matrix, local.load[dofs], local_near_nullspace(local)[dofs], dofs
