r"""Volumes: mean volume strains over groups of nodes, which a nearly incompressible body keeps
nearly at zero.

Of a body whose first Lame constant :math:`\lambda` is more than four shear moduli, the smoothed
stiffness K' has
:math:`\lambda_1 = 4\mu` (:mod:`adaptmg.discrete.elasticity`); the rest acts on the mean divergence b_a u of groups of
nodes, with the volume A_a,

.. math:: K = K' + \sum_a A_a\,\kappa\, b_a b_a^T,\qquad \kappa = \lambda - \lambda_1,\qquad
          A_a\,b_a u = \sum_{n \in a} \sum_{T \ni n} \frac{V_T}{d + 1}\,\mathrm{div}_T u .

K is never formed. With the group pressures :math:`p_a = \kappa\, b_a u` (tension positive) and the
rows
:math:`B_a = A_a b_a` equilibrium is

.. math:: K' u + B^T p = f,\qquad b_a u - p_a/\kappa = 0,

which makes sense for Poisson's ratio .5, :math:`1/\kappa = 0`, too. Of initial strains the mean
trace is taken off
:math:`b_a u`. Single nodes are an unstable pair with linear
displacements; groups of four in the plane, eight in space are stable (the inf-sup constant is .17
on all meshes tried)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg._numba import kernel, read_only
from adaptmg.discrete.coordinates import Unknowns
from adaptmg.discrete.elasticity import (
    element_measures,
    elements_of_nodes,
    nodal_matrix,
    pattern,
    separate_bodies,
    shape_gradients,
    starts_of,
)
from adaptmg.discrete.moduli import (
    Materials,
    body_materials,
    edge_parts,
    inelastic_bodies,
    is_axisymmetric,
    lame_constants,
)
from adaptmg.geometry.search import morton_order
from adaptmg.mesh.arrays import MeshArrays
from adaptmg.problem.laws import Elastic

#: nodes of a group, by dimension
GROUP = {2: 4, 3: 8}
#: of a problem without groups
NO_PRESSURES = read_only(np.empty(0))


@dataclass(frozen=True, eq=False)
class Volumes:
    """The groups of nodes of a problem, with rows that act on its unknowns."""

    rows: sparse.csr_array  # (n_groups, n_dofs): B, m or m^2
    means: sparse.csr_array  # (n_groups, n_nodes): shares of nodes in a group's volume, row sums 1
    areas: np.ndarray  # (n_groups,): A, m^2 (plane) or m^3
    compliance: np.ndarray  # (n_groups,): 1 / kappa, 1/Pa; 0: incompressible
    #: (n_groups,): lambda_1 + mu, Pa: the stress with which K' resists a volume strain of 1 that is equal along both
    #: axes of the plane. Bodies in space, where this stress is lambda_1 + 2/3 mu, take the same number
    modulus: np.ndarray
    body: np.ndarray  # (n_groups,) int: number of the body that a group belongs to
    corners: np.ndarray  # (n_elements, dim + 1) int32: groups of the corners of elements, or -1
    expansion: np.ndarray | float = 0.0  # (n_groups,): mean trace of initial strains

    @classmethod
    @lru_cache(maxsize=32)  # hierarchies ask for each level many times: .1 ms each
    def none(cls, n_nodes: int, dim: int) -> Volumes:
        """Return no groups, of a problem whose matrix holds the whole stiffness."""
        return NoVolumes(
            rows=checks.no_entries((0, n_nodes * dim)),
            means=checks.no_entries((0, n_nodes)),
            areas=NO_PRESSURES,
            compliance=NO_PRESSURES,
            modulus=NO_PRESSURES,
            body=np.empty(0, dtype=np.int64),
            corners=np.empty((0, dim + 1), dtype=np.int32),
        )

    def __len__(self) -> int:
        return len(self.areas)

    @cached_property
    def columns(self) -> sparse.csr_array:
        """Return B' (n_dofs, n_groups)."""
        return sparse.csr_array(self.rows.T)

    def forces(self, pressures: np.ndarray) -> np.ndarray:
        """Return B'p (n_dofs,), N."""
        return self.columns @ pressures

    def balanced(self, forces: np.ndarray, pressures: np.ndarray) -> np.ndarray:
        """Return forces (n_dofs,) minus B'p, N; without groups these themselves."""
        return forces - self.forces(pressures)

    def right_side(self, forces: np.ndarray, missed: np.ndarray) -> np.ndarray:
        """Return forces (n_dofs,) followed by -A times what strains miss (n_groups,), as the equations of
        displacements and pressures have them on their right-hand side; without groups the forces."""
        return np.append(forces, -self.areas * missed)

    def strains(self, unknowns: np.ndarray) -> np.ndarray:
        """Return the mean divergence (n_groups,) of unknowns (n_dofs,), without that of free expansion."""
        return (self.rows @ unknowns) / self.areas - self.expansion

    def missed(self, unknowns: np.ndarray, pressures: np.ndarray) -> np.ndarray:
        """Return the :meth:`strains` minus p / kappa (n_groups,)."""
        missed = (self.rows @ unknowns) / self.areas - self.compliance * pressures
        return missed - self.expansion

    def from_prescribed(self, problem: Unknowns) -> Volumes:
        """Return the groups for unknowns that count from prescribed values, and are zero along what is
        held."""
        nodes = problem.fixed_nodes()
        held = np.eye(problem.dim) - problem.free_spans(nodes)
        rows = self.rows - self.rows @ nodal_matrix(nodes, held, self.rows.shape[1])
        # the expansion minus the strains of the prescribed values
        expansion = -self.strains(problem.fixed_values)
        return replace(self, rows=checks.narrowed(sparse.csr_array(rows)), expansion=expansion)

    @cached_property
    def uniform(self) -> tuple[np.ndarray, ...]:
        """Return for each body the pressures (n_groups,) that are 1 in it."""
        return tuple((self.body == k).astype(float) for k in np.unique(self.body))

    def relax(self, unknowns: np.ndarray, pressures: np.ndarray, share: float) -> float:
        """Change ``pressures`` (n_groups,), in place, towards those of unknowns (n_dofs,), by a ``share``
        of the step of :mod:`adaptmg.multigrid.volume_pressures`; return the energy of the whole step,
        N m."""
        missed = self.missed(unknowns, pressures)
        # (b u - p/kappa) / (1/kappa + 1/(lambda_1 + mu))
        change = missed / (self.compliance + 1 / self.modulus)
        energy = float(np.einsum("i,i,i->", self.areas, missed, change))
        pressures += share * change
        return energy

    def conditions(self, unknowns: np.ndarray, pressures: np.ndarray) -> dict[str, np.ndarray]:
        """Return the deviations of the pressures of groups from their mean volume strains, as forces
        (n_groups,) on a facet, N, by the name of this condition; without groups there is none."""
        return {"volumes": self.scale * self.missed(unknowns, pressures)}

    def energy(self, pressures: np.ndarray) -> float:
        """Return the sum of A p^2 / kappa, N m."""
        return float(np.einsum("i,i,i,i->", self.areas, self.compliance, pressures, pressures))

    @cached_property
    def scale(self) -> np.ndarray:
        """Return the factors (n_groups,) from strains to forces: (lam_1 + mu) times a facet of the
        group, N."""
        dim = self.rows.shape[1] // self.means.shape[1]
        return self.modulus * self.areas ** (1 - 1 / dim)

    def expanding(self, mesh: MeshArrays, strain: np.ndarray, axisymmetric: bool) -> Volumes:
        """Return these groups with the expansion of initial strains (n_elements, 3), xx, yy and zz, of
        elements."""
        present = self.corners >= 0
        size = self.corners.shape[1]
        shares = np.repeat(
            element_measures(mesh, axisymmetric) * strain.sum(axis=1) / size, size
        ).reshape(present.shape)
        return replace(
            self,
            expansion=np.bincount(self.corners[present], shares[present], len(self)) / self.areas,
        )

    def at_nodes(self, pressures: np.ndarray) -> np.ndarray:
        """Return pressures (n_nodes,) of the groups of nodes, between bodies their mean; zero where
        there are none."""
        total = np.asarray(self.means.sum(axis=0)).reshape(-1)
        return np.divide(self.means.T @ pressures, total, out=np.zeros_like(total), where=total > 0)

    def interpolated(
        self, pressures: np.ndarray, to_fine: Callable[[np.ndarray], np.ndarray], fine: Volumes
    ) -> np.ndarray:
        """Return pressures, Pa, of the groups of a ``fine`` level; ``to_fine`` interpolates values of
        nodes."""
        return fine.means @ to_fine(self.at_nodes(pressures))

    def of_elements(self, pressures: np.ndarray) -> np.ndarray | None:
        """Return the means (n_elements,) of the pressures (n_groups,) at the corners of elements, which are
        0 where a corner has no group: its number -1 is the place of the last entry. None without
        groups."""
        return np.append(pressures, 0.0)[self.corners].mean(axis=1)


