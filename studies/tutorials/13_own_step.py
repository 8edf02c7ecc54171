"""
Your own multigrid step
=======================

A method is ``setup(hierarchy, start)``, which returns an object with ``step(state)``: state in,
state out. This one smooths, drops what contact holds, corrects by a V-cycle of pyamg, and projects.
``am.solve`` adds the nested start, the history, the work and the certificate."""

import numpy as np
from scipy import sparse

import adaptmg as am


class TruncatedStep:
    def __init__(self, hierarchy):
        problems = [am.smoother.local_system(level.discrete) for level in hierarchy.levels]
        self.problem = problems[-1]  # the matrix in contact frames: normal, tangents
        self.prolongations = am.multigrid.local_prolongations(hierarchy, problems)

    def step(self, state):
        problem, contact = self.problem, self.problem.contact
        w = state.unknowns.copy()
        passes = am.ProjectedGaussSeidel().smooth(
            problem.system, contact, problem.load, w, sweeps=3
        )
        residual = problem.residual(w)
        normal = problem.system.dim * problem.system.nodes
        held = problem.system.fixed.copy()
        held[normal] |= (w[normal] >= contact.gap) & (residual[normal] > 0)
        change = self.linear_cycle(np.where(held, 0.0, residual), held)
        w += np.where(held, 0.0, change)
        w[normal] = np.minimum(w[normal], contact.gap)
        return am.State(unknowns=w, passes=passes + 3)

    def linear_cycle(self, load, held):
        free = sparse.diags_array(np.where(held, 0.0, 1.0))
        matrix = free @ self.problem.system.matrix @ free + sparse.diags_array(held.astype(float))
        matrices, prolongations = [sparse.csr_array(matrix)], list(self.prolongations)
        prolongations[-1] = sparse.csr_array(free @ prolongations[-1])
        for prolongation in reversed(prolongations):
            coarse = sparse.csr_array(prolongation.T @ matrices[0] @ prolongation)
            empty = np.where(coarse.diagonal() > 0, 0.0, 1.0)  # dofs that reach no free one
            matrices.insert(0, coarse + sparse.diags_array(empty))
        return am.PyAMG().setup(matrices, prolongations).solve(load)


class Mine:
    rtol = 1e-6

    def setup(self, hierarchy, start):
        return TruncatedStep(hierarchy)


problem = am.cases.curved_obstacle()  # without friction
grids = am.Hierarchy.uniform(problem, divisions=(4, 8, 16, 32))
for solver in (Mine(), am.FullMultigrid(rtol=1e-6)):
    result = am.solve(grids, solver)
    print(f"{result.solver_name}: {result.cycles} cycles, {result.work_units:.0f} passes")
am.plot.history(result)

# %%
# The cycles of the package go from state to state too, so that you can look at each state, or put something between
# two cycles:
stepper = am.Multigrid().setup(grids)
state = am.State(unknowns=np.zeros(grids.finest.discrete.n_dofs))
for _ in range(3):
    state = stepper.step(state)
    print(f"cycle {state.cycles}: {state.passes:.1f} passes")

# %%
# To exchange one part of the package's step, give it to ``am.Truncated``: ``smooth=``, ``correct=`` or ``project=``.
#
# **Next:** keep the directions of slip too (``am.Truncated`` does). **It depends on** your own parts.
