"""Rigid-body modes of a set of points."""

from __future__ import annotations

import numpy as np

from adaptmg.runtime.threads import one_blas_thread

__all__ = ["rigid_body_modes"]


@one_blas_thread()
def rigid_body_modes(points: np.ndarray) -> np.ndarray:
    """Rigid-body modes about the centroid, orthonormal.

    Parameters
    ----------
    points : (n_nodes, dim) array
        m.

    Returns
    -------
    (n_nodes * dim, 3 or 6) array
        Translations, then rotations; orthonormalised.
    """
    n, dim = points.shape
    x = points - points.mean(axis=0)
    modes = np.zeros((n, dim, 3 if dim == 2 else 6))
    for k in range(dim):
        modes[:, k, k] = 1.0
    if dim == 2:
        modes[:, 0, 2], modes[:, 1, 2] = -x[:, 1], x[:, 0]
    else:
        for k, (a, b) in enumerate(((0, 1), (1, 2), (2, 0))):
            modes[:, a, 3 + k], modes[:, b, 3 + k] = -x[:, b], x[:, a]
    modes = modes.reshape(n * dim, -1)
    # by the triangle of the Gram matrix, several times faster than by reflections; not where it is singular (a line)
    size = np.sqrt(np.einsum("nk,nk->k", modes, modes))
    if size.min() > 0:
        gram = (modes.T @ modes) / np.outer(size, size)
        if np.linalg.eigvalsh(gram)[0] > 1e-6:
            return modes @ (np.linalg.inv(np.linalg.cholesky(gram)).T / size[:, None])
    return np.linalg.qr(modes)[0]
