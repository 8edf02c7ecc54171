r"""Plastic bodies on a mesh: their internal forces, and the linear problem of a Newton step.

With the strains :math:`B_p u` of the patches p of :mod:`adaptmg.discrete.elasticity`, on which the
material gives a stress :math:`\sigma_p` for the state at the beginning of the load step, the bodies
resist with

.. math:: f_\mathrm{int}(u) = \sum_p V_p\, B_p^T \sigma_p(B_p u) = K u - \sum_p V_p\, B_p^T
   \rho_p,\qquad \rho_p = C B_p u - \sigma_p ,

K being the elastic stiffness with all springs. The tangent :math:`K_t` at u has the derivatives
of the stresses in place of C, and the contact problem

.. math:: K_t w = f + K_t u - f_\mathrm{int}(u) + \lambda(w)

has at w = u the residual of the nonlinear one, :math:`f + \lambda - f_\mathrm{int}(u)`: the
certificate of u in this problem is that of u as a solution of the nonlinear problem, with an energy
error in the norm of the tangent.

In smoothed elements the patches have a bulk modulus of .3 shear moduli, and groups of nodes the
rest (:func:`adaptmg.discrete.volumes.formed_volumes`): a law is split into :math:`\sigma - (K_b -
K'_b)\,\mathrm{tr}\,\varepsilon\, I` on the patches and what is elastic on the groups."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, cast

import numpy as np
from scipy import sparse

from adaptmg import _checks as checks
from adaptmg.discrete.elasticity import (
    Patches,
    Tangents,
    edge_means,
    patches_of,
)
from adaptmg.discrete.loads import supported_stiffness
from adaptmg.discrete.moduli import PAIRS, as_tensors, inelastic_bodies, moduli
from adaptmg.discrete.posed import Posed
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.discrete.stress import PlasticState, StressData
from adaptmg.discrete.volumes import Volumes, formed_volumes, volume_groups
from adaptmg.mesh.arrays import places_of

if TYPE_CHECKING:
    from adaptmg.problem.plastic import Inelastic


@dataclass(frozen=True, eq=False)
class Response:
    """The stresses, tangents, states and forces of inelastic patches at a displacement."""

    displacement: np.ndarray  # (n_dofs,): unknowns, m
    stress: np.ndarray  # (m, k): on smoothed patches without the part on groups of nodes, Pa
    tangent: np.ndarray  # (m, k, k): derivatives of these stresses by the strains, Pa
    #: (m, n), n being the largest ``state_size`` of all materials, at least 1; 0 behind a shorter state
    state: np.ndarray
    missed: np.ndarray  # (n_dofs,): f - f_int, N


@dataclass(frozen=True, eq=False)
class InelasticBodies:
    """The patches of plastic bodies on one mesh."""

    posed: Posed
    #: the material of each plastic body, and the numbers (n,) of its patches among the m plastic ones: rows
    #: of the arrays below
    members: tuple[tuple[Inelastic, np.ndarray], ...]
    numbers: np.ndarray  # (m,): of the plastic patches among those of all bodies, ascending
    n_patches: int  # of all bodies
    strains: sparse.csr_array  # (m * k, n_dofs): B, 1/m
    measures: np.ndarray  # (m,): volumes
    elastic: np.ndarray  # (m, k, k): C, Pa
    bulk: np.ndarray  # (m,): part of the bulk modulus that acts on groups of nodes, Pa
    groups: Volumes  # groups of nodes that this part acts on; none of linear elements

    @classmethod
    def of(cls, posed: Posed) -> InelasticBodies:
        """Return the plastic bodies of a posed problem."""
        mesh = posed.mesh
        elements = posed.problem.elements
        patches = patches_of(mesh, posed.materials, elements)
        body = mesh.element_body[patches.element]
        inelastic = inelastic_bodies(posed.materials)
        numbers = np.flatnonzero(inelastic[body])
        # both tables have their rows in the same order, which mesh and materials decide
        whole_tensors = moduli(mesh, posed.materials)
        tensors = moduli(mesh, posed.materials, elements)
        tensor_of_patch = tensors.rows[patches.element][numbers]
        members = tuple(
            (posed.materials[k].inelastic, np.flatnonzero(body[numbers] == k))
            for k in np.flatnonzero(inelastic)
        )
        return cls(
            posed=posed,
            members=members,
            numbers=numbers,
            n_patches=len(patches.measures),
            # k = 2 dim components of strain: in the plane xx, yy, zz, xy
            strains=_strain_matrix(patches, numbers, n_dofs=mesh.points.size, k=2 * mesh.dim),
            measures=patches.measures[numbers],
            elastic=tensors.table[tensor_of_patch],
            # C_xxyy is Lame's first constant: the shear moduli of both tensors are the same
            bulk=(whole_tensors.table - tensors.table)[tensor_of_patch, 0, 1],
            groups=volume_groups(mesh, posed.materials, inelastic=True)
            if elements == "smoothed"
            else Volumes.none(mesh.n_nodes, mesh.dim),
        )

    @cached_property
    def volumes(self) -> sparse.bsr_array:
        """Return the matrix (n_dofs, n_dofs) that groups of nodes add to the stiffness, N/m."""
        return formed_volumes(self.groups, self.posed.mesh.dim)

    @property
    def unloaded(self) -> np.ndarray:
        """Return the states (m, n) of bodies before any load."""
        # at least one number, which ``result`` reads also of bodies without a state; of shorter states the rest is 0
        size = max(1, *(material.state_size for material, _ in self.members))
        return np.zeros((len(self.numbers), size))

    def respond(
        self, problem: DiscreteProblem, displacement: np.ndarray, state: np.ndarray
    ) -> Response:
        """Return the response to unknowns (n_dofs,) of an elastic ``problem``, of bodies whose ``state``
        (m, n) is that at the beginning of the load step."""
        k = self.elastic.shape[1]
        strain = (self.strains @ problem.physical(displacement).reshape(-1)).reshape(-1, k)
        stress, tangent, new_state = self._material(strain, state)
        if self.bulk.any():
            # without (K_b - K'_b) tr(eps) I, which acts on the mean volume strains of groups of nodes
            stress[:, :3] -= (self.bulk * strain[:, :3].sum(axis=1))[:, None]
            tangent[:, :3, :3] -= self.bulk[:, None, None]
        # f - f_int = f - K u + sum V B' rho, rho = C B u - sigma
        relaxed = np.einsum("nij,nj->ni", self.elastic, strain) - stress
        forces = self.strains.T @ (self.measures[:, None] * relaxed).reshape(-1)
        missed = problem.residual(displacement) + problem.relative_forces(forces)
        return Response(displacement, stress, tangent, new_state, missed)

    def linearised(self, problem: DiscreteProblem, response: Response) -> DiscreteProblem:
        """Return the contact problem of the module, whose bodies have the tangent K_t at a response."""
        posed = self.posed
        matrix = supported_stiffness(
            posed.mesh,
            posed.materials,
            posed.problem.supports,
            posed.problem.elements,
            Tangents(self.numbers, response.tangent, self.volumes),
        )
        if problem.coupling is not None:
            matrix = problem.coupling.transformed(matrix)
        return problem.restructured(
            matrix=matrix,
            load=matrix @ response.displacement + response.missed,  # f + K_t u - f_int(u)
            strain_free=None,  # its energy terms belong to the elastic matrix
            inelastic=False,  # with this matrix and load the bodies are linear
        )

    def _material(
        self, strain: np.ndarray, state: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the stresses (m, k), tangents (m, k, k) and states (m, n) that the materials answer to
        strains (m, k) after ``state`` (m, n), checked."""
        k = strain.shape[1]
        stress = np.empty(strain.shape)
        tangent = np.empty((len(strain), k, k))
        result = np.zeros(state.shape)
        for material, patches in self.members:
            size = material.state_size
            shapes = ((len(patches), k), (len(patches), k, k), (len(patches), size))
            answer = material.response(strain[patches], state[patches, :size])
            if not isinstance(answer, tuple) or len(answer) != 3:
                raise TypeError(
                    f"material: response must return stress, tangent and state, got "
                    f"{checks.shown(answer)}"
                )
            names = ("the stress", "the tangent", "the state")
            stress[patches], tangent[patches], result[patches, :size] = (
                checks.array(f"{name} that response of material returns", value, shape)
                for name, value, shape in zip(names, answer, shapes, strict=True)
            )
        skew = np.abs(tangent - tangent.swapaxes(1, 2)).max()
        if not skew <= checks.ALIKE * np.abs(tangent).max():
            raise ValueError(
                "the tangent that response of material returns must be symmetric, got an asymmetry "
                f"of {skew:g} Pa: return its symmetric part"
            )
        return stress, tangent, result

    def result(self, problem: DiscreteProblem, response: Response, data: StressData) -> StressData:
        """Return stress data with the stresses and plastic strains of a response."""
        physical = problem.physical(response.displacement)
        k = self.elastic.shape[1]
        strain = (self.strains @ physical.reshape(-1)).reshape(-1, k)
        volume_strain = strain[:, :3].sum(axis=1)
        whole_stress = response.stress.copy()
        whole_stress[:, :3] += (self.bulk * volume_strain)[:, None]
        stiffness = self.elastic.copy()
        stiffness[:, :3, :3] += self.bulk[:, None, None]
        # what the whole stress leaves of the strain is plastic
        plastic = strain - np.linalg.solve(stiffness, whole_stress[:, :, None])[:, :, 0]
        plastic[:, 3:] *= 0.5  # components of tensors, not angles
        inelastic = inelastic_bodies(self.posed.materials)[self.posed.mesh.element_body]
        stress = data.tensors(self.posed.mesh, physical)
        stress[inelastic] = as_tensors(self._of_elements(response.stress)[inelastic])
        # groups of nodes bear the rest of the pressure, kappa times their mean volume strain b u
        pressures = self.groups.strains(physical.reshape(-1)) / self.groups.compliance
        of_elements = self.groups.of_elements(pressures)
        if of_elements is not None:
            stress[inelastic] += of_elements[inelastic, None, None] * np.eye(3)
        # the place of the last number of each state: of Plastic the accumulated plastic strain, a zero of materials
        # without a state
        last = np.zeros((len(self.numbers), 1), dtype=np.int64)
        for material, patches in self.members:
            last[patches] = max(material.state_size, 1) - 1
        accumulated = np.take_along_axis(response.state, last, axis=1)
        plastic_state = PlasticState(
            state=response.state,
            stress=stress,
            strain=as_tensors(self._of_elements(plastic)),
            accumulated=self._of_elements(accumulated)[:, 0],
        )
        return replace(data, plastic=plastic_state)

    def _of_elements(self, values: np.ndarray) -> np.ndarray:
        """Return the values (n_elements, n) of elements from those (m, n) of the patches, zero in
        elastic bodies."""
        every = np.zeros((self.n_patches, values.shape[1]))
        every[self.numbers] = values
        return (
            edge_means(self.posed.mesh, every)
            if self.posed.problem.elements == "smoothed"
            else every
        )


