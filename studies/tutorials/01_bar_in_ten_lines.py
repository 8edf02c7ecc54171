"""
The bar in ten lines
====================

A square bar is pressed on a rigid plane and pushed along it, with Coulomb friction 1. A problem,
grids, a solve, a result: every session has these four parts. The first solve on a machine compiles
kernels; ``adaptmg warm`` in a shell compiles nearly all of them."""

import adaptmg as am

problem = am.cases.greco_bar(law=am.Coulomb(1.0))  # lengths in m, pressures in Pa
grids = am.Hierarchy.graded(problem, sizes=(10e-3, 6e-3, 3.6e-3, 2.2e-3), contact_ratio=4)
grids

# %%
# The four meshes are independent of one another, and four times finer at contact. The default
# method is truncated multigrid with a nested start (of problems with at most 600 unknowns it is the active set
# method). Printing a result shows its status, cycles,
# work and estimated error.

result = am.solve(grids)
result

# %%
# The certificate recomputes every condition of the problem from the raw matrices.

print(result.certificate())

# %%
# The bar lifts at its left corner, slips in the middle and sticks on the right: the three colours.

am.plot.contact(result)

# %%
# **Next:** change the friction, or take more sizes. ``result.stress()``, ``result.probe(points)`` and
# ``result.resultant("contact")`` answer further questions.
# **It depends on** nothing: this is the first tutorial.
