"""CoarseObstacles: corrections of scalar problems while the contact status is unknown, by a monotone
cycle.

Where all nodes may touch, a linear correction carries a membrane through its obstacle, and the
projection puts far too many nodes back onto it. They lose contact layer by layer, which takes many
cycles. Here the obstacle of a coarse node is the smallest gap over the nodes that it reaches, as in
:class:`~adaptmg.multigrid.cycle.Monotone`, on all levels: no correction penetrates."""

from __future__ import annotations

import numpy as np
from scipy import sparse

from adaptmg.mesh.arrays import mask_of
from adaptmg.multigrid.cycle import CoarseSolve, CorrectionLevel, Cycle, Monotone, MultigridCycle
from adaptmg.multigrid.truncated_step import TruncatedState, TruncatedStep
from adaptmg.smoother.gauss_seidel import ProjectedGaussSeidel
from adaptmg.smoother.system import LocalSystem


class CoarseObstacles:
    """Monotone W-cycles below the level of a step, in place of
    :class:`~adaptmg.multigrid.truncated_step.CoarseContact`."""

    def __init__(self, step: TruncatedStep) -> None:
        self.step = step
        levels = _levels(step)
        # with weights that are not positive no coarse obstacle is safe
        safe = all((level.contact_prolongation.data > 0).all() for level in levels[1:])
        self.number = step.number - 1 if safe else None  # the level below, where this serves
        # cycles from zero to 1e-8, floor and torsion with 64 and 256 cells a side: W and F 7, 7, 9, 8,
        # V 7, 8, 9, 12; W with two sweeps 7, 7, 8, 8
        self.cycle = MultigridCycle(
            levels,
            Cycle(shape="W", pre=1, post=1),
            ProjectedGaussSeidel(),
            Monotone(),
            CoarseSolve(),
            step.cycle.recorder,
        )

    def __call__(self, state: TruncatedState) -> TruncatedState:
        """Correct a smoothed iterate, in place."""
        step = self.step
        unknowns = step.displacement(state)
        moved = unknowns.copy()
        self.cycle.correct(step.number, state.contact.conditions, moved, state.residual, shape="W")
        # iterates count from the prescribed values: all fixed dofs are zero, also the prescribed ones
        moved[step.matrix.fixed] = 0.0
        return step.move(state, moved - unknowns)


def _levels(step: TruncatedStep) -> list[CorrectionLevel]:
    """Return the levels up to that of the step, coarsest first. The problem is scalar: a node has the
    number of its dof."""
    levels = step.cycle.levels
    # of the level of the step the cycle reads the contact nodes only: the state has the residual
    finest = levels[step.number].matrix
    identity = sparse.bsr_array(sparse.eye_array(finest.n_dofs))
    fixed = mask_of(finest.fixed, finest.n_dofs)
    fine = CorrectionLevel(LocalSystem.from_matrix(identity, fixed, step.contact.nodes))
    result = [fine]  # finest first
    for number in range(step.number - 1, -1, -1):
        prolongation = levels[number + 1].prolongation
        fixed = mask_of(levels[number].matrix.fixed, prolongation.shape[1])
        # columns of fixed coarse nodes are empty, as the product stores no zeros: values there do not
        # reach the finer levels
        free = sparse.diags_array((~fixed).astype(float))
        fine.prolongation = sparse.csr_array(prolongation @ free)
        fine.restriction = sparse.csr_array(fine.prolongation.T)
        # coarse nodes are contact nodes where they reach some of the fine ones
        contact_rows = fine.prolongation[fine.system.nodes]
        nodes = np.unique(contact_rows.indices)
        fine.contact_prolongation = contact_rows[:, nodes]
        system = LocalSystem.from_matrix(step.base_matrix(number), fixed, nodes)
        fine = CorrectionLevel(system)
        result.append(fine)
    return result[::-1]
