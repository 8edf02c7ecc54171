"""Pictures of meshes for notebooks: SVG text, without a plotting library."""

from __future__ import annotations

import numpy as np

#: of the longer side, pixels; elements beyond which only the boundary is drawn; solids are seen from above and right
_SIZE, _MANY, _VIEW = 480, 20_000, np.array([[0.87, -0.25], [-0.5, -0.43], [0.0, -0.87]])


def svg(points: np.ndarray, elements: np.ndarray, facets: np.ndarray) -> str | None:
    """Return the edges of a plane mesh, or those on the surface of a solid one; None where they are too many."""
    dim = points.shape[1]
    cells = elements if dim == 2 and len(elements) <= _MANY else facets
    ends = np.concatenate([cells[:, [a, b]] for a in range(cells.shape[1]) for b in range(a)])
    edges = np.unique(np.sort(ends, axis=1), axis=0)
    if not 0 < len(edges) <= 10 * _MANY or not np.isfinite(points).all():
        return None
    seen = points[edges] @ (np.diag([1.0, -1.0]) if dim == 2 else _VIEW)
    seen -= seen.min(axis=(0, 1))
    at = seen * (_SIZE / (seen.max() or 1.0)) + 4
    width, height = np.ceil(at.max(axis=(0, 1)) + 4).astype(int)
    path = "".join(f"M{x:.1f} {y:.1f}L{u:.1f} {v:.1f}" for (x, y), (u, v) in at.tolist())
    return (f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}">'
            f'<path d="{path}" fill="none" stroke="#3f454d" stroke-width="0.6"/></svg>')
