"""
A goal: one number, with its error
==================================

Often one number matters: here the displacement of the bar's corner. A dual problem says which
elements the number depends on. The estimate has a sign, and the corrected value is usually closer
than the value."""

import adaptmg as am

problem = am.cases.greco_bar()
exact = problem.reference["values"]["converged"]["A"]  # m
goal = am.Goal(am.Displacement(problem.reference["points"]["A"], "x"))
steps = list(am.adapt(problem, start=10e-3, indicator=goal, max_nodes=4000))
for step in steps:
    error, corrected = step.estimate.value / exact - 1, step.estimate.corrected[0] / exact - 1
    errors = f"error {error:+.1e}, corrected {corrected:+.1e}"
    print(f"{step.nodes:5d} nodes: {errors}, settled: {step.settled}")

# %%
# Believe the estimate when ``step.settled`` says so: on coarse meshes the contact state itself is
# wrong. It may be False on a good mesh, too, where the error passes through zero; the corrected
# values and their change from mesh to mesh then say more.

am.plot.adaptation(steps)

# %%
# **Next:** ``am.ContactForce``, ``am.Opening``, ``am.MeanDisplacement``, or several goals in one list.
# **It depends on** the adaptive loop.
