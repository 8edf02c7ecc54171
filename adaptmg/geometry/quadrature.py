r"""Quadrature on edges, triangles and tetrahedra: barycentric points inside the cell, positive
weights of sum 1.

Gauss on edges; on triangles the 3-point rule of degree 2 (Strang and Fix 1973) and the 7-point rule
of degree 5 (Radon 1948); on tetrahedra the 4-point rule of degree 2 (Keast 1986,
doi:10.1016/0045-7825(86)90059-9). Of any degree: the conical product rules (Stroud 1971)."""

from __future__ import annotations

import numpy as np

PLAIN_DEGREE = 2
"""Linear data times a shape function."""
AXISYMMETRIC_DEGREE = 5
"""More than linear data times a shape function times r: what is divided by r gains from it."""


def _rotations(*first: float) -> np.ndarray:
    return np.stack([np.roll(first, k) for k in range(len(first))])


def _gauss(n: int) -> tuple[np.ndarray, np.ndarray]:
    x, weights = np.polynomial.legendre.leggauss(n)
    return np.column_stack([0.5 - 0.5 * x, 0.5 + 0.5 * x]), 0.5 * weights


def _radon() -> tuple[np.ndarray, np.ndarray]:
    """Return Radon's rule of degree 5 on a triangle: barycentric points (7, 3) and weights."""
    root = np.sqrt(15)
    near = (6 - root) / 21
    far = (6 + root) / 21
    points = np.vstack(
        [np.full(3, 1 / 3), _rotations(1 - 2 * near, near, near), _rotations(1 - 2 * far, far, far)]
    )
    return points, np.repeat([9 / 40, (155 - root) / 1200, (155 + root) / 1200], [1, 3, 3])


_KEAST = (5 - np.sqrt(5)) / 20
_RULES = {
    (2, PLAIN_DEGREE): _gauss(2),
    (2, AXISYMMETRIC_DEGREE): _gauss(3),
    (3, PLAIN_DEGREE): (_rotations(2 / 3, 1 / 6, 1 / 6), np.full(3, 1 / 3)),
    (3, AXISYMMETRIC_DEGREE): _radon(),
    (4, PLAIN_DEGREE): (_rotations(1 - 3 * _KEAST, _KEAST, _KEAST, _KEAST), np.full(4, 1 / 4)),
}


def quadrature_rule(corners: int, degree: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the barycentric points (n, corners) and the weights (n,) of a rule that is exact for
    polynomials up to a degree."""
    return _RULES[corners, degree]


def quadrature_points(points: np.ndarray, cells: np.ndarray, rule: np.ndarray) -> np.ndarray:
    """Return positions (n_cells, n, dim) of the ``rule``'s barycentric points (n, corners) in
    ``cells`` (n_cells, corners)."""
    return np.einsum("qk,ckd->cqd", rule, points.take(cells, axis=0))


def integration(
    points: np.ndarray, cells: np.ndarray, measures: np.ndarray, axisymmetric: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the barycentric points (n, corners) of a rule, their positions (n_cells, n, dim) in ``cells``
    (n_cells, corners) of these ``measures`` (n_cells,), and weights (n_cells, n), which sum to the
    measures; in axisymmetry times 2 pi r."""
    rule, weights = quadrature_rule(
        cells.shape[1], AXISYMMETRIC_DEGREE if axisymmetric else PLAIN_DEGREE
    )
    at = quadrature_points(points, cells, rule)
    weights = measures[:, None] * weights
    return rule, at, weights * (2 * np.pi * at[:, :, 0]) if axisymmetric else weights


def simplex_rule(dim: int, n: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the conical product Gauss-Jacobi rule (Stroud 1971) on a simplex of volume 1: the
    barycentric coordinates (n^dim, dim + 1) of its points, and their weights (n^dim,)."""
    from scipy.special import roots_jacobi  # a first solve without it starts sooner

    coordinates = np.ones((1, 1))  # of the points on a simplex of the dimension ``level``
    weights = np.ones(1)
    for level in range(dim):
        # collapse the last coordinate: what is left of the simplex there has measure (1 - x)^level
        x, w = roots_jacobi(n, level, 0)
        x = (1 + x) / 2
        w = w / w.sum()
        coordinates = np.concatenate(
            [
                np.multiply.outer(1 - x, coordinates),
                np.multiply.outer(x, np.ones((len(coordinates), 1))),
            ],
            axis=2,
        ).reshape(-1, level + 2)
        weights = np.multiply.outer(w, weights).ravel()
    return coordinates, weights
