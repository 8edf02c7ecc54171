r"""TruncatedStep: one step of the truncated nonsmooth Newton multigrid, on one level and those
below it.

1. *Smoother* (:meth:`~TruncatedStep.smooth`): a backward and a forward projected Gauss-Seidel
   sweep, or a user-defined smoother, local sweeps over the interface between bodies, and the rigid
   motions that only contact holds go to their least energy.
2. *Linearisation* (:meth:`~TruncatedStep.linearise`): update the contact status, drop closed
   normals and held tangents from the residual, and truncate the coarse matrices where the status
   has changed.
3. *Coarse correction*: a linear V-cycle on the truncated coarse problem, from a recombination of
   the last iterates.
4. *Projection* onto the admissible displacements, which may be user-defined.
5. *Search* for the least energy along the correction, where the friction is frozen.

With frozen friction this is a truncated nonsmooth Newton multigrid method (C. Graeser, R.
Kornhuber, J. Comput. Math. 27, 2009); the Newton rows of Coulomb's law and the recombination make
it faster.

CoarseContact: while the contact status is unknown, a linear correction carries a flexible body
through its obstacle, and the projection cuts it node by node. In the span of a coarse space,
:math:`u + P e`, the inequalities and the law of all contact nodes are kept: with the residual
:math:`r = f - A u`, the Galerkin matrix :math:`A_c` and the rows R of P at contact nodes, in their
frames, e solves

.. math:: A_c e + R' q(w + R e) = P' r,

q being the contact forces that belong to the displacements w + R e of the contact nodes. Coarse
unknowns that reach no contact node are eliminated once; the interior point method
(:mod:`adaptmg.smoother.interior_point`) solves the rest."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, cast

import numpy as np
from scipy import linalg, sparse

from adaptmg import _checks as checks
from adaptmg._numba import kernel
from adaptmg._threads import sum_of_parts
from adaptmg.discrete.coordinates import block_diagonal
from adaptmg.discrete.elasticity import dofs_of
from adaptmg.discrete.problem import DiscreteProblem
from adaptmg.mesh.arrays import mask_of
from adaptmg.multigrid import projected_sweeps
from adaptmg.multigrid.linear_cycle import LinearCycle, by_dofs, least_weights, regular_matrix
from adaptmg.multigrid.projected_sweeps import Interface
from adaptmg.multigrid.rigid_motions import RigidMotions
from adaptmg.multigrid.truncated_contact import UPPER, TruncatedContact, with_fields
from adaptmg.multigrid.truncated_parts import FrameSmoother, Truncated
from adaptmg.multigrid.truncation import Truncation
from adaptmg.smoother.blocks import ZERO
from adaptmg.smoother.factorisation import Eliminated, eliminate
from adaptmg.smoother.interior_point import DenseSpan, dense_factors, interior_point
from adaptmg.smoother.system import LocalSystem

#: entries of long vectors that a recombination takes at a time: its temporary arrays stay in the cache, and need no new
#: memory. The recombinations of a solve with 263k nodes take 39 ms; 41 at 65 536, 50 at 4096, 63 with whole vectors
PART = 16_384


@dataclass(frozen=True, eq=False)
class TruncatedStatus:
    """The contact status that the coarse matrices are truncated for."""

    contact: TruncatedContact  # with status, slip directions and Hessians
    frozen: bool  # whether the bounds g of friction are frozen, which keeps them symmetric


#: an iterate (n_unknowns,), or pressures (n_groups,) alone, and its residual on the next coarser level with what
#: volumes miss behind
Recombinable = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False, kw_only=True)
class TruncatedState:
    """An iterate, and all data of earlier steps that the next step reads."""

    iterate: np.ndarray  # (n_unknowns,): from the prescribed values, then pressures
    contact: TruncatedContact  # with its local values and status
    residual: np.ndarray  # (n_dofs,): f - B'p - A u; truncated by :meth:`TruncatedStep.linearise`
    cycles: int = 0  # corrections so far
    correction: float = np.nan  # energy of the last correction, N m: it estimates that of the error
    corrected: bool = False  # whether a correction came after the start and the last move
    #: newest first, in turns a recombined iterate and the one it was made from
    past: tuple[Recombinable, ...] = ()
    # further directions: a uniform pressure in each body, without displacements
    uniform: tuple[Recombinable, ...] = ()
    cautious: int = 0  # steps of the pressures that are still cautious
    linearised: TruncatedStatus | None = None  # None: at a start, which is not smoothed
    # the residual on the next coarser level, and what volumes miss
    coarse_residual: np.ndarray | None = None
    changed: int = 0  # contact nodes whose status changed
    natural: float = np.inf  # Euclidean norm of the natural residual, N
    reactions: float = 0.0  # norm of the contact forces, N
    size: float = 0.0  # A-norm of the displacement, when it was measured last
    moves: int = 0  # contact problems on a coarse level so far
    # A-norm, over ``size``, above which the next correction ends where the first open node closes
    shorten_above: float = np.inf
    from_start: float | None = None  # A-norm of the change by the first correction


class TruncatedStep:
    """Steps on level ``number`` of the levels of a linear cycle, with contact. It stores matrices,
    transfers and loads, and the coarse matrices of the last status, but no iterate."""

    #: with pressures: status changes in a step up to which iterates are recombined with uniform pressures. An enclosed
    #: block of rubber takes 34 cycles from zero at 0, 21 at 2, 20 at 4, 19 without a limit; 130 solves of random bodies
    #: of rubber 1928, 1935, 1928, 1977
    UNIFORM_CHANGES = 4
    #: share of a step of the pressures after a change of the status, and number of such steps. Half of the share
    #: changes 4 of 119 solves, paths and loops, twice 5; cycles 691, 700, 682 (campaign constants)
    CAUTIOUS, CAUTIOUS_STEPS = 0.5, 2
    #: times that the interval in the search for the least energy is halved
    HALVINGS = 30

    def __init__(
        self,
        cycle: LinearCycle,
        number: int,
        problem: DiscreteProblem,
        contact: TruncatedContact,
        options: Truncated,
        interface: Interface | None = None,
        smoother: FrameSmoother | None = None,
    ) -> None:
        """Prepare steps with the contact of a level; ``interface`` and ``smoother`` are None where
        the options do without."""
        self.options = options
        self.cycle = cycle
        self.number = number
        self.contact = contact
        self.level = cycle.levels[number]
        levels = cycle.levels[: number + 1]
        self.matrix = self.level.matrix
        self.coarse = self.level.below.matrix
        self._n_dofs = self.matrix.n_dofs
        self.truncation = Truncation(
            [level.matrix for level in levels],
            [level.prolongation for level in levels[1:]],
            contact,
        )
        self.interface = interface
        self.smoother = smoother
        self._applied: TruncatedStatus | None = None
        self._weights = np.empty(0)  # of squares of restricted residuals, in recombinations
        self._set_load(problem)

    def pose(self, problem: DiscreteProblem) -> None:
        """Replace loads, prescribed values, gaps and slip references by those of another load step."""
        self.contact = self.contact.posed(problem)
        self._set_load(problem)

    def _set_load(self, problem: DiscreteProblem) -> None:
        """Store the load and the volumes of a problem, and the motions that only contact holds."""
        self.load = problem.load_from_prescribed()
        self.volumes = problem.volumes.from_prescribed(problem)
        self.motions = (
            RigidMotions.of(problem, self.contact, self.load)
            if self.options.rigid_motions
            else None
        )

    def begin(self, iterate: np.ndarray) -> TruncatedState:
        """Return the state of a start (n_unknowns,), which is made admissible in place."""
        contact = self.contact.copy()
        contact.start(iterate[: self._n_dofs])
        return TruncatedState(iterate=iterate, contact=contact, residual=np.empty(self._n_dofs))

    def step(self, state: TruncatedState) -> TruncatedState:
        """Return the state after a correction (of a start there is none), smoothing and
        linearisation."""
        return self.linearise(self.smooth(self.correct(state)))

    def correct(self, state: TruncatedState) -> TruncatedState:
        """Return the state after a correction from the coarser levels, projection and search; a copy
        of a start. Each step begins here: what was set aside of the matrix is made again."""
        self.matrix.complete()
        if state.linearised is None or state.coarse_residual is None:
            return with_fields(state, iterate=state.iterate.copy(), contact=state.contact.copy())
        self._truncate(state.linearised)
        present = state.iterate, state.coarse_residual
        recombined = self._recombined(state, state.coarse_residual)
        # the correction begins at the recombined iterate, if there is one; both are past iterates then
        newest = (present,) if recombined is None else (recombined, present)
        begin, coarse_residual = newest[0]
        iterate = np.empty_like(begin)
        # views of the new iterate, which are changed in place
        proposed = iterate[: self._n_dofs]
        pressures = iterate[self._n_dofs :]
        pressures[:] = begin[self._n_dofs :]
        load = coarse_residual[: self.coarse.n_dofs]
        # only the first correction after a start or a move smooths first: no recombination makes up for it yet
        energy = self._corrected(begin, load, proposed, smooth=not state.corrected)
        contact = state.contact.copy()
        # matrices with Newton rows are not symmetric: this energy may be negative
        if abs(energy) > (state.shorten_above * state.size) ** 2:
            unknowns = self.displacement(state)
            share = contact.closing_share(proposed)
            proposed[:] = unknowns + share * (proposed - unknowns)
        self._project(contact, proposed)
        if state.linearised.frozen and self.options.search:
            self._search(state, proposed, contact)
        share = self.CAUTIOUS if state.cautious > 0 else 1.0
        energy += self.volumes.relax(proposed, pressures, share)
        self.cycle.recorder.count(2.0, self.volumes.rows.nnz)
        self.cycle.recorder.visit(self.number, "prolong")
        return with_fields(
            state,
            iterate=iterate,
            contact=contact,
            residual=np.empty(len(proposed)),
            cycles=state.cycles + 1,
            correction=energy,
            corrected=True,
            past=(*newest, *state.past)[: self.options.recombine],
            cautious=max(state.cautious - 1, 0),
            shorten_above=np.inf,
            from_start=None,
        )

    def _corrected(
        self, begin: np.ndarray, load: np.ndarray, result: np.ndarray, smooth: bool
    ) -> float:
        """Write the displacement of an iterate (n_unknowns,) plus the correction of the coarser levels for
        a load on the next one to ``result`` (n_dofs,); return the energy of the correction. Without the
        first smoothing the cycle is cheaper, and recombination makes up for the difference."""
        correction = self.cycle.solve(self.number - 1, load, smooth=smooth)
        self.level.prolong(correction, result, begin)
        result[self.matrix.fixed] = 0.0
        return _product(load, correction)

    def smooth(self, state: TruncatedState) -> TruncatedState:
        """Improve the iterate of a state from :meth:`correct` locally, in place, and write f - B'p - A u
        to its residual; return the state, which :meth:`linearise` takes."""
        unknowns, pressures = self.parts(state)
        self._sweep(state, self.volumes.balanced(self.load, pressures), unknowns)
        if self.interface is not None:
            self._sweep_interface(state, self.interface, unknowns)
        if self.motions is None:
            return state
        motion = self.motions.settle(state.contact, unknowns, state.residual)
        if motion is None:
            return state
        # the iterates before move along, so that recombination does not undo the motion
        motion = np.append(motion, np.zeros(len(pressures)))
        return with_fields(
            state,
            past=tuple(
                (earlier + motion, coarse_residual) for earlier, coarse_residual in state.past
            ),
        )

    def linearise(
        self,
        state: TruncatedState,
        trusted: Callable[[np.ndarray], float] = lambda unknowns: np.inf,
        norm: Callable[[np.ndarray, float], float] | None = None,
    ) -> TruncatedState:
        """Return the state with the contact status after the smoothing, and with the residual truncated
        for this status.

        If the natural residual, N, is above ``trusted(unknowns)``, the bounds g of friction are frozen
        in the coarse matrices, which keeps them symmetric. ``norm`` returns the size of a displacement
        with the energy u'Au; None: the size stays that of the state."""
        unknowns, pressures = self.parts(state)
        contact = state.contact
        residual = state.residual  # f - B'p - A u, which is truncated in place below
        size = state.size
        if norm is not None:
            # u'Au = u'f - u'r, and the energy of the pressures
            balanced = self.volumes.balanced(self.load, pressures)
            energy = _product(unknowns, balanced) - _product(unknowns, residual)
            energy += self.volumes.energy(pressures)
            size = norm(unknowns, energy)
        changed, natural_squares, reaction_squares = contact.update_status(residual)
        at_contact = residual.reshape(-1, contact.dim)[contact.nodes]
        truncated_squares = contact.truncate(residual)
        n = self.coarse.n_dofs
        coarse_residual = np.empty(n + len(pressures))
        all_squares = self.level.restrict(residual, coarse_residual[:n])
        self.cycle.recorder.visit(self.number, "restrict")
        missed = self.volumes.missed(unknowns, pressures)
        coarse_residual[n:] = missed
        forces_missed = self.volumes.scale * missed
        natural_squares += _product(forces_missed, forces_missed)
        self.cycle.recorder.count(1.0, self.volumes.rows.nnz)
        # away from contact nodes the natural residual is the residual
        free_squares = max(all_squares - truncated_squares, 0.0)
        natural = float(np.sqrt(free_squares + natural_squares))
        measured = with_fields(
            state,
            coarse_residual=coarse_residual,
            changed=changed,
            natural=natural,
            reactions=float(np.sqrt(reaction_squares)),
            size=size,
        )
        frozen = natural > trusted(unknowns)
        return self._with_linear_problem(measured, at_contact, frozen)

    def _with_linear_problem(
        self, state: TruncatedState, at_contact: np.ndarray, frozen: bool
    ) -> TruncatedState:
        """Return a measured state with the linear problem of its status: if that has changed, the
        earlier iterates had another one and are dropped. ``at_contact`` (n_contact, dim) is the residual
        at contact nodes before the truncation."""
        contact = state.contact
        if state.linearised is None or state.changed or frozen != state.linearised.frozen:
            # a start has no status that moves: if it counts, 46 problems with Poisson's ratios of .45
            # to .5 take 1512 cycles in place of 1441
            status_moves = state.changed and state.linearised is not None
            contact.linearise_friction()
            state = with_fields(
                state,
                linearised=TruncatedStatus(contact, frozen),
                past=(),
                uniform=(),
                cautious=self.CAUTIOUS_STEPS if status_moves else state.cautious,
            )
        if not state.uniform and state.changed <= self.UNIFORM_CHANGES:
            directions = tuple(
                self._of_uniform(contact, at_contact, state.residual, mode)
                for mode in self.volumes.uniform
            )
            state = with_fields(state, uniform=directions)
        return state

    def move(self, state: TruncatedState, change: np.ndarray) -> TruncatedState:
        """Add a change (n_dofs,) to an iterate that is being smoothed, and project it."""
        unknowns = self.displacement(state)
        unknowns += change
        state.contact.start(unknowns)
        return with_fields(state, corrected=False, past=())

    def displacement(self, state: TruncatedState) -> np.ndarray:
        """Return the displacement (n_dofs,) of an iterate, from the prescribed values."""
        return state.iterate[: self._n_dofs]

    def parts(self, state: TruncatedState) -> tuple[np.ndarray, np.ndarray]:
        """Return the displacement (n_dofs,) of an iterate, and its pressures (n_groups,)."""
        return state.iterate[: self._n_dofs], state.iterate[self._n_dofs :]

    def base_matrix(self, number: int) -> sparse.bsr_array:
        """Return the matrix of a coarser level without truncation."""
        self.restore()
        level = self.cycle.levels[number].matrix
        scale = level.diagonal_sizes
        return regular_matrix(level, np.where(scale > 0, scale, 1.0))

    def restore(self) -> None:
        """Restore the coarse matrices without truncation."""
        if self._applied is not None:
            self.truncation.restore()
            self._applied = None

    def _truncate(self, linearised: TruncatedStatus) -> None:
        """Truncate the coarse matrices for a status, unless they are truncated for it."""
        if self._applied is not linearised:
            self.truncation.apply(linearised.contact, newton=not linearised.frozen)
            self.cycle.renew(self.number)
            self._applied = linearised
            # 1/d of recombinations: of blocks the diagonals of their inverses, of pressures the factors
            # of their energies
            blocks = self.coarse.inverse.reshape(-1, self.coarse.dim, self.coarse.dim)
            diagonals = blocks.diagonal(axis1=1, axis2=2).reshape(-1)
            self._weights = np.append(diagonals, self.volumes.areas * self.volumes.modulus)

    def _of_uniform(
        self,
        contact: TruncatedContact,
        at_contact: np.ndarray,
        truncated: np.ndarray,
        pressures: np.ndarray,
    ) -> Recombinable:
        """Return uniform ``pressures`` q (n_groups,), Pa, as a direction of recombination: their changes
        of the restricted residual, P'(T(r - B'q) - T r), and of the missed volumes, -q/kappa.
        ``at_contact`` (n_contact, dim) is the residual r at contact nodes before the truncation T, which
        changes it only there, ``truncated`` (n_dofs,) that after it."""
        volumes = self.volumes
        changed = truncated.copy()
        changed.reshape(-1, contact.dim)[contact.nodes] = at_contact
        changed -= volumes.forces(pressures)
        restricted = np.empty(self.coarse.n_dofs)
        contact.truncate(changed)
        self.level.restrict(changed - truncated, restricted)
        return pressures, np.append(restricted, -volumes.compliance * pressures)

    def _project(self, contact: TruncatedContact, unknowns: np.ndarray) -> None:
        """Make a corrected iterate (n_dofs,) admissible, in place."""
        projection = self.options.project
        if projection is None:
            contact.project(unknowns, contact.codes)
        else:
            contact.project_by(projection.project, unknowns)

    def _sweep(self, state: TruncatedState, load: np.ndarray, unknowns: np.ndarray) -> None:
        """Sweep over all nodes: the ``unknowns`` (n_dofs,) of a state, for the ``load`` f - B'p."""
        if self.smoother is None:
            for _ in range(cast("int", self.options.smooth)):
                self._projected_sweeps(state, load, unknowns)
            return
        passes = self.smoother.smooth(load, state.contact, unknowns, state.residual)
        self.cycle.recorder.count(passes, self.matrix.nonzeros)
        self.cycle.recorder.count(1.0, self.matrix.nonzeros)  # the residual
        self.cycle.recorder.visit(self.number, "smooth")

    def _projected_sweeps(
        self, state: TruncatedState, load: np.ndarray, unknowns: np.ndarray
    ) -> None:
        """Sweep backward and forward, half a pass over the matrix each, as both read L alone; write
        f - B'p - A u to the residual. The forward sweep alone completes it, at contact nodes with their
        diagonal blocks: other nodes have no residual after their solve."""
        matrix = self.matrix
        contact = state.contact
        state.residual[:] = load
        halves = matrix.shared_arrays
        arguments = contact.contact_of, *contact.node_data, unknowns, state.residual
        matrix.sweep(projected_sweeps.backward, *halves, *arguments, backward=True)
        matrix.sweep(projected_sweeps.forward, *halves, contact.diagonal, *arguments)
        # two half passes, and two sweeps
        self.cycle.recorder.count(1.0, matrix.nonzeros)
        self.cycle.recorder.visit(self.number, "smooth", 2)

    def _sweep_interface(
        self, state: TruncatedState, interface: Interface, unknowns: np.ndarray
    ) -> None:
        """Sweep over the nodes near the interface, backward and forward in turn."""
        contact = state.contact
        arguments = (
            *interface.arrays,
            self.matrix.inverse,
            contact.contact_of,
            *contact.node_data,
            unknowns,
            state.residual,
        )
        for k in range(self.options.interface_sweeps):
            order = interface.backward if k % 2 == 0 else interface.forward
            projected_sweeps.local(ZERO[self.matrix.dim], order, *arguments)
            self.cycle.recorder.count(1.0, interface.nonzeros)

    def _recombined(
        self, state: TruncatedState, coarse_residual: np.ndarray
    ) -> Recombinable | None:
        r"""Return the iterate and its restricted residual (n,), recombined with the last ones: the weights of
        :math:`u + \sum_j \alpha_j (u_j - u)` minimise :math:`\sum_k |R_0 + \sum_j \alpha_j (R_j - R_0)|_k^2 / d_k`, d
        the diagonal of the coarse matrix (Anderson acceleration). While the contact status stays,
        the residual is affine in u (3D: nearly). None without earlier iterates, or if the recombined
        iterate is not admissible. Of symmetric problems a few recombined iterates would do; Coulomb's
        law needs those that they were made from, too."""
        if not (state.past or state.uniform):
            return None
        alphas = self._least_weights(state, coarse_residual)
        of_past = alphas[: len(state.past)]
        of_uniform = alphas[len(state.past) :]
        # (1 - sum alpha_j) u + sum alpha_j u_j
        present_share = 1.0 - of_past.sum()
        combined = np.empty_like(state.iterate)
        for part in _parts(len(combined)):
            np.multiply(present_share, state.iterate[part], out=combined[part])
            for alpha, (iterate, _) in zip(of_past, state.past, strict=True):
                linalg.blas.daxpy(iterate[part], combined[part], a=alpha)  # in place
        for alpha, (pressures, _) in zip(of_uniform, state.uniform, strict=True):
            combined[self._n_dofs :] += alpha * pressures
        if not state.contact.admits(combined[: self._n_dofs]):
            return None
        combined_residual = np.empty_like(coarse_residual)
        for part in _parts(len(coarse_residual)):
            change = alphas @ _changes(state, coarse_residual, part)
            combined_residual[part] = coarse_residual[part] + change
        return combined, combined_residual

    def _least_weights(self, state: TruncatedState, coarse_residual: np.ndarray) -> np.ndarray:
        """Return the weights alpha (k,) of :meth:`_recombined`, from sums over the parts of the
        residuals."""
        n_changes = len(state.past) + len(state.uniform)
        products = np.zeros((n_changes, n_changes))
        loads = np.zeros(n_changes)
        for part in _parts(len(coarse_residual)):
            changes = _changes(state, coarse_residual, part)
            weighted = changes * self._weights[part]
            products += weighted @ changes.T
            loads -= weighted @ coarse_residual[part]
        return least_weights(products, loads)

    def _search(
        self, state: TruncatedState, proposed: np.ndarray, contact: TruncatedContact
    ) -> None:
        """Shorten the step from the iterate of a state to the ``proposed`` one (n_dofs,), in place, to the
        least energy with the bounds g of friction frozen; ``contact`` has its values. Costs half a pass."""
        unknowns = self.displacement(state)
        curvature = self.distance(unknowns, proposed) ** 2
        change = proposed - unknowns
        gain = _product(state.residual, change)
        # the slope of the energy at u + part d: part d'A d - r . d, and the change of the friction's slope,
        # since r, truncated, contains the friction at u. Where the energy rises at the end of the step,
        # halve to where its slope vanishes
        slope = contact.slope_along(state.contact.values, curvature)
        gain += slope(0.0)
        if not slope(1.0) <= gain:
            accepted = 0.0
            rejected = 1.0
            for _ in range(self.HALVINGS):
                middle = 0.5 * (accepted + rejected)
                accepted, rejected = (
                    (accepted, middle) if slope(middle) > gain else (middle, rejected)
                )
            proposed[:] = unknowns + accepted * change
            contact.values[:] = state.contact.values
            self._project(contact, proposed)

    def distance(self, first: np.ndarray, second: np.ndarray) -> float:
        """Return the A-norm of the difference d of two displacements (n_dofs,); half a pass.

        With A = L + D + L' its square is d'D d + 2 d'L d. The rows of L are stored in the order of the sweeps,
        ``strips.order``. The sweeps store D by the inverses of its blocks, ``inverse``, which are
        inverted back here."""
        matrix = self.matrix
        self.cycle.recorder.count(0.5, matrix.nonzeros)
        square = sum_of_parts(
            projected_sweeps.energy_product,
            matrix.n_nodes,
            matrix.size_of_lower,  # the numbers that it reads, which decide into how many parts it is split
            matrix.strips.order,
            ZERO[matrix.dim],
            *matrix.shared_arrays,
            first,
            second,
        )
        return float(np.sqrt(max(square, 0.0)))

    def rounding(self, state: TruncatedState) -> float:
        """Return the norm of D u, N, of the displacement of a state; no residual falls below this times
        the unit of rounding (:class:`~adaptmg.solver.iterate.Measured`). The sweeps store only the
        inverses of diagonal blocks: D is the reciprocal of their diagonals, at most the diagonal of the
        matrix."""
        matrix = self.matrix
        matrix.complete()
        square = sum_of_parts(
            projected_sweeps.diagonal_square,
            matrix.n_nodes,
            matrix.dim * matrix.n_dofs,  # the entries of the inverse blocks
            ZERO[matrix.dim],
            matrix.kinds,
            matrix.inverse,
            self.displacement(state),
        )
        return float(np.sqrt(square))


