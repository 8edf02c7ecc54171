"""Truncation: the matrices below one level, changed near contact whenever the contact status changes."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.multigrid.linear.split_matrix import SplitMatrix
from adaptmg.multigrid.truncated.coarse_matrices import kernels
from adaptmg.multigrid.truncated.coarse_matrices.dof_update import DofUpdate
from adaptmg.multigrid.truncated.coarse_matrices.nodal_update import NodalUpdate
from adaptmg.multigrid.truncated.contact import TruncatedContact

__all__ = ["Truncation"]


class Truncation:
    """Keeps the matrices of the levels below one level as the contact status of that level demands.

    Parameters
    ----------
    levels : list of SplitMatrix
        Coarsest first; the last is the level of the contact nodes. The others are changed in place and must come with
        their base matrices, of which ``P' A P`` is the pattern at least near contact.
    prolongations : list of csr_array
        Between neighbours, all of nodes or all of dofs.
    contact : TruncatedContact
        The contact nodes of the last level, whose matrix is taken as symmetric.
    """

    def __init__(self, levels: list[SplitMatrix], prolongations: list[sparse.csr_array],
                 contact: TruncatedContact) -> None:
        self.contact, fine = contact, levels[-1]
        dim = fine.dim
        count = kernels.count_blocks(contact.nodes, contact.contact_of, fine.lower_indptr, fine.lower_indices)
        rows, columns, entries = (np.empty(count, dtype=np.int32) for _ in range(3))
        kernels.collect(contact.nodes, contact.contact_of, fine.lower_indptr, fine.lower_indices, rows, columns,
                        entries)
        # contact node by contact node, so that what is written on the levels below lies close together
        owner = np.where(contact.contact_of[rows] < 0, contact.contact_of[columns], contact.contact_of[rows])
        order = np.argsort(owner, kind="stable")
        self.rows, self.columns = rows[order], columns[order]
        self.blocks, self.change = np.empty(count * dim * dim), np.zeros(count * dim * dim)
        kernels.fetch(dim, self.rows, self.columns, entries[order], fine.lower, contact.diagonal, self.blocks)
        if prolongations[-1].shape[0] == fine.n_nodes:
            self.products: NodalUpdate | DofUpdate = NodalUpdate(levels[:-1], prolongations, self.rows, self.columns)
        else:
            self.products = DofUpdate(levels[:-1], prolongations, dim, self.rows, self.columns)

    def apply(self, newton: bool) -> None:
        """Change the matrices for the present status; ``newton`` False keeps them symmetric, with g frozen."""
        o = self.contact
        kernels.changed_blocks(o.dim, self.rows, self.columns, self.blocks, o.contact_of, o.codes, o.frames,
                               o.friction, o.direction, o.hessian, newton, self.change)
        self.products.update(self.change)

    def restore(self) -> None:
        """Put the base matrices back."""
        self.products.restore()

    @property
    def nbytes(self) -> int:
        """Memory of the arrays, bytes."""
        own = self.rows.nbytes + self.columns.nbytes + self.blocks.nbytes + self.change.nbytes
        return own + self.products.nbytes
