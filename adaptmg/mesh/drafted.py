r"""drafted: tetrahedra by a size field, made of a coarse draft that is refined and improved in arrays.

Of a box the draft is cells as large as the field anywhere, of other solids Netgen's mesh with edges of k (near 2, 4
or 7) times the field f, which may then grow k times as fast. It takes :math:`k^{-3}` of the time that Netgen would take
for the whole, and is the only part that is not nested in other meshes.

With the size e of an element (the edge of the equilateral one of the same volume) and the mean w of f at its corners,
it is refined until no element has :math:`e > \sqrt 2 w` and almost no boundary facet is longer than 1.4 f (also where
no element is too large: one facet of twice the length next to a re-entrant corner doubles the rate of multigrid). All
elements are cut where half of them are far too large, else those that are too large are bisected once. In the end, and
after passes that change much, moves make better shapes. New nodes on round faces are put onto them after each pass.

None of these steps can make a hole or a fold out of a sound mesh as long as all measures stay positive: the draft alone
is checked.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from adaptmg.mesh.arrays import MeshArrays
from adaptmg.mesh.bisection import refined
from adaptmg.mesh.improve import halved, improved
from adaptmg.mesh.netgen_plane import (
    MAX_BISECTIONS,
    NODES_PER_CELL,
    equilateral_sizes,
    facet_elements,
    refuse_too_many,
    unreachable,
)
from adaptmg.problem.plane_domains import Domain

# elements and facets that are too large for the field, over it; by how much more most are before all are cut
_LARGE, _LONG, _FAR = 2**0.5, 1.4, 1.3
# share of the elements (of the facets) that may stay too large, though by less than this
_LEFT, _NEVER = 0.01, 2**0.5
# share of too large elements above which a pass is followed by improvement; rounds of it in the end
_MANY, _ROUNDS = 0.02, 3
# volume of the equilateral element of size 1
_EQUILATERAL = 2**0.5 / 12


def drafted(domain: Domain, draft: MeshArrays, field: Callable[[MeshArrays], np.ndarray],
            onto: Callable[[MeshArrays, int], MeshArrays] | None = None) -> MeshArrays:
    """Refine a sound draft to the sizes at the nodes of a mesh. ``onto`` puts nodes from a number on onto the boundary;
    this is called by the names that it has in the draft."""
    mesh = draft
    for _ in range(3 * MAX_BISECTIONS):
        at, n_old = field(mesh), mesh.n_nodes
        elements = equilateral_sizes(mesh.points, mesh.elements) / at[mesh.elements].mean(axis=1)
        facets = equilateral_sizes(mesh.points, mesh.facets) / at[mesh.facets].mean(axis=1)
        large, long = elements > _LARGE, facets > _LONG
        if max(large.mean(), long.mean()) <= _LEFT:
            large, long = elements > _NEVER, facets > _NEVER
            if not (large.any() or long.any()):
                break
        refuse_too_many(NODES_PER_CELL[3] * _EQUILATERAL * float((elements**3).sum()), domain)
        many = large.mean() > _MANY
        if (elements > _FAR * _LARGE).mean() > 0.5:
            mesh = halved(mesh)
        else:
            large[facet_elements(mesh, mesh.facets[long])] = True
            mesh = refined(mesh, large, 1).mesh
        if onto is not None:
            mesh = onto(mesh, n_old)
        if many:
            mesh = improved(mesh, 1)
    else:
        raise unreachable(domain, large)
    return improved(mesh, _ROUNDS)