def _strain_matrix(patches: Patches, numbers: np.ndarray, n_dofs: int, k: int) -> sparse.csr_array:
    """Return the matrix (n * k, n_dofs) of the strains of patches ``numbers`` (n,), which have k
    components each."""
    dim = patches.slopes.shape[1]
    number_among_chosen = places_of(numbers, len(patches.measures))
    patch_of_corner = np.repeat(number_among_chosen, np.diff(patches.start))
    chosen = patch_of_corner >= 0
    # for each corner of these patches the first row of its patch, the first column of its node
    row = k * patch_of_corner[chosen]
    column = dim * patches.nodes[chosen].astype(np.int64)
    slopes = patches.slopes[chosen]
    entries = []
    # component c of the strain is u_i,j, and of shear strains u_i,j + u_j,i
    for c, (i, j) in enumerate(PAIRS[:k].tolist()):
        if max(i, j) < dim:
            entries.append((row + c, column + i, slopes[:, j]))
        if i != j:
            entries.append((row + c, column + j, slopes[:, i]))
    if len(patches.hoops):  # zz is the hoop strain, of the displacement along r
        entries.append((row + 2, column, patches.hoops[chosen]))
    rows, columns, values = map(np.concatenate, zip(*entries, strict=True))
    shape = (k * len(numbers), n_dofs)
    return sparse.csr_array(sparse.coo_array((cast("np.ndarray", values), (rows, columns)), shape))