class NoVolumes(Volumes):
    """No groups: the formulas without their products with nothing, which take up to 20 us each, several
    times a cycle."""

    def balanced(self, forces: np.ndarray, pressures: np.ndarray) -> np.ndarray:
        return forces

    def right_side(self, forces: np.ndarray, missed: np.ndarray) -> np.ndarray:
        return forces

    def missed(self, unknowns: np.ndarray, pressures: np.ndarray) -> np.ndarray:
        return NO_PRESSURES

    def from_prescribed(self, problem: Unknowns) -> Volumes:
        return self

    def relax(self, unknowns: np.ndarray, pressures: np.ndarray, share: float) -> float:
        return 0.0

    def expanding(self, mesh: MeshArrays, strain: np.ndarray, axisymmetric: bool) -> Volumes:
        return self

    def interpolated(
        self, pressures: np.ndarray, to_fine: Callable[[np.ndarray], np.ndarray], fine: Volumes
    ) -> np.ndarray:
        return np.zeros(len(fine))

    def conditions(self, unknowns: np.ndarray, pressures: np.ndarray) -> dict[str, np.ndarray]:
        return {}

    def of_elements(self, pressures: np.ndarray) -> None:
        return None


def formed_volumes(groups: Volumes, dim: int) -> sparse.bsr_array:
    """Return the stiffness (n_dofs, n_dofs) of the mean volume strains over groups of nodes, bitwise
    symmetric. Plastic bodies use it: with pressures as unknowns Prandtl's punch on 2667 nodes takes 1507
    cycles in place of 232."""
    factors = 1 / np.sqrt(groups.areas * groups.compliance)
    half = sparse.csr_array(sparse.diags_array(factors) @ groups.rows)
    return sparse.bsr_array(half.T @ half, blocksize=(dim, dim))


