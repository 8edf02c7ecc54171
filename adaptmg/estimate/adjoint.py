r"""The linearised contact problem of a solution, and its adjoint: what a force at any place changes
in a quantity.

With the normal n, a tangent t and the direction f of the friction force on the body, the condition
of a slipping node is :math:`r_t - \mu p f = 0`, r = A u - b, p = -r_n. An error v of the
displacement therefore has :math:`v_n = 0` where bodies touch and :math:`v_t = 0` where they stick,
and its equations are those of A, but at slipping nodes

.. math:: (A_t + H)\,v + \mu f A_n\,v, \qquad H = \frac{g}{|s|}\Bigl(I - \frac{s s^T}{|s|^2}\Bigr)

(H in 3D; slip s, limit g). With the errors E and the combinations T of equations (:math:`t + \mu
f\,n` at a slipping node) the dual field z of a functional j solves the transpose of :math:`T^T (A +
H) E`,

.. math:: E^T (A + H)\,T\,y = E^T j, \qquad z = T y .

GMRES (Y. Saad, M. H. Schultz, SIAM J. Sci. Stat. Comput. 7, 1986, doi:10.1137/0907058) solves it,
preconditioned by a multigrid cycle on the same matrix; small problems and those of a single level
are factorised."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, gmres, splu

from adaptmg import _checks as checks
from adaptmg.discrete.coordinates import block_diagonal, rotate, rotate_back, to_frames
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.hierarchy import Hierarchy
from adaptmg.multigrid.linear_cycle import LinearCycle
from adaptmg.multigrid.split_matrix import nodal_prolongations, split
from adaptmg.smoother.system import ContactState as State
from adaptmg.smoother.system import held_tangents, local_contact, local_system
from adaptmg.solver.record import Run
from adaptmg.transfer.galerkin import coarse_matrix

_LOG = logging.getLogger(__name__)

#: relative residual of the adjoint problems: on 32 goals of 8 problems 67 iterations change estimates by 1e-5 in the
#: median; with half 71, with twice 62, with 1e-2 39 and 5e-3
RTOL = 1e-4
#: iterations of GMRES
MAX_ITERATIONS = 100


@dataclass(frozen=True, eq=False)
class LinearisedContact:
    """The contact nodes of a solution, in local components (normal, tangents)."""

    discrete: DiscreteProblem
    frames: np.ndarray  # (n, dim, dim)
    state: np.ndarray  # (n,) int: am.OPEN, am.SLIP, am.STICK
    unknowns: np.ndarray  # (n_dofs,): relative coordinates, Cartesian, m
    residual: np.ndarray  # (n_dofs,): A u - b, Cartesian, N
    gap: np.ndarray  # (n,), m
    slip: np.ndarray  # (n, dim - 1), m
    fixed_limit: np.ndarray  # (n,): part of the limit that does not depend on the pressure, N
    #: (n,) bool: nodes with friction at its limit, open ones of Tresca's law included
    is_slipping: np.ndarray
    is_sticking: np.ndarray  # (n,) bool
    friction_direction: np.ndarray  # (n, dim - 1): f at slipping nodes
    friction_by_pressure: np.ndarray  # (n, dim - 1): mu f at nodes that slip and touch, else 0
    hessian: np.ndarray  # (n, dim - 1, dim - 1): H of slipping nodes, N/m
    free: np.ndarray  # (n, dim) bool: components in which an error may move
    held: np.ndarray  # (n, dim - 1) bool: tangents that a support holds

    @property
    def nodes(self) -> np.ndarray:
        """Return the contact nodes (n,)."""
        return self.discrete.contact.nodes

    def local(self, vector: np.ndarray) -> np.ndarray:
        """Return a Cartesian vector (n_dofs,) in local components at the contact nodes."""
        return rotate(vector, self.frames, self.nodes)

    def cartesian(self, vector: np.ndarray) -> np.ndarray:
        """Return the inverse of :meth:`local`."""
        return rotate_back(vector, self.frames, self.nodes)

    @property
    def fixed_friction(self) -> np.ndarray:
        """Return the forces (n_dofs,) of the friction that does not depend on pressure, in local
        components, N."""
        forces = np.zeros((self.discrete.n_nodes, self.discrete.dim))
        forces[self.nodes, 1:] = (
            np.where(self.is_slipping, self.fixed_limit, 0.0)[:, None] * self.friction_direction
        )
        return forces.reshape(-1)


def linearised_contact(
    discrete: DiscreteProblem, displacement: np.ndarray, state: np.ndarray
) -> LinearisedContact:
    """Return the contact conditions linearised at a displacement (n_nodes, dim), m, with the
    ``state`` (n,) of its contact nodes."""
    nodal, frames = local_contact(discrete)
    dim = discrete.dim
    nodes = discrete.contact.nodes
    unknowns = discrete.relative(displacement).reshape(-1)
    residual = discrete.matrix @ unknowns - discrete.load
    # slips, gaps and contact forces, in contact frames
    held = held_tangents(discrete)
    relative_slip = to_frames(
        frames, discrete.at_contact(unknowns) - discrete.contact.slip_reference
    )
    slip = relative_slip[:, 1:]
    # the largest normal displacement from the prescribed values, minus that of the solution
    gap = nodal.gap - np.einsum(
        "nj,nj->n", frames[:, 0], discrete.from_prescribed(unknowns).reshape(-1, dim)[nodes]
    )
    force = to_frames(frames, residual.reshape(-1, dim)[nodes])
    # along what supports hold it contains their reaction
    force[:, 1:][held] = 0.0
    slip_length = np.linalg.norm(slip, axis=1)
    at_rest = slip_length <= checks.ROUNDING * np.abs(unknowns).max(initial=0.0)
    # open nodes stick or slip, too, where friction does not need pressure, as of Tresca's law
    is_open_with_friction = (state == State.OPEN) & (nodal.limit > 0)
    is_sticking = (state == State.STICK) | (is_open_with_friction & at_rest)
    is_slipping = (state == State.SLIP) | (is_open_with_friction & ~at_rest)
    # friction g f with the limit g = limit + mu |normal force| in the direction f = -s/|s| against the
    # slip s: its derivative by the normal force is mu f
    friction_direction = _opposite(slip, slip_length, force[:, 1:])
    friction_by_pressure = np.where(
        (state == State.SLIP)[:, None], nodal.friction[:, None] * friction_direction, 0.0
    )
    # and that by the slip is -H with H = g/|s| (I - f f')
    limit = nodal.limit + nodal.friction * np.maximum(-force[:, 0], 0.0)
    moves = is_slipping & (slip_length > 0)
    stiffness = np.where(moves, limit / np.where(moves, slip_length, 1.0), 0.0)
    hessian = stiffness[:, None, None] * (
        np.eye(dim - 1) - friction_direction[:, :, None] * friction_direction[:, None, :]
    )
    # an error may change neither the gap where bodies touch nor the slip where they stick
    free = np.ones((len(nodes), dim), dtype=bool)
    free[state != State.OPEN, 0] = False
    free[:, 1:] = ~held & ~is_sticking[:, None]
    return LinearisedContact(
        discrete=discrete,
        frames=frames,
        state=state,
        unknowns=unknowns,
        residual=residual,
        gap=gap,
        slip=slip,
        fixed_limit=nodal.limit,
        is_slipping=is_slipping,
        is_sticking=is_sticking,
        friction_direction=friction_direction,
        friction_by_pressure=friction_by_pressure,
        hessian=hessian,
        free=free,
        held=held,
    )


def _opposite(slip: np.ndarray, length: np.ndarray, force: np.ndarray) -> np.ndarray:
    """Return unit vectors (n, dim - 1) against the slip of this length (n,); where there is none,
    along the force (n, dim - 1)."""
    size = np.linalg.norm(force, axis=1)
    along = np.divide(force, size[:, None], out=np.zeros_like(slip), where=size[:, None] > 0)
    return np.divide(-slip, length[:, None], out=along, where=length[:, None] > 0)


@dataclass(frozen=True, eq=False)
class AdjointSolution:
    """The solution of an adjoint problem."""

    #: (n_dofs,): z in relative coordinates, Cartesian, m/N times the unit of the quantity
    field: np.ndarray
    residual: float  # euclidean, over that of the functional
    iterations: int  # 0 of a direct solution
    converged: bool  # whether the residual is below the tolerance


@dataclass(frozen=True, eq=False)
class AdjointSystem:
    """The adjoint matrix in local components."""

    contact: LinearisedContact
    matrix: sparse.bsr_array  # (n_dofs, n_dofs)
    trial: np.ndarray  # (n_dofs,) bool: dofs that an error has
    test: sparse.csr_array  # (n_dofs, n_dofs): T on them

    def direct(self, functionals: list[np.ndarray]) -> list[AdjointSolution]:
        """Return dual fields of functionals (n_dofs,), by one sparse factorisation."""
        free = np.flatnonzero(self.trial)
        result = []
        try:
            factors = splu(sparse.csc_array(sparse.csr_array(self.matrix)[free][:, free]))
        except RuntimeError as error:
            raise np.linalg.LinAlgError(
                "the adjoint matrix is singular, the contact state leaves a motion free: solve more accurately, or add "
                "a support"
            ) from error
        for functional in functionals:
            load = self._load(functional)
            y = np.zeros(len(self.trial))
            y[free] = factors.solve(load[free])
            residual = self._relative(load, y)
            result.append(
                AdjointSolution(
                    field=self._field(y),
                    residual=residual,
                    iterations=0,
                    # a factorisation leaves rounding, unless the matrix is singular up to rounding
                    converged=residual <= checks.SIX_DIGITS,
                )
            )
        return result

    def multigrid(
        self,
        hierarchy: Hierarchy,
        functionals: list[np.ndarray],
        rtol: float = RTOL,
        max_iterations: int = MAX_ITERATIONS,
    ) -> list[AdjointSolution]:
        """Return dual fields of functionals (n_dofs,), by GMRES with a multigrid cycle."""
        cycle = _cycle(hierarchy, self)
        n = len(self.trial)
        finest = len(hierarchy) - 1

        def precondition(load: np.ndarray) -> np.ndarray:
            return cycle.solve(finest, load.reshape(-1)).copy()  # the cycle reuses its vector

        preconditioner = LinearOperator((n, n), matvec=precondition, dtype=np.float64)
        result = []
        for functional in functionals:
            load = self._load(functional)
            norms = []
            # scipy tests the preconditioned residual: where the true one is larger than ``rtol``, GMRES
            # goes on from its result to a tenth of the tolerance, at most twice
            y = np.zeros(n)
            tolerance = rtol
            for _ in range(3):
                y, _ = gmres(
                    self.matrix,
                    load,
                    x0=y,
                    rtol=tolerance,
                    atol=0.0,
                    restart=min(max_iterations, 30),  # iterations to a restart
                    maxiter=max(1, max_iterations // 30),  # restarts
                    M=preconditioner,
                    callback=norms.append,
                    callback_type="pr_norm",
                )
                residual = self._relative(load, y)
                if residual <= rtol or len(norms) >= max_iterations:
                    break
                tolerance *= 0.1
            if residual > rtol:
                _LOG.info(
                    "the adjoint problem was solved to %.1e, not %.1e, in %d iterations",
                    residual,
                    rtol,
                    len(norms),
                )
            result.append(
                AdjointSolution(
                    field=self._field(y),
                    residual=residual,
                    iterations=len(norms),
                    converged=residual <= rtol,
                )
            )
        return result

    def _load(self, functional: np.ndarray) -> np.ndarray:
        """Return E^T j (n_dofs,) of a functional j."""
        free = self.contact.discrete.free_part(functional)
        return np.where(self.trial, self.contact.local(free), 0.0)

    def _field(self, y: np.ndarray) -> np.ndarray:
        """Return the dual field z = T y (n_dofs,), Cartesian."""
        return self.contact.cartesian(self.test @ np.where(self.trial, y, 0.0))

    def _relative(self, load: np.ndarray, y: np.ndarray) -> float:
        """Return the Euclidean norm of the residual of y (n_dofs,) over that of the load (n_dofs,), if the
        latter is not 0."""
        size = float(np.linalg.norm(load))
        residual = float(np.linalg.norm(np.where(self.trial, load - self.matrix @ y, 0.0)))
        return residual / size if size > 0 else residual


def error_spaces(
    contact: LinearisedContact,
) -> tuple[sparse.csr_array, np.ndarray, sparse.csr_array]:
    """Return A + H in local components, the mask (n_dofs,) of the dofs in which an error may move,
    and T (n_dofs, n_dofs), whose columns are zero at other dofs; see the module."""
    local = local_system(contact.discrete)
    dim = contact.discrete.dim
    n = contact.discrete.n_dofs
    matrix = sparse.csr_array(local.system.matrix)
    # dofs of the contact nodes
    at = contact.nodes[:, None] * dim + np.arange(dim)
    if contact.hessian.any():
        rows, columns = np.broadcast_arrays(at[:, 1:, None], at[:, None, 1:])
        matrix = matrix + sparse.csr_array(
            (contact.hessian.ravel(), (rows.ravel(), columns.ravel())), shape=(n, n)
        )
    trial = ~local.system.fixed
    trial[at[~contact.free]] = False
    # T: ones on the diagonal and, at tangents that slip, mu f in the row of the normal
    free_dofs = np.flatnonzero(trial)
    node, tangent = np.nonzero(contact.friction_by_pressure)
    moves = trial[at[node, 1 + tangent]]
    node = node[moves]
    tangent = tangent[moves]
    entries = np.concatenate([np.ones(len(free_dofs)), contact.friction_by_pressure[node, tangent]])
    rows = np.concatenate([free_dofs, at[node, 0]])
    columns = np.concatenate([free_dofs, at[node, 1 + tangent]])
    test = sparse.csr_array((entries, (rows, columns)), shape=(n, n))
    return matrix, trial, test


def adjoint_system(contact: LinearisedContact) -> AdjointSystem:
    """Return the adjoint system of linearised contact conditions."""
    local_matrix, trial, test = error_spaces(contact)
    keep = sparse.diags_array(trial.astype(float), format="csr")
    dim = contact.discrete.dim
    # E'(A + H) T, and ones at dofs that an error does not have
    product = keep @ local_matrix @ test + sparse.diags_array((~trial).astype(float), format="csr")
    matrix = sparse.bsr_array(sparse.csr_array(product), blocksize=(dim, dim)).sorted_indices()
    return AdjointSystem(contact, matrix, trial, test)


def _cycle(hierarchy: Hierarchy, system: AdjointSystem) -> LinearCycle:
    r"""Return a V-cycle for the adjoint matrix M, which is not symmetric where nodes slip with Coulomb
    friction. M is in local components with the dofs that cannot move decoupled, Z; with the frames
    F at contact nodes and the nodal prolongation P the first coarse matrix is :math:`(Z F P)^T M Z
    F P`; those below are Galerkin products with P."""
    levels = hierarchy.levels
    dim = system.contact.discrete.dim
    # from the finest level to the coarsest
    matrices = [split(system.matrix, ~system.trial)]
    rotated = _rotated(levels[-1].prolongation, system.contact, system.trial)
    prolongations = [rotated]
    coarse = sparse.csr_array(rotated.T @ sparse.csr_array(system.matrix) @ rotated)
    # a coarse dof from which only decoupled ones would be interpolated has a row of zeros: the largest
    # diagonal entry there makes the matrix regular, and leaves the dof at 0
    diagonal = coarse.diagonal()
    coarse = coarse + sparse.diags_array(
        np.where(diagonal == 0, np.abs(diagonal).max(), 0.0), format="csr"
    )
    matrix = sparse.bsr_array(sparse.csr_array(coarse), blocksize=(dim, dim)).sorted_indices()
    matrices.append(split(matrix, levels[-2].discrete.fixed))
    further = zip(nodal_prolongations(hierarchy)[:-1], levels[:-2], strict=True)
    for nodal, level in reversed(list(further)):
        matrix = coarse_matrix(matrix, nodal)
        matrices.append(split(matrix, level.discrete.fixed))
        prolongations.append(nodal)
    # nothing reads the work that the run counts
    cycle = LinearCycle(
        matrices[::-1], prolongations[::-1], Run(unit=1), sweeps=[2] * len(matrices)
    )
    cycle.renew(len(matrices) - 1)  # factorises the coarsest matrix
    return cycle


def _rotated(
    nodal: sparse.csr_array, contact: LinearisedContact, trial: np.ndarray
) -> sparse.csr_array:
    """Return Z F P (n_dofs, n_dofs coarse) of :func:`_cycle`, with sorted columns; ``nodal`` is P, and Z
    keeps the dofs of ``trial`` (n_dofs,)."""
    dim = contact.discrete.dim
    frames = np.broadcast_to(np.eye(dim), (contact.discrete.n_nodes, dim, dim)).copy()
    frames[contact.nodes] = contact.frames
    rotation = sparse.csr_array(block_diagonal(frames))
    keep = sparse.diags_array(trial.astype(float), format="csr")
    result = sparse.csr_array(
        keep @ rotation @ sparse.kron(nodal, sparse.eye_array(dim), format="csr")
    )
    result.eliminate_zeros()
    result.sort_indices()
    return checks.indices_frozen(result)
