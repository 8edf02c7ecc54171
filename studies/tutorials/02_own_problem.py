"""
Your own problem: a plate with a hole
=====================================

A problem is a domain, a material, contact, a friction law, loads and supports. Boundaries have
names: those of a rectangle are bottom, right, top and left; the circle names its edge."""

import adaptmg as am

plate = am.Cut(am.Rectangle(width=80e-3, height=60e-3), am.Circle((40e-3, 30e-3), 12e-3, "hole"))
problem = am.ContactProblem(
    name="plate with a hole",
    domain=plate,
    material=am.PlaneStrain(young=2.1e11, poisson=0.3),
    contact=am.Contact("bottom", am.Plane((0, 0), (0, 1))),  # a rigid plane below
    law=am.Coulomb(0.3),
    loads=(am.Pressure("top", 4e7),),
    supports=(am.Support("left", x=0.0),),
)  # held in x, free in y
am.plot.problem(problem)

# %%
# Meshes are graded towards contact; the nodes of all levels lie on the circle. The default mesher
# is quick; ``mesher="netgen"`` takes meshes of NGSolve, to compare with its results or where the
# default one fails.

grids = am.Hierarchy.graded(problem, sizes=(12e-3, 7e-3, 4e-3, 2.4e-3), contact_ratio=2)
result = am.solve(grids)
am.plot.deformation(result, amplify=200, stress=True)

# %%
# The plane carries the whole load, 40 MPa on 80 mm; the hole takes pressure from the middle.

print(result.resultant("bottom").force)  # N/m
am.plot.contact(result)

# %%
# **Next:** ``am.Polygon`` and ``am.Outline`` (with arcs) make other shapes, ``am.GapFunction`` an obstacle that is not
# flat, ``am.Spring`` an elastic support. **It depends on** the bar in ten lines.