def volume_groups(mesh: MeshArrays, material: Materials, inelastic: bool = False) -> Volumes:
    """Return the groups of all elastic bodies that are nearly incompressible, or those of all
    ``inelastic`` bodies."""
    materials = body_materials(mesh, material)
    dim = mesh.dim
    kappa, modulus = _moduli_of_bodies(materials, inelastic)
    in_groups = (kappa > 0)[mesh.element_body]
    if not in_groups.any():
        return Volumes.none(mesh.n_nodes, dim)
    # the corners of these elements, by numbers of their nodes along a curve, and by those of the mesh
    cells = _nodes_of_bodies(mesh, in_groups)
    elements = mesh.elements[in_groups]
    starts = starts_of(cells)
    group, n_groups = _groups_of_nodes(cells, starts, GROUP[dim])
    group_of_corner = group[cells]
    # V_T / (d + 1) and the slopes of div_T
    slopes, corner_volumes = (every[in_groups] for every in shape_gradients(mesh))
    if is_axisymmetric(materials):
        mean_radius = mesh.points[elements, 0].mean(axis=1)
        corner_volumes *= 2 * np.pi * mean_radius
        # the divergence has u_r / r, at the centroid, where the shape functions are 1/3
        slopes[:, :, 0] += 1 / (3 * mean_radius[:, None])
    corner_volumes /= dim + 1
    node_volumes = np.bincount(cells.reshape(-1), np.repeat(corner_volumes, dim + 1))
    areas = np.bincount(group, node_volumes, minlength=n_groups)
    # B = A b: the elements of each group, once for each corner there, times their V_T / (d + 1) div_T
    corners_in_groups = sparse.csr_array(
        (np.ones(cells.size), group_of_corner.reshape(-1), starts), shape=(len(cells), n_groups)
    )
    dofs = dim * elements[:, :, None] + np.arange(dim)
    divergences = sparse.csr_array(
        ((corner_volumes[:, None, None] * slopes).reshape(-1), dofs.reshape(-1), dim * starts),
        shape=(len(cells), dim * mesh.n_nodes),
    )
    rows = sparse.csr_array(sparse.csr_array(corners_in_groups.T) @ divergences)
    rows.sort_indices()
    mesh_node = np.empty(len(group), dtype=np.int64)
    mesh_node[cells] = elements
    means = sparse.csr_array(
        (node_volumes / areas[group], (group, mesh_node)), shape=(n_groups, mesh.n_nodes)
    )
    # a group lies in one body: whichever of its corners comes last
    body = np.empty(n_groups, dtype=np.int64)
    body[group_of_corner] = mesh.element_body[in_groups, None]
    corners = np.full(mesh.elements.shape, -1, dtype=np.int32)
    corners[in_groups] = group_of_corner
    return Volumes(
        rows=rows,
        means=means,
        areas=areas,
        compliance=1 / kappa[body],
        modulus=modulus[body],
        body=body,
        corners=corners,
    )


