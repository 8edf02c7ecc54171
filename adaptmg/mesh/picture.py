"""Pictures of meshes for notebooks: SVG text, without a plotting library."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from adaptmg.mesh.arrays import MeshArrays

__all__ = ["svg"]

#: of the longer side, pixels; edges beyond which only the boundary is drawn, and beyond which nothing is
_SIZE, _MANY, _MOST = 480, 20_000, 200_000
#: solids are seen from the front, right and above
_VIEW = np.array([[0.87, -0.25], [-0.5, -0.43], [0.0, -0.87]])


def svg(mesh: MeshArrays) -> str | None:
    """The edges of a plane mesh, or those on the surface of a solid one; None where they are too many."""
    cells = mesh.elements if mesh.dim == 2 and len(mesh.elements) <= _MANY else mesh.facets
    corners = cells.shape[1]
    ends = np.concatenate([cells[:, [a, b]] for a in range(corners) for b in range(a)])
    edges = np.unique(np.sort(ends, axis=1), axis=0)
    if not 0 < len(edges) <= _MOST or not np.isfinite(mesh.points).all():
        return None
    seen = mesh.points * [1.0, -1.0] if mesh.dim == 2 else mesh.points @ _VIEW
    low = seen[edges].min(axis=(0, 1))
    size = seen[edges].max(axis=(0, 1)) - low
    at = np.rint((seen - low) * (_SIZE / (size.max() or 1.0)) * 10).astype(np.int64) / 10 + 4
    width, height = np.ceil(size * (_SIZE / (size.max() or 1.0))).astype(int) + 8
    path = "".join(f"M{x:g} {y:g}L{u:g} {v:g}" for (x, y), (u, v) in at[edges].tolist())
    return (f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}">'
            f'<path d="{path}" fill="none" stroke="#3f454d" stroke-width="0.6"/></svg>')
