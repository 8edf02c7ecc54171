"""
A rubber seal
=============

Rubber keeps its volume: its Poisson's ratio is nearly 1/2, and linear elements lock. Smoothed
elements have the same nodes and unknowns and do not. A seal of 5 mm is squeezed between two plates;
by symmetry a quarter of its section is enough."""

from dataclasses import replace

import adaptmg as am

radius, squeezed = 2.5e-3, 35e-6  # m; each plate moves by this
section = am.Outline(
    vertices=((0.0, 0.0), (radius, radius), (0.0, radius)),
    boundaries=("round", "middle", "axis"),
    arcs={0: (0.0, radius)},
)
problem = am.ContactProblem(
    name="seal",
    domain=section,
    material=am.PlaneStrain(young=3e6, poisson=0.4999),
    law=am.Coulomb(0.3),
    contact=am.Contact("round", am.Plane((0.0, 0.0), (0.0, 1.0))),
    supports=(am.Support("axis", x=0.0), am.Support("middle", y=-squeezed)),
    elements="smoothed",
)
grids = am.Hierarchy.graded(problem, sizes=(0.5e-3, 0.25e-3, 0.125e-3), contact_ratio=6)
result = am.solve(grids)
print(result)
print(2 * result.resultant("round").force[1])  # N/m on a plate
print(result.max_pressure)  # Pa: it holds a fluid below about that

# %%
# Linear elements on the same meshes: the force is too large, and the pressure oscillates.

linear = replace(problem, elements="linear")
locked = am.solve(grids.with_problem(linear))
print(2 * locked.resultant("round").force[1], locked.max_pressure)
am.plot.contact(result)

# %%
# **Next:** ``poisson=0.5`` exactly; a fluid's pressure on a part of the round side; :doc:`/theory/smoothed_elements`.
# **It depends on** graded meshes.
