"""
The adaptive loop
=================

Solve, estimate, mark, refine. The foot of this block is singular where it ends; uniform meshes
converge slowly there. Every mesh becomes the finest level of those before it, and the solution on
the last mesh is the start."""

import adaptmg as am

steps = list(am.adapt(am.cases.upset_block(), start=5e-3, max_nodes=8000))
for step in steps:
    print(step)

# %%
# The error falls as the inverse square root of the number of nodes, the best that linear elements
# do. ``am.ContactProblem(elements="smoothed")`` needs fewer nodes for the same error.

print(steps[-1].outcome)
am.plot.adaptation(steps)

# %%
# **Next:** ``engine=am.Remesh()`` makes new meshes, ``indicator=am.Recovery()`` is a sharper estimate,
# ``tolerance=`` ends the loop at an error. **It depends on** the bar in ten lines; :doc:`/theory/estimators_and_goals`.
