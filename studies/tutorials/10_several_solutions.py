"""
Several solutions
=================

With large friction one load may have several equilibria. The leaning strut has three: its foot
sticks, slips, or has lifted off. A solver finds one of them; which one depends on the start."""

import matplotlib.pyplot as plt

import adaptmg as am

grids = am.Hierarchy.graded(am.cases.leaning_strut(), sizes=(20e-3, 10e-3, 5e-3), contact_ratio=2)


def near(law):
    """A solution of the same strut with another law, as start."""
    return am.solve(grids.with_problem(am.cases.leaning_strut(law=law)), am.ActiveSet())


# a given limit serves as a start only: it holds at open nodes, too, and a warning says so
results = {
    "all nodes held": am.solve(grids, am.ActiveSet(start="held")),
    "limit of 1 MPa": am.solve(grids, am.ActiveSet(), start=near(am.Tresca(1e6))),
    "frictionless": am.solve(grids, am.ActiveSet(), start=near(am.Frictionless())),
}
figure, axes = plt.subplots(1, 3, figsize=(11, 4), layout="constrained")
for ax, (start, result) in zip(axes, results.items(), strict=True):
    closed = result.contact.state[result.contact.state != am.OPEN]
    state = {am.SLIP: "slips", am.STICK: "sticks"}[closed[0]] if len(closed) else "is open"
    am.plot.deformation(result, ax=ax, amplify=300)
    ax.set_title(f"start: {start}\nthe foot {state}", fontsize=9)
    print(f"the foot {state}: residual {result.residual:.0e}")

# %%
# All three satisfy every condition. ``am.solve`` warns where friction exceeds an estimate of the
# critical coefficient. Newton steps of the active set method stay near their start; multigrid finds
# the foot open from zero and from the last two of these starts.
#
# **Next:** a load path decides physically which solution is reached. **It depends on** the bar in ten lines.
