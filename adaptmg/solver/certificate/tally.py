"""Tally: sums and largest entries over all nodes that the lines of a certificate need, in one pass."""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.compiled import kernel

__all__ = ["Tally"]


@kernel
def _tally(unexplained, fixed, physical, unknowns, values, diagonal, squares, largest, sums):
    """Squares and largest entries of: free forces, forces in supports, prescribed values missed; displacements."""
    for i in range(len(unexplained)):
        for k in range(unexplained.shape[1]):
            force, u, stiffness = abs(unexplained[i, k]), abs(physical[i, k]), abs(diagonal[i, k])
            if fixed[i, k]:
                missed = abs(unknowns[i, k] - values[i, k])
                squares[1] += force * force
                squares[2] += missed * missed
                largest[2] = max(largest[2], missed)
            else:
                squares[0] += force * force
                largest[0] = max(largest[0], force)
                sums[k] += unexplained[i, k]
            squares[3] += (stiffness * u) ** 2
            squares[4] += stiffness * u * u
            largest[3] = max(largest[3], u)


class Tally:
    """Over the nodes of a problem; what has run away makes its numbers infinite or NaN.

    Parameters
    ----------
    unexplained : (n_nodes, dim) array
        Forces that neither loads nor claimed contact forces explain, N.
    fixed : (n_nodes, dim) bool array
    physical, unknowns, values : (n_nodes, dim) arrays
        Displacement of the bodies, the same relative, prescribed values, m.
    diagonal : (n_nodes, dim) array
        Of the matrix, N/m.

    Attributes
    ----------
    free, largest : float
        Norm and largest component of what is unexplained at free dofs, N.
    supports : float
        Norm of the forces at fixed dofs, N.
    moved, furthest : float
        Norm and largest component of the distance from prescribed values, m.
    displacement : float
        The largest component, m.
    stiff, stiff_energy : float
        Norms of D u (N) and of D^1/2 u (sqrt(N m)), D the diagonal.
    sums : (dim,) array
        Of what is unexplained at free dofs, N.
    """

    def __init__(self, unexplained: np.ndarray, fixed: np.ndarray, physical: np.ndarray, unknowns: np.ndarray,
                 values: np.ndarray, diagonal: np.ndarray) -> None:
        squares, largest, self.sums = np.zeros(5), np.zeros(4), np.zeros(unexplained.shape[1])
        _tally(unexplained, fixed, physical, unknowns, values, diagonal, squares, largest, self.sums)
        # the larger of NaN and a number is the number: the squares know
        largest[~np.isfinite(squares[:4])] = np.nan
        self.free, self.supports, self.moved, self.stiff, self.stiff_energy = np.sqrt(squares).tolist()
        self.largest, _, self.furthest, self.displacement = largest.tolist()
