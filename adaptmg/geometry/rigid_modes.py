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
    # by coordinate, each in one piece: several times faster than the points as they are
    x = np.ascontiguousarray(points.T)
    x = x - x.mean(axis=1, keepdims=True)
    planes = ((0, 1),) if dim == 2 else ((0, 1), (1, 2), (2, 0))
    modes = np.full((n, dim, dim + len(planes)), 0.0)
    # about the centroid rotations are orthogonal to translations: only their own Gram matrix is to be undone
    triangle = _triangle(x @ x.T, planes)
    plain = triangle is None  # points on a line: by reflections
    if plain:
        triangle = np.eye(len(planes))
    for k in range(dim):
        modes[:, k, k] = 1.0 if plain else 1 / np.sqrt(n)
    for k in range(len(planes)):
        for (a, b), share in zip(planes, triangle[:, k], strict=True):
            if share != 0.0:
                modes[:, a, dim + k] -= share * x[b]
                modes[:, b, dim + k] += share * x[a]
    modes = modes.reshape(n * dim, -1)
    return np.linalg.qr(modes)[0] if plain else modes


def _triangle(moments: np.ndarray, planes: tuple[tuple[int, int], ...]) -> np.ndarray | None:
    """The upper triangle that makes rotations in the planes orthonormal; None where they are (nearly) dependent.

    ``moments`` (dim, dim) are the second moments of the points about their centroid.
    """
    same = np.eye(len(moments))
    gram = np.array([[same[a, c] * moments[b, d] - same[a, d] * moments[b, c] - same[b, c] * moments[a, d]
                      + same[b, d] * moments[a, c] for c, d in planes] for a, b in planes])
    size = np.sqrt(gram.diagonal())
    if not size.min() > 0:
        return None
    scaled = gram / np.outer(size, size)
    if np.linalg.eigvalsh(scaled)[0] <= 1e-6:
        return None
    return np.linalg.inv(np.linalg.cholesky(scaled)).T / size[:, None]
