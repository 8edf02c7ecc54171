"""
The bar in ten lines
====================

A square bar is pressed on a rigid plane and pushed along it, with Coulomb friction 1. A problem, grids, a solve, a result:
every session has these four parts.
"""

import adaptmg as am

problem = am.cases.greco_bar(law=am.Coulomb(1.0))
grids = am.Hierarchy.graded(problem, sizes=(10e-3, 6e-3, 3.6e-3, 2.2e-3), contact_ratio=4)
grids