def _moduli_of_bodies(
    materials: tuple[Elastic, ...], inelastic: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Return kappa = lambda - lambda_1 (n_bodies,), 0 for bodies without groups, and lambda_1 + mu
    (n_bodies,), see :attr:`Volumes.modulus`. Either the inelastic or the elastic bodies have groups.
    lambda_1 is the part of lambda up to 4 mu, of plastic bodies less, that the means of smoothed elements
    around edges keep."""
    lame, shear = lame_constants(materials)
    edge_lame = np.minimum(lame, edge_parts(materials) * shear)  # lambda_1
    isotropic = np.array([elastic.anisotropy is None for elastic in materials])
    chosen = inelastic_bodies(materials) == inelastic
    kappa = lame - edge_lame
    # with Poisson's ratio .4 lambda is 4 mu up to rounding, and kappa is only this rounding
    above_rounding = kappa > checks.ALIKE * shear
    return np.where(isotropic & chosen & above_rounding, kappa, 0.0), edge_lame + shear


def _groups_of_nodes(cells: np.ndarray, starts: np.ndarray, size: int) -> tuple[np.ndarray, int]:
    """Return the group of each node (n,) of cells (n_cells, dim + 1), whose rows begin at ``starts``
    (n_cells + 1,), and the number of groups, of about ``size`` nodes each."""
    n = cells.max() + 1
    group = np.full(n, -1, dtype=np.int32)
    neighbours = pattern(elements_of_nodes(cells, n), starts, read_only(cells.reshape(-1)))
    return group, _gather(*neighbours, size, group)


def _nodes_of_bodies(mesh: MeshArrays, chosen: np.ndarray) -> np.ndarray:
    """Return the corners (n_chosen, dim + 1) of chosen elements, a mask (n_elements,), by numbers of
    their nodes along a curve through space, along which groups grow side by side: few gaps are left
    between them. A node that several bodies share has a number for each."""
    cells, points = separate_bodies(mesh)
    nodes, number = np.unique(cells[chosen], return_inverse=True)
    rank = np.empty(len(nodes), dtype=np.int32)
    rank[morton_order(points[nodes])] = np.arange(len(nodes), dtype=np.int32)
    return rank[number.reshape(-1, mesh.dim + 1)]


@kernel
def _gather(indptr, indices, size, group):
    """Number the groups of nodes in ``group``, which comes as -1; returns their number. A group
    grows from the first free node over free neighbours, those of its first members first, to ``size``
    nodes; a group that stays smaller joins its smallest neighbour. Node i has the neighbours
    ``indices[indptr[i]:indptr[i + 1]]``, and is one of them."""
    n = len(group)
    n_groups = 0
    queue = np.empty(size, dtype=np.int64)
    sizes = np.zeros(n, dtype=np.int64)
    for seed in range(n):
        if group[seed] >= 0:
            continue
        queue[0] = seed
        group[seed] = n_groups
        n_members = 1
        smallest_neighbour = -1
        # k runs over the members, which grow
        for k in range(size):
            if k == n_members:
                break
            for p in range(indptr[queue[k]], indptr[queue[k] + 1]):
                other = group[indices[p]]
                if other < 0 and n_members < size:
                    queue[n_members] = indices[p]
                    group[indices[p]] = n_groups
                    n_members += 1
                elif 0 <= other < n_groups and (
                    smallest_neighbour < 0 or sizes[other] < sizes[smallest_neighbour]
                ):
                    smallest_neighbour = other
        if n_members < size and smallest_neighbour >= 0:
            for k in range(n_members):
                group[queue[k]] = smallest_neighbour
            sizes[smallest_neighbour] += n_members
        else:
            sizes[n_groups] = n_members
            n_groups += 1
    return n_groups
