"""
Solids, STEP files and ParaView
===============================

Solids are boxes, cylinders, balls, bodies of revolution and extrusion, and what is cut and fused of
them. Here a drilled block is squeezed on a plane."""

import adaptmg as am

block = am.Cut(
    am.Box(width=40e-3, depth=30e-3, height=20e-3),
    am.Cylinder((20e-3, 15e-3, 0), (0, 0, 1), 7e-3, 20e-3),
)
print(block.boundaries)
problem = am.ContactProblem(
    name="drilled block",
    domain=block,
    material=am.Solid(young=2.1e11, poisson=0.3),
    law=am.Coulomb(0.4),
    contact=am.Contact("bottom", am.Plane((0, 0, 0), (0, 0, 1))),
    loads=(am.Pressure("top", 5e7), am.Pressure("left", 2e7)),
    supports=(am.Support("right", x=0.0), am.Support("front", y=0.0)),
)
grids = am.Hierarchy.graded(problem, sizes=(10e-3, 6e-3, 4e-3), contact_ratio=1)
result = am.solve(grids)
result

# %%
# Maps of the contact surface; a file for ParaView with displacement, stresses and contact
# quantities.

am.export.vtk(result, "drilled_block.vtu")
am.plot.contact(result)

# %%
# A body from a CAD program is ``am.StepFile("part.step", names={"face3": "foot"})``;
# ``am.mesh.step_table`` lists its solids and faces.
#
# **Next:** ``am.plot.deformation(result)``; the case ``greco_block``. **It depends on** your own problem.
