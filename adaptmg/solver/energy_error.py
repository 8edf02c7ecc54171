r"""The energy error of a displacement, estimated from the raw matrix by a few steps of a Galerkin
method.

With the contact status of the displacement held, u is first moved onto its constraints by a change
z of constrained dofs alone: v = u + z has its prescribed values, touching nodes on the obstacle,
sticking nodes at zero slip. What is then missing is a correction in the space of the displacements
that keep the status,

.. math:: \|u - u_h\|_A \le \|z\|_A + \|v - u_h\|_A,

the solution of :math:`K (I + D) A\,y + K S\,y = e`: e the forces at v that no load, support or
lawful contact force explains, K the projection onto that space, S the stiffness of friction that
turns with the slip, D the friction that a change of the pressure brings (Coulomb). Its Galerkin
solution in the span of preconditioned residuals is sought, without D by conjugate gradients, whose
energy grows from step to step and is never too large. The preconditioner: forward Gauss-Seidel, the
rigid motions of :mod:`adaptmg.solver.aggregates`, backward Gauss-Seidel. A residual r holds at most
the energy :math:`r\cdot P r / \lambda`, with the least eigenvalue :math:`\lambda` of the
preconditioned matrix; the least Ritz value of the steps stands for it, which falls towards it. The
steps end when this value has settled and what the last step may have left is small; it is counted
as missing. Where they do not settle, a factorisation decides if the matrix is not too large for
one.

Where a problem has volumes, pressures q of groups are missing, too, and the correction (y, q)
solves

.. math:: K(I + D)(K' y + B^T q) + K S\,y = e,\qquad -B y + A\,q/\kappa = -A\,(b\,v - p/\kappa);

its energy is :math:`y'K'y + \sum A q^2/\kappa`, that of the whole displacement where :math:`p =
\kappa\,b\,u`. Directions are z, the residual of the first equation preconditioned, with
:math:`(\rho + B z)/(A/\kappa + A/(\lambda_1 + \mu))`, :math:`\rho` the residual of the second one.
The symmetric part of the equations is the energy. The steps end when the last two have hardly
changed it.

Nothing here comes from the solvers but the arithmetic of small blocks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from adaptmg import _checks as checks
from adaptmg._numba import kernel, prefetch
from adaptmg.discrete.block_rows import table_column, table_row
from adaptmg.discrete.elasticity import nodal_matrix
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.smoother.blocks import (
    AHEAD,
    ONE,
    SIX,
    THREE,
    TWO,
    ZERO,
    add,
    increase,
    negative,
    read,
    scale,
    subtract,
    times,
    transposed_times,
    upper,
    write,
)
from adaptmg.smoother.strips import Strips
from adaptmg.solver.aggregates import Aggregates, CoarseCorrection

#: the share of the energy that the last step may have left, and of the least Ritz value that stays; with
#: volumes the share by which each of the last two steps may have changed the energy
#: _MISSING: a tenth changes 2 of 373 random solves by a cycle, no limit one by two
_MISSING, _SETTLED, _CALM = 0.3, 0.7, 0.1
#: least steps
_LEAST = 3
#: times the number of steps: the multiple of the negligible error up to which no further step is taken: .6 of rtol
#: after the second step, .9 after the third (seen at most 1.46 and 1.09 times too small). After the first step the
#: energy may still be far too small. Energies are squares: their multiples are 6^2 and 9^2
#: half changes 0 of 119 solves, paths and loops, twice 3; cycles 691, 691, 694 (campaign constants)
_SURER = 3.0
#: steps at most, without and with Coulomb friction, which needs all directions, and with volumes
_MOST, _MOST_COULOMB, _MOST_VOLUMES = 40, 16, 24
#: solves with a factorised matrix
_REFINEMENTS = 4
#: dofs up to which a factorisation is taken where the steps do not settle, by dimension
FACTORISED = {1: 100_000, 2: 100_000, 3: 30_000}


@dataclass(frozen=True, eq=False)
class FrozenStatus:
    """The space of the displacements that keep a contact status, and how contact forces change in
    it."""

    held: np.ndarray  # (m,) int: the contact nodes, then all other nodes in supports
    projections: np.ndarray  # (m, dim, dim): onto the free directions of the held nodes
    nodes: np.ndarray  # (n_contact,) int: contact nodes
    # (n_contact, dim, dim): stiffness of friction that turns with the slip (3D), and of springs, N/m
    stiffening: np.ndarray
    # (n_contact, dim, dim): friction by force on the node (Coulomb: friction grows with pressure)
    dragged: np.ndarray

    def project(self, vector: np.ndarray) -> None:
        """Project a vector (n_nodes, dim) onto the space, in place."""
        vector[self.held] = np.einsum("nij,nj->ni", self.projections, vector[self.held])


@kernel
def _invert(zero, data, places, inverse):
    """Invert the symmetric blocks at some places by cofactors: 2.2 ms for 263k plane nodes with seven
    blocks in a row. By numpy.linalg it takes 45, which pays only if the result is stored, 32 bytes a
    node. ``zero``, here and below, is ZERO[dim]."""
    size = np.uint64(len(zero) ** 2)
    for k in range(len(places)):
        at = size * np.uint64(k)
        # xx, xy, yy; in space xx, xy, xz, yy, yz, zz
        m = upper(data, size * np.uint64(places[k]), zero)
        if len(zero) == 1:
            inverse[at] = 1.0 / m[0]
        elif len(zero) == 2:
            factor = 1.0 / (m[0] * m[2] - m[1] * m[1])
            write(inverse, at, (factor * m[2], -factor * m[1]))
            write(inverse, at + TWO, (-factor * m[1], factor * m[0]))
        else:
            cofactors_x = (
                m[3] * m[5] - m[4] * m[4],
                m[2] * m[4] - m[1] * m[5],
                m[1] * m[4] - m[2] * m[3],
            )
            cofactor_yz = m[1] * m[2] - m[0] * m[4]
            factor = 1.0 / (m[0] * cofactors_x[0] + m[1] * cofactors_x[1] + m[2] * cofactors_x[2])
            write(inverse, at, scale(factor, cofactors_x))
            cofactors_y = (cofactors_x[1], m[0] * m[5] - m[2] * m[2], cofactor_yz)
            write(inverse, at + THREE, scale(factor, cofactors_y))
            cofactors_z = (cofactors_x[2], cofactor_yz, m[0] * m[3] - m[1] * m[1])
            write(inverse, at + SIX, scale(factor, cofactors_z))


@kernel
def _forward(
    first, last, order, zero, kinds, indptr, indices, data, rank, inverse, load, u, residual
):
    """Sweep by Gauss-Seidel from zero over places of ``order``, and leave the residual in
    ``residual``, which comes as 0. Of the matrix the half that couples a node with those of lower ``rank`` is
    read. With prefetch and unsigned positions 4.6 ms for 263k nodes (7.7), 1.8 for 36k in 3D
    (4.9).

    Arguments here and in the backward sweep: ``order`` (n_nodes,) has the node of each place of the
    sweep, ``rank`` the place of each node. ``kinds, indptr, indices, data`` are those of
    :class:`~adaptmg.discrete.block_rows.BlockRows`, a table of rows that equal nodes share: table_row
    finds the row of a node, and the ``origin`` that table_column adds to the columns there.
    ``inverse`` has the inverse diagonal blocks, flat; ``load``, ``u`` and the result are (n_dofs,)."""
    dim = np.uint64(len(zero))
    size = dim * dim
    ahead = np.int64(data.ctypes.data) + AHEAD
    for place in range(first, last):
        i = np.uint64(order[place])
        row, origin = table_row(kinds, i)
        begin = np.uint64(indptr[row])
        end = begin  # of the half: what follows is not read again
        r = read(load, dim * i, zero)
        for p in range(begin, np.uint64(indptr[row + ONE])):
            prefetch(np.uintp(ahead + np.int64(8 * size * p)))
            j = table_column(origin, indices, p)
            if rank[j] < place:
                r = subtract(r, times(data, size * p, read(u, dim * j, zero)))
                end = p + ONE
        value = times(inverse, size * i, r)
        write(u, dim * i, value)
        for p in range(begin, end):
            j = table_column(origin, indices, p)
            if rank[j] < place:
                change = negative(transposed_times(data, size * p, value))
                increase(residual, dim * j, change)


@kernel
def _backward(
    first, last, order, zero, kinds, indptr, indices, data, rank, inverse, load, u, image
):
    """Sweep by Gauss-Seidel from u, and leave the matrix times the result in ``image``, which comes as 0,
    in one pass. Nodes and the blocks of their rows are both visited from the last to the first:
    memory that is read in one direction comes in advance, in 3D in a third of the time."""
    dim = np.uint64(len(zero))
    size = dim * dim
    ahead = np.int64(data.ctypes.data) - AHEAD
    for place in range(last - 1, first - 1, -1):
        i = np.uint64(order[place])
        row, origin = table_row(kinds, i)
        begin = np.uint64(indptr[row])
        end = np.uint64(indptr[row + ONE])
        on_diagonal = begin
        total = zero
        for k in range(end - begin):
            p = end - ONE - k
            prefetch(np.uintp(ahead + np.int64(8 * size * p)))
            j = table_column(origin, indices, p)
            if j == i:
                on_diagonal = p
            else:
                total = add(total, times(data, size * p, read(u, dim * j, zero)))
        value = times(inverse, size * i, subtract(read(load, dim * i, zero), total))
        change = subtract(value, read(u, dim * i, zero))
        write(u, dim * i, value)
        increase(image, dim * i, add(total, times(data, size * on_diagonal, value)))
        # nodes j of higher rank are done: their image was made with the old u_i, so add A_ji change
        for p in range(begin, end):
            j = table_column(origin, indices, p)
            if rank[j] > place:
                increase(image, dim * j, transposed_times(data, size * p, change))


class _Preconditioner:
    """Forward Gauss-Seidel, coarse correction, backward Gauss-Seidel on the matrix of a status."""

    def __init__(
        self, problem: DiscreteProblem, status: FrozenStatus, aggregates: Aggregates
    ) -> None:
        """Invert the diagonal blocks, projected where the status holds nodes, and factorise the
        coarse matrix."""
        rows = problem.rows
        dim = problem.dim
        self._zero = ZERO[dim]
        self._strips = Strips.of(rows, stored=False)
        self._matrix = *rows.arrays, self._strips.rank
        self._coarse = CoarseCorrection(
            rows,
            aggregates,
            status.held,
            status.projections,
            status.nodes,
            status.stiffening,
        )
        blocks = rows.diagonal_blocks(status.held)
        blocks[: len(status.nodes)] += status.stiffening
        # directions that are projected away have no stiffness but rounding: their inverse is 0
        stiffness, axes = np.linalg.eigh(status.projections @ blocks @ status.projections)
        rounding = 1e-12 * np.abs(blocks).max(axis=(1, 2), initial=0.0)[:, None]
        stiffness[np.abs(stiffness) <= rounding] = np.inf
        self._inverse = np.empty(rows.n_nodes * dim * dim)
        _invert(self._zero, rows.data, rows.diagonal_places, self._inverse)
        of_held = (axes / stiffness[:, None]) @ axes.swapaxes(1, 2)
        self._inverse.reshape(-1, dim, dim)[status.held] = of_held

    def __call__(self, residual: np.ndarray, result: np.ndarray, image: np.ndarray) -> None:
        """Write the preconditioned residual (n_dofs,) to ``result``, and the stored matrix times it to
        ``image``, which comes as 0. Between the sweeps that is the residual after the first one."""
        arguments = self._zero, *self._matrix, self._inverse, residual, result, image
        self._strips.sweep(_forward, *arguments)
        self._coarse.add(image, result)
        image[:] = 0.0
        self._strips.sweep(_backward, *arguments, backward=True)


@dataclass(frozen=True, eq=False)
class HeldCorrection:
    """A correction of a displacement within the linear space of its contact status."""

    energy: float  # N m; infinite where the status leaves a motion free that is loaded
    moved: np.ndarray  # (n_contact, dim): the correction at the contact nodes, m
    forces: np.ndarray  # (n_contact, dim): the matrix times it there, N


def correction(
    problem: DiscreteProblem,
    status: FrozenStatus,
    residual: np.ndarray,
    missed: np.ndarray,
    aggregates: Aggregates | None,
    negligible: float,
    rounding: float,
) -> HeldCorrection:
    """Return the correction in the space of a status for a residual e (n_nodes, dim), which is
    overwritten, and ``missed`` (n_groups,), b v - p/kappa of the module.

    It is the estimate of a few steps if these settle. Otherwise, and without ``aggregates``, the
    equations are factorised; but above FACTORISED dofs the estimate is returned although it has not
    settled. No further step is taken for an energy that is small compared with ``negligible``, the
    energy (N m) of the negligible error (_SURER). A residual whose norm is at most ``rounding`` loads
    no motion."""
    status.project(residual)
    load = problem.volumes.right_side(residual.reshape(-1), missed)
    size = load @ load
    if not 0.0 < size < np.inf:  # nothing is missed, or the displacement has diverged
        none = np.zeros((len(status.nodes), problem.dim))
        return HeldCorrection(0.0 if size == 0.0 else np.inf, none, none)
    if aggregates is not None:
        kind = _EquationsWithVolumes if len(problem.volumes) else _Equations
        estimate, settled = _estimated(kind(problem, status, aggregates), load, negligible)
        if settled or problem.n_dofs > FACTORISED[problem.dim]:
            return estimate
    return _factorised(problem, status, load, rounding)


@dataclass(frozen=True, eq=False)
class _Direction:
    """A direction of the Galerkin method."""

    values: np.ndarray  # (n,): displacement and pressures
    image: np.ndarray  # (n,): the operator of the equations times the values
    at_contact: np.ndarray  # (2, n_contact, dim): displacement and forces at contact nodes

    def add(self, factor: float, other: _Direction) -> None:
        """Add a multiple of another direction, in place."""
        # without a product of long vectors, which would be the peak of memory of a whole solve
        linalg.blas.daxpy(other.values, self.values, a=factor)
        linalg.blas.daxpy(other.image, self.image, a=factor)
        np.add(self.at_contact, factor * other.at_contact, out=self.at_contact)

    def scale(self, factor: float) -> None:
        """Multiply all arrays by a factor, in place."""
        for array in vars(self).values():
            array *= factor


class _Equations:
    """The equations of a status, in ``n`` displacements. At most ``most`` steps are taken, none from a
    residual r with r.Pr at most ``least``, P the preconditioner."""

    least = 0.0

    def __init__(
        self, problem: DiscreteProblem, status: FrozenStatus, aggregates: Aggregates
    ) -> None:
        self.n = problem.n_dofs
        self.status = status
        self.precondition = _Preconditioner(problem, status, aggregates)
        self.symmetric = not status.dragged.any()
        self.most = _MOST if self.symmetric else _MOST_COULOMB
        self._ritz_root = np.zeros((_MOST, _MOST))  # R of settled_energy
        self._ritz = np.inf

    def direction(self, residual: np.ndarray) -> tuple[_Direction, Callable[[_Direction], float]]:
        """Return the preconditioned residual (n,), of displacements and pressures, as a direction (z, q),
        with its image (K (I + D)(K' z + B'q) + K S z, A/kappa q - B z); and its energy product with other
        directions, that of their values with the gradient (K' z + S z, A/kappa q)."""
        status = self.status
        shape = -1, status.projections.shape[1]
        values = np.empty_like(residual)  # z, and q
        image = np.zeros_like(residual)
        z = values[: self.n]
        forces = image[: self.n]  # K' z, completed in place
        self.precondition(residual[: self.n], z, forces)
        z_at_contact = z.reshape(shape)[status.nodes]
        forces_at_contact = forces.reshape(shape)[status.nodes]
        forces.reshape(shape)[status.nodes] += np.einsum(
            "nij,nj->ni", status.stiffening, z_at_contact
        )
        gradient = self.add_pressures(residual, values, image, forces_at_contact)
        by_node = forces.reshape(shape)
        drag = np.einsum("nij,nj->ni", status.dragged, forces_at_contact)
        by_node[status.nodes] += drag
        status.project(by_node)

        def energy_product(other: _Direction) -> float:
            if gradient is not None:
                return float(other.values @ gradient)
            # K other = other: the image is the gradient and the drag, so that no copy of the gradient
            # is stored
            return float(other.values @ image - np.sum(other.at_contact[0] * drag))

        return _Direction(
            values, image, np.stack([z_at_contact, forces_at_contact])
        ), energy_product

    def add_pressures(
        self,
        residual: np.ndarray,
        values: np.ndarray,
        image: np.ndarray,
        forces_at_contact: np.ndarray,
    ) -> np.ndarray | None:
        """Complete the values, the image and the forces of a direction, which comes with its
        displacement alone, by its pressures; return its gradient, None without pressures."""
        return None

    def settled_energy(
        self, energies: list[float], column: np.ndarray, product: float, negligible: float
    ) -> float | None:
        """Return the energy of a solution and what its residual may hold, if the last step has settled it:
        where the least Ritz value has settled, and the energy that the residual may hold is small, or an
        energy up to some multiples of ``negligible``, N m (_SURER); else None. ``energies``: 0, then those
        after each step; ``column`` and ``product``: the energy products of the last direction with all, and its
        r.Pr."""
        # the vectors P r_k, r_k residuals of unit length r.Pr, are the directions times R, so that the
        # energy of a combination P r c is |R c|^2: the least Ritz value is the square of the least
        # singular value of R. Products with directions that are not stored vanish
        step = len(energies) - 1
        energy = energies[-1]
        self._ritz_root[step - len(column) : step, step - 1] = column / np.sqrt(product)
        ritz_before = self._ritz
        singular_values = np.linalg.svd(self._ritz_root[:step, :step], compute_uv=False)
        self._ritz = singular_values[-1] ** 2
        # the residual before this step holds at most the energy r.Pr / lambda
        most_energy = max(energies[-2] + product / self._ritz, energy)
        missing_energy = most_energy - energy
        if not self.symmetric:
            missing_energy = max(missing_energy, abs(energy - energies[-2]))
        settled = (
            step >= _LEAST
            and missing_energy <= _MISSING * energy
            and self._ritz >= _SETTLED * ritz_before
        )
        is_negligible = step > 1 and most_energy <= (min(step, _LEAST) * _SURER) ** 2 * negligible
        return most_energy if settled or is_negligible else None


class _EquationsWithVolumes(_Equations):
    """The equations of a status in displacements and pressures; the signs of those of volumes make them
    positive."""

    least = -np.inf  # at first only volumes may miss something

    def __init__(
        self, problem: DiscreteProblem, status: FrozenStatus, aggregates: Aggregates
    ) -> None:
        super().__init__(problem, status, aggregates)
        self.symmetric = False
        self.most = _MOST_VOLUMES
        self.volumes = problem.volumes

    def add_pressures(
        self,
        residual: np.ndarray,
        values: np.ndarray,
        image: np.ndarray,
        forces_at_contact: np.ndarray,
    ) -> np.ndarray:
        forces = image[: self.n]
        soft = self.volumes.areas * self.volumes.compliance  # A/kappa
        strains = self.volumes.rows @ values[: self.n]  # B z
        # (rho + B z) / (A/kappa + A/(lambda_1 + mu))
        q = (residual[self.n :] + strains) / (soft + self.volumes.areas / self.volumes.modulus)
        values[self.n :] = q
        gradient = np.append(forces, soft * q)
        of_pressures = self.volumes.forces(q)
        forces += of_pressures
        by_node = of_pressures.reshape(-1, self.status.projections.shape[1])
        forces_at_contact += by_node[self.status.nodes]
        image[self.n :] = soft * q - strains
        return gradient

    def settled_energy(
        self, energies: list[float], column: np.ndarray, product: float, negligible: float
    ) -> float | None:
        """Return the energy of a solution if the last two steps have hardly changed it, else None."""
        energy = energies[-1]
        last_changes = [abs(energy - before) for before in energies[-3:-1]]
        settled = len(energies) > _LEAST and max(last_changes) <= _CALM * energy
        return energy if settled else None


class _GalerkinSolution:
    """The solution in the span of directions that are orthonormal in the energy. For symmetric equations
    (conjugate gradients) only the last direction is stored, along which alone the solution changes;
    otherwise the equations on all of them are solved again for each new direction."""

    def __init__(self, equations: _Equations, load: np.ndarray) -> None:
        """Begin at zero; ``load`` (n,) is the right-hand side."""
        status = equations.status
        self.equations = equations
        self.load = load
        self.residual = load.copy()
        self.energy = 0.0
        self.directions: list[_Direction] = []
        self.at_contact = np.zeros((2, len(status.nodes), status.projections.shape[1]))
        # the equations on the directions, and their solution
        self._matrix = np.empty((equations.most, equations.most))
        self._loads = np.empty(equations.most)
        self._coefficients = np.empty(0)
        self._changes: np.ndarray | list[float] = []

    def update_residual(self) -> np.ndarray:
        """Return the residual (n,) after the last direction. It is updated only when a step begins, since
        nothing reads it after the last step."""
        for change, direction in zip(self._changes, self.directions, strict=True):
            self.residual = linalg.blas.daxpy(direction.image, self.residual, a=-change)
        return self.residual

    def extend(
        self, newest: _Direction, energy_product: Callable[[_Direction], float], least: float
    ) -> np.ndarray | None:
        """Solve with one direction more, which is made orthogonal in energy to the stored ones and of
        length 1, in place. Return the energy products (k + 1,) of the direction as it was with the k
        stored ones and with the new one; None, without a solution, if the square of the last one is
        not above ``least`` or the equations are singular: the status leaves a motion free."""
        # all products before the new direction changes: they read its arrays
        overlaps = np.array([energy_product(direction) for direction in self.directions])
        length_squared = energy_product(newest) - float(overlaps @ overlaps)
        if not length_squared > least:
            return None
        for overlap, direction in zip(overlaps, self.directions, strict=True):
            newest.add(-overlap, direction)
        newest.scale(1 / np.sqrt(length_squared))
        if self.equations.symmetric:
            self.directions = [newest]
            self._changes = [float(newest.values @ self.residual)]
            self.energy += self._changes[0] ** 2
        else:
            self.directions = [*self.directions, newest]
            k = len(self.directions)
            self._matrix[:k, k - 1] = [other.values @ newest.image for other in self.directions]
            self._matrix[k - 1, :k] = [newest.values @ other.image for other in self.directions]
            self._loads[k - 1] = newest.values @ self.load
            before = np.append(self._coefficients, 0.0)
            try:
                self._changes = np.linalg.solve(self._matrix[:k, :k], self._loads[:k]) - before
            except np.linalg.LinAlgError:
                return None
            self._coefficients = before + self._changes
            self.energy = float(self._coefficients @ self._coefficients)
        for change, direction in zip(self._changes, self.directions, strict=True):
            self.at_contact += change * direction.at_contact
        return np.append(overlaps, np.sqrt(length_squared))


def _estimated(
    equations: _Equations, load: np.ndarray, negligible: float
) -> tuple[HeldCorrection, bool]:
    """Return a Galerkin solution for a load (n,), of displacements and pressures, and whether further
    steps would change it little; ``negligible`` is an energy, N m, that need not be known."""
    solution = _GalerkinSolution(equations, load)
    energies = [0.0]
    for _ in range(equations.most):
        residual = solution.update_residual()
        newest, energy_product = equations.direction(residual)
        product = float(residual[: equations.n] @ newest.values[: equations.n])  # r.Pr
        if product <= equations.least:
            return HeldCorrection(solution.energy, *solution.at_contact), True
        column = solution.extend(newest, energy_product, checks.SIX_DIGITS * product)
        if column is None:
            return HeldCorrection(float("inf"), *solution.at_contact), False
        energies.append(solution.energy)
        settled = equations.settled_energy(energies, column, product, negligible)
        if settled is not None:
            return HeldCorrection(settled, *solution.at_contact), True
    return HeldCorrection(solution.energy, *solution.at_contact), False


def _factorised(
    problem: DiscreteProblem, status: FrozenStatus, load: np.ndarray, rounding: float
) -> HeldCorrection:
    r"""Return the correction for a load (n,), of displacements and pressures, by a factorisation of the
    equations

    .. math:: (K (I + D) A + K S) K + d\,(I - K),

    where d is the largest diagonal entry of A; with volumes there are further rows and columns. Rows of
    displacements get a small shift of the diagonal, which makes the matrix regular where the status
    leaves motions free. Forces that load such a motion, by more than ``rounding``, N, do not balance: the
    energy is then infinite."""
    matrix = problem.matrix
    volumes = problem.volumes
    n = problem.n_dofs
    dim = problem.dim
    identity = sparse.eye_array(n, format="csr")
    projection = identity + nodal_matrix(status.held, status.projections - np.eye(dim), n)  # K
    # K (I + D)
    with_drag = projection + projection @ nodal_matrix(status.nodes, status.dragged, n)
    diagonal_size = np.abs(matrix.diagonal()).max()
    equations = (
        with_drag @ matrix + projection @ nodal_matrix(status.nodes, status.stiffening, n)
    ) @ projection + diagonal_size * (identity - projection)
    shift = np.zeros(len(load))
    shift[:n] = checks.ROUNDING * diagonal_size
    of_pressures = sparse.diags_array(volumes.areas * volumes.compliance)
    blocks = [
        [equations, with_drag @ volumes.columns],
        [-volumes.rows @ projection, of_pressures],
    ]
    equations = sparse.block_array(blocks, format="csc")
    factors = splu(equations + sparse.diags_array(shift, format="csc"))
    solution = np.zeros(len(load))
    residual = load
    most_left = max(checks.SIX_DIGITS * np.linalg.norm(load[:n]), rounding)
    # balanced after any refinement: further ones may add motions that are free, by rounding
    balanced = False
    for _ in range(_REFINEMENTS):
        solution += factors.solve(residual)
        residual = load - equations @ solution
        balanced = balanced or bool(np.linalg.norm(residual[:n]) <= most_left)
    image = matrix @ solution[:n]
    energy = max(float(solution[:n] @ image), 0.0) + volumes.energy(solution[n:])
    image += volumes.forces(solution[n:])
    moved, forces = (vector.reshape(-1, dim)[status.nodes] for vector in (solution[:n], image))
    return HeldCorrection(energy if balanced else float("inf"), moved, forces)
