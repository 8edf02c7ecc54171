r"""TruncatedStep: one step of the truncated nonsmooth Newton multigrid, on one level and those
below it.

1. *Smoother* (:meth:`~TruncatedStep.smooth`): a backward and a forward projected Gauss-Seidel
   sweep, local sweeps over the interface between bodies, and the rigid motions that only contact
   holds go to their least energy.
2. *Linearisation* (:meth:`~TruncatedStep.linearise`): update the contact status, drop closed
   normals and held tangents from the residual, and truncate the coarse matrices where the status
   has changed.
3. *Coarse correction*: a linear V-cycle on the truncated coarse problem, from a recombination of
   the last iterates.
4. *Projection* onto the admissible displacements.
5. *Search* for the least energy along the correction, where the friction is frozen.

With frozen friction this is a truncated nonsmooth Newton multigrid method (C. Graeser, R.
Kornhuber, J. Comput. Math. 27, 2009); the Newton rows of Coulomb's law and the recombination make
it faster.

CoarseContact: while the contact status is unknown, a linear correction carries a flexible body
through its obstacle, and the projection cuts it node by node. In the span of a coarse space,
:math:`u + P e`, the inequalities and the law of all contact nodes are kept: with the residual
:math:`r = f - A u`, the Galerkin matrix :math:`A_c` and the rows B of P at contact nodes, in their
frames, e solves

.. math:: A_c e + B' q(w + B e) = P' r,

q being the contact forces that belong to the displacements w + B e of the contact nodes. Coarse
unknowns that reach no contact node are eliminated once; the interior point method
(:mod:`adaptmg.smoother.interior_point`) solves the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import linalg, sparse

from adaptmg._numba import kernel
from adaptmg._threads import sum_of_parts
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.multigrid import projected_sweeps
from adaptmg.multigrid.linear_cycle import LinearCycle, least_weights, regular_matrix
from adaptmg.multigrid.projected_sweeps import Interface
from adaptmg.multigrid.rigid_motions import RigidMotions
from adaptmg.multigrid.truncated_contact import TruncatedContact
from adaptmg.multigrid.truncation import Truncation
from adaptmg.multigrid.volume_pressures import VolumePressures
from adaptmg.smoother.blocks import ZERO
from adaptmg.smoother.factorisation import Eliminated, dofs_of, eliminate
from adaptmg.smoother.interior_point import dense_factors, interior_point
from adaptmg.smoother.system import LocalSystem, NodalContact


@dataclass(frozen=True)
class StepState:
    """The iterate after the linearisation."""

    changed: int  # contact nodes whose status changed
    residual: float  # Euclidean norm of the natural residual, N
    reactions: float  # norm of the contact forces, N
    energy: float  # u'Au, N m; NaN: not asked


class TruncatedStep:
    """Steps on level ``number`` of the levels of a linear cycle, with contact."""

    #: with pressures: status changes with which a recombination with uniform pressures still is one. An enclosed block
    #: of rubber takes 34 cycles from zero at 0, 21 at 2, 20 at 4, 19 without a limit; 130 solves of random bodies of
    #: rubber 1928, 1935, 1928, 1977
    FEW = 4
    #: of the interval in the search for the least energy
    HALVINGS = 30

    def __init__(
        self,
        cycle: LinearCycle,
        number: int,
        problem: DiscreteProblem,
        contact: TruncatedContact,
        load: np.ndarray,
        iterate: np.ndarray,
        depth: int,
        motions: RigidMotions | None = None,
        interface: Interface | None = None,
        interface_sweeps: int = 0,
        search: bool = True,
    ) -> None:
        self.searches = search
        self.cycle = cycle
        self.number = number
        self.contact = contact
        self.pressures = VolumePressures(problem)
        self.level = cycle.levels[number]
        levels = cycle.levels[: number + 1]
        self.matrix = self.level.matrix
        self.coarse = self.level.below.matrix
        self.truncation = Truncation(
            [level.matrix for level in levels],
            [level.prolongation for level in levels[1:]],
            contact,
        )
        self.depth = depth
        self.residual = np.zeros(self.matrix.n_dofs)
        self.begin(load, iterate, motions)
        self.interface = interface
        self._interface_sweeps = 0 if interface is None else interface_sweeps

    def measure(
        self,
        trusted: Callable[[np.ndarray], float] | None = None,
        with_energy: bool = False,
    ) -> StepState:
        """Smooth and linearise, the first half of a step; :meth:`correct` is the other one.
        ``trusted`` gives the limit of :meth:`linearise` for the smoothed unknowns."""
        self.smooth()
        # u'Au = u'f - u'r; the linearisation truncates r
        energy = (
            _product(self.unknowns, self.load)
            - _product(self.unknowns, self.residual)
            + self.pressures.volumes.energy(self.group_pressures)
            if with_energy
            else np.nan
        )
        return self.linearise(np.inf if trusted is None else trusted(self.unknowns), energy)

    def smooth(self) -> None:
        """Improve the iterate locally; leaves f - A u in ``residual``."""
        self._projected_sweeps()
        if self.interface is not None:
            for k in range(self._interface_sweeps):
                backward = k % 2 == 0
                order = self.interface.backward if backward else self.interface.forward
                self._interface_sweep(self.interface, order)
        if self.motions is not None:
            past = [iterate[: self.matrix.n_dofs] for iterate, _ in self._past]
            self.motions.settle(self.unknowns, past, self.residual)

    def linearise(self, trusted: float, energy: float) -> StepState:
        """Update the contact status, truncate the residual and, where the status has changed, the
        coarse matrices. A residual above ``trusted`` (N) freezes g in the matrices, which keeps
        them symmetric."""
        changed, natural, reactions = self.contact.update_status(self.residual)
        pressures = self.pressures
        whole = self.residual.copy() if len(pressures.volumes) else self.residual
        at_contact = self.contact.truncate(self.residual)
        n = self.coarse.n_dofs
        #: the residual on the next coarser level, and what volumes miss
        self._left = np.empty(n + len(pressures.volumes))
        elsewhere = max(self.level.restrict(self.residual, self._left[:n]) - at_contact, 0.0)
        self.cycle.recorder.visit(self.number, "restrict")
        missed = self._left[n:]
        missed[:] = pressures.missed(self.unknowns, self.group_pressures)
        natural += pressures.forces_missed(missed)
        self.cycle.recorder.count(1.0, pressures.nonzeros)
        # not where the status was unknown: 1441 for 1512 cycles of 46 problems, ratio .45 to .5
        if changed and self._frozen is not None:
            pressures.hesitate()
        residual = float(np.sqrt(elsewhere + natural))
        frozen = residual > trusted
        if changed or frozen != self._frozen:
            self.contact.linearise_friction()
            self.truncation.apply(newton=not frozen)
            self.cycle.renew(self.number)
            self._past.clear()
            self._frozen = frozen
            self._uniform = []
        if not self._uniform and changed <= self.FEW:
            self._uniform = [self._of_uniform(whole, one) for one in pressures.uniform]
        return StepState(changed, residual, float(np.sqrt(reactions)), energy)

    def correct(self, shorten: bool = False) -> float:
        """Correct, project and search; returns the energy of the coarse correction, N m. It
        estimates the energy of the error that the correction removes. ``shorten``: up to where the
        first open node closes."""
        start = self.iterate, self._left
        combined, residual = self._recombined(*start)
        load = residual[: self.coarse.n_dofs]
        iterate = combined.copy()
        proposed = iterate[: self.matrix.n_dofs]
        # past iterates make up for what a cheaper cycle leaves
        correction = self.cycle.solve(self.number - 1, load, smooth=not self._corrected)
        energy = _product(load, correction)
        before = self.contact.values.copy()
        self.level.prolong(correction, proposed)
        proposed[self.matrix.fixed] = 0.0
        if shorten:
            way = self.contact.way(proposed)
            proposed[:] = self.unknowns + way * (proposed - self.unknowns)
        self.contact.project(proposed)
        if self._frozen and self.searches:
            self._search(proposed, before)
        smoothed = [] if combined is self.iterate else [start]
        self._past = [(combined, residual), *smoothed, *self._past][: self.depth]
        self.iterate = iterate
        self._corrected = True
        energy += self.pressures.advance(proposed, self.group_pressures)
        self._carry()
        self.cycle.recorder.count(2.0, self.pressures.nonzeros)
        self.cycle.recorder.visit(self.number, "prolong")
        return energy

    def move(self, change: np.ndarray) -> None:
        """Add a change (n_dofs,) to the iterate, which is projected onto the admissible ones."""
        unknowns = self.unknowns
        unknowns += change
        self.contact.start(self.unknowns)
        self._forget()

    def begin(self, load: np.ndarray, iterate: np.ndarray, motions: RigidMotions | None) -> None:
        """Begin at an admissible iterate (n_unknowns,), which is changed, under a load (n_dofs,):
        the first one or another load step."""
        self._given = load
        self.iterate = iterate
        self.motions = motions
        #: whether friction is frozen in the coarse matrices; None: they are to be made
        self._frozen: bool | None = None
        self._uniform: list[tuple[np.ndarray, np.ndarray]] = []
        self._forget()
        self._carry()

    def base_matrix(self, number: int) -> sparse.bsr_array:
        """The matrix of a coarser level without truncation."""
        self.truncation.restore()
        level = self.cycle.levels[number].matrix
        scale = np.abs(
            level.diagonal.reshape(-1, level.dim, level.dim).diagonal(axis1=1, axis2=2)
        ).reshape(-1)
        matrix = regular_matrix(level, np.where(scale > 0, scale, 1.0))
        if self._frozen is not None:
            self.truncation.apply(newton=not self._frozen)
        return matrix

    def set_aside(self, matrix: sparse.bsr_array, fixed: np.ndarray) -> None:
        """Free what only further steps read, if it is much: half of the matrix, which is made again
        from the whole one, and past iterates, without which recombination starts again."""
        if self.matrix.set_aside(matrix, fixed):
            self._past.clear()

    @property
    def unknowns(self) -> np.ndarray:
        """The displacement of the iterate (n_dofs,), from the prescribed values."""
        return self.iterate[: self.matrix.n_dofs]

    @property
    def group_pressures(self) -> np.ndarray:
        """The pressures of the iterate (n_groups,)."""
        return self.iterate[self.matrix.n_dofs :]

    def _forget(self) -> None:
        """Recombine no iterate before the present one."""
        self._corrected = False
        #: iterates and their restricted residuals, newest first, in turns a recombined one and the one it was made from
        self._past: list[tuple[np.ndarray, np.ndarray]] = []

    def _carry(self) -> None:
        """Find what the matrix of this level balances (n_dofs,): the load without what pressures of
        groups carry."""
        volumes = self.pressures.volumes
        self.load = self._given
        if len(volumes):
            self.load = self._given - volumes.forces(self.group_pressures)

    def _of_uniform(
        self, residual: np.ndarray, pressures: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """The pressures, and what they add to the restricted residual and to what volumes miss."""
        volumes = self.pressures.volumes
        changed = residual - volumes.forces(pressures)
        restricted = np.empty(self.coarse.n_dofs)
        self.contact.truncate(changed)
        self.level.restrict(changed - self.residual, restricted)
        return pressures, np.append(restricted, -volumes.compliance * pressures)

    def _projected_sweeps(self) -> None:
        """A backward and a forward sweep in one pass over the matrix."""
        matrix = self.matrix
        c = self.contact
        self.residual[:] = self.load
        matrix.sweep(
            projected_sweeps.backward,
            *matrix.lower_arrays,
            matrix.inverse,
            c.contact_of,
            *c.node_data,
            self.unknowns,
            self.residual,
            backward=True,
        )
        matrix.sweep(
            projected_sweeps.forward,
            *matrix.lower_arrays,
            matrix.inverse,
            c.diagonal,
            c.contact_of,
            *c.node_data,
            self.unknowns,
            self.residual,
        )
        self.cycle.recorder.count(1.0, matrix.nonzeros)
        self.cycle.recorder.visit(self.number, "smooth", 2)

    def _interface_sweep(self, interface: Interface, order: np.ndarray) -> None:
        c = self.contact
        projected_sweeps.local(
            ZERO[self.matrix.dim],
            order,
            *interface.arrays,
            self.matrix.inverse,
            c.contact_of,
            *c.node_data,
            self.unknowns,
            self.residual,
        )
        self.cycle.recorder.count(1.0, interface.nonzeros)

    def _recombined(self, iterate: np.ndarray, load: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        r"""The iterate and its restricted residual, recombined with the last ones: the weights of
        :math:`u + \sum_j \alpha_j (u_j - u)` minimise :math:`\sum_k |R_0 + \sum_j \alpha_j (R_j - R_0)|_k^2 / d_k`, d
        the diagonal of the coarse matrix (Anderson acceleration). While the contact status stays,
        the residual is affine in u (3D: nearly). With recombined iterates alone, few are as good as
        all of them where the problem is symmetric; the others keep what Coulomb's law needs."""
        uniform = self._uniform
        if self._past or uniform:
            dim = self.coarse.dim
            n = len(self._past)
            d = self.coarse.inverse.reshape(-1, dim, dim).diagonal(axis1=1, axis2=2).reshape(-1)
            d = np.append(d, self.pressures.weights)
            changes = np.array(
                [residual - load for _, residual in self._past] + [change for _, change in uniform]
            )
            alpha = least_weights(load, changes, d)
            combined = (1.0 - alpha[:n].sum()) * iterate
            for weight, (past, _) in zip(alpha, self._past, strict=False):
                combined = linalg.blas.daxpy(
                    past, combined, a=weight
                )  # in place: one pass over long vectors
            for weight, (pressures, _) in zip(alpha[n:], uniform, strict=True):
                combined[self.matrix.n_dofs :] += weight * pressures
            if self.contact.admits(combined[: self.matrix.n_dofs]):
                return combined, load + alpha @ changes
        return iterate, load

    def _search(self, proposed: np.ndarray, before: np.ndarray) -> None:
        """Shorten the step to the least energy with g frozen, in place; costs half a pass."""
        curvature = self._energy_product(proposed)
        change = proposed - self.unknowns
        gain = _product(self.residual, change)
        of_friction = self.contact.friction_slope(before)

        def slope(part: float) -> float:
            return part * curvature - gain + of_friction(part)

        if not slope(1.0) <= 0.0:
            low = 0.0
            high = 1.0
            for _ in range(self.HALVINGS):
                middle = 0.5 * (low + high)
                low, high = (low, middle) if slope(middle) > 0.0 else (middle, high)
            proposed[:] = self.unknowns + low * change
            self.contact.values[:] = before
            self.contact.project(proposed)

    def distance(self, other: np.ndarray) -> float:
        return float(np.sqrt(max(self._energy_product(other), 0.0)))

    def _energy_product(self, other: np.ndarray) -> float:
        """Square of the A-norm of the difference to other unknowns; half a pass."""
        matrix = self.matrix
        arrays = self.matrix.lower_arrays
        self.cycle.recorder.count(0.5, matrix.nonzeros)
        parts = sum_of_parts(
            projected_sweeps.energy_product,
            matrix.n_nodes,
            len(arrays[-1]),
            matrix.strips.order,
            ZERO[matrix.dim],
            *arrays,
            matrix.inverse,
            self.unknowns,
            other,
        )
        return float(parts)

    def rounding(self) -> float:
        """Norm of D u, D the diagonal, N: times the unit of rounding the least residual that
        arithmetic reaches."""
        matrix = self.matrix
        matrix.complete()
        diagonal = (
            matrix.inverse.reshape(-1, matrix.dim, matrix.dim)
            .diagonal(axis1=1, axis2=2)
            .reshape(-1)
        )
        stiff = np.divide(
            self.unknowns, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0
        )
        return float(np.sqrt(_product(stiff, stiff)))


