"""
A crack that slips
==================

A plate with a crack at 45 degrees is pressed from above and below. The crack stays closed, slides
against friction, and its tips are sheared. Both faces are boundaries of one body, and a contact
pair."""

import numpy as np

import adaptmg as am

a, stress, friction = 10e-3, 50e6, 0.3
c = a / np.sqrt(2)
plate = am.Rectangle(width=0.4, height=0.4, origin=(-0.2, -0.2))
problem = am.ContactProblem(
    name="crack",
    domain=am.Cracked(plate, {"crack": ((-c, -c), (c, c))}),
    material=am.PlaneStrain(young=7e10, poisson=0.25),
    law=am.Coulomb(friction),
    contact=am.ContactPair("crack.left", "crack.right"),  # left and right as seen along the path
    loads=(am.Pressure("top", stress), am.Pressure("bottom", stress)),
    supports=(am.PointSupport((-0.2, -0.2), x=0.0, y=0.0), am.PointSupport((0.2, -0.2), y=0.0)),
)
*_, step = am.adapt(problem, max_nodes=5000)  # fine at the tips
print(step)

# %%
# The stress intensity factors at the end of the path, against those of an infinite plate: K_I = 0,
# and K_II from the shear that friction leaves.

factors = step.result.stress_intensity("crack", tip=1)
print(factors.K_I, factors.K_II, -0.5 * stress * (1 - friction) * np.sqrt(np.pi * a))  # Pa sqrt(m)

# %%
# The slip along the crack is an ellipse.

am.plot.contact(step.result)

# %%
# **Next:** a path with more points, or from the boundary; several cracks; :doc:`/howto/cracks`. **It depends on** two
# bodies, and the adaptive loop.