@lru_cache(maxsize=32)  # of vectors of all levels: each is cut in every cycle
def _parts(n: int) -> tuple[slice, ...]:
    """Return the slices of ``PART`` entries of a vector (n,)."""
    return tuple(slice(first, first + PART) for first in range(0, n, PART))


def _changes(state: TruncatedState, coarse_residual: np.ndarray, part: slice) -> np.ndarray:
    """Return a part of the changes (k, m) of the restricted residual R_0 by a recombination: R_j - R_0
    of the earlier iterates, then those of uniform pressures."""
    changes = np.array([residual[part] for _, residual in (*state.past, *state.uniform)])
    changes[: len(state.past)] -= coarse_residual[part]
    return changes


def _product(a: np.ndarray, b: np.ndarray) -> float:
    """Return a'b, not through BLAS: its threads cost more than they gain."""
    return float(np.einsum("i,i->", a, b))


class CoarseContact:
    """Corrections of one :class:`~adaptmg.multigrid.truncated_step.TruncatedStep`, in the span of
    the finest level below its own with at most ``MOST`` unknowns (the coarsest may have more), of
    which at most ``MOST_CONTACT`` reach contact nodes. Where there is no such level, ``number`` is
    None and there are no corrections."""

    #: unknowns of the coarse space at most
    MOST = 2500
    #: unknowns at most that move contact nodes, dense in each interior point step: a plate that touches with its whole
    #: face, 21k nodes, takes .5 s with 500, 2.7 s with all 2500
    MOST_CONTACT = 500
    #: tolerance of its problem: half changes none of 74 solves and load paths, twice 3 of them, 778 cycles to 779
    #: (multigrid in campaign constants)
    TOLERANCE = 1e-3
    #: slack above which its solution is refused, as where the interior point method finds none: half, twice and a
    #: hundred times change none of these solves
    REFUSED = 1e-2

    def __init__(self, step: TruncatedStep, coordinates: list[np.ndarray | None]) -> None:
        """Choose the coarse space of a step, and eliminate its unknowns that move no contact node;
        ``coordinates`` (n_nodes, dim) are those of the levels, None of bare ones."""
        self.step = step
        #: Any: None where no level serves; then it is not called
        self.number: int | Any = None
        space = next(self._spaces(), None)
        if space is None:
            return
        self.number, contact_rows, moving_nodes = space  # as _spaces yields them
        contact = step.contact
        dim = step.contact.dim
        matrix = step.base_matrix(self.number)
        fixed = mask_of(step.cycle.levels[self.number].matrix.fixed, matrix.shape[0])
        self.eliminated = _eliminated(matrix, fixed, moving_nodes, coordinates[self.number])
        self.unknowns = _CoarseSpan(
            self.eliminated.matrix, contact_rows[:, self.eliminated.contact], dim
        )
        row, column = UPPER[dim]
        # the packed upper triangles of the local diagonal blocks
        triangles = contact.blocks.reshape(len(contact.nodes), -1)
        #: (n_contact, dim): their diagonals, N/m, by which the interior point method scales its start;
        #: that of a held tangent has its sign turned there (see turn_held)
        self.stiffness = np.abs(triangles[:, row == column])

    def _spaces(self) -> Iterator[tuple[int, sparse.csr_array, np.ndarray]]:
        """Yield the levels that may serve, finest first: the number, R, and the coarse nodes (n,) that move
        contact nodes. A level with more than MOST unknowns may serve if it is the coarsest one, number 0.

        R (n_contact * dim, n_dofs coarse) gives the local values of the contact nodes for coarse
        unknowns e, R e = F P_1 P_2 ... e, with the frames F of the contact nodes and the
        prolongations from level to level, in which fixed dofs do not move."""
        step = self.step
        dim = self.step.contact.dim
        dofs = dofs_of(step.contact.nodes, dim)
        frames = sparse.csr_array(block_diagonal(step.contact.node_frames))
        # F, in the columns of the dofs of the contact nodes
        rows = sparse.csr_array(
            (frames.data, dofs[frames.indices], frames.indptr),
            shape=(len(dofs), step.matrix.n_dofs),
        )
        for number in reversed(range(step.number)):
            finer = step.cycle.levels[number + 1]
            coarse = step.cycle.levels[number].matrix
            prolongation = by_dofs(finer.prolongation, finer.matrix.n_dofs)
            rows = _without(rows, finer.matrix.fixed) @ prolongation
            if coarse.n_dofs > self.MOST and number > 0:
                continue
            moving = _without(rows, coarse.fixed)
            moving.eliminate_zeros()
            nodes = np.unique(moving.indices // coarse.dim)
            if coarse.dim * len(nodes) <= self.MOST_CONTACT:
                yield number, moving, nodes

    def __call__(self, state: TruncatedState) -> TruncatedState:
        """Correct a smoothed iterate, in place; the same state where there is no correction."""
        step = self.step
        if not len(self.eliminated.contact):  # no coarse unknown moves a contact node
            return state
        levels = step.cycle.levels
        # P'r, level by level, then the correction P e in the same way
        residual = state.residual
        for level in reversed(levels[self.number + 1 : step.number + 1]):
            restricted = np.zeros(level.below.matrix.n_dofs)
            level.restrict(residual, restricted)
            residual = restricted
        particular, load = self.eliminated.reduce(residual)
        contact = state.contact
        # A_c e + R'q(w + R e) = P'r
        solution = interior_point(
            self.unknowns,
            load,
            contact.conditions,
            stiffness=self.stiffness,
            tolerance=self.TOLERANCE,
            offset=contact.values.reshape(len(contact.nodes), -1),
        )
        if not solution.slack <= self.REFUSED:
            return state
        correction = self.eliminated.complete(particular, solution.unknowns)
        for level in levels[self.number + 1 : step.number + 1]:
            correction[level.below.matrix.fixed] = 0.0
            prolonged = np.zeros(level.matrix.n_dofs)
            level.prolong(correction, prolonged)
            correction = prolonged
        correction[step.matrix.fixed] = 0.0
        return step.move(state, correction)


def _eliminated(
    matrix: sparse.bsr_array, fixed: np.ndarray, nodes: np.ndarray, coordinates: np.ndarray | None
) -> Eliminated:
    """Eliminate all but the coarse ``nodes`` (n,), which move contact nodes; ``fixed`` (n_dofs,) is a mask,
    ``coordinates`` are (n_nodes, dim). Galerkin matrices of independent meshes may be singular without
    these nodes: weak springs on all dofs then hold motions on which no force acts."""
    try:
        return eliminate(LocalSystem.from_matrix(matrix, fixed, nodes), coordinates)
    except ValueError:  # singular with all contact dofs fixed
        stiffened = sparse.bsr_array(
            matrix + sparse.diags_array(checks.ALIKE * matrix.diagonal()),
            blocksize=matrix.blocksize,
        )
        return eliminate(LocalSystem.from_matrix(stiffened, fixed, nodes), coordinates)


def _without(rows: sparse.csr_array, fixed: np.ndarray) -> sparse.csr_array:
    """Return the rows (m, n_dofs) with zeros in the columns of the dofs ``fixed`` (n,), numbers."""
    free = np.ones(rows.shape[1])
    free[fixed] = 0.0
    return sparse.csr_array(
        (rows.data * free[rows.indices], rows.indices, rows.indptr), shape=rows.shape
    )


class _CoarseSpan(DenseSpan):
    """Coarse unknowns; see :class:`~adaptmg.smoother.interior_point.Span`."""

    def factors(self, blocks: np.ndarray) -> Callable[[np.ndarray], np.ndarray] | None:
        whole = self.matrix.copy()
        rows = self.rows
        _add_nodal(self.dim, rows.indptr, rows.indices, rows.data, blocks, whole)
        return dense_factors(whole)


@kernel
def _add_nodal(dim, indptr, indices, data, blocks, whole):
    """Add R'D R to ``whole`` (m, m), with R (n_contact * dim, m) as CSR arrays and D the ``blocks``
    (n_contact, dim, dim) of the contact nodes."""
    for k in range(len(blocks)):
        for a in range(dim):
            for p in range(indptr[dim * k + a], indptr[dim * k + a + 1]):
                for b in range(dim):
                    factor = data[p] * blocks[k, a, b]
                    for q in range(indptr[dim * k + b], indptr[dim * k + b + 1]):
                        whole[indices[p], indices[q]] += factor * data[q]