def _product(a: np.ndarray, b: np.ndarray) -> float:
    """a'b, not through BLAS: its threads cost more than they gain."""
    return float(np.einsum("i,i->", a, b))


class CoarseContact:
    """Corrections of one :class:`~adaptmg.multigrid.truncated_step.TruncatedStep`, in the span of
    the finest level below its own with at most ``MOST`` unknowns (the coarsest may have more), of
    which at most ``MOST_CONTACT`` reach contact nodes. Where there is no such level, ``number`` is
    None and there are no corrections."""

    #: unknowns of the coarse space; those that reach contact nodes, dense in each interior point step (plate that
    #: touches with its whole face, 21k nodes: .5 s with 500, 2.7 s with all 2500); tolerance of its problem; slack
    #: above which its solution is refused
    MOST, MOST_CONTACT, TOLERANCE, REFUSED = 2500, 500, 1e-3, 1e-2

    def __init__(self, step: TruncatedStep, coordinates: list[np.ndarray | None]) -> None:
        self.step = step
        #: Any: None where no level serves; then it is not called
        self.number: int | Any = None
        space = next(self._spaces(), None)
        if space is None:
            return
        self.number, rows, nodes = space
        levels = step.cycle.levels
        contact = step.contact
        dim = step.contact.dim
        matrix = step.base_matrix(self.number)
        fixed = np.zeros(matrix.shape[0], dtype=bool)
        fixed[levels[self.number].matrix.fixed] = True
        self.eliminated = _eliminated(matrix, fixed, nodes, coordinates[self.number])
        self.unknowns = _CoarseSpan(self.eliminated.matrix, rows[:, self.eliminated.contact], dim)
        block = np.zeros((len(contact.nodes), dim, dim))
        block[(slice(None), *np.triu_indices(dim))] = contact.blocks.reshape(len(block), -1)
        self.stiffness = np.abs(block.diagonal(axis1=1, axis2=2))

    def _spaces(self) -> Iterator[tuple[int, sparse.csr_array, np.ndarray]]:
        """The levels that may serve, finest first: with B, the prolongation from there at contact
        nodes, in their frames, and the nodes that reach these."""
        step = self.step
        dim = self.step.contact.dim
        n = len(step.contact.nodes)
        dofs = dofs_of(step.contact.nodes, dim)
        frames = step.contact.frames.reshape(n, dim, dim)
        rows = sparse.csr_array(
            sparse.bsr_array((frames, np.arange(n), np.arange(n + 1)), shape=(n * dim, n * dim))
        )
        rows = sparse.csr_array(
            (rows.data, dofs[rows.indices], rows.indptr), shape=(n * dim, len(step.unknowns))
        )
        for number in reversed(range(step.number)):
            finer = step.cycle.levels[number + 1]
            coarse = step.cycle.levels[number].matrix
            size = finer.matrix.n_dofs // finer.prolongation.shape[0]
            nodal = sparse.kron(finer.prolongation, sparse.eye_array(size), format="csr")
            rows = _without(rows, finer.matrix.fixed) @ nodal
            if number > 0 and coarse.n_dofs > self.MOST:
                continue
            moving = _without(rows, coarse.fixed)
            moving.eliminate_zeros()
            nodes = np.unique(moving.indices // coarse.dim)
            if coarse.dim * len(nodes) <= self.MOST_CONTACT:
                yield number, moving, nodes

    def __call__(self) -> bool:
        """Correct the smoothed iterate; return whether there is a correction."""
        step = self.step
        if not len(self.eliminated.contact):  # no coarse unknown moves a contact node
            return False
        levels = step.cycle.levels
        rest = step.residual
        for level in reversed(levels[self.number + 1 : step.number + 1]):
            coarse = np.zeros(level.below.matrix.n_dofs)
            level.restrict(rest, coarse)
            rest = coarse
        particular, load = self.eliminated.reduce(rest)
        c = step.contact
        conditions = NodalContact(c.gap, c.reference.reshape(len(c.nodes), -1), c.limit, c.friction)
        solution = interior_point(
            self.unknowns,
            load,
            conditions,
            self.stiffness,
            self.TOLERANCE,
            c.values.reshape(len(c.nodes), -1),
        )
        if not solution.slack <= self.REFUSED:
            return False
        correction = self.eliminated.complete(particular, solution.unknowns)
        for level in levels[self.number + 1 : step.number + 1]:
            correction[level.below.matrix.fixed] = 0.0
            finer = np.zeros(level.matrix.n_dofs)
            level.prolong(correction, finer)
            correction = finer
        correction[step.matrix.fixed] = 0.0
        step.move(correction)
        return True


#: springs that hold what no fine node tells apart, over the diagonal
_SPRING = 1e-9


def _eliminated(
    matrix: sparse.bsr_array, fixed: np.ndarray, nodes: np.ndarray, coordinates: np.ndarray | None
) -> Eliminated:
    """All but the coarse nodes that reach contact nodes eliminated. Galerkin matrices of
    independent meshes may be singular without these; no force acts on what springs hold then."""
    try:
        return eliminate(LocalSystem.from_matrix(matrix, fixed, nodes), coordinates)
    except ValueError:
        held = sparse.bsr_array(
            matrix + sparse.diags_array(_SPRING * matrix.diagonal()), blocksize=matrix.blocksize
        )
        return eliminate(LocalSystem.from_matrix(held, fixed, nodes), coordinates)


def _without(rows: sparse.csr_array, fixed: np.ndarray) -> sparse.csr_array:
    """The rows with columns of fixed dofs zero."""
    free = np.ones(rows.shape[1])
    free[fixed] = 0.0
    return sparse.csr_array(
        (rows.data * free[rows.indices], rows.indices, rows.indptr), shape=rows.shape
    )


class _CoarseSpan:
    """Coarse unknowns; see :class:`~adaptmg.smoother.interior_point.Span`."""

    def __init__(self, matrix: np.ndarray, rows: sparse.csr_array, dim: int) -> None:
        self.matrix = matrix
        self.rows = rows
        self.dim = dim

    def product(self, unknowns: np.ndarray) -> np.ndarray:
        return self.matrix @ unknowns

    def values(self, unknowns: np.ndarray) -> np.ndarray:
        return (self.rows @ unknowns).reshape(-1, self.dim)

    def restricted(self, forces: np.ndarray) -> np.ndarray:
        return self.rows.T @ forces.reshape(-1)

    def factors(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        whole = self.matrix.copy()
        rows = self.rows
        _add_nodal(self.dim, rows.indptr, rows.indices, rows.data, blocks, whole)
        return dense_factors(whole)


@kernel
def _add_nodal(dim, indptr, indices, data, blocks, whole):
    """Whole += B' S B, S the blocks of the contact nodes."""
    for k in range(len(blocks)):
        for a in range(dim):
            for p in range(indptr[dim * k + a], indptr[dim * k + a + 1]):
                for b in range(dim):
                    factor = data[p] * blocks[k, a, b]
                    for q in range(indptr[dim * k + b], indptr[dim * k + b + 1]):
                        whole[indices[p], indices[q]] += factor * data[q]
