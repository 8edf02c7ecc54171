"""
A load path and its hysteresis
==============================

Friction depends on the history. A load path gives each load a factor in each step; friction acts on
the slip of the step. The bar is pressed down, pushed, let go, and pushed again."""

import numpy as np

import adaptmg as am

grids = am.Hierarchy.graded(am.cases.greco_bar(), sizes=(10e-3, 6e-3, 3.6e-3), contact_ratio=4)
push = np.array([0.0, 0.25, 0.5, 0.75, 1.0, 0.75, 0.5, 0.25, 0.0, 0.5, 1.0])
path = am.LoadPath({"left": push})  # the pressure on top stays
steps = am.solve_path(grids, path)
steps

# %%
# The way back is another curve than the way there: the foot does not return to where it was.

moved = {"u_x of the corner [µm]": lambda step: 1e6 * step.probe([(0.0, 0.0)])[0, 0]}
am.plot.load_history(steps, push, moved, against="factor of the push", steps=4)

# %%
# A path may go on on another mesh, which need not be nested in the first one. Its first step repeats
# the loads, and restores equilibrium there.

finer = am.Hierarchy.graded(am.cases.greco_bar(), sizes=(8e-3, 4e-3, 2e-3), contact_ratio=4)
start = am.transfer_state(grids, steps[4], finer)
rest = am.solve_path(finer, am.LoadPath({"left": push[4:]}), start=start)
forces = [(path[-1].resultant("contact").force / 1e6).round(3) for path in (steps, rest)]
forces  # MN/m, at the end of both

# %%
# **Next:** ``store="folder"`` keeps each finished step, and an interrupted path goes on there;
# ``am.export.vtk_series`` writes all steps for ParaView. **It depends on** the bar in ten lines.
