"""What is posed: problems, materials, laws, loads, obstacles, domains. Pure data in SI units, no NGSolve."""

from adaptmg.problem.contact_problem import Contact, ContactProblem
from adaptmg.problem.domains import Box, Polygon, Rectangle
from adaptmg.problem.laws import Coulomb, Frictionless, Law, Tresca
from adaptmg.problem.loads import BodyForce, Pressure, Support, Traction
from adaptmg.problem.materials import Elastic, PlaneStrain, PlaneStress, Solid
from adaptmg.problem.obstacles import GapFunction, Plane

__all__ = ["BodyForce", "Box", "Contact", "ContactProblem", "Coulomb", "Elastic", "Frictionless", "GapFunction", "Law",
           "Plane", "PlaneStrain", "PlaneStress", "Polygon", "Pressure", "Rectangle", "Solid", "Support", "Traction",
           "Tresca"]
